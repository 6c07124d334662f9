"""Simulated experiments, fitted and compared: thousands a second.

Each is drawn, weighed under every hypothesis with the priors of the fit (`tables`), and left with
two results: the Bayes factor of the truth, and the interval of the Weber fraction. One animal is
fitted by itself; several share a population, ln k of each being normal about its median.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.special import ndtr, ndtri
from scipy.stats import beta as beta_distribution

from ..behaviour.hierarchy import PopulationPriors
from ..behaviour.priors import Priors
from ..behaviour.quadrature import score_prior
from .coding import decode
from .goals import Animals
from .hypotheses import Hypothesis
from .scheme import Scheme
from .tables import marginal

Array = NDArray[np.float64]

QUANTILES = (0.025, 0.5, 0.975)
FINER = 8  # nodes between those of k, for quantiles
SPREADS = 10  # Gauss–Legendre nodes of the spread between animals
BATCH = 2048  # data sets at once
BEYOND = 1.5  # how far past all animals' ln k the population's median is looked for


@dataclass(frozen=True)
class Fitted:
    """Posteriors of D experiments under one hypothesis.

    `log_evidence` (D,) of the sequences of answers; `quantiles` (D, 3) of the Weber fraction, or
    with several animals of the population's median: 2.5, 50 and 97.5 %.
    """

    log_evidence: Array
    quantiles: Array

    @property
    def half_width(self) -> Array:
        """Half the width of the 95 % interval over the posterior median, (D,): 0.2 is ±20 %."""
        low, middle, high = self.quantiles.T
        return (high - low) / (2 * middle)


def simulate(
    hypothesis: Hypothesis,
    scheme: Scheme,
    animals: Animals,
    runs: int,
    rng: np.random.Generator,
    *,
    assurance: bool = False,
) -> tuple[Array, Array]:
    """Answers of so many experiments.

    Parameters
    ----------
    hypothesis : Hypothesis
        The truth.
    scheme : Scheme
    animals : Animals
        What they are like; each experiment draws its own.
    runs : int
    rng : Generator
    assurance : bool
        Draw the Weber fraction (with several animals their median) from the hypothesis's prior
        instead, for every experiment anew.

    Returns
    -------
    counts : ndarray, shape (runs, animals, C)
    weber_fraction : ndarray, shape (runs,)
        The true one, of the animal, or of the population with several.

    Examples
    --------
    >>> from weberwhisk.behaviour import IdentityPercept
    >>> weber = Hypothesis("Weber", IdentityPercept())
    >>> counts, k = simulate(weber, Scheme([1.0], [-0.1, 0.1]), Animals(), 5,
    ...                      np.random.default_rng(1))
    >>> counts.shape, k.shape
    ((5, 1, 2), (5,))
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
    # One bias an animal, as in `simulate_population`; a criterion is as the prior has it.
    centre = 0.0
    if hypothesis.asked.bias_name == "criterion":
        centre = float(hypothesis.priors.value("bias", 0.0))
    bias = centre + animals.bias_spread * rng.standard_normal(shape)
    p, _ = model.probability(k, low, high, np.repeat(bias[..., None], model.n_groups, axis=-1))
    counts = rng.binomial(model.cells.n.astype(np.int64), np.clip(p, 0.0, 1.0))
    return counts.astype(float), k[:, 0] if scheme.animals == 1 else middle


