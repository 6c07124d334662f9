"""Observers of curved and rubbing whiskers: signals, posteriors and the model that they choose."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import simpson
from scipy.interpolate import CubicSpline
from scipy.ndimage import maximum_filter1d, minimum_filter1d
from scipy.special import expit
from short_forms import slow_but

import weberwhisk as ww
from weberwhisk import Observer, Whisker, cues, posterior
from weberwhisk.cues import (
    BalanceOfMoments,
    Compliance,
    ForceMap,
    Friction,
    Fused,
    UnknownCurvature,
)
from weberwhisk.mechanics import Profile, Spiral, profile
from weberwhisk.mechanics.curved_surface import CurvedSurface, curved_surface
from weberwhisk.receptors import GeneralisedWeber
from weberwhisk.recordings import methods_paragraph
from weberwhisk.sensitivity import prior_draws
from weberwhisk.whisker import identities, rest_shape

MU = np.arctan(0.48)


def whisker(radius_ratio=20.0, curvature=8.0):
    return Whisker(50e-3, 100e-6, 100e-6 / radius_ratio, 3e9, curvature)


def planar_signals(w, r, push, friction=0.0):
    """Straight from the planar beam, at deflections from rest."""
    bent = profile.press(w, r, profile.rest_angle(w, r) + push, friction)
    return np.stack([bent.moment, bent.axial_force, bent.transverse_force], axis=-1), bent.outcome


@pytest.mark.parametrize(
    ("radius_ratio", "curvature", "friction"),
    slow_but(
        [(5, -25, -0.45), (20, 25, 0), (1, 8, 0), (5, 25, 0.45), (20, -8, 0), (40, 25, -0.45)],
        quick=(0,),
    ),
)
def test_the_surface_is_the_planar_beam(radius_ratio, curvature, friction):
    """Signals within 2e-5 of the lateral force, the ends of its branches within 1e-4."""
    w = whisker(radius_ratio, curvature)
    surface = CurvedSurface(w, (friction, friction))
    assert surface.error < 2e-5
    r = np.linspace(0.05, 0.99, 7) * surface.reach
    end = profile.flick_past(w, r, friction)
    limit = surface.limit(r)
    assert limit == pytest.approx(end.deflection_angle - profile.rest_angle(w, r), rel=1e-4)
    beyond, outcome = surface(r, limit * 1.001)
    assert np.isnan(beyond).all()
    assert np.array_equal(outcome, end.ended_by)
    assert (surface(r, np.full(r.shape, -1e-3))[1] == ww.Outcome.NO_TOUCH).all()
    assert surface(np.array([1.01 * surface.reach]), np.array([0.1]))[1] == ww.Outcome.OUT_OF_REACH


def test_friction_and_curvature_that_are_unknown_are_axes_of_the_surface():
    w = whisker(20, 6.0)
    cue = Friction(UnknownCurvature(ForceMap(ww.cues.force_map.SIGNALS), 1.0))
    rng = np.random.default_rng(3)
    contact = np.stack(
        [
            rng.uniform(5e-3, 45e-3, 15),
            rng.uniform(0.01, 0.08, 15),
            rng.uniform(-3, 3, 15),
            rng.uniform(-MU, MU, 15),
        ],
        axis=-1,
    )
    signals, outcome = cue.signals(w, contact)
    for (r, push, offset, friction), row, held in zip(contact, signals, outcome, strict=True):
        true, kind = planar_signals(whisker(20, 6.0 + offset), r, push, friction)
        assert held == kind
        if held == 0:
            assert row == pytest.approx(true, abs=5e-5 * np.hypot(*true[1:]))


@pytest.mark.slow
def test_whiskers_of_other_stiffness_share_a_surface():
    r, push = np.array([10e-3, 30e-3]), np.array([0.1, 0.2])
    plain, other = whisker(), replace(whisker(), youngs_modulus=0.9e9)
    varying = Profile.of(plain).curved(Spiral(8.0, 300.0))
    for stiff, soft in ((plain, other), (varying, replace(varying, whisker=other))):
        tables = [curved_surface(w, (0.0, 0.0)) for w in (stiff, soft)]
        assert tables[0]._signals is tables[1]._signals
        signals = tables[1](r, push, 0.0, 0.0)[0]
        np.testing.assert_allclose(signals, 0.3 * tables[0](r, push, 0.0, 0.0)[0], rtol=1e-14)
        np.testing.assert_allclose(signals, CurvedSurface(soft)(r, push, 0.0, 0.0)[0], rtol=1e-7)


@lru_cache(maxsize=1)
def coarse(w, friction):
    """Contacts all over: see `contacts`."""
    share = np.broadcast_to(np.linspace(-14, 9, 300), (61, 300))
    return contacts(w, friction, (2e-3, 1.0), share)


def contacts(w, friction, ends, x):
    """Distances (n,), what one stands for, signals (n, m, 3) and ln areas (n, m) of contacts.

    Between fractions of the reach, closer towards the far one; x (n, m) is the logit of the share
    of the way to the largest deflection.
    """
    low, high = np.array(ends) * (1 - 1e-7) * np.max(np.hypot(*profile_tip(w)))
    left = 1 - np.linspace(0, 1, len(x))
    r, rate = high - (high - low) * left**1.5, left**0.5
    end = profile.flick_past(w, r, friction).deflection_angle - profile.rest_angle(w, r)
    push = end[:, None] * expit(x)
    signals, outcome = planar_signals(w, r[:, None], push, friction)
    held = outcome == 0
    log_area = np.log(push * expit(-x) * (x[:, 1] - x[:, 0])[:, None])
    return r, rate, np.where(held[..., None], signals, 1.0), np.where(held, log_area, -np.inf)


def brute(w, cue, noise, reading, friction=0.0):
    """Mean and sd of r by a fine sum over distance and deflection, by the planar beam itself.

    Over all contacts, then twice over where the mass is at each distance. A light push leaves a
    ridge along which the moment is known, and of the same nodes at all distances 110 by 110 missed
    its ends: they were up to 0.3 sd off.
    """
    columns = [("moment", "axial_force", "transverse_force").index(n) for n in cue.signal_names]
    r, rate, signals, area = coarse(w, friction)
    x = np.broadcast_to(np.linspace(-14, 9, 300), area.shape)
    reach = r[-1]
    for _ in range(2):
        log = noise.log_likelihood(reading, signals[..., columns]) + area
        some = log > log.max(axis=1, keepdims=True) - 28
        row = np.arange(len(r))
        low = x[row, some.argmax(axis=1)]
        high = x[row, x.shape[1] - 1 - some[:, ::-1].argmax(axis=1)]
        gap = 3 * (x[:, 1] - x[:, 0])
        # With what its neighbours have.
        low, high = minimum_filter1d(low - gap, 3), maximum_filter1d(high + gap, 3)
        of_r = np.exp(log - log.max()).sum(axis=1)
        mass = np.flatnonzero(of_r > 1e-9 * of_r.max())
        ends = r[max(mass[0] - 2, 0)] / reach, r[min(mass[-1] + 2, len(r) - 1)] / reach
        fine = reach * (ends[1] - (ends[1] - ends[0]) * (1 - np.linspace(0, 1, 101)) ** 1.5)
        low, high = np.interp(fine, r, low), np.interp(fine, r, high)
        x = low[:, None] + (high - low)[:, None] * np.linspace(0, 1, 120)
        r, rate, signals, area = contacts(w, friction, ends, x)
    # Where a signal changes sign its noise is the floor's: what has that sign is a narrow peak,
    # of which these nodes alone took a quarter (sds 0.03 off). Signals are smooth: a spline.
    t, dense = np.linspace(0, 1, x.shape[1]), np.linspace(0, 1, 16 * x.shape[1])
    assert np.isfinite(area).all()
    signals, area = (CubicSpline(t, part, axis=1)(dense) for part in (signals, area))
    log = noise.log_likelihood(reading, signals[..., columns]) + area
    density = np.exp(log - log.max()).sum(axis=1) * rate
    whole = simpson(density)
    mean = simpson(density * r) / whole
    return mean, np.sqrt(simpson(density * (r - mean) ** 2) / whole)


def profile_tip(w):
    return ww.mechanics.Profile.of(w).law.point(np.array([float(w.length)]))


SCENES = [
    (20, 25.0, 0.0, 0.05),
    pytest.param(5, -25.0, 0.0, 0.1, marks=pytest.mark.slow),
    pytest.param(20, 8.0, -0.45, 0.3, marks=pytest.mark.slow),
    pytest.param(40, -8.0, 0.45, 0.1, marks=pytest.mark.slow),
]


@pytest.mark.parametrize(("radius_ratio", "curvature", "friction", "k"), SCENES)
def test_posteriors_are_those_of_a_fine_sum_over_the_planar_beam(
    radius_ratio, curvature, friction, k
):
    compare(radius_ratio, curvature, friction, k, seed=1, count=1)


def compare(radius_ratio, curvature, friction, k, seed, count):
    w = whisker(radius_ratio, curvature)
    cue = ForceMap(("moment", "transverse_force"))
    # Signals that change sign have a floor: under Weber's law alone zero would be known exactly.
    noise = GeneralisedWeber(k, floor=[0.0, 0.01 * w.force_scale])
    observer = Observer(w, Friction(cue, friction), noise)
    rng = np.random.default_rng(seed)
    r = rng.uniform(0.2, 0.85, count) * observer.reach[1]
    push = rng.uniform(0.1, 0.8, count) * observer.space.angle_range(r)[1]
    reading = observer.read(np.stack([r, push], axis=-1), seed)
    found = posterior(observer, reading)
    for i in range(count):
        mean, sd = brute(w, cue, noise, reading[i], friction)
        assert abs(found.mean[i] - mean) < 2e-3 * sd
        assert abs(found.sd[i] - sd) < 2e-3 * sd


@pytest.mark.parametrize("k", slow_but([0.16, 0.22], quick=range(1)))
def test_heavy_contacts_whose_force_turns_its_sign_are_summed(k):
    """Above k = 1/7 no moment is too heavy for a reading."""
    w = whisker(9.6, -13.8)
    noise = GeneralisedWeber(k, floor=[0.0, 0.01 * w.force_scale])
    observer = Observer(w, Friction(ForceMap(("moment", "transverse_force")), -0.28), noise)
    reading = observer.read([[0.0125, 0.14], [0.03, 0.3]], seed=3)
    found = posterior(observer, reading)
    assert found.method == "quadrature"
    fine = posterior(observer, reading, tolerance=1e-4)
    assert fine.mean == pytest.approx(found.mean, abs=2e-3 * found.sd.min())
    assert fine.sd == pytest.approx(found.sd, rel=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(25))
def test_posteriors_over_all_curvatures_and_frictions(seed):
    rng = np.random.default_rng(seed + 100)
    ratio, curvature = np.exp(rng.uniform(np.log(5), np.log(40))), rng.uniform(-25, 25)
    friction, k = rng.uniform(-MU, MU), np.exp(rng.uniform(np.log(0.03), np.log(0.3)))
    compare(ratio, curvature, friction, k, seed, count=20)


def coverage(cue, w, noise, count, seed=5):
    """The share of 95 % intervals that hold the distance, of contacts drawn from the prior."""
    observer = Observer(w, cue, noise)
    contact = prior_draws(observer, count, seed)
    found = posterior(observer, observer.read(contact, seed + 1))
    low, high = np.moveaxis(np.asarray(found.interval(0.95)), -1, 0)
    return np.mean((low <= contact[:, 0]) & (contact[:, 0] <= high))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("curvature", "floor"), [(-20.0, 0.01), (-5.0, 0.01), (5.0, 0.01), (20.0, 0.01), (-20.0, 0.0)]
)
def test_intervals_hold_the_distance_in_2000_draws(curvature, floor):
    w = whisker(20, curvature)
    noise = GeneralisedWeber(0.1, floor=[0.0, floor * w.force_scale])
    assert 0.935 <= coverage(ForceMap(), w, noise, 2000) <= 0.965


@pytest.mark.parametrize(
    ("cue", "count", "off"),
    [
        (UnknownCurvature(Compliance(tap_angle=0.1), 2.0), 150, 0.053),
        *(
            pytest.param(cue, count, off, marks=pytest.mark.slow)
            for cue, count, off in (
                (UnknownCurvature(Compliance(tap_angle=0.1), 2.0), 2000, 0.015),
                (Friction(Compliance(tap_angle=0.1)), 2000, 0.015),
                (UnknownCurvature(ForceMap(), 2.0), 2000, 0.015),  # 110 s of CPU
                (Friction(ForceMap()), 200, 0.046),
            )
        ),
    ],
    ids=repr,
)
@pytest.mark.slow  # of coverage: `tests/atlas/test_coverage.py`
def test_intervals_hold_the_distance_where_curvature_or_friction_is_not_known(cue, count, off):
    """2000 draws to 1.5 %, fewer to three standard errors; contacts lost were drawn, too."""
    w = whisker(20, 8.0)
    floor = [0.0, 0.01 * w.force_scale][: len(cue.signal_names)]
    assert coverage(cue, w, GeneralisedWeber(0.1, floor=floor), count) == pytest.approx(
        0.95, abs=off
    )


def test_compliance_of_a_curved_whisker():
    """The lightest tap gives the slope of the moment; a heavier one what the planar beam says."""
    w = whisker(20, 12.0)
    r = np.array([10e-3, 25e-3, 40e-3])
    for tap in (0.0, 0.05):
        push = tap or 1e-5
        true = planar_signals(w, r, push)[0][:, 0] / push
        signals, _ = Compliance(tap_angle=tap).signals(w, r[:, None])
        assert signals[:, 0] == pytest.approx(true, rel=2e-5 if tap else 2e-4)
    observer = Observer(w, Fused(Compliance(), ForceMap()))
    found = posterior(observer, observer.read([25e-3, 0.1], seed=2))
    assert abs(found.mean - 25e-3) < 4 * found.sd


@pytest.mark.parametrize("effort", slow_but([1.0, None], (1,)))
def test_a_curved_whisker_balances_where_the_planar_beam_says(effort):
    """The effort is the muscle's at the balance, up to where it would peak; so with friction."""
    w, friction = whisker(20, 8.0), -0.3
    cue = BalanceOfMoments(effort=effort)
    rubbing = Friction(cue, friction)
    r = np.array([8e-3, 20e-3, 28e-3])
    push = np.array([0.05, 0.1, 0.2])
    contact = r[:, None] if effort else np.stack([r, push], axis=-1)
    for felt, psi in ((cue, 0.0), (rubbing, friction)):
        signals, outcome = felt.signals(w, contact)
        assert (outcome == 0).all()
        angle, wanted = signals[:, 0], signals[:, 1] if effort is None else effort
        moment = planar_signals(w, r, angle, psi)[0][:, 0] / w.moment_scale
        muscle = cue.curve.moment(cue.impact_angle + angle)
        assert cue.curve.gain() * moment / muscle == pytest.approx(wanted, rel=2e-5)
        edge = felt.largest_angle(felt.forward(w, contact), r)
        end = profile.flick_past(w, r, psi).deflection_angle - profile.rest_angle(w, r)
        theta = np.linspace(0.01, 0.999, 200) * np.minimum(end, cue.room)[:, None]
        moments = planar_signals(w, r[:, None], theta, psi)[0][..., 0]
        peak = (moments / cue.curve.moment(cue.impact_angle + theta)).argmax(axis=1)
        assert np.take_along_axis(theta, peak[:, None], 1)[:, 0] == pytest.approx(edge, rel=0.01)


