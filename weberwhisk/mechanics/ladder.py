"""Bend, press, flick past: by the cheapest model that leaves nothing out, or by a named one."""

from __future__ import annotations

from dataclasses import replace
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .._util.checks import angle, distance, finite, one_of, positive
from .._util.refusals import Refusal, argument, named
from .._util.values import Array, Flags, member
from ..whisker import Whisker
from . import closed_form, elastica
from .contact import NUMBERS, TOLERANCE, Bending, FlickPast, Model, Outcome, friction, signals_of
from .shape import Profile

__all__ = ["bend", "flick_past", "press", "press_by", "signal_jacobian"]

#: The models that a name can force, cheapest first.
MODELS = tuple(model.name.lower() for model in Model)
_METRES = "give metres, such as 35e-3"
_NO_ROLL = "give radians, 0 for contact in plane"
_STRAIGHT: dict[str, Any] = {"closed_form": closed_form, "elastica": elastica}


def bend(
    whisker: Whisker | Profile,
    arc_length: ArrayLike,
    force: ArrayLike,
    friction_angle: ArrayLike = 0.0,
    *,
    roll: ArrayLike = 0.0,
    model: str | None = None,
    tolerance: float = TOLERANCE,
) -> Bending:
    """Bend a whisker by a given contact force at a given arc length.

    Parameters
    ----------
    whisker : Whisker or Profile
    arc_length : float or array
        Arc length from base to contact, m.
    force : float or array
        Contact force, N; its sign is that of the deflection.
    friction_angle : float or array
        Angle by which friction tilts the force from the normal towards the base, rad.
    roll : float or array
        As for `press`, where it makes no difference: a force given out of the plane of curvature
        also has a direction, which `rod.bend` takes.
    model : {"closed_form", "elastica", "profile"}, optional
        The model to use. By default the cheapest that leaves nothing out: the elastica for every
        straight whisker without friction, and the profile, some twenty times slower, for intrinsic
        curvature, other stiffness profiles and friction.
    tolerance : float
        Largest relative error of the signals where the profile integrates the equations.

    Returns
    -------
    Bending
        Arrays of the broadcast shape; `outcome` says what became of each contact.

    Raises
    ------
    ValueError
        For input that is not finite, a distance that is not positive, an unknown model, a scene
        with something that the named model leaves out, and a curved whisker that is rolled.

    Examples
    --------
    >>> w = Whisker(length=50e-3, base_radius=100e-6, tip_radius=5e-6, youngs_modulus=3e9)
    >>> b = bend(w, arc_length=35e-3, force=8.755567343e-5)
    >>> print(f"{b.moment:.6e} N m, {np.degrees(b.contact_angle):.3f} degrees, {b.outcome.name}")
    2.311082e-06 N m, 60.000 degrees, HELD
    """
    arc = positive("arc_length", arc_length, _METRES)
    load = finite("force", force, "give newtons, such as 1e-5")
    tilt = friction(friction_angle)
    hint = "write ww.mechanics.rod.bend(whisker, arc_length, force, direction, plane=...)"
    _refuse_roll(whisker, "bend", roll, hint)
    name = _model_of(whisker, model, tilt, models=MODELS[:3])
    if name in _STRAIGHT:
        return _STRAIGHT[name].bend(whisker, arc, load)
    return _module("profile").bend(whisker, arc, load, tilt, tolerance=tolerance)


