"""The posterior of a contact."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes

from .style import COLOURS, axes_or_new, legend_above, styled

if TYPE_CHECKING:
    from ..posterior import Posterior

_UNKNOWNS = {
    "radial_distance": ("Radial distance (mm)", 1e-3),
    "deflection_angle": ("Deflection angle (degrees)", np.pi / 180),
}


@styled
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
    ax = axes_or_new(ax)
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
    legend_above(ax)
    return ax
