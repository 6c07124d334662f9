"""How time and memory grow with the number of posteriors, trials, subjects and places."""

from __future__ import annotations

import time
import tracemalloc
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pandas as pd

from ..behaviour import fit_population, fit_weber, simulate_population, simulate_trials
from ..jnd import jnd_curve
from ..posterior import posterior
from .posteriors import OBSERVERS, readings

#: Largest count of each, in full and in short.
MOST = {
    "posteriors, quadrature, r": (65_536, 1024),
    "posteriors, quadrature, r and θ_d": (4096, 64),
    "posteriors, emcee, r": (1024, 64),
    "trials, fit": (262_144, 4096),
    "subjects, population fit": (32, 8),
    "distances, JND curve": (1024, 64),
}


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
    return lambda: jnd_curve(one, r, draws=20, seed=1)


def _sizes(what: str, full: bool) -> Iterator[int]:
    most = MOST[what][0 if full else 1]
    n = 2 if what.startswith("subjects") else 16 if what.startswith("trials") else 1
    while n <= most:
        yield n
        n *= 4


def measure(*, full: bool = False) -> pd.DataFrame:
    """CPU seconds and peak bytes of one call against its size, with the exponents of both."""
    tables = []
    for what in MOST:
        _job(what, 2)()  # what is made once is not counted
        rows = []
        for n in _sizes(what, full):
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
    """Exponent of growth over the upper half of the sizes, by least squares; NaN of fewer than 2.

    Examples
    --------
    >>> round(slope([1, 10, 100, 1000], [5, 5, 50, 500]), 6)
    1.0
    """
    half = len(count) // 2
    x, y = (np.log(np.asarray(v, dtype=float)[-max(half, 2) :]) for v in (count, value))
    return float(np.polyfit(x, y, 1)[0]) if x.size > 1 else float("nan")
