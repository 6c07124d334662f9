"""The psychometric function: what the animal was asked, the probability of its answer, and the
threshold, its inverse.

A task makes a decision variable d of two noisy signals, says how a response bias or criterion b
enters it, and what the chance of the answer is: Φ(d + b) for all but the same–different task.
Lapses then cut both ends: P = λ_lo + (1 − λ_lo − λ_hi) · chance. A new task is one class here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import log_ndtr, ndtr, ndtri

from .. import _checks
from .._values import Array
from .effects import Effect, check_valued
from .encodings import (
    Encoding,
    Signals,
    UnitEncodings,
    checked_encoding,
    refuse_outside,
    unit_encodings,
)


class Task:
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


@dataclass(frozen=True)
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

    def decide(self, encoded: Signals) -> tuple[Array, Array | float]:
        m1, s1, m2, s2, shift = encoded
        return (m2 - m1) / np.hypot(s1, s2) + shift, 1.0


@dataclass(frozen=True)
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
        _checks.whole("alternatives", self.alternatives, "write PercentCorrect(3), say", least=2)

    @property
    def name(self) -> str:  # type: ignore[override]
        return f"{self.alternatives}AFC percent correct"

    @property
    def guess_rate(self) -> float:  # type: ignore[override]
        return 1.0 / self.alternatives

    def decide(self, encoded: Signals) -> tuple[Array, Array | float]:
        m1, s1, m2, s2, shift = encoded
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


@dataclass(frozen=True)
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
        m1, s1, m2, s2, shift = encoded
        return (m2 - m1) / s2 + shift, -s1 / s2

    def decision_sd(self, encoded: Signals) -> Array:
        return np.asarray(encoded.sd_2)


@dataclass(frozen=True)
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
        m1, s1, m2, s2, shift = encoded
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
    return TASKS[_checks.one_of("task", name, TASKS)]


def response_probability(
    task: Task,
    encoding: Encoding,
    stimulus_1: ArrayLike,
    stimulus_2: ArrayLike,
    *,
    standard: ArrayLike | None = None,
    weber_fraction: ArrayLike,
    lapse_low: ArrayLike = 0.0,
    lapse_high: ArrayLike = 0.0,
    bias: ArrayLike = 0.0,
    effects: Sequence[tuple[Effect, ArrayLike]] = (),
    noise: str = "weber",
) -> Array:
    """Probability of the answer that is counted: "second greater", "yes", "different", or right.

    Parameters
    ----------
    task, encoding
        What was asked, and how a stimulus is encoded.
    stimulus_1, stimulus_2 : array_like, shape (C,)
        In the stimulus's own unit.
    standard : array_like, optional
        Sets the noise of the equal-variance form; `stimulus_1` where not given.
    weber_fraction, lapse_low, lapse_high, bias : array_like, shape (...)
        Parameters of the observer; they broadcast with one another. Bias is in sds of the
        difference between the two signals, positive towards "second greater"; for tasks that have
        one it is the criterion (see the task).
    effects : sequence of (effect, value), optional
        Effects bound to a table, and their parameters (...); in the middle of a session's course
        and with no answer before.
    noise : {"weber", "equal-variance"}

    Returns
    -------
    ndarray, shape (..., C)

    Examples
    --------
    >>> from weberwhisk.behaviour import IdentityEncoding, task_named
    >>> response_probability(task_named("2AFC"), IdentityEncoding(), 1.0, [0.9, 1.0, 1.1],
    ...                      weber_fraction=0.1).round(3)
    array([0.229, 0.5  , 0.749])
    """
    hint = "give one stimulus or several"
    s1, s2 = np.broadcast_arrays(
        np.atleast_1d(_checks.finite("stimulus_1", stimulus_1, hint)),
        np.atleast_1d(_checks.finite("stimulus_2", stimulus_2, hint)),
    )
    if standard is not None:
        standard = _checks.finite("standard", standard, hint)
    _check_observer(task, encoding, bias, effects)
    _checks.positive("weber_fraction", weber_fraction, "write for example 0.1")
    refuse_outside(encoding, np.concatenate([s1, s2], axis=None))
    cells = unit_encodings(encoding, s1, s2, s1 if standard is None else standard, noise)
    up, down = _chance(task, cells, weber_fraction, bias, effects)
    lapses = [
        _checks.non_negative(name, value, "write 0.02, say")[..., None]
        for name, value in (("lapse_low", lapse_low), ("lapse_high", lapse_high))
    ]
    if np.any(sum(lapses) > 1):
        raise ValueError("lapses sum to more than 1; write 0.02 for each, say.")
    low, high = task.asymptotes(*lapses)
    return low * down + (1 - high) * up


def _check_observer(task: Task, encoding: Encoding, bias: ArrayLike, effects: Any) -> None:
    _checks.kind("task", task, "a Task", "decide", "write task_named('2AFC'), say")
    checked_encoding(encoding)
    _checks.finite("bias", bias, "write for example 0")
    check_valued(effects)


def _chance(
    task: Task,
    cells: UnitEncodings,
    k: ArrayLike,
    bias: ArrayLike,
    effects: Sequence[tuple[Effect, ArrayLike]],
) -> tuple[Array, Array]:
    """Chance of the answer and of the other, without lapses, (..., C)."""
    encoded = cells.encoded(k)
    for effect, value in effects:
        encoded = effect.apply(encoded, np.asarray(value, dtype=float)[..., None], 0.0)
    d, weight = task.decide(encoded)
    return task.chance(d, weight * np.asarray(bias, dtype=float)[..., None])


def criterion(task: Task, proportion: float) -> str:
    """The criterion of a threshold in words."""
    return f"{100 * proportion:.4g} % {task.answer}, {task.name.split()[0]}, lapses removed"


def check_proportion(task: Task, proportion: float) -> float:
    """A proportion at which the task has a threshold."""
    low = task.guess_rate or 0.0
    value = _checks.number("proportion", proportion, "write for example 0.75")
    if not low < value < 1:
        raise ValueError(
            f"proportion must lie between {low:g} and 1 for {task.name}, got {value:g}; "
            "write for example 0.75."
        )
    return value


def threshold(
    task: Task,
    encoding: Encoding,
    standard: float,
    proportion: float,
    *,
    weber_fraction: ArrayLike,
    bias: ArrayLike = 0.0,
    effects: Sequence[tuple[Effect, ArrayLike]] = (),
    noise: str = "weber",
    upward: bool = True,
) -> Array:
    """The comparison at which an observer that never lapses answers with that proportion.

    Solved by bisection to machine precision, whatever the encoding. Infinite (or the edge's own
    side: −inf, or 0 for magnitudes) where no comparison reaches it: under Weber noise Φ never
    passes Φ(1/k), so a poor observer has no 90 % point, nor has a same–different observer one below
    its false alarms.

    Parameters
    ----------
    standard : float
        The stimulus compared against, as stimulus 1.
    proportion : float
        For signed tasks below ½ gives the downward threshold. For percent-correct and
        same–different tasks `upward` chooses the side.
    weber_fraction, bias : array_like, shape (...)
    effects : sequence of (effect, value (...))
        As in `response_probability`.

    Returns
    -------
    ndarray, shape (...)
        Comparison in the stimulus's unit; NaN is never returned.

    Examples
    --------
    The closed form for magnitudes, q = k z: (1 + q√(2 − q²))/(1 − q²).

    >>> from weberwhisk.behaviour import IdentityEncoding, task_named
    >>> point = threshold(task_named("2AFC"), IdentityEncoding(), 1.0, 0.75, weber_fraction=0.2)
    >>> round(float(point), 5)
    1.21196
    """
    _check_observer(task, encoding, bias, effects)
    check_proportion(task, proportion)
    _checks.positive("weber_fraction", weber_fraction, "write for example 0.1")
    values = [np.asarray(v, dtype=float) for _, v in effects]
    k, shift, *values = np.broadcast_arrays(
        np.asarray(weber_fraction, float), np.asarray(bias, float), *values
    )
    bound = [(effect, value) for (effect, _), value in zip(effects, values, strict=True)]
    standard = _checks.number("standard", standard, "give one stimulus")
    refuse_outside(encoding, standard)

    def above(comparison: Array) -> Array:
        with np.errstate(all="ignore"):
            cells = unit_encodings(encoding, standard, comparison, standard, noise)
            return _chance(task, cells, k, shift, bound)[0] - proportion

    both = rises_on_both_sides(task)
    if both:
        upward_at = np.full(k.shape, upward)
        sign = np.ones(k.shape)[..., None]
    else:
        upward_at = above(np.array([standard]))[..., 0] < 0
        sign = np.where(upward_at, 1.0, -1.0)[..., None]
    up, down = _ladder(encoding, standard, +1), _ladder(encoding, standard, -1)
    rungs = np.where(upward_at[..., None], up, down)
    # The side that nobody is on is not looked at: the ladders are most of the work.
    seen = [above(side) if some else 0.0 for side, some in (
        (up, upward_at.any()), (down, not upward_at.all())
    )]  # fmt: skip
    passed = sign * np.where(upward_at[..., None], *seen)
    beyond = passed >= 0
    first = np.maximum(np.argmax(beyond, axis=-1), 1)[..., None]
    inner = np.take_along_axis(rungs, first - 1, -1)
    outer = np.take_along_axis(rungs, first, -1)
    for _ in range(60):
        middle = 0.5 * (inner + outer)
        if np.all((middle == inner) | (middle == outer)):
            break
        far = sign * above(middle) >= 0
        inner, outer = np.where(far, inner, middle), np.where(far, middle, outer)
    answer = 0.5 * (inner + outer)[..., 0]
    # Where the standard itself gets more such answers, moving away from it only adds to them.
    reached = beyond.any(axis=-1) & ~(both & (passed[..., 0] > 0))
    return np.where(reached, answer, np.where(upward_at, np.inf, encoding.domain[0]))


def rises_on_both_sides(task: Task) -> bool:
    """Whether the answer grows more likely with distance from the standard on either side."""
    return task.bias_name is None or task.name == "same-different"


def _ladder(encoding: Encoding, standard: float, sign: int) -> Array:
    """Comparisons from the standard to the edge of what gives a signal, close at both ends."""
    low, high = encoding.domain
    edge = high if sign > 0 else low
    if np.isfinite(edge):
        share = np.concatenate([np.linspace(0, 0.99, 199), 1 - np.geomspace(0.009, 1e-12, 60)])
        return standard + (edge - standard) * share
    size = abs(standard) if low == 0 else 1.0
    return standard + sign * size * np.concatenate([[0.0], np.geomspace(1e-6, 1e6, 258)])


def decision_variable(encoding: Encoding, standard: ArrayLike, comparison: ArrayLike) -> Array:
    """Difference between the two encodings in its own sds, for a Weber fraction of 1."""
    s, c = np.asarray(standard, dtype=float), np.asarray(comparison, dtype=float)
    gap = encoding.direction * (encoding.mean(c) - encoding.mean(s))
    return gap / np.hypot(encoding.sd_per_weber_fraction(s), encoding.sd_per_weber_fraction(c))


def difference_sd(encoding: Encoding, standard: ArrayLike) -> Array:
    """Offset that moves the difference between the two signals by one of its sds, for k = 1.

    √2 σ(s)/|μ′(s)|, the small-offset limit: for a tapered whisker's compliance √2 r (1 − r/A).
    """
    s = np.asarray(standard, dtype=float)
    low, high = encoding.domain
    h = 1e-5 * np.minimum(np.where(s != 0, np.abs(s), 1.0), np.minimum(s - low, high - s))
    slope = (encoding.mean(s + h) - encoding.mean(s - h)) / (2 * h)
    return np.asarray(np.sqrt(2.0) * encoding.sd_per_weber_fraction(s) / np.abs(slope))
