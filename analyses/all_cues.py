"""Every cue on one whisker: which tells distance best where, what each adds, where it fails.

    python analyses/all_cues.py [folder] [--short]

Writes, with k = 0.1 for every signal of size: all_cues_jnd (the JND of each cue against r, on one
axis, and below it the posterior's JND over the closed form's, with its Monte Carlo error),
all_cues_outcomes (what each cue's method makes of readings: no touch, tip not touched, lines that
do not meet, flicked past, modes that are not resolved), all_cues_best (the best cue at every
contact, and where it is flicked past), all_cues_ridge (the posterior of one reading on a tapered
whisker and on a cylinder), all_cues_bits (what each cue tells alone and adds to the others) as PNG
and SVG, and their tables as CSV.
"""

from __future__ import annotations

from pathlib import Path

import pandas as pd
from command import options

from weberwhisk.commands import figure
from weberwhisk.output import Run
from weberwhisk.surveys import SEED, K

#: The charts, and the names of their files.
CHARTS = {
    "jnd": figure.cues,
    "outcomes": figure.outcomes,
    "best": figure.best_cue,
    "ridge": figure.ridge,
    "bits": figure.information,
}


def make(folder: Path, *, short: bool = False) -> dict[str, pd.DataFrame]:
    """Tables and figures into `folder`."""
    tables = {}
    with Run(folder, "all_cues", {"weber_fraction": K, "short": short}, SEED) as run:
        for name, chart in CHARTS.items():
            made = chart(figure.Asked(short=short))
            (tables[name],) = made.tables.values()
            run.table(f"all_cues_{name}", tables[name])
            run.figure(f"all_cues_{name}", made.chart)
    return tables


if __name__ == "__main__":
    given = options(__file__, __doc__, short="few posteriors, seconds")
    tables = make(given.folder, short=given.short)
    print(tables["bits"].to_string(index=False, float_format="{:.2f}".format))
    print(tables["best"]["best"].value_counts(normalize=True).to_string())
    print(f"Written to {given.folder}.")
