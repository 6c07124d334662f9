"""Fits of data that tell little, recovery of what was simulated, and real data."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from choice_tables import NINE, counted
from scipy import stats
from scipy.interpolate import CubicSpline
from short_forms import slow_but

from weberwhisk.behaviour import (
    FitStatus,
    LogEncoding,
    Priors,
    fit_weber,
    load_numerosity,
    load_rat_auditory,
    read_trials,
    simulate_trials,
    task_named,
)
from weberwhisk.behaviour.effects import History
from weberwhisk.behaviour.encodings import IdentityEncoding
from weberwhisk.behaviour.importance import ImportancePosterior
from weberwhisk.behaviour.psychometric import threshold

ENDS = [0.025, 0.5, 0.975]


# -- trouble --------------------------------------------------------------------------------------


def test_perfect_performance_bounds_from_above() -> None:
    fit = fit_weber(counted([0.8, 0.9, 1.1, 1.2], 25, [0, 0, 25, 25]))
    assert fit.status is FitStatus.UPPER_BOUND
    low, high = fit.interval()
    # Were k 0.1, 50 trials at ±10 % (76 % right) would all be right once in 10⁶.
    assert high < 0.1
    # The lower end is the prior's: far below anything the levels could show.
    assert low < 0.01
    assert "Every level is answered all one way" in fit.notes[0]
    assert "Harder comparisons" in fit.report()


def test_reversed_labels_are_found() -> None:
    right = simulate_trials(trials_per_level=20, seed=30)
    wrong = replace(right, frame=right.frame.assign(count=1 - right.frame["count"]))
    fit = fit_weber(wrong)
    assert fit.status is FitStatus.REVERSED
    assert "means nothing" in fit.report()
    assert "check which answer means which stimulus" in fit.report()
    assert fit_weber(counted([0.8, 1.2], 30, [30, 0])).status is FitStatus.REVERSED
    odd = simulate_trials(task="3AFC percent correct", seed=31)
    never = replace(odd, frame=odd.frame.assign(count=0.0))
    assert fit_weber(never).status is FitStatus.REVERSED


def test_chance_performance_does_not_claim_a_weber_fraction() -> None:
    fit = fit_weber(counted(NINE.tolist(), 40, [20] * 9))
    assert "Easier comparisons" in fit.report()
    for seed in range(1):
        rng = np.random.default_rng(seed)
        fit = fit_weber(counted(NINE.tolist(), 40, rng.binomial(40, 0.5, 9).tolist()))
        # Either the animal feels nothing, or it does not attend: small k is not quite excluded.
        assert fit.status in (FitStatus.LOWER_BOUND, FitStatus.UNINFORMED)
        low, high = fit.interval()
        assert high > 1.0
        assert high / low > 5


@pytest.mark.parametrize(("task", "share"), [("2AFC", 0), ("yes/no", 1)])
def test_one_answer_to_everything_tells_no_weber_fraction(task: str, share: int) -> None:
    frame = pd.DataFrame({"standard": 1.0, "comparison": NINE, "n": 40, "n_greater": 40 * share})
    fit = fit_weber(read_trials(frame, task=task))
    assert fit.status is FitStatus.ONE_SIDED
    assert not fit.status.ok
    assert "means nothing" in fit.report()
    assert "why the animal gave only one" in fit.report()
    # On one side of the standard alone the same answers are what a good animal gives.
    assert fit_weber(counted([1.1, 1.3], 40, [40, 40])).status is FitStatus.UPPER_BOUND


def test_no_answers_leave_the_prior() -> None:
    frame = pd.DataFrame({"standard": 1.0, "comparison": [1.1, 0.9], "choice": [None, None]})
    fit = fit_weber(read_trials(frame))
    assert fit.status is FitStatus.NO_TRIALS
    prior = Priors().weber_fraction
    np.testing.assert_allclose(
        fit.posterior.quantile("weber_fraction", ENDS), prior.ppf(ENDS), rtol=5e-3
    )
    assert "2 trials without an answer" in fit.report()
    json.loads(fit.to_json())


def test_an_unknown_log_unit_scales_the_answer_and_says_so() -> None:
    d = np.array([-1.0, -0.5, 0.5, 1.0])
    frame = pd.DataFrame(
        {"stimulus_1": 0.0, "stimulus_2": d, "n": 40, "n_greater": [5, 12, 27, 36]}
    )
    one = fit_weber(read_trials(frame, scale="log"))
    ten = fit_weber(read_trials(frame.assign(stimulus_2=10 * d), scale="log"))
    assert ten.weber_fraction == pytest.approx(10 * one.weber_fraction, rel=1e-9)
    assert one.unit == "per unit of the stimulus column"
    assert "log_unit would make it a ratio" in one.report()
    known = fit_weber(read_trials(frame, scale="log", log_unit=0.01))
    assert known.unit == ""
    assert isinstance(known.encoding, LogEncoding)
    # For small steps the two are the same noise, but for the prior on k.
    assert known.weber_fraction == pytest.approx(0.01 * one.weber_fraction, rel=0.15)


def test_mixed_subjects_are_refused() -> None:
    with pytest.raises(ValueError, match=r"2 subjects.*trials\.select\(subject='s1'\)"):
        fit_weber(load_numerosity())


def test_a_ridge_between_bias_and_lapses_is_integrated() -> None:
    """One ratio up and one down: four parameters on two proportions."""
    trials = counted([0.8, 1.25], 1500, [470, 900])
    wide = stats.beta(0.3, 3)
    fit = fit_weber(
        trials, priors={"lapse_low": wide, "lapse_high": wide, "bias": stats.norm(0, 1)}
    )
    assert fit.posterior.trouble == ""
    c = trials.cells()
    drive = (c.stimulus_2 - c.stimulus_1) / np.hypot(c.stimulus_1, c.stimulus_2)
    z = np.linspace(-6, 3.5, 150)
    lapse = wide.ppf(stats.norm.cdf(z))
    low, high = lapse[:, None, None], lapse[:, None]
    pair = stats.multivariate_normal(cov=[[1, 0.7], [0.7, 1]])
    prior = pair.pdf(np.stack(np.meshgrid(z, z, indexing="ij"), -1))
    prior[np.add.outer(lapse, lapse) >= 1] = 0.0
    b = np.linspace(-6, 6, 160)

    def log_likelihood(k: float) -> float:
        total = np.zeros(prior.shape)
        for some in np.split(b, 16):
            ll = 0.0
            for d, n, x in zip(drive, c.n, c.count, strict=True):
                up, down = stats.norm.cdf(d / k + some), stats.norm.cdf(-d / k - some)
                ll = ll + x * np.log(np.maximum(low * down + (1 - high) * up, 1e-300))
                ll = ll + (n - x) * np.log(np.maximum((1 - low) * down + high * up, 1e-300))
            total += (np.exp(ll + 1940) * stats.norm.pdf(some)).sum(axis=-1)
        return float(np.log((total * prior).sum()))

    score, log_posterior = fit.posterior.score_curve()
    curve = CubicSpline(score, log_posterior + score**2 / 2)
    off = [log_likelihood(k) - curve(np.log(k / 0.1) / np.log(3)) for k in (0.02, 0.05, 0.1, 0.3)]
    # On the shelf below 0.1, a tenth of the mass: 4 % there move the lower end by half a per cent.
    assert np.ptp(off) < 0.04


@pytest.mark.parametrize(
    ("options", "part"),
    [
        ({"noise": "pink"}, "noise 'pink' is unknown"),
        ({"bias": "per_standard"}, "did you mean 'per standard'"),
        ({"method": "mcmc"}, "did you mean 'emcee'|method 'mcmc' is unknown"),
        ({"priors": {"webber_fraction": 0.1}}, "did you mean 'weber_fraction'"),
        ({"priors": {"lapse_low": "small"}}, "the prior of lapse_low must be a number"),
        ({"priors": {"lapse_low": stats.norm(0, 1)}}, "must lie between 0 and 1"),
        ({"priors": {"weber_fraction": stats.norm(0, 1)}}, "must lie above zero"),
        ({"encoding": IdentityEncoding(), "observer": object()}, "both given"),
    ],
)
def test_unknown_names_and_bad_priors_are_refused(options: dict, part: str) -> None:
    with pytest.raises(ValueError, match=part) as caught:
        fit_weber(simulate_trials(trials_per_level=2, seed=33), **options)
    assert "\n" not in str(caught.value)


# -- recovery -------------------------------------------------------------------------------------


# Relative RMSE of k by an exact grid of the right model, k = 0.1 and lapses of 0.02, by trials.
EXACT_RMSE = {13: 0.221, 33: 0.145, 111: 0.085}


def recover(n_sets: int, first_seed: int, per_level: int = 33) -> tuple[np.ndarray, float]:
    """Relative errors of the posterior median, and the share of 95 % intervals that hold k."""
    errors, inside = [], 0
    for seed in range(first_seed, first_seed + n_sets):
        trials = simulate_trials(
            trials_per_level=per_level, lapse_low=0.02, lapse_high=0.02, seed=seed
        )
        fit = fit_weber(trials)
        low, high = fit.interval()
        inside += low < 0.1 < high
        errors.append(fit.weber_fraction / 0.1 - 1)
    return np.array(errors), inside / n_sets


def judge(errors: np.ndarray, covered: float, per_level: int = 33) -> None:
    n = errors.size
    se = errors.std() / np.sqrt(n)
    if per_level >= 33:  # with fewer trials the prior of k is told too
        assert abs(np.median(errors)) < 0.06 + 3 * 1.25 * se
    exact = EXACT_RMSE[per_level]
    assert np.sqrt(np.mean(errors**2)) < 1.05 * exact * (1 + 3 / np.sqrt(2 * n))
    assert stats.binomtest(round(covered * n), n, 0.95).pvalue > 0.005


@pytest.mark.slow  # of coverage: `tests/atlas/test_coverage.py`
def test_recovery_and_coverage() -> None:
    judge(*recover(30, 40_000))


@pytest.mark.slow
@pytest.mark.parametrize("per_level", EXACT_RMSE)
def test_recovery_and_coverage_in_full(per_level: int) -> None:
    """Other k and lapse rates: `analyses/recovery.py`, and `test_lapse_prior.py` for what
    not knowing the lapses costs."""
    errors, covered = recover(500, 50_000, per_level)
    judge(errors, covered, per_level)
    assert 0.93 <= covered <= 0.98


# -- real data ------------------------------------------------------------------------------------


@pytest.mark.parametrize("subject", slow_but(["s1", "s2"], (0,)))
def test_numerosity(subject: str) -> None:
    fit = fit_weber(load_numerosity(subject))
    # How far down k may go is a matter of what is believed about lapses, how far up is not.
    assert fit.status is FitStatus.PRIOR_DEPENDENT
    moved = fit.prior_sensitivity.loc["lapses"]
    assert abs(np.log(moved["lower_half"] / moved["lower_twice"])) > 0.15
    assert abs(np.log(moved["upper_half"] / moved["upper_twice"])) < 0.02
    assert fit.misfit > 0.05
    # Numerosity Weber fractions of adults lie between 0.1 and 0.35.
    assert 0.1 < fit.weber_fraction < 0.35


@pytest.mark.slow  # simulated: test_fit.py
def test_the_rat_needs_a_bias_per_standard() -> None:
    trials = load_rat_auditory(range(31, 36))
    shared, own = (fit_weber(trials, bias=b) for b in ("shared", "per standard"))
    assert shared.misfit < 0.001
    assert own.misfit > 0.05
    # k alone misreads the animal by a factor of more than two.
    assert shared.weber_fraction > 2 * own.weber_fraction


@pytest.mark.slow  # simulated streaks are found in `test_misfit.py`
@pytest.mark.parametrize("first", [33, 31])
def test_the_rat_is_not_always_engaged(first: int) -> None:
    trials = load_rat_auditory(range(first, 36))
    one = fit_weber(trials, bias="per standard")
    assert one.status is FitStatus.MISFIT_STREAKS
    assert one.search.chosen is not None
    assert "The answers show streaks" in one.report()
    if first > 31:  # three sessions are too few to show a third state
        assert one.search.chosen.name.startswith("states=")
        return
    assert one.search.chosen.name.startswith("states=3")
    three = fit_weber(trials, bias="per standard", states=3)
    assert one.log_evidence is not None
    assert three.log_evidence is not None
    assert three.log_evidence > one.log_evidence + 10
    # States leave some of what wins and losses do, and most like it a bias that drifts, but not by
    # a Bayes factor of ten.
    assert three.status is FitStatus.MISFIT_HISTORY
    assert three.search.chosen is None
    assert max(three.search.tried, key=lambda one: one.log_evidence).name == "bias_drift"


def test_false_alarms_above_the_proportion_leave_no_threshold() -> None:
    point = threshold(
        task_named("same-different"),
        IdentityEncoding(),
        1.0,
        0.5,
        weber_fraction=0.1,
        bias=[0.1, 2.0],
    )
    assert np.isfinite(point[1])
    assert np.isinf(point[0])


def test_a_posterior_that_was_given_up_names_the_method_to_take(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It said "the other method", of which there are two."""
    given_up = property(lambda self: "its draws are worth only 9 independent ones")
    monkeypatch.setattr(ImportancePosterior, "trouble", given_up)
    trials = simulate_trials(sessions=2, trials_per_level=20, seed=1)
    fit = fit_weber(trials, effects=[History()])
    assert fit.status is FitStatus.NOT_CONVERGED
    assert "first fit with method='emcee', or state more beforehand" in fit.report()
