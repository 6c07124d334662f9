"""`weberwhisk next`: the next trial of a running experiment, line by line for a rig."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any

import numpy as np

import weberwhisk as ww

from .. import _checks
from ..behaviour import CueEncoding, IdentityEncoding
from ..behaviour.trials import STIMULI
from ..cli import numbers
from ..design import BayesianPlacer, Constraints, Hypothesis, Scheme, Staircase, lattice
from ..design.session import RULES, Session, converse
from ..output import Run
from .choices import distance_encoding
from .options import NO_SHAPE, Number, Shape, Texts, as_asked, command


@command
def next_trials(
    shape: Shape = NO_SHAPE,
    cue: str | None = None,
    deflection_angle_deg: Texts = None,
    standard: Annotated[Texts, "Magnitudes compared with."] = None,
    standard_mm: Texts = None,
    goal: Annotated[
        str,
        "What the trials are to tell: weber-fraction, or taper (against a cylinder); or a rule: "
        "1-up/2-down, 1-up/3-down, 1-up/1-down.",
    ] = "weber-fraction",
    nearest: Annotated[float, "Least stimulus; mm with a whisker."] = 0.0,
    farthest: Annotated[float, "Greatest stimulus; mm with a whisker."] = float("inf"),
    step: Annotated[float, "Stimuli come in steps of this size."] = 0.0,
    easy_share: Annotated[float, "Share of easy trials."] = 0.1,
    width_percent: Annotated[Number, "Stop when the 95 % interval of k is within ± this."] = None,
    most: Annotated[int | None, "Stop after so many trials."] = None,
    bias: Annotated[str, "per-standard, shared or none."] = "per-standard",
    task: Annotated[str, "As for simulate."] = "2AFC",
    log: Annotated[
        Path | None, "Keeps every trial; goes on where it was.", {"metavar": "FILE"}
    ] = None,
    seed: int = 1,
    out: Path | None = None,
) -> None:
    """Place trials one by one: a line of JSON out, an answer in.

    An answer is 1, 0 or null, or {"choice": 1, "comparison_mm": 21.4} where another stimulus was
    shown than was proposed (without a whisker: "comparison"). A line that cannot be used gets
    {"error": ...} and the trial stands. With --log nothing is lost: start the same command again.
    """
    inputs = as_asked(locals(), "log") | {"seed": seed}
    if farthest == float("inf"):
        inputs["farthest"] = None
    encoding, whisker = distance_encoding(shape, cue, deflection_angle_deg)
    name = "--standard" if encoding is None else "--standard-mm"
    texts = standard if encoding is None else standard_mm
    if not texts or (standard if encoding is not None else standard_mm):
        raise ValueError(f"{name} says what is compared with, got none; write {name} 20, say.")
    at = numbers(name, texts)
    limits = Constraints(nearest, farthest, step)
    placer = _placer(goal, encoding, whisker, at, limits, bias.replace("-", " "), task,
                     easy_share, width_percent, most, seed)  # fmt: skip
    unit = "" if encoding is None else "_mm"
    # More trials, or fewer, go on with the same file.
    question = {name: value for name, value in inputs.items() if name != "most"}
    with Run(out, "next", inputs, seed) as run, Session(placer, log, question) as session:
        for line in converse(session, sys.stdin, unit):
            print(line, flush=True)
        table = placer.trials().table()
        run.table("trials", table.rename(columns={c: f"{c}{unit}" for c in STIMULI}))
        if run.out_dir is not None and len(table):
            run.figure("trials", ww.figures.placements(placer))


def _placer(
    goal: str,
    encoding: CueEncoding | None,
    whisker: ww.Whisker | None,
    standards: np.ndarray,
    limits: Constraints,
    bias: str,
    task: str,
    easy_share: float,
    width_percent: float | None,
    most: int | None,
    seed: int,
) -> BayesianPlacer | Staircase:
    """What the options ask for."""
    _checks.one_of("--goal", goal, ("weber-fraction", "taper", *RULES))
    how: dict[str, Any] = {"bias": bias, "task": task}
    encoded = encoding or IdentityEncoding()
    hypotheses = [Hypothesis("Weber", encoded, **how)]
    scheme = lattice(encoded, standards, limits)
    if goal in RULES:
        return Staircase(hypotheses[0], scheme, rule=goal, most=most, seed=seed)
    if goal == "taper":
        if encoding is None or whisker is None or whisker.tip_radius >= whisker.base_radius:
            raise ValueError(
                "--goal taper tells a tapered whisker from a cylinder, got none; write "
                "--identity C2, say."
            )
        observer = ww.Observer(whisker.cylinder(), encoding.observer.cue, encoding.observer.noise)
        other = CueEncoding(observer, encoding.deflection_angle, encoding.unit)
        named = {"tapered": encoded, "cylindrical": other}
        hypotheses = [Hypothesis(name, of_it, **how) for name, of_it in named.items()]
        rows = zip(scheme.offsets, lattice(other, standards, limits).offsets, strict=True)
        scheme = Scheme(scheme.standards, [sorted({*a, *b}) for a, b in rows])
    return BayesianPlacer(
        hypotheses,
        scheme,
        goal="hypothesis" if goal == "taper" else "weber_fraction",
        easy_share=easy_share,
        width=None if width_percent is None else width_percent / 100,
        most=most,
        seed=seed,
    )
