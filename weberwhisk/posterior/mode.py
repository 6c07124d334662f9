"""The highest point of a posterior and its curvature there, many readings at a time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from ..observer import Observer
from ..threads import on_threads
from .densities import refuse_impossible
from .solution import is_improbable

Array = NDArray[np.float64]

#: Coarse grid of starting points, per unknown, as fractions of its range.
#: In three dimensions and more the further unknowns take few values.
_COARSE = {1: expit(np.linspace(-8.0, 8.0, 129)), 2: expit(np.linspace(-7.0, 6.0, 27))}
#: The most, in ln, that a peak has left to gain, and the least curvature, 1/x², that makes it one.
_SETTLED, _CURVED = 1e-6, 1e-2
#: Values of each unknown that has a prior alone on the coarse grid.
OTHERS = 7
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

    def of(self, rows: NDArray[np.intp]) -> Mode:
        """Those of some of the posteriors."""
        return Mode(self.x[rows], self.log_density[rows], self.covariance[rows])

    def put(self, rows: NDArray[np.intp], other: Mode) -> None:
        """Those of another in place of some."""
        self.x[rows], self.log_density[rows] = other.x, other.log_density
        self.covariance[rows] = other.covariance


def find_mode(
    observer: Observer, reading: Array, starts: Array | None = None, *, steps: int = 60
) -> Mode:
    """Newton's method in a trust region, from the best point of a coarse grid.

    Parameters
    ----------
    observer : Observer
    reading : array, shape (B, S)
    starts : array, shape (B, U), optional
        `starting_points`, if they are there already.
    steps : int
        Most iterations; few posteriors need more than ten.
    """
    starts = starting_points(observer, reading) if starts is None else starts
    mode, peaked = _climb(observer, reading, starts, steps)
    # Where noise is far narrower than the coarse grid, a climb may end at the edge of what is
    # held, on a plateau, or in another valley's end, from where readings are improbable.
    odd = ~peaked | is_improbable(observer, reading, observer.contact(mode.x)[0])
    for climb in (_gently, _from_everywhere) if len(observer.unknowns) > 1 else (_gently,):
        rows = np.flatnonzero(odd)
        if not rows.size:
            break
        again = climb(observer, reading[rows], starts[rows], steps)
        better = np.flatnonzero(again.log_density > mode.log_density[rows])
        mode.put(rows[better], again.of(better))
        contact = observer.contact(mode.x[rows])[0]
        odd[rows] = is_improbable(observer, reading[rows], contact)
    return mode


def _gently(observer: Observer, reading: Array, start: Array, steps: int) -> Mode:
    """Peaks come to by readings that count for little at first."""
    for weight in (1e-3, 1e-2, 1e-1, 1.0):
        mode, _ = _climb(observer, reading, start, steps, weight=weight)
        start = mode.x
    return mode


def _from_everywhere(observer: Observer, reading: Array, start: Array, steps: int) -> Mode:
    """The highest peaks above the coarse grid's best points for values of the second unknown.

    Of neighbouring values' points the best: each valley has one.
    """
    grid, density, shape = _coarse(observer)
    line = np.moveaxis(np.arange(len(grid)).reshape(shape), 1, 0).reshape(shape[1], -1)
    table = density(reading)[:, line]
    height = np.pad(table.max(axis=2), ((0, 0), (1, 1)), constant_values=-np.inf)
    high = (height[:, 1:-1] >= height[:, :-2]) & (height[:, 1:-1] >= height[:, 2:])
    row, value = np.nonzero(high & np.isfinite(height[:, 1:-1]))
    point = grid[line[value, table[row, value].argmax(axis=1)]]
    mode, _ = _climb(observer, reading[row], point, steps)
    order = np.lexsort((mode.log_density, row))
    return mode.of(order[np.flatnonzero(np.diff(row[order], append=len(reading)))])


def starting_points(observer: Observer, reading: Array, places: Array | None = None) -> Array:
    """The best points of a coarse grid, or of places (n, 1) of one unknown, for readings (B, R)."""
    grid, density, _ = _coarse(observer, places)
    best = np.zeros(len(reading), dtype=np.intp)

    def part(start: int) -> None:
        rows = slice(start, start + 256)
        table = density(reading[rows])
        best[rows] = table.argmax(axis=1)
        refuse_impossible(reading[rows], table.max(axis=1))

    list(on_threads(part, range(0, len(reading), 256)))
    return grid[best]


def _coarse(
    observer: Observer, places: Array | None = None
) -> tuple[Array, Callable[[Array], Array], tuple[int, ...]]:
    """The coarse grid (n, U), or places; ln of readings' densities (B, n) there; its shape."""
    dim = len(observer.unknowns)
    fractions = _COARSE[min(dim, 2)]
    grid = observer.space.spread(fractions, others=OTHERS) if places is None else places
    shape = (fractions.size,) * observer.bounded + (OTHERS,) * (dim - observer.bounded)
    contact, log_prior = observer.contact(grid)
    signals, outcome = observer.signals(contact)
    held = np.asarray(outcome == 0)
    signals, log_prior = np.where(held[:, None], signals, 1.0), np.where(held, log_prior, -np.inf)

    def density(reading: Array) -> Array:
        table = observer.noise.log_likelihoods(reading, signals)
        table += log_prior
        return table

    return grid, density, shape


