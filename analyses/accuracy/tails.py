"""Fits with long tails and animals of two states, beside plain sums: which are wrong in silence?

    python analyses/accuracy/tails.py [table] [--count 60] [--seed 20261129]

Appends a row a fit to `tails.csv`, and prints a row a kind; what the table has is not made again.
The kinds: noise with a floor, which leaves a long left tail of the Weber fraction k; same or
different, where a criterion does; and animals that are disengaged part of the time, whose answers
then may be any. Three parameters of each are unknown, or two, and a third of the fits are at an
edge: few trials with a high floor, a criterion of four to six sds, or an animal that is disengaged
in half of its trials or more.

The sums are over even nodes of the normal scores of the priors, in a box that is found by looking
at the posterior to the power 1/64, 1/16, 1/4 and 1. Sums over every second node of each axis say
what error is left, and nodes are doubled until it is a third of the bars; fits where it stays more
are left out. Likelihoods and priors are written out here.

A fit is silently wrong if it does not say that its integral is rough and is off by more than three
times its claim and more than 1e-2 sd in a quartile or the median of a parameter, or 2e-2 sd in an
end of a 95 % interval; some have no variance, and an sd is the interval's length over 3.92. Draws
that are worth n independent ones claim, as of a normal, 1.4/√n sds in a quartile and 2.7/√n in an
end.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from edges import ENDS, MOMENTS, SURE, search
from numpy.typing import NDArray
from scipy import stats
from scipy.interpolate import CubicSpline
from scipy.special import ndtr, xlog1py, xlogy

import weberwhisk as ww
from weberwhisk.behaviour import Trials, effects, read_trials

Array = NDArray[np.float64]

TABLE = Path(__file__).with_name("tails.csv")
KINDS = ("floor", "same-different", "states")
OFFSETS = np.array([-0.4, -0.25, -0.1, 0.0, 0.1, 0.25, 0.4])
LAPSE, SWITCH = 0.02, 0.05
#: Powers of the density that are looked at, nodes of an axis then and in the sums, and how many
#: nats under the best node nothing is summed.
LOOKS, LOOK, NODES, DROP = (1 / 64, 1 / 16, 1 / 4, 1.0), 40, 60, 30.0
#: Ends of the 95 % interval, quartiles and median, and the standard errors of the first two kinds
#: for normal draws over that of their mean.
QUANTILES = np.array([0.025, 0.975, 0.25, 0.5, 0.75])
OF_AN_END, OF_A_QUARTILE = (
    np.sqrt(p * (1 - p)) / stats.norm.pdf(stats.norm.ppf(p)) for p in (0.025, 0.25)
)
PRIORS: dict[str, Any] = {
    "weber_fraction": stats.lognorm(np.log(3.0), scale=0.1),
    "floor": stats.lognorm(np.log(4.0), scale=0.03),
    "bias": stats.cauchy(0.0, 0.7),
    "criterion": stats.fisk(1.5, scale=1.6),
    "engaged": stats.uniform(0.0, 1.0),
    "answer_away": stats.uniform(0.0, 1.0),
}
FARTHEST = 1000.0  # sds: the package has no bias or criterion beyond


class Case:
    """An animal's answers, their fit and ln of their probability.

    Parameters
    ----------
    index, seed : int
    """

    def __init__(self, index: int, seed: int) -> None:
        self.rng = np.random.default_rng([seed, index])
        self.kind = KINDS[index % len(KINDS)]
        self.edge = bool(self.rng.random() < 1 / 3)
        self.k = float(np.exp(self.rng.uniform(np.log(0.04), np.log(0.3))))
        few = self.edge and self.kind == "floor"
        per_level = int(np.exp(self.rng.uniform(np.log(4), np.log(10 if few else 80))))
        self.first = np.repeat([1.0, 2.0][: self.rng.integers(1, 3)], OFFSETS.size)
        self.second = self.first * np.resize(1 + OFFSETS, self.first.size)
        self.n = np.full(self.first.size, per_level)
        getattr(self, f"_{self.kind.replace('-', '_')}")()

    def _floor(self) -> None:
        floor = self.rng.uniform(0.1, 0.3) if self.edge else self.rng.uniform(0.0, 0.1)
        bias = self.rng.normal(0, 0.5)
        self.unknowns: tuple[str, ...] = "weber_fraction", "floor", "bias"
        self.counts = self.rng.binomial(self.n, self.chance(self.k, floor, bias))
        self.found = ww.fit_weber(
            self._table(), priors={"lapse_low": LAPSE, "lapse_high": LAPSE, "bias": PRIORS["bias"]},
            effects=[effects.Floor(PRIORS["floor"])],
        )  # fmt: skip

    def _same_different(self) -> None:
        criterion = self.rng.uniform(4, 6) if self.edge else self.rng.uniform(0.3, 3)
        self.unknowns = "weber_fraction", "criterion"
        self.counts = self.rng.binomial(self.n, self.chance(self.k, criterion))
        self.found = ww.fit_weber(
            self._table("same-different"),
            priors={"lapse_low": LAPSE, "lapse_high": LAPSE, "bias": PRIORS["criterion"]},
        )  # fmt: skip

    def _states(self) -> None:
        engaged = self.rng.uniform(0.1, 0.5) if self.edge else self.rng.uniform(0.5, 1.0)
        away = self.rng.uniform()
        self.unknowns = "weber_fraction", "engaged", "answer_away"
        self.cell = self.rng.permutation(np.repeat(np.arange(self.n.size), self.n))[:200]
        anew = self.rng.random(self.cell.size) < SWITCH
        anew[0] = True
        run = np.cumsum(anew) - 1
        is_engaged = (self.rng.random(run[-1] + 1) < engaged)[run]
        chance = np.where(is_engaged, self.chance(self.k)[self.cell], away)
        self.answers = (self.rng.random(self.cell.size) < chance).astype(int)
        table = {"stimulus_1": self.first[self.cell], "stimulus_2": self.second[self.cell],
                 "standard": self.first[self.cell], "choice": self.answers}  # fmt: skip
        self.found = ww.fit_weber(
            read_trials(pd.DataFrame(table), in_order=True), states=2,
            priors={"lapse_low": LAPSE, "lapse_high": LAPSE, "bias": 0.0, "switch": SWITCH},
        )  # fmt: skip

    def _table(self, task: str = "2AFC") -> Trials:
        table = pd.DataFrame({
            "stimulus_1": self.first, "stimulus_2": self.second, "standard": self.first,
            "n": self.n, "n_greater": self.counts,
        })  # fmt: skip
        return read_trials(table, task=task)

    def chance(self, k: Any, *others: Any) -> Array:
        """Probability of "second greater", or of "different", of every cell, (..., C)."""
        k, *others = (np.asarray(a)[..., None] for a in (k, *others))
        floor = others[0] if self.kind == "floor" else 0.0
        sd_1, sd_2 = np.hypot(k * self.first, floor), np.hypot(k * self.second, floor)
        spread = np.hypot(sd_1, sd_2)
        d = (self.second - self.first) / spread
        if self.kind == "same-different":
            c = others[0] * np.sqrt(2) * sd_1 / spread
            p = ndtr(d - c) + ndtr(-d - c)
        else:
            p = ndtr(d + others[1]) if self.kind == "floor" else ndtr(d)
        return np.asarray(LAPSE + (1 - 2 * LAPSE) * p)

    def log_likelihood(self, values: list[Array]) -> Array:
        """ln of the probability of the answers at values of the unknowns (N,) each."""
        if self.kind != "states":
            p = self.chance(*values)
            return np.asarray((xlogy(self.counts, p) + xlog1py(self.n - self.counts, -p)).sum(-1))
        k, engaged, away = values
        p = self.chance(k)
        share, log = engaged.copy(), np.zeros(k.size)  # of the engaged state, before each answer
        for t, (cell, answer) in enumerate(zip(self.cell, self.answers, strict=True)):
            if t:
                share = (1 - SWITCH) * share + SWITCH * engaged
            here = share * (p[:, cell] if answer else 1 - p[:, cell])
            total = here + (1 - share) * (away if answer else 1 - away)
            log += np.log(np.maximum(total, 1e-300))
            share = here / np.maximum(total, 1e-300)
        return log

    def density(self, axes: list[Array], part: int = 20_000) -> Array:
        """ln of the posterior density on nodes of scores, unnormalised."""
        scores = np.stack([g.ravel() for g in np.meshgrid(*axes, indexing="ij")])
        log = np.empty(scores.shape[1])
        for i in range(0, log.size, part):
            z = scores[:, i : i + part]
            values = [at(name, one) for name, one in zip(self.unknowns, z, strict=True)]
            log[i : i + part] = self.log_likelihood(values) - 0.5 * (z**2).sum(axis=0)
            for name, value in zip(self.unknowns, values, strict=True):
                if name in ("bias", "criterion"):
                    log[i : i + part][np.abs(value) > FARTHEST] = -np.inf
        return log.reshape([axis.size for axis in axes])


def at(name: str, score: Array) -> Array:
    """A parameter at its normal score, from either tail."""
    prior = PRIORS[name]
    return np.where(score < 0, prior.ppf(ndtr(score)), prior.isf(ndtr(-score)))


def summed(case: Case) -> tuple[dict[str, Array], float]:
    """`QUANTILES` of each unknown, and the error left as a share of the bars."""
    ends = np.array([[-8.0, 8.0]] * len(case.unknowns))
    for power in LOOKS:
        axes = [np.linspace(*span, LOOK) for span in ends]
        log = case.density(axes)
        inside = log > log.max() - DROP / power
        for i, axis in enumerate(axes):
            others = tuple(j for j in range(len(axes)) if j != i)
            held = np.flatnonzero(inside.any(axis=others))
            ends[i] = axis[max(held[0] - 1, 0)], axis[min(held[-1] + 1, LOOK - 1)]
    for times in (1, 2):
        axes = [np.linspace(*span, 2 * times * NODES + 1) for span in ends]
        log = case.density(axes)
        out, left = {}, 0.0
        for i, name in enumerate(case.unknowns):
            out[name] = Marginal(name, axes[i], log, i).quantiles()
            every_second = (slice(None, None, 2),) * len(axes)
            coarse = Marginal(name, axes[i][::2], log[every_second], i).quantiles()
            moments, apart = off(coarse, out[name])
            left = max(left, moments / MOMENTS, apart / ENDS)
        if left < SURE:
            break
    return out, left


class Marginal:
    """One parameter: a smooth curve through ln of its marginal density on nodes of its score.

    Parameters
    ----------
    name : str
    axis : ndarray, shape (N,)
    log : ndarray
        ln of the density of all.
    which : int
        The parameter's axis.
    """

    def __init__(self, name: str, axis: Array, log: Array, which: int) -> None:
        others = tuple(j for j in range(log.ndim) if j != which)
        marginal = np.exp(log - log.max()).sum(axis=others)
        some = marginal > 1e-200
        fine = np.linspace(*axis[some][[0, -1]], 20_001)
        weight = np.exp(CubicSpline(axis[some], np.log(marginal[some]))(fine))
        self.weight, self.values = weight / weight.sum(), at(name, fine)

    def quantiles(self) -> Array:
        """Its `QUANTILES`."""
        below = np.cumsum(self.weight) - 0.5 * self.weight
        return np.asarray(np.interp(QUANTILES, below, self.values))


def off(found: Array, truth: Array) -> tuple[float, float]:
    """The largest errors inside, and of ends, in sds."""
    apart = np.abs(found - truth) / ((truth[1] - truth[0]) / 3.92)
    return float(apart[2:].max()), float(apart[:2].max())


def judged(index: int, seed: int) -> dict[str, Any]:
    """One fit beside the sums."""
    case = Case(index, seed)
    truth, left = summed(case)
    posterior = case.found.posterior
    claim = posterior.error
    worst = {"moments": 0.0, "ends": 0.0, "bar": 0.0}
    for name, exact in truth.items():
        moments, apart = off(posterior.quantile(name, QUANTILES), exact)
        share = max(
            moments / max(MOMENTS, 3 * OF_A_QUARTILE * claim),
            apart / max(ENDS, 3 * OF_AN_END * claim),
        )
        for key, value in zip(worst, (moments, apart, share), strict=True):
            worst[key] = max(worst[key], value)
    status = "NOT_CONVERGED" if posterior.trouble else "CONVERGED"
    return {"index": index, "seed": seed, "kind": case.kind, "edge": case.edge,
            "status": status, "claim": claim, "left": left, **worst}  # fmt: skip


if __name__ == "__main__":
    search(judged, __doc__ or "", TABLE, 60, [20261129])
