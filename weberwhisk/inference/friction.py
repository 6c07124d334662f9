"""Posteriors with an unknown friction, summed over rows of contacts of one distance each.

Friction turns the sign of a force, and noise that is in proportion to a force with it: tiles of
distance and deflection, with friction summed at each node, are many, and their sums dear. At one
distance two signals determine deflection and friction, and a rectangle of both is cut until no part
is longer than a few sd; parts are the same for all readings. Along distances evidence is smooth on
the scale of the JND at a known friction, and rows at even steps of that are summed by the trapezoid
rule. Every other row tells the error.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.polynomial import chebyshev, legendre
from scipy.interpolate import CubicSpline
from scipy.special import ndtr

from .._values import Array, Flags, Index
from ..mechanics.contact import Outcome
from .coordinates import leaps
from .marginals import logs, to_cells
from .observer import Observer
from .result import is_outside
from .rows import TouchRows, distances, highest
from .tiled import Moments
from .tiling import ORDER

#: Gauss and Legendre's nodes of a part, and their weights in either direction.
_X, _W = legendre.leggauss(ORDER)
_BOTH = np.log(np.outer(_W, _W).ravel() / 4)


class Leaves(NamedTuple):
    """Parts of rows that readings can be of.

    Which reading, which row and which part of it (n, 4), of each; its nodes' contacts (n, 36, 3);
    and ln of what they add to the evidence of the row (n, 36).
    """

    which: Index
    row: Index
    box: Array
    contact: Array
    log: Array


class FrictionRows(TouchRows):
    """Rows of contacts whose friction is unknown.

    There are too many contacts to keep. Of each row the signals are kept as polynomials of
    c = √(1 − share of the largest deflection), in which they are smooth up to the fold, and of the
    friction. The rectangle of both is cut in two, where the signals change most, until none changes
    by more than `LONGEST` sd, and parts that no reading can be of are left out; what remains is
    summed by 6 × 6 of Gauss and Legendre's nodes each.
    """

    #: The longest parts, in sd: 3e-6 of an evidence off, and 2e-4 at 7.5; pairs at a time.
    LONGEST, AT_ONCE = 5.5, 1000
    #: As of `leaves`; other touches may want what is far below one's highest.
    DEPTHS = 11.0, 40.0

    @property
    def first(self) -> float:
        """At a 500th of the reach: nearer to the base parts are without end, and in no domain."""
        return -2.52 if self.observer.reach[0] == 0 else -3.4

    def _lay(self, at_once: int = 48, *, across: int = 24, terms: int = 9) -> None:
        """Coefficients (rows, S + 1, across, terms) of signals over the angle, and of its range."""
        observer = self.observer
        prior = observer.prior[observer.unknowns[-1]]
        self.low = observer.angle_range(self.r)[0]
        ends = np.array(prior.support())
        self.ends = np.where(np.isfinite(ends), ends, prior.ppf(ndtr([-6.0, 6.0])))
        nodes = [np.cos(np.pi * (np.arange(k) + 0.5) / k) for k in (across, terms)]
        fits = [np.linalg.inv(chebyshev.chebvander(t, len(t) - 1)) for t in nodes]
        c, last = (nodes[0] + 1) / 2, self.value((nodes[1] + 1) / 2)
        width = self._widths(self.r, last)
        values = self._signals(self.r[:, None, None], width[:, None], c[:, None], last)
        self.known = np.asarray(np.isfinite(values).all(axis=(1, 2, 3)))
        values[~self.known] = 1.0
        self.parts = np.einsum("ic,jp,ncps->nsij", *fits, values, optimize=True)
        self.ranges = width @ fits[1].T
        share, weight = np.polynomial.legendre.leggauss(16)
        last = self.value((share + 1) / 2)
        held = self._widths(self.r, last)
        if "deflection_angle" in observer.prior:
            angle = observer.prior["deflection_angle"]
            low = self.low
            held = angle.cdf(low + held) - angle.cdf(low)
        self.held = held @ (weight * prior.pdf(last)) * (self.ends[1] - self.ends[0]) / 2
        leaping = [leaps(prior), *observer.space.leaps.values()]
        self.coarse = self._misfit() > 0.03 or any(a.size for a in leaping)

    def value(self, share: Array) -> Array:
        return self.ends[0] + (self.ends[1] - self.ends[0]) * share

    def _widths(self, r: Array, last: Array) -> Array:
        """Ranges (n, J) of the angle at distances (n,) and values (J,) of the unknown."""
        contact = np.ones((len(r), len(last), 3))
        contact[..., 0], contact[..., 2] = r[:, None], last
        return self.observer.space.angle_range(contact[..., 0], contact)[1]

    def _signals(self, r: Array, width: Array, c: Array, last: Array) -> Array:
        """Signals (..., S) over the angle, NaN where not held."""
        low = self.low
        theta = low + width * (1 - c**2)
        contact = np.stack(np.broadcast_arrays(r, theta, last), axis=-1)
        signals, outcome = self.observer.signals(contact)
        return np.where((outcome == Outcome.HELD)[..., None], signals, np.nan) / theta[..., None]

    def _misfit(self, count: int = 400) -> float:
        """How far off, in sd, the worst but one in twenty of contacts are."""
        rng = np.random.default_rng(20261123)
        row = rng.choice(np.flatnonzero(self.known), count)
        c, share = rng.uniform(0.02, 0.98, (2, count))
        found, contact = self.signals_in(row, np.column_stack([c, c, share, share]), np.zeros(1))
        off, held = self.off(contact[:, 0, :3], found[:, 0])
        return float(np.quantile(np.nan_to_num(off[held], nan=np.inf), 0.95))

    def off(self, contact: Array, found: Array) -> tuple[Array, Flags]:
        """How far off signals (..., S) found at contacts (..., 3) are, in sds; which are held."""
        exact, outcome = self.observer.signals(contact)
        held = outcome == Outcome.HELD
        low, high = self.observer.noise.interval(np.where(held[..., None], exact, 1.0), 0.5)
        found_low, found_high = self.observer.noise.interval(found, 0.5)
        with np.errstate(all="ignore"):
            off = np.abs(found_low + found_high - low - high) / 2 / (high - low)
        return off.max(axis=-1), held

    def signals_in(self, row: Index, box: Array, at: Array = _X) -> tuple[Array, Array]:
        """Signals (m, J², S) in parts (m, 4) of rows, at places −1 to 1 of either; contacts.

        With the contacts' measure, of dθ = 2 c width dc, (m, J², 4).
        """
        sides = [
            (box[:, [i]] + box[:, [i + 1]]) / 2 + (box[:, [i + 1]] - box[:, [i]]) / 2 * at
            for i in (0, 2)
        ]
        first, second = (
            chebyshev.chebvander(2 * side - 1, k - 1)
            for side, k in zip(sides, self.parts.shape[2:], strict=True)
        )
        encoded = first[:, None] @ (self.parts[row] @ second.swapaxes(1, 2)[:, None])
        encoded = np.moveaxis(encoded, 1, -1)
        width = (second @ self.ranges[row][:, :, None]).swapaxes(1, 2)
        contact = np.empty((*encoded.shape[:3], 4))
        contact[..., 0] = self.r[row][:, None, None]
        contact[..., 1] = self.low + width * (1 - sides[0][:, :, None] ** 2)
        contact[..., 2] = self.value(sides[1])[:, None]
        contact[..., 3] = 2 * sides[0][:, :, None] * width
        signals = encoded * contact[..., 1:2]
        flat = len(row), -1
        return signals.reshape(*flat, signals.shape[-1]), contact.reshape(*flat, 4)

    def leaves(
        self, reading: Array, rows: Index, log_step: Array, depths: tuple[float, float]
    ) -> Iterator[Leaves]:
        """What readings (B, R) can be of rows (n,), some rows at a time.

        But for what is so far below the highest of its row and, with ln of the rows' steps, of its
        reading, in ln.
        """
        size = max(1, self.AT_ONCE // len(reading))
        rows, top = rows[self.known[rows]], np.full((len(reading), len(self.r)), -np.inf)
        for start in range(0, len(rows), size):
            some = rows[start : start + size]
            yield from self._leaves(reading, some, log_step, depths, top)

    def _leaves(
        self,
        reading: Array,
        row: Index,
        log_step: Array,
        depths: tuple[float, float],
        top: Array,
        *,
        deepest: int = 60,
    ) -> Iterator[Leaves]:
        noise, prior = self.observer.noise, self.observer.prior
        # Pairs of a reading and a part.
        which, part = np.tile(np.arange(len(reading)), len(row)), np.arange(len(row))
        part = np.repeat(part, len(reading))
        box = np.tile([0.0, 1.0, 0.0, 1.0], (len(row), 1))
        corner = np.arange(ORDER**2).reshape(ORDER, ORDER)
        angle = prior.get("deflection_angle")
        last = prior[self.observer.unknowns[-1]]
        sharpest = [0.0 if p is None else highest(p) for p in (angle, last)]
        for depth in range(deepest):
            signals, contact = self.signals_in(row, box)
            low, high = noise.interval(signals, 6.0)
            low, high = low.min(axis=1), high.max(axis=1)
            room = 0.1 * (high - low)
            y = reading[which]
            some = np.all((y >= (low - room)[part]) & (y <= (high + room)[part]), axis=1)
            which, part = which[some], part[some]
            if not which.size:
                return
            used, part = np.unique(part, return_inverse=True)
            row, box, signals, contact = row[used], box[used], signals[used], contact[used]
            low, high = noise.interval(signals, 0.5)
            unit, middle = (high - low).min(axis=1), (low + high) / 2
            change = []
            square = middle.reshape(-1, ORDER, ORDER, middle.shape[-1])
            for i, ends in enumerate(((corner[0], corner[-1]), (corner[:, 0], corner[:, -1]))):
                turn = np.ptp(square, axis=i + 1).max(axis=1)
                with np.errstate(all="ignore"):
                    sds = np.nan_to_num(turn / unit, nan=0.0, posinf=1e9)
                own = contact[:, ends[1], i + 1] - contact[:, ends[0], i + 1]
                own = sharpest[i] * np.abs(own).max(axis=1)
                change.append(np.sqrt(np.square(sds).sum(axis=1) + own**2) / 0.93)
            along = change[0] >= change[1]
            done = np.maximum(*change) <= (self.LONGEST if depth < deepest - 1 else np.inf)
            side = box[:, [1, 3]] - box[:, [0, 2]]
            with np.errstate(divide="ignore"):
                log = np.log(side.prod(axis=1) * (self.ends[1] - self.ends[0]))[:, None] + _BOTH
                log = log + np.log(np.maximum(contact[..., 3], 0.0))
            log += last.logpdf(contact[..., 2])
            if angle is not None:
                log += angle.logpdf(contact[..., 1])
            # A bump is a square sd at least, and may lie between nodes: as high as signals allow.
            weight = (log - _BOTH).max(axis=1)[part] + log_step[row[part]]
            log = log[part] + noise.log_likelihood(reading[which, None], signals[part])
            high = (log - _BOTH).max(axis=1) + log_step[row[part]]
            least = high - np.log(np.maximum(change, 1.0)).sum(axis=0)[part] - 1.0
            most = high + 0.02 * np.square(change).sum(axis=0)[part]
            if noise.reads_signals:
                low, high = signals.min(axis=1), signals.max(axis=1)
                room = 0.1 * (high - low)
                nearest = np.clip(reading[which], (low - room)[part], (high + room)[part])
                most = np.minimum(
                    most, weight + noise.log_likelihood(reading[which], nearest) + 1.0
                )
            ended = done[part]
            np.maximum.at(top, (which, row[part]), least)
            least = top[which, row[part]] - depths[0]
            least = np.maximum(least, top.max(axis=1)[which] - depths[1])
            live = most > least
            pair = np.flatnonzero(ended & live)
            if pair.size:
                own = part[pair]
                yield Leaves(which[pair], row[own], box[own], contact[own, :, :3], log[pair])
            pair = np.flatnonzero(~ended & live)
            if not pair.size:
                return
            pieces = np.clip(np.ceil(np.maximum(*change) / self.LONGEST), 2, 4).astype(np.intp)
            pieces[done] = 0
            first = np.cumsum(pieces) - pieces
            count = pieces[part[pair]]
            piece = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
            part = np.repeat(first[part[pair]], count) + piece
            which = np.repeat(which[pair], count)
            parent = np.repeat(np.arange(len(row)), pieces)
            piece = np.arange(len(parent)) - first[parent]
            row, box, each = row[parent], box[parent], np.arange(len(parent))
            split = np.where(along, 0, 2)[parent]
            low = box[each, split]
            step = (box[each, split + 1] - low) / pieces[parent]
            box[each, split], box[each, split + 1] = low + piece * step, low + (piece + 1) * step

    def log_likelihood(self, reading: Array, rows: Index, stride: int = 1) -> Array:
        """ln p(reading | distance), (n, rows), of readings (n, R), all else integrated out.

        The same with any stride.
        """
        out = np.full((len(reading), len(self.r)), -np.inf)
        for found in self.leaves(reading, rows, self.log_step, self.DEPTHS):
            np.logaddexp.at(out, (found.which, found.row), _sum(found.log)[0])
        with np.errstate(divide="ignore"):
            out = out[:, rows] - np.log(self.held[rows])
        return np.nan_to_num(out, nan=-np.inf, neginf=-np.inf)

    def hidden(self, reading: Array, rows: Index) -> Array:
        """Nothing: parts are cut until none lies between nodes."""
        return np.full((len(reading), len(rows)), -np.inf)

    def best_contacts(self, reading: Array, row: int) -> tuple[Array, bool]:
        """The most probable contacts (n, U) at one distance; if any is 5 sd from its reading."""
        contact, known = _best(
            _joined(self.leaves(reading, np.array([row]), self.log_step, self.DEPTHS)), len(reading)
        )
        if not known.all():
            return contact[:0], True
        signals = self.observer.signals(contact)[0]
        return contact, bool(is_outside(self.observer.noise, reading, signals).any())


@lru_cache(maxsize=8)
def friction_rows(observer: Observer) -> FrictionRows:
    """The rows of an observer, kept with it."""
    return FrictionRows(observer)


def _sum(log: Array) -> tuple[Array, Array]:
    """ln of the sums of exp of rows (n, m), and the shares of each."""
    top = log.max(axis=1)
    top = np.where(np.isfinite(top), top, -1e300)
    share = np.exp(log - top[:, None])
    total = share.sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        return top + np.log(total), np.nan_to_num(share / total[:, None])


def _joined(found: Iterable[Leaves]) -> Leaves:
    none, size = np.empty(0, dtype=np.intp), ORDER**2
    parts = [Leaves(none, none, np.empty((0, 4)), np.empty((0, size, 3)), np.empty((0, size)))]
    return Leaves(*(np.concatenate(column) for column in zip(*parts, *found, strict=True)))


def _best(found: Leaves, count: int) -> tuple[Array, Flags]:
    """The contact of the highest node of each reading, (B, 3), and whether it has any."""
    top = found.log.max(axis=1, initial=-np.inf)
    order = np.lexsort((-top, found.which))
    which, first = np.unique(found.which[order], return_index=True)
    pair = order[first]
    out, known = np.ones((count, 3)), np.zeros(count, dtype=bool)
    out[which] = found.contact[pair, found.log[pair].argmax(axis=1)]
    known[which] = np.isfinite(top[pair])
    return out, known


def _chosen(which: Index, weight: Array, count: int, number: int, rng: Any) -> tuple[Index, Index]:
    """Parts and nodes (B, number) of readings, one from each stratum of weights (n, 36)."""
    order = np.argsort(which, kind="stable")
    rise = np.cumsum(weight[order])
    ends = np.searchsorted(which[order], np.arange(count + 1)) * weight.shape[1]
    below = np.append(0.0, rise)[ends]
    share = (np.arange(number) + rng.random((count, number))) / number
    at = np.searchsorted(rise, below[:-1, None] + share * np.diff(below)[:, None], side="right")
    at = np.clip(at, ends[:-1, None], np.maximum(ends[1:, None] - 1, 0))
    return order[at // weight.shape[1]], at % weight.shape[1]


class FrictionSums:
    """The posteriors of readings (B, R), summed over rows.

    Parameters
    ----------
    grid : FrictionRows
    reading : array, shape (B, R)
    wanted : float
        Error of mean and sd asked for, in sds.

    Attributes
    ----------
    rows : array of int
        Readings that are served; moments, errors, quantiles and draws are of those.
    moments : Moments
    error : array, shape (b, 3)
    """

    count = 1
    #: As of `leaves`: at k = 0.3 means are 1e-4 sd off.
    DEPTHS = 7.0, 11.0
    #: Readings that are worked on together; every so many rows at first.
    together, coarsest = 16, 4

    def __init__(self, grid: FrictionRows, reading: Array, wanted: float) -> None:
        self.grid, self.observer, self.reading = grid, grid.observer, reading
        self.log_step = grid.log_step
        if (prior := self.observer.prior.get("radial_distance")) is not None:
            with np.errstate(divide="ignore"):
                self.log_step = self.log_step + prior.logpdf(grid.r)
        count = len(reading)
        #: Every so many rows are summed, of each reading; ln of the mass of rows (B, n).
        self.stride = np.full(count, self.coarsest)
        self.log = np.full((count, len(grid.r)), -np.inf)
        mean, sd, error, contact = np.full((4, count, 3), np.nan)
        share, misfit = np.zeros(count), np.full(count, np.nan)
        held = np.zeros(count, dtype=bool)
        rng = np.random.default_rng(20261123)
        for start in range(0, count, self.together):
            some = np.arange(start, min(start + self.together, count))
            found, weight = self._refined(some, wanted)
            mean[some], sd[some], error[some] = self._sums(some, found, weight)
            contact[some], held[some] = _best(found, len(some))
            nodes = weight[:, None] * _sum(found.log)[1]
            np.maximum.at(share, some[found.which], nodes.max(axis=1))
            if not held[some].any():
                continue
            pair, node = _chosen(found.which, nodes, len(some), 24, rng)
            used, of = np.unique(pair, return_inverse=True)
            signals, _ = grid.signals_in(found.row[used], found.box[used])
            signals = signals[of.reshape(node.shape), node]
            off, _ = grid.off(found.contact[pair, node], signals)
            misfit[some] = np.where(held[some], off.mean(axis=1), np.nan)
        top = self.log.max(axis=1)
        live = self.log > top[:, None] - 20
        #: The first and the last row (B,) that count, and a step more.
        self.first = np.maximum(live.argmax(axis=1) - self.stride, 0)
        self.last = len(grid.r) - 1 - live[:, ::-1].argmax(axis=1) + self.stride
        signals = np.nan_to_num(self.observer.signals(contact)[0], nan=1.0)
        low, high = self.observer.noise.interval(signals, 4.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            mass = np.exp(self.log - np.where(np.isfinite(top), top, 0.0)[:, None]).sum(axis=1)
            log_evidence = top + np.log(mass * self.stride)
            # What is nearer to the base than all rows; density falls towards it.
            beyond = self.log[:, 0] - self.log_step[0] + np.log(grid.r[0] - self.observer.reach[0])
            error += np.exp(beyond - log_evidence)[:, None]
            served = held & (error + misfit[:, None] / 2 <= wanted).all(axis=1)
        served &= ((low <= reading) & (reading <= high)).all(axis=1)
        for row in np.flatnonzero(~grid.known):  # whose contacts are lost
            served &= (row < self.first) | (row > self.last)
        self.rows, self.error = np.flatnonzero(served), error[served]
        none = np.zeros(count)
        columns = mean, sd, log_evidence, share, contact, signals, none, misfit
        self.moments = Moments(*(column[served] for column in columns))

    def _refined(self, some: Index, wanted: float) -> tuple[Leaves, Array]:
        """The parts of readings, and the shares of the mass on them, (n,).

        Of rows closer and closer, where every other one says otherwise.
        """
        grid, size = self.grid, len(self.grid.r)
        rows = np.arange(0, size, self.coarsest)
        found = _joined(grid.leaves(self.reading[some], rows, self.log_step, self.DEPTHS))
        left = np.arange(len(some))
        while True:
            weight, log = self._weight(some, found)
            error = self._sums(some, found, weight)[2][left]
            precise = (error <= wanted / 10).all(axis=1)
            left = left[~precise & (self.stride[some[left]] > 1)]
            if not left.size:
                np.logaddexp.at(self.log, (some[found.which], found.row), log)
                return found, weight
            stride = int(self.stride[some[left[0]]])
            rows = np.arange(stride // 2, size, stride)
            live = found.row[np.isin(found.which, left) & (weight > 1e-9)]
            if live.size:
                rows = rows[(rows > live.min() - 2 * stride) & (rows < live.max() + 2 * stride)]
            self.stride[some[left]] //= 2
            more = grid.leaves(self.reading[some[left]], rows, self.log_step, self.DEPTHS)
            found = _joined([found, *(m._replace(which=left[m.which]) for m in more)])

    def _weight(self, some: Index, found: Leaves) -> tuple[Array, Array]:
        """Shares of the mass of readings on parts (n,), and ln of the mass, but for the stride."""
        log = _sum(found.log)[0] + self.log_step[found.row]
        top = np.full(len(some), -np.inf)
        np.maximum.at(top, found.which, log)
        top = np.where(np.isfinite(top), top, 0.0)
        weight = np.exp(log - top[found.which])
        total = np.bincount(found.which, weight, len(some))
        return weight / np.where(total > 0, total, 1.0)[found.which], log

    def _sums(self, some: Index, found: Leaves, weight: Array) -> tuple[Array, Array, Array]:
        """Means, sds and errors (b, 3) of readings; errors in sds, by every other row."""
        share = _sum(found.log)[1]
        middle = np.einsum("nk,nku->nu", share, found.contact)
        spread = np.einsum("nk,nku->nu", share, (found.contact - middle[:, None]) ** 2)

        def moments(weight: Array) -> tuple[Array, Array]:
            def total(column: Array) -> Array:
                return np.bincount(found.which, weight * column, len(some)).astype(np.float64)

            with np.errstate(invalid="ignore", divide="ignore"):
                whole = total(np.ones(len(weight)))
                mean = np.stack([total(column) / whole for column in middle.T], axis=1)
                square = spread + (middle - mean[found.which]) ** 2
                sd = np.sqrt(np.stack([total(column) / whole for column in square.T], axis=1))
            return mean, sd

        mean, sd = moments(weight)
        error = np.zeros_like(sd)
        side = found.row // self.stride[some][found.which] % 2
        with np.errstate(invalid="ignore", divide="ignore"):
            for half in (0, 1):
                other, width = moments(weight * (side == half))
                off = np.maximum(np.abs(other - mean) / sd, np.abs(width / sd - 1))
                error = np.maximum(error, np.nan_to_num(off, nan=np.inf))
        # What every other row changes falls as the square root of what all leave, and faster.
        return mean, sd, np.where(error < 0.1, error**1.5, error) + 2e-4

    def _again(self) -> Iterator[tuple[Index, Leaves, Array]]:
        """Some of the readings that are served, as places (b,) among them; as of `_refined`."""
        for stride in np.unique(self.stride[self.rows]):
            place = np.flatnonzero(self.stride[self.rows] == stride)
            place = place[np.argsort(self.first[self.rows[place]])]
            for at in np.array_split(place, -(-len(place) // self.together)):
                some = self.rows[at]
                rows = np.arange(0, len(self.grid.r), stride)
                inside = (rows >= self.first[some].min()) & (rows <= self.last[some].max())
                found = _joined(
                    self.grid.leaves(self.reading[some], rows[inside], self.log_step, self.DEPTHS)
                )
                yield at, found, self._weight(some, found)[0]

    def quantiles(self, p: Array, unknown: int) -> tuple[Array, Array]:
        """Quantiles (b, Q), and their errors: by every other row."""
        out, other = np.empty((2, len(self.rows), len(p)))
        if unknown:
            for at, found, weight in self._again():
                side = found.row // self.stride[self.rows[at]][found.which] % 2
                for into, share in ((out, weight), (other, weight * (side == 0))):
                    for i, (edges, rise) in zip(at, self._rise(found, share, unknown), strict=True):
                        into[i] = np.interp(p, rise, edges)
        else:
            for i, row in enumerate(self.rows):
                out[i], other[i] = (self._distances(row, k)(p) for k in (1, 2))
        sd = self.moments.sd[:, unknown, None]
        off = np.abs(out - other) / sd
        return out, (np.where(off < 0.1, off**1.5, off) + self.error[:, unknown, None]) * sd

    def _distances(self, row: int, step: int, *, finer: int = 16) -> Callable[[Array], Array]:
        """Distances at probabilities, by a spline through ln of the mass of every so many rows."""
        stride = step * int(self.stride[row])
        log = self.log[row, ::stride]
        log = np.maximum(log - log.max(), -40.0)
        place = np.arange(len(log) * finer - finer + 1) / finer
        mass = np.exp(CubicSpline(np.arange(len(log)), log)(place))
        rise = np.append(0.0, np.cumsum(mass[1:] + mass[:-1]))
        r = distances(
            self.observer,
            np.interp(place * stride, np.arange(len(self.grid.x)), self.grid.x),
        )[0]
        return lambda p: np.interp(p, rise / rise[-1], r)

    def _rise(
        self, found: Leaves, weight: Array, unknown: int, *, cells: int = 12, bins: int = 1024
    ) -> Iterator[tuple[Array, Array]]:
        """Of one reading after the other: edges (n,) of an unknown, and its mass below them.

        Lines of nodes are cut into cells, and each is counted where its middle is.
        """
        square = -1, ORDER, ORDER
        share, value = (
            _sum(found.log)[1].reshape(square),
            found.contact[..., unknown].reshape(square),
        )
        if unknown == 1:  # along c
            share, value = share.swapaxes(1, 2), value.swapaxes(1, 2)
        finer = to_cells(cells)
        log, _ = logs(share)
        mass = np.exp(np.minimum(log @ finer.T, 30.0))
        mass *= (weight / mass.sum(axis=(1, 2)))[:, None, None]
        value = value @ finer.T
        for i in range(found.which.max(initial=-1) + 1):
            some = (found.which == i) & (weight > 1e-9)
            own, at = mass[some].ravel(), value[some].ravel()
            edges = np.linspace(at.min(), at.max(), bins + 1)
            counted = np.histogram(at, edges, weights=own)[0]
            yield edges, np.append(0.0, np.cumsum(counted)) / counted.sum()

    def draws(self, count: int, rng: np.random.Generator, *, more: int = 16) -> Array:
        """Contacts (b, count, 3) drawn from the posteriors.

        Nodes, moved evenly within the part of their row that is theirs, and along the rows; of many
        more than asked for, drawn again as likely as the posterior there is over that of the nodes.
        """
        grid, observer = self.grid, self.observer
        out = np.empty((len(self.rows), count, 3))
        edges, index = np.append(0.0, np.cumsum(_W) / 2), np.arange(len(grid.r))
        prior = observer.prior[observer.unknowns[-1]]
        for at, found, weight in self._again():
            some = self.rows[at]
            nodes = weight[:, None] * _sum(found.log)[1]
            pair, node = _chosen(found.which, nodes, len(some), more * count, rng)
            box, row = found.box[pair], found.row[pair]
            side = [box[..., 1] - box[..., 0], box[..., 3] - box[..., 2]]
            which = node // ORDER, node % ORDER
            c, share = (
                box[..., 2 * k] + side[k] * (edges[i] + _W[i] / 2 * rng.random(node.shape))
                for k, i in enumerate(which)
            )
            contact = np.stack([grid.r[row], c, grid.value(share)], axis=-1)
            width = observer.space.angle_range(contact[..., 0], contact)[1]
            contact[..., 1] = grid.low + width * (1 - c**2)
            # ln of the density of nodes over distance, x₂ and the friction's coordinate.
            log = np.log(nodes[pair, node]) - np.log(side[0] * side[1])
            log -= np.log(_W[which[0]] * _W[which[1]] * 2 * c * width)
            x = observer.coordinates(contact)
            log += observer.space.constrain(x)[1] - distances(observer, x[..., 0])[1]
            log -= 0.5 * x[..., 2] ** 2 + prior.logpdf(contact[..., 2])
            stride = self.stride[some][:, None]
            place = row + stride * (rng.random(node.shape) - 0.5)
            x[..., 0] = np.interp(place, index, grid.x)
            log -= np.log(np.interp(place, index, grid.step))
            log = observer.log_density(x, self.reading[some][:, None]) - log
            weight = np.exp(log - log.max(axis=1, keepdims=True))
            kept, _ = _chosen(
                np.repeat(np.arange(len(some)), more * count),
                weight.reshape(-1, 1),
                len(some),
                count,
                rng,
            )
            kept = rng.permuted(kept - np.arange(len(some))[:, None] * more * count, axis=1)
            out[at] = np.take_along_axis(observer.contact(x)[0], kept[..., None], axis=1)
        return out
