"""What the observer was asked: the decision variable of a trial, and the chance of the answer.

A task makes a decision variable d of two noisy signals, says how a response bias or criterion b
enters it, and what the chance of the answer is: Φ(d + b) for all but the same–different task.
Lapses then cut both ends: P = λ_lo + (1 − λ_lo − λ_hi) · chance. A new task is one class here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import log_ndtr, ndtr, ndtri

from .._util import checks
from .._util.values import Array, Fields
from .encodings import Signals

__all__ = [
    "TASKS", "PercentCorrect", "SameDifferent", "SignedChoice", "Task", "YesNo",
    "rises_on_both_sides", "task_named",
]  # fmt: skip


class Task(Fields):
    """A question put to the observer; by default one normal variable exceeds another, or not.

    `name` is written in `task=`; `response` is the column that holds the answer, "choice" or
    "correct"; `answer` says what is counted, in words; `lapses` are its lapse parameters.
    `bias_name` is what its response bias is called, "bias", "criterion", or None where it has none;
    `guess_rate` the proportion of the answer at chance, None where lapses on either side set it.
    """

    name: str
    response: str
    answer: str
    lapses: tuple[str, ...] = ("lapse_low", "lapse_high")
    bias_name: str | None = "bias"
    guess_rate: float | None = None

    @property
    def has_bias(self) -> bool:
        """Whether a response bias can show in the data."""
        return self.bias_name is not None

    @property
    def is_difference(self) -> bool:
        """Whether d is the difference of two signals over its sd, and a bias adds alike to all."""
        return False

    def decide(self, encoded: Signals) -> tuple[Array, Array | float]:
        """Decision variable d (..., C), and what a bias of 1 adds to it."""
        raise NotImplementedError

    def decision_sd(self, encoded: Signals) -> Array:
        """Sd of the noise by which d was divided, in the signal's unit, (..., C)."""
        return np.asarray(np.hypot(encoded.sd_1, encoded.sd_2))

    def chance(self, d: Array, bias: Array | float) -> tuple[Array, Array]:
        """Probability of the answer and of the other, without lapses; neither loses its tail."""
        z = d + bias
        less = ndtr(-np.abs(z))  # the tail; the rest is known from it to the last digit
        more, upward = 1 - less, z > 0
        return np.where(upward, more, less), np.where(upward, less, more)

    def asymptotes(self, lapse_low: Array, lapse_high: Array) -> tuple[Array, Array]:
        """What is lost at either end, as (low, high)."""
        return lapse_low, lapse_high


@dataclass(frozen=True, repr=False)
class SignedChoice(Task):
    """Which of two is greater (farther): two noisy signals are compared, 2AFC or 2IFC.

    P(second greater) = λ_lo + (1 − λ_lo − λ_hi) Φ((I₂ − I₁)/√(σ₁² + σ₂²) + bias), σ = k I: noise in
    each interval grows with the stimulus of that interval. The lower end is λ_lo, not ½. Stimuli
    are in the order of their intervals, so a bias is also the order effect (time-order error).

    Examples
    --------
    >>> from weberwhisk.behaviour.encodings import IdentityEncoding, unit_encodings
    >>> cell = unit_encodings(IdentityEncoding(), [1.0], [1.1], [1.0])
    >>> SignedChoice().decide(cell.encoded(0.1))[0].round(4)
    array([0.6727])
    """

    name: str = "2AFC"
    response: str = "choice"
    answer: str = '"second greater"'
    is_difference = True

    def decide(self, encoded: Signals) -> tuple[Array, Array | float]:
        m1, s1, m2, s2, shift = encoded[:5]
        return (m2 - m1) / np.hypot(s1, s2) + shift, 1.0


