"""Choices, the psychometric functions fitted to them, and states of single trials."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray
from scipy.special import betaincinv

from .._util import checks
from .._util.refusals import Refusal
from .._util.values import Array, pd
from .style import (
    COLOURS,
    DOUBLE,
    SINGLE,
    axes_or_new,
    bars,
    drawable,
    legend_above,
    legend_over,
    log_numbers,
    look,
    mark,
    open_figure,
    styled,
)

if TYPE_CHECKING:
    from ..behaviour import Comparison, PopulationFit, StateFit, WeberFit
    from ..behaviour.trials import Cells

__all__ = [
    "binomial_interval", "comparison", "engagement", "population", "psychometrics", "residuals",
    "shrinkage",
]  # fmt: skip


@styled
def psychometrics(
    fit: WeberFit, axes: Axes | Sequence[Axes] | None = None, *, standard: float | None = None,
    unit: str = "",
) -> NDArray[np.object_]:  # fmt: skip
    """Plot choices at each standard with 95 % binomial intervals, and the fitted curve.

    Parameters
    ----------
    fit : WeberFit
    axes : Axes or sequence of Axes, optional
        One per standard.
    standard : float, optional
        The only standard to draw; by default all.
    unit : str
        Unit of the stimulus, for the axis label.

    Returns
    -------
    array of Axes

    Raises
    ------
    ValueError
        For fewer axes than standards, and a standard without choices.

    Notes
    -----
    The curve is for a first stimulus at the standard. Choices with another first stimulus are drawn
    where a second one has the same ratio to the standard (on a log scale, the same difference).

    Examples
    --------
    >>> from weberwhisk import fit_weber, simulate_trials
    >>> axes = psychometrics(fit_weber(simulate_trials(weber_fraction=0.1, seed=7)))
    >>> axes[0].get_title(), len(axes)
    ('', 1)
    """
    known = fit.standards if standard is None else np.array([float(standard)])
    count = len(known)
    if axes is not None:
        drawn = np.array(axes, dtype=object).ravel()
        if len(drawn) < count:
            raise Refusal(
                f"There are {count} standards and {len(drawn)} axes",
                remedy=f"name one, such as standard={known[0]:g}, or give more",
            )
        for ax, s in zip(drawn, known, strict=False):
            _choices(fit, ax, float(s))
            ax.set(xlabel=_stimulus_label(fit, unit), ylabel=_answer_label(fit))
            legend_above(ax)
        return drawn[:count]
    columns = max(min(count, 4), 1)
    rows = max(-(-count // columns), 1)
    width = SINGLE if columns == 1 else DOUBLE * columns / 4
    figure = open_figure(width, 0.9 + 1.55 * rows if rows > 1 else 2.6)
    sharing: Any = {"sharey": True, "sharex": _relative(fit), "squeeze": False}
    drawn = figure.subplots(rows, columns, **sharing).ravel()
    for spare in drawn[count:]:
        spare.set_visible(False)
    for ax, s in zip(drawn, known, strict=False):
        _choices(fit, ax, float(s))
        if count > 1:
            ax.set_title(f"standard {s:.3g}")
    figure.supxlabel(_stimulus_label(fit, unit))
    figure.supylabel(_answer_label(fit))
    legend_over(figure, drawn[:1], 3)
    return drawn[:count]


def _relative(fit: WeberFit) -> bool:
    """Whether the horizontal axis is a difference of stimuli, as on a log scale."""
    return bool(fit.trials.scale == "log")


def _stimulus_label(fit: WeberFit, unit: str) -> str:
    counted = f" ({drawable(unit)})" if unit else ""
    first = _own_name(fit, ("stimulus_1", "standard"), "first")
    second = _own_name(fit, ("stimulus_2", "comparison"), "Second stimulus")
    if _relative(fit):
        difference = _own_name(fit, ("log_ratio",), f"{second} − {first}")
        return f"{difference}{counted or ' (units of the log column)'}"
    return f"{second}{counted}"


def _answer_label(fit: WeberFit) -> str:
    choice = fit.trials.task.response == "choice"
    words = "Second reported greater" if choice else "Proportion correct"
    own = _own_name(fit, ("choice", "n_greater", "correct", "n_correct"), "")
    return f"{own}: {words.lower()}" if own else words


def _own_name(fit: WeberFit, columns: Sequence[str], otherwise: str) -> str:
    """The name, in the table that was read, of the first of these columns that it has."""
    names = fit.trials.frame.attrs.get("columns", {})
    return next((drawable(names[column]) for column in columns if column in names), otherwise)


def _shown_at(fit: WeberFit, standard: float) -> tuple[Array, Cells]:
    """Positions on the axis of the choices at a standard, and their counts."""
    every = fit.trials.cells()
    if every.standard.size and not np.isclose(every.standard, standard).any():
        raise Refusal(
            f"standard {standard:g} has no answers to draw",
            remedy=f"choose one of {', '.join(f'{s:g}' for s in fit.standards)}",
        )
    cells = every.of(float(every.standard[np.argmin(np.abs(every.standard - standard))]))
    first, second = cells.stimulus_1, cells.stimulus_2
    return second - first if _relative(fit) else standard * second / first, cells


def _choices(fit: WeberFit, ax: Axes, standard: float) -> None:
    x, cells = _shown_at(fit, standard)
    n, count = cells.n, cells.count
    origin = standard if _relative(fit) else 0.0
    if cells.sd_1 is not None and x.size > 20:  # located distances differ from trial to trial
        groups = np.array_split(np.argsort(x, kind="stable"), 10)
        x = np.array([x[g].mean() for g in groups])
        n, count = (np.array([a[g].sum() for g in groups]) for a in (n, count))
    share = count / n
    low, high = binomial_interval(count, n)
    if x.size:
        reach = [min(x.min(), standard - origin), max(x.max(), standard - origin)]
        margin = 0.08 * (reach[1] - reach[0]) or 0.1 * abs(standard) or 0.1
        lowest, highest = fit.encoding.domain  # may be infinite
        edges = np.array([reach[0] - margin, reach[1] + margin]) + origin
        edges = np.clip(edges, lowest + 1e-6 * margin, highest - 1e-6 * margin)
        curve = fit.psychometric(np.linspace(edges[0], edges[1], 121), standard)
        at = curve["comparison"] - origin
        # With every parameter given there is a curve but no band.
        drawn = "fit" if fit.model.n_states == 1 else "engaged"
        band, line = (f"{drawn}, 95 %", None) if fit.parameters else (None, "given parameters")
        ends = curve["lower"], curve["upper"]
        ax.fill_between(at, *ends, color=COLOURS[4], alpha=0.35, label=band)
        ax.plot(at, curve["median"], color=COLOURS[0], label=line)
    bars(ax, x, (share, low, high), 0, color=COLOURS[6], label="choices, 95 %", markersize=4)
    ax.axvline(standard - origin, color="0.7", linewidth=0.8, zorder=0, label="standard")
    ax.set_ylim(-0.03, 1.03)
    ax.xaxis.set_major_locator(MaxNLocator(5))


def binomial_interval(count: Array, n: Array) -> tuple[Array, Array]:
    """Jeffreys' 95 % interval of a proportion; it reaches 0 or 1 where count is 0 or n."""
    low = np.where(count == 0, 0.0, betaincinv(count + 0.5, n - count + 0.5, 0.025))
    high = np.where(count == n, 1.0, betaincinv(count + 0.5, n - count + 0.5, 0.975))
    # Rounding must not make the length of an error bar negative.
    return np.minimum(low, count / n), np.maximum(high, count / n)


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


