"""Data that an observer would give, from its prior or posterior, beside those that it gave."""

from __future__ import annotations

import numpy as np
import pandas as pd

from .._util.values import Array
from .likelihood import Draws, WeberModel
from .trials import STIMULI

__all__ = ["compared", "misfit", "predicted", "prior_draws", "residuals"]


def residuals(model: WeberModel, draws: Draws) -> pd.DataFrame:
    """Observed and expected proportions by pair of stimuli.

    `standard`, `stimulus_1`, `stimulus_2`, `n`, `observed`, `expected` (posterior mean) and `z`,
    their difference in binomial standard errors.
    """
    c = model.cells
    expected = model.probability(*draws.thinned(1000).values)[0].mean(axis=0)
    labels = {name: getattr(c, name) for name in STIMULI}
    return pd.DataFrame(labels | compared(c.n, c.count, c.n * expected, expected * (1 - expected)))


def misfit(model: WeberModel, draws: Draws) -> float:
    """Posterior-predictive p of Σ (count − n P)²/(n P (1 − P)) over pairs of stimuli: the share of
    draws whose own replicated data lie as far from the curve as the data do."""
    c = model.cells
    if not c.n.size:
        return 1.0
    few = draws.thinned(1000)
    p, q = model.probability(*few.values)
    again = model.simulate(few, np.random.default_rng(0))
    spread = c.n * p * q

    def distance(count: Array) -> Array:
        square = (count - c.n * p) ** 2
        return np.divide(square, spread, out=np.zeros_like(spread), where=spread > 0).sum(axis=1)

    return float(np.mean(distance(again) >= distance(c.count)))


def prior_draws(model: WeberModel, size: int, rng: np.random.Generator) -> Draws:
    """Joint draws from the prior of a model."""
    free = np.array(model.free)
    kept: list[Array] = []
    while sum(map(len, kept)) < size:
        z = rng.standard_normal((size, free.size)) * free
        if free[-2:].all():
            rho = model.priors.lapse_correlation
            z[:, -1] = rho * z[:, -2] + np.sqrt(1 - rho**2) * z[:, -1]
        *_, low, high = model.at_scores(z)
        kept.append(z[sum(model.lapses(low, high)) < 1])
    if model.free_bias:
        uniform = rng.random((size, model.n_groups))
        bias = np.asarray(model.priors.of("bias").ppf(uniform))
    else:
        bias = np.full((size, model.n_groups), model.fixed_bias())
    return model.draws_at(np.concatenate(kept)[:size], bias)


def predicted(model: WeberModel, draws: Draws, rng: np.random.Generator) -> pd.DataFrame:
    """Observed proportions beside those that observers with these parameters would give.

    A row a cell: `standard`, `stimulus_1`, `stimulus_2`, `n`, `observed`, `median`, `lower`,
    `upper` (95 % of replicated data), and `inside`.
    """
    c = model.cells
    n = np.maximum(c.n, 1)
    low, median, high = np.quantile(model.simulate(draws, rng) / n, [0.025, 0.5, 0.975], axis=0)
    observed = c.count / n
    return pd.DataFrame({name: getattr(c, name) for name in STIMULI}).assign(
        n=c.n.astype(int), observed=observed, median=median, lower=low, upper=high,
        inside=(low <= observed) & (observed <= high),
    )  # fmt: skip


def compared(n: Array, count: Array, mean: Array, spread: Array) -> dict[str, Array]:
    """`spread` is that of one trial: n times it is the variance of the count."""
    se = np.sqrt(n * spread)
    off = count - mean
    return {
        "n": n.astype(int),
        "observed": count / n,
        "expected": mean / n,
        # Where the model is certain and the data agree there is nothing off.
        "z": np.divide(off, se, out=np.zeros_like(off), where=se > 0),
    }
