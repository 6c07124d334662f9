"""What the paper's text and captions say of figures 2 and 3, a test for each claim in words."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from analysis_scripts import load
from figure_checks import faults

import weberwhisk as ww
from weberwhisk._util.output import Run
from weberwhisk.cues import BalanceOfMoments, MuscleCurve
from weberwhisk.plots import figure_of

paper, claims, script = (load(f"paper.{name}") for name in ("remade", "claims", "make"))
gallery = load("gallery.make")
ROOT = Path(__file__).parents[2]
W = ww.Whisker(50e-3, 100e-6, 5e-6, 3e9)
IMPACT = np.radians(60)


def test_2a_the_whiskers_drawn_are_free_of_moment_at_the_contact_and_at_90_degrees():
    """Drawn from the base's signals alone, they end where, and as steep as, the contact says."""
    for share in (0.3, 0.6, 0.9):
        bent = paper.loaded(W, np.array(share * W.length), np.array(np.pi / 2))
        x, y = paper.shape(W, bent)
        assert np.hypot(x[-2], y[-2]) == pytest.approx(float(bent.radial_distance), rel=1e-6)
        assert np.arctan2(y[-1] - y[-2], x[-1] - x[-2]) == pytest.approx(np.pi / 2, abs=1e-6)
        lever = [x[-2], y[-2]] @ np.array([bent.transverse_force, bent.axial_force])
        assert lever == pytest.approx(float(bent.moment), rel=1e-6)


def test_2de_the_tapered_map_is_one_to_one():
    """One sign of the Jacobian, and an edge whose image does not cross itself: no two contacts.

    The domain is the paper's, up to a contact angle of 90°, past the folds too.
    """
    assert set(np.sign(paper.map_jacobian(W)).ravel()) == {-1.0}
    edge = paper.map_boundary(W, 120)
    assert np.all(np.isfinite(edge))
    assert paper.crossings(edge) == 0
    # The count sees a crossing where there is one.
    assert paper.crossings(np.array([[0.0, 0.0], [1.0, 1.0], [1.0, 0.0], [0.0, 1.0]])) == 1


def test_2de_distinct_contacts_have_distinct_signals_by_plain_comparison():
    """All pairs of 1600 contacts: near in both signals only where near as contacts."""
    arc = np.linspace(0.05, 1.0, 40) * W.length
    angle = np.radians(np.linspace(2, 90, 40))[:, None]
    bent = paper.loaded(W, arc, angle)
    ratio = bent.moment**2 / (2 * W.stiffness * bent.axial_force)
    signals = np.log([bent.normalised_moment, ratio]).reshape(2, -1)
    place = np.indices(ratio.shape).reshape(2, -1)
    apart = np.max(np.abs(place[:, :, None] - place[:, None]), axis=0)
    gap = np.hypot(*(signals[:, :, None] - signals[:, None]))
    assert np.min(gap[apart > 2]) > 0.1 * np.median(gap[apart == 1])


def test_2f_the_cylinders_map_is_the_parabola():
    cylinder = W.cylinder()
    bent = paper.loaded(
        cylinder,
        np.linspace(0.05, 1, 30) * W.length,
        np.radians(np.linspace(1, 90, 40))[:, None],
    )
    ratio = bent.moment**2 / (2 * cylinder.stiffness * bent.axial_force)
    np.testing.assert_allclose(ratio, 1, rtol=1e-12)
    # Contacts far apart share their signals, as they cannot on the tapered whisker.
    moment = 2.5 * cylinder.moment_scale
    places = []
    for share in (0.4, 0.9):
        force = np.geomspace(1e-6, 1e-2, 4000)
        at = ww.bend(cylinder, share * W.length, force)
        i = int(np.nanargmin(np.abs(at.moment - moment)))
        places.append((at.axial_force[i], at.radial_distance[i]))
    assert places[0][0] == pytest.approx(places[1][0], rel=0.01)
    assert places[1][1] > 2 * places[0][1]


def test_3a_of_four_distances_two_are_held_and_two_flick_past():
    place = np.array([[0.3], [0.5], [0.7], [0.9]]) * W.length
    _, outcome = BalanceOfMoments(IMPACT).signals(W, place)
    assert [ww.Outcome(k).name for k in outcome] == ["HELD"] * 2 + ["FLICKED_PAST"] * 2


