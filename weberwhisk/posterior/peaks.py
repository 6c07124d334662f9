"""The highest point of a posterior, Laplace's Gaussian about it, and how many peaks there are."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import expit, ndtri

from .._checks import finite
from ..observer import Observer
from ..receptors import Seed
from ..threads import on_threads
from .panels import panels_of
from .result import (
    Array,
    Estimate,
    Solution,
    Status,
    contact_slope,
    is_improbable,
    is_unidentified,
    refuse_impossible,
)


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

    def root(self, *, widen: float = 1.0, widest: float = 2.0) -> Array:
        """A square root of each covariance, (B, U, U), no wider than `widest`.

        On a ridge the curvature knows no bound; the prior's width in x is a few units.
        """
        root = widen * np.linalg.cholesky(self.covariance)
        length = np.linalg.norm(root, axis=(1, 2))
        return np.asarray(root * np.minimum(1.0, widest / length)[:, None, None])


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
    return _climb(observer, reading, starts, steps)


def starting_points(observer: Observer, reading: Array, places: Array | None = None) -> Array:
    """The best points of a coarse grid, or of places (n, 1) of one unknown, for readings (B, R)."""
    grid, density = _coarse(observer, places)
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
) -> tuple[Array, Callable[[Array], Array]]:
    """The coarse grid (n, U), or places; ln of readings' densities (B, n) there."""
    ends = (-8.0, 8.0, 129) if len(observer.unknowns) == 1 else (-7.0, 6.0, 27)
    grid = observer.space.spread(expit(np.linspace(*ends))) if places is None else places
    contact, log_prior = observer.contact(grid)
    signals, outcome = observer.signals(contact)
    held = np.asarray(outcome == 0)
    signals, log_prior = np.where(held[:, None], signals, 1.0), np.where(held, log_prior, -np.inf)

    def density(reading: Array) -> Array:
        table = observer.noise.log_likelihoods(reading, signals)
        table += log_prior
        return table

    return grid, density


