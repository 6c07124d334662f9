"""A whisker along its arc: radius, hollow core, intrinsic curvature.

The radius of a `Profile` is linear in arc length on each piece: one piece is a linear taper, more
are a tabulated radius. A second table is the hollow core (the medulla). Intrinsic curvature is one
of two laws, each with a closed form.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .. import domain
from .._util.checks import finite, kind, non_negative, positive, refuse_hinge
from .._util.refusals import Refusal
from .._util.values import Array, Value
from ..whisker import DENSITY, YOUNGS_MODULUS, Assumed, Whisker

__all__ = ["Law", "Parabola", "Profile", "Spiral", "bent_shape", "with_modulus"]

_METRES = "give metres, such as 5e-3"
_PER_METRE = "give 1/m, such as 20, or 0 for none"


@dataclass(frozen=True, eq=False, repr=False, init=False)
class Spiral(Value):
    """Intrinsic curvature ``base + rate · s``: straight, circular or an Euler spiral.

    Parameters
    ----------
    base : float or array
        Curvature at the base, 1/m. Positive bends towards the side that a positive force pushes
        to: contact on the convex side. Negative: contact on the concave side.
    rate : float or array
        Change of curvature along the arc, 1/m².
    """

    base: Array
    rate: Array

    def __init__(self, base: ArrayLike = 0.0, rate: ArrayLike = 0.0) -> None:
        given = finite("base", base, _PER_METRE)
        self._set(base=given, rate=finite("rate", rate, "give 1/m², or 0"))

    @classmethod
    def through(cls, x: ArrayLike, y: ArrayLike) -> Spiral:
        """Fit the law to points on a whisker at rest by least squares of distances.

        The frame has y to the left of x: in an image, whose y runs down, write −y. Arc lengths are
        those of the polygon through all points. `tracked_signals` takes tracked videos as they are.

        Parameters
        ----------
        x, y : array, shape (n,)
            Points from the base on, m; four or more.

        Raises
        ------
        ValueError
            For fewer points, other shapes, points that do not move, and millimetres.

        Examples
        --------
        >>> x = np.linspace(0, 30e-3, 40)
        >>> law = Spiral.through(x, 4 * x**2)
        >>> print(f"{law.base:.1f} /m at the base, {law.turn(30e-3):.2f} rad up to 30 mm")
        8.1 /m at the base, 0.23 rad up to 30 mm
        """
        from scipy.optimize import least_squares

        across, up = finite("x", x, _METRES), finite("y", y, _METRES)
        moving = across.shape == up.shape and (np.diff(across) != 0) | (np.diff(up) != 0)
        if across.ndim != 1 or across.size < 4 or not np.all(moving):
            raise Refusal(
                "A shape at rest takes four points or more, no two in a row the same",
                f"x of shape {across.shape} and y of {up.shape}",
                "give both (n,), from the base on",
            )
        points = across + 1j * up
        arc = np.append(0.0, np.cumsum(np.abs(np.diff(points))))
        domain.refuse_length(arc[-1], 0.0)
        unit = (points - points[0]) / arc[-1]

        def miss(values: Array) -> Array:
            base, rate, *place = values
            at = np.stack(cls(base, rate).point(arc / arc[-1]))
            off = (at[0] + 1j * at[1]) * np.exp(1j * place[0]) + place[1] + 1j * place[2] - unit
            return np.concatenate([off.real, off.imag])

        solution = least_squares(miss, [0.0, 0.0, np.angle(unit[1]), 0.0, 0.0])
        return cls(*solution.x[:2]).scaled(1 / arc[-1])

    def __call__(self, arc: Array) -> Array:
        """Curvature at the arc lengths `arc`."""
        return np.asarray(self.base + self.rate * arc)

    def turn(self, arc: Array) -> Array:
        """Tangent angle at the arc lengths `arc`, rad."""
        return np.asarray(arc * (self.base + self.rate * arc / 2))

    def point(self, arc: Array) -> tuple[Array, Array]:
        """x and y (n,) at the arc lengths `arc` (n,): of a circle, or by quadrature."""
        if not np.any(self.rate):
            half = self.turn(arc) / 2
            chord = arc * np.sinc(half / np.pi)
            return chord * np.cos(half), chord * np.sin(half)
        winding = float(np.max(np.abs(self.turn(arc)), initial=0.0))
        x, w = np.polynomial.legendre.leggauss(10 + int(4 * winding))
        turn = self.turn((x[:, None] + 1) / 2 * arc)
        return w @ np.cos(turn) * arc / 2, w @ np.sin(turn) * arc / 2

    def scaled(self, length: Array, sign: Array | float = 1.0) -> Spiral:
        """The law in units of `length`, mirrored where `sign` is −1."""
        return Spiral(self.base * length * sign, self.rate * length**2 * sign)


@dataclass(frozen=True, eq=False, repr=False, init=False)
class Parabola(Value):
    """Intrinsic shape y = a·x²: curvature 2a cos³(tangent angle).

    Parameters
    ----------
    coefficient : float or array
        a, 1/m; its sign as for `Spiral`.
    """

    coefficient: Array

    def __init__(self, coefficient: ArrayLike) -> None:
        self._set(coefficient=finite("coefficient", coefficient, _PER_METRE))

    def __call__(self, arc: Array) -> Array:
        """Curvature at the arc lengths `arc`."""
        square = 1 + self._slope(arc) ** 2
        return np.asarray(2 * self.coefficient / (square * np.sqrt(square)))

    def turn(self, arc: Array) -> Array:
        """Tangent angle at the arc lengths `arc`, rad."""
        return np.arctan(self._slope(arc))

    def point(self, arc: Array) -> tuple[Array, Array]:
        """x and y (n,) at the arc lengths `arc` (n,)."""
        straight = np.asarray(2 * self.coefficient * arc)
        x = arc * np.divide(
            self._slope(arc), straight, out=np.ones_like(straight), where=straight != 0
        )
        return x, self.coefficient * x**2

    def scaled(self, length: Array, sign: Array | float = 1.0) -> Parabola:
        """The law in units of `length`, mirrored where `sign` is −1."""
        return Parabola(self.coefficient * length * sign)

    def _slope(self, arc: Array) -> Array:
        """t = 2ax at arc s: t√(1+t²) + asinh t = 4as."""
        sigma = np.asarray(2 * self.coefficient * arc)
        # A fit good to 2e-4 for every σ = 2as, in a variable with the branch points (σ = ±iπ/4) and
        # the growth of t; one step of Halley's method makes that 1e-12.
        z = np.sqrt(np.sqrt(1 + (sigma * (4 / np.pi)) ** 2))
        t = sigma * (1.02674404 + z * (1.82957611 + z * 0.03793815))
        t /= 1 + z * (0.72496427 + z * (1.14584214 + z * 0.02377654))
        root = np.sqrt(1 + t * t)
        miss = (t * root + np.arcsinh(t)) / 2 - sigma
        return np.asarray(t - miss / (root - miss * t / (2 * root * root)))


Law = Spiral | Parabola


def with_modulus(whisker: Whisker | Profile, youngs_modulus: float) -> Any:
    """The whisker or profile of another Young's modulus, Pa."""
    if isinstance(whisker, Profile):
        return replace(whisker, whisker=with_modulus(whisker.whisker, youngs_modulus))
    return replace(whisker, youngs_modulus=youngs_modulus)


