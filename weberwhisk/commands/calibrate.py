"""`weberwhisk calibrate`: a whisker and its sensor by taps at known distances."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import weberwhisk as ww

from ..output import Run, to_json
from . import options as opt


@opt.command
def calibrate(
    taps: Annotated[Path, "Table of taps: CSV, Parquet or Excel."],
    shape: opt.Shape = opt.NO_SHAPE,
    column: opt.Texts = None,
    unit: opt.Texts = None,
    counts: Annotated[bool, "Slopes are counts a second: find the gain."] = False,
    clamped: Annotated[bool, "The base does not give way."] = False,
    seed: int = 0,
    out: Path | None = None,
    as_json: bool = False,
) -> None:
    """Calibrate a whisker and its sensor by taps at known distances.

    The table has radial_distance_mm and moment_rate, the slope of the signal in a tap, a row a tap.
    Found are stiffness (or gain), apex distance, the hinge of the base and the sensor's own Weber
    fraction, with posteriors; and how well a distance left out is found again.
    """
    options = opt.as_asked(locals())
    whisker = opt.the_whisker(shape)
    with Run(out, "calibrate", options, seed) as run:
        with opt.options_named(["columns", "units"]):
            found = ww.calibrate(
                taps,
                whisker,
                columns=opt.pairs("--column", column, "moment_rate=slope"),
                units=opt.pairs("--unit", unit, "moment_rate=uN m/s"),
                counts=counts,
                hinge=not clamped,
                seed=seed,
            )
        parameters = found.parameters.reset_index(names="parameter")
        run.table("parameters", parameters)
        run.table("residuals", found.residuals)
        run.table("left_out", found.left_out)
        if run.out_dir is not None:
            opt.draw(run, "calibration", ww.figures.calibrated(found))
    if as_json:
        print(to_json({
            "whisker": opt.describe(found.whisker), "message": found.message,
            "parameters": parameters.to_dict("records"), "p_value": found.p_value,
            "left_out": found.left_out.to_dict("records"),
        }))  # fmt: skip
        return
    print(opt.whisker_line(found.whisker))
    print(parameters.to_string(index=False, float_format="{:.4g}".format))
    print(found.left_out.to_string(index=False, float_format="{:.4g}".format))
    print(found.message)
    opt.wrote(run)
