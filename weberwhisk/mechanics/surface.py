"""The base signals of one straight whisker as a surface over (r, θ_d), for millions of contacts.

An observer presses one whisker against point after point and asks for its signals only. For that,
the elastica's map is taken to the signals themselves and to as many terms as `TOLERANCE` needs:
a third of the time of `elastica.press`, with the same outcomes.

Below, how a contact moves along a whisker that is pushed on along an object (§2g): the same for
straight and curved whiskers, with and without friction, which differ in the contact angle alone.

In the frame of the base, with φ the direction of the whisker's tangent at the contact, β = φ − θ_d
its angle to the line base → contact, and ρ the push angle: the contact moves along the tangent,

    r d(θ_d − ρ) = tan β dr,                                                            (slip)

and the object's own tangent, φ − ρ in the world, is what the object lets it be: on a wall it does
not turn, so that its contacts move at a rate that depends on the contact alone,

    dr/dρ = (1 − ∂φ/∂θ_d) / (∂φ/∂r + ∂φ/∂θ_d tan β / r).                                (wall)
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._checks import refuse_hinge
from ..whisker import Whisker
from .chebyshev import Array, ChebyshevTable, Curve, fit, nodes, place_of, the_map, unfold
from .contact import Outcome, beyond_tip
from .elastica import limits, press

#: What the terms left out may add up to, along either axis, of the closed form's signals.
TOLERANCE = 1e-9
_ALONG, _ACROSS = 40, 24  # nodes: more than the surface needs


class Surface:
    """Moment, axial and transverse force of one straight whisker (of numbers) at any contact.

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

        # Up to some distance the fold ends contacts, from there on the tip.
        low, high = np.array([1e-3 * self.length]), np.array([self.length])
        for _ in range(54):
            middle = (low + high) / 2
            tip = at(middle)[1] > 0
            low, high = np.where(tip, low, middle), np.where(tip, middle, high)
        self.tip_from = float(high[0])
        # There θ²/(L − r) is smooth; enough nodes for the error to be rounding, cylinder to cone.
        r = self.tip_from + (self.length - self.tip_from) * nodes(24)
        room = self.length - r
        # Of a whisker that all but ends in a point no distance is left between the fold's end and
        # the tip: no room, no angle.
        self._tip = Curve(fit(np.where(room > 0, at(r)[0] ** 2 / (room + (room == 0)), 0)[:, None]))

    def limit(self, radial_distance: Array) -> Array:
        """Largest deflection angle at each distance (n,), rad; NaN out of reach."""
        r = np.asarray(radial_distance, dtype=float)
        v = np.clip(r / self.length * self.taper, 0.0, 1.0)
        return self._limit(r, (1 - v) * _fold()(unfold(v))[0])

    def _limit(self, r: Array, fold: Array) -> Array:
        """The same where the angles of the folds (n,) are known."""
        angle = np.where(beyond_tip(r, self.length, r / self.length * self.taper), np.nan, fold)
        tip = (r > self.tip_from) & ~np.isnan(angle)
        if np.any(tip):
            room = np.maximum(self.length - r[tip], 0.0)
            x = np.maximum(1 - room / max(self.length - self.tip_from, 1e-300), 0.0)
            angle[tip] = np.sqrt(room * self._tip(x)[0])
        return angle

    def __call__(
        self, radial_distance: Array, deflection_angle: Array
    ) -> tuple[Array, NDArray[np.int8]]:
        """Signals (n, 3), NaN where not held, and outcomes (n,) at distances and angles (n,)."""
        r = np.asarray(radial_distance, dtype=float)
        v = np.clip(r / self.length * self.taper, 0.0, 1.0)
        x = unfold(v)
        fold = (1 - v) * _fold()(x)[0]
        theta = np.abs(deflection_angle)
        limit = self._limit(r, fold)
        with np.errstate(divide="ignore", invalid="ignore"):
            tangent = theta / fold
            c = np.sqrt(np.maximum((1 - tangent) * (1 + tangent), 0.0))
            moment, axial, transverse = _table()(x, c)
            out = np.empty((r.size, 3))
            lateral = 3 * self.stiffness * deflection_angle * (1 - v) / r
            out[:, 0] = lateral * moment
            lateral /= r
            out[:, 1] = lateral * deflection_angle * ((1.5 - v) / (1 - v)) * axial
            out[:, 2] = lateral * transverse
        held = (theta <= limit) & (r > 0)
        outcome = np.zeros(r.size, dtype=np.int8)
        if not held.all():
            out[~held] = np.nan
            outcome[~held] = np.where(
                r > self.tip_from, Outcome.SLIPPED_OFF_TIP, Outcome.FLICKED_PAST
            )[~held]
            outcome[np.isnan(limit) | ~(r > 0)] = Outcome.OUT_OF_REACH
        return out, outcome


