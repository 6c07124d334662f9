"""A verdict is about the data: no seed of a fit changes its status."""

from __future__ import annotations

import numpy as np
import pytest

from weberwhisk import Trials, fit_weber, simulate_trials
from weberwhisk.behaviour import checks
from weberwhisk.behaviour.effects import Contraction, Drift
from weberwhisk.behaviour.predictive import Tally, is_near, threshold


def near_table(seed: int) -> Trials:
    """Answers of an animal that may or may not pass for one of the model."""
    return simulate_trials(
        standards=[1, 2], trials_per_level=12, lapse_low=0.02, lapse_high=0.05, bias=0.3, seed=seed
    )


def statuses(trials: Trials, seeds: range, **options: object) -> set[str]:
    return {fit_weber(trials, seed=seed, **options).status.name for seed in seeds}  # type: ignore[arg-type]


@pytest.mark.slow
def test_no_seed_changes_a_status_near_a_threshold() -> None:
    """Its p for levels was a share of 250 draws: nine seeds passed, and seven did not."""
    trials = simulate_trials(standards=[1, 2], lapse_low=0.02, lapse_high=0.05, bias=0.3, seed=15)
    assert len(statuses(trials, range(2))) == 1
    table = checks(fit_weber(trials))
    assert table.loc["levels", "p"] == pytest.approx(0.021, abs=0.02)
    assert table.loc["trend", "replicates"] == 250


def test_a_check_near_its_threshold_is_noted() -> None:
    fit = fit_weber(near_table(281))
    assert is_near(fit.checked.loc["repetition", "p"], threshold(fit.checked))
    assert fit.checked.loc["repetition", "replicates"] == 8000
    assert sum("is near its threshold" in note for note in fit.notes) == 1


@pytest.mark.parametrize("effects", [[Drift()], [Contraction()]])
def test_estimates_by_importance_sampling_do_not_depend_on_the_seed(effects: list) -> None:
    trials = simulate_trials(standards=[1, 2], sessions=2, trials_per_level=10, seed=3)
    one, two = (fit_weber(trials, effects=effects, seed=seed) for seed in (1, 2))
    assert one.log_evidence == two.log_evidence
    assert one.interval() == two.interval()
    draws = (f.posterior.draws().weber_fraction for f in (one, two))
    assert not np.array_equal(*draws)


@pytest.mark.slow
def test_no_seed_changes_the_status_of_twenty_tables_near_a_verdict() -> None:
    near = []
    for trials in map(near_table, range(2000)):
        table = fit_weber(trials).checked
        if any(is_near(p, threshold(table)) for p in table["p"]):
            near.append(trials)
        if len(near) == 20:
            break
    assert len(near) == 20
    for i, trials in enumerate(near):
        options = {"effects": [Contraction()]} if i % 4 == 3 else {}
        assert len(statuses(trials, range(16), **options)) == 1


def test_replicates_are_drawn_until_p_is_on_one_side() -> None:
    at = 0.01
    assert Tally(250, 2).is_beside(at)
    assert not Tally(250, 25).is_beside(at)
    assert Tally(250, 0).is_beside(at)
    assert not Tally(2000, 0).is_beside(at)
    # With all 8000 nothing is left beside that is not near.
    for p in (at / 1.5, at * 1.5):
        assert not Tally(8000, round(8000 * p)).is_beside(at)
