"""The posterior of one observer on a grid: zoom in from the prior, then sum over even nodes.

Nodes grow finer until every other of them gives the same evidence and the same interval of the
Weber fraction.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.special import logsumexp

from .._util.values import Array, Index
from .._util.weights import line_error, log_error
from .axes import lapse_prior, least_sd, score_prior
from .likelihood import WeberModel
from .nodes import ChoiceNodes
from .windows import Span, Steps
from .zoom import zoomed

__all__ = [
    "BiasMass", "PosteriorGrid", "density_of", "integrate", "log_marginal",
]  # fmt: skip


class BiasMass(NamedTuple):
    """Scores of one bias at some nodes of k, and the posterior mass of each, (P, B)."""

    nodes: Array
    mass: Array


@dataclass(frozen=True)
class PosteriorGrid:
    """Log posterior of one data set on even nodes.

    `axes`: scores of k (K,), coordinates of lapse_low (Lo,) and lapse_high (Hi,). `joint`: log
    density of these, biases integrated, (K, Lo, Hi), −inf where nothing was summed. `biases`: for
    each group its masses, in blocks. `windows`: for each group the coordinates (K,) between which
    its bias lies, and `bias_nodes` (K,) how many nodes were enough there. `log_evidence` is for the
    sequence of answers. `error` is the larger of two estimates: of the error of `log_evidence`, and
    of that of the ends of the interval of k, in sds.
    """

    axes: tuple[Array, Array, Array]
    joint: Array
    biases: list[list[BiasMass]]
    windows: list[Span]
    bias_nodes: Index
    log_evidence: float
    error: float


def integrate(model: WeberModel, tolerance: float = 0.1, most: float = 1e9) -> PosteriorGrid:
    """The posterior on a fine enough grid; its error is infinite where that takes too many values.

    `tolerance`: how far the evidence may move when every other node is left out, line by line,
    where errors along a ridge cannot cancel; on the whole a share of it. For a normal density the
    error t falls to t⁴/8 at half the step, so that what is left is far smaller.
    """
    counts, least = model.cells.count[None], least_sd(model)
    zooming = Steps(2.5 * least, 2.0, 2.0, 2.5)
    # 30 nodes at first: one pass fewer where it costs little.
    windows = zoomed(model, counts, zooming, 10.0 + 2 * np.log(0.1 / tolerance), nodes=30.0)
    # Wider steps where windows are far wider than the least sd: they are refined as needed.
    first, last = windows.fraction.ends
    steps = Steps(max(1.3 * least, (last - first) / 26), 0.8, 0.8, 1.3)
    grid = None
    for _ in range(12):
        nodes = ChoiceNodes(model, windows, steps, counts, dtype=np.float64)
        if nodes.size > most:
            break
        grid, finer = _summed(nodes, tolerance)
        if finer == Steps(1.0, 1.0, 1.0, 1.0):
            return grid
        steps = steps.times(*finer)
    while grid is None:  # something to show
        steps = steps.times(2.0)
        nodes = ChoiceNodes(model, windows, steps, counts, dtype=np.float64)
        if nodes.size < most / 4:
            grid, _ = _summed(nodes, tolerance)
    return replace(grid, error=np.inf)


def _summed(nodes: ChoiceNodes, tolerance: float) -> tuple[PosteriorGrid, Steps]:
    """The grid, and by what factors each step must be finer."""
    axes = nodes.k, *nodes.lapses
    prior = score_prior(nodes.k)[:, None, None] + lapse_prior(nodes.model, *nodes.lapses)
    joint = np.full(prior.shape, -np.inf)
    biases: list[list[BiasMass]] = [[] for _ in nodes.cells]
    missed, total, reference = 0.0, 0.0, -np.inf
    for block in nodes.blocks():
        place = block.at, block.low, block.high
        joint[place] = log_density = block.log_like[..., 0] + prior[place]
        if (top := log_density.max()) == -np.inf:
            continue
        if top > reference:
            fall = np.exp(reference - top)
            missed, total, reference = missed * fall, total * fall, top
            biases = [[BiasMass(b.nodes, b.mass * fall) for b in before] for before in biases]
        mass = np.exp(log_density - reference)
        total += mass.sum()
        for before, group in zip(biases, block.groups, strict=True):
            share = group.values[..., 0]  # (P, B, Lo, Hi)
            whole = share.sum(axis=1)
            if share.shape[1] > 1:
                missed += float((mass * np.abs(2 * share[:, ::2].sum(axis=1) / whole - 1)).sum())
            by_node = np.einsum("pbij,pij->pb", share, mass / whole)
            before.append(BiasMass(group.nodes, by_node))
    log_cell = sum(np.log(a[1] - a[0]) for a in axes if a.size > 1)
    bias_error = missed / max(total, 1e-300) / len(nodes.cells)
    marginals = [log_marginal(joint, i) for i in range(3)]
    relative = np.exp(joint - joint.max())
    lines = [line_error(relative, i) for i in range(3)]
    over = [
        max(by_line / tolerance, log_error(np.exp(marginal)) / (0.4 * tolerance))
        for by_line, marginal in zip(lines, marginals, strict=True)
    ]
    if _steepest(marginals[0]) > 8.0:  # a lapse's axis ends where its prior does, steep or not
        over[0] = np.inf
    finer = [_refinement(o, tolerance) for o in (*over, bias_error / tolerance)]
    error = max(*lines, bias_error) ** 4
    # Half-grids agree on the evidence long before they do on the tails of k where these are not
    # a normal's: a shelf where lapses explain all, a kink where answers forbid every smaller k.
    shift = _quantile_shift(axes[0], marginals[0])
    if shift > 0.03:  # sds by which half the nodes move a quantile: for a kink a third is left
        if axes[0].size < 200:
            finer[0] = min(finer[0], 0.6)
        else:
            error = max(error, shift / 3)
    windows = [span.at((slice(None), 0)) for span in nodes.windows.biases]
    widths = [np.where(s.kept, s.last - s.first, 0.0) for s in windows]
    count = np.ceil(np.array(widths) / nodes.bias_steps.T).max(axis=0).astype(np.intp) + 1
    biases = [[BiasMass(b.nodes, b.mass / total) for b in before] for before in biases]
    log_evidence = float(logsumexp(joint) + log_cell)
    grid = PosteriorGrid(axes, joint, biases, windows, count, log_evidence, float(error))
    return grid, Steps(*finer)


def _refinement(over: float, tolerance: float) -> float:
    """By what factor a step is to be finer whose error is so many times what is tolerated.

    Of a normal density the error is 2 exp(−2π²/h²): what is over goes with 1/h².
    """
    if over <= 1:
        return 1.0
    square = np.clip(1 - np.log(over) / np.log(2 / tolerance), 0.25, 1.0)
    return float(min(np.sqrt(square), 0.8))


def log_marginal(joint: Array, axis: int) -> Array:
    """Log marginal density of one coordinate, its highest zero."""
    summed = tuple(i for i in range(joint.ndim) if i != axis)
    density = np.exp(joint - joint.max()).sum(axis=summed)
    with np.errstate(divide="ignore"):
        return np.asarray(np.log(density / density.max()))


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
    quantiles = []
    for step in (slice(None), slice(0, None, 2), slice(1, None, 2)):
        fine, density = density_of(axis[step], log_density[step])
        rise = np.cumsum(density)
        quantiles.append(np.interp([0.025, 0.5, 0.975], rise / rise[-1], fine))
        if step == slice(None):
            variance = fine**2 @ density / rise[-1] - (fine @ density / rise[-1]) ** 2
    return float(np.max(np.abs(np.subtract(quantiles[1:], quantiles[0]))) / np.sqrt(variance))


def density_of(axis: Array, log_density: Array) -> tuple[Array, Array]:
    """1601 even points of an axis, and the density there."""
    # A spline through the fall to empty nodes would ring.
    above = np.flatnonzero(log_density > -80.0)
    more = int(above.size < 4)
    span = slice(max(int(above[0]) - more, 0), int(above[-1]) + 1 + more)
    axis, log_density = axis[span], np.maximum(log_density[span], -80.0)
    fine = np.linspace(axis[0], axis[-1], 1601)
    return fine, np.exp(CubicSpline(axis, log_density)(fine))
