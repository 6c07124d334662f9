"""Remake the paper's figure 3: the balance of moments between a muscle and a whisker.

    python analyses/figure_3.py [folder]

Writes figure_3 (PNG, SVG) and its tables: figure_3a.csv (moments against angle), figure_3b.csv (θ_b
against distance), figure_3c.csv (θ_b and the outcome over distance and impact angle) and
figure_3_check.csv (what the caption and §2h say, as numbers).

Equation (2.2) as printed is not the curve drawn in the paper's figure 3a. Each panel that depends
on it therefore shows all three curves by name: *figure*, sin(θ − 23°), read off the dashed curve;
*printed*, equation (2.2) with w = 1.25, which peaks at 0.625 near 129°; *normalised*, the same with
a peak of 1. The whisker's moment is scaled by 2.0 per EI/L for all of them, which with the figure's
curve reproduces the paper's values of figure 3b.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from command import options
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

import weberwhisk as ww
from weberwhisk import figures
from weberwhisk.mechanics.muscle import (
    FIGURE_GAIN,
    WHISKING,
    Balance,
    MuscleCurve,
    moment_balance,
)
from weberwhisk.runs import Run

Array = NDArray[np.float64]

WHISKER = ww.Whisker(length=50e-3, base_radius=100e-6, tip_radius=5e-6, youngs_modulus=3e9)
IMPACT = np.radians(60.0)
#: Distances over L of panel a, and those of panel b with the paper's θ_b in degrees.
SHOWN = (0.3, 0.5, 0.7, 0.9)
PAPER_3B = {0.3: 2.55, 0.4: 4.06, 0.5: 6.29, 0.6: 10.09, 0.65: 13.54}
#: Panel c: distances over L and impact angles in degrees.
DISTANCES, IMPACTS = np.linspace(0.3, 1.0, 71), np.linspace(30.0, 150.0, 61)


def moments() -> pd.DataFrame:
    """Panel a: the whisker's scaled moment at four distances, up to flick-past."""
    tables = []
    for share in SHOWN:
        r = share * WHISKER.length
        end = float(ww.flick_past(WHISKER, r).deflection_angle)
        past = end * (1 - np.linspace(1, 0, 200) ** 2)
        bent = ww.press(WHISKER, r, past)
        columns = {
            "radial_distance": np.full(past.size, share),
            "angle_deg": np.degrees(IMPACT + past),
            "moment": FIGURE_GAIN * bent.normalised_moment,
        }
        tables.append(pd.DataFrame(columns))
    return pd.concat(tables, ignore_index=True)


def balance_angles() -> pd.DataFrame:
    """Panel b: θ_b at the impact angle of 60°, for each curve, and where each curve ends."""
    tables = []
    for curve in MuscleCurve:
        share = np.append(np.linspace(0.3, 1.0, 141), curve_end(curve))
        b = moment_balance(WHISKER, np.sort(share) * WHISKER.length, IMPACT, curve=curve)
        columns = {
            "curve": np.full(share.size, curve.value),
            "radial_distance": np.sort(share),
            "balance_angle_deg": np.degrees(b.balance_angle),
            "outcome": [Balance(k).name for k in b.outcome],
        }
        tables.append(pd.DataFrame(columns))
    return pd.concat(tables, ignore_index=True)


def curve_end(curve: MuscleCurve, impact: float = IMPACT) -> float:
    """The largest distance over L at which muscle and whisker still balance, by bisection."""
    low, high = 0.3, 1.0
    for _ in range(26):
        middle = (low + high) / 2
        b = moment_balance(WHISKER, middle * WHISKER.length, impact, curve=curve)
        low, high = (middle, high) if b.outcome is Balance.BALANCED else (low, middle)
    return low


def surface(curve: MuscleCurve) -> pd.DataFrame:
    """Panel c: θ_b and the outcome over distance and impact angle."""
    b = moment_balance(
        WHISKER, DISTANCES * WHISKER.length, np.radians(IMPACTS)[:, None], curve=curve
    )
    share, impact = np.meshgrid(DISTANCES, IMPACTS)
    columns = {
        "curve": np.full(share.size, curve.value),
        "radial_distance": share.ravel(),
        "impact_angle_deg": impact.ravel(),
        "balance_angle_deg": np.degrees(b.balance_angle).ravel(),
        "outcome": [Balance(k).name for k in b.outcome.ravel()],
    }
    return pd.DataFrame(columns)


