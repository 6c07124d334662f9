"""`weberwhisk locate` and `calibrate`: measured contacts, and the sensor that measures them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import weberwhisk as ww

from ..cli import numbers, progress
from ..output import Run, to_json
from . import options as opt

_VIDEO, _SENSOR = {"rich_help_panel": "Tracked video"}, {"rich_help_panel": "Sensor"}
#: Files of trackers, by their ends.
TRACKERS = (".whiskers", ".measurements", ".hdf5", ".h5", ".nwb", ".slp")


@opt.command
def locate(
    contacts: Annotated[Path, "Table of contacts (CSV, Parquet, Excel), or a tracker's file."],
    shape: opt.Shape = opt.NO_SHAPE,
    column: opt.Texts = None,
    unit: opt.Texts = None,
    touch: Annotated[opt.Text, "Column that numbers touches.", {"metavar": "COLUMN"}] = None,
    time: Annotated[opt.Text, "Column that figures go by.", {"metavar": "COLUMN"}] = None,
    weber_fraction: Annotated[
        opt.Texts, "Noise of the numbers.  [default: their sds, or 0.1]"
    ] = None,
    taps: Annotated[
        Path | None, "Table of taps at known distances, to calibrate by.", _SENSOR
    ] = None,
    counts: Annotated[bool, "Slopes are counts a second.", _SENSOR] = False,
    clamped: Annotated[bool, "The base does not give way.", _SENSOR] = False,
    pixels_per_mm: Annotated[opt.Number, "Its scale.", _VIDEO] = None,
    frame_rate: Annotated[opt.Number, "A second.", _VIDEO] = None,
    label: Annotated[int | None, "Which of several tracked whiskers.", _VIDEO] = None,
    shortest_px: Annotated[float, "Shorter ones are fur.", _VIDEO] = 0.0,
    face: Annotated[opt.Text, "Where the face is: left, right, top or bottom.", _VIDEO] = None,
    pole_px: Annotated[opt.Texts, "The pole: x, y.", _VIDEO] = None,
    out: Path | None = None,
    as_json: bool = False,
) -> None:
    """Say how far away each contact of a table or a tracked video is.

    Columns are called moment, axial_force, transverse_force, deflection_angle, moment_rate,
    angular_velocity, with the unit behind (moment_uNm), or as --column says. The stiffness is
    unknown unless --youngs-modulus-gpa is given. Of a tracker's file (.whiskers, .hdf5, .nwb, or
    with --pixels-per-mm a table of points) the forces follow from the shape of the whisker. With
    --taps, a table as of `weberwhisk calibrate`, slopes of a sensor are located by what they tell.
    """
    options = opt.as_asked(locals())
    import pandas as pd

    table_or_path: Any = contacts
    whisker = opt.the_whisker(shape)
    heard: tuple[str, ...] = ()
    noise = None if weber_fraction is None else opt.the_noise(weber_fraction)
    with Run(out, "locate", options) as run, progress("Rows", 1.0, as_json=as_json) as advance:
        shown = [0.0]

        def step(done: int, total: int) -> None:
            advance(done / total - shown[0])
            shown[0] = done / total

        if pixels_per_mm is not None or contacts.suffix.lower() in TRACKERS:
            with opt.options_named(
                ["pixels_per_mm", "frame_rate", "identity", "pole", "shortest_px", "face"]
            ):
                video = ww.read_tracking(contacts, shortest_px=shortest_px, face=face)
                pole = numbers("--pole-px", pole_px) if pole_px else None
                signals = ww.tracked_signals(
                    video, whisker, pixels_per_mm=pixels_per_mm, frame_rate=frame_rate,
                    identity=label, pole=pole,
                )  # fmt: skip
            heard = (*video.attrs["notes"], *signals.attrs["notes"])
            table_or_path = signals
        with opt.options_named(["columns", "units", "touch", "noise"]):
            mapped = opt.pairs("--column", column, "moment=M_uNm")
            units = opt.pairs("--unit", unit, "moment=mN m")
            by: Any = whisker
            if taps is not None:
                by = ww.calibrate(
                    taps, whisker, columns=mapped, units=units, counts=counts, hinge=not clamped
                )
                heard = (*heard, by.message)
            elif counts or clamped:
                raise ValueError(
                    "--counts and --clamped say how taps are read, got no --taps; write "
                    "--taps taps.csv, or leave them out."
                )
            table = ww.locate(
                table_or_path, by, columns=mapped, units=units, touch=touch, noise=noise,
                known_stiffness=shape.youngs_modulus_gpa is not None, progress=step,
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
            run.figure("located", ww.figures.located(table, against=time, by=touch or ""))
            if touch is not None:
                run.figure("touches", ww.figures.located(table, against=touch, by=touch))
    if taps is not None:
        whisker = by.whisker
    notes = (*heard, *table.attrs["notes"])
    if as_json:
        rows = table.to_dict("records")
        print(to_json({"whisker": opt.describe(whisker), "notes": notes, "rows": rows}))
        return
    print(opt.whisker_line(whisker))
    few = table if len(table) <= 20 else table.head(20)
    print(few.drop(columns="message").to_string(float_format="{:.6g}".format, na_rep="-"))
    if len(few) < len(table):
        print(f"… and {len(table) - len(few)} more rows.")
    for message, count in table["message"].value_counts().items():
        print(f"{count} of {len(table)} rows: {message}.")
    for note in notes:
        print(note)
    opt.wrote(run)


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
            run.figure("calibration", ww.figures.calibrated(found))
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
