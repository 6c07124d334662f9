"""The axes of the integrator, and where posteriors lie on them.

The outer coordinates are the normal scores of k and of any effects; given these, every data set has
a window in each lapse and in the score of every group's bias. All start as wide as the prior. A
pass takes the posterior to a power below 1, under which the narrowest peak is as wide as the steps,
so that none can lie between two nodes; what is far below the best node is dropped, and the next
pass has a higher power and finer steps.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import product

import numpy as np
from numpy.typing import NDArray

from .._util.values import Array
from ..domain import FITTED_WEBER_FRACTIONS
from .likelihood import WeberModel
from .priors import REACH, Priors
from .tasks import Task

__all__ = [
    "Steps", "Windows", "bias_at", "everything", "kept", "lapse_prior", "lapse_weights",
    "least_bias_sds", "least_sds", "log_lapses_possible", "outer_signals", "score_prior",
]  # fmt: skip


def score_prior(axis: Array) -> Array:
    """Standard normal log-density of the scores; nothing for a fixed parameter."""
    return -0.5 * axis**2 - 0.5 * np.log(2 * np.pi) if axis.size > 1 else np.zeros(1)


def lapse_prior(model: WeberModel, low: Array, high: Array) -> Array:
    """Log prior density of the lapses on their coordinates, (Lo, Hi).

    Lapses that leave no rise are impossible. A node that stands for some of either kind has the
    share of the possible ones: where few trials leave mass at that edge, sums over nodes that are
    all in or all out went by steps.
    """
    transforms = model.transforms[-2:]
    z = [s.score(t) for s, t in zip(transforms, (low, high), strict=True)]
    slope = [
        np.log(s.slope(t)) * (t.size > 1) for s, t in zip(transforms, (low, high), strict=True)
    ]
    lo, hi = model.lapses(
        model.value("lapse_low", z[0])[:, None], model.value("lapse_high", z[1])[None, :]
    )
    density = log_score_prior(z[0][:, None], z[1][None, :], model.priors.lapse_correlation)
    density += slope[0][:, None] + slope[1] - log_lapses_possible(model.task, model.priors)
    lost = np.broadcast_to(lo + hi, density.shape)
    if lost.max() <= 0.5:  # no node stands for any past the edge
        return np.asarray(density)
    free = [axis for axis in (0, 1) if lost.shape[axis] > 1]
    across = np.sum([np.abs(np.gradient(lost, axis=axis)) for axis in free], axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(across > 0, np.clip((1 - lost) / across + 0.5, 0.0, 1.0), lost < 1)
        return np.asarray(density + np.log(share))


def lapse_weights(model: WeberModel, low: Array, high: Array) -> Array:
    """Log prior probability of the lapse nodes, (Lo, Hi)."""
    steps = [a[1] - a[0] for a in (low, high) if a.size > 1]
    return lapse_prior(model, low, high) + float(np.log(steps).sum())


@lru_cache(maxsize=64)
def log_lapses_possible(task: Task, priors: Priors) -> float:
    """Log prior mass of the lapses that leave the curve rising: λ_lo + λ_hi < 1."""
    z = np.linspace(-REACH, REACH, 181)
    values, scores = [], []
    for name in ("lapse_low", "lapse_high"):
        free = name in task.lapses and not priors.is_fixed(name)
        scores.append(z if free else np.zeros(1))
        values.append(priors.value(name, scores[-1]) * (name in task.lapses))
    low, high = task.asymptotes(values[0][:, None], values[1][None, :])
    weight = np.exp(log_score_prior(scores[0][:, None], scores[1], priors.lapse_correlation))
    # A node on the edge stands for as much inside as outside.
    rising = np.heaviside(np.round(1 - low - high, 12), 0.5)
    return float(np.log((weight * rising).sum() / weight.sum()))


def log_score_prior(low: Array, high: Array, correlation: float) -> Array:
    """Log prior density of the scores of both lapses (broadcasts), each of one value if fixed."""
    free = [int(a.size > 1) for a in (low, high)]
    rho = correlation if all(free) else 0.0
    square = free[0] * low**2 + free[1] * high**2 - 2 * rho * low * high
    norm = 0.5 * sum(free) * np.log(2 * np.pi) + 0.5 * np.log1p(-(rho**2))
    return np.asarray(-0.5 * square / (1 - rho**2) - norm)


# -- windows and steps ----------------------------------------------------------------------------


@dataclass(frozen=True)
class Steps:
    """Of one pass: the power, and steps of the outer axes, of each lapse, and of the biases, the
    last in the least sd that a bias can have given the rest."""

    power: float
    outer: Array
    lapse: Array
    bias: float

    def at(self, power: float, factor: float = 1.0) -> Steps:
        """The same for another power, so many times as wide beside its peaks."""
        by = factor * np.sqrt(self.power / power)
        return Steps(power, by * self.outer, by * self.lapse, by * self.bias)


@dataclass(frozen=True)
class Windows:
    """What is kept of R data sets at each of M outer nodes.

    `axes` are the nodes of the outer coordinates, M in all; `ends` (E, 2, R) how far each of these
    goes; `low` and `high` (2 + G, M, R) the ends of the coordinates of both lapses and of the bias
    of each group, infinite the wrong way round where nothing is kept.
    """

    axes: tuple[Array, ...]
    ends: Array
    low: Array
    high: Array

    def outer(self, steps: Array) -> tuple[Array, ...]:
        """Even nodes of the outer coordinates over all windows."""
        return tuple(even(e[0].min(), e[1].max(), s) for e, s in zip(self.ends, steps, strict=True))

    def lapses(self, steps: Array) -> tuple[Array, Array]:
        """Even nodes of both lapses over all windows."""
        low, high = (even(self.low[i].min(), self.high[i].max(), steps[i]) for i in (0, 1))
        return low, high

    def at(self, axes: tuple[Array, ...]) -> tuple[Array, Array]:
        """Windows at other outer nodes: those of the nodes around, together."""
        if self.low.shape[1] == 1:
            low, high = (np.repeat(s, _size(axes), axis=1) for s in (self.low, self.high))
        else:
            sides, shape = [], [a.size for a in self.axes]
            for old, new in zip(self.axes, axes, strict=True):
                place = np.maximum(np.searchsorted(old, new - 1e-9) - 1, 0)
                place = np.minimum(place, old.size - 1)
                sides.append((place, np.minimum(place + 1, old.size - 1)))
            corners = [
                np.ravel_multi_index(np.meshgrid(*c, indexing="ij"), shape).ravel()
                for c in product(*sides)
            ]
            low, high = self.low[:, corners[0]], self.high[:, corners[0]]
            for corner in corners[1:]:
                np.minimum(low, self.low[:, corner], out=low)
                np.maximum(high, self.high[:, corner], out=high)
        outside = np.zeros((*(a.size for a in axes), self.ends.shape[2]), dtype=bool)
        for e, (nodes, ends) in enumerate(zip(axes, self.ends, strict=True)):
            beyond = (nodes[:, None] < ends[0] - 1e-9) | (nodes[:, None] > ends[1] + 1e-9)
            outside |= beyond.reshape(
                *(-1 if i == e else 1 for i in range(len(axes))), ends.shape[1]
            )
        outside = outside.reshape(low.shape[1:])
        low[:, outside], high[:, outside] = np.inf, -np.inf
        return low, high


def _size(axes: tuple[Array, ...]) -> int:
    return int(np.prod([a.size for a in axes]))


def even(low: float, high: float, step: float) -> Array:
    """Nodes from `low` to `high`, no farther apart than a step; one where the ends are the same."""
    return np.linspace(low, high, int(np.ceil((high - low) / step - 1e-9)) + 1)


def everything(model: WeberModel, count: int) -> Windows:
    """Windows with whatever there may be: 8 sds of the priors, 5 of those of lapses."""
    far = 8.0
    lapses = [
        (float(transform.coordinate(-5.0)), float(transform.coordinate(5.0)))
        if free
        else (0.0, 0.0)
        for transform, free in zip(model.transforms[-2:], model.free[-2:], strict=True)
    ]
    bias = (-far, far) if model.free_bias else (0.0, 0.0)
    box = np.array([*lapses, *[bias] * model.n_groups])
    low, high = (np.repeat(side[:, None, None], count, axis=2) for side in box.T)
    ends = [far if free else 0.0 for free in model.free[:-2]]
    outer = np.array([[np.full(count, -f), np.full(count, f)] for f in ends])
    return Windows(tuple(np.zeros(1) for _ in ends), outer, low, high)


def kept(
    before: Windows,
    axes: tuple[Array, ...],
    profiles: list[tuple[Array, NDArray[np.floating]]],
    cut: float,
    beyond: float,
    by_node: bool = False,
) -> Windows:
    """Windows around the outer nodes that matter, within those before.

    `profiles` are, for each inner axis, its nodes (M, N) and the highest log density (M, N, R) with
    each of them and of the outer ones. A node `cut` nats under the best counts as empty, the best
    `by_node` being that with the same outer node; `beyond` of a gap is added where linear
    interpolation puts the end of a window.
    """
    shape = [a.size for a in axes]
    top = profiles[0][1].max(axis=1)  # (M, R)
    least = top.max(axis=0) - cut
    above = top > least
    ends = np.empty((len(axes), 2, top.shape[1]))
    folded = top.reshape(*shape, -1)
    for e, axis in enumerate(axes):
        others = tuple(i for i in range(len(axes)) if i != e)
        alone = folded.max(axis=others)  # (n, R)
        # Outer nodes are interpolated to the very ends: a whole gap is added.
        found = _ends(axis[None], alone[None], least[None], 1.0)
        ends[e, 0] = np.maximum(found[0][0], before.ends[e, 0].min())
        ends[e, 1] = np.minimum(found[1][0], before.ends[e, 1].max())
    low, high = (np.full((len(profiles), *top.shape), s) for s in (np.inf, -np.inf))
    least = top - cut if by_node else np.broadcast_to(least, top.shape)
    for i, (nodes, values) in enumerate(profiles):
        sides = _ends(nodes, values, least, beyond)
        finite = np.isfinite(before.low[i]), np.isfinite(before.high[i])
        first, last = before.low[i][finite[0]].min(), before.high[i][finite[1]].max()
        low[i] = np.where(above, np.maximum(sides[0], first), np.inf)
        high[i] = np.where(above, np.minimum(sides[1], last), -np.inf)
    # Outer axes go on beyond the last node kept, and the windows with them.
    for e in range(len(axes)):
        if shape[e] == 1:
            continue
        for side, nearest, nothing in ((low, np.minimum, np.inf), (high, np.maximum, -np.inf)):
            whole = np.moveaxis(side.reshape(len(side), *shape, -1), 1 + e, 1)
            pad = np.full((len(side), 1, *whole.shape[2:]), nothing)
            beside = nearest(
                np.concatenate([pad, whole[:, :-1]], axis=1),
                np.concatenate([whole[:, 1:], pad], axis=1),
            )
            whole[...] = np.where(np.isinf(whole), beside, whole)
    return Windows(axes, ends, low, high)


def _ends(
    nodes: Array, values: NDArray[np.floating], least: Array, beyond: float
) -> tuple[Array, Array]:
    """Where what is above the least begins and ends on an axis, (M, R), of values (M, N, R)."""
    size = nodes.shape[1]
    if size == 1:
        both = np.broadcast_to(nodes, least.shape)
        return both, both
    full = values > least[:, None]
    gap = (nodes[:, 1] - nodes[:, 0])[:, None]
    m, r = np.ogrid[: least.shape[0], : least.shape[1]]
    out = []
    for at, step in ((full.argmax(axis=1), -1), (size - 1 - full[:, ::-1].argmax(axis=1), 1)):
        outside = np.minimum(np.maximum(at + step, 0), size - 1)
        outer = np.maximum(np.where(outside == at, -np.inf, values[m, outside, r]), least - 20.0)
        inner = np.maximum(values[m, at, r], least)  # where nothing is above, whatever
        share = beyond + (inner - least) / np.maximum(inner - outer, 1e-9)
        out.append(nodes[m, at] + step * share * gap)
    return out[0], out[1]


def least_sds(model: WeberModel) -> Array:
    """The least sd that each outer score can have given the rest, whatever the answers.

    An effect is known the better the less noise there is, without end: so of effects, whatever
    the answers and for a Weber fraction within the domain.
    """
    free = np.array(model.free[:-2])
    out = np.ones(free.size)
    few = [np.linspace(-6.0, 6.0, 121), *[np.array([-1.5, 0.0, 1.5])] * (free.size - 1)]
    axes = [a if f else np.zeros(1) for a, f in zip(few, free, strict=True)]
    inside = axes[0][model.value(model.lead[0], axes[0]) >= FITTED_WEBER_FRACTIONS[0]]
    h, biases = 1e-3, bias_at(model, np.zeros(1))
    if np.any(
        biases != 0
    ):  # a criterion that lies to one side: elsewhere answers may inform it more
        biases = bias_at(model, np.linspace(-1.0, 1.0, 3))[:, None, None]
    for e in np.flatnonzero(free):
        sides = []
        for s in (h, -h):
            moved = [a + s * (i == e) for i, a in enumerate(axes)]
            if e and inside.size:
                moved[0] = inside
            d, weight = outer_signals(model, moved)
            sides.append(model.task.chance(d, weight * biases)[0])
        informed = information_of(model.cells.n, sides, 2 * h).sum(axis=-1)
        out[e] = 1 / np.sqrt(informed.max(initial=0.0) + 1)
    return out


def outer_signals(model: WeberModel, axes: list[Array] | tuple[Array, ...]) -> tuple[Array, Array]:
    """Decision variable and weight of the bias, both (M, C), at the outer nodes."""
    values = [model.value(name, a) for name, a in zip(model.lead[:-2], axes, strict=True)]
    k, *effects = (a.ravel() for a in np.meshgrid(*values, indexing="ij"))
    moved = np.stack(effects, axis=-1) if effects else None
    d, weight = np.broadcast_arrays(*model.decide(k, moved))
    return d, weight


def bias_at(model: WeberModel, score: Array) -> Array:
    """A bias at a normal score of its prior; what it is known to be, where it is."""
    if not model.free_bias:
        return np.full(np.shape(score), model.fixed_bias())
    return model.priors.value("bias", np.minimum(np.maximum(score, -REACH), REACH))


def least_bias_sds(model: WeberModel, d: Array, weight: Array, span: Array) -> Array:
    """The least sd of the score of every group's bias given the rest, (M, G), for decision
    variables (M, C), wherever in the span it lies."""
    if not model.free_bias:
        return np.ones((len(d), model.n_groups))
    h, at = 1e-3, span[:, None, None]
    sides = [model.task.chance(d, weight * bias_at(model, at + s))[0] for s in (h, -h)]
    informed = information_of(model.cells.n, sides, 2 * h) @ model.membership  # (B, M, G)
    return np.asarray(1 / np.sqrt(informed.max(axis=0) + 1))


def information_of(n: Array, sides: list[Array], between: float) -> Array:
    """Fisher information of n answers, of their chances after and before a change."""
    after, before = sides
    p = np.clip(0.5 * (after + before), 1e-9, 1 - 1e-9)
    return np.asarray(n * ((after - before) / between) ** 2 / (p * (1 - p)))
