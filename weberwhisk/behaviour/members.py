"""The members of a population, and the likelihood of its parameters given their tables."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from .lapses import AS_BELIEVED, BiasScales
from .tabulated import Table

Array = NDArray[np.float64]

NODES_PER_SD = 4.0  # of ln k, for the sharpest member
COARSEST = 0.15  # nodes of ln k, however little members tell: spreads are told apart from 0.1 on


@dataclass(frozen=True)
class Members:
    """The tables of a population: one for each animal, or for each session of each animal.

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

    def axis(self, finest: float) -> Array:
        """Nodes of ln k on which all members are compared."""
        low = min(t.log_k[0] for t in self.tables) - 0.5
        high = max(t.log_k[-1] for t in self.tables) + 0.5
        return np.arange(low, high + finest, finest)


class Work:
    """The likelihood of a population's parameters, given its members' tables."""

    def __init__(self, members: Members) -> None:
        self.members = members
        moments = np.array([_moments(t) for t in members.tables])  # (U, 2, S)
        self._mean, self._log_sd = moments[:, 0], moments[:, 1]
        finest = float(np.exp(self._log_sd.min()))
        self.x = members.axis(min(finest / NODES_PER_SD, COARSEST))
        self.step = self.x[1] - self.x[0]

    def middle(
        self, spread: Array, session_spread: Array, bias_scale: Array
    ) -> tuple[Array, Array]:
        """Where ln k of the population lies given its spreads, and how surely, both (T, Z, B).

        As if every member's likelihood were normal: only the place of nodes depends on it.
        """
        onto = self.members.scales.onto(bias_scale).T
        own_mean, own_sd = self._mean @ onto, np.exp(self._log_sd @ onto)  # (U, B)
        precision = 1 / (own_sd[:, None] ** 2 + session_spread[:, None] ** 2)  # (U, Z, B)
        first = self.members.first
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
        if not self.members.sessions:
            return None
        return self.kernel(self.x, np.full(self.x.shape, session_spread))

    def given_lapses(self, mean: Array, spread: Array, bias_scale: Array) -> Array:
        """Log-likelihood of ln k of every member, (B, J, U, X).

        For J populations of lapses, and each scale of the biases (B,).
        """
        onto, rho = self.members.scales.onto(bias_scale), self.members.lapse_correlation
        out = [
            table.given_lapses(table.lapse_weights(mean, spread, rho), self.x, onto)
            for table in self.members.tables
        ]
        return np.array(out).transpose(1, 3, 0, 2)

    def by_animal(self, log_like: Array, within: Array | None) -> tuple[Array, Array]:
        """Log-likelihood of each animal's middle ln k, (..., A, X), and each member's (..., U, X).

        `within` is the kernel of its sessions.
        """
        if within is None:
            return log_like, log_like
        own = _log_product(log_like, within)
        return np.add.reduceat(own, self.members.first, axis=-2), own

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
