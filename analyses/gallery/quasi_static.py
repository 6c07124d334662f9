"""Up to which whisking frequency a whisker in contact is in balance at every angle.

The base turns by θ while a peg holds it at r. To first order in the angle the exact
displacement is u₀θ + v: u₀ the static shape (base at slope 1, held at r, straight beyond), v the
motion of the beam that is clamped and pinned there. With its modes ψₙ of unit modal mass and
pₙ = ∫ m u₀ ψₙ ds, and as EI ψₙ″(0) = ωₙ² pₙ by reciprocity, a steady sinusoid makes the moment
fall short by

    1 − M(ω)/M(0) = Σ pₙ² ωₙ²/M(0) · ω²/(ωₙ² − ω²).

All terms have one sign, and Σ pₙ² = ∫ m u₀² ds. So the error lies between (ω/ω_q)² and
(ω/ω_q)² / (1 − (ω/ω₁)²), where ω_q² = M(0)/∫ m u₀² ds is the static shape's Rayleigh quotient.

A whisker that comes on at a steady rate and strikes the peg at t = 0 has the velocity s where the
static shape's is u₀: v starts at s − u₀, with bₙ = ∫ m (s − u₀) ψₙ ds of it in each mode (what the
peg stops at once is orthogonal to them), and rings with the moment, over M(0) t,

    − Σ ωₙ pₙ bₙ exp(−ζωₙt) sin(ωₙ√(1 − ζ²) t) / (√(1 − ζ²) M(0) t).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq

from weberwhisk import Whisker
from weberwhisk.mechanics import Profile
from weberwhisk.mechanics.modes import basis, gauss, one_profile, ritz

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class QuasiStatic:
    """How far inertia moves the base moment of a whisker that is held at a contact.

    Attributes
    ----------
    first_frequency : float
        Hz; of the whisker clamped at its base and pinned at the contact.
    rayleigh_frequency : float
        Hz; f_q, of the static shape.
    angular_frequency, excitation : array (n,)
        Of its modes, rad/s, and what a first contact excites of each: ω p b/M(0), s.
    """

    first_frequency: float
    rayleigh_frequency: float
    angular_frequency: Array
    excitation: Array

    def error(self, frequency: ArrayLike) -> tuple[Array, Array]:
        """Least and largest 1 − M(f)/M(0) of a steady sinusoidal whisk, Hz.

        The largest is infinite from the first natural frequency on.
        """
        f = np.asarray(frequency, dtype=float)
        least = (f / self.rayleigh_frequency) ** 2
        left = 1 - (f / self.first_frequency) ** 2
        most = np.where(left > 0, least / np.where(left > 0, left, 1.0), np.inf)
        return least, most[()]

    def limit(self, error: ArrayLike) -> Array:
        """Frequency, Hz, up to which the moment is off by no more than a relative error.

        With a moment of which distance is judged under Weber's law, an error of k/10 moves the
        distance by a tenth of a JND.
        """
        e = np.asarray(error, dtype=float)
        slow = self.rayleigh_frequency**-2.0 + e / self.first_frequency**2
        return np.sqrt(e / slow)[()]

    def onset(self, time: ArrayLike, damping_ratio: float = 0.1) -> Array:
        """Largest share of the moment that a first contact still rings with, s after it.

        Parameters
        ----------
        time : float or array (...)
            Since a whisker that came on at a steady rate, and goes on so, met a peg, s.
        damping_ratio : float
            Of every mode, above 0: without damping the moment of impact never has a bound.

        Examples
        --------
        >>> found = quasi_static(Whisker(50e-3, 100e-6, 5e-6), 30e-3)
        >>> found.onset([5e-3, 20e-3]).round(3)
        array([0.498, 0.025])
        """
        t = np.asarray(time, dtype=float)
        rings = np.exp(-damping_ratio * t[..., None] * self.angular_frequency) @ np.abs(
            self.excitation
        )
        return np.asarray(rings / (t * np.sqrt(1 - damping_ratio**2)))

    def settled(self, error: float, damping_ratio: float = 0.1) -> float:
        """Time, s, from which on a first contact rings with no more than a share of the moment."""

        def excess(log: float) -> float:
            rings = float(self.onset(np.exp(log), damping_ratio))
            return float(np.log(max(rings, 1e-300) / error))

        slowest = 1 / self.angular_frequency[0]
        return float(np.exp(brentq(excess, np.log(1e-6 * slowest), np.log(1e4 * slowest))))


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
    To first order in the angle. `QuasiStatic.error` is of a steady whisk in contact, whose base
    turns as a sinusoid, without damping; `QuasiStatic.onset` of what rings when a whisker strikes.
    In free air the whisker is a cantilever, whose first frequency (`modes`) is lower.

    Examples
    --------
    >>> found = quasi_static(Whisker(50e-3, 100e-6, 5e-6), 30e-3)
    >>> print(f"{found.first_frequency:.0f} Hz; 1 % at {found.limit(0.01):.0f} Hz")
    84 Hz; 1 % at 10 Hz
    """
    profile = one_profile(whisker, "quasi_static")
    length = float(profile.whisker.length)
    r = radial_distance
    if not 0 < r < length * (1 + 1e-9):
        raise ValueError(
            f"radial_distance must be on the whisker of {length:g} m, got {r:g}; give metres."
        )
    r = min(r, length)
    omega, shapes = ritz(profile, 60, 30, r)
    s, weight = gauss(np.append(profile.arc, r), 80)
    stiffness, mass = profile.stiffness(s), weight * profile.line_density(s)
    inner = np.where(s < r, r - s, 0.0)
    # u₀″ = −c (r − s)/EI up to the peg, c by u₀(r) = 0; the moment at the base is c r.
    bent = weight * inner / stiffness
    c = r / float(inner @ bent)
    static = s - c * np.array([bent[s < x] @ (x - s[s < x]) for x in s])
    rayleigh = np.sqrt(c * r / float(mass @ static**2))
    modal = mass * (shapes.T @ basis(s / length, len(shapes), 0))
    excitation = omega * (modal @ static) * (modal @ (s - static)) / (c * r)
    turn = 2 * np.pi
    return QuasiStatic(float(omega[0]) / turn, float(rayleigh) / turn, omega, excitation)
