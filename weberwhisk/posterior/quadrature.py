"""Quadrature, the reference: panels for one unknown, tiles for more."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..observer import Observer
from ..receptors import Seed
from .by_tiles import by_tiles
from .panels import panels_of
from .result import Estimate, Status
from .solution import Array, Solution

#: Error of mean and sd, over the sd, above which a quadrature of one unknown is imprecise, and
#: above which an odd reading's is.
TOLERANCE, ODD = 1e-6, 1e-2


def quadrature(
    observer: Observer, reading: Array, seed: Seed, tolerance: float | None, progress: Any
) -> Solution:
    if len(observer.unknowns) > 1:
        return by_tiles(observer, reading, tolerance, progress)
    panels = panels_of(observer)
    m = panels.moments(reading)
    error = np.maximum(m.mean_error, m.sd_error) / m.sd
    wanted = tolerance or TOLERANCE
    status = np.where(error <= wanted, Status.CONVERGED, Status.IMPRECISE)
    # Of an odd reading digits are of no interest, but numbers that may be anything are.
    odd = m.improbable & (error <= max(wanted, ODD))
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


def _stratified(rows: int, count: int, seed: Seed) -> Array:
    """Probabilities (rows, 4·count), one from each stratum, in random order: four chains."""
    rng = np.random.default_rng(seed)
    u = (np.arange(4 * count) + rng.random((rows, 4 * count))) / (4 * count)
    return rng.permuted(np.clip(u, 1e-12, 1 - 1e-12), axis=1)
