"""How far each belief moves a population's median: hyperpriors to powers, draws reweighted.

A prior to the power 2 counts twice, to ½ half (power-scaling; Kallioinen et al. 2024), as the
density of its normal scores, which is one to any power.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from .._util.refusals import Advice, argument
from .._util.values import Array, weighted_quantiles
from .hierarchy import LAPSES, Hierarchy
from .population import Population
from .prior_sensitivity import HALF, QUANTILES, TWICE

__all__ = ["DECIDES", "belief_sensitivity", "belief_sentence"]

#: A belief that moves the median of ln k or an end of its interval by more posterior sds, counted
#: twice or half, decides.
DECIDES = 0.3


def belief_sensitivity(population: Population) -> pd.DataFrame:
    """How far every belief moves the population's median Weber fraction, a row each.

    Index `belief`: a parameter of the population, both lapses together. Columns: `prior`, in words;
    `twice` and `half`, the median of k where the belief counts so; `change_twice`, `change_half`,
    relative to the fit; and `sds`, how far median or ends of the interval of ln k move at most, in
    its posterior sds.
    """
    hierarchy, draws = population.hierarchy, population.draws
    log_k = np.log(population.values["weber_fraction"])
    fitted = weighted_quantiles(log_k, draws.weights, QUANTILES)
    sd = (fitted[2] - fitted[1]) / 3.92
    rows = {}
    for belief, log in _log_beliefs(hierarchy, draws.values).items():
        moved = []
        for power in (TWICE, HALF):
            log_weight = (power - 1) * log
            weight = draws.weights * np.exp(log_weight - log_weight.max())
            moved.append(weighted_quantiles(log_k, weight, QUANTILES) - fitted)
        names = LAPSES if belief == "lapses" else (belief,)
        rows[belief] = [
            " and ".join(dict.fromkeys(hierarchy.prior_in_words(name) for name in names)),
            *(float(np.exp(fitted[0] + m[0])) for m in moved),
            *(float(np.expm1(m[0])) for m in moved),
            float(np.abs(moved).max() / sd),
        ]
    columns = ["prior", "twice", "half", "change_twice", "change_half", "sds"]
    table = pd.DataFrame.from_dict(rows, orient="index", columns=columns)
    return table.rename_axis("belief")


def _log_beliefs(hierarchy: Hierarchy, scores: Array) -> dict[str, Array]:
    """Log density of each hyperprior at scores (M, D + S), but for a constant."""
    out: dict[str, Array] = {}
    both = hierarchy.lapses
    for i, name in enumerate((*hierarchy.names, *hierarchy.spread_names)):
        if both and i in both:
            pair, rho = scores[:, list(both)], hierarchy.correlation
            square = (pair**2).sum(axis=1) - 2 * rho * pair.prod(axis=1)
            out["lapses"] = -0.5 * square / (1 - rho**2)
        else:
            out[name] = -0.5 * scores[:, i] ** 2
    return out


def belief_sentence(belief: str, row: pd.Series) -> Advice:
    """How far a belief moves the median, and what to write."""
    about = {"weber_fraction": "the median Weber fraction itself", "lapses": "lapses"}.get(
        belief, f"the {belief.replace('_', ' ')}"
    )
    said = (
        f"What is believed about {about}, {row['prior']}, moves the population's median: by "
        f"{100 * row['change_twice']:+.2g} % where it counts twice, and by "
        f"{100 * row['change_half']:+.2g} % where it counts half. State what you know of it, "
    )
    if belief.endswith("spread"):
        return said + argument("spread_prior", {belief: ...}) + "."
    written = {"lapse_low": 0.02, "lapse_high": 0.02} if belief == "lapses" else {belief: ...}
    return said + argument("priors", written) + ", say."
