"""Equilibria of the planar beam at a contact point: Newton's method, else a walk along the branch.

In units of the whisker's length, base radius and base stiffness.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._util.refusals import Refusal
from .._util.values import Array, Codes, Flags, Index
from ..whisker import Whisker
from .beam import Beams, Path, beams_of, follow_each, needed, zero_load
from .branches import FOLD, Branches, extended, walk
from .contact import TIP_ROUNDING, Bending, Model, Outcome, bending
from .elastica import ChebyshevTable, Curve, the_map, unfold
from .shape import Profile

__all__ = [
    "ROUNDING", "Scenes", "Solved", "at_points", "by_rows", "common_shape", "in_order",
    "numbers_of", "on_whisker", "press_beams", "signal_error", "signal_slopes",
]  # fmt: skip

Solved = tuple[Array, Codes, Array]


def common_shape(profile: Profile, arguments: Mapping[str, ArrayLike]) -> tuple[int, ...]:
    """The broadcast shape of whiskers and arguments; raises ValueError if they do not broadcast."""
    law = vars(profile.law).values()
    whiskers = profile.arc[0], profile.radius[0], profile.whisker.stiffness, *law
    try:
        return np.broadcast_shapes(*(np.shape(a) for a in (*whiskers, *arguments.values())))
    except ValueError:
        shapes = ", ".join(f"{k} {np.shape(v)}" for k, v in arguments.items())
        raise Refusal(
            "The scenes must broadcast with each other and the whisker",
            f"{shapes} and a whisker of {np.shape(profile.radius[0])}",
            "give arrays of one shape",
        ) from None


@dataclass(frozen=True, eq=False)
class Scenes:
    """Whiskers and scenes of one broadcast shape, flat and in natural units."""

    whisker: Whisker
    shape: tuple[int, ...]
    length: Array
    force: Array
    beams: Beams
    given: list[Array]

    @classmethod
    def of(cls, whisker: Whisker | Profile, **arguments: ArrayLike) -> Scenes:
        """Scenes with the arguments named ``length`` and ``force`` brought to natural units."""
        profile = Profile.of(whisker)
        base, shape = profile.whisker, common_shape(profile, arguments)

        def flat(value: ArrayLike) -> Array:
            return np.broadcast_to(np.asarray(value, dtype=float), shape).reshape(-1)

        length, force = flat(base.length), flat(base.force_scale)
        unit: dict[str, Any] = {"length": length, "force": force}
        given = [flat(value) / unit.get(name, 1.0) for name, value in arguments.items()]
        return cls(base, shape, length, force, beams_of(profile, shape), given)

    def pieces(self) -> Iterator[tuple[slice, Beams, list[Array]]]:
        """Pieces of 32 768 scenes: where they are, their whiskers and their arguments."""
        size = 32768
        for start in range(0, self.length.size, size):
            part = slice(start, start + size)
            yield part, self.beams.take(part), [a[part] for a in self.given]

    def jacobian(self, slopes: Array) -> Array:
        """Slopes (3, 2, n) of moment and two forces to (r, θ_d), (..., 3, 2) and in SI units."""
        one = np.ones_like(self.length)
        to_signal = self.force * np.stack([self.length, one, one])
        to_contact = np.stack([self.length, one])
        slopes = slopes * to_signal[:, None] / to_contact
        return np.moveaxis(slopes, -1, 0).reshape(*self.shape, 3, 2)

    def bending(self, numbers: Array, outcome: Codes, error: Array) -> Bending:
        """Results in the scenes' shape and in SI units."""
        length, force, one = self.length, self.force, np.ones_like(self.length)
        # In the order of `contact.NUMBERS`.
        units = np.stack([force * length, force, force, length, one, one, length, force])
        return bending(self.whisker, Model.PROFILE, self.shape, numbers * units, outcome, error)


def by_rows(
    solve: Callable[..., Solved], whisker: Whisker | Profile, **arguments: ArrayLike
) -> Bending:
    """Solve scenes in pieces, and restore units and shape."""
    scenes = Scenes.of(whisker, **arguments)
    n = scenes.length.size
    numbers, outcome, error = np.empty((8, n)), np.empty(n, dtype=np.int8), np.empty(n)
    for part, beams, given in scenes.pieces():
        numbers[:, part], outcome[part], error[part] = solve(beams, *given)
    return scenes.bending(numbers, outcome, error)


