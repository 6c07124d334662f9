"""What the rest of the package asks of a cue, how to write one, and several cues on one contact.

A cue is a frozen dataclass of `Cue` with its signals, and nothing more::

    @dataclass(frozen=True, eq=False, repr=False)
    class MomentAlone(Cue):
        deflection_angle: float = 0.1
        signal_names = ("moment",)

        def signals(self, whisker, contact, *, model=None):
            bent = press(whisker, contact[..., 0], self.deflection_angle, model=model)
            return np.asarray(bent.moment)[..., None], np.asarray(bent.outcome)

What else is asked has an answer here, to be overridden where the cue has a better one. One line in
`cues/__init__.py` lists it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from scipy.optimize import brentq

from .._util.checks import numbers, refuse_hinge, shown
from .._util.refusals import Refusal, argument
from .._util.values import Array, Codes, Value
from ..mechanics import Profile, rest_angle
from ..mechanics.contact import Outcome
from ..mechanics.forward import ForwardModel, forward_of
from ..receptors import GeneralisedWeber, Joint, ReceptorNoise, Weber
from ..whisker import Whisker

__all__ = [
    "ANGLE_SD", "Cue", "Encoded", "Fused", "MeasuredAngle", "a_cue", "is_curved", "reach_at",
    "readings", "straight",
]  # fmt: skip

#: Signals (..., S), NaN where the contact is not held, and the `Outcome` (...).
Encoded = tuple[Array, Codes]
#: Sd of an angle, rad: one degree. No receptor value is known for single whiskers.
ANGLE_SD = float(np.radians(1.0))
#: Unknowns that may be of either sign, rad and 1/m.
SIGNED = ("azimuth", "friction_angle", "roll", "surface_tilt", "curvature_offset")


class Cue(Value):
    """One of the paper's methods (§2a–h): from a contact to the signals that inform of it.

    A contact is an array whose last axis holds the cue's unknowns: radial distance (m), then, if
    it is one, the deflection angle (rad), then whatever else is not known (a stiffness, a side, a
    bearing), each with a proper prior. Cues are frozen: they compare and hash by value.
    """

    #: Whether curved whiskers will do, profiles, and friction.
    takes_curved: ClassVar[bool] = False

    @property
    def signal_names(self) -> tuple[str, ...]:
        """Names of the signals, in the order of the last axis of `signals`."""
        raise NotImplementedError

    @property
    def unknowns(self) -> tuple[str, ...]:
        """Names of the unknowns, ``"radial_distance"`` first."""
        return ("radial_distance",)

    @property
    def is_scale(self) -> bool:
        """Whether every signal is proportional to the last unknown."""
        return False

    @property
    def is_isotropic(self) -> bool:
        """Whether only directions change as contact and whisker rotate about the base tangent."""
        return False

    @property
    def is_smooth(self) -> bool:
        """Whether all signals are smooth functions of the contact, without kinks."""
        return True

    @property
    def circular(self) -> tuple[bool, ...]:
        """Which signals are angles that a whole turn leaves as they are."""
        return (False,) * len(self.signal_names)

    def signals(self, whisker: Whisker, contact: Array, *, model: str | None = None) -> Encoded:
        """Signals (..., S) of a contact (..., U), NaN where it is not held, and its `Outcome`.

        `model` names the model of the mechanics; without it the elastica's.
        """
        raise NotImplementedError

    def jacobian(self, whisker: Whisker, contact: Array, *, model: str | None = None) -> Array:
        """Derivatives of the signals with respect to the unknowns, (..., S, U).

        By differences, good to 1e-9 of smooth signals; to 2e-5 within 6e-6 of an edge, by one side.
        """
        contact = np.asarray(contact, dtype=float)
        columns = []
        for i in range(contact.shape[-1]):
            step = np.zeros_like(contact)
            size = np.abs(contact[..., i])
            if self.unknowns[i] in SIGNED:  # and next to 0 as well as at it
                size = np.maximum(size, 1.0)
            step[..., i] = 6e-6 * np.where(size == 0, 1.0, size)
            above, below = (
                self.signals(whisker, contact + s, model=model)[0] for s in (step, -step)
            )
            slope = (above - below) / (2 * step[..., i, None])
            if np.isnan(slope).any():
                here = self.signals(whisker, contact, model=model)[0]
                beside = np.where(np.isnan(above), here - below, above - here)
                slope = np.where(np.isnan(slope), beside / step[..., i, None], slope)
            columns.append(slope)
        return np.stack(columns, axis=-1)

    def forward(self, whisker: Any, contact: Array) -> ForwardModel:
        """The mechanics of contacts (..., U): with the friction, say, that is an unknown of theirs.

        Where the angle of contacts is not needed, anything may stand for it.
        """
        return forward_of(whisker)

    def farthest(self, whisker: Whisker) -> float:
        """Largest radial distance at which the cue works on this whisker, m: the tip."""
        return forward_of(whisker).reach

    def largest_angle(self, whisker: Any, radial_distance: Array) -> Array:
        """Largest deflection (...) at which the cue works, rad; infinite where the fold is.

        Cues that take curved whiskers are asked with the `forward` model of the contacts.
        """
        return np.full(np.shape(radial_distance), np.inf)

    def priors(self, whisker: Whisker) -> Mapping[str, Any]:
        """Frozen SciPy distributions of all unknowns but radial distance and deflection angle."""
        return {}

    def default_noise(self) -> ReceptorNoise:
        """Noise of the signals where the user names none: Weber's law, k = 0.1."""
        return Weber(0.1)

    def reading_outcome(self, whisker: Whisker, reading: Array) -> Codes:
        """What the method's own inverse makes of readings (..., R); `HELD` where it has none."""
        return np.zeros(reading.shape[:-1], dtype=np.int8)


