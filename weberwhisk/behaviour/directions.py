"""Which way an effect would move the answers: directions of residuals to look along.

The score of an effect at nothing, what the other parameters can take up of it removed (weighted
least squares), is the statistic that sees it with the fewest trials.
"""

from __future__ import annotations

import numpy as np

from .._util.values import Array
from .effects import Contraction, Drift, Effect, Exponent, NoiseByOrder, StandardSecond, is_possible
from .estimates import Estimates
from .likelihood import build_model, gather

__all__ = ["LOOKED_FOR", "directions"]

#: Effects that checks look for by their direction; others are seen by statistics of their own.
LOOKED_FOR: tuple[Effect, ...] = (
    Contraction(), Exponent(), NoiseByOrder(), StandardSecond(), Drift(),
)  # fmt: skip
NUDGE = 1e-3


def directions(fit: Estimates) -> dict[str, Array]:
    """By the name of each effect that the table can show, a weight for the residual (count − n P)
    of every row with an answer; their sum has unit variance."""
    model, trials = fit.model, fit.trials
    if model.n_states > 1 or "weber_fraction" not in model.names:
        return {}
    given = trials, fit.encoding, model.encodings, model.cells.n
    effects = [e for e in LOOKED_FOR if e.name not in fit.effects and is_possible(e, *given)]
    if not effects:
        return {}
    whole = (*model.effects, *effects)
    more = build_model(
        trials, fit.encoding, None, fit.bias, fit.noise, model.priors, whole
    )[0]  # fmt: skip
    cell = gather(trials, more.effects, fit.encoding)[2]
    draws = fit.posterior.reproducible_draws()
    means = [np.exp(np.log(draws.weber_fraction).mean()), draws.lapse_low.mean(),
             draws.lapse_high.mean(), *draws.bias.mean(axis=0), *draws.effects.mean(axis=0),
             *(effect.null for effect in effects)]  # fmt: skip
    at, groups = np.array(means), draws.bias.shape[1]
    k_step = np.full(at.size, NUDGE)
    k_step[0] = NUDGE * at[0]
    # One row a parameter: nudged up, and at the value itself.
    nudged = np.concatenate([at + np.diag(k_step), at[None]])
    p, q = more.probability(
        nudged[:, 0], nudged[:, 1], nudged[:, 2], nudged[:, 3 : 3 + groups], nudged[:, 3 + groups :]
    )
    slopes = ((p[:-1] - p[-1]) / k_step[:, None])[:, cell]
    n = trials.frame.loc[trials.answered, "n"].to_numpy(float)
    variance = n * (p[-1] * q[-1])[cell]
    root = np.sqrt(n * n / np.maximum(variance, 1e-12))
    weighted = (slopes * root).T
    nuisance, scores = weighted[:, : -len(effects)], weighted[:, -len(effects) :]
    left = scores - nuisance @ np.linalg.lstsq(nuisance, scores, rcond=1e-6)[0]
    out = {}
    for effect, rest, all_of_it in zip(effects, left.T, scores.T, strict=True):
        size = float(rest @ rest)
        if size > 1e-4 * float(all_of_it @ all_of_it):  # else the rest can do the same
            out[effect.name] = rest * root / n / np.sqrt(size)
    return out
