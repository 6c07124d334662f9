"""Readings on their way through a tree, from coarse cells to the lattices that are summed."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from .._util.values import Array, Flags, Index
from .weighted import Leaves

__all__ = ["PAIRS", "Descent", "Pairs"]

if TYPE_CHECKING:
    from .tree import Level, Tree

#: Pairs of a reading and a cell that are weighed together: 150 000 fit the cache.
PAIRS = 150_000
#: Most cells of one reading, and most times its cells are halved.
MOST, DEEPEST = 300_000, 22


class Pairs(NamedTuple):
    """Pairs of readings and cells of one level, sorted by reading; whether it is their last."""

    level: Level
    row: Index
    cell: Index
    last: bool


class Descent:
    """One chunk of readings on their way from the coarse cells to their lattices."""

    def __init__(
        self, tree: Tree, readings: Array, covariance: Array | None, which: Index, rows: Index,
        drop: Array, out: Any,
    ) -> None:  # fmt: skip
        self.tree, self.rows_out, self.drop, self.out = tree, rows, drop, out
        self.readings, self.covariance, self.which = readings, covariance, which
        self.log_slope = np.zeros(len(rows))
        if tree.gaussian:
            self.y, self.log_slope = tree.gaussian.readings(readings)
        self.refined = np.zeros(len(rows), dtype=int)
        #: The highest density of a cell that was left out, blurred, and of those that were not.
        self.left_out, self.highest = np.full((2, len(rows)), -np.inf)

    def missed(self, drop: float) -> Array:
        """By how many nats what was left out may be less than `drop` below the highest, (n,).

        Wide cells have densities of readings that are improbable everywhere which their halves
        have not: beside those the right ones were given up.
        """
        known = np.isfinite(self.highest) & np.isfinite(self.left_out)
        gap = np.zeros(len(known))
        gap[known] = self.left_out[known] - self.highest[known] + drop
        return np.maximum(gap, 0.0)

    def first(self) -> Pairs:
        """All readings beside all coarse cells of what is given."""
        begins, counts = self.tree.begins[self.which], self.tree.counts[self.which]
        row = np.repeat(np.arange(len(counts)), counts)
        cell = np.arange(len(row)) + np.repeat(begins - np.cumsum(counts) + counts, counts)
        return Pairs(self.tree.start, row, cell, False)

    def run(self, least: Array, room: float) -> Index:
        """From the coarse cells on, but for readings whose density is nowhere above `least`.

        Returns the readings that are left to do once the tree has outgrown `room` bytes, but
        finishes a single one.
        """
        least = least - self.log_slope
        todo = [self.first()]
        while todo:
            if self.tree.bytes > room and len(least) > 1:
                return np.unique(np.concatenate([task.row for task in todo]))
            task = todo.pop()
            middle = np.searchsorted(task.row, task.row[len(task.row) // 2])
            if len(task.row) > PAIRS and middle:
                halves = slice(middle, None), slice(middle)
                todo += [task._replace(row=task.row[h], cell=task.cell[h]) for h in halves]
                continue
            log = self.log(task.level, task.row, task.cell, blurred=not task.last)
            first = np.flatnonzero(np.diff(task.row, prepend=-1))
            top = np.repeat(np.maximum.reduceat(log, first), np.diff(first, append=len(task.row)))
            with np.errstate(invalid="ignore"):
                depth = log - top
                if not task.last:
                    depth = depth + task.level.data[self.tree.rows.rise.start][task.cell]
            kept = top >= least[task.row]
            kept &= depth > -(self.drop if task.last else self.drop + self.tree.slack)[task.row]
            if task.last:
                self.highest[task.row[first]] = np.maximum.reduceat(log, first)
            else:
                out = np.where(kept, -np.inf, log)
                most = self.left_out[task.row[first]]
                self.left_out[task.row[first]] = np.maximum(most, np.maximum.reduceat(out, first))
            if kept.any():
                log, depth = log[kept], (log - top)[kept]
                task = task._replace(row=task.row[kept], cell=task.cell[kept])
                how = self._sum(task, log) if task.last else self._long(task, depth)
                todo += self._halved(task, *how)
        return np.zeros(0, dtype=int)

    def log(self, level: Level, row: Index, cell: Index, *, blurred: bool) -> Array:
        """ln of the posterior density at pairs, exact or as blurred as their cells are wide."""
        tree, rows, data = self.tree, self.tree.rows, level.data
        if self.covariance is not None:
            return self._log_measured(level, row, cell, blurred)
        start = rows.blurred_constant.start if blurred else rows.constant.start
        out = data[start][cell]
        if tree.gaussian:
            precision = rows.blurred_precision.start if blurred else rows.precision.start
            z = []
            for k in range(tree.size):
                value = tree.gaussian.off(self.y[k][row], data[rows.mean.start + k][cell], k)
                value *= data[precision + k][cell]
                z.append(value)
            out = out + tree.gaussian.log(z, blurred)
        if tree.others:
            first = np.flatnonzero(np.diff(row, prepend=-1))
            length = data[rows.other_length.start][cell] if blurred else None
            signals = data[rows.signals][:, cell].T
            for term in tree.others:
                out = out + term.log(self.readings[row], signals, length, first)
        return out

    def _log_measured(self, level: Level, row: Index, cell: Index, blurred: bool) -> Array:
        """The same with each reading's own covariance of measurement errors."""
        tree, rows, data = self.tree, self.tree.rows, level.data
        assert tree.gaussian
        blur = np.zeros((tree.size, 1))
        if blurred:
            wide, plain = (data[r][:, cell] for r in (rows.blurred_precision, rows.precision))
            with np.errstate(invalid="ignore", divide="ignore"):  # where an sd is infinite
                blur = np.fmax(wide**-2 - plain**-2, 0.0)
        root = self._root(level, row, cell, blur)
        out = data[rows.log_prior.start][cell] - 0.5 * tree.size * np.log(2 * np.pi)
        off = [
            tree.gaussian.off(self.y[i][row], data[rows.mean.start + i][cell], i)
            for i in range(tree.size)
        ]
        for line, z in zip(root, _solved(root, off), strict=True):
            out = out - 0.5 * z**2 - np.log(line[-1])
        return np.asarray(out)

    def _root(self, level: Level, row: Index, cell: Index, blur: Array) -> list[list[Array]]:
        """Cholesky's root of the covariance of pairs, with more variance on its diagonal."""
        tree, data = self.tree, level.data
        assert tree.gaussian
        assert self.covariance is not None
        sd = 1 / data[tree.rows.precision][:, cell]
        own, correlation = self.covariance[row], tree.gaussian.correlation
        root: list[list[Array]] = []
        for i in range(tree.size):
            line: list[Array] = []
            for j in range(i + 1):
                part = own[:, i, j] + correlation[i, j] * sd[i] * sd[j]
                for k in range(j):
                    part = part - line[k] * (root[j][k] if j < i else line[k])
                line.append(part / root[j][j] if j < i else np.sqrt(part + blur[i]))
            root.append(line)
        return root

    def _lengths(self, level: Level, row: Index, cell: Index) -> Array:
        """Lengths of cells along each axis (U, P), in sds of the readings."""
        tree, rows, data = self.tree, self.tree.rows, level.data
        if self.covariance is None:
            return data[rows.length][:, cell]
        root = self._root(level, row, cell, np.zeros(tree.size))
        change = data[rows.change][:, cell].reshape(tree.unknowns, tree.features, -1)
        square = np.stack(
            [np.square(_solved(root, list(c[: tree.size]))).sum(axis=0) for c in change]
        )
        square += (change[:, tree.size : -1] ** 2).sum(axis=1)
        return np.sqrt(square + ((2.5 * level.step) ** 2)[:, None])

    def _long(self, task: Pairs, depth: Array) -> tuple[Flags, Flags, Flags]:
        """Along which axes the cells of each reading are too long, and what `_halved` asks more."""
        level, row, cell, _ = task
        first = np.flatnonzero(np.diff(row, prepend=-1))
        counts, own = np.diff(first, append=len(row)), row[first]
        # The trapezoidal rule is off by exp(−2π²/L²) of the mass in cells L sds long.
        mass = np.exp(depth)
        mass /= np.repeat(np.add.reduceat(mass, first), counts)
        square = 2 * np.pi**2 / self._lengths(level, row, cell) ** 2
        off = np.add.reduceat(mass * np.exp(-square), first, axis=1)
        halved = np.add.reduceat(mass * np.exp(-4 * square), first, axis=1)
        wide = off > self.tree.share
        stuck = (counts * 2.0 ** wide.sum(axis=0) > MOST) | (level.depth >= DEEPEST)
        self.refined[own[stuck & wide.any(axis=0)]] = DEEPEST  # as often as it could be
        last = (halved <= self.tree.share).all(axis=0) | stuck
        return wide & ~stuck, np.ones(len(own), dtype=bool), np.asarray(last)

    def _sum(self, task: Pairs, log: Array) -> tuple[Flags, Flags, Flags]:
        """Sum over lattices; those whose halves disagree are halved along that axis."""
        level, row, cell, _ = task
        first = np.flatnonzero(np.diff(row, prepend=-1))
        counts, own = np.diff(first, append=len(row)), row[first]
        rows, out = self.tree.rows, self.rows_out[own]
        place = level.data[rows.place][:, cell].astype(np.int32)
        contact = level.data[rows.contact][:, cell]
        leaves = Leaves(level.step, out, first, place, log)
        each = self.out.add(leaves, contact, self.log_slope[own], self.tree.smooth)
        wide = (each > 0.5 * each.max(axis=0)) & (self.out.error[out] > self.tree.tolerance)
        # Finer cells find no more of what lies beyond the coarse ones.
        self.out.error[out] = np.maximum(self.out.error[out], self._at_ends(leaves))
        self.refined[own] += wide.any(axis=0)
        again = wide.any(axis=0) & (self.refined[own] <= self.tree.refinements)
        again &= counts * 2.0 ** wide.sum(axis=0) <= MOST
        return wide, again, np.ones(len(own), dtype=bool)

    def _at_ends(self, leaves: Leaves) -> Array:
        """The share of each mass that is in the first or last coarse cells of an axis, (n,)."""
        place, (low, high) = leaves.place, self.tree.inner_ends / leaves.step
        if (place.min(axis=1) >= low).all() and (place.max(axis=1) < high).all():
            return np.zeros(len(leaves.rows))
        weight = np.exp(leaves.log - np.maximum.reduceat(leaves.log, leaves.first)[leaves.owner])
        at_end = ((place < low[:, None]) | (place >= high[:, None])).any(axis=0)
        share = np.add.reduceat(weight * at_end, leaves.first)
        return np.asarray(share / np.add.reduceat(weight, leaves.first))

    def _halved(self, task: Pairs, wide: Flags, again: Flags, last: Flags) -> list[Pairs]:
        """The cells of readings that go on `again` (n,), halved along the `wide` axes (U, n).

        For the last time, or not, (n,).
        """
        level, row, cell, _ = task
        first = np.flatnonzero(np.diff(row, prepend=-1))
        counts = np.diff(first, append=len(row))
        kinds, tasks = np.vstack([wide, last]), []
        for kind in np.unique(kinds[:, again], axis=1).T:
            own = np.repeat(again & (kinds == kind[:, None]).all(axis=0), counts)
            pattern = tuple(int(w) for w in kind[:-1])
            child, cells = level, cell[own]
            if any(pattern):
                child, split = self.tree._split(level, pattern, cells)
                cells = (split[:, None] + np.arange(2 ** sum(pattern))).ravel()
            rows = np.repeat(row[own], 2 ** sum(pattern))
            tasks.append(Pairs(child, rows, cells, bool(kind[-1])))
        return tasks


def _solved(root: list[list[Array]], values: list[Array]) -> list[Array]:
    """Values (S, P) in sds and without correlation, by Cholesky's root of their covariance."""
    z: list[Array] = []
    for line, value in zip(root, values, strict=True):
        for part, before in zip(line, z, strict=False):
            value = value - part * before
        z.append(value / line[-1])
    return z
