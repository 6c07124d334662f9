"""The test of Weber's law beside rivals of one parameter each."""

from __future__ import annotations

from itertools import product

import numpy as np
import pandas as pd
import pytest
from scipy import stats
from scipy.special import logsumexp, ndtr
from short_forms import slow_but

from weberwhisk.behaviour import (
    FitStatus,
    IdentityEncoding,
    Trials,
    fit_weber,
    read_trials,
    simulate_trials,
    weber_law_test,
)
from weberwhisk.behaviour.effects import Exponent, Floor
from weberwhisk.behaviour.encodings import ConstantNoise

STANDARDS = (300.0, 600.0, 1200.0)


def observed(
    seed: int,
    *,
    exponent: float = 1.0,
    contraction: float = 0.0,
    lapse: float = 0.02,
    each: int = 280,
) -> Trials:
    """Choices between durations whose noise is a power of them, drawn towards their mean."""
    rng = np.random.default_rng(seed)
    standard = rng.permutation(np.repeat(STANDARDS, each))
    ratio = np.exp(rng.choice([-0.35, -0.2, -0.1, 0.1, 0.2, 0.35], standard.size))
    swapped = rng.random(standard.size) < 0.5
    s1, s2 = np.where(swapped, [standard * ratio, standard], [standard, standard * ratio])
    sd = [0.12 * s * (s / 600.0) ** (exponent - 1) for s in (s1, s2)]
    first = s1 + contraction * (standard.mean() - s1)
    p = lapse + (1 - 2 * lapse) * ndtr((s2 - first) / np.hypot(*sd))
    answers = (rng.random(standard.size) < p).astype(int)
    return read_trials(
        pd.DataFrame({"standard": standard, "stimulus_1": s1, "stimulus_2": s2, "choice": answers}),
        in_order=True,
    )


def test_evidence_of_an_exponent_by_brute_force() -> None:
    known = {"lapse_low": 0.02, "lapse_high": 0.02}
    trials = observed(1, each=60)
    fits = [fit_weber(trials, bias="none", priors=known, effects=e) for e in ([], [Exponent()])]
    test = weber_law_test(fits[0])
    s1, s2, yes = (trials.frame[c].to_numpy() for c in ("stimulus_1", "stimulus_2", "count"))
    typical = np.exp(np.log(np.concatenate([s1, s2])).mean())
    log_k, exponent = np.linspace(-5, 1, 241), np.linspace(-2, 4, 241)
    evidence = []
    for at in exponent:
        unit = np.hypot(*(s * (s / typical) ** (at - 1) for s in (s1, s2)))
        p = 0.02 + 0.96 * ndtr((s2 - s1) / unit / np.exp(log_k)[:, None])
        total = np.log(np.where(yes == 1, p, 1 - p)).sum(axis=1)
        prior = stats.norm.logpdf(log_k, np.log(0.1), np.log(3)) + np.log(log_k[1] - log_k[0])
        evidence.append(logsumexp(total + prior))
    believed = fits[1].model.effects[0].prior.logpdf(exponent)
    rival = logsumexp(evidence + believed) + np.log(exponent[1] - exponent[0])
    law = np.interp(1.0, exponent, evidence)
    assert test.rivals.loc["exponent", "log_bayes_factor"] == pytest.approx(law - rival, abs=0.05)
    mass = np.exp(evidence + believed - np.max(evidence + believed))
    middle = np.interp(0.5, np.cumsum(mass) / mass.sum(), exponent)
    assert test.rivals.loc["exponent", "value"] == pytest.approx(middle, abs=0.03)


@pytest.mark.parametrize(
    ("contraction", "bias"),
    slow_but(product([0.0, 0.5], ["shared", "per standard"]), (0,)),
)
@pytest.mark.slow  # of a law that fails: the test after
def test_the_law_is_judged_by_what_made_the_choices(contraction: float, bias: str) -> None:
    obeys = weber_law_test(fit_weber(observed(2, contraction=contraction), bias=bias))
    assert obeys.log_bayes_factor > -np.log(10)
    each = 500 if contraction else 280  # contraction tells less of each trial
    breaks = weber_law_test(
        fit_weber(observed(2, contraction=contraction, exponent=2.0, each=each), bias=bias)
    )
    assert breaks.log_bayes_factor < -np.log(100)
    assert breaks.verdict == "decisive evidence against Weber's law"
    assert breaks.rivals["log_bayes_factor"].idxmin() == "exponent"
    low, high = breaks.rivals.loc["exponent", ["lower", "upper"]]
    assert low < 2.0 < high
    if not contraction:  # which passes for noise at a standard alone
        assert breaks.by_standard["weber_fraction"].is_monotonic_increasing


