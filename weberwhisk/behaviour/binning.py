"""Thousands of trials, each at measured places of its own, in fewer cells."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .encodings import UnitEncodings
from .trials import Cells

Array = NDArray[np.float64]


def binned(
    task: Any, encodings: UnitEncodings, cells: Cells, group: NDArray[np.intp], most: int = 1000
) -> tuple[UnitEncodings, Cells, NDArray[np.intp]]:
    """About `most` cells: those of a bias that are alike in D for k = 1, and in its variance.

    A bin is some thousandths of D wide, and what is lost is of second order in its width over k.
    """
    n = cells.n
    if n.size <= most:
        return encodings, cells, group
    sd = task.decision_sd(encodings.encoded(np.float64(1.0)))
    d, variance = (encodings.mean_2 - encodings.mean_1) / sd, encodings.spread / sd**2
    spread = np.log(np.maximum(variance, 1e-6))
    level = np.floor(15.99 * (spread - spread.min()) / (np.ptp(spread) + 1e-12))
    _, pool = np.unique(np.column_stack([level, group]), axis=0, return_inverse=True)
    pool = pool.reshape(-1)
    sizes = np.bincount(pool)
    order = np.lexsort((d, pool))
    rank = np.empty(n.size, dtype=np.intp)
    rank[order] = np.arange(n.size) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    each = max(most // sizes.size, 1)
    _, first, same = np.unique(
        pool * each + rank * each // sizes[pool], return_index=True, return_inverse=True
    )
    same = same.reshape(-1)

    def total(values: Array) -> Array:
        return np.bincount(same, values).astype(float)

    weight = total(n)
    ratio = total(n * encodings.sd_2 / encodings.sd_1) / weight
    unit = UnitEncodings(np.zeros(first.size), np.ones(first.size), ratio, ratio)
    sd = task.decision_sd(unit.encoded(np.float64(1.0)))
    fewer = Cells(
        cells.stimulus_1[first], cells.stimulus_2[first], cells.standard[first], weight,
        total(cells.count),
    )  # fmt: skip
    mean, spread = sd * total(n * d) / weight, sd**2 * total(n * variance) / weight
    return unit._replace(mean_2=mean, spread=spread), fewer, group[first]
