"""Error against time, and how time and memory grow: figures of the tables of `chart`."""

from __future__ import annotations

from collections.abc import Iterable
from textwrap import fill
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from weberwhisk.plots.style import (
    COLOURS,
    DOUBLE,
    LINES,
    MARKERS,
    SMALL,
    legend_over,
    log_numbers,
    new_figure,
    styled,
)

#: Unit roundoff of the numbers.
ROUNDING = float(np.finfo(float).eps)
#: Letters of small print in a line, and where the axes of errors end.
FOOT, TOP = 130, 3e4


@styled
def speed_accuracy(
    table: pd.DataFrame, *, weber_fraction: float = 0.1, allowed: float = 0.1, foot: str = "",
    outside: Iterable[str] = (),
) -> Figure:  # fmt: skip
    """Beams, posteriors and JND curves, a panel for each scene; every method a line over its knob.

    Crosses mark settings at which a method fails or flags answers, with their share; at the upper
    edge those without any answer. Methods named in `outside` have hollow marks; the
    dashed line is the bias, in JNDs, that models are `allowed`.
    """
    figure = new_figure(DOUBLE, 10.0)
    rows: Any = figure.subfigures(3, 1, height_ratios=(1.0, 1.1, 0.85))
    parts = dict(iter(table.groupby("part")))
    styles = _styles(table, set(outside))
    k = weber_fraction
    axes = _row(rows[0], parts["beams"], styles, "relative error of the moment", "rounding")
    in_jnds = (lambda error: error / k, lambda jnds: jnds * k)
    for ax in axes:
        ax.axhline(allowed * k, color="0.6", linewidth=0.7, linestyle="--")
        ax.set_ylim(1e-17, TOP)
        right = ax.secondary_yaxis("right", functions=in_jnds)
        right.yaxis.set_major_locator(LogLocator(numticks=6))
        right.yaxis.set_minor_formatter(NullFormatter())
        if ax is not axes[-1]:
            right.set_yticklabels([])
    right.set_ylabel(f"error of r (JND, k = {k:g})")
    rows[0].supxlabel("CPU time of one contact (s)", fontsize=8)
    error = "r.m.s. relative error of the"
    axes = _row(rows[1], parts["posteriors"], styles, f"{error} sd", "referee")
    axes[0].set_ylim(1e-17, TOP)
    rows[1].supxlabel(f"CPU time of one posterior (s), k = {k:g}", fontsize=8)
    truth = "Monte Carlo error of the truth"
    axes = _row(rows[2], parts["jnds"], styles, f"{error} JND", truth, below=True)
    for ax, (_, part) in zip(axes, parts["jnds"].groupby("scene", sort=False), strict=True):
        swept = part[part["knob"] > 0]
        for i, (_, row) in enumerate(swept.iterrows()):  # in turn above and below
            _beside(ax, f"{row['knob']:.0f}", row, (4, -8 if i % 2 else 2))
    words = "CPU time of a JND at one distance (s); small numbers: readings"
    rows[2].supxlabel(f"{words}\n{fill(foot, FOOT)}", fontsize=SMALL)
    return figure


@styled
def fits_and_growth(table: pd.DataFrame, *, foot: str = "", outside: Iterable[str] = ()) -> Figure:
    """RMSE and coverage of fits against time, above; time and memory against size, below."""
    figure = new_figure(DOUBLE, 6.6)
    rows: Any = figure.subfigures(2, 1)
    fits, growth = (table[table["part"] == part] for part in ("fits", "growth"))
    left, right = rows[0].subplots(1, 2)
    styles = _styles(table, set(outside))
    for i, (method, part) in enumerate(fits.groupby("method", sort=False)):
        style = styles[method] | {"label": method}
        left.errorbar(part["seconds"], part["error"], part["error_se"], elinewidth=0.7, **style)
        miss = 100 * (part["coverage"] - 0.95)
        spread = 100 * np.sqrt(0.95 * 0.05 / part["count"])
        right.errorbar(part["seconds"], miss, spread, elinewidth=0.7, **style)
        for _, row in part.iterrows():  # clear of those of tools as fast
            place = {"xytext": (4, 2)} if i < 2 else {"xytext": (-4, -3), "ha": "right"}
            _beside(left, f"{row['knob']:.0f}", row, **place)
    left.margins(x=0.12)
    left.set(xscale="log", yscale="log", ylabel="relative RMSE of the Weber fraction")
    left.set_title("small numbers: trials of a data set; bars: standard errors")
    right.axhline(0, color="0.4", linewidth=0.7, linestyle=":")
    right.set(xscale="log", ylabel="coverage − 95 (points)")
    right.set_title("95 % intervals; bars: one standard error")
    for ax in (left, right):
        ax.set_xlabel("CPU time of a fit (s)")
        log_numbers(ax.xaxis)
    log_numbers(left.yaxis)
    _legend(rows[0], [left])
    axes = rows[1].subplots(1, 2)
    for ax, column, unit in zip(
        axes, ("seconds", "bytes"), ("CPU time (s)", "peak memory (bytes)"), strict=True
    ):
        for i, (method, part) in enumerate(growth.groupby("method", sort=False)):
            by_time, by_size = (part[f"slope_{c}"].iloc[0] for c in ("seconds", "bytes"))
            grows = (("time", by_time), ("memory", by_size))
            label = ", ".join(
                [f"{what} ∝ n^{power:.2f}" for what, power in grows if power == power]
            )
            label = f"{method}: {label}" if label else method
            ax.loglog(part["count"], part[column], **_style(i, False), label=label)
        ax.set(xlabel="n in one call", ylabel=unit)
    _legend(rows[1], [axes[0]])
    if foot:
        rows[1].supxlabel(fill(foot, FOOT), fontsize=SMALL)
    return figure


