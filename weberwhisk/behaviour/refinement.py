"""Whether a posterior's quantiles can be relied on: integrated again, with more care.

The sums of `quadrature` judge themselves by the evidence, of which half-grids agree to far better
than 1 % long before the tails of k do where these are no bump's: a shelf where lapses explain all,
a kink where answers forbid every smaller k. Such posteriors take more nodes of lapses and biases
than a bump, or half the nodes of k tell another interval. They are summed again on finer grids
until the 95 % interval and the median stay where they are.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from .likelihood import WeberModel
from .quadrature import Care, Grid, integrate, log_marginal

Array = NDArray[np.float64]

LAPSE_NODES = 40  # most that a bump takes of a lapse
BIAS_NODES, K_NODES = 15, 20  # and of a bias, but where k has more than this many
HALVED = 0.08  # shift of a quantile, in sds of the score of k, by which half its nodes may be off
FINER = Care(5e-5, 0.005, 0.03), Care(5e-6, 0.001, 0.01), Care(5e-7, 0.0003, 0.003)
STEADY = 0.03  # shift of a quantile, in sds of the score of k, that ends it
LEFT = 1 / 3  # of the last shift, what may still be wrong: steps at least halve the error
ENDS = np.array([0.025, 0.5, 0.975])
FINE = 1601


class _Quantiles(NamedTuple):
    """Of the score of k: the ends and the middle of its interval, and its sd."""

    ends: Array
    sd: float


def refined(model: WeberModel) -> Grid:
    """The posterior on a grid fine enough for its quantiles; `error` says if none was."""
    grid = integrate(model)
    if grid.axes[0].size == 1 or len(grid.axes) > 3 or _bump(grid) or not np.isfinite(grid.error):
        return grid
    for care in FINER:
        finer = integrate(model, care)
        if not np.isfinite(finer.error):
            return grid  # finer than this is more than can be summed
        shift = _shift(*(_quantiles(g.axes[0], log_marginal(g, 0)) for g in (grid, finer)))
        grid = replace(finer, error=max(finer.error, LEFT * shift))
        if shift < STEADY:
            break
    return grid


def density_of(axis: Array, log_density: Array) -> tuple[Array, Array]:
    """Even points of an axis, and the density there."""
    fine = np.linspace(axis[0], axis[-1], FINE)
    return fine, np.exp(CubicSpline(axis, np.maximum(log_density, -80.0))(fine))


def _bump(grid: Grid) -> bool:
    k, low, high = grid.axes
    many_biases = grid.offsets.size > BIAS_NODES and k.size <= K_NODES
    if many_biases or max(low.size, high.size) > LAPSE_NODES:
        return False
    log_density = log_marginal(grid, 0)
    whole = _quantiles(k, log_density)
    halves = (_quantiles(k[i::2], log_density[i::2]) for i in (0, 1))
    return all(_shift(half, whole) < HALVED for half in halves)


def _shift(old: _Quantiles, new: _Quantiles) -> float:
    """The farthest that a quantile moved, in sds."""
    return float(np.max(np.abs(new.ends - old.ends)) / new.sd)


def _quantiles(axis: Array, log_density: Array) -> _Quantiles:
    fine, density = density_of(axis, log_density)
    rise = np.cumsum(density)
    middle = float(fine @ density / rise[-1])
    sd = float(np.sqrt((fine - middle) ** 2 @ density / rise[-1]))
    return _Quantiles(np.interp(ENDS, rise / rise[-1], fine), sd)
