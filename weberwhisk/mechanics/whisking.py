"""How fast a whisker may whisk before its own inertia shows in the moment at its base.

Everywhere else the whisker is in balance at every angle. Here its base turns by θ cos ωt while a
peg holds it at r. To first order in the angle the exact displacement is u₀ + v: u₀ the static shape
(base at slope θ, held at r, straight beyond), v the response of the beam that is clamped and pinned
there to the inertia of u₀. With its modes ψₙ of unit modal mass and pₙ = ∫ m u₀ ψₙ ds, and as
EI ψₙ″(0) = ωₙ² pₙ/θ by reciprocity, the moment at the base falls by

    1 − M(ω)/M(0) = Σ pₙ² ωₙ² / (θ M(0)) · ω²/(ωₙ² − ω²).

All terms have one sign, and Σ pₙ² = ∫ m u₀² ds. So the error lies between (ω/ω_q)² and
(ω/ω_q)² / (1 − (ω/ω₁)²), where ω_q² = θ M(0)/∫ m u₀² ds is the static shape's Rayleigh quotient.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import eigh, null_space

from .._checks import finite, positive
from ..whisker import Whisker
from .modes import _BASIS, _basis, _gauss
from .shape import Profile


@dataclass(frozen=True, eq=False)
class QuasiStatic:
    """How far inertia moves the base moment of a whisker that is held at a contact.

    Attributes
    ----------
    first_frequency : float
        Hz; of the whisker clamped at its base and pinned at the contact.
    rayleigh_frequency : float
        Hz; f_q, of the static shape.
    """

    first_frequency: float
    rayleigh_frequency: float

    def error(self, frequency: ArrayLike) -> tuple[Any, Any]:
        """Least and largest 1 − M(f)/M(0) of a steady sinusoidal whisk, Hz.

        The largest is infinite from the first natural frequency on.
        """
        f = positive("frequency", frequency, "give hertz, such as 8")
        least = (f / self.rayleigh_frequency) ** 2
        left = 1 - (f / self.first_frequency) ** 2
        most = np.where(left > 0, least / np.where(left > 0, left, 1.0), np.inf)
        return least, most[()]

    def limit(self, error: ArrayLike) -> Any:
        """Frequency, Hz, up to which the moment is off by no more than a relative error.

        With a moment of which distance is judged under Weber's law, an error of k/10 moves the
        distance by a tenth of a JND.
        """
        e = positive("error", error, "write 0.01, say")
        slow = self.rayleigh_frequency**-2.0 + e / self.first_frequency**2
        return np.sqrt(e / slow)[()]

    def note(self, frequency: float, weber_fraction: float = 0.1) -> str:
        """Whether a quasi-static answer holds at a whisking frequency, in a sentence.

        Examples
        --------
        >>> found = quasi_static(Whisker(50e-3, 100e-6, 5e-6), 30e-3)
        >>> print(found.note(8.0))
        At 8 Hz inertia takes at most 0.66 % off the moment, 0.066 JND: quasi-static mechanics hold.
        """
        most = float(self.error(frequency)[1])
        jnds = most / weber_fraction
        said = f"At {frequency:g} Hz inertia takes at most {100 * most:.2g} % off the moment"
        if not np.isfinite(most):
            return (
                f"{frequency:g} Hz is beyond the first natural frequency of the held whisker, "
                f"{self.first_frequency:.3g} Hz: quasi-static mechanics do not hold."
            )
        if jnds <= 0.1:
            return f"{said}, {jnds:.2g} JND: quasi-static mechanics hold."
        return (
            f"{said}, {jnds:.2g} JND: quasi-static mechanics hold up to "
            f"{float(self.limit(weber_fraction / 10)):.3g} Hz."
        )


def quasi_static(whisker: Whisker | Profile, radial_distance: float) -> QuasiStatic:
    """Up to which whisking frequency quasi-static mechanics hold, for a contact at a distance.

    Parameters
    ----------
    whisker : Whisker or Profile
        One whisker; its curvature at rest is left out, as of `modes`.
    radial_distance : float
        Of the contact, m.

    Returns
    -------
    QuasiStatic

    Raises
    ------
    ValueError
        For a contact off the whisker.

    Notes
    -----
    Of a steady whisk in contact, whose base turns as a sinusoid, to first order in the angle and
    without damping. What rings when a whisker strikes is `impulse_response`'s. In free air the
    whisker is a cantilever, whose first frequency (`modes`) is lower.

    Examples
    --------
    >>> found = quasi_static(Whisker(50e-3, 100e-6, 5e-6), 30e-3)
    >>> print(f"{found.first_frequency:.0f} Hz; 1 % at {found.limit(0.01):.0f} Hz")
    84 Hz; 1 % at 10 Hz
    """
    profile = whisker if isinstance(whisker, Profile) else Profile.of(whisker)
    length = float(profile.whisker.length)
    r = float(finite("radial_distance", radial_distance, "give metres, such as 30e-3"))
    if not 0 < r < length * (1 + 1e-9):
        raise ValueError(
            f"radial_distance must be on the whisker of {length:g} m, got {r:g}; give metres."
        )
    r = min(r, length)
    knots = np.unique(np.append(np.asarray(profile.arc, dtype=float).ravel(), r))
    s, weight = _gauss(knots, 80)
    stiffness, mass = profile.stiffness(s), profile.line_density(s)
    inner = np.where(s < r, r - s, 0.0)
    # u₀″ = −c (r − s)/EI up to the peg, c by u₀(r) = 0 for θ = 1; the moment at the base is c r.
    compliance = float(weight @ (inner**2 / stiffness))
    c = r / compliance
    bent = weight * inner / stiffness
    static = s - c * np.array([bent[s < x] @ (x - s[s < x]) for x in s])
    rayleigh = np.sqrt(c * r / float(weight @ (mass * static**2)))
    curved, moved = _basis(s / length, _BASIS, 2) / length**2, _basis(s / length, _BASIS, 0)
    pinned = null_space(_basis(np.array([r / length]), _BASIS, 0).T)
    forms = [
        pinned.T @ ((values * (weight * load)) @ values.T) @ pinned
        for values, load in ((curved, stiffness), (moved, mass))
    ]
    scale = 1 / np.sqrt(np.diag(forms[0]))
    bend, move = (form * np.outer(scale, scale) for form in forms)
    size = len(scale)
    inverse = eigh(move, bend, eigvals_only=True, subset_by_index=(size - 1, size - 1))
    return QuasiStatic(float(inverse[0] ** -0.5) / (2 * np.pi), float(rayleigh) / (2 * np.pi))


__all__ = ["QuasiStatic", "quasi_static"]
