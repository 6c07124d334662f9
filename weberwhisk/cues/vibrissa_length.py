"""Vibrissa length (§2a), of one whisker or of several beside each other (§2b).

Distance from a touch of the tip, of the shaft, or none, and from which whiskers of an array touch.
"""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtr

from .._util.checks import finite, non_negative_number, positive, positive_number, whole
from .._util.refusals import Refusal
from .._util.values import Array, Codes
from ..mechanics.contact import Outcome
from ..receptors import Events
from ..whisker import Whisker
from .protocol import Cue, Encoded, readings, straight

__all__ = ["ComparativeLength", "VibrissaLength"]


@dataclass(frozen=True, eq=False, repr=False)
class VibrissaLength(Cue):
    """Radial distance from whether a whisker of uncertain length touches, and with its tip (§2a).

    The whisker points at the object. It touches if it is long enough; the touch is sensed as one of
    the tip if the contact lies within the last part of the whisker. What happens is an event, and
    the signals are its chances, over what is not known of the length: a log-normal spread about
    the whisker's own, and with the chance `damage` a break at any place, all equally likely.

    Parameters
    ----------
    spread : float
        Sd of the length over its mean. Default 0.18, that between rats' whiskers of one identity
        (the median over the 30 of Belli et al. 2017); a rat that has learnt its own whiskers'
        lengths knows them better.
    damage : float
        Chance that the whisker has broken off.
    tip_zone : float
        Part of the whisker at its end within which a contact is sensed as one of the tip. Assumed.
    reach : float
        How far out there may be objects, in lengths of the whisker: what bounds the distance
        where nothing is touched.

    Raises
    ------
    ValueError
        For a spread that is not positive, a chance or a part outside 0 … 1, a reach of 1 or less.

    Notes
    -----
    A reading is (touch, touch of the tip), 0 or 1 each: [0, 0] is no touch, [1, 1] one of the tip,
    [1, 0] one of the shaft.

    One event has no limit of small noise: the JND is the sd of a posterior with a flat top (no
    touch: beyond the whisker; the shaft: short of the tip), and never less than the spread
    and the tip's zone allow.

    Examples
    --------
    >>> w = Whisker(length=50e-3, base_radius=100e-6, tip_radius=5e-6)
    >>> cue = VibrissaLength(spread=0.05)
    >>> chances, outcome = cue.signals(w, np.array([[20e-3], [47e-3], [60e-3]]))
    >>> chances.round(3)  # of no touch and of the tip; the rest is the shaft's
    array([[0.   , 0.   ],
           [0.113, 0.702],
           [1.   , 0.   ]])
    """

    signal_names = ("chance_of_no_touch", "chance_of_tip")
    #: Touch and touch of the tip, by event: no touch, tip, shaft.
    reports = ((0.0, 0.0), (1.0, 1.0), (1.0, 0.0))

    _: KW_ONLY
    spread: float = 0.18
    damage: float = 0.0
    tip_zone: float = 0.1
    reach: float = 1.5

    def __post_init__(self) -> None:
        self._set(
            spread=positive_number("spread", self.spread, "give sd over mean, 0.18 say"),
            damage=non_negative_number("damage", self.damage, "give a probability, 0 to 1"),
            tip_zone=positive_number("tip_zone", self.tip_zone, "give a part, 0.1 say"),
            reach=positive_number("reach", self.reach, "give whisker lengths, 1.5 say"),
        )
        for name in ("damage", "tip_zone"):
            if getattr(self, name) >= 1:
                raise Refusal(
                    f"{name} must be below 1", f"{getattr(self, name):g}", "write 0.1, say"
                )
        if self.reach <= 1:
            raise Refusal(
                "Objects must be possible beyond the whisker's tip",
                f"reach={self.reach:g}",
                "write 1.5, say",
            )

    def _missing(self, whisker: Whisker, r: Array) -> Array:
        """The chance of being shorter than r.

        Whole: ln length is normal. Broken: 1 − E[(1 − r/length)₊], as the break is anywhere.
        """
        sigma = np.sqrt(np.log1p(self.spread**2))
        log_median = np.log(whisker.length) - 0.5 * sigma**2
        z = (np.log(r) - log_median) / sigma
        # E[1/length; length > r]
        inverse = np.exp(0.5 * sigma**2 - log_median) * ndtr(-z - sigma)
        return np.asarray(ndtr(z) + self.damage * r * inverse)

    def signals(self, whisker: Whisker, contact: Array, *, model: str | None = None) -> Encoded:
        """Chances (..., 2) of no touch and of a touch with the tip, at a contact (..., 1)."""
        straight(whisker)
        r = np.asarray(contact, dtype=float)[..., 0]
        in_reach = (r > 0) & (r <= self.farthest(whisker))
        r = np.where(in_reach, r, whisker.length)
        none, not_shaft = (self._missing(whisker, at) for at in (r, r / (1 - self.tip_zone)))
        chances = np.stack([none, not_shaft - none], axis=-1)
        outcome = np.where(in_reach, Outcome.HELD, Outcome.OUT_OF_REACH).astype(np.int8)
        return np.where(in_reach[..., None], chances, np.nan), outcome

    def default_noise(self) -> Events:
        """Events that are never misreported."""
        return Events(self.reports)

    def farthest(self, whisker: Whisker) -> float:
        """As far out as there may be objects, m."""
        return self.reach * float(whisker.length)

    def radial_distance(self, whisker: Whisker, reading: ArrayLike) -> tuple[Array, Codes]:
        """The distance that a reading (..., 2) gives away, m, and its outcome, (...) each.

        A touch of the tip puts the object into the middle of the tip's zone; after any other
        event the method does not work: NaN, and `NO_TOUCH` or `TIP_NOT_TOUCHED`.
        """
        pair = readings("reading", finite("reading", reading, "give two numbers, 0 or 1"), 2)
        touch, tip = np.moveaxis(pair, -1, 0)
        at_tip = (touch == 1) & (tip == 1)
        outcome = np.select(
            [at_tip, touch == 1], [Outcome.HELD, Outcome.TIP_NOT_TOUCHED], Outcome.NO_TOUCH
        )
        middle = whisker.length * (1 - self.tip_zone / 2)
        return np.where(at_tip, middle, np.nan), outcome.astype(np.int8)

    def reading_outcome(self, whisker: Whisker, reading: Array) -> Codes:
        """`HELD` after a touch of the tip, else `NO_TOUCH` or `TIP_NOT_TOUCHED`, (...)."""
        return self.radial_distance(whisker, reading)[1]


