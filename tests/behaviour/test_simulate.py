"""Simulated trials are repeatable, balanced, and refused where they make no sense."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.special import ndtr

from weberwhisk.behaviour import (
    LogEncoding,
    effects,
    fit_weber,
    simulate_population,
    simulate_trials,
)
from weberwhisk.behaviour.encodings import IdentityEncoding
from weberwhisk.behaviour.simulate import simulate_responses


def digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()[:16]


def test_the_same_seed_gives_the_same_bytes_everywhere(tmp_path: Path) -> None:
    def make(name: str, seed: int) -> str:
        trials = simulate_trials(
            weber_fraction=0.12, standards=[1.0, 3.0], trials_per_level=10, lapse_low=0.03,
            lapse_high=0.01, bias=[0.1, -0.1], sessions=2, subject="r1", missing=0.02, seed=seed,
        )  # fmt: skip
        return digest(trials.to_csv(tmp_path / name))

    assert make("a", 11) == make("b", 11) != make("c", 12)
    # Written down once: other versions of Python and NumPy must give it too.
    assert make("d", 11) == "e06f7670ff54ea5d"


def test_the_design_is_balanced() -> None:
    trials = simulate_trials(
        standards=[1.0, 2.0], comparisons=[[0.8, 1.2], [1.6, 2.4]], trials_per_level=30,
        sessions=4, seed=1,
    )  # fmt: skip
    assert trials.cells().n.tolist() == [30.0] * 4
    assert trials.cells().stimulus_2.tolist() == [0.8, 1.2, 1.6, 2.4]
    assert trials.frame.groupby("session").size().tolist() == [30] * 4
    assert trials.frame.groupby("session")["trial"].max().tolist() == [30] * 4
    # Shuffled: no session has only one standard.
    assert (trials.frame.groupby("session")["standard"].nunique() == 2).all()


def test_missing_answers() -> None:
    trials = simulate_trials(missing=0.2, trials_per_level=500, seed=3)
    assert trials.n_missing == pytest.approx(900, abs=110)
    assert trials.frame["count"].isna().sum() == trials.n_missing


def test_same_and_different_are_both_said_by_default() -> None:
    """With a criterion of 0 every pair is called different, which says nothing of k."""
    one = simulate_trials(task="same-different", trials_per_level=200, seed=5)
    equal = one.frame.loc[one.frame["stimulus_1"] == one.frame["stimulus_2"], "count"]
    assert equal.mean() == pytest.approx(2 * ndtr(-1.6), abs=0.07)
    assert fit_weber(one).interval(0.99)[0] < 0.1 < fit_weber(one).interval(0.99)[1]
    several, truth = simulate_population(4, task="same-different", trials_per_level=5, seed=5)
    assert truth["bias"].between(0.8, 2.4).all()
    _, low = simulate_population(6, task="same-different", bias=0.1, trials_per_level=2, seed=1)
    assert low["bias"].min() == 0  # one was drawn below it, and refused as if the user gave it
    assert 0.1 < several.frame["count"].mean() < 0.9
    with pytest.raises(ValueError, match=r"criterion of a same-different task.*write for ex"):
        simulate_trials(task="same-different", bias=-1.0, seed=1)


@pytest.mark.parametrize(
    ("options", "part"),
    [
        ({"weber_fraction": -0.1}, "weber_fraction must be above zero, got -0.1"),
        ({"weber_fraction": np.nan}, "weber_fraction must be finite"),
        ({"weber_fraction": "big"}, "weber_fraction must be a number"),
        ({"lapse_low": -0.1}, "lapse_low must lie between 0 and 1, got -0.1"),
        ({"lapse_low": 0.6, "lapse_high": 0.5}, "must be below 1, got 1.1"),
        ({"missing": 1.0}, "missing must lie between 0 and 1, got 1"),
        ({"trials_per_level": 0}, "trials_per_level must be a whole number"),
        ({"trials_per_level": 2.5}, "trials_per_level must be a whole number"),
        ({"sessions": -1}, "sessions must be a whole number"),
        ({"standards": -1.0}, "outside what can be encoded"),
        ({"offsets": [-1.5]}, "outside what can be encoded"),
        ({"offsets": [0.1], "comparisons": [1.0]}, "give one of them"),
        ({"comparisons": [[1.0], [2.0]]}, r"shape \(2, 1\) for 1 standards"),
        ({"task": "4AFC percnt correct"}, "did you mean '4AFC percent correct'"),
        ({"noise": "white"}, "noise 'white' is unknown"),
        ({"bias": np.inf}, "bias must be finite"),
        ({"encoding": LogEncoding(), "observer": object()}, "both given"),
        ({"drift": -0.5}, "drift goes from the first session to the last, got sessions=1"),
        ({"bias_drift": np.nan, "sessions": 3}, "bias_drift must be finite"),
        ({"weber_fraction": [0.1, 0.2], "sessions": 3}, r"shape \(2,\) for 3 sessions"),
    ],
)
def test_nonsense_is_refused_in_one_sentence(options: dict, part: str) -> None:
    with pytest.raises(ValueError, match=part) as caught:
        simulate_trials(**{"seed": 1, **options})
    assert "\n" not in str(caught.value)


# -- drift, and many animals ----------------------------------------------------------------------


def test_a_drift_is_that_of_the_sessions() -> None:
    trials = simulate_trials(
        weber_fraction=0.2, drift=np.log(0.25), bias_drift=1.0, bias=0.5, offsets=[-0.1, 0.1],
        sessions=3, trials_per_level=60_000, seed=5,
    )  # fmt: skip
    share = trials.frame.groupby(["session", "stimulus_2"])["count"].mean().unstack()
    # By hand: k = 0.4, 0.2, 0.1 and bias 0, 0.5, 1 in Φ((x − 1)/(k √(1 + x²)) + bias).
    np.testing.assert_allclose(
        share.to_numpy(),
        [[0.42629, 0.56677], [0.55107, 0.79852], [0.60130, 0.95280]],
        atol=4 * 0.5 / np.sqrt(20_000),
    )


def test_the_animals_of_a_population_are_what_the_truth_says() -> None:
    trials, truth = simulate_population(
        3,
        spread=0.5,
        lapse_high=0.0,
        bias=0.4,
        trials_per_level=20_000,
        offsets=[0.0, 40.0],
        seed=7,
    )
    share = trials.frame.groupby(["subject", "stimulus_2"])["count"].mean().unstack().to_numpy()
    assert (truth["lapse_high"] == 0).all()
    # Far above the standard the signal's own noise is all there is: Φ(40/√(41² + 1)/k + bias).
    easy = np.array(
        [
            norm_cdf(40 / np.hypot(41, 1) / k + b)
            for k, b in zip(truth["weber_fraction"], truth["bias"], strict=True)
        ]
    )
    low = truth["lapse_low"].to_numpy()
    even = low + (1 - low) * np.array([norm_cdf(b) for b in truth["bias"]])
    np.testing.assert_allclose(share, np.column_stack([even, low + (1 - low) * easy]), atol=0.012)


def norm_cdf(x: float) -> float:
    from math import erf, sqrt

    return 0.5 * (1 + erf(x / sqrt(2)))


def test_a_population_has_the_spread_asked_for() -> None:
    n = 200
    _, truth = simulate_population(
        n, weber_fraction=0.2, spread=0.4, lapse_low=0.05, trials_per_level=1, offsets=[0.1],
        seed=8,
    )  # fmt: skip
    logs = np.log(truth["weber_fraction"])
    assert np.mean(logs) == pytest.approx(np.log(0.2), abs=4 * 0.4 / np.sqrt(n))
    assert np.std(logs) == pytest.approx(0.4, rel=4 / np.sqrt(2 * n))
    assert np.mean(truth["lapse_low"]) == pytest.approx(0.05, abs=4 * 0.033 / np.sqrt(n))


@pytest.mark.parametrize(
    ("options", "part"),
    [
        ({"subjects": 0}, "subjects must be a whole number of 1 or more, got 0"),
        ({"spread": -1.0}, "spread must not be negative"),
        ({"lapse_low": 0.6}, "lapse_low must lie between 0 and 0.5, got 0.6"),
    ],
)
def test_impossible_populations_are_refused(options: dict, part: str) -> None:
    with pytest.raises(ValueError, match=part):
        simulate_population(**{"subjects": 2, "seed": 1, **options})


# -- effects -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("given", "match"),
    [
        ([effects.History()], "pairs of an effect and its value"),
        ([("history", 0.5)], r"write History\(\)"),
        ([(effects.History(), "much")], "the value of history must be a number"),
        ([(effects.Overdispersion(), 1.5)], "overdispersion must lie between 0 and 1"),
    ],
)
def test_effects_without_a_value_are_refused(given: list[object], match: str) -> None:
    with pytest.raises(ValueError, match=match):
        simulate_trials(effects=given, seed=1)  # type: ignore[arg-type]


def test_random_order_puts_the_comparison_first_in_half_of_the_trials() -> None:
    trials = simulate_trials(
        standards=[1.0, 2.0], trials_per_level=10, order="random", sessions=2, seed=4
    )
    frame = trials.frame
    offset = (frame["stimulus_1"] + frame["stimulus_2"]) / frame["standard"] - 2
    swapped = frame["stimulus_1"] != frame["standard"]
    away = offset.abs() > 1e-9
    counts = frame[away].groupby(["standard", offset[away].round(6)]).size()
    assert (counts == 10).all()
    assert swapped[away].mean() == 0.5
    assert 0.2 < swapped[away & (frame["session"] == 1)].mean() < 0.8
    plain = simulate_trials(standards=[1.0, 2.0], trials_per_level=10, sessions=2, seed=4).frame
    assert (plain["stimulus_1"] == plain["standard"]).all()
    assert (plain["standard"] == frame["standard"]).all()


def test_easy_trials_of_a_scattered_observer_are_answered_right() -> None:
    """At a probability of 1 no beta distribution is left: all such answers were the wrong one."""
    scattered = [(effects.Overdispersion(), 0.05)]
    trials = simulate_trials(weber_fraction=0.02, trials_per_level=20, effects=scattered, seed=1)
    cells = trials.cells()
    assert (cells.count / cells.n)[[0, -1]].tolist() == [0.0, 1.0]


def test_a_truth_that_is_not_whole_is_refused() -> None:
    table = pd.DataFrame({"subject": ["a"], "standard": 1.0, "stimulus_1": 1.0, "stimulus_2": 2.0})
    animals = pd.DataFrame(
        {"subject": ["a"], "weber_fraction": 0.1, "lapse_low": np.nan, "lapse_high": 0, "bias": 0}
    )
    with pytest.raises(ValueError, match="The truth about a is not given"):
        simulate_responses(table, animals, encoding=IdentityEncoding(), seed=1)