#: Of contact distance and angle, a few last digits.
ROUNDING = 3e-15


def press_beams(beams: Beams, r: Array, theta: Array, psi: Array, tolerance: float) -> Solved:
    """Numbers, outcomes and errors of whiskers pressed against points (r, θ)."""
    n = r.size
    numbers, error = np.full((8, n), np.nan), np.full(n, np.nan)
    outcome = np.full(n, Outcome.OUT_OF_REACH, dtype=np.int8)
    start, rest = zero_load(beams, r)
    good = in_order(beams, start, np.isfinite(start) & on_whisker(beams, start))
    if not good.size:
        return numbers, outcome, error
    sign = np.where(theta < rest, -1.0, 1.0)[good]
    part = beams.take(good).mirrored(sign)
    distance, angle, psi_ = r[good], theta[good] * sign, psi[good]
    push = angle - rest[good] * sign
    s, f, path, rest_error, converged = _newton(
        part, distance, angle, psi_, start[good], push, tolerance
    )
    values = numbers_of(path.angle, path.lever, path.along, s, f, psi_, sign)
    error[good] = np.minimum(signal_error(path, f, given_contact=True) + rest_error, 1.0)
    outcome[good] = Outcome.HELD

    hard = np.flatnonzero(~converged)
    if hard.size:
        whiskers = extended(part.take(hard))
        branch = Branches.of(whiskers, distance[hard], psi_[hard], tolerance=tolerance)
        ended = walk(branch, angle[hard] - branch.rest)
        values[:, hard], error[good[hard]] = at_points(branch, ended.point, sign[hard], angle[hard])
        outcome[good[hard]] = ended.outcome
        # Where contact without friction would be stable, friction has stopped the sliding.
        folded = good[hard[(ended.end == FOLD) & (psi_[hard] != 0)]]
        if folded.size:
            of = beams.take(folded), r[folded], theta[folded]
            slick = press_beams(*of, 0 * r[folded], tolerance)[1]
            outcome[folded[slick == Outcome.HELD]] = Outcome.STUCK
    in_contact = outcome[good] == Outcome.HELD
    numbers[:, good] = np.where(in_contact, values, np.nan)
    error[good] = np.where(in_contact, error[good], np.nan)
    numbers[3], numbers[4] = r, theta  # as given
    return numbers, outcome, error


def _newton(
    beams: Beams, r: Array, theta: Array, psi: Array, start: Array, push: Array, tolerance: float
) -> tuple[Array, Array, Path, Array, Flags]:
    """Arc, force and pass at (r, θ), error left by the last step, and where stability is shown."""
    n = r.size
    compliance, f, s, steps = _guess(beams, r, psi, start, push)
    floor = 1e-6 / compliance
    size, before, left = np.full(n, np.inf), np.ones(n), np.zeros(n)
    paths: Path | None = None
    active = np.arange(n)
    for count in range(12):
        at = active
        part = beams.take(at) if at.size < n else beams
        path = follow_each(part, s[at], f[at], psi[at], steps[at])
        with np.errstate(all="ignore"):
            r_s, r_f, t_s, t_f = path.jacobian()
            d = r_s * t_f - r_f * t_s
            miss_r, miss_t = r[at] - path.distance, theta[at] - path.deflection
            ds = (miss_r * t_f - miss_t * r_f) / d
            df = (miss_t * r_s - miss_r * t_s) / d
            ds = np.clip(np.nan_to_num(ds), -0.2 * r[at], 0.2 * r[at])
            most = np.abs(f[at]) + floor[at]
            df = np.clip(np.nan_to_num(df), -0.5 * most, most)
            ds = np.minimum(ds, 1.0 - s[at])
            now = np.maximum(np.abs(ds) / r[at], np.abs(df) / most)
            # Error left in the signals, C·size²: C from the step before, but no less than usual,
            # which grows towards the fold as D falls.
            usual = 3 * np.maximum(1.0, (compliance[at] / d) ** 2)
            left[at] = 10 * now**2 * np.maximum(now / before[at] ** 2, usual)
            path = path.moved(ds, df)
            # Errors of the pass grow in the signals towards the fold, and where a curved whisker is
            # hardly pushed from rest.
            idle = np.maximum(path.scale / np.abs(push[at]), 1.0)
            grown = np.clip(np.maximum(np.abs(compliance[at] / d), idle), 1.0, 100.0)
            exact = np.maximum(tolerance / grown, min(tolerance, 1e-12))
            loose = np.maximum(1e-4 / idle, exact)
            # The next pass need be no more precise than its step.
            last = 300 * now**4 < tolerance
            bound = np.where(last, 0.5 * exact, np.clip(1e-2 * now**2, exact, loose))
            steps[at] = needed(path.steps, path.error, bound)
        size[at] = now
        s[at] += ds
        f[at] += df
        paths = path if paths is None else paths.put(at, path)
        before[at] = np.minimum(now, 1.0)
        done = (left[at] <= tolerance) & (path.error <= exact)
        lost = (count > 4) & (now > 0.1)
        active = at[~(done | lost)]
        if not active.size:
            break
    assert paths is not None
    converged = (left <= tolerance) & (size < 1e-2) & (paths.flips == 0)
    converged &= (paths.error <= tolerance) & (f > -floor) & ~_winds(beams)
    with np.errstate(invalid="ignore"):
        slack = 1e-5 * np.sqrt(tolerance) + 10 * tolerance
        converged &= np.abs(paths.distance - r) <= (slack + left) * r
        converged &= np.abs(paths.deflection - theta) <= slack + left
    return s, f, paths, left, converged


