"""Zooming in from the prior, many data sets of one design together, and k of one animal.

Steps are fine beside the narrowest peak that there can be: trapezoid sums over smooth peaks
converge exponentially, so that log evidences err by some 0.01.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import lognorm

from ..._util.values import Array, Index
from ..axes import (
    Steps,
    Windows,
    everything,
    kept,
    lapse_weights,
    least_bias_sds,
    least_sds,
    outer_signals,
    score_prior,
)
from ..likelihood import WeberModel
from .blocks import NOTHING, ChoiceNodes

__all__ = ["log_sum", "marginal", "of_fraction", "outer_prior", "over_fractions", "zoomed"]

Single = NDArray[np.float32]


def zoomed(
    model: WeberModel,
    counts: Array,
    steps: Steps,
    cut: float,
    *,
    finer: float = 2.0,
    nodes: float = 12.0,
    slack: float = 2.5,
    by_node: bool = False,
    most: float = 2e9,
) -> Windows:
    """Windows of every data set (R, C), of all that is no more than `cut` nats under its best node.

    `steps` are those of the last pass here, each `finer` than the one before; the first, over all
    of the prior, has about `nodes` an axis. The best of a pass may lie `slack` nats under the best
    there is; the best is that `by_node` where any k may come to matter. Windows stay as
    they are before a pass of more than `most` values.
    """
    windows = everything(model, len(counts))
    spans = [e[1].max() - e[0].min() for e in windows.ends]
    spans += [windows.high[i].max() - windows.low[i].min() for i in (0, 1)]
    coarsest = max(
        [s / step for s, step in zip(spans, [*steps.outer, *steps.lapse], strict=True)]
        + [(windows.high[2] - windows.low[2]).max() / narrowest_bias(model) / steps.bias]
    )
    # Nothing to zoom into where all is known, or within a few steps.
    zooms = int(np.ceil(np.log(max(coarsest / nodes, 1.0)) / np.log(finer)))
    for power in finer ** (-2.0 * np.arange(zooms, -1, -1)):
        at = ChoiceNodes(model, windows, steps.at(power), counts)
        if at.size > most:
            break
        windows = _pass(at, windows, power * cut + slack, by_node)
    return windows


def narrowest_bias(model: WeberModel) -> float:
    """The least sd that the score of any bias can have given the rest."""
    few = [np.linspace(-2.0, 2.0, 9) * f for f in model.free[:1]]
    d, weight = outer_signals(model, [*few, *[np.zeros(1)] * len(model.effects)])
    return float(least_bias_sds(model, d, weight, np.linspace(-2.0, 2.0, 9)).min())


def _pass(at: ChoiceNodes, windows: Windows, cut: float, by_node: bool) -> Windows:
    """Smaller windows, by the highest log posterior with each outer node and one other."""
    count, size, power = windows.ends.shape[2], len(at.d), at.steps.power
    prior = (power * outer_prior(at.outer)).astype(np.float32)
    weights = np.maximum(power * lapse_weights(at.model, *at.lapses), NOTHING).astype(np.float32)
    low, high = (np.full((size, a.size, count), -np.inf, np.float32) for a in at.lapses)
    biases: list[list[tuple[Index, Index, Array, Single]]]
    biases = [[] for _ in at.groups]
    for block in at.blocks(highest=True):
        outer, rows = block.outer, block.rows
        joint = block.log_like + weights[block.low, block.high, None]
        joint += prior[outer, None, None, None]
        _put(low, outer, block.low, rows, joint.max(axis=2))
        _put(high, outer, block.high, rows, joint.max(axis=1))
        for known, group in zip(biases, block.groups, strict=True):
            values = group.values
            values += (joint - group.top)[:, None]
            values = values.reshape(*group.nodes.shape, -1, rows.size)
            known.append((outer, rows, group.nodes, _highest(values)))
    profiles = [
        (np.broadcast_to(a, (size, a.size)), p) for a, p in zip(at.lapses, (low, high), strict=True)
    ]
    profiles += [_gathered(known, at.bias_step[:, g], count) for g, known in enumerate(biases)]
    return kept(windows, at.outer, profiles, cut, 0.15, by_node)


def _put(out: Single, outer: Index, span: slice, rows: Index, values: Single) -> None:
    for i, m in enumerate(outer):
        out[m][span, rows] = values[i]


def _gathered(known: list, step: Array, count: int) -> tuple[Array, Single]:
    """Nodes of a bias that differ between outer nodes, (M, B), and what is there (M, B, R)."""
    size = len(step)
    first = np.full(size, np.inf)
    last = np.full(size, -np.inf)
    for outer, _, nodes, _ in known:
        first[outer] = np.minimum(first[outer], nodes[:, 0])
        last[outer] = np.maximum(last[outer], nodes[:, -1])
    nothing = np.isinf(first)
    first[nothing], last[nothing] = 0.0, 0.0
    most = int(np.round((last - first) / step).max()) + 1
    values = np.full((size, most, count), -np.inf, np.float32)
    for outer, rows, nodes, value in known:
        place = np.round((nodes[:, 0] - first[outer]) / step[outer]).astype(np.intp)
        for i, m in enumerate(outer):
            values[m][place[i] : place[i] + nodes.shape[1], rows] = value[i]
    return first[:, None] + step[:, None] * np.arange(most), values


def _highest(values: Single) -> Single:
    """Over the third axis, half against half, for good: NumPy itself takes many short steps."""
    while (half := values.shape[2] // 2) > 0:
        np.maximum(values[:, :, :half], values[:, :, -half:], out=values[:, :, :half])
        values = values[:, :, :-half]
    return values[:, :, 0]


def outer_prior(axes: Sequence[Array]) -> Array:
    """Log prior density of the outer scores at their nodes, (M,)."""
    total = np.zeros(1)
    for axis in axes:
        total = (total[:, None] + score_prior(axis)).ravel()
    return total


def batch_steps(model: WeberModel, k: float = 2.5, lapse: float = 1.5, bias: float = 2.0) -> Steps:
    """Steps for many data sets, those of k and of biases in the least sd they can have: log
    evidences err by some 0.01, and k is interpolated."""
    return Steps(1.0, k * least_sds(model), np.full(2, lapse), bias)


def _zoom_steps(steps: Steps) -> Steps:
    """Twice as wide, for the last pass of the zoom."""
    return replace(
        steps, outer=2 * steps.outer, lapse=np.maximum(steps.lapse, 2.0), bias=2 * steps.bias
    )


def marginal(
    model: WeberModel,
    counts: Array,
    cut: float = 5.0,
    steps: Steps | None = None,
    by_node: bool = False,
) -> tuple[Array, Array]:
    """Scores of k (K,), and the log-likelihoods (R, K) there, biases and lapses integrated.

    Of counts (R, C), which need not be whole, of a model without effects; a node so many nats under
    the best counts as empty, or `by_node` under the best with the same k.
    """
    steps = steps or batch_steps(model)
    windows = zoomed(model, counts, _zoom_steps(steps), cut, by_node=by_node)
    at = ChoiceNodes(model, windows, steps, counts)
    weights = np.maximum(lapse_weights(model, *at.lapses), NOTHING).astype(np.float32)
    out = np.full((len(counts), at.outer[0].size), -np.inf)
    for block in at.blocks():
        joint = block.log_like + weights[block.low, block.high, None]
        total = log_sum(joint.reshape(len(block.outer), -1, block.rows.size), 1)
        total = np.where(total > 0.5 * NOTHING, total, -np.inf)
        out[block.rows[:, None], block.outer] = total.T
    return at.outer[0], carried_on(out)


def of_fraction(
    model: WeberModel, middle: float, cut: float = 20.0, vague: float = 0.6
) -> tuple[Array, Array]:
    """Nodes of ln k (K,) and the log-likelihood of one animal there, lapses and biases integrated.

    Other animals of a population draw k to where this one's own posterior has nothing: nodes lie
    about its `middle`, `vague` being the sd of the logarithm, as far as `cut` nats under the best.
    """
    believed = replace(model.priors, weber_fraction=lognorm(vague, scale=middle))
    wide = replace(model, priors=believed)
    steps = batch_steps(wide, k=0.9, lapse=0.8, bias=1.3)
    scores, found = marginal(wide, model.cells.count[None], cut, steps, by_node=True)
    return np.log(wide.value("weber_fraction", scores)), found[0]


def carried_on(values: Array) -> Array:
    """Beyond its window every row (R, K) goes on as it ended there, and falls."""
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
    return np.asarray(np.log(np.exp(values - top).sum(axis=axis)) + np.squeeze(top, axis))


def over_fractions(
    model: WeberModel, lapses: tuple[Array, Array], bias: Array | None, cut: float = 25.0
) -> Array:
    """Log-likelihood of the answers with the Weber fraction integrated, (B, Lo, Hi).

    At rising coordinates (Lo,) and (Hi,) of the lapses, and even scores (B,) of the one bias;
    without these biases are integrated, and B is 1. No k is looked for so many nats under the best.
    """
    counts, least = model.cells.count[None], least_sds(model)
    steps = Steps(1.0, 1.3 * least, np.full(2, 1.0), 1.3)
    found = zoomed(model, counts, replace(steps, outer=2.5 * least, bias=2.5), cut, slack=4.0)
    low, high = found.low.copy(), found.high.copy()
    for i, axis in enumerate(lapses):
        low[i, np.isfinite(low[i])], high[i, np.isfinite(high[i])] = axis[0], axis[-1]
    if bias is not None:
        low[2, np.isfinite(low[2])], high[2, np.isfinite(high[2])] = bias[0], bias[-1]
    at = ChoiceNodes(model, replace(found, low=low, high=high), steps, counts, np.float64, lapses)
    if bias is not None:
        at.bias_step[:] = bias[1] - bias[0]
    prior = outer_prior(at.outer) + np.log(at.outer[0][1] - at.outer[0][0])
    total = np.full((1 if bias is None else bias.size, lapses[0].size, lapses[1].size), -np.inf)
    for block in at.blocks(highest=bias is not None):
        own = block.log_like[:, None] if bias is None else block.groups[0].values
        own = own[..., 0] + prior[block.outer, None, None, None]
        if bias is not None:
            own = own - score_prior(bias)[:, None, None]
        total = np.logaddexp(total, np.logaddexp.reduce(own, axis=0))
    return total
