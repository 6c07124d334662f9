"""Designs of experiments: power, plans and rehearsals; plans as a page and as files."""

from __future__ import annotations

import base64
import io
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from html import escape
from importlib import resources
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from .._util import checks
from .._util.output import Run, atomic_write, csv_text
from .._util.refusals import Refusal, argument
from .style import (
    COLOURS,
    DOUBLE,
    LINES,
    SINGLE,
    axes_or_new,
    bars,
    drawable,
    figure_of,
    legend_above,
    legend_over,
    log_numbers,
    look,
    mark,
    new_figure,
    open_figure,
    plain_numbers,
    styled,
)

if TYPE_CHECKING:
    from ..design import AnalysisResult, Plan, TrialLog
    from ..design.power_analysis import Power

__all__ = [
    "analysed", "fill", "placements", "plan_page", "planned_jnds", "planned_psychometrics",
    "power_curve", "rehearsed", "write_plan",
]  # fmt: skip


@styled
def power_curve(found: Power | Plan, ax: Axes | None = None) -> Axes:
    """Plot the power (share of experiments that reach the goal) against the size of experiments.

    The size is the number of animals if only that varies, else that of trials. Bars are Wilson's
    95 % Monte Carlo intervals; for a plan a line marks its own size.

    Raises
    ------
    ValueError
        For a plan without simulated power.

    Examples
    --------
    >>> from weberwhisk import plan_experiment
    >>> ax = power_curve(plan_experiment("C2", standards=[10e-3, 30e-3], trials=10, runs=16))
    >>> ax.get_xlabel()
    'Trials of each comparison'
    """
    scheme = getattr(found, "scheme", None)
    table: Any = getattr(found, "table" if scheme is None else "power")
    if table is None:
        raise Refusal(
            "The plan's power was not looked at", remedy="plan it with " + argument("runs", 512)
        )
    ax = axes_or_new(ax)
    by = "animals" if table["trials"].nunique() == 1 < table["animals"].nunique() else "trials"
    others = [name for name in ("truth", "trials", "animals")
              if name != by and (name == "truth" or table[name].nunique() > 1)]  # fmt: skip
    for i, (key, group) in enumerate(table.groupby(others, sort=False)):
        ordered = group.sort_values(by)
        ends = (ordered[name] for name in ("power", "lower", "upper"))
        more = (f"{n} {v:g}" for n, v in zip(others[1:], key[1:], strict=True))
        words = ", ".join([f"{drawable(key[0])} is true", *more])
        bars(ax, ordered[by], ends, i, linestyle=LINES[i % len(LINES)], label=words)
    style: Any = {"color": "0.6", "linewidth": 0.8, "zorder": 0}
    ax.axhline(found.goal.share, **style, label="goal")
    if scheme is not None:
        planned = scheme.animals if by == "animals" else max(map(max, scheme.trials))
        ax.axvline(planned, **style, linestyle=":", label="planned")
    ax.set_xscale("log")
    log_numbers(ax.xaxis)
    ax.set(xlabel="Animals" if by == "animals" else "Trials of each comparison", ylim=(0, 1.02))
    ax.set_ylabel("Share that reaches the goal")
    return legend_above(ax)


