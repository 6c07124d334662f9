"""Layers: unknowns that have a prior alone, each summed over even nodes of its coordinate.

Friction, stiffness, curvature, hinge, roll and azimuth are not bounded by the whisker. At each node
of theirs distance and angle have a tree of their own, which is kept, with its own range of angles.
Nodes are halved where the sums over odd and even ones disagree. (One tree of all axes fails: its
cells are thin oblique sheets, up to a million a reading.)
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from itertools import product
from typing import Any

import numpy as np
from scipy.special import ndtr

from .._util.values import Array, Flags, Index
from .coordinates import within_half_turn
from .nodes import HALVINGS, TURN, Axis, Conditional
from .observer import Observer
from .tree import DROP, Tree, tree_of
from .weighted import OVER, Spans, Sums, extrapolated, interpolate, mixed, resampled

__all__ = ["SCORES", "LayeredSums", "Layers"]

#: Normal scores at which conditional quantiles are interpolated from node to node.
SCORES = np.linspace(-4.5, 4.5, 37)
#: Parts of a step between nodes at which conditional posteriors are interpolated.
PARTS = 8


@dataclass(eq=False)
class _Node:
    """Evidence and moments of all readings at one node; a guess alone where there is no mass."""

    log: Array
    guess: Array
    mean: Array
    sd: Array
    error: Array
    parts: list[tuple[Index, Sums]] = field(default_factory=list)


class Layers:
    """Posteriors of an observer some of whose unknowns have priors alone, or are given at nodes."""

    def __init__(
        self, observer: Observer, tolerance: float, inner: int | None = None,
        given: Mapping[str, int] | None = None,
    ) -> None:  # fmt: skip
        self.observer, self.tolerance, self.given = observer, tolerance, dict(given or {})
        self.inner = observer.bounded if inner is None else inner
        self._all = [Axis(name, observer) for name in observer.unknowns[self.inner :]]
        self.axes = [axis for axis in self._all if axis.name not in self.given]

    def tree(self, node: tuple[int, ...]) -> Tree:
        """The tree at a node."""
        at = dict(zip((axis.name for axis in self.axes), node, strict=True)) | self.given
        standard = {"scaled": 1.0, "turned": 0.0}
        further = tuple(
            standard.get(axis.known, float(axis.value(0 if axis.known else at[axis.name])))
            for axis in self._all
        )
        return tree_of(Conditional(self.observer, further), self.tolerance)

    def sums(
        self, readings: Array, covariance: Array | None = None, *, drop: float = DROP
    ) -> LayeredSums:
        """The posteriors of readings (B, R), with measurement errors' covariances (B, R, R)."""
        out = LayeredSums(self, readings, covariance, drop)
        out.solve()
        return out