@pytest.mark.parametrize(
    ("effort", "unknown"),
    slow_but([(1.0, False), (None, False), (1.0, True)], (1,)),
)
def test_posteriors_of_a_curved_balance_are_a_plain_sum(effort, unknown):
    """Over distances and rotations, by the planar beam's moments, with a friction known or not."""
    w = whisker(20, -10.0)
    cue = BalanceOfMoments(effort=effort)
    place = [20e-3, 0.1][: len(cue.unknowns)]
    n = 60
    r = (np.arange(n) + 0.5) / n * 35e-3
    theta = (
        (np.arange(2 * n) + 0.5) / (2 * n) * 0.9 if effort is None else np.linspace(0.01, 0.9, n)
    )
    observer = Observer(w, Friction(cue) if unknown else cue)
    reading = observer.read([*place, *[0.1] * unknown], seed=3)
    found = posterior(observer, reading)
    log = []
    for psi in MU * np.polynomial.legendre.leggauss(5)[0] if unknown else [0.0]:
        signals, outcome = planar_signals(w, r[:, None], theta, psi)
        muscle = cue.curve.moment(cue.impact_angle + theta)
        held = np.where(outcome == 0, signals[..., 0] / w.moment_scale, 0.0)
        effort_of = cue.curve.gain() * held / muscle
        peak = effort_of.argmax(axis=1)
        if effort is None:
            felt = np.stack([np.broadcast_to(theta, held.shape), effort_of], axis=-1)
            each = observer.noise.log_likelihood(reading, felt)
            log.append(np.where(np.arange(theta.size) <= peak[:, None], each, -np.inf))
            continue
        rising = [e[: k + 1] for e, k in zip(effort_of, peak, strict=True)]
        at = [np.interp(1.0, e, theta[: len(e)], right=np.nan) for e in rising]
        each = observer.noise.log_likelihood(reading, np.nan_to_num(at)[:, None])
        log.append(np.where(np.isfinite(at), each, -np.inf))
    weights = np.polynomial.legendre.leggauss(5)[1] if unknown else [1.0]
    each = [np.exp(a).reshape(n, -1).sum(axis=1) for a in log]
    density = sum(a * b for a, b in zip(weights, each, strict=True))
    mean = density @ r / density.sum()
    sd = np.sqrt(density @ (r - mean) ** 2 / density.sum())
    assert found.mean == pytest.approx(mean, abs=5e-3 * sd)
    assert found.sd == pytest.approx(sd, rel=5e-3)


