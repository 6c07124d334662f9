"""The branch of equilibria of an object at a fixed radial distance, from zero load to its end.

A whisker at rest meets the circle of radius r at the arc s₀ and the angle θ₀. From there the
equilibria of a point object at that distance form a curve in (contact arc, force), walked here by
steps along its tangent with corrections across it, until the deflection angle asked for is
reached, or the branch ends: in a fold, where the determinant D of `beam` changes sign; where
the force comes down to zero again and a curved whisker lets go; at the tip; or at once where at
this friction angle the object cannot move the contact at all.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._util.values import Array, Codes, Flags, Index
from .beam import Path, Rows, needed, resolve

REACHED, FOLD, TIP, NO_MOVE = range(4)
#: Steps along a branch: the first, the longest, and the shortest, where a walk gives up.
_FIRST, _LONGEST, _SHORTEST = 0.1, 0.4, 1e-5


def zero_load(rows: Rows, r: Array) -> tuple[Array, Array]:
    """Arc length and angle at which the whisker at rest first meets the radius r; NaN if never.

    Newton's method from the base outwards: r(s) rises towards the first meeting, and a whisker
    that has turned back before it (dr/ds ≤ 0) or ended never gets there.
    """
    if rows.law is None:
        return np.where(r <= 1 + 1e-12, r, np.nan), np.where(r <= 1 + 1e-12, 0.0, np.nan)
    s, theta = np.minimum(r, 1.0), np.full_like(r, np.nan)
    active = np.arange(r.size)
    for _ in range(60):
        law, arc = rows.take(active).law, s[active]
        assert law is not None
        x, y = law.point(arc)
        turn = law.turn(arc)
        distance = np.hypot(x, y)
        miss = r[active] - distance
        slope = (x * np.cos(turn) + y * np.sin(turn)) / distance
        theta[active] = np.arctan2(y, x)
        at_tip = (arc >= 1) & (miss > 0)
        # The tips that `bend` finds, to its tolerance, are touched.
        lost = (slope <= 1e-3) | (at_tip & (miss > 1e-9))
        step = np.where(lost, 0.0, miss / np.where(lost, 1.0, slope))
        done = (np.abs(miss) <= 4e-15 * r[active]) | at_tip
        s[active] = np.where(lost, np.nan, np.minimum(arc + step, 1.0))
        theta[active[lost]] = np.nan
        active = active[~(done | lost)]
        if not active.size:
            break
    return s, theta


@dataclass(frozen=True, eq=False)
class Branch:
    """The branches of n objects: fixed distance and friction, arc and force in natural units.

    A point of a branch is v = (s/r, F k)/m, k the compliance dθ_d/dF at zero load and m the
    radius at the contact over that at the base, with which fold angles shrink towards the tip.
    """

    rows: Rows
    r: Array
    friction: Array
    start: Array
    compliance: Array
    unit: Array
    tolerance: float

    @classmethod
    def of(cls, rows: Rows, r: Array, friction: Array, start: Array, tolerance: float) -> Branch:
        """The branches that leave the resting whisker at arc `start`."""
        path = resolve(rows, start, np.zeros_like(r), friction, 1e-6)
        r_s, r_f, t_s, t_f = path.jacobian()
        place = np.clip((start - rows.arc[:-1]) / np.maximum(np.diff(rows.arc, axis=0), 1e-9), 0, 1)
        width = rows.radius[0] + (place * np.diff(rows.radius, axis=0)).sum(axis=0)
        unit = np.clip(width / rows.radius[0], 1e-6, 1.0)
        return cls(rows, r, friction, start, t_f - t_s * r_f / r_s, unit, tolerance)

    def take(self, index: Index) -> Branch:
        """The branches at `index`."""
        own = vars(self).items()
        some: dict[str, Any] = {k: v[index] for k, v in own if isinstance(v, np.ndarray)}
        return replace(self, rows=self.rows.take(index), **some)

    def contact(self, v: Array) -> tuple[Array, Array]:
        """Contact arc and force at the points v (2, n)."""
        return np.minimum(v[0] * self.unit * self.r, 1.0), v[1] * self.unit / self.compliance

    @property
    def loose(self) -> Array:
        """An error (n,) that is small against a walk's steps."""
        return np.asarray(np.clip(1e-3 * self.unit, 1e-10, 1e-4))

    def path(self, v: Array, tolerance: ArrayLike, steps: NDArray[np.int64] | None = None) -> Path:
        """The pass at the points v (2, n)."""
        return resolve(self.rows, *self.contact(v), self.friction, tolerance, steps)

    def slopes(self, path: Path) -> tuple[Array, Array]:
        """Gradients of (ln r)/m and of θ_d/m to v, each (2, n)."""
        r_s, r_f, t_s, t_f = path.jacobian()
        k = self.compliance
        return np.stack([r_s, r_f / (k * self.r)]), np.stack([t_s * self.r, t_f / k])

    def onto(self, path: Path, fixed: ArrayLike = False) -> tuple[Array, Path]:
        """From the point of a pass to the branch, across it (along the force where `fixed`)."""
        up, _ = self.slopes(path)
        up[0] = np.where(fixed, 0.0, up[0])
        miss = (path.distance / self.r - 1) / self.unit
        off = -up * (miss / np.maximum((up**2).sum(0), 1e-12))
        scale = off * self.unit
        return off, path.moved(scale[0] * self.r, scale[1] / self.compliance)


