"""The branch of equilibria of an object at a fixed radial distance, from zero load to its end.

A whisker at rest meets the circle of radius r at the arc s₀ and the angle θ₀. From there the
equilibria of a point object at that distance form a curve in (contact arc, force), walked here by
steps along its tangent with corrections across it, until the deflection angle asked for is
reached, or the branch ends: in a fold, where the determinant D of `trajectory` changes sign, at
the tip, or at once where at this friction angle the object cannot move the contact at all.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .chebyshev import Array
from .shape import Law
from .trajectory import Path, Rows, resolve

REACHED, FOLD, TIP, NO_MOVE = range(4)
_LONGEST, _SHORTEST = 0.3, 1e-5


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
        x, y = rest_point(law, arc)
        turn = law.turn(arc)
        distance = np.hypot(x, y)
        miss = r[active] - distance
        slope = (x * np.cos(turn) + y * np.sin(turn)) / distance
        theta[active] = np.arctan2(y, x)
        lost = (slope <= 1e-3) | ((arc >= 1) & (miss > 1e-12))
        step = np.where(lost, 0.0, miss / np.where(lost, 1.0, slope))
        done = np.abs(miss) <= 4e-15 * r[active]
        s[active] = np.where(lost, np.nan, np.minimum(arc + step, 1.0))
        theta[active[lost]] = np.nan
        active = active[~(done | lost)]
        if not active.size:
            break
    return s, theta


def rest_point(law: Law, arc: Array) -> tuple[Array, Array]:
    """Where the points at the arc lengths `arc` of the whisker at rest lie, by quadrature."""
    winding = float(np.max(np.abs(law.turn(arc)), initial=0.0))
    x, w = np.polynomial.legendre.leggauss(10 + int(4 * winding))
    turn = law.turn((x[:, None] + 1) / 2 * arc)
    return w @ np.cos(turn) * arc / 2, w @ np.sin(turn) * arc / 2


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

    def take(self, index: NDArray[np.intp]) -> Branch:
        """The branches at `index`."""
        values = (self.r, self.friction, self.start, self.compliance, self.unit)
        r, friction, start, compliance, unit = (v[index] for v in values)
        return Branch(self.rows.take(index), r, friction, start, compliance, unit, self.tolerance)

    def contact(self, v: Array) -> tuple[Array, Array]:
        """Contact arc and force at the points v (2, n)."""
        return np.minimum(v[0] * self.unit * self.r, 1.0), v[1] * self.unit / self.compliance

    @property
    def loose(self) -> float:
        """The error that is small against a walk's steps."""
        return float(1e-6 * np.clip(10 * np.min(self.unit, initial=1.0), 1e-4, 1.0))

    def path(self, v: Array, tolerance: float) -> Path:
        """The pass at the points v (2, n)."""
        return resolve(self.rows, *self.contact(v), self.friction, tolerance)

    def slopes(self, path: Path) -> tuple[Array, Array]:
        """Gradients of (ln r)/m and of θ_d/m to v, each (2, n)."""
        r_s, r_f, t_s, t_f = path.jacobian()
        k = self.compliance
        return np.stack([r_s, r_f / (k * self.r)]), np.stack([t_s * self.r, t_f / k])

    def correct(self, v: Array, tolerance: float, count: int, fixed: Array) -> tuple[Array, Path]:
        """v brought onto the branch across it (or along the force where `fixed`)."""
        for _ in range(count):
            path = self.path(v, tolerance)
            up, _ = self.slopes(path)
            up[0] = np.where(fixed, 0.0, up[0])
            miss = (path.distance / self.r - 1) / self.unit
            v = v - up * (miss / np.maximum((up**2).sum(0), 1e-12))
        return v, self.path(v, tolerance)


def _tangent(up: Array) -> Array:
    t = np.stack([-up[1], up[0]])
    return np.asarray(t / np.hypot(*t))


