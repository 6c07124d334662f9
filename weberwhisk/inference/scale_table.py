"""The last unknown summed out where all signals are in proportion to it, by a table.

Readings of c times the signals being c times as large, p(y | cs) = c⁻ᴿ p(y/c | s), R numbers in
each. Where noise is Gaussian the logarithm of that is quadratic in t = 1/c but for its power:
a + qβt − (βt)²/2 + R ln t, highest where βt is s = (q + √(q² + 4R))/2, with a curvature of s² + R
in ln t. Where logarithms are Gaussian it is quadratic in ln t, with a curvature s² that all share.
So the integral over the unknown is, but for the height of that peak, a function of s and of where
the peak lies in the prior, and so are the mean and the variance that the unknown then has.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations
from typing import NamedTuple

import numpy as np
from scipy.interpolate import RectBivariateSpline

from .._values import Array, Index
from .observer import Observer

#: ln p(reading | signals / t), without its power of t: at t = 0, slope and half the curvature.
Quadratic = tuple[Array, Array, Array]
Cells = tuple[Index, Array, Array]


class Likelihoods(NamedTuple):
    """Of a scale, at contacts (n,): their heights, where and how wide they are in ln t; ln s."""

    height: Array
    place: Array
    width: Array
    sharp: Array


class ScaleTable:
    """What is left of likelihoods when an unknown that all signals are in proportion to is summed.

    At steps of ln s, and of what prior and likelihood together have for an sd; between them by a
    Taylor series of second order. `misfit` is by how much ln of the integral is off, within 3 sds.
    Steps of 0.05 leave 2e-5 at k = 0.3, 1e-6 at 0.03; of a prior with an edge, as much as 0.1.
    """

    def __init__(self, observer: Observer, *, step: float = 0.05, ends: float = 9.0) -> None:
        self.observer, self.noise = observer, observer.noise
        self.on_logs = self.noise.gaussian_on == "log"
        signals = len(observer.cue.signal_names)
        self.size = self.noise.reading_size(signals)
        self.middle = float(observer.last_unknown(np.zeros(1))[0])
        one, other = np.log(observer.last_unknown(np.array([1.0, -1.0])) / self.middle)
        self.spread, self.centre = abs(one - other) / 2, -(one + other) / 2
        # No likelihood is sharper than that of a reading which is the signals; nor are those of
        # interest that explain theirs so ill that they lie 75 below it.
        most = float(np.sqrt(-2 * self.quadratic(np.ones(self.size), np.ones((1, signals)))[2][0]))
        ranges = np.array([np.sqrt(most**2 - 150) if most**2 > 150 else -6.0, most])
        if not self.on_logs:
            ranges = (ranges + np.hypot(ranges, 2 * np.sqrt(self.size))) / 2
        low, high = np.log(ranges[self.on_logs :][[0, -1]])
        sharp = low + step * np.arange(-2, np.ceil((high - low) / step) + 3)
        place = np.asarray(np.arange(-ends, ends + step, 4 * step), dtype=np.float64)
        self._scores = np.linspace(-ends, ends, 3601)
        self._logs = np.log(observer.last_unknown(self._scores) / self.middle)
        #: Within which the unknown is, over its middle, in t.
        self.range = tuple(self.middle / observer.last_unknown(np.array([7.0, -7.0])))
        exact = np.stack([self._sums(float(row), place) for row in sharp], axis=1)
        fine = np.linspace(place[0], place[-1], 4 * len(place) - 3)
        self.step, self.ends, self.columns = step, ends, len(fine)
        self.rows = sharp[0], sharp[-1]
        # Values, and derivatives to ln s and place: 1, x, y, xx/2, xy, yy/2.
        orders = ((0, 0, 1), (1, 0, 1), (0, 1, 1), (2, 0, 0.5), (1, 1, 1), (0, 2, 0.5))
        splines = [RectBivariateSpline(sharp, place, values) for values in exact]
        self._tables = [[s(sharp, fine, i, j).ravel() * f for i, j, f in orders] for s in splines]
        self.misfit = self._off(float(sharp[len(sharp) // 2]) + 0.4 * step)

    def _off(self, sharp: float) -> float:
        """How far off the table is at one s, between its nodes."""
        place = np.linspace(-3.0, 3.0, 199)
        width = np.full(len(place), self._width(np.exp(sharp)))
        both = np.hypot(width, self.spread)
        found = Likelihoods(0.0 * place, self.centre + both * place, width, 0.0 * place + sharp)
        exact = self._sums(sharp, place)[0] - 0.5 * place**2
        return float(np.abs(self.integral(found) - exact).max())

    def _sums(self, sharp: float, place: Array, *, ends: float = 12.0) -> Array:
        """What is tabulated, (3, n): ln of integral, mean and relative variance, nearly constant.

        Over, in this order, exp(−place²/2), what the mean is for narrow likelihoods, and nothing.
        """
        width = self._width(np.exp(sharp))
        both = np.hypot(self.spread, width)
        step = min(0.25, 0.3 * width / self.spread)
        z = np.linspace(-ends, ends, int(2 * ends / step) + 1)[:, None]
        c = self.observer.last_unknown(z) / self.middle
        peak = self.centre + both * place
        away = -np.log(c) - peak
        if self.on_logs:
            log = -0.5 * np.exp(2 * sharp) * away**2
        else:
            grown = np.expm1(np.minimum(away, 300.0))
            log = -0.5 * np.exp(2 * sharp) * grown**2 - self.size * (grown - away)
        log -= 0.5 * z**2
        top = log.max(axis=0)
        weight = np.exp(log - top)
        total = weight.sum(axis=0)
        mean = (weight * c).sum(axis=0) / total
        variance = (weight * np.square(c / mean - 1)).sum(axis=0) / total
        integral = np.log(total * (z[1, 0] - z[0, 0]) / np.sqrt(2 * np.pi)) + top
        tilt = (self.spread / both) ** 2
        return np.array([integral + 0.5 * place**2, np.log(mean) + tilt * peak, np.log(variance)])

    def _width(self, s: float) -> float:
        return float((s * s + (0 if self.on_logs else self.size)) ** -0.5)

    def quadratic(self, reading: Array, signals: Array) -> Quadratic:
        """Of readings (..., R) and signals (..., S) at the middle of the prior."""
        if self.on_logs:
            scales, per = np.exp([0.0, -1.0, 1.0]), 1.0
        else:  # readings about as large as signals: differences of others would be of nothing
            most = np.maximum(np.abs(reading / signals).max(axis=-1), 1e-100)
            scales, per = np.array([0.0, 1.0, -1.0]), 1 / most
            reading = reading * per[..., None]
        middle, one, other = (self.noise.log_likelihood(c * reading, signals) for c in scales)
        known = np.isfinite(middle)  # else a signal of no spread, or of another sign
        with np.errstate(invalid="ignore"):
            first = (one - other) / 2 / per
            second = ((one + other) / 2 - middle) / per**2
        return middle, np.where(known, first, 0.0), np.where(known, second, -0.5)

    def prepared(self, signals: Array, weight: Array) -> Callable[[Array, Index, Index], Quadratic]:
        """`quadratic` of readings (B, R), rows (n,) of them, at (n,) of a table of signals (P, S).

        And of weights (P,) of the signals, in ln.
        """
        if self.on_logs:

            def at_logs(reading: Array, row: Index, index: Index) -> Quadratic:
                middle, first, second = self.quadratic(reading[row], signals[index])
                return middle + weight[index], first, second

            return at_logs
        # What a reading is multiplied with, from readings of one or two of the signals alone.
        middle = self.noise.log_likelihood(0.0 * signals, signals)
        held = np.isfinite(middle)
        per, alone = 1 / np.where(held[:, None], signals, 1.0).T, np.eye(self.size)[:, None]

        def more(reading: Array) -> Array:
            found = self.noise.log_likelihood(reading * signals, signals)
            return np.where(held, found, 0.0) - np.where(held, middle, 0.0)

        above, below = more(alone), more(-alone)
        slopes = (above - below) / 2 * per
        squares = [(i, i, (above[i] + below[i]) / 2 * per[i] ** 2) for i in range(self.size)]
        for i, j in combinations(range(self.size), 2):
            both = more(alone[i] + alone[j]) - above[i] - above[j]
            if np.abs(both).max(initial=0.0) > 1e-9 * np.abs(above).max(initial=0.0):
                squares.append((i, j, both * per[i] * per[j]))

        weighted = middle + weight

        def told(reading: Array, row: Index, index: Index) -> Quadratic:
            own = [y.take(row) for y in reading.T]
            first = sum(y * slope.take(index) for y, slope in zip(own, slopes, strict=True))
            second = sum(own[i] * own[j] * square.take(index) for i, j, square in squares)
            return weighted.take(index), first, second

        return told

    def likelihoods(self, told: Quadratic) -> Likelihoods:
        """Where likelihoods of the scale lie, of which the quadratic functions (n,) are known."""
        middle, first, second = told
        curved = np.maximum(-2 * second, 1e-300)
        if self.on_logs:
            place = (self.size - first) / curved
            height = middle + 0.5 * curved * place**2
            return Likelihoods(height, place, curved**-0.5, 0.5 * np.log(curved))
        scale = curved**-0.5
        q = first * scale
        s = 0.5 * (q + np.sqrt(q * q + 4 * self.size))
        place = np.log(scale * s)
        height = middle + 0.5 * s * (2 * q - s) + self.size * place
        return Likelihoods(height, place, (s * s + self.size) ** -0.5, np.log(s))

    def integral(self, found: Likelihoods) -> Array:
        """ln of the integrals (n,) over the unknown."""
        return self._integral(found, *self._cells(found))

    def summed(self, found: Likelihoods) -> tuple[Array, Array, Array]:
        """The same; mean and variance (n,) of the unknown, over its middle."""
        place, cells = self._cells(found)
        log = self._integral(found, place, cells)
        tilt = self.spread**2 / (found.width**2 + self.spread**2)
        mean = np.exp(self._between(1, *cells) - tilt * found.place)
        return log, mean, np.exp(self._between(2, *cells)) * mean**2

    def _integral(self, found: Likelihoods, place: Array, cells: Cells) -> Array:
        log = self._between(0, *cells)
        log += found.height
        log -= 0.5 * place**2
        return log

    def _cells(self, found: Likelihoods) -> tuple[Array, Cells]:
        """Where peaks lie in the prior, in sds; the nodes next to that and to ln s, how far off."""
        place = found.place - self.centre
        place /= np.sqrt(found.width**2 + self.spread**2)
        x = np.minimum(np.maximum(found.sharp, self.rows[0]), self.rows[1])
        x -= self.rows[0]
        y = np.minimum(np.maximum(place, -self.ends), self.ends)
        y += self.ends
        row, column = np.rint(x / self.step), np.rint(y / self.step)
        x -= self.step * row
        y -= self.step * column
        row *= self.columns
        row += column
        return place, (row.astype(np.intp), x, y)

    def _between(self, which: int, node: Index, x: Array, y: Array) -> Array:
        """Taylor series of one of the tables."""
        value, by_x, by_y, xx, xy, yy = (table.take(node) for table in self._tables[which])
        xx *= x
        xx += by_x
        xx *= x
        yy *= y
        yy += by_y
        xy *= x
        yy += xy
        yy *= y
        value += xx
        value += yy
        return np.asarray(value)

    def scores(self, found: Likelihoods) -> tuple[Array, Array]:
        """Where the unknown's density peaks (n,), in scores of its prior, and how wide it is."""
        both = found.width**2 + self.spread**2
        place = found.place - (found.place - self.centre) * found.width**2 / both
        return np.interp(-place, self._logs, self._scores), found.width / np.sqrt(both)

    def density(self, score: Array) -> tuple[Array, Array]:
        """Where scores of the prior are in the quadratic functions, and ln of what is beside them.

        So that middle + (first + second · x) · x + that is ln of the density of a score.
        """
        logs = np.log(self.observer.last_unknown(score) / self.middle)
        beside = -self.size * logs - 0.5 * (score**2 + np.log(2 * np.pi))
        return logs if self.on_logs else np.exp(-logs), beside
