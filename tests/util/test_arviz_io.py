"""Conversion to ArviZ, and diagnostics to ArviZ's own digits."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from weberwhisk._util.sampling import mcse, rhat, to_arviz

Array = NDArray[np.float64]


# -- diagnostics -------------------------------------------------------------------------------


def test_diagnostics_are_arvizs_own_of_each_posterior(arviz: Any) -> None:
    x = np.random.default_rng(1).normal(size=(2, 3, 4, 100)).cumsum(axis=-1)
    for ours, theirs in (
        (rhat(x), [arviz.rhat(chains) for chains in x.reshape(-1, 4, 100)]),
        (mcse(x), [arviz.mcse(chains, method="mean") for chains in x.reshape(-1, 4, 100)]),
    ):
        assert ours.shape == (2, 3)
        np.testing.assert_array_equal(
            ours.ravel(), np.concatenate([np.ravel(one) for one in theirs])
        )


def test_diagnostics_that_arviz_gives_as_arrays_of_one(
    arviz: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As ArviZ 0.23 gives the error of a mean where Numba is installed; NumPy from 2.4 on makes no
    number of one."""
    x = np.random.default_rng(1).normal(size=(2, 4, 100))
    before, theirs = mcse(x), arviz.mcse
    monkeypatch.setattr(arviz, "mcse", lambda x, **options: np.atleast_1d(theirs(x, **options)))
    np.testing.assert_array_equal(mcse(x), before)


def test_the_error_of_a_known_process() -> None:
    # For memory 0.8 the variance is 1/(1 - 0.64), the integrated time 1.8/0.2.
    x = np.random.default_rng(2).normal(size=(20, 4, 4000))
    for t in range(1, 4000):
        x[..., t] += 0.8 * x[..., t - 1]
    error = np.sqrt(9 / 0.36 / 16_000)
    assert mcse(x).mean() == pytest.approx(error, rel=0.05)
    assert np.all(mcse(x + np.arange(4)[:, None]) > 3 * error)  # chains that disagree widen it


def test_rhat_sees_place_and_spread() -> None:
    x = np.random.default_rng(2).normal(size=(20, 4, 500))
    assert np.all(rhat(x) < 1.02)
    one = np.array([0.0, 0.0, 0.0, 1.0])[:, None]
    assert np.all(rhat(x + one) > 1.05)
    assert np.all(rhat(x * (1 + one)) > 1.03)


def test_diagnostics_of_draws_that_do_not_differ_or_are_no_numbers_are_nan() -> None:
    x = np.random.default_rng(3).normal(size=(3, 4, 20))
    x[1, 0, 3] = np.nan
    x[2] = 1.0
    assert np.isnan(rhat(x)).tolist() == [False, True, True]
    assert not np.isfinite(mcse(x)[1])


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
