"""Gaps in the marginals of a lattice: a ridge that is thinner than the lattice hits or misses it.

A lattice is as fine as its posterior asks at the peak. Where the ridge grows thinner as it bends,
most lines of nodes across it meet none of it and some by chance all: the sum over nodes loses its
meaning there, and a flood of tiles may end in one of the gaps. What is left out is nowhere seen,
but the gaps are. Rain that fell on the marginal would stay in them: the water tells how much.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def water_in(row: NDArray[np.intp], place: NDArray[np.int64], mass: Array, count: int) -> Array:
    """Water that would stay in the gaps of marginals, (count,).

    Over the whole mass, and as variances go: what is far from the middle counts by its distance
    squared.

    Parameters
    ----------
    row, place : array, shape (n,)
        Of stretches of nodes: whose they are, in order, and where along the axis, in order too,
        without repetition.
    mass : array, shape (n, nodes)
    count : int
        How many marginals there are; each has some mass.

    Returns
    -------
    array, shape (count,)

    Examples
    --------
    >>> hill, pit = [1.0, 2.0, 4.0, 2.0], [2.0, 4.0, 1.0, 3.0]
    >>> row, place = np.array([0, 1]), np.array([0, 0])
    >>> water_in(row, place, np.array([hill, pit]), 2).tolist()
    [0.0, 0.2]
    """
    starts = np.searchsorted(row, np.arange(count))

    def total(value: Array) -> Array:
        return np.asarray(np.add.reduceat(value.sum(axis=1), starts))

    share = mass / total(mass)[row, None]
    at = place[:, None] * mass.shape[1] + np.arange(mass.shape[1], dtype=float)
    off = np.square(at - total(share * at)[row, None])
    pull = np.maximum(off / np.maximum(total(share * off), 0.1)[row, None], 1.0)
    # The highest so far, from either end: what comes later stands above all that came before.
    level = 2.0 * row[:, None]
    flat = (share + level).ravel()
    rising = np.maximum.accumulate(flat).reshape(share.shape) - level
    flat = (share - level).ravel()[::-1]
    falling = np.maximum.accumulate(flat)[::-1].reshape(share.shape) + level
    return total(np.maximum(np.minimum(rising, falling) - share, 0.0) * pull)
