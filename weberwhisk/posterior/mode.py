"""The highest point of a posterior and its curvature there, many readings at a time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import reduce
from itertools import product
from typing import NamedTuple

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
#: Most that a second peak of the coarse grid may be below the first, in ln of the density, to be
#: climbed, and the least mass over the first's, in ln, that counts.
SECOND, LEAST_SHARE = 30.0, float(np.log(1e-3))
#: How far, in ln, a place must be above the first peak's Gaussian to be climbed from.
UNEXPLAINED = 5.0
#: How far, in x, a climb may go before its start is tried again: the coarse grid's own spacing.
LEFT = 0.4
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


class Starts(NamedTuple):
    """Where climbs start: the best point of a coarse grid, and the best of its other peaks.

    Coordinates (B, U) each, and ln of the density at the second (B,), −∞ where there is none and
    where it is too far below the first to count.
    """

    best: Array
    second: Array
    height: Array


def find_mode(
    observer: Observer, reading: Array, starts: Starts | None = None, *, steps: int = 60
) -> Mode:
    """Newton's method in a trust region, from the best point of a coarse grid.

    Parameters
    ----------
    observer : Observer
    reading : array, shape (B, S)
    starts : Starts, optional
        `starting_points`, if they are there already.
    steps : int
        Most iterations; few posteriors need more than ten.
    """
    starts = starting_points(observer, reading) if starts is None else starts
    mode, peaked = _climb(observer, reading, starts.best, steps)
    # Where noise is far narrower than the coarse grid, a climb may end at the edge of what is
    # held, on a plateau, or in another valley's end, from where readings are improbable.
    odd = ~peaked | is_improbable(observer, reading, observer.contact(mode.x)[0])
    for climb in (_gently, _from_everywhere) if len(observer.unknowns) > 1 else (_gently,):
        rows = np.flatnonzero(odd)
        if not rows.size:
            break
        again = climb(observer, reading[rows], starts.best[rows], steps)
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


def find_other(
    observer: Observer, reading: Array, mode: Mode, starts: Starts
) -> tuple[NDArray[np.intp], Mode]:
    """Posteriors (n,) with a second peak that may count, and these peaks.

    A climb from the highest of the coarse grid's points that is higher than its neighbours and
    none of the best one's; or from the best point itself, in small steps, where the first climb
    has left it behind. It may end at the peak that is known already, which does not count.
    """
    left = np.abs(mode.x - starts.best).max(axis=1) > LEFT
    # What the known peak's own Gaussian says of a place is no other peak.
    square = _square(starts.second - mode.x, mode.covariance)
    unexplained = starts.height > mode.log_density - square / 2 + UNEXPLAINED
    rows = np.flatnonzero(unexplained | left)
    if not rows.size:
        return rows, mode.of(rows)
    start = np.where(left[:, None], starts.best, starts.second)[rows]
    known = mode.of(rows)
    other, _ = _climb(observer, reading[rows], start, 60, radius=0.1, known=known)
    nearness = [_square(other.x - known.x, m.covariance) for m in (other, known)]
    volume = [0.5 * np.linalg.slogdet(m.covariance)[1] for m in (other, known)]
    mass = other.log_density - known.log_density + volume[0] - volume[1]
    counts = (np.min(nearness, axis=0) > 4.0) & (mass > LEAST_SHARE)
    return rows[counts], other.of(np.flatnonzero(counts))


def starting_points(observer: Observer, reading: Array, places: Array | None = None) -> Starts:
    """The best points of a coarse grid, or of places (n, 1) of one unknown, for readings (B, R)."""
    grid, density, shape = _coarse(observer, places)
    best, second = np.zeros((2, len(reading)), dtype=np.intp)
    height = np.full(len(reading), -np.inf)

    def part(start: int) -> None:
        rows = slice(start, start + 256)
        table = density(reading[rows])
        best[rows] = table.argmax(axis=1)
        refuse_impossible(reading[rows], table.max(axis=1))
        if len(observer.unknowns) > 1:
            second[rows], height[rows] = _second(table, best[rows], shape)

    list(on_threads(part, range(0, len(reading), 256)))
    return Starts(grid[best], grid[second], height)


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


def _second(
    table: Array, best: NDArray[np.intp], shape: tuple[int, ...]
) -> tuple[NDArray[np.intp], Array]:
    """The highest point (n,) that no neighbour beats, away from the best, and its height (n,).

    Neighbours are along the first two axes; of further axes the highest value stands for all.
    """
    rows = np.arange(len(table))
    full = table.reshape(len(table), *shape[:2], -1)
    # Far quicker than a maximum along a last axis that is short.
    flat = reduce(np.maximum, np.moveaxis(full, -1, 0))
    padded = np.pad(flat, ((0, 0), (1, 1), (1, 1)), constant_values=-np.inf)
    n, m = flat.shape[1:]
    peak = np.isfinite(flat)
    for i, j in product(range(3), repeat=2):
        peak &= flat >= padded[:, i : i + n, j : j + m]
    first, along = np.divmod(best // full.shape[-1], m)
    away = np.abs(np.arange(n) - first[:, None])[:, :, None] > 1
    away = away | (np.abs(np.arange(m) - along[:, None])[:, None, :] > 1)
    flat = np.where(peak & away, flat, -np.inf).reshape(len(table), -1)
    place = flat.argmax(axis=1)
    last = full.reshape(len(table), n * m, -1)[rows, place].argmax(axis=1)
    height = flat[rows, place]
    height = np.where(height > table[rows, best] - SECOND, height, -np.inf)
    return place * full.shape[-1] + last, height


def _square(off: Array, covariance: Array) -> Array:
    """Squares (B,) of distances (B, U) in sds."""
    return np.asarray(np.einsum("bd,bde,be->b", off, np.linalg.inv(covariance), off))


def _climb(
    observer: Observer,
    reading: Array,
    start: Array,
    steps: int,
    *,
    radius: float = 0.5,
    known: Mode | None = None,
    weight: float = 1.0,
) -> tuple[Mode, NDArray[np.bool_]]:
    """The peaks above starting points (B, U), with first steps no longer than the radius.

    What has come within an sd of a known peak is left there. The likelihood counts to the power of
    the weight. Said of each (B,) too: whether it is a peak that the climb has come to.
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
        if known is not None:
            there = known.of(moving)
            moving = moving[_square(centre[moving] - there.x, there.covariance) > 1]
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
