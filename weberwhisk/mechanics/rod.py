"""The rod: contact out of the plane of a curved whisker, with bending about two axes and torsion.

A Kirchhoff rod of circular section, GJ = EI/(1 + ν). As in the plane, the moment is zero at the
contact and the force's direction is known in the contact's own frame, so the rod is followed from
there to the base without shooting: with the directors dᵢ (d₃ the tangent, d₁ the normal towards
+y, d₂ towards +z), F the force and X the contact as seen from the running point,

    Ω = Σ uᵢdᵢ,  u = (m₁/EI, κ₀ + m₂/EI, m₃/GJ),  m = X × F,
    dᵢ′ = −Ω × dᵢ,  X′ = d₃    along s_c − s.

Base frame: x along the base tangent, y in the plane of intrinsic curvature, z = x × y; ``plane``
rolls that plane about x. The point of contact is on the whisker's axis, so that it brings no
torque of its own; friction acts along the whisker, as in the plane.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .._util.checks import finite, positive
from .._util.refusals import Refusal
from .._util.values import Array, Codes, Fields, Flags, Index, member
from ..whisker import Whisker
from .beam import CAUTION, ENDS, POINTS, STAGES, Beams, Piece, pilot, zero_load
from .contact import TOLERANCE, Model, Outcome, friction
from .equilibrium import ROUNDING, Scenes, on_whisker
from .shape import Profile

__all__ = ["POISSON_RATIO", "RodBending", "RodScenes", "bend", "press"]

_METRES = "give metres, such as 35e-3"
#: Of keratin; sets the torsional stiffness.
POISSON_RATIO = 0.38
_NEXT, _LAST = [1, 2, 0], [2, 0, 1]  # of three components


@dataclass(frozen=True, eq=False, repr=False)
class RodBending(Fields):
    """A whisker bent in space: six signals at the base, the contact and its outcome.

    Vectors have a last axis of 3, (x, y, z) in the base frame. NaN where there is no equilibrium.

    Attributes
    ----------
    force, moment : array (..., 3)
        What the contact does to the base, N and N m: the contact force, and its moment about the
        base, the first component of which is the torsion.
    contact : array (..., 3)
        Point of contact, m.
    tangent : array (..., 3)
        Of the whisker at the contact.
    arc_length, magnitude, direction : array
        Contact arc, m; size of the force, N; direction of its part across the whisker, rad from
        the normal d₁ towards d₂ there.
    outcome, model, error : array
        As in `Bending`.
    whisker : Whisker
    """

    force: Array
    moment: Array
    contact: Array
    tangent: Array
    arc_length: Array
    magnitude: Array
    direction: Array
    outcome: Outcome | Codes
    model: Model | Codes
    error: Array
    whisker: Whisker

    @property
    def axial_force(self) -> Array:
        """N, positive in compression."""
        return -self.force[..., 0]

    @property
    def radial_distance(self) -> Array:
        """Straight line from base to contact, m."""
        return np.sqrt((self.contact**2).sum(axis=-1))


def bend(
    whisker: Whisker | Profile,
    arc_length: ArrayLike,
    force: ArrayLike,
    direction: ArrayLike = 0.0,
    friction_angle: ArrayLike = 0.0,
    *,
    plane: ArrayLike = 0.0,
    poisson_ratio: float = POISSON_RATIO,
    tolerance: float = TOLERANCE,
) -> RodBending:
    """Bend any whisker by a force (N) in any direction across it, at an arc length (m).

    `direction` is the angle of the force about the tangent at the contact, from the normal d₁, rad:
    0 pushes to +y as in the plane. `friction_angle` as for `profile.bend`; `plane` is the roll of
    the plane of intrinsic curvature about the base tangent, rad; `poisson_ratio` lies between −1
    and 0.5. Stability is not tested when the force is given: `HELD` means in balance,
    `FLICKED_PAST` a load under which the rod winds up too much to be resolved.

    Examples
    --------
    >>> w = Whisker(50e-3, 100e-6, 5e-6, 3e9, curvature=-8.0)
    >>> b = bend(w, 30e-3, 5e-5, direction=np.radians(90))
    >>> print("torsion %.3e, bending %.3e and %.3e N m" % tuple(b.moment))
    torsion -1.773e-07, bending -1.456e-06 and 4.017e-08 N m
    """
    s = positive("arc_length", arc_length, _METRES)
    size = finite("force", force, "give newtons, such as 1e-5")
    turn = finite("direction", direction, "give radians, 0 for the plane of curvature")
    scenes, (arc, f, chi) = RodScenes.of(
        whisker, friction_angle, plane, poisson_ratio, length=s, force=size, direction=turn
    )
    v = np.stack([arc, f * np.cos(chi), f * np.sin(chi)])
    good = on_whisker(scenes.beams, v[0])
    outcome = np.where(good, Outcome.HELD, Outcome.OUT_OF_REACH).astype(np.int8)
    v[:, ~good] = [[0.5], [0.0], [0.0]]
    v[0] = np.minimum(v[0], 1.0)
    base = scenes.resolve(v, tolerance)
    lost = ~(base.error <= max(tolerance, 1e-4))
    outcome = np.where(good & lost, Outcome.FLICKED_PAST, outcome)
    return _result(scenes, v, base, outcome.astype(np.int8), base.signal_error())


def press(
    whisker: Whisker | Profile,
    point: ArrayLike,
    friction_angle: ArrayLike = 0.0,
    *,
    plane: ArrayLike = 0.0,
    poisson_ratio: float = POISSON_RATIO,
    tolerance: float = TOLERANCE,
    round_back: ArrayLike = False,
) -> RodBending:
    """Press any whisker against a point (..., 3) in space, m, in the base frame.

    The point moves on a sphere about the base, along the great circle from where the whisker at
    rest meets that sphere. The equilibrium is followed while it is stable in all directions: a
    whisker may slip sideways past the point where the planar beam would stay in contact. With
    `round_back` the point moved along the longer arc of that circle, by more than half a turn. The
    other arguments are those of `bend`, the outcomes those of `profile.press`.

    Examples
    --------
    >>> w = Whisker(50e-3, 100e-6, 5e-6, 3e9, curvature=-8.0)
    >>> b = press(w, [30e-3, 2e-3, 4e-3])
    >>> b.outcome.name, b.moment.shape
    ('HELD', (3,))
    """
    place = finite("point", point, "give (x, y, z) in metres")
    if place.ndim < 1 or place.shape[-1] != 3:
        raise Refusal(
            "point must have three components", f"shape {place.shape}", "give (x, y, z) in metres"
        )
    r = positive("the point's distance", np.sqrt((place**2).sum(-1)), _METRES)
    x, y, z = np.moveaxis(place, -1, 0)
    scenes, (distance, *point) = RodScenes.of(
        whisker, friction_angle, plane, poisson_ratio, length=r, x=x, y=y, z=z
    )
    target = np.stack(point) / scenes.length / distance
    far = np.broadcast_to(np.asarray(round_back, dtype=bool), scenes.shape).reshape(-1)
    v, outcome = scenes.press(distance, target, far)
    # Where contact without friction would be stable, friction has stopped the sliding.
    ended = np.flatnonzero((outcome == Outcome.FLICKED_PAST) & (scenes.friction != 0))
    if ended.size:
        slick = replace(scenes.take(ended), friction=np.zeros(ended.size))
        in_contact = slick.press(distance[ended], target[:, ended], far[ended])[1] == Outcome.HELD
        outcome[ended[in_contact]] = Outcome.STUCK
    tolerance = 0.03 * tolerance  # towards the fold, errors of the pass grow in the signals
    base = scenes.resolve(v, tolerance)
    in_contact = outcome == Outcome.HELD
    for _ in range(6):
        off, _ = scenes.newton(v, distance * target, base.steps)
        v = np.where(in_contact, v + off, v)
        v[0] = np.minimum(v[0], 1.0)
        if (
            np.max(np.abs(off[:, in_contact]) / scenes.scale(distance)[:, in_contact], initial=0.0)
            < 1e-11
        ):
            break
    base = scenes.resolve(v, tolerance)
    error = np.full(distance.size, np.nan)
    at, base_path = scenes.take(np.flatnonzero(in_contact)), base.take(in_contact)
    error[in_contact] = base_path.signal_error(
        at.moved(v[:, in_contact], (distance * target)[:, in_contact], base_path)
    )
    return _result(scenes, v, base, outcome, error)


def _result(scenes: RodScenes, v: Array, base: Base, outcome: Codes, error: Array) -> RodBending:
    lost = outcome != Outcome.HELD
    contact = base.seen(base.lever)
    force, moment = np.split(base.signals(), 2)
    tangent = base.seen(np.stack([0 * v[0], 0 * v[0], 0 * v[0] + 1]))

    def vector(value: Any, unit: Array | float) -> Array:
        return np.where(lost, np.nan, value * unit).T.reshape(*scenes.shape, 3)

    def scalar(value: Any) -> Any:
        return np.where(lost, np.nan, value).reshape(scenes.shape)[()]

    return RodBending(
        vector(force, scenes.force),
        vector(moment, scenes.force * scenes.length),
        vector(contact, scenes.length),
        vector(tangent, 1.0),
        scalar(v[0] * scenes.length),
        scalar(np.hypot(v[1], v[2]) * scenes.force),
        scalar(np.arctan2(v[2], v[1])),
        member(Outcome, outcome.reshape(scenes.shape)),
        member(Model, np.full(scenes.shape, Model.ROD, dtype=np.int8)),
        scalar(error),
        scenes.whisker,
    )


# -- inside, in units of the whisker's length, base radius and base stiffness ----------------------


@dataclass(frozen=True, eq=False)
class Base:
    """The base as reached from the contact: directors and X in the contact's frame, (3, n)."""

    d1: Array
    d2: Array
    d3: Array
    lever: Array
    force: Array
    error: Array
    steps: int

    def take(self, index: Index | Flags) -> Base:
        """The rods at `index`."""
        arrays: dict[str, Any] = {k: v[..., index] for k, v in vars(self).items() if k != "steps"}
        return replace(self, **arrays)

    def seen(self, vector: Array) -> Array:
        """A vector of the contact's frame in the base frame, (3, n)."""
        return np.stack([(d * vector).sum(axis=0) for d in (self.d3, self.d1, self.d2)])

    def signals(self) -> Array:
        """Force and moment at the base, in its frame, (6, n)."""
        force = self.seen(self.force)
        return np.concatenate([force, np.cross(self.seen(self.lever), force, axis=0)])

    def signal_error(self, off: Array | float = 0.0) -> Array:
        """Bound on the relative error of the signals, from the pass and an absolute error `off`.

        The largest over axial force, transverse force, torsion and bending, each compared with no
        less than a thousandth of the force or moment.
        """
        now = np.abs(self.signals())
        force, moment = np.linalg.norm(now[:3], axis=0), np.linalg.norm(now[3:], axis=0)
        arm = np.linalg.norm(self.lever, axis=0)
        turned = np.concatenate([3 * [force], 3 * [moment + arm * force]])
        with np.errstate(all="ignore"):
            wrong = turned * (self.error + ROUNDING) + off
            errors = [
                np.hypot(wrong[k], wrong[m]) / np.maximum(np.hypot(now[k], now[m]), 1e-3 * whole)
                for k, m, whole in ((0, 0, force), (1, 2, force), (3, 3, moment), (4, 5, moment))
            ]
            error = np.max(errors, axis=0)
        # No load, no signals to be wrong.
        return np.asarray(np.minimum(np.where(force == 0, self.error, error), 1.0))


