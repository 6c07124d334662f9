"""What makes a figure hard to read, found on the drawn figure: small print, overlaps, cut text."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from matplotlib.text import Text
from matplotlib.transforms import Bbox

from weberwhisk.plots import DOUBLE
from weberwhisk.plots.style import SMALL


def faults(figure: Figure) -> list[str]:
    """Text under 7 pt where the figure is printed at most two columns wide, text over text, text
    cut off by the figure's edge, a legend over text or over a line; none in a good figure.
    """
    FigureCanvasAgg(figure)
    figure.draw_without_rendering()
    texts = [text for text in _shown(figure) if text.get_text().strip()]
    boxes = [_core(text) for text in texts]
    named = [text.get_text().replace("\n", "/") for text in texts]
    print_scale = min(1.0, DOUBLE / figure.get_figwidth())
    found = [
        f"{name!r} has {text.get_fontsize() * print_scale:.1f} pt"
        for text, name in zip(texts, named, strict=True)
        if text.get_fontsize() * print_scale < SMALL - 0.05
    ]
    page = figure.bbox.padded(1.0)
    for box, name in zip(boxes, named, strict=True):
        if not (page.x0 <= box.x0 and box.x1 <= page.x1 and page.y0 <= box.y0
                and box.y1 <= page.y1):  # fmt: skip
            found.append(f"{name!r} leaves the figure")
    found += [
        f"{named[i]!r} is over {named[j]!r}"
        for i, j in combinations(range(len(texts)), 2)
        if boxes[i].overlaps(boxes[j])
    ]
    for ax, legend in _legends(figure):
        frame = legend.get_window_extent()
        own = set(legend.findobj(Text))
        found += [
            f"a legend is over {name!r}"
            for text, box, name in zip(texts, boxes, named, strict=True)
            if text not in own and frame.overlaps(box)
        ]
        for line in ax.get_lines() if ax is not None else ():
            path = line.get_transform().transform_path(line.get_path())
            finite = np.isfinite(path.vertices).all(axis=1)
            if not (finite.any() and line.get_visible()):
                continue
            seen = Bbox.intersection(frame, ax.bbox) if line.get_clip_on() else frame
            if seen is None:
                continue
            if _crosses(path.vertices, seen, joined=line.get_linestyle() != "None"):
                found.append(f"a legend of {_title(ax)!r} is over a line")
    return found


def _shown(artist: Any) -> Iterator[Text]:
    """Every text that is drawn: those of hidden axes and of ticks out of view are not."""
    if not artist.get_visible():
        return
    if isinstance(artist, Axes) and not artist.axison:
        children = [*artist.texts, artist.title, artist._left_title, artist._right_title]
    elif hasattr(artist, "_update_ticks"):  # an axis has ticks out of view
        parts = [t for tick in artist._update_ticks() for t in (tick.label1, tick.label2)]
        children = [*parts, artist.label, artist.offsetText]
    else:
        children = artist.get_children()
    if isinstance(artist, Text):
        yield artist
    for child in children:
        yield from _shown(child)


def _core(text: Text) -> Bbox:
    """The box of a text without the blank above and below its letters."""
    box = text.get_window_extent()
    upright = round(text.get_rotation()) % 180 == 0
    turned = round(text.get_rotation()) % 180 == 90
    x, y = 0.02 * box.width, 0.02 * box.height
    blank = 0.18 * text.get_fontsize() * text.figure.dpi / 72  # type: ignore[union-attr]
    if upright:
        y = blank
    elif turned:
        x = blank
    else:  # slanted: its middle
        x, y = 0.3 * box.width, 0.3 * box.height
    return Bbox.from_extents(box.x0 + x, box.y0 + y, box.x1 - x, box.y1 - y)


def _legends(figure: Any) -> Iterator[tuple[Axes | None, Legend]]:
    for legend in figure.findobj(Legend):
        if legend.get_visible():
            yield legend.axes, legend


def _crosses(vertices: Any, frame: Bbox, *, joined: bool) -> bool:
    """Whether marks, or a line also between its vertices, have a point in the box."""
    x, y = np.asarray(vertices, dtype=float).T
    step = np.linspace(0, 1, 20 if joined and x.size > 1 else 1)[:, None]
    along_x = x[:-1] + step * np.diff(x) if joined and x.size > 1 else x
    along_y = y[:-1] + step * np.diff(y) if joined and y.size > 1 else y
    inside = (frame.x0 < along_x) & (along_x < frame.x1)
    return bool((inside & (frame.y0 < along_y) & (along_y < frame.y1)).any())


def _title(ax: Axes | None) -> str:
    return "" if ax is None else ax.get_title() or ax.get_title("left") or ax.get_ylabel()
