"""Many animals: the integrals against brute force and emcee, and what pooling does."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats
from scipy.special import logsumexp, ndtr
from short_forms import slow_but

from weberwhisk._util.sampling import sample_stacked
from weberwhisk.behaviour import (
    PopulationFit,
    PopulationStatus,
    Priors,
    Trials,
    fit_population,
    simulate_population,
)

Array = NDArray[np.float64]

#: Known lapses and biases: one unknown an animal.
KNOWN = {"lapse_low": 0.02, "lapse_high": 0.02, "bias": 0.0}


def animals(count: int, **options: object) -> tuple[Trials, Array]:
    given = {
        "spread": 0.4, "bias_spread": 0.0, "trials_per_level": 8, "offsets": [-0.3, -0.1, 0.1, 0.3],
        "standards": [1.0, 2.0],
    } | options  # fmt: skip
    trials, truth = simulate_population(count, seed=41, **given)  # type: ignore[arg-type]
    return trials, truth["weber_fraction"].to_numpy()


def likelihood(trials: Trials, log_k: Array) -> Array:
    """Log-likelihood of ln k with the parameters of `KNOWN`, from the formula itself."""
    frame = trials.frame
    s1, s2, x = (frame[c].to_numpy(float) for c in ("stimulus_1", "stimulus_2", "count"))
    eta = (s2 - s1) / np.hypot(s1, s2) / np.exp(log_k)[..., None]
    p = 0.02 + 0.96 * ndtr(eta)
    return np.log(np.where(x == 1, p, 1 - p)).sum(axis=-1)


# -- the integrals --------------------------------------------------------------------------------


def test_a_prior_of_spreads_that_ends_above_zero_is_integrated_from_there() -> None:
    trials, _ = animals(2)
    fit = fit_population(trials, priors=KNOWN, spread_prior=stats.uniform(0.2, 0.4))
    low, middle, high = fit.quantile("spread", [0.025, 0.5, 0.975])
    # By brute force: each animal's likelihood, averaged over the normal, on nodes of its own.
    k, mu, tau = np.linspace(-7, 2, 1201), np.linspace(-5, 0, 101), np.linspace(0.2, 0.6, 81)
    z = (k[:, None, None] - mu[:, None]) / tau
    normal = np.exp(-0.5 * z**2) / tau
    log_post = stats.norm.logpdf(mu, np.log(0.1), np.log(3.0))[:, None] + np.zeros(tau.size)
    for subject in trials.subjects:
        seen = likelihood(trials.select(subject=subject), k)
        log_post = log_post + np.log(np.tensordot(np.exp(seen - seen.max()), normal, 1))
    mass = np.exp(log_post - log_post.max())
    mass[:, [0, -1]] *= 0.5
    below = np.cumsum(mass.sum(axis=0))
    below -= 0.5 * mass.sum(axis=0)
    exact = np.interp(np.array([0.025, 0.5, 0.975]) * mass.sum(), below, tau)
    np.testing.assert_allclose([low, middle, high], exact, atol=0.005)
    assert fit.status is not PopulationStatus.NOT_CONVERGED


@pytest.mark.slow
def test_a_prior_that_ends_above_the_likely_is_integrated_or_said_not_to_be() -> None:
    trials, _ = animals(2)
    believed = Priors(weber_fraction=stats.uniform(0.03, 0.09), lapse_low=0.02, lapse_high=0.02)
    fit = fit_population(trials, priors=believed, bias="none")
    # By brute force, as above, with the mean between two ends.
    k, mu, tau = np.linspace(-7, 2, 1201), np.linspace(0.03, 0.12, 401), (np.arange(80) + 0.5) / 40
    z = (k[:, None, None] - np.log(mu)[:, None]) / tau
    log_post = np.zeros((mu.size, 1)) + stats.halfnorm(scale=0.5).logpdf(tau)
    for subject in trials.subjects:
        seen = likelihood(trials.select(subject=subject), k)
        log_post += np.log(np.tensordot(np.exp(seen - seen.max()), np.exp(-0.5 * z**2) / tau, 1))
    mass = np.exp(log_post - log_post.max()).sum(axis=1)
    exact = np.interp([0.025, 0.5, 0.975], (np.cumsum(mass) - 0.5 * mass) / mass.sum(), mu)
    if fit.status is not PopulationStatus.NOT_CONVERGED:
        np.testing.assert_allclose(
            fit.quantile("weber_fraction", [0.025, 0.5, 0.975]), exact, rtol=0.02
        )
    wide = Priors(weber_fraction=stats.uniform(1e-4, 5.0), lapse_low=0.02, lapse_high=0.02)
    assert fit_population(trials, priors=wide).status is not PopulationStatus.NOT_CONVERGED


def brute_force(trials: Trials) -> dict[str, Array]:
    """Mean and sd of the population's ln k and spread, and of each animal's ln k, on a dense grid
    with Gauss–Hermite nodes for each animal."""
    mu, tau = np.linspace(-7.5, 2.5, 301), (np.arange(160) + 0.5) * 0.0156
    node, weight = np.polynomial.hermite_e.hermegauss(90)
    weight = weight / weight.sum()
    x = mu[:, None, None] + tau[:, None] * node
    log_prior = stats.lognorm(np.log(3.0), scale=0.1).logpdf(np.exp(mu))[:, None] + mu[:, None]
    log_post = log_prior + stats.halfnorm(scale=0.5).logpdf(tau)
    moments = []
    for subject in trials.subjects:
        table = np.linspace(-22, 18, 8001)
        like = np.interp(x, table, likelihood(trials.select(subject=subject), table))
        own = like + np.log(weight)
        total = logsumexp(own, axis=2)
        share = np.exp(own - total[..., None])
        moments.append(((share * x).sum(axis=2), (share * x**2).sum(axis=2)))
        log_post = log_post + total
    mass = np.exp(log_post - logsumexp(log_post))

    def of(first: Array, second: Array) -> Array:
        mean = (mass * first).sum()
        return np.array([mean, np.sqrt((mass * second).sum() - mean**2)])

    out = {"mu": of(mu[:, None], mu[:, None] ** 2), "spread": of(tau, tau**2)}
    return out | {f"{i}": of(*m) for i, m in enumerate(moments)}


def moments_of(fit: PopulationFit) -> dict[str, Array]:
    assert fit.population is not None
    found, weights = fit.population, fit.population.draws.weights
    pairs = {"mu": (np.log(found.values["weber_fraction"]), weights),
             "spread": (found.values["spread"], weights)}  # fmt: skip
    for i in range(len(found.animals)):
        own = np.log(found.animal_values(i)["weber_fraction"])
        pairs[f"{i}"] = own, found.animal_weights(i)
    out = {}
    for name, (values, weight) in pairs.items():
        mean = weight @ values
        out[name] = np.array([mean, np.sqrt(weight @ (values - mean) ** 2)])
    return out


@pytest.mark.parametrize("count", slow_but([2, 5], (0,)))
def test_population_and_animals_by_brute_force(count: int) -> None:
    trials, _ = animals(count)
    fit = fit_population(trials, priors=KNOWN)
    expected, found = brute_force(trials), moments_of(fit)
    assert expected.keys() == found.keys()
    for name, (mean, sd) in expected.items():
        assert found[name][0] == pytest.approx(mean, abs=0.02 * sd), name
        assert found[name][1] == pytest.approx(sd, rel=0.02), name


@pytest.mark.slow
def test_what_fails_emcee_on_all_animals_at_once() -> None:
    # Thirty animals with a normal likelihood each: with their own ln k integrated out two numbers
    # are left, and a sampler has them at once; sampled all together it has not after as many steps,
    # and says so.
    rng = np.random.default_rng(7)
    y = rng.normal(-2.3, np.hypot(0.3, 0.1), 30)

    def prior(mu: Array, log_tau: Array) -> Array:
        tau = np.exp(log_tau)
        out = stats.norm.logpdf(mu, -2.3, 1.1) + stats.halfnorm.logpdf(tau, scale=0.5) + log_tau
        return np.asarray(out)

    def marginal(x: Array) -> Array:
        mu, log_tau = x[..., 0], x[..., 1]
        variance = np.exp(2 * log_tau) + 0.01
        square = ((y - mu[..., None]) ** 2).sum(axis=-1)
        return prior(mu, log_tau) - 0.5 * square / variance - 15 * np.log(variance)

    def joint(x: Array) -> Array:
        mu, log_tau, own = x[..., 0], x[..., 1], x[..., 2:]
        inside = -0.5 * (((y - own) / 0.1) ** 2).sum(axis=-1)
        square = ((own - mu[..., None]) ** 2).sum(axis=-1)
        return prior(mu, log_tau) + inside - 0.5 * square / np.exp(2 * log_tau) - 30 * log_tau

    few = np.array([-2.3, -1.2]) + rng.normal(0, 0.1, (1, 4, 16, 2))
    many = np.r_[-2.3, -1.2, y] + rng.normal(0, 0.1, (1, 4, 128, 32))
    few_run = sample_stacked(marginal, few, seed=1, precision=0.05, max_steps=1500)
    many_run = sample_stacked(joint, many, seed=1, precision=0.05, max_steps=1500)
    assert few_run.converged[0]
    assert not many_run.converged[0]


# -- what pooling does ----------------------------------------------------------------------------


@pytest.mark.slow
def test_pooling_draws_animals_together_and_errs_less() -> None:
    trials, truth = animals(8, spread=0.2, trials_per_level=14, bias_spread=0.2)
    fit = fit_population(trials)
    rows = fit.subjects
    # In forty such populations the error of ln k was 0.18 with pooling and 0.26 without.
    off = {c: np.log(rows[c].to_numpy() / truth) for c in ("weber_fraction", "alone")}
    assert np.mean(off["weber_fraction"] ** 2) < np.mean(off["alone"] ** 2)
    assert np.log(rows["weber_fraction"]).std() < np.log(rows["alone"]).std()
    assert ((rows["lower"] < truth) & (truth < rows["upper"])).sum() >= 7
    narrower = np.log(rows["upper"] / rows["lower"]) < np.log(
        rows["alone_upper"] / rows["alone_lower"]
    )
    assert narrower.all()
    for name, value in (("weber_fraction", 0.1), ("spread", 0.2)):
        low, high = fit.interval(0.95, name)
        assert low < value < high


@pytest.mark.parametrize("unit", slow_but([1e-6, 1e6], (0,)))
@pytest.mark.slow
def test_the_unit_does_not_matter(unit: float) -> None:
    trials, _ = animals(3)
    scaled, _ = animals(3, standards=[1.0 * unit, 2.0 * unit])
    one, other = (fit_population(t, priors=KNOWN).summary() for t in (trials, scaled))
    np.testing.assert_allclose(
        one.drop(columns=["mass", "prior"]),
        other.drop(columns=["mass", "prior"]),
        rtol=1e-6,
        atol=1e-12,
    )


@pytest.mark.slow  # of a population: by brute force, above
def test_five_animals_of_a_percent_correct_task() -> None:
    trials, truth = animals(
        5, task="3AFC percent correct", offsets=[0.1, 0.2, 0.4, 0.8], trials_per_level=20
    )
    fit = fit_population(trials)
    assert fit.status.ok
    low, high = fit.interval(0.99)
    assert low < 0.1 < high
    order = [f"s{i + 1}" for i in range(5)]
    rows = fit.subjects.set_index("subject").loc[order]
    assert ((rows["lower"] < truth) & (truth < rows["upper"])).sum() >= 4


# -- trouble --------------------------------------------------------------------------------------


def test_one_animal_says_nothing_of_a_spread() -> None:
    trials, _ = animals(1)
    fit = fit_population(trials, priors=KNOWN)
    assert fit.status is PopulationStatus.ONE_ANIMAL
    prior = float(stats.halfnorm(scale=0.5).mean())
    assert fit.summary().loc["spread", "mean"] == pytest.approx(prior, rel=0.25)


def test_a_reversed_animal_and_one_without_answers_stay_out() -> None:
    trials, _ = animals(4)
    odd = trials.frame.copy()
    odd.loc[odd["subject"] == "s1", "count"] = 1 - odd.loc[odd["subject"] == "s1", "count"]
    odd.loc[odd["subject"] == "s2", "count"] = np.nan
    fit = fit_population(Trials(odd, trials.task), priors=KNOWN)
    alone = fit_population(trials.select(subject=["s3", "s4"]), priors=KNOWN)
    assert fit.weber_fraction == pytest.approx(alone.weber_fraction, rel=1e-9)
    missing, *out = fit.notes
    assert missing.startswith("64 trials without an answer")
    assert [note.split()[0] for note in out] == ["s1", "s2"]
    rows = fit.subjects.set_index("subject")
    assert rows.loc["s1", "status"] == "REVERSED"
    assert rows.loc["s2", "status"] == "NO_TRIALS"
    assert rows["weber_fraction"].isna().tolist() == [True, True, False, False]
    json.loads(fit.to_json())  # strict: what is not known is null


def test_no_animal_at_all_is_an_outcome() -> None:
    trials, _ = animals(2)
    empty = Trials(trials.frame.assign(count=np.nan), trials.task)
    fit = fit_population(empty)
    assert fit.status is PopulationStatus.NO_TRIALS
    assert json.loads(fit.to_json())["population"] == {}
    with pytest.raises(ValueError, match="no animal has trials"):
        fit.summary()
    with pytest.raises(ValueError, match="no animal has trials"):
        fit.to_arviz()


@pytest.mark.slow  # of such animals: the test above
def test_perfect_and_hopeless_animals_are_carried_by_the_others() -> None:
    trials, _ = animals(3, spread=0.1, trials_per_level=30)
    frame = trials.frame.copy()
    first, second = (frame["subject"] == s for s in ("s1", "s2"))
    right = (frame["stimulus_2"] > frame["stimulus_1"]).astype(float)
    frame["count"] = frame["count"].mask(first, right)
    frame.loc[second, "count"] = (np.arange(second.sum()) % 2).astype(float)
    given = {"check": False, "bias": "none"}
    fit = fit_population(Trials(frame, trials.task), **given)
    rows = fit.subjects.set_index("subject")
    assert rows.loc["s1", "status"] == "UPPER_BOUND"
    assert np.isfinite(rows[["weber_fraction", "lower", "upper"]].to_numpy()).all()
    better = fit_population(Trials(frame[~second], trials.task), **given)
    found = better.subjects.set_index("subject")
    assert found.loc["s1", "weber_fraction"] > found.loc["s1", "alone"]


def test_missing_labels_are_refused() -> None:
    trials, _ = animals(2)
    lacking = Trials(trials.frame.drop(columns="subject"), trials.task)
    with pytest.raises(ValueError, match="no column 'subject' that names the subjects"):
        fit_population(lacking)


def test_reading_off_a_fit_and_its_draws_for_arviz() -> None:
    trials, _ = animals(4)
    fit = fit_population(trials, priors=KNOWN)
    summary = fit.summary(0.9)
    assert summary.index.tolist() == list(fit.parameters)
    posterior = fit.to_arviz(draws=5000)["posterior"]
    for name in ("weber_fraction", "spread"):
        draws = np.asarray(posterior[name]).ravel()
        assert draws.mean() == pytest.approx(
            summary.loc[name, "mean"], abs=0.05 * summary.loc[name, "sd"]
        )
        assert draws.std() == pytest.approx(summary.loc[name, "sd"], rel=0.08)
        low, high = np.quantile(draws, [0.05, 0.95])
        assert low == pytest.approx(summary.loc[name, "lower"], abs=0.08 * summary.loc[name, "sd"])
        assert high == pytest.approx(summary.loc[name, "upper"], abs=0.2 * summary.loc[name, "sd"])
    assert json.loads(fit.to_json())["population"]["spread"]["median"] > 0
    assert fit.population is not None
    cut_off = replace(fit, population=replace(fit.population, error=np.inf))
    assert json.loads(cut_off.to_json())["error"] is None
    with pytest.raises(ValueError, match="did you mean 'spread'"):
        fit.interval(parameter="sprad")
    with pytest.raises(ValueError, match="mass must lie between 0 and 1, got 1"):
        fit.interval(1.0)
    with pytest.raises(ValueError, match=re.escape("write fit.interval(parameter='spread')")):
        fit.interval("spread")  # type: ignore[arg-type]
