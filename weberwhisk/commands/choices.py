"""`weberwhisk simulate`, `fit` and `next`: simulated choices, fits, and the next trial."""

from __future__ import annotations

import shlex
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import weberwhisk as ww

from .. import commands as opt
from .._util import checks
from .._util.campaign import all_cores
from .._util.output import Run, atomic_write, csv_text, to_json
from .._util.refusals import Refusal
from .._util.values import counted
from . import numbers

if TYPE_CHECKING:
    from ..behaviour import CueEncoding
    from ..design import Hypothesis, Magnitude

__all__ = ["distance_encoding", "fit", "next_trials", "simulate"]

#: Trials from which it is said that a fit takes long: its checks and causes, of 11 500 two minutes.
LONG = 4000


def distance_encoding(
    shape: opt.Shape, cue: str | None, angles_deg: opt.Texts
) -> tuple[CueEncoding | None, ww.Whisker | None]:
    """The encoding and the whisker of the options; None for both without a whisker."""
    if not shape.given:
        for name, given in (("--cue", cue), ("--deflection-angle-deg", angles_deg)):
            if given:
                raise Refusal(f"{name} needs a whisker", "none", "write --identity C2, say")
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
    offset: Annotated[opt.Texts, "Comparison/standard - 1.  [default: nine, -0.3 to 0.3]"] = None,
    weber_fraction: Annotated[float, "The truth to find."] = 0.1,
    lapse_low: Annotated[float, "Share lost at the low end."] = 0.0,
    lapse_high: Annotated[float, "Share lost at the high end."] = 0.0,
    bias: Annotated[
        float | None,
        "Towards the second, or the criterion, in sds.  [default: 0, of same-different 1.6]",
    ] = None,
    noise: Annotated[str, "weber, equal-variance or constant."] = "weber",
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
    task: Annotated[str, "As for fit: 2AFC, go/no-go, same-different and so on."] = "2AFC",
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
    from ..behaviour.priors import usual_bias
    from ..behaviour.simulate import SIGNED_OFFSETS, valued_effects
    from ..behaviour.tasks import task_named
    from ..behaviour.trials import STIMULI

    encoding, whisker = distance_encoding(shape, cue, deflection_angle_deg)
    if encoding is None and standard_mm:
        raise Refusal(
            "--standard-mm needs a whisker",
            "none",
            "write --identity C2, or --standard for magnitudes",
        )
    if encoding is not None and (standard or not standard_mm):
        raise Refusal(
            "Distances encoded through a whisker are given by --standard-mm",
            "--standard" if standard else "none",
            "write --standard-mm 20, say",
        )
    base = numbers("--standard-mm" if encoding else "--standard", standard_mm or standard or ["1"])
    checks.positive("--standard-mm" if encoding else "--standard", base, "write 20, say")
    levels = numbers("--offset", offset) if offset else None
    effects = [effect_valued(text) for text in effect or ()]
    own_task = task_named(task)
    bias = usual_bias(own_task) if bias is None else bias
    truth: dict[str, Any] = {
        "weber_fraction": weber_fraction, "lapse_low": lapse_low, "lapse_high": lapse_high,
        "bias": bias,
    }  # fmt: skip
    with Run(out, "simulate", inputs, seed) as run:
        design: dict[str, Any] = truth | {
            "standards": base, "offsets": levels, "encoding": encoding, "effects": effects,
            "noise": noise, "trials_per_level": trials_per_level, "order": order,
            "sessions": sessions, "missing": missing, "task": task, "seed": seed,
        }  # fmt: skip
        if subjects == 1:
            trials, animals = ww.simulate_trials(**design), None
        else:
            trials, animals = ww.simulate_population(subjects, spread=spread, **design)
        table = trials.table()
        if encoding is not None:
            table = table.rename(columns={name: f"{name}_mm" for name in STIMULI})
        run.table("trials", table)
        true_values = dict(truth)
        if animals is not None:
            true_values |= {"spread": spread, "animals": animals.to_dict("records")}
        by_name = {e.name: value for e, value in valued_effects(effects, trials)}
        if effects:
            true_values |= {"effects": by_name}
        true_values |= {
            "standards": base, "offsets": SIGNED_OFFSETS if levels is None else levels,
            "order": order, "task": trials.task.name, "seed": seed,
            "whisker": None if whisker is None else opt.describe(whisker),
        }  # fmt: skip
        if run.out_dir is not None:
            atomic_write(run.path("truth.json"), to_json(true_values) + "\n")
            if animals is None:
                unit = "mm" if encoding else ""
                free = {name: truth[name] for name in trials.task.lapses}
                free |= {"bias": bias} if trials.task.has_bias else {}
                free |= by_name
                exact = ww.fit_weber(
                    trials, encoding=encoding, noise=noise, effects=[e for e, _ in effects],
                    priors={"weber_fraction": weber_fraction, **free},
                )  # fmt: skip
                run.figure("trials", ww.plots.psychometrics(exact, unit=unit))
    lines = [] if whisker is None else [opt.whisker_line(whisker)]
    many = "" if animals is None else f" of {subjects} animals"
    lines.append(
        f"{counted(len(table), 'trial')}{many} of {trials.task.name}, "
        f"{trials.n_missing} without an answer; {counted(base.size, 'standard')}, "
        f"Weber fraction {weber_fraction:g}, lapses {lapse_low:g} and {lapse_high:g}, "
        f"{own_task.bias_name or 'bias'} {bias:g}, seed {seed}."
    )
    if run.out_dir is None:
        lines.append(csv_text(table).rstrip("\n"))
    answer = {"truth": true_values, "rows": table.astype(object).to_dict("records")}
    opt.finish(run, as_json, answer, *lines)


