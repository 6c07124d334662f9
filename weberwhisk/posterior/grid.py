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

from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, replace
from enum import IntEnum
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import special

from weberwhisk.posterior.densities import checked_density
from weberwhisk.posterior.threads import on_threads

Array = NDArray[np.float64]
Density = Callable[[Array, NDArray[np.intp]], ArrayLike]
Functions = Callable[[Array], ArrayLike]

COARSE_PASSES, LONG_TRIED, PASSES = 15, 4, 50
SLOWEST_FALL = 1 - 1e-6  # from layer to layer of nodes, when the mass beyond the last is guessed
RESOLVED = 0.3  # error of the spacing up to which a coarse pass is believed
LOST = 0.3  # change of ln Z, from all nodes to every second, at which mass falls between nodes
NEARLY, FINER = 4.0, 0.75  # up to so many tolerances a spacing is cut by this instead of halved
LEVEL = 1e-9  # sd over mean of a function that only rounding keeps from being constant
BATCH = 40_000  # nodes evaluated in one call: the arrays of one pass stay in the cache


class Status(IntEnum):
    """How an integration ended."""

    CONVERGED = 0
    COARSE = 1
    OPEN = 2
    EMPTY = 3

    @property
    def message(self) -> str:
        """The status in words."""
        return _MESSAGES[self]


_MESSAGES = {
    Status.CONVERGED: "converged",
    Status.COARSE: "the density has more structure than max_points resolve",
    Status.OPEN: "the mass does not die out: a ridge without end, or tails too heavy",
    Status.EMPTY: "the density is zero at every node",
}


@dataclass(frozen=True)
class Nodes:
    """The weighted nodes of one posterior.

    Attributes
    ----------
    points : array, shape (N, D)
    weights : array, shape (N,)
        They sum to one.
    shape : tuple of int
        Nodes along each axis of the grid; their product is N, the last axis runs fastest.
    edges : array, shape (D, D)
        Column k is the step between neighbours along axis k.
    """

    points: Array
    weights: Array
    shape: tuple[int, ...]
    edges: Array

    def quantile(self, values: ArrayLike, probability: ArrayLike) -> Array:
        """Quantiles of a quantity given at the nodes.

        The step function in F(v) = E[step(v − V)] is smoothed over about one node's distance in V
        by a sixth-order Gaussian kernel (its moments 1 to 5 vanish), which keeps the trapezoid
        rule's accuracy: about 1e-3 in probability, or better, where the integral has converged.

        Parameters
        ----------
        values : array_like, shape (N,)
        probability : array_like
            Between 0 and 1.

        Returns
        -------
        array of the shape of `probability`

        Examples
        --------
        >>> z = np.linspace(-6, 6, 25)
        >>> weights = np.exp(-z**2 / 2) / np.exp(-z**2 / 2).sum()
        >>> nodes = Nodes(z[:, None], weights, (25,), np.array([[0.5]]))
        >>> nodes.quantile(z, [0.025, 0.975]).round(2).tolist()
        [-1.96, 1.96]
        """
        v = np.asarray(values, dtype=float)
        p = np.asarray(probability, dtype=float)
        used = self.weights > 1e-12 * self.weights.max()
        cells = np.where(used, v, v[self.weights.argmax()]).reshape(self.shape)
        slopes = np.stack([np.gradient(cells, axis=k) for k in range(cells.ndim)])  # per node
        width = KERNEL * np.sqrt(np.square(slopes).sum(axis=0)).ravel()
        v, weights = v[used], self.weights[used] / self.weights[used].sum()
        width = np.maximum(width[used], 1e-12 * (np.ptp(v) or 1.0))
        out = [_crossing(v, width, weights, float(target)) for target in p.ravel()]
        return np.reshape(out, p.shape)


KERNEL = 0.8  # smoothing width of quantiles, in nodes: bias and aliasing about equal


