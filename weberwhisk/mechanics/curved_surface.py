"""Base signals of a curved whisker, or one with friction, as tables over contacts, for posteriors.

The equations of the planar beam or the rod are solved once at Chebyshev nodes, then interpolated.
A contact is given by its radial distance and its push, the angle by which the whisker has turned
since it first touched there.

At one distance the branch of equilibria runs from rest to the fold, at the push P, on the whisker
continued beyond its tip to the apex (`branches`). It is smooth in c = √(1 − push/P). Tables over
distance and c hold the signals over the small-angle lateral force of the straight taper, and the
arc length of the contact: where it exceeds the length the tip has slipped off. Azimuth, friction
and curvature are further axes.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import lru_cache, reduce
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike

from .._util.refusals import Refusal
from .._util.values import Array, Codes, Flags, Index, distinct
from ..whisker import YOUNGS_MODULUS, Whisker
from . import profile as planar
from . import rod
from .beam import beams_of, zero_load
from .branches import Branches, NotFound, extended, walk
from .contact import Outcome, signals_of
from .elastica import basis, fit, nodes, place_of, product, summed, unfold
from .shape import Profile, Spiral, with_modulus

__all__ = ["SIX", "THINNEST", "CurvedSurface", "curved_surface", "more_curved", "pressed"]

#: Axial force positive in compression, forces along y and z; torsion, moments about y and z.
SIX = ("axial_force", "force_y", "force_z", "torsion", "moment_y", "moment_z")
#: Runge–Kutta steps a piece of tabled whiskers: relative errors of 1e-9, 1e-7 at thin tips.
STEPS = 12
#: Least ratio of tip to base radius in tables: a thinner tip has almost no stiffness.
THINNEST = 1e-3


class _Places(NamedTuple):
    """Distinct places (m,), the index of each contact's, and what the tables give there."""

    which: Index
    distance: Array  # in lengths, 1 where it is not known
    in_reach: Flags
    far: Flags
    room: Array
    last: Array
    poly: Array
    by_r: Array


