"""Posteriors summed over tiles, many readings at a time."""

from __future__ import annotations

from functools import cached_property, reduce
from itertools import product
from typing import NamedTuple

import numpy as np

from .._values import Array, Flags, Index
from .observer import Observer
from .result import joined
from .summed import within
from .tiling import ORDER, Tiles, near_the_cut, negligible

#: Tiles that are looked for together.
GROUP = 16


class Weighed(NamedTuple):
    """Pairs of a reading and a tile that has some of its mass.

    The reading and the tile of each pair (n,), the weights of its nodes (n, N) over the largest of
    the reading, and ln of the largest (B,). Of an unknown that is summed out: mean and sd (B,), its
    coordinate at each reading's best node (B,), and mass (B, L) at steps (B,) of its coordinate
    about 0. Where it moves the angle at a node: means (n, N) of the angle and of its square, over
    those at the middle.
    """

    row: Index
    tile: Index
    weight: Array
    top: Array
    last: tuple[Array, Array] | None = None
    last_best: Array | None = None
    last_mass: Array | None = None
    last_step: Array | None = None
    turn: tuple[Array, Array] | None = None


class Moments(NamedTuple):
    """Of B posteriors: mean and sd (B, U), ln of the evidence; and how well it went.

    The share of the mass on the best node, the contact there (B, U) and its signals (B, S); the
    share on tiles that are longer than they should be, or next to what is left out; and how far off
    signals are at the nodes, in sds, where they are functions of an unknown that is summed out.
    """

    mean: Array
    sd: Array
    log_evidence: Array
    share: Array
    contact: Array
    signals: Array
    rough: Array
    misfit: Array


