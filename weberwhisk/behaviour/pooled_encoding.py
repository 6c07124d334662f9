"""Decisions on more than one look: several touches, several whiskers, a whole array.

Independent looks at one distance add their precisions. What is encoded is the distance itself, with
the sd that they leave together, to first order in the noise.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _checks
from .cue_encoding import CueEncoding

Array = NDArray[np.float64]


class _Distance(CueEncoding):
    """The distance that a cue tells, also where its one signal would do for a decision."""

    _one_signal = False


@dataclass(frozen=True)
class PooledEncoding:
    """One distance from several independent looks, pooled by their precision.

    Parameters
    ----------
    looks : sequence of CueEncoding
        A look each: a touch, with its own deflection angle, or a whisker. All in one unit.
    offsets : sequence of float, optional
        How far the base of each look's whisker lies in front of where stimuli are measured from,
        along the line to the object, in their unit; 0 by default.

    Raises
    ------
    ValueError
        For no looks, looks in different units, another number of offsets, and looks that leave a
        stiffness or the like unknown, which touches share and no number of them averages away.

    Notes
    -----
    Precisions add, 1/σ² = Σ 1/σᵢ², over the looks that reach the object: n equal touches give
    σ/√n. The Weber fraction is that of a single receptor in a single look. Where a part of the
    noise does not go with it, the floor is exact at the receptors' own Weber fraction, and for
    equal looks at any. See `weberwhisk.touches` for the posterior of such a decision.

    Examples
    --------
    >>> import weberwhisk as ww
    >>> observer = ww.Observer(ww.Whisker(50e-3, 100e-6, 5e-6), ww.cues.ForceMap())
    >>> one, four = (PooledEncoding.of_touches(observer, [0.2] * n) for n in (1, 4))
    >>> (one.sd_per_weber_fraction(20e-3) / four.sd_per_weber_fraction(20e-3)).round(6)
    np.float64(2.0)
    """

    looks: tuple[CueEncoding, ...]
    offsets: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        hint = "write PooledEncoding.of_touches(observer, [0.1, 0.2]), say"
        given = tuple(_checks.several("looks", self.looks, hint))
        for look in given:
            _checks.kind("a look", look, "a CueEncoding", "has_weber_fraction", hint)
        if not given:
            raise ValueError(f"looks is empty; {hint}.")
        if len({look.unit for look in given}) > 1:
            raise ValueError("the looks have stimuli in different units; give all the same unit=.")
        for look in given:
            observer = look.observer
            if observer.bounded < len(observer.unknowns):
                raise ValueError(
                    f"all looks share what {observer.cue!r} leaves unknown "
                    f"({', '.join(observer.unknowns[observer.bounded :])}), which pooling would "
                    "average away; take a cue that knows it."
                )
        offsets = tuple(float(d) for d in self.offsets) or (0.0,) * len(given)
        if len(offsets) != len(given):
            raise ValueError(
                f"offsets has {len(offsets)} numbers for {len(given)} looks; give one a look."
            )
        _checks.finite("offsets", offsets, "give the distances between the bases")
        object.__setattr__(self, "looks", given)
        object.__setattr__(self, "offsets", offsets)

    @classmethod
    def of_touches(
        cls, observer: Any, deflection_angles: ArrayLike, *, unit: float = 1.0
    ) -> PooledEncoding:
        """Touches of one whisker, each with its own deflection angle, rad.

        A cue that does not need the angle takes them for the number of touches alone.
        """
        angles = np.atleast_1d(
            _checks.finite("deflection_angles", deflection_angles, "give radians, one a touch")
        )
        return cls(tuple(CueEncoding(observer, float(a), unit) for a in angles))

    @property
    def unit(self) -> float:
        """Metres in one unit of the stimulus."""
        return self.looks[0].unit

    @property
    def direction(self) -> int:
        """A greater distance is encoded as greater."""
        return 1

    @property
    def domain(self) -> tuple[float, float]:
        """Distances that any look reaches."""
        ends = [o + np.array(k.domain) for k, o in zip(self.looks, self.offsets, strict=True)]
        low, high = min(e[0] for e in ends), max(e[1] for e in ends)
        return float(max(low, 0.0)), float(high)

    def mean(self, stimulus: ArrayLike) -> Array:
        """The distance, NaN where no look reaches it."""
        x = np.asarray(stimulus, dtype=float)
        return np.where(np.isfinite(self.sd_per_weber_fraction(x)), x, np.nan)

    def sd_per_weber_fraction(self, stimulus: ArrayLike) -> Array:
        """Sd of the pooled distance, for a Weber fraction of 1."""
        k = _own(self.looks[0])
        return self._pooled(
            stimulus, lambda look, x: _own(look) / k * look.sd_per_weber_fraction(x)
        )

    def floor_sd(self, stimulus: ArrayLike) -> Array:
        """What is left of the pooled sd without a Weber fraction, at the receptors' own."""
        together = self._pooled(
            stimulus,
            lambda look, x: np.hypot(_own(look) * look.sd_per_weber_fraction(x), look.floor_sd(x)),
        )
        weber = _own(self.looks[0]) * self.sd_per_weber_fraction(stimulus)
        floor = np.sqrt(np.maximum(together**2 - weber**2, 0.0))
        return np.where(floor > 1e-6 * together, floor, 0.0)

    def outcome(self, stimulus: float) -> str:
        """Why no look gives a signal at a distance, in words: the first look's reason."""
        return self.looks[0].outcome(stimulus - self.offsets[0])

    def _pooled(self, stimulus: ArrayLike, sd: Callable[[CueEncoding, Array], Array]) -> Array:
        x = np.asarray(stimulus, dtype=float)
        precision = np.zeros(x.shape)
        done: dict[tuple[Any, ...], Array] = {}
        for look, offset in zip(self.looks, self.offsets, strict=True):
            key = (look, offset)
            if key not in done:
                distance = _Distance(look.observer, look.deflection_angle, look.unit)
                low, high = look.domain
                inside = (x - offset > low) & (x - offset < high)
                own = sd(distance, np.where(inside, x - offset, 0.5 * (low + high)))
                with np.errstate(divide="ignore"):
                    done[key] = np.where(inside & np.isfinite(own), own**-2.0, 0.0)
            precision += done[key]
        with np.errstate(divide="ignore"):
            return np.where(precision > 0, precision**-0.5, np.nan)


