"""Checks see what is wrong with a fit, and nothing where nothing is."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from scipy import stats
from short_forms import slow_but

from weberwhisk.behaviour import (
    Trials,
    WeberFit,
    checks,
    fit_weber,
    quantile_residuals,
    residuals_by,
    simulate_trials,
)
from weberwhisk.behaviour.criticism import SEEN_BY
from weberwhisk.behaviour.directions import LOOKED_FOR, directions
from weberwhisk.behaviour.effects import Drift

DESIGN = {"weber_fraction": 0.15, "standards": [1.0, 2.0], "sessions": 6, "trials_per_level": 40}


def sound(seed: int = 1, **options: object) -> WeberFit:
    return fit_weber(simulate_trials(**DESIGN | options, seed=seed))  # type: ignore[arg-type]


def test_residuals_by_session_are_counts_over_counts() -> None:
    fit = sound(missing=0.1)
    table = residuals_by(fit, "session")
    frame = fit.trials.frame.dropna(subset="count")
    by_session = frame.groupby("session")["count"]
    np.testing.assert_allclose(table["observed"], by_session.mean())
    assert table["n"].tolist() == by_session.count().tolist()
    # By pair of stimuli it is what the fit itself says.
    pairs = residuals_by(fit, "standard", "stimulus_1", "stimulus_2")
    pd.testing.assert_frame_equal(pairs, fit.residuals(), check_dtype=False)
    total = (table["n"] * table["expected"]).sum()
    assert total == pytest.approx((pairs["n"] * pairs["expected"]).sum())


def test_an_effect_that_goes_with_sessions_is_expected_there() -> None:
    trials = simulate_trials(**DESIGN | {"offsets": [0.1, 0.2]}, drift=-2.5, seed=2)  # type: ignore[arg-type]
    stationary = fit_weber(trials, priors={"bias": 0.0, "lapse_high": 0.0})
    drifting = fit_weber(trials, priors={"bias": 0.0, "lapse_high": 0.0}, effects=[Drift()])
    expected = residuals_by(drifting, "session")["expected"].to_numpy()
    assert np.all(np.diff(expected) > 0)
    # Without the drift sessions differ only in which trials fell to them.
    assert np.ptp(residuals_by(stationary, "session")["expected"]) < 0.2 * np.ptp(expected)
    assert checks(stationary).loc["sessions", "p"] < 0.01
    assert checks(drifting).loc["sessions", "p"] > 0.05


def test_quantile_residuals_are_standard_normal_under_the_model() -> None:
    tables = [quantile_residuals(sound(seed), seed=seed) for seed in range(10, 13)]
    z = np.concatenate([t["z"] for t in tables])
    assert z.size > 300
    assert stats.kstest(z, "norm").pvalue > 0.001
    assert z.std() == pytest.approx(1.0, abs=4 / np.sqrt(2 * z.size))
    again = quantile_residuals(sound(10), seed=10)
    pd.testing.assert_frame_equal(tables[0], again)


def test_quantile_residuals_of_a_wrong_model_are_not() -> None:
    trials = simulate_trials(**DESIGN, seed=3)  # type: ignore[arg-type]
    wrong = fit_weber(
        trials, priors={"weber_fraction": 0.05, "lapse_low": 0.01, "lapse_high": 0.01}
    )
    z = quantile_residuals(wrong, seed=0)["z"]
    assert stats.kstest(z, "norm").pvalue < 1e-6


def test_nothing_is_wrong_with_a_sound_observer() -> None:
    p = pd.DataFrame([checks(sound(seed), seed=seed)["p"] for seed in range(20, 26)])
    assert (p.pop("streaks") > 0.01).all()  # a bound on the probability, not uniform
    # Thirty-six uniform numbers: more than two below 0.01 come six times in a thousand.
    assert (p.to_numpy() < 0.01).sum() <= 2
    p = p.to_numpy()
    assert 0.35 < p.mean() < 0.65


def broken(trouble: str) -> WeberFit:
    rng = np.random.default_rng(5)
    trials = simulate_trials(**DESIGN, seed=4)  # type: ignore[arg-type]
    frame = trials.frame.copy()
    answer = frame["count"].to_numpy(copy=True)
    if trouble == "levels":  # one comparison is felt as its opposite
        odd = frame["stimulus_2"].between(1.1, 1.2)
        answer[odd] = 1 - answer[odd]
    elif trouble == "sessions":  # guessing in two of six
        lost = frame["session"].isin([2, 5])
        answer[lost] = (rng.random(lost.sum()) < 0.85).astype(float)
    elif trouble == "trend":  # a bias that moves all the time
        late = np.arange(answer.size) > answer.size // 2
        answer[late & (rng.random(answer.size) < 0.4)] = 1.0
    elif trouble == "repetition":  # a third of the answers repeat the last
        for i in range(1, answer.size):
            if rng.random() < 0.33:
                answer[i] = answer[i - 1]
    else:  # every pair in every session has a probability of its own
        for _, part in frame.groupby(["session", "stimulus_1", "stimulus_2"]):
            if rng.random() < 0.4:
                answer[part.index] = float(rng.random() < answer[part.index].mean())
    return fit_weber(Trials(frame.assign(count=answer), trials.task))


@pytest.mark.parametrize(
    "trouble", slow_but(["levels", "overdispersion", "sessions", "trend", "repetition"], (0, 4))
)
def test_each_trouble_is_seen_by_its_check(trouble: str) -> None:
    table = checks(broken(trouble))
    assert table.loc[trouble, "p"] < 0.01
    off = abs(table.loc[trouble, "observed"]), abs(table.loc[trouble, "expected"])
    assert off[0] > off[1]
    assert table.loc[trouble, "remedy"]


@pytest.mark.slow
def test_the_intraclass_correlation_is_estimated() -> None:
    rho, cells, n = 0.1, 150, 40
    rng = np.random.default_rng(6)
    p = rng.beta(0.5 * (1 - rho) / rho, 0.5 * (1 - rho) / rho, cells)
    frame = pd.DataFrame(
        {
            "session": np.arange(cells), "standard": 1.0, "stimulus_1": 1.0,
            "stimulus_2": np.where(np.arange(cells) % 2, 1.0001, 0.9999), "n": n,
            "count": rng.binomial(n, p).astype(float),
        }
    )  # fmt: skip
    trials = simulate_trials(seed=1)
    fit = fit_weber(Trials(frame, trials.task))
    found = checks(fit)
    assert found.loc["overdispersion", "observed"] == pytest.approx(rho, abs=0.02)
    assert abs(found.loc["overdispersion", "expected"]) < 0.005
    assert found.loc["overdispersion", "p"] == 0.0
    assert "trend" not in found.index  # counts have no order of trials


def test_misuse_and_emptiness() -> None:
    fit = sound()
    with pytest.raises(ValueError, match="did you mean 'session'"):
        residuals_by(fit, "sesion")
    single = fit_weber(simulate_trials(seed=1))
    assert "sessions" not in checks(single).index


def test_what_is_looked_for_has_a_status_and_one_weight_for_each_pair_in_a_session() -> None:
    """Answers to one pair in a session are checked as one count: an effect that differs between
    them would be seen by the weight of the first alone."""
    assert {e.name for e in LOOKED_FOR} <= {name for names in SEEN_BY.values() for name in names}
    trials = simulate_trials(
        standards=[1, 2], sessions=3, trials_per_level=12, order="random", seed=2
    )
    found = directions(fit_weber(trials))
    assert {*found} == {e.name for e in LOOKED_FOR}
    pairs = trials.frame[["session", "stimulus_1", "stimulus_2", "standard"]]
    for weight in found.values():
        by_pair = pairs.assign(weight=weight).groupby([*pairs]).weight
        assert np.ptp(weight) > 0
        np.testing.assert_allclose(by_pair.transform("min"), by_pair.transform("max"), atol=1e-12)
