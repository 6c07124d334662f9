"""The map of moment and axial force (§2f): distance and angle of a contact from its signals."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..mechanics import closed_form, ladder
from ..mechanics.contact import Outcome
from ..mechanics.surface import base_signals
from ..receptors import Weber
from ..whisker import Whisker
from .protocol import Array


class ForceMap:
    """Radial distance and deflection angle, both unknown, from moment M and axial force Fx.

    One-to-one on a tapered whisker; on a cylinder M² = 2EI·Fx at every contact, so that the map
    collapses to a curve and the posterior to a ridge.

    Examples
    --------
    >>> w = Whisker(length=50e-3, base_radius=100e-6, tip_radius=5e-6)
    >>> signals, outcome = ForceMap().signals(w, np.array([30e-3, 0.4]))
    >>> contact, outcome = ForceMap().contact(w, signals)
    >>> contact.round(9)
    array([0.03, 0.4 ])
    """

    signal_names: tuple[str, ...] = ("moment", "axial_force")
    unknowns: tuple[str, ...] = ("radial_distance", "deflection_angle")

    def __repr__(self) -> str:
        return "ForceMap()"

    def signals(
        self, whisker: Whisker, contact: Array, *, model: str | None = None
    ) -> tuple[Array, NDArray[np.int8]]:
        """Moment and axial force (..., 2), N m and N, and outcome of a contact (..., 2)."""
        contact = np.asarray(contact, dtype=float)
        r, theta = contact[..., 0], contact[..., 1]
        if model is None:
            signals, outcome = base_signals(whisker, r, theta)
            return signals[..., :2], outcome
        bent = ladder.press(whisker, r, theta, model=model)
        return np.stack([bent.moment, bent.axial_force], axis=-1), np.asarray(
            bent.outcome, dtype=np.int8
        )

    def jacobian(self, whisker: Whisker, contact: Array, *, model: str | None = None) -> Array:
        """Derivatives (..., 2, 2) of M and Fx with respect to r and θ_d."""
        contact = np.asarray(contact, dtype=float)
        r, theta = contact[..., 0], contact[..., 1]
        if model == "closed_form":
            return closed_form.signal_jacobian(whisker, r, theta)[..., :2, :]
        return ladder.signal_jacobian(whisker, r, theta)[..., :2, :]

    def priors(self, whisker: Whisker) -> dict[str, Any]:
        """None: every unknown is bounded by the whisker."""
        return {}

    def default_noise(self) -> Weber:
        """Weber's law, k = 0.1."""
        return Weber(0.1)

    def farthest(self, whisker: Whisker) -> float:
        """The tip, m."""
        return float(whisker.length)

    def contact(
        self, whisker: Whisker, signals: ArrayLike, *, steps: int = 60
    ) -> tuple[Array, NDArray[np.int8]]:
        """The contact that gives these signals, by Newton's method from the closed-form inverse.

        Parameters
        ----------
        whisker : Whisker
        signals : array, shape (..., 2)
            Moment (N m) and axial force (N).

        Returns
        -------
        contact : array, shape (..., 2)
            r (m) and θ_d (rad); NaN where no held contact on this whisker gives the signals.
        outcome : array of int
            `HELD`, or `OUT_OF_REACH` where there is none: every reading on a cylinder, and
            readings too stiff or too slack for this taper.
        """
        wanted = np.asarray(signals, dtype=float)
        start = closed_form.contact_from_signals(whisker, wanted[..., 0], wanted[..., 1])
        contact = np.full(wanted.shape, np.nan)
        known = np.isfinite(start[0])
        contact[known] = self._newton(
            whisker, wanted[known], start[0][known], start[1][known], steps
        )
        # Large angles are far from the closed form: start again from the nearest of a coarse map.
        missed = np.isnan(contact[..., 0]) & np.all(wanted > 0, axis=-1)
        if np.any(missed) and np.any(np.not_equal(whisker.taper, 0)):
            contact[missed] = self._newton(
                whisker, wanted[missed], *self._nearest(whisker, wanted[missed]), steps
            )
        lost = np.isnan(contact[..., 0])
        return contact, np.where(lost, Outcome.OUT_OF_REACH, Outcome.HELD).astype(np.int8)

    def _nearest(self, whisker: Whisker, wanted: Array) -> tuple[Array, Array]:
        """The contact of a coarse map whose signals are nearest in logarithms, (n,) each."""
        r = np.linspace(0.01, 0.99, 50)[:, None] * whisker.length
        share = np.sin(np.linspace(0.02, 0.98, 50) * np.pi / 2)
        theta = share * ladder.flick_past(whisker, r).deflection_angle
        grid = np.stack(np.broadcast_arrays(r, theta), axis=-1).reshape(-1, 2)
        known = np.log(self.signals(whisker, grid)[0])
        best = [np.nansum((known - y) ** 2, axis=1).argmin() for y in np.log(wanted)]
        return grid[best, 0], grid[best, 1]

    def _newton(self, whisker: Whisker, wanted: Array, r: Array, theta: Array, steps: int) -> Array:
        """Newton's method in logarithms, in which the map is nearly linear. NaN where it fails."""
        length = float(whisker.length)
        r = np.minimum(r, 0.98 * length)
        miss = np.full(wanted.shape, np.inf)
        for _ in range(steps):
            theta = np.minimum(theta, 0.995 * ladder.flick_past(whisker, r).deflection_angle)
            point = np.stack([r, theta], axis=-1)
            now, _ = self.signals(whisker, point, model="elastica")
            miss = np.log(wanted / now)
            if np.all(np.abs(miss) < 1e-13):
                break
            (a, b), (c, d) = np.moveaxis(
                self.jacobian(whisker, point) / now[..., :, None] * point[..., None, :], 0, -1
            )
            determinant = a * d - b * c
            step_r = np.clip((d * miss[:, 0] - b * miss[:, 1]) / determinant, -0.3, 0.3)
            step_theta = np.clip((a * miss[:, 1] - c * miss[:, 0]) / determinant, -0.3, 0.3)
            r = np.where(r * np.exp(step_r) < length, r * np.exp(step_r), (r + length) / 2)
            theta = theta * np.exp(step_theta)
        found = np.all(np.abs(miss) < 1e-9, axis=-1)
        return np.where(found[:, None], np.stack([r, theta], axis=-1), np.nan)
