"""Where the posterior of one observer lies: the mode in normal scores, and the curvature there."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from .likelihood import Draws, WeberModel
from .priors import REACH

Array = NDArray[np.float64]


def lead_values(model: WeberModel, scores: Array) -> tuple[Array, Array, Array, Array]:
    """k, effects, and both lapses at scores (..., lead)."""
    values = [model.value(name, scores[..., i]) for i, name in enumerate(model.lead)]
    effects = np.stack(values[1:-2], axis=-1) if model.effects else np.zeros((*values[0].shape, 0))
    return values[0], effects, values[-2], values[-1]


def score_precision(model: WeberModel) -> Array:
    """Precision matrix of the free lead scores under their prior: the lapses of an observer, one
    at either end, are correlated."""
    free = np.array(model.free)
    covariance = np.eye(free.size)
    if free[-2:].all():
        covariance[-1, -2] = covariance[-2, -1] = model.priors.lapse_correlation
    return np.linalg.inv(covariance[np.ix_(free, free)])


def find_mode(model: WeberModel, scores: Array, bias: Array) -> tuple[tuple[Array, Array], Array]:
    """Mode of (scores, biases), and the Fisher information there (free parameters, biases last).

    Levenberg–Marquardt on the binomial likelihood with the priors; only the place of the nodes
    depends on it, so the bias prior enters as a normal of its mean and sd, and overdispersion
    stays where it starts.
    """
    free = np.flatnonzero(model.free)
    n_bias = model.n_groups if model.free_bias else 0
    mean, sd = model.priors.moments("bias") if n_bias else (0.0, 1.0)
    prior_mean = np.r_[np.zeros(free.size), np.full(n_bias, mean)]
    precision = np.diag(np.full(free.size + n_bias, 1 / sd**2))
    precision[: free.size, : free.size] = score_precision(model)
    n, x = model.cells.n, model.cells.count
    if model.dispersed is not None:  # worth fewer trials than there are
        rho = float(model.value(model.effects[model.dispersed].name, 0.0))
        n, x = (a / (1 + np.maximum(model.cells.n - 1, 0) * rho) for a in (n, x))

    def probability(theta: Array) -> tuple[Array, Array]:
        z = np.tile(scores, (len(theta), 1))
        z[:, free] = np.clip(theta[:, : free.size], -REACH, REACH)
        k, effects, low, high = lead_values(model, z)
        b = theta[:, free.size :] if n_bias else np.tile(bias, (len(theta), 1))
        return model.probability(k, low, np.minimum(high, 1 - low), b, effects)

    def objective(p: Array, q: Array, theta: Array) -> float:
        off = theta - prior_mean
        return float(x @ np.log(p) + (n - x) @ np.log(q) - 0.5 * off @ precision @ off)

    theta = np.r_[scores[free], bias if n_bias else ()]
    nudge = 1e-3 * np.eye(theta.size)
    damping, information = 1e-3, precision
    for _ in range(60):
        p, q = probability(np.concatenate([theta[None], theta + nudge, theta - nudge]))
        best = objective(p[0], q[0], theta)
        slopes = (p[1 : 1 + theta.size] - p[1 + theta.size :]) / 2e-3
        gradient = slopes @ (x / p[0] - (n - x) / q[0]) - precision @ (theta - prior_mean)
        information = (slopes * (n / (p[0] * q[0]))) @ slopes.T + precision
        moved = False
        while damping < 1e8:
            step = np.linalg.solve(information + damping * np.diag(np.diag(information)), gradient)
            step = np.clip(step, -2.0, 2.0)
            p, q = probability((theta + step)[None])
            if objective(p[0], q[0], theta + step) >= best:
                theta, damping, moved = theta + step, max(damping * 0.1, 1e-9), True
                break
            damping *= 10
        if not moved or step @ information @ step < 1e-2:
            break
    out = scores.copy()
    out[free] = np.clip(theta[: free.size], -REACH, REACH)
    return (out, theta[free.size :] if n_bias else bias), information


def map_point(model: WeberModel, scores: Array) -> dict[str, float]:
    """The most probable values of the inferred parameters, found from these lead scores on.

    Most probable in the normal scores of the priors (for the Weber fraction that is in ln k): the
    lapses' density itself has no top, it grows without end towards 0.
    """
    free = np.flatnonzero(model.free)
    n_bias = model.n_groups if model.free_bias else 0
    bias = np.full(model.n_groups, model.priors.moments("bias")[0] if n_bias else 0.0)
    (scores, bias), information = find_mode(model, scores, bias)
    precision = score_precision(model)
    scale = np.r_[1 / np.sqrt(np.diag(information))]
    centre = np.r_[scores[free], bias if n_bias else ()]

    def unpack(step: Array) -> tuple[Array, Array]:
        theta = centre + scale * step
        z = scores.copy()
        z[free] = np.clip(theta[: free.size], -REACH, REACH)
        own = theta[free.size :] if n_bias else np.full(model.n_groups, model.fixed_bias())
        return z, own

    def cost(step: Array) -> float:
        z, own = unpack(step)
        k, effects, low, high = lead_values(model, z)
        if sum(model.lapses(low, high)) >= 1:
            return 1e10
        log_density = model.log_likelihood(k, low, high, own, effects)
        log_density = log_density - 0.5 * z[free] @ precision @ z[free]
        return -float(log_density + model.log_bias_prior(own).sum() * bool(n_bias))

    found = minimize(cost, np.zeros(centre.size), method="Powell", options={"xtol": 1e-5})
    z, own = unpack(found.x)
    k, effects, low, high = lead_values(model, z)
    one = Draws(k[None], low[None], high[None], own[None], effects[None])
    return {name: float(value[0]) for name, value in one.named(model).items()}
