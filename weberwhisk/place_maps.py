"""How well an array of whiskers resolves an object's place: everywhere, and whisker by whisker.

By Fisher information, to which the flat prior of the region adds that of a Gaussian as wide: exact
for small noise, and never worse than the region itself. `places.place` has the posteriors.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtr

from ._checks import finite, generator, positive_number, whole
from .place_sensor import one_place
from .places import ArrayObserver
from .receptors import Seed

if TYPE_CHECKING:
    import pandas as pd

Array = NDArray[np.float64]


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
    import pandas as pd

    sides = [np.atleast_1d(finite(n, v, "give metres")) for n, v in (("x", x), ("y", y))]
    place = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 2)
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


def array_by_whisker(observer: ArrayObserver, place: ArrayLike) -> pd.DataFrame:
    """What each whisker tells of one place, alone and beside the others.

    Parameters
    ----------
    observer : ArrayObserver
    place : array, shape (2,)
        m.

    Returns
    -------
    pandas.DataFrame
        A row a whisker, most bits first: ``whisker``, ``touches``; ``distance_mm`` and
        ``deflection_deg`` of the contact; ``error_mm`` as in `array_resolution`; ``bits`` alone,
        which for one that does not touch is what it excludes of the region, and ``added_bits``,
        what all that touch lose without it.

    Examples
    --------
    >>> from weberwhisk import WhiskerArray
    >>> array = WhiskerArray("rat", "right", identities=["C1", "C2", "D2"]).protract(0.7)
    >>> table = array_by_whisker(ArrayObserver(array), [16e-3, -2e-3])
    >>> table[["whisker", "touches", "error_mm", "bits", "added_bits"]].round(2)
      whisker  touches  error_mm  bits  added_bits
    0      C2     True      3.22  8.11        1.56
    1      D2     True      3.72  7.79        1.25
    2      C1    False       NaN  0.24        0.00
    """
    import pandas as pd

    at = one_place(place)[None]
    each, prior = observer.information(at)[0], _prior(observer)

    sides = [low + (high - low) * (np.arange(64) + 0.5) / 64 for low, high in observer.box]
    region = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 2)
    rows, total = [], each.sum(axis=0)
    for own, (name, sensor) in zip(each, observer.sensors.items(), strict=True):
        r, theta = (float(v[0]) for v in sensor.contact(at))
        touches = bool(np.any(own != 0))
        alone = float(_bits(own, prior))
        if not touches:
            r = theta = np.nan
            left = 1 - (1 - observer.missed) * sensor.touch_probability(region).mean()
            alone = float(-np.log2(left))
        error = np.sqrt(np.trace(np.linalg.inv(own + prior))) if touches else np.nan
        added = float(_bits(total, prior) - _bits(total - own, prior))
        rows.append((name, touches, 1e3 * r, np.degrees(theta), 1e3 * error, alone, added))
    columns = "whisker touches distance_mm deflection_deg error_mm bits added_bits"
    table = pd.DataFrame(rows, columns=columns.split())
    return table.sort_values(["touches", "bits"], ascending=False, ignore_index=True)


def array_by_count(
    observer: ArrayObserver,
    x: float,
    y: ArrayLike,
    counts: Iterable[int] = (1, 2, 4, 8, 12, 16, 20, 25, 30),
    *,
    difference: float = 3e-3,
    subsets: int = 200,
    seed: Seed = None,
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
    seed : int, SeedSequence or Generator

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
        For an array of both sides, counts that it has not, and lengths that are not positive.

    Notes
    -----
    Rats' performance fell in proportion to the number of whiskers removed, whichever they were
    (Krupa, Matell, Brisben, Oliveira & Nicolelis 2001, J Neurosci 21:5752).
    """
    import pandas as pd

    if observer.array.sides == "both":
        raise ValueError(
            'array_by_count needs one side, got both; write WhiskerArray("rat", "right").'
        )
    x = positive_number("x", x, "give metres from the midline, such as 16e-3")
    gap = positive_number("difference", difference, "give metres, such as 3e-3")
    places = np.atleast_1d(finite("y", y, "give metres"))
    subsets, rng = whole("subsets", subsets, "write 200, say", least=2), generator(seed)
    lateral = x if observer.array.sides == "right" else -x
    place = np.stack([np.full(len(places), lateral), places], axis=-1)
    each, prior = observer.information(place), _prior(observer)
    touches = np.any(each != 0, axis=(2, 3))
    names, rows = len(observer.sensors), []
    for count in counts:
        n = whole("counts", count, f"give numbers from 1 to {names}")
        if n > names:
            raise ValueError(f"There are {names} whiskers on a side, got a count of {n}.")
        intact = rng.random((subsets, names)).argsort(axis=1) < n
        information = np.einsum("sw,pwij->spij", intact.astype(float), each) + prior
        width = np.sqrt(2 * np.linalg.inv(information)[..., 0, 0])
        right = ndtr(gap / 2 / width).mean(axis=1)
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
