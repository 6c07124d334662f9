"""Likelihoods of the Weber fraction of many data sets of one design, lapses and biases integrated.

They are zoomed and summed together, with steps fine beside the narrowest peak there can be:
trapezoid sums over smooth peaks converge exponentially, so that log evidences err by some 0.01.
`power` integrates thousands of simulated experiments so, and a population each of its animals.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import lognorm

from .._util.values import Array
from .axes import lapse_weights, least_sd
from .likelihood import WeberModel
from .nodes import IMPOSSIBLE, ChoiceNodes
from .windows import Steps
from .zoom import zoomed

__all__ = ["log_sum", "marginal", "of_fraction"]


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
    # Steps of k and of biases in the least sd they can have: k is interpolated.
    steps = steps or Steps(2.5 * least_sd(model), 1.5, 1.5, 2.0)
    lapse = max(steps.low, 2.0)
    windows = zoomed(model, counts, Steps(2 * steps.k, lapse, lapse, 2 * steps.bias), cut,
                     by_node=by_node)  # fmt: skip
    at = ChoiceNodes(model, windows, steps, counts)
    weights = np.maximum(lapse_weights(model, *at.lapses), IMPOSSIBLE).astype(np.float32)
    out = np.full((len(counts), at.k.size), -np.inf)
    for block in at.blocks():
        joint = block.log_like + weights[block.low, block.high, None]
        total = log_sum(joint.reshape(len(block.at), -1, block.sets.size), 1)
        total = np.where(total > 0.5 * IMPOSSIBLE, total, -np.inf)
        out[block.sets[:, None], block.at] = total.T
    return at.k, _extended(out)


def of_fraction(
    model: WeberModel, middle: float, cut: float = 20.0, vague: float = 0.6
) -> tuple[Array, Array]:
    """Nodes of ln k (K,) and the log-likelihood of one animal there, lapses and biases integrated.

    Other animals of a population draw k to where this one's own posterior has nothing: nodes lie
    about its `middle`, `vague` being the sd of the logarithm, as far as `cut` nats under the best.
    """
    believed = replace(model.priors, weber_fraction=lognorm(vague, scale=middle))
    wide = replace(model, priors=believed)
    steps = Steps(0.9 * least_sd(wide), 0.8, 0.8, 1.3)
    scores, log_like = marginal(wide, model.cells.count[None], cut, steps, by_node=True)
    return np.log(wide.value("weber_fraction", scores)), log_like[0]


def _extended(values: Array) -> Array:
    """Beyond its window every row (R, K) goes on as it ended there, and falls."""
    count, size = values.shape
    if size == 1:
        return values
    finite = np.isfinite(values)
    first, last = finite.argmax(axis=1), size - 1 - finite[:, ::-1].argmax(axis=1)
    row, at = np.arange(count), np.arange(size)
    out = np.where(finite, values, values.max(axis=1, keepdims=True) - 60.0)  # a gap is empty
    for edge, inner in ((first, first + 1), (last, last - 1)):
        fall = np.maximum(values[row, inner] - values[row, edge], 1.0)
        away = (edge[:, None] - at) * (1 if edge is first else -1)
        out = np.where(away > 0, values[row, edge][:, None] - fall[:, None] * away, out)
    return out


def log_sum(values: NDArray[np.floating], axis: int) -> Array:
    """ln Σ exp of finite values; SciPy's costs several times as much."""
    top = values.max(axis=axis, keepdims=True)
    return np.asarray(np.log(np.exp(values - top).sum(axis=axis)) + np.squeeze(top, axis))
