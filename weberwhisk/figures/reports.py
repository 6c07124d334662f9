"""What commands draw of their own tables: the paper's figures 1d, 2 and 3, and error against time.

The tables are those of `weberwhisk.paper` and of `weberwhisk.charts`.
"""

from __future__ import annotations

from collections.abc import Iterable
from textwrap import fill
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from .style import (
    COLOURS,
    DOUBLE,
    LINES,
    MARKERS,
    SMALL,
    axes_or_new,
    legend_above,
    legend_over,
    log_numbers,
    look,
    mark,
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
    hollow, k = set(outside), weber_fraction
    axes = _row(rows[0], parts["beams"], hollow, "relative error of the moment", "rounding")
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
    axes = _row(rows[1], parts["posteriors"], hollow, f"{error} sd", "referee")
    axes[0].set_ylim(1e-17, TOP)
    rows[1].supxlabel(f"CPU time of one posterior (s), k = {k:g}", fontsize=8)
    truth = "Monte Carlo error of the truth"
    axes = _row(rows[2], parts["jnds"], hollow, f"{error} JND", truth, below=True)
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
            label = f"{method}: time ∝ n^{by_time:.2f}, memory ∝ n^{by_size:.2f}"
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


def _row(
    figure: Any, table: pd.DataFrame, hollow: set[str], ylabel: str, floor: str, below: bool = False
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
        for i, method in enumerate(dict.fromkeys(known["method"])):
            one = here[(here["method"] == method) & here["failed"].notna()]
            _line(ax, one, _style(i, method in hollow), str(method))
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


# -- the paper's figures ---------------------------------------------------------------------------

PARABOLA = "M² = 2EI·F$_x$"


@styled
def paper_1d(table: pd.DataFrame, ax: Axes | None = None) -> Axes:
    """Figure 1d: dM/dθ against radial distance, a line a whisker."""
    ax = axes_or_new(ax)
    for i, (name, rows) in enumerate(table.groupby("whisker", sort=False)):
        ax.plot(rows["radial_distance"], rows["rate"], **look(i), label=str(name))
    ax.set(xlabel="Radial distance r/L", ylabel="dM/dθ (EI/L)", xlim=(0, 1), yscale="log")
    return legend_above(ax)


@styled
def paper_2(examples: pd.DataFrame, lines: pd.DataFrame, contacts: pd.DataFrame) -> Figure:
    """Figure 2a–f, in the paper's order."""
    figure = new_figure(DOUBLE, 4.9)
    a, b, c, d, e, f = figure.subplots(2, 3).ravel()
    _examples(a, examples)
    numbered = {"tapered": (0.1, 0.3, 0.5, 0.7, 0.9, 1.0), "cylinder": (0.1, 0.3, 1.0)}
    for ax, (name, beside) in zip((b, c), numbered.items(), strict=True):
        _lines(ax, lines[lines["whisker"] == name], beside)
    for ax in (b, c):  # one range, to compare
        ax.set(xlim=(2e-3, 3e3), ylim=(2e-4, 30))
    tapered = contacts[contacts["whisker"] == "tapered"]
    _map(d, tapered, "radial_distance", "r/L", "viridis")
    _map(e, tapered, "deflection_angle_deg", "θ$_d$ (degrees)", "cividis")
    _curve(f, contacts[contacts["whisker"] == "cylinder"])
    titles = ("(a) loaded to α = 90°", "(b) tapered", "(c) cylinder", "(d) tapered: distance",
              "(e) tapered: angle", "(f) cylinder")  # fmt: skip
    for ax, title in zip((a, b, c, d, e, f), titles, strict=True):
        ax.set_title(title, loc="left")
    return figure


def _examples(ax: Axes, table: pd.DataFrame) -> None:
    for i, (share, bent) in enumerate(table.groupby("arc_length")):
        for k, (_, line) in enumerate(bent.groupby("contact_angle_deg")):
            ax.plot(line["x"], line["y"], **look(i, linewidth=0.7))
            label = f"s = {share:g} L" if k == 0 else None
            ax.plot(*line.iloc[-2][["x", "y"]], **mark(i, label=label))
    ax.set(xlabel="x/L", ylabel="y/L", aspect="equal", xlim=(0, 1.03), ylim=(-0.03, 1.15))
    ax.legend(loc="upper right", handletextpad=0.2, borderpad=0)


def _lines(ax: Axes, table: pd.DataFrame, numbered: tuple[float, ...]) -> None:
    groups = list(table.groupby("arc_length"))
    for i, (share, line) in enumerate(groups):
        shade, last = f"{0.75 * i / (len(groups) - 1):.2f}", line.iloc[-1]
        end = last["force"], last["moment"]
        ax.loglog(line["force"], line["moment"], color=shade, linewidth=0.9)
        ax.plot(*end, "o", color=shade, markersize=2.5)
        if round(float(share), 3) in numbered:  # type: ignore[arg-type]
            # A line whose moment has fallen ends clear of the others.
            fallen = last["moment"] < 0.8 * line["moment"].max()
            place: dict[str, Any] = {"xytext": (3, -1) if fallen else (-3, 2)}
            place |= {"ha": "left" if fallen else "right", "textcoords": "offset points"}
            ax.annotate(f"{share:g}", end, **place, fontsize=SMALL)
    ax.plot([], [], "o-", color="0.4", markersize=2.5, label="number: s/L\nend: α = 90°")
    ax.set(xlabel="Contact force F$_c$L²/EI", ylabel="Moment M$_z$L/EI")
    ax.legend(loc="lower right")


def _map(ax: Axes, table: pd.DataFrame, column: str, label: str, colours: str) -> None:
    columns = ("moment", "axial_force", column)
    shape = -1, table["arc_length"].round(9).nunique()
    moment, axial, values = (table[name].to_numpy(float).reshape(shape) for name in columns)
    shown = ax.pcolormesh(moment, axial, values, shading="gouraud", cmap=colours, rasterized=True)
    levels = 6 if column == "radial_distance" else 8
    lines = ax.contour(moment, axial, values, levels, colors="white", linewidths=0.5)
    limit = np.linspace(0, 9, 200)
    ax.plot(limit, limit**2 / 2, "--", color="0.4", linewidth=0.9, label=PARABOLA)
    ax.figure.colorbar(shown, ax=ax, pad=0.02, label=label).add_lines(lines)
    # Roots spread the small signals of contacts near the tip.
    ax.set_xscale("function", functions=(np.sqrt, np.square))
    ax.set_yscale("function", functions=(lambda v: np.abs(v) ** 0.25, lambda v: v**4))
    ax.set(xlim=(0, 9), ylim=(0, 120))
    ax.set_xticks([0.1, 1, 2, 4, 8], ["0.1", "1", "2", "4", "8"])
    ax.set_yticks([0.01, 0.1, 1, 10, 50, 100], ["0.01", "0.1", "1", "10", "50", "100"])
    ax.set(xlabel="M$_z$L/EI (square-root scale)", ylabel="F$_x$L²/EI (fourth-root scale)")
    ax.legend(loc="upper left")


def _curve(ax: Axes, table: pd.DataFrame) -> None:
    for i, share in enumerate((0.3, 0.6, 0.9)):
        line = table[np.isclose(table["arc_length"], share)].iloc[3 * i :: 9]
        style = mark(i, markersize=4, markerfacecolor="none", label=f"s = {share:g} L")
        ax.plot(line["moment"], line["axial_force"], **style)
    moment = np.linspace(0, 9, 100)
    ax.plot(moment, moment**2 / 2, "-", color="0.4", linewidth=0.9, label=PARABOLA)
    ax.set(xlabel="M$_z$L/EI", ylabel="F$_x$L²/EI", xlim=(0, 9), ylim=(0, 40))
    ax.legend(loc="upper left")


@styled
def paper_3(
    moments: pd.DataFrame,
    muscle: pd.DataFrame,
    angles: pd.DataFrame,
    surface: pd.DataFrame,
    edge: tuple[Any, Any],
) -> Figure:
    """Figure 3a–c: moments against angle, θ_b against distance, and θ_b from any impact angle.

    `edge` is the dashed line of 3c: where a whisker flicks past just as whisking ends.
    """
    figure = new_figure(DOUBLE, 2.9)
    a, b, c = figure.subplots(1, 3)
    a.plot(muscle["angle_deg"], muscle["moment"], "--", color="0.0", label="muscle, (2.2)")
    held = angles[angles["outcome"] == "BALANCED"]
    first = held[held["curve"] == held["curve"].iloc[0]]
    for i, (share, rows) in enumerate(moments.groupby("radial_distance")):
        a.plot(rows["angle_deg"], rows["moment"], **look(i, label=f"r = {share:g} L"))
        begin = float(rows["angle_deg"].iloc[0])
        balanced = np.isclose(first["radial_distance"], share)  # type: ignore[arg-type]
        at = begin + first["balance_angle_deg"][balanced].to_numpy(float)
        balance = np.interp(at, muscle["angle_deg"], muscle["moment"])
        a.plot(at, balance, **mark(i, markersize=4, markerfacecolor="white"))
    a.set(xlabel="Follicle angle θ (degrees)", ylabel="Moment (of the muscle's peak)")
    a.set(xlim=(30, 150), ylim=(0, 1.2), xticks=range(30, 151, 30))
    a.plot([], [], "o", color="0.4", markerfacecolor="white", label="balance")
    a.legend(loc="lower right", borderpad=0, handlelength=1.6)
    for i, (name, rows) in enumerate(held.groupby("curve", sort=False)):
        label = f"(2.2) {name}:\nends at {rows['radial_distance'].iloc[-1]:.3f} L"
        b.plot(rows["radial_distance"], rows["balance_angle_deg"], **look(i), label=label)
    b.set(xlabel="Radial distance r/L", ylabel="Angle of balance θ$_b$ (degrees)")
    b.set(xlim=(0.3, 0.8), ylim=(0, 27), yticks=range(0, 26, 5))
    b.legend(loc="upper left")
    values = surface.pivot(
        index="impact_angle_deg", columns="radial_distance", values="balance_angle_deg"
    )
    place, impact = values.columns.to_numpy(float), values.index.to_numpy(float)
    white = np.isnan(values.to_numpy())
    shown = c.pcolormesh(place, impact, values, cmap="viridis", vmin=0, rasterized=True)
    here = np.abs(impact[:, None] - np.asarray(edge[1])).argmin(axis=0), np.arange(place.size)
    c.plot(place, np.where(white[here], edge[1], np.nan), "k--", linewidth=1)
    c.axhline(60, color="white", linewidth=0.8, linestyle=":")
    c.text(place[0], 62, " 60°", color="white")
    figure.colorbar(shown, ax=c, pad=0.02, label="θ$_b$ (degrees)")
    c.text(0.86, 80, "flicked\npast", ha="center")
    c.text(0.98, 154, "whisking ends", ha="right")
    c.set(xlabel="Radial distance r/L", ylabel="Impact angle θ$_i$ (degrees)")
    c.set(xlim=(0.3, 1), ylim=(30, 165), yticks=range(30, 151, 30))
    for ax, title in ((a, "(a) impact at 60°"), (b, "(b) impact at 60°"), (c, "(c) any impact")):
        ax.set_title(title, loc="left")
    return figure