class CurvedSurface:
    """Signals of one whisker with curvature or friction at any contact.

    In the plane of curvature they are moment, axial and transverse force of contacts that push
    towards positive angles: on the convex side for positive curvature, on the concave side for
    negative. In space they are `SIX`: a point at the distance r moves from where the whisker at
    rest touches, along the great circle about the base in the direction of the azimuth ω. At ω = 0
    it pushes towards the side to which the whisker curves, at π away from it. On a straight whisker
    push and ω are deflection angle and azimuth. Signals even in ω are polynomials of cos ω, odd
    ones sin ω times a polynomial.

    A contact is given by its distance (m), its push (rad), its azimuth (rad, in space alone),
    friction (rad) and an offset of the curvature (1/m).

    Parameters
    ----------
    whisker : Whisker or Profile
        One whisker.
    friction : (float, float)
        Range of friction angles, rad; both ends the same for a fixed angle.
    offset : (float, float)
        Range of what is added to the curvature along the whole length, 1/m.
    in_space : bool
        Whether contacts have an azimuth.

    Attributes
    ----------
    error : float
        Largest error at 60 contacts against the planar beam or the rod, over the lateral force.

    Raises
    ------
    ValueError
        For a whisker that turns by more than 2 rad, or whose folds are not found.
    """

    def __init__(
        self,
        whisker: Whisker | Profile,
        friction: tuple[float, float] = (0.0, 0.0),
        offset: tuple[float, float] = (0.0, 0.0),
        *,
        in_space: bool = False,
    ) -> None:
        self.whisker, self.profile, self.in_space = whisker, Profile.of(whisker), in_space
        base = self.profile.whisker
        self.length, self.stiffness = float(base.length), float(base.stiffness)
        thin = self.profile.radius[-1] / self.profile.radius[0]
        self.taper = max(1 - max(float(thin), THINNEST), 0.0)
        self._ends = friction, offset
        for end in offset:
            law = more_curved(self.profile, np.asarray(end)).law
            turn = max(abs(float(law.turn(np.asarray(k * self.length / 4)))) for k in (1, 2, 3, 4))
            if turn > 2.0:  # tables are made for whiskers that do not wind
                raise Refusal(
                    "Observers take whiskers that turn by up to 2 rad from base to tip",
                    f"{turn:.3g}",
                    "give a smaller curvature",
                )
        axes = [7 if high > low else 1 for low, high in self._ends]
        sizes = [(*axes, 24, 14), (*axes, 32, 16)]
        if in_space:
            sizes = [(9, *axes, 18, 12), (14, *axes, 28, 16)]
        try:
            self._made(*sizes)
        except NotFound:
            name = "rod" if in_space else "profile"
            remedy = (
                f'curvature or friction, or model="{name}", which solves each contact by itself'
            )
            low, high = offset
            if high > low:
                remedy = f"spread to the curvature, whose 7 sd are {low:.3g} to {high:.3g} 1/m more"
            raise Refusal(
                f"No table{' in space' * in_space} serves {whisker}, whose folds were not found",
                remedy=f"give less {remedy}",
            ) from None

    @property
    def reach(self) -> float:
        """Distance of the tip at rest, m."""
        return float(np.hypot(*self.profile.law.point(np.array([self.length])))[0])

    def _given(self, shares: list[Array]) -> Sequence[Array]:
        """Azimuth (in space), friction and offset (n,) at shares (n,) of their axes."""
        along = zip(self._ends, shares[self.in_space :], strict=True)
        uncertain = tuple(low + (high - low) * share for (low, high), share in along)
        return (np.arccos(2 * shares[0] - 1), *uncertain) if self.in_space else uncertain

    def _shares(self, given: Sequence[Array]) -> list[Array]:
        """Shares, clipped to 0 and 1, of the axes of `given`: (n,), or (1,) for a single value."""
        uncertain = given[self.in_space :] or np.zeros((2, 1))
        shares = [
            np.clip((value - low) / (high - low), 0.0, 1.0) if high > low else np.zeros(1)
            for (low, high), value in zip(self._ends, uncertain, strict=True)
        ]
        return [(1 + np.cos(given[0])) / 2, *shares] if self.in_space else shares

    def _parity(self, given: Sequence[Array]) -> Any:
        """Factor of the signals that are odd in the azimuth, (n, S)."""
        sine_like = np.array([False, False, True, True, True, False])
        return np.where(sine_like, np.sin(given[0])[:, None], 1.0) if self.in_space else 1.0

    def _branches(self, along: Array, given: Sequence[Array]) -> tuple[Array, Branches]:
        """Reaches (m,) where that is given, and branches at shares `along` of each."""
        *azimuth, friction, offset = (np.repeat(a, along.size) for a in given)
        radius = self.profile.radius.copy()
        radius[-1] = max(radius[-1], THINNEST * radius[0])
        profile = more_curved(replace(self.profile, radius=radius), offset)
        beams = extended(beams_of(profile, offset.shape))
        reach = np.ones(offset.size)
        if beams.law is not None:
            reach = np.hypot(*beams.law.point(reach))
        r = reach * np.tile(along, len(given[0]))
        flat = Branches.of(beams, r, friction, np.inf)
        # Near the apex, where 12 steps a piece were 3 % off at the fold, 36 are 4e-5 off.
        flat = replace(flat, steps=np.where(flat.scale[-1] < 0.02, 3 * STEPS, STEPS))
        if self.in_space:
            flat = SpaceBranches.around(flat, azimuth[0], self.profile.whisker)
        return reach[:: along.size], flat

    def _exact(self, r: Array, push: Array, given: Sequence[Array]) -> Array:
        """Signals (n, S), contact by contact."""
        *azimuth, friction, offset = given
        if self.in_space:
            return pressed(self.whisker, r, push, azimuth[0], friction, offset)[0]
        whisker = more_curved(self.profile, offset)
        bent = planar.press(whisker, r, planar.rest_angle(whisker, r) + push, friction)
        return signals_of(bent)

    # -- building ------------------------------------------------------------------------------

    def _made(self, *sizes: tuple[int, ...]) -> None:
        """Make tables of the first of `sizes` whose error is below a thousandth of k = 0.01.

        A size is the numbers of nodes on each axis of the conditions, along r and across c.
        """
        with np.errstate(all="ignore"):
            for *axes, along, across in sizes:
                self._build(axes, along, across)
                self.error = self._certified()
                if self.error < 1e-5:
                    break
        if not self.error < 1e-3:
            raise NotFound

    def _build(self, axes: list[int], along: int, across: int) -> None:
        self._axes, self._along, self._across = axes, along, across
        shares = [a.ravel() for a in np.meshgrid(*map(nodes, axes), indexing="ij")]
        given = self._given(shares)
        reach, branches = self._branches(self._at(nodes(along)), given)
        ended = walk(branches, np.full(branches.r.size, np.inf))
        if not ended.stopped.all():
            raise NotFound
        signals, arcs, pushes = branches.tabled(ended.point, across)
        # Over the small-angle lateral force of a taper, moments over its moment.
        room = 1 - self.taper * branches.r / np.repeat(reach, along)
        lateral = 3 * pushes * room / branches.r**2
        signals /= np.where(branches.moments[:, None], branches.r, 1.0) * lateral[:, None]
        wide = tuple(np.repeat(a, along) for a in given)
        even = signals.transpose(0, 2, 1) / self._parity(wide)
        values = np.concatenate([even, (arcs / branches.r)[..., None]], axis=-1)
        values = fit(values).transpose(1, 2, 0)
        self._moments = branches.moments

        def table(values: Array) -> Array:
            """Rows (along · k, m) of coefficients of values (m · along, …)."""
            out = values.reshape(*axes, -1, *values.shape[1:])
            for axis in range(len(axes) + 1):
                out = np.moveaxis(fit(np.moveaxis(out, axis, 0)), 0, axis)
            return np.ascontiguousarray(out.reshape(reach.size, -1).T)

        self._reach = table(reach)[0]
        fold = ended.point[:, -1] * branches.scale[-1] / room
        self._folds = table(fold[:, None])
        self._signals, self._arcs = table(values[:, :-1]), table(values[:, -1])
        arcs = values[:, -1].reshape(*axes, along, across)
        self._safe = 0.98 * self._first_slip(arcs, reach.reshape(axes))

    def _first_slip(self, arcs: Array, reach: Array) -> float:
        """The least share of the reach at which some contact comes to the tip; 1 where none does.

        Of arcs over distances (..., along, across), polynomials of c at the nodes of conditions and
        distances, and of reaches (...). Between the nodes of distances a root is looked for, as
        they are far apart; of conditions there are their nodes and ends.
        """
        for axis, count in enumerate(reach.shape):  # the ends beside the nodes
            place = np.concatenate([[0.0], nodes(count), [1.0]]) if count > 1 else nodes(count)
            wide = basis(count, place).T
            wider = [
                np.tensordot(wide, fit(np.moveaxis(a, axis, 0)), axes=1) for a in (arcs, reach)
            ]
            arcs, reach = (np.asarray(np.moveaxis(a, 0, axis), dtype=float) for a in wider)
        x = np.linspace(0.0, 1.0, 129)[1:]
        fine = basis(self._along, x).T @ np.moveaxis(fit(np.moveaxis(arcs, -2, 0)), 0, -2)
        over = (fine @ basis(self._across, np.linspace(0.0, 1.0, 49))).max(axis=-1)
        over = (over * self._at(x) * reach[..., None] - 1).reshape(-1, x.size)
        slips = np.flatnonzero((over > 0).any(axis=1))
        after = np.maximum((over[slips] > 0).argmax(axis=1), 1)
        low, high = over[slips, after - 1], over[slips, after]
        share = np.clip(-low / np.maximum(high - low, 1e-300), 0.0, 1.0)
        root = self._at(x[after - 1] + share * (x[after] - x[after - 1]))
        return float(np.min(root, initial=1.0))

    def _certified(self) -> float:
        """The largest error over lateral force at 60 contacts, against solving each."""
        rng, count = np.random.default_rng(20261122), 60
        given = self._given([rng.random(count) for _ in self._axes])
        reach = self._reach @ self._polynomials(given) * np.ones(count)
        r = reach * self.length * rng.uniform(0.01, 0.999, count)
        push = self.limit(r, *given) * rng.uniform(0.001, 0.998, count)
        off = np.abs(self(r, push, *given)[0] - self._exact(r, push, given))
        room = 1 - self.taper * r / (reach * self.length)
        off /= (3 * push * room * self.stiffness / r**2)[:, None]
        off[:, self._moments] /= r[:, None]
        return float(np.max(np.where(np.isnan(off), np.inf, off)))

    # -- evaluation ----------------------------------------------------------------------------

    def _coordinate(self, share: Array) -> Array:
        """The coordinate along, 0 to 1, of shares of the reach: closer towards base and apex."""
        bend = np.array(max(self.taper, 1e-3))
        return (1 - np.sqrt(1 - unfold(bend * share))) / (1 - np.sqrt(1 - unfold(bend)))

    def _at(self, x: Array) -> Array:
        """The shares at coordinates."""
        bend = np.array(max(self.taper, 1e-3))
        return place_of(1 - (1 - x * (1 - np.sqrt(1 - unfold(bend)))) ** 2) / bend

    def _polynomials(self, given: Sequence[Array]) -> Array:
        """Products of the Chebyshev polynomials of the conditions, (m, n) or (m, 1)."""
        factors = [
            basis(k, share) for k, share in zip(self._axes, self._shares(given), strict=True)
        ]
        return reduce(lambda a, b: (a[:, None] * b).reshape(len(a) * len(b), -1), factors)

    def _contracted(self, coefficients: Array, poly: Array, by_r: Array) -> Array:
        """A table (k, n) at places (n,)."""
        along = len(by_r)
        if poly.shape[1] == 1:
            whole = np.ascontiguousarray((coefficients @ poly).reshape(along, -1).T)
            return product(whole, by_r)
        out = np.empty((len(coefficients) // along, by_r.shape[1]))
        for i in range(0, by_r.shape[1], 512):
            part = slice(i, i + 512)
            terms = product(coefficients, poly[:, part]).reshape(along, len(out), -1)
            out[:, part] = summed(terms, by_r[:, part], "xkn,xn->kn")
        return out

    def _placed(self, r: Array, given: Sequence[Array]) -> _Places:
        # Grids have many pushes at one distance and azimuth, where most of the work is.
        varied = [a for a in given if a.size > 1]
        (r, *varied), which = distinct(np.asarray(r, dtype=float) / self.length, *varied)
        if varied and r.size == 1:  # as of many: one alone would be summed in another order
            r, *varied = (a.repeat(2) for a in (r, *varied))
        each = iter(varied)
        given = [next(each) if a.size > 1 else a for a in given]
        poly = self._polynomials(given)
        reach = product(self._reach[None], poly)[0]
        in_reach = (r > 0) & (r <= reach * (1 + 1e-12))
        share = np.clip(r / reach, 0.0, 1.0)
        room = 1 - self.taper * share
        by_r = basis(self._along, self._coordinate(share))
        (last,) = self._contracted(self._folds, poly, by_r)
        far = in_reach & (share > self._safe)
        r = np.where(in_reach, r, 1.0)
        return _Places(which, r, in_reach, far, room, last * room, poly, by_r)

    def _arcs_at(self, place: _Places) -> Array:
        """Arcs of the far places as polynomials of c, (across, n)."""
        poly = place.poly if place.poly.shape[1] == 1 else place.poly[:, place.far]
        arcs = self._contracted(self._arcs, poly, place.by_r[:, place.far])
        return np.asarray(arcs * place.distance[place.far])

    def limit(self, r: Array, *given: Any) -> Array:
        """Largest push at distances and what is given (n,), rad; NaN out of reach."""
        place = self._placed(r, tuple(map(np.atleast_1d, given)))
        out = np.where(place.in_reach, place.last, np.nan)
        if place.far.any():
            arcs, c = self._arcs_at(place), np.linspace(1.0, 0.0, 25)
            over = product(basis(self._across, c).T, arcs) - 1
            over[0] = np.minimum(over[0], 0.0)
            slips = np.flatnonzero((over > 0).any(axis=0))
            first, terms = (over[:, slips] > 0).argmax(axis=0), arcs[:, slips]
            inside, outside = c[first - 1], c[first]
            below, above = over[first - 1, slips], over[first, slips]
            for _ in range(8):  # false position: all but straight, each is some 40 times closer
                at = inside + (outside - inside) * below / (below - above)
                value = summed(basis(self._across, at), terms, "kn,kn->n") - 1
                inside, below = np.where(value > 0, [inside, below], [at, value])
                outside, above = np.where(value > 0, [at, value], [outside, above])
            out[np.flatnonzero(place.far)[slips]] *= 1 - at**2
        return out[place.which]

    def __call__(self, r: Array, push: Array, *given: Any) -> tuple[Array, Codes]:
        """Signals (n, S), NaN where not held, and outcomes (n,) at distances and pushes (n,)."""
        given = tuple(map(np.atleast_1d, given))
        place = self._placed(r, given)
        which, size = place.which, len(self._moments)
        terms = self._contracted(self._signals, place.poly, place.by_r)
        terms = terms.reshape(size, self._across, -1)
        last = place.last[which]
        r, in_reach = place.distance, place.in_reach[which]
        with np.errstate(all="ignore"):
            powers = basis(self._across, np.sqrt(np.maximum(1 - push / last, 0.0)))
            lateral = (3 * self.stiffness / self.length**2) * place.room / r**2
            coefficients = np.ascontiguousarray((terms * lateral).transpose(2, 1, 0))
            out = np.matmul(powers.T[:, None], coefficients[which])[:, 0]
            out *= push[:, None] * self._parity(given)
            out[:, self._moments] *= (r * self.length)[which][:, None]
        slips = np.zeros(push.size, dtype=bool)
        if place.far.any():
            far = np.flatnonzero(place.far[which])
            at = (np.cumsum(place.far) - 1)[which][far]
            arcs = summed(powers[:, far], self._arcs_at(place)[:, at], "kn,kn->n")
            slips[far] = arcs > 1 + 1e-9
        in_contact = in_reach & (push >= 0) & (push <= last) & ~slips
        out[~in_contact] = np.nan
        lost = np.where(slips, Outcome.SLIPPED_OFF_TIP, Outcome.FLICKED_PAST)
        lost = np.where(push < 0, Outcome.NO_TOUCH, lost)
        lost = np.where(in_reach, lost, Outcome.OUT_OF_REACH)
        return out, np.where(in_contact, Outcome.HELD, lost).astype(np.int8)


@lru_cache(maxsize=256)
def curved_surface(
    whisker: Whisker | Profile, friction: tuple[float, float] = (0.0, 0.0),
    offset: tuple[float, float] = (0.0, 0.0), *, in_space: bool = False,
) -> CurvedSurface:  # fmt: skip
    """A `CurvedSurface`, kept for next contacts; whiskers of all stiffnesses share its tables."""
    stiffness_free = with_modulus(whisker, YOUNGS_MODULUS), friction, offset
    surface = copy(_kept(*stiffness_free, in_space=in_space))
    surface.whisker, surface.profile = whisker, Profile.of(whisker)
    surface.stiffness = float(surface.profile.whisker.stiffness)
    return surface


_kept = lru_cache(maxsize=64)(CurvedSurface)


def more_curved(profile: Profile, offset: Array) -> Profile:
    """The whisker, more curved by `offset` along its whole length, 1/m."""
    if not np.any(offset):
        return profile
    assert isinstance(profile.law, Spiral)
    return profile.curved(Spiral(profile.law.base + offset, profile.law.rate + 0 * offset))


def pressed(
    whisker: Whisker | Profile,
    r: Array,
    push: Array,
    azimuth: Array,
    friction: ArrayLike = 0.0,
    offset: Array | float = 0.0,
) -> tuple[Array, Codes]:
    """`SIX` signals (n, 6) and outcomes (n,) of contacts, by the rod's own equations."""
    profile = Profile.of(whisker)
    whisker = more_curved(profile, np.asarray(offset))
    beams = beams_of(whisker, r.shape)
    length = float(profile.whisker.length)
    usable = (r > 0) & np.isfinite(push) & np.isfinite(azimuth)
    rest, aside = circle(zero_load(beams, np.where(usable, r / length, 0.5))[1], azimuth)
    place = r * (rest * np.cos(push) + aside * np.sin(push))
    usable &= np.isfinite(place).all(axis=0)
    place[:, ~usable] = [[0.5 * length], [0.0], [0.0]]
    bent = rod.press(whisker, place.T, friction, round_back=push > np.pi)
    signals = np.concatenate([bent.force * [-1, 1, 1], bent.moment], axis=-1)
    signals[~usable | (push < 0)] = np.nan
    outcome = np.where(push < 0, Outcome.NO_TOUCH, bent.outcome)
    return signals, np.where(usable, outcome, Outcome.OUT_OF_REACH).astype(np.int8)


@dataclass(frozen=True, eq=False)
class SpaceBranches(Branches):
    """Branches in space, with two forces and six signals, pushed towards an azimuth (n,)."""

    moments: ClassVar[Array] = np.array([False, False, False, True, True, True])
    scenes: Any = None
    azimuth: Any = None

    @classmethod
    def around(cls, flat: Branches, azimuth: Array, whisker: Whisker) -> SpaceBranches:
        """Branches of the same contacts at azimuths (n,)."""
        none, one, twist = np.zeros(flat.r.size), np.ones(flat.r.size), 1 + rod.POISSON_RATIO
        shape = flat.r.shape
        scenes = rod.RodScenes(flat.beams, shape, one, one, flat.friction, none, twist, whisker)
        scale = flat.scale[[0, 1, 1, 2]]
        return cls(**vars(flat) | {"scale": scale}, scenes=scenes, azimuth=azimuth)

    def take(self, index: Index) -> Self:
        return replace(super().take(index), scenes=self.scenes.take(index))

    def linear(self, y: Array) -> tuple[Array, Array]:
        rest, aside = circle(self.rest, self.azimuth)
        push, unit = y[:, 3] * self.scale[3], self.scale[0]
        there = rest * np.cos(push) + aside * np.sin(push)
        forces = y[:, :3].T * self.scale[:3]
        miss, slopes, _ = self.scenes._slopes(forces, self.r * there, STEPS)
        out = np.empty((len(y), 3, 4))
        out[..., :3] = slopes * (self.scale[:3] / unit).T[:, None]
        turn = rest * np.sin(push) - aside * np.cos(push)
        out[..., 3] = (turn * self.r * self.scale[3] / unit).T
        return np.nan_to_num(miss / unit).T, out

    def onset(self) -> Array:
        if not self.friction.any():
            return super().onset()
        # Friction has a cusp at zero force, and no derivative there.
        _, aside = circle(self.rest, self.azimuth)
        v = self.start[:, :3].T * self.scale[:3]
        pace = self.scenes.onset(v, self.r, self.r * aside)
        if not np.all(np.isfinite(pace) & (np.abs(pace).max(axis=0) > 0)):
            raise NotFound
        out = np.concatenate([pace / self.scale[:3], 1 / self.scale[3:]]).T
        return out / np.linalg.norm(out, axis=1, keepdims=True)

    def signals(self, y: Array) -> Array:
        base = self.scenes.follow(y[:, :3].T * self.scale[:3], STEPS)
        return (base.signals().T * [-1, 1, 1, 1, 1, 1]).T


def circle(angle: Array, azimuth: Array) -> tuple[Array, Array]:
    """Unit vectors (3, n): where the whisker at rest touches, and the direction of the push."""
    zero = np.zeros_like(angle)
    rest = np.stack([np.cos(angle), np.sin(angle), zero])
    aside = np.stack([-np.sin(angle), np.cos(angle), zero]) * np.cos(azimuth)
    aside[2] = np.sin(azimuth)
    return rest, aside