@pytest.mark.slow
def test_constant_noise_is_an_exponent_of_zero() -> None:
    trials = simulate_trials(
        encoding=ConstantNoise(IdentityEncoding(), 2.0), weber_fraction=0.12,
        standards=[1.0, 2.0, 4.0], trials_per_level=40, seed=4,
    )  # fmt: skip
    test = weber_law_test(fit_weber(trials))
    low, high = test.rivals.loc["exponent", ["lower", "upper"]]
    assert low < 0 < high < 1
    assert test.log_bayes_factor < -np.log(100)


def levels(unit: float, slope: float) -> Trials:
    """Choices between levels on a log axis, whose noise changes along it by a factor a unit."""
    rng = np.random.default_rng(8)
    standard = rng.choice([-2.0, 0.0, 2.0], 1500)
    second = standard + rng.choice([-0.6, -0.3, 0.3, 0.6], 1500)
    p = 0.02 + 0.96 * ndtr((second - standard) / (0.35 * np.exp(slope * (standard + second) / 2)))
    answers = (rng.random(1500) < p).astype(int)
    table = {"standard": unit * standard, "stimulus_1": unit * standard}
    return read_trials(
        pd.DataFrame(table | {"stimulus_2": unit * second, "choice": answers}), scale="log"
    )


@pytest.mark.parametrize("slope", slow_but([0.0, 0.25], (1,)))
def test_levels_of_unknown_unit_have_a_law_of_constant_noise(slope: float) -> None:
    one, other = (weber_law_test(fit_weber(levels(unit, slope))) for unit in (1.0, 8.7))
    assert one.rivals.index.tolist() == ["exponent"]
    np.testing.assert_allclose(one.rivals, other.rivals, atol=0.05)
    # The standards are taken to span ln 4 in place of 4 units.
    low, high = one.rivals.loc["exponent", ["lower", "upper"]]
    assert low < 1 + slope * 4 / np.log(4) < high
    assert (one.log_bayes_factor < -np.log(100)) == (slope > 0)


@pytest.mark.parametrize("sets", slow_but([12, 24], (0,)))
@pytest.mark.slow
def test_the_least_departure_shown_is_that_of_half_the_data_sets(sets: int) -> None:
    """Of observers that depart so far, some half give strong evidence, and fewer decisive.

    The evidence is that of an exponent beside none, for the observer who made the choices.
    """
    far = np.mean(
        [weber_law_test(fit_weber(observed(i))).least_shown for i in range(5, 5 + sets // 8)]
    )
    law, power = (
        [fit_weber(observed(10 + i, exponent=1 + far), effects=e).log_evidence for i in range(sets)]
        for e in ([], [Exponent()])
    )
    shown = np.subtract(law, power) < -np.log(10)
    assert abs(sum(shown) - sets / 2) <= 2.5 * np.sqrt(sets / 4)  # sds of a binomial


@pytest.mark.slow
def test_nothing_is_said_where_the_model_does_not_hold() -> None:
    """Streaks of guesses are no noise of any exponent."""
    trials = observed(4, each=80)
    frame = trials.frame.copy()
    frame.loc[: len(frame) // 3, "count"] = 1.0
    streaks = read_trials(
        frame.drop(columns=["n"]).rename(columns={"count": "choice"}), in_order=True
    )
    test = weber_law_test(fit_weber(streaks))
    assert test.status.name.startswith("MISFIT")
    assert test.verdict.startswith("nothing can be said of Weber's law")


def test_what_cannot_be_tested_is_refused() -> None:
    with pytest.raises(ValueError, match="two standards or more"):
        weber_law_test(fit_weber(simulate_trials(seed=24)))
    two = simulate_trials(standards=[1.0, 2.0], seed=24)
    with pytest.raises(ValueError, match="got a fit with floor; fit without"):
        weber_law_test(fit_weber(two, effects=[Floor()]))
    with pytest.raises(ValueError, match="the Weber fraction is fixed"):
        weber_law_test(fit_weber(two, priors={"weber_fraction": 0.1}))


def test_what_it_says_goes_to_json() -> None:
    said = weber_law_test(fit_weber(observed(2, each=60))).to_dict()
    assert set(said["rivals"]) == {"exponent", "floor"}  # type: ignore[call-overload]
    assert said["status"] in {status.name for status in FitStatus}