def _climb(
    observer: Observer,
    reading: Array,
    start: Array,
    steps: int,
    *,
    radius: float = 0.5,
    weight: float = 1.0,
) -> tuple[Mode, NDArray[np.bool_]]:
    """The peaks above starting points (B, U), with first steps no longer than the radius.

    The likelihood counts to the power of the weight. Said of each (B,) too: whether it is a peak
    that the climb has come to.
    """
    dim = start.shape[1]
    x = start.copy()
    reach = np.full(len(x), radius)
    stencil, weights_gradient, weights_hessian = _stencil(dim)
    top = np.full(len(x), -np.inf)
    centre = x.copy()
    gradient, hessian = np.zeros((len(x), dim)), np.zeros((len(x), dim, dim))
    moving = np.arange(len(x))
    for _ in range(steps):
        points = x[moving, None] + _STEP * stencil
        values = observer.log_density(points, reading[moving, None])
        if weight < 1:
            values = weight * values + (1 - weight) * observer.contact(points)[1]
        now = values[:, 0]
        better = (now >= top[moving]) & np.isfinite(now)
        accepted, rejected = moving[better], moving[~better]
        centre[accepted], top[accepted] = x[accepted], now[better]
        relative = _mirrored(values[better] - now[better, None])
        gradient[accepted] = relative @ weights_gradient.T / _STEP
        hessian[accepted] = np.einsum("dek,bk->bde", weights_hessian, relative) / _STEP**2
        reach[rejected] /= 4
        reach[accepted] *= 1.5
        step = _newton(gradient[moving], hessian[moving], reach[moving])
        x[moving] = centre[moving] + step
        # Converged to a fraction of the posterior's own width, or to rounding.
        gain = np.abs(np.einsum("bd,bd->b", step, gradient[moving]))
        moving = moving[(gain > 1e-9) & (reach[moving] > 1e-9)]
        if not moving.size:
            break
    values, vectors = np.linalg.eigh(hessian)
    scale = 1 / np.maximum(np.abs(values), 1e-6)
    covariance = np.einsum("bde,be,bfe->bdf", vectors, scale, vectors)
    gain = np.einsum("bd,bde,be->b", gradient, covariance, gradient)
    return Mode(centre, top, covariance), (gain < _SETTLED) & (values[:, -1] < -_CURVED)


def _stencil(dim: int) -> tuple[Array, Array, Array]:
    """Offsets around a point (the point itself first) and the weights of gradient and Hessian."""
    unit = np.eye(dim)
    pairs = [(i, j) for i in range(dim) for j in range(i)]
    offsets = [np.zeros(dim), *(sign * unit[i] for i in range(dim) for sign in (1, -1))]
    offsets += [sign * (unit[i] + unit[j]) for i, j in pairs for sign in (1, -1)]
    gradient = np.zeros((dim, len(offsets)))
    hessian = np.zeros((dim, dim, len(offsets)))
    for i in range(dim):
        gradient[i, 1 + 2 * i : 3 + 2 * i] = [0.5, -0.5]
        hessian[i, i, [0, 1 + 2 * i, 2 + 2 * i]] = [-2, 1, 1]
    # What the diagonals bend, less what the axes do.
    for k, (i, j) in enumerate(pairs):
        own = hessian[i, i] + hessian[j, j]
        first = 1 + 2 * dim + 2 * k
        hessian[i, j, [0, first, first + 1]] = [-1, 0.5, 0.5]
        hessian[i, j] -= own / 2
        hessian[j, i] = hessian[i, j]
    return np.array(offsets), gradient, hessian


def _mirrored(relative: Array) -> Array:
    """Values (B, n) on the stencil over that in its midst, with points outside the support filled.

    By what makes a straight line of the point across, or by none where that is outside as well.
    """
    lost = ~np.isfinite(relative)
    if lost.any():
        across = relative.copy()
        across[:, 1::2], across[:, 2::2] = -relative[:, 2::2], -relative[:, 1::2]
        relative = np.where(lost, np.where(np.isfinite(across), across, 0.0), relative)
    return relative


def _newton(gradient: Array, hessian: Array, radius: Array) -> Array:
    """An uphill Newton step no longer than the radius."""
    values, vectors = np.linalg.eigh(hessian)
    curvature = np.maximum(np.abs(values), 1e-6)
    step = np.einsum("bde,be,bfe,bf->bd", vectors, 1 / curvature, vectors, gradient)
    length = np.linalg.norm(step, axis=1)
    return step * np.minimum(1.0, radius / np.maximum(length, 1e-300))[:, None]
