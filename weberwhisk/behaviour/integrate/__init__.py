"""The posterior of one observer's choices: zoom in from the prior, then sum on even nodes.

The nodes grow finer until every other of them gives the same evidence and the same interval of the
Weber fraction. `batch` zooms, and serves thousands of data sets of one design (`power`);
`weberwhisk.behaviour.axes` says where nodes lie, and `blocks` evaluates them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.special import logsumexp

from ..._util.values import Array
from ..axes import Steps, lapse_prior, least_sds
from ..likelihood import WeberModel
from .batch import outer_prior, zoomed
from .blocks import ChoiceNodes

__all__ = ["PosteriorGrid", "density_of", "half_grid_error", "integrate", "log_marginal"]

SHIFT = 0.03  # sds by which half the nodes may move a quantile of k: for a kink a third is left


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
    if shift > SHIFT and axes[0].size < 200:
        refine[0] = min(refine[0], 0.6)
    elif shift > SHIFT:
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
