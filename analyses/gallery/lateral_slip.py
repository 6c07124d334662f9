"""A tap on a tilted surface, with slip out of the plane of rotation (§2e): a cue of one's own."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from typing import Any

import numpy as np
import scipy
from numpy.typing import ArrayLike

from weberwhisk import Outcome, Whisker
from weberwhisk.cues import Cue
from weberwhisk.mechanics import closed_form
from weberwhisk.receptors import GeneralisedWeber, Joint, Weber

Array = np.ndarray
Encoded = tuple[Array, Array]


@dataclass(frozen=True, eq=False, repr=False)
class LateralSlip(Cue):
    """Radial distance and the tilt of a surface, from the moment rate's size and direction.

    A whisker that taps a surface whose normal is tilted by τ out of the plane of rotation slips
    sideways along it. The contact moves across the surface by rθ̇ cos τ; without friction the
    whisker bends along the normal, with friction of angle φ by φ less:

        |Ṁ| = Cθ̇ (1/r − 1/A) cos τ / cos φ,  direction τ ∓ φ out of the plane,

    and where |τ| < φ it sticks, the direction is 0 and |Ṁ| that of equation (2.1). A straight
    round whisker bends in the plane of the force, so that the small-angle form (2.3) holds there.

    Parameters
    ----------
    angular_velocity : float
        θ̇, rad/s.
    friction_angle : float
        φ, arctan of the coefficient of friction, rad.
    steepest : float
        The prior of the tilt is flat to this far on either side, rad.

    Raises
    ------
    ValueError
        For a friction angle below 0 or above the steepest tilt, or a steepest tilt beyond π/2.

    Notes
    -----
    The direction of bending is which receptors around the follicle fire: its noise is an angle,
    whatever the size. Noise of k|M| in both components of the moment is k in that angle. The idea
    of tapping with lateral slip is Solomon & Hartmann's (2008, IEEE Trans. Robot. 24, 1157, the
    paper's [31]); this light-tap form is derived here.

    Examples
    --------
    >>> w = Whisker(length=50e-3, base_radius=100e-6, tip_radius=5e-6)
    >>> cue = LateralSlip(friction_angle=0.2)
    >>> signals, outcome = cue.signals(w, np.array([20e-3, 0.7]))
    >>> float(signals[1].round(9))
    0.5
    """

    signal_names = ("moment_rate", "moment_direction")
    unknowns = ("radial_distance", "surface_tilt")

    _: KW_ONLY
    angular_velocity: float = 1.0
    friction_angle: float = 0.0
    steepest: float = float(np.radians(75.0))

    def __post_init__(self) -> None:
        if not 0 <= self.friction_angle < self.steepest < np.pi / 2:
            raise ValueError(
                f"Angles must rise from friction_angle over steepest to a right angle, got "
                f"{self.friction_angle:g} and {self.steepest:g} rad; write steepest=1.3, say."
            )

    def sticks(self, surface_tilt: ArrayLike) -> Array:
        """Where friction holds the whisker: the tilt is not sensed there, the distance is."""
        return np.abs(surface_tilt) <= self.friction_angle

    def _gain(self, tilt: Array) -> Array:
        """Moment rate over that of a surface met squarely."""
        slip = np.maximum(np.abs(tilt), self.friction_angle)
        return np.asarray(np.cos(slip) / np.cos(self.friction_angle))

    def signals(self, whisker: Whisker, contact: Array, *, model: str | None = None) -> Encoded:
        """Moment rate (N m/s) and its direction (rad), (..., 2), and outcome of a contact (..., 2).

        Beyond the whisker, or on a surface steeper than the steepest, it is out of reach.
        """
        contact = np.asarray(contact, dtype=float)
        r, tilt = contact[..., 0], contact[..., 1]
        reached = (r > 0) & (r < whisker.apex_distance) & (r <= whisker.length)
        reached &= np.abs(tilt) <= self.steepest
        outcome = np.where(reached, Outcome.HELD, Outcome.OUT_OF_REACH).astype(np.int8)
        rate = closed_form.moment(whisker, np.where(reached, r, np.nan), self.angular_velocity)
        direction = np.sign(tilt) * np.maximum(np.abs(tilt) - self.friction_angle, 0.0)
        direction = np.where(reached, direction, np.nan)
        return np.stack([rate * self._gain(tilt), direction], axis=-1), outcome

    def jacobian(self, whisker: Whisker, contact: Array, *, model: str | None = None) -> Array:
        contact = np.asarray(contact, dtype=float)
        r, tilt = contact[..., 0], contact[..., 1]
        slips = ~self.sticks(tilt)
        rate = closed_form.moment(whisker, r, self.angular_velocity)
        slope = -whisker.compliance_constant * self.angular_velocity / r**2
        turn = np.where(slips, -np.sin(tilt) / np.cos(self.friction_angle), 0.0)
        rows = [[slope * self._gain(tilt), rate * turn], [np.zeros_like(r), slips.astype(float)]]
        return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)

    def priors(self, whisker: Whisker) -> dict[str, Any]:
        """Flat, of the tilt."""
        return {"surface_tilt": scipy.stats.uniform(-self.steepest, 2 * self.steepest)}

    def default_noise(self) -> Joint:
        """Noise of a tenth of the moment in both of its components: k = 0.1, and 0.1 rad."""
        return Joint([Weber(0.1), GeneralisedWeber(0, floor=0.1)], sizes=[1, 1])
