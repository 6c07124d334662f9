"""The axes of the grid: coordinates, the prior density there, and how well each can be known.

k has the normal score of its prior as coordinate, lapses and biases have those of
`priors.lapse_transform` and `priors.bias_transform`.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from .._util.values import Array
from .likelihood import WeberModel
from .priors import REACH, Priors
from .tasks import Task

__all__ = [
    "bias_at", "bias_prior", "even", "lapse_prior", "lapse_weights", "least_bias_sds", "least_sd",
    "log_lapses_possible", "score_prior", "signals",
]  # fmt: skip

FALL = 0.25  # sd of the fall of a bias's prior beyond the ends of its coordinate


def score_prior(axis: Array) -> Array:
    """Standard normal log-density of the scores; nothing for a fixed parameter."""
    return -0.5 * axis**2 - 0.5 * np.log(2 * np.pi) if axis.size > 1 else np.zeros(1)


def lapse_prior(model: WeberModel, low: Array, high: Array) -> Array:
    """Log prior density of the lapses on their coordinates, (Lo, Hi).

    Lapses that leave no rise are impossible. A node that stands for some of either kind has the
    share of the possible ones: where few trials leave mass at that edge, sums over nodes that are
    all in or all out went by steps.
    """
    transforms = model.transforms[-2:]
    z = [s.score(t) for s, t in zip(transforms, (low, high), strict=True)]
    slope = [
        np.log(s.slope(t)) * (t.size > 1) for s, t in zip(transforms, (low, high), strict=True)
    ]
    lo, hi = model.lapses(
        model.value("lapse_low", z[0])[:, None], model.value("lapse_high", z[1])[None, :]
    )
    density = log_score_prior(z[0][:, None], z[1][None, :], model.priors.lapse_correlation)
    density += slope[0][:, None] + slope[1] - log_lapses_possible(model.task, model.priors)
    lost = np.broadcast_to(lo + hi, density.shape)
    if lost.max() <= 0.5:  # no node stands for any past the edge
        return np.asarray(density)
    free = [axis for axis in (0, 1) if lost.shape[axis] > 1]
    across = np.sum([np.abs(np.gradient(lost, axis=axis)) for axis in free], axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(across > 0, np.clip((1 - lost) / across + 0.5, 0.0, 1.0), lost < 1)
        return np.asarray(density + np.log(share))


def lapse_weights(model: WeberModel, low: Array, high: Array) -> Array:
    """Log prior probability of the lapse nodes, (Lo, Hi)."""
    steps = [a[1] - a[0] for a in (low, high) if a.size > 1]
    return lapse_prior(model, low, high) + float(np.log(steps).sum())


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
    # A node on the edge stands for as much inside as outside.
    rising = np.heaviside(np.round(1 - low - high, 12), 0.5)
    return float(np.log((weight * rising).sum() / weight.sum()))


def log_score_prior(low: Array, high: Array, correlation: float) -> Array:
    """Log prior density of the scores of both lapses (broadcasts), each of one value if fixed."""
    free = [int(a.size > 1) for a in (low, high)]
    rho = correlation if all(free) else 0.0
    square = free[0] * low**2 + free[1] * high**2 - 2 * rho * low * high
    norm = 0.5 * sum(free) * np.log(2 * np.pi) + 0.5 * np.log1p(-(rho**2))
    return np.asarray(-0.5 * square / (1 - rho**2) - norm)


def even(low: float, high: float, step: float) -> Array:
    """Nodes from `low` to `high`, no farther apart than a step; one where the ends are the same."""
    return np.linspace(low, high, int(np.ceil((high - low) / step - 1e-9)) + 1)


def least_sd(model: WeberModel) -> float:
    """The least sd that the score of k can have given the rest, whatever the answers."""
    if not model.free[0]:
        return 1.0
    z, h, biases = np.linspace(-6.0, 6.0, 121), 1e-3, bias_at(model, np.zeros(1))
    if np.any(biases != 0):  # a criterion that lies to one side: elsewhere answers may inform more
        biases = bias_at(model, np.linspace(-1.0, 1.0, 3))[:, None, None]
    sides = []
    for s in (h, -h):
        d, weight = signals(model, z + s)
        sides.append(model.task.chance(d, weight * biases)[0])
    information = information_of(model.cells.n, sides, 2 * h).sum(axis=-1)
    return float(1 / np.sqrt(information.max(initial=0.0) + 1))


def signals(model: WeberModel, nodes: Array) -> tuple[Array, Array]:
    """Decision variable and weight of the bias, both (K, C), at scores of k."""
    d, weight = np.broadcast_arrays(*model.decide(model.value("weber_fraction", nodes)))
    return d, weight


def bias_at(model: WeberModel, coordinate: Array) -> Array:
    """A bias at its coordinate; its value where it is fixed."""
    if not model.free_bias:
        return np.full(np.shape(coordinate), model.fixed_bias())
    score = model.bias_transform.score(coordinate)
    return model.priors.value("bias", np.minimum(np.maximum(score, -REACH), REACH))


def bias_prior(model: WeberModel, coordinate: Array) -> Array:
    """Log prior density of a bias on its coordinate; 0 where it is fixed.

    Nodes may lie beyond the coordinate's ends, where all stand for the same bias: the density falls
    off there, as fast as splines through it bear.
    """
    if not model.free_bias:
        return np.zeros(np.shape(coordinate))
    transform = model.bias_transform
    normal = -0.5 * transform.score(coordinate) ** 2 - 0.5 * np.log(2 * np.pi)
    first, last = transform.ends
    beyond = np.maximum(np.maximum(first - coordinate, coordinate - last), 0.0)
    return np.asarray(normal + np.log(transform.slope(coordinate)) - 0.5 * (beyond / FALL) ** 2)


def least_bias_sds(model: WeberModel, d: Array, weight: Array, span: Array) -> Array:
    """The least sd of the score of every group's bias given the rest, (M, G), for decision
    variables (M, C), wherever in the span it lies."""
    if not model.free_bias:
        return np.ones((len(d), model.n_groups))
    h, at = 1e-3, span[:, None, None]
    sides = [model.task.chance(d, weight * bias_at(model, at + s))[0] for s in (h, -h)]
    informed = information_of(model.cells.n, sides, 2 * h) @ model.membership  # (B, M, G)
    return np.asarray(1 / np.sqrt(informed.max(axis=0) + 1))


def information_of(n: Array, sides: list[Array], between: float) -> Array:
    """Fisher information of n answers, of their chances after and before a change."""
    after, before = sides
    p = np.clip(0.5 * (after + before), 1e-9, 1 - 1e-9)
    return np.asarray(n * ((after - before) / between) ** 2 / (p * (1 - p)))
