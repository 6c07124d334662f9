"""Branches of equilibria, many at a time, from the whisker at rest to the fold.

The equilibria of a contact at one distance r are a curve in y = (contact arc, force, push), the
push being the angle by which the whisker has been turned since it first touched. The curve is
followed by steps along its tangent, with Newton's method across it, on the whisker continued beyond
its tip to the apex. It ends in a fold, where the push turns back; where the contact comes to the
tip; where the force comes down to zero again and a curved whisker lets go; or at once, where at
this friction angle the object cannot move the contact at all.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from .._util.values import Array, Codes, Flags, Index
from .beam import Beams, Path, follow_each, resolve, zero_load
from .contact import Outcome
from .elastica import nodes

__all__ = [
    "FOLD", "NO_MOVE", "REACHED", "TIP", "Branches", "NotFound", "Walk", "extended", "tangents",
    "walk",
]  # fmt: skip

REACHED, FOLD, TIP, NO_MOVE = range(4)
#: Steps along a branch, in its own units: the first, the longest, and the shortest, at which a walk
#: gives up.
FIRST, LONGEST, SHORTEST = 0.05, 0.25, 1e-5


class NotFound(Exception):
    """Raised where a fold is not found."""


def extended(beams: Beams) -> Beams:
    """The whiskers continued beyond their tips to the apex, or to 2.5 lengths."""
    beyond = 2.5
    gap = beams.arc[-1] - beams.arc[-2]
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = np.where(gap > 0, (beams.radius[-1] - beams.radius[-2]) / gap, 0.0)
        apex = np.where(slope < 0, 1.0 - beams.radius[-1] / slope, beyond)
    end = np.minimum(apex, beyond)
    arc, radius = beams.arc.copy(), beams.radius.copy()
    arc[-1], radius[-1] = end, np.maximum(radius[-1] + slope * (end - 1.0), 0.0)
    core = None
    if beams.core is not None:
        core = beams.core.copy()
        core[-1] = np.minimum(core[-1], 0.9 * radius[-1])
    return Beams(arc, radius, core, beams.law)


@dataclass(frozen=True, eq=False)
class Branches:
    """Branches of n contacts at distances r (n,), in the plane of curvature and in one line.

    Points y (n, 3) are arc, force and push in units of `scale` (3, n), which shrink towards the
    apex as folds do; `rest` is the angle at first touch, `stiff` (n,) the force of the unit push at
    rest, or NaN where no force moves the contact, `last` the arc up to which branches are followed
    (without one also past the force's end), `tolerance` that of each pass, or `steps` (n,) its
    Runge–Kutta steps a piece.
    """

    #: Which signals are moments.
    moments: ClassVar[Array] = np.array([True, False, False])
    beams: Beams
    r: Array
    friction: Array
    arc: Array
    rest: Array
    scale: Array
    stiff: Array
    last: float
    tolerance: float = 1e-9
    goal: Array | float = np.inf
    steps: NDArray[np.int64] | None = None

    @classmethod
    def of(
        cls, beams: Beams, r: Array, friction: Array, last: float = 1.0, tolerance: float = 1e-9
    ) -> Branches:
        """Branches of `extended` whiskers at distances and friction angles (n,)."""
        arc, rest = zero_load(beams, r)
        path = resolve(beams, arc, np.zeros_like(r), friction, 1e-6)
        r_s, r_f, t_s, t_f = path.jacobian()
        with np.errstate(divide="ignore", invalid="ignore"):
            compliance = t_f - t_s * r_f / r_s
        gaps = np.maximum(np.diff(beams.arc, axis=0), 1e-9)
        place = np.clip((arc - beams.arc[:-1]) / gaps, 0, 1)
        width = beams.radius[0] + (place * np.diff(beams.radius, axis=0)).sum(axis=0)
        narrow = np.clip(width / beams.radius[0], 1e-6, 1.0)
        stiff = narrow / np.where(compliance > 0, compliance, np.nan)
        scale = np.stack([r * narrow, np.nan_to_num(stiff, nan=1.0), narrow])
        return cls(beams, r, friction, arc, rest, scale, stiff, last, tolerance)

    def take(self, index: Index) -> Self:
        """The branches at `index`."""
        mine = vars(self).items()
        arrays: dict[str, Any] = {k: v[..., index] for k, v in mine if isinstance(v, np.ndarray)}
        return replace(self, beams=self.beams.take(index), **arrays)

    @property
    def size(self) -> int:
        """How many numbers a point has."""
        return len(self.scale)

    @property
    def start(self) -> Array:
        """The points at rest."""
        y = np.zeros((self.r.size, self.size))
        y[:, 0] = self.arc / self.scale[0]
        return y

    def path(self, y: Array) -> Path:
        """The whiskers from their contacts to the base."""
        arc, force = y[:, :2].T * self.scale[:2]
        if self.steps is not None:
            return follow_each(self.beams, arc, force, self.friction, self.steps)
        return resolve(self.beams, arc, force, self.friction, self.tolerance)

    def linear(self, y: Array) -> tuple[Array, Array]:
        """Misses of the contact (n, size − 1), and minus their derivatives with respect to y."""
        path, push = self.path(y), y[:, 2] * self.scale[2]
        miss = np.stack([self.r - path.distance, self.rest + push - path.deflection])
        r_s, r_f, t_s, t_f = path.jacobian()
        zero, one = np.zeros_like(push), np.ones_like(push)
        slopes = np.array([[r_s, r_f, zero], [t_s, t_f, -one]]) * self.scale
        unit = self.scale[[0, 2]]
        return np.nan_to_num(miss / unit).T, (slopes / unit[:, None]).transpose(2, 0, 1)

    def signals(self, y: Array) -> Array:
        """Moment, axial and transverse force, (3, n)."""
        path, force = self.path(y), y[:, 1] * self.scale[1]
        return force * np.stack([path.lever, np.sin(path.angle), np.cos(path.angle)])

    def onset(self) -> Array:
        """Unit tangents (n, size) at rest, of a growing push."""
        tangent = tangents(self.linear(self.start)[1])
        return tangent * np.sign(tangent[:, -1:])

    # -- for every kind of branch --------------------------------------------------------------

    def corrected(self, y: Array, across: Array, steps: int) -> tuple[Array, Array, Array]:
        """Newton's method on the plane through y normal to `across`: y, slopes, last step."""
        for _ in range(steps):
            miss, slopes = self.linear(y)
            matrix = np.concatenate([slopes, across[:, None]], axis=1)
            bad = ~(np.abs(np.linalg.det(matrix)) > 1e-12)
            matrix[bad] = np.eye(self.size)
            right = np.concatenate([miss, np.zeros((len(y), 1))], axis=1)
            step = np.where(bad[:, None], 1.0, np.linalg.solve(matrix, right[..., None])[..., 0])
            y = y + np.clip(step, -0.3, 0.3)
        return y, slopes, (np.abs(step) / np.maximum(np.abs(y), 1.0)).max(axis=1)

    def ahead(self, y: Array, along: Array, h: Array, steps: int) -> tuple[Array, Array, Array]:
        """The points a step h (n,) along a tangent, their tangents, and the last step to them."""
        there, slopes, size = self.corrected(y + h[:, None] * along, along, steps)
        after = tangents(slopes)
        return there, after * np.sign((after * along).sum(axis=1))[:, None], size

    def room(self, y: Array) -> Array:
        """How far contacts are from the last place that they may come to, (n,)."""
        return self.last / self.scale[0] - y[:, 0]

    def ends(self, y: Array, along: Array) -> Array:
        """What falls through zero where branches end, (n,): slope of push, room or force."""
        out = np.minimum(along[:, -1], self.room(y))
        return np.minimum(out, y[:, 1]) if np.isfinite(self.last) else out

    def short(self, y: Array, _along: Array) -> Array:
        """What pushes lack of `goal`, (n,)."""
        return self.goal - y[:, -1]

    def tabled(self, end: Array, across: int) -> tuple[Array, Array, Array]:
        """Signals (across, S, n), arcs and pushes (across, n) at the nodes from the fold to rest.

        By Newton's method, each node from those before and from the fold.
        """
        tangent = self.onset()
        pace = tangent / tangent[:, -1:]

        def over(y: Array) -> Array:
            return np.concatenate([y[:, :1], y[:, 1:-1] / y[:, -1:]], axis=1)

        values = [over(end), np.concatenate([self.start[:, :1], pace[:, 1:-1]], axis=1)]
        cs, points = [0.0, 1.0], np.empty((across, *end.shape))
        for j, c in list(enumerate(nodes(across)))[::-1]:
            near = [0, *range(len(cs) - 1, 0, -1)[:6]]
            guess = sum(
                values[a] * np.prod([(c - cs[b]) / (cs[a] - cs[b]) for b in near if b != a])
                for a in near
            )
            push = end[:, -1] * (1 - c) * (1 + c)
            y = np.concatenate([guess[:, :1], guess[:, 1:] * push[:, None], push[:, None]], axis=1)
            upright = np.broadcast_to(np.eye(self.size)[-1], y.shape)
            for _ in range(15):
                y, _, size = self.corrected(y, upright, 1)
                if np.max(size) < 1e-7:  # the next is some square of it
                    break
            if not np.max(size) < 1e-6:
                raise NotFound
            cs.append(float(c))
            values.append(over(y))
            points[j] = y
        signals = np.stack([self.signals(y) for y in points])
        arcs, pushes = points[..., 0] * self.scale[0], points[..., -1] * self.scale[-1]
        return signals, arcs, pushes


@dataclass(frozen=True, eq=False)
class Walk:
    """Points (n, size) where walks ended, why (`end`), and where the moment was largest (`peak`).

    Walks that have not `stopped` were given up.
    """

    point: Array
    end: Codes
    peak: Array
    stopped: Flags

    @property
    def outcome(self) -> Codes:
        """What becomes of the contacts, by the index of `end`."""
        lost = Outcome.FLICKED_PAST, Outcome.SLIPPED_OFF_TIP, Outcome.STUCK
        return np.array([Outcome.HELD, *lost], dtype=np.int8)[self.end]


#: A quantity that falls through zero on the way along branches, at points and their tangents.
Measure = Callable[[Branches, Array, Array], Array]


@np.errstate(all="ignore")
def walk(branches: Branches, target: Array, *, peaks: bool = False) -> Walk:
    """Follow branches from rest to the pushes `target` (n,), rad or infinite, or to their ends.

    With `peaks` the largest moment on the way is found as well.
    """
    n, goal = branches.r.size, target / branches.scale[-1]
    # An error of 1e-4 is small beside a step.
    quick = replace(branches, tolerance=max(branches.tolerance, 1e-4))
    y, end = branches.start, np.full(n, FOLD, dtype=np.int8)
    end[~(branches.stiff > 0)] = NO_MOVE
    end[(end == FOLD) & (branches.arc >= branches.last * (1 - 1e-12))] = TIP
    stride, stopped, climbs = np.full(n, FIRST), np.zeros(n, dtype=bool), np.ones(n, dtype=bool)
    tangent, before, height = np.zeros_like(y), np.zeros((2, *y.shape)), np.zeros(n)
    highest = np.zeros(n)
    left = np.flatnonzero(end == FOLD)
    if left.size:
        tangent[left] = quick.take(left).onset()
    for _ in range(400):
        if not left.size:
            break
        part, h, here, along = quick.take(left), stride[left], y[left], tangent[left]
        there, after, size = part.ahead(here, along, h, 2)
        rise = np.maximum(along[:, -1], 0.0) * h
        good = (size < 1e-3) & ((after * along).sum(axis=1) > 0.97)
        stops = good & ((part.ends(there, after) < 0) | (there[:, -1] >= goal[left]))
        if peaks:
            falls = good & climbs[left] & (moment_slope(part, there, after) < 0)
            before[:, left[falls]] = here[falls], along[falls]
            height[left[falls]], climbs[left[falls]] = h[falls], False
        on = good & ~stops
        y[left[on]], tangent[left[on]], stopped[left[stops]] = there[on], after[on], True
        most = LONGEST * np.maximum(np.abs(there[:, 1:]).max(axis=1), 1.0)
        next_ = np.where(good, np.minimum(1.3 * h, most), h / 2)
        # The last step was over by rougher passes: by better ones it may all but be.
        stride[left] = np.where(stops, 1.02 * h, next_)
        # The highest push that the last step can hold; the end, if that is below the goal.
        highest[left] = np.maximum(here, there)[:, -1] + 2 * rise
        beyond, turned = part.room(there) < 0, after[:, -1] < 0
        highest[left[beyond & turned]] = np.inf
        end[left[stops & beyond]] = TIP
        left = left[~stops & (next_ >= SHORTEST)]
    point, at = y.copy(), np.flatnonzero(stopped & ((highest >= goal) | np.isinf(goal)))
    if at.size:
        part, pushes = branches.take(at), goal[at]
        points, along, h = root(part, y[at], tangent[at], stride[at], Branches.ends)
        tips = part.room(points) < np.minimum(np.abs(along[:, -1]), np.abs(points[:, 1]))
        end[at] = np.where(tips, TIP, FOLD)
        inside = points[:, -1] >= pushes
        hits, point[at] = at[inside], points
        end[hits] = REACHED
        if hits.size:
            part = replace(branches.take(hits), goal=pushes[inside])
            point[hits] = root(part, y[hits], tangent[hits], h[inside], Branches.short)[0]
    peak, tops = point.copy(), np.flatnonzero(~climbs)
    if tops.size:
        part = branches.take(tops)
        summit = root(part, before[0, tops], before[1, tops], height[tops], moment_slope)[0]
        early = summit[:, -1] < point[tops, -1]  # the tip may come before
        peak[tops[early]] = summit[early]
    return Walk(point, end, peak, stopped)


def root(
    branches: Branches, y: Array, along: Array, h: Array, measure: Measure
) -> tuple[Array, Array, Array]:
    """Points, tangents and steps from y, of at most h (n,), at which a measure falls to zero.

    By the secant method in a bracket (Illinois), each point from the tangent at the one before.
    Where the measure has not fallen by h, they are those of h.
    """
    low, high, at, at_low = np.zeros_like(h), h.copy(), h.copy(), measure(branches, y, along)
    point, after, _ = branches.ahead(y, along, h, 3)
    at_high, side = measure(branches, point, after), np.zeros_like(h)
    left = np.flatnonzero(at_high < 0)
    for i in range(40):
        if not left.size:
            break
        part, a, b, base = branches.take(left), at_low[left], at_high[left], along[left]
        there = low[left] + (high - low)[left] * np.clip(a / (a - b), 1e-3, 1 - 1e-3)
        pace = after[left] / (after[left] * base).sum(axis=1, keepdims=True)
        start = point[left] + (there - at[left])[:, None] * pace
        point[left], slopes, size = part.corrected(start, base, 3 if i < 2 else 1)
        new = tangents(slopes)
        after[left] = new * np.sign((new * base).sum(axis=1))[:, None]
        at[left], value = there, measure(part, point[left], after[left])
        up = value > 0
        low[left] = np.where(up, there, low[left])
        high[left] = np.where(up, high[left], there)
        again = side[left] == np.where(up, 1, -1)
        at_low[left] = np.where(up, value, np.where(again, a / 2, a))
        at_high[left] = np.where(up, np.where(again, b / 2, b), value)
        side[left] = np.where(up, 1, -1)
        near = (np.abs(value) < 1e-11) | ((high - low)[left] < 1e-12)
        left = left[~(near & (size < 1e-8))]
    return point, after, at


def moment_slope(branches: Branches, y: Array, along: Array) -> Array:
    """Derivative of the moment along a branch in the plane, (n,)."""
    path, (arc, force) = branches.path(y), along[:, :2].T * branches.scale[:2]
    d_lever = path.d_arc[1] * arc + path.d_force[1] * force
    return np.asarray(force * path.lever + y[:, 1] * branches.scale[1] * d_lever)


def tangents(slopes: Array) -> Array:
    """Unit null vectors (n, k + 1) of the matrices `slopes` (n, k, k + 1)."""
    size = slopes.shape[2]
    minors = [np.linalg.det(np.delete(slopes, k, axis=2)) * (-1) ** k for k in range(size)]
    out = np.stack(minors, axis=1)
    return out / np.linalg.norm(out, axis=1, keepdims=True)
