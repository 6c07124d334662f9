"""Rotational compliance during a tap (§2e): distance from the rate at which the moment grows."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .._checks import non_negative_number, positive_number
from ..mechanics import closed_form
from ..mechanics.contact import Outcome
from ..mechanics.forward import forward_of
from ..whisker import Whisker
from .protocol import Array, Cue, Felt
from .reach import reach_at


@dataclass(frozen=True, eq=False, repr=False)
class Compliance(Cue):
    """Radial distance from the moment rate Ṁ and the angular velocity θ̇ (equation (2.1)).

    By default θ̇ is known. With a spread it is unknown, felt with noise of its own, and the
    posterior of the distance is that of both readings.

    Parameters
    ----------
    tap_angle : float
        How far the whisker is pushed into the object, rad: Ṁ is the moment reached, over the time
        it took. 0, the default, is the limit of a light tap, in which the closed form is exact.
    angular_velocity : float
        θ̇, rad/s; with a spread, the median of its log-normal prior.
    velocity_spread : float
        Sd of ln θ̇ from tap to tap. 0, the default: θ̇ is known, and no signal.

    Raises
    ------
    ValueError
        For a negative tap angle or spread, an angular velocity that is not positive.

    Notes
    -----
    With Weber fractions k_M and k_θ and a wide prior the JND is √(k_M² + k_θ²)·r(1 − r/A): the
    readings' ratio is what tells. Noise that both share cancels (a clock: ρ = 1, equal fractions).

    Examples
    --------
    >>> w = Whisker(length=50e-3, base_radius=100e-6, tip_radius=5e-6)
    >>> rate, outcome = Compliance().signals(w, np.array([20e-3]))
    >>> float(Compliance().radial_distance(w, rate[0]).round(12))
    0.02
    """

    takes_curved = True
    _: KW_ONLY
    tap_angle: float = 0.0
    angular_velocity: float = 1.0
    velocity_spread: float = 0.0

    def __post_init__(self) -> None:
        self._set(
            tap_angle=non_negative_number(
                "tap_angle", self.tap_angle, "give radians, 0 for the lightest tap"
            ),
            angular_velocity=positive_number(
                "angular_velocity", self.angular_velocity, "give rad/s, such as 1"
            ),
            velocity_spread=non_negative_number(
                "velocity_spread", self.velocity_spread, "give the sd of ln, such as 0.5"
            ),
        )

    @property
    def signal_names(self) -> tuple[str, ...]:
        """The moment rate, and the angular velocity where it is not known."""
        return ("moment_rate", "angular_velocity")[: 1 + (self.velocity_spread > 0)]

    @property
    def unknowns(self) -> tuple[str, ...]:
        """The distance, and the angular velocity where it is not known."""
        return ("radial_distance", "angular_velocity")[: 1 + (self.velocity_spread > 0)]

    def _velocity(self, contact: Array) -> Array:
        """θ̇ of a contact: what it says, or the known one."""
        if self.velocity_spread > 0:
            return contact[..., 1]
        return np.full(contact.shape[:-1], self.angular_velocity)

    def _stiffness(self, whisker: Whisker, r: Array, model: str | None) -> Felt:
        """Moment for each radian of the tap, N m, and outcome."""
        forward = forward_of(whisker, model)
        if self.tap_angle == 0:
            return forward.stiffness(r)
        if forward.is_plain:  # the default model's last digits, by name
            forward = forward_of(whisker, model or "elastica")
        signals, outcome = forward.signals(r, np.full_like(r, self.tap_angle))
        return signals[..., 0] / self.tap_angle, outcome

    def signals(self, whisker: Whisker, contact: Array, *, model: str | None = None) -> Felt:
        """Moment rate, N m/s, and where unknown θ̇, rad/s, (..., S); outcome of a contact."""
        contact = np.asarray(contact, dtype=float)
        stiffness, outcome = self._stiffness(whisker, contact[..., 0], model)
        velocity = self._velocity(contact)
        rate = stiffness * velocity
        if self.velocity_spread == 0:
            return rate[..., None], outcome
        velocity = np.where(outcome == Outcome.HELD, velocity, np.nan)
        return np.stack([rate, velocity], axis=-1), outcome

    def jacobian(self, whisker: Whisker, contact: Array, *, model: str | None = None) -> Array:
        """d(Ṁ, θ̇)/d(r, θ̇), (..., S, U): equation (3.3)."""
        contact = np.asarray(contact, dtype=float)
        r = contact[..., 0]
        forward = forward_of(whisker, model)
        if not forward.is_plain:
            return super().jacobian(whisker, contact, model=model)
        if self.tap_angle == 0 or model == "closed_form":
            slope = -forward.base.compliance_constant / r**2
            if forward.is_hinged:  # in series with a hinge, which takes a share of every angle
                slope = slope * (1 - forward.give * forward.stiffness(r)[0]) ** 2
        else:
            slope = forward.jacobian(r, self.tap_angle)[..., 0, 0] / self.tap_angle
        slope = np.asarray(slope * self._velocity(contact))
        if self.velocity_spread == 0:
            return slope[..., None, None]
        stiffness, _ = self._stiffness(whisker, r, model)
        rows = [[slope, stiffness], [np.zeros_like(r), np.ones_like(r)]]
        return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)

    def priors(self, whisker: Whisker) -> dict[str, Any]:
        """Log-normal, of θ̇ where it is unknown."""
        if self.velocity_spread == 0:
            return {}
        from scipy.stats import lognorm

        return {"angular_velocity": lognorm(self.velocity_spread, scale=self.angular_velocity)}

    def farthest(self, whisker: Whisker) -> float:
        """The tip, or where the whisker flicks past at the tap angle, m."""
        if self.tap_angle == 0:
            return forward_of(whisker).reach
        return reach_at(whisker, self.tap_angle, "tap_angle")

    def radial_distance(
        self,
        whisker: Whisker,
        moment_rate: ArrayLike,
        angular_velocity: ArrayLike | None = None,
    ) -> Array:
        """The inverse (2.1) for a light tap, m: r = Cθ̇A/(Cθ̇ + ṀA); θ̇ by default the cue's."""
        velocity = self.angular_velocity if angular_velocity is None else angular_velocity
        forward, rate = forward_of(whisker), np.asarray(moment_rate, dtype=float)
        bending = np.asarray(velocity) - forward.give * rate  # what the hinge does not take up
        return closed_form.distance_from_moment(forward.base, rate, bending)
