"""How well each receptor model knows a moment, and how far Weber's law of a population reaches.

    python analyses/receptors.py [folder]

Writes receptors (CSV, PNG, SVG): the effective Weber fraction, 1/√(I²·Fisher information), of every
model over eight decades of moment I, and for spike counts the closed form beside it.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from command import options
from matplotlib.figure import Figure
from scipy.special import expit

from weberwhisk import plots
from weberwhisk._util.output import Run
from weberwhisk.receptors import (
    Afferents,
    GeneralisedWeber,
    LogNormal,
    ReceptorNoise,
    Saturating,
    SpikeCount,
    Weber,
)

LOWEST, HIGHEST = 1e-8, 1e-5
POPULATION = SpikeCount(Afferents(75, LOWEST, HIGHEST), Afferents(25, 100 * LOWEST, 100 * HIGHEST))
MODELS: dict[str, ReceptorNoise] = {
    "Weber": Weber(0.1),
    "floor": GeneralisedWeber(0.1, floor=0.1 * LOWEST),
    "saturating": Saturating(0.1, ceiling=HIGHEST),
    "log-normal": LogNormal(0.1),
    "100 afferents' counts": POPULATION,
}
CLOSED_FORM = "100 afferents, closed form"


def effective(points: int = 201) -> pd.DataFrame:
    """The effective Weber fraction, a column a model, at moments in N m."""
    moment = np.geomspace(10**-10.5, 10**-2.5, points)[:, None]
    table = {"moment": moment[:, 0]}
    for name, noise in MODELS.items():
        table[name] = 1 / np.sqrt(moment[:, 0] ** 2 * noise.fisher(moment)[:, 0, 0])
    table[CLOSED_FORM] = weber_law(POPULATION, moment[:, 0])
    return pd.DataFrame(table)


def weber_law(noise: SpikeCount, signals: np.ndarray) -> np.ndarray:
    """Effective Weber fractions (n,) of signals (n,), as if thresholds lay densely.

    Each afferent's share of the axis of ln c is integrated over, so that the plateau and both of
    its ends are there; see the notes of `SpikeCount`. For thresholds that are the same for all
    signals, and classes of two afferents or more.
    """
    window, rise = noise.window, min(noise.rise_time, noise.window)
    total = np.zeros(len(signals))
    for part, time, unit in ((noise.slow, window, 1.0), (noise.rapid, rise, noise.rise_time)):
        if part is None:
            continue
        low, high = np.log(part.lowest * unit), np.log(part.highest * unit)
        spacing = np.maximum(high - low, 1e-4) / (part.number - 1)  # thresholds may all be one
        high = low + spacing * (part.number - 1)
        edges = low - spacing / 2, high + spacing / 2
        most, least = (expit(part.exponent * (np.log(signals) - edge)) for edge in edges)
        peak = part.peak_rate * time
        rest = part.spontaneous_rate * window / peak
        share = _share(rest, least, most)
        if noise.gain_sd > 0:
            share = share - _share(rest + 1 / (noise.gain_sd**2 * peak), least, most)
        total += peak * part.exponent / spacing * share
    return 1 / np.sqrt(total)


def _share(beta: float, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """∫ s(1 − s)/(β + s) ds from low to high."""
    width = high - low
    value = (1 + beta) * width - (high**2 - low**2) / 2
    if beta > 0:
        value = value - beta * (1 + beta) * np.log1p(width / (beta + low))
    return value


@plots.styled
def draw(table: pd.DataFrame) -> Figure:
    """One line a model; the range of the afferents' thresholds is shaded."""
    figure = plots.new_figure(plots.DOUBLE / 1.6, plots.SINGLE * 0.9)
    ax = figure.subplots()
    ax.axvspan(LOWEST, HIGHEST, color="0.93", label="the afferents' thresholds")
    for i, name in enumerate(MODELS):
        style = plots.LINES[i % len(plots.LINES)]
        # Weber's law and its log-normal form are one line: the wide one shows beneath the dots.
        wide, dots = name == "Weber", name == "log-normal"
        ax.loglog(
            table["moment"], table[name], ":" if dots else style, label=name,
            color="black" if dots else plots.COLOURS[i], linewidth=4.0 if wide else 1.3,
            alpha=0.4 if wide else 1.0, zorder=3 if dots else 2,
        )  # fmt: skip
    marked = table.iloc[::8]
    ax.plot(marked["moment"], marked[CLOSED_FORM], "kx", markersize=4, label=CLOSED_FORM)
    ax.set(
        xlabel="moment (N m)",
        ylabel="effective Weber fraction",
        ylim=(0.02, 10),
        xlim=(table["moment"].min(), table["moment"].max()),
    )
    figure.legend(loc="outside upper center", ncols=2)
    return figure


def make(folder: Path) -> pd.DataFrame:
    """Table and figure into `folder`."""
    with Run(
        folder, "receptors", {name: repr(noise) for name, noise in MODELS.items()}, None
    ) as run:
        table = effective()
        run.table("receptors", table)
        run.figure("receptors", draw(table))
    return table


if __name__ == "__main__":
    given = options(__file__, __doc__)
    print(make(given.folder).iloc[::25].to_string(index=False, float_format="{:.3g}".format))
    print(f"Written to {given.folder}.")
