"""`weberwhisk design`, `rehearse` and `analyse`: plan, simulate and analyse an experiment."""

from __future__ import annotations

import hashlib
import shlex
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
    from ..design import Constraints, Goal, Magnitude, Plan

__all__ = ["analyse", "design", "rehearse", "rig_trials"]

#: Default levels of `plan_experiment`, as an option.
_LEVELS = "-3.5,-1.5,-0.75,0.75,1.5,3.5"


@opt.command
def design(
    magnitude: Annotated[
        opt.Text,
        "What is compared, where it is no distance along a whisker: duration, weight, 'sound "
        "level', frequency, number or any other, in your words.",
    ] = None,
    unit: Annotated[opt.Text, "Of a magnitude, such as ms.  [default: by the magnitude]"] = None,
    standards: Annotated[opt.Texts, "Magnitudes compared with.", {"also": ("--standard",)}] = None,
    least: Annotated[opt.Number, "Least magnitude that can be put.  [default: 0]"] = None,
    greatest: Annotated[opt.Number, "Greatest magnitude that can be put."] = None,
    step: Annotated[opt.Number, "Step of a magnitude.  [default: a round one]"] = None,
    words: Annotated[
        opt.Text,
        "What the greater and the smaller of two are called.  [default: by the magnitude]",
        {"metavar": "LONGER,SHORTER"},
    ] = None,
    log_unit: Annotated[
        opt.Number, "Natural-log units in a unit that is a logarithm.  [default: of dB, 0.115]"
    ] = None,
    shape: opt.Shape = opt.NO_SHAPE,
    cue: str | None = None,
    deflection_angle_deg: opt.Texts = None,
    task: Annotated[
        opt.Text,
        "2AFC, 2IFC, yes/no, go/no-go (at a pole).  [default: 2AFC, or 2IFC of a --magnitude]",
    ] = None,
    question: Annotated[
        opt.Text,
        "What is to be found: whiskers (tapered or cylinder), weber-law (or constant noise), "
        "precision (of k) or conditions (in which k differs).  [a terminal asks; else whiskers, or "
        "weber-law of a --magnitude]",
    ] = None,
    rival: Annotated[
        opt.Text,
        "Of weber-law: constant, exponent:0.5 (noise as a power of the signal) or floor:20 (noise "
        "that is left, in the unit).  [default: constant]",
        {"metavar": "NAME[:VALUE]"},
    ] = None,
    conditions: Annotated[
        opt.Text, "Two conditions in which k is compared, such as saline,drug.", {"metavar": "A,B"}
    ] = None,
    ratio: Annotated[
        opt.Number, "Goal: conditions told apart where k differs by this factor.  [default: 1.3]"
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
    animals: Annotated[int | None, "How many.  [default: 1]"] = None,
    people: Annotated[int | None, "How many, where those who answer are people."] = None,
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
    title: Annotated[opt.Text, "Of the page.  [default: by the magnitude]"] = None,
    seed: int = 1,
    out: Path | None = None,
    as_json: bool = False,
) -> None:
    """Plan an experiment: stimuli, trials, animals or people, trial lists, and what to expect.

    Of radial distances (--standard-mm, with a whisker), or of any --magnitude (--standards).
    Writes trial lists for PsychoPy and Bpod, a page to print with expected curves and a text for a
    preregistration, and plan.json, which `weberwhisk rehearse` simulates.
    """
    inputs = opt.as_asked(locals())
    from ..design import Contrast, Evidence, Precision, SubjectPopulation

    of, limits = _magnitude_asked(magnitude, unit, (least, greatest, step), words, log_unit)
    whisker: ww.Whisker | None = None
    if of is None:
        whisker = opt.the_whisker(shape if shape.given else opt.Shape("C2"))
        limits = _constraints(nearest_mm, farthest_mm, step_mm)
        if standards:
            raise Refusal(
                "--standards are those of a --magnitude", "none",
                "write --magnitude duration, say, or --standard-mm for distances",
            )  # fmt: skip
        at = numbers("--standard-mm", standard_mm or [])
        checks.positive("--standard-mm", at, "give millimetres, such as 10,20")
        at = at * 1e-3
    else:
        if shape.given or standard_mm:
            raise Refusal(
                f"A plan is of {of.plural} or of distances along a whisker", "both",
                "leave --magnitude out, or the whisker and --standard-mm",
            )  # fmt: skip
        at = numbers("--standards", standards or [])
        checks.finite("--standards", at, "give numbers, such as 10,20")
    levels = numbers("--level", level or [_LEVELS])
    encoded: dict[str, Any] = {}
    if cue is not None or deflection_angle_deg:
        signals, angles = opt.the_cue(cue, deflection_angle_deg)
        encoded = {"cue": signals, "deflection_angle": opt.one_angle(angles)}
    if (question, bayes_factor, half_width, of, conditions, ratio) == (None,) * 6 and not as_json:
        question = inputs["question"] = _question_asked()
    if bayes_factor is not None and half_width is not None:
        raise Refusal(
            "A goal is a Bayes factor or the width of an interval",
            "both",
            "write --bayes-factor or --half-width",
        )
    if people is not None and animals is not None:
        raise Refusal("Those who answer are animals or people", "both", "leave one out")
    who = "subject" if of is not None and animals is None else "animal"
    who = "person" if people is not None else who
    number = next((n for n in (people, animals) if n is not None), 1)
    goal: Goal = Evidence(10.0 if bayes_factor is None else bayes_factor, share)
    if conditions is not None or ratio is not None or question == "conditions":
        if conditions is None:
            raise Refusal("Two conditions have names", "none", "write --conditions saline,drug")
        if bayes_factor is not None or half_width is not None:
            raise Refusal(
                "Two conditions are told apart by the ratio of their k",
                "another goal",
                "write --ratio 1.3",
            )
        question = inputs["question"] = question or "conditions"
        goal = Contrast(1.3 if ratio is None else ratio, share)
    elif half_width is not None or (bayes_factor is None and question == "precision"):
        goal = Precision(0.2 if half_width is None else half_width, share)
    with Run(out, "design", inputs, seed) as run:
        plan = ww.plan_experiment(
            whisker or "C2", magnitude=of, question=question, rival=rival, goal=goal,
            conditions=[name.strip() for name in (conditions or "").split(",") if name.strip()],
            standards=at if at.size else None,
            levels=checks.finite("--level", levels, "write -1,1, say"), best=best,
            trials=trials, animals=number, find=find,
            expected=SubjectPopulation(weber_fraction, spread, lapse, subject=who),
            constraints=limits, trials_per_session=trials_per_session,
            together=False if apart else None, title=title or "",
            runs=runs, task=task, seed=seed, workers=all_cores(workers, scheduler),
            scheduler=scheduler, progress=(lambda done: None) if as_json else None, **encoded,
        )  # fmt: skip
        if run.out_dir is not None:
            from ..plots.designs import fill

            fill(run, plan)
    first_lines = [] if whisker is None else [f"{opt.whisker_line(whisker)}\n"]
    opt.finish(run, as_json, _answer(plan, whisker), *first_lines, _summary(plan))
    if as_json:
        return
    if run.out_dir is None:
        print("Write it, with its trial lists, by naming a folder: --out plan.")
    else:
        print(f"Simulate the whole with: weberwhisk rehearse {run.out_dir / 'plan.json'}")


def _magnitude_asked(
    name: str | None, unit: str | None, limits: tuple[float | None, ...], words: str | None,
    log_unit: float | None,
) -> tuple[Magnitude | None, Constraints | None]:  # fmt: skip
    """The magnitude of the options, and what stimuli there are where that is said."""
    given = {"--unit": unit, "--words": words, "--log-unit": log_unit}
    given |= dict(zip(("--least", "--greatest", "--step"), limits, strict=True))
    if name is None:
        for option, value in given.items():
            if value is not None:
                raise Refusal(
                    f"{option} is of a --magnitude", "none", "write --magnitude duration, say"
                )
        return None, None
    greater, comma, less = (words or "").partition(",")
    if words is not None and not (greater.strip() and less.strip()):
        raise Refusal("--words takes two words, such as longer,shorter", repr(words))
    said = {"greater": greater.strip(), "less": less.strip()} if comma else {}
    least, greatest, step = limits
    of = ww.design.magnitude_named(
        name, unit, least=least, greatest=greatest, step=step, log_unit=log_unit, **said
    )
    limited = least is not None or greatest is not None or step is not None
    return of, ww.design.Constraints(of.least, of.greatest, of.step) if limited else None


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


def _answer(plan: Plan, whisker: ww.Whisker | None) -> dict[str, Any]:
    scheme, power, of = plan.scheme, plan.power, plan.magnitude
    about: dict[str, Any] = {"magnitude": of.name, "unit": of.unit}
    if whisker is not None:
        about = {"whisker": opt.describe(whisker)}
    return about | {
        "goal": str(plan.goal), "animals": scheme.animals,
        "trials_per_animal": scheme.n_trials, "total_trials": scheme.total_trials,
        "sessions": plan.sessions,
        "levels": scheme.table().drop(columns=of.column("offset")).to_dict("records"),
        "power": None if power is None else power.to_dict("records"),
        "trials_sha256": plan.fingerprint,
    }  # fmt: skip


def _summary(plan: Plan) -> str:
    from ..design.plan_file import assumptions, offsets_in_words

    scheme, of = plan.scheme, plan.magnitude
    unit = f" {of.unit}" if of.unit else ""
    lines = [
        f"Goal: {plan.goal}.",
        f"{plan.animals.counted(scheme.animals)} × {scheme.n_trials} trials in "
        f"{counted(plan.sessions, 'session')}, {scheme.total_trials} in all:",
    ]
    for standard, row, n in zip(scheme.standards, scheme.offsets, scheme.trials, strict=True):
        offsets, times = offsets_in_words(row, of), ", ".join(map(str, sorted(set(n))))
        lines.append(f"  standard {of.said(standard)}, offsets {offsets}{unit}, {times} each")
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
    only: opt.Texts = None,
    without: opt.Texts = None,
    out: Path | None = None,
    as_json: bool = False,
) -> None:
    """The preregistered analysis of a plan, on PsychoPy's or Bpod's own output.

    The tables, or Bpod's SessionData (.mat), have the columns of the trial lists, and an answer:
    PsychoPy's <keyboard>.keys (the plan's keys), `response` (1 left, 2 right) or `choice` (1 where
    the second was judged greater: farther, longer).
    """
    for path in (file, *data):
        if not path.is_file():
            raise Refusal(
                f"{str(path)!r} is not a file", remedy="name a plan.json and tables of trials"
            )
    plan = ww.read_plan(file)
    trials = opt.chosen_trials(rig_trials(data, plan), only, without)
    inputs = {
        "plan": str(file), "trials_sha256": plan.fingerprint, "data": [str(d) for d in data],
        "only": only, "without": without,
    }  # fmt: skip
    with Run(out, "analyse", inputs) as run:
        analysis = plan.analyse(trials, unit=1 / plan.magnitude.per_unit)
        words = analysis.report()
        run.table("analysis", analysis.estimates)
        table = "analysed_trials.csv"
        if run.out_dir is not None:
            run.table("analysed_trials", trials.table())
            table = str(run.out_dir / table)
            atomic_write(run.path("analysis.txt"), words)
            atomic_write(run.path("analysis_methods.txt"), analysis.methods())
            run.figure("analysis", ww.plots.analysed(analysis))
    answer: dict[str, Any] = {
        "log_evidence": analysis.log_evidence, "favoured": analysis.favoured(),
        "left_out": analysis.left_out, "rows": analysis.estimates.to_dict("records"),
    }  # fmt: skip
    answer |= dict(zip(("missing", "not_planned"), analysis.departures, strict=True))
    answer |= {"as_planned": analysis.is_as_planned}
    again = _fit_again(plan, trials, table)
    if again and run.out_dir is None:
        again.append("  (--out FOLDER writes that table there.)")
    opt.finish(run, as_json, answer, words.rstrip(), *again)


