"""Trials placed one by one: the package's own likelihood, exact information, fewer trials."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy import stats
from scipy.integrate import quad
from short_forms import slow_but

import weberwhisk as ww
from weberwhisk.behaviour import (
    IdentityEncoding,
    LogEncoding,
    Priors,
    fit_weber,
    response_probability,
    simulate_trials,
)
from weberwhisk.design import (
    BayesianPlacer,
    Hypothesis,
    Scheme,
    lattice,
    next_trial,
    taper,
)

W = ww.Whisker(50e-3, 100e-6, 5e-6)
PLAIN = Hypothesis("Weber", IdentityEncoding(), bias="shared")
QUIET = Priors(lapse_low=0.02, lapse_high=0.02)


def animal(h: Hypothesis, seed: int, k: float = 0.1, lapse: float = 0.03, bias: float = 0.0) -> Any:
    """Answers of an observer."""
    rng = np.random.default_rng(seed)

    def answer(standard: float, comparison: float) -> int:
        chance = response_probability(
            h.asked, h.encoding, standard, comparison, weber_fraction=k,
            lapse_low=lapse, lapse_high=lapse, bias=bias,
        )  # fmt: skip
        return int(rng.random() < chance[0])

    return answer


def session(placer: Any, n: int, answer: Any) -> Any:
    for _ in range(n):
        trial = placer.next()
        placer.record(trial.standard, trial.comparison, answer(trial.standard, trial.comparison))
    return placer


# -- the belief is the fit's posterior -----------------------------------------------------------

TAPER = taper(W)
KNOWN = Hypothesis("known", IdentityEncoding(), Priors(lapse_low=0.01, lapse_high=0.0, bias=0.1),
                   bias="shared")  # fmt: skip
FLAT = Hypothesis("flat", IdentityEncoding(), Priors(lapse_low=stats.beta(1, 1),
                  lapse_high=stats.beta(1, 1)), bias="shared")  # fmt: skip
CORRECT = Hypothesis("correct", IdentityEncoding(), bias="none", task="3AFC percent correct")


@pytest.mark.parametrize(
    ("hypotheses", "standards", "n"),
    slow_but(
        [
            ([PLAIN], [1.0], 20),
            ([PLAIN], [1.0], 300),
            ([Hypothesis("Weber", IdentityEncoding())], [0.5, 2.0], 150),
            ([KNOWN], [1.0], 100),
            ([FLAT], [1.0], 200),
            ([CORRECT], [1.0], 100),
            ([Hypothesis("log", LogEncoding(), bias="shared")], [0.0], 60),
            (TAPER, [0.3 * W.length, 0.8 * W.length], 120),
        ],
        (2, 5, 7),
    ),
    ids=["few", "many", "biases", "known", "flat lapses", "percent correct", "log", "whisker"],
)
def test_the_belief_agrees_with_the_fit_of_the_same_trials(hypotheses, standards, n):
    """Quantiles of k to a twentieth of the posterior sd, and the evidence to 5 %."""
    scheme = lattice(hypotheses[-1].encoding, standards)
    placer = BayesianPlacer(hypotheses, scheme, seed=2)
    session(placer, n, animal(hypotheses[0], seed=n, bias=0.2 * hypotheses[0].asked.has_bias))
    for name, fit in placer.fits().items():
        at = [0.025, 0.5, 0.975]
        off = placer.beliefs[name].quantile(np.array(at)) - fit.posterior.quantile(
            "weber_fraction", at
        )
        assert np.abs(off).max() < 0.05 * fit.posterior.sd("weber_fraction")
        assert placer.beliefs[name].log_evidence == pytest.approx(fit.log_evidence, abs=0.05)


# -- the objective -------------------------------------------------------------------------------


def test_information_is_the_integral_that_it_says():
    """k alone unknown: I = H(∫ p π) − ∫ H(p) π by SciPy's quadrature and the textbook's Φ."""
    h = Hypothesis("k alone", IdentityEncoding(), QUIET, bias="none")
    scheme = Scheme([2.0], [[-1.0, -0.3, 0.02, 0.1, 0.5, 1.5]])
    found = BayesianPlacer(h, scheme, seed=1).information()
    prior = stats.lognorm(np.log(3.0), scale=0.1)

    def entropy(p: float) -> float:
        return float(-p * np.log2(p) - (1 - p) * np.log2(1 - p))

    def chance(k: float, s2: float) -> float:
        return 0.02 + 0.96 * float(stats.norm.cdf((s2 - 2) / (k * np.hypot(2, s2))))

    def mean(f: Any) -> float:
        return quad(lambda z: f(prior.ppf(stats.norm.cdf(z))) * stats.norm.pdf(z), -6, 6,
                    limit=200)[0]  # fmt: skip

    for s2, bits in zip(scheme.comparisons[0], found, strict=True):
        whole = entropy(mean(lambda k, s2=s2: chance(k, s2)))
        left = mean(lambda k, s2=s2: entropy(chance(k, s2)))
        assert bits == pytest.approx(whole - left, abs=1e-4)


@pytest.mark.parametrize("goal", slow_but(["weber_fraction", "hypothesis", "everything"], (2,)))
def test_lapses_and_bias_are_integrated_out(goal):
    """Brute force: draws of all parameters from their priors, and means over them."""
    priors = Priors(lapse_low=stats.beta(2, 18), lapse_high=stats.beta(1, 9), lapse_correlation=0,
                    bias=stats.norm(0, 1))  # fmt: skip
    tapered, cylinder = (Hypothesis(h.name, h.encoding, priors, bias="shared") for h in taper(W))
    scheme = Scheme([40e-3], [[-20e-3, -4e-3, -1e-3, 1e-3, 3e-3, 9e-3]])
    found = BayesianPlacer([tapered, cylinder], scheme, goal=goal, seed=1).information()
    rng = np.random.default_rng(5)
    inner, nodes = 20_000, np.linspace(-4, 4, 31)
    weight = stats.norm.pdf(nodes) / stats.norm.pdf(nodes).sum()
    low, high = priors.lapse_low.rvs(inner, rng), priors.lapse_high.rvs(inner, rng)
    bias = rng.normal(size=inner)

    def entropy(p: np.ndarray) -> np.ndarray:
        return -p * np.log2(p) - (1 - p) * np.log2(1 - p)

    given_k, given_all = [], []
    for h in (tapered, cylinder):
        p = np.array([
            response_probability(
                h.asked, h.encoding, 40e-3, scheme.comparisons[0],
                weber_fraction=0.1 * 3.0**z, lapse_low=low, lapse_high=high, bias=bias,
            )
            for z in nodes
        ])  # fmt: skip
        given_k.append(p.mean(axis=1))
        given_all.append(weight @ entropy(p).mean(axis=1))
    given_k = np.array(given_k)
    given = np.einsum("k,hkc->hc", weight, given_k)
    if goal == "hypothesis":
        bits = entropy(given.mean(axis=0)) - entropy(given).mean(axis=0)
    elif goal == "everything":
        bits = entropy(given.mean(axis=0)) - np.mean(given_all, axis=0)
    else:
        left = np.einsum("k,hkc->hc", weight, entropy(given_k))
        bits = (entropy(given) - left).mean(axis=0)
    # Four standard errors of a mean over 20 000 draws of a bias of sd 1.
    assert found == pytest.approx(bits, abs=4e-3)


def test_nearly_as_good_trials_are_drawn_at_random_and_replayed():
    scheme = lattice(PLAIN.encoding, 1.0)
    placer = session(BayesianPlacer(PLAIN, scheme, seed=3), 30, animal(PLAIN, seed=1))
    bits = placer.information()
    trial = placer.next()
    assert trial.easy or trial.information >= 0.95 * bits.max()
    again = BayesianPlacer(PLAIN, scheme, seed=3)
    for s1, s2, choice in placer.trials().frame[["stimulus_1", "stimulus_2", "count"]].to_numpy():
        assert again.next() == again.next()
        assert (again.next().standard, again.next().comparison) == (s1, s2)
        again.record(s1, s2, int(choice))
    assert again.next() == trial
    assert next_trial(placer.trials(), PLAIN, scheme, seed=3) == trial
    other = session(BayesianPlacer(PLAIN, scheme, seed=4), 30, animal(PLAIN, seed=1))
    assert (
        other.trials().frame["stimulus_2"].tolist() != placer.trials().frame["stimulus_2"].tolist()
    )


def test_stops_when_the_interval_is_narrow_or_the_trials_are_many():
    placer = BayesianPlacer(PLAIN, lattice(PLAIN.encoding, 1.0), width=0.5, most=300, seed=1)
    answer, n = animal(PLAIN, seed=1), 0
    while not placer.finished:
        trial = placer.next()
        placer.record(trial.standard, trial.comparison, answer(trial.standard, trial.comparison))
        n += 1
    low, high = placer.fits()["Weber"].interval(0.95)
    assert "is narrow enough" in placer.finished
    assert 20 < n < 300
    assert (high - low) / (high + low) < 0.55
    few = session(BayesianPlacer(PLAIN, lattice(PLAIN.encoding, 1.0), most=3, seed=1), 3, answer)
    assert few.finished == "3 trials, as many as wanted"


# -- the trials saved ----------------------------------------------------------------------------


@pytest.mark.slow
def test_information_saves_trials():
    """k twice what was expected: a narrower interval than constant stimuli for the expected k."""
    levels = [-2.0, -1.2, -0.6, 0.6, 1.2, 2.0]
    constant = Scheme.spaced(PLAIN.encoding, [1.0], levels=levels, weber_fraction=0.1)
    halves = {"information": [], "constant": []}
    for seed in range(16):
        placer = BayesianPlacer(PLAIN, lattice(PLAIN.encoding, 1.0), seed=seed)
        session(placer, 120, animal(PLAIN, seed=seed, k=0.2))
        low, high = placer.interval()
        halves["information"].append((high - low) / (high + low))
        trials = simulate_trials(
            weber_fraction=0.2, comparisons=constant.comparisons[0], trials_per_level=20,
            lapse_low=0.03, lapse_high=0.03, seed=seed,
        )  # fmt: skip
        low, high = fit_weber(trials).interval()
        halves["constant"].append((high - low) / (high + low))
    # 0.86: some trials go to where a large bias, which is believed possible, would show.
    assert np.median(halves["information"]) < 0.9 * np.median(halves["constant"])


# -- what is refused -----------------------------------------------------------------------------


def test_bad_input_in_one_sentence():
    scheme = lattice(PLAIN.encoding, 1.0)
    for options, words in (
        ({"goal": "k"}, "goal 'k' is unknown"),
        ({"goal": "hypothesis"}, "one hypothesis cannot be distinguished from others"),
        ({"easy_share": 1.0}, "easy_share must lie between 0 and 1"),
        ({"easy_share": np.nan}, "easy_share must be finite"),
        ({"width": 0.0}, "width must be above zero"),
        ({"most": 0}, "most must be above zero"),
    ):
        with pytest.raises(ValueError, match=words):
            BayesianPlacer(PLAIN, scheme, **options)
    placer = BayesianPlacer(PLAIN, scheme)
    for trial, words in (
        ((1.0, 1.1, 2), "choice must be 1"),
        ((1.0, 1.1, "yes"), "choice must be 1"),
        ((1.0, np.nan, 1), "comparison must be finite"),
        ((1.0, -1.0, 1), "lies outside what can be encoded"),
        (("far", 1.0, 1), "standard must be a number"),
    ):
        with pytest.raises(ValueError, match=words):
            placer.record(*trial)
    assert len(placer.trials()) == 0
    with pytest.raises(ValueError, match="mass must lie between 0 and 1"):
        placer.interval(95)
