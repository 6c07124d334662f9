"""The part of `stability.py` that hunts in fits of populations.

The reference draws populations from what is believed beforehand, animals from each of them, and
where these are told apart sessions from each animal, and weighs them by their answers: no grid, no
conditional modes, no tables. The likelihood is written anew. Judged are the ends of the 95 %
interval and the median of the population's Weber fraction, of the spreads, and of each animal's
own, and each session's.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
import pandas as pd
from hunting import Axis, Domain, Fate, Judged
from scipy import stats
from scipy.special import logsumexp, ndtr, ndtri, xlogy

from weberwhisk.behaviour import fit_population, read_trials

Array = np.ndarray
Case = dict[str, Array]


class Table(NamedTuple):
    """Whose it is, comparisons against 1, trials of each and answers."""

    animal: int
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
OF_SESSIONS = AXES | {
    "animals": Axis(1.0, 2.49),
    "sessions": Axis(1.0, 2.49),
    "session_spread": Axis(0.0, 1.0, special=(0.0, 0.3)),
}
LEVELS = 5
ENDS = np.array([0.025, 0.5, 0.975])
#: Populations drawn, animals of each that stand for one, and sessions of each of these.
ANIMALS, SESSIONS = (2**15, 64, 1), (2**14, 12, 12)
#: How many populations are weighed at a time.
CHUNK = 2**11
#: Error allowed, in posterior sds; populations that must count for the reference to judge; sds that
#: a quantile of so many is known to.
ERROR, ENOUGH, SURE = 0.08, 1500, 5.0


def tables(case: Case, i: int) -> list[Table]:
    """Answers of every animal, session by session: quantiles all through."""
    count, n = round(float(case["animals"][i])), round(float(case["trials"][i]))
    sessions = round(float(case["sessions"][i])) if "sessions" in case else 1
    levels = 1 + np.linspace(-1, 1, LEVELS) * case["span"][i]
    z, within = (ndtri((np.arange(m) + 0.5) / m) for m in (count, sessions))
    out = []
    for j in range(count * sessions):
        animal, session = divmod(j, sessions)
        log_k = case["spread"][i] * z[animal]
        if "sessions" in case:
            log_k = log_k + case["session_spread"][i] * within[session]
        k = case["weber_fraction"][i] * np.exp(log_k)
        lapse = case["lapse"][i] * (j + 1) / (count * sessions)
        drive = (levels - 1) / (k * np.hypot(levels, 1)) + case["bias"][i] * np.cos(7.0 * j)
        p = lapse + (1 - 2 * lapse) * ndtr(drive)
        u = (case["answers"][i] + 0.6180339887498949 * (np.arange(LEVELS) + LEVELS * j)) % 1
        answers = stats.binom.ppf(np.clip(u, 1e-6, 1 - 1e-6), n, p)
        out.append(Table(animal, levels, n, answers))
    return out


@cache
def _drawn(count: int) -> dict[str, Array]:
    """Populations as believed."""
    z = ndtri(stats.qmc.Sobol(6, seed=2).random(count)).T
    return {
        "weber_fraction": np.log(0.1) + np.log(3.0) * z[0],
        "spread": 0.5 * np.abs(z[1]),
        "lapse_mean": z[2],
        "lapse_spread": 0.7 * np.exp(0.5 * z[3]),
        "bias_scale": np.abs(z[4]),
        "session_spread": 0.3 * np.abs(z[5]),
    }


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
    """ln of the likelihood of tables at ln k (P, A, S), their lapses and biases drawn by z."""
    mean, spread, scale = (
        p[name][:, None, None] for name in ("lapse_mean", "lapse_spread", "bias_scale")
    )
    other = 0.7 * z[..., 0] + np.sqrt(0.51) * z[..., 1]
    low, high = (np.interp(mean + spread * s, *_lapses()) for s in (z[..., 0], other))
    log = np.where(low + high < 1, 0.0, -1e4)  # no animal at all
    drives = (table.levels - 1) / np.hypot(table.levels, 1)
    for drive, hits in zip(drives, table.answers, strict=True):
        up = ndtr(drive * np.exp(-log_k) + scale * z[..., 2])
        chance = low * (1 - up) + (1 - high) * up
        log += xlogy(hits, np.maximum(chance, 1e-300))
        log += xlogy(table.n - hits, np.maximum(1 - chance, 1e-300))
    return log


def weighed(found: list[Table], *, sessions: bool = False) -> tuple[dict[str, Array], Array, float]:
    """Quantiles of what describes the population and of ln k; how many populations count.

    Of ln k of every animal, then of every session where these are told apart, (A + U, 4).
    """
    populations, animals, inner = SESSIONS if sessions else ANIMALS
    drawn = _drawn(populations)
    order = sorted({t.animal for t in found})
    total = np.zeros(populations)
    log_ks: list[list[Array]] = [[] for _ in order]
    logs: list[list[Array]] = [[] for _ in order]
    of_sessions: list[list[tuple[Array, Array]]] = [[] for _ in found]
    rng = np.random.default_rng(3)
    for start in range(0, populations, CHUNK):
        part = slice(start, start + CHUNK)
        p = {name: value[part] for name, value in drawn.items()}
        for a, animal in enumerate(order):
            z = _normals(rng, CHUNK, animals, 1)[..., 0]
            middle = p["weber_fraction"][:, None] + p["spread"][:, None] * z
            own = []
            for u, table in enumerate(found):
                if table.animal != animal:
                    continue
                z = _normals(rng, CHUNK, animals * inner, 4).reshape(CHUNK, animals, inner, 4)
                log_k = np.broadcast_to(middle[..., None], z.shape[:3])
                if sessions:
                    log_k = log_k + p["session_spread"][:, None, None] * z[..., 3]
                log = _log_likelihood(table, log_k, p, z)
                own.append(log)
                of_sessions[u].append((log_k, log))
            # Each session's draws are its own, so that the mean of a product is the product's.
            log = sum(logsumexp(log, axis=2) for log in own)
            log_ks[a].append(middle)
            logs[a].append(np.asarray(log))
            total[part] += logsumexp(log, axis=1)
            if sessions:
                rest = [np.asarray(log) - logsumexp(each, axis=2) for each in own]
                at = [u for u, table in enumerate(found) if table.animal == animal]
                for u, other, each in zip(at, rest, own, strict=True):
                    of_sessions[u][-1] = _thinned(of_sessions[u][-1][0], each + other[..., None])
    weight = np.exp(total - total.max())
    weight /= weight.sum()
    of_population = {name: _quantiles(values, weight) for name, values in drawn.items()}
    each = []
    for log_k, log in zip(log_ks, logs, strict=True):
        of_animal = np.concatenate(log)
        share = np.exp(of_animal - logsumexp(of_animal, axis=1)[:, None])
        each.append(_quantiles(np.concatenate(log_k).ravel(), (weight[:, None] * share).ravel()))
    if sessions:
        for parts in of_sessions:
            log_k, share = (np.concatenate(values) for values in zip(*parts, strict=True))
            each.append(_quantiles(log_k.ravel(), (weight[:, None] * share).ravel()))
    return of_population, np.array(each), float(1 / (weight**2).sum())


def _thinned(log_k: Array, log: Array) -> tuple[Array, Array]:
    """Of each population's draws (P, A, S) one for each of its animals, and what it counts."""
    flat = log.reshape(len(log), -1)
    share = np.exp(flat - logsumexp(flat, axis=1)[:, None]).reshape(log.shape)
    rise = np.cumsum(share, axis=2)
    place = np.random.default_rng(5).random((*log.shape[:2], 1)) * rise[..., -1:]
    chosen = np.minimum((rise < place).sum(axis=2), log.shape[2] - 1)[..., None]
    return np.take_along_axis(log_k, chosen, axis=2)[..., 0], rise[..., -1]


