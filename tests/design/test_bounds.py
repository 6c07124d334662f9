"""What no number of trials can reach is refused at once, and what is refused cannot be reached."""

from __future__ import annotations

import io
import sys
import time
from typing import Any

import numpy as np
import pytest
from short_forms import slow_but

import weberwhisk as ww
from weberwhisk.commands import plans as commands
from weberwhisk.design import (
    Evidence,
    Goal,
    Precision,
    Scheme,
    SubjectPopulation,
    plan_experiment,
    power,
    taper,
)
from weberwhisk.design.bounds import fewest_animals, least_half_widths

PAIR = taper(ww.Whisker.from_identity("C2"))
PLACES = [10e-3, 20e-3, 30e-3]


@pytest.mark.parametrize(
    ("options", "remedy"),
    [
        (
            {"goal": Precision(half_width=0.2), "animals": 4},
            r"write animals=\d+ or more, or half_width=",
        ),
        ({"goal": Precision(half_width=0.02)}, r"k to ±2 %, which takes 28\d\d trials a compar"),
        ({"standards": [5e-3, 6e-3]}, "tapered discriminated from cylindrical, which takes"),
    ],
)
def test_a_design_that_cannot_work_says_so_in_three_seconds(
    options: dict[str, Any], remedy: str
) -> None:
    start = time.process_time()
    with pytest.raises(ValueError, match=remedy):
        plan_experiment("C2", **options)
    assert time.process_time() - start < 3


def test_more_trials_do_not_pass_the_bound_of_the_animals() -> None:
    """Fits of 200 trials a comparison are no narrower than populations whose k are known."""
    expected = SubjectPopulation()
    scheme = Scheme.spaced(PAIR[0].encoding, PLACES, trials=200, animals=4)
    fitted = power(scheme, PAIR[:1], runs=48, seed=1).table.iloc[0]
    known = least_half_widths(PAIR[0], expected, 4)
    assert 0.95 * np.median(known) < fitted["half_width"] < 1.3 * np.median(known)
    assert fitted["power"] < 0.2


def test_the_remedies_of_the_bound_pass_it() -> None:
    goal, expected = Precision(half_width=0.2), SubjectPopulation()
    fewest = fewest_animals(PAIR[0], expected, goal.half_width, share=goal.share)
    assert fewest is not None
    share = [(least_half_widths(PAIR[0], expected, n) < 0.2).mean() for n in (fewest - 1, fewest)]
    assert share[0] < goal.share <= share[1]
    assert fewest_animals(PAIR[0], SubjectPopulation(spread=3.0), 0.2, share=0.8) is None


@pytest.mark.slow
@pytest.mark.parametrize(
    ("hypotheses", "goal"), slow_but([(PAIR[:1], Precision(0.2)), (PAIR, Evidence(10))], (1,))
)
def test_the_information_of_trials_is_no_more_than_simulation_finds(
    hypotheses: Any, goal: Goal
) -> None:
    """With as many trials as it demands less than the goal's share reaches the goal."""
    scheme = Scheme.spaced(PAIR[0].encoding, PLACES)
    needed, _ = goal.trials_needed(scheme, hypotheses, SubjectPopulation())
    few, many = max(int(needed), 1), 4 * int(np.ceil(needed))
    found = power(scheme, hypotheses, goal=goal, trials=[few, many], runs=256, seed=1)
    least = found.table.groupby("trials")[["upper", "lower"]].min()
    assert least["upper"][few] < goal.share + 0.05
    assert least["lower"][many] > least["upper"][few]


class Terminal(io.StringIO):
    """Standard error, or input, as a terminal has it."""

    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize("progress", slow_but([None, lambda done: None], (0,)))
def test_the_search_shows_the_time_left_on_a_terminal(
    monkeypatch: pytest.MonkeyPatch, progress: Any
) -> None:
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr(sys, "stderr", shown := Terminal())
    plan_experiment(
        magnitude="duration", standards=[300, 600], goal=Precision(0.3), people=1, runs=8,
        progress=progress, seed=1,
    )  # fmt: skip
    if progress is None:
        assert "Smallest design" in shown.getvalue()
        assert "-:--:--" in shown.getvalue() or "0:00:" in shown.getvalue()
    else:
        assert shown.getvalue() == ""


def test_the_question_decides_hypotheses_and_goal() -> None:
    plans = {
        question: plan_experiment("C2", question=question, trials=4, runs=0)
        for question in ("whiskers", "weber-law", "precision")
    }
    named = {question: [h.name for h in plan.hypotheses] for question, plan in plans.items()}
    assert named == {
        "whiskers": ["tapered", "cylindrical"],
        "weber-law": ["Weber noise", "constant noise"],
        "precision": ["expected observer"],
    }
    assert plans["precision"].goal == Precision(half_width=0.2)
    assert plans["weber-law"].goal == Evidence(bayes_factor=10)
    with pytest.raises(ValueError, match=r"'precision' is not answered by a Bayes factor above 3"):
        plan_experiment("C2", question="precision", goal=Evidence(bayes_factor=3))
    with pytest.raises(ValueError, match="Hypotheses have their question"):
        plan_experiment("C2", question="whiskers", hypotheses=PAIR)


def test_a_terminal_is_asked_for_the_question(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdin", io.StringIO())
    assert commands._question_asked() is None
    monkeypatch.setattr(sys, "stdin", Terminal("2\n"))
    monkeypatch.setattr(sys, "stderr", shown := Terminal())
    monkeypatch.setattr("typer.prompt", lambda *words, **options: "2")
    assert commands._question_asked() == "weber-law"
    assert "--question precision" in shown.getvalue()
    monkeypatch.setattr("typer.prompt", lambda *words, **options: "4")
    with pytest.raises(ValueError, match="the answer"):
        commands._question_asked()
