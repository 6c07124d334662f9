"""Animals that share a population in simulated experiments: ln k is normal, on nodes.

Lapses and biases of each animal are integrated out first, each animal for itself, which leaves a
likelihood of its ln k. Given the mean and the sd of the population these are independent, so that
the posterior is a sum over two axes: quick enough for thousands of experiments. `fit_population`
learns lapses and biases from all animals too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from .._util.values import Array
from ..behaviour.priors import SPREAD

__all__ = ["PopulationGrid", "spread_nodes"]


def normal_weights(x: Array, mean: Array, sd: Array) -> Array:
    """Probability of each even node x (X,) under normals, (X, ...).

    The end nodes stand for all beyond them, where a likelihood goes on as it was: populations out
    there are unlikely by their prior, and not impossible.
    """
    half = 0.5 * (x[1] - x[0])
    away = x.reshape(-1, *[1] * np.ndim(mean)) - mean
    below = -np.abs(away)  # a tail that is not lost to rounding
    out = ndtr((below + half) / sd) - ndtr((below - half) / sd)
    out[0], out[-1] = ndtr((away[0] + half) / sd), ndtr((half - away[-1]) / sd)
    return np.asarray(out)


def log_product(log_like: Array, weights: Array) -> Array:
    """ln of likelihoods (..., X) averaged with each column of weights (X, N), (..., N)."""
    top = log_like.max(axis=-1, keepdims=True)
    return np.asarray(np.log(np.maximum(np.exp(log_like - top) @ weights, 1e-300)) + top)


@dataclass(frozen=True)
class PopulationGrid:
    """Populations on nodes of mean and spread, and what animals say of them.

    `kernel` (X, M·T) is the probability of each even node of ln k in each population;
    `log_weight` (M, T) is ln of the prior density times the node's share of the integral.
    """

    kernel: Array
    log_weight: Array

    @classmethod
    def at(cls, log_k: Array, mean: Array, sd: Array, log_weight: Array) -> PopulationGrid:
        """Of populations with means (M, T) and sds (T,), on nodes log_k (X,)."""
        return cls(normal_weights(log_k, mean, sd).reshape(log_k.size, -1), log_weight)

    def by_animal(self, log_like: Array) -> Array:
        """Log-likelihood of each population, (..., A, M·T), by those of ln k, (..., A, X)."""
        return log_product(log_like, self.kernel)

    def log_mass(self, by_animal: Array) -> Array:
        """ln of prior, likelihood of all animals and share of the integral, (..., M, T)."""
        total = by_animal.sum(axis=-2)
        return np.asarray(total.reshape(*total.shape[:-1], *self.log_weight.shape)
                          + self.log_weight)  # fmt: skip


def spread_nodes(count: int) -> tuple[Array, Array]:
    """Gauss–Legendre nodes of the default prior of the spread (T,), and ln of their probability."""
    node, weight = np.polynomial.legendre.leggauss(count)
    half = 0.5 * float(SPREAD.ppf(1 - 1e-4))
    spread = half * (node + 1)
    return spread, np.log(half * weight) + SPREAD.logpdf(spread)
