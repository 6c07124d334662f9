"""This package and psignifit on the same data: time, bias, RMSE and coverage.

    pip install psignifit
    OMP_NUM_THREADS=1 python analyses/psignifit_side_by_side.py [--sets N] [folder]

Writes `psignifit_side_by_side.md` into this folder, or the one named. The observer compares two
magnitudes with Weber noise (k = 0.1), lapses by 0.02 at each end, and sees nine signed levels to
±0.30 of one standard. psignifit fits a cumulative normal against ln(comparison/standard) with
equal asymptotes; its width, over 1.645 √2 twice, is its Weber fraction. Times are CPU seconds.
"""

from __future__ import annotations

import warnings
from importlib.metadata import version

import numpy as np
from command import ANALYSES, options
from scipy.stats import norm

from weberwhisk.behaviour import Trials
from weberwhisk.charts import fits


def psignifit_answer(trials: Trials) -> fits.Answer:
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


def main() -> None:
    given = options(__file__, __doc__, folder=ANALYSES, sets=100)
    sets, folder = given.sets, given.folder
    tools = {"weberwhisk": fits.ours(), f"psignifit {version('psignifit')}": psignifit_answer}
    lines = [
        "# The same data fitted by weberwhisk and by psignifit",
        "",
        f"Made by `analyses/psignifit_side_by_side.py --sets {sets}`: {sets} data sets a row; "
        f"Weber fraction {fits.K:g}, lapses {fits.LAPSE:g} at each end, "
        "nine signed levels to ±0.30.",
        "",
        "| trials | tool | CPU ms a fit | median bias, % | RMSE, % | 95 % interval covers, % |",
        "|---|---|---|---|---|---|",
    ]
    for per_level in fits.SIZES:
        for name, answer in tools.items():
            row = fits.measure_tool(name, answer, per_level, sets)
            per_cent = {key: 100 * row[key] for key in ("bias", "error", "coverage")}
            lines.append(
                f"| {9 * per_level} | {name} | {1e3 * row['seconds']:.0f} | "
                f"{per_cent['bias']:+.1f} | {per_cent['error']:.1f} | {per_cent['coverage']:.1f} |"
            )
            print(lines[-1], flush=True)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "psignifit_side_by_side.md").write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
