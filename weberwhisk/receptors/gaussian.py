"""Gaussian receptor noise with a spread that grows with the signal (Weber's law, (3.1)).

A law is one short class that gives the sd; the mean where it is not the signal, and exact slopes
where they are to be exact.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from .._util.checks import non_negative, number, numbers, positive
from .._util.refusals import Refusal
from .._util.values import Array, Flags
from .protocol import ReceptorNoise, Seed

__all__ = ["Gaussian", "GeneralisedWeber", "Proportional", "Saturating", "Weber"]


class Gaussian(ReceptorNoise):
    """Independent or equally correlated Gaussian noise whose sd depends on the signal."""

    gaussian_on = "linear"
    #: Correlation between any two of the readings.
    correlation: float = 0.0

    def mean(self, signals: ArrayLike) -> Array:
        return np.asarray(signals, dtype=float)

    def slopes(self, signals: Array) -> tuple[Array, Array]:
        """d mean/d signal and d sd/d signal, (..., S) each: here by differences, good to 1e-10."""
        step = 6e-6 * np.where(signals == 0, 1.0, np.abs(signals))
        ends = signals + step, signals - step
        rise, growth = (f(ends[0]) - f(ends[1]) for f in (self.mean, self.sd))
        return rise / (2 * step), growth / (2 * step)

    def jacobian(self, signals: ArrayLike) -> Array:
        """d mean/d signal, (..., S, S): each reading is of its own signal."""
        slope, _ = self.slopes(np.asarray(signals, dtype=float))
        return np.asarray(slope[..., None] * np.eye(slope.shape[-1]))

    def interval(self, signals: ArrayLike, width: float) -> tuple[Array, Array]:
        """`width` sd to either side of the mean, (..., S) each."""
        mean, reach = self.mean(signals), width * self.sd(signals)
        return mean - reach, mean + reach

    def _correlations(self, size: int) -> Array:
        rho = self.correlation
        if size > 2 and rho <= -1 / (size - 1):
            raise Refusal(
                f"{size} signals cannot all be correlated by {rho:g}",
                remedy=f"write a correlation above {-1 / (size - 1):.3g}",
            )
        return (1 - rho) * np.eye(size) + rho

    def covariance(self, signals: ArrayLike) -> Array:
        sd = self.sd(signals)
        return sd[..., :, None] * self._correlations(sd.shape[-1]) * sd[..., None, :]

    def _precision(self, size: int) -> Array:
        if size > 1 and abs(self.correlation) >= 1:
            raise Refusal(
                f"Perfectly correlated noise (correlation {self.correlation:g}) has no likelihood",
                remedy="write a correlation between -1 and 1",
            )
        return np.asarray(np.linalg.inv(self._correlations(size)), dtype=float)

    def gaussian_root(self, size: int) -> Array:
        return np.asarray(np.linalg.cholesky(self._precision(size)).T)

    def as_gaussian(self, signals: Array) -> tuple[Array, Array]:
        return self.mean(signals), self.sd(signals)

    def to_gaussian(self, reading: Array) -> tuple[Array, Array]:
        return reading, np.zeros(len(reading))

    def log_likelihood(self, reading: ArrayLike, signals: ArrayLike) -> Array:
        """ln p(reading | signals), shape (...). −∞ where a signal leaves its receptor no spread."""
        sd = self.sd(signals)
        size = sd.shape[-1]
        root = self.gaussian_root(size)
        constant = np.log(np.diag(root)).sum() - 0.5 * size * np.log(2 * np.pi)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            z = (np.asarray(reading, dtype=float) - self.mean(signals)) / sd
            z = np.clip(z, -1e150, 1e150)  # where an sd is next to nothing
            value = constant - 0.5 * ((z @ root.T) ** 2).sum(axis=-1) - np.log(sd).sum(axis=-1)
        return np.where((sd > 0).all(axis=-1), value, -np.inf)

    def sample(self, signals: ArrayLike, seed: Seed = None) -> Array:
        sd = self.sd(signals)
        rho = self._correlations(sd.shape[-1])
        values, vectors = np.linalg.eigh(rho)
        root = vectors * np.sqrt(np.maximum(values, 0))
        draws = np.random.default_rng(seed).standard_normal(sd.shape)
        return self.mean(signals) + sd * (draws @ root.T)

    def fisher(self, signals: ArrayLike) -> Array:
        """Fisher information about the signals, (..., S, S).

        ∂μᵀΣ⁻¹∂μ + ½tr(Σ⁻¹∂Σ Σ⁻¹∂Σ): the spread informs as well as the mean, so that one signal
        carries (1 + 2k²)/(kI)² under Weber's law.
        """
        signals = np.asarray(signals, dtype=float)
        sd = self.sd(signals)
        size = sd.shape[-1]
        precision, correlations = self._precision(size), self._correlations(size)
        mean_slope, sd_slope = self.slopes(signals)
        a, b = mean_slope / sd, sd_slope / sd
        return (
            a[..., :, None] * precision * a[..., None, :]
            + b[..., :, None] * (np.eye(size) + precision * correlations) * b[..., None, :]
        )


@dataclass(frozen=True, eq=False, repr=False, init=False)
class Proportional(ReceptorNoise):
    """Noise whose sd is k·|signal|, whatever its shape."""

    weber_fraction: Array
    correlation: float

    def __init__(self, weber_fraction: ArrayLike = 0.1, *, correlation: float = 0.0) -> None:
        self._set(
            weber_fraction=positive("weber_fraction", weber_fraction, "write 0.1, say"),
            correlation=checked_correlation(correlation),
        )

    @property
    def is_scale_family(self) -> bool:
        """Always: the sd is a share of the signal."""
        return True

    def sd(self, signals: ArrayLike) -> Array:
        """k·|signal|, (..., S)."""
        return np.asarray(self.weber_fraction * np.abs(np.asarray(signals, dtype=float)))


@dataclass(frozen=True, eq=False, repr=False, init=False)
class Weber(Proportional, Gaussian):
    """Weber's law: each reading is Gaussian about its signal with sd = k·|signal|.

    Parameters
    ----------
    weber_fraction : float or sequence of float
        k of (3.1), one for all signals or one each.
    correlation : float
        Correlation ρ of the noise between signals, −1 to 1. At ±1 there is a covariance, for the
        limits of the closed-form JND, but no likelihood.

    Raises
    ------
    ValueError
        For a Weber fraction that is not positive, a correlation outside −1 … 1.

    Notes
    -----
    The law is of magnitudes (§3a): a signal of zero has no noise. Observers refuse it for signals
    that change sign within the whisker's reach; see `inference.default_noise`.

    Examples
    --------
    >>> noise = Weber(0.1)
    >>> noise.sd([2.0, 5.0])
    array([0.2, 0.5])
    >>> float(noise.fisher([2.0])[0, 0].round(6))
    25.5
    """

    def slopes(self, signals: Array) -> tuple[Array, Array]:
        return np.ones_like(signals), self.weber_fraction * np.sign(signals)


@dataclass(frozen=True, eq=False, repr=False, init=False)
class GeneralisedWeber(Gaussian):
    """Weber's law between a floor and a ceiling: sd² = floor² + (k·signal)².

    Parameters
    ----------
    weber_fraction : float or sequence of float
        k, one for all signals or one each. 0 leaves constant noise, natural for angles.
    floor : float or sequence of float
        Receptor threshold noise σ₀, in the unit of each signal. One that changes sign within the
        whisker's reach needs it; `inference.default_noise` has one.
    ceiling : float or sequence of float or None, optional
        Signal above which the receptor is saturated: it reports the ceiling, whatever the signal,
        and carries no information.
    correlation : float
        Correlation between signals, −1 to 1.

    Raises
    ------
    ValueError
        For values that are negative (ceiling: not positive), a Weber fraction and a floor that
        are both 0, a correlation outside −1 … 1.

    Examples
    --------
    >>> noise = GeneralisedWeber(0.1, floor=0.3, ceiling=10.0)
    >>> noise.sd([4.0, 40.0]).round(3), noise.saturated([4.0, 40.0])
    (array([0.5  , 1.044]), array([False,  True]))
    """

    weber_fraction: Array
    floor: Array
    ceiling: Array
    correlation: float

    def __init__(
        self,
        weber_fraction: ArrayLike = 0.1,
        *,
        floor: ArrayLike,
        ceiling: ArrayLike | Sequence[float | None] | None = np.inf,
        correlation: float = 0.0,
    ) -> None:
        k = non_negative("weber_fraction", weber_fraction, "write 0.1, say")
        floor = non_negative("floor", floor, "write it in the unit of the signal")
        if np.any((k == 0) & (floor == 0)):
            raise Refusal(
                "A signal without noise has no likelihood",
                "weber_fraction 0 and floor 0",
                "write one of them above zero",
            )
        each = np.asarray(ceiling, dtype=object)
        limit = numbers("ceiling", np.where(each == None, np.inf, each), "write None for none")  # noqa: E711
        positive("ceiling", np.where(limit == np.inf, 1.0, limit), "write None for no ceiling")
        self._set(
            weber_fraction=k,
            floor=floor,
            ceiling=limit,
            correlation=checked_correlation(correlation),
        )

    @property
    def is_scale_family(self) -> bool:
        """Without a floor and a ceiling, where this is `Weber`'s law."""
        return not np.any(self.floor) and bool(np.all(np.isinf(self.ceiling)))

    @property
    def is_smooth(self) -> bool:
        """Without a ceiling, where the mean of readings has a kink."""
        return bool(np.all(np.isinf(self.ceiling)))

    def without_floor(self) -> GeneralisedWeber:
        """Without the floor, but of signals whose noise is a floor alone."""
        return replace(self, floor=np.where(np.asarray(self.weber_fraction) > 0, 0.0, self.floor))

    def uninformative(self, signals: Array) -> Flags:
        return self.saturated(signals)

    def saturated(self, signals: ArrayLike) -> Flags:
        """Where a signal lies above the ceiling, (..., S)."""
        return np.abs(np.asarray(signals, dtype=float)) > self.ceiling

    def mean(self, signals: ArrayLike) -> Array:
        """The signal, or the ceiling where it is saturated, (..., S)."""
        return np.clip(np.asarray(signals, dtype=float), -self.ceiling, self.ceiling)

    def sd(self, signals: ArrayLike) -> Array:
        """√(floor² + (k·signal)²), (..., S)."""
        if not np.any(self.weber_fraction):
            return np.broadcast_to(self.floor, np.shape(signals)).astype(float)
        return np.hypot(self.floor, self.weber_fraction * self.mean(signals))

    def _mean_slope(self, signals: Array) -> Array:
        return np.where(self.saturated(signals), 0.0, 1.0)

    def slopes(self, signals: Array) -> tuple[Array, Array]:
        slope = self._mean_slope(signals)
        return slope, slope * self.weber_fraction**2 * self.mean(signals) / self.sd(signals)


