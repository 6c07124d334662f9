"""What fits of choices say besides their curves: residuals, states, animals, comparisons."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from .._util import checks
from .._util.values import pd
from .style import (
    COLOURS,
    DOUBLE,
    SINGLE,
    axes_or_new,
    drawable,
    legend_above,
    log_numbers,
    look,
    mark,
    styled,
)

if TYPE_CHECKING:
    from ..behaviour import Comparison, PopulationFit, StateFit

__all__ = ["comparison", "engagement", "height_of", "residuals", "shrinkage"]

#: More animals than this are drawn without their names, which would not be legible.
MOST_NAMED = 48


@styled
def residuals(table: pd.DataFrame, ax: Axes | None = None, *, against: str | None = None) -> Axes:
    """Plot residuals in standard errors, with the band of 95 % of them if the model is right.

    Parameters
    ----------
    table : DataFrame
        From `residuals_by` or `quantile_residuals`; its column `z` is drawn.
    ax : Axes, optional
    against : str, optional
        Column of the horizontal axis; by default `stimulus_2`, or else the table's first.

    Examples
    --------
    >>> from weberwhisk import fit_weber, simulate_trials
    >>> from weberwhisk.behaviour import residuals_by
    >>> fit = fit_weber(simulate_trials(sessions=4, seed=1))
    >>> residuals(residuals_by(fit, "session")).get_xlabel()
    'session'
    """
    ax = axes_or_new(ax)
    column = against or ("stimulus_2" if "stimulus_2" in table else str(table.columns[0]))
    z = table["z"].to_numpy(float)
    outside = np.abs(z) > 1.96
    x = table[column].to_numpy()
    ax.axhspan(-1.96, 1.96, color="0.92", zorder=0, label="95 %, if the model is right")
    ax.axhline(0, color="0.6", linewidth=0.8, zorder=0)
    for i, (which, name) in enumerate(((~outside, "inside"), (outside, "outside"))):
        if which.any():
            ax.plot(x[which], z[which], **mark(i, markersize=3.5), label=name)
    if np.issubdtype(x.dtype, np.integer):
        ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ax.set(xlabel=drawable(column.replace("_", " ")), ylabel="Residual (standard errors)")
    return legend_above(ax)


@styled
def engagement(fit: StateFit, ax: Axes | None = None) -> Axes:
    """Plot the probability that the animal was engaged on each trial, given all its answers.

    Trials are in the order of the table; dotted lines mark the beginning of sessions.

    Examples
    --------
    >>> from weberwhisk import fit_weber, simulate_trials
    >>> from weberwhisk.behaviour import States
    >>> fit = fit_weber(simulate_trials(states=States(engaged=0.6), seed=1), states=3)
    >>> engagement(fit).get_ylabel()
    'P(engaged)'
    """
    checks.kind("fit", fit, "one with states", "engagement", "write states=3 in ww.fit_weber")
    ax = axes_or_new(ax, DOUBLE, 1.9)
    table, n = fit.engagement, len(fit.engagement)
    ax.plot(np.arange(1, n + 1), table["engaged"], **look(0, lw=0.8))
    if "session" in table:
        for begin in np.flatnonzero(table["session"].ne(table["session"].shift()))[1:]:
            ax.axvline(begin + 0.5, color="0.6", ls=":", lw=0.8, zorder=0)
    share, low, high = (100 * x for x in fit.share_engaged())
    ax.set_title(f"Engaged on {share:.0f} % of the trials ({low:.0f} to {high:.0f} %)")
    ax.set(xlabel="Trial", ylabel="P(engaged)", xlim=(0, n + 1), ylim=(-0.02, 1.02))
    return ax


def height_of(animals: int) -> float:
    """Height of a figure with a row an animal, inches; not above that of a page."""
    return 1.2 + 0.16 * animals if animals <= MOST_NAMED else 6.5


@styled
def shrinkage(fit: PopulationFit, ax: Axes | None = None) -> Axes:
    """Plot the Weber fraction of each animal, fitted alone and within the population.

    Of more than 48 animals the names are left out: `fit.subjects` has them.

    Examples
    --------
    >>> from weberwhisk import fit_population, simulate_population
    >>> trials, _ = simulate_population(2, trials_per_level=6, seed=1)
    >>> ax = shrinkage(fit_population(trials, bias="none"))
    >>> ax.get_xlabel()
    'Weber fraction'
    """
    table = fit.subjects
    animals = table[table["weber_fraction"].notna()].sort_values("alone").reset_index(drop=True)
    named = len(animals) <= MOST_NAMED
    ax = axes_or_new(ax, SINGLE, height_of(len(animals)))
    y = np.arange(len(animals), dtype=float) + 1
    for names, shift, i, face, label in (
        (("alone", "alone_lower", "alone_upper"), -0.17, 1, "white", "alone"),
        (("weber_fraction", "lower", "upper"), 0.17, 0, COLOURS[0], "with the others"),
    ):
        middle, low, high = (animals[c].to_numpy(float) for c in names)
        ends = [(middle - low).tolist(), (high - middle).tolist()]
        style = mark(i, elinewidth=0.9, markerfacecolor=face, label=f"{label}, 95 %")
        small = {} if named else {"elinewidth": 0.4, "markersize": 1.5, "markeredgewidth": 0.5}
        ax.errorbar(middle, y + shift, xerr=ends, **style | small)
    ax.axvspan(*fit.interval(0.95), color="0.9", zorder=0, label="population median, 95 %")
    if named:
        ax.set_yticks(y, [drawable(str(subject)) for subject in animals["subject"]])
    else:
        ax.set_ylim(0, len(animals) + 1)
        ax.set_ylabel("Animal, in the order of the Weber fraction alone")
    unit = next((f" ({one.unit})" for one in fit.fits.values() if one.unit), "")
    ax.set(xscale="log", xlabel=f"Weber fraction{unit}")
    log_numbers(ax.xaxis)
    return legend_above(ax)


@styled
def comparison(result: Comparison, ax: Axes | None = None) -> Axes:
    """Plot by how many nats each observer is worse than the best.

    In log evidence, and by leave-one-out cross-validation (LOO) of trials with one standard error.

    Examples
    --------
    >>> from weberwhisk import compare, fit_weber, simulate_trials
    >>> trials = simulate_trials(weber_fraction=0.1, seed=1)
    >>> none = fit_weber(trials, priors={"lapse_low": 0.0, "lapse_high": 0.0})
    >>> comparison(compare({"lapses": fit_weber(trials), "none": none})).get_xlabel()
    'Difference from the best (nats)'
    """
    table = result.table.iloc[::-1]
    ax = axes_or_new(ax, SINGLE + 0.4, 1.2 + 0.3 * len(table))
    y = np.arange(len(table), dtype=float)
    evidence = table["log_bayes_factor"].to_numpy(float)
    ax.plot(evidence, y + 0.12, "o", color=COLOURS[0], label="log evidence")
    style = mark(1, elinewidth=0.9, label="a trial left out, ± 1 SE")
    ax.errorbar(table["elpd_difference"], y - 0.12, xerr=table["difference_se"], **style)
    ax.axvline(0, color="0.7", linewidth=0.8, zorder=0, label="the best")
    ax.set_yticks(y, [drawable(name, 40) for name in table.index])
    ax.set(xlabel="Difference from the best (nats)", ylim=(-0.6, len(table) - 0.4))
    return legend_above(ax)
