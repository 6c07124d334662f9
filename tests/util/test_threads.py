"""Cores, and one thread for linear algebra."""

from __future__ import annotations

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from weberwhisk._util import campaign
from weberwhisk._util.campaign import all_cores
from weberwhisk.behaviour import IdentityEncoding, fit_population, fit_weber, simulate_population
from weberwhisk.design import Hypothesis, Scheme
from weberwhisk.design.simulation import fit


def test_a_worker_for_each_core(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(campaign.os, "sched_getaffinity", lambda pid: set(range(8)), raising=False)
    assert all_cores(None, None) == 8


def test_the_limit_lasts_until_the_last_thread_leaves_it() -> None:
    """The first to leave must not end it for the others."""

    def most() -> int:
        return max(p["num_threads"] for p in threadpool_info() if p["user_api"] == "blas")

    with threadpool_limits(2, user_api="blas"):
        before, first, second = most(), campaign.limited_blas(), campaign.limited_blas()
        first.__enter__()
        second.__enter__()
        first.__exit__(None, None, None)
        assert most() == 1
        second.__exit__(None, None, None)
        assert most() == before
        with pytest.raises(ZeroDivisionError), campaign.limited_blas():
            1 / 0  # noqa: B018
        assert most() == before


def test_fits_and_designs_keep_blas_to_one_thread() -> None:
    """Six animals took eight times as long where BLAS had two threads on a busy machine."""
    seen = []

    class Watched(IdentityEncoding):
        def mean(self, stimulus: np.ndarray) -> np.ndarray:
            blas = [p for p in threadpool_info() if p["user_api"] == "blas"]
            seen.append(max(p["num_threads"] for p in blas))
            return super().mean(stimulus)

    trials, _ = simulate_population(2, trials_per_level=2, seed=1)
    scheme, watched = Scheme([1.0], [-0.2, 0.2], 4), Hypothesis("a", Watched())
    with threadpool_limits(2, user_api="blas"):
        for work in (
            lambda: fit_weber(trials.select(subject="s1"), encoding=Watched()),
            lambda: fit_population(trials, encoding=Watched()),
            lambda: fit(watched, scheme, np.ones((1, 1, 2))),
        ):
            seen.clear()
            work()
            assert set(seen) == {1}
        assert max(p["num_threads"] for p in threadpool_info() if p["user_api"] == "blas") == 2
