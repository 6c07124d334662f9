"""Sums of weights over nodes: errors from odd and even nodes, moments of mixtures, resampling.

A sum over even nodes is as good as its halves agree, those over odd and over even nodes. Where the
integrand is smooth, the error of the whole is about the square of what a half is off by, or less:

- `line_error(mass, axis)` and `log_error(mass)`: what halves of a grid of masses are off by;
- `half_error(share, mean_shift, half_sd, sd)`: the same of mass, mean and sd together;
- `halves(numbers)`: which nodes of a grid of several axes are in which half.

`mixture_moments(weight, mean, sd)` has the mean and sd of mixtures over nodes;
`systematic(weight, count, rng)` and `resampled(log_weight, count, rng)` keep nodes or draws by
their weights.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .values import Array, Flags, Index

__all__ = [
    "Moments", "half_error", "halves", "line_error", "log_error", "mixture_moments", "resampled",
    "systematic",
]  # fmt: skip


# -- errors from odd and even nodes ----------------------------------------------------------------


def line_error(mass: Array, axis: int = -1) -> float:
    """By which share of the mass every second node along an axis is off, line by line.

    Errors of lines are added up, so that those of a ridge across the axes do not cancel.

    Examples
    --------
    >>> even, ridge = np.ones((4, 4)), np.eye(4)
    >>> line_error(even), line_error(ridge)
    (0.0, 1.0)
    """
    if mass.shape[axis] == 1:
        return 0.0
    lines = np.moveaxis(mass, axis, -1)
    whole = lines.sum(axis=-1)
    return float(np.abs(2 * lines[..., ::2].sum(axis=-1) - whole).sum() / whole.sum())


def log_error(mass: Array) -> float:
    """By how much ln of a sum (N,) moves when every second node is left out."""
    if mass.size == 1:
        return 0.0
    return float(abs(np.log(max(2 * mass[::2].sum() / mass.sum(), 1e-300))))


def half_error(share: Array, mean_shift: Array, half_sd: Array, sd: Array) -> Array:
    """By how much a half of the nodes is off: the most of its mass, and of mean and sd in sds.

    Parameters
    ----------
    share : array
        Of the whole mass in the half, which should be a half.
    mean_shift : array
        By how much the half's mean is off.
    half_sd, sd : array
        The sd of the half and of the whole.
    """
    off = np.maximum(np.abs(mean_shift), np.abs(half_sd - sd)) / sd
    return np.maximum(np.abs(2 * share - 1), off)


def halves(numbers: NDArray[Any]) -> Iterator[tuple[Index, Flags]]:
    """The halves of a grid whose nodes have the integers (D, N) along its axes.

    By every set of axes: which these are, and the nodes (N,) whose numbers along them have an odd
    sum, then the others. Ridges along a diagonal look even along each axis, and not by sums.
    """
    for axes in product((0, 1), repeat=len(numbers)):
        if any(axes):
            odd = (axes @ numbers % 2).astype(bool)
            for half in (odd, ~odd):
                yield np.flatnonzero(axes), half


# -- mixtures --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Moments:
    """Sum of the weights of a mixture, and its mean and sd."""

    total: Array
    mean: Array
    sd: Array


def mixture_moments(weight: Array, mean: Array, sd: ArrayLike = 0.0) -> Moments:
    """Moments of mixtures of distributions at nodes, which are the first axis.

    Weights (N, ...) need no sum of 1; where they have more axes than means and sds, the mixtures
    are of each.

    Examples
    --------
    >>> m = mixture_moments(np.array([1.0, 3.0]), np.array([0.0, 4.0]), 1.0)
    >>> float(m.mean), float(m.sd)
    (3.0, 2.0)
    """
    total = np.maximum(weight.sum(axis=0), 1e-300)
    middle = (weight * mean).sum(axis=0) / total
    square = np.square(sd) + (mean - middle) ** 2
    return Moments(total, middle, np.sqrt((weight * square).sum(axis=0) / total))


# -- resampling ------------------------------------------------------------------------------------


def resampled(log_weight: Array, count: int, rng: np.random.Generator) -> Index:
    """Which (count,) of draws to keep by importance, given ln of their weights (n,); shuffled."""
    return rng.permutation(systematic(np.exp(log_weight - log_weight.max()), count, rng))


def systematic(weight: Array, count: int, rng: np.random.Generator) -> Index:
    """Systematic resampling: which (count,) of `weight` (n,), each by its share to within one.

    Examples
    --------
    >>> systematic(np.array([1.0, 3.0]), 4, np.random.default_rng(1)).tolist()
    [0, 1, 1, 1]
    """
    rise = np.cumsum(weight) / weight.sum()
    places = (np.arange(count) + rng.random()) / count
    return np.minimum(np.searchsorted(rise, places), len(rise) - 1)