@opt.command
def fit(
    file: Annotated[
        Path,
        "Table of trials: text (also .gz), Excel, .ods, Parquet, NWB or MATLAB's .mat.",
        {"metavar": "FILE"},
    ],
    column: Annotated[
        opt.Texts,
        "Name of a column in the file, such as choice=response; may be repeated.",
        {"metavar": "OURS=THEIRS"},
    ] = None,
    label: Annotated[
        opt.Texts,
        "Which stimulus an answer calls greater, such as L=first, or whether it is correct, as in "
        "hit=correct, or none; may be repeated.",
        {"metavar": "LABEL=first|second|correct|wrong|none"},
    ] = None,
    task: Annotated[
        opt.Text, "2AFC, 2IFC, yes/no, go/no-go, same-different, '3AFC percent correct' and so on."
    ] = None,
    scale: Annotated[str, "linear, or log where stimuli are logarithms."] = "linear",
    log_unit: Annotated[opt.Number, "Natural-log units per unit of a log column, if known."] = None,
    in_order: Annotated[
        bool | None,
        "Whether rows are in the order in which trials were run.  [default: read off the table]",
    ] = None,
    text_encoding: Annotated[
        opt.Text, "Of a text, such as mac_roman.  [default: read off the text]"
    ] = None,
    subject: Annotated[opt.Text, "The one to fit, where there are several."] = None,
    session: Annotated[
        opt.Text, "Sessions by name, or such as 31-40 or 1,2.", {"metavar": "LIST"}
    ] = None,
    only: opt.Texts = None,
    without: opt.Texts = None,
    bias: Annotated[opt.Text, "none, shared or 'per standard'.  [default: shared]"] = None,
    noise: Annotated[str, "weber, equal-variance or constant."] = "weber",
    effect: Annotated[
        opt.Texts,
        "What else moves the answers: floor, exponent, contraction, noise_by_order, "
        "standard_second, history, win_stay, drift, session_bias, bias_drift, overdispersion; "
        "covariate:COLUMN is another column's, and so is a formula, 'k ~ condition' or "
        "'bias ~ block'; may be repeated.",
        {"metavar": "NAME"},
    ] = None,
    states: Annotated[
        int,
        "States of the animal: 1, engaged throughout; 2, or also answering whatever the stimuli; "
        "3, or also keeping to one side or the other.",
        {"metavar": "1|2|3"},
    ] = 1,
    lapse_prior: Annotated[
        opt.Text,
        "Belief about the lapses at either end, Beta(A, B): short for --prior of both.  "
        "[default: 0.7,20]",
        {"metavar": "A,B"},
    ] = None,
    prior: Annotated[
        opt.Texts,
        "Belief about weber_fraction, lapse_low, lapse_high, bias or criterion, or an effect: a "
        "distribution as scipy.stats has it, bias='norm(0, 2)', or a number that is known; may "
        "be repeated. weber_fraction=levels: the levels shown bracket the thresholds, as when they "
        "were chosen for the animal; not to compare designs, nor for data collected in stages.  "
        "[default: those that the report names]",
        {"metavar": "NAME=BELIEF"},
    ] = None,
    law: Annotated[
        bool, "Test Weber's law against noise as a power of the stimulus, and against a floor."
    ] = False,
    together: Annotated[bool, "Fit all subjects at once, each learning from the others."] = False,
    method: Annotated[opt.Text, "quadrature or emcee.  [default: by the parameters]"] = None,
    shape: opt.Shape = opt.NO_SHAPE,
    cue: str | None = None,
    deflection_angle_deg: opt.Texts = None,
    distances: Annotated[
        Path | None,
        "Where the touches of each trial were located (weberwhisk locate), by columns trial and "
        "interval, in place of nominal distances.",
        {"metavar": "TABLE"},
    ] = None,
    seed: int = 1,
    workers: int | None = None,
    scheduler: str | None = None,
    out: Path | None = None,
    as_json: bool = False,
) -> None:
    """Fit the Weber fraction of one observer, or with --together of many, to a table of choices.

    Columns: stimulus_1 and stimulus_2, or standard and comparison, or log_ratio; choice or correct
    (1 or 0), or counts n and n_greater or n_correct. With a whisker the stimuli are radial
    distances in millimetres, and the columns may be called stimulus_1_mm and so on.
    """
    inputs = opt.as_asked(locals())
    from ..behaviour.effects import effect_named

    encoding, whisker = distance_encoding(shape, cue, deflection_angle_deg)
    reading = {"in_order": in_order, "text_encoding": text_encoding}
    trials = _trials(file, column, label, task, scale, log_unit, encoding, reading)
    trials = _selected(trials, subject, session, together)
    trials = opt.chosen_trials(trials, only, without)
    if encoding is not None:
        _refuse_metres(trials, encoding)
    if distances is not None:
        if encoding is None:
            raise Refusal(
                f"--distances {distances} needs the whisker that touched",
                remedy="add --identity C2, say",
            )
        trials = ww.behaviour.with_distances(trials, distances, encoding)
    priors = _lapse_priors(lapse_prior, trials) | opt.beliefs(prior) or None
    effects = [effect_named(name) for name in effect or ()]
    if together:
        if method or states != 1:
            raise Refusal(
                "--together fits animals in one state, by weighted draws",
                remedy="leave --states and --method out",
            )
        options = {
            "encoding": encoding, "bias": bias, "noise": noise, "priors": priors,
            "effects": effects, "scheduler": scheduler,
            # Few animals are done before other processes have started.
            "workers": 1 if workers is None and len(trials.subjects) < 16
            else all_cores(workers, scheduler),
        }  # fmt: skip
        _fit_together(trials, options, inputs, law, seed, out, as_json)
        return
    if workers is not None or scheduler is not None:
        raise Refusal(
            "--workers and --scheduler fit many subjects at once",
            remedy="add --together, or leave them out",
        )
    if trials.n_trials > LONG and not as_json:
        print(
            f"{trials.n_trials} trials: the checks, and what is behind a misfit if they find one, "
            "may take some minutes.",
            file=sys.stderr, flush=True,
        )  # fmt: skip
    with Run(out, "fit", inputs, seed) as run:
        result = ww.fit_weber(
            trials, encoding=encoding, bias=bias, noise=noise, effects=effects, states=states,
            priors=priors, method=method, seed=seed,
        )  # fmt: skip
        summary = result.summary().reset_index()
        run.table("fit", summary)
        if result.unweighed.is_misfit:
            run.table("causes", result.causes.reset_index())
        answer = result.to_dict()
        report = opt.as_options(result.report())
        if law:
            report += _law(run, result, answer)
        if run.out_dir is not None:
            atomic_write(run.path("fit.json"), to_json(answer) + "\n")
            atomic_write(run.path("fit_report.txt"), report)
            atomic_write(run.path("fit_methods.txt"), result.methods() + "\n")
            if result.status is not ww.behaviour.FitStatus.NO_TRIALS:
                unit = "mm" if encoding else ""
                run.figure("psychometric", ww.plots.psychometrics(result, unit=unit))
            if isinstance(result, ww.behaviour.StateFit):
                run.table("engagement", result.engagement)
                run.figure("engagement", ww.plots.engagement(result))
    lines = [report]
    if bias is None and result.bias == "shared" and trials.standards.size > 1:
        lines.append(
            "One bias was fitted to all standards; `next` and `analyse` have one for each, as has "
            "--bias 'per standard'."
        )
    if whisker is not None:
        lines.insert(0, f"{opt.whisker_line(whisker)} Distances are in millimetres.\n")
    opt.finish(run, as_json, answer, *lines)


