"""Designs of experiments: information, power, plans, rehearsals, trials placed one by one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from .fits import binomial_interval
from .style import (
    COLOURS,
    DOUBLE,
    LINES,
    MARKERS,
    SINGLE,
    axes_or_new,
    bars,
    drawable,
    figure_of,
    legend_above,
    legend_over,
    look,
    open_figure,
    styled,
)

if TYPE_CHECKING:
    import pandas as pd

    from ..design import Plan, TrialLog
    from ..design.power_analysis import Power
    from ..design.simulated_study import SimulatedStudy

#: What the columns of `information_map` are about.
ABOUT = {"weber_fraction": "k", "jnd": "the JND", "hypothesis": "the hypothesis"}


@styled
def information_map(
    table: pd.DataFrame, ax: Axes | None = None, *, about: str = "weber_fraction"
) -> Axes:
    """Information of one trial over standard and offset, millibits; a ring where it is greatest.

    Parameters
    ----------
    table : DataFrame
        From `weberwhisk.design.information`.
    ax : Axes, optional
    about : {"weber_fraction", "jnd", "hypothesis"}

    Examples
    --------
    >>> from weberwhisk.behaviour import IdentityEncoding
    >>> from weberwhisk.design import Hypothesis, information as bits
    >>> table = bits([Hypothesis("Weber", IdentityEncoding())], [1e-3, 2e-3], [-1e-4, 0.0, 1e-4])
    >>> information_map(table).get_xlabel()
    'Standard (mm)'
    """
    ax = axes_or_new(ax)
    shape = table["standard_mm"].nunique(), -1
    standard, offset, bits = (
        table[name].to_numpy(float).reshape(shape)
        for name in ("standard_mm", "offset_mm", f"{about}_bits")
    )
    shown = np.ma.masked_invalid(1e3 * bits)
    mesh = ax.pcolormesh(standard, offset, shown, shading="nearest", cmap="cividis", vmin=0.0)
    figure_of(ax).colorbar(mesh, ax=ax, label=f"About {ABOUT[about]} (millibit)")
    best = np.unravel_index(np.nanargmax(bits), bits.shape)
    ring: dict[str, Any] = {"linestyle": "none", "marker": "o", "markerfacecolor": "none"}
    ring["markersize"] = 7
    ax.plot(standard[best], offset[best], **ring, color="w")
    ax.plot([], [], **ring, color="black", label="the most")
    ax.axhline(0.0, color="w", linewidth=0.5)
    ax.set_xlabel("Standard (mm)")
    ax.set_ylabel("Offset (mm)")
    legend_above(ax)
    return ax


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
    others = [name for name in ("truth", "lapse", "trials", "animals")
              if name != by and (name == "truth" or table[name].nunique() > 1)]  # fmt: skip
    for i, (key, own) in enumerate(table.groupby(others, sort=False)):
        own = own.sort_values(by)
        words = [drawable(key[0])] + [
            f"{n} {v:g}" for n, v in zip(others[1:], key[1:], strict=True)
        ]
        ends = own["power"], own["lower"], own["upper"]
        bars(ax, own[by], ends, i, linestyle=LINES[i % 4], label=", ".join(words))
    ax.axhline(power.goal.share, color="0.6", linewidth=0.8, linestyle=":", label="goal")
    ax.set_xscale("log")
    sizes = np.unique(table[by])
    ax.set_xticks(sizes, [f"{size:g}" for size in sizes])
    ax.minorticks_off()
    ax.set_ylim(0.0, 1.0)
    ax.set_xlabel("Animals" if by == "animals" else "Trials of each comparison")
    ax.set_ylabel("Assurance" if power.assurance else "Power")
    legend_above(ax)
    return ax


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
    >>> from weberwhisk import Whisker
    >>> from weberwhisk.design import Goal, Plan, Scheme, taper
    >>> scheme = Scheme([15e-3, 40e-3], [-2e-3, -1e-3, 1e-3, 2e-3])
    >>> plan = Plan(scheme, taper(Whisker(50e-3, 100e-6, 5e-6)), Goal(bayes_factor=10))
    >>> planned_psychometrics(plan).shape
    (2,)
    """
    standards = plan.scheme.standards
    if axes is None:
        width = SINGLE if len(standards) == 1 else DOUBLE
        axes = list(
            open_figure(width, 2.0).subplots(1, len(standards), sharey=True, squeeze=False)[0]
        )
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
        ax.axvline(mm, color="0.8", linewidth=0.8, zorder=0)
        ax.set_ylim(-0.03, 1.03)
        ax.xaxis.set_major_locator(MaxNLocator(4))
        ax.set_title(f"standard {mm:.3g} mm")
    figure = figure_of(axes)
    figure.supxlabel("Comparison (mm)")
    axes[0].set_ylabel("Reported farther")
    legend_over(figure, axes[:1], 9)
    return np.array(axes, dtype=object)


