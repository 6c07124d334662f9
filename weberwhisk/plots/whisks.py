"""An array of whiskers, and the place of an object that some of them touch."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes

from .style import COLOURS, DOUBLE, LINES, SINGLE, axes_or_new, legend_above, styled

if TYPE_CHECKING:
    from ..array import Follicle, Place, WhiskerArray

__all__ = ["from_above", "place", "whisker_array"]


@styled
def whisker_array(array: WhiskerArray, ax: Axes | None = None) -> Axes:
    """Whiskers from above, a colour and line style for each row; mm."""
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
    """x and y, mm, along a whisker at rest in its plane of whisking."""
    law, straight = getattr(whisker.whisker, "law", None), whisker.whisker
    arc = np.linspace(0.0, getattr(straight, "whisker", straight).length, 40)
    # Curvature is positive away from the object, at positive angles of deflection backwards.
    along, across = (arc, 0 * arc) if law is None else law.point(arc)
    x, y = 1e3 * whisker.place(np.hypot(along, across), np.arctan2(across, along)).T
    return x, y


@styled
def place(found: Place, ax: Axes | None = None) -> Axes:
    """The region that holds an object with probability 95 %, its error ellipse, the whiskers.

    Whiskers that touch are drawn thick, as they lie where nothing bends them.
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
    ax.set(
        xlim=((left + right) / 2 - room, (left + right) / 2 + room),
        ylim=((low + high) / 2 - room, (low + high) / 2 + room),
        aspect="equal",
        xlabel="to the right (mm)",
        ylabel="rostral (mm)",
    )
    return legend_above(ax)