@styled
def shrinkage(fit: PopulationFit, ax: Axes | None = None) -> Axes:
    """Plot the Weber fraction of each animal, fitted alone and within the population.

    Examples
    --------
    >>> from weberwhisk import fit_population, simulate_population
    >>> trials, _ = simulate_population(2, trials_per_level=6, seed=1)
    >>> ax = shrinkage(fit_population(trials, bias="none"))
    >>> ax.get_xlabel()
    'Weber fraction'
    """
    table = fit.subjects
    rows = table[table["weber_fraction"].notna()].sort_values("alone").reset_index(drop=True)
    ax = axes_or_new(ax, SINGLE if len(rows) < 30 else DOUBLE / 2, min(1.2 + 0.16 * len(rows), 9.0))
    y = np.arange(len(rows), dtype=float)
    for names, shift, i, face, label in (
        (("alone", "alone_lower", "alone_upper"), -0.17, 1, "white", "alone"),
        (("weber_fraction", "lower", "upper"), 0.17, 0, COLOURS[0], "with the others"),
    ):
        middle, low, high = (rows[c].to_numpy(float) for c in names)
        ends = [(middle - low).tolist(), (high - middle).tolist()]
        style = mark(i, elinewidth=0.9, markerfacecolor=face, label=f"{label}, 95 %")
        ax.errorbar(middle, y + shift, xerr=ends, **style)
    ax.axvspan(*fit.interval(0.95), color="0.9", zorder=0, label="population median, 95 %")
    ax.set_yticks(y, [drawable(str(subject)) for subject in rows["subject"]])
    ax.set(xscale="log", xlabel="Weber fraction")
    log_numbers(ax.xaxis)
    return legend_above(ax)