@styled
def planned_psychometrics(plan: Plan, axes: Sequence[Axes] | None = None) -> NDArray[np.object_]:
    """Plot expected answers at every standard, and the curve of every hypothesis fitted to them.

    Answers are those of a typical animal under the first hypothesis; bars hold 95 % of the
    proportions in its number of trials.

    Parameters
    ----------
    plan : Plan
    axes : sequence of Axes, optional
        One per standard.

    Returns
    -------
    array of Axes

    Examples
    --------
    >>> from weberwhisk import plan_experiment
    >>> plan = plan_experiment("C2", standards=[20e-3], levels=[-1, 1], trials=10, runs=0)
    >>> planned_psychometrics(plan).shape
    (1,)
    """
    standards, of = plan.scheme.standards, plan.magnitude
    if axes is None:
        width = SINGLE if len(standards) == 1 else DOUBLE
        figure = open_figure(width, 2.0)
        axes = list(figure.subplots(1, len(standards), sharey=True, squeeze=False)[0])
    for ax, standard in zip(axes, standards, strict=True):
        shown, name = float(of.written(standard)), of.column("standard")
        levels = plan.levels[np.isclose(plan.levels[name], shown)]
        expected = (levels[column] for column in ("expected", "lower", "upper"))
        at = levels[of.column("comparison")]
        bars(ax, at, expected, 0, color=COLOURS[6], label="expected, 95 % by chance")
        for i, hypothesis in enumerate(plan.hypotheses):
            curve = plan.curves.query("hypothesis == @hypothesis.name")
            curve = curve[np.isclose(curve[name], shown)]
            label = drawable(hypothesis.name)
            ax.plot(curve[of.column("comparison")], curve["median"], **look(i), label=label)
        ax.axvline(shown, color="0.8", linewidth=0.8, zorder=0, label="standard")
        ax.set(title=f"standard {drawable(of.said(standard))}", ylim=(-0.03, 1.03))
        plain_numbers(ax.xaxis, most=4)
    figure_of(axes).supxlabel(drawable(of.axis("comparison"), 60))
    axes[0].set_ylabel(f"Reported {drawable(of.greater)}")
    legend_over(figure_of(axes), axes[:1], 9)
    return np.array(axes, dtype=object)


@styled
def planned_jnds(plan: Plan, ax: Axes | None = None) -> Axes:
    """Plot the expected JND curve of every hypothesis, and the expected JND at each standard.

    Bands and bars are predicted 95 % intervals for one typical animal: of the curve from all its
    trials, of a point from the trials at its standard.

    Examples
    --------
    >>> from weberwhisk import plan_experiment
    >>> plan = plan_experiment("C2", standards=[10e-3, 30e-3], trials=10, runs=0)
    >>> planned_jnds(plan).get_xlabel()
    'Radial distance (mm)'
    """
    ax, of = axes_or_new(ax), plan.magnitude
    names = [of.column(name) for name in ("stimulus", "jnd", "lower", "upper")]
    for i, hypothesis in enumerate(plan.hypotheses):
        curve = plan.jnds.query("hypothesis == @hypothesis.name")
        at, jnd, low, high = (curve[name] for name in names)
        ax.fill_between(at, low, high, color=COLOURS[i], alpha=0.2)
        ax.plot(at, jnd, **look(i), label=f"{drawable(hypothesis.name)}, 95 %")
    points = plan.jnds_by_standard
    jnds = (points[name] for name in names[1:])
    bars(ax, points[of.column("standard")], jnds, 0, color=COLOURS[6],
         label="each standard alone, 95 %")  # fmt: skip
    ax.set_ylim(bottom=0)
    plain_numbers(ax.xaxis)
    plain_numbers(ax.yaxis)
    ax.set_xlabel(drawable(of.axis(), 60))
    ax.set_ylabel(f"{drawable(of.axis('JND'), 60)}, {points['criterion'].iloc[0]}")
    return legend_above(ax)


@styled
def rehearsed(result: Power, ax: Axes | None = None) -> Axes:
    """Plot the cumulative distribution of the results of simulated experiments, by truth.

    With several hypotheses: the Bayes factor for the truth, and the criterion in either direction.
    With one: the relative half-width of the interval of k.

    Examples
    --------
    >>> from weberwhisk import plan_experiment, simulate_study
    >>> plan = plan_experiment("C2", standards=[10e-3, 30e-3], trials=10, runs=0)
    >>> rehearsed(simulate_study(plan, 2, seed=1)).get_ylabel()
    'Share of experiments'
    """
    ax = axes_or_new(ax)
    goal = result.goal
    compared = goal.column == "log_bayes_factor"
    unit = np.log(10.0) if compared else 0.01
    for i, (truth, runs) in enumerate(result.runs.groupby("truth", sort=False)):
        values = np.sort(runs[goal.column].to_numpy(float)) / unit
        below = np.arange(1, values.size + 1) / values.size
        ax.step(values, below, where="post", **look(i), label=drawable(truth))
    edge: Any = {"color": "0.6", "linewidth": 0.8, "zorder": 0}
    limit = goal.threshold / unit
    ax.axvline(limit, **edge, label="goal")
    what = f"Half-width of the interval of {goal.quantity} (%)"
    if compared:
        what = "log$_{10}$ Bayes factor for the truth"
        ax.axvline(-limit, **edge, linestyle=":", label="the wrong way")
    ax.set(xlabel=what, ylabel="Share of experiments", ylim=(0, 1))
    return legend_above(ax)


