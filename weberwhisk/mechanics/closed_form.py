"""The closed form: the straight whisker at small angle, in closed form, and its exact inverses.

With u the contact's distance over the apex distance A, a linear taper obeys, exactly as the angle
goes to zero,

    M = 3EI₀ θ_d (1/r − 1/A),   α = θ_d (3−2u)/(2(1−u)),   M²/(2EI₀Fx) = 3(1−u)²/(3−2u):

equation (2.3) with the apex distance in the place of the paper's L, which covers perfect cones,
truncated cones and cylinders (A infinite) alike.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from .._util.checks import refuse_hinge
from .._util.values import Array, Codes, Flags
from ..whisker import Whisker
from .contact import Bending, Model, Outcome, beyond_tip, by_rows

__all__ = [
    "bend", "contact_from_signals", "distance_from_moment", "moment", "press", "signal_jacobian",
]  # fmt: skip


def bend(whisker: Whisker, arc_length: ArrayLike, force: ArrayLike) -> Bending:
    """Bend a straight whisker by a force (N) at an arc length (m), at small angle.

    `HELD` wherever the contact is on the whisker: this model has no flick-past. `error` estimates
    the relative error of the signals against the elastica.
    """
    return by_rows(_bend, Model.CLOSED_FORM, whisker, arc_length, force)


def _bend(
    length: Array, taper: Array, stiffness: Array, arc: Array, force: Array
) -> tuple[Array, Codes, Array]:
    u, lost = _place(length, taper, arc)
    contact_angle = force * arc**2 * (3 - 2 * u) / (6 * stiffness * (1 - u) ** 2)
    theta = contact_angle * 2 * (1 - u) / (3 - 2 * u)
    return _result(arc, theta, contact_angle, force, lost)


def press(whisker: Whisker, radial_distance: ArrayLike, deflection_angle: ArrayLike) -> Bending:
    """Press a straight whisker against a point (m, rad), at small angle: equation (2.3).

    `HELD` wherever the contact is on the whisker, as for `bend`. `error` is 1 where the push would
    slide the contact off the tip.
    """
    return by_rows(_press, Model.CLOSED_FORM, whisker, radial_distance, deflection_angle)


def _press(
    length: Array, taper: Array, stiffness: Array, r: Array, theta: Array
) -> tuple[Array, Codes, Array]:
    u, lost = _place(length, taper, r)
    contact_angle = theta * (3 - 2 * u) / (2 * (1 - u))
    force = 3 * stiffness * theta * (1 - u) / r**2
    numbers, outcome, error = _result(r, theta, contact_angle, force, lost)
    # The arc is longer than the chord by r θ²/(10(1 − u)), half the integral of the squared angle
    # between them, and what comes after that in θ is less than the error says.
    with np.errstate(over="ignore"):
        slid_off = r * (1 + theta**2 / (10 * (1 - u)) * (1 + error)) > length
    return numbers, outcome, np.where(slid_off & ~lost, 1.0, error)


def _place(length: Array, taper: Array, r: Array) -> tuple[Array, Flags]:
    u = r / length * taper
    lost = beyond_tip(r, length, u)
    return np.where(lost, 0.0, u), lost


def _result(
    r: Array, theta: Array, contact_angle: Array, force: Array, lost: Flags
) -> tuple[Array, Codes, Array]:
    with np.errstate(over="ignore"):  # at absurd loads, where the error is 1
        axial = force * contact_angle
        square = contact_angle**2
        # Largest relative error of any signal (the transverse force's), for every taper and
        # distance, as the angle goes to zero; the tests hold it to the elastica.
        error = np.minimum(0.65 * square * (1 + square) ** 3, 1.0)
    numbers = np.stack([force * r, axial, force, r, theta, contact_angle, r, force])
    numbers[:, lost] = np.nan
    outcome = np.where(lost, Outcome.OUT_OF_REACH, Outcome.HELD).astype(np.int8)
    return numbers, outcome, np.where(lost, np.nan, error)


def moment(whisker: Whisker, radial_distance: ArrayLike, deflection_angle: ArrayLike) -> Array:
    """M = 3EI₀ θ_d (1/r − 1/A), N m: equation (2.3)."""
    refuse_hinge(whisker, "The closed form")
    push = whisker.compliance_constant * np.asarray(deflection_angle)
    return push * (1 / np.asarray(radial_distance) - np.divide(whisker.taper, whisker.length))


def signal_jacobian(
    whisker: Whisker, radial_distance: ArrayLike, deflection_angle: ArrayLike
) -> Array:
    """Derivatives (..., 3, 2) of M, Fx, Fy with respect to r (m) and θ_d (rad) at small angle.

    M = Cθ(1/r − 1/A), Fx = Cθ²(3−2u)/(2r²), Fy = Cθ(1−u)/r² with C = 3EI₀, u = r/A.
    """
    refuse_hinge(whisker, "The closed form")
    r, theta = np.asarray(radial_distance, dtype=float), np.asarray(deflection_angle, dtype=float)
    stiff, u = whisker.compliance_constant, r * np.divide(whisker.taper, whisker.length)
    push = stiff * theta
    jacobian = [
        [-push / r**2, stiff * (1 - u) / r],
        [-push * theta * (3 - u) / r**3, push * (3 - 2 * u) / r**2],
        [-push * (2 - u) / r**3, stiff * (1 - u) / r**2],
    ]
    return np.stack([np.stack(np.broadcast_arrays(*row), axis=-1) for row in jacobian], axis=-2)


def distance_from_moment(whisker: Whisker, moment: ArrayLike, deflection_angle: ArrayLike) -> Array:
    """Radial distance (m) from moment and deflection angle, or from their rates: equation (2.1).

    r = Cθ A/(Cθ + M A), which lies beyond the tip where the moment is too small for this whisker.

    Examples
    --------
    >>> w = Whisker(50e-3, 100e-6, 5e-6)
    >>> float(distance_from_moment(w, moment(w, 0.03, 0.1), 0.1).round(12))
    0.03
    """
    refuse_hinge(whisker, "The closed form")
    push = whisker.compliance_constant * np.asarray(deflection_angle, dtype=float)
    inverse_apex = np.divide(whisker.taper, whisker.length)
    return push / (push * inverse_apex + np.asarray(moment, dtype=float))


def contact_from_signals(
    whisker: Whisker, moment: ArrayLike, axial_force: ArrayLike
) -> tuple[Array, Array]:
    """Radial distance (m) and deflection angle (rad) from moment and axial force (compression).

    At small angle: the inverse of M²/(2EI₀Fx) = 3(1−u)²/(3−2u), §2f in closed form. NaN where no
    contact on this whisker gives such signals, and always on a cylinder, whose signals lie on one
    curve.

    Examples
    --------
    >>> w = Whisker(50e-3, 100e-6, 5e-6)
    >>> b = press(w, 0.03, 0.05)
    >>> r, theta = contact_from_signals(w, b.moment, b.axial_force)
    >>> round(float(r), 12), round(float(theta), 12)
    (0.03, 0.05)
    """
    refuse_hinge(whisker, "The closed form")
    m, fx = np.asarray(moment, dtype=float), np.asarray(axial_force, dtype=float)
    with np.errstate(divide="ignore", invalid="ignore"):
        g = m**2 / (2 * whisker.stiffness * fx)
        # With w = 1−u: 3w² − 2gw − g = 0, its positive root.
        w = (g + np.sqrt(g * g + 3 * g)) / 3
        inverse_apex = np.divide(whisker.taper, whisker.length)
        r = (1 - w) / inverse_apex
        theta = m / (whisker.compliance_constant * (1 / r - inverse_apex))
    good = (g > 0) & (w < 1) & (r <= whisker.length) & np.isfinite(theta)
    return np.where(good, r, np.nan), np.where(good, theta, np.nan)
