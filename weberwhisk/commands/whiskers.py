"""`weberwhisk bend`, `jnd`, `locate`, `calibrate`: signals of contacts, and the inverse."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import numpy as np

import weberwhisk as ww

from .. import commands as opt
from .._util import checks
from .._util.output import Run
from .._util.refusals import Refusal
from .._util.values import Array, counted, pd
from . import a_seed, numbers, progress

__all__ = ["bend", "calibrate", "curve_in_steps", "jnd", "locate"]


@opt.command
def bend(
    shape: opt.Shape = opt.NO_SHAPE,
    radial_distance_mm: opt.Texts = None,
    deflection_angle_deg: Annotated[opt.Texts, "Its angle to the base."] = None,
    arc_length_mm: Annotated[opt.Texts, "Arc length to the contact."] = None,
    force_micronewton: Annotated[opt.Texts, "Contact force."] = None,
    model: Annotated[opt.Text, "Force a model.  [default: the cheapest that will do]"] = None,
    seed: Annotated[
        int | None,
        "Draw the whisker from the spread of its identity.",
        {"parser": a_seed, "metavar": "NUMBER"},
    ] = None,
    out: Path | None = None,
    as_json: bool = False,
) -> None:
    """Bend a whisker against a point: the forces and moment at its base.

    Say where the contact is (--radial-distance-mm and --deflection-angle-deg), or how hard it
    pushes (--arc-length-mm and --force-micronewton); lists are combined, each with each. A contact
    that cannot be held is part of the answer: its row says what becomes of it.
    """
    options = opt.as_asked(locals())
    whisker = opt.the_whisker(shape, seed)
    pairs = {
        ("radial_distance_mm", "deflection_angle_deg"): (radial_distance_mm, deflection_angle_deg),
        ("arc_length_mm", "force_micronewton"): (arc_length_mm, force_micronewton),
    }
    named = [names for names, lists in pairs.items() if any(lists)]
    if len(named) != 1 or not all(pairs[named[0]]):
        got = " and ".join(opt.option(n) for names in pairs for n in names if options[n])
        raise Refusal(
            "A contact is --radial-distance-mm and --deflection-angle-deg, or --arc-length-mm "
            "and --force-micronewton",
            got or "none of them",
            "write both of one pair",
        )
    names = named[0]
    where, much = (
        numbers(opt.option(n), texts or []) for n, texts in zip(names, pairs[names], strict=True)
    )
    checks.positive(opt.option(names[0]), where, "give millimetres, such as 35")
    checks.finite(opt.option(names[1]), much, "give a number, such as 20")
    where, much = (grid.ravel() for grid in np.meshgrid(where, much, indexing="ij"))
    of = {  # column: attribute of `Bending`, and its unit in SI
        "arc_length_mm": ("arc_length", 1e-3), "force_micronewton": ("force", 1e-6),
        "radial_distance_mm": ("radial_distance", 1e-3),
        "deflection_angle_deg": ("deflection_angle", np.pi / 180),
        "contact_angle_deg": ("contact_angle", np.pi / 180),
        "moment_micronewton_metre": ("moment", 1e-6),
        "axial_force_micronewton": ("axial_force", 1e-6),
        "transverse_force_micronewton": ("transverse_force", 1e-6),
    }  # fmt: skip
    units = [of[name][1] for name in names]
    with Run(out, "bend", options, seed) as run:
        call = ww.press if names[0] == "radial_distance_mm" else ww.bend
        bending = call(whisker, where * units[0], much * units[1], model=model)
        columns = {name: getattr(bending, field) / unit for name, (field, unit) in of.items()}
        # The requested values stay as written, also where there is no equilibrium.
        columns |= dict(zip(names, (where, much), strict=True))
        columns["outcome"] = [ww.Outcome(o).name.lower() for o in np.asarray(bending.outcome)]
        columns["model"] = [ww.mechanics.Model(m).name.lower() for m in np.asarray(bending.model)]
        columns["error"] = bending.error
        table = pd.DataFrame(columns)
        run.table("bend", table)
        if run.out_dir is not None:
            run.figure("bend", _figure(whisker, where * units[0], much * units[1], names[0], model))
    lost = sorted({ww.Outcome(o) for o in np.asarray(bending.outcome)[~bending.held]})
    notes = [f"{o.message[:1].upper()}{o.message[1:]}." for o in lost]
    notes += [bending.outside_domain] * bool(bending.outside_domain)
    if model is None and not as_json:
        notes += _which_model(whisker, bending)
    opt.show(table, run, whisker, as_json, notes)


def _which_model(whisker: ww.Whisker, bending: ww.mechanics.Bending) -> Iterator[str]:
    """One line per model that the contacts need, with the reason for the first contact."""
    at = bending.held
    if not np.any(at):
        return
    choice = ww.choose_model(whisker, bending.radial_distance[at], bending.deflection_angle[at])
    models, first, counts = np.unique(choice.model, return_index=True, return_counts=True)
    for model, k, count in zip(models, first, counts, strict=True):
        title = ww.mechanics.Model(model).message
        yield f"At k = 0.1, {title} is enough for {count} of {at.sum()}: {choice.why[k]}."


def _figure(whisker: ww.Whisker, where: Array, load: Array, given: str, model: str | None) -> Any:
    """The signals at each requested place, from no load to the largest requested."""
    by_place = given == "radial_distance_mm"
    against = "deflection_angle" if by_place else "force"
    steps = np.linspace(min(load.min(), 0.0), max(load.max(), 0.0), 241)
    places = np.unique(where)
    call = ww.press if by_place else ww.bend
    curves = call(whisker, places[:, None], steps, model=model)
    marked = call(whisker, places[:, None], np.unique(load), model=model)
    return ww.plots.bending(curves, points=marked, against=against)


@opt.command
def jnd(
    shape: opt.Shape = opt.NO_SHAPE,
    cue: str | None = None,
    weber_fraction: Annotated[
        opt.Texts, "Of all signals, or one each (moment, axial force).  [default: 0.1]"
    ] = None,
    radial_distance_mm: opt.Texts = None,
    deflection_angle_deg: opt.Texts = None,
    method: Annotated[opt.Text, "quadrature, emcee or laplace.  [default: quadrature]"] = None,
    criterion: Annotated[str, "What counts as noticeable, such as '75% 2AFC'."] = "d'=1",
    draws: Annotated[int, "Noisy readings at each distance, 2 or more."] = 100,
    seed: int = 1,
    out: Path | None = None,
    as_json: bool = False,
) -> None:
    """Just noticeable differences of radial distance, by formula, information, posterior.

    Without --radial-distance-mm at ten places along the whisker. A contact that the whisker cannot
    hold is part of the answer: its row says what becomes of it.
    """
    inputs = opt.as_asked(locals())
    whisker = opt.the_whisker(shape)
    observer, angles = opt.the_scene(cue, deflection_angle_deg, weber_fraction, whisker)
    places = np.asarray(np.round(np.linspace(0.05, 0.95, 10) * whisker.length * 1e3, 6))
    if radial_distance_mm:
        places = numbers("--radial-distance-mm", radial_distance_mm)
        checks.positive("--radial-distance-mm", places, "give millimetres, such as 20")
    opt.enough_draws(draws)
    with Run(out, "jnd", inputs, seed) as run:
        curve = curve_in_steps(
            observer, places * 1e-3, angles, method or "quadrature", criterion, draws, seed, as_json
        )
        written = curve.table.reset_index()
        # Without the rounding of a conversion to metres and back.
        written["radial_distance_mm"] = np.tile(places, max(angles.size, 1))
        run.table("jnd", written)
        if run.out_dir is not None:
            run.figure("jnd", ww.plots.jnd_lines(curve))
    notes = [f"Every column of lengths is a JND of radial distance, criterion {criterion}."]
    bad = written["unreliable"].fillna(0.0)
    if (bad > 0).any():
        notes.append(
            f"At {int((bad > 0).sum())} of {len(bad)} places some posteriors are not to be "
            f"relied on (up to {bad.max():.0%}): the reading does not pin the contact down, or "
            "the method did not reach its precision."
        )
    lost = sorted(o for o in set(written["outcome"]) if not o.startswith("held"))
    notes += [f"{outcome[:1].upper()}{outcome[1:]}." for outcome in lost]
    if not as_json:  # the note takes longer than the rest
        notes += [observer.note] * bool(observer.note)
    opt.show(written, run, whisker, as_json, notes)


def curve_in_steps(
    observer: ww.Observer, distances: Array, angles: Array, method: str, criterion: str, draws: int,
    seed: int, as_json: bool, description: str = "Posteriors", step: int = 4,
) -> ww.sensitivity.JNDCurve:  # fmt: skip
    """`jnd_curve` for all distances at each angle, `step` at a time, with a progress bar."""
    pairs: list[tuple[float | None, Array]] = [
        (angle, distances[i : i + step])
        for angle in (angles.tolist() or [None])
        for i in range(0, distances.size, step)
    ]
    seeds = np.random.SeedSequence(seed).spawn(len(pairs))
    steps_done = []
    with progress(description, len(pairs), as_json=as_json) as advance:
        for (angle, r), each in zip(pairs, seeds, strict=True):
            steps_done.append(ww.jnd_curve(
                observer, r, angle, method=method, criterion=criterion, n_readings=draws, seed=each
            ))  # fmt: skip
            advance()
    return ww.sensitivity.JNDCurve.joined(steps_done)


# -- measured contacts ----------------------------------------------------------------------------

_VIDEO, _SENSOR = {"rich_help_panel": "Tracked video"}, {"rich_help_panel": "Sensor"}
_AT_REST = (
    "Curvature at rest, above 0 where touched on the convex side; own for that of the --identity, "
    "0 for straight.  [default: unknown, as is usual of its kind; of a cylinder 0; of a tracked "
    "video from its free frames]"
)


@opt.command
def locate(
    contacts: Annotated[Path, "Table of contacts (CSV, Parquet, Excel), or a tracker's file."],
    shape: Annotated[opt.Shape, {"curvature_per_m": _AT_REST}] = opt.NO_SHAPE,
    column: opt.Texts = None,
    unit: opt.Texts = None,
    touch: Annotated[opt.Text, "Column that numbers touches.", {"metavar": "COLUMN"}] = None,
    time: Annotated[opt.Text, "Column that figures go by.", {"metavar": "COLUMN"}] = None,
    weber_fraction: Annotated[opt.Texts, "Noise.  [default: sds of the table, or learnt]"] = None,
    taps: Annotated[Path | None, "Taps at known distances, to calibrate by.", _SENSOR] = None,
    counts: Annotated[bool, "Slopes are counts a second.", _SENSOR] = False,
    clamped: Annotated[bool, "The base does not give way.", _SENSOR] = False,
    pixels_per_mm: Annotated[opt.Number, "Its scale.", _VIDEO] = None,
    frame_rate: Annotated[opt.Number, "A second.", _VIDEO] = None,
    label: Annotated[
        opt.Text, "Which of several tracked whiskers, by name or number.",
        {"metavar": "WHISKER", **_VIDEO},
    ] = None,
    shortest_px: Annotated[float, "Shorter ones are fur.", _VIDEO] = 0.0,
    follicles: Annotated[opt.Texts, "Box of the follicles: x, y, x, y.", _VIDEO] = None,
    likelihood: Annotated[float, "Less likely keypoints are left out.", _VIDEO] = 0.6,
    face: Annotated[opt.Text, "Where the face is: left, right, top or bottom.", _VIDEO] = None,
    pole_px: Annotated[opt.Texts, "The pole: x, y.", _VIDEO] = None,
    workers: Annotated[
        int | None, "Processes, for long tables.  [default: this one]",
        {"rich_help_panel": "Workers"},
    ] = None,
    scheduler: str | None = None,
    out: Path | None = None,
    as_json: bool = False,
) -> None:
    """Say how far away each contact of a table or a tracked video is.

    Columns are called moment, axial_force, transverse_force, deflection_angle, moment_rate,
    angular_velocity, with the unit behind (moment_uNm), or as --column says. The stiffness is
    unknown unless --youngs-modulus-gpa is given. Of a tracker's file (.whiskers, .hdf5, .slp,
    .nwb, or with --pixels-per-mm a .csv or .parquet) the forces follow from the shape of the
    whisker. With --taps, a table as of `weberwhisk calibrate`, slopes of a sensor are located.
    """
    options = opt.as_asked(locals())
    table_or_path: Any = contacts
    whisker = opt.the_whisker(shape)
    notes: list[str] = []
    noise = None if weber_fraction is None else opt.weber_fractions(weber_fraction)
    with Run(out, "locate", options) as run, progress("Rows", 1.0, as_json=as_json) as advance:
        shown = [0.0]

        def step(done: int, total: int) -> None:
            advance(done / total - shown[0])
            shown[0] = done / total

        from ..recordings.files import TRACKERS

        if pixels_per_mm is not None or contacts.suffix.lower() in (*TRACKERS, ".nwb"):
            video = ww.read_tracking(
                contacts, shortest_px=shortest_px, face=face, pixels_per_mm=pixels_per_mm,
                frame_rate=frame_rate, likelihood=likelihood,
                follicles=numbers("--follicles", follicles) if follicles else None,
            )  # fmt: skip
            pole = numbers("--pole-px", pole_px) if pole_px else None
            table_or_path = ww.tracked_signals(video, whisker, identity=label, pole=pole)
            notes += [*video.attrs["notes"], *table_or_path.attrs["notes"]]
        mapped = opt.pairs("--column", column, "moment=M_uNm")
        units = opt.pairs("--unit", unit, "moment=mN m")
        by: Any = whisker
        if taps is not None:
            by = ww.calibrate(
                taps, whisker, columns=mapped, units=units, counts=counts, hinge=not clamped
            )
            notes.append(by.message)
        elif counts or clamped:
            raise Refusal(
                "--counts and --clamped say how taps are read",
                "no --taps",
                "write --taps taps.csv, or leave them out",
            )
        table = ww.locate(
            table_or_path, by, columns=mapped, units=units, touch=touch, noise=noise,
            known_stiffness=shape.youngs_modulus_gpa is not None, progress=step, workers=workers,
            scheduler=scheduler,
        )  # fmt: skip
        if time is not None and not (
            time in table.columns and pd.api.types.is_numeric_dtype(table[time])
        ):
            raise Refusal("--time needs a column of numbers", f"{time!r}", "name another")
        run.table("located", table)
        if touch is not None:
            in_touches = table[table["touch_status"] != "no_touch"]
            names = [touch, *(c for c in table.columns if c.startswith("touch_") and c != touch)]
            run.table("touches", in_touches[names].drop_duplicates(touch))
        if run.out_dir is not None:
            run.figure("located", ww.plots.located(table, against=time, by=touch or ""))
            if touch is not None:
                run.figure("touches", ww.plots.located(table, against=touch, by=touch))
    if taps is not None:
        whisker = by.whisker
    notes += table.attrs["notes"]
    first_rows = table.head(20).drop(columns="message")
    more = [f"… and {counted(len(table) - len(first_rows), 'more row')}."] * (
        len(first_rows) < len(table)
    )
    messages = table["message"].value_counts().items()
    answer = {"notes": notes, "rows": table.to_dict("records")}
    opt.finish(
        run, as_json, {"whisker": opt.describe(whisker), **answer}, opt.whisker_line(whisker),
        first_rows.to_string(float_format="{:.6g}".format, na_rep="-"), *more,
        *(f"{count} of {len(table)} rows: {message}." for message, count in messages), *notes,
    )  # fmt: skip


@opt.command
def calibrate(
    taps: Annotated[Path, "Table of taps: CSV, Parquet or Excel."],
    shape: opt.Shape = opt.NO_SHAPE,
    column: opt.Texts = None,
    unit: opt.Texts = None,
    counts: Annotated[bool, "Slopes are counts a second: find the gain."] = False,
    clamped: Annotated[bool, "The base does not give way."] = False,
    seed: int = 1,
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
        calibration = ww.calibrate(
            taps, whisker, columns=opt.pairs("--column", column, "moment_rate=slope"),
            units=opt.pairs("--unit", unit, "moment_rate=uN m/s"), counts=counts,
            hinge=not clamped, seed=seed,
        )  # fmt: skip
        parameters = calibration.parameters.reset_index(names="parameter")
        run.table("parameters", parameters)
        run.table("residuals", calibration.residuals)
        run.table("left_out", calibration.left_out)
        if run.out_dir is not None:
            run.figure("calibration", ww.plots.calibrated(calibration))
    answer = {
        "whisker": opt.describe(calibration.whisker), "message": calibration.message,
        "parameters": parameters.to_dict("records"), "p_value": calibration.p_value,
        "left_out": calibration.left_out.to_dict("records"),
    }  # fmt: skip
    opt.finish(
        run, as_json, answer, opt.whisker_line(calibration.whisker),
        parameters.to_string(index=False, float_format="{:.4g}".format),
        calibration.left_out.to_string(index=False, float_format="{:.4g}".format),
        calibration.message,
    )  # fmt: skip