def _style(i: int, hollow: bool) -> dict[str, Any]:
    style: dict[str, Any] = {
        "color": COLOURS[i % len(COLOURS)],
        "marker": MARKERS[i % len(MARKERS)],
        "linestyle": LINES[i // len(COLOURS) % len(LINES)],
        "linewidth": 1.0,
        "markersize": 3.5,
    }
    return style | ({"markerfacecolor": "white"} if hollow else {})


def _styles(table: pd.DataFrame, hollow: set[str]) -> dict[str, dict[str, Any]]:
    """One style a method in all panels: the same colour, mark and line wherever it is drawn."""
    known = table[table["failed"].notna()]["method"]
    names = dict.fromkeys(name.removeprefix("posteriors, ") for name in known)
    number = {name: i for i, name in enumerate(names)}
    return {
        name: _style(number[name.removeprefix("posteriors, ")], name in hollow)
        for name in dict.fromkeys(known)
    }


def _row(
    figure: Any,
    table: pd.DataFrame,
    styles: dict[str, dict[str, Any]],
    ylabel: str,
    floor: str,
    below: bool = False,
) -> list[Axes]:
    """A panel for each scene, with one legend, the time of the closed form and the least error.

    The `floor` is the error of the truth itself, if rounding is not above it.
    """
    scenes = list(table.groupby("scene", sort=False))
    known = table[table["failed"].notna()]  # what is left are referees, and times alone
    axes = list(np.atleast_1d(figure.subplots(1, len(scenes), sharey=True)))
    guide: Any = {"color": "0.4", "linewidth": 0.7, "linestyle": ":"}
    lowest = TOP
    for ax, (scene, here) in zip(axes, scenes, strict=True):
        for method in dict.fromkeys(known["method"]):
            one = here[(here["method"] == method) & here["failed"].notna()]
            _line(ax, one, styles[method], str(method))
        ax.set_title(str(scene), fontsize=SMALL)
        ax.set(xscale="log", yscale="log")
        closed = float(here[here["method"].str.contains("closed form")]["seconds"].min())
        least = max([*here[here["method"] == "referee"]["error"], ROUNDING])
        ax.axvline(closed, **guide)
        ax.axhline(least, **guide)
        place: Any = {"fontsize": SMALL, "transform": ax.get_xaxis_transform()}
        ax.text(closed * 1.15, 0.02, "closed form", rotation=90, va="bottom", **place)
        place["transform"] = ax.get_yaxis_transform()
        ax.text(0.99, least, floor, ha="right", va="top" if below else "bottom", **place)
        lowest = min(lowest, least / 3)
    axes[0].set_ylabel(ylabel)
    axes[0].set_ylim(bottom=min(axes[0].get_ylim()[0], lowest))  # of all panels
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
    drawn = ax.annotate(text, at, xytext=xytext, textcoords="offset points", fontsize=SMALL, **more)
    if box := drawn.get_bbox_patch():
        box.set_boxstyle("square", pad=0.05)


def _legend(figure: Any, axes: list[Axes]) -> None:
    """Every method once, in as many columns as its names leave room for."""
    names = [label for ax in axes for label in ax.get_legend_handles_labels()[1]]
    legend_over(figure, axes, max(min(FOOT // (max(map(len, names), default=0) + 9), 4), 1))
