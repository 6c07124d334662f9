"""Quadrature, the reference: trees of cells, layers of trees, and what their sums say."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise, product
from typing import Any

import numpy as np

from .._util.values import Array, Index
from ..receptors import Seed
from .laplace import find_mode
from .layers import LayeredSums, Layers
from .observer import Observer
from .result import (
    Estimate,
    Solution,
    Status,
    is_improbable,
    is_unidentified,
    refuse_impossible,
)
from .tree import DROP, tree_of
from .weighted import Spans, Sums, extrapolated

#: Error of means and sds, in sds, above which posteriors are `IMPRECISE`.
TOLERANCE = 2e-3
#: Readings that are solved together, for progress and memory.
TOGETHER = 2048


def sums_of(
    observer: Observer,
    readings: Array,
    covariance: Array | None = None,
    *,
    tolerance: float = TOLERANCE,
    drop: float = DROP,
) -> Sums | LayeredSums | PiecewiseSums:
    """The posteriors of readings (B, R) as weighted cells.

    With the covariances (B, R, R) of measurement errors, which add to the receptors' noise; cells
    whose density is `drop` nats below the highest are left out.
    """
    pieces = pieces_of(observer)
    if len(pieces) > 1:
        parts = [sums_of(p, readings, covariance, tolerance=tolerance, drop=drop) for p in pieces]
        return PiecewiseSums(observer, parts)
    if len(observer.unknowns) > observer.inner:
        layers = Layers(observer, tolerance, observer.inner)
        return layers.sums(readings, covariance, drop=drop)
    return tree_of(observer, tolerance).sums(readings, covariance, drop=drop)


def quadrature(
    observer: Observer, reading: Array, seed: Seed, tolerance: float | None, progress: Any
) -> Solution:
    """Posteriors of readings (B, R) by quadrature."""
    if len(observer.unknowns) > 4:
        raise ValueError(
            f"Quadrature sums over four unknowns at most, got {len(observer.unknowns)} "
            f'({", ".join(observer.unknowns)}); write method="emcee".'
        )
    wanted = tolerance or TOLERANCE
    if observer.noise.is_categorical and len(reading) > 1:
        # Few things can happen: each is summed once.
        each, back = np.unique(reading, axis=0, return_inverse=True)
        if len(each) < len(reading):
            return quadrature(observer, each, seed, tolerance, progress).of(back.reshape(-1))
    parts = []
    for first in range(0, len(reading), TOGETHER):
        some = reading[first : first + TOGETHER]
        parts.append(sums_of(observer, some, tolerance=wanted))
        if progress:
            progress(first + len(some), len(reading))
    return _solution(observer, reading, parts, wanted)


def _solution(observer: Observer, reading: Array, parts: Sequence[Any], wanted: float) -> Solution:
    mean, sd, error, evidence, best = (
        np.concatenate([getattr(part, name) for part in parts])
        for name in ("mean", "sd", "error", "log_evidence", "best")
    )
    refuse_impossible(reading, np.nan_to_num(evidence, nan=-np.inf))
    status = np.where(error <= wanted, Status.CONVERGED, Status.IMPRECISE)
    if len(observer.unknowns) > 1:
        # By the best cell, and where that says so by the mode itself. An error of a third of an sd
        # is worse news than a ridge.
        some = np.flatnonzero(is_unidentified(observer, best) & (error < 0.3))
        if some.size:
            mode = find_mode(observer, reading[some], observer.coordinates(best[some])).x
            some = some[is_unidentified(observer, observer.contact(mode)[0])]
        status[some] = Status.UNIDENTIFIED
    outside = is_improbable(observer, reading, best)
    vague = np.flatnonzero(outside & (status == Status.IMPRECISE))
    if vague.size:  # whose best cell may be the wrong one
        mode = find_mode(observer, reading[vague]).x
        outside[vague] = is_improbable(observer, reading[vague], observer.contact(mode)[0])
    status[outside] = Status.IMPROBABLE_READING
    ends = np.cumsum([len(part.error) for part in parts])[:-1]

    def quantile_of(p: Array, unknown: int) -> Array:
        return np.concatenate([part.quantiles(p, unknown) for part in parts])

    def quantile_error_of(p: Array, unknown: int) -> Array:
        # A share of the mass that moves the mean by its error may lie on the wrong side; and what
        # is interpolated between cells and nodes: a third of the most beside the kept truth.
        rough = 2e-3 if len(observer.unknowns) == observer.inner else 6e-3
        off = rough + error[:, None] / (4 * p * (1 - p))
        return np.asarray(sd[:, unknown, None] * off)

    def draws_of(count: int, seed: Seed) -> Array:
        rng = np.random.default_rng(seed)
        pairs = zip(parts, np.split(reading, ends), strict=True)
        out = np.concatenate([part.draws(4 * count, rng, rows) for part, rows in pairs])
        return out.reshape(len(reading), 4, count, -1)

    estimates = [Estimate(m, s, error * s, error * s) for m, s in zip(mean.T, sd.T, strict=True)]
    return Solution(
        estimates, status.astype(np.int8), evidence, quantile_of, draws_of, quantile_error_of
    )


# -- priors that leap ------------------------------------------------------------------------------


class _Within:
    """A distribution between two values, its density as it is."""

    def __init__(self, distribution: Any, low: float, high: float) -> None:
        self.distribution, self.ends = distribution, (low, high)
        for name in ("pdf", "logpdf", "cdf", "sf", "ppf", "isf", "median", "mean", "std"):
            if hasattr(distribution, name):
                setattr(self, name, getattr(distribution, name))

    def support(self) -> tuple[float, float]:
        return self.ends


def pieces_of(observer: Observer) -> list[Observer]:
    """Observers between the values at which priors of distance and angle leap; mostly itself.

    Between them densities are smooth, as the trapezoidal rule has them; the coordinates of each
    piece have no edges at its ends.
    """
    leaps = {name: at for name, at in observer.space.leaps.items() if len(at)}
    if not leaps:
        return [observer]
    choices = []
    for name, at in leaps.items():
        prior = observer.prior[name]
        low, high = observer.reach if name == "radial_distance" else prior.support()
        inside = at[(at > low) & (at < high)]
        edges = np.concatenate([[low], inside, [high]])
        some = [(a, b) for a, b in pairwise(edges) if prior.cdf(b) > prior.cdf(a)]
        choices.append([(name, _Within(prior, float(a), float(b))) for a, b in some])
    return [
        replace(observer, prior={**observer.prior, **dict(chosen)}, noise=observer.noise)
        for chosen in product(*choices)
    ]


class PiecewiseSums:
    """Posteriors under a prior that leaps: mixtures of those of its pieces.

    Attributes
    ----------
    mean, sd, error, log_evidence, best
        As of `weighted.Sums`.
    """

    def __init__(self, observer: Observer, parts: list[Any]) -> None:
        self.observer, self.parts = observer, parts
        log = np.stack([np.nan_to_num(p.log_evidence, nan=-np.inf) for p in parts])
        top = log.max(axis=0)
        with np.errstate(invalid="ignore"):
            weight = np.where(np.isfinite(top), np.exp(log - top), 0.0)
        total = weight.sum(axis=0)
        with np.errstate(divide="ignore", invalid="ignore"):
            self.log_evidence = np.where(total > 0, top + np.log(total), np.nan)
            self.share = weight / total
        mean = np.stack([np.nan_to_num(p.mean) for p in parts])
        sd = np.stack([np.nan_to_num(p.sd) for p in parts])
        share = self.share[..., None]
        self.mean = (share * mean).sum(axis=0)
        self.sd = np.sqrt((share * (sd**2 + (mean - self.mean) ** 2)).sum(axis=0))
        error = np.stack([np.where(np.isfinite(p.error), p.error, 0.0) for p in parts])
        self.error = np.where(total > 0, (self.share * error).sum(axis=0), np.inf)
        best = np.nan_to_num(self.share, nan=0.0).argmax(axis=0)
        self.best = np.stack([p.best for p in parts])[best, np.arange(len(best))]

    def spans(self, unknown: int, stride: int = 1) -> Iterator[Spans]:
        """Spans of an unknown, for one reading at a time."""
        every: dict[int, list[tuple[Array, Array, Array]]] = {}
        for part, share in zip(self.parts, self.share, strict=True):
            for spans in part.spans(unknown, stride):
                for row, low, high, mass in zip(*spans, strict=True):
                    own = low, high, share[row] * mass / mass.sum()
                    every.setdefault(int(row), []).append(own)
        for row, pieces in sorted(every.items()):
            yield Spans(
                np.array([row]), *(np.concatenate(c)[None] for c in zip(*pieces, strict=True))
            )

    def quantiles(self, p: Array, unknown: int) -> Array:
        """Quantiles (B, Q) of an unknown."""
        return extrapolated(self, p, unknown)

    def draws(self, count: int, rng: np.random.Generator, readings: Array) -> Array:
        """Draws (B, count, U) of the contact."""
        every = np.stack([part.draws(count, rng, readings) for part in self.parts])
        out = np.full(every.shape[1:], np.nan)
        for row in np.flatnonzero(np.isfinite(self.log_evidence)):
            which: Index = rng.choice(len(every), count, p=self.share[:, row])
            out[row] = every[which, row, np.arange(count)]
        return out
