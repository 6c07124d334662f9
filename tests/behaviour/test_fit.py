"""The fit: against brute force and emcee, on data that tell all, little, or nothing."""

from __future__ import annotations

import json
from functools import cache

import numpy as np
import pandas as pd
import pytest
from choice_tables import NINE, counted, expected_counts
from scipy import stats
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize
from short_forms import slow_but

from weberwhisk._util.values import interval_text
from weberwhisk.behaviour import (
    FitStatus,
    Priors,
    Trials,
    WeberFit,
    fit_weber,
    read_trials,
    simulate_trials,
)
from weberwhisk.behaviour.encodings import LogEncoding
from weberwhisk.behaviour.posteriors import prior_draws

ENDS = [0.025, 0.5, 0.975]


# -- the posterior is the posterior ---------------------------------------------------------------


@cache
def lapses_possible() -> float:
    """Prior probability that lapses are not more than 1 in all, as they cannot be."""
    scores = stats.multivariate_normal(cov=[[1, 0.7], [0.7, 1]]).rvs(400_000, random_state=1)
    return float(np.mean(stats.beta(0.7, 20).ppf(stats.norm.cdf(scores)).sum(axis=1) < 1))


def brute_force(trials: Trials, bias: str, n_k: int = 61, n_b: int = 121, n_l: int = 31) -> dict:
    """The posterior on an even grid, written anew with SciPy's distributions, in two passes.

    The axes are ln k, and normal scores under the priors: of the lapses (correlated by 0.7), and of
    the bias, which is integrated standard by standard. The second pass has the window of the first.
    """
    c = trials.cells()
    drive = (c.stimulus_2 - c.stimulus_1) / np.hypot(c.stimulus_1, c.stimulus_2)
    groups = [c.standard == s for s in np.unique(c.standard)]
    if bias != "per standard":
        groups = [np.ones(c.n.size, bool)]
    windows = [(np.log(0.1) - 5, np.log(0.1) + 5), (-5.0, 5.0), (-5.0, 5.0), (-5.0, 5.0)]
    for sizes in ((31, 13, 13, 61), (n_k, n_l, n_l, n_b)):
        axes = [np.linspace(*w, n) for w, n in zip(windows, sizes, strict=True)]
        ln_k, z_low, z_high, b = axes
        if bias == "none":
            b = np.zeros(1)  # the median
        low, high = (stats.beta(0.7, 20).ppf(stats.norm.cdf(z)) for z in (z_low, z_high))
        low, high = low[:, None, None, None], high[None, :, None, None]
        prior_b = stats.norm.pdf(b) * (b[1] - b[0]) if b.size > 1 else np.ones(1)
        b = stats.cauchy(0, 0.7).ppf(stats.norm.cdf(b))
        log_post = np.empty([a.size for a in axes[:3]])
        for i, k in enumerate(np.exp(ln_k)):
            total = np.zeros(log_post.shape[1:])
            for g in groups:
                up = stats.norm.cdf(drive[g] / k + b[:, None])
                p = np.clip(low + (1 - low - high) * up, 1e-14, 1 - 1e-14)
                ll = np.log(p) @ c.count[g] + np.log1p(-p) @ (c.n[g] - c.count[g])
                top = ll.max()
                total += np.log(np.maximum(np.exp(ll - top) @ prior_b, 1e-300)) + top
            log_post[i] = total + stats.norm.logpdf(ln_k[i], np.log(0.1), np.log(3))
        pair = stats.multivariate_normal(cov=[[1, 0.7], [0.7, 1]])
        log_post += pair.logpdf(np.stack(np.meshgrid(z_low, z_high, indexing="ij"), -1))
        weight = np.exp(log_post - log_post.max())
        for i in range(3):
            m = weight.sum(axis=tuple(j for j in range(3) if j != i))
            held = np.flatnonzero(m > 1e-7 * m.max())
            step = axes[i][1] - axes[i][0]
            windows[i] = (axes[i][held[0]] - step, axes[i][held[-1]] + step)
    marginal = weight.sum(axis=(1, 2))
    spline = CubicSpline(ln_k, np.log(np.maximum(marginal, 1e-290)))
    fine = np.linspace(ln_k[0], ln_k[-1], 4001)
    cdf = np.cumsum(np.exp(spline(fine)))
    cell = np.prod([a[1] - a[0] for a in axes[:3]])
    return {
        "ends": np.exp(np.interp(ENDS, cdf / cdf[-1], fine)),
        "log_evidence": np.log(weight.sum() * cell / lapses_possible()) + log_post.max(),
        "lapse_mean": [
            float(weight.sum(axis=(0, 2)) @ low.ravel() / weight.sum()),
            float(weight.sum(axis=(0, 1)) @ high.ravel() / weight.sum()),
        ],
    }


