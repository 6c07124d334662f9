"""Fits looked at closely: residuals, joint posteriors, and many animals beside one another."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter
from numpy.typing import NDArray

from .style import (
    COLOURS,
    DOUBLE,
    SINGLE,
    axes_or_new,
    drawable,
    figure_of,
    legend_above,
    new_figure,
    styled,
)

if TYPE_CHECKING:
    import pandas as pd

    from ..behaviour import PopulationFit, WeberFit


@styled
def residuals(table: pd.DataFrame, ax: Axes | None = None, *, against: str | None = None) -> Axes:
    """Residuals in standard errors, with the band that holds 95 % of them if the model does.

    Parameters
    ----------
    table : DataFrame
        From `residuals_by` or `quantile_residuals`: its `z` is drawn.
    ax : Axes, optional
    against : str, optional
        The column along the horizontal axis: `stimulus_2` by default, or the table's first.

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
    ax.axhspan(-1.96, 1.96, color="0.92", zorder=0, label="95 % of sound residuals")
    ax.axhline(0, color="0.6", linewidth=0.8, zorder=0)
    for which, marker, colour, name in (
        (~outside, "o", COLOURS[0], None),
        (outside, "D", COLOURS[1], "outside"),
    ):
        if which.any():
            ax.plot(x[which], z[which], marker, color=colour, label=name, markersize=3.5)
    if np.issubdtype(x.dtype, np.integer):
        ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ax.set_xlabel(drawable(column.replace("_", " ")))
    ax.set_ylabel("Residual (standard errors)")
    legend_above(ax)
    return ax


@styled
def pairs(fit: WeberFit, axes: Sequence[Axes] | None = None, *, draws: int = 800) -> NDArray[Any]:
    """The joint posterior of a fit's parameters, two at a time, and each one's alone.

    Returns
    -------
    array of Axes, shape (P, P)
        Those above the diagonal are empty.

    Examples
    --------
    >>> from weberwhisk import fit_weber, simulate_trials
    >>> pairs(fit_weber(simulate_trials(seed=1))).shape
    (4, 4)
    """
    names = fit.parameters
    size = len(names)
    if axes is None:
        figure = new_figure(max(SINGLE, 1.5 * size), max(2.6, 1.4 * size))
        axes = list(figure.subplots(size, size, squeeze=False).ravel())
    grid = np.array(axes, dtype=object).reshape(size, size)
    sample = fit.posterior.draws().named(fit.posterior.model)  # type: ignore[attr-defined]
    for i, down in enumerate(names):
        for j, along in enumerate(names):
            ax = grid[i, j]
            if j > i:
                ax.set_visible(False)
            elif i == j:
                ax.hist(sample[down], bins=40, color=COLOURS[4], edgecolor="none")
                ax.set_yticks([])
            else:
                step = max(len(sample[down]) // draws, 1)
                x, y = sample[along][::step], sample[down][::step]
                ax.plot(x, y, ".", color=COLOURS[0], alpha=0.35, markersize=2, rasterized=True)
            ax.xaxis.set_major_locator(MaxNLocator(3))
            if i != j:
                ax.yaxis.set_major_locator(MaxNLocator(3))
            if i < size - 1:
                ax.set_xticklabels([])
            else:
                ax.set_xlabel(along.replace("_", " "))
            if j:
                ax.set_yticklabels([])
            elif i:
                ax.set_ylabel(down.replace("_", " "))
    figure_of(grid).align_labels()
    return grid


@styled
def shrinkage(fit: PopulationFit, ax: Axes | None = None) -> Axes:
    """Weber fractions of animals from their own trials, and in the light of the others.

    Examples
    --------
    >>> from weberwhisk import fit_population, simulate_population
    >>> ax = shrinkage(fit_population(simulate_population(3, trials_per_level=10, seed=1)[0]))
    >>> ax.get_xlabel()
    'Weber fraction'
    """
    table = fit.subjects if "alone" in fit.subjects else fit.sessions
    assert table is not None
    rows = table[table["weber_fraction"].notna()].sort_values("alone").reset_index(drop=True)
    ax = axes_or_new(ax, SINGLE if len(rows) < 30 else DOUBLE / 2, min(1.2 + 0.16 * len(rows), 9.0))
    y = np.arange(len(rows), dtype=float)
    for names, shift, marker, colour, label in (
        (("alone", "alone_lower", "alone_upper"), -0.17, "o", COLOURS[1], "alone"),
        (("weber_fraction", "lower", "upper"), 0.17, "s", COLOURS[0], "with the others"),
    ):
        middle, low, high = (rows[c].to_numpy(float) for c in names)
        ax.errorbar(
            middle, y + shift, xerr=[(middle - low).tolist(), (high - middle).tolist()],
            fmt=marker, color=colour, markersize=3, elinewidth=0.9,
            markerfacecolor="white" if shift < 0 else colour, label=f"{label}, 95 %",
        )  # fmt: skip
    ax.axvspan(*fit.interval(0.95), color="0.9", zorder=0, label="population median, 95 %")
    labels = [str(s) for s in rows["subject"]]
    if "session" in rows:
        labels = [f"{s}, {n}" for s, n in zip(rows["subject"], rows["session"], strict=True)]
    ax.set_yticks(y, [drawable(label) for label in labels])
    ax.set_xscale("log")
    ax.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    ax.xaxis.set_minor_formatter(NullFormatter())
    ax.set_xlabel("Weber fraction")
    legend_above(ax)
    return ax
