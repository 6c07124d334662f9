"""Windows found by zooming in from the whole prior, so that no mode lies between nodes.

A pass takes the posterior to a power below 1, under which the narrowest peak there can be is as
wide as the steps, so that none lies between two nodes. What is far below the best node is dropped,
and the next pass has a higher power and finer steps.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .._util.values import Array, Index
from .axes import lapse_weights, least_bias_sds, score_prior, signals
from .likelihood import WeberModel
from .nodes import IMPOSSIBLE, ChoiceNodes
from .windows import Profile, Steps, Windows, narrowed, whole_prior

__all__ = ["zoomed"]

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
    most: float = 2e9,
) -> Windows:
    """Windows of every data set (R, C), of all that is no more than `cut` nats under its best node.

    `steps` are those of the last pass here, each `finer` than the one before; the first, over all
    of the prior, has about `nodes` an axis. The best of a pass may lie `slack` nats under the best
    there is. Windows stay as they are before a pass of more than `most` values.
    """
    windows = whole_prior(model, len(counts))
    widths = [
        last - first
        for first, last in (
            span.ends for span in (windows.fraction, windows.low, windows.high, windows.biases[0])
        )
    ]
    # The least sd that the coordinate of any bias can have given the rest.
    middle = np.linspace(-2.0, 2.0, 9)
    drive = signals(model, middle * model.free[0])
    narrowest = float(least_bias_sds(model, *drive, model.bias_transform.coordinate(middle)).min())
    least = steps._replace(bias=steps.bias * narrowest)
    coarsest = max(width / step for width, step in zip(widths, least, strict=True))
    # Nothing to zoom into where all is fixed, or within a few steps.
    zooms = int(np.ceil(np.log(max(coarsest / nodes, 1.0)) / np.log(finer)))
    for power in (finer ** (-2.0 * np.arange(zooms, -1, -1))).tolist():
        at = ChoiceNodes(model, windows, steps.times(power**-0.5), counts, power=power)
        if at.size > most:
            break
        windows = _pass(at, windows, power * cut + slack)
    return windows


class _BiasValues(NamedTuple):
    """The highest log density of a block with each node of a bias, (P, B, r)."""

    at: Index
    sets: Index
    nodes: Array
    values: Single


def _pass(at: ChoiceNodes, windows: Windows, cut: float) -> Windows:
    """Smaller windows, by the highest log posterior with each node of k and one other."""
    count, size = len(windows.fraction.first), at.k.size
    prior = (at.power * score_prior(at.k)).astype(np.float32)
    weights = np.maximum(at.power * lapse_weights(at.model, *at.lapses), IMPOSSIBLE)
    weights = weights.astype(np.float32)
    low, high = (np.full((size, a.size, count), -np.inf, np.float32) for a in at.lapses)
    biases: list[list[_BiasValues]] = [[] for _ in at.cells]
    for block in at.blocks(highest=True):
        joint = block.log_like + weights[block.low, block.high, None]
        joint += prior[block.at, None, None, None]
        for i, m in enumerate(block.at):
            low[m][block.low, block.sets] = joint[i].max(axis=1)
            high[m][block.high, block.sets] = joint[i].max(axis=0)
        for seen, group in zip(biases, block.groups, strict=True):
            values = group.values
            values += (joint - group.top)[:, None]
            values = values.reshape(*group.nodes.shape, -1, block.sets.size)
            seen.append(_BiasValues(block.at, block.sets, group.nodes, _highest(values)))
    low_profile, high_profile = (
        Profile(np.broadcast_to(axis, (size, axis.size)), values)
        for axis, values in zip(at.lapses, (low, high), strict=True)
    )
    of_biases = [_gathered(seen, at.bias_steps[:, g], count) for g, seen in enumerate(biases)]
    return narrowed(windows, at.k, low_profile, high_profile, of_biases, cut)


def _gathered(blocks: list[_BiasValues], step: Array, count: int) -> Profile:
    """The profile of a bias, whose nodes differ between nodes of k."""
    size = len(step)
    first, last = np.full(size, np.inf), np.full(size, -np.inf)
    for block in blocks:
        first[block.at] = np.minimum(first[block.at], block.nodes[:, 0])
        last[block.at] = np.maximum(last[block.at], block.nodes[:, -1])
    empty = np.isinf(first)
    first[empty], last[empty] = 0.0, 0.0
    most = int(np.round((last - first) / step).max()) + 1
    values = np.full((size, most, count), -np.inf, np.float32)
    for block in blocks:
        place = np.round((block.nodes[:, 0] - first[block.at]) / step[block.at]).astype(np.intp)
        for i, m in enumerate(block.at):
            values[m][place[i] : place[i] + block.nodes.shape[1], block.sets] = block.values[i]
    return Profile(first[:, None] + step[:, None] * np.arange(most), values)


def _highest(values: Single) -> Single:
    """Over the third axis, half against half, for good: NumPy itself takes many short steps."""
    while (half := values.shape[2] // 2) > 0:
        np.maximum(values[:, :, :half], values[:, :, -half:], out=values[:, :, :half])
        values = values[:, :, :-half]
    return values[:, :, 0]
