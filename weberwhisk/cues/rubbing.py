"""Cues of contacts that rub, and of whiskers whose curvature is not known for certain."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from .._checks import number, positive_number
from ..mechanics.forward import FRICTION_COEFFICIENT, ForwardModel, forward_of
from ..receptors import ReceptorNoise
from .protocol import Array, Cue, Felt, a_cue


@dataclass(frozen=True, eq=False, repr=False, init=False)
class _Wrapped(Cue):
    """A cue felt under conditions of its own, which may be one more unknown."""

    cue: Cue
    #: The name of the unknown.
    unknown: ClassVar[str]

    @property
    def known(self) -> float | None:
        """The condition where it is known."""
        return None

    @property
    def ends(self) -> tuple[float, float]:
        """Between which the condition lies."""
        raise NotImplementedError

    def _under(self, forward: ForwardModel, value: Any) -> ForwardModel:
        raise NotImplementedError

    @property
    def takes_curved(self) -> bool:  # type: ignore[override]
        """As the cue does."""
        return self.cue.takes_curved

    @property
    def signal_names(self) -> tuple[str, ...]:
        """Those of the cue."""
        return self.cue.signal_names

    @property
    def unknowns(self) -> tuple[str, ...]:
        """Those of the cue, and the condition where it is not known."""
        return (*self.cue.unknowns, self.unknown)[: len(self.cue.unknowns) + (self.known is None)]

    def _parts(self, whisker: Any, contact: Array) -> tuple[Any, Array]:
        """The forward model under the condition, and the rest of the contact."""
        contact = np.asarray(contact, dtype=float)
        if self.known is not None:
            return self._under(forward_of(whisker), self.known), contact
        return self._under(forward_of(whisker), contact[..., -1]), contact[..., :-1]

    def forward(self, whisker: Any, contact: Array) -> ForwardModel:
        """The cue's, under the condition of each contact."""
        return self.cue.forward(*self._parts(whisker, contact))

    def signals(self, whisker: Any, contact: Array, *, model: str | None = None) -> Felt:
        """The cue's signals (..., S) under the condition, and the outcome."""
        forward, rest = self._parts(whisker, contact)
        return self.cue.signals(forward, rest, model=model)

    def jacobian(self, whisker: Any, contact: Array, *, model: str | None = None) -> Array:
        """Derivatives of the signals to the unknowns, (..., S, U): by the cue where known."""
        if self.known is None:
            return super().jacobian(whisker, contact, model=model)
        forward, rest = self._parts(whisker, contact)
        return self.cue.jacobian(forward, rest, model=model)

    def _all(self, whisker: Any) -> Any:
        """The forward model, ready for any of the conditions."""
        return self._under(forward_of(whisker), sum(self.ends) / 2)

    def priors(self, whisker: Any) -> dict[str, Any]:
        """The cue's."""
        return dict(self.cue.priors(self._all(whisker)))

    def default_noise(self) -> ReceptorNoise:
        """The cue's."""
        return self.cue.default_noise()

    def farthest(self, whisker: Any) -> float:
        """As far as the cue works under any of the conditions, m."""
        return self.cue.farthest(self._all(whisker))


@dataclass(frozen=True, eq=False, repr=False, init=False)
class Friction(_Wrapped):
    """A cue of contacts that rub: with a friction angle that is known, or one more unknown.

    Coulomb friction tilts the contact force from the normal towards the base by the friction angle
    ψ: positive while the whisker slides outwards over the object, as while it is let go, negative
    while it is pressed harder (see `mechanics.profile`).

    Parameters
    ----------
    cue : Cue
        `ForceMap`, `Compliance`, or a cue made of them.
    angle : float, optional
        ψ, rad, where it is known. By default it is the unknown ``"friction_angle"``.
    coefficient : float
        Of an unknown angle, the largest |tan ψ|: its prior is flat from −atan µ to atan µ, which
        leaves open which way the contact slides and whether it sticks. By default 0.48, of a
        whisker on steel.

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

    def __init__(
        self, cue: Cue, angle: float | None = None, *, coefficient: float = FRICTION_COEFFICIENT
    ) -> None:
        _checked(cue, self.unknown)
        if angle is not None:
            angle = number("angle", angle, "give radians, such as -0.2, or None where unknown")
        largest = positive_number("coefficient", coefficient, "give µ, such as 0.48")
        if not max(abs(np.tan(angle or 0.0)), largest) <= np.tan(np.pi / 6) + 1e-12:
            raise ValueError(
                "Observers take friction angles up to 30° either way, got "
                f"angle {angle} rad and coefficient {largest:g}; write smaller ones."
            )
        self._set(cue=cue, angle=angle, coefficient=largest)

    @property
    def known(self) -> float | None:
        """The angle where it is known."""
        return self.angle

    @property
    def ends(self) -> tuple[float, float]:
        """The least and the largest friction angle, rad."""
        if self.angle is not None:
            return self.angle, self.angle
        return -float(np.arctan(self.coefficient)), float(np.arctan(self.coefficient))

    def _under(self, forward: ForwardModel, value: Any) -> ForwardModel:
        return forward.rubbing(value, self.ends)

    def priors(self, whisker: Any) -> dict[str, Any]:
        """The cue's, and flat of an unknown friction angle."""
        out = super().priors(whisker)
        if self.angle is None:
            from scipy.stats import uniform

            low, high = self.ends
            out["friction_angle"] = uniform(low, high - low)
        return out


@dataclass(frozen=True, eq=False, repr=False, init=False)
class UnknownCurvature(_Wrapped):
    """A cue of one more unknown, ``"curvature_offset"``: 1/m more than the whisker says, all along.

    Parameters
    ----------
    cue : Cue
        `ForceMap`, `Compliance`, or a cue made of them.
    spread : float
        Sd of the normal prior, 1/m; its mean is 0. Beyond 5 sd signals are those at 5 sd.

    Raises
    ------
    ValueError
        For a cue of straight whiskers alone, and a spread that is not positive.

    Examples
    --------
    >>> from weberwhisk.cues import ForceMap
    >>> UnknownCurvature(ForceMap(), 2.0).unknowns
    ('radial_distance', 'deflection_angle', 'curvature_offset')
    """

    cue: Cue
    spread: float
    unknown: ClassVar[str] = "curvature_offset"

    def __init__(self, cue: Cue, spread: float) -> None:
        _checked(cue, self.unknown)
        self._set(
            cue=cue, spread=positive_number("spread", spread, "give the sd in 1/m, such as 2.0")
        )

    @property
    def ends(self) -> tuple[float, float]:
        """The least and the largest offset, 1/m."""
        return -5 * self.spread, 5 * self.spread

    def _under(self, forward: ForwardModel, value: Any) -> ForwardModel:
        return forward.bowed(value, self.ends)

    def priors(self, whisker: Any) -> dict[str, Any]:
        """The cue's, and normal of the offset."""
        from scipy.stats import norm

        return {**super().priors(whisker), "curvature_offset": norm(0.0, self.spread)}


def _checked(cue: Any, unknown: str) -> None:
    """Refuse cues that take neither friction nor curvature, and those that have the unknown."""
    if not a_cue(cue).takes_curved:
        raise ValueError(
            f"{cue!r} is for straight whiskers without friction; write cues.ForceMap() or "
            "Compliance(), or a fusion of them."
        )
    if unknown in cue.unknowns:
        raise ValueError(f"The {unknown} is unknown in {cue!r} already; leave it as it is.")
