"""Cues with one more unknown, of the whisker or of the contact, that has a prior of its own.

Each wraps a cue and adds its unknown as the last: `UnknownStiffness`, `UnknownCurvature`,
`UnknownHinge` and `Friction`, whose angle may be known as well. They nest; `UnknownRoll` is of
`SpaceMap` alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import scipy

from .._util.checks import number, one_or_more, positive_number, refuse_hinge, shown
from .._util.refusals import Refusal
from .._util.values import Array, Flags
from ..mechanics.curved_surface import SIX
from ..mechanics.forward import ForwardModel, forward_of
from ..receptors import ReceptorNoise
from .force_map import SIGNALS, SpaceMap
from .protocol import Cue, Encoded, a_cue

#: Largest friction angle, rad (30°, to within rounding of its tangent).
_LARGEST_FRICTION = float(np.pi / 6 + 1e-12)

__all__ = ["Friction", "UnknownCurvature", "UnknownHinge", "UnknownRoll", "UnknownStiffness"]


@dataclass(frozen=True, eq=False, repr=False, init=False)
class _Wrapped(Cue):
    """A cue of one more unknown, in all else the cue itself; of none where that is known."""

    cue: Cue
    #: The name of the unknown.
    unknown: ClassVar[str]

    def _wrap(self, cue: Any, **values: Any) -> None:
        """Give fields their values; refuse what is no cue, and one that has the unknown."""
        if self.unknown in a_cue(cue).unknowns:
            raise Refusal(
                f"The {self.unknown} is unknown in {cue!r} already", remedy="leave it as it is"
            )
        self._set(cue=cue, **values)

    def _refuse_straight(self) -> None:
        """Refuse cues that take neither friction nor curvature."""
        if not self.cue.takes_curved:
            raise Refusal(
                f"{self.cue!r} is for whiskers without friction whose shape is known",
                remedy=(
                    "write ww.cues.ForceMap(), ww.cues.Compliance() or "
                    "ww.cues.BalanceOfMoments(), or a fusion of them"
                ),
            )

    @property
    def known(self) -> float | None:
        """The condition where it is known."""
        return None

    def _under(self, whisker: Any, value: Any = None) -> Any:
        """The whisker under the condition; ready for any of those possible without one."""
        raise NotImplementedError

    def _prior(self, whisker: Any) -> Any:
        """Of the unknown, a frozen SciPy distribution."""
        raise NotImplementedError

    @property
    def takes_curved(self) -> bool:  # type: ignore[override]
        return self.cue.takes_curved

    @property
    def signal_names(self) -> tuple[str, ...]:
        return self.cue.signal_names

    @property
    def is_smooth(self) -> bool:
        return self.cue.is_smooth

    @property
    def circular(self) -> tuple[bool, ...]:
        return self.cue.circular

    def forward(self, whisker: Any, contact: Array) -> ForwardModel:
        return self.cue.forward(*self._conditioned(whisker, contact))

    def signals(self, whisker: Any, contact: Array, *, model: str | None = None) -> Encoded:
        return self.cue.signals(*self._conditioned(whisker, contact), model=model)

    def default_noise(self) -> ReceptorNoise:
        return self.cue.default_noise()

    def farthest(self, whisker: Any) -> float:
        return self.cue.farthest(self._under(whisker))

    def largest_angle(self, whisker: Any, radial_distance: Array) -> Array:
        return self.cue.largest_angle(whisker, radial_distance)

    @property
    def is_isotropic(self) -> bool:
        return self.cue.is_isotropic

    @property
    def unknowns(self) -> tuple[str, ...]:
        """Those of the cue, and the condition where it is not known."""
        if self.known is not None:
            return self.cue.unknowns
        return (*self.cue.unknowns, self.unknown)

    def _conditioned(self, whisker: Any, contact: Array) -> tuple[Any, Array]:
        """The whisker under the condition, and the rest of the contact."""
        contact = np.asarray(contact, dtype=float)
        if self.known is not None:
            return self._under(whisker, self.known), contact
        return self._under(whisker, contact[..., -1]), contact[..., :-1]

    def jacobian(self, whisker: Any, contact: Array, *, model: str | None = None) -> Array:
        """Derivatives of the signals to the unknowns, (..., S, U): by the cue where known."""
        if self.known is None:
            return super().jacobian(whisker, contact, model=model)
        return self.cue.jacobian(*self._conditioned(whisker, contact), model=model)

    def priors(self, whisker: Any) -> dict[str, Any]:
        out = dict(self.cue.priors(self._under(whisker)))
        return out if self.known is not None else out | {self.unknown: self._prior(whisker)}


@dataclass(frozen=True, eq=False, repr=False, init=False)
class Friction(_Wrapped):
    """A cue with friction at the contact, of a known angle or of one that is one more unknown.

    Coulomb friction tilts the contact force from the normal towards the base by the friction angle
    ψ: positive while the whisker slides outwards over the object, as while it is let go, negative
    while it is pressed harder (see `mechanics.profile`).

    Parameters
    ----------
    cue : Cue
        `ForceMap`, `SpaceMap`, `Compliance`, `BalanceOfMoments`, or a cue made of them.
    angle : float, optional
        ψ, rad, where it is known. By default it is the unknown ``"friction_angle"``.
    coefficient : float
        Largest |tan ψ| of an unknown angle, whose prior is flat from −atan µ to atan µ: the contact
        may slide either way, or stick. By default 0.48, of a whisker on steel.

    Raises
    ------
    ValueError
        For a cue that takes no friction, an angle beyond ±30°, a coefficient that is not between 0
        and 0.577.

    Examples
    --------
    >>> from weberwhisk import Whisker
    >>> from weberwhisk.cues import ForceMap
    >>> cue = Friction(ForceMap())
    >>> cue.unknowns
    ('radial_distance', 'deflection_angle', 'friction_angle')
    >>> signals, outcome = cue.signals(Whisker(50e-3, 100e-6, 5e-6), [30e-3, 0.2, -0.2])
    """

    cue: Cue
    angle: float | None
    coefficient: float
    unknown: ClassVar[str] = "friction_angle"

    def __init__(self, cue: Cue, angle: float | None = None, *, coefficient: float = 0.48) -> None:
        if angle is not None:
            angle = number("angle", angle, "give radians, such as -0.2, or None where unknown")
            # Angles themselves: the tangent of 9, which is 9° passed as radians, is small.
            if abs(angle) > _LARGEST_FRICTION:
                remedy = f"write np.radians({angle:g}) if those are degrees"
                if not 1 < abs(angle) <= 30:  # advice must not be refused itself
                    remedy = f"write np.radians({np.copysign(30, angle):g}) at most"
                raise Refusal("angle must be radians up to 30° either way", f"{angle:g}", remedy)
        largest = positive_number("coefficient", coefficient, "give µ, such as 0.48")
        if np.arctan(largest) > _LARGEST_FRICTION:
            raise Refusal(
                "coefficient must be at most 0.577, of a friction angle up to 30°",
                f"{largest:g}",
                "write 0.48, say",
            )
        self._wrap(cue, angle=angle, coefficient=largest)
        self._refuse_straight()

    @property
    def known(self) -> float | None:
        """The angle where it is known."""
        return self.angle

    def _under(self, whisker: Any, value: Any = None) -> ForwardModel:
        largest = float(np.arctan(self.coefficient))
        ends = (-largest, largest) if self.angle is None else (self.angle, self.angle)
        value = sum(ends) / 2 if value is None else value
        return forward_of(whisker).with_uncertain("friction", value, ends)

    def _prior(self, whisker: Any) -> Any:
        largest = float(np.arctan(self.coefficient))
        return scipy.stats.uniform(-largest, 2 * largest)


@dataclass(frozen=True, eq=False, repr=False, init=False)
class UnknownCurvature(_Wrapped):
    """A cue with one more unknown, ``"curvature_offset"``: added to the whisker's curvature, 1/m.

    Parameters
    ----------
    cue : Cue
        `ForceMap`, `SpaceMap`, `Compliance`, `BalanceOfMoments`, or a cue made of them.
    spread : float
        Sd of the normal prior, 1/m; its mean is 0. Beyond 7 sd signals are those at 7 sd.

    Raises
    ------
    ValueError
        For a cue of straight whiskers alone, and a spread that is not positive. Where it is used,
        for a spread whose 7 sd bend the whisker too much: 2 1/m on a straight one of 50 mm.

    Examples
    --------
    >>> from weberwhisk.cues import ForceMap
    >>> UnknownCurvature(ForceMap(), 1.0).unknowns
    ('radial_distance', 'deflection_angle', 'curvature_offset')
    """

    cue: Cue
    spread: float
    unknown: ClassVar[str] = "curvature_offset"

    def __init__(self, cue: Cue, spread: float) -> None:
        self._wrap(cue, spread=positive_number("spread", spread, "give the sd in 1/m, such as 1.0"))
        self._refuse_straight()

    def _under(self, whisker: Any, value: Any = 0.0) -> ForwardModel:
        ends = (-7 * self.spread, 7 * self.spread)
        return forward_of(whisker).with_uncertain("offset", value, ends)

    def _prior(self, whisker: Any) -> Any:
        return scipy.stats.norm(0.0, self.spread)


@dataclass(frozen=True, eq=False, repr=False, init=False)
class UnknownHinge(_Wrapped):
    """A cue with one more unknown, ``"hinge_stiffness"``: that of the hinge at the base, N m/rad.

    Parameters
    ----------
    cue : Cue
        `ForceMap`, `Compliance`, `BalanceOfMoments`, or a cue made of them; `SpaceMap` of a
        straight whisker.
    spread : float
        Sd of the log-normal prior's ln; its median is the whisker's `hinge_stiffness`. Beyond 7 sd
        signals are those at 7 sd.

    Raises
    ------
    ValueError
        For a cue that takes no hinge, and a spread that is not positive; for a whisker without a
        hinge where it is used.

    Notes
    -----
    Next to the base, where a push turns the hinge alone, contact is lost at half a turn on the
    hinge of median stiffness, and at the same share of the largest deflection on any other: on
    a softer hinge that is beyond half a turn.

    Examples
    --------
    >>> from weberwhisk import Whisker
    >>> from weberwhisk.cues import ForceMap
    >>> cue = UnknownHinge(ForceMap(), 0.3)
    >>> cue.unknowns
    ('radial_distance', 'deflection_angle', 'hinge_stiffness')
    >>> w = Whisker(50e-3, 100e-6, 5e-6, hinge_stiffness=2e-5)
    >>> soft, stiff = cue.signals(w, [[30e-3, 0.2, 1e-5], [30e-3, 0.2, 1e-3]])[0][:, 0]
    >>> print(f"{soft / stiff:.2f}")
    0.52
    """

    cue: Cue
    spread: float
    unknown: ClassVar[str] = "hinge_stiffness"

    def __init__(self, cue: Cue, spread: float) -> None:
        spread = positive_number("spread", spread, "give the sd of ln stiffness, such as 0.3")
        self._wrap(cue, spread=spread)
        self._refuse_straight()

    def _median(self, whisker: Any) -> float:
        forward = forward_of(whisker)
        if not forward.is_hinged:
            raise Refusal(
                "UnknownHinge needs a whisker on a hinge",
                "a clamped base",
                "write ww.Whisker(..., hinge_stiffness=2e-5), the median of the prior in N m/rad",
            )
        return float(forward.whisker.hinge_stiffness)

    def _under(self, whisker: Any, value: Any = None) -> ForwardModel:
        median = self._median(whisker)
        low, high = median * np.exp(-7 * self.spread), median * np.exp(7 * self.spread)
        value = median if value is None else np.clip(value, low, high)
        return forward_of(whisker).with_uncertain("hinge", value, (float(low), float(high)))

    def _prior(self, whisker: Any) -> Any:
        return scipy.stats.lognorm(self.spread, scale=self._median(whisker))


@dataclass(frozen=True, eq=False, repr=False, init=False)
class UnknownRoll(_Wrapped):
    """A `SpaceMap` with one more unknown, the ``"roll"`` of the plane of curvature, rad.

    A whisker rolled by ρ and touched at the azimuth ω bends as one that is not, touched at ω − ρ;
    its forces and moments are turned by ρ about the base tangent. So the roll shows in how
    a curved whisker bends out of the plane of the contact. A straight one's roll has no effect,
    and is as the prior has it. JNDs at contacts in the plane of curvature do not depend on it, to
    first order: for curves of other contacts give the azimuth a prior such as
    ``scipy.stats.uniform(1.5 - np.pi, 2 * np.pi)``, of middle 1.5.

    Parameters
    ----------
    cue : SpaceMap
    spread : float
        Sd of the normal prior, rad. Its mean is the cue's `roll`, and it is truncated half a turn
        to either side: with a spread of several turns it is flat.

    Raises
    ------
    ValueError
        For a cue other than `SpaceMap`, and a spread that is not positive.

    Examples
    --------
    >>> from weberwhisk import Whisker
    >>> from weberwhisk.cues import SpaceMap
    >>> cue = UnknownRoll(SpaceMap(), 0.3)
    >>> cue.unknowns
    ('radial_distance', 'deflection_angle', 'azimuth', 'roll')
    >>> w = Whisker(50e-3, 100e-6, 5e-6)
    >>> signals, _ = cue.signals(w, [[30e-3, 0.2, 1.0, 0.0], [30e-3, 0.2, 1.0, 0.5]])
    >>> bool((signals[0] == signals[1]).all())
    True
    """

    cue: SpaceMap
    spread: float
    unknown: ClassVar[str] = "roll"

    def __init__(self, cue: SpaceMap, spread: float) -> None:
        if not isinstance(cue, SpaceMap):
            raise Refusal(
                "Only a SpaceMap informs of the roll",
                shown(cue),
                "write ww.cues.UnknownRoll(ww.cues.SpaceMap(), 0.3), and a known roll "
                "as ww.cues.SpaceMap(roll=0.3)",
            )
        self._wrap(cue, spread=positive_number("spread", spread, "give the sd in rad, such as 0.3"))

    def _under(self, whisker: Any, value: Any = None) -> Any:
        return whisker

    def _prior(self, whisker: Any) -> Any:
        ends = np.pi / self.spread
        return scipy.stats.truncnorm(-ends, ends, self.cue.roll, self.spread)

    def forward(self, whisker: Any, contact: Array) -> ForwardModel:
        """The mechanics of contacts (..., 4), at their azimuths from the plane of curvature."""
        contact = np.asarray(contact, dtype=float)
        forward = self.cue.forward(whisker, contact[..., :3])
        if forward.is_flat:
            return forward
        return replace(forward, azimuth=contact[..., 2] - contact[..., 3])

    def signals(self, whisker: Any, contact: Array, *, model: str | None = None) -> Encoded:
        contact = np.array(contact, dtype=float)
        azimuth = contact[..., 2].copy()
        contact[..., 2] -= contact[..., 3]
        return self.cue.from_plane(whisker, contact[..., :3], model=model)(azimuth)


#: Signals that are proportional to EI₀.
FORCES = {*SIGNALS, "moment_rate", *SIX}


@dataclass(frozen=True, eq=False, repr=False, init=False)
class UnknownStiffness(_Wrapped):
    """A cue with one more unknown, ``"stiffness"``: EI₀ over the whisker's own.

    Forces and moments are proportional to EI₀ at a given contact, so any cue of them can be
    wrapped, fusions too. In a fusion of cues that are wrapped each, all share one stiffness.

    Parameters
    ----------
    cue : Cue
    spread : float
        Sd of the log-normal prior's ln; its median is 1. By default that of measured moduli,
        3.34 ± 1.48 GPa (Quist, Faruqi & Hartmann 2011).
    soft_signals : sequence of str, optional
        The cue's signals that are proportional to EI₀; by default its forces, moments and rates of
        moments, and not its angles, ratios or chances.

    Raises
    ------
    ValueError
        For a spread that is not positive, a signal that the cue has not, a cue whose stiffness is
        unknown already or that senses no force, and an `UnknownRoll`.

    Examples
    --------
    >>> from weberwhisk import Whisker
    >>> from weberwhisk.cues import ForceMap
    >>> cue = UnknownStiffness(ForceMap())
    >>> cue.unknowns
    ('radial_distance', 'deflection_angle', 'stiffness')
    >>> w = Whisker(50e-3, 100e-6, 5e-6)
    >>> plain, _ = ForceMap().signals(w, np.array([30e-3, 0.2]))
    >>> soft, _ = cue.signals(w, np.array([30e-3, 0.2, 0.5]))
    >>> soft / plain
    array([0.5, 0.5])
    """

    cue: Cue
    spread: float
    soft_signals: tuple[str, ...]
    unknown: ClassVar[str] = "stiffness"

    def __init__(
        self, cue: Cue, spread: float = 0.42, soft_signals: Sequence[str] | None = None
    ) -> None:
        spread = positive_number("spread", spread, "give the sd of ln EI₀, such as 0.42")
        names = a_cue(cue).signal_names
        if isinstance(cue, UnknownRoll):
            raise Refusal(
                f"{cue!r} has four unknowns, and sums over five take too long",
                remedy=(
                    "give the stiffness, or the roll as "
                    "ww.cues.UnknownStiffness(ww.cues.SpaceMap(roll=0.3))"
                ),
            )
        if soft_signals is None:
            # The signals of a fusion are numbered where a name comes twice.
            soft_signals = [name for name in names if name.rstrip("_0123456789") in FORCES]
            if not soft_signals:
                raise Refusal(
                    f"Of the signals of {cue!r} ({', '.join(names)}) none is a force or a "
                    "moment that goes with the stiffness",
                    remedy="use the cue as it is",
                )
        stiffness_scaled = one_or_more("signals", soft_signals, names)
        self._wrap(cue, spread=spread, soft_signals=stiffness_scaled)

    def __repr__(self) -> str:
        return f"UnknownStiffness({self.cue!r}, {self.spread:g})"

    @property
    def is_isotropic(self) -> bool:
        return self.cue.is_isotropic and not np.any(self._stiffness_scaled & self.circular)

    @cached_property
    def _stiffness_scaled(self) -> Flags:
        return np.isin(self.cue.signal_names, self.soft_signals)

    @property
    def is_scale(self) -> bool:
        return bool(self._stiffness_scaled.all())

    def _under(self, whisker: Any, value: Any = None) -> Any:
        refuse_hinge(whisker, "UnknownStiffness, under which forces grow with EI₀ alone,")
        return whisker

    def _prior(self, whisker: Any) -> Any:
        return scipy.stats.lognorm(self.spread)

    def signals(self, whisker: Any, contact: Array, *, model: str | None = None) -> Encoded:
        contact = np.asarray(contact, dtype=float)
        signals, outcome = self.cue.signals(self._under(whisker), contact[..., :-1], model=model)
        return signals * np.where(self._stiffness_scaled, contact[..., -1:], 1.0), outcome
