"""One pass along the whisker from the contact to the base: the integrator under the planar beam.

At a contact the moment is zero and the direction of the force is known in the contact's own
frame, so the beam is followed from there to the base as an initial value problem. With y along
the force, X, Y the contact as seen from the running point, and χ the tangent angle from the
normal of the force (χ = −ψ at the contact, ψ the friction angle), dχ/du = −(κ₀ + F X/EI),
dX/du = cos χ, dY/du = sin χ, u = s_c − s.

On a piece of linear radius a(s) the path is followed in τ with ds ∝ a dτ: the steps grow in
proportion to the distance from the apex, and a cylinder's are uniform. Tangents are carried as
(cos χ, sin χ): the right side is then a polynomial, and an explicit Runge–Kutta method of order 8
needs no trigonometry.

The same pass carries the derivatives of (χ, X, Y) with respect to s_c and F, and at every step the
determinant D of the map (s_c, F) → contact point. The contact is stable if D keeps its sign from
the contact to the base (Jacobi's condition for a minimum of the energy): one pass decides it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.integrate import DOP853

from .._util.values import Array, Codes, Index
from .shape import Law, Profile

__all__ = [
    "CAUTION", "ENDS", "POINTS", "STAGES", "Beams", "Path", "Piece", "beams_of", "follow",
    "follow_each", "needed", "pilot", "resolve", "zero_load",
]  # fmt: skip

STAGES = DOP853.n_stages
#: Where in a step they lie.
PLACES = np.asarray(DOP853.C[:STAGES], dtype=float)
#: The weights of the slopes before it that make each stage's point.
POINTS = [np.asarray(DOP853.A[i, :i], dtype=float) for i in range(STAGES)]
#: The weights of the step, and of its estimate of error of order h⁶.
ENDS: Array = np.stack([DOP853.B, DOP853.E5[:STAGES]]).astype(float)
#: Factor from the h⁶ estimate to the power of 3/2 to a bound on the method's error, of order h⁹.
#: The bound holds in 99 of 100 whiskers and exceeds the error by a factor of 7 in the median.
CAUTION = 4.0

#: Rows of the state. The first `FED`, on which the right side depends: derivatives of χ and of X
#: with respect to contact arc and force, −sin χ, cos χ, X. The rest: −Y and its derivatives.
FED, ROWS_OF_STATE = 7, 10


@dataclass(frozen=True, eq=False)
class Beams:
    """n whiskers, flat, in units of their length, base radius and base stiffness.

    ``arc, radius, core`` are (k, n); the curvature law holds (n,) arrays, sign included.
    """

    arc: Array
    radius: Array
    core: Array | None
    law: Law | None

    def take(self, index: Index | slice) -> Beams:
        """The beams at `index`."""
        law = self.law
        if law is not None:
            law = type(law)(*(value[index] for value in vars(law).values()))
        core = None if self.core is None else self.core[:, index]
        return Beams(self.arc[:, index], self.radius[:, index], core, law)

    def mirrored(self, sign: Array) -> Beams:
        """The beams with their curvature mirrored where `sign` is −1."""
        law = None if self.law is None else self.law.scaled(np.ones_like(sign), sign)
        return Beams(self.arc, self.radius, self.core, law)


def beams_of(profile: Profile, shape: tuple[int, ...]) -> Beams:
    """The beams of a profile broadcast to the scenes' `shape`, one a scene."""

    def flat(table: ArrayLike, scale: ArrayLike, lead: tuple[int, ...]) -> Array:
        ratio = np.asarray(table, dtype=float) / scale
        return np.ascontiguousarray(np.broadcast_to(ratio, (*lead, *shape))).reshape(*lead, -1)

    whisker, knots = profile.whisker, (len(profile.arc),)
    law: Law | None = None
    ratio = profile.law.scaled(np.asarray(whisker.length))
    if any(np.any(value != 0) for value in vars(ratio).values()):
        law = type(ratio)(*(flat(value, 1.0, ()) for value in vars(ratio).values()))

    def table(values: Array, scale: ArrayLike) -> Array:
        # Knots lead; what follows broadcasts with the scenes from the right.
        extra = len(shape) + 1 - values.ndim
        return flat(values.reshape(len(values), *(1,) * extra, *values.shape[1:]), scale, knots)

    return Beams(
        table(profile.arc, whisker.length),
        table(profile.radius, whisker.base_radius),
        table(profile.core, whisker.base_radius) if np.any(profile.core > 0) else None,
        law,
    )


