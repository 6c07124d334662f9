"""Sweeps against model 1 and 2 at a point, SciPy at rounded and flat objects, and geometry."""

from __future__ import annotations

import numpy as np
import pytest
from integrators import follow
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, minimize_scalar
from short_forms import slow_but

from weberwhisk.mechanics import elastica
from weberwhisk.mechanics.contact import Outcome
from weberwhisk.mechanics.profile import flick_past, press, rest_angle
from weberwhisk.sweeping import cylinder, peg, sweep, wall
from weberwhisk.whisker import Whisker

W = Whisker(50e-3, 100e-6, 5e-6, 3e9)
CURLED = Whisker(50e-3, 100e-6, 5e-6, 3e9, curvature=-8.0)  # towards the object


def test_a_peg_is_press_at_every_angle():
    s = sweep(W, peg(35e-3, 0.0), np.radians([-5, 0.001, 5, 15, 24, 25]))
    np.testing.assert_array_equal(s.bending.outcome, [4, 0, 0, 0, 0, 2])
    exact = elastica.press(W, 35e-3, s.rotation[1:5])
    for name in ("moment", "axial_force", "transverse_force", "arc_length"):
        np.testing.assert_allclose(
            getattr(s.bending, name)[1:5], getattr(exact, name), rtol=2e-8, err_msg=name
        )
    np.testing.assert_allclose(s.contact[1:5], [[35e-3, 0.0]] * 4, atol=1e-11)
    assert s.first_contact == pytest.approx(0, abs=1e-9)
    assert s.end == pytest.approx(elastica.flick_past(W, 35e-3).deflection_angle, abs=5e-6)
    assert s.ended_by is Outcome.FLICKED_PAST
    assert np.all(np.isnan(s.bending.moment[[0, 5]]))


@pytest.mark.slow  # of such whiskers: `test_track.py`
def test_a_curved_whisker_and_friction_at_a_peg():
    w = CURLED
    x, y = 30e-3 * np.cos(-0.4), 30e-3 * np.sin(-0.4)
    s = sweep(w, peg(x, y), np.linspace(0.0, 1.4, 8), friction_angle=-0.2)
    rest = float(rest_angle(w, 30e-3))
    assert s.first_contact == pytest.approx(rest + 0.4, abs=1e-6)
    held = s.bending.held
    exact = press(w, 30e-3, s.rotation[held] - 0.4, -0.2)
    np.testing.assert_allclose(s.bending.moment[held], exact.moment, rtol=1e-7)
    assert s.end == pytest.approx(flick_past(w, 30e-3, -0.2).deflection_angle + 0.4, abs=5e-6)


def test_a_thin_cylinder_is_a_peg_and_a_thick_one_meets_its_own_geometry():
    angles = np.radians([-2, 3, 12, 22])
    thin = sweep(W, cylinder(35e-3, -1e-8, 1e-8), angles).bending.moment
    np.testing.assert_allclose(thin[1:], elastica.press(W, 35e-3, angles[1:]).moment, rtol=1e-5)
    centre, radius = np.array([30e-3, -5e-3]), 5e-3
    s = sweep(W, cylinder(*centre, radius), np.radians(np.arange(-5, 60, 10)))
    held = s.bending.held
    out = s.contact[held] - centre
    np.testing.assert_allclose(np.hypot(*out.T), radius, rtol=1e-8)
    # The whisker is tangent: its angle in the world is that of the circle there.
    tangent = s.bending.contact_angle[held] - s.rotation[held]
    np.testing.assert_allclose(np.arctan2(-out[:, 0], out[:, 1]), tangent, atol=1e-7)
    assert np.all(np.diff(s.contact[held][:, 0]) < 0)  # it rolls towards the base
    assert s.ended_by is Outcome.FLICKED_PAST