def _tangent(up: Array) -> Array:
    t = np.stack([-up[1], up[0]])
    return np.asarray(t / np.hypot(*t))


# Measures that fall through zero on the way along a branch.


def stability(branch: Branch, _v: Array, path: Path, _goal: Array | None = None) -> Array:
    """D, with the sign of what the whole pass says."""
    up, across = branch.slopes(path)
    d = up[0] * across[1] - up[1] * across[0]
    return np.where(path.flips > 0, -np.abs(d), d)


def moment_slope(branch: Branch, v: Array, path: Path, _goal: Array | None = None) -> Array:
    """dM along the branch, in the direction of growing angle before the fold."""
    t = _tangent(branch.slopes(path)[0])
    d_lever = path.d_arc[1] * t[0] * branch.r + path.d_force[1] * t[1] / branch.compliance
    return np.asarray(t[1] * path.lever + v[1] * branch.unit * d_lever)


@dataclass(frozen=True, eq=False)
class Section:
    """A stretch of branch between two points, each (2, n), and the measure (n,) at either end.

    Between them the branch is followed by the cubic through both points and both tangents.
    """

    low: Array
    high: Array
    low_tangent: Array
    high_tangent: Array
    at_low: Array
    at_high: Array

    @classmethod
    def empty(cls, n: int) -> Section:
        """n stretches, not yet known."""
        low, high, low_tangent, high_tangent = np.full((4, 2, n), np.nan)
        return cls(low, high, low_tangent, high_tangent, np.full(n, np.nan), np.zeros(n))

    def put(self, index: Index, which: Flags, *values: Array) -> None:
        """Set those of the stretches at `index` that are `which`."""
        for old, new in zip(vars(self).values(), values, strict=True):
            old[..., index[which]] = new[..., which]

    def take(self, index: Index | Flags) -> Section:
        """The stretches at `index`."""
        return Section(*(value[..., index] for value in vars(self).values()))

    def __call__(self, x: Array) -> Array:
        """The points (2, n) at 0 ≤ x ≤ 1."""
        chord = self.high - self.low
        span = np.hypot(*chord)
        start, stop = self.low_tangent * span - chord, chord - self.high_tangent * span
        return np.asarray(self.low + x * chord + x * (1 - x) * ((1 - x) * start + x * stop))


@dataclass(frozen=True, eq=False)
class Walk:
    """Where walks ended: the points (2, n) and why; with the moment peak's where asked for."""

    point: Array
    end: Codes
    peak: Array