def _guess(
    beams: Beams, r: Array, psi: Array, start: Array, push: Array
) -> tuple[Array, Array, Array, NDArray[np.int64]]:
    """dθ_d/dF at zero load; force, arc and steps a piece from which Newton's method starts.

    From the elastica of the straight taper with the same compliance and the same ratio of contact
    to deflection angle, its fold shifted for friction and the shape at rest.
    """
    # One step is not enough where the taper is thin.
    thin = start * (1 - beams.radius[-1] / beams.radius[0]) > 0.7
    path = follow_each(beams, start, np.zeros_like(r), psi, np.where(thin, 2, 1))
    r_s, r_f, t_s, t_f = path.jacobian()
    slide = -r_f / r_s
    share = path.d_force[0] / t_f  # (3 − 2v) / (2 (1 − v)) for a straight taper touched at r = vA
    v = np.clip((2 * share - 3) / (2 * share - 2), 0.0, 0.99)
    compliance = np.maximum(t_f + t_s * slide, 1e-3 * r**2)
    # The folds of curved whiskers and of those that friction pushes along, against straight ones.
    tilt = path.angle - psi - path.deflection
    moved = np.clip(1 - 0.45 * psi - 0.8 * tilt, 0.3, 3.0)
    table, folds = _small_table()
    x = unfold(v)
    fold = (1 - v) * folds(x)[0]
    near = np.minimum(push / (moved * fold), 0.98)
    log_force, _, log_extra = table(x, np.sqrt(1 - near**2))
    log_force += near * (0.4 * psi * (1 + near**2) - 0.35 * tilt)
    f = near * moved * fold / compliance * np.exp(log_force)
    s = start * (1 + push**2 / (1 - v) * np.exp(log_extra)) + slide * f
    spanned = np.maximum((beams.arc[:-1] < start).sum(axis=0), 1)
    steps = np.rint(2.8 * (push * share) ** 0.2 / spanned**0.7)
    return compliance, f, np.clip(s, 0.5 * start, 1.0), np.clip(steps, 1, 4).astype(np.int64)


def _winds(beams: Beams) -> Flags:
    """Whether whiskers are so curled that Newton's method may find another branch than the first.

    From 1.5 rad of turn at rest on, about twice that of a rat's whisker.
    """
    if beams.law is None:
        return np.zeros(beams.radius.shape[1], dtype=bool)
    bends = [np.abs(beams.law.turn(np.asarray(share))) for share in (0.25, 0.5, 0.75, 1.0)]
    return np.asarray(np.max(bends, axis=0) > 1.5)