def straight(
    whisker: Any,
    instead: str = "ww.cues.ForceMap(), ww.cues.Compliance() or ww.cues.BalanceOfMoments(), "
    "which take curved ones",
) -> None:
    """Refuse whiskers that most cues do not take: curved, hinged or rubbing ones, and profiles."""
    if not isinstance(whisker, Whisker):
        raise Refusal(
            "This cue needs a Whisker, straight and without friction",
            f"a {type(whisker).__name__}",
            "write ww.Whisker(50e-3, 100e-6, 5e-6), or take ww.cues.ForceMap()",
        )
    refuse_hinge(whisker, "This cue")
    if np.any(whisker.curvature):
        largest = float(np.max(np.abs(whisker.curvature)))
        raise Refusal(
            "This cue is for straight whiskers",
            f"curvature {largest:g} 1/m",
            "write " + argument("curvature", 0) + f", or take {instead}",
        )


def readings(name: str, value: Any, count: int) -> Array:
    """`value` as an array (..., count) for an inverse; what is infinite has none: NaN."""
    array = numbers(name, value, "give the base signals in SI units")
    if array.ndim == 0 or array.shape[-1] != count:
        raise Refusal(
            f"{name} must have {count} numbers along the last axis",
            f"shape {array.shape}",
            "give one for each signal",
        )
    return np.where(np.isfinite(array), array, np.nan)


def a_cue(value: Any) -> Cue:
    """`value` if it is a cue, else a refusal in one sentence."""
    if not isinstance(value, Cue):
        raise Refusal("A cue is needed", shown(value), "write ww.cues.ForceMap(), say")
    return value


def reach_at(whisker: Whisker | ForwardModel, deflection_angle: float, name: str) -> float:
    """Largest radial distance at which an angle is held: the tip, or where it flicks past, m.

    The angle is from where the whisker first touches, rad; one that is held nowhere is refused by
    its `name`.
    """
    forward = forward_of(whisker)
    length = forward.reach

    def room(fraction: float) -> float:
        last = max(f.limit(fraction * length) for f in forward.extremes())
        # The tip of a perfect cone holds no contact at all.
        return float(np.nan_to_num(last)) - deflection_angle

    if room(1e-6) < 0:
        raise Refusal(
            f"No contact holds a {name} of {np.degrees(deflection_angle):.1f} degrees",
            remedy="write a smaller one",
        )
    if room(1.0) >= 0:
        return length
    return length * float(brentq(room, 1e-6, 1.0, xtol=1e-13, rtol=1e-13))