def test_the_observer_chooses_its_model_and_says_why():
    """The straight elastica where curvature does not matter, the planar beam where it does."""
    bowed = Observer(whisker(20, 8.0), ForceMap())
    assert bowed.model == "profile"
    assert "elastica is off by up to" in bowed.why
    hardly = Observer(whisker(20, 0.0015), ForceMap())
    assert hardly.model == "elastica"
    assert ", 0.1 allowed" in hardly.why
    assert Observer(whisker(20, 0.0015), ForceMap(), tolerance=1e-4).model == "profile"
    plain = Observer(whisker(20, 0.0), ForceMap(), tolerance=0.2)
    assert plain.model == "elastica"
    assert plain.why.endswith(", 0.2 allowed")
    contact = [25e-3, 0.2]
    straight = Observer(whisker(20, 0.0), ForceMap())
    assert hardly.signals(contact)[0] == pytest.approx(straight.signals(contact)[0], rel=1e-9)
    # A model that was chosen is chosen anew for another whisker; one that is named stays.
    assert replace(hardly, whisker=whisker(20, 8.0)).model == "profile"
    assert Observer(whisker(20, 8.0), ForceMap(), model="profile").why == "profile was requested"
    exact = Observer(whisker(20, 8.0), ForceMap(), model="profile").signals(contact)[0]
    assert bowed.signals(contact)[0] == pytest.approx(exact, rel=2e-5)
    assert bowed == Observer(whisker(20, 8.0), ForceMap()) != hardly


