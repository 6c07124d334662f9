"""The map in three dimensions (§2g): a contact anywhere around the whisker from all its forces."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .._checks import numbers
from ..mechanics.contact import Outcome
from ..receptors import GeneralisedWeber, Joint, Weber
from ..whisker import Whisker
from .force_map import SIGNALS, ForceMap
from .protocol import Array, Cue, Felt, readings, straight


@dataclass(frozen=True, eq=False, repr=False)
class SpaceMap(Cue):
    """Distance, deflection angle and azimuth from moment and forces in all directions.

    The paper's look-up in three dimensions, Scholz & Rahn's with a second plane. A straight whisker
    bends in the plane of its contact, so that the sizes of moment and forces are those of
    `ForceMap`, and the azimuth ω of the contact about the base tangent (from y towards z) is the
    direction of both: F = (−Fx, Fy cos ω, Fy sin ω), moment (0, −M sin ω, M cos ω).

    Examples
    --------
    >>> w = Whisker(length=50e-3, base_radius=100e-6, tip_radius=5e-6)
    >>> signals, outcome = SpaceMap().signals(w, np.array([30e-3, 0.4, 1.0]))
    >>> moment, axial = signals[0] * np.array([-np.sin(1.0), np.cos(1.0)]), signals[1]
    >>> contact, outcome = SpaceMap().contact(w, moment, axial)
    >>> contact.round(9)
    array([0.03, 0.4 , 1.  ])
    """

    signal_names = (*SIGNALS, "moment_direction", "force_direction")
    unknowns = ("radial_distance", "deflection_angle", "azimuth")
    #: The cue without the azimuth, which the directions alone tell of and which tells of no more.
    all_but_last = ForceMap(SIGNALS)

    def signals(self, whisker: Whisker, contact: Array, *, model: str | None = None) -> Felt:
        """Moment, axial and transverse force, and the two directions, (..., 5); outcome."""
        contact = np.asarray(contact, dtype=float)
        return self.given(whisker, contact[..., :2], model=model)(contact[..., 2])

    def given(
        self, whisker: Whisker, contact: Array, *, model: str | None = None
    ) -> Callable[[Array], Felt]:
        """The signals as a function of the azimuth (...), the rest of the contact given."""
        straight(whisker)
        sizes, outcome = self.all_but_last.signals(whisker, contact, model=model)
        signals = np.empty((*outcome.shape, 5))
        signals[..., :3] = sizes

        def turned(azimuth: Array) -> Felt:
            out = signals.copy()
            out[..., 3:] = azimuth[..., None]
            # A direction that is no number is none of a contact.
            off = (outcome == Outcome.HELD) & ~np.isfinite(azimuth)
            found = np.where(off, np.int8(Outcome.OUT_OF_REACH), outcome) if off.any() else outcome
            out[found != Outcome.HELD] = np.nan
            return out, found

        return turned

    def jacobian(self, whisker: Whisker, contact: Array, *, model: str | None = None) -> Array:
        """Derivatives (..., 5, 3) of the signals with respect to r, θ_d and ω."""
        contact = np.asarray(contact, dtype=float)
        out = np.zeros((*contact.shape[:-1], 5, 3))
        out[..., :3, :2] = self.all_but_last.jacobian(whisker, contact[..., :2], model=model)
        out[..., 3:, 2] = 1.0
        return out

    def priors(self, whisker: Whisker) -> dict[str, Any]:
        """Flat all around, of the azimuth."""
        from scipy.stats import uniform

        return {"azimuth": uniform(-np.pi, 2 * np.pi)}

    def default_noise(self) -> Joint:
        """Weber's law, k = 0.1, for the sizes; as much across them: 0.1 rad."""
        return Joint([Weber(0.1), GeneralisedWeber(0, floor=0.1)], sizes=[3, 2])

    def contact(self, whisker: Whisker, moment: ArrayLike, axial_force: ArrayLike) -> Felt:
        """The contact of a moment in two dimensions and an axial force.

        Parameters
        ----------
        whisker : Whisker
        moment : array, shape (..., 2)
            About y and z, N m.
        axial_force : array, shape (...)
            N.

        Returns
        -------
        contact : array, shape (..., 3)
            r (m), θ_d and ω (rad); NaN where there is none.
        outcome : array of int
            As of `ForceMap.contact`; `OUT_OF_REACH` for every reading on a cylinder.
        """
        about = readings("moment", moment, 2)
        size = np.hypot(about[..., 0], about[..., 1])
        axial = numbers("axial_force", axial_force, "give newtons")
        pair = np.stack(np.broadcast_arrays(size, axial), axis=-1)
        place, outcome = ForceMap().contact(whisker, pair)
        turn = np.where(outcome == Outcome.HELD, np.arctan2(-about[..., 0], about[..., 1]), np.nan)
        return np.concatenate([place, turn[..., None]], axis=-1), outcome
