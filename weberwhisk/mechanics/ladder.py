"""Bend, press, flick past: one front for all rungs."""

from __future__ import annotations

from types import ModuleType

import numpy as np
from numpy.typing import ArrayLike

from .._checks import finite, one_of, positive
from ..whisker import Whisker
from . import closed_form, elastica
from .contact import Bending
from .elastica import FlickPast

_RUNGS = {"closed_form": closed_form, "elastica": elastica}
_METRES = "give metres, such as 35e-3"


def bend(
    whisker: Whisker,
    arc_length: ArrayLike,
    force: ArrayLike,
    friction_angle: ArrayLike = 0.0,
    *,
    model: str | None = None,
) -> Bending:
    """Bend a whisker by a given contact force at a given arc length.

    Parameters
    ----------
    whisker : Whisker
    arc_length : float or array
        Arc length from base to contact, m.
    force : float or array
        Contact force, N; its sign is that of the deflection.
    friction_angle : float or array
        Angle by which friction tilts the force from the normal towards the base, rad. Only 0
        is modelled so far.
    model : {"closed_form", "elastica"}, optional
        The rung to use. By default the cheapest that the scene needs: the elastica for every
        straight whisker, as its map costs no more than the closed form.

    Returns
    -------
    Bending
        Arrays of the broadcast shape; `outcome` says what became of each contact.

    Raises
    ------
    ValueError
        For input that is not finite, a distance that is not positive, an unknown model, and
        for intrinsic curvature or friction, which these rungs do not model.

    Examples
    --------
    >>> w = Whisker(length=50e-3, base_radius=100e-6, tip_radius=5e-6, youngs_modulus=3e9)
    >>> b = bend(w, arc_length=35e-3, force=8.755567343e-5)
    >>> print(f"{b.moment:.6e} N m, {np.degrees(b.contact_angle):.3f} degrees, {b.outcome.name}")
    2.311082e-06 N m, 60.000 degrees, HELD
    """
    arc = positive("arc_length", arc_length, _METRES)
    load = finite("force", force, "give newtons, such as 1e-5")
    tilt = finite("friction_angle", friction_angle, "give radians, 0 for no friction")
    if np.any(tilt != 0):
        raise ValueError(
            f"Friction is not modelled by these rungs, got friction_angle {np.max(tilt):g}; "
            "write friction_angle=0."
        )
    return _rung(whisker, model).bend(whisker, arc, load)


def press(
    whisker: Whisker,
    radial_distance: ArrayLike,
    deflection_angle: ArrayLike,
    *,
    model: str | None = None,
) -> Bending:
    """Press a whisker against a point at a given radial distance and deflection angle.

    Parameters
    ----------
    whisker : Whisker
    radial_distance : float or array
        Straight line from base to contact, m.
    deflection_angle : float or array
        Angle between the base tangent and that line, rad; its sign is that of the deflection.
    model : {"closed_form", "elastica"}, optional
        The rung to use; see `bend`.

    Returns
    -------
    Bending
        Arrays of the broadcast shape. Signals are NaN where `outcome` is not `HELD`.

    Raises
    ------
    ValueError
        As for `bend`.

    Examples
    --------
    >>> w = Whisker(length=50e-3, base_radius=100e-6, tip_radius=5e-6, youngs_modulus=3e9)
    >>> b = press(w, radial_distance=[20e-3, 40e-3, 60e-3], deflection_angle=np.radians(20))
    >>> b.outcome
    array([0, 2, 4], dtype=int8)
    """
    r = positive("radial_distance", radial_distance, _METRES)
    theta = finite("deflection_angle", deflection_angle, "give radians, such as 0.35")
    return _rung(whisker, model).press(whisker, r, theta)


def flick_past(whisker: Whisker, radial_distance: ArrayLike) -> FlickPast:
    """The largest deflection angle at a radial distance, why it ends, and the peak of the moment.

    Parameters
    ----------
    whisker : Whisker
    radial_distance : float or array
        m.

    Returns
    -------
    FlickPast

    Raises
    ------
    ValueError
        As for `bend`.

    Examples
    --------
    >>> w = Whisker(length=50e-3, base_radius=100e-6, tip_radius=5e-6, youngs_modulus=3e9)
    >>> end = flick_past(w, radial_distance=35e-3)
    >>> print(f"{np.degrees(end.deflection_angle):.2f} degrees, {end.ended_by.name}")
    24.57 degrees, FLICKED_PAST
    """
    r = positive("radial_distance", radial_distance, _METRES)
    _rung(whisker, None)
    return elastica.flick_past(whisker, r)


def signal_jacobian(
    whisker: Whisker, radial_distance: ArrayLike, deflection_angle: ArrayLike
) -> np.ndarray:
    """Derivatives of the base signals with respect to the contact.

    Parameters
    ----------
    whisker : Whisker
    radial_distance, deflection_angle : float or array
        m, rad.

    Returns
    -------
    array, shape (..., 3, 2)
        Rows moment, axial force, transverse force; columns d/dr (per m), d/dθ_d (per rad). NaN
        where the contact is not held. They grow without bound towards the fold.

    Raises
    ------
    ValueError
        As for `bend`.
    """
    r = positive("radial_distance", radial_distance, _METRES)
    theta = finite("deflection_angle", deflection_angle, "give radians, such as 0.35")
    _rung(whisker, None)
    return elastica.signal_jacobian(whisker, r, theta)


def _rung(whisker: Whisker, model: str | None) -> ModuleType:
    if np.any(np.not_equal(whisker.curvature, 0)):
        raise ValueError(
            "Intrinsic curvature is not modelled by these rungs, got curvature "
            f"{np.max(np.abs(whisker.curvature)):g} 1/m; write curvature=0."
        )
    return _RUNGS[one_of("model", model or "elastica", _RUNGS)]
