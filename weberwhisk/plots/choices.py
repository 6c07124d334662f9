"""Choices and the psychometric functions fitted to them, of one observer and of a population."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray
from scipy.special import betaincinv

from .._util import checks
from .._util.refusals import Refusal
from .._util.values import Array, Flags, Index, plain_number
from .fits import height_of, shrinkage
from .style import (
    COLOURS,
    DOUBLE,
    SINGLE,
    bars,
    drawable,
    legend_above,
    legend_over,
    log_numbers,
    look,
    mark,
    open_figure,
    plain_numbers,
    styled,
)

if TYPE_CHECKING:
    from ..behaviour import PopulationFit, WeberFit
    from ..behaviour.trials import Cells

__all__ = ["binomial_interval", "population", "psychometrics"]

#: More different stimuli than this at a standard are drawn in bins, of measured places 20.
MOST_LEVELS = 40
#: More standards than this are drawn in groups.
MOST_STANDARDS = 12
#: More animals than this are drawn without a colour of their own.
MOST_ANIMALS = 12


@styled
def psychometrics(
    fit: WeberFit, axes: Axes | Sequence[Axes] | None = None, *, standard: float | None = None,
    unit: str = "",
) -> NDArray[np.object_]:  # fmt: skip
    """Plot choices at each standard with 95 % binomial intervals, and the fitted curve.

    More than 40 different stimuli at a standard are drawn in 20 bins with as many trials each, and
    more than 12 standards in four groups, against the ratio of the stimuli; so are all choices in
    one where it is not known which stimuli are standards.

    Parameters
    ----------
    fit : WeberFit
    axes : Axes or sequence of Axes, optional
        One per standard, or per group of standards.
    standard : float, optional
        The only standard to draw; by default all.
    unit : str
        Unit of the stimulus, for the axis label; by default that of an encoding of distances.

    Returns
    -------
    array of Axes

    Raises
    ------
    ValueError
        For fewer axes than standards, and a standard without choices.

    Notes
    -----
    The curve is for a first stimulus at the standard. Choices with another first stimulus are drawn
    at the second one that is as easy to tell from the standard: of equal d′ under the fit, and so
    of a magnitude with Weber noise at the same ratio (on a log scale, the same difference). The
    curve of a group of standards is what the fit expects of the choices in each bin.

    Examples
    --------
    >>> from weberwhisk import fit_weber, simulate_trials
    >>> axes = psychometrics(fit_weber(simulate_trials(weber_fraction=0.1, seed=7)))
    >>> axes[0].get_title(), len(axes)
    ('', 1)
    """
    given = None if axes is None else np.array(axes, dtype=object).ravel()
    panels = _panels(fit, standard, 4 if given is None else len(given), unit)
    count, in_groups = len(panels), standard is None and _grouped(len(fit.standards))
    label = _stimulus_label(fit, unit, in_groups)
    if given is not None:
        if len(given) < count:
            raise Refusal(
                f"There are {count} standards and {len(given)} axes",
                remedy=f"name one, such as standard={fit.standards[0]:g}, or give more",
            )
        for ax, panel in zip(given, panels, strict=False):
            panel.draw(ax)
            ax.set(xlabel=label, ylabel=_answer_label(fit))
            legend_above(ax)
        return given[:count]
    columns = max(min(count, 4), 1)
    panel_rows = max(-(-count // columns), 1)
    width = SINGLE if columns == 1 else DOUBLE * columns / 4
    figure = open_figure(width, 0.9 + 1.55 * panel_rows if panel_rows > 1 else 2.6)
    sharing: Any = {"sharey": True, "sharex": _relative(fit) or in_groups, "squeeze": False}
    drawn = figure.subplots(panel_rows, columns, **sharing).ravel()
    for spare in drawn[count:]:
        spare.set_visible(False)
    for ax, panel in zip(drawn, panels, strict=False):
        panel.draw(ax)
        if count > 1:
            ax.set_title(panel.title)
    figure.supxlabel(label)
    figure.supylabel(_answer_label(fit))
    legend_over(figure, drawn[:1], 3)
    return drawn[:count]


@dataclass(frozen=True)
class _Panel:
    """What one axes shows."""

    title: str
    draw: Callable[[Axes], None]


def _standard_title(fit: WeberFit, standard: float, unit: str = "") -> str:
    unit = drawable(unit or fit.stimulus_unit)
    return f"standard {plain_number(standard)}{f' {unit}' if unit else ''}"


def _panels(fit: WeberFit, standard: float | None, most: int, unit: str = "") -> list[_Panel]:
    """A panel for each standard, or for groups of them with as many trials each."""
    standards = fit.standards if standard is None else np.array([float(standard)])
    if not _grouped(len(standards)):
        return [
            _Panel(_standard_title(fit, float(s), unit), partial(_choices, fit, standard=float(s)))
            for s in standards
        ]
    cells = fit.model.cells
    group = _bins(cells.standard, cells.n, min(most, 4) if len(standards) else 1)
    panels = []
    for i in range(group.max(initial=-1) + 1):
        part = group == i
        low, high = cells.standard[part].min(), cells.standard[part].max()
        title = f"standards {plain_number(low, 3)} to {plain_number(high, 3)}"
        panels.append(_Panel(title, partial(_group, fit, part=part)))
    return panels


def _grouped(standards: int) -> bool:
    """Whether so many standards, or none that are known, are drawn together."""
    return standards == 0 or standards > MOST_STANDARDS


# -- the axes --------------------------------------------------------------------------------------


def _relative(fit: WeberFit) -> bool:
    """Whether the horizontal axis is a difference of stimuli, as on a log scale."""
    return bool(fit.trials.scale == "log")


def _stimulus_label(fit: WeberFit, unit: str, in_groups: bool = False) -> str:
    """What is on the horizontal axis, by the names of the table that was read."""
    unit = unit or fit.stimulus_unit
    counted = f" ({drawable(unit)})" if unit else ""
    one = fit.trials.task.name in ("yes/no", "go/no-go")
    first = _own_name(fit, ("stimulus_1", "standard"), "standard" if one else "first")
    second = _own_name(fit, ("stimulus_2", "comparison"), "Stimulus" if one else "Second stimulus")
    cells = fit.trials.cells()
    if _relative(fit):
        logarithms = {1.0: " (natural logarithm)", None: " (units of the log column)"}
        log_unit = fit.trials.log_unit
        counted = counted or logarithms.get(log_unit, f" (in {log_unit} natural-log units)")
        if not cells.stimulus_1.any():  # the table has the difference alone
            return f"{_own_name(fit, ('log_ratio',), 'log_ratio, second/first')}{counted}"
        return f"{second} − {first}{counted}"
    if in_groups:
        return f"{second} / {first}"
    if np.allclose(cells.stimulus_1, cells.standard):
        return f"{second}{counted}"
    if _by_ratio(fit):
        return f"{second} × standard / {first}{counted}"
    return f"{second} of equal d′{counted}"


def _by_ratio(fit: WeberFit) -> bool:
    """Whether two pairs at the same ratio are as easy to tell apart."""
    from ..behaviour.encodings import IdentityEncoding

    return isinstance(fit.encoding, IdentityEncoding) and fit.noise == "weber" and not fit.effects


def _answer_label(fit: WeberFit) -> str:
    task = fit.trials.task
    if task.response == "correct":
        words = "Proportion correct"
    elif task.bias_name == "criterion":
        words = f"Proportion of {task.answer}"
    else:
        words = "Second reported greater"
    column = _own_name(fit, ("choice", "n_greater", "correct", "n_correct"), "")
    return f"{column}: {words[0].lower()}{words[1:]}" if column else words


def _own_name(fit: WeberFit, columns: Sequence[str], otherwise: str) -> str:
    """The name, in the table that was read, of the first of these columns that it has."""
    names = fit.trials.frame.attrs.get("columns", {})
    return next((drawable(names[column]) for column in columns if column in names), otherwise)


# -- what is on them -------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Points:
    """Choices at places of the horizontal axis, (P,): `count` of `n` had the answer."""

    x: Array
    n: Array
    count: Array

    def gathered(self, group: Index) -> _Points:
        """The same in groups (P,), each at the mean place of its trials."""
        n, count, total = (
            np.bincount(group, a).astype(float) for a in (self.n, self.count, self.n * self.x)
        )
        return _Points(total / n, n, count)

    def binned(self, most: int, bins: int = 20) -> _Points:
        """In bins with as many trials each, where there are more places than that."""
        if np.unique(self.x).size <= most or self.x.size == 0:
            return self
        return self.gathered(_bins(self.x, self.n, bins))


def _bins(x: Array, n: Array, bins: int) -> Index:
    """Which of so many bins, of as many trials each, a place is in; equal ones share theirs."""
    # The same ratio of other stimuli differs in its last digits.
    size = np.abs(x).max(initial=0.0) or 1.0
    places, which = np.unique(np.round(x / size, 9), return_inverse=True)
    weight = np.bincount(which.ravel(), n, places.size)
    middle = (np.cumsum(weight) - weight / 2) / weight.sum()
    _, rank = np.unique(np.floor(middle * bins), return_inverse=True)
    return np.asarray(rank.ravel()[which.ravel()], dtype=np.intp)


def _shown_at(fit: WeberFit, standard: float) -> tuple[Array, Cells]:
    """Positions on the axis of the choices at a standard, and their counts."""
    every = fit.trials.cells()
    if not fit.trials.has_standards:
        return _beside(fit, every, standard), every
    if every.standard.size and not np.isclose(every.standard, standard).any():
        raise Refusal(
            f"standard {standard:g} has no answers to draw",
            remedy=f"choose one of {checks.listed(fit.standards)}",
        )
    cells = every.of(float(every.standard[np.argmin(np.abs(every.standard - standard))]))
    return _beside(fit, cells, standard), cells


def _beside(fit: WeberFit, cells: Cells, standard: float) -> Array:
    """The second stimulus that is as easy to tell from the standard as those of each cell."""
    first, second = cells.stimulus_1, cells.stimulus_2
    if _relative(fit):
        return second - first
    at_ratio = standard * second / first
    moved = ~np.isclose(first, standard)
    if _by_ratio(fit) or not moved.any():
        return at_ratio
    low, high = fit.encoding.domain
    reach = np.abs(np.r_[second, at_ratio, first] - standard).max()
    ends = np.clip([standard - 3 * reach, standard + 3 * reach], low, high)
    inset = 1e-6 * (ends[1] - ends[0])
    places = np.linspace(ends[0] + inset, ends[1] - inset, 2001)
    rising = np.maximum.accumulate(_decided(fit, np.full(places.size, standard), places, standard))
    with np.errstate(invalid="ignore"):
        found = np.interp(_decided(fit, first, second, cells.standard), rising, places)
    return np.where(moved, found, second)


def _decided(fit: WeberFit, first: Array, second: Array, standard: Array | float) -> Array:
    """d′ of pairs under the fit, at the medians of its parameters and without response bias."""
    from ..behaviour.encodings import unit_encodings

    model = fit.model
    signals = unit_encodings(fit.encoding, first, second, standard, fit.noise).encoded(
        np.float64(fit.weber_fraction)
    )
    for effect in model.effects:
        free = effect.name in fit.parameters
        value = fit.posterior.quantile(effect.name, 0.5) if free else model.fixed_value(effect.name)
        signals = effect.apply(signals, np.asarray(value, dtype=float), 0.0)
    gap = signals.mean_2 - signals.mean_1
    return np.asarray(gap / model.task.decision_sd(signals) + signals.shift)


def _choices(fit: WeberFit, ax: Axes, standard: float) -> None:
    x, cells = _shown_at(fit, standard)
    origin = standard if _relative(fit) else 0.0
    if x.size:
        reach = [min(x.min(), standard - origin), max(x.max(), standard - origin)]
        margin = 0.08 * (reach[1] - reach[0]) or 0.1 * abs(standard) or 0.1
        lowest, highest = fit.encoding.domain  # may be infinite
        edges = np.array([reach[0] - margin, reach[1] + margin]) + origin
        edges = np.clip(edges, lowest + 1e-6 * margin, highest - 1e-6 * margin)
        curve = fit.psychometric(np.linspace(edges[0], edges[1], 121), standard)
        ends = (curve[name].to_numpy() for name in ("lower", "median", "upper"))
        _fitted(fit, ax, curve["comparison"].to_numpy() - origin, *ends)
    # Located distances differ from trial to trial.
    most, bins = (20, 10) if cells.sd_1 is not None else (MOST_LEVELS, 20)
    _marked(ax, _Points(x, cells.n, cells.count), most, bins)
    ax.axvline(standard - origin, color="0.7", linewidth=0.8, zorder=0, label="standard")


def _group(fit: WeberFit, ax: Axes, part: Flags) -> None:
    """Draw choices at many standards, and what the fit expects of them, bin by bin."""
    cells = fit.model.cells
    first, second = cells.stimulus_1[part], cells.stimulus_2[part]
    points = _Points(
        second - first if _relative(fit) else second / first, cells.n[part], cells.count[part]
    )
    group = _bins(points.x, points.n, 20)
    p = fit.model.expected(fit.posterior.draws().thinned(200))[0][:, part] * points.n
    expected = np.array([np.bincount(group, row) for row in p]) / np.bincount(group, points.n)
    low, middle, high = np.quantile(expected, [0.025, 0.5, 0.975], axis=0)
    binned = points.gathered(group)
    _fitted(fit, ax, binned.x, low, middle, high)
    _marked(ax, binned, 0, label="choices in bins, 95 %")
    equal = 0.0 if _relative(fit) else 1.0
    ax.axvline(equal, color="0.7", linewidth=0.8, zorder=0, label="equal stimuli")


def _fitted(fit: WeberFit, ax: Axes, x: Array, low: Array, middle: Array, high: Array) -> None:
    # With every parameter given there is a curve but no band.
    drawn = "fit" if fit.model.n_states == 1 else "engaged"
    band, line = (f"{drawn}, 95 %", None) if fit.parameters else (None, "given parameters")
    ax.fill_between(x, low, high, color=COLOURS[4], alpha=0.35, label=band)
    ax.plot(x, middle, color=COLOURS[0], label=line)


def _marked(ax: Axes, points: _Points, most: int, bins: int = 0, label: str = "") -> None:
    shown = points.binned(most, bins) if bins else points
    share = shown.count / shown.n
    low, high = binomial_interval(shown.count, shown.n)
    words = label or ("choices, 95 %" if shown is points else "choices in bins, 95 %")
    bars(ax, shown.x, (share, low, high), 0, color=COLOURS[6], label=words, markersize=4)
    ax.set_ylim(-0.03, 1.03)
    plain_numbers(ax.xaxis)


def binomial_interval(count: Array, n: Array) -> tuple[Array, Array]:
    """Jeffreys' 95 % interval of a proportion; it reaches 0 or 1 where count is 0 or n."""
    low = np.where(count == 0, 0.0, betaincinv(count + 0.5, n - count + 0.5, 0.025))
    high = np.where(count == n, 1.0, betaincinv(count + 0.5, n - count + 0.5, 0.975))
    # Rounding must not make the length of an error bar negative.
    return np.minimum(low, count / n), np.maximum(high, count / n)


