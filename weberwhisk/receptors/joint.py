"""Noise of several groups of receptors, each with a model of its own."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._checks import shown, whole
from .protocol import Array, Component, ReceptorNoise, Seed


@dataclass(frozen=True, eq=False, repr=False)
class Joint(ReceptorNoise):
    """Independent groups of receptors, one noise model for each group of signals.

    Parameters
    ----------
    noises : sequence of ReceptorNoise
    sizes : sequence of int
        How many of the signals, in order, each model is of.

    Raises
    ------
    ValueError
        For other than one size for each model, sizes below 1, models that are none.

    Examples
    --------
    >>> from weberwhisk.receptors import Weber
    >>> noise = Joint([Weber(0.1), Weber(0.5)], sizes=[1, 2])
    >>> noise.sd([2.0, 2.0, 4.0])
    array([0.2, 1. , 2. ])
    """

    noises: Sequence[ReceptorNoise]
    sizes: Sequence[int]

    def __post_init__(self) -> None:
        hint = "write Joint([Weber(0.1), Weber(0.5)], sizes=[1, 2]), say"
        for name in ("noises", "sizes"):
            if not np.iterable(getattr(self, name)) or isinstance(getattr(self, name), str):
                raise ValueError(
                    f"{name} must be a list, got {shown(getattr(self, name))}; {hint}."
                )
        noises, sizes = tuple(self.noises), tuple(self.sizes)
        if len(noises) != len(sizes) or not noises:
            raise ValueError(
                f"Every noise model needs its number of signals, got {len(noises)} models and "
                f"sizes {list(sizes)}; write sizes=[1, 2], say."
            )
        for noise in noises:
            if not isinstance(noise, ReceptorNoise):
                raise ValueError(f"noises must be noise models, got {shown(noise)}; {hint}.")
        self._set(noises=noises, sizes=tuple(whole("sizes", n, hint) for n in sizes))

    def __repr__(self) -> str:
        return f"Joint([{', '.join(map(repr, self.noises))}], sizes={list(self.sizes)})"

    # -- what it is made of --------------------------------------------------------------------

    @property
    def is_categorical(self) -> bool:  # type: ignore[override]
        """Whether all of its models are."""
        return all(noise.is_categorical for noise in self.noises)

    @property
    def reads_signals(self) -> bool:  # type: ignore[override]
        """Whether all of its models do."""
        return all(noise.reads_signals for noise in self.noises)

    @property
    def is_scale_family(self) -> bool:
        """Whether all of its models are."""
        return all(noise.is_scale_family for noise in self.noises)

    def components(self, signals: int) -> tuple[Component, ...]:
        """The models, those of a joint one among them one by one."""
        return self._components

    @cached_property
    def _components(self) -> tuple[Component, ...]:
        out, row, column = [], 0, 0
        for noise, size in zip(self.noises, self.sizes, strict=True):
            for own, s, r in noise.components(size):
                signals = slice(column + s.start, column + s.stop)
                out.append(Component(own, signals, slice(row + r.start, row + r.stop)))
            row, column = row + noise.reading_size(size), column + size
        return tuple(out)

    def part(self, signals: int, start: int, stop: int) -> ReceptorNoise | None:
        """The model, or the models, of signals start … stop."""
        ends = [0, *accumulate(self.sizes)]
        for noise, low, high in zip(self.noises, ends[:-1], ends[1:], strict=True):
            if low <= start and stop <= high:
                return noise.part(high - low, start - low, stop - low)
        if start not in ends or stop not in ends:
            return None
        first, last = ends.index(start), ends.index(stop)
        return Joint(self.noises[first:last], self.sizes[first:last])

    def weber_fractions(self, signals: int) -> Array:
        """Those of the models, (S,)."""
        every = [
            c.noise.weber_fractions(c.signals.stop - c.signals.start) for c in self._components
        ]
        return np.concatenate(every)

    def floors(self, signals: int) -> Array:
        """Those of the models, (S,)."""
        every = [c.noise.floors(c.signals.stop - c.signals.start) for c in self._components]
        return np.concatenate(every)

    def with_weber_fraction(self, weber_fraction: ArrayLike) -> Joint:
        """The same models with another Weber fraction, one or one for each signal."""
        k = np.asarray(weber_fraction, dtype=float)
        each = [k] * len(self.sizes)
        if k.ndim:
            each = np.split(np.broadcast_to(k, sum(self.sizes)), np.cumsum(self.sizes)[:-1])
        pairs = zip(self.noises, each, strict=True)
        return Joint([noise.with_weber_fraction(own) for noise, own in pairs], self.sizes)

    def without_floor(self) -> Joint:
        """The same models with no noise but what grows with the signal."""
        return Joint([noise.without_floor() for noise in self.noises], self.sizes)

    def uninformative(self, signals: Array) -> NDArray[np.bool_]:
        """That of each model, (..., S)."""
        return np.concatenate([n.uninformative(s) for n, s in self.parts(signals)], axis=-1)

    def resolution(self, signals: Array) -> tuple[Array, Array]:
        """That of each model, one after the other."""
        both = [noise.resolution(part) for noise, part in self.parts(signals)]
        place, step = (np.concatenate(side, axis=-1) for side in zip(*both, strict=True))
        return place, step

    def parts(self, signals: ArrayLike) -> list[tuple[ReceptorNoise, Array]]:
        """Each component with its own signals, (..., S_i)."""
        array = np.asarray(signals, dtype=float)
        if array.shape[-1] != sum(self.sizes):
            raise ValueError(
                f"This noise is of {sum(self.sizes)} signals, got {array.shape[-1]}; "
                "write sizes that add up to the cue's signals."
            )
        return [(c.noise, array[..., c.signals]) for c in self._components]

    def apart(
        self, reading: ArrayLike, signals: ArrayLike
    ) -> list[tuple[ReceptorNoise, Array, Array]]:
        """Each component with its own readings, (..., R_i), and signals, (..., S_i)."""
        array = np.asarray(reading, dtype=float)
        own = [array[..., c.readings] for c in self._components]
        return [(n, y, s) for y, (n, s) in zip(own, self.parts(signals), strict=True)]

    def reading_size(self, signals: int) -> int:
        """The readings of all models."""
        return self._components[-1].readings.stop

    def mean(self, signals: ArrayLike) -> Array:
        """Mean of the readings, (..., R)."""
        return np.concatenate([n.mean(s) for n, s in self.parts(signals)], axis=-1)

    def sd(self, signals: ArrayLike) -> Array:
        """Standard deviation of each number of a reading, (..., R)."""
        return np.concatenate([n.sd(s) for n, s in self.parts(signals)], axis=-1)

    def jacobian(self, signals: ArrayLike) -> Array:
        """d mean/d signal, (..., R, S): one block a model."""
        return _blocks([n.jacobian(s) for n, s in self.parts(signals)])

    def covariance(self, signals: ArrayLike) -> Array:
        """Covariance of the readings, (..., R, R): one block a model."""
        return _blocks([n.covariance(s) for n, s in self.parts(signals)])

    def fisher(self, signals: ArrayLike) -> Array:
        """Fisher information about the signals, (..., S, S): one block a model."""
        return _blocks([n.fisher(s) for n, s in self.parts(signals)])

    def interval(self, signals: ArrayLike, width: float) -> tuple[Array, Array]:
        """Readings outside are rarer than those `width` sd from a Gaussian's mean, (..., R)."""
        ends = [noise.interval(part, width) for noise, part in self.parts(signals)]
        low, high = (np.concatenate(side, axis=-1) for side in zip(*ends, strict=True))
        return low, high

    def log_likelihood(self, reading: ArrayLike, signals: ArrayLike) -> Array:
        """ln p(reading | signals), shape (...): the sum over the models."""
        first, *others = (n.log_likelihood(y, s) for n, y, s in self.apart(reading, signals))
        return sum(others, start=first)

    def prepared(self, signals: Array) -> Callable[[Array, NDArray[np.intp]], Array]:
        """`log_likelihood` at a table of signals (P, ..., S): the sum over the models."""
        parts = [(c.readings, c.noise.prepared(signals[..., c.signals])) for c in self._components]

        def log_likelihood(reading: Array, index: NDArray[np.intp]) -> Array:
            first, *others = (part(reading[:, columns], index) for columns, part in parts)
            return sum(others, start=first)

        return log_likelihood

    def log_likelihoods(self, reading: Array, signals: Array) -> Array:
        """`log_likelihood` of readings (B, R) at signals (N, S), (B, N): summed over models."""
        first, *others = (n.log_likelihoods(y, s) for n, y, s in self.apart(reading, signals))
        return sum(others, start=first)

    def sample(self, signals: ArrayLike, seed: Seed = None) -> Array:
        """Readings of these signals, (..., R)."""
        rng = np.random.default_rng(seed)
        return np.concatenate([n.sample(s, rng) for n, s in self.parts(signals)], axis=-1)


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