@styled
def planned_jnds(plan: Plan, ax: Axes | None = None) -> Axes:
    """Expected JND curves of every hypothesis, and the JND that every standard will tell.

    Bands and bars are the predicted 95 % intervals of one typical animal: the curve's from all its
    trials, a point's from those of its standard alone.

    Examples
    --------
    >>> from weberwhisk import Whisker
    >>> from weberwhisk.design import Goal, Plan, Scheme, taper
    >>> scheme = Scheme([15e-3, 40e-3], [-2e-3, -1e-3, 1e-3, 2e-3])
    >>> plan = Plan(scheme, taper(Whisker(50e-3, 100e-6, 5e-6)), Goal(bayes_factor=10))
    >>> planned_jnds(plan).get_xlabel()
    'Radial distance (mm)'
    """
    ax = axes_or_new(ax)
    for i, hypothesis in enumerate(plan.hypotheses):
        own = plan.jnds.query("hypothesis == @hypothesis.name")
        at = own["stimulus_mm"]
        ax.fill_between(
            at, own["lower_mm"], own["upper_mm"], color=COLOURS[i], alpha=0.2, linewidth=0
        )
        ax.plot(at, own["jnd_mm"], **look(i), label=f"{drawable(hypothesis.name)}, 95 %")
    points = plan.jnds_by_standard
    known = (points[name] for name in ("jnd_mm", "lower_mm", "upper_mm"))
    bars(ax, points["standard_mm"], known, 0, color=COLOURS[6], label="each standard alone, 95 %")
    ax.set_ylim(bottom=0)
    ax.set_xlabel("Radial distance (mm)")
    ax.set_ylabel(f"JND (mm), {points['criterion'].iloc[0]}")
    legend_above(ax)
    return ax


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
        at = own["animals" if by_animals else "trials"].to_numpy(float) * unit
        found = (own[name] for name in ("power", "lower", "upper"))
        label = f"{drawable(hypothesis.name)} is true"
        bars(ax, at, found, i, linestyle=LINES[i % 4], label=label)
    ax.axhline(plan.goal.share, color="0.6", linewidth=0.8, zorder=0, label="goal")
    ax.axvline(planned, color="0.6", linewidth=0.8, zorder=0, linestyle=":", label="planned")
    ax.set_ylim(0, 1.02)
    ax.set_xlim(left=0)
    ax.set_xlabel("Animals" if by_animals else "Trials of an animal")
    ax.set_ylabel("Share that reaches the goal")
    legend_above(ax)
    return ax


