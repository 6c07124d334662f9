"""Folds and tips of the branches of a curved or rubbing whisker, many whiskers at a time.

What `planar_surface` is built from: Newton's method from the straight elastica, to which curvature
and friction are added step by step, and along each branch from rest to its end.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .beam import Path, Rows, follow_blocks
from .chebyshev import Array, nodes, the_map, unfold
from .continuation import zero_load
from .shape import Profile

#: Where some of the whiskers that are possible have folds at their tips and some have none, tips
#: count as folds of a longer whisker, in as much of the reach as lies beyond this.
LAST = 0.97


@dataclass(frozen=True)
class Grid:
    """Rows of whiskers, one for each combination of the nodes of what is uncertain."""

    rows: Rows
    friction: Array
    taper: float

    def repeated(self, count: int) -> Grid:
        """Each row so many times, side by side."""
        return self.take(np.repeat(np.arange(self.friction.size), count))

    def take(self, index: NDArray[np.intp]) -> Grid:
        """Some of the rows."""
        return Grid(self.rows.take(index), self.friction[index], self.taper)

    def eased(self, share: float) -> Grid:
        """The same with a share of the curvature and of the friction."""
        law = self.rows.law
        assert law is not None
        eased = type(law)(*(value * share for value in vars(law).values()))
        rows = Rows(self.rows.arc, self.rows.radius, self.rows.core, eased)
        return Grid(rows, self.friction * share, self.taper)

    def path(self, arc: Array, force: Array) -> Path:
        """By 12 steps a piece: relative errors of 1e-9, and 1e-7 at thin curved tips."""
        return follow_blocks(self.rows, arc, force, self.friction, 12)

    @property
    def stages(self) -> int:
        """In how many steps a straight whisker is bent into this one."""
        law = self.rows.law
        assert law is not None
        turn = np.max(np.abs(law.turn(np.ones_like(self.friction))))
        return int(max(1, np.ceil(turn / 0.4), np.ceil(np.max(np.abs(self.friction)) / 0.15)))


def grid_of(profile: Profile, friction: Array, offset: Array, beyond: float = 2.5) -> Grid:
    """The rows in units of length, base radius and stiffness.

    They go on beyond the tip, to the apex or `beyond`.
    """
    length, radius = float(profile.whisker.length), float(profile.whisker.base_radius)
    arc, wide, core = profile.arc / length, profile.radius / radius, profile.core / radius
    # The last thousandth of a perfect cone has no stiffness to speak of.
    wide = np.append(wide[:-1], max(wide[-1], 1e-3))
    slope = (wide[-1] - wide[-2]) / (arc[-1] - arc[-2])
    end = beyond if slope >= 0 else min(1.0 - wide[-1] / slope, beyond)
    if end > 1.0:
        wide = np.append(wide[:-1], wide[-1] + slope * (end - 1.0))
        arc = np.append(arc[:-1], end)
        core = np.append(core[:-1], min(core[-1], 0.9 * wide[-1]))
    n = friction.size

    def rows(table: Array) -> Array:
        return np.repeat(np.maximum(table, 0.0)[:, None], n, axis=1)

    law = profile.law.scaled(np.asarray(length))
    parts = {name: np.full(n, float(value)) for name, value in vars(law).items()}
    if np.any(offset):
        parts["base"] = parts["base"] + offset * length
    whole = rows(core) if np.any(profile.core > 0) else None
    taper = max(1 - max(float(profile.radius[-1]) / radius, 1e-3), 0.0)
    return Grid(Rows(rows(arc), rows(wide), whole, type(law)(**parts)), friction, taper)


def _straight_fold(taper: float, r: Array) -> tuple[Array, Array]:
    """Contact arc and force at the fold of the straight taper, at distances r (n,)."""
    v = np.minimum(taper * r, 0.999)
    x = unfold(v)
    log_force, _, log_extra = the_map().contact_given(x, np.zeros_like(x))
    angle = the_map().fold_angle(v)
    return (
        r * (1 + angle**2 / (1 - v) * np.exp(log_extra)),
        3 * angle * (1 - v) / r**2 * np.exp(log_force),
    )


def _determinant(path: Path) -> Array:
    r_s, r_f, t_s, t_f = path.jacobian()
    return np.asarray(r_s * t_f - r_f * t_s)


def to_fold(grid: Grid, r: Array, s: Array, f: Array, steps: int) -> tuple[Array, Array, Array]:
    """Newton's method for the fold at distances r: contact arc, force, and the last step."""
    size = np.full(r.shape, np.inf)
    for _ in range(steps):
        h = 1e-6
        path = grid.path(s, f)
        d = _determinant(path)
        d_s = (_determinant(grid.path(s * (1 + h), f)) - d) / (s * h)
        d_f = (_determinant(grid.path(s, f * (1 + h))) - d) / (f * h)
        r_s, r_f, _, _ = path.jacobian()
        miss = r - path.distance
        whole = r_s * d_f - r_f * d_s
        room = 0.5 * np.minimum(0.4 * s, grid.rows.arc[-1] - s)
        ds = np.clip((miss * d_f + d * r_f) / whole, -room, room)
        df = np.clip((-d * r_s - miss * d_s) / whole, -0.3 * f, 0.3 * f)
        s, f = s + ds, f + df
        size = np.maximum(np.abs(ds / s), np.abs(df / f))
    return s, f, size


