"""The posterior of choices on a grid: zoom in from the prior, then sum on even nodes.

Of one observer the nodes grow finer until every other of them gives the same evidence and the same
interval of the Weber fraction. Many data sets of one design, as `power` has them, are zoomed and
summed together, with steps fine beside the narrowest peak that there can be: trapezoid sums over
smooth peaks converge exponentially, so that log evidences err by some 0.01. `axes` says where
nodes lie, and `blocks` evaluates them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.special import logsumexp
from scipy.stats import lognorm

from .._util.values import Array, Index
from .axes import (
    Steps,
    Windows,
    everything,
    kept,
    lapse_prior,
    lapse_weights,
    least_bias_sds,
    least_sds,
    outer_signals,
    score_prior,
)
from .blocks import NOTHING, ChoiceNodes
from .likelihood import WeberModel

__all__ = [
    "PosteriorGrid", "density_of", "half_grid_error", "integrate", "log_marginal", "log_sum",
    "marginal", "of_fraction", "outer_prior", "over_fractions", "zoomed",
]  # fmt: skip


@dataclass(frozen=True)
class PosteriorGrid:
    """Log posterior of one data set on even nodes.

    `axes`: coordinates of the model's lead: scores of k (K,) and any effects, those of lapse_low
    (Lo,) and lapse_high (Hi,). `joint`: log density of the coordinates, biases integrated,
    (K, ..., Lo, Hi), −inf where nothing was summed. `biases`: for each group scores (P, B) of its
    bias and the posterior mass of each, in blocks. `windows` (2, G, M): scores between which each
    bias lies at each outer node, infinite the wrong way round where nothing was summed, and
    `bias_nodes` how many nodes were enough there. `log_evidence` is for the sequence of answers;
    `error` estimates its absolute error, or that of the interval of k in sds if it is larger.
    """

    axes: tuple[Array, ...]
    joint: Array
    biases: list[list[tuple[Array, Array]]]
    windows: Array
    bias_nodes: int
    log_evidence: float
    error: float


def integrate(model: WeberModel, tolerance: float = 0.1, most: float = 1e9) -> PosteriorGrid:
    """The posterior on a fine enough grid; its error is infinite where that takes too many values.

    `tolerance`: how far the evidence may move when every other node is left out, line by line,
    where errors along a ridge cannot cancel; on the whole a share of it. For a normal density the
    error t falls to t⁴/8 at half the step, so that what is left is far smaller.
    """
    counts = model.cells.count[None]
    least = least_sds(model)
    steps = Steps(1.0, 1.3 * least, np.full(2, 0.8), 1.3)
    wide = replace(steps, outer=2.5 * least, lapse=np.full(2, 2.0), bias=2.5)
    first = 30.0 if len(least) == 1 else 20.0  # nodes: one pass fewer where it costs little
    windows = zoomed(model, counts, wide, 10.0 + 2 * np.log(0.1 / tolerance), nodes=first)
    # Wider steps where windows are far wider than the least sd: they are refined as needed.
    width = (windows.ends[:, 1] - windows.ends[:, 0]).max(axis=1)
    steps = replace(steps, outer=np.maximum(steps.outer, width / 26))
    grid = None
    for _ in range(12):
        nodes = ChoiceNodes(model, windows, steps, counts, np.float64)
        if nodes.size > most:
            break
        grid, finer = _summed(nodes, tolerance)
        if np.all(finer == 1):
            return grid
        outer, lapse, bias = finer[:-3], finer[-3:-1], finer[-1]
        steps = Steps(1.0, steps.outer * outer, steps.lapse * lapse, float(steps.bias * bias))
    while grid is None:  # something to show
        steps = steps.at(1.0, 2.0)
        nodes = ChoiceNodes(model, windows, steps, counts, np.float64)
        if nodes.size < most / 4:
            grid, _ = _summed(nodes, tolerance)
    return replace(grid, error=np.inf)


def _summed(nodes: ChoiceNodes, tolerance: float) -> tuple[PosteriorGrid, Array]:
    """The grid, and by how much each axis must be finer (outer, lapses, biases)."""
    axes = (*nodes.outer, *nodes.lapses)
    prior = outer_prior(nodes.outer)[:, None, None] + lapse_prior(nodes.model, *nodes.lapses)
    joint = np.full(prior.shape, -np.inf)
    biases: list[list[tuple[Array, Array]]] = [[] for _ in nodes.groups]
    missed, total, reference = 0.0, 0.0, -np.inf
    for block in nodes.blocks():
        place = block.outer, block.low, block.high
        joint[place] = own = block.log_like[..., 0] + prior[place]
        if (top := own.max()) == -np.inf:
            continue
        if top > reference:
            fall = np.exp(reference - top)
            missed, total, reference = missed * fall, total * fall, top
            biases = [[(scores, mass * fall) for scores, mass in known] for known in biases]
        mass = np.exp(own - reference)
        total += mass.sum()
        for known, group in zip(biases, block.groups, strict=True):
            share = group.values[..., 0]  # (P, B, Lo, Hi)
            whole = share.sum(axis=1)
            if share.shape[1] > 1:
                missed += float((mass * np.abs(2 * share[:, ::2].sum(axis=1) / whole - 1)).sum())
            known.append((group.nodes, np.einsum("pbij,pij->pb", share, mass / whole)))
    joint = joint.reshape([a.size for a in axes])
    log_cell = sum(np.log(a[1] - a[0]) for a in axes if a.size > 1)
    marginals = [log_marginal(joint, i) for i in range(joint.ndim)]
    lines = np.array([_half_grid_error_by_line(joint, i) for i in range(joint.ndim)])
    wholes = np.array([half_grid_error(np.exp(m)) for m in marginals])
    steep = np.array([_steepest(m) for m in marginals])
    steep[-2:] = 0.0  # a lapse's axis ends where its prior does, steep or not
    bias_error = missed / max(total, 1e-300) / len(nodes.groups)
    over = np.maximum(lines / tolerance, wholes / (0.4 * tolerance))
    over = np.r_[np.where(steep > 8.0, np.inf, over), bias_error / tolerance]
    # Of a normal density the error is 2 exp(−2π²/h²): what is over goes with 1/h².
    refine = np.sqrt(np.clip(1 - np.log(np.maximum(over, 1.0)) / np.log(2 / tolerance), 0.25, 1.0))
    refine = np.where(over > 1, np.minimum(refine, 0.8), 1.0)
    error = max(lines.max(), bias_error) ** 4
    # Half-grids agree on the evidence long before they do on the tails of k where these are not
    # a normal's: a shelf where lapses explain all, a kink where answers forbid every smaller k.
    shift = _quantile_shift(axes[0], marginals[0])
    if shift > 0.03:  # sds by which half the nodes move a quantile: for a kink a third is left
        if axes[0].size < 200:
            refine[0] = min(refine[0], 0.6)
        else:
            error = max(error, shift / 3)
    windows = np.stack([nodes.first[2:, :, 0], nodes.last[2:, :, 0]])
    inside = np.isfinite(windows[0])
    widths = np.subtract(windows[1], windows[0], where=inside, out=np.zeros(inside.shape))
    count = int(np.ceil(widths / nodes.bias_step.T).max(initial=0.0)) + 1
    biases = [[(scores, mass / total) for scores, mass in known] for known in biases]
    log_evidence = float(logsumexp(joint) + log_cell)
    return PosteriorGrid(axes, joint, biases, windows, count, log_evidence, float(error)), refine


def log_marginal(joint: Array, axis: int) -> Array:
    """Log marginal density of one coordinate, its highest zero."""
    others = tuple(i for i in range(joint.ndim) if i != axis)
    density = np.exp(joint - joint.max()).sum(axis=others)
    with np.errstate(divide="ignore"):
        return np.asarray(np.log(density / density.max()))


def half_grid_error(density: Array) -> float:
    """How far the evidence moves when every other node is left out."""
    if density.size == 1:
        return 0.0
    return float(abs(np.log(max(2 * density[::2].sum() / density.sum(), 1e-300))))


def _half_grid_error_by_line(joint: Array, axis: int) -> float:
    """The same along every line of the grid, errors added up: a ridge across the axes shows."""
    if joint.shape[axis] == 1:
        return 0.0
    lines = np.moveaxis(np.exp(joint - joint.max()), axis, -1)
    whole = lines.sum(axis=-1)
    return float(np.abs(2 * lines[..., ::2].sum(axis=-1) - whole).sum() / whole.sum())


def _steepest(log_density: Array) -> float:
    """The farthest fall from one node to the next, of nodes within 4 nats of the peak: where
    answers forbid all beyond a place the density ends in a cliff."""
    finite = np.maximum(log_density, -600.0)
    high = np.maximum(finite[1:], finite[:-1]) > -4.0
    return float(np.max(np.abs(np.diff(finite)), where=high, initial=0.0))


def _quantile_shift(axis: Array, log_density: Array) -> float:
    """The farthest that half the nodes move the median or an end of the 95 % interval, in sds."""
    if axis.size < 5:  # none, or nothing to compare
        return 0.0 if axis.size == 1 else np.inf
    found = []
    for step in (slice(None), slice(0, None, 2), slice(1, None, 2)):
        fine, density = density_of(axis[step], log_density[step])
        rise = np.cumsum(density)
        found.append(np.interp([0.025, 0.5, 0.975], rise / rise[-1], fine))
        if step == slice(None):
            variance = fine**2 @ density / rise[-1] - (fine @ density / rise[-1]) ** 2
    return float(np.max(np.abs(np.subtract(found[1:], found[0]))) / np.sqrt(variance))


def density_of(axis: Array, log_density: Array) -> tuple[Array, Array]:
    """1601 even points of an axis, and the density there."""
    # A spline through the fall to empty nodes would ring.
    above = np.flatnonzero(log_density > -80.0)
    few = int(above.size < 4)
    span = slice(max(int(above[0]) - few, 0), int(above[-1]) + 1 + few)
    axis, log_density = axis[span], np.maximum(log_density[span], -80.0)
    fine = np.linspace(axis[0], axis[-1], 1601)
    return fine, np.exp(CubicSpline(axis, log_density)(fine))


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
    # The least sd that the score of any bias can have given the rest.
    few = [np.linspace(-2.0, 2.0, 9) * f for f in model.free[:1]]
    drive = outer_signals(model, [*few, *[np.zeros(1)] * len(model.effects)])
    narrowest = float(least_bias_sds(model, *drive, np.linspace(-2.0, 2.0, 9)).min())
    coarsest = max(
        [s / step for s, step in zip(spans, [*steps.outer, *steps.lapse], strict=True)]
        + [(windows.high[2] - windows.low[2]).max() / narrowest / steps.bias]
    )
    # Nothing to zoom into where all is known, or within a few steps.
    zooms = int(np.ceil(np.log(max(coarsest / nodes, 1.0)) / np.log(finer)))
    for power in finer ** (-2.0 * np.arange(zooms, -1, -1)):
        at = ChoiceNodes(model, windows, steps.at(power), counts)
        if at.size > most:
            break
        windows = _pass(at, windows, power * cut + slack, by_node)
    return windows


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
    lapse = np.maximum(steps.lapse, 2.0)
    twice = Steps(steps.power, 2 * steps.outer, lapse, 2 * steps.bias)
    windows = zoomed(model, counts, twice, cut, by_node=by_node)
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
