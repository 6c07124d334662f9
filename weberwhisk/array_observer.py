"""An ideal observer of the place of a pole, through all whiskers of an array, and its resolution.

Each whisker that touches says by its cue how far away the object is and by how much it is deflected
(`inference.observer`), which is a place of the head's own coordinates; each that does not excludes
the places at which it would touch. Given the place, receptors of different whiskers are
independent: likelihoods multiply.

Resolution is by Fisher information, to which the flat prior of the region adds that of a Gaussian
as wide: exact for small noise, and never worse than the region itself. `places.place` has the
posteriors.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtr

from ._checks import (
    angle,
    finite,
    generator,
    kind,
    non_negative_number,
    one_of,
    positive_number,
    shown,
    whole,
)
from ._values import Array, pd
from .array import WhiskerArray
from .cues.protocol import Cue
from .inference.observer import Observer
from .place_sensor import JointEvidence, Sensor, metres, one_place
from .receptors import ReceptorNoise, Seed

Readings = Mapping[str, Any]
_RADIANS = "give radians, such as 0.02"


@dataclass(frozen=True, eq=False)
class ArrayObserver:
    """An ideal observer of the place of one vertical pole, through all whiskers of an array.

    Parameters
    ----------
    array : WhiskerArray
        Where the whiskers are now; they have swept there from rest, `WhiskerArray.protract`.
    cue : Cue, or mapping of whisker to Cue
        One that knows the distance and the deflection, `ForceMap`, or the distance alone: such a
        whisker *taps*, and its reading is the cue's signals and last the azimuth (rad) that it had
        when it first touched. By default ``ForceMap()``.
    noise : ReceptorNoise, or mapping of whisker to ReceptorNoise
        By default the cue's own.
    angle_sd : float
        Sd of what is known of each whisker's azimuth, rad, one whisker's error being independent of
        the next one's: by default 1°, the finest that rats tell (Knutsen, Pietr & Ahissar 2006,
        J Neurosci 26:8451). 0 where it is known, but for taps.
    missed : float
        Probability that a touch is not noticed.
    pole_length : float, optional
        Of a short pole, m, whose height is to be told by which whiskers touch it and which do not:
        one touches where its plane of whisking meets the pole. By default it is as high as all.
    region : ((float, float), (float, float)), optional
        x and y, m, between which the place is; its prior is flat. By default all places that any
        whisker can touch lie inside. The height's prior is flat over all heights of these.

    Raises
    ------
    ValueError
        For a whisker without a cue, a cue of more unknowns or with a prior of its own, and numbers
        out of range.

    Notes
    -----
    A whisker is bent in its plane of whisking, which holds its base tangent and the horizontal
    across it, and there the pole is a point. Left out: slip along the pole and out of that plane,
    which grows with elevation (`Place.note` names whiskers above 30° that touch), friction,
    several contacts of one whisker, and poles that lean. The height of a long pole is told by
    none; `information`, and `array_resolution` and its kin with it, refuse short ones.

    Examples
    --------
    >>> array = WhiskerArray("rat", "right").protract(np.radians(40))
    >>> observer = ArrayObserver(array)
    >>> observer.touching([20e-3, 5e-3])
    ('C3', 'D3', 'E3')
    """

    array: WhiskerArray
    cue: Cue | Mapping[str, Cue] | None = None
    noise: ReceptorNoise | Mapping[str, ReceptorNoise] | None = None
    angle_sd: float = float(np.radians(1.0))
    missed: float = 0.0
    pole_length: float | None = None
    region: ArrayLike | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        kind("array", self.array, "a WhiskerArray", "protract", 'write WhiskerArray("rat"), say')
        angle("angle_sd", non_negative_number("angle_sd", self.angle_sd, _RADIANS), _RADIANS)
        if not non_negative_number("missed", self.missed, "write 0.02, say") < 1:
            raise ValueError(f"missed must be below 1, got {self.missed}; write 0.02, say.")
        if self.pole_length is not None:
            positive_number("pole_length", self.pole_length, "give metres, such as 5e-3")
        if self.region is not None:
            box = finite("region", self.region, "give metres")
            if box.shape != (2, 2) or np.any(box[:, 0] >= box[:, 1]):
                raise ValueError(
                    f"region must be two ends of x and two of y, got {box.tolist()}; "
                    "write ((0.0, 40e-3), (-20e-3, 20e-3)), say."
                )
            metres("region", box)

    @cached_property
    def sensors(self) -> dict[str, Sensor]:
        """Whiskers with their observers, by name."""
        from .cues import ForceMap

        out = {}
        for name, follicle in self.array.whiskers.items():
            cue = _own(self.cue, name, "cue") or ForceMap()
            observer = Observer(follicle.whisker, cue, _own(self.noise, name, "noise"))
            if len(observer.unknowns) > observer.bounded:
                raise ValueError(
                    f"The place is of distance and deflection alone, got "
                    f"{', '.join(observer.unknowns)} unknown; take a cue that knows the rest."
                )
            out[name] = Sensor(follicle, observer, self.angle_sd)
            if out[name].taps and self.angle_sd == 0:
                raise ValueError(
                    f"{name} taps, whose bearing is as uncertain as its azimuth, got angle_sd 0; "
                    "write np.radians(1.0), say."
                )
        return out

    @cached_property
    def box(self) -> Array:
        """Ends of x and of y (2, 2) between which the place is, m."""
        if self.region is not None:
            return np.asarray(self.region, dtype=float)
        rim = []
        for sensor in self.sensors.values():
            turned = np.linspace(-0.3, sensor.follicle.swept_in_plane + 0.3, 32)
            rim.append(sensor.follicle.place(sensor.observer.reach[1], turned))
            rim.append(sensor.follicle.base[None, :2])
        ends = np.concatenate(rim)
        return np.stack([ends.min(axis=0), ends.max(axis=0)], axis=1)

    @cached_property
    def heights(self) -> tuple[float, float]:
        """Least and largest z of a short pole's middle, m."""
        ends = []
        for sensor in self.sensors.values():
            rise = sensor.observer.reach[1] * np.sin(sensor.follicle.elevation)
            ends += [sensor.follicle.base[2], sensor.follicle.base[2] + rise]
        half = (self.pole_length or 0.0) / 2
        return float(min(ends)) - half, float(max(ends)) + half

    def _one(self, place: ArrayLike) -> tuple[Array, dict[str, Sensor]]:
        """x and y of a pole, and the whiskers that are at its height."""
        at = one_place(place, 2 if self.pole_length is None else 3)
        if self.pole_length is None:
            return at, self.sensors
        level = {n: abs(float(s.height(at[:2])) - at[2]) for n, s in self.sensors.items()}
        half = self.pole_length / 2
        return at[:2], {n: s for n, s in self.sensors.items() if level[n] < half}

    def touching(self, place: ArrayLike) -> tuple[str, ...]:
        """Names of the whiskers that touch a pole at (2,), m, more likely than not.

        A place (3,), with the z of its middle, of a pole whose length is given.
        """
        at, level = self._one(place)
        return tuple(n for n, s in level.items() if s.touch_probability(at) > 0.5)

    def read(self, place: ArrayLike, seed: Seed = None) -> dict[str, Array | None]:
        """Noisy readings of a pole at (2,) or (3,), m, by whisker; None where it does not touch.

        Examples
        --------
        >>> array = WhiskerArray("rat", "right", identities=["C1", "C2"]).protract(0.7)
        >>> readings = ArrayObserver(array).read([15e-3, -2e-3], seed=1)
        >>> [name for name, reading in readings.items() if reading is not None]
        ['C2']
        """
        (at, level), rng = self._one(place), generator(seed)
        return {
            name: reading if rng.random() >= self.missed and name in level else None
            for name, reading in ((n, s.read(at, rng)) for n, s in self.sensors.items())
        }

    def log_likelihood(self, readings: Readings) -> JointEvidence:
        """ln p(readings | pole at (n, 2)) as a function of places, (n,).

        −∞ where a reading, or the absence of one, cannot be.
        """
        y = self.checked(readings)
        touched = [self.sensors[name].evidence(r) for name, r in y.items() if r is not None]
        apart = [self.sensors[name] for name, r in y.items() if r is None]
        return JointEvidence(touched, apart, self.missed, self.pole_length, self.heights)

    def information(self, place: ArrayLike) -> Array:
        """Fisher information about places (n, 2) by whisker, (n, whiskers, 2, 2), 1/m²."""
        if self.pole_length is not None:
            raise ValueError(
                "Fisher information is of poles as high as all whiskers, got a pole_length of "
                f"{self.pole_length:g} m; leave it out."
            )
        at = np.atleast_2d(metres("place", place))
        return np.stack([s.information(at) for s in self.sensors.values()], axis=1)

    def checked(self, readings: Readings) -> dict[str, Array | None]:
        """Readings by name, each of the numbers that its cue has."""
        if not isinstance(readings, Mapping) or not readings:
            raise ValueError(
                "Readings are a mapping of whisker to reading, None where it does not touch, got "
                f"{shown(readings)}; write {{'C2': [1e-7, 1e-6], 'C3': None}}, say."
            )
        return {
            one_of("whisker", name, self.sensors): None
            if reading is None
            else self.sensors[name].checked(name, reading)
            for name, reading in readings.items()
        }


