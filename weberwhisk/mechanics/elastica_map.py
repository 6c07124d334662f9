"""The map under the elastica: its coordinates, and the tables shipped as ``elastica_map.npz``.

The map is held as two faces, each a Chebyshev table of logarithms of ratios to the closed form:

- *force given*: (u, (ℓ/ℓ_cap)²) → contact angle, height, shortening;
- *contact given*: (v = r/A, c = √(1 − (θ_d/θ_fold)²)) → force, contact angle, arc length. The
  square root unfolds the fold at which an object at r flicks past: no root has to be found.

`build_map` computes both; they are shipped as ``elastica_map.npz``.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from importlib import resources

import numpy as np

from .chebyshev import Array, Curve, Table


def load_cap(u: Array) -> Array:
    """Largest load ℓ on the map: past the fold and past a contact angle of 90° for every u."""
    return 5.3 - 2.6 * u


def unfold(v: Array) -> Array:
    """The coordinate x of v = x(1+x)/2, in which everything about the fold at r = vA is smooth."""
    return (np.sqrt(1 + 8 * v) - 1) / 2


def place_of(x: Array) -> Array:
    """The v of a coordinate x: the inverse of `unfold`."""
    return x * (1 + x) / 2


@dataclass(frozen=True, eq=False)
class Map:
    """The two faces of the map, and its fold."""

    force_given: Table  # (u, (ℓ/ℓ_cap)²) → ln α/ℓ, ln height ratio, ln shortening ratio
    contact_given: Table  # (x(v), c) → ln F/F_lin, ln α/α_lin, ln of the extra arc length
    fold_load: Curve  # u → ℓ/ℓ_cap at the fold
    fold: Curve  # x(v) → θ_fold/(1−v), and c at the moment peak

    def fold_angle(self, v: Array) -> Array:
        """θ_fold at r = vA."""
        return (1 - v) * self.fold(unfold(v))[0]


@cache
def the_map() -> Map:
    """The map that is shipped, read when it is first used."""
    with resources.files(__package__).joinpath("elastica_map.npz").open("rb") as file:
        stored = np.load(file)
        return Map(
            Table(stored["force_given"]),
            Table(stored["contact_given"]),
            Curve(stored["fold_load"]),
            Curve(stored["fold"]),
        )
