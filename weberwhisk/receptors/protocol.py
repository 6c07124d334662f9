"""What the rest of the package asks of a noise model; `ReceptorNoise` says how to write one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property, reduce
from itertools import accumulate
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from .._util.checks import several, shown, whole
from .._util.refusals import Refusal
from .._util.values import Array, Flags, Seed, Value

__all__ = ["Component", "Joint", "ReceptorNoise", "Seed"]


class Component(NamedTuple):
    """One independent part of a noise model, and where its signals and readings stand."""

    noise: ReceptorNoise
    signals: slice
    readings: slice


class ReceptorNoise(Value):
    """A noise model: S kinds of signal along the last axis, R numbers in each reading.

    A law of Gaussian noise is a frozen dataclass of `Gaussian` with its sd, and nothing more::

        @dataclass(frozen=True, eq=False, repr=False)
        class SquareRoot(Gaussian):
            size: float = 0.1
            correlation: float = 0.0

            def sd(self, signals):
                return self.size * np.sqrt(np.abs(signals))

    Any other derives from `ReceptorNoise` and has `mean`, `sd`, `jacobian`, `interval`,
    `log_likelihood`, `sample` and `fisher`; the rest has defaults. A field called `weber_fraction`
    is taken for a dimensionless k to which the sd is proportional but for a floor, as in
    sd² = (k·I)² + floor²; it is varied by fits, and held against the domain as sd/|I|, so that
    sd/|I| must be near k at usual contacts. `floor` is the sd at no signal, in the signal's unit.
    Call anything else otherwise (`size`, `coefficient`): of such a law sd/|I| at usual contacts is
    held against the domain. A
    law for others to use has an `__init__` that refuses junk in one sentence, by `_util.checks`.
    Models are values: they compare and hash by their fields.
    """

    _always_printed: ClassVar[tuple[str, ...]] = ("weber_fraction",)
    #: Whether a reading is one of a few reports, of which the signals are the probabilities.
    is_categorical: ClassVar[bool] = False
    #: Whether a reading is of the signals themselves, so that a cue's own inverse can take it.
    reads_signals: bool = True
    #: Readings are Gaussian as they are ("linear"), their logarithms are ("log"), or neither.
    gaussian_on: ClassVar[Literal["linear", "log"] | None] = None

    @property
    def is_smooth(self) -> bool:
        """Whether the likelihood is a smooth function of the signals, without kinks."""
        return not self.is_categorical

    def mean(self, signals: ArrayLike) -> Array:
        """Mean of the readings, (..., R)."""
        raise NotImplementedError

    def sd(self, signals: ArrayLike) -> Array:
        """Standard deviation of each number of a reading, (..., R)."""
        raise NotImplementedError

    def jacobian(self, signals: ArrayLike) -> Array:
        """d mean/d signal, (..., R, S)."""
        raise NotImplementedError

    def interval(self, signals: ArrayLike, width: float) -> tuple[Array, Array]:
        """Readings outside are rarer than those `width` sd from a Gaussian's mean, (..., R) each.

        The probability of a number below the first, or above the second, is at most
        exp(−width²/2).
        """
        raise NotImplementedError

    def log_likelihood(self, reading: ArrayLike, signals: ArrayLike) -> Array:
        """ln p(reading | signals), shape (...)."""
        raise NotImplementedError

    def sample(self, signals: ArrayLike, seed: Seed = None) -> Array:
        """Readings of these signals, (..., R)."""
        raise NotImplementedError

    def fisher(self, signals: ArrayLike) -> Array:
        """Fisher information of a reading about the signals, (..., S, S)."""
        raise NotImplementedError

    def as_gaussian(self, signals: Array) -> tuple[Array, Array]:
        """Mean and sd (N, S) of `to_gaussian` of readings, where these are Gaussian."""
        raise NotImplementedError

    def to_gaussian(self, reading: Array) -> tuple[Array, Array]:
        """Readings (B, S) on the axis on which they are Gaussian, and ln of its slope (B,)."""
        raise NotImplementedError

    def gaussian_root(self, size: int) -> Array:
        """Upper triangular; of the deviations in sds there it makes numbers without correlation."""
        raise NotImplementedError

    def reading_size(self, signals: int) -> int:
        """R for S = `signals` kinds of signal: S, unless readings are something else."""
        return signals

    def covariance(self, signals: ArrayLike) -> Array:
        """Covariance of the readings, (..., R, R): by default they are independent."""
        sd = self.sd(signals)
        return np.asarray(sd[..., None] ** 2 * np.eye(sd.shape[-1]))

    def components(self, signals: int) -> tuple[Component, ...]:
        """The independent parts of which the noise of S = `signals` consists; itself, mostly."""
        return (Component(self, slice(0, signals), slice(0, self.reading_size(signals))),)

    def part(self, signals: int, start: int, stop: int) -> ReceptorNoise | None:
        """The noise of signals start … stop of S alone; None where it depends on the rest.

        Examples
        --------
        >>> from weberwhisk.receptors import Joint, Weber
        >>> Joint([Weber(0.1), Weber(0.2)], [1, 2]).part(3, 1, 3), Weber(0.1).part(3, 1, 3)
        (Weber(0.2), None)
        """
        return self if (start, stop) == (0, signals) else None

    def weber_fractions(self, signals: int) -> Array:
        """Weber fraction of each signal, (S,), 0 where its noise has none.

        Examples
        --------
        >>> from weberwhisk.receptors import GeneralisedWeber
        >>> GeneralisedWeber([0.1, 0.0], floor=[0.0, 0.02]).weber_fractions(2)
        array([0.1, 0. ])
        """
        return np.broadcast_to(np.asarray(getattr(self, "weber_fraction", 0.0), float), signals)

    def floors(self, signals: int) -> Array:
        """Sd of the noise that is left without a signal, (S,)."""
        return np.broadcast_to(np.asarray(getattr(self, "floor", 0.0), float), signals)

    def with_weber_fraction(self, weber_fraction: ArrayLike) -> ReceptorNoise:
        """The same receptors with another Weber fraction, one or one for each signal.

        One is that of the signals that have one: what has none is left as it is.

        Examples
        --------
        >>> from weberwhisk.receptors import LogNormal
        >>> LogNormal(0.1, correlation=0.5).with_weber_fraction(0.2)
        LogNormal(0.2, correlation=0.5)
        """
        fraction = getattr(self, "weber_fraction", None)
        if fraction is None:
            return self
        k = np.asarray(weber_fraction, dtype=float)
        if k.ndim == 0:
            k = np.where(np.asarray(fraction) > 0, k, 0.0)
        elif np.ndim(fraction) == 0 and np.ptp(k) == 0:
            k = k.flat[0]
        return self._with(weber_fraction=k)

    def without_floor(self) -> ReceptorNoise:
        """The same receptors with no noise but what grows with the signal."""
        return self._with(floor=0.0)

    def uninformative(self, signals: Array) -> Flags:
        """Where a reading says nothing of its signal's size, (..., S): above a hard ceiling."""
        return np.zeros(np.shape(signals), dtype=bool)

    @property
    def is_scale_family(self) -> bool:
        """Whether a reading of c times the signals is c times a reading of them, for every c > 0.

        With `gaussian_on` = "linear" that is Weber's law: mean the signal, sd k·|signal|.
        """
        return False

    def resolution(self, signals: Array) -> tuple[Array, Array]:
        """A smooth function of the signals, (..., T), and what it must change by for one JND.

        By default mean and sd of the readings.
        """
        return self.mean(signals), self.sd(signals)

    def _with(self, **values: Any) -> Any:
        """Itself with other values of those of these fields that it has."""
        names = {f.name for f in fields(self)}  # type: ignore[arg-type]
        changed = {name: value for name, value in values.items() if name in names}
        return replace(self, **changed) if changed else self  # type: ignore[type-var]


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
        two = "[ww.receptors.Weber(0.1), ww.receptors.Weber(0.5)]"
        hint = f"write ww.receptors.Joint({two}, sizes=[1, 2]), say"
        noises = tuple(several("noises", self.noises, hint))
        sizes = tuple(several("sizes", self.sizes, hint))
        if len(noises) != len(sizes) or not noises:
            raise Refusal(
                "Every noise model needs its number of signals",
                f"{len(noises)} models and sizes {list(sizes)}",
                "write sizes=[1, 2], say",
            )
        for noise in noises:
            if not isinstance(noise, ReceptorNoise):
                raise Refusal("noises must be noise models", shown(noise), hint)
        self._set(noises=noises, sizes=tuple(whole("sizes", n, hint) for n in sizes))

    def __repr__(self) -> str:
        return f"Joint([{', '.join(map(repr, self.noises))}], sizes={list(self.sizes)})"

    @property
    def is_categorical(self) -> bool:  # type: ignore[override]
        return all(noise.is_categorical for noise in self.noises)

    @property
    def reads_signals(self) -> bool:  # type: ignore[override]
        return all(noise.reads_signals for noise in self.noises)

    @property
    def is_scale_family(self) -> bool:
        return all(noise.is_scale_family for noise in self.noises)

    def components(self, signals: int) -> tuple[Component, ...]:
        """The models, those of a joint one among them one by one."""
        return self._components

    @cached_property
    def _components(self) -> tuple[Component, ...]:
        out, row, column = [], 0, 0
        for noise, size in zip(self.noises, self.sizes, strict=True):
            for component, s, r in noise.components(size):
                signals = slice(column + s.start, column + s.stop)
                out.append(Component(component, signals, slice(row + r.start, row + r.stop)))
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
        return np.concatenate([n.weber_fractions(k) for n, k in self._sizes])

    def floors(self, signals: int) -> Array:
        return np.concatenate([n.floors(k) for n, k in self._sizes])

    @property
    def _sizes(self) -> list[tuple[ReceptorNoise, int]]:
        return [(c.noise, c.signals.stop - c.signals.start) for c in self._components]

    def with_weber_fraction(self, weber_fraction: ArrayLike) -> Joint:
        k = np.asarray(weber_fraction, dtype=float)
        each = [k] * len(self.sizes)
        if k.ndim:
            each = np.split(np.broadcast_to(k, sum(self.sizes)), np.cumsum(self.sizes)[:-1])
        pairs = zip(self.noises, each, strict=True)
        return Joint([noise.with_weber_fraction(k) for noise, k in pairs], self.sizes)

    def without_floor(self) -> Joint:
        return Joint([noise.without_floor() for noise in self.noises], self.sizes)

    def uninformative(self, signals: Array) -> Flags:
        return np.concatenate([n.uninformative(s) for n, s in self.by_component(signals)], axis=-1)

    def resolution(self, signals: Array) -> tuple[Array, Array]:
        return _joined([noise.resolution(part) for noise, part in self.by_component(signals)])

    def by_component(self, signals: ArrayLike) -> list[tuple[ReceptorNoise, Array]]:
        """Each component with its own signals, (..., S_i)."""
        array = np.asarray(signals, dtype=float)
        if array.shape[-1] != sum(self.sizes):
            raise Refusal(
                f"This noise is of {sum(self.sizes)} signals",
                array.shape[-1],
                "write sizes that add up to the cue's signals",
            )
        return [(c.noise, array[..., c.signals]) for c in self._components]

    def reading_size(self, signals: int) -> int:
        return self._components[-1].readings.stop

    def mean(self, signals: ArrayLike) -> Array:
        return np.concatenate([n.mean(s) for n, s in self.by_component(signals)], axis=-1)

    def sd(self, signals: ArrayLike) -> Array:
        return np.concatenate([n.sd(s) for n, s in self.by_component(signals)], axis=-1)

    def jacobian(self, signals: ArrayLike) -> Array:
        return _blocks([n.jacobian(s) for n, s in self.by_component(signals)])

    def covariance(self, signals: ArrayLike) -> Array:
        return _blocks([n.covariance(s) for n, s in self.by_component(signals)])

    def fisher(self, signals: ArrayLike) -> Array:
        return _blocks([n.fisher(s) for n, s in self.by_component(signals)])

    def interval(self, signals: ArrayLike, width: float) -> tuple[Array, Array]:
        return _joined([noise.interval(part, width) for noise, part in self.by_component(signals)])

    def log_likelihood(self, reading: ArrayLike, signals: ArrayLike) -> Array:
        array = np.asarray(reading, dtype=float)
        readings = [array[..., c.readings] for c in self._components]
        pairs = zip(readings, self.by_component(signals), strict=True)
        return reduce(np.add, (noise.log_likelihood(y, s) for y, (noise, s) in pairs))

    def sample(self, signals: ArrayLike, seed: Seed = None) -> Array:
        rng = np.random.default_rng(seed)
        return np.concatenate([n.sample(s, rng) for n, s in self.by_component(signals)], axis=-1)


def _joined(pairs: list[tuple[Array, Array]]) -> tuple[Array, Array]:
    first, second = (np.concatenate(side, axis=-1) for side in zip(*pairs, strict=True))
    return first, second


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
