"""How far the answer hangs on what is believed about lapses."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pandas as pd
from scipy import stats

from ..threads import one_blas_thread
from .integrate import refined
from .likelihood import WeberModel
from .posteriors import GridPosterior, WeberPosterior

# What one might believe instead: an animal that never lapses, seldom, or often.
BELIEFS = {"never": 0.0, "seldom": stats.beta(1.0, 20.0), "often": stats.beta(1.0, 9.0)}


@one_blas_thread
def lapse_sensitivity(model: WeberModel, posterior: WeberPosterior) -> pd.DataFrame:
    """Median and 95 % interval of k with other lapse priors than those of the fit.

    Lapses and a poor Weber fraction explain the same errors, so the belief about lapses moves k, by
    less the more easy trials there are.

    Returns
    -------
    DataFrame
        `lapses` ("as fitted", "never", "seldom": Beta(1, 20), "often": Beta(1, 9)),
        `weber_fraction`, `lower`, `upper`, `change` (relative to the fit). Only the fit's own row
        where the Weber fraction is fixed, the task has no free lapse, or emcee was needed.
    """
    own = list(posterior.quantile("weber_fraction", [0.5, 0.025, 0.975]))
    rows = [("as fitted", *own)]
    free = [n for n in model.lapse_names if n in model.names]
    if free and "weber_fraction" in model.names and isinstance(posterior, GridPosterior):
        for words, belief in BELIEFS.items():
            changed: dict[str, Any] = dict.fromkeys(free, belief)
            priors = replace(model.priors, **changed)
            other = replace(model, priors=priors).merged()
            grid = GridPosterior(other, refined(other), 0)
            rows.append((words, *grid.quantile("weber_fraction", [0.5, 0.025, 0.975])))
    table = pd.DataFrame(rows, columns=["lapses", "weber_fraction", "lower", "upper"])
    table["change"] = table["weber_fraction"] / own[0] - 1
    return table
