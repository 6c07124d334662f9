"""A surface of JNDs is the curves that it is made of."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import weberwhisk as ww
from weberwhisk import surveys
from weberwhisk.cues import ForceMap, Friction
from weberwhisk.inference import default_noise
from weberwhisk.mechanics import profile

W = ww.Whisker(50e-3, 100e-6, 5e-6)


@pytest.mark.parametrize("angles", [None, [0.05, 0.1]])
def test_rows_are_those_of_jnd_curve(angles):
    k, r = [0.05, 0.1], [15e-3, 35e-3]
    table = ww.jnd_sweep(W, k, r, angles, n_readings=4, seed=3)
    places = [(fraction, angle) for fraction in k for angle in angles or [None]]
    seeds = np.random.SeedSequence(3).spawn(len(places))
    parts = []
    for (fraction, angle), seed in zip(places, seeds, strict=True):
        cue = ww.cues.Compliance() if angle is None else ww.cues.ForceMap()
        observer = ww.Observer(W, cue, ww.receptors.Weber(fraction))
        curve = ww.jnd_curve(observer, r, angle, n_readings=4, seed=seed)
        parts.append(curve.table.reset_index())
        parts[-1].insert(0, "weber_fraction", fraction)
    pd.testing.assert_frame_equal(table, pd.concat(parts, ignore_index=True), check_exact=True)


def test_several_whiskers_are_refused():
    several = ww.Whisker([50e-3, 40e-3], 100e-6, 5e-6)
    with pytest.raises(ValueError, match="A sweep has one whisker"):
        ww.jnd_sweep(several, 0.1, 10e-3, seed=1)


def test_the_surface_by_posteriors_ends_at_the_fold_and_falls_to_the_base():
    table = surveys.posterior_surface(4, 20)
    r, angle = table["radial_distance_mm"] * 1e-3, np.radians(table["deflection_angle_deg"])
    places = np.repeat(np.linspace(0.05, 0.97, 4), 4)
    assert list(r / surveys.WHISKER.length) == pytest.approx(places)
    share = angle / ww.flick_past(surveys.WHISKER, r).deflection_angle
    assert list(share) == pytest.approx(np.tile(np.linspace(0.005, 0.98, 4), 4))
    bent = ww.press(surveys.WHISKER, r, angle)
    np.testing.assert_allclose(np.radians(table["contact_angle_deg"]), bent.contact_angle)
    # To first order the JND is largest at the base; posteriors know that nothing is nearer.
    light = table[1::4]  # a third of the way to the fold
    assert light["propagation_mm"].is_monotonic_decreasing
    assert light["posterior_mm"].iloc[0] < 0.6 * light["posterior_mm"].iloc[1]
    assert (table["jnd_mm"] == table["posterior_mm"]).all()


def test_jnds_of_curved_and_rubbing_whiskers_are_those_of_the_planar_beam():
    """Linear JNDs with slopes by differences of the beam's signals.

    Axial forces that change sign have a floor: on the concave side, and where the whisker rubs.
    """
    table = surveys.curvatures(2, 2)
    step, k = 1e-4, surveys.K
    for row in table.to_dict("records"):
        whisker = replace(surveys.WHISKER, curvature=row["curvature_per_m"])
        contact = np.array([row["radial_distance_mm"] * 1e-3, surveys.ANGLE])
        near = contact * (1 + step * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]]))
        psi = np.radians(row["friction_angle_deg"])
        r, push = near.T  # from where the whisker is at rest
        bent = profile.press(whisker, r, profile.rest_angle(whisker, r) + push, psi)
        if row["outcome"].startswith("held"):
            signals = np.array([bent.moment, bent.axial_force])
            cue = Friction(ForceMap(), psi) if psi else ForceMap()
            sd = default_noise(whisker, cue, k).sd(signals.mean(axis=1))
            slope = (signals[:, ::2] - signals[:, 1::2]) / (2 * step * contact) / sd[:, None]
            jnd = np.sqrt(np.linalg.inv(slope.T @ slope)[0, 0])
            assert row["propagation_mm"] == pytest.approx(1e3 * jnd, rel=2e-3)
    assert list(table.groupby("whisker")["outcome"].first().str[:4]) == ["held"] * 4
    assert set(zip(table["whisker"], table["model"], strict=True)) == {
        ("concave", "profile"), ("straight", "elastica"), ("convex", "profile"),
        ("rubbing", "profile"),
    }  # fmt: skip


def test_the_cost_of_a_straight_model_is_what_a_posterior_says():
    table = surveys.taken_as_straight("A").set_index("identity")
    assert list(table.index) == ["A0", "A1", "A2", "A3", "A4"]
    observer = ww.Observer(ww.Whisker.from_identity("A3"), ww.cues.ForceMap())
    found = ww.posterior(observer, observer.read([6e-3, 0.1], seed=1))
    assert f"by up to {table['bias_jnd']['A3']:.2g} JND" in found.summary()["note"].iloc[0]
