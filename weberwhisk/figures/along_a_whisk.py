"""Along a whisk: resolution against push, limits, direction and speed; a distance followed."""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING, Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from .style import COLOURS, DOUBLE, LINES, MARKERS, SINGLE, axes_or_new, new_figure, styled

if TYPE_CHECKING:
    import pandas as pd


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
        look: dict[str, Any] = {
            "color": COLOURS[i],
            "linestyle": LINES[i % len(LINES)],
            "label": str(name),
        }
        if i >= len(LINES):
            look |= {"marker": MARKERS[i], "markevery": 10, "markersize": 3}
        push = rows["push_deg"]
        left.plot(push, rows["jnd_mm"], **look)
        right.plot(push, rows["radial_distance_mm"].where(~rows["tip"]), **look)
    left.set(yscale="log", xlabel="push since contact (°)", ylabel="JND of distance (mm), d'=1")
    left.set_yticks([0.1, 0.2, 0.5, 1.0, 2.0, 5.0], ["0.1", "0.2", "0.5", "1", "2", "5"])
    left.minorticks_off()
    right.set(xlabel="push since contact (°)", ylabel="radial distance (mm)")
    figure.legend(*left.get_legend_handles_labels(), loc="outside upper center", ncols=5)
    return figure


@styled
def lateral_sweep(table: pd.DataFrame) -> Figure:
    """True distance and the one followed from the moment, with its 95 % band, an object a panel.

    Parameters
    ----------
    table : DataFrame
        From `along_whisk.lateral_sweep`.
    """
    figure = new_figure(DOUBLE, 2.8)
    groups = list(table.groupby("object", sort=False))
    axes = figure.subplots(1, len(groups), sharey=True, squeeze=False)[0]
    for ax, (name, rows) in zip(axes, groups, strict=True):
        push = rows["push_deg"]
        ax.fill_between(
            push, rows["lower_mm"], rows["upper_mm"], color=COLOURS[4], alpha=0.35,
            linewidth=0, label="95 % of the posterior",
        )  # fmt: skip
        ax.plot(push, rows["radial_distance_mm"], color=COLOURS[0], label="followed")
        ax.plot(push, rows["true_distance_mm"], "--", color="black", label="true")
        ax.set(title=str(name), xlabel="push since contact (°)")
    figure.supylabel("radial distance (mm)")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure


@styled
def touches(table: pd.DataFrame, ax: Axes | None = None) -> Axes:
    """JND of a distance against the number of touches, beside 1/√n and what mice do.

    Parameters
    ----------
    table : DataFrame
        From `touches_jnd`, with ``receptors``: the name of each line.
    """
    ax = axes_or_new(ax, SINGLE, 3.2)
    for i, (name, rows) in enumerate(table.groupby("receptors", sort=False)):
        colour, n = COLOURS[i], rows["count"]
        ax.errorbar(
            n, rows["posterior_mm"], 1.96 * rows["posterior_error_mm"], color=colour,
            linestyle="none", marker=MARKERS[i], markersize=4, label=f"posterior, {name}",
        )  # fmt: skip
        ax.plot(n, rows["fisher_mm"], LINES[0], color=colour, label=f"information, {name}")
        first = rows.sort_values("count").iloc[0]  # at one touch, if it is there
        root = first["fisher_mm"] * (first["count"] / n) ** 0.5
        ax.plot(n, root, LINES[1], color=colour, linewidth=0.8, label=f"1/√n, {name}")
    ax.fill_between(
        [1, 17], 0.8, 1.25, color="0.85", linewidth=0, label="mice: about 1 mm, 1 to 17 touches"
    )
    ax.set(xscale="log", yscale="log", xlabel="touches", ylabel="JND of distance (mm), d'=1")
    ticks = [n for n in (1, 2, 5, 10, 20, 50) if n <= table["count"].max()]
    ax.set_xticks(ticks, map(str, ticks))
    sizes = (0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20)
    low, high = ax.get_ylim()
    ax.set_yticks(sizes, map(str, sizes))
    ax.set_ylim(low, high)
    ax.minorticks_off()
    ax.legend(loc="lower center", bbox_to_anchor=(0.45, 1.01), ncols=2)
    return ax


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
    low, high = 0.0, 1.15 * float(table["threshold_mm"].max())
    for shown, name, hatch in (
        (table["all_mm"].isna() & table["weber_mm"].notna(), "receptors saturated", "//"),
        (table["stopped"], "torque stops the push", "\\\\"),
    ):
        if shown.any():
            ax.fill_between(
                place, low, high, where=shown.to_numpy(), facecolor="none", edgecolor="0.6",
                hatch=hatch, linewidth=0, label=name,
            )  # fmt: skip
    ax.set(xlabel="radial distance r/L", ylabel="JND of distance (mm), d'=1", ylim=(low, high))
    ax.set_xlim(0, 1)
    ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.01), ncols=2)
    return ax


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
            angle = mine["push_deg"]
            if i == 0:
                jnd = mine["jnd_mm"]
                ax.fill_between(angle, -jnd, jnd, color="0.85", linewidth=0, label="± a JND")
            ax.plot(
                angle, mine["bias_mm"], LINES[i], color=COLOURS[i], marker=MARKERS[i],
                markevery=max(len(mine) // 8, 1), markersize=3, label=str(direction),
            )  # fmt: skip
        ax.axhline(0.0, color="black", linewidth=0.6)
        ax.set_title(f"{name}: base {base}")
    figure.supxlabel("push, or the angle of a peg to a base that moves (°)")
    figure.supylabel("error of the distance (mm) where friction is left out")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
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
    place = table["radial_distance_mm"] / (1e3 * length)
    lines = (
        ("first_frequency_hz", "first natural frequency, held"),
        ("ten_percent_hz", "moment off by 10 % (one JND, k = 0.1)"),
        ("one_percent_hz", "moment off by 1 % (a tenth of it)"),
    )
    for i, (column, name) in enumerate(lines):
        ax.plot(place, table[column], LINES[i], color=COLOURS[i], label=name)
    ax.axhspan(5.0, 12.0, color="0.88", linewidth=0, label="exploratory whisking, 5 to 12 Hz")
    ax.set(xlabel="radial distance r/L", ylabel="whisking frequency (Hz)", yscale="log")
    ax.set(xlim=(0, 1), ylim=(1, 200))
    ax.set_yticks([1, 2, 5, 10, 20, 50, 100, 200], map(str, (1, 2, 5, 10, 20, 50, 100, 200)))
    ax.minorticks_off()
    ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.01), ncols=1)
    return ax
