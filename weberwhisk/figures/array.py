"""The array of whiskers from above, and what it tells of an object's place."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes

from .style import COLOURS, DOUBLE, LINES, axes_or_new, styled

if TYPE_CHECKING:
    from ..array import Follicle, WhiskerArray


@styled
def whisker_array(array: WhiskerArray, ax: Axes | None = None) -> Axes:
    """Whiskers from above, a colour and line style for each row; mm."""
    ax = axes_or_new(ax, DOUBLE, 2.6)
    for row, (colour, line) in enumerate(zip(COLOURS, [*LINES, "-"], strict=False)):
        mine = [w for w in array.whiskers.values() if w.identity[0] == "ABCDE"[row]]
        for i, whisker in enumerate(mine):
            label = f"row {whisker.identity[0]}" if i == 0 else None
            ax.plot(*_from_above(whisker), color=colour, linestyle=line, linewidth=0.9, label=label)
    ax.plot(*(1e3 * np.array([w.base[:2] for w in array.whiskers.values()])).T, "k.", markersize=2)
    ax.set(aspect="equal", xlabel="to the right (mm)", ylabel="rostral (mm)")
    ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.01), ncols=5, handlelength=2.4)
    return ax


def _from_above(whisker: Follicle) -> tuple[np.ndarray, np.ndarray]:
    """x and y, mm, along a whisker at rest in its plane of whisking."""
    law, straight = getattr(whisker.whisker, "law", None), whisker.whisker
    arc = np.linspace(0.0, getattr(straight, "whisker", straight).length, 40)
    # Curvature is positive away from the object, at positive angles of deflection backwards.
    along, across = (arc, 0 * arc) if law is None else law.point(arc)
    x, y = 1e3 * whisker.place(np.hypot(along, across), np.arctan2(across, along)).T
    return x, y
