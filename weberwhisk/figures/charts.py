"""Error against time of many methods, and growth: the tables of `weberwhisk.charts`."""

from __future__ import annotations

from collections.abc import Iterable
from textwrap import fill
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from .style import COLOURS, DOUBLE, LINES, MARKERS, SMALL, new_figure, styled

#: Unit roundoff of the numbers, and the bias that the ladder allows, in JNDs.
ROUNDING, ALLOWED = float(np.finfo(float).eps), 0.1
#: Rows of a posteriors' table that are no method.
LANDMARKS = ("closed form", "referee")
#: Letters of small print in a line, and where the axes of errors end.
FOOT, TOP = 130, 3e4


@styled
def speed_accuracy(
    table: pd.DataFrame, *, weber_fraction: float = 0.1, foot: str = "", outside: Iterable[str] = ()
) -> Figure:
    """Beams, posteriors and JND curves, a panel for each scene; every method a line over its knob.

    Crosses mark settings at which a method fails or flags answers, with their share; at the upper
    edge those without any answer. Methods named in `outside` have hollow marks.
    """
    figure = new_figure(DOUBLE, 10.0)
    rows: Any = figure.subfigures(3, 1, height_ratios=(1.0, 1.1, 0.85))
    beams, posteriors, jnds = (
        table[table["part"] == part] for part in ("beams", "posteriors", "jnds")
    )
    axes = _row(rows[0], beams, set(outside))
    for ax, (_, part) in zip(axes, beams.groupby("scene", sort=False), strict=True):
        _limits(ax, _closed_form(part), ROUNDING, "rounding")
        ax.axhline(ALLOWED * weber_fraction, color="0.6", linewidth=0.7, linestyle="--")
        ax.set_ylim(1e-17, TOP)
        right = ax.secondary_yaxis("right", functions=_scaling(weber_fraction))
        right.yaxis.set_major_locator(LogLocator(numticks=6))
        right.yaxis.set_minor_formatter(NullFormatter())
        if ax is axes[-1]:
            right.set_ylabel(f"error of r (JND, k = {weber_fraction:g})")
        else:
            right.set_yticklabels([])
    axes[0].set_ylabel("relative error of the moment")
    rows[0].supxlabel("CPU time of one contact (s)", fontsize=8)
    axes = _row(rows[1], posteriors[~posteriors["method"].isin(LANDMARKS)], set(outside))
    for ax, (_, part) in zip(axes, posteriors.groupby("scene", sort=False), strict=True):
        _limits(ax, _closed_form(part), _doubt(part), "referee")
        ax.set_ylim(1e-17, TOP)
    axes[0].set_ylabel("r.m.s. relative error of the sd")
    rows[1].supxlabel(f"CPU time of one posterior (s), k = {weber_fraction:g}", fontsize=8)
    axes = _row(rows[2], jnds[jnds["method"] != "referee"], set(outside))
    for ax, (_, part) in zip(axes, jnds.groupby("scene", sort=False), strict=True):
        doubt = _doubt(part)
        _limits(ax, _closed_form(part), doubt, "Monte Carlo error of the truth", below=True)
        ax.set_ylim(min(ax.get_ylim()[0], doubt / 3))
        swept = part[part["knob"] > 0]
        for i, (_, row) in enumerate(swept.iterrows()):  # in turn above and below
            _beside(ax, f"{row['knob']:.0f}", row, (4, -8 if i % 2 else 2))
    axes[0].set_ylabel("r.m.s. relative error of the JND")
    words = "CPU time of a JND at one distance (s); small numbers: readings"
    rows[2].supxlabel(f"{words}\n{fill(foot, FOOT)}", fontsize=SMALL)
    return figure


def _closed_form(part: pd.DataFrame) -> float:
    """Time of the closed form, the least there is."""
    return float(part[part["method"].str.contains("closed form")]["seconds"].min())


def _doubt(part: pd.DataFrame) -> float:
    """Error of the truth itself."""
    return max(float(part[part["method"] == "referee"]["error"].iloc[0]), ROUNDING)


@styled
def fits_and_growth(table: pd.DataFrame, *, foot: str = "", outside: Iterable[str] = ()) -> Figure:
    """RMSE and coverage of fits against time, above; time and memory against size, below."""
    figure = new_figure(DOUBLE, 6.6)
    rows: Any = figure.subfigures(2, 1)
    fits, growth = (table[table["part"] == part] for part in ("fits", "growth"))
    left, right = rows[0].subplots(1, 2)
    for i, (method, part) in enumerate(fits.groupby("method", sort=False)):
        style = _style(i, method in set(outside)) | {"label": method}
        left.errorbar(part["seconds"], part["error"], part["error_se"], elinewidth=0.7, **style)
        miss = 100 * (part["coverage"] - 0.95)
        spread = 100 * np.sqrt(0.95 * 0.05 / part["count"])
        right.errorbar(part["seconds"], miss, spread, elinewidth=0.7, **style)
        for _, row in part.iterrows():  # clear of those of tools as fast
            place = {"xytext": (4, 2)} if i < 2 else {"xytext": (-4, -3), "ha": "right"}
            _beside(left, f"{row['knob']:.0f}", row, **place)
    left.margins(x=0.12)
    left.set(xscale="log", yscale="log")
    left.set(ylabel="relative RMSE of the Weber fraction", xlabel="CPU time of a fit (s)")
    right.axhline(0, color="0.4", linewidth=0.7, linestyle=":")
    right.set(xscale="log", xlabel="CPU time of a fit (s)")
    right.set_ylabel("coverage − 95 (points)")
    for axis in (left.xaxis, left.yaxis, right.xaxis):
        _log_ticks(axis)
    left.set_title("small numbers: trials of a data set; bars: standard errors")
    right.set_title("95 % intervals; bars: one standard error")
    _legend(rows[0], [left])
    axes = rows[1].subplots(1, 2)
    for ax, column, unit in zip(
        axes, ("seconds", "bytes"), ("CPU time (s)", "peak memory (bytes)"), strict=True
    ):
        for i, (method, part) in enumerate(growth.groupby("method", sort=False)):
            by_time, by_size = (part[f"slope_{c}"].iloc[0] for c in ("seconds", "bytes"))
            label = f"{method}: time ∝ n^{by_time:.2f}, memory ∝ n^{by_size:.2f}"
            ax.loglog(part["count"], part[column], **_style(i, False), label=label)
        ax.set(xlabel="n in one call", ylabel=unit)
    _legend(rows[1], [axes[0]])
    if foot:
        rows[1].supxlabel(fill(foot, FOOT), fontsize=SMALL)
    return figure