def _own(look: CueEncoding) -> float:
    """The Weber fraction of a look's receptors."""
    k = look.observer.noise.weber_fractions(len(look.observer.cue.signal_names))
    return float(k[k > 0][0]) if k.any() else 1.0


@dataclass(frozen=True)
class PlaceEncoding:
    """A pole that slides along a line, sensed by all whiskers of an array that touch it.

    Parameters
    ----------
    observer : ArrayObserver
        The whiskers where they are, their cues and receptors.
    start : (float, float)
        x and y, m, in head coordinates, where the stimulus is 0.
    direction_deg : float
        Which way the pole goes: 0 to the right of the head, 90 rostrally.
    length : float
        How far, in the stimulus's unit.
    unit : float
        Metres in one unit of the stimulus.
    weber_fraction : float
        Of the receptors of `observer`, by which its sds are divided.
    sideways_known : bool
        Whether the animal knows on which line the pole slides.

    Notes
    -----
    The sd is that of the Fisher information of all whiskers together, [I⁻¹]ₛₛ^½ along the line (or
    Iₛₛ^−½ where the line is known). What is known of azimuths, `angle_sd`, does not go with k: it
    is counted as if it did.

    Examples
    --------
    >>> import weberwhisk as ww
    >>> array = ww.WhiskerArray("rat", "right").protract(np.radians(40))
    >>> few, all_ = (PlaceEncoding(ww.ArrayObserver(a), (16e-3, 5e-3), length=8e-3)
    ...              for a in (array.only(["C3"]), array))
    >>> bool(all_.sd_per_weber_fraction(4e-3) < few.sd_per_weber_fraction(4e-3))
    True
    """

    observer: Any
    start: tuple[float, float]
    direction_deg: float = 0.0
    length: float = 10e-3
    unit: float = 1.0
    weber_fraction: float = 0.1
    sideways_known: bool = True

    def __post_init__(self) -> None:
        hint = "write ArrayObserver(WhiskerArray('rat', 'right').protract(0.7)), say"
        _checks.kind("observer", self.observer, "an ArrayObserver", "touching", hint)
        _checks.positive("length", self.length, "write 10e-3, say")
        _checks.positive("unit", self.unit, "give metres per unit of the stimulus, such as 1e-3")
        _checks.positive("weber_fraction", self.weber_fraction, "write 0.1, say")
        if _checks.finite("start", self.start, "give x and y in metres").shape != (2,):
            raise ValueError(
                f"start must be x and y, got {self.start!r}; write (20e-3, 5e-3), say."
            )
        _checks.number("direction_deg", self.direction_deg, "give degrees")

    @property
    def direction(self) -> int:
        """A place farther along the line is encoded as greater."""
        return 1

    @property
    def domain(self) -> tuple[float, float]:
        """The ends of the line."""
        return 0.0, float(self.length)

    def mean(self, stimulus: ArrayLike) -> Array:
        """The place along the line, NaN where no whisker tells it."""
        x = np.asarray(stimulus, dtype=float)
        return np.where(np.isfinite(self.sd_per_weber_fraction(x)), x, np.nan)

    def sd_per_weber_fraction(self, stimulus: ArrayLike) -> Array:
        """Sd of the place along the line, for a Weber fraction of 1."""
        x = np.asarray(stimulus, dtype=float)
        turn = np.radians(self.direction_deg)
        along = np.array([np.cos(turn), np.sin(turn)])
        axes = np.stack([along, [-along[1], along[0]]])
        places = np.asarray(self.start) + self.unit * x.reshape(-1, 1) * along
        information = axes @ self.observer.information(places).sum(axis=1) @ axes.T
        precision = information[:, 0, 0].copy()
        if not self.sideways_known:
            with np.errstate(divide="ignore", invalid="ignore"):
                precision -= np.nan_to_num(information[:, 0, 1] ** 2 / information[:, 1, 1])
        known = precision > 1e-12 * np.maximum(information[:, 0, 0], 1e-300)
        with np.errstate(divide="ignore", invalid="ignore"):
            sd = np.where(known, precision**-0.5, np.nan)
        return sd.reshape(x.shape) / (self.unit * self.weber_fraction)

    def outcome(self, stimulus: float) -> str:
        """Why no place is known, in words."""
        return "no whisker touches the pole there"
