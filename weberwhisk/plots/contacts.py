"""Bent whiskers, inferred contacts and positions, and JNDs."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from textwrap import fill
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from .._util.checks import one_of, shown
from .._util.refusals import Refusal
from .._util.values import Array, pd
from .style import (
    COLOURS,
    DOUBLE,
    LINES,
    SINGLE,
    SMALL,
    axes_or_new,
    bars,
    drawable,
    errors,
    figure_of,
    legend_above,
    legend_over,
    look,
    mark,
    open_figure,
    styled,
)

if TYPE_CHECKING:
    from ..array import Follicle, Place, WhiskerArray
    from ..inference import Posterior
    from ..mechanics import Bending
    from ..sensitivity import JNDCurve

__all__ = [
    "bending", "calibrated", "fill_surface", "from_above", "jnd_lines", "jnd_surface", "located",
    "place", "posteriors", "whisker_array",
]  # fmt: skip

#: More readings than this are drawn as dots over a band.
MOST_BARS = 200


@styled
def bending(
    curves: Bending, axes: Sequence[Axes] | None = None, *, points: Bending | None = None,
    against: str = "deflection_angle",
) -> NDArray[np.object_]:  # fmt: skip
    """Plot the three signals at the base of a bent whisker, one line per contact distance.

    Parameters
    ----------
    curves : Bending
        Arrays (lines, points along each line); with fewer dimensions, one line or one point.
    axes : three Axes, optional
    points : Bending, optional
        Contacts to mark, arrays (lines, marks on each line).
    against : {"deflection_angle", "force"}
        The horizontal axis. Lines then differ in radial distance or in arc length.

    Returns
    -------
    array of the three Axes

    Raises
    ------
    ValueError
        For another `against`, or a number of axes other than three.

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
        raise Refusal("Three signals are drawn", shown(axes), "give three axes")
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
        x, y, place = (_values(curves, which) for which in (against, attribute, name))
        for i, in_reach in enumerate(np.isfinite(y)):
            if not in_reach.any():  # out of reach: there is no line
                continue
            ends = dict.fromkeys(f"{1e3 * f(place[i][in_reach]):.4g}" for f in (np.min, np.max))
            text = f"{symbol} = {' to '.join(ends)} mm"
            line = mark(i, markersize=4) if in_reach.sum() == 1 else look(i)
            ax.plot(x[i] / unit, y[i] / scale, **line, label=text)
            if points is not None:
                at = [_values(points, which)[i] for which in (against, attribute)]
                marks = mark(i, markersize=4, markerfacecolor="white")
                ax.plot(at[0] / unit, at[1] / scale, **marks)
        ax.set(xlabel=label, ylabel=title)
    legend_over(figure_of(axes), axes[:1], 5)
    if not axes[0].lines:
        axes[1].annotate(
            "no contact is held", (0.5, 0.5), xycoords="axes fraction", ha="center", va="center"
        )
    return np.array(axes, dtype=object)


