"""The likelihood of one observer's choices: Weber fraction, lapses, and biases by group."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from .percepts import UnitPercepts
from .priors import Priors
from .tasks import Task
from .trials import Cells

Array = NDArray[np.float64]

TINY = 1e-300  # an answer that cannot happen costs 690 nats a trial, not infinity


@dataclass(frozen=True)
class WeberModel:
    """One observer: k and two lapses for all cells, one bias per group of cells.

    Given k and the lapses, the biases of the groups are independent, which is what makes a bias per
    standard as cheap as one bias: each is integrated by itself.

    Parameters
    ----------
    task : Task
    percepts : UnitPercepts
        Of every cell; arrays (C,).
    cells : Cells
    priors : Priors
    group : ndarray of int, shape (C,)
        Which bias a cell has.
    group_names : tuple of str
        Names of the biases; empty where there is none.
    """

    task: Task
    percepts: UnitPercepts
    cells: Cells
    priors: Priors
    group: NDArray[np.intp]
    group_names: tuple[str, ...]

    @property
    def n_groups(self) -> int:
        """Groups of cells, one where there is no bias."""
        return max(len(self.group_names), 1)

    @property
    def lapse_names(self) -> tuple[str, ...]:
        """Lapse parameters of the task."""
        return self.task.lapses

    @property
    def names(self) -> tuple[str, ...]:
        """All parameters that are not fixed."""
        lead = [n for n in ("weber_fraction", *self.lapse_names) if not self.priors.is_fixed(n)]
        return (*lead, *(self.group_names if self.free_bias else ()))

    @property
    def free_bias(self) -> bool:
        """Whether there is any bias to infer."""
        return bool(self.group_names) and not self.priors.is_fixed("bias")

    @cached_property
    def membership(self) -> Array:
        """(C, G): 1 where a cell belongs to a group."""
        return np.equal.outer(self.group, np.arange(self.n_groups)).astype(float)

    def eta(self, k: Array) -> Array:
        """Decision variable without bias, (..., C)."""
        return self.task.decision_variable(self.percepts, k)

    def lapses(self, low: Array, high: Array) -> tuple[Array, Array]:
        """Asymptotes as the task sees them; `low` is ignored where the task has none."""
        return self.task.asymptotes(low, high)

    def fixed_bias(self) -> float:
        """The bias of every group where it is not inferred."""
        if self.group_names and self.priors.is_fixed("bias"):
            return float(self.priors.bias)
        return 0.0

    def fixed_value(self, name: str) -> float:
        """The value of a parameter that is not inferred."""
        if name in ("weber_fraction", *self.lapse_names):
            return float(getattr(self.priors, name))
        return self.fixed_bias()

    def probability(self, k: Array, low: Array, high: Array, bias: Array) -> tuple[Array, Array]:
        """P and 1 − P of every cell.

        Parameters
        ----------
        k, low, high : ndarray, shape (...)
        bias : ndarray, shape (..., G)

        Returns
        -------
        tuple of ndarray, shape (..., C)
            Both computed without subtraction from 1, so neither loses its tail.
        """
        low, high = self.lapses(low, high)
        eta = self.eta(k) + bias[..., self.group]
        up, down = ndtr(eta), ndtr(-eta)
        low, high = low[..., None], high[..., None]
        return (
            np.maximum(low * down + (1 - high) * up, TINY),
            np.maximum((1 - low) * down + high * up, TINY),
        )

    def log_likelihood(self, k: Array, low: Array, high: Array, bias: Array) -> Array:
        """Log-probability of the sequence of answers, (...); binomial coefficients left out."""
        return self.cell_log_likelihood(k, low, high, bias).sum(axis=-1)

    def cell_log_likelihood(self, k: Array, low: Array, high: Array, bias: Array) -> Array:
        """The same by cell, (..., C)."""
        p, q = self.probability(k, low, high, bias)
        return self.cells.count * np.log(p) + (self.cells.n - self.cells.count) * np.log(q)

    def log_bias_prior(self, bias: Array) -> Array:
        """Log-density of the bias prior, elementwise; 0 where the bias is fixed."""
        if not self.free_bias:
            return np.zeros(np.shape(bias))
        return np.asarray(self.priors.bias.logpdf(bias))

    def bias_mode(
        self, k: Array, low: Array, high: Array, start: Array | None = None
    ) -> tuple[Array, Array]:
        """Where each bias lies given the rest: centre and sd, (..., G), by Fisher scoring.

        Only the place of quadrature nodes depends on these, never the answer.
        """
        shape = (*np.broadcast_shapes(k.shape, low.shape, high.shape), self.n_groups)
        if not self.free_bias:
            return np.full(shape, self.fixed_bias()), np.ones(shape)
        mean, sd = float(self.priors.bias.mean()), float(self.priors.bias.std())
        low, high = (a[..., None] for a in self.lapses(low, high))
        eta, n, x = self.eta(k), self.cells.n, self.cells.count
        bias = np.full(shape, mean) if start is None else np.broadcast_to(start, shape)
        precision = np.ones(shape)
        for _ in range(25):
            z = eta + bias[..., self.group]
            up, down = ndtr(z), ndtr(-z)
            p = np.maximum(low * down + (1 - high) * up, TINY)
            q = np.maximum((1 - low) * down + high * up, TINY)
            slope = (1 - low - high) * np.exp(-0.5 * z * z) / np.sqrt(2 * np.pi)
            weight = slope / (p * q)
            score = (weight * (x - n * p)) @ self.membership - (bias - mean) / sd**2
            precision = (weight * slope * n) @ self.membership + 1 / sd**2
            step = np.clip(score / precision, -1.0, 1.0)
            bias = bias + step
            if np.max(np.abs(step) * np.sqrt(precision)) < 0.02:
                break
        return bias, 1 / np.sqrt(precision)

    def merged(self) -> WeberModel:
        """The same likelihood with fewer cells: those that only differ in scale are one.

        Under Weber's law every standard repeats the same few ratios.
        """
        p = self.percepts
        key = np.column_stack([(p.mean_2 - p.mean_1) / p.sd_1, p.sd_2 / p.sd_1])
        rounded = np.column_stack([np.round(key, 11), self.group])
        _, first, same = np.unique(rounded, axis=0, return_index=True, return_inverse=True)
        same = same.reshape(-1)
        gap, ratio = key[first].T
        c = self.cells
        return replace(
            self,
            percepts=UnitPercepts(np.zeros(first.size), np.ones(first.size), gap, ratio),
            cells=Cells(
                c.stimulus_1[first],
                c.stimulus_2[first],
                c.standard[first],
                np.bincount(same, c.n, first.size).astype(float),
                np.bincount(same, c.count, first.size).astype(float),
            ),
            group=self.group[first],
        )

    def subset(self, standard: float) -> WeberModel:
        """The same observer seen at one standard alone."""
        keep = self.cells.standard == standard
        groups = np.unique(self.group[keep])
        return replace(
            self,
            percepts=UnitPercepts(*(a[keep] for a in self.percepts)),
            cells=self.cells.of(standard),
            group=np.searchsorted(groups, self.group[keep]),
            group_names=tuple(self.group_names[g] for g in groups) if self.group_names else (),
        )

    def by_standard(self) -> Iterator[tuple[float, WeberModel]]:
        """Every standard with its part of the model."""
        for standard in np.unique(self.cells.standard):
            yield float(standard), self.subset(float(standard))
