"""The posterior of many parameters, where a grid would be too large, as weighted draws.

In normal scores of priors, and the coordinates of biases, a posterior has lighter tails than any
Student's t, so that the weights of `_util.importance` are bounded. One t stands for each quarter of
the Weber fractions, and one for either tail: at small ones a bias in sds is wide and lapses are
many, at large ones few. The draws are a quadrature rule: estimates and evidence depend on the data
alone, and the seed of a fit is that of the draws resampled from them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from .._util.importance import SobolPoints, WeightedDraws, adapted_draws
from .._util.values import Array, Fields, Index, weighted_quantiles
from .axes import bias_prior, log_lapses_possible
from .likelihood import Draws, WeberModel
from .posteriors import fraction_curve, split

__all__ = ["EFFECTIVE", "PASS", "ImportancePosterior", "Target"]

PASS = 2000  # vectors of a call
EFFECTIVE = 5000.0  # independent draws that the weighted ones are to be worth
RESAMPLED = 8000  # draws of equal weight


@dataclass(frozen=True)
class Target:
    """The density of vectors: free lead scores of an observer, the coordinates of its biases, and
    the scores of any further parameters of a kind of model."""

    model: WeberModel

    @property
    def further(self) -> int:
        """How many scores follow the biases."""
        return 0

    def parameters(self, theta: Array) -> Draws:
        """Every parameter at vectors (N, D)."""
        return self.model.draws_at(*split(self.model, theta))

    def log_likelihood(self, draws: Draws) -> Array:
        """Log-probability of the answers, (N,)."""
        return self.model.log_likelihood(*draws.values)

    @cached_property
    def start(self) -> tuple[Array, Array]:
        """Mean and sd of a vector under the prior."""
        lead, model = sum(self.model.free), self.model
        biases = model.n_groups if model.free_bias else 0
        size = lead + biases + self.further
        mean, sd = np.zeros(size), np.ones(size)
        if biases:
            low, middle, high = model.bias_transform.coordinate([-1.0, 0.0, 1.0]).tolist()
            mean[lead : lead + biases], sd[lead : lead + biases] = middle, 0.5 * (high - low)
        return mean, sd

    @property
    def _biases(self) -> slice:
        """Which entries are coordinates of biases."""
        lead = sum(self.model.free)
        return slice(lead, lead + self.model.free_bias * self.model.n_groups)

    @cached_property
    def _prior(self) -> tuple[Index, Array, float]:
        """Which entries are scores, their precision, and the log density at zero."""
        lead = sum(self.model.free)
        scores = np.r_[0:lead, self.start[0].size - self.further : self.start[0].size]
        precision = np.eye(scores.size)
        precision[:lead, :lead] = self.model.score_precision
        at_zero = 0.5 * np.linalg.slogdet(precision)[1] - 0.5 * scores.size * np.log(2 * np.pi)
        return scores, precision, at_zero - log_lapses_possible(self.model.task, self.model.priors)

    def log_density(self, theta: Array) -> Array:
        """Log of prior times likelihood, (N,), normalised as the evidence needs it."""
        scores, precision, at_zero = self._prior
        out = np.empty(len(theta))
        for part in (slice(i, i + PASS) for i in range(0, len(theta), PASS)):
            draws, x = self.parameters(theta[part]), theta[part][:, scores]
            prior = at_zero - 0.5 * np.einsum("ni,ij,nj->n", x, precision, x)
            if self.model.free_bias:
                prior += bias_prior(self.model, theta[part][:, self._biases]).sum(axis=-1)
            possible = sum(self.model.lapses(draws.lapse_low, draws.lapse_high)) < 1
            out[part] = np.where(possible, prior + self.log_likelihood(draws), -np.inf)
        return out

    def weighted(self, effective: float = EFFECTIVE, size: int = PASS) -> WeightedDraws:
        """Draws worth so many independent ones; the same whenever they are made."""
        if not self.start[0].size:  # every parameter is given: the posterior is one point
            return WeightedDraws(
                np.zeros((1, 0)), self.log_density(np.zeros((1, 0))), log_proposal=np.zeros(1)
            )
        points = SobolPoints(self.start[0].size + 1, seed=0)
        return adapted_draws(
            self.log_density, *self.start, points, effective=effective, size=size, tails=True,
        )  # fmt: skip


@dataclass(frozen=True, repr=False)
class ImportancePosterior(Fields):
    """Weighted draws of vectors of a target; `draws` are resampled from them."""

    target: Target
    weighted: WeightedDraws
    seed: int = 0
    chains: int = 4

    @classmethod
    def sampled(
        cls, target: Target, seed: int = 0, *, effective: float = EFFECTIVE, size: int = PASS
    ) -> Self:
        """The posterior of a target, by draws worth so many independent ones."""
        return cls(target, target.weighted(effective, size), seed)

    def recomputed(self, model: WeberModel) -> ImportancePosterior | None:
        return ImportancePosterior.sampled(Target(model))

    @property
    def model(self) -> WeberModel:
        return self.target.model

    @property
    def log_evidence(self) -> float:
        return self.weighted.log_evidence

    @property
    def error(self) -> float:
        return float(self.weighted.effective**-0.5) if self.weighted.values.size else 0.0

    @property
    def trouble(self) -> str:
        if self.error <= 0.03:
            return ""
        return f"its draws are worth only {self.weighted.effective:.0f} independent ones"

    @cached_property
    def _values(self) -> dict[str, Array]:
        """Every inferred parameter at the weighted draws."""
        return self.target.parameters(self.weighted.values).named(self.model)

    def _weighed(self, name: str) -> tuple[Array, Array]:
        if name in self._values:
            return self._values[name], self.weighted.weights
        return np.full(2, self.model.fixed_value(name)), np.full(2, 0.5)

    def mean(self, name: str) -> float:
        values, weight = self._weighed(name)
        return float(weight @ values)

    def sd(self, name: str) -> float:
        values, weight = self._weighed(name)
        return float(np.sqrt(weight @ (values - weight @ values) ** 2))

    def quantile(self, name: str, probability: ArrayLike) -> Array:
        return weighted_quantiles(*self._weighed(name), probability)

    def score_curve(self) -> tuple[Array, Array]:
        return fraction_curve(self.model, self.reproducible_draws().thinned(400))

    def mode(self) -> dict[str, float]:
        """The best place of many about the best, nearer and nearer."""
        rng = np.random.default_rng(0)
        density = self.target.log_density
        near = self.weighted.resampled(1000, rng)
        covariance = np.cov(near.T) if near.size else np.zeros((0, 0))
        root = np.linalg.cholesky(covariance + 1e-8 * np.eye(near.shape[1]))
        best = near.mean(axis=0)
        for scale in 0.7 ** np.arange(16):
            near = best + scale * rng.standard_normal((200, best.size)) @ root.T
            places = np.concatenate([best[None], near])
            best = places[int(np.argmax(density(places)))]
        named = self.target.parameters(best[None]).named(self.model)
        return {name: float(value[0]) for name, value in named.items()}

    def draws(self) -> Draws:
        return self._draws

    def reproducible_draws(self) -> Draws:
        return self._reproducible_draws

    @cached_property
    def _draws(self) -> Draws:
        return self._resampled(self.seed)

    @cached_property
    def _reproducible_draws(self) -> Draws:
        return self._draws if self.seed == 0 else self._resampled(0)

    def _resampled(self, seed: int) -> Draws:
        rng = np.random.default_rng(seed)
        return self.target.parameters(self.weighted.resampled(RESAMPLED, rng))
