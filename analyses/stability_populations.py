"""The part of `stability.py` that hunts in fits of populations.

The reference draws populations from what is believed beforehand, and animals from each of them, and
weighs them by their answers: no grid, no conditional modes, no tables. The likelihood is written
anew. Judged are the ends of the 95 % interval and the median of the population's Weber fraction, of
the spread, and of each animal's own.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pandas as pd
from hunting import Axis, Domain, Fate, Judged
from scipy import stats
from scipy.special import logsumexp, ndtr, ndtri, xlogy

from weberwhisk.behaviour import fit_population, read_trials

Array = np.ndarray
Case = dict[str, Array]

AXES = {
    "weber_fraction": Axis(0.01, 1.0, log=True, special=(0.1,)),
    "spread": Axis(0.0, 1.5, special=(0.0, 0.3)),
    "lapse": Axis(0.0, 0.3, special=(0.02,)),
    "bias": Axis(-1.5, 1.5, special=(0.0,)),
    "animals": Axis(1.0, 5.0),
    "trials": Axis(1.0, 30.0, log=True),
    "span": Axis(0.05, 0.9, log=True),
    "answers": Axis(0.0, 1.0, special=(0.5,)),
}
LEVELS = 5
ENDS = np.array([0.025, 0.5, 0.975])
#: Populations drawn, and animals of each that stand for one.
POPULATIONS, ANIMALS = 2**15, 64
#: Error allowed, in posterior sds; populations that must count for the reference to judge; sds that
#: a quantile of so many is known to.
ERROR, ENOUGH, SURE = 0.08, 1500, 5.0


def tables(case: Case, i: int) -> list[tuple[Array, int, Array]]:
    """Comparisons against 1, trials of each and answers of every animal: quantiles all through."""
    count, n = round(float(case["animals"][i])), round(float(case["trials"][i]))
    levels = 1 + np.linspace(-1, 1, LEVELS) * case["span"][i]
    z = ndtri((np.arange(count) + 0.5) / count)
    out = []
    for j in range(count):
        k = case["weber_fraction"][i] * np.exp(case["spread"][i] * z[j])
        lapse = case["lapse"][i] * (j + 1) / count
        drive = (levels - 1) / (k * np.hypot(levels, 1)) + case["bias"][i] * np.cos(7.0 * j)
        p = lapse + (1 - 2 * lapse) * ndtr(drive)
        u = (case["answers"][i] + 0.6180339887498949 * (np.arange(LEVELS) + LEVELS * j)) % 1
        out.append((levels, n, stats.binom.ppf(np.clip(u, 1e-6, 1 - 1e-6), n, p)))
    return out


@cache
def _drawn() -> tuple[Array, Array, Array, Array]:
    """Populations as believed: middle of ln k, spread, middle and spread of the lapses' scores."""
    z = ndtri(stats.qmc.Sobol(4, seed=2).random(POPULATIONS)).T
    spread = 0.5 * np.abs(z[1])
    return np.log(0.1) + np.log(3.0) * z[0], spread, z[2], 0.7 * np.exp(0.5 * z[3])


@cache
def _lapses() -> tuple[Array, Array]:
    score = np.linspace(-9.0, 9.0, 4001)
    return score, stats.beta(0.3, 3).ppf(ndtr(score))


