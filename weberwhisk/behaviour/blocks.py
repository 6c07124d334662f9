"""Log-likelihoods on nodes, block by block: tables of log P, and matrix products.

All data sets of one design share their stimuli: the log-probability of every answer at every node
is tabulated once, and the log-likelihood of all of them is counts @ table. A block is one outer
node and many data sets, or many outer nodes and one data set. Biases are taken out group by group,
as they are independent given the rest.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray
from scipy.interpolate import CubicSpline
from scipy.special import expit

from .._util.values import Array, Index
from .axes import Steps, Windows, bias_at, least_bias_sds, outer_signals, score_prior
from .likelihood import WeberModel
from .priors import TINY

__all__ = ["NOTHING", "ChoiceNodes"]

Values = NDArray[Any]

NOTHING = -1e5  # log of what cannot be


@dataclass(frozen=True)
class Group:
    """One bias in a block: its nodes (P, B), the log-density there (P, B, Lo, Hi, r), and the
    highest of it over the nodes (P, Lo, Hi, r)."""

    nodes: Array
    values: Values
    top: Values


@dataclass(frozen=True)
class Block:
    """Some data sets, `rows`, at some outer nodes, with about the same windows.

    `low` and `high` are nodes of the lapses, `log_like` (P, Lo, Hi, r) log-likelihoods with the
    biases integrated, or at their highest.
    """

    outer: Index
    rows: Index
    low: slice
    high: slice
    log_like: Values
    groups: list[Group]


class ChoiceNodes:
    """What is evaluated in one pass: nodes of all axes, tables of the answers there.

    `counts` (R, C) of the trials of every cell need not be whole; rising coordinates of both
    `lapses` are by default even ones over the windows.
    """

    def __init__(
        self,
        model: WeberModel,
        windows: Windows,
        steps: Steps,
        counts: Array,
        dtype: DTypeLike | None = None,
        lapses: tuple[Array, Array] | None = None,
    ) -> None:
        # Single precision as long as sums over all answers are good to a hundredth.
        many = float(model.cells.n.sum()) * steps.power > 1e5
        self.model, self.steps = model, steps
        self.dtype = np.dtype(dtype or (np.float64 if many else np.float32))
        self.least = 1e-30 if self.dtype == np.float32 else TINY  # of a probability
        self.outer = windows.outer(steps.outer)
        self.lapses = windows.lapses(steps.lapse) if lapses is None else lapses
        self.first, self.last = windows.at(self.outer)
        self.d, self.weight = outer_signals(model, self.outer)
        values = [model.at(n, a) for n, a in zip(model.lead[-2:], self.lapses, strict=True)]
        low, high = model.lapses(values[0][:, None], values[1][None])
        lost = np.maximum(low + high, 1.0)  # nodes past the edge stand for places just before it
        shape = self.lapses[0].size, self.lapses[1].size
        self.low, self.high = (np.broadcast_to(a / lost, shape) for a in (low, high))
        self.groups = [np.flatnonzero(model.group == g) for g in range(model.n_groups)]
        self.bias_step = self._bias_steps()
        n = model.cells.n
        self.sides, self.answers = [], []
        self.alone = len(counts) == 1 and model.dispersed is None
        self.given: list[list[Array]] = []
        for c in self.groups:
            sides = [counts[:, c], n[c] - counts[:, c]]
            some = [np.flatnonzero(s.any(axis=0)) for s in sides]
            given = [s[:, i] for s, i in zip(sides, some, strict=True)]
            part = np.hstack([*given, np.ones((len(counts), 1))]) * steps.power
            self.sides.append(some)
            self.given.append([s[0] * steps.power for s in given])
            part = np.array([[1.0, steps.power]]) if self.alone else part
            self.answers.append(part.T.astype(self.dtype, order="C"))
        self.dispersed = None
        if model.dispersed is not None:
            self.dispersed = [BetaBinomial(model, c) for c in self.groups]
            self.answers = [np.ones((1, 1), dtype=self.dtype)] * len(self.groups)
            scores = np.meshgrid(*self.outer, indexing="ij")[model.dispersed + 1].ravel()
            self.rho = model.value(model.effects[model.dispersed].name, scores)

    def _bias_steps(self) -> Array:
        """Steps of every group's bias at each outer node, (M, G)."""
        if not self.model.free_bias:
            return np.ones((len(self.d), self.model.n_groups))
        low, high = self.first[2:], self.last[2:]
        ends = np.array([low[np.isfinite(low)].min(), high[np.isfinite(high)].max()])
        width = float(np.ptp(bias_at(self.model, ends)))  # in the sd that one answer leaves
        span = np.linspace(ends[0], ends[1], int(np.clip(width / 0.4, 4, 48)) + 1)
        # Effects hardly change it: those in the middle stand for all.
        size = self.outer[0].size
        middle = np.arange(len(self.d)).reshape(size, -1)[:, len(self.d) // size // 2]
        sds = least_bias_sds(self.model, self.d[middle], self.weight[middle], span)
        return np.repeat(self.steps.bias * sds, len(self.d) // size, axis=0)

    @property
    def size(self) -> float:
        """Values in all, about, for one data set."""
        widths = self.last - self.first  # (2 + G, M, R)
        inside = np.isfinite(widths[0])
        counts = [
            np.where(inside, widths[i] / (a[1] - a[0]) + 1, 0.0) if a.size > 1 else inside * 1.0
            for i, a in enumerate(self.lapses)
        ]
        total = 0.0
        for g, cells in enumerate(self.groups):
            biases = np.where(inside, widths[2 + g], 0.0) / self.bias_step[:, g, None] + 1
            total += float((counts[0] * counts[1] * biases).sum()) * cells.size
        return total / max(widths.shape[2], 1)

    def blocks(self, *, highest: bool = False, together: int = 96) -> Iterator[Block]:
        """All blocks, with biases integrated or at their highest; up to so many data sets meet the
        same nodes."""
        for outer in self._outer_chunks():
            inside = np.isfinite(self.first[0, outer]).any(axis=0)
            rows = np.flatnonzero(inside)
            if not rows.size:
                continue
            first, last = (s[:, outer][..., rows] for s in (self.first, self.last))
            # Outer nodes where a data set has nothing do not widen its window.
            low, high = first.min(axis=1), last.max(axis=1)  # (2 + G, r)
            spans = [_spans(a, low[i], high[i]) for i, a in enumerate(self.lapses)]
            nodes = [
                self._biases(outer, g, first[2 + g], last[2 + g]) for g in range(len(self.groups))
            ]
            if len(outer) == 1:
                spans += [_spans(b[0], low[2 + g], high[2 + g]) for g, b in enumerate(nodes)]
            else:
                whole = [np.array([[0], [b.shape[1]]]) for b in nodes]
                spans += [np.repeat(w, rows.size, axis=1) for w in whole]
            order = np.lexsort((spans[1][0], spans[0][0]))
            rows, spans = rows[order], [s[:, order] for s in spans]
            all_of = [_slice(s) for s in spans]
            tables = [
                self._table(outer, g, b[:, all_of[2 + g]], all_of[:2]) for g, b in enumerate(nodes)
            ]
            for some in (slice(j, j + together) for j in range(0, rows.size, together)):
                yield self._block(outer, rows[some], nodes, tables, all_of,
                                  [_slice(s[:, some]) for s in spans], highest)  # fmt: skip

    def _outer_chunks(self, values: int = 20_000) -> Iterator[Index]:
        """One outer node at a time, or with one data set as many as fill a cell's table of so many
        values: what is summed up stays in the cache."""
        inside = np.flatnonzero(np.isfinite(self.first[0]).any(axis=1))
        if self.first.shape[2] > 1 or not inside.size:
            yield from inside[:, None]
            return
        first, last = self.first[:, inside, 0], self.last[:, inside, 0]
        # Where answers are overdispersed, all pairs are looked up together.
        size = np.full(inside.size, 1.0 if self.alone else max(map(len, self.groups)) / 5)
        for i, axis in enumerate(self.lapses):
            step = axis[1] - axis[0] if axis.size > 1 else 1.0
            size *= (last[i] - first[i]) / step + 2
        size *= ((last[2:] - first[2:]) / self.bias_step[inside].T + 1).max(axis=0)
        start = 0
        while start < inside.size:
            largest = np.maximum.accumulate(size[start:]) * np.arange(1, inside.size - start + 1)
            stop = start + max(int(np.searchsorted(largest, values)), 1)
            yield inside[start:stop]
            start = stop

    def _biases(self, outer: Index, g: int, first: Array, last: Array) -> Array:
        """Nodes of a bias at each outer node, (P, B)."""
        low, high, step = first.min(axis=1), last.max(axis=1), self.bias_step[outer, g]
        count = int(np.ceil((high - low) / step - 1e-9).max()) + 1
        return np.asarray(low[:, None] + step[:, None] * np.arange(count))

    def _table(self, outer: Index, g: int, bias: Array, spans: list[slice]) -> Values:
        """Log-probabilities of the answers that were given, and of the bias, (N, P, B, Lo, Hi)."""
        model, cells = self.model, self.groups[g]
        low, high = self.low[spans[0], spans[1]], self.high[spans[0], spans[1]]
        log_bias = score_prior(bias) if model.free_bias else np.zeros(bias.shape)
        log_bias, bias = log_bias[..., None, None], bias_at(model, bias)
        d, weight = (a[outer][:, cells].T[..., None] for a in (self.d, self.weight))
        both = model.task.chance(d, weight * bias)  # (C, P, B)
        if self.dispersed is not None:
            own = self.dispersed[g](*both, low, high, self.rho[outer])
            return np.asarray(self.steps.power * (own + log_bias)[None])
        slope = np.maximum(1 - low - high, 0.0).ravel()
        # Lapse plus slope times chance, as a matrix product: a fifth of what broadcasting costs.
        lines = [np.array([slope, lapse.ravel()], dtype=self.dtype) for lapse in (low, high)]
        some = self.sides[g]
        if self.alone:  # nobody shares its table: every cell is added up as soon as it is made
            table = np.zeros((2, *bias.shape, *low.shape), dtype=self.dtype)
            total = table[0].reshape(-1, slope.size)
            logs = np.empty_like(total)
            chance = np.ones((bias.size, 2), dtype=self.dtype)
            for side, line, i, given in zip(both, lines, some, self.given[g], strict=True):
                for cell, count in zip(i, given, strict=True):
                    chance[:, 0] = side[cell].reshape(-1)
                    np.matmul(chance, line, out=logs)
                    np.log(np.maximum(logs, self.least, out=logs), out=logs)
                    logs *= count
                    total += logs
        else:
            ends = np.cumsum([0, *(s.size for s in some)])
            table = np.empty((ends[-1] + 1, *bias.shape, *low.shape), dtype=self.dtype)
            for side, line, i, at in zip(both, lines, some, (0, 1), strict=True):
                chance = np.ones((i.size * bias.size, 2), dtype=self.dtype)
                chance[:, 0] = side[i].reshape(-1)
                np.matmul(chance, line, out=table[ends[at] : ends[at + 1]].reshape(-1, slope.size))
            logs = table[:-1]
            np.log(np.maximum(logs, self.least, out=logs), out=logs)
        table[-1] = log_bias
        return table

    def _block(
        self,
        outer: Index,
        rows: Index,
        nodes: list[Array],
        tables: list[Values],
        whole: list[slice],
        spans: list[slice],
        highest: bool,
    ) -> Block:
        joint: Any = 0.0
        groups = []
        for g, table in enumerate(tables):
            own = spans[2 + g]
            cut = [
                slice(s.start - w.start, s.stop - w.start)
                for s, w in zip(spans, whole, strict=True)
            ]
            part = table[:, :, cut[2 + g], cut[0], cut[1]]
            values = part.reshape(len(part), -1).T @ self.answers[g][:, rows]
            values = values.reshape(*part.shape[1:], rows.size)
            top = values.max(axis=1)
            if not highest:
                step = self.bias_step[outer, g] if self.model.free_bias else np.ones(outer.size)
                values -= top[:, None]
                np.exp(values, out=values)
                total = np.log(values.sum(axis=1))
                total += np.log(step).astype(self.dtype)[:, None, None, None]
                joint = joint + top + total
            else:
                joint = joint + top
            groups.append(Group(nodes[g][:, own], values, top))
        return Block(outer, rows, spans[0], spans[1], joint, groups)


def _spans(axis: Array, low: Array, high: Array) -> Index:
    """First node within a window, and the one after the last, (2, r)."""
    first, last = np.searchsorted(axis, low - 1e-9), np.searchsorted(axis, high + 1e-9)
    return np.minimum(np.array([first, last + 1]), [[axis.size - 1], [axis.size]])


def _slice(spans: Index) -> slice:
    return slice(int(spans[0].min()), int(spans[1].max()))


def lines(chance: Array, low: Array, high: Array, lapse: Array) -> Array:
    """lapse + (1 − low − high) chance for every chance (N,) and pair of lapses (L,), (N, L): as a
    matrix product, which is five times as fast as broadcasting."""
    slope = np.maximum(1 - low - high, 0.0)
    factors = np.ones((chance.size, 2))
    factors[:, 0] = chance.ravel()
    return factors @ np.array([slope.ravel(), lapse.ravel()])


class BetaBinomial:
    """Log-likelihood of overdispersed answers of the cells of one bias.

    Sessions at one pair of stimuli share its P, so that their log-likelihood is one function of P
    for each ρ: it is tabulated over logit P, and read off at the nodes, where log-gammas would take
    minutes. Entries are a `share` of the logit's own sd apart: at 0.1 errors are 3e-4 a pair,
    mostly common. Beyond logits of `far` a P is as good as 0 or 1.
    """

    def __init__(
        self, model: WeberModel, cells: Index, share: float = 0.1, far: float = 40.0
    ) -> None:
        self.model, self.cells, self.far = model, cells, far
        columns = np.delete(model.columns, model.dispersed or 0, axis=0)
        encoded = [np.broadcast_to(a, model.group.shape) for a in model.encodings]
        keys = np.column_stack([*encoded, *columns])[cells]
        _, self.first, pair = np.unique(keys, axis=0, return_index=True, return_inverse=True)
        self.pair = pair.reshape(-1)
        answers = max(float(np.bincount(self.pair, model.cells.n[cells]).max(initial=1.0)), 1.0)
        count = int(np.ceil(2 * far * max(np.sqrt(answers) / share / 2, 50.0)))
        self.fine = np.linspace(-far, far, count + 1)
        self.tables: dict[float, Array] = {}

    def __call__(self, up: Array, down: Array, low: Array, high: Array, rho: Array) -> Array:
        """At chances without lapses (C, P, B), lapses (Lo, Hi), and ρ (P,): (P, B, Lo, Hi)."""
        shape = self.first.size, *up.shape[1:], *low.shape
        # log P − log(1 − P), neither of them by subtraction.
        place = lines(up[self.first], low, high, np.maximum(low, 1e-300))
        place /= lines(down[self.first], low, high, np.maximum(high, 1e-300))
        np.clip(np.log(place, out=place), -self.far, self.far, out=place)
        place += self.far
        place *= (self.fine.size - 1) / (2 * self.far)
        place = place.reshape(shape)
        left = np.minimum(place.astype(np.intp), self.fine.size - 2)
        place -= left
        left += (np.arange(self.first.size) * self.fine.size)[:, None, None, None, None]
        out = np.empty(place.shape[1:])
        for row, one in enumerate(rho):
            table = self._table(float(one))
            below = np.take(table, left[:, row])
            out[row] = (below + place[:, row] * (np.take(table, left[:, row] + 1) - below)).sum(0)
        return out

    def _table(self, rho: float) -> Array:
        """Log-likelihood of every pair's answers over the logits, one pair after another."""
        if rho not in self.tables:
            # A pair's P at the knots, (K, C), each cell with the answers of its session.
            knots = np.linspace(-self.far, self.far, 1601)
            p, q = expit(knots)[:, None], expit(-knots)[:, None]
            cells = self.model.beta_binomial(p, q, np.array(rho))[:, self.cells]
            pairs = np.zeros((knots.size, self.first.size))
            np.add.at(pairs.T, self.pair, cells.T)
            self.tables[rho] = CubicSpline(knots, pairs)(self.fine).T.ravel()
        return self.tables[rho]
