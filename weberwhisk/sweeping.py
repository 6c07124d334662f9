"""Following a contact along a sweep, from moment and push angle alone (§2g).

While a whisker is pushed on, its contact slides along the object, tangent to it. That and the
change of the moment give the changes of r and θ_d (``docs/theory/cues.md``, Sweeping): no map is
looked up, and each contact builds on the one before. It holds for curved and rubbing whiskers, but
not where the tip is what touches. A curved whisker's θ_d starts where it touches at rest.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ._util.checks import finite, kind, non_negative, positive, refuse_hinge
from ._util.refusals import Refusal
from ._util.values import Array, Codes, Fields, Flags, weighted_quantiles
from .cues import ForceMap
from .cues.protocol import Cue, readings
from .inference import Observer
from .inference.weighted import systematic
from .mechanics.contact import Outcome
from .mechanics.forward import ForwardModel
from .mechanics.objects import Walls, rate_on_wall, slid
from .mechanics.shape import Profile
from .receptors import ReceptorNoise, Seed
from .whisker import Whisker

__all__ = ["SweepFilter", "Track", "follow"]

#: Share of objects that are walls; where in question with more than this probability, and beyond
#: this share of the largest θ_d, they are `AT_LIMIT`.
TIP_SHARE, MOST_AT_LIMIT, NEAR_LIMIT = 0.2, 0.25, 0.95


@dataclass(frozen=True, eq=False, repr=False)
class Track(Fields):
    """Where a contact was along a sweep, as far as moment and push angle tell.

    Attributes
    ----------
    push_angle : array (n,)
        Rotation of the base since first contact, rad.
    radial_distance, deflection_angle : array (n,)
        m, rad; NaN where `outcome` is not `HELD`. Of a filter the posterior means.
    distance_sd, angle_sd : array (n,)
        Posterior sds; 0 of the iterative update, which knows no noise.
    interval : array (n, 2)
        95 % of the radial distance, m.
    path, path_sd : array (n, 2)
        Contact in the world, m, whose x axis is the whisker at first contact and whose y axis
        points against the push, and the sd of either coordinate: the recovered contour.
    outcome : array (n,) of int
        `FLICKED_PAST` from the angle on that no contact left in question holds, `OUT_OF_REACH`
        where the moment is not that of any contact on the whisker. `AT_LIMIT`, of a filter, where
        an object that the tip met may bend the whisker almost to its limit, as a wall does while
        the tip still touches it, and one at more than some 40° from the whisker from then on.
    note : str
        Of a filter, what its `Observer` leaves out: the shape at rest of a named whisker.
    """

    push_angle: Array
    radial_distance: Array
    deflection_angle: Array
    distance_sd: Array
    angle_sd: Array
    interval: Array
    path: Array
    path_sd: Array
    outcome: Codes
    note: str = ""


def follow(
    whisker: Whisker,
    push_angle: ArrayLike,
    moment: ArrayLike,
    *,
    start: tuple[float, float] | None = None,
    cue: Cue | None = None,
) -> Track:
    """The iterative update of §2g: contact after contact, from exact moments.

    The first contact is that of the compliance cue; after it each push makes the contact slide, by
    the trapezoid rule, to where the moment is the one read.

    Parameters
    ----------
    whisker : Whisker or Profile
    push_angle : array (n,)
        Ascending from above 0, rad.
    moment : array (n,)
        At the base, N m.
    start : (float, float), optional
        r (m) and θ_d (rad) at push angle 0, where another cue tells them: of a wall, say, that the
        tip touches first. By default the whisker is at rest then, and r unknown.
    cue : Cue, optional
        ``Friction(ForceMap("moment"), angle)`` for contacts that rub at a known angle.

    Raises
    ------
    ValueError
        For push angles that do not ascend from above 0, moments that are not as many, a start that
        is not a contact, a whisker on a hinge, and a cue of anything but the moment.

    Notes
    -----
    Solomon & Hartmann's (2010, the paper's [35]) for cylinders, here for any straight taper and any
    bending. Errors of the moment are not forgotten: they drift along with the estimate.

    Examples
    --------
    >>> from weberwhisk.mechanics.objects import peg, sweep
    >>> from weberwhisk.receptors import Weber
    >>> w = Whisker(50e-3, 100e-6, 5e-6)
    >>> push = np.radians([2.0, 4.0, 8.0, 16.0])
    >>> moments = sweep(w, peg(30e-3, 0.0), [-0.1, *push]).bending.moment[1:]
    >>> (follow(w, push, moments).radial_distance * 1e3).round(3)
    array([30., 30., 30., 30.])
    """
    cue = _of_moment(whisker, cue, known=True)
    forward = cue.forward(whisker, np.zeros(2))
    push, moments = _checked(push_angle, moment)
    r, theta, before = 0.0, 0.0, 0.0
    if start is not None:
        pair = readings("start", positive("start", start, "give r in m and θ_d in rad"), 2)
        r, theta = map(float, pair)
    found = np.full((2, push.size), np.nan)
    outcome = np.full(push.size, Outcome.OUT_OF_REACH, dtype=np.int8)
    for k, angle in enumerate(push):
        known = start is not None or k > 0
        place = partial(_next if known else _first, forward, r, theta, float(angle) - before)
        solved = _at_moment(forward, place, float(moments[k]), r if known else None)
        if solved is None:
            break
        (r, theta), before = solved, float(angle)
        found[:, k], outcome[k] = solved, Outcome.HELD
    zero = np.where(outcome == Outcome.HELD, 0.0, np.nan)
    r_found, theta_found = found
    return Track(
        push,
        r_found,
        theta_found,
        zero,
        zero,
        np.stack([r_found, r_found], axis=-1),
        _world(r_found, theta_found, push),
        np.stack([zero, zero], axis=-1),
        outcome,
    )


def _of_moment(whisker: Any, cue: Cue | None, known: bool = False) -> Cue:
    """The cue, if it is one of the moment at an unknown angle, with nothing else where `known`."""
    if not isinstance(whisker, Profile):
        kind("whisker", whisker, "a Whisker", "taper", "write ww.Whisker(50e-3, 100e-6, 5e-6), say")
    refuse_hinge(whisker, "A sweep")
    cue = ForceMap("moment") if cue is None else cue
    own = ("radial_distance", "deflection_angle")
    if (
        not isinstance(cue, Cue)
        or cue.signal_names != ("moment",)
        or cue.unknowns[:2] != own
        or (known and len(cue.unknowns) > 2)
    ):
        raise Refusal(
            f"A sweep is followed by its moment{', all else being known' * known}",
            f"{cue!r}",
            'write ww.cues.ForceMap("moment"), or '
            'ww.cues.Friction(ww.cues.ForceMap("moment"), -0.3)',
        )
    return cue


def _first(forward: ForwardModel, r: float, theta: float, push: float, place: Array) -> Array:
    """θ_d at all distances after the first push: no slip yet."""
    return forward.rest(place) + push


def _next(forward: ForwardModel, r: float, theta: float, push: float, place: Array) -> Array:
    """θ_d at the distances `place` that a push from (r, θ_d) may have led to."""
    start = np.full_like(place, r), np.full_like(place, theta)
    return slid(forward, *start, place - r, push)[1]


def _at_moment(
    forward: ForwardModel,
    place: Callable[[Array], Array],
    reading: float,
    near: float | None,
) -> tuple[float, float] | None:
    """The contact, among those at radial distances (n,), that has this moment: the nearest."""
    length = forward.reach
    low, high = (1e-3 * length, length) if near is None else (near / 1.5, min(near * 1.5, length))
    for narrowed in range(12):
        r = np.linspace(low, high, 65)
        theta = place(r)
        push = theta - forward.rest(r)
        signals, outcome = forward.signals(r, np.maximum(push, 0.0))
        held = (outcome == Outcome.HELD) & (push >= 0)
        miss = np.where(held, signals[:, 0], np.nan) - reading
        crossed = np.flatnonzero(np.sign(miss[1:]) * np.sign(miss[:-1]) <= 0)
        if not crossed.size:
            if not narrowed:
                return None
            break  # as close as rounding lets signals tell
        if near is not None:
            crossed = crossed[[np.argmin(np.abs(r[crossed] - near))]]
        low, high = r[crossed[0]], r[crossed[0] + 1]
    middle = np.array([(low + high) / 2])
    return float(middle[0]), float(place(middle)[0])


def _world(r: Array, theta: Array, push: Any) -> Array:
    """Contact (..., 2) in the world, from the base frame."""
    angle = theta - push
    return np.stack([r * np.cos(angle), r * np.sin(angle)], axis=-1)


class SweepFilter:
    """The Bayesian form of §2g: contacts in question, which slide, weighed by each moment.

    The state is r, θ_d and the rate of slip dr/dρ, which wanders: the object's shape is unknown,
    and smooth. A bootstrap particle filter (Gordon, Salmond & Smith 1993, IEE Proc. F 140, 107)
    with systematic resampling; the likelihood of each moment is that of an `Observer`. A share of
    the objects is met by the tip: walls at any distance from the base, whose contacts stay at the
    tip at first and then run inwards as `mechanics.objects` says, but for a rate that wanders too.
    A whisker that is pushed on its convex side meets near walls with its flank.

    Parameters
    ----------
    whisker : Whisker or Profile
        One of them. Positive curvature is contact on the convex side, negative on the concave.
    noise : ReceptorNoise
        Of the moment, independent from one reading to the next.
    slip_rate : float
        Sd of dr/dρ at first contact, in whisker lengths per rad. A peg has none.
    slip_change : float
        Sd by which dr/dρ wanders over one rad, in the same unit.
    prior : frozen SciPy distribution, optional
        Of the radial distance of first contact, m, where it is the flank that touches; by default
        flat up to the tip, with a share of walls.
    particles : int
    cue : Cue, optional
        Of the moment: ``Friction(ForceMap("moment"), -0.3)`` for contacts that rub (negative while
        the whisker is pressed harder), or `Friction`, `UnknownCurvature` or `UnknownStiffness` with
        an unknown, which stays the same throughout a sweep.

    Raises
    ------
    ValueError
        For what `Observer` refuses, negative rates, fewer than 100 particles, a whisker on a hinge.
        Where the tip may meet an object and then go further out than it reaches at rest, as on the
        concave side, or where it goes depends on what is not known: no table has such contacts.

    Examples
    --------
    >>> from weberwhisk.mechanics.objects import peg, sweep
    >>> from weberwhisk.receptors import Weber
    >>> w = Whisker(50e-3, 100e-6, 5e-6)
    >>> push = np.radians(np.arange(1.0, 21.0))
    >>> moments = sweep(w, peg(30e-3, 0.0), [-0.1, *push]).bending.moment[1:]
    >>> track = SweepFilter(w, Weber(0.1), slip_rate=0.0, slip_change=0.0)(push, moments, seed=1)
    >>> print("%.0f ± %.1f mm" % (1e3 * track.radial_distance[-1], 1e3 * track.distance_sd[-1]))
    30 ± 0.3 mm
    """

    def __init__(
        self,
        whisker: Whisker,
        noise: ReceptorNoise | None = None,
        *,
        slip_rate: float = 0.5,
        slip_change: float = 1.0,
        prior: Any = None,
        particles: int = 4000,
        cue: Cue | None = None,
    ) -> None:
        priors = {} if prior is None else {"radial_distance": prior}
        cue = _of_moment(whisker, cue)
        self.observer = Observer(whisker, cue, noise, priors)  # type: ignore[arg-type]
        hint = "give whisker lengths per rad, 0 for a peg"
        self.slip_rate = float(non_negative("slip_rate", slip_rate, hint))
        self.slip_change = float(non_negative("slip_change", slip_change, hint))
        self.particles = int(particles)
        if self.particles < 100:
            raise Refusal("A filter needs 100 particles or more", particles, "write 4000")
        self._tip: Any = None
        if self.slip_rate > 0 and "radial_distance" not in self.observer.prior:
            self._tip = Walls.of(self.observer.forward)

    def start(self, seed: Seed = None) -> Array:
        """States (particles, 4 and more) at first contact, from the prior.

        r, θ_d at rest, dr/dρ and, of walls, how far the tip is turned before the flank touches,
        −∞ where the flank touches first, else 0; then whatever else the cue does not know. A wall's
        dr/dρ is what it differs by from that of a straight one.
        """
        rng = np.random.default_rng(seed)
        low, high = self.observer.reach
        u = (np.arange(self.particles) + rng.random(self.particles)) / self.particles
        r = low + u * (high - low)
        if "radial_distance" in self.observer.prior:
            prior = self.observer.prior["radial_distance"]
            ends = prior.cdf([low, high])
            r = prior.ppf(ends[0] + u * (ends[1] - ends[0]))
        rate = self.slip_rate * self.observer.forward.length * rng.standard_normal(u.size)
        release = np.zeros(u.size)
        if self._tip is not None:
            # What the tip meets first, at any distance from the base.
            wall = np.flatnonzero(rng.permutation(u.size) < TIP_SHARE * u.size)
            r[wall], release[wall] = self._tip.met(np.arcsin(rng.random(wall.size)))
        names = self.observer.unknowns[2:]
        others = [self.observer.prior[name].ppf(rng.random(u.size)) for name in names]
        state = np.stack([r, 0 * r, rate, release, *others], axis=-1)
        state[:, 1] = self._forward(state).rest(r)
        return state

    def _contact(self, state: Array) -> Array:
        """What the observer calls a contact, (n, U), its angle from where it touches at rest."""
        contact = np.concatenate([state[:, :2], state[:, 4:]], axis=1)
        contact[:, 1] -= self._forward(state).rest(state[:, 0])
        return contact

    def _forward(self, state: Array) -> ForwardModel:
        """The mechanics of the states."""
        observer = self.observer
        others = np.concatenate([state[:, :2], state[:, 4:]], axis=1)
        return observer.cue.forward(observer.whisker, others)

    def move(self, state: Array, push: float, seed: Seed = None) -> Array:
        """States after a push dρ: what the filter believes of objects."""
        rng = np.random.default_rng(seed)
        r, theta, rate, release = state[:, :4].T
        running = np.full_like(r, push)
        if self._tip is not None:
            # While the tip touches there is no slip.
            turned = theta - self._tip.theta[0] + push - release
            running = np.where(release > 0, np.clip(turned, 0.0, push), push)
            theta = theta + (push - running)
            r = np.where(running < push, np.interp(theta, self._tip.theta, self._tip.r), r)
        slip = rate * running
        flat = np.flatnonzero((release != 0) & (running > 0))
        slip[flat] += self._slip_on_wall(state[flat], r[flat], theta[flat], running[flat])
        r, theta = slid(self._forward(state), r, theta, slip, running)
        wander = self.slip_change * np.sqrt(push) * self.observer.forward.length
        rate = rate + wander * rng.standard_normal(len(state))
        return np.column_stack([r, theta, rate, release, state[:, 4:]])

    def _slip_on_wall(self, state: Array, r: Array, theta: Array, push: Array) -> Array:
        """dr (n,) along walls, by the midpoint rule."""
        forward = self._forward(state)
        start = rate_on_wall(forward, r, theta)
        middle = slid(forward, r, theta, start * push / 2, push / 2)
        return rate_on_wall(forward, *middle) * push

    def __call__(self, push_angle: ArrayLike, moment: ArrayLike, seed: Seed = None) -> Track:
        """Follow the contact of one sweep.

        Parameters
        ----------
        push_angle : array (n,)
            Ascending from above 0, rad; known exactly.
        moment : array (n,)
            Readings of the moment at the base, N m.
        seed : int, SeedSequence or Generator
        """
        push, moments = _checked(push_angle, moment)
        rng = np.random.default_rng(seed)
        state = self.start(rng)
        log_weight = np.zeros(len(state))
        nowhere = np.full(2, np.nan)
        rows: list[tuple[Any, ...]] = [(*[np.nan] * 4, *[nowhere] * 3)] * push.size
        outcome = np.full(push.size, Outcome.FLICKED_PAST, dtype=np.int8)
        for k, step in enumerate(np.diff(push, prepend=0.0)):
            state = self.move(state, step, rng)
            value, fate = self._weigh(state, moments[k])
            log_weight = log_weight + value
            top = log_weight.max()
            if not np.isfinite(top):
                lost = fate[fate != Outcome.HELD]
                outcome[k:] = np.bincount(lost).argmax() if lost.size else Outcome.OUT_OF_REACH
                break
            weight = np.exp(log_weight - top)
            weight /= weight.sum()
            outcome[k] = Outcome.HELD
            if weight @ self._at_limit(state) > MOST_AT_LIMIT:
                outcome[k] = Outcome.AT_LIMIT
            else:
                rows[k] = _summary(state, weight, push[k])
            if 1 / np.square(weight).sum() < 0.5 * len(state):
                state = state[systematic(weight, len(weight), rng)]
                log_weight = np.zeros(len(state))
            else:
                log_weight = log_weight - top
        names = [field.name for field in fields(Track)][1:-2]
        columns: Any = dict(zip(names, map(np.array, zip(*rows, strict=True)), strict=True))
        return Track(push, **columns, outcome=outcome, note=self.observer.note)

    def _at_limit(self, state: Array) -> Flags:
        """States of walls at which the tip still touches, or that are about to flick past."""
        limit = self._forward(state).limit(state[:, 0])
        return (state[:, 3] != 0) & ~(self._contact(state)[:, 1] < NEAR_LIMIT * limit)

    def _weigh(self, state: Array, reading: float) -> tuple[Array, Codes]:
        """ln p(moment | state), −∞ where not held, and the outcome of every state."""
        contact, whisker = self._contact(state), self.observer.whisker
        inside = (contact[:, 0] > 0) & (contact[:, 1] > 0)
        safe = np.where(inside[:, None], contact, self.observer.reach[1])
        signals, outcome = self.observer.cue.signals(whisker, safe)
        outcome = np.where(inside, outcome, Outcome.OUT_OF_REACH).astype(np.int8)
        held = outcome == Outcome.HELD
        value = self.observer.noise.log_likelihood([reading], np.where(held[:, None], signals, 1.0))
        return np.where(held, value, -np.inf), outcome


def _summary(state: Array, weight: Array, push: float) -> tuple[Any, ...]:
    """What weighted states say of the contact, in the order of the fields of `Track`."""
    state, weight = state[weight > 0], weight[weight > 0]  # the others may be nowhere
    contact, path = state[:, :2], _world(state[:, 0], state[:, 1], push)
    mean, middle = weight @ contact, weight @ path
    sd, path_sd = (np.sqrt(weight @ np.square(v - m)) for v, m in ((contact, mean), (path, middle)))
    interval = weighted_quantiles(contact[:, 0], weight, [0.025, 0.975])
    return *mean, *sd, interval, middle, path_sd


def _checked(push_angle: ArrayLike, moment: ArrayLike) -> tuple[Array, Array]:
    push = np.atleast_1d(positive("push_angle", push_angle, "give radians since first contact"))
    moments = np.atleast_1d(finite("moment", moment, "give newton metres, up to the last contact"))
    if push.ndim != 1 or not push.size or np.any(np.diff(push) <= 0) or moments.shape != push.shape:
        raise Refusal(
            "A sweep is one row of ascending push angles and as many moments",
            f"shapes {push.shape} and {moments.shape}",
            "write np.radians(np.arange(1, 31)) for the first, say",
        )
    return push, moments