def test_what_real_observers_refuse():
    several = ww.mechanics.Profile.of(whisker(20, 0.0)).curved(ww.mechanics.Spiral([1.0, 2.0]))
    with pytest.raises(ValueError, match="one whisker, got 2 values of base"):  # it was taken
        Observer(several, ForceMap())
    with pytest.raises(ValueError, match=r"up to 30°.*got 0\.6; write np\.radians\(30\) at most"):
        Friction(ForceMap(), 0.6)
    for angle in (9, -9, 3.2, 22.0):  # degrees, whose tangents as radians may be small
        with pytest.raises(ValueError, match=rf"up to 30°.*got .*np\.radians\({angle:g}\)"):
            Friction(ForceMap(), angle)
    assert Friction(ForceMap(), np.radians(9)).known == np.radians(9)
    assert Friction(ForceMap(), -np.pi / 6, coefficient=np.tan(np.pi / 6)).known == -np.pi / 6
    with pytest.raises(ValueError, match=r"at most 0\.577, .*got 0\.6"):
        Friction(ForceMap(), coefficient=0.6)
    with pytest.raises(ValueError, match="without friction whose shape is known"):
        Friction(cues.Vibration())
    with pytest.raises(ValueError, match="unknown in"):
        Friction(Friction(ForceMap()))
    with pytest.raises(ValueError, match="turn by up to"):
        Observer(whisker(20, 60.0), ForceMap())
    five = Observer(whisker(), cues.UnknownStiffness(Friction(UnknownCurvature(ForceMap(), 1.0))))
    with pytest.raises(ValueError, match="four unknowns at most, got 5"):
        posterior(five, five.read([30e-3, 0.2, 0.0, 0.0, 1.0], seed=1))


