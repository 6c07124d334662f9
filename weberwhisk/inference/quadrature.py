"""Posteriors by quadrature: sums of cells, or over nodes of them, of many readings."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._util.refusals import Refusal, argument
from .._util.values import Array
from ..receptors import Seed
from . import tree
from .approximate import find_mode
from .descent import cell_sums
from .layers import LayeredSums
from .nodes import Layers
from .observer import Observer
from .result import Estimate, Status, is_improbable, is_unidentified, refuse_impossible
from .tree import DROP, TOLERANCE, tree_of
from .weighted import WeightedPosteriors

__all__ = ["QuadratureSolution", "chunk_size", "quadrature", "refuse_too_many", "sums_of"]

#: Most readings that are solved together, for progress; of unknowns that have priors alone, whose
#: readings have up to 3 MB of cells each.
TOGETHER, LAYERED = 2048, 32


def sums_of(
    observer: Observer,
    readings: Array,
    covariance: Array | None = None,
    *,
    tolerance: float = TOLERANCE,
    drop: float = DROP,
) -> WeightedPosteriors:
    """The posteriors of readings (B, R) as weighted cells.

    With the covariances (B, R, R) of measurement errors, which add to the receptors' noise; cells
    whose density is `drop` nats below the highest are left out.
    """
    if len(observer.unknowns) > observer.inner:
        layers = Layers(observer, tolerance, observer.inner)
        return LayeredSums(layers, readings, covariance, drop)
    return cell_sums(tree_of(observer, tolerance), readings, covariance, drop=drop)


def quadrature(
    observer: Observer, reading: Array, seed: Seed, tolerance: float | None,
    progress: Callable[[int, int], None] | None,
) -> QuadratureSolution:  # fmt: skip
    """Posteriors of readings (B, R) by quadrature, some at a time."""
    refuse_too_many(observer)
    tolerance = tolerance or TOLERANCE
    solutions: list[QuadratureSolution] = []
    done, room, size = 0, tree.MEMORY / 2, chunk_size(observer)
    while done < len(reading) or not solutions:
        begin, done = done, min(done + size, len(reading))
        chunk = reading[begin:done]
        sums = sums_of(observer, chunk, tolerance=tolerance)
        part = QuadratureSolution.of_chunk(observer, chunk, sums, tolerance)
        room -= sums.bytes
        if room <= 0:
            part.kept = [None]
        solutions.append(part)
        if size != LAYERED:  # so many that their cells take a quarter of the memory
            size = int(np.clip(tree.MEMORY / 4 / max(sums.bytes / size, 1), LAYERED + 1, TOGETHER))
        if progress:
            progress(done, len(reading))
    solution = QuadratureSolution.joined(solutions)
    refuse_impossible(reading, solution.log_evidence)
    return solution


def refuse_too_many(observer: Observer) -> None:
    """Refuse an observer of more unknowns than can be summed over."""
    if len(observer.unknowns) > 4:
        raise Refusal(
            "Quadrature sums over four unknowns at most",
            f"{len(observer.unknowns)} ({', '.join(observer.unknowns)})",
            "write " + argument("method", "emcee"),
        )


def chunk_size(observer: Observer) -> int:
    """How many readings are solved together at most.

    Nodes of unknowns that have priors alone are halved for all of them: which they are matters.
    """
    return LAYERED if len(observer.unknowns) > observer.inner else TOGETHER


@dataclass(eq=False)
class QuadratureSolution:
    """Posteriors of many readings (B, R) by quadrature: moments (B, U), error (B,), status (B,).

    Their cells are kept while they fit in half of `tree.MEMORY`; those of later readings are summed
    again where quantiles or draws are requested, as are all in a copy from a pickle.

    Attributes
    ----------
    chunks : list
        Where chunks of readings begin and end.
    kept : list
        The sums of each chunk, None where they are not kept.
    """

    observer: Observer
    readings: Array
    tolerance: float
    mean: Array
    sd: Array
    error: Array
    log_evidence: Array
    status: NDArray[np.int8]
    chunks: list[tuple[int, int]]
    kept: list[WeightedPosteriors | None]

    @classmethod
    def of_chunk(
        cls, observer: Observer, readings: Array, sums: WeightedPosteriors, tolerance: float
    ) -> QuadratureSolution:
        """The posteriors of readings summed together; impossible ones have no evidence."""
        possible = ~np.isnan(sums.log_evidence)
        evidence = np.where(possible, sums.log_evidence, -np.inf)
        status = np.zeros(len(readings), dtype=np.int8)
        status[possible] = _status(
            observer, readings[possible], sums.best[possible], sums.error[possible], tolerance
        )
        return cls(
            observer, readings, tolerance, sums.mean, sums.sd, sums.error, evidence, status,
            [(0, len(readings))], [sums],
        )  # fmt: skip

    @classmethod
    def joined(cls, solutions: Sequence[QuadratureSolution]) -> QuadratureSolution:
        """Solutions of readings that follow one another, as one."""
        names = ("readings", "mean", "sd", "error", "log_evidence", "status")
        columns = {
            name: np.concatenate([getattr(part, name) for part in solutions]) for name in names
        }
        begins = np.cumsum([0, *(len(part.readings) for part in solutions)])
        chunks = [
            (int(begin) + first, int(begin) + last)
            for begin, part in zip(begins, solutions, strict=False)
            for first, last in part.chunks
        ]
        return cls(
            solutions[0].observer, tolerance=solutions[0].tolerance, chunks=chunks,
            kept=[sums for part in solutions for sums in part.kept], **columns,
        )  # fmt: skip

    def __getstate__(self) -> dict[str, Any]:
        return vars(self) | {"kept": [None] * len(self.kept)}

    @property
    def estimates(self) -> list[Estimate]:
        """Of each unknown."""
        columns = zip(self.mean.T, self.sd.T, strict=True)
        return [Estimate(m, s, self.error * s, self.error * s) for m, s in columns]

    def sums(self) -> Iterator[tuple[Array, WeightedPosteriors]]:
        """Readings (n, R) and their sums, some at a time."""
        for (begin, end), sums in zip(self.chunks, self.kept, strict=True):
            readings = self.readings[begin:end]
            yield readings, sums or sums_of(self.observer, readings, tolerance=self.tolerance)

    def quantiles(self, p: Array, unknown: int) -> Array:
        return np.concatenate([sums.quantiles(p, unknown) for _, sums in self.sums()])

    def quantile_errors(self, p: Array, unknown: int) -> Array:
        # An error of the mean may come of mass on the wrong side of a quantile. Mass at an end of a
        # 95 % interval that moves the mean by e sds moves that end by 9 e, which 4 p (1 − p) has
        # as 10 e; at the median e. To this comes what is off between cells and nodes: a third of
        # the most that was met beside the kept truth (`analyses/accuracy`), and of 314 ends of an
        # angle beside dense sums one was 5.4e-3 sds off, the others less than 5e-3.
        layered = len(self.observer.unknowns) > self.observer.inner
        interpolated = 6e-3 if layered else 5e-3 if unknown else 2e-3
        off = interpolated + self.error[:, None] / (4 * p * (1 - p))
        return np.asarray(self.sd[:, unknown, None] * off)

    def draws(self, count: int, seed: Seed) -> Array:
        rng = np.random.default_rng(seed)
        out = [sums.draws(4 * count, rng, readings) for readings, sums in self.sums()]
        return np.concatenate(out).reshape(len(self.readings), 4, count, -1)


def _status(
    observer: Observer, readings: Array, best: Array, error: Array, tolerance: float
) -> NDArray[np.int8]:
    """The status of readings (B, R), by the contact of the best cell and the estimated error."""
    status = np.where(error <= tolerance, Status.CONVERGED, Status.IMPRECISE)
    if len(observer.unknowns) > 1:
        # By the best cell, and where that says so by the mode itself. An error of a third of an sd
        # is worse news than a ridge.
        vague = np.flatnonzero(is_unidentified(observer, best) & (error < 0.3))
        if vague.size:
            mode, _ = find_mode(observer, readings[vague], observer.space.unconstrain(best[vague]))
            vague = vague[is_unidentified(observer, observer.space.constrain(mode)[0])]
        status[vague] = Status.UNIDENTIFIED
    outside = is_improbable(observer, readings, best)
    vague = np.flatnonzero(outside & (status == Status.IMPRECISE))
    if vague.size:  # whose best cell may be the wrong one
        mode, _ = find_mode(observer, readings[vague])
        outside[vague] = is_improbable(observer, readings[vague], observer.space.constrain(mode)[0])
    status[outside] = Status.IMPROBABLE_READING
    return status.astype(np.int8)
