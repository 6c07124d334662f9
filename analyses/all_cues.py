"""Every cue on one whisker: which tells distance best where, what each adds, where it fails.

    python analyses/all_cues.py [folder] [--short]

Writes, with k = 0.1 for every signal of size: all_cues_jnd (the JND of each cue against r, on one
axis, and below it the posterior's JND over the closed form's, with its Monte Carlo error),
all_cues_best (the best cue at every contact, and where it is flicked past), all_cues_ridge (the
posterior of one reading on a tapered whisker and on a cylinder), all_cues_bits (what each cue tells
alone and adds to the others) as PNG and SVG, and their tables as CSV.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure

import weberwhisk as ww
from weberwhisk import figures
from weberwhisk.cues import (
    AngleSideAngle,
    BalanceOfMoments,
    ComparativeLength,
    Compliance,
    Cue,
    ForceMap,
    Fused,
    LateralSlip,
    Vibration,
    VibrissaLength,
)
from weberwhisk.cues.force_map import SIGNALS
from weberwhisk.jnd import fisher_jnd, jnd_curve
from weberwhisk.receptors import Weber
from weberwhisk.runs import Run

WHISKER = ww.Whisker(length=50e-3, base_radius=100e-6, tip_radius=5e-6, youngs_modulus=3e9)
K = 0.1
#: Deflection where a cue does not say, rad.
ANGLE = np.radians(5.0)
SEED = 20110166
DRAWS, DRAWS_SHORT = 200, 16
#: One line a cue, in the order of the paper's sections.
CUES: dict[str, Cue] = {
    "whisker length (a)": VibrissaLength(),
    "which of three whiskers touch (b)": ComparativeLength(
        [40e-3, 30e-3], [[0.0, 3e-3], [0.0, 6e-3]]
    ),
    "angle-side-angle (c)": AngleSideAngle(),
    "vibration, 3 modes with phase (d)": Vibration(3, phase=True),
    "tap (e)": Compliance(),
    "tap, velocity felt (e)": Compliance(velocity_spread=0.5),
    "tap on a tilted surface (e)": LateralSlip(),
    "moment and axial force (f)": ForceMap(),
    "moment and both forces (f)": ForceMap(SIGNALS),
    "moment at a known angle (f)": ForceMap("moment", deflection_angle=ANGLE),
    "balance of moments (h)": BalanceOfMoments(),
}
#: Those that a contact of any distance and angle has.
MAPPED = ("vibration, 3 modes with phase (d)", "tap (e)", "moment and axial force (f)",
          "moment and both forces (f)")  # fmt: skip


def curves(points: int, draws: int) -> pd.DataFrame:
    """The JND of every cue by every route, m, a row for each cue and distance."""
    tables = []
    for name, cue in CUES.items():
        observer = ww.Observer(WHISKER, cue)
        r = np.linspace(0.05, 0.97, points) * min(cue.farthest(WHISKER), WHISKER.length)
        angle = None
        if "deflection_angle" in cue.unknowns:
            r = r[ww.flick_past(WHISKER, r).deflection_angle > ANGLE]
            angle = ANGLE
        table = jnd_curve(observer, r, angle, draws=draws, seed=SEED)
        table.insert(0, "cue", name)
        tables.append(table)
    return pd.concat(tables, ignore_index=True)


def best(points: int) -> pd.DataFrame:
    """Fisher JND (m) of the mapped cues at contacts up to flick-past, and the name of the least."""
    r = np.linspace(0.03, 0.99, points) * WHISKER.length
    share = np.linspace(0.02, 0.99, points)
    theta = ww.flick_past(WHISKER, r).deflection_angle[:, None] * share
    contact = np.stack(np.broadcast_arrays(r[:, None], theta), axis=-1).reshape(-1, 2)
    table = pd.DataFrame(contact, columns=["radial_distance", "deflection_angle"])
    for name in MAPPED:
        observer = ww.Observer(WHISKER, CUES[name])
        table[name] = fisher_jnd(observer, contact[:, : len(observer.unknowns)])
    table["best"] = table[list(MAPPED)].idxmin(axis=1)
    return table


def bits(draws: int) -> pd.DataFrame:
    """What the mapped cues tell alone and add to the others."""
    fused = Fused(*(CUES[name] for name in MAPPED[:3]))
    table = ww.added_information(ww.Observer(WHISKER, fused), draws=draws, seed=SEED)
    table["cue"] = [*MAPPED[:3], "all three"]
    return table


def ridge(draws: int) -> pd.DataFrame:
    """Draws from the posterior of one reading of M and Fx, tapered and cylindrical."""
    tables = []
    for name, whisker in (("tapered", WHISKER), ("cylinder", WHISKER.cylinder())):
        observer = ww.Observer(whisker, ForceMap(), Weber(0.03))
        reading = observer.signals([25e-3, 0.3])[0]
        drawn = ww.posterior(observer, reading).draws_of(draws // 4, SEED)[0].reshape(-1, 2)
        table = pd.DataFrame(drawn, columns=["radial_distance", "deflection_angle"])
        tables.append(table.assign(whisker=name))
    return pd.concat(tables, ignore_index=True)


@figures.styled
def draw_curves(table: pd.DataFrame) -> Figure:
    """JND against r (lines: Fisher, marks: posterior), and posterior over closed form.

    Open marks are where the two differ by more than the Monte Carlo error: near the base, where a
    JND as wide as the distance meets the prior's edge; near the tip, likewise, and where the
    deflection is large; and at the vibration's nodes, about which no linear form holds.
    """
    figure = figures.new_figure(figures.DOUBLE, 6.4)
    top, below = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    for i, (name, rows) in enumerate(table.groupby("cue", sort=False)):
        look = {
            "color": figures.COLOURS[i % len(figures.COLOURS)],
            "marker": figures.MARKERS[i // 2 % len(figures.MARKERS)],
            "markersize": 3,
        }
        x = rows["radial_distance"] / WHISKER.length
        line = figures.LINES[i % len(figures.LINES)]
        # One event has no limit of small noise, and its information at a point says little.
        events = rows["closed_form"].isna().all()
        expected = rows["posterior" if events else "fisher"]
        top.semilogy(x, expected * 1e3, line, color=look["color"])
        top.plot(x, rows["posterior"] * 1e3, linestyle="none", label=name, **look)
        ratio = rows["posterior"] / rows["closed_form"]
        error = 1.96 * rows["posterior_error"] / rows["closed_form"]
        off = np.abs(ratio - 1) > error
        for shown, face in ((off, "none"), (~off, look["color"])):
            below.errorbar(
                x[shown], ratio[shown], error[shown],
                linestyle="none", linewidth=0.7, markerfacecolor=face, **look,
            )  # fmt: skip
    below.axhline(1.0, color="black", linewidth=0.8)
    below.set(xlabel="Radial distance r/L", ylabel="posterior / closed form", ylim=(0.3, 1.7))
    top.set(ylabel="JND (mm), d'=1", ylim=(0.05, 60))
    figure.legend(*top.get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure


@figures.styled
def draw_best(table: pd.DataFrame) -> Figure:
    """The best cue as a map over r and θ_d."""
    figure = figures.new_figure(figures.SINGLE * 1.4, 3.6)
    ax = figure.subplots()
    size = int(np.sqrt(len(table)))
    names = [name for name in MAPPED if (table["best"] == name).any()]
    x, y, which = (
        np.reshape(v, (size, size))
        for v in (
            table["radial_distance"] / WHISKER.length,
            np.degrees(table["deflection_angle"]),
            [names.index(name) for name in table["best"]],
        )
    )
    colours = [figures.COLOURS[MAPPED.index(name)] for name in names]
    # The table's contacts are the middles of cells in r and in the share of the largest angle.
    r, share = (_edges(np.linspace(low, 0.99, size)) for low in (0.03, 0.02))
    limit = np.degrees(ww.flick_past(WHISKER, r * WHISKER.length).deflection_angle)
    ax.pcolormesh(
        np.broadcast_to(r[:, None], (size + 1, size + 1)), limit[:, None] * share, which,
        cmap=ListedColormap(colours), rasterized=True,
    )  # fmt: skip
    for name, colour in zip(names, colours, strict=True):
        ax.fill_between([], [], color=colour, label=name)
    ax.plot(x[:, -1], y[:, -1], color="black", linewidth=1.2)
    ax.text(0.97, 0.95, "flicked past", transform=ax.transAxes, ha="right", va="top")
    ax.set(xlabel="Radial distance r/L", ylabel="Deflection angle θ$_d$ (degrees)", xlim=(0, 1))
    figure.legend(loc="outside upper center", ncols=2)
    return figure


def _edges(middles: np.ndarray) -> np.ndarray:
    """Edges of even cells, from their middles; between 0 and 1."""
    half = (middles[1] - middles[0]) / 2
    return np.clip(np.append(middles - half, middles[-1] + half), 1e-3, 1.0)


@figures.styled
def draw_ridge(table: pd.DataFrame) -> Figure:
    """A pair plot of distance and angle for either whisker."""
    figure = figures.new_figure(figures.SINGLE * 1.3, 3.4)
    ax = figure.subplots()
    for i, (name, rows) in enumerate(table.groupby("whisker", sort=False)):
        x, y = rows["radial_distance"] * 1e3, np.degrees(rows["deflection_angle"])
        ax.plot(x, y, ".", markersize=1.5, alpha=0.5, color=figures.COLOURS[i], label=name)
    ax.plot(25, np.degrees(0.3), "k+", markersize=10, label="contact")
    ax.set(xlabel="Radial distance (mm)", ylabel="Deflection angle θ$_d$ (degrees)")
    ax.legend(frameon=False)
    return figure


@figures.styled
def draw_bits(table: pd.DataFrame) -> Figure:
    """Bars of what is told alone and what is added."""
    figure = figures.new_figure(figures.DOUBLE / 1.4, 2.4)
    ax = figure.subplots()
    places = np.arange(len(table))[::-1]
    for shift, column in ((0.2, "alone"), (-0.2, "added")):
        rows = table if column == "alone" else table.iloc[:-1]
        error = rows[f"{column}_error"]
        ax.barh(places[: len(rows)] + shift, rows[column], 0.38, xerr=error, label=column,
                color=figures.COLOURS[0 if column == "alone" else 1])  # fmt: skip
    ax.set_yticks(places, table["cue"])
    ax.set_xlabel("information about radial distance (bits)")
    ax.legend(frameon=False)
    return figure


def make(folder: Path, *, short: bool = False) -> dict[str, pd.DataFrame]:
    """Tables and figures into `folder`."""
    draws, points = (DRAWS_SHORT, 8) if short else (DRAWS, 30)
    with Run(folder, "all_cues", {"weber_fraction": K, "draws": draws}, SEED) as run:
        made = {
            "jnd": (curves(points, draws), draw_curves),
            "best": (best(5 * points if short else 90), draw_best),
            "ridge": (ridge(400 if short else 8000), draw_ridge),
            "bits": (bits(40 if short else 400), draw_bits),
        }
        for name, (table, draw) in made.items():
            run.table(f"all_cues_{name}", table)
            run.figure(f"all_cues_{name}", draw(table))
    return {name: table for name, (table, _) in made.items()}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    default = Path(__file__).parent.parent / "results" / "all_cues"
    parser.add_argument("folder", type=Path, nargs="?", default=default)
    parser.add_argument("--short", action="store_true", help="few posteriors, seconds")
    given = parser.parse_args()
    tables = make(given.folder, short=given.short)
    print(tables["bits"].to_string(index=False, float_format="{:.2f}".format))
    print(tables["best"]["best"].value_counts(normalize=True).to_string())
    print(f"Written to {given.folder}.")
