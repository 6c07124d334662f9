"""Contacts along a whisker; the array of whiskers, and what it tells of an object's place."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap, LogNorm
from matplotlib.figure import Figure

from .style import (
    COLOURS,
    DOUBLE,
    LINES,
    MARKERS,
    SINGLE,
    SMALL,
    axes_or_new,
    bars,
    legend_above,
    new_figure,
    styled,
)

if TYPE_CHECKING:
    import pandas as pd

    from ..array import Follicle, WhiskerArray
    from ..places import Place


@styled
def whisker_array(array: WhiskerArray, ax: Axes | None = None) -> Axes:
    """Whiskers from above, a colour and line style for each row; mm."""
    ax = axes_or_new(ax, DOUBLE, 2.6)
    for row, (colour, line) in enumerate(zip(COLOURS, [*LINES, "-"], strict=False)):
        mine = [w for w in array.whiskers.values() if w.identity[0] == "ABCDE"[row]]
        for i, whisker in enumerate(mine):
            label = f"row {whisker.identity[0]}" if i == 0 else None
            ax.plot(*_from_above(whisker), color=colour, linestyle=line, linewidth=0.9, label=label)
    ax.plot(*(1e3 * np.array([w.base[:2] for w in array.whiskers.values()])).T, "k.", markersize=2)
    ax.set(aspect="equal", xlabel="to the right (mm)", ylabel="rostral (mm)")
    ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.01), ncols=5, handlelength=2.4)
    return ax


def _from_above(whisker: Follicle) -> tuple[np.ndarray, np.ndarray]:
    """x and y, mm, along a whisker at rest in its plane of whisking."""
    law, straight = getattr(whisker.whisker, "law", None), whisker.whisker
    arc = np.linspace(0.0, getattr(straight, "whisker", straight).length, 40)
    # Curvature is positive away from the object, at positive angles of deflection backwards.
    along, across = (arc, 0 * arc) if law is None else law.point(arc)
    x, y = 1e3 * whisker.place(np.hypot(along, across), np.arctan2(across, along)).T
    return x, y


@styled
def place(found: Place, ax: Axes | None = None) -> Axes:
    """The region that holds an object with probability 95 %, its error ellipse, the whiskers.

    Whiskers that touch are drawn thick, as they lie where nothing bends them.
    """
    ax = axes_or_new(ax, SINGLE, 3.0)
    x, y = 1e3 * found.places.T
    order = np.argsort(-found.log_density)
    above = np.cumsum(found.weights[order])
    levels = [float(found.log_density[order][np.searchsorted(above, m)]) for m in (0.95, 0.5)]
    kept = found.log_density > levels[0] - 4.0
    if kept.sum() > 3:
        shades = [COLOURS[4], COLOURS[0]]
        ends = [*levels, float(found.log_density.max()) + 1.0]
        ax.tricontourf(x[kept], y[kept], found.log_density[kept], ends, colors=shades, alpha=0.6)
        for shade, words in zip(shades, ("95 % of the posterior", "50 %"), strict=True):
            ax.fill([], [], color=shade, alpha=0.6, label=words)
    major, minor, angle = found.ellipse()
    turn = np.linspace(0.0, 2 * np.pi, 90)
    u, v = major * np.cos(turn), minor * np.sin(turn)
    along = found.mean[0] + u * np.cos(angle) - v * np.sin(angle)
    across = found.mean[1] + u * np.sin(angle) + v * np.cos(angle)
    ax.plot(1e3 * along, 1e3 * across, "--", color=COLOURS[1], label="95 % error ellipse")
    for name, whisker in found.observer.array.whiskers.items():
        touches = name in found.touching
        colour, width = ("black", 1.2) if touches else ("0.7", 0.5)
        label = "whiskers that touch" if touches else "others"
        known = {str(line.get_label()) for line in ax.get_lines()}
        ax.plot(*_from_above(whisker), color=colour, linewidth=width,
                label=None if label in known else label)  # fmt: skip
    (left, right), (low, high) = ((a.min(), a.max()) for a in (x[kept], y[kept]))
    room = max(right - left, high - low) * 0.75
    ax.set(
        xlim=((left + right) / 2 - room, (left + right) / 2 + room),
        ylim=((low + high) / 2 - room, (low + high) / 2 + room),
        aspect="equal",
        xlabel="to the right (mm)",
        ylabel="rostral (mm)",
    )
    legend_above(ax)
    return ax


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
    figure = new_figure(DOUBLE, 5.6)
    axes = figure.subplots(2, 2, sharex=True, sharey=True)

    def over(values: Any) -> Any:
        return np.asarray(values, dtype=float).reshape(len(x), len(y)).T

    def drawn(ax: Axes, values: Any, label: str, ticks: Any = None, **how: Any) -> None:
        mesh = ax.pcolormesh(x, y, over(values), shading="nearest", rasterized=True, **how)
        bar = figure.colorbar(mesh, ax=ax, label=label, shrink=0.85, ticks=ticks)
        if ticks is not None:
            bar.ax.set_yticks(ticks, [f"{v:g}" for v in ticks])
            bar.ax.minorticks_off()

    error, best = table["error_mm"], table["best"]
    # Colours end where a hundredth of the places lies beyond.
    low, high = np.nanquantile(error, [0.01, 0.99])
    scale = {"norm": LogNorm(low, high), "cmap": "viridis_r"}
    ticks = [v for v in (0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0) if low <= v <= high]
    drawn(axes[0, 0], error, "error of place (mm)", ticks, **scale)
    gain = table["best_error_mm"] / error
    drawn(axes[0, 1], gain, "best whisker's error / all whiskers'", cmap="cividis", vmin=1, vmax=6)
    touching = np.where(table["touching"] > 0, table["touching"], np.nan)
    drawn(axes[1, 1], touching, "whiskers that touch", cmap="cividis")
    rows = [np.nan if name == "" else "ABCDE".index(name[0]) for name in best]
    colours = ListedColormap(COLOURS[:5])
    axes[1, 0].pcolormesh(
        x, y, over(rows), cmap=colours, vmin=-0.5, vmax=4.5, shading="nearest", rasterized=True,
        alpha=0.55,
    )  # fmt: skip
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
            ax.plot(*_from_above(whisker), color="0.4", linewidth=0.4)
        ax.set(title=title, aspect="equal", xlim=(x[0], x[-1]), ylim=(y[0], y[-1]))
    figure.supxlabel("to the right (mm); lines: whiskers")
    figure.supylabel("rostral (mm)")
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
        look = {"color": COLOURS[i], "marker": MARKERS[i], "markersize": 3}
        left.errorbar(
            rows["count"], rows["correct"], 1.96 * rows["correct_error"], linestyle=LINES[i],
            label=str(name), **look,
        )  # fmt: skip
        last = rows.iloc[-1]
        left.plot([0, last["count"]], [0.5, last["correct"]], color="0.6", linewidth=0.8, zorder=0)
    left.text(
        0.98, 0.04, "grey: in proportion, as rats' (Krupa et al. 2001)", fontsize=SMALL,
        color="0.4", ha="right", transform=left.transAxes,
    )  # fmt: skip
    right.plot(rows["count"], rows["touched"], color=COLOURS[0], label="places that some touch")
    share = rows["touching"] / rows["count"]
    right.plot(rows["count"], share, "--", color=COLOURS[1], label="of intact ones, that touch")
    left.set(xlabel="whiskers intact on a side", ylabel="right answers", ylim=(0.48, 1.0))
    right.set(xlabel="whiskers intact on a side", ylabel="share", ylim=(0.0, 1.0))
    for ax in (left, right):
        ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.01), ncols=2)
    return figure


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
    named = "row" if against is None else against.replace("_", " ")
    ax.set_xlabel(re.sub(" (m?s|mm?)$", r" (\1)", named))
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
