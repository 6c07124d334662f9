"""This package and psignifit on the same data: time, bias, RMSE and coverage.

    pip install psignifit
    OMP_NUM_THREADS=1 python analyses/psignifit_side_by_side.py [data sets] [folder]

Writes `psignifit_side_by_side.md` into this folder, or the one named. The observer compares two
magnitudes with Weber noise (k = 0.1), lapses by 0.02 at each end, and sees nine signed levels to
±0.30 of one standard. psignifit fits a cumulative normal against ln(comparison/standard) with
equal asymptotes; its width, over 1.645 √2 twice, is its Weber fraction. Times are CPU seconds.
"""

from __future__ import annotations

import sys
import time
import warnings
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path

import numpy as np
from scipy.stats import norm

from weberwhisk.behaviour import Trials, fit_weber, simulate_trials

K, LAPSE = 0.1, 0.02
Answer = tuple[float, float, float]


def ours(trials: Trials) -> Answer:
    """Median and 95 % interval."""
    fit = fit_weber(trials)
    return fit.weber_fraction, *fit.interval()


def psignifit_answer(trials: Trials) -> Answer:
    """psignifit's estimate and 95 % interval of the width, as a Weber fraction."""
    import psignifit

    c = trials.cells()
    table = np.column_stack([np.log(c.stimulus_2 / c.stimulus_1), c.count, c.n])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = psignifit.psignifit(table, experiment_type="equal asymptote")
    low, high = found.confidence_intervals["width"]["0.95"]
    # From 5 to 95 %, in sds of the difference of two signals; ln(I2/I1) has an sd of √2 k.
    per_width = 1 / (2 * norm.ppf(0.95) * np.sqrt(2))
    return tuple(per_width * float(v) for v in (found.parameter_estimate["width"], low, high))  # type: ignore[return-value]


def measure(answer: Callable[[Trials], Answer], per_level: int, sets: int) -> list[float]:
    """CPU milliseconds (median), median bias, RMSE and coverage in per cent."""
    times, errors, inside = [], [], 0
    for seed in range(sets):
        trials = simulate_trials(
            weber_fraction=K, lapse_low=LAPSE, lapse_high=LAPSE, trials_per_level=per_level,
            seed=400_000 + 1000 * per_level + seed,
        )  # fmt: skip
        start = time.process_time()
        middle, low, high = answer(trials)
        times.append(time.process_time() - start)
        errors.append(middle / K - 1)
        inside += low < K < high
    e = np.array(errors)
    return [
        1e3 * float(np.median(times)),
        100 * float(np.median(e)),
        100 * float(np.sqrt(np.mean(e**2))),
        100 * inside / sets,
    ]


def main() -> None:
    sets = int(sys.argv[1]) if len(sys.argv) > 1 else 100
    folder = Path(sys.argv[2]) if len(sys.argv) > 2 else Path(__file__).parent
    tools = {"weberwhisk": ours, f"psignifit {version('psignifit')}": psignifit_answer}
    lines = [
        "# The same data fitted by weberwhisk and by psignifit",
        "",
        f"Made by `analyses/psignifit_side_by_side.py {sets}`: {sets} data sets a row; Weber "
        f"fraction {K:g}, lapses {LAPSE:g} at each end, nine signed levels to ±0.30.",
        "",
        "| trials | tool | CPU ms a fit | median bias, % | RMSE, % | 95 % interval covers, % |",
        "|---|---|---|---|---|---|",
    ]
    for per_level in (13, 33, 111):
        for name, answer in tools.items():
            ms, bias, rmse, covers = measure(answer, per_level, sets)
            lines.append(
                f"| {9 * per_level} | {name} | {ms:.0f} | {bias:+.1f} | {rmse:.1f} | {covers:.1f} |"
            )
            print(lines[-1], flush=True)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "psignifit_side_by_side.md").write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
