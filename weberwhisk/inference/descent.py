"""The descent of readings through a tree, from coarse cells to the lattices that are summed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from .._util.values import Array, Flags, Index
from . import tree as trees
from .cells import Lattices, Level
from .tree import DROP, PAIRS, Tree
from .weighted import CellSums

__all__ = ["cell_sums", "glimpse"]

#: Most cells of one reading, and most times its cells are halved.
MOST, DEEPEST = 300_000, 22


def cell_sums(
    tree: Tree, readings: Array, covariance: Array | None = None, *, which: Index | None = None,
    drop: float = DROP, least: Array | None = None,
) -> CellSums:  # fmt: skip
    """The posteriors of readings (B, R) as weighted cells, and their moments.

    With the covariances (B, R, R) of measurement errors, which add to the receptors' noise, and
    the numbers (B,) of what is given, the first by default; cells whose density is `drop` nats
    below the highest are left out. A reading some of whose cells were left out too early
    descends again, three times in all at most; with `least` (B,) none does, and those whose ln
    of the density is nowhere above that have no sums.
    """
    which = np.zeros(len(readings), dtype=int) if which is None else which
    out = CellSums(len(readings), tree.unknowns, tree.observer, which)
    lowest = np.full(len(readings), -np.inf) if least is None else least
    deeper, tries = np.full(len(readings), drop), np.zeros(len(readings), dtype=int)
    waiting = list(_chunks(tree, which, 512))
    while waiting:
        subset = waiting.pop()
        if tree.bytes > trees.MEMORY:
            tree.forget()
        errors = None if covariance is None else covariance[subset]
        descent = Descent(tree, readings[subset], errors, which[subset], deeper[subset])
        remaining = descent.run(lowest[subset], 1.25 * trees.MEMORY, out, subset)
        if remaining.size == subset.size:  # whose cells are too many together
            waiting += np.array_split(subset, 2)
            continue
        # Again where cells turn out to have been left out too early.
        missed = descent.missed(drop) if least is None else np.zeros(len(subset))
        missed[remaining] = 0.0
        again = subset[missed > 0]
        deeper[again] += missed[missed > 0] + 1
        tries[again] += 1
        out.error[again[tries[again] == 3]] = np.inf
        again = np.append(subset[remaining], again[tries[again] < 3])
        if again.size:
            waiting.append(again)
    # That of a log-normal reading whose sign is not its signal's.
    out.log_evidence[out.log_evidence < -1e8] = np.nan
    return out


def glimpse(tree: Tree, readings: Array, covariance: Array | None, which: Index) -> Array:
    """ln of the highest density of readings (B, R) as coarse cells have it, (B,)."""
    out = np.full(len(readings), -np.inf)
    for subset in _chunks(tree, which, len(which)):
        errors = None if covariance is None else covariance[subset]
        descent = Descent(tree, readings[subset], errors, which[subset], np.zeros(len(subset)))
        pairs = descent.first()
        log = descent.log(pairs, blurred=True)
        out[subset] = np.maximum.reduceat(log, pairs.first) + descent.log_slope
    return out


def _chunks(tree: Tree, which: Index, most: int) -> Iterator[Index]:
    """Readings, up to `most` at a time, but for those that no contact can be of.

    Their pairs with the coarse cells are in memory at once.
    """
    tree.begin(which)
    possible = np.flatnonzero(tree.counts[which] > 0)
    size = (
        int(np.clip(PAIRS // max(tree.counts.max(initial=1), 1), 1, most)) if len(possible) else 1
    )
    for begin in range(0, len(possible), size):
        yield possible[begin : begin + size]


@dataclass(frozen=True, eq=False)
class Pairs:
    """Pairs of readings (P,) and cells (P,) of one level, sorted by reading.

    With `is_last` the cells are the readings' lattices, which are summed.
    """

    level: Level
    reading: Index
    cell: Index
    is_last: bool

    @property
    def first(self) -> Index:
        """Where the pairs of each reading begin."""
        return np.flatnonzero(np.diff(self.reading, prepend=-1))

    @property
    def counts(self) -> Index:
        return np.diff(self.first, append=len(self.reading))

    def of(self, chosen: Flags | slice) -> Pairs:
        return replace(self, reading=self.reading[chosen], cell=self.cell[chosen])


@dataclass(frozen=True, eq=False)
class Halving:
    """What to do with the cells of n readings.

    Along which axes to halve them, (U, n); whether they go on, and whether for the last time, (n,).
    """

    axes: Flags
    goes_on: Flags
    is_last: Flags


class Descent:
    """One chunk of readings on their way from the coarse cells to their lattices."""

    def __init__(
        self, tree: Tree, readings: Array, covariance: Array | None, which: Index, drop: Array
    ) -> None:
        self.tree, self.drop = tree, drop
        self.readings, self.covariance, self.which = readings, covariance, which
        self.log_slope = np.zeros(len(readings))
        if tree.gaussian:
            self.y, self.log_slope = tree.gaussian.readings(readings)
        self.refined = np.zeros(len(readings), dtype=int)
        #: The highest density of a cell that was left out, blurred, and of those that were not.
        self.left_out, self.highest = np.full((2, len(readings)), -np.inf)

    def missed(self, drop: float) -> Array:
        """By how many nats what was left out may be less than `drop` below the highest, (n,).

        Wide cells have densities of readings that are improbable everywhere which their halves
        have not: beside those the right ones were given up.
        """
        both = np.isfinite(self.highest) & np.isfinite(self.left_out)
        gap = np.zeros(len(both))
        gap[both] = self.left_out[both] - self.highest[both] + drop
        return np.maximum(gap, 0.0)

    def first(self) -> Pairs:
        """All readings beside all coarse cells of what is given."""
        begins, counts = self.tree.begins[self.which], self.tree.counts[self.which]
        reading = np.repeat(np.arange(len(counts)), counts)
        cell = np.arange(len(reading)) + np.repeat(begins - np.cumsum(counts) + counts, counts)
        return Pairs(self.tree.start, reading, cell, False)

    def run(self, least: Array, room: float, out: CellSums, subset: Index) -> Index:
        """From the coarse cells on, but for readings whose density is nowhere above `least`.

        Sums go to readings `subset` (n,) of `out`. Returns the readings that remain to do once the
        tree has outgrown `room` bytes, but finishes a single one.
        """
        least = least - self.log_slope
        todo = [self.first()]
        while todo:
            if self.tree.bytes > room and len(least) > 1:
                return np.unique(np.concatenate([pairs.reading for pairs in todo]))
            pairs = todo.pop()
            middle = np.searchsorted(pairs.reading, pairs.reading[len(pairs.reading) // 2])
            if len(pairs.reading) > PAIRS and middle:
                todo += [pairs.of(slice(middle, None)), pairs.of(slice(middle))]
                continue
            log = self.log(pairs, blurred=not pairs.is_last)
            first, reading = pairs.first, pairs.reading
            top = np.repeat(np.maximum.reduceat(log, first), np.diff(first, append=len(reading)))
            with np.errstate(invalid="ignore"):
                depth = log - top
                if not pairs.is_last:
                    depth = depth + pairs.level.cells.rise[pairs.cell]
            kept = top >= least[reading]
            kept &= depth > -(self.drop if pairs.is_last else self.drop + self.tree.slack)[reading]
            if pairs.is_last:
                self.highest[reading[first]] = np.maximum.reduceat(log, first)
            else:
                dropped = np.where(kept, -np.inf, log)
                most = self.left_out[reading[first]]
                most = np.maximum(most, np.maximum.reduceat(dropped, first))
                self.left_out[reading[first]] = most
            if kept.any():
                log, depth = log[kept], (log - top)[kept]
                pairs = pairs.of(kept)
                if pairs.is_last:
                    halving = self._sum(pairs, log, out, subset)
                else:
                    halving = self._too_long(pairs, depth)
                todo += self._halved(pairs, halving)
        return np.zeros(0, dtype=int)

    def log(self, pairs: Pairs, *, blurred: bool) -> Array:
        """ln of the posterior density of pairs, exact or as blurred as their cells are wide."""
        if self.covariance is not None:
            return self._log_measured(pairs, blurred)
        tree, cells, reading, cell = self.tree, pairs.level.cells, pairs.reading, pairs.cell
        out = (cells.blurred_log_scale if blurred else cells.log_scale)[cell]
        if tree.gaussian:
            precision = cells.blurred_precision if blurred else cells.precision
            z = []
            for k in range(tree.size):
                value = tree.gaussian.off(self.y[k][reading], cells.mean[k][cell], k)
                value *= precision[k][cell]
                z.append(value)
            out = out + tree.gaussian.log(z, blurred)
        if tree.others:
            length = cells.other_length[cell] if blurred else None
            signals = cells.signals[:, cell].T
            for term in tree.others:
                out = out + term.log(self.readings[reading], signals, length, pairs.first)
        return out

    def _log_measured(self, pairs: Pairs, blurred: bool) -> Array:
        """The same with each reading's own covariance of measurement errors."""
        tree, cells, cell = self.tree, pairs.level.cells, pairs.cell
        assert tree.gaussian
        blur = np.zeros((tree.size, 1))
        if blurred:
            wide, plain = cells.blurred_precision[:, cell], cells.precision[:, cell]
            with np.errstate(invalid="ignore", divide="ignore"):  # where an sd is infinite
                blur = np.fmax(wide**-2 - plain**-2, 0.0)
        root = self._root(pairs, blur)
        out = cells.log_prior[cell] - 0.5 * tree.size * np.log(2 * np.pi)
        off = [
            tree.gaussian.off(self.y[i][pairs.reading], cells.mean[i][cell], i)
            for i in range(tree.size)
        ]
        for line, z in zip(root, _solved(root, off), strict=True):
            out = out - 0.5 * z**2 - np.log(line[-1])
        return np.asarray(out)

    def _root(self, pairs: Pairs, blur: Array) -> list[list[Array]]:
        """Cholesky's root of the covariance of pairs, with more variance on its diagonal."""
        tree = self.tree
        assert tree.gaussian
        assert self.covariance is not None
        sd = 1 / pairs.level.cells.precision[:, pairs.cell]
        errors, correlation = self.covariance[pairs.reading], tree.gaussian.correlation
        root: list[list[Array]] = []
        for i in range(tree.size):
            line: list[Array] = []
            for j in range(i + 1):
                entry = errors[:, i, j] + correlation[i, j] * sd[i] * sd[j]
                for k in range(j):
                    entry = entry - line[k] * (root[j][k] if j < i else line[k])
                line.append(entry / root[j][j] if j < i else np.sqrt(entry + blur[i]))
            root.append(line)
        return root

    def _lengths(self, pairs: Pairs) -> Array:
        """Lengths of cells along each axis (U, P), in sds of the readings."""
        tree, level, cell = self.tree, pairs.level, pairs.cell
        if self.covariance is None:
            return level.cells.length[:, cell]
        root = self._root(pairs, np.zeros(tree.size))
        change = level.cells.change[:, cell].reshape(tree.unknowns, tree.features, -1)
        square = np.stack(
            [np.square(_solved(root, list(c[: tree.size]))).sum(axis=0) for c in change]
        )
        square += (change[:, tree.size : -1] ** 2).sum(axis=1)
        return np.sqrt(square + ((2.5 * level.step) ** 2)[:, None])

    def _too_long(self, pairs: Pairs, depth: Array) -> Halving:
        """Along which axes the cells of each reading are too long for the trapezoidal rule."""
        first, counts = pairs.first, pairs.counts
        # The trapezoidal rule is off by exp(−2π²/L²) of the mass in cells L sds long.
        mass = np.exp(depth)
        mass /= np.repeat(np.add.reduceat(mass, first), counts)
        square = 2 * np.pi**2 / self._lengths(pairs) ** 2
        off = np.add.reduceat(mass * np.exp(-square), first, axis=1)
        once_halved = np.add.reduceat(mass * np.exp(-4 * square), first, axis=1)
        wide = off > self.tree.share
        stuck = (counts * 2.0 ** wide.sum(axis=0) > MOST) | (pairs.level.depth >= DEEPEST)
        # As often as it could be.
        self.refined[pairs.reading[first[stuck & wide.any(axis=0)]]] = DEEPEST
        is_last = (once_halved <= self.tree.share).all(axis=0) | stuck
        return Halving(wide & ~stuck, np.ones(len(first), dtype=bool), np.asarray(is_last))

    def _sum(self, pairs: Pairs, log: Array, out: CellSums, subset: Index) -> Halving:
        """Sum over lattices; those whose halves disagree are halved along that axis."""
        first, counts, cells = pairs.first, pairs.counts, pairs.level.cells
        reading = pairs.reading[first]
        at = subset[reading]
        step = np.repeat(pairs.level.step[:, None], len(at), axis=1)
        lattices = Lattices(step, at, first, cells.place[:, pairs.cell], log)
        contact, slope = cells.contact[:, pairs.cell], self.log_slope[reading]
        each = out.add(lattices, contact, slope, self.tree.smooth)
        wide = (each > 0.5 * each.max(axis=0)) & (out.error[at] > self.tree.tolerance)
        # Finer cells find no more of what lies beyond the coarse ones.
        ends = self.tree.inner_ends / pairs.level.step
        out.error[at] = np.maximum(out.error[at], _share_at_ends(lattices, ends))
        self.refined[reading] += wide.any(axis=0)
        again = wide.any(axis=0) & (self.refined[reading] <= self.tree.refinements)
        again &= counts * 2.0 ** wide.sum(axis=0) <= MOST
        return Halving(wide, again, np.ones(len(reading), dtype=bool))

    def _halved(self, pairs: Pairs, halving: Halving) -> list[Pairs]:
        """The cells of readings that go on, those of one pattern of halved axes together."""
        counts, out = pairs.counts, []
        kinds = np.vstack([halving.axes, halving.is_last])
        for kind in np.unique(kinds[:, halving.goes_on], axis=1).T:
            chosen = halving.goes_on & (kinds == kind[:, None]).all(axis=0)
            mine = pairs.of(np.repeat(chosen, counts))
            pattern = tuple(int(w) for w in kind[:-1])
            level, cell = mine.level, mine.cell
            if any(pattern):
                level, halves = self.tree.split(level, pattern, cell)
                cell = (halves[:, None] + np.arange(2 ** sum(pattern))).ravel()
            reading = np.repeat(mine.reading, 2 ** sum(pattern))
            out.append(Pairs(level, reading, cell, bool(kind[-1])))
        return out


def _solved(root: list[list[Array]], values: list[Array]) -> list[Array]:
    """Values (S, P) in sds and without correlation, by Cholesky's root of their covariance."""
    z: list[Array] = []
    for line, value in zip(root, values, strict=True):
        for entry, before in zip(line, z, strict=False):
            value = value - entry * before
        z.append(value / line[-1])
    return z


def _share_at_ends(lattices: Lattices, ends: Array) -> Array:
    """The share of each mass (n,) that is below or beyond `ends` (2, U) of the axes, in steps."""
    place, (low, high) = lattices.place, ends
    if (place.min(axis=1) >= low).all() and (place.max(axis=1) < high).all():
        return np.zeros(len(lattices.readings))
    first = lattices.first
    weight = np.exp(lattices.log - np.maximum.reduceat(lattices.log, first)[lattices.owner])
    at_end = ((place < low[:, None]) | (place >= high[:, None])).any(axis=0)
    share = np.add.reduceat(weight * at_end, first)
    return np.asarray(share / np.add.reduceat(weight, first))
