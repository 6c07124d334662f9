"""Posteriors from their highest points: Laplace's Gaussian, and emcee, which takes no sums.

emcee owes nothing to quadrature, so that it can check it: its walkers start from the Fisher
information about the best places of a scatter of the prior.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import expit, ndtri

from .._util.checks import between
from .._util.refusals import Refusal
from .._util.sampling import StackedSample, sample_stacked
from .._util.values import Array, Codes, Flags, Index
from ..mechanics.contact import Outcome
from ..receptors import Seed
from .coordinates import FARTHEST, constrain_distance
from .descent import cell_sums
from .observer import Observer
from .result import (
    Estimate,
    Status,
    contact_slope,
    is_improbable,
    is_unidentified,
    refuse_impossible,
)
from .tree import TOLERANCE, tree_of
from .weighted import CellSums, interpolate

__all__ = [
    "count_peaks", "density_at", "find_mode", "fisher_scoring", "is_divided", "laplace", "sample",
]  # fmt: skip

#: Monte Carlo error of the sd, over the sd, that emcee goes on for, and the steps after which a
#: posterior that has not converged is called so: one unknown, and more.
PRECISION, MOST_STEPS = (0.02, 0.03), (20_000, 6_000)
#: Posteriors in one run: more are no quicker, and 6000 steps of three unknowns take 0.3 GB.
STACKED = 64


def find_mode(
    observer: Observer, reading: Array, starts: Array | None = None
) -> tuple[Array, Array]:
    """The highest points x (B, U) of posteriors of readings (B, S), and ln of the density there.

    From starts (B, U), by default the best point of a coarse grid; of distance alone, and with the
    angle, the best cell of their tree, between which no peak is lost: a signature (§2d) may have
    more peaks, and narrower ones, than any fixed grid has places.
    """
    if starts is None:
        starts = _starting_points(observer, reading)
    return fisher_scoring(observer, reading, starts, 1e-9, 60)[:2]


def _starting_points(observer: Observer, reading: Array) -> Array:
    """Where `find_mode` starts, (B, U)."""
    if exact := _exact(observer, reading):
        return observer.space.unconstrain(exact.best)
    places = observer.space.spread(expit(np.linspace(-7.0, 6.0, 27)))
    density = density_at(observer, places)
    best = np.zeros(len(reading), dtype=np.intp)
    for start in range(0, len(reading), 256):
        chunk = slice(start, start + 256)
        table = density(reading[chunk])
        best[chunk] = table.argmax(axis=1)
        refuse_impossible(reading[chunk], table.max(axis=1))
    return places[best]


def _exact(observer: Observer, reading: Array) -> CellSums | None:
    """Posteriors by the tree where it has all unknowns: distance, or distance and angle."""
    if len(observer.unknowns) > observer.bounded:
        return None
    sums = cell_sums(tree_of(observer, TOLERANCE), reading)
    refuse_impossible(reading, np.nan_to_num(sums.log_evidence, nan=-np.inf))
    return sums


def density_at(observer: Observer, places: Array) -> Callable[[Array], Array]:
    """ln of the densities (B, n) that readings (B, R) have at places (n, U)."""
    contact, log_prior = observer.space.constrain(places)
    signals, outcome = observer.signals(contact)
    in_contact = np.asarray(outcome == Outcome.HELD)
    signals = np.where(in_contact[:, None], signals, 1.0)
    log_prior = np.where(in_contact, log_prior, -np.inf)
    return lambda reading: observer.log_reading(reading[:, None], signals) + log_prior


def fisher_scoring(
    observer: Any, reading: Array, start: Array, enough: float, steps: int
) -> tuple[Array, Array, Array]:
    """Fisher scoring from places (n, U) of readings (n, R), down to a squared decrement.

    Returns the places, ln of the density there (n,), and the inverse of the information (n, U, U),
    that of the prior in x included.
    """
    dim = start.shape[1]
    x, top = start.copy(), np.full(len(start), -np.inf)
    covariance = np.broadcast_to(np.eye(dim), (len(start), dim, dim)).copy()
    prior = prior_precision(observer)
    radius, moving, trial = np.full(len(start), 0.5), np.arange(len(start)), start.copy()
    for _ in range(steps):
        value, gradient, information = score(observer, reading[moving], trial[moving])
        better = value >= top[moving]
        improved = moving[better]
        x[improved], top[improved] = trial[improved], value[better]
        inverse = np.linalg.inv(information[better] + prior)
        covariance[improved] = inverse
        step = np.einsum("nij,nj->ni", inverse, gradient[better])
        decrement = np.einsum("ni,ni->n", step, gradient[better])
        radius[improved] *= 1.5
        radius[moving[~better]] /= 4
        length = np.linalg.norm(step, axis=1)
        shorter = np.minimum(1.0, radius[improved] / np.maximum(length, 1e-12))
        trial[improved] = x[improved] + step * shorter[:, None]
        back = moving[~better]
        trial[back] = x[back] + (trial[back] - x[back]) / 4
        moving = np.sort(np.concatenate([improved[decrement > enough], back[radius[back] > 1e-6]]))
        if not moving.size:
            break
    return x, top, covariance


def score(observer: Any, reading: Array, x: Array) -> tuple[Array, Array, Array]:
    """ln of the density at x (n, U), its gradient, and the information of one reading in x."""
    dim = x.shape[1]
    h = 1e-4
    stencil = np.concatenate([np.zeros((1, dim)), h * np.eye(dim), -h * np.eye(dim)])
    contact, log_prior = observer.space.constrain(x[:, None] + stencil)
    signals, outcome = observer.signals(contact)
    in_contact = (outcome == Outcome.HELD) & np.isfinite(log_prior)
    in_contact &= np.abs(x[:, None, 0] + stencil[:, 0]) < FARTHEST
    signals = np.where(in_contact[..., None], signals, 1.0)
    value = observer.log_reading(reading[:, None], signals) + log_prior
    value = np.where(in_contact & np.isfinite(value), value, -np.inf)
    inside = np.asarray(np.isfinite(value).all(axis=1))
    steps = np.where(inside[:, None], value, 0.0)
    gradient = (steps[:, 1 : 1 + dim] - steps[:, 1 + dim :]) / (2 * h)
    slope = np.swapaxes(signals[:, 1 : 1 + dim] - signals[:, 1 + dim :], 1, 2) / (2 * h)
    information = np.swapaxes(slope, 1, 2) @ observer.noise.fisher(signals[:, 0]) @ slope
    normal = observer.space.prior_scores(contact)  # each of sd 1
    if normal.shape[-1]:
        rise = np.swapaxes(normal[:, 1 : 1 + dim] - normal[:, 1 + dim :], 1, 2) / (2 * h)
        information += np.swapaxes(rise, 1, 2) @ rise
    is_finite = np.isfinite(information).all(axis=(1, 2), keepdims=True) & inside[:, None, None]
    return value[:, 0], gradient, np.where(is_finite, information, 0.0)


def prior_precision(observer: Observer) -> Array:
    """Curvature of ln prior in x, about: ¼ and more of what is flat, 1 of the standard normal."""
    return np.diag(np.where(np.arange(len(observer.unknowns)) < observer.bounded, 0.25, 1.0))


def _hessian(observer: Observer, reading: Array, x: Array) -> Array:
    """Second derivatives (B, U, U) of ln of the density at x (B, U), by differences.

    Posteriors are 0.005 wide in x, and wider. The prior's where a point is outside the support.
    """
    dim, prior, h = x.shape[1], prior_precision(observer), 1e-4
    out = np.zeros((len(x), dim, dim))
    for i in range(dim):
        for j in range(i + 1):
            a, b = h * np.eye(dim)[[i, j]] / 2
            points = x[:, None] + [a + b, a - b, b - a, -a - b]
            value = observer.log_density(points, reading[:, None])
            with np.errstate(invalid="ignore"):
                bend = (value @ [1.0, -1.0, -1.0, 1.0]) / h**2
            out[:, i, j] = out[:, j, i] = np.where(np.isfinite(bend), bend, -prior[i, j])
    return out


def laplace(
    observer: Observer, reading: Array, seed: Seed, tolerance: float | None, progress: Any
) -> LaplaceSolution:
    """Posteriors of readings (B, R) as Gaussians about their modes."""
    exact = _exact(observer, reading)
    starts = observer.space.unconstrain(exact.best) if exact else None
    x, top = find_mode(observer, reading, starts)
    values, vectors = np.linalg.eigh(_hessian(observer, reading, x))
    # Where minus the Hessian is not positive, of its absolute value.
    root = vectors / np.sqrt(np.maximum(np.abs(values), 1e-6))[:, None]
    contact, _ = observer.space.constrain(x)
    to_contact = contact_slope(observer.space, x) @ root
    covariance = to_contact @ np.swapaxes(to_contact, 1, 2)
    sd = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    if exact:  # in fusions with a signature there was a second peak, 18 sd off
        mean_error, sd_error, summed = np.abs(exact.mean - contact), np.abs(exact.sd - sd), exact.sd
    else:
        mean_error, sd_error, summed = _beside_the_density(observer, reading, x, root, sd)
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
    log_evidence = top + np.linalg.slogdet(root)[1] + 0.5 * x.shape[1] * np.log(2 * np.pi)

    return LaplaceSolution(observer, x, root, estimates, status.astype(np.int8), log_evidence)


@dataclass(frozen=True, eq=False)
class LaplaceSolution:
    """Gaussians in the coordinates: modes (B, U), and roots (B, U, U) of their covariances."""

    observer: Observer
    mode: Array
    root: Array
    estimates: list[Estimate]
    status: Codes
    log_evidence: Array

    def quantiles(self, p: Array, unknown: int) -> Array:
        """Quantiles (B, Q), carried along each coordinate."""
        sd, space = np.linalg.norm(self.root, axis=2), self.observer.space
        ends = [space.constrain(self.mode + z * sd)[0][:, unknown] for z in ndtri(p)]
        return np.stack(ends, axis=-1)

    def quantile_errors(self, p: Array, unknown: int) -> Array:
        return np.full((len(self.mode), len(p)), np.nan)

    def draws(self, count: int, seed: Seed) -> Array:
        size = len(self.mode), 4 * count, self.mode.shape[1]
        z = np.random.default_rng(seed).standard_normal(size)
        x = self.mode[:, None] + z @ np.swapaxes(self.root, 1, 2)
        return self.observer.space.constrain(x)[0].reshape(len(self.mode), 4, count, -1)


def _beside_the_density(
    observer: Observer, reading: Array, mode: Array, root: Array, sd: Array
) -> tuple[Array, Array, Array]:
    """How far mean and sd of the contact are from the Gaussian's, and what the sd is, (B, U) each.

    The density itself is summed over a coarse grid along the axes of the Gaussian. Along each axis
    alone it would miss what bends across them. A Gaussian leaves next to nothing at the grid's
    edge; of what there is as much again is taken to lie beyond, at the least as far off.
    """
    at_mode = observer.space.constrain(mode)[0]
    dim = mode.shape[1]
    reach = 4.5
    t = np.linspace(-reach, reach, {2: 13, 3: 9}.get(dim, 7))
    z = np.stack([a.ravel() for a in np.meshgrid(*[t] * dim, indexing="ij")], axis=-1)
    edge = (np.abs(z) == reach).any(axis=1)
    mean, variance = np.empty((2, *at_mode.shape))
    beyond = np.empty((len(reading), 1))
    size = max(1, 500_000 // len(z))
    for start in range(0, len(reading), size):
        chunk = slice(start, start + size)
        x = mode[chunk, None] + z @ np.swapaxes(root[chunk], 1, 2)
        log, contact = observer.log_density_and_contact(x, reading[chunk, None])
        weight = np.exp(log - log.max(axis=1, keepdims=True))
        weight /= weight.sum(axis=1, keepdims=True)
        # Where the density is zero there may be no contact.
        contact = np.where(weight[..., None] > 0, contact, 0.0)
        mean[chunk] = np.einsum("bt,btu->bu", weight, contact)
        off = contact - mean[chunk, None]
        variance[chunk] = np.einsum("bt,btu->bu", weight, off * off)
        beyond[chunk, 0] = weight[:, edge].sum(axis=1)
    summed = np.sqrt(variance)
    return (
        np.abs(mean - at_mode) + reach * beyond * summed,
        np.abs(summed - sd) + reach**2 / 2 * beyond * summed,
        summed,
    )


def count_peaks(observer: Observer, reading: ArrayLike, mass: float = 0.95) -> Any:
    """In how many separate stretches of distance a share `mass` of a posterior lies, () or (B,).

    Its highest-density region is one interval where a reading (R,) or (B, R) leaves one place,
    several where it leaves several, of an observer of one unknown. A second peak of less mass than
    is left out does not count.

    Examples
    --------
    >>> from weberwhisk import Whisker
    >>> from weberwhisk.cues import Vibration
    >>> observer = Observer(Whisker(50e-3, 100e-6, 5e-6), Vibration(2))
    >>> count_peaks(observer, observer.signals([[15e-3], [35e-3]])[0]).tolist()
    [2, 2]
    """
    share = between("mass", mass, "write 0.95, say")
    if len(observer.unknowns) != 1:
        raise Refusal(
            "Peaks are counted for one unknown",
            ", ".join(observer.unknowns),
            "write ww.posterior(observer, reading).interval()",
        )
    y = observer.checked_reading(reading)
    readings = y.reshape(-1, y.shape[-1])
    # Down to a billionth of a billionth of the highest density.
    sums = cell_sums(tree_of(observer, TOLERANCE), readings, drop=41.0)
    counts = np.zeros(len(readings), dtype=int)
    for marginal in sums.marginals():
        start, step, log = marginal.start[:, None], marginal.step[:, None], marginal.log
        # Per metre, where it is flat towards the ends, and cubics between cells make no valleys.
        cells = start + step * np.arange(log.shape[1])
        x, density = interpolate(log - constrain_distance(cells)[1], 8)
        log_slope = constrain_distance(start + step * x)[1]
        last = log.shape[1] - 1 - np.isfinite(log[:, ::-1]).argmax(axis=1)
        for row, log_density, slope, end in zip(
            marginal.readings, density, log_slope, last, strict=True
        ):
            weight = np.exp(log_density + slope - (log_density + slope).max())
            weight[(x < 1) | (x > end - 1)] = 0.0  # cubics bend next to places without a value
            counts[row] = _count(log_density, weight / weight.sum(), share)
    return counts if y.ndim > 1 else counts[0]


def is_divided(observer: Observer, reading: Array) -> Flags:
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


# -- emcee -----------------------------------------------------------------------------------------


def sample(
    observer: Observer, reading: Array, seed: Seed, tolerance: float | None, progress: Any
) -> EmceeSolution:
    """Posteriors of readings (B, R) by emcee, `STACKED` in one run."""
    several = int(len(observer.unknowns) > 1)
    rng = np.random.default_rng(seed)
    runs, modes = [], []
    for first in range(0, len(reading), STACKED):
        readings = reading[first : first + STACKED]

        def density(x: Array, index: Index, readings: Array = readings) -> Array:
            value = observer.log_density(x, readings[index, None])
            # Beyond, where contacts stay at an end, a density that does would let walkers go.
            return np.where(np.abs(x[..., 0]) < FARTHEST, value, -np.inf)

        start, mode = _start(observer, readings, density, rng)
        run = sample_stacked(
            density,
            start,
            seed=rng,
            functions=lambda x: observer.space.constrain(x)[0],
            precision=tolerance or PRECISION[several],
            max_steps=MOST_STEPS[several],
            indexed=True,
        )
        runs.append(run)
        modes.append(mode)
        if progress:
            progress(first + len(readings), len(reading))
    run = StackedSample(*map(np.concatenate, zip(*runs, strict=True)))
    mode = observer.space.constrain(np.concatenate(modes))[0]
    columns = np.stack([run.mean, run.sd, run.mcse_mean, run.mcse_sd])
    estimates = [Estimate(*columns[..., i]) for i in range(mode.shape[1])]
    # Of one unknown the prior is as good as any reading; of several one may be known by a ridge.
    status = np.full(len(reading), Status.CONVERGED)
    if several:
        status[is_unidentified(observer, mode)] = Status.UNIDENTIFIED
    status[is_improbable(observer, reading, mode)] = Status.IMPROBABLE_READING
    status[_missing_peaks(observer, reading, estimates[0])] = Status.SEVERAL_PEAKS
    status[~run.converged] = Status.NOT_CONVERGED

    return EmceeSolution(run.values, estimates, status.astype(np.int8))


@dataclass(frozen=True, eq=False)
class EmceeSolution:
    """Draws (B, chain, draw, U) of emcee's walkers."""

    values: Array
    estimates: list[Estimate]
    status: Codes

    @property
    def log_evidence(self) -> Array:
        """NaN: walkers do not give it."""
        return np.full(len(self.values), np.nan)

    def quantiles(self, p: Array, unknown: int) -> Array:
        return np.quantile(self.values[..., unknown], p, axis=(1, 2)).T

    def quantile_errors(self, p: Array, unknown: int) -> Array:
        return np.full((len(self.values), len(p)), np.nan)

    def draws(self, count: int, seed: Seed) -> Array:
        """The last so many of each chain; nothing is drawn anew."""
        return self.values[:, :, -count:]


