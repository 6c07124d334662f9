"""What a stimulus feels like: the mean of its signal, and its noise per unit Weber fraction.

A percept is the only thing a fit knows about a stimulus. Anything with the four members of
`Percept` will do; the whisker enters through `CuePercept` alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _checks
from ..jnd import weber_propagation
from ..mechanics.contact import Outcome
from ..observer import Observer

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


@dataclass(frozen=True)
class CuePercept:
    """A radial distance felt through a whisker and a cue.

    One signal (the compliance cue): the two noisy signals are the decision variables, exactly.
    Several signals (the moment–axial-force map): noise is carried to the distance to first order,
    so the percept is the distance, with the propagated JND as its sd.

    Parameters
    ----------
    observer : Observer
        Its whisker and cue. Its noise says only how the Weber fractions of several signals go
        together: the fraction that is fitted is that of the first.
    deflection_angle : float, optional
        rad; of every contact, where the cue does not know it.
    unit : float
        Metres in one unit of the stimulus: 1e-3 where trials are in millimetres.

    Raises
    ------
    ValueError
        For a unit that is not positive, and where the cue needs a deflection angle.

    Examples
    --------
    >>> from weberwhisk import Observer, Whisker, cues
    >>> observer = Observer(Whisker(50e-3, 100e-6, 5e-6), cues.Compliance())
    >>> CuePercept(observer, unit=1e-3).direction
    -1
    """

    observer: Observer
    deflection_angle: float | None = None
    unit: float = 1.0

    def __post_init__(self) -> None:
        _checks.positive("unit", self.unit, "give metres per unit of the stimulus, such as 1e-3")
        if "deflection_angle" in self.observer.unknowns and self.deflection_angle is None:
            raise ValueError(
                f"{self.observer.cue!r} needs the deflection angle of the contacts, got none; "
                "write deflection_angle=np.radians(10), say."
            )

    @property
    def domain(self) -> tuple[float, float]:
        return (0.0, float(self.observer.whisker.length) / self.unit)

    @property
    def direction(self) -> int:
        return -1 if self._one_signal else 1

    @property
    def _one_signal(self) -> bool:
        return len(self.observer.cue.signal_names) == 1

    def _contact(self, stimulus: ArrayLike) -> Array:
        r = np.asarray(stimulus, dtype=float) * self.unit
        columns = [r, np.full_like(r, self.deflection_angle or 0.0)]
        return np.stack(columns[: len(self.observer.unknowns)], axis=-1)

    def mean(self, stimulus: ArrayLike) -> Array:
        signals, outcome = self.observer.signals(self._contact(stimulus))
        if self._one_signal:
            return np.asarray(signals[..., 0])
        return np.where(outcome == Outcome.HELD, np.asarray(stimulus, dtype=float), np.nan)

    def unit_sd(self, stimulus: ArrayLike) -> Array:
        if self._one_signal:
            return np.abs(self.mean(stimulus))
        first = np.ravel(getattr(self.observer.noise, "weber_fraction", 1.0))[0]
        jnd = weber_propagation(self.observer, self._contact(stimulus)) / (first * self.unit)
        # Signals that cannot tell distance (a cylinder's map) leave nothing to judge by.
        return np.where(np.isfinite(jnd), jnd, np.nan)

    def outcome(self, stimulus: float) -> str:
        """What becomes of the contact at one distance, in words."""
        outcome = Outcome(int(self.observer.signals(self._contact(stimulus))[1]))
        if outcome == Outcome.HELD:
            return "these signals cannot tell distance on this whisker"
        return outcome.message


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

    The sds are for a Weber fraction of 1.
    """

    mean_1: Array
    sd_1: Array
    mean_2: Array
    sd_2: Array


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
    return UnitPercepts(sign * percept.mean(s1), sd_1, sign * percept.mean(s2), sd_2)


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
