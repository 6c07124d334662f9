"""Receptors that are not Gaussian with Weber's sd: log-normal readings, events."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from .._util.checks import finite, non_negative, number
from .._util.refusals import Refusal
from .._util.values import Array
from .gaussian import GeneralisedWeber, Proportional
from .protocol import ReceptorNoise, Seed

__all__ = ["Events", "LogNormal"]


@dataclass(frozen=True, eq=False, repr=False, init=False)
class LogNormal(Proportional):
    """Weber's law with log-normal readings: mean the signal, sd = k·|signal|.

    The ln of a reading is Gaussian with variance σ² = ln(1 + k²) about ln|signal| − σ²/2: constant
    noise on Fechner's logarithmic scale. Mean and sd are exactly those of `Weber`, so the two
    differ in shape alone, and less the smaller k is. The median is the signal/√(1 + k²), and the
    reading has the signal's sign: that of a moment, which follows the side of the deflection, is
    never mistaken.

    Parameters
    ----------
    weber_fraction : float or sequence of float
        k, one for all signals or one each.
    correlation : float
        Correlation between the logs of the readings' magnitudes, −1 to 1. At ±1 there is a
        covariance but no likelihood.

    Raises
    ------
    ValueError
        For a Weber fraction that is not positive, a correlation outside −1 … 1.

    Notes
    -----
    Only the mean of the logs moves with the signal, so that one reading carries 1/(σI)². With
    σ² = ln(1 + k²) that is (1 + k²/2 + …)/(kI)², where `Weber` has (1 + 2k²)/(kI)². Moments as in
    Johnson, Kotz & Balakrishnan (1994), Continuous Univariate Distributions 1, chapter 14.

    Examples
    --------
    >>> noise = LogNormal(0.1)
    >>> noise.mean([2.0, -5.0]), noise.sd([2.0, -5.0])
    (array([ 2., -5.]), array([0.2, 0.5]))
    >>> float(noise.fisher([2.0])[0, 0].round(3))
    25.125
    """

    gaussian_on = "log"

    @cached_property
    def _logs(self) -> GeneralisedWeber:
        """The noise of the logs, the same everywhere."""
        return GeneralisedWeber(0.0, floor=self.sigma, correlation=self.correlation)

    @property
    def sigma(self) -> Array:
        """Sd σ of the ln of a reading: √ln(1 + k²)."""
        return np.sqrt(np.log1p(self.weber_fraction**2))

    def mean(self, signals: ArrayLike) -> Array:
        return np.asarray(signals, dtype=float)

    def jacobian(self, signals: ArrayLike) -> Array:
        size = np.shape(signals)[-1]
        return np.broadcast_to(np.eye(size), (*np.shape(signals), size))

    def covariance(self, signals: ArrayLike) -> Array:
        """Covariance of the readings, (..., S, S): IᵢIⱼ(exp(ρσᵢσⱼ) − 1)."""
        signals = np.asarray(signals, dtype=float)
        logs = self._logs.covariance(signals)
        return np.asarray(signals[..., :, None] * np.expm1(logs) * signals[..., None, :])

    def interval(self, signals: ArrayLike, width: float) -> tuple[Array, Array]:
        """Readings `width`·σ to either side of the median on the log scale, (..., S) each."""
        signals = np.asarray(signals, dtype=float)
        ends = signals * np.exp(
            -0.5 * self.sigma**2
            + np.multiply.outer([-width, width], self.sigma).reshape(
                2, *[1] * (signals.ndim - 1), -1
            )
        )
        return ends.min(axis=0), ends.max(axis=0)

    def log_likelihood(self, reading: ArrayLike, signals: ArrayLike) -> Array:
        """ln p(reading | signals), shape (...); −∞ where a reading has not its signal's sign."""
        reading, signals = np.asarray(reading, dtype=float), np.asarray(signals, dtype=float)
        possible = np.all(reading * np.sign(signals) > 0, axis=-1)
        with np.errstate(divide="ignore", invalid="ignore"):
            log_reading = np.log(np.abs(reading))
            value = self._logs.log_likelihood(log_reading, self._centre(signals))
            value = value - log_reading.sum(axis=-1)
        return np.where(possible, value, -np.inf)

    def gaussian_root(self, size: int) -> Array:
        return self._logs.gaussian_root(size)

    def as_gaussian(self, signals: Array) -> tuple[Array, Array]:
        # So far apart that no reading is of a signal of the other sign.
        return self._centre(signals) + 1e5 * (signals < 0), self._logs.sd(signals)

    def to_gaussian(self, reading: Array) -> tuple[Array, Array]:
        with np.errstate(divide="ignore"):
            log = np.log(np.abs(reading))
        return log + 1e5 * (reading < 0), -log.sum(axis=-1)  # as `as_gaussian` has them

    def sample(self, signals: ArrayLike, seed: Seed = None) -> Array:
        signals = np.asarray(signals, dtype=float)
        return np.sign(signals) * np.exp(self._logs.sample(self._centre(signals), seed))

    def fisher(self, signals: ArrayLike) -> Array:
        """Fisher information about the signals, (..., S, S): 1/(σI)² for one signal."""
        signals = np.asarray(signals, dtype=float)
        with np.errstate(divide="ignore"):
            slope = 1 / signals
        return slope[..., :, None] * self._logs.fisher(signals) * slope[..., None, :]

    def _centre(self, signals: Array) -> Array:
        """Mean of the logs, (..., S)."""
        with np.errstate(divide="ignore"):
            return np.asarray(np.log(np.abs(signals)) - 0.5 * self.sigma**2)


