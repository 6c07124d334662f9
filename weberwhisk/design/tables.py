"""Posteriors of thousands of experiments at once: tables of log P, and matrix products.

All data sets of one design share their stimuli, so the log-probability of every answer at every
node of a lattice is tabulated once, and the log-likelihood of all of them is counts @ table. Biases
are integrated group by group, as they are independent given the rest; then the lapses.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..behaviour.likelihood import WeberModel
from ..behaviour.quadrature import score_prior
from .nodes import (
    CLOSE,
    Indices,
    Lattice,
    Mask,
    coarseness,
    emptiness,
    lapse_weights,
    refined,
    widest,
)

Array = NDArray[np.float64]

BATCHES = 512, 512, 128  # data sets weighed on one lattice, pass by pass
BLOCK = 400_000  # values at once: what stays in the cache
ROUNDED = 4  # biases of a triple, to a multiple
LEAST = np.float32(1e-30)  # of a probability


@dataclass(frozen=True)
class Weights:
    """Likelihoods (R, K) of R data sets at even scores of k (K,), all else integrated."""

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
    start = Table(model, widest(model))
    everything = np.arange(len(counts))
    for i in range(0, len(counts), BATCHES[0]):
        yield from _zoom(model, start, counts, everything[i : i + BATCHES[0]], 1)


def _zoom(
    model: WeberModel, table: Table, counts: Array, rows: Indices, depth: int
) -> Iterator[tuple[Indices, Weights]]:
    """Some data sets on finer and finer lattices, in batches that are more and more alike."""
    animals = counts.shape[1]
    coarse = coarseness(model, table.lattice)
    answers = table.answers(counts[rows].reshape(-1, counts.shape[-1]))
    best, joint = table.profile(answers)
    place = table.k_of[joint.argmax(axis=0)].reshape(rows.size, animals)
    order = np.lexsort((place.max(axis=1), place.min(axis=1)))
    size = max(1, BATCHES[min(depth, len(BATCHES) - 1)] // animals)
    for own in (order[i : i + size] for i in range(0, order.size, size)):
        inside = (own[:, None] * animals + np.arange(animals)).ravel()
        part = [a[:, inside] for a in answers]
        held = table.held(part, best[..., inside], joint[:, inside], emptiness(coarse))
        lattice, fine = refined(model, table.lattice, held, with_neighbours=coarse > 1.5 * CLOSE)
        finer = Table(model, lattice)
        if fine:
            yield rows[own], finer.integrated(part)
        else:
            yield from _zoom(model, finer, counts, rows[own], depth + 1)


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


class Table:
    """The answers' log-probabilities on a lattice, in pieces that stay in the cache."""

    def __init__(self, model: WeberModel, lattice: Lattice) -> None:
        self.model, self.lattice = model, lattice
        triples = lattice.triples
        self.at = np.nonzero(triples)
        self.k_of = self.at[0]
        log_prior = score_prior(lattice.axes[0])[:, None, None] + lapse_weights(model, lattice)
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
        ends = model.lapses(low[self.at[1]], high[self.at[2]])
        lost = [a.astype(np.float32) for a in ends]
        step = bias[1] - bias[0] if bias.size > 1 else 1.0
        log_weight = model.log_bias_prior(bias) + np.log(step)
        used = self.lattice.masks[group][self.at]  # (T, B)
        first = used.argmax(axis=1)
        width = used.shape[1] - used[:, ::-1].argmax(axis=1) - first
        width = np.minimum(-(-width // ROUNDED) * ROUNDED, bias.size)
        for size in np.unique(width):
            some = np.flatnonzero(width == size)
            most = max(1, BLOCK // (BATCHES[-1] * int(size)))
            for own in (some[i : i + most] for i in range(0, some.size, most)):
                b = np.minimum(first[own], bias.size - size) + np.arange(size)[:, None]
                table = np.empty((2 * cells.size + 1, *b.shape), dtype=np.float32)
                yes, no = (a[:, self.k_of[own], b] for a in (up, down))
                lo, hi = (a[own] for a in lost)
                np.log(np.maximum(lo * no + (1 - hi) * yes, LEAST), out=table[: cells.size])
                np.log(np.maximum((1 - lo) * no + hi * yes, LEAST), out=table[cells.size : -1])
                table[-1] = log_weight[b]
                yield _Piece(group, own, b, table)

    def answers(self, counts: Array) -> list[NDArray[np.float32]]:
        """What meets the tables, (2C + 1, R) for each group."""
        n = self.model.cells.n
        ones = np.ones((len(counts), 1))
        return [
            np.hstack([counts[:, c], n[c] - counts[:, c], ones]).T.astype(np.float32, order="C")
            for c in self.groups
        ]

    def profile(
        self, answers: list[NDArray[np.float32]]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Each group at its best bias, (G, T, R), and all with the prior, (T, R)."""
        shape = len(self.groups), self.k_of.size, answers[0].shape[1]
        best = np.empty(shape, dtype=np.float32)
        for piece in self.pieces:
            best[piece.group, piece.triples] = piece.values(answers).max(axis=0)
        return best, best.sum(axis=0) + self.log_prior[:, None]

    def held(
        self,
        answers: list[NDArray[np.float32]],
        best: NDArray[np.float32],
        joint: NDArray[np.float32],
        cut: float,
    ) -> list[Mask]:
        """Nodes within `cut` of the best in some data set, like the lattice's masks."""
        joint = joint - joint.max(axis=0)
        full = np.any(joint > -cut, axis=1)
        least = best - (joint + cut)  # what a node must surpass
        masks = [np.zeros(mask.shape, dtype=bool) for mask in self.lattice.masks]
        for piece in self.pieces:
            some = np.flatnonzero(full[piece.triples])
            if some.size:
                triples, bias = piece.triples[some], piece.bias[:, some]
                part = _Piece(piece.group, triples, bias, piece.table[:, :, some])
                own = (part.values(answers) > least[piece.group, triples]).any(axis=2)
                where = tuple(np.broadcast_to(a[triples], own.shape)[own] for a in self.at)
                masks[piece.group][(*where, bias[own])] = True
        return masks

    def integrated(self, answers: list[NDArray[np.float32]]) -> Weights:
        """The likelihood of k, lapses and biases integrated."""
        count = answers[0].shape[1]
        joint = np.repeat(self.log_prior[:, None], count, axis=1).astype(float)
        for piece in self.pieces:
            values = piece.values(answers)
            top = values.max(axis=0)
            values -= top
            np.exp(values, out=values)
            joint[piece.triples] += np.log(values.sum(axis=0)) + top
        top = joint.max(axis=0)
        joint -= top
        starts = np.flatnonzero(np.diff(self.k_of, prepend=-1))
        kept = self.k_of[starts]
        scores = self.lattice.axes[0]
        total = np.zeros((scores.size, count))
        total[kept] = np.add.reduceat(np.exp(joint, out=joint), starts, axis=0)
        log_mass = np.log(np.maximum(total, 1e-300)) + top
        return Weights(scores, (log_mass - score_prior(scores)[:, None]).T)


def log_sum(values: Array, axis: int) -> Array:
    """ln Σ exp of finite values; SciPy's costs several times as much."""
    top = values.max(axis=axis, keepdims=True)
    return np.log(np.exp(values - top).sum(axis=axis)) + np.squeeze(top, axis)
