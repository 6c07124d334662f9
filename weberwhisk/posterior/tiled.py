"""Posteriors summed over tiles, many readings at a time."""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..observer import Observer
from .tiling import NEGLIGIBLE, ORDER, Array, Index, Tiles

#: Tiles that are looked for together.
GROUP = 16
#: Readings that are worked on together: their arrays stay in the cache.
TOGETHER = 96
#: Numbers of a reading by which its tiles are looked for: more, as of counts, tell no more.
LOOKED_AT = 12
#: What a tile's best corner node may be below its best place, in ln: it is as many sd away.
BETWEEN = 4.0


class Weighed(NamedTuple):
    """Pairs of a reading and a tile that has some of its mass.

    The reading and the tile of each pair (n,), the weights of its nodes (n, N) over the largest of
    the reading, and ln of the largest (B,).
    """

    row: Index
    tile: Index
    weight: Array
    top: Array


class Moments(NamedTuple):
    """Of B posteriors: mean and sd (B, U), ln of the evidence; and how well it went.

    The share of the mass on the best node, which of all nodes that is, and the share on tiles that
    are longer than they should be.
    """

    mean: Array
    sd: Array
    log_evidence: Array
    share: Array
    best: Index
    rough: Array


class TiledObserver:
    """The tiles of an observer, laid out for many readings.

    `longest` is the length asked of the tiles; `everywhere` looks for a reading on all of them,
    however far from their signals it lies.
    """

    def __init__(
        self, observer: Observer, tiles: Tiles, longest: float, *, everywhere: bool = False
    ) -> None:
        self.observer, self.tiles, self.everywhere = observer, tiles, everywhere
        nodes = tiles.nodes
        self.count, self.dim = len(nodes.low), tiles.boxes.low.shape[1]
        self.log_weight = nodes.log_weight
        self._at = observer.noise.prepared(nodes.signals)
        corner = list(product((1, ORDER - 2), repeat=self.dim))
        few = np.ravel_multi_index(np.transpose(corner), (ORDER,) * self.dim)
        self._at_few = observer.noise.prepared(nodes.signals[:, few])
        self._few_weight = nodes.log_weight[:, few]
        contact = np.where(np.isfinite(nodes.log_weight)[..., None], nodes.contact, 0.0)
        one = np.ones((*contact.shape[:-1], 1))
        self._rough = nodes.lengths.max(axis=1) > 1.01 * longest
        #: 1, the contact and its squares at each node, (T, N, 1 + 2U).
        self._powers = np.concatenate([one, contact, contact**2], axis=-1)
        self._middle = self._powers[:, few].mean(axis=1)
        size = nodes.low.shape[1]
        looked_at = np.unique(np.linspace(0, size - 1, LOOKED_AT).round().astype(np.intp))
        self._low, self._high = (
            np.ascontiguousarray(side[:, looked_at].T) for side in (nodes.low, nodes.high)
        )
        self._looked_at = looked_at
        self._group_low = _grouped(self._low, np.inf).min(axis=-1)
        self._group_high = _grouped(self._high, -np.inf).max(axis=-1)

    def find(self, reading: Array) -> tuple[Index, Index]:
        """Pairs of a reading (B, R) and a tile from which it may come, by readings."""
        if self.everywhere:
            row, tile = np.divmod(np.arange(len(reading) * self.count), self.count)
            return row, tile
        near = np.ones((len(reading), self._group_low.shape[1]), dtype=bool)
        for k, column in enumerate(self._looked_at):
            y = reading[:, column, None]
            near &= self._group_low[k] <= y
            near &= y <= self._group_high[k]
        row, group = np.nonzero(near)
        tile = (group[:, None] * GROUP + np.arange(GROUP)).ravel()
        row = np.repeat(row, GROUP)
        near = tile < self.count
        tile = np.minimum(tile, self.count - 1)
        for k, column in enumerate(self._looked_at):
            y = reading[row, column]
            near &= self._low[k][tile] <= y
            near &= y <= self._high[k][tile]
        return row[near], tile[near]

    def weigh(self, reading: Array) -> Weighed:
        """The weights of the nodes for readings (B, R); a reading may have no tile."""
        row, tile = self.find(reading)
        log = self._at_few(reading[row], tile)
        log += self._few_weight[tile]
        live = self._matters(row, tile, log, len(reading))
        row, tile = row[live], tile[live]
        weight = self._at(reading[row], tile)
        weight += self.log_weight[tile]
        top = np.full(len(reading), -np.inf)
        np.maximum.at(top, row, weight.max(axis=1))
        weight -= np.where(np.isfinite(top), top, 0.0)[row, None]
        np.exp(weight, out=weight)
        return Weighed(row, tile, weight, top)

    def _matters(self, row: Index, tile: Index, log: Array, count: int) -> NDArray[np.bool_]:
        """Of which pairs the mass, or what it adds to a variance, is not negligible.

        Told by the best of a few nodes of each.
        """
        best = log.max(axis=1)
        top = np.full(count, -np.inf)
        np.maximum.at(top, row, best)
        weight = np.exp(best - np.where(np.isfinite(top), top, 0.0)[row])
        middle = self._middle[tile]
        sums = summed(weight[:, None] * middle, row, count)
        first, second = np.split(sums[:, 1:] / np.maximum(sums[:, :1], 1e-300), 2, axis=1)
        variance = np.maximum(second - first**2, 1e-300)
        off = (middle[:, 1 : 1 + first.shape[1]] - first[row]) ** 2 / variance[row]
        return np.asarray(best + np.log1p(off.max(axis=1)) > top[row] - NEGLIGIBLE)

    def moments(self, reading: Array) -> Moments:
        """Moments of the contact for readings (B, R); NaN where no tile has mass."""
        parts = [self._moments(reading[i : i + TOGETHER]) for i in range(0, len(reading), TOGETHER)]
        return Moments._make(np.concatenate(column) for column in zip(*parts, strict=True))

    def _moments(self, reading: Array) -> Moments:
        weighed = self.weigh(reading)
        of_tiles = (weighed.weight[:, None] @ self._powers[weighed.tile])[:, 0]
        sums = summed(of_tiles, weighed.row, len(reading))
        unknowns = self._powers.shape[-1] // 2
        with np.errstate(invalid="ignore", divide="ignore"):
            mean = sums[:, 1 : 1 + unknowns] / sums[:, :1]
            square = sums[:, 1 + unknowns :] / sums[:, :1]
            log_evidence = np.log(sums[:, 0]) + weighed.top
            share = 1 / sums[:, 0]
            rough = np.where(self._rough[weighed.tile], of_tiles[:, 0], 0.0)
            rough = summed(rough, weighed.row, len(reading)) / sums[:, 0]
        best = np.zeros(len(reading), dtype=np.intp)
        pair, node = np.nonzero(weighed.weight == 1.0)
        best[weighed.row[pair]] = weighed.tile[pair] * self.log_weight.shape[1] + node
        return Moments(
            mean, np.sqrt(np.maximum(square - mean**2, 0)), log_evidence, share, best, rough
        )


def summed(values: Array, row: Index, count: int) -> Array:
    """Sums (B, …) over the pairs of each reading, 0 where there are none; rows rise."""
    out = np.zeros((count, *values.shape[1:]))
    if len(row):
        starts = np.flatnonzero(np.diff(row, prepend=-1))
        out[row[starts]] = np.add.reduceat(values, starts, axis=0)
    return out


def _grouped(values: Array, fill: float) -> Array:
    """Values (K, T) in groups (K, G, GROUP), filled up."""
    count = -(-values.shape[1] // GROUP)
    out = np.full((len(values), count * GROUP), fill)
    out[:, : values.shape[1]] = values
    return out.reshape(len(values), count, GROUP)
