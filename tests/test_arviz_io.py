"""Conversion to ArviZ, and diagnostics to ArviZ's own digits."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import emcee
import numpy as np
import pytest
from numpy.typing import NDArray

from weberwhisk.inference import arviz_io as diagnostics
from weberwhisk.inference.arviz_io import to_arviz

Array = NDArray[np.float64]


def chains(draws: int, memory: float, *, ties: bool, seed: int) -> Array:
    """Four first-order autoregressive chains, with repeated values as in Metropolis chains."""
    rng = np.random.default_rng(seed)
    x = rng.normal(size=(4, draws))
    for t in range(1, draws):
        x[:, t] += memory * x[:, t - 1]
    return np.round(x, 1) if ties else x


# -- diagnostics -------------------------------------------------------------------------------


@pytest.mark.parametrize("draws", [8, 9, 10, 11, 51, 200])
@pytest.mark.parametrize("memory", [-0.9, 0.0, 0.5, 0.95])
@pytest.mark.parametrize("ties", [False, True])
def test_diagnostics_have_arviz_digits(arviz: Any, draws: int, memory: float, ties: bool) -> None:
    batch = np.stack([chains(draws, memory, ties=ties, seed=s) for s in range(4)])
    theirs = np.array([arviz.rhat(x) for x in batch], dtype=float)
    np.testing.assert_allclose(diagnostics.rhat(batch), theirs, rtol=1e-10)


@pytest.mark.parametrize("memory", [0.0, 0.5, 0.95])
def test_integrated_time_has_emcee_digits(memory: float) -> None:
    batch = np.stack([chains(500, memory, ties=False, seed=s) for s in range(3)])
    theirs = [emcee.autocorr.integrated_time(x.T, tol=0)[0] for x in batch]
    covariance = diagnostics.autocovariance(batch)
    ours = diagnostics.windowed_time((covariance / covariance[..., :1]).mean(axis=-2))
    np.testing.assert_allclose(ours, theirs, rtol=1e-10)


def test_diagnostics_keep_leading_axes() -> None:
    x = np.random.default_rng(1).normal(size=(2, 3, 4, 100))
    together = diagnostics.rhat(x)
    assert together.shape == (2, 3)
    np.testing.assert_allclose(together[1, 2], diagnostics.rhat(x[1, 2]), rtol=1e-12)


def test_long_run_variance_of_a_known_process() -> None:
    # For memory 0.8 the variance is 1/(1 - 0.64), the integrated time 1.8/0.2.
    x = np.stack([chains(4000, 0.8, ties=False, seed=s) for s in range(20)])
    variance, time = diagnostics.long_run_variance(x)
    assert variance.mean() == pytest.approx(9 / 0.36, rel=0.05)
    assert time.mean() == pytest.approx(9.0, rel=0.05)
    # Chains that disagree widen it by what their scatter implies.
    apart, _ = diagnostics.long_run_variance(x + np.arange(4)[:, None])
    assert np.all(apart > 10 * variance)


def test_rhat_sees_place_and_spread() -> None:
    x = np.random.default_rng(2).normal(size=(50, 4, 500))
    assert np.all(diagnostics.rhat(x) < 1.02)
    one = np.array([0.0, 0.0, 0.0, 1.0])[:, None]
    assert np.all(diagnostics.rhat(x + one) > 1.05)
    assert np.all(diagnostics.rhat(x * (1 + one)) > 1.03)


def test_diagnostics_of_draws_that_are_not_numbers_are_nan() -> None:
    x = np.random.default_rng(3).normal(size=(2, 4, 20))
    x[1, 0, 3] = np.nan
    assert np.isnan(diagnostics.rhat(x)).tolist() == [False, True]
    assert np.isnan(diagnostics.rhat(np.ones((4, 20))))


@pytest.mark.parametrize("shape", [(20,), (4, 3), (1, 20)])
def test_too_few_draws_are_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match=r"Draws must have shape \(..., chain, draw\)"):
        diagnostics.rhat(np.zeros(shape))


# -- ArviZ data --------------------------------------------------------------------------------


def example(**more: Any) -> Any:
    rng = np.random.default_rng(4)
    return to_arviz(
        {"distance": rng.normal(size=(4, 100)), "bias": rng.normal(size=(4, 100, 3))},
        log_likelihood={"answers": rng.normal(size=(4, 100, 5))},
        observed_data={"answers": np.arange(5)},
        constant_data={"trials": np.full(5, 20)},
        prior={"distance": rng.normal(size=(1, 50))},
        posterior_predictive={"answers": rng.normal(size=(4, 100, 5))},
        coords={"standard": ["low", "middle", "high"]},
        dims={"bias": ["standard"], "answers": ["cell"], "trials": ["cell"]},
        attrs={"method": "emcee", "k": 0.1},
        **more,
    )


GROUPS = (
    "posterior",
    "log_likelihood",
    "prior",
    "posterior_predictive",
    "observed_data",
    "constant_data",
)


def test_the_container_is_arvizs_own(arviz: Any) -> None:
    data = example()
    kind = "InferenceData" if arviz.__version__.startswith("0.") else "DataTree"
    assert type(data).__name__ == kind
    for group in GROUPS:
        assert group in data
    assert data["posterior"]["bias"].dims == ("chain", "draw", "standard")
    assert data["observed_data"]["answers"].dims == ("cell",)
    assert data["posterior"].attrs["method"] == "emcee"


def test_summary_works(arviz: Any) -> None:
    table = arviz.summary(example(), var_names=["distance", "bias"])
    assert len(table) == 4
    spread = float(np.std(example()["posterior"]["distance"], ddof=1))
    assert float(table["sd"].astype(float).iloc[0]) == pytest.approx(spread, rel=0.1)


def test_netcdf_round_trip(arviz: Any, tmp_path: Path) -> None:
    data, path = example(), tmp_path / "posterior.nc"
    data.to_netcdf(str(path))
    back = arviz.from_netcdf(str(path))
    for group in GROUPS:
        for name, values in data[group].data_vars.items():
            np.testing.assert_array_equal(back[group][name], values)
    assert back["posterior"].attrs["k"] == 0.1
    if hasattr(back, "close"):
        back.close()


@pytest.mark.parametrize(
    ("posterior", "words"),
    [
        ({}, "posterior holds no variable"),
        ({"r": np.zeros(10)}, "must have shape"),
        ({"r": np.zeros((4, 10)), "k": np.zeros((4, 9))}, "'k' must have shape"),
    ],
)
def test_misshapen_draws_are_refused(posterior: dict[str, Array], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        to_arviz(posterior)
