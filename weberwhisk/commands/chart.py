"""`weberwhisk chart`: speed against accuracy of every method, measured on this machine."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from .._terminal import progress
from ..output import Run, to_json
from .options import command, wrote


@command
def chart(
    full: Annotated[bool, "Every setting and more data: some ten minutes."] = False,
    out: Path = Path("chart"),
    as_json: bool = False,
) -> None:
    """Chart error against CPU time: beams, posteriors, JND curves and fits, and how each grows.

    Takes about half a minute; with --full ten. Every method is swept over its own knob; time and
    error are of the same run. What needs other packages (PyElastica, dynesty, psignifit and so on)
    is added by analyses/speed_accuracy.py.
    """
    import pandas as pd

    from .. import charts, figures

    foot = charts.machine()
    tables = {}
    with Run(out, "chart", {"full": full, "machine": foot}) as run:
        with progress("Charting", len(charts.PARTS), as_json=as_json) as advance:
            for name, measure in charts.PARTS.items():
                tables[name] = measure(full=full)
                run.table(name, tables[name])
                advance()
        table = pd.concat(tables.values(), ignore_index=True)
        run.figure("speed_accuracy", figures.speed_accuracy(table, foot=foot))
        run.figure("fits_and_growth", figures.fits_and_growth(table, foot=foot))
    if as_json:
        print(to_json({"machine": foot, "rows": table.to_dict("records")}))
        return
    print(foot)
    for name, rows in tables.items():
        shown = rows.drop(columns="part").dropna(axis="columns", how="all")
        print(f"\n{name}\n{shown.to_string(index=False, float_format='{:.3g}'.format)}")
    wrote(run)
