"""How far each belief moves the Weber fraction: priors and likelihood to powers, draws reweighted.

A prior to the power 2 counts twice, to ½ half (power-scaling; Kallioinen et al. 2024, Stat. Comput.
34:57), as the density of its normal scores, which is one to any power. Draws from the posterior are
weighted by what that changes, and drawn anew where few of them would have the weight.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
from scipy import stats

from .._util.campaign import one_blas_thread
from .._util.importance import SobolPoints, adapted_draws
from .._util.refusals import Advice, argument, named
from .._util.values import Array, weighted_quantiles
from .likelihood import Draws, WeberModel
from .posteriors import FreeDensity, WeberPosterior, log_score_density

__all__ = [
    "ANSWERS", "lapse_sensitivity", "moving", "prior_sensitivity", "sentence_of",
    "shifted_distance",
]  # fmt: skip

ANSWERS = "answers"  # the row of the likelihood
TWICE, HALF = 2.0, 0.5
#: A belief that moves the median of ln k or an end of its interval by more posterior sds, counted
#: twice or half, decides; that about lapses, which explain the same errors as k, before others do:
#: `analyses/prior_choice.md`.
DECIDES, LAPSES_DECIDE = 3 / 4, 1 / 2
QUANTILES = 0.5, 0.025, 0.975
#: Sensitivity from which a prior or a likelihood matters, of two together being in conflict.
MATTERS = 0.05
LEAST_EFFECTIVE = 400.0  # draws that weighted ones must be worth


@one_blas_thread
def prior_sensitivity(model: WeberModel, posterior: WeberPosterior) -> pd.DataFrame:
    """How far every belief moves the Weber fraction, a row each, and one of the answers.

    Rows: `weber_fraction`, `lapses` (both together), `bias` or `criterion` (of all standards),
    effects by name, and `answers`, the likelihood. None where the Weber fraction is fixed.

    Returns
    -------
    DataFrame
        Index `belief`. `prior`, in words; `twice` and `half`, the median of k where the belief
        counts so, `lower_…` and `upper_…` its 95 % interval; `change_twice`, `change_half`, of the
        median relative to the fit; `sds`, how far median or ends move at most, in posterior sds of
        ln k; `sensitivity`, that of k by ArviZ's `psense` (`psens` in 0.23);
        `conflict`, whether answers and belief pull k apart, both sensitivities being 0.05 or more;
        `write`, a line that states another belief.
    """
    ends = [f"{name}{power}" for power in ("twice", "half") for name in ("", "lower_", "upper_")]
    columns = ["prior", *ends, "change_twice", "change_half", "sds", "sensitivity", "conflict",
               "write"]  # fmt: skip
    none = pd.DataFrame(columns=columns, index=pd.Index([], name="belief"))
    if "weber_fraction" not in model.names or not model.cells.n.sum():
        return none
    draws = posterior.reproducible_draws()
    log_k = np.log(draws.weber_fraction)
    fitted = np.quantile(log_k, QUANTILES)
    sd = (fitted[2] - fitted[1]) / 3.92
    logs = _log_beliefs(posterior.target, draws)
    matters = {belief: _sensitivity(draws.weber_fraction, log) for belief, log in logs.items()}
    moves = {
        belief: np.array([
            _quantiles(posterior, belief, log_k, (power - 1) * log, power) - fitted
            for power in (TWICE, HALF)
        ])
        for belief, log in logs.items()
    }  # fmt: skip
    rows = {}
    for belief, moved in moves.items():
        both_matter = min(matters[belief], matters[ANSWERS]) >= MATTERS
        conflict = bool(both_matter and moved[0, 0] * moves[ANSWERS][0, 0] < 0)
        rows[belief] = [
            _in_words(model, belief), *np.exp(fitted + moved).ravel(), *np.expm1(moved[:, 0]),
            float(np.abs(moved).max() / sd), matters[belief], conflict,
            _to_write(model, belief, conflict),
        ]  # fmt: skip
    table = pd.DataFrame.from_dict(rows, orient="index", columns=columns)
    return table.rename_axis("belief")


@one_blas_thread
def lapse_sensitivity(model: WeberModel, posterior: WeberPosterior) -> pd.DataFrame:
    """Median and 95 % interval of k with other lapse priors than those of the fit.

    Lapses and a poor Weber fraction explain the same errors, so the belief about lapses moves k, by
    less the more easy trials there are. Rows `lapses`: "as fitted", "never", "seldom" (Beta(1, 20))
    and "often" (Beta(1, 9)), the first alone where the Weber fraction is fixed, the task has no
    free lapse, or the fit is by emcee or with states; `log_bayes_factor` is that of each belief
    against the fit's, and `change` is relative to the fit.
    """
    levels = [0.5, 0.025, 0.975]
    fitted = list(posterior.quantile("weber_fraction", levels))
    rows = [("as fitted", *fitted, 0.0)]
    free = [n for n in model.task.lapses if n in model.names]
    if free and "weber_fraction" in model.names:
        beliefs = {"never": 0.0, "seldom": stats.beta(1.0, 20.0), "often": stats.beta(1.0, 9.0)}
        for words, belief in beliefs.items():
            changed: dict[str, Any] = dict.fromkeys(free, belief)
            priors = replace(model.priors, **changed)
            under = posterior.recomputed(replace(model, priors=priors).merged())
            if under is None or under.log_evidence is None or posterior.log_evidence is None:
                break
            factor = under.log_evidence - posterior.log_evidence
            rows.append((words, *under.quantile("weber_fraction", levels), factor))
    columns = ["lapses", "weber_fraction", "lower", "upper", "log_bayes_factor"]
    table = pd.DataFrame(rows, columns=columns)
    table["change"] = table["weber_fraction"] / fitted[0] - 1
    return table


def moving(table: pd.DataFrame) -> pd.DataFrame:
    """The beliefs that decide the Weber fraction, the one that moves it most first."""
    of_beliefs = table.drop(index=ANSWERS, errors="ignore")
    least = np.where(of_beliefs.index == "lapses", LAPSES_DECIDE, DECIDES)
    return of_beliefs[of_beliefs["sds"] > least].sort_values("sds", ascending=False)


def sentence_of(belief: str, row: pd.Series) -> Advice:
    """How far a belief moves k, and what to write."""
    about = {"weber_fraction": "the Weber fraction itself", "lapses": "lapses"}.get(
        belief, f"the {belief.replace('_', ' ')}"
    )
    against = " The answers pull it the other way." if row["conflict"] else ""
    said = [
        f"by {100 * row[f'change_{power}']:+.2g} % ({row[f'lower_{power}']:.2g} to "
        f"{row[f'upper_{power}']:.2g}) where {words} {power}"
        for power, words in (("twice", "the belief counts"), ("half", "it counts"))
    ]
    return (
        f"What is believed about {about}, {row['prior']}, moves the Weber fraction: "
        f"{', '.join(said)}.{against} State what you know of it, " + row["write"] + ", say."
    )


def _log_beliefs(target: FreeDensity, draws: Draws) -> dict[str, Array]:
    """Log density of each prior, on normal scores, and of the answers, at draws (N,)."""
    return {**log_score_density(target.model, draws), ANSWERS: target.log_likelihood(draws)}


def _quantiles(
    posterior: WeberPosterior, belief: str, log_k: Array, log_weight: Array, power: float
) -> Array:
    """Median and interval of ln k with a belief to a power, from weighted draws or, where these are
    worth too few, from others."""
    weight = _weights(log_weight)
    if 1 / np.square(weight).sum() >= LEAST_EFFECTIVE:
        return weighted_quantiles(log_k, weight, QUANTILES)
    target = posterior.target

    def log_density(theta: Array) -> Array:
        log = _log_beliefs(target, target.parameters(theta))[belief]
        return np.asarray(target.log_density(theta) + (power - 1) * log)

    mean, sd = target.start
    points = SobolPoints(mean.size + 1, seed=0)
    drawn = adapted_draws(log_density, mean, sd, points, effective=5 * LEAST_EFFECTIVE)
    k = target.parameters(drawn.values).weber_fraction
    return np.log(weighted_quantiles(k, drawn.weights, QUANTILES))


def _weights(log_weight: Array) -> Array:
    weight = np.exp(log_weight - log_weight.max())
    return np.asarray(weight / weight.sum())


def _sensitivity(values: Array, log: Array, delta: float = 0.01) -> float:
    """How fast the distribution of values moves with log2 of the power (Kallioinen et al. 2024)."""
    powers = 1 / (1 + delta), 1 + delta
    moved = [shifted_distance(values, _weights((power - 1) * log)) for power in powers]
    return float(sum(moved) / (2 * np.log2(1 + delta)))


def shifted_distance(values: Array, weight: Array) -> float:
    """Cumulative Jensen-Shannon distance between draws and the same draws weighted.

    The larger of that of the values and of their negatives, as in ArviZ (Nguyen & Vreeken 2015).
    """
    return max(_distance(values, weight), _distance(-values, weight))


def _distance(values: Array, weight: Array) -> float:
    order = np.argsort(values)
    width = np.diff(values[order])
    p = np.linspace(1 / values.size, 1 - 1 / values.size, values.size - 1)
    q = np.clip(np.cumsum(weight[order])[:-1], 0.0, 1.0)
    middle = 0.5 * (p + q)

    def from_middle(a: Array, b: Array) -> float:
        ratio = np.divide(a, middle, out=np.ones_like(a), where=a > 0)
        return float(width @ (a * np.log2(ratio)) + 0.5 / np.log(2) * (width @ (b - a)))

    bound = float(width @ (p + q))
    both = from_middle(p, q) + from_middle(q, p)
    return float(np.sqrt(max(both, 0.0) / bound)) if bound > 0 else 0.0


def _in_words(model: WeberModel, belief: str) -> str:
    if belief == ANSWERS:
        return ""
    if belief == "lapses":
        free = [name for name in model.task.lapses if name in model.names]
        words = dict.fromkeys(model.priors.words(name) for name in free)
        return " and ".join(words)
    return model.priors.words(belief)


def _to_write(model: WeberModel, belief: str, conflict: bool) -> Advice | str:
    """Another belief: a wide one against which nothing speaks, known lapses where they are few."""
    if belief == ANSWERS:
        return ""
    if belief == "weber_fraction":
        return argument("priors", {belief: stats.lognorm(2, scale=0.1)})
    if belief == "lapses":
        free = [name for name in model.task.lapses if name in model.names]
        return argument("priors", dict.fromkeys(free, stats.beta(1, 4) if conflict else 0.02))
    if belief == model.task.bias_name:
        wide: Any = stats.norm(0, 5)
        if model.task.name == "same-different":
            wide = stats.lognorm(1.5, scale=2)
        return argument("priors", {belief: wide})
    prior = model.priors.of(belief)
    if prior.dist.name == "norm":
        return argument("priors", {belief: stats.norm(0, float(f"{2 * prior.std():.2g}"))})
    return named("priors")
