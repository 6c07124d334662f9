"""The coordinate in which the posterior of a lapse is equally smooth everywhere.

In the normal score z of its prior a lapse near 0 is known from the prior alone, over a width of 1,
and a large one from the answers, over a width that shrinks with their number. The coordinate t
counts both: dt² = dz² + N d(2 asin √λ)², with 2 asin √λ the coordinate in which a proportion of N
answers has an sd of 1/√N. Even nodes in t are then fine where they must be, and nowhere else.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.integrate import cumulative_simpson
from scipy.interpolate import CubicSpline

from .priors import REACH, quantiles

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Stretch:
    """A coordinate t of a normal score z; the score itself where `to_score` is None."""

    to_score: Any = None
    to_coordinate: Any = None
    ends: tuple[float, float] = (-REACH, REACH)

    def score(self, t: ArrayLike) -> Array:
        """z at t."""
        t = np.asarray(t, dtype=float)
        return t if self.to_score is None else self.to_score(np.clip(t, *self.ends))

    def coordinate(self, z: ArrayLike) -> Array:
        """t at z."""
        z = np.asarray(z, dtype=float)
        return z if self.to_score is None else self.to_coordinate(np.clip(z, -REACH, REACH))

    def slope(self, t: ArrayLike) -> Array:
        """dz/dt at t."""
        t = np.asarray(t, dtype=float)
        if self.to_score is None:
            return np.ones(t.shape)
        return self.to_score(np.clip(t, *self.ends), 1)


PLAIN = Stretch()


def stretch_for(prior: Any, answers: float) -> Stretch:
    """The coordinate for a lapse with that prior, told by so many answers."""
    return _stretch(prior, int(np.round(np.log2(max(answers, 1.0)))))


@lru_cache(maxsize=256)
def _stretch(prior: Any, doublings: int) -> Stretch:
    z = np.linspace(-REACH, REACH, 1441)
    arc = CubicSpline(z, 2 * np.arcsin(np.sqrt(np.clip(quantiles(prior)(z), 0.0, 1.0))))
    density = np.sqrt(1 + 2.0**doublings * arc(z, 1) ** 2)
    t = cumulative_simpson(density, x=z, initial=0.0)
    t = t - t[z.size // 2]
    return Stretch(CubicSpline(t, z), CubicSpline(z, t), (float(t[0]), float(t[-1])))
