"""What is believed of scores and lapses beforehand, on the coordinates of a grid."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from .likelihood import WeberModel
from .priors import REACH, Priors
from .tasks import Task

Array = NDArray[np.float64]


def score_prior(axis: Array) -> Array:
    """Standard normal log-density of the scores; nothing for a fixed parameter."""
    return -0.5 * axis**2 - 0.5 * np.log(2 * np.pi) if axis.size > 1 else np.zeros(1)


def lapse_prior(model: WeberModel, low: Array, high: Array) -> Array:
    """Log prior density of the lapses on their coordinates, (Lo, Hi).

    Lapses that leave no rise are impossible. A node that stands for some of either kind has the
    share of the possible ones: where few trials leave mass at that edge, sums over nodes that are
    all in or all out went by steps.
    """
    stretches = model.stretches[-2:]
    z = [s.score(t) for s, t in zip(stretches, (low, high), strict=True)]
    slope = [np.log(s.slope(t)) * (t.size > 1) for s, t in zip(stretches, (low, high), strict=True)]
    lo, hi = model.lapses(
        model.value("lapse_low", z[0])[:, None], model.value("lapse_high", z[1])[None, :]
    )
    density = log_score_prior(z[0][:, None], z[1][None, :], model.priors.lapse_correlation)
    density += slope[0][:, None] + slope[1] - log_lapses_possible(model.task, model.priors)
    lost = np.broadcast_to(lo + hi, density.shape)
    free = [axis for axis in (0, 1) if lost.shape[axis] > 1]
    across = np.sum([np.abs(np.gradient(lost, axis=axis)) for axis in free], axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(across > 0, np.clip((1 - lost) / across + 0.5, 0.0, 1.0), lost < 1)
        return np.asarray(density + np.log(share))


@lru_cache(maxsize=64)
def log_lapses_possible(task: Task, priors: Priors) -> float:
    """Log prior mass of the lapses that leave the curve rising: λ_lo + λ_hi < 1."""
    z = np.linspace(-REACH, REACH, 181)
    values, scores = [], []
    for name in ("lapse_low", "lapse_high"):
        free = name in task.lapses and not priors.is_fixed(name)
        scores.append(z if free else np.zeros(1))
        values.append(priors.value(name, scores[-1]) * (name in task.lapses))
    low, high = task.asymptotes(values[0][:, None], values[1][None, :])
    weight = np.exp(log_score_prior(scores[0][:, None], scores[1], priors.lapse_correlation))
    rising = np.broadcast_to(low + high < 1, weight.shape)
    return float(np.log(weight[rising].sum() / weight.sum()))


def log_score_prior(low: Array, high: Array, correlation: float) -> Array:
    """Log prior density of the scores of both lapses (broadcasts), each of one value if fixed."""
    free = [int(a.size > 1) for a in (low, high)]
    rho = correlation if all(free) else 0.0
    square = free[0] * low**2 + free[1] * high**2 - 2 * rho * low * high
    norm = 0.5 * sum(free) * np.log(2 * np.pi) + 0.5 * np.log1p(-(rho**2))
    return np.asarray(-0.5 * square / (1 - rho**2) - norm)