@dataclass(frozen=True, eq=False, repr=False, init=False)
class Saturating(GeneralisedWeber):
    """Weber's law on a response that levels off: sd² = floor² + (k·response)².

    The mean reading is I/(1 + (|I|/ceiling)ᵖ)^(1/p): the signal itself far below the ceiling, the
    ceiling far above. With p = 1 this is the Naka–Rushton function ceiling·I/(ceiling + I); the
    larger p, the sharper the bend, and p → ∞ is the hard ceiling of `GeneralisedWeber`.

    Parameters
    ----------
    weber_fraction : float or sequence of float
        k, one for all signals or one each.
    ceiling : float or sequence of float
        Largest response, in the unit of each signal; at a signal of the same size the response
        is 2^(−1/p) of it.
    sharpness : float
        p.
    floor : float or sequence of float
        Receptor threshold noise σ₀, in the unit of each signal.
    correlation : float
        Correlation between signals, −1 to 1.

    Raises
    ------
    ValueError
        For a Weber fraction, ceiling or sharpness that is not positive, a negative floor, a
        correlation outside −1 … 1.

    Notes
    -----
    d mean/dI = (1 + (|I|/ceiling)ᵖ)^(−1−1/p), so the information about ln I far above the ceiling
    falls as (ceiling/I)²ᵖ: every further JND costs a larger ratio of signals. Naka & Rushton
    (1966), J. Physiol. 185, 536; the family in p is an assumption between it and the hard ceiling.

    Examples
    --------
    >>> noise = Saturating(0.1, ceiling=10.0)
    >>> noise.mean([0.1, 10.0, 1000.0]).round(3), noise.saturated([0.1, 10.0, 1000.0])
    (array([0.099, 5.   , 9.901]), array([False, False,  True]))
    """

    sharpness: float

    def __init__(
        self,
        weber_fraction: ArrayLike = 0.1,
        *,
        floor: ArrayLike = 0.0,
        ceiling: ArrayLike | Sequence[float | None],
        correlation: float = 0.0,
        sharpness: float = 1.0,
    ) -> None:
        super().__init__(weber_fraction, floor=floor, ceiling=ceiling, correlation=correlation)
        self._set(sharpness=number("sharpness", sharpness, "write 1 for Naka–Rushton"))
        positive("sharpness", sharpness, "write 1 for Naka–Rushton")
        if np.any(np.isinf(self.ceiling)):
            raise Refusal(
                "A response that levels off needs a ceiling", "none", "write GeneralisedWeber"
            )

    @property
    def is_scale_family(self) -> bool:
        """Never: the response bends."""
        return False

    is_smooth = True

    def uninformative(self, signals: Array) -> Flags:
        """Nowhere: the response rises for ever."""
        return np.zeros(np.shape(signals), dtype=bool)

    def mean(self, signals: ArrayLike) -> Array:
        """The response, (..., S)."""
        return np.asarray(signals, dtype=float) * np.exp(self._log_ratio(signals))

    def _log_ratio(self, signals: ArrayLike) -> Array:
        """ln of response/signal, −ln(1 + (|I|/ceiling)ᵖ)/p, without overflow."""
        with np.errstate(divide="ignore"):
            excess = self.sharpness * np.log(np.abs(np.asarray(signals)) / self.ceiling)
        return np.asarray(-np.logaddexp(0.0, excess) / self.sharpness)

    def _mean_slope(self, signals: Array) -> Array:
        return np.asarray(np.exp((1 + self.sharpness) * self._log_ratio(signals)))


def checked_correlation(value: float) -> float:
    """A correlation, refused outside −1 … 1."""
    rho = number("correlation", value, "write a number from -1 to 1")
    if not -1 <= rho <= 1:
        raise Refusal("correlation must lie between -1 and 1", f"{rho:g}", "write 0 for none")
    return rho