def press(
    whisker: Whisker | Profile,
    radial_distance: ArrayLike,
    deflection_angle: ArrayLike,
    friction_angle: ArrayLike = 0.0,
    *,
    roll: ArrayLike = 0.0,
    model: str | None = None,
) -> Bending:
    """Press a whisker against a point at a given radial distance and deflection angle.

    Parameters
    ----------
    whisker : Whisker or Profile
    radial_distance : float or array
        Straight line from base to contact, m.
    deflection_angle : float or array
        Angle between the base tangent and that line, rad; its sign is that of the deflection. A
        curved whisker at rest lies at an angle of its own, `rest_angle`.
    friction_angle : float or array
        Angle by which friction tilts the force from the normal towards the base, rad.
    roll : float or array
        Angle about the base tangent from the plane of the push to that of the intrinsic curvature,
        rad. The object is met at the height at which the resting whisker reaches that distance;
        the deflection angle is then its azimuth. Moment and forces are those in the plane of the
        push; `rod.press` has all six.
    model : {"closed_form", "elastica", "profile", "rod"}, optional
        The model to use. By default the cheapest that leaves nothing out; `choose_model` says
        which one a noisy observer needs.

    Returns
    -------
    Bending
        Arrays of the broadcast shape. Signals are NaN where `outcome` is not `HELD`; `model` is
        the model of each scene and `error` its relative error.

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
    r, theta, tilt, turn = _scene(radial_distance, deflection_angle, friction_angle, roll)
    name = _model_of(whisker, model, tilt, turn)
    if name in _STRAIGHT:
        return _STRAIGHT[name].press(whisker, r, theta)
    if name == "profile":
        return _module("profile").press(whisker, r, theta, tilt)
    return _press_in_space(whisker, r, theta, tilt, turn)


def flick_past(
    whisker: Whisker | Profile,
    radial_distance: ArrayLike,
    friction_angle: ArrayLike = 0.0,
    *,
    side: ArrayLike = 1.0,
    roll: ArrayLike = 0.0,
) -> FlickPast:
    """The last deflection angle at a radial distance, why it ends, and the peak of the moment.

    Parameters
    ----------
    whisker : Whisker or Profile
    radial_distance : float or array
        m.
    friction_angle : float or array
        As for `press`.
    side : +1, -1 or array
        Which way the whisker is pushed.
    roll : float or array
        As for `press`, where it makes no difference: out of the plane of curvature, follow the
        outcomes of `press` as the deflection angle grows.

    Raises
    ------
    ValueError
        As for `bend`, also for a rolled curved whisker, and for a side other than 1 and -1.

    Examples
    --------
    >>> w = Whisker(length=50e-3, base_radius=100e-6, tip_radius=5e-6, youngs_modulus=3e9)
    >>> end = flick_past(w, radial_distance=35e-3)
    >>> print(f"{np.degrees(end.deflection_angle):.2f} degrees, {end.ended_by.name}")
    24.57 degrees, FLICKED_PAST
    """
    r = positive("radial_distance", radial_distance, _METRES)
    tilt = friction(friction_angle)
    sides = finite("side", side, "write 1 or -1")
    if np.any(np.abs(sides) != 1):
        raise Refusal("side must be 1 or -1", f"{np.ravel(sides)[0]:g}", "write side=1")
    hint = "write ww.press(..., roll=...) at growing deflection angles"
    _refuse_roll(whisker, "flick_past", roll, hint)
    if _model_of(whisker, None, tilt) == "profile":
        return _module("profile").flick_past(whisker, r, tilt, side=sides)
    assert isinstance(whisker, Whisker)
    r, sides = np.broadcast_arrays(r, sides)
    end = elastica.flick_past(whisker, r)
    if np.all(sides == 1):
        return end
    last, peak = (
        elastica.press(whisker, r, b.deflection_angle * sides)
        for b in (end.at_end, end.at_moment_peak)
    )
    return FlickPast(end.deflection_angle * sides, end.ended_by, last, peak)


def signal_jacobian(
    whisker: Whisker | Profile,
    radial_distance: ArrayLike,
    deflection_angle: ArrayLike,
    friction_angle: ArrayLike = 0.0,
    *,
    roll: ArrayLike = 0.0,
) -> Array:
    """Derivatives of the base signals with respect to the contact.

    Parameters
    ----------
    whisker : Whisker or Profile
    radial_distance, deflection_angle, friction_angle, roll : float or array
        m, rad; as for `press`.

    Returns
    -------
    array, shape (..., 3, 2)
        Rows moment, axial force, transverse force; columns d/dr (per m), d/dθ_d (per rad). NaN
        where contact is lost. They grow without bound towards the fold. In space they are
        differences of fourth order, good to 1e-7, and NaN within 1e-3 of where contact ends.

    Raises
    ------
    ValueError
        As for `bend`.
    """
    r, theta, tilt, turn = _scene(radial_distance, deflection_angle, friction_angle, roll)
    name = _model_of(whisker, None, tilt, turn)
    if name == "profile":
        return _module("profile").signal_jacobian(whisker, r, theta, tilt)
    if name == "elastica":
        assert isinstance(whisker, Whisker)
        return elastica.signal_jacobian(whisker, r, theta)
    columns = []
    for dr, dt in ((5e-4 * r, 0.0), (0.0, 5e-4)):
        near, back, far, farther = (
            signals_of(press(whisker, r + k * dr, theta + k * dt, tilt, roll=turn))
            for k in (1, -1, 2, -2)
        )
        rise = (8 * (near - back) - (far - farther)) / 12
        columns.append(rise / np.asarray(dr + dt)[..., None])
    return np.stack(columns, axis=-1)


def press_by(
    whisker: Whisker | Profile,
    radial_distance: ArrayLike,
    deflection_angle: ArrayLike,
    friction_angle: ArrayLike,
    roll: ArrayLike,
    model: Model,
) -> Bending:
    """`press` by a model that may leave part of the scene out.

    The closed form and the elastica take a straight taper, deflected by the *push*: the angle from
    where the whisker at rest first touches. The planar beam takes the whisker's projection on the
    plane of the push, its curvature times cos(roll), under the same push.
    """
    r, theta, tilt, turn = _scene(radial_distance, deflection_angle, friction_angle, roll)
    if model == Model.ROD:
        return _press_in_space(whisker, r, theta, tilt, turn)
    whole = Profile.of(whisker)
    push = theta - _first_touch(whole, r, turn)[0]
    lost = np.isnan(push)
    push = np.where(lost, 0.0, push)
    if model == Model.PROFILE:
        flat = whole.curved(whole.law.scaled(np.ones(()), np.cos(turn)))
        rest = np.nan_to_num(_module("profile").rest_angle(flat, r))
        bent: Bending = _module("profile").press(flat, r, rest + push, tilt)
    else:
        bare = replace(whole.whisker, curvature=0.0)
        bent = _STRAIGHT[model.name.lower()].press(bare, r, push)
    return _seen(bent, lost, theta)


def _scene(
    radial_distance: ArrayLike,
    deflection_angle: ArrayLike,
    friction_angle: ArrayLike,
    roll: ArrayLike,
) -> tuple[Array, Array, Array, Array]:
    """The arguments of `press` as checked arrays."""
    return (
        distance("radial_distance", radial_distance, _METRES),
        angle("deflection_angle", deflection_angle, "give radians, such as 0.35"),
        friction(friction_angle),
        finite("roll", roll, _NO_ROLL),
    )


def _first_touch(whole: Profile, r: Array, roll: Array) -> tuple[Array, Array]:
    """Azimuth and elevation at which the whisker at rest reaches a distance; NaN beyond."""
    rest = _module("profile").rest_angle(whole, r)
    azimuth = np.arctan2(np.sin(rest) * np.cos(roll), np.cos(rest))
    return azimuth, np.arcsin(np.sin(rest) * np.sin(roll))


def _seen(bent: Bending, lost: Flags, theta: Array) -> Bending:
    """The result of a simpler model, out of reach where `lost`, at the angle that was given."""
    shape = np.broadcast_shapes(np.shape(bent.moment), theta.shape)
    values: dict[str, Any] = {
        name: np.where(lost, np.nan, getattr(bent, name))[()] for name in (*NUMBERS, "error")
    }
    values["radial_distance"] = bent.radial_distance
    values["deflection_angle"] = np.broadcast_to(theta, shape)[()]
    outcome = np.where(lost, Outcome.OUT_OF_REACH, bent.outcome).astype(np.int8)
    return replace(bent, **values, outcome=member(Outcome, outcome))


def _press_in_space(
    whisker: Whisker | Profile, r: Array, theta: Array, tilt: Array, roll: Array
) -> Bending:
    """`press` by the rod, at the elevation at which the whisker at rest reaches that distance."""
    whole = Profile.of(whisker)
    azimuth, height = _first_touch(whole, r, roll)
    height, push = np.nan_to_num(height), theta - azimuth  # NaN: out of reach at any elevation
    direction = [np.cos(height) * np.cos(theta), np.cos(height) * np.sin(theta), np.sin(height)]
    point = r[..., None] * np.stack(np.broadcast_arrays(*direction), axis=-1)
    # A point does not say by which of the two ways round it was reached: the push does.
    b = _module("rod").press(whole, point, tilt, plane=roll, round_back=np.abs(push) > np.pi)
    # The contact angle is within half a turn of θ_d.
    slant = np.arctan2(b.tangent[..., 1], b.tangent[..., 0]) - theta
    slant = theta + (slant + np.pi) % (2 * np.pi) - np.pi
    r, theta = (np.broadcast_to(v, np.shape(b.error))[()] for v in (r, theta))
    size = np.where(push < 0, -1.0, 1.0) * b.magnitude
    return Bending(
        b.moment[..., 2], b.axial_force, b.force[..., 1], r, theta, slant, b.arc_length, size,
        b.outcome, b.model, b.error, whole.whisker,
    )  # fmt: skip


def _module(name: str) -> Any:
    """A module that a straight whisker does not need, imported when a scene first needs it."""
    return import_module(f"{__package__}.{name}")


def _refuse_roll(whisker: Whisker | Profile, name: str, roll: ArrayLike, instead: str) -> None:
    turn = finite("roll", roll, _NO_ROLL)
    if _model_of(whisker, None, 0.0, turn) == "rod":
        raise Refusal(
            f"{name} takes contact in the plane of a whisker's curvature alone",
            f"a roll of {np.max(np.abs(turn)):g} rad",
            instead,
        )


def _model_of(
    whisker: Whisker | Profile,
    model: str | None,
    friction_angle: ArrayLike,
    roll: ArrayLike = 0.0,
    models: tuple[str, ...] = MODELS,
) -> str:
    """The name of the model to use: the named one, or the cheapest that leaves nothing out."""
    needs = {}  # feature of the scene → its size and unit, and the lowest model that includes it
    if isinstance(whisker, Whisker):
        bow = np.max(np.abs(whisker.curvature))
    else:
        needs["A stiffness profile"] = (f"{len(whisker.arc)} knots", Model.PROFILE)
        bow = max(np.max(np.abs(value)) for value in vars(whisker.law).values())
    if bow > 0:
        needs["Intrinsic curvature"] = (f"{bow:g} 1/m", Model.PROFILE)
    tilt, turn = (np.max(np.abs(v), initial=0.0) for v in (friction_angle, np.sin(roll)))
    if tilt > 0:
        needs["Friction"] = (f"{tilt:g} rad", Model.PROFILE)
    if turn > 0 and bow > 0:
        needs["Roll of the plane of curvature"] = (f"{np.max(np.abs(roll)):g} rad", Model.ROD)
    lowest = max((least for _, least in needs.values()), default=Model.ELASTICA)
    if model is None:
        return lowest.name.lower()
    one_of("model", model, models)
    for what, (size, least) in needs.items():
        if Model[model.upper()] < least:
            raise Refusal(
                f"{what} is not modelled by the {model} model",
                size,
                "write "
                + argument("model", lowest.name.lower())
                + " or leave "
                + named("model")
                + " out",
            )
    return model
