"""Branches of equilibria from rest to the fold, many at a time: what `curved_surface` is made of.

The equilibria of a contact at one place along the whisker are a curve in y: contact arc, force
(in space along two directions) and push, the angle by which the whisker has been turned since it
first touched. Along it the push rises up to the fold, in whatever direction the whisker leaves
there. The curve is followed by steps along its tangent, on the whisker continued beyond its tip to
the apex, and then solved for at the nodes of c = √(1 − push/fold) by Newton's method.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np

from .._util.values import Array, Index
from ..whisker import Whisker
from .beam import Path, Rows, follow_each
from .chebyshev import nodes
from .continuation import zero_load
from .rod import POISSON_RATIO, RodScenes
from .shape import Profile

#: Runge–Kutta steps a piece: relative errors of 1e-9, and 1e-7 at thin curved tips.
STEPS = 12


class NotFound(Exception):
    """A fold that is not found."""


#: The last thousandth of a perfect cone has no stiffness to speak of.
THINNEST = 1e-3


def taper_of(profile: Profile) -> float:
    """1 − tip over base radius, of a tip that is no thinner than `THINNEST`."""
    return max(1 - max(float(profile.radius[-1] / profile.radius[0]), THINNEST), 0.0)


def extended(profile: Profile, offset: Array, beyond: float = 2.5) -> Rows:
    """Rows of a whisker that is more curved by `offset` (n,), 1/m.

    In units of length, base radius and stiffness, going on beyond the tip to the apex or `beyond`.
    """
    length, radius = float(profile.whisker.length), float(profile.whisker.base_radius)
    arc, wide, core = profile.arc / length, profile.radius / radius, profile.core / radius
    wide = np.append(wide[:-1], max(wide[-1], THINNEST))
    slope = (wide[-1] - wide[-2]) / (arc[-1] - arc[-2])
    end = beyond if slope >= 0 else min(1.0 - wide[-1] / slope, beyond)
    if end > 1.0:
        wide = np.append(wide[:-1], wide[-1] + slope * (end - 1.0))
        arc = np.append(arc[:-1], end)
        core = np.append(core[:-1], min(core[-1], 0.9 * wide[-1]))

    def rows(table: Array) -> Array:
        return np.repeat(np.maximum(table, 0.0)[:, None], offset.size, axis=1)

    law = profile.law.scaled(np.asarray(length))
    parts = {name: np.full(offset.size, float(value)) for name, value in vars(law).items()}
    if np.any(offset):
        parts["base"] = parts["base"] + offset * length
    whole = rows(core) if np.any(profile.core > 0) else None
    return Rows(rows(arc), rows(wide), whole, type(law)(**parts))


def reach_of(rows: Rows) -> Array:
    """Distance of the tip at rest, (n,)."""
    assert rows.law is not None
    return np.hypot(*rows.law.point(np.ones(rows.radius.shape[1])))


@dataclass(frozen=True, eq=False)
class Branches:
    """Branches of n contacts at distances r (n,), in the plane of curvature and in one line.

    Points y (n, 3) are arc, force and push in units of `scale` (3, n), which shrink towards the
    apex as folds do; `room` is what is left to the apex, `rest` the angle at first touch.
    """

    #: Which signals are moments.
    moments: ClassVar[Array] = np.array([True, False, False])
    rows: Rows
    r: Array
    room: Array
    friction: Array
    arc: Array
    rest: Array

    @classmethod
    def of(cls, rows: Rows, taper: float, r: Array, friction: Array) -> Branches:
        """Those at distances and friction angles (n,)."""
        room = 1 - taper * r / reach_of(rows)
        return cls(rows, r, room, friction, *zero_load(rows, r))

    def take(self, index: Index) -> Self:
        """Some of them."""
        parts = {k: v[..., index] for k, v in vars(self).items() if isinstance(v, np.ndarray)}
        return replace(self, rows=self.rows.take(index), **parts)

    @property
    def size(self) -> int:
        """Numbers of a point."""
        return 3

    @property
    def scale(self) -> Array:
        """Sizes of arc, forces and push, (size, n)."""
        force = 3 * self.room**2 / self.r**2
        return np.stack([self.r * self.room, *(self.size - 2) * [force], self.room])

    @property
    def start(self) -> Array:
        """The points at rest."""
        y = np.zeros((self.r.size, self.size))
        y[:, 0] = self.arc / (self.r * self.room)
        return y

    def followed(self, arc: Array, force: Array) -> Path:
        """The whiskers from their contacts to the base.

        Near the apex, where 12 steps a piece were 3 % off at the fold, 36 are 4e-5 off.
        """
        steps = np.where(self.room < 0.02, 3 * STEPS, STEPS)
        return follow_each(self.rows, arc, force, self.friction, steps)

    def linear(self, y: Array) -> tuple[Array, Array]:
        """How far contacts are off their places, (n, size − 1), and minus its slopes to y."""
        arc, force, push = y.T * self.scale
        path = self.followed(arc, force)
        miss = np.stack([self.r - path.distance, self.rest + push - path.deflection])
        r_s, r_f, t_s, t_f = path.jacobian()
        zero, one = np.zeros_like(arc), np.ones_like(arc)
        slopes = np.array([[r_s, r_f, zero], [t_s, t_f, -one]]) * self.scale
        unit = np.stack([self.r * self.room, self.room])
        return np.nan_to_num(miss / unit).T, (slopes / unit[:, None]).transpose(2, 0, 1)

    def signals(self, y: Array) -> Array:
        """Moment, axial and transverse force, (3, n)."""
        arc, force, _ = y.T * self.scale
        path = self.followed(arc, force)
        return force * np.stack([path.lever, np.sin(path.angle), np.cos(path.angle)])

    def onset(self) -> Array:
        """Unit tangents (n, size) at rest, of a growing push."""
        tangent = _tangent(self.linear(self.start)[1])
        return tangent * np.sign(tangent[:, -1:])

    # -- for every kind of branch --------------------------------------------------------------

    def corrected(self, y: Array, across: Array, steps: int) -> tuple[Array, Array, Array]:
        """Newton's method on the plane through y normal to `across`: y, slopes, last step."""
        for _ in range(steps):
            miss, slopes = self.linear(y)
            matrix = np.concatenate([slopes, across[:, None]], axis=1)
            bad = ~(np.abs(np.linalg.det(matrix)) > 1e-12)
            matrix[bad] = np.eye(self.size)
            right = np.concatenate([miss, np.zeros((len(y), 1))], axis=1)
            step = np.where(bad[:, None], 1.0, np.linalg.solve(matrix, right[..., None])[..., 0])
            y = y + np.clip(step, -0.3, 0.3)
        return y, slopes, (np.abs(step) / np.maximum(np.abs(y), 1.0)).max(axis=1)

    def folds(self, *, first: float = 0.05, longest: float = 0.25) -> Array:
        """The points (n, size) of the folds.

        By steps along the branch until the push falls, and the secant method in the last of them.
        """
        y = self.start
        tangent = self.onset()
        stride, left = np.full(len(y), first), np.arange(len(y))
        for _ in range(200):
            part, h, here, along = self.take(left), stride[left], y[left], tangent[left]
            there, after, size = part.ahead(here, along, h, 2)
            good = (size < 1e-3) & ((after * along).sum(axis=1) > 0.97)
            over = good & (after[:, -1] < 0)
            most = longest * np.maximum(np.abs(there[:, 1:]).max(axis=1), 1.0)
            stride[left] = np.where(over, h, np.where(good, np.minimum(1.3 * h, most), h / 2))
            on = (good & ~over)[:, None]
            y[left], tangent[left] = np.where(on, there, here), np.where(on, after, along)
            left = left[~over]
            if not left.size:
                break
            if np.min(stride[left]) < 1e-4:
                raise NotFound
        if left.size:
            raise NotFound
        # The last step was over by rougher tangents: by better ones it may all but be.
        low, high, at = np.zeros_like(stride), 1.05 * stride, stride
        at_low, at_high = tangent[:, -1], np.full_like(stride, np.nan)
        for i in range(8):
            point, after, _ = self.ahead(y, tangent, at, 3)
            slope = after[:, -1]
            rising = slope > 0
            low, at_low = np.where(rising, at, low), np.where(rising, slope, at_low)
            high, at_high = np.where(rising, high, at), np.where(rising, at_high, slope)
            if np.max(np.abs(slope)) < 1e-5:  # pushes are then known to its square
                break
            share = np.where(np.isnan(at_high), 1.0, at_low / (at_low - at_high))
            if i % 3 == 2:  # lest one end stay where it is
                share = np.clip(share, 0.05, 0.95)
            at = low + (high - low) * share
        return point

    def ahead(self, y: Array, along: Array, h: Array, steps: int) -> tuple[Array, Array, Array]:
        """The points a step h (n,) along a tangent, their tangents, and the last step to them."""
        there, slopes, size = self.corrected(y + h[:, None] * along, along, steps)
        after = _tangent(slopes)
        return there, after * np.sign((after * along).sum(axis=1))[:, None], size

    def tabled(self, end: Array, across: int) -> Array:
        """Signals and, last, the arc, (across, n, S + 1), at the nodes from the fold to rest.

        Signals are over the small-angle lateral force 3 push · room/r², moments over its moment;
        the arc is over r. By Newton's method, each node from those before and from the fold.
        """
        tangent = self.onset()
        pace = tangent / tangent[:, -1:]

        def over(y: Array) -> Array:
            return np.concatenate([y[:, :1], y[:, 1:-1] / y[:, -1:]], axis=1)

        known = [over(end), np.concatenate([self.start[:, :1], pace[:, 1:-1]], axis=1)]
        cs, out = [0.0, 1.0], np.empty((across, self.r.size, len(self.moments) + 1))
        for j, c in list(enumerate(nodes(across)))[::-1]:
            near = [0, *range(len(cs) - 1, 0, -1)[:6]]
            guess = sum(
                known[a] * np.prod([(c - cs[b]) / (cs[a] - cs[b]) for b in near if b != a])
                for a in near
            )
            push = end[:, -1] * (1 - c) * (1 + c)
            y = np.concatenate([guess[:, :1], guess[:, 1:] * push[:, None], push[:, None]], axis=1)
            upright = np.broadcast_to(np.eye(self.size)[-1], y.shape)
            for _ in range(15):
                y, _, size = self.corrected(y, upright, 1)
                if np.max(size) < 1e-7:  # the next is some square of it
                    break
            if not np.max(size) < 1e-6:
                raise NotFound
            cs.append(float(c))
            known.append(over(y))
            lateral = 3 * push * self.room**2 / self.r**2
            unit = lateral * np.where(self.moments[:, None], self.r, 1.0)
            out[j] = np.vstack([self.signals(y) / unit, y[:, 0] * self.room]).T
        return out


