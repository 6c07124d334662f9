"""Quadrature, the reference: panels for one unknown, adaptive grids for two to four."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..observer import Observer
from ..receptors import Seed
from .densities import taken_apart
from .grid import GridPosterior, integrate
from .mode import Mode, find_mode, find_other, starting_points
from .nodes import Nodes
from .nuisance import integrate_but_last
from .panels import panels_of
from .result import Estimate, Status
from .solution import Array, Solution, is_improbable, is_unidentified, mode_root
from .threads import on_threads

#: Error of mean and sd, over the sd, above which a quadrature is called imprecise: one unknown,
#: and more.
TOLERANCE = (1e-6, 1e-2)
#: Posteriors whose grids are worked on together.
TOGETHER = 4096


def quadrature(
    observer: Observer, reading: Array, seed: Seed, tolerance: float | None, progress: Any
) -> Solution:
    if len(observer.unknowns) > 1:
        return _grid(observer, reading, tolerance, progress)
    panels = panels_of(observer)
    m = panels.moments(reading)
    error = np.maximum(m.mean_error, m.sd_error) / m.sd
    status = np.where(error > (tolerance or TOLERANCE[0]), Status.IMPRECISE, Status.CONVERGED)
    status = np.where(m.improbable, Status.IMPROBABLE_READING, status)

    def quantile_of(p: Array, unknown: int) -> Array:
        return panels.quantiles(reading, p)

    def draws_of(count: int, seed: Seed) -> Array:
        u = _stratified(len(reading), count, seed)
        return panels.quantiles(reading, u).reshape(len(reading), 4, -1, 1)

    estimate = Estimate(m.mean, m.sd, m.mean_error, m.sd_error)
    return Solution([estimate], status.astype(np.int8), m.log_evidence, quantile_of, draws_of)


def _grid(observer: Observer, reading: Array, tolerance: float | None, progress: Any) -> Solution:
    dim = len(observer.unknowns)
    starts = starting_points(observer, reading)
    mode = find_mode(observer, reading, starts)
    contact = observer.contact(mode.x)[0]
    unidentified = is_unidentified(observer, contact)
    improbable = is_improbable(observer, reading, contact)

    def limits(rows: NDArray[np.intp]) -> dict[str, Any]:
        # A ridge that no reading resolves is not worth resolving either.
        most = MOST_NODES // 100 if unidentified[rows[0]] else MOST_NODES
        return {"tolerance": tolerance or TOLERANCE[1], "max_points": most}

    def integral(rows: NDArray[np.intp], at: Mode, *, keep_points: bool = False) -> GridPosterior:
        density, functions = taken_apart(
            lambda x, index: observer.log_density_and_contact(x, reading[rows[index], None])
        )
        return integrate(
            density,
            at.x,
            mode_root(at),
            functions=functions,
            only_functions=True,
            keep_points=keep_points,
            **limits(rows),
        )

    def moments(rows: NDArray[np.intp], at: Mode, *, keep_points: bool = False) -> GridPosterior:
        if dim < 3:
            return integral(rows, at, keep_points=keep_points)
        return integrate_but_last(
            observer, reading[rows], at, keep_points=keep_points, **limits(rows)
        )

    # Ridges go apart from the rest, so that no posterior depends on its neighbours.
    pieces = [
        rows[start : start + TOGETHER]
        for rows in (np.flatnonzero(~unidentified), np.flatnonzero(unidentified))
        for start in range(0, len(rows), TOGETHER)
    ]

    parts, done = [], 0
    for rows in pieces:
        parts.append(moments(rows, mode.of(rows)))
        done += len(rows)
        if progress:
            progress(done, len(reading))
    back = np.argsort(np.concatenate(pieces))
    mean, sd, mean_error, sd_error = (
        np.concatenate([getattr(part, name) for part in parts])[back]
        for name in ("mean", "sd", "mean_error", "sd_error")
    )
    estimates = [
        Estimate(mean[:, i], sd[:, i], mean_error[:, i] * sd[:, i], sd_error[:, i] * sd[:, i])
        for i in range(dim)
    ]
    converged = np.concatenate([part.converged for part in parts])[back]
    status = np.where(converged, Status.CONVERGED, Status.IMPRECISE)
    # A second peak that the grid has missed has a grid, and moments, of its own.
    rows, other = find_other(observer, reading, mode, starts)
    if rows.size:
        beside = moments(rows, other)
        off = (np.abs(beside.mean - mean[rows]) / sd[rows]).max(axis=1)
        status[rows[~(off < APART)]] = Status.SEVERAL_PEAKS
    # Along a ridge a few per cent are of no interest; numbers that may be anything are.
    lost = (status == Status.IMPRECISE) & ~(np.maximum(mean_error, sd_error) < LOST).all(axis=1)
    status = np.where(unidentified & ~lost, Status.UNIDENTIFIED, status)
    status = np.where(improbable, Status.IMPROBABLE_READING, status)

    def nodes(row: int, *, of_all: bool) -> Nodes:
        rows = np.array([row])
        kept = (integral if of_all else moments)(rows, mode.of(rows), keep_points=True).nodes
        assert kept is not None
        return kept[0]

    def quantile_of(p: Array, unknown: int) -> Array:
        # Of three unknowns, the last is not among the nodes' coordinates unless asked for.
        of_all = unknown == dim - 1

        def quantiles(row: int) -> Array:
            kept = nodes(row, of_all=of_all)
            return kept.quantile(observer.contact(kept.points)[0][:, unknown], p)

        return np.stack(list(on_threads(quantiles, range(len(reading)))))

    def draws_of(count: int, seed: Seed) -> Array:
        from .arviz_io import resample

        rng = np.random.default_rng(seed)
        out = np.empty((len(reading), 4, count, dim))
        for row in range(len(reading)):
            kept = nodes(row, of_all=True)
            x = resample(kept.points, kept.weights, 4 * count, seed=rng, edges=kept.edges)
            out[row] = observer.contact(rng.permutation(x))[0].reshape(4, count, dim)
        return out

    log_evidence = np.concatenate([part.log_evidence for part in parts])[back]
    return Solution(estimates, status.astype(np.int8), log_evidence, quantile_of, draws_of)


#: Means from either of two peaks differ by less than this, in sds, where each grid has seen both.
APART = 0.05
#: An error, in sds, from which the imprecision of a ridge is worse news than the ridge.
LOST = 0.3
#: Most nodes in one pass over one posterior.
MOST_NODES = 2_000_000


def _stratified(rows: int, count: int, seed: Seed) -> Array:
    """Probabilities (rows, 4·count), one from each stratum, in random order: four chains."""
    rng = np.random.default_rng(seed)
    u = (np.arange(4 * count) + rng.random((rows, 4 * count))) / (4 * count)
    return rng.permuted(np.clip(u, 1e-12, 1 - 1e-12), axis=1)
