"""Bend, press, flick past: one front for all rungs."""

from __future__ import annotations

from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .._checks import finite, one_of, positive
from ..whisker import Whisker
from . import closed_form, elastica
from .contact import Bending
from .elastica import FlickPast

#: The rungs that a name can force, cheapest first.
MODELS = ("closed_form", "elastica", "profile")
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
        Angle by which friction tilts the force from the normal towards the base, rad.
    model : {"closed_form", "elastica", "profile"}, optional
        The rung to use. By default the cheapest that the scene needs: the elastica for every
        straight whisker without friction, as its map costs no more than the closed form, and the
        profile, some hundred times dearer, for intrinsic curvature and friction.

    Returns
    -------
    Bending
        Arrays of the broadcast shape; `outcome` says what became of each contact.

    Raises
    ------
    ValueError
        For input that is not finite, a distance that is not positive, an unknown model, and
        for curvature or friction on a rung that has none.

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
    name = _rung(whisker, model, tilt)
    if name == "profile":
        return _profile().bend(whisker, arc, load, tilt)
    return _STRAIGHT[name].bend(whisker, arc, load)


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
    model : {"closed_form", "elastica", "profile"}, optional
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
    name = _rung(whisker, model)
    if name == "profile":
        return _profile().press(whisker, r, theta)
    return _STRAIGHT[name].press(whisker, r, theta)


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
    if _rung(whisker, None) == "profile":
        return _profile().flick_past(whisker, r)
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
        As for `bend`, and for an intrinsically curved whisker.
    """
    r = positive("radial_distance", radial_distance, _METRES)
    theta = finite("deflection_angle", deflection_angle, "give radians, such as 0.35")
    _rung(whisker, "elastica")
    return elastica.signal_jacobian(whisker, r, theta)


_STRAIGHT: dict[str, Any] = {"closed_form": closed_form, "elastica": elastica}


def _profile() -> Any:
    """Rung 2, imported when a scene first needs it."""
    return import_module(".profile", __package__)


def _rung(whisker: Whisker, model: str | None, friction_angle: ArrayLike = 0.0) -> str:
    """The name of the rung to use."""
    needs_profile = {
        "Intrinsic curvature": (np.max(np.abs(whisker.curvature)), "1/m"),
        "Friction": (np.max(np.abs(friction_angle)), "rad"),
    }
    found = {name: value for name, value in needs_profile.items() if value[0] > 0}
    if model is None:
        return "profile" if found else "elastica"
    one_of("model", model, MODELS)
    if found and model != "profile":
        name, (size, unit) = next(iter(found.items()))
        raise ValueError(
            f"{name} is not modelled by the {model} rung, got {size:g} {unit}; "
            'write model="profile" or leave model out.'
        )
    return model
