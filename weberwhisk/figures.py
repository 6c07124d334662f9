"""Charts of results: each takes a result and, if wanted, axes to draw on, and returns the axes.

Nothing is computed here but the scaling of axes and the error bars of counts. Colours are those of
Okabe and Ito, which the colour-blind can tell apart, and every colour comes with its own marker or
line style, so that a figure also reads in grey.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import wraps
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray
from scipy.special import betaincinv

if TYPE_CHECKING:
    import pandas as pd

    from .behaviour import WeberFit
    from .mechanics import Bending
    from .posterior import Posterior

Array = NDArray[np.float64]

#: Okabe and Ito's colours, dark ones first.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000")
LINES = ("-", "--", "-.", ":")
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
#: Widths of a printed column and of two, inches.
SINGLE, DOUBLE = 3.5, 7.2
_STYLE: Any = {
    "font.size": 8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
    "legend.fontsize": 7,
    "axes.titlesize": 8,
    "figure.labelsize": 8,
    "patch.linewidth": 0,
    "lines.linewidth": 1.3,
    "lines.markersize": 4,
}
_SAVING: Any = {"svg.hashsalt": "weberwhisk"}


P = ParamSpec("P")
R = TypeVar("R")


def _styled(draw: Callable[P, R]) -> Callable[P, R]:
    """Draw in this module's style and leave the user's own as it was."""

    @wraps(draw)
    def drawn(*arguments: P.args, **options: P.kwargs) -> R:
        with matplotlib.rc_context(_STYLE):
            return draw(*arguments, **options)

    return drawn


class _Figure(Figure):
    """A figure whose files are the same each time they are made."""

    def savefig(self, fname: Any, **options: Any) -> None:
        with matplotlib.rc_context(_STYLE | _SAVING):
            super().savefig(fname, **options)


def new_figure(width: float = SINGLE, height: float = 2.8) -> Figure:
    """An empty figure in this module's style, inches."""
    return _Figure(figsize=(width, height), dpi=200, layout="constrained")


def _axes(ax: Axes | None, width: float = SINGLE, height: float = 2.8) -> Axes:
    if ax is not None:
        return ax
    return new_figure(width, height).subplots()


def figure_of(axes: Any) -> Any:
    """The figure that axes, or an array of them, stand in."""
    figure = np.ravel(np.asarray(axes, dtype=object))[0].figure
    assert isinstance(figure, Figure)
    return figure


# -- just noticeable differences -----------------------------------------------------------------


