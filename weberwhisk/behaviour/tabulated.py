"""One animal's (or session's) likelihood on nodes, its biases integrated: tabulated once.

What a population needs of each of its members is its likelihood over the parameters that are
pooled: ln k, the lapses, and the scale of the biases. Everything after that is re-weighting.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.special import ndtr, ndtri
from scipy.stats import norm

from .lapses import AS_BELIEVED, BiasScales, scaled_prior
from .likelihood import Draws, WeberModel


@dataclass(frozen=True)
class Members:
    """The likelihood of a population's parameters, given the tables of its members: one for each
    animal, or for each session of each animal.

    `animal` (U,) rises and says whose each table is; `scales` are those of the biases at which all
    were made.
    """

    tables: tuple[Table, ...]
    animal: NDArray[np.intp]
    sessions: bool
    lapse_correlation: float
    scales: BiasScales = AS_BELIEVED

    @cached_property
    def first(self) -> NDArray[np.intp]:
        """The first table of each animal."""
        return np.flatnonzero(np.r_[True, np.diff(self.animal) > 0])

    @cached_property
    def _moments(self) -> tuple[Array, Array]:
        """Mean and log sd of ln k of each alone, with the prior's lapses, by scale, (U, S)."""
        found = np.array([_moments(t) for t in self.tables])
        return found[:, 0], found[:, 1]

    @cached_property
    def x(self) -> Array:
        """Nodes of ln k on which all are compared."""
        # However little members tell, spreads are distinguished from 0.1 on.
        step = min(float(np.exp(self._moments[1].min())) / 4, 0.15)
        low = min(t.log_k[0] for t in self.tables) - 0.5
        high = max(t.log_k[-1] for t in self.tables) + 0.5
        return np.arange(low, high + step, step)

    @property
    def step(self) -> float:
        """How far these are apart."""
        return float(self.x[1] - self.x[0])

    def middle(
        self, spread: Array, session_spread: Array, bias_scale: Array
    ) -> tuple[Array, Array]:
        """Where ln k of the population lies given its spreads, and how surely, both (T, Z, B).

        As if every member's likelihood were normal: only the place of nodes depends on it.
        """
        onto = self.scales.onto(bias_scale).T
        mean, log_sd = self._moments
        own_mean, own_sd = mean @ onto, np.exp(log_sd @ onto)  # (U, B)
        precision = 1 / (own_sd[:, None] ** 2 + session_spread[:, None] ** 2)  # (U, Z, B)
        first = self.first
        total = np.add.reduceat(precision, first)
        mean = np.add.reduceat(precision * own_mean[:, None], first) / total
        weight = 1 / (1 / total + spread[:, None, None, None] ** 2)  # (T, A, Z, B)
        sum_of_weights = weight.sum(axis=1)
        return (weight * mean).sum(axis=1) / sum_of_weights, 1 / np.sqrt(sum_of_weights)

    def kernel(self, centre: Array, spread: Array) -> Array:
        """Probability of each node of ln k under normals, (X, ...).

        The end nodes stand for all beyond them, where a likelihood goes on as it was: populations
        out there are unlikely by their prior, and not impossible.
        """
        # A normal narrower than the nodes is as wide as they are: a fifth of what any member tells.
        width = np.maximum(spread, 0.8 * self.step)
        z = (self.x.reshape(-1, *[1] * np.ndim(centre)) - centre) / width
        out: Array = np.exp(-0.5 * z**2) * (self.step / (width * np.sqrt(2 * np.pi)))
        half = 0.5 * self.step / width
        out[0] += ndtr(z[0] - half)
        out[-1] += ndtr(-z[-1] - half)
        return out

    def within(self, session_spread: float) -> Array | None:
        """The kernel of sessions about their animal's ln k, (X, X); none where they are one."""
        if not self.sessions:
            return None
        return self.kernel(self.x, np.full(self.x.shape, session_spread))

    def given_lapses(self, mean: Array, spread: Array, bias_scale: Array) -> Array:
        """Log-likelihood of ln k of every member, (B, J, U, X).

        For J populations of lapses, and each scale of the biases (B,).
        """
        onto, rho = self.scales.onto(bias_scale), self.lapse_correlation
        out = [
            table.given_lapses(table.lapse_weights(mean, spread, rho), self.x, onto)
            for table in self.tables
        ]
        return np.array(out).transpose(1, 3, 0, 2)

    def by_animal(self, log_like: Array, within: Array | None) -> tuple[Array, Array]:
        """Log-likelihood of each animal's middle ln k, (..., A, X), and each member's (..., U, X).

        `within` is the kernel of its sessions.
        """
        if within is None:
            return log_like, log_like
        own = _log_product(log_like, within)
        return np.add.reduceat(own, self.first, axis=-2), own

    def log_likelihood(
        self, log_like: Array, within: Array | None, between: Array
    ) -> tuple[Array, Array]:
        """Of the population, (..., MT), by animal (..., A, MT); `between` is the kernel (X, MT)."""
        by_animal = _log_product(self.by_animal(log_like, within)[0], between)
        return by_animal.sum(axis=-2), by_animal


