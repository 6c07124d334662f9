"""A planned experiment: what is expected of it, and what came out in rehearsal."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from .style import (
    COLOURS,
    DOUBLE,
    LINES,
    MARKERS,
    SINGLE,
    axes_or_new,
    drawable,
    figure_of,
    legend_above,
    new_figure,
    styled,
)

if TYPE_CHECKING:
    from ..design import Plan
    from ..design.rehearsal import Rehearsal

MM = 1e-3


@styled
def planned_psychometrics(plan: Plan, axes: Sequence[Axes] | None = None) -> NDArray[Any]:
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
            new_figure(width, 2.0).subplots(1, len(standards), sharey=True, squeeze=False)[0]
        )
    for ax, standard in zip(axes, standards, strict=True):
        levels = plan.levels.query("standard == @standard")
        share = levels["expected"].to_numpy(float)
        ax.errorbar(
            levels["comparison"] / MM,
            share,
            [(share - levels["lower"]).tolist(), (levels["upper"] - share).tolist()],
            fmt="o", color=COLOURS[6], elinewidth=1, capsize=2, label="expected, 95 % by chance",
        )  # fmt: skip
        for i, hypothesis in enumerate(plan.hypotheses):
            own = plan.curves.query("standard == @standard and hypothesis == @hypothesis.name")
            ax.plot(
                own["comparison"] / MM, own["median"], color=COLOURS[i], linestyle=LINES[i % 4],
                label=drawable(hypothesis.name),
            )  # fmt: skip
        ax.axvline(standard / MM, color="0.8", linewidth=0.8, zorder=0)
        ax.set_ylim(-0.03, 1.03)
        ax.xaxis.set_major_locator(MaxNLocator(4))
        ax.set_title(f"standard {standard / MM:.3g} mm")
    figure = figure_of(axes)
    figure.supxlabel("Comparison (mm)")
    axes[0].set_ylabel("Reported farther")
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=len(labels))
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
        at = own["stimulus"] / MM
        ax.fill_between(
            at, own["lower"] / MM, own["upper"] / MM, color=COLOURS[i], alpha=0.2, linewidth=0
        )
        ax.plot(at, own["jnd"] / MM, color=COLOURS[i], linestyle=LINES[i % 4],
                label=drawable(hypothesis.name))  # fmt: skip
    points = plan.jnds_by_standard
    jnd = points["jnd"] / MM
    ax.errorbar(
        points["standard"] / MM,
        jnd,
        [(jnd - points["lower"] / MM).tolist(), (points["upper"] / MM - jnd).tolist()],
        fmt=MARKERS[0], color=COLOURS[6], elinewidth=1, capsize=2, label="each standard alone",
    )  # fmt: skip
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
        share = own["power"].to_numpy(float)
        low, high = share - own["lower"].to_numpy(float), own["upper"].to_numpy(float) - share
        ax.errorbar(
            at, share, [low.clip(0).tolist(), high.clip(0).tolist()], color=COLOURS[i],
            fmt=f"{MARKERS[i]}{LINES[i % 4]}", markersize=3, elinewidth=1, capsize=2,
            label=f"{drawable(hypothesis.name)} is true",
        )  # fmt: skip
    ax.axhline(plan.goal.share, color="0.6", linewidth=0.8, zorder=0)
    ax.axvline(planned, color="0.6", linewidth=0.8, zorder=0)
    ax.set_ylim(0, 1.02)
    ax.set_xlim(left=0)
    ax.set_xlabel("Animals" if by_animals else "Trials of an animal")
    ax.set_ylabel("Share that reaches the goal")
    legend_above(ax)
    return ax


@styled
def rehearsed(result: Rehearsal, ax: Axes | None = None) -> Axes:
    """What came out of every rehearsed experiment, truth by truth.

    With hypotheses to compare: the Bayes factor for the truth, cumulated over the runs, and the
    criterion either way. With one: the relative half-width of the interval of k.

    Examples
    --------
    >>> from weberwhisk import Whisker
    >>> from weberwhisk.design import Goal, Plan, Scheme, rehearse, taper
    >>> scheme = Scheme([15e-3, 40e-3], [-2e-3, -1e-3, 1e-3, 2e-3])
    >>> plan = Plan(scheme, taper(Whisker(50e-3, 100e-6, 5e-6)), Goal(bayes_factor=10))
    >>> rehearsed(rehearse(plan, 2, seed=1)).get_ylabel()
    'Share of experiments'
    """
    ax = axes_or_new(ax)
    goal = result.plan.goal
    compared = goal.bayes_factor is not None
    column = "log_bayes_factor" if compared else "half_width"
    unit = np.log(10.0) if compared else 0.01
    for i, (truth, own) in enumerate(result.table.groupby("truth", sort=False)):
        values = np.sort(own[column].to_numpy(float)) / unit
        ax.step(
            values, np.arange(1, values.size + 1) / values.size, where="post", color=COLOURS[i],
            linestyle=LINES[i % 4], label=drawable(truth),
        )  # fmt: skip
    limits = [np.log10(goal.bayes_factor)] if goal.bayes_factor else [100 * (goal.half_width or 0)]
    for limit in limits + ([-limits[0]] if compared else []):
        ax.axvline(limit, color="0.6", linewidth=0.8, zorder=0)
    ax.set_ylim(0, 1)
    ax.set_xlabel(
        "log$_{10}$ Bayes factor for the truth"
        if compared
        else "Half-width of the interval of k (%)"
    )
    ax.set_ylabel("Share of experiments")
    legend_above(ax)
    return ax
