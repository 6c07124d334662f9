"""Likelihoods of the Weber fraction of many data sets of one design, lapses and biases integrated.

They are zoomed and summed together, with steps fine beside the narrowest peak there can be:
trapezoid sums over smooth peaks converge exponentially, so that log evidences err by some 0.01.
`power` integrates thousands of simulated experiments so.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .._util.values import Array
from .axes import lapse_weights, least_sd
from .likelihood import WeberModel
from .nodes import IMPOSSIBLE, ChoiceNodes
from .windows import Steps
from .zoom import zoomed

__all__ = ["log_sum", "marginal"]


def marginal(
    model: WeberModel,
    counts: Array,
    cut: float = 5.0,
    steps: Steps | None = None,
) -> tuple[Array, Array]:
    """Scores of k (K,), and the log-likelihoods (R, K) there, biases and lapses integrated.

    Of counts (R, C), which need not be whole, of a model without effects; a node so many nats under
    the best counts as empty.
    """
    # Steps of k and of biases in the least sd they can have: k is interpolated.
    steps = steps or Steps(2.5 * least_sd(model), 1.5, 1.5, 2.0)
    lapse = max(steps.low, 2.0)
    windows = zoomed(model, counts, Steps(2 * steps.k, lapse, lapse, 2 * steps.bias), cut)
    at = ChoiceNodes(model, windows, steps, counts)
    weights = np.maximum(lapse_weights(model, *at.lapses), IMPOSSIBLE).astype(np.float32)
    out = np.full((len(counts), at.k.size), -np.inf)
    for block in at.blocks():
        joint = block.log_like + weights[block.low, block.high, None]
        total = log_sum(joint.reshape(len(block.at), -1, block.sets.size), 1)
        total = np.where(total > 0.5 * IMPOSSIBLE, total, -np.inf)
        out[block.sets[:, None], block.at] = total.T
    return at.k, _extended(out)


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
