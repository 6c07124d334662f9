"""Weighted cells: moments, intervals and draws of posteriors, read off in one place.

A posterior is an even lattice of cells in the observer's coordinates, each with the ln of its
density. Sums over the lattice are exact but for what `CellSums.error` says. Between cells ln of
the density is interpolated by cubics, which is exact for a Gaussian, and integrated.
`WeightedPosteriors` is what all sums have in common, whether of cells or over nodes.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.interpolate import PchipInterpolator, make_interp_spline
from scipy.special import ndtr, ndtri

from .._util.values import Array, Flags, Index
from .._util.weights import half_error, resampled
from .cells import Lattices
from .conditional import Conditional

__all__ = [
    "OVER", "CellSums", "Spans", "WeightedPosteriors", "between_nodes", "density_of_distance",
    "extrapolated", "in_one", "interpolate", "masses", "mixed", "spans_between",
]  # fmt: skip

#: Points between cells at which densities are interpolated: along the distance (for spans; half as
#: many for quantiles), and along the second unknown at each distance. Quantiles of a Gaussian are
#: so off by less than 1e-4 sd.
PARTS = 16, 4
#: Nats below the highest density beyond which cells do not count in quantiles of the second
#: unknown.
DEPTH = 14.0
#: Proposals for each draw.
OVER = 4
#: Numbers at once, in quantiles of the second unknown: 16 MB.
NUMBERS = 2_000_000
#: By how many sds quantiles of the second unknown may differ from those of half the columns. Those
#: of all columns are then off by less than 2e-3.
HALVES = 5e-3
#: Most columns of quantiles of the second unknown to a step between cells.
MOST_STEPS = 64
#: Where quantiles of the second unknown are first looked for, in sds from its mean.
GRID = np.array([-8.0, -5.0, -3.5, -2.5, -2.0, -1.5, -0.7, 0.0, 0.7, 1.5, 2.0, 2.5, 3.5, 5.0, 8.0])


class WeightedPosteriors(Protocol):
    """Posteriors of B readings of U unknowns as weighted cells; NaN where there is none.

    Implemented by `CellSums` and `layers.LayeredSums`.

    Attributes
    ----------
    mean, sd, best : array, shape (B, U)
        Moments, and the contact of highest density.
    error : array, shape (B,)
        Estimated error of means and sds, in sds; infinite where there is no sum.
    log_evidence : array, shape (B,)
    """

    mean: Array
    sd: Array
    best: Array
    error: Array
    log_evidence: Array

    @property
    def bytes(self) -> int:
        """Memory of the cells."""

    def quantiles(self, p: Array, unknown: int) -> Array:
        """Quantiles (B, Q) of an unknown at probabilities (Q,)."""

    def spans(self, unknown: int, stride: int = 1) -> Iterator[Spans]:
        """Stretches of an unknown and their masses, for one or more readings at a time."""

    def draws(self, count: int, rng: np.random.Generator, readings: Array) -> Array:
        """Draws (B, count, U) of the contact, given the readings (B, R)."""


@dataclass(frozen=True, eq=False)
class Spans:
    """Of readings (n,), stretches of an unknown (n, K), over which mass is spread evenly.

    Stretches may overlap.
    """

    readings: Index
    low: Array
    high: Array
    mass: Array

    def quantiles(self, p: Array) -> Array:
        """Quantiles (n, Q) of the union of all stretches."""
        count = self.low.shape[1]
        ends = np.concatenate([self.low, self.high], axis=1)
        width = np.maximum(self.high - self.low, 1e-12 * np.abs(ends).max(axis=1, keepdims=True))
        slope = self.mass / np.maximum(width, 1e-300)
        slope = np.concatenate([slope, -slope], axis=1)
        ends[:, count:] = self.low + width
        order = np.argsort(ends, axis=1, kind="stable")
        ends = np.take_along_axis(ends, order, axis=1)
        density = np.cumsum(np.take_along_axis(slope, order, axis=1), axis=1)[:, :-1]
        rise = np.zeros_like(ends)
        np.cumsum(np.maximum(density, 0.0) * np.diff(ends, axis=1), axis=1, out=rise[:, 1:])
        rise /= rise[:, -1:]
        return np.stack([np.interp(p, up, at) for up, at in zip(rise, ends, strict=True)])


class CellSums:
    """Posteriors of `count` readings as weighted cells and their sums, NaN until there are any.

    As `WeightedPosteriors`, and `log_slope` (B,): ln of the density of a reading over that of what
    cells take for it.

    Parameters
    ----------
    count, unknowns : int
        B and U.
    observer : Conditional
    which : array, shape (B,)
        The number of what is given to the observer for each reading.
    """

    def __init__(self, count: int, unknowns: int, observer: Conditional, which: Index) -> None:
        self.observer, self.which = observer, which
        self.mean, self.sd, self.best = np.full((3, count, unknowns), np.nan)
        self.log_evidence, self.log_slope = np.full((2, count), np.nan)
        self.error = np.full(count, np.inf)
        #: Which of the lattices each reading is in.
        self._at = np.full(count, -1)
        self._lattices: list[Lattices] = []

    def add(self, lattices: Lattices, contact: Array, log_slope: Array, smooth: bool) -> Array:
        """Sum over lattices in place of any that their readings had: by how much halves differ.

        With the contacts (U, P) of the cells.

        The error of the trapezoidal rule at a step h is that at 2h to the fourth power for a
        Gaussian, and to the second for an edge: the square of what sums over every other cell
        along one axis (U, n) differ by; that itself where the density has kinks. (Halves as on a
        chessboard see nothing of ridges oblique to both axes: 560 of 1025 errors were so missed.)
        """
        step, at, first = lattices.step, lattices.readings, lattices.first
        log, owner, unknowns = lattices.log, lattices.owner, len(step)
        top = np.maximum.reduceat(log, first)
        weight = np.exp(log - top[owner])
        total = np.add.reduceat(weight, first)
        signs = 1.0 - 2.0 * (lattices.place & 1)
        each = np.zeros((unknowns, len(at)))
        halves = [np.add.reduceat(weight * s, first) for s in signs]
        for i in range(unknowns):
            origin = contact[i][first]
            value = contact[i] - origin[owner]
            weighted = weight * value
            mean = np.add.reduceat(weighted, first) / total
            value -= mean[owner]
            weighted = weight * value
            squared = weighted * value
            variance = np.add.reduceat(squared, first) / total
            sd = np.sqrt(np.maximum(variance, 1e-300))
            self.mean[at, i], self.sd[at, i] = origin + mean, np.sqrt(variance)
            for d in range(unknowns if i == 0 else 0):
                one = np.add.reduceat(weighted * signs[d], first)
                two = np.add.reduceat(squared * signs[d], first)
                for sign in (1, -1):
                    part = total + sign * halves[d]
                    share = part / (2 * total)
                    part = np.maximum(part, 1e-300)
                    m = sign * one / part
                    with np.errstate(over="ignore", invalid="ignore"):
                        v = (variance * total + sign * two) / part - m * m
                    off = half_error(share, m, np.sqrt(np.maximum(v, 0)), sd)
                    off = np.where(share > 0, off, 1.0)  # a half has nothing
                    each[d] = np.maximum(each[d], off)
        each = np.minimum(each, 1e100)
        worst = np.max(each, axis=0)
        self.error[at] = worst**2 if smooth else worst
        self.log_evidence[at] = top + np.log(total) + np.log(step).sum(axis=0) + log_slope
        self.log_slope[at] = log_slope
        highest = np.flatnonzero(log == top[owner])
        highest = highest[np.unique(owner[highest], return_index=True)[1]]
        self.best[at] = contact[:, highest].T
        self._at[at] = len(self._lattices)
        self._lattices.append(lattices)
        return each

    @property
    def bytes(self) -> int:
        """Memory of the cells."""
        return sum(each.place.nbytes + each.log.nbytes for each in self._lattices)

    def lattices(self, among: Flags | None = None) -> Iterator[Lattices]:
        """Lattices, but for those that were summed again, of readings `among` (B,) if given."""
        for i, each in enumerate(self._lattices):
            current = self._at[each.readings] == i
            if among is not None:
                current &= among[each.readings]
            if current.all():
                yield each
            elif current.any():
                yield each.of(current)

    # -- along one axis ----------------------------------------------------------------------------

    def marginals(
        self, among: Flags | None = None, factors: SpanFactors | None = None
    ) -> Iterator[Marginals]:
        """ln of the density of the first coordinate at even places, for some readings at a time."""
        for lattices in self.lattices(among):
            step, place = lattices.step, lattices.place[0].astype(np.intp)
            low = np.minimum.reduceat(place, lattices.first)
            owner = lattices.owner
            place -= low[owner]
            count = int(place.max()) + 1
            top = np.maximum.reduceat(lattices.log, lattices.first)
            weight = np.exp(lattices.log - top[owner])
            index, size = owner * count + place, len(low) * count
            times = np.ones((1, 1)) if factors is None else factors.at(self, lattices)
            mass = np.stack([np.bincount(index, weight * f, size) for f in times], axis=-1)
            with np.errstate(divide="ignore"):
                log = np.log(mass.reshape(len(low), count, -1)) + top[:, None, None]
            log = log[..., 0] if factors is None else log
            log += np.log(step[1:]).sum(axis=0).reshape(-1, *[1] * (log.ndim - 1))
            yield Marginals(lattices.readings, (low + 0.5) * step[0], step[0], log)

    def spans(self, unknown: int, stride: int = 1) -> Iterator[Spans]:
        """Spans of the distance, for some readings at a time; half as many with a stride of 2."""
        assert unknown == 0
        for marginal in self.marginals():
            x, log = interpolate(marginal.log, PARTS[0] // stride)
            x = marginal.start[:, None] + marginal.step[:, None] * x
            value = self.observer.distance(x, self.which[marginal.readings])
            yield spans_between(marginal.readings, value, log)

    def quantiles(self, p: Array, unknown: int, among: Flags | None = None) -> Array:
        """Quantiles (B, Q) of an unknown, of readings `among` (B,) if given, NaN of others."""
        out = np.full((len(self.error), len(p)), np.nan)
        if unknown == 0:
            for marginal in self.marginals(among):
                curves = Cumulative(marginal.log, PARTS[0] // 2)
                x = marginal.start[:, None] + marginal.step[:, None] * curves.inverse(p)
                at = marginal.readings
                out[at] = self.observer.distance(x, self.which[at])
            return out
        lattices: Iterable[Lattices] = self.lattices(among)
        #: By the number of columns to a step, lattices that need so many.
        finer: dict[int, list[Lattices]] = {2**n: [] for n in range(1, MOST_STEPS.bit_length())}
        for steps in (1, *finer):
            # Columns of a lattice are some tens, with some tens of cells each.
            for chunk in _in_batches(lattices, NUMBERS // (8 * PARTS[1] * steps)):
                at = chunk.readings
                columns = Columns(chunk, self.observer, self.which[at], steps)
                mean, sd = self.mean[at, 1], self.sd[at, 1]
                needed = columns.steps_needed(mean, sd) if steps == 1 else np.full(len(at), steps)
                enough = np.asarray(needed <= steps)
                if enough.any():
                    out[at[enough]], off = columns.quantiles(p, mean, sd, enough)
                    needed[enough] = np.where(off > HALVES, 2 * steps, steps)
                needed = np.minimum(needed, MOST_STEPS)
                for more in np.unique(needed[needed > steps]):
                    finer[int(more)].append(chunk.of(needed == more))
            lattices = finer.get(2 * steps, ())
        return out

    # -- draws -------------------------------------------------------------------------------------

    def proposals(
        self, count: int, rng: np.random.Generator, reading: int
    ) -> tuple[Array, Array]:
        """Coordinates (count, U) spread over the cells of one reading, and ln of their density.

        The density (count,) is up to a factor. Of cells of next to no density there are more than
        these have mass, as it may be higher elsewhere in them.
        """
        among = np.arange(len(self.error)) == reading
        lattice = next(self.lattices(among))
        step, top = lattice.step, lattice.log.max()
        weight = np.exp(0.75 * (lattice.log - top))
        weight /= weight.sum()
        chosen = rng.choice(len(weight), count, p=weight)
        middle = lattice.place[:, chosen].T + 0.5
        x = (middle + rng.random(middle.shape) - 0.5) * step.T
        return x, np.log(weight[chosen]) - np.log(step).sum()

    def draws(self, count: int, rng: np.random.Generator, readings: Array) -> Array:
        """Draws (B, count, U) of the contact, given the readings (B, R)."""
        out = np.full((*self.mean.shape[:1], count, self.mean.shape[1]), np.nan)
        for i in np.flatnonzero(np.isfinite(self.log_evidence)):
            x, log_proposed = self.proposals(OVER * count, rng, int(i))
            log, contact = self.observer.observer.log_density_and_contact(x, readings[i])
            out[i] = contact[resampled(log - log_proposed, count, rng)]
        return out


def _in_batches(lattices: Iterable[Lattices], cells: int) -> Iterator[Lattices]:
    """Lattices of any steps joined, until they have so many cells."""
    batch: list[Lattices] = []
    count = 0
    for each in lattices:
        for part in each.chunks(max(1, cells * len(each.readings) // len(each.log))):
            batch.append(part)
            count += len(part.log)
            if count >= cells:
                yield Lattices.joined(batch)
                batch, count = [], 0
    if batch:
        yield Lattices.joined(batch)


# -- cumulative densities --------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Marginals:
    """ln of densities of the first coordinate at even places, of readings (n,).

    The first place (n,) and the step (n,); ln of the density is (n, L), or (n, L, K) by K factors;
    −inf where there is no cell.
    """

    readings: Index
    start: Array
    step: Array
    log: Array


class SpanFactors(Protocol):
    """Factors (K, P) by which cells of lattices are weighed for marginals."""

    def at(self, sums: CellSums, lattices: Lattices) -> Array: ...


class Cumulative:
    """Cumulative of densities (n, L) at even places of which ln is given, interpolated by cubics.

    Integrals between points are of fourth order, and within them the density is linear.
    """

    def __init__(self, log: Array, per_step: int) -> None:
        x, fine = interpolate(log, per_step)
        self.first, self.per_step = x[0], per_step
        #: ln of the highest density (n,), to which all are relative.
        self.log_top = fine.max(axis=1)
        with np.errstate(invalid="ignore"):  # NaN where there is no density at all
            self.density = d = np.exp(fine - self.log_top[:, None])
        mass = (d[:, 1:] + d[:, :-1]) / 2
        mass[:, 1:-1] += (mass[:, 1:-1] - (d[:, 3:] + d[:, :-3]) / 2) / 12
        self.mass = np.maximum(mass, 0.0)
        self.below = np.zeros(d.shape)
        np.cumsum(self.mass, axis=1, out=self.below[:, 1:])

    def inverse(self, p: Array) -> Array:
        """Places (n, Q), in steps from the first, below which there are shares p (Q,)."""
        target = p * self.below[:, -1:]
        cell = np.stack(
            [np.searchsorted(b, t, side="right") for b, t in zip(self.below, target, strict=True)]
        )
        cell = np.clip(cell - 1, 0, self.mass.shape[1] - 1)
        low, mass, below = (
            np.take_along_axis(a, cell, axis=1) for a in (self.density, self.mass, self.below)
        )
        high = np.take_along_axis(self.density, cell + 1, axis=1)
        share = np.clip((target - below) / np.maximum(mass, 1e-300), 0.0, 1.0)
        # Of a linear density: low t + (high − low) t²/2 is this share of the mean.
        root = np.sqrt(low**2 + share * (high**2 - low**2))
        t = share * (low + high) / np.maximum(low + root, 1e-300)
        return np.asarray(self.first + (cell + t) / self.per_step)


class CumulativeByLength:
    """Cumulatives of densities (n, L), of `length` (n,) each, in classes of similar length.

    The longest columns of a chunk are three times as long as the mean: in one table two thirds of
    the interpolated points would be empty.
    """

    def __init__(self, log: Array, length: Index, per_step: int) -> None:
        n, self.per_step = len(length), per_step
        #: ln of the highest density (n,), and the mass relative to it.
        self.log_top, self.total = np.zeros((2, n))
        #: Where the points of each begin, and how many intervals are between them.
        self.begin, self.intervals = np.zeros((2, n), dtype=np.intp)
        # A class is of lengths within a factor of √2.
        classes, begin = np.ceil(2 * np.log2(length)).astype(np.intp), 0
        tables = []
        for number in np.unique(classes):
            of_class = np.flatnonzero(classes == number)
            curves = Cumulative(log[of_class, : length[of_class].max()], per_step)
            self.first, points = curves.first, curves.density.shape[1]
            self.log_top[of_class], self.total[of_class] = curves.log_top, curves.below[:, -1]
            self.begin[of_class] = begin + points * np.arange(len(of_class))
            self.intervals[of_class] = points - 1
            begin += points * len(of_class)
            mass = np.pad(curves.mass, ((0, 0), (0, 1)))
            tables.append([table.ravel() for table in (curves.density, mass, curves.below)])
        self.density, self.mass, self.below = map(np.concatenate, zip(*tables, strict=True))

    def at(self, x: Array, which: Index) -> Array:
        """Mass (m, Q) of densities `which` (m,) below places (m, Q), in steps from the first."""
        last = self.intervals[which, None]
        place = np.clip((x - self.first) * self.per_step, 0.0, last)
        cell = np.minimum(place.astype(np.intp), last - 1)
        flat = cell + self.begin[which, None]
        low, high = self.density[flat], self.density[flat + 1]
        t = place - cell
        share = t * (2 * low + t * (high - low)) / np.maximum(low + high, 1e-300)
        return np.asarray(self.below[flat] + share * self.mass[flat])


class Columns:
    """Lattices of two unknowns as columns of one distance each.

    The probability that the second unknown lies below a value is the sum over columns of their
    masses below its coordinate there: over distances the trapezoidal rule. Where a line of one
    value crosses a narrow ridge within a step, there are several `steps` of columns to one: as many
    as `steps_needed` finds at a few values, or more until quantiles of half the columns agree.
    """

    def __init__(
        self, lattices: Lattices, observer: Conditional, which: Index, steps: int
    ) -> None:
        owner = lattices.owner
        top = np.maximum.reduceat(lattices.log, lattices.first)
        kept = lattices.log > (top - DEPTH)[owner]
        owner, log = owner[kept], lattices.log[kept]
        first, second = lattices.place[:, kept].astype(np.intp)
        begin = np.flatnonzero(np.diff(owner, prepend=-1))
        left = np.minimum.reduceat(first, begin)
        if steps > 1:
            first, second, owner, log = _with_finer_columns(first, second, owner, log, left, steps)
            kept = log > (top - DEPTH)[owner]
            first, second, owner, log = first[kept], second[kept], owner[kept], log[kept]
            left = left * steps - steps
        width = int((first - left[owner]).max()) + 1
        column = owner * width + first - left[owner]
        lowest = np.full(len(left) * width, np.iinfo(np.intp).max)
        np.minimum.at(lowest, column, second)
        present = np.flatnonzero(lowest < np.iinfo(np.intp).max)
        number = np.zeros(len(lowest), dtype=np.intp)
        number[present] = np.arange(len(present))
        #: Of each column the number of its reading, and of each reading its first column.
        self.owner = present // width
        self.first = np.flatnonzero(np.diff(self.owner, prepend=-1))
        place = second - lowest[column]
        table = np.full((len(present), int(place.max()) + 1), -np.inf)
        table[number[column], place] = log
        length = np.zeros(len(present), dtype=np.intp)
        np.maximum.at(length, number[column], place + 1)
        self.curves = CumulativeByLength(table, length, PARTS[1])
        self.weight = np.exp(self.curves.log_top - top[self.owner])
        self.total = np.add.reduceat(self.weight * self.curves.total, self.first)
        self.start = (lowest[present] + 0.5)[:, None]
        step, self.step = lattices.step[0, self.owner], lattices.step[1, self.owner, None]
        place_in = left[self.owner] + present % width
        #: Whether a column is one of every other.
        self.odd_columns = np.asarray(place_in % 2 == 1)
        x = (place_in / steps + 0.5) * step
        self.scale = observer.second_scale(x, which[self.owner])
        low, high = self.scale.low, np.maximum.reduceat(self.scale.high, self.first)
        #: The least value (n, 1) that the second unknown may have, and the largest.
        self.bounds = np.full((len(high), 1), low), high[:, None]

    def steps_needed(self, mean: Array, sd: Array) -> Index:
        """How many columns to a step resolve the crossings of ridges, (n,): a power of 2.

        A normal cumulative whose steps are 1.4 sds has a trapezoidal sum right to 1e-5.
        """
        value = (mean[:, None] + sd[:, None] * [-1.8, -0.9, 0.0, 1.0, 2.2])[self.owner]
        every = np.arange(len(self.owner))
        x = self.scale.coordinate(value, every) / self.step - self.start
        mass = self.curves.total[:, None]
        score = np.clip(ndtri(np.clip(self.curves.at(x, every) / mass, 0.0, 1.0)), -6.0, 6.0)
        move = np.abs(np.diff(score, axis=0, append=score[-1:]))
        crosses = np.diff(score > 0, axis=0, append=score[-1:] > 0)
        same = np.append(self.owner[1:] == self.owner[:-1], False)
        heavy = self.weight * mass[:, 0] > 1e-4 * self.total[self.owner]
        counts = np.asarray(same & heavy)[:, None]
        move = np.where(crosses & counts, move, 0.0).max(axis=1)
        most = np.maximum.reduceat(move, self.first)
        power = np.ceil(np.log2(np.maximum(most / 1.4, 1.0))).astype(np.intp)
        return np.asarray(2**power)

    def off_by_half_columns(self, value: Array) -> Array:
        """By how much probabilities (n, Q) below values (n, Q) differ from those of half columns.

        Every other column is one half, the rest the other.
        """
        every = np.arange(len(self.owner))
        x = self.scale.coordinate(value[self.owner], every) / self.step - self.start
        below = self.weight[:, None] * self.curves.at(x, every)
        mass = self.weight * self.curves.total
        share = np.add.reduceat(below, self.first, axis=0) / self.total[:, None]
        off = np.zeros(value.shape)
        for half in (self.odd_columns, ~self.odd_columns):
            total = np.maximum(np.add.reduceat(mass * half, self.first), 1e-300)
            part = np.add.reduceat(below * half[:, None], self.first, axis=0) / total[:, None]
            off = np.maximum(off, np.abs(part - share))
        return off

    def score(self, value: Array, among: Flags) -> Array:
        """Normal scores of the probabilities (n, Q) below values (n, Q), of readings `among`."""
        mine = np.flatnonzero(among[self.owner])
        number = np.cumsum(among) - 1
        owner = number[self.owner[mine]]
        x = self.scale.coordinate(value[owner], mine) / self.step[mine] - self.start[mine]
        below = self.weight[mine, None] * self.curves.at(x, mine)
        first = np.flatnonzero(np.diff(owner, prepend=-1))
        below = np.add.reduceat(below, first, axis=0) / self.total[among, None]
        return np.clip(ndtri(np.clip(below, 0.0, 1.0)), -38.0, 38.0)

    def quantiles(self, p: Array, mean: Array, sd: Array, among: Flags) -> tuple[Array, Array]:
        """Quantiles (m, Q) at probabilities (Q,) of the second unknown, of readings `among` (n,).

        And by how many sds the worst of each reading differs from that of half the columns (m,).
        Moments are of all readings, (n,).

        Scores of values are all but straight lines: regula falsi with Illinois steps converges in
        three or four.
        """
        target = ndtri(p)
        sd_of = sd[among, None]
        lowest, highest = (bound[among] for bound in self.bounds)
        grid = np.clip(mean[among, None] + sd_of * GRID, lowest, highest)
        score = np.pad(self.score(grid, among), ((0, 0), (1, 1)), constant_values=(-38.0, 38.0))
        ends = np.maximum(lowest, grid[:, :1] - 40 * sd_of), np.minimum(
            highest, grid[:, -1:] + 40 * sd_of
        )
        grid = np.concatenate([ends[0], grid, ends[1]], axis=1)
        above = np.maximum((score[:, None] >= target[:, None]).argmax(axis=2), 1)
        low, high = (np.take_along_axis(grid, above - i, axis=1) for i in (1, 0))
        below, beyond = (np.take_along_axis(score, above - i, axis=1) - target for i in (1, 0))
        out, side = np.where(beyond == 0, high, low), np.zeros(low.shape)
        done = np.asarray(beyond == 0)
        for _ in range(80):
            left = np.flatnonzero(~done.all(axis=1))
            if not left.size:
                break
            active = np.zeros(len(among), dtype=bool)
            active[np.flatnonzero(among)[left]] = True
            a, b, fa, fb = low[left], high[left], below[left], beyond[left]
            guess = a - fa * (b - a) / np.maximum(fb - fa, 1e-300)
            off = self.score(guess, active) - target
            over = off >= 0
            again = np.where(over, 1.0, -1.0) == side[left]
            out[left] = np.where(done[left], out[left], guess)
            done[left] |= (np.abs(off) < 1e-7) | (b - a < 1e-6 * sd_of[left])
            high[left], beyond[left] = np.where(over, guess, b), np.where(
                over, off, np.where(again, fb / 2, fb)
            )
            low[left], below[left] = np.where(over, a, guess), np.where(
                over, np.where(again, fa / 2, fa), off
            )
            side[left] = np.where(over, 1.0, -1.0)
        near = 0.05 * sd_of
        rise = ndtr(self.score(out + near, among)) - ndtr(self.score(out - near, among))
        value = np.repeat(mean[:, None], len(p), axis=1)
        value[among] = out
        # Probabilities over the density are distances: `rise` is the density times 2 * 0.05 sd.
        off = 0.1 * self.off_by_half_columns(value)[among] / np.maximum(rise, 1e-300)
        return out, off.max(axis=1)


def _with_finer_columns(
    first: Index, second: Index, owner: Index, log: Array, left: Index, steps: int
) -> tuple[Index, Index, Index, Array]:
    """Places along both axes, owner, and ln of the density, of cells with columns in between.

    The places along the first axis are in steps so many times as small.
    """
    begin = np.flatnonzero(np.diff(owner, prepend=-1))
    low = np.minimum.reduceat(second, begin)
    i, j = first - left[owner], second - low[owner]
    table = np.full((len(left), int(j.max()) + 1, int(i.max()) + 1), -np.inf)
    table[owner, j, i] = log
    fine = interpolate(table.reshape(-1, table.shape[2]), steps)[1]
    fine = fine.reshape(*table.shape[:2], -1)
    owner, j, i = np.nonzero(np.isfinite(fine))
    return left[owner] * steps - steps + i, low[owner] + j, owner, fine[owner, j, i]


def spans_between(readings: Index, value: Array, log: Array) -> Spans:
    """Spans between values (n, K) at which ln of the density is given, at even places."""
    return Spans(readings, value[:, :-1], value[:, 1:], masses(log))


def masses(log: Array) -> Array:
    """Masses (n, K − 1) between even places at which ln of the density is (n, K), unnormalised."""
    with np.errstate(invalid="ignore"):  # NaN where there is no density at all
        density = np.exp(log - log.max(axis=1, keepdims=True))
    return np.asarray((density[:, 1:] + density[:, :-1]) / 2)


def interpolate(log: Array, per_step: int) -> tuple[Array, Array]:
    """Cubic interpolation of ln of densities (n, L) at even places, −inf where not given.

    Beyond the ends, for a step to either side, and in gaps, ln of the density goes on as a
    parabola that falls. Returns places (K,) in steps from the first, and values (n, K).
    """
    n, count = log.shape
    is_finite = np.isfinite(log)
    first, last = is_finite.argmax(axis=1), count - 1 - is_finite[:, ::-1].argmax(axis=1)
    whole = last - first + 1
    whole = np.asarray((is_finite.sum(axis=1) == whole) & (whole > 2))
    pad = np.zeros((n, count + 6))
    pad[:, 3:-3] = np.where(is_finite, log, 0.0)
    gapless = np.flatnonzero(whole)
    for side, end in ((1, last[gapless] + 3), (-1, first[gapless] + 3)):
        for j in (end + side, end + 2 * side):  # beyond those no number counts
            a, b, c = (pad[gapless, j - k * side] for k in (1, 2, 3))
            pad[gapless, j] = np.minimum(np.minimum(3 * a - 3 * b + c, 2 * a - b), a - 1)
    if len(gapless) < n:
        pad[~whole] = _filled(log[~whole])
    pad = pad[:, 1:-1]
    unknown = np.asarray(~is_finite.any(axis=1))
    t = np.arange(per_step) / per_step
    cubic = np.stack(
        [-t * (t - 1) * (t - 2) / 6, (t + 1) * (t - 1) * (t - 2) / 2,
         -(t + 1) * t * (t - 2) / 2, (t + 1) * t * (t - 1) / 6]
    )  # fmt: skip
    m = pad.shape[1] - 3
    # Beside a cliff a cubic overshoots.
    ceiling = np.maximum(pad[:, 1 : 1 + m], pad[:, 2 : 2 + m]) + 0.5
    out, term = np.empty((n, m, per_step)), np.empty((n, m))
    for k in range(per_step):
        value = pad[:, :m] * cubic[0, k]
        for i in (1, 2, 3):
            value += np.multiply(pad[:, i : i + m], cubic[i, k], out=term)
        np.minimum(value, ceiling, out=out[..., k])
    x = np.arange(m * per_step + 3) / per_step - 1.0
    # The longest row ends as the others do, so that a row is the same whatever rows it is with.
    out = np.concatenate([out.reshape(n, -1), pad[:, -2:-1], np.full((n, 2), -np.inf)], axis=1)
    beyond = (x < first[:, None] - 1) | (x > last[:, None] + 1)
    out[np.asarray(beyond | unknown[:, None])] = -np.inf
    return x, out


def _filled(log: Array) -> Array:
    """ln of densities (n, L) with three more to either side, and with gaps filled; 0 if unknown."""
    n, count = log.shape
    pad = np.full((count + 6, n), -np.inf)  # places first, as one place is filled at a time
    pad[3:-3] = log.T
    is_finite = np.isfinite(pad)
    for order in (range(3, count + 6), range(count + 2, -1, -1)):
        side = 1 if order[0] < order[-1] else -1
        for j in order:
            gap = is_finite[j - side] & ~is_finite[j]
            if gap.any():
                a, b, c = (pad[j - k * side] for k in (1, 2, 3))
                with np.errstate(invalid="ignore"):
                    on = np.minimum(3 * a - 3 * b + c, 2 * a - b)
                    on = np.where(np.isfinite(on), np.minimum(on, a - 1), a - 8)
                np.copyto(pad[j], on, where=gap)
                is_finite[j] |= gap
    pad[:, ~is_finite.any(axis=0)] = 0.0
    return pad.T


def extrapolated(full: Iterator[Spans], halved: Iterator[Spans], p: Array, count: int) -> Array:
    """Quantiles (count, Q) by spans, and by half as many: their error of second order is removed.
    """
    out = np.full((count, len(p)), np.nan)
    for spans, half in zip(full, halved, strict=True):
        value = spans.quantiles(p)
        out[spans.readings] = value + (value - half.quantiles(p)) / 3
    return out


def density_of_distance(sums: WeightedPosteriors, r: Array) -> Array:
    """Posterior density (B,) of the radial distance at r (B,), 1/m."""
    out = np.zeros(len(r))
    for spans in sums.spans(0):
        value = r[spans.readings, None]
        inside = (spans.low <= value) & (value < spans.high)
        width = np.where(inside, spans.high - spans.low, 1.0)
        out[spans.readings] = (inside * spans.mass / width).sum(axis=1) / spans.mass.sum(axis=1)
    return out


def mixed(
    readings: Index, log: Array, has_mass: Flags, quantile: Array, scores: Array, per_step: int
) -> Spans:
    """Spans of a mixture over nodes of conditional distributions, given their quantiles.

    Between nodes quantiles are interpolated: conditional distributions may have two modes.
    """
    weight, quantile = between_nodes(log, has_mass, quantile, per_step)
    # Between scores mass is all but that of a Gaussian, which is not spread evenly.
    fine = np.linspace(scores[0], scores[-1], per_step * (len(scores) - 1) // 2 + 1)
    return in_one(readings, weight, PchipInterpolator(scores, quantile, axis=1)(fine), ndtr(fine))


def between_nodes(log: Array, has_mass: Flags, table: Array, per_step: int) -> tuple[Array, Array]:
    """Weights (M,) and numbers (M, K) at nodes (...) and between them, of all that have weight.

    ln of the evidence (...) is interpolated by splines, numbers (..., K) by cubics without
    overshoot; a node without has those of the nearest that is.
    """
    if not has_mass.all():
        place = np.argwhere(has_mass)
        for i in np.argwhere(~has_mass):
            nearest = place[np.abs(place - i).sum(axis=1).argmin()]
            table[tuple(i)] = table[tuple(nearest)]
    log = np.maximum(log - log[has_mass].max(), -45.0)
    for d, n in enumerate(log.shape):
        if n > 1:
            fine = np.linspace(0, n - 1, per_step * (n - 1) + 1)
            log = make_interp_spline(np.arange(n), log, k=min(3, n - 1), axis=d)(fine)
            table = PchipInterpolator(np.arange(n), table, axis=d)(fine)
    log = log.ravel()
    heavy = log > log.max() - 18.0
    return np.exp(log[heavy] - log.max()), table.reshape(len(log), -1)[heavy]


def in_one(readings: Index, weight: Array, quantile: Array, p: Array) -> Spans:
    """Spans of the mixture of distributions of `weight` (M,) with quantiles (M, Q) at p (Q,)."""
    quantile = np.maximum.accumulate(quantile, axis=1)
    low, high, mass = quantile[:, :-1], quantile[:, 1:], weight[:, None] * np.diff(p)
    return Spans(readings, *(part.reshape(1, -1) for part in (low, high, mass)))
