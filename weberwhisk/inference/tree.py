"""The tree: cells over an observer's coordinates, from coarse to fine, the same for all readings.

Cells are evaluated once, when a reading first needs them, and kept with the observer. A reading
descends from the coarse cells to fine ones, many readings together. It keeps a cell if it could
come from it, were it as uncertain as the signals vary across the cell, and halves the axes along
which the signals change by more than a step of the trapezoidal rule may. The last cells are an even
lattice for that reading, and its integrals are plain sums over them: in coordinates without edges
the trapezoidal rule converges as fast as it does for a Gaussian, with an error of
exp(−2π²/h²) at steps of h sds (Trefethen & Weideman 2014, SIAM Review 56, 385).
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import product
from types import SimpleNamespace
from typing import Any

import numpy as np

from .._util.values import Array, Index
from ..receptors import ReceptorNoise
from .conditional import Conditional, Evaluated
from .coordinates import within_half_turn
from .descent import PAIRS, Descent
from .observer import Observer
from .weighted import Sums

#: Error of means and sds, in sds, above which posteriors are `IMPRECISE`.
TOLERANCE = 2e-3
#: Step of the first cells, in the observer's coordinates; a sixteenth of it with one unknown. At
#: 1.0 narrow parts of posteriors of whiskers that rub were not found (19 of 225 readings).
ROOT_STEP = 0.5
#: Cells whose density is so many nats below the highest are left out. At 15, 2 of 225 posteriors
#: of whiskers that rub lost a part; at 20 none, and sums agree to 1e-7.
DROP = 20.0
#: Bytes of cells that are kept for all observers together, a quarter more while readings need them;
#: half as much again for a posterior's readings. Set it before the first posterior. An unknown
#: friction takes 1 GB in all, and is no quicker with twice as much.
MEMORY = 250_000_000


# -- what readings say of cells --------------------------------------------------------------------


class GaussianTerm:
    """Signals whose readings are Gaussian, as they are or in their logarithms."""

    def __init__(self, noise: ReceptorNoise, size: int, circular: Index) -> None:
        self.parts = [c for c in noise.components(size) if c.noise.gaussian_on]
        self.root = np.zeros((0, 0))
        for part in self.parts:  # independent of each other
            own = part.noise.gaussian_root(part.signals.stop - part.signals.start)
            n, m = len(self.root), len(own)
            self.root = np.block([[self.root, np.zeros((n, m))], [np.zeros((m, n)), own]])
        self.size = len(self.root)
        own = np.concatenate([np.arange(size)[part.signals] for part in self.parts])
        #: Which of them are directions, known up to whole turns.
        self.circular = np.flatnonzero(np.isin(own, circular))
        self.constant = np.log(np.diag(self.root)).sum() - 0.5 * self.size * np.log(2 * np.pi)
        inverse = np.linalg.inv(self.root)
        self.correlation = inverse @ inverse.T

    def features(self, signals: Array) -> tuple[Array, Array]:
        """Mean and sd of readings at signals (N, S), (N, size) each."""
        pairs = [part.noise.as_gaussian(signals[:, part.signals]) for part in self.parts]
        mean, sd = (np.concatenate(column, axis=1) for column in zip(*pairs, strict=True))
        return mean, sd

    def readings(self, readings: Array) -> tuple[Array, Array]:
        """Readings (B, R) where they are Gaussian, (size, B), and ln of the slope there (B,)."""
        pairs = [part.noise.to_gaussian(readings[:, part.readings]) for part in self.parts]
        columns, log_slope = zip(*pairs, strict=True)
        return np.concatenate(columns, axis=1).T.copy(), np.asarray(sum(log_slope))

    def off(self, reading: Array, mean: Array, k: int) -> Array:
        """By how much readings of one signal are off its means, (P,)."""
        value = reading - mean
        return within_half_turn(value) if k in self.circular else value

    def log(self, z: list[Array], blurred: bool) -> Array:
        """−½ of the squared distance of readings, given (reading − mean)/sd of each signal."""
        total: Any = 0.0
        for k in range(self.size):
            value = z[k] if blurred else self.root[k, k] * z[k]
            if not blurred:
                for i in range(k + 1, self.size):
                    if self.root[k, i]:
                        value = value + self.root[k, i] * z[i]
            total = total + value * value
        return np.asarray(-0.5 * total)


class OtherTerm:
    """Signals with any other noise: spike counts, reports of events."""

    def __init__(self, noise: ReceptorNoise, signals: slice, readings: slice) -> None:
        self.noise, self.signals, self.columns = noise, signals, readings

    def features(self, signals: Array) -> tuple[Array, Array]:
        """A smooth function of the signals, (N, T), and what it changes by for one JND."""
        return self.noise.resolution(signals[:, self.signals])

    def log(self, readings: Array, signals: Array, length: Array | None, first: Index) -> Array:
        """ln of the likelihood of pairs of a reading (P, R) and signals (P, S).

        In cells as long as `length` JNDs (P,), what is far below a reading's best could be less
        far: that is divided by 1 + length², as the exponent of a Gaussian blurred by as much is.
        Any of few reports may come from a cell whose middle excludes it.
        """
        if length is not None and self.noise.is_categorical:
            return np.zeros(len(signals))
        log = self.noise.log_likelihood(readings[:, self.columns], signals[:, self.signals])
        if length is None:
            return np.asarray(log)
        best = np.repeat(np.maximum.reduceat(log, first), np.diff(first, append=len(log)))
        return np.asarray(best + (log - best) / (1 + length**2))


# -- cells -----------------------------------------------------------------------------------------


@dataclass(eq=False)
class Level:
    """Cells of one spacing that have been evaluated, a column each.

    By pattern of halved axes, the level of the halves, and where the halves of each cell begin.
    """

    step: Array
    data: Array
    count: int = 0
    depth: int = 0
    children: dict[tuple[int, ...], tuple[Level, Index]] = field(default_factory=dict)

    def add(self, columns: Array) -> int:
        """Keep more cells; the number of the first."""
        first, self.count = self.count, self.count + columns.shape[1]
        if self.count > self.data.shape[1]:
            # Of room that is not used yet there is no memory; copies are what costs.
            more = np.empty((len(self.data), 3 * self.count + 16))
            more[:, :first] = self.data[:, :first]
            self.data = more
        self.data[:, first : self.count] = columns
        return first


class Tree:
    """The tree of one or two unknowns of an observer, the others being given at nodes.

    Parameters
    ----------
    observer : Conditional
    tolerance : float
        Error of means and sds, in sds, above which a reading's lattice is refined.
    """

    def __init__(self, observer: Conditional, tolerance: float) -> None:
        self.observer, self.unknowns = observer, len(observer.unknowns)
        # Of kinks halves tell the error to a third of it; cells of one unknown are next to free.
        self.tolerance = tolerance / 10 if self.unknowns == 1 else tolerance
        # The share of the mass by which the trapezoidal rule may be off: at this one means are up
        # to 2e-4 sd off at k = 0.3, at 100 times it 3e-3. With one unknown a step more costs next
        # to nothing.
        self.share = tolerance / 2000 if self.unknowns > 1 else min(tolerance / 2000, 1e-8)
        # Three times as fine is 64 times the error of an edge, and any other is gone.
        self.refinements = 12 if self.unknowns == 1 else 3
        # More nats on the way, as cells are judged by their middles; cells of one unknown are few.
        self.slack = 100.0 if self.unknowns == 1 else 4.0
        self.evaluated = 0
        #: The coarse cells, and by number of what is given where they begin and how many they are.
        self.start = Level(np.ones(self.unknowns), np.empty((0, 0)))
        self.begins, self.counts = np.zeros((2, 0), dtype=int)
        #: Along each axis, the inner ends of the first and of the last of the coarse cells.
        self.inner_ends = np.zeros((2, self.unknowns))

    # -- evaluation --------------------------------------------------------------------------------

    def _prepare(self, signals: int, scores: int) -> None:
        noise, circular = self.observer.observer.noise, self.observer.observer.circular
        components = noise.components(signals)
        self.gaussian = (
            GaussianTerm(noise, signals, circular)
            if any(c.noise.gaussian_on for c in components)
            else None
        )
        self.others = [OtherTerm(*c) for c in components if not c.noise.gaussian_on]
        self.size = self.gaussian.size if self.gaussian else 0
        probe = np.ones((1, signals))
        own = sum(term.features(probe)[0].shape[1] for term in self.others)
        self.scores, self.smooth = scores, self.observer.observer.is_smooth
        # Features: Gaussian means, stabilised others, scores of priors, ln of the prior.
        self.features = self.size + own + scores + 1
        # The rows of a level's data, by what they are for.
        axes, size = self.unknowns, self.size
        sizes = {
            "which": 1, "place": axes, "contact": axes, "log_prior": 1, "constant": 1, "mean": size,
            "precision": size, "blurred_constant": 1, "blurred_precision": size, "length": axes,
            "rise": 1, "other_length": 1, "signals": signals if self.others else 0,
            "change": axes * self.features,
        }  # fmt: skip
        *begins, self.height = np.cumsum([0, *sizes.values()]).tolist()
        slices = map(slice, begins, [*begins[1:], self.height])
        self.rows: Any = SimpleNamespace(**dict(zip(sizes, slices, strict=True)))

    def _features(self, at: Evaluated) -> tuple[Array, Array]:
        """What is smooth across cells (N, F), and what of it one JND is, (N, F − 1)."""
        terms = ([self.gaussian] if self.gaussian else []) + self.others
        parts = [term.features(at.signals) for term in terms]
        place = [*(p for p, _ in parts), at.scores, at.log_prior[:, None]]
        scale = [*(s for _, s in parts), np.ones_like(at.scores)]
        return np.concatenate(place, axis=1), np.concatenate(scale, axis=1)

    def _between(self, change: Array) -> Array:
        """Changes of features (..., F), of directions the shorter way round."""
        if self.gaussian and self.gaussian.circular.size:
            turning = self.gaussian.circular
            change[..., turning] = within_half_turn(change[..., turning])
        return change

    def _columns(
        self, which: Index, place: Array, at: Evaluated, scale: Array, change: Array, level: Level
    ) -> Array:
        """All that readings ask of cells at integer places (N, U): columns (rows, N).

        `which` (N,) says what is given; `change` (U, N, F) is by how much features change across a
        cell along each axis.
        """
        rows, size = self.rows, self.size
        out = np.empty((self.height, len(place)))
        total = np.abs(change).sum(axis=0)
        with np.errstate(divide="ignore", invalid="ignore"):
            # Not where noise vanishes with the signal: its square is no number.
            held = np.isfinite(at.log_prior) & (scale > 1e-150).all(axis=1)
            scale = np.where(held[:, None], scale, 1.0)
            log_prior = np.where(held, at.log_prior, -np.inf)
            sd = scale[:, :size]
            # Curvature bends signals further within large cells.
            blur = 1.0 if level.depth < 2 else 0.36
            across = total[:, :size].copy()
            if self.gaussian:
                mean, turning = self.gaussian.features(at.signals)[0], self.gaussian.circular
                out[rows.mean] = mean.T
                if turning.size:  # a force that may vanish within the cell may turn round there
                    any_way = np.abs(mean) < across / 2
                    any_way = np.delete(any_way, turning, axis=1).any(axis=1)
                    across[np.ix_(any_way, turning)] = np.pi
            blurred = np.sqrt(sd**2 + blur * across**2)
            # A cell may be from where the prior is higher: as far as it rises, and of a prior
            # with a score, as far as that comes towards its middle.
            score = np.abs(at.scores)
            nearer = np.maximum(score - total[:, -1 - self.scores : -1] / 2, 0.0)
            rise = 0.5 * (score**2 - nearer**2).sum(axis=1) + 0.5 * total[:, -1]
            out[rows.which] = which
            out[rows.place], out[rows.contact] = place.T, at.contact[:, : self.unknowns].T
            out[rows.log_prior] = log_prior
            constant = self.gaussian.constant if self.gaussian else 0.0
            out[rows.constant] = log_prior + constant - np.log(sd).sum(axis=1)
            out[rows.blurred_constant] = log_prior + constant - np.log(blurred).sum(axis=1)
            out[rows.precision], out[rows.blurred_precision] = 1 / sd.T, 1 / blurred.T
            # Flat priors are as wide as 1 or so in the coordinates, for which a step counts.
            own = (2.5 * level.step) ** 2
            length = change[..., :-1] / scale
            if self.gaussian:
                length[..., :size] = length[..., :size] @ self.gaussian.root.T
            square = np.square(length).sum(axis=2) + own[:, None]
            out[rows.length], out[rows.rise] = np.sqrt(square), rise
            other = (
                total[:, size : -1 - self.scores] / scale[:, size : scale.shape[1] - self.scores]
            )
            out[rows.other_length] = np.sqrt(np.square(other).sum(axis=1))
        if self.others:
            out[rows.signals] = at.signals.T
        out[rows.change] = change.transpose(0, 2, 1).reshape(-1, len(place)) if len(place) else 0.0
        self.evaluated += len(place)
        return out

    def _begin(self, which: Index) -> None:
        """Evaluate the coarse cells over all contacts where there are none, at numbers (n,).

        They and how much signals change across them are read off a lattice of half the step: the
        change along an axis from its middle to either side, and the range over all 3^U points, by
        which it is raised where signals are not monotonic.
        """
        new = np.setdiff1d(which, np.flatnonzero(self.counts >= 0))
        if not new.size:
            return
        unknowns = self.unknowns
        low, high = self.observer.observer.ends(unknowns)
        root = ROOT_STEP if unknowns > 1 else ROOT_STEP / 16
        step = np.full(unknowns, root)
        first = np.floor(low / step).astype(int)
        count = np.ceil(high / step).astype(int) + 1 - first
        self.inner_ends = np.stack([first + 1, first + count - 1]) * root
        pairs = zip(first, count, strict=True)
        axes = [0.5 * (2 * f + np.arange(2 * n + 1)) * root for f, n in pairs]
        x = np.stack([a.ravel() for a in np.meshgrid(*axes, indexing="ij")], axis=-1)
        at = self.observer.evaluate(np.tile(x, (new.size, 1)), np.repeat(new, len(x)))
        if not self.start.count:
            self._prepare(at.signals.shape[1], at.scores.shape[1])
            self.start = Level(step, np.empty((self.height, 0)))
        features, scale = self._features(at)
        shape = new.size, *(2 * count + 1)
        held = np.isfinite(at.log_prior).reshape(shape)
        grid = features.reshape(*shape, -1)

        def moved(corner: Sequence[int]) -> tuple[slice, ...]:
            pairs = zip(corner, count, strict=True)
            return slice(None), *(slice(c, c + 2 * n, 2) for c, n in pairs)

        centre = moved([1] * unknowns)
        middle, inside = grid[centre], held[centre]

        def off(corner: Sequence[int]) -> Array:
            """How far features at a corner (0, 1 or 2 along each axis) are off the middle's."""
            with np.errstate(invalid="ignore"):
                value = np.abs(self._between(grid[moved(corner)] - middle))
                value[..., -1] = np.maximum(grid[moved(corner)] - middle, 0.0)[..., -1]
            return np.where((inside & held[moved(corner)])[..., None], value, 0.0)

        offs = {corner: off(corner) for corner in product((0, 1, 2), repeat=unknowns)}
        sides = [
            [tuple(1 + side * (i == d) for i in range(unknowns)) for side in (-1, 1)]
            for d in range(unknowns)
        ]
        change = np.stack([2 * np.maximum(offs[one], offs[other]) for one, other in sides])
        farthest = np.max(list(offs.values()), axis=0)
        with np.errstate(invalid="ignore", divide="ignore"):
            more = np.nan_to_num(2 * farthest / change.sum(axis=0), posinf=1.0, nan=1.0)
            change[..., :-1] *= np.maximum(more, 1.0)[..., :-1]
            for d, (one, other) in enumerate(sides):  # with signs, for correlated noise
                change[d] *= np.where(
                    self._between(grid[moved(other)] - grid[moved(one)]) < 0, -1, 1
                )
        place = np.tile(np.indices(count).reshape(unknowns, -1).T + first, (new.size, 1))
        chosen = np.flatnonzero(inside.ravel())
        cells = np.arange(held.size).reshape(shape)[centre].ravel()[chosen]
        own = Evaluated(*(column[cells] for column in at))
        change = change.reshape(unknowns, -1, features.shape[1])[:, chosen]
        number = np.repeat(new, inside[0].size)[chosen]
        begin = self.start.add(
            self._columns(number, place[chosen], own, scale[cells], change, self.start)
        )
        room = max(int(new.max()) + 1 - len(self.counts), 0)
        self.begins, self.counts = (
            np.append(a, np.full(room, -1)) for a in (self.begins, self.counts)
        )
        self.counts[new] = inside.reshape(new.size, -1).sum(axis=1)
        self.begins[new] = begin + np.cumsum(self.counts[new]) - self.counts[new]

    def _split(self, level: Level, pattern: tuple[int, ...], cells: Index) -> tuple[Level, Index]:
        """Halves of cells (P,) along the axes of a pattern: their level, and the first of each."""
        unknowns, shape = self.unknowns, tuple(1 + p for p in pattern)
        parts = int(np.prod(shape))
        child, first = level.children.get(pattern) or (
            Level(level.step / shape, np.empty((self.height, 0)), depth=level.depth + 1),
            np.zeros(0, dtype=np.int32),
        )
        if len(first) < level.count:
            first = np.append(first, np.full(level.count - len(first), -1, dtype=np.int32))
        halves = np.indices(shape).reshape(unknowns, -1)
        missing = np.unique(cells[first[cells] < 0])
        for begin in range(0, len(missing), PAIRS // parts):
            new = missing[begin : begin + PAIRS // parts]
            place = level.data[self.rows.place, new][:, :, None] * np.array(shape)[:, None, None]
            place = (place + halves[:, None]).reshape(unknowns, -1).T
            which = np.repeat(level.data[self.rows.which.start, new].astype(np.intp), parts)
            at = self.observer.evaluate((place + 0.5) * child.step, which)
            features, scale = self._features(at)
            before = level.data[self.rows.change, new].reshape(unknowns, self.features, -1)
            before = before.transpose(0, 2, 1) / np.array(shape)[:, None, None]
            change = np.repeat(before, parts, axis=1)
            held = np.isfinite(at.log_prior).reshape(len(new), *shape)
            grid = np.where(np.isfinite(features), features, 0.0).reshape(len(new), *shape, -1)
            for d in np.flatnonzero(pattern):
                rise = self._between(np.diff(grid, axis=1 + d))
                rise = np.broadcast_to(rise, grid.shape).reshape(change[d].shape)
                both = np.broadcast_to(held.all(axis=1 + d, keepdims=True), held.shape)
                # Where one half is not held, the change is half of what it was across both; nor
                # is it trusted to be far less than that.
                found = np.copysign(np.maximum(np.abs(rise), 0.5 * np.abs(change[d])), rise)
                change[d] = np.where(both.reshape(-1, 1), found, change[d])
            columns = self._columns(which, place, at, scale, change, child)
            first[new] = child.add(columns) + parts * np.arange(len(new), dtype=np.int32)
        level.children[pattern] = child, first
        return child, first[cells].astype(np.intp)

    @property
    def bytes(self) -> int:
        """Memory of the cells, and of where the halves of each begin."""
        return (8 * self.height + 4) * self.evaluated if self.start.count else 0

    # -- readings ----------------------------------------------------------------------------------

    def sums(
        self, readings: Array, covariance: Array | None = None, *, which: Index | None = None,
        drop: float = DROP, least: Array | None = None,
    ) -> Sums:  # fmt: skip
        """The weighted cells of readings (B, R), and their moments.

        With the covariances (B, R, R) of measurement errors, which add to the receptors' noise, and
        the numbers (B,) of what is given, the first by default; cells whose density is `drop` nats
        below the highest are left out. A reading some of whose cells were left out too early
        descends again, three times in all at most; with `least` (B,) none does, and those whose ln
        of the density is nowhere above that have no sums.
        """
        which = np.zeros(len(readings), dtype=int) if which is None else which
        out = Sums(len(readings), self.unknowns, self.observer, which)
        lowest = np.full(len(readings), -np.inf) if least is None else least
        deeper, tries = np.full(len(readings), drop), np.zeros(len(readings), dtype=int)
        waiting = list(self._chunks(which, 512))
        while waiting:
            rows = waiting.pop()
            if self.bytes > MEMORY:  # none are kept but the coarse ones
                self.start.children.clear()
                self.evaluated = self.start.count
            own = None if covariance is None else covariance[rows]
            descent = Descent(self, readings[rows], own, which[rows], rows, deeper[rows], out)
            left = descent.run(lowest[rows], 1.25 * MEMORY)
            if left.size == rows.size:  # whose cells are too many together
                waiting += np.array_split(rows, 2)
                continue
            # Again where cells turn out to have been left out too early.
            missed = descent.missed(drop) if least is None else np.zeros(len(rows))
            missed[left] = 0.0
            again = rows[missed > 0]
            deeper[again] += missed[missed > 0] + 1
            tries[again] += 1
            out.error[again[tries[again] == 3]] = np.inf
            again = np.append(rows[left], again[tries[again] < 3])
            if again.size:
                waiting.append(again)
        # That of a log-normal reading whose sign is not its signal's.
        out.log_evidence[out.log_evidence < -1e8] = np.nan
        return out

    def glimpse(self, readings: Array, covariance: Array | None, which: Index) -> Array:
        """ln of the highest density of readings (B, R) as coarse cells have it, (B,)."""
        out = np.full(len(readings), -np.inf)
        for rows in self._chunks(which, len(which)):
            own = None if covariance is None else covariance[rows]
            none = np.zeros(len(rows))
            descent = Descent(self, readings[rows], own, which[rows], rows, none, None)
            task = descent.first()
            log = descent.log(task.level, task.row, task.cell, blurred=True)
            first = np.flatnonzero(np.diff(task.row, prepend=-1))
            out[rows] = np.maximum.reduceat(log, first) + descent.log_slope
        return out

    def _chunks(self, which: Index, most: int) -> Iterator[Index]:
        """Readings, some at a time, but for those that no contact can be of where that is given.

        Their pairs with the coarse cells are held at once.
        """
        self._begin(which)
        some = np.flatnonzero(self.counts[which] > 0)
        size = (
            int(np.clip(PAIRS // max(self.counts.max(initial=1), 1), 1, most)) if len(some) else 1
        )
        for begin in range(0, len(some), size):
            yield some[begin : begin + size]


# -- trees that are kept ---------------------------------------------------------------------------

_kept: OrderedDict[tuple[Any, int, float], Tree] = OrderedDict()


def tree_of(observer: Observer, tolerance: float, inner: int | None = None) -> Tree:
    """The tree of an observer, kept for the next reading; the least used go first.

    Of its first `inner` unknowns, by default all.
    """
    inner = len(observer.unknowns) if inner is None else inner
    key = observer, inner, tolerance
    tree = _kept.pop(key, None) or Tree(Conditional(observer, inner), tolerance)
    total = sum(other.bytes for other in _kept.values()) + tree.bytes
    while total > MEMORY and _kept:
        total -= _kept.popitem(last=False)[1].bytes
    _kept[key] = tree
    return tree
