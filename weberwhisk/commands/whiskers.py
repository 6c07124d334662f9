"""`weberwhisk bend` and `jnd`: signals and just noticeable differences of a whisker."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

import weberwhisk as ww

from .. import _checks
from ..cli import a_seed, numbers, progress
from ..output import Run
from . import options as opt

Array = NDArray[np.float64]

#: Column of `bend`'s table: attribute of `Bending`, and its unit in SI.
_BENDING_COLUMNS = {
    "arc_length_mm": ("arc_length", 1e-3),
    "force_micronewton": ("force", 1e-6),
    "radial_distance_mm": ("radial_distance", 1e-3),
    "deflection_angle_deg": ("deflection_angle", np.pi / 180),
    "contact_angle_deg": ("contact_angle", np.pi / 180),
    "moment_micronewton_metre": ("moment", 1e-6),
    "axial_force_micronewton": ("axial_force", 1e-6),
    "transverse_force_micronewton": ("transverse_force", 1e-6),
}


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
    import pandas as pd

    whisker = opt.the_whisker(shape, seed)
    pairs = {
        ("radial_distance_mm", "deflection_angle_deg"): (radial_distance_mm, deflection_angle_deg),
        ("arc_length_mm", "force_micronewton"): (arc_length_mm, force_micronewton),
    }
    named = [names for names, lists in pairs.items() if any(lists)]
    if len(named) != 1 or not all(pairs[named[0]]):
        got = " and ".join(opt.option(n) for names in pairs for n in names if options[n])
        raise ValueError(
            "A contact is --radial-distance-mm and --deflection-angle-deg, or --arc-length-mm and "
            f"--force-micronewton, got {got or 'none of them'}; write both of one pair."
        )
    names = named[0]
    where, much = (
        numbers(opt.option(n), texts or []) for n, texts in zip(names, pairs[names], strict=True)
    )
    _checks.positive(opt.option(names[0]), where, "give millimetres, such as 35")
    _checks.finite(opt.option(names[1]), much, "give a number, such as 20")
    where, much = (grid.ravel() for grid in np.meshgrid(where, much, indexing="ij"))
    units = [_BENDING_COLUMNS[name][1] for name in names]
    with Run(out, "bend", options, seed) as run:
        call = ww.press if names[0] == "radial_distance_mm" else ww.bend
        bending = call(whisker, where * units[0], much * units[1], model=model)
        columns = {
            name: getattr(bending, attribute) / unit
            for name, (attribute, unit) in _BENDING_COLUMNS.items()
        }
        # What was asked stays as it was written, also where there is no equilibrium.
        columns |= dict(zip(names, (where, much), strict=True))
        columns["outcome"] = [ww.Outcome(o).name.lower() for o in np.asarray(bending.outcome)]
        columns["model"] = [ww.Model(m).name.lower() for m in np.asarray(bending.model)]
        columns["error"] = bending.error
        table = pd.DataFrame(columns)
        run.table("bend", table)
        if run.out_dir is not None:
            run.figure("bend", _figure(whisker, where * units[0], much * units[1], names[0], model))
    opt.show(table, run, whisker, as_json=as_json)
    if not as_json:
        for outcome in sorted({ww.Outcome(o) for o in np.asarray(bending.outcome)[~bending.held]}):
            print(f"{outcome.message[:1].upper()}{outcome.message[1:]}.")
        if bending.outside_domain:
            print(bending.outside_domain)
        if model is None:
            _say_which_model(whisker, bending)


def _say_which_model(whisker: ww.Whisker, bending: ww.Bending) -> None:
    """One line for each model that the contacts held would need, with the reason of the first."""
    at = bending.held
    if not np.any(at):
        return
    choice = ww.choose_model(whisker, bending.radial_distance[at], bending.deflection_angle[at])
    models, first, counts = np.unique(choice.model, return_index=True, return_counts=True)
    for model, k, count in zip(models, first, counts, strict=True):
        title = ww.Model(model).title
        print(f"At k = 0.1, {title} is enough for {count} of {at.sum()}: {choice.why[k]}.")


def _figure(whisker: ww.Whisker, where: Array, load: Array, given: str, model: str | None) -> Any:
    """The signals along each contact asked for, from no load to the most asked for."""
    by_place = given == "radial_distance_mm"
    against = "deflection_angle" if by_place else "force"
    steps = np.linspace(min(load.min(), 0.0), max(load.max(), 0.0), 241)
    places = np.unique(where)
    call = ww.press if by_place else ww.bend
    curves = call(whisker, places[:, None], steps, model=model)
    marked = call(whisker, places[:, None], np.unique(load), model=model)
    return ww.figures.bending(curves, points=marked, against=against)


@opt.command
def jnd(
    shape: opt.Shape = opt.NO_SHAPE,
    cue: str | None = None,
    weber_fraction: Annotated[
        opt.Texts, "Of all signals, or one each (moment, axial force).  [default: 0.1]"
    ] = None,
    radial_distance_mm: opt.Texts = None,
    deflection_angle_deg: opt.Texts = None,
    method: Annotated[
        opt.Text, "Posteriors by quadrature, emcee or laplace.  [default: quadrature]"
    ] = None,
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
    if radial_distance_mm:
        asked = numbers("--radial-distance-mm", radial_distance_mm)
        _checks.positive("--radial-distance-mm", asked, "give millimetres, such as 20")
    else:
        asked = np.asarray(np.round(np.linspace(0.05, 0.95, 10) * whisker.length * 1e3, 6))
    opt.enough_draws(draws)
    with Run(out, "jnd", inputs, seed) as run:
        curve = curve_in_steps(
            observer, asked * 1e-3, angles, method or "quadrature", criterion, draws, seed, as_json
        )
        written = curve.table.reset_index()
        # What was asked stays as it was written.
        written["radial_distance_mm"] = np.tile(asked, max(angles.size, 1))
        run.table("jnd", written)
        if run.out_dir is not None:
            run.figure("jnd", ww.figures.jnd_lines(curve))
    opt.show(written, run, whisker, as_json=as_json)
    if not as_json:
        print(f"Every column of lengths is a JND of radial distance, criterion {criterion}.")
        bad = written["unreliable"].fillna(0.0)
        if (bad > 0).any():
            print(
                f"At {int((bad > 0).sum())} of {len(bad)} places some posteriors are not to be "
                f"relied on (up to {bad.max():.0%}): the reading does not pin the contact down, or "
                "the method did not reach its precision."
            )
        for outcome in sorted(set(written["outcome"])):
            if not outcome.startswith("held"):
                print(f"{outcome[:1].upper()}{outcome[1:]}.")


def curve_in_steps(
    observer: ww.Observer,
    distances: Array,
    angles: Array,
    method: str,
    criterion: str,
    draws: int,
    seed: int,
    as_json: bool,
    description: str = "Posteriors",
    step: int = 4,
) -> ww.JNDCurve:
    """`jnd_curve` of so many distances at a time, with a progress bar; angles are combined."""
    pairs: list[tuple[float | None, Array]] = [
        (angle, distances[i : i + step])
        for angle in (angles.tolist() or [None])
        for i in range(0, distances.size, step)
    ]
    seeds = np.random.SeedSequence(seed).spawn(len(pairs))
    parts = []
    with progress(description, len(pairs), as_json=as_json) as advance:
        for (angle, r), own in zip(pairs, seeds, strict=True):
            curve = ww.jnd_curve(
                observer, r, angle, method=method, criterion=criterion, n_readings=draws, seed=own
            )
            parts.append(curve)
            advance()
    return ww.JNDCurve.joined(parts)
