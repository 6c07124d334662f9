"""How a whisker touches a body, with its flank or its tip, and the equations of both.

The flank touches a circle or a wall tangentially. At the tip the force is normal to the object, not
to the whisker. Two unknowns: contact arc and force, or the tip's tilt into the object and force.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from .._util.refusals import Refusal
from .._util.values import Array
from ..mechanics import Outcome, Profile
from ..mechanics.beam import beams_of, follow, pilot
from ..mechanics.shape import bent_shape
from .objects import Body

__all__ = ["Touch", "TouchSolution", "TouchedBody"]

#: Depth in lengths at which another part of the whisker counts as touching.
OVERLAP = 1e-6


@dataclass(frozen=True)
class Touch:
    """A way to touch: with the tip or with the flank."""

    tip: bool


@dataclass(frozen=True)
class TouchSolution:
    """A point v, the sign of the Jacobian there, and the force before Newton's last step."""

    point: Array
    sign: float
    force: float


class TouchedBody:
    """The equations of one whisker on one body, in units of the length and EI₀/L².

    The base has been turned by `at`, rad, or where it `translates` moved by that towards −y.
    """

    def __init__(self, profile: Profile, body: Body, friction: float, translates: bool) -> None:
        self.profile, self.beams = profile, beams_of(profile, (1,))
        self.translates = translates
        length = float(profile.whisker.length)
        self.corners, self.radius = body.corners / length, body.radius / length
        self.body = Body(self.corners, self.radius)
        self.friction, self.is_wall = friction, len(self.corners) == 2
        step = self.corners[-1] - self.corners[0]
        self.edge = float(np.arctan2(step[1], step[0]))

    def pose(self, at: float) -> tuple[float, float]:
        """How far the base has turned, and moved."""
        return (0.0, at) if self.translates else (at, 0.0)

    def seen(self, place: Array, at: float) -> Array:
        """A place of the world in the base frame."""
        angle, shift = self.pose(at)
        c, s = np.cos(angle), np.sin(angle)
        return np.array([place[0] * c - place[1] * s, place[0] * s + place[1] * c + shift])

    def depth(self, x: Array, y: Array, at: float) -> float:
        """How deep the deepest of points of the base frame lies in the body."""
        angle, shift = self.pose(at)
        c, s = np.cos(angle), np.sin(angle)
        y = y - shift
        return float(np.max(self.body.depth(c * x + s * y, c * y - s * x)))

    def state(self, touch: Touch, v: Array) -> tuple[Array, Array, Array]:
        """Contact x and y, and the angle of the object's tangent there."""
        m = v.shape[1]
        arc = np.ones(m) if touch.tip else np.minimum(v[0], 1.0)
        tilt = v[0] if touch.tip else np.zeros(m)
        beams = self.beams.take(np.zeros(m, dtype=int))
        with np.errstate(all="ignore"):
            path = follow(beams, arc, np.abs(v[1]), tilt + self.friction, 5 * pilot(beams))
        angle, (c, s) = path.angle, (np.cos(path.angle), np.sin(path.angle))
        x, y = path.lever * c - path.along * s, path.lever * s + path.along * c
        return x, y, angle - self.friction

    def miss(self, touch: Touch, v: Array, at: float) -> Array:
        """The two equations, (2, m)."""
        x, y, tangent = self.state(touch, v)
        corner = self.seen(self.corners[0], at)
        off_x = x + self.radius * np.sin(tangent) - corner[0]
        off_y = y - self.radius * np.cos(tangent) - corner[1]
        if not self.is_wall:
            return np.stack([off_x, off_y])
        edge = self.edge + self.pose(at)[0]
        return np.stack([np.sin(tangent - edge), -off_x * np.sin(edge) + off_y * np.cos(edge)])

    def solve(self, touch: Touch, v: Array, at: float) -> TouchSolution | None:
        """The solution by Newton's method, or None."""
        step = 1e-6
        for _ in range(7):
            f_step = step * max(1.0, abs(v[1]))
            probes = v[:, None] + np.array([[0, -step, 0], [0, 0, f_step]])
            f = self.miss(touch, probes, at)
            if not np.all(np.isfinite(f)):
                return None
            jacobian = np.stack([(f[:, 0] - f[:, 1]) / step, (f[:, 2] - f[:, 0]) / f_step], axis=1)
            det = np.linalg.det(jacobian)
            if det == 0:
                return None
            move = np.linalg.solve(jacobian, f[:, 0])
            force, v = float(v[1]), v - move
            if abs(move[0]) > 0.3 or not np.all(np.isfinite(v)):
                return None
            # The next step would be 1e-4 of this one, the error of the difference quotients.
            if np.max(np.abs(move) / np.maximum(np.abs(v), [1.0, 0.1])) < 1e-7:
                return TouchSolution(v, float(np.sign(det)), force)
        return None

    def next_touch(
        self, touch: Touch, solution: TouchSolution, at: float
    ) -> Touch | Outcome | None:
        """None if this touch is valid, else the touch that follows or the outcome that ends it."""
        first, force = solution.point
        if not touch.tip and first > 1 + 1e-9:
            return Outcome.SLIPPED_OFF_TIP
        if force < -1e-9:
            return Outcome.OUT_OF_REACH
        if touch.tip and first < -1e-9:
            return Touch(False)
        twice = self.beams.law and self._overlap(touch, solution, at) > OVERLAP
        return Outcome.TOUCHES_TWICE if twice else None

    def _overlap(self, touch: Touch, solution: TouchSolution, at: float) -> float:
        """Depth of the deepest part of the bent whisker in the object, in lengths."""
        v, whisker = solution.point, self.profile.whisker
        contact_arc = (1.0 if touch.tip else min(float(v[0]), 1.0)) * float(whisker.length)
        tilt = self.friction + (float(v[0]) if touch.tip else 0.0)
        push = abs(solution.force) * float(whisker.force_scale)
        ends = (
            np.linspace(0, contact_arc, 200),
            np.linspace(contact_arc, float(whisker.length), 100),
        )
        arc = np.unique(np.concatenate(ends))
        _, x, y = bent_shape(self.profile, arc, contact_arc, push, tilt) / float(whisker.length)
        return self.depth(x, y, at)

    def first(self, begin: float, end: float) -> tuple[float, Touch, Array] | None:
        """Pose in the range, touch and start of the first contact, the whisker at rest."""
        s = np.linspace(0, 1, 4001)
        x, y = self.beams.law.point(s) if self.beams.law else (s, np.zeros_like(s))
        if self.depth(x, y, begin) > OVERLAP:
            raise Refusal(
                "The whisker must start clear of the object",
                f"it inside at {begin:g} {'lengths' if self.translates else 'rad'}",
                "start from further back",
            )
        # Which parts of the whisker reach which places, and when: by radius, or by x.
        along, across = (x, y) if self.translates else (np.hypot(x, y), np.arctan2(y, x))
        top = int(np.argmax(along)) + 1  # parts that curl back are never the first to touch
        places = self._outline(along[top - 1])
        out, high = places if self.translates else (np.hypot(*places), np.arctan2(*places[::-1]))
        reach = (out > 0) & (out <= along[top - 1] * (1 + 1e-12))
        needed = np.interp(out, along[:top], across[:top]) - high
        if self.translates:
            reach &= needed >= begin - 1e-12
        else:
            needed = begin + (_turn(needed) - begin + 1e-12) % (2 * np.pi) - 1e-12
        needed = np.where(reach, needed, np.inf)
        first = float(np.min(needed))
        if first > end:
            return None
        turned = self.pose(first)[0]
        glancing = None  # a curved flank on an edge that touches between two points of the table
        for at in np.flatnonzero(needed <= first + 1e-10):
            arc = float(np.interp(out[at], along[:top], s[:top]))
            tangent = float(self.beams.law.turn(np.array([arc]))[0]) if self.beams.law else 0.0
            x, y = places[:, at] - self.corners[0]
            edge = self.edge if self.is_wall else np.arctan2(-x, y)
            tilt = float(_turn(edge + turned - tangent))
            flat = abs(tilt) < 1e-6
            is_peg = not self.is_wall and self.radius == 0
            if arc > 1 - 1e-6 and 1e-6 < tilt < np.pi / 2 and not is_peg:
                return first, Touch(True), np.array([tilt, 0.0])
            if flat or is_peg or (not self.is_wall and abs(tilt) < 0.02):
                return first, Touch(False), np.array([arc, 0.0])
            if abs(tilt) < 0.02 and glancing is None:
                glancing = first, Touch(False), np.array([arc, 0.0])
        return glancing

    def _outline(self, reach: float) -> Array:
        """Points of the object's outline, (2, m), within reach as well."""
        corner = self.corners[0]
        if not self.is_wall:
            t = np.linspace(-np.pi, np.pi, 4001 if self.radius else 1)
            if self.radius:  # and where the circle leaves the reach, which the tip touches
                t = np.append(t, self._crossings(corner, reach))
            return np.asarray(corner[:, None] + self.radius * np.stack([-np.sin(t), np.cos(t)]))
        edge = np.array([np.cos(self.edge), np.sin(self.edge)])
        # The tip touches the wall where the wall leaves the reach.
        if self.translates:
            low, high = np.sort((np.array([0.0, reach]) - corner[0]) / (edge[0] or 1e-12))
        else:
            middle, gap = -corner @ edge, abs(corner[1] * edge[0] - corner[0] * edge[1])
            half = np.sqrt(max(reach**2 - gap**2, 0.0))
            low, high = middle - half, middle + half
        span = np.hypot(*(self.corners[1] - corner))
        along = np.clip(np.linspace(low, high, 4001), 0, span)
        return np.asarray(corner[:, None] + along * edge[:, None])

    def _crossings(self, corner: Array, reach: float) -> Array:
        """Tangent angles at which the circle leaves the reach."""
        size, bearing = float(np.hypot(*corner)), float(np.arctan2(corner[1], corner[0]))
        if self.translates:
            share, at = (corner[0] - reach) / self.radius, 0.0
        else:
            share = (size**2 + self.radius**2 - reach**2) / (2 * size * self.radius)
            at = bearing
        if abs(share) > 1:
            return np.empty(0)
        half = np.arcsin(share)
        return at + np.array([half, np.pi - half])


def _turn(angle: Any) -> Any:
    """The angle brought to (−π, π]."""
    return -((-angle + np.pi) % (2 * np.pi) - np.pi)
