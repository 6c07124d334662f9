"""Quadrature, the reference: panels for one unknown, adaptive grids for two to four."""

from __future__ import annotations

from dataclasses import fields
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..observer import Observer
from ..receptors import Seed
from ..threads import on_threads
from .by_tiles import by_tiles
from .lattice import LatticeMoments
from .mode import Mode, find_mode, find_other, starting_points
from .nodes import Nodes
from .nuisance import MOST, LastUnknown
from .panels import panels_of
from .result import Estimate, Status
from .solution import Array, Solution, is_improbable, is_unidentified
from .tiles import AllUnknowns, Engine

#: Error of mean and sd, over the sd, above which a quadrature is called imprecise: one unknown,
#: and more.
TOLERANCE = (1e-6, 1e-2)
#: Posteriors that are worked on together, by one thread.
TOGETHER = 2048


def quadrature(
    observer: Observer, reading: Array, seed: Seed, tolerance: float | None, progress: Any
) -> Solution:
    if len(observer.unknowns) == 2 or _is_fusion_of_two(observer):
        return by_tiles(observer, reading, tolerance, progress)
    if len(observer.unknowns) > 1:
        return _several(observer, reading, tolerance, progress)
    panels = panels_of(observer)
    m = panels.moments(reading)
    error = np.maximum(m.mean_error, m.sd_error) / m.sd
    wanted = tolerance or TOLERANCE[0]
    status = np.where(error <= wanted, Status.CONVERGED, Status.IMPRECISE)
    # Of an odd reading digits are of no interest, but numbers that may be anything are.
    odd = m.improbable & (error <= max(wanted, TOLERANCE[1]))
    status = np.where(odd, Status.IMPROBABLE_READING, status)

    def quantile_of(p: Array, unknown: int) -> Array:
        return panels.quantiles(reading, p)

    def quantile_error_of(p: Array, unknown: int) -> Array:
        """The panels' own estimate, as a share of mass that may lie on the wrong side; and what
        cubics between nodes miss: 5e-6 sd at most beside sums, k = 0.03 to 0.3.
        """
        return np.asarray(m.sd[:, None] * (1e-5 + error[:, None] / (4 * p * (1 - p))))

    def draws_of(count: int, seed: Seed) -> Array:
        u = _stratified(len(reading), count, seed)
        return panels.quantiles(reading, u).reshape(len(reading), 4, -1, 1)

    estimate = Estimate(m.mean, m.sd, m.mean_error, m.sd_error)
    return Solution(
        [estimate],
        status.astype(np.int8),
        m.log_evidence,
        quantile_of,
        draws_of,
        quantile_error_of,
    )


def _is_fusion_of_two(observer: Observer) -> bool:
    """Whether cues of distance and an unknown of its own each are fused.

    Such as forces and bearings: a ridge of one in another, on which climbs from a few starts missed
    the peak (by 5.7 sd, and called it converged), and lattices the ends (by 0.02 to 0.08 sd).
    """
    cues = getattr(observer.cue, "cues", ())
    own = [name for cue in cues for name in cue.unknowns[1:]]
    return len(observer.unknowns) == 3 and len(own) == 2 and all(len(c.unknowns) < 3 for c in cues)


def _several(
    observer: Observer, reading: Array, tolerance: float | None, progress: Any
) -> Solution:
    dim, wanted = len(observer.unknowns), tolerance or TOLERANCE[1]
    starts = range(0, len(reading), TOGETHER)
    parts = []
    for part in on_threads(lambda i: _part(observer, reading[i : i + TOGETHER], wanted), starts):
        parts.append(part)
        if progress:
            progress(min(len(parts) * TOGETHER, len(reading)), len(reading))
    mode = Mode(*(np.concatenate([getattr(p.mode, f.name) for p in parts]) for f in fields(Mode)))
    mean, sd, mean_error, sd_error, log_evidence, *_ = map(
        np.concatenate, zip(*(part.moments for part in parts), strict=True)
    )
    status, unidentified = (
        np.concatenate([getattr(part, name) for part in parts])
        for name in ("status", "unidentified")
    )
    estimates = [
        Estimate(mean[:, i], sd[:, i], mean_error[:, i] * sd[:, i], sd_error[:, i] * sd[:, i])
        for i in range(dim)
    ]

    def nodes(row: int, *, of_all: bool) -> Nodes:
        rows = np.array([row])
        whole = _engine(observer, reading[rows], mode.of(rows), wanted, of_all=of_all)
        kept = whole.on_grid(max_points=_most(unidentified[row]), keep_points=True).nodes
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

    return Solution(estimates, status.astype(np.int8), log_evidence, quantile_of, draws_of)


