"""Truths rank uniformly among draws from their posteriors, unless the model is wrong."""

from __future__ import annotations

import numpy as np
import pytest
from analysis_scripts import load
from scipy import stats
from short_forms import slow_but

from weberwhisk import Observer

calibration = load("calibration")
#: Sets of ranks looked at here: with a correct model one in two thousand runs of all fails.
RARE = 1e-3 / 20


def test_p_is_uniform_where_ranks_are_and_small_where_they_are_not() -> None:
    rng = np.random.default_rng(2)
    p = [calibration.uniform_p(rng.random(100)) for _ in range(300)]
    assert stats.kstest(p, "uniform").pvalue > 1e-3
    assert calibration.uniform_p(rng.random(200) ** 1.5) < 1e-3
    assert calibration.uniform_p(stats.norm.cdf(1.3 * rng.standard_normal(300))) < 0.01


@pytest.mark.parametrize(
    ("name", "n"),
    slow_but(
        [
            ("vibrissa length (a)", 300),
            ("vibration with phase (d)", 300),
            ("compliance (e)", 300),
            ("balance, effort known (h)", 100),
            ("balance, effort known (h)", 300),
        ],
        (0, 1),
    ),
)
def test_one_unknown(name: str, n: int) -> None:
    ranks, flagged = calibration.posterior_ranks(calibration.CUES[name], n, seed=11)
    assert flagged < 0.1
    assert min(map(calibration.uniform_p, ranks.values())) > RARE


@pytest.mark.parametrize(
    ("name", "method", "n"),
    slow_but(
        [
            ("force map (f)", "quadrature", 30),
            ("compliance, velocity felt (e)", "quadrature", 100),
            ("compliance (e)", "emcee", 50),
        ],
        (0,),
    ),
)
def test_engines(name: str, method: str, n: int) -> None:
    ranks, flagged = calibration.posterior_ranks(calibration.CUES[name], n, method, seed=12)
    assert flagged < 0.2
    assert min(map(calibration.uniform_p, ranks.values())) > RARE


@pytest.mark.parametrize("name", slow_but(["2AFC, 5 trials a level", "percent correct"], [1]))
def test_fits(name: str) -> None:
    ranks, flagged = calibration.fit_ranks(calibration.FITS[name], 20, seed=13)
    assert flagged < 0.05
    assert min(map(calibration.uniform_p, ranks.values())) > RARE


@pytest.mark.parametrize(
    "name",
    slow_but(
        (n for n in calibration.BROKEN if "softer" not in n),
        (0, 3),
    ),
)
def test_a_broken_likelihood_is_caught(name: str) -> None:
    """Of two unknowns by the likelihood's ranks, with half of the readings of the short form."""
    truth, assumed = calibration.BROKEN[name]
    assert isinstance(assumed, Observer)
    n = calibration.SHORT[-1] // (2 if len(truth.unknowns) > 1 else 1)
    ranks, _ = calibration.posterior_ranks(truth, n, assumed=assumed, seed=14)
    assert min(map(calibration.uniform_p, ranks.values())) < RARE * 20


@pytest.mark.slow
def test_ignored_lapses_are_caught() -> None:
    design, assumed = calibration.BROKEN_FITS["lapses ignored"]
    ranks, _ = calibration.fit_ranks(design, 30, assumed=assumed, seed=15)
    assert calibration.uniform_p(ranks["weber_fraction"]) < RARE * 20


@pytest.mark.slow
def test_everything_in_full() -> None:
    rows = calibration.run_all(calibration.FULL)
    p = np.array([calibration.uniform_p(r.ranks) for r in rows if r.group != "broken"])
    assert p.min() > 0.01 / p.size
    for name in [*calibration.BROKEN, *calibration.BROKEN_FITS]:
        assert min(calibration.uniform_p(r.ranks) for r in rows if r.name == name) < 0.01
