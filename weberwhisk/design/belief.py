"""What is believed of one observer while trials come in, and what one more would tell.

That is the mutual information, in bits, of its answer and the Weber fraction, or which hypothesis
is right (Lindley 1956, Ann. Math. Stat. 27:986), everything else integrated out: a lapse or a bias
that must be learnt as well costs information.

A trial multiplies the grid by the probability of its answer. Where the axes have become too wide or
too short for what is left, another grid is laid and the trials so far put in again.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.special import entr

from .._util.values import Array, density_quantiles
from ..behaviour.axes import bias_at, bias_prior, lapse_prior, score_prior
from ..behaviour.encodings import UnitEncodings
from ..behaviour.likelihood import WeberModel
from ..behaviour.priors import TINY
from ..behaviour.trials import Cells
from .hypotheses import Hypothesis

__all__ = ["Belief", "Pair", "entropy"]

Pair = tuple[float, float, float]  # stimulus 1, stimulus 2, standard

FAR = 4.5  # scores of the priors, beyond which next to nothing lies


@dataclass(frozen=True)
class Axes:
    """Nodes of each parameter, one of them where it is known."""

    k: Array
    low: Array
    high: Array
    bias: tuple[Array, ...]

    @classmethod
    def whole(cls, model: WeberModel) -> Axes:
        """Even nodes of k, either lapse and every bias over all of their priors."""
        far = -FAR, FAR
        lapses = [tuple(t.coordinate(far).tolist()) for t in model.transforms[-2:]]
        of_bias = tuple(model.bias_transform.coordinate(far).tolist())
        ends: list[Any] = [far, *lapses, *[of_bias] * model.n_groups]
        # So many leave quantiles within 0.02 posterior sd of the fit's
        # (`tests/benchmarks/bench_adaptive.py`).
        counts = [21, 14, 14, *[21] * model.n_groups]
        free = [model.free[0], *model.free[-2:], *[model.free_bias] * model.n_groups]
        k, low, high, *biases = (
            np.linspace(end[0], end[1], count) if is_free else np.zeros(1)
            for end, count, is_free in zip(ends, counts, free, strict=True)
        )
        return cls(k, low, high, tuple(biases))


class BeliefGrid:
    """Likelihoods (K, B, L) of every group on its nodes; L are pairs of lapses.

    Trials are first `put` in, any number at once; `close` makes the logarithms a grid, which learns
    from more by `multiply`.
    """

    def __init__(self, model: WeberModel, axes: Axes) -> None:
        self.model, self.axes = model, axes
        self.k = model.at("weber_fraction", axes.k)
        self.bias = [bias_at(model, b) for b in axes.bias]
        lapses = model.at("lapse_low", axes.low), model.at("lapse_high", axes.high)
        low, high = model.lapses(*np.meshgrid(*lapses, indexing="ij"))
        self.low, high = low.ravel(), high.ravel()
        self.slope = np.maximum(1 - self.low - high, 0.0)
        # Of the other answer, and of the one that is counted.
        self._ends = [np.stack([self.slope, lapse]) for lapse in (high, self.low)]
        self._least_ends = [np.add(e, [[0.0], [1e-30]]).astype(np.float32) for e in self._ends]
        self.lapse_moments = np.stack([np.ones_like(self.low), self.low, self.slope])
        self.lapse_ends = [s.coordinate([-FAR, FAR]) for s in model.transforms[-2:]]
        all_axes = axes.k, axes.low, axes.high, *axes.bias
        steps = [float(a[1] - a[0]) if a.size > 1 else 1.0 for a in all_axes]
        of_lapses = np.exp(lapse_prior(model, axes.low, axes.high)).ravel()
        self.prior = np.exp(score_prior(axes.k))[:, None] * of_lapses * np.prod(steps[:3])
        of_biases = zip(axes.bias, steps[3:], strict=True)
        self.prior_bias = [np.exp(bias_prior(model, b)) * step for b, step in of_biases]
        self.bias_ends = model.bias_transform.coordinate([-FAR, FAR])
        shape = axes.k.size, axes.bias[0].size, self.low.size
        self._logs = [np.zeros(shape, dtype=np.float32) for _ in axes.bias]

    def put(self, encodings: UnitEncodings, group: int, counts: Sequence[float]) -> None:
        """Answers to a pair of stimuli, so many of each."""
        sides = self._sides(encodings, group)[::-1]
        for side, ends, times in zip(sides, self._least_ends, counts, strict=True):
            if times:
                chance = _with_lapses(side.astype(np.float32), ends)
                np.log(chance, out=chance)
                self._logs[group] += chance if times == 1 else chance * np.float32(times)

    def close(self) -> None:
        """From logarithms to likelihoods; and the answers to all pairs that may be put."""
        of_group = [self.model.encodings.of(self.model.group == g) for g in range(len(self._logs))]
        self.up = [self._sides(encodings, g)[0] for g, encodings in enumerate(of_group)]
        self.log = [float(log.max()) for log in self._logs]
        self.values = [
            np.exp(log - top).astype(float) for log, top in zip(self._logs, self.log, strict=True)
        ]
        self.by_group = [self._over_bias(g) for g in range(len(self.values))]

    def multiply(self, encodings: UnitEncodings, group: int, answer: int) -> None:
        """Learn from one answer."""
        side = self._sides(encodings, group)[1 - answer]
        self.values[group] *= _with_lapses(side, self._ends[answer])
        self.by_group[group] = self._over_bias(group)
        top = float(self.by_group[group].max())
        if top < 1e-60:  # brought back to 1
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


class Belief:
    """The posterior of one hypothesis, trial by trial.

    `candidates` are the pairs of stimuli that may be put; what is put may differ. `mass_k` are the
    masses of the Weber fractions `k`.
    """

    def __init__(self, hypothesis: Hypothesis, candidates: Cells) -> None:
        self.hypothesis, self._candidates = hypothesis, candidates
        # The coordinates of the lapses are made for 8 trials; with 100 errors are the same.
        eight_trials = np.full(candidates.n.size, 8 / candidates.n.size)
        model = hypothesis.model(replace(candidates, n=eight_trials))
        self._seen: dict[Pair, list[float]] = {}
        self._encoded: dict[Pair, UnitEncodings] = {
            pair: model.encodings.of(np.array([i])) for i, pair in enumerate(_pairs(candidates))
        }
        self._standards = np.unique(candidates.standard)
        self._model = model
        self._lay(Axes.whole(model))

    def _lay(self, axes: Axes) -> None:
        """A grid on these axes, with all trials so far in it."""
        self._grid = BeliefGrid(self._model, axes)
        for pair, seen in self._seen.items():
            self._grid.put(self.encode(pair), self._group(pair), seen)
        self._grid.close()
        self._sum()

    def _sum(self) -> None:
        """Integrate everything."""
        self.axes, self.k = self._grid.axes, self._grid.k
        by_group = self._grid.by_group
        others = [
            math.prod((o for h, o in enumerate(by_group) if h != g), start=self._grid.prior)
            for g in range(len(by_group))
        ]
        joint = others[0] * by_group[0]
        total = joint.sum()
        self.log_evidence = float(np.log(total)) + sum(self._grid.log)
        self._joint = joint / total
        self._others = [rest / total for rest in others]
        self.mass_k = self._joint.sum(axis=1)
        self._moments = [self._weigh(g) for g in range(len(others))]

    def _weigh(self, group: int) -> Array:
        """Mass of every (k, bias), and its mean lower lapse and slope times that, (K, B, 3)."""
        weighed = self._others[group][:, None] * self._grid.lapse_moments  # (K, 3, L)
        moments = np.matmul(self._grid.values[group], np.swapaxes(weighed, 1, 2))
        return np.asarray(moments * self._grid.prior_bias[group][:, None])

    def quantile(self, probability: float | Array) -> Array:
        """Posterior quantiles of the Weber fraction."""
        z = self.axes.k
        if z.size == 1:
            return np.full(np.shape(probability), self.k[0])
        fine = np.linspace(z[0], z[-1], 40 * z.size)
        log_mass = np.maximum(np.log(np.maximum(self.mass_k, TINY)), -200.0)
        density = np.exp(CubicSpline(z, log_mass - log_mass.max())(fine))
        at = density_quantiles(fine, density, probability)
        return self._grid.model.value("weber_fraction", at)

    def predicted(self) -> tuple[Array, Array]:
        """Chance of the answer to every candidate given k, (K, C), and whatever k is, (C,)."""
        given_k = np.empty((self.axes.k.size, self._candidates.n.size))
        mass = np.maximum(self.mass_k, TINY)
        for g, (moments, up) in enumerate(zip(self._moments, self._grid.up, strict=True)):
            low, slope = moments[..., 1].sum(axis=1), moments[..., 2]
            rise = np.einsum("kb,kbc->kc", slope, up)
            given_k[:, self._grid.model.group == g] = (low[:, None] + rise) / mass[:, None]
        given_k = np.clip(given_k, 0.0, 1.0)
        return given_k, self.mass_k @ given_k

    def entropy_of_all(self, drawn: int = 2000) -> Array:
        """Mean entropy of the answer were all parameters known, (C,), nats.

        Over so many nodes at even steps of the cumulative mass: without bias.
        """
        out = np.empty(self._candidates.n.size)
        for g, up in enumerate(self._grid.up):
            grid = self._grid
            joint = grid.values[g] * grid.prior_bias[g][:, None] * self._others[g][:, None]
            below = np.cumsum(joint)
            steps = (np.arange(drawn) + 0.5) / drawn * below[-1]
            k, b, lapse = np.unravel_index(np.searchsorted(below, steps), joint.shape)
            p = grid.low[lapse, None] + grid.slope[lapse, None] * up[k, b]
            out[grid.model.group == g] = entropy(p).mean(axis=0)
        return out

    def _group(self, pair: Pair) -> int:
        if self.hypothesis.bias != "per standard":
            return 0
        return int(np.searchsorted(self._standards, pair[2]))

    def encode(self, pair: Pair) -> UnitEncodings:
        """Both encoded stimuli of a trial; refuses what cannot be encoded."""
        if pair not in self._encoded:
            cell = Cells(*(np.array([v]) for v in (*pair, 1.0, 0.0)))
            self._encoded[pair] = self.hypothesis.model(cell).encodings
        return self._encoded[pair]

    def absorb(self, pair: Pair, answer: int) -> None:
        """Learn from one trial."""
        self._seen.setdefault(pair, [0.0, 0.0])[answer] += 1
        self._grid.multiply(self.encode(pair), self._group(pair), answer)
        self._sum()
        if (better := self._better_axes()) is not None:
            self._lay(better)

    def _better_axes(self) -> Axes | None:
        """Axes that fit what is left; None where those there do."""
        axes = self.axes
        sheet = self._joint.sum(axis=0).reshape(axes.low.size, axes.high.size)
        far = np.array([-FAR, FAR])
        refitted = [_fitted(*one) for one in [
            (axes.k, self.mass_k, far),
            (axes.low, sheet.sum(axis=1), self._grid.lapse_ends[0]),
            (axes.high, sheet.sum(axis=0), self._grid.lapse_ends[1]),
            *((b, m[..., 0].sum(axis=0), self._grid.bias_ends)
              for b, m in zip(axes.bias, self._moments, strict=True)),
        ]]  # fmt: skip
        if all(serves for serves, _ in refitted):
            return None
        k, low, high, *bias = (better for _, better in refitted)
        return Axes(k, low, high, tuple(bias))


def _pairs(cells: Cells) -> list[Pair]:
    shown = cells.stimulus_1, cells.stimulus_2, cells.standard
    return [(float(s1), float(s2), float(s)) for s1, s2, s in zip(*shown, strict=True)]


def entropy(p: Array) -> Array:
    """Entropy of a yes-or-no answer, nats."""
    return np.asarray(entr(p) + entr(1 - p))


def _fitted(
    axis: Array, mass: Array, ends: Array, share: float = 0.6, least: float = 1e-3
) -> tuple[bool, Array]:
    """Whether an axis is fine and long enough for the mass on it; and as many nodes over what has
    the mass, and some more where there is `least` of the highest at an end and it may go on."""
    if axis.size == 1:
        return True, axis
    filled, edges = np.flatnonzero(mass > 1e-4 * mass.max()), axis[[0, -1]]
    short = (mass[[0, -1]] > least * mass.max()) & (np.abs(edges - ends) > 1e-9)
    step = axis[1] - axis[0]
    low, high = axis[filled[0]] - step, axis[filled[-1]] + step
    reach = 0.3 * (high - low) * short
    low, high = max(low - reach[0], ends[0]), min(high + reach[1], ends[1])
    serves = filled.size > share * axis.size and not short.any()
    return serves, np.linspace(low, high, axis.size)