def _trials(
    file: Path, column: opt.Texts, label: opt.Texts, task: str | None, scale: str,
    log_unit: float | None, encoding: CueEncoding | None, reading: dict[str, Any],
) -> ww.Trials:  # fmt: skip
    from ..design.session import read_log

    if not file.is_file():
        raise Refusal(f"{str(file)!r} is not a file", remedy="give the path of a table of trials")
    columns = opt.pairs("--column", column, "choice=response")
    if not columns and (kept := read_log(file)) is not None:
        return _of_log(file, *kept, task, scale, log_unit)
    if encoding is not None:
        columns = _with_millimetres(file, columns) | columns
        if scale != "linear":
            raise Refusal(
                "Distances encoded through a whisker are on a linear scale",
                f"{scale!r}",
                "leave --scale out",
            )
    labels = opt.pairs("--label", label, "L=first") or None
    return ww.read_trials(
        file, columns=columns, task=task, choice_labels=labels, scale=scale, log_unit=log_unit,
        **reading,
    )  # fmt: skip


def _of_log(
    file: Path, table: Any, question: dict[str, Any], task: str | None, scale: str,
    log_unit: float | None,
) -> ww.Trials:  # fmt: skip
    """The trials that `next` kept in its log, in the unit of the command."""
    of_task = task or question.get("task")
    trials = ww.read_trials(
        table.assign(session=1), task=of_task, scale=scale, log_unit=log_unit, in_order=True
    )
    return replace(trials, source=str(file))


