"""The whisker as an encoding: a distance encoded by a cue, or by several looks.

Independent looks at one distance add their precisions. What is encoded is the distance itself, with
the sd that they leave together, to first order in the noise.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from .._util import checks
from .._util.refusals import Refusal
from .._util.values import Array, Codes, Fields
from ..cues import Compliance, ForceMap
from ..inference.observer import Observer
from ..mechanics.contact import Outcome
from ..receptors import ReceptorNoise
from ..sensitivity import weber_propagation

__all__ = ["CueEncoding", "PooledEncoding"]


@dataclass(frozen=True, repr=False)
class CueEncoding(Fields):
    """A radial distance encoded through a whisker and a cue, with any receptor noise.

    One signal (the compliance cue): the two noisy signals are the decision variables, exactly; of
    log-normal noise their logarithms, and of receptors that level off their responses. Several
    signals (the moment–axial-force map): noise is carried to the distance to first order, so the
    encoding is the distance, with the propagated JND as its sd.

    Parameters
    ----------
    observer : Observer
        Its whisker, cue and receptors. The Weber fraction that is fitted is that of the first
        signal that has one; others keep their ratio to it. Of one signal with log-normal noise
        it is σ, the sd of the logarithm. Noise that does not scale with a Weber fraction is taken
        as known: a floor, that of an angle, the prior sd of a nuisance parameter. The division is
        exact for as many signals as unknowns with uncorrelated noise. A signal above a hard
        ceiling gives no encoding.
    deflection_angle : float, optional
        rad; of every contact, where the cue does not know it. Any further unknown has its prior's
        median.
    unit : float
        Metres in one unit of the stimulus: 1e-3 where trials are in millimetres.

    Raises
    ------
    ValueError
        For a unit that is not positive, a cue that reports events alone, and where the cue needs a
        deflection angle.

    Examples
    --------
    >>> from weberwhisk import Observer, Whisker, cues
    >>> observer = Observer(Whisker(50e-3, 100e-6, 5e-6), cues.Compliance())
    >>> CueEncoding(observer, unit=1e-3).direction
    -1
    """

    observer: Observer
    deflection_angle: float | None = None
    unit: float = 1.0

    def __post_init__(self) -> None:
        hint = "write ww.Observer(whisker, ww.cues.Compliance()), say"
        checks.kind("observer", self.observer, "an Observer", "unknowns", hint)
        checks.positive("unit", self.unit, "give metres per unit of the stimulus, such as 1e-3")
        cue = self.observer.cue
        if self.observer.noise.is_categorical:
            raise Refusal(
                f"{cue!r} reports events, all or none, which leave no two noisy signals to compare",
                remedy="write ww.cues.Compliance(), say",
            )
        if self.deflection_angle is not None:
            hint = "give radians, such as 0.2"
            checks.number("deflection_angle", self.deflection_angle, hint)
            checks.angle("deflection_angle", self.deflection_angle, hint)
        if "deflection_angle" in self.observer.unknowns and self.deflection_angle is None:
            raise Refusal(
                f"{cue!r} needs the deflection angle of the contacts",
                "none",
                "write deflection_angle=np.radians(10), say",
            )

    @property
    def domain(self) -> tuple[float, float]:
        return (0.0, float(self.observer.whisker.length) / self.unit)

    @cached_property
    def direction(self) -> int:
        if not self._one_signal:
            return 1
        encoded = self.mean(np.linspace(0.02, 0.98, 49) * self.domain[1])
        encoded = encoded[np.isfinite(encoded)]
        return 1 if encoded.size > 1 and encoded[-1] > encoded[0] else -1

    @property
    def _one_signal(self) -> bool:
        one = len(self.observer.cue.signal_names) == 1
        return one and self.observer.noise.gaussian_on is not None

    def _contact(self, stimulus: ArrayLike) -> Array:
        r = np.asarray(stimulus, dtype=float) * self.unit
        known = [r]
        if "deflection_angle" in self.observer.unknowns:
            known.append(np.full_like(r, self.deflection_angle or 0.0))
        return self.observer.at_middle(np.stack(known, axis=-1))

    def _signals(self, stimulus: ArrayLike) -> tuple[Array, Codes]:
        signals, outcome = self.observer.signals(self._contact(stimulus))
        blind = np.asarray(self.observer.noise.uninformative(signals).any(axis=-1))
        return np.where(blind[..., None], np.nan, signals), outcome

    def mean(self, stimulus: ArrayLike) -> Array:
        signals, outcome = self._signals(stimulus)
        if not self._one_signal:
            encoded = (outcome == Outcome.HELD) & np.isfinite(signals).all(axis=-1)
            return np.where(encoded, np.asarray(stimulus, dtype=float), np.nan)
        noise = self.observer.noise
        if noise.gaussian_on == "log":
            return np.log(np.abs(signals[..., 0]))
        return np.asarray(noise.mean(signals)[..., 0], dtype=float)

    @cached_property
    def _fractions(self) -> Array:
        return self.observer.noise.weber_fractions(len(self.observer.cue.signal_names))

    @property
    def own_fraction(self) -> float:
        """The first Weber fraction of the receptors, 1 where there is none."""
        k = self._fractions
        return float(k[k > 0][0]) if k.any() else 1.0

    def sd_per_weber_fraction(self, stimulus: ArrayLike) -> Array:
        noise, k, first = self.observer.noise, self._fractions, self.own_fraction
        encoded = self.mean(stimulus)
        if not k.any():
            return np.where(np.isfinite(encoded), 0.0, np.nan)
        if self._one_signal:
            signals, _ = self._signals(stimulus)
            if noise.gaussian_on == "log":
                return np.where(np.isfinite(encoded), 1.0, np.nan)
            return np.asarray(_varied(noise, k.size, 1.0, floor=False).sd(signals)[..., 0] / first)
        own = self.observer.bounded == len(self.observer.unknowns)
        if k.all() and own and not noise.floors(k.size).any():
            jnd = self._jnd(stimulus, _varied(noise, k.size, 1.0, floor=False))
        else:  # some is a floor, or of a prior: what is added as the Weber fractions double
            both = (_varied(noise, k.size, factor, floor=True) for factor in (2.0, 1.0))
            more, less = (self._jnd(stimulus, each) for each in both)
            jnd = np.sqrt(np.maximum(more**2 - less**2, 0.0) / 3)
        return jnd / first

    def _jnd(self, stimulus: ArrayLike, noise: ReceptorNoise) -> Array:
        """Noise carried to distance, in the stimulus's unit; NaN where signals leave it open."""
        observer = _with_noise(self.observer, noise)
        jnd = weber_propagation(observer, self._contact(stimulus)) / self.unit
        # Of signals that do not determine distance (a cylinder's map) there is none.
        return np.where(np.isfinite(jnd), jnd, np.nan)

    def floor_sd(self, stimulus: ArrayLike) -> Array:
        """Sd of the noise that does not go with the Weber fraction, carried to the encoding."""
        noise, k = self.observer.noise, self._fractions
        if self._one_signal and not k.any():
            return noise.as_gaussian(self._signals(stimulus)[0])[1][..., 0]
        if self._one_signal:
            return np.full(np.shape(stimulus), float(noise.floors(1)[0]))
        whole = self._jnd(stimulus, noise)
        if not k.any():
            return whole
        weber = self.own_fraction * self.sd_per_weber_fraction(stimulus)
        floor = np.sqrt(np.maximum(whole**2 - weber**2, 0.0))
        return np.where(floor > 1e-7 * whole, floor, 0.0)

    def outcome(self, stimulus: float) -> str:
        """What becomes of the contact at one distance, in words."""
        signals, reached = self.observer.signals(self._contact(stimulus))
        outcome = Outcome(int(reached))
        if outcome == Outcome.HELD and self.observer.noise.uninformative(signals).any():
            return "the receptors are saturated there"
        if outcome == Outcome.HELD:
            return "these signals do not determine distance on this whisker"
        return outcome.message

    @property
    def described(self) -> str:
        """What a distance is encoded through, in words."""
        whisker, ends = self.observer.whisker, ""
        if whisker.radius_ratio != 1:
            ends = f" to {1e6 * whisker.tip_radius:.3g}"
        shape = "tapered" if ends else "cylindrical"
        if whisker.curvature:
            shape += f", curved ({whisker.curvature:+.3g} /m)"
        if whisker.hinge_stiffness is not None:
            shape += f", hinged ({whisker.hinge_stiffness:.3g} N m/rad)"
        return (
            f"a {shape} whisker ({1e3 * whisker.length:.3g} mm long, radius "
            f"{1e6 * whisker.base_radius:.3g}{ends} µm) by its {self._cue_in_words()}"
        )

    def _cue_in_words(self) -> str:
        cue, at = self.observer.cue, ""
        if isinstance(cue, Compliance):
            tap = f"{np.degrees(cue.tap_angle):.3g}°" if cue.tap_angle else "a light tap"
            return f"rotational compliance (§2e; {tap})"
        if self.deflection_angle is not None:
            at = f"; deflected by {np.degrees(self.deflection_angle):.3g}°"
        if isinstance(cue, ForceMap):
            return f"{' and '.join(cue.signal_names).replace('_', ' ')} (§2f{at})"
        return f"{cue!r}{at}"