def _missing_peaks(observer: Observer, reading: Array, sampled: Estimate) -> Flags:
    """Posteriors (B,) of one unknown whose mass lies apart, and that quadrature does not confirm.

    No diagnostic of the walkers sees a peak where none of them is.
    """
    missing = is_divided(observer, reading)
    if missing.any():
        exact = cell_sums(tree_of(observer, TOLERANCE), reading[missing])
        mean, sd, *errors = (column[missing] for column in sampled)
        off = np.abs([exact.mean[:, 0] - mean, exact.sd[:, 0] - sd])
        missing[missing] = (off > 4 * np.array(errors)).any(axis=0)
    return missing


def _start(
    observer: Observer, reading: Array, density: Any, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Walkers (B, E, W, U) of four ensembles, inside the support, and the modes (B, U).

    The best places of a scatter of the prior climb by Fisher scoring until they are among the bulk
    of what is about them (a Newton decrement of √(2U) sds), the best of them on to its peak.
    Walkers are drawn about each by the inverse of the information there, in proportion to the mass
    that this would be.
    """
    dim, bounded, places = len(observer.unknowns), observer.bounded, 6
    along, others = {1: (257, 1), 2: (45, 9)}.get(dim, (25, 5))
    scatter = observer.space.spread(expit(np.linspace(-7.0, 6.0, along)), others=others)
    shape = (along,) * bounded + (others,) * (dim - bounded)
    best = _best_places(density_at(observer, scatter)(reading), reading, shape, places)
    index = np.arange(len(reading))
    repeated = np.repeat(reading, places, axis=0)
    x, top, covariance = fisher_scoring(observer, repeated, scatter[best.ravel()], 2.0 * dim, 15)
    top = top.reshape(-1, places)
    highest = index * places + top.argmax(axis=1)
    mode, _, _ = fisher_scoring(observer, reading, x[highest], 1e-4, 25)
    root = np.linalg.cholesky(covariance).reshape(-1, places, dim, dim)
    mass = top + np.log(np.diagonal(root, axis1=2, axis2=3)).sum(axis=2)
    weight = np.cumsum(np.exp(mass - mass.max(axis=1, keepdims=True)), axis=1)
    # With 6 walkers in an ensemble 6 of 48 force maps did not converge, with 16 all did.
    walkers = (len(reading), 4, max(16, 2 * dim + 2))
    u = rng.random(walkers) * weight[:, -1, None, None]
    which = (u[..., None] > weight[:, None, None]).sum(axis=3)
    at = index[:, None, None], which
    step = root[at] @ rng.standard_normal((*walkers, dim, 1))
    start = x.reshape(-1, places, dim)[at] + step[..., 0]
    for _ in range(30):  # draw in towards the best place what has fallen outside
        bad = np.isneginf(density(start.reshape(len(reading), -1, dim), index)).reshape(walkers)
        if not bad.any():
            break
        start = np.where(bad[..., None], (start + mode[:, None, None]) / 2, start)
    return start, mode


def _best_places(table: Array, reading: Array, shape: tuple[int, ...], places: int) -> Index:
    """Places (B, K) of a grid with the highest densities (B, n), none next to another."""
    refuse_impossible(reading, table.max(axis=1))
    grid = np.stack(np.unravel_index(np.arange(table.shape[1]), shape), axis=-1)
    best = np.empty((len(reading), places), dtype=np.intp)
    for k in range(places):
        best[:, k] = table.argmax(axis=1)
        lost = np.isneginf(table[np.arange(len(table)), best[:, k]])
        best[lost, k] = best[lost, 0]
        for row, at in enumerate(best[:, k]):
            table[row, (np.abs(grid - grid[at]) <= 2).all(axis=1)] = -np.inf
    return best
