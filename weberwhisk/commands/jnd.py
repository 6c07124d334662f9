"""`weberwhisk jnd`: the just noticeable difference of radial distance along a whisker."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

import weberwhisk as ww

from .. import _checks
from .._terminal import numbers, progress
from ..output import Run
from . import options as opt

Array = NDArray[np.float64]


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
            opt.draw(run, "jnd", ww.figures.jnd_lines(curve))
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