@styled
def population(
    fit: PopulationFit, ax: Axes | None = None, *, unit: str = ""
) -> Axes | NDArray[np.object_]:
    """Plot every animal's choices and curve at up to three standards, and `shrinkage`.

    Curves are fitted to each animal alone. With a given `ax` only `shrinkage` is drawn.

    Examples
    --------
    >>> from weberwhisk import fit_population, simulate_population
    >>> trials, _ = simulate_population(2, trials_per_level=6, seed=1)
    >>> axes = population(fit_population(trials, bias="none"))
    >>> axes[0].get_ylabel(), axes[-1].get_xlabel()
    ('Second reported greater', 'Weber fraction')
    """
    fits = {animal: one for animal, one in fit.fits.items() if one.parameters}
    if ax is not None or not fits:
        return shrinkage(fit, ax)
    known = np.unique(np.concatenate([one.standards for one in fits.values()]))
    if known.size > 3:
        known = known[[0, known.size // 2, -1]]
    figure = open_figure(DOUBLE, min(max(2.9, 1.8 + 0.16 * len(fit.subjects)), 9.0))
    grid = figure.add_gridspec(1, known.size + 1)
    axes: list[Axes] = []
    for i, standard in enumerate(known):
        axes.append(figure.add_subplot(grid[i], sharey=axes[0] if axes else None))
        for number, (animal, one) in enumerate(fits.items()):
            if np.isclose(one.standards, standard).any():
                name = f"{drawable(str(animal))}, alone" if len(fits) <= 12 else "animals, alone"
                _animal(one, axes[-1], float(standard), number, name)
        axes[-1].set(title=f"standard {standard:.3g}", ylim=(-0.03, 1.03))
        axes[-1].xaxis.set_major_locator(MaxNLocator(4))
        axes[-1].set_xlabel(_stimulus_label(one, unit))
    axes[0].set_ylabel(_answer_label(one))
    legend_over(figure, axes, 6)
    axes.append(shrinkage(fit, figure.add_subplot(grid[-1])))
    return np.array(axes, dtype=object)


def _animal(fit: WeberFit, ax: Axes, standard: float, i: int, name: str) -> None:
    """Draw one animal's proportions, and the median curve of its own fit."""
    x, cells = _shown_at(fit, standard)
    origin = standard if _relative(fit) else 0.0
    curve = fit.psychometric(np.linspace(x.min(), x.max(), 81) + origin, standard)
    ax.plot(x, cells.count / cells.n, **mark(i))
    ax.plot(curve["comparison"] - origin, curve["median"], **look(i, linewidth=1.0), label=name)


@styled
def comparison(result: Comparison, ax: Axes | None = None) -> Axes:
    """Plot by how many nats each observer is worse than the best.

    By log evidence, and by leave-one-out cross-validation (LOO) of trials with one standard error.

    Examples
    --------
    >>> from weberwhisk import compare, fit_weber, simulate_trials
    >>> trials = simulate_trials(weber_fraction=0.1, seed=1)
    >>> none = fit_weber(trials, priors={"lapse_low": 0.0, "lapse_high": 0.0})
    >>> comparison(compare({"lapses": fit_weber(trials), "none": none})).get_xlabel()
    'Nats below the best'
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
    ax.set(xlabel="Nats below the best", ylim=(-0.6, len(table) - 0.4))
    return legend_above(ax)