@_styled
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
    >>> ax = jnd_curve(curve(observer, [10e-3, 30e-3], draws=20, seed=1))
    >>> ax.get_xlabel()
    'Radial distance r (mm)'
    """
    import pandas as pd

    ax = _axes(ax)
    named = {"": tables} if isinstance(tables, pd.DataFrame) else tables
    x_unit = 1e-3 if length is None else length
    y_unit = 1e-3 if length is None else length * weber_fraction
    for i, (label, table) in enumerate(named.items()):
        rows = table.sort_values("radial_distance")
        colour = COLOURS[i % len(COLOURS)]
        prefix = f"{label}: " if label else ""
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
    _legend_above(ax)
    return ax


def _criterion(tables: Mapping[str, pd.DataFrame]) -> str:
    return " / ".join(dict.fromkeys(str(c) for t in tables.values() for c in t["criterion"]))


@_styled
def jnd_surface(
    table: pd.DataFrame,
    ax: Axes | None = None,
    *,
    length: float,
    weber_fraction: float,
    points: pd.DataFrame | None = None,
) -> Axes:
    """The JND over radial distance and deflection angle, up to where the whisker flicks past.

    The paper's figure 4b.

    Parameters
    ----------
    table : DataFrame
        Columns ``radial_distance`` (m), ``deflection_angle`` (rad) and ``jnd`` (m): for every
        distance equally many angles, the last of them where the whisker flicks past.
    ax : Axes, optional
    length, weber_fraction : float
        The JND is shown as a fraction of their product, the distance as one of the length.
    points : DataFrame, optional
        Rows of `jnd_curve` whose posterior is written beside their place.

    Returns
    -------
    Axes
    """
    ax = _axes(ax, SINGLE + 0.6, 3.0)
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
    ax.plot(x[:, -1], y[:, -1], color="black", linewidth=1.2)
    ax.text(0.97, 0.95, "flicked past", transform=ax.transAxes, ha="right", va="top")
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


# -- choices -------------------------------------------------------------------------------------


@_styled
def psychometric(
    fit: WeberFit, ax: Axes | None = None, *, standard: float | None = None, unit: str = ""
) -> Axes:
    """Choices at one standard, with 95 % binomial intervals, and the curve fitted to them.

    Parameters
    ----------
    fit : WeberFit
    ax : Axes, optional
    standard : float, optional
        May be left out where the table has one.
    unit : str
        Of the stimulus, for the axis.

    Returns
    -------
    Axes

    Notes
    -----
    The curve is that of a first stimulus at the standard. Choices with another first stimulus stand
    where their difference (on a log scale) or their ratio puts them.

    Examples
    --------
    >>> from weberwhisk import fit_weber, simulate_trials
    >>> ax = psychometric(fit_weber(simulate_trials(weber_fraction=0.1, seed=7)))
    >>> ax.get_ylabel()
    'Second reported greater'
    """
    ax = _axes(ax)
    known = fit.trials.standards
    if standard is None and known.size > 1:
        raise ValueError(
            f"There are {known.size} standards; name one, such as standard={known[0]:g}, or draw "
            "psychometrics(fit)."
        )
    s = float(known[0]) if standard is None else standard
    _choices(fit, ax, s)
    ax.set_xlabel(_stimulus_label(fit, unit))
    ax.set_ylabel(_answer_label(fit))
    _legend_above(ax)
    return ax


@_styled
def psychometrics(
    fit: WeberFit, axes: Sequence[Axes] | None = None, *, unit: str = ""
) -> NDArray[Any]:
    """`psychometric` at every standard, in small multiples; returns their axes."""
    known = fit.trials.standards
    if axes is None:
        columns = min(len(known), 4)
        rows = -(-len(known) // columns)
        width = SINGLE if columns == 1 else DOUBLE * max(columns, 2) / 4
        figure = new_figure(width, 0.9 + 1.55 * rows if rows > 1 else 2.6)
        grid = figure.subplots(rows, columns, sharey=True, sharex=_relative(fit), squeeze=False)
        axes = list(grid.ravel())
        for spare in axes[len(known) :]:
            spare.set_visible(False)
    for ax, s in zip(axes, known, strict=False):
        _choices(fit, ax, float(s))
        if len(known) > 1:
            ax.set_title(f"standard {s:.3g}")
    figure = figure_of(axes)
    figure.supxlabel(_stimulus_label(fit, unit))
    figure.supylabel(_answer_label(fit))
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=2)
    return np.array(axes[: len(known)], dtype=object)


def _relative(fit: WeberFit) -> bool:
    """Whether the horizontal axis is a difference: on a log scale only that matters."""
    return bool(fit.trials.scale == "log")


def _stimulus_label(fit: WeberFit, unit: str) -> str:
    counted = f" ({unit})" if unit else ""
    if _relative(fit):
        return f"Second stimulus − first{counted or ' (units of the log column)'}"
    return f"Second stimulus{counted}"


def _answer_label(fit: WeberFit) -> str:
    return (
        "Second reported greater" if fit.trials.task.response == "choice" else "Proportion correct"
    )


def _choices(fit: WeberFit, ax: Axes, standard: float) -> None:
    every = fit.trials.cells()
    cells = every.of(float(every.standard[np.argmin(np.abs(every.standard - standard))]))
    first, second, n = cells.stimulus_1, cells.stimulus_2, cells.n
    share = cells.count / n
    low, high = _binomial_interval(share * n, n)
    if _relative(fit):
        x, origin = second - first, standard
    else:
        x, origin = standard * second / first, 0.0
    if x.size:
        reach = [min(x.min(), standard - origin), max(x.max(), standard - origin)]
        margin = 0.08 * (reach[1] - reach[0]) or 0.1 * abs(standard) or 0.1
        lowest, highest = fit.percept.domain
        edges = np.clip(
            [reach[0] - margin + origin, reach[1] + margin + origin],
            lowest + 1e-6 * margin if np.isfinite(lowest) else lowest,
            highest - 1e-6 * margin if np.isfinite(highest) else highest,
        )
        curve = fit.psychometric(np.linspace(edges[0], edges[1], 121), standard)
        at = curve["comparison"] - origin
        ax.fill_between(
            at, curve["lower"], curve["upper"], color=COLOURS[4], alpha=0.35, linewidth=0,
            label="fit, 95 %" if fit.parameters else None,
        )  # fmt: skip
        # A fit to which every parameter was given has a curve and no band.
        name = None if fit.parameters else "given parameters"
        ax.plot(at, curve["median"], color=COLOURS[0], label=name)
    ax.errorbar(
        x,
        share,
        # Lists: some versions of Matplotlib take a lone row of an array for a number.
        [(share - low).tolist(), (high - share).tolist()],
        fmt="o",
        color=COLOURS[6],
        elinewidth=1,
        capsize=2,
        label="choices, 95 %",
    )
    ax.axvline(standard - origin, color="0.7", linewidth=0.8, zorder=0)
    ax.set_ylim(-0.03, 1.03)
    ax.xaxis.set_major_locator(MaxNLocator(5))


def _binomial_interval(count: Array, n: Array) -> tuple[Array, Array]:
    """Jeffreys' 95 % interval of a proportion, closed where all or none were."""
    low = np.where(count == 0, 0.0, betaincinv(count + 0.5, n - count + 0.5, 0.025))
    high = np.where(count == n, 1.0, betaincinv(count + 0.5, n - count + 0.5, 0.975))
    # Rounding must not turn an error bar round.
    return np.minimum(low, count / n), np.maximum(high, count / n)


