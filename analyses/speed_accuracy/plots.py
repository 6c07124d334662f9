"""Error against time, and how time and memory grow: figures of the tables of `chart`."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
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

Styles = dict[str, dict[str, Any]]
#: Okabe and Ito's, and two of Tol's: a figure has nine methods.
ALL_COLOURS = (*COLOURS, "#882255", "#999933")
#: Unit roundoff of the numbers.
ROUNDING = float(np.finfo(float).eps)
#: Letters of small print in a line, and where the axes of errors end.
FOOT, TOP = 130, 3e4


@styled
def beams(
    table: pd.DataFrame, styles: Styles, *, weber_fraction: float = 0.1, allowed: float = 0.1
) -> Figure:
    """Bent whiskers, a panel for each scene; every method a line over its knob.

    Crosses mark settings at which a method fails, at the upper edge those without any answer; the
    dashed line is the bias, in JNDs, that models are `allowed`.
    """
    figure = new_figure(DOUBLE, 3.9)
    k = weber_fraction
    axes = _row(figure, table, styles, "relative error of the moment", "rounding")
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
    return _footed(figure, "CPU time of one contact (s)")


@styled
def posteriors(table: pd.DataFrame, styles: Styles, *, weber_fraction: float = 0.1) -> Figure:
    """Posteriors of one reading, a panel for each scene; every method a line over its knob.

    Crosses mark settings at which a method flags answers, with their share.
    """
    figure = new_figure(DOUBLE, 3.9)
    axes = _row(figure, table, styles, "r.m.s. relative error of the sd", "referee")
    axes[0].set_ylim(1e-17, TOP)
    return _footed(figure, f"CPU time of one posterior (s), k = {weber_fraction:g}")


@styled
def jnds(table: pd.DataFrame, styles: Styles) -> Figure:
    """Curves of JNDs, a panel for each scene; every method a line over its readings."""
    figure = new_figure(DOUBLE, 3.4)
    truth = "Monte Carlo error of the truth"
    axes = _row(figure, table, styles, "r.m.s. relative error of the JND", truth, below=True)
    for ax, (_, part) in zip(axes, table.groupby("scene", sort=False), strict=True):
        swept = part[part["knob"] > 0]
        for i, (_, row) in enumerate(swept.iterrows()):  # in turn above and below
            _beside(ax, f"{row['knob']:.0f}", row, (4, -8 if i % 2 else 2))
    return _footed(figure, "CPU time of a JND at one distance (s); small numbers: readings")


@styled
def fits(table: pd.DataFrame, styles: Styles) -> Figure:
    """RMSE and coverage of fits against time."""
    figure = new_figure(DOUBLE, 3.2)
    left, right = figure.subplots(1, 2)
    for i, (method, part) in enumerate(table.groupby("method", sort=False)):
        style = styles[str(method)] | {"label": method}
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
        log_numbers(ax.xaxis)
    log_numbers(left.yaxis)
    _legend(figure, [left])
    return _footed(figure, "CPU time of a fit (s)")


@styled
def growth(table: pd.DataFrame, styles: Styles) -> Figure:
    """Time and memory of one call against its size."""
    figure = new_figure(DOUBLE, 3.9)
    axes = figure.subplots(1, 2)
    for ax, column, unit in zip(
        axes, ("seconds", "bytes"), ("CPU time (s)", "peak memory (bytes)"), strict=True
    ):
        for method, part in table.groupby("method", sort=False):
            by_time, by_size = (part[f"slope_{c}"].iloc[0] for c in ("seconds", "bytes"))
            grows = (("time", by_time), ("memory", by_size))
            label = ", ".join(
                [f"{what} ∝ n^{power:.2f}" for what, power in grows if power == power]
            )
            label = f"{method}: {label}" if label else str(method)
            ax.loglog(part["count"], part[column], **styles[str(method)], label=label)
        ax.set(ylabel=unit)
    _legend(figure, [axes[0]])
    return _footed(figure, "n in one call")


FIGURES: dict[str, Callable[..., Figure]] = {
    "beams": beams, "posteriors": posteriors, "jnds": jnds, "fits": fits, "growth": growth,
}  # fmt: skip


def figures(
    tables: Mapping[str, pd.DataFrame], *, foot: str = "", outside: Iterable[str] = ()
) -> dict[str, Figure]:
    """A figure of each table; methods named in `outside` have hollow marks."""
    styles, hollow = styles_of(tables, set(outside)), set(outside)
    made = {}
    for name, draw in FIGURES.items():
        made[name] = draw(tables[name], styles[name])
        words = made[name].get_supxlabel()
        marks = "hollow marks: tools of others" if hollow & set(styles[name]) else ""
        small = "\n".join(filter(None, [words, marks, fill(foot, FOOT)]))
        made[name].supxlabel(small, fontsize=SMALL)
    return made


def method_of(name: str) -> str:
    """What a line of the figures is of, whatever its settings: these have a line style each."""
    name = name.removeprefix("posteriors, ")
    # Of SciPy there are several methods; the last way of fitting is another model.
    whole = name.startswith("SciPy") or name.endswith("equal-variance")
    return name if whole else name.split(",")[0]


def styles_of(tables: Mapping[str, pd.DataFrame], hollow: set[str]) -> dict[str, Styles]:
    """Styles of each figure: one colour one method, which keeps it in the next where it can."""
    colour_of: dict[str, str] = {}
    out = {}
    for part, table in tables.items():
        known = table if "failed" not in table else table[table["failed"].notna()]
        names = list(dict.fromkeys(known["method"].astype(str)))
        methods = {name: name if part == "growth" else method_of(name) for name in names}
        here: dict[str, str] = {}
        for method in dict.fromkeys(methods.values()):
            free = [c for c in ALL_COLOURS if c not in here.values()]
            kept = colour_of.get(method)
            here[method] = kept if kept in free else _unkept(free, methods.values(), colour_of)
        colour_of |= here
        ways: dict[str, int] = {}
        out[part] = {}
        for i, (name, method) in enumerate(methods.items()):
            ways[method] = ways.get(method, -1) + 1
            style: dict[str, Any] = {
                "color": here[method], "marker": MARKERS[i % len(MARKERS)],
                "linestyle": LINES[ways[method] % len(LINES)], "linewidth": 1.0, "markersize": 3.5,
            }  # fmt: skip
            out[part][name] = style | ({"markerfacecolor": "white"} if name in hollow else {})
    return out


def _unkept(free: list[str], methods: Iterable[str], colour_of: Mapping[str, str]) -> str:
    """The first colour that no other method of this figure has from one before."""
    taken = {colour_of.get(method) for method in methods}
    return next((c for c in free if c not in taken), free[0])


def _footed(figure: Figure, words: str) -> Figure:
    figure.supxlabel(words, fontsize=SMALL)
    return figure


def _row(
    figure: Any,
    table: pd.DataFrame,
    styles: Styles,
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
