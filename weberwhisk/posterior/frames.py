"""Where each posterior's grid is: found by coarse passes, widened and refined by fine ones."""

from __future__ import annotations

from collections.abc import Iterator
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from .nodes import Array, Nodes
from .passes import Pass, fitting

COARSE_PASSES, LONG_TRIED = 15, 4
RESOLVED = 0.3  # error of the spacing up to which a coarse pass is believed
DOUBT = 0.1  # share of the tolerance below which it is all that is needed
NEARLY, FINER = 4.0, 0.75  # up to so many tolerances a spacing is cut by this instead of halved
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


class Frames:
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
        self.fitting = fitting(tolerance, self.dim)
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

    def take(self, index: NDArray[np.intp], out: Pass, keep_points: bool) -> None:
        """Record a pass over the posteriors `index`; end each, or choose its next grid."""
        self.evaluations[index] += out.weights.shape[1]
        for name, value in out.found.items():
            shape = (len(self.centre), *value.shape[1:])
            self.found.setdefault(name, np.full(shape, np.nan))[index] = value
        empty = ~np.isfinite(out.found["log_evidence"])
        self.end(index[empty], Status.EMPTY)
        fine = self.fine[index]
        # A coarse pass is often good enough already; of ridges that bend it knows its error badly.
        errors = np.maximum(out.found["mean_error"], out.found["sd_error"])
        enough = ~fine & ~empty & (not self.quantiles)
        enough &= errors.max(axis=1) <= DOUBT * self.tolerance
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

    def reframe(self, index: NDArray[np.intp], out: Pass) -> None:
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

    def refine(self, index: NDArray[np.intp], out: Pass) -> None:
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