@dataclass(frozen=True, eq=False, repr=False)
class Profile(Value):
    """A whisker whose stiffness and curvature vary along the arc in any way.

    `of` and `tabulated` make one; `cut`, `hollow` and `curved` change it.

    Parameters
    ----------
    whisker : Whisker
        Length, base radius, modulus and density, which set the scales of results. The tables below
        replace its tip radius and curvature.
    arc : array, shape (k, ...)
        Arc length of the knots, m, ascending from 0 to the length. A knot given twice makes a step.
    radius, core : array, shape (k, ...)
        Outer radius and radius of the hollow core at the knots, m; linear between them.
    law : Spiral or Parabola
        Intrinsic curvature.
    """

    whisker: Whisker
    arc: Array
    radius: Array
    core: Array
    law: Law

    def __post_init__(self) -> None:
        hint = "write ww.mechanics.Profile.of(whisker)"
        kind("whisker", self.whisker, "a Whisker", "stiffness", hint)
        refuse_hinge(self.whisker, "A Profile")
        hint = "write ww.mechanics.Spiral(20.0), say"
        kind("law", self.law, "a Spiral or a Parabola", "turn", hint)
        for name in ("arc", "radius", "core"):
            self._set(**{name: finite(name, getattr(self, name), _METRES)})

    @classmethod
    def of(cls, whisker: Whisker | Profile) -> Profile:
        """The profile of a linearly tapered whisker of constant curvature; a profile as it is."""
        if isinstance(whisker, Profile):
            return whisker
        kind("whisker", whisker, "a Whisker", "taper", "write ww.Whisker(50e-3, 100e-6, 5e-6), say")
        ends = (0.0, whisker.length, whisker.base_radius, whisker.tip_radius)
        table = np.stack(np.broadcast_arrays(*ends)).astype(float)
        arc, radius = table[:2], table[2:]
        return cls(whisker, arc, radius, np.zeros_like(radius), Spiral(whisker.curvature))

    @classmethod
    def tabulated(
        cls,
        arc: ArrayLike,
        radius: ArrayLike,
        *,
        core: ArrayLike = 0.0,
        law: Law | None = None,
        youngs_modulus: ArrayLike = YOUNGS_MODULUS,
        density: ArrayLike = DENSITY,
    ) -> Profile:
        """A profile from a table of radii, linear between the knots.

        Parameters
        ----------
        arc : array, shape (k,)
            Arc length of the knots, m, from 0 at the base to the length; a knot given twice makes
            a step.
        radius, core : array, shape (k,)
            Outer radius and radius of the hollow core, m.
        law : Spiral or Parabola, optional
            Intrinsic curvature; default straight.
        youngs_modulus, density : float
            Pa, kg/m³.

        Raises
        ------
        ValueError
            For fewer than two knots, knots that do not ascend from 0, and a core that is not
            inside the whisker.

        Examples
        --------
        >>> p = Profile.tabulated([0, 20e-3, 50e-3], [100e-6, 70e-6, 5e-6])
        >>> print(p.whisker.length, p.stiffness(0.0) / p.whisker.stiffness)
        0.05 1.0
        """
        s = finite("arc", arc, "give metres from base to tip")
        a = non_negative("radius", radius, "give metres, such as 1e-4")
        hole = non_negative("core", core, "give metres, or 0 for a solid whisker")
        if s.ndim != 1 or s.size < 2 or s[0] != 0 or np.any(np.diff(s) < 0) or s[-1] == 0:
            raise Refusal(
                "arc must ascend from 0 at the base in two knots or more",
                s.tolist(),
                "give one row of metres such as [0, 20e-3, 50e-3]",
            )
        if a.shape != s.shape or hole.shape not in ((), s.shape):
            raise Refusal(
                "radius and core need one value a knot",
                f"shapes {a.shape} and {hole.shape} for {s.size} knots",
                "give tables of one length",
            )
        bow = Assumed(0.0) if law is None else 0.0
        whisker = Whisker(s[-1], np.max(a), min(a[-1], np.max(a)), youngs_modulus, bow, density)
        if a[0] != np.max(a):
            whisker = Whisker(s[-1], a[0], min(a[-1], a[0]), youngs_modulus, bow, density)
        made = cls(whisker, s, a, np.broadcast_to(hole, s.shape).copy(), law or Spiral())
        return made._checked()

    def cut(self, length: ArrayLike) -> Profile:
        """The same whisker with its tip cut off at `length`, m.

        Raises
        ------
        ValueError
            For a length beyond the tip.

        Examples
        --------
        >>> w = Whisker(length=50e-3, base_radius=100e-6, tip_radius=5e-6)
        >>> print(Profile.of(w).cut(25e-3).whisker.tip_radius)
        5.25e-05
        """
        end = positive("length", length, _METRES)
        if np.any(end > self.whisker.length):
            raise Refusal(
                f"A whisker of {np.min(self.whisker.length):g} m cannot be cut at "
                f"{np.max(end):g} m",
                remedy="give a length up to its own",
            )
        tables = np.stack(np.broadcast_arrays(self.arc, self.radius, self.core, end[None]))
        kept = np.empty_like(tables[:3])
        for at in np.ndindex(tables.shape[2:]):
            s, a, c, e = tables[:, :, *at]
            kept[:, :, *at] = [np.interp(np.minimum(s, e), s, table) for table in (s, a, c)]
        old = self.whisker
        whisker = replace(old, length=kept[0, -1], tip_radius=np.minimum(kept[1, -1], kept[1, 0]))
        return replace(self, whisker=whisker, arc=kept[0], radius=kept[1], core=kept[2])

    def hollow(self, core_radius: ArrayLike, end: ArrayLike) -> Profile:
        """The same whisker with a medulla: a hollow cone, widest at the base, ending at `end`.

        Parameters
        ----------
        core_radius, end : float
            Radius of the core at the base and arc length at which it has narrowed to nothing, m.

        Raises
        ------
        ValueError
            For a core that is not inside the whisker, and for a table of several pieces.
        """
        core = non_negative("core_radius", core_radius, "give metres, such as 3e-5")
        stop = positive("end", end, _METRES)
        if len(self.arc) != 2:
            raise Refusal(
                "hollow() needs a whisker of one piece",
                len(self.arc) - 1,
                "give the core's table to ww.mechanics.Profile.tabulated(core=...)",
            )
        if np.any(stop > self.whisker.length):
            raise Refusal(
                f"The medulla must end on the whisker of {np.min(self.whisker.length):g} m",
                f"{np.max(stop):g} m",
                "give an end up to its length",
            )
        share = stop / self.whisker.length
        arc, middle, core = np.broadcast_arrays(
            self.arc[1], self.radius[0] + share * (self.radius[1] - self.radius[0]), core
        )
        zero = np.zeros_like(arc)
        made = replace(
            self,
            arc=np.stack([zero, arc * share, arc]),
            radius=np.stack([zero + self.radius[0], middle, zero + self.radius[1]]),
            core=np.stack([core, zero, zero]),
        )
        return made._checked()

    def curved(self, law: Law) -> Profile:
        """The same whisker with another intrinsic curvature."""
        return replace(self, law=law)

    def stiffness(self, arc: ArrayLike) -> Array:
        """Bending stiffness EI at the arc lengths `arc` (one row of knots only), N m²."""
        s = np.asarray(arc, dtype=float)
        a, c = (np.interp(s, self.arc, table) for table in (self.radius, self.core))
        return np.asarray(self.whisker.youngs_modulus * np.pi / 4 * (a**4 - c**4))

    def line_density(self, arc: ArrayLike) -> Array:
        """Mass per arc length at `arc` (one row of knots only), kg/m."""
        s = np.asarray(arc, dtype=float)
        a, c = (np.interp(s, self.arc, table) for table in (self.radius, self.core))
        return np.asarray(self.whisker.density * np.pi * (a**2 - c**2))

    def _checked(self) -> Profile:
        bad = (self.core >= self.radius) & (self.core > 0)
        if np.any(bad):
            raise Refusal(
                "The core must be inside the whisker",
                f"a core of {self.core[bad].flat[0]:g} m in a radius of "
                f"{self.radius[bad].flat[0]:g} m",
                "give a narrower core",
            )
        return self