@dataclass(frozen=True, eq=False, repr=False, init=False)
class Fused(Cue):
    """Cues of one contact that are measured together: a cue itself.

    What several cues do not know by the same name is one unknown, shared. Signals stand one after
    the other, each cue's receptors with their own noise. A contact is held where it is for every
    cue.

    Parameters
    ----------
    *each : Cue
        Two or more, other fusions among them. Two of one kind are two looks at one contact.
    cues : sequence of Cue
        Further ones: by their field's name `dataclasses.replace` gives them.

    Raises
    ------
    ValueError
        For fewer than two cues, and anything that is no cue.

    Examples
    --------
    >>> from weberwhisk import Observer, Whisker
    >>> from weberwhisk.cues import Compliance, ForceMap
    >>> from weberwhisk.sensitivity import fisher_jnd
    >>> both = Fused(Compliance(), ForceMap())
    >>> both.signal_names, both.unknowns
    (('moment_rate', 'moment', 'axial_force'), ('radial_distance', 'deflection_angle'))
    >>> w = Whisker(50e-3, 100e-6, 5e-6)
    >>> jnds = [fisher_jnd(Observer(w, cue), both.part(cue, np.array([30e-3, 0.2])))
    ...         for cue in (*both.cues, both)]
    >>> print("%.2f and %.2f mm alone, %.2f mm together" % tuple(1e3 * d for d in jnds))
    1.28 and 2.75 mm alone, 1.16 mm together
    """

    cues: tuple[Cue, ...]

    def __init__(self, *each: Cue, cues: Sequence[Cue] = ()) -> None:
        if not isinstance(cues, list | tuple):
            raise Refusal(
                "cues must be a list of cues",
                shown(cues),
                "write ww.cues.Fused(ww.cues.Compliance(), ww.cues.ForceMap()), say",
            )
        cues = (*each, *cues)
        if len(cues) < 2:
            raise Refusal(
                "A fusion takes two cues or more",
                len(cues),
                "write ww.cues.Fused(ww.cues.Compliance(), ww.cues.ForceMap()), say",
            )
        self._set(cues=tuple(map(a_cue, cues)))

    @cached_property
    def signal_names(self) -> tuple[str, ...]:
        """Those of all cues; one that several have, with the cue's number behind it."""
        return _distinct([c.signal_names for c in self.cues])

    @property
    def is_smooth(self) -> bool:
        return all(cue.is_smooth for cue in self.cues)

    @property
    def circular(self) -> tuple[bool, ...]:
        return tuple(circular for cue in self.cues for circular in cue.circular)

    @cached_property
    def unknowns(self) -> tuple[str, ...]:
        """All that any cue does not know; those that the whisker bounds come first."""
        named = dict.fromkeys(name for cue in self.cues for name in cue.unknowns)
        return tuple(sorted(named, key=lambda n: _FIRST.index(n) if n in _FIRST else len(_FIRST)))

    def __repr__(self) -> str:
        return f"Fused({', '.join(map(repr, self.cues))})"

    @property
    def takes_curved(self) -> bool:  # type: ignore[override]
        """Where all cues do, in one plane."""
        return all(cue.takes_curved and "azimuth" not in cue.unknowns for cue in self.cues)

    def forward(self, whisker: Any, contact: Array) -> ForwardModel:
        out = forward_of(whisker)
        for cue in self.cues:
            out = cue.forward(out, self.part(cue, contact))
        return out

    def part(self, cue: Cue, contact: Array) -> Array:
        """What one cue does not know of a contact (..., U): (..., its own unknowns)."""
        return np.asarray(contact, dtype=float)[
            ..., [self.unknowns.index(name) for name in cue.unknowns]
        ]

    def signals(self, whisker: Whisker, contact: Array, *, model: str | None = None) -> Encoded:
        """Signals of all cues (..., S); the outcome is that of the first cue that fails."""
        encoded = [c.signals(whisker, self.part(c, contact), model=model) for c in self.cues]
        return self._together(encoded)

    def _together(self, encoded: Sequence[Encoded]) -> Encoded:
        """All signals, and the outcome of the first cue that fails."""
        outcome = encoded[0][1]
        for _, cue_outcome in encoded[1:]:
            outcome = np.where(outcome == Outcome.HELD, cue_outcome, outcome)
        signals = np.concatenate([s for s, _ in encoded], axis=-1)
        lost = outcome != Outcome.HELD
        if lost.any():
            signals[lost] = np.nan
        return signals, np.asarray(outcome, dtype=np.int8)

    def jacobian(self, whisker: Whisker, contact: Array, *, model: str | None = None) -> Array:
        contact = np.asarray(contact, dtype=float)
        out = np.zeros((*contact.shape[:-1], len(self.signal_names), len(self.unknowns)))
        row = 0
        for cue in self.cues:
            columns = [self.unknowns.index(name) for name in cue.unknowns]
            slope = cue.jacobian(whisker, self.part(cue, contact), model=model)
            out[..., row : row + slope.shape[-2], columns] = slope
            row += slope.shape[-2]
        return out

    def reading_outcome(self, whisker: Whisker, reading: Array) -> Codes:
        """That of the first cue to which its part of the readings (..., R) gives no contact."""
        outcome = np.zeros(reading.shape[:-1], dtype=np.int8)
        start = 0
        for cue in self.cues:
            stop = start + cue.default_noise().reading_size(len(cue.signal_names))
            cue_outcome = cue.reading_outcome(whisker, reading[..., start:stop])
            outcome = np.where(outcome == Outcome.HELD, cue_outcome, outcome)
            start = stop
        return outcome

    def priors(self, whisker: Whisker) -> dict[str, Any]:
        out: dict[str, Any] = {}
        for cue in self.cues:
            out = {**cue.priors(whisker), **out}
        return out

    def joint(self, *noises: ReceptorNoise) -> Joint:
        """One noise model for each cue's signals, put together.

        Raises
        ------
        ValueError
            For other than one for each cue.
        """
        if len(noises) != len(self.cues):
            raise Refusal(
                f"Each of the {len(self.cues)} cues needs one noise model",
                len(noises),
                "write fused.joint(ww.receptors.Weber(0.1), ww.receptors.Weber(0.05)), say",
            )
        return Joint(noises, [len(cue.signal_names) for cue in self.cues])

    def default_noise(self) -> Joint:
        return self.joint(*(cue.default_noise() for cue in self.cues))

    def farthest(self, whisker: Whisker) -> float:
        return min(cue.farthest(whisker) for cue in self.cues)

    def largest_angle(self, whisker: Whisker, radial_distance: Array) -> Array:
        least = np.full(np.shape(radial_distance), np.inf)
        for cue in self.cues:
            least = np.minimum(least, cue.largest_angle(whisker, radial_distance))
        return least