def at_points(
    branches: Branches, y: Array, sign: Array, goal: Array | None = None
) -> tuple[Array, Array]:
    """The eight numbers and the error at points of branches, with `goal` for deflection angle."""
    path, (arc, force) = branches.path(y), y[:, :2].T * branches.scale[:2]
    arc = np.minimum(arc, 1.0)
    missed = np.zeros_like(path.errors)
    missed[1] = np.abs(path.distance / branches.r - 1)
    if goal is not None:
        missed[0] = np.abs(goal - path.deflection)
    path = replace(path, errors=path.errors + missed)
    error = signal_error(path, force, given_contact=True)
    # At a fold signals vary as the square root of the angle left: a bound on their error.
    error = np.minimum(error, 3 * np.sqrt(path.error))
    numbers = numbers_of(path.angle, path.lever, path.along, arc, force, branches.friction, sign)
    return numbers, error


def signal_error(path: Path, force: Array, *, given_contact: bool) -> Array:
    """The relative error of the signals from the error of the pass.

    With contact arc and force given, from base angle and lever. With the contact point given, also
    from arc and force: without bound towards the fold. An axial or transverse force near zero is
    compared with a thousandth of the force.
    """
    r, sine, cosine = path.distance, np.sin(path.angle), np.cos(path.angle)
    with np.errstate(all="ignore"):
        e_t = path.errors[0] + ROUNDING * np.abs(path.angle)
        e_r = r * (path.errors[1] + ROUNDING)
        off = force * np.stack([e_r, np.abs(cosine) * e_t, np.abs(sine) * e_t])
        if given_contact:
            slopes = np.abs(signal_slopes(path, force, np.ones_like(force)))
            off += slopes[:, 0] * e_r + slopes[:, 1] * e_t
        whole = np.abs(force * np.stack([path.lever, sine, cosine]))
        least = 1e-3 * np.abs(force) * np.stack([r, np.minimum(path.scale, 1.0), np.ones_like(r)])
        error = (off / np.maximum(whole, least)).max(axis=0)
    error = np.where(np.isnan(error), path.error, np.maximum(error, path.error))
    return np.asarray(np.minimum(error, 1.0))


def numbers_of(
    angle: Array, lever: Array, along: Array, arc: Array, force: Array, psi: Array, sign: Array
) -> Array:
    """The numbers of a `Bending` in units of length, EI₀/L² and EI₀/L."""
    return np.stack(
        [
            sign * force * lever,
            force * np.sin(angle),
            sign * force * np.cos(angle),
            np.hypot(lever, along),
            sign * (angle + np.arctan2(along, lever)),
            sign * (angle - psi),
            arc,
            sign * force,
        ]
    )


def signal_slopes(path: Path, force: Array, sign: Array) -> Array:
    """Derivatives (3, 2, n) of the signals with respect to r and θ_d, mirrored by `sign`."""
    sine, cosine = np.sin(path.angle), np.cos(path.angle)
    turn_s, turn_f = path.d_arc[0], path.d_force[0]
    to_arc = force * np.stack([path.d_arc[1], cosine * turn_s, -sine * turn_s])
    to_force = np.stack([path.lever, sine, cosine]) + force * np.stack(
        [path.d_force[1], cosine * turn_f, -sine * turn_f]
    )
    r_s, r_f, t_s, t_f = path.jacobian()
    with np.errstate(divide="ignore", invalid="ignore"):
        determinant = r_s * t_f - r_f * t_s
        to_point = to_arc * t_f - to_force * t_s, to_force * r_s - to_arc * r_f
        slopes = np.stack(to_point, axis=1) / determinant
    # Moment, transverse force and angle are mirrored, axial force and distance are not.
    slopes[[0, 2], 0] *= sign
    slopes[1, 1] *= sign
    return np.asarray(slopes)


def on_whisker(beams: Beams, arc: Array) -> Flags:
    """Whether arcs are on the whisker, and not at the tip of a cone, which has no stiffness."""
    return (arc <= 1 + TIP_ROUNDING) & ~((arc >= 1 - TIP_ROUNDING) & (beams.radius[-1] <= 0))


def in_order(beams: Beams, arc: Array, which: Flags) -> Index:
    """The indices of `which`, sorted by contact arc if there are several pieces.

    A block of contacts near the base then skips the pieces beyond.
    """
    index = np.flatnonzero(which)
    return index[np.argsort(arc[index])] if len(beams.arc) > 2 else index


@cache
def _small_table() -> tuple[ChebyshevTable, Curve]:
    """The map of the elastica truncated to six digits, twenty times as fast."""
    table = ChebyshevTable(the_map().contact_given.coefficients[:12, :8])
    return table, Curve(the_map().fold.coefficients[:12, :1])
