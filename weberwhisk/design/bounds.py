"""What no number of trials can reach, found before any experiment is simulated."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import minimize
from scipy.special import rel_entr

from .._util.values import Array, counted
from ..behaviour.priors import SPREAD
from .hypotheses import Goal, Hypothesis, SubjectPopulation
from .scheme import Scheme, sized

__all__ = ["fewest_animals", "known_half_widths", "refuse_impossible", "trials_needed"]


def refuse_impossible(
    scheme: Scheme,
    hypotheses: Sequence[Hypothesis],
    goal: Goal,
    expected: SubjectPopulation,
    vary: str,
    most: int,
    together: bool,
) -> None:
    """Refuse a goal that the animals' spread or the information per trial puts out of reach.

    Either bound is optimistic: animals whose k is known exactly, and trials of an animal of which
    nothing else is unknown.
    """
    what = "trials a comparison" if vary == "trials" else "animals"
    start = f"no design of up to {most} {what} reaches {goal}"
    largest = sized(scheme, vary, most)
    if goal.half_width is not None and together and largest.animals > 1:
        widths = known_half_widths(hypotheses[0], expected, largest.animals)
        share = float((widths < goal.half_width).mean())
        if share < goal.share:
            fewest = fewest_animals(hypotheses[0], expected, goal)
            reached = float(np.quantile(widths, goal.share))
            more = "" if fewest is None else f"animals={fewest} or more, or "
            raise ValueError(
                f"{start}: were the k of each of {counted(largest.animals, 'animal')} known "
                f"exactly, with ln k spread by {expected.spread:g} between animals, the interval "
                f"would be narrow enough in {100 * share:.2g} % of experiments; write {more}"
                f"half_width={np.ceil(100 * reached) / 100:.2g}."
            )
        return
    if vary != "trials" or (goal.bayes_factor is not None and goal.share < 0.5):
        return
    needed, words = trials_needed(scheme, hypotheses, goal, expected)
    if needed > most:
        raise ValueError(
            f"{start}: {words}, which takes {needed:.0f} trials a comparison were nothing else "
            "unknown; set the standards farther apart, take more of them or of animals, or ask "
            "for less."
        )


def known_half_widths(
    hypothesis: Hypothesis, expected: SubjectPopulation, animals: int, runs: int = 256
) -> Array:
    """Half-widths of the population's k over its median, (runs,), were every animal's k known.

    What is left unknown is the mean of ln k, given its prior, and the spread.
    """
    log_k = np.log(expected.weber_fraction) + expected.spread * np.random.default_rng(1).normal(
        size=(runs, animals)
    )
    middle, variance = log_k.mean(axis=1), log_k.var(axis=1)
    node, weight = np.polynomial.legendre.leggauss(60)
    end = float(SPREAD.ppf(1 - 1e-4))
    spread = 0.5 * end * (node + 1)
    # As many sds of the mean as the tails of an unknown spread have.
    away = np.sqrt((variance[:, None] + 1e-12) / animals) * np.linspace(-12, 12, 241)
    square = (variance[:, None] + away**2)[..., None]
    log_like = -animals * (np.log(spread) + square / (2 * spread**2)) + np.log(weight)
    log_like += SPREAD.logpdf(spread)
    top = log_like.max(axis=(1, 2), keepdims=True)
    density = np.exp(log_like - top).sum(axis=2)
    mean = middle[:, None] + away
    density *= np.exp(hypothesis.priors.log_density("weber_fraction", np.exp(mean)) + mean)
    below = np.cumsum(density, axis=1) / density.sum(axis=1, keepdims=True)
    low, half, high = (
        np.array([np.interp(q, b, m) for b, m in zip(below, mean, strict=True)])
        for q in (0.025, 0.5, 0.975)
    )
    return np.asarray((np.exp(high - half) - np.exp(low - half)) / 2)


def fewest_animals(
    hypothesis: Hypothesis, expected: SubjectPopulation, goal: Goal, most: int = 200
) -> int | None:
    """The fewest animals that could reach the goal, were every animal's k known; None past `most`.

    Examples
    --------
    >>> from weberwhisk.behaviour import IdentityEncoding
    >>> weber = Hypothesis("Weber", IdentityEncoding())
    >>> 8 < fewest_animals(weber, SubjectPopulation(), Goal(half_width=0.2)) < 20
    True
    """
    assert goal.half_width is not None
    low, high = 1, most
    if (known_half_widths(hypothesis, expected, most) < goal.half_width).mean() < goal.share:
        return None
    while high - low > 1:
        middle = (low + high) // 2
        widths = known_half_widths(hypothesis, expected, middle)
        enough = (widths < goal.half_width).mean() >= goal.share
        low, high = (low, middle) if enough else (middle, high)
    return high


def trials_needed(
    scheme: Scheme, hypotheses: Sequence[Hypothesis], goal: Goal, expected: SubjectPopulation
) -> tuple[float, str]:
    """Trials of the comparison shown most that the information of a trial demands, and of what.

    For an interval Fisher information of ln k, lapses and bias known: the sd is at least its root's
    inverse. For a Bayes factor the mean log-likelihood ratio to the nearest of the other
    hypothesis, which has any k and biases (Kullback–Leibler divergence).
    """
    cells, most = scheme.cells(), max(map(max, scheme.trials))
    if goal.half_width is not None:
        model = hypotheses[0].model(scheme)
        drawn = expected.draw(64, seed=20)
        lapses = drawn[["lapse_low", "lapse_high"]].to_numpy().T
        bias = np.repeat(
            hypotheses[0].usual_bias + drawn["bias"].to_numpy()[:, None], model.n_groups, axis=1
        )
        k, step = drawn["weber_fraction"].to_numpy(), 1e-3
        below, p, above = (
            model.probability(k * np.exp(d), lapses[0], lapses[1], bias)[0]
            for d in (-step, 0.0, step)
        )
        slope = (above - below) / (2 * step)
        each = (slope**2 / (p * (1 - p))) @ cells.n / most
        wanted = (1.96 / np.arcsinh(goal.half_width)) ** 2
        prior = np.log(hypotheses[0].priors.value("weber_fraction", np.array([-0.5, 0.5])))
        needed = (wanted - np.diff(prior).item() ** -2.0) / each
        return float(np.quantile(needed, goal.share)), f"k to ±{100 * goal.half_width:g} %"
    assert goal.bayes_factor is not None
    hardest, words = 0.0, ""
    for truth in hypotheses:
        p = truth.expected_counts(scheme, expected.weber_fraction, expected.lapse) / cells.n
        for other in hypotheses:
            if other is truth:
                continue
            ratio = scheme.animals * _divergence(other, scheme, p, expected) / most
            needed = float(np.log(goal.bayes_factor) / max(ratio, 1e-12))
            if needed > hardest:
                hardest, words = needed, f"{truth.name} discriminated from {other.name}"
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
