"""Where a fitted observer misses the data."""

from __future__ import annotations

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from .likelihood import WeberModel
from .posteriors import Draws

Array = NDArray[np.float64]

REPEATS = 1000  # draws that a check is averaged over


def residuals(model: WeberModel, draws: Draws) -> pd.DataFrame:
    """Observed and expected proportions by pair of stimuli.

    Returns
    -------
    DataFrame
        `standard`, `stimulus_1`, `stimulus_2`, `n`, `observed`, `expected` (posterior mean) and
        `z`: their difference in binomial standard errors.
    """
    c = model.cells
    expected = _probability(model, draws)[0].mean(axis=0)
    se = np.sqrt(expected * (1 - expected) / c.n)
    off = c.count / c.n - expected
    return pd.DataFrame(
        {
            "standard": c.standard,
            "stimulus_1": c.stimulus_1,
            "stimulus_2": c.stimulus_2,
            "n": c.n.astype(int),
            "observed": c.count / c.n,
            "expected": expected,
            # Where the model is certain and the data agree there is nothing off.
            "z": np.divide(off, se, out=np.zeros_like(off), where=se > 0),
        }
    )


def misfit(model: WeberModel, draws: Draws) -> float:
    """Posterior-predictive p of Σ (count − n P)²/(n P (1 − P)) over pairs of stimuli.

    The share of draws whose own replicated data lie as far from the curve as the data do; near 0
    the curve misses them. Repeatable: the replications have a seed of their own.
    """
    c = model.cells
    if not c.n.size:
        return 1.0
    p, q = _probability(model, draws)
    again = np.random.default_rng(0).binomial(c.n.astype(np.int64), np.clip(p, 0, 1))
    spread = c.n * p * q

    def distance(count: Array) -> Array:
        square = (count - c.n * p) ** 2
        return np.divide(square, spread, out=np.zeros_like(spread), where=spread > 0).sum(axis=1)

    return float(np.mean(distance(again.astype(float)) >= distance(c.count)))


def _probability(model: WeberModel, draws: Draws) -> tuple[Array, Array]:
    """P and 1 − P of every pair at a thinned set of draws, (REPEATS, C)."""
    thin = slice(None, None, max(draws.weber_fraction.size // REPEATS, 1))
    return model.probability(
        draws.weber_fraction[thin], draws.lapse_low[thin], draws.lapse_high[thin], draws.bias[thin]
    )