# -- populations -----------------------------------------------------------------------------------


@styled
def population(
    fit: PopulationFit, ax: Axes | None = None, *, unit: str = ""
) -> Axes | NDArray[np.object_]:
    """Plot every animal's choices and curve at up to three standards, and `shrinkage`.

    Curves are fitted to each animal alone. Of more than 12 animals the choices are drawn together,
    and the median of their curves. Of more than 12 standards there is one panel, in which every
    curve is that at the animal's middle standard. With a given `ax` only `shrinkage` is drawn.

    Examples
    --------
    >>> from weberwhisk import fit_population, simulate_population
    >>> trials, _ = simulate_population(2, trials_per_level=6, seed=1)
    >>> axes = population(fit_population(trials, bias="none"))
    >>> axes[0].get_ylabel(), axes[-1].get_xlabel()
    ('Second reported greater', 'Weber fraction')
    """
    fits = {animal: one for animal, one in fit.fits.items() if one.parameters}
    if ax is not None or not fits:
        return shrinkage(fit, ax)
    standards = np.unique(np.concatenate([one.standards for one in fits.values()]))
    in_groups = _grouped(standards.size)
    places: list[float | None] = [None]
    if not in_groups:
        all_shown = standards.size <= 3
        places = [*standards] if all_shown else [*standards[[0, standards.size // 2, -1]]]
    figure = open_figure(DOUBLE, max(2.9, height_of(len(fits)) + 0.6))
    grid = figure.add_gridspec(1, len(places) + 1, width_ratios=[1.0] * len(places) + [1.2])
    axes: list[Axes] = []
    for i, standard in enumerate(places):
        axes.append(figure.add_subplot(grid[i], sharey=axes[0] if axes else None))
        here = {
            animal: one for animal, one in fits.items()
            if standard is None or np.isclose(one.standards, standard).any()
        }  # fmt: skip
        one = next(iter(here.values()))
        if len(fits) <= MOST_ANIMALS:
            for number, (animal, each) in enumerate(here.items()):
                _animal(each, axes[-1], standard, number, f"{drawable(str(animal))}, alone")
        else:
            _animals([*here.values()], axes[-1], standard)
        title = "all standards" if standard is None else _standard_title(one, standard, unit)
        axes[-1].set(title=title, ylim=(-0.03, 1.03))
        plain_numbers(axes[-1].xaxis, most=4)
        axes[-1].set_xlabel(_stimulus_label(one, unit, in_groups))
    axes[0].set_ylabel(_answer_label(one))
    legend_over(figure, axes, 6)
    axes.append(shrinkage(fit, figure.add_subplot(grid[-1])))
    log_numbers(axes[-1].xaxis, narrow=len(places) > 1)
    return np.array(axes, dtype=object)


def _of_animal(fit: WeberFit, standard: float | None) -> _Points:
    """An animal's choices at a standard, or at all of them."""
    if standard is not None:
        x, cells = _shown_at(fit, standard)
    else:
        cells = fit.trials.cells()
        first, second = cells.stimulus_1, cells.stimulus_2
        x = second - first if _relative(fit) else second / first
    return _Points(x, cells.n, cells.count)


def _curve(fit: WeberFit, standard: float | None, x: Array) -> Array:
    """The median curve at places of the axis; at the middle standard where all are drawn."""
    standards = fit.standards if fit.standards.size else fit.model.cells.standard
    s = float(np.quantile(standards, 0.5, method="nearest")) if standard is None else standard
    comparison = x if standard is not None else s * x
    low, high = fit.encoding.domain
    comparison = np.clip(x + s if _relative(fit) else comparison, low, high)
    return fit.psychometric(comparison, s)["median"].to_numpy()


def _animal(fit: WeberFit, ax: Axes, standard: float | None, i: int, name: str) -> None:
    """Draw one animal's proportions, and the median curve of its own fit."""
    points = _of_animal(fit, standard)
    x = np.linspace(points.x.min(), points.x.max(), 81)
    shown = points.binned(MOST_LEVELS)
    ax.plot(shown.x, shown.count / shown.n, **mark(i))
    ax.plot(x, _curve(fit, standard, x), **look(i, linewidth=1.0), label=name)


def _animals(fits: Sequence[WeberFit], ax: Axes, standard: float | None) -> None:
    """Draw the curve of each of many animals, their median, and all their choices together."""
    points = [_of_animal(fit, standard) for fit in fits]
    every = _Points(*(np.concatenate([getattr(p, n) for p in points]) for n in ("x", "n", "count")))
    _, which = np.unique(every.x, return_inverse=True)
    shown = every.gathered(which.ravel()).binned(MOST_LEVELS)
    x = np.linspace(every.x.min(), every.x.max(), 81)
    curves = np.array([_curve(fit, standard, x) for fit in fits])
    for i, curve in enumerate(curves):
        label = "an animal, alone" if i == 0 else None
        ax.plot(x, curve, color=COLOURS[4], linewidth=0.5, alpha=0.6, label=label)
    ax.plot(x, np.median(curves, axis=0), color=COLOURS[0], label="median of the animals")
    ax.plot(shown.x, shown.count / shown.n, **mark(6, markersize=3.5), label="all their choices")