def zero_load(beams: Beams, r: Array) -> tuple[Array, Array]:
    """Arc length and angle at which the whisker at rest first meets the radius r; NaN if never.

    Newton's method from the base outwards: r(s) rises towards the first meeting, and a whisker
    that has turned back before it (dr/ds ≤ 0) or ended never gets there.
    """
    if beams.law is None:
        return np.where(r <= 1 + 1e-12, r, np.nan), np.where(r <= 1 + 1e-12, 0.0, np.nan)
    s, theta = np.minimum(r, 1.0), np.full_like(r, np.nan)
    active = np.arange(r.size)
    for _ in range(60):
        law, arc = beams.take(active).law, s[active]
        assert law is not None
        x, y = law.point(arc)
        turn = law.turn(arc)
        distance = np.hypot(x, y)
        miss = r[active] - distance
        slope = (x * np.cos(turn) + y * np.sin(turn)) / distance
        theta[active] = np.arctan2(y, x)
        at_tip = (arc >= 1) & (miss > 0)
        # The tips that `bend` finds, to its tolerance, are touched.
        lost = (slope <= 1e-3) | (at_tip & (miss > 1e-9))
        step = np.where(lost, 0.0, miss / np.where(lost, 1.0, slope))
        done = (np.abs(miss) <= 4e-15 * r[active]) | at_tip
        s[active] = np.where(lost, np.nan, np.minimum(arc + step, 1.0))
        theta[active[lost]] = np.nan
        active = active[~(done | lost)]
        if not active.size:
            break
    return s, theta


@dataclass(frozen=True, eq=False)
class Path:
    """The base of n whiskers as reached from the contact, in the frame of the force.

    ``angle`` is β = α + ψ, the direction of the force's normal; ``lever, along`` the contact point
    X, Y; ``errors`` (2, n) bounds on the error of θ_d, rad, and on the relative error of r;
    ``scale`` the angle that an error of θ_d is compared with; ``d_arc, d_force`` (3, n) the
    derivatives of (β, X, Y); ``flips`` how often D changed sign; ``steps`` the steps per piece.
    """

    angle: Array
    lever: Array
    along: Array
    errors: Array
    scale: Array
    d_arc: Array
    d_force: Array
    flips: Codes
    steps: NDArray[np.int64]

    def room(self, n: int) -> Path:
        """An uninitialised path of n beams."""
        return Path(**{k: np.empty((*v.shape[:-1], n), v.dtype) for k, v in vars(self).items()})

    def put(self, index: Index, path: Path) -> Path:
        """Set the beams at `index`; returns this path."""
        for name, value in vars(path).items():
            getattr(self, name)[..., index] = value
        return self

    @property
    def error(self) -> Array:
        """Bound on the error of θ_d over `scale` plus the relative error of r."""
        turned, reached = self.errors
        return np.asarray(turned / self.scale + reached)

    @property
    def distance(self) -> Array:
        """r."""
        return np.hypot(self.lever, self.along)

    @property
    def deflection(self) -> Array:
        """θ_d."""
        return self.angle + np.arctan2(self.along, self.lever)

    def moved(self, arc: Array, force: Array) -> Path:
        """The base to first order in a change of contact arc and force."""
        turn, lever, along = self.d_arc * arc + self.d_force * force
        return replace(
            self, angle=self.angle + turn, lever=self.lever + lever, along=self.along + along
        )

    def jacobian(self) -> tuple[Array, Array, Array, Array]:
        """r_s, r_F, θ_s, θ_F: derivatives of (r, θ_d) with respect to contact arc and force."""
        x, y, r = self.lever, self.along, self.distance
        turn, d_x, d_y = np.stack([self.d_arc, self.d_force], axis=1)
        r_s, r_f = (x * d_x + y * d_y) / r
        t_s, t_f = turn + (x * d_y - y * d_x) / r**2
        return r_s, r_f, t_s, t_f