def _own(value: Any, name: str, what: str) -> Any:
    """The cue or noise of a whisker: its own, or that of all."""
    if not isinstance(value, Mapping):
        return value
    if name not in value:
        raise ValueError(f"{name} has no {what}; leave it out of the array, or give it one.")
    return value[name]


# -- resolution ------------------------------------------------------------------------------------


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
    place = _grid(*(np.atleast_1d(metres(n, v)) for n, v in (("x", x), ("y", y))))
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
    at = one_place(place)[None]
    each, prior = observer.information(at)[0], _prior(observer)
    middles = (np.arange(64) + 0.5) / 64
    region = _grid(*(low + (high - low) * middles for low, high in observer.box))
    rows, total = [], each.sum(axis=0)
    for own, (name, sensor) in zip(each, observer.sensors.items(), strict=True):
        r, theta = (float(v[0]) for v in sensor.contact(at))
        touches, alone = bool(np.any(own != 0)), float(_bits(own, prior))
        error = np.sqrt(np.trace(np.linalg.inv(own + prior)))
        if not touches:
            r = theta = error = np.nan
            left = 1 - (1 - observer.missed) * sensor.touch_probability(region).mean()
            alone = float(-np.log2(left))
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
    Where nothing touches the answer is a guess: that no whisker does says something of the place,
    and is left out. Rats' performance fell in proportion to the number of whiskers removed,
    whichever they were (Krupa, Matell, Brisben, Oliveira & Nicolelis 2001, J Neurosci 21:5752).
    """
    if observer.array.sides == "both":
        raise ValueError(
            'array_by_count needs one side, got both; write WhiskerArray("rat", "right").'
        )
    x = positive_number("x", x, "give metres from the midline, such as 16e-3")
    gap = positive_number("difference", difference, "give metres, such as 3e-3")
    places = np.atleast_1d(metres("y", y))
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
        information = np.einsum("sw,pwij->spij", intact.astype(float), each)
        width = np.sqrt(2 * np.linalg.inv(information + prior)[..., 0, 0])
        # What whiskers tell of x, y being as uncertain as it is: the region says of neither width.
        cross, own = information[..., 0, 1], information[..., 1, 1] + prior[1, 1]
        precision = np.maximum(information[..., 0, 0] - cross**2 / own, 0.0)
        right = ndtr(gap / 2 * np.sqrt(precision / 2)).mean(axis=1)
        sensed = np.einsum("sw,pw->sp", intact.astype(float), touches.astype(float))
        error = right.std(ddof=1) / np.sqrt(subsets)
        middle = 1e3 * float(np.median(width))
        rows.append((n, (sensed > 0).mean(), sensed.mean(), middle, right.mean(), error))
    columns = ["count", "touched", "touching", "error_mm", "correct", "correct_error"]
    return pd.DataFrame(rows, columns=columns)


def _grid(x: Array, y: Array) -> Array:
    """Every pair of them, (n, 2)."""
    return np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)


def _prior(observer: ArrayObserver) -> Array:
    """Information (2, 2) of a Gaussian as wide as the region, 1/m²."""
    return np.asarray(np.diag(12.0 / np.diff(observer.box, axis=1)[:, 0] ** 2))


def _bits(information: Array, prior: Array) -> Array:
    """What information (..., 2, 2) adds to the prior's, in bits."""
    gain = np.linalg.slogdet(information + prior)[1] - np.linalg.slogdet(prior)[1]
    return np.asarray(gain / 2 / np.log(2))
