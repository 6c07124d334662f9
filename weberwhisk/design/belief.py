"""What is believed of one observer while trials come in: a grid that follows the posterior.

A trial multiplies the grid by the probability of its answer. Where the axes have become too wide or
too short for what is left, another grid is laid and the trials so far put in again, some of them
with every trial that comes, so that none has long to wait; until it is done the old grid serves.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline
from scipy.special import entr

from ..behaviour.axes import lapse_prior, lapse_transform, score_prior
from ..behaviour.encodings import UnitEncodings
from ..behaviour.likelihood import WeberModel
from ..behaviour.priors import TINY
from ..behaviour.trials import Cells
from .hypotheses import Hypothesis

Array = NDArray[np.float64]
Pair = tuple[float, float, float]  # stimulus 1, stimulus 2, standard

FAR = 4.5  # scores of the priors, beyond which next to nothing lies


@dataclass(frozen=True)
class Axes:
    """Nodes of each parameter, one of them where it is known."""

    k: Array
    low: Array
    high: Array
    bias: tuple[Array, ...]


def wide_ends(model: WeberModel, far: float) -> list[tuple[float, float]]:
    """Ends of k, either lapse and every bias, so many scores of their priors away."""
    lapses = [tuple(t.coordinate([-far, far]).tolist()) for t in model.transforms[-2:]]
    return [(-far, far), *lapses, *[(-far, far)] * model.n_groups]


def even_axes(
    model: WeberModel, ends: Sequence[tuple[float, float]], sizes: tuple[int, int, int]
) -> Axes:
    """Even nodes of k, either lapse and every bias between these ends, one where it is known."""
    counts = [sizes[0], sizes[1], sizes[1], *[sizes[2]] * model.n_groups]
    free = [model.free[0], *model.free[-2:], *[model.free_bias] * model.n_groups]
    k, low, high, *biases = (
        np.linspace(*end, count) if own else np.zeros(1)
        for end, count, own in zip(ends, counts, free, strict=True)
    )
    return Axes(k, low, high, tuple(biases))


class BeliefGrid:
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
        self._least_ends = [np.add(e, [[0.0], [1e-30]]).astype(np.float32) for e in self._ends]
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

    def put(self, encodings: UnitEncodings, group: int, counts: Sequence[float]) -> None:
        """Answers to a pair of stimuli, so many of each; in a grid that is open, any number."""
        if group < len(self.values):
            for answer, times in enumerate(counts):
                for _ in range(int(times)):
                    self.multiply(encodings, group, answer)
            return
        sides = self._sides(encodings, group)[::-1]
        for side, ends, times in zip(sides, self._least_ends, counts, strict=True):
            if times:
                chance = _with_lapses(side.astype(np.float32), ends)
                np.log(chance, out=chance)
                if times != 1:
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


def step_of(axis: Array) -> float:
    """Distance of the nodes, 1 where there is one."""
    return float(axis[1] - axis[0]) if axis.size > 1 else 1.0


HELD = 1e-4  # of the highest marginal density: below, a node is empty
LEAST_TOLD = 8  # trials that the coordinates of the lapses are made for at first


class Belief:
    """The posterior of one hypothesis on a grid that has all answers so far.

    `candidates` are the pairs of stimuli that may be put; what is put may differ.
    """

    def __init__(self, hypothesis: Hypothesis, candidates: Cells, grid: BeliefGrid) -> None:
        self.hypothesis, self._candidates, self._grid = hypothesis, candidates, grid
        self._sum()

    @property
    def axes(self) -> Axes:
        """Of the grid as it is."""
        return self._grid.axes

    @property
    def k(self) -> Array:
        """Weber fractions of its nodes, whose masses are `mass_k`."""
        return self._grid.k

    def _sum(self) -> None:
        """Integrate everything."""
        by_group = self._grid.by_group
        others = []
        for g in range(len(by_group)):
            rest = self._grid.prior.copy()
            for h, other in enumerate(by_group):
                if h != g:
                    rest *= other
            others.append(rest)
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
            return np.full(np.shape(probability), self._grid.k[0])
        fine = np.linspace(z[0], z[-1], 40 * z.size)
        log_mass = np.maximum(np.log(np.maximum(self.mass_k, TINY)), -200.0)
        density = np.exp(CubicSpline(z, log_mass - log_mass.max())(fine))
        below = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]))])
        at = np.interp(probability, below / below[-1], fine)
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
            joint = (
                self._grid.values[g] * self._grid.prior_bias[g][:, None] * self._others[g][:, None]
            )
            below = np.cumsum(joint)
            steps = (np.arange(drawn) + 0.5) / drawn * below[-1]
            k, b, lapse = np.unravel_index(np.searchsorted(below, steps), joint.shape)
            p = self._grid.low[lapse, None] + self._grid.slope[lapse, None] * up[k, b]
            out[self._grid.model.group == g] = entropy(p).mean(axis=0)
        return out


class GrowingBelief(Belief):
    """The same, trial by trial."""

    def __init__(self, hypothesis: Hypothesis, candidates: Cells) -> None:
        self.hypothesis = hypothesis
        model = _told(hypothesis.model(candidates), LEAST_TOLD)
        self._seen: dict[Pair, list[int]] = {}
        pairs = zip(candidates.stimulus_1, candidates.stimulus_2, candidates.standard, strict=True)
        self._encoded: dict[Pair, UnitEncodings] = {
            (float(s1), float(s2), float(s)): model.encodings.of(np.array([i]))
            for i, (s1, s2, s) in enumerate(pairs)
        }
        self._standards = np.unique(candidates.standard)
        for name, free in zip(model.lead[-2:], model.free[-2:], strict=True):
            for doublings in range(3, 13 * free):  # their coordinates, made now and kept
                lapse_transform(model.priors.of(name), 2.0**doublings)
        self._building: Iterator[BeliefGrid | None] | None = None
        *_, grid = self._laid(model, even_axes(model, wide_ends(model, FAR), (21, 14, 21)))
        assert grid is not None
        super().__init__(hypothesis, candidates, grid)

    def _laid(self, model: WeberModel, axes: Axes, pairs: int = 3) -> Iterator[BeliefGrid | None]:
        """A grid on these axes with all trials so far in it, after some rests, in each of which the
        answers to so many pairs of stimuli are put in."""
        grid = BeliefGrid(model, axes)
        for _ in axes.bias:
            grid.see_candidates()
            yield None
        inside: dict[Pair, list[int]] = {}
        closed = 0
        while True:
            left = [p for p, seen in self._seen.items() if inside.get(p) != seen]
            for pair in left[:pairs]:
                before, seen = inside.get(pair, [0, 0]), self._seen[pair]
                new = [n - b for n, b in zip(seen, before, strict=True)]
                grid.put(self.encode(pair), self._group(pair), new)
                inside[pair] = list(seen)
            if len(left) <= pairs // 2:
                if closed == len(axes.bias):
                    break
                grid.close()
                closed += 1
            yield None
        yield grid

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
        self._seen.setdefault(pair, [0, 0])[answer] += 1
        self._grid.multiply(self.encode(pair), self._group(pair), answer)
        if self._building is not None:
            grid = next(self._building)
            if grid is not None:
                self._grid, self._building = grid, None
        self._sum()
        if self._building is None:
            axes = self._better_axes()
            if axes is not None:
                self._building = self._laid(*axes)

    def _better_axes(self) -> tuple[WeberModel, Axes] | None:
        """Axes that fit what is left, and coordinates; None where those there do."""
        axes = self.axes
        sheet = self._joint.sum(axis=0).reshape(axes.low.size, axes.high.size)
        far = np.array([-FAR, FAR])
        kept: list[tuple[Array, Array, Array]] = [
            (axes.k, self.mass_k, far),
            (axes.low, sheet.sum(axis=1), self._grid.lapse_ends[0]),
            (axes.high, sheet.sum(axis=0), self._grid.lapse_ends[1]),
            *((b, m[..., 0].sum(axis=0), far)
              for b, m in zip(axes.bias, self._moments, strict=True)),
        ]  # fmt: skip
        if all(_serves(*one) for one in kept):
            return None
        k, low, high, *bias = (_better(*one) for one in kept)
        # The coordinate of a lapse goes with how many trials tell of it.
        before = self._grid.model.transforms[-2:]
        trials = sum(map(sum, self._seen.values()))
        model = _told(self._grid.model, max(trials, LEAST_TOLD))
        low, high = (
            _even(new.coordinate(was.score(axis[[0, -1]])), axis.size)
            for axis, was, new in zip((low, high), before, model.transforms[-2:], strict=True)
        )
        return model, Axes(k, low, high, tuple(bias))


def entropy(p: Array) -> Array:
    """Entropy of a yes-or-no answer, nats."""
    return np.asarray(entr(p) + entr(1 - p))


def _serves(axis: Array, mass: Array, ends: Array, share: float = 0.6) -> bool:
    """Whether an axis is fine and long enough for the mass on it."""
    fine = bool(np.count_nonzero(mass > HELD * mass.max()) > share * axis.size)
    return axis.size == 1 or (fine and not any(_short(axis, mass, ends)))


def _short(axis: Array, mass: Array, ends: Array, least: float = 1e-3) -> list[bool]:
    """Whether mass, so much of the highest, hangs over either end, where the parameter goes on."""
    top = mass.max()
    return [
        bool(mass[edge] > least * top and abs(axis[edge] - end) > 1e-9)
        for edge, end in zip((0, -1), ends, strict=True)
    ]


def _better(axis: Array, mass: Array, ends: Array) -> Array:
    """As many nodes over what holds the mass, and some more where it may go on."""
    if axis.size == 1:
        return axis
    step = axis[1] - axis[0]
    held = axis[np.flatnonzero(mass > HELD * mass.max())[[0, -1]]]
    low, high = held[0] - step, held[1] + step
    below, above = _short(axis, mass, ends)
    reach = 0.3 * (high - low)
    low, high = max(low - reach * below, ends[0]), min(high + reach * above, ends[1])
    return _even((low, high), axis.size)


def _even(ends: ArrayLike, size: int) -> Array:
    low, high = np.asarray(ends, dtype=float)
    return np.linspace(low, high, size)


def _told(model: WeberModel, trials: float) -> WeberModel:
    """The model with the lapses' coordinates for so many trials."""
    c = model.cells
    return replace(model, cells=replace(c, n=np.full(c.n.size, trials / max(c.n.size, 1))))
