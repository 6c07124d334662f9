"""How well whiskers of an array resolve a pole's place, over places and by their number (§2b, §4).

Resolution is by Fisher information, to which the flat prior of the region adds that of a Gaussian
as wide: exact for small noise, and never worse than the region itself.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.special import ndtr

from weberwhisk import ArrayObserver

Array = np.ndarray


def array_resolution(observer: ArrayObserver, x: ArrayLike, y: ArrayLike) -> pd.DataFrame:
    """The resolution of a pole's place over a grid of places.

    Parameters
    ----------
    observer : ArrayObserver
    x, y : array, shape (n,), (m,)
        m, in head coordinates.

    Returns
    -------
    pandas.DataFrame
        A row a place: ``x_mm``, ``y_mm``; ``touching``, the number of whiskers that touch;
        ``error_mm``, the root of the summed variances of x and y; ``major_mm`` and ``minor_mm``,
        the half axes of the error ellipse of one sd; ``best``, the whisker that alone has the
        least error, ``best_error_mm``; ``bits``, what all tell. Where none touches, NaN and "".

    Examples
    --------
    >>> from weberwhisk import WhiskerArray
    >>> array = WhiskerArray("rat", "right").protract(np.radians(40))
    >>> table = array_resolution(ArrayObserver(array), [16e-3, 30e-3], [-2e-3])
    >>> table[["touching", "error_mm", "best", "best_error_mm"]].round(2)
       touching  error_mm best  best_error_mm
    0        10      0.19   B3           0.85
    1         6      0.38   E2           0.83
    """
    place = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    each, prior = observer.information(place), _prior(observer)
    covariance = np.linalg.inv(each.sum(axis=1) + prior)
    alone = np.sqrt(np.trace(np.linalg.inv(each + prior), axis1=-2, axis2=-1))
    touches = np.any(each != 0, axis=(2, 3))
    some, best = touches.any(axis=1), np.where(touches, alone, np.inf).argmin(axis=1)
    axes = np.sqrt(np.linalg.eigvalsh(covariance))
    names = np.array([*observer.sensors])
    table = pd.DataFrame(1e3 * place, columns=["x_mm", "y_mm"])
    return table.assign(
        touching=touches.sum(axis=1),
        error_mm=np.where(some, 1e3 * np.sqrt(np.sum(axes**2, axis=1)), np.nan),
        major_mm=np.where(some, 1e3 * axes[:, 1], np.nan),
        minor_mm=np.where(some, 1e3 * axes[:, 0], np.nan),
        best=np.where(some, names[best], ""),
        best_error_mm=np.where(some, 1e3 * alone[np.arange(len(best)), best], np.nan),
        bits=np.where(some, _bits(each.sum(axis=1), prior), np.nan),
    )


def array_by_count(
    observer: ArrayObserver,
    x: float,
    y: ArrayLike,
    counts: Iterable[int] = (1, 2, 4, 8, 12, 16, 20, 25, 30),
    *,
    difference: float = 3e-3,
    subsets: int = 200,
    seed: int | None = None,
) -> pd.DataFrame:
    """The discrimination of aperture widths by the number of whiskers left intact on each side.

    Two poles stand at the same distance on either side, each touched by that side alone;
    which of two widths it is, a narrow or a wide one, is answered by the ideal observer.

    Parameters
    ----------
    observer : ArrayObserver
        Of one side; the other is its mirror image.
    x : float
        Lateral distance of either pole from the midline, m.
    y : array
        Rostrocaudal places at which the poles may stand, not known beforehand, m.
    counts : iterable of int
        Numbers of whiskers left intact on either side, drawn at random.
    difference : float
        Wide less narrow, m.
    subsets : int
        Sets of whiskers drawn for each number.
    seed : int

    Returns
    -------
    pandas.DataFrame
        A row a number: ``count``; ``touched``, the share of places that some whisker touches;
        ``touching``, the mean number that do; ``error_mm``, the median sd of the width;
        ``correct``, the share of right answers, and ``correct_error``, its standard error over
        sets.

    Raises
    ------
    ValueError
        For an array of both sides, and counts that it has not.

    Notes
    -----
    Where nothing touches the answer is a guess: that no whisker does says something of the place,
    and is left out. Rats' performance fell in proportion to the number of whiskers removed,
    whichever they were (Krupa, Matell, Brisben, Oliveira & Nicolelis 2001, J Neurosci 21:5752).
    """
    if observer.array.sides == "both":
        raise ValueError(
            'array_by_count needs one side, got both; write WhiskerArray("rat", "right").'
        )
    places, rng = np.atleast_1d(y), np.random.default_rng(seed)
    lateral = x if observer.array.sides == "right" else -x
    place = np.stack([np.full(len(places), lateral), places], axis=-1)
    each, prior = observer.information(place), _prior(observer)
    touches = np.any(each != 0, axis=(2, 3))
    names, rows = len(observer.sensors), []
    for n in counts:
        if n > names:
            raise ValueError(f"There are {names} whiskers on a side, got a count of {n}.")
        intact = rng.random((subsets, names)).argsort(axis=1) < n
        information = np.einsum("sw,pwij->spij", intact.astype(float), each)
        width = np.sqrt(2 * np.linalg.inv(information + prior)[..., 0, 0])
        # What whiskers tell of x, y being as uncertain as it is: the region says of neither width.
        cross, own = information[..., 0, 1], information[..., 1, 1] + prior[1, 1]
        precision = np.maximum(information[..., 0, 0] - cross**2 / own, 0.0)
        right = ndtr(difference / 2 * np.sqrt(precision / 2)).mean(axis=1)
        sensed = np.einsum("sw,pw->sp", intact.astype(float), touches.astype(float))
        error = right.std(ddof=1) / np.sqrt(subsets)
        middle = 1e3 * float(np.median(width))
        rows.append((n, (sensed > 0).mean(), sensed.mean(), middle, right.mean(), error))
    columns = ["count", "touched", "touching", "error_mm", "correct", "correct_error"]
    return pd.DataFrame(rows, columns=columns)


def _prior(observer: ArrayObserver) -> Array:
    """Information (2, 2) of a Gaussian as wide as the region, 1/m²."""
    return np.asarray(np.diag(12.0 / np.diff(observer.box, axis=1)[:, 0] ** 2))


def _bits(information: Array, prior: Array) -> Array:
    """What information (..., 2, 2) adds to the prior's, in bits."""
    gain = np.linalg.slogdet(information + prior)[1] - np.linalg.slogdet(prior)[1]
    return np.asarray(gain / 2 / np.log(2))
