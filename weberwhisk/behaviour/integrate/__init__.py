"""The one integrator of choices: zoom in from the prior, then sum on even nodes.

Here is the posterior of one data set (`fit_weber`, `weber_law_test`), on finer and finer even nodes
until every other gives the same; `batch` zooms, and serves thousands of one design (`power`);
`weberwhisk.behaviour.axes` says where they lie, and `blocks` evaluates them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline

from ..._util.values import Array
from ..axes import Steps, Windows, lapse_prior, lapse_weights, least_sds, with_tail
from ..likelihood import WeberModel
from .batch import outer_prior, zoomed
from .blocks import ChoiceNodes


@dataclass(frozen=True)
class Tolerance:
    """How fine a grid of one data set must be.

    `line`, `whole`: largest changes of the evidence when every other node is left out, line by
    line, where errors along a ridge cannot cancel, and on the whole. For a normal bump the error t
    falls to t⁴/8 at half the step, so that what is left is far smaller. `given_bias`: the same of
    the lapses at each bias, which only the density of a bias itself needs. `cut`: nats under the
    best node, where nothing is summed.
    """

    line: float = 0.1
    whole: float = 0.04
    cut: float = 10.0
    given_bias: float = np.inf


@dataclass(frozen=True)
class PosteriorGrid:
    """Log posterior of one data set on even nodes.

    `axes`: coordinates of the model's lead: scores of k (K,) and any effects, those of lapse_low
    (Lo,) and lapse_high (Hi,). `joint`: log density of the coordinates, biases integrated,
    (K, ..., Lo, Hi), −inf where nothing was summed. `biases`: for each group scores (P, B) of its
    bias and the posterior mass of each, in blocks. `windows` (2, G, M): scores between which each
    bias lies at each outer node, infinite the wrong way round where nothing was summed, and
    `bias_nodes` how many nodes were enough there. `log_evidence` is for the sequence of answers;
    `error` estimates its absolute error; `given_bias` is what leaving out every other lapse node
    changes at each bias.
    """

    axes: tuple[Array, ...]
    joint: Array
    biases: list[list[tuple[Array, Array]]]
    windows: Array
    bias_nodes: int
    log_evidence: float
    error: float
    given_bias: float


def integrate(
    model: WeberModel, tolerance: Tolerance = Tolerance(), most: float = 1e9
) -> PosteriorGrid:
    """The posterior on a grid fine enough for its evidence; its error is infinite where more than
    `most` values would be needed."""
    counts = model.cells.count[None]
    least = least_sds(model)
    steps = Steps(1.0, 1.3 * least, np.full(2, 0.8), 1.3)
    windows = zoomed(
        model,
        counts,
        replace(steps, outer=2.5 * least, lapse=np.full(2, 2.0), bias=2.5),
        tolerance.cut,
        nodes=30.0 if len(least) == 1 else 20.0,  # one pass fewer where it costs little
    )
    steps = _fitting(windows, steps)
    grid = None
    for _ in range(12):
        at = ChoiceNodes(model, windows, steps, counts, np.float64)
        if at.size > most:
            break
        grid, finer = _summed(at, tolerance)
        if np.all(finer == 1):
            return grid
        outer, lapse, bias = finer[:-3], finer[-3:-1], finer[-1]
        steps = Steps(1.0, steps.outer * outer, steps.lapse * lapse, float(steps.bias * bias))
    while grid is None:  # something to show
        steps = steps.at(1.0, 2.0)
        at = ChoiceNodes(model, windows, steps, counts, np.float64)
        if at.size < most / 4:
            grid, _ = _summed(at, tolerance)
    return replace(grid, error=np.inf)


def _fitting(windows: Windows, steps: Steps, nodes: float = 26.0) -> Steps:
    """Wider steps where windows are far wider than the least bump: they are refined as needed."""
    outer = (windows.ends[:, 1] - windows.ends[:, 0]).max(axis=1)
    return replace(steps, outer=np.maximum(steps.outer, outer / nodes))


def _summed(at: ChoiceNodes, tolerance: Tolerance) -> tuple[PosteriorGrid, Array]:
    """The grid, and by how much each axis must be finer (outer, lapses, biases)."""
    model, shape = at.model, [a.size for a in at.outer]
    like = np.full((len(at.d), at.lapses[0].size, at.lapses[1].size), -np.inf)
    prior, weights = outer_prior(at.outer), lapse_weights(model, *at.lapses)
    body = _without_tail(model, at.lapses, weights)
    parts: list[list[tuple[Array, Array, float]]] = [[] for _ in at.groups]
    lost, total, given = 0.0, 0.0, np.zeros(2)
    reference = -np.inf
    for block in at.blocks():
        own = block.log_like[..., 0]
        like[block.outer, block.low, block.high] = own
        joint = own + weights[block.low, block.high] + prior[block.outer, None, None]
        top = joint.max()
        if top == -np.inf:
            continue
        if top > reference:
            lost, total, given = (x * np.exp(reference - top) for x in (lost, total, given))
            reference = top
        mass = np.exp(joint - reference)
        total += mass.sum()
        for known, group in zip(parts, block.groups, strict=True):
            share = group.values[..., 0]  # (P, B, Lo, Hi)
            whole = share.sum(axis=1)
            if share.shape[1] > 1:
                lost += float((mass * np.abs(2 * share[:, ::2].sum(axis=1) / whole - 1)).sum())
            share *= (mass / whole)[:, None]
            by_node = share.sum(axis=(2, 3))
            share *= body[block.low, block.high]
            given += [_missed(share, axis) for axis in (2, 3)]
            known.append((group.nodes, by_node, reference))
    low, high = (with_tail(model, n, a) for n, a in zip(model.lead[-2:], at.lapses, strict=True))
    # Below its first node a lapse is none: the likelihood there is that of none.
    pad = low.size - at.lapses[0].size, high.size - at.lapses[1].size
    like = np.pad(like, ((0, 0), (pad[0], 0), (pad[1], 0)), mode="edge")
    joint = like + lapse_prior(model, low, high) + prior[:, None, None]
    joint = joint.reshape(*shape, low.size, high.size)
    axes = (*at.outer, low, high)
    log_cell = sum(np.log(a[1] - a[0]) for a in axes if a.size > 1)
    top = joint.max()
    log_evidence = float(np.log(np.exp(joint - top).sum()) + top + log_cell)
    lines = np.array([half_grid_error_by_line(joint, i) for i in range(joint.ndim)])
    marginals = [log_marginal(joint, i) for i in range(joint.ndim)]
    wholes = np.array([half_grid_error(np.exp(m)) for m in marginals])
    steep = np.array([_steepest(m) for m in marginals])
    steep[-2:] = 0.0  # a lapse's axis ends where its prior does, steep or not
    bias_error = lost / max(total, 1e-300) / len(at.groups)
    error = max(lines.max(), bias_error)
    given /= max(total, 1e-300) * len(at.groups)
    lines[-2:] = np.where(given > tolerance.given_bias, np.inf, lines[-2:])
    over = np.maximum(lines / tolerance.line, wholes / tolerance.whole)
    over = np.r_[np.where(steep > 8.0, np.inf, over), bias_error / tolerance.line]
    # Of a normal bump the error is 2 exp(−2π²/h²): what is over goes with 1/h².
    tight = np.log(2 / tolerance.line)
    refine = np.sqrt(np.clip(1 - np.log(np.maximum(over, 1.0)) / tight, 0.25, 1.0))
    refine = np.where(over > 1, np.minimum(refine, 0.8), 1.0)
    biases = [
        [(nodes, mass * (np.exp(top - reference) / total)) for nodes, mass, top in known]
        for known in parts
    ]
    windows = np.stack([at.first[2:, :, 0], at.last[2:, :, 0]])
    inside = np.isfinite(windows[0])
    widths = np.subtract(windows[1], windows[0], where=inside, out=np.zeros(inside.shape))
    count = int(np.ceil(widths / at.bias_step.T).max(initial=0.0)) + 1
    grid = PosteriorGrid(
        axes, joint, biases, windows, count, log_evidence, float(error**4), float(given.max())
    )
    return grid, refine


def _without_tail(model: WeberModel, lapses: tuple[Array, Array], weights: Array) -> Array:
    """Share of a lapse node's prior that is its own in a trapezoid sum from the first node on,
    where that stands for all below it."""
    log_cell = sum(np.log(a[1] - a[0]) for a in lapses if a.size > 1)
    with np.errstate(invalid="ignore"):
        share = np.exp(lapse_prior(model, *lapses) + log_cell - weights)
    for i, (name, axis) in enumerate(zip(model.lead[-2:], lapses, strict=True)):
        if with_tail(model, name, axis).size > axis.size:
            np.moveaxis(share, i, 0)[0] *= 0.5
    return np.nan_to_num(share)


def _missed(mass: Array, axis: int) -> float:
    """What leaving out every other node changes, line by line."""
    if mass.shape[axis] == 1:
        return 0.0
    even_ones = mass[:, :, ::2] if axis == 2 else mass[:, :, :, ::2]
    return float(np.abs(2 * even_ones.sum(axis=axis) - mass.sum(axis=axis)).sum())


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


def half_grid_error_by_line(joint: Array, axis: int) -> float:
    """The same along every line of the grid, errors added up: a ridge across the axes shows."""
    if joint.shape[axis] == 1:
        return 0.0
    lines = np.moveaxis(np.exp(joint - joint.max()), axis, -1)
    whole = lines.sum(axis=-1)
    return float(np.abs(2 * lines[..., ::2].sum(axis=-1) - whole).sum() / whole.sum())


def _steepest(log_density: Array, near: float = 4.0) -> float:
    """The farthest fall from one node to the next, of nodes near the peak: where answers forbid all
    beyond a place the density ends in a cliff, not as a bump."""
    finite = np.maximum(log_density, -600.0)
    high = np.maximum(finite[1:], finite[:-1]) > -near
    return float(np.max(np.abs(np.diff(finite)), where=high, initial=0.0))


def refined(model: WeberModel) -> PosteriorGrid:
    """The posterior on a grid fine enough for its quantiles too; `error` says if none was.

    Half-grids agree on the evidence to far better than 1 % long before the tails of k do where
    these are no bump's: a shelf where lapses explain all, a kink where answers forbid every smaller
    k. Such posteriors are summed again on finer grids until the 95 % interval and the median stay.
    """
    grid = integrate(model)
    if (
        grid.axes[0].size == 1
        or len(grid.axes) > 3
        or _is_bump(grid)
        or not np.isfinite(grid.error)
    ):
        return grid
    levels = Tolerance(0.03, 0.005, 12.0), Tolerance(0.01, 1e-3, 14.0), Tolerance(3e-3, 3e-4, 16.0)
    for tolerance in levels:
        finer = integrate(model, tolerance)
        if not np.isfinite(finer.error):
            return grid  # finer than this is more than can be summed
        shift = _shift(*(_quantiles(g.axes[0], log_marginal(g.joint, 0)) for g in (grid, finer)))
        # Steps at least halve the error: a third of the last shift may still be wrong.
        grid = replace(finer, error=max(finer.error, shift / 3))
        if shift < 0.03:
            break
    return grid


def density_of(axis: Array, log_density: Array, count: int = 1601) -> tuple[Array, Array]:
    """Even points of an axis, and the density there."""
    # A spline through the fall to empty nodes would ring.
    above = np.flatnonzero(log_density > -80.0)
    few = int(above.size < 4)
    span = slice(max(int(above[0]) - few, 0), int(above[-1]) + 1 + few)
    axis, log_density = axis[span], np.maximum(log_density[span], -80.0)
    fine = np.linspace(axis[0], axis[-1], count)
    return fine, np.exp(CubicSpline(axis, log_density)(fine))


def _is_bump(grid: PosteriorGrid, most: float = 0.08) -> bool:
    """Whether half the nodes of k tell the same interval, to so many sds of its score."""
    k, log_density = grid.axes[0], log_marginal(grid.joint, 0)
    whole = _quantiles(k, log_density)
    halves = (_quantiles(k[i::2], log_density[i::2]) for i in (0, 1))
    return all(_shift(half, whole) < most for half in halves)


def _shift(old: tuple[Array, float], new: tuple[Array, float]) -> float:
    """The farthest that a quantile moved, in sds."""
    return float(np.max(np.abs(new[0] - old[0])) / new[1])


def _quantiles(axis: Array, log_density: Array) -> tuple[Array, float]:
    """Of the score of k: the ends and the middle of its interval, and its sd."""
    fine, density = density_of(axis, log_density)
    rise = np.cumsum(density)
    middle = float(fine @ density / rise[-1])
    sd = float(np.sqrt((fine - middle) ** 2 @ density / rise[-1]))
    return np.interp([0.025, 0.5, 0.975], rise / rise[-1], fine), sd