@lru_cache(maxsize=64)
def surface_of(whisker: Whisker) -> Surface:
    """The surface of a whisker, kept for its next contacts."""
    return Surface(whisker)


@cache
def _fold() -> Curve:
    """θ_fold/(1 − v) against x(v), in as many terms as the surface needs."""
    x = nodes(_ALONG)
    v = place_of(x)
    coefficients = fit((the_map().fold_angle(v) / (1 - v))[:, None])
    return Curve(coefficients[: _needed(np.abs(coefficients[:, 0]), TOLERANCE / 100)])


@cache
def _table() -> ChebyshevTable:
    """Moment, axial and transverse force over those of the closed form, against (x(v), c).

    On a whisker of apex distance 1 and stiffness 1 without a tip in the way.
    """
    x, c = nodes(_ALONG), nodes(_ACROSS)
    r = place_of(x)[:, None]
    cone = Whisker(1.0, 1.0, 0.0, youngs_modulus=4 / np.pi)
    theta = the_map().fold_angle(r[:, 0])[:, None] * np.sqrt((1 - c) * (1 + c))
    bent = press(cone, r, theta)
    lateral = 3 * theta * (1 - r) / r**2
    values = np.stack(
        [
            bent.moment / (lateral * r),
            bent.axial_force / (lateral * theta * (1.5 - r) / (1 - r)),
            bent.transverse_force / lateral,
        ],
        axis=-1,
    )
    by_x = fit(values)
    coefficients = fit(by_x.transpose(1, 0, 2)).transpose(1, 0, 2)
    size = np.abs(coefficients).max(axis=2)
    rows, columns = (_needed(size.max(axis=axis), TOLERANCE) for axis in (1, 0))
    return ChebyshevTable(coefficients[:rows, :columns])


def _needed(size: Array, tolerance: float) -> int:
    """Terms to keep so that those left out add up to less than the tolerance."""
    left_out = np.cumsum(size[::-1])[::-1]
    return int(np.sum(left_out > tolerance))


#: Relative step of the differences in (wall); contacts of the tip in its table, and how far they
#: are, in θ_d, from slipping off.
STEP, NODES, INSIDE = 1e-5, 401, 1e-6


def contact_angle(forward: Any, r: Array, theta: Array) -> Array:
    """φ (...) from the direction of the force, which friction tilts; NaN of what is not held.

    `forward` is a `ForwardModel`. Where nothing is pressed, φ is that of the whisker at rest.
    """
    signals, _ = forward.signals(r, np.maximum(theta - forward.rest(r), 1e-9))
    beta = np.arctan2(signals[..., 1], signals[..., 2]) - forward.friction - theta
    return np.asarray(theta + np.mod(beta + np.pi / 2, 2 * np.pi) - np.pi / 2)


def slid(
    forward: Any, r: Array, theta: Array, slip: Array, push: Array | float
) -> tuple[Array, Array]:
    """r and θ_d (n,) after slips dr (n,) and pushes dρ: (slip), by the trapezoid rule."""
    start = slope(forward, r, theta)
    there = r + slip
    # A contact that is not held has no slope of its own: it is lost, whatever is written here.
    end = slope(forward, there, theta + push + start * slip)
    mean = np.where(np.isfinite(end), (start + end) / 2, start)
    return there, theta + push + np.where(slip == 0, 0.0, mean * slip)


