"""Many different stimuli as a few: quadrature nodes that stand for the answers near them.

A log-likelihood is a sum over trials of a smooth function of the decision variable D of a Weber
fraction of 1, one function for each answer. Within a narrow bin of D such a sum is that over three
Gaussian nodes with the same moments up to the fifth: what is lost is of sixth order in the width of
the bin. The cost of a fit then does not grow with the number of different stimuli.
"""

from __future__ import annotations

import numpy as np

from .._util.values import Array, Index

__all__ = ["nodes_of"]

SMALLEST = 3e-3  # Weber fraction below which bins about zero are not narrower
WIDTH = 0.5  # of a bin, in asinh(D / SMALLEST): half of D, far from zero


def nodes_of(d: Array, weight: Array, group: Index) -> tuple[Array, Array, Index]:
    """Nodes (N,) with their weights and groups, for weights at d (C,) in groups (C,).

    Examples
    --------
    >>> d = np.linspace(0.1, 0.12, 500)
    >>> at, n, _ = nodes_of(d, np.ones(500), np.zeros(500, dtype=np.intp))
    >>> at.size, bool(abs(n @ np.exp(at) - np.exp(d).sum()) < 1e-9)
    (3, True)
    """
    used = weight > 0
    d, weight, group = d[used], weight[used], group[used]
    place = np.floor(np.arcsinh(d / SMALLEST) / WIDTH).astype(np.intp)
    keys, row = np.unique(np.stack([group, place]), axis=1, return_inverse=True)
    row = row.reshape(-1)
    count = keys.shape[1]

    def total(values: Array) -> Array:
        return np.bincount(row, weight * values, count).astype(float)

    # In each bin's own coordinate the polynomials orthogonal under the weights (Stieltjes), and
    # the nodes as eigenvalues of their recurrence (Golub & Welsch 1969).
    mass = total(np.ones(d.size))
    middle = total(d) / mass
    scale = np.sqrt(total((d - middle[row]) ** 2) / mass) + 1e-300
    x = np.where(scale[row] > 1e-9 * np.abs(middle[row]), (d - middle[row]) / scale[row], 0.0)
    jacobi = np.zeros((count, 3, 3))
    before, now, norm = np.zeros(d.size), np.ones(d.size), mass
    b = np.zeros(count)
    for i in range(3):
        real = norm > 1e-10 * mass  # of one or two different values there are no more polynomials
        a = np.divide(total(x * now**2), norm, where=real, out=np.zeros(count))
        jacobi[:, i, i] = a
        before, now = now, (x - a[row]) * now - b[row] * before
        rest = total(now**2)
        b = np.divide(rest, norm, where=real, out=np.zeros(count))
        b[rest < 1e-10 * mass] = 0.0
        if i < 2:
            jacobi[:, i, i + 1] = jacobi[:, i + 1, i] = np.sqrt(b)
        norm = rest
    value, vector = np.linalg.eigh(jacobi)
    share = vector[:, 0] ** 2
    at, weights = middle[:, None] + scale[:, None] * value, mass[:, None] * share
    kept = share > 1e-12
    groups: Index = np.repeat(keys[0], 3)[kept.ravel()]
    return at[kept], weights[kept], groups
