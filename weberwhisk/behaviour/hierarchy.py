"""Many animals at once: ln k of each is drawn from one normal distribution.

Each animal has lapses and biases of its own, with the priors of a single fit. They are integrated
out first, which leaves a likelihood of its ln k. Given the mean and the standard deviation of the
population these likelihoods are independent, so that the whole posterior is a sum over two axes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import binary_dilation
from scipy.special import ndtr

from .._util.values import Array
from .integrate import half_grid_error

__all__ = ["Population", "integrate_population", "log_product", "normal_weights"]

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


def log_product(log_like: Array, weights: Array) -> Array:
    """ln of likelihoods (..., X) averaged with each column of weights (X, N), (..., N)."""
    top = log_like.max(axis=-1, keepdims=True)
    return np.asarray(np.log(np.maximum(np.exp(log_like - top) @ weights, 1e-300)) + top)


@dataclass(frozen=True)
class Population:
    """The posterior of a population on nodes, and of ln k of its animals.

    `mass` (M, T) is the probability of each node: `mean` (M, T) of ln k, and its sd, the `spread`
    (T,). `animals` (A, X) are the probabilities of ln k of each animal on the nodes `log_k`, given
    all the data. Between nodes the density is linear.
    """

    mean: Array
    spread: Array
    mass: Array
    log_k: Array
    animals: Array
    log_evidence: float
    error: float

    def nodes(self, parameter: str) -> tuple[Array, Array]:
        """Values of "weber_fraction" or "spread" and their probabilities, flat."""
        if parameter == "spread":
            return self.spread, self.mass.sum(axis=0)
        return np.exp(self.mean).ravel(), self.mass.ravel()

    def draws(self, count: int, seed: int) -> dict[str, Array]:
        """Joint draws of both parameters, each (count,): nodes, moved within their cells."""
        rng = np.random.default_rng(seed)
        at = rng.choice(self.mass.size, count, p=self.mass.ravel())
        places = []
        for i, n in zip(np.unravel_index(at, self.mass.shape), self.mass.shape, strict=True):
            moved = np.abs(i + rng.random(count) - rng.random(count))  # for a spread of 0 exact
            places.append(np.minimum(moved, n - 1 - 1e-9))
        (m, t), (dm, dt) = [p.astype(int) for p in places], [p % 1 for p in places]
        spread = self.spread[t] + dt * (self.spread[t + 1] - self.spread[t])
        low, high = (self.mean[m, t + j] * (1 - dm) + self.mean[m + 1, t + j] * dm for j in (0, 1))
        return {"weber_fraction": np.exp(low + dt * (high - low)), "spread": spread}


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
    mean, sd = np.array([_moments(*one) for one in animals]).T
    # Spreads are distinguished from 0.1 on, however little the animals say.
    step = min(float(sd.min()) / 4, 0.15)
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
        # A normal narrower than the nodes is as wide as they are: a fifth of what any animal says.
        kernel = normal_weights(x, mu, np.maximum(tau, 0.8 * step)).reshape(x.size, -1)
        by_animal = log_product(log_like, kernel)  # (A, M·T)
        with np.errstate(divide="ignore"):
            log_mass = by_animal.sum(axis=0).reshape(mu.shape) + log_prior(mu) + spread.logpdf(tau)
            log_mass += np.log(width * _end_weights(mu.shape))
        top = float(log_mass.max())
        mass = np.exp(log_mass - top)
        ranges = [
            _narrowed(mass.sum(axis=1 - i), axis, ends)
            for i, (axis, ends) in enumerate(zip((place, tau), bounds, strict=True))
        ]
    total = mass.sum()
    mass /= total
    cell = (place[1] - place[0]) * (tau[1] - tau[0])
    error = max(half_grid_error(mass.sum(axis=i)) ** 2 for i in (0, 1))
    # Where a prior ends between two nodes, half a cell beside each may be misjudged.
    possible = np.isfinite(log_mass)
    error = max(error, 0.5 * float(mass[possible & binary_dilation(~possible)].sum()))
    # What the others say of an animal: every population by how it fares without it.
    flat = mass.ravel()
    low = by_animal.min(axis=1, keepdims=True, where=flat > 1e-12 * flat.max(), initial=np.inf)
    of_others = (flat * np.exp(np.minimum(low - by_animal, 0.0))) @ kernel.T
    found = log_like + np.log(np.maximum(of_others, 1e-300))
    found = np.exp(found - found.max(axis=1, keepdims=True))
    found /= found.sum(axis=1, keepdims=True)
    return Population(mu, tau, mass, x, found, top + float(np.log(total * cell)), error)


def _moments(log_k: Array, log_like: Array) -> tuple[float, float]:
    """Mean and sd of ln k in the likelihood of one animal."""
    mass = np.exp(log_like - log_like.max())
    mass /= mass.sum()
    mean = float(mass @ log_k)
    return mean, float(np.sqrt(mass @ (log_k - mean) ** 2))


def _onto(x: Array, log_k: Array, log_like: Array) -> Array:
    """A log-likelihood at other nodes; beyond its own it goes on as it was: flat, or falling."""
    curve = CubicSpline(log_k, log_like)
    slopes = curve(log_k[[0, -1]], 1)
    below, above = np.minimum(x - log_k[0], 0), np.maximum(x - log_k[-1], 0)
    inside = curve(np.clip(x, log_k[0], log_k[-1]))
    return np.asarray(inside + below * max(slopes[0], 0.0) + above * min(slopes[1], 0.0))


def _end_weights(shape: Sequence[int]) -> Array:
    """Half at either end of both axes, 1 within: the trapezoid rule, exact at a spread of 0."""
    out = np.ones(shape)
    for axis in (0, 1):
        np.moveaxis(out, axis, 0)[[0, -1]] *= 0.5
    return out


def _narrowed(
    mass: Array, axis: Array, bounds: tuple[float, float], least: float = 1e-6
) -> tuple[float, float]:
    """The part of an axis with at least that share of the peak, a step more on either side."""
    above, step = axis[mass > least * mass.max()], axis[1] - axis[0]
    return max(above[0] - step, bounds[0]), min(above[-1] + step, bounds[1])
