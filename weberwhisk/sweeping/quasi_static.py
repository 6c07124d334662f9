"""Sweeps against objects: where a whisker touches as its base turns or moves, up to flick-past.

§2g. The whisker is in balance at every angle, without inertia, which holds where the base turns
slowly (`analyses/gallery/quasi_static.py` says how slowly). Flank and tip may alternate along a
sweep (see `touch`). A whisker touches at one point: a sweep ends with `TOUCHES_TWICE` where it
would lie a millionth of its length inside the object at another.

The base starts at the origin of the world frame; at rotation 0 its tangent is the x axis, and a
positive rotation turns it towards −y, into objects below. In the base frame the object then turns
the other way, and the deflection is positive. A base that travels instead moves towards −y.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .._util.checks import finite, kind, number
from .._util.refusals import Refusal
from .._util.values import Array, Fields, Flags, member
from ..mechanics import Bending, Outcome, Profile
from ..mechanics.contact import NUMBERS, friction
from ..mechanics.profile import bend
from ..whisker import Whisker
from .objects import Body
from .touch import Touch, TouchedBody

__all__ = ["Sweep", "sweep"]


@dataclass(frozen=True, eq=False, repr=False)
class Sweep(Fields):
    """One sweep of a whisker against an object.

    Attributes
    ----------
    rotation, travel : array (n,)
        Rotation of the base, rad, and how far it has moved, m: one of them 0.
    bending : Bending
        Signals, contact in the base frame, and outcome at each angle. `OUT_OF_REACH` before the
        first contact; NaN from the end of the sweep on.
    contact : array (n, 2)
        Path of the contact in the world, m.
    tip : array (n,) of bool
        Whether it is the tip that touches.
    first_contact, end : float
        Rotation, rad, or travel, m, at first contact and at the end; NaN if never reached.
    ended_by : Outcome
        `HELD` where the sweep ended still in contact.
    """

    rotation: Array
    bending: Bending
    contact: Array
    tip: Flags
    first_contact: float
    end: float
    ended_by: Outcome
    travel: Array


def sweep(
    whisker: Whisker | Profile,
    body: Body,
    rotation: ArrayLike | None = None,
    friction_angle: float = 0.0,
    *,
    travel: ArrayLike | None = None,
) -> Sweep:
    """Rotate or move the base of one whisker against an object, quasi-statically.

    Parameters
    ----------
    whisker : Whisker or Profile
        One whisker: scalar fields.
    body : Body
        Made by `peg`, `cylinder` or `wall`.
    rotation : array (n,)
        Angles of the base at which to report, rad, ascending, from before the first contact.
    friction_angle : float
        As for `bend`; negative while a whisker is pressed harder.
    travel : array (n,)
        In place of angles how far the base has moved towards −y, m.

    Raises
    ------
    ValueError
        For angles or travels that do not ascend, none or both of them, a whisker that starts inside
        the object, several whiskers at once, and what `bend` refuses.

    Examples
    --------
    >>> from weberwhisk.sweeping import peg
    >>> w = Whisker(50e-3, 100e-6, 5e-6, 3e9)
    >>> s = sweep(w, peg(35e-3, 0.0), np.radians([-5, 5, 15, 25]))
    >>> s.bending.outcome
    array([4, 0, 0, 2], dtype=int8)
    >>> print(np.degrees(s.end).round(2), s.ended_by.name)
    24.57 FLICKED_PAST

    A base that moves goes away from a peg:

    >>> s = sweep(w, peg(25e-3, 0.0), travel=[-1e-3, 4e-3, 8e-3])
    >>> (s.bending.radial_distance * 1e3).round(2)
    array([  nan, 25.32, 26.25])
    """
    kind("body", body, "an object", "corners", "write ww.sweeping.peg(20e-3, 0.0)")
    profile = Profile.of(whisker)
    given = travel if rotation is None else rotation
    if given is None or (rotation is not None and travel is not None):
        raise Refusal(
            "sweep() takes rotations or travels of the base",
            "none" if given is None else "both",
            "write one of them",
        )
    moves = rotation is None
    name, unit = ("travel", "give metres") if moves else ("rotation", "give radians")
    angles = np.atleast_1d(finite(name, given, unit))
    if angles.ndim != 1 or np.any(np.diff(angles) <= 0):
        raise Refusal(
            f"{name} must be one row of ascending numbers",
            f"shape {angles.shape}",
            f"write np.linspace(0, {0.02 if moves else 1}, 100)",
        )
    if profile.radius.ndim != 1 or np.ndim(profile.whisker.youngs_modulus):
        raise Refusal("sweep() takes one whisker at a time", "several", "call it for each")
    # In radians, or in lengths.
    size = float(profile.whisker.length) if moves else 1.0
    angles = angles / size
    tilt = float(friction(number("friction_angle", friction_angle, "give radians, such as 0.2")))
    contact = TouchedBody(profile, body, tilt, moves)
    path = np.linspace(min(angles[0], 0.0), max(angles[-1], 0.0), 257) if moves else np.zeros(1)
    if np.any(body.depth(0.0, -size * path) >= 0):
        raise Refusal(
            "The base of the whisker must be outside the object",
            f"a body with corners from {body.corners.min():g} to {body.corners.max():g} m "
            f"over {'its path' if moves else 'the origin'}",
            "move it",
        )
    first = contact.first(float(angles[0]), float(angles[-1]))
    n = angles.size
    contacts = np.tile([[1e-3], [0.0], [0.0]], n)  # arc, force, tilt
    outcome = np.full(n, Outcome.OUT_OF_REACH, dtype=np.int8)
    tip = np.zeros(n, dtype=bool)
    ended, end, begin = Outcome.OUT_OF_REACH, np.nan, np.nan
    if first is not None:
        begin, touch, v = first
        now, sign, ended = begin, 0.0, Outcome.HELD
        last, stride = np.zeros(2), 0.1  # change of v per rad; longest step
        for k in np.flatnonzero(angles >= begin - 1e-12):
            while ended is Outcome.HELD and now < angles[k]:
                before = touch, now
                stepped = _advance(contact, touch, v, sign, now, angles[k], last, stride)
                touch, v, sign, now, last, ended = stepped
                taken = now - before[1]
                halved = touch == before[0] and taken < 0.99 * min(angles[k] - before[1], stride)
                stride = taken / 2 if halved else min(max(1.5 * stride, 1e-4), 0.1)
            if ended is not Outcome.HELD:
                outcome[k:] = ended
                break
            contacts[:, k] = (1.0, v[1], v[0]) if touch.tip else (min(v[0], 1.0), v[1], 0.0)
            outcome[k], tip[k] = Outcome.HELD, touch.tip
        end = now if ended is not Outcome.HELD else np.nan
    base = profile.whisker
    force = np.maximum(contacts[1], 0.0) * base.force_scale
    b = bend(profile, contacts[0] * base.length, force, contacts[2] + friction_angle)
    in_contact = outcome == Outcome.HELD
    numbers: dict[str, Any] = {
        name: np.where(in_contact, getattr(b, name), np.nan) for name in (*NUMBERS, "error")
    }
    b = replace(b, **numbers, outcome=member(Outcome, outcome))
    turned, moved = (0 * angles, size * angles) if moves else (angles, 0 * angles)
    world, r = b.deflection_angle - turned, b.radial_distance
    path = np.stack([r * np.cos(world), r * np.sin(world) - moved], axis=-1)
    return Sweep(turned, b, path, tip, size * float(begin), size * float(end), ended, moved)


def _advance(
    contact: TouchedBody,
    touch: Touch,
    v: Array,
    sign: float,
    now: float,
    goal: float,
    last: Array,
    stride: float,
) -> tuple[Touch, Array, float, float, Array, Outcome]:
    """One step of a sweep towards `goal`, halved until it is taken or the end is found."""
    smallest = 1e-6
    step = min(goal - now, max(stride, 2 * smallest))
    while True:
        there = goal if step == goal - now else now + step
        solved = contact.solve(touch, v + last * step, there)
        if solved is None:
            solved = contact.solve(touch, v, there)
        if solved is not None and (sign == 0 or solved.sign == sign):
            jump = np.abs(solved.point - v - last * step)
            near = jump[0] < 0.1 and jump[1] < 0.5 * abs(v[1]) + 2.0
            change = contact.next_touch(touch, solved, there)
            if change is None and near:
                slope = (solved.point - v) / step
                return touch, solved.point, solved.sign, there, slope, Outcome.HELD
        step /= 2
        if step <= smallest:
            break
    # No equilibrium ahead: another kind of touch begins here, or the sweep ends.
    there = now + 4 * smallest
    solved = contact.solve(touch, v + last * step, there)
    change = contact.next_touch(touch, solved, there) if solved else None
    if isinstance(change, Touch):
        start = np.array([1.0, v[1]]) if touch.tip and not change.tip else v
        again = contact.solve(change, start, there)
        if again is not None:
            after = contact.next_touch(change, again, there)
            if after is None:
                return change, again.point, 0.0, there, np.zeros(2), Outcome.HELD
            change = after
    if change is Outcome.TOUCHES_TWICE:
        return touch, v, sign, now, last, Outcome.TOUCHES_TWICE
    if not touch.tip and v[0] > 1 - 10 * smallest:
        return touch, v, sign, now, last, Outcome.SLIPPED_OFF_TIP
    return touch, v, sign, now, last, Outcome.FLICKED_PAST