def _fit_of_log(
    log: Path | None, hypothesis: Hypothesis, of: Magnitude | None, prior: opt.Texts
) -> str:
    """The command that fits what a log keeps as `next` does; none without a log."""
    encoded = opt.encoding_options(hypothesis.encoding)
    if log is None or encoded is None:
        return ""
    of_scale = f" --scale log --log-unit {of.log_unit}" if of is not None and of.is_log else ""
    bias = "" if hypothesis.bias == "shared" else f" --bias {shlex.quote(hypothesis.bias)}"
    believed = "".join(f" --prior {shlex.quote(text)}" for text in prior or ())
    return f"weberwhisk fit {shlex.quote(str(log))}{bias}{believed}{of_scale}{encoded}"


def _with_millimetres(file: Path, columns: dict[str, str]) -> dict[str, str]:
    """The stimulus columns whose names end in their unit, as `simulate` writes them."""
    from ..behaviour.io import millimetres_beside
    from ..recordings.tables import load_table

    try:
        return millimetres_beside(load_table(file).frame, columns)
    except ValueError:  # `read_trials` will raise it again
        return {}


def _lapse_priors(text: str | None, trials: ww.Trials) -> dict[str, Any]:
    if text is None:
        return {}
    from scipy import stats

    shape = numbers("--lapse-prior", [text])
    if shape.size != 2 or (shape <= 0).any():
        raise Refusal("--lapse-prior takes two numbers above zero", f"{text!r}", "write 1,20")
    return {name: stats.beta(*shape.tolist()) for name in trials.task.lapses}


def _law(run: Run, fit: Any, answer: dict[str, object]) -> str:
    """Test Weber's law of a fit, and write its tables; what is added to the report."""
    test = ww.behaviour.weber_law_test(fit)
    run.table("law", test.rivals.reset_index())
    run.table("by_standard", test.by_standard)
    answer["law"] = test.to_dict()
    return f"\nWeber's law.\n{test.report()}\n"


