"""A grid over one observer's parameters, and the probabilities of answers at its nodes.

Axes are normal scores of the Weber fraction and of the biases, and the transformed scores of both
lapses, as in `behaviour.quadrature`. Given the rest, biases of several standards are independent: a
grid each.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..behaviour.encodings import UnitEncodings
from ..behaviour.lapses import lapse_prior, score_prior
from ..behaviour.likelihood import WeberModel

Array = NDArray[np.float64]

FAR = 4.5  # scores of the priors, beyond which next to nothing lies
LEAST = 1e-30  # of a probability
SMALL = 1e-60  # where a grid is brought back to 1


@dataclass(frozen=True)
class Axes:
    """Nodes of each parameter, one of them where it is known."""

    k: Array
    low: Array
    high: Array
    bias: tuple[Array, ...]


class Grid:
    """Likelihoods (K, B, L) of every group on its nodes; L are pairs of lapses.

    Trials are first `put` in, as many as there are; `close` makes the logarithms a grid, which
    learns from more by `multiply`.
    """

    def __init__(self, model: WeberModel, axes: Axes) -> None:
        self.model, self.axes = model, axes
        self.k = model.at("weber_fraction", axes.k)
        self.bias = [
            model.priors.value("bias", b) if b.size > 1 else np.array([model.fixed_bias()])
            for b in axes.bias
        ]
        low, high = np.meshgrid(
            model.at("lapse_low", axes.low), model.at("lapse_high", axes.high), indexing="ij"
        )
        self.low, self.high = (np.ravel(a) for a in model.lapses(low, high))
        self.slope = np.maximum(1 - self.low - self.high, 0.0)
        # Of the other answer, and of the one that is counted.
        self._ends = [np.stack([self.slope, lapse]) for lapse in (self.high, self.low)]
        self._least_ends = [np.add(e, [[0.0], [LEAST]]).astype(np.float32) for e in self._ends]
        self.lapse_moments = np.stack([np.ones_like(self.low), self.low, self.slope])
        self.lapse_ends = [s.coordinate([-FAR, FAR]) for s in model.transforms[-2:]]
        lapses = np.exp(lapse_prior(model, axes.low, axes.high)).ravel()
        self.prior = (
            np.exp(score_prior(axes.k))[:, None] * step_of(axes.k)
            * lapses * step_of(axes.low) * step_of(axes.high)
        )  # fmt: skip
        self.prior_bias = [np.exp(score_prior(b)) * step_of(b) for b in axes.bias]
        shape = axes.k.size, axes.bias[0].size, self.low.size
        self._logs: list[NDArray[np.float32]] = [
            np.zeros(shape, dtype=np.float32) for _ in axes.bias
        ]
        self.up: list[Array] = []
        self.values: list[Array] = []
        self.by_group: list[Array] = []
        self.log: list[float] = []

    def see_candidates(self) -> None:
        """Tabulate the answers to all pairs that may be put, of the next group."""
        g = len(self.up)
        self.up.append(self._sides(self.model.encodings.of(self.model.group == g), g)[0])

    def put(self, encodings: UnitEncodings, group: int, counts: list[int]) -> None:
        """Answers to a pair of stimuli, so many of each."""
        if group < len(self.values):
            for answer, times in enumerate(counts):
                for _ in range(times):
                    self.multiply(encodings, group, answer)
            return
        sides = self._sides(encodings, group)[::-1]
        for side, ends, times in zip(sides, self._least_ends, counts, strict=True):
            if times:
                chance = _with_lapses(side.astype(np.float32), ends)
                np.log(chance, out=chance)
                if times > 1:
                    chance *= times
                self._logs[group] += chance

    def close(self) -> None:
        """Exponentiate the next group."""
        log = self._logs[len(self.values)]
        self._logs[len(self.values)] = np.zeros(0, dtype=np.float32)
        self.log.append(float(log.max()))
        log -= log.max()
        self.values.append(np.exp(log, out=log).astype(float))
        self.by_group.append(self._over_bias(len(self.values) - 1))

    def multiply(self, encodings: UnitEncodings, group: int, answer: int) -> None:
        """Learn from one answer."""
        side = self._sides(encodings, group)[1 - answer]
        self.values[group] *= _with_lapses(side, self._ends[answer])
        self.by_group[group] = self._over_bias(group)
        top = float(self.by_group[group].max())
        if top < SMALL:
            self.values[group] /= top
            self.by_group[group] /= top
            self.log[group] += float(np.log(top))

    def _sides(self, encodings: UnitEncodings, group: int) -> tuple[Array, Array]:
        """Chance of the answer and of the other, without lapses, (K, B, C)."""
        task = self.model.task
        d, weight = np.broadcast_arrays(*task.decide(encodings.encoded(self.k)))
        return task.chance(d[:, None], weight[:, None] * self.bias[group][:, None])

    def _over_bias(self, group: int) -> Array:
        """One group with its bias integrated, (K, L)."""
        return np.asarray(np.matmul(self.prior_bias[group], self.values[group]))


def _with_lapses(side: Any, ends: Any) -> Any:
    """Chance of an answer (K, B, L), from that without lapses (K, B, 1): one product of matrices,
    as every pass over a grid takes its time."""
    factors = np.concatenate([side, np.ones_like(side)], axis=-1)
    return (factors.reshape(-1, 2) @ ends).reshape(*side.shape[:2], -1)


def step_of(axis: Array) -> float:
    """Distance of the nodes, 1 where there is one."""
    return float(axis[1] - axis[0]) if axis.size > 1 else 1.0
