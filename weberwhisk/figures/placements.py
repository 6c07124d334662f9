"""Trials placed one by one: what adaptive placement saves, and where it puts them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from .choices import binomial_interval
from .style import (
    COLOURS,
    DOUBLE,
    LINES,
    MARKERS,
    SINGLE,
    axes_or_new,
    legend_above,
    new_figure,
    styled,
)

if TYPE_CHECKING:
    import pandas as pd

    from ..design import TrialLog


@styled
def adaptive(
    tables: Mapping[str, pd.DataFrame], axes: Sequence[Axes] | None = None
) -> NDArray[Any]:
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
        figure = new_figure(DOUBLE, 2.9)
        axes = list(figure.subplots(1, len(ks) + 1))
    methods = list(dict.fromkeys(first["method"]))
    half = (first["high"] - first["low"]) / (first["high"] + first["low"])
    for ax, k in zip(axes, ks, strict=False):
        for i, method in enumerate(methods):
            own = first[(first["weber_fraction"] == k) & (first["method"] == method)]
            width = half[own.index].groupby(own["n"]).median()
            ax.plot(width.index, 100 * width, **_look(i), label=method)
        ax.axhline(40, color="0.7", linewidth=0.8, zorder=0)
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
            look = _look(methods.index(method)) | {"linestyle": LINES[truth % len(LINES)]}
            ax.errorbar(
                share.index,
                100 * share,
                100 * np.stack([share - low, high - share]),
                **look,
                capsize=2,
                elinewidth=0.8,
                label=f"{method}, {('tapered', 'cylinder')[truth]}",
            )
    ax.axhline(80, color="0.7", linewidth=0.8, zorder=0)
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
    ax.set(xlabel="Trial", ylabel="Comparison − standard")
    legend_above(ax)
    return ax


def _look(i: int) -> dict[str, Any]:
    return {
        "color": COLOURS[i % len(COLOURS)],
        "marker": MARKERS[i % len(MARKERS)],
        "linestyle": LINES[i % len(LINES)],
        "markersize": 3,
    }
