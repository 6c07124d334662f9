"""The ratio of the Weber fractions in two conditions, the same for all who answer.

Each of them has a k of its own, biases and lapses of each condition of their own; ln k differs
between the conditions by one δ, whose posterior is a sum over everything else. Power analyses and
the analysis of a plan both come here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from scipy.interpolate import CubicSpline
from scipy.stats import norm

from .._util.campaign import one_blas_thread
from .._util.values import Array, Fields, density_quantiles, interval_text
from ..behaviour.bulk import log_sum, marginal
from ..behaviour.trials import Trials
from .hypotheses import Hypothesis, SubjectPopulation
from .scheme import Scheme

__all__ = ["Ratio", "contrast_experiments", "ratio_of"]

#: What is believed of δ: a factor of 2.7 either way is one sd.
PRIOR = norm(0.0, 1.0)
#: δ is looked for as far, and δ and ln k in such steps: logarithms are interpolated between them.
REACH, STEP = 2.5, 0.04
QUANTILES = (0.5, 0.025, 0.975)


@dataclass(frozen=True, repr=False)
class Ratio(Fields):
    """The Weber fraction in the second condition over that in the first: median, and 95 %."""

    conditions: tuple[str, ...]
    median: float
    lower: float
    upper: float

    def __str__(self) -> str:
        first, second = self.conditions
        said = interval_text(self.median, self.lower, self.upper)
        return f"the Weber fraction in {second} is {said} times that in {first}"


def log_ratio_density(log_like: Array, log_prior: Array) -> tuple[Array, Array]:
    """Even values of δ (M,), and their log posterior density (D, M).

    `log_like` (D, A, 2, K) are log-likelihoods of ln k of A subjects in two conditions on nodes
    `STEP` apart, `log_prior` (2K − 1,) the density, also between the nodes, of ln k halfway between
    the conditions.
    """
    size = log_like.shape[-1]
    most = min(round(REACH / STEP), size // 2 - 1)
    shifts = np.arange(-most, most + 1)
    out = np.empty((len(log_like), shifts.size))
    for i, shift in enumerate(shifts):
        first = slice(max(-shift, 0), size - max(shift, 0))
        second = slice(max(shift, 0), size - max(-shift, 0))
        middle = log_prior[2 * first.start + shift : 2 * first.stop + shift - 1 : 2]
        both = log_like[:, :, 0, first] + log_like[:, :, 1, second] + middle
        out[:, i] = log_sum(both, 2).sum(axis=1)
    delta = shifts * STEP
    return delta, out + PRIOR.logpdf(delta)


def quantiles_of_ratio(delta: Array, log_density: Array) -> Array:
    """Median, 2.5 and 97.5 % of the ratio, (D, 3)."""
    fine = np.linspace(delta[0], delta[-1], 8 * delta.size)
    top = log_density.max(axis=1, keepdims=True)
    density = np.exp(CubicSpline(delta, np.maximum(log_density - top, -60.0).T)(fine).T)
    low, middle, high = density_quantiles(fine, density, sorted(QUANTILES)).T
    return np.exp(np.stack([middle, low, high], axis=-1))


def _on_nodes(hypothesis: Hypothesis) -> tuple[Array, Array]:
    """Even nodes (K,) of ln k over what the prior allows, and the log prior density (2K − 1,) at
    and between them."""
    low, high = np.log(hypothesis.priors.value("weber_fraction", np.array([-4.0, 4.0])))
    x = np.arange(low - 0.5 * REACH, high + 0.5 * REACH, STEP)
    both = np.linspace(x[0], x[-1], 2 * x.size - 1)
    return x, hypothesis.priors.log_density("weber_fraction", np.exp(both)) + both


def _log_like(hypothesis: Hypothesis, cells: Any, counts: Array, x: Array) -> Array:
    """Log-likelihoods (R, K) of ln k at nodes, everything else integrated."""
    model = hypothesis.model(cells)
    scores, log_like = marginal(model, counts)
    log_k = np.log(model.value("weber_fraction", scores))
    top = log_like.max(axis=1, keepdims=True)
    spline = CubicSpline(log_k, np.maximum(log_like - top, -60.0), axis=1)
    inside = spline(np.clip(x, log_k[0], log_k[-1]))
    outside = np.maximum(log_k[0] - x, 0.0) + np.maximum(x - log_k[-1], 0.0)
    return np.asarray(inside - 20.0 * outside)


@one_blas_thread
def ratio_of(
    hypothesis: Hypothesis, trials: Trials, conditions: Sequence[str], without: Sequence[str] = ()
) -> Ratio:
    """The ratio of k in two conditions, from the choices of all subjects but some."""
    x, log_prior = _on_nodes(hypothesis)
    subjects = [s for s in trials.subjects or [None] if str(s) not in without]
    log_like = np.zeros((1, len(subjects), 2, x.size))
    for i, subject in enumerate(subjects):
        for j, condition in enumerate(conditions):
            named: dict[str, Any] = {"condition": condition}
            named |= {} if subject is None else {"subject": subject}
            cells = trials.select(**named).cells()
            log_like[0, i, j] = _log_like(hypothesis, cells, cells.count[None], x)[0]
    ratio = quantiles_of_ratio(*log_ratio_density(log_like, log_prior))[0]
    return Ratio(tuple(conditions), *ratio.tolist())


@one_blas_thread
def contrast_experiments(
    chunk: dict[str, Any], seed: np.random.SeedSequence, scheme: Scheme, hypothesis: Hypothesis,
    animals: SubjectPopulation, ratio: float,
) -> pd.DataFrame:  # fmt: skip
    """Simulated experiments in two conditions between which k has a ratio, a row each.

    The columns of `Power.runs`, where `weber_fraction`, `estimate` and `half_width` are of the
    ratio, with its interval `lower` to `upper`.
    """
    rng, runs = np.random.default_rng(seed), int(chunk["runs"])
    drawn = animals.draw(runs * scheme.animals, np.random.SeedSequence(int(rng.integers(2**63))))
    model = hypothesis.model(scheme)
    bias = np.repeat(
        hypothesis.usual_bias + drawn["bias"].to_numpy(float)[:, None], model.n_groups, axis=1
    )
    k, low, high = (
        drawn[name].to_numpy(float) for name in ("weber_fraction", "lapse_low", "lapse_high")
    )
    x, log_prior = _on_nodes(hypothesis)
    n = scheme.cells().n.astype(np.int64)
    log_like = np.empty((runs, scheme.animals, 2, x.size))
    for j, factor in enumerate((ratio**-0.5, ratio**0.5)):
        p, _ = model.probability(k * factor, low, high, bias)
        counts = rng.binomial(n, np.clip(p, 0.0, 1.0)).astype(float)
        of_all = _log_like(hypothesis, scheme, counts, x)
        log_like[:, :, j] = of_all.reshape(runs, scheme.animals, -1)
    middle, lower, upper = quantiles_of_ratio(*log_ratio_density(log_like, log_prior)).T
    about = {name: chunk[name] for name in ("trials", "animals", "truth")}
    return pd.DataFrame(about | {
        "weber_fraction": ratio, "estimate": middle, "log_bayes_factor": np.inf,
        "half_width": (upper - lower) / (2 * middle), "covers": (lower <= ratio) & (ratio <= upper),
        "lower": lower, "upper": upper,
    })  # fmt: skip
