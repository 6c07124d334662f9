"""`weberwhisk design`, `rehearse` and `analyse`: plan, simulate and analyse an experiment."""

from __future__ import annotations

import hashlib
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

import weberwhisk as ww

from .. import commands as opt
from .._util import checks
from .._util.campaign import all_cores
from .._util.output import Run, atomic_write
from .._util.refusals import Advice, Refusal
from .._util.values import counted, pd
from . import numbers

if TYPE_CHECKING:
    from ..design import Constraints, Goal, Plan

__all__ = ["analyse", "design", "rehearse", "rig_trials"]

#: Default levels of `plan_experiment`, as an option.
_LEVELS = "-3.5,-1.5,-0.75,0.75,1.5,3.5"


@opt.command
def design(
    shape: opt.Shape = opt.NO_SHAPE,
    cue: str | None = None,
    deflection_angle_deg: opt.Texts = None,
    task: Annotated[opt.Text, "2AFC, 2IFC, yes/no, go/no-go (at a pole).  [default: 2AFC]"] = None,
    question: Annotated[
        opt.Text,
        "What is to be found: whiskers (tapered or cylinder), weber-law (or constant noise) or "
        "precision (of k).  [a terminal asks; else whiskers]",
    ] = None,
    bayes_factor: Annotated[opt.Number, "Goal: a Bayes factor of this.  [default: 10]"] = None,
    half_width: Annotated[opt.Number, "Goal: 95 % interval of k, 0.2 for ±20 %."] = None,
    share: Annotated[float, "Of experiments that reach the goal."] = 0.8,
    standard_mm: Annotated[
        opt.Texts, "Radial distances compared with.  [default: 0.3, 0.6 and 0.9 of the length]"
    ] = None,
    level: Annotated[opt.Texts, f"Comparisons, in sds of the noise.  [default: {_LEVELS}]"] = None,
    best: Annotated[bool, "Choose the most informative standards and offsets in reach."] = False,
    trials: Annotated[int | None, "Of each comparison, per animal.  [default: by the goal]"] = None,
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
    from ..design import Evidence, Precision, SubjectPopulation

    whisker = opt.the_whisker(shape if shape.given else opt.Shape("C2"))
    standards = numbers("--standard-mm", standard_mm or [])
    checks.positive("--standard-mm", standards, "give millimetres, such as 10,20")
    levels = numbers("--level", level or [_LEVELS])
    encoded: dict[str, Any] = {}
    if cue is not None or deflection_angle_deg:
        signals, angles = opt.the_cue(cue, deflection_angle_deg)
        encoded = {"cue": signals, "deflection_angle": opt.one_angle(angles)}
    if (question, bayes_factor, half_width) == (None, None, None) and not as_json:
        question = inputs["question"] = _question_asked()
    if bayes_factor is not None and half_width is not None:
        raise Refusal(
            "A goal is a Bayes factor or the width of an interval",
            "both",
            "write --bayes-factor or --half-width",
        )
    goal: Goal = Evidence(10.0 if bayes_factor is None else bayes_factor, share)
    if half_width is not None or (bayes_factor is None and question == "precision"):
        goal = Precision(0.2 if half_width is None else half_width, share)
    with Run(out, "design", inputs, seed) as run:
        plan = ww.plan_experiment(
            whisker, question=question, goal=goal,
            standards=standards * 1e-3 if standards.size else None,
            levels=checks.finite("--level", levels, "write -1,1, say"), best=best,
            trials=trials, animals=animals, find=find,
            expected=SubjectPopulation(weber_fraction, spread, lapse),
            constraints=_constraints(nearest_mm, farthest_mm, step_mm),
            trials_per_session=trials_per_session, together=False if apart else None, title=title,
            runs=runs, task=task, seed=seed, workers=all_cores(workers, scheduler),
            scheduler=scheduler, progress=(lambda done: None) if as_json else None, **encoded,
        )  # fmt: skip
        if run.out_dir is not None:
            from ..plots.designs import fill

            fill(run, plan)
    opt.finish(
        run, as_json, _answer(plan, whisker), f"{opt.whisker_line(whisker)}\n", _summary(plan)
    )
    if as_json:
        return
    if run.out_dir is None:
        print("Write it, with its trial lists, by naming a folder: --out plan.")
    else:
        print(f"Simulate the whole with: weberwhisk rehearse {run.out_dir / 'plan.json'}")


def _question_asked() -> str | None:
    """The question, asked at an interactive terminal; None elsewhere."""
    if not (sys.stdin.isatty() and sys.stderr.isatty()):
        return None
    import typer

    ways = {
        "1": ("whiskers", "whether the whisker is sensed as tapered or as a cylinder"),
        "2": ("weber-law", "whether noise grows with the signal (Weber's law) or is constant"),
        "3": ("precision", "the Weber fraction k, within ±20 %"),
    }
    lines = (f"  {key}  {what} (--question {name})" for key, (name, what) in ways.items())
    print("What is the experiment to find?", *lines, sep="\n", file=sys.stderr)
    answer = typer.prompt("1, 2 or 3", default="1", err=True)
    checks.one_of("the answer", answer, ways)
    return ways[answer][0]


def _constraints(nearest_mm: float, farthest_mm: float | None, step_mm: float) -> Constraints:
    checks.non_negative("--nearest-mm", nearest_mm, "give millimetres, such as 5")
    checks.non_negative("--step-mm", step_mm, "give millimetres, such as 0.1, or 0")
    if farthest_mm is not None and not farthest_mm > nearest_mm:
        raise Refusal(
            "--farthest-mm must lie beyond --nearest-mm",
            f"{farthest_mm:g} and {nearest_mm:g}",
            "exchange them, say",
        )
    farthest = np.inf if farthest_mm is None else farthest_mm * 1e-3
    return ww.design.Constraints(nearest_mm * 1e-3, farthest, step_mm * 1e-3)


def _answer(plan: Plan, whisker: ww.Whisker) -> dict[str, Any]:
    scheme, power = plan.scheme, plan.power
    return {
        "whisker": opt.describe(whisker), "goal": str(plan.goal), "animals": scheme.animals,
        "trials_per_animal": scheme.n_trials, "total_trials": scheme.total_trials,
        "sessions": plan.sessions,
        "levels": scheme.table().drop(columns="offset_mm").to_dict("records"),
        "power": None if power is None else power.to_dict("records"),
        "trials_sha256": plan.fingerprint,
    }  # fmt: skip


def _summary(plan: Plan) -> str:
    from ..design.plan_file import assumptions, offsets_in_words

    scheme = plan.scheme
    lines = [
        f"Goal: {plan.goal}.",
        f"{counted(scheme.animals, 'animal')} × {scheme.n_trials} trials in "
        f"{counted(plan.sessions, 'session')}, {scheme.total_trials} in all:",
    ]
    for standard, row, n in zip(scheme.standards, scheme.offsets, scheme.trials, strict=True):
        offsets, times = offsets_in_words(row), ", ".join(map(str, sorted(set(n))))
        lines.append(f"  standard {standard * 1e3:.4g} mm, offsets {offsets} mm, {times} each")
    lines += [plan.power_in_words()] * bool(plan.power_in_words())
    lines += ["Assumed:", *("  " + line for line in assumptions(plan))]
    return Advice.joined("\n", lines)


@opt.command
def rehearse(
    file: Annotated[Path, "plan.json, as `weberwhisk design` writes it.", {"metavar": "PLAN"}],
    runs: Annotated[int, "Experiments simulated under each hypothesis."] = 100,
    workers: int | None = None,
    scheduler: str | None = None,
    seed: int = 1,
    out: Path | None = None,
    as_json: bool = False,
) -> None:
    """Simulate a planned experiment, fit it as planned, and count how often it ends right.

    With --out a study that was broken off goes on where it was when the command is given again.
    """
    if not file.is_file():
        raise Refusal(
            f"{str(file)!r} is not a file",
            remedy="name the plan.json that `weberwhisk design` wrote",
        )
    plan = ww.read_plan(file)
    inputs = {"plan": str(file), "trials_sha256": plan.fingerprint, "runs": runs}
    with Run(out, "rehearse", inputs, seed) as run:
        stream = None if run.out_dir is None else _stream(run.out_dir, plan, runs, seed)
        rehearsal = ww.simulate_study(
            plan, runs, seed=seed, workers=all_cores(workers, scheduler), scheduler=scheduler,
            out=stream, progress=(lambda done: None) if as_json else None,
        )  # fmt: skip
        run.table("rehearsal", rehearsal.runs)
        run.table("rehearsal_summary", rehearsal.table)
        if run.out_dir is not None:
            atomic_write(run.path("rehearsal.txt"), rehearsal.report())
            run.figure("rehearsal", ww.plots.rehearsed(rehearsal))
    if stream is not None:
        stream.unlink(missing_ok=True)  # its runs are in rehearsal.csv now
    answer = {"goal": str(plan.goal), "rows": rehearsal.table.to_dict("records")}
    opt.finish(run, as_json, answer, rehearsal.report().rstrip())


def _stream(folder: Path, plan: Any, runs: int, seed: int) -> Path:
    """File of finished runs, from which the same question (plan, runs, seed) is resumed."""
    question = f"{ww.design.plan_json(plan)} {runs} {seed}".encode()
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise Refusal(
            f"The output folder {str(folder)!r} cannot be made ({error.strerror})",
            remedy="name a folder that you may write to",
        ) from error
    return folder / f"rehearsal-{hashlib.sha256(question).hexdigest()[:8]}.jsonl"


@opt.command
def analyse(
    file: Annotated[Path, "plan.json, as `weberwhisk design` writes it.", {"metavar": "PLAN"}],
    data: Annotated[list[Path], "Tables of trials.", {"metavar": "DATA..."}],
    out: Path | None = None,
    as_json: bool = False,
) -> None:
    """The preregistered analysis of a plan, on PsychoPy's or Bpod's own output.

    The tables, or Bpod's SessionData (.mat), have the columns of the trial lists, and an answer:
    PsychoPy's <keyboard>.keys (left or right), `response` (1 left, 2 right) or `choice` (1 where
    the second was judged farther).
    """
    for path in (file, *data):
        if not path.is_file():
            raise Refusal(
                f"{str(path)!r} is not a file", remedy="name a plan.json and tables of trials"
            )
    plan = ww.read_plan(file)
    trials = rig_trials(data, plan.hypotheses[0].task)
    inputs = {"plan": str(file), "trials_sha256": plan.fingerprint, "data": [str(d) for d in data]}
    with Run(out, "analyse", inputs) as run:
        analysis = plan.analyse(trials, unit=1e-3)
        words = analysis.report()
        run.table("analysis", analysis.estimates)
        if run.out_dir is not None:
            atomic_write(run.path("analysis.txt"), words)
            atomic_write(run.path("analysis_methods.txt"), analysis.methods())
            run.figure("analysis", ww.plots.analysed(analysis))
    answer = {
        "log_evidence": analysis.log_evidence, "favoured": analysis.favoured(),
        "left_out": analysis.left_out, "rows": analysis.estimates.to_dict("records"),
    }  # fmt: skip
    opt.finish(run, as_json, answer, words.rstrip())


def rig_trials(files: list[Path], task: str | None = None) -> ww.Trials:
    """The trials in the tables of one rig, in mm; rows without a stimulus are left out."""
    from ..behaviour.trials import STIMULI
    from ..recordings.tables import load_table

    loaded = [load_table(path) for path in files]
    table = pd.concat([_with_choice(t.frame, path) for t, path in zip(loaded, files, strict=True)])
    named = {name: f"{name}_mm" for name in STIMULI if f"{name}_mm" in table}
    if "trial" not in table and "trial_number" in table:
        named["trial"] = "trial_number"
    trials = ww.read_trials(table.reset_index(drop=True), columns=named, task=task)
    of_files = [f"{t.name}: {note}" for t in loaded for note in t.notes]
    return replace(trials, notes=(*of_files, *trials.notes))


def _with_choice(table: pd.DataFrame, file: Path) -> pd.DataFrame:
    """The trials of one table, with answers as `choice`: 1, 0, or NaN for none."""
    from ..behaviour.trials import rows_in_words

    places = np.arange(1, len(table) + 1)
    for name in ("stimulus_1_mm", "stimulus_1"):
        if name in table:
            shown = table[name].notna().to_numpy()
            table, places = table[shown], places[shown]
            break
    # Keyboards of other routines, such as instructions, have no values here.
    columns = [str(n) for n in table if str(n).endswith(".keys") and table[n].notna().any()]
    columns += ["response"] if "response" in table else []
    columns = ["choice"] if "choice" in table else columns
    if len(columns) != 1:
        raise Refusal(
            f"{str(file)!r}: there is no one column of answers",
            ", ".join(columns) or "none",
            "call it choice (1 where the second was judged farther), response or <keyboard>.keys",
        )
    given = table[columns[0]].map(lambda v: str(v).strip().lower().removesuffix(".0"))
    # PsychoPy's keyboard writes sides, a table for Bpod 1 or 2 for them (`trial_lists`).
    codes = {"left": 0.0, "right": 1.0, "1": 0.0, "2": 1.0}
    if columns == ["choice"]:
        codes = {"left": 0.0, "right": 1.0, "0": 0.0, "1": 1.0, "false": 0.0, "true": 1.0}
    none = "", "nan", "none", "<na>", "null", "na", "n/a"
    unknown = ~given.isin([*codes, *none]).to_numpy()
    if unknown.any():
        raise Refusal(
            f"{str(file)!r}, column {columns[0]!r}, {rows_in_words(places[unknown])}: "
            f"{checks.listed(given[unknown].unique())} is no answer",
            remedy=(
                f"write {', '.join(code for code, second in codes.items() if not second)} "
                "where the first was judged farther, "
                f"{', '.join(code for code, second in codes.items() if second)} where the "
                "second, and nothing for no answer"
            ),
        )
    return table.assign(choice=given.map(codes))