def follow(beams: Beams, arc: Array, force: Array, friction: Array, steps: int) -> Path:
    """Follow whiskers from contacts (n,) to the base, in `steps` Runge–Kutta steps on each piece.

    Contact arcs are in units of L, forces (≥ 0) of EI₀/L², friction angles in rad.
    """
    n = arc.size
    state = np.zeros((ROWS_OF_STATE, n))
    state[4], state[5] = np.sin(friction), np.cos(friction)
    if beams.law is not None:
        state[0] = -beams.law(arc)
    state[2], state[8] = state[5], -state[4]
    # Two arrays: a product over contiguous rows takes half the time.
    slopes, rates = np.zeros((STAGES, FED, n)), np.zeros((STAGES, ROWS_OF_STATE - FED, n))
    fed, summed = slopes.reshape(STAGES, -1), rates.reshape(STAGES, -1)
    point = np.empty((FED, n))
    wound = np.zeros(n)
    error = np.zeros((2, n))
    flips = np.zeros(n, dtype=np.int8)
    above = np.ones(n, dtype=bool)
    for piece in range(len(beams.arc) - 2, -1, -1):
        low, high = beams.arc[piece], np.minimum(beams.arc[piece + 1], arc)
        span = high - low
        if not np.any(span > 0):
            continue
        path = Piece(beams, piece, low, np.maximum(high, low), steps)
        for step in range(steps):
            weight, give, curl = path.at(step)
            load = -force * give
            left = state[4] > 0
            for i, share in enumerate(POINTS):
                np.dot(share, fed[:i], out=point.reshape(-1))
                point += state[:FED]
                _slope(point, weight[i], give[i], load[i], curl[i], slopes[i], rates[i])
            state[:FED] += np.dot(ENDS[0], fed).reshape(FED, n)
            state[FED:] += np.dot(ENDS[0], summed).reshape(-1, n)
            off_sine, off_cosine, off_x = np.dot(ENDS[1], fed[:, 4 * n :]).reshape(3, n)
            off_y = np.dot(ENDS[1], summed[:, :n])
            turn = off_sine * state[5] - off_cosine * state[4]
            size = turn**2 + (off_y / arc) ** 2
            error[0] += np.sqrt(size * np.sqrt(size))
            size += (off_x / arc) ** 2
            error[1] += np.sqrt(size * np.sqrt(size))
            turned = (state[5] < 0) & ((state[4] > 0) != left)
            if np.any(turned):
                wound += np.where(turned, np.where(state[4] > 0, 1.0, -1.0), 0.0)
            now_above = np.where(span > 0, _determinant(state) > 0, above)
            flips += now_above != above
            above = now_above
    angle = np.arctan2(state[4], state[5]) - 2 * np.pi * wound
    lever, along = state[6], -state[7]
    d_arc, d_force = state[[0, 2, 8]], state[[1, 3, 9]]
    d_arc[0] *= -1
    d_force[0] *= -1
    # θ_d may pass through zero where the whisker is curved or the force tilted: its error is
    # compared with no less than a thousandth of the angles that add up to it.
    deflection = np.abs(angle + np.arctan2(along, lever))
    angles = np.abs(angle) + np.abs(friction)
    if beams.law is not None:
        angles += np.abs(beams.law(arc)) * arc
    scale = np.minimum(np.maximum(deflection, 1e-3 * angles) + 1e-300, 1.0)
    # Errors are relative to what bends the whisker; those of θ_d and of r are much the same.
    error *= CAUTION / np.sqrt(np.stack([scale, np.maximum(scale, 1e-2)]))
    errors = np.nan_to_num(error, nan=np.inf)
    return Path(angle, lever, along, errors, scale, d_arc, d_force, flips, np.full(n, steps))


class Piece:
    """The coefficients of the right side along one piece of linear radius, in τ ∈ [0, 1]."""

    def __init__(self, beams: Beams, piece: int, low: Array, high: Array, steps: int) -> None:
        left = beams.arc[piece]
        gap = beams.arc[piece + 1] - left
        share = np.divide(high - left, gap, out=np.zeros_like(gap), where=gap > 0)
        a_low = beams.radius[piece]
        self.a_high = a_low + share * (beams.radius[piece + 1] - a_low)
        # τ is even in ln a. For a cylinder its rate is kept off zero: that a goes as its own
        # exponential of τ is then off by less than 1e-14.
        exact_rate = np.log(a_low / self.a_high) / steps
        rate = np.where(np.abs(exact_rate) * steps < 1e-7, 1e-7 / steps, exact_rate)
        self.rate, self.exact_rate = rate, exact_rate
        self.high, self.span = high, high - low
        whole = np.expm1(rate * steps)
        self.gone, self.whole = np.expm1(PLACES[:, None] * rate), whole
        self.weight = (1 + self.gone) * (self.span * rate / whole)
        self.fourth = np.square(
            np.square(self.a_high + self.gone * (self.a_high * exact_rate / rate))
        )
        self.give = self.weight / self.fourth
        self.core: tuple[Array, Array] | None = None
        if beams.core is not None:
            c_low = beams.core[piece]
            c_high = c_low + share * (beams.core[piece + 1] - c_low)
            self.core = (c_high, c_low - c_high)
        self.law = beams.law

    def at(self, step: int) -> tuple[Array, Array, Array | list[None]]:
        """ds/dτ, ds/dτ/EI and κ₀ ds/dτ at the stages of a step, each (stages, n)."""
        growth, wider = np.exp(step * self.rate), np.exp(4 * step * self.exact_rate)
        weight = self.weight * growth
        give = self.give * (growth / wider)
        if self.law is None and self.core is None:
            return weight, give, [None] * STAGES
        share = self.gone * (growth / self.whole) + np.expm1(step * self.rate) / self.whole
        if self.core is not None:
            core = np.square(np.square(self.core[0] + self.core[1] * share))
            give = weight / (self.fourth * wider - core)
        if self.law is None:
            return weight, give, [None] * STAGES
        return weight, give, weight * self.law(self.high - self.span * share)


