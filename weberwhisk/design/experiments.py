"""Simulated experiments, fitted and compared: thousands a second.

Each is drawn, weighed under every hypothesis with the priors of the fit, and left with two results:
the Bayes factor of the truth, and the interval of the Weber fraction. One animal is fitted by
itself. Several share a population, as `fit_population` has it: ln k of the animals is normal about
the population's median, the normal scores of their lapses are normal with one mean and spread for
both ends, and biases are those of their prior times one factor. All animals of all experiments
share their nodes, so that a population is a set of weights of these nodes, tabulated once, and
integrals are matrix products.
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

from .._values import Array
from ..behaviour.axes import AS_BELIEVED, BiasScales, Steps, score_prior
from ..behaviour.integrate.batch import (
    LapseNodes,
    Likelihood,
    batch_steps,
    carried_on,
    likelihood,
    log_sum,
    marginal,
    narrowest_bias,
)
from ..behaviour.integrate.blocks import NOTHING
from ..behaviour.likelihood import WeberModel
from ..behaviour.priors import PopulationPriors, Priors
from ..threads import one_blas_thread
from .hypotheses import Hypothesis, SubjectPopulation
from .plan_file import decode
from .scheme import Scheme

Weights = NDArray[np.float32]

MOST_BYTES = 100e6  # of the tables of a population's batch, a quarter of what a worker then takes
LEAST = 1e-30  # of a likelihood
FLOOR = -60.0  # nats under the best, where nothing is left
CUT = 14.0  # nats under the best, where populations are left out
PRIORS = PopulationPriors()  # made once: that costs a hundred times what is asked of it


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
    out = np.empty((len(mass), 3))
    for i, q in enumerate((0.025, 0.5, 0.975)):
        at = np.argmax(mass >= q, axis=1)
        after, before = (
            np.take_along_axis(np.pad(mass, ((0, 0), (1, 0))), at[:, None] + j, 1)[:, 0]
            for j in (1, 0)
        )
        out[:, i] = fine[at] + step * (q - before) / (after - before)
    return evidence, out


# -- several animals of one population, each one's own parameters integrated out ------------------


def populations(
    model: WeberModel, found: Likelihood, animals: int, finer: int = 3
) -> tuple[Array, Array, Array]:
    """Medians mu of ln k (U,), even; their log posterior density (D, U), and the log evidence (D,).

    `found` is of D·A animals, those of an experiment together; there are `finer` nodes between
    those of k.
    """
    log_k = np.log(model.value("weber_fraction", found.scores))
    weights, log_prior = _lapses(model, found, animals)
    x = np.linspace(log_k[0], log_k[-1], finer * (log_k.size - 1) + 1)
    mu, *fractions = _fractions(model, x, animals)
    out = np.empty((found.values.shape[-1] // animals, mu.size))
    for i in range(len(out)):
        own = found.values[..., i * animals : (i + 1) * animals]
        # All data sets share their nodes, of which the animals of one hold a tenth to a third.
        held = np.nonzero((own[0] > 0.5 * NOTHING).any(axis=-1))
        k, *lapses = (slice(int(at.min()), int(at.max()) + 1) for at in held)
        own = own[:, k, *lapses].reshape(len(own), k.stop - k.start, -1, animals)
        own = np.ascontiguousarray(np.moveaxis(own, -1, 1))  # (S, A, K, L)
        few = weights[tuple(lapses)].reshape(own.shape[-1], -1)
        shares, log_weight = _bias_scales(found.scales, own, few[:, log_prior.argmax()])
        by_scale = (shares @ own.reshape(len(own), -1)).reshape(-1, *own.shape[1:])
        given = [_of_one(v, k, log_k, x, few, log_prior, *fractions) for v in by_scale]
        out[i] = log_sum(log_weight[:, None] + np.array(given), 0)
    return mu, out, log_sum(out, 1) + np.log(mu[1] - mu[0])


def steps_of(model: WeberModel) -> Steps:
    """Steps of the tables, between which likelihoods are linear in lapses; those of biases also
    serve priors narrower than a single fit's."""
    return batch_steps(model, lapse=0.6, bias=0.95)


def bias_scales(model: WeberModel, step: float = 0.5, far: float = 1e-6) -> BiasScales:
    """Scales of the biases at which likelihoods are tabulated: so far apart, in asinh, and up to
    where the prior leaves so little; closer where a bias is believed to lie off zero, as a scale
    then moves it by more than it widens it."""
    if not model.free_bias:
        return AS_BELIEVED
    last = float(PRIORS.bias_scale.isf(far))
    mean, sd = model.priors.moments("bias")
    return BiasScales.between(0.0, last, narrowest_bias(model), step / np.hypot(1.0, mean / sd))


def _bias_scales(
    scales: BiasScales, values: Weights, usual: Weights, count: int = 7
) -> tuple[Weights, Array]:
    """Likely scales Z of the biases of one experiment, with the usual lapses (L,): the shares
    (Z, S) of the tabulated ones in each, and the log of its prior probability (Z,)."""
    if scales.nodes.size == 1:
        return np.ones((1, 1), dtype=np.float32), np.zeros(1)
    top = values.max(axis=(0, 2, 3), keepdims=True)
    # Every animal's k is its own.
    like = np.exp(values - top).sum(axis=2) @ usual
    log_likelihood = np.log(np.maximum(like, LEAST))  # (S, A)

    def log_density(at: Array) -> Array:
        """Prior density of asinh(scale / unit)."""
        scale = scales.unit * np.sinh(at)
        return np.asarray(PRIORS.bias_scale.logpdf(scale) + np.log(scales.unit * np.cosh(at)))

    last = float(np.arcsinh(scales.nodes[-1] / scales.unit))
    at = np.linspace(0.0, last, 128)
    total = scales.onto(scales.unit * np.sinh(at)) @ log_likelihood.sum(axis=1) + log_density(at)
    likely = at[total > total.max() - CUT]
    nodes = np.linspace(max(likely[0] - 2 * at[1], 0.0), min(likely[-1] + 2 * at[1], last), count)
    log_weight = log_density(nodes) + np.log(nodes[1] - nodes[0])
    log_weight[[0, -1]] -= np.log(2.0)  # of a scale of zero that is exact: all is even about it
    return scales.onto(scales.unit * np.sinh(nodes)).astype(np.float32), log_weight