BRUTE = {
    "300 trials": (dict(trials_per_level=33, lapse_low=0.02, lapse_high=0.02, seed=3), "shared"),
    "45 trials": (dict(trials_per_level=5, weber_fraction=0.3, seed=4), "shared"),
    "36 trials": (
        dict(trials_per_level=4, lapse_low=0.1, lapse_high=0.05, bias=0.7, seed=11), "shared",
    ),
    "999 trials": (dict(trials_per_level=111, lapse_high=0.03, bias=-0.3, seed=12), "shared"),
    "high lapses": (dict(trials_per_level=20, lapse_low=0.2, lapse_high=0.1, seed=5), "shared"),
    "nearly perfect": (dict(trials_per_level=20, weber_fraction=0.02, seed=6), "shared"),
    "one side": (dict(offsets=[0.05, 0.1, 0.2, 0.4], trials_per_level=30, seed=7), "shared"),
    "no bias": (dict(trials_per_level=10, seed=8), "none"),
    "two biases": (
        dict(standards=[1.0, 2.0], bias=[0.8, -0.8], offsets=[-0.2, 0.2], trials_per_level=60,
             seed=9),
        "per standard",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", slow_but(BRUTE, (8,)))
def test_interval_ends_within_one_percent_of_brute_force(name: str) -> None:
    options, bias = BRUTE[name]
    trials = simulate_trials(**options)  # type: ignore[arg-type]
    fit = fit_weber(trials, bias=bias)
    exact = brute_force(trials, bias)
    np.testing.assert_allclose(
        fit.posterior.quantile("weber_fraction", ENDS), exact["ends"], rtol=0.01
    )
    assert fit.log_evidence == pytest.approx(exact["log_evidence"], abs=0.02)
    for name, mean in zip(("lapse_low", "lapse_high"), exact["lapse_mean"], strict=True):
        assert fit.posterior.mean(name) == pytest.approx(mean, rel=0.05, abs=5e-4)


def test_bias_interval_against_brute_force() -> None:
    """One bias, by itself: everything else known."""
    trials = simulate_trials(bias=0.4, trials_per_level=6, seed=10)
    fit = fit_weber(trials, priors={"weber_fraction": 0.1, "lapse_low": 0.0, "lapse_high": 0.0})
    assert fit.parameters == ("bias",)
    c = trials.cells()
    b = np.linspace(-40, 40, 80001)
    z = (c.stimulus_2 - 1) / np.hypot(1, c.stimulus_2) / 0.1 + b[:, None]
    log_post = stats.norm.logcdf(z) @ c.count + stats.norm.logcdf(-z) @ (c.n - c.count)
    cdf = np.cumsum(np.exp(log_post - log_post.max()) * stats.cauchy(0, 0.7).pdf(b))
    exact = np.interp(ENDS, cdf / cdf[-1], b)
    np.testing.assert_allclose(fit.posterior.quantile("bias", ENDS), exact, atol=2e-3)
    evidence = np.log(cdf[-1] * (b[1] - b[0])) + log_post.max()
    assert fit.log_evidence == pytest.approx(evidence, abs=1e-3)


def test_draws_are_the_same_posterior() -> None:
    fit = fit_weber(simulate_trials(trials_per_level=8, seed=11))
    draws = fit.posterior.draws().named(fit.model)
    assert set(draws) == set(fit.parameters)
    for name in fit.parameters:
        n = draws[name].size
        sd = fit.posterior.sd(name)
        assert draws[name].mean() == pytest.approx(fit.posterior.mean(name), abs=5 * sd / n**0.5)
        # Share of draws below a quantile: binomial, and draws by rejection are independent.
        for p in (0.025, 0.25, 0.5, 0.75, 0.975):
            below = np.mean(draws[name] < fit.posterior.quantile(name, p))
            assert below == pytest.approx(p, abs=4.5 * np.sqrt(p * (1 - p) / n))


@pytest.mark.slow  # of emcee for fits: `test_arviz_data.py`
@pytest.mark.parametrize(
    ("options", "bias"),
    [
        pytest.param(
            dict(trials_per_level=33, lapse_low=0.02, lapse_high=0.05, seed=12),
            "shared",
            marks=pytest.mark.slow,
        ),
        (
            dict(standards=[1.0, 3.0], bias=[0.5, -0.5], trials_per_level=10, seed=13),
            "per standard",
        ),
    ],
)
def test_emcee_agrees(options: dict, bias: str) -> None:
    trials = simulate_trials(**options)
    exact = fit_weber(trials, bias=bias)
    sampled = fit_weber(trials, bias=bias, method="emcee", seed=1)
    assert sampled.status is exact.status is FitStatus.DETERMINED
    assert sampled.parameters == exact.parameters
    for name in exact.parameters:
        sd = exact.posterior.sd(name)
        # 2 % of an sd is what the run was asked for; allow four of that.
        assert sampled.posterior.mean(name) == pytest.approx(
            exact.posterior.mean(name), abs=4 * max(sampled.posterior.error, 0.02) * sd
        )
        assert sampled.posterior.sd(name) == pytest.approx(sd, rel=0.1)
    assert sampled.log_evidence is None


# -- what a fit gives -----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def fit() -> WeberFit:
    return fit_weber(
        simulate_trials(standards=[1.0, 2.0], lapse_low=0.02, lapse_high=0.05, bias=0.3, seed=15)
    )


def test_summary(fit: WeberFit) -> None:
    table = fit.summary()
    assert table.index.tolist() == ["weber_fraction", "lapse_low", "lapse_high", "bias"]
    assert (table["lower"] < table["median"]).all()
    assert (table["median"] < table["upper"]).all()
    assert table.loc["weber_fraction", "median"] == fit.weber_fraction
    assert tuple(table.loc["weber_fraction", ["lower", "upper"]]) == fit.interval(0.95)
    assert table.loc["lapse_low", "prior"] == "beta(0.7, 20)"
    narrow = fit.summary(mass=0.5)
    assert (narrow["lower"] > table["lower"]).all()


def test_threshold_is_the_posterior_of_the_threshold(fit: WeberFit) -> None:
    table = fit.threshold()
    assert table["standard"].tolist() == [1.0, 2.0]
    criterion = '75 % "second greater", 2AFC, lapses and bias removed'
    assert table["criterion"].unique().tolist() == [criterion]
    # Weber's law: the same ratio at every standard.
    np.testing.assert_allclose(table["comparison"] / table["standard"], table["comparison"][0])
    # By draws, each through the closed form.
    k = fit.posterior.draws().weber_fraction
    q = k * stats.norm.ppf(0.75)
    point = (1 + q * np.sqrt(2 - q * q)) / (1 - q * q)
    sd = point.std()
    np.testing.assert_allclose(
        table.loc[0, ["lower", "comparison", "upper"]].astype(float),
        np.quantile(point, ENDS), atol=0.15 * sd,
    )  # fmt: skip


def late_animal() -> WeberFit:
    """An animal that calls a comparison equal where it is greater by a quarter."""
    levels = np.array([170.0, 184, 198, 212, 226, 240, 254, 268, 282, 296])
    point = 246.0
    p = stats.norm.cdf((levels - point) / (0.1 * np.hypot(200, point)))
    frame = pd.DataFrame({"stimulus_1": 200.0, "stimulus_2": levels, "n": 240,
                          "n_greater": np.round(240 * p)})  # fmt: skip
    return fit_weber(read_trials(frame))


def test_thresholds_say_what_was_taken_out_and_the_report_has_the_point_of_equality() -> None:
    """The line "75 %, lapses removed: 213.6" stood where 8 % of the answers were greater."""
    fit = late_animal()
    sensitivity, curve = fit.threshold().loc[0], fit.threshold(with_bias=True).loc[0]
    assert sensitivity["criterion"].endswith("lapses and bias removed")
    assert curve["criterion"].endswith("lapses removed, bias kept")
    equal = fit.subjective_equality().loc[0]
    assert equal["criterion"] == '50 % "second greater", 2AFC, lapses removed, bias kept'
    assert equal["comparison"] == pytest.approx(246, abs=2)
    assert equal["lower"] < equal["comparison"] < equal["upper"]
    # On the curve, where the proportion is as the fitted curve has it; the other is not.
    there, not_there = fit.psychometric([curve["comparison"], sensitivity["comparison"]])["median"]
    assert there == pytest.approx(0.75, abs=0.02)
    assert not_there < 0.25
    text = fit.report()
    assert 'PSE, the point of subjective equality: 50 % "second greater", 2AFC, ' in text
    assert 'JND, from the standard to 75 % "second greater", 2AFC, lapses and bias removed.' in text
    jnd = interval_text(*(sensitivity[["comparison", "lower", "upper"]] - 200))
    said = f"From standard 200: PSE {interval_text(*equal[['comparison', 'lower', 'upper']])}"
    assert f"{said}; JND {jnd}." in text
    (row,) = json.loads(fit.to_json())["points_of_subjective_equality"]
    assert row["comparison"] == equal["comparison"]


def test_a_criterion_is_kept_and_named_and_what_has_no_bias_names_none() -> None:
    yes = fit_weber(simulate_trials(task="yes/no", seed=1))
    assert yes.threshold()["criterion"][0] == '75 % "yes", yes/no, lapses removed, criterion kept'
    assert yes.threshold(with_bias=False)["criterion"][0].endswith("lapses and criterion removed")
    assert "subjective equality" not in yes.report()
    with pytest.raises(ValueError, match="of a choice between two stimuli, got the task yes/no"):
        yes.subjective_equality()
    plain = fit_weber(simulate_trials(seed=1), bias="none")
    assert plain.threshold()["criterion"][0].endswith("2AFC, lapses removed")
    assert "subjective equality" not in plain.report()  # the standards, by assumption
    np.testing.assert_allclose(plain.subjective_equality()["difference"], 0, atol=1e-6)


def test_thresholds_do_not_carry_lapses() -> None:
    """Raw 75 % points with 10 % lapse a side overstate the JND by 31 % (docs/theory/jnd.md)."""
    raw = stats.norm.ppf((0.75 - 0.1) / 0.8) / stats.norm.ppf(0.75)
    assert raw == pytest.approx(1.315, abs=1e-3)
    many = counted(NINE.tolist(), 100_000, expected_counts(NINE, 100_000, 0.1, lapse=0.1))
    row = fit_weber(many).threshold().loc[0]
    q = 0.1 * stats.norm.ppf(0.75)
    assert row["comparison"] == pytest.approx((1 + q * np.sqrt(2 - q * q)) / (1 - q * q), abs=2e-3)


def test_thresholds_out_of_reach_in_many_draws_are_infinite_not_nan() -> None:
    """Interpolating between two infinite draws made NaN, with a warning."""
    few = simulate_trials(
        weber_fraction=0.5, standards=6.0, offsets=[0.2, 2.0], missing=0.9, task="yes/no", seed=0
    )
    row = fit_weber(few).threshold(6.0, 0.95).loc[0]
    assert row["unreachable"] > 0.1
    assert row["upper"] == np.inf
    assert 0 < row["lower"] < row["comparison"]


@pytest.fixture(scope="module")
def biased() -> WeberFit:
    """One bias for two standards, at which the animal has two; empty priors are the defaults."""
    trials = simulate_trials(standards=[1.0, 2.0], bias=[1.2, -1.2], trials_per_level=50, seed=16)
    return fit_weber(trials, priors={})


@pytest.mark.usefixtures("few_draws")
@pytest.mark.slow  # of options: `test_misfit.py`
def test_a_remedy_keeps_the_encoding_and_priors_of_the_fit(biased: WeberFit) -> None:
    """The line that was given left out an encoding and priors of one's own."""
    given = {"priors": {"lapse_low": 0.02}, "encoding": LogEncoding()}
    own = fit_weber(biased.trials, **given)
    assert "of this fit" not in biased.report()
    assert ", and the encoding and priors of this fit" in own.report()


def test_misfit_is_found_and_the_remedy_named(biased: WeberFit) -> None:
    shared, own = biased, fit_weber(biased.trials, bias="per standard")
    assert shared.misfit < 0.001
    assert shared.status is FitStatus.MISFIT_CURVE
    assert "first fit_weber(trials, bias='per standard')" in shared.report()
    assert own.misfit > 0.01
    assert own.log_evidence is not None
    assert shared.log_evidence is not None
    assert own.log_evidence > shared.log_evidence + 10
    truth = {"bias[1]": 1.2, "bias[2]": -1.2}
    for name, value in truth.items():
        low, high = own.interval(parameter=name)
        assert low < value < high


def test_json_and_report(fit: WeberFit) -> None:
    found = json.loads(fit.to_json())
    assert found["status"] == "PRIOR_DEPENDENT"  # lapses of 5 %: the lower end goes by the belief
    assert found["weber_fraction"] == fit.weber_fraction
    assert found["settings"]["bias"] == "shared"
    text = fit.report()
    for heading in (
        "Data.",
        "What the data say.",
        "What they cannot say.",
        "What to collect next.",
    ):
        assert heading in text
    assert "75 %" in text


def test_arviz(fit: WeberFit) -> None:
    data = fit.to_arviz()
    assert data.posterior["weber_fraction"].dims == ("chain", "draw")
    assert data.log_likelihood["answers"].shape[2:] == (18,)
    np.testing.assert_array_equal(data.observed_data["answers"], fit.model.cells.count)
    assert float(data.posterior["weber_fraction"].mean()) == pytest.approx(0.1, rel=0.15)
    assert set(data.prior.data_vars) == set(data.posterior.data_vars) == set(fit.parameters)
    # The prior's own quantiles, and counts that the fitted observer would give.
    prior = Priors().weber_fraction
    share = float((data.prior["weber_fraction"] < prior.ppf(0.25)).mean())
    assert share == pytest.approx(0.25, abs=4 * np.sqrt(0.25 * 0.75 / 4000))
    again = data.posterior_predictive["answers"]
    assert again.shape == data.log_likelihood["answers"].shape
    assert float(again.sum("cell").mean()) == pytest.approx(fit.model.cells.count.sum(), rel=0.05)


def test_map_is_the_top_of_the_density() -> None:
    trials = simulate_trials(bias=0.4, trials_per_level=12, seed=18)
    known = {"lapse_low": 0.01, "lapse_high": 0.01, "bias": stats.norm(0, 1)}
    found = fit_weber(trials, priors=known).map
    c = trials.cells()
    drive = (c.stimulus_2 - c.stimulus_1) / np.hypot(c.stimulus_1, c.stimulus_2)

    def cost(theta: np.ndarray) -> float:
        p = 0.01 + 0.98 * stats.norm.cdf(drive / np.exp(theta[0]) + theta[1])
        prior = stats.norm.logpdf(theta[0], np.log(0.1), np.log(3)) + stats.norm.logpdf(theta[1])
        return -float(stats.binom.logpmf(c.count, c.n, p).sum() + prior)

    top = minimize(cost, [np.log(0.1), 0.0], method="Nelder-Mead", options={"xatol": 1e-6}).x
    assert found["weber_fraction"] == pytest.approx(np.exp(top[0]), rel=1e-3)
    assert found["bias"] == pytest.approx(top[1], abs=1e-3)


def test_lapse_sensitivity_is_what_the_other_priors_give() -> None:
    trials = simulate_trials(trials_per_level=40, lapse_low=0.05, lapse_high=0.05, seed=19)
    one = fit_weber(trials)
    table = one.lapse_sensitivity.set_index("lapses")
    assert table.loc["as fitted", "weber_fraction"] == one.weber_fraction
    for name, belief in (
        ("never", 0.0),
        ("seldom", stats.beta(1, 20)),
        ("often", stats.beta(1, 9)),
    ):
        other = fit_weber(trials, priors={"lapse_low": belief, "lapse_high": belief})
        row = table.loc[name]
        assert row["weber_fraction"] == pytest.approx(other.weber_fraction, rel=1e-6)
        assert (row["lower"], row["upper"]) == pytest.approx(other.interval(), rel=1e-6)
        assert row["change"] == pytest.approx(other.weber_fraction / one.weber_fraction - 1)
    # What lapses explain is not put down to noise.
    assert table.loc["never", "weber_fraction"] > table.loc["often", "weber_fraction"]
    known = fit_weber(trials, priors={"lapse_low": 0.1, "lapse_high": 0.1})
    assert known.lapse_sensitivity["lapses"].tolist() == ["as fitted"]


def test_draws_from_the_priors_are_what_the_priors_say(fit: WeberFit) -> None:
    """Of equal stimuli, with SciPy alone: half of all counts lie below one half."""
    rng = np.random.default_rng(1)
    found = fit.model.simulate(prior_draws(fit.model, 4000, rng), rng) / fit.model.cells.n
    z = rng.multivariate_normal([0, 0], [[1, 0.7], [0.7, 1]], 40_000).T
    low, high = stats.beta(0.7, 20).ppf(stats.norm.cdf(z))
    low, high = (side[low + high < 1] for side in (low, high))
    p = low + (1 - low - high) * stats.norm.cdf(rng.standard_normal(low.size))
    share = rng.binomial(40, p) / 40
    cells = fit.model.cells
    equal = np.flatnonzero((cells.stimulus_1 == cells.stimulus_2) & (cells.n == 40))[0]
    ends = np.quantile(found[:, equal], ENDS)
    np.testing.assert_allclose(ends, np.quantile(share, ENDS), atol=0.051)  # two counts of 40
