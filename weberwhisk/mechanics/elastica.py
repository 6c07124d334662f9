"""The elastica of every straight taper and cylinder, from one dimensionless map.

A straight whisker touched without friction carries a force normal to it at the contact, where
the moment is zero, so the beam can be followed from the contact to the base without shooting. For
a linear taper the shape, scaled by the arc length s of the contact, depends on two numbers only:
u = s/A (A the apex distance) and the load, given as the contact angle that the small-angle theory
would predict, ℓ = F s²(3−2u) / (6EI₀(1−u)²). Cylinders are the edge u = 0, the perfect cone
touched at its tip the edge u = 1, and the whole map is analytic in between.

The map is held by `elastica_map`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._checks import refuse_hinge
from ..whisker import Whisker
from .chebyshev import Array, ChebyshevTable, load_cap, the_map, unfold
from .contact import (
    TIP_ROUNDING,
    Bending,
    FlickPast,
    Model,
    Outcome,
    beyond_tip,
    by_rows,
    flat_with,
    in_pieces,
)

#: Relative accuracy of the tables, held by the tests against an independent integrator.
MAP_ERROR = 1e-12


def bend(whisker: Whisker, arc_length: ArrayLike, force: ArrayLike) -> Bending:
    """Bend a straight whisker by a force (N) at an arc length (m), as `weberwhisk.bend` does.

    `PAST_FOLD` is an equilibrium at the given force that an object fixed in space could no longer
    hold; `FLICKED_PAST` marks loads beyond the map. Relative error about 1e-12, for every taper
    from the cylinder to the perfect cone.
    """
    return by_rows(_bend, Model.ELASTICA, whisker, arc_length, force)


def _bend(
    length: Array, taper: Array, stiffness: Array, arc: Array, force: Array
) -> tuple[Array, NDArray[np.int8], Array]:
    table = the_map()
    u = arc / length * taper
    beyond = beyond_tip(arc, length, u)
    u = np.where(beyond, 0.0, u)
    load = np.abs(force) * arc**2 * (3 - 2 * u) / (6 * stiffness * (1 - u) ** 2)
    ratio = load / load_cap(u)
    outcome = np.where(ratio > table.fold_load(u)[0], Outcome.PAST_FOLD, Outcome.HELD)
    outcome = np.where(ratio > 1, Outcome.FLICKED_PAST, outcome)
    outcome = np.where(beyond, Outcome.OUT_OF_REACH, outcome).astype(np.int8)
    lost = outcome > Outcome.PAST_FOLD
    ratio = np.where(lost, 0.0, ratio)
    load = np.where(lost, np.nan, load)

    log_angle, log_height, log_shortening = table.force_given(u, ratio**2)
    sign = np.sign(force)
    contact_angle = load * np.exp(log_angle)
    y = arc * (1 - u) * 2 * load / (3 - 2 * u) * np.exp(log_height)
    x = arc * (1 - (1 - u) * load**2 * np.exp(log_shortening))
    numbers = _numbers(x, y, contact_angle, arc, np.where(lost, np.nan, np.abs(force)), sign)
    numbers[6:, lost] = np.nan
    return numbers, outcome, np.where(lost, np.nan, MAP_ERROR)


def press(whisker: Whisker, radial_distance: ArrayLike, deflection_angle: ArrayLike) -> Bending:
    """Press a straight whisker against a point (m, rad), as `weberwhisk.press` does.

    Relative error about 1e-12. Within a fraction ε of the fold angle the signals themselves go as
    √ε, so that the last digits of the angle cost twice as many of the signals; `Bending.error`
    carries this.
    """
    return by_rows(_press, Model.ELASTICA, whisker, radial_distance, deflection_angle)


def _press(
    length: Array, taper: Array, stiffness: Array, r: Array, theta: Array
) -> tuple[Array, NDArray[np.int8], Array]:
    table = the_map()
    v = r / length * taper
    beyond = beyond_tip(r, length, v)
    v = np.where(beyond, 0.0, v)
    fold_angle = table.fold_angle(v)
    tangent = np.abs(theta) / fold_angle
    past = tangent > 1
    c = np.sqrt(np.where(past, 0.0, (1 - tangent) * (1 + tangent)))
    force, contact_angle, arc = _contact(
        table.contact_given, v, c, stiffness, r, np.where(past, fold_angle, np.abs(theta))
    )
    outcome = np.where(past, Outcome.FLICKED_PAST, Outcome.HELD)
    outcome = np.where(arc > length * (1 + TIP_ROUNDING), Outcome.SLIPPED_OFF_TIP, outcome)
    outcome = np.where(beyond, Outcome.OUT_OF_REACH, outcome).astype(np.int8)
    lost = outcome != Outcome.HELD
    force = np.where(lost, np.nan, force)
    numbers = _numbers(
        r * np.cos(theta), r * np.sin(np.abs(theta)), contact_angle, arc, force, np.sign(theta)
    )
    numbers[3], numbers[4] = r, theta  # as given, not as recomputed
    numbers[5:7, lost] = np.nan
    with np.errstate(divide="ignore"):
        error = MAP_ERROR + 3e-15 / c**2
    return numbers, outcome, np.where(lost, np.nan, np.minimum(error, 1.0))


def _contact(
    table: ChebyshevTable, v: Array, c: Array, stiffness: Array, r: Array, theta: Array
) -> tuple[Array, Array, Array]:
    """Force, contact angle and arc length of an object at r = vA, deflection angle θ ≥ 0."""
    log_force, log_angle, log_extra = table(unfold(v), c)
    force = 3 * stiffness * theta * (1 - v) / r**2 * np.exp(log_force)
    contact_angle = theta * (3 - 2 * v) / (2 * (1 - v)) * np.exp(log_angle)
    arc = r * (1 + theta**2 / (1 - v) * np.exp(log_extra))
    return force, contact_angle, arc


def _numbers(
    x: Array, y: Array, contact_angle: Array, arc: Array, force: Array, sign: Array
) -> Array:
    """The eight numbers of a `Bending` from contact point, contact angle and force, all ≥ 0."""
    sine, cosine = np.sin(contact_angle), np.cos(contact_angle)
    return np.stack(
        [
            sign * force * (x * cosine + y * sine),  # |contact vector × force|
            force * sine,
            sign * force * cosine,
            np.hypot(x, y),
            sign * np.arctan2(y, x),
            sign * contact_angle,
            arc,
            sign * force,
        ]
    )


def flick_past(whisker: Whisker, radial_distance: ArrayLike) -> FlickPast:
    """The largest deflection angle at a radial distance (m), and why it ends."""
    refuse_hinge(whisker, "flick_past")
    shape, (length, taper, _, r) = flat_with(whisker, radial_distance)
    angle, c_end, fold_angle, c_peak = in_pieces(limits, length, taper, r)
    beyond = np.isnan(angle)
    peak_angle = np.where(beyond, 0.0, fold_angle * np.sqrt(1 - np.maximum(c_peak, c_end) ** 2))
    ended = np.where(c_end > 0, Outcome.SLIPPED_OFF_TIP, Outcome.FLICKED_PAST)
    ended = np.where(beyond, Outcome.OUT_OF_REACH, ended).astype(np.int8).reshape(shape)

    def at(theta: Array) -> Bending:
        return press(whisker, radial_distance, theta.reshape(shape))

    return FlickPast(
        angle.reshape(shape)[()],
        ended if shape else Outcome(int(ended)),
        at(np.where(beyond, 0.0, angle)),
        at(peak_angle),
    )


def limits(length: Array, taper: Array, r: Array) -> tuple[Array, Array, Array, Array]:
    """Largest angle, c there, fold angle and c at the moment peak, at each r (n,)."""
    table = the_map()
    v = r / length * taper
    beyond = beyond_tip(r, length, v)
    v = np.where(beyond, 0.0, v)
    x = unfold(v)
    scaled_angle, c_peak = table.fold(x)
    fold_angle = (1 - v) * scaled_angle

    # The extra arc length θ²/(1−v)·exp(g) of the contact grows all the way to the fold. Where it
    # would pass the tip first, c solves ln(1−c²) + g(x, c) = ln of the room left there.
    c_end = np.zeros_like(v)
    room = (length - r) / r * (1 - v) / fold_angle**2
    tip = ~beyond & (np.exp(table.contact_given(x, c_end)[2]) > room)
    if np.any(tip):
        x_tip, room = x[tip], np.maximum(room[tip], 0.0)
        c = np.ones_like(room)
        for _ in range(12):  # Newton's method on a concave falling function, from above
            values = table.contact_given.gradient(x_tip, c)
            growth = np.exp(values[2])
            excess = (1 - c) * (1 + c) * growth - room
            slope = growth * ((1 - c) * (1 + c) * values[8] - 2 * c)
            c = np.clip(c - excess / slope, 0.0, 1.0)
        c_end[tip] = c
    angle = fold_angle * np.sqrt((1 - c_end) * (1 + c_end))
    return np.where(beyond, np.nan, angle), c_end, fold_angle, c_peak


def signal_jacobian(
    whisker: Whisker, radial_distance: ArrayLike, deflection_angle: ArrayLike
) -> Array:
    """Derivatives of the base signals to the contact, as `weberwhisk.signal_jacobian` has them."""
    refuse_hinge(whisker, "signal_jacobian")
    shape, flat = flat_with(whisker, radial_distance, deflection_angle)
    slopes = in_pieces(_signal_jacobian, *flat)
    return np.moveaxis(slopes, -1, 0).reshape(*shape, 3, 2)


def _signal_jacobian(
    length: Array, taper: Array, stiffness: Array, r: Array, theta: Array
) -> Array:
    """The derivatives (3, 2, n)."""
    outcome = _press(length, taper, stiffness, r, theta)[1]
    lost = outcome != Outcome.HELD
    v = np.where(lost, 0.0, r / length * taper)
    theta = np.where(lost, 0.0, theta)
    sign, theta = np.where(theta < 0, -1.0, 1.0), np.abs(theta)
    v_r = taper / length

    table = the_map()
    x = unfold(v)
    x_r = 2 / (1 + 2 * x) * v_r
    scaled = table.fold(x)[0]
    fold_angle = (1 - v) * scaled
    fold_angle_r = -v_r * scaled + (1 - v) * table.fold.derivative(x)[0] * x_r
    tangent = theta / fold_angle
    c = np.sqrt((1 - tangent) * (1 + tangent))
    with np.errstate(divide="ignore", invalid="ignore"):
        c_theta = -tangent / (fold_angle * c)
        c_r = -tangent * fold_angle_r * c_theta

        values = table.contact_given.gradient(x, c)
        (log_force, log_angle, _), d_x, d_c = values[:3], values[3:6], values[6:]
        d_r = d_x * x_r + d_c * c_r
        d_theta = d_c * c_theta
        # Per unit force, so that θ = 0 needs no special case: F = θ·g, α = θ·h.
        g = 3 * stiffness * (1 - v) / r**2 * np.exp(log_force)
        h = (3 - 2 * v) / (2 * (1 - v)) * np.exp(log_angle)
        force, alpha = theta * g, theta * h
        force_r = force * (d_r[0] - v_r / (1 - v) - 2 / r)
        alpha_r = alpha * (d_r[1] + v_r * (1 / (1 - v) - 2 / (3 - 2 * v)))
        force_theta = g * (1 + theta * d_theta[0])
        alpha_theta = h * (1 + theta * d_theta[1])
        sine, cosine = np.sin(alpha), np.cos(alpha)
        lever_cosine, lever_sine = np.cos(alpha - theta), np.sin(alpha - theta)
        moment_r = (force_r * r + force) * lever_cosine - force * r * lever_sine * alpha_r
        moment_theta = force_theta * lever_cosine - force * lever_sine * (alpha_theta - 1)
        axial_theta = force_theta * sine + force * cosine * alpha_theta
        rows = [
            [sign * moment_r, r * moment_theta],
            [force_r * sine + force * cosine * alpha_r, sign * axial_theta],
            [
                sign * (force_r * cosine - force * sine * alpha_r),
                force_theta * cosine - force * sine * alpha_theta,
            ],
        ]
    return np.where(lost, np.nan, rows)