def folds(grid: Grid, r: Array, along: int) -> tuple[Array, Array]:
    """Contact arc and force at the folds of objects at distances r (n,), from the straight ones.

    Distances ascend, `along` of them for each whisker.
    """
    start, _ = zero_load(grid.rows, r)
    s, f = _straight_fold(grid.taper, start)
    size = np.zeros_like(r)
    stages = grid.stages
    for i in range(1, stages + 1):
        part = grid.eased(i / stages)
        assert part.rows.law is not None
        here = np.hypot(*part.rows.law.point(start)) if i < stages else r
        s, f, size = to_fold(part, here, s, f, 3 if i < stages else 6)
    # Next to thin tips the straight fold is too far off: from those further in, then.
    far = int(np.max(np.argmax(size.reshape(-1, along) > 1e-9, axis=1)))
    for j in range(far, along if far > 3 else 0):
        at = np.arange(j, r.size, along)
        near = [at - i for i in range(1, 5)]
        shares = [
            np.prod([(r[at] - r[b]) / (r[a] - r[b]) for b in near if b is not a], axis=0)
            for a in near
        ]
        s_at, f_at = (
            np.exp(sum(x * np.log(v[a]) for x, a in zip(shares, near, strict=True)))
            for v in (s, f * r**2)
        )
        part = grid.take(at)
        s[at], f[at], size[at] = to_fold(part, r[at], s_at, f_at / r[at] ** 2, 10)
    if not np.all(size < 1e-6):
        raise NotFound
    return s, f


class NotFound(Exception):
    """A fold that Newton's method does not find."""


def tip_folds(grid: Grid) -> tuple[Array, Array]:
    """Force (n,) at which the fold is met with the very tip, and the distance r* there."""
    one = np.ones(grid.friction.size)
    u = np.full(one.shape, grid.taper)
    table = the_map()
    ratio = table.fold_load(u)[0]
    load = ratio * (5.3 - 2.6 * u)
    f = load * 6 * (1 - u) ** 2 / (3 - 2 * u)
    size = one
    for i in range(1, grid.stages + 1):
        part = grid.eased(i / grid.stages)
        for _ in range(3 if i < grid.stages else 8):
            d = _determinant(part.path(one, f))
            d_f = (_determinant(part.path(one, f * (1 + 1e-6))) - d) / (f * 1e-6)
            step = np.clip(-d / d_f, -0.3 * f, 0.3 * f)
            f = f + step
            size = np.abs(step / f)
    r = grid.path(one, f).distance
    reach = reach_of(grid)
    # Strongly curved, the whisker is past its fold before any contact comes to the tip.
    found = (size < 1e-6) & (r < reach * (1 - 1e-9))
    if found.any() and not found.all() and np.min((r / reach)[found]) < LAST:
        raise NotFound
    return f, r if found.all() else reach


def turns(grid: Grid, f_star: Array) -> tuple[Array, Array]:
    """Force (n,) at which a loaded tip is farthest out, and the distance there."""
    one, f = np.ones_like(f_star), np.zeros_like(f_star)
    for _ in range(12):
        h = 1e-4 * f_star
        up, down = (grid.path(one, f + e).jacobian()[1] for e in (h, -h))
        slope, bend = (up + down) / 2, (up - down) / (2 * h)
        step = np.where(bend < 0, -slope / np.minimum(bend, -1e-300), -np.sign(slope) * f_star)
        f = np.clip(f + np.clip(step, -0.3 * f_star, 0.3 * f_star), -f_star, 0.9 * f_star)
    return f, grid.path(one, f).distance


