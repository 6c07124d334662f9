"""The highest point of a posterior and its curvature there, many readings at a time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from ..observer import Observer
from .densities import refuse_impossible

Array = NDArray[np.float64]

#: Coarse grid of starting points, per unknown, as fractions of its range.
#: In three dimensions and more the further unknowns take few values.
_COARSE = {1: expit(np.linspace(-8.0, 8.0, 129)), 2: expit(np.linspace(-7.0, 6.0, 27))}
_STEP = 1e-4  # of the finite differences, in x: posteriors there are 0.005 wide and wider


@dataclass(frozen=True, eq=False)
class Mode:
    """Modes of B posteriors in the coordinates x.

    Attributes
    ----------
    x : array, shape (B, U)
    log_density : array, shape (B,)
    covariance : array, shape (B, U, U)
        Inverse of the negative Hessian; where that is not positive, of its absolute value.
    """

    x: Array
    log_density: Array
    covariance: Array


def find_mode(
    observer: Observer, reading: Array, *, steps: int = 60, start: Array | None = None
) -> Mode:
    """Newton's method in a trust region, from the best point of a coarse grid.

    Parameters
    ----------
    observer : Observer
    reading : array, shape (B, S)
    steps : int
        Most iterations; few posteriors need more than ten.
    start : array, shape (n, U), optional
        Coordinates of the places to start from the best of; by default a coarse grid.
    """
    dim = len(observer.unknowns)
    grid = observer.spread(_COARSE[min(dim, 2)]) if start is None else start
    contact, log_prior = observer.contact(grid)
    signals, outcome = observer.signals(contact)
    held = outcome == 0
    grid, signals = grid[held], signals[held]
    log_prior = log_prior[held]
    best = np.empty(len(reading), dtype=np.intp)
    for i in range(0, len(reading), 256):
        part = slice(i, i + 256)
        value = observer.noise.log_likelihood(reading[part, None], signals) + log_prior
        refuse_impossible(reading[part], value.max(axis=1))
        best[part] = np.argmax(value, axis=1)

    x = grid[best].copy()
    radius = np.full(len(x), 0.5)
    stencil, weights_gradient, weights_hessian = _stencil(dim)
    top = np.full(len(x), -np.inf)
    centre = x.copy()
    gradient, hessian = np.zeros((len(x), dim)), np.zeros((len(x), dim, dim))
    moving = np.arange(len(x))
    for _ in range(steps):
        points = x[moving, None] + _STEP * stencil
        values = observer.log_density(points, reading[moving, None])
        now = values[:, 0]
        better = now >= top[moving]
        accepted, rejected = moving[better], moving[~better]
        centre[accepted], top[accepted] = x[accepted], now[better]
        relative = values[better] - now[better, None]
        gradient[accepted] = relative @ weights_gradient.T / _STEP
        hessian[accepted] = np.einsum("dek,bk->bde", weights_hessian, relative) / _STEP**2
        radius[rejected] /= 4
        radius[accepted] *= 1.5
        step = _newton(gradient[moving], hessian[moving], radius[moving])
        x[moving] = centre[moving] + step
        # Converged to a fraction of the posterior's own width, or to rounding.
        gain = np.abs(np.einsum("bd,bd->b", step, gradient[moving]))
        moving = moving[(gain > 1e-9) & (radius[moving] > 1e-9)]
        if not moving.size:
            break
    values, vectors = np.linalg.eigh(hessian)
    scale = 1 / np.maximum(np.abs(values), 1e-6)
    covariance = np.einsum("bde,be,bfe->bdf", vectors, scale, vectors)
    return Mode(centre, top, covariance)


def _stencil(dim: int) -> tuple[Array, Array, Array]:
    """Offsets around a point (the point itself first) and the weights of gradient and Hessian."""
    unit = np.eye(dim)
    pairs = [(i, j) for i in range(dim) for j in range(i)]
    offsets = [np.zeros(dim), *(sign * unit[i] for i in range(dim) for sign in (1, -1))]
    offsets += [
        s * unit[i] + t * unit[j] for i, j in pairs for s, t in ((1, 1), (-1, -1), (1, -1), (-1, 1))
    ]
    gradient = np.zeros((dim, len(offsets)))
    hessian = np.zeros((dim, dim, len(offsets)))
    for i in range(dim):
        gradient[i, 1 + 2 * i : 3 + 2 * i] = [0.5, -0.5]
        hessian[i, i, [0, 1 + 2 * i, 2 + 2 * i]] = [-2, 1, 1]
    for k, (i, j) in enumerate(pairs):
        first = 1 + 2 * dim + 4 * k
        hessian[i, j, first : first + 4] = hessian[j, i, first : first + 4] = [
            0.25, 0.25, -0.25, -0.25,
        ]  # fmt: skip
    return np.array(offsets), gradient, hessian


def _newton(gradient: Array, hessian: Array, radius: Array) -> Array:
    """An uphill Newton step no longer than the radius."""
    values, vectors = np.linalg.eigh(hessian)
    curvature = np.maximum(np.abs(values), 1e-6)
    step = np.einsum("bde,be,bfe,bf->bd", vectors, 1 / curvature, vectors, gradient)
    length = np.linalg.norm(step, axis=1)
    return step * np.minimum(1.0, radius / np.maximum(length, 1e-300))[:, None]