def _fit_again(plan: Plan, trials: ww.Trials, table: str) -> list[str]:
    """The commands that repeat the Weber fractions, of hypotheses that `fit` has."""
    subjects = trials.subjects or [None]
    whose = "" if len(subjects) == 1 else f" --subject {shlex.quote(str(subjects[0]))}"
    whose = " --together" if plan.together else whose
    # A condition by itself is fitted as a table by itself.
    conditions = plan.scheme.conditions
    by_condition = [f" --only condition={shlex.quote(c)}" for c in conditions] or [""]
    said = []
    for h in plan.hypotheses:
        encoded = opt.encoding_options(h.encoding)
        if encoded is not None:
            noise = "" if h.noise == "weber" else f" --noise {h.noise}"
            of_log = f" --scale log --log-unit {plan.magnitude.log_unit}" * plan.magnitude.is_log
            said += [
                f"  {h.name}: weberwhisk fit {shlex.quote(table)}{whose}{part} --task "
                f"{shlex.quote(h.task)} --bias {shlex.quote(h.bias)}{noise}{of_log}{encoded}"
                for part in by_condition
            ]
    return ["\nThe same numbers again:", *said] if said else []


def rig_trials(files: list[Path], plan: Plan) -> ww.Trials:
    """The trials in the tables of one rig, in their unit; rows without a stimulus are left out."""
    from ..behaviour.trials import STIMULI
    from ..design.session import read_log
    from ..recordings.tables import load_table

    of, task = plan.magnitude, plan.hypotheses[0].task
    notes: list[str] = []
    tables = []
    for path in files:
        if (kept := read_log(path)) is not None:
            columns = {name: of.column(name) for name in STIMULI}
            frame = kept[0].rename(columns=columns).assign(subject=path.stem, session=1)
        else:
            loaded = load_table(path)
            frame = loaded.frame
            notes += [f"{loaded.name}: {note}" for note in loaded.notes]
        tables.append(_with_choice(frame, path, plan))
    table = pd.concat(tables)
    named = {name: of.column(name) for name in STIMULI if of.column(name) in table}
    if "trial" not in table and "trial_number" in table:
        named["trial"] = "trial_number"
    trials = ww.read_trials(
        table.reset_index(drop=True), columns=named, task=task, scale=of.scale,
        log_unit=of.log_unit,
    )  # fmt: skip
    return replace(trials, reading=(*notes, *trials.reading))


