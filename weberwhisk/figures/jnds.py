"""Just noticeable differences, as lines and as a surface."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes

from .style import (
    COLOURS,
    LINES,
    MARKERS,
    SINGLE,
    axes_or_new,
    drawable,
    figure_of,
    legend_above,
    styled,
)

if TYPE_CHECKING:
    import pandas as pd


@styled
def jnd_curve(
    tables: pd.DataFrame | Mapping[str, pd.DataFrame],
    ax: Axes | None = None,
    *,
    length: float | None = None,
    weber_fraction: float = 1.0,
) -> Axes:
    """The JND of radial distance against distance: closed form as lines, posteriors as points.

    The paper's figure 4a.

    Parameters
    ----------
    tables : DataFrame, or mapping of label to DataFrame
        From `jnd_curve`. Rows whose ``posterior`` is NaN extend the line alone.
    ax : Axes, optional
    length : float, optional
        Length of the whisker, m. With it both axes are fractions of it and the JND is divided by
        `weber_fraction`, as in the paper; without it they are in mm.
    weber_fraction : float
        See `length`.

    Returns
    -------
    Axes

    Examples
    --------
    >>> from weberwhisk import Observer, Whisker, cues, jnd_curve as curve
    >>> observer = Observer(Whisker(50e-3, 100e-6, 5e-6), cues.Compliance())
    >>> ax = jnd_curve(curve(observer, [10e-3, 30e-3], n_readings=20, seed=1))
    >>> ax.get_xlabel()
    'Radial distance r (mm)'
    """
    import pandas as pd

    ax = axes_or_new(ax)
    named = {"": tables} if isinstance(tables, pd.DataFrame) else tables
    x_unit = 1e-3 if length is None else length
    y_unit = 1e-3 if length is None else length * weber_fraction
    for i, (label, table) in enumerate(named.items()):
        rows = table.sort_values("radial_distance")
        colour = COLOURS[i % len(COLOURS)]
        prefix = f"{drawable(label)}: " if label else ""
        # The closed form holds for small angles; where it is not what the observer has, both show.
        x = rows["radial_distance"].to_numpy(float) / x_unit
        exact = rows["propagation"].to_numpy(float) / y_unit
        closed = rows["closed_form"].to_numpy(float) / y_unit
        ax.plot(
            x, closed, color=colour, linestyle=LINES[i % len(LINES)], label=f"{prefix}closed form"
        )
        if not np.allclose(exact, closed, rtol=1e-3, equal_nan=True):
            ax.plot(x, exact, color=colour, linestyle=":", label=f"{prefix}exact slope")
        points = np.isfinite(rows["posterior"].to_numpy(float))
        if points.any():
            ax.errorbar(
                x[points],
                rows["posterior"].to_numpy(float)[points] / y_unit,
                1.96 * rows["posterior_error"].to_numpy(float)[points] / y_unit,
                fmt=MARKERS[i % len(MARKERS)],
                color=colour,
                markersize=2.5,
                elinewidth=1,
                capsize=3,
                label=f"{prefix}posterior, 95 %",
            )
    ax.set_xlim(left=0)
    ax.set_ylim(bottom=0)
    if length is None:
        ax.set_xlabel("Radial distance r (mm)")
        ax.set_ylabel(f"JND of radial distance (mm), {_criterion(named)}")
    else:
        ax.set_xlabel("Radial distance r/L")
        ax.set_ylabel(f"JND/(kL), {_criterion(named)}")
    legend_above(ax)
    return ax


def _criterion(tables: Mapping[str, pd.DataFrame]) -> str:
    return " / ".join(dict.fromkeys(str(c) for t in tables.values() for c in t["criterion"]))


@styled
def jnd_surface(
    table: pd.DataFrame,
    ax: Axes | None = None,
    *,
    length: float,
    weber_fraction: float,
    points: pd.DataFrame | None = None,
) -> Axes:
    """The JND over radial distance and deflection angle, up to where the whisker flicks past.

    The paper's figure 4b, which ends where the contact angle is 90°. With noise in one signal alone
    the linear JND has a *false zero*, a dark band about the line drawn here: there the other signal
    no longer changes with the angle, and to first order distance is known exactly. No posterior has
    it. With noise in the moment alone it lies beyond the 90°; in the axial force alone, within them
    from a fifth of the length outwards.

    Parameters
    ----------
    table : DataFrame
        Columns ``radial_distance`` (m), ``deflection_angle`` (rad) and ``jnd`` (m): for every
        distance equally many angles, the last of them where the whisker flicks past. If there are
        ``contact_angle`` (rad) and ``signed_jnd``, which changes sign at a false zero, the contact
        angle of 90° and the false zero are drawn. From `surveys.surface`, say.
    ax : Axes, optional
    length, weber_fraction : float
        The JND is shown as a fraction of their product, the distance as one of the length.
    points : DataFrame, optional
        Rows of `jnd_curve` whose posterior is written beside their place.

    Returns
    -------
    Axes
    """
    ax = axes_or_new(ax, SINGLE + 0.6, 3.0)
    rows = table.sort_values(["radial_distance", "deflection_angle"])
    count = rows["radial_distance"].nunique()
    r, theta, jnd = (
        rows[name].to_numpy(float).reshape(count, -1)
        for name in ("radial_distance", "deflection_angle", "jnd")
    )
    x, y, z = r / length, np.degrees(theta), jnd / (length * weber_fraction)
    top = np.ceil(np.nanmax(z[:, 0]) * 5) / 5
    filled = ax.contourf(x, y, z, np.linspace(0, top, 65), cmap="cividis", extend="neither")
    filled.set_rasterized(True)
    lines = ax.contour(x, y, z, np.arange(0.2, top, 0.2), colors="white", linewidths=0.8)
    # Where each line is crossed half-way up: the labels stand clear of the edge.
    ax.clabel(lines, fmt="%.1f", fontsize=7)
    for name, unit, level, style, colour, label in (
        ("contact_angle", np.pi / 180, 90.0, "--", "white", "contact angle of 90°"),
        ("signed_jnd", 1.0, 0.0, "-", COLOURS[1], "false zero of the linear JND"),
    ):
        if name in rows:
            w = rows[name].to_numpy(float).reshape(count, -1) / unit
            if np.nanmin(w) < level < np.nanmax(w):  # a cylinder may reach neither
                ax.contour(x, y, w, [level], colors=colour, linestyles=style, linewidths=1.2)
                shown = "0.6" if colour == "white" else colour
                ax.plot([], [], linestyle=style, color=shown, linewidth=1.2, label=label)
    ax.plot(x[:, -1], y[:, -1], color="black", linewidth=1.2)
    ax.text(0.97, 0.95, "flicked past", transform=ax.transAxes, ha="right", va="top")
    legend_above(ax)
    bar = figure_of(ax).colorbar(filled, ax=ax, ticks=np.arange(0, top + 0.01, 0.2))
    bar.set_label("JND/(kL), d'=1")
    if points is not None:
        for row in points.to_dict("records"):
            at = row["radial_distance"] / length, np.degrees(row["deflection_angle"])
            ax.plot(*at, "o", color="white", markeredgecolor="black")
            ax.annotate(
                f"{row['posterior'] / (length * weber_fraction):.2f}",
                at,
                xytext=(4, 4),
                textcoords="offset points",
                fontsize=7,
                bbox={"boxstyle": "round,pad=0.15", "facecolor": "white", "linewidth": 0},
            )
    ax.set_xlim(0, 1)
    ax.set_ylim(0, None)
    ax.set_xlabel("Radial distance r/L")
    ax.set_ylabel("Deflection angle θ$_d$ (degrees)")
    return ax