def _crossing(v: Array, width: Array, weights: Array, target: float) -> float:
    """Where the smoothed F reaches a probability.

    By bisection, as the smoothed F need not rise everywhere in the far tails. Nodes that the
    bracket has left behind, by `BEHIND` widths, count in full or not at all.
    """
    low, high, full = float(v.min()), float(v.max()), 0.0
    for step in range(50):
        if step % 5 == 4:
            under = v + BEHIND * width < low
            near = ~under & (v - BEHIND * width < high)
            full += weights[under].sum()
            v, width, weights = v[near], width[near], weights[near]
        middle = (low + high) / 2
        if full + _smooth_step((middle - v) / width) @ weights < target:
            low = middle
        else:
            high = middle
    return (low + high) / 2


BEHIND = 8.0  # the kernel's integral is 1 to 1e-12 there


def _smooth_step(u: Array) -> Array:
    """The integral of the sixth-order Gaussian kernel."""
    density = np.exp(-0.5 * u**2) / np.sqrt(2 * np.pi)
    return np.asarray(special.ndtr(u) + density * (u / 2 - (u**3 - 3 * u) / 8))


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
    work = _Work(*start, tolerance, max_points, reach, keep_points)
    first = work.dim if only_functions else 0
    for _ in range(PASSES):
        groups = list(work.groups())
        passes = on_threads(lambda i: _evaluate(work, i, log_density, functions, first), groups)
        for index, out in zip(groups, passes, strict=True):
            work.take(index, out, keep_points)
        if not work.running.any():
            break
    work.status[work.running] = Status.OPEN
    return work.result(keep_points)


