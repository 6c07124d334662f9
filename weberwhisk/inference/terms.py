"""What receptors say of cells: the likelihood of readings, as terms that add in its logarithm."""

from __future__ import annotations

from typing import Any

import numpy as np

from .._util.values import Array, Index
from ..receptors import ReceptorNoise
from .coordinates import within_half_turn

__all__ = ["GaussianTerm", "OtherTerm"]


class GaussianTerm:
    """Signals whose readings are Gaussian, as they are or in their logarithms."""

    def __init__(self, noise: ReceptorNoise, size: int, circular: Index) -> None:
        self.components = [c for c in noise.components(size) if c.noise.gaussian_on]
        self.root = np.zeros((0, 0))
        for part in self.components:  # independent of each other
            root = part.noise.gaussian_root(part.signals.stop - part.signals.start)
            n, m = len(self.root), len(root)
            self.root = np.block([[self.root, np.zeros((n, m))], [np.zeros((m, n)), root]])
        self.size = len(self.root)
        gaussian = np.concatenate([np.arange(size)[c.signals] for c in self.components])
        #: Which of them are directions, given up to whole turns.
        self.circular = np.flatnonzero(np.isin(gaussian, circular))
        self.constant = np.log(np.diag(self.root)).sum() - 0.5 * self.size * np.log(2 * np.pi)
        inverse = np.linalg.inv(self.root)
        self.correlation = inverse @ inverse.T

    def features(self, signals: Array) -> tuple[Array, Array]:
        """Mean and sd of readings at signals (N, S), (N, size) each."""
        pairs = [part.noise.as_gaussian(signals[:, part.signals]) for part in self.components]
        mean, sd = (np.concatenate(column, axis=1) for column in zip(*pairs, strict=True))
        return mean, sd

    def readings(self, readings: Array) -> tuple[Array, Array]:
        """Readings (B, R) where they are Gaussian, (size, B), and ln of the slope there (B,)."""
        pairs = [part.noise.to_gaussian(readings[:, part.readings]) for part in self.components]
        columns, log_slope = zip(*pairs, strict=True)
        return np.concatenate(columns, axis=1).T.copy(), np.asarray(sum(log_slope))

    def off(self, reading: Array, mean: Array, k: int) -> Array:
        """By how much readings of one signal are off its means, (P,)."""
        value = reading - mean
        return within_half_turn(value) if k in self.circular else value

    def uncorrelated(self, z: Array) -> Array:
        """Values (..., size) in sds as combinations of them without correlation.

        Added up one by one: the sums of BLAS depend in the last bit on how many rows there are.
        """
        columns = [
            sum(self.root[k, i] * z[..., i] for i in np.flatnonzero(self.root[k]))
            for k in range(self.size)
        ]
        return np.stack(columns, axis=-1)

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
