"""The base signals of a curved or rubbing whisker as a surface over contacts, for posteriors.

What `surface` is to the straight elastica, this is to the planar beam: the equations are solved
once, at Chebyshev nodes, and interpolated from then on. Contacts are those that push the whisker
towards positive angles: positive curvature is contact on the convex side, negative on the concave.

At a radial distance the branch of equilibria runs from rest to the fold, or to the tip where that
comes first (from the distance r* on). Signals go as the square root of what is left to the fold.
Let P be the push at the fold, and beyond r* a curve that leaves it smoothly; the coordinate across
is then c = √(1 − push/P), from 1 at rest to the end of the branch. Along, it is r/r* below r*, and
above it √(r_turn − r), where r_turn is the largest distance that a loaded tip gets to: there the
last push has its own square root. Signals are tabled over the small-angle lateral force of the
straight taper. Whatever may be uncertain (friction, curvature) is one more Chebyshev axis.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..whisker import Whisker
from . import profile as planar
from .beam import Path, Rows, follow_blocks
from .chebyshev import Array, ChebyshevTable, basis, fit, nodes, product, the_map, unfold
from .contact import Outcome
from .continuation import zero_load
from .shape import Profile, Spiral

#: Runge–Kutta steps a piece: relative errors of 1e-9, and 1e-7 at thin curved tips.
STEPS = 12
#: How far a whisker is thought to go on beyond its tip, over its length: to its apex, or so far.
BEYOND = 2.5
#: Nodes along and across, more where they are needed, and along each axis of what is uncertain.
SIZES, UNCERTAIN = ((20, 14), (32, 18)), 7
#: Error over the lateral force that is small enough: a thousandth of a Weber fraction of 0.01.
ENOUGH = 1e-5
#: Where some of the whiskers that are possible have folds at their tips and some have none, tips
#: count as folds of a longer whisker, in as much of the reach as lies beyond this.
LAST = 0.97
#: Largest turn of the whisker at rest, rad: tables are made for whiskers that do not wind.
MOST_TURN = 2.0


@dataclass(frozen=True)
class _Grid:
    """Rows of whiskers, one for each combination of the nodes of what is uncertain."""

    rows: Rows
    friction: Array
    taper: float

    def repeated(self, count: int) -> _Grid:
        """Each row so many times, side by side."""
        return self.take(np.repeat(np.arange(self.friction.size), count))

    def take(self, index: NDArray[np.intp]) -> _Grid:
        """Some of the rows."""
        return _Grid(self.rows.take(index), self.friction[index], self.taper)

    def eased(self, share: float) -> _Grid:
        """The same with a share of the curvature and of the friction."""
        law = self.rows.law
        assert law is not None
        eased = type(law)(*(value * share for value in vars(law).values()))
        rows = Rows(self.rows.arc, self.rows.radius, self.rows.core, eased)
        return _Grid(rows, self.friction * share, self.taper)

    def path(self, arc: Array, force: Array) -> Path:
        return follow_blocks(self.rows, arc, force, self.friction, STEPS)

    @property
    def stages(self) -> int:
        """In how many steps a straight whisker is bent into this one."""
        law = self.rows.law
        assert law is not None
        turn = np.max(np.abs(law.turn(np.ones_like(self.friction))))
        return int(max(1, np.ceil(turn / 0.4), np.ceil(np.max(np.abs(self.friction)) / 0.15)))


def _grid(profile: Profile, friction: Array, offset: Array) -> _Grid:
    """The rows in units of length, base radius and stiffness, extended beyond the tip."""
    length, radius = float(profile.whisker.length), float(profile.whisker.base_radius)
    arc, wide, core = profile.arc / length, profile.radius / radius, profile.core / radius
    # The last thousandth of a perfect cone has no stiffness to speak of.
    wide = np.append(wide[:-1], max(wide[-1], 1e-3))
    slope = (wide[-1] - wide[-2]) / (arc[-1] - arc[-2])
    end = BEYOND if slope >= 0 else min(1.0 - wide[-1] / slope, BEYOND)
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
    return _Grid(Rows(rows(arc), rows(wide), whole, type(law)(**parts)), friction, taper)


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


def _to_fold(grid: _Grid, r: Array, s: Array, f: Array, steps: int) -> tuple[Array, Array, Array]:
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


def _folds(grid: _Grid, r: Array, along: int) -> tuple[Array, Array]:
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
        s, f, size = _to_fold(part, here, s, f, 3 if i < stages else 6)
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
        s[at], f[at], size[at] = _to_fold(part, r[at], s_at, f_at / r[at] ** 2, 10)
    if not np.all(size < 1e-6):
        raise _NotFound
    return s, f


class _NotFound(Exception):
    """A fold that Newton's method does not find."""


