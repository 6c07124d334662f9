"""Signals of bent whiskers, posteriors of contacts, and just noticeable differences."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from .._checks import one_of, shown
from ..jnd_curves import JNDCurve
from .style import (
    COLOURS,
    DOUBLE,
    MARKERS,
    SINGLE,
    axes_or_new,
    bars,
    drawable,
    figure_of,
    legend_above,
    legend_over,
    look,
    open_figure,
    styled,
)

if TYPE_CHECKING:
    import pandas as pd

    from ..mechanics import Bending
    from ..posterior import Posterior


@styled
def bending(
    curves: Bending,
    axes: Sequence[Axes] | None = None,
    *,
    points: Bending | None = None,
    against: str = "deflection_angle",
) -> NDArray[np.object_]:
    """The three signals at the base of a bent whisker, a line for each contact distance.

    Parameters
    ----------
    curves : Bending
        Arrays (lines, points along each); fewer dimensions are one line, or one point.
    axes : three Axes, optional
    points : Bending, optional
        Contacts to mark, arrays (lines, marks on each).
    against : {"deflection_angle", "force"}
        Along the horizontal axis. Lines are told apart by radial distance or by arc length.

    Returns
    -------
    array of the three Axes

    Examples
    --------
    >>> from weberwhisk import Whisker, press
    >>> whisker = Whisker(50e-3, 100e-6, 5e-6)
    >>> lines = press(whisker, [[20e-3], [30e-3]], np.linspace(0.01, 0.4, 20))
    >>> len(bending(lines))
    3
    """
    one_of("against", against, ("force", *_UNKNOWNS))
    if axes is None:
        axes = list(open_figure(DOUBLE, 2.7).subplots(1, 3))
    if np.size(np.array(axes, dtype=object)) != 3:
        raise ValueError(f"Three signals are drawn, got {shown(axes)}; give three axes.")
    label, unit, name, symbol = "Contact force (µN)", 1e-6, "arc_length", "s"
    if against != "force":
        label, unit = _UNKNOWNS[against]
        name, symbol = "radial_distance", "r"
    signals = (
        ("moment", "Moment M (µN m)", 1e-6),
        ("axial_force", "Axial force F$_x$ (µN)", 1e-6),
        ("transverse_force", "Transverse force F$_y$ (µN)", 1e-6),
    )
    for ax, (attribute, title, scale) in zip(axes, signals, strict=True):
        x, y, place = (_rows(curves, which) for which in (against, attribute, name))
        for i, held in enumerate(np.isfinite(y)):
            if not held.any():  # out of reach: there is no line
                continue
            ends = dict.fromkeys(f"{1e3 * f(place[i][held]):.4g}" for f in (np.min, np.max))
            text = f"{symbol} = {' to '.join(ends)} mm"
            dot = {"marker": MARKERS[i % len(MARKERS)]} if held.sum() == 1 else {}
            ax.plot(x[i] / unit, y[i] / scale, **look(i, **dot), label=text)
            if points is not None:
                at = [_rows(points, which)[i] for which in (against, attribute)]
                marks = {"marker": MARKERS[i % len(MARKERS)], "markerfacecolor": "white"}
                ax.plot(at[0] / unit, at[1] / scale, **look(i, **marks) | {"linestyle": "none"})
        ax.set_xlabel(label)
        ax.set_ylabel(title)
    legend_over(figure_of(axes), axes[:1], 5)
    if not axes[0].lines:
        axes[1].text(
            0.5, 0.5, "no contact is held", transform=axes[1].transAxes, ha="center", va="center"
        )
    return np.array(axes, dtype=object)


def _rows(curves: Bending, name: str) -> NDArray[np.float64]:
    """A value of every contact, (lines, points)."""
    values = np.asarray(getattr(curves, name), dtype=float)
    return values.reshape(-1, values.shape[-1] if values.ndim else 1)


_UNKNOWNS = {
    "radial_distance": ("Radial distance (mm)", 1e-3),
    "deflection_angle": ("Deflection angle θ$_d$ (degrees)", np.pi / 180),
}


@styled
def posteriors(
    result: Posterior, ax: Axes | None = None, *, of: str = "radial_distance", draws: int = 4000
) -> Axes:
    """One posterior as `posterior_histogram`; of many, each mean with its 95 % interval, in order.

    Examples
    --------
    >>> from weberwhisk import Observer, Whisker, cues, posterior as infer
    >>> observer = Observer(Whisker(50e-3, 100e-6, 5e-6), cues.Compliance())
    >>> posteriors(infer(observer, observer.read([[20e-3], [30e-3]], seed=1))).get_xlabel()
    'Reading'
    """
    if np.ndim(result.reading) < 2:
        return posterior_histogram(result, ax, of=of, draws=draws)
    ax = axes_or_new(ax)
    label, unit = _UNKNOWNS.get(of, (drawable(of.replace("_", " ")), 1.0))
    mean = np.asarray(result.estimates[of].mean) / unit
    low, high = np.moveaxis(np.asarray(result.interval(0.95, of=of)) / unit, -1, 0)
    ends = mean, np.minimum(low, mean), np.maximum(high, mean)
    reliable = np.asarray(result.status) == 0
    for i, (which, name) in enumerate(((reliable, "mean, 95 %"), (~reliable, "see its status"))):
        if which.any():
            bars(ax, np.flatnonzero(which), [v[which] for v in ends], i, label=name)
    ax.set_xlabel("Reading")
    ax.set_ylabel(label)
    legend_above(ax)
    return ax


@styled
def posterior_histogram(
    result: Posterior, ax: Axes | None = None, *, of: str = "radial_distance", draws: int = 4000
) -> Axes:
    """The posterior of one unknown given one reading: a histogram, its mean and 95 % interval.

    Parameters
    ----------
    result : Posterior
        Of a single reading.
    ax : Axes, optional
    of : str
        The unknown.
    draws : int
        Draws in the histogram, repeatable.

    Returns
    -------
    Axes

    Raises
    ------
    ValueError
        For a result of many readings.

    Examples
    --------
    >>> from weberwhisk import Observer, Whisker, cues, posterior as infer
    >>> observer = Observer(Whisker(50e-3, 100e-6, 5e-6), cues.Compliance())
    >>> posterior_histogram(infer(observer, observer.read(30e-3, seed=1))).get_ylabel()
    'Probability density'
    """
    if np.ndim(result.reading) > 1:
        raise ValueError(
            f"One posterior is drawn at a time, got {len(result.reading)} readings; "
            "infer from one of them."
        )
    one_of("of", of, result.observer.unknowns)
    ax = axes_or_new(ax)
    label, unit = _UNKNOWNS.get(of, (drawable(of.replace("_", " ")), 1.0))
    ax.set_xlabel(label)
    ax.set_ylabel("Probability density")
    if not np.isfinite(result.estimates[of].mean).all():
        why = result.status.message
        ax.text(0.5, 0.5, f"no posterior: {why}", transform=ax.transAxes, ha="center", wrap=True)
        return ax
    column = result.observer.unknowns.index(of)
    values = result.draws_of(-(-draws // 4), 0)[0, :, :, column].ravel() / unit
    ax.hist(values, bins=60, density=True, color=COLOURS[4], edgecolor="none")
    mean = float(result.estimates[of].mean / unit)
    low, high = np.asarray(result.interval(0.95, of=of)) / unit
    ax.axvline(mean, color=COLOURS[0], label=f"mean {mean:.3g}")
    for end in (low, high):
        ax.axvline(
            end, color=COLOURS[1], linestyle="--",
            label=f"95 %: {low:.3g} to {high:.3g}" if end == low else None,
        )  # fmt: skip
    legend_above(ax)
    return ax


@styled
def jnd_lines(
    tables: JNDCurve | pd.DataFrame | Mapping[str, JNDCurve | pd.DataFrame],
    ax: Axes | None = None,
    *,
    length: float | None = None,
    weber_fraction: float | None = None,
) -> Axes:
    """The JND of radial distance against distance: closed form as lines, posteriors as points.

    The paper's figure 4a.

    Parameters
    ----------
    tables : JNDCurve or DataFrame, or mapping of label to such
        From `jnd_curve`, or its ``table``. Of a table, rows whose ``posterior_mm`` is NaN extend
        the line alone.
    ax : Axes, optional
    length : float, optional
        Length of the whisker, m. With it both axes are fractions of it and the JND is divided by
        `weber_fraction`, where that is given, as in the paper; without it they are in mm.
    weber_fraction : float, optional
        See `length`.

    Returns
    -------
    Axes

    Examples
    --------
    >>> from weberwhisk import Observer, Whisker, cues, jnd_curve as curve
    >>> observer = Observer(Whisker(50e-3, 100e-6, 5e-6), cues.Compliance())
    >>> ax = jnd_lines(curve(observer, [10e-3, 30e-3], n_readings=20, seed=1))
    >>> ax.get_xlabel()
    'Radial distance r (mm)'
    """
    ax = axes_or_new(ax)
    given = tables if isinstance(tables, Mapping) else {"": tables}
    named: dict[str, pd.DataFrame] = {}
    for label, one in given.items():
        parts = one.lines() if isinstance(one, JNDCurve) else _by_angle(one)
        named |= {", ".join(filter(None, (label, angle))): t for angle, t in parts.items()}
    x_unit = 1.0 if length is None else 1e3 * length
    y_unit = 1.0 if length is None else 1e3 * length * (weber_fraction or 1.0)
    for i, (label, table) in enumerate(named.items()):
        rows = table.sort_values("radial_distance_mm")
        prefix = f"{drawable(label)}: " if label else ""
        # The closed form holds for small angles; where it is not what the observer has, both show.
        x = rows["radial_distance_mm"].to_numpy(float) / x_unit
        exact = rows["propagation_mm"].to_numpy(float) / y_unit
        closed = rows["closed_form_mm"].to_numpy(float) / y_unit
        if np.isfinite(closed).any():
            ax.plot(x, closed, **look(i), label=f"{prefix}closed form")
        if not np.allclose(exact, closed, rtol=1e-3, equal_nan=True):
            ax.plot(x, exact, **look(i) | {"linestyle": ":"}, label=f"{prefix}exact slope")
        points = np.isfinite(rows["posterior_mm"].to_numpy(float))
        if points.any():
            found, error = (
                rows[name].to_numpy(float)[points] / y_unit
                for name in ("posterior_mm", "posterior_error_mm")
            )
            ends = found, found - 1.96 * error, found + 1.96 * error
            bars(ax, x[points], ends, i, markersize=2.5, label=f"{prefix}posterior, 95 %")
    ax.set_xlim(left=0)
    ax.set_ylim(bottom=0)
    if length is None:
        ax.set_xlabel("Radial distance r (mm)")
        ax.set_ylabel(f"JND of radial distance (mm), {_criterion(named)}")
    else:
        ax.set_xlabel("Radial distance r/L")
        unit = "L" if weber_fraction is None else "(kL)"
        ax.set_ylabel(f"JND/{unit}, {_criterion(named)}")
    legend_above(ax)
    return ax


def _by_angle(table: pd.DataFrame) -> dict[str, pd.DataFrame]:
    """The rows of each deflection angle, by its label."""
    rows = table.reset_index()
    if "deflection_angle_deg" not in rows or rows["deflection_angle_deg"].nunique() < 2:
        return {"": rows}
    return {f"{angle:.4g}°": part for angle, part in rows.groupby("deflection_angle_deg")}


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
        Columns ``radial_distance_mm``, ``deflection_angle_deg`` and ``jnd_mm``: for every distance
        equally many angles, the last of them where the whisker flicks past. If there are
        ``contact_angle_deg`` and ``signed_jnd_mm``, which changes sign at a false zero, the contact
        angle of 90° and the false zero are drawn. From `surveys.surface`, say.
    ax : Axes, optional
    length, weber_fraction : float
        m. The JND is shown as a fraction of their product, the distance as one of the length.
    points : DataFrame, optional
        Rows of a `JNDCurve`'s table, whose posterior is written beside their place.

    Returns
    -------
    Axes
    """
    ax = axes_or_new(ax, SINGLE + 0.6, 3.0)
    names = ["radial_distance_mm", "deflection_angle_deg", "jnd_mm"]
    rows = table.sort_values(names[:2])
    count = rows["radial_distance_mm"].nunique()
    r, y, jnd = (rows[name].to_numpy(float).reshape(count, -1) for name in names)
    length_mm = 1e3 * length
    x, z = r / length_mm, jnd / (length_mm * weber_fraction)
    top = np.ceil(np.nanmax(z[:, 0]) * 5) / 5
    filled = ax.contourf(x, y, z, np.linspace(0, top, 65), cmap="cividis", extend="neither")
    filled.set_rasterized(True)
    lines = ax.contour(x, y, z, np.arange(0.2, top, 0.2), colors="white", linewidths=0.8)
    # Where each line is crossed half-way up: the labels stand clear of the edge.
    ax.clabel(lines, fmt="%.1f", fontsize=7)
    for name, level, style, colour, label in (
        ("contact_angle_deg", 90.0, "--", "white", "contact angle of 90°"),
        ("signed_jnd_mm", 0.0, "-", COLOURS[1], "false zero of the linear JND"),
    ):
        if name in rows:
            w = rows[name].to_numpy(float).reshape(count, -1)
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
        for row in points.reset_index().to_dict("records"):
            at = row["radial_distance_mm"] / length_mm, row["deflection_angle_deg"]
            ax.plot(*at, "o", color="white", markeredgecolor="black")
            ax.annotate(
                f"{row['posterior_mm'] / (length_mm * weber_fraction):.2f}",
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