def _of_one(
    values: Weights, k: slice, log_k: Array, x: Array, lapses: Weights, lapse_prior: Array,
    kernel: Array, prior: Array,
) -> Array:  # fmt: skip
    """Log posterior density of the median in one experiment, (U,), whose animals hold nodes `k`.

    `values` (A, K, L) are log-likelihoods; the rest as of `_lapses` and `_fractions`.
    """
    animals = len(values)
    top = values.max(axis=(1, 2), keepdims=True)
    like = np.maximum(np.exp(values - top) @ lapses, LEAST)  # (A, K, J)
    # What lapses there are, whatever k: then the rest for these populations alone.
    log_likelihood = np.log(like.sum(axis=1)).sum(axis=0) + lapse_prior
    kept = np.flatnonzero(log_likelihood > log_likelihood.max() - CUT)
    best = int(np.flatnonzero(kept == log_likelihood.argmax())[0])
    some = like[..., kept].astype(float)
    log_like = np.full((animals, log_k.size, kept.size), -np.inf)
    np.log(some, out=log_like[:, k], where=some > 1e3 * LEAST)
    rows = carried_on(np.swapaxes(log_like, 1, 2).reshape(-1, log_k.size))
    high = rows.max(axis=1, keepdims=True)
    fine = np.exp(CubicSpline(log_k, np.maximum(rows - high, FLOOR), axis=1)(x))
    fine = fine.reshape(animals, kept.size, x.size)  # (A, J, X)
    first = np.log(fine[:, best] @ kernel + 1e-300).sum(axis=0) + prior.ravel()
    likely = np.flatnonzero(first > first.max() - 1.5 * CUT)
    total = np.log(fine @ kernel[:, likely] + 1e-300).sum(axis=0) + prior.ravel()[likely]
    total += (high.reshape(animals, -1).sum(axis=0) + lapse_prior[kept])[:, None]
    joint = np.full(prior.size, -np.inf)
    joint[likely] = log_sum(total, 0)
    mass = np.exp(joint.reshape(prior.shape) - joint.max()).sum(axis=1)
    return np.asarray(np.log(np.maximum(mass, np.exp(FLOOR))) + joint.max() + float(top.sum()))


def _lapses(
    model: WeberModel,
    found: Likelihood,
    animals: int,
    means: tuple[float, float] = (-3.5, 3.5),
    spreads: tuple[float, float] = (0.15, 2.0),
    count: int = 6,
) -> tuple[Weights, Array]:
    """Every population of lapses, as weights (Lo, Hi, J) of nodes between which likelihoods are
    linear, and its log prior (J,).

    `means`, in scores, and `spreads` are where populations are looked for, with so many
    Gauss–Legendre nodes of the logarithm of the spread.
    """
    if found.low.size == found.high.size == 1:
        return np.ones((1, 1, 1), dtype=np.float32), np.zeros(1)
    step = min(0.75 / np.sqrt(animals), 0.35)
    mean = np.arange(means[0], means[1] + step, step)
    log_spread, weight = _legendre(float(np.log(spreads[0])), float(np.log(spreads[1])), count)
    prior = PRIORS.lapse_mean.logpdf(mean)[:, None] + np.log(step)
    prior = prior + PRIORS.lapse_spread.logpdf(np.exp(log_spread)) + log_spread + np.log(weight)
    nodes = LapseNodes.between(model, found.low, found.high, finer=4, lowest=-4.5)
    columns = [nodes.weights(mean, spread) for spread in np.exp(log_spread)]
    weights = np.stack(columns, axis=-1).reshape(found.low.size, found.high.size, -1)
    return weights.astype(np.float32), prior.ravel()


def _fractions(
    model: WeberModel, x: Array, animals: int, beyond: float = 1.0, spreads: int = 10
) -> tuple[Array, Array, Array]:
    """Every population of ln k: medians (U,) up to `beyond` past all animals', and for these and so
    many spreads the weights (X, U·T) of the nodes of ln k, and the log prior (U, T)."""
    h = x[1] - x[0]
    # Nodes of k are 2.8 of the least sd apart, so 2 h is 1.9 of an animal's.
    mu = np.arange(x[0] - beyond, x[-1] + beyond, 2.0 * h / np.sqrt(animals))
    tau, weight = _legendre(0.0, float(PRIORS.spread.ppf(1 - 1e-4)), spreads)
    # A cell's probability, which also holds where the spread is smaller than the cell.
    edges = (x[:, None, None] - mu[:, None]) / tau
    kernel = ndtr(edges + 0.5 * h / tau) - ndtr(edges - 0.5 * h / tau)  # (X, U, T)
    prior = model.priors.log_density("weber_fraction", np.exp(mu)) + mu
    log_prior = prior[:, None] + np.log(weight) + PRIORS.spread.logpdf(tau)
    return mu, kernel.reshape(x.size, -1), log_prior


def _legendre(low: float, high: float, count: int) -> tuple[Array, Array]:
    """Gauss–Legendre nodes between two ends, and their weights."""
    node, weight = np.polynomial.legendre.leggauss(count)
    return low + 0.5 * (node + 1) * (high - low), 0.5 * (high - low) * weight