#: The unknowns that the whisker bounds, in the order of the protocol.
_FIRST = ("radial_distance", "deflection_angle")


def _distinct(groups: list[tuple[str, ...]]) -> tuple[str, ...]:
    """All names; one that several groups have, with the group's number behind it."""
    every = [name for group in groups for name in group]
    return tuple(
        name if every.count(name) == 1 else f"{name}_{i}"
        for i, group in enumerate(groups, start=1)
        for name in group
    )


def is_curved(whisker: Any) -> bool:
    """Whether a Whisker or Profile is curved anywhere."""
    return any(np.any(value) for value in vars(Profile.of(whisker).law).values())


@dataclass(frozen=True, eq=False, repr=False)
class MeasuredAngle(Cue):
    """A map of forces, and the deflection angle as video shows it, with an error of its own.

    The angle is that from the base tangent, on curved whiskers too, whose unknown deflection angle
    is counted from the first touch.

    Parameters
    ----------
    cue : Cue
        Of a distance and an unknown deflection angle.

    Examples
    --------
    >>> from weberwhisk.cues import ForceMap
    >>> cue = MeasuredAngle(ForceMap(["moment"]))
    >>> cue.signal_names, cue.unknowns
    (('moment', 'measured_angle'), ('radial_distance', 'deflection_angle'))
    """

    cue: Cue
    takes_curved = True

    @property
    def signal_names(self) -> tuple[str, ...]:
        return (*self.cue.signal_names, "measured_angle")

    @property
    def unknowns(self) -> tuple[str, ...]:
        return self.cue.unknowns

    def signals(self, whisker: Whisker, contact: Array, *, model: str | None = None) -> Encoded:
        refuse_hinge(whisker, "MeasuredAngle")
        contact = np.asarray(contact, dtype=float)
        signals, outcome = self.cue.signals(whisker, contact, model=model)
        angle, in_contact = contact[..., 1].copy(), outcome == Outcome.HELD
        if is_curved(whisker) and in_contact.any():
            angle[in_contact] += rest_angle(whisker, contact[in_contact, 0])
        return np.concatenate([signals, angle[..., None]], axis=-1), outcome

    def default_noise(self) -> ReceptorNoise:
        """Weber's law with k = 0.1, and a degree of the angle."""
        angle = GeneralisedWeber(0.0, floor=ANGLE_SD)
        return Joint([Weber(0.1), angle], [len(self.cue.signal_names), 1])