class TiledObserver:
    """The tiles of an observer, laid out for many readings.

    `longest` is the length asked of the tiles; `everywhere` looks for a reading on all of them,
    however far from their signals it lies.
    """

    #: Readings that are worked on together: their arrays stay in the cache.
    together = 96
    #: By how much readings may be larger for a scale that all signals have.
    scales: tuple[float, float] | None = None

    def __init__(
        self, observer: Observer, tiles: Tiles, longest: float, *, everywhere: bool = False
    ) -> None:
        self.observer, self.tiles, self.everywhere = observer, tiles, everywhere
        self.negligible = negligible(longest)
        nodes = tiles.nodes
        self.count, self.dim = len(nodes.low), tiles.boxes.low.shape[1]
        self.log_weight = nodes.log_weight
        corner = list(product((1, ORDER - 2), repeat=self.dim))
        self._few = few = np.ravel_multi_index(np.transpose(corner), (ORDER,) * self.dim)
        self._prepare(nodes.signals)
        self._few_weight = nodes.log_weight[:, few]
        contact = np.where(np.isfinite(nodes.log_weight)[..., None], nodes.contact, 0.0)
        one = np.ones((*contact.shape[:-1], 1))
        self._rough = nodes.lengths.max(axis=1) > 1.01 * longest
        self._rough |= near_the_cut(observer, nodes, longest)
        #: 1, the contact and its squares at each node, (T, N, 1 + 2U).
        self._powers = np.concatenate([one, contact, contact**2], axis=-1)
        self._middle = self._powers[:, few].mean(axis=1)
        size = nodes.low.shape[-1]
        # Of many numbers of a reading, as of counts, twelve tell which tiles are near.
        self._looked_at = np.unique(np.linspace(0, size - 1, 12).round().astype(np.intp))
        self._bounds = [
            _Bounds.of(nodes.low[:, i, self._looked_at].T, nodes.high[:, i, self._looked_at].T)
            for i in range(nodes.low.shape[1])
        ]

    def _prepare(self, signals: Array) -> None:
        """Work out what the likelihood at nodes (T, N, S) does not owe to readings."""
        self._at = self.observer.noise.prepared(signals)
        self._at_few = self.observer.noise.prepared(signals[:, self._few])

    def find(self, reading: Array, panel: int = 0) -> tuple[Index, Index]:
        """Pairs of a reading (B, R) and a tile from which it may come, by readings."""
        if self.everywhere:
            row, tile = np.divmod(np.arange(len(reading) * self.count), self.count)
            return row, tile
        bounds = self._bounds[panel]
        columns = [reading[:, column, None] for column in self._looked_at]
        near = within(bounds.group_low, bounds.group_high, columns, self.scales)
        row, group = np.nonzero(near)
        tile = (group[:, None] * GROUP + np.arange(GROUP)).ravel()
        row = np.repeat(row, GROUP)
        inside = tile < self.count
        return self._near(reading, row[inside], tile[inside], panel)

    def _near(self, reading: Array, row: Index, tile: Index, panel: int = 0) -> tuple[Index, Index]:
        """Those of the pairs whose tile makes the reading plausible."""
        low, high = ([side.take(tile) for side in ends] for ends in self._bounds[panel][:2])
        near = within(low, high, [reading[row, c] for c in self._looked_at], self.scales)
        return row[near], tile[near]

    def weigh(self, reading: Array, *, whole: bool = False) -> Weighed:
        """The weights of the nodes for readings (B, R); a reading may have no tile.

        Those of no weight are 0, but not in `whole` tiles.
        """
        if not self.everywhere and self._crowded:  # without looking for those near a reading
            row, tile = self._of_all(reading)
        else:
            row, tile = self.find(reading)
            log = self._at_few(reading[row], tile)
            log += self._few_weight[tile]
            live = self._matters(row, tile, log)
            row, tile = row[live], tile[live]
        weight = self._at(reading[row], tile)
        weight += self.log_weight[tile]
        top = np.full(len(reading), -np.inf)
        np.maximum.at(top, row, weight.max(axis=1))
        weight -= np.where(np.isfinite(top), top, 0.0)[row, None]
        np.exp(weight, out=weight)
        return Weighed(row, tile, weight, top)

    @cached_property
    def _crowded(self) -> bool:
        """Whether readings may come from more than a fifth of the tiles, as they do above k = 0.14.

        As told by those of some tiles' own signals. With fewer near, looking is twice as quick.
        """
        noise = self.observer.noise
        if noise.gaussian_on != "linear" or not 0 < self.count <= 4000:
            return False
        some = self.tiles.nodes.signals[:: -(-self.count // 32), self._few[0]]
        return len(self.find(noise.mean(some))[0]) > 0.2 * len(some) * self.count

    def _of_all(self, reading: Array) -> tuple[Index, Index]:
        """`find` and `_matters` where there are few tiles: of all at once, by products of matrices.

        Half as dear at k = 0.3, where readings may come from half of 2000 tiles.
        """
        signals = self.tiles.nodes.signals[:, self._few].swapaxes(0, 1)
        log = self.observer.noise.log_likelihoods(reading, signals.reshape(-1, signals.shape[-1]))
        log += self._few_weight.T.ravel()
        best = log.reshape(len(reading), len(self._few), -1).max(axis=1)
        top = best.max(axis=1, initial=-np.inf)
        best -= np.where(np.isfinite(top), top, 0.0)[:, None]
        sums = np.exp(best) @ self._middle
        first, second = np.split(sums[:, 1:] / np.maximum(sums[:, :1], 1e-300), 2, axis=1)
        variance = np.maximum(second - first**2, 1e-300)
        # Tiles 55 sd away, as far below the best as that, are left out unseen.
        row, tile = np.nonzero(best > -self.negligible - 8.0)
        middle = self._middle[tile, 1 : 1 + first.shape[1]]
        off = reduce(np.maximum, ((middle - first[row]) ** 2 / variance[row]).T)
        live = best[row, tile] + np.log1p(off) > -self.negligible
        return self._near(reading, row[live], tile[live])

    def _matters(self, row: Index, tile: Index, log: Array, below: float | None = None) -> Flags:
        """Of which pairs the mass, or what it adds to a variance, is not negligible.

        Told by the best of a few nodes of each.
        """
        best = reduce(np.maximum, log.T)  # `max` along rows of four takes longer
        count = int(row[-1]) + 1 if len(row) else 0
        top = np.full(count, -np.inf)
        np.maximum.at(top, row, best)
        weight = np.exp(best - np.where(np.isfinite(top), top, 0.0)[row])
        middle = self._middle[tile]
        sums = summed(weight[:, None] * middle, row, count)
        first, second = np.split(sums[:, 1:] / np.maximum(sums[:, :1], 1e-300), 2, axis=1)
        variance = np.maximum(second - first**2, 1e-300)
        off = (middle[:, 1 : 1 + first.shape[1]] - first[row]) ** 2 / variance[row]
        return np.asarray(best + np.log1p(off.max(axis=1)) > top[row] - (below or self.negligible))

    def moments(self, reading: Array) -> Moments:
        """Moments of the contact for readings (B, R); NaN where no tile has mass."""
        size = self.together
        parts = [self._moments(reading[i : i + size]) for i in range(0, len(reading), size)]
        return joined(parts)

    def _moments(self, reading: Array) -> Moments:
        weighed = self.weigh(reading)
        of_tiles = (weighed.weight[:, None] @ self._powers[weighed.tile])[:, 0]
        unknowns = self._powers.shape[-1] // 2
        if weighed.turn is not None:
            for column, turn in zip((2, 2 + unknowns), weighed.turn, strict=True):
                moved = weighed.weight * turn * self._powers[weighed.tile, :, column]
                of_tiles[:, column] = moved.sum(axis=1)
        sums = summed(of_tiles, weighed.row, len(reading))
        with np.errstate(invalid="ignore", divide="ignore"):
            mean = sums[:, 1 : 1 + unknowns] / sums[:, :1]
            square = sums[:, 1 + unknowns :] / sums[:, :1]
            log_evidence = np.log(sums[:, 0]) + weighed.top
            share = 1 / sums[:, 0]
            rough = np.where(self._rough[weighed.tile], of_tiles[:, 0], 0.0)
            rough = summed(rough, weighed.row, len(reading)) / sums[:, 0]
            off = (weighed.weight * self._misfit(weighed.tile)).sum(axis=1)
            misfit = summed(off, weighed.row, len(reading)) / sums[:, 0]
        best = np.zeros((2, len(reading)), dtype=np.intp)
        pair, node = np.nonzero(weighed.weight == 1.0)
        best[:, weighed.row[pair]] = weighed.tile[pair], node
        sd = np.sqrt(np.maximum(square - mean**2, 0))
        contact, signals = self._at_best(best[0], best[1], weighed)
        if weighed.last is not None:
            first, second = weighed.last
            mean, sd = np.column_stack([mean, first]), np.column_stack([sd, second])
        return Moments(mean, sd, log_evidence, share, contact, signals, rough, misfit)

    def _misfit(self, tile: Index) -> Array:
        """By how much signals are off at the nodes of tiles (n, N), in sds."""
        return np.zeros((len(tile), 1))

    def _at_best(self, tile: Index, node: Index, weighed: Weighed) -> tuple[Array, Array]:
        """Contacts and signals at nodes (B,) of tiles (B,)."""
        if not self.count:
            none = np.full((len(tile), len(self.observer.cue.signal_names)), np.nan)
            return np.full((len(tile), self.dim), np.nan), none
        nodes = self.tiles.nodes
        return nodes.contact[tile, node], nodes.signals[tile, node]

    def last_quantiles(
        self, reading: Array, weighed: Weighed, probability: Array, lost: Array
    ) -> tuple[Array, Array]:
        """Quantiles (B, Q) of an unknown that is summed out, and their errors.

        `lost` (B,) is mass that may lie on the wrong side.
        """
        raise NotImplementedError

    def completed(self, reading: Array, x: Array, rng: np.random.Generator) -> Array:
        """Contacts (B, n, U) at coordinates (B, n, d) drawn for readings (B, R)."""
        return self.observer.contact(x)[0]


class _Bounds(NamedTuple):
    """Between which readings tiles (R, T), and groups of them (R, G), make plausible lie."""

    low: Array
    high: Array
    group_low: Array
    group_high: Array

    @classmethod
    def of(cls, low: Array, high: Array) -> _Bounds:
        low, high = np.ascontiguousarray(low), np.ascontiguousarray(high)
        groups = _grouped(low, np.inf).min(axis=-1), _grouped(high, -np.inf).max(axis=-1)
        return cls(low, high, *groups)


def last_moments(value: Array, mass: Array) -> tuple[Array, Array]:
    """Mean and sd (B,) of values (B, L) that have masses (B, L)."""
    with np.errstate(invalid="ignore", divide="ignore"):
        share = mass / mass.sum(axis=1, keepdims=True)
    mean = (share * value).sum(axis=1)
    return mean, np.sqrt((share * np.square(value - mean[:, None])).sum(axis=1))


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