@styled
def analysed(result: AnalysisResult, ax: Axes | None = None) -> Axes:
    """Plot Weber fractions with 95 % intervals, by animal (or for all) and hypothesis.

    Beside a plan's intervals stands how wide they were to be. Without `ax` a second panel has the
    Bayes factor of each hypothesis against the best of the others, where there are several, or the
    ratio of the Weber fractions in two conditions.
    """
    from ..design.goals import Precision

    goal = None if result.plan is None else result.plan.goal
    if ax is None and len(result.log_evidence) > 1:
        figure = open_figure(DOUBLE, 2.8)
        ax, beside = figure.subplots(1, 2, width_ratios=[1.4, 1.0])
        _bayes_factors(result, beside)
    if ax is None and result.ratio is not None:
        figure = open_figure(DOUBLE, 2.8)
        ax, beside = figure.subplots(1, 2, width_ratios=[2.5, 1.0])
        first, second = map(drawable, result.ratio.conditions)
        ratio = ([result.ratio.median], [result.ratio.lower], [result.ratio.upper])
        bars(beside, [0.0], ratio, 6)
        beside.axhline(1.0, color="0.7", linewidth=0.8, zorder=0)
        beside.set(xticks=[], xlim=(-1, 1), ylabel=f"k in {second} / k in {first}, 95 %")
        plain_numbers(beside.yaxis)
    ax = axes_or_new(ax)
    subjects = list(dict.fromkeys(result.estimates["subject"]))
    middle = (len(result.log_evidence) - 1) / 2
    series = [(name, result.of(name)) for name in result.log_evidence]
    if "condition" in result.estimates:
        groups = result.estimates.groupby("condition", sort=False)
        series = [(str(name), group) for name, group in groups]
        middle = (len(series) - 1) / 2
    for i, (name, estimates) in enumerate(series):
        interval = (estimates[column] for column in ("weber_fraction", "lower", "upper"))
        at = [subjects.index(s) + 0.15 * (i - middle) for s in estimates["subject"]]
        if isinstance(goal, Precision):
            k, planned = estimates["weber_fraction"].to_numpy(float), goal.half_width
            label = f"planned ±{100 * planned:g} %" if i == 0 else "_nolegend_"
            ax.vlines(at, k * (1 - planned), k * (1 + planned), color="0.85", linewidth=7,
                      zorder=0, label=label)  # fmt: skip
        bars(ax, at, interval, i, label=f"{drawable(name)}, 95 %")
    ax.set_xticks(range(len(subjects)), [drawable(str(s)) for s in subjects])
    who = "animal" if result.plan is None else result.plan.animals.subject
    who = f"{who[0].upper()}{who[1:]}"
    ax.set(xlabel=who, ylabel="Weber fraction k", xlim=(-0.6, len(subjects) - 0.4))
    ends = result.estimates[["lower", "upper"]].to_numpy(float)
    if np.nanmax(ends) > 5 * np.nanmin(ends):
        ax.set_yscale("log")
        log_numbers(ax.yaxis)
    else:
        plain_numbers(ax.yaxis)
    return legend_above(ax)


def _bayes_factors(result: AnalysisResult, ax: Axes) -> None:
    """Draw the Bayes factor of each hypothesis against the best of the others, and the goal."""
    from ..design.goals import Evidence

    names = list(result.log_evidence)
    for i, name in enumerate(names):
        ax.plot(result.log_bayes_factor(name) / np.log(10.0), i, **mark(i, markersize=5))
    ax.axvline(0.0, color="0.8", linewidth=0.8, zorder=0)
    goal = None if result.plan is None else result.plan.goal
    if isinstance(goal, Evidence):
        limit = goal.threshold / np.log(10.0)
        ax.axvline(limit, color="0.5", linewidth=0.8, linestyle=":", label="planned")
        ax.axvline(-limit, color="0.5", linewidth=0.8, linestyle=":")
    ax.set_yticks(range(len(names)), [drawable(name) for name in names])
    ax.set_ylim(len(names) - 0.5, -0.5)
    ax.margins(x=0.15)
    ax.set_xlabel("log$_{10}$ Bayes factor")
    legend_above(ax)


