"""Quantiles and draws read off tiles.

On a tile ln of the density is next to a polynomial: through its nodes it is known everywhere, and
as many more nodes as an integral over part of a tile needs cost no mechanics.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.polynomial import legendre
from scipy.special import logit, wrightomega

from .tiled import TiledObserver, Weighed, summed
from .tiling import ORDER, Array, Index

_X, _W = legendre.leggauss(ORDER)
#: From values at the nodes of an axis to Legendre coefficients.
_TO_LEGENDRE = np.linalg.inv(legendre.legvander(_X, ORDER - 1))
#: Rules for part of a line and, where lines are cut at different places, across them.
_PART_X, _PART_W = legendre.leggauss(8)
_PART_BASIS = _PART_X ** np.arange(ORDER)[:, None]
_TO_POWERS = (
    np.stack(
        [
            np.pad(legendre.leg2poly(row), (0, ORDER - 1 - k))
            for k, row in enumerate([np.eye(k + 1)[k] for k in range(ORDER)])
        ],
        axis=1,
    )
    @ _TO_LEGENDRE
)
#: Lines across are many where a value cuts a tile at some of them and passes by the rest, as near
#: the fold: the upper end of 95 % was 0.041 sd off with 16, 0.003 with 64.
_FEW, _MANY = 12, 64
#: ln of a weight, below the highest of its tile, that counts as none.
_NONE = -80.0


@cache
def _angle_table(points: int = 20_001) -> tuple[Array, Array]:
    """`unconstrain_angle` against the logit of the fraction: straight lines are 3e-7 off."""
    z = np.linspace(-39.2, 36.8, points)
    omega = wrightomega(z)
    return z, np.where(z > 0, np.log(omega), z - omega)


class Lines:
    """The posteriors of some readings along the lines of their tiles on the axis of an unknown."""

    def __init__(
        self,
        tiled: TiledObserver,
        weighed: Weighed,
        count: int,
        unknown: int,
        across: int = _FEW,
    ) -> None:
        self.observer, self.unknown, self.count = tiled.observer, unknown, count
        mass = weighed.weight.sum(axis=1)
        total = summed(mass, weighed.row, count)
        kept = mass > 1e-9 * total[weighed.row]
        self.row, self.tile = weighed.row[kept], weighed.tile[kept]
        self.mass = mass[kept] / total[self.row]
        self._weight, self._total = weighed.weight[kept], total
        self._boxes, self._contact = tiled.tiles.boxes, tiled.tiles.nodes.contact
        #: Whether lines are cut at different places: the angle, whose axis turns with distance.
        self.sheared = unknown == 1 < tiled.observer.bounded
        dim = self._boxes.low.shape[1]
        #: How many lines are cut alike, and coefficients of ln of the weight along them (n, …).
        self._count = across if self.sheared else 1
        x, self._across_weight = legendre.leggauss(self._count)
        self._to_across = legendre.legvander(x, ORDER - 1) @ _TO_LEGENDRE
        self._ready = np.zeros(len(self.row), dtype=bool)
        lines = ORDER ** (dim - 2) * across if self.sheared else ORDER ** (dim - 1)
        self._powers = np.empty((len(self.row), lines, ORDER))
        self._scale_of, self._whole = np.empty((2, len(self.row)))
        if self.sheared:
            self._scale = self._scales()
        value = self._contact[self.tile, :, unknown]
        self.least, self.most = value.min(axis=1), value.max(axis=1)
        #: More lines, for values that cut some of these lines and not others.
        self._finer: Lines | None = None
        if self.sheared and across == _FEW:
            self._finer = Lines(tiled, weighed, count, unknown, _MANY)

    def _scales(self) -> tuple[float, Array, Array]:
        """`angle_scale` at the lines across the tiles that there are: (T, lines)."""
        tiles = np.unique(self.tile)
        first = self._contact[tiles, :: ORDER ** (self._boxes.low.shape[1] - 1), 0]
        low, *both = self.observer.space.angle_scale(first)
        out = np.full((2, len(self._contact), self._count), np.nan)
        for whole, part in zip(out, both, strict=True):
            whole[tiles] = part @ self._to_across.T
        return low, out[0], out[1]

    def crude(self, probability: float) -> tuple[Array, Array]:
        """Quantiles (B,) and the density there, as if values were even on each tile."""
        low, high = np.full(self.count, np.inf), np.full(self.count, -np.inf)
        np.minimum.at(low, self.row, self.least)
        np.maximum.at(high, self.row, self.most)
        width = np.maximum(self.most - self.least, 1e-300)
        starts, rows = self._starts()
        a, b = low[rows].copy(), high[rows].copy()
        own = np.repeat(np.arange(len(rows)), np.diff(np.append(starts, len(self.row))))
        for _ in range(16):
            middle = (a + b) / 2
            share = np.clip((middle[own] - self.least) / width, 0.0, 1.0)
            below = np.add.reduceat(self.mass * share, starts) < probability
            a, b = np.where(below, middle, a), np.where(below, b, middle)
        value, density = np.full((2, self.count), np.nan)
        value[rows] = (a + b) / 2
        inside = (value[self.row] > self.least) & (value[self.row] < self.most)
        density[rows] = np.add.reduceat(np.where(inside, self.mass / width, 0.0), starts)
        return value, density

    def _starts(self) -> tuple[Index, Index]:
        starts = np.flatnonzero(np.diff(self.row, prepend=-1))
        return starts, self.row[starts]

    def cumulative(self, value: Array) -> tuple[Array, Array]:
        """P(unknown < value) for values (B,), NaN where not asked for; and the error of that."""
        v = value[self.row]
        # The nodes end a little before the tile does.
        beyond = 0.25 * (self.most - self.least)
        below = v > self.most + beyond
        some = np.flatnonzero(~below & (v > self.least - beyond))
        out = summed(np.where(below, self.mass, 0.0), self.row, self.count)
        error = np.zeros(self.count)
        if some.size:
            part, whole, missed = self._parts_below(some, v[some])
            out += summed(part, self.row[some], self.count)
            error += np.abs(summed(whole - self.mass[some], self.row[some], self.count))
            error += np.sqrt(summed(missed**2, self.row[some], self.count))
        return out, error

    def _parts_below(self, pairs: Index, value: Array) -> tuple[Array, Array, Array]:
        """`_partial` of pairs (n,) below values (n,), by more lines where these are cut unlike."""
        t = self._cut(self.tile[pairs], value)
        kind = (t > 0).astype(int) + (t >= 1)
        unlike = np.ptp(kind, axis=1) > 0
        if self._finer is None or not unlike.any():
            return self._partial(pairs, t)
        out = np.empty((3, len(pairs)))
        if not unlike.all():
            out[:, ~unlike] = self._partial(pairs[~unlike], t[~unlike])
        some, finer = pairs[unlike], self._finer
        out[:, unlike] = finer._partial(some, finer._cut(self.tile[some], value[unlike]))
        return out[0], out[1], out[2]

    def _cut(self, tile: Index, value: Array) -> Array:
        """Where values (n,) cut tiles along the axis, as fractions (n, 1), or (n, lines)."""
        space, unknown = self.observer.space, self.unknown
        if not self.sheared:
            x = space.unconstrain_one(value, unknown)[:, None]
        else:
            low, width, gain = self._scale
            fraction = (value[:, None] - low) / width[tile]
            known = np.interp(logit(np.clip(fraction, 1e-17, 1 - 1e-16)), *_angle_table())
            x = known + gain[tile]
            x = np.where(fraction < 1, x, np.inf)
        low, high = self._boxes.low[tile, unknown], self._boxes.high[tile, unknown]
        return np.asarray(np.clip((x - low[:, None]) / (high - low)[:, None], 0.0, 1.0))

    def _prepare(self, pairs: Index) -> None:
        """Work out the powers of pairs that have been without."""
        pairs = pairs[~self._ready[pairs]]
        if not pairs.size:
            return
        self._ready[pairs] = True
        dim = self._boxes.low.shape[1]
        weight = self._weight[pairs].reshape(len(pairs), *(ORDER,) * dim)
        weight = np.moveaxis(weight, self.unknown + 1, -1)
        rule = _W / 2
        with np.errstate(divide="ignore"):
            log = np.log(weight) - np.log(rule)
        top = log.reshape(len(pairs), -1).max(axis=1)
        log = np.maximum(log - top[:, *(None,) * dim], _NONE)
        if self.sheared:  # as many lines as it takes where each is cut at a place of its own
            log -= np.log(rule)[:, *(None,) * (dim - 1)]
            log = np.moveaxis(self._to_across @ np.moveaxis(log, 1, -2), -2, 1)
            log += np.log(self._across_weight / 2)[:, *(None,) * (dim - 1)]
        self._powers[pairs] = log.reshape(len(pairs), -1, ORDER) @ _TO_POWERS.T
        scale = self._scale_of[pairs] = np.exp(top) / self._total[self.row[pairs]]
        whole = np.exp(np.minimum(self._powers[pairs] @ _PART_BASIS, 30.0)) @ (_PART_W / 2)
        self._whole[pairs] = scale * whole.sum(axis=1)

    def _partial(self, pairs: Index, t: Array) -> tuple[Array, Array, Array]:
        """The mass of tiles (n,) below the fractions t, and all of it, by finer rules.

        And how far off that may be: by a fifth of what is between two lines of which one is cut and
        the other is not (8 times what it was near the fold at k = 0.03 with a half).
        """
        self._prepare(pairs)
        powers = self._powers[pairs].reshape(len(pairs), self._count, -1, ORDER)
        scale = self._scale_of[pairs]
        x = (t[..., None] * (_PART_X + 1) - 1)[:, :, None]
        value = powers[..., -1, None] * x
        for k in range(ORDER - 2, 0, -1):
            value += powers[..., k, None]
            value *= x
        value += powers[..., 0, None]
        part = (np.exp(np.minimum(value, 30.0)) @ (_PART_W / 2)).sum(axis=2)
        below, cut = part * t, (t > 0).astype(int) + (t >= 1)
        apart = np.where(np.diff(cut, axis=1) != 0, np.abs(np.diff(below, axis=1)), 0.0)
        missed = 0.2 * scale * apart.max(axis=1, initial=0.0)
        return scale * below.sum(axis=1), self._whole[pairs], missed


def quantiles(
    tiled: TiledObserver, reading: Array, probability: Array, unknown: int
) -> tuple[Array, Array]:
    """Quantiles (B, Q) of an unknown for readings (B, R), and their errors by these rules."""
    if unknown == tiled.dim:
        return tiled.last_quantiles(reading, probability)
    by_draws = unknown == 1 and tiled.observer.space.angle_range_varies
    found = _quantiles_of_draws if by_draws else _quantiles
    parts = [
        found(tiled, reading[i : i + tiled.together], probability, unknown)
        for i in range(0, len(reading), tiled.together)
    ]
    values, errors = (np.concatenate(side) for side in zip(*parts, strict=True))
    return values, errors


def _quantiles(
    tiled: TiledObserver, reading: Array, probability: Array, unknown: int
) -> tuple[Array, Array]:
    lines = Lines(tiled, tiled.weigh(reading, whole=True), len(reading), unknown)
    out, error = np.empty((2, len(reading), len(probability)))
    for column, p in enumerate(probability):
        out[:, column], error[:, column] = _quantile(lines, float(p))
    return out, error


def _quantiles_of_draws(
    tiled: TiledObserver, reading: Array, probability: Array, unknown: int, *, count: int = 20_000
) -> tuple[Array, Array]:
    """The same by draws: an angle whose range turns with a third unknown is cut by no line alike.

    The error is that of draws without strata, which these have: some 0.01 of an sd.
    """
    x = draws(tiled, reading, count, np.random.default_rng(0))
    value = tiled.observer.contact(x)[0][..., unknown]
    half = np.sqrt(probability * (1 - probability) / count)
    low, middle, high = (
        np.quantile(value, np.clip(p, 0, 1), axis=1).T
        for p in (probability - half, probability, probability + half)
    )
    return middle, (high - low) / 2


def _quantile(lines: Lines, p: float) -> tuple[Array, Array]:
    """Quantiles (B,) by secants within a bracket, from the crude ones; and their errors."""
    value, density = lines.crude(p)
    low, high = np.full(lines.count, -np.inf), np.full(lines.count, np.inf)
    np.minimum.at(high, lines.row, lines.least)
    np.maximum.at(low, lines.row, lines.most)
    low, high = high, low
    best, error = value.copy(), np.full(lines.count, np.inf)
    asked, before, f_before = value.copy(), value.copy(), np.full(lines.count, np.nan)
    for step in range(40):
        f, off = lines.cumulative(asked)
        f -= p
        live = np.isfinite(asked)
        low = np.where(live & (f < 0), asked, low)
        high = np.where(live & (f >= 0), asked, high)
        with np.errstate(invalid="ignore", divide="ignore"):
            slope = (f - f_before) / (asked - before)
            usual = (slope > 0.1 * density) & (slope < 10 * density)
            density = np.where(live & usual, slope, density)
            following = asked - f / density
            # A probability known so well leaves the quantile known as well as its density says.
            error = np.where(live, (off + np.abs(f)) / density, error)
        inside = (following >= low) & (following <= high)
        following = np.where(inside & (step % 8 < 7), following, (low + high) / 2)
        near = np.abs(f) < 5e-4 * min(p, 1 - p)
        best = np.where(live, asked, best)
        going = live & ~near & (high - low > 1e-12 * np.abs(high))
        before, f_before = asked, f
        if not going.any():
            break
        asked = np.where(going, following, np.nan)
    return best, error


def draws(tiled: TiledObserver, reading: Array, count: int, rng: np.random.Generator) -> Array:
    """Coordinates (B, count, d) drawn from the posteriors of readings (B, R), one by one.

    A tile is cut into cells, each with the mass that the polynomial gives it; cells are drawn in
    strata, and a place in each.
    """
    dim = tiled.dim
    cells = 24 if dim <= 2 else 12
    middle = (np.arange(cells) + 0.5) / cells
    finer = legendre.legvander(2 * middle - 1, ORDER - 1) @ _TO_LEGENDRE
    rule = np.array(1.0)
    for _ in range(dim):
        rule = np.multiply.outer(rule, _W / 2)
    out = np.full((len(reading), count, dim), np.nan)
    for i, row in enumerate(reading):
        weighed = tiled.weigh(row[None], whole=True)
        mass = weighed.weight.sum(axis=1)
        kept = mass > 1e-7 * mass.sum()
        if not kept.any():
            continue
        with np.errstate(divide="ignore"):
            log = np.log(weighed.weight[kept].reshape(-1, *(ORDER,) * dim) / rule)
        log = np.maximum(log, log.reshape(len(log), -1).max(axis=1)[:, *(None,) * dim] + _NONE)
        for axis in range(1, dim + 1):
            log = np.moveaxis(np.moveaxis(log, axis, -1) @ finer.T, -1, axis)
        density = np.exp(np.minimum(log.reshape(len(log), -1), 30.0))
        share = density * (mass[kept] / density.sum(axis=1))[:, None]
        rise = np.cumsum(share.ravel())
        at = (rng.random() + np.arange(count)) / count * rise[-1]
        chosen = np.minimum(np.searchsorted(rise, at, side="right"), len(rise) - 1)
        tile, cell = np.divmod(chosen, cells**dim)
        place = np.stack(np.unravel_index(cell, (cells,) * dim), axis=-1)
        tile = weighed.tile[kept][tile]
        low, high = tiled.tiles.boxes.low[tile], tiled.tiles.boxes.high[tile]
        out[i] = rng.permutation(low + (high - low) * (place + rng.random(place.shape)) / cells)
    return out
