"""The psychometric function: the probability of an answer, and the threshold, its inverse."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .._util import checks
from .._util.refusals import Refusal
from .._util.values import Array
from .effects import Effect, check_valued
from .encodings import (
    Encoding,
    UnitEncodings,
    checked_encoding,
    refuse_outside,
    unit_encodings,
)
from .tasks import Task, rises_on_both_sides

__all__ = ["criterion", "difference_sd", "response_probability", "threshold"]


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
        Effects with the values of their parameters (...), at a column of 0: mid-course, with no
        answer before. Those of a fit's model have their scale; `Contraction()` has a centre of 0.
    noise : {"weber", "equal-variance", "constant"}

    Examples
    --------
    >>> from weberwhisk.behaviour import IdentityEncoding, task_named
    >>> response_probability(task_named("2AFC"), IdentityEncoding(), 1.0, [0.9, 1.0, 1.1],
    ...                      weber_fraction=0.1).round(3)
    array([0.229, 0.5  , 0.749])
    """
    hint = "give one stimulus or several"
    s1, s2 = np.broadcast_arrays(
        np.atleast_1d(checks.finite("stimulus_1", stimulus_1, hint)),
        np.atleast_1d(checks.finite("stimulus_2", stimulus_2, hint)),
    )
    if standard is not None:
        standard = checks.finite("standard", standard, hint)
    _check_observer(task, encoding, bias, effects)
    checks.positive("weber_fraction", weber_fraction, "write for example 0.1")
    refuse_outside(encoding, np.concatenate([s1, s2], axis=None))
    cells = unit_encodings(encoding, s1, s2, s1 if standard is None else standard, noise)
    up, down = _chance(task, cells, weber_fraction, bias, effects)
    lapses = [
        checks.non_negative(name, value, "write 0.02, say")[..., None]
        for name, value in (("lapse_low", lapse_low), ("lapse_high", lapse_high))
    ]
    if np.any(sum(lapses) > 1):
        raise Refusal("lapses sum to more than 1", remedy="write 0.02 for each, say")
    low, high = task.asymptotes(*lapses)
    return low * down + (1 - high) * up


def _check_observer(task: Task, encoding: Encoding, bias: ArrayLike, effects: Any) -> None:
    checks.kind("task", task, "a Task", "decide", "write ww.behaviour.task_named('2AFC'), say")
    checked_encoding(encoding)
    checks.finite("bias", bias, "write for example 0")
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


def criterion(task: Task, proportion: float, with_bias: bool | None = None) -> str:
    """The criterion of a threshold in words, with what was removed from the curve and what kept.

    `with_bias` is whether a bias was left in; None where the observer has none.

    Examples
    --------
    >>> from weberwhisk.behaviour import task_named
    >>> criterion(task_named("2AFC"), 0.75, with_bias=False)
    '75 % "second greater", 2AFC, lapses and bias removed'
    """
    removed = "lapses removed"
    if with_bias is not None:
        bias = task.bias_name or "bias"
        removed = f"lapses removed, {bias} kept" if with_bias else f"lapses and {bias} removed"
    return f"{100 * proportion:.4g} % {task.answer}, {task.name.split()[0]}, {removed}"


def check_proportion(task: Task, proportion: float) -> float:
    """A proportion at which the task has a threshold."""
    low = task.guess_rate or 0.0
    value = checks.number("proportion", proportion, "write for example 0.75")
    if not low < value < 1:
        raise Refusal(
            f"proportion must lie between {low:g} and 1 for {task.name}",
            f"{value:g}",
            "write for example 0.75",
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

    Solved by bisection to machine precision, whatever the encoding. Where no comparison reaches it
    the threshold is infinite, or if downward the lowest stimulus (−inf, or 0 for magnitudes). Under
    Weber noise Φ never passes Φ(1/k), so that a poor observer has no 90 % point; a same–different
    observer has none below its false alarms.

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
    checks.positive("weber_fraction", weber_fraction, "write for example 0.1")
    values = [np.asarray(v, dtype=float) for _, v in effects]
    k, shift, *values = np.broadcast_arrays(
        np.asarray(weber_fraction, float), np.asarray(bias, float), *values
    )
    bound = [(effect, value) for (effect, _), value in zip(effects, values, strict=True)]
    standard = checks.number("standard", standard, "give one stimulus")
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
    seen = [above(side) if reached else 0.0 for side, reached in (
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


def _ladder(encoding: Encoding, standard: float, sign: int) -> Array:
    """Comparisons from the standard to the edge of what gives a signal, close at both ends."""
    low, high = encoding.domain
    edge = high if sign > 0 else low
    if np.isfinite(edge):
        share = np.concatenate([np.linspace(0, 0.99, 199), 1 - np.geomspace(0.009, 1e-12, 60)])
        return standard + (edge - standard) * share
    size = abs(standard) if low == 0 else 1.0
    return standard + sign * size * np.concatenate([[0.0], np.geomspace(1e-6, 1e6, 258)])


def difference_sd(encoding: Encoding, standard: ArrayLike) -> Array:
    """Offset that moves the difference between the two signals by one of its sds, for k = 1.

    √2 σ(s)/|μ′(s)|, the small-offset limit: for a tapered whisker's compliance √2 r (1 − r/A).
    """
    s = np.asarray(standard, dtype=float)
    low, high = encoding.domain
    h = 1e-5 * np.minimum(np.where(s != 0, np.abs(s), 1.0), np.minimum(s - low, high - s))
    slope = (encoding.mean(s + h) - encoding.mean(s - h)) / (2 * h)
    return np.asarray(np.sqrt(2.0) * encoding.sd_per_weber_fraction(s) / np.abs(slope))
