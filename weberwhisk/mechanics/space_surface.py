"""The six base signals of a curved whisker in space as one table over contacts, for posteriors.

What `planar_surface` is in the plane of curvature, this is around it. A point at the distance r is
pushed from where the whisker at rest touches, along the great circle about the base that leaves
there by the azimuth ω: 0 pushes towards the side that the whisker curves to, in its plane, π
against it. On a straight whisker the push and ω are the deflection angle and the azimuth.

At (r, ω) the branch of equilibria runs to the fold, at the push P: there the determinant of
∂(contact)/∂(arc, force along d₁, along d₂) changes its sign, in whatever direction the whisker
then leaves. It is followed by steps along its tangent, on the whisker continued beyond its tip to
the apex, and tabled over r, cos ω and c = √(1 − push/P), in which it is smooth up to the fold.
Signals even in ω are polynomials of cos ω, odd ones sin ω times such. With them the arc of the
contact is tabled: the contact is lost at the tip where that arc first comes to the length.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ..whisker import Whisker
from . import rod
from .branches import NotFound, grid_of, reach_of
from .chebyshev import Array, basis, fit, nodes, product
from .contact import Outcome
from .continuation import zero_load
from .cosserat import POISSON_RATIO, RodScenes
from .shape import Profile

#: Axial force positive in compression, forces along y and z; torsion, moments about y and z.
SIX = ("axial_force", "force_y", "force_z", "torsion", "moment_y", "moment_z")
_ODD = np.array([False, False, True, True, True, False, False])


class SpaceSurface:
    """The six signals of one curved whisker at any contact, without friction.

    Parameters
    ----------
    whisker : Whisker or Profile
        One whisker.

    Attributes
    ----------
    error : float
        Largest error of 60 contacts beside the rod's own, over the lateral force.

    Raises
    ------
    ValueError
        For a whisker whose folds are not found.
    """

    def __init__(self, whisker: Whisker | Profile) -> None:
        self.whisker = whisker
        profile = whisker if isinstance(whisker, Profile) else Profile.of(whisker)
        self.length = float(profile.whisker.length)
        self.stiffness = float(profile.whisker.stiffness)
        one = grid_of(profile, np.zeros(1), np.zeros(1))
        self.taper, self._reach = one.taper, float(reach_of(one)[0])
        try:
            # Nodes about, along and across, more where the error over the lateral force is more
            # than a thousandth of a Weber fraction of 0.01.
            for self._sizes in ((9, 18, 12), (14, 28, 16)):
                with np.errstate(all="ignore"):
                    self._build(profile)
                self.error = self._certified()
                if self.error < 1e-5:
                    break
        except NotFound:
            raise ValueError(
                f"The folds of {whisker} in space were not found; give less curvature, or "
                'model="rod", which solves each contact by itself.'
            ) from None

    def _build(self, profile: Profile) -> None:
        about, along, across = self._sizes
        cosine, r = (
            a.ravel()
            for a in np.meshgrid(2 * nodes(about) - 1, self._reach * nodes(along), indexing="ij")
        )
        branches = _Branches.of(profile, r, np.arccos(cosine))
        end = branches.folds()
        values = branches.tabled(end, across)  # (across, n, 7)
        lateral = 3 * branches.room / r**2
        values[..., :6] /= lateral[:, None]
        values[..., 3:6] /= r[:, None]
        values[..., 6] /= r
        values[..., _ODD] /= np.sqrt(1 - cosine**2)[:, None]
        self._last = fit(fit(end[:, 3].reshape(about, along)).T).T
        table = fit(values).reshape(across, about, along, 7).transpose(1, 2, 0, 3)
        table = fit(np.moveaxis(fit(np.moveaxis(table, 1, 0)), 0, 1))
        self._rows = np.ascontiguousarray(table.reshape(about, -1).T)
        slipping = (values[..., 6] * r > 1).any(axis=0)
        #: No contact nearer than this comes to the tip.
        self._safe = 0.98 * float(np.min(r[slipping], initial=self._reach)) - 0.5 / along**2

    # -- evaluation ----------------------------------------------------------------------------

    def _placed(self, r: Array, azimuth: Array) -> tuple[Array, Array, Array, Array]:
        """Polynomials about and along at distances; room to the apex, and push at the fold."""
        about, along, _ = self._sizes
        x = np.clip(r / self._reach, 0.0, 1.0)
        poly, by_r = basis(about, (1 + np.cos(azimuth)) / 2), basis(along, x)
        room = 1 - self.taper * x
        last = np.einsum("in,in->n", self._last.T @ poly, by_r) * room
        return poly, by_r, room, last

    def _across(self, poly: Array, by_r: Array) -> Array:
        """Coefficients (across, 7, n) of what is tabled, as polynomials of c."""
        _, along, across = self._sizes
        out = np.empty((across, 7, by_r.shape[1]))
        for i in range(0, by_r.shape[1], 512):
            part = slice(i, i + 512)
            terms = product(self._rows, poly[:, part]).reshape(along, across * 7, -1)
            whole = np.einsum("xkn,xn->kn", terms, by_r[:, part])
            out[..., part] = whole.reshape(across, 7, -1)
        return out

    def _slips(self, r: Array, last: Array, coefficients: Array) -> Array:
        """The push at which contacts first come to the tip; that of the fold where they do not."""
        across, samples = self._sizes[2], 24
        c = np.linspace(1.0, 0.0, samples)
        over = r * (basis(across, c).T @ coefficients[:, 6]) - 1
        beyond = over > 0
        beyond[0] = False
        slips = np.flatnonzero(beyond.any(axis=0))
        first, terms = beyond[:, slips].argmax(axis=0), coefficients[:, 6, slips]
        low, high = c[first], c[first - 1]
        at_low, at_high = over[first, slips], over[first - 1, slips]
        for _ in range(9):  # regula falsi, an end that stays counted for half
            share = np.clip(at_low / (at_low - at_high), 1e-3, 1 - 1e-3)
            middle = low + (high - low) * share
            at = r[slips] * np.einsum("kn,kn->n", basis(across, middle), terms) - 1
            lost = at > 0
            at_high = np.where(lost, 0.5 * at_high, at)
            at_low = np.where(lost, at, 0.5 * at_low)
            low, high = np.where(lost, middle, low), np.where(lost, high, middle)
        out = last.copy()
        out[slips] *= 1 - high**2
        return out

    def limit(self, r: Array, azimuth: Array) -> Array:
        """Largest push at distances and azimuths (n,), rad; NaN out of reach."""
        pairs, which = _pairs(r, azimuth)
        x, _, _, end, _ = self._at(*pairs, tabled=False)
        return np.where((x > 0) & (x <= self._reach), end, np.nan)[which]

    def _at(
        self, r: Array, azimuth: Array, *, tabled: bool = True
    ) -> tuple[Array, Array, Array, Array, Array]:
        """Distances in lengths, room, the pushes at fold and end; and `_across`, all or beyond
        the distance from which contacts come to the tip.
        """
        x = r / self.length
        poly, by_r, room, last = self._placed(x, azimuth)
        far = x > self._safe
        terms = self._across(poly, by_r) if tabled else self._across(poly[:, far], by_r[:, far])
        end = last.copy()
        end[far] = self._slips(x[far], last[far], terms[..., far] if tabled else terms)
        return x, room, last, end, terms

    def reach(self) -> float:
        """Distance of the tip at rest, m."""
        return self.length * self._reach

    def __call__(self, r: Array, push: Array, azimuth: Array) -> tuple[Array, NDArray[np.int8]]:
        """`SIX` signals (n, 6), NaN where not held, and outcomes (n,)."""
        # Grids and tiles have many pushes at one distance and azimuth, where most of the work is.
        pairs, which = _pairs(r, azimuth)
        x, room, last, end, terms = self._at(*pairs)
        known = (x > 0) & (x <= self._reach) & np.isfinite(pairs[1])
        x = np.where(known, x, self._reach)
        terms[:, :6] *= 3 * room / x**2 * (self.stiffness / self.length**2)
        terms[:, _ODD] *= np.sin(pairs[1])
        terms[:, 3:6] *= x * self.length
        known = known[which]
        slips, last, end = (end < last)[which], last[which], end[which]
        held = known & (push >= 0) & (push <= end)
        c = np.where(held, np.sqrt(np.maximum(1 - push / np.where(held, last, 1.0), 0.0)), 0.0)
        powers = basis(self._sizes[2], c).T
        powers *= np.where(held, push, np.nan)[:, None]
        rows = np.ascontiguousarray(terms[:, :6].transpose(2, 0, 1))
        out = np.matmul(powers[:, None], rows[which])[:, 0]
        lost = np.where(slips, Outcome.SLIPPED_OFF_TIP, Outcome.FLICKED_PAST)
        lost = np.where(push < 0, Outcome.NO_TOUCH, lost)
        lost = np.where(known, lost, Outcome.OUT_OF_REACH)
        return out, np.where(held, Outcome.HELD, lost).astype(np.int8)

    def _certified(self, count: int = 60) -> float:
        """The largest error of contacts all over, beside the rod's own solution."""
        rng = np.random.default_rng(20261123)
        r = self.reach() * rng.uniform(0.01, 0.999, count)
        azimuth = rng.uniform(-np.pi, np.pi, count)
        push = self.limit(r, azimuth) * rng.uniform(0.001, 0.998, count)
        exact, _ = pressed(self.whisker, r, push, azimuth)
        found, _ = self(r, push, azimuth)
        lateral = 3 * push * (1 - self.taper * r / self.reach()) * self.stiffness / r**2
        off = np.abs(found - exact) / lateral[:, None]
        off[:, 3:] /= r[:, None]
        return float(np.max(np.where(np.isnan(off), np.inf, off)))


