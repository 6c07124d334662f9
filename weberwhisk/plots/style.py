"""The style of every figure: colours, markers, sizes, and reproducible files."""

from __future__ import annotations

import io
import sys
from collections.abc import Callable, Iterable
from contextvars import ContextVar
from functools import wraps
from typing import Any, ParamSpec, TypeVar

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties, findfont, get_font
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter

from .._util.values import plain_number

__all__ = [
    "COLOURS", "DOUBLE", "LINES", "MARKERS", "SINGLE", "SMALL", "axes_or_new", "bars", "drawable",
    "errors", "figure_of", "legend_above", "legend_over", "log_numbers", "look", "mark",
    "new_figure", "open_figure", "plain_numbers", "shown", "styled",
]  # fmt: skip

#: Okabe and Ito's colours, dark ones first.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000")
LINES = ("-", "--", "-.", ":")
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
#: Widths of a printed column and of two, inches.
SINGLE, DOUBLE = 3.5, 7.2
_STYLE: Any = {
    "font.size": 8, "axes.titlesize": 8, "figure.labelsize": 8, "legend.fontsize": 7.0,
    "legend.frameon": False, "axes.spines.top": False, "axes.spines.right": False,
    "patch.linewidth": 0, "lines.linewidth": 1.3, "lines.markersize": 4,
}  # fmt: skip
SMALL: float = _STYLE["legend.fontsize"]  # the smallest size of text, points

P = ParamSpec("P")
R = TypeVar("R")


def styled(draw: Callable[P, R]) -> Callable[P, R]:
    """Draw in this module's style without changing the user's."""

    @wraps(draw)
    def drawn(*arguments: P.args, **options: P.kwargs) -> R:
        if _is_shown():
            from matplotlib import pyplot

            pyplot.draw_if_interactive()  # loads the backend, which sets parameters of its own
        with matplotlib.rc_context(_STYLE):
            return draw(*arguments, **options)

    return drawn


def drawable(name: object, longest: int = 24) -> str:
    """A name as the font can draw it: unknown characters escaped, no formula, cut if long."""
    font = get_font(findfont(FontProperties()))
    glyphs = font.get_charmap()
    text = "".join(
        c if ord(c) in glyphs and c.isprintable() else c.encode("unicode_escape").decode()
        for c in str(name)
    )
    text = text if len(text) <= longest else f"{text[: longest - 1]}…"
    return text.replace("$", r"\$")


class _Figure(Figure):
    """A figure that keeps its style wherever it is drawn, and shows itself in a notebook."""

    def draw(self, renderer: Any) -> None:
        with matplotlib.rc_context(_STYLE):  # ticks are only made here
            super().draw(renderer)

    def savefig(self, fname: Any, **options: Any) -> None:
        with matplotlib.rc_context(_STYLE | {"svg.hashsalt": "weberwhisk"}):  # same file each time
            super().savefig(fname, **options)

    def _repr_png_(self) -> bytes:
        content = io.BytesIO()
        self.savefig(content, format="png")
        return content.getvalue()

    def _ipython_display_(self) -> None:
        """Show the figure once, although `pyplot` would show it again at the end of the cell."""
        from IPython.display import Image, display
        from matplotlib import pyplot

        width = round(self.get_figwidth() * 110)
        display(Image(self._repr_png_(), format="png", width=width))
        pyplot.close(self)


def new_figure(width: float = SINGLE, height: float = 2.8) -> Figure:
    """An empty figure in this module's style, size in inches, unknown to `pyplot`."""
    return _Figure(figsize=(width, height), dpi=200, layout="constrained")


#: Whether new figures are shown by `pyplot`; see `shown`.
_SHOWING: ContextVar[bool] = ContextVar("showing", default=False)


def _is_shown() -> bool:
    ipython = sys.modules.get("IPython")
    return _SHOWING.get() or (ipython is not None and ipython.get_ipython() is not None)


def open_figure(width: float = SINGLE, height: float = 2.8) -> Figure:
    """As `new_figure`; in a notebook, or when drawn by `.plot()`, `pyplot` shows the figure."""
    if not _is_shown():
        return new_figure(width, height)
    from matplotlib import pyplot

    size = width, height
    return pyplot.figure(FigureClass=_Figure, figsize=size, dpi=200, layout="constrained")