@dataclass(frozen=True, eq=False, repr=False, init=False)
class Events(ReceptorNoise):
    """One event out of C, of which the signals are the chances of the first C − 1.

    A touch has no magnitude: it happens or it does not, with chances that depend on the
    contact. The last event's chance is what the others leave, so that the covariance is regular.

    Parameters
    ----------
    reports : array, shape (C, R)
        The numbers that report each event. Rows of 0 and 1 serve: which whiskers touch, or 1 in
        the place of the event's own number (none, for the last).
    misreport : float
        Chance that the report has nothing to do with the event: any of the C, all equally likely.

    Raises
    ------
    ValueError
        For fewer than two events, two with one report, a chance of misreporting outside 0 … 1.

    Examples
    --------
    >>> touch = Events([[0.0], [1.0]])
    >>> touch.mean([0.2]), touch.sd([0.2])
    (array([0.8]), array([0.4]))
    >>> touch.log_likelihood([1.0], [0.2]).round(4)
    np.float64(-0.2231)
    """

    is_categorical = True

    reports: Array
    misreport: float

    def __init__(self, reports: ArrayLike, *, misreport: float = 0.0) -> None:
        reports = finite("reports", reports, "give one row of numbers for each event")
        if reports.ndim != 2 or len(reports) < 2:
            raise Refusal(
                "reports must have a row for each of two events or more",
                f"shape {reports.shape}",
                "write [[0], [1]] for no touch and touch, say",
            )
        if len(np.unique(reports, axis=0)) < len(reports):
            raise Refusal(
                "Each event needs a report of its own",
                f"{len(reports)} events and {len(np.unique(reports, axis=0))} different "
                "rows of reports",
                "leave out events that cannot be distinguished",
            )
        misreport = number("misreport", misreport, "give a probability, 0 to 1")
        non_negative("misreport", misreport, "give a probability, 0 to 1")
        if misreport >= 1:
            raise Refusal(
                "misreport must be below 1", f"{misreport:g}", "give a probability, 0 to 1"
            )
        self._set(reports=reports, misreport=misreport)

    def __repr__(self) -> str:
        return f"Events({len(self.reports)} events, misreport={self.misreport:g})"

    def reading_size(self, signals: int) -> int:
        """R, the numbers in each report."""
        if signals != len(self.reports) - 1:
            raise Refusal(
                f"Events with {len(self.reports)} reports take {len(self.reports) - 1} chances",
                f"{signals} signals",
                "use the cue's default_noise()",
            )
        return int(self.reports.shape[1])

    def chances(self, signals: ArrayLike) -> Array:
        """Chance of each of the C reports, (..., C)."""
        first = np.asarray(signals, dtype=float)
        # What rounding takes below zero is zero.
        chance = np.maximum(np.concatenate([first, 1 - first.sum(-1, keepdims=True)], axis=-1), 0)
        return (1 - self.misreport) * chance + self.misreport / len(self.reports)

    def mean(self, signals: ArrayLike) -> Array:
        return np.asarray(self.chances(signals) @ self.reports)

    def jacobian(self, signals: ArrayLike) -> Array:
        """d mean/d chance, (..., R, S): constant, as the mean is linear in the chances."""
        slope = (1 - self.misreport) * (self.reports[:-1] - self.reports[-1]).T
        return np.broadcast_to(slope, (*np.shape(signals)[:-1], *slope.shape))

    def sd(self, signals: ArrayLike) -> Array:
        mean = self.mean(signals)[..., None, :]
        square = self.chances(signals)[..., None] * (self.reports - mean) ** 2
        return np.asarray(np.sqrt(square.sum(axis=-2)))

    def covariance(self, signals: ArrayLike) -> Array:
        off = self.reports - self.mean(signals)[..., None, :]
        return np.einsum("...c,...ci,...cj->...ij", self.chances(signals), off, off)

    def interval(self, signals: ArrayLike, width: float) -> tuple[Array, Array]:
        """Smallest and largest numbers among the reports that may come, (..., R) each.

        Reports that may not are those with a chance below exp(−width²/2) in all.
        """
        possible = self.chances(signals) > np.exp(-0.5 * width**2) / len(self.reports)
        return (
            np.where(possible[..., None], self.reports, np.inf).min(axis=-2),
            np.where(possible[..., None], self.reports, -np.inf).max(axis=-2),
        )

    def resolution(self, signals: Array) -> tuple[Array, Array]:
        """2√chance, (..., C): smooth where chances vanish, with steps of one JND of length one.

        The arc length of this curve is ∫√(information), as Σp'²/p = Σ(d 2√p)² (Fisher, 1922).
        Far below 1e-12, where chances may be rounding, it is level.
        """
        place = 2 * np.sqrt(self.chances(signals) + 1e-12)
        return place, np.ones_like(place)

    def log_likelihood(self, reading: ArrayLike, signals: ArrayLike) -> Array:
        """ln of the chance of a report (..., R), shape (...); −∞ for what reports no event."""
        same = (np.asarray(reading, dtype=float)[..., None, :] == self.reports).all(axis=-1)
        event, possible = same.argmax(axis=-1), same.any(axis=-1)
        with np.errstate(divide="ignore"):
            log = np.log(self.chances(signals))
        shape = np.broadcast_shapes(event.shape, log.shape[:-1])
        log = np.broadcast_to(log, (*shape, log.shape[-1]))
        at = np.broadcast_to(event, shape)[..., None]
        return np.where(possible, np.take_along_axis(log, at, axis=-1)[..., 0], -np.inf)

    def sample(self, signals: ArrayLike, seed: Seed = None) -> Array:
        rise = np.cumsum(self.chances(signals), axis=-1)
        u = np.random.default_rng(seed).random(rise.shape[:-1])[..., None]
        return np.asarray(self.reports[(u > rise[..., :-1]).sum(axis=-1)])

    def fisher(self, signals: ArrayLike) -> Array:
        """Fisher information about the chances, (..., S, S): diag(1/p) + 1/p_last."""
        # Below, chances inform of nothing, as p'²/p falls with p; dividing by them would magnify
        # what rounding leaves of sums over the others' slopes.
        chance = np.maximum(self.chances(signals), 1e-10)
        size = chance.shape[-1] - 1
        own = np.eye(size) / chance[..., None, :-1]
        return np.asarray((1 - self.misreport) ** 2 * (own + 1 / chance[..., -1:, None]))