def _pairs(r: Array, azimuth: Array) -> tuple[tuple[Array, Array], NDArray[np.intp]]:
    """The distinct pairs (m,) of distances and azimuths (n,), and which each is."""
    distances, i = np.unique(np.asarray(r, dtype=float), return_inverse=True)
    azimuths, j = np.unique(np.broadcast_to(azimuth, i.shape), return_inverse=True)
    pairs, which = np.unique(i * azimuths.size + j, return_inverse=True)
    i, j = np.divmod(pairs, max(azimuths.size, 1))
    return (distances[i], azimuths[j]), which


@lru_cache(maxsize=16)
def space_surface(whisker: Whisker | Profile) -> SpaceSurface:
    """The surface of a whisker, kept for its next contacts."""
    return SpaceSurface(whisker)


def pressed(
    whisker: Whisker | Profile, r: Array, push: Array, azimuth: Array
) -> tuple[Array, NDArray[np.int8]]:
    """`SIX` signals (n, 6) and outcomes (n,) of contacts, by the rod's own equations."""
    profile = whisker if isinstance(whisker, Profile) else Profile.of(whisker)
    one = grid_of(profile, np.zeros_like(r), np.zeros_like(r))
    length = float(profile.whisker.length)
    known = (r > 0) & np.isfinite(push) & np.isfinite(azimuth)
    rest, aside = _circle(zero_load(one.rows, np.where(known, r / length, 0.5))[1], azimuth)
    place = r * (rest * np.cos(push) + aside * np.sin(push))
    known &= np.isfinite(place).all(axis=0)
    place[:, ~known] = [[0.5 * length], [0.0], [0.0]]
    bent = rod.press(whisker, place.T, round_back=push > np.pi)
    signals = np.concatenate([bent.force * [-1, 1, 1], bent.moment], axis=-1)
    signals[~known | (push < 0)] = np.nan
    outcome = np.where(push < 0, Outcome.NO_TOUCH, bent.outcome)
    return signals, np.where(known, outcome, Outcome.OUT_OF_REACH).astype(np.int8)