@dataclass(frozen=True, repr=False)
class PercentCorrect(Task):
    """Which of m is the odd one, scored right or wrong against an unsigned difference.

    The target (`stimulus_2`) is the greatest, or the least, of m noisy signals, the others being
    `stimulus_1`. The observer takes the most extreme (Green & Swets 1966, §2.6): the chance is
    ∫ φ(x; target) Φ(x; other)^(m−1) dx, each with its own noise. Chance is 1/m; `lapse_high` is
    what is missing from 1 at the easiest level.

    Examples
    --------
    >>> PercentCorrect(4).guess_rate
    0.25
    """

    alternatives: int = 2
    response: str = "correct"
    answer: str = "correct"
    bias_name: str | None = None
    lapses: tuple[str, ...] = ("lapse_high",)

    def __post_init__(self) -> None:
        checks.whole(
            "alternatives", self.alternatives, "write ww.behaviour.PercentCorrect(3), say", least=2
        )

    @property
    def name(self) -> str:  # type: ignore[override]
        return f"{self.alternatives}AFC percent correct"

    @property
    def is_difference(self) -> bool:
        return self.alternatives == 2

    @property
    def guess_rate(self) -> float:  # type: ignore[override]
        return 1.0 / self.alternatives

    def decide(self, encoded: Signals) -> tuple[Array, Array | float]:
        m1, s1, m2, s2, shift = encoded[:5]
        gap = np.abs(m2 - m1)
        if self.alternatives == 2:
            return gap / np.hypot(s1, s2) + shift, 0.0
        # The trapezoid rule converges exponentially here: 1e-14 with these nodes of its noise.
        z = np.linspace(-8.5, 8.5, 115)
        weights = np.exp(-0.5 * z**2)
        margin = gap[..., None] + np.asarray(s2)[..., None] * z
        others = log_ndtr(margin / np.asarray(s1)[..., None])
        missed = -np.expm1((self.alternatives - 1) * others)
        return -ndtri(missed @ (weights / weights.sum())) + shift, 0.0

    def asymptotes(self, lapse_low: Array, lapse_high: Array) -> tuple[Array, Array]:
        return lapse_high / (self.alternatives - 1), lapse_high


@dataclass(frozen=True, repr=False)
class YesNo(Task):
    """One stimulus, against a standard held in mind: "yes, greater", or go and no-go.

    P(yes) = λ_lo + (1 − λ_lo − λ_hi) Φ((I₂ − I₁ − c σ₁)/σ₂): the signal of the stimulus put
    (`stimulus_2`) passes a criterion, `criterion` c in sds of the standard's signal above its mean
    (Green & Swets 1966, §3; Macmillan & Creelman 2005, ch. 2). The standard itself, put as a
    stimulus, gives the false alarms, Φ(−c). c is inferred with the Weber fraction. A stimulus that
    is to be found *smaller* than its standard wants its answers counted the other way.

    Examples
    --------
    >>> from weberwhisk.behaviour.encodings import IdentityEncoding, unit_encodings
    >>> cell = unit_encodings(IdentityEncoding(), [1.0], [1.0674], [1.0], "equal-variance")
    >>> d, weight = YesNo().decide(cell.encoded(0.1))
    >>> YesNo().chance(d, weight * 0.0)[0].round(3)
    array([0.75])
    """

    name: str = "yes/no"
    response: str = "choice"
    answer: str = '"yes"'
    bias_name: str | None = "criterion"

    def decide(self, encoded: Signals) -> tuple[Array, Array | float]:
        m1, s1, m2, s2, shift = encoded[:5]
        return (m2 - m1) / s2 + shift, -s1 / s2

    def decision_sd(self, encoded: Signals) -> Array:
        return np.asarray(encoded.sd_2)


@dataclass(frozen=True, repr=False)
class SameDifferent(Task):
    """Are two stimuli the same or different? The differencing rule.

    "Different" where the two signals differ by more than a criterion (Macmillan & Creelman 2005,
    ch. 9; Sorkin 1962): P = Φ((Δ − C)/σ) + Φ((−Δ − C)/σ), σ² = σ₁² + σ₂². `criterion` is C in sds
    of the difference between two signals of stimulus 1, so "different" to equal pairs is 2Φ(−C).

    Examples
    --------
    >>> SameDifferent().chance(np.array([0.0]), -1.0)[0].round(4)
    array([0.3173])
    """

    name: str = "same-different"
    response: str = "choice"
    answer: str = '"different"'
    bias_name: str | None = "criterion"

    def decide(self, encoded: Signals) -> tuple[Array, Array | float]:
        m1, s1, m2, s2, shift = encoded[:5]
        spread = np.hypot(s1, s2)
        return np.abs(m2 - m1) / spread + shift, -np.sqrt(2.0) * s1 / spread

    def chance(self, d: Array, bias: Array | float) -> tuple[Array, Array]:
        # Below zero there is no criterion: every pair differs.
        c = np.maximum(-np.asarray(bias), 0.0)
        return ndtr(d - c) + ndtr(-d - c), np.maximum(ndtr(c - d) - ndtr(-c - d), 0.0)


TASKS: dict[str, Task] = {
    "2AFC": SignedChoice("2AFC"),
    "2IFC": SignedChoice("2IFC"),
    **{f"{m}AFC percent correct": PercentCorrect(m) for m in (2, 3, 4, 5, 6, 8)},
    "yes/no": YesNo("yes/no"),
    "go/no-go": YesNo("go/no-go", answer='"go"'),
    "same-different": SameDifferent(),
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
    return TASKS[checks.one_of("task", name, TASKS)]


def rises_on_both_sides(task: Task) -> bool:
    """Whether the answer grows more likely with distance from the standard on either side."""
    return task.bias_name is None or task.name == "same-different"