@pytest.mark.parametrize("curve", MuscleCurve)
def test_3b_the_angle_of_balance_grows_with_distance_from_any_impact(curve):
    place = np.linspace(0.3, 1.0, 60)[:, None] * W.length
    for impact in np.radians(np.linspace(30, 140, 9)):
        angle, outcome = BalanceOfMoments(impact, curve=curve).signals(W, place)
        held = np.flatnonzero(outcome == ww.Outcome.HELD)
        assert held.size > 1
        assert np.all(np.diff(held) == 1)
        assert np.all(np.diff(angle[held, 0]) > 0)


@pytest.mark.parametrize(("curve", "end"), [("printed", 0.6970), ("normalised", 0.6970)])
def test_3b_the_curve_ends_at_around_70_per_cent(curve, end):
    """§2h: scaled so that it tended to flick past at around 70 %; see also test_muscle."""
    found = paper.curve_end(MuscleCurve(curve))
    assert found == pytest.approx(0.7, abs=0.02)
    assert round(found, 4) == end


@pytest.mark.slow
def test_3c_flick_past_below_the_dashed_line_and_the_end_of_whisking_above():
    share = np.linspace(0.3, 0.98, 25)
    impact = np.radians(np.linspace(30, 149, 41))
    place = share[:, None] * W.length
    outcome = np.stack([BalanceOfMoments(angle).signals(W, place)[1] for angle in impact])
    flick = ww.flick_past(W, share * W.length).deflection_angle
    below = impact[:, None] + flick <= np.radians(150)
    early = np.isin(outcome, [ww.Outcome.FLICKED_PAST, ww.Outcome.SLIPPED_OFF_TIP])
    late = outcome == ww.Outcome.END_OF_WHISKING
    assert early.any()
    assert late.any()
    assert np.all(below[early])
    assert not np.any(below[late])


def test_every_claim_names_a_test_that_is_there():
    names = [claim.test.split("::") for claim in claims.CLAIMS]
    for file, name in names:
        assert re.search(rf"^def {name}\(", (ROOT / file).read_text("utf-8"), re.MULTILINE), name
    said = " ".join(claim.where for claim in claims.CLAIMS)
    for equation in ("2.1", "2.2", "2.3", *(f"3.{i}" for i in range(1, 9))):
        assert f"({equation})" in said
    for section in (*(f"§2{letter}" for letter in "abcdefgh"), "§3b", "§3c", "§4"):
        assert section in said


@pytest.mark.slow
def test_the_script_draws_every_panel_and_says_what_it_finds(tmp_path, monkeypatch):
    charts = {}

    def only_png(run, name, chart):
        charts[name] = figure_of(chart)
        charts[name].savefig(run.path(f"{name}.png"))

    monkeypatch.setattr(Run, "figure", only_png)
    monkeypatch.setattr(gallery.Asked, "readings", lambda asked, times=1: 6)
    script.make(tmp_path, short=True)
    assert set(charts) == set(claims.PANELS)
    assert [fault for chart in charts.values() for fault in faults(chart)] == []
    text = (tmp_path / "paper.md").read_text("utf-8")
    for name in claims.PANELS:
        assert f"({name}.png)" in text
    check_4a(pd.read_csv(tmp_path / "figure-4a.csv"), close=0.2)


def test_what_is_found_has_the_papers_anchors():
    """Numbers that the paper's text and figures give, and the notes beside them."""
    found = {claim.found: claims.found_of(claim) for claim in claims.CLAIMS}
    assert "nan" not in " ".join(found.values())
    for name, number in (
        ("flick_past_at", "0.697 L"), ("similar", "θ_d = 20.8° (α = 59°)"),
        ("reason", "from 13.50 to 0.21"), ("figure_4b", "0.440 → 0.367"),
        ("two_of_four", "2 balance, 2 flick past"), ("small_angle", "5% at s = 0.7 L"),
    ):  # fmt: skip
        assert number in found[name], name


def check_4a(curve, close):
    """Posteriors on the closed forms; figure 4b's numbers are in test_paper.py."""
    tapered = curve[curve["whisker"] == "tapered"]
    r, apex = tapered["radial_distance_mm"], 50 / 0.95
    np.testing.assert_allclose(tapered["closed_form_mm"], 0.1 * r * (1 - r / apex), rtol=1e-9)
    np.testing.assert_allclose(tapered["posterior_mm"], tapered["closed_form_mm"], rtol=close)
    assert (curve["unreliable"] == 0).all()


@pytest.mark.slow
def test_4a_posteriors_are_within_a_twentieth():
    """So much the bend of the closed form over one sd makes of its slope."""
    check_4a(gallery.figure_4a(gallery.Asked()).tables["figure-4a"], close=0.06)
