"""Designs of experiments: power, plans and rehearsals."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from .._util.values import pd
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
    look,
    mark,
    open_figure,
    styled,
)

if TYPE_CHECKING:
    from ..design import AnalysisResult, Plan, TrialLog
    from ..design.experiment import SimulatedStudy
    from ..design.power_analysis import Power

__all__ = [
    "analysed", "placements", "planned_jnds", "planned_power",
    "planned_psychometrics", "power_curve", "rehearsed",
]  # fmt: skip


@styled
def power_curve(power: Power, ax: Axes | None = None) -> Axes:
    """Share of experiments that reach the goal against their size, with Monte Carlo intervals.

    Against the number of animals where that alone varies, else against trials.

    Examples
    --------
    >>> from weberwhisk import Whisker, power
    >>> from weberwhisk.design import Scheme, taper
    >>> hypotheses = taper(Whisker(50e-3, 100e-6, 5e-6))
    >>> scheme = Scheme.spaced(hypotheses[0].encoding, [15e-3, 45e-3])
    >>> found = power(scheme, hypotheses, trials=[5, 10], truths=["tapered"], runs=16, seed=1)
    >>> power_curve(found).get_ylabel()
    'Power'
    """
    ax = axes_or_new(ax)
    table = power.table
    by = "animals" if table["trials"].nunique() == 1 < table["animals"].nunique() else "trials"
    others = [name for name in ("truth", "trials", "animals")
              if name != by and (name == "truth" or table[name].nunique() > 1)]  # fmt: skip
    for i, (key, own) in enumerate(table.groupby(others, sort=False)):
        more = (f"{n} {v:g}" for n, v in zip(others[1:], key[1:], strict=True))
        _shares(ax, own.sort_values(by), own[by].sort_values(), i, [drawable(key[0]), *more])
    ax.axhline(power.goal.share, color="0.6", linewidth=0.8, linestyle=":", label="goal")
    ax.set_xscale("log")
    sizes = np.unique(table[by])
    ax.set_xticks(sizes, [f"{size:g}" for size in sizes])
    ax.minorticks_off()
    ax.set(xlabel="Animals" if by == "animals" else "Trials of each comparison", ylim=(0, 1))
    ax.set_ylabel("Power")
    return legend_above(ax)


@styled
def planned_psychometrics(plan: Plan, axes: Sequence[Axes] | None = None) -> NDArray[np.object_]:
    """Expected answers at every standard, with the curve of every hypothesis fitted to them.

    The animal is a typical one and as the first hypothesis has it; bars hold 95 % of the shares
    that chance makes of its trials.

    Parameters
    ----------
    plan : Plan
    axes : sequence of Axes, optional
        One a standard.

    Returns
    -------
    array of Axes

    Examples
    --------
    >>> from weberwhisk import plan_experiment
    >>> plan = plan_experiment("C2", standards=[10e-3, 30e-3], trials=10, runs=0)
    >>> planned_psychometrics(plan).shape
    (2,)
    """
    standards = plan.scheme.standards
    if axes is None:
        width = SINGLE if len(standards) == 1 else DOUBLE
        figure = open_figure(width, 2.0)
        axes = list(figure.subplots(1, len(standards), sharey=True, squeeze=False)[0])
    for ax, standard in zip(axes, standards, strict=True):
        mm = 1e3 * standard
        levels = plan.levels[np.isclose(plan.levels["standard_mm"], mm)]
        expected = (levels[name] for name in ("expected", "lower", "upper"))
        at = levels["comparison_mm"]
        bars(ax, at, expected, 0, color=COLOURS[6], label="expected, 95 % by chance")
        for i, hypothesis in enumerate(plan.hypotheses):
            own = plan.curves.query("hypothesis == @hypothesis.name")
            own = own[np.isclose(own["standard_mm"], mm)]
            ax.plot(own["comparison_mm"], own["median"], **look(i), label=drawable(hypothesis.name))
        ax.axvline(mm, color="0.8", linewidth=0.8, zorder=0, label="standard")
        ax.set(title=f"standard {mm:.3g} mm", ylim=(-0.03, 1.03))
        ax.xaxis.set_major_locator(MaxNLocator(4))
    figure_of(axes).supxlabel("Comparison (mm)")
    axes[0].set_ylabel("Reported farther")
    legend_over(figure_of(axes), axes[:1], 9)
    return np.array(axes, dtype=object)


@styled
def planned_jnds(plan: Plan, ax: Axes | None = None) -> Axes:
    """Expected JND curves of every hypothesis, and the JND that every standard will tell.

    Bands and bars are the predicted 95 % intervals of one typical animal: the curve's from all its
    trials, a point's from those of its standard alone.

    Examples
    --------
    >>> from weberwhisk import plan_experiment
    >>> plan = plan_experiment("C2", standards=[10e-3, 30e-3], trials=10, runs=0)
    >>> planned_jnds(plan).get_xlabel()
    'Radial distance (mm)'
    """
    ax = axes_or_new(ax)
    for i, hypothesis in enumerate(plan.hypotheses):
        own = plan.jnds.query("hypothesis == @hypothesis.name")
        at, low, high = (own[f"{name}_mm"] for name in ("stimulus", "lower", "upper"))
        ax.fill_between(at, low, high, color=COLOURS[i], alpha=0.2)
        ax.plot(at, own["jnd_mm"], **look(i), label=f"{drawable(hypothesis.name)}, 95 %")
    points = plan.jnds_by_standard
    known = (points[name] for name in ("jnd_mm", "lower_mm", "upper_mm"))
    bars(ax, points["standard_mm"], known, 0, color=COLOURS[6], label="each standard alone, 95 %")
    ax.set_ylim(bottom=0)
    ax.set(xlabel="Radial distance (mm)", ylabel=f"JND (mm), {points['criterion'].iloc[0]}")
    return legend_above(ax)


@styled
def planned_power(plan: Plan, ax: Axes | None = None) -> Axes:
    """How often the goal is reached, against the size of the experiment, by which truth.

    Bars are Wilson's 95 % intervals of the simulations; lines mark the goal and the plan.

    Raises
    ------
    ValueError
        For a plan whose power was not looked at.

    Examples
    --------
    >>> from weberwhisk import plan_experiment
    >>> ax = planned_power(plan_experiment("C2", standards=[10e-3, 30e-3], trials=10, runs=16))
    >>> ax.get_xlabel()
    'Trials of an animal'
    """
    if plan.power is None:
        raise ValueError("The plan's power was not looked at; plan it with runs=512.")
    ax = axes_or_new(ax)
    by_animals = plan.power["animals"].nunique() > 1
    most = max(map(max, plan.scheme.trials))
    unit = 1.0 if by_animals else plan.scheme.n_trials / most
    planned = plan.scheme.animals if by_animals else plan.scheme.n_trials
    for i, hypothesis in enumerate(plan.hypotheses):
        own = plan.power.query("truth == @hypothesis.name").sort_values(["animals", "trials"])
        at = own["animals" if by_animals else "trials"] * unit
        _shares(ax, own, at, i, [f"{drawable(hypothesis.name)} is true"])
    ax.axhline(plan.goal.share, color="0.6", linewidth=0.8, zorder=0, label="goal")
    ax.axvline(planned, color="0.6", linewidth=0.8, zorder=0, linestyle=":", label="planned")
    ax.set(ylabel="Share that reaches the goal", ylim=(0, 1.02))
    ax.set_xlabel("Animals" if by_animals else "Trials of an animal")
    ax.set_xlim(left=0)
    return legend_above(ax)


def _shares(ax: Axes, rows: pd.DataFrame, at: Any, i: int, words: Sequence[str]) -> None:
    """Shares of experiments that reach the goal, over their sizes, with Monte Carlo intervals."""
    ends = (rows[name] for name in ("power", "lower", "upper"))
    bars(ax, at, ends, i, linestyle=LINES[i % len(LINES)], label=", ".join(words))


@styled
def rehearsed(result: SimulatedStudy, ax: Axes | None = None) -> Axes:
    """What came out of every rehearsed experiment, truth by truth.

    With hypotheses to compare: the Bayes factor for the truth, cumulated over the runs, and the
    criterion either way. With one: the relative half-width of the interval of k.

    Examples
    --------
    >>> from weberwhisk import plan_experiment, simulate_study
    >>> plan = plan_experiment("C2", standards=[10e-3, 30e-3], trials=10, runs=0)
    >>> rehearsed(simulate_study(plan, 2, seed=1)).get_ylabel()
    'Share of experiments'
    """
    ax = axes_or_new(ax)
    goal = result.plan.goal
    compared = goal.bayes_factor is not None
    column = "log_bayes_factor" if compared else "half_width"
    unit = np.log(10.0) if compared else 0.01
    for i, (truth, own) in enumerate(result.table.groupby("truth", sort=False)):
        values = np.sort(own[column].to_numpy(float)) / unit
        below = np.arange(1, values.size + 1) / values.size
        ax.step(values, below, where="post", **look(i), label=drawable(truth))
    edge: Any = {"color": "0.6", "linewidth": 0.8, "zorder": 0}
    limit = np.log10(goal.bayes_factor) if goal.bayes_factor else 100 * (goal.half_width or 0)
    ax.axvline(limit, **edge, label="goal")
    what = "Half-width of the interval of k (%)"
    if compared:
        what = "log$_{10}$ Bayes factor for the truth"
        ax.axvline(-limit, **edge, linestyle=":", label="the wrong way")
    ax.set(xlabel=what, ylabel="Share of experiments", ylim=(0, 1))
    return legend_above(ax)


@styled
def analysed(result: AnalysisResult, ax: Axes | None = None) -> Axes:
    """The Weber fraction of every animal, or of all together, under each hypothesis.

    Bars are 95 % intervals.

    Parameters
    ----------
    result : AnalysisResult
    ax : Axes, optional
    """
    ax = axes_or_new(ax)
    subjects = list(dict.fromkeys(result.estimates["subject"]))
    middle = (len(result.log_evidence) - 1) / 2
    for i, name in enumerate(result.log_evidence):
        own = result.of(name)
        ends = (own[column] for column in ("weber_fraction", "lower", "upper"))
        at = [subjects.index(s) + 0.15 * (i - middle) for s in own["subject"]]
        bars(ax, at, ends, i, label=f"{drawable(name)}, 95 %")
    ax.set_xticks(range(len(subjects)), [drawable(str(s)) for s in subjects])
    ax.set(xlabel="Animal", ylabel="Weber fraction k", xlim=(-0.6, len(subjects) - 0.4))
    ax.set_yscale("log")
    return legend_above(ax)


@styled
def placements(placer: TrialLog, ax: Axes | None = None) -> Axes:
    """The comparisons of a session in order, and whether they were judged greater.

    Parameters
    ----------
    placer : TrialLog
        After some trials.
    ax : Axes, optional
    """
    ax = axes_or_new(ax, SINGLE, 2.8)
    rows = placer.trials().frame
    offset = rows["stimulus_2"] - rows["stimulus_1"]
    for i, (answer, label) in enumerate(((1.0, "counted answer"), (0.0, "the other"))):
        own = rows["count"] == answer
        ax.plot(rows["trial"][own], offset[own], **mark(i, markersize=2.5), label=label)
    ax.axhline(0, color="0.7", linewidth=0.8, zorder=0)
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ax.set(xlabel="Trial", ylabel="Comparison − standard")
    return legend_above(ax)