class _Part(NamedTuple):
    """What was found of some of the readings."""

    mode: Mode
    moments: LatticeMoments
    status: NDArray[np.int64]
    unidentified: NDArray[np.bool_]


def _part(observer: Observer, reading: Array, tolerance: float) -> _Part:
    starts = starting_points(observer, reading)
    mode = find_mode(observer, reading, starts)
    contact = observer.contact(mode.x)[0]
    unidentified = is_unidentified(observer, contact)
    found = _moments(observer, reading, mode, unidentified, tolerance)
    status = np.where(found.converged, Status.CONVERGED, Status.IMPRECISE)
    # A second peak that was missed has moments of its own.
    rows, other = find_other(observer, reading, mode, starts)
    if rows.size:
        beside = _moments(observer, reading[rows], other, unidentified[rows], tolerance)
        off = (np.abs(beside.mean - found.mean[rows]) / found.sd[rows]).max(axis=1)
        status[rows[~(off < APART)]] = Status.SEVERAL_PEAKS
    # Along a ridge a few per cent are of no interest; numbers that may be anything are.
    precise = (np.maximum(found.mean_error, found.sd_error) < LOST).all(axis=1)
    status[unidentified & ((status != Status.IMPRECISE) | precise)] = Status.UNIDENTIFIED
    right = np.isin(status, (Status.CONVERGED, Status.UNIDENTIFIED))
    status[right & is_improbable(observer, reading, contact)] = Status.IMPROBABLE_READING
    return _Part(mode, found, status, unidentified)


def _moments(
    observer: Observer,
    reading: Array,
    mode: Mode,
    unidentified: NDArray[np.bool_],
    tolerance: float,
) -> LatticeMoments:
    """By lattices, and on a grid of its own where a posterior asks too much of them."""
    engine = _engine(observer, reading, mode, tolerance)
    if engine.coarse.any() and not engine.coarse.all():
        parts = [
            (rows, _moments(observer, reading[rows], mode.of(rows), unidentified[rows], tolerance))
            for rows in (np.flatnonzero(engine.coarse), np.flatnonzero(~engine.coarse))
        ]
        order = np.argsort(np.concatenate([rows for rows, _ in parts]))
        columns = zip(*(part for _, part in parts), strict=True)
        return LatticeMoments._make(np.concatenate(column)[order] for column in columns)
    if len(observer.unknowns) < 4:
        found = engine.on_lattice(unidentified)
    else:
        mean, sd, mean_error, sd_error = np.full((4, *mode.x.shape), np.nan)
        none = np.zeros((2, len(reading)), dtype=bool)
        found = LatticeMoments(mean, sd, mean_error, sd_error, mode.log_density.copy(), *none)
    # Ridges go apart from the rest, so that no posterior depends on its neighbours.
    for ridge in (False, True):
        left = np.flatnonzero(~found.converged & ~found.gaping & (unidentified == ridge))
        if left.size:
            engine = _engine(observer, reading[left], mode.of(left), tolerance)
            again = engine.on_grid(max_points=_most(ridge))
            for name in set(found._fields) - {"gaping"}:
                getattr(found, name)[left] = getattr(again, name)
    return found


def _engine(
    observer: Observer, reading: Array, mode: Mode, tolerance: float, *, of_all: bool = False
) -> Engine:
    """All unknowns at once, or of three and more the last one first, by a rule that is fine enough.

    Where it is not for all alike, the engine says for which.
    """
    if of_all or len(observer.unknowns) == 2:
        return AllUnknowns(observer, reading, mode, tolerance)
    engine = LastUnknown(observer, reading, mode, tolerance)
    while engine.coarse.all() and engine.count < MOST:
        engine = LastUnknown(observer, reading, mode, tolerance, 3 * engine.count)
    return engine


def _most(ridge: bool) -> int:
    """Most nodes of one posterior: a ridge that no reading resolves is not worth resolving."""
    return MOST_NODES // 100 if ridge else MOST_NODES


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
