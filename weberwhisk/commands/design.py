"""`weberwhisk design`: an experiment planned, with its trial lists."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

import weberwhisk as ww

from .. import _checks
from .._terminal import numbers
from ..campaign import all_cores
from ..design import Constraints, Goal, Plan, SubjectPopulation
from ..design.experiment import WIDE
from ..design.preregistration import assumptions, offsets_in_words
from ..output import Run, to_json
from ..planning import fill
from . import options as opt


@opt.command
def design(
    shape: opt.Shape = opt.NO_SHAPE,
    cue: str | None = None,
    deflection_angle_deg: opt.Texts = None,
    bayes_factor: Annotated[
        opt.Number, "Goal: tapered whisker or cylinder, distinguished by so much.  [default: 10]"
    ] = None,
    half_width: Annotated[
        opt.Number, "Goal instead: the 95 % interval of k, 0.2 for ±20 %."
    ] = None,
    share: Annotated[float, "Of experiments that reach the goal."] = 0.8,
    standard_mm: Annotated[
        opt.Texts, "Radial distances compared with.  [default: 0.3, 0.6 and 0.9 of the length]"
    ] = None,
    level: Annotated[
        opt.Texts,
        "Comparisons, in sds of what the animal can tell.  "
        f"[default: {','.join(f'{z:g}' for z in WIDE)}]",
    ] = None,
    best: Annotated[bool, "Choose standards and offsets by what they tell, in reach."] = False,
    trials: Annotated[
        int | None, "Of each comparison, for each animal.  [default: what reaches the goal]"
    ] = None,
    animals: Annotated[int, "How many."] = 1,
    find: Annotated[
        opt.Text,
        "What the goal decides: trials, animals or nothing.  [default: trials, where they are not "
        "given]",
    ] = None,
    weber_fraction: Annotated[float, "Of the expected animals, the median."] = 0.1,
    spread: Annotated[float, "Sd of ln k between animals."] = 0.3,
    lapse: Annotated[float, "Expected share lost on either side."] = 0.03,
    nearest_mm: Annotated[float, "Nearest distance that the animal can reach."] = 0.0,
    farthest_mm: Annotated[opt.Number, "Farthest distance that the animal can reach."] = None,
    step_mm: Annotated[float, "Step of the pole, 0 for none."] = 0.01,
    easy_share: Annotated[float, "Least share of easy trials, which keep it working."] = 0.0,
    trials_per_session: Annotated[int, "At most."] = 300,
    apart: Annotated[bool, "Fit each animal by itself; several are fitted together."] = False,
    runs: Annotated[int, "Experiments simulated at each size, for the power."] = 512,
    workers: int | None = None,
    scheduler: str | None = None,
    title: Annotated[str, "Of the page."] = "Discrimination of radial distance",
    seed: int = 1,
    out: Path | None = None,
    as_json: bool = False,
) -> None:
    """Plan an experiment: distances, trials, animals, trial lists, and what to expect of it.

    Writes trial lists for PsychoPy and Bpod, a page to print with expected curves and a text for a
    preregistration, and plan.json, which `weberwhisk rehearse` simulates.
    """
    inputs = opt.as_asked(locals())
    whisker = opt.the_whisker(shape if shape.given else opt.Shape("C2"))
    _checks.positive("--weber-fraction", weber_fraction, "write 0.1, say")
    with opt.options_named(inputs), Run(out, "design", inputs, seed) as run:
        plan = ww.plan_experiment(
            whisker,
            goal=_goal(bayes_factor, half_width, share),
            standards=_standards(standard_mm),
            levels=_checks.finite("--level", numbers("--level", level), "write -1,1, say")
            if level
            else WIDE,
            best=best,
            trials=trials,
            animals=animals,
            find=find,
            expected=SubjectPopulation(weber_fraction, spread, lapse),
            constraints=_constraints(nearest_mm, farthest_mm, step_mm, easy_share),
            trials_per_session=trials_per_session,
            together=False if apart else None,
            title=title,
            runs=runs,
            seed=seed,
            workers=all_cores(workers, scheduler),
            scheduler=scheduler,
            progress=(lambda done: None) if as_json else None,
            **_encoded(cue, deflection_angle_deg),
        )
        fill(run, plan)
    if as_json:
        print(to_json(_answer(plan, whisker)))
        return
    print(f"{opt.whisker_line(whisker)}\n")
    print(_summary(plan))
    opt.wrote(run)
    if run.out_dir is None:
        print("Write it, with its trial lists, by naming a folder: --out plan.")
    else:
        print(f"Simulate the whole with: weberwhisk rehearse {run.out_dir / 'plan.json'}")


def _goal(bayes_factor: float | None, half_width: float | None, share: float) -> Goal:
    if bayes_factor is not None and half_width is not None:
        raise ValueError(
            f"There is one goal, got --bayes-factor {bayes_factor:g} and --half-width "
            f"{half_width:g}; leave one of them out."
        )
    if half_width is not None:
        return Goal(half_width=half_width, share=share)
    return Goal(bayes_factor=10.0 if bayes_factor is None else bayes_factor, share=share)


def _constraints(
    nearest_mm: float, farthest_mm: float | None, step_mm: float, easy_share: float
) -> Constraints:
    _checks.non_negative("--nearest-mm", nearest_mm, "give millimetres, such as 5")
    _checks.non_negative("--step-mm", step_mm, "give millimetres, such as 0.1, or 0")
    if farthest_mm is not None and not farthest_mm > nearest_mm:
        raise ValueError(
            f"--farthest-mm must lie beyond --nearest-mm, got {farthest_mm:g} and {nearest_mm:g}; "
            "exchange them, say."
        )
    farthest = np.inf if farthest_mm is None else farthest_mm * 1e-3
    return Constraints(nearest_mm * 1e-3, farthest, step_mm * 1e-3, easy_share)


def _standards(texts: opt.Texts) -> NDArray[np.float64] | None:
    if not texts:
        return None
    at = numbers("--standard-mm", texts)
    return _checks.positive("--standard-mm", at, "give millimetres, such as 10,20") * 1e-3


def _encoded(cue: str | None, angles_deg: opt.Texts) -> dict[str, Any]:
    if cue is None and not angles_deg:
        return {}
    encoded, angles = opt.the_cue(cue, angles_deg)
    return {"cue": encoded, "deflection_angle": opt.one_angle(angles)}


def _answer(plan: Plan, whisker: ww.Whisker) -> dict[str, Any]:
    return {
        "whisker": opt.describe(whisker),
        "goal": str(plan.goal),
        "animals": plan.scheme.animals,
        "trials_per_animal": plan.scheme.n_trials,
        "total_trials": plan.scheme.total_trials,
        "sessions": plan.sessions,
        "levels": plan.scheme.table().drop(columns="offset_mm").to_dict("records"),
        "power": None if plan.power is None else plan.power.to_dict("records"),
        "trials_sha256": plan.fingerprint,
    }


def _summary(plan: Plan) -> str:
    scheme = plan.scheme
    lines = [
        f"Goal: {plan.goal}.",
        f"{scheme.animals} animal{'s' * (scheme.animals > 1)} × {scheme.n_trials} trials in "
        f"{plan.sessions} session{'s' * (plan.sessions > 1)}, {scheme.total_trials} in all:",
    ]
    for standard, row, n in zip(scheme.standards, scheme.offsets, scheme.trials, strict=True):
        offsets = offsets_in_words(row)
        times = ", ".join(map(str, sorted(set(n))))
        lines.append(f"  standard {standard * 1e3:.4g} mm, offsets {offsets} mm, {times} each")
    lines += [plan.power_in_words()] * bool(plan.power_in_words())
    lines += ["Assumed:", *(f"  {line}" for line in assumptions(plan))]
    return "\n".join(lines)
