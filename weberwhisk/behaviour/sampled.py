"""Draws of the posterior of one observer by emcee, a check that shares the model alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from .._util.values import Array, Fields
from .importance import Target
from .likelihood import Draws, WeberModel
from .posteriors import (
    find_mode,
    fraction_curve,
    log_posterior,
    named_values,
    refuse_all_fixed,
    split,
)
from .priors import REACH

__all__ = ["SampledPosterior", "sample"]


@dataclass(frozen=True, repr=False)
class SampledPosterior(Fields):
    """Draws by emcee: `chains` independent ensembles one after another."""

    model: WeberModel
    sample: Draws
    chains: int
    error: float
    trouble: str
    log_evidence: None = None

    def mean(self, name: str) -> float:
        return float(self._column(name).mean())

    def sd(self, name: str) -> float:
        return float(self._column(name).std())

    def quantile(self, name: str, probability: ArrayLike) -> Array:
        at = np.asarray(probability, dtype=float)
        return np.asarray(np.quantile(self._column(name), at), dtype=float)

    def score_curve(self) -> tuple[Array, Array]:
        return fraction_curve(self.model, self.sample.thinned(400))

    def mode(self) -> dict[str, float]:
        dim = sum(self.model.free) + self.model.free_bias * self.model.n_groups
        return named_values(self.model, find_mode(self.model, np.zeros(dim))[0])

    def draws(self) -> Draws:
        return self.sample

    def reproducible_draws(self) -> Draws:
        return self.sample  # there are no others

    def recomputed(self, model: WeberModel) -> None:
        return None

    @property
    def target(self) -> Target:
        return Target(self.model)

    def _column(self, name: str) -> Array:
        named = self.sample.named(self.model)
        return named[name] if name in named else np.full(2, self.model.fixed_value(name))


def sample(
    model: WeberModel, *, seed: int | np.random.SeedSequence | np.random.Generator
) -> SampledPosterior:
    """Sample the posterior with emcee, four ensembles of the scores and biases.

    `trouble` says so where the run has not converged, to 0.03 sds of every parameter.
    """
    from .._util.sampling import Shortfall, sample_stacked

    rng = np.random.default_rng(seed)
    dim = sum(model.free) + model.free_bias * model.n_groups
    refuse_all_fixed(dim)

    def log_density(theta: Array) -> Array:
        inside = (np.abs(theta[..., : sum(model.free)]) < REACH).all(axis=-1)
        return np.where(inside, log_posterior(model, theta), -np.inf)

    centre, covariance = find_mode(model, np.zeros(dim))
    root = np.linalg.cholesky(covariance)
    start = centre + rng.standard_normal((1, 4, max(32, 4 * dim), dim)) @ root.T
    # A start outside the support is pulled towards the mode until it is inside.
    while (lost := ~np.isfinite(log_density(start))).any():
        start[lost] = centre + 0.5 * (start[lost] - centre)
    run = sample_stacked(log_density, start, seed=rng, precision=0.03)
    flat = run.values[0].reshape(-1, dim)
    error = float(np.max(run.mcse_mean[0] / run.sd[0]))
    trouble = "" if run.converged[0] else f"emcee: {Shortfall(int(run.shortfall[0])).message}"
    return SampledPosterior(model, model.draws_at(*split(model, flat)), 4, error, trouble)
