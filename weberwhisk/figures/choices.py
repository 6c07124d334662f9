"""Choices and the psychometric functions fitted to them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray
from scipy.special import betaincinv

from .style import (
    COLOURS,
    DOUBLE,
    SINGLE,
    Array,
    axes_or_new,
    drawable,
    figure_of,
    legend_above,
    new_figure,
    styled,
)

if TYPE_CHECKING:
    from ..behaviour import WeberFit


@styled
def psychometric(
    fit: WeberFit, ax: Axes | None = None, *, standard: float | None = None, unit: str = ""
) -> Axes:
    """Choices at one standard, with 95 % binomial intervals, and the curve fitted to them.

    Parameters
    ----------
    fit : WeberFit
    ax : Axes, optional
    standard : float, optional
        May be left out where the table has one.
    unit : str
        Of the stimulus, for the axis.

    Returns
    -------
    Axes

    Notes
    -----
    The curve is that of a first stimulus at the standard. Choices with another first stimulus stand
    where their difference (on a log scale) or their ratio puts them.

    Examples
    --------
    >>> from weberwhisk import fit_weber, simulate_trials
    >>> ax = psychometric(fit_weber(simulate_trials(weber_fraction=0.1, seed=7)))
    >>> ax.get_ylabel()
    'Second reported greater'
    """
    ax = axes_or_new(ax)
    known = fit.trials.standards
    if standard is None and known.size > 1:
        raise ValueError(
            f"There are {known.size} standards; name one, such as standard={known[0]:g}, or draw "
            "psychometrics(fit)."
        )
    s = float(known[0]) if standard is None else standard
    _choices(fit, ax, s)
    ax.set_xlabel(_stimulus_label(fit, unit))
    ax.set_ylabel(_answer_label(fit))
    legend_above(ax)
    return ax


@styled
def psychometrics(
    fit: WeberFit, axes: Sequence[Axes] | None = None, *, unit: str = ""
) -> NDArray[Any]:
    """`psychometric` at every standard, in small multiples; returns their axes."""
    known = fit.trials.standards
    if axes is None:
        columns = min(len(known), 4)
        rows = -(-len(known) // columns)
        width = SINGLE if columns == 1 else DOUBLE * max(columns, 2) / 4
        figure = new_figure(width, 0.9 + 1.55 * rows if rows > 1 else 2.6)
        grid = figure.subplots(rows, columns, sharey=True, sharex=_relative(fit), squeeze=False)
        axes = list(grid.ravel())
        for spare in axes[len(known) :]:
            spare.set_visible(False)
    for ax, s in zip(axes, known, strict=False):
        _choices(fit, ax, float(s))
        if len(known) > 1:
            ax.set_title(f"standard {s:.3g}")
    figure = figure_of(axes)
    figure.supxlabel(_stimulus_label(fit, unit))
    figure.supylabel(_answer_label(fit))
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=2)
    return np.array(axes[: len(known)], dtype=object)


def _relative(fit: WeberFit) -> bool:
    """Whether the horizontal axis is a difference: on a log scale only that matters."""
    return bool(fit.trials.scale == "log")


def _stimulus_label(fit: WeberFit, unit: str) -> str:
    counted = f" ({drawable(unit)})" if unit else ""
    if _relative(fit):
        return f"Second stimulus − first{counted or ' (units of the log column)'}"
    return f"Second stimulus{counted}"


def _answer_label(fit: WeberFit) -> str:
    return (
        "Second reported greater" if fit.trials.task.response == "choice" else "Proportion correct"
    )


def _choices(fit: WeberFit, ax: Axes, standard: float) -> None:
    every = fit.trials.cells()
    cells = every.of(float(every.standard[np.argmin(np.abs(every.standard - standard))]))
    first, second, n = cells.stimulus_1, cells.stimulus_2, cells.n
    share = cells.count / n
    low, high = binomial_interval(share * n, n)
    if _relative(fit):
        x, origin = second - first, standard
    else:
        x, origin = standard * second / first, 0.0
    if x.size:
        reach = [min(x.min(), standard - origin), max(x.max(), standard - origin)]
        margin = 0.08 * (reach[1] - reach[0]) or 0.1 * abs(standard) or 0.1
        lowest, highest = fit.percept.domain
        edges = np.clip(
            [reach[0] - margin + origin, reach[1] + margin + origin],
            lowest + 1e-6 * margin if np.isfinite(lowest) else lowest,
            highest - 1e-6 * margin if np.isfinite(highest) else highest,
        )
        curve = fit.psychometric(np.linspace(edges[0], edges[1], 121), standard)
        at = curve["comparison"] - origin
        ax.fill_between(
            at, curve["lower"], curve["upper"], color=COLOURS[4], alpha=0.35, linewidth=0,
            label="fit, 95 %" if fit.parameters else None,
        )  # fmt: skip
        # A fit to which every parameter was given has a curve and no band.
        name = None if fit.parameters else "given parameters"
        ax.plot(at, curve["median"], color=COLOURS[0], label=name)
    ax.errorbar(
        x,
        share,
        # Lists: some versions of Matplotlib take a lone row of an array for a number.
        [(share - low).tolist(), (high - share).tolist()],
        fmt="o",
        color=COLOURS[6],
        elinewidth=1,
        capsize=2,
        label="choices, 95 %",
    )
    ax.axvline(standard - origin, color="0.7", linewidth=0.8, zorder=0)
    ax.set_ylim(-0.03, 1.03)
    ax.xaxis.set_major_locator(MaxNLocator(5))


def binomial_interval(count: Array, n: Array) -> tuple[Array, Array]:
    """Jeffreys' 95 % interval of a proportion, closed where all or none were."""
    low = np.where(count == 0, 0.0, betaincinv(count + 0.5, n - count + 0.5, 0.025))
    high = np.where(count == n, 1.0, betaincinv(count + 0.5, n - count + 0.5, 0.975))
    # Rounding must not turn an error bar round.
    return np.minimum(low, count / n), np.maximum(high, count / n)
