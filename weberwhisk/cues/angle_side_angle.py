"""Angle–side–angle (§2c): two angles and the side between them make a triangle.

The paper's three variants are one triangle; they differ in what must reach the object from its two
ends, and in how well the side can be known: a base moved between whisks (`AngleSideAngle`), two
whiskers (`TwoWhiskers`), a base that moves within a whisk (`ContactAndDetachment`).
"""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import scipy
from numpy.typing import ArrayLike

from .._util.checks import finite, non_negative_number, positive, positive_number
from .._util.refusals import Refusal
from .._util.values import Array, Codes
from ..mechanics.contact import Outcome
from ..receptors import GeneralisedWeber
from ..whisker import Whisker
from .protocol import ANGLE_SD, Cue, Encoded, reach_at, readings, straight

__all__ = ["AngleSideAngle", "ContactAndDetachment", "TwoWhiskers"]


@dataclass(frozen=True, eq=False, repr=False)
class AngleSideAngle(Cue):
    """Radial distance from the angles of an object seen from two ends of a known side (§2c, i).

    Between two whisks the base moves by a side of known length. At both places the angle of first
    contact, between the side and the whisker, is sensed. Radial distance is counted from the second
    place: r = side·sin(first)/sin(second − first). The object's bearing, which is the true second
    angle, is unknown too.

    Parameters
    ----------
    side : float
        Length of the side, m.
    side_sd : float
        Sd of the side, m. Above 0 the side is a third unknown with a normal prior.
    bearings : (float, float)
        Range of possible bearings, rad; their prior is flat.

    Raises
    ------
    ValueError
        For a side that is not positive or less certain than a quarter of itself, bearings that
        do not go up between 0 and π.

    Notes
    -----
    The method works at distances that the straight whisker reaches from both places at every
    bearing (with an unknown side, also 4 sd beyond its mean). At large distances the lines of sight
    are nearly parallel, and the JND grows as r²/side.

    Examples
    --------
    >>> w = Whisker(length=50e-3, base_radius=100e-6, tip_radius=5e-6)
    >>> cue = AngleSideAngle(side=10e-3)
    >>> angles, outcome = cue.signals(w, np.array([30e-3, np.pi / 2]))
    >>> np.degrees(angles).round(3)
    array([71.565, 90.   ])
    >>> r, outcome = cue.radial_distance(w, angles)
    >>> print(f"{r * 1e3:.6f} mm")
    30.000000 mm
    """

    signal_names = ("first_angle", "second_angle")

    side: float = 10e-3
    _: KW_ONLY
    side_sd: float = 0.0
    bearings: tuple[float, float] = (float(np.radians(30.0)), float(np.radians(150.0)))

    def __post_init__(self) -> None:
        side = positive_number("side", self.side, "give metres, such as 10e-3")
        side_sd = non_negative_number("side_sd", self.side_sd, "give metres, 0 for a known side")
        if side_sd > side / 4:
            raise Refusal(
                "side_sd must be at most a quarter of the side",
                f"{side_sd:g} m for {side:g} m",
                "a side that may be 0 does not inform of distance",
            )
        bearings = finite("bearings", self.bearings, "give (low, high) in rad")
        low, high = bearings if bearings.shape == (2,) else (np.nan, np.nan)
        if not 0 < low < high < np.pi:
            raise Refusal(
                "bearings must be two that go up between 0 and π",
                bearings.tolist(),
                "give them in radians",
            )
        self._set(side=side, side_sd=side_sd, bearings=(float(low), float(high)))

    @property
    def unknowns(self) -> tuple[str, ...]:
        """Distance, bearing and, where it is not known, the side."""
        return ("radial_distance", "bearing", "side")[: 2 + (self.side_sd > 0)]

    def _reaches(self, whisker: Whisker) -> tuple[float, float]:
        """How far the object may be from the first place and from the second, m."""
        return float(whisker.length), float(whisker.length)

    def _farthest(self, whisker: Whisker) -> float:
        """Largest r at which q² = r² + side² + 2r·side·cos(bearing) is within reach, m; or < 0."""
        first_reach, reach = self._reaches(whisker)
        side = self.side + 4 * self.side_sd
        across, along = side * np.sin(self.bearings[0]), side * np.cos(self.bearings[0])
        if across >= first_reach:
            return -1.0
        return float(min(np.sqrt(first_reach**2 - across**2) - along, reach))

    def _outcome(self, whisker: Whisker, r: Array, first: Array) -> Codes:
        """Outcomes, given the distances from the second place and from the first."""
        first_reach, reach = self._reaches(whisker)
        seen = (r > 0) & (r <= reach) & (first <= first_reach)
        in_reach = seen & (r <= self._farthest(whisker))
        if in_reach.all():
            return np.zeros(in_reach.shape, dtype=np.int8)
        outcome = np.select(
            [in_reach, seen], [Outcome.HELD, Outcome.ONE_SIDED], Outcome.OUT_OF_REACH
        )
        return np.asarray(outcome, dtype=np.int8)

    def signals(self, whisker: Whisker, contact: Array, *, model: str | None = None) -> Encoded:
        """First and second angle (..., 2), rad, of a contact (..., U), and its outcome."""
        straight(whisker)
        contact = np.asarray(contact, dtype=float)
        r, bearing = contact[..., 0], contact[..., 1]
        side = contact[..., 2] if self.side_sd > 0 else self.side
        # The object as seen from the first place.
        along, across = side + r * np.cos(bearing), r * np.sin(bearing)
        outcome = self._outcome(whisker, r, np.hypot(along, across))
        angles = np.stack([np.arctan2(across, along), bearing], axis=-1)
        return np.where((outcome == Outcome.HELD)[..., None], angles, np.nan), outcome

    def priors(self, whisker: Whisker) -> dict[str, Any]:
        """The bearing, flat, and the side, normal, where it is not known."""
        low, high = self.bearings
        priors: dict[str, Any] = {"bearing": scipy.stats.uniform(low, high - low)}
        if self.side_sd > 0:
            priors["side"] = scipy.stats.norm(self.side, self.side_sd)
        return priors

    def default_noise(self) -> GeneralisedWeber:
        """The same sd at every angle: one degree."""
        return GeneralisedWeber(0.0, floor=ANGLE_SD)

    def farthest(self, whisker: Whisker) -> float:
        """As far as the object is reached from both places at every bearing, m."""
        farthest = self._farthest(whisker)
        if farthest <= 0:
            raise Refusal(
                "No object is reached from both ends of the side at every bearing",
                f"a side of {self.side:g} m and a reach of {self._reaches(whisker)[0]:g} m",
                "write a shorter side",
            )
        return farthest

    def radial_distance(
        self, whisker: Whisker, angles: ArrayLike, side: ArrayLike | None = None
    ) -> tuple[Array, Codes]:
        """The distance that two angles (..., 2) and the side give, m, and its outcome, (...) each.

        NaN and `PARALLEL` where the lines of sight do not meet ahead, NaN and `OUT_OF_REACH` (or
        what else becomes of such a contact) where they meet too far off.
        """
        pair = readings("angles", finite("angles", angles, "give radians"), 2)
        first, second = np.moveaxis(pair, -1, 0)
        s = self.side if side is None else positive("side", side, "give metres, such as 10e-3")
        apex = second - first
        meet = (first > 0) & (apex > 0) & (second < np.pi)
        scale = s / np.sin(np.where(meet, apex, 1.0))
        r, far = scale * np.sin(first), scale * np.sin(second)
        outcome = np.where(meet, self._outcome(whisker, r, far), Outcome.PARALLEL)
        return np.where(outcome == Outcome.HELD, r, np.nan), outcome.astype(np.int8)

    def reading_outcome(self, whisker: Whisker, reading: Array) -> Codes:
        """`PARALLEL` where two angles (..., 2) do not meet, or what else `radial_distance` says."""
        return self.radial_distance(whisker, reading)[1]


