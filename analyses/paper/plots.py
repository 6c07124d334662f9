"""The paper's figures 1d, 2 and 3, from the tables of `remade`."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from weberwhisk.plots.style import (
    DOUBLE,
    SMALL,
    axes_or_new,
    legend_above,
    look,
    mark,
    new_figure,
    styled,
)

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
    held = angles[angles["outcome"] == "HELD"]
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
