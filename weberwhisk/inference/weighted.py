"""Weighted cells: moments, intervals and draws of posteriors, read off in one place.

A posterior is an even lattice of cells in the observer's coordinates, each with the ln of its
density. Between the cells ln of the density is interpolated by cubics, which is exact for a
Gaussian. Quantiles are those of *spans*, stretches of an unknown over which mass is spread evenly.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator, make_interp_spline
from scipy.special import ndtr

from .._util.values import Array, Flags, Index
from .._util.weights import half_error, resampled

__all__ = [
    "OVER", "Leaves", "Spans", "Sums", "between_nodes", "density_of_distance", "extrapolated",
    "in_one", "interpolate", "masses", "mixed", "spans_between",
]  # fmt: skip

#: Parts of a step between cells over which mass is spread evenly: of one lattice axis and of two.
#: The share of an sd by which a Gaussian's quantiles are so off is 1e-4 and 4e-4.
PARTS = 16, 4
#: Nats below the highest density beyond which cells have no say in the quantiles of angles.
DEPTH = 14.0
#: Proposals for each draw.
OVER = 4


class Leaves(NamedTuple):
    """The last cells of some readings, all of one step (U,): pairs sorted by reading.

    Rows (n,) of the readings, where the pairs of each begin (n,), and of each pair the place of the
    cell in steps (U, P) and ln of the density (P,).
    """

    step: Array
    rows: Index
    first: Index
    place: NDArray[np.int32]
    log: Array

    @property
    def owner(self) -> Index:
        """The number among `rows` of each pair, (P,)."""
        return np.repeat(np.arange(len(self.rows)), np.diff(self.first, append=len(self.log)))


class Spans(NamedTuple):
    """Of rows (n,) of readings: stretches of an unknown (n, K), and the mass in each."""

    rows: Index
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
        order = np.argsort(ends, axis=1)
        ends = np.take_along_axis(ends, order, axis=1)
        density = np.cumsum(np.take_along_axis(slope, order, axis=1), axis=1)[:, :-1]
        rise = np.zeros_like(ends)
        np.cumsum(np.maximum(density, 0.0) * np.diff(ends, axis=1), axis=1, out=rise[:, 1:])
        rise /= rise[:, -1:]
        return np.stack([np.interp(p, up, at) for up, at in zip(rise, ends, strict=True)])


class Sums:
    """Posteriors of `count` readings as weighted cells and their sums, NaN until there are any.

    Attributes
    ----------
    mean, sd : array, shape (B, U)
    error : array, shape (B,)
        Estimated error of means and sds, in sds; infinite where there is no sum.
    log_evidence : array, shape (B,)
    best : array, shape (B, U)
        The contact of the cell of highest density.
    log_slope : array, shape (B,)
        ln of the density of a reading over that of what cells take for it.
    """

    def __init__(self, count: int, unknowns: int, observer: Any, which: Index) -> None:
        self.observer, self.which = observer, which
        self.mean, self.sd, self.best = np.full((3, count, unknowns), np.nan)
        self.log_evidence, self.log_slope = np.full((2, count), np.nan)
        self.error, self._part = np.full(count, np.inf), np.full(count, -1)
        self._leaves: list[Leaves] = []

    def add(self, leaves: Leaves, contact: Array, log_slope: Array, smooth: bool) -> Array:
        """Sum over leaves in place of any that their readings had: by how much halves differ.

        With the contacts (U, P) of the cells.

        The error of the trapezoidal rule at a step h is that at 2h to the fourth power for a
        Gaussian, and to the second for an edge: the square of what sums over every other cell
        along one axis (U, n) differ by; that itself where the density has kinks. (Halves as on a
        chessboard see nothing of ridges oblique to both axes: 560 of 1025 errors were so missed.)
        """
        step, at, first, place, log = leaves
        owner, unknowns = leaves.owner, len(step)
        top = np.maximum.reduceat(log, first)
        weight = np.exp(log - top[owner])
        total = np.add.reduceat(weight, first)
        signs = 1.0 - 2.0 * (place & 1)
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
        self.log_evidence[at] = top + np.log(total) + np.log(step).sum() + log_slope
        self.log_slope[at] = log_slope
        highest = np.flatnonzero(log == top[owner])
        highest = highest[np.unique(owner[highest], return_index=True)[1]]
        self.best[at] = contact[:, highest].T
        self._part[at] = len(self._leaves)
        self._leaves.append(leaves)
        return each

    @property
    def bytes(self) -> int:
        """Memory of the cells."""
        return sum(leaves.place.nbytes + leaves.log.nbytes for leaves in self._leaves)

    def leaves(self, among: Flags | None = None) -> Iterator[Leaves]:
        """Leaves, but for those that were summed again, of readings `among` (B,) if given."""
        for i, leaves in enumerate(self._leaves):
            mine = self._part[leaves.rows] == i
            if among is not None:
                mine &= among[leaves.rows]
            if mine.all():
                yield leaves
            elif mine.any():
                counts = np.diff(leaves.first, append=len(leaves.log))
                some = np.repeat(mine, counts)
                first = np.append(0, np.cumsum(counts[mine])[:-1])
                yield Leaves(leaves.step, leaves.rows[mine], first, leaves.place[:, some],
                             leaves.log[some])  # fmt: skip

    # -- along one axis ----------------------------------------------------------------------------

    def marginals(
        self, among: Flags | None = None, within: Callable[[Leaves], Array] | None = None
    ) -> Iterator[tuple[Index, Array, float, Array]]:
        """ln of the density of the first coordinate at even places.

        For some rows (n,) at a time: the first place (n,), the step, and ln of the density (n, L),
        −inf where there is no cell; (n, L, K) by factors (K, P) of the cells, if any.
        """
        for leaves in self.leaves(among):
            step, place = leaves.step, leaves.place[0].astype(np.intp)
            low = np.minimum.reduceat(place, leaves.first)
            owner = leaves.owner
            place -= low[owner]
            count = int(place.max()) + 1
            top = np.maximum.reduceat(leaves.log, leaves.first)
            weight = np.exp(leaves.log - top[owner])
            index, size = owner * count + place, len(low) * count
            factors = np.ones((1, len(weight))) if within is None else within(leaves)
            mass = np.stack([np.bincount(index, weight * f, size) for f in factors], axis=-1)
            with np.errstate(divide="ignore"):
                log = np.log(mass.reshape(len(low), count, -1)) + top[:, None, None]
            log = log[..., 0] if within is None else log
            yield leaves.rows, (low + 0.5) * step[0], step[0], log + np.log(step[1:]).sum()

    def spans(self, unknown: int, stride: int = 1, among: Flags | None = None) -> Iterator[Spans]:
        """Spans of an unknown, for some readings at a time, `among` (B,) alone if given.

        At every second point with a stride of 2, at every fourth with one of 4.
        """
        if unknown == 0:
            for rows, start, step, log in self.marginals(among):
                x, log = interpolate(log, PARTS[0] // stride)
                value = self.observer.distance(start[:, None] + step * x, self.which[rows])
                yield spans_between(rows, value, log)
            return
        for leaves in self.leaves(among):
            # Some 4 million numbers at once.
            size = max(1, 500_000 * len(leaves.rows) // (PARTS[1] * len(leaves.log)))
            bounds = np.append(leaves.first, len(leaves.log))
            for begin in range(0, len(leaves.rows), size):
                end = min(begin + size, len(leaves.rows))
                pairs = slice(bounds[begin], bounds[end])
                some = Leaves(
                    leaves.step, leaves.rows[begin:end], bounds[begin:end] - bounds[begin],
                    leaves.place[:, pairs], leaves.log[pairs],
                )  # fmt: skip
                yield self._spans_of_angle(some, stride)

    def _spans_of_angle(self, leaves: Leaves, stride: int) -> Spans:
        """Spans of the second unknown, which depends on both coordinates: of finer cells."""
        step, n = leaves.step, len(leaves.rows)
        owner = leaves.owner
        top = np.maximum.reduceat(leaves.log, leaves.first)
        kept = leaves.log > (top - DEPTH)[owner]
        owner = owner[kept]
        place = leaves.place[:, kept].astype(np.intp)
        first = np.flatnonzero(np.diff(owner, prepend=-1))
        low = np.minimum.reduceat(place, first, axis=1)
        place -= low[:, owner]
        log = np.full((n, *(place.max(axis=1) + 1)), -np.inf)
        log[owner, place[0], place[1]] = leaves.log[kept]
        offsets = []
        for axis in (2, 1):
            log = np.moveaxis(log, axis, -1)
            shape = log.shape[:-1]
            x, fine = interpolate(log.reshape(-1, log.shape[-1]), PARTS[1] // stride)
            log = np.moveaxis(fine.reshape(*shape, -1), -1, axis)
            offsets.append(x)
        inside = log > (top - DEPTH)[:, None, None]
        row, i, j = np.nonzero(inside)
        x = np.stack([low[0, row] + 0.5 + offsets[1][i], low[1, row] + 0.5 + offsets[0][j]], axis=1)
        value = np.zeros(log.shape)
        value[row, i, j] = self.observer.contact_at(x * step, self.which[leaves.rows[row]])[:, 1]
        density = np.exp(log - top[:, None, None])
        return _of_cells(leaves.rows, inside, value, density)

    # -- draws -------------------------------------------------------------------------------------

    def proposals(self, count: int, rng: np.random.Generator, row: int) -> tuple[Array, Array]:
        """Coordinates (count, U) spread over the cells of one reading, and ln of their density.

        The density (count,) is up to a factor. Of cells of next to no density there are more than
        these have mass, as it may be higher elsewhere in them.
        """
        among = np.arange(len(self.error)) == row
        leaves = next(self.leaves(among))
        step, top = leaves.step, leaves.log.max()
        weight = np.exp(0.75 * (leaves.log - top))
        weight /= weight.sum()
        chosen = rng.choice(len(weight), count, p=weight)
        middle = leaves.place[:, chosen].T + 0.5
        x = (middle + rng.random(middle.shape) - 0.5) * step
        return x, np.log(weight[chosen]) - np.log(step).sum()

    def draws(self, count: int, rng: np.random.Generator, readings: Array) -> Array:
        """Draws (B, count, U) of the contact, given the readings (B, R)."""
        out = np.full((*self.mean.shape[:1], count, self.mean.shape[1]), np.nan)
        for row in np.flatnonzero(np.isfinite(self.log_evidence)):
            x, log_proposed = self.proposals(OVER * count, rng, int(row))
            log, contact = self.observer.observer.log_density_and_contact(x, readings[row])
            out[row] = contact[resampled(log - log_proposed, count, rng)]
        return out


def _of_cells(rows: Index, inside: Flags, value: Array, density: Array) -> Spans:
    """Spans of cells all of whose corners (n, I, J) are inside, from least to most value there."""
    n, i, j = inside.shape
    corners = [
        (slice(None), slice(a, i - 1 + a), slice(b, j - 1 + b))
        for a, b in product((0, 1), repeat=2)
    ]
    whole = np.logical_and.reduce([inside[c] for c in corners])
    ends = np.stack([value[c][whole] for c in corners])
    mass = sum(density[c][whole] for c in corners)
    # Cells of one reading side by side; slots that are left have no mass.
    counts = whole.sum(axis=(1, 2))
    owner = np.repeat(np.arange(n), counts)
    slot = np.arange(len(owner)) - np.repeat(np.cumsum(counts) - counts, counts)
    out = []
    for values in (ends.min(axis=0), ends.max(axis=0), mass):
        filled = np.zeros((n, int(counts.max())))
        filled[owner, slot] = values
        out.append(filled)
    return Spans(rows, *out)


def spans_between(rows: Index, value: Array, log: Array) -> Spans:
    """Spans between values (n, K) at which ln of the density is given, at even places."""
    return Spans(rows, value[:, :-1], value[:, 1:], masses(log))


def masses(log: Array) -> Array:
    """Masses (n, K − 1) between even places at which ln of the density is (n, K), unnormalised."""
    with np.errstate(invalid="ignore"):  # NaN where there is no density at all
        density = np.exp(log - log.max(axis=1, keepdims=True))
    return np.asarray((density[:, 1:] + density[:, :-1]) / 2)


def interpolate(log: Array, parts: int) -> tuple[Array, Array]:
    """Cubic interpolation of ln of densities (n, L) at even places, −inf where not known.

    Beyond what is known, for three steps to either side and in gaps, ln of the density goes on as
    a parabola that falls. Returns places (K,) in steps from the first, and values (n, K).
    """
    n, count = log.shape
    pad = np.full((n, count + 6), -np.inf)
    pad[:, 3:-3] = log
    for order in (range(3, count + 6), range(count + 2, -1, -1)):
        side = 1 if order[0] < order[-1] else -1
        for j in order:
            gap = ~np.isfinite(pad[:, j]) & np.isfinite(pad[:, j - side])
            if gap.any():
                a, b, c = (pad[gap, j - k * side] for k in (1, 2, 3))
                with np.errstate(invalid="ignore"):
                    on = np.minimum(3 * a - 3 * b + c, 2 * a - b)
                    pad[gap, j] = np.where(np.isfinite(on), np.minimum(on, a - 1), a - 8)
    pad = pad[:, 1:-1]
    unknown = ~np.isfinite(pad).any(axis=1)
    pad[unknown] = 0.0
    t = np.arange(parts) / parts
    cubic = np.stack(
        [-t * (t - 1) * (t - 2) / 6, (t + 1) * (t - 1) * (t - 2) / 2,
         -(t + 1) * t * (t - 2) / 2, (t + 1) * t * (t - 1) / 6]
    )  # fmt: skip
    m = pad.shape[1] - 3
    out = sum(pad[:, i : i + m, None] * cubic[i] for i in range(4))
    # Beside a cliff a cubic overshoots.
    ceiling = np.maximum(pad[:, 1 : 1 + m], pad[:, 2 : 2 + m]) + 0.5
    out = np.minimum(out, ceiling[..., None])
    out[unknown] = -np.inf
    return np.arange(m * parts) / parts - 1.0, out.reshape(n, -1)


def extrapolated(sums: Any, p: Array, unknown: int, stride: int = 1, *among: Any) -> Array:
    """Quantiles (B, Q) by spans, and by half as many: their error of second order is removed."""
    out = np.full((len(sums.error), len(p)), np.nan)
    both = sums.spans(unknown, stride, *among), sums.spans(unknown, 2 * stride, *among)
    for fine, coarse in zip(*both, strict=True):
        value = fine.quantiles(p)
        out[fine.rows] = value + (value - coarse.quantiles(p)) / 3
    return out


def density_of_distance(sums: Any, r: Array) -> Array:
    """Posterior density (B,) of the radial distance at r (B,), 1/m."""
    out = np.zeros(len(r))
    for spans in sums.spans(0):
        inside = (spans.low <= r[spans.rows, None]) & (r[spans.rows, None] < spans.high)
        width = np.where(inside, spans.high - spans.low, 1.0)
        out[spans.rows] = (inside * spans.mass / width).sum(axis=1) / spans.mass.sum(axis=1)
    return out


def mixed(
    rows: Index, log: Array, held: Flags, quantile: Array, scores: Array, parts: int
) -> Spans:
    """Spans of a mixture over nodes of conditional distributions, given their quantiles.

    Between nodes quantiles are interpolated: conditional distributions may have two modes.
    """
    weight, quantile = between_nodes(log, held, quantile, parts)
    # Between scores mass is all but that of a Gaussian, which is not spread evenly.
    fine = np.linspace(scores[0], scores[-1], parts * (len(scores) - 1) // 2 + 1)
    return in_one(rows, weight, PchipInterpolator(scores, quantile, axis=1)(fine), ndtr(fine))


def between_nodes(log: Array, held: Flags, table: Array, parts: int) -> tuple[Array, Array]:
    """Weights (M,) and numbers (M, K) at nodes (...) and between them, of all that have weight.

    ln of the evidence (...) is interpolated by splines, numbers (..., K) by cubics without
    overshoot; a node that is not held has those of the nearest that is.
    """
    if not held.all():
        place = np.argwhere(held)
        for i in np.argwhere(~held):
            nearest = place[np.abs(place - i).sum(axis=1).argmin()]
            table[tuple(i)] = table[tuple(nearest)]
    log = np.maximum(log - log[held].max(), -45.0)
    for d, n in enumerate(log.shape):
        if n > 1:
            fine = np.linspace(0, n - 1, parts * (n - 1) + 1)
            log = make_interp_spline(np.arange(n), log, k=min(3, n - 1), axis=d)(fine)
            table = PchipInterpolator(np.arange(n), table, axis=d)(fine)
    log = log.ravel()
    heavy = log > log.max() - 18.0
    return np.exp(log[heavy] - log.max()), table.reshape(len(log), -1)[heavy]


def in_one(rows: Index, weight: Array, quantile: Array, p: Array) -> Spans:
    """Spans of the mixture of distributions of `weight` (M,) with quantiles (M, Q) at p (Q,)."""
    quantile = np.maximum.accumulate(quantile, axis=1)
    low, high, mass = quantile[:, :-1], quantile[:, 1:], weight[:, None] * np.diff(p)
    return Spans(rows, *(part.reshape(1, -1) for part in (low, high, mass)))
