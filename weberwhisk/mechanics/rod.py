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
from numpy.typing import ArrayLike, NDArray

from .._checks import finite, positive
from ..whisker import Whisker
from .chebyshev import Array
from .contact import TOLERANCE, Model, Outcome
from .cosserat import POISSON_RATIO, Base, RodScenes
from .equilibrium import on_whisker
from .shape import Profile

_METRES = "give metres, such as 35e-3"


@dataclass(frozen=True, eq=False)
class RodBending:
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
    outcome: Outcome | NDArray[np.int8]
    model: Model | NDArray[np.int8]
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
    and 0.5. Stability is not judged when the force is given: `HELD` means in balance,
    `FLICKED_PAST` marks loads that wind the rod up past resolving.

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
    scenes = RodScenes.of(whisker, (s, size, turn), friction_angle, plane, poisson_ratio)
    f = scenes.flat(size) / scenes.force
    chi = scenes.flat(turn)
    v = np.stack([scenes.flat(s) / scenes.length, f * np.cos(chi), f * np.sin(chi)])
    good = on_whisker(scenes.rows, v[0])
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

    The point is moved on its sphere about the base, along the great circle from where the resting
    whisker meets that sphere, and the equilibrium followed for as long as it is stable, in all
    directions: a whisker may leave its plane, sideways past the point, where a model of the plane
    alone would have it held. `round_back` says that the point got there by the longer arc of that
    circle, having been pushed by more than half a turn. The other arguments are those of `bend`,
    the outcomes those of `profile.press`.

    Examples
    --------
    >>> w = Whisker(50e-3, 100e-6, 5e-6, 3e9, curvature=-8.0)
    >>> b = press(w, [30e-3, 2e-3, 4e-3])
    >>> b.outcome.name, b.moment.shape
    ('HELD', (3,))
    """
    place = finite("point", point, "give (x, y, z) in metres")
    if place.ndim < 1 or place.shape[-1] != 3:
        raise ValueError(
            f"point must have three components, got shape {place.shape}; give (x, y, z) in metres."
        )
    r = positive("the point's distance", np.sqrt((place**2).sum(-1)), _METRES)
    scenes = RodScenes.of(whisker, (r,), friction_angle, plane, poisson_ratio)
    distance = scenes.flat(r) / scenes.length
    target = np.stack([scenes.flat(place[..., k]) / scenes.length for k in range(3)]) / distance
    far = np.broadcast_to(np.asarray(round_back, dtype=bool), scenes.shape).reshape(-1)
    v, outcome = scenes.press(distance, target, far)
    # Where no sliding contact gets, one without friction may hold: then friction holds it.
    ended = np.flatnonzero((outcome == Outcome.FLICKED_PAST) & (scenes.friction != 0))
    if ended.size:
        slick = replace(scenes.take(ended), friction=np.zeros(ended.size))
        held = slick.press(distance[ended], target[:, ended], far[ended])[1] == Outcome.HELD
        outcome[ended[held]] = Outcome.STUCK
    tolerance = 0.03 * tolerance  # towards the fold errors of the pass grow in the signals
    base = scenes.resolve(v, tolerance)
    held = outcome == Outcome.HELD
    for _ in range(6):
        off = scenes.newton(v, distance * target, base.steps)
        v = np.where(held, v + off, v)
        v[0] = np.minimum(v[0], 1.0)
        if np.max(np.abs(off[:, held]) / scenes.scale(distance)[:, held], initial=0.0) < 1e-11:
            break
    base = scenes.resolve(v, tolerance)
    held = outcome == Outcome.HELD
    error = np.full(distance.size, np.nan)
    at, found = scenes.take(np.flatnonzero(held)), base.take(held)
    error[held] = found.signal_error(at.moved(v[:, held], (distance * target)[:, held], found))
    return _result(scenes, v, base, outcome, error)


def _result(
    scenes: RodScenes, v: Array, base: Base, outcome: NDArray[np.int8], error: Array
) -> RodBending:
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
        outcome.reshape(scenes.shape) if scenes.shape else Outcome(int(outcome[0])),
        np.full(scenes.shape, Model.ROD, dtype=np.int8) if scenes.shape else Model.ROD,
        scalar(error),
        scenes.whisker,
    )
