"""`weberwhisk simulate` and `next`, choices and the next trial; how a whisker encodes distance."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import weberwhisk as ww

from .. import commands as opt
from .._util import checks
from .._util.output import Run, atomic_write, csv_text, to_json
from .._util.values import counted
from . import numbers

if TYPE_CHECKING:
    from ..behaviour import CueEncoding

__all__ = ["distance_encoding", "next_trials", "simulate"]


def distance_encoding(
    shape: opt.Shape, cue: str | None, angles_deg: opt.Texts
) -> tuple[CueEncoding | None, ww.Whisker | None]:
    """The encoding and the whisker that the options describe; None where they name no whisker."""
    if not shape.given:
        for name, given in (("--cue", cue), ("--deflection-angle-deg", angles_deg)):
            if given:
                raise ValueError(f"{name} needs a whisker, got none; write --identity C2, say.")
        return None, None
    whisker = opt.the_whisker(shape)
    made, angles = opt.the_cue(cue, angles_deg)
    noise = ww.inference.default_noise(whisker, made, 0.1)
    observer, angle = ww.Observer(whisker, made, noise), opt.one_angle(angles)
    return ww.behaviour.CueEncoding(observer, angle, unit=1e-3), whisker


@opt.command
def simulate(
    shape: opt.Shape = opt.NO_SHAPE,
    cue: str | None = None,
    deflection_angle_deg: opt.Texts = None,
    standard: Annotated[opt.Texts, "Magnitudes compared with.  [default: 1]"] = None,
    standard_mm: opt.Texts = None,
    offset: Annotated[
        opt.Texts, "Comparisons over their standard, less 1.  [default: nine from -0.3 to 0.3]"
    ] = None,
    weber_fraction: Annotated[float, "The truth to find."] = 0.1,
    lapse_low: Annotated[float, "Share lost at the low end."] = 0.0,
    lapse_high: Annotated[float, "Share lost at the high end."] = 0.0,
    bias: Annotated[float, "Towards the second, in sds."] = 0.0,
    effect: Annotated[
        opt.Texts,
        "What else moves the answers, as in fit, with its parameter: history:0.5; may be repeated.",
        {"metavar": "NAME:VALUE"},
    ] = None,
    missing: Annotated[float, "Share of trials without an answer."] = 0.0,
    trials_per_level: Annotated[int, "Trials of each comparison."] = 40,
    order: Annotated[
        str, "'standard first', or random: the comparison comes first in half of the trials."
    ] = "standard first",
    sessions: Annotated[int, "Dealt out over these."] = 1,
    subjects: Annotated[int, "Animals; with several, each draws its own truth."] = 1,
    spread: Annotated[float, "Standard deviation of ln k between several animals."] = 0.3,
    task: Annotated[str, "2AFC, 2IFC, or '2AFC percent correct' and the like."] = "2AFC",
    seed: int = 1,
    out: Path | None = None,
    as_json: bool = False,
) -> None:
    """Simulate choices between two stimuli, with the truth beside them.

    Stimuli are magnitudes (--standard), or radial distances encoded through a whisker
    (--standard-mm with --identity or a shape). `weberwhisk fit` reads the table.
    """
    inputs = opt.as_asked(locals())
    from ..behaviour.effects import effect_valued
    from ..behaviour.simulate import SIGNED_OFFSETS
    from ..behaviour.trials import STIMULI

    encoding, whisker = distance_encoding(shape, cue, deflection_angle_deg)
    if encoding is None and standard_mm:
        raise ValueError(
            "--standard-mm needs a whisker, got none; write --identity C2, or "
            "--standard for magnitudes."
        )
    if encoding is not None and (standard or not standard_mm):
        raise ValueError(
            f"Distances encoded through a whisker are given by --standard-mm, got "
            f"{'--standard' if standard else 'none'}; write --standard-mm 20, say."
        )
    base = numbers("--standard-mm" if encoding else "--standard", standard_mm or standard or ["1"])
    checks.positive("--standard-mm" if encoding else "--standard", base, "write 20, say")
    levels = numbers("--offset", offset) if offset else None
    effects = [effect_valued(text) for text in effect or ()]
    truth: dict[str, Any] = {
        name: inputs[name] for name in ("weber_fraction", "lapse_low", "lapse_high", "bias")
    }
    with Run(out, "simulate", inputs, seed) as run:
        design: dict[str, Any] = truth | {
            "standards": base, "offsets": levels, "encoding": encoding, "effects": effects,
            "trials_per_level": trials_per_level, "order": order, "sessions": sessions,
            "missing": missing, "task": task, "seed": seed,
        }  # fmt: skip
        if subjects == 1:
            trials, animals = ww.simulate_trials(**design), None
        else:
            trials, animals = ww.simulate_population(subjects, spread=spread, **design)
        table = trials.table()
        if encoding is not None:
            table = table.rename(columns={name: f"{name}_mm" for name in STIMULI})
        run.table("trials", table)
        known = dict(truth)
        if animals is not None:
            known |= {"spread": spread, "animals": animals.to_dict("records")}
        if effects:
            known |= {"effects": {e.name: value for e, value in effects}}
        known |= {
            "standards": base,
            "offsets": SIGNED_OFFSETS if levels is None else levels,
            "order": order,
            "task": trials.task.name,
            "seed": seed,
            "whisker": None if whisker is None else opt.describe(whisker),
        }
        if run.out_dir is not None:
            atomic_write(run.path("truth.json"), to_json(known) + "\n")
            if animals is None:
                unit = "mm" if encoding else ""
                free = {name: truth[name] for name in trials.task.lapses}
                free |= {"bias": bias} if trials.task.has_bias else {}
                free |= {e.name: value for e, value in effects}
                exact = ww.fit_weber(
                    trials, encoding=encoding, effects=[e for e, _ in effects],
                    priors={"weber_fraction": weber_fraction, **free},
                )  # fmt: skip
                run.figure("trials", ww.plots.psychometrics(exact, unit=unit))
    lines = [] if whisker is None else [opt.whisker_line(whisker)]
    many = "" if animals is None else f" of {subjects} animals"
    lines.append(
        f"{counted(len(table), 'trial')}{many} of {trials.task.name}, "
        f"{trials.n_missing} without an answer; "
        f"{counted(base.size, 'standard')}, "
        f"Weber fraction {weber_fraction:g}, "
        f"lapses {lapse_low:g} and {lapse_high:g}, bias {bias:g}, seed {seed}."
    )
    if run.out_dir is None:
        lines.append(csv_text(table).rstrip("\n"))
    answer = {"truth": known, "rows": table.astype(object).to_dict("records")}
    opt.finish(run, as_json, answer, *lines)


@opt.command
def next_trials(
    shape: opt.Shape = opt.NO_SHAPE,
    cue: str | None = None,
    deflection_angle_deg: opt.Texts = None,
    standard: Annotated[opt.Texts, "Magnitudes compared with."] = None,
    standard_mm: opt.Texts = None,
    goal: Annotated[
        str, "What the trials are to tell: weber-fraction, or taper (against a cylinder)."
    ] = "weber-fraction",
    nearest: Annotated[float, "Least stimulus; mm with a whisker."] = 0.0,
    farthest: Annotated[float, "Greatest stimulus; mm with a whisker."] = float("inf"),
    step: Annotated[float, "Stimuli come in steps of this size."] = 0.0,
    easy_share: Annotated[float, "Share of easy trials."] = 0.1,
    width_percent: Annotated[
        opt.Number, "Stop when the 95 % interval of k is within ± this."
    ] = None,
    most: Annotated[int | None, "Stop after so many trials."] = None,
    bias: Annotated[str, "per-standard, shared or none; none where answers are scored."] = (
        "per-standard"
    ),
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
    inputs = opt.as_asked(locals(), "log") | {"seed": seed}
    from ..behaviour import CueEncoding, IdentityEncoding, task_named
    from ..behaviour.trials import STIMULI
    from ..design import BayesianPlacer, Constraints, Hypothesis, Scheme, lattice
    from ..design.session import Session, converse

    if farthest == float("inf"):
        inputs["farthest"] = None
    encoding, whisker = distance_encoding(shape, cue, deflection_angle_deg)
    name = "--standard" if encoding is None else "--standard-mm"
    texts = standard if encoding is None else standard_mm
    if not texts or (standard if encoding is not None else standard_mm):
        raise ValueError(f"{name} says what is compared with, got none; write {name} 20, say.")
    at = numbers(name, texts)
    limits = Constraints(nearest, farthest, step)
    checks.one_of("--goal", goal, ("weber-fraction", "taper"))
    bias = bias.replace("-", " ")
    unasked = bias == "per standard" and not task_named(task).has_bias
    how: dict[str, Any] = {"bias": "none" if unasked else bias, "task": task}
    encoded = encoding or IdentityEncoding()
    hypotheses = [Hypothesis("Weber", encoded, **how)]
    scheme = lattice(encoded, at, limits)
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
        rows = zip(scheme.offsets, lattice(other, at, limits).offsets, strict=True)
        scheme = Scheme(scheme.standards, [sorted({*a, *b}) for a, b in rows])
    placer = BayesianPlacer(
        hypotheses, scheme, goal="hypothesis" if goal == "taper" else "weber_fraction",
        easy_share=easy_share, width=None if width_percent is None else width_percent / 100,
        most=most, seed=seed,
    )  # fmt: skip
    unit = "" if encoding is None else "_mm"
    # More trials, or fewer, go on with the same file.
    question = {name: value for name, value in inputs.items() if name != "most"}
    with Run(out, "next", inputs, seed) as run, Session(placer, log, question) as session:
        for line in converse(session, sys.stdin, unit):
            print(line, flush=True)
        table = placer.trials().table()
        run.table("trials", table.rename(columns={c: f"{c}{unit}" for c in STIMULI}))
        if run.out_dir is not None and len(table):
            run.figure("trials", ww.plots.placements(placer))
