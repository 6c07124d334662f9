"""Posteriors of many readings spread over processes or a cluster: the same numbers to the bit."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from .._util import campaign
from .._util.values import Array, pd
from .observer import Observer
from .quadrature import QuadratureSolution, chunk_size, refuse_too_many, sums_of
from .result import refuse_impossible
from .tree import TOLERANCE

__all__ = ["solve_chunk", "spread_quadrature"]


def spread_quadrature(
    observer: Observer, readings: Array, tolerance: float | None,
    progress: Callable[[int, int], None] | None, workers: int | None, scheduler: str | None,
) -> QuadratureSolution:  # fmt: skip
    """The posteriors of readings (B, R) by quadrature, as `quadrature` solves them.

    Workers send sums and no cells, which take hundreds of times as much memory.
    """
    refuse_too_many(observer)
    tolerance = tolerance or TOLERANCE
    count, size = len(readings), chunk_size(observer)
    bounds = [(begin, min(begin + size, count)) for begin in range(0, count, size)]
    chunks_done = 0.0

    def advance(more: float) -> None:
        nonlocal chunks_done
        chunks_done += more
        assert progress is not None
        progress(min(round(chunks_done) * size, count), count)

    table = campaign.run(
        partial(solve_chunk, observer=observer, tolerance=tolerance),
        [{"readings": readings[begin:end].tolist()} for begin, end in bounds], seed=0,
        workers=1 if workers is None else workers, scheduler=scheduler, title="Posteriors",
        progress=advance if progress else None,
    )  # fmt: skip
    evidence = table["log_evidence"].to_numpy()
    refuse_impossible(readings, evidence)
    unknowns = range(len(observer.unknowns))
    mean, sd = (
        np.column_stack([table[f"{name}_{i}"] for i in unknowns]) for name in ("mean", "sd")
    )
    return QuadratureSolution(
        observer, readings, tolerance, mean, sd, table["error"].to_numpy(), evidence,
        table["status"].to_numpy(np.int8), bounds, [None] * len(bounds),
    )  # fmt: skip


def solve_chunk(
    chunk: dict[str, Any], _seed: np.random.SeedSequence, observer: Observer, tolerance: float
) -> pd.DataFrame:
    """Moments, error, evidence and status of a chunk's readings, one a row."""
    readings = np.array(chunk["readings"], dtype=float)
    sums = sums_of(observer, readings, tolerance=tolerance)
    part = QuadratureSolution.of_chunk(observer, readings, sums, tolerance)
    moments = {
        f"{name}_{i}": column
        for name, values in (("mean", part.mean), ("sd", part.sd))
        for i, column in enumerate(values.T)
    }
    rest = {"error": part.error, "log_evidence": part.log_evidence, "status": part.status}
    return pd.DataFrame(moments | rest)