# -- bending -------------------------------------------------------------------------------------

#: What a panel of `bending` shows: attribute of Bending, label, and unit in SI.
_SIGNALS = (
    ("moment", "Moment M (µN m)", 1e-6),
    ("axial_force", "Axial force F$_x$ (µN)", 1e-6),
    ("transverse_force", "Transverse force F$_y$ (µN)", 1e-6),
)
_AGAINST = {
    "deflection_angle": ("Deflection angle θ$_d$ (degrees)", np.pi / 180, "radial_distance", "r"),
    "force": ("Contact force (µN)", 1e-6, "arc_length", "s"),
}


@_styled
def bending(
    curves: Bending,
    axes: Sequence[Axes] | None = None,
    *,
    points: Bending | None = None,
    against: str = "deflection_angle",
) -> NDArray[Any]:
    """The three signals at the base of a bent whisker, a line for each contact distance.

    Parameters
    ----------
    curves : Bending
        Arrays (lines, points along each).
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
    if axes is None:
        axes = list(new_figure(DOUBLE, 2.7).subplots(1, 3))
    label, unit, name, symbol = _AGAINST[against]
    for ax, (attribute, title, scale) in zip(axes, _SIGNALS, strict=True):
        for i in range(len(curves.moment)):
            held = np.isfinite(curves.moment[i])
            if not held.any():  # out of reach: there is no line
                continue
            distance = np.max(getattr(curves, name)[i][held])
            ax.plot(
                getattr(curves, against)[i] / unit,
                getattr(curves, attribute)[i] / scale,
                color=COLOURS[i % len(COLOURS)],
                linestyle=LINES[i % len(LINES)],
                label=f"{symbol} = {distance * 1e3:.4g} mm",
            )
            if points is not None:
                ax.plot(
                    getattr(points, against)[i] / unit,
                    getattr(points, attribute)[i] / scale,
                    MARKERS[i % len(MARKERS)],
                    color=COLOURS[i % len(COLOURS)],
                    markerfacecolor="white",
                )
        ax.set_xlabel(label)
        ax.set_ylabel(title)
    handles, labels = axes[0].get_legend_handles_labels()
    if handles:
        figure_of(axes).legend(
            handles, labels, loc="outside upper center", ncols=min(len(handles), 5)
        )
    else:
        axes[1].text(
            0.5, 0.5, "no contact is held", transform=axes[1].transAxes, ha="center", va="center"
        )
    return np.array(axes, dtype=object)


# -- posteriors ----------------------------------------------------------------------------------

_UNKNOWNS = {
    "radial_distance": ("Radial distance (mm)", 1e-3),
    "deflection_angle": ("Deflection angle (degrees)", np.pi / 180),
}


@_styled
def posterior(
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
    >>> posterior(infer(observer, observer.read(30e-3, seed=1))).get_ylabel()
    'Probability density'
    """
    if np.ndim(result.reading) > 1:
        raise ValueError(
            f"One posterior is drawn at a time, got {len(result.reading)} readings; "
            "infer from one of them."
        )
    ax = _axes(ax)
    label, unit = _UNKNOWNS[of]
    column = result.observer.unknowns.index(of)
    values = result.draws_of(-(-draws // 4), 0)[0, :, :, column].ravel() / unit
    ax.hist(values, bins=60, density=True, color=COLOURS[4], edgecolor="none")
    mean = result.estimates[of].mean / unit
    low, high = np.asarray(result.interval(0.95, of=of)) / unit
    ax.axvline(mean, color=COLOURS[0], label=f"mean {mean:.3g}")
    for end in (low, high):
        ax.axvline(
            end, color=COLOURS[1], linestyle="--",
            label=f"95 %: {low:.3g} to {high:.3g}" if end == low else None,
        )  # fmt: skip
    ax.set_xlabel(label)
    ax.set_ylabel("Probability density")
    _legend_above(ax)
    return ax


def _legend_above(ax: Axes) -> None:
    """A legend that cannot cover data, over the axes; none where there is nothing to tell."""
    handles, labels = ax.get_legend_handles_labels()
    if len(handles) > 1:
        ax.legend(
            handles, labels, loc="lower center", bbox_to_anchor=(0.5, 1.01), ncols=2,
        )  # fmt: skip
