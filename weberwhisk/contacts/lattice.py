"""Posteriors of many measured contacts: sums over lattices in the observer's own coordinates.

Rows of a table of contacts may each have a measurement error, and those of one touch share distance
and stiffness while the deflection angle moves. So what is wanted is the evidence of each row over
both, the angle summed out; and intervals of every row at the cost of its mean.

A row's cells start from all contacts at a coarse spacing; cells that could explain the reading,
were it as uncertain as the signals vary across a cell, are split along the coordinates in which
signals change by more than 1.9 sd. The coordinates have no edges, so that sums over a lattice (the
trapezoidal rule) converge as they do for a Gaussian. A stiffness that scales signals is integrated
at each cell by Gauss and Hermite's rule.

Cells are the same for all rows: each is found once, when a row first asks for it, and pairs of a
row and a cell are weighed many rows at a time. Arrays of pairs have one signal after the other in
memory.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from .._values import Array, Flags, Index
from ..cues import UnknownStiffness
from ..inference.observer import Observer
from ..mechanics.contact import Outcome


class Readings(NamedTuple):
    """Readings (n, S), and the covariances (n, S, S) of their measurement errors where known.

    By `to_white`, in units in which these are independent and 1, where there is no other noise.
    """

    value: Array
    covariance: Array | None = None
    to_white: Array | None = None

    def take(self, rows: Any) -> Readings:
        """Some of them."""
        value, *errors = (None if part is None else part.T[..., rows].T for part in self)
        return Readings(np.asarray(value), *errors)


class LatticeCells(NamedTuple):
    """Cells from which some rows may come, of one spacing: (P,) in all, row after row.

    Rows (n,), where the cells of each begin, steps (U,) in x, whether each row's are as fine as
    they should be; of each cell its row's number among the n, its place along the distance, its
    contact (P, U), signals (P, S), ln of the prior density in x, and of the row's density.
    """

    rows: Index
    first: Index
    step: Array
    precise: Flags
    owner: Index
    layer: Index
    contact: Array
    signals: Array
    log_prior: Array
    log: Array


@dataclass(eq=False)
class _Level:
    """Cells of one spacing, found so far, a column each: place, contact, signals, prior, change.

    By `children`, the first of the cells into which each is split along some axes.
    """

    step: Array
    data: Array
    count: int
    depth: int = 0
    children: dict[tuple[bool, ...], tuple[_Level, Index]] = field(default_factory=dict)

    def add(self, columns: Array) -> int:
        """Keep more cells; the number of the first."""
        first, self.count = self.count, self.count + columns.shape[1]
        if self.count > self.data.shape[1]:
            more = np.empty((len(self.data), 2 * self.count))
            more[:, :first] = self.data[:, :first]
            self.data = more
        self.data[:, first : self.count] = columns
        return first


def refuse_sharp(observer: Observer, *, least: float = 0.15) -> None:
    """Refuse priors of distance and angle that cells, as wide as signals let them be, do not see.

    Cells go by the prior's width in x, by default about 1. At 0.16 (2 mm at half of 50 mm) normal
    priors are right to 3e-4 sd, at 0.08 to 9e-3, at 0.04 sds were a third of what they are.
    """
    own = [  # uniform ones end where the cells do
        i
        for i, name in enumerate(observer.unknowns[: observer.bounded])
        if name in observer.prior and observer.prior[name].dist.name != "uniform"
    ]
    if not own:
        return
    ends = observer.space.spread(np.array([1e-3, 0.5, 1 - 1e-3]))[:, : observer.bounded]
    axes = np.linspace(ends.min(axis=0), ends.max(axis=0), 101).T
    x = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    score = observer.space.prior_scores(observer.contact(x)[0])
    for i in own:
        name = observer.unknowns[i]
        z = score[..., i]
        slope = np.abs(np.gradient(z, axes[i], axis=i))
        steepest = float(np.max(slope, where=np.abs(z) < 2, initial=0.0))
        unseen = not (np.abs(z) < 2).any()
        if unseen or steepest > 1 / least or np.size(observer.space.leaps[name]):
            raise ValueError(
                f"The prior of {name} is sharp or leaps, which locate does not resolve; give a "
                "wider or a uniform one, a measured angle as the column deflection_angle, or take "
                "posterior(Observer(whisker, cue, noise, prior), readings), which takes any."
            )


class Lattice:
    """The lattices of an observer, whose cue may be an `UnknownStiffness`.

    Without receptors readings have their measurement errors alone; cells for touches resolve
    distance and angle at each stiffness.
    """

    def __init__(
        self, observer: Observer, *, with_receptors: bool = True, for_touches: bool = False
    ) -> None:
        self.for_touches = for_touches
        self.whole, self.with_receptors = observer, with_receptors
        self.soft: Flags | None = None
        if isinstance(observer.cue, UnknownStiffness):
            self.soft = np.isin(observer.cue.signal_names, observer.cue.soft_signals)
            self.stiffness = observer.prior["stiffness"]
            low, middle, high = np.log(self.stiffness.ppf([0.159, 0.5, 0.841]))
            self.log_median, self.log_sd = float(middle), float(high - low) / 2
            prior = {name: p for name, p in observer.prior.items() if name != "stiffness"}
            kept = observer._filled._replace(noise=None)  # floors stay those of the whole
            observer = replace(observer, cue=observer.cue.cue, prior=prior, _filled=kept)
        self.observer = observer
        self.unknowns, self.size = len(observer.unknowns), len(observer.cue.signal_names)
        # The tails of strong Weber noise are wide: with k = 0.3 errors were 0.04 sd by plain nodes.
        strong = max(observer.noise.weber_fractions(self.size)) > 0.15
        nodes, weights = np.polynomial.hermite_e.hermegauss(11 if strong else 7)
        wider = 1.4 if strong else 1.15
        self._nodes, self._log_weights = wider * nodes, np.log(wider * weights) + nodes**2 / 2

    # -- likelihood ----------------------------------------------------------------------------

    def log_likelihood(self, readings: Readings, signals: Array) -> Array:
        """ln p (P, ...) of readings (P, S) at signals (P, ..., S)."""
        y = readings.value
        y = y.reshape(len(y), *(1,) * (signals.ndim - 2), self.size)
        if readings.covariance is None:
            return self.observer.noise.log_likelihood(y, signals)
        z, log_sd = self._whitened(readings, signals, y - self.observer.noise.mean(signals))
        out = -0.5 * self.size * np.log(2 * np.pi) - log_sd
        for each in z:
            out = out - 0.5 * each * each
        return out

    def covariance(self, readings: Readings, signals: Array) -> Array:
        """Covariances (P, ..., S, S) of readings (P, S) at signals (P, ..., S)."""
        if readings.covariance is None:  # laws that are no Gaussian's have no correlations
            sd = np.maximum(self.observer.noise.sd(signals), 1e-300)
            return sd[..., None] ** 2 * np.eye(self.size)
        size = self.size
        own = readings.covariance.reshape(-1, *(1,) * (signals.ndim - 2), size, size)
        return own + self.observer.noise.covariance(signals) if self.with_receptors else own

    def _whitened(self, readings: Readings, signals: Array, *values: Array) -> tuple[Any, Array]:
        """Values (P, ..., S) in units in which errors are independent and 1; ln √|covariance|.

        A list of the S (P, ...) for each. By Cholesky's root, an element after the other.
        """
        size = self.size
        if readings.to_white is not None:
            white = readings.to_white.reshape(-1, *(1,) * (signals.ndim - 2), size, size)
            white_values: Any = [
                [sum(white[..., i, j] * value[..., j] for j in range(i + 1)) for i in range(size)]
                for value in values
            ]
            return (white_values if len(values) > 1 else white_values[0]), np.zeros(())
        c = self.covariance(readings, signals)
        out: list[list[Array]] = [[] for _ in values]
        root: list[list[Array]] = []
        log_sd: Any = 0.0
        for i in range(size):
            row: list[Array] = []
            for j in range(i + 1):
                part = c[..., i, j]
                for k in range(j):
                    part = part - row[k] * (root[j][k] if j < i else row[k])
                row.append(np.sqrt(part) if i == j else part / root[j][j])
            root.append(row)
            log_sd = log_sd + np.log(row[i])
            for done, value in zip(out, values, strict=True):
                left = value[..., i]
                for j in range(i):
                    left = left - row[j] * done[j]
                done.append(left / row[i])
        return (out if len(values) > 1 else out[0]), log_sd

    def match(self, readings: Readings, signals: Array) -> tuple[Array, Array]:
        """ln of the stiffness (P, …) that brings signals (P, …, S) nearest to readings; its sd."""
        assert self.soft is not None
        variance = np.diagonal(self.covariance(readings, readings.value), axis1=-2, axis2=-1)
        total: Any = self.log_sd**-2
        pull: Any = self.log_median * total
        for i in np.flatnonzero(self.soft):
            s = signals[..., i]
            own = (-1, *(1,) * (s.ndim - 1))
            y, known = readings.value[:, i].reshape(own), variance[:, i].reshape(own)
            with np.errstate(divide="ignore", invalid="ignore"):
                ratio = y / s
                usable = (ratio > 0) & np.isfinite(ratio)
                weight = np.where(usable, y**2 / known, 0.0)
                pull = pull + weight * np.log(np.where(usable, ratio, 1.0))
            total = total + weight
        return pull / total, total**-0.5

    def scaled(self, signals: Array, log_stiffness: Array) -> Array:
        """Signals (..., S) at another stiffness (...)."""
        assert self.soft is not None
        scale = np.exp(log_stiffness)[..., None]
        return signals * (scale if self.soft.all() else np.where(self.soft, scale, 1.0))

    def evidence(self, readings: Readings, row: Index, signals: Array) -> Array:
        """ln p (P,) of the readings of rows (P,) at signals (P, S), the stiffness integrated."""
        if self.soft is None:
            return self.log_likelihood(readings.take(row), signals)
        out = np.empty(len(row))
        for some in (slice(i, i + 4096) for i in range(0, len(out), 4096)):  # the cache's size
            own = readings.take(row[some])
            middle, sd = self.match(own, signals[some])
            log_e = middle + sd * self._nodes[:, None]
            log = self.log_likelihood(own, self.scaled(signals[some, None], log_e.T)).T
            log = log + self.log_prior_of_stiffness(log_e) + self._log_weights[:, None]
            top = np.maximum(log.max(axis=0), -1e300)
            out[some] = top + np.log(np.exp(log - top).sum(axis=0)) + np.log(sd)
        return out

    def log_prior_of_stiffness(self, log_stiffness: Array) -> Array:
        """Its prior density in the logarithm."""
        if self.stiffness.dist.name == "lognorm":  # SciPy's own takes ten times as long
            z = (log_stiffness - self.log_median) / self.log_sd
            return -0.5 * z * z - np.log(self.log_sd * np.sqrt(2 * np.pi))
        return self.stiffness.logpdf(np.exp(log_stiffness)) + log_stiffness

    # -- cells ---------------------------------------------------------------------------------

    @cached_property
    def _start(self) -> _Level:
        """The coarse lattice over all contacts."""
        ends = self.observer.space.spread(np.array([1e-7, 1e-3, 0.5, 1 - 1e-3, 1 - 1e-7]))
        step = np.full(self.unknowns, 0.5)
        axes = [
            np.arange(np.floor(a / h), np.ceil(b / h) + 1)
            for a, b, h in zip(ends.min(axis=0), ends.max(axis=0), step, strict=True)
        ]
        place = np.stack([a.ravel() for a in np.meshgrid(*axes, indexing="ij")], axis=-1)
        contact, signals, log_prior = self._at((place + 0.5) * step)
        change = np.zeros((self.unknowns, self.size, len(place)))
        for d in range(self.unknowns):
            _, moved, still = self._at((place + 0.5 + 1e-3 * np.eye(self.unknowns)[d]) * step)
            both = np.isfinite(still) & np.isfinite(log_prior)
            change[d] = np.where(both[:, None], (moved - signals) / 1e-3, 0.0).T
        data = _columns(place, contact, signals, log_prior, change)[:, np.isfinite(log_prior)]
        return _Level(step, data, data.shape[1])

    def _at(self, x: Array) -> tuple[Array, Array, Array]:
        """Contacts, signals (0 where not held) and ln of the prior in x, −inf where not held."""
        contact, log_prior = self.observer.contact(x)
        signals, outcome = self.observer.signals(contact)
        held = (outcome == Outcome.HELD) & np.isfinite(log_prior)
        return contact, np.where(held[:, None], signals, 0.0), np.where(held, log_prior, -np.inf)

    def _children(
        self, level: _Level, wide: tuple[bool, ...], cells: Index
    ) -> tuple[_Level, Index]:
        """Cells (P,) of a level split along the wide axes: their level, and the first of each's."""
        unknowns, size, shape = self.unknowns, self.size, tuple(1 + w for w in wide)
        parts = int(np.prod(shape))
        child, first = level.children.get(wide) or (
            _Level(level.step / shape, np.empty((len(level.data), 0)), 0, level.depth + 1),
            np.zeros(0, dtype=np.intp),
        )
        first = np.append(first, np.full(level.count - len(first), -1))
        new = np.unique(cells[first[cells] < 0])
        if new.size:
            halves = np.indices(shape).reshape(unknowns, -1)
            place = level.data[:unknowns, new, None] * np.array(shape)[:, None, None]
            place = (place + halves[:, None]).reshape(unknowns, -1).T
            contact, signals, log_prior = self._at((place + 0.5) * child.step)
            # From a half to the other; where one is not held, half of what it was.
            before = level.data[-unknowns * size :, new].reshape(unknowns, size, -1)
            change = np.repeat(before / np.array(shape)[:, None, None], parts, axis=2)
            grid, held = (v.reshape(*v.shape[:-1], -1, *shape)
                          for v in (signals.T, np.isfinite(log_prior)))  # fmt: skip
            for d in np.flatnonzero(wide):
                axis = d - unknowns
                rise = np.diff(grid, axis=axis)
                both = np.broadcast_to(held.all(axis=axis, keepdims=True), held.shape)
                rise = np.broadcast_to(rise, grid.shape).reshape(size, -1)
                change[d] = np.where(both.reshape(-1), rise, change[d])
            columns = _columns(place, contact, signals, log_prior, change)
            first[new] = child.add(columns) + parts * np.arange(len(new))
        level.children[wide] = child, first
        return child, first[cells]

    def search(
        self, readings: Readings, drop: Array, within: tuple[float, float] | None = None,
        most: int = 60_000, widest: float = 1.9,
    ) -> Iterator[LatticeCells]:  # fmt: skip
        """For each of n readings, the cells from which it may come, rows of one spacing together.

        Left out are those whose ln of the density is `drop` (n,) below the best, and distances that
        are not `within` coordinates. `widest` is by how many sds signals may change from a cell to
        the next where the density is highest.
        """
        if sum(level.count for level in self._levels()) > 1_500_000:  # what memory holds
            self._start.children.clear()
        start, n = self._start, len(readings.value)
        if readings.covariance is not None and not self.with_receptors:
            root = np.linalg.cholesky(readings.covariance)
            readings = readings._replace(to_white=np.linalg.inv(root))
        todo = [(start, np.repeat(np.arange(n), start.count), np.tile(np.arange(start.count), n),
                 np.zeros(n, dtype=bool))]  # fmt: skip
        while todo:
            level, row, cell, last = todo.pop()
            if within is not None and level is not start:
                x = (level.data[0, cell] + 0.5) * level.step[0]
                room = 3 * level.step[0]  # for splines
                near = (x > within[0] - room) & (x < within[1] + room)
                row, cell = row[near], cell[near]
                if not row.size:
                    continue
            if last.any():
                yield self._found(readings, level, row, cell, drop, last)
                continue
            first = np.flatnonzero(np.diff(row, prepend=-1))
            rows = row[first]
            counts = np.diff(first, append=len(row))
            depth, lengths = self._tempered(readings, level, row, cell, first, counts)
            kept = depth > -1.2 * drop[row]
            wide = lengths > widest
            many = np.add.reduceat(kept, first) * 2 ** wide.sum(axis=0)
            stop = ~wide.any(axis=0) | (many > most) | (level.depth >= 14)
            if stop.any():
                some = kept & np.repeat(stop, counts)
                precise = np.zeros(n, dtype=bool)
                precise[rows] = ~wide.any(axis=0)
                yield self._found(readings, level, row[some], cell[some], drop, precise)
            # Half the step changes signals half as much: where that will do, it is the last.
            done = (np.where(wide, lengths / 2, lengths) <= widest).all(axis=0)
            kinds = np.vstack([wide, done])
            for kind in np.unique(kinds[:, ~stop], axis=1).T:
                own = ~stop & (kinds == kind[:, None]).all(axis=0)
                some = kept & np.repeat(own, counts)
                pattern = tuple(bool(w) for w in kind[:-1])
                child, split = self._children(level, pattern, cell[some])
                parts = 2 ** sum(pattern)
                last = np.zeros(n, dtype=bool)
                last[rows[own]] = kind[-1]
                todo.append((child, np.repeat(row[some], parts),
                             (split[:, None] + np.arange(parts)).ravel(), last))  # fmt: skip

    def _levels(self) -> Iterator[_Level]:
        left = [self._start]
        while left:
            yield left[-1]
            left += [child for child, _ in left.pop().children.values()]

    def _found(
        self, readings: Readings, level: _Level, row: Index, cell: Index, drop: Array,
        precise: Flags,
    ) -> LatticeCells:  # fmt: skip
        """Cells (P,) of rows (P,) with their densities, but those that are `drop` below."""
        u, s = self.unknowns, self.size
        data = level.data[: 2 * u + s + 1, cell]
        if self.soft is not None:  # what is far off at its nearest stiffness is so at every other
            own, signals = readings.take(row), data[2 * u : -1].T
            log_e, sd = self.match(own, signals)
            log = self.log_likelihood(own, self.scaled(signals, log_e)) + np.log(sd)
            log += data[-1] + self.log_prior_of_stiffness(log_e)
            keep = log > self._below(log, row) - drop[row] - 3.0
            row, data, log = row[keep], data[:, keep], log[keep]
        if self.soft is None or not self.for_touches:  # those sum over the stiffness by themselves
            log = self.evidence(readings, row, data[2 * u : -1].T) + data[-1]
        keep = log > self._below(log, row) - drop[row]
        row, data, log = row[keep], data[:, keep], log[keep]
        first = np.flatnonzero(np.diff(row, prepend=-1))
        rows = row[first]
        owner = np.repeat(np.arange(len(rows)), np.diff(first, append=len(row)))
        return LatticeCells(
            rows, first, level.step, precise[rows], owner, data[0].astype(np.intp),
            data[u : 2 * u].T, data[2 * u : -1].T, data[-1], log,
        )  # fmt: skip

    def _below(self, log: Array, row: Index) -> Array:
        """The best of each pair's row."""
        first = np.flatnonzero(np.diff(row, prepend=-1))
        counts = np.diff(first, append=len(row))
        return np.repeat(np.maximum.reduceat(log, first), counts)

    def _tempered(
        self, readings: Readings, level: _Level, row: Index, cell: Index, first: Index,
        counts: Index,
    ) -> tuple[Array, Array]:  # fmt: skip
        """ln of the density of cells (P,), as blurred as they are wide, below each row's best; and
        their lengths (U, n) in sd.

        The lengths are the largest near the top, across the direction in which stiffness moves
        signals: along it there is nothing to resolve but the prior, whose width is 1, about.
        """
        u, s = self.unknowns, self.size
        every = level is self._start  # each row's cells are all of them: arrays (n, N)
        data = level.data[2 * u :, None] if every else level.data[2 * u :, cell]
        own = readings if every else readings.take(row)
        parts = np.moveaxis(data, 0, -1)
        signals, log = parts[..., :s], parts[..., s]
        change = [parts[..., s + 1 + d * s : s + 1 + (d + 1) * s] for d in range(u)]
        if self.soft is not None:
            log_e = self.match(own, signals)[0]
            signals = self.scaled(signals, log_e)
            change = [self.scaled(each, log_e) for each in change]
        y = own.value.reshape(len(own.value), *(1,) * (signals.ndim - 2), s)
        off = y - self.observer.noise.mean(signals)
        (off, along, *steps), log_sd = self._whitened(own, signals, off, signals, *change)
        # Across half a cell each way, and more for curvature, which large cells have most of: with
        # 0.36 there, a part of one posterior in 76 at k = 0.3 was left out, 0.07 sd.
        blur = 1.0 if level.depth < 2 else 0.36
        product: Any = 1.0
        for i in range(s):
            spread = 1 + blur * sum(np.abs(step[i]) for step in steps) ** 2
            log = log - 0.5 * off[i] ** 2 / spread
            product = product * spread
        log = log - 0.5 * np.log(product) - log_sd
        if self.soft is not None:  # by how much the nearest stiffness changes, too
            along = [v * soft for v, soft in zip(along, self.soft, strict=True)]
            size = sum(v**2 for v in along) + self.log_sd**-2
            turns = [sum(a * b for a, b in zip(step, along, strict=True)) / size for step in steps]
            spread = self.log_sd**2 + blur * sum(np.abs(turn) for turn in turns) ** 2
            log = log - 0.5 * (log_e - self.log_median) ** 2 / spread
        log = log.reshape(-1)
        depth = log - np.repeat(np.maximum.reduceat(log, first), counts)
        near = np.flatnonzero(depth > -2.0)
        at = np.unravel_index(near, off[0].shape)
        lengths = np.zeros((u, len(row)))
        for d, step in enumerate(steps):
            square = sum(np.broadcast_to(v, off[0].shape)[at] ** 2 for v in step)
            if self.soft is not None and not self.for_touches:
                square = square - turns[d][at] ** 2 * size[at]
            lengths[d, near] = np.sqrt(np.maximum(square, 0.0))
        longest = np.maximum.reduceat(lengths, first, axis=1)
        return depth, longest + 5.0 * level.step[:, None]


def _columns(*parts: Array) -> Array:
    """Place, contact, signals, ln of the prior (N, …) and change (U, S, N), a row each."""
    *values, change = parts
    return np.concatenate([*(v.T.reshape(-1, len(v)) for v in values),
                           change.reshape(-1, change.shape[-1])])  # fmt: skip
