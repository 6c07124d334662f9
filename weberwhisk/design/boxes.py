"""Where the posteriors of many data sets of one design lie, and steps that suit all of them.

The coordinates are those of `behaviour.quadrature`: the score of k, the stretched lapses, and the
bias of every group. Given k, each data set has a box of its own in the others, found by zooming in:
every pass drops what is empty and takes finer steps, until these are small beside the narrowest
bump there can be, where trapezoid sums are as good as exact.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..behaviour.lapses import lapse_prior
from ..behaviour.likelihood import WeberModel

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

STEP_K = 2.5  # in the least sd that it can have given the rest: its marginal is interpolated
STEP_BIAS = 1.9  # in the same, and summed
LAPSE_STEP = 1.4  # of the lapses, in their stretched coordinates
FINER = 3.0  # from one pass to the next, about
CUT = 7.5  # nats under the best node, where a node counts as empty
BETWEEN = 20.0  # nats allowed for what may lie between nodes far apart, at most
BEYOND = 0.15  # of a gap, added where linear interpolation puts the end of a box
BEYOND_K = 1.0  # the same for k, which is interpolated to its ends
NO_LAPSE = 0.01  # trials lost, below which a lapse is none
FAR = 6.0  # scores of k beyond which nothing is looked for
FAR_LAPSE = 3.5  # the same for lapses
FAR_BIAS = 5.0  # sds of the bias's prior, likewise
STEEP = 20.0  # nats by which what was not computed is taken to lie under the least
#: Steps of k, of the lapses, and of the biases in final steps: at first, and before the last pass.
WIDE = 0.5, 4.0, np.inf
ZOOMED = 2.0, 2.0, 2.0  # of k in final steps too
WIDE_BIAS = 0.7  # where no final steps are known


@dataclass(frozen=True)
class Boxes:
    """What is held of R data sets at each node of k.

    `scores` (K,) are the nodes; `ends`, both (R,), how far k goes; `low` and `high` (axes, K, R)
    the ends of the coordinates of both lapses and of the bias of each group, infinite the wrong way
    round where nothing is held.
    """

    scores: Array
    ends: tuple[Array, Array]
    low: Array
    high: Array

    def at(self, score: float) -> tuple[Mask, Array, Array]:
        """Which data sets hold a score of k, and their boxes there, both (axes, R)."""
        place = int(np.clip(np.searchsorted(self.scores, score) - 1, 0, self.scores.size - 1))
        both = slice(place, place + 2)
        low, high = self.low[:, both].min(axis=1), self.high[:, both].max(axis=1)
        inside = (self.ends[0] <= score + 1e-9) & (score - 1e-9 <= self.ends[1])
        return inside & (low[0] <= high[0]), low, high

    def nodes(self, step: float) -> Array:
        """Even nodes of k over all boxes."""
        return even(self.ends[0].min(), self.ends[1].max(), step)

    def lapses(self, step: float) -> tuple[Array, Array]:
        """Even nodes of both lapses over all boxes."""
        low, high = (even(self.low[i].min(), self.high[i].max(), step) for i in (0, 1))
        return low, high


@dataclass(frozen=True)
class Steps:
    """Of one pass: those of k and of the lapses, and of the biases in final steps."""

    k: float
    lapse: float
    biases: float


def even(low: float, high: float, step: float) -> Array:
    """Nodes from `low` to `high` or just beyond, one where the ends are the same."""
    return np.asarray(low + step * np.arange(int(np.ceil((high - low) / step - 1e-9)) + 1))


def passes(model: WeberModel, lapse_step: float = LAPSE_STEP) -> list[Steps]:
    """Steps, pass by pass; the last are fine."""
    fine = k_step(model)
    zooms = int(np.floor(np.log(max(WIDE[0] / (ZOOMED[0] * fine), 1.0)) / np.log(FINER) + 0.5))
    middle = [
        Steps(min(ZOOMED[0] * fine * FINER**i, WIDE[0]), max(ZOOMED[1], lapse_step), ZOOMED[2])
        for i in reversed(range(max(zooms, 1)))
    ]
    return [Steps(*WIDE), *middle, Steps(fine, lapse_step, 1.0)]


def everything(model: WeberModel, count: int) -> Boxes:
    """Boxes that hold whatever there may be."""
    lapses = [
        (none(model, name), float(stretch.coordinate(FAR_LAPSE))) if free else (0.0, 0.0)
        for name, stretch, free in zip(
            model.lead[-2:], model.stretches[-2:], model.free[-2:], strict=True
        )
    ]
    bias = (model.fixed_bias(),) * 2
    if model.free_bias:
        ends = model.priors.support("bias")
        mean, sd = model.priors.moments("bias")
        bias = max(ends[0], mean - FAR_BIAS * sd), min(ends[1], mean + FAR_BIAS * sd)
    far = FAR if model.free[0] else 0.0
    box = np.array([*lapses, *[bias] * model.n_groups])
    low, high = (np.repeat(side[:, None, None], count, axis=2) for side in box.T)
    return Boxes(np.zeros(1), (np.full(count, -far), np.full(count, far)), low, high)


def held(
    before: Boxes,
    scores: Array,
    profiles: list[tuple[Array, Any]],
    fine: float,
    cut: float,
) -> Boxes:
    """Boxes of the nodes that matter.

    Parameters
    ----------
    scores : ndarray, shape (K,)
    profiles : list of (nodes, values) pairs, for each axis (K, N) and (K, N, R)
        Highest log posterior density with each node of k and of an axis.
    fine : float
        The final step of k.
    cut : float
        Nats under the best node, where one counts as empty.
    """
    gap = scores[1] - scores[0] if scores.size > 1 else 0.0
    wide = before.scores.size == 1 or gap > 1.5 * ZOOMED[0] * fine
    between = min(0.5 * (0.5 * gap * STEP_K / fine) ** 2 + 3.0, BETWEEN) if wide else 0.0
    top = profiles[0][1].max(axis=1)  # (K, R)
    least = top.max(axis=0) - cut - between
    kept = top > least
    ends = _ends(scores[None], top[None], kept[None], least[None], 1.0 if wide else None, BEYOND_K)
    start, end = (side[0] for side in ends)
    below = np.broadcast_to(least, top.shape)
    if wide:  # where k is far from its peak the rest is not yet where it will be
        below = np.minimum(least, top - cut)
    low, high = (np.full((len(profiles), *top.shape), s) for s in (np.inf, -np.inf))
    for i, (nodes, values) in enumerate(profiles):
        full = values > below[:, None]
        sides = _ends(nodes, values, full, below, 0.5 if wide else None)
        low[i] = np.where(kept, np.maximum(sides[0], before.low[i].min()), np.inf)
        high[i] = np.where(kept, np.minimum(sides[1], before.high[i].max()), -np.inf)
    if scores.size > 1:  # k goes on beyond the last node held, and the box with it
        for side, nearest in ((low, np.minimum), (high, np.maximum)):
            around = np.pad(
                side, ((0, 0), (1, 1), (0, 0)), constant_values=np.inf if side is low else -np.inf
            )
            beside = nearest(around[:, :-2], around[:, 2:])
            side[:, ~kept] = beside[:, ~kept]
    start = np.maximum(start, before.ends[0].min())
    return Boxes(scores, (start, np.minimum(end, before.ends[1].max())), low, high)


def _ends(
    nodes: Array,
    values: Array,
    full: Mask,
    least: Array,
    reach: float | None,
    beyond: float = BEYOND,
) -> tuple[Array, Array]:
    """Where what is full begins and ends on an axis, (K, R).

    `reach` gaps beyond the last node that is full, or where it falls below the least.
    """
    size = nodes.shape[1]
    if size == 1:
        return nodes, nodes
    gap = (nodes[:, 1] - nodes[:, 0])[:, None]
    out = []
    for at, step in ((full.argmax(axis=1), -1), (size - 1 - full[:, ::-1].argmax(axis=1), 1)):
        place = np.take_along_axis(nodes, at, axis=1)
        share: Any = reach
        if reach is None:
            outside = np.clip(at + step, 0, size - 1)
            inner, outer = (
                np.take_along_axis(values, i[:, None], axis=1)[:, 0] for i in (at, outside)
            )
            outer = np.maximum(np.where(outside == at, -np.inf, outer), least - STEEP)
            inner = np.maximum(inner, least)  # where nothing is held, whatever
            share = beyond + (inner - least) / np.maximum(inner - outer, 1e-9)
        out.append(place + step * share * gap)
    return out[0], out[1]


def lapse_weights(model: WeberModel, low: Array, high: Array) -> Array:
    """Log prior probability of the lapse nodes, (Lo, Hi).

    A first node so low that no trial is lost stands for everything below it.
    """
    pair, starts = [], []
    for name, axis in zip(model.lead[-2:], (low, high), strict=True):
        pair.append(with_tail(model, name, axis))
        starts.append(np.r_[0, pair[-1].size - axis.size + 1 : pair[-1].size])
    weights = np.exp(lapse_prior(model, *pair))
    for i, axis in enumerate(pair):
        weights *= axis[1] - axis[0] if axis.size > 1 else 1.0
        weights = np.add.reduceat(weights, starts[i], axis=i)
    with np.errstate(divide="ignore"):
        return np.log(weights)


def with_tail(model: WeberModel, name: str, axis: Array) -> Array:
    """The nodes of a lapse carried on below the first, where that is none at all."""
    if axis.size == 1 or axis[0] > none(model, name) + 1e-9:
        return axis
    stretch = model.stretches[model.lead.index(name)]
    step = axis[1] - axis[0]
    below = max(int((axis[0] - float(stretch.coordinate(-FAR_LAPSE))) / step), 0)
    return axis[0] + step * np.arange(-below, axis.size)


def none(model: WeberModel, name: str) -> float:
    """Coordinate under which a lapse loses no trial."""
    stretch = model.stretches[model.lead.index(name)]
    z = np.linspace(-FAR_LAPSE, 3.0, 151)
    lost = model.value(name, z) * max(float(model.cells.n.sum()), 1.0)
    return float(stretch.coordinate(z[max(int(np.searchsorted(lost, NO_LAPSE)) - 1, 0)]))


def k_step(model: WeberModel) -> float:
    """A step of the score of k, fine beside the narrowest bump that any answers can leave."""
    if not model.free[0]:
        return 1.0
    scores, h = np.linspace(-FAR, FAR, 161), 1e-3
    # Under a lapse, and away from even chances, an answer tells less.
    sides = []
    for s in (h, -h):
        d, weight = model.task.decide(model.felt(model.value("weber_fraction", scores + s)))
        sides.append(model.task.chance(d, np.asarray(weight) * model.fixed_bias())[0])
    return float(STEP_K / np.sqrt(_told(model.cells.n, sides, 2 * h).sum(axis=-1).max() + 1))


def bias_steps(model: WeberModel, d: Array, weight: Array, span: Array) -> Array:
    """The same for the bias of every group, (K, G), at the decision variables (K, C) of some k."""
    if not model.free_bias:
        return np.ones((len(d), model.n_groups))
    h, at = 1e-3, span[:, None, None]
    sides = [model.task.chance(d, weight * (at + s))[0] for s in (h, -h)]
    told = _told(model.cells.n, sides, 2 * h) @ model.membership  # (B, K, G)
    return STEP_BIAS / np.sqrt(told.max(axis=0) + 1 / model.priors.moments("bias")[1] ** 2)


def _told(n: Array, sides: list[Array], between: float) -> Array:
    """Fisher information of n answers, of their chances after and before a change."""
    after, before = sides
    p = np.clip(0.5 * (after + before), 1e-9, 1 - 1e-9)
    return np.asarray(n * ((after - before) / between) ** 2 / (p * (1 - p)))
