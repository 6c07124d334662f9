"""Speed against accuracy, measured here and now: beams, posteriors, JNDs, fits and growth.

Every part is a table in one form, a row for each method, scene and setting of the method's own
knob: `part`, `scene`, `method`, `knob`, `seconds` (CPU of one core, of one solution), `error`,
`failed` (share without an answer, or flagged by the method itself). Time and error are of the same
run. Rows of other tools may be joined to them; `weberwhisk.figures.speed_accuracy` draws either.
"""

from __future__ import annotations

import time
import tracemalloc
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pandas as pd

from ..behaviour import Trials, fit_population, fit_weber, simulate_population, simulate_trials
from ..citing import machine
from ..jnd_curves import jnd_curve
from ..posterior import posterior
from . import beams, posteriors
from .beams import Row
from .posteriors import OBSERVERS, readings

__all__ = ["PARTS", "TOOLS", "beams", "machine", "measure_fits", "measure_tool", "posteriors"]

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


def measure_tool(
    name: str, tool: Tool, per_level: int, sets: int, k: float = 0.1, lapse: float = 0.02
) -> Row:
    """One row: median CPU time, relative RMSE with its standard error, bias and coverage.

    The data sets go by their number and size alone, so that every tool has the same: nine signed
    levels to ±0.30 of one standard, answered with the Weber fraction k and lapses at either end.
    """
    times, middle, inside = [], [], []
    for seed in range(sets):
        trials = simulate_trials(
            weber_fraction=k, lapse_low=lapse, lapse_high=lapse, trials_per_level=per_level,
            seed=400_000 + 1000 * per_level + seed,
        )  # fmt: skip
        start = time.process_time()
        value, low, high = tool(trials)
        times.append(time.process_time() - start)
        middle.append(value / k - 1)
        inside.append(np.nan if np.isnan(low) else low < k < high)
    off = np.array(middle)
    square = off[np.isfinite(off)] ** 2
    error = float(np.sqrt(square.mean()))
    return {
        "part": "fits",
        "scene": f"{9 * per_level} trials",
        "method": name,
        "knob": 9 * per_level,
        "count": sets,
        "seconds": float(np.median(times)),
        "error": error,
        "error_se": float(square.std(ddof=1) / (2 * error * np.sqrt(square.size))),
        "failed": float(np.mean(~np.isfinite(off))),
        "bias": float(np.nanmedian(off)),
        "coverage": float(np.mean(inside)),
    }


def measure_fits(*, full: bool = False, sets: int | None = None) -> pd.DataFrame:
    """Relative RMSE of the Weber fraction, coverage of its 95 % interval, and CPU seconds a fit.

    All tools fit the same data sets: with fewer for the slow ones their RMSE is another number.
    """
    sets = sets or (100 if full else 3)
    return pd.DataFrame(
        [
            measure_tool(name, tool, per_level, sets)
            for per_level in (SIZES if full else SIZES[:1])
            for name, tool in TOOLS.items()
        ]
    )


# -- growth ----------------------------------------------------------------------------------------


def _job(what: str, n: int) -> Callable[[], Any]:
    """The call whose size is n; what it needs is made here."""
    one, two = list(OBSERVERS.values())[:2]
    if what.startswith("posteriors"):
        observer = two if "θ_d" in what else one
        rows = np.resize(readings(observer, 4096), (n, len(observer.cue.signal_names)))
        method = "emcee" if "emcee" in what else "quadrature"
        return lambda: posterior(observer, rows, method=method, seed=1)
    if what.startswith("trials"):
        trials = simulate_trials(trials_per_level=max(n // 9, 1), seed=1)
        return lambda: fit_weber(trials)
    if what.startswith("subjects"):
        table, _ = simulate_population(n, trials_per_level=15, seed=1)
        return lambda: fit_population(table, seed=1)
    r = np.linspace(5e-3, 45e-3, n)
    return lambda: jnd_curve(one, r, n_readings=20, seed=1)


def _sizes(what: str, most: int) -> Iterator[int]:
    n = 2 if what.startswith("subjects") else 16 if what.startswith("trials") else 1
    while n <= most:
        yield n
        n *= 4


def measure_growth(*, full: bool = False) -> pd.DataFrame:
    """CPU seconds and peak bytes of one call against its size, with the exponents of both."""
    tables = []
    largest = {  # in short, and in full; 0 leaves out what takes seconds a call
        "posteriors, quadrature, r": (1024, 65_536),
        "posteriors, quadrature, r and θ_d": (64, 4096),
        "posteriors, emcee, r": (64, 1024),
        "trials, fit": (4096, 262_144),
        "subjects, population fit": (0, 32),
        "distances, JND curve": (64, 1024),
    }
    for what, most in largest.items():
        if not most[full]:
            continue
        _job(what, 2)()  # what is made once is not counted
        rows = []
        for n in _sizes(what, most[full]):
            job = _job(what, n)
            start = time.process_time()
            job()
            seconds = time.process_time() - start
            tracemalloc.start()
            job()
            peak = tracemalloc.get_traced_memory()[1]
            tracemalloc.stop()
            rows.append(
                {"part": "growth", "method": what, "count": n, "seconds": seconds, "bytes": peak}
            )
        part = pd.DataFrame(rows)
        for column in ("seconds", "bytes"):
            part[f"slope_{column}"] = slope(part["count"], part[column])
        tables.append(part)
    return pd.concat(tables, ignore_index=True)


def slope(count: Any, value: Any) -> float:
    """Exponent of growth over the upper half of the sizes, by least squares; NaN of one size."""
    half = len(count) // 2
    x, y = (np.log(np.asarray(v, dtype=float)[-max(half, 2) :]) for v in (count, value))
    return float(np.polyfit(x, y, 1)[0]) if x.size > 1 else float("nan")


#: Name of each part, and what measures it: ``measure(full=...)`` gives its table.
PARTS = {
    "beams": beams.measure,
    "posteriors": posteriors.measure,
    "jnds": posteriors.measure_jnds,
    "fits": measure_fits,
    "growth": measure_growth,
}
