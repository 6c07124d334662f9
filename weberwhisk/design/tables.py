"""Posteriors of thousands of experiments at once: tables of log P, and matrix products.

All data sets of one design share their stimuli, so the log-probability of every answer at every
node is tabulated once, and the log-likelihood of all of them is counts @ table. Nodes are shared,
and every data set meets those of its own box alone (`boxes`). Biases are integrated group by
group, as they are independent given the rest; then the lapses.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..behaviour.bias_scale import AS_BELIEVED, BiasScales, scaled_prior
from ..behaviour.lapses import score_prior
from ..behaviour.likelihood import WeberModel
from ..behaviour.priors import PopulationPriors
from .boxes import (
    CUT,
    LAPSE_STEP,
    STEP_BIAS,
    WIDE_BIAS,
    Boxes,
    Steps,
    bias_steps,
    even,
    everything,
    held,
    lapse_weights,
    passes,
)

Array = NDArray[np.float64]
Single = NDArray[np.float32]
Indices = NDArray[np.intp]

TOGETHER = 64  # data sets that meet the same nodes
FINE_BIAS = 0.5  # steps of the biases, in final steps, where their prior may be narrow
SCALE_STEP = 0.5  # of the biases' scale, in asinh
FAR_SCALE = 1e-6  # of its prior, beyond which it is not looked for
LEAST = np.float32(1e-30)  # of a probability
NOTHING = -1e5  # log of what cannot be


@dataclass(frozen=True)
class Likelihood:
    """Log-likelihoods of R data sets on even nodes, biases integrated.

    `scales` of the biases, S of them; `scores` (K,) of k; `low` and `high`, coordinates of the
    lapses; `values` (S, K, Lo, Hi, R), of which nothing but what lies in the boxes was computed.
    """

    scales: BiasScales
    scores: Array
    low: Array
    high: Array
    values: Single


def boxes_of(model: WeberModel, counts: Array, steps: list[Steps], cut: float = CUT) -> Boxes:
    """Where the posterior of every data set lies, from all passes but the last."""
    answers = _answers(model, counts)
    boxes = everything(model, len(counts))
    for coarse in steps[:-1]:
        boxes = _zoomed(model, boxes, coarse, answers, (steps[-1].k, cut))
    return boxes


def marginal(model: WeberModel, counts: Array) -> tuple[Array, Array]:
    """Scores of k (K,), and the log-likelihoods (R, K) there, biases and lapses integrated.

    Parameters
    ----------
    model : WeberModel
        Without effects; its cells say how many trials there are.
    counts : ndarray, shape (R, C)
        Answers counted, of the trials of every cell; they need not be whole.
    """
    steps = passes(model)
    boxes = boxes_of(model, counts, steps)
    axes = boxes.nodes(steps[-1].k), *boxes.lapses(steps[-1].lapse)
    weights = np.maximum(lapse_weights(model, *axes[1:]), NOTHING).astype(np.float32)
    out = np.full((len(counts), axes[0].size), -np.inf)
    for block in _blocks(model, axes, boxes, steps[-1], _answers(model, counts)):
        joint = block.joint + weights[block.low, block.high, None]
        total = log_sum(joint.reshape(-1, block.rows.size), 0)
        out[block.rows, block.k] = np.where(total > 0.5 * NOTHING, total, -np.inf)
    return axes[0], carried_on(out)


def likelihood(
    model: WeberModel, counts: Array, lapse_step: float = LAPSE_STEP, cut: float = CUT
) -> Likelihood:
    """The same before the lapses are integrated, wherever it is above the best less `cut`, and for
    biases that are as wide as the prior has them, narrower and wider."""
    steps = passes(model, lapse_step)
    boxes = boxes_of(model, counts, steps, cut)
    axes = boxes.nodes(steps[-1].k), *boxes.lapses(steps[-1].lapse)
    scales = _scales(model)
    fine = replace(steps[-1], biases=FINE_BIAS)
    values = np.full(
        (scales.nodes.size, *(a.size for a in axes), len(counts)), NOTHING, dtype=np.float32
    )
    answers = _answers(model, counts)
    for block in _blocks(model, axes, boxes, fine, answers, scales=scales.nodes):
        values[:, block.k, block.low, block.high][..., block.rows] = block.joint
    return Likelihood(scales, *axes, values)


def _scales(model: WeberModel) -> BiasScales:
    """Scales of the biases at which likelihoods are tabulated."""
    if not model.free_bias:
        return AS_BELIEVED
    k = model.value("weber_fraction", np.linspace(-2.0, 2.0, 9))
    d, weight = np.broadcast_arrays(*model.task.decide(model.felt(k)))
    mean, sd = model.priors.moments("bias")
    told = bias_steps(model, d, weight, np.linspace(mean - 2 * sd, mean + 2 * sd, 9)).min()
    last = float(PopulationPriors().bias_scale.isf(FAR_SCALE))
    return BiasScales.between(0.0, last, float(told) / (STEP_BIAS * sd), SCALE_STEP)


def _answers(model: WeberModel, counts: Array) -> list[Single]:
    """What meets the tables, (2C + 1, R) for each group."""
    n, ones = model.cells.n, np.ones((len(counts), 1))
    parts = []
    for group in range(model.n_groups):
        c = np.flatnonzero(model.group == group)
        part = np.hstack([counts[:, c], n[c] - counts[:, c], ones])
        parts.append(part.T.astype(np.float32, order="C"))
    return parts


def _zoomed(
    model: WeberModel, boxes: Boxes, steps: Steps, answers: list[Single], fine: tuple[float, float]
) -> Boxes:
    """Smaller boxes, by the highest log posterior with each node of k and of every other axis."""
    count = answers[0].shape[1]
    axes = boxes.nodes(steps.k), *boxes.lapses(steps.lapse)
    prior, weights = score_prior(axes[0]), lapse_weights(model, *axes[1:])
    low, high = (np.full((axes[0].size, a.size, count), -np.inf, np.float32) for a in axes[1:])
    biases: list[dict[int, tuple[Array, Single]]] = [{} for _ in range(model.n_groups)]
    for block in _blocks(model, axes, boxes, steps, answers, keep=True):
        rows, own = block.rows, prior[block.k] + weights[block.low, block.high, None]
        joint = block.joint + own.astype(np.float32)
        low[block.k][block.low, rows] = joint.max(axis=1)
        high[block.k][block.high, rows] = joint.max(axis=0)
        for known, (nodes, places, values, top) in zip(biases, block.parts, strict=True):
            if block.k not in known:
                known[block.k] = nodes, np.full((nodes.size, count), -np.inf, np.float32)
            values += joint - top
            known[block.k][1][places, rows] = _highest(values.reshape(len(values), -1, rows.size))
    profiles: list[tuple[Array, Any]] = [
        (np.broadcast_to(a, (axes[0].size, a.size)), p)
        for a, p in zip(axes[1:], (low, high), strict=True)
    ]
    profiles += [_stacked(known, axes[0].size, count) for known in biases]
    return held(boxes, axes[0], profiles, *fine)


def _stacked(known: dict[int, tuple[Array, Single]], size: int, count: int) -> tuple[Array, Single]:
    """Nodes (K, B) that differ from k to k, and what is there (K, B, R), in one array."""
    most = max(nodes.size for nodes, _ in known.values())
    nodes = np.zeros((size, most))
    values = np.full((size, most, count), -np.inf, np.float32)
    for k, (own, value) in known.items():
        step = own[1] - own[0] if own.size > 1 else 1.0
        nodes[k] = own[0] + step * np.arange(most)
        values[k, : own.size] = value
    return nodes, values


@dataclass(frozen=True)
class _Block:
    """Some data sets at one node of k, that have about the same lapses.

    `low` and `high` are nodes of the lapses, `joint` (Lo, Hi, r) log-likelihoods, biases
    integrated; `parts`, for each group, all nodes of its bias at this k, which ones, the
    log-density there (B, Lo, Hi, r), and the highest of it over the biases (Lo, Hi, r).
    """

    k: int
    rows: Indices
    low: slice
    high: slice
    joint: Single
    parts: list[tuple[Array, slice, Single, Single]]


def _blocks(
    model: WeberModel,
    axes: tuple[Array, Array, Array],
    boxes: Boxes,
    steps: Steps,
    answers: list[Single],
    keep: bool = False,
    scales: Array | None = None,
) -> Iterator[_Block]:
    """Log-likelihoods of the data sets, node of k by node.

    With `keep`, the highest over the biases in place of their integral, and the parts. With
    `scales` (S,) the integral for each of them, (S, Lo, Hi, r).
    """
    tables = _Tables(model, axes, boxes, steps)
    for i, score in enumerate(axes[0]):
        inside, low, high = boxes.at(score)
        rows = np.flatnonzero(inside)
        if not rows.size:
            continue
        nodes = [
            *axes[1:],
            *tables.biases(i, low[2:, rows].min(axis=1), high[2:, rows].max(axis=1)),
        ]
        first = np.array([_first(a, x) for a, x in zip(nodes, low[:, rows], strict=True)])
        last = np.array([_last(a, x) for a, x in zip(nodes, high[:, rows], strict=True)])
        order = np.lexsort((first[1], first[0]))
        rows, first, last = rows[order], first[:, order], last[:, order]
        whole = _spans(first, last)
        of_groups = [
            tables.at(i, g, nodes[2 + g][whole[2 + g]], whole) for g in range(model.n_groups)
        ]
        for some in (slice(j, j + TOGETHER) for j in range(0, rows.size, TOGETHER)):
            spans, own = _spans(first[:, some], last[:, some]), rows[some]
            joint: Any = np.float32(0.0)
            parts = []
            for g, table in enumerate(of_groups):
                at = 2 + g, 0, 1
                part = table[:, *(_within(spans[j], whole[j]) for j in at)]
                values = part.reshape(len(part), -1).T @ answers[g][:, own]
                values = values.reshape(*part.shape[1:], own.size)
                top = values.max(axis=0)
                if keep:
                    parts.append((nodes[2 + g], spans[2 + g], values, top))
                elif scales is not None:
                    top = _by_scale(
                        model, values - part[-1][..., None], nodes[2 + g][spans[2 + g]], scales
                    )
                else:
                    values -= top
                    top = top + np.log(np.exp(values, out=values).sum(axis=0))
                joint = joint + top
            yield _Block(i, own, spans[0], spans[1], joint, parts)


def _by_scale(model: WeberModel, log_like: Single, bias: Array, scales: Array) -> Single:
    """Biases (B,) integrated, for each scale of their prior, (S, Lo, Hi, r)."""
    if not model.free_bias:
        return np.asarray(log_like.max(axis=0, keepdims=True))
    log_like, bias = _with_middles(log_like), _with_middles(bias)
    step = bias[1] - bias[0] if bias.size > 1 else WIDE_BIAS
    weights = np.exp(scaled_prior(model.priors, bias, np.array(step), scales)).astype(np.float32)
    top = log_like.max(axis=0)
    log_like -= top
    like = np.exp(log_like, out=log_like).reshape(bias.size, -1)
    total = np.log(np.maximum(weights.T @ like, LEAST))
    return np.asarray(total.reshape(-1, *top.shape) + top)


def _with_middles(values: Any) -> Any:
    """Rows (B, ...) with others between them: cubic interpolation, quadratic at the ends."""
    count = len(values)
    if count == 1:
        return values
    out = np.empty((2 * count - 1, *values.shape[1:]), dtype=values.dtype)
    out[::2] = values
    out[1::2] = 0.5 * (values[1:] + values[:-1])
    if count > 2:
        bend = values[2:] - 2 * values[1:-1] + values[:-2]  # second differences
        out[3::2] -= bend / 16
        out[1:-2:2] -= bend / 16
        out[1] -= bend[0] / 16
        out[-2] -= bend[-1] / 16
    return out


def _highest(values: Single) -> Single:
    """Over the middle axis, half against half, for good: NumPy itself takes many short steps."""
    while (half := values.shape[1] // 2) > 0:
        np.maximum(values[:, :half], values[:, -half:], out=values[:, :half])
        values = values[:, :-half]
    return values[:, 0]


def _first(axis: Array, low: Array) -> Indices:
    return np.clip(np.searchsorted(axis, low - 1e-9), 0, axis.size - 1)


def _last(axis: Array, high: Array) -> Indices:
    return np.clip(np.searchsorted(axis, high + 1e-9), 0, axis.size - 1)


def _spans(first: Indices, last: Indices) -> list[slice]:
    """Nodes of every axis that some of the data sets hold."""
    start, stop = first.min(axis=1), last.max(axis=1) + 1
    return [slice(a, b) for a, b in zip(start.tolist(), stop.tolist(), strict=True)]


def _within(span: slice, whole: slice) -> slice:
    return slice(span.start - whole.start, span.stop - whole.start)


class _Tables:
    """Log-probabilities of both answers of every cell, and the log weight of the bias."""

    def __init__(
        self, model: WeberModel, axes: tuple[Array, Array, Array], boxes: Boxes, steps: Steps
    ) -> None:
        self.model = model
        d, weight = model.task.decide(model.felt(model.value("weber_fraction", axes[0])))
        self.d, self.weight = d, np.broadcast_to(weight, d.shape)  # (K, C)
        low, high = (model.at(n, a) for n, a in zip(model.lead[-2:], axes[1:], strict=True))
        shape, ends = (low.size, high.size), model.lapses(low[:, None], high[None])
        self.low, self.high = (np.broadcast_to(a, shape).astype(np.float32) for a in ends)
        self.cells = [np.flatnonzero(model.group == g) for g in range(model.n_groups)]
        self.step = np.full((len(d), model.n_groups), WIDE_BIAS)
        if np.isfinite(steps.biases):
            span = np.arange(boxes.low[2:].min(), boxes.high[2:].max() + 0.1, 0.1)
            self.step = steps.biases * bias_steps(model, self.d, self.weight, span)

    def biases(self, i: int, low: Array, high: Array) -> list[Array]:
        """Nodes of every group's bias at one node of k."""
        return [even(*ends) for ends in zip(low, high, self.step[i], strict=True)]

    def at(self, i: int, group: int, bias: Array, spans: list[slice]) -> Single:
        """At one node of k, (2C + 1, B, Lo, Hi)."""
        cells, model = self.cells[group], self.model
        d, weight = self.d[i, cells, None], self.weight[i, cells, None]
        yes, no = (
            a.astype(np.float32)[..., None, None] for a in model.task.chance(d, weight * bias)
        )
        low, high = self.low[spans[0], spans[1]], self.high[spans[0], spans[1]]
        table = np.empty((2 * cells.size + 1, bias.size, *low.shape), dtype=np.float32)
        np.log(np.maximum(low * no + (1 - high) * yes, LEAST), out=table[: cells.size])
        np.log(np.maximum((1 - low) * no + high * yes, LEAST), out=table[cells.size : -1])
        step = np.log(self.step[i, group]) if model.free_bias else 0.0
        table[-1] = np.maximum(model.log_bias_prior(bias) + step, NOTHING)[:, None, None]
        return table


def carried_on(values: Array) -> Array:
    """Beyond its box every row (R, K) goes on as it ended there, and falls."""
    count, size = values.shape
    if size == 1:
        return values
    known = np.isfinite(values)
    first, last = known.argmax(axis=1), size - 1 - known[:, ::-1].argmax(axis=1)
    row, at = np.arange(count), np.arange(size)
    out = np.where(known, values, values.max(axis=1, keepdims=True) - 60.0)  # a gap is empty
    for edge, inner in ((first, first + 1), (last, last - 1)):
        fall = np.maximum(values[row, inner] - values[row, edge], 1.0)
        away = (edge[:, None] - at) * (1 if edge is first else -1)
        out = np.where(away > 0, values[row, edge][:, None] - fall[:, None] * away, out)
    return out


def log_sum(values: NDArray[np.floating], axis: int) -> Array:
    """ln Σ exp of finite values; SciPy's costs several times as much."""
    top = values.max(axis=axis, keepdims=True)
    return np.log(np.exp(values - top).sum(axis=axis)) + np.squeeze(top, axis)
