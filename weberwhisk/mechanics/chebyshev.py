"""Chebyshev tables of smooth functions on the unit square, and the map under the elastica.

The map is held as two faces, each a Chebyshev table of logarithms of ratios to the closed form:

- *force given*: (u, (ℓ/ℓ_cap)²) → contact angle, height, shortening;
- *contact given*: (v = r/A, c = √(1 − (θ_d/θ_fold)²)) → force, contact angle, arc length. The
  square root unfolds the fold at which an object at r flicks past: no root has to be found.

``analyses/build_elastica_map.py`` computes both; they are shipped as ``elastica_map.npz``.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property
from importlib import resources

import numpy as np
from numpy.polynomial import chebyshev

from .._util.values import Array

__all__ = [
    "ChebyshevTable", "Curve", "basis", "fit", "load_cap", "nodes", "place_of", "product",
    "the_map", "unfold",
]  # fmt: skip


def nodes(n: int) -> Array:
    """The `n` Chebyshev points of the first kind on [0, 1], ascending, without the ends."""
    return (1 - np.cos(np.pi * (np.arange(n) + 0.5) / n)) / 2


def basis(n: int, x: Array) -> Array:
    """The first `n` Chebyshev polynomials of 2x − 1, shape (n, len(x)).

    Built by doubling, T_{k+j} = 2 T_k T_j − T_{k−j}: few NumPy calls, so that a single point is
    as cheap as the call overhead allows.
    """
    out = np.empty((n, x.size))
    out[0] = 1.0
    if n > 1:
        np.subtract(2 * x, 1, out=out[1])
    k = 1
    while k < n - 1:
        m = min(k, n - 1 - k)
        np.multiply(out[k], out[1 : m + 1], out=out[k + 1 : k + m + 1])
        out[k + 1 : k + m + 1] *= 2
        out[k + 1 : k + m + 1] -= out[k - m : k][::-1]
        k += m
    return out


def product(matrix: Array, columns: Array, block: int = 256) -> Array:
    """Their matrix product, in blocks of columns that BLAS multiplies on one thread.

    Its own threads cost up to sixty times what they save on a matrix of some ten rows, as they wait
    for each other where another process has a core; and callers have threads of their own.
    """
    size = columns.shape[1]
    whole = size - size % block
    out = np.empty((len(matrix), size))
    blocks = columns[:, :whole].reshape(len(columns), -1, block).swapaxes(0, 1)
    filled = out[:, :whole].reshape(len(out), -1, block).swapaxes(0, 1)
    np.matmul(matrix, blocks, out=filled)
    np.matmul(matrix, columns[:, whole:], out=out[:, whole:])
    return out


def fit(values: Array) -> Array:
    """Coefficients of the interpolant through `values` at `nodes`, along the first axis."""
    n = len(values)
    weights = basis(n, nodes(n)) * (2 / n)
    weights[0] /= 2
    return np.asarray(np.tensordot(weights, values, axes=1), dtype=float)


@dataclass(frozen=True, eq=False)
class Curve:
    """Several functions of one variable: `coefficients` (n, k)."""

    coefficients: Array

    def __call__(self, x: Array) -> Array:
        """Values (k, len(x))."""
        # In pieces whose polynomials stay in the cache: four times as fast on a million points.
        rows, n, size = np.ascontiguousarray(self.coefficients.T), len(self.coefficients), 8192
        out = np.empty((len(rows), x.size))
        for i in range(0, x.size, size):
            out[:, i : i + size] = product(rows, basis(n, x[i : i + size]))
        return out

    @cached_property
    def derivative(self) -> Curve:
        """The curve of the derivatives with respect to x."""
        return Curve(np.asarray(2 * chebyshev.chebder(self.coefficients), dtype=float))


@dataclass(frozen=True, eq=False)
class ChebyshevTable:
    """Several functions of two variables: `coefficients` (nx, ny, k)."""

    coefficients: Array

    @cached_property
    def _rows(self) -> Array:
        nx, ny, k = self.coefficients.shape
        return np.ascontiguousarray(self.coefficients.transpose(2, 0, 1).reshape(k * nx, ny))

    def __call__(self, x: Array, y: Array) -> Array:
        """Values (k, len(x)) at the points (x, y)."""
        nx, ny, k = self.coefficients.shape
        along_y = product(self._rows, basis(ny, y)).reshape(k, nx, -1)
        return np.einsum("kin,in->kn", along_y, basis(nx, x))

    @cached_property
    def gradient(self) -> ChebyshevTable:
        """The table of all values, then all d/dx, then all d/dy."""
        parts = [self.coefficients]
        for axis in (0, 1):
            derived = 2 * chebyshev.chebder(self.coefficients, axis=axis)
            padding = [(0, 0)] * 3
            padding[axis] = (0, 1)
            parts.append(np.pad(derived, padding))
        return ChebyshevTable(np.concatenate(parts, axis=2))


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

    force_given: ChebyshevTable  # (u, (ℓ/ℓ_cap)²) → ln α/ℓ, ln height ratio, ln shortening ratio
    contact_given: ChebyshevTable  # (x(v), c) → ln F/F_lin, ln α/α_lin, ln of the extra arc length
    fold_load: Curve  # u → ℓ/ℓ_cap at the fold
    fold: Curve  # x(v) → θ_fold/(1−v), and c at the moment peak


@cache
def the_map() -> Map:
    """The map that is shipped, read when it is first used."""
    with resources.files(__package__).joinpath("elastica_map.npz").open("rb") as file:
        stored = np.load(file)
        return Map(
            ChebyshevTable(stored["force_given"]),
            ChebyshevTable(stored["contact_given"]),
            Curve(stored["fold_load"]),
            Curve(stored["fold"]),
        )
