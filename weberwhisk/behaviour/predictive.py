"""What the model says the data should look like, before they are seen and after."""

from __future__ import annotations

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from .likelihood import Draws, WeberModel
from .mode import lead_values

Array = NDArray[np.float64]


def prior_draws(model: WeberModel, size: int, rng: np.random.Generator) -> Draws:
    """Joint draws from the prior of a model."""
    free = np.array(model.free)
    kept: list[Array] = []
    while sum(map(len, kept)) < size:
        z = rng.standard_normal((size, free.size)) * free
        if free[-2:].all():
            rho = model.priors.lapse_correlation
            z[:, -1] = rho * z[:, -2] + np.sqrt(1 - rho**2) * z[:, -1]
        k, effects, low, high = lead_values(model, z)
        kept.append(z[sum(model.lapses(low, high)) < 1])
    k, effects, low, high = lead_values(model, np.concatenate(kept)[:size])
    if model.free_bias:
        uniform = rng.random((size, model.n_groups))
        bias = np.asarray(model.priors.of("bias").ppf(uniform))
    else:
        bias = np.full((size, model.n_groups), model.fixed_bias())
    return Draws(k, low, high, bias, effects)


def predicted(model: WeberModel, draws: Draws, rng: np.random.Generator) -> pd.DataFrame:
    """Observed proportions beside those that observers with these parameters would give.

    Returns
    -------
    DataFrame
        A row a cell: `standard`, `stimulus_1`, `stimulus_2`, `n`, `observed`, `median`, `lower`,
        `upper` (95 % of replicated data), and `inside`.
    """
    c = model.cells
    n = np.maximum(c.n, 1)
    low, median, high = np.quantile(model.simulate(draws, rng) / n, [0.025, 0.5, 0.975], axis=0)
    observed = c.count / n
    return pd.DataFrame(
        {
            "standard": c.standard,
            "stimulus_1": c.stimulus_1,
            "stimulus_2": c.stimulus_2,
            "n": c.n.astype(int),
            "observed": observed,
            "median": median,
            "lower": low,
            "upper": high,
            "inside": (low <= observed) & (observed <= high),
        }
    )
