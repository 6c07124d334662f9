"""Objects that a whisker meets: a peg, a cylinder of finite radius, a flat wall."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from .._util.checks import finite, positive
from .._util.refusals import Refusal
from .._util.values import Array, Fields

__all__ = ["Body", "cylinder", "peg", "wall"]


@dataclass(frozen=True, eq=False, repr=False)
class Body(Fields):
    """A circle of `radius` about one corner, m, or a wall through two: `corners` (1 or 2, 2)."""

    corners: Array
    radius: float = 0.0

    def depth(self, x: ArrayLike, y: ArrayLike) -> Array:
        """How deep points lie inside, m; negative outside. A wall is solid below.

        Examples
        --------
        >>> print(cylinder(0.0, -3e-3, 1e-3).depth(0.0, [0.0, -2.5e-3]))
        [-0.002   0.0005]
        """
        x, y = np.asarray(x) - self.corners[0, 0], np.asarray(y) - self.corners[0, 1]
        if len(self.corners) == 1:
            return np.asarray(self.radius - np.hypot(x, y))
        step = self.corners[1] - self.corners[0]
        return np.asarray((x * step[1] - y * step[0]) / np.hypot(*step))


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


def _points(points: ArrayLike) -> Array:
    array = finite("points", points, "give rows of (x, y) in metres")
    if array.ndim != 2 or array.shape[1] != 2:
        raise Refusal("points must be rows of (x, y)", f"shape {array.shape}", "give (k, 2)")
    return array
