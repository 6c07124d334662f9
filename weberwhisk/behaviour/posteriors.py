"""What every posterior of one observer can say, and its free parameters as vectors."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import minimize
from scipy.special import logsumexp

from .._util.refusals import Refusal
from .._util.values import Array
from .likelihood import Draws, WeberModel
from .priors import REACH

__all__ = [
    "WeberPosterior", "find_mode", "fraction_curve", "log_posterior", "named_values", "prior_draws",
    "refuse_all_fixed", "split",
]  # fmt: skip


class WeberPosterior(Protocol):
    """The posterior of one observer: `QuadraturePosterior`, `ImportancePosterior` (of states,
    `StatePosterior`), or `SampledPosterior` by emcee.

    `draws` are in `chains` one after another; `error` is estimated, relative to the posterior sd;
    `trouble` says why the numbers are not to be relied on, and is empty where they are;
    `log_evidence` is that of the sequence of answers, None by emcee.
    """

    @property
    def model(self) -> WeberModel: ...
    @property
    def chains(self) -> int: ...
    @property
    def error(self) -> float: ...
    @property
    def trouble(self) -> str: ...
    @property
    def log_evidence(self) -> float | None: ...
    def mean(self, name: str) -> float:
        """Posterior mean of a parameter."""

    def sd(self, name: str) -> float:
        """Its standard deviation."""

    def quantile(self, name: str, probability: ArrayLike) -> Array:
        """Its quantiles."""

    def score_curve(self) -> tuple[Array, Array]:
        """Scores of k, and ln of the posterior density there, but for a constant."""

    def mode(self) -> dict[str, float]:
        """The most probable value of every parameter."""

    def draws(self) -> Draws:
        """Joint draws, by the seed of the fit."""

    def reproducible_draws(self) -> Draws:
        """Joint draws that do not depend on the seed of the fit, for verdicts about the data."""

    def recomputed(self, model: WeberModel) -> WeberPosterior | None:
        """The posterior of another model by the same method; None where that is not quick."""


def split(model: WeberModel, theta: Array) -> tuple[Array, Array]:
    """Scores (..., lead) and biases (..., G) of the free parameters (..., D), biases last."""
    free = np.flatnonzero(model.free)
    scores = np.zeros((*theta.shape[:-1], len(model.lead)))
    scores[..., free] = np.clip(theta[..., : free.size], -REACH, REACH)
    if model.free_bias:
        return scores, theta[..., free.size :]
    return scores, np.full((*theta.shape[:-1], model.n_groups), model.fixed_bias())


def log_posterior(model: WeberModel, theta: Array) -> Array:
    """Log density of the free scores and biases (..., D), not normalised; −∞ without a rise."""
    scores, bias = split(model, theta)
    k, effects, low, high = model.at_scores(scores)
    free = theta[..., : sum(model.free)]
    out = model.log_likelihood(k, low, high, bias, effects)
    out = out - 0.5 * np.einsum("...i,ij,...j->...", free, model.score_precision, free)
    out = out + model.log_bias_prior(bias).sum(axis=-1)
    return np.where(sum(model.lapses(low, high)) < 1, out, -np.inf)


def find_mode(model: WeberModel, start: Array) -> tuple[Array, Array]:
    """Mode of the free scores and biases (D,), found from a start, and their covariance there."""

    def cost(theta: Array) -> Any:
        return -np.maximum(log_posterior(model, theta), -1e10)

    def slope(theta: Array) -> Array:
        nudge = 1e-4 * np.eye(theta.size)
        return (cost(theta + nudge) - cost(theta - nudge)) / 2e-4

    best = minimize(cost, start, jac=slope, method="BFGS", options={"gtol": 1e-3})
    return best.x, np.asarray(best.hess_inv)


def prior_draws(model: WeberModel, size: int, rng: np.random.Generator) -> Draws:
    """Joint draws from the prior of a model."""
    free = np.array(model.free)
    kept: list[Array] = []
    while sum(map(len, kept)) < size:
        z = rng.standard_normal((size, free.size)) * free
        if free[-2:].all():
            rho = model.priors.lapse_correlation
            z[:, -1] = rho * z[:, -2] + np.sqrt(1 - rho**2) * z[:, -1]
        *_, low, high = model.at_scores(z)
        kept.append(z[sum(model.lapses(low, high)) < 1])
    if model.free_bias:
        uniform = rng.random((size, model.n_groups))
        bias = np.asarray(model.priors.of("bias").ppf(uniform))
    else:
        bias = np.full((size, model.n_groups), model.fixed_bias())
    return model.completed(model.draws_at(np.concatenate(kept)[:size], bias), rng)


def named_values(model: WeberModel, theta: Array) -> dict[str, float]:
    """Free scores and biases (D,) as values of the inferred parameters."""
    one = model.draws_at(*split(model, theta[None]))
    return {name: float(value[0]) for name, value in one.named(model).items()}


def refuse_all_fixed(dimensions: int) -> None:
    """Refuses a posterior without a parameter."""
    if dimensions == 0:
        raise Refusal(
            "every parameter is fixed", remedy="leave at least one of them a distribution"
        )


def fraction_curve(model: WeberModel, draws: Draws) -> tuple[Array, Array]:
    """ln of the posterior density of k's score: its own given the rest, averaged over draws.

    Counts of draws would say nothing of ends where there is one in a thousand of them.
    """
    axis = np.linspace(-REACH, REACH, 73)
    low, high, bias, effects = (
        np.repeat(values[:, None], axis.size, axis=1) for values in draws.values[1:]
    )
    k = np.broadcast_to(model.value("weber_fraction", axis), low.shape)
    if model.by_session is None:
        log = model.log_likelihood(k, low, high, bias, effects)
    else:  # biases of sessions are among what is given
        deviation = np.asarray(model.deviation(draws))[:, None]
        log = model.cell_log_likelihood(k, low, high, bias, effects, deviation).sum(axis=-1)
    log = log - 0.5 * axis**2
    log -= logsumexp(log, axis=1, keepdims=True)
    return axis, logsumexp(log, axis=0)
