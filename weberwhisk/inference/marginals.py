"""Quantiles and draws read off tiles.

On a tile ln of the density is next to a polynomial: through its nodes it is known everywhere, and
as many more nodes as an integral over part of a tile needs cost no mechanics.
"""

from __future__ import annotations

from functools import cache, cached_property

import numpy as np
from numpy.polynomial import legendre
from scipy.special import logit, wrightomega

from .._values import Array, Index
from .coordinates import constrain_angle
from .tiled import TiledObserver, Weighed, summed
from .tiling import ORDER

_X, _W = legendre.leggauss(ORDER)
#: From values at the nodes of an axis to Legendre coefficients.
_TO_LEGENDRE = np.linalg.inv(legendre.legvander(_X, ORDER - 1))
#: A rule for part of a line, and from values at the nodes to powers.
_PART_X, _PART_W = legendre.leggauss(8)
_TO_POWERS = np.linalg.inv(_X[:, None] ** np.arange(ORDER))
#: Places across a tile at which it is seen where a value leaves it.
_ACROSS = np.linspace(-1.0, 1.0, 17)
#: ln of a weight, below the highest of its tile, that counts as none.
_NONE = -80.0


@cache
def _angle_table(points: int = 20_001) -> tuple[Array, Array]:
    """`unconstrain_angle` against the logit of the fraction: straight lines are 3e-7 off."""
    z = np.linspace(-39.2, 36.8, points)
    omega = wrightomega(z)
    return z, np.where(z > 0, np.log(omega), z - omega)


