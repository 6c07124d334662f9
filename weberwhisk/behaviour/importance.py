"""Weighted draws from a posterior of many parameters, where a grid would be too large.

Adaptive importance sampling (Cappé et al. 2004; Bugallo et al. 2017): Student t's are fitted to
weighted draws again and again, the posterior first taken to a power below 1, so that no mode is
lost between the prior and where it was fitted last. In the normal scores of the priors a posterior
has lighter tails than any Student t, so that its weights are bounded. One t stands for each quarter
of the Weber fractions: at small ones a bias in sds is wide and lapses are many, at large ones few.
All draws of a pass are one call: an ensemble of walkers would need thousands, one after another.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.special import logsumexp
from scipy.stats import multivariate_t

from .._util.refusals import Refusal
from .._util.values import Array, Index
from .axes import log_lapses_possible
from .likelihood import Draws, WeberModel
from .posteriors import SampledPosterior, split

__all__ = ["ImportancePosterior", "Target", "WeightedDraws", "weighted_draws"]

PASS = 2000  # vectors of a call, and draws of a pass; a quarter of these must count
KEPT = 8000  # draws that stay, and independent ones that the weighted are to be worth


class WeightedDraws(NamedTuple):
    """Draws (N, D), their weights (N,) of sum 1, the log of the evidence, and how many independent
    draws they are worth, 1/Σw²."""

    values: Array
    weights: Array
    log_evidence: float
    effective: float

    def resampled(self, size: int, rng: np.random.Generator) -> Array:
        """Draws of equal weight, (size, D), in random order (systematic resampling)."""
        at = (np.arange(size) + rng.random()) / size
        place = np.searchsorted(np.cumsum(self.weights), at).clip(max=len(self.weights) - 1)
        return np.asarray(rng.permutation(self.values[place]))


def weighted_draws(
    log_density: Callable[[Array], Array],
    mean: Array,
    sd: Array,
    rng: np.random.Generator,
    *,
    wanted: float = KEPT,
    most: int = 100_000,
    size: int = PASS,
) -> WeightedDraws:
    """Draws worth `wanted` independent ones, if `most` in one round can be.

    Parameters
    ----------
    log_density : callable
        Of places (N, D), (N,), normalised where the evidence is to be; −∞ is impossible.
    mean, sd : ndarray, shape (D,)
        Where to begin: those of the prior.
    rng : Generator
    wanted, most, size : int
        `size` is that of a pass while the proposal is fitted.
    """
    parts = [(mean, np.diag(sd**2))]
    for _ in range(30):
        values, log_weight, power = _drawn(log_density, parts, size, rng, size / 4)
        parts = _fitted(values, power * log_weight)
        if power == 1.0:
            break
    count = 2 * size
    for _ in range(8):  # now the posterior itself
        values, log_weight, _ = _drawn(log_density, parts, count, rng, 0.0)
        effective = _effective(log_weight)
        if effective >= wanted:
            break
        count = int(np.clip(1.3 * count * wanted / effective, count, most))
        parts = _fitted(values, log_weight)
    evidence = float(logsumexp(log_weight) - np.log(len(values)))
    return WeightedDraws(values, _weights(log_weight), evidence, effective)


def _drawn(
    log_density: Callable[[Array], Array],
    parts: list[tuple[Array, Array]],
    count: int,
    rng: np.random.Generator,
    least: float,
) -> tuple[Array, Array, float]:
    """Draws from as many of each Student t, their log weights, and the power under which `least`
    count."""
    each = [multivariate_t(centre, spread, df=6, seed=rng) for centre, spread in parts]
    drawn = [t.rvs(-(-count // len(each))).reshape(-1, parts[0][0].size) for t in each]
    values = np.concatenate(drawn)
    proposed = logsumexp([t.logpdf(values) for t in each], axis=0) - np.log(len(each))
    log_weight = log_density(values) - proposed
    below, power = 0.0, 1.0
    if _effective(log_weight) < least:
        for _ in range(30):
            middle = 0.5 * (below + power)
            if _effective(middle * log_weight) < least:
                power = middle
            else:
                below = middle
        power = max(below, 1e-9)  # most draws may be impossible
    return values, log_weight, power


def _weights(log_weight: Array) -> Array:
    weight = np.exp(log_weight - log_weight.max())
    return np.asarray(weight / weight.sum())


def _effective(log_weight: Array) -> float:
    return float(1 / np.square(_weights(log_weight)).sum())


def _fitted(values: Array, log_weight: Array) -> list[tuple[Array, Array]]:
    """Weighted means and covariances of the quarters of the first coordinate, or of all draws where
    a quarter of them would be few for a covariance."""
    weight, dim = _weights(log_weight), values.shape[1]
    few = _effective(log_weight) < 4 * 20 * dim
    rise = np.cumsum(weight[np.argsort(values[:, 0])])[np.argsort(np.argsort(values[:, 0]))]
    quarter = np.zeros(len(values)) if few else np.minimum(np.floor(4 * rise), 3)
    out = []
    for part in range(1 if few else 4):
        own = weight * (quarter == part)
        mean = own @ values / own.sum()
        off = values - mean
        # Few draws may all lie in one plane.
        out.append((mean, (off.T * own) @ off / own.sum() + 1e-8 * np.eye(dim)))
    return out


@dataclass(frozen=True)
class ImportancePosterior(SampledPosterior):
    """Draws resampled from weighted ones; `best` is the most probable place found."""

    best: Draws = field(kw_only=True, repr=False)

    def mode(self) -> dict[str, float]:
        return {name: float(value[0]) for name, value in self.best.named(self.model).items()}


@dataclass(frozen=True)
class Target:
    """A posterior over vectors: free lead scores of an observer, its biases, and scores of `more`
    parameters, of which `draws_of` makes draws (an observer's own by default)."""

    model: WeberModel
    more: int = 0
    draws_of: Callable[[Array], Draws] | None = None
    log_likelihood: Callable[[Draws], Array] | None = None

    def made(self, theta: Array) -> Draws:
        """Every parameter at vectors (N, D)."""
        if self.draws_of is not None:
            return self.draws_of(theta)
        return self.model.draws_at(*split(self.model, theta))

    @cached_property
    def start(self) -> tuple[Array, Array]:
        """Mean and sd of a vector under the prior."""
        lead, model = sum(self.model.free), self.model
        biases = model.n_groups if model.free_bias else 0
        mean, sd = np.zeros(lead + biases + self.more), np.ones(lead + biases + self.more)
        if biases:
            mean[lead : lead + biases], sd[lead : lead + biases] = model.priors.moments("bias")
        return mean, sd

    @cached_property
    def _prior(self) -> tuple[Index, Array, float]:
        """Which entries are scores, their precision, and the log density at zero."""
        lead = sum(self.model.free)
        scores = np.r_[0:lead, self.start[0].size - self.more : self.start[0].size]
        precision = np.eye(scores.size)
        precision[:lead, :lead] = self.model.score_precision
        at_zero = 0.5 * np.linalg.slogdet(precision)[1] - 0.5 * scores.size * np.log(2 * np.pi)
        return scores, precision, at_zero - log_lapses_possible(self.model.task, self.model.priors)

    def log_density(self, theta: Array) -> Array:
        """Log of prior times likelihood, (N,), normalised as the evidence wants it."""
        scores, precision, at_zero = self._prior
        out = np.empty(len(theta))
        for rows in (slice(i, i + PASS) for i in range(0, len(theta), PASS)):
            draws, x = self.made(theta[rows]), theta[rows][:, scores]
            prior = at_zero - 0.5 * np.einsum("ni,ij,nj->n", x, precision, x)
            prior += self.model.log_bias_prior(draws.bias).sum(axis=-1)
            possible = sum(self.model.lapses(draws.lapse_low, draws.lapse_high)) < 1
            if self.log_likelihood is None:
                like = self.model.log_likelihood(*draws.values)
            else:
                like = self.log_likelihood(draws)
            out[rows] = np.where(possible, prior + like, -np.inf)
        return out

    def posterior(self, rng: np.random.Generator) -> ImportancePosterior:
        """Draws of it, with its evidence."""
        if not self.start[0].size:
            raise Refusal(
                "every parameter is fixed", remedy="leave at least one of them a distribution"
            )
        found = weighted_draws(self.log_density, *self.start, rng)
        error = found.effective**-0.5
        trouble = f"its draws are worth only {found.effective:.0f} independent ones"
        draws = found.resampled(KEPT, rng)
        best = self.made(_climbed(self.log_density, draws, rng)[None])
        return ImportancePosterior(
            self.model, self.made(draws), 4, error, trouble if error > 0.03 else "",
            found.log_evidence, best=best,
        )  # fmt: skip


def _climbed(
    log_density: Callable[[Array], Array], draws: Array, rng: np.random.Generator
) -> Array:
    """The best place of many about the best, nearer and nearer."""
    root = np.linalg.cholesky(np.cov(draws.T) + 1e-8 * np.eye(draws.shape[1]))
    best = draws.mean(axis=0)
    for scale in 0.7 ** np.arange(16):
        near = best + scale * rng.standard_normal((200, best.size)) @ root.T
        places = np.concatenate([best[None], near])
        best = places[int(np.argmax(log_density(places)))]
    return np.asarray(best)