def _log_product(log_like: Array, kernel: Array) -> Array:
    """ln of the likelihoods averaged over each column of a kernel."""
    top = log_like.max(axis=-1, keepdims=True)
    return np.log(np.maximum(np.exp(log_like - top) @ kernel, 1e-300)) + top


def _moments(table: Table) -> tuple[Array, Array]:
    """Mean and log sd of ln k in the likelihood of a member alone, with the prior's lapses, for
    every scale of its biases, (S,)."""
    weights = table.lapse_weights(np.zeros(1), np.ones(1), 0.0)
    log_like = table.given_lapses(weights, table.log_k, np.eye(len(table.top)))[..., 0]
    mass = np.exp(log_like - log_like.max(axis=1, keepdims=True))
    mass /= mass.sum(axis=1, keepdims=True)
    mean = mass @ table.log_k
    variance = (mass * (table.log_k - mean[:, None]) ** 2).sum(axis=1)
    return mean, 0.5 * np.log(variance)


Array = NDArray[np.float64]

LEAST = 1e-35  # of a likelihood, over the highest


@dataclass(frozen=True)
class Table:
    """Likelihood of the answers of one member.

    `log_k` (K,) are nodes of ln k; `low` (Lo,) and `high` (Hi,) nodes of the lapses' normal scores,
    a single zero where the task has no such lapse. For S scales of the biases, `top` (S, K) is the
    highest log-likelihood over the lapses, and `relative` (S, K, Lo·Hi) the likelihood over it.
    Below the first lapse nodes the lapses are none, and the likelihood is that of the first.
    """

    log_k: Array
    low: Array
    high: Array
    top: Array
    relative: NDArray[np.float32]

    def lapse_weights(self, mean: Array, spread: Array, correlation: float) -> Array:
        """Probability of the lapse nodes for a population, (Lo·Hi, J) for J means and spreads.

        The scores of an animal are normal with that mean, spread and correlation.
        """
        free = [axis.size > 1 for axis in (self.low, self.high)]
        rho = correlation if all(free) else 0.0
        low, first_low = _with_tail(self.low)
        high, first_high = _with_tail(self.high)
        scale = 1 / spread
        u, v = (
            (axis[:, None] - mean) * scale if is_free else np.zeros((1, mean.size))
            for axis, is_free in zip((low, high), free, strict=True)
        )
        square = u[:, None] ** 2 + v[None] ** 2 - 2 * rho * u[:, None] * v[None]
        density = np.exp(-0.5 * square / (1 - rho**2))  # (Lo', Hi', J)
        for axis, is_free in zip((low, high), free, strict=True):
            density *= (axis[1] - axis[0]) * scale / np.sqrt(2 * np.pi) if is_free else 1.0
        density /= np.sqrt(1 - rho**2)
        density = np.add.reduceat(density, np.r_[0, first_low + 1 : low.size], axis=0)
        density = np.add.reduceat(density, np.r_[0, first_high + 1 : high.size], axis=1)
        return density.reshape(-1, mean.size)

    def given_lapses(self, weights: Array, log_k: Array, onto: Array) -> Array:
        """Log-likelihood of ln k alone, (B, X, J): lapses weighted, interpolated onto other nodes.

        `onto` (B, S) are the shares of the tabulated scales in B others.
        """
        like = (self.relative @ weights.astype(np.float32)).astype(float)
        value = np.log(np.maximum(like, LEAST)) + self.top[..., None]
        curve = CubicSpline(self.log_k, np.tensordot(onto, value, 1), axis=1)
        first, last = self.log_k[[0, -1]]
        slope = curve(self.log_k[[0, -1]], 1)
        # Beyond the nodes the likelihood goes on as it was: flat, or falling.
        below, above = np.minimum(log_k - first, 0), np.maximum(log_k - last, 0)
        inside: Array = curve(np.clip(log_k, first, last))
        inside += below[:, None] * np.maximum(slope[:, :1], 0.0)
        inside += above[:, None] * np.minimum(slope[:, 1:], 0.0)
        return inside


def _with_tail(axis: Array, reach: float = 9.0) -> tuple[Array, int]:
    """The axis carried on below, and where its first node has come to stand."""
    if axis.size == 1:
        return axis, 0
    step = axis[1] - axis[0]
    more = int(reach / step)
    return axis[0] + step * np.arange(-more, axis.size), more