def test_a_named_whisker_carries_its_curvature_where_asked():
    """C2 is column 3 of the table, the Greek arc being 1; lengths of both sources agree there."""
    from weberwhisk.whisker import rest_shape

    straight, curved = Whisker.from_identity("C2"), Whisker.from_identity("C2", curved=True)
    assert straight.curvature == 0
    assert replace(curved, curvature=0.0) == straight
    base, rate = rest_shape("C2")
    assert (base, rate) == (7.325, 552.0)
    assert curved.curvature == pytest.approx(base + rate * curved.length / 2)
    law = ww.mechanics.Spiral(base, rate)
    assert law.turn(curved.length) == pytest.approx(curved.curvature * curved.length)
    assert rest_shape("C2", "mouse") != rest_shape("C2")
    with pytest.raises(ValueError, match="species"):
        rest_shape("C2", "cat")


@pytest.mark.slow  # of each alone: its own tests
def test_whatever_takes_a_named_whisker_as_straight_says_so():
    """Of contacts, touches, places and JNDs, where once the posterior alone did."""
    plain = Whisker.from_identity("C2")
    said = "C2 is taken as straight; its shape at rest moves r by up to"
    observer = Observer(plain, ForceMap())
    readings = observer.read([[20e-3, 0.2]] * 2, seed=1)
    assert said in repr(ww.touches(observer, readings))
    assert said in repr(ww.jnd_curve(Observer(plain, Compliance()), 20e-3, n_readings=2, seed=1))
    array = ww.ArrayObserver(ww.WhiskerArray("rat", "right").protract(0.5).only(["C2"]))
    place = array.array.whiskers["C2"].place(20e-3, 0.1)
    assert said in ww.place(array, array.read(place, seed=1)).note
    table = pd.DataFrame(readings[:1], columns=["moment", "axial_force"])
    located = ww.locate(table, plain)
    assert any("write curvature=0 of a straight whisker" in n for n in located.attrs["notes"])
    text = methods_paragraph(located)
    assert "write" not in text  # nor what to write for another model
    assert "its curvature has a normal prior of mean 0 and sd 17 /m" in text
    given = replace(plain, curvature=0.0)  # what the note says to write, and no note after it
    assert Observer(given, ForceMap()).note == ""
    assert not any("is taken as" in note for note in ww.locate(table, given).attrs["notes"])
    curved = Whisker.from_identity("C2", curved=True)
    assert not any("straight" in note for note in ww.locate(table, curved).attrs["notes"])
    for rows in (table, table * [-1, 1]):  # also where all of them are mirrored
        notes = ww.locate(rows, curved).attrs["notes"]
        assert any("C2 is taken as an arc" in note for note in notes)