@dataclass(frozen=True, eq=False)
class SpaceBranches(Branches):
    """The same in space: two forces, six signals; pushed to an azimuth (n,)."""

    moments: ClassVar[Array] = np.array([False, False, False, True, True, True])
    scenes: RodScenes
    azimuth: Array

    @classmethod
    def around(
        cls, rows: Rows, taper: float, r: Array, azimuth: Array, friction: Array, whisker: Whisker
    ) -> SpaceBranches:
        """Those at distances, azimuths and friction angles (n,)."""
        none, one, twist = np.zeros(r.size), np.ones(r.size), 1 + POISSON_RATIO
        flat = vars(Branches.of(rows, taper, r, friction))
        scenes = RodScenes(rows, (r.size,), one, one, friction, none, twist, whisker)
        return cls(**flat, scenes=scenes, azimuth=azimuth)

    def take(self, index: Index) -> Self:
        return replace(super().take(index), scenes=self.scenes.take(index))

    @property
    def size(self) -> int:
        return 4

    def linear(self, y: Array) -> tuple[Array, Array]:
        rest, aside = circle(self.rest, self.azimuth)
        push, unit = y[:, 3] * self.room, self.r * self.room
        there = rest * np.cos(push) + aside * np.sin(push)
        forces = y[:, :3].T * self.scale[:3]
        miss, slopes, _ = self.scenes._slopes(forces, self.r * there, STEPS)
        out = np.empty((len(y), 3, 4))
        out[..., :3] = slopes * (self.scale[:3] / unit).T[:, None]
        out[..., 3] = (rest * np.sin(push) - aside * np.cos(push)).T
        return np.nan_to_num(miss / unit).T, out

    def onset(self) -> Array:
        if not self.friction.any():
            return super().onset()
        # The size of friction has a cusp at no force, and no slopes there.
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
    """Where the whisker at rest touches, and whither it is pushed: unit vectors (3, n)."""
    zero = np.zeros_like(angle)
    rest = np.stack([np.cos(angle), np.sin(angle), zero])
    aside = np.stack([-np.sin(angle), np.cos(angle), zero]) * np.cos(azimuth)
    aside[2] = np.sin(azimuth)
    return rest, aside


def _tangent(slopes: Array) -> Array:
    """Unit vectors (n, k + 1) that slopes (n, k, k + 1) take to nothing."""
    size = slopes.shape[2]
    minors = [np.linalg.det(np.delete(slopes, k, axis=2)) * (-1) ** k for k in range(size)]
    out = np.stack(minors, axis=1)
    return out / np.linalg.norm(out, axis=1, keepdims=True)
