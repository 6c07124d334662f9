"""Every figure of Solomon & Hartmann (2011), and every claim with what we find.

    python analyses/paper/make.py [folder] [--short]

Writes figures 1d, 2a-f, 3a-c, 4a and 4b with their tables, and paper.md: each equation and claim,
the numbers found now, the test that shows it, and where the sentence ends.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import pandas as pd

sys.path.insert(0, str(Path(__file__).parent.parent))

from command import options
from gallery.make import Asked, figure_4a, figure_4b
from gallery.surveys import SEED
from paper import claims, plots, remade

from weberwhisk._util.output import Run, atomic_write
from weberwhisk.cues import MuscleCurve


def figures(short: bool) -> dict[str, tuple[dict[str, pd.DataFrame], Any]]:
    """The tables and the chart of each figure."""
    rates, degrees = remade.moment_rates(), remade.DEGREES[:: 3 if short else 1]
    table = remade.contacts(remade.ARCS, degrees)
    step = slice(None, None, 5 if short else 1)
    a, b = remade.moments(), remade.balance_angles()
    c = remade.surface(MuscleCurve.NORMALISED, remade.DISTANCES[step], remade.IMPACTS[step])
    line, angle = remade.dashed_line()
    third = plots.paper_3(a, remade.muscle(), b, c, (line[step], angle[step]))
    return {
        "figure-1d": ({"figure-1d": rates}, plots.paper_1d(rates)),
        "figure-2": (
            {"figure-2": table},
            plots.paper_2(remade.examples(), remade.lines(), table),
        ),
        "figure-3": ({"figure-3a": a, "figure-3b": b, "figure-3c": c}, third),
        "figure-4a": figure_4a(Asked(short)),
        "figure-4b": figure_4b(Asked(short)),
    }


def make(folder: Path, *, short: bool = False) -> list[dict[str, str]]:
    """Figures, tables and paper.md into `folder`; returns the claims with what is found."""
    with Run(folder, "paper", {"short": short}, SEED) as run:
        for name, (tables, chart) in figures(short).items():
            for key, each in tables.items():
                run.table(key, each)
            run.figure(name, chart)
        rows = list(claims.rows())
        atomic_write(run.path("paper.md"), claims.as_markdown(rows))
    return rows


if __name__ == "__main__":
    given = options(__file__, __doc__, folder="paper", short="few posteriors, seconds")
    for row in make(given.folder, short=given.short):
        print(f"{row['where']}: {row['claim']}: {row['found']}")
    print(f"Written to {given.folder}.")
