"""How many peaks a posterior of distance has: whether a signature is unique (§2d)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .._checks import finite
from ..observer import Observer
from .panels import Panels
from .solution import Array


def count_peaks(observer: Observer, reading: ArrayLike, mass: float = 0.95) -> Any:
    """In how many separate stretches of distance the most probable share of a posterior lies.

    The highest-density region of that mass is one interval where the reading leaves one place,
    several where it leaves several. A second peak of less mass than is left out does not count.

    Parameters
    ----------
    observer : Observer
        Of one unknown.
    reading : array, shape (R,) or (B, R)
    mass : float
        Between 0 and 1.

    Returns
    -------
    int or array of int, shape (B,)

    Raises
    ------
    ValueError
        For an observer of several unknowns, a mass outside 0 to 1, a reading of the wrong shape.

    Examples
    --------
    >>> from weberwhisk import Whisker
    >>> from weberwhisk.cues import Vibration
    >>> observer = Observer(Whisker(50e-3, 100e-6, 5e-6), Vibration(2))
    >>> count_peaks(observer, observer.signals([[15e-3], [35e-3]])[0]).tolist()
    [1, 1]
    """
    share = float(finite("mass", mass, "write 0.95, say"))
    if not 0 < share < 1:
        raise ValueError(f"mass must lie between 0 and 1, got {share:g}; write 0.95, say.")
    y = observer.checked_reading(reading)
    panels = Panels(observer)
    rows = y.reshape(-1, y.shape[-1])
    counts = np.array([_count(*_density(panels, row), share) for row in rows])
    return counts if y.ndim > 1 else int(counts[0])


def _density(panels: Panels, reading: Array) -> tuple[Array, Array]:
    """Density of r, up to a factor, and mass at every node in ascending r."""
    log = panels.log_weight + panels.observer.noise.log_likelihood(reading, panels.signals)
    weight = np.exp(log - log.max())
    return weight / np.gradient(panels.r), weight / weight.sum()


def _count(density: Array, weight: Array, mass: float) -> int:
    order = np.argsort(density)[::-1]
    last = np.searchsorted(np.cumsum(weight[order]), mass)
    inside = density >= density[order[min(last, len(order) - 1)]]
    return int(inside[0]) + int(np.sum(inside[1:] & ~inside[:-1]))