def _stable(branch: Branch, path: Path) -> Array:
    """D, with the sign of what the whole pass says."""
    up, across = branch.slopes(path)
    d = up[0] * across[1] - up[1] * across[0]
    return np.where(path.flips > 0, -np.abs(d), d)


def _moment_slope(branch: Branch, v: Array, path: Path) -> Array:
    """dM along the branch, in the direction of growing angle before the fold."""
    t = _tangent(branch.slopes(path)[0])
    d_lever = path.d_arc[1] * t[0] * branch.r + path.d_force[1] * t[1] / branch.compliance
    return np.asarray(t[1] * path.lever + v[1] * branch.unit * d_lever)


@dataclass(frozen=True, eq=False)
class Walk:
    """Where walks ended: the points (2, n) and why; with the moment peak's where asked for."""

    point: Array
    end: NDArray[np.int8]
    peak: Array


def walk(branch: Branch, target: Array, *, peaks: bool = False) -> Walk:
    """Walk branches from zero load to the deflection angle `target`, or to their end.

    Parameters
    ----------
    target : array (n,)
        Deflection angle, rad; infinite to walk to the end.
    peaks : bool
        Whether to find where the moment is largest on the way, too.
    """
    n = branch.r.size
    v = np.stack([branch.start / (branch.r * branch.unit), np.zeros(n)])
    end = np.full(n, FOLD, dtype=np.int8)
    before, after = v.copy(), v.copy()
    peak_from, peak_to = np.full_like(v, np.nan), np.full_like(v, np.nan)
    moves = branch.compliance > 0
    end[~moves] = NO_MOVE
    at_once = moves & (branch.start >= 1 - 1e-12)  # it rests on the object with its very tip
    end[at_once] = TIP
    bracketed = np.zeros(n, dtype=bool)

    active = np.flatnonzero(moves & ~at_once)
    step = np.full(n, 0.1)
    direction = np.zeros((2, n))
    here = branch.take(active).path(v[:, active], branch.loose)
    for _k in range(400):
        if not active.size:
            break
        part = branch.take(active)
        now = v[:, active]
        t = _tangent(part.slopes(here)[0])
        turn = np.where((t * direction[:, active]).sum(0) < 0, -1.0, 1.0)
        t = t * turn
        h = step[active]
        tip = 1 / (part.r * part.unit)
        over = now[0] + h * t[0] > tip
        h = np.where(over, (tip - now[0]) / np.where(over, t[0], 1.0), h)
        guess = now + h * t
        guess[0] = np.where(over, tip, guess[0])
        found, path = part.correct(guess, branch.loose, 2, over)
        off = np.hypot(*(found - guess))
        good = (off < 0.25 * h + 1e-9) & (np.abs(path.distance / part.r - 1) < 1e-5 * part.unit)
        tiny = h < _SHORTEST
        good |= tiny & np.isfinite(off)
        stuck = tiny & ~good
        step[active] = np.where(
            good, np.minimum(h * np.where(off < 0.05 * h, 1.6, 1.0), _LONGEST), h / 3
        )
        theta = path.deflection
        if peaks:
            top = good & np.isnan(peak_to[0, active]) & (_moment_slope(part, found, path) < 0)
            peak_from[:, active[top]], peak_to[:, active[top]] = now[:, top], found[:, top]
        reached = good & (theta >= target[active])
        folded = good & ~reached & (_stable(part, path) <= 0)
        at_tip = good & ~reached & ~folded & over
        stop = reached | folded | at_tip | stuck
        end[active[reached]], end[active[folded]] = REACHED, FOLD
        end[active[at_tip]] = TIP
        bracketed[active[reached | folded]] = True
        before[:, active] = np.where(good & ~at_tip, now, before[:, active])
        after[:, active] = np.where(good, found, after[:, active])
        direction[:, active] = np.where(good, t, direction[:, active])
        v[:, active] = np.where(good, found, now)
        keep = ~stop
        names = vars(path)
        here = Path(**{k: np.where(good, names[k], vars(here)[k])[..., keep] for k in names})
        active = active[keep]

    point = after.copy()
    tips = np.flatnonzero((end == TIP) & ~at_once)
    if tips.size:
        fixed = np.ones(tips.size, dtype=bool)
        point[:, tips], _ = branch.take(tips).correct(after[:, tips], branch.tolerance, 3, fixed)
    folds = np.flatnonzero(bracketed & (end == FOLD))
    if folds.size:
        part = branch.take(folds)
        point[:, folds], path = refine(
            part, before[:, folds], after[:, folds], lambda b, _v, p: _stable(b, p)
        )
        inside = path.deflection >= target[folds]
        end[folds[inside]] = REACHED
        after[:, folds[inside]] = point[:, folds[inside]]
    hits = np.flatnonzero(bracketed & (end == REACHED))
    if hits.size:
        goal = target[hits]
        point[:, hits], _ = refine(
            branch.take(hits),
            before[:, hits],
            after[:, hits],
            lambda _b, _v, p: goal - p.deflection,
        )
    peak = point.copy()
    tops = np.flatnonzero(np.isfinite(peak_to[0]))
    if peaks and tops.size:
        peak[:, tops], _ = refine(
            branch.take(tops),
            peak_from[:, tops],
            peak_to[:, tops],
            lambda b, v, p: _moment_slope(b, v, p),
        )
    return Walk(point, end, peak)


