"""Sweeps against objects: where a whisker touches as its base turns or moves, up to flick-past.

§2g. The objects are a peg, a cylinder of finite radius and a flat wall. Flank and tip may alternate
along a sweep (see `touch`). A whisker touches at one point: a sweep ends with `TOUCHES_TWICE` where
it would lie a millionth of its length inside the object at another.

Whisking is quasi-static: the whisker is in balance at every angle, without inertia, which holds
where the base turns slowly (`analyses/gallery/quasi_static.py` says how slowly).

The base starts at the origin of the world frame; at rotation 0 its tangent is the x axis, and a
positive rotation turns it towards −y, into objects below. In the base frame the object then turns
the other way, and the deflection is positive. A base that travels instead moves towards −y.

`slid`, `rate_on_wall` and `Walls` say how a contact slips along a whisker, by the equations of
``docs/theory/cues.md`` (Sweeping); curvature and friction enter by the contact angle alone.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .._util.checks import finite, kind, number
from .._util.refusals import Refusal
from .._util.values import Array, Fields, Flags, member
from ..whisker import Whisker
from .contact import NUMBERS, Bending, Outcome, friction
from .profile import bend
from .shape import Profile
from .touch import Body, Touch, TouchedBody, cylinder, peg, wall

__all__ = ["Body", "Sweep", "cylinder", "peg", "sweep", "wall"]


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
    kind("body", body, "an object", "corners", "write ww.mechanics.peg(20e-3, 0.0)")
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
    found = np.tile([[1e-3], [0.0], [0.0]], n)  # arc, force, tilt
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
            found[:, k] = (1.0, v[1], v[0]) if touch.tip else (min(v[0], 1.0), v[1], 0.0)
            outcome[k], tip[k] = Outcome.HELD, touch.tip
        end = now if ended is not Outcome.HELD else np.nan
    base = profile.whisker
    force = np.maximum(found[1], 0.0) * base.force_scale
    b = bend(profile, found[0] * base.length, force, found[2] + friction_angle)
    held = outcome == Outcome.HELD
    numbers: dict[str, Any] = {
        name: np.where(held, getattr(b, name), np.nan) for name in (*NUMBERS, "error")
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


def contact_angle(forward: Any, r: Array, theta: Array) -> Array:
    """φ (...) of contacts of a `ForwardModel`, from the direction of the force; NaN if lost.

    At no push φ is that of the whisker at rest.
    """
    signals, _ = forward.signals(r, np.maximum(theta - forward.rest(r), 1e-9))
    beta = np.arctan2(signals[..., 1], signals[..., 2]) - forward.friction - theta
    return np.asarray(theta + np.mod(beta + np.pi / 2, 2 * np.pi) - np.pi / 2)


def slid(
    forward: Any, r: Array, theta: Array, slip: Array, push: Array | float
) -> tuple[Array, Array]:
    """r and θ_d (n,) after slips dr (n,) and pushes dρ: sliding, by the trapezoid rule."""
    start = slope(forward, r, theta)
    there = r + slip
    # Where contact is lost there is no slope: the value does not matter.
    end = slope(forward, there, theta + push + start * slip)
    mean = np.where(np.isfinite(end), (start + end) / 2, start)
    return there, theta + push + np.where(slip == 0, 0.0, mean * slip)


def slope(forward: Any, r: Array, theta: Array) -> Array:
    """tan β/r (n,)."""
    inside = np.clip(r, 1e-6 * forward.length, forward.reach)
    return np.asarray(np.tan(contact_angle(forward, inside, theta) - theta) / inside)


def rate_on_wall(forward: Any, r: Array, theta: Array) -> Array:
    """dr/dρ (n,) of contacts with a wall, m/rad; 0 where contact is lost."""
    r = np.clip(r, 1e-3 * forward.length, forward.reach)
    # One-sided differences, away from the largest angle and from the tip.
    step = 1e-5
    inwards = r * (1 - step)
    rest, beside = forward.rest(r), forward.rest(inwards)
    push = np.maximum(theta - rest, 1e-6 + 2 * np.abs(rest - beside))
    theta, less = rest + push, rest + push * (1 - step)
    here, there, before = contact_angle(
        forward, np.stack([r, inwards, r]), np.stack([theta, theta, less])
    )
    by_r, by_theta = (here - there) / (r - inwards), (here - before) / (theta - less)
    with np.errstate(divide="ignore", invalid="ignore"):
        rate = (1 - by_theta) / (by_r + by_theta * np.tan(here - theta) / r)
    return np.where(np.isfinite(rate), rate, 0.0)


@dataclass(frozen=True, eq=False)
class Walls:
    """Walls that a whisker meets: with its tip, at r, θ_d and β (n,), or with its flank at rest.

    A wall at the angle β to the line base → tip at first contact touches the tip until the bent
    whisker has this β, then the flank. `rest` holds distances of walls from the base and the r at
    which the flank touches them, (m,) each.
    """

    r: Array
    theta: Array
    beta: Array
    rest: tuple[Array, Array]

    @classmethod
    def of(cls, forward: Any) -> Walls:
        """Walls for a `ForwardModel` whose tip is not pushed outwards by more than 0.01 rad."""
        unknown = len({*forward.friction_range}) > 1 or len({*forward.offset_range}) > 1
        reach = forward.reach * (1 - 1e-12)
        if unknown or forward.limit(np.array([reach]))[0] > 0.01:
            raise Refusal(
                "A tip that meets an object may go further out than it reaches at rest",
                f"{forward.whisker!r}{' with friction or curvature unknown' * unknown}",
                "write prior=scipy.stats.uniform(...) of the distances at which the "
                "flank is touched, or slip_rate=0 for a peg",
            )
        r = np.linspace(1e-3, 1.0, 201) * reach
        rest = forward.rest(r)
        depth = r * np.sin(contact_angle(forward, r, rest) - rest)
        flank = np.maximum.accumulate(depth), r
        # Contacts of the tip, from rest on to a millionth of the push before it slips off.
        r = forward.reach * (1 - 1e-15) * (1 - np.linspace(0.0, 1.0, 401)[:-1] ** 2)
        push = np.nan_to_num(forward.limit(r)) * (1 - 1e-6)
        tip = forward.signals(r, push * (1 + 2e-6))[1] == Outcome.SLIPPED_OFF_TIP
        tip[0] = True
        r, push = r[tip], push[tip]
        push[0] = 0.0
        theta = forward.rest(r) + push
        return cls(r, theta, contact_angle(forward, r, theta) - theta, flank)

    def met(self, angle: Array) -> tuple[Array, Array]:
        """r (n,) at which walls are met, and the turn up to which the tip touches; −∞: the flank.

        The sine of `angle` is a wall's distance from the base over that of the tip.
        """
        flank = angle < self.beta[0]
        turned = np.interp(angle, self.beta, self.theta - self.theta[0], right=np.inf)
        place = np.interp(np.sin(angle) * self.r[0], *self.rest)
        return np.where(flank, place, self.r[0]), np.where(flank, -np.inf, turned)
