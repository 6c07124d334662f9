"""Log-likelihoods of choices on the nodes of one pass.

All data sets of one design share their stimuli: the log-probability of every answer at every node
is tabulated once, and the log-likelihoods of all of them are counts @ table. A block is one node of
k and many data sets, or many nodes of k and one data set. Biases are integrated group by group, as
they are independent given the rest.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import DTypeLike, NDArray

from .._util.values import Array, Index
from .axes import bias_at, bias_prior, least_bias_sds, signals
from .likelihood import WeberModel
from .priors import TINY
from .windows import Span, Steps, Windows, even_nodes

__all__ = ["IMPOSSIBLE", "Block", "ChoiceNodes", "GroupBlock"]

Values = NDArray[Any]

IMPOSSIBLE = -1e5  # ln of the probability of what cannot be


class GroupBlock(NamedTuple):
    """One bias in a block: its nodes (P, B), the log density there (P, B, Lo, Hi, r), or the
    density over its highest, and that highest over the nodes (P, Lo, Hi, r)."""

    nodes: Array
    values: Values
    top: Values


@dataclass(frozen=True)
class Block:
    """Some data sets, `sets`, at some nodes of k, `at`, with similar windows.

    `low` and `high` are nodes of the lapses, `log_like` (P, Lo, Hi, r) log-likelihoods with the
    biases integrated, or at their highest.
    """

    at: Index
    sets: Index
    low: slice
    high: slice
    log_like: Values
    groups: list[GroupBlock]


class _Given(NamedTuple):
    """The answers of one side to the cells of a group: cells where any data set has one, their
    indices among all cells and in the group, and counts (R, given) times the power."""

    cells: Index
    counts: Array


class ChoiceNodes:
    """What is evaluated in one pass: nodes of all axes, tables of the answers there.

    Parameters
    ----------
    model : WeberModel
        Without effects.
    counts : ndarray, shape (R, C)
        Need not be whole.
    power : float
        To which the likelihood is taken.
    """

    def __init__(
        self,
        model: WeberModel,
        windows: Windows,
        steps: Steps,
        counts: Array,
        *,
        power: float = 1.0,
        dtype: DTypeLike | None = None,
    ) -> None:
        # Single precision as long as sums over all answers are good to a hundredth.
        many = float(model.cells.n.sum()) * power > 1e5
        self.model, self.power = model, power
        self.dtype = np.dtype(dtype or (np.float64 if many else np.float32))
        self.k = even_nodes(windows.fraction, steps.k)
        self.lapses = even_nodes(windows.low, steps.low), even_nodes(windows.high, steps.high)
        self.windows = windows.at(self.k)
        self.d, self.weight = signals(model, self.k)
        values = [model.at(n, a) for n, a in zip(model.lead[-2:], self.lapses, strict=True)]
        low, high = model.lapses(values[0][:, None], values[1][None])
        lost = np.maximum(low + high, 1.0)  # nodes past the edge stand for places just before it
        shape = self.lapses[0].size, self.lapses[1].size
        self.low, self.high = (np.broadcast_to(a / lost, shape) for a in (low, high))
        self.cells = [np.flatnonzero(model.group == g) for g in range(model.n_groups)]
        self.bias_steps = self._bias_steps(steps.bias)
        self.alone = len(counts) == 1
        self.given: list[tuple[_Given, _Given]] = []
        self.answers: list[Values] = []
        for cells in self.cells:
            both = counts[:, cells], model.cells.n[cells] - counts[:, cells]
            used = [np.flatnonzero(side.any(axis=0)) for side in both]
            yes, no = (
                _Given(place, side[:, place] * power)
                for side, place in zip(both, used, strict=True)
            )
            self.given.append((yes, no))
            prior = np.full((len(counts), 1), power)
            factors = np.hstack([yes.counts, no.counts, prior])
            if self.alone:  # its answers are added up in the table
                factors = np.array([[1.0, power]])
            self.answers.append(factors.T.astype(self.dtype, order="C"))

    def _bias_steps(self, in_sds: float) -> Array:
        """Steps of every group's bias at each node of k, (K, G)."""
        if not self.model.free_bias:
            return np.ones((self.k.size, self.model.n_groups))
        spans = [span.ends for span in self.windows.biases]
        ends = np.array([min(s[0] for s in spans), max(s[1] for s in spans)])
        width = float(np.ptp(bias_at(self.model, ends)))  # in the sd that one answer leaves
        span = np.linspace(ends[0], ends[1], int(np.clip(width / 0.4, 4, 48)) + 1)
        return in_sds * least_bias_sds(self.model, self.d, self.weight, span)

    @property
    def size(self) -> float:
        """Values in all, about, for one data set."""
        kept = self.windows.low.kept
        total: Any = 1.0
        for span, axis in zip((self.windows.low, self.windows.high), self.lapses, strict=True):
            width = np.subtract(span.last, span.first, where=kept, out=np.zeros(kept.shape))
            total = total * np.where(kept, _count(axis, width), 0.0)
        values = 0.0
        for g, (span, cells) in enumerate(zip(self.windows.biases, self.cells, strict=True)):
            width = np.subtract(span.last, span.first, where=kept, out=np.zeros(kept.shape))
            values += float((total * (width / self.bias_steps[:, g, None] + 1)).sum()) * cells.size
        return values / max(kept.shape[1], 1)

    def blocks(self, *, highest: bool = False, together: int = 96) -> Iterator[Block]:
        """All blocks, with biases integrated or at their highest; up to so many data sets meet the
        same nodes."""
        for at in self._chunks():
            sets = np.flatnonzero(self.windows.low.kept[at].any(axis=0))
            if not sets.size:
                continue
            place = np.ix_(at, sets)
            # Nodes of k where a data set has nothing do not widen its window.
            low, high, *biases = (
                span.at(place)
                for span in (self.windows.low, self.windows.high, *self.windows.biases)
            )
            spans = [
                _places(axis, span) for axis, span in zip(self.lapses, (low, high), strict=True)
            ]
            nodes = [self._bias_nodes(at, g, span) for g, span in enumerate(biases)]
            for bias, span in zip(nodes, biases, strict=True):
                whole = np.repeat([[0], [bias.shape[1]]], sets.size, axis=1)
                spans.append(_places(bias[0], span) if len(at) == 1 else whole)
            order = np.lexsort((spans[1][0], spans[0][0]))
            sets, spans = sets[order], [s[:, order] for s in spans]
            whole_spans = [_slice(s) for s in spans]
            tables = [
                self._table(at, g, bias[:, span], *whole_spans[:2])
                for g, (bias, span) in enumerate(zip(nodes, whole_spans[2:], strict=True))
            ]
            for part in (slice(j, j + together) for j in range(0, sets.size, together)):
                yield self._block(
                    at, sets[part], nodes, tables, whole_spans,
                    [_slice(s[:, part]) for s in spans], highest,
                )  # fmt: skip

    def _chunks(self, values: int = 20_000) -> Iterator[Index]:
        """One node of k at a time, or with one data set as many as fill a cell's table of so many
        values: what is summed up stays in the cache."""
        kept = np.flatnonzero(self.windows.low.kept.any(axis=1))
        if not self.alone or not kept.size:
            yield from kept[:, None]
            return
        size: Any = 1.0
        for axis, span in zip(self.lapses, (self.windows.low, self.windows.high), strict=True):
            size = size * (_count(axis, (span.last - span.first)[kept, 0]) + 1)
        widths = np.array([(s.last - s.first)[kept, 0] for s in self.windows.biases])
        size = size * (widths / self.bias_steps[kept].T + 1).max(axis=0)
        start = 0
        while start < kept.size:
            largest = np.maximum.accumulate(size[start:]) * np.arange(1, kept.size - start + 1)
            stop = start + max(int(np.searchsorted(largest, values)), 1)
            yield kept[start:stop]
            start = stop

    def _bias_nodes(self, at: Index, g: int, span: Span) -> Array:
        """Nodes of a bias at each node of k, (P, B)."""
        low, high, step = span.first.min(axis=1), span.last.max(axis=1), self.bias_steps[at, g]
        count = int(np.ceil((high - low) / step - 1e-9).max()) + 1
        return np.asarray(low[:, None] + step[:, None] * np.arange(count))

    def _table(self, at: Index, g: int, bias: Array, low_at: slice, high_at: slice) -> Values:
        """Log-probabilities of the answers that were given, and of the bias, (N, P, B, Lo, Hi).

        Of one data set alone N is 2, the first being the sum over its answers.
        """
        model, cells = self.model, self.cells[g]
        low, high = self.low[low_at, high_at], self.high[low_at, high_at]
        log_bias = bias_prior(model, bias)
        d, weight = (a[at][:, cells].T[..., None] for a in (self.d, self.weight))
        both = model.task.chance(d, weight * bias_at(model, bias))  # (C, P, B)
        rise = np.maximum(1 - low - high, 0.0).ravel()
        # Lapse plus rise times chance, as a matrix product: a fifth of what broadcasting costs.
        lines = [np.array([rise, lapse.ravel()], dtype=self.dtype) for lapse in (low, high)]
        count = 1 if self.alone else sum(side.cells.size for side in self.given[g])
        table = np.zeros((count + 1, *bias.shape, *low.shape), dtype=self.dtype)
        table[-1] = log_bias[..., None, None]
        least = 1e-30 if self.dtype == np.float32 else TINY
        chance = np.ones((bias.size, 2), dtype=self.dtype)
        row = 0
        logs = np.empty((bias.size, rise.size), dtype=self.dtype)
        for side, line, given in zip(both, lines, self.given[g], strict=True):
            for i, cell in enumerate(given.cells):
                into = logs if self.alone else table[row].reshape(logs.shape)
                chance[:, 0] = side[cell].reshape(-1)
                np.matmul(chance, line, out=into)
                np.log(np.maximum(into, least, out=into), out=into)
                if self.alone:  # nobody shares its table
                    logs *= given.counts[0, i]
                    table[0] += logs.reshape(table[0].shape)
                row += 1
        return table

    def _block(
        self,
        at: Index,
        sets: Index,
        nodes: list[Array],
        tables: list[Values],
        whole: list[slice],
        spans: list[slice],
        highest: bool,
    ) -> Block:
        joint: Any = 0.0
        groups = []
        low, high, *biases = (
            slice(s.start - w.start, s.stop - w.start) for s, w in zip(spans, whole, strict=True)
        )
        for g, (table, bias) in enumerate(zip(tables, biases, strict=True)):
            part = table[:, :, bias, low, high]
            values = part.reshape(len(part), -1).T @ self.answers[g][:, sets]
            values = values.reshape(*part.shape[1:], sets.size)
            top = values.max(axis=1)
            if highest:
                joint = joint + top
            else:
                step = self.bias_steps[at, g] if self.model.free_bias else np.ones(at.size)
                values -= top[:, None]
                np.exp(values, out=values)
                total = np.log(values.sum(axis=1))
                total += np.log(step).astype(self.dtype)[:, None, None, None]
                joint = joint + top + total
            groups.append(GroupBlock(nodes[g][:, spans[2 + g]], values, top))
        return Block(at, sets, spans[0], spans[1], joint, groups)


def _count(axis: Array, width: Array) -> Array:
    """Nodes of an axis in windows so wide."""
    return width / (axis[1] - axis[0]) + 1 if axis.size > 1 else np.ones(np.shape(width))


def _places(axis: Array, span: Span) -> Index:
    """First node within the window of a data set, and the one after the last, (2, r)."""
    first = np.searchsorted(axis, span.first.min(axis=0) - 1e-9)
    last = np.searchsorted(axis, span.last.max(axis=0) + 1e-9)
    return np.minimum(np.array([first, last + 1]), [[axis.size - 1], [axis.size]])


def _slice(spans: Index) -> slice:
    return slice(int(spans[0].min()), int(spans[1].max()))
