"""The table of six signals in space: beside the rod, a referee, the plane and the straight."""

from functools import cache

import numpy as np
import pytest
from analysis_scripts import load
from short_forms import slow_but

import weberwhisk as ww
from weberwhisk import Outcome
from weberwhisk.mechanics.curved_surface import CurvedSurface, pressed
from weberwhisk.mechanics.elastica import Surface

BEND = 8.0
W = ww.Whisker(50e-3, 100e-6, 5e-6, 3e9, curvature=BEND)


@cache
def in_space(friction):
    return CurvedSurface(W, (friction, friction), in_space=True)


def relative(found, exact):
    """Errors over the size of force and of moment."""
    off = found - exact
    size = [np.linalg.norm(exact[:, part], axis=1) for part in (slice(0, 3), slice(3, 6))]
    return np.abs(off) / np.repeat(np.stack(size, axis=1), 3, axis=1)


@pytest.mark.parametrize("friction", slow_but([0.0, -0.3, 0.3], (1,)))
def test_signals_and_ends_are_those_of_the_rod_itself(friction):
    surface = in_space(friction)
    assert surface.error < 2e-5
    rng = np.random.default_rng(8)
    r = surface.reach * rng.uniform(0.02, 0.995, 12)
    azimuth = rng.uniform(-np.pi, np.pi, 12)
    last = surface.limit(r, azimuth)
    push = last * np.append(rng.uniform(0.01, 0.99, 6), [0.999] * 6)
    found, outcome = surface(r, push, azimuth)
    exact, held = pressed(W, r, push, azimuth, friction=friction)
    assert (outcome == Outcome.HELD).all()
    assert (held == Outcome.HELD).all()
    # Where it turns its sign, a moment is next to nothing beside its error.
    assert np.max(relative(found, exact)) < (1e-3 if friction else 5e-5)
    assert np.median(relative(found, exact)) < 2e-6
    # Just beyond, the whisker is lost, by either and for the same reason.
    found, outcome = surface(r, 1.001 * last, azimuth)
    assert np.isnan(found).all()
    lost = pressed(W, r, 1.001 * last, azimuth, friction=friction)[1]
    lost[lost == Outcome.STUCK] = Outcome.FLICKED_PAST
    assert np.array_equal(outcome, lost)
    assert {Outcome.FLICKED_PAST, Outcome.SLIPPED_OFF_TIP} == set(outcome.tolist())


@pytest.mark.parametrize("friction", slow_but([0.0, -0.3], (1,)))
def test_signals_are_those_of_the_referee_from_the_base_outwards(friction):
    r, azimuth = np.array([15e-3, 30e-3, 40e-3]), np.array([0.7, 2.0, 3.0])
    push, one = np.array([0.6, 0.3, 0.2]), np.ones(3)
    beams = load("reference_beam").Beams(
        50e-3 * one, 1e-4 * one, 5e-6 * one, 3e9 * one, BEND * one, friction * one
    )
    rods = load("reference_rod").Rods.pushed(beams, r, 0 * r, azimuth)
    way = rods.walk(push * 1.05)
    force = rods.polish(push, *rods.at(way["trail"], push)[:2])["force"]
    moment = np.cross(rods.point(push), force, axis=0)
    exact = np.concatenate([[-1], [1], [1]]) * force.T
    found, _ = in_space(friction)(r, push, azimuth)
    assert np.max(relative(found, np.concatenate([exact, moment.T], axis=1))) < 5e-5


@pytest.mark.parametrize(
    ("azimuth", "sign", "friction"),
    slow_but([(np.pi, -1, 0.0), (0.0, 1, 0.0), (np.pi, -1, 0.3), (0.0, 1, -0.3)], quick=range(1)),
)
@pytest.mark.slow  # of the rod: above
def test_in_the_plane_of_curvature_it_is_the_planar_beam(azimuth, sign, friction):
    """Pushed against its curvature it is the whisker of the other sign, upside down."""
    surface = in_space(friction)
    mirrored = ww.Whisker(50e-3, 100e-6, 5e-6, 3e9, curvature=sign * BEND)
    plane = CurvedSurface(mirrored, (friction, friction))
    r = np.linspace(0.05, 0.995, 24) * surface.reach
    last = surface.limit(r, np.full(r.shape, azimuth))
    assert last == pytest.approx(plane.limit(r), rel=1e-5)
    push = last * np.linspace(0.02, 0.98, 24)
    found, _ = surface(r, push, np.full(r.shape, azimuth))
    moment, axial, transverse = plane(r, push)[0].T
    exact = np.stack([axial, sign * transverse, 0 * r, 0 * r, 0 * r, sign * moment], axis=1)
    assert np.max(relative(found, exact)) < 5e-5


@pytest.mark.slow  # of the rod: above
def test_of_a_whisker_that_is_all_but_straight_it_is_the_elastica():
    w = ww.Whisker(50e-3, 100e-6, 5e-6, 3e9, curvature=1e-9)
    surface, straight = CurvedSurface(w, in_space=True), Surface(w)
    azimuth = np.linspace(-3, 3, 12)
    r = np.linspace(0.05, 0.99, 12) * 50e-3
    assert surface.limit(r, azimuth) == pytest.approx(straight.limit(r), rel=1e-6)
    push = 0.7 * straight.limit(r)
    moment, axial, transverse = straight(r, push)[0].T
    y, z = np.cos(azimuth), np.sin(azimuth)
    exact = [axial, transverse * y, transverse * z, 0 * r, -moment * z, moment * y]
    assert np.max(relative(surface(r, push, azimuth)[0], np.stack(exact, axis=1))) < 2e-5


def test_what_is_no_contact_has_an_outcome_and_no_signals():
    r = np.array([20e-3, 20e-3, 60e-3, 0.0, np.nan, 20e-3])
    push = np.array([-0.1, 3.0, 0.1, 0.1, 0.1, 0.1])
    azimuth = np.array([1.0, 1.0, 1.0, 1.0, 1.0, np.nan])
    for signals, outcome in (
        in_space(0.0)(r, push, azimuth),
        pressed(W, r, push, azimuth),
    ):
        assert np.isnan(signals).all()
        assert outcome.tolist() == [
            Outcome.NO_TOUCH, Outcome.FLICKED_PAST, *[Outcome.OUT_OF_REACH] * 4,
        ]  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(
    ("radius_ratio", "curvature", "friction"),
    [(20, 25, 0), (5, -25, 0), (40, 25, 0), (100, 8, 0), (20, 25, -0.45), (5, 25, 0.45),
     (5, -25, 0.45), (40, -25, 0.45)],
)  # fmt: skip
def test_tables_of_strongly_curved_whiskers_are_the_rod(radius_ratio, curvature, friction):
    w = ww.Whisker(50e-3, 100e-6, 100e-6 / radius_ratio, 3e9, curvature=curvature)
    assert CurvedSurface(w, (friction, friction), in_space=True).error < 5e-5