def fit(hypothesis: Hypothesis, scheme: Scheme, counts: Array) -> Fitted:
    """Weigh a hypothesis by every experiment.

    Parameters
    ----------
    hypothesis : Hypothesis
    scheme : Scheme
    counts : ndarray, shape (D, A, C)
        From `simulate`; expected answers, which are not whole, will do as well.

    Examples
    --------
    >>> from weberwhisk.behaviour import IdentityPercept
    >>> weber, scheme = Hypothesis("Weber", IdentityPercept()), Scheme([1.0], [-0.1, 0.1], 50)
    >>> low, middle, high = fit(weber, scheme, np.array([[[12.0, 38.0]]])).quantiles[0]
    >>> bool(low < 0.1 < high)
    True
    """
    model = hypothesis.model(scheme)
    single = counts.shape[1] == 1
    size = max(1, BATCH // counts.shape[1])
    found = []
    for some in (counts[i : i + size] for i in range(0, len(counts), size)):
        flat = some.reshape(-1, some.shape[-1])
        if single:
            found.append(_single(hypothesis.priors, *marginal(model, flat)))
        else:
            found.append(_population(hypothesis.priors, *marginal(model, flat), counts.shape[1]))
    evidence, quantiles = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return Fitted(evidence, quantiles)


def compare(
    hypotheses: Sequence[Hypothesis], truth: str, scheme: Scheme, counts: Array
) -> tuple[Array, Fitted]:
    """Log Bayes factor of the truth against the best of the others (D,), and the truth's fit.

    Infinite where there is no other.
    """
    fits = {h.name: fit(h, scheme, counts) for h in hypotheses}
    others = [f.log_evidence for name, f in fits.items() if name != truth]
    best = np.max(others, axis=0) if others else np.full(len(counts), -np.inf)
    return fits[truth].log_evidence - best, fits[truth]


def experiments(chunk: dict[str, Any], seed: np.random.SeedSequence) -> pd.DataFrame:
    """The work of a power analysis: so many experiments of one design, a row each.

    Parameters
    ----------
    chunk : dict
        As `power` writes it.
    seed : SeedSequence

    Returns
    -------
    DataFrame
        The true `weber_fraction` and its `estimate`, `log_bayes_factor`, `half_width` and `covers`,
        with what the chunk says of the design.
    """
    hypotheses = decode(chunk["hypotheses"])
    scheme, animals = decode(chunk["scheme"]), decode(chunk["animals"])
    truth = next(h for h in hypotheses if h.name == chunk["truth"])
    counts, k = simulate(
        truth, scheme, animals, chunk["runs"], np.random.default_rng(seed),
        assurance=chunk["assurance"],
    )  # fmt: skip
    log_factor, fitted = compare(hypotheses, truth.name, scheme, counts)
    low, middle, high = fitted.quantiles.T
    return pd.DataFrame(
        {
            **chunk["label"],
            "truth": truth.name,
            "weber_fraction": k,
            "estimate": middle,
            "log_bayes_factor": log_factor,
            "half_width": fitted.half_width,
            "covers": (low < k) & (k < high),
        }
    )


def _single(priors: Priors, scores: Array, log_likelihood: Array) -> tuple[Array, Array]:
    if scores.size == 1:  # k is known
        k = np.full((len(log_likelihood), 3), float(priors.value("weber_fraction", 0.0)))
        return log_likelihood[:, 0], k
    log_post = log_likelihood + score_prior(scores)
    evidence, z = _integrated(scores, log_post)
    return evidence, priors.value("weber_fraction", z)


def _integrated(x: Array, log_density: Array) -> tuple[Array, Array]:
    """ln of the integral (D,) on even nodes, and the quantiles (D, 3) of densities (D, X)."""
    top = log_density.max(axis=1, keepdims=True)
    relative = np.maximum(log_density - top, -60.0)
    fine = np.linspace(x[0], x[-1], FINER * (x.size - 1) + 1)
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


def _population(
    priors: Priors, scores: Array, log_likelihood: Array, animals: int
) -> tuple[Array, Array]:
    """The population's median Weber fraction, each animal's own integrated out.

    ln k is normal between animals, with the spread that `PopulationPriors` believes in. Lapses have
    the prior of a single fit, not one learnt from each other.
    """
    if scores.size == 1:
        single = log_likelihood.reshape(-1, animals).sum(axis=1)
        return single, np.full((single.size, 3), float(priors.value("weber_fraction", 0.0)))
    log_k = np.log(priors.value("weber_fraction", scores))
    top = log_likelihood.max(axis=1, keepdims=True)
    curve = CubicSpline(log_k, np.maximum(log_likelihood - top, -60.0).T)
    x = np.linspace(log_k[0], log_k[-1], 3 * (scores.size - 1) + 1)
    like = np.exp(curve(x).T)  # (D·A, X)
    h = x[1] - x[0]
    # Nodes of k are 1.7 of the least sd apart, so 2.3 h is 1.3 of an animal's.
    mu = np.arange(log_k[0] - BEYOND, log_k[-1] + BEYOND, 2.3 * h / np.sqrt(animals))
    spread = PopulationPriors().spread
    node, weight = np.polynomial.legendre.leggauss(SPREADS)
    widest = float(spread.ppf(1 - 1e-4))
    tau = 0.5 * widest * (node + 1)
    weight = 0.5 * widest * weight * spread.pdf(tau)
    # A cell's probability, which also holds where the spread is smaller than the cell.
    edges = (x[:, None, None] - mu[:, None]) / tau
    kernel = ndtr(edges + 0.5 * h / tau) - ndtr(edges - 0.5 * h / tau)  # (X, U, T)
    seen = like @ kernel.reshape(x.size, -1) + 1e-300
    log_seen = (np.log(seen) + top).reshape(-1, animals, mu.size, tau.size).sum(axis=1)
    best = log_seen.max(axis=(1, 2), keepdims=True)
    by_median = np.log(np.exp(log_seen - best) @ weight + 1e-300) + best[..., 0]
    k = np.exp(mu)
    by_median += priors.log_density("weber_fraction", k) + mu
    evidence, quantiles = _integrated(mu, by_median)
    return evidence, np.exp(quantiles)