def tabulate(model: WeberModel, draws: Draws, scales: Array, values: int = 400_000) -> Table:
    """The table of a model without effects, on nodes laid around draws from its posterior.

    Its biases have their prior times each of the scales (S,). So many values are computed at once.
    """
    log_k = np.log(draws.weber_fraction)
    if model.free[0]:
        step = _node_step(log_k)
        log_k = np.arange(log_k.min() - 8 * step, log_k.max() + 9 * step, step)
    else:  # known: a population of it says nothing, but costs nothing either
        log_k = log_k[0] + np.linspace(-1e-3, 1e-3, 5)
    low, high = (_lapse_axis(model, n, getattr(draws, n)) for n in ("lapse_low", "lapse_high"))
    lapses = model.value("lapse_low", low), model.value("lapse_high", high)
    lo, hi = (a.ravel() for a in np.meshgrid(*lapses, indexing="ij"))
    k = np.exp(log_k)
    bias, finer, prior = _bias_nodes(model, k, draws, scales)
    rows = max(1, values // (lo.size * len(finer) * max(model.cells.n.size, model.n_groups)))
    parts = []
    for i in (slice(j, j + rows) for j in range(0, k.size, rows)):
        cells = model.cell_log_likelihood(
            k[i, None, None], lo[:, None], hi[:, None], bias[i, None]
        )  # (k, Lo·Hi, B, C)
        curve = np.moveaxis(cells @ model.membership, -1, 1) @ finer.T  # (k, G, Lo·Hi, F)
        top = curve.max(axis=-1, keepdims=True)
        by_group = np.log(np.maximum(np.exp(curve - top) @ prior[i], LEAST)) + top
        parts.append(by_group.sum(axis=1))
    found = np.moveaxis(np.concatenate(parts), -1, 0)  # (S, K, Lo·Hi)
    found[..., sum(model.lapses(lo, hi)) >= 1] = -np.inf
    best = found.max(axis=-1)
    return Table(log_k, low, high, best, np.exp(found - best[..., None]).astype(np.float32))


def _bias_nodes(
    model: WeberModel, k: Array, draws: Draws, scales: Array, finer: int = 4
) -> tuple[Array, Array, Array]:
    """Nodes of every bias for each k, (K, B, G); and nodes between them, as narrow a prior needs:
    their shares of the former (F, B), and their prior probabilities (K, G, F, S).

    Nodes go to 8 sds with the prior and 4 with the widest scale, but not beyond 32: answers that
    say nothing of a bias say it of all.
    """
    if not model.free_bias:
        bias = np.full((k.size, 1, model.n_groups), model.fixed_bias())
        return bias, np.ones((1, 1)), np.ones((k.size, model.n_groups, 1, scales.size))
    encoded = model.decide(k)
    at = [np.quantile(v, [0.5, 0.002, 0.998]) for v in (draws.lapse_low, draws.lapse_high)]
    modes = [model.bias_mode(encoded, lo, hi) for lo, hi in zip(*at, strict=True)]
    (centre, spread), *others = modes
    # The nodes must also serve other lapses than the likeliest, and wider biases than believed.
    far = max(float(np.max(np.abs(c - centre) / spread)) for c, _ in others) + 8
    if scales[-1] > 1:
        c, wide = _widened(model, scales[-1]).bias_mode(encoded, at[0][0], at[1][0])
        reach = float(np.max((np.abs(c - centre) + 4 * wide) / spread))
        far = max(far, min(reach, 32.0))
    offsets = np.arange(-np.ceil(far), np.ceil(far) + 1)
    fine = np.linspace(offsets[0], offsets[-1], finer * (offsets.size - 1) + 1)
    between = centre[..., None] + spread[..., None] * fine  # (K, G, F)
    prior = scaled_prior(
        model.priors, between, np.broadcast_to((spread / finer)[..., None], between.shape), scales
    )
    bias = centre[:, None, :] + spread[:, None, :] * offsets[:, None]
    return bias, CubicSpline(offsets, np.eye(offsets.size))(fine), np.exp(prior)


def _widened(model: WeberModel, scale: float) -> WeberModel:
    """The same observer, with a normal prior of the bias so many times as wide."""
    mean, sd = model.priors.moments("bias")
    return replace(model, priors=replace(model.priors, bias=norm(scale * mean, scale * sd)))


def _lapse_axis(
    model: WeberModel, name: str, values: Array, widest: float = 0.3, none_lost: float = 0.02
) -> Array:
    """Scores from where the lapse is none, so few trials being lost, to where the answers exclude
    it, no farther apart than the widest step."""
    if name not in model.lapse_names or model.priors.is_fixed(name):
        return np.zeros(1)
    scores = ndtri(np.clip(model.priors.of(name).cdf(values), 1e-12, 1 - 1e-12))
    step = min(_node_step(scores, below=False), widest)
    last = scores.max() + 8 * step
    scan = np.arange(-6.0, last, 0.05)
    none = scan[model.value(name, scan) * max(model.cells.n.sum(), 1) < none_lost]
    first = min(none[-1] if none.size else scan[0], last - 4 * step)
    return np.arange(first, last + step, step)


def _node_step(values: Array, below: bool = True) -> float:
    """Three fifths of a standard deviation, judged by the steeper side of what may be a shelf."""
    q = np.quantile(values, [0.001, 0.16, 0.84, 0.999])
    sides = [q[3] - q[2], q[1] - q[0]][: 2 if below else 1]
    return float(max(min(sides) / 3.5, 1e-4))