@dataclass(frozen=True, eq=False, repr=False)
class TwoWhiskers(AngleSideAngle):
    """Angle–side–angle with two whiskers, the side between their bases (§2c, ii).

    Radial distance is from the base of the observer's whisker, the second place; the neighbour
    stands in the first. The side is anatomy, and may be known well.

    Parameters
    ----------
    side, side_sd, bearings
        As for `AngleSideAngle`. The default spacing of 3 mm is assumed.
    neighbour_length : float, optional
        Length of the neighbour, m; default that of the observer's whisker.

    Examples
    --------
    >>> w = Whisker(length=50e-3, base_radius=100e-6, tip_radius=5e-6)
    >>> cue = TwoWhiskers(side=3e-3, neighbour_length=25e-3)
    >>> angles, outcome = cue.signals(w, np.array([[20e-3, 1.5], [30e-3, 1.5]]))
    >>> [Outcome(k).name for k in outcome]
    ['HELD', 'OUT_OF_REACH']
    """

    side: float = 3e-3
    _: KW_ONLY
    neighbour_length: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.neighbour_length is not None:
            hint = "give metres, such as 40e-3"
            length = positive_number("neighbour_length", self.neighbour_length, hint)
            self._set(neighbour_length=length)

    def _reaches(self, whisker: Whisker) -> tuple[float, float]:
        length = float(whisker.length)
        return self.neighbour_length or length, length


@dataclass(frozen=True, eq=False, repr=False)
class ContactAndDetachment(AngleSideAngle):
    """Angle–side–angle within a whisk, between first contact and detachment (§2c, iii).

    The pad carries the base along while the object holds the whisker; the whisker is straight when
    it meets the object and when it leaves it, but in between it is deflected, by `push`. Where
    it would flick past, there is no detachment angle.

    Parameters
    ----------
    side, side_sd, bearings
        As for `AngleSideAngle`. The default movement of 2 mm within a whisk is assumed.
    push : float
        Largest deflection between contact and detachment, rad.

    Examples
    --------
    >>> w = Whisker(length=50e-3, base_radius=100e-6, tip_radius=5e-6)
    >>> cue = ContactAndDetachment(push=np.radians(24.5732))
    >>> print(f"{cue.farthest(w) * 1e3:.2f} mm")
    33.25 mm
    >>> Outcome(int(cue.signals(w, np.array([40e-3, 1.5]))[1])).name
    'FLICKED_PAST'
    """

    side: float = 2e-3
    _: KW_ONLY
    push: float = float(np.radians(10.0))

    def __post_init__(self) -> None:
        super().__post_init__()
        self._set(push=non_negative_number("push", self.push, "give radians, 0.17 say"))

    def _reaches(self, whisker: Whisker) -> tuple[float, float]:
        reach = _reach_at(whisker, self.push, "push")
        return reach, reach

    def _outcome(self, whisker: Whisker, r: Array, first: Array) -> Codes:
        outcome = super()._outcome(whisker, r, first)
        on_whisker = (r > 0) & (np.maximum(r, first) <= whisker.length)
        lost = (outcome == Outcome.OUT_OF_REACH) & on_whisker
        return np.where(lost, Outcome.FLICKED_PAST, outcome).astype(np.int8)


_reach_at = lru_cache(maxsize=64)(reach_at)