def dashed_line() -> tuple[Array, Array]:
    """Distance over L and impact angle (degrees) between the two white areas.

    From an impact there, the whisker would flick past just as its range of motion ends.
    """
    flick = ww.flick_past(WHISKER, DISTANCES * WHISKER.length).deflection_angle
    return DISTANCES, np.degrees(WHISKING[1] - flick)


def check(b: pd.DataFrame, c: pd.DataFrame) -> pd.DataFrame:
    """What caption and text say of the figure, a row a claim, with the paper's numbers."""
    figure = MuscleCurve.FIGURE
    rows: list[tuple[str, float, float]] = []
    for share, degrees in PAPER_3B.items():
        found = moment_balance(WHISKER, share * WHISKER.length, IMPACT).balance_angle
        rows.append((f"b: θ_b at {share:g} L, degrees", float(np.degrees(found)), degrees))
    for curve in MuscleCurve:
        expected = 0.684 if curve is figure else np.nan
        end = b.loc[(b["curve"] == curve.value) & (b["outcome"] == "BALANCED"), "radial_distance"]
        rows.append((f"b: end of the curve, {curve.value}, r/L", end.max(), expected))
    past = moment_balance(WHISKER, np.array(SHOWN) * WHISKER.length, IMPACT).outcome
    rows.append(("a: distances of four that flick past", int(np.sum(past != 0)), 2))
    falling = b.groupby("curve")["balance_angle_deg"].apply(lambda t: np.sum(np.diff(t) <= 0))
    rows.append(("b: falls of θ_b with distance, all curves", int(falling.sum()), 0))
    grid = c[c["curve"] == figure.value]
    below = _below_the_line(grid)
    early = grid["outcome"].isin(["FLICKED_PAST", "SLIPPED_OFF_TIP"])
    late = grid["outcome"] == "END_OF_WHISKING"
    rows.append(("c: flicked past, but above the dashed line", int(np.sum(early & ~below)), 0))
    rows.append(("c: range of whisking ended, but below it", int(np.sum(late & below)), 0))
    return pd.DataFrame(rows, columns=["claim", "found", "paper"])


def _below_the_line(grid: pd.DataFrame) -> Array:
    share, angle = dashed_line()
    limit = np.interp(grid["radial_distance"], share, angle)
    return np.asarray(grid["impact_angle_deg"] <= limit + 1e-9)


def draw(a: pd.DataFrame, b: pd.DataFrame, c: pd.DataFrame) -> Figure:
    """Panels a and b, and c for the figure's curve and for the printed one."""
    figure = figures.new_figure(figures.DOUBLE, 5.6)
    axes = figure.subplots(2, 2)
    _moments(axes[0, 0], a, b)
    _angles(axes[0, 1], b)
    for ax, curve in zip(axes[1], (MuscleCurve.FIGURE, MuscleCurve.PRINTED), strict=True):
        _surface(ax, c[c["curve"] == curve.value])
    axes[0, 0].set_title("(a) impact at 60°", loc="left", fontsize=8)
    axes[0, 1].set_title("(b) impact at 60°", loc="left", fontsize=8)
    axes[1, 0].set_title("(c) with the figure's curve", loc="left", fontsize=8)
    axes[1, 1].set_title("(c) with equation (2.2) as printed", loc="left", fontsize=8)
    for ax in axes.flat:
        ax.tick_params(labelsize=7)
        ax.xaxis.label.set_size(8)
        ax.yaxis.label.set_size(8)
        ax.spines[["top", "right"]].set_visible(False)
    return figure


