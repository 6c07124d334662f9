"""What a stimulus feels like: the mean of its signal, and its noise per unit Weber fraction.

A percept is the only thing a fit knows about a stimulus. Anything with the four members of
`Percept` will do; the whisker enters through `CuePercept` alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _checks
from .cue_percept import CuePercept

Array = NDArray[np.float64]

NOISES = ("weber", "equal-variance")


class Percept(Protocol):
    """A stimulus as it is felt: what every observer model asks of it."""

    @property
    def direction(self) -> int:
        """+1 where a greater stimulus gives a greater signal, −1 where it gives a smaller one."""

    @property
    def domain(self) -> tuple[float, float]:
        """The stimuli that can be felt, (lowest, highest), in the stimulus's own unit."""

    def mean(self, stimulus: ArrayLike) -> Array:
        """Mean signal at each stimulus."""

    def unit_sd(self, stimulus: ArrayLike) -> Array:
        """Noise sd of the signal at each stimulus, for a Weber fraction of 1."""


@runtime_checkable
class FlooredPercept(Percept, Protocol):
    """A percept with noise that stays where the signal vanishes."""

    def floor_sd(self, stimulus: ArrayLike) -> Array:
        """The part of the noise sd that does not go with the Weber fraction."""


@dataclass(frozen=True)
class IdentityPercept:
    """The magnitude itself, with sd = k × magnitude (Weber noise); any unit, all above zero.

    Examples
    --------
    >>> IdentityPercept().unit_sd([1.0, 2.0])
    array([1., 2.])
    """

    direction: int = 1
    domain: tuple[float, float] = (0.0, np.inf)

    def mean(self, stimulus: ArrayLike) -> Array:
        return np.asarray(stimulus, dtype=float)

    def unit_sd(self, stimulus: ArrayLike) -> Array:
        return np.asarray(stimulus, dtype=float)


@dataclass(frozen=True)
class LogPercept:
    """A stimulus given by its logarithm: magnitude = exp(log_unit × column), sd = k × magnitude.

    An additive constant in the column cancels, as only ratios matter under Weber's law.

    Parameters
    ----------
    log_unit : float
        Natural-log units in one unit of the column: 1 for natural logs, ln 10 for decades,
        ln(10)/20 for the amplitude of a level in decibels.

    Examples
    --------
    >>> LogPercept().mean([0.0, 0.0])
    array([1., 1.])
    """

    log_unit: float = 1.0
    direction: int = 1
    domain: tuple[float, float] = (-np.inf, np.inf)

    def __post_init__(self) -> None:
        _checks.positive("log_unit", self.log_unit, "give natural-log units per unit of the column")

    def mean(self, stimulus: ArrayLike) -> Array:
        return np.exp(self.log_unit * np.asarray(stimulus, dtype=float))

    def unit_sd(self, stimulus: ArrayLike) -> Array:
        return self.mean(stimulus)


@dataclass(frozen=True)
class LogAxisPercept:
    """The logarithm itself, with one sd everywhere: the textbook equal-variance form.

    With `log_unit = 1` the Weber fraction is counted *per unit of the column*: the choice left when
    that unit is unknown, and the limit of `LogPercept` for steps small against a natural-log unit.

    Examples
    --------
    >>> LogAxisPercept().unit_sd([-1.0, 1.0])
    array([1., 1.])
    """

    log_unit: float = 1.0
    direction: int = 1
    domain: tuple[float, float] = (-np.inf, np.inf)

    def __post_init__(self) -> None:
        _checks.positive("log_unit", self.log_unit, "give natural-log units per unit of the column")

    def mean(self, stimulus: ArrayLike) -> Array:
        return self.log_unit * np.asarray(stimulus, dtype=float)

    def unit_sd(self, stimulus: ArrayLike) -> Array:
        return np.ones_like(np.asarray(stimulus, dtype=float))


def chosen_percept(percept: Percept | None, observer: Any) -> Percept | None:
    """The percept given, directly or as an observer; None where there is neither."""
    if percept is not None and observer is not None:
        raise ValueError("percept and observer were both given; give one of them.")
    if observer is not None:
        return CuePercept(observer)
    if percept is not None:
        _checks.kind("percept", percept, "a Percept", "unit_sd", "write IdentityPercept(), say")
    return percept


def refuse_outside(percept: Percept, stimulus: ArrayLike) -> None:
    """Refuse stimuli that no observer can feel, such as negative magnitudes."""
    stimuli, (low, high) = np.ravel(np.asarray(stimulus, dtype=float)), percept.domain
    outside = ~((stimuli > low) & (stimuli < high))
    if outside.any():
        raise ValueError(
            f"stimulus {stimuli[outside][0]:g} lies outside what can be felt, {low:g} to {high:g}; "
            "choose other standards or comparisons."
        )


