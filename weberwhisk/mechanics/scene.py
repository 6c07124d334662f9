"""One scene, any model: what each model makes of the same whisker pressed against the same point.

A scene is a whisker, the radial distance and deflection angle of the contact, a friction angle,
and a *roll*: the angle about the base tangent between the plane in which the whisker is pushed
(xy) and the plane of its intrinsic curvature. The point lies as high above the xy plane as the
resting whisker does where it reaches that distance, so that the push begins at first touch; the
deflection angle is the azimuth of the point.

Each model sees of it what it can model:

- closed form and elastica a straight taper, deflected by the *push*: the deflection angle less the
  angle of the resting whisker;
- the planar beam the whisker's projection on the xy plane: curvature times cos(roll), the same
  push;
- the rod everything.

In units of the whisker's length, base radius and base stiffness; signals are M_z, −F_x, F_y.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .._util.values import Array, Codes, Index
from ..whisker import Whisker
from . import closed_form, elastica, rod
from .beam import Rows
from .contact import Bending, Model, Outcome
from .continuation import zero_load
from .equilibrium import Scenes, Solved, by_rows, friction, press_rows
from .shape import Profile, Spiral


@dataclass(frozen=True, eq=False)
class SceneRows:
    """n scenes, each array (n,).

    ``start`` is the arc at which the resting whisker is touched, ``push`` the deflection from
    there, both NaN beyond its reach; ``height`` is the elevation of the point, an angle at the
    base.
    """

    rows: Rows
    distance: Array
    angle: Array
    friction: Array
    roll: Array
    start: Array
    push: Array
    height: Array

    @classmethod
    def of(cls, rows: Rows, r: Array, theta: Array, psi: Array, roll: Array) -> SceneRows:
        """The scenes and their pushes."""
        start, rest = zero_load(rows, r)
        azimuth = np.arctan2(np.sin(rest) * np.cos(roll), np.cos(rest))
        height = np.arcsin(np.sin(rest) * np.sin(roll))
        return cls(rows, r, theta, psi, roll, start, theta - azimuth, height)

    def take(self, index: Index) -> SceneRows:
        """The scenes at `index`."""
        rest = (value[index] for name, value in vars(self).items() if name != "rows")
        return SceneRows(self.rows.take(index), *rest)

    @property
    def taper(self) -> Array:
        """1 − 1/R of the straight whisker that models 0 and 1 see."""
        return np.clip(1 - self.rows.radius[-1] / self.rows.radius[0], 0.0, 1.0)

    def top(self) -> Codes:
        """The lowest model that models all there is in each scene."""
        plain = self.rows.core is None and len(self.rows.arc) == 2
        model = np.where((self.friction != 0) | (not plain), Model.PROFILE, Model.ELASTICA)
        if self.rows.law is not None:
            curved = np.any([value != 0 for value in vars(self.rows.law).values()], axis=0)
            model = np.where(curved, Model.PROFILE, model)
            model = np.where(curved & (np.sin(self.roll) != 0), Model.ROD, model)
        return model.astype(np.int8)

    def planar(self) -> tuple[Rows, Array]:
        """The whiskers as projected on the plane of the push, and the deflection angles there."""
        if not np.any(self.roll):
            return self.rows, self.angle
        rows = self.rows.mirrored(np.cos(self.roll))
        return rows, zero_load(rows, self.distance)[1] + self.push

    def point(self) -> Array:
        """The points (n, 3); those out of reach have no height, and need none to be so."""
        height = np.nan_to_num(self.height)
        flat = np.cos(height)
        return np.asarray(
            self.distance
            * np.stack([flat * np.cos(self.angle), flat * np.sin(self.angle), np.sin(height)])
        ).T

    def profile(self) -> Profile:
        """The whiskers as a `Profile` of unit length, base radius and base stiffness."""
        rows = self.rows
        core = np.zeros_like(rows.radius) if rows.core is None else rows.core
        whisker = Whisker(1.0, 1.0, np.minimum(rows.radius[-1], 1.0), 4 / np.pi)
        return Profile(whisker, rows.arc, rows.radius, core, rows.law or Spiral())


def press_by(
    whisker: Whisker | Profile, r: ArrayLike, theta: ArrayLike, psi: ArrayLike, roll: ArrayLike,
    model: Model | Codes, tolerance: float = 1e-9,
) -> Bending:  # fmt: skip
    """Press each whisker by the model named for its scene; arguments as for `ladder.press`.

    `tolerance` is that of solving the equations of the planar beam.
    """

    def solve(rows: Rows, r: Array, theta: Array, psi: Array, turn: Array, model: Array) -> Solved:
        return press(SceneRows.of(rows, r, theta, psi, turn), model.astype(np.int8), tolerance)

    b = by_rows(solve, whisker, length=r, angle=theta, tilt=friction(psi), roll=roll, model=model)
    used: Any = np.broadcast_to(np.asarray(model, dtype=np.int8), np.shape(b.moment))
    return replace(b, model=used if used.ndim else Model(int(used)))


def press_in_space(
    whisker: Whisker | Profile, r: ArrayLike, theta: ArrayLike, psi: ArrayLike, roll: ArrayLike
) -> Bending:
    """The rod as a `Bending`; arguments as for `ladder.press`."""
    return press_by(whisker, r, theta, psi, roll, Model.ROD)


def jacobian_in_space(
    whisker: Whisker | Profile, r: ArrayLike, theta: ArrayLike, psi: ArrayLike, roll: ArrayLike
) -> Array:
    """The rod's derivatives of (M_z, −F_x, F_y) to (r, θ_d); arguments as for `ladder.press`.

    Differences of fourth order, good to 1e-7; NaN within 1e-3 of where the contact ends.
    """
    shape = Scenes.of(whisker, length=r, angle=theta, tilt=friction(psi), roll=roll).shape
    r, theta = (np.broadcast_to(np.asarray(a, dtype=float), shape) for a in (r, theta))
    step = 5e-4 * np.stack([r, np.ones_like(r)])
    at = np.array([1, -1, 2, -2]).reshape(-1, *(1,) * r.ndim)
    columns = []
    for dr, dt in ((step[0], 0.0), (0.0, step[1])):
        bent = press_in_space(whisker, r + at * dr, theta + at * dt, psi, roll)
        one, other, far, further = np.stack(
            [bent.moment, bent.axial_force, bent.transverse_force], axis=-1
        )
        slope = (8 * (one - other) - (far - further)) / 12
        columns.append(slope / np.asarray(dr + dt)[..., None])
    return np.stack(columns, axis=-1)


def press(scene: SceneRows, model: Codes, tolerance: float) -> Solved:
    """The eight numbers of a `Bending`, outcome and error, each scene by the model named."""
    n = scene.distance.size
    numbers, error = np.full((8, n), np.nan), np.full(n, np.nan)
    outcome = np.full(n, Outcome.OUT_OF_REACH, dtype=np.int8)
    for step in np.unique(model):
        which = np.flatnonzero(model == step)
        part = scene.take(which)
        if step <= Model.ELASTICA:
            solved = straight(part, step)
        else:
            solved = _spatial(part) if step == Model.ROD else planar(part, tolerance)
        numbers[:, which], outcome[which], error[which] = solved
    numbers[3], numbers[4] = scene.distance, scene.angle  # as given
    return numbers, outcome, error


def straight(scene: SceneRows, model: Model) -> Solved:
    """By the closed form or by the elastica."""
    solve = closed_form._press if model == Model.CLOSED_FORM else elastica._press
    unit, lost = np.ones_like(scene.distance), np.isnan(scene.push)
    push = np.where(lost, 0.0, scene.push)
    numbers, outcome, error = solve(unit, scene.taper, unit, scene.distance, push)
    numbers[:, lost], error[lost] = np.nan, np.nan
    return numbers, np.where(lost, Outcome.OUT_OF_REACH, outcome).astype(np.int8), error


def planar(scene: SceneRows, tolerance: float) -> Solved:
    rows, angle = scene.planar()
    angle = np.nan_to_num(angle)  # out of reach either way
    return press_rows(rows, scene.distance, angle, scene.friction, tolerance)


def _spatial(scene: SceneRows) -> Solved:
    # A point alone does not tell half a turn and more from what is left to a whole one.
    back = np.abs(scene.push) > np.pi
    place, roll = scene.point(), scene.roll
    b = rod.press(scene.profile(), place, scene.friction, plane=roll, round_back=back)
    side = np.where(scene.push < 0, -1.0, 1.0)
    # The tangent is within half a turn of the line to the contact, on whichever turn that is.
    slant = np.arctan2(b.tangent[:, 1], b.tangent[:, 0]) - scene.angle
    slant = (slant + np.pi) % (2 * np.pi) - np.pi
    numbers = np.stack(
        [
            b.moment[:, 2],
            b.axial_force,
            b.force[:, 1],
            scene.distance,
            scene.angle,
            scene.angle + slant,
            b.arc_length,
            side * b.magnitude,
        ]
    )
    return numbers, np.asarray(b.outcome, dtype=np.int8), b.error
