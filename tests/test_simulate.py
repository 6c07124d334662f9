"""Simulated trials are repeatable, balanced, and refused where they make no sense."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import pytest

from weberwhisk.behaviour import LogPercept, simulate_trials


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


def test_seeds_of_every_kind() -> None:
    tables = [
        simulate_trials(seed=seed).frame
        for seed in (5, np.random.SeedSequence(5), np.random.default_rng(5))
    ]
    assert all(tables[0].equals(t) for t in tables)


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


def test_counts_follow_the_parameters() -> None:
    trials = simulate_trials(
        offsets=[-0.9, 0.0, 9.0], weber_fraction=0.01, lapse_low=0.1, lapse_high=0.3, bias=0.5,
        trials_per_level=20_000, seed=2,
    )  # fmt: skip
    share = trials.cells().count / trials.cells().n
    np.testing.assert_allclose(share, [0.1, 0.1 + 0.6 * 0.69146, 0.7], atol=0.012)


def test_missing_answers() -> None:
    trials = simulate_trials(missing=0.2, trials_per_level=500, seed=3)
    assert trials.n_missing == pytest.approx(900, abs=110)
    assert trials.frame["count"].isna().sum() == trials.n_missing


def test_a_log_percept_makes_a_log_table() -> None:
    trials = simulate_trials(percept=LogPercept(2.0), standards=[-1.0, 1.0], seed=4)
    assert (trials.scale, trials.log_unit) == ("log", 2.0)
    assert trials.frame["stimulus_2"].min() == pytest.approx(-1.3)


@pytest.mark.parametrize(
    ("options", "part"),
    [
        ({"weber_fraction": -0.1}, "weber_fraction must be above zero, got -0.1"),
        ({"weber_fraction": np.nan}, "weber_fraction must be finite"),
        ({"weber_fraction": "big"}, "weber_fraction must be a number"),
        ({"lapse_low": -0.1}, "lapse_low must not be negative"),
        ({"lapse_low": 0.6, "lapse_high": 0.5}, "must be below 1, got 1.1"),
        ({"missing": 1.0}, "missing must be below 1"),
        ({"trials_per_level": 0}, "trials_per_level must be a whole number"),
        ({"trials_per_level": 2.5}, "trials_per_level must be a whole number"),
        ({"sessions": -1}, "sessions must be a whole number"),
        ({"standards": -1.0}, "outside what can be felt"),
        ({"offsets": [-1.5]}, "outside what can be felt"),
        ({"offsets": [0.1], "comparisons": [1.0]}, "give one of them"),
        ({"comparisons": [[1.0], [2.0]]}, "2 rows for 1 standards"),
        ({"task": "4AFC percnt correct"}, "did you mean '4AFC percent correct'"),
        ({"noise": "white"}, "noise 'white' is unknown"),
        ({"bias": np.inf}, "bias must be finite"),
        ({"percept": LogPercept(), "observer": object()}, "both given"),
    ],
)
def test_nonsense_is_refused_in_one_sentence(options: dict, part: str) -> None:
    with pytest.raises(ValueError, match=part) as caught:
        simulate_trials(**{"seed": 1, **options})
    assert "\n" not in str(caught.value)