def walk(branch: Branch, target: Array, *, peaks: bool = False) -> Walk:
    """Walk branches from zero load to the angles `target` (n,), rad or infinite, or to their end.

    With `peaks` the largest moment on the way is found as well.
    """
    n = branch.r.size
    v = np.stack([branch.start / (branch.r * branch.unit), np.zeros(n)])
    end = np.full(n, FOLD, dtype=np.int8)
    moves = branch.compliance > 0
    end[~moves] = NO_MOVE
    at_once = moves & (branch.start >= 1 - 1e-12)  # it rests on the object with its very tip
    end[at_once] = TIP
    last, top = Section.empty(n), Section.empty(n)
    freed = np.zeros(n, dtype=bool)  # the force is down to zero again: no contact is left
    best = np.full(n, np.inf)  # the largest angle that the last stretch can hold

    active = np.flatnonzero(moves & ~at_once)
    here = branch.take(active)
    path = here.path(v[:, active], here.loose)
    tangent = np.zeros((2, n))
    tangent[:, active] = _tangent(here.slopes(path)[0])
    bend, step = np.zeros((2, n)), np.full(n, _FIRST)
    theta, steady, growing = np.zeros(n), np.zeros(n), np.ones(n)
    theta[active], steady[active] = path.deflection, stability(here, v[:, active], path)
    for _ in range(400):
        if not active.size:
            break
        part = branch.take(active)
        now, t, h = v[:, active], tangent[:, active], step[active]
        tip = 1 / (part.r * part.unit)
        guess = now + h * t + h**2 / 2 * bend[:, active]
        over = guess[0] > tip
        with np.errstate(divide="ignore", invalid="ignore"):
            short = np.clip((tip - now[0]) / (guess[0] - now[0]), 0.0, 1.0)
        h = np.where(over, h * short, h)
        guess = np.where(over, now + h * t + h**2 / 2 * bend[:, active], guess)
        guess[0] = np.where(over, tip, guess[0])
        off, path = part.onto(part.path(guess, part.loose), over)
        found, far = guess + off, np.hypot(*off)
        again, path = part.onto(part.path(found, part.loose), over)
        found += again
        up, across = part.slopes(path)
        new = _tangent(up)
        new = new * np.where((new * t).sum(0) < 0, -1.0, 1.0)
        tiny, straight = h < _SHORTEST, (new * t).sum(0) > 0.8
        good = (far < 0.2 * h) & (np.hypot(*again) < 0.02 * h) & straight
        good |= tiny & np.isfinite(far)
        angle = path.deflection
        sound, rise = stability(part, found, path), moment_slope(part, found, path)

        ends = now, found, t, new
        if peaks:
            falls = good & np.isnan(top.at_low[active]) & (rise < 0)
            top.put(active, falls, *ends, growing[active], rise)
        goal = target[active]
        let_go = good & (found[1] < 0)
        reached = good & ~let_go & (angle >= goal)
        folded = good & ~let_go & ~reached & (sound <= 0)
        at_tip = good & ~let_go & ~reached & ~folded & over
        last.put(active, reached, *ends, goal - theta[active], goal - angle)
        last.put(active, folded | at_tip, *ends, steady[active], sound)
        last.put(active, let_go, *ends, now[1], found[1])
        end[active[reached]], end[active[at_tip]] = REACHED, TIP
        freed[active[let_go]] = True
        fell = folded | let_go
        climb = part.unit * np.abs((across * new).sum(0)) * 2 * h
        best[active[fell]] = (np.maximum(angle, theta[active]) + climb)[fell]

        on = active[good]
        bend[:, on] = ((new - t) / np.maximum(h, _SHORTEST))[:, good]
        v[:, on], tangent[:, on] = found[:, good], new[:, good]
        theta[on], steady[on], growing[on] = angle[good], sound[good], rise[good]
        grown = np.where(far < 0.03 * h, 2.0, np.where(far < 0.1 * h, 1.2, 0.7))
        step[active] = np.where(good, np.minimum(h * grown, _LONGEST), h / 3)
        active = active[~(reached | fell | at_tip | (tiny & ~good))]

    point = np.where(np.isnan(last.high), v, last.high)
    tips = np.flatnonzero((end == TIP) & ~at_once)
    if tips.size:
        part = branch.take(tips)
        for _ in range(3):
            path = part.path(point[:, tips], part.tolerance)
            point[:, tips] += part.onto(path, True)[0]
    # A fold may lie behind the angle asked for, though the walk's points do not.
    ended = (end == FOLD) & ~np.isnan(last.at_low) & ((best >= target) | np.isinf(target))
    for measure, which in ((stability, ended & ~freed), (_push, ended & freed)):
        folds = np.flatnonzero(which)
        if not folds.size:
            continue
        part, stretch = branch.take(folds), last.take(folds)
        point[:, folds], path = refine(part, stretch, measure)
        turned = _tangent(part.slopes(path)[0])
        inside = path.deflection >= target[folds]
        end[folds[inside]] = REACHED
        goal = target[folds]
        last.put(
            folds,
            inside,
            *(stretch.low, point[:, folds], stretch.low_tangent, turned),
            *(goal - theta[folds], goal - path.deflection),
        )
    hits = np.flatnonzero(end == REACHED)
    if hits.size:
        point[:, hits], _ = refine(branch.take(hits), last.take(hits), _short_of, target[hits])
    peak = point.copy()
    tops = np.flatnonzero(np.isfinite(top.at_low))
    if tops.size:
        peak[:, tops], _ = refine(branch.take(tops), top.take(tops), moment_slope)
    return Walk(point, end, peak)


