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
from scipy.special import ndtr
from scipy.stats import lognorm, norm

from .integrate.batch import batch_steps, likelihood
from .integrate.blocks import NOTHING
from .lapses import AS_BELIEVED, BiasScales, with_tail
from .likelihood import Draws, WeberModel
from .priors import REACH


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
        onto = self.scales.onto(bias_scale)
        out = [table.given_lapses(mean, spread, self.x, onto) for table in self.tables]
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
    usual = np.zeros(1), np.ones(1)
    log_like = table.given_lapses(*usual, table.log_k, np.eye(len(table.top)))[..., 0]
    mass = np.exp(log_like - log_like.max(axis=1, keepdims=True))
    mass /= mass.sum(axis=1, keepdims=True)
    mean = mass @ table.log_k
    variance = (mass * (table.log_k - mean[:, None]) ** 2).sum(axis=1)
    return mean, 0.5 * np.log(variance)


Array = NDArray[np.float64]

LEAST = 1e-35  # of a likelihood, over the highest


@dataclass(frozen=True)
class LapseNodes:
    """Nodes of both lapses for populations, finer than those on which likelihoods are known.

    Of each lapse `scores` (F,) of its prior, `widths` (F,) in scores, and `shares` (F, N): of every
    known node in the likelihood there, a cubic spline's; below the first it is that of no lapse.
    `possible` (F, F) are those that leave the curve rising.
    """

    scores: tuple[Array, ...]
    widths: tuple[Array, ...]
    shares: tuple[Array, ...]
    possible: NDArray[np.bool_]
    correlation: float

    @classmethod
    def between(
        cls, model: WeberModel, low: Array, high: Array, finer: int = 2, lowest: float = -REACH
    ) -> LapseNodes:
        """So many nodes for each of these coordinates (N,), carried on below to a score."""
        parts = []
        for name, axis in zip(model.lead[-2:], (low, high), strict=True):
            score, width, share = np.zeros(1), np.ones(1), np.ones((1, 1))
            if axis.size > 1:
                transform = model.transforms[model.lead.index(name)]
                step = (axis[1] - axis[0]) / finer
                first = with_tail(model, name, axis, lowest)[0]
                fine = np.arange(first, axis[-1] + 0.5 * step, step)
                score, width = transform.score(fine), transform.slope(fine) * step
                share = CubicSpline(axis, np.eye(axis.size))(np.maximum(fine, axis[0]))
            parts.append((score, width, share, model.value(name, score)))
        scores, widths, shares, (lo, hi) = zip(*parts, strict=True)
        possible = np.add(*model.lapses(lo[:, None], hi[None])) < 1
        return cls(scores, widths, shares, possible, model.priors.lapse_correlation)

    def weights(self, mean: Array, spread: Array) -> Array:
        """Probability of the known nodes in J populations, (Lo, Hi, J): the scores of an animal are
        normal with that mean, spread and correlation."""
        free = [score.size > 1 for score in self.scores]
        rho = self.correlation if all(free) else 0.0
        u, v = ((s[:, None] - mean * f) / spread for s, f in zip(self.scores, free, strict=True))
        square = u[:, None] ** 2 + v[None] ** 2 - 2 * rho * u[:, None] * v[None]
        density = np.exp(-0.5 * square / (1 - rho**2)) * self.possible[..., None]
        density /= np.sqrt(1 - rho**2) * (spread * np.sqrt(2 * np.pi)) ** sum(free)
        parts = (s * w[:, None] for s, w in zip(self.shares, self.widths, strict=True))
        return np.asarray(np.einsum("li,hj,lhm->ijm", *parts, density, optimize=True))


@dataclass(frozen=True)
class Table:
    """Likelihood of the answers of one member.

    `log_k` (K,) are nodes of ln k; `lapses` those of both lapses, of which there are Lo and Hi. For
    S scales of the biases, `top` (S, K) is the highest log-likelihood over the lapses, and
    `relative` (S, K, Lo·Hi) the likelihood over it.
    """

    log_k: Array
    lapses: LapseNodes
    top: Array
    relative: NDArray[np.float32]

    def given_lapses(self, mean: Array, spread: Array, log_k: Array, onto: Array) -> Array:
        """Log-likelihood of ln k alone, (B, X, J): in J populations of lapses, interpolated onto
        other nodes.

        `onto` (B, S) are the shares of the tabulated scales in B others.
        """
        weights = self.lapses.weights(mean, spread).reshape(-1, mean.size).astype(np.float32)
        like = (self.relative @ weights).astype(float)
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


def tabulate(
    model: WeberModel, draws: Draws, scales: BiasScales, cut: float = 20.0, vague: float = 0.6
) -> Table:
    """The table of a model without effects, of all that lies no more than `cut` nats under its
    best, with biases as wide as the widest scale has them and any k.

    Others of the population draw an animal to where its own prior has nothing: k is believed to lie
    about its draws, `vague` being the sd of its logarithm.
    """
    priors = model.priors
    middle = float(np.median(draws.weber_fraction))
    wide = replace(priors, weber_fraction=lognorm(vague, scale=middle))
    if model.free_bias:
        mean, sd = (max(scales.nodes[-1], 1.0) * moment for moment in priors.moments("bias"))
        wide = replace(wide, bias=norm(mean, sd))
    unbound = replace(model, priors=wide)
    steps = batch_steps(unbound, k=0.9, lapse=0.8, bias=0.6)
    found = likelihood(unbound, model.cells.count[None], steps, scales, cut, priors)
    values = found.values[..., 0].reshape(scales.nodes.size, found.scores.size, -1)
    some = values.max(axis=(0, 2)) > 0.5 * NOTHING
    values = values[:, some].astype(float)
    top = values.max(axis=-1)
    return Table(
        np.log(unbound.value("weber_fraction", found.scores[some])),
        LapseNodes.between(model, found.low, found.high),
        top,
        np.exp(values - top[..., None]).astype(np.float32),
    )