def weighed(animals: list[tuple[Array, int, Array]]) -> tuple[Array, Array, Array, float]:
    """Quantiles of ln k, of the spread and of each animal's ln k; how many populations count."""
    middle, spread, score, score_spread = _drawn()
    each, total = [], np.zeros(POPULATIONS)
    rng = np.random.default_rng(3)
    for levels, n, answers in animals:
        # The same animals for all, but scrambled: Sobol's, shifted for each population.
        u = stats.qmc.Sobol(4, seed=rng).random(ANIMALS)
        z = ndtri(np.clip((u + rng.random((POPULATIONS, 1, 4))) % 1, 1e-12, 1 - 1e-12))
        log_k = middle[:, None] + spread[:, None] * z[..., 0]
        other = 0.7 * z[..., 1] + np.sqrt(0.51) * z[..., 2]
        low, high = (
            np.interp(score[:, None] + score_spread[:, None] * s, *_lapses())
            for s in (z[..., 1], other)
        )
        log = np.where(low + high < 1, 0.0, -np.inf)
        for drive, hits in zip((levels - 1) / np.hypot(levels, 1), answers, strict=True):
            up = ndtr(drive * np.exp(-log_k) + z[..., 3])
            p = low * (1 - up) + (1 - high) * up
            log += xlogy(hits, np.maximum(p, 1e-300)) + xlogy(n - hits, np.maximum(1 - p, 1e-300))
        own = np.maximum(
            logsumexp(log, axis=1), -1e4
        )  # no animal at all: a population of no weight
        total += own
        each.append((log_k, log, own))
    weight = np.exp(total - total.max())
    weight /= weight.sum()
    found = [_quantiles(values, weight) for values in (middle, spread)]
    of_each = [
        _quantiles(log_k.ravel(), (weight[:, None] * np.exp(log - own[:, None])).ravel())
        for log_k, log, own in each
    ]
    return found[0], found[1], np.array(of_each), float(1 / (weight**2).sum())


def _quantiles(values: Array, weight: Array) -> Array:
    """Those at `ENDS`, and the sd."""
    order = np.argsort(values)
    rise = np.cumsum(weight[order]) - 0.5 * weight[order]
    mean = weight @ values
    return np.append(np.interp(ENDS, rise, values[order]), np.sqrt(weight @ (values - mean) ** 2))


def judge(case: Case) -> Judged:
    """Each population's fit beside the weighed draws."""
    n = case["trials"].size
    fate, excess = np.full(n, Fate.RIGHT), np.full(n, -np.inf)
    seen = {
        key: np.full(n, np.nan) for key in ("error", "of_k", "of_spread", "of_animals", "count")
    }
    status = np.full(n, "", dtype=object)
    for i in range(n):
        animals = tables(case, i)
        frame = pd.concat(
            [
                pd.DataFrame({"subject": f"s{j}", "standard": 1.0, "comparison": levels, "n": count,
                              "n_greater": answers.astype(int)})
                for j, (levels, count, answers) in enumerate(animals)
            ]
        )  # fmt: skip
        fit = fit_population(read_trials(frame))
        status[i] = fit.status.name
        if fit.population is None:
            fate[i] = Fate.REFUSED
            continue
        kept = fit.subjects["weber_fraction"].notna().to_numpy()
        k, spread, each, counted = weighed(
            [a for a, held in zip(animals, kept, strict=True) if held]
        )
        own = np.log(fit.subjects.loc[kept, ["lower", "weber_fraction", "upper"]].to_numpy())
        parts = {
            "of_k": np.abs(np.log(fit.quantile("weber_fraction", ENDS)) - k[:3]).max() / k[3],
            "of_spread": np.abs(fit.quantile("spread", ENDS) - spread[:3]).max() / spread[3],
            "of_animals": (np.abs(own - each[:, :3]).max(axis=1) / each[:, 3]).max(),
        }
        error = max(parts.values())
        for name, value in {**parts, "error": error, "count": counted}.items():
            seen[name][i] = value
        if counted < ENOUGH:
            fate[i] = Fate.UNJUDGED
            continue
        allowed = ERROR + SURE / np.sqrt(counted)
        excess[i] = np.log(max(error, 1e-300) / allowed)
        fate[i] = Fate.RIGHT if fit.status.ok else Fate.WARNED
        if error > allowed and fit.status.name != "NOT_CONVERGED":
            fate[i] = Fate.SILENT
    return Judged(fate, excess, {**seen, "status": status})


DOMAINS = [Domain("population of animals", AXES, judge)]