def bent_shape(
    profile: Profile, arc: Array, contact_arc: float, force: float, friction_angle: float = 0.0
) -> Array:
    """Tangent angle, x and y (3, n) at arcs (n,), ascending, of a whisker with a force at
    `contact_arc`.

    In the frame of the base; by SciPy's DOP853 from the contact to the base, at rest beyond it.
    """
    from scipy.integrate import solve_ivp

    across, along = force * np.cos(friction_angle), -force * np.sin(friction_angle)

    def rates(s: float, state: Array) -> list[float]:
        angle, x, y = state
        moment = along * y - across * x  # the contact is the origin, and its tangent the x axis
        bend = moment / float(profile.stiffness(s)) + float(profile.law(np.array(s)))
        return [bend, np.cos(angle), np.sin(angle)]

    near, law = arc[arc <= contact_arc], profile.law
    inner = solve_ivp(
        rates, (contact_arc, 0.0), [0.0, 0.0, 0.0], "DOP853", near[::-1], rtol=1e-9, atol=1e-12
    ).y[:, ::-1]
    at_contact, far = (
        np.array([law.turn(s), *law.point(s)])
        for s in (np.array([contact_arc]), arc[arc > contact_arc])
    )
    turned = ((far[1] - at_contact[1]) + 1j * (far[2] - at_contact[2])) * np.exp(
        -1j * at_contact[0]
    )
    beyond = np.array([far[0] - at_contact[0], turned.real, turned.imag])
    angle, x, y = np.concatenate([inner, beyond], axis=1)
    based = (x - x[0] + 1j * (y - y[0])) * np.exp(-1j * angle[0])
    return np.array([angle - angle[0], based.real, based.imag])
