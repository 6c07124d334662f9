"""A whisker in series with a rotational spring at its base.

The base turns by the moment over the spring's stiffness, Λ M. A contact at an angle θ of what
carries the spring is one of the clamped whisker at θ′, with

    θ = θ′ + Λ M(r, θ′).

The angle grows with θ′ until the fold, or until the moment falls faster than the whisker is bent:
there the whisker flicks past, the earlier the softer the spring. With θ′ = limit·sin p and
θ = largest·sin q all is smooth on either side. Contacts count as lost from half a turn on, as next
to the base whatever turns there turns the spring alone. Below, `forward` is the `ForwardModel` of
the clamped whisker, and `give` is Λ, rad/(N m).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize.elementwise import find_root

from .chebyshev import Array


def largest(forward: Any, give: float, r: Array) -> tuple[Array, Array, Array]:
    """Limits of θ′ and p, and the largest θ, at distances (n,), rad; NaN out of reach."""
    top = forward.limit(r) * (1 - 1e-13)  # rounding must not put it beyond the table's own
    peak = np.interp(r, *_peaks(forward, give))
    return top, peak, _angle(forward, give)(peak, r, top)


def bent(forward: Any, give: float, r: Array, theta: Array) -> tuple[Array, NDArray[np.bool_]]:
    """θ′ at distances and θ (n,), beyond its limit where θ is; whether not the tip ends it."""
    top, peak, last = largest(forward, give, r)
    size, held = np.abs(theta), np.minimum(last, np.pi)
    inside = (size > 0) & (size < last) & (size <= held)
    # Beyond, as far beyond the clamped whisker's own limit, which then says what becomes of it.
    out = np.where(size > held, 2 * top + size, np.where(size == last, top * np.sin(peak), size))
    if inside.any():
        angle = _angle(forward, give)

        def excess(p: Array, r: Array, top: Array, last: Array, q: Array) -> Array:
            return np.asarray(np.arcsin(np.minimum(angle(p, r, top) / last, 1.0)) - q)

        q, ends = np.arcsin(size[inside] / last[inside]), peak[inside]
        args = (r[inside], top[inside], last[inside], q)
        found: Any = find_root(
            excess, (0 * q, ends), args=args, tolerances={"xrtol": 1e-12, "frtol": 1e-12}
        )
        # Rounding can leave no root between the ends where θ is all but the largest.
        p = np.where(found.success, found.x, np.where(q > np.pi / 2 - 1e-6, ends, np.nan))
        out[inside] = top[inside] * np.sin(p)
    return np.copysign(out, theta), (size > held) & ((peak < np.pi / 2) | (last > np.pi))


def _angle(forward: Any, give: float) -> Callable[[Array, Array, Array], Array]:
    def angle(p: Array, r: Array, top: Array) -> Array:
        inner = top * np.sin(p)
        return np.asarray(inner + give * forward.tabled(r, inner)[0][..., 0])

    return angle


@lru_cache(maxsize=64)
def _peaks(forward: Any, give: float, count: int = 400) -> tuple[Array, Array]:
    """Distances, and p at which θ is largest: to first order no error of p is one of θ."""
    r = forward.reach * np.sin(np.linspace(1e-3, np.pi / 2 - 1e-3, count)) ** 2
    step, end = 1e-4, np.full(count, np.pi / 2)
    angle = _angle(forward, give)

    def rise(p: Array, r: Array, top: Array) -> Array:
        return angle(p, r, top) - angle(p - step, r, top)

    top = forward.limit(r)
    falls = rise(end, r, top) < 0
    if falls.any():
        ends = (np.full(end[falls].shape, step), end[falls])
        end[falls] = find_root(rise, ends, args=(r[falls], top[falls])).x - step / 2
    return r, end
