"""How many peaks a posterior of distance has: whether a signature is unique (§2d)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._checks import finite
from ..observer import Observer
from .mode import Mode, find_mode, starting_points
from .panels import panels_of
from .solution import Array

#: Nodes over all peaks of one posterior; the difference, in sds, of what either half gives; and
#: the kurtosis from which some thousand draws may not have seen what makes the sd.
CELLS, RESOLVED, HEAVIEST = 1024, 0.1, 8.0


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
    [2, 2]
    """
    share = float(finite("mass", mass, "write 0.95, say"))
    if not 0 < share < 1:
        raise ValueError(f"mass must lie between 0 and 1, got {share:g}; write 0.95, say.")
    y = observer.checked_reading(reading)
    panels = panels_of(observer)
    r, log_weight = panels.r.reshape(-1), panels.log_weight.reshape(-1)
    signals = np.nan_to_num(observer.signals(r[:, None])[0], nan=1.0)  # of no weight where not held
    prior = observer.prior.get("radial_distance")
    log_prior = 0.0 if prior is None else prior.logpdf(r)
    counts = []
    for row in y.reshape(-1, y.shape[-1]):
        log = observer.noise.log_likelihood(row, signals)
        weight = np.exp(log + log_weight - (log + log_weight).max())
        counts.append(_count(log + log_prior, weight / weight.sum(), share))
    return np.array(counts) if y.ndim > 1 else counts[0]


def find_highest(observer: Observer, reading: Array) -> Mode:
    """`find_mode`; with one unknown from the best of the panels, between which no peak is lost.

    A signature (§2d) may have more peaks, and narrower ones, than any fixed grid has places.
    """
    if len(observer.unknowns) > 1:
        return find_mode(observer, reading)
    return find_mode(
        observer, reading, starting_points(observer, reading, panels_of(observer).middles)
    )


def is_divided(observer: Observer, reading: Array) -> NDArray[np.bool_]:
    """Posteriors (B,) of one unknown whose mass lies apart: methods that climb miss some of it.

    A billionth of the mass, as far off as the base is from the tip, still widens a narrow peak.
    """
    if len(observer.unknowns) > 1:
        return np.zeros(len(reading), dtype=bool)
    return np.asarray(count_peaks(observer, reading, 1 - 1e-9) > 1)


def over_all_peaks(
    observer: Observer, reading: Array
) -> tuple[dict[int, tuple[float, float]], NDArray[np.bool_]]:
    """Mean and sd of distance, by even nodes over all mass, of posteriors of which it lies apart.

    By their rows; and of which of the posteriors (B,) draws of these would not tell enough: half
    of the nodes give other moments than the other half, or so little mass lies so far off that a
    sample may well do without.
    """
    rows = np.flatnonzero(is_divided(observer, reading))
    found: dict[int, tuple[float, float]] = {}
    beyond = np.zeros(len(reading), dtype=bool)
    if not rows.size:
        return found, beyond
    for row, low, high in zip(rows, *panels_of(observer).ends(reading[rows]), strict=True):
        step = (high - low) / CELLS
        x = low + step * (np.arange(CELLS) + 0.5)
        log, contact = observer.log_density_and_contact(x[:, None], reading[row])
        weight = np.exp(log - log.max())
        halves = [_moments(contact[k::2, 0], weight[k::2]) for k in (0, 1)]
        (mean, sd, kurtosis), (other, width, tails) = halves
        change = max(abs(mean - other), abs(sd - width)) / max(sd, width, 1e-300)
        beyond[row] = not (change < RESOLVED and max(kurtosis, tails) < HEAVIEST)
        found[int(row)] = _moments(contact[:, 0], weight)[:2]
    return found, beyond


def _moments(r: Array, weight: Array) -> tuple[float, float, float]:
    """Mean, sd and kurtosis."""
    share = weight / np.maximum(weight.sum(), np.finfo(float).tiny)
    mean = float(share @ r)
    square = np.square(r - mean)
    variance = float(share @ square)
    # All on a single node, or on none, is not resolved.
    kurtosis = float(share @ square**2) / variance**2 if variance > 0 else np.inf
    return mean, variance**0.5, kurtosis


def _count(density: Array, weight: Array, mass: float) -> int:
    """Stretches of neighbouring nodes with the highest density that hold the mass."""
    order = np.argsort(density)[::-1]
    last = int(np.searchsorted(np.cumsum(weight[order]), mass))
    # Where a density is flat, rounding makes no valleys.
    inside = (density >= density[order[min(last, len(order) - 1)]] - 1e-6) & (weight > 0)
    return int(inside[0]) + int(np.sum(inside[1:] & ~inside[:-1]))