def branch(
    grid: Grid,
    r: Array,
    ends: tuple[Array, Array],
    last: Array,
    whole: Array,
    floor: Array,
    across: int,
) -> Array:
    """Signals over the lateral force, (across, n, 3), at the nodes from the end to rest.

    Newton's method in contact arc and force, each node from those before and from the end of the
    branch, where the push is `last`; c runs from `floor` up and goes with P = `whole`.
    """
    start, rest = zero_load(grid.rows, r)
    none = np.zeros_like(r)
    r_s, r_f, t_s, t_f = grid.path(start, none).jacobian()
    s_end, f_end = ends
    unit = f_end / last
    cs = [floor, np.ones_like(r)]
    known = [(none, s_end), (np.log(1 / (t_f - t_s * r_f / r_s) / unit), start)]
    lateral = 3 * (1 - grid.taper * r / reach_of(grid)) / r**2
    out = np.empty((across, r.size, 3))
    for j, w in list(enumerate(nodes(across)))[::-1]:
        c = floor + (1 - floor) * w
        push = whole * (1 - c) * (1 + c)
        near = [0, *range(len(cs) - 1, 0, -1)[:5]]
        shares = [
            np.prod([(c - cs[b]) / (cs[a] - cs[b]) for b in near if b != a], axis=0) for a in near
        ]
        log, s = (
            np.asarray(sum(x * known[a][k] for x, a in zip(shares, near, strict=True)))
            for k in (0, 1)
        )
        f = push * unit * np.exp(np.clip(log, known[-1][0] - 0.5, known[-1][0] + 0.5))
        size = np.ones_like(r)
        for _ in range(15):
            path = grid.path(s, f)
            r_s, r_f, t_s, t_f = path.jacobian()
            d = r_s * t_f - r_f * t_s
            miss, turn = r - path.distance, rest + push - path.deflection
            ds, df = (miss * t_f - turn * r_f) / d, (turn * r_s - miss * t_s) / d
            s, f = s + np.clip(ds, -0.2 * s, 0.2 * s), f + np.clip(df, -0.8 * f, 2 * f)
            size = np.maximum(np.abs(ds / s), np.abs(df / f))
            if np.all(size < 1e-9):
                break
        if not np.all((size < 1e-4) | (push < 1e-7)):  # angles are known to 1e-15 and no better
            raise NotFound
        cs.append(c)
        known.append((np.log(f / push / unit), s))
        path = grid.path(s, f)
        pull = f / (lateral * push)
        out[j] = np.stack(
            [pull * path.lever / r, pull * np.sin(path.angle), pull * np.cos(path.angle)], axis=-1
        )
    return out


def reach_of(grid: Grid) -> Array:
    """Distance of the tip at rest."""
    law = grid.rows.law
    assert law is not None
    return np.hypot(*law.point(np.ones(grid.friction.size)))


def on_tip(grid: Grid, r: Array, f: Array, most: Array) -> Array:
    """Force at which the tip is at the distances r (n,), from guesses."""
    one = np.ones_like(r)
    for _ in range(12):
        path = grid.path(one, f)
        step = (r - path.distance) / path.jacobian()[1]
        f = np.clip(f + np.clip(step, -0.2 * most, 0.2 * most), 1e-12 * most, most)
    return f


def rise_of(grid: Grid, f_star: Array, r_star: Array, r_turn: Array, first: Array) -> Array:
    """How fast c at the tip rises beyond r*: as √(1 − tip/fold) does, so that P leaves the fold.

    Over 1 − x, x being the coordinate along; (n,).
    """
    x = 0.97
    t = first + (1 - first) * x
    r = r_turn - t**2 * (r_turn - r_star)
    rest = zero_load(grid.rows, r)[1]
    s, f, size = to_fold(grid, r, np.ones_like(r), f_star, 8)
    fold = grid.path(s, f).deflection - rest
    tip = grid.path(np.ones_like(r), on_tip(grid, r, 0.97 * f_star, f_star)).deflection - rest
    rise = np.sqrt(np.maximum(1 - tip / fold, 0.0)) / (1 - x)
    return np.where((size < 1e-6) & (rise > 0), np.clip(rise, 0.1, 0.9), 0.6)
