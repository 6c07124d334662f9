"""How many trials it takes to tell a taper from a cylinder.

    python analyses/design.py [folder] [--short]

Writes design_power (the share of experiments whose Bayes factor passes 10, and the interval of k in
90 % of them, against trials) as PNG and SVG, with its table as CSV.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from command import options
from matplotlib.figure import Figure

import weberwhisk as ww
from weberwhisk import plots
from weberwhisk._util.output import Run
from weberwhisk.design import Power, Scheme, SubjectPopulation, taper

WHISKER = ww.Whisker(length=50e-3, base_radius=100e-6, tip_radius=5e-6, youngs_modulus=3e9)
LEVELS = (-2.0, -1.2, -0.6, 0.6, 1.2, 2.0)  # sds of the expected difference
PLACES = np.array([0.3, 0.6, 0.9]) * WHISKER.length
#: One animal with k = 0.1 and lapses of 3 % a side.
ANIMAL = SubjectPopulation(0.1, spread=0.0, lapse=0.03, bias_spread=0.0, lapses_vary=False)
TRIALS = [3, 5, 10, 20, 40]
SEED = 20110166


def grow(runs: int) -> Power:
    """Power against trials, whichever is true."""
    hypotheses = taper(WHISKER)
    scheme = Scheme.spaced(hypotheses[0].encoding, PLACES, levels=LEVELS)
    return ww.power(scheme, hypotheses, trials=TRIALS, expected=ANIMAL, runs=runs, seed=SEED)


@plots.styled
def draw_power(found: Power) -> Figure:
    figure = plots.new_figure(plots.DOUBLE, 2.8)
    left, right = figure.subplots(1, 2)
    plots.power_curve(found, left)
    for i, (truth, own) in enumerate(found.table.groupby("truth", sort=False)):
        middle = own["half_width"].to_numpy(float)
        right.errorbar(
            own["trials"] * 1.03 ** (2 * i - 1),
            100 * middle,
            100 * np.array([middle - own["half_width_5"], own["half_width_95"] - middle]),
            color=plots.COLOURS[i], marker=plots.MARKERS[i], linestyle=plots.LINES[i],
            elinewidth=1, label=f"{truth}: median, 90 % of runs",
        )  # fmt: skip
    right.axhline(20, color="0.6", linewidth=0.8, linestyle=":", label="± 20 %")
    right.set(xscale="log", yscale="log", xlabel="Trials of each comparison",
              ylabel="95 % interval of k (± %)")  # fmt: skip
    right.set_xticks(TRIALS, [str(n) for n in TRIALS])
    right.set_yticks([10, 20, 50, 100, 200], ["10", "20", "50", "100", "200"])
    right.minorticks_off()
    right.legend(loc="upper right")
    return figure


def make(folder: Path, *, short: bool = False) -> dict[str, pd.DataFrame]:
    """Table and figure into `folder`."""
    runs = 16 if short else 2000
    with Run(folder, "design", {"weber_fraction": 0.1, "runs": runs}, SEED) as run:
        found = grow(runs)
        run.table("design_power", found.table)
        run.figure("design_power", draw_power(found))
    return {"power": found.table}


if __name__ == "__main__":
    given = options(__file__, __doc__, short="few runs, seconds")
    made = make(given.folder, short=given.short)
    print(made["power"][["truth", "trials", "power", "lower", "upper", "half_width"]].to_string())
    print(f"Written to {given.folder}.")
