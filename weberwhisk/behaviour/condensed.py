"""Many different stimuli as a few: quadrature nodes that stand for the answers near them.

A log-likelihood is a sum over trials of a smooth function of the decision variable D of a Weber
fraction of 1, one function for each answer. Within a narrow bin of D such a sum is that over three
Gaussian nodes with the same moments up to the fifth: what is lost is of sixth order in the width of
the bin. The cost of a fit then does not grow with the number of different stimuli. Measured places
add a variance to D, by which trials are binned too.
"""

from __future__ import annotations

import numpy as np

from .._util.values import Array, Index
from .encodings import UnitEncodings
from .tasks import Task

__all__ = ["condensed", "nodes_of"]

SMALLEST = 3e-3  # Weber fraction below which bins about zero are not narrower
WIDTH = 0.5  # of a bin, in asinh(D / SMALLEST) and in ln variance: half of D, far from zero


def condensed(
    task: Task, pairs: UnitEncodings, n: Array, count: Array, group: Index
) -> tuple[UnitEncodings, Array, Array, Index]:
    """Pairs, trials, answers and groups of nodes that stand for those given, (C,)."""
    sd = task.decision_sd(pairs.encoded(np.float64(1.0)))
    d, ratio = (pairs.mean_2 - pairs.mean_1) / sd, pairs.sd_2 / pairs.sd_1
    variance = np.broadcast_to(np.asarray(pairs.spread, dtype=float) / sd**2, d.shape)
    parts = [nodes_of(d, some, group, variance, ratio) for some in (count, n - count)]
    d, weight, variance, ratio = (np.concatenate([p[i] for p in parts]) for i in range(4))
    given = np.where(np.arange(d.size) < parts[0][0].size, weight, 0.0)
    unit = UnitEncodings(np.zeros(d.size), np.ones(d.size), ratio, ratio)
    sd = task.decision_sd(unit.encoded(np.float64(1.0)))
    fewer = unit._replace(mean_2=sd * d, spread=sd**2 * variance)
    return fewer, weight, given, np.concatenate([p[4] for p in parts])


def nodes_of(
    d: Array, weight: Array, group: Index, variance: Array, ratio: Array
) -> tuple[Array, Array, Array, Array, Index]:
    """Nodes (N,) with weights, mean variances and ratios of the two sds, and groups, for weights at
    d (C,) in groups.

    Examples
    --------
    >>> d = np.linspace(0.1, 0.12, 500)
    >>> at, n, *_ = nodes_of(d, np.ones(500), np.zeros(500, int), np.zeros(500), np.ones(500))
    >>> at.size, bool(abs(n @ np.exp(at) - np.exp(d).sum()) < 1e-9)
    (3, True)
    """
    used = weight > 0
    d, weight, variance, ratio = (a[used] for a in (d, weight, variance, ratio))
    group = group[used]
    place = np.floor(np.arcsinh(d / SMALLEST) / WIDTH).astype(np.intp)
    level = np.floor(2 * np.log(np.maximum(variance, SMALLEST**2)) / WIDTH).astype(np.intp)
    keys, row = np.unique(np.stack([group, place, level]), axis=1, return_inverse=True)
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
    by_bin = total(variance) / mass, total(ratio) / mass, keys[0]
    others = [np.repeat(a, 3)[kept.ravel()] for a in by_bin]
    return at[kept], weights[kept], others[0], others[1], others[2]
