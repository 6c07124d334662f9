"""Remake the paper's figures 4a and 4b for a whisker of radius ratio 20.

    python analyses/figure_4.py [folder] [--short]

Writes figure_4a and figure_4b (CSV, PNG, SVG) and figure_4b_check.csv, which holds the surface
against values that were derived apart from this package; it ends with status 1 where they differ.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from command import options

from weberwhisk.commands import figure
from weberwhisk.commands.quickstart import moment_dominated
from weberwhisk.jnd import weber_propagation
from weberwhisk.output import Run
from weberwhisk.surveys import SEED, WHISKER, K

#: Moment-dominated JND/(kL) by r/L, at these deflections; NaN: past the fold.
DEGREES = (1.0, 5.0, 10.0, 20.0)
EXPECTED = {
    0.3: (1.066, 1.053, 1.011, 0.854),
    0.5: (0.742, 0.727, 0.682, 0.511),
    0.7: (0.440, 0.422, 0.367, 0.161),
    0.9: (0.171, 0.140, 0.036, np.nan),
}


def figure_4a(run: Run, short: bool) -> None:
    """Compliance cue, tapered and cylindrical: closed forms, and emcee's posteriors as points."""
    made = figure.figure_4a(figure.Asked(short=short))
    run.table("figure_4a", made.tables["figure-4a"])
    run.figure("figure_4a", made.chart)


def figure_4b(run: Run) -> pd.DataFrame:
    """Force map with noise in the moment alone; returns the surface beside what is expected."""
    made = figure.figure_4b(figure.Asked(short=True))
    run.table("figure_4b", made.tables["figure-4b"])
    run.figure("figure_4b", made.chart)
    checked = check()
    run.table("figure_4b_check", checked)
    return checked


def check() -> pd.DataFrame:
    """JND/(kL) found and expected, a row for each contact."""
    rows = [
        (place, angle, value)
        for place, values in EXPECTED.items()
        for angle, value in zip(DEGREES, values, strict=True)
    ]
    place, angle, expected = np.array(rows).T
    contact = np.stack([place * WHISKER.length, np.radians(angle)], axis=-1)
    jnd = weber_propagation(moment_dominated(WHISKER, K), contact)
    return pd.DataFrame(
        {
            "r_over_length": place,
            "deflection_angle_deg": angle,
            "expected": expected,
            "found": jnd / (K * WHISKER.length),
        }
    )


def agrees(checked: pd.DataFrame) -> bool:
    """Whether every value is the expected one to its last digit."""
    return bool(np.allclose(checked["found"], checked["expected"], atol=6e-4, equal_nan=True))


def make(folder: Path, *, short: bool = False) -> pd.DataFrame:
    """Both figures into `folder`; returns the check of figure 4b."""
    inputs = {"radius_ratio": WHISKER.radius_ratio, "weber_fraction": K, "short": short}
    with Run(folder, "figure_4", inputs, SEED) as run:
        figure_4a(run, short)
        return figure_4b(run)


if __name__ == "__main__":
    given = options(__file__, __doc__, short="few posteriors, seconds")
    result = make(given.folder, short=given.short)
    print(result.round(4).to_string(index=False))
    print(f"Written to {given.folder}.")
    raise SystemExit(0 if agrees(result) else "Figure 4b differs from what is expected.")