def _values(curves: Bending, name: str) -> Array:
    """An attribute of every contact, (lines, points)."""
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
    """Plot posteriors: a histogram for one reading, means and 95 % intervals for several.

    Parameters
    ----------
    result : Posterior
    ax : Axes, optional
    of : str
        The unknown of the contact to plot.
    draws : int
        Draws in the histogram, from a fixed seed.

    Examples
    --------
    >>> from weberwhisk import Observer, Whisker, cues, posterior as infer
    >>> observer = Observer(Whisker(50e-3, 100e-6, 5e-6), cues.Compliance())
    >>> posteriors(infer(observer, observer.read([[20e-3], [30e-3]], seed=1))).get_xlabel()
    'Reading'
    >>> posteriors(infer(observer, observer.read(30e-3, seed=1))).get_ylabel()
    'Probability density'
    """
    one_of("of", of, result.observer.unknowns)
    ax = axes_or_new(ax)
    label, unit = _UNKNOWNS.get(of, (drawable(of.replace("_", " ")), 1.0))
    mean = np.asarray(result.estimates[of].mean) / unit
    if np.ndim(result.reading) < 2:
        ax.set(xlabel=label, ylabel="Probability density")
        if not np.isfinite(mean):
            why = fill(f"no posterior: {result.status.message}.", 36)
            ax.text(0.5, 0.5, why, transform=ax.transAxes, ha="center", va="center")
            ax.set(xticks=[], yticks=[])
            return ax
        column = result.observer.unknowns.index(of)
        values = result.solution.draws(-(-draws // 4), 0)[0, :, :, column].ravel() / unit
        ax.hist(values, bins=60, density=True, color=COLOURS[4], edgecolor="none")
        low, high = np.asarray(result.interval(0.95, of=of)) / unit
        ax.axvline(float(mean), color=COLOURS[0], label=f"mean {mean:.3g}")
        ax.axvline(low, color=COLOURS[1], linestyle="--", label=f"95 %: {low:.3g} to {high:.3g}")
        ax.axvline(high, color=COLOURS[1], linestyle="--")
        return legend_above(ax)
    low, high = np.moveaxis(np.asarray(result.interval(0.95, of=of)) / unit, -1, 0)
    ends = mean, np.minimum(low, mean), np.maximum(high, mean)
    reliable = np.asarray(result.status) == 0
    many = len(mean) > MOST_BARS
    if many:
        at = np.arange(len(mean))
        ax.fill_between(at, *ends[1:], color=COLOURS[4], alpha=0.4, linewidth=0, label="95 %")
    for i, (which, name) in enumerate(((reliable, "mean, 95 %"), (~reliable, "see its status"))):
        if which.any() and many:
            dots = mark(i, markersize=1.5, label=name.removesuffix(", 95 %"))
            ax.plot(np.flatnonzero(which), mean[which], **dots)
        elif which.any():
            bars(ax, np.flatnonzero(which), [v[which] for v in ends], i, label=name)
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ax.set(xlabel="Reading", ylabel=label)
    return legend_above(ax)


@styled
def jnd_lines(
    tables: JNDCurve | pd.DataFrame | Mapping[str, JNDCurve | pd.DataFrame], ax: Axes | None = None,
    *, length: float | None = None, weber_fraction: float | None = None,
) -> Axes:  # fmt: skip
    """Plot the JND of radial distance: closed form as lines, posteriors as points (figure 4a).

    Parameters
    ----------
    tables : JNDCurve or DataFrame, or mapping from labels to these
        From `jnd_curve`, or its ``table``. Rows of a table whose ``posterior_mm`` is NaN only
        extend the line.
    ax : Axes, optional
    length : float, optional
        Length of the whisker, m, by which both axes are divided, as in the paper; by default they
        are in mm.
    weber_fraction : float, optional
        Weber fraction by which the JND is divided too, if `length` is given.

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
        lines = _by_angle(one) if isinstance(one, pd.DataFrame) else one.lines()
        named |= {", ".join(filter(None, (label, angle))): t for angle, t in lines.items()}
    x_unit = 1.0 if length is None else 1e3 * length
    y_unit = 1.0 if length is None else 1e3 * length * (weber_fraction or 1.0)
    for i, (label, table) in enumerate(named.items()):
        by_distance = table.sort_values("radial_distance_mm")
        prefix = f"{drawable(label)}: " if label else ""
        # The closed form is for small angles: the observer's own slope is shown where it differs.
        x = by_distance["radial_distance_mm"].to_numpy(float) / x_unit
        exact = by_distance["propagation_mm"].to_numpy(float) / y_unit
        closed = by_distance["closed_form_mm"].to_numpy(float) / y_unit
        if np.isfinite(closed).any():
            ax.plot(x, closed, **look(i), label=f"{prefix}closed form")
        if not np.allclose(exact, closed, rtol=1e-3, equal_nan=True):
            ax.plot(x, exact, **look(i) | {"linestyle": ":"}, label=f"{prefix}exact slope")
        points = np.isfinite(by_distance["posterior_mm"].to_numpy(float))
        if points.any():
            posterior, error = (
                by_distance[name].to_numpy(float)[points] / y_unit
                for name in ("posterior_mm", "posterior_error_mm")
            )
            label = f"{prefix}posterior, 95 %"
            errors(ax, x[points], posterior, error, i, markersize=2.5, label=label)
    ax.set_xlim(left=0)
    ax.set_ylim(bottom=0)
    criterion = " / ".join(dict.fromkeys(str(c) for t in named.values() for c in t["criterion"]))
    what = "JND of radial distance (mm)"
    if length is not None:
        what = "JND/L" if weber_fraction is None else "JND/(kL)"
    ax.set_xlabel("Radial distance r (mm)" if length is None else "Radial distance r/L")
    ax.set_ylabel(f"{what}, {criterion}")
    return legend_above(ax)


def _by_angle(table: pd.DataFrame) -> dict[str, pd.DataFrame]:
    """The rows at each deflection angle, by its label."""
    flat = table.reset_index()
    if "deflection_angle_deg" not in flat or flat["deflection_angle_deg"].nunique() < 2:
        return {"": flat}
    return {f"{angle:.4g}°": part for angle, part in flat.groupby("deflection_angle_deg")}


@styled
def jnd_surface(
    table: pd.DataFrame, ax: Axes | None = None, *, length: float, weber_fraction: float
) -> Axes:
    """Plot the JND over radial distance and deflection angle up to flick-past (figure 4b).

    The paper's figure ends at a contact angle of 90°. With noise in only one signal the linear JND
    has a *false zero*, drawn as a line in a dark band: the other signal does not change with the
    angle there, so that to first order distance is known exactly. No posterior has it. With noise
    in the moment only, it lies beyond 90°; in the axial force only, below 90° from a fifth of the
    length outwards.

    Parameters
    ----------
    table : DataFrame
        As from `sensitivity.linear_surface`: ``radial_distance_mm``, ``deflection_angle_deg`` and
        ``jnd_mm``, with the same number of angles at every distance, the last of them at
        flick-past. ``contact_angle_deg`` adds the line of 90°, and ``signed_jnd_mm``, which
        changes sign at a false zero, the line of the false zero.
    ax : Axes, optional
    length, weber_fraction : float
        Length L (m) and Weber fraction k: the axes are r/L and JND/(kL).
    """
    ax = axes_or_new(ax, SINGLE + 0.6, 3.0)
    fill_surface(ax, table, length, weber_fraction)
    return legend_above(ax)


def fill_surface(ax: Axes, table: pd.DataFrame, length: float, weber_fraction: float) -> None:
    """Draw the colours, lines and labels of `jnd_surface`, without its legend."""
    names = ["radial_distance_mm", "deflection_angle_deg", "jnd_mm"]
    by_place = table.sort_values(names[:2])
    count = by_place["radial_distance_mm"].nunique()
    r, y, jnd = (by_place[name].to_numpy(float).reshape(count, -1) for name in names)
    x, z = r / (1e3 * length), jnd / (1e3 * length * weber_fraction)
    top = np.ceil(np.nanmax(z[:, 0]) * 5) / 5
    filled = ax.contourf(x, y, z, np.linspace(0, top, 65), cmap="cividis", extend="neither")
    filled.set_rasterized(True)
    lines = ax.contour(x, y, z, np.arange(0.2, top, 0.2), colors="white", linewidths=0.8)
    ax.clabel(lines, fmt="%.1f", fontsize=SMALL)
    for name, level, style, colour, label in (
        ("contact_angle_deg", 90.0, "--", "white", "contact angle of 90°"),
        ("signed_jnd_mm", 0.0, "-", COLOURS[1], "false zero of the linear JND"),
    ):
        if name in by_place:
            w = by_place[name].to_numpy(float).reshape(count, -1)
            if np.nanmin(w) < level < np.nanmax(w):  # a cylinder may reach neither
                ax.contour(x, y, w, [level], colors=colour, linestyles=style, linewidths=1.2)
                colour = "0.6" if colour == "white" else colour
                ax.plot([], [], linestyle=style, color=colour, linewidth=1.2, label=label)
    ax.plot(x[:, -1], y[:, -1], color="black", linewidth=1.2)
    ax.text(0.97, 0.95, "flicked past", transform=ax.transAxes, ha="right", va="top")
    ticks = np.arange(0, top + 0.01, 0.2)
    figure_of(ax).colorbar(filled, ax=ax, ticks=ticks, label="JND/(kL), d'=1")
    ax.set(xlabel="Radial distance r/L", ylabel=_UNKNOWNS["deflection_angle"][0], xlim=(0, 1))
    ax.set_ylim(bottom=0)


@styled
def located(
    table: pd.DataFrame, ax: Axes | None = None, *, against: str | None = None, by: str = ""
) -> Axes:
    """Plot a table from `locate`: distances with 95 % intervals.

    Parameters
    ----------
    table : DataFrame
    ax : Axes, optional
    against : str, optional
        Column of the horizontal axis; by default the row.
    by : str
        Column that numbers touches. If it is also `against`, only touches are drawn.
    """
    ax = axes_or_new(ax, DOUBLE)
    names = ("radial_distance_mm", "lower_mm", "upper_mm")
    x = np.arange(len(table)) if against in (None, by) else table[against].to_numpy(dtype=float)
    frames = table.assign(place=x).sort_values("place", kind="stable")
    touches = frames[frames["touch_status"] == "converged"].groupby(by, sort=False) if by else None
    if touches is not None and against == by:
        first = touches.first()
        at = np.arange(len(first))
        bars(ax, at, [first[f"touch_{n}"] for n in names], 0, label="each touch, 95 % interval")
        ax.set_xticks(at[:: 1 + len(at) // 20], first.index[:: 1 + len(at) // 20])
    else:
        middle, low, high = (frames[name].astype(float) for name in names)
        band: Any = {"color": COLOURS[4], "alpha": 0.4, "label": "95 % interval, each row"}
        ax.fill_between(frames["place"], low, high, **band)
        dots: Any = {"color": COLOURS[0], "markersize": 2, "label": "mean, each row"}
        ax.plot(frames["place"], middle, ".", **dots)
        if touches is not None and len(touches):
            first = touches.first()
            ends = [first[f"touch_{name}"] for name in names]
            bars(ax, touches["place"].mean(), ends, 1, label="each touch, 95 % interval")
    named = "row" if against is None else against.replace("_", " ")
    ax.set(xlabel=re.sub(" (m?s|mm?)$", r" (\1)", named), ylabel="radial distance (mm)")
    return legend_above(ax)


@styled
def calibrated(found: Any, ax: Axes | None = None) -> Axes:
    """Plot measured over fitted slopes of a `Calibration` against distance, with its noise."""
    ax = axes_or_new(ax, DOUBLE)
    taps = found.residuals
    k = found.noise.weber_fraction
    ax.axhspan(1 - 1.96 * k, 1 + 1.96 * k, color=COLOURS[4], alpha=0.4, label="95 % of taps")
    ax.axhline(1.0, color=COLOURS[0], linewidth=0.8, label="fit")
    slope = taps["slope"] / taps["fitted"]
    ax.plot(taps["radial_distance_mm"], slope, ".", color=COLOURS[0], markersize=3, label="taps")
    ax.set(xlabel="radial distance (mm)", ylabel="slope, measured over fitted")
    return legend_above(ax)


@styled
def whisker_array(array: WhiskerArray, ax: Axes | None = None) -> Axes:
    """Plot whiskers from above in mm, with a colour and line style for each row."""
    ax = axes_or_new(ax, DOUBLE, 2.6)
    for row, (colour, line) in enumerate(zip(COLOURS, [*LINES, "-"], strict=False)):
        mine = [w for w in array.whiskers.values() if w.identity[0] == "ABCDE"[row]]
        for i, whisker in enumerate(mine):
            label = f"row {whisker.identity[0]}" if i == 0 else None
            ax.plot(*from_above(whisker), color=colour, linestyle=line, linewidth=0.9, label=label)
    bases = 1e3 * np.array([w.base[:2] for w in array.whiskers.values()])
    ax.plot(*bases.T, "k.", markersize=2, label="bases")
    ax.set(aspect="equal", xlabel="to the right (mm)", ylabel="rostral (mm)")
    return legend_above(ax, columns=6)


def from_above(whisker: Follicle) -> tuple[np.ndarray, np.ndarray]:
    """x and y (mm) along a whisker at rest, in its plane of whisking."""
    law, straight = getattr(whisker.whisker, "law", None), whisker.whisker
    arc = np.linspace(0.0, getattr(straight, "whisker", straight).length, 40)
    # Curvature is positive away from the object; positive deflection angles point backwards.
    along, across = (arc, 0 * arc) if law is None else law.point(arc)
    x, y = 1e3 * whisker.place(np.hypot(along, across), np.arctan2(across, along)).T
    return x, y


@styled
def place(found: Place, ax: Axes | None = None) -> Axes:
    """Plot the 95 % region of an object's position, its error ellipse, and the whiskers.

    Whiskers are drawn at rest, those in contact as thick lines.
    """
    ax = axes_or_new(ax, SINGLE, 3.0)
    x, y = 1e3 * found.places.T
    order = np.argsort(-found.log_density)
    above = np.cumsum(found.weights[order])
    levels = [float(found.log_density[order][np.searchsorted(above, m)]) for m in (0.95, 0.5)]
    kept = found.log_density > levels[0] - 4.0
    if kept.sum() > 3:
        shades = [COLOURS[4], COLOURS[0]]
        ends = [*levels, float(found.log_density.max()) + 1.0]
        ax.tricontourf(x[kept], y[kept], found.log_density[kept], ends, colors=shades, alpha=0.6)
        for shade, words in zip(shades, ("95 % of the posterior", "50 %"), strict=True):
            ax.fill([], [], color=shade, alpha=0.6, label=words)
    major, minor, angle = found.ellipse()
    turn = np.linspace(0.0, 2 * np.pi, 90)
    rim = (major * np.cos(turn) + 1j * minor * np.sin(turn)) * np.exp(1j * angle)
    along, across = found.mean[0] + rim.real, found.mean[1] + rim.imag
    ax.plot(1e3 * along, 1e3 * across, "--", color=COLOURS[1], label="95 % error ellipse")
    for touches, label, colour, width in (
        (True, "whiskers that touch", "black", 1.2), (False, "others", "0.7", 0.5)
    ):  # fmt: skip
        for name, whisker in found.observer.array.whiskers.items():
            if (name in found.touching) == touches:
                line = ax.plot(*from_above(whisker), color=colour, linewidth=width)
                line[0].set_label(label)
                label = "_"
    (left, right), (low, high) = ((a.min(), a.max()) for a in (x[kept], y[kept]))
    room = max(right - left, high - low) * 0.75
    ax.set_xlim((left + right) / 2 - room, (left + right) / 2 + room)
    ax.set_ylim((low + high) / 2 - room, (low + high) / 2 + room)
    ax.set(aspect="equal", xlabel="to the right (mm)", ylabel="rostral (mm)")
    return legend_above(ax)
