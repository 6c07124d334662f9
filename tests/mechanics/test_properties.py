"""Properties of the mechanics: symmetries, limits, round trips; no NaN and no warning inside."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from property_strategies import (
    ANGLES,
    FRACTIONS,
    POWERS,
    floats,
    logarithmic,
    scaled,
    whiskers,
)

import weberwhisk as ww

# Whiskers of every size may be as little curved as a slip of units would be.
pytestmark = pytest.mark.filterwarnings("ignore:curvature is in 1/m")

NUMBERS = (
    "moment", "axial_force", "transverse_force", "radial_distance", "deflection_angle",
    "contact_angle", "arc_length", "force",
)  # fmt: skip
MIRRORED = ("moment", "transverse_force", "deflection_angle", "contact_angle", "force")


def same(a: object, b: object, rtol: float = 0.0) -> None:
    np.testing.assert_allclose(np.asarray(a), np.asarray(b), rtol=rtol, atol=0.0)


def check_whole(b: ww.mechanics.Bending) -> None:
    """Numbers where a contact is held, NaN where not; an outcome and an error everywhere."""
    held = np.asarray(b.held)
    for name in NUMBERS:
        value = np.asarray(getattr(b, name))
        assert np.isfinite(value[held]).all(), name
    for name in ("moment", "axial_force", "transverse_force", "force"):
        assert np.isnan(np.asarray(getattr(b, name))[~held]).all(), name
    assert (np.asarray(b.error)[held] >= 0).all()
    for outcome in np.ravel(b.outcome):
        assert ww.Outcome(int(outcome)).message
    assert np.all(np.sign(b.moment)[held] == np.sign(b.deflection_angle)[held])
    assert np.all(np.asarray(b.axial_force)[held] >= 0)


models = st.sampled_from([None, "closed_form", "elastica"])


@given(whiskers(), FRACTIONS, ANGLES, models)
def test_a_pressed_whisker_is_whole(
    w: ww.Whisker, fractions: np.ndarray, angles: np.ndarray, model: str | None
) -> None:
    check_whole(ww.press(w, fractions[:, None] * w.length, angles, model=model))


@given(whiskers(), FRACTIONS, ANGLES, POWERS, POWERS, models)
def test_units_do_not_matter(
    w: ww.Whisker, fractions: np.ndarray, angles: np.ndarray, size: float, stiff: float,
    model: str | None,
) -> None:  # fmt: skip
    r = fractions[:, None] * w.length
    one = ww.press(w, r, angles, model=model)
    other = ww.press(scaled(w, size, stiff), r * size, angles, model=model)
    same(one.outcome, other.outcome)
    same(one.moment * stiff * size**3, other.moment)
    for name in ("axial_force", "transverse_force", "force"):
        same(getattr(one, name) * stiff * size**2, getattr(other, name))
    same(one.arc_length * size, other.arc_length)


@given(whiskers(), FRACTIONS, ANGLES, models)
def test_a_mirrored_contact_has_mirrored_signals(
    w: ww.Whisker, fractions: np.ndarray, angles: np.ndarray, model: str | None
) -> None:
    r = fractions[:, None] * w.length
    one, other = (ww.press(w, r, sign * angles, model=model) for sign in (1, -1))
    for name in NUMBERS:
        same(getattr(one, name), getattr(other, name) * (-1 if name in MIRRORED else 1))
    same(one.outcome, other.outcome)


@given(whiskers(), floats(0.02, 0.999), floats(1e-4, 0.9999))
def test_bend_undoes_press(w: ww.Whisker, fraction: float, share: float) -> None:
    r = fraction * w.length
    theta = share * ww.flick_past(w, r).deflection_angle
    pressed = ww.press(w, r, theta)
    assert pressed.outcome == ww.Outcome.HELD
    bent = ww.bend(w, pressed.arc_length, pressed.force)
    # At a fold of the force a hair is amplified without bound.
    margin = 1e-9 / (1 - share)
    if share < 0.99:
        assert bent.outcome in (ww.Outcome.HELD, ww.Outcome.PAST_FOLD)
    assume(np.isfinite(bent.moment))
    same(bent.moment, pressed.moment, rtol=margin)
    same(bent.radial_distance, r, rtol=margin)
    same(bent.deflection_angle, theta, rtol=margin)


@given(whiskers(), floats(1e-3, 0.9999))
def test_contact_is_held_up_to_the_flick_past_and_no_further(
    w: ww.Whisker, fraction: float
) -> None:
    r = fraction * w.length
    end = ww.flick_past(w, r)
    angles = end.deflection_angle * np.array(
        [1e-6, 0.5, 0.9, 0.999, 1 - 1e-6, 1 + 1e-6, 1.001, 1.5]
    )
    held = ww.press(w, r, angles).held
    assert held[:5].all(), held
    assert not held[5:].any(), held
    assert end.ended_by != ww.Outcome.HELD


@given(whiskers(), floats(1e-3, 0.999))
def test_moment_grows_with_deflection_up_to_its_peak(w: ww.Whisker, fraction: float) -> None:
    r = fraction * w.length
    end = ww.flick_past(w, r)
    top = end.at_moment_peak.deflection_angle
    b = ww.press(w, r, np.linspace(0.01, 0.999, 40) * top)
    assert b.held.all()
    assert (np.diff(b.moment) > 0).all()
    assert (np.diff(b.axial_force) > 0).all()
    beyond = ww.press(w, r, np.linspace(1.001 * top, 0.9999 * end.deflection_angle, 10))
    assume(end.deflection_angle > 1.01 * top)
    assert (beyond.moment[beyond.held] < end.at_moment_peak.moment).all()


@given(whiskers(), floats(1e-3, 0.999), logarithmic(1e-7, 0.05))
def test_a_light_touch_is_the_closed_form(w: ww.Whisker, fraction: float, angle: float) -> None:
    r = fraction * w.length
    theta = angle * ww.flick_past(w, r).deflection_angle
    rough = ww.press(w, r, theta, model="closed_form")
    exact = ww.press(w, r, theta)
    # Its own estimate of its error holds, with rounding.
    for name in ("moment", "axial_force", "transverse_force"):
        off = abs(getattr(rough, name) / getattr(exact, name) - 1)
        assert off <= 2 * rough.error + 1e-9, name


@given(whiskers(), floats(0.01, 0.99), floats(0.01, 0.9))
def test_slopes_are_those_of_the_signals(w: ww.Whisker, fraction: float, share: float) -> None:
    r = fraction * w.length
    theta = share * ww.flick_past(w, r).deflection_angle
    slope = ww.mechanics.signal_jacobian(w, r, theta)
    step = 1e-5
    for k, (dr, dtheta) in enumerate(((step * r, 0.0), (0.0, step * theta))):
        up, down = (ww.press(w, r + s * dr, theta + s * dtheta) for s in (1, -1))
        assume(up.held and down.held)
        for row, name in enumerate(("moment", "axial_force", "transverse_force")):
            value = getattr(up, name) - getattr(down, name)
            size = abs(getattr(up, name)) / (dr + dtheta)
            by_step = value / (2 * (dr + dtheta))
            assert abs(slope[row, k] - by_step) < 1e-3 * max(abs(by_step), size * step), name


@settings(max_examples=max(settings.default.max_examples // 3, 2))  # seconds each next to a tip
@given(whiskers(curved=True), floats(0.05, 1.02), floats(-1.5, 1.5), floats(0.0, 0.6), POWERS)
def test_curved_whiskers_with_friction_keep_the_symmetries(
    w: ww.Whisker, fraction: float, theta: float, friction: float, size: float
) -> None:
    r = fraction * w.length
    one = ww.press(w, r, theta, friction)
    check = np.isfinite(one.moment) == (one.outcome == ww.Outcome.HELD)
    assert check
    mirror = ww.press(replace(w, curvature=-w.curvature), r, -theta, friction)
    other = ww.press(scaled(w, size), r * size, theta, friction)
    assert one.outcome == mirror.outcome == other.outcome
    near = {"rtol": 1e-8, "atol": 1e-10}  # a whisker at rest has signals of rounding
    np.testing.assert_allclose(one.normalised_moment, -mirror.normalised_moment, **near)
    np.testing.assert_allclose(one.normalised_axial_force, mirror.normalised_axial_force, **near)
    np.testing.assert_allclose(one.normalised_moment, other.normalised_moment, **near)


@given(
    whiskers(curved=True),
    floats(0.05, 0.95),
    floats(0.01, 0.95),
    logarithmic(1e-4, 1.0),
    logarithmic(0.01, 0.5),
)
def test_the_rung_chosen_is_within_the_tolerance_and_no_dearer_when_it_grows(
    w: ww.Whisker, fraction: float, share: float, tolerance: float, k: float
) -> None:  # fmt: skip
    r = fraction * w.length
    theta = float(ww.mechanics.rest_angle(w, r)) + share * 0.5
    assume(np.isfinite(theta))
    strict, loose = (
        ww.choose_model(w, r, theta, weber_fraction=k, tolerance=t)
        for t in (tolerance, 3 * tolerance)
    )
    assert strict.bias[strict.model] <= tolerance
    assert loose.model <= strict.model
    assert strict.why