@lru_cache(maxsize=64)
def _with_noise(observer: Observer, noise: ReceptorNoise) -> Observer:
    """An observer with other noise, kept: it chooses its model anew, a sixth of a power's time."""
    return replace(observer, noise=noise)


def _varied(noise: ReceptorNoise, signals: int, factor: float, *, floor: bool) -> ReceptorNoise:
    """The same receptors with their Weber fractions times a factor, with or without their floor."""
    other = noise.with_weber_fraction(noise.weber_fractions(signals) * factor)
    return other if floor else other.without_floor()


class _Distance(CueEncoding):
    """Distance itself, also where one signal would do for a decision."""

    _one_signal = False


@dataclass(frozen=True, repr=False)
class PooledEncoding(Fields):
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
        For no looks, looks in different units, another number of offsets, and looks with an
        unknown stiffness or the like, which all touches share, so that it does not average out.

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

    direction: ClassVar[int] = 1  # a greater distance is encoded as greater
    looks: tuple[CueEncoding, ...]
    offsets: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        hint = "write ww.behaviour.PooledEncoding.of_touches(observer, [0.1, 0.2]), say"
        given = tuple(checks.several("looks", self.looks, hint))
        for look in given:
            checks.kind("a look", look, "a CueEncoding", "own_fraction", hint)
        if not given:
            raise Refusal("looks is empty", remedy=hint)
        if len({look.unit for look in given}) > 1:
            raise Refusal(
                "the looks have stimuli in different units", remedy="give all the same unit="
            )
        for look in given:
            observer = look.observer
            if observer.bounded < len(observer.unknowns):
                raise Refusal(
                    f"all looks share what {observer.cue!r} leaves unknown "
                    f"({', '.join(observer.unknowns[observer.bounded :])}), which pooling "
                    "would average away",
                    remedy="take a cue that knows it",
                )
        offsets = tuple(float(d) for d in self.offsets) or (0.0,) * len(given)
        if len(offsets) != len(given):
            raise Refusal(
                f"offsets has {len(offsets)} numbers for {len(given)} looks",
                remedy="give one a look",
            )
        checks.finite("offsets", offsets, "give the distances between the bases")
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
            checks.finite("deflection_angles", deflection_angles, "give radians, one a touch")
        )
        return cls(tuple(CueEncoding(observer, float(a), unit) for a in angles))

    @property
    def unit(self) -> float:
        """Metres in one unit of the stimulus."""
        return self.looks[0].unit

    @property
    def domain(self) -> tuple[float, float]:
        """Distances that any look reaches."""
        ends = [o + np.array(k.domain) for k, o in zip(self.looks, self.offsets, strict=True)]
        low, high = min(e[0] for e in ends), max(e[1] for e in ends)
        return float(max(low, 0.0)), float(high)

    def mean(self, stimulus: ArrayLike) -> Array:
        """The distance itself, NaN where no look informs it."""
        x = np.asarray(stimulus, dtype=float)
        return np.where(np.isfinite(self.sd_per_weber_fraction(x)), x, np.nan)

    def sd_per_weber_fraction(self, stimulus: ArrayLike) -> Array:
        """Sd of the pooled distance, for a Weber fraction of 1."""
        k = self.looks[0].own_fraction
        return self._pooled(
            stimulus, lambda look, x: look.own_fraction / k * look.sd_per_weber_fraction(x)
        )

    def floor_sd(self, stimulus: ArrayLike) -> Array:
        """What is left of the pooled sd without a Weber fraction, at the receptors' own."""
        together = self._pooled(
            stimulus,
            lambda look, x: np.hypot(
                look.own_fraction * look.sd_per_weber_fraction(x), look.floor_sd(x)
            ),
        )
        weber = self.looks[0].own_fraction * self.sd_per_weber_fraction(stimulus)
        floor = np.sqrt(np.maximum(together**2 - weber**2, 0.0))
        return np.where(floor > 1e-6 * together, floor, 0.0)

    def outcome(self, stimulus: float) -> str:
        """Why no look gives a signal at a distance, in words: the first look's reason."""
        return self.looks[0].outcome(stimulus - self.offsets[0])

    @property
    def described(self) -> str:
        each = Counter(look.described for look in self.looks)
        return ", and ".join(f"{n} independent looks through {words}" for words, n in each.items())

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
