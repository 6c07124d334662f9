"""The same posterior by emcee, through the stacked sampler; the check on the quadrature."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..posterior.ensemble import sample_stacked
from .likelihood import TINY, WeberModel
from .mode import LEAD, REACH, find_mode, free_scores, score_value
from .posteriors import Draws

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SampledPosterior:
    """Draws by emcee: `chains` independent ensembles one after another."""

    model: WeberModel
    sample: Draws
    chains: int
    error: float
    trouble: str
    log_evidence: float | None = None

    def mean(self, name: str) -> float:
        return float(self._column(name).mean())

    def sd(self, name: str) -> float:
        return float(self._column(name).std())

    def quantile(self, name: str, probability: ArrayLike) -> Array:
        at = np.asarray(probability, dtype=float)
        return np.asarray(np.quantile(self._column(name), at), dtype=float)

    def draws(self) -> Draws:
        return self.sample

    def _column(self, name: str) -> Array:
        named = self.sample.named(self.model)
        return named[name] if name in named else np.full(2, self.model.fixed_value(name))


def sample(
    model: WeberModel,
    *,
    seed: int | np.random.SeedSequence | np.random.Generator,
    ensembles: int = 4,
    precision: float = 0.03,
) -> SampledPosterior:
    """Sample the posterior with emcee, in the normal scores of the priors (biases as they are).

    Parameters
    ----------
    model : WeberModel
    seed : int, SeedSequence or Generator
    ensembles : int
        Independent ensembles; R-hat compares them.
    precision : float
        Monte Carlo error asked for, in posterior sds.

    Returns
    -------
    SampledPosterior
        `trouble` says so where the run has not converged.
    """
    rng = np.random.default_rng(seed)
    free = np.flatnonzero(free_scores(model))
    n_bias = model.n_groups if model.free_bias else 0
    dim = free.size + n_bias
    if dim == 0:
        raise ValueError("every parameter is fixed; leave at least one of them a distribution.")

    # SciPy's quantile functions cost more than the likelihood: tabulated once, finely.
    table = np.linspace(-REACH, REACH, 18_001)
    logs = {name: np.log(np.maximum(score_value(model, name, table), TINY)) for name in LEAD}

    def unpack(theta: Array) -> tuple[Array, Array, Array, Array]:
        z = np.zeros((*theta.shape[:-1], 3))
        z[..., free] = theta[..., : free.size]
        k, low, high = (np.exp(np.interp(z[..., i], table, logs[n])) for i, n in enumerate(LEAD))
        if n_bias:
            return k, low, high, theta[..., free.size :]
        return k, low, high, np.full((*k.shape, model.n_groups), model.fixed_bias())

    def log_density(theta: Array) -> Array:
        k, low, high, bias = unpack(theta)
        scores = theta[..., : free.size]
        possible = (sum(model.lapses(low, high)) < 1) & (np.abs(scores) < REACH).all(axis=-1)
        out = model.log_likelihood(k, low, high, bias)
        out = (
            out
            - 0.5 * (scores**2).sum(axis=-1)
            + model.log_bias_prior(bias).sum(axis=-1) * bool(n_bias)
        )
        return np.where(possible, out, -np.inf)

    mode, information = find_mode(model, np.zeros(3), np.zeros(model.n_groups))
    scores, bias = mode
    root = np.linalg.cholesky(np.linalg.inv(information))
    walkers = max(32, 4 * dim)
    centre = np.r_[scores[free], bias if n_bias else ()]
    start = centre + rng.standard_normal((1, ensembles, walkers, dim)) @ root.T
    # A start outside the support is pulled towards the mode until it is inside.
    for _ in range(60):
        lost = ~np.isfinite(log_density(start))
        if not lost.any():
            break
        start[lost] = centre + 0.5 * (start[lost] - centre)
    run = sample_stacked(log_density, start, seed=rng, precision=precision)
    flat = run.draws[0].reshape(-1, dim)
    error = float(np.max(run.mcse_mean[0, :dim] / run.sd[0, :dim]))
    trouble = "" if run.converged[0] else f"emcee: {_reason(run.shortfall[0])}"
    return SampledPosterior(model, Draws(*unpack(flat)), ensembles, error, trouble)


def _reason(shortfall: int) -> str:
    from ..posterior.ensemble import Shortfall

    return Shortfall(int(shortfall)).message
