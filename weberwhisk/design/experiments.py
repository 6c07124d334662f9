"""Simulated experiments, fitted and compared: thousands a second.

Each is drawn, weighed under every hypothesis with the priors of the fit (`tables`), and left with
two results: the Bayes factor of the truth, and the interval of the Weber fraction. One animal is
fitted by itself; several share a population, as `fit_population` has it (`populations`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.special import ndtri
from scipy.stats import beta as beta_distribution

from .. import _checks
from ..behaviour.integrate import likelihood, marginal
from ..behaviour.lapses import score_prior
from ..behaviour.priors import Priors
from ..threads import one_blas_thread
from .hypotheses import Goal, Hypothesis, SubjectPopulation
from .plan_file import decode
from .populations import bias_scales, populations, steps_of
from .scheme import Scheme

Array = NDArray[np.float64]

BY = ["truth", "trials", "animals", "lapse"]  # what experiments are counted by
QUANTILES = (0.025, 0.5, 0.975)
MOST_BYTES = 100e6  # of the tables of a population's batch, a quarter of what a worker then takes


@dataclass(frozen=True)
class Fitted:
    """Posteriors of D experiments under one hypothesis.

    `log_evidence` (D,) of the sequences of answers; `quantiles` (D, 3) of the Weber fraction, or
    with several animals of the population's median: 2.5, 50 and 97.5 %. Of several animals fitted
    apart they are (D, A, 3), each one's own.
    """

    log_evidence: Array
    quantiles: Array

    @property
    def half_width(self) -> Array:
        """Half the width of the 95 % interval over the posterior median, (D,) or (D, A): 0.2 is
        ±20 %."""
        low, middle, high = np.moveaxis(self.quantiles, -1, 0)
        return (high - low) / (2 * middle)


def simulate(
    hypothesis: Hypothesis,
    scheme: Scheme,
    animals: SubjectPopulation,
    runs: int,
    rng: np.random.Generator,
    *,
    assurance: bool = False,
    together: bool = True,
) -> tuple[Array, Array]:
    """Answers (runs, animals, C) of so many experiments, and the true Weber fractions (runs,): of
    the animal, or of the population with several; (runs, animals) where these are fitted apart.

    Every experiment draws its own animals. With `assurance` the Weber fraction (with several
    animals their median) is drawn from the hypothesis's prior, for every experiment anew.
    """
    model = hypothesis.model(scheme)
    shape = runs, scheme.animals
    middle = np.full(runs, animals.weber_fraction)
    if assurance:
        middle = hypothesis.priors.value("weber_fraction", ndtri(rng.random(runs)))
    k = middle[:, None] * np.exp(animals.spread * rng.standard_normal(shape))
    if animals.lapses_vary and animals.lapse > 0:
        ends = 2.0, 2.0 / animals.lapse - 2.0
        low, high = (beta_distribution.ppf(rng.random(shape), *ends) for _ in range(2))
    else:
        low = high = np.full(shape, animals.lapse)
    # One bias an animal, as in `simulate_population`.
    bias = hypothesis.usual_bias + animals.bias_spread * rng.standard_normal(shape)
    p, _ = model.probability(k, low, high, np.repeat(bias[..., None], model.n_groups, axis=-1))
    counts = rng.binomial(model.cells.n.astype(np.int64), np.clip(p, 0.0, 1.0))
    true = k[:, 0] if scheme.animals == 1 else middle if together else k
    return counts.astype(float), true


@one_blas_thread
def fit(
    hypothesis: Hypothesis, scheme: Scheme, counts: Array, batch: int = 2048, held: float = 7.5,
    together: bool = True,
) -> Fitted:  # fmt: skip
    """Weigh a hypothesis by every experiment, counts (D, A, C); expected ones, not whole, will do
    too.

    `batch` data sets of animals alone are done at once; `held` is how far under the best, in nats,
    the likelihood of one of several animals is tabulated. Animals that are not fitted `together`
    each have a posterior, and evidence multiplies.
    """
    model = hypothesis.model(scheme)
    apart = counts.shape[1] == 1 or not model.free[0] or not together
    # The first few experiments with several animals tell how much memory one takes.
    size = max(1, batch // counts.shape[1]) if apart else 4
    found: list[tuple[Array, Array]] = []
    at = 0
    while at < len(counts):
        some = counts[at : at + size]
        at += len(some)
        flat = some.reshape(-1, some.shape[-1])
        if apart:
            evidence, quantiles = _single(hypothesis.priors, *marginal(model, flat))
            each = quantiles[: len(some)]
            if not together and counts.shape[1] > 1:
                each = quantiles.reshape(*some.shape[:2], -1)
            found.append((evidence.reshape(len(some), -1).sum(axis=1), each))
        else:
            table = likelihood(model, flat, steps_of(model), bias_scales(model), held)
            mu, by_median, evidence = populations(model, table, counts.shape[1])
            found.append((evidence, np.exp(_integrated(mu, by_median)[1])))
            # Nodes are shared: more data sets together spread over more of them, by half or so.
            fits = int(MOST_BYTES * len(some) / (1.5 * table.values.nbytes))
            size = max(1, min(fits, 2 * len(some)))
    evidence, quantiles = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return Fitted(evidence, quantiles)


def compare(
    hypotheses: Sequence[Hypothesis],
    truth: str,
    scheme: Scheme,
    counts: Array,
    together: bool = True,
) -> tuple[Array, Fitted]:
    """Log Bayes factor of the truth against the best of the others (D,), and the truth's fit.

    Infinite where there is no other.
    """
    fits = {h.name: fit(h, scheme, counts, together=together) for h in hypotheses}
    others = [f.log_evidence for name, f in fits.items() if name != truth]
    best = np.max(others, axis=0) if others else np.full(len(counts), -np.inf)
    return fits[truth].log_evidence - best, fits[truth]


def experiments(chunk: dict[str, Any], seed: np.random.SeedSequence) -> pd.DataFrame:
    """The work of a power analysis: so many experiments of one design, a row each.

    Columns: the true `weber_fraction` and its `estimate`, `log_bayes_factor`, `half_width` and
    `covers`, with what the chunk, as `power` writes it, says of the design. Where several animals
    are fitted apart these are medians over them, and `covers` a share, as in `SimulatedStudy`.
    """
    hypotheses = decode(chunk["hypotheses"])
    scheme, animals = decode(chunk["scheme"]), decode(chunk["animals"])
    truth = next(h for h in hypotheses if h.name == chunk["truth"])
    counts, k = simulate(
        truth, scheme, animals, chunk["runs"], np.random.default_rng(seed),
        assurance=chunk["assurance"], together=(together := chunk.get("together", True)),
    )  # fmt: skip
    log_factor, fitted = compare(hypotheses, truth.name, scheme, counts, together)
    low, middle, high = np.moveaxis(fitted.quantiles, -1, 0)
    width, covers = fitted.half_width, (low <= k) & (k <= high)
    narrow = {}
    if width.ndim == 2:
        if chunk["half_width"] is not None:
            narrow = {"reached": (width < chunk["half_width"]).mean(axis=1)}
        k, middle, width = (np.median(of, axis=1) for of in (k, middle, width))
        covers = covers.mean(axis=1)
    return pd.DataFrame(
        {
            **chunk["label"],
            "truth": truth.name,
            "weber_fraction": k,
            "estimate": middle,
            "log_bayes_factor": log_factor,
            "half_width": width,
            "covers": covers,
            **narrow,
        }
    )


def _single(priors: Priors, scores: Array, log_likelihood: Array) -> tuple[Array, Array]:
    if scores.size == 1:  # k is known
        k = np.full((len(log_likelihood), 3), float(priors.value("weber_fraction", 0.0)))
        return log_likelihood[:, 0], k
    log_post = log_likelihood + score_prior(scores)
    evidence, z = _integrated(scores, log_post)
    return evidence, priors.value("weber_fraction", z)


def _integrated(x: Array, log_density: Array, finer: int = 8) -> tuple[Array, Array]:
    """ln of the integral (D,) on even nodes, and the quantiles (D, 3) of densities (D, X)."""
    top = log_density.max(axis=1, keepdims=True)
    relative = np.maximum(log_density - top, -60.0)
    fine = np.linspace(x[0], x[-1], finer * (x.size - 1) + 1)
    # Of a normal density the logarithm is interpolated without error, however far the nodes.
    density = np.exp(CubicSpline(x, relative.T)(fine).T)
    step = fine[1] - fine[0]
    evidence = np.log(density.sum(axis=1) * step) + top[:, 0]
    mass = np.cumsum(0.5 * step * (density[:, 1:] + density[:, :-1]), axis=1)
    mass /= mass[:, -1:]
    out = np.empty((len(mass), len(QUANTILES)))
    for i, q in enumerate(QUANTILES):
        at = np.argmax(mass >= q, axis=1)
        after, before = (
            np.take_along_axis(np.pad(mass, ((0, 0), (1, 0))), at[:, None] + j, 1)[:, 0]
            for j in (1, 0)
        )
        out[:, i] = fine[at] + step * (q - before) / (after - before)
    return evidence, out


def wilson(share: float, n: int, mass: float = 0.95) -> tuple[float, float]:
    """Wilson's interval of a proportion (1927, J. Am. Stat. Assoc. 22:209), of any share."""
    z = float(ndtri(0.5 + mass / 2))
    middle = (share + z**2 / (2 * n)) / (1 + z**2 / n)
    reach = z / (1 + z**2 / n) * np.sqrt(share * (1 - share) / n + (z / (2 * n)) ** 2)
    low = 0.0 if share <= 0 else float(max(middle - reach, 0.0))  # not 1e-17
    return low, 1.0 if share >= 1 else float(min(middle + reach, 1.0))