def _circle(angle: Array, azimuth: Array) -> tuple[Array, Array]:
    """Where the whisker at rest touches, and whither it is pushed: unit vectors (3, n)."""
    zero = np.zeros_like(angle)
    rest = np.stack([np.cos(angle), np.sin(angle), zero])
    aside = np.stack([-np.sin(angle), np.cos(angle), zero]) * np.cos(azimuth)
    aside[2] = np.sin(azimuth)
    return rest, aside


class _Branches:
    """Branches of equilibria at n distances and azimuths, on whiskers continued to the apex.

    A point of a branch is y (n, 4): arc, the two forces and the push in units of `scale` (4, n),
    which shrink towards the apex as folds do.
    """

    def __init__(
        self, scenes: RodScenes, r: Array, rest: Array, aside: Array, start: Array, room: Array
    ) -> None:
        self.scenes, self.r, self.rest, self.aside = scenes, r, rest, aside
        self.start, self.room = start, room
        self.scale = np.stack([r * room, *2 * [3 * room**2 / r**2], room])

    @classmethod
    def of(cls, profile: Profile, r: Array, azimuth: Array) -> _Branches:
        one, none = np.ones(r.size), np.zeros(r.size)
        grid = grid_of(profile, none, none)
        scenes = RodScenes(
            grid.rows, (r.size,), one, one, none, none, 1 + POISSON_RATIO, profile.whisker
        )
        arc, angle = zero_load(grid.rows, r)
        room = 1 - grid.taper * r / reach_of(grid)
        start = np.stack([arc / (r * room), none, none, none], axis=1)
        return cls(scenes, r, *_circle(angle, azimuth), start, room)

    def take(self, index: NDArray[np.intp]) -> _Branches:
        return _Branches(
            self.scenes.take(index), self.r[index], self.rest[:, index], self.aside[:, index],
            self.start[index], self.room[index],
        )  # fmt: skip

    def linear(self, y: Array) -> tuple[Array, Array]:
        """How far the contact is off the point (n, 3), and its slopes to y (n, 3, 4)."""
        push, unit = y[:, 3] * self.room, self.r * self.room
        there = self.rest * np.cos(push) + self.aside * np.sin(push)
        miss, slopes, _ = self.scenes._slopes(y[:, :3].T * self.scale[:3], self.r * there, 12)
        out = np.empty((len(y), 3, 4))
        out[..., :3] = slopes * (self.scale[:3] / unit).T[:, None]
        out[..., 3] = (self.rest * np.sin(push) - self.aside * np.cos(push)).T
        return np.nan_to_num(miss / unit).T, out

    def corrected(self, y: Array, across: Array, steps: int) -> tuple[Array, Array, Array]:
        """Newton's method on the plane through y normal to `across` (n, 4); slopes, last step."""
        for _ in range(steps):
            miss, slopes = self.linear(y)
            matrix = np.concatenate([slopes, across[:, None]], axis=1)
            bad = ~(np.abs(np.linalg.det(matrix)) > 1e-12)
            matrix[bad] = np.eye(4)
            right = np.concatenate([miss, np.zeros((len(y), 1))], axis=1)
            step = np.where(bad[:, None], 1.0, np.linalg.solve(matrix, right[..., None])[..., 0])
            y = y + np.clip(step, -0.3, 0.3)
        return y, slopes, np.abs(step).max(axis=1)

    def folds(self, *, first: float = 0.05, longest: float = 0.15) -> Array:
        """Points (n, 4) of the folds.

        By steps along the branch until the push falls, and the secant method in the last of them.
        """
        n = self.r.size
        y, end = self.start.copy(), np.full((n, 4), np.nan)
        tangent = _tangent(self.linear(y)[1])
        tangent *= np.sign(tangent[:, 3:])
        stride, left = np.full(n, first), np.arange(n)
        for _ in range(200):
            part, h = self.take(left), stride[left]
            here, along = y[left], tangent[left]
            there, slopes, size = part.corrected(here + h[:, None] * along, along, 3)
            after = _tangent(slopes)
            after *= np.sign((after * along).sum(axis=1))[:, None]
            good = (size < 1e-5) & ((after * along).sum(axis=1) > 0.97)
            over = good & (after[:, 3] < 0)
            if over.any():
                some = np.flatnonzero(over)
                end[left[some]] = part.take(some).fold(here[some], along[some], h[some])
            stride[left] = np.where(good, np.minimum(1.3 * h, longest), h / 2)
            y[left] = np.where(good[:, None], there, here)
            tangent[left] = np.where(good[:, None], after, along)
            left = left[~over]
            if not left.size:
                break
            if np.min(stride[left]) < 1e-4:
                raise NotFound
        if np.isnan(end).any():
            raise NotFound
        return end

    def fold(self, y: Array, along: Array, stride: Array) -> Array:
        """The point at which the push is largest, on steps from y along a tangent."""
        low, high = np.zeros_like(stride), stride
        at_low, at_high = along[:, 3], np.full_like(stride, np.nan)
        at = high
        for i in range(8):
            point, slopes, _ = self.corrected(y + at[:, None] * along, along, 3)
            slope = _tangent(slopes)
            slope = (slope * np.sign((slope * along).sum(axis=1))[:, None])[:, 3]
            rising = slope > 0
            low, at_low = np.where(rising, at, low), np.where(rising, slope, at_low)
            high, at_high = np.where(rising, high, at), np.where(rising, at_high, slope)
            if np.max(np.abs(slope)) < 1e-6:
                break
            share = at_low / (at_low - at_high)
            if i % 3 == 2:  # lest one end stay where it is
                share = np.clip(share, 0.05, 0.95)
            at = low + (high - low) * share
        return point

    def tabled(self, end: Array, across: int) -> Array:
        """Signals over the push, and the arc, (across, n, 7), at the nodes from the fold to rest.

        Newton's method, each node from those before and from the fold.
        """
        tangent = _tangent(self.linear(self.start)[1])
        pace = tangent / tangent[:, 3:]

        def over(y: Array) -> Array:
            return np.concatenate([y[:, :1], y[:, 1:3] / y[:, 3:]], axis=1)

        rest = np.concatenate([self.start[:, :1], pace[:, 1:3]], axis=1)
        known, cs = [over(end), rest], [0.0, 1.0]
        out = np.empty((across, self.r.size, 7))
        for j, c in list(enumerate(nodes(across)))[::-1]:
            near = [0, *range(len(cs) - 1, 0, -1)[:6]]
            guess = sum(
                known[a] * np.prod([(c - cs[b]) / (cs[a] - cs[b]) for b in near if b != a])
                for a in near
            )
            push = end[:, 3] * (1 - c) * (1 + c)
            y = np.concatenate([guess[:, :1], guess[:, 1:] * push[:, None], push[:, None]], axis=1)
            upright = np.broadcast_to([0.0, 0.0, 0.0, 1.0], y.shape)
            for _ in range(6):
                y, _, size = self.corrected(y, upright, 1)
                if np.max(size) < 1e-9:
                    break
            if not np.max(size) < 1e-6:
                raise NotFound
            cs.append(float(c))
            known.append(over(y))
            base = self.scenes.follow(y[:, :3].T * self.scale[:3], 12)
            signals = base.signals().T * [-1, 1, 1, 1, 1, 1]
            out[j] = np.column_stack(
                [signals / (push * self.room)[:, None], y[:, 0] * self.scale[0]]
            )
        return out


def _tangent(slopes: Array) -> Array:
    """Unit vectors (n, 4) that slopes (n, 3, 4) take to nothing."""
    minors = [np.linalg.det(np.delete(slopes, k, axis=2)) * (-1) ** k for k in range(4)]
    out = np.stack(minors, axis=1)
    return out / np.linalg.norm(out, axis=1, keepdims=True)
