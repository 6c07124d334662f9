"""The weighted nodes of one posterior, and quantiles read off them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import special

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Nodes:
    """The weighted nodes of one posterior.

    Attributes
    ----------
    points : array, shape (N, D)
    weights : array, shape (N,)
        They sum to one.
    shape : tuple of int
        Nodes along each axis of the grid; their product is N, the last axis runs fastest.
    edges : array, shape (D, D)
        Column k is the step between neighbours along axis k.
    values : array, shape (N, Q), optional
        Functions of the points.
    """

    points: Array
    weights: Array
    shape: tuple[int, ...]
    edges: Array
    values: Array | None = None

    def quantile(self, values: ArrayLike, probability: ArrayLike) -> Array:
        """Quantiles of a quantity given at the nodes.

        The step function in F(v) = E[step(v − V)] is smoothed over about one node's distance in V
        by a sixth-order Gaussian kernel (its moments 1 to 5 vanish), which keeps the trapezoid
        rule's accuracy: about 1e-3 in probability, or better, where the integral has converged.

        Parameters
        ----------
        values : array_like, shape (N,)
        probability : array_like
            Between 0 and 1.

        Returns
        -------
        array of the shape of `probability`

        Examples
        --------
        >>> z = np.linspace(-6, 6, 25)
        >>> weights = np.exp(-z**2 / 2) / np.exp(-z**2 / 2).sum()
        >>> nodes = Nodes(z[:, None], weights, (25,), np.array([[0.5]]))
        >>> nodes.quantile(z, [0.025, 0.975]).round(2).tolist()
        [-1.96, 1.96]
        """
        v = np.asarray(values, dtype=float)
        p = np.asarray(probability, dtype=float)
        used = self.weights > 1e-12 * self.weights.max()
        cells = np.where(used, v, v[self.weights.argmax()]).reshape(self.shape)
        slopes = np.stack([np.gradient(cells, axis=k) for k in range(cells.ndim)])  # per node
        width = KERNEL * np.sqrt(np.square(slopes).sum(axis=0)).ravel()
        v, weights = v[used], self.weights[used] / self.weights[used].sum()
        width = np.maximum(width[used], 1e-12 * (np.ptp(v) or 1.0))
        out = [_crossing(v, width, weights, float(target)) for target in p.ravel()]
        return np.reshape(out, p.shape)


KERNEL = 0.8  # smoothing width of quantiles, in nodes: bias and aliasing about equal


def _crossing(v: Array, width: Array, weights: Array, target: float) -> float:
    """Where the smoothed F reaches a probability.

    By bisection, as the smoothed F need not rise everywhere in the far tails. Nodes that the
    bracket has left behind, by `BEHIND` widths, count in full or not at all.
    """
    low, high, full = float(v.min()), float(v.max()), 0.0
    for step in range(50):
        if step % 5 == 4:
            under = v + BEHIND * width < low
            near = ~under & (v - BEHIND * width < high)
            full += weights[under].sum()
            v, width, weights = v[near], width[near], weights[near]
        middle = (low + high) / 2
        if full + _smooth_step((middle - v) / width) @ weights < target:
            low = middle
        else:
            high = middle
    return (low + high) / 2


BEHIND = 8.0  # the kernel's integral is 1 to 1e-12 there


def _smooth_step(u: Array) -> Array:
    """The integral of the sixth-order Gaussian kernel."""
    density = np.exp(-0.5 * u**2) / np.sqrt(2 * np.pi)
    return np.asarray(special.ndtr(u) + density * (u / 2 - (u**3 - 3 * u) / 8))