@styled
def placements(placer: TrialLog, ax: Axes | None = None) -> Axes:
    """Plot the comparisons of a session in order, and whether they were judged greater.

    Without `ax` also the Weber fraction after every trial with its 95 % interval, where the trials
    were placed by it.
    """
    from ..behaviour.tasks import task_named

    course = np.array(getattr(placer, "course", [])).reshape(-1, 4)
    below = None
    if ax is None and len(course):
        figure = open_figure(SINGLE, 4.2)
        ax, below = figure.subplots(2, 1, sharex=True)
    ax = axes_or_new(ax, SINGLE, 2.8)
    trials = placer.trials().frame
    task, of = task_named(placer.hypotheses[0].task), placer.magnitude
    offset = of.written(trials["stimulus_2"] - trials["stimulus_1"])
    yes = f"second {of.greater}" if task.is_difference else task.answer.strip('"')
    no = f"first {of.greater}" if task.is_difference else f"not {yes}"
    for i, (answer, label) in enumerate(((1.0, yes), (0.0, no))):
        chosen = trials["count"] == answer
        ax.plot(trials["trial"][chosen], offset[chosen], **mark(i, markersize=2.5), label=label)
    ax.axhline(0, color="0.7", linewidth=0.8, zorder=0)
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ax.set_ylabel(drawable(of.axis("comparison − standard"), 60))
    plain_numbers(ax.yaxis)
    if below is not None:
        trial, low, middle, high = course.T
        below.fill_between(trial, low, high, color=COLOURS[4], alpha=0.35, step="post")
        below.step(trial, middle, where="post", color=COLOURS[0])
        below.set_yscale("log")
        log_numbers(below.yaxis)
        below.set_ylabel("Weber fraction k, 95 %")
    (ax if below is None else below).set_xlabel("Trial")
    return legend_above(ax)


# -- a plan as files -------------------------------------------------------------------------------


def plan_page(plan: Plan) -> str:
    """The plan on one A4 page: numbers, expected curves, assumptions, preregistration.

    One file of HTML, with figures inside it as SVG.

    Examples
    --------
    >>> from weberwhisk import plan_experiment
    >>> plan = plan_experiment("C2", standards=[20e-3], levels=[-1, 1], trials=10, runs=0)
    >>> plan_page(plan).startswith("<!DOCTYPE html>")
    True
    """
    from ..design.plan_file import assumptions, preregistration

    who = plan.animals.subject
    title, *paragraphs = preregistration(plan).strip().split("\n\n")
    wide = 100 if len(plan.scheme.standards) > 1 else 50
    halves = [_image(_half(planned_jnds, plan), "Expected JND curves")]
    if plan.power is not None:
        halves.append(_image(_half(power_curve, plan), "Power"))
    psychometrics = figure_of(planned_psychometrics(plan))
    heads = (" ".join(p.split()).partition(". ") for p in paragraphs)
    page = resources.files("weberwhisk").joinpath("data/plan.html").read_text("utf-8")
    return Template(page).substitute(
        title=escape(title),
        numbers=_each("<tr><th>{}</th><td>{}</td></tr>", _numbers(plan)),
        assumptions=_each("<li>{}</li>", ((line,) for line in assumptions(plan))),
        psychometrics=_image(psychometrics, "Expected psychometric functions", wide),
        halves="".join(f'<div class="half">{half}</div>' for half in halves),
        subject=who,
        a_subject=f"{'an' if who[0] in 'aeiou' else 'a'} {who}",
        preregistration=_each("<p><b>{}.</b> {}</p>", ((h, rest) for h, _, rest in heads)),
    )


def _each(form: str, records: Iterable[tuple[str, ...]]) -> str:
    """HTML of a table's rows: each filled, escaped, into a form."""
    return "".join(form.format(*map(escape, row)) for row in records)


