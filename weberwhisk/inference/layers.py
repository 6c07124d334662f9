"""Layers: unknowns that have a prior alone, each summed over even nodes of its coordinate.

Friction, stiffness, curvature, hinge, roll and azimuth are not bounded by the whisker. At each node
of theirs distance and angle have cells of their own in one tree, with their own range of angles.
Nodes are halved where the sums over odd and even ones disagree. (Cells of all axes fail: they are
thin oblique sheets, up to a million a reading.)
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import product
from typing import Any, Protocol

import numpy as np
from scipy.special import ndtr

from .._util.values import Array, Flags, Index
from .._util.weights import half_error, halves, mixture_moments, resampled
from .coordinates import within_half_turn
from .descent import cell_sums, glimpse
from .nodes import HALVINGS, Layers
from .tree import DROP
from .weighted import (
    OVER,
    CellSums,
    Spans,
    extrapolated,
    interpolate,
    masses,
    mixed,
    spans_between,
)

__all__ = ["SCORES", "LayeredSums"]

#: Normal scores at which conditional quantiles are interpolated from node to node.
SCORES = np.linspace(-4.5, 4.5, 37)
#: Parts of a step between nodes at which conditional posteriors are interpolated.
PARTS = 8


@dataclass(eq=False)
class AtNodes:
    """Posteriors of n pairs of a reading and a node, summed together.

    Attributes
    ----------
    sums : CellSums
    readings : array, shape (n,)
        The number of each reading.
    node : array, shape (n, D)
    log : array, shape (n,)
        ln of the evidence of reading and node.
    quantiles : dict
        By unknown, (n, Q) at `SCORES`, once they are needed.
    """

    sums: CellSums
    readings: Index
    node: Index
    log: Array
    quantiles: dict[int, Array] = field(default_factory=dict)


class LayeredSums:
    """As `weighted.Sums`, of B readings at nodes, at each of which there are weighted cells.

    Parameters
    ----------
    layers : Layers
    readings : array, shape (B, R)
    covariance : array, shape (B, R, R), optional
        Of measurement errors, which add to the receptors' noise.
    drop : float
        Nats below the highest density at which cells are left out.
    """

    def __init__(
        self, layers: Layers, readings: Array, covariance: Array | None = None, drop: float = DROP
    ) -> None:
        self.layers, self.axes, self.observer = layers, layers.axes, layers.observer
        self.readings, self.covariance, self.drop = readings, covariance, drop
        count, unknowns = len(readings), layers.inner + len(self.axes)
        self.mean, self.sd, self.best = np.full((3, count, unknowns), np.nan)
        self.error, self.log_evidence = np.full(count, np.inf), np.full(count, np.nan)
        self.halvings = np.zeros((count, len(self.axes)), dtype=int)
        #: Numbers of nodes, their places (N, D), and their numbers in the tree.
        self.numbers: dict[tuple[int, ...], int] = {}
        self.nodes, self.given = np.zeros((0, len(self.axes)), dtype=int), np.zeros(0, dtype=int)
        #: Of each node and reading: ln of the evidence, or what it may be, and moments; which of
        #: the parts it is in, and where there.
        self.log, self.guess, self.error_at = np.zeros((3, 0, count))
        self.mean_at, self.sd_at = np.zeros((2, 0, count, layers.inner))
        self.part, self.pair = np.zeros((2, 0, count), dtype=np.int32)
        self.at_nodes: list[AtNodes] = []
        self._solve()

    @property
    def bytes(self) -> int:
        """Memory of the cells at all nodes, with their sums and quantiles."""
        cells = sum(
            each.sums.bytes + 8 * len(SCORES) * len(each.readings) for each in self.at_nodes
        )
        return cells + 64 * len(self.nodes) * len(self.readings)

    def _solve(self) -> None:
        """Halve nodes until sums over odd and even ones agree."""
        todo = np.arange(len(self.readings))
        halvings = np.zeros(len(self.axes), dtype=int)
        before: tuple[Any, ...] = ()
        while todo.size:
            keys = self._keys(halvings)
            self._evaluate(keys, todo, before)
            each = self._sum(keys, halvings, todo)
            self.halvings[todo] = halvings
            with np.errstate(invalid="ignore"):
                bad = (each > self.layers.tolerance) & (halvings < HALVINGS)[:, None]
            again = bad.any(axis=0)
            before = halvings.copy(), todo
            halvings = halvings + bad.any(axis=1)
            todo = todo[again]

    def _keys(self, halvings: Index) -> list[Index]:
        return [axis.nodes(int(h)) for axis, h in zip(self.axes, halvings, strict=True)]

    def _grid(self, keys: list[Index]) -> Index:
        """The numbers of all nodes (...), with room for the sums at those that are new.

        Their evidence is NaN until it is summed.
        """
        every = list(product(*map(np.ndarray.tolist, keys)))
        new = [key for key in every if key not in self.numbers]
        if new:
            self.numbers |= {key: len(self.nodes) + i for i, key in enumerate(new)}
            nodes, empty = np.array(new), {"log": np.nan, "guess": -1e5, "part": -1}
            self.nodes = np.concatenate([self.nodes, nodes])
            self.given = np.append(self.given, self.layers.numbers(nodes.T))
            for name in ("log", "guess", "error_at", "mean_at", "sd_at", "part", "pair"):
                table = getattr(self, name)
                room = np.full((len(new), *table.shape[1:]), empty.get(name, 0), dtype=table.dtype)
                setattr(self, name, np.concatenate([table, room]))
        return np.array([self.numbers[key] for key in every]).reshape(*map(len, keys))

    def _evaluate(self, keys: list[Index], subset: Index, before: tuple[Any, ...]) -> None:
        """Ask the tree at all nodes that may have mass."""
        grid = self._grid(keys).ravel()
        at = np.ix_(grid, subset)
        if before:
            without, guess = self._bound(keys, subset, *before)
            without &= np.isnan(self.log[at])
            self.log[at] = np.where(without, -np.inf, self.log[at])
            self.guess[at] = np.where(without, guess, self.guess[at])
        best = np.full(len(self.readings), -np.inf)
        best[subset] = np.fmax.reduce(self.log[at], axis=0, initial=-np.inf)
        new = np.isnan(self.log[at])
        if not before:  # first the node where each reading is most probable at a glance
            node, row = np.nonzero(np.ones_like(new))
            readings, covariance, slope = self._for_tree(grid[node], subset[row])
            seen = glimpse(self.layers.tree, readings, covariance, self.given[grid[node]]) + slope
            most = np.zeros_like(new)
            most[seen.reshape(new.shape).argmax(axis=0), np.arange(len(subset))] = True
            self._ask(grid, subset, most & new, best)
        self._ask(grid, subset, np.isnan(self.log[at]), best)

    def _bound(
        self, keys: list[Index], subset: Index, halvings: Index, before: Index
    ) -> tuple[Flags, Array]:
        """Whether nodes (N, n) have next to no mass, by those beside them, and a guess of it."""
        old = self._grid(self._keys(halvings))
        log = self.guess[np.ix_(old.ravel(), subset)].reshape(*old.shape, len(subset))
        # Between nodes it may be higher by an eighth of its second difference, as a parabola is:
        # twice that is allowed for.
        rise = np.zeros_like(log)
        for d, axis in enumerate(self.axes):
            if axis.around:
                second = np.roll(log, 1, d) + np.roll(log, -1, d) - 2 * log
            else:
                pad = [(1, 1) if i == d else (0, 0) for i in range(log.ndim)]
                second = np.diff(np.pad(log, pad, mode="reflect", reflect_type="odd"), 2, axis=d)
            rise += np.abs(second) / 4
        possible = log + rise > log.reshape(-1, len(subset)).max(axis=0) - self.drop
        for d, (axis, nodes) in enumerate(zip(self.axes, keys, strict=True)):
            if len(nodes) > old.shape[d]:  # a new node between any two
                log, possible = np.moveaxis(log, d, 0), np.moveaxis(possible, d, 0)
                after, later = np.roll(log, -1, axis=0), np.roll(possible, -1, axis=0)
                log = np.stack([log, (log + after) / 2], axis=1).reshape(-1, *log.shape[1:])
                both = np.stack([possible, possible | later], axis=1)
                possible = both.reshape(-1, *possible.shape[1:])
                end = None if axis.around else -1
                log, possible = np.moveaxis(log[:end], 0, d), np.moveaxis(possible[:end], 0, d)
        return ~possible.reshape(-1, len(subset)), log.reshape(-1, len(subset))

    def _for_tree(self, nodes: Index, subset: Index) -> tuple[Array, Array | None, Array]:
        """What to ask of the tree of pairs (P,) of the number of a node and a reading.

        Readings, covariances, and ln of Jacobian times prior.
        """
        at = self.nodes[nodes].T
        values = self.layers.values(at)
        covariance = None if self.covariance is None else self.covariance[subset]
        readings, covariance, more = self.layers.for_tree(self.readings[subset], covariance, values)
        return readings, covariance, self.layers.log_prior(at, values) + more

    def _ask(self, grid: Index, subset: Index, chosen: Flags, best: Array) -> None:
        """Sum over the cells of `chosen` (N, n) pairs of a node and a reading of the `subset`.

        With the `best` (B,) evidence of each reading so far.
        """
        node, row = np.nonzero(chosen)
        if not node.size:
            return
        node, row = grid[node], subset[row]
        readings, covariance, slope = self._for_tree(node, row)
        least = best[row] - 2 * self.drop
        sums = cell_sums(
            self.layers.tree, readings, covariance, which=self.given[node], drop=self.drop,
            least=least - slope,
        )  # fmt: skip
        has_mass = np.isfinite(sums.log_evidence)
        log = np.where(has_mass, sums.log_evidence + slope, -np.inf)
        np.maximum.at(best, row, log)
        self.log[node, row] = log
        self.guess[node, row] = np.maximum(np.where(has_mass, log, least), -1e5)
        self.mean_at[node, row], self.sd_at[node, row] = np.nan_to_num([sums.mean, sums.sd])
        self.error_at[node, row] = np.where(has_mass, sums.error, 0.0)
        self.part[node, row], self.pair[node, row] = len(self.at_nodes), np.arange(len(row))
        self.at_nodes.append(AtNodes(sums, row, self.nodes[node], log))

    def _sum(self, keys: list[Index], halvings: Index, subset: Index) -> Array:
        """Sum over nodes; about how far off the sums along each axis are, (D, n)."""
        inner = self.layers.inner
        number = self._grid(keys)
        at = np.ix_(number.ravel(), subset)
        log, mean, sd = self.log[at], self.mean_at[at], self.sd_at[at]
        top = log.max(axis=0)
        with np.errstate(invalid="ignore"):
            weight = np.where(np.isfinite(top), np.exp(log - top), 0.0)
        best = log.argmax(axis=0)
        grid = self.nodes[number.ravel()].T
        values, middle = [], []
        for axis, at_node in zip(self.axes, self.layers.values(grid), strict=True):
            value = np.broadcast_to(at_node[:, None], log.shape)
            if axis.around and not axis.from_plane:  # a half turn from the best to either side
                at_best = value[best, np.arange(len(subset))]
                value = at_best + within_half_turn(value - at_best)
            values.append(value)
            middle.append(value[best, np.arange(len(subset))])

        # Of the unknowns at a node the conditional posteriors, of the others the values.
        means = np.concatenate([mean, np.stack(values, axis=-1)], axis=-1)
        sds = np.concatenate([sd, np.zeros((*log.shape, len(values)))], axis=-1)
        whole = mixture_moments(weight[..., None], means, sds)
        self.mean[subset], self.sd[subset], total = whole.mean, whole.sd, whole.total[..., 0]
        least_sd = np.maximum(whole.sd, 1e-300)
        each = np.zeros((len(keys), len(subset)))
        count = [(at_axis - k[0]) // (k[1] - k[0]) for at_axis, k in zip(grid, keys, strict=True)]
        for axes, half in halves(np.stack(count)):
            part = mixture_moments((weight * half[:, None])[..., None], means, sds)
            share = part.total / whole.total
            off = half_error(share, part.mean - whole.mean, part.sd, least_sd)
            each[axes] = np.maximum(each[axes], off.max(axis=1))
        each = np.minimum(each, 1e100)
        # On a circle sums over every other node are off by the root of this, as in `Sums.add`.
        each[[axis.around for axis in self.axes]] **= 2
        # Where the mass ends between two nodes, by half of that beside: halves may agree by chance.
        # Beside none with so much does a Gaussian fall by more than 3 nats once its halves agree.
        at_node, share = (v.reshape(*number.shape, -1) for v in (log, weight / total))
        for d, axis in enumerate(self.axes):
            sides = [_shifted(at_node, k, axis=d, circle=axis.around) for k in (-1, 1)]
            ends = np.min(sides, axis=0) < at_node - 6.0
            each[d] = np.maximum(each[d], 0.5 * (share * ends).reshape(-1, len(subset)).sum(axis=0))
        inside = (weight * self.error_at[at]).sum(axis=0)
        self.error[subset] = np.maximum(each.max(axis=0), inside / total)
        steps = sum(np.log(a.unit * (k[1] - k[0])) for a, k in zip(self.axes, keys, strict=True))
        self.log_evidence[subset] = top + np.log(total) + steps
        for i, value in enumerate(middle):
            self.best[subset, inner + i] = value
        which = number.ravel()[best], subset
        for k in np.unique(self.part[which]):
            mine = subset[self.part[which] == k]
            pair = self.pair[which][self.part[which] == k]
            self.best[mine, :inner] = self.at_nodes[k].sums.best[pair]
        none = ~np.isfinite(top)
        self.error[subset[none]], self.log_evidence[subset[none]] = np.inf, np.nan
        self.mean[subset[none]], self.sd[subset[none]] = np.nan, np.nan
        return each

    # -- quantiles and draws -----------------------------------------------------------------------

    def _refine(self, subset: Index, criterion: Criterion) -> None:
        """Halve nodes of readings whose conditional posteriors fail a criterion between them."""
        while subset.size:
            left = []
            for halvings in np.unique(self.halvings[subset], axis=0):
                group = subset[(self.halvings[subset] == halvings).all(axis=1)]
                bad = self._failing(self._keys(halvings), group, criterion)
                bad &= (halvings < HALVINGS)[:, None]
                again = bad.any(axis=0)
                if again.any():
                    finer = halvings + bad.any(axis=1)
                    self._evaluate(self._keys(finer), group[again], (halvings, group[again]))
                    self.halvings[group[again]] = finer
                    left.append(group[again])
            subset = np.concatenate(left) if left else subset[:0]

    def _failing(self, keys: list[Index], subset: Index, criterion: Criterion) -> Flags:
        """Along which axes posteriors at nodes fail a criterion, (D, B)."""
        grid = self._grid(keys)
        at = np.ix_(grid.ravel(), subset)
        shape = *grid.shape, len(subset)
        log = (self.log[at] - self.log[at].max(axis=0)).reshape(shape)
        mean, sd = (table[at].reshape(*shape, -1) for table in (self.mean_at, self.sd_at))
        out = np.zeros((len(keys), len(subset)), dtype=bool)
        for d, axis in enumerate(self.axes):
            beside = Neighbours(log, mean, sd, d, axis.around)
            with np.errstate(invalid="ignore", divide="ignore"):
                out[d] = (criterion.excess(beside).reshape(-1, len(subset)) > 1).any(axis=0)
        return out

    def _box(self, row: int) -> tuple[list[Index], Index, Array]:
        """About the mass of one reading: nodes along each axis, all numbers, ln of the evidence."""
        keys = self._keys(self.halvings[row])
        number = self._grid(keys)
        log = self.log[number, row]
        log = np.where(np.isnan(log), -np.inf, log)
        best = np.unravel_index(log.argmax(), log.shape)
        out = []
        for d, axis in enumerate(self.axes):
            nodes = keys[d]
            if axis.around:  # from the node opposite to the best on
                shift = len(nodes) // 2 - int(best[d])
                log, number = np.roll(log, shift, axis=d), np.roll(number, shift, axis=d)
                step = nodes[1] - nodes[0]
                nodes = nodes[best[d]] + step * (np.arange(len(nodes)) - len(nodes) // 2)
            along = np.moveaxis(log, d, 0).reshape(len(nodes), -1).max(axis=1)
            live = np.flatnonzero(along > log.max() - self.drop)
            low, high = max(live[0] - 1, 0), min(live[-1] + 2, len(nodes))
            if high - low < 2:
                low, high = max(low - 1, 0), min(high + 1, len(nodes))
            log, number = (np.take(a, np.arange(low, high), axis=d) for a in (log, number))
            out.append(nodes[low:high])
        return out, number, log

    def quantiles(self, p: Array, unknown: int) -> Array:
        """Quantiles (B, Q) of an unknown."""
        spans, halved = self.spans(unknown), self.spans(unknown, 2)
        return extrapolated(spans, halved, p, len(self.error))

    def spans(self, unknown: int, stride: int = 1) -> Iterator[Spans]:
        """Spans of an unknown, for one reading at a time; half as many with a stride of 2."""
        inner = self.layers.inner
        solved = np.flatnonzero(np.isfinite(self.log_evidence))
        if unknown < inner:
            self._refine(solved, IsSmooth(self.drop))
        for row in solved:
            keys, number, log = self._box(int(row))
            at = np.array([row])
            d = unknown - inner
            if d >= 0 and self.axes[d].from_plane:
                of_roll = self._rolls(d, keys, log, stride)
                yield mixed(at, *of_roll, SCORES[::stride], PARTS // stride)
            elif d >= 0:
                rest = tuple(i for i in range(log.ndim) if i != d)
                along = np.logaddexp.reduce(log, axis=rest) if rest else log
                x, fine = interpolate(along[None], 2 * PARTS // stride)
                step = keys[d][1] - keys[d][0]
                value = self.axes[d].value(keys[d][0] + step * x)
                yield spans_between(at, value[None], fine)
            else:
                heavy = log > log.max() - self.drop
                quantile = np.full((*log.shape, len(SCORES)), np.nan)
                for i in zip(*np.nonzero(heavy), strict=True):
                    part, pair = self._place(number[i], int(row))
                    quantile[i] = self._conditional(part, unknown)[pair]
                heavy &= np.isfinite(quantile[..., 0])
                quantile = quantile[..., ::stride]
                yield mixed(at, log, heavy, quantile, SCORES[::stride], PARTS // stride)

    def _rolls(
        self, roll: int, keys: list[Index], log: Array, stride: int
    ) -> tuple[Array, Flags, Array]:
        """At nodes of all but the roll: ln of the evidence, whether there is any, its quantiles."""
        log = np.moveaxis(log, roll, -1)
        x, fine = interpolate(log.reshape(-1, log.shape[-1]), 2 * PARTS // stride)
        step = keys[roll][1] - keys[roll][0]
        middle = keys[roll][0] + step * (x[1:] + x[:-1]) / 2
        nodes = [middle if i == roll else k for i, k in enumerate(keys)]
        value = self.layers.values(np.meshgrid(*nodes, indexing="ij"))[roll]
        value = np.moveaxis(value, roll, -1).reshape(len(fine), -1)
        half = self.axes[roll].unit * step * (x[1] - x[0]) / 2
        spans = Spans(np.arange(len(fine)), value - half, value + half, masses(fine))
        quantile = spans.quantiles(ndtr(SCORES[::stride])).reshape(*log.shape[:-1], -1)
        return np.logaddexp.reduce(log, axis=-1), np.isfinite(quantile[..., 0]), quantile

    def _place(self, number: Any, row: int) -> tuple[AtNodes, int]:
        """Where the sums of a reading at a node are, and their number there."""
        return self.at_nodes[self.part[number, row]], int(self.pair[number, row])

    def _conditional(self, at_nodes: AtNodes, unknown: int) -> Array:
        """Quantiles (n, Q) of readings at nodes, of those that have mass there."""
        if unknown not in at_nodes.quantiles:
            heavy = at_nodes.log > self.log_evidence[at_nodes.readings] - self.drop
            at_nodes.quantiles[unknown] = at_nodes.sums.quantiles(ndtr(SCORES), unknown, heavy)
        return at_nodes.quantiles[unknown]

    def draws(self, count: int, rng: np.random.Generator, readings: Array) -> Array:
        """Draws (B, count, U) of the contact, given the readings (B, R)."""
        out = np.full((len(self.readings), count, len(self.observer.unknowns)), np.nan)
        solved = np.flatnonzero(np.isfinite(self.log_evidence))
        self._refine(solved, Overlap())
        for row in solved:
            keys, number, log = self._box(int(row))
            weight = np.exp(0.75 * (log - log.max())).ravel()
            weight /= weight.sum()
            many = rng.multinomial(OVER * count, weight)
            x, z, log_of = [], [], []
            for i in np.flatnonzero(many):
                at = np.unravel_index(i, log.shape)
                centre = tuple(k[j] for k, j in zip(keys, at, strict=True))
                part, pair = self._place(number[at], int(row))
                proposed, log_proposed = part.sums.proposals(int(many[i]), rng, pair)
                x.append(proposed)
                step = np.array([k[1] - k[0] for k in keys])
                z.append(centre + step * (rng.random((len(x[-1]), len(centre))) - 0.5))
                log_of.append(log_proposed + np.log(weight[i]))
            inner, node = np.concatenate(x), np.concatenate(z)
            further = self.layers.values(node.T)
            contact, log_density = self.observer.space.constrain(inner, further=further)
            log_density += self.layers.log_prior(node.T, further)
            log_density += self.observer.log_likelihood(self.readings[row], contact)
            chosen = resampled(log_density - np.concatenate(log_of), count, rng)
            out[row] = contact[chosen]
        return out


@dataclass(frozen=True, eq=False)
class Neighbours:
    """Posteriors at nodes (n, ...) of readings (B,), and those beside them along an axis.

    ln of the evidence (n, ..., B) below the best, means and sds (n, ..., B, U).
    """

    log: Array
    mean: Array
    sd: Array
    axis: int
    is_circle: bool

    def moved(self, values: Array, by: int) -> Array:
        """Of each node those that are so many nodes further."""
        return _shifted(values, by, axis=self.axis, circle=self.is_circle)


class Criterion(Protocol):
    """What conditional posteriors must fulfil between nodes."""

    def excess(self, at: Neighbours) -> Array:
        """How far each is from it, (n, ..., B): above 1 it fails."""


@dataclass(frozen=True)
class IsSmooth:
    """Cubics between nodes must be right, by those of twice the step.

    What a node's conditional mean is off, in its sds, moves quantiles by its share of the mass; at
    2.5 % that is seven times as many sds. Nodes more than `drop` nats below the best do not count.
    """

    drop: float

    def excess(self, at: Neighbours) -> Array:
        share = np.exp(at.log)
        share /= share.reshape(-1, at.log.shape[-1]).sum(axis=0)
        mean = at.mean
        off = mean - (9 * (at.moved(mean, 1) + at.moved(mean, -1))
                      - at.moved(mean, 3) - at.moved(mean, -3)) / 16  # fmt: skip
        off = np.nan_to_num(np.abs(off / at.sd).max(axis=-1), posinf=0.0)
        near = np.min([at.moved(at.log, k) for k in (-3, -1, 1, 3)], axis=0) > -self.drop
        # The error of fourth order is a sixteenth of that at half the steps; an end of an interval
        # may be 5e-3 sd off.
        return np.where(near, 7 * share * off, 0.0) / 16 / 5e-3


@dataclass(frozen=True)
class Overlap:
    """Conditional posteriors of neighbours must overlap: differ by less than their sds."""

    def excess(self, at: Neighbours) -> Array:
        step = np.abs(at.moved(at.mean, 1) - at.mean) / np.minimum(at.sd, at.moved(at.sd, 1))
        near = (at.log > -9.0) & (at.moved(at.log, 1) > -9.0)
        return np.where(near, np.nan_to_num(step).max(axis=-1), 0.0)


def _shifted(values: Array, by: int, *, axis: int, circle: bool) -> Array:
    """Values moved along an axis; −inf from beyond its ends, unless it is a circle."""
    moved = np.roll(values, -by, axis=axis)
    if not circle:
        beyond = [slice(None)] * values.ndim
        beyond[axis] = slice(-by, None) if by > 0 else slice(0, -by)
        moved[tuple(beyond)] = -np.inf
    return moved
