"""What is believed of one observer while trials come in: a grid that follows the posterior.

Axes are normal scores of the Weber fraction and of the biases, and the stretched scores of both
lapses, as in `behaviour.quadrature`. A trial multiplies the grid by the probability of its answer;
where the axes have become too wide or too short for what is left, they are laid anew and the trials
so far put in again. Given the rest, biases of several standards are independent: a grid each.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline
from scipy.special import entr

from ..behaviour.likelihood import WeberModel
from ..behaviour.percepts import UnitPercepts
from ..behaviour.priors import TINY
from ..behaviour.quadrature import lapse_prior, score_prior
from ..behaviour.trials import Cells
from .hypotheses import Hypothesis

Array = NDArray[np.float64]
Pair = tuple[float, float, float]  # stimulus 1, stimulus 2, standard

NODES = {"weber_fraction": 21, "bias": 21, "lapse_low": 14, "lapse_high": 14}
FAR = 4.5  # scores of the priors, beyond which next to nothing lies
HELD = 1e-4  # of the highest marginal density: below, a node is empty
EDGE = 1e-3  # of the highest marginal density: above, an axis is too short
FEW = 0.6
SMALL = 1e-60  # where a grid is brought back to 1
LEAST_TOLD = 8  # trials that the coordinates of the lapses are made for at first
DRAWN = 2000  # nodes over which the entropy of all parameters is averaged


@dataclass(frozen=True)
class Axes:
    """Nodes of each parameter, one of them where it is known."""

    k: Array
    low: Array
    high: Array
    bias: tuple[Array, ...]


class Belief:
    """The posterior of one hypothesis, trial by trial.

    Parameters
    ----------
    hypothesis : Hypothesis
    candidates : Cells
        The pairs of stimuli that may be put; what is put may differ.
    """

    def __init__(self, hypothesis: Hypothesis, candidates: Cells) -> None:
        self.hypothesis = hypothesis
        self._candidates = candidates
        self._model = _told(hypothesis.model(candidates), LEAST_TOLD)
        self._seen: dict[Pair, list[int]] = {}
        self._felt: dict[Pair, UnitPercepts] = {}
        self._standards = np.unique(candidates.standard)
        model = self._model
        free = dict(zip(model.lead, model.free, strict=True)) | {"bias": model.free_bias}
        wide = {n: (-FAR, FAR, size) if free[n] else (0.0, 0.0, 1) for n, size in NODES.items()}
        low, high = (
            _even(stretch.coordinate(wide[name][:2]), wide[name][2])
            for name, stretch in zip(model.lead[-2:], model.stretches[-2:], strict=True)
        )
        k, bias = (_even(wide[name][:2], wide[name][2]) for name in ("weber_fraction", "bias"))
        self._lay(Axes(k, low, high, (bias,) * model.n_groups))

    # -- the grid --------------------------------------------------------------------------------

    def _lay(self, axes: Axes) -> None:
        """Begin a grid on these axes and put in all trials so far."""
        model = self._model
        self.axes = axes
        self._k = model.at("weber_fraction", axes.k)
        self._bias = [
            model.priors.value("bias", b) if b.size > 1 else np.array([model.fixed_bias()])
            for b in axes.bias
        ]
        low, high = np.meshgrid(
            model.at("lapse_low", axes.low), model.at("lapse_high", axes.high), indexing="ij"
        )
        self._low, self._high = (np.ravel(a) for a in model.lapses(low, high))
        self._slope = np.maximum(1 - self._low - self._high, 0.0)
        self._lapse_moments = np.stack([np.ones_like(self._low), self._low, self._slope])
        self._prior_k = np.exp(score_prior(axes.k)) * _step(axes.k)
        self._lapse_ends = [s.coordinate([-FAR, FAR]) for s in model.stretches[-2:]]
        lapses = np.exp(lapse_prior(model, axes.low, axes.high)).ravel()
        self._prior_lapses = lapses * _step(axes.low) * _step(axes.high)
        self._prior_bias = [np.exp(score_prior(b)) * _step(b) for b in axes.bias]
        self._up = [
            self._sides(model.percepts.of(model.group == g), g)[0] for g in range(model.n_groups)
        ]
        shape = axes.k.size, axes.bias[0].size, self._low.size
        self._grid = [np.zeros(shape) for _ in axes.bias]
        for pair, counts in self._seen.items():
            g = self._group(pair)
            for answer, times in enumerate(counts):
                if times:
                    chance = self._chance(pair, answer)
                    np.log(np.maximum(chance, TINY, out=chance), out=chance)
                    self._grid[g] += chance if times == 1 else times * chance
        self._log = [float(log.max()) for log in self._grid]
        self._grid = [np.exp(log - log.max()) for log in self._grid]
        self._by_group = [self._over_bias(g) for g in range(len(self._grid))]
        self._sum()

    def _sides(self, percepts: UnitPercepts, group: int) -> tuple[Array, Array]:
        """Chance of the answer and of the other, without lapses, (K, B, C)."""
        task = self._model.task
        d, weight = np.broadcast_arrays(*task.decide(percepts.felt(self._k)))
        return task.chance(d[:, None], weight[:, None] * self._bias[group][:, None])

    def _group(self, pair: Pair) -> int:
        if self.hypothesis.bias != "per standard":
            return 0
        return int(np.searchsorted(self._standards, pair[2]))

    def feel(self, pair: Pair) -> UnitPercepts:
        """Both percepts of a trial; refuses what cannot be felt."""
        if pair not in self._felt:
            cell = Cells(*(np.array([v]) for v in (*pair, 1.0, 0.0)))
            self._felt[pair] = self.hypothesis.model(cell).percepts
        return self._felt[pair]

    def _chance(self, pair: Pair, answer: int) -> Array:
        """Probability of one answer at every node, (K, B, L)."""
        up, down = self._sides(self.feel(pair), self._group(pair))
        side, lapse = (up, self._low) if answer else (down, self._high)
        chance = side * self._slope
        chance += lapse
        return chance

    def absorb(self, pair: Pair, answer: int) -> None:
        """Learn from one trial."""
        self._seen.setdefault(pair, [0, 0])[answer] += 1
        g = self._group(pair)
        self._grid[g] *= self._chance(pair, answer)
        self._by_group[g] = self._over_bias(g)
        top = float(self._by_group[g].max())
        if top < SMALL:
            self._grid[g] /= top
            self._by_group[g] /= top
            self._log[g] += float(np.log(top))
        self._sum()
        axes = self._better_axes()
        if axes is not None:
            self._lay(axes)

    def _over_bias(self, group: int) -> Array:
        """The grid of one group with its bias integrated, (K, L)."""
        return np.asarray(np.matmul(self._prior_bias[group], self._grid[group]))

    def _sum(self) -> None:
        """Integrate everything."""
        prior = self._prior_k[:, None] * self._prior_lapses
        others = []
        for g in range(len(self._by_group)):
            rest = prior.copy()
            for h, other in enumerate(self._by_group):
                if h != g:
                    rest *= other
            others.append(rest)
        joint = others[0] * self._by_group[0]
        total = joint.sum()
        self.log_evidence = float(np.log(total)) + sum(self._log)
        self._joint = joint / total
        self._others = [rest / total for rest in others]
        self.mass_k = self._joint.sum(axis=1)
        self._moments = [self._weigh(g) for g in range(len(others))]

    def _weigh(self, group: int) -> Array:
        """Mass of every (k, bias), and its mean lower lapse and slope times that, (K, B, 3)."""
        weighed = self._others[group][:, None] * self._lapse_moments  # (K, 3, L)
        moments = np.matmul(self._grid[group], np.swapaxes(weighed, 1, 2))
        return np.asarray(moments * self._prior_bias[group][:, None])

    def _better_axes(self) -> Axes | None:
        """Axes that fit what is left; None where those there do."""
        axes = self.axes
        sheet = self._joint.sum(axis=0).reshape(axes.low.size, axes.high.size)
        far = np.array([-FAR, FAR])
        kept: list[tuple[Array, Array, Array]] = [
            (axes.k, self.mass_k, far),
            (axes.low, sheet.sum(axis=1), self._lapse_ends[0]),
            (axes.high, sheet.sum(axis=0), self._lapse_ends[1]),
            *((b, m[..., 0].sum(axis=0), far)
              for b, m in zip(axes.bias, self._moments, strict=True)),
        ]  # fmt: skip
        if all(_serves(*one) for one in kept):
            return None
        k, low, high, *bias = (_better(*one) for one in kept)
        # The coordinate of a lapse goes with how many trials tell of it.
        before = self._model.stretches[-2:]
        trials = sum(map(sum, self._seen.values()))
        self._model = _told(self._model, max(trials, LEAST_TOLD))
        low, high = (
            _even(new.coordinate(was.score(axis[[0, -1]])), axis.size)
            for axis, was, new in zip((low, high), before, self._model.stretches[-2:], strict=True)
        )
        return Axes(k, low, high, tuple(bias))

    # -- what it says ----------------------------------------------------------------------------

    def quantile(self, probability: float | Array) -> Array:
        """Posterior quantiles of the Weber fraction."""
        z = self.axes.k
        if z.size == 1:
            return np.full(np.shape(probability), self._k[0])
        fine = np.linspace(z[0], z[-1], 40 * z.size)
        log_mass = np.maximum(np.log(np.maximum(self.mass_k, TINY)), -200.0)
        density = np.exp(CubicSpline(z, log_mass - log_mass.max())(fine))
        below = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]))])
        at = np.interp(probability, below / below[-1], fine)
        return self._model.value("weber_fraction", at)

    def predicted(self) -> tuple[Array, Array]:
        """Chance of the answer to every candidate given k, (K, C), and whatever k is, (C,)."""
        given_k = np.empty((self.axes.k.size, self._candidates.n.size))
        mass = np.maximum(self.mass_k, TINY)
        for g, (moments, up) in enumerate(zip(self._moments, self._up, strict=True)):
            low, slope = moments[..., 1].sum(axis=1), moments[..., 2]
            rise = np.einsum("kb,kbc->kc", slope, up)
            given_k[:, self._model.group == g] = (low[:, None] + rise) / mass[:, None]
        given_k = np.clip(given_k, 0.0, 1.0)
        return given_k, self.mass_k @ given_k

    def entropy_of_all(self) -> Array:
        """Mean entropy of the answer were all parameters known, (C,), nats.

        Over nodes at even steps of the cumulative mass: few, and without bias.
        """
        out = np.empty(self._candidates.n.size)
        for g, up in enumerate(self._up):
            joint = self._grid[g] * self._prior_bias[g][:, None] * self._others[g][:, None]
            below = np.cumsum(joint)
            steps = (np.arange(DRAWN) + 0.5) / DRAWN * below[-1]
            k, b, lapse = np.unravel_index(np.searchsorted(below, steps), joint.shape)
            p = self._low[lapse, None] + self._slope[lapse, None] * up[k, b]
            out[self._model.group == g] = entropy(p).mean(axis=0)
        return out


def entropy(p: Array) -> Array:
    """Entropy of a yes-or-no answer, nats."""
    return np.asarray(entr(p) + entr(1 - p))


def _step(axis: Array) -> float:
    return float(axis[1] - axis[0]) if axis.size > 1 else 1.0


def _serves(axis: Array, mass: Array, ends: Array) -> bool:
    """Whether an axis is fine and long enough for the mass on it."""
    if axis.size == 1:
        return True
    top = mass.max()
    return not any(_short(axis, mass, ends)) and bool(
        np.count_nonzero(mass > HELD * top) > FEW * axis.size
    )


def _short(axis: Array, mass: Array, ends: Array) -> list[bool]:
    """Whether mass hangs over either end, where the parameter goes on."""
    top = mass.max()
    return [
        bool(mass[edge] > EDGE * top and abs(axis[edge] - end) > 1e-9)
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