def _numbers(plan: Plan) -> list[tuple[str, str]]:
    from ..design.plan_file import offsets_in_words

    scheme, of, who = plan.scheme, plan.magnitude, plan.animals
    unit = f" {of.unit}" if of.unit else ""
    return [
        ("Goal", str(plan.goal)),
        ("Hypotheses", ", ".join(h.name for h in plan.hypotheses)),
        (f"{who.subjects[0].upper()}{who.subjects[1:]}", f"{scheme.animals}"),
        ("Trials", f"{scheme.n_trials} each, {scheme.total_trials} in all"),
        ("Sessions", f"{plan.sessions} each, of at most {plan.trials_per_session} trials"),
        ("Standards", of.listed(scheme.standards)),
        *((f"Offsets at {of.said(s)}", f"{offsets_in_words(row, of)}{unit}")
          for s, row in zip(scheme.standards, scheme.offsets, strict=True)),
    ]  # fmt: skip


@styled
def _half(draw: Callable[[Plan, Axes], Any], plan: Plan) -> Any:
    figure = new_figure(DOUBLE / 2, 2.0)
    draw(plan, figure.subplots())
    return figure


def _image(figure: Any, alt: str, percent: int = 100) -> str:
    content = io.BytesIO()
    figure.savefig(content, format="svg", metadata={"Date": None})
    text = base64.b64encode(content.getvalue()).decode("ascii")
    source = f"data:image/svg+xml;base64,{text}"
    return f'<img alt="{escape(alt)}" style="width: {percent}%" src="{source}">'


def write_plan(
    plan: Plan, out: str | os.PathLike[str], *, inputs: Mapping[str, Any] | None = None
) -> Path:
    """Write all files that an experiment needs into one folder: all of them or none.

    - ``plan.json``: the plan, for `read_plan` and `weberwhisk rehearse`;
    - ``plan.html``: one page to print; ``preregistration.txt``: its text;
    - ``trials.csv``: all trial lists, which `weberwhisk fit` reads with the answers added;
    - ``psychopy_<animal>_<session>.csv``: a conditions file for every session;
    - ``bpod.csv``: all trials, in numbers only;
    - ``planned_levels.csv``, ``planned_jnds.csv``, ``planned_power.csv`` and figures of them.

    Parameters
    ----------
    plan : Plan
    out : path
        Folder, created if missing.
    inputs : mapping, optional
        The inputs of the plan, for the record ``design.run.json``.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    ValueError
        As `Run`: if the folder cannot be written or holds other files.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> from weberwhisk import plan_experiment
    >>> plan = plan_experiment("C2", standards=[20e-3], levels=[-1, 1], trials=10, runs=0)
    >>> with TemporaryDirectory() as folder:
    ...     sorted(path.name for path in write_plan(plan, folder).glob("p*.csv"))
    ['planned_jnds.csv', 'planned_levels.csv', 'psychopy_s1_001.csv']
    """
    checks.kind("plan", plan, "a Plan", "scheme", "write ww.plan_experiment(...), say")
    with Run(out, "design", dict(inputs or {}), plan.seed) as run:
        fill(run, plan)
    assert run.out_dir is not None
    return run.out_dir


def fill(run: Run, plan: Plan) -> None:
    """Write the files of a plan in an open run; none if the run has no folder."""
    from ..design.plan_file import plan_json, preregistration
    from ..design.session import bpod_table, psychopy_tables, with_places

    if run.out_dir is None:
        return
    task = plan.hypotheses[0].task
    lists = with_places(plan.trials, task)
    for name, text in (
        ("plan.json", plan_json(plan)),
        ("plan.html", plan_page(plan)),
        ("preregistration.txt", preregistration(plan)),
        ("trials.csv", csv_text(lists)),
        ("bpod.csv", csv_text(bpod_table(lists))),
        *((f"{name}.csv", csv_text(table)) for name, table in psychopy_tables(lists, task)),
    ):
        atomic_write(run.path(name), text)
    run.table("planned_levels", plan.levels)
    run.table("planned_jnds", plan.jnds)
    run.figure("planned_psychometric", planned_psychometrics(plan))
    run.figure("planned_jnd", planned_jnds(plan))
    if plan.power is not None:
        run.table("planned_power", plan.power)
        run.figure("planned_power", power_curve(plan))
