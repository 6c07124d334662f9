"""Following a contact along a sweep (§2g), against the sweeps of the planar beam (model 2)."""

from dataclasses import replace

import numpy as np
import pytest
from short_forms import slow_but

import weberwhisk as ww
from weberwhisk import Outcome
from weberwhisk.cues import ForceMap, Friction
from weberwhisk.sweeping import cylinder, follow, peg, sweep, wall

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


@pytest.mark.parametrize("steps", [15, pytest.param(24, marks=pytest.mark.slow)])
@pytest.mark.parametrize(("curvature", "friction"), slow_but([(8.0, -0.3), (-20.0, 0.0)], (0,)))
def test_curved_and_rubbing_whiskers_are_followed(curvature, friction, steps):
    """On their convex and their concave side, by the moments of the planar beam."""
    whisker = replace(W, curvature=curvature)
    body = cylinder(25e-3, 0.5 * curvature * 25e-3**2 - 8e-3, 6e-3)
    first = sweep(whisker, body, np.radians([-40.0, 80.0]), friction).first_contact
    bent = sweep(whisker, body, np.r_[first - 0.01, first + PUSH[:steps]], friction).bending
    r, moment = bent.radial_distance[1:], bent.moment[1:]
    cue = Friction(ForceMap("moment"), friction)
    off = follow(whisker, PUSH[:steps], moment, cue=cue).radial_distance - r
    assert np.all(np.abs(off) < 0.06e-3)
    assert np.all(np.abs(off)[8:] < 1e-6)
    straight = follow(W, PUSH[:steps], moment).radial_distance - r
    assert np.nanmax(np.abs(straight)) > 2e-5


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: follow(W, [0.2, 0.1], [1e-6, 1e-6]), "one row of ascending push angles"),
        (lambda: follow(W, [0.1], [1e-6, 1e-6]), "one row of ascending push angles"),
        (lambda: follow(W, [0.0], [1e-6]), "push_angle must be above zero"),
        (lambda: follow(W, [0.1], [np.nan]), "moment must be finite"),
        (lambda: follow(W, [0.1], [1e-6], start=(0.0, 0.1)), "start must be above zero"),
        (lambda: follow(W, [0.1], [1e-6], cue=Friction(ForceMap("moment"))), "without nuisance"),
        (lambda: follow(W, [0.1], [1e-6], cue=ForceMap()), "followed by its moment, .* got"),
        (lambda: follow("C2", [0.1], [1e-6]), "whisker must be a Whisker"),
    ],
)
def test_misuse_is_refused_in_one_sentence(call, words):
    with pytest.raises(ValueError, match=words) as error:
        call()
    assert "\n" not in str(error.value)
