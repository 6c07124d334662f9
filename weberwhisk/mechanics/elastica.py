"""The elastica of every straight taper and cylinder, from one dimensionless map.

The shape of a linear taper touched without friction, scaled by the arc length s of the contact,
depends on two numbers (``docs/theory/models.md``): u = s/A (A the apex distance), and the load as
the contact angle of the small-angle theory, ℓ = F s²(3−2u) / (6EI₀(1−u)²). The map has two faces,
each a Chebyshev table of logarithms of ratios to the closed form:

- *force given*: (u, (ℓ/ℓ_cap)²) → contact angle, height, shortening;
- *contact given*: (v = r/A, c = √(1 − (θ_d/θ_fold)²)) → force, contact angle, arc length. The
  square root unfolds the fold at which an object at r flicks past: no root has to be found.

``analyses/build_elastica_map.py`` computes both, ``elastica_map.npz`` stores them. Their relative
error is 1e-12, tested against an independent integrator. `Surface` evaluates the map for one
whisker, for observers.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property, lru_cache
from importlib import resources

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import ArrayLike

from .._util.checks import refuse_hinge
from .._util.values import Array, Codes, Flags, member
from ..whisker import Whisker
from .contact import (
    TIP_ROUNDING,
    Bending,
    FlickPast,
    Model,
    Outcome,
    beyond_tip,
    by_rows,
    flat_with,
    in_pieces,
)  # fmt: skip

__all__ = [
    "ChebyshevTable", "Curve", "Surface", "basis", "bend", "fit", "flick_past", "load_cap",
    "nodes", "place_of", "press", "product", "signal_jacobian", "summed", "surface_of", "the_map",
    "unfold",
]  # fmt: skip

#: Columns that BLAS multiplies at once, or a multiple: 8 on x86-64, 4 or 8 on ARM.
TILE = 16

# -- Chebyshev tables on the unit square, and the map ----------------------------------------------


def nodes(n: int) -> Array:
    """The `n` Chebyshev points of the first kind on [0, 1], ascending, without the ends."""
    return (1 - np.cos(np.pi * (np.arange(n) + 0.5) / n)) / 2


def basis(n: int, x: Array) -> Array:
    """The first `n` Chebyshev polynomials of 2x − 1, shape (n, len(x)).

    Built by doubling, T_{k+j} = 2 T_k T_j − T_{k−j}, in few NumPy calls.
    """
    out = np.empty((n, x.size))
    out[0] = 1.0
    if n > 1:
        np.subtract(2 * x, 1, out=out[1])
    k = 1
    while k < n - 1:
        m = min(k, n - 1 - k)
        np.multiply(out[k], out[1 : m + 1], out=out[k + 1 : k + m + 1])
        out[k + 1 : k + m + 1] *= 2
        out[k + 1 : k + m + 1] -= out[k - m : k][::-1]
        k += m
    return out


def product(matrix: Array, columns: Array, block: int = 256) -> Array:
    """The matrix product, in blocks of columns so small that BLAS uses one thread.

    On a matrix of some ten rows BLAS threads cost up to sixty times what they save where another
    process has a core. A column's product is the same to the bit whatever columns stand beside it:
    BLAS adds in another order in columns that do not fill its tiles, so that the last block is
    filled up with zeros.
    """
    size = columns.shape[1]
    whole = size - size % block
    out = np.empty((len(matrix), size))
    blocks = columns[:, :whole].reshape(len(columns), -1, block).swapaxes(0, 1)
    filled = out[:, :whole].reshape(len(out), -1, block).swapaxes(0, 1)
    np.matmul(matrix, blocks, out=filled)
    rest = size - whole
    if rest % TILE:
        last = np.zeros((len(columns), rest + TILE - rest % TILE))
        last[:, :rest] = columns[:, whole:]
        out[:, whole:] = np.matmul(matrix, last)[:, :rest]
    else:
        np.matmul(matrix, columns[:, whole:], out=out[:, whole:])
    return out


def summed(terms: Array, weights: Array, indices: str) -> Array:
    """`np.einsum` of many terms (..., n) and weights (..., n), the same to the bit for any n.

    A single column is added up in another order, unless it has company.
    """
    if weights.shape[-1] != 1:
        return np.einsum(indices, terms, weights)
    return np.einsum(indices, terms.repeat(2, -1), weights.repeat(2, -1))[..., :1]


def fit(values: Array) -> Array:
    """Coefficients of the interpolant through `values` at `nodes`, along the first axis."""
    n = len(values)
    weights = basis(n, nodes(n)) * (2 / n)
    weights[0] /= 2
    return np.asarray(np.tensordot(weights, values, axes=1), dtype=float)


@dataclass(frozen=True, eq=False)
class Curve:
    """Several functions of one variable: `coefficients` (n, k)."""

    coefficients: Array

    def __call__(self, x: Array) -> Array:
        """Values (k, len(x))."""
        # In pieces whose polynomials stay in the cache: four times as fast on a million points.
        functions, n, size = np.ascontiguousarray(self.coefficients.T), len(self.coefficients), 8192
        out = np.empty((len(functions), x.size))
        for i in range(0, x.size, size):
            out[:, i : i + size] = product(functions, basis(n, x[i : i + size]))
        return out

    @cached_property
    def derivative(self) -> Curve:
        """The curve of the derivatives with respect to x."""
        return Curve(np.asarray(2 * chebyshev.chebder(self.coefficients), dtype=float))


@dataclass(frozen=True, eq=False)
class ChebyshevTable:
    """Several functions of two variables: `coefficients` (nx, ny, k)."""

    coefficients: Array

    @cached_property
    def _by_function(self) -> Array:
        nx, ny, k = self.coefficients.shape
        return np.ascontiguousarray(self.coefficients.transpose(2, 0, 1).reshape(k * nx, ny))

    def __call__(self, x: Array, y: Array) -> Array:
        """Values (k, len(x)) at the points (x, y)."""
        nx, ny, k = self.coefficients.shape
        along_y = product(self._by_function, basis(ny, y)).reshape(k, nx, -1)
        return summed(along_y, basis(nx, x), "kin,in->kn")

    @cached_property
    def gradient(self) -> ChebyshevTable:
        """The table of all values, then all d/dx, then all d/dy."""
        tables = [self.coefficients]
        for axis in (0, 1):
            derived = 2 * chebyshev.chebder(self.coefficients, axis=axis)
            padding = [(0, 0)] * 3
            padding[axis] = (0, 1)
            tables.append(np.pad(derived, padding))
        return ChebyshevTable(np.concatenate(tables, axis=2))


def load_cap(u: Array) -> Array:
    """Largest load ℓ on the map: past the fold and past a contact angle of 90° for every u."""
    return 5.3 - 2.6 * u


def unfold(v: Array) -> Array:
    """The coordinate x of v = x(1+x)/2, in which everything about the fold at r = vA is smooth."""
    return (np.sqrt(1 + 8 * v) - 1) / 2


def place_of(x: Array) -> Array:
    """The v of a coordinate x: the inverse of `unfold`."""
    return x * (1 + x) / 2


@dataclass(frozen=True, eq=False)
class Map:
    """The two faces of the map, and its fold."""

    force_given: ChebyshevTable  # (u, (ℓ/ℓ_cap)²) → ln α/ℓ, ln height ratio, ln shortening ratio
    contact_given: ChebyshevTable  # (x(v), c) → ln F/F_lin, ln α/α_lin, ln of the extra arc length
    fold_load: Curve  # u → ℓ/ℓ_cap at the fold
    fold: Curve  # x(v) → θ_fold/(1−v), and c at the moment peak


@cache
def the_map() -> Map:
    """The map that is shipped, read when it is first used."""
    with resources.files(__package__).joinpath("elastica_map.npz").open("rb") as file:
        stored = np.load(file)
        return Map(
            ChebyshevTable(stored["force_given"]),
            ChebyshevTable(stored["contact_given"]),
            Curve(stored["fold_load"]),
            Curve(stored["fold"]),
        )


# -- bending -------------------------------------------------------------------------------------


def bend(whisker: Whisker, arc_length: ArrayLike, force: ArrayLike) -> Bending:
    """Bend a straight whisker by a force (N) at an arc length (m), as `weberwhisk.bend` does.

    `PAST_FOLD`: in balance at this force, but an object fixed in space would have been flicked
    past. `FLICKED_PAST`: a load beyond the map. Relative error about 1e-12, for every taper from
    the cylinder to the perfect cone.
    """
    return by_rows(_bend, Model.ELASTICA, whisker, arc_length, force)


def _bend(
    length: Array, taper: Array, stiffness: Array, arc: Array, force: Array
) -> tuple[Array, Codes, Array]:
    table = the_map()
    u = arc / length * taper
    beyond = beyond_tip(arc, length, u)
    u = np.where(beyond, 0.0, u)
    load = np.abs(force) * arc**2 * (3 - 2 * u) / (6 * stiffness * (1 - u) ** 2)
    ratio = load / load_cap(u)
    outcome = np.where(ratio > table.fold_load(u)[0], Outcome.PAST_FOLD, Outcome.HELD)
    outcome = np.where(ratio > 1, Outcome.FLICKED_PAST, outcome)
    outcome = np.where(beyond, Outcome.OUT_OF_REACH, outcome).astype(np.int8)
    lost = outcome > Outcome.PAST_FOLD
    ratio = np.where(lost, 0.0, ratio)
    load = np.where(lost, np.nan, load)

    log_angle, log_height, log_shortening = table.force_given(u, ratio**2)
    sign = np.sign(force)
    contact_angle = load * np.exp(log_angle)
    y = arc * (1 - u) * 2 * load / (3 - 2 * u) * np.exp(log_height)
    x = arc * (1 - (1 - u) * load**2 * np.exp(log_shortening))
    numbers = _numbers(x, y, contact_angle, arc, np.where(lost, np.nan, np.abs(force)), sign)
    numbers[6:, lost] = np.nan
    return numbers, outcome, np.where(lost, np.nan, 1e-12)


def press(whisker: Whisker, radial_distance: ArrayLike, deflection_angle: ArrayLike) -> Bending:
    """Press a straight whisker against a point (m, rad), as `weberwhisk.press` does.

    Relative error about 1e-12. Within a fraction ε of the fold angle the signals vary as √ε, so
    that rounding of the angle matters more there; `Bending.error` includes this.
    """
    return by_rows(_press, Model.ELASTICA, whisker, radial_distance, deflection_angle)


def _press(
    length: Array, taper: Array, stiffness: Array, r: Array, theta: Array
) -> tuple[Array, Codes, Array]:
    v = r / length * taper
    beyond = beyond_tip(r, length, v)
    force, contact_angle, arc, c, past = _contact(
        np.where(beyond, 0.0, v), stiffness, r, np.abs(theta)
    )
    outcome = np.where(past, Outcome.FLICKED_PAST, Outcome.HELD)
    outcome = np.where(arc > length * (1 + TIP_ROUNDING), Outcome.SLIPPED_OFF_TIP, outcome)
    outcome = np.where(beyond, Outcome.OUT_OF_REACH, outcome).astype(np.int8)
    lost = outcome != Outcome.HELD
    force = np.where(lost, np.nan, force)
    numbers = _numbers(
        r * np.cos(theta), r * np.sin(np.abs(theta)), contact_angle, arc, force, np.sign(theta)
    )
    numbers[3], numbers[4] = r, theta  # as given, not as recomputed
    numbers[5:7, lost] = np.nan
    with np.errstate(divide="ignore"):
        error = 1e-12 + 3e-15 / c**2
    return numbers, outcome, np.where(lost, np.nan, np.minimum(error, 1.0))


def _contact(
    v: Array, stiffness: Array | float, r: Array, theta: Array
) -> tuple[Array, Array, Array, Array, Flags]:
    """Force, contact angle, arc and c at v = r/A and θ ≥ 0 (past the fold, those of the fold)."""
    table, x = the_map(), unfold(v)
    fold_angle = (1 - v) * table.fold(x)[0]
    tangent = theta / fold_angle
    past = tangent > 1
    c = np.sqrt(np.where(past, 0.0, (1 - tangent) * (1 + tangent)))
    angle = np.where(past, fold_angle, theta)
    log_force, log_angle, log_extra = table.contact_given(x, c)
    force = 3 * stiffness * angle * (1 - v) / r**2 * np.exp(log_force)
    contact_angle = angle * (3 - 2 * v) / (2 * (1 - v)) * np.exp(log_angle)
    arc = r * (1 + angle**2 / (1 - v) * np.exp(log_extra))
    return force, contact_angle, arc, c, past


def _numbers(
    x: Array, y: Array, contact_angle: Array, arc: Array, force: Array, sign: Array
) -> Array:
    """The eight numbers of a `Bending` from contact point, contact angle and force, all ≥ 0."""
    sine, cosine = np.sin(contact_angle), np.cos(contact_angle)
    return np.stack(
        [
            sign * force * (x * cosine + y * sine),  # |contact vector × force|
            force * sine,
            sign * force * cosine,
            np.hypot(x, y),
            sign * np.arctan2(y, x),
            sign * contact_angle,
            arc,
            sign * force,
        ]
    )


def flick_past(whisker: Whisker, radial_distance: ArrayLike) -> FlickPast:
    """The largest deflection angle (rad) at a radial distance (m), and what ends the contact."""
    refuse_hinge(whisker, "flick_past")
    shape, (length, taper, _, r) = flat_with(whisker, radial_distance)
    angle, c_end, fold_angle, c_peak = in_pieces(limits, length, taper, r)
    beyond = np.isnan(angle)
    peak_angle = np.where(beyond, 0.0, fold_angle * np.sqrt(1 - np.maximum(c_peak, c_end) ** 2))
    ended = np.where(c_end > 0, Outcome.SLIPPED_OFF_TIP, Outcome.FLICKED_PAST)
    ended = np.where(beyond, Outcome.OUT_OF_REACH, ended).astype(np.int8).reshape(shape)

    ends = (
        press(whisker, radial_distance, theta.reshape(shape))
        for theta in (np.where(beyond, 0.0, angle), peak_angle)
    )
    return FlickPast(angle.reshape(shape)[()], member(Outcome, ended), *ends)


def limits(length: Array, taper: Array, r: Array) -> tuple[Array, Array, Array, Array]:
    """Largest angle, its c, fold angle, and c at the moment peak, at each r (n,)."""
    table = the_map()
    v = r / length * taper
    beyond = beyond_tip(r, length, v)
    v = np.where(beyond, 0.0, v)
    x = unfold(v)
    scaled_angle, c_peak = table.fold(x)
    fold_angle = (1 - v) * scaled_angle

    # The extra arc length θ²/(1−v)·exp(g) grows up to the fold. Where it reaches the tip first, c
    # solves ln(1−c²) + g(x, c) = ln(room up to the tip).
    c_end = np.zeros_like(v)
    room = (length - r) / r * (1 - v) / fold_angle**2
    tip = ~beyond & (np.exp(table.contact_given(x, c_end)[2]) > room)
    if np.any(tip):
        x_tip, room = x[tip], np.maximum(room[tip], 0.0)
        c = np.ones_like(room)
        for _ in range(12):  # Newton's method on a concave falling function, from above
            values = table.contact_given.gradient(x_tip, c)
            growth = np.exp(values[2])
            excess = (1 - c) * (1 + c) * growth - room
            slope = growth * ((1 - c) * (1 + c) * values[8] - 2 * c)
            c = np.clip(c - excess / slope, 0.0, 1.0)
        c_end[tip] = c
    angle = fold_angle * np.sqrt((1 - c_end) * (1 + c_end))
    return np.where(beyond, np.nan, angle), c_end, fold_angle, c_peak


def signal_jacobian(
    whisker: Whisker, radial_distance: ArrayLike, deflection_angle: ArrayLike
) -> Array:
    """Derivatives (..., 3, 2) of the base signals, as `mechanics.signal_jacobian` returns."""
    refuse_hinge(whisker, "signal_jacobian")
    shape, flat = flat_with(whisker, radial_distance, deflection_angle)
    slopes = in_pieces(_signal_jacobian, *flat)
    return np.moveaxis(slopes, -1, 0).reshape(*shape, 3, 2)


def _signal_jacobian(
    length: Array, taper: Array, stiffness: Array, r: Array, theta: Array
) -> Array:
    """The derivatives (3, 2, n)."""
    outcome = _press(length, taper, stiffness, r, theta)[1]
    lost = outcome != Outcome.HELD
    v = np.where(lost, 0.0, r / length * taper)
    theta = np.where(lost, 0.0, theta)
    sign, theta = np.where(theta < 0, -1.0, 1.0), np.abs(theta)
    v_r = taper / length

    table = the_map()
    x = unfold(v)
    x_r = 2 / (1 + 2 * x) * v_r
    folds = table.fold(x)[0]
    fold_angle = (1 - v) * folds
    fold_angle_r = -v_r * folds + (1 - v) * table.fold.derivative(x)[0] * x_r
    tangent = theta / fold_angle
    c = np.sqrt((1 - tangent) * (1 + tangent))
    with np.errstate(divide="ignore", invalid="ignore"):
        c_theta = -tangent / (fold_angle * c)
        c_r = -tangent * fold_angle_r * c_theta

        values = table.contact_given.gradient(x, c)
        (log_force, log_angle, _), d_x, d_c = values[:3], values[3:6], values[6:]
        d_r = d_x * x_r + d_c * c_r
        d_theta = d_c * c_theta
        # Per unit force, so that θ = 0 needs no special case: F = θ·g, α = θ·h.
        g = 3 * stiffness * (1 - v) / r**2 * np.exp(log_force)
        h = (3 - 2 * v) / (2 * (1 - v)) * np.exp(log_angle)
        force, alpha = theta * g, theta * h
        force_r = force * (d_r[0] - v_r / (1 - v) - 2 / r)
        alpha_r = alpha * (d_r[1] + v_r * (1 / (1 - v) - 2 / (3 - 2 * v)))
        force_theta = g * (1 + theta * d_theta[0])
        alpha_theta = h * (1 + theta * d_theta[1])
        sine, cosine = np.sin(alpha), np.cos(alpha)
        lever_cosine, lever_sine = np.cos(alpha - theta), np.sin(alpha - theta)
        moment_r = (force_r * r + force) * lever_cosine - force * r * lever_sine * alpha_r
        moment_theta = force_theta * lever_cosine - force * lever_sine * (alpha_theta - 1)
        axial_theta = force_theta * sine + force * cosine * alpha_theta
        jacobian = [
            [sign * moment_r, r * moment_theta],
            [force_r * sine + force * cosine * alpha_r, sign * axial_theta],
            [
                sign * (force_r * cosine - force * sine * alpha_r),
                force_theta * cosine - force * sine * alpha_theta,
            ],
        ]
    return np.where(lost, np.nan, jacobian)


class Surface:
    """Moment, axial and transverse force of one straight whisker (scalar fields) at any contact.

    The signals are those of `press`, up to `limit`, the largest angle at each distance.

    Examples
    --------
    >>> surface = Surface(Whisker(50e-3, 100e-6, 5e-6, youngs_modulus=3e9))
    >>> signals, outcome = surface(np.array([30e-3]), np.array([0.4]))
    >>> print(f"{signals[0, 0]:.4e} N m, {signals[0, 1]:.4e} N, {Outcome(outcome[0]).name}")
    3.3039e-06 N m, 1.0163e-04 N, HELD
    """

    def __init__(self, whisker: Whisker) -> None:
        refuse_hinge(whisker, "This cue or table")
        self.length, self.taper = float(whisker.length), float(whisker.taper)
        self.stiffness = float(whisker.stiffness)

        def at(r: Array) -> tuple[Array, Array]:
            return limits(np.full_like(r, self.length), np.full_like(r, self.taper), r)[:2]

        # Distance from which on the tip, not the fold, ends contacts: by bisection.
        low, high = np.array([1e-3 * self.length]), np.array([self.length])
        for _ in range(54):
            middle = (low + high) / 2
            tip = at(middle)[1] > 0
            low, high = np.where(tip, low, middle), np.where(tip, middle, high)
        self.tip_from = float(high[0])
        # There θ²/(L − r) is smooth: 24 nodes suffice to rounding, from cylinder to cone.
        r = self.tip_from + (self.length - self.tip_from) * nodes(24)
        room = self.length - r
        # On a whisker that almost ends in a point the fold ends contacts up to the tip: no room.
        self._tip = Curve(fit(np.where(room > 0, at(r)[0] ** 2 / (room + (room == 0)), 0)[:, None]))

    def limit(self, radial_distance: Array) -> Array:
        """Largest deflection angle at each distance (n,), rad; NaN out of reach."""
        r = np.asarray(radial_distance, dtype=float)
        v = r / self.length * self.taper
        inside = np.clip(v, 0.0, 1.0)
        angle = (1 - inside) * the_map().fold(unfold(inside))[0]
        angle[beyond_tip(r, self.length, v)] = np.nan
        tip = (r > self.tip_from) & ~np.isnan(angle)
        if np.any(tip):
            room = np.maximum(self.length - r[tip], 0.0)
            x = np.maximum(1 - room / max(self.length - self.tip_from, 1e-300), 0.0)
            angle[tip] = np.sqrt(room * self._tip(x)[0])
        return angle

    def __call__(self, radial_distance: Array, deflection_angle: Array) -> tuple[Array, Codes]:
        """Signals (n, 3), NaN where not held, and outcomes (n,) at distances and angles (n,)."""
        r = np.asarray(radial_distance, dtype=float)
        limit = self.limit(r)
        in_contact = (np.abs(deflection_angle) <= limit) & (r > 0)
        place, theta = (
            np.where(in_contact, r, self.length / 2),
            np.where(in_contact, deflection_angle, 0.0),
        )
        size = np.abs(theta)
        force, contact_angle, *_ = _contact(
            place / self.length * self.taper, self.stiffness, place, size
        )
        x, y = place * np.cos(size), place * np.sin(size)
        out = _numbers(x, y, contact_angle, place, force, np.sign(theta))[:3].T
        outcome = np.where(r > self.tip_from, Outcome.SLIPPED_OFF_TIP, Outcome.FLICKED_PAST)
        outcome[np.isnan(limit) | ~(r > 0)] = Outcome.OUT_OF_REACH
        outcome[in_contact] = Outcome.HELD
        out[~in_contact] = np.nan
        return out, outcome.astype(np.int8)


#: The surface of a whisker, kept for its next contacts.
surface_of = lru_cache(maxsize=64)(Surface)
