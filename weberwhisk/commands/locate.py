"""`weberwhisk locate`: radial distances of a table of measured contacts."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import weberwhisk as ww

from .. import _checks
from .._terminal import numbers, progress
from ..output import Run, to_json
from .options import (
    NO_SHAPE,
    ColumnOption,
    JsonOption,
    OutOption,
    Shape,
    UnitOption,
    as_asked,
    describe,
    options_named,
    pairs,
    takes_whisker,
    the_whisker,
    whisker_line,
    wrote,
)


@takes_whisker
def locate(
    contacts: Annotated[Path, typer.Argument(help="Table of contacts: CSV, Parquet or Excel.")],
    shape: Shape = NO_SHAPE,
    column: ColumnOption = None,
    unit: UnitOption = None,
    touch: Annotated[
        str | None, typer.Option("--touch", metavar="COLUMN", help="Column that numbers touches.")
    ] = None,
    time: Annotated[
        str | None, typer.Option("--time", metavar="COLUMN", help="Column that figures go by.")
    ] = None,
    weber_fraction: Annotated[
        list[str] | None,
        typer.Option(
            "--weber-fraction", help="Noise of the numbers.  [default: their sds, or 0.1]"
        ),
    ] = None,
    out: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """Say how far away each contact of a table of forces is.

    Columns are called moment, axial_force, transverse_force, deflection_angle, moment_rate,
    angular_velocity, with the unit behind (moment_uNm), or as --column says. The stiffness is
    unknown unless --youngs-modulus-gpa is given.
    """
    import pandas as pd

    options = as_asked(locals(), "out", "as_json", "pd")
    options["contacts"] = str(contacts)
    whisker = the_whisker(shape)
    noise = None
    if weber_fraction is not None:
        k = _checks.positive(
            "--weber-fraction", numbers("--weber-fraction", weber_fraction), "write 0.1, say"
        )
        noise = ww.receptors.Weber(k if k.size > 1 else float(k[0]))
    with Run(out, "locate", options) as run, progress("Rows", 1.0, as_json=as_json) as advance:
        shown = [0.0]

        def step(done: int, total: int) -> None:
            advance(done / total - shown[0])
            shown[0] = done / total

        with options_named(["columns", "units", "touch", "noise"]):
            table = ww.locate(
                contacts, whisker, columns=pairs("--column", column, "moment=M_uNm"),
                units=pairs("--unit", unit, "moment=mN m"), touch=touch, noise=noise, progress=step,
            )  # fmt: skip
        if time is not None and not (
            time in table.columns and pd.api.types.is_numeric_dtype(table[time])
        ):
            raise ValueError(f"--time needs a column of numbers, got {time!r}; name another.")
        run.table("located", table)
        if touch is not None:
            own = table[table["touch_status"] != "no_touch"]
            names = [touch, *(c for c in table.columns if c.startswith("touch_") and c != touch)]
            run.table("touches", own[names].drop_duplicates(touch))
        if run.out_dir is not None:
            from .. import figures

            axes = figures.located(table, against=time, by=touch or "")
            run.figure("located", figures.figure_of(axes))
    notes = table.attrs["notes"]
    if as_json:
        rows = table.to_dict("records")
        print(to_json({"whisker": describe(whisker), "notes": notes, "rows": rows}))
        return
    print(whisker_line(whisker))
    few = table if len(table) <= 20 else table.head(20)
    print(few.drop(columns="message").to_string(float_format="{:.6g}".format, na_rep="-"))
    if len(few) < len(table):
        print(f"… and {len(table) - len(few)} more rows.")
    counts = table["message"].value_counts()
    for message, count in counts.items():
        print(f"{count} of {len(table)} rows: {message}.")
    for note in notes:
        print(note)
    wrote(run)