def _fit_together(
    trials: ww.Trials, options: dict[str, Any], inputs: dict[str, Any], law: bool, seed: int,
    out: Path | None, as_json: bool,
) -> None:  # fmt: skip
    quiet: dict[str, Any] = {"progress": lambda done: None} if as_json else {}
    with Run(out, "fit", inputs, seed) as run:
        population = ww.fit_population(trials, seed=seed, **options, **quiet)
        report = opt.as_options(population.report())
        run.table("subjects", population.subjects)
        if population.population is not None:
            run.table("population", population.summary().reset_index())
        if len(population.causes):
            run.table("causes", population.causes.reset_index())
        answer = population.to_dict()
        if law:
            report += _law(run, population, answer)
        if run.out_dir is not None:
            atomic_write(run.path("fit.json"), to_json(answer) + "\n")
            atomic_write(run.path("fit_report.txt"), report)
            atomic_write(run.path("fit_methods.txt"), population.methods() + "\n")
            if population.population is not None:
                unit = "mm" if options["encoding"] else ""
                run.figure("shrinkage", ww.plots.shrinkage(population))
                run.figure("population", ww.plots.population(population, unit=unit))
    opt.finish(run, as_json, answer, report)


def _selected(
    trials: ww.Trials, subject: str | None, session: str | None, together: bool = False
) -> ww.Trials:
    for name, value in (("subject", subject), ("session", session)):
        if value is not None and name not in trials.frame:
            raise Refusal(
                f"{trials.source}: there is no column {name!r}",
                remedy=f"leave --{name} out, or name it with --column {name}='<its name>'",
            )
    if subject is not None:
        named = [one for one in trials.subjects if str(one) == subject]  # "1" is a number there
        trials = trials.select(subject=named or subject)
    elif len(trials.subjects) > 1 and not together:
        raise Refusal(
            f"{trials.source}: there are {len(trials.subjects)} subjects "
            f"({checks.listed(trials.subjects)}), and one is fitted at a time",
            remedy=(
                f"write --subject {shlex.quote(str(trials.subjects[0]))}, or --together for all"
            ),
        )
    if session is not None:
        trials = trials.select(session=opt.values_of(session, trials.sessions))
    return trials


def _refuse_metres(trials: ww.Trials, encoding: CueEncoding) -> None:
    """Refuse distances apparently in metres, and distances beyond the whisker."""
    values = trials.frame[["stimulus_1", "stimulus_2"]].to_numpy(float)
    length = encoding.domain[1]
    if values.max() < 0.002 * length:
        raise Refusal(
            f"{trials.source}: no distance is above {values.max():.3g} mm on a whisker of "
            f"{length:.3g} mm, as if written in metres",
            remedy="write millimetres",
        )
    if values.max() >= length:
        raise Refusal(
            f"{trials.source}: the radial distance {values.max():.4g} mm is beyond the "
            f"whisker's length of {length:.4g} mm",
            remedy="write millimetres, or give the whisker that was used",
        )