def shown(draw: Callable[..., Any], result: object, ax: object, options: dict[str, Any]) -> Figure:
    """The figure of a result, for its `.plot()`: drawn by one of this package's functions."""
    token = _SHOWING.set(True)
    try:
        return figure_of(draw(result, ax, **options))
    finally:
        _SHOWING.reset(token)


def look(i: int, **more: Any) -> dict[str, Any]:
    """Colour and line style of the i-th line."""
    return {"color": COLOURS[i % len(COLOURS)], "linestyle": LINES[i % len(LINES)], **more}


def mark(i: int, **more: Any) -> dict[str, Any]:
    """Colour and marker of the i-th series, small and without a line."""
    style = {"color": COLOURS[i % len(COLOURS)], "marker": MARKERS[i % len(MARKERS)]}
    return {**style, "markersize": 3, "linestyle": "none", **more}


def bars(ax: Axes, x: Any, ends: Iterable[Any], i: int, **more: Any) -> None:
    """Markers of the i-th series with error bars; `ends` are heights, lower and upper ends."""
    middle, low, high = (np.asarray(v, dtype=float) for v in ends)
    # Lists: some versions of Matplotlib read a single row of an array as a number.
    length = [np.maximum(middle - low, 0).tolist(), np.maximum(high - middle, 0).tolist()]
    ax.errorbar(x, middle, length, **mark(i, capsize=2, elinewidth=1) | more)


def errors(ax: Axes, x: Any, y: Any, error: Any, i: int, **more: Any) -> None:
    """As `bars`, with bars of ±1.96 standard errors."""
    bars(ax, x, (y, y - 1.96 * error, y + 1.96 * error), i, **more)


def log_numbers(*axes: Axis, narrow: bool = False) -> None:
    """Plain numbers on logarithmic axes, spaced to be legible over few or many decades."""
    for axis in axes:
        low, high = axis.get_view_interval()
        decades = np.log10(high / low)
        # Most numbers a decade first, with the most decades that there is room for.
        room: dict[tuple[float, ...], float] = {(1.0, 2.0, 5.0): 1.0 if narrow else 2.5}
        room |= {(1.0, 3.0): 2.0} if narrow else {}
        subs = next((places for places, most in room.items() if decades < most), (1.0,))
        axis.set_major_locator(LogLocator(subs=subs))
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter(NullFormatter())


def plain_numbers(axis: Axis, most: int = 5) -> None:
    """Numbers as people write them, at most so many, and fewer where they are long."""
    locator, (low, high) = MaxNLocator(most), axis.get_view_interval()
    for fewer in range(most, 1, -1):
        locator = MaxNLocator(fewer, min_n_ticks=2)
        longest = max((len(plain_number(v)) for v in locator.tick_values(low, high)), default=0)
        if longest * fewer <= 3.5 * most:
            break
    axis.set_major_locator(locator)
    axis.set_major_formatter(lambda value, _: plain_number(value, 6).replace("-", "−"))


def axes_or_new(ax: Axes | None, width: float = SINGLE, height: float = 2.8) -> Axes:
    if ax is not None:
        return ax
    return open_figure(width, height).subplots()


def figure_of(axes: Any) -> Figure:
    """The figure that axes, or an array of axes, belong to."""
    figure = np.ravel(np.asarray(axes, dtype=object))[0].figure
    assert isinstance(figure, Figure)
    return figure


def legend_above(ax: Axes, columns: int = 2) -> Axes:
    """The axes with a legend above them, clear of the data; no legend without labels."""
    if ax.get_legend_handles_labels()[0]:
        ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.01), ncols=columns)
    return ax


def legend_over(figure: Any, axes: Iterable[Axes], columns: int) -> None:
    """One legend above several axes, with every label once; no legend without labels."""
    entries: dict[str, Any] = {}
    for ax in axes:
        for handle, label in zip(*ax.get_legend_handles_labels(), strict=True):
            entries.setdefault(label, handle)
    if entries:
        names, columns = list(entries), min(columns, len(entries))
        figure.legend(entries.values(), names, loc="outside upper center", ncols=columns)