@styled
def rehearsed(result: SimulatedStudy, ax: Axes | None = None) -> Axes:
    """What came out of every rehearsed experiment, truth by truth.

    With hypotheses to compare: the Bayes factor for the truth, cumulated over the runs, and the
    criterion either way. With one: the relative half-width of the interval of k.

    Examples
    --------
    >>> from weberwhisk import Whisker
    >>> from weberwhisk.design import Goal, Plan, Scheme, simulate_study, taper
    >>> scheme = Scheme([15e-3, 40e-3], [-2e-3, -1e-3, 1e-3, 2e-3])
    >>> plan = Plan(scheme, taper(Whisker(50e-3, 100e-6, 5e-6)), Goal(bayes_factor=10))
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
    limits = [np.log10(goal.bayes_factor)] if goal.bayes_factor else [100 * (goal.half_width or 0)]
    for limit, name in zip(
        limits + [-v for v in limits if compared], ("goal", "the wrong way"), strict=False
    ):
        line = ":" if name != "goal" else "-"
        ax.axvline(limit, color="0.6", linewidth=0.8, zorder=0, linestyle=line, label=name)
    ax.set_ylim(0, 1)
    ax.set_xlabel(
        "log$_{10}$ Bayes factor for the truth"
        if compared
        else "Half-width of the interval of k (%)"
    )
    ax.set_ylabel("Share of experiments")
    legend_above(ax)
    return ax


@styled
def adaptive(
    tables: Mapping[str, pd.DataFrame], axes: Sequence[Axes] | None = None
) -> NDArray[np.object_]:
    """What simulated experiments know after so many trials, a line a method; returns the axes.

    Parameters
    ----------
    tables : mapping
        ``estimation``: rows with ``method``, ``weber_fraction`` (the truth), ``n``, ``low`` and
        ``high``; ``discrimination``: with ``method``, ``truth``, ``n`` and ``log_bayes_factor``.
    axes : sequence of Axes, optional
        One for each Weber fraction, and one for the Bayes factors.
    """
    first, second = tables["estimation"], tables["discrimination"]
    ks = sorted(first["weber_fraction"].unique())
    if axes is None:
        figure = open_figure(DOUBLE, 2.9)
        axes = list(figure.subplots(1, len(ks) + 1))
    methods = list(dict.fromkeys(first["method"]))
    half = (first["high"] - first["low"]) / (first["high"] + first["low"])
    for ax, k in zip(axes, ks, strict=False):
        for i, method in enumerate(methods):
            own = first[(first["weber_fraction"] == k) & (first["method"] == method)]
            width = half[own.index].groupby(own["n"]).median()
            marks = {"marker": MARKERS[i % len(MARKERS)], "markersize": 3}
            ax.plot(width.index, 100 * width, **look(i, **marks), label=method)
        ax.axhline(40, color="0.7", linewidth=0.8, zorder=0, label="goal")
        ax.text(0.95, 0.93, f"k = {k:g}", ha="right", transform=ax.transAxes)
        ax.set(xlabel="Trials", ylim=(0, 100))
    axes[0].set_ylabel("Half width of the 95 % interval of k (%)")
    legend_above(axes[0])
    ax = axes[len(ks)]
    for truth in sorted(second["truth"].unique()):
        for method in dict.fromkeys(second["method"]):
            own = second[(second["truth"] == truth) & (second["method"] == method)]
            found = (own["log_bayes_factor"] > np.log(10)).groupby(own["n"])
            share, count = found.mean(), found.sum().to_numpy(float)
            low, high = binomial_interval(count, found.size().to_numpy(float))
            style = {"linestyle": LINES[truth % len(LINES)], "elinewidth": 0.8}
            label = f"{method}, {('tapered', 'cylinder')[truth]}"
            ends = 100 * share, 100 * low, 100 * high
            bars(ax, share.index, ends, methods.index(method), **style, label=label)
    ax.axhline(80, color="0.7", linewidth=0.8, zorder=0, label="goal")
    ax.set(xlabel="Trials", ylabel="Runs with Bayes factor > 10 (%)", ylim=(0, 102))
    legend_above(ax)
    return np.array(list(axes), dtype=object)


@styled
def placements(placer: TrialLog, ax: Axes | None = None) -> Axes:
    """The comparisons of a session in order, and whether they were judged greater.

    Parameters
    ----------
    placer : BayesianPlacer or Staircase
        After some trials.
    ax : Axes, optional
    """
    ax = axes_or_new(ax, SINGLE, 2.8)
    rows = placer.trials().frame
    offset = rows["stimulus_2"] - rows["stimulus_1"]
    answers = ((1.0, "counted answer", "o"), (0.0, "the other", "s"))
    for i, (answer, label, marker) in enumerate(answers):
        own = rows["count"] == answer
        ax.plot(
            rows["trial"][own], offset[own], marker, color=COLOURS[i], markersize=2.5, label=label
        )
    ax.axhline(0, color="0.7", linewidth=0.8, zorder=0)
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ax.set(xlabel="Trial", ylabel="Comparison − standard")
    legend_above(ax)
    return ax
