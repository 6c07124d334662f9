"""Several animals of one population, experiment by experiment: each one's own integrated out.

The model is that of `fit_population`: ln k of the animals is normal about the population's median,
the normal scores of their lapses are normal with one mean and spread for both ends, and biases are
those of their prior times one factor. All animals of all experiments share their nodes (`tables`),
so a population is a set of weights of these nodes, tabulated once, and integrals are matrix
products.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.special import ndtr

from ..behaviour.integrate.batch import (
    Likelihood,
    batch_steps,
    carried_on,
    log_sum,
    narrowest_bias,
)
from ..behaviour.integrate.blocks import NOTHING
from ..behaviour.integrate.windows import Steps
from ..behaviour.lapses import AS_BELIEVED, BiasScales, with_tail
from ..behaviour.likelihood import WeberModel
from ..behaviour.priors import PopulationPriors

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

LEAST = 1e-30  # of a likelihood
FLOOR = -60.0  # nats under the best, where nothing is left
CUT = 14.0  # nats under the best, where populations are left out
PRIORS = PopulationPriors()  # made once: that costs a hundred times what is asked of it


@dataclass(frozen=True)
class _Lapses:
    """Populations of lapses: `weights` (Lo, Hi, J) of the nodes, and `log_prior` (J,)."""

    weights: NDArray[np.float32]
    log_prior: Array

    def at(self, inside: tuple[slice, ...]) -> NDArray[np.float32]:
        """Weights of some of the nodes."""
        return self.weights[inside]

    @property
    def flat(self) -> NDArray[np.float32]:
        """Weights (L, J) of all nodes in a row."""
        return self.weights.reshape(-1, self.weights.shape[-1])


@dataclass(frozen=True)
class _Fractions:
    """Populations of ln k: medians `mu` (U,), and for each and every spread the prior and weights.

    `kernel` (X, U·T), of the nodes of ln k; `log_prior` (U, T).
    """

    mu: Array
    kernel: Array
    log_prior: Array


def populations(
    model: WeberModel, found: Likelihood, animals: int, finer: int = 3
) -> tuple[Array, Array, Array]:
    """Medians mu of ln k (U,), even; their log posterior density (D, U), and the log evidence (D,).

    `found` is of D·A animals, those of an experiment together; there are `finer` nodes between
    those of k.
    """
    log_k = np.log(model.value("weber_fraction", found.scores))
    lapses = _lapses(model, found, animals)
    x = np.linspace(log_k[0], log_k[-1], finer * (log_k.size - 1) + 1)
    fractions = _fractions(model, x, animals)
    experiments = found.values.shape[-1] // animals
    out = np.empty((experiments, fractions.mu.size))
    scales = len(found.values)
    for i in range(experiments):
        own = found.values[..., i * animals : (i + 1) * animals]
        inside, k = _cropped(found, own)
        own = own[:, *inside].reshape(scales, k.size, -1, animals)
        own = np.ascontiguousarray(np.moveaxis(own, -1, 1))  # (S, A, K, L)
        few = _Lapses(lapses.at(inside[1:]), lapses.log_prior)
        shares, log_weight = _bias_scales(found.scales, own, few)
        by_scale = (shares @ own.reshape(scales, -1)).reshape(-1, *own.shape[1:])
        given = np.array([_of_one(values, k, log_k, x, few, fractions) for values in by_scale])
        out[i] = log_sum(log_weight[:, None] + given, 0)
    step = fractions.mu[1] - fractions.mu[0]
    return fractions.mu, out, log_sum(out, 1) + np.log(step)


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


def _cropped(found: Likelihood, own: NDArray[np.float32]) -> tuple[tuple[slice, ...], Indices]:
    """The nodes (K, Lo, Hi) that some animal of one experiment holds, and those of k by number.

    All data sets share their nodes, of which the animals of one hold a tenth to a third.
    """
    held = (own[0] > 0.5 * NOTHING).any(axis=-1)
    spans = []
    for axis in range(3):
        some = np.flatnonzero(held.any(axis=tuple(a for a in range(3) if a != axis)))
        spans.append(slice(int(some[0]), int(some[-1]) + 1))
    return tuple(spans), np.arange(found.scores.size)[spans[0]]


def _bias_scales(
    scales: BiasScales, values: NDArray[np.float32], lapses: _Lapses, count: int = 7
) -> tuple[NDArray[np.float32], Array]:
    """Likely scales Z of the biases of one experiment: the shares (Z, S) of the tabulated ones in
    each, and the log of its prior probability (Z,)."""
    if scales.nodes.size == 1:
        return np.ones((1, 1), dtype=np.float32), np.zeros(1)
    # With likely lapses, and every animal's k its own.
    usual = lapses.flat[:, int(np.argmax(lapses.log_prior))]
    top = values.max(axis=(0, 2, 3), keepdims=True)
    log_likelihood = np.log(np.exp(values - top).sum(axis=2) @ usual + LEAST)  # (S, A)
    prior = PRIORS.bias_scale

    def log_density(at: Array) -> Array:
        """Prior density of asinh(scale / unit)."""
        return np.asarray(
            prior.logpdf(scales.unit * np.sinh(at)) + np.log(scales.unit * np.cosh(at))
        )

    last = float(np.arcsinh(scales.nodes[-1] / scales.unit))
    at = np.linspace(0.0, last, 128)
    total = scales.onto(scales.unit * np.sinh(at)) @ log_likelihood.sum(axis=1) + log_density(at)
    likely = at[total > total.max() - CUT]
    nodes = np.linspace(max(likely[0] - 2 * at[1], 0.0), min(likely[-1] + 2 * at[1], last), count)
    log_weight = log_density(nodes) + np.log(nodes[1] - nodes[0])
    log_weight[[0, -1]] -= np.log(2.0)  # of a scale of zero that is exact: all is even about it
    shares = scales.onto(scales.unit * np.sinh(nodes)).astype(np.float32)
    return shares, log_weight


def _of_one(
    values: NDArray[np.float32],
    k: Indices,
    log_k: Array,
    x: Array,
    lapses: _Lapses,
    fractions: _Fractions,
) -> Array:
    """Log posterior density of the median in one experiment, (U,), whose animals hold nodes `k`."""
    animals = len(values)  # (A, K, L)
    top = values.max(axis=(1, 2), keepdims=True)
    like = np.maximum(np.exp(values - top) @ lapses.flat, LEAST)  # (A, K, J)
    # What lapses there are, whatever k: then the rest for these populations alone.
    log_likelihood = np.log(like.sum(axis=1)).sum(axis=0) + lapses.log_prior
    kept = np.flatnonzero(log_likelihood > log_likelihood.max() - CUT)
    best = int(np.flatnonzero(kept == log_likelihood.argmax())[0])
    some = like[..., kept].astype(float)
    log_like = np.full((animals, log_k.size, kept.size), -np.inf)
    np.log(some, out=log_like[:, k[0] : k[-1] + 1], where=some > 1e3 * LEAST)
    rows = carried_on(np.swapaxes(log_like, 1, 2).reshape(-1, log_k.size))
    high = rows.max(axis=1, keepdims=True)
    fine = np.exp(CubicSpline(log_k, np.maximum(rows - high, FLOOR), axis=1)(x))
    fine = fine.reshape(animals, kept.size, x.size)  # (A, J, X)
    prior = fractions.log_prior.ravel()
    first = np.log(fine[:, best] @ fractions.kernel + 1e-300).sum(axis=0) + prior
    likely = np.flatnonzero(first > first.max() - 1.5 * CUT)
    total = np.log(fine @ fractions.kernel[:, likely] + 1e-300).sum(axis=0) + prior[likely]
    total += (high.reshape(animals, -1).sum(axis=0) + lapses.log_prior[kept])[:, None]
    joint = np.full(prior.size, -np.inf)
    joint[likely] = log_sum(total, 0)
    by_median = joint.reshape(fractions.log_prior.shape)
    peak = by_median.max()
    mass = np.exp(by_median - peak).sum(axis=1)
    return np.asarray(np.log(np.maximum(mass, np.exp(FLOOR))) + peak + float(top.sum()))


def _lapses(
    model: WeberModel,
    found: Likelihood,
    animals: int,
    means: tuple[float, float] = (-3.5, 3.5),
    spreads: tuple[float, float] = (0.15, 2.0),
    count: int = 6,
) -> _Lapses:
    """Every population of lapses, as weights of nodes between which likelihoods are linear.

    `means`, in scores, and `spreads` are where populations are looked for, with so many
    Gauss–Legendre nodes of the logarithm of the spread.
    """
    names = model.lead[-2:]
    parts = [
        _between(model, name, axis)
        for name, axis in zip(names, (found.low, found.high), strict=True)
    ]
    if found.low.size == found.high.size == 1:
        return _Lapses(np.ones((1, 1, 1), dtype=np.float32), np.zeros(1))
    priors = PRIORS
    step = min(0.75 / np.sqrt(animals), 0.35)
    mean = np.arange(means[0], means[1] + step, step)
    ends = np.log(spreads)
    node, weight = np.polynomial.legendre.leggauss(count)
    log_spread = ends[0] + 0.5 * (node + 1) * (ends[1] - ends[0])
    prior = priors.lapse_mean.logpdf(mean)[:, None] + np.log(step)
    prior = prior + priors.lapse_spread.logpdf(np.exp(log_spread)) + log_spread
    prior += np.log(0.5 * weight * (ends[1] - ends[0]))
    free = [axis.size > 1 for axis in (found.low, found.high)]
    rho = model.priors.lapse_correlation if all(free) else 0.0
    columns = []
    for spread in np.exp(log_spread):
        u, v = (
            (score[:, None] - mean) / spread if is_free else np.zeros((1, mean.size))
            for (score, _, _), is_free in zip(parts, free, strict=True)
        )
        square = u[:, None] ** 2 + v[None] ** 2 - 2 * rho * u[:, None] * v[None]
        density = np.exp(-0.5 * square / (1 - rho**2)) / np.sqrt(1 - rho**2)
        scale = (spread * np.sqrt(2 * np.pi)) ** sum(free)
        density *= parts[0][1][:, None, None] * parts[1][1][:, None] / scale
        columns.append(
            np.einsum("li,hj,lhm->ijm", parts[0][2], parts[1][2], density, optimize=True)
        )
    weights = np.stack(columns, axis=-1).reshape(found.low.size, found.high.size, -1)
    lo, hi = (model.at(n, a) for n, a in zip(names, (found.low, found.high), strict=True))
    lost = np.add(*model.lapses(lo[:, None], hi[None]))
    weights[np.broadcast_to(lost >= 1, (lo.size, hi.size))] = 0.0
    return _Lapses(weights.astype(np.float32), prior.ravel())


def _between(
    model: WeberModel, name: str, axis: Array, finer: int = 4
) -> tuple[Array, Array, Array]:
    """Fine scores (F,), their width, and what each takes of every node, (F, N)."""
    if axis.size == 1:
        return np.zeros(1), np.ones(1), np.ones((1, 1))
    transform = model.transforms[model.lead.index(name)]
    below = with_tail(model, name, axis)
    step = (axis[1] - axis[0]) / finer
    fine = np.arange(below[0], axis[-1] + 0.5 * step, step)
    # Below the first node, where there is none, the likelihood is that of none.
    share = np.stack([np.interp(fine, axis, one) for one in np.eye(axis.size)], axis=1)
    return transform.score(fine), transform.slope(fine) * step, share


def _fractions(
    model: WeberModel, x: Array, animals: int, beyond: float = 1.0, spreads: int = 10
) -> _Fractions:
    """Every population of ln k: medians up to `beyond` past all animals', and so many
    Gauss–Legendre nodes of their spread."""
    h = x[1] - x[0]
    # Nodes of k are 2.8 of the least sd apart, so 2 h is 1.9 of an animal's.
    mu = np.arange(x[0] - beyond, x[-1] + beyond, 2.0 * h / np.sqrt(animals))
    spread = PRIORS.spread
    node, weight = np.polynomial.legendre.leggauss(spreads)
    widest = float(spread.ppf(1 - 1e-4))
    tau = 0.5 * widest * (node + 1)
    log_weight = np.log(0.5 * widest * weight) + spread.logpdf(tau)
    # A cell's probability, which also holds where the spread is smaller than the cell.
    edges = (x[:, None, None] - mu[:, None]) / tau
    kernel = ndtr(edges + 0.5 * h / tau) - ndtr(edges - 0.5 * h / tau)  # (X, U, T)
    log_prior = (model.priors.log_density("weber_fraction", np.exp(mu)) + mu)[:, None] + log_weight
    return _Fractions(mu, kernel.reshape(x.size, -1), log_prior)
