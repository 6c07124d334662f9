"""Along a whisk, and over an array of whiskers: limits and resolution of distances and places."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap, LogNorm
from matplotlib.figure import Figure

from weberwhisk import WhiskerArray
from weberwhisk.plots.contacts import from_above
from weberwhisk.plots.style import (
    COLOURS,
    DOUBLE,
    LINES,
    SINGLE,
    SMALL,
    axes_or_new,
    errors,
    legend_above,
    legend_over,
    log_numbers,
    look,
    mark,
    new_figure,
    styled,
)

JND = "JND of distance (mm), d'=1"
PUSH = "push since contact (°)"


@styled
def along_push(table: pd.DataFrame) -> Figure:
    """The JND of distance and the distance itself against push, an object a line.

    Parameters
    ----------
    table : DataFrame
        From `along_whisk.resolution_along_push`.
    """
    figure = new_figure(DOUBLE, 3.0)
    left, right = figure.subplots(1, 2)
    for i, (name, rows) in enumerate(table.groupby("object", sort=False)):
        line = look(i, label=str(name))
        if i >= len(LINES):
            line = mark(i, markevery=max(len(rows) // 8, 1)) | line
        left.plot(rows["push_deg"], rows["jnd_mm"], **line)
        right.plot(rows["push_deg"], rows["radial_distance_mm"].where(~rows["tip"]), **line)
    left.set(yscale="log", xlabel=PUSH, ylabel=JND)
    log_numbers(left.yaxis)
    right.set(xlabel=PUSH, ylabel="radial distance (mm)")
    legend_over(figure, [left], 5)
    return figure


@styled
def lateral_sweep(table: pd.DataFrame) -> Figure:
    """True distance and the one followed from the moment, an object a panel.

    Parameters
    ----------
    table : DataFrame
        From `along_whisk.lateral_sweep`.
    """
    figure = new_figure(DOUBLE, 2.8)
    groups = list(table.groupby("object", sort=False))
    axes = figure.subplots(1, len(groups), sharey=True, squeeze=False)[0]
    for ax, (name, rows) in zip(axes, groups, strict=True):
        push, ends = rows["push_deg"], (rows["lower_mm"], rows["upper_mm"])
        ax.fill_between(push, *ends, color=COLOURS[4], alpha=0.35, label="95 % of noisy sweeps")
        ax.plot(push, rows["radial_distance_mm"], color=COLOURS[0], label="exact moments")
        ax.plot(push, rows["true_distance_mm"], "--", color="black", label="true")
        ax.set(title=str(name), xlabel=PUSH)
    figure.supylabel("radial distance (mm)")
    legend_over(figure, axes[:1], 3)
    return figure


@styled
def touches(table: pd.DataFrame, ax: Axes | None = None) -> Axes:
    """JND of a distance against the number of touches, beside 1/√n and what mice do.

    Marks are posteriors.

    Parameters
    ----------
    table : DataFrame
        From `touches_jnd`, with ``receptors``: the name of each line.
    """
    ax = axes_or_new(ax, SINGLE, 3.2)
    for i, (name, rows) in enumerate(table.groupby("receptors", sort=False)):
        colour, n = COLOURS[i], rows["count"]
        error = rows["posterior_error_mm"]
        errors(ax, n, rows["posterior_mm"], error, i, label=str(name))
        ax.plot(n, rows["fisher_mm"], LINES[0], color=colour)
        first = rows.sort_values("count").iloc[0]  # at one touch, if it is there
        root = first["fisher_mm"] * (first["count"] / n) ** 0.5
        ax.plot(n, root, LINES[1], color=colour, linewidth=0.8)
    ax.plot([], [], LINES[0], color="0.3", label="information")
    ax.plot([], [], LINES[1], color="0.3", linewidth=0.8, label="1/√n")
    ax.fill_between([1, 17], 0.8, 1.25, color="0.85", label="mice, 1 to 17 touches")
    ax.set(xscale="log", yscale="log", xlabel="touches", ylabel=JND)
    log_numbers(ax.xaxis, ax.yaxis)
    return legend_above(ax)


@styled
def jnd_limits(table: pd.DataFrame, length: float, ax: Axes | None = None) -> Axes:
    """One JND curve with the limits of torque, threshold and saturation.

    Parameters
    ----------
    table : DataFrame
        From `along_whisk.limits`.
    length : float
        Of the whisker, m.
    """
    ax = axes_or_new(ax, SINGLE, 3.2)
    place = table["radial_distance_mm"] / (1e3 * length)
    ax.plot(place, table["weber_mm"], "--", color=COLOURS[1], label="Weber's law alone")
    ax.plot(place, table["all_mm"], color=COLOURS[0], label="with threshold and saturation")
    top = 1.15 * float(table["threshold_mm"].max())
    saturated = table["all_mm"].isna() & table["weber_mm"].notna()
    for where, name, hatch in (
        (saturated, "receptors saturated", "////"),
        (table["stopped"], "torque stops the push", "\\\\\\\\"),
    ):
        if where.any():
            shade: Any = {"facecolor": "none", "edgecolor": "0.6", "hatch": hatch}
            ax.fill_between(place, 0.0, top, where=where.to_numpy(), label=name, **shade)
    ax.set(xlabel="radial distance r/L", ylabel=JND, xlim=(0, 1), ylim=(0.0, top))
    return legend_above(ax)


@styled
def reversal(table: pd.DataFrame) -> Figure:
    """What friction does to a distance as the push reverses, beside ± a JND.

    Parameters
    ----------
    table : DataFrame
        From `along_whisk.reversal`.
    """
    figure = new_figure(DOUBLE, 4.4)
    bases, objects = (list(dict.fromkeys(table[name])) for name in ("base", "object"))
    axes = figure.subplots(len(bases), len(objects), sharex=True, sharey=True, squeeze=False)
    for (base, name), ax in zip(product(bases, objects), axes.flat, strict=True):
        rows = table[(table["base"] == base) & (table["object"] == name)]
        for i, (direction, mine) in enumerate(rows.groupby("direction", sort=False)):
            angle, jnd = mine["push_deg"], mine["jnd_mm"]
            if i == 0:
                ax.fill_between(angle, -jnd, jnd, color="0.85", label="± a JND")
            line = mark(i, markevery=max(len(mine) // 8, 1)) | look(i, label=str(direction))
            ax.plot(angle, mine["bias_mm"], **line)
        ax.axhline(0.0, color="black", linewidth=0.6)
        ax.set_title(f"{name}: base {base}")
    figure.supxlabel("push, or the angle of a peg to a base that moves (°)")
    figure.supylabel("error of the distance (mm) where friction is left out")
    legend_over(figure, axes[0, :1], 3)
    return figure


@styled
def whisking_speed(table: pd.DataFrame, length: float, ax: Axes | None = None) -> Axes:
    """Whisking frequencies up to which quasi-static mechanics hold, against distance.

    Parameters
    ----------
    table : DataFrame
        From `along_whisk.speed`.
    length : float
        Of the whisker, m.
    """
    ax = axes_or_new(ax, SINGLE, 3.2)
    lines = {
        "first_frequency_hz": "first natural frequency, held",
        "ten_percent_hz": "moment off by 10 % (one JND, k = 0.1)",
        "one_percent_hz": "moment off by 1 % (a tenth of it)",
    }
    for i, (column, name) in enumerate(lines.items()):
        ax.plot(table["radial_distance_mm"] / (1e3 * length), table[column], **look(i), label=name)
    ax.axhspan(5.0, 12.0, color="0.88", label="exploratory whisking, 5 to 12 Hz")
    ax.set(xlabel="radial distance r/L", ylabel="whisking frequency (Hz)", yscale="log")
    ax.set(xlim=(0, 1), ylim=(1, 200))
    log_numbers(ax.yaxis)
    return legend_above(ax, columns=1)


# -- arrays ----------------------------------------------------------------------------------------


@styled
def array_map(table: pd.DataFrame, array: WhiskerArray) -> Figure:
    """Resolution over places: by all whiskers, what they gain, the best one, how many touch.

    Parameters
    ----------
    table : DataFrame
        From `array_resolution`.
    array : WhiskerArray
        As it was then, drawn in grey.
    """
    x, y = np.unique(table["x_mm"]), np.unique(table["y_mm"])
    figure = new_figure(DOUBLE, 4.3)
    figure.set_layout_engine("compressed")  # else colour bars stand far from maps in proportion
    axes = figure.subplots(2, 2, sharex=True, sharey=True)

    def drawn(ax: Axes, values: Any, label: str = "", beyond: str = "neither", **how: Any) -> Any:
        over = np.asarray(values, dtype=float).reshape(len(x), len(y)).T
        mesh = ax.pcolormesh(x, y, over, shading="nearest", rasterized=True, **how)
        if not label:
            return None
        return figure.colorbar(mesh, ax=ax, label=label, shrink=0.85, extend=beyond)

    error, best = table["error_mm"], table["best"]
    # Colours end where a hundredth of the places lies beyond.
    norm = LogNorm(*np.nanquantile(error, [0.01, 0.99]))
    bar = drawn(axes[0, 0], error, "error of place (mm)", "both", norm=norm, cmap="viridis_r")
    log_numbers(bar.ax.yaxis)
    gain = table["best_error_mm"] / error
    words = "best whisker's error / all whiskers'"
    drawn(axes[0, 1], gain, words, "max", cmap="cividis", vmin=1, vmax=6)
    touching = np.where(table["touching"] > 0, table["touching"], np.nan)
    drawn(axes[1, 1], touching, "whiskers that touch", cmap="cividis")
    rows = [np.nan if name == "" else "ABCDE".index(name[0]) for name in best]
    colours = ListedColormap(COLOURS[:5])
    drawn(axes[1, 0], rows, cmap=colours, vmin=-0.5, vmax=4.5, alpha=0.55)
    for row in sorted({int(row) for row in rows if row == row}):
        axes[1, 0].fill_between([], [], color=COLOURS[row], alpha=0.55, label="ABCDE"[row])
    axes[1, 0].legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), title="row", handlelength=1.0)
    written = np.empty((0, 2))
    room = 0.11 * np.ptp(x), 0.06 * np.ptp(y)  # of a name
    own = [mine for _, mine in table[best != ""].groupby("best")]
    for mine in sorted(own, key=len, reverse=True):
        if len(mine) > 0.006 * len(table):
            # The name stands on the place of its own that is nearest to their middle.
            place = mine[["x_mm", "y_mm"]].to_numpy()
            at = place[np.argmin(np.sum((place - np.median(place, axis=0)) ** 2, axis=1))]
            if (np.abs(written - at) < room).all(axis=1).any():
                continue  # beside a larger one's
            written = np.vstack([written, at])
            name = str(mine["best"].iloc[0])
            axes[1, 0].text(*at, name, fontsize=SMALL, ha="center", va="center")
    titles = ("all whiskers", "what all gain on the best one", "the best whisker", "how many touch")
    for ax, title in zip(axes.ravel(), titles, strict=True):
        for whisker in array.whiskers.values():
            ax.plot(*from_above(whisker), color="0.4", linewidth=0.4)
        ax.set(title=title, aspect="equal", xlim=(x[0], x[-1]), ylim=(y[0], y[-1]))
    for low, left in zip(axes[1], axes[:, 0], strict=True):
        low.set_xlabel("to the right (mm); lines: whiskers")
        left.set_ylabel("rostral (mm)")
    return figure


@styled
def array_counts(table: pd.DataFrame) -> Figure:
    """Discrimination of aperture widths, and what is touched, by the whiskers left intact.

    Parameters
    ----------
    table : DataFrame
        Of `array_by_count`, with a column ``receptors`` that says what they are.
    """
    figure = new_figure(DOUBLE, 3.0)
    left, right = figure.subplots(1, 2, sharex=True)
    for i, (name, rows) in enumerate(table.groupby("receptors", sort=False)):
        shown = rows["count"], rows["correct"], rows["correct_error"]
        errors(left, *shown, i, linestyle=LINES[i], capsize=0, label=str(name))
        ends, words = rows.iloc[-1], "" if i else "in proportion, as rats' (Krupa et al. 2001)"
        line: Any = {"color": "0.6", "linewidth": 0.8, "zorder": 0, "label": words}
        left.plot([0, ends["count"]], [0.5, ends["correct"]], **line)
    share = rows["touching"] / rows["count"]
    right.plot(rows["count"], rows["touched"], **look(0), label="places that some touch")
    right.plot(rows["count"], share, **look(1), label="of intact ones, that touch")
    left.set(xlabel="whiskers intact on a side", ylabel="right answers (bars: 95 %)")
    left.set_ylim(0.48, 1.0)
    right.set(xlabel="whiskers intact on a side", ylabel="share", ylim=(0.0, 1.0))
    for ax in (left, right):
        ax.set_xticks(range(0, int(table["count"].max()) + 1, 5))
        legend_above(ax, 1)
    return figure
