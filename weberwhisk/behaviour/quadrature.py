"""The posterior of one observer by a product rule made for this likelihood.

Axes: the normal scores of k and of the two lapses (every prior is a standard normal there), and for
each group its bias, on nodes that follow its conditional mode as k changes. Trapezoid sums over
such smooth bumps converge exponentially. The rule finds the mode, lays the axes from the curvature,
then widens and halves them until nothing hangs over an edge and every other node gives the same.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp, ndtr

from .likelihood import TINY, WeberModel
from .mode import LEAD, REACH, find_mode, free_scores, log_lapses_possible, score_value

Array = NDArray[np.float64]

EDGE = 5e-4  # largest density at an edge, relative to the peak
CHUNK = 40_000  # values at once: a few arrays of this size stay in the cache
COARSE = 0.04  # largest change of the evidence when every other node is left out
SLICED = 0.1  # the same, line by line of the grid, where errors along a ridge cannot cancel


@dataclass(frozen=True)
class Grid:
    """Log posterior on the nodes.

    `axes`: scores of k (K,), lapse_low (Lo,), lapse_high (Hi,). `joint`: log density of the scores,
    biases integrated, (K, Lo, Hi). `offsets`: bias nodes (B,), in sds from `centre` (K, X, G) with
    `spread` (K, X, G), where X is 1, or Lo·Hi if the nodes follow the lapses too; `bias_mass`: the
    posterior mass of every bias node, (K, X, B, G). `log_evidence` is for the sequence of answers;
    `error` estimates its absolute error. `reference`: lapses at which the bias nodes were centred.
    """

    axes: tuple[Array, Array, Array]
    joint: Array
    offsets: Array
    centre: Array
    spread: Array
    bias_mass: Array
    log_evidence: float
    error: float
    reference: tuple[Array, Array]


def integrate(model: WeberModel) -> Grid:
    """The posterior on a grid that suits it."""
    axes, reference = _lay_axes(model)
    narrow = np.linspace(-7.0, 7.0, 15) if model.free_bias else np.zeros(1)
    sketch = evaluate(model, axes, narrow[::2], reference)
    axes = tuple(_trim(sketch.joint, i, axis) for i, axis in enumerate(axes))  # type: ignore[assignment]
    offsets, follow = narrow, False
    for _ in range(12):
        grid = evaluate(model, axes, offsets, reference, follow)
        k, low, high = (adapt(grid.joint, i, axis) for i, axis in enumerate(axes))
        new_axes = k, low, high
        new_offsets = _adapt_offsets(grid.bias_mass, offsets)
        if new_offsets is offsets and all(a is b for a, b in zip(axes, new_axes, strict=True)):
            return grid
        axes, offsets = new_axes, new_offsets
        if offsets.size > 4 * narrow.size and not follow:
            # Biases trade off against lapses: let their nodes follow, at ten times the cost.
            offsets, follow = narrow, True
    return replace(grid, error=np.inf)


def _lay_axes(model: WeberModel) -> tuple[tuple[Array, Array, Array], tuple[Array, Array]]:
    """Axes around the mode, and the lapses at the mode."""
    free = free_scores(model)
    coarse = (
        np.linspace(-5, 5, 26),
        np.array([-2.0, 0.0, 1.5, 3.0]),
        np.array([-2.0, 0.0, 1.5, 3.0]),
    )
    start_axes = tuple(a if f else np.zeros(1) for a, f in zip(coarse, free, strict=True))
    offsets = np.linspace(-3.0, 3.0, 5) if model.free_bias else np.zeros(1)
    middle = tuple(score_value(model, name, np.zeros(1)) for name in LEAD[1:])
    scan = evaluate(model, start_axes, offsets, middle)  # type: ignore[arg-type]
    at = np.unravel_index(int(np.argmax(scan.joint)), scan.joint.shape)
    scores = np.array([a[i] for a, i in zip(start_axes, at, strict=True)])
    (scores, _), hessian = find_mode(model, scores, scan.centre[at[0], 0])
    wide = np.sqrt(np.diag(np.linalg.inv(hessian)))[: sum(free)]
    if model.free_bias:  # curvature of the lead scores with the biases integrated
        lead = sum(free)
        cross = hessian[:lead, lead:]
        curvature = hessian[:lead, :lead] - cross @ np.linalg.solve(hessian[lead:, lead:], cross.T)
    else:
        curvature = hessian
    narrow = 1 / np.sqrt(np.diag(curvature))
    axes: list[Array] = []
    column = 0
    for i in range(3):
        if not free[i]:
            axes.append(np.zeros(1))
            continue
        reach, step = wide[column], (1.4 if i else 1.8) * narrow[column]
        # A lapse that is found may also be none: its score has a long tail on that side.
        below = min(np.ceil((9.0 if i else 6.0) * reach / step), 24, (scores[i] + REACH) // step)
        above = min(np.ceil(5.5 * reach / step), 24)
        axes.append(scores[i] + step * np.arange(-int(below), int(above) + 1))
        column += 1
    reference = tuple(
        score_value(model, name, scores[i + 1 : i + 2]) for i, name in enumerate(LEAD[1:])
    )
    return (axes[0], axes[1], axes[2]), (reference[0], reference[1])


def evaluate(
    model: WeberModel,
    axes: tuple[Array, Array, Array],
    offsets: Array,
    reference: tuple[Array, Array],
    follow: bool = False,
) -> Grid:
    """The log posterior on given nodes; with `follow`, bias nodes are centred for every lapse."""
    k, low, high = (score_value(model, name, axis) for name, axis in zip(LEAD, axes, strict=True))
    centre, spread = model.bias_mode(k[:, None], reference[0], reference[1])  # (K, 1, G)
    lo, hi = model.lapses(low[:, None], high[None, :])
    lo, hi = (np.broadcast_to(a, (low.size, high.size)).reshape(-1, 1, 1) for a in (lo, hi))
    if follow:
        pairs = np.repeat(low, high.size), np.tile(high, low.size)
        centre, spread = model.bias_mode(k[:, None], *pairs, start=centre)  # (K, Lo·Hi, G)
    prior_of_lapses = lapse_prior(model, axes[1], axes[2])
    slope = np.maximum(1 - lo - hi, 0.0)
    lo, hi = np.maximum(lo, TINY), np.maximum(hi, TINY)
    yes = model.membership * model.cells.count[:, None]
    no = model.membership * (model.cells.n - model.cells.count)[:, None]
    eta = model.eta(k)
    h = offsets[1] - offsets[0] if offsets.size > 1 else 1.0
    joint = np.empty((k.size, *prior_of_lapses.shape))
    mass = np.empty((*centre.shape[:2], offsets.size, model.n_groups))
    rows = max(1, CHUNK // (lo.size * offsets.size * max(model.cells.n.size, 1)))
    for i in (slice(j, j + rows) for j in range(0, k.size, rows)):
        bias = centre[i, :, None, :] + spread[i, :, None, :] * offsets[:, None]  # (k, X, B, G)
        z = eta[i, None, None, :] + bias[..., model.group]
        p, q = slope * ndtr(z), slope * ndtr(-z)
        p += lo
        q += hi
        by_bias = np.log(p, out=p) @ yes + np.log(q, out=q) @ no  # (k, Lo·Hi, B, G)
        if model.free_bias:
            by_bias += model.log_bias_prior(bias) + np.log(h * spread[i])[:, :, None, :]
        top = by_bias.max(axis=2, keepdims=True)
        weight = np.exp(by_bias - top)
        total = weight.sum(axis=2, keepdims=True)
        by_group = (top + np.log(total))[:, :, 0, :]
        here = by_group.sum(axis=-1).reshape(-1, *prior_of_lapses.shape) + prior_of_lapses
        joint[i] = here
        weight *= (
            np.exp(here - here.max(axis=(1, 2), keepdims=True)).reshape(len(here), -1, 1, 1) / total
        )
        mass[i] = weight if follow else weight.sum(axis=1, keepdims=True)
    joint += score_prior(axes[0])[:, None, None]
    row = joint.max(axis=(1, 2))
    mass *= np.exp(row - row.max())[:, None, None, None]
    mass /= mass.sum(axis=(0, 1, 2))
    log_cell = sum(np.log(a[1] - a[0]) for a in axes if a.size > 1)
    log_evidence = float(logsumexp(joint) + log_cell)
    error = max(_thinned_by_line(joint, i) for i in range(3)) ** 2
    return Grid(axes, joint, offsets, centre, spread, mass, log_evidence, error, reference)


def score_prior(axis: Array) -> Array:
    """Standard normal log-density of the scores; nothing for a fixed parameter."""
    return -0.5 * axis**2 - 0.5 * np.log(2 * np.pi) if axis.size > 1 else np.zeros(1)


def lapse_prior(model: WeberModel, low: Array, high: Array) -> Array:
    """Log prior density of the lapse scores, (Lo, Hi); lapses that leave no rise are impossible."""
    lo, hi = model.lapses(
        score_value(model, LEAD[1], low)[:, None], score_value(model, LEAD[2], high)[None, :]
    )
    density = (
        score_prior(low)[:, None]
        + score_prior(high)[None, :]
        - log_lapses_possible(model.task, model.priors)
    )
    return np.where(lo + hi < 1, density, -np.inf)


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


def adapt(joint: Array, index: int, axis: Array) -> Array:
    """The axis itself where it serves; wider where mass hangs over, finer where nodes are few."""
    if axis.size == 1:
        return axis
    log_density = _marginal(joint, index)
    log_density = np.maximum(log_density - log_density.max(), -600.0)
    step = axis[1] - axis[0]
    below, above = _missing(log_density[::-1]), _missing(log_density)
    below = min(below, int((axis[0] + REACH) / step))
    above = min(above, int((REACH - axis[-1]) / step))
    coarse = _thinned(log_density) > COARSE or _thinned_by_line(joint, index) > SLICED
    if not (coarse or below > 0 or above > 0):
        return axis
    held = np.flatnonzero(log_density > np.log(1e-3 * EDGE))[[0, -1]]
    low = axis[held[0]] - step * (1 + max(below, 0))
    high = axis[held[1]] + step * (1 + max(above, 0))
    return _even(low, high, 0.5 * step if coarse else step)


def _missing(log_density: Array) -> int:
    """Nodes wanting beyond the last, where the density still hangs over it."""
    over = log_density[-1] - np.log(EDGE)
    if over <= 0:
        return 0
    fall = max(log_density[-2] - log_density[-1], 1e-3)
    return int(min(np.ceil(over / fall), log_density.size))


def _trim(joint: Array, index: int, axis: Array) -> Array:
    """Twice the nodes, over the range that holds the mass."""
    if axis.size == 1:
        return axis
    density = _marginal(joint, index)
    held = np.flatnonzero(density > density.max() + np.log(1e-3 * EDGE))[[0, -1]]
    step = axis[1] - axis[0]
    return _even(axis[held[0]] - 0.5 * step, axis[held[1]] + 0.5 * step, 0.5 * step)


def _even(low: float, high: float, step: float) -> Array:
    return np.asarray(low + step * np.arange(round((high - low) / step) + 1), dtype=float)


def _adapt_offsets(mass: Array, offsets: Array) -> Array:
    """The same for the biases, all groups at once."""
    if offsets.size == 1:
        return offsets
    step = offsets[1] - offsets[0]
    with np.errstate(divide="ignore"):
        by_node = np.log(mass.sum(axis=(0, 1))).T  # (G, B)
    by_node = np.maximum(by_node - by_node.max(axis=1, keepdims=True), -600.0)
    below = max(_missing(m[::-1]) for m in by_node)
    above = max(_missing(m) for m in by_node)
    if below or above:
        return step * np.arange(
            round(offsets[0] / step) - below, round(offsets[-1] / step) + above + 1
        )
    if max(_thinned(m) for m in by_node) > COARSE:
        return np.linspace(offsets[0], offsets[-1], 2 * offsets.size - 1)
    return offsets