def slope(forward: Any, r: Array, theta: Array) -> Array:
    """tan β/r (n,)."""
    inside = np.clip(r, 1e-6 * forward.length, forward.reach)
    return np.asarray(np.tan(contact_angle(forward, inside, theta) - theta) / inside)


def rate_on_wall(forward: Any, r: Array, theta: Array) -> Array:
    """dr/dρ (n,) of contacts with a wall, m per rad: (wall); 0 of contacts that are not held."""
    r = np.clip(r, 1e-3 * forward.length, forward.reach)
    # On this side of the largest angles and of the tip.
    inwards = r * (1 - STEP)
    rest, beside = forward.rest(r), forward.rest(inwards)
    push = np.maximum(theta - rest, 1e-6 + 2 * np.abs(rest - beside))
    theta, less = rest + push, rest + push * (1 - STEP)
    here, there, before = contact_angle(
        forward, np.stack([r, inwards, r]), np.stack([theta, theta, less])
    )
    by_r, by_theta = (here - there) / (r - inwards), (here - before) / (theta - less)
    with np.errstate(divide="ignore", invalid="ignore"):
        rate = (1 - by_theta) / (by_r + by_theta * np.tan(here - theta) / r)
    return np.where(np.isfinite(rate), rate, 0.0)


def tip_contacts(forward: Any) -> tuple[Array, Array, Array]:
    """r, θ_d and β (n,) along the contacts of the tip, from the whisker at rest on.

    A wall at the angle β from the line base → tip at first contact is met by the tip until the
    whisker is bent as much there; by the flank from then on.
    """
    reach = forward.reach * (1 - 1e-15)
    r = reach * (1 - np.linspace(0.0, 1.0, NODES)[:-1] ** 2)
    push = np.nan_to_num(forward.limit(r)) * (1 - INSIDE)
    tip = forward.signals(r, push * (1 + 2 * INSIDE))[1] == Outcome.SLIPPED_OFF_TIP
    tip[0] = True
    r, push = r[tip], push[tip]
    push[0] = 0.0
    theta = forward.rest(r) + push
    return r, theta, contact_angle(forward, r, theta) - theta


@dataclass(frozen=True, eq=False)
class Walls:
    """Walls that a whisker meets: with its tip, at r, θ_d and β (n,), or with its flank at rest.

    `rest` is the distance of a wall from the base and the r (m,) at which the flank touches it.
    """

    r: Array
    theta: Array
    beta: Array
    rest: tuple[Array, Array]

    @classmethod
    def of(cls, forward: Any, farther_out: float = 0.01) -> Walls:
        """Those of a `ForwardModel`, whose tip must not be pushed by `farther_out`, rad, outwards.

        Raises
        ------
        ValueError
        """
        unknown = len({*forward.friction_range}) > 1 or len({*forward.offset_range}) > 1
        reach = forward.reach * (1 - 1e-12)
        if unknown or forward.limit(np.array([reach]))[0] > farther_out:
            raise ValueError(
                "A tip that meets an object may go further out than it reaches at rest, got "
                f"{forward.whisker!r}{' with friction or curvature unknown' * unknown}; write "
                "prior=scipy.stats.uniform(...) of the distances at which the flank is touched, or "
                "slip_rate=0 for a peg."
            )
        r = np.linspace(1e-3, 1.0, 201) * reach
        rest = forward.rest(r)
        depth = r * np.sin(contact_angle(forward, r, rest) - rest)
        return cls(*tip_contacts(forward), (np.maximum.accumulate(depth), r))

    def met(self, angle: Array) -> tuple[Array, Array]:
        """r (n,) at which walls are met, and how far the tip is then turned, −∞ of the flank.

        The sine of `angle` is a wall's distance from the base over that of the tip.
        """
        flank = angle < self.beta[0]
        turned = np.interp(angle, self.beta, self.theta - self.theta[0], right=np.inf)
        place = np.interp(np.sin(angle) * self.r[0], *self.rest)
        return np.where(flank, place, self.r[0]), np.where(flank, -np.inf, turned)