Measure = Callable[[Branch, Array, Path, Array], Array]


def refine(
    branch: Branch, stretch: Section, measure: Measure, goal: Array | None = None
) -> tuple[Array, Path]:
    """The point of a stretch where `measure` falls through zero, and its pass.

    The secant method in the coordinate x along the chord, inside the bracket that it narrows; each
    pass corrects its point across the branch and says how the branch goes on from there.
    """
    n = branch.r.size
    goal = np.zeros(n) if goal is None else goal
    low, high = np.zeros(n), np.ones(n)
    old, old_value = low.copy(), stretch.at_low.copy()
    share = old_value - stretch.at_high
    x = np.clip(np.divide(old_value, share, out=np.full(n, 0.5), where=share > 0), 0.02, 0.98)
    point, last = stretch(x), np.ones(n)
    left = np.ones(n, dtype=bool)
    path: Path | None = None
    for _ in range(25):
        active = np.flatnonzero(left)
        if not active.size:
            break
        part, span = branch.take(active), stretch.take(active)
        # Passes need to be no better than the point yet is.
        enough = np.clip(1e-4 * part.unit * last[active], part.tolerance, part.loose)
        steps = None
        if path is not None:
            steps = needed(path.steps[active], path.error[active], enough)
        across, now = part.onto(part.path(point[:, active], enough, steps))
        v = point[:, active] + across
        value = measure(part, v, now, goal[active])
        path = now if path is None else path.put(active, now)
        far, chord = np.hypot(*across), span.high - span.low
        square = (chord**2).sum(0)
        at = ((v - span.low) * chord).sum(0) / square
        tangent = _tangent(part.slopes(now)[0])
        tangent /= (tangent * chord).sum(0) / square
        # Far from the branch the measure may be that of another point: only go there.
        point[:, active] = v
        near = far < 1e-4
        active, v, at, value, far = active[near], v[:, near], at[near], value[near], far[near]
        tangent, span, exact = tangent[:, near], span.take(near), enough[near] <= part.tolerance
        above = value > 0
        low[active[above]], high[active[~above]] = at[above], at[~above]
        change = value - old_value[active]
        move = np.divide(
            -value * (at - old[active]), change, out=np.zeros_like(at), where=change != 0
        )
        old[active], old_value[active] = at, value
        # Close in, rounding and what the branch was off may put the root just outside.
        size, room = np.abs(move), high[active] - low[active]
        ahead = at + move
        inside = (ahead > low[active]) & (ahead < high[active]) | (size < 1e-3)
        ahead = np.where(inside, ahead, (low[active] + high[active]) / 2)
        beside = np.abs(ahead - at) < 0.2
        point[:, active] = np.where(beside, v + tangent * (ahead - at), span(ahead))
        noise = (size < 1e-7) & (size > 0.3 * last[active]) | (room < 1e-12)
        done = ((size < 3e-8) | noise) & (far < 1e-6) & exact
        last[active] = np.minimum(np.where(inside, size, room / 2), 1.0)
        left[active[done]] = False
    assert path is not None
    return point, path


def _push(_branch: Branch, v: Array, _path: Path, _goal: Array | None = None) -> Array:
    """The force."""
    return np.asarray(v[1])


def _short_of(_branch: Branch, _v: Array, path: Path, goal: Array) -> Array:
    """How far the angle is from the goal."""
    return goal - path.deflection