def _slope(
    state: Array,
    weight: Array,
    give: Array,
    load: Array,
    curl: Array | None,
    out: Array,
    rates: Array,
) -> None:
    """The right side of the equations, into `out` and `rates`; `load` is −F·give."""
    turn = load * state[6]  # χ'
    if curl is not None:
        turn -= curl
    np.multiply(turn, state[5:3:-1], out=out[4:6])  # (−sin χ)' = −cos χ·χ',  (cos χ)' = −sin χ·χ'
    np.negative(out[4], out=out[4])
    np.multiply(weight, state[5], out=out[6])  # X'
    np.multiply(weight, state[4], out=rates[0])  # −Y'
    np.multiply(load, state[2:4], out=out[:2])
    out[1] -= give * state[6]
    np.multiply(rates[0], state[:2], out=out[2:4])  # (X, Y)' = (cos χ, sin χ), so
    np.multiply(out[6], state[:2], out=rates[1:])  # (δX, δY)' = (−Y', X') δχ


def _determinant(state: Array) -> Array:
    """D: the area that contact arc and force span at the contact, seen from the running point."""
    x, y = state[6], -state[7]
    arc_x, force_x = state[2:4] + state[:2] * y
    arc_y, force_y = state[8:] - state[:2] * x
    return np.asarray(arc_x * force_y - arc_y * force_x)


def follow_each(
    beams: Beams, arc: Array, force: Array, friction: Array, steps: NDArray[np.int64]
) -> Path:
    """`follow` with a number of steps for each beam; no warning is raised."""
    counts, block = np.unique(steps), 2000  # beams whose slopes fit the cache
    path: Path | None = None
    with np.errstate(all="ignore"):
        if counts.size <= 1 and arc.size <= block:
            return follow(beams, arc, force, friction, int(np.max(counts, initial=1)))
        for count in counts:
            every = np.flatnonzero(steps == count)
            for start in range(0, every.size, block):
                at = every[start : start + block]
                now = follow(beams.take(at), arc[at], force[at], friction[at], int(count))
                path = (path or now.room(arc.size)).put(at, now)
    assert path is not None
    return path


def resolve(
    beams: Beams,
    arc: Array,
    force: Array,
    friction: Array,
    tolerance: ArrayLike,
    steps: NDArray[np.int64] | None = None,
) -> Path:
    """`follow` with as many steps as each beam needs for an error below `tolerance`.

    The error estimate of a pilot of few steps, or of `steps`, says how many are needed. Beams
    that 256 steps a piece do not resolve keep their error; no warning is raised.
    """
    bound = np.broadcast_to(np.asarray(tolerance, dtype=float), arc.size)
    counts = np.full(arc.size, pilot(beams)) if steps is None else steps
    path = follow_each(beams, arc, force, friction, counts)
    while True:
        left = np.flatnonzero(path.error > bound)
        counts = needed(path.steps[left], path.error[left], bound[left])
        more = counts > path.steps[left]
        left, counts = left[more], counts[more]
        if not left.size:
            return path
        path.put(
            left, follow_each(beams.take(left), arc[left], force[left], friction[left], counts)
        )


def needed(steps: NDArray[np.int64], error: Array, bound: Array) -> NDArray[np.int64]:
    """Steps for an error below `bound`, by the order of the method, from a pass with `steps`."""
    ratio = np.clip(error / bound, 1e-12, 1e12)
    # Every distinct count costs a pass: powers of √2 for many beams, of 4 for few.
    spacing = 0.5 if steps.size > 400 else 2.0
    exponent = np.ceil(np.log2(steps * 1.05 * ratio ** (1 / 8)) / spacing) * spacing
    return np.clip(np.ceil(np.exp2(exponent)), 1, 256).astype(np.int64)


def pilot(beams: Beams) -> int:
    """Steps a piece for a first look."""
    return max(1, round(4 / (len(beams.arc) - 1) ** 0.75))
