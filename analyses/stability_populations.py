"""The part of `stability.py` that searches fits of populations.

The reference draws populations from the priors, animals from each of them, and weighs them by their
answers: no grid, no conditional modes, no tables. The likelihood is written anew. Judged are the
ends of the 95 % interval and the median of the population's Weber fraction, of its spread, and of
each animal's Weber fraction.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
import pandas as pd
from fault_search import Axis, Domain, Fate, Judged
from scipy import stats
from scipy.special import expit, logit, logsumexp, ndtr, ndtri, xlogy

from weberwhisk.behaviour import fit_population, read_trials

Array = np.ndarray
Case = dict[str, Array]


class Table(NamedTuple):
    """Of one animal: comparisons against 1, trials of each and answers."""

    levels: Array
    n: int
    answers: Array


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
#: How many populations are weighed at a time.
CHUNK = 2**11
#: Scales of the half-normal priors of spreads; of ln k it is 0.5.
LAPSE_SPREAD, BIAS_SPREAD = 0.76, 0.63
#: Error allowed, in posterior sds; populations that must count for the reference to judge; sds that
#: a quantile of so many is known to.
ERROR, ENOUGH, SURE = 0.25, 1500, 5.0


def tables(case: Case, i: int) -> list[Table]:
    """Answers of every animal: quantiles all through."""
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
        answers = stats.binom.ppf(np.clip(u, 1e-6, 1 - 1e-6), n, p)
        out.append(Table(levels, n, answers))
    return out


@cache
def _drawn(count: int) -> dict[str, Array]:
    """Populations as believed: ln k, two correlated lapses (scores of their prior) and a bias, each
    with its spread."""
    z = ndtri(np.clip(stats.qmc.Sobol(7, seed=2).random(count), 1e-12, 1 - 1e-12)).T
    return {
        "weber_fraction": np.log(0.1) + np.log(3.0) * z[0], "spread": 0.5 * np.abs(z[1]),
        "low": z[2], "high": 0.7 * z[2] + np.sqrt(0.51) * z[3],
        "lapse_spread": LAPSE_SPREAD * np.abs(z[4]), "bias": stats.cauchy(0, 0.7).ppf(ndtr(z[5])),
        "bias_spread": BIAS_SPREAD * np.abs(z[6]),
    }  # fmt: skip


@cache
def _lapses() -> tuple[Array, Array]:
    score = np.linspace(-9.0, 9.0, 4001)
    return score, stats.beta(0.7, 20).ppf(ndtr(score))


def _normals(rng: np.random.Generator, *shape: int) -> Array:
    """Standard normals: Sobol's along the axes but the first and last, shifted for each first."""
    *counts, dim = shape[1:]
    u = stats.qmc.Sobol(dim, seed=rng).random(int(np.prod(counts))).reshape(*counts, dim)
    shift = rng.random((shape[0], *[1] * len(counts), dim))
    return ndtri(np.clip((u + shift) % 1, 1e-12, 1 - 1e-12))


def _log_likelihood(table: Table, log_k: Array, p: dict[str, Array], z: Array) -> Array:
    """ln of the likelihood of a table at ln k (P, A) of animals of populations, whose lapses and
    bias are drawn by z (P, A, 3)."""
    other = 0.7 * z[..., 0] + np.sqrt(0.51) * z[..., 1]
    low, high = (
        expit(logit(np.interp(p[side], *_lapses()))[:, None] + p["lapse_spread"][:, None] * own)
        for side, own in (("low", z[..., 0]), ("high", other))
    )
    bias = p["bias"][:, None] + p["bias_spread"][:, None] * z[..., 2]
    log = np.where(low + high < 1, 0.0, -1e4)  # no animal at all
    drives = (table.levels - 1) / np.hypot(table.levels, 1)
    for drive, hits in zip(drives, table.answers, strict=True):
        up = ndtr(drive * np.exp(-log_k) + bias)
        chance = low * (1 - up) + (1 - high) * up
        log += xlogy(hits, np.maximum(chance, 1e-300))
        log += xlogy(table.n - hits, np.maximum(1 - chance, 1e-300))
    return log


def weighed(found: list[Table]) -> tuple[dict[str, Array], Array, float]:
    """Quantiles of the population's parameters and of ln k of every animal (A, 4); how many
    populations count."""
    drawn = _drawn(POPULATIONS)
    total = np.zeros(POPULATIONS)
    log_ks: list[list[Array]] = [[] for _ in found]
    logs: list[list[Array]] = [[] for _ in found]
    rng = np.random.default_rng(3)
    for start in range(0, POPULATIONS, CHUNK):
        part = slice(start, start + CHUNK)
        p = {name: value[part] for name, value in drawn.items()}
        for a, table in enumerate(found):
            z = _normals(rng, CHUNK, ANIMALS, 4)
            log_k = p["weber_fraction"][:, None] + p["spread"][:, None] * z[..., 3]
            log = _log_likelihood(table, log_k, p, z)
            log_ks[a].append(log_k)
            logs[a].append(log)
            total[part] += logsumexp(log, axis=1)
    weight = np.exp(total - total.max())
    weight /= weight.sum()
    of_population = {name: _quantiles(drawn[name], weight) for name in ("weber_fraction", "spread")}
    each = []
    for log_k, log in zip(log_ks, logs, strict=True):
        of_animal = np.concatenate(log)
        share = np.exp(of_animal - logsumexp(of_animal, axis=1)[:, None])
        each.append(_quantiles(np.concatenate(log_k).ravel(), (weight[:, None] * share).ravel()))
    return of_population, np.array(each), float(1 / (weight**2).sum())


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
    described = ("weber_fraction", "spread")
    names = ("error", *(f"of_{name}" for name in described), "of_each", "count")
    seen = {key: np.full(n, np.nan) for key in names}
    status = np.full(n, "", dtype=object)
    for i in range(n):
        found = tables(case, i)
        frame = pd.concat(
            [
                pd.DataFrame({"subject": f"s{j}", "standard": 1.0, "comparison": t.levels,
                              "n": t.n, "n_greater": t.answers.astype(int)})
                for j, t in enumerate(found)
            ]
        )  # fmt: skip
        fit = fit_population(read_trials(frame), check=False)
        status[i] = fit.status.name
        if fit.population is None:
            fate[i] = Fate.REFUSED
            continue
        kept = fit.subjects["weber_fraction"].notna().to_numpy()
        population, each, counted = weighed(
            [t for t, held in zip(found, kept, strict=True) if held]
        )
        own = np.log(fit.subjects[["lower", "weber_fraction", "upper"]].dropna().to_numpy())
        error = {}
        for name in described:
            value = fit.quantile(name, ENDS)
            value = np.log(value) if name == "weber_fraction" else value
            exact = population[name]
            error[f"of_{name}"] = np.abs(value - exact[:3]).max() / exact[3]
        error["of_each"] = (np.abs(own - each[:, :3]).max(axis=1) / each[:, 3]).max()
        worst = max(error.values())
        for name, value in {**error, "error": worst, "count": counted}.items():
            seen[name][i] = value
        if counted < ENOUGH:
            fate[i] = Fate.UNJUDGED
            continue
        allowed = ERROR + SURE / np.sqrt(counted)
        excess[i] = np.log(max(worst, 1e-300) / allowed)
        fate[i] = Fate.RIGHT if fit.status.ok else Fate.WARNED
        if worst > allowed and fit.status.name != "NOT_CONVERGED":
            fate[i] = Fate.SILENT
    return Judged(fate, excess, {**seen, "status": status})


DOMAINS = [Domain("population of animals", AXES, judge)]
