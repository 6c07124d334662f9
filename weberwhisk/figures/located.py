"""Radial distances of measured contacts: over time, and by touch."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes

from .style import COLOURS, DOUBLE, axes_or_new, bars, legend_above, styled

if TYPE_CHECKING:
    import pandas as pd


@styled
def located(
    table: pd.DataFrame, ax: Axes | None = None, *, against: str | None = None, by: str = ""
) -> Axes:
    """Distance with its 95 % interval, over rows or the column `against`; `by` names touches.

    With the same column for both, over touches: one posterior each.
    """
    ax = axes_or_new(ax, DOUBLE)
    ax.set_ylabel("radial distance (mm)")
    if by and against == by:
        first = table[table["touch_status"] == "converged"].groupby(by, sort=False).first()
        names = ("radial_distance_mm", "lower_mm", "upper_mm")
        at = np.arange(len(first))
        bars(ax, at, [first[f"touch_{n}"] for n in names], 0, label="each touch, 95 % interval")
        ax.set_xticks(at[:: 1 + len(at) // 20], first.index[:: 1 + len(at) // 20])
        ax.set_xlabel(by.replace("_", " "))
        legend_above(ax)
        return ax
    x = np.arange(len(table)) if against is None else table[against].to_numpy(dtype=float)
    order = np.argsort(x, kind="stable")
    part = table.iloc[order]
    x = x[order]
    names = ("radial_distance_mm", "lower_mm", "upper_mm")
    middle, low, high = (part[name].to_numpy(dtype=float) for name in names)
    ax.fill_between(x, low, high, color=COLOURS[4], alpha=0.4, label="95 % interval, each row")
    ax.plot(x, middle, ".", color=COLOURS[0], markersize=2, label="mean, each row")
    if by:
        own = np.asarray(part["touch_status"] == "converged")
        if own.any():
            groups = part[own].assign(place=x[own]).groupby(by, sort=False)
            first = groups.first()
            ends = [first[f"touch_{name}"] for name in names]
            bars(ax, groups["place"].mean(), ends, 1, label="each touch")
    ax.set_xlabel("row" if against is None else against.replace("_", " "))
    legend_above(ax)
    return ax


@styled
def calibrated(found: Any, ax: Axes | None = None) -> Axes:
    """Slopes of taps over what a `Calibration` fits, against distance, with its Weber noise."""
    ax = axes_or_new(ax, DOUBLE)
    taps = found.residuals
    k = found.noise.weber_fraction
    ax.axhspan(1 - 1.96 * k, 1 + 1.96 * k, color=COLOURS[4], alpha=0.4, label="95 % of taps")
    ax.axhline(1.0, color=COLOURS[0], linewidth=0.8)
    ax.plot(taps["radial_distance_mm"], taps["slope"] / taps["fitted"], ".", color=COLOURS[0],
            markersize=3, label="taps")  # fmt: skip
    ax.set_xlabel("radial distance (mm)")
    ax.set_ylabel("slope, measured over fitted")
    legend_above(ax)
    return ax
