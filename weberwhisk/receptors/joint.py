"""Noise of several groups of receptors, each with a model of its own."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike

from .protocol import Array, ReceptorNoise, Seed


class Joint:
    """Independent groups of receptors, one noise model for each group of signals.

    Parameters
    ----------
    noises : sequence of ReceptorNoise
    sizes : sequence of int
        How many of the signals, in order, each model is of.

    Raises
    ------
    ValueError
        For other than one size for each model, and sizes below 1.

    Examples
    --------
    >>> from weberwhisk.receptors import Weber
    >>> noise = Joint([Weber(0.1), Weber(0.5)], sizes=[1, 2])
    >>> noise.sd([2.0, 2.0, 4.0])
    array([0.2, 1. , 2. ])
    """

    def __init__(self, noises: Sequence[ReceptorNoise], sizes: Sequence[int]) -> None:
        self.noises, self.sizes = tuple(noises), tuple(int(n) for n in sizes)
        if len(self.noises) != len(self.sizes) or not self.noises or min(self.sizes) < 1:
            raise ValueError(
                f"Every noise model needs its number of signals, got {len(self.noises)} models and "
                f"sizes {list(self.sizes)}; write sizes=[1, 2], say."
            )

    def __repr__(self) -> str:
        return f"Joint([{', '.join(map(repr, self.noises))}], sizes={list(self.sizes)})"

    def _signals(self, signals: ArrayLike) -> list[Array]:
        """The signals of each model, (..., S_i)."""
        array = np.asarray(signals, dtype=float)
        if array.shape[-1] != sum(self.sizes):
            raise ValueError(
                f"This noise is of {sum(self.sizes)} signals, got {array.shape[-1]}; "
                "write sizes that add up to the cue's signals."
            )
        return np.split(array, np.cumsum(self.sizes)[:-1], axis=-1)

    def parts(self, signals: ArrayLike) -> list[tuple[ReceptorNoise, Array]]:
        """Each model with its own signals, (..., S_i)."""
        return list(zip(self.noises, self._signals(signals), strict=True))

    def _readings(self, reading: ArrayLike) -> list[Array]:
        """The readings of each model, (..., R_i)."""
        counts = [n.reading_size(s) for n, s in zip(self.noises, self.sizes, strict=True)]
        return np.split(np.asarray(reading, dtype=float), np.cumsum(counts)[:-1], axis=-1)

    def each(
        self, function: Callable[[ReceptorNoise, Array], Array], signals: ArrayLike
    ) -> list[Array]:
        """A function of every model and its signals."""
        return [function(noise, part) for noise, part in self.parts(signals)]

    def reading_size(self, signals: int) -> int:
        """The readings of all models."""
        pairs = zip(self.noises, self.sizes, strict=True)
        return sum(noise.reading_size(size) for noise, size in pairs)

    def mean(self, signals: ArrayLike) -> Array:
        """Mean of the readings, (..., R)."""
        return np.concatenate(self.each(lambda n, s: n.mean(s), signals), axis=-1)

    def sd(self, signals: ArrayLike) -> Array:
        """Standard deviation of each number of a reading, (..., R)."""
        return np.concatenate(self.each(lambda n, s: n.sd(s), signals), axis=-1)

    def jacobian(self, signals: ArrayLike) -> Array:
        """d mean/d signal, (..., R, S): one block a model."""
        return _blocks(self.each(lambda n, s: n.jacobian(s), signals))

    def covariance(self, signals: ArrayLike) -> Array:
        """Covariance of the readings, (..., R, R): one block a model."""
        return _blocks(self.each(lambda n, s: n.covariance(s), signals))

    def fisher(self, signals: ArrayLike) -> Array:
        """Fisher information about the signals, (..., S, S): one block a model."""
        return _blocks(self.each(lambda n, s: n.fisher(s), signals))

    def interval(self, signals: ArrayLike, width: float) -> tuple[Array, Array]:
        """Readings outside are rarer than those `width` sd from a Gaussian's mean, (..., R)."""
        ends = [noise.interval(part, width) for noise, part in self.parts(signals)]
        low, high = (np.concatenate(side, axis=-1) for side in zip(*ends, strict=True))
        return low, high

    def apart(
        self, reading: ArrayLike, signals: ArrayLike
    ) -> list[tuple[ReceptorNoise, Array, Array]]:
        """Each model with its own readings, (..., R_i), and signals, (..., S_i)."""
        return list(zip(self.noises, self._readings(reading), self._signals(signals), strict=True))

    def log_likelihood(self, reading: ArrayLike, signals: ArrayLike) -> Array:
        """ln p(reading | signals), shape (...): the sum over the models."""
        first, *others = (n.log_likelihood(y, s) for n, y, s in self.apart(reading, signals))
        for value in others:
            first = first + value
        return first

    def sample(self, signals: ArrayLike, seed: Seed = None) -> Array:
        """Readings of these signals, (..., R)."""
        rng = np.random.default_rng(seed)
        return np.concatenate(self.each(lambda n, s: n.sample(s, rng), signals), axis=-1)


def _blocks(matrices: list[Array]) -> Array:
    """Matrices (..., m, n) down the diagonal of one."""
    shape = np.broadcast_shapes(*(m.shape[:-2] for m in matrices))
    size = [sum(m.shape[axis] for m in matrices) for axis in (-2, -1)]
    out = np.zeros((*shape, *size))
    row = column = 0
    for m in matrices:
        out[..., row : row + m.shape[-2], column : column + m.shape[-1]] = m
        row, column = row + m.shape[-2], column + m.shape[-1]
    return out