def _moments(ax: Axes, a: pd.DataFrame, b: pd.DataFrame) -> None:
    theta = np.linspace(*WHISKING, 300)
    styles = (":", "-.", "--"), ("0.5", "0.5", "0.0"), ((139, 0.66), (116, 1.06), (120, 0.86))
    for curve, style, shade, (x, y) in zip(MuscleCurve, *styles, strict=True):
        ax.plot(np.degrees(theta), curve.moment(theta), style, color=shade, linewidth=1.2)
        ax.text(x, y, curve.value, color=shade, fontsize=7, ha="center")
    for i, share in enumerate(SHOWN):
        rows = a[a["radial_distance"] == share]
        ax.plot(
            rows["angle_deg"],
            rows["moment"],
            color=figures.COLOURS[i],
            linewidth=1.2,
            label=f"r = {share:g} L",
        )
        at = b[np.isclose(b["radial_distance"], share) & (b["outcome"] == "BALANCED")]
        for curve, degrees in zip(at["curve"], at["balance_angle_deg"], strict=True):
            angle = IMPACT + np.radians(degrees)
            ax.plot(
                np.degrees(angle),
                MuscleCurve(curve).moment(angle),
                figures.MARKERS[i],
                color=figures.COLOURS[i],
                markerfacecolor="white",
                markersize=3.5,
            )
    ax.set(
        xlabel="Follicle angle θ (degrees)",
        ylabel="Moment (units of the figure's muscle peak)",
        xlim=(30, 150),
        ylim=(0, 1.2),
    )
    ax.legend(frameon=False, fontsize=7, loc="lower right", title="whisker", title_fontsize=7)


def _angles(ax: Axes, b: pd.DataFrame) -> None:
    for i, curve in enumerate(MuscleCurve):
        rows = b[(b["curve"] == curve.value) & (b["outcome"] == "BALANCED")]
        end = rows["radial_distance"].iloc[-1]
        ax.plot(
            rows["radial_distance"],
            rows["balance_angle_deg"],
            color=figures.COLOURS[i],
            linestyle=figures.LINES[i],
            linewidth=1.2,
            label=f"{curve.value}: ends at {end:.4f} L",
        )
    ax.plot(
        list(PAPER_3B), list(PAPER_3B.values()), "o", color="0.0", markersize=3.5, label="paper"
    )
    ax.set(
        xlabel="Radial distance r/L",
        ylabel="Angle of moment balance θ$_b$ (degrees)",
        xlim=(0.3, 0.8),
        ylim=(0, None),
    )
    ax.legend(frameon=False, fontsize=7)


def _surface(ax: Axes, c: pd.DataFrame) -> None:
    shape = (IMPACTS.size, DISTANCES.size)
    values = c["balance_angle_deg"].to_numpy(float).reshape(shape)
    shown = ax.pcolormesh(
        DISTANCES, IMPACTS, np.ma.masked_invalid(values), cmap="viridis", vmin=0, vmax=30,
        rasterized=True,
    )  # fmt: skip
    share, angle = dashed_line()
    here = np.abs(IMPACTS[:, None] - angle).argmin(axis=0), np.arange(share.size)
    ax.plot(share, np.where(np.isnan(values[here]), angle, np.nan), "k--", linewidth=1)
    ax.axhline(60, color="white", linewidth=0.8, linestyle=":")
    bar = ax.figure.colorbar(shown, ax=ax, pad=0.02)
    bar.set_label("θ$_b$ (degrees)", fontsize=8)
    bar.ax.tick_params(labelsize=7)
    ax.text(0.86, 85, "flicked\npast", ha="center", fontsize=7)
    ax.annotate(
        "range of whisking ends", (0.62, 147), (0.31, 156), fontsize=7,
        arrowprops={"arrowstyle": "-", "linewidth": 0.5},
    )  # fmt: skip
    ax.set(
        xlabel="Radial distance r/L",
        ylabel="Impact angle θ$_i$ (degrees)",
        xlim=(0.3, 1),
        ylim=(30, 165),
        yticks=range(30, 151, 30),
    )


def make(folder: Path) -> pd.DataFrame:
    """Figure and tables into `folder`; returns the check of the claims."""
    inputs = {"radius_ratio": WHISKER.radius_ratio, "gain": FIGURE_GAIN}
    with Run(folder, "figure_3", inputs) as run:
        a, b = moments(), balance_angles()
        c = pd.concat([surface(curve) for curve in MuscleCurve], ignore_index=True)
        for letter, table in zip("abc", (a, b, c), strict=True):
            run.table(f"figure_3{letter}", table)
        checked = check(b, c)
        run.table("figure_3_check", checked)
        run.figure("figure_3", draw(a, b, c))
    return checked


if __name__ == "__main__":
    given = options(__file__, __doc__)
    print(make(given.folder).to_string(index=False, float_format="{:.6g}".format))
    print(f"Written to {given.folder}.")
