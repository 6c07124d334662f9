"""Where the posterior of one observer lies: normal scores, the mode, and the curvature there."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from .likelihood import WeberModel
from .priors import Priors
from .tasks import Task

Array = NDArray[np.float64]

LEAD = ("weber_fraction", "lapse_low", "lapse_high")
REACH = 9.0  # scores beyond which no prior has mass


def free_scores(model: WeberModel) -> list[bool]:
    """Which of the lead scores are inferred."""
    present = ("weber_fraction", *model.lapse_names)
    return [name in present and not model.priors.is_fixed(name) for name in LEAD]


def score_value(model: WeberModel, name: str, scores: Array) -> Array:
    """A lead parameter at a score; zero where the task has no such parameter."""
    if name not in ("weber_fraction", *model.lapse_names):
        return np.zeros(np.shape(scores))
    return model.priors.value(name, scores)


def find_mode(model: WeberModel, scores: Array, bias: Array) -> tuple[tuple[Array, Array], Array]:
    """Mode of (scores, biases), and the Fisher information there (free parameters, biases last).

    Levenberg–Marquardt on the binomial likelihood with the priors; only the place of the nodes
    depends on it, so the bias prior enters as a normal of its mean and sd.
    """
    free = np.flatnonzero(free_scores(model))
    table = np.linspace(-REACH, REACH, 361)
    values = [score_value(model, name, table) for name in LEAD]
    values[0] = np.log(np.maximum(values[0], 1e-300))
    n_bias = model.n_groups if model.free_bias else 0
    mean, sd = (
        (float(model.priors.bias.mean()), float(model.priors.bias.std())) if n_bias else (0.0, 1.0)
    )
    prior_mean = np.r_[np.zeros(free.size), np.full(n_bias, mean)]
    prior_precision = np.r_[np.ones(free.size), np.full(n_bias, 1 / sd**2)]
    n, x = model.cells.n, model.cells.count

    def probability(theta: Array) -> tuple[Array, Array]:
        z = np.tile(scores, (len(theta), 1))
        z[:, free] = theta[:, : free.size]
        k, low, high = (np.interp(z[:, i], table, v) for i, v in enumerate(values))
        b = theta[:, free.size :] if n_bias else np.tile(bias, (len(theta), 1))
        return model.probability(np.exp(k), low, np.minimum(high, 1 - low), b)

    def objective(p: Array, q: Array, theta: Array) -> float:
        return float(
            x @ np.log(p) + (n - x) @ np.log(q) - 0.5 * prior_precision @ (theta - prior_mean) ** 2
        )

    theta = np.r_[scores[free], bias if n_bias else ()]
    nudge = 1e-3 * np.eye(theta.size)
    damping, best, information = 1e-3, -np.inf, np.diag(prior_precision)
    for _ in range(60):
        p, q = probability(np.concatenate([theta[None], theta + nudge, theta - nudge]))
        best = objective(p[0], q[0], theta)
        slopes = (p[1 : 1 + theta.size] - p[1 + theta.size :]) / 2e-3
        gradient = slopes @ (x / p[0] - (n - x) / q[0]) - prior_precision * (theta - prior_mean)
        information = (slopes * (n / (p[0] * q[0]))) @ slopes.T + np.diag(prior_precision)
        moved = False
        while damping < 1e8:
            step = np.linalg.solve(information + damping * np.diag(np.diag(information)), gradient)
            step = np.clip(step, -2.0, 2.0)
            p, q = probability((theta + step)[None])
            if objective(p[0], q[0], theta + step) >= best:
                theta, damping, moved = theta + step, max(damping * 0.1, 1e-9), True
                break
            damping *= 10
        if not moved or step @ information @ step < 1e-4:
            break
    out = scores.copy()
    out[free] = theta[: free.size]
    return (out, theta[free.size :] if n_bias else bias), information


@lru_cache(maxsize=64)
def log_lapses_possible(task: Task, priors: Priors) -> float:
    """Log prior mass of the lapses that leave the curve rising: λ_lo + λ_hi < 1."""
    z = np.linspace(-REACH, REACH, 181)
    score = np.exp(-0.5 * z**2)
    values, weights = [], []
    for name in LEAD[1:]:
        free = name in task.lapses and not priors.is_fixed(name)
        fixed = (
            0.0 if name not in task.lapses else float(getattr(priors, name)) if not free else 0.0
        )
        values.append(priors.value(name, z) if free else np.array([fixed]))
        weights.append(score if free else np.ones(1))
    low, high = task.asymptotes(values[0][:, None], values[1][None, :])
    weight = weights[0][:, None] * weights[1]
    rising = np.broadcast_to(low + high < 1, weight.shape)
    return float(np.log(weight[rising].sum() / weight.sum()))
