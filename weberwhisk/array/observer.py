"""An ideal observer of the place of a pole, through all whiskers of an array.

The cue of each whisker that touches informs of radial distance and deflection
(`inference.observer`), that is of a place in head coordinates. Each whisker that does not touch
excludes the places at which it would. Given the place, receptors of different whiskers are
independent: likelihoods multiply. `place.place` returns the posteriors.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .._util import checks
from .._util.refusals import Refusal
from .._util.values import Array, Fields
from ..cues.protocol import Cue
from ..inference.observer import Observer
from ..receptors import ReceptorNoise, Seed
from .evidence import JointEvidence, Sensor, metres, one_place
from .follicles import WhiskerArray

__all__ = ["ArrayObserver", "Readings"]

Readings = Mapping[str, Any]
_RADIANS = "give radians, such as 0.02"


@dataclass(frozen=True, eq=False, repr=False)
class ArrayObserver(Fields):
    """An ideal observer of the place of one vertical pole, through all whiskers of an array.

    Parameters
    ----------
    array : WhiskerArray
        Where the whiskers are now; they have swept there from rest, `WhiskerArray.protract`.
    cue : Cue, or mapping of whisker to Cue
        One whose unknowns are distance and deflection, such as `ForceMap`, or distance alone. With
        distance alone a whisker *taps*: its reading is the cue's signals and last the azimuth (rad)
        at first touch. By default ``ForceMap()``.
    noise : ReceptorNoise, or mapping of whisker to ReceptorNoise
        By default the cue's own.
    angle_sd : float
        Sd of the error of each whisker's azimuth, rad, independent between whiskers: by default
        1°, the finest difference that rats discriminate (Knutsen, Pietr & Ahissar 2006, J Neurosci
        26:8451). 0 for azimuths without error, which taps refuse.
    missed : float
        Probability that a touch is not noticed.
    pole_length : float, optional
        Of a short pole, m, whose height is inferred from which whiskers touch it: those whose plane
        of whisking meets the pole. By default the pole is as high as all whiskers.
    region : ((float, float), (float, float)), optional
        Ends of x and y, m, of the flat prior of the place. By default all places that any whisker
        can touch lie inside. The prior of the height is flat over the heights of these places.

    Raises
    ------
    ValueError
        For a whisker without a cue, a cue of more unknowns or with a prior of its own, and numbers
        out of range.

    Notes
    -----
    A whisker is bent in its plane of whisking, which holds its base tangent and the horizontal
    across it, and there the pole is a point. Left out: slip along the pole and out of that plane,
    which grows with elevation (`Place.note` names whiskers above 30° that touch), friction, several
    contacts of one whisker, and poles that lean. No whisker informs of the height of a long pole;
    `information` refuses short ones.

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
        checks.kind(
            "array", self.array, "a WhiskerArray", "protract", 'write ww.WhiskerArray("rat"), say'
        )
        sd = checks.non_negative_number("angle_sd", self.angle_sd, _RADIANS)
        checks.angle("angle_sd", sd, _RADIANS)
        if not checks.non_negative_number("missed", self.missed, "write 0.02, say") < 1:
            raise Refusal("missed must be below 1", self.missed, "write 0.02, say")
        if self.pole_length is not None:
            checks.positive_number("pole_length", self.pole_length, "give metres, such as 5e-3")
        if self.region is not None:
            box = checks.finite("region", self.region, "give metres")
            if box.shape != (2, 2) or np.any(box[:, 0] >= box[:, 1]):
                raise Refusal(
                    "region must be two ends of x and two of y",
                    box.tolist(),
                    "write ((0.0, 40e-3), (-20e-3, 20e-3)), say",
                )
            metres("region", box)

    @cached_property
    def sensors(self) -> dict[str, Sensor]:
        """Whiskers with their observers, by name."""
        from ..cues import ForceMap

        out = {}
        for name, follicle in self.array.whiskers.items():
            cue = _of_whisker(self.cue, name, "cue") or ForceMap()
            observer = Observer(follicle.whisker, cue, _of_whisker(self.noise, name, "noise"))
            if len(observer.unknowns) > observer.bounded:
                raise Refusal(
                    "The place is of distance and deflection alone",
                    f"{', '.join(observer.unknowns)} unknown",
                    "take a cue that knows the rest",
                )
            out[name] = Sensor(follicle, observer, self.angle_sd)
            if out[name].taps and self.angle_sd == 0:
                raise Refusal(
                    f"{name} taps, whose bearing is as uncertain as its azimuth",
                    "angle_sd 0",
                    "write np.radians(1.0), say",
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
        (at, level), rng = self._one(place), checks.generator(seed)
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
        untouched = [self.sensors[name] for name, r in y.items() if r is None]
        return JointEvidence(touched, untouched, self.missed, self.pole_length, self.heights)

    def information(self, place: ArrayLike) -> Array:
        """Fisher information about places (n, 2) by whisker, (n, whiskers, 2, 2), 1/m²."""
        if self.pole_length is not None:
            raise Refusal(
                "Fisher information is of poles as high as all whiskers",
                f"a pole_length of {self.pole_length:g} m",
                "leave it out",
            )
        at = np.atleast_2d(metres("place", place))
        return np.stack([s.information(at) for s in self.sensors.values()], axis=1)

    def checked(self, readings: Readings) -> dict[str, Array | None]:
        """Readings by name, each of the numbers that its cue has."""
        if not isinstance(readings, Mapping) or not readings:
            raise Refusal(
                "Readings are a mapping of whisker to reading, None where it does not touch",
                checks.shown(readings),
                "write {'C2': [1e-7, 1e-6], 'C3': None}, say",
            )
        return {
            checks.one_of("whisker", name, self.sensors): None
            if reading is None
            else self.sensors[name].checked(name, reading)
            for name, reading in readings.items()
        }


def _of_whisker(value: Any, name: str, what: str) -> Any:
    """The cue or noise of one whisker, from a mapping or shared by all."""
    if not isinstance(value, Mapping):
        return value
    if name not in value:
        raise Refusal(f"{name} has no {what}", remedy="leave it out of the array, or give it one")
    return value[name]
