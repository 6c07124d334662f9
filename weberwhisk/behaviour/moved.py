"""Answers of an observer who is moved by effects: his last answer, the past, the session."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.stats import beta

from .effects import Effect, History, Overdispersion
from .percepts import Percept, UnitPercepts, unit_percepts
from .trials import Trials

Array = NDArray[np.float64]


def moved_answers(
    trials: Trials,
    percept: Percept,
    *,
    weber_fraction: Array,
    lapse_low: float,
    lapse_high: float,
    bias: Array,
    noise: str,
    effects: Sequence[tuple[Effect, float]],
    uniform: Array,
    rng: np.random.Generator,
) -> Array:
    """Answers, 0 or 1 a row, to trials that are laid out in their order; all arrays a number a row.

    `trials` has NaN for an answer that the animal does not give. `uniform` decides the answers.
    """
    frame, task = trials.frame, trials.task
    names = ("stimulus_1", "stimulus_2", "standard")
    rows = np.column_stack([frame[name].to_numpy(float) for name in names])
    silent = frame["count"].isna().to_numpy()
    pairs, which = np.unique(rows, axis=0, return_inverse=True)
    which = which.reshape(-1)
    n = np.bincount(which, ~silent).astype(float)
    both = unit_percepts(percept, pairs[:, 0], pairs[:, 1], pairs[:, 2], noise)
    bound = [(e.bound(both, n), float(value)) for e, value in effects]
    own = both.of(which)
    scaled = UnitPercepts(
        own.mean_1, weber_fraction * own.sd_1, own.mean_2, weber_fraction * own.sd_2, *own[4:]
    )
    columns = [e.column(trials, percept) for e, _ in bound]

    def probability(before: float) -> Array:
        """Of the answer counted, after the other answer (-1), none (0), or itself (1)."""
        felt = scaled.felt(1.0)
        for (effect, value), column in zip(bound, columns, strict=True):
            goes_with = before if isinstance(effect, History) else column
            felt = effect.apply(felt, np.array([value]), 0.0 if goes_with is None else goes_with)
        d, weight = task.decide(felt)
        up, down = task.chance(d, weight * bias)
        low, high = task.asymptotes(np.array(lapse_low), np.array(lapse_high))
        p = np.asarray(low * down + (1 - high) * up)
        for (effect, value), column in zip(bound, columns, strict=True):
            if isinstance(effect, Overdispersion):
                _, cell = np.unique(
                    np.column_stack([which, np.zeros(len(p)) if column is None else column]),
                    axis=0,
                    return_inverse=True,
                )
                drawn = scatter[: len(frame)][cell.reshape(-1)]
                size = 1 / value - 1
                p = np.asarray(beta.ppf(drawn, p * size, (1 - p) * size))
        return p

    scatter = rng.random(len(frame))
    if not any(isinstance(effect, History) for effect, _ in bound):
        return (uniform < probability(0.0)).astype(float)
    after = (uniform < np.stack([probability(b) for b in (0.0, 1.0, -1.0)])).astype(int)
    session = frame["session"].to_numpy()
    answer, last = np.zeros(len(frame)), 0
    for i in range(len(frame)):
        if i and session[i] != session[i - 1]:
            last = 0
        answer[i] = after[last, i]
        last = 0 if silent[i] else (1 if answer[i] else -1)
    return answer
