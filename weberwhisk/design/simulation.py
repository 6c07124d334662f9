"""Simulated experiments, fitted and compared: thousands a second.

Each is drawn, weighed under every hypothesis with the priors of the fit, and left with two results:
the Bayes factor of the truth, and the interval of the Weber fraction. One animal is fitted by
itself. Several share a population of k: ln k of the animals is normal about the population's
median, while lapses and biases of each are integrated for itself (`fit_population` learns these
from all animals too, and so says no less). All animals of all experiments share their nodes, so
that a population is a set of weights of these nodes, and integrals are matrix products.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from scipy.interpolate import CubicSpline
from scipy.stats import beta as beta_distribution

from .._util.campaign import one_blas_thread
from .._util.values import Array, density_quantiles
from ..behaviour.axes import score_prior
from ..behaviour.bulk import log_sum, marginal
from ..behaviour.fit import fit_weber
from ..behaviour.likelihood import WeberModel
from ..behaviour.priors import Priors
from ..behaviour.states import States
from ..behaviour.trials import STIMULI, Trials
from .conditions import contrast_experiments
from .goals import Contrast, Goal
from .hypotheses import Hypothesis, SubjectPopulation, options_of
from .population_grid import PopulationGrid, spread_nodes
from .scheme import Scheme, sized

__all__ = ["Fitted", "compare", "experiments", "fit", "simulate"]


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
    together: bool = True,
) -> tuple[Array, Array]:
    """Answers (runs, animals, C) of so many experiments, and the true Weber fractions (runs,): of
    the animal, or of the population with several; (runs, animals) where these are fitted apart.

    Every experiment draws its own animals.
    """
    p, true = _drawn(hypothesis, scheme, animals, runs, rng, together=together)
    n = scheme.cells().n.astype(np.int64)
    return rng.binomial(n, p).astype(float), true


def _drawn(
    hypothesis: Hypothesis,
    scheme: Scheme,
    animals: SubjectPopulation,
    runs: int,
    rng: np.random.Generator,
    *,
    together: bool,
) -> tuple[Array, Array]:
    """Probability of the answer of animals drawn, (runs, animals, C), and their Weber fractions."""
    model = hypothesis.model(scheme)
    shape = runs, scheme.animals
    middle = np.full(runs, animals.weber_fraction)
    k = middle[:, None] * np.exp(animals.spread * rng.standard_normal(shape))
    if animals.lapses_vary and animals.lapse > 0:
        ends = 2.0, 2.0 / animals.lapse - 2.0
        low, high = (beta_distribution.ppf(rng.random(shape), *ends) for _ in range(2))
    else:
        low = high = np.full(shape, animals.lapse)
    # One bias an animal, as in `simulate_population`.
    bias = hypothesis.usual_bias + animals.bias_spread * rng.standard_normal(shape)
    p, _ = model.probability(k, low, high, np.repeat(bias[..., None], model.n_groups, axis=-1))
    true = k[:, 0] if scheme.animals == 1 else middle if together else k
    return np.clip(p, 0.0, 1.0), true


@one_blas_thread
def fit(
    hypothesis: Hypothesis, scheme: Scheme, counts: Array, batch: int = 2048, together: bool = True
) -> Fitted:
    """Weigh a hypothesis by every experiment, counts (D, A, C); expected ones, not whole, will do
    too.

    `batch` data sets are done at once. Animals that are not fitted `together` each have a
    posterior, and evidence multiplies.
    """
    model, animals = hypothesis.model(scheme), counts.shape[1]
    pooled = together and animals > 1 and model.free[0]
    size = max(1, batch // animals)
    fitted: list[tuple[Array, Array]] = []
    for chunk in (counts[i : i + size] for i in range(0, len(counts), size)):
        flat = chunk.reshape(-1, chunk.shape[-1])
        if pooled:
            scores, log_like = marginal(model, flat, 7.5)
            log_k = np.log(model.value("weber_fraction", scores))
            mean, density = populations(model, log_k, log_like.reshape(len(chunk), animals, -1))
            evidence, log_median = _integrated(mean, density)
            fitted.append((evidence, np.exp(log_median)))
        else:
            evidence, each = _single(hypothesis.priors, *marginal(model, flat))
            if animals > 1:
                each = each.reshape(len(chunk), animals, -1)
                each = each if not together else each[:, 0]  # k is given, the same for all
            fitted.append((evidence.reshape(len(chunk), -1).sum(axis=1), each))
    evidence, quantiles = (np.concatenate(arrays) for arrays in zip(*fitted, strict=True))
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
    return _log_factor({name: f.log_evidence for name, f in fits.items()}, truth), fits[truth]


def _log_factor(log_evidence: dict[str, Array], truth: str) -> Array:
    others = [each for name, each in log_evidence.items() if name != truth]
    best = np.max(others, axis=0) if others else -np.inf
    return np.asarray(log_evidence[truth] - best)


def _with_states(
    hypotheses: Sequence[Hypothesis],
    truth: Hypothesis,
    scheme: Scheme,
    animals: SubjectPopulation,
    states: States,
    runs: int,
    rng: np.random.Generator,
    *,
    together: bool,
) -> tuple[Array, Fitted, Array]:
    """Experiments with animals that are engaged part of the time, each fitted with three states:
    log Bayes factors, fits of the truth, and the true Weber fractions."""
    p, k = _drawn(truth, scheme, animals, runs, rng, together=together)
    cells = scheme.cells()
    every = pd.DataFrame({name: getattr(cells, name) for name in STIMULI}).assign(n=1)
    evidence = {h.name: np.zeros(runs) for h in hypotheses}
    quantiles = np.empty((runs, scheme.animals, 3))
    for run, animal in np.ndindex(runs, scheme.animals):
        order = rng.permutation(np.repeat(np.arange(cells.n.size), cells.n.astype(int)))
        frame = every.iloc[order].reset_index(drop=True)
        state, second = states.drawn(frame, rng.random((2, order.size)))
        chance = np.where(state > 0, second, p[run, animal, order])
        frame = frame.assign(count=(rng.random(order.size) < chance).astype(float))
        trials = Trials(frame, truth.asked, in_order=True, source="simulated answers")
        for h in hypotheses:
            state_fit = fit_weber(trials, states=3, seed=rng, **options_of(h))
            assert state_fit.log_evidence is not None
            evidence[h.name][run] += state_fit.log_evidence
            if h is truth:
                levels = [0.025, 0.5, 0.975]
                quantiles[run, animal] = state_fit.posterior.quantile("weber_fraction", levels)
    kept = quantiles[:, 0] if scheme.animals == 1 else quantiles
    return _log_factor(evidence, truth.name), Fitted(evidence[truth.name], kept), k


def experiments(
    chunk: dict[str, Any],
    seed: np.random.SeedSequence,
    scheme: Scheme,
    hypotheses: Sequence[Hypothesis],
    animals: SubjectPopulation,
    goal: Goal,
    together: bool = True,
    states: States | None = None,
) -> pd.DataFrame:
    """The work of a power analysis: so many experiments of one size and truth, a row each.

    Columns: what the chunk says of them, the true `weber_fraction` and its `estimate`,
    `log_bayes_factor`, `half_width` and `covers`. Where animals are fitted one by one, these are
    medians over them, and `covers`, and what the goal adds, are shares.
    """
    truth = next(h for h in hypotheses if h.name == chunk["truth"])
    scheme = sized(sized(scheme, "trials", chunk["trials"]), "animals", chunk["animals"])
    if isinstance(goal, Contrast):
        return contrast_experiments(chunk, seed, scheme, truth, animals, goal.ratio)
    rng = np.random.default_rng(seed)
    if states is not None:
        log_factor, fitted, k = _with_states(
            hypotheses, truth, scheme, animals, states, chunk["runs"], rng, together=together
        )
    else:
        counts, k = simulate(truth, scheme, animals, chunk["runs"], rng, together=together)
        log_factor, fitted = compare(hypotheses, truth.name, scheme, counts, together)
    low, middle, high = np.moveaxis(fitted.quantiles, -1, 0)
    width, covers = fitted.half_width, (low <= k) & (k <= high)
    of_animals: dict[str, Array] = {}
    if width.ndim == 2:
        of_animals = goal.animal_columns(width)
        k, middle, width = (np.median(of, axis=1) for of in (k, middle, width))
        covers = covers.mean(axis=1)
    outcomes = {
        "weber_fraction": k, "estimate": middle, "log_bayes_factor": log_factor,
        "half_width": width, "covers": covers,
    }  # fmt: skip
    about = {name: chunk[name] for name in ("trials", "animals", "truth")}
    return pd.DataFrame({**about, **outcomes, **of_animals})


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
    evidence = np.log(density.sum(axis=1) * (fine[1] - fine[0])) + top[:, 0]
    return evidence, density_quantiles(fine, density, [0.025, 0.5, 0.975])


def populations(
    model: WeberModel, log_k: Array, log_like: Array, finer: int = 3, spreads: int = 10
) -> tuple[Array, Array]:
    """Even means of ln k (U,), and their log posterior density in every experiment (D, U).

    `log_like` (D, A, K) are log-likelihoods of ln k of the animals, interpolated to `finer` nodes
    between those given; the spread is integrated out over so many nodes.
    """
    animals = log_like.shape[1]
    x = np.linspace(log_k[0], log_k[-1], finer * (log_k.size - 1) + 1)
    top = log_like.max(axis=-1, keepdims=True)
    fine = CubicSpline(log_k, np.maximum(log_like - top, -60.0), axis=-1)(x) + top
    # Given nodes are 2.8 of the least sd of an animal apart: two finer ones are 1.9.
    mean = np.arange(x[0] - 1.0, x[-1] + 1.0, 2.0 * (x[1] - x[0]) / np.sqrt(animals))
    tau, log_spread = spread_nodes(spreads)
    prior = model.priors.log_density("weber_fraction", np.exp(mean)) + mean
    means, sds = np.meshgrid(mean, tau, indexing="ij")
    grid = PopulationGrid.at(x, means, sds, prior[:, None] + log_spread)
    out = np.empty((len(log_like), mean.size))
    size = max(1, int(4e6 / (animals * means.size)))  # experiments whose tables fit the cache
    for i in range(0, len(out), size):
        out[i : i + size] = log_sum(grid.log_mass(grid.by_animal(fine[i : i + size])), 2)
    return mean, out
