"""Sweeps against objects: where a whisker touches as its base rotates, up to flick-past.

§2g. A peg, a cylinder of finite radius, a flat wall and a convex contour are all *rounded
polygons*: corners, straight edges between them, and one radius of rounding. A whisker touches a
corner's arc or an edge with its flank, tangentially, or an object with its tip, whose force is
normal to the object instead of the whisker; which of these it is changes along a sweep.

Whisking is quasi-static here: the whisker is in balance at every angle, without inertia. It is
then a good model where the base turns slowly against the first natural period (`modes`).

The base is at the origin of the world frame; at rotation 0 its tangent is the x axis, and a
positive rotation turns it towards −y, into objects below. In the base frame the object then turns
the other way, and the deflection is positive.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .._checks import finite
from ..whisker import Whisker
from .bodies import Body, contour, cylinder, peg, wall
from .branch import rest_point
from .chebyshev import Array
from .contact import Bending, Outcome
from .profile import bend
from .shape import Profile
from .trajectory import Rows, follow, pilot, rows_of

__all__ = ["Body", "Sweep", "contour", "cylinder", "peg", "sweep", "wall"]

_SMALLEST = 1e-6


@dataclass(frozen=True, eq=False)
class Sweep:
    """One sweep of a whisker against an object.

    Attributes
    ----------
    rotation : array (n,)
        Rotation of the base, rad.
    bending : Bending
        Signals, contact in the base frame, and outcome at each angle. `OUT_OF_REACH` before the
        first contact; NaN from flick-past on.
    contact : array (n, 2)
        Path of the contact in the world, m.
    tip : array (n,) of bool
        Whether it is the tip that touches.
    first_contact, end : float
        Rotation at first contact and at the end, rad; NaN if never reached.
    ended_by : Outcome
        `HELD` where the sweep ended still in contact.
    """

    rotation: Array
    bending: Bending
    contact: Array
    tip: Any
    first_contact: float
    end: float
    ended_by: Outcome


@dataclass(frozen=True)
class _Touch:
    """A way to touch: feature 2i is corner i, 2i + 1 the edge after it; flank or tip."""

    feature: int
    tip: bool


class _Contact:
    """The equations of one whisker on one body, in units of the length and EI₀/L²."""

    def __init__(self, profile: Profile, body: Body, friction: float) -> None:
        self.rows: Rows = rows_of(profile, (1,))
        length = float(profile.whisker.length)
        self.corners, self.radius = body.corners / length, body.radius / length
        self.friction = friction
        step = np.diff(np.vstack([self.corners, self.corners[:1]]), axis=0)
        self.edges = np.arctan2(step[:, 1], step[:, 0])
        self.spans = np.hypot(step[:, 0], step[:, 1])

    def state(self, touch: _Touch, v: Array) -> tuple[Array, Array, Array, Array, Array]:
        """Contact x, y and angle, the angle of the object's tangent there, and the force."""
        m = v.shape[1]
        arc = np.ones(m) if touch.tip else np.minimum(v[0], 1.0)
        tilt = v[0] if touch.tip else np.zeros(m)
        rows = self.rows.take(np.zeros(m, dtype=int))
        with np.errstate(all="ignore"):
            path = follow(rows, arc, np.abs(v[1]), tilt + self.friction, 5 * pilot(rows))
        angle, (c, s) = path.angle, (np.cos(path.angle), np.sin(path.angle))
        x, y = path.lever * c - path.along * s, path.lever * s + path.along * c
        return x, y, angle - tilt - self.friction, angle - self.friction, v[1]

    def miss(self, touch: _Touch, v: Array, rotation: float) -> Array:
        """The two equations, (2, m)."""
        x, y, _, tangent, _ = self.state(touch, v)
        corner = self.corners[touch.feature // 2]
        c, s = np.cos(rotation), np.sin(rotation)
        off_x = x + self.radius * np.sin(tangent) - (corner[0] * c - corner[1] * s)
        off_y = y - self.radius * np.cos(tangent) - (corner[0] * s + corner[1] * c)
        if touch.feature % 2 == 0:
            return np.stack([off_x, off_y])
        edge = self.edges[touch.feature // 2] + rotation
        return np.stack([np.sin(tangent - edge), -off_x * np.sin(edge) + off_y * np.cos(edge)])

    def solve(self, touch: _Touch, v: Array, rotation: float) -> tuple[Array, float] | None:
        """Newton's method; the point and the sign of its Jacobian, or None."""
        step = 1e-6
        for _ in range(7):
            f_step = step * max(1.0, abs(v[1]))
            probes = v[:, None] + np.array([[0, -step, 0], [0, 0, f_step]])
            f = self.miss(touch, probes, rotation)
            if not np.all(np.isfinite(f)):
                return None
            jacobian = np.stack([(f[:, 0] - f[:, 1]) / step, (f[:, 2] - f[:, 0]) / f_step], axis=1)
            det = np.linalg.det(jacobian)
            if det == 0:
                return None
            move = np.linalg.solve(jacobian, f[:, 0])
            v = v - move
            if abs(move[0]) > 0.3 or not np.all(np.isfinite(v)):
                return None
            if np.max(np.abs(move) / np.maximum(np.abs(v), [1.0, 0.1])) < 1e-10:
                return v, float(np.sign(det))
        return None

    def next_touch(self, touch: _Touch, v: Array, rotation: float) -> _Touch | Outcome | None:
        """None if this touch is valid, else what it turns into."""
        if not touch.tip and v[0] > 1 + 1e-9:
            return Outcome.SLIPPED_OFF_TIP
        if v[1] < -1e-9:
            return Outcome.OUT_OF_REACH
        if touch.tip and v[0] < -1e-9:
            return _Touch(touch.feature, False)
        x, y, _, tangent, _ = (float(part[0]) for part in self.state(touch, v[:, None]))
        i, k = touch.feature // 2, len(self.corners)
        if touch.feature % 2:
            c, s = np.cos(rotation), np.sin(rotation)
            corner = self.corners[i]
            edge = self.edges[i] + rotation
            along = (x - corner[0] * c + corner[1] * s) * np.cos(edge)
            along += (y - corner[0] * s - corner[1] * c) * np.sin(edge)
            if along > self.spans[i]:
                return _Touch(2 * ((i + 1) % k), touch.tip)
            return _Touch(2 * i, touch.tip) if along < 0 else None
        if k == 1:
            return None
        after = _turn(tangent - rotation - self.edges[i])
        before = _turn(tangent - rotation - self.edges[i - 1])
        if after < -1e-9:
            return _Touch(2 * i + 1, touch.tip)
        return _Touch(2 * ((i - 1) % k) + 1, touch.tip) if before > 1e-9 else None

    def first(self, begin: float) -> tuple[float, _Touch, Array] | None:
        """Rotation from `begin` on, touch and start of the first contact, the whisker at rest."""
        n = 4001
        s = np.linspace(0, 1, n)
        rows = self.rows.take(np.zeros(n, dtype=int))
        x, y = rest_point(rows.law, s) if rows.law else (s, np.zeros(n))
        rest_r, rest_angle = np.hypot(x, y), np.arctan2(y, x)
        end = int(np.argmax(rest_r)) + 1  # a whisker that curls back is touched before it does
        places, features = self._outline(rest_r[end - 1])
        r, angle = np.hypot(*places), np.arctan2(places[1], places[0])
        reach = r <= rest_r[end - 1] * (1 + 1e-12)
        if not np.any(reach):
            return None
        needed = _turn(np.interp(r, rest_r[:end], rest_angle[:end]) - angle)
        needed = begin + (needed - begin + 1e-12) % (2 * np.pi) - 1e-12
        needed = np.where(reach, needed, np.inf)
        rotation = float(np.min(needed))
        # A point may belong to an edge and to its corner: which one touches, the tangents say.
        for at in np.flatnonzero(needed <= rotation + 1e-10):
            feature, arc = int(features[at]), float(np.interp(r[at], rest_r[:end], s[:end]))
            tangent = float(self.rows.law.turn(np.array([arc]))[0]) if self.rows.law else 0.0
            tilt = float(_turn(self._tangent_at(places[:, at], feature) + rotation - tangent))
            flat = abs(tilt) < 1e-6
            if arc > 1 - 1e-6 and 1e-6 < tilt < np.pi / 2 and (feature % 2 or self.radius > 0):
                return rotation, _Touch(feature, True), np.array([tilt, 0.0])
            if flat or (feature % 2 == 0 and (self.radius == 0 or abs(tilt) < 0.02)):
                return rotation, _Touch(feature, False), np.array([arc, 0.0])
        return None

    def _outline(self, reach: float) -> tuple[Array, Array]:
        """Points of the object's outline, (2, m), and their features, within reach as well."""
        places, features = [], []
        k = len(self.corners)
        for i in range(k):
            high = self.edges[i - 1] if k > 1 else np.pi
            low = high - (_turn(high - self.edges[i]) % (2 * np.pi) if k > 1 else 2 * np.pi)
            t = np.linspace(low, high, 4001 if self.radius else 1)
            arc = self.corners[i][:, None] + self.radius * np.stack([-np.sin(t), np.cos(t)])
            places.append(arc)
            features += [2 * i] * arc.shape[1]
            if k == 1:
                continue
            edge = np.array([np.cos(self.edges[i]), np.sin(self.edges[i])])
            start = self.corners[i] + self.radius * np.array([-edge[1], edge[0]])
            # Where the edge leaves the whisker's reach is where a tip would meet it.
            middle, gap = -start @ edge, abs(start[1] * edge[0] - start[0] * edge[1])
            half = np.sqrt(max(reach**2 - gap**2, 0.0))
            t = np.clip(np.linspace(middle - half, middle + half, 4001), 0, self.spans[i])
            places.append(start[:, None] + t * edge[:, None])
            features += [2 * i + 1] * t.size
        return np.concatenate(places, axis=1), np.array(features)

    def covers_base(self) -> bool:
        """Whether the origin is inside the body."""
        if len(self.corners) == 1:
            return bool(np.hypot(*self.corners[0]) <= self.radius)
        normals = np.stack([-np.sin(self.edges), np.cos(self.edges)], axis=1)
        depth = -(self.corners * normals).sum(axis=1)
        if len(self.corners) == 2:  # a wall: solid below
            return bool(depth[0] <= self.radius)
        return bool(np.all(depth <= self.radius))

    def _tangent_at(self, place: Array, feature: int) -> float:
        if feature % 2:
            return float(self.edges[feature // 2])
        out = place - self.corners[feature // 2]
        return float(np.arctan2(-out[0], out[1]))


def _turn(angle: Any) -> Any:
    """The angle brought to (−π, π]."""
    return -((-angle + np.pi) % (2 * np.pi) - np.pi)


def sweep(
    whisker: Whisker | Profile,
    body: Body,
    rotation: ArrayLike,
    friction_angle: float = 0.0,
) -> Sweep:
    """Rotate the base of one whisker against an object, quasi-statically.

    Parameters
    ----------
    whisker : Whisker or Profile
        One whisker: scalar fields.
    body : Body
        Made by `peg`, `cylinder`, `wall` or `contour`.
    rotation : array (n,)
        Angles of the base at which to report, rad, ascending, from before the first contact.
    friction_angle : float
        As for `bend`; negative while a whisker is pressed harder.

    Returns
    -------
    Sweep

    Raises
    ------
    ValueError
        For angles that do not ascend, several whiskers at once, and what `bend` refuses.

    Examples
    --------
    >>> w = Whisker(50e-3, 100e-6, 5e-6, 3e9)
    >>> s = sweep(w, peg(35e-3, 0.0), np.radians([-5, 5, 15, 25]))
    >>> s.bending.outcome
    array([4, 0, 0, 2], dtype=int8)
    >>> print(np.degrees(s.end).round(2), s.ended_by.name)
    24.57 FLICKED_PAST
    """
    profile = whisker if isinstance(whisker, Profile) else Profile.of(whisker)
    angles = np.atleast_1d(finite("rotation", rotation, "give radians"))
    if angles.ndim != 1 or np.any(np.diff(angles) <= 0):
        raise ValueError(
            f"rotation must be one row of ascending angles, got shape {angles.shape}; "
            "write np.linspace(0, 1, 100)."
        )
    if profile.radius.ndim != 1 or np.ndim(profile.whisker.youngs_modulus):
        raise ValueError("sweep() takes one whisker at a time, got several; call it for each.")
    contact = _Contact(profile, body, float(friction_angle))
    if contact.covers_base():
        raise ValueError(
            f"The base of the whisker must be outside the object, got a body with corners from "
            f"{body.corners.min():g} to {body.corners.max():g} m over the origin; move it."
        )
    first = contact.first(float(angles[0]))
    n = angles.size
    found = np.full((3, n), np.nan)  # arc, force, tilt
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
    held = outcome == Outcome.HELD
    base = profile.whisker
    b = bend(
        profile,
        np.where(held, found[0], 1e-3) * base.length,
        np.where(held, np.maximum(found[1], 0.0), 0.0) * base.force_scale,
        np.where(held, found[2], 0.0) + friction_angle,
    )
    numbers: dict[str, Any] = {
        name: np.where(held, value, np.nan)
        for name, value in vars(b).items()
        if name not in ("outcome", "model", "whisker")
    }
    b = replace(b, **numbers, outcome=outcome)
    world = b.deflection_angle - angles
    path = np.stack([b.radial_distance * np.cos(world), b.radial_distance * np.sin(world)], axis=-1)
    return Sweep(angles, b, path, tip, float(begin), float(end), ended)


def _advance(
    contact: _Contact,
    touch: _Touch,
    v: Array,
    sign: float,
    now: float,
    goal: float,
    last: Array,
    stride: float,
) -> tuple[_Touch, Array, float, float, Array, Outcome]:
    """One step of a sweep towards `goal`, halved until it is taken or the end is found."""
    step = min(goal - now, max(stride, 2 * _SMALLEST))
    while step > _SMALLEST:
        there = goal if step == goal - now else now + step
        solved = contact.solve(touch, v + last * step, there)
        if solved is None:
            solved = contact.solve(touch, v, there)
        if solved is not None and (sign == 0 or solved[1] == sign):
            change = contact.next_touch(touch, solved[0], there)
            jump = np.abs(solved[0] - v - last * step)
            near = jump[0] < 0.1 and jump[1] < 0.5 * abs(v[1]) + 2.0
            if change is None and near:
                return touch, solved[0], solved[1], there, (solved[0] - v) / step, Outcome.HELD
        step /= 2
    # No further this way: something else is touched from here on, or the sweep ends.
    solved = contact.solve(touch, v + last * step, now + 4 * _SMALLEST)
    change = contact.next_touch(touch, solved[0], now + 4 * _SMALLEST) if solved else None
    if isinstance(change, _Touch):
        start = np.array([1.0, v[1]]) if touch.tip and not change.tip else v
        again = contact.solve(change, start, now + 4 * _SMALLEST)
        if again is not None and contact.next_touch(change, again[0], now + 4 * _SMALLEST) is None:
            return change, again[0], 0.0, now + 4 * _SMALLEST, np.zeros(2), Outcome.HELD
    if not touch.tip and v[0] > 1 - 10 * _SMALLEST:
        return touch, v, sign, now, last, Outcome.SLIPPED_OFF_TIP
    return touch, v, sign, now, last, Outcome.FLICKED_PAST
