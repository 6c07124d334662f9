"""Fits as ArviZ data: counts are counts, the prior density is right, and ArviZ's own tools run."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from weberwhisk.behaviour import (
    FitStatus,
    PopulationFit,
    Priors,
    WeberFit,
    fit_population,
    fit_weber,
    simulate_population,
    simulate_trials,
)
from weberwhisk.behaviour.arviz_data import log_prior_density
from weberwhisk.behaviour.effects import Overdispersion

Array = NDArray[np.float64]


@pytest.fixture(scope="module")
def fit() -> WeberFit:
    return fit_weber(
        simulate_trials(weber_fraction=0.1, standards=[1.0, 2.0, 4.0], trials_per_level=40, seed=3),
        bias="per standard",
    )


@pytest.fixture(scope="module")
def population() -> PopulationFit:
    trials, _ = simulate_population(6, spread=0.4, trials_per_level=8, seed=1)
    return fit_population(trials, check=False)


def loo_pit(arviz: Any, data: Any) -> Array:
    if arviz.__version__.startswith("0."):
        return np.asarray(arviz.loo_pit(data, y="answers", y_hat="answers"), dtype=float)
    return np.asarray(arviz.loo_pit(data)["answers"], dtype=float)


def sensitivity(arviz: Any, data: Any, to: str) -> Any:
    if arviz.__version__.startswith("0."):
        return arviz.psens(data, component=to)
    return arviz.psense(data, group=to)


def test_counts_are_integers_and_loo_pit_takes_them_as_such(arviz: Any, fit: WeberFit) -> None:
    """As floats they were taken for a continuous quantity, and a true model looked biased."""
    data = fit.to_arviz()
    for group, name in (
        ("observed_data", "answers"), ("posterior_predictive", "answers"), ("constant_data", "n")
    ):  # fmt: skip
        assert data[group][name].dtype == np.int64
    np.testing.assert_array_equal(data["observed_data"]["answers"], fit.model.cells.count)
    assert loo_pit(arviz, data).mean() == pytest.approx(0.5, abs=0.12)


def test_the_prior_density_is_that_of_the_scores_carried_over(fit: WeberFit) -> None:
    """Each parameter is a function of a normal score; two lapses of scores that correlate."""
    draws = fit.posterior.draws().at(slice(0, 200))
    found = log_prior_density(fit.model, draws)
    assert {name: values.shape for name, values in found.items()} == {
        "weber_fraction": (200,), "lapses": (200,), "bias": (200, 3)
    }  # fmt: skip
    priors: Priors = fit.model.priors
    scores = np.linspace(-8, 8, 4001)

    def carried(name: str, values: Array) -> tuple[Array, Array]:
        """The score of each value, and the log of how fast the value moves with it."""
        grid = np.log(priors.value(name, scores))
        z = np.interp(np.log(values), grid, scores)
        ends = (np.log(priors.value(name, z + sign * 1e-4)) for sign in (1, -1))
        return z, np.log(np.subtract(*ends) / 2e-4) + np.log(values)

    z, speed = carried("weber_fraction", draws.weber_fraction)
    expected = -0.5 * z**2 - 0.5 * np.log(2 * np.pi) - speed
    np.testing.assert_allclose(found["weber_fraction"], expected, atol=1e-4)
    (a, fast), (b, faster) = (carried(n, getattr(draws, n)) for n in ("lapse_low", "lapse_high"))
    rho = priors.lapse_correlation
    covariance = np.array([[1, rho], [rho, 1]])
    both = np.stack([a, b])
    expected = -0.5 * np.einsum("ik,ij,jk->k", both, np.linalg.inv(covariance), both)
    expected -= np.log(2 * np.pi) + 0.5 * np.log(np.linalg.det(covariance)) + fast + faster
    np.testing.assert_allclose(found["lapses"], expected, atol=2e-3)
    np.testing.assert_allclose(found["bias"], priors.bias.logpdf(draws.bias))


def test_arviz_says_what_moves_an_estimate(arviz: Any, fit: WeberFit) -> None:
    data = fit.to_arviz()
    prior, likelihood = (sensitivity(arviz, data, to) for to in ("prior", "likelihood"))
    assert float(likelihood["weber_fraction"]) > float(prior["weber_fraction"])
    few = fit_weber(simulate_trials(trials_per_level=2, seed=3)).to_arviz()
    assert float(sensitivity(arviz, few, "prior")["weber_fraction"]) > 0.08


def test_units_and_what_the_likelihood_is_of_travel_with_the_file(
    arviz: Any, fit: WeberFit, tmp_path: Path
) -> None:
    path = str(tmp_path / "fit.nc")
    fit.to_arviz().to_netcdf(path)
    data = arviz.from_netcdf(path)
    units = {name: data["posterior"][name].attrs["units"] for name in ("weber_fraction", "bias")}
    assert units == {"weber_fraction": "1", "bias": "sd of the difference between the signals"}
    assert data["constant_data"]["stimulus_2"].attrs["units"] == "unit of the column stimulus_2"
    assert "leaves out a pair" in data["log_likelihood"].attrs["comment"]
    assert data["observed_data"]["answers"].dtype == np.int64
    assert "units" not in data["log_prior"]["weber_fraction"].attrs
    if hasattr(data, "close"):
        data.close()


@pytest.mark.parametrize(
    ("table", "options", "named"),
    [
        pytest.param({"task": "3AFC percent correct"}, {}, {"weber_fraction", "lapse_high"},
                     marks=pytest.mark.slow),
        pytest.param({"task": "yes/no"}, {}, {"weber_fraction", "lapses", "bias"},
                     marks=pytest.mark.slow),
        ({}, {"effects": [Overdispersion()], "bias": "none"},
         {"weber_fraction", "overdispersion", "lapses"}),
        pytest.param({}, {"priors": {"lapse_correlation": 0.0, "bias": 0.1}},
                     {"weber_fraction", "lapse_low", "lapse_high"}, marks=pytest.mark.slow),
        ({}, {"states": 2},
         {"weber_fraction", "lapses", "bias", "engaged", "switch", "answer_away"}),
        ({}, {"method": "emcee"}, {"weber_fraction", "lapses", "bias"}),
    ],
)  # fmt: skip
def test_every_kind_of_fit_has_its_prior_density(
    arviz: Any, table: dict[str, Any], options: dict[str, Any], named: set[str]
) -> None:
    fit = fit_weber(simulate_trials(trials_per_level=12, seed=2, **table), **options)
    data = fit.to_arviz()
    assert set(data["log_prior"].data_vars) == named
    for name in named:
        assert np.isfinite(data["log_prior"][name].to_numpy()).all()
        assert data["log_prior"][name].shape[:2] == data["posterior"]["weber_fraction"].shape
    if fit.model.n_states > 1:
        assert "LOO of it means nothing" in data["log_likelihood"].attrs["comment"]
    assert fit.status is not FitStatus.NOT_CONVERGED


def test_a_population_has_its_animals_and_leaves_them_out(
    arviz: Any, population: PopulationFit
) -> None:
    data = population.to_arviz()
    assert data["posterior"]["subject_weber_fraction"].dims == ("chain", "draw", "subject")
    assert data["posterior"]["subject"].to_numpy().tolist() == ["s1", "s2", "s3", "s4", "s5", "s6"]
    drawn = data["posterior"]["subject_weber_fraction"].to_numpy().reshape(4000, 6)
    table = population.subjects
    width = (table["upper"] - table["lower"]).to_numpy()
    ends = np.quantile(drawn, [0.025, 0.5, 0.975], axis=0)
    for found, name in zip(ends, ("lower", "weber_fraction", "upper"), strict=True):
        np.testing.assert_allclose(found, table[name], atol=0.12 * width.max())
        assert abs((found - table[name]) / width).mean() < 0.05
    left_out = arviz.loo(data, pointwise=True)
    pointwise = left_out["elpd_i"] if hasattr(left_out, "elpd_i") else left_out["loo_i"]
    assert np.size(pointwise) == 6
    assert float(sensitivity(arviz, data, "prior")["spread"]) > 0.02
    assert data["posterior"]["spread"].attrs["units"] == "1"
    np.testing.assert_array_equal(data["constant_data"]["n"], table["n"])


def test_the_likelihood_of_an_animal_is_its_own_averaged_over_the_population() -> None:
    trials, _ = simulate_population(4, trials_per_level=12, seed=2)
    known = {"lapse_low": 0.02, "lapse_high": 0.02, "bias": 0.0}
    fit = fit_population(trials, priors=known, check=False)
    assert fit.population is not None
    scores = fit.population.draws.resampled(20, np.random.default_rng(1))
    values = fit.population.hierarchy.values(scores)
    likelihood, _ = fit.population.given(scores, np.random.default_rng(1))
    z = np.linspace(-6, 6, 2001)
    k = values["weber_fraction"][:, None] * np.exp(values["spread"][:, None] * z)
    lapse, bias = np.full(k.shape, 0.02), np.zeros((*k.shape, 1))
    for animal in (0, 3):
        model = fit.fits.model(trials.subjects[animal])
        at = model.log_likelihood(k, lapse, lapse, bias)
        top = at.max(axis=1, keepdims=True)
        direct = np.log(np.exp(at - top) @ np.exp(-0.5 * z**2) / np.exp(-0.5 * z**2).sum())
        wide = values["spread"] > 0.1  # narrower ones are not distinguished
        np.testing.assert_allclose((likelihood[animal] - direct - top[:, 0])[wide], 0.0, atol=0.05)


@pytest.mark.parametrize("draws", [0, -1, 2.5, "many"])
def test_a_number_of_draws_is_a_whole_one(population: PopulationFit, draws: Any) -> None:
    with pytest.raises(ValueError, match="draws must be a whole number"):
        population.to_arviz(draws=draws)