def _tip_folds(grid: _Grid) -> tuple[Array, Array]:
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
    reach = _reach(grid)
    # Strongly curved, the whisker is past its fold before any contact comes to the tip.
    found = (size < 1e-6) & (r < reach * (1 - 1e-9))
    if found.any() and not found.all() and np.min((r / reach)[found]) < LAST:
        raise _NotFound
    return f, r if found.all() else reach


def _turns(grid: _Grid, f_star: Array) -> tuple[Array, Array]:
    """Force (n,) at which a loaded tip is farthest out, and the distance there."""
    one, f = np.ones_like(f_star), np.zeros_like(f_star)
    for _ in range(12):
        h = 1e-4 * f_star
        up, down = (grid.path(one, f + e).jacobian()[1] for e in (h, -h))
        slope, bend = (up + down) / 2, (up - down) / (2 * h)
        step = np.where(bend < 0, -slope / np.minimum(bend, -1e-300), -np.sign(slope) * f_star)
        f = np.clip(f + np.clip(step, -0.3 * f_star, 0.3 * f_star), -f_star, 0.9 * f_star)
    return f, grid.path(one, f).distance


def _branch(
    grid: _Grid,
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
    lateral = 3 * (1 - grid.taper * r / _reach(grid)) / r**2
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
            raise _NotFound
        cs.append(c)
        known.append((np.log(f / push / unit), s))
        path = grid.path(s, f)
        pull = f / (lateral * push)
        out[j] = np.stack(
            [pull * path.lever / r, pull * np.sin(path.angle), pull * np.cos(path.angle)], axis=-1
        )
    return out


def _reach(grid: _Grid) -> Array:
    """Distance of the tip at rest."""
    law = grid.rows.law
    assert law is not None
    return np.hypot(*law.point(np.ones(grid.friction.size)))


def _on_tip(grid: _Grid, r: Array, f: Array, most: Array) -> Array:
    """Force at which the tip is at the distances r (n,), from guesses."""
    one = np.ones_like(r)
    for _ in range(12):
        path = grid.path(one, f)
        step = (r - path.distance) / path.jacobian()[1]
        f = np.clip(f + np.clip(step, -0.2 * most, 0.2 * most), 1e-12 * most, most)
    return f


def _rise(grid: _Grid, f_star: Array, r_star: Array, r_turn: Array, first: Array) -> Array:
    """How fast c at the tip rises beyond r*: as √(1 − tip/fold) does, so that P leaves the fold.

    Over 1 − x, x being the coordinate along; (n,).
    """
    x = 0.97
    t = first + (1 - first) * x
    r = r_turn - t**2 * (r_turn - r_star)
    rest = zero_load(grid.rows, r)[1]
    s, f, size = _to_fold(grid, r, np.ones_like(r), f_star, 8)
    fold = grid.path(s, f).deflection - rest
    tip = grid.path(np.ones_like(r), _on_tip(grid, r, 0.97 * f_star, f_star)).deflection - rest
    rise = np.sqrt(np.maximum(1 - tip / fold, 0.0)) / (1 - x)
    return np.where((size < 1e-6) & (rise > 0), np.clip(rise, 0.1, 0.9), 0.6)


class PlanarSurface:
    """Moment, axial and transverse force of one curved or rubbing whisker at any contact.

    Parameters
    ----------
    whisker : Whisker or Profile
        One whisker.
    friction : (float, float)
        Friction angles that it is made for, rad; twice the same where it is known.
    offset : (float, float)
        As much, 1/m, may the curvature differ from the whisker's along its whole length.

    Attributes
    ----------
    error : float
        Largest error of 60 contacts beside the planar beam's own, over the lateral force.

    Raises
    ------
    ValueError
        For a whisker that winds by more than 2 rad at rest, or whose folds are not found.
    """

    def __init__(
        self,
        whisker: Whisker | Profile,
        friction: tuple[float, float] = (0.0, 0.0),
        offset: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        self.whisker = whisker
        self.profile = whisker if isinstance(whisker, Profile) else Profile.of(whisker)
        base = self.profile.whisker
        self.length, self.stiffness = float(base.length), float(base.stiffness)
        self._ends = (friction, offset)
        axes = [nodes(UNCERTAIN) if high > low else np.zeros(1) for low, high in self._ends]
        shape = [len(axis) for axis in axes]
        psi, kappa = (
            low + (high - low) * axis.ravel()
            for (low, high), axis in zip(self._ends, np.meshgrid(*axes, indexing="ij"), strict=True)
        )
        grid = _grid(self.profile, psi, kappa)
        law = grid.rows.law
        assert law is not None
        turn = np.max(np.abs([law.turn(np.full(psi.size, x)) for x in (0.25, 0.5, 0.75, 1.0)]))
        if turn > MOST_TURN:
            raise ValueError(
                f"Observers take whiskers that turn by up to {MOST_TURN:g} rad from base to tip, "
                f"got {turn:.3g}; give a smaller curvature."
            )
        self.taper = grid.taper
        try:
            with np.errstate(all="ignore"):
                for self._along, self._across in SIZES:
                    self._build(grid, shape)
                    self.error = self._certified()
                    if self.error < ENOUGH:
                        break
        except _NotFound:
            raise ValueError(
                f"The folds of {whisker} were not found; give less curvature or friction, or "
                'model="profile", which solves each contact by itself.'
            ) from None

    def _build(self, grid: _Grid, shape: list[int]) -> None:
        count = grid.friction.size
        reach = _reach(grid)

        def table(values: Array, axes: int) -> Array:
            """Coefficients of values (n, …) whose first axis is what is uncertain, that axis last.

            `axes` more are those of nodes.
            """
            out = values.reshape(*shape, *values.shape[1:])
            for axis in (0, 1):
                out = np.moveaxis(fit(np.moveaxis(out, axis, 0)), 0, axis)
            for axis in range(2, 2 + axes):
                out = np.moveaxis(fit(np.moveaxis(out, axis, 0)), 0, axis)
            return out.reshape(count, *values.shape[1:])

        f_star, r_star = _tip_folds(grid)
        # Up to the distance at which the tip is at the fold.
        along = nodes(self._along)
        r = (r_star[:, None] * along).ravel()
        wide = grid.repeated(self._along)
        rest = zero_load(wide.rows, r)[1]
        s, f = _folds(wide, r, self._along)
        fold = wide.path(s, f).deflection - rest
        inner = _branch(wide, r, (s, f), fold, fold, np.zeros_like(r), self._across)
        v = grid.taper * r / np.repeat(reach, self._along)
        tables = [(fold / (1 - v), rest, inner)]
        # From there on, the tip.
        r_turn, rise = reach, np.zeros(count)
        if np.all(reach - r_star > 1e-9):
            f_turn, r_turn = _turns(grid, f_star)
            r_turn = np.maximum(np.minimum(r_turn, 2 * reach - r_star), reach)
            first = np.sqrt((r_turn - reach) / (r_turn - r_star))
            t = first[:, None] + (1 - first[:, None]) * along
            r = (r_turn[:, None] - t**2 * (r_turn - r_star)[:, None]).ravel()
            f = (f_turn[:, None] + t * (f_star - f_turn)[:, None]).ravel()
            one, f = np.ones_like(r), _on_tip(wide, r, f, np.repeat(f_star, self._along))
            rest = zero_load(wide.rows, r)[1]
            tip = wide.path(one, f).deflection - rest
            rise = _rise(grid, f_star, r_star, r_turn, first)
            floor = (rise[:, None] * (1 - along)).ravel()
            outer = _branch(wide, r, (one, f), tip, tip / (1 - floor**2), floor, self._across)
            tables.append((tip, rest, outer))
        self._marks = table(np.stack([reach, r_star, r_turn, rise], axis=-1), 0)
        self._curves = [
            table(np.stack([last, rest], axis=-1).reshape(count, self._along, 2), 1)
            for last, rest, _ in tables
        ]
        self._tables = [
            table(values.reshape(self._across, count, self._along, 3).transpose(1, 2, 0, 3), 2)
            for *_, values in tables
        ]

    # -- evaluation ----------------------------------------------------------------------------

    def _polynomials(self, friction: Array, offset: Array) -> Array:
        """Those (count, n or 1) at what is uncertain; beyond its range, those of its end."""
        parts = []
        for (low, high), value in zip(self._ends, (friction, offset), strict=True):
            known = not high > low
            share = np.zeros(1) if known else np.clip((value - low) / (high - low), 0.0, 1.0)
            parts.append(basis(1 if known else UNCERTAIN, share))
        a, b = parts
        return np.asarray((a[:, None] * b).reshape(len(a) * len(b), -1))

    def _placed(self, r: Array, friction: Array, offset: Array) -> _Placed:
        poly = self._polynomials(friction, offset)
        reach, r_star, r_turn, rise = np.broadcast_to(self._marks.T @ poly, (4, r.size))
        known = (r > 0) & (r <= reach)
        outer = known & (r > r_star)
        x = np.clip(r / r_star, 0.0, 1.0)
        if outer.any():
            first, t = (
                np.sqrt(np.maximum(r_turn - d, 0.0)[outer] / (r_turn - r_star)[outer])
                for d in (reach, r)
            )
            x[outer] = (t - first) / (1 - first)
        last, rest = np.empty((2, r.size))
        for which, curves in zip((~outer, outer), self._curves, strict=False):
            along = basis(self._along, x[which])
            if poly.shape[1] == 1:
                values = np.tensordot(curves, poly[:, 0], (0, 0)).T @ along
            else:
                terms = curves.reshape(len(curves), -1).T @ poly[:, which]
                values = np.einsum("ikn,in->kn", terms.reshape(self._along, 2, -1), along)
            last[which], rest[which] = values
        v = 1 - self.taper * np.minimum(r / reach, 1.0)
        last = np.where(outer, last, last * v)
        floor = np.where(outer, rise * (1 - x), 0.0)
        return _Placed(poly, known, outer, x, last, rest, floor, v)

    def limit(self, r: Array, friction: Any = 0.0, offset: Any = 0.0) -> Array:
        """Largest push, from rest, at each distance (n,), rad; NaN out of reach."""
        place = self._placed(r / self.length, *np.atleast_1d(friction, offset))
        return np.where(place.known, place.last, np.nan)

    def reach(self, offset: float = 0.0) -> float:
        """Distance of the tip at rest, m."""
        poly = self._polynomials(np.array([self._ends[0][0]]), np.atleast_1d(offset))
        return self.length * float(self._marks[:, 0] @ poly[:, 0])

    def rest(self, r: Array, friction: Any = 0.0, offset: Any = 0.0) -> Array:
        """Deflection angle at each distance (n,) at which the whisker at rest just touches, rad."""
        place = self._placed(r / self.length, *np.atleast_1d(friction, offset))
        return np.where(place.known, place.rest, np.nan)

    def __call__(
        self, r: Array, push: Array, friction: Any = 0.0, offset: Any = 0.0
    ) -> tuple[Array, NDArray[np.int8]]:
        """Signals (n, 3), NaN where not held, and outcomes (n,) at distances and pushes (n,).

        The push is the angle from the one at which the whisker at rest touches.
        """
        distance = np.asarray(r, dtype=float) / self.length
        place = self._placed(distance, *np.atleast_1d(friction, offset))
        held = place.known & (push >= 0) & (push <= place.last)
        with np.errstate(all="ignore"):
            c = np.sqrt(np.maximum(1 - push * (1 - place.floor**2) / place.last, 0.0))
            w = np.clip((c - place.floor) / (1 - place.floor), 0.0, 1.0)
            ratio = self._ratios(place, np.where(held, w, 0.0))
            lateral = 3 * push * place.room / distance**2 * (self.stiffness / self.length**2)
            out = lateral[:, None] * ratio
            out[:, 0] *= r
        out[~held] = np.nan
        lost = np.where(place.outer, Outcome.SLIPPED_OFF_TIP, Outcome.FLICKED_PAST)
        lost = np.where(push < 0, Outcome.NO_TOUCH, lost)
        lost = np.where(place.known, lost, Outcome.OUT_OF_REACH)
        return out, np.where(held, Outcome.HELD, lost).astype(np.int8)

    def _ratios(self, place: _Placed, w: Array) -> Array:
        out = np.empty((w.size, 3))
        for which, table in zip((~place.outer, place.outer), self._tables, strict=False):
            some = np.flatnonzero(which)
            if place.poly.shape[1] == 1:
                whole = ChebyshevTable(np.asarray(np.tensordot(table, place.poly[:, 0], (0, 0))))
                out[some] = whole(place.x[some], w[some]).T
                continue
            rows = np.ascontiguousarray(table.reshape(len(table), -1).T)
            for i in range(0, some.size, 1024):
                at = some[i : i + 1024]
                terms = product(rows, place.poly[:, at]).reshape(self._along, self._across, 3, -1)
                across = np.einsum("xckn,cn->xkn", terms, basis(self._across, w[at]))
                out[at] = np.einsum("xkn,xn->nk", across, basis(self._along, place.x[at]))
        return out

    def _certified(self, count: int = 60) -> float:
        """The largest error of contacts all over, beside the planar beam's own solution."""
        rng = np.random.default_rng(20261122)
        friction, offset = (low + (high - low) * rng.random(count) for low, high in self._ends)
        reach = self._marks[:, 0] @ self._polynomials(friction, offset) * np.ones(count)
        r = reach * self.length * rng.uniform(0.01, 0.999, count)
        rest, limit = self.rest(r, friction, offset), self.limit(r, friction, offset)
        push = limit * rng.uniform(0.001, 0.998, count)
        whisker: Whisker | Profile = self.whisker
        if np.any(offset):
            law = self.profile.law
            assert isinstance(law, Spiral)
            bent = Spiral(law.base + offset, np.broadcast_to(law.rate, count))
            whisker = self.profile.curved(bent)
        true = planar.press(whisker, r, rest + push, friction)
        found = self(r, push, friction, offset)[0]
        room = 1 - self.taper * r / (reach * self.length)
        lateral = 3 * push * room * self.stiffness / r**2
        exact = np.stack([true.moment / r, true.axial_force, true.transverse_force], axis=-1)
        found[:, 0] /= r
        off = np.abs(found - exact) / lateral[:, None]
        beyond = (true.outcome == Outcome.SLIPPED_OFF_TIP) & (r > LAST * reach * self.length)
        off[beyond & (len(self._tables) == 1)] = 0.0
        return float(np.max(np.where(np.isnan(off), np.inf, off)))


@dataclass(frozen=True)
class _Placed:
    """Where contacts lie on the tables: see `PlanarSurface`."""

    poly: Array
    known: NDArray[np.bool_]
    outer: NDArray[np.bool_]
    x: Array
    last: Array
    rest: Array
    floor: Array
    room: Array
