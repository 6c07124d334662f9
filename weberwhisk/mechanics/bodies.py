"""What whiskers are swept against: pegs, cylinders, walls and convex contours.

All are rounded polygons: corners, the straight edges between them, and one radius of rounding.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from .._checks import finite, non_negative, positive
from .chebyshev import Array


@dataclass(frozen=True, eq=False)
class Body:
    """A convex object: `corners` (k, 2), clockwise, in m, rounded by `radius`, m."""

    corners: Array
    radius: float = 0.0

    def depth(self, x: ArrayLike, y: ArrayLike) -> Array:
        """How deep points lie inside, m; negative outside. Two corners are a wall, solid below.

        Examples
        --------
        >>> print(cylinder(0.0, -3e-3, 1e-3).depth(0.0, [0.0, -2.5e-3]))
        [-0.002   0.0005]
        """
        place = np.stack(np.broadcast_arrays(x, y), axis=-1)[..., None, :] - self.corners
        if len(self.corners) == 1:
            return np.asarray(self.radius - np.hypot(place[..., 0, 0], place[..., 0, 1]))
        step = np.diff(np.vstack([self.corners, self.corners[:1]]), axis=0)
        span = np.hypot(step[:, 0], step[:, 1])
        along = (place * step).sum(axis=-1) / span
        over = (place[..., 1] * step[:, 0] - place[..., 0] * step[:, 1]) / span
        if len(self.corners) == 2:
            return np.asarray(self.radius - over[..., 0])
        off = along - np.clip(along, 0, span)
        edge = np.min(np.hypot(off, over), axis=-1)
        return self.radius - np.where(np.all(over <= 0, axis=-1), -edge, edge)


def peg(x: float, y: float) -> Body:
    """A point, such as a thin peg, at (x, y), m."""
    return Body(_points([[x, y]]))


def cylinder(x: float, y: float, radius: float) -> Body:
    """A cylinder of finite radius about (x, y), m."""
    return Body(_points([[x, y]]), float(positive("radius", radius, "give metres, such as 2e-3")))


def wall(x: float, y: float, angle: float) -> Body:
    """A flat wall through (x, y), m, that runs at `angle` to the x axis, rad; the whisker above."""
    along = 10.0 * np.array([np.cos(angle), np.sin(angle)])
    return Body(_points([np.array([x, y]) - along, np.array([x, y]) + along]))


def contour(points: ArrayLike, radius: float = 0.0) -> Body:
    """A convex contour given as points (k, 2), m, in order, its corners rounded by `radius`.

    Raises
    ------
    ValueError
        For fewer than three points, and for a contour that is not convex.
    """
    corners = _points(points)
    steps = np.diff(np.vstack([corners, corners[:1]]), axis=0)
    turns = steps[:, 0] * np.roll(steps[:, 1], -1) - steps[:, 1] * np.roll(steps[:, 0], -1)
    if len(corners) < 3 or not (np.all(turns > 0) or np.all(turns < 0)):
        raise ValueError(
            f"A contour must be convex, of three points or more in order, got {len(corners)} "
            "points that turn both ways or not at all; give its convex hull."
        )
    rounding = float(non_negative("radius", radius, "give metres, or 0 for sharp corners"))
    return Body(corners if turns[0] < 0 else corners[::-1], rounding)


def _points(points: ArrayLike) -> Array:
    array = finite("points", points, "give rows of (x, y) in metres")
    if array.ndim != 2 or array.shape[1] != 2:
        raise ValueError(f"points must be rows of (x, y), got shape {array.shape}; give (k, 2).")
    return array
