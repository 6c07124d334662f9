"""emcee on contacts: where the walkers start, and what their sample says.

It owes nothing to quadrature, so that it can check it: the walkers start from the Fisher
information about the best places of a scatter of the prior, and move as those of `ensemble` do.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.special import expit

from .._util.sampling import StackedSample, sample_stacked
from .._util.values import Array, Flags, Index
from ..receptors import Seed
from .coordinates import FARTHEST
from .laplace import climb, density_at, is_divided
from .observer import Observer
from .result import Estimate, Solution, Status, is_improbable, is_unidentified, refuse_impossible
from .tree import TOLERANCE, tree_of

#: Monte Carlo error of the sd, over the sd, that emcee goes on for, and the steps after which a
#: posterior that has not converged is called so: one unknown, and more.
PRECISION, MOST_STEPS = (0.02, 0.03), (20_000, 6_000)
#: Posteriors in one run: more are no quicker, and 6000 steps of three unknowns take 0.3 GB.
STACKED = 64
#: Walkers in an ensemble: with 6 of them 6 of 48 force maps did not converge, with 16 all did.
WALKERS = 16


def sample(
    observer: Observer, reading: Array, seed: Seed, tolerance: float | None, progress: Any
) -> Solution:
    """Posteriors of readings (B, R), so many in one run."""
    several = int(len(observer.unknowns) > 1)
    rng = np.random.default_rng(seed)
    runs, modes = [], []
    for first in range(0, len(reading), STACKED):
        rows = reading[first : first + STACKED]

        def density(x: Array, index: Index, rows: Array = rows) -> Array:
            value = observer.log_density(x, rows[index, None])
            # Beyond, where contacts stay at an end, a density that does would let walkers go.
            return np.where(np.abs(x[..., 0]) < FARTHEST, value, -np.inf)

        start, mode = _start(observer, rows, density, rng)
        run = sample_stacked(
            density,
            start,
            seed=rng,
            functions=lambda x: observer.contact(x)[0],
            precision=tolerance or PRECISION[several],
            max_steps=MOST_STEPS[several],
            indexed=True,
        )
        runs.append(run)
        modes.append(mode)
        if progress:
            progress(first + len(rows), len(reading))
    run = StackedSample(*map(np.concatenate, zip(*runs, strict=True)))
    mode = observer.contact(np.concatenate(modes))[0]
    columns = np.stack([run.mean, run.sd, run.mcse_mean, run.mcse_sd])
    estimates = [Estimate(*columns[..., i]) for i in range(mode.shape[1])]
    # Of one unknown the prior is as good as any reading; of several one may be known by a ridge.
    status = np.full(len(reading), Status.CONVERGED)
    if several:
        status[is_unidentified(observer, mode)] = Status.UNIDENTIFIED
    status[is_improbable(observer, reading, mode)] = Status.IMPROBABLE_READING
    status[_missing_peaks(observer, reading, estimates[0])] = Status.SEVERAL_PEAKS
    status[~run.converged] = Status.NOT_CONVERGED

    def quantile_of(p: Array, unknown: int) -> Array:
        return np.quantile(run.values[..., unknown], p, axis=(1, 2)).T

    def draws_of(count: int, seed: Seed) -> Array:
        return run.values[:, :, -count:]

    status, no_evidence = status.astype(np.int8), np.full(len(reading), np.nan)
    return Solution(estimates, status, no_evidence, quantile_of, draws_of)


def _missing_peaks(observer: Observer, reading: Array, sampled: Estimate) -> Flags:
    """Posteriors (B,) of one unknown whose mass lies apart, and that quadrature does not confirm.

    No diagnostic of the walkers sees a peak where none of them is.
    """
    missing = is_divided(observer, reading)
    if missing.any():
        exact = tree_of(observer, TOLERANCE).sums(reading[missing])
        mean, sd, *errors = (column[missing] for column in sampled)
        off = np.abs([exact.mean[:, 0] - mean, exact.sd[:, 0] - sd])
        missing[missing] = (off > 4 * np.array(errors)).any(axis=0)
    return missing


def _start(
    observer: Observer, reading: Array, density: Any, rng: np.random.Generator, places: int = 6
) -> tuple[Array, Array]:
    """Walkers (B, E, W, U) of four ensembles, inside the support, and the modes (B, U).

    The best places of a scatter of the prior climb by Fisher scoring until they are among the bulk
    of what is about them (a Newton decrement of √(2U) sds), the best of them on to its peak.
    Walkers are drawn about each by the inverse of the information there, in proportion to the mass
    that this would be.
    """
    dim, bounded = len(observer.unknowns), observer.bounded
    along, others = {1: (257, 1), 2: (45, 9)}.get(dim, (25, 5))
    scatter = observer.space.spread(expit(np.linspace(-7.0, 6.0, along)), others=others)
    shape = (along,) * bounded + (others,) * (dim - bounded)
    best = _best_places(density_at(observer, scatter)(reading), reading, shape, places)
    index = np.arange(len(reading))
    rows = np.repeat(reading, places, axis=0)
    x, top, covariance = climb(observer, rows, scatter[best.ravel()], 2.0 * dim, 15)
    top = top.reshape(-1, places)
    highest = index * places + top.argmax(axis=1)
    mode, _, _ = climb(observer, reading, x[highest], 1e-4, 25)
    root = np.linalg.cholesky(covariance).reshape(-1, places, dim, dim)
    mass = top + np.log(np.diagonal(root, axis1=2, axis2=3)).sum(axis=2)
    weight = np.cumsum(np.exp(mass - mass.max(axis=1, keepdims=True)), axis=1)
    walkers = (len(reading), 4, max(WALKERS, 2 * dim + 2))
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
