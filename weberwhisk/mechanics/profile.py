"""The planar beam: any whisker, curved or cut or hollow, with Coulomb friction.

The whisker is followed from the contact to the base (`beam`): bending by a given force needs no
root. Pressing against a point solves for contact arc and force by Newton's method. A solution is
accepted where the pass shows it to be stable; the other contacts are followed along their branches
from zero load (`branches`), up to a fold or the tip.

Signs: a positive force pushes the whisker towards +y, and positive curvature bends it that way at
rest: contact is on the convex side where force and curvature have the same sign, on the concave
side otherwise. A positive friction angle tilts the force from the normal towards the base, as where
the whisker slides outwards over the object while it unloads; it is negative where the whisker
slides inwards while pressed harder. This sign does not depend on the side.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from .._util.checks import positive
from .._util.values import Array, member
from ..whisker import Whisker
from .beam import Beams, resolve, zero_load
from .branches import Branches, extended, walk
from .contact import TOLERANCE, Bending, FlickPast, Outcome
from .equilibrium import (
    Scenes,
    Solved,
    at_points,
    by_rows,
    in_order,
    numbers_of,
    on_whisker,
    press_beams,
    signal_error,
    signal_slopes,
)
from .shape import Profile

__all__ = ["bend", "flick_past", "press", "rest_angle", "signal_jacobian"]


def bend(
    whisker: Whisker | Profile,
    arc_length: ArrayLike,
    force: ArrayLike,
    friction_angle: ArrayLike = 0.0,
    *,
    tolerance: float = TOLERANCE,
) -> Bending:
    """Bend any whisker by a force (N) at an arc length (m), as `weberwhisk.bend` does.

    `friction_angle` (rad, between −π/2 and π/2) is the angle by which friction tilts the force from
    the normal towards the base, `tolerance` the largest relative error. `PAST_FOLD`: in balance at
    this force, but an object fixed in space would have been flicked past. `FLICKED_PAST`: a load
    beyond that, or one that is not resolved.

    Examples
    --------
    >>> w = Whisker(50e-3, 100e-6, 5e-6, 3e9, curvature=-8.0)
    >>> b = bend(w, arc_length=30e-3, force=5e-5, friction_angle=np.radians(10))
    >>> print(f"{b.moment:.6e} N m at {np.degrees(b.deflection_angle):.4f} degrees")
    1.461915e-06 N m at 1.4289 degrees
    """

    def solve(beams: Beams, s: Array, f: Array, psi: Array) -> Solved:
        n = s.size
        sign = np.where(f < 0, -1.0, 1.0)
        numbers, error = np.full((8, n), np.nan), np.full(n, np.nan)
        outcome = np.full(n, Outcome.OUT_OF_REACH, dtype=np.int8)
        good = in_order(beams, s, on_whisker(beams, s))
        s, f, psi, sign = np.minimum(s[good], 1.0), np.abs(f[good]), psi[good], sign[good]
        path = resolve(beams.take(good).mirrored(sign), s, f, psi, tolerance)
        outcome[good] = np.select(
            [~(path.error <= np.maximum(tolerance, 1e-4)) | (path.flips > 1), path.flips == 1],
            [Outcome.FLICKED_PAST, Outcome.PAST_FOLD],
            Outcome.HELD,
        )
        in_contact = outcome[good] != Outcome.FLICKED_PAST
        values = numbers_of(path.angle, path.lever, path.along, s, f, psi, sign)
        numbers[:, good] = np.where(in_contact, values, np.nan)
        error[good] = np.where(in_contact, signal_error(path, f, given_contact=False), np.nan)
        return numbers, outcome, error

    return by_rows(solve, whisker, length=arc_length, force=force, angle=friction_angle)


def press(
    whisker: Whisker | Profile,
    radial_distance: ArrayLike,
    deflection_angle: ArrayLike,
    friction_angle: ArrayLike = 0.0,
    *,
    tolerance: float = TOLERANCE,
) -> Bending:
    """Press any whisker against a point (m, rad), as `weberwhisk.press` does.

    All motion is in the plane: `rod.press` says whether the whisker would slip out of it. The sign
    of the force is that of `deflection_angle` less `rest_angle`. `STUCK`: no contact that slides at
    this friction angle is in balance, although one without friction is, or friction never lets the
    contact slide.

    ``error`` estimates the relative error of the signals from above: it exceeds the true error in
    99.7 % of scenes and by a factor of 11 in the median. The true error is below `tolerance` except
    towards the fold, where signals vary as the square root of the angle left, and towards zero
    load. There it grows without bound, and `error` with it.

    Examples
    --------
    >>> w = Whisker(50e-3, 100e-6, 5e-6, 3e9, curvature=8.0)
    >>> b = press(w, radial_distance=30e-3, deflection_angle=np.radians([-5, 10, 60]))
    >>> b.outcome
    array([0, 0, 2], dtype=int8)
    """
    solve = partial(press_beams, tolerance=tolerance)
    return by_rows(
        solve, whisker, length=radial_distance, angle=deflection_angle, tilt=friction_angle
    )


def signal_jacobian(
    whisker: Whisker | Profile,
    radial_distance: ArrayLike,
    deflection_angle: ArrayLike,
    friction_angle: ArrayLike = 0.0,
    *,
    tolerance: float = TOLERANCE,
) -> Array:
    """Derivatives (..., 3, 2) of the base signals, as `mechanics.signal_jacobian` returns.

    At a fixed friction angle, from derivatives with respect to contact arc and force.

    Examples
    --------
    >>> w = Whisker(50e-3, 100e-6, 5e-6, 3e9, curvature=8.0)
    >>> slope = signal_jacobian(w, radial_distance=30e-3, deflection_angle=np.radians(10))
    >>> print(f"dM/dr = {slope[0, 0]:.4e} N")
    dM/dr = -8.1500e-05 N
    """
    scenes = Scenes.of(whisker, length=radial_distance, angle=deflection_angle, tilt=friction_angle)
    out = np.full((3, 2, scenes.length.size), np.nan)
    for part, beams, (r, theta, psi) in scenes.pieces():
        numbers, outcome, _ = press_beams(beams, r, theta, psi, tolerance)
        in_contact = np.flatnonzero(outcome == Outcome.HELD)
        _, rest = zero_load(beams.take(in_contact), r[in_contact])
        sign = np.where(theta[in_contact] < rest, -1.0, 1.0)
        s, f = numbers[6, in_contact], numbers[7, in_contact] * sign
        path = resolve(beams.take(in_contact).mirrored(sign), s, f, psi[in_contact], tolerance)
        out[..., part][..., in_contact] = signal_slopes(path, f, sign)
    return scenes.jacobian(out)


def rest_angle(whisker: Whisker | Profile, radial_distance: ArrayLike) -> Array:
    """Deflection angle of an object that the whisker at rest just touches, rad.

    Parameters
    ----------
    radial_distance : float or array
        m.

    Returns
    -------
    array
        NaN beyond the whisker's reach. Where a curved whisker has two points at this distance, the
        one nearer to the base touches.

    Examples
    --------
    >>> w = Whisker(50e-3, 100e-6, 5e-6, curvature=10.0)
    >>> print(np.degrees(rest_angle(w, 30e-3)).round(4))
    8.6269
    """
    hint = "give metres, such as 35e-3"
    scenes = Scenes.of(whisker, length=positive("radial_distance", radial_distance, hint))
    angle = np.empty(scenes.length.size)
    for part, beams, (distance,) in scenes.pieces():
        angle[part] = zero_load(beams, distance)[1]
    return angle.reshape(scenes.shape)


def flick_past(
    whisker: Whisker | Profile,
    radial_distance: ArrayLike,
    friction_angle: ArrayLike = 0.0,
    *,
    side: ArrayLike = 1.0,
    tolerance: float = TOLERANCE,
) -> FlickPast:
    """The largest deflection angle at a radial distance (m), what ends it, and the moment's peak.

    As `weberwhisk.flick_past`; `side`, 1 or −1, is the sign of the force.

    Examples
    --------
    >>> w = Whisker(50e-3, 100e-6, 5e-6, curvature=10.0)
    >>> end = flick_past(w, radial_distance=35e-3, side=[1, -1])
    >>> np.degrees(end.deflection_angle).round(3)
    array([ 31.094, -18.613])
    """
    scenes = Scenes.of(whisker, length=radial_distance, tilt=friction_angle, side=side)
    n = scenes.length.size
    at_end, at_peak = np.full((2, 8, n), np.nan)
    errors = np.full((2, n), np.nan)
    ended_by = np.full(n, Outcome.OUT_OF_REACH, dtype=np.int8)
    for part, beams, (distance, psi, sign) in scenes.pieces():
        beams = beams.mirrored(sign)
        start, _ = zero_load(beams, distance)
        good = np.flatnonzero(np.isfinite(start) & on_whisker(beams, start))
        if not good.size:
            continue
        whiskers = extended(beams.take(good))
        branch = Branches.of(whiskers, distance[good], psi[good], tolerance=tolerance)
        ended = walk(branch, np.full(good.size, np.inf), peaks=True)
        which = np.arange(n)[part][good]
        for i, (numbers, point) in enumerate(((at_end, ended.point), (at_peak, ended.peak))):
            numbers[:, which], errors[i, which] = at_points(branch, point, sign[good])
        ended_by[which] = ended.outcome
    lost = ended_by == Outcome.OUT_OF_REACH
    outcome = np.where(lost, Outcome.OUT_OF_REACH, Outcome.HELD).astype(np.int8)
    end, peak = (
        scenes.bending(n, outcome, e) for n, e in zip((at_end, at_peak), errors, strict=True)
    )
    reason = member(Outcome, ended_by.reshape(scenes.shape))
    return FlickPast(end.deflection_angle, reason, end, peak)
