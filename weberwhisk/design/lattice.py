"""Posteriors of thousands of experiments at once: tables of log P, and matrix products.

All data sets of one design share their stimuli, so the log-probability of every answer at every
node of a grid is tabulated once, and the log-likelihood of all of them is counts @ table. The nodes
are those of `behaviour.quadrature`, a product rule in the score of k, the stretched lapses and the
biases, which are integrated group by group as they are independent given the rest; but of its box
only those are kept that matter to some data set of a batch, a few in a hundred. They are found by
zooming in: every pass drops what is empty and takes finer steps, until these are small beside the
narrowest bump there can be, where trapezoid sums are as good as exact.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

from ..behaviour.likelihood import WeberModel
from ..behaviour.quadrature import lapse_prior, score_prior

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
Mask = NDArray[np.bool_]

STEP = 1.7  # of k and the biases, in the least sd that they can have given the rest
LAPSE_STEP = 1.4  # of the lapses, in their stretched coordinates
FINER = 3.0  # from one pass to the next, at most
CUT = 8.0  # nats under the best node, where a node counts as empty
BATCH = 512  # data sets weighed on one grid
BLOCK = 400_000  # values at once: what stays in the cache
ROUNDED = 4  # biases of a triple, to a multiple
LEAST = np.float32(1e-30)  # of a probability
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


@dataclass(frozen=True)
class Weights:
    """Likelihoods of R data sets, (R, K), at scores of k (K,): lapses and biases integrated."""

    scores: Array
    log_likelihood: Array


def integrate(model: WeberModel, counts: Array) -> Iterator[tuple[Indices, Weights]]:
    """Weigh data sets, those of similar Weber fraction together, on nodes that suit them.

    Parameters
    ----------
    model : WeberModel
        Without effects; its cells say how many trials there are.
    counts : ndarray, shape (D, A, C)
        Answers counted, of the trials of every cell; they need not be whole. The A of one data set
        stay together.

    Yields
    ------
    rows : ndarray of int
        Which data sets.
    Weights
        Theirs, with D·A rows.
    """
    start = _widest(model)
    table = _Table(model, start)
    flat = counts.reshape(-1, counts.shape[-1])
    place = np.concatenate(
        [table.profile(flat[i : i + BATCH])[1].argmax(axis=0) for i in range(0, len(flat), BATCH)]
    )
    place = table.k_of[place].reshape(counts.shape[:2])
    order = np.lexsort((place.max(axis=1), place.min(axis=1)))
    batch = max(1, BATCH // counts.shape[1])
    for rows in (order[i : i + batch] for i in range(0, len(order), batch)):
        inside = counts[rows].reshape(-1, counts.shape[-1])
        lattice, fine = _refined(model, start, table.held(inside))
        while not fine:
            lattice, fine = _refined(model, lattice, _Table(model, lattice).held(inside))
        yield rows, _Table(model, lattice).integrated(inside)


@dataclass(frozen=True)
class _Piece:
    """Nodes of one group that form a rectangle: W neighbouring biases of each of some triples.

    `triples` (T,) and `bias` (W, T) are indices; `table` (2C + 1, W, T) holds the log-probabilities
    of both answers of every cell, and the log weight of the bias. Data sets come last everywhere:
    sums over biases then run along memory.
    """

    group: int
    triples: Indices
    bias: Indices
    table: NDArray[np.float32]

    def values(self, answers: list[NDArray[np.float32]]) -> NDArray[np.float32]:
        """Log-likelihood of the group's answers, (W, T, R)."""
        flat = self.table.reshape(len(self.table), -1).T @ answers[self.group]
        return flat.reshape(*self.bias.shape, -1)


