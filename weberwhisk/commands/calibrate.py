"""`weberwhisk calibrate`: a whisker and its sensor by taps at known distances."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import weberwhisk as ww

from ..output import Run, to_json
from .options import (
    NO_SHAPE,
    ColumnOption,
    JsonOption,
    OutOption,
    SeedOption,
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
def calibrate(
    taps: Annotated[Path, typer.Argument(help="Table of taps: CSV, Parquet or Excel.")],
    shape: Shape = NO_SHAPE,
    column: ColumnOption = None,
    unit: UnitOption = None,
    counts: Annotated[
        bool, typer.Option("--counts", help="Slopes are counts a second: find the gain.")
    ] = False,
    clamped: Annotated[bool, typer.Option("--clamped", help="The base does not give way.")] = False,
    seed: SeedOption = 0,
    out: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """Calibrate a whisker and its sensor by taps at known distances.

    The table has radial_distance_mm and moment_rate, the slope of the signal in a tap, a row a tap.
    Found are stiffness (or gain), apex distance, the hinge of the base and the sensor's own Weber
    fraction, with posteriors; and how well a distance left out is found again.
    """
    options = as_asked(locals(), "seed", "out", "as_json")
    options["taps"] = str(taps)
    whisker = the_whisker(shape)
    with Run(out, "calibrate", options, seed) as run:
        with options_named(["columns", "units"]):
            found = ww.calibrate(
                taps,
                whisker,
                columns=pairs("--column", column, "moment_rate=slope"),
                units=pairs("--unit", unit, "moment_rate=uN m/s"),
                counts=counts,
                hinge=not clamped,
                seed=seed,
            )
        parameters = found.parameters.reset_index(names="parameter")
        run.table("parameters", parameters)
        run.table("residuals", found.residuals)
        run.table("left_out", found.left_out)
        if run.out_dir is not None:
            from .. import figures

            run.figure("calibration", figures.figure_of(figures.calibrated(found)))
    if as_json:
        print(to_json({
            "whisker": describe(found.whisker), "message": found.message,
            "parameters": parameters.to_dict("records"), "p_value": found.p_value,
            "left_out": found.left_out.to_dict("records"),
        }))  # fmt: skip
        return
    print(whisker_line(found.whisker))
    print(parameters.to_string(index=False, float_format="{:.4g}".format))
    print(found.left_out.to_string(index=False, float_format="{:.4g}".format))
    print(found.message)
    wrote(run)
