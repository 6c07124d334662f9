"""The equilibrium of a contact given in space: Newton's method, proved stable, else a walk.

The inner half of rung 2, in units of the whisker's length, base radius and base stiffness.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from . import elastica
from .branch import REACHED, TIP, Branch, walk, zero_load
from .chebyshev import Array
from .contact import TIP_ROUNDING, Outcome
from .trajectory import Path, Rows, follow_blocks, pilot, resolve

Solved = tuple[Array, NDArray[np.int8], Array]


def press_rows(rows: Rows, r: Array, theta: Array, psi: Array, tolerance: float) -> Solved:
    n = r.size
    numbers, error = np.full((8, n), np.nan), np.full(n, np.nan)
    outcome = np.full(n, Outcome.OUT_OF_REACH, dtype=np.int8)
    start, rest = zero_load(rows, r)
    good = np.flatnonzero(np.isfinite(start) & on_whisker(rows, start))
    if not good.size:
        return numbers, outcome, error
    sign = np.where(theta < rest, -1.0, 1.0)[good]
    part = rows.take(good).mirrored(sign)
    distance, angle, psi_, start, rest = (
        r[good],
        theta[good] * sign,
        psi[good],
        start[good],
        (rest[good] * sign),
    )
    s, f, path, found = _newton(part, distance, angle, psi_, start, angle - rest, tolerance)
    values = numbers_of(path.angle, path.lever, path.along, s, f, psi_, sign)
    error[good] = path.error
    outcome[good] = Outcome.HELD

    hard = np.flatnonzero(~found)
    if hard.size:
        branch = Branch.of(part.take(hard), distance[hard], psi_[hard], start[hard], tolerance)
        ended = walk(branch, angle[hard])
        values[:, hard], error[good[hard]] = at_points(branch, ended.point, sign[hard])
        outcome[good[hard]] = np.select(
            [ended.end == REACHED, ended.end == TIP],
            [Outcome.HELD, Outcome.SLIPPED_OFF_TIP],
            Outcome.FLICKED_PAST,
        )
    held = outcome[good] == Outcome.HELD
    numbers[:, good] = np.where(held, values, np.nan)
    error[good] = np.where(held, error[good], np.nan)
    numbers[3], numbers[4] = r, theta  # as given
    return numbers, outcome, error


def _newton(
    rows: Rows, r: Array, theta: Array, psi: Array, start: Array, push: Array, tolerance: float
) -> tuple[Array, Array, Path, NDArray[np.bool_]]:
    """Arc, force and pass at (r, θ); True where they are found and proved stable."""
    v = np.clip(r * (1 - rows.radius[-1] / rows.radius[0]), 0.0, 0.999)
    f, s = _straight(v, push, r)
    s = np.minimum(s / r * start, 1.0)
    compliance = r**2 / (3 * (1 - v))
    if rows.law is not None or rows.core is not None or len(rows.arc) > 2 or np.any(psi != 0):
        path = follow_blocks(rows, start, np.zeros_like(r), psi, pilot(rows))
        r_s, r_f, t_s, t_f = path.jacobian()
        true = np.maximum(t_f - t_s * r_f / r_s, 1e-3 * compliance)
        f = f * compliance / true
        compliance = true

    floor = 1e-6 / compliance
    active = np.arange(r.size)
    size = np.full(r.size, np.inf)
    paths: Path | None = None
    enough = 1e-2 * np.sqrt(tolerance)
    fine = np.zeros(r.size, dtype=bool)
    for _ in range(12):
        new = np.zeros((2, active.size))
        for exact in (False, True):
            which = np.flatnonzero(fine[active] == exact)
            if not which.size:
                continue
            at = active[which]
            part = rows.take(at) if at.size < r.size else rows
            with np.errstate(all="ignore"):
                if exact:
                    path = resolve(part, s[at], f[at], psi[at], tolerance)
                else:
                    path = follow_blocks(part, s[at], f[at], psi[at], pilot(rows))
                r_s, r_f, t_s, t_f = path.jacobian()
                d = r_s * t_f - r_f * t_s
                miss_r, miss_t = r[at] - path.distance, theta[at] - path.deflection
                ds = (miss_r * t_f - miss_t * r_f) / d
                df = (miss_t * r_s - miss_r * t_s) / d
                ds = np.clip(np.nan_to_num(ds), -0.2 * r[at], 0.2 * r[at])
                df = np.clip(np.nan_to_num(df), -0.5 * f[at] - floor[at], f[at] + floor[at])
                ds = np.minimum(ds, 1.0 - s[at])
            size[at] = np.maximum(np.abs(ds) / r[at], np.abs(df) / (f[at] + floor[at]))
            s[at] += ds
            f[at] += df
            path.angle[:] += path.d_arc[0] * ds + path.d_force[0] * df
            path.lever[:] += path.d_arc[1] * ds + path.d_force[1] * df
            path.along[:] += path.d_arc[2] * ds + path.d_force[2] * df
            if paths is None:
                paths = path
            else:
                for name, value in vars(path).items():
                    getattr(paths, name)[..., at] = value
            if not exact:
                # A pilot that is good enough, or a start close enough for the fine pass.
                fine[at] = (size[at] < 3e-3) & (path.error > tolerance)
                size[at[fine[at]]] = np.inf
        del new
        active = active[size[active] > enough]
        if not active.size:
            break
    assert paths is not None
    found = (size <= enough) & (paths.flips == 0) & (paths.error <= tolerance) & (f > -floor)
    with np.errstate(invalid="ignore"):
        found &= np.abs(paths.distance - r) <= 1e-3 * enough * r + 10 * tolerance * r
        found &= np.abs(paths.deflection - theta) <= 1e-3 * enough + 10 * tolerance
    return s, f, paths, found


def at_points(branch: Branch, v: Array, sign: Array) -> tuple[Array, Array]:
    """The eight numbers and the error at points of branches."""
    path = branch.path(v, branch.tolerance)
    arc, force = branch.contact(v)
    return (
        numbers_of(path.angle, path.lever, path.along, arc, force, branch.friction, sign),
        path.error,
    )


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


def on_whisker(rows: Rows, arc: Array) -> NDArray[np.bool_]:
    """On the whisker, and not at a tip of no width, which has no stiffness to push back."""
    return (arc <= 1 + TIP_ROUNDING) & ~((arc >= 1 - TIP_ROUNDING) & (rows.radius[-1] <= 0))


def _straight(v: Array, push: Array, r: Array) -> tuple[Array, Array]:
    """Force and arc of the straight taper (rung 1) at this push, or close to its fold."""
    table = elastica._map()
    fold = table.fold_angle(v)
    theta = np.minimum(push, 0.95 * fold)
    c = np.sqrt(1 - (theta / fold) ** 2)
    force, _, arc = elastica._contact(table.contact_given, v, c, np.ones_like(v), r, theta)
    return force, arc
