"""`weberwhisk jnd`: the just noticeable difference of radial distance along a whisker."""

from __future__ import annotations

from typing import Annotated

import numpy as np
import typer
from numpy.typing import NDArray

import weberwhisk as ww

from .. import _checks
from .._terminal import numbers, progress
from ..output import Run
from .options import (
    NO_SHAPE,
    AngleOption,
    CueOption,
    DistanceOption,
    JsonOption,
    OutOption,
    SeedOption,
    Shape,
    as_asked,
    enough_draws,
    show,
    takes_whisker,
    the_scene,
    the_whisker,
)

Array = NDArray[np.float64]

#: Distances in one call of `jnd_curve`: what the progress bar moves by.
STEP = 4


@takes_whisker
def jnd(
    shape: Shape = NO_SHAPE,
    cue: CueOption = None,
    weber_fraction: Annotated[
        list[str] | None,
        typer.Option(
            "--weber-fraction",
            metavar="LIST",
            help="Of all signals, or one each (moment, axial force).  [default: 0.1]",
        ),
    ] = None,
    radial_distance_mm: DistanceOption = None,
    deflection_angle_deg: AngleOption = None,
    method: Annotated[
        str | None,
        typer.Option(
            "--method",
            help="Posteriors by quadrature, emcee or laplace.  [default: quadrature]",
        ),
    ] = None,
    criterion: Annotated[
        str, typer.Option("--criterion", help="What counts as noticeable, such as '75% 2AFC'.")
    ] = "d'=1",
    draws: Annotated[
        int, typer.Option("--draws", help="Noisy readings at each distance, 2 or more.")
    ] = 100,
    seed: SeedOption = 1,
    out: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """Just noticeable differences of radial distance, by formula, information, posterior.

    Without --radial-distance-mm at ten places along the whisker. A contact that the whisker cannot
    hold is part of the answer: its row says what becomes of it.
    """
    inputs = as_asked(locals())
    whisker = the_whisker(shape)
    observer, angles = the_scene(cue, deflection_angle_deg, weber_fraction, whisker)
    if radial_distance_mm:
        asked = numbers("--radial-distance-mm", radial_distance_mm)
        _checks.positive("--radial-distance-mm", asked, "give millimetres, such as 20")
    else:
        asked = np.asarray(np.round(np.linspace(0.05, 0.95, 10) * whisker.length * 1e3, 6))
    enough_draws(draws)
    for name in ("out", "as_json", "seed"):
        inputs.pop(name)
    with Run(out, "jnd", inputs, seed) as run:
        curve = curve_in_steps(
            observer, asked * 1e-3, angles, method or "quadrature", criterion, draws, seed, as_json
        )
        written = curve.table.reset_index()
        # What was asked stays as it was written.
        written["radial_distance_mm"] = np.tile(asked, max(angles.size, 1))
        run.table("jnd", written)
        if run.out_dir is not None:
            from .. import figures

            run.figure("jnd", figures.figure_of(figures.jnd_lines(curve)))
    show(written, run, whisker, as_json=as_json)
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
) -> ww.JNDCurve:
    """`jnd_curve` in steps, with a progress bar; angles are combined with distances."""
    import pandas as pd

    pairs: list[tuple[float | None, Array]] = [
        (angle, distances[i : i + STEP])
        for angle in (angles.tolist() or [None])
        for i in range(0, distances.size, STEP)
    ]
    seeds = np.random.SeedSequence(seed).spawn(len(pairs))
    parts = []
    with progress(description, len(pairs), as_json=as_json) as advance:
        for (angle, r), own in zip(pairs, seeds, strict=True):
            parts.append(
                ww.jnd_curve(
                    observer,
                    r,
                    angle,
                    method=method,
                    criterion=criterion,
                    n_readings=draws,
                    seed=own,
                ).frame
            )
            advance()
    return ww.JNDCurve(observer, pd.concat(parts, ignore_index=True))