@dataclass(frozen=True, eq=False, repr=False, init=False)
class ComparativeLength(Cue):
    """Radial distance from which whiskers of an array touch an object, and which do not (§2b).

    In the plane of whisking the observer's whisker has its base at the origin, and the object is
    a vertical pole on the x axis, at the radial distance. Each whisker sweeps a sector about its
    base, as wide as its whisk and as far as its tip, and touches if the pole is in it. What
    happens is a pattern of touches; the signals are the patterns' chances, over what is not known
    of the pose of the head, of the lengths and of the ends of the sectors.

    Parameters
    ----------
    lengths : array, shape (m,)
        Lengths of the neighbours, m; the first whisker of the array is the observer's own.
    bases : array, shape (m, 2)
        Positions of their bases, m, relative to that of the observer's whisker.
    sweeps : array, shape (m + 1, 2), optional
        Angles to the x axis between which each whisker sweeps, rad, the observer's own first.
        Default everything ahead, ± 90°.
    spread : float
        Sd of each length over its mean: log-normal and independent. Default assumed.
    base_sd : float
        Sd of each base's position, m, independent. Default assumed.
    angle_sd : float
        Sd of either end of each sector, rad, independent. Default assumed.
    position_sd, orientation_sd : float
        Sd of the head's position in each direction, m, and of its orientation, rad; all whiskers
        move along. Defaults assumed.
    reach : float
        How far out there may be poles, in lengths of the longest whisker.
    poses : int
        Gauss–Hermite nodes for each of the three directions of the pose. Five give chances to
        1e-3 and better, from a few mm off the bases on, where what is independent (bases,
        sectors) is as uncertain as the pose; a less certain pose needs more.

    Raises
    ------
    ValueError
        For no neighbours or more than seven, shapes that do not fit, sds that are negative
        (spread: not positive), sectors that do not go up.

    Notes
    -----
    A longer whisker that touches where a shorter one does not puts the object between the two
    lengths, as the paper says, for whiskers with one base. Where the longer one's base is further
    back and its tip ends first, the shorter may touch alone. The chance of a pattern is Σ over
    poses of Π over whiskers. A prior keeps poles out of the snout. One event has no limit of small
    noise; see `VibrissaLength`.

    Examples
    --------
    >>> w = Whisker(length=30e-3, base_radius=60e-6, tip_radius=3e-6)
    >>> cue = ComparativeLength([40e-3], [[-1e-3, 0.0]])
    >>> chances, outcome = cue.signals(w, np.array([[20e-3], [35e-3], [50e-3]]))
    >>> cue.reports[:-1]
    array([[0., 0.],
           [0., 1.],
           [1., 0.]])
    >>> chances.round(2)  # neither, the longer neighbour alone, the shorter alone
    array([[0.  , 0.  , 0.  ],
           [0.05, 0.94, 0.  ],
           [1.  , 0.  , 0.  ]])
    >>> low, high, _ = cue.interval(w, [0, 1])
    >>> print(f"{low * 1e3:.1f} to {high * 1e3:.1f} mm")
    30.0 to 39.0 mm
    """

    lengths: Array
    bases: Array
    sweeps: Array
    spread: float
    base_sd: float
    angle_sd: float
    position_sd: float
    orientation_sd: float
    reach: float
    poses: int

    def __init__(
        self,
        lengths: ArrayLike,
        bases: ArrayLike,
        *,
        sweeps: ArrayLike | None = None,
        spread: float = 0.05,
        base_sd: float = 1e-3,
        angle_sd: float = float(np.radians(3.0)),
        position_sd: float = 1e-3,
        orientation_sd: float = float(np.radians(3.0)),
        reach: float = 1.5,
        poses: int = 5,
    ) -> None:
        lengths = np.atleast_1d(positive("lengths", lengths, "give metres"))
        bases = finite("bases", bases, "give metres, a row for each neighbour")
        count = lengths.size + 1
        if not 2 <= count <= 8 or lengths.ndim > 1:  # 2⁸ patterns of touch
            raise Refusal(
                "An array has 1 to 7 neighbours",
                f"lengths of shape {lengths.shape}",
                "give one length for each",
            )
        if bases.shape != (count - 1, 2):
            raise Refusal(
                f"bases must have shape ({count - 1}, 2)",
                bases.shape,
                "give x and y for each neighbour",
            )
        ends = np.tile([-np.pi / 2, np.pi / 2], (count, 1)) if sweeps is None else sweeps
        sweeps = finite("sweeps", ends, "give radians, a row for each whisker")
        if sweeps.shape != (count, 2) or np.any(sweeps[:, 0] >= sweeps[:, 1]):
            raise Refusal(
                f"sweeps must be {count} rows of (low, high), the observer's own whisker first",
                sweeps.tolist(),
                "give radians that go up",
            )
        metres = "give metres, 1e-3 say"
        self._set(
            lengths=lengths,
            bases=bases,
            sweeps=sweeps,
            spread=positive_number("spread", spread, "give sd over mean, 0.05 say"),
            base_sd=positive_number("base_sd", base_sd, metres),
            angle_sd=positive_number("angle_sd", angle_sd, "give radians"),
            position_sd=non_negative_number("position_sd", position_sd, metres),
            orientation_sd=non_negative_number("orientation_sd", orientation_sd, "give radians"),
            reach=positive_number("reach", reach, "give lengths of the longest, 1.5 say"),
            poses=whole("poses", poses, "write 5, say"),
        )

    @cached_property
    def reports(self) -> Array:
        """Which whiskers touch, by event, (2ⁿ, n): none of them first, all of them last."""
        return np.array(list(product([0.0, 1.0], repeat=len(self.lengths) + 1)))

    @cached_property
    def signal_names(self) -> tuple[str, ...]:
        """The probability of each pattern but the last."""
        patterns = ("".join(str(int(touch)) for touch in row) for row in self.reports[:-1])
        return tuple(f"chance_of_{row}" for row in patterns)

    def __repr__(self) -> str:
        millimetres = ", ".join(f"{v * 1e3:g}" for v in self.lengths)
        return f"ComparativeLength({len(self.lengths) + 1} whiskers, neighbours {millimetres} mm)"

    @cached_property
    def _poses(self) -> tuple[Array, Array, Array]:
        """Turns (P,), shifts (P, 2) of the pole as the head sees it, and their weights (P,)."""
        sds = (self.orientation_sd, self.position_sd, self.position_sd)
        rules = [np.polynomial.hermite_e.hermegauss(self.poses if sd > 0 else 1) for sd in sds]
        grid = np.meshgrid(*(sd * x for sd, (x, _) in zip(sds, rules, strict=True)), indexing="ij")
        turn, along, across = (a.ravel() for a in grid)
        weight = np.einsum("i,j,k->ijk", *(w / w.sum() for _, w in rules)).ravel()
        return turn, np.stack([along, across], axis=-1), weight

    # -- chances -------------------------------------------------------------------------------

    def _lengths(self, whisker: Whisker) -> Array:
        return np.concatenate([[float(whisker.length)], self.lengths])

    def _angle(self, y: Array, x: Array) -> Array:
        """Of what each whisker meets, within half a turn of the middle of its sweep, rad."""
        angle = np.arctan2(y, x)
        whole_turns = np.round((angle - self.sweeps.mean(axis=1)) / (2 * np.pi))
        return np.asarray(angle - 2 * np.pi * whole_turns)

    def _touches(self, whisker: Whisker, r: Array) -> Array:
        """Chance of each whisker's touch in each pose, (n, P, whiskers)."""
        turn, shift, _ = self._poses
        ahead = np.stack([np.cos(turn), -np.sin(turn)], axis=-1)
        pole = r[:, None, None] * ahead + shift
        bases = np.concatenate([np.zeros((1, 2)), self.bases])
        x, y = np.moveaxis(pole[:, :, None] - bases, -1, 0)
        distance = np.maximum(np.hypot(x, y), 1e-12)
        lengths = self._lengths(whisker)
        # To first order about d = length, the base's error adds to that of the length …
        sigma = np.sqrt(np.log1p(self.spread**2 + (self.base_sd / lengths) ** 2))
        z = np.log(distance / lengths) / sigma + 0.5 * sigma
        # … and in the angle, the more the closer by, to that of the sector's ends.
        sd = np.hypot(self.angle_sd, self.base_sd / distance)
        low, high = ((self._angle(y, x) - end) / sd for end in self.sweeps.T)
        return np.asarray(ndtr(-z) * (ndtr(low) - ndtr(high)))

    def _patterns(self, whisker: Whisker, r: Array) -> Array:
        """Chances (..., 2ⁿ) of all patterns: of either half of the array, times each other's."""
        half, pieces = self.reports.shape[1] // 2, []
        size = 256  # distances worked on together
        for start in range(0, max(r.size, 1), size):  # of none there is one empty piece
            touch = self._touches(whisker, r.reshape(-1)[start : start + size])
            first, second = _together(touch[..., :half]), _together(touch[..., half:])
            both = np.swapaxes(first * self._poses[2][:, None], 1, 2) @ second
            pieces.append(both.reshape(len(touch), len(self.reports)))
        return np.concatenate(pieces).reshape(*r.shape, len(self.reports))

    def signals(self, whisker: Whisker, contact: Array, *, model: str | None = None) -> Encoded:
        """Chances (..., 2ⁿ − 1) of all patterns but "all touch", of a contact (..., 1)."""
        straight(whisker)
        r = np.asarray(contact, dtype=float)[..., 0]
        in_reach = (r > 0) & (r <= self.farthest(whisker))
        chances = self._patterns(whisker, np.where(in_reach, r, whisker.length))
        outcome = np.where(in_reach, Outcome.HELD, Outcome.OUT_OF_REACH).astype(np.int8)
        return np.where(in_reach[..., None], chances[..., :-1], np.nan), outcome

    def default_noise(self) -> Events:
        """Events that are never misreported."""
        return Events(self.reports)

    def farthest(self, whisker: Whisker) -> float:
        """As far out as there may be poles, m."""
        return self.reach * float(self._lengths(whisker).max())

    # -- inverse -------------------------------------------------------------------------------

    def interval(self, whisker: Whisker, touches: ArrayLike) -> tuple[float, float, Outcome]:
        """Between which distances just these whiskers touch, were nothing uncertain.

        Parameters
        ----------
        whisker : Whisker
        touches : array, shape (n,)
            1 for each whisker that touches, else 0; the observer's own first.

        Returns
        -------
        low, high : float
            m. NaN where no distance gives the pattern; `high` is `farthest` where none bounds it.
        outcome : Outcome
            `HELD`, `NO_TOUCH` or `CONTRADICTORY`.
        """
        pattern = finite("touches", touches, "give 0 or 1 for each whisker")
        if not np.any((pattern == self.reports).all(axis=-1)):
            raise Refusal(
                f"touches must be {self.reports.shape[1]} numbers, 0 or 1",
                pattern.tolist(),
                "write 1 for each whisker that touches",
            )
        x, y = np.concatenate([np.zeros((1, 2)), self.bases]).T
        lengths, (low, high) = self._lengths(whisker), self.sweeps.T
        with np.errstate(divide="ignore", invalid="ignore"):
            # Where the axis crosses the arc of a tip, and either edge of a sector.
            half = np.sqrt(lengths**2 - y**2)
            cuts = np.concatenate([x - half, x + half, x - y / np.tan(low), x - y / np.tan(high)])
        cuts = np.append(cuts[np.isfinite(cuts)], [*x, 0.0, self.farthest(whisker)])
        cuts = np.unique(np.clip(cuts, 0.0, self.farthest(whisker)))
        middle = (cuts[:-1] + cuts[1:]) / 2
        along, angle = middle[:, None] - x, self._angle(-y, middle[:, None] - x)
        touch = (np.hypot(along, y) <= lengths) & (low <= angle) & (angle <= high)
        fits = np.flatnonzero((touch == pattern).all(axis=1))
        if not fits.size:
            return np.nan, np.nan, Outcome.CONTRADICTORY
        outcome = Outcome.HELD if pattern.any() else Outcome.NO_TOUCH
        return float(cuts[fits[0]]), float(cuts[fits[-1] + 1]), outcome

    def reading_outcome(self, whisker: Whisker, reading: Array) -> Codes:
        """What `interval` says of readings (..., n): `HELD`, `NO_TOUCH` or `CONTRADICTORY`."""
        reports, back = np.unique(
            reading.reshape(-1, reading.shape[-1]), axis=0, return_inverse=True
        )
        outcome = np.array([self.interval(whisker, row)[2] for row in reports], dtype=np.int8)
        return outcome[back.reshape(reading.shape[:-1])]


def _together(touch: Array) -> Array:
    """Chances (..., 2ᵐ) of the patterns of m whiskers with independent chances (..., m)."""
    shape = touch.shape[:-1]
    out = np.ones((*shape, 1))
    for k in range(touch.shape[-1]):
        chance = np.stack([1 - touch[..., k], touch[..., k]], axis=-1)
        out = (out[..., :, None] * chance[..., None, :]).reshape(*shape, 2 ** (k + 1))
    return out
