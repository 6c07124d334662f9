"""Weber's law in two dimensions (§3c): the whole family between the paper's two limits.

    python analyses/weber_2d.py [folder] [--short]

The paper took the JND of moment or of axial force to be the smaller by far. Here k_M, k_F and the
correlation ρ of the two are anything. Writes weber_2d (PNG, SVG): figure 4b with noise in the
moment alone, in both alike and in the axial force alone, and for the latter the false zero of the
linear JND beside posteriors; with the numbers in weber_2d_false_zero.csv, and in weber_2d_gain.csv
how noise that is a common gain (k_F = 2k_M, ρ → 1) cancels.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import weberwhisk as ww
from weberwhisk import figures
from weberwhisk.jnd import fisher_jnd, jnd_curve, weber_propagation
from weberwhisk.runs import Run

WHISKER = ww.Whisker(length=50e-3, base_radius=100e-6, tip_radius=5e-6, youngs_modulus=3e9)
K, NONE = 0.1, 1e-9
#: Weber fractions of moment and axial force.
FAMILY = {
    "moment noise alone": (K, NONE),
    "both alike": (K, K),
    "axial force noise alone": (NONE, K),
}
#: Noise in the moment that is next to none, and still has posteriors.
SLIGHT = 0.003
#: Where the false zero is shown.
PLACE = 0.7
SEED = 20110166
DRAWS, DRAWS_SHORT = 200, 16


def observer(k_moment: float, k_force: float, correlation: float = 0.0) -> ww.Observer:
    """The paper's pair of signals under Weber noise."""
    noise = ww.receptors.Weber([k_moment, k_force], correlation=correlation)
    return ww.Observer(WHISKER, ww.cues.ForceMap(), noise)


def closed_form(r: np.ndarray, k_moment: float, k_force: float, rho: float) -> np.ndarray:
    """½(A−r)(3A−2r)/(2A−r)·√(4k_M² + k_F² − 4ρk_Mk_F): the JND at small angle, m."""
    a = WHISKER.apex_distance
    noise = np.sqrt(4 * k_moment**2 + k_force**2 - 4 * rho * k_moment * k_force)
    return 0.5 * (a - r) * (3 * a - 2 * r) / (2 * a - r) * noise


def surface(k_moment: float, k_force: float, points: int = 80) -> pd.DataFrame:
    """The JND over every contact that the whisker holds, as `figures.jnd_surface` takes it."""
    r = np.linspace(0.02, 0.99, points) * WHISKER.length
    limit = np.asarray(ww.flick_past(WHISKER, r).deflection_angle)
    share = np.sin(0.5 * np.pi * np.linspace(0.002, 0.998, points))
    contact = np.stack(np.broadcast_arrays(r[:, None], limit[:, None] * share), axis=-1)
    jnd = weber_propagation(observer(k_moment, k_force), contact)
    columns = (contact[..., 0], contact[..., 1], jnd)
    names = ("radial_distance", "deflection_angle", "jnd")
    return pd.DataFrame({n: c.ravel() for n, c in zip(names, columns, strict=True)})


def false_zero(draws: int, degrees: np.ndarray | None = None) -> pd.DataFrame:
    """Linear, Fisher and posterior JNDs (m) with noise in the axial force and next to none else."""
    angle = np.append(np.arange(2.0, 20.0, 3.0), [19.0, 20.0, 20.8, 21.5, 22.5, 23.5])
    theta = np.radians(angle if degrees is None else degrees)
    table = jnd_curve(observer(SLIGHT, K), PLACE * WHISKER.length, theta, draws=draws, seed=SEED)
    contact = table[["radial_distance", "deflection_angle"]].to_numpy()
    table.insert(4, "linear", weber_propagation(observer(NONE, K), contact))
    kept = ["deflection_angle", "linear", "fisher", "posterior", "posterior_error", "unreliable"]
    return table[kept]


def gain() -> pd.DataFrame:
    """JNDs (m) as the noise of k_F = 2k_M becomes one gain: at small angle and at 10 degrees."""
    r = 0.5 * WHISKER.length
    contact = np.array([[r, 1e-4], [r, np.radians(10.0)]])
    rows = []
    for rho in (-0.9, 0.0, 0.9, 0.99, 0.999, 0.9999, 0.999999):
        o = observer(K, 2 * K, rho)
        rows.append((rho, float(closed_form(np.array(r), K, 2 * K, rho)),
                     *weber_propagation(o, contact), *fisher_jnd(o, contact)))  # fmt: skip
    columns = ["rho", "closed_form", "linear_0", "linear_10", "fisher_0", "fisher_10"]
    return pd.DataFrame(rows, columns=columns)


def draw_false_zero(table: pd.DataFrame, ax: Axes) -> None:
    """The linear JND through its zero, and the posterior that has none."""
    theta = np.radians(np.linspace(1.0, 24.3, 400))
    contact = np.stack([np.full(theta.size, PLACE * WHISKER.length), theta], axis=-1)
    scale = K * WHISKER.length
    linear = weber_propagation(observer(NONE, K), contact) / scale
    ax.semilogy(np.degrees(theta), linear, color=figures.COLOURS[0], label="linear")
    ax.errorbar(
        np.degrees(table["deflection_angle"]),
        table["posterior"] / scale,
        1.96 * table["posterior_error"] / scale,
        fmt="o",
        color=figures.COLOURS[1],
        label="posterior",
    )
    ax.set(
        xlabel="Deflection angle θ$_d$ (degrees)", ylabel="JND/(kL), d'=1", ylim=(1e-4, 1),
        title=f"its false zero, r = {PLACE:g} L",
    )  # fmt: skip
    ax.legend(frameon=False)


@figures.styled
def draw(table: pd.DataFrame) -> Figure:
    """Three surfaces and the false zero."""
    figure = figures.new_figure(figures.DOUBLE, 5.6)
    axes = figure.subplots(2, 2).ravel()
    for ax, (title, noise) in zip(axes[:3], FAMILY.items(), strict=True):
        figures.jnd_surface(surface(*noise), ax, length=WHISKER.length, weber_fraction=K)
        ax.set_title(title)
    draw_false_zero(table, axes[3])
    return figure


def make(folder: Path, *, short: bool = False) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Tables and figure into `folder`."""
    draws = DRAWS_SHORT if short else DRAWS
    with Run(folder, "weber_2d", {"weber_fraction": K, "draws": draws}, SEED) as run:
        zero, common = false_zero(draws), gain()
        run.table("weber_2d_false_zero", zero)
        run.table("weber_2d_gain", common)
        run.figure("weber_2d", draw(zero))
    return zero, common


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    default = Path(__file__).parent.parent / "results" / "weber_2d"
    parser.add_argument("folder", type=Path, nargs="?", default=default)
    parser.add_argument("--short", action="store_true", help="few posteriors, seconds")
    given = parser.parse_args()
    for found in make(given.folder, short=given.short):
        print(found.to_string(index=False, float_format="{:.3g}".format), end="\n\n")
    print(f"Written to {given.folder}.")