def _climb(
    observer: Observer,
    reading: Array,
    start: Array,
    steps: int,
    *,
    radius: float = 0.5,
    h: float = 1e-4,
) -> Mode:
    """The peaks above starting points (B, U), with first steps no longer than the radius.

    Finite differences are over h: posteriors are 0.005 wide in x, and wider.
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
        points = x[moving, None] + h * stencil
        values = observer.log_density(points, reading[moving, None])
        now = values[:, 0]
        better = (now >= top[moving]) & np.isfinite(now)
        accepted, rejected = moving[better], moving[~better]
        centre[accepted], top[accepted] = x[accepted], now[better]
        relative = _mirrored(values[better] - now[better, None])
        gradient[accepted] = relative @ weights_gradient.T / h
        hessian[accepted] = np.einsum("dek,bk->bde", weights_hessian, relative) / h**2
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
    return Mode(centre, top, np.einsum("bde,be,bfe->bdf", vectors, scale, vectors))


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


def laplace(
    observer: Observer, reading: Array, seed: Seed, tolerance: float | None, progress: Any
) -> Solution:
    mode = find_highest(observer, reading)
    contact, _ = observer.contact(mode.x)
    to_contact = contact_slope(observer, mode.x)
    covariance = to_contact @ mode.covariance @ np.swapaxes(to_contact, 1, 2)
    sd = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    mean_error, sd_error, summed = _beside_the_density(observer, reading, mode, sd)
    worst = (np.maximum(mean_error, sd_error) / np.minimum(sd, summed)).max(axis=1)
    improbable = is_improbable(observer, reading, contact)
    status = np.where(improbable, Status.IMPROBABLE_READING, Status.CONVERGED)
    status = np.where(~(worst <= (tolerance or 0.25)), Status.NOT_GAUSSIAN, status)
    status = np.where(is_divided(observer, reading), Status.SEVERAL_PEAKS, status)
    status = np.where(is_unidentified(observer, contact), Status.UNIDENTIFIED, status)
    estimates = [
        Estimate(contact[:, i], sd[:, i], mean_error[:, i], sd_error[:, i])
        for i in range(contact.shape[1])
    ]
    log_evidence = mode.log_density + 0.5 * (
        np.linalg.slogdet(mode.covariance)[1] + contact.shape[1] * np.log(2 * np.pi)
    )
    root = np.linalg.cholesky(mode.covariance)

    def quantile_of(p: Array, unknown: int) -> Array:
        spread = np.sqrt(np.diagonal(mode.covariance, axis1=1, axis2=2))
        out = []
        for value in ndtri(p):  # quantiles are carried along each coordinate
            out.append(observer.contact(mode.x + value * spread)[0][:, unknown])
        return np.stack(out, axis=-1)

    def draws_of(count: int, seed: Seed) -> Array:
        z = np.random.default_rng(seed).standard_normal((len(reading), 4 * count, root.shape[1]))
        x = mode.x[:, None] + z @ np.swapaxes(root, 1, 2)
        return observer.contact(x)[0].reshape(len(reading), 4, count, -1)

    return Solution(estimates, status.astype(np.int8), log_evidence, quantile_of, draws_of)


def _beside_the_density(
    observer: Observer, reading: Array, mode: Mode, sd: Array, *, together: int = 500_000
) -> tuple[Array, Array, Array]:
    """How far mean and sd of the contact are from the Gaussian's, and what the sd is, (B, U) each.

    The density itself is summed over a coarse grid along the axes of the Gaussian. Along each axis
    alone it would miss what bends across them. A Gaussian leaves next to nothing at the grid's
    edge; of what there is as much again is taken to lie beyond, at the least as far off.
    """
    at_mode = observer.contact(mode.x)[0]
    dim = mode.x.shape[1]
    reach = 6.0 if dim == 1 else 4.5
    t = np.linspace(-reach, reach, {1: 25, 2: 13, 3: 9}.get(dim, 7))
    z = np.stack([a.ravel() for a in np.meshgrid(*[t] * dim, indexing="ij")], axis=-1)
    edge = (np.abs(z) == reach).any(axis=1)
    values, vectors = np.linalg.eigh(mode.covariance)
    root = vectors * np.sqrt(values)[:, None]
    mean, variance = np.empty((2, *at_mode.shape))
    beyond = np.empty((len(reading), 1))
    rows = max(1, together // len(z))
    for start in range(0, len(reading), rows):
        some = slice(start, start + rows)
        x = mode.x[some, None] + z @ np.swapaxes(root[some], 1, 2)
        log, contact = observer.log_density_and_contact(x, reading[some, None])
        weight = np.exp(log - log.max(axis=1, keepdims=True))
        weight /= weight.sum(axis=1, keepdims=True)
        # Where the density is zero there may be no contact.
        contact = np.where(weight[..., None] > 0, contact, 0.0)
        mean[some] = np.einsum("bt,btu->bu", weight, contact)
        off = contact - mean[some, None]
        variance[some] = np.einsum("bt,btu->bu", weight, off * off)
        beyond[some, 0] = weight[:, edge].sum(axis=1)
    summed = np.sqrt(variance)
    return (
        np.abs(mean - at_mode) + reach * beyond * summed,
        np.abs(summed - sd) + reach**2 / 2 * beyond * summed,
        summed,
    )


def count_peaks(observer: Observer, reading: ArrayLike, mass: float = 0.95) -> Any:
    """In how many separate stretches of distance the most probable share of a posterior lies.

    The highest-density region of that mass is one interval where the reading leaves one place,
    several where it leaves several. A second peak of less mass than is left out does not count.

    Parameters
    ----------
    observer : Observer
        Of one unknown.
    reading : array, shape (R,) or (B, R)
    mass : float
        Between 0 and 1.

    Returns
    -------
    int or array of int, shape (B,)

    Raises
    ------
    ValueError
        For an observer of several unknowns, a mass outside 0 to 1, a reading of the wrong shape.

    Examples
    --------
    >>> from weberwhisk import Whisker
    >>> from weberwhisk.cues import Vibration
    >>> observer = Observer(Whisker(50e-3, 100e-6, 5e-6), Vibration(2))
    >>> count_peaks(observer, observer.signals([[15e-3], [35e-3]])[0]).tolist()
    [2, 2]
    """
    share = float(finite("mass", mass, "write 0.95, say"))
    if not 0 < share < 1:
        raise ValueError(f"mass must lie between 0 and 1, got {share:g}; write 0.95, say.")
    y = observer.checked_reading(reading)
    panels = panels_of(observer)
    r, log_weight = panels.r.reshape(-1), panels.log_weight.reshape(-1)
    signals = np.nan_to_num(observer.signals(r[:, None])[0], nan=1.0)  # of no weight where not held
    prior = observer.prior.get("radial_distance")
    log_prior = 0.0 if prior is None else prior.logpdf(r)
    counts = []
    for row in y.reshape(-1, y.shape[-1]):
        log = observer.noise.log_likelihood(row, signals)
        weight = np.exp(log + log_weight - (log + log_weight).max())
        counts.append(_count(log + log_prior, weight / weight.sum(), share))
    return np.array(counts) if y.ndim > 1 else counts[0]


def find_highest(observer: Observer, reading: Array) -> Mode:
    """`find_mode`; with one unknown from the best of the panels, between which no peak is lost.

    A signature (§2d) may have more peaks, and narrower ones, than any fixed grid has places.
    """
    if len(observer.unknowns) > 1:
        return find_mode(observer, reading)
    return find_mode(
        observer, reading, starting_points(observer, reading, panels_of(observer).middles)
    )


def is_divided(observer: Observer, reading: Array) -> NDArray[np.bool_]:
    """Posteriors (B,) of one unknown whose mass lies apart: methods that climb miss some of it.

    A billionth of the mass, as far off as the base is from the tip, still widens a narrow peak.
    """
    if len(observer.unknowns) > 1:
        return np.zeros(len(reading), dtype=bool)
    return np.asarray(count_peaks(observer, reading, 1 - 1e-9) > 1)


def _count(density: Array, weight: Array, mass: float) -> int:
    """Stretches of neighbouring nodes with the highest density that hold the mass."""
    order = np.argsort(density)[::-1]
    last = int(np.searchsorted(np.cumsum(weight[order]), mass))
    # Where a density is flat, rounding makes no valleys.
    inside = (density >= density[order[min(last, len(order) - 1)]] - 1e-6) & (weight > 0)
    return int(inside[0]) + int(np.sum(inside[1:] & ~inside[:-1]))