def refine(
    branch: Branch,
    low: Array,
    high: Array,
    measure: Callable[[Branch, Array, Path], Array],
) -> tuple[Array, Path]:
    """The point between `low` and `high` where `measure` falls through zero, by Chandrupatla."""
    fixed = np.zeros(branch.r.size, dtype=bool)

    def at(x: Array, tolerance: float = branch.loose) -> tuple[Array, Array, Path]:
        v, path = branch.correct(low + x * (high - low), tolerance, 2, fixed)
        return measure(branch, v, path), v, path

    a, b = np.ones_like(branch.r), np.zeros_like(branch.r)
    fa, fb = at(a)[0], at(b)[0]
    c, fc = a.copy(), fa.copy()
    t = np.full_like(a, 0.5)
    for _ in range(60):
        x = a + t * (b - a)
        fx, v, path = at(x)
        same = np.sign(fx) == np.sign(fa)
        c, fc = np.where(same, a, b), np.where(same, fa, fb)
        b, fb = np.where(same, b, a), np.where(same, fb, fa)
        a, fa = x, fx
        best = np.abs(fa) < np.abs(fb)
        room = np.abs(b - a)
        if np.all((room < 1e-5) | (fa == 0)):
            break
        with np.errstate(divide="ignore", invalid="ignore"):
            xi = (a - b) / (c - b)
            phi = (fa - fb) / (fc - fb)
            quadratic = (phi**2 < xi) & ((1 - phi) ** 2 < 1 - xi)
            t = fa / (fb - fa) * fc / (fb - fc) + (c - a) / (b - a) * fa / (fc - fa) * fb / (
                fc - fb
            )
            t = np.where(quadratic & np.isfinite(t), t, 0.5)
            least = np.minimum(0.5, 2e-6 / np.maximum(room, 1e-300))
        t = np.clip(t, least, 1 - least)
    # The last digits by secants in the full tolerance.
    old = np.where(best, a, b)
    f_old, v, path = at(old, branch.tolerance)
    x = old + np.where(old < 0.5, 1e-5, -1e-5)
    for _ in range(6):
        f, v, path = at(x, branch.tolerance)
        slope = np.divide(f - f_old, x - old, out=np.zeros_like(f), where=x != old)
        move = np.divide(-f, slope, out=np.zeros_like(f), where=slope != 0)
        old, f_old = x, f
        x = x + np.where(np.abs(move) < 0.1, move, 0.0)
        if np.all(np.abs(move) < 1e-13):
            break
    _, v, path = at(x, branch.tolerance)
    return v, path
