"""Whether a posterior's quantiles can be relied on: integrated again, with more care.

The sums of `quadrature` judge themselves by the evidence, of which half-grids agree to far better
than 1 % long before the tails of k do where these are no bump's: a shelf where lapses explain all,
a kink where answers forbid every smaller k. Such posteriors take more nodes than a bump. They are
summed again on finer grids until the 95 % interval and the median stay where they are.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from .likelihood import WeberModel
from .quadrature import Care, Grid, integrate, log_marginal

Array = NDArray[np.float64]

BUMP = (21, 25, 11)  # most nodes of k, of a lapse and of a bias that a bump takes
FINER = Care(5e-5, 0.02, 0.03), Care(5e-6, 0.005, 0.01), Care(5e-7, 0.001, 0.003)
STEADY = 0.03  # shift of a quantile, in sds of the score of k, that ends it
LEFT = 1 / 3  # of the last shift, what may still be wrong: steps at least halve the error
ENDS = np.array([0.025, 0.5, 0.975])
FINE = 1601


def refined(model: WeberModel) -> Grid:
    """The posterior on a grid fine enough for its quantiles; `error` says if none was."""
    grid = integrate(model)
    if grid.axes[0].size == 1 or len(grid.axes) > 3 or _bump(grid) or not np.isfinite(grid.error):
        return grid
    for care in FINER:
        finer = integrate(model, care)
        if not np.isfinite(finer.error):
            return grid  # finer than this is more than can be summed
        shift = _shift(grid, finer)
        grid = replace(finer, error=max(finer.error, LEFT * shift))
        if shift < STEADY:
            break
    return grid


def density_of(axis: Array, log_density: Array) -> tuple[Array, Array]:
    """Even points of an axis, and the density there."""
    fine = np.linspace(axis[0], axis[-1], FINE)
    return fine, np.exp(CubicSpline(axis, np.maximum(log_density, -80.0))(fine))


def _bump(grid: Grid) -> bool:
    k, low, high = (axis.size for axis in grid.axes)
    most_k, most_lapse, most_bias = BUMP
    return k <= most_k and max(low, high) <= most_lapse and grid.offsets.size <= most_bias


def _shift(one: Grid, other: Grid) -> float:
    """The farthest that a quantile of k moved, in sds."""
    (old, _), (new, sd) = _quantiles(one), _quantiles(other)
    return float(np.max(np.abs(new - old)) / sd)


def _quantiles(grid: Grid) -> tuple[Array, float]:
    fine, density = density_of(grid.axes[0], log_marginal(grid, 0))
    rise = np.cumsum(density)
    middle = float(fine @ density / rise[-1])
    sd = float(np.sqrt((fine - middle) ** 2 @ density / rise[-1]))
    return np.interp(ENDS, rise / rise[-1], fine), sd
