"""The contacts of an observer in rows of one distance each: what many touches are summed over.

Along them no step is longer than 0.28 JND; across, the deflections lie at even steps of what a
reading tells of them, about 0.6 sd: at 0.75 sd single touches were up to 4e-6 sd off at k = 0.1.
"""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
from scipy import ndimage
from scipy.interpolate import CubicSpline, PchipInterpolator

from .._values import Array, Index
from ..mechanics.contact import Outcome
from .coordinates import constrain_angle, constrain_distance, unconstrain_angle
from .observer import Observer
from .result import is_outside


def distances(observer: Observer, x: Array) -> tuple[Array, Array]:
    """r (n,) at their coordinates x, and ln dr/dx."""
    low, high = observer.reach
    fraction, log_slope = constrain_distance(x)
    return low + (high - low) * fraction, log_slope + np.log(high - low)


def highest(prior: Any) -> float:
    """One over the sd of a normal distribution as high as this one."""
    return float(np.sqrt(2 * np.pi) * prior.pdf(prior.ppf(np.linspace(0.02, 0.98, 49))).max())


class TouchRows:
    """The contacts of an observer in rows of one distance each, one row after the other."""

    #: Steps along, in JNDs, and across, in sd; most nodes in all; sd within which a node matters.
    ALONG, ACROSS, MOST, WINDOW = 0.28, 0.6, 4_000_000, 7.5

    def __init__(self, observer: Observer) -> None:
        self.observer = observer
        #: Coordinates of the rows' distances, and the steps between them.
        self.x, self.step = self._along()
        self.r, log_rate = distances(observer, self.x)
        #: ln of the steps in m.
        self.log_step = log_rate + np.log(self.step)
        self._lay()
        with np.errstate(divide="ignore"):
            self.log_held = np.log(self.held) + log_rate
            self.log_prior = self.log_held
            if (prior := observer.prior.get("radial_distance")) is not None:
                ends, _ = distances(observer, (self.x[1:] + self.x[:-1]) / 2)
                share = np.diff(prior.cdf(ends), prepend=0.0, append=1.0)
                self.log_prior = self.log_held + np.log(share / np.gradient(self.r))

    @property
    def first(self) -> float:
        """Coordinate of the first row's distance: at the base."""
        return -3.4

    def contacts(self, r: Array, y: Array) -> tuple[Array, Array, Array]:
        """Contacts (n, D, U) at distances (n,) and angles' coordinates (n, D); ln dθ/dy."""
        low, width = self.observer.angle_range(r)
        fraction, log_slope = constrain_angle(y)
        theta = low + width[:, None] * fraction
        contact = np.stack([np.broadcast_to(r[:, None], theta.shape), theta], axis=-1)
        with np.errstate(divide="ignore"):
            return contact[..., : self.observer.bounded], log_slope + np.log(width)[:, None], theta

    def _along(self) -> tuple[Array, Array]:
        """Coordinates of the rows' distances, and the steps between them."""
        ends = np.linspace(self.first, 4.0, 75)
        r, log_rate = distances(self.observer, ends)
        jnd = np.full(len(ends), np.inf)
        further = [self.observer.prior[n] for n in self.observer.unknowns[self.observer.bounded :]]
        for depth, share in product((-3.0, -1.0, 0.0, 0.5, 1.0), (0.02, 0.5, 0.98)):
            if not further and share != 0.5:
                continue
            contact = self.contacts(r, np.full((len(r), 1), depth))[0][:, 0]
            rest = [np.full((len(r), 1), prior.ppf(share)) for prior in further]
            with np.errstate(all="ignore"):  # at the tip itself no deflection may be left
                fisher = self.observer.information(np.concatenate([contact, *rest], axis=1))
            fisher = fisher[:, : self.observer.bounded, : self.observer.bounded]
            known = np.asarray(np.isfinite(fisher).all(axis=(1, 2)))
            with np.errstate(all="ignore"):
                own = np.sqrt(np.linalg.pinv(np.where(known[:, None, None], fisher, 0.0))[:, 0, 0])
            jnd = np.fmin(jnd, np.where(known, own, np.inf))
        rate = np.clip(np.exp(log_rate) / np.maximum(jnd, 1e-12) / self.ALONG, 4.0, 400.0)
        rate = np.exp(ndimage.gaussian_filter1d(np.log(rate), 1.5, mode="nearest"))
        rise = np.append(0.0, np.cumsum((rate[1:] + rate[:-1]) / 2 * np.diff(ends)))
        x, count = PchipInterpolator(rise, ends), int(rise[-1]) + 2
        place = np.linspace(0, rise[-1], count)
        return x(place), x(place, 1) * rise[-1] / (count - 1)

    def _lay(self, at_once: int = 48) -> None:
        """The nodes' angles, signals and ln of weights, and where each row of them starts."""
        observer, n = self.observer, len(self.x)
        #: The prior of what is held at each distance.
        self.held = observer.angles_held(self.r)
        count, self.coarse = np.ones(n, dtype=np.intp), False
        if several := observer.bounded > 1:
            across = _Across(self)
            count = (across.whole / self.ACROSS).astype(np.intp) + 2
            thinned = max(count.sum() / self.MOST, 1.0)
            # Steps of 1.35 sd sum a Gaussian to 4e-5; three signals at k = 0.03, to 4e-4 of an sd.
            self.coarse = thinned * self.ACROSS > 1.35
            count = (count / thinned).astype(np.intp) + 2
        self.start = np.append(0, np.cumsum(count))
        self.theta, self.weight = np.zeros((2, self.start[-1]))
        low, width = observer.angle_range(self.r)
        prior = observer.prior.get("deflection_angle")
        rough = []
        for first in range(0, n, at_once):
            rows = np.arange(first, min(first + at_once, n))
            begin, stop = self.start[[rows[0], rows[-1] + 1]]
            row = np.repeat(rows, count[rows])
            theta, weight = self.theta[begin:stop], self.weight[begin:stop]
            if several:
                y, log_step = across(rows, count[rows])
                fraction, log_across = constrain_angle(y)
                theta[:] = low + width[row] * fraction
                weight[:] = log_across + log_step
            if several and prior is not None:
                weight += prior.logpdf(theta)
                if observer.space.leaps["deflection_angle"].size:  # which the rule does not see
                    middle = (theta[1:] + theta[:-1]) / 2
                    same = row[1:] == row[:-1]
                    above = np.append(
                        np.where(same, middle, low + width[row[:-1]]), low + width[rows[-1]]
                    )
                    below = np.append(low, np.where(same, middle, low))
                    with np.errstate(divide="ignore"):
                        weight[:] = np.log(prior.cdf(above) - prior.cdf(below))
            place = np.stack([self.r[row], theta], axis=-1)[:, : observer.bounded]
            signals, outcome = observer.signals(place)
            held = outcome == Outcome.HELD
            weight[~held] = -np.inf
            at = self.start[rows] - begin
            top = np.maximum.reduceat(weight, at)
            top = np.where(np.isfinite(top), top, 0.0)
            whole = np.add.reduceat(np.exp(weight - np.repeat(top, count[rows])), at)
            weight -= np.repeat(top + np.log(np.where(whole > 0, whole, 1.0)), count[rows])
            if not first:
                # In C's order, or each `take` would copy the whole of it first.
                self.signals = np.empty((len(self.theta), signals.shape[-1]))
            self.signals[begin:stop] = np.where(held[:, None], signals, 1.0)
            mean, sd = observer.noise.mean(signals), observer.noise.sd(signals)
            far = np.abs(np.diff(mean, axis=0)) > 2.5 * self.ACROSS * np.maximum(sd[1:], sd[:-1])
            node, which = np.nonzero(far & (row[1:] == row[:-1])[:, None])
            rough.append([node + begin, which])
        #: Nodes from which it is far to the next of their row, and by which number of a reading.
        self.rough = np.concatenate(rough, axis=1)
        self._sort()

    def hidden(self, reading: Array, rows: Index) -> Array:
        """ln of the most that likelihoods (n, rows) may miss between nodes.

        About a signal's zero, where its noise is none, Weber's law asks for nodes without end: the
        likelihood of a reading (n, R) so near it is a peak of that number alone, as high as the
        other numbers have it, between two nodes.
        """
        out = np.full((len(rows), len(reading)), -np.inf)
        first, past = np.searchsorted(self.rough[0], self.start[[rows[0], rows[-1] + 1]])
        node, which = self.rough[:, first:past]
        row = np.searchsorted(self.start, node, side="right") - 1
        at = np.minimum(np.searchsorted(rows, row), len(rows) - 1)
        some = rows[at] == row
        node, which, at = node[some], which[some], at[some]
        both, each = node[:, None] + [0, 1], (np.arange(len(node)), slice(None), which)
        noise, signals = self.observer.noise, self.signals[both]
        ends, sd = noise.mean(signals)[each], noise.sd(signals)[each]
        low, high = ends.min(axis=1), ends.max(axis=1)
        touch, i = np.nonzero((reading[:, which] >= low) & (reading[:, which] <= high))
        as_read = np.repeat(reading[touch][:, None], 2, axis=1)
        as_read[np.arange(len(i)), :, which[i]] = ends[i]
        log = noise.log_likelihood(as_read, signals[i]) + self.weight[both[i]] + np.log(sd[i])
        peak = log.max(axis=1) + 0.5 * np.log(2 * np.pi) - np.log(high - low)[i]
        np.logaddexp.at(out, (at[i], touch), peak)
        return out.T

    def _sort(self, bins: int = 512) -> None:
        """Between which nodes of a row readings can be, known by what bins they lie in."""
        noise, held = self.observer.noise, np.isfinite(self.weight)
        some = self.signals[held][:: max(int(held.sum()) // 50_000, 1)]
        ends = np.concatenate(noise.interval(some, self.WINDOW))
        self._between = np.quantile(ends, np.linspace(0.0, 1.0, bins), axis=0).T
        shape = (len(self._between), bins + 1, len(self.x))
        self._first, self._last = np.empty((2, *shape), dtype=np.int32)
        for i, (begin, stop) in enumerate(zip(self.start[:-1], self.start[1:], strict=True)):
            low, high = noise.interval(self.signals[begin:stop], self.WINDOW)
            off = ~held[begin:stop]
            low[off], high[off] = np.inf, -np.inf
            # Made monotone: what follows on nodes is known by the first of them.
            high = np.maximum.accumulate(high, axis=0)
            low = np.minimum.accumulate(low[::-1], axis=0)[::-1]
            for k, ends in enumerate(self._between):
                self._first[k, 0, i], self._last[k, -1, i] = 0, stop - begin
                self._first[k, 1:, i] = np.searchsorted(high[:, k], ends)
                self._last[k, :-1, i] = np.searchsorted(low[:, k], ends, side="right")

    def best_contacts(self, reading: Array, row: int) -> tuple[Array, bool]:
        """The most probable contacts (n, U) at one distance; if any is 5 sd from its reading."""
        nodes, begin, which, log = self._weighed(reading, np.array([row]), 1)
        if len(which) < len(reading):  # beyond the window of all nodes
            return np.empty((0, self.observer.bounded)), True
        ends = np.append(begin[1:], len(log))
        best = nodes[[a + log[a:b].argmax() for a, b in zip(begin, ends, strict=True)]]
        far = is_outside(self.observer.noise, reading, self.signals[best]).any()
        contact = np.stack([np.full(len(best), self.r[row]), self.theta[best]], axis=-1)
        return contact[:, : self.observer.bounded], bool(far)

    def _weighed(
        self, reading: Array, rows: Index, stride: int
    ) -> tuple[Index, Index, Index, Array]:
        """Nodes that readings (n, R) can be of, row after row and reading after reading.

        With them where those of a pair begin, which pair each is, and ln of their likelihoods and
        weights.
        """
        first = np.zeros((len(rows), len(reading)), dtype=np.intp)
        last = np.broadcast_to(np.diff(self.start)[rows][:, None], first.shape).copy()
        for k, y in enumerate(reading.T):
            at = np.searchsorted(self._between[k], y)[None, :], rows[:, None]
            np.maximum(first, self._first[k][at], out=first)
            np.minimum(last, self._last[k][at], out=last)
        pair = np.flatnonzero((last > first).ravel())
        row, which = np.divmod(pair, len(reading))
        count = ((last - first).ravel()[pair] + stride - 1) // stride
        begin = np.cumsum(count) - count
        nodes = np.repeat(self.start[rows[row]] + first.ravel()[pair] - begin * stride, count)
        nodes += stride * np.arange(len(nodes))
        y = np.repeat(reading[which], count, axis=0)
        log = self.observer.noise.log_likelihood(y, self.signals.take(nodes, axis=0))
        log += self.weight.take(nodes)
        return nodes, begin, pair, log

    def log_likelihood(self, reading: Array, rows: Index, stride: int = 1) -> Array:
        """ln p(reading | distance), (n, rows), of readings (n, R), deflections integrated out.

        By every so many of the nodes.
        """
        out = np.full(len(rows) * len(reading), -np.inf)
        _, begin, pair, log = self._weighed(reading, rows, stride)
        if pair.size:
            top = np.maximum.reduceat(log, begin)
            count = np.diff(np.append(begin, len(log)))
            log -= np.repeat(np.where(np.isfinite(top), top, 0.0), count)
            with np.errstate(divide="ignore"):
                out[pair] = top + np.log(np.add.reduceat(np.exp(log), begin) * stride)
        out = np.nan_to_num(out, nan=-np.inf, neginf=-np.inf)
        return out.reshape(len(rows), len(reading)).T


class _Across:
    """Angles' coordinates at even steps of what a reading tells of them, along rows of a grid.

    Even steps of the coordinate miss bumps where signals hardly change with the angle but in a
    part of its range: ten touches 5 mm from the base were 4 sd off at k = 0.03. The trapezoid rule
    asks that steps change smoothly.
    """

    def __init__(self, grid: TouchRows, *, samples: int = 129, fine: int = 4) -> None:
        observer = grid.observer
        self.start, self.stop = unconstrain_angle(np.array([1e-6, 1 - 1e-8]))
        #: Coordinates of each row at even shares of the way, and their slopes.
        s = np.linspace(0.0, 1.0, fine * (samples - 1) + 1)
        self.y = np.tile(self.start + (self.stop - self.start) * s, (len(grid.r), 1))
        self.slope = np.full(self.y.shape, self.stop - self.start)
        s, y, slope = np.linspace(0.0, 1.0, samples), self.y[:, ::fine], self.slope[:, ::fine]
        contact, log_slope, _ = grid.contacts(grid.r, y)
        signals, outcome = observer.signals(contact)
        signals = np.where((outcome == Outcome.HELD)[..., None], signals, np.nan)
        rise = np.gradient(signals, s, axis=1)
        with np.errstate(all="ignore"):
            inner = observer.noise.fisher(np.nan_to_num(signals, nan=1.0))
            rate = np.sqrt(np.einsum("nsi,nsij,nsj->ns", rise, inner, rise))
        rate = np.nan_to_num(rate, nan=0.0, posinf=0.0)
        rate = ndimage.maximum_filter1d(rate, 3, axis=1)
        # A third of an sd of the range itself, which is summed too.
        rate = np.hypot(rate, 3.0 * slope)
        if (prior := observer.prior.get("deflection_angle")) is not None:
            rate = np.hypot(rate, highest(prior) * np.exp(log_slope) * slope)
        smooth = ndimage.gaussian_filter1d(np.log(rate), 2.0, axis=1, mode="nearest")
        log_rate = CubicSpline(s, smooth, axis=1)
        s = np.linspace(0.0, 1.0, fine * (samples - 1) + 1)
        self.density = np.exp(log_rate(s))
        turn, h = self.density * log_rate(s, 1), s[1]
        part = h / 2 * (self.density[:, 1:] + self.density[:, :-1])
        part += h**2 / 12 * (turn[:, :-1] - turn[:, 1:])
        self.rise = np.column_stack([np.zeros(len(part)), np.cumsum(part, axis=1)])
        self.whole = self.rise[:, -1]

    def __call__(self, rows: Index, count: Index) -> tuple[Array, Array]:
        """Coordinates of so many nodes in each of these rows, and ln of their steps."""
        last = self.rise.shape[1] - 1
        row = np.repeat(np.arange(len(rows)), count)
        share = np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count)
        u = share * (self.whole[rows] / (count - 1))[row]
        base = np.cumsum(self.whole[rows] + 1.0) - self.whole[rows]
        table = (base[:, None] + self.rise[rows]).ravel()
        at = np.interp(base[row] + u, table, np.arange(len(table), dtype=float))
        at = np.minimum(at.astype(np.intp) - row * (last + 1), last - 1)
        ends = [(rows[row], at + i) for i in (0, 1)]
        low, high = (self.rise[end] for end in ends)
        wide = high - low
        # In parts of a cell of the table.
        part, step = _cubic(
            (u - low) / wide, 1.0, *(last * wide / self.density[end] for end in ends)
        )
        first, second = (self.y[end] for end in ends)
        y, slope = _cubic(part, second - first, *(self.slope[end] / last for end in ends))
        return first + y, np.log(step * slope / wide)


def _cubic(share: Array, rise: Any, first: Any, second: Any) -> tuple[Array, Array]:
    """The cubic from 0 to a rise that has these slopes at its ends, at shares; and its slope."""
    first, second = first - rise, second - rise
    bend = first * (1 - share) - second * share
    slope = rise + (1 - 2 * share) * bend - share * (1 - share) * (first + second)
    return rise * share + share * (1 - share) * bend, slope