class _Work:
    """Where each posterior's grid is now, and what its passes found so far.

    Along axis k the window runs over ``cells[:, 0, k]`` cells below the centre and
    ``cells[:, 1, k]`` above it. A cell is ``width[:, k]`` wide, in units of ``root``, and is cut
    into ``2**level[:, k]`` intervals.
    """

    def __init__(
        self,
        centre: Array,
        root: Array,
        tolerance: float,
        max_points: int,
        reach: float,
        quantiles: bool,
    ) -> None:
        count, self.dim = centre.shape
        self.tolerance, self.max_points = tolerance, max_points
        self.centre, self.root = centre.copy(), root.copy()
        # In one or two dimensions so fine that a Gaussian needs no second pass.
        cells = int(np.ceil(reach / (0.72 if self.dim < 3 else 1.5)))
        self.first_cells = cells
        self.cells = np.full((count, 2, self.dim), cells)
        self.width = np.full((count, self.dim), reach / cells)
        self.level = np.zeros((count, self.dim), dtype=np.int64)
        self.coarse_passes = np.zeros(count, dtype=np.int64)
        self.quantiles, self.halved = quantiles, np.zeros(count, dtype=bool)
        self.fine = np.zeros(count, dtype=bool)
        self.seen = np.zeros(count, dtype=bool)
        self.kept = self.centre.copy(), self.root.copy(), self.cells.copy()
        self.fitting = _fitting(tolerance, self.dim)
        self.running = np.ones(count, dtype=bool)
        self.status = np.full(count, Status.OPEN, dtype=np.int64)
        self.evaluations = np.zeros(count, dtype=np.int64)
        self.found: dict[str, Array] = {}
        self.nodes: dict[int, Nodes] = {}

    def settle(self, index: NDArray[np.intp]) -> None:
        """Add cells above until their number is one of few, so that more grids share a shape."""
        total = self.cells[index].sum(axis=1)
        unit = 2 ** np.maximum(np.floor(np.log2(total)).astype(np.int64) - 3, 0)  # of eighths
        self.cells[index, 1] += -total % unit

    def intervals(self) -> NDArray[np.int64]:
        """Intervals along each axis of each posterior's grid, shape (B, D)."""
        return np.asarray(self.cells.sum(axis=1) * 2**self.level)

    def groups(self) -> Iterator[NDArray[np.intp]]:
        """The running posteriors: grids of one shape together, no more than fit the cache."""
        running = np.flatnonzero(self.running)
        grids = np.concatenate([self.intervals(), self.level], axis=1)[running]
        shapes, member = np.unique(grids, axis=0, return_inverse=True)
        for j, shape in enumerate(shapes):
            together = running[member.ravel() == j]
            size = max(1, BATCH // int(np.prod(shape[: self.dim] + 1)))
            yield from np.split(together, range(size, len(together), size))

    def take(self, index: NDArray[np.intp], out: _Pass, keep_points: bool) -> None:
        """Record a pass over the posteriors `index`; end each, or choose its next grid."""
        self.evaluations[index] += out.weights.shape[1]
        for name, value in out.found.items():
            shape = (len(self.centre), *value.shape[1:])
            self.found.setdefault(name, np.full(shape, np.nan))[index] = value
        empty = ~np.isfinite(out.found["log_evidence"])
        self.end(index[empty], Status.EMPTY)
        fine = self.fine[index]
        # A coarse pass is often good enough already.
        errors = np.maximum(out.found["mean_error"], out.found["sd_error"])
        enough = ~fine & ~empty & (errors.max(axis=1) <= self.tolerance) & (not self.quantiles)
        self.end(index[enough], Status.CONVERGED)
        empty |= enough
        for rows, step in ((~fine & ~empty, self.reframe), (fine & ~empty, self.refine)):
            if rows.any():
                step(index[rows], out.of(rows))
        if keep_points:
            for i in np.flatnonzero(~self.running[index]):
                self.nodes[int(index[i])] = out.nodes(i)

    def end(self, index: NDArray[np.intp], status: Status | NDArray[np.int64]) -> None:
        """No more passes over these."""
        self.running[index], self.status[index] = False, status

    def reframe(self, index: NDArray[np.intp], out: _Pass) -> None:
        """Widen a coarse window, or centre and whiten by what it holds; go on once it fitted."""
        open_sides = out.edge_mass > 0.02
        cut_off = np.asarray(open_sides.any(axis=(1, 2)))
        seen = np.asarray(~cut_off & (out.axis_error < RESOLVED).all(axis=1))
        self.coarse_passes[index] += 1
        late = self.coarse_passes[index] >= COARSE_PASSES
        self.end(index[late & cut_off], Status.OPEN)
        # A long tail is followed along its axis: whitening by it would lose the narrow core. So is
        # a heavy one where windows have grown and shrunk in turn; but where most of the mass is
        # at the edge there is no core yet.
        inside = (np.abs(out.z_mean) < 0.5 * self.first_cells * self.width[index]).all(axis=1)
        follow = out.edge_mass.max(axis=(1, 2)) < 0.4
        follow |= inside & (self.coarse_passes[index] > LONG_TRIED)
        follow &= cut_off & ~late
        follow &= self.cells[index].max(axis=(1, 2)) <= 2 * self.first_cells
        self.cells[index[follow]] += np.where(open_sides[follow], self.cells[index[follow]], 0)
        # Where whitening has lost it, back to the last frame in which all was seen.
        lost = np.asarray(~seen & ~follow & self.seen[index])
        self.back(index[lost])

        rest = ~follow & ~lost
        index, out = index[rest], out.of(rest)
        late, cut_off, seen = late[rest], cut_off[rest], seen[rest]
        self.keep(index[seen], out.extent[seen])
        values, vectors = np.linalg.eigh(out.z_cov)
        # What the grid cannot see is not believed: a width below its spacing, or any width while
        # much of the mass is still outside, when the window doubles instead.
        floor = np.where(cut_off, 4.0, (0.4 * self.width[index].max(axis=1)) ** 2)
        fits = (np.abs(out.z_mean) < 1.0).all(axis=1) & ~cut_off
        fits &= (values > 0.3).all(axis=1) & (values < 6.0).all(axis=1)
        values = np.where(
            fits[:, None], np.minimum(values, 2.0), np.maximum(values, floor[:, None])
        )
        self.centre[index] += (self.root[index] @ out.z_mean[..., None])[..., 0]
        # The symmetric square root: axes keep their directions, and tails along them theirs.
        step = (np.sqrt(values)[:, None, :] * vectors) @ vectors.swapaxes(1, 2)
        self.root[index] = self.root[index] @ step
        self.cells[index] = self.first_cells
        ready = index[(fits | late) & ~(late & cut_off)]
        self.start_fine(ready, out.extent[np.isin(index, ready)])

    def keep(self, index: NDArray[np.intp], extent: NDArray[np.int64]) -> None:
        """Remember the frames of these, in which all of the mass lies within `extent`."""
        self.seen[index] = True
        for kept, now in zip(
            self.kept, (self.centre[index], self.root[index], extent), strict=True
        ):
            kept[index] = now

    def back(self, index: NDArray[np.intp]) -> None:
        """Fine passes over the window remembered."""
        for kept, now in zip(self.kept, (self.centre, self.root, self.cells), strict=True):
            now[index] = kept[index]
        self.start_fine(index, self.cells[index])

    def start_fine(self, index: NDArray[np.intp], extent: NDArray[np.int64]) -> None:
        """Fine passes over a window that holds the mass found in `extent` coarse cells."""
        scale = self.width[index] / self.fitting
        self.cells[index] = np.ceil((extent + 1) * scale[:, None])
        self.fine[index], self.width[index] = True, self.fitting
        self.settle(index)

    def refine(self, index: NDArray[np.intp], out: _Pass) -> None:
        """Widen the window where mass is left, halve the spacing where it matters."""
        errors = np.maximum(out.found["mean_error"], out.found["sd_error"])
        worst = errors.max(axis=1)
        good = (worst <= self.tolerance) | self.halved[index]
        # Quantiles are read off the nodes, and want them closer than moments do.
        again = good & self.quantiles & ~self.halved[index]
        again &= np.prod(2.0 * self.intervals()[index] + 1, axis=1) <= self.max_points
        self.level[index[again]] += 1
        self.halved[index[again]] = True
        self.end(index[good & ~again], Status.CONVERGED)
        left = ~good
        index, out = index[left], out.of(left)
        share = self.tolerance / (4 * self.dim)
        narrow = out.edge_error > share / 2
        narrow &= out.edge_error.sum(axis=(1, 2), keepdims=True) > self.tolerance / 2
        rough = out.axis_error > self.tolerance / 4
        neither = ~narrow.any(axis=(1, 2)) & ~rough.any(axis=1)
        rough[neither, out.axis_error[neither].argmax(axis=1)] = True
        # As many more layers as it takes, if they go on falling as the last two do.
        with np.errstate(divide="ignore", invalid="ignore"):
            layers = np.log(out.edge_error * 4 / share) / -np.log(np.clip(out.fall, 0, 0.999))
        more = np.ceil(np.nan_to_num(layers))
        more = np.clip(more, 1, self.cells[index]).astype(np.int64)
        self.cells[index] += np.where(narrow, more, 0)
        # An axis that is nearly fine enough is not made twice as fine: with a third more nodes the
        # error of an analytic density is its own 1.3rd to 1.8th power, and falls to a quarter.
        nearly = rough & (out.axis_error < NEARLY * self.tolerance)
        self.cells[index] = np.where(
            nearly[:, None], np.ceil(self.cells[index] / FINER), self.cells[index]
        )
        self.width[index] *= np.where(nearly, FINER, 1.0)
        self.level[index] += rough & ~nearly
        self.settle(index)
        over = np.prod(self.intervals()[index] + 1.0, axis=1) > self.max_points
        why = np.where(narrow.any(axis=(1, 2)), Status.OPEN, Status.COARSE)
        self.end(index[over], why[over])

    def result(self, keep_points: bool) -> GridPosterior:
        """The results of the last passes."""
        nodes = tuple(self.nodes[i] for i in range(len(self.status))) if keep_points else None
        return GridPosterior(
            **self.found, status=self.status, evaluations=self.evaluations, nodes=nodes
        )


@dataclass(frozen=True)
class _Pass:
    """What one pass over b posteriors found; z are coordinates in units of the root."""

    found: dict[str, Array]  # fields of `GridPosterior`
    z_mean: Array
    z_cov: Array
    edge_mass: Array  # (b, 2, D): the share of the mass beyond either end of each axis
    edge_error: Array  # (b, 2, D): what that does to the worst of the means and sds
    extent: NDArray[np.int64]  # (b, 2, D): cells below and above the centre that hold mass
    fall: Array  # (b, 2, D): how fast the layers of nodes fall towards either end
    axis_error: Array  # (b, D): what the spacing along one axis does
    points: Array
    weights: Array
    edges: Array
    shape: tuple[int, ...]

    def of(self, rows: NDArray[np.bool_]) -> _Pass:
        """The same of some of the posteriors."""
        named = {
            f.name: getattr(self, f.name)[rows]
            for f in fields(self)
            if f.name not in ("found", "shape")
        }
        return replace(self, found={k: v[rows] for k, v in self.found.items()}, **named)

    def nodes(self, i: int) -> Nodes:
        """The nodes of one posterior."""
        weights = self.weights[i] / max(self.weights[i].sum(), np.finfo(float).tiny)
        return Nodes(self.points[i].copy(), weights, self.shape, self.edges[i])


def _evaluate(
    work: _Work,
    index: NDArray[np.intp],
    log_density: Density,
    functions: Functions | None,
    first: int,
) -> _Pass:
    """One pass over posteriors whose grids have the same shape; columns from the `first` on."""
    counts = work.intervals()[index[0]] + 1
    spacing = work.width[index] / 2.0 ** work.level[index]
    lowest = -work.cells[index, 0] * work.width[index]
    node = np.moveaxis(np.indices(counts), 0, -1).reshape(-1, work.dim)
    z = lowest[:, None] + node * spacing[:, None]
    points = work.centre[index, None] + z @ work.root[index].swapaxes(1, 2)
    log_value = checked_density(log_density(points, index), points, index)
    peak = log_value.max(axis=1)
    peak = np.where(np.isfinite(peak), peak, 0.0)
    weights = np.exp(log_value - peak[:, None])
    total = weights.sum(axis=1)
    found = total > 0
    safe = np.where(found, total, 1.0)[:, None]
    values = _columns(points, weights, functions)[..., first:]
    mean = (weights[:, None] @ values)[:, 0] / safe
    off = np.ascontiguousarray((values - mean[:, None]).swapaxes(1, 2))  # (b, C, N)
    sd = np.sqrt((off**2 @ weights[..., None])[..., 0] / safe)
    off /= np.maximum(sd, 1e-100)[..., None]  # a single node has no sd
    # What is the same everywhere is known wherever anything is.
    level = (sd <= LEVEL * np.abs(mean))[..., None]
    off = np.where(level & ~level.all(axis=1, keepdims=True), off[:, :1], off)
    # The mass, first and second moment of every node, as shares of the whole.
    mass = weights / safe
    terms = np.empty((len(index), 1 + 2 * off.shape[1], *counts))
    share = terms.reshape(len(index), terms.shape[1], -1)
    share[:, 0] = mass
    first_moments, second_moments = np.split(share[:, 1:], 2, axis=1)
    np.multiply(mass[:, None], off, out=first_moments)
    np.multiply(first_moments, off, out=second_moments)
    along = [_along(terms, k) for k in range(work.dim)]
    edge_mass, edge_mean, edge_sd, fall = _edges(along, 2 ** work.level[index[0]])
    # Thinned along both axes, errors can cancel: along each alone they show.
    changes = [_resolution(part) for part in ([terms, *along] if work.dim > 1 else along)]
    evidence_change, mean_change, sd_change = (
        np.maximum.reduce(parts) for parts in zip(*changes, strict=True)
    )
    lost = (changes[0][1] >= 1).all(axis=1)
    alone = [np.maximum(mean, sd).max(axis=1) for _, mean, sd in changes[-work.dim :]]
    alone = [np.where(lost, 1.0, error) for error in alone]
    middle = (weights[:, None] @ points)[:, 0] / safe
    centred = points - middle[:, None]
    covariance = (mass[..., None] * centred).swapaxes(1, 2) @ centred
    inverse = np.linalg.inv(work.root[index])
    cell = spacing.prod(axis=1) * np.abs(np.linalg.det(work.root[index]))
    empty = np.where(found, 0.0, np.nan)
    return _Pass(
        found={
            "log_evidence": np.where(found, peak + np.log(safe[:, 0] * cell), -np.inf),
            "log_evidence_error": evidence_change + edge_mass.sum(axis=(1, 2)),
            "mean": mean + empty[:, None],
            "sd": sd + empty[:, None],
            "mean_error": mean_change + edge_mean.sum(axis=(1, 2)),
            "sd_error": sd_change + edge_sd.sum(axis=(1, 2)),
            "covariance": covariance + empty[:, None, None],
        },
        z_mean=(inverse @ (middle - work.centre[index])[..., None])[..., 0],
        z_cov=inverse @ covariance @ inverse.swapaxes(1, 2),
        edge_mass=edge_mass,
        edge_error=np.maximum(edge_mean, edge_sd).max(axis=-1),
        extent=_extent(terms[:, 0], work.cells[index], work.tolerance / 10),
        fall=fall,
        axis_error=np.stack(alone, axis=-1),
        points=points,
        weights=weights,
        edges=work.root[index] * spacing[:, None],
        shape=tuple(int(n) for n in counts),
    )


def _along(terms: Array, axis: int) -> Array:
    """Sums (b, 1 + 2C, nodes) over all axes but one."""
    others = tuple(k + 2 for k in range(terms.ndim - 2) if k != axis)
    return np.asarray(terms.sum(axis=others)) if others else terms


def _resolution(terms: Array) -> tuple[Array, Array, Array]:
    """Error of ln Z (b,), of means and of sds (b, C), from the spacing of the nodes.

    Every second node alone changes them by δ₂, every fourth alone by δ₄. Halving the spacing
    squares the trapezoid rule's error where the density is analytic, and divides it by a power of
    two where it has a kink: the error of all nodes is δ₂³/δ₄² in the one case, δ₂²/δ₄ in the
    other. Three times the latter is claimed, with no trust in a δ₄ above a tenth, as errors of
    order one no longer fall in any order.
    """
    second, fourth = _thinned(terms, 2), _thinned(terms, 4)
    error, mean_error, sd_error = (_claim(a, b) for a, b in zip(second, fourth, strict=True))
    # Mass that every second node cannot see lies on few nodes, whose moments mean nothing: a
    # single one of them has no error at all.
    lost = (second[0] > LOST)[:, None]
    return error, np.where(lost, 1.0, mean_error), np.where(lost, 1.0, sd_error)


def _claim(second: ArrayLike, fourth: ArrayLike) -> Array:
    """Error claimed of all nodes, given the changes δ₂ and δ₄."""
    second = np.asarray(second)
    trusted = np.clip(fourth, second, np.maximum(second, 0.1))
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(second > 0, second * np.fmin(1.0, 3.0 * second / trusted), 0.0)


def _thinned(terms: Array, step: int) -> tuple[Array, Array, Array]:
    """How ln Z (b,), means and sds (b, C) change when of `step` nodes along each axis one is kept.

    `terms` (b, 1 + 2C, nodes along each axis) are the nodes' shares of the mass, of the first
    moments and of the second, so that with all nodes they sum to 1, 0 and 1.
    """
    axes = range(2, terms.ndim)
    kept = (slice((terms.shape[k] - 1) % step // 2, None, step) for k in axes)
    sums = terms[slice(None), slice(None), *kept].sum(axis=tuple(axes))
    mass = sums[:, 0] * float(step) ** len(axes)
    known = mass > 0
    columns = terms.shape[1] // 2
    moments = sums[:, 1:] / np.where(known, sums[:, 0], 1.0)[:, None]
    first, second = moments[:, :columns], moments[:, columns:]
    sd = np.sqrt(np.maximum(second - first**2, 0.0))
    never = np.where(known, 0.0, np.inf)
    return (
        np.abs(np.log(np.where(known, mass, 1.0))) + never,
        np.abs(first) + never[:, None],
        np.abs(sd - 1.0) + never[:, None],
    )


def _edges(along: list[Array], cell: NDArray[np.int64]) -> tuple[Array, Array, Array, Array]:
    """Mass beyond the ends of each axis (b, 2, D), its pull on means and sds (b, 2, D, C), and
    the factor by which they fall from cell to cell (b, 2, D); `cell` (D,) is in nodes.

    Mass and second moments are taken to go on falling as from the last two cells but two to the
    last two (single nodes hit or miss a thin bent ridge), with a cell to spare. Twice that,
    because a power law falls ever more slowly: in the variance of Student's t with three degrees
    of freedom the factor is just two.
    """
    columns = along[0].shape[1] // 2
    layers = []
    for terms, two in zip(along, 2 * cell, strict=True):
        blocks = slice(0, two), slice(two, 2 * two), slice(-2 * two, -two), slice(-two, None)
        layers.append(np.stack([terms[..., block].sum(axis=-1) for block in blocks], axis=1))
    pairs = np.stack(layers, axis=2)
    outer, inner = pairs[:, [0, 3]], pairs[:, [1, 2]]
    judged = [0, *range(columns + 1, 2 * columns + 1)]
    with np.errstate(over="ignore"):  # layers that grow without measure are clipped below
        ratio = outer[..., judged] / np.where(inner[..., judged] > 0, inner[..., judged], 1.0)
    fall = np.sqrt(np.clip(ratio.max(axis=-1), 0.0, SLOWEST_FALL**2))
    beyond = 2.0 * outer * (fall / (1.0 + fall) / (1.0 - fall))[..., None]
    pull = np.abs(beyond[..., 1 : columns + 1])
    return beyond[..., 0], pull, beyond[..., columns + 1 :] / 2, fall


def _extent(mass: Array, cells: NDArray[np.int64], share: float) -> NDArray[np.int64]:
    """Cells (b, 2, D) out to the last layers that hold this share of the mass."""
    dim = mass.ndim - 1
    out = np.empty_like(cells)
    for k in range(dim):
        others = tuple(axis for axis in range(1, dim + 1) if axis != k + 1)
        holds = mass.sum(axis=others) > share
        count = holds.shape[1]
        out[:, 0, k] = cells[:, 0, k] - holds.argmax(axis=1)
        out[:, 1, k] = count - 1 - holds[:, ::-1].argmax(axis=1) - cells[:, 0, k]
    return np.maximum(out, 1)


@lru_cache
def _fitting(tolerance: float, dim: int) -> float:
    """Width of a cell that a Gaussian needs.

    With nodes H apart the trapezoid rule changes its variance by 2 u exp(-u), u = 2π²/H². What
    `_resolution` makes of this is held to a quarter of the tolerance.
    """

    def change(h: float) -> float:
        u = 2.0 * np.pi**2 / h**2
        return float(min(dim * 2.0 * u * np.exp(-u), 1.0))

    width = 1.2
    while _claim(change(2.0 * width), change(4.0 * width)) > tolerance / 4.0:
        width *= 0.98
    return width


def _columns(points: Array, weights: Array, functions: Functions | None) -> Array:
    """Coordinates and functions of them side by side, (b, N, C); 0 where the density is 0."""
    if functions is None:
        return points
    extra = np.asarray(functions(points), dtype=float)
    if extra.ndim != 3 or extra.shape[:2] != points.shape[:2]:
        raise ValueError(
            f"functions must return shape {(*points.shape[:2], 'Q')} for points of shape "
            f"{points.shape}, got {extra.shape}; put the quantities on the last axis."
        )
    inside = weights[..., None] > 0
    if not np.all(np.isfinite(extra) | ~inside):
        bad = np.argwhere(inside & ~np.isfinite(extra))[0]
        raise ValueError(
            f"functions must be finite where the density is not zero, got {extra[tuple(bad)]} at "
            f"{points[tuple(bad[:2])].tolist()}; return -inf as log-density there."
        )
    return np.concatenate([points, np.where(inside, extra, 0.0)], axis=-1)


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