def _log_ticks(axis: Any) -> None:
    """Plain numbers that do not run together, however few or many decades there are."""
    low, high = axis.get_view_interval()
    decades = np.log10(high / low)
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if decades < 1.5 else (1.0,)))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter(NullFormatter())


def _scaling(k: float) -> tuple[Any, Any]:
    return (lambda error: error / k), (lambda jnds: jnds * k)


def _style(i: int, hollow: bool) -> dict[str, Any]:
    style: dict[str, Any] = {
        "color": COLOURS[i % len(COLOURS)],
        "marker": MARKERS[i % len(MARKERS)],
        "linestyle": LINES[i // len(COLOURS) % len(LINES)],
        "linewidth": 1.0,
        "markersize": 3.5,
    }
    return style | ({"markerfacecolor": "white"} if hollow else {})


def _row(figure: Any, table: pd.DataFrame, outside: set[str]) -> list[Axes]:
    """A panel for each scene, with one legend below."""
    scenes = list(dict.fromkeys(table["scene"]))
    methods = list(dict.fromkeys(table["method"]))
    axes = list(np.atleast_1d(figure.subplots(1, len(scenes), sharey=True)))
    for ax, scene in zip(axes, scenes, strict=True):
        here = table[table["scene"] == scene]
        for i, method in enumerate(methods):
            _line(ax, here[here["method"] == method], _style(i, method in outside), method)
        ax.set_title(scene, fontsize=7)
        ax.set_xscale("log")
        ax.set_yscale("log")
    _legend(figure, axes)
    return axes


def _line(ax: Axes, part: pd.DataFrame, style: dict[str, Any], label: str) -> None:
    answered = part[np.isfinite(part["error"])]
    ax.plot(answered["seconds"], np.maximum(answered["error"], ROUNDING / 2), label=label, **style)
    for _, row in part[part["failed"] > 0].iterrows():
        lost = not np.isfinite(row["error"])
        error = TOP / 30 if lost else max(row["error"], ROUNDING / 2)
        ax.plot(row["seconds"], error, "x", color="black", markersize=6, markeredgewidth=0.9)
        if lost:  # all of them; said once
            if "no answer" not in (text.get_text() for text in ax.texts):
                ax.text(0.02, error, "no answer", fontsize=SMALL, va="center",
                        transform=ax.get_yaxis_transform())  # fmt: skip
            continue
        _beside(ax, f"{row['failed']:.0%}", row, (5, 3), backgroundcolor="white")


def _beside(ax: Axes, text: str, row: Any, xytext: tuple[float, float], **more: Any) -> None:
    """Small print beside a mark."""
    at = row["seconds"], max(row["error"], ROUNDING / 2)
    drawn = ax.annotate(
        text, at, xytext=xytext, textcoords="offset points", fontsize=SMALL, **more
    )
    if box := drawn.get_bbox_patch():
        box.set_boxstyle("square", pad=0.05)


def _limits(ax: Axes, closed: float, floor: float, name: str, *, below: bool = False) -> None:
    ax.axvline(closed, color="0.4", linewidth=0.7, linestyle=":")
    ax.axhline(floor, color="0.4", linewidth=0.7, linestyle=":")
    place: dict[str, Any] = {"fontsize": SMALL, "transform": ax.get_xaxis_transform()}
    ax.text(closed * 1.15, 0.02, "closed form", rotation=90, va="bottom", **place)
    place["transform"] = ax.get_yaxis_transform()
    ax.text(0.99, floor, name, ha="right", va="top" if below else "bottom", **place)


def _legend(figure: Any, axes: list[Axes]) -> None:
    """Every method once, in as many columns as its names leave room for."""
    found: dict[str, Any] = {}
    for ax in axes:
        for handle, label in zip(*ax.get_legend_handles_labels(), strict=True):
            found.setdefault(label, handle)
    columns = max(FOOT // (max(map(len, found), default=0) + 9), 1)
    figure.legend(
        found.values(), found.keys(), loc="outside upper center", ncols=min(columns, 4),
        fontsize=SMALL,
    )  # fmt: skip
