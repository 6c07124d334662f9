"""Remake the paper's figure 2: large bending of a tapered whisker (radius ratio 20) and a cylinder.

    python analyses/figure_2.py [folder]

Writes figure_2 (PNG, SVG), figure_2.csv (every contact computed, in the paper's normalised units)
and figure_2_check.csv (what the text of §2f says of it, as numbers). Each whisker is loaded at
many arc lengths until the contact angle is 90°, as in the paper; some of those contacts an object
fixed in space could no longer hold (outcome PAST_FOLD), and the map is one-to-one there as well.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from command import options
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

import weberwhisk as ww
from weberwhisk import figures
from weberwhisk.output import Run

Array = NDArray[np.float64]

WHISKER = ww.Whisker(length=50e-3, base_radius=100e-6, tip_radius=5e-6, youngs_modulus=3e9)
WHISKERS = {"tapered": WHISKER, "cylinder": WHISKER.cylinder()}
#: Contacts: arc lengths over L, and the angles up to which the paper loads them.
ARCS = np.linspace(0.05, 1.0, 96)
DEGREES = np.linspace(0.5, 90.0, 90)
#: Panel a: the arc lengths and contact angles of the whiskers drawn.
EXAMPLES, DRAWN_DEGREES = (0.3, 0.6, 0.9), (15.0, 30.0, 45.0, 60.0, 75.0, 90.0)
#: Panels b and c: the arc lengths of the lines.
LINES = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)
#: and those with a number beside them.
NUMBERED = {"tapered": (0.1, 0.3, 0.5, 0.7, 0.9, 1.0), "cylinder": (0.1, 0.3, 1.0)}


def loaded(whisker: ww.Whisker, arc: Array, contact_angle: Array) -> ww.Bending:
    """The whisker loaded at arc lengths (m) to given contact angles (rad), by bisection in ln F."""
    shape = np.broadcast_shapes(np.shape(arc), np.shape(contact_angle))
    low, high = np.full(shape, -40.0), np.full(shape, 12.0)
    for _ in range(70):
        middle = (low + high) / 2
        angle = ww.bend(whisker, arc, np.exp(middle) * whisker.force_scale).contact_angle
        under = angle < contact_angle  # NaN, a load beyond the map, is over
        low, high = np.where(under, middle, low), np.where(under, high, middle)
    return ww.bend(whisker, arc, np.exp(low) * whisker.force_scale)


def contacts() -> pd.DataFrame:
    """Every contact of panels b to f, a row each, normalised as in the paper."""
    tables = []
    for name, whisker in WHISKERS.items():
        bent = loaded(whisker, ARCS * whisker.length, np.radians(DEGREES)[:, None])
        columns = {
            "whisker": np.full(bent.moment.shape, name),
            "arc_length": bent.arc_length / whisker.length,
            "contact_angle_deg": np.degrees(bent.contact_angle),
            "force": bent.force / whisker.force_scale,
            "moment": bent.normalised_moment,
            "axial_force": bent.normalised_axial_force,
            "transverse_force": bent.transverse_force / whisker.force_scale,
            "radial_distance": bent.radial_distance / whisker.length,
            "deflection_angle_deg": np.degrees(bent.deflection_angle),
            "outcome": [ww.Outcome(k).name for k in bent.outcome.ravel()],
        }
        tables.append(pd.DataFrame({key: np.ravel(value) for key, value in columns.items()}))
    return pd.concat(tables, ignore_index=True)


def map_jacobian(whisker: ww.Whisker) -> Array:
    """Determinant of ∂(ln M, ln Fx)/∂(ln s, ln F) over the contacts, by central differences.

    In arc length and force, unlike in r and θ_d, nothing is singular at a fold.
    """
    step = 1e-4
    arc = np.minimum(ARCS, 1 - 2 * step) * whisker.length
    force = loaded(whisker, arc, np.radians(DEGREES)[:, None]).force * (1 - 4 * step)

    def signals(along: float, push: float) -> Array:
        bent = ww.bend(whisker, arc * np.exp(along), force * np.exp(push))
        return np.log([bent.moment, bent.axial_force])

    by_arc = (signals(step, 0) - signals(-step, 0)) / (2 * step)
    by_force = (signals(0, step) - signals(0, -step)) / (2 * step)
    return np.asarray(by_arc[0] * by_force[1] - by_arc[1] * by_force[0])


def map_boundary(whisker: ww.Whisker, points: int = 200) -> Array:
    """The image of the domain's edge in (ln M, ln M²/(2EI₀Fx)), a closed polygon (n, 2).

    A map without singular points that takes the edge of a disc to a curve that does not cross
    itself is one-to-one: no two contacts of the domain share signals.
    """
    arc, angle = np.linspace(*ARCS[[0, -1]], points), np.linspace(*DEGREES[[0, -1]], points)
    edges = [
        (arc, angle[:1]),
        (arc[-1:], angle),
        (arc[::-1], angle[-1:]),
        (arc[:1], angle[::-1]),
    ]
    sides = []
    for s, alpha in edges:
        bent = loaded(whisker, s * whisker.length, np.radians(alpha))
        ratio = bent.moment**2 / (2 * whisker.stiffness * bent.axial_force)
        sides.append(np.stack([np.log(bent.normalised_moment), np.log(ratio)], axis=-1)[:-1])
    return np.concatenate(sides)


def crossings(polygon: Array) -> int:
    """How often the sides of a closed polygon (n, 2) cross one another."""
    a, b = polygon, np.roll(polygon, -1, axis=0)

    def side(p: Array, q: Array, x: Array) -> Array:
        """On which side of each line p → q each point x lies, (n, n)."""
        along, out = (q - p)[:, None], x[None] - p[:, None]
        return np.asarray(np.sign(along[..., 0] * out[..., 1] - along[..., 1] * out[..., 0]))

    crossed = (side(a, b, a) * side(a, b, b) < 0) & (side(a, b, a) * side(a, b, b) < 0).T
    return int(np.sum(crossed)) // 2


def check(table: pd.DataFrame) -> pd.DataFrame:
    """What §2f says of the figure, a row a claim."""
    jacobian = map_jacobian(WHISKER)
    cylinder = table[table["whisker"] == "cylinder"]
    ratio = cylinder["moment"] ** 2 / (2 * cylinder["axial_force"])
    at_90 = table[np.isclose(table["contact_angle_deg"], 90.0)].pivot_table(
        index="arc_length", columns="whisker", values="force"
    )
    less = at_90["tapered"] / at_90["cylinder"]
    rows = [
        ("d, e: the tapered map's Jacobian has one sign", len(np.unique(np.sign(jacobian))), 1),
        ("d, e: crossings of the tapered map's edge", crossings(map_boundary(WHISKER)), 0),
        ("f: largest distance of the cylinder from M² = 2EI·Fx", np.abs(ratio - 1).max(), 0),
        ("b, c: largest force of taper over cylinder at 90°", less.max(), np.nan),
        ("b, c: the same at the tip", less.iloc[-1], np.nan),
    ]
    return pd.DataFrame(rows, columns=["claim", "found", "expected"])


def shape(whisker: ww.Whisker, bent: ww.Bending) -> Array:
    """Points (2, n) of one bent whisker, straight past the contact, from the signals at its base.

    The base's moment and force are all that is used: that the moment comes out as zero at the
    contact is a check.
    """
    taper = float(whisker.taper / whisker.length)

    def rates(s: float, state: Array) -> list[float]:
        angle, x, y = state
        moment = bent.moment - x * bent.transverse_force - y * bent.axial_force
        bend = moment / (whisker.stiffness * (1 - taper * s) ** 4)
        return [bend, np.cos(angle), np.sin(angle)]

    at = np.linspace(0, bent.arc_length, 100)
    end = (0.0, bent.arc_length)
    path = solve_ivp(rates, end, [0.0, 0.0, 0.0], t_eval=at, rtol=1e-9, atol=1e-12).y
    rest = (whisker.length - bent.arc_length) * np.array([np.cos(path[0, -1]), np.sin(path[0, -1])])
    return np.column_stack([path[1:], path[1:, -1] + rest])


def draw(table: pd.DataFrame) -> Figure:
    """All six panels."""
    figure = figures.new_figure(figures.DOUBLE, 7.4)
    # A row of its own for each pair, so that colour bars stay with their maps.
    (shapes, curve), (b, c), (d, e) = (
        row.subplots(1, 2)
        for row in figure.subfigures(3, 1)  # type: ignore[attr-defined]
    )
    _shapes(shapes)
    _curve(curve, table)
    _lines(b, "tapered")
    _lines(c, "cylinder")
    c.set(xlim=b.get_xlim(), ylim=b.get_ylim())
    _map(d, table, "radial_distance", "r/L", "viridis")
    _map(e, table, "deflection_angle_deg", "θ$_d$ (degrees)", "cividis")
    for ax, title in {
        shapes: "(a) three examples, loaded to α = 90°",
        b: "(b) tapered",
        c: "(c) cylinder",
        d: "(d) tapered: distance",
        e: "(e) tapered: angle",
        curve: "(f) cylinder",
    }.items():
        ax.set_title(title, loc="left", fontsize=8)
        ax.tick_params(labelsize=7)
        ax.xaxis.label.set_size(8)
        ax.yaxis.label.set_size(8)
        ax.spines[["top", "right"]].set_visible(False)
    return figure


def _shapes(ax: Axes) -> None:
    for i, share in enumerate(EXAMPLES):
        arc = np.array(share * WHISKER.length)
        for degrees in (0.0, *DRAWN_DEGREES):
            bent = loaded(WHISKER, arc, np.array(np.radians(max(degrees, 1e-3))))
            x, y = shape(WHISKER, bent) / WHISKER.length
            ax.plot(x, y, color=figures.COLOURS[i], linewidth=0.7, linestyle=figures.LINES[i])
            ax.plot(
                x[-2],
                y[-2],
                figures.MARKERS[i],
                color=figures.COLOURS[i],
                markersize=3,
                label=f"s = {share:g} L" if degrees == 0 else None,
            )
    ax.set(xlabel="x/L", ylabel="y/L", aspect="equal", xlim=(0, 1.03), ylim=(-0.02, 0.95))
    ax.legend(frameon=False, fontsize=7, loc="upper left", bbox_to_anchor=(0.98, 1))


def _lines(ax: Axes, name: str) -> None:
    whisker = WHISKERS[name]
    angle = np.radians(np.linspace(0.3, 90, 120))[:, None]
    bent = loaded(whisker, np.array(LINES) * whisker.length, angle)
    force, moment = bent.force / whisker.force_scale, bent.normalised_moment
    for i, share in enumerate(LINES):
        shade = f"{0.75 * i / (len(LINES) - 1):.2f}"
        ax.loglog(force[:, i], moment[:, i], color=shade, linewidth=0.9)
        ax.plot(force[-1, i], moment[-1, i], "o", color=shade, markersize=2.5)
        if share in NUMBERED[name]:
            fallen = moment[-1, i] < 0.8 * moment[:, i].max()  # its end is clear of other lines
            ax.annotate(
                f"{share:g}",
                (force[-1, i], moment[-1, i]),
                (3, -1) if fallen else (-3, 1.5),
                textcoords="offset points",
                ha="left" if fallen else "right",
                fontsize=6,
            )
    ax.plot([], [], "o-", color="0.4", markersize=2.5, label="number: s/L; end: α = 90°")
    ax.set(xlabel="Contact force F$_c$L²/EI", ylabel="Moment M$_z$L/EI")
    ax.legend(frameon=False, fontsize=7, loc="upper left")


def _grid(table: pd.DataFrame, name: str, column: str) -> Array:
    rows = table[table["whisker"] == name]
    return rows[column].to_numpy(float).reshape(DEGREES.size, ARCS.size)


def _map(ax: Axes, table: pd.DataFrame, column: str, label: str, colours: str) -> None:
    moment, axial = _grid(table, "tapered", "moment"), _grid(table, "tapered", "axial_force")
    values = _grid(table, "tapered", column)
    shown = ax.pcolormesh(moment, axial, values, shading="gouraud", cmap=colours, rasterized=True)
    levels = 6 if column == "radial_distance" else 8
    ax.contour(moment, axial, values, levels, colors="white", linewidths=0.5)
    limit = np.linspace(0, 9, 200)
    ax.plot(limit, limit**2 / 2, "--", color="0.4", linewidth=0.9, label="M² = 2EI·F$_x$")
    bar = ax.figure.colorbar(shown, ax=ax, pad=0.02)
    bar.set_label(label, fontsize=8)
    bar.ax.tick_params(labelsize=7)
    # Square roots spread the small signals of contacts near the tip.
    ax.set_xscale("function", functions=(np.sqrt, np.square))
    ax.set_yscale("function", functions=(lambda v: np.abs(v) ** 0.25, lambda v: v**4))
    ax.set(xlim=(0, 9), ylim=(0, 120), xticks=[0.1, 1, 2, 4, 8], yticks=[0.01, 0.1, 1, 10, 50, 100])
    ax.set_xticklabels([f"{v:g}" for v in (0.1, 1, 2, 4, 8)])
    ax.set_yticklabels([f"{v:g}" for v in (0.01, 0.1, 1, 10, 50, 100)])
    ax.set(xlabel="Moment M$_z$L/EI (square-root scale)")
    ax.set(ylabel="Axial force F$_x$L²/EI (fourth-root scale)")
    ax.legend(frameon=False, fontsize=7, loc="upper left")


def _curve(ax: Axes, table: pd.DataFrame) -> None:
    for i, share in enumerate((0.3, 0.6, 0.9)):
        k = int(np.argmin(np.abs(ARCS - share)))
        ax.plot(
            _grid(table, "cylinder", "moment")[i * 3 :: 9, k],
            _grid(table, "cylinder", "axial_force")[i * 3 :: 9, k],
            figures.MARKERS[i],
            color=figures.COLOURS[i],
            markerfacecolor="none",
            markersize=4,
            label=f"s = {ARCS[k]:g} L",
        )
    moment = np.linspace(0, 9, 100)
    ax.plot(moment, moment**2 / 2, "-", color="0.4", linewidth=0.9, label="M² = 2EI·F$_x$")
    ax.set(xlabel="Moment M$_z$L/EI", ylabel="Axial force F$_x$L²/EI", xlim=(0, 9), ylim=(0, 40))
    ax.legend(frameon=False, fontsize=7)


def make(folder: Path) -> pd.DataFrame:
    """Figure and tables into `folder`; returns the check of the text's claims."""
    with Run(folder, "figure_2", {"radius_ratio": WHISKER.radius_ratio}) as run:
        table = contacts()
        run.table("figure_2", table)
        checked = check(table)
        run.table("figure_2_check", checked)
        run.figure("figure_2", draw(table))
    return checked


if __name__ == "__main__":
    given = options(__file__, __doc__)
    print(make(given.folder).to_string(index=False, float_format="{:.3g}".format))
    print(f"Written to {given.folder}.")
