"""`weberwhisk fit`: the Weber fraction of a table of choices."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import weberwhisk as ww

from .. import commands as opt
from .._util import checks
from .._util.output import Run, atomic_write, to_json
from . import numbers
from .choices import distance_encoding

if TYPE_CHECKING:
    from ..behaviour import CueEncoding

__all__ = ["fit"]


@opt.command
def fit(
    file: Annotated[
        Path,
        "Table of trials: CSV or TSV (also .gz), Excel, Parquet, NWB or Bpod's .mat.",
        {"metavar": "FILE"},
    ],
    column: Annotated[
        opt.Texts,
        "Name of a column in the file, such as choice=response; may be repeated.",
        {"metavar": "OURS=THEIRS"},
    ] = None,
    label: Annotated[
        opt.Texts,
        "Which stimulus an answer calls greater, such as L=first, or none; may be repeated.",
        {"metavar": "LABEL=first|second|none"},
    ] = None,
    task: Annotated[
        opt.Text, "2AFC, 2IFC, yes/no, go/no-go, same-different, '3AFC percent correct' and so on."
    ] = None,
    scale: Annotated[str, "linear, or log where stimuli are logarithms."] = "linear",
    log_unit: Annotated[
        opt.Number, "Natural-log units per unit of a log column, where known."
    ] = None,
    subject: Annotated[opt.Text, "The one to fit, where there are several."] = None,
    session: Annotated[
        opt.Text, "Sessions to fit, such as 31-40 or 1,2.", {"metavar": "LIST"}
    ] = None,
    bias: Annotated[opt.Text, "none, shared or 'per standard'.  [default: shared]"] = None,
    noise: Annotated[str, "weber or equal-variance."] = "weber",
    effect: Annotated[
        opt.Texts,
        "What else moves the answers: floor, contraction, history, win_stay, drift, "
        "overdispersion; covariate:COLUMN is another column's; may be repeated.",
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
        "Belief about the lapses at either end, Beta(A, B).  [default: 0.7,20]",
        {"metavar": "A,B"},
    ] = None,
    prior: Annotated[
        opt.Text,
        "levels: believe that the levels shown bracket the thresholds, as when they were chosen "
        "for the animal; not to compare designs, nor for data collected in stages.  [default: a "
        "median of 0.1, whatever the levels]",
    ] = None,
    law: Annotated[bool, "Compare one Weber fraction with one a standard: Weber's law."] = False,
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
    out: Path | None = None,
    as_json: bool = False,
) -> None:
    """Fit the Weber fraction of one observer to a table of choices.

    Columns: stimulus_1 and stimulus_2, or standard and comparison, or log_ratio; choice or correct
    (1 or 0), or counts n and n_greater or n_correct. With a whisker the stimuli are radial
    distances in millimetres, and the columns may be called stimulus_1_mm and so on.
    """
    inputs = opt.as_asked(locals())
    from ..behaviour.effects import effect_named

    encoding, whisker = distance_encoding(shape, cue, deflection_angle_deg)
    trials = _trials(file, column, label, task, scale, log_unit, encoding)
    trials = _selected(trials, subject, session, together)
    if encoding is not None:
        _refuse_metres(trials, encoding)
    if distances is not None:
        if encoding is None:
            raise ValueError(
                f"--distances {distances} needs the whisker that touched; add --identity C2, say."
            )
        trials = ww.behaviour.with_distances(trials, distances, encoding)
    priors = _lapse_priors(lapse_prior, trials)
    if prior is not None:
        known = checks.one_of("--prior", prior, ("levels",))
        priors = {"weber_fraction": known} | (priors or {})
    if together:
        if effect or law or method or states != 1:
            raise ValueError(
                "--together fits the plain observer, by quadrature; leave --effect, --states, "
                "--law and --method out."
            )
        options = {"encoding": encoding, "bias": bias, "noise": noise, "priors": priors}
        _fit_together(trials, options, inputs, seed, out, as_json)
        return
    effects = [effect_named(name) for name in effect or ()]
    with Run(out, "fit", inputs, seed) as run:
        result = ww.fit_weber(
            trials, encoding=encoding, bias=bias, noise=noise, effects=effects, states=states,
            priors=priors, method=method, seed=seed,
        )  # fmt: skip
        summary = result.summary().reset_index()
        run.table("fit", summary)
        answer = result.to_dict()
        report = opt.with_options(result.report())
        if law:
            test = ww.behaviour.weber_law_test(result)
            run.table("law", test.by_standard)
            answer["law"] = {"rows": test.by_standard.to_dict("records"), "verdict": test.report()}
            report += f"\nWeber's law.\n{test.report()}\n"
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
    if whisker is not None:
        lines.insert(0, f"{opt.whisker_line(whisker)} Distances are in millimetres.\n")
    opt.finish(run, as_json, answer, *lines)


def _trials(
    file: Path, column: opt.Texts, label: opt.Texts, task: str | None, scale: str,
    log_unit: float | None, encoding: CueEncoding | None,
) -> ww.Trials:  # fmt: skip
    if not file.is_file():
        raise ValueError(f"{str(file)!r} is not a file; give the path of a table of trials.")
    columns = opt.pairs("--column", column, "choice=response")
    if encoding is not None:
        columns = _with_millimetres(file) | columns
        if scale != "linear":
            raise ValueError(
                f"Distances encoded through a whisker are on a linear scale, got {scale!r}; "
                "leave --scale out."
            )
    labels = opt.pairs("--label", label, "L=first") or None
    return ww.read_trials(
        file, columns=columns, task=task, choice_labels=labels, scale=scale, log_unit=log_unit
    )


def _with_millimetres(file: Path) -> dict[str, str]:
    """The stimulus columns whose names carry their unit, as `simulate` writes them."""
    from ..behaviour.trials import in_millimetres
    from ..recordings.files import load_table

    try:
        return in_millimetres(load_table(file)[0])
    except ValueError:  # `read_trials` says what is wrong with it
        return {}


def _lapse_priors(text: str | None, trials: ww.Trials) -> dict[str, Any] | None:
    if text is None:
        return None
    from scipy import stats

    shape = numbers("--lapse-prior", [text])
    if shape.size != 2 or (shape <= 0).any():
        raise ValueError(f"--lapse-prior takes two numbers above zero, got {text!r}; write 1,20.")
    return {name: stats.beta(*shape.tolist()) for name in trials.task.lapses}


def _fit_together(
    trials: ww.Trials, options: dict[str, Any], inputs: dict[str, Any], seed: int,
    out: Path | None, as_json: bool,
) -> None:  # fmt: skip
    with Run(out, "fit", inputs, seed) as run:
        found = ww.fit_population(trials, seed=seed, **options)
        run.table("subjects", found.subjects)
        if run.out_dir is not None:
            atomic_write(run.path("fit.json"), found.to_json() + "\n")
            atomic_write(run.path("fit_report.txt"), found.report())
            atomic_write(run.path("fit_methods.txt"), found.methods() + "\n")
            if found.population is not None:
                unit = "mm" if options["encoding"] else ""
                run.figure("shrinkage", ww.plots.shrinkage(found))
                run.figure("population", ww.plots.population(found, unit=unit))
    opt.finish(run, as_json, found.to_dict(), found.report())


def _selected(
    trials: ww.Trials, subject: str | None, session: str | None, together: bool = False
) -> ww.Trials:
    for name, value in (("subject", subject), ("session", session)):
        if value is not None and name not in trials.frame:
            raise ValueError(
                f"{trials.source}: there is no column {name!r}; leave --{name} out, or name it "
                f"with --column {name}='<its name>'."
            )
    if subject is not None:
        own = [one for one in trials.subjects if str(one) == subject]  # "1" is a number there
        trials = trials.select(subject=own or subject)
    elif len(trials.subjects) > 1 and not together:
        raise ValueError(
            f"{trials.source}: there are {len(trials.subjects)} subjects "
            f"({checks.listed(trials.subjects)}), and one is fitted at a time; write "
            f"--subject {shlex.quote(str(trials.subjects[0]))}, or --together for all."
        )
    if session is not None:
        wanted = _sessions(session)
        numeric = all(isinstance(s, int) for s in trials.sessions)
        trials = trials.select(session=wanted if numeric else list(map(str, wanted)))
    return trials


def _sessions(text: str) -> list[int | str]:
    """Whole numbers and ranges, or names as they stand.

    Examples
    --------
    >>> _sessions("1,3-5")
    [1, 3, 4, 5]
    """
    wanted: list[int | str] = []
    for part in map(str.strip, text.split(",")):
        ends = re.fullmatch(r"(\d{1,6})-(\d{1,6})", part)
        if ends:
            wanted.extend(range(int(ends[1]), int(ends[2]) + 1))
        else:
            wanted.append(int(part) if part.isdecimal() else part)
    return wanted


def _refuse_metres(trials: ww.Trials, encoding: CueEncoding) -> None:
    """Distances in metres would be taken for contacts at the base, and give an answer."""
    values = trials.frame[["stimulus_1", "stimulus_2"]].to_numpy(float)
    length = encoding.domain[1]
    if values.max() < 0.002 * length:
        raise ValueError(
            f"{trials.source}: no distance is above {values.max():.3g} mm on a whisker of "
            f"{length:.3g} mm, as if written in metres; write millimetres."
        )
    if values.max() >= length:
        raise ValueError(
            f"{trials.source}: the radial distance {values.max():.4g} mm is beyond the whisker's "
            f"length of {length:.4g} mm; write millimetres, or give the whisker that was used."
        )
