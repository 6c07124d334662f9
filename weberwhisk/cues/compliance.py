"""Rotational compliance during a tap (§2e): distance from the rate at which the moment grows."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brentq

from .._checks import non_negative, positive
from ..mechanics import closed_form, ladder
from ..mechanics.contact import Outcome
from ..receptors import Weber
from ..whisker import Whisker
from .protocol import Array


class Compliance:
    """Radial distance from the moment rate Ṁ at a known angular velocity θ̇ (equation (2.1)).

    Parameters
    ----------
    tap_angle : float
        How far the whisker is pushed into the object, rad: Ṁ is the moment reached, over the time
        it took. 0, the default, is the limit of a light tap, in which the closed form is exact.
    angular_velocity : float
        θ̇, rad/s.

    Raises
    ------
    ValueError
        For a negative tap angle, an angular velocity that is not positive.

    Examples
    --------
    >>> w = Whisker(length=50e-3, base_radius=100e-6, tip_radius=5e-6)
    >>> rate, outcome = Compliance().signals(w, np.array([20e-3]))
    >>> float(Compliance().radial_distance(w, rate[0]).round(12))
    0.02
    """

    signal_names: tuple[str, ...] = ("moment_rate",)
    unknowns: tuple[str, ...] = ("radial_distance",)

    def __init__(self, *, tap_angle: float = 0.0, angular_velocity: float = 1.0) -> None:
        self.tap_angle = float(
            non_negative("tap_angle", tap_angle, "give radians, 0 for the lightest tap")
        )
        self.angular_velocity = float(
            positive("angular_velocity", angular_velocity, "give rad/s, such as 1")
        )

    def __repr__(self) -> str:
        return (
            f"Compliance(tap_angle={self.tap_angle:g}, angular_velocity={self.angular_velocity:g})"
        )

    def signals(
        self, whisker: Whisker, contact: Array, *, model: str | None = None
    ) -> tuple[Array, NDArray[np.int8]]:
        """Moment rate (..., 1), N m/s, and outcome of a contact (..., 1)."""
        r = np.asarray(contact, dtype=float)[..., 0]
        if self.tap_angle == 0:
            reached = (r > 0) & (r < whisker.apex_distance) & (r <= whisker.length)
            outcome = np.where(reached, Outcome.HELD, Outcome.OUT_OF_REACH).astype(np.int8)
            rate = closed_form.moment(whisker, np.where(reached, r, whisker.length), 1.0)
            rate = np.where(reached, rate * self.angular_velocity, np.nan)
        else:
            bent = ladder.press(whisker, r, self.tap_angle, model=model)
            outcome = np.asarray(bent.outcome, dtype=np.int8)
            rate = bent.moment / self.tap_angle * self.angular_velocity
        return np.asarray(rate)[..., None], outcome

    def jacobian(self, whisker: Whisker, contact: Array, *, model: str | None = None) -> Array:
        """dṀ/dr, (..., 1, 1): equation (3.3)."""
        r = np.asarray(contact, dtype=float)[..., 0]
        if self.tap_angle == 0 or model == "closed_form":
            slope = -whisker.compliance_constant / r**2
        else:
            slope = ladder.signal_jacobian(whisker, r, self.tap_angle)[..., 0, 0] / self.tap_angle
        return np.asarray(slope * self.angular_velocity)[..., None, None]

    def priors(self, whisker: Whisker) -> dict[str, Any]:
        """None: every unknown is bounded by the whisker."""
        return {}

    def default_noise(self) -> Weber:
        """Weber's law, k = 0.1."""
        return Weber(0.1)

    def farthest(self, whisker: Whisker) -> float:
        """The tip, or where the whisker flicks past at the tap angle, m."""
        length = float(whisker.length)
        if self.tap_angle == 0:
            return length

        def room(fraction: float) -> float:
            return float(ladder.flick_past(whisker, fraction * length).deflection_angle) - (
                self.tap_angle
            )

        if room(1e-6) < 0:
            raise ValueError(
                f"No contact holds a tap of {np.degrees(self.tap_angle):.1f} degrees; "
                "write a smaller tap_angle."
            )
        return length * float(brentq(room, 1e-6, 1.0, xtol=1e-13, rtol=1e-13))

    def radial_distance(self, whisker: Whisker, moment_rate: ArrayLike) -> Array:
        """The inverse (2.1) for a light tap, m: r = Cθ̇A/(Cθ̇ + ṀA)."""
        return closed_form.distance_from_moment(whisker, moment_rate, self.angular_velocity)
