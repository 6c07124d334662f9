"""The whisker as an encoding: a radial distance encoded by a cue, with its receptors' noise."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _checks
from .._deprecated import renamed_attribute
from ..jnd import weber_propagation
from ..mechanics.contact import Outcome
from ..observer import Observer
from ..receptors import ReceptorNoise

Array = NDArray[np.float64]


@dataclass(frozen=True)
class CueEncoding:
    """A radial distance encoded through a whisker and a cue, with any receptor noise.

    One signal (the compliance cue): the two noisy signals are the decision variables, exactly; of
    log-normal noise their logarithms, and of receptors that level off their responses. Several
    signals (the moment–axial-force map): noise is carried to the distance to first order, so the
    encoding is the distance, with the propagated JND as its sd.

    Parameters
    ----------
    observer : Observer
        Its whisker, cue and receptors. The Weber fraction that is fitted is that of the first
        signal that has one, those of others keep their ratio to it (of one signal with log-normal
        noise it is σ, the sd of the logarithm). Whatever noise does not go with a Weber fraction
        is taken as known: a floor, that of an angle, what a prior leaves open of a further
        unknown; exactly where the noise of as many signals as unknowns is uncorrelated. A signal
        above a hard ceiling gives no encoding.
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
    unit_sd = renamed_attribute("CueEncoding", "unit_sd", "sd_per_weber_fraction")

    def __post_init__(self) -> None:
        hint = "write Observer(whisker, cues.Compliance()), say"
        _checks.kind("observer", self.observer, "an Observer", "unknowns", hint)
        _checks.positive("unit", self.unit, "give metres per unit of the stimulus, such as 1e-3")
        cue = self.observer.cue
        if self.observer.noise.is_categorical:
            raise ValueError(
                f"{cue!r} reports events, all or none, which leave no two noisy signals to "
                "compare; write cues.Compliance(), say."
            )
        if self.deflection_angle is not None:
            hint = "give radians, such as 0.2"
            _checks.number("deflection_angle", self.deflection_angle, hint)
            _checks.angle("deflection_angle", self.deflection_angle, hint)
        if "deflection_angle" in self.observer.unknowns and self.deflection_angle is None:
            raise ValueError(
                f"{cue!r} needs the deflection angle of the contacts, got none; "
                "write deflection_angle=np.radians(10), say."
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

    def _signals(self, stimulus: ArrayLike) -> tuple[Array, NDArray[np.int8]]:
        signals, outcome = self.observer.signals(self._contact(stimulus))
        blind = np.asarray(self.observer.noise.uninformative(signals).any(axis=-1))
        return np.where(blind[..., None], np.nan, signals), outcome

    def mean(self, stimulus: ArrayLike) -> Array:
        signals, outcome = self._signals(stimulus)
        if not self._one_signal:
            held = (outcome == Outcome.HELD) & np.isfinite(signals).all(axis=-1)
            return np.where(held, np.asarray(stimulus, dtype=float), np.nan)
        noise = self.observer.noise
        if noise.gaussian_on == "log":
            return np.log(np.abs(signals[..., 0]))
        return np.asarray(noise.mean(signals)[..., 0], dtype=float)

    @property
    def has_weber_fraction(self) -> bool:
        """Whether any noise goes with a Weber fraction, so that choices can tell it."""
        return bool(self._fractions.any())

    @cached_property
    def _fractions(self) -> Array:
        return self.observer.noise.weber_fractions(len(self.observer.cue.signal_names))

    def sd_per_weber_fraction(self, stimulus: ArrayLike) -> Array:
        noise, k = self.observer.noise, self._fractions
        encoded = self.mean(stimulus)
        if not k.any():
            return np.where(np.isfinite(encoded), 0.0, np.nan)
        first = float(k[k > 0][0])
        if self._one_signal:
            signals, _ = self._signals(stimulus)
            if noise.gaussian_on == "log":
                return np.where(np.isfinite(encoded), 1.0, np.nan)
            return np.asarray(_varied(noise, k.size, 1.0, floor=False).sd(signals)[..., 0] / first)
        own = self.observer.bounded == len(self.observer.unknowns)
        if k.all() and own:
            jnd = self._jnd(stimulus, _varied(noise, k.size, 1.0, floor=False))
        else:  # some is not Weber's, or of a prior: what is added as the Weber fractions double
            both = (_varied(noise, k.size, factor, floor=True) for factor in (2.0, 1.0))
            more, less = (self._jnd(stimulus, each) for each in both)
            jnd = np.sqrt(np.maximum(more**2 - less**2, 0.0) / 3)
        return jnd / first

    def _jnd(self, stimulus: ArrayLike, noise: ReceptorNoise) -> Array:
        """Noise carried to distance, in the stimulus's unit; NaN where signals leave it open."""
        observer = replace(self.observer, noise=noise)
        jnd = weber_propagation(observer, self._contact(stimulus)) / self.unit
        # Signals that cannot tell distance (a cylinder's map) leave nothing to judge by.
        return np.where(np.isfinite(jnd), jnd, np.nan)

    def floor_sd(self, stimulus: ArrayLike) -> Array:
        """Sd of the noise that does not go with the Weber fraction, carried to the encoding."""
        noise, k = self.observer.noise, self._fractions
        if self._one_signal:
            return np.full(np.shape(stimulus), float(noise.floors(1)[0]))
        whole = self._jnd(stimulus, noise)
        if not k.any():
            return whole
        weber = float(k[k > 0][0]) * self.sd_per_weber_fraction(stimulus)
        floor = np.sqrt(np.maximum(whole**2 - weber**2, 0.0))
        return np.where(floor > 1e-7 * whole, floor, 0.0)

    def outcome(self, stimulus: float) -> str:
        """What becomes of the contact at one distance, in words."""
        signals, reached = self.observer.signals(self._contact(stimulus))
        outcome = Outcome(int(reached))
        if outcome == Outcome.HELD and self.observer.noise.uninformative(signals).any():
            return "the receptors are saturated there"
        if outcome == Outcome.HELD:
            return "these signals cannot tell distance on this whisker"
        return outcome.message


def _varied(noise: ReceptorNoise, signals: int, factor: float, *, floor: bool) -> ReceptorNoise:
    """The same receptors with their Weber fractions times a factor, with or without their floor."""
    other = noise.with_weber_fraction(noise.weber_fractions(signals) * factor)
    return other if floor else other.without_floor()