def refuse_unfelt(percept: Percept, stimulus: ArrayLike) -> None:
    """Refuse stimuli that give no signal.

    Raises
    ------
    ValueError
        Naming the first such stimulus, how many there are, and why.
    """
    levels = np.unique(np.asarray(stimulus, dtype=float))
    felt = np.isfinite(percept.mean(levels)) & np.isfinite(percept.unit_sd(levels))
    if felt.all():
        return
    first = float(levels[~felt][0])
    why = f" ({percept.outcome(first)})" if isinstance(percept, CuePercept) else ""
    raise ValueError(
        f"{int((~felt).sum())} of {levels.size} stimuli give no signal, the first being "
        f"{first:g}{why}; leave those trials out, or change the whisker or the cue."
    )


class UnitPercepts(NamedTuple):
    """The two percepts of each cell, a greater stimulus giving a greater mean; arrays (C,).

    The sds are for a Weber fraction of 1; floors do not go with it, and add in variance.
    """

    mean_1: Array
    sd_1: Array
    mean_2: Array
    sd_2: Array
    floor_1: ArrayLike = 0.0
    floor_2: ArrayLike = 0.0

    def felt(self, weber_fraction: ArrayLike) -> Signals:
        """Both signals with the noise of an observer, (..., C) for a Weber fraction (...)."""
        k = np.asarray(weber_fraction, dtype=float)[..., None]
        sd_1, sd_2 = k * self.sd_1, k * self.sd_2
        if self.has_floor:
            sd_1, sd_2 = np.hypot(sd_1, self.floor_1), np.hypot(sd_2, self.floor_2)
        return Signals(self.mean_1, sd_1, self.mean_2, sd_2)

    @property
    def has_floor(self) -> bool:
        """Whether any noise is left at a Weber fraction of nothing."""
        return bool(np.any(self.floor_1) or np.any(self.floor_2))

    def of(self, which: NDArray[np.bool_] | NDArray[np.intp]) -> UnitPercepts:
        """Some of the cells."""
        return UnitPercepts(*(np.broadcast_to(a, self.mean_1.shape)[which] for a in self))


class Signals(NamedTuple):
    """The two noisy signals of each cell: means and sds, and a push towards "second greater".

    `push` adds to the decision variable, in its sds. Arrays that broadcast to (..., C).
    """

    mean_1: Array
    sd_1: Array
    mean_2: Array
    sd_2: Array
    push: Array | float = 0.0


def unit_percepts(
    percept: Percept,
    stimulus_1: ArrayLike,
    stimulus_2: ArrayLike,
    standard: ArrayLike,
    noise: str = "weber",
) -> UnitPercepts:
    """Both percepts of every cell.

    Parameters
    ----------
    percept : Percept
        How a stimulus is felt.
    stimulus_1, stimulus_2, standard : array_like, shape (C,)
        In the stimulus's own unit.
    noise : {"weber", "equal-variance"}
        "weber": each interval has the sd of its own stimulus, as a receptor has. "equal-variance":
        both have the sd of the standard, the textbook form.

    Examples
    --------
    >>> unit_percepts(IdentityPercept(), [1.0], [1.1], [1.0], "equal-variance").sd_2
    array([1.])
    """
    _checks.one_of("noise", noise, NOISES)
    s1, s2, s0 = np.broadcast_arrays(
        *(np.asarray(s, float) for s in (stimulus_1, stimulus_2, standard))
    )
    sign = percept.direction
    if noise == "weber":
        sd_1, sd_2 = percept.unit_sd(s1), percept.unit_sd(s2)
    else:
        sd_1 = sd_2 = percept.unit_sd(s0)
    means = sign * percept.mean(s1), sign * percept.mean(s2)
    if not isinstance(percept, FlooredPercept):
        return UnitPercepts(means[0], sd_1, means[1], sd_2)
    floors = [percept.floor_sd(s) for s in ((s1, s2) if noise == "weber" else (s0, s0))]
    return UnitPercepts(means[0], sd_1, means[1], sd_2, *floors)


def percept_for(scale: str, log_unit: float | None, noise: str) -> Percept:
    """The percept a table of magnitudes calls for, when no whisker stands between.

    Examples
    --------
    >>> percept_for("log", 1.0, "weber")
    LogPercept(log_unit=1.0, direction=1, domain=(-inf, inf))
    """
    _checks.one_of("noise", noise, NOISES)
    if scale == "linear":
        return IdentityPercept()
    if log_unit is None or noise == "equal-variance":
        return LogAxisPercept(1.0 if log_unit is None else log_unit)
    return LogPercept(log_unit)
