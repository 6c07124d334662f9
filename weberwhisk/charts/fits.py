"""Error and coverage of a fitted Weber fraction against time, on simulated choices."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import pandas as pd

from ..behaviour import Trials, fit_weber, simulate_trials
from .timing import Row

#: The observer: Weber fraction, lapses at either end; nine signed levels to ±0.30 of one standard.
K, LAPSE = 0.1, 0.02
#: Trials a level.
SIZES = (13, 33, 111)
#: Middle and 95 % interval of the Weber fraction; NaN where a tool gives no interval.
Answer = tuple[float, float, float]
Tool = Callable[[Trials], Answer]


def ours(**options: str) -> Tool:
    """This package's posterior median and 95 % interval."""

    def answer(trials: Trials) -> Answer:
        fit = fit_weber(trials, **options)  # type: ignore[arg-type]
        return (fit.weber_fraction, *fit.interval())

    return answer


TOOLS: dict[str, Tool] = {
    "quadrature": ours(),
    "emcee": ours(method="emcee"),
    "quadrature, equal-variance": ours(noise="equal-variance"),
}


def measure_tool(name: str, tool: Tool, per_level: int, sets: int) -> Row:
    """One row: median CPU time, relative RMSE, bias and coverage over data sets of their own."""
    times, middle, inside = [], [], []
    for seed in range(sets):
        trials = simulate_trials(
            weber_fraction=K, lapse_low=LAPSE, lapse_high=LAPSE, trials_per_level=per_level,
            seed=400_000 + 1000 * per_level + seed,
        )  # fmt: skip
        start = time.process_time()
        value, low, high = tool(trials)
        times.append(time.process_time() - start)
        middle.append(value / K - 1)
        inside.append(np.nan if np.isnan(low) else low < K < high)
    off = np.array(middle)
    return {
        "part": "fits",
        "scene": f"{9 * per_level} trials",
        "method": name,
        "knob": 9 * per_level,
        "count": sets,
        "seconds": float(np.median(times)),
        "error": float(np.sqrt(np.nanmean(off**2))),
        "failed": float(np.mean(~np.isfinite(off))),
        "bias": float(np.nanmedian(off)),
        "coverage": float(np.mean(inside)),
    }


def measure(*, full: bool = False, sets: int | None = None) -> pd.DataFrame:
    """Relative RMSE of the Weber fraction, coverage of its 95 % interval, and CPU seconds a fit."""
    sets = sets or (100 if full else 6)
    rows = []
    for per_level in SIZES if full else SIZES[:2]:
        for name, tool in TOOLS.items():
            many = sets if name != "emcee" else max(sets // 4, 3)
            rows.append(measure_tool(name, tool, per_level, many))
    return pd.DataFrame(rows)
