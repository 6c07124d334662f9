"""Spike counts of slowly and rapidly adapting afferents, from which Weber's law emerges."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import gammaln

from .._util.checks import non_negative_number, positive, positive_number, shown, whole
from .._util.refusals import Refusal
from .._util.values import Array, Value
from .protocol import ReceptorNoise, Seed

__all__ = ["Afferents", "SpikeCount"]


@dataclass(frozen=True, eq=False, repr=False, init=False)
class Afferents(Value):
    """One class of afferents, its thresholds evenly spread on a logarithmic axis.

    An afferent of threshold c fires at spontaneous_rate + peak_rate·s(u), u = drive/c, with the
    Naka–Rushton function s = uⁿ/(1 + uⁿ): half its range at its threshold.

    Parameters
    ----------
    number : int
        Afferents for each kind of signal.
    lowest, highest : float or sequence of float
        Thresholds of the most and the least sensitive one; for slowly adapting afferents in the
        unit of the signal, for rapidly adapting ones in that unit per second. One for all kinds
        of signal or one each.
    peak_rate : float
        Evoked rate of a saturated afferent, spikes/s.
    exponent : float
        Steepness n of the tuning.
    spontaneous_rate : float
        Rate without a stimulus, spikes/s.

    Raises
    ------
    ValueError
        For values that are not positive (spontaneous rate: negative), a number that is not whole,
        a highest threshold below the lowest.

    Examples
    --------
    >>> Afferents(3, 1e-7, 1e-5).thresholds
    array([1.e-07, 1.e-06, 1.e-05])
    """

    number: int
    lowest: Array
    highest: Array
    peak_rate: float
    exponent: float
    spontaneous_rate: float

    def __init__(
        self,
        number: int,
        lowest: ArrayLike,
        highest: ArrayLike,
        peak_rate: float = 150.0,
        exponent: float = 2.0,
        spontaneous_rate: float = 0.5,
    ) -> None:
        number = whole("number", number, "write how many afferents there are")
        low = positive("lowest", lowest, "write a threshold in the signal's unit")
        high = positive("highest", highest, "write a threshold in the signal's unit")
        if np.any(high < low):
            raise Refusal("highest must not lie below lowest", f"{high} below {low}", "swap them")
        rest = non_negative_number("spontaneous_rate", spontaneous_rate, "write spikes/s")
        self._set(
            number=number, lowest=low, highest=high, spontaneous_rate=rest,
            peak_rate=positive_number("peak_rate", peak_rate, "write spikes/s"),
            exponent=positive_number("exponent", exponent, "write 2, say"),
        )  # fmt: skip

    @property
    def thresholds(self) -> Array:
        """Thresholds, (number,), or (S, number) where signals differ."""
        return np.geomspace(self.lowest, self.highest, self.number, axis=-1)


@dataclass(frozen=True, eq=False, repr=False)
class SpikeCount(ReceptorNoise):
    """Counts of a population of slowly (SA) and rapidly adapting (RA) trigeminal afferents.

    Every kind of signal has afferents of its own. SA afferents respond to its magnitude throughout
    the window, RA afferents to the speed of its onset (it rises evenly within `rise_time`), and
    only while it lasts. A reading is one count for each afferent: SA then RA, in the order of
    their thresholds, signal by signal. The sign of a signal is not read from these counts: they
    are those of the afferents tuned to its direction.

    Parameters
    ----------
    slow, rapid : Afferents, optional
        Either may be left out, not both.
    window : float
        Time over which spikes are counted, s.
    rise_time : float
        Time that the signal takes to build up, s.
    gain_sd : float
        Sd of a random gain of each afferent from trial to trial (gamma-distributed, mean 1): the
        variance is μ + (gain_sd·μ)², the counts are negative binomial. 0, the default: Poisson.

    Raises
    ------
    ValueError
        For no afferents at all, times that are not positive, a negative gain_sd.

    Notes
    -----
    Weber's law emerges: over signals that many thresholds surround, the effective Weber fraction
    does not depend on the signal. Below the lowest threshold k rises as I^(−n/2), in the end, where
    spontaneous spikes outnumber evoked ones, as I⁻ⁿ; above the highest as Iⁿ. The faster the onset,
    the smaller the signal that reaches the RA afferents. Derivation, sources and what is assumed:
    the theory page "Receptor noise, JNDs and criteria".

    Examples
    --------
    A hundred afferents over three decades of moment:

    >>> noise = SpikeCount(
    ...     slow=Afferents(75, 1e-8, 1e-5), rapid=Afferents(25, 1e-6, 1e-3), rise_time=0.01
    ... )
    >>> noise.effective_weber_fraction([1e-10, 1e-7, 1e-6, 1e-3]).round(3)
    array([5.89420e+01, 1.10000e-01, 1.11000e-01, 9.77933e+02])
    """

    reads_signals = False

    slow: Afferents | None = None
    rapid: Afferents | None = None
    _: KW_ONLY
    window: float = 0.05
    rise_time: float = 0.01
    gain_sd: float = 0.0

    def __post_init__(self) -> None:
        if self.slow is None and self.rapid is None:
            raise Refusal(
                "A population needs afferents", "none", "write slow=ww.receptors.Afferents(...)"
            )
        for name in ("slow", "rapid"):
            if not isinstance(getattr(self, name), Afferents | None):
                raise Refusal(
                    f"{name} must be Afferents",
                    shown(getattr(self, name)),
                    "write ww.receptors.Afferents(75, 1e-8, 1e-5), say",
                )
        for name in ("window", "rise_time"):
            hint = "write seconds, such as 0.05"
            self._set(**{name: positive_number(name, getattr(self, name), hint)})
        hint = "write 0 for Poisson counts"
        self._set(gain_sd=non_negative_number("gain_sd", self.gain_sd, hint))

    # From here on both classes have one form: thresholds in the signal's unit, times to count in.

    @cached_property
    def _classes(self) -> list[tuple[Afferents, float]]:
        classes = []
        if self.slow is not None:
            classes.append((self.slow, self.window))
        if self.rapid is not None:
            low, high = self.rapid.lowest * self.rise_time, self.rapid.highest * self.rise_time
            magnitude = replace(self.rapid, lowest=low, highest=high)
            classes.append((magnitude, min(self.rise_time, self.window)))
        return classes

    @cached_property
    def _log_threshold(self) -> Array:
        logs = [np.log(part.thresholds) for part, _ in self._classes]
        signals = np.broadcast_shapes(*(c.shape[:-1] for c in logs))
        return np.concatenate([np.broadcast_to(c, (*signals, c.shape[-1])) for c in logs], axis=-1)

    @cached_property
    def _exponent(self) -> Array:
        return self._each([part.exponent for part, _ in self._classes])

    @cached_property
    def _peak(self) -> Array:
        return self._each([part.peak_rate * time for part, time in self._classes])

    @cached_property
    def _rest(self) -> Array:
        return self._each([part.spontaneous_rate * self.window for part, _ in self._classes])

    def _each(self, values: list[float]) -> Array:
        """A value of each class, for each of its afferents."""
        return np.repeat(np.asarray(values, float), [part.number for part, _ in self._classes])

    # -- readings ------------------------------------------------------------------------------

    @property
    def number(self) -> int:
        """Afferents for each kind of signal."""
        return self._log_threshold.shape[-1]

    def reading_size(self, signals: int) -> int:
        """A count for each afferent of each signal."""
        return signals * self.number

    def _activation(self, signals: ArrayLike) -> Array:
        """s of every afferent, (..., S, number); above zero, so that it has a logarithm."""
        signals = np.asarray(signals, dtype=float)
        if self._log_threshold.ndim > 1 and signals.shape[-1] != len(self._log_threshold):
            raise Refusal(
                f"These afferents have thresholds for {len(self._log_threshold)} signals",
                signals.shape[-1],
                "give one threshold for each signal, or one for all",
            )
        with np.errstate(divide="ignore"):
            log_ratio = np.log(np.abs(signals))[..., None] - self._log_threshold
        # At 460 from its threshold an afferent is at rest, or saturated, to any precision.
        power = np.exp(np.clip(self._exponent * log_ratio, -460.0, 460.0))
        return np.asarray(power / (1 + power))

    def _mean(self, activation: Array) -> Array:
        return self._rest + self._peak * activation

    def _slope(self, activation: Array) -> Array:
        """d mean/d ln signal, (..., S, number)."""
        return self._peak * self._exponent * activation * (1 - activation)

    def mean(self, signals: ArrayLike) -> Array:
        return _flat(self._mean(self._activation(signals)))

    def variance(self, signals: ArrayLike) -> Array:
        """Variance of the counts, μ + (gain_sd·μ)², (..., R)."""
        mean = self.mean(signals)
        return mean + (self.gain_sd * mean) ** 2

    def sd(self, signals: ArrayLike) -> Array:
        return np.sqrt(self.variance(signals))

    def jacobian(self, signals: ArrayLike) -> Array:
        signals = np.asarray(signals, dtype=float)
        slope = self._slope(self._activation(signals)) / _off_zero(signals)[..., None]
        size = signals.shape[-1]
        return np.asarray(_flat(slope)[..., None] * np.repeat(np.eye(size), self.number, axis=0))

    def interval(self, signals: ArrayLike, width: float) -> tuple[Array, Array]:
        """Counts beyond which the chance is at most exp(−width²/2) on either side, (..., R) each.

        Bernstein's inequalities for sub-gamma sums (Boucheron, Lugosi & Massart 2013, §2.4): the
        lower tail is Gaussian at worst, the upper one that of a gamma whose scale is the Fano
        factor.
        """
        mean, variance = self.mean(signals), self.variance(signals)
        reach = width * np.sqrt(variance)
        return mean - reach, mean + reach + 0.5 * width**2 * variance / mean

    # -- likelihood ----------------------------------------------------------------------------

    def log_likelihood(self, reading: ArrayLike, signals: ArrayLike) -> Array:
        """ln p(counts | signals), shape (...).

        Poisson and negative binomial (of fixed gain_sd) are exponential families: η(I)·counts −
        A(I) + a term without I.
        """
        reading, signals = np.asarray(reading, dtype=float), np.asarray(signals, dtype=float)
        refused = ~((reading >= 0) & (reading < np.inf) & (reading == np.floor(reading)))
        if np.any(refused):
            raise Refusal(
                "Spike counts are whole and not negative",
                f"{reading[refused][0]:g}",
                "a reading has one for each afferent",
            )
        mean = _flat(self._mean(self._activation(signals)))
        natural, normaliser = np.log(mean), mean
        if self.gain_sd > 0:
            gain = self.gain_sd**2
            normaliser = np.log1p(gain * mean) / gain
            natural = natural - gain * normaliser
        value = np.einsum("...r,...r->...", reading, natural) - normaliser.sum(axis=-1)
        return np.asarray(value + self._log_base(reading).sum(axis=-1))

    def _log_base(self, counts: Array) -> Array:
        """The term without I, looked up where counts are fewer than readings."""
        top = int(counts.max(initial=0))
        n = np.arange(top + 1.0) if top < counts.size else counts
        value = -gammaln(n + 1)
        if self.gain_sd > 0:
            shape = self.gain_sd**-2
            value = value + gammaln(n + shape) - gammaln(shape) - n * np.log(shape)
        return np.asarray(value if n is counts else value[counts.astype(np.intp)])

    def sample(self, signals: ArrayLike, seed: Seed = None) -> Array:
        rng = np.random.default_rng(seed)
        mean = self.mean(signals)
        if self.gain_sd > 0:
            mean = mean * rng.gamma(self.gain_sd**-2, self.gain_sd**2, size=mean.shape)
        return rng.poisson(mean).astype(float)

    # -- information ---------------------------------------------------------------------------

    def _log_information(self, signals: Array) -> Array:
        """Fisher information about ln |signal|, Σ μ'²/variance, (..., S)."""
        activation = self._activation(signals)
        mean = self._mean(activation)
        slope = self._slope(activation)
        return np.asarray((slope**2 / (mean + (self.gain_sd * mean) ** 2)).sum(axis=-1))

    def fisher(self, signals: ArrayLike) -> Array:
        signals = np.asarray(signals, dtype=float)
        information = self._log_information(signals) / _off_zero(signals) ** 2
        return np.asarray(information[..., None] * np.eye(signals.shape[-1]))

    def effective_weber_fraction(self, signals: ArrayLike) -> Array:
        """Least sd of ln |signal| that the counts allow, 1/√(I²·Fisher information), (..., S)."""
        with np.errstate(divide="ignore"):
            return np.asarray(1 / np.sqrt(self._log_information(np.asarray(signals, dtype=float))))


def _off_zero(signals: Array) -> Array:
    """Signals to divide by: where there is none, slopes are none either."""
    return np.where(signals == 0, np.inf, signals)


def _flat(values: Array) -> Array:
    """(..., S, number) as (..., S·number)."""
    return values.reshape(*values.shape[:-2], values.shape[-2] * values.shape[-1])