def _quantiles(values: Array, weight: Array) -> Array:
    """Those at `ENDS`, and the sd."""
    order = np.argsort(values)
    rise = np.cumsum(weight[order]) - 0.5 * weight[order]
    mean = weight @ values
    return np.append(np.interp(ENDS, rise, values[order]), np.sqrt(weight @ (values - mean) ** 2))


def judge(case: Case) -> Judged:
    """Each population's fit beside the weighed draws."""
    n, sessions = case["trials"].size, "sessions" in case
    fate, excess = np.full(n, Fate.RIGHT), np.full(n, -np.inf)
    described = ("weber_fraction", "spread", *["session_spread"] * sessions)
    names = ("error", *(f"of_{name}" for name in described), "of_each", "count")
    seen = {key: np.full(n, np.nan) for key in names}
    status = np.full(n, "", dtype=object)
    for i in range(n):
        found = tables(case, i)
        frame = pd.concat(
            [
                pd.DataFrame({"subject": f"s{t.animal}", "session": j, "standard": 1.0,
                              "comparison": t.levels, "n": t.n, "n_greater": t.answers.astype(int)})
                for j, t in enumerate(found)
            ]
        )  # fmt: skip
        fit = fit_population(
            read_trials(frame if sessions else frame.drop(columns="session")), sessions=sessions
        )
        status[i] = fit.status.name
        if fit.population is None:
            fate[i] = Fate.REFUSED
            continue
        members = fit.subjects if fit.sessions is None else fit.sessions
        kept = members["weber_fraction"].notna().to_numpy()
        population, each, counted = weighed(
            [t for t, held in zip(found, kept, strict=True) if held], sessions=sessions
        )
        table = pd.concat([fit.subjects, members]) if sessions else fit.subjects
        own = np.log(table[["lower", "weber_fraction", "upper"]].dropna().to_numpy())
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


DOMAINS = [
    Domain("population of animals", AXES, judge),
    Domain("population of animals and sessions", OF_SESSIONS, judge),
]
