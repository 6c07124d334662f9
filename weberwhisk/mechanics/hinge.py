"""A whisker in series with a rotational spring at its base.

The base turns by the moment over the spring's stiffness, Λ M. A contact at an angle θ of what
carries the spring is one of the clamped whisker at θ′, with

    θ = θ′ + Λ M(r, θ′).

The angle grows with θ′ until the fold, or until the moment falls faster than the whisker is bent:
there the whisker flicks past, the earlier the softer the spring. With θ′ = limit·sin p and
θ = largest·sin q all is smooth on either side. Contacts count as lost from half a turn on, as next
to the base whatever turns there turns the spring alone; where Λ is not known, from the share of the
largest angle on that is half a turn for the middle of its range, so that nothing has a kink in it.
Below, `forward` is the `ForwardModel` of the clamped whisker, and `compliance`
is Λ (n,), rad/(N m), between the two `ends`.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator
from scipy.optimize.elementwise import find_root

from .chebyshev import Array


def largest(
    forward: Any, ends: tuple[float, float], r: Array, compliance: Array
) -> tuple[Array, Array, Array, Array]:
    """Limits of θ′ and p, the largest θ, and that held, at distances (n,), rad; or NaN."""
    top = forward.limit(r) * (1 - 1e-13)  # rounding must not put it beyond the table's own
    peaks = _peaks(forward, *ends)
    peak = peaks(r, compliance)
    last = middle = _angle(forward, peak, r, top, compliance)
    if ends[1] > ends[0]:
        typical = np.full(r.shape, np.sqrt(ends[0] * ends[1]))
        middle = _angle(forward, peaks(r, typical), r, top, typical)
    return top, peak, last, np.where(middle > np.pi, last / np.maximum(middle, np.pi) * np.pi, last)


def bent(
    forward: Any, ends: tuple[float, float], r: Array, theta: Array, compliance: Array
) -> tuple[Array, NDArray[np.bool_]]:
    """θ′ at distances and θ (n,), beyond its limit where θ is; whether not the tip ends it."""
    top, peak, last, held = largest(forward, ends, r, compliance)
    size = np.abs(theta)
    inside = (size > 0) & (size < last) & (size <= held)
    # Beyond, as far beyond the clamped whisker's own limit, which then says what becomes of it.
    out = np.where(size > held, 2 * top + size, np.where(size == last, top * np.sin(peak), size))
    if inside.any():

        def excess(p: Array, *given: Array) -> Array:
            *place, last, q = given
            angle = _angle(forward, p, *place)
            return np.asarray(np.arcsin(np.minimum(angle / last, 1.0)) - q)

        q, end = np.arcsin(size[inside] / last[inside]), peak[inside]
        args = (*(a[inside] for a in (r, top, compliance, last)), q)
        # By secants, as p is nearly in proportion to q; where they have not ended, by brackets.
        p, behind, miss = q / (np.pi / 2) * end, 0 * q, -q
        for _ in range(5):
            now = excess(p, *args)
            with np.errstate(invalid="ignore", divide="ignore"):
                step = np.where(now == 0, 0.0, now * (p - behind) / (now - miss))
            behind, miss, p = p, now, np.clip(p - step, 0.0, end)
        left = ~(np.abs(step) < 1e-8 * p)  # the next is smaller than rounding
        if left.any():
            some = tuple(a[left] for a in args)
            found: Any = find_root(
                excess,
                (0 * q[left], end[left]),
                args=some,
                tolerances={"xrtol": 1e-12, "frtol": 1e-12},
            )
            # Rounding can leave no root between the ends where θ is all but the largest.
            lost = np.where(q[left] > np.pi / 2 - 1e-6, end[left], np.nan)
            p[left] = np.where(found.success, found.x, lost)
        out[inside] = top[inside] * np.sin(p)
    return np.copysign(out, theta), (size > held) & ((peak < np.pi / 2) | (last > held))


def _angle(forward: Any, p: Array, r: Array, top: Array, compliance: Array) -> Array:
    inner = top * np.sin(p)
    return np.asarray(inner + compliance * forward.tabled(r, inner)[0][..., 0])


@lru_cache(maxsize=64)
def _peaks(
    forward: Any, low: float, high: float, count: int = 400, compliances: int = 33
) -> Callable[[Array, Array], Array]:
    """p (n,) at which θ is largest, at r and Λ: to first order no error is one of θ."""
    place = forward.reach * np.sin(np.linspace(1e-3, np.pi / 2 - 1e-3, count)) ** 2
    soft = np.geomspace(low, high, compliances) if high > low else np.array([low])
    r, compliance = (a.ravel() for a in np.meshgrid(place, soft, indexing="ij"))
    step, end, top = 1e-4, np.full(r.shape, np.pi / 2), forward.limit(r)

    def rise(p: Array, *at: Array) -> Array:
        return _angle(forward, p, *at) - _angle(forward, p - step, *at)

    falls = rise(end, r, top, compliance) < 0
    if falls.any():
        at = tuple(a[falls] for a in (r, top, compliance))
        end[falls] = find_root(rise, (np.full(at[0].shape, step), end[falls]), args=at).x - step / 2
    peak = end.reshape(count, -1)
    if not high > low:
        return lambda r, compliance: np.interp(r, place, peak[:, 0])
    table = RegularGridInterpolator((place, np.log(soft)), peak)

    def between(r: Array, compliance: Array) -> Array:
        inside = np.clip(r, place[0], place[-1]), np.log(np.clip(compliance, *soft[[0, -1]]))
        return np.asarray(table(np.stack(np.broadcast_arrays(*inside), axis=-1)))

    return between
