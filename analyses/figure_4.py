"""Remake the paper's figures 4a and 4b for a whisker of radius ratio 20.

    python analyses/figure_4.py [folder] [--short]

Writes figure_4a and figure_4b (CSV, PNG, SVG) and figure_4b_check.csv, which holds the surface
against values that were derived apart from this package; it ends with status 1 where they differ.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import pandas as pd

import weberwhisk as ww
from weberwhisk import figures
from weberwhisk.commands.jnd import in_millimetres, jnd_table, lines_and_points
from weberwhisk.commands.quickstart import moment_dominated, surface_in_degrees, surface_table
from weberwhisk.jnd import weber_propagation
from weberwhisk.runs import Run

WHISKER = ww.Whisker(length=50e-3, base_radius=100e-6, tip_radius=5e-6, youngs_modulus=3e9)
WEBER_FRACTION = 0.1
SEED = 20110166
#: Posteriors at each distance of figure 4a.
DRAWS, DRAWS_SHORT = 400, 16

#: Moment-dominated JND/(kL) by r/L, at these deflections; NaN: past the fold.
DEGREES = (1.0, 5.0, 10.0, 20.0)
EXPECTED = {
    0.3: (1.066, 1.053, 1.011, 0.854),
    0.5: (0.742, 0.727, 0.682, 0.511),
    0.7: (0.440, 0.422, 0.367, 0.161),
    0.9: (0.171, 0.140, 0.036, np.nan),
}


def figure_4a(run: Run, draws: int) -> pd.DataFrame:
    """Compliance cue, tapered and cylindrical: closed forms, and emcee's posteriors as points."""
    r = np.linspace(0.05, 0.95, 10) * WHISKER.length
    none = np.array([])
    tables, shown = [], {}
    for name, whisker in (("tapered", WHISKER), ("cylinder", WHISKER.cylinder())):
        observer = ww.Observer(whisker, ww.cues.Compliance(), ww.receptors.Weber(WEBER_FRACTION))
        table = jnd_table(observer, r, none, "emcee", "d'=1", draws, SEED, False, name)
        written = in_millimetres(table)
        written.insert(0, "whisker", name)
        tables.append(written)
        shown[name] = lines_and_points(observer, table, none, "d'=1")[""]
    joined = pd.concat(tables, ignore_index=True)
    run.table("figure_4a", joined)
    drawn = figures.jnd_curve(shown, length=WHISKER.length, weber_fraction=WEBER_FRACTION)
    run.figure("figure_4a", figures.figure_of(drawn))
    return joined


def figure_4b(run: Run) -> pd.DataFrame:
    """Force map with noise in the moment alone; returns the surface beside what is expected."""
    table = surface_table(WHISKER, WEBER_FRACTION)
    run.table("figure_4b", surface_in_degrees(table))
    drawn = figures.jnd_surface(table, length=WHISKER.length, weber_fraction=WEBER_FRACTION)
    run.figure("figure_4b", figures.figure_of(drawn))
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
    jnd = weber_propagation(moment_dominated(WHISKER, WEBER_FRACTION), contact)
    return pd.DataFrame(
        {
            "r_over_length": place,
            "deflection_angle_deg": angle,
            "expected": expected,
            "found": jnd / (WEBER_FRACTION * WHISKER.length),
        }
    )


def agrees(checked: pd.DataFrame) -> bool:
    """Whether every value is the expected one to its last digit."""
    return bool(np.allclose(checked["found"], checked["expected"], atol=6e-4, equal_nan=True))


def make(folder: Path, *, short: bool = False) -> pd.DataFrame:
    """Both figures into `folder`; returns the check of figure 4b."""
    draws = DRAWS_SHORT if short else DRAWS
    inputs = {"radius_ratio": WHISKER.radius_ratio, "weber_fraction": WEBER_FRACTION}
    with Run(folder, "figure_4", inputs | {"draws": draws}, SEED) as run:
        figure_4a(run, draws)
        return figure_4b(run)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    default = Path(__file__).parent.parent / "results" / "figure_4"
    parser.add_argument("folder", type=Path, nargs="?", default=default)
    parser.add_argument("--short", action="store_true", help="few posteriors, seconds")
    given = parser.parse_args()
    result = make(given.folder, short=given.short)
    print(result.round(4).to_string(index=False))
    print(f"Written to {given.folder}.")
    raise SystemExit(0 if agrees(result) else "Figure 4b differs from what is expected.")
