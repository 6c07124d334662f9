"""Following a contact along a sweep, from moment and push angle alone (§2g).

While a whisker is pushed on, its contact slides along the object, tangent to it. That and the
change of the moment give the changes of r and θ_d (``docs/theory/cues.md``, Sweeping); each contact
builds on the one before. This holds for curved and rubbing whiskers, which differ in moment and
contact angle alone, but not where the tip touches. A curved whisker's θ_d starts from its angle at
rest.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .._util.checks import finite, kind, positive, refuse_hinge
from .._util.refusals import Refusal
from .._util.values import Array, Codes, Fields
from ..cues import ForceMap
from ..cues.protocol import Cue, readings
from ..mechanics import Outcome, Profile
from ..mechanics.forward import ForwardModel
from ..whisker import Whisker

__all__ = ["Track", "follow"]


@dataclass(frozen=True, eq=False, repr=False)
class Track(Fields):
    """Where a contact was along a sweep, by moment and push angle.

    Attributes
    ----------
    push_angle : array (n,)
        Rotation of the base since first contact, rad.
    radial_distance, deflection_angle : array (n,)
        m, rad; NaN where `outcome` is not `HELD`.
    path : array (n, 2)
        Contact in the world, m, whose x axis is the whisker at first contact and whose y axis
        points against the push: the recovered contour.
    outcome : array (n,) of int
        `OUT_OF_REACH` from the reading on that is not the moment of any contact on the whisker.
    """

    push_angle: Array
    radial_distance: Array
    deflection_angle: Array
    path: Array
    outcome: Codes


def follow(
    whisker: Whisker,
    push_angle: ArrayLike,
    moment: ArrayLike,
    *,
    start: tuple[float, float] | None = None,
    cue: Cue | None = None,
) -> Track:
    """The iterative update of §2g: contact after contact, from exact moments.

    The first contact is that of the compliance cue; after it each push makes the contact slide, by
    the trapezoid rule, to where the moment is the one read.

    Parameters
    ----------
    whisker : Whisker or Profile
    push_angle : array (n,)
        Ascending from above 0, rad.
    moment : array (n,)
        At the base, N m.
    start : (float, float), optional
        r (m) and θ_d (rad) at push angle 0, from another cue: of a wall, say, that the tip touches
        first. By default the whisker is at rest then, and r unknown.
    cue : Cue, optional
        ``Friction(ForceMap("moment"), angle)`` for contacts that rub at a known angle.

    Raises
    ------
    ValueError
        For push angles that do not ascend from above 0, moments that are not as many, a start that
        is not a contact, a whisker on a hinge, and a cue of anything but the moment.

    Notes
    -----
    Solomon & Hartmann's (2010, the paper's [35]) for cylinders, here for any straight taper and any
    bending. Errors of the moment are not forgotten: the estimate drifts.

    Examples
    --------
    >>> from weberwhisk.sweeping import peg, sweep
    >>> from weberwhisk.receptors import Weber
    >>> w = Whisker(50e-3, 100e-6, 5e-6)
    >>> push = np.radians([2.0, 4.0, 8.0, 16.0])
    >>> moments = sweep(w, peg(30e-3, 0.0), [-0.1, *push]).bending.moment[1:]
    >>> (follow(w, push, moments).radial_distance * 1e3).round(3)
    array([30., 30., 30., 30.])
    """
    cue = _of_moment(whisker, cue)
    forward = cue.forward(whisker, np.zeros(2))
    push, moments = _checked(push_angle, moment)
    r, theta, before = 0.0, 0.0, 0.0
    if start is not None:
        pair = readings("start", positive("start", start, "give r in m and θ_d in rad"), 2)
        r, theta = map(float, pair)
    distance, deflection = np.full((2, push.size), np.nan)
    outcome = np.full(push.size, Outcome.OUT_OF_REACH, dtype=np.int8)
    for k, angle in enumerate(push):
        if k or start is not None:
            angle_at = partial(_pushed_on, forward, r, theta, float(angle) - before)
            contact = _at_moment(forward, angle_at, float(moments[k]), near=r)
        else:
            angle_at = partial(_first_pushed, forward, float(angle))
            contact = _at_moment(forward, angle_at, float(moments[k]))
        if contact is None:
            break
        (r, theta), before = contact, float(angle)
        distance[k], deflection[k], outcome[k] = r, theta, Outcome.HELD
    world = deflection - push
    path = np.stack([distance * np.cos(world), distance * np.sin(world)], axis=-1)
    return Track(push, distance, deflection, path, outcome)


def _of_moment(whisker: Any, cue: Cue | None) -> Cue:
    """The cue, if its one signal is the moment and it has no nuisance parameters."""
    if not isinstance(whisker, Profile):
        kind("whisker", whisker, "a Whisker", "taper", "write ww.Whisker(50e-3, 100e-6, 5e-6), say")
    refuse_hinge(whisker, "A sweep")
    cue = ForceMap("moment") if cue is None else cue
    if (
        not isinstance(cue, Cue)
        or cue.signal_names != ("moment",)
        or cue.unknowns != ("radial_distance", "deflection_angle")
    ):
        raise Refusal(
            "A sweep is followed by its moment, without nuisance parameters",
            f"{cue!r}",
            'write ww.cues.ForceMap("moment"), or '
            'ww.cues.Friction(ww.cues.ForceMap("moment"), -0.3)',
        )
    return cue


def _first_pushed(forward: ForwardModel, push: float, r: Array) -> Array:
    """θ_d (n,) at distances r after the first push: the contact has not slid yet."""
    return forward.rest(r) + push


def _pushed_on(forward: ForwardModel, before: float, theta: float, push: float, r: Array) -> Array:
    """θ_d (n,) where a push makes the contact slide from (before, θ_d) to the distances r.

    By the trapezoid rule.
    """
    slip = r - before
    slope = _slope(forward, np.full_like(r, before), np.full_like(r, theta))
    slope_there = _slope(forward, r, theta + push + slope * slip)
    # Where contact is lost there is no slope: the value does not matter.
    mean = np.where(np.isfinite(slope_there), (slope + slope_there) / 2, slope)
    return theta + push + np.where(slip == 0, 0.0, mean * slip)


def _slope(forward: ForwardModel, r: Array, theta: Array) -> Array:
    """dθ_d/dr (n,) of a contact that slides: tan β/r."""
    r = np.clip(r, 1e-6 * forward.length, forward.reach)
    # The direction of the force says how the whisker lies at the contact; at no push, rest does.
    signals, _ = forward.signals(r, np.maximum(theta - forward.rest(r), 1e-9))
    beta = np.arctan2(signals[..., 1], signals[..., 2]) - forward.friction - theta
    return np.asarray(np.tan(beta) / r)


def _at_moment(
    forward: ForwardModel,
    angle_at: Callable[[Array], Array],
    moment: float,
    near: float | None = None,
) -> tuple[float, float] | None:
    """r and θ_d = angle_at(r) of the contact with this moment, the nearest to `near` if several."""
    length = forward.reach
    low, high = (1e-3 * length, length) if near is None else (near / 1.5, min(near * 1.5, length))
    for narrowed in range(12):
        r = np.linspace(low, high, 65)
        theta = angle_at(r)
        push = theta - forward.rest(r)
        signals, outcome = forward.signals(r, np.maximum(push, 0.0))
        valid = (outcome == Outcome.HELD) & (push >= 0)
        excess = np.where(valid, signals[:, 0], np.nan) - moment
        crossings = np.flatnonzero(np.sign(excess[1:]) * np.sign(excess[:-1]) <= 0)
        if not crossings.size:
            if not narrowed:
                return None
            break  # as close as rounding lets signals say
        if near is not None:
            crossings = crossings[[np.argmin(np.abs(r[crossings] - near))]]
        low, high = r[crossings[0]], r[crossings[0] + 1]
    middle = np.array([(low + high) / 2])
    return float(middle[0]), float(angle_at(middle)[0])


def _checked(push_angle: ArrayLike, moment: ArrayLike) -> tuple[Array, Array]:
    push = np.atleast_1d(positive("push_angle", push_angle, "give radians since first contact"))
    moments = np.atleast_1d(finite("moment", moment, "give newton metres, up to the last contact"))
    if push.ndim != 1 or not push.size or np.any(np.diff(push) <= 0) or moments.shape != push.shape:
        raise Refusal(
            "A sweep is one row of ascending push angles and as many moments",
            f"shapes {push.shape} and {moments.shape}",
            "write np.radians(np.arange(1, 31)) for the first, say",
        )
    return push, moments
