"""Quadrature of many posteriors at once, in one to four unconstrained coordinates.

The trapezoid rule on a tensor grid is hard to beat here: for an analytic density that dies out
in every direction its error falls exponentially with the number of nodes (Trefethen & Weideman
2014, SIAM Review 56, 385). What it needs is a grid that fits: each density gets its own centre,
its own whitening (a square root of its covariance) and its own window, all found from its own
coarser passes. A Gaussian takes 17 nodes an axis to 1e-4.

Everything is said in units of the posterior's own sd, with two errors added up: what half the
resolution changes, and what the mass at the edge of the window says about the mass beyond it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..threads import on_threads
from .densities import Density, Functions
from .frames import Frames, Status
from .nodes import Array, Nodes
from .passes import evaluate

PASSES = 50


@dataclass(frozen=True)
class GridPosterior:
    """Moments of B posteriors by quadrature, with an error estimate on each.

    The C columns of `mean`, `sd` and their errors are the D coordinates, then the functions.

    Attributes
    ----------
    log_evidence, log_evidence_error : array, shape (B,)
        Log of the integral of the density over the unconstrained coordinates.
    mean, sd : array, shape (B, C)
        NaN where the density was zero at every node.
    mean_error, sd_error : array, shape (B, C)
        Estimated errors in units of the posterior sd.
    covariance : array, shape (B, D, D)
        Of the coordinates.
    status : array of int, shape (B,)
        `Status` values.
    evaluations : array of int, shape (B,)
        How often the density was evaluated, all passes together.
    nodes : tuple of Nodes, or None
        Of each posterior, if asked for.
    """

    log_evidence: Array
    log_evidence_error: Array
    mean: Array
    sd: Array
    mean_error: Array
    sd_error: Array
    covariance: Array
    status: NDArray[np.int64]
    evaluations: NDArray[np.int64]
    nodes: tuple[Nodes, ...] | None

    @property
    def converged(self) -> NDArray[np.bool_]:
        """Which posteriors met the tolerance, shape (B,)."""
        return self.status == Status.CONVERGED


def integrate(
    log_density: Density,
    centre: ArrayLike,
    scale: ArrayLike,
    *,
    functions: Functions | None = None,
    only_functions: bool = False,
    tolerance: float = 1e-4,
    max_points: int = 400_000,
    reach: float = 5.0,
    keep_points: bool = False,
) -> GridPosterior:
    """Integrate B densities over D = 1 to 4 unconstrained coordinates.

    A coarse pass finds the mean and covariance and is repeated about them until they stay, so a
    poor start costs passes, not accuracy; if its own errors are small enough, that is all. Fine
    passes then widen the window on whichever side still holds mass and refine whichever axis
    still changes the moments, until the estimated errors of every mean and sd, in units of that
    sd, are below `tolerance`.

    Parameters
    ----------
    log_density : callable
        ``log_density(x, index)`` with x of shape (b, N, D) and index (b,), the posteriors that
        these rows belong to; returns (b, N). May be -inf, never NaN or +inf.
    centre : array_like, shape (B, D)
        A point of non-zero density near the middle of each.
    scale : array_like, shape (B, D, D)
        A square root of each guessed covariance (columns are steps of one sd).
    functions : callable, optional
        ``functions(x)`` of shape (b, N, Q): quantities whose moments are wanted as well, and held
        to the same tolerance. Finite wherever the density is not zero.
    only_functions : bool
        The columns of the result are the functions alone, and only they are held to the tolerance.
    tolerance : float
        Largest estimated error of a mean or sd, in units of that sd.
    max_points : int
        Most nodes in one pass over one posterior.
    reach : float
        Half-width of the first pass, in units of `scale`. A second mode further off than this,
        across a gap without mass, is not found: no local rule can know of it.
    keep_points : bool
        Keep the nodes and weights of the last pass.

    Returns
    -------
    GridPosterior

    Raises
    ------
    ValueError
        If shapes do not fit, a start is not finite, or the log-density is NaN or +inf somewhere.

    Examples
    --------
    The log of a gamma variable of shape 3, and the variable itself:

    >>> density = lambda x, index: 3 * x[..., 0] - np.exp(x[..., 0])
    >>> fit = integrate(density, [[1.0]], [[[0.5]]], functions=np.exp, tolerance=1e-6)
    >>> fit.mean.round(5).tolist(), fit.sd.round(5).tolist()       # digamma(3), 3; ..., sqrt(3)
    ([[0.92278, 3.0]], [[0.62844, 1.73205]])
    >>> bool(fit.converged[0]), round(float(np.exp(fit.log_evidence[0])), 5)   # Gamma(3)
    (True, 2.0)
    """
    start = _checked_start(centre, scale, tolerance, reach)
    work = Frames(*start, tolerance, max_points, reach, keep_points)
    first = work.dim if only_functions else 0
    for _ in range(PASSES):
        groups = list(work.groups())
        passes = on_threads(lambda i: evaluate(work, i, log_density, functions, first), groups)
        for index, out in zip(groups, passes, strict=True):
            work.take(index, out, keep_points)
        if not work.running.any():
            break
    work.status[work.running] = Status.OPEN
    return GridPosterior(
        **work.found,
        status=work.status,
        evaluations=work.evaluations,
        nodes=tuple(work.nodes[i] for i in range(len(work.status))) if keep_points else None,
    )


def _checked_start(
    centre: ArrayLike, scale: ArrayLike, tolerance: float, reach: float
) -> tuple[Array, Array]:
    middle, root = np.asarray(centre, dtype=float), np.asarray(scale, dtype=float)
    if middle.ndim != 2 or len(middle) == 0 or not 1 <= middle.shape[1] <= 4:
        raise ValueError(
            f"centre must have shape (B, D) with B at least 1 and D from 1 to 4, got "
            f"{middle.shape}; give one row for each posterior."
        )
    if root.shape != (*middle.shape, middle.shape[1]):
        raise ValueError(
            f"scale must have shape {(*middle.shape, middle.shape[1])} for a centre of shape "
            f"{middle.shape}, got {root.shape}; give a square root of each covariance."
        )
    if not (np.isfinite(middle).all() and np.isfinite(root).all()):
        bad = np.flatnonzero(~(np.isfinite(middle).all(1) & np.isfinite(root).all((1, 2))))[0]
        raise ValueError(
            f"centre and scale must be finite, got {middle[bad].tolist()} and "
            f"{root[bad].tolist()} for posterior {bad}; leave such a posterior out."
        )
    singular = np.linalg.matrix_rank(root) < middle.shape[1]
    if singular.any():
        bad = np.flatnonzero(singular)[0]
        raise ValueError(
            f"scale must be invertible, got {root[bad].tolist()} for posterior {bad}; "
            "give every coordinate a width above zero."
        )
    if not 1e-12 <= tolerance < 1:
        raise ValueError(
            f"tolerance must be at least 1e-12 and below 1, got {tolerance}; 1e-4 is usual."
        )
    if not 2 <= reach <= 100:
        raise ValueError(f"reach must be between 2 and 100, got {reach}; 5 is usual.")
    return middle, root
