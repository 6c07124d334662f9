"""Gaps in the marginals of a lattice: a ridge that is thinner than the lattice hits or misses it.

A lattice is as fine as its posterior asks at the peak. Where the ridge grows thinner as it bends,
most lines of nodes across it meet none of it and some by chance all: the sum over nodes loses its
meaning there, and a flood of tiles may end in one of the gaps. What is left out is nowhere seen,
but the gaps are. Rain that fell on the marginal would stay in them: the water tells how much.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from .lattice import LatticeMoments

Array = NDArray[np.float64]
#: Water in the gaps of a marginal, over the tolerance, from which a finer lattice is asked; the
#: change of the moments, over the tolerance, and of the water, over itself, up to which that finds
#: the same; and the tiles that it may take.
GAPS, SAME, ALIKE, MORE_TILES = 5.0, 0.2, 0.2, 1024


class Look(NamedTuple):
    """What one lattice found of b posteriors, the water in its gaps (b, 2), whether for that it is
    doubted (b,)."""

    found: LatticeMoments
    water: Array
    doubted: NDArray[np.bool_]

    def agrees(
        self, found: LatticeMoments, water: Array, which: slice, tolerance: float
    ) -> NDArray[np.bool_]:
        """Whether what was doubted is found once more, with the same water in the same gaps."""
        sd = np.where(found.sd > 0, found.sd, np.inf)
        off = np.abs(np.stack([found.mean - self.found.mean, found.sd - self.found.sd])) / sd
        near = off.max(axis=0)[:, which].max(axis=1) < SAME * tolerance
        alike = np.abs(water - self.water) < ALIKE * np.maximum(water, GAPS * tolerance)
        return np.asarray(self.doubted & near & alike.all(axis=1))


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
    >>> water_in(row, place, np.array([hill, pit]), 2).round(12).tolist()
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
