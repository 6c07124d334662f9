"""The posterior of one observer by a product rule made for this likelihood.

Axes: the normal scores of k and of any effects (every prior is a standard normal there), the lapses
in the coordinates of `stretch`, and for each group its bias, on nodes that follow its conditional
mode as k changes. Trapezoid sums over such smooth bumps converge exponentially. The rule finds the
mode, lays the axes from the curvature, then widens and refines them until nothing hangs over an
edge and every other node gives the same.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from .dispersion import DispersedAnswers
from .likelihood import WeberModel
from .mode import find_mode, log_lapses_possible, log_score_prior
from .priors import TINY
from .stretch import PLAIN

Array = NDArray[np.float64]
Axes = tuple[Array, ...]

CHUNK = 40_000  # values at once: a few arrays of this size stay in the cache
MOST = 2_000_000_000  # values in all, at which a posterior is given up
FOLLOWED = 20  # what a value costs where bias nodes follow the lapses, in ordinary ones
# Where the answers forbid all beyond a place the density ends in a cliff, not as a bump: no node
# near the peak (in ln) may stand so far above its neighbour.
NEAR, CLIFF = 4.0, 8.0
PLENTY, GOOD = 50_000_000, 3e-3  # values after which an evidence good to this is good enough
STEP, LAPSE_STEP = 2.0, 1.6  # of the first axes, in conditional sds; they are halved once
FINER = 0.7  # of a step that was too coarse
LAPSE_NODES = 23  # at least, over all that a lapse may be: its tails are unlike a bump's
FAR_SCORE = 4.5  # of a lapse's prior, below which next to nothing lies


@dataclass(frozen=True)
class Care:
    """How fine a grid must be.

    `edge`: largest density at an edge, relative to the peak. `coarse`, `sliced`: largest changes of
    the evidence when every other node is left out, on the whole and line by line, where errors
    along a ridge cannot cancel. For a normal bump the error t falls to t⁴/8 at half the step, so
    what is left is far smaller.
    """

    edge: float = 5e-4
    coarse: float = 0.04
    sliced: float = 0.1


@dataclass(frozen=True)
class Grid:
    """Log posterior on the nodes.

    `axes`: coordinates of the model's lead: scores of k (K,) and any effects, stretched scores of
    lapse_low (Lo,) and lapse_high (Hi,). `joint`: log density of the coordinates, biases
    integrated, (K, ..., Lo, Hi). `offsets`: bias nodes (B,), in sds from `centre` (R, X, G) with
    `spread` (R, X, G), where R counts the nodes of k and effects together and X is 1, or Lo·Hi if
    the nodes follow the lapses too; `bias_mass`: the posterior mass of every bias node,
    (R, X, B, G). `log_evidence` is for the sequence of answers; `error` estimates its absolute
    error. `reference`: lapses at which the bias nodes were centred. `bias_error`: what leaving out
    every other bias node changes, on average over the grid.
    """

    axes: Axes
    joint: Array
    offsets: Array
    centre: Array
    spread: Array
    bias_mass: Array
    log_evidence: float
    error: float
    reference: tuple[Array, Array]
    bias_error: float


def integrate(model: WeberModel, care: Care = Care()) -> Grid:
    """The posterior on a grid that suits it."""
    axes, reference = _lay_axes(model)
    narrow = np.linspace(-6.25, 6.25, 11) if model.free_bias else np.zeros(1)
    sketch = evaluate(model, axes, narrow[::2], reference)
    axes = tuple(
        _trim(sketch.joint, i, axis, LAPSE_NODES * name.startswith("lapse"), care.edge)
        for i, (axis, name) in enumerate(zip(axes, model.lead, strict=True))
    )
    offsets, follow, grid = narrow, False, sketch
    for _ in range(12):
        work = model.cells.n.size * offsets.size * float(np.prod([float(a.size) for a in axes]))
        work *= FOLLOWED if follow else 1
        if work > MOST:
            break
        grid = evaluate(model, axes, offsets, reference, follow)
        new_axes = tuple(
            adapt(grid.joint, i, axis, stretch.ends, care)
            for i, (axis, stretch) in enumerate(zip(axes, model.stretches, strict=True))
        )
        new_offsets = _adapt_offsets(grid, offsets, care)
        if new_offsets is offsets and all(a is b for a, b in zip(axes, new_axes, strict=True)):
            return grid
        if work > PLENTY and grid.error < GOOD and not _wider(axes, new_axes):
            return grid  # a ridge across the axes, well enough summed
        axes, offsets = new_axes, new_offsets
        if offsets.size > 4 * narrow.size and not follow:
            # Biases trade off against lapses: let their nodes follow, at ten times the cost.
            offsets, follow = narrow, True
    return replace(grid, error=np.inf)


def _lay_axes(model: WeberModel) -> tuple[Axes, tuple[Array, Array]]:
    """Axes around the mode, and the lapses at the mode."""
    free = model.free
    lapse, effect = np.array([-2.0, 0.0, 1.5, 3.0]), np.array([-1.0, 0.0, 1.0])
    coarse = (np.linspace(-5, 5, 26), *[effect] * len(model.effects), lapse, lapse)
    start_axes = tuple(
        stretch.coordinate(a) if f else np.zeros(1)
        for a, f, stretch in zip(coarse, free, model.stretches, strict=True)
    )
    offsets = np.linspace(-3.0, 3.0, 5) if model.free_bias else np.zeros(1)
    middle = (model.value("lapse_low", np.zeros(1)), model.value("lapse_high", np.zeros(1)))
    scan = evaluate(model, start_axes, offsets, middle)
    at = np.unravel_index(int(np.argmax(scan.joint)), scan.joint.shape)
    scores = np.array([a[i] if f else 0.0 for a, i, f in zip(coarse, at, free, strict=True)])
    row = int(np.ravel_multi_index(at[:-2], scan.joint.shape[:-2]))
    (scores, _), hessian = find_mode(model, scores, scan.centre[row, 0])
    lead = sum(free)
    wide = np.sqrt(np.diag(np.linalg.inv(hessian)))[:lead]
    # Curvature of the lead scores with the biases integrated.
    cross = hessian[:lead, lead:]
    curvature = hessian[:lead, :lead] - cross @ np.linalg.solve(hessian[lead:, lead:], cross.T)
    narrow = 1 / np.sqrt(np.diag(curvature))
    axes: list[Array] = []
    column = 0
    for name, is_free, score, stretch in zip(
        model.lead, free, scores, model.stretches, strict=True
    ):
        if not is_free:
            axes.append(np.zeros(1))
            continue
        middle_t = float(stretch.coordinate(score))
        per_score = 1 / float(stretch.slope(middle_t))
        is_lapse = name.startswith("lapse")
        step = (LAPSE_STEP if is_lapse else STEP) * narrow[column] * per_score
        reach = 6.0 * wide[column] * per_score / step
        # A lapse that is found may also be none: it has a long tail on that side.
        low_end = float(stretch.coordinate(-FAR_SCORE))
        below = (middle_t - low_end) / step if is_lapse else reach
        count = int(min(np.ceil(max(below, 1.0)), 24)), int(min(np.ceil(reach), 24))
        axes.append(middle_t + step * np.arange(-count[0], count[1] + 1))
        column += 1
    low, high = (
        model.value(name, score[None])
        for name, score in zip(model.lead[-2:], scores[-2:], strict=True)
    )
    return tuple(axes), (low, high)


def evaluate(
    model: WeberModel,
    axes: Axes,
    offsets: Array,
    reference: tuple[Array, Array],
    follow: bool = False,
) -> Grid:
    """The log posterior on given nodes; with `follow`, bias nodes are centred for every lapse."""
    values = [model.at(name, axis) for name, axis in zip(model.lead, axes, strict=True)]
    low, high = values[-2:]
    k, *moved = (a.ravel() for a in np.meshgrid(*values[:-2], indexing="ij"))
    effects = np.stack(moved, axis=-1) if moved else np.zeros((k.size, 0))  # (R, E)
    d, weight = np.broadcast_arrays(*model.task.decide(model.felt(k, effects)))  # (R, C)
    centred = d[:, None], weight[:, None]
    centre, spread = model.bias_mode(centred, *reference)  # (R, 1, G)
    lo, hi = model.lapses(low[:, None], high[None, :])
    all_lost = np.maximum(lo + hi, 1.0)  # nodes past the edge stand for places just before it
    lo, hi = (np.broadcast_to(a / all_lost, (low.size, high.size)).reshape(-1) for a in (lo, hi))
    if follow:
        pairs = np.repeat(low, high.size), np.tile(high, low.size)
        centre, spread = model.bias_mode(centred, *pairs, start=centre)  # (R, Lo·Hi, G)
    prior_of_lapses = lapse_prior(model, *axes[-2:])
    sheet = prior_of_lapses.shape
    h = offsets[1] - offsets[0] if offsets.size > 1 else 1.0
    joint = np.empty((k.size, *sheet))
    mass = np.empty((*centre.shape[:2], offsets.size, model.n_groups))
    thinned = np.zeros(k.size)
    answers = (_Answers if model.dispersed is None else DispersedAnswers)(model, lo, hi)
    rows = max(1, CHUNK // (lo.size * offsets.size * max(model.cells.n.size, 1)))
    # The lapses come last of all axes: they are the longest, and NumPy's loops run along the last.
    middles, spreads = (np.swapaxes(a, 1, 2) for a in (centre, spread))  # (R, G, X)
    for i in (slice(j, j + rows) for j in range(0, k.size, rows)):
        bias = middles[i, None] + spreads[i, None] * offsets[:, None, None]  # (r, B, G, X)
        pushed = weight[i, None, :, None] * bias[:, :, model.group]
        by_bias = answers(d[i, None, :, None], pushed, effects[i])  # (r, B, G, Lo·Hi)
        if model.free_bias:
            by_bias += model.log_bias_prior(bias) + np.log(h * spreads[i])[:, None]
        top = by_bias.max(axis=1, keepdims=True)
        # Answers that no bias explains have no mass, and no logarithm of it to take away.
        share = np.exp(by_bias - np.where(np.isneginf(top), 0.0, top))
        total = np.where(np.isneginf(top), 1.0, share.sum(axis=1, keepdims=True))
        by_group = (top + np.log(total))[:, 0]
        here = by_group.sum(axis=1).reshape(-1, *sheet) + prior_of_lapses
        joint[i] = here
        share /= total
        best = here.max(axis=(1, 2), keepdims=True)
        best = np.where(np.isneginf(best), 0.0, best)
        weight_here = np.exp(here - best).reshape(len(here), -1)
        if model.free_bias:
            lost = np.abs(2 * share[:, ::2].sum(axis=1) - 1).max(axis=1)
            thinned[i] = (weight_here * lost).sum(axis=1)
        share *= weight_here[:, None, None]
        by_lapses = share if follow else share.sum(axis=-1, keepdims=True)
        mass[i] = by_lapses.transpose(0, 3, 1, 2)
    joint = joint.reshape(*(a.size for a in axes[:-2]), *sheet)
    for place, axis in enumerate(axes[:-2]):
        prior = score_prior(axis)
        joint += prior.reshape(-1, *[1] * (joint.ndim - 1 - place))
    row = joint.max(axis=(-2, -1)).ravel()
    mass *= np.exp(row - row.max())[:, None, None, None]
    whole = mass.sum(axis=(0, 1, 2))
    mass /= whole
    bias_error = float(thinned @ np.exp(row - row.max()) / whole[0])
    log_cell = sum(np.log(a[1] - a[0]) for a in axes if a.size > 1)
    log_evidence = float(logsumexp(joint) + log_cell)
    error = max(_thinned_by_line(joint, i) for i in range(joint.ndim)) ** 4
    return Grid(
        axes, joint, offsets, centre, spread, mass, log_evidence, error, reference, bias_error
    )


class _Answers:
    """Log-likelihood of the answers by group, for lapses on a sheet of nodes (S,)."""

    def __init__(self, model: WeberModel, low: Array, high: Array) -> None:
        self.model = model
        self.slope = np.maximum(1 - low - high, 0.0)
        self.low, self.high = np.maximum(low, TINY), np.maximum(high, TINY)
        cells = model.cells
        self.sides = []
        for count in (cells.count, cells.n - cells.count):
            some = np.flatnonzero(count > 0)  # a level answered all one way has one logarithm
            self.sides.append((some, (model.membership[some] * count[some, None]).T))

    def __call__(self, d: Array, pushed: Array, effects: Array) -> Array:
        """Shape (r, B, G, S) from decision variables (r, 1, C, 1) and biases (r, B, C, X)."""
        both = self.model.task.chance(d, pushed)
        total: Array | float = 0.0
        for side, lapse, (some, weight) in zip(
            both, (self.low, self.high), self.sides, strict=True
        ):
            p = self.slope * np.take(side, some, axis=2)
            p += lapse
            np.log(p, out=p)
            total = total + weight @ p
        return np.asarray(total)


def score_prior(axis: Array) -> Array:
    """Standard normal log-density of the scores; nothing for a fixed parameter."""
    return -0.5 * axis**2 - 0.5 * np.log(2 * np.pi) if axis.size > 1 else np.zeros(1)


def lapse_prior(model: WeberModel, low: Array, high: Array) -> Array:
    """Log prior density of the lapses on their coordinates, (Lo, Hi).

    Lapses that leave no rise are impossible. A node that stands for some of either kind has the
    share of the possible ones: where few trials leave mass at that edge, sums over nodes that are
    all in or all out went by steps.
    """
    stretches = model.stretches[-2:]
    z = [s.score(t) for s, t in zip(stretches, (low, high), strict=True)]
    slope = [np.log(s.slope(t)) * (t.size > 1) for s, t in zip(stretches, (low, high), strict=True)]
    lo, hi = model.lapses(
        model.value("lapse_low", z[0])[:, None], model.value("lapse_high", z[1])[None, :]
    )
    density = log_score_prior(z[0][:, None], z[1][None, :], model.priors.lapse_correlation)
    density += slope[0][:, None] + slope[1] - log_lapses_possible(model.task, model.priors)
    lost = np.broadcast_to(lo + hi, density.shape)
    free = [axis for axis in (0, 1) if lost.shape[axis] > 1]
    across = np.sum([np.abs(np.gradient(lost, axis=axis)) for axis in free], axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(across > 0, np.clip((1 - lost) / across + 0.5, 0.0, 1.0), lost < 1)
        return np.asarray(density + np.log(share))


def log_marginal(grid: Grid, axis: int) -> Array:
    """Log marginal density of one score on its nodes, up to a constant."""
    density = _marginal(grid.joint, axis)
    return density - density.max()


def _marginal(joint: Array, axis: int) -> Array:
    """Log marginal density of one score, up to a constant."""
    others = tuple(i for i in range(joint.ndim) if i != axis)
    top = joint.max()
    with np.errstate(divide="ignore"):
        return np.log(np.exp(joint - top).sum(axis=others))


def _thinned(log_density: Array) -> float:
    """How far the evidence moves when every other node is left out."""
    if log_density.size == 1:
        return 0.0
    density = np.exp(log_density - log_density.max())
    return float(abs(np.log(max(2 * density[::2].sum() / density.sum(), TINY))))


def _thinned_by_line(joint: Array, axis: int) -> float:
    """The same along every line of the grid, errors added up: a ridge across the axes shows."""
    if joint.shape[axis] == 1:
        return 0.0
    lines = np.moveaxis(np.exp(joint - joint.max()), axis, -1)
    whole = lines.sum(axis=-1)
    return float(np.abs(2 * lines[..., ::2].sum(axis=-1) - whole).sum() / whole.sum())


def _steepest(log_density: Array) -> float:
    """The farthest fall from one node to the next, of nodes near the peak."""
    high = np.maximum(log_density[1:], log_density[:-1]) > -NEAR
    return float(np.max(np.abs(np.diff(log_density)), where=high, initial=0.0))


def adapt(
    joint: Array, index: int, axis: Array, ends: tuple[float, float], care: Care = Care()
) -> Array:
    """The axis itself where it serves; wider where mass hangs over, finer where nodes are few."""
    if axis.size == 1:
        return axis
    log_density = _marginal(joint, index)
    log_density = np.maximum(log_density - log_density.max(), -600.0)
    step = axis[1] - axis[0]
    below, above = _missing(log_density[::-1], care.edge), _missing(log_density, care.edge)
    below = min(below, max(int((axis[0] - ends[0]) / step), 0))
    above = min(above, max(int((ends[1] - axis[-1]) / step), 0))
    shrink = min(
        _shrink(_thinned(log_density), care.coarse),
        _shrink(_thinned_by_line(joint, index), care.sliced),
        # A lapse's axis ends where its prior does, steep or not.
        _shrink(_steepest(log_density), CLIFF if ends == PLAIN.ends else np.inf),
    )
    if shrink == 1 and below <= 0 and above <= 0:
        return axis
    held = np.flatnonzero(log_density > np.log(1e-3 * care.edge))[[0, -1]]
    low = axis[held[0]] - step * (1 + max(below, 0))
    high = axis[held[1]] + step * (1 + max(above, 0))
    return _even(low, high, shrink * step)


def _wider(axes: Axes, new_axes: Axes) -> bool:
    """Whether any axis was found too short."""
    return any(
        b[0] < a[0] - 1.5 * (a[1] - a[0]) or b[-1] > a[-1] + 1.5 * (a[1] - a[0])
        for a, b in zip(axes, new_axes, strict=True)
        if a.size > 1
    )


def _shrink(thinned: float, most: float) -> float:
    """What to make of a step that may be too coarse."""
    return 1.0 if thinned <= most else FINER


def _missing(log_density: Array, edge: float) -> int:
    """Nodes wanting beyond the last, where the density still hangs over it."""
    over = log_density[-1] - np.log(edge)
    if over <= 0:
        return 0
    fall = max(log_density[-2] - log_density[-1], 1e-3)
    return int(min(np.ceil(over / fall), log_density.size))


def _trim(joint: Array, index: int, axis: Array, least: int, edge: float) -> Array:
    """Twice the nodes, and no fewer than `least`, over the range that holds the mass."""
    if axis.size == 1:
        return axis
    density = _marginal(joint, index)
    held = np.flatnonzero(density > density.max() + np.log(1e-3 * edge))[[0, -1]]
    step = axis[1] - axis[0]
    low, high = axis[held[0]] - 0.5 * step, axis[held[1]] + 0.5 * step
    return _even(low, high, min(0.5 * step, (high - low) / max(least - 1, 1)))


def _even(low: float, high: float, step: float) -> Array:
    return np.asarray(low + step * np.arange(round((high - low) / step) + 1), dtype=float)


def _adapt_offsets(grid: Grid, offsets: Array, care: Care) -> Array:
    """The same for the biases, all groups at once."""
    if offsets.size == 1:
        return offsets
    step = offsets[1] - offsets[0]
    with np.errstate(divide="ignore"):
        by_node = np.log(grid.bias_mass.sum(axis=(0, 1))).T  # (G, B)
    by_node = np.maximum(by_node - by_node.max(axis=1, keepdims=True), -600.0)
    below = max(_missing(m[::-1], care.edge) for m in by_node)
    above = max(_missing(m, care.edge) for m in by_node)
    if below or above:
        return _even(offsets[0] - below * step, offsets[-1] + above * step, step)
    shrink = _shrink(grid.bias_error, care.sliced)
    return offsets if shrink == 1 else _even(offsets[0], offsets[-1], shrink * step)
