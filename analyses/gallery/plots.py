"""What every cue tells of distance, from the tables of `surveys`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure

from weberwhisk import Outcome
from weberwhisk.plots.contacts import fill_surface
from weberwhisk.plots.style import (
    COLOURS,
    DOUBLE,
    LINES,
    SINGLE,
    SMALL,
    errors,
    legend_above,
    legend_over,
    log_numbers,
    look,
    mark,
    new_figure,
    styled,
)

#: Panels of `cue_jnds`: a title and the paper's sections in it.
_GROUPS = (
    ("events (§2a, b)", "ab"),
    ("angles and sides (§2c)", "c"),
    ("vibration and taps (§2d, e)", "de"),
    ("force map, balance (§2f, h)", "fgh"),
)
#: The first words of the outcome that is no failure.
_WORKS = Outcome.HELD.message.partition(":")[0]
_MARKS = (
    "Lines: Fisher information. Marks: mean sd of posteriors, with 95 % Monte Carlo errors below; "
    "open: the closed form is outside."
)


@styled
def cue_jnds(table: pd.DataFrame) -> Figure:
    """Where each cue works, its JND against r, and posteriors over closed forms.

    Lines are Fisher's JNDs, marks posteriors; open marks are where posterior and closed form differ
    by more than the Monte Carlo error. Above, every cue has its name and a line where it works;
    elsewhere it says what fails.

    Parameters
    ----------
    table : DataFrame
        From `surveys.curves`.
    """
    figure = new_figure(DOUBLE, 6.4)
    axes = figure.subplots(
        3, len(_GROUPS), sharex=True, sharey="row", height_ratios=(2.4, 4, 2.4), squeeze=False
    )
    for (title, sections), (works, top, below) in zip(_GROUPS, axes.T, strict=True):
        mine = table[table["cue"].str.extract(r"\(([a-h])\)$", expand=False).isin(list(sections))]
        for i, (name, rows) in enumerate(mine.groupby("cue", sort=False)):
            look = _cue_lines(top, below, rows, i)
            _where_it_works(works, rows, str(name), -i, look)
        works.set_title(title)
        works.set(ylim=(-3.6, 0.7), yticks=[])
        below.axhline(1.0, color="black", linewidth=0.8)
    below.set(ylim=(0.2, 1.7), xlim=(-0.02, 1.0))
    top.set(yscale="log", ylim=(0.05, 60))
    axes[0, 0].set_ylabel("where it works")
    axes[1, 0].set_ylabel("JND (mm), d'=1")
    axes[2, 0].set_ylabel("posterior /\nclosed form")
    axes[2, 0].text(0.5, 1.2, "events have\nno closed form", ha="center", color="0.3")
    figure.supxlabel(f"Radial distance r/L\n{_MARKS}")
    return figure


def _cue_lines(top: Axes, below: Axes, rows: pd.DataFrame, i: int) -> dict[str, Any]:
    """One cue's JNDs, and its posteriors over its closed form; returns its look."""
    # One event has no limit of small noise, and its information at a point says little.
    events = rows["closed_form_mm"].isna().all()
    expected = rows["posterior_mm" if events else "fisher_mm"]
    top.plot(rows["place"], expected, LINES[i], color=COLOURS[i])
    every = max(len(rows) // 12, 1)  # so that marks stand apart
    top.plot(rows["place"], rows["posterior_mm"], **mark(i, markevery=every))
    ratio = rows["posterior_mm"] / rows["closed_form_mm"]
    error = 1.96 * rows["posterior_error_mm"] / rows["closed_form_mm"]
    kept = np.arange(len(rows)) % every == 0
    off = np.abs(ratio - 1) > error
    for shown, face in ((off & kept, "none"), (~off & kept, COLOURS[i])):
        below.errorbar(
            rows["place"][shown], ratio[shown], error[shown],
            **mark(i, linewidth=0.7, markerfacecolor=face),
        )  # fmt: skip
    return mark(i, linestyle=LINES[i], markevery=every)


def _where_it_works(
    ax: Axes, rows: pd.DataFrame, name: str, height: float, look: Mapping[str, Any]
) -> None:
    """A cue's name over a line where it works, and under it the names of what fails elsewhere."""
    works = rows["outcome"].str.split(":").str[0].eq(_WORKS).to_numpy()
    place = rows["place"].to_numpy()
    ax.plot(np.where(works, place, np.nan), np.full(place.size, height), **look)
    ax.text(0.0, height + 0.12, name, fontsize=SMALL, color=look["color"], va="bottom")
    said: dict[str, list[str]] = {"left": [], "right": []}
    for outcome, lost in rows[~works].groupby("outcome", sort=False):
        ends = lost["place"].min(), lost["place"].max()
        ax.plot(ends, (height, height), ":", color="0.5", linewidth=1)
        said["right" if ends[1] > 0.7 else "left"].append(str(outcome).split(":")[0])
    for side, words in ((s, w) for s, w in said.items() if w):
        ha = side if len(words) < 2 else "left"  # two are as wide as the panel
        x = 1.0 if ha == "right" else 0.0
        ax.text(x, height - 0.16, ", ".join(words), fontsize=SMALL, color="0.3", va="top", ha=ha)


@styled
def curvature(jnds: pd.DataFrame, biases: pd.DataFrame) -> Figure:
    """JNDs of curved and rubbing whiskers, and the bias of taking the rat's as straight.

    Parameters
    ----------
    jnds : DataFrame
        From `surveys.curvatures`; of posteriors, with 95 % Monte Carlo errors.
    biases : DataFrame
        From `surveys.taken_as_straight`.
    """
    figure = new_figure(DOUBLE, 3.4)
    left, right = figure.subplots(1, 2)
    for i, (name, rows) in enumerate(jnds.groupby("whisker", sort=False)):
        jnd, error = rows["posterior_mm"], rows["posterior_error_mm"]
        bow, friction, model = rows.iloc[0][["curvature_per_m", "friction_angle_deg", "model"]]
        of = f", {bow:+.3g} /m" if bow else f", ψ = {friction:+g}°" if friction else ""
        label = f"{name}{of}: {model}".replace("-", "−")
        errors(left, rows["place"], jnd, error, i, **look(i), label=label)
    left.set(xlabel="Radial distance r/L", ylabel="JND (mm), d'=1", xlim=(0, 1))
    left.set_ylim(bottom=0)
    legend_above(left)
    for i, (row, rows) in enumerate(biases.groupby(biases["identity"].str[0])):
        arc = rows["identity"].str[1:].astype(int)
        right.plot(arc, rows["bias_jnd"], **mark(i) | look(i), label=f"row {row}")
    for i, (level, text) in enumerate(((1.0, "said in note"), (0.1, "allowed: a tenth"))):
        right.axhline(level, color="0.4", linestyle=LINES[i], linewidth=0.8, label=text)
    right.set(xlabel="Arc (0: α to δ)", ylabel="moved by a straight model (JND)", yscale="log")
    log_numbers(right.yaxis)
    legend_above(right, 3)
    return figure


@styled
def decisions(choices: pd.DataFrame, powers: pd.DataFrame) -> Figure:
    """Choices of observers of real whiskers, and the power to distinguish pairs of them.

    Parameters
    ----------
    choices : DataFrame
        Columns `decision`, `task`, `standard_mm`, `radial_distance_mm` and `farther`, the share of
        answers that the pole, or the second of two, is farther.
    powers : DataFrame
        Tables of `power`, with a column `question`; of both truths the one told less is drawn.
    """
    figure = new_figure(DOUBLE, 3.6)
    left, right = figure.subplots(1, 2)
    for i, (name, rows) in enumerate(choices.groupby("decision", sort=False)):
        left.plot(rows["radial_distance_mm"], rows["farther"], **look(i), label=name)
    left.axvline(choices["standard_mm"].iloc[0], color="0.6", linewidth=0.8, label="standard")
    left.set(xlabel="Radial distance (mm)", ylabel='answers "farther" or "go"', ylim=(0, 1))
    legend_above(left, 2)
    for i, (name, rows) in enumerate(powers.groupby("question", sort=False)):
        least = rows.loc[rows.groupby("trials")["power"].idxmin()]
        ends = [least["power"] - least["lower"], least["upper"] - least["power"]]
        right.errorbar(least["trials"], least["power"], ends, **mark(i) | look(i), label=name)
    right.axhline(powers["goal"].iloc[0], color="0.6", linewidth=0.8, linestyle=":", label="goal")
    right.set(xlabel="Trials of each comparison", ylabel="power", xscale="log", ylim=(0, 1))
    sizes = np.unique(powers["trials"])
    right.set_xticks(sizes, [f"{size:g}" for size in sizes])
    right.minorticks_off()
    legend_above(right, 2)
    return figure


def _outcome_looks() -> dict[str, dict[str, Any]]:
    """A colour and hatch for every outcome there is, whichever a chart happens to show."""
    names = [outcome.message.split(":")[0] for outcome in Outcome]
    return {
        name: {
            "facecolor": COLOURS[i % len(COLOURS)],
            "alpha": 0.45 if i else 0.9,
            "hatch": (None, "//", "..")[i // len(COLOURS)],
        }
        for i, name in enumerate(names)
    }


@styled
def cue_outcomes(table: pd.DataFrame) -> Figure:
    """The share of readings of which each cue makes a distance, and the names of what else.

    Parameters
    ----------
    table : DataFrame
        From `surveys.outcomes`.
    """
    groups = list(table.groupby("cue", sort=False))
    looks = _outcome_looks()
    count = -(-len(groups) // 2)
    figure = new_figure(DOUBLE, 1.2 * count + 0.8)
    axes = figure.subplots(count, 2, sharex=True, sharey=True).ravel()
    for ax in axes[len(groups) :]:
        ax.set_axis_off()
    for ax in axes[max(len(groups) - 2, 0) : len(groups)]:  # the last of each column
        ax.tick_params(labelbottom=True)
    for ax, (cue, rows) in zip(axes, groups, strict=False):
        below = np.zeros(rows["place"].nunique())
        for name, part in rows.groupby("outcome", sort=False):
            place, share = part["place"].to_numpy(), part["share"].to_numpy()
            ax.fill_between(place, below, below + share, step="mid", **looks[str(name)])
            below = below + share
        ax.set(title=cue, xlim=(place[0], place[-1]), ylim=(0, 1))
    for name, fill in looks.items():
        if (table["outcome"] == name).any():
            label = "distance found" if name == _WORKS else name
            axes[0].fill_between([], [], label=label, **fill)
    legend_over(figure, axes[:1], 5)
    figure.supxlabel("Radial distance r/L")
    figure.supylabel("share of readings")
    return figure


@styled
def best_cue(table: pd.DataFrame, names: Sequence[str]) -> Figure:
    """The best cue as a map over (r, θ_d), and what becomes of contacts beyond.

    Parameters
    ----------
    table : DataFrame
        From `surveys.best`.
    names : sequence of str
        Of the cues in question.
    """
    figure = new_figure(SINGLE * 1.4, 3.6)
    ax = figure.subplots()
    shown = [name for name in names if (table["best"] == name).any()]
    which = table.pivot(index="place", columns="share", values="best").map(shown.index)
    ends = table.drop_duplicates("place").sort_values("place")
    place, limit = ends["place"].to_numpy(), ends["limit_deg"].to_numpy()
    # The table's contacts are the middles of cells in r and in the share of the largest angle.
    r, share = _edges(place), _edges(which.columns.to_numpy())
    colours = [COLOURS[list(names).index(name)] for name in shown]
    ax.pcolormesh(
        np.broadcast_to(r[:, None], (r.size, share.size)),
        np.interp(r, place, limit)[:, None] * share,
        which.to_numpy(),
        cmap=ListedColormap(colours), vmin=-0.5, vmax=len(shown) - 0.5, rasterized=True,
    )  # fmt: skip
    for name, colour in zip(shown, colours, strict=True):
        ax.fill_between([], [], color=colour, label=name)
    ax.plot(place, limit, color="black", linewidth=1.2)
    top = 1.25 * limit.max()
    for i, (outcome, rows) in enumerate(ends.groupby("beyond", sort=False)):
        half = (place[1] - place[0]) / 2
        low, high = rows["place"].min() - half, min(rows["place"].max() + half, 1.0)
        x = np.linspace(low, high, 50)
        shade: Any = {"facecolor": "none", "edgecolor": "0.75", "hatch": ("//", "..")[i % 2]}
        ax.fill_between(x, np.interp(x, place, limit), top, **shade)
        side = "right" if low > 0.8 else "center"
        at = high if side == "right" else (low + high) / 2
        box = {"facecolor": "white", "pad": 1}
        ax.text(at, top * (0.93 - 0.1 * i), str(outcome), ha=side, va="center", bbox=box)
    ax.set(xlabel="Radial distance r/L", ylabel="Deflection angle θ$_d$ (degrees)")
    ax.set(xlim=(0, 1), ylim=(0, top))
    legend_over(figure, [ax], 2)
    return figure


def _edges(middles: np.ndarray) -> np.ndarray:
    """Edges of even cells, from their middles; between 0 and 1."""
    half = (middles[1] - middles[0]) / 2
    return np.clip(np.append(middles - half, middles[-1] + half), 1e-3, 1.0)


@styled
def ridge(table: pd.DataFrame, contact: tuple[float, float]) -> Figure:
    """A pair plot of distance and angle for either whisker, and the contact (m, rad).

    Parameters
    ----------
    table : DataFrame
        From `surveys.ridge`.
    contact : (float, float)
    """
    figure = new_figure(SINGLE * 1.4, SINGLE * 1.4)
    grid = figure.add_gridspec(2, 2, width_ratios=(3, 1), height_ratios=(1, 3))
    ax = figure.add_subplot(grid[1, 0])
    above = figure.add_subplot(grid[0, 0], sharex=ax)
    beside = figure.add_subplot(grid[1, 1], sharey=ax)
    for i, (name, rows) in enumerate(table.groupby("whisker", sort=False)):
        x, y = rows["radial_distance_mm"], rows["deflection_angle_deg"]
        label = f"{name}: {rows['status'].iloc[0]}"
        ax.plot(x, y, ".", markersize=1.5, alpha=0.5, color=COLOURS[i], label=label)
        outline: Any = {"histtype": "step", "color": COLOURS[i], "linewidth": 1}
        above.hist(x, 40, density=True, **outline)
        beside.hist(y, 40, density=True, orientation="horizontal", **outline)
    ax.plot(contact[0] * 1e3, np.degrees(contact[1]), "k+", markersize=10, label="contact")
    ax.set(xlabel="Radial distance (mm)", ylabel="Deflection angle θ$_d$ (degrees)")
    ax.legend()
    above.tick_params(labelbottom=False)
    beside.tick_params(labelleft=False)
    above.set(ylabel="density", yticks=[])
    beside.set(xlabel="density", xticks=[])
    return figure


@styled
def cue_information(table: pd.DataFrame) -> Figure:
    """Bars of what each cue tells alone and what it adds.

    Parameters
    ----------
    table : DataFrame
        From `surveys.bits`.
    """
    figure = new_figure(DOUBLE / 1.4, 2.4)
    ax = figure.subplots()
    places = np.arange(len(table))[::-1]
    for i, (shift, column) in enumerate(((0.2, "alone"), (-0.2, "added"))):
        rows = table if column == "alone" else table.iloc[:-1]
        error = rows[f"{column}_error_bits"]
        heights = places[: len(rows)] + shift * (places[: len(rows)] > 0)  # the last has one bar
        label = f"{column}, ± 1 SE" if i == 0 else "added to the other two, ± 1 SE"
        ax.barh(heights, rows[f"{column}_bits"], 0.38, xerr=error, label=label, color=COLOURS[i])
    ax.set_yticks(places, table["cue"])
    ax.set_xlabel("information about radial distance (bits)")
    legend_above(ax)
    return figure


@styled
def weber_2d(
    surfaces: Mapping[str, pd.DataFrame],
    false_zero: pd.DataFrame,
    linear: pd.DataFrame,
    *,
    length: float,
    weber_fraction: float,
) -> Figure:
    """JNDs of three pairs of noises as surfaces, and a false zero beside posteriors.

    With noise in one signal alone the linear JND has a false zero: in the axial force where the
    moment no longer grows with the angle, in the moment where the axial force no longer does.

    Parameters
    ----------
    surfaces : mapping of title to DataFrame
        From `surveys.surface`.
    false_zero, linear : DataFrame
        From the functions of these names in `surveys` (`linear_between`).
    length, weber_fraction : float
        JNDs are shown over their product; m.
    """
    figure = new_figure(DOUBLE, 5.6)
    *axes, last = figure.subplots(2, 2).ravel()
    for ax, (title, table) in zip(axes, surfaces.items(), strict=True):
        fill_surface(ax, table, length, weber_fraction)
        ax.set_title(title)
    legend_over(figure, axes, 3)
    scale = 1e3 * weber_fraction * length
    angle = linear["deflection_angle_deg"]
    last.semilogy(angle, linear["linear_jnd_mm"] / scale, color=COLOURS[0], label="linear")
    found, error = (false_zero[f"posterior{name}_mm"] / scale for name in ("", "_error"))
    dots: Any = {"marker": "o", "markersize": 4, "capsize": 0, "label": "posterior, 95 %"}
    errors(last, false_zero["deflection_angle_deg"], found, error, 1, **dots)
    last.set(
        xlabel="Deflection angle θ$_d$ (degrees)", ylabel="JND/(kL), d'=1", ylim=(1e-4, 1),
        title="axial force noise alone, at 0.7 L: its false zero",
    )  # fmt: skip
    last.legend()
    return figure
