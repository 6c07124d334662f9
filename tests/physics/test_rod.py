"""The rod against elastica and planar beam, and SciPy's Cosserat equations from the base."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from short_forms import slow_but

from weberwhisk.mechanics import elastica, profile, rod
from weberwhisk.mechanics.contact import Outcome
from weberwhisk.mechanics.shape import Parabola, Profile, Spiral
from weberwhisk.whisker import Whisker

STRAIGHT = Whisker(50e-3, 100e-6, 5e-6, 3e9)
CURVED = Whisker(50e-3, 100e-6, 5e-6, 3e9, curvature=-8.0)


@pytest.mark.parametrize("psi", [0.0, 0.25, -0.25])
@pytest.mark.parametrize("law", [Spiral(-8.0), Spiral(5.0, 200.0), Parabola(-9.0)])
def test_in_its_plane_it_is_rung_2(law, psi):
    p = Profile.of(STRAIGHT).curved(law)
    arc, force = np.array([10e-3, 25e-3, 40e-3]), np.array([3e-4, -6e-5, 1e-5])
    space, plane = rod.bend(p, arc, force, 0.0, psi), profile.bend(p, arc, force, psi)
    scale = np.abs(force)
    assert np.all(plane.held)
    np.testing.assert_allclose(space.moment[:, 2], plane.moment, rtol=1e-9)
    np.testing.assert_allclose((space.axial_force - plane.axial_force) / scale, 0, atol=1e-9)
    np.testing.assert_allclose((space.force[:, 1] - plane.transverse_force) / scale, 0, atol=1e-9)
    np.testing.assert_allclose(space.radial_distance, plane.radial_distance, rtol=1e-9)
    np.testing.assert_array_equal(space.moment[:, :2], 0)
    np.testing.assert_array_equal(space.contact[:, 2], 0)


def test_a_straight_whisker_bends_in_a_turned_plane_as_rung_1():
    rng = np.random.default_rng(3)
    n = 12
    r, theta = rng.uniform(0.1, 0.8, n) * 50e-3, rng.uniform(0.05, 1.0, n)
    azimuth = rng.uniform(-np.pi, np.pi, n)
    point = r[:, None] * np.stack(
        [np.cos(theta), np.sin(theta) * np.cos(azimuth), np.sin(theta) * np.sin(azimuth)], axis=-1
    )
    got, exact = rod.press(STRAIGHT, point), elastica.press(STRAIGHT, r, theta)
    assert set(exact.outcome) == {Outcome.HELD, Outcome.FLICKED_PAST}
    np.testing.assert_array_equal(got.outcome, exact.outcome)
    np.testing.assert_allclose(got.axial_force, exact.axial_force, rtol=1e-9)
    y, z = np.cos(azimuth), np.sin(azimuth)
    np.testing.assert_allclose(got.force[:, 1], exact.transverse_force * y, rtol=1e-9)
    np.testing.assert_allclose(got.force[:, 2], exact.transverse_force * z, rtol=1e-9)
    np.testing.assert_allclose(got.moment[:, 2], exact.moment * y, rtol=1e-9)
    np.testing.assert_allclose(got.moment[:, 1], -exact.moment * z, rtol=1e-9)
    np.testing.assert_allclose(got.moment[exact.held, 0], 0, atol=1e-9 * np.nanmax(exact.moment))


def cosserat(whisker, b, plane=0.0, nu=rod.POISSON_RATIO):
    """From the base outwards, with force and moment as states and a quaternion for the frame."""
    kappa, tilt = whisker.curvature, (-np.sin(plane), np.cos(plane))

    def frame(q):
        w, x, y, z = q / np.linalg.norm(q)
        turn = np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ]
        )
        return turn[:, 0], turn[:, 1], turn[:, 2]  # tangent, d1, d2 in the base frame

    def slope(s, state):
        q, m, n = state[:4], state[7:10], state[10:13]
        t, d1, d2 = frame(q)
        ei = whisker.stiffness * (1 - s / whisker.apex_distance) ** 4
        omega = (m @ d1 / ei + kappa * tilt[0]) * d1 + (m @ d2 / ei + kappa * tilt[1]) * d2
        omega = omega + (1 + nu) * (m @ t) / ei * t
        spin = 0.5 * np.array([-omega @ q[1:], *(q[0] * omega + np.cross(omega, q[1:]))])
        return np.concatenate([spin, t, -np.cross(t, n), np.zeros(3)])

    start = np.concatenate([[1, 0, 0, 0], np.zeros(3), b.moment, b.force])
    solved = solve_ivp(
        slope,
        (0, b.arc_length),
        start,
        "DOP853",
        rtol=1e-12,
        atol=1e-13 * np.array([1] * 4 + [0.05] * 3 + [1e-6] * 3 + [1e-4] * 3),
    )
    return solved.y, frame(solved.y[:4, -1])


@pytest.mark.parametrize("plane", [0.0, 0.7])
@pytest.mark.parametrize("psi", [0.0, 0.3])
def test_force_and_moment_balance_along_the_arc(plane, psi):
    """From the base, the Cosserat equations with these six signals end moment-free there."""
    b = rod.bend(CURVED, 30e-3, 8e-5, np.radians(65), psi, plane=plane)
    y, (t, d1, d2) = cosserat(CURVED, b, plane)
    np.testing.assert_allclose(y[4:7, -1], b.contact, atol=1e-9 * 0.03)
    np.testing.assert_allclose(y[7:10, -1], 0, atol=1e-9 * np.abs(b.moment).max())
    np.testing.assert_allclose(t, b.tangent, atol=1e-9)
    # The moment anywhere is that of the contact force about there.
    about = np.cross(b.contact[:, None] - y[4:7], b.force[:, None], axis=0)
    np.testing.assert_allclose(y[7:10], about, atol=1e-9 * np.abs(b.moment).max())
    # The force leans on the whisker as asked.
    assert b.force @ t == pytest.approx(-b.magnitude * np.sin(psi), abs=1e-9 * b.magnitude)
    assert np.arctan2(b.force @ d2, b.force @ d1) == pytest.approx(np.radians(65), abs=1e-8)
    assert abs(b.moment[0]) > 0.02 * np.abs(b.moment).max()  # torsion is really there


def test_press_inverts_bend_and_ends_as_rung_2_does():
    b = rod.bend(CURVED, 30e-3, 6e-5, np.radians([10, 50, 90, 140]), 0.1)
    again = rod.press(CURVED, b.contact, 0.1)
    assert np.all(again.outcome == Outcome.HELD)
    np.testing.assert_allclose(again.magnitude, b.magnitude, rtol=1e-7)
    np.testing.assert_allclose(again.direction, b.direction, atol=1e-7)
    np.testing.assert_allclose(again.contact, b.contact, atol=1e-10)
    r = np.array([25e-3, 25e-3, 49.7e-3, 60e-3])
    theta = profile.flick_past(CURVED, r[0]).deflection_angle + np.array([-0.01, 0.01, 0.0, 0.0])
    point = r[:, None] * np.stack([np.cos(theta), np.sin(theta), 0 * theta], axis=-1)
    space, plane = rod.press(CURVED, point), profile.press(CURVED, r, theta)
    np.testing.assert_array_equal(space.outcome, plane.outcome)
    np.testing.assert_array_equal(np.isnan(space.moment[:, 0]), plane.outcome != 0)


def flat(r, theta):
    return np.stack([r * np.cos(theta), r * np.sin(theta), 0 * (r * theta)], axis=-1)


def test_contact_at_the_very_base():
    """Lengths vanish and forces grow without bound: every size must be relative."""
    r = 1e-9 * 50e-3
    b = rod.press(STRAIGHT, flat(r, 0.3))
    assert b.outcome is Outcome.HELD
    assert b.magnitude == pytest.approx(profile.press(STRAIGHT, r, 0.3).force, rel=1e-9)


@pytest.mark.parametrize(
    ("curvature", "share"),
    slow_but(itertools.product([0.0, 5.0], [0.0, 1e-3, 0.5, 2.0]), (7,)),
)
def test_contact_at_the_very_tip(curvature, share):
    """No arc lies beyond, so that derivatives exist on one side only; a hair further it slips."""
    w = Whisker(50e-3, 100e-6, 100e-6, 3e9, curvature=curvature)
    b = profile.bend(w, 50e-3, share * w.force_scale)
    r, theta = b.radial_distance, b.deflection_angle
    at, beyond = rod.press(w, flat(r, theta)), rod.press(w, flat(r, theta + 1e-3))
    assert at.outcome is Outcome.HELD
    assert at.magnitude == pytest.approx(share * w.force_scale, rel=1e-8, abs=1e-12)
    assert at.arc_length == pytest.approx(50e-3, rel=1e-8)
    assert beyond.outcome is Outcome.SLIPPED_OFF_TIP
    assert np.all(np.isnan(beyond.moment))


def test_radius_ratio_to_one_and_to_infinity():
    """ln of the ratio sets the steps: 0/0 for a cylinder, without bound for a cone."""
    tips = 100e-6 * np.array([1, 1 - 1e-15, 1 - 1e-9, 1e-6, 1e-12, 0])
    w = Whisker(50e-3, 100e-6, tips, 3e9, curvature=-8.0)
    theta = profile.rest_angle(w, 30e-3) + 0.2
    space, plane = rod.press(w, flat(30e-3, theta)), profile.press(w, 30e-3, theta)
    assert np.all(space.outcome == Outcome.HELD)
    np.testing.assert_allclose(space.moment[:, 2], plane.moment, rtol=1e-7)
    np.testing.assert_allclose(space.moment[:3, 2], space.moment[0, 2], rtol=1e-8)
    np.testing.assert_allclose(space.moment[3:, 2], space.moment[-1, 2], rtol=1e-5)


@pytest.mark.slow
def test_the_fold_itself():
    """Held just before it, past it just after; nearer, a walk by 1e-6 rad cannot tell."""
    end = profile.flick_past(CURVED, 25e-3).deflection_angle
    near = rod.press(CURVED, flat(25e-3, end + np.array([-1e-5, 1e-5])))
    np.testing.assert_array_equal(near.outcome, [Outcome.HELD, Outcome.FLICKED_PAST])


def test_friction_at_which_nothing_slides():
    """No sliding contact gets there, but one without friction does: friction holds it."""
    r, theta = 44e-3, np.radians(9)
    got = rod.press(STRAIGHT, flat(r, theta), np.arctan([0.1, 20.0]))
    np.testing.assert_array_equal(got.outcome, [Outcome.HELD, Outcome.STUCK])
    np.testing.assert_array_equal(
        got.outcome, profile.press(STRAIGHT, r, theta, np.arctan([0.1, 20.0])).outcome
    )
    assert np.all(np.isnan(got.moment[1]))


@pytest.mark.slow  # of the planar beam: test_profile.py
@pytest.mark.parametrize("tolerance", [1e-6, pytest.param(1e-9, marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    "shares",
    [(1e-3, 0.9, 0.99999), pytest.param((1e-3, 0.3, 0.9, 0.999, 0.99999), marks=pytest.mark.slow)],
)
def test_the_error_is_an_upper_estimate_up_to_the_fold(tolerance, shares):
    """Near the fold a contact a little off its place makes signals that are far off."""
    r = np.array([10e-3, 25e-3, 38e-3])[:, None]
    rest = profile.rest_angle(CURVED, r)
    end = profile.flick_past(CURVED, r).deflection_angle
    theta = rest + np.array(shares) * (end - rest)
    true = profile.press(CURVED, r, theta, tolerance=1e-13)
    point = r[..., None] * np.stack([np.cos(theta), np.sin(theta), 0 * theta], axis=-1)
    got = rod.press(CURVED, point, tolerance=tolerance)
    off = np.max(
        [
            np.abs(got.moment[..., 2] / true.moment - 1),
            np.abs(got.axial_force / true.axial_force - 1),
            np.abs(got.force[..., 1] / true.transverse_force - 1),
        ],
        axis=0,
    )
    assert np.all(off <= got.error + true.error)
    assert np.all(got.error < 1e3 * tolerance)
    # Out of the plane, against itself.
    height = np.array([-0.3, 0.1, 0.4])[:, None]
    point = r[..., None] * np.stack(
        [
            np.cos(height) * np.cos(theta),
            np.cos(height) * np.sin(theta),
            np.sin(height) + 0 * theta,
        ],
        axis=-1,
    )
    got, true = (rod.press(CURVED, point, tolerance=t) for t in (tolerance, 1e-13))
    held = got.outcome == Outcome.HELD
    assert held.sum() > len(shares)
    for part in ("force", "moment"):
        a, b = getattr(got, part)[held], getattr(true, part)[held]
        size = np.linalg.norm(b, axis=-1)
        assert np.all(np.linalg.norm(a - b, axis=-1) <= got.error[held] * size)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: rod.press(CURVED, [0.03, 0.01]), "three components"),
        (lambda: rod.press(CURVED, [0.0, 0.0, 0.0]), "must be above zero"),
        (lambda: rod.bend(CURVED, 0.03, 1e-5, poisson_ratio=0.7), "poisson_ratio must be"),
        (lambda: rod.bend(CURVED, 0.03, 1e-5, 0.0, 2.0), "friction_angle must be"),
    ],
)
def test_misuse_is_one_sentence(make, message):
    with pytest.raises(ValueError, match=message):
        make()
