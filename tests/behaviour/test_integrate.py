"""The one integrator of choices against plain sums over even grids, written here."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy import stats
from scipy.special import logsumexp, ndtr

from weberwhisk.behaviour import fit_weber, read_trials, simulate_trials
from weberwhisk.behaviour.axes import log_lapses_possible, score_prior
from weberwhisk.behaviour.bulk import marginal
from weberwhisk.behaviour.integrate import integrate
from weberwhisk.behaviour.likelihood import WeberModel, build_model


def plain_evidence(model: WeberModel, k: tuple, lapse: tuple, bias: tuple) -> float:
    """Log evidence on an even grid of normal scores, node by node, with no window and no zoom."""
    z, y, x = (np.linspace(*ends) for ends in (k, lapse, bias))
    rho = model.priors.lapse_correlation
    pair = stats.multivariate_normal(cov=[[1, rho], [rho, 1]])
    low, high = np.meshgrid(
        *(model.value(n, y) for n in ("lapse_low", "lapse_high")), indexing="ij"
    )
    prior = pair.logpdf(np.stack(np.meshgrid(y, y, indexing="ij"), -1))
    possible = low + high < 1
    prior = prior[possible] - log_lapses_possible(model.task, model.priors)
    low, high = low[possible], high[possible]
    b = model.priors.value("bias", x)
    total = []
    for i, fraction in enumerate(model.value("weber_fraction", z)):
        for j, one in enumerate(b):
            given = model.log_likelihood(
                np.full(low.shape, fraction), low, high, np.full((low.size, 1), one)
            )
            own = logsumexp(given + prior)
            total.append(own + score_prior(z)[i] + score_prior(x)[j])
    steps = (z[1] - z[0]) * (y[1] - y[0]) ** 2 * (x[1] - x[0])
    return float(logsumexp(total) + np.log(steps))


def test_a_criterion_near_zero_is_not_missed() -> None:
    """All but a few called "different": the evidence was 0.6 nats too low, its error 3e-4.

    The density of a log-normal prior is steep beside the bump of what the answers tell.
    """
    trials = simulate_trials(
        task="same-different", bias=0.0, trials_per_level=20, lapse_low=0.0, lapse_high=0.0, seed=41
    )
    model = fit_weber(trials, method="quadrature").model.merged()
    grid = integrate(model)
    plain = plain_evidence(model, (-5.5, 2.0, 31), (-6.0, 4.0, 25), (-6.5, 2.5, 34))
    assert grid.error < 1e-3
    assert grid.log_evidence == pytest.approx(plain, abs=5e-3)


@pytest.mark.parametrize("per_level", [1, 30, 3000])
def test_finer_grids_tell_the_same_evidence_to_a_thousandth(per_level: int) -> None:
    trials = simulate_trials(
        trials_per_level=per_level, lapse_low=0.03, lapse_high=0.03, bias=0.3, seed=5
    )
    model = fit_weber(trials).model.merged()
    usual, fine = integrate(model), integrate(model, 0.01)
    assert usual.log_evidence == pytest.approx(fine.log_evidence, abs=2e-3)


def test_one_data_set_and_many_tell_the_same() -> None:
    """The batched sums, in single precision and wider steps, against those of the fits."""
    trials = simulate_trials(standards=[1.0, 2.0], trials_per_level=20, seed=6)
    model = fit_weber(trials, bias="per standard").model
    rng = np.random.default_rng(1)
    counts = rng.binomial(model.cells.n.astype(int), model.cells.count / model.cells.n, (40, 18))
    scores, log_like = marginal(model, counts.astype(float))
    log_evidence = logsumexp(log_like + score_prior(scores), axis=1) + np.log(scores[1] - scores[0])
    for count, found in zip(counts[::5], log_evidence[::5], strict=True):
        own = replace(model, cells=replace(model.cells, count=count.astype(float)))
        assert found == pytest.approx(integrate(own).log_evidence, abs=0.08)


def test_a_grid_that_would_be_too_large_is_given_up() -> None:
    model = fit_weber(simulate_trials(standards=[1.0, 4.0], trials_per_level=20, seed=7)).model
    assert np.isinf(integrate(model, most=1e4).error)


@pytest.mark.parametrize("task", ["2AFC", "2AFC percent correct"])
@pytest.mark.parametrize("k", [0.01, 0.1, 1.0])
def test_thousands_of_different_stimuli_are_condensed_without_moving_the_likelihood(
    task: str, k: float
) -> None:
    rng = np.random.default_rng(1)
    s1, s2 = rng.uniform(1.0, 4.0, 3000), rng.uniform(1.0, 4.0, 3000)
    d = (s2 - s1) / np.hypot(s1, s2) / k
    answers = (rng.random(3000) < ndtr(d if task == "2AFC" else np.abs(d))).astype(int)
    kind = {"choice": answers} if task == "2AFC" else {"correct": answers}
    trials = read_trials(pd.DataFrame({"stimulus_1": s1, "stimulus_2": s2} | kind), task=task)
    model = build_model(trials, None, None, None, "weber", None)[0]
    fewer = model.merged()
    assert fewer.cells.n.size < 250
    assert fewer.cells.n.sum() == pytest.approx(3000)
    ks = k * np.geomspace(0.5, 2.0, 5)
    low = high = np.full(5, 0.02)
    bias = np.linspace(-1.0, 1.0, 5)[:, None]
    exact, found = (m.log_likelihood(ks, low, high, bias) for m in (model, fewer))
    np.testing.assert_allclose(found, exact, atol=0.01)


def test_many_trials_in_counts_are_as_quick_as_few_and_right() -> None:
    """Windows were lost to single precision: a billion trials took a thousand times as long."""
    s2 = 1 + np.linspace(-0.3, 0.3, 9)
    p = 0.02 + 0.96 * ndtr((s2 - 1) / np.hypot(1, s2) / 0.1)
    widths = []
    for n in (10**6, 10**8):
        table = {"standard": 1.0, "comparison": s2, "n": n, "n_greater": np.round(n * p)}
        fit = fit_weber(read_trials(pd.DataFrame(table)))
        low, high = fit.interval()
        assert low < 0.1 < high
        widths.append(high - low)
    assert widths[0] / widths[1] == pytest.approx(10.0, rel=0.02)


def test_draws_of_a_bias_on_thousands_of_nodes_fit_into_memory() -> None:
    """A spline between nodes was a matrix: 3600 nodes took 10 s and more than a GB."""
    path = Path(__file__).parents[1] / "data" / "contraction_standard.csv"
    posterior = fit_weber(read_trials(path)).posterior
    tracemalloc.start()
    try:
        posterior.draws()
        _, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert most < 50e6
