"""What every posterior of one observer can say, and its free parameters as vectors."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import minimize
from scipy.special import logsumexp

from .._util.refusals import Refusal
from .._util.values import Array
from .axes import bias_at, bias_prior
from .likelihood import Draws, WeberModel
from .priors import REACH, TINY, Priors

__all__ = [
    "FreeDensity", "WeberPosterior", "find_mode", "fraction_curve", "joint_lapses", "log_posterior",
    "log_prior_density", "log_score_density", "named_values", "prior_draws", "refuse_all_fixed",
    "split",
]  # fmt: skip


class FreeDensity(Protocol):
    """A posterior density of vectors of free coordinates, (N, D)."""

    @property
    def model(self) -> WeberModel: ...
    @property
    def start(self) -> tuple[Array, Array]:
        """Mean and sd of a vector under the prior."""

    def parameters(self, theta: Array) -> Draws:
        """Every parameter at vectors."""

    def log_likelihood(self, draws: Draws) -> Array:
        """Log-probability of the answers, (N,)."""

    def log_density(self, theta: Array) -> Array:
        """Log of prior times likelihood, (N,)."""


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

    @property
    def target(self) -> FreeDensity:
        """Its density."""


def split(model: WeberModel, theta: Array) -> tuple[Array, Array]:
    """Scores (..., lead) and biases (..., G) of the free parameters (..., D): scores of the lead,
    then the coordinates of biases."""
    free = np.flatnonzero(model.free)
    scores = np.zeros((*theta.shape[:-1], len(model.lead)))
    scores[..., free] = np.clip(theta[..., : free.size], -REACH, REACH)
    if model.free_bias:
        return scores, bias_at(model, theta[..., free.size :])
    return scores, np.full((*theta.shape[:-1], model.n_groups), model.fixed_bias())


def log_posterior(model: WeberModel, theta: Array) -> Array:
    """Log density of the free coordinates (..., D), not normalised; −∞ without a rise."""
    scores, bias = split(model, theta)
    k, effects, low, high = model.at_scores(scores)
    free = theta[..., : sum(model.free)]
    out = model.log_likelihood(k, low, high, bias, effects)
    out = out - 0.5 * np.einsum("...i,ij,...j->...", free, model.score_precision, free)
    out = out + bias_prior(model, theta[..., free.shape[-1] :]).sum(axis=-1)
    return np.where(sum(model.lapses(low, high)) < 1, out, -np.inf)


def find_mode(model: WeberModel, start: Array) -> tuple[Array, Array]:
    """Mode of the free coordinates (D,), found from a start, and their covariance there."""

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


def log_prior_density(model: WeberModel, draws: Draws) -> dict[str, Array]:
    """Log prior density of the inferred parameters at draws, (N,) each; of the biases (N, G).

    Two lapses that are correlated beforehand have one, "lapses", which is joint. That they sum to
    less than 1 changes it by a constant, and is left out.
    """
    named, priors = draws.named(model), model.priors
    both = ("lapse_low", "lapse_high")
    joint = all(name in named for name in both) and priors.lapse_correlation != 0
    out: dict[str, Array] = {}
    for name, values in named.items():
        if name in model.group_names:
            continue
        if not (joint and name in both):
            out[name] = priors.log_density(name, np.maximum(values, _least(priors, name)))
        elif name == both[0]:
            out["lapses"] = joint_lapses(priors, *(named[n] for n in both))
    if model.free_bias:
        out["bias"] = model.log_bias_prior(draws.bias)
    return out


def log_score_density(model: WeberModel, draws: Draws) -> dict[str, Array]:
    """The same of the normal scores of the parameters, but for a constant, (N,) each: of lapses
    under one name, of the biases in all under theirs.

    To any power it is a density, which that of a lapse, infinite at 0, is not.
    """
    named, priors = draws.named(model), model.priors
    rho = priors.lapse_correlation
    free = [name for name in model.task.lapses if name in named]
    out: dict[str, Array] = {}
    for name, values in named.items():
        if name not in (*free, *model.group_names):
            out[name] = -0.5 * priors.score(name, values) ** 2
        elif free and name == free[0]:
            scores = [priors.score(lapse, named[lapse]) for lapse in free]
            square = np.sum(np.square(scores), axis=0)
            if len(free) == 2:
                square = (square - 2 * rho * scores[0] * scores[1]) / (1 - rho**2)
            out["lapses"] = -0.5 * square
    if model.free_bias:
        out[model.task.bias_name or "bias"] = -0.5 * np.square(
            priors.score("bias", draws.bias)
        ).sum(axis=1)
    return out


def _least(priors: Priors, name: str) -> float:
    """Below which a density that is infinite at 0 is taken as there."""
    return TINY if priors.support(name)[0] == 0 else -np.inf


def joint_lapses(priors: Priors, low: Array, high: Array) -> Array:
    """Log density of two lapses whose normal scores are correlated."""
    rho, lapses = priors.lapse_correlation, {"lapse_low": low, "lapse_high": high}
    total: Any = 0.0
    for name, lapse in lapses.items():
        total = total + priors.log_density(name, np.maximum(lapse, TINY))
    a, b = (priors.score(name, lapse) for name, lapse in lapses.items())
    left = 1 - rho**2
    copula = (2 * rho * a * b - rho**2 * (a**2 + b**2)) / (2 * left) - 0.5 * np.log(left)
    return np.asarray(total + copula)


def named_values(model: WeberModel, theta: Array) -> dict[str, float]:
    """Free coordinates (D,) as values of the inferred parameters."""
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