class Marginal:
    """The posteriors of some readings along the axis of an unknown, tile by tile.

    What is summed out leaves one line to a tile. An angle, whose axis turns with distance, has
    lines at several distances, which a value cuts each at a place of its own.
    """

    def __init__(
        self,
        tiled: TiledObserver,
        weighed: Weighed,
        count: int,
        unknown: int,
    ) -> None:
        self.observer, self.unknown, self.count = tiled.observer, unknown, count
        self._boxes, contact = tiled.tiles.boxes, tiled.tiles.nodes.contact
        dim = self._boxes.low.shape[1]
        self.sheared = unknown == 1 < tiled.observer.bounded
        mass = weighed.weight.sum(axis=1)
        total = summed(mass, weighed.row, count)
        kept = mass > 1e-8 * total[weighed.row]
        self.row, self.tile = weighed.row[kept], weighed.tile[kept]
        self.mass = mass[kept] / total[self.row]
        axes = (0, 1) if self.sheared else (unknown,)
        weight = weighed.weight[kept].reshape(-1, *(ORDER,) * dim)
        weight = weight.sum(axis=tuple(1 + i for i in range(dim) if i not in axes))
        #: Weights of the nodes of lines, as shares of their reading's, (n, lines, ORDER).
        self._weight = weight.reshape(len(weight), -1, ORDER) / total[self.row, None, None]
        value = contact[self.tile, :, unknown]
        self.least, self.most = value.min(axis=1), value.max(axis=1)
        first = np.arange(ORDER) * ORDER ** (dim - 1 - unknown)
        if self.sheared:
            first = first + ORDER ** (dim - 1) * np.arange(ORDER)[:, None]
        self._value = contact[self.tile][:, first.reshape(-1, ORDER), unknown]
        self._distance = contact[:, :: ORDER ** (dim - 1), 0]
        self._ready = np.zeros(len(weight), dtype=bool)
        self._whole = np.empty(len(weight))
        self._powers = np.empty((len(weight), weight[0].size // ORDER if len(weight) else 1, ORDER))

    def ends(self) -> tuple[Array, Array]:
        """Between which values (B,) readings have mass: a little beyond the outermost nodes."""
        starts = np.flatnonzero(np.diff(self.row, prepend=-1))
        low, high = np.full((2, self.count), np.nan)
        beyond = 0.25 * (self.most - self.least)
        low[self.row[starts]] = np.minimum.reduceat(self.least - beyond, starts)
        high[self.row[starts]] = np.maximum.reduceat(self.most + beyond, starts)
        return low, high

    def rise(self, *, cells: int = 12, bins: int = 256) -> tuple[Array, Array]:
        """P(unknown < value) (B, bins + 1) at even steps of values (B, bins + 1), about.

        A line is cut into cells, and each is counted where its middle is; of many lines the nodes.
        """
        some = np.flatnonzero(self.mass > 1e-5)
        row = self.row[some]
        share, value = self._weight[some], self._value[some]
        if not self.sheared:
            finer = to_cells(cells)
            share = np.exp(np.minimum(logs(share)[0] @ finer.T, 30.0))
            share *= (self.mass[some] / share.sum(axis=(1, 2)))[:, None, None]
            value = value @ finer.T
        low, high = np.full((2, self.count), np.nan)
        starts = np.flatnonzero(np.diff(row, prepend=-1))
        low[row[starts]] = np.minimum.reduceat(value.min(axis=(1, 2)), starts)
        high[row[starts]] = np.maximum.reduceat(value.max(axis=(1, 2)), starts)
        step = np.maximum((high - low) / bins, np.finfo(float).tiny)
        place = (value - low[row, None, None]) / step[row, None, None]
        place = np.minimum(place.astype(np.intp), bins - 1) + bins * row[:, None, None]
        mass = np.bincount(place.ravel(), share.ravel(), minlength=bins * self.count)
        rise = np.cumsum(mass.reshape(self.count, bins), axis=1)
        edges = low[:, None] + step[:, None] * np.arange(bins + 1)
        return edges, np.pad(rise, ((0, 0), (1, 0)))

    def cumulative(self, value: Array, *, slight: float = 3e-6) -> tuple[Array, Array]:
        """P(unknown < value) for values (B,), NaN where not asked for; and the error of that.

        In tiles of slight mass values count as even.
        """
        # The nodes end a little before the tile does.
        width = 1.5 * (self.most - self.least)
        share = (value[self.row] - self.least) / np.maximum(width, 1e-300) + 1 / 6
        some = np.flatnonzero((share > 0) & (share < 1) & (self.mass > slight))
        share = np.where(share > 0, np.minimum(share, 1.0), 0.0) * self.mass
        share[some] = 0.0
        out = _totals(self.row, share, self.count)
        if not some.size:
            return out, np.zeros(self.count)
        row = self.row[some]
        part, whole, missed = self._parts_below(some, value[row])
        error = np.abs(_totals(row, whole - self.mass[some], self.count))
        error += np.sqrt(_totals(row, missed**2, self.count))
        return out + _totals(row, part, self.count), error

    def _prepare(self, pairs: Index) -> None:
        """Work out ln of the density on pairs that have been without."""
        pairs = pairs[~self._ready[pairs]]
        self._ready[pairs] = True
        log, top = logs(self._weight[pairs])
        if self.sheared:
            log -= np.log(_W / 2)[:, None]
        powers = log @ _TO_POWERS.T
        powers[..., 0] += top[:, None]
        lines = _exp_of(powers, _PART_X) @ (_PART_W / 2)
        self._whole[pairs] = lines @ (_W / 2) if self.sheared else lines[:, 0]
        self._powers[pairs] = _TO_LEGENDRE @ powers if self.sheared else powers

    @cached_property
    def _tiles(self) -> Index:
        return np.unique(self.tile)

    @cached_property
    def _scale(self) -> tuple[float, Array]:
        """The lowest angle; of the tiles that there are the scale of angles across, (t, ORDER, 3).

        As Legendre coefficients of the range's width and of what makes y of the coordinate.
        """
        r = self._distance[self._tiles]
        low, width = self.observer.space.angle_range(r)
        scales = width, -self.observer.space._log_gain(r, width), np.ones(())
        across = _TO_LEGENDRE @ np.stack(np.broadcast_arrays(*scales), axis=-1)
        return low, np.asarray(across, dtype=np.float64)

    @cached_property
    def _edges(self) -> Array:
        """Angles at either edge of the tiles that there are, (t, 2, n), at even steps across."""
        low, scale = self._scale
        scale = np.moveaxis(legendre.legvander(_ACROSS, ORDER - 1) @ scale, -1, 0)
        width, start, slope = scale[:, :, None]
        boxes = self._boxes
        ends = np.stack([boxes.low[self._tiles, 1], boxes.high[self._tiles, 1]], axis=1)
        return low + width * constrain_angle(start + slope * ends[..., None])[0]

    def _pieces(self, tile: Index, value: Array) -> tuple[Index, Array, Array]:
        """Parts of tiles (n,) that values (n,) cut smoothly: whose, and from where to where across.

        They meet where a value leaves the tile by either edge.
        """
        above = value[:, None, None] - self._edges[np.searchsorted(self._tiles, tile)]
        one, other = above[..., :-1], above[..., 1:]
        crossed = (one > 0) != (other > 0)
        which, edge, step = np.nonzero(crossed)
        one, other = one[which, edge, step], other[which, edge, step]
        # As many as four of a tile, in order.
        ends = np.ones((len(tile), 6))
        ends[:, 0] = -1.0
        order = np.arange(len(which)) - np.searchsorted(which, which)
        kept = order < 4
        place = _ACROSS[step] + (_ACROSS[1] - _ACROSS[0]) * one / (one - other)
        ends[which[kept], order[kept] + 1] = place[kept]
        ends.sort(axis=1)
        whose, part = np.nonzero(np.diff(ends, axis=1) > 1e-9)
        return whose, ends[whose, part], ends[whose, part + 1]

    def _parts_below(self, pairs: Index, value: Array) -> tuple[Array, Array, Array]:
        """The mass of pairs (n,) below values (n,), and all of it, by finer rules.

        And how far off that may be: as the last terms of a smooth function tell of what is left.
        """
        self._prepare(pairs)
        tile, space = self.tile[pairs], self.observer.space
        low, high = (side[tile, self.unknown] for side in (self._boxes.low, self._boxes.high))
        if not self.sheared:
            t = np.clip((space.unconstrain_one(value, self.unknown) - low) / (high - low), 0, 1)
            below = _below(self._powers[pairs], t[:, None])[:, 0]
            return below, self._whole[pairs], np.zeros(len(pairs))
        whose, start, end = self._pieces(tile, value)
        half = (end - start) / 2
        terms = legendre.legvander((start + half)[:, None] + half[:, None] * _X, ORDER - 1)
        least, scale = self._scale
        scale = scale[np.searchsorted(self._tiles, tile[whose])]
        width, start, slope = np.moveaxis(terms @ scale, -1, 0)
        fraction = (value[whose, None] - least) / width
        known = np.interp(logit(np.clip(fraction, 1e-17, 1 - 1e-16)), *_angle_table())
        x = np.where(fraction < 1, (known - start) / slope, np.inf)
        t = np.clip((x - low[whose, None]) / (high - low)[whose, None], 0.0, 1.0)
        some = np.flatnonzero(t.max(axis=1, initial=0.0) > 0)
        whose, half = whose[some], half[some]
        powers = np.asarray(terms[some] @ self._powers[pairs[whose]], dtype=np.float64)
        lines = _below(powers, t[some])
        out = np.bincount(whose, half * (lines @ (_W / 2)), len(pairs)).astype(np.float64)
        tail = np.abs(lines @ _TO_LEGENDRE[-2:].T).sum(axis=1)
        missed = 0.01 * half * tail**2 / np.maximum(lines.max(axis=1, initial=0.0), 1e-300)
        return out, self._whole[pairs], np.bincount(whose, missed, len(pairs)).astype(np.float64)


def _totals(row: Index, parts: Array, count: int) -> Array:
    """Sums (B,) of parts (n,) that belong to readings (n,)."""
    return np.bincount(row, parts, count).astype(np.float64)


def _below(powers: Array, t: Array) -> Array:
    """The mass of lines (n, lines, ORDER) below the fractions t (n, lines)."""
    x = t[..., None] * (_PART_X + 1) - 1
    return np.asarray((_exp_of(powers, x) @ (_PART_W / 2)) * t)


def to_cells(count: int) -> Array:
    """From values at the nodes of a line to those in the middle of even cells, (count, ORDER)."""
    middle = (np.arange(count) + 0.5) / count
    return np.asarray(legendre.legvander(2 * middle - 1, ORDER - 1) @ _TO_LEGENDRE)


def logs(weight: Array) -> tuple[Array, Array]:
    """ln of the density at the nodes of lines (n, lines, ORDER) over the highest; ln of that."""
    with np.errstate(divide="ignore"):
        log = np.log(weight) - np.log(_W / 2)
    top = log.max(axis=(1, 2))
    return np.maximum(log - top[:, None, None], _NONE), top


def _exp_of(powers: Array, x: Array) -> Array:
    """exp of polynomials (n, lines, ORDER) at x (n, lines, m) or (m,)."""
    value = powers[..., -1, None] * x
    for k in range(ORDER - 2, 0, -1):
        value += powers[..., k, None]
        value *= x
    value += powers[..., 0, None]
    return np.exp(np.minimum(value, 30.0, out=value), out=value)


def tile_quantiles(
    tiled: TiledObserver, reading: Array, probability: Array, unknowns: list[int], lost: Array
) -> tuple[Array, Array]:
    """Quantiles (U, B, Q) of some unknowns for readings (B, R), NaN of others; and their errors.

    All are read off the same weights. `lost` (B, U) is mass that may lie on the wrong side.
    """
    shape = len(tiled.observer.unknowns), len(reading), len(probability)
    out, error = np.full((2, *shape), np.nan)
    size = 2 * tiled.together
    for part in (slice(i, i + size) for i in range(0, len(reading), size)):
        weighed = tiled.weigh(reading[part], whole=True)
        for unknown in unknowns:
            if unknown == tiled.dim:
                found = tiled.last_quantiles(
                    reading[part], weighed, probability, lost[part, unknown]
                )
            else:
                marginal = Marginal(tiled, weighed, len(reading[part]), unknown)
                found = quantiles(marginal, probability, lost[part, unknown])
            out[unknown, part], error[unknown, part] = found
    return out, error


def by_draws(
    tiled: TiledObserver, reading: Array, probability: Array, unknown: int, *, count: int = 20_000
) -> tuple[Array, Array]:
    """Quantiles (B, Q) of an unknown by draws, and their errors.

    The error is that of draws without strata, which these have: some 0.01 of an sd.
    """
    x = draws(tiled, reading, count, np.random.default_rng(0))
    value = tiled.completed(reading, x, np.random.default_rng(1))[..., unknown]
    half = np.sqrt(probability * (1 - probability) / count)
    low, middle, high = (
        np.quantile(value, np.clip(p, 0, 1), axis=1).T
        for p in (probability - half, probability, probability + half)
    )
    return middle, (high - low) / 2


def quantiles(marginal: Marginal, probability: Array, lost: Array) -> tuple[Array, Array]:
    """Quantiles (B, Q) and their errors, where so much mass (B,) may lie on the wrong side."""
    edges, rise = marginal.rise()
    out, error = np.empty((2, marginal.count, len(probability)))
    for column, p in enumerate(probability):
        out[:, column], error[:, column] = _quantile(marginal, float(p), lost, edges, rise)
    return out, error


def _about(edges: Array, rise: Array, p: float) -> Array:
    """Where sums (B, n) at values (B, n) rise past a probability, (B,)."""
    rows = np.arange(len(rise))
    after = np.clip((rise < p).sum(axis=1), 1, rise.shape[1] - 1)
    mass = np.maximum(rise[rows, after] - rise[rows, after - 1], 1e-300)
    share = np.clip((p - rise[rows, after - 1]) / mass, 0.0, 1.0)
    return np.asarray(edges[rows, after - 1] + share * (edges[:, 1] - edges[:, 0]))


def _quantile(
    marginal: Marginal, p: float, lost: Array, edges: Array, rise: Array
) -> tuple[Array, Array]:
    """Quantiles (B,) by secants within a bracket, from about where they are; and their errors."""
    apart = 0.3 * min(p, 1 - p)
    asked, below, above = (_about(edges, rise, q) for q in (p, p - apart, p + apart))
    step = edges[:, 1] - edges[:, 0]
    # In a gap there is next to no density, and next to no knowing where a quantile lies.
    density = 2 * apart / np.maximum(above - below, 1e-3 * step)
    low, high = marginal.ends()
    best, error = asked.copy(), np.full(marginal.count, np.inf)
    last, f_last = asked.copy(), np.full(marginal.count, np.nan)
    live = np.isfinite(asked)
    for _ in range(60):
        f, off = marginal.cumulative(np.where(live, asked, np.nan))
        f -= p
        low = np.where(live & (f < 0), asked, low)
        high = np.where(live & (f >= 0), asked, high)
        with np.errstate(invalid="ignore", divide="ignore"):
            slope = (f - f_last) / (asked - last)
            density = np.where(live & (slope > 0), slope, density)
            following = asked - f / density
            error = np.where(live, (off + lost + 0.1 * np.abs(f)) / density, error)
        # Where a secant does not lead on, as beside a gap, halves do.
        slow = np.isfinite(f_last) & (np.abs(f) > 0.5 * np.abs(f_last))
        inside = (following >= low) & (following <= high)
        near = np.abs(f) < 0.002 * min(p, 1 - p)
        following = np.where(inside & (near | ~slow), following, (low + high) / 2)
        best = np.where(live, following, best)
        live &= ~((inside & near) | (high - low <= 1e-12 * np.abs(high)))
        if not live.any():
            break
        last, f_last, asked = asked, f, following
    return best, error


def draws(tiled: TiledObserver, reading: Array, count: int, rng: np.random.Generator) -> Array:
    """Coordinates (B, count, d) drawn from the posteriors of readings (B, R), one by one.

    A tile is cut into cells, each with the mass that the polynomial gives it; cells are drawn in
    strata, and a place in each.
    """
    dim = tiled.dim
    cells = 24 if dim <= 2 else 12
    finer = to_cells(cells)
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