def sized(scheme: Scheme, vary: str, size: int) -> Scheme:
    """The scheme with so many animals, or trials of the comparison shown most."""
    if vary == "animals":
        return scheme.with_animals(size)
    most = max(map(max, scheme.trials))
    _checks.whole("trials", size, "write 20")
    counts = [[max(1, round(n * size / most)) for n in row] for row in scheme.trials]
    return Scheme(scheme.standards, scheme.offsets, counts, scheme.animals)


def summary(runs: pd.DataFrame, goal: Goal) -> pd.DataFrame:
    """What `Power.table` holds, of single runs."""
    met = reaches(runs, goal)
    rows = []
    for key, own in runs.groupby(BY, sort=False):
        share = float(met[own.index].mean())
        lower, upper = wilson(share, len(own))
        row = dict(zip(BY, key, strict=True)) | {
            "runs": len(own), "power": share, "lower": lower, "upper": upper,
        }  # fmt: skip
        for name in ("half_width", "log_bayes_factor"):
            low, middle, high = own[name].quantile([0.05, 0.5, 0.95], interpolation="nearest")
            row |= {name: middle, f"{name}_5": low, f"{name}_95": high}
        off = float((own["estimate"] / own["weber_fraction"]).median() - 1)
        rows.append(row | {"bias": off, "coverage": own["covers"].mean()})
    return pd.DataFrame(rows)


def reaches(runs: pd.DataFrame, goal: Goal) -> pd.Series:
    """Which experiments reach the goal, or what share of their animals, fitted apart."""
    if goal.bayes_factor is not None:
        return runs["log_bayes_factor"] > np.log(goal.bayes_factor)
    return runs["reached"] if "reached" in runs else runs["half_width"] < goal.half_width
