"""Following a contact along a sweep (§2g), against the sweeps of the planar beam (model 2)."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from short_forms import short_or_full, slow_but

import weberwhisk as ww
from weberwhisk import Outcome
from weberwhisk.cues import ForceMap, Friction, UnknownCurvature
from weberwhisk.mechanics import elastica, profile
from weberwhisk.mechanics.objects import cylinder, peg, sweep, wall
from weberwhisk.receptors import Weber
from weberwhisk.sweeping import SweepFilter, follow

W = ww.Whisker(length=50e-3, base_radius=100e-6, tip_radius=5e-6)
PUSH = np.radians(np.arange(1.0, 31.0))
BODIES = {
    "peg": peg(30e-3, 0.0),
    "cylinder": cylinder(25e-3, -8e-3, 6e-3),
}


@pytest.fixture(scope="module")
def sweeps():
    """Rotation of first contact, and the contacts at push angles PUSH, of each body."""
    found = {}
    for name, body in BODIES.items():
        first = sweep(W, body, np.radians([-1.0, 30.0])).first_contact
        full = sweep(W, body, np.concatenate([[first - 0.01], first + PUSH]))
        found[name] = full.bending.radial_distance[1:], full.bending.deflection_angle[1:], (
            full.bending.moment[1:]
        ), full.contact[1:], first  # fmt: skip
    return found


@pytest.mark.parametrize("name", BODIES)
def test_exact_moments_give_the_contact_and_the_contour(sweeps, name):
    r, theta, moment, contact, first = sweeps[name]
    track = follow(W, PUSH, moment)
    assert np.all(track.outcome == Outcome.HELD)
    # The first step is taken as one without slip; what that misses is second order.
    assert np.all(np.abs(track.radial_distance - r) < 0.06e-3)
    assert np.all(np.abs(track.radial_distance - r)[5:] < 2e-6)
    assert np.all(np.abs(track.deflection_angle - theta)[5:] < 5e-5)
    turn = np.array([[np.cos(first), -np.sin(first)], [np.sin(first), np.cos(first)]])
    assert np.allclose(track.path[5:], contact[5:] @ turn.T, atol=4e-6)


def test_a_wall_is_followed_from_where_its_flank_touches():
    body = wall(0.0, -10e-3, 0.0)
    at = np.radians(np.arange(11.0, 46.0))
    full = sweep(W, body, at)
    flank = full.bending.held & ~full.tip
    r, theta = full.bending.radial_distance[flank], full.bending.deflection_angle[flank]
    push = at[flank] - at[flank][0]
    track = follow(W, push[1:], full.bending.moment[flank][1:], start=(r[0], theta[0]))
    assert np.all(np.abs(track.radial_distance - r[1:]) < 0.05e-3)
    # The recovered contour is a straight line, across 20 mm of it: here with the wall's own slope.
    assert np.ptp(r) > 15e-3
    along, over = np.moveaxis(track.path, -1, 0)
    angle = -at[flank][0]
    height = along * np.sin(angle) + over * np.cos(angle)
    assert np.allclose(height, -10e-3, atol=0.05e-3)
    # From first touch on, the tip's, no contact of the flank has such moments.
    touched = full.bending.held
    lost = follow(W, at[touched] - full.first_contact, full.bending.moment[touched])
    assert np.all(lost.outcome == Outcome.OUT_OF_REACH)
    assert np.isnan(lost.radial_distance).all()


@pytest.mark.parametrize("name", BODIES)
def test_the_filter_finds_the_contact_within_its_own_uncertainty(sweeps, name):
    r, theta, moment, contact, first = sweeps[name]
    readings = Weber(0.1).sample(moment[:, None], seed=1)[:, 0]
    track = SweepFilter(W, Weber(0.1), particles=2000)(PUSH, readings, seed=2)
    assert np.all(track.outcome == Outcome.HELD)
    assert np.all(np.abs(track.radial_distance - r) < 4 * track.distance_sd)
    assert np.all(np.abs(track.deflection_angle - theta) < 4 * track.angle_sd)
    turn = np.array([[np.cos(first), -np.sin(first)], [np.sin(first), np.cos(first)]])
    assert np.all(np.abs(track.path - contact @ turn.T) < 4.5 * track.path_sd)
    low, high = track.interval.T
    assert np.mean((low <= r) & (r <= high)) > 0.7
    # Thirty readings tell more than one, though what is asked of them moves.
    assert track.distance_sd[10] < track.distance_sd[0]


def swept_wall(depth):
    """Push angles, distances and moments of a wall at this distance from the base."""
    body = wall(0.0, -depth, 0.0)
    first = sweep(W, body, np.radians([-1.0, 80.0])).first_contact
    full = sweep(W, body, np.concatenate([[first - 0.01], first + PUSH]))
    held = full.bending.held
    return PUSH[held[1:]], full.bending.radial_distance[held], full.bending.moment[held]


@pytest.mark.parametrize(
    "depth",
    [pytest.param(d, marks=[pytest.mark.slow] * (d != 5e-3)) for d in (2.5e-3, 5e-3, 10e-3)],
)
def test_walls_that_the_tip_meets_are_followed(depth):
    """Their contacts run inwards at 0.3 L/depth per rad at first, and ever slower."""
    push, r, moment = swept_wall(depth)
    off = []
    for s in range(1 if depth == 5e-3 else 2):
        felt = Weber(0.1).sample(moment[:, None], 100 + s)[:, 0]
        track = SweepFilter(W, Weber(0.1))(push, felt, seed=s)
        off.append((track.radial_distance - r) / track.distance_sd)
        # But at the first steps, at which the tip itself touches.
        assert np.isin(track.outcome[:3], [Outcome.HELD, Outcome.AT_LIMIT]).all()
        assert np.all(track.outcome[3:] == Outcome.HELD)
    assert np.sqrt(np.nanmean(np.square(off))) < 1.3
    assert np.nanmax(np.abs(off)) < 4


def test_on_a_peg_the_filter_is_the_product_of_the_likelihoods():
    readings = Weber(0.1).sample(elastica.press(W, 30e-3, PUSH[::3]).moment[:, None], seed=3)[:, 0]
    r = np.linspace(20e-3, 40e-3, 4001)
    moments = elastica.press(W, r[:, None], PUSH[::3])
    log = np.where(moments.held, stats.norm.logpdf(readings, moments.moment, 0.1 * moments.moment),
                   -np.inf).sum(axis=1)  # fmt: skip
    weight = np.exp(log - log.max())
    mean = r @ weight / weight.sum()
    sd = np.sqrt((r - mean) ** 2 @ weight / weight.sum())
    filtered = SweepFilter(W, slip_rate=0.0, slip_change=0.0, particles=40_000)
    track = filtered(PUSH[::3], readings, seed=4)
    # Some 700 of 40 000 particles are within the posterior: their mean is good to 0.04 sd.
    assert track.radial_distance[-1] == pytest.approx(mean, abs=0.2 * sd)
    assert track.distance_sd[-1] == pytest.approx(sd, rel=0.15)
    assert track.angle_sd[-1] < 1e-12


@pytest.mark.parametrize(
    ("curvature", "friction"), slow_but([(0.0, 0.0), (15.0, -0.3), (-15.0, 0.0)], [0])
)
@short_or_full("objects", 36, 60)
def test_the_filter_is_calibrated_on_objects_of_its_own_making(curvature, friction, objects):
    """Truths drawn from its prior of objects: E[((r − mean)/sd)²] = 1 at every step."""
    push = np.radians(np.arange(2.0, 14.0, 2.0))
    whisker = replace(W, curvature=curvature)
    prior = stats.uniform(2e-3, 44e-3) if curvature < 0 else None  # tips that go further out
    cue = Friction(ForceMap("moment"), friction)
    made = SweepFilter(whisker, Weber(0.1), particles=1500, cue=cue, prior=prior)
    rng = np.random.default_rng(5)
    states, moments, places = made.start(rng), [], []
    states = rng.permutation(states)[:400]
    for step in np.diff(push, prepend=0.0):
        states = made.move(states, step, rng)
        inside = np.clip(np.nan_to_num(states[:, 0]), 1e-4, made.observer.reach[1] * (1 - 1e-12))
        pushed = states[:, 1] - profile.rest_angle(whisker, inside)
        at = profile.rest_angle(whisker, inside) + np.maximum(np.nan_to_num(pushed), 1e-9)
        bent = profile.press(whisker, inside, at, friction)
        good = bent.held & (pushed > 0) & (states[:, 0] == inside)
        moments.append(np.where(good, bent.moment, np.nan))
        places.append(states[:, 0])
    moments, places = np.array(moments).T, np.array(places).T
    kept = np.flatnonzero(np.isfinite(moments).all(axis=1))[:objects]
    square = []
    for row in kept:
        track = made(push, Weber(0.1).sample(moments[row][:, None], rng)[:, 0], rng)
        square.append(((track.radial_distance - places[row]) / track.distance_sd) ** 2)
    square = np.array(square)
    # Not where the filter says that it does not know: that depends on the readings alone.
    count = np.isfinite(square).sum(axis=0)
    assert np.all(count > 2 / 3 * objects)
    error = np.nanstd(square, axis=0, ddof=1) / np.sqrt(count)
    assert np.all(np.abs(np.nanmean(square, axis=0) - 1) < 4 * error)


@short_or_full("steps", 15, 24)
@pytest.mark.parametrize(("curvature", "friction"), [(8.0, -0.3), (-20.0, 0.0)])
def test_curved_and_rubbing_whiskers_are_followed(curvature, friction, steps):
    """On their convex and their concave side, by the moments of the planar beam."""
    whisker = replace(W, curvature=curvature)
    body = cylinder(25e-3, 0.5 * curvature * 25e-3**2 - 8e-3, 6e-3)
    first = sweep(whisker, body, np.radians([-40.0, 80.0]), friction).first_contact
    push = PUSH[:steps:3]
    bent = sweep(whisker, body, np.r_[first - 0.01, first + PUSH[:steps]], friction).bending
    r, moment = bent.radial_distance[1:], bent.moment[1:]
    cue = Friction(ForceMap("moment"), friction)
    off = follow(whisker, PUSH[:steps], moment, cue=cue).radial_distance - r
    assert np.all(np.abs(off) < 0.06e-3)
    assert np.all(np.abs(off)[8:] < 1e-6)
    prior = stats.uniform(2e-3, 44e-3)
    made = SweepFilter(whisker, Weber(0.1), cue=cue, prior=prior, particles=1000)
    track = made(push, Weber(0.1).sample(moment[::3, None], 10)[:, 0], seed=1)
    assert np.all(np.abs(track.radial_distance - r[::3]) < 4 * track.distance_sd)
    straight = follow(W, PUSH[:steps], moment).radial_distance - r
    assert np.nanmax(np.abs(straight)) > 2e-5


def test_an_unknown_friction_is_carried_along():
    """On a peg the product of the likelihoods, summed over friction, by the planar beam itself."""
    whisker, push = replace(W, curvature=8.0), PUSH[3:22:6]
    cue = Friction(ForceMap("moment"), coefficient=0.4)
    largest, (x, mass) = np.arctan(0.4), np.polynomial.legendre.leggauss(5)
    r = np.linspace(22e-3, 40e-3, 60)
    at = profile.rest_angle(whisker, r)[:, None, None] + push
    bent = profile.press(whisker, r[:, None, None], at, largest * x[:, None], tolerance=1e-6)
    truth = profile.press(whisker, 30e-3, profile.rest_angle(whisker, 30e-3) + push, 0.2).moment
    reading = Weber(0.1).sample(truth[:, None], seed=3)[:, 0]
    log = stats.norm.logpdf(reading, bent.moment, 0.1 * bent.moment)
    weight = np.exp(np.where(bent.held, log, -np.inf).sum(axis=2)) @ mass
    mean = r @ weight / weight.sum()
    sd = np.sqrt((r - mean) ** 2 @ weight / weight.sum())
    made = SweepFilter(whisker, slip_rate=0.0, slip_change=0.0, particles=40_000, cue=cue)
    track = made(push, reading, seed=4)
    assert track.radial_distance[-1] == pytest.approx(mean, abs=0.2 * sd)
    assert track.distance_sd[-1] == pytest.approx(sd, rel=0.15)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: follow(W, [0.2, 0.1], [1e-6, 1e-6]), "one row of ascending push angles"),
        (lambda: follow(W, [0.1], [1e-6, 1e-6]), "one row of ascending push angles"),
        (lambda: follow(W, [0.0], [1e-6]), "push_angle must be above zero"),
        (lambda: follow(W, [0.1], [np.nan]), "moment must be finite"),
        (lambda: follow(W, [0.1], [1e-6], start=(0.0, 0.1)), "start must be above zero"),
        (lambda: SweepFilter(W, particles=5), "100 particles or more"),
        (lambda: SweepFilter(W, slip_rate=-1), "slip_rate must not be negative"),
        (lambda: SweepFilter(replace(W, curvature=-8.0)), "further out than it reaches at rest"),
        (lambda: SweepFilter(W, cue=UnknownCurvature(ForceMap("moment"), 1.0)), "curvature unknow"),
        (lambda: SweepFilter(W, cue=ForceMap()), "followed by its moment, got"),
        (lambda: follow(W, [0.1], [1e-6], cue=Friction(ForceMap("moment"))), "else being known"),
        (lambda: follow("C2", [0.1], [1e-6]), "whisker must be a Whisker"),
    ],
)
def test_misuse_is_refused_in_one_sentence(call, words):
    with pytest.raises(ValueError, match=words) as error:
        call()
    assert "\n" not in str(error.value)