@dataclass(frozen=True, eq=False)
class RodScenes:
    """Rods and their friction and rolled planes, flat and in natural units."""

    beams: Beams
    shape: tuple[int, ...]
    length: Array
    force: Array
    friction: Array
    plane: Array
    twist: float
    whisker: Whisker

    @classmethod
    def of(
        cls,
        whisker: Whisker | Profile,
        friction_angle: ArrayLike,
        plane: ArrayLike,
        poisson_ratio: float,
        **contact: ArrayLike,
    ) -> tuple[RodScenes, list[Array]]:
        """The rods, and the arguments of their contacts as `Scenes.of` gives them."""
        tilt = friction(friction_angle)
        roll = finite("plane", plane, "give radians, 0 for the xy plane")
        if not -1 < poisson_ratio <= 0.5:
            raise Refusal(
                "poisson_ratio must be between -1 and 0.5", f"{poisson_ratio:g}", "write 0.38"
            )
        made = Scenes.of(whisker, friction_angle=tilt, plane=roll, **contact)
        psi, turn, *given = made.given
        flat = made.beams, made.shape, made.length, made.force, psi, turn
        return cls(*flat, 1 + poisson_ratio, made.whisker), given

    def take(self, index: Index) -> RodScenes:
        each = vars(self).items()
        arrays: dict[str, Any] = {k: v[index] for k, v in each if isinstance(v, np.ndarray)}
        return replace(self, beams=self.beams.take(index), shape=(index.size,), **arrays)

    def follow(self, v: Array, steps: int) -> Base:
        """The rods at v = (arc, force along d₁, along d₂), in `steps` steps a piece."""
        n = v.shape[1]
        size = np.hypot(v[1], v[2])
        cosine, sine = np.cos(self.friction), np.sin(self.friction)
        force = np.stack([v[1] * cosine, v[2] * cosine, -size * sine])
        tilt = -np.sin(self.plane), np.cos(self.plane)
        state = np.zeros((12, n))
        state[0] = state[4] = state[8] = 1.0
        slopes = np.zeros((STAGES, 12, n))
        error, bent = np.zeros(n), np.full(n, 1e-3)
        for piece in range(len(self.beams.arc) - 2, -1, -1):
            low, high = self.beams.arc[piece], np.minimum(self.beams.arc[piece + 1], v[0])
            if not np.any(high > low):
                continue
            path = Piece(self.beams, piece, low, np.maximum(high, low), steps)
            for step in range(steps):
                weight, give, curl = path.at(step)
                for i, share in enumerate(POINTS):
                    at = state + np.tensordot(share, slopes[:i], axes=1)
                    slopes[i] = self._slope(at, weight[i], give[i], curl[i], force, tilt)
                change, off = np.tensordot(ENDS, slopes, axes=1)
                state = state + change
                size = (off[:9] ** 2).sum(axis=0) + (off[9:] ** 2).sum(axis=0) / v[0] ** 2
                error += np.sqrt(size * np.sqrt(size))
                bent = np.maximum(bent, np.hypot(state[6], state[7]))
        lever = state[9:]
        bound = np.nan_to_num(CAUTION * error / np.sqrt(bent), nan=np.inf)
        return Base(state[:3], state[3:6], state[6:9], lever, force, bound, steps)

    def _slope(
        self,
        state: Array,
        weight: Array,
        give: Array,
        curl: Array | None,
        force: Array,
        tilt: tuple[Array, Array],
    ) -> Array:
        d1, d2, d3, x = state[:3], state[3:6], state[6:9], state[9:]
        m = x[_NEXT] * force[_LAST] - x[_LAST] * force[_NEXT]
        u1, u2, u3 = (give * (d * m).sum(axis=0) for d in (d1, d2, d3))
        u3 = u3 * self.twist
        if curl is not None:
            u1, u2 = u1 + curl * tilt[0], u2 + curl * tilt[1]
        return np.concatenate(
            [u2 * d3 - u3 * d2, u3 * d1 - u1 * d3, u1 * d2 - u2 * d1, weight * d3]
        )

    def resolve(self, v: Array, tolerance: float) -> Base:
        """`follow` with steps enough for every row, up to 128."""
        steps = 2 * pilot(self.beams)
        while True:
            with np.errstate(all="ignore"):
                base = self.follow(v, steps)
            worst = float(np.max(base.error, initial=0.0))
            if worst <= tolerance or steps >= 128:
                return base
            count = steps * 1.1 * min(worst / tolerance, 1e9) ** (1 / 8)
            steps = int(np.clip(np.ceil(count), steps + 2, 128))

    def scale(self, distance: Array) -> Array:
        """Sizes of v at which everything changes by its own order."""
        room = np.maximum(1 - distance * (1 - self.beams.radius[-1] / self.beams.radius[0]), 1e-4)
        stiff = 3 * room / distance**2
        return np.stack([distance, stiff, stiff])

    def newton(self, v: Array, target: Array, steps: int) -> tuple[Array, Array]:
        """Newton's step to a contact at `target`, (3, n), and the sign of its determinant."""
        miss, jacobian, _ = self._slopes(v, target, steps)
        with np.errstate(all="ignore"):
            det = np.linalg.det(jacobian)
            usable = np.isfinite(det) & (det != 0)
            jacobian[~usable] = np.eye(3)
            step = np.linalg.solve(jacobian, np.nan_to_num(miss.T)[..., None])[..., 0].T
        return np.where(usable, step, np.inf), np.where(usable, np.sign(det), 0.0)

    def _slopes(
        self, v: Array, target: Array, steps: int, nudge: float = 1e-6
    ) -> tuple[Array, Array, Array]:
        """How far the contact is from `target` (3, n); its slopes to v and those of the signals.

        The slopes are difference quotients, (n, 3, 3) and (n, 6, 3).
        """
        n = v.shape[1]
        scale = self.scale(np.sqrt((target**2).sum(axis=0)))
        h = nudge * scale
        # Friction has a cusp at zero force: steps stay well within the force.
        small = np.clip(1e-2 * np.hypot(v[1], v[2]) / scale[1], 1e-11, abs(nudge))
        h[1:] *= np.where(self.friction != 0, small / abs(nudge), 1.0)
        probes = np.concatenate([v, *(v - h * np.eye(3)[:, [k]] for k in range(3))], axis=1)
        with np.errstate(all="ignore"):
            base = self.take(np.tile(np.arange(n), 4)).follow(probes, steps)
            both = np.concatenate([base.seen(base.lever), base.signals()]).reshape(9, 4, n)
            slopes = np.nan_to_num((both[:, :1] - both[:, 1:]) / h).transpose(2, 0, 1)
        return target - both[:3, 0], slopes[:, :3], slopes[:, 3:]

    def onset(self, v: Array, distance: Array, pace: Array) -> Array:
        """Rate of v at rest with friction as the point moves at the rate `pace`, (3, n).

        The contact moves in proportion to the force f across the whisker, and by friction in
        proportion to |f|: slopes · v + cusp · |f| = pace, a quadratic in |f|. Zero where stuck.
        """
        there = distance * np.eye(3)[:, [0]]  # slopes do not depend on the target
        ahead, behind = (self._slopes(v, there, 2 * pilot(self.beams), h)[1] for h in (-1e-6, 1e-6))
        slopes, cusp = (ahead + behind) / 2, (ahead - behind)[:, :, 1].T / 2
        with np.errstate(all="ignore"):
            inverse = np.linalg.pinv(slopes)
            smooth, leaning = (np.einsum("nij,jn->in", inverse, w) for w in (pace, -cusp))
            a = 1 - (leaning[1:] ** 2).sum(axis=0)
            b = (smooth[1:] * leaning[1:]).sum(axis=0)
            size = (b + np.sqrt(b * b + a * (smooth[1:] ** 2).sum(axis=0))) / a
            return np.where(a > 0, np.nan_to_num(smooth + size * leaning), 0.0)

    def moved(self, v: Array, target: Array, base: Base) -> Array:
        """Bound on the errors of the signals (6, n) from the contacts' misses of `target`."""
        miss, places, signals = self._slopes(v, target, base.steps)
        slopes = np.nan_to_num(signals @ np.linalg.pinv(places))
        off = (base.error + ROUNDING) * np.linalg.norm(target, axis=0)
        off = off + np.linalg.norm(miss, axis=0)
        return np.asarray(np.linalg.norm(slopes, axis=2).T * off)

    def press(self, distance: Array, target: Array, round_back: Flags) -> tuple[Array, Codes]:
        """Equilibria by continuation along the great circle from rest to the unit `target`.

        Along the longer arc of the circle where `round_back`.
        """
        n = distance.size
        outcome = np.full(n, Outcome.OUT_OF_REACH, dtype=np.int8)
        start, _ = zero_load(self.beams, distance)
        v = np.stack([np.nan_to_num(start, nan=0.5), np.zeros(n), np.zeros(n)])
        good = np.isfinite(start) & on_whisker(self.beams, np.nan_to_num(start, nan=2.0))
        outcome[good] = Outcome.FLICKED_PAST
        x, y = self.beams.law.point(v[0]) if self.beams.law else (v[0], np.zeros(n))
        r = np.hypot(x, y)
        rest = np.stack([x, y * np.cos(self.plane), y * np.sin(self.plane)]) / r
        across = target - rest * (rest * target).sum(axis=0)
        size = np.sqrt((across**2).sum(axis=0))
        across = across / np.maximum(size, 1e-300)
        whole = np.arctan2(size, (rest * target).sum(axis=0))
        across = np.where(round_back, -across, across)
        whole = np.where(round_back, 2 * np.pi - whole, whole)
        done, stride, last = np.zeros(n), np.full(n, 0.2), np.zeros((3, n))
        rubbed = np.flatnonzero(good & (self.friction != 0))
        if rubbed.size:
            pace = distance[rubbed] * across[:, rubbed]
            last[:, rubbed] = self.take(rubbed).onset(v[:, rubbed], distance[rubbed], pace)
        sign = np.zeros(n)
        active = np.flatnonzero(good)
        for _ in range(500):
            if not active.size:
                break
            part = self.take(active)
            scale = part.scale(distance[active])
            step = np.minimum(stride[active], whole[active] - done[active])
            angle = done[active] + step
            goal = distance[active] * (
                rest[:, active] * np.cos(angle) + across[:, active] * np.sin(angle)
            )
            guess = v[:, active] + last[:, active] * step
            here = guess.copy()
            wide = 1e3 * scale
            for _ in range(4):
                move, det = part.newton(here, goal, 2 * pilot(self.beams))
                here = np.clip(here + np.nan_to_num(move, posinf=np.inf), -wide, wide)
                # No further than the tip, where an arc has slopes on this side only.
                beyond = here[0] - 1
                here[0] = np.clip(here[0], 0.5 * distance[active], 1.0)
            ok = np.max(np.abs(move) / scale, axis=0) < 1e-6
            ok &= (det == sign[active]) | (sign[active] == 0)
            ok &= np.max(np.abs(here - guess) / scale, axis=0) < 0.15
            ok &= beyond < 1e-9  # rounding of Newton's method on difference quotients
            rate = (here - v[:, active]) / np.maximum(step, 1e-300)
            v[:, active] = np.where(ok, here, v[:, active])
            last[:, active] = np.where(ok, rate, last[:, active])
            sign[active] = np.where(ok & (sign[active] == 0), det, sign[active])
            done[active] = np.where(ok, angle, done[active])
            stride[active] = np.where(ok, np.minimum(1.5 * stride[active], 0.3), step / 2)
            finished = ok & (whole[active] - done[active] <= 1e-14)
            dead = ~ok & (step < 1e-6)
            outcome[active[finished]] = Outcome.HELD
            outcome[active[dead & (v[0, active] > 1 - 1e-4)]] = Outcome.SLIPPED_OFF_TIP
            active = active[~(finished | dead)]
        return v, outcome
