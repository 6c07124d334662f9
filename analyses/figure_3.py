"""Remake the paper's figure 3: the balance of moments between a muscle and a whisker.

    python analyses/figure_3.py [folder]

Writes figure_3 (PNG, SVG) and its tables: figure_3a.csv (moments against angle), figure_3b.csv (θ_b
against distance), figure_3c.csv (θ_b and the outcome over distance and impact angle) and
figure_3_check.csv (what the caption and §2h say, as numbers).

The muscle is equation (2.2) with the arctangent of the full circle, its peak scaled to 1
(*normalised*) or as it is (*printed*), each on its own gain: with which the whisker flicks past
from 0.697 L on, for the "around 70 per cent" of the text. The two differ in their unit alone.
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
    WHISKING,
    Balance,
    MuscleCurve,
    moment_balance,
)
from weberwhisk.output import Run

Array = NDArray[np.float64]

WHISKER = ww.Whisker(length=50e-3, base_radius=100e-6, tip_radius=5e-6, youngs_modulus=3e9)
IMPACT = np.radians(60.0)
CURVES = (MuscleCurve.NORMALISED, MuscleCurve.PRINTED)
#: Distances over L of panel a.
SHOWN = (0.3, 0.5, 0.7, 0.9)
#: Panel c: distances over L and impact angles in degrees.
DISTANCES, IMPACTS = np.linspace(0.3, 1.0, 211), np.linspace(30.0, 150.0, 121)


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
            "moment": MuscleCurve.NORMALISED.gain() * bent.normalised_moment,
        }
        tables.append(pd.DataFrame(columns))
    return pd.concat(tables, ignore_index=True)


def balance_angles() -> pd.DataFrame:
    """Panel b: θ_b at the impact angle of 60°, on either scale, and where each curve ends."""
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
    """The largest distance over L at which muscle and whisker still balance, by finer grids."""
    low, high = 0.3, 1.0
    for _ in range(5):
        share = np.linspace(low, high, 33)
        b = moment_balance(WHISKER, share * WHISKER.length, impact, curve=curve)
        last = int(np.flatnonzero(b.outcome == Balance.BALANCED)[-1])
        low, high = share[last], share[last + 1]
    return float(low)


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
    rows: list[tuple[str, float, float]] = []
    for curve in MuscleCurve:
        end = b.loc[(b["curve"] == curve.value) & (b["outcome"] == "BALANCED"), "radial_distance"]
        rows.append((f"b: end of the curve, {curve.value}, r/L", end.max(), 0.7))
    past = moment_balance(WHISKER, np.array(SHOWN) * WHISKER.length, IMPACT).outcome
    rows.append(("a: distances of four that flick past", int(np.sum(past != 0)), 2))
    falling = b.groupby("curve")["balance_angle_deg"].apply(lambda t: np.sum(np.diff(t) <= 0))
    rows.append(("b: falls of θ_b with distance, all curves", int(falling.sum()), 0))
    grid = c[c["curve"] == MuscleCurve.NORMALISED.value]
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
    """Panels a and b, and c for equation (2.2) on either scale, each with its own gain."""
    figure = figures.new_figure(figures.DOUBLE, 5.6)
    axes = figure.subplots(2, 2)
    _moments(axes[0, 0], a, b)
    _angles(axes[0, 1], b)
    for ax, curve in zip(axes[1], CURVES, strict=True):
        _surface(ax, c[c["curve"] == curve.value])
    axes[0, 0].set_title("(a) impact at 60°", loc="left", fontsize=8)
    axes[0, 1].set_title("(b) impact at 60°", loc="left", fontsize=8)
    for ax, curve, words in zip(axes[1], CURVES, ("peak scaled to 1", "as printed"), strict=True):
        ax.set_title(f"(c) {words}, gain {curve.gain():g}", loc="left", fontsize=8)
    for ax in axes.flat:
        ax.tick_params(labelsize=7)
        ax.xaxis.label.set_size(8)
        ax.yaxis.label.set_size(8)
        ax.spines[["top", "right"]].set_visible(False)
    return figure


def _moments(ax: Axes, a: pd.DataFrame, b: pd.DataFrame) -> None:
    theta = np.linspace(*WHISKING, 300)
    muscle = MuscleCurve.NORMALISED
    ax.plot(np.degrees(theta), muscle.moment(theta), "--", color="0.0", linewidth=1.2)
    ax.text(116, 1.06, "muscle: equation (2.2)", color="0.0", fontsize=7, ha="center")
    b = b[b["curve"] == muscle.value]
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
        for degrees in at["balance_angle_deg"]:
            angle = IMPACT + np.radians(degrees)
            ax.plot(
                np.degrees(angle),
                muscle.moment(angle),
                figures.MARKERS[i],
                color=figures.COLOURS[i],
                markerfacecolor="white",
                markersize=3.5,
            )
    ax.set(
        xlabel="Follicle angle θ (degrees)",
        ylabel="Moment (units of the muscle's peak)",
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
    inputs = {"radius_ratio": WHISKER.radius_ratio, "gain": MuscleCurve.NORMALISED.gain()}
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