def test_a_wall_is_met_with_the_tip_then_with_the_flank():
    """Tip first, at acos(h/L) from the normal; then flush, the whisker's end along the wall."""
    s = sweep(W, wall(0.0, -30e-3, 0.0), np.radians(np.arange(30, 100, 4.0)))
    assert s.first_contact == pytest.approx(np.arcsin(30 / 50), abs=1e-9)
    held = s.bending.held
    np.testing.assert_allclose(s.contact[held][:, 1], -30e-3, atol=1e-10)
    flank = held & ~s.tip
    assert np.sum(s.tip) >= 1
    assert np.all(np.flatnonzero(s.tip).max() < np.flatnonzero(flank).min())
    world = s.bending.contact_angle - s.rotation
    np.testing.assert_allclose(world[flank], 0, atol=1e-8)
    assert np.all(world[s.tip] < 0)
    np.testing.assert_allclose(s.bending.arc_length[s.tip], 50e-3)
    # Without friction the force is normal to the wall, whichever touches.
    force = np.arctan2(s.bending.axial_force, s.bending.transverse_force)
    np.testing.assert_allclose((force - s.rotation)[held], 0, atol=1e-8)
    assert np.all(np.diff(s.bending.arc_length[flank]) < 0)


@pytest.mark.slow  # of the tip: a wall, below
def test_a_round_object_beyond_the_flanks_reach_is_met_with_the_tip():
    """It was not met at all: no point of the arc that was looked at was the tip's."""
    distance, radius, length = 52e-3, 5e-3, W.length
    centre = distance * np.array([np.cos(-0.4), np.sin(-0.4)])
    apart = np.arccos((distance**2 + length**2 - radius**2) / (2 * distance * length))
    s = sweep(W, cylinder(*centre, radius), np.linspace(0, 0.8, 17))
    assert s.first_contact == pytest.approx(0.4 - apart, abs=1e-9)
    held = s.bending.held
    assert s.tip[held].tolist() == [True, False, False, False]
    np.testing.assert_allclose(np.hypot(*(s.contact[held] - centre).T), radius, rtol=1e-7)
    s = sweep(W, cylinder(52e-3, -10e-3, radius), travel=[0.0, 6e-3])
    assert s.first_contact == pytest.approx(10e-3 - np.sqrt(radius**2 - 2e-3**2), abs=1e-9)


def test_an_object_that_the_sweep_does_not_reach_is_out_of_reach():
    s = sweep(W, peg(35e-3, 0.0), [0.1, 0.5, 1.0])  # it starts past the peg
    assert s.ended_by is Outcome.OUT_OF_REACH
    assert np.isnan(s.first_contact)


@pytest.mark.parametrize("radius", [5e-3, pytest.param(12e-3, marks=pytest.mark.slow)])
@pytest.mark.slow
def test_the_fold_at_a_cylinder_is_the_largest_rotation_of_any_tangent_whisker(radius):
    """All whiskers tangent to the circle, found one force at a time by SciPy, know no path."""
    centre = np.array([30e-3, -1e-3 - radius])

    def seen(s, force):
        """Centre of the circle in the base frame."""
        *_, r, theta, alpha = follow(50e-3, 100e-6, 5e-6, 3e9, s, force)
        x, y = r * np.cos(theta), r * np.sin(theta)
        return x + radius * np.sin(alpha), y - radius * np.cos(alpha)

    def rotation(force):
        far = np.hypot(*centre)
        s = brentq(lambda s: np.hypot(*seen(s, force)) - far, 20e-3, 40e-3, xtol=1e-10)
        x, y = seen(s, force)
        return np.arctan2(y, x) - np.arctan2(*centre[::-1])

    peak = minimize_scalar(
        lambda f: -rotation(f * 1e-4), bounds=(2, 9), method="bounded", options={"xatol": 1e-4}
    )
    s = sweep(W, cylinder(*centre, radius), np.radians(np.arange(0, 120, 10)))
    assert s.ended_by is Outcome.FLICKED_PAST
    assert s.end == pytest.approx(-peak.fun, abs=5e-6)


