"""Small vibrations: natural frequencies and mode shapes.

§2d. An Euler–Bernoulli cantilever, clamped at the base and free at the tip,

    (EI y″)″ = ω² m(s) y,   m = ρ π (a² − core²),

of any profile, by Rayleigh and Ritz's method on twice integrated Legendre polynomials, with Gauss's
rule on each piece. The basis satisfies the clamped end exactly and the free end naturally: the
frequencies converge from above, exponentially for a whisker of one piece, and a perfect cone needs
no special case. Intrinsic curvature is left out: whiskers are nearly straight over a wavelength.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import ArrayLike
from scipy.linalg import eigh, null_space

from .._util.checks import finite, whole
from .._util.refusals import Refusal
from .._util.values import Array, Line
from ..whisker import Whisker
from .shape import Profile

__all__ = ["Modes", "basis", "gauss", "modes", "one_profile", "ritz"]


@dataclass(frozen=True, eq=False, repr=False)
class Modes(Line):
    """The first modes of a whisker, lowest first.

    Attributes
    ----------
    angular_frequency : array, shape (n,)
        Undamped ω, rad/s.
    error : array, shape (n,)
        Estimated relative error of the frequencies, from a basis of three quarters the size.
    coefficients : array, shape (n, basis)
        Of the shapes, over twice integrated Legendre polynomials in s/L; unit modal mass.
    profile : Profile
    """

    angular_frequency: Array
    error: Array
    coefficients: Array
    profile: Profile

    def _line(self) -> str:
        return f"{', '.join(f'{f:.4g}' for f in self.frequency)} Hz"

    @property
    def frequency(self) -> Array:
        """Hz."""
        return self.angular_frequency / (2 * np.pi)

    @property
    def normalised_frequency(self) -> Array:
        """ω √(ρ A₀ L⁴/EI₀), as in the tables."""
        w = self.profile.whisker
        line = w.density * np.pi * w.base_radius**2
        return np.asarray(self.angular_frequency * np.sqrt(line * w.length**4 / w.stiffness))

    def shape(self, arc_length: ArrayLike) -> Array:
        """Mode shapes φ_n(s), kg^(−1/2), shape (n, ...): ∫ m φ_i φ_j ds = 1 for i = j, else 0.

        Positive at the tip.
        """
        return self.derivative(arc_length, 0)

    @property
    def base_moment(self) -> Array:
        """Moment at the base, N m per unit modal coordinate, shape (n,): ω² ∫ m φ_n s ds.

        Equal to EI(0) φ_n″(0), and more accurate where a profile has kinks.
        """
        return self._inertia(1)

    @property
    def base_shear(self) -> Array:
        """Transverse force at the base per unit modal coordinate, N: ω² ∫ m φ_n ds."""
        return self._inertia(0)

    def _inertia(self, power: int) -> Array:
        s, weight = gauss(self.profile.arc, self.coefficients.shape[1])
        load = self.profile.line_density(s) * weight * s**power
        return np.asarray(self.angular_frequency**2 * (self.shape(s) @ load))

    def derivative(self, arc_length: ArrayLike, order: int) -> Array:
        """Derivatives of the shapes with respect to arc length, order 0 to 2, shape (n, ...)."""
        length = self.profile.whisker.length
        s = finite("arc_length", arc_length, "give metres, such as 35e-3")
        if np.any((s < 0) | (s > length * (1 + 1e-12))):
            raise Refusal(
                f"arc_length must be on the whisker of {length:g} m",
                f"{s.flat[np.argmax(np.abs(s - length / 2))]:g}",
                "give metres from the base",
            )
        values = basis(s.reshape(-1) / length, self.coefficients.shape[1], order)
        return np.asarray(self.coefficients @ values / length**order).reshape(-1, *s.shape)


def modes(whisker: Whisker | Profile, count: int = 5) -> Modes:
    """The first natural frequencies and mode shapes of one whisker.

    Parameters
    ----------
    whisker : Whisker or Profile
        One whisker: scalar fields.
    count : int
        How many modes, up to 12.

    Raises
    ------
    ValueError
        For several whiskers at once, and a count outside 1 to 12.

    Examples
    --------
    >>> w = Whisker(50e-3, 100e-6, 5e-6, 3e9)
    >>> modes(w, 3).normalised_frequency.round(3)
    array([ 7.894, 19.448, 36.51 ])
    """
    profile = one_profile(whisker, "modes")
    if not 1 <= (count := whole("count", count, "write count=5", least=0)) <= 12:
        raise Refusal("count must be 1 to 12", count, "write count=5")
    size = 60 if np.sum(np.diff(profile.arc) > 0) == 1 else 70
    omega, vectors = ritz(profile, size, count)
    fewer, _ = ritz(profile, 3 * size // 4, count)
    error = np.abs(fewer / omega - 1) + 1e-12
    vectors = vectors * np.sign(basis(np.ones(1), size, 0).T @ vectors)  # up at the tip
    return Modes(omega, error, vectors.T, profile)


def one_profile(whisker: Whisker | Profile, name: str) -> Profile:
    """The profile of one whisker; several are refused, with the function's `name`."""
    profile = Profile.of(whisker)
    fields = (profile.radius[0], profile.whisker.density, profile.whisker.youngs_modulus)
    if shape := np.broadcast_shapes(*map(np.shape, fields)):
        raise Refusal(
            f"{name}() takes one whisker at a time",
            f"an array of shape {shape}",
            "call it for each",
        )
    return profile


def ritz(
    profile: Profile, size: int, count: int, pinned: float | None = None
) -> tuple[Array, Array]:
    """ω (count,) and shapes (size, count) of unit modal mass; with an arc `pinned`, held there."""
    length = float(profile.whisker.length)
    s, weight = gauss(profile.arc if pinned is None else np.append(profile.arc, pinned), size + 8)
    bent, moved = basis(s / length, size, 2) / length**2, basis(s / length, size, 0)
    free = np.eye(size)
    if pinned is not None:
        free = null_space(basis(np.array([pinned / length]), size, 0).T)
        bent, moved = free.T @ bent, free.T @ moved
    stiffness = (bent * (weight * profile.stiffness(s))) @ bent.T
    mass = (moved * (weight * profile.line_density(s))) @ moved.T
    # Scaled to a unit diagonal, so that rounding does not swamp the rows of a thin tip.
    scale = 1 / np.sqrt(np.diag(stiffness))
    last = len(scale)
    # The larger form on the right: its inverse's largest eigenvalues are the lowest frequencies.
    inverse, vectors = eigh(
        mass * np.outer(scale, scale),
        stiffness * np.outer(scale, scale),
        subset_by_index=(last - count, last - 1),
    )
    omega = 1 / np.sqrt(inverse[::-1])
    return omega, free @ (scale[:, None] * vectors[:, ::-1] * omega)


def gauss(knots: Array, n: int) -> tuple[Array, Array]:
    """Nodes and weights of Gauss and Legendre's rule of n points between successive knots."""
    x, w = legendre.leggauss(n)
    knots = np.unique(knots)
    start, gap = knots[:-1, None], np.diff(knots)[:, None]
    return ((x + 1) / 2 * gap + start).ravel(), (w / 2 * gap).ravel()


def basis(x: Array, size: int, order: int) -> Array:
    """The order-th x-derivatives of the twice integrated P_k(2x − 1), shape (size, len(x))."""
    series = np.eye(size)
    for _ in range(2 - order):
        series = legendre.legint(series, lbnd=-1, axis=0) / 2
    return np.asarray(series.T @ legendre.legvander(2 * x - 1, len(series) - 1).T)
