"""Weber's law in two dimensions (§3c): the whole family between the paper's two limits.

    python analyses/weber_2d.py [folder] [--short]

The paper took the JND of moment or of axial force to be the smaller by far. Here k_M, k_F and the
correlation ρ of the two are anything. Writes weber_2d (PNG, SVG): figure 4b with noise in the
moment alone, in both alike and in the axial force alone, and for the latter the false zero of the
linear JND beside posteriors; with the numbers in weber_2d_false_zero.csv, and in weber_2d_gain.csv
how noise that is a common gain (k_F = 2k_M, ρ → 1) cancels.
"""

from __future__ import annotations

from pathlib import Path

import pandas as pd
from command import options

from weberwhisk.commands import figure
from weberwhisk.output import Run
from weberwhisk.surveys import SEED, K


def make(folder: Path, *, short: bool = False) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Tables and figure into `folder`."""
    with Run(folder, "weber_2d", {"weber_fraction": K, "short": short}, SEED) as run:
        made = figure.weber_2d(figure.Asked(short=short))
        zero, common = made.tables.values()
        run.table("weber_2d_false_zero", zero)
        run.table("weber_2d_gain", common)
        run.figure("weber_2d", made.chart)
    return zero, common


if __name__ == "__main__":
    given = options(__file__, __doc__, short="few posteriors, seconds")
    for found in make(given.folder, short=given.short):
        print(found.to_string(index=False, float_format="{:.3g}".format), end="\n\n")
    print(f"Written to {given.folder}.")
