"""What an observer needs of a noise model."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Seed = int | np.random.SeedSequence | np.random.Generator | None


@runtime_checkable
class ReceptorNoise(Protocol):
    """A noise model: S kinds of signal along the last axis, R numbers in each reading."""

    def reading_size(self, signals: int) -> int:
        """R for S = `signals` kinds of signal: S, unless readings are something else."""

    def mean(self, signals: ArrayLike) -> Array:
        """Mean of the readings, (..., R)."""

    def jacobian(self, signals: ArrayLike) -> Array:
        """d mean/d signal, (..., R, S)."""

    def sd(self, signals: ArrayLike) -> Array:
        """Standard deviation of each number of a reading, (..., R)."""

    def covariance(self, signals: ArrayLike) -> Array:
        """Covariance of the readings, (..., R, R)."""

    def interval(self, signals: ArrayLike, width: float) -> tuple[Array, Array]:
        """Readings outside are rarer than those `width` sd from a Gaussian's mean, (..., R) each.

        The chance of a number below the first, or above the second, is at most exp(−width²/2).
        """

    def log_likelihood(self, reading: ArrayLike, signals: ArrayLike) -> Array:
        """ln p(reading | signals), shape (...)."""

    def sample(self, signals: ArrayLike, seed: Seed = None) -> Array:
        """Readings of these signals, (..., R)."""

    def fisher(self, signals: ArrayLike) -> Array:
        """Fisher information of a reading about the signals, (..., S, S)."""
