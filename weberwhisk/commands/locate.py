"""`weberwhisk locate`: radial distances of a table of measured contacts."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

import weberwhisk as ww

from .. import _checks
from .._terminal import a_number, numbers, progress
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

VIDEO, SENSOR = "Tracked video", "Sensor"
#: Files of trackers, by their ends.
TRACKERS = (".whiskers", ".measurements", ".hdf5", ".h5", ".nwb", ".slp")


@takes_whisker
def locate(
    contacts: Annotated[
        Path,
        typer.Argument(help="Table of contacts (CSV, Parquet, Excel), or a tracker's file."),
    ],
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
    taps: Annotated[
        Path | None,
        typer.Option(
            rich_help_panel=SENSOR, help="Table of taps at known distances, to calibrate by."
        ),
    ] = None,
    counts: Annotated[
        bool, typer.Option("--counts", rich_help_panel=SENSOR, help="Slopes are counts a second.")
    ] = False,
    clamped: Annotated[
        bool, typer.Option("--clamped", rich_help_panel=SENSOR, help="The base does not give way.")
    ] = False,
    pixels_per_mm: Annotated[
        float | None,
        typer.Option(parser=a_number, metavar="NUMBER", rich_help_panel=VIDEO, help="Its scale."),
    ] = None,
    frame_rate: Annotated[
        float | None,
        typer.Option(parser=a_number, metavar="NUMBER", rich_help_panel=VIDEO, help="A second."),
    ] = None,
    label: Annotated[
        int | None,
        typer.Option("--label", rich_help_panel=VIDEO, help="Which of several tracked whiskers."),
    ] = None,
    shortest_px: Annotated[
        float,
        typer.Option(
            parser=a_number, metavar="NUMBER", rich_help_panel=VIDEO, help="Shorter ones are fur."
        ),
    ] = 0.0,
    face: Annotated[
        str | None,
        typer.Option(rich_help_panel=VIDEO, help="Where the face is: left, right, top or bottom."),
    ] = None,
    pole_px: Annotated[
        list[str] | None,
        typer.Option("--pole-px", metavar="LIST", rich_help_panel=VIDEO, help="The pole: x, y."),
    ] = None,
    out: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """Say how far away each contact of a table or a tracked video is.

    Columns are called moment, axial_force, transverse_force, deflection_angle, moment_rate,
    angular_velocity, with the unit behind (moment_uNm), or as --column says. The stiffness is
    unknown unless --youngs-modulus-gpa is given. Of a tracker's file (.whiskers, .hdf5, .nwb, or
    with --pixels-per-mm a table of points) the forces follow from the shape of the whisker. With
    --taps, a table as of `weberwhisk calibrate`, slopes of a sensor are located by what they tell.
    """
    import pandas as pd

    options = as_asked(locals(), "out", "as_json", "pd")
    table_or_path: Any = contacts
    options["contacts"] = str(contacts)
    options["taps"] = None if taps is None else str(taps)
    whisker, noise = the_whisker(shape), None
    heard: tuple[str, ...] = ()
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

        if pixels_per_mm is not None or contacts.suffix.lower() in TRACKERS:
            with options_named(
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
        with options_named(["columns", "units", "touch", "noise"]):
            mapped = pairs("--column", column, "moment=M_uNm")
            units = pairs("--unit", unit, "moment=mN m")
            by: Any = whisker
            if taps is not None:
                by = ww.calibrate(
                    taps, whisker, columns=mapped, units=units, counts=counts, hinge=not clamped
                )
                heard = (by.message,)
            table = ww.locate(
                table_or_path, by, columns=mapped, units=units, touch=touch, noise=noise,
                progress=step,
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
            if touch is not None:
                axes = figures.located(table, against=touch, by=touch)
                run.figure("touches", figures.figure_of(axes))
    notes = (*heard, *table.attrs["notes"])
    if as_json:
        rows = table.to_dict("records")
        print(to_json({"whisker": describe(whisker), "notes": notes, "rows": rows}))
        return
    print(whisker_line(whisker))
    few = table if len(table) <= 20 else table.head(20)
    print(few.drop(columns="message").to_string(float_format="{:.6g}".format, na_rep="-"))
    if len(few) < len(table):
        print(f"… and {len(table) - len(few)} more rows.")
    for message, count in table["message"].value_counts().items():
        print(f"{count} of {len(table)} rows: {message}.")
    for note in notes:
        print(note)
    wrote(run)
