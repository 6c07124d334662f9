"""Which stimulus of a trial is the standard, found over the whole table.

The rule, the first that holds:

1. What a column `standard` says: the stimulus itself, or in which interval it was (1 or 2).
2. The first stimulus of yes/no tasks, and of those with more than two alternatives.
3. One value in every trial of a table with four or more, or all of one interval.
4. Values that were each compared with three others or more, of which every pair has exactly one.
5. The interval with at most half as many values as the other, each compared with two or more.

Where none holds there is no standard: pairs are then gathered by their middle (geometric for
magnitudes), and nothing is concluded that needs to know it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .._util.refusals import argument
from .._util.values import Array, Flags, counted
from .tasks import PercentCorrect, Task, YesNo

__all__ = ["NAMING", "Standards", "named_standards", "rounded", "standards_of"]

#: How a user names the standards.
NAMING = argument("columns", {"standard": "<its name>"})


@dataclass(frozen=True)
class Standards:
    """The standard of each trial (R,), whether it is known, and what to say of how it was found."""

    values: Array
    are_known: bool = True
    note: str = ""


def standards_of(stimulus_1: Array, stimulus_2: Array, scale: str, task: Task) -> Standards:
    """The standard of each trial, where the table names none.

    Examples
    --------
    >>> from weberwhisk.behaviour.tasks import task_named
    >>> first, second = np.array([1, 1, 4, 4, 1, 4.0]), np.array([2, 0.5, 3, 5, 1, 7.0])
    >>> standards = standards_of(first, second, "linear", task_named("2AFC"))
    >>> standards.values.tolist(), standards.are_known
    ([1.0, 1.0, 4.0, 4.0, 1.0, 4.0], True)
    """
    s1, s2 = rounded(stimulus_1, scale), rounded(stimulus_2, scale)
    if isinstance(task, YesNo) or (isinstance(task, PercentCorrect) and task.alternatives > 2):
        return Standards(s1)
    first, second = np.unique(s1).size, np.unique(s2).size
    if 1 in (first, second):
        return Standards(s1 if first == 1 else s2)
    if (hubs := _hubs(s1, s2)) is not None:
        values = np.where(hubs, s1, s2)
        several = np.unique(values).size
        said = "" if several == 1 else _guessed(several, "every pair has exactly one of them")
        return Standards(values, note=said)
    pairs = np.unique(np.stack([s1, s2]), axis=1)
    for values, levels, others, place, which in (
        (s1, first, second, 0, "first"), (s2, second, first, 1, "second")
    ):  # fmt: skip
        partners = np.unique(pairs[place], return_counts=True)[1]
        if 2 * levels <= others and partners.min() > 1:
            why = f"the {which} stimulus has {levels} values, and the other {others}"
            return Standards(values, note=_guessed(levels, why))
    middle = 0.5 * (s1 + s2) if scale == "log" else np.sqrt(s1) * np.sqrt(s2)
    return Standards(
        rounded(middle, scale),
        are_known=False,
        note="Nothing says which stimulus of a pair is the standard, so that no bias per standard, "
        "test of Weber's law or threshold from a standard is given; " + NAMING + " would name it.",
    )


def _guessed(number: int, why: str) -> str:
    said = f"The {counted(number, 'standard')} were guessed from the pairs ({why}); "
    return said + NAMING + " would name them."


def _hubs(s1: Array, s2: Array) -> Flags | None:
    """Whether the first stimulus of a trial, or else the second, is the only one of the two that
    was compared with three others or more; None where that is so of neither, or of both."""
    _, place = np.unique(np.stack([s1, s2]), return_inverse=True)
    one, two = place.reshape(2, -1)
    low, high = np.minimum(one, two), np.maximum(one, two)
    unequal = low < high
    edges = np.unique(np.stack([low, high])[:, unequal], axis=1)
    is_hub = np.bincount(edges.ravel(), minlength=int(place.max()) + 1) >= 3
    both = is_hub[one] & is_hub[two] & unequal
    if both.any() or not (is_hub[one] | is_hub[two]).all():
        return None
    return np.asarray(is_hub[one], dtype=bool)


def named_standards(
    named: Array, stimulus_1: Array, stimulus_2: Array, column: str, scale: str
) -> Standards:
    """The standards of a column that names them, or the interval in which they were."""
    values, s1, s2 = (rounded(v, scale) for v in (named, stimulus_1, stimulus_2))
    shown = (values == s1) | (values == s2)
    levels = np.unique(values).tolist()
    if not shown.all() and levels in ([1.0, 2.0], [0.0, 1.0]):
        return Standards(
            np.where(values == levels[0], s1, s2),
            note=f"The column {column!r} holds {levels[0]:g} and {levels[1]:g}, which no stimulus "
            "of those rows is, and was read as the interval of the standard; " + NAMING + " names "
            "another.",
        )
    return Standards(values)


def rounded(values: Array, scale: str) -> Array:
    """Stimuli to twelve digits, so that those that differ by rounding alone are one."""
    if scale == "log":
        return np.round(values, 12) + 0.0
    levels, place = np.unique(values, return_inverse=True)
    return np.array([float(f"{s:.12g}") for s in levels])[place.reshape(-1)]
