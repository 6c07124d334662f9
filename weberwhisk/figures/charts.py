"""Error against time of many methods, and growth: the tables of `weberwhisk.charts`."""

from __future__ import annotations

from collections.abc import Iterable
from textwrap import fill
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.ticker import LogLocator, NullFormatter

from .style import COLOURS, DOUBLE, LINES, MARKERS, SMALL, new_figure, styled

#: Unit roundoff of the numbers, and the bias that the ladder allows, in JNDs.
ROUNDING, ALLOWED = float(np.finfo(float).eps), 0.1
#: Rows of a posteriors' table that are no method.
LANDMARKS = ("closed form", "referee")
#: Letters of small print in a line.
FOOT = 130


@styled
def speed_accuracy(
    table: pd.DataFrame, *, weber_fraction: float = 0.1, foot: str = "", outside: Iterable[str] = ()
) -> Any:
    """Beams above and posteriors below, a panel for each scene; every method a line over its knob.

    Crosses mark settings at which a method fails or flags answers, with their share; at the upper
    edge those without any answer. Methods named in `outside` have hollow marks.
    """
    figure = new_figure(DOUBLE, 7.4)
    rows: Any = figure.subfigures(2, 1, height_ratios=(1.0, 1.08))
    beams, posteriors = (table[table["part"] == part] for part in ("beams", "posteriors"))
    axes = _row(rows[0], beams, set(outside))
    for ax, (_, part) in zip(axes, beams.groupby("scene", sort=False), strict=True):
        closed = part[part["method"].str.startswith("rung 0")]["seconds"].min()
        _limits(ax, closed, ROUNDING, "rounding")
        ax.axhline(ALLOWED * weber_fraction, color="0.6", linewidth=0.7, linestyle="--")
        ax.set_ylim(1e-17, 30)
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
        referee, closed = (part[part["method"] == name] for name in ("referee", "closed form"))
        doubt = max(float(referee["error"].iloc[0]), ROUNDING)
        _limits(ax, float(closed["seconds"].iloc[0]), doubt, "referee")
        ax.set_ylim(1e-17, 30)
    axes[0].set_ylabel("r.m.s. relative error of the sd")
    rows[1].supxlabel(
        f"CPU time of one posterior (s), k = {weber_fraction:g}\n{fill(foot, FOOT)}", fontsize=SMALL
    )
    return figure


@styled
def fits_and_growth(table: pd.DataFrame, *, foot: str = "", outside: Iterable[str] = ()) -> Any:
    """RMSE and coverage of fits against time, above; time and memory against size, below."""
    figure = new_figure(DOUBLE, 6.6)
    rows: Any = figure.subfigures(2, 1)
    fits, growth = (table[table["part"] == part] for part in ("fits", "growth"))
    left, right = rows[0].subplots(1, 2)
    for i, (method, part) in enumerate(fits.groupby("method", sort=False)):
        style = _style(i, method in set(outside)) | {"label": method}
        left.loglog(part["seconds"], part["error"], **style)
        miss = 100 * (part["coverage"] - 0.95)
        spread = 100 * np.sqrt(0.95 * 0.05 / part["count"])
        right.errorbar(part["seconds"], miss, spread, elinewidth=0.7, **style)
        for _, row in part.iterrows():
            left.annotate(
                f"{row['knob']:.0f}", (row["seconds"], row["error"]), fontsize=5,
                textcoords="offset points", xytext=(4, 2),
            )  # fmt: skip
    left.set(ylabel="relative RMSE of the Weber fraction", xlabel="CPU time of a fit (s)")
    right.axhline(0, color="0.4", linewidth=0.7, linestyle=":")
    right.set(xscale="log", xlabel="CPU time of a fit (s)")
    right.set_ylabel("coverage of the 95 % interval − 95 (points)")
    for ax in (left, right):  # often less than a decade, where labels of minor ticks overlap
        ax.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 3.0, 5.0)))
        ax.xaxis.set_major_formatter("{x:g}")
        ax.xaxis.set_minor_formatter(NullFormatter())
    left.set_title("small numbers: trials of a data set")
    right.set_title("bars: one standard error of the coverage")
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
    _legend(rows[1], [axes[0]], columns=2)
    if foot:
        rows[1].supxlabel(fill(foot, FOOT), fontsize=SMALL)
    return figure


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
        error = max(row["error"], ROUNDING / 2) if np.isfinite(row["error"]) else 10.0
        ax.plot(row["seconds"], error, "x", color="black", markersize=6, markeredgewidth=0.9)
        ax.annotate(
            f"{row['failed']:.0%}", (row["seconds"], error), fontsize=5,
            textcoords="offset points", xytext=(4, 3),
        )  # fmt: skip


def _limits(ax: Axes, closed: float, floor: float, name: str) -> None:
    ax.axvline(closed, color="0.4", linewidth=0.7, linestyle=":")
    ax.axhline(floor, color="0.4", linewidth=0.7, linestyle=":")
    top = ax.get_xaxis_transform()
    ax.text(closed * 1.15, 0.02, "closed form", rotation=90, fontsize=5, transform=top, va="bottom")
    ax.text(
        0.99, floor, name, fontsize=5, transform=ax.get_yaxis_transform(), ha="right", va="bottom"
    )


def _legend(figure: Any, axes: list[Axes], columns: int = 4) -> None:
    found: dict[str, Any] = {}
    for ax in axes:
        for handle, label in zip(*ax.get_legend_handles_labels(), strict=True):
            found.setdefault(label, handle)
    figure.legend(
        found.values(), found.keys(), loc="outside upper center", ncols=columns, fontsize=SMALL
    )