class LayeredSums:
    """As `weighted.Sums`, of B readings at nodes, at each of which there are weighted cells."""

    def __init__(
        self, layers: Layers, readings: Array, covariance: Array | None, drop: float
    ) -> None:
        self.layers, self.axes, self.observer = layers, layers.axes, layers.observer
        self.readings, self.covariance, self.drop = readings, covariance, drop
        count, unknowns = len(readings), layers.inner + len(self.axes)
        self.mean, self.sd, self.best = np.full((3, count, unknowns), np.nan)
        self.error, self.log_evidence = np.full(count, np.inf), np.full(count, np.nan)
        self.halvings = np.zeros((count, len(self.axes)), dtype=int)
        self.nodes: dict[tuple[int, ...], _Node] = {}
        self._quantiles: dict[tuple[tuple[int, ...], int], Array] = {}

    @property
    def bytes(self) -> int:
        """Memory of the cells at all nodes, of what is known there, and of quantiles there."""
        cells = sum(sums.bytes for node in self.nodes.values() for _, sums in node.parts)
        return cells + 8 * len(self.nodes) * len(self.readings) * (8 + len(SCORES))

    def solve(self) -> None:
        """Halve nodes until sums over odd and even ones agree."""
        todo = np.arange(len(self.readings))
        halvings = np.zeros(len(self.axes), dtype=int)
        before: tuple[Any, ...] = ()
        while todo.size:
            keys = self._keys(halvings)
            self._evaluate(keys, todo, before)
            each = self._sum(keys, halvings, todo)
            self.halvings[todo] = halvings
            with np.errstate(invalid="ignore"):
                bad = (each > self.layers.tolerance) & (halvings < HALVINGS)[:, None]
            again = bad.any(axis=0)
            before = halvings.copy(), todo
            halvings = halvings + bad.any(axis=1)
            todo = todo[again]

    def _keys(self, halvings: Index) -> list[Index]:
        return [axis.nodes(int(h)) for axis, h in zip(self.axes, halvings, strict=True)]

    def _table(self, keys: list[Index], rows: Index, name: str) -> Array:
        """A column of all nodes (..., n), or (..., n, U)."""
        parts = [
            getattr(self.nodes[key], name)[rows] for key in product(*map(np.ndarray.tolist, keys))
        ]
        return np.stack(parts).reshape(*map(len, keys), *parts[0].shape)

    def _evaluate(self, keys: list[Index], rows: Index, before: tuple[Any, ...]) -> None:
        """Ask the trees of all nodes that may have mass."""
        every = list(product(*map(np.ndarray.tolist, keys)))
        count, inner = len(self.readings), self.layers.inner
        bound = self._bound(keys, rows, *before) if before else None
        for key in every:
            if key not in self.nodes:
                self.nodes[key] = _Node(
                    np.full(count, np.nan), np.full(count, -1e5), np.zeros((count, inner)),
                    np.zeros((count, inner)), np.zeros(count),
                )  # fmt: skip
            node = self.nodes[key]
            if bound is not None and key in bound:
                without, guess = bound[key]
                without = np.isnan(node.log[rows]) & without
                node.log[rows[without]] = -np.inf
                node.guess[rows[without]] = guess[without]
        new = [key for key in every if np.isnan(self.nodes[key].log[rows]).any()]
        best = self._table(keys, rows, "log").reshape(-1, len(rows))
        best = np.where(np.isnan(best), -np.inf, best).max(axis=0)
        if not before:  # first the node where each reading is most probable at a glance
            glimpse = np.stack([self._glimpse(key, rows) for key in new])
            most = glimpse.argmax(axis=0)
            for i in np.unique(most):
                self._ask(new[i], rows[most == i], best[most == i])
                best[most == i] = self.nodes[new[i]].log[rows[most == i]]
        for key in new:
            wanted = np.isnan(self.nodes[key].log[rows])
            if wanted.any():
                self._ask(key, rows[wanted], best[wanted])
                np.maximum(best, self.nodes[key].log[rows], out=best)

    def _bound(
        self, keys: list[Index], rows: Index, halvings: Index, before: Index
    ) -> dict[tuple[int, ...], tuple[Flags, Array]]:
        """Whether new nodes have next to no mass, by their neighbours, and the evidence there."""
        old = self._keys(halvings)
        log = self._table(old, rows, "guess")
        # Between nodes it may be higher by an eighth of its second difference, as a parabola is:
        # twice that is allowed for.
        rise = np.zeros_like(log)
        for d, axis in enumerate(self.axes):
            if axis.around:
                second = np.roll(log, 1, d) + np.roll(log, -1, d) - 2 * log
            else:
                pad = [(1, 1) if i == d else (0, 0) for i in range(log.ndim)]
                second = np.diff(np.pad(log, pad, mode="reflect", reflect_type="odd"), 2, axis=d)
            rise += np.abs(second) / 4
        top = log.reshape(-1, len(rows)).max(axis=0)
        possible = log + rise > top - self.drop
        out = {}
        places = [{int(k): i for i, k in enumerate(o)} for o in old]
        for key in product(*map(np.ndarray.tolist, keys)):
            near = []
            for k, axis, o, at in zip(key, self.axes, old, places, strict=True):
                if k in at:
                    near.append([at[k]])
                    continue
                step = int(o[1] - o[0])
                i = int((k - o[0]) // step)
                after = (i + 1) % len(o) if axis.around else i + 1
                near.append([i, after])
            if any(len(n) > 1 for n in near):
                beside = list(product(*near))
                without = ~np.any([possible[i] for i in beside], axis=0)
                out[key] = without, np.mean([log[i] for i in beside], axis=0)
        return out

    def _asked(self, key: tuple[int, ...], rows: Index) -> tuple[Array, Array | None, Any]:
        """What to ask of the tree at a node, and ln of the Jacobian and of the prior there."""
        readings, slope = self.readings[rows], 0.0
        covariance = None if self.covariance is None else self.covariance[rows]
        for axis, k in zip(self.axes, key, strict=True):
            readings, covariance, own = axis.asked(readings, covariance, k)
            slope += own + float(axis.log_prior(k))
        return readings, covariance, slope

    def _glimpse(self, key: tuple[int, ...], rows: Index) -> Array:
        """About how probable readings are at a node, in nats."""
        readings, covariance, slope = self._asked(key, rows)
        return np.asarray(self.layers.tree(key).glimpse(readings, covariance) + slope)

    def _ask(self, key: tuple[int, ...], rows: Index, best: Array) -> None:
        """Sum over the cells at a node, where they may have mass beside the `best` other node."""
        node, (readings, covariance, slope) = self.nodes[key], self._asked(key, rows)
        least = best - 2 * self.drop
        found = self.layers.tree(key).sums(
            readings, covariance, drop=self.drop, least=least - slope
        )
        known = np.isfinite(found.log_evidence)
        node.log[rows] = np.where(known, found.log_evidence + slope, -np.inf)
        node.guess[rows] = np.maximum(np.where(known, node.log[rows], least), -1e5)
        node.mean[rows], node.sd[rows] = np.nan_to_num(found.mean), np.nan_to_num(found.sd)
        node.error[rows] = np.where(known, found.error, 0.0)
        node.parts.append((rows, found))
        for unknown in range(self.layers.inner):
            self._quantiles.pop((key, unknown), None)

    def _sum(self, keys: list[Index], halvings: Index, rows: Index) -> Array:
        """Sum over nodes; about how far off the sums along each axis are, (D, n)."""
        inner = self.layers.inner
        log = self._table(keys, rows, "log").reshape(-1, len(rows))
        mean, sd = (
            self._table(keys, rows, n).reshape(-1, len(rows), inner) for n in ("mean", "sd")
        )
        top = log.max(axis=0)
        with np.errstate(invalid="ignore"):
            weight = np.where(np.isfinite(top), np.exp(log - top), 0.0)
        best = log.argmax(axis=0)
        grid = np.stack([a.ravel() for a in np.meshgrid(*keys, indexing="ij")])
        values, middle = [], []
        for axis, own in zip(self.axes, grid, strict=True):
            value = np.broadcast_to(axis.value(own)[:, None], log.shape)
            if axis.around:  # counted from the best, a half turn either way
                at_best = value[best, np.arange(len(rows))]
                value = at_best + within_half_turn(value - at_best)
            values.append(value)
            middle.append(value[best, np.arange(len(rows))])

        def moments(weight: Array) -> tuple[Array, Array, Array]:
            total = np.maximum(weight.sum(axis=0), 1e-300)
            means, variances = [], []
            for i in range(inner):
                m = (weight * mean[..., i]).sum(axis=0) / total
                means.append(m)
                square = sd[..., i] ** 2 + (mean[..., i] - m) ** 2
                variances.append((weight * square).sum(axis=0) / total)
            for value in values:
                m = (weight * value).sum(axis=0) / total
                means.append(m)
                variances.append((weight * (value - m) ** 2).sum(axis=0) / total)
            return total, np.stack(means, axis=-1), np.sqrt(np.stack(variances, axis=-1))

        total, self.mean[rows], self.sd[rows] = moments(weight)
        own_sd = np.maximum(self.sd[rows], 1e-300)
        each = np.zeros((len(keys), len(rows)))
        for d, k in enumerate(keys):
            odd = ((grid[d] - k[0]) // (k[1] - k[0]) % 2).astype(bool)
            for half in (odd, ~odd):
                t, m, s = moments(weight * half[:, None])
                off = np.maximum(np.abs(m - self.mean[rows]), np.abs(s - own_sd)) / own_sd
                each[d] = np.maximum.reduce([each[d], np.abs(2 * t / total - 1), off.max(axis=1)])
        each = np.minimum(each, 1e100)
        # Sums over every other node are worse: on a circle as cells' are in `weighted.Sums.add`,
        # along a friction as over a density with kinks: a third of 6.7e-3 where 2.2e-3 was missed.
        for d, axis in enumerate(self.axes):
            each[d] = each[d] ** 2 if axis.around else each[d] / 3
        inside = (weight * self._table(keys, rows, "error").reshape(weight.shape)).sum(axis=0)
        self.error[rows] = np.maximum(each.max(axis=0), inside / total)
        steps = sum(np.log(a.unit * (k[1] - k[0])) for a, k in zip(self.axes, keys, strict=True))
        self.log_evidence[rows] = top + np.log(total) + steps
        for i, value in enumerate(middle):
            self.best[rows, inner + i] = value
        every = list(product(*map(np.ndarray.tolist, keys)))
        for j in np.unique(best):
            for some, found in self.nodes[every[j]].parts:
                mine = np.isin(some, rows[best == j])
                self.best[some[mine], :inner] = found.best[mine]
        none = ~np.isfinite(top)
        self.error[rows[none]], self.log_evidence[rows[none]] = np.inf, np.nan
        self.mean[rows[none]], self.sd[rows[none]] = np.nan, np.nan
        return each

    # -- quantiles and draws -----------------------------------------------------------------------

    def _refine(self, rows: Index, rough: Any) -> None:
        """Halve nodes of readings whose conditional posteriors are too `rough` between them."""
        while rows.size:
            left = []
            for halvings in np.unique(self.halvings[rows], axis=0):
                own = rows[(self.halvings[rows] == halvings).all(axis=1)]
                bad = rough(self._keys(halvings), own) & (halvings < HALVINGS)[:, None]
                again = bad.any(axis=0)
                if again.any():
                    finer = halvings + bad.any(axis=1)
                    self._evaluate(self._keys(finer), own[again], (halvings, own[again]))
                    self.halvings[own[again]] = finer
                    left.append(own[again])
            rows = np.concatenate(left) if left else rows[:0]

    def _conditionals(self, keys: list[Index], rows: Index) -> tuple[Array, Array, Array]:
        """ln of the evidence (n, ..., B) below the best, and conditional means and sds."""
        log, mean, sd = (self._table(keys, rows, name) for name in ("log", "mean", "sd"))
        return log - log.reshape(-1, len(rows)).max(axis=0), mean, sd

    def _not_smooth(self, keys: list[Index], rows: Index) -> Flags:
        """Along which axes cubics between nodes are off, (D, B): by those of twice the step.

        What a node's conditional mean is off, in its own sds, moves quantiles by its share of the
        mass; at 2.5 % that is seven times as many sds.
        """
        log, mean, sd = self._conditionals(keys, rows)
        share = np.exp(log)
        share /= share.reshape(-1, len(rows)).sum(axis=0)
        out = np.zeros((len(keys), len(rows)), dtype=bool)
        for d, axis in enumerate(self.axes):
            around = partial(_shifted, axis=d, circle=axis.around)
            with np.errstate(invalid="ignore", divide="ignore"):
                off = mean - (9 * (around(mean, 1) + around(mean, -1))
                              - around(mean, 3) - around(mean, -3)) / 16  # fmt: skip
                off = np.nan_to_num(np.abs(off / sd).max(axis=-1), posinf=0.0)
            near = np.min([around(log, k) for k in (-3, -1, 1, 3)], axis=0) > -self.drop
            off = np.where(near, 7 * share * off, 0.0)
            # The error of fourth order is a sixteenth of that at half the steps; an end of an
            # interval may be 5e-3 sd off.
            out[d] = off.reshape(-1, len(rows)).max(axis=0) / 16 > 5e-3
        return out

    def _far_apart(self, keys: list[Index], rows: Index) -> Flags:
        """Along which axes conditional posteriors are further apart than wide, (D, B)."""
        log, mean, sd = self._conditionals(keys, rows)
        out = np.zeros((len(keys), len(rows)), dtype=bool)
        for d, axis in enumerate(self.axes):
            around = partial(_shifted, axis=d, circle=axis.around)
            with np.errstate(divide="ignore", invalid="ignore"):
                step = np.abs(around(mean, 1) - mean) / np.minimum(sd, around(sd, 1))
            near = (log > -9.0) & (around(log, 1) > -9.0)
            step = np.where(near, np.nan_to_num(step).max(axis=-1), 0.0)
            out[d] = step.reshape(-1, len(rows)).max(axis=0) > 1.0
        return out

    def _box(self, row: int) -> tuple[list[Index], Array]:
        """The nodes about the mass of one reading along each axis, and ln of the evidence there."""
        keys = self._keys(self.halvings[row])
        log = self._table(keys, np.array([row]), "log")[..., 0]
        log = np.nan_to_num(log, nan=-np.inf)
        best = np.unravel_index(log.argmax(), log.shape)
        out = []
        for d, axis in enumerate(self.axes):
            own = keys[d]
            if axis.around:  # from the node opposite to the best on
                shift = len(own) // 2 - int(best[d])
                log = np.roll(log, shift, axis=d)
                step = own[1] - own[0]
                own = own[best[d]] + step * (np.arange(len(own)) - len(own) // 2)
            along = np.moveaxis(log, d, 0).reshape(len(own), -1).max(axis=1)
            live = np.flatnonzero(along > log.max() - self.drop)
            low, high = max(live[0] - 1, 0), min(live[-1] + 2, len(own))
            if high - low < 2:
                low, high = max(low - 1, 0), min(high + 1, len(own))
            log = np.take(log, np.arange(low, high), axis=d)
            out.append(own[low:high])
        return out, log

    def _wrapped(self, key: tuple[int, ...]) -> tuple[int, ...]:
        """A node on the first turn."""
        out = []
        for axis, k in zip(self.axes, key, strict=True):
            half = TURN // 2 * 2**HALVINGS
            out.append(int((k + half) % (2 * half) - half) if axis.around else int(k))
        return tuple(out)

    def spans(self, unknown: int, stride: int = 1) -> Iterator[Spans]:
        """Spans of an unknown, for one reading at a time; half as many with a stride of 2."""
        inner = self.layers.inner
        known = np.flatnonzero(np.isfinite(self.log_evidence))
        if unknown < inner:
            self._refine(known, self._not_smooth)
        for row in known:
            keys, log = self._box(int(row))
            at = np.array([row])
            if unknown >= inner:
                d = unknown - inner
                other = tuple(i for i in range(log.ndim) if i != d)
                along = np.logaddexp.reduce(log, axis=other) if other else log
                x, fine = interpolate(along[None], 2 * PARTS // stride)
                step = keys[d][1] - keys[d][0]
                value = self.axes[d].value(keys[d][0] + step * x)
                density = np.exp(fine - fine.max())
                mass = (density[:, 1:] + density[:, :-1]) / 2
                yield Spans(at, value[None, :-1], value[None, 1:], mass)
                continue
            held = log > log.max() - self.drop
            quantile = np.full((*log.shape, len(SCORES)), np.nan)
            for i in zip(*np.nonzero(held), strict=True):
                key = self._wrapped(tuple(int(k[j]) for k, j in zip(keys, i, strict=True)))
                quantile[i] = self._conditional(key, unknown)[row]
            held &= np.isfinite(quantile[..., 0])
            yield mixed(at, log, held, quantile[..., ::stride], SCORES[::stride], PARTS // stride)

    def _conditional(self, key: tuple[int, ...], unknown: int) -> Array:
        """Quantiles (B, Q) at a node, of the readings that have mass there."""
        if (key, unknown) not in self._quantiles:
            node = self.nodes[key]
            table = np.full((len(self.readings), len(SCORES)), np.nan)
            for rows, found in node.parts:
                wanted = node.log[rows] > self.log_evidence[rows] - self.drop
                if wanted.any():  # half as fine as where there are no nodes
                    table[rows] = extrapolated(found, ndtr(SCORES), unknown, 2, wanted)
            self._quantiles[key, unknown] = table
        return self._quantiles[key, unknown]

    def quantiles(self, p: Array, unknown: int) -> Array:
        """Quantiles (B, Q) of an unknown."""
        return extrapolated(self, p, unknown)

    def draws(self, count: int, rng: np.random.Generator, readings: Array) -> Array:
        """Draws (B, count, U) of the contact, given the readings (B, R)."""
        out = np.full((len(self.readings), count, len(self.observer.unknowns)), np.nan)
        known = np.flatnonzero(np.isfinite(self.log_evidence))
        self._refine(known, self._far_apart)
        for row in known:
            keys, log = self._box(int(row))
            weight = np.exp(0.75 * (log - log.max())).ravel()
            weight /= weight.sum()
            many = rng.multinomial(OVER * count, weight)
            x, z, log_of = [], [], []
            for i in np.flatnonzero(many):
                at = np.unravel_index(i, log.shape)
                own = tuple(k[j] for k, j in zip(keys, at, strict=True))
                for rows, found in self.nodes[self._wrapped(own)].parts:
                    if row in rows:
                        place = int(np.flatnonzero(rows == row)[0])
                        proposed, log_proposed = found.proposals(int(many[i]), rng, place)
                        x.append(proposed)
                        step = np.array([k[1] - k[0] for k in keys])
                        z.append(own + step * (rng.random((len(x[-1]), len(own))) - 0.5))
                        log_of.append(log_proposed + np.log(weight[i]))
            some, node = np.concatenate(x), np.concatenate(z)
            further = [axis.value(k) for axis, k in zip(self.axes, node.T, strict=True)]
            contact, log_density = self.observer.contact(some, further=further)
            log_density += sum(a.log_prior(k) for a, k in zip(self.axes, node.T, strict=True))
            log_density += self.observer.log_likelihood(self.readings[row], contact)
            chosen = resampled(log_density - np.concatenate(log_of), count, rng)
            out[row] = contact[chosen]
        return out


def _shifted(values: Array, by: int, *, axis: int, circle: bool) -> Array:
    """Values moved along an axis; −inf from beyond its ends, unless it is a circle."""
    moved = np.roll(values, -by, axis=axis)
    if not circle:
        beyond = [slice(None)] * values.ndim
        beyond[axis] = slice(-by, None) if by > 0 else slice(0, -by)
        moved[tuple(beyond)] = -np.inf
    return moved