def test_mice_have_whiskers_and_robots_shafts():
    """Lengths of mice are those of the table; a shaft is uniform, of handbook stiffness."""
    mouse = Whisker.from_identity("C2", species="mouse", curved=True)
    assert mouse.length == pytest.approx(13.817698e-3)
    base, rate = rest_shape("C2", "mouse")
    assert mouse.curvature == pytest.approx(base + rate * mouse.length / 2)
    rat = Whisker.from_identity("C2")
    assert mouse.base_radius / mouse.length == pytest.approx(rat.base_radius / rat.length)
    assert identities("mouse") == identities()
    shaft = Whisker.shaft(0.1, 1e-3, "steel")
    assert shaft.stiffness == pytest.approx(200e9 * np.pi / 64 * 1e-12)
    assert shaft.taper == 0
    assert Whisker.shaft(0.1, 1e-3, 200e9).stiffness == shaft.stiffness
    for refused, said in (
        (lambda: Whisker.from_identity("C2", species="cat"), "species"),
        (lambda: Whisker.from_identity("E0", species="mouse"), "whisker"),
        (lambda: Whisker.from_identity("C2", species="mouse", seed=1), "leave seed out"),
        (lambda: Whisker.shaft(0.1, 1e-3, "wood"), "material"),
    ):
        with pytest.raises(ValueError, match=said):
            refused()
