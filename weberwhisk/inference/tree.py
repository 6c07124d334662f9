"""The tree: cells over an observer's coordinates, from coarse to fine, the same for all readings.

Cells are evaluated once, when a reading first needs them, and kept with the observer. A reading
descends from the coarse cells to fine ones, many readings together. It keeps a cell if it could
come from it, were it as uncertain as the signals vary across the cell, and halves the axes along
which the signals change by more than a step of the trapezoidal rule may. The last cells are an even
lattice for that reading, and its integrals are plain sums over them: in coordinates without edges
the trapezoidal rule converges as fast as it does for a Gaussian, with an error of
exp(−2π²/h²) at steps of h sds (Trefethen & Weideman 2014, SIAM Review 56, 385).
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np

from .._util.values import Array, Index
from .cells import Cells, Level
from .conditional import Conditional, Evaluated
from .coordinates import within_half_turn
from .observer import Observer
from .terms import GaussianTerm, OtherTerm

__all__ = ["DROP", "MEMORY", "PAIRS", "ROOT_STEP", "TOLERANCE", "Tree", "tree_of"]

#: Error of means and sds, in sds, above which posteriors are `IMPRECISE`.
TOLERANCE = 2e-3
#: Step of the first cells, in the observer's coordinates; a sixteenth of it with one unknown. At
#: 1.0 narrow parts of posteriors of whiskers that rub were not found (19 of 225 readings).
ROOT_STEP = 0.5
#: Cells whose density is so many nats below the highest are left out. At 15, 2 of 225 posteriors
#: of whiskers that rub lost a part; at 20 none, and sums agree to 1e-7.
DROP = 20.0
#: Bytes of cells that are kept for all observers together, a quarter more while readings need them;
#: half as much again for a posterior's readings. Set it before the first posterior. An unknown
#: friction takes 1 GB in all, and is no quicker with twice as much.
MEMORY = 250_000_000
#: Pairs of a reading and a cell that are weighed together: 150 000 fit the cache.
PAIRS = 150_000


class Tree:
    """The tree of one or two unknowns of an observer, the others being given at nodes.

    Parameters
    ----------
    observer : Conditional
    tolerance : float
        Error of means and sds, in sds, above which a reading's lattice is refined.
    """

    def __init__(self, observer: Conditional, tolerance: float) -> None:
        self.observer, self.unknowns = observer, len(observer.unknowns)
        # Of kinks halves tell the error to a third of it; cells of one unknown are next to free.
        self.tolerance = tolerance / 10 if self.unknowns == 1 else tolerance
        # The share of the mass by which the trapezoidal rule may be off: at this one means are up
        # to 2e-4 sd off at k = 0.3, at 100 times it 3e-3. With one unknown a step more costs next
        # to nothing.
        self.share = tolerance / 2000 if self.unknowns > 1 else min(tolerance / 2000, 1e-8)
        # Three times as fine is 64 times the error of an edge, and any other is gone.
        self.refinements = 12 if self.unknowns == 1 else 3
        # More nats on the way, as cells are judged by their middles; cells of one unknown are few.
        self.slack = 100.0 if self.unknowns == 1 else 4.0
        self.evaluated = 0
        #: The coarse cells, and by number of what is given where they begin and how many they are.
        self.start = Level(np.ones(self.unknowns))
        self.begins, self.counts = np.zeros((2, 0), dtype=int)
        #: Along each axis, the inner ends of the first and of the last of the coarse cells.
        self.inner_ends = np.zeros((2, self.unknowns))

    # -- evaluation --------------------------------------------------------------------------------

    def _prepare(self, signals: int, scores: int) -> None:
        noise, circular = self.observer.observer.noise, self.observer.observer.circular
        components = noise.components(signals)
        self.gaussian = (
            GaussianTerm(noise, signals, circular)
            if any(c.noise.gaussian_on for c in components)
            else None
        )
        self.others = [OtherTerm(*c) for c in components if not c.noise.gaussian_on]
        self.size = self.gaussian.size if self.gaussian else 0
        probe = np.ones((1, signals))
        separate = sum(term.features(probe)[0].shape[1] for term in self.others)
        self.scores, self.smooth = scores, self.observer.observer.is_smooth
        # Features: Gaussian means, stabilised others, scores of priors, ln of the prior.
        self.features = self.size + separate + scores + 1

    def _features(self, at: Evaluated) -> tuple[Array, Array]:
        """What is smooth across cells (N, F), and what of it one JND is, (N, F − 1)."""
        terms = ([self.gaussian] if self.gaussian else []) + self.others
        terms_at = [term.features(at.signals) for term in terms]
        place = [*(p for p, _ in terms_at), at.scores, at.log_prior[:, None]]
        scale = [*(s for _, s in terms_at), np.ones_like(at.scores)]
        return np.concatenate(place, axis=1), np.concatenate(scale, axis=1)

    def _between(self, change: Array) -> Array:
        """Changes of features (..., F), of directions the shorter way round."""
        if self.gaussian and self.gaussian.circular.size:
            turning = self.gaussian.circular
            change[..., turning] = within_half_turn(change[..., turning])
        return change

    def _cells(
        self, which: Index, place: Index, at: Evaluated, scale: Array, change: Array, level: Level
    ) -> Cells:
        """Cells at integer places (N, U).

        `which` (N,) says what is given; `change` (U, N, F) is by how much features change across a
        cell along each axis.
        """
        size, mean = self.size, np.empty((len(place), 0))
        total = np.abs(change).sum(axis=0)
        with np.errstate(divide="ignore", invalid="ignore"):
            # Not where noise vanishes with the signal: its square is no number.
            possible = np.isfinite(at.log_prior) & (scale > 1e-150).all(axis=1)
            scale = np.where(possible[:, None], scale, 1.0)
            log_prior = np.where(possible, at.log_prior, -np.inf)
            sd = scale[:, :size]
            # Curvature bends signals further within large cells.
            blur = 1.0 if level.depth < 2 else 0.36
            across = total[:, :size].copy()
            if self.gaussian:
                mean, turning = self.gaussian.features(at.signals)[0], self.gaussian.circular
                if turning.size:  # a force that may vanish within the cell may turn round there
                    any_way = np.abs(mean) < across / 2
                    any_way = np.delete(any_way, turning, axis=1).any(axis=1)
                    across[np.ix_(any_way, turning)] = np.pi
            blurred = np.sqrt(sd**2 + blur * across**2)
            # A cell may be from where the prior is higher: as far as it rises, and of a prior
            # with a score, as far as that comes towards its middle.
            score = np.abs(at.scores)
            nearer = np.maximum(score - total[:, -1 - self.scores : -1] / 2, 0.0)
            rise = 0.5 * (score**2 - nearer**2).sum(axis=1) + 0.5 * total[:, -1]
            log_constant = log_prior + (self.gaussian.constant if self.gaussian else 0.0)
            # Flat priors are as wide as 1 or so in the coordinates, for which a step counts.
            prior_square = (2.5 * level.step) ** 2
            length = change[..., :-1] / scale
            if self.gaussian:
                length[..., :size] = self.gaussian.uncorrelated(length[..., :size])
            square = np.square(length).sum(axis=2) + prior_square[:, None]
            jnds = (
                total[:, size : -1 - self.scores] / scale[:, size : scale.shape[1] - self.scores]
            )
            other_length = np.sqrt(np.square(jnds).sum(axis=1))
        self.evaluated += len(place)
        return Cells(
            given=which,
            place=place.T.astype(np.int32),
            contact=at.contact[:, : self.unknowns].T,
            log_prior=log_prior,
            rise=rise,
            mean=mean.T,
            precision=1 / sd.T,
            blurred_precision=1 / blurred.T,
            log_scale=log_constant - np.log(sd).sum(axis=1),
            blurred_log_scale=log_constant - np.log(blurred).sum(axis=1),
            length=np.sqrt(square),
            change=change.transpose(0, 2, 1).reshape(self.unknowns * self.features, -1),
            signals=at.signals.T if self.others else np.empty((0, len(place))),
            other_length=other_length,
        )

    def begin(self, which: Index) -> None:
        """Evaluate the coarse cells over all contacts where there are none, at numbers (n,).

        They and how much signals change across them are read off a lattice of half the step: the
        change along an axis from its middle to either side, and the range over all 3^U points, by
        which it is raised where signals are not monotonic.
        """
        new = np.setdiff1d(which, np.flatnonzero(self.counts >= 0))
        if not new.size:
            return
        unknowns = self.unknowns
        low, high = self.observer.observer.ends(unknowns)
        root = ROOT_STEP if unknowns > 1 else ROOT_STEP / 16
        step = np.full(unknowns, root)
        first = np.floor(low / step).astype(int)
        count = np.ceil(high / step).astype(int) + 1 - first
        self.inner_ends = np.stack([first + 1, first + count - 1]) * root
        pairs = zip(first, count, strict=True)
        axes = [0.5 * (2 * f + np.arange(2 * n + 1)) * root for f, n in pairs]
        x = np.stack([a.ravel() for a in np.meshgrid(*axes, indexing="ij")], axis=-1)
        at = self.observer.evaluate(np.tile(x, (new.size, 1)), np.repeat(new, len(x)))
        if not self.start.count:
            self._prepare(at.signals.shape[1], at.scores.shape[1])
            self.start = Level(step)
        features, scale = self._features(at)
        shape = new.size, *(2 * count + 1)
        possible = np.isfinite(at.log_prior).reshape(shape)
        grid = features.reshape(*shape, -1)

        def moved(corner: Sequence[int]) -> tuple[slice, ...]:
            pairs = zip(corner, count, strict=True)
            return slice(None), *(slice(c, c + 2 * n, 2) for c, n in pairs)

        centre = moved([1] * unknowns)
        middle, inside = grid[centre], possible[centre]

        def off(corner: Sequence[int]) -> Array:
            """How far features at a corner (0, 1 or 2 along each axis) are off the middle's."""
            with np.errstate(invalid="ignore"):
                value = np.abs(self._between(grid[moved(corner)] - middle))
                value[..., -1] = np.maximum(grid[moved(corner)] - middle, 0.0)[..., -1]
            return np.where((inside & possible[moved(corner)])[..., None], value, 0.0)

        offs = {corner: off(corner) for corner in product((0, 1, 2), repeat=unknowns)}
        sides = [
            [tuple(1 + side * (i == d) for i in range(unknowns)) for side in (-1, 1)]
            for d in range(unknowns)
        ]
        change = np.stack([2 * np.maximum(offs[below], offs[above]) for below, above in sides])
        farthest = np.max(list(offs.values()), axis=0)
        with np.errstate(invalid="ignore", divide="ignore"):
            more = np.nan_to_num(2 * farthest / change.sum(axis=0), posinf=1.0, nan=1.0)
            change[..., :-1] *= np.maximum(more, 1.0)[..., :-1]
            for d, (below, above) in enumerate(sides):  # with signs, for correlated noise
                rise = self._between(grid[moved(above)] - grid[moved(below)])
                change[d] *= np.where(rise < 0, -1, 1)
        place = np.tile(np.indices(count).reshape(unknowns, -1).T + first, (new.size, 1))
        chosen = np.flatnonzero(inside.ravel())
        cells = np.arange(possible.size).reshape(shape)[centre].ravel()[chosen]
        at_middle = Evaluated(*(column[cells] for column in at))
        change = change.reshape(unknowns, -1, features.shape[1])[:, chosen]
        number = np.repeat(new, inside[0].size)[chosen]
        begin = self.start.append(
            self._cells(number, place[chosen], at_middle, scale[cells], change, self.start)
        )
        room = max(int(new.max()) + 1 - len(self.counts), 0)
        self.begins, self.counts = (
            np.append(a, np.full(room, -1)) for a in (self.begins, self.counts)
        )
        self.counts[new] = inside.reshape(new.size, -1).sum(axis=1)
        self.begins[new] = begin + np.cumsum(self.counts[new]) - self.counts[new]

    def split(self, level: Level, pattern: tuple[int, ...], cells: Index) -> tuple[Level, Index]:
        """Halves of cells (P,) along the axes of a pattern: their level, and the first of each."""
        unknowns, shape = self.unknowns, tuple(1 + p for p in pattern)
        count = int(np.prod(shape))
        child, first = level.children.get(pattern) or (
            Level(level.step / shape, level.depth + 1),
            np.zeros(0, dtype=np.int32),
        )
        if len(first) < level.count:
            first = np.append(first, np.full(level.count - len(first), -1, dtype=np.int32))
        halves = np.indices(shape).reshape(unknowns, -1)
        missing = np.unique(cells[first[cells] < 0])
        for begin in range(0, len(missing), PAIRS // count):
            new = missing[begin : begin + PAIRS // count]
            place = level.cells.place[:, new, None].astype(np.intp) * np.array(shape)[:, None, None]
            place = (place + halves[:, None]).reshape(unknowns, -1).T
            which = np.repeat(level.cells.given[new], count)
            at = self.observer.evaluate((place + 0.5) * child.step, which)
            features, scale = self._features(at)
            before = level.cells.change[:, new].reshape(unknowns, self.features, -1)
            before = before.transpose(0, 2, 1) / np.array(shape)[:, None, None]
            change = np.repeat(before, count, axis=1)
            possible = np.isfinite(at.log_prior).reshape(len(new), *shape)
            grid = np.where(np.isfinite(features), features, 0.0).reshape(len(new), *shape, -1)
            for d in np.flatnonzero(pattern):
                rise = self._between(np.diff(grid, axis=1 + d))
                rise = np.broadcast_to(rise, grid.shape).reshape(change[d].shape)
                both = possible.all(axis=1 + d, keepdims=True)
                both = np.broadcast_to(both, possible.shape)
                # Where one half is not held, the change is half of what it was across both; nor
                # is it trusted to be far less than that.
                across = np.copysign(np.maximum(np.abs(rise), 0.5 * np.abs(change[d])), rise)
                change[d] = np.where(both.reshape(-1, 1), across, change[d])
            begun = child.append(self._cells(which, place, at, scale, change, child))
            first[new] = begun + count * np.arange(len(new), dtype=np.int32)
        level.children[pattern] = child, first
        return child, first[cells].astype(np.intp)

    @property
    def bytes(self) -> int:
        """Memory of the cells, and of where the halves of each begin."""
        return (self.start.cells.bytes_each + 4) * self.evaluated if self.start.count else 0

    def forget(self) -> None:
        """Keep the coarse cells alone."""
        self.start.children.clear()
        self.evaluated = self.start.count


# -- trees that are kept ---------------------------------------------------------------------------

_kept: OrderedDict[tuple[Any, int, float], Tree] = OrderedDict()


def tree_of(observer: Observer, tolerance: float, inner: int | None = None) -> Tree:
    """The tree of an observer, kept for the next reading; the least used go first.

    Of its first `inner` unknowns, by default all.
    """
    inner = len(observer.unknowns) if inner is None else inner
    key = observer, inner, tolerance
    tree = _kept.pop(key, None) or Tree(Conditional(observer, inner), tolerance)
    total = sum(kept.bytes for kept in _kept.values()) + tree.bytes
    while total > MEMORY and _kept:
        total -= _kept.popitem(last=False)[1].bytes
    _kept[key] = tree
    return tree