def _with_choice(table: pd.DataFrame, file: Path, plan: Plan) -> pd.DataFrame:
    """The trials of one table, with answers as `choice`: 1, 0, or NaN for none."""
    from ..behaviour.tasks import task_named
    from ..behaviour.trials import rows_in_words
    from ..design.session import KEYS, PLACES

    of, question = plan.magnitude, task_named(plan.hypotheses[0].task)
    of_one = question.name in KEYS
    greater = f"the second was judged {of.greater}"
    greater = f"the answer was {question.answer}" if of_one else greater
    of_first = "the other" if of_one else f"the first was judged {of.greater}"
    places = np.arange(1, len(table) + 1)
    for name in (of.column("stimulus_1"), "stimulus_1"):
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
            f"call it choice (1 where {greater}), response or <keyboard>.keys",
        )
    given = table[columns[0]].map(lambda v: str(v).strip().lower().removesuffix(".0"))
    # PsychoPy's keyboard writes sides, a table for Bpod 1 or 2 for them (`trial_lists`).
    no, yes = KEYS.get(question.name) or PLACES.get(question.name, ("left", "right"))
    keys = {"left": 0.0, "right": 1.0, no: 0.0, yes: 1.0}
    keys.pop("None", None)
    codes = keys | {"1": 0.0, "2": 1.0}
    if columns == ["choice"]:
        codes = keys | {"0": 0.0, "1": 1.0, "false": 0.0, "true": 1.0}
    none = "", "nan", "none", "<na>", "null", "na", "n/a"
    if question.name == "go/no-go" and columns[0].endswith(".keys"):
        codes |= dict.fromkeys(none, 0.0)  # not to press is an answer
    unknown = ~given.isin([*codes, *none]).to_numpy()
    if unknown.any():
        raise Refusal(
            f"{str(file)!r}, column {columns[0]!r}, {rows_in_words(places[unknown])}: "
            f"{checks.listed(given[unknown].unique())} is no answer",
            remedy=(
                f"write {', '.join(code for code, second in codes.items() if not second)} "
                f"where {of_first}, {', '.join(code for code, second in codes.items() if second)} "
                f"where {greater}, and nothing for no answer"
            ),
        )
    return table.assign(choice=given.map(codes))