class _Table:
    """The answers' log-probabilities on a lattice, in pieces that stay in the cache."""

    def __init__(self, model: WeberModel, lattice: Lattice) -> None:
        self.model, self.lattice = model, lattice
        triples = lattice.triples
        self.at = np.nonzero(triples)
        self.k_of = self.at[0]
        log_prior = score_prior(lattice.axes[0])[:, None, None] + _lapse_weights(model, lattice)
        self.log_prior = log_prior[self.at].astype(np.float32)
        self.groups = [np.flatnonzero(model.group == g) for g in range(model.n_groups)]
        self.pieces = [piece for group in range(model.n_groups) for piece in self._cut(group)]

    def _cut(self, group: int) -> Iterator[_Piece]:
        """The pieces of one group: triples with about as many biases each."""
        model, axes = self.model, self.lattice.axes
        cells, bias = self.groups[group], axes[3 + group]
        d, weight = model.task.decide(model.felt(model.value("weber_fraction", axes[0])))
        weight = np.broadcast_to(weight, d.shape)[:, cells]
        both = model.task.chance(d[:, None, cells], weight[:, None] * bias[:, None])  # (K, B, C)
        up, down = (np.moveaxis(a, -1, 0).astype(np.float32) for a in both)
        low, high = (model.at(n, a) for n, a in zip(model.lead[-2:], axes[1:3], strict=True))
        low, high = (a.astype(np.float32) for a in model.lapses(low[self.at[1]], high[self.at[2]]))
        step = bias[1] - bias[0] if bias.size > 1 else 1.0
        log_weight = model.log_bias_prior(bias) + np.log(step)
        used = self.lattice.masks[group][self.at]  # (T, B)
        first = used.argmax(axis=1)
        width = used.shape[1] - used[:, ::-1].argmax(axis=1) - first
        width = np.minimum(-(-width // ROUNDED) * ROUNDED, bias.size)
        for size in np.unique(width):
            some = np.flatnonzero(width == size)
            most = max(1, BLOCK // (BATCH * int(size)))
            for own in (some[i : i + most] for i in range(0, some.size, most)):
                b = np.minimum(first[own], bias.size - size) + np.arange(size)[:, None]
                table = np.empty((2 * cells.size + 1, *b.shape), dtype=np.float32)
                yes, no = (a[:, self.k_of[own], b] for a in (up, down))
                lo, hi = low[own], high[own]
                np.log(np.maximum(lo * no + (1 - hi) * yes, LEAST), out=table[: cells.size])
                np.log(np.maximum((1 - lo) * no + hi * yes, LEAST), out=table[cells.size : -1])
                table[-1] = log_weight[b]
                yield _Piece(group, own, b, table)

    def _answers(self, counts: Array) -> list[NDArray[np.float32]]:
        """The rows that meet the tables, a matrix for each group."""
        n = self.model.cells.n
        ones = np.ones((len(counts), 1))
        return [
            np.hstack([counts[:, c], n[c] - counts[:, c], ones]).T.astype(np.float32, order="C")
            for c in self.groups
        ]

    def profile(self, counts: Array) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Each group at its best bias, (G, T, R), and all with the prior, (T, R)."""
        answers = self._answers(counts)
        best = np.empty((len(self.groups), self.k_of.size, len(counts)), dtype=np.float32)
        for piece in self.pieces:
            best[piece.group, piece.triples] = piece.values(answers).max(axis=0)
        return best, best.sum(axis=0) + self.log_prior[:, None]

    def held(self, counts: Array) -> list[Mask]:
        """The nodes that are not empty in some data set, like the lattice's masks."""
        answers = self._answers(counts)
        best, joint = self.profile(counts)
        joint -= joint.max(axis=0)
        full = (joint > -CUT).any(axis=1)
        best -= joint + CUT  # what a node must surpass
        masks = [np.zeros(mask.shape, dtype=bool) for mask in self.lattice.masks]
        for piece in self.pieces:
            some = np.flatnonzero(full[piece.triples])
            if some.size:
                triples, bias = piece.triples[some], piece.bias[:, some]
                part = _Piece(piece.group, triples, bias, piece.table[:, :, some])
                own = (part.values(answers) > best[piece.group, triples]).any(axis=2)
                where = tuple(np.broadcast_to(a[triples], own.shape)[own] for a in self.at)
                masks[piece.group][(*where, bias[own])] = True
        return masks

    def integrated(self, counts: Array) -> Weights:
        """The likelihood of k, lapses and biases integrated."""
        answers = self._answers(counts)
        joint = np.repeat(self.log_prior[:, None], len(counts), axis=1).astype(float)
        for piece in self.pieces:
            values = piece.values(answers)
            top = values.max(axis=0)
            values -= top
            np.exp(values, out=values)
            joint[piece.triples] += np.log(values.sum(axis=0)) + top
        top = joint.max(axis=0)
        joint -= top
        starts = np.flatnonzero(np.diff(self.k_of, prepend=-1))
        total = np.add.reduceat(np.exp(joint, out=joint), starts, axis=0)
        scores = self.lattice.axes[0]
        prior = score_prior(scores)
        kept = self.k_of[starts]
        log_likelihood = np.log(np.maximum(total, 1e-300)) + top - prior[kept][:, None]
        return Weights(scores[kept], log_likelihood.T)


def _widest(model: WeberModel) -> Lattice:
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


def _refined(model: WeberModel, lattice: Lattice, held: list[Mask]) -> tuple[Lattice, bool]:
    """A finer lattice over the nodes held, and whether it is as fine as wanted."""
    # A neighbour on every side: what lies between nodes may be fuller than they are.
    wide = [binary_dilation(mask) for mask in held]
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
        wanted = max(step, gap.max() / FINER)
        new = np.linspace(low, high, max(int(np.ceil((high - low) / wanted)) + 1, 3))
        fine = fine and new[1] - new[0] <= 1.001 * step
        axes.append(new)
        nearest.append(np.abs(new[:, None] - axis).argmin(axis=1))
    masks = tuple(m[np.ix_(*nearest[:3], b)] for m, b in zip(wide, nearest[3:], strict=True))
    return Lattice(tuple(axes), masks), fine


def _lapse_weights(model: WeberModel, lattice: Lattice) -> Array:
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
