"""What the animal was asked, and the probability of its answer.

Every task is brought to one form: P = λ_lo + (1 − λ_lo − λ_hi) Φ(η + bias), with the decision
variable η(k) computed by the task from the two noisy percepts. A new task is one class here.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import log_ndtr, ndtri

from .. import _checks
from .percepts import UnitPercepts

Array = NDArray[np.float64]

NODES = np.linspace(-8.5, 8.5, 115)  # of the target's noise, in sds


class Task(Protocol):
    """A question put to the observer."""

    def __hash__(self) -> int: ...

    @property
    def name(self) -> str:
        """As written in `task=`."""

    @property
    def response(self) -> str:
        """The column that holds the answer: "choice" or "correct"."""

    @property
    def lapses(self) -> tuple[str, ...]:
        """The lapse parameters that the task has."""

    @property
    def has_bias(self) -> bool:
        """Whether a response bias can show in the data."""

    @property
    def guess_rate(self) -> float | None:
        """Proportion of the answer at chance, None where lapses on either side set it."""

    def decision_variable(self, percepts: UnitPercepts, weber_fraction: ArrayLike) -> Array:
        """η: Φ(η) is the probability of the answer of an observer that never lapses."""

    def asymptotes(self, lapse_low: Array, lapse_high: Array) -> tuple[Array, Array]:
        """What is lost at either end of Φ, as (low, high)."""


@dataclass(frozen=True)
class SignedChoice:
    """Which of two is greater (farther): two noisy signals are compared, 2AFC or 2IFC.

    P(second greater) = λ_lo + (1 − λ_lo − λ_hi) Φ((I₂ − I₁)/(k √(I₁² + I₂²)) + bias): noise in
    each interval grows with the stimulus of that interval. The lower end is λ_lo, not ½.

    Examples
    --------
    >>> from weberwhisk.behaviour.percepts import IdentityPercept, unit_percepts
    >>> cell = unit_percepts(IdentityPercept(), [1.0], [1.1], [1.0])
    >>> SignedChoice().decision_variable(cell, 0.1).round(4)
    array([0.6727])
    """

    name: str = "2AFC"
    response: str = "choice"
    lapses: tuple[str, ...] = ("lapse_low", "lapse_high")
    has_bias: bool = True
    guess_rate: float | None = None

    def decision_variable(self, percepts: UnitPercepts, weber_fraction: ArrayLike) -> Array:
        m1, u1, m2, u2 = percepts
        k = np.asarray(weber_fraction, dtype=float)[..., None]
        return (m2 - m1) / np.hypot(u1, u2) / k

    def asymptotes(self, lapse_low: Array, lapse_high: Array) -> tuple[Array, Array]:
        return lapse_low, lapse_high


@dataclass(frozen=True)
class PercentCorrect:
    """Which of m is the odd one, scored right or wrong against an unsigned difference.

    The target (`stimulus_2`) is the greatest, or the least, of m noisy signals, the others being
    `stimulus_1`. Chance is 1/m; `lapse_high` is what is missing from 1 at the easiest level.

    Examples
    --------
    >>> PercentCorrect(4).guess_rate
    0.25
    """

    alternatives: int = 2
    response: str = "correct"
    lapses: tuple[str, ...] = ("lapse_high",)
    has_bias: bool = False

    @property
    def name(self) -> str:
        return f"{self.alternatives}AFC percent correct"

    @property
    def guess_rate(self) -> float:
        return 1.0 / self.alternatives

    def decision_variable(self, percepts: UnitPercepts, weber_fraction: ArrayLike) -> Array:
        m1, u1, m2, u2 = percepts
        k = np.asarray(weber_fraction, dtype=float)[..., None]
        gap = np.abs(m2 - m1)
        if self.alternatives == 2:
            return gap / np.hypot(u1, u2) / k
        # The trapezoid rule converges exponentially here: 1e-14 with these nodes.
        weights = np.exp(-0.5 * NODES**2)
        margin = (gap / k)[..., None] + np.asarray(u2)[..., None] * NODES
        others = log_ndtr(margin / np.asarray(u1)[..., None])
        missed = -np.expm1((self.alternatives - 1) * others)
        return -ndtri(missed @ (weights / weights.sum()))

    def asymptotes(self, lapse_low: Array, lapse_high: Array) -> tuple[Array, Array]:
        return lapse_high / (self.alternatives - 1), lapse_high


TASKS: dict[str, Task] = {
    "2AFC": SignedChoice("2AFC"),
    "2IFC": SignedChoice("2IFC"),
    **{f"{m}AFC percent correct": PercentCorrect(m) for m in (2, 3, 4, 5, 6, 8)},
}


def task_named(name: str) -> Task:
    """The task of that name.

    Raises
    ------
    ValueError
        For an unknown name, with the nearest one.

    Examples
    --------
    >>> task_named("2IFC").response
    'choice'
    """
    return TASKS[_checks.one_of("task", name, TASKS)]
