"""What every engine demands of a log-density."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def checked_density(value: ArrayLike, points: Array, index: NDArray[np.intp]) -> Array:
    """The log-density as (b, N), refused where it is NaN, +inf or of another shape."""
    out = np.asarray(value, dtype=float)
    if out.shape != points.shape[:2]:
        raise ValueError(
            f"The log-density must have shape {points.shape[:2]} for points of shape "
            f"{points.shape}, got {out.shape}; return one value for each point."
        )
    if not np.max(out) < np.inf:
        bad = tuple(np.argwhere(~(out < np.inf))[0])
        raise ValueError(
            f"The log-density of posterior {index[bad[0]]} is {out[bad]} at "
            f"{points[bad].tolist()}; return -inf where the density is zero."
        )
    return out


def refuse_impossible(reading: Array, highest: Array) -> None:
    """Refuse readings (B, R) whose log-density is −inf everywhere: there is no posterior."""
    impossible = np.isneginf(highest)
    if np.any(impossible):
        raise ValueError(
            f"No contact can give the reading {reading[impossible][0].tolist()} under this noise; "
            "check its sign, or choose noise that allows it, such as Weber."
        )
