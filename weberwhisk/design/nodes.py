"""Nodes around the posteriors of many data sets of one design: few, and enough for all of them.

They are those of `behaviour.quadrature`, a product rule in the score of k, the stretched lapses and
the biases; but of its box only those are kept that matter to some data set, a few in a hundred.
They are found by zooming in: every pass drops what is empty and takes finer steps, until these are
small beside the narrowest bump there can be, where trapezoid sums are as good as exact.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

from ..behaviour.likelihood import WeberModel
from ..behaviour.quadrature import lapse_prior

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
Mask = NDArray[np.bool_]

STEP = 1.7  # of k and the biases, in the least sd that they can have given the rest
LAPSE_STEP = 1.4  # of the lapses, in their stretched coordinates
FINER, CLOSE = 3.0, 3.0  # from one pass to the next; where one pass will do
CUT = 9.5  # nats under the best node, where a node counts as empty
MOST_BETWEEN = 20.0  # nats allowed for what may lie between nodes, at most
NO_LAPSE = 0.01  # trials lost, below which a lapse is none
FAR = 8.0  # scores of k beyond which nothing is looked for
FAR_LAPSE = 4.5  # the same for lapses
WIDEST = np.linspace(-FAR, FAR, 17), np.array([-2.0, 0.0, 0.7, 1.4, 2.1, 2.8]), 17
INFORMATION = 2 / np.pi  # the most that one answer tells of the score behind it, at even chances


@dataclass(frozen=True)
class Lattice:
    """Nodes: some of a box.

    `axes`: scores of k (K,), coordinates of both lapses (Lo,) and (Hi,), then the biases of each
    group (B,). `masks`: for each group the nodes in use, (K, Lo, Hi, B).
    """

    axes: tuple[Array, ...]
    masks: tuple[Mask, ...]

    @property
    def triples(self) -> Mask:
        """Nodes of k and the lapses that have some bias in every group, (K, Lo, Hi)."""
        return np.logical_and.reduce([mask.any(axis=3) for mask in self.masks])


def widest(model: WeberModel) -> Lattice:
    """Everything that may be, in large steps."""
    k, lapse, size = WIDEST
    low, high = (
        stretch.coordinate(lapse) if free else np.zeros(1)
        for stretch, free in zip(model.stretches[-2:], model.free[-2:], strict=True)
    )
    bias = np.array([model.fixed_bias()])
    if model.free_bias:
        mean, sd = model.priors.moments("bias")
        bias = mean + sd * np.linspace(-4.0, 4.0, size)
    axes = (k if model.free[0] else np.zeros(1), low, high, *[bias] * model.n_groups)
    return Lattice(axes, _everywhere(axes))


def _everywhere(axes: tuple[Array, ...]) -> tuple[Mask, ...]:
    shape = tuple(a.size for a in axes[:3])
    return tuple(np.ones((*shape, bias.size), dtype=bool) for bias in axes[3:])


def refined(
    model: WeberModel, lattice: Lattice, held: list[Mask], with_neighbours: bool
) -> tuple[Lattice, bool]:
    """A finer lattice over the cells of the nodes held, and whether it is as fine as wanted.

    With neighbours where nodes are so far apart that what lies between them may be far fuller than
    they are.
    """
    wide = [binary_dilation(mask) for mask in held] if with_neighbours else held
    used = [
        np.logical_or.reduce([m.any(axis=tuple(j for j in range(4) if j != i)) for m in wide])
        for i in range(3)
    ] + [m.any(axis=(0, 1, 2)) for m in wide]
    steps = _steps(model, lattice.axes[0][used[0]])
    limits = _limits(model)
    axes, nearest, fine = [], [], True
    for axis, own, step, (low, high) in zip(lattice.axes, used, steps, limits, strict=True):
        if axis.size == 1:
            axes.append(axis)
            nearest.append(np.zeros(1, dtype=np.intp))
            continue
        some = np.flatnonzero(own)[[0, -1]]
        gap = np.diff(axis)
        low = max(axis[some[0]] - 0.5 * gap[max(some[0] - 1, 0)], low)
        high = min(axis[some[1]] + 0.5 * gap[min(some[1], gap.size - 1)], high)
        wanted = step if gap.max() < CLOSE * step else gap.max() / FINER
        new = np.linspace(low, high, max(int(np.ceil((high - low) / wanted)) + 1, 3))
        fine = fine and new[1] - new[0] <= 1.001 * step
        axes.append(new)
        nearest.append(np.abs(new[:, None] - axis).argmin(axis=1))
    masks = tuple(m[np.ix_(*nearest[:3], b)] for m, b in zip(wide, nearest[3:], strict=True))
    return Lattice(tuple(axes), masks), fine


def lapse_weights(model: WeberModel, lattice: Lattice) -> Array:
    """Log prior probability of the lapse nodes, (Lo, Hi).

    A first node so low that no trial is lost stands for everything below it.
    """
    pair, starts = [], []
    for name, axis, stretch in zip(
        model.lead[-2:], lattice.axes[1:3], model.stretches[-2:], strict=True
    ):
        below = 0
        if axis.size > 1 and axis[0] <= _none(model, name) + 1e-9:
            step = axis[1] - axis[0]
            below = max(int((axis[0] - float(stretch.coordinate(-FAR_LAPSE))) / step), 0)
            axis = axis[0] + step * np.arange(-below, axis.size)
        pair.append(axis)
        starts.append(np.r_[0, below + 1 : axis.size])
    weights = np.exp(lapse_prior(model, *pair))
    for i, axis in enumerate(pair):
        weights *= axis[1] - axis[0] if axis.size > 1 else 1.0
        weights = np.add.reduceat(weights, starts[i], axis=i)
    with np.errstate(divide="ignore"):
        return np.log(weights)


def _none(model: WeberModel, name: str) -> float:
    """Coordinate under which a lapse loses no trial."""
    stretch = model.stretches[model.lead.index(name)]
    z = np.linspace(-FAR_LAPSE, 3.0, 151)
    lost = model.value(name, z) * max(float(model.cells.n.sum()), 1.0)
    return float(stretch.coordinate(z[max(int(np.searchsorted(lost, NO_LAPSE)) - 1, 0)]))


def coarseness(model: WeberModel, lattice: Lattice) -> float:
    """How many times as far apart nodes are as they should be, on the worst axis."""
    steps = _steps(model, lattice.axes[0])
    return max(
        float(np.diff(axis).max()) / step
        for axis, step in zip(lattice.axes, steps, strict=True)
        if axis.size > 1
    )


def emptiness(coarse: float) -> float:
    """Nats under the best node at which one is empty: half a cell from a peak costs its share."""
    return CUT + min(0.5 * (0.5 * STEP * coarse) ** 2, MOST_BETWEEN)


def _limits(model: WeberModel) -> list[tuple[float, float]]:
    """Where nothing is looked for beyond, axis by axis."""
    low, high = model.priors.support("bias")
    mean, sd = model.priors.moments("bias") if model.free_bias else (0.0, 1.0)
    lapses = [
        (_none(model, name), float(stretch.coordinate(FAR_LAPSE)))
        for name, stretch in zip(model.lead[-2:], model.stretches[-2:], strict=True)
    ]
    bias = max(low, mean - 9 * sd), min(high, mean + 9 * sd)
    return [(-FAR, FAR), *lapses, *[bias] * model.n_groups]


def _steps(model: WeberModel, scores: Array) -> list[float]:
    """Steps that are fine beside the narrowest bump that any answers can leave."""
    n = model.cells.n
    if not model.free[0]:
        scores = np.zeros(1)
    h = 1e-3
    zero, bias = np.zeros(scores.shape), np.full((*scores.shape, model.n_groups), 0.0)
    # Under a lapse, and away from even chances, an answer tells less.
    sides = [
        model.task.chance(*_pushed(model, model.value("weber_fraction", scores + s), bias))[0]
        for s in (h, -h)
    ]
    slope = (sides[0] - sides[1]) / (2 * h)
    p = np.clip(0.5 * (sides[0] + sides[1]), 1e-9, 1 - 1e-9)
    told = (n * slope**2 / (p * (1 - p))).sum(axis=-1).max() + zero[0]
    of_bias = []
    for group in range(model.n_groups):
        sd = model.priors.moments("bias")[1] if model.free_bias else 1.0
        total = INFORMATION * n[model.group == group].sum()
        of_bias.append(STEP / np.sqrt(total + 1 / sd**2))
    return [STEP / float(np.sqrt(told + 1)), LAPSE_STEP, LAPSE_STEP, *of_bias]


def _pushed(model: WeberModel, k: Array, bias: Array) -> tuple[Array, Array]:
    d, weight = model.task.decide(model.felt(k))
    return d, np.asarray(weight * bias[..., model.group])
