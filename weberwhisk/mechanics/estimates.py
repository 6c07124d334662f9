"""How far each model is off at a scene, from the first Newton step of the model above it.

A model's contact arc and force, put into the next model's equations, miss the point that the
whisker is pressed against. One Newton step on that miss gives the next model's signals up to the
square of the step, for a pass or two in the place of a solution. The elastica checks the closed
form (both are formulas); one pass of the planar beam at the elastica's contact checks both for
curvature, stiffness profile and friction; two steps of the rod at the planar beam's contact check
all of them for what is out of the plane. Where a step is large, or leaves the stable branch or the
whisker, it vouches for nothing, and the scene is left to the model above; the square of a smaller
one is added to the errors, as what it may have missed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from . import elastica
from .chebyshev import Array
from .contact import Model, Outcome
from .cosserat import POISSON_RATIO
from .cosserat import Scenes as Rods
from .equilibrium import numbers_of, signal_slopes
from .scene import Scene, _closed_form, _elastica, _planar
from .trajectory import follow_blocks

#: Largest relative Newton step that is believed.
LARGEST_STEP = 0.2
#: What a step may be wrong by, in times its square.
DOUBT = 2.0
#: Below this push, rad, signals are proportional to it, so that their relative errors stay.
LEAST_PUSH = 1e-6
#: Runge–Kutta steps a piece, and the largest error bound of such a pass that is believed; the
#: bound exceeds the error by far.
STEPS, RESOLVED = 5, 1e-4
#: Accuracy of the planar beam solution that the rod steps from.
COARSE = 1e-9


@dataclass(frozen=True, eq=False)
class Estimates:
    """Of n scenes.

    ``top`` is the lowest model that models all there is in the scene; ``signals`` (3, n) and
    ``slopes`` (3, 2, n), their derivatives to (r, θ_d), are that model's as far as the first step
    tells. ``misses`` (4, 3, n) are the errors of each model's signals, infinite where the step does
    not vouch for that model and zero from the top on.
    """

    top: NDArray[np.int8]
    signals: Array
    slopes: Array
    misses: Array


def estimate(scene: Scene) -> Estimates:
    """The estimates at n scenes, in natural units."""
    top = scene.top()
    nudge = np.where(scene.push < 0, -LEAST_PUSH, LEAST_PUSH)
    push = np.where(np.abs(scene.push) < LEAST_PUSH, nudge, scene.push)
    scene = replace(scene, push=push, angle=scene.angle + push - scene.push)

    numbers, outcome, _ = _elastica(scene)
    small, straight = _closed_form(scene)[0][:3], numbers[:3]
    planar, true = straight.copy(), straight.copy()
    unit = np.ones_like(push)
    slopes = np.moveaxis(
        elastica._signal_jacobian(unit, scene.taper, unit, scene.distance, np.nan_to_num(push)),
        0,
        -1,
    )
    held, moved = outcome == Outcome.HELD, np.zeros(push.size)
    flat = np.flatnonzero((top == Model.PROFILE) & held)
    if flat.size:
        part, contact = scene.take(flat), numbers[6:, flat]
        contact[0] *= part.start / part.distance
        true[:, flat], slopes[..., flat], held[flat], moved[flat] = _planar_step(part, contact)
    vouched = np.stack([held, held, np.ones_like(held)])

    high = np.flatnonzero(top == Model.ROD)
    if high.size:
        part = scene.take(high)
        numbers, outcome, _ = _planar(part, COARSE)
        planar[:, high] = numbers[:3]
        vouched[2, high] = outcome == Outcome.HELD
        high, part, contact = _where(outcome == Outcome.HELD, high, part, numbers[6:])
    if high.size:
        _, slopes[..., high], *_ = _planar_step(part, contact)
        true[:, high], good = _spatial_step(part, contact)
        vouched[2, high] = good
    vouched[:2] &= vouched[2]

    misses = np.zeros((4, 3, push.size))
    for model, signals in enumerate((small, straight, planar)):
        miss = np.where(vouched[model], signals - true, np.inf)
        if model < Model.PROFILE:  # what one step leaves is of the order of its square
            miss = miss + np.copysign(DOUBT * moved**2 * true, miss)
        misses[model] = np.where(model < top, miss, 0.0)
    return Estimates(top, true, slopes, misses)


def _where(
    mask: NDArray[np.bool_], index: NDArray[np.intp], scene: Scene, numbers: Array
) -> tuple[NDArray[np.intp], Scene, Array]:
    return index[mask], scene.take(np.flatnonzero(mask)), numbers[:, mask]


def _planar_step(scene: Scene, contact: Array) -> tuple[Array, Array, NDArray[np.bool_], Array]:
    """Signals and slopes of the planar beam one Newton step from a contact (arc, force).

    And how large the step was: of the moment, of the contact and of the whisker that is left.
    """
    rows, angle = scene.planar()
    sign = np.where(scene.push < 0, -1.0, 1.0)
    r, angle = scene.distance, angle * sign
    s, f = np.minimum(contact[0], 1.0), np.abs(contact[1])
    with np.errstate(all="ignore"):
        path = follow_blocks(rows.mirrored(sign), s, f, scene.friction, STEPS)
        slopes = signal_slopes(path, f, sign)
        r_s, r_f, t_s, t_f = path.jacobian()
        miss_r, miss_t = r - path.distance, angle - path.deflection
        determinant = r_s * t_f - r_f * t_s
        ds = (miss_r * t_f - miss_t * r_f) / determinant
        df = (miss_t * r_s - miss_r * t_s) / determinant
        size = np.maximum(np.abs(ds) / r, np.abs(df) / f)
    good = (size < LARGEST_STEP) & (path.flips == 0) & (s + ds <= 1) & (path.error < RESOLVED)
    ds, df = np.where(good, ds, 0.0), np.where(good, df, 0.0)
    start = numbers_of(path.angle, path.lever, path.along, s, f, scene.friction, sign)
    beta, lever, along = (
        value + path.d_arc[k] * ds + path.d_force[k] * df
        for k, value in enumerate((path.angle, path.lever, path.along))
    )
    numbers = numbers_of(beta, lever, along, s + ds, f + df, scene.friction, sign)
    with np.errstate(all="ignore"):
        moved = np.maximum(np.abs(numbers[0] / start[0] - 1), size)
        # Next to the tip stiffness changes over what is left of the whisker.
        size = np.maximum(moved, np.abs(ds) / (1 - s))
    good &= moved < LARGEST_STEP
    return numbers[:3], slopes, good, np.where(good, size, 0.0)


def _spatial_step(scene: Scene, contact: Array) -> tuple[Array, NDArray[np.bool_]]:
    """The rod's signals two Newton steps from a planar contact, and their vouching."""
    rods = Rods.of(scene.profile(), (scene.distance,), scene.friction, scene.roll, POISSON_RATIO)
    v = np.stack([np.minimum(contact[0], 1.0), contact[1], np.zeros_like(contact[1])])
    point, good = scene.point().T, np.ones(v.shape[1], dtype=bool)
    scale = np.stack([scene.distance, np.abs(v[1]), np.abs(v[1])])
    for _ in range(2):
        step = rods.newton(v, point, STEPS)
        good &= np.max(np.abs(step) / scale, axis=0) < LARGEST_STEP
        v = v + np.where(good, step, 0.0)
    good &= v[0] <= 1
    base = rods.follow(v, STEPS)
    force, lever = base.seen(base.force), base.seen(base.lever)
    moment = lever[0] * force[1] - lever[1] * force[0]
    return np.stack([moment, -force[0], force[1]]), good & (base.error < RESOLVED)