def drawn(whisker, s, force, tilt):
    """x and y of the whole whisker in the base frame, by SciPy from the contact both ways.

    The force leans by `tilt` from the normal towards the base.
    """
    kappa = whisker.curvature

    def rates(at, state):
        angle, x, y = state  # as seen from the contact
        moment = force * (-x * np.cos(tilt) - y * np.sin(tilt)) * (at <= s)
        stiff = whisker.stiffness * (1 - at / whisker.apex_distance) ** 4
        return [kappa + moment / stiff, np.cos(angle), np.sin(angle)]

    def to(end):
        if end == s:
            return np.zeros((3, 1))
        at = np.linspace(s, end, 1500)
        return solve_ivp(rates, (s, end), [0.0] * 3, t_eval=at, rtol=1e-11, atol=1e-14).y

    inner, outer = to(0.0), to(whisker.length)
    alpha = -inner[0, -1]
    x, y = np.concatenate([inner[1:, ::-1], outer[1:, 1:]], axis=1) - inner[1:, [-1]]
    c, s = np.cos(alpha), np.sin(alpha)
    return c * x - s * y, s * x + c * y, alpha


BODIES = {
    "peg": peg(30e-3, -10e-3),
    "cylinder": cylinder(30e-3, -12e-3, 5e-3),
    "level": wall(0.0, -30e-3, 0.0),
    "steep": wall(45e-3, -10e-3, 1.2),
}


@pytest.mark.parametrize(
    ("name", "whisker"),
    [
        pytest.param(
            name, w, id=f"{name}-{shape}", marks=[pytest.mark.slow] * (slow or (i + j) % 2)
        )
        for i, name in enumerate(BODIES)
        for slow in [name in ("peg", "steep")]
        for j, (shape, w) in enumerate({"straight": W, "curled": CURLED}.items())
    ],
)
def test_the_whisker_is_never_inside_the_object(name, whisker):
    body = BODIES[name]
    s = sweep(whisker, body, np.radians(np.arange(-42, 60, 6.0)))
    b = s.bending
    assert np.any(b.held)
    for i in np.flatnonzero(b.held)[::4]:
        lean = np.arctan2(b.axial_force[i], b.transverse_force[i]) - b.contact_angle[i]
        x, y, alpha = drawn(whisker, b.arc_length[i], b.force[i], lean)
        assert alpha == pytest.approx(b.contact_angle[i], abs=1e-8)
        c, q = np.cos(s.rotation[i]), np.sin(s.rotation[i])
        depth = body.depth(c * x + q * y, c * y - q * x)
        assert -2e-8 < np.max(depth) < 1e-9  # it touches, within the spacing of the points


@pytest.mark.slow
def test_a_whisker_curved_towards_a_wall_ends_where_it_touches_twice():
    """Tip first, then flush; there the free end dips into the wall, which two points must hold.

    By SciPy: where a whisker flush with the wall at s has its tip a millionth of L inside.
    """

    def flush(s):
        def heights(force):
            x, y, alpha = drawn(CURLED, s, force, 0.0)
            return 30e-3 + y * np.cos(alpha) - x * np.sin(alpha), alpha

        return heights(brentq(lambda f: heights(f)[0][1499], 1e-8, 1e-5, xtol=1e-15))

    s = brentq(lambda s: flush(s)[0][-1] + 1e-6 * 50e-3, 49.7e-3, 49.99e-3, xtol=1e-9)
    end = flush(s)[1]
    s = sweep(CURLED, wall(0.0, -30e-3, 0.0), np.radians(np.arange(0, 60, 4.0)))
    assert s.ended_by is Outcome.TOUCHES_TWICE
    assert s.end == pytest.approx(end, abs=5e-6)
    assert np.all(s.tip[s.bending.held])
    assert s.bending.outcome[-1] == Outcome.TOUCHES_TWICE


def test_depth_is_the_signed_distance():
    level, round_one = wall(0.0, -5e-3, 0.0), cylinder(20e-3, -5e-3, 2e-3)
    x, y = np.array([25e-3, 20e-3]), np.array([-8e-3, -4e-3])
    np.testing.assert_allclose(level.depth(x, y), [3e-3, -1e-3], atol=1e-15)
    np.testing.assert_allclose(round_one.depth(x, y), [2e-3 - np.hypot(5, 3) * 1e-3, 1e-3])


