"""The signals at the base of a bent whisker."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from .style import COLOURS, DOUBLE, LINES, MARKERS, figure_of, new_figure, styled

if TYPE_CHECKING:
    from ..mechanics import Bending

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


@styled
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
