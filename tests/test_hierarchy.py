"""Many animals: the integrals against brute force and emcee, and what pooling does."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats
from scipy.special import logsumexp, ndtr

from weberwhisk.behaviour import (
    PopulationFit,
    PopulationPriors,
    PopulationStatus,
    Priors,
    Trials,
    fit_population,
    fit_weber,
    simulate_population,
    simulate_trials,
)
from weberwhisk.behaviour.axes import AS_BELIEVED, BiasScales
from weberwhisk.behaviour.hierarchy import Members, _zoomed, integrate_population
from weberwhisk.behaviour.integrate.batch import tabulate
from weberwhisk.behaviour.trials import joined
from weberwhisk.inference.ensemble import sample_stacked

Array = NDArray[np.float64]

#: Known lapses and biases: one unknown an animal.
KNOWN = {"lapse_low": 0.02, "lapse_high": 0.02, "bias": 0.0}


#: Lapses and biases of a population as in the prior of a single fit.
AS_ALONE = np.zeros(1), np.ones(1), np.ones(1)


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


def work_of(trials: Trials, sessions: bool, priors: object = KNOWN) -> Members:
    parts, animal = [], []
    for i, subject in enumerate(trials.subjects):
        own = trials.select(subject=subject)
        for part in [own.select(session=s) for s in own.sessions] if sessions else [own]:
            fit = fit_weber(part, priors=priors)
            parts.append(tabulate(fit.model.merged(), fit.posterior.draws(), AS_BELIEVED))
            animal.append(i)
    return Members(tuple(parts), np.array(animal), sessions)


# -- the integrals --------------------------------------------------------------------------------


def test_nodes_between_cut_offs_are_interpolated_within_them() -> None:
    """A spline through logs that drop by hundreds put all mass beside the drop.

    A normal cut off two sds below its mean and the nodes' exact quantiles; then two nodes alone.
    """
    place = np.linspace(-4.0, 4.0, 23)
    for cut in (-2.0, -0.9, 0.5):
        log = np.where(place < cut, -690.0, -0.5 * place**2)
        fine, x = np.exp(_zoomed(log, [24])), _zoomed(place, [24])
        first = place[place >= cut][0]
        exact = stats.truncnorm(first, np.inf).ppf([0.025, 0.5, 0.975])
        below = np.cumsum(fine) / fine.sum()
        # A cell with a drop is a whole one of its node's or none: half of it is not told.
        np.testing.assert_allclose(np.interp([0.025, 0.5, 0.975], below, x), exact, atol=0.06)
    few = np.array([-690.0, -690.0, -5.0, -4.0, -690.0, -690.0])
    assert _zoomed(few, [5]).max() < -3.5 + 1e-9


def test_a_prior_of_spreads_that_ends_above_zero_is_integrated_from_there() -> None:
    trials, _ = animals(2)
    prior = PopulationPriors(spread=stats.uniform(0.2, 0.4))
    fit = fit_population(trials, priors=KNOWN, population=prior)
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


def test_a_prior_that_ends_between_nodes_is_said_not_to_converge() -> None:
    trials, _ = animals(2)
    believed = Priors(weber_fraction=stats.uniform(0.03, 0.09), lapse_low=0.02, lapse_high=0.02)
    assert fit_population(trials, priors=believed).status is PopulationStatus.NOT_CONVERGED
    wide = Priors(weber_fraction=stats.uniform(1e-4, 5.0), lapse_low=0.02, lapse_high=0.02)
    assert fit_population(trials, priors=wide).status is not PopulationStatus.NOT_CONVERGED


def test_a_table_integrates_to_the_evidence_of_one_animal() -> None:
    # A population with the prior of a single fit: the same integral over k, lapses and bias, here
    # by brute force in the normal scores of the priors.
    trials = simulate_trials(
        weber_fraction=0.12, offsets=[-0.3, -0.1, 0.1, 0.3], lapse_high=0.05, trials_per_level=30,
        subject="a", seed=3,
    )  # fmt: skip
    model = fit_weber(trials).model
    priors, c = model.priors, model.cells
    z = np.linspace(-6, 4, 81)
    lapse = priors.of("lapse_low").ppf(stats.norm.cdf(z))
    low, high = lapse[:, None, None], lapse[None, :, None]
    rho = priors.lapse_correlation
    prior = stats.multivariate_normal([0, 0], [[1, rho], [rho, 1]]).logpdf(
        np.stack(np.meshgrid(z, z, indexing="ij"), axis=-1)
    )
    prior = np.where(low[..., 0] + high[..., 0] < 1, prior, -np.inf)
    gap = (c.stimulus_2 - c.stimulus_1) / np.hypot(c.stimulus_1, c.stimulus_2)
    log_k, bias = np.linspace(np.log(0.02), np.log(0.5), 41), np.linspace(-1.6, 1.6, 25)
    total = []
    for x in log_k:
        for b in bias:
            up = ndtr(gap / np.exp(x) + b)
            p = np.clip(low * (1 - up) + (1 - high) * up, 1e-300, 1 - 1e-16)
            inside = (c.count * np.log(p) + (c.n - c.count) * np.log(1 - p)).sum(axis=-1) + prior
            total.append(logsumexp(inside) + stats.norm.logpdf(b))
            total[-1] += priors.weber_fraction.logpdf(np.exp(x)) + x
    steps = (z[1] - z[0]) ** 2 * (log_k[1] - log_k[0]) * (bias[1] - bias[0])
    work = work_of(trials, False, None)
    kernel = work.kernel(np.array([np.log(0.1)]), np.array([np.log(3.0)]))
    log_like = work.given_lapses(*AS_ALONE)[0, 0]
    found = work.log_likelihood(log_like, None, kernel)[0][0]
    assert found == pytest.approx(logsumexp(total) + np.log(steps), abs=2e-3)


def test_sessions_within_animals_by_brute_force() -> None:
    trials, _ = animals(2, sessions=3, session_spread=0.3)
    work = work_of(trials, True)
    log_like = work.given_lapses(*AS_ALONE)[0, 0]
    node, weight = np.polynomial.hermite_e.hermegauss(120)
    weight = weight / weight.sum()
    for mu, tau, sigma in ((-2.3, 0.4, 0.3), (-2.0, 0.2, 0.6), (-2.6, 0.8, 0.15)):
        middle = mu + tau * node
        expected = 0.0
        for subject in trials.subjects:
            own = trials.select(subject=subject)
            by_session = [
                logsumexp(
                    likelihood(own.select(session=s), middle[:, None] + sigma * node),
                    axis=1,
                    b=weight,
                )
                for s in own.sessions
            ]
            expected += logsumexp(np.sum(by_session, axis=0), b=weight)
        kernel = work.kernel(np.array([mu]), np.array([tau]))
        assert work.log_likelihood(log_like, work.within(sigma), kernel)[0][0] == pytest.approx(
            expected, abs=2e-3
        )


def brute_force(trials: Trials, prior: PopulationPriors) -> dict[str, Array]:
    """Mean and sd of the population's ln k and spread, and of each animal's ln k, on a dense grid
    with Gauss–Hermite nodes for each animal."""
    mu, tau = np.linspace(-7.5, 2.5, 301), (np.arange(160) + 0.5) * 0.0156
    node, weight = np.polynomial.hermite_e.hermegauss(90)
    weight = weight / weight.sum()
    x = mu[:, None, None] + tau[:, None] * node
    log_prior = stats.lognorm(np.log(3.0), scale=0.1).logpdf(np.exp(mu))[:, None] + mu[:, None]
    log_post = log_prior + prior.spread.logpdf(tau)
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


def brute_force_with_biases(trials: Trials, prior: PopulationPriors) -> dict[str, Array]:
    """The same where animals have a bias each, drawn with a common sd, also on a dense grid."""
    mu, tau = np.linspace(-6.0, 1.5, 121), (np.arange(60) + 0.5) * 0.04
    scale = (np.arange(60) + 0.5) * 0.07
    node, weight = np.polynomial.hermite_e.hermegauss(40)
    weight = weight / weight.sum()
    x = mu[:, None, None] + tau[:, None] * node
    table, bias = np.linspace(-16, 12, 1401), np.arange(-14, 14.01, 0.05)
    log_prior = stats.lognorm(np.log(3.0), scale=0.1).logpdf(np.exp(mu))[:, None] + mu[:, None]
    log_post = log_prior + prior.spread.logpdf(tau)
    log_post = log_post[..., None] + prior.bias_scale.logpdf(scale)
    density = stats.norm.pdf(bias[:, None], scale=scale)
    for subject in trials.subjects:
        frame = trials.select(subject=subject).frame
        cells = frame.groupby(["stimulus_1", "stimulus_2"])["count"].agg(["sum", "count"])
        log_like = np.zeros((table.size, bias.size))
        for (s1, s2), (yes, n) in zip(cells.index, cells.to_numpy(), strict=True):
            gap = (s2 - s1) / np.hypot(s1, s2)
            p = 0.02 + 0.96 * ndtr(gap / np.exp(table)[:, None] + bias)
            log_like += yes * np.log(p) + (n - yes) * np.log1p(-p)
        top = log_like.max()
        by_scale = np.log(np.exp(log_like - top) @ density * 0.05) + top  # (X, S)
        for i, one in enumerate(by_scale.T):
            log_post[..., i] += logsumexp(np.interp(x, table, one), axis=2, b=weight)
    mass = np.exp(log_post - logsumexp(log_post))
    out = {}
    grids = {"mu": mu[:, None, None], "spread": tau[:, None], "bias_scale": scale}
    for name, value in grids.items():
        mean = (mass * value).sum()
        out[name] = np.array([mean, np.sqrt((mass * (value - mean) ** 2).sum())])
    return out


NAMED = {"mu": "log_weber_fraction", "spread": "spread", "bias_scale": "bias_scale"}


def moments_of(fit: PopulationFit) -> dict[str, Array]:
    assert fit.population is not None
    found = fit.population
    out = {}
    for label, name in NAMED.items():
        (values,), mass = found.nodes(name)
        mean = mass @ values
        out[label] = np.array([mean, np.sqrt(mass @ (values - mean) ** 2)])
    for i, mass in enumerate(found.animals):
        mean = mass @ found.log_k
        out[f"{i}"] = np.array([mean, np.sqrt(mass @ (found.log_k - mean) ** 2)])
    return out


@pytest.mark.parametrize("count", [2, 5])
def test_population_and_animals_by_brute_force(count: int) -> None:
    trials, _ = animals(count)
    fit = fit_population(trials, priors=KNOWN)
    expected, found = brute_force(trials, fit.priors), moments_of(fit)
    assert expected.keys() == found.keys() - {"bias_scale"}
    for name, (mean, sd) in expected.items():
        assert found[name][0] == pytest.approx(mean, abs=0.01 * sd), name
        assert found[name][1] == pytest.approx(sd, rel=0.01), name


@pytest.mark.parametrize("count", [2, pytest.param(3, marks=pytest.mark.slow)])
def test_population_with_biases_by_brute_force(count: int) -> None:
    trials, _ = animals(count, bias_spread=0.3)
    fit = fit_population(trials, priors={"lapse_low": 0.02, "lapse_high": 0.02})
    expected, found = brute_force_with_biases(trials, fit.priors), moments_of(fit)
    for name, (mean, sd) in expected.items():
        assert found[name][0] == pytest.approx(mean, abs=0.01 * sd), name
        assert found[name][1] == pytest.approx(sd, rel=0.01), name


def population_density(work: Members, prior: PopulationPriors, x: Array) -> Array:
    """Log posterior of (ln k of the population, log spread) with every animal integrated out."""
    flat = x.reshape(-1, 2)
    log_like = work.given_lapses(*AS_ALONE)[0, 0]
    kernel = work.kernel(flat[:, 0], np.exp(flat[:, 1]))
    weber = stats.lognorm(np.log(3.0), scale=0.1)
    out = work.log_likelihood(log_like, None, kernel)[0]
    out = out + weber.logpdf(np.exp(flat[:, 0])) + flat[:, 0]
    return (out + prior.spread.logpdf(np.exp(flat[:, 1])) + flat[:, 1]).reshape(x.shape[:-1])


@pytest.mark.slow
def test_emcee_on_the_populations_own_parameters_agrees() -> None:
    """The same means and sds as `test_population_and_animals_by_brute_force`, by a second judge."""
    trials, _ = animals(3)
    work, fit = work_of(trials, False), fit_population(trials, priors=KNOWN)
    start = np.array([-2.3, -1.0]) + np.random.default_rng(1).normal(0, 0.3, (1, 4, 16, 2))
    run = sample_stacked(
        lambda x: population_density(work, fit.priors, x), start, seed=2, precision=0.1
    )
    assert run.converged[0]
    found = moments_of(fit)
    draws = run.values[0].reshape(-1, 2)
    mean, sd = found["mu"]
    assert draws[:, 0].mean() == pytest.approx(mean, abs=0.3 * sd)
    assert draws[:, 0].std() == pytest.approx(sd, rel=0.3)
    mean, sd = found["spread"]
    assert np.exp(draws[:, 1]).mean() == pytest.approx(mean, abs=0.3 * sd)


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


def test_scales_of_biases_that_were_not_tabulated_are_missed() -> None:
    # A posterior that runs into the end of what was tabulated is no answer, and says so.
    trials, _ = animals(3, bias_spread=0.2)
    known = {"lapse_low": 0.02, "lapse_high": 0.02}
    fits = [fit_weber(trials.select(subject=s), priors=known) for s in trials.subjects]
    weber = Priors().weber_fraction
    errors = []
    for scales in (BiasScales.between(0.0, 5.0, 0.1), BiasScales.between(1.5, 3.0, 0.1)):
        tables = [tabulate(f.model.merged(), f.posterior.draws(), scales) for f in fits]
        members = Members(tuple(tables), np.arange(3), False, scales)
        found = integrate_population(
            members, PopulationPriors(), lambda x: weber.logpdf(np.exp(x)) + x
        )
        errors.append(found.error)
    assert errors[0] < 0.02
    assert np.isinf(errors[1])


def test_k_is_not_pulled_by_biases_that_are_alike() -> None:
    # Twelve animals without any bias: with the scale of a single fit k is 0.0927, and 0.0979 with
    # one that is learnt.
    trials, _ = animals(12, spread=0.1, trials_per_level=12)
    known = {"lapse_low": 0.02, "lapse_high": 0.02}
    learnt = fit_population(trials, bias="per standard", priors=known)
    believed = PopulationPriors(bias_scale=stats.lognorm(0.01, scale=1.0))
    fixed = fit_population(trials, bias="per standard", priors=known, population=believed)
    assert fixed.weber_fraction < 0.97 * learnt.weber_fraction
    low, high = learnt.interval(0.95)
    assert low < 0.1 < high
    assert learnt.interval(0.95, "bias_scale")[1] < 0.3


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
    for name, value in (("weber_fraction", 0.1), ("spread", 0.2), ("mean_lapse_low", 0.02)):
        low, high = fit.interval(0.95, name)
        assert low < value < high


def test_sessions_are_told_apart() -> None:
    trials, _ = animals(3, spread=0.1, sessions=4, session_spread=0.8, trials_per_level=60)
    fit = fit_population(trials, sessions=True, priors=KNOWN)
    assert fit.sessions is not None
    assert len(fit.sessions) == 12
    low, high = fit.interval(0.95, "session_spread")
    assert 0.35 < low < 0.8 < high
    lower, upper = fit.interval(0.95, "spread")
    assert lower < 0.1 < upper < 1.5
    # A session learns from its animal's others: each lies between itself and them.
    alone, pooled = (np.log(fit.sessions[c]) for c in ("alone", "weber_fraction"))
    assert pooled.std() < alone.std()


def test_the_order_of_the_animals_does_not_matter() -> None:
    trials, _ = animals(3)
    parts = [trials.select(subject=s) for s in ("s3", "s1", "s2")]
    one, other = (fit_population(t, priors=KNOWN) for t in (trials, joined(parts)))
    assert one.weber_fraction == pytest.approx(other.weber_fraction, rel=1e-9)
    assert one.subjects.equals(other.subjects)


@pytest.mark.parametrize("unit", [1e-6, 1e6])
def test_the_unit_does_not_matter(unit: float) -> None:
    trials, _ = animals(3)
    scaled, _ = animals(3, standards=[1.0 * unit, 2.0 * unit])
    one, other = (fit_population(t, priors=KNOWN).summary() for t in (trials, scaled))
    np.testing.assert_allclose(
        one.drop(columns="mass"), other.drop(columns="mass"), rtol=1e-6, atol=1e-12
    )


def test_five_animals_of_a_percent_correct_task() -> None:
    trials, truth = animals(
        5, task="3AFC percent correct", offsets=[0.1, 0.2, 0.4, 0.8], trials_per_level=20
    )
    fit = fit_population(trials)
    assert fit.status.ok
    assert "mean_lapse_low" not in fit.parameters
    low, high = fit.interval(0.99)
    assert low < 0.1 < high
    order = [f"s{i + 1}" for i in range(5)]
    rows = fit.subjects.set_index("subject").loc[order]
    assert ((rows["lower"] < truth) & (truth < rows["upper"])).sum() >= 4


@pytest.mark.slow
def test_fifty_animals_of_two_thousand_trials() -> None:
    trials, truth = simulate_population(
        50, spread=0.3, standards=[1.0, 2.0, 4.0], trials_per_level=74, seed=3
    )
    fit = fit_population(trials)
    assert fit.status.ok
    rows = fit.subjects.set_index("subject").loc[truth["subject"]]
    true = truth["weber_fraction"].to_numpy()
    assert ((rows["lower"] < true) & (true < rows["upper"])).sum() >= 43
    for name, value in (("weber_fraction", 0.1), ("spread", 0.3), ("mean_lapse_high", 0.02)):
        low, high = fit.interval(0.99, name)
        assert low < value < high


# -- trouble --------------------------------------------------------------------------------------


def test_one_animal_says_nothing_of_a_spread() -> None:
    trials, _ = animals(1)
    fit = fit_population(trials, priors=KNOWN)
    assert fit.status is PopulationStatus.ONE_ANIMAL
    (values,), mass = fit.population.nodes("spread")  # type: ignore[union-attr]
    assert mass @ values == pytest.approx(float(fit.priors.spread.mean()), rel=0.25)


def test_a_reversed_animal_and_one_without_answers_stay_out() -> None:
    trials, _ = animals(4)
    odd = trials.frame.copy()
    odd.loc[odd["subject"] == "s1", "count"] = 1 - odd.loc[odd["subject"] == "s1", "count"]
    odd.loc[odd["subject"] == "s2", "count"] = np.nan
    fit = fit_population(Trials(odd, trials.task), priors=KNOWN)
    alone = fit_population(trials.select(subject=["s3", "s4"]), priors=KNOWN)
    assert fit.weber_fraction == pytest.approx(alone.weber_fraction, rel=1e-9)
    assert [note.split()[0] for note in fit.notes] == ["s1", "s2"]
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


def test_perfect_and_hopeless_animals_are_carried_by_the_others() -> None:
    trials, _ = animals(3, spread=0.1, trials_per_level=30)
    frame = trials.frame.copy()
    first, second = (frame["subject"] == s for s in ("s1", "s2"))
    right = (frame["stimulus_2"] > frame["stimulus_1"]).astype(float)
    frame["count"] = frame["count"].mask(first, right)
    frame.loc[second, "count"] = (np.arange(second.sum()) % 2).astype(float)
    fit = fit_population(Trials(frame, trials.task))
    rows = fit.subjects.set_index("subject")
    assert rows.loc["s1", "status"] == "UPPER_BOUND"
    assert np.isfinite(rows[["weber_fraction", "lower", "upper"]].to_numpy()).all()
    assert rows.loc["s1", "weber_fraction"] > rows.loc["s1", "alone"]


@pytest.mark.parametrize(("column", "sessions"), [("subject", False), ("session", True)])
def test_missing_labels_are_refused(column: str, sessions: bool) -> None:
    trials, _ = animals(2)
    lacking = Trials(trials.frame.drop(columns=column), trials.task)
    with pytest.raises(ValueError, match=f"no column '{column}' to tell {column}s apart"):
        fit_population(lacking, sessions=sessions)


def test_sessions_without_a_subject_are_one_animals() -> None:
    trials = simulate_trials(sessions=2, trials_per_level=20, seed=4)
    fit = fit_population(trials, sessions=True, priors=KNOWN)
    assert fit.status is PopulationStatus.ONE_ANIMAL
    assert fit.sessions is not None
    assert fit.sessions["session"].tolist() == [1, 2]


def test_reading_off_a_fit_and_its_draws_for_arviz() -> None:
    trials, _ = animals(4)
    fit = fit_population(trials, sessions=False, priors=KNOWN)
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
