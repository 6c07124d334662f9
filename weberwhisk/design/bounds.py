"""Bounds on what any number of trials, or of animals, can do: by them goals are refused at once."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import minimize
from scipy.special import logsumexp, rel_entr

from .._util.values import Array, density_quantiles
from .hypotheses import Hypothesis, SubjectPopulation
from .population_grid import spread_nodes
from .scheme import Scheme

__all__ = [
    "fewest_animals", "least_half_widths", "trials_for_bayes_factor", "trials_for_half_width",
]  # fmt: skip


def least_half_widths(
    hypothesis: Hypothesis, expected: SubjectPopulation, animals: int, runs: int = 256
) -> Array:
    """Half-widths of the population's k over its median, (runs,), were every animal's k given.

    Unknown are then the mean of ln k, given its prior, and the sd between animals.
    """
    log_k = np.log(expected.weber_fraction) + expected.spread * np.random.default_rng(1).normal(
        size=(runs, animals)
    )
    middle, variance = log_k.mean(axis=1), log_k.var(axis=1)
    sds, log_spread = spread_nodes(60)
    # As many sds of the mean as the tails of an unknown spread have.
    away = np.sqrt((variance[:, None] + 1e-12) / animals) * np.linspace(-12, 12, 241)
    square = variance[:, None] + 1e-12 + away**2
    # The likelihood of the mean depends on that square alone.
    table = np.geomspace(square.min(), square.max(), 500)
    log_like = -animals * (np.log(sds) + table[:, None] / (2 * sds**2))
    log_like = logsumexp(log_like + log_spread, axis=1)
    density = np.interp(np.log(square), np.log(table), log_like)
    density = np.exp(density - density.max(axis=1, keepdims=True))
    mean = middle[:, None] + away
    density *= np.exp(hypothesis.priors.log_density("weber_fraction", np.exp(mean)) + mean)
    low, half, high = density_quantiles(mean, density, [0.025, 0.5, 0.975]).T
    return np.asarray((np.exp(high - half) - np.exp(low - half)) / 2)


def fewest_animals(
    hypothesis: Hypothesis,
    expected: SubjectPopulation,
    half_width: float,
    *,
    share: float,
    most: int = 200,
) -> int | None:
    """The fewest animals with which a share of intervals is narrow enough, were every k given.

    None past `most`.

    Examples
    --------
    >>> from weberwhisk.behaviour import IdentityEncoding
    >>> weber = Hypothesis("Weber", IdentityEncoding())
    >>> 8 < fewest_animals(weber, SubjectPopulation(), 0.2, share=0.8) < 20
    True
    """

    def enough(animals: int) -> bool:
        narrow = least_half_widths(hypothesis, expected, animals) < half_width
        return bool(narrow.mean() >= share)

    low, high = 1, most
    if not enough(most):
        return None
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if enough(middle) else (middle, high)
    return high


def trials_for_half_width(
    scheme: Scheme,
    hypothesis: Hypothesis,
    expected: SubjectPopulation,
    half_width: float,
    *,
    share: float,
) -> float:
    """Trials of the comparison shown most with which a share of intervals of k could be so narrow.

    By the Fisher information of ln k, lapses and bias given: the sd is at least its root's inverse.
    """
    cells, most = scheme.cells(), max(map(max, scheme.trials))
    model = hypothesis.model(scheme)
    drawn = expected.draw(64, seed=20)
    lapses = drawn[["lapse_low", "lapse_high"]].to_numpy().T
    bias = np.repeat(
        hypothesis.usual_bias + drawn["bias"].to_numpy()[:, None], model.n_groups, axis=1
    )
    k, step = drawn["weber_fraction"].to_numpy(), 1e-3
    below, p, above = (
        model.probability(k * np.exp(d), lapses[0], lapses[1], bias)[0] for d in (-step, 0.0, step)
    )
    slope = (above - below) / (2 * step)
    information = (slope**2 / (p * (1 - p))) @ cells.n / most  # of one trial of that comparison
    needed = (1.96 / np.arcsinh(half_width)) ** 2
    prior = np.log(hypothesis.priors.value("weber_fraction", np.array([-0.5, 0.5])))
    return float(np.quantile((needed - np.diff(prior).item() ** -2.0) / information, share))


def trials_for_bayes_factor(
    scheme: Scheme,
    hypotheses: Sequence[Hypothesis],
    expected: SubjectPopulation,
    bayes_factor: float,
) -> tuple[float, str]:
    """Trials of the comparison shown most that a Bayes factor takes on average, and between what.

    By the mean log-likelihood ratio of the truth to the nearest that a rival hypothesis has, with
    any k and biases (Kullback–Leibler divergence), of the two hypotheses that are hardest to
    discriminate.
    """
    cells, most = scheme.cells(), max(map(max, scheme.trials))
    hardest, words = 0.0, ""
    for truth in hypotheses:
        p = truth.expected_counts(scheme, expected.weber_fraction, expected.lapse) / cells.n
        for rival in hypotheses:
            if rival is truth:
                continue
            ratio = scheme.animals * _divergence(rival, scheme, p, expected) / most
            needed = float(np.log(bayes_factor) / max(ratio, 1e-12))
            if needed > hardest:
                hardest, words = needed, f"{truth.name} discriminated from {rival.name}"
    return hardest, words


def _divergence(
    hypothesis: Hypothesis, scheme: Scheme, p: Array, expected: SubjectPopulation
) -> float:
    """Mean log-likelihood ratio of one animal's table to the nearest that a hypothesis has."""
    model, n = hypothesis.model(scheme), scheme.cells().n
    lapse, middle = np.array([expected.lapse]), np.log(expected.weber_fraction)

    def ratio(theta: Array) -> float:
        bias = theta[1:] if model.free_bias else 0.0
        biases = hypothesis.usual_bias + np.broadcast_to(bias, (1, model.n_groups))
        q = model.probability(np.exp(middle + theta[:1]), lapse, lapse, biases)[0][0]
        return float(n @ (rel_entr(p, q) + rel_entr(1 - p, 1 - q)))

    start = np.zeros(1 + model.n_groups * model.free_bias)
    return float(minimize(ratio, start, method="BFGS").fun)
