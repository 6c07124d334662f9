"""Vibrissa length (§2a): what a touch of the tip, of the shaft, or none tells of distance."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtr

from .._checks import finite, non_negative_number, positive_number
from ..mechanics.contact import Outcome
from ..receptors import Events
from ..whisker import Whisker
from .protocol import Array, Cue, Felt, readings, straight


@dataclass(frozen=True, eq=False, repr=False)
class VibrissaLength(Cue):
    """Radial distance from whether a whisker of uncertain length touches, and with its tip (§2a).

    The whisker points at the object. It touches if it is long enough; the touch feels like one of
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
        Part of the whisker at its end within which a contact feels as one of the tip. Assumed.
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
                raise ValueError(
                    f"{name} must be below 1, got {getattr(self, name):g}; write 0.1, say."
                )
        if self.reach <= 1:
            raise ValueError(
                f"Objects must be possible beyond the whisker's tip, got reach={self.reach:g}; "
                "write 1.5, say."
            )

    def _missing(self, whisker: Whisker, r: Array) -> tuple[Array, Array]:
        """The chance of being shorter than r, and its slope.

        Whole: ln length is normal. Broken: 1 − E[(1 − r/length)₊], as the break is anywhere.
        """
        sigma = np.sqrt(np.log1p(self.spread**2))
        log_median = np.log(whisker.length) - 0.5 * sigma**2
        z = (np.log(r) - log_median) / sigma
        density = np.exp(-0.5 * z**2) / (np.sqrt(2 * np.pi) * sigma * r)
        # E[1/length; length > r]
        inverse = np.exp(0.5 * sigma**2 - log_median) * ndtr(-z - sigma)
        chance = ndtr(z) + self.damage * r * inverse
        return chance, (1 - self.damage) * density + self.damage * inverse

    def signals(self, whisker: Whisker, contact: Array, *, model: str | None = None) -> Felt:
        """Chances (..., 2) of no touch and of a touch with the tip, at a contact (..., 1)."""
        straight(whisker)
        r = np.asarray(contact, dtype=float)[..., 0]
        known = (r > 0) & (r <= self.farthest(whisker))
        r = np.where(known, r, whisker.length)
        none, not_shaft = (self._missing(whisker, at)[0] for at in (r, r / (1 - self.tip_zone)))
        chances = np.stack([none, not_shaft - none], axis=-1)
        outcome = np.where(known, Outcome.HELD, Outcome.OUT_OF_REACH).astype(np.int8)
        return np.where(known[..., None], chances, np.nan), outcome

    def jacobian(self, whisker: Whisker, contact: Array, *, model: str | None = None) -> Array:
        """Slopes of the chances, (..., 2, 1)."""
        r = np.asarray(contact, dtype=float)[..., 0]
        stretch = 1 / (1 - self.tip_zone)
        none = self._missing(whisker, r)[1]
        not_shaft = self._missing(whisker, r * stretch)[1] * stretch
        return np.stack([none, not_shaft - none], axis=-1)[..., None]

    def default_noise(self) -> Events:
        """Events that are never misreported."""
        return Events(self.reports)

    def farthest(self, whisker: Whisker) -> float:
        """As far out as there may be objects, m."""
        return self.reach * float(whisker.length)

    def radial_distance(
        self, whisker: Whisker, reading: ArrayLike
    ) -> tuple[Array, NDArray[np.int8]]:
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

    def reading_outcome(self, whisker: Whisker, reading: Array) -> NDArray[np.int8]:
        """`HELD` after a touch of the tip, else `NO_TOUCH` or `TIP_NOT_TOUCHED`, (...)."""
        return self.radial_distance(whisker, reading)[1]