@opt.command
def next_trials(
    shape: opt.Shape = opt.NO_SHAPE,
    cue: str | None = None,
    deflection_angle_deg: opt.Texts = None,
    standard: Annotated[opt.Texts, "Magnitudes compared with.", {"also": ("--standards",)}] = None,
    standard_mm: opt.Texts = None,
    magnitude: Annotated[
        opt.Text, "What is compared without a whisker: duration, weight or any other."
    ] = None,
    unit: Annotated[opt.Text, "Of a magnitude, such as ms.  [default: by the magnitude]"] = None,
    goal: Annotated[
        str, "What the trials inform of: weber-fraction, or taper (against a cylinder)."
    ] = "weber-fraction",
    nearest: Annotated[
        float | None, "Least stimulus; mm with a whisker.  [default: 0]", {"also": ("--least",)}
    ] = None,
    farthest: Annotated[
        float, "Greatest stimulus; mm with a whisker.", {"also": ("--greatest",)}
    ] = float("inf"),
    step: Annotated[float, "Stimuli come in steps of this size."] = 0.0,
    easy_share: Annotated[float, "Share of easy trials."] = 0.1,
    width_percent: Annotated[opt.Number, "Stop when k's 95 % interval is within ± this."] = None,
    most: Annotated[int | None, "Stop after so many trials."] = None,
    bias: Annotated[str, "per-standard, shared or none (if answers are scored)."] = "per-standard",
    task: Annotated[str, "As for simulate."] = "2AFC",
    prior: opt.Texts = None,
    log: Annotated[Path | None, "Keeps all trials, to go on later.", {"metavar": "FILE"}] = None,
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
    from ..behaviour.priors import PARAMETERS
    from ..behaviour.trials import STIMULI
    from ..design import (
        BayesianPlacer,
        Constraints,
        Hypothesis,
        Scheme,
        lattice,
        magnitude_named,
        with_priors,
    )
    from ..design.session import Session, converse

    if farthest == float("inf"):
        inputs["farthest"] = None
    encoding, whisker = distance_encoding(shape, cue, deflection_angle_deg)
    of: Magnitude | None = None
    if magnitude is not None or unit is not None:
        if encoding is not None:
            raise Refusal("A whisker's stimuli are distances", "a magnitude", "leave one out")
        of = magnitude_named(magnitude or "stimulus", unit)
    least = of.least if of is not None else 0.0
    nearest = least if nearest is None else nearest
    inputs["nearest"] = nearest if nearest > -float("inf") else None
    name = "--standard" if encoding is None else "--standard-mm"
    texts = standard if encoding is None else standard_mm
    if not texts or (standard if encoding is not None else standard_mm):
        raise Refusal(f"{name} says what is compared with", "none", f"write {name} 20, say")
    at = numbers(name, texts)
    limits = Constraints(nearest, farthest, step or (of.step if of else 0.0))
    checks.one_of("--goal", goal, ("weber-fraction", "taper"))
    bias = bias.replace("-", " ")
    unasked = bias == "per standard" and not task_named(task).has_bias
    how: dict[str, Any] = {"bias": "none" if unasked else bias, "task": task}
    encoded = encoding or (of.encoding if of else IdentityEncoding())
    hypotheses = [Hypothesis("Weber", encoded, **how)]
    scheme = lattice(encoded, at, limits, magnitude=of)
    if goal == "taper":
        if encoding is None or whisker is None or whisker.tip_radius >= whisker.base_radius:
            raise Refusal(
                "--goal taper discriminates a tapered whisker from a cylinder",
                "none",
                "write --identity C2, say",
            )
        observer = ww.Observer(whisker.cylinder(), encoding.observer.cue, encoding.observer.noise)
        of_cylinder = CueEncoding(observer, encoding.deflection_angle, encoding.unit)
        named = {"tapered": encoded, "cylindrical": of_cylinder}
        hypotheses = [Hypothesis(name, of_it, **how) for name, of_it in named.items()]
        offsets = zip(scheme.offsets, lattice(of_cylinder, at, limits).offsets, strict=True)
        both = [sorted({*a, *b}) for a, b in offsets]
        scheme = Scheme(scheme.standards, both, magnitude=scheme.magnitude)
    if prior:
        beliefs = opt.beliefs(prior)
        for parameter in beliefs:
            checks.one_of("--prior", parameter, (*PARAMETERS, "criterion"))
        if "criterion" in beliefs:
            beliefs["bias"] = beliefs.pop("criterion")
        hypotheses = list(with_priors(hypotheses, **beliefs))
    placer = BayesianPlacer(
        hypotheses, scheme, goal="hypothesis" if goal == "taper" else "weber_fraction",
        easy_share=easy_share, width=None if width_percent is None else width_percent / 100,
        most=most, seed=seed,
    )  # fmt: skip
    suffix = "" if encoding is None else "_mm"
    suffix = of.suffix if of is not None else suffix
    repeat = _fit_of_log(log, hypotheses[0], of, prior)
    # Another --most continues the same file.
    question = {name: value for name, value in inputs.items() if name != "most"}
    if not prior:
        del question["prior"]  # files from before there was such an option
    with Run(out, "next", inputs, seed) as run, Session(placer, log, question) as session:
        for line in converse(session, sys.stdin, suffix, repeat):
            print(line, flush=True)
        table = placer.trials().table()
        run.table("trials", table.rename(columns={c: f"{c}{suffix}" for c in STIMULI}))
        if run.out_dir is not None and len(table):
            run.figure("trials", ww.plots.placements(placer))
