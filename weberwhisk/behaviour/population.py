"""The integral over a population of animals whose ln k is normal.

Lapses and biases of each animal are integrated out first, which leaves a likelihood of its ln k.
Given the mean and the sd of the population these are independent, so that the whole posterior is a
sum over two axes: `PopulationGrid`, which fits and power analyses share.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import binary_dilation
from scipy.special import ndtr

from .._util.values import Array, weighted_quantiles
from .._util.weights import log_error
from .priors import SPREAD

__all__ = [
    "Population", "PopulationGrid", "integrate_population", "spread_nodes", "trapezoid_shares",
]  # fmt: skip

Likelihood = tuple[Array, Array]  # nodes of ln k (K,), and the log-likelihood of one animal there


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


def narrowest(sd: Array, step: float) -> Array:
    """Sds of normals on nodes that far apart: one narrower than the nodes is as wide as they are, a
    fifth of what any animal says."""
    return np.maximum(sd, 0.8 * step)


def trapezoid_shares(count: int) -> Array:
    """Weights of even nodes in the trapezoid rule, in steps (count,)."""
    return np.r_[0.5, np.ones(count - 2), 0.5]


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


@dataclass(frozen=True)
class Population:
    """The posterior of a population on nodes, and of ln k of its animals.

    `mass` (M, T) is the probability of each node: `mean` (M, T) of ln k, and its sd, the `spread`
    (T,). `animals` (A, X) are the probabilities of ln k of each animal on the nodes `log_k`, given
    all the data, and `log_likelihood` (A, X) what its own choices say. Between nodes the density is
    linear.
    """

    mean: Array
    spread: Array
    mass: Array
    log_k: Array
    animals: Array
    log_likelihood: Array
    log_evidence: float
    error: float

    def nodes(self, parameter: str) -> tuple[Array, Array]:
        """Values of "weber_fraction" or "spread" and their probabilities, flat."""
        if parameter == "spread":
            return self.spread, self.mass.sum(axis=0)
        return np.exp(self.mean).ravel(), self.mass.ravel()

    def draws(self, count: int, rng: np.random.Generator) -> dict[str, Array]:
        """Joint draws of both parameters, each (count,): nodes, moved within their cells."""
        at = rng.choice(self.mass.size, count, p=self.mass.ravel())
        places = []
        for i, n in zip(np.unravel_index(at, self.mass.shape), self.mass.shape, strict=True):
            moved = np.abs(i + rng.random(count) - rng.random(count))  # for a spread of 0 exact
            places.append(np.minimum(moved, n - 1 - 1e-9))
        (m, t), (dm, dt) = [p.astype(int) for p in places], [p % 1 for p in places]
        spread = self.spread[t] + dt * (self.spread[t + 1] - self.spread[t])
        low, high = (self.mean[m, t + j] * (1 - dm) + self.mean[m + 1, t + j] * dm for j in (0, 1))
        return {"weber_fraction": np.exp(low + dt * (high - low)), "spread": spread}

    def given(
        self, log_mean: Array, spread: Array, rng: np.random.Generator
    ) -> tuple[Array, Array]:
        """Of each animal in populations (N,): log-likelihood of its choices, and a draw of its ln
        k, (A, N)."""
        step = self.log_k[1] - self.log_k[0]
        kernel = normal_weights(self.log_k, log_mean, narrowest(spread, step))  # (X, N)
        shared = np.exp(self.log_likelihood - self.log_likelihood.max(axis=1, keepdims=True))
        drawn = np.empty((len(shared), log_mean.size))
        for row, likelihood in zip(drawn, shared, strict=True):
            below = np.cumsum(likelihood[:, None] * kernel, axis=0)
            node = (below < rng.random(log_mean.size) * below[-1]).sum(axis=0)
            moved = rng.random(log_mean.size) - rng.random(log_mean.size)
            row[:] = self.log_k[node] + step * moved
        return log_product(self.log_likelihood, kernel), drawn


def integrate_population(
    animals: Sequence[Likelihood], log_prior: Callable[[Array], Array], spread: Any
) -> Population:
    """The posterior of a population of animals.

    Parameters
    ----------
    animals : sequence of (ln k, log-likelihood)
    log_prior : callable
        Log prior density of the mean of ln k.
    spread : frozen distribution
        Prior of its sd between animals.
    """
    mean, sd, core = np.array([_moments(*one) for one in animals]).T
    # Spreads are distinguished from 0.1 on, however little the animals say.
    step = min(float(core.min()) / 4, 0.15)
    first, last = min(k[0] for k, _ in animals), max(k[-1] for k, _ in animals)
    x = np.arange(first - 0.5, last + 0.5, step)
    log_like = np.array([_onto(x, *one) for one in animals])
    bounds = [(-12.0, 12.0), (float(spread.support()[0]), float(spread.ppf(1 - 1e-6)))]
    ranges = bounds
    for count in (25, 25, 25, 81):
        place, tau = (np.linspace(*ends, count) for ends in ranges)
        # The mean in its sds from its middle, given the spread, as if likelihoods were normal.
        weight = 1 / (sd[:, None] ** 2 + tau**2)  # (A, T)
        width = 1 / np.sqrt(weight.sum(axis=0))
        mu = width**2 * (weight * mean[:, None]).sum(axis=0) + width * place[:, None]
        with np.errstate(divide="ignore"):
            log_weight = log_prior(mu) + spread.logpdf(tau)
            # Half at either end, the trapezoid rule: exact at a spread of 0.
            log_weight += np.log(width * np.outer(*map(trapezoid_shares, mu.shape)))
        grid = PopulationGrid.at(x, mu, narrowest(tau, step), log_weight)
        by_animal = grid.by_animal(log_like)  # (A, M·T)
        log_mass = grid.log_mass(by_animal)
        top = float(log_mass.max())
        mass = np.exp(log_mass - top)
        ranges = [
            _narrowed(mass.sum(axis=1 - i), axis, ends)
            for i, (axis, ends) in enumerate(zip((place, tau), bounds, strict=True))
        ]
    total = mass.sum()
    mass /= total
    cell = (place[1] - place[0]) * (tau[1] - tau[0])
    error = max(log_error(mass.sum(axis=i)) ** 2 for i in (0, 1))
    # Where a prior ends between two nodes, half a cell beside each may be misjudged.
    possible = np.isfinite(log_mass)
    error = max(error, 0.5 * float(mass[possible & binary_dilation(~possible)].sum()))
    # What the others say of an animal: every population by how it fares without it.
    flat = mass.ravel()
    low = by_animal.min(axis=1, keepdims=True, where=flat > 1e-12 * flat.max(), initial=np.inf)
    of_others = (flat * np.exp(np.minimum(low - by_animal, 0.0))) @ grid.kernel.T
    log_animals = log_like + np.log(np.maximum(of_others, 1e-300))
    animals_mass = np.exp(log_animals - log_animals.max(axis=1, keepdims=True))
    animals_mass /= animals_mass.sum(axis=1, keepdims=True)
    return Population(
        mu, tau, mass, x, animals_mass, log_like, top + float(np.log(total * cell)), error
    )


def _moments(log_k: Array, log_like: Array) -> tuple[float, ...]:
    """Mean and sd of ln k in the likelihood of one animal, and the sd that its quartiles have.

    Lapses may explain any answers: the likelihood has a tail that widens its sd.
    """
    mass = np.exp(log_like - log_like.max())
    mass /= mass.sum()
    mean = float(mass @ log_k)
    low, high = weighted_quantiles(log_k, mass, [0.25, 0.75])
    return mean, float(np.sqrt(mass @ (log_k - mean) ** 2)), float(high - low) / 1.35


def _onto(x: Array, log_k: Array, log_like: Array) -> Array:
    """A log-likelihood at other nodes; beyond its own it goes on as it was: flat, or falling."""
    curve = CubicSpline(log_k, log_like)
    slopes = curve(log_k[[0, -1]], 1)
    below, above = np.minimum(x - log_k[0], 0), np.maximum(x - log_k[-1], 0)
    inside = curve(np.clip(x, log_k[0], log_k[-1]))
    return np.asarray(inside + below * max(slopes[0], 0.0) + above * min(slopes[1], 0.0))


def _narrowed(
    mass: Array, axis: Array, bounds: tuple[float, float], least: float = 1e-6
) -> tuple[float, float]:
    """The part of an axis with at least that share of the peak, a step more on either side."""
    above, step = axis[mass > least * mass.max()], axis[1] - axis[0]
    return max(above[0] - step, bounds[0]), min(above[-1] + step, bounds[1])