@pytest.mark.parametrize("friction", [0.0, -0.2])
def test_a_base_that_travels_past_a_peg_is_press_at_every_place(friction):
    travel = np.array([-1e-3, 1e-6, 2e-3, 6e-3, 10e-3])
    s = sweep(W, peg(30e-3, 0.0), friction_angle=friction, travel=travel)
    r, theta = np.hypot(30e-3, travel[1:]), np.arctan2(travel[1:], 30e-3)
    exact = press(W, r, theta, friction)
    for name in ("moment", "axial_force", "transverse_force", "arc_length"):
        found, true = getattr(s.bending, name)[1:], getattr(exact, name)
        np.testing.assert_allclose(found, true, rtol=1e-6, err_msg=name)
    np.testing.assert_allclose(s.contact[1:], [[30e-3, 0.0]] * 4, atol=1e-10)
    assert s.first_contact == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize(
    ("body", "whisker", "span"),
    slow_but(
        [
            (cylinder(25e-3, -5e-3, 5e-3), W, 9e-3),
            (cylinder(25e-3, -12e-3, 5e-3), CURLED, 3e-3),
            (wall(50e-3, 0.0, np.pi / 3), W, 1.5e-3),
        ],
        (1,),
    ),
)
def test_the_work_of_a_base_that_travels_is_the_energy_that_bends(body, whisker, span):
    """∫ Fy dy beside ½ ∫ (EI (κ − κ₀)²) ds along the whisker, drawn by SciPy."""
    start = sweep(whisker, body, travel=[-10e-3, 20e-3]).first_contact
    u, weight = np.polynomial.legendre.leggauss(12)
    u = (u + 1) / 2
    s = sweep(whisker, body, travel=start + span * np.r_[-0.1, u**2, 1.0])
    assert np.all(s.bending.held[1:])
    work = s.bending.transverse_force[1:-1] @ (weight * span * u)
    axial, across, angle, arc, force = (
        getattr(s.bending, f"{name}")[-1]
        for name in ("axial_force", "transverse_force", "contact_angle", "arc_length", "force")
    )
    lean = np.arctan2(axial, across) - angle

    def rates(at, state):
        turn, x, y, _ = state
        moment = force * (-x * np.cos(lean) - y * np.sin(lean))
        stiff = whisker.stiffness * (1 - at / whisker.apex_distance) ** 4
        bent = whisker.curvature + moment / stiff
        return [bent, np.cos(turn), np.sin(turn), moment**2 / (2 * stiff)]

    energy = -solve_ivp(rates, (arc, 0.0), [0.0] * 4, rtol=1e-10, atol=1e-18).y[3, -1]
    assert work == pytest.approx(energy, rel=2e-4)
    assert abs(body.depth(*s.contact[-1])) < 1e-9


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: sweep(W, peg(0.03, 0.0), [0.2, 0.1]), "one row of ascending numbers"),
        (lambda: sweep(W, peg(0.03, 0.0), [0.1], [0.1, 0.2]), "friction_angle must be one number"),
        (lambda: sweep(W, peg(0.03, 0.0), [0.1], 9), "friction_angle must .*got 9; give"),
        (lambda: sweep(W, 0.03, [0.0, 0.1]), "body must be an object, got"),
        (lambda: sweep(W, peg(0.03, 0.0)), "rotations or travels of the base, got none"),
        (lambda: sweep(W, wall(0.0, 0.01, 0.0), [0.0, 0.1]), "base of the whisker must be outside"),
        (lambda: sweep(W, cylinder(0.03, 0.0, 2e-3), [0.0, 0.1]), "start clear of the object"),
        (lambda: sweep(Whisker([0.05, 0.04], 1e-4, 5e-6), peg(0.03, 0), [0.0]), "one whisker"),
    ],
)
def test_misuse_is_one_sentence(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_a_base_does_not_move_through_the_object():
    with pytest.raises(ValueError, match="base of the whisker must be outside"):
        sweep(W, cylinder(2e-3, -10e-3, 5e-3), travel=[0.0, 12e-3])
