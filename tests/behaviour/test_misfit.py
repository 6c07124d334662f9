"""The status of a fit whose model does not hold, or that depends on beliefs, and its advice."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest
from short_forms import slow_but

from weberwhisk._util.refusals import argument, call
from weberwhisk.behaviour import (
    FitStatus,
    PopulationStatus,
    States,
    Trials,
    WeberFit,
    effects,
    fit_population,
    fit_weber,
    simulate_population,
    simulate_trials,
)
from weberwhisk.commands import as_options
from weberwhisk.plots import engagement

FOUR = [-0.3, -0.1, 0.1, 0.3]


def animal(trouble: str) -> Trials:
    """An animal that the default observer does not describe."""
    more: dict[str, Any] = {
        "MISFIT_STREAKS": {"states": States(engaged=0.5), "sessions": 3, "trials_per_level": 40},
        "MISFIT_CURVE": {"standards": [1.0, 2.0], "bias": [1.2, -1.2], "trials_per_level": 50},
        "MISFIT_DRIFT": {"sessions": 6, "bias_drift": 1.5, "trials_per_level": 60},
        "PRIOR_DEPENDENT": {"offsets": [-0.12, 0.12], "trials_per_level": 300},
    }.get(trouble, {"trials_per_level": 60})
    trials = simulate_trials(**{"seed": 5} | more)
    if trouble == "MISFIT_HISTORY":  # every third answer is the one before
        frame = trials.frame.copy()
        count = frame["count"].to_numpy(copy=True)
        count[1::3] = count[: count[1::3].size * 3 : 3]
        return Trials(frame.assign(count=count), trials.task)
    return trials


def advised(fit: WeberFit) -> list[str]:
    """The fits that a report advises, as they stand there."""
    return re.findall(r"fit_weber\((?:[^()]|\([^()]*\))*\)", fit.report())


@pytest.mark.parametrize(
    "trouble", slow_but(["MISFIT_STREAKS", "MISFIT_CURVE", "MISFIT_HISTORY"], (0,))
)
def test_what_does_not_hold_is_the_status_and_the_advised_fit_is_better(trouble: str) -> None:
    trials = animal(trouble)
    fit = fit_weber(trials)
    assert fit.status is FitStatus[trouble]
    assert fit.report().split("What they cannot say")[0].count("does not hold") == 1
    lines = advised(fit)
    assert lines
    known = {**vars(effects), "fit_weber": fit_weber, "trials": trials}
    better = max(eval(line, known).log_evidence for line in lines)
    assert better > fit.log_evidence + 3
    assert "fit_weber" not in as_options(fit.report())


def test_a_belief_about_lapses_that_decides_is_the_status() -> None:
    fit = fit_weber(animal("PRIOR_DEPENDENT"))
    assert fit.status is FitStatus.PRIOR_DEPENDENT
    assert "lapse_low" in fit.report().split("What to collect next")[1]


def test_options_of_a_fit_stay_in_what_is_advised() -> None:
    fit = fit_weber(animal("MISFIT_STREAKS"), bias="none", noise="equal-variance")
    assert "fit_weber(trials, bias='none', noise='equal-variance', states=3)" in fit.report()
    assert "--bias none --noise equal-variance --states 3" in as_options(fit.report())


@pytest.mark.parametrize(
    "more", [[], pytest.param([effects.Contraction()], marks=pytest.mark.slow)]
)
def test_effects_with_arguments_are_advised_as_they_are_typed(more: list[effects.Effect]) -> None:
    trials = animal("MISFIT_STREAKS")
    trials = Trials(trials.frame.assign(laser=np.arange(len(trials.frame)) % 2), trials.task)
    fit = fit_weber(trials, effects=[effects.Covariate("laser"), *more])
    line = advised(fit)[0]
    also = ", Contraction()" if more else ""
    assert f"effects=[Covariate('laser'){also}], states=3" in line
    again = eval(line, {**vars(effects), "fit_weber": fit_weber, "trials": trials})
    assert again.effects == ("laser", *("contraction" for _ in more))
    also = " --effect contraction" if more else ""
    assert f"--effect covariate:laser{also} --states 3" in as_options(fit.report())
    two = [effects.Covariate("a b", on="weber_fraction"), effects.Contraction()]
    said = as_options(call("fit_weber", "trials", argument("effects", two)))
    assert as_options(argument("effects", two)) == said
    assert said == "--effect 'covariate:a b:weber_fraction' --effect contraction"


def test_only_a_fit_with_states_has_a_course_of_engagement() -> None:
    fit = fit_weber(simulate_trials(trials_per_level=10, seed=1))
    with pytest.raises(ValueError, match=r"fit must be one with states.*write states=3"):
        engagement(fit)  # type: ignore[arg-type]


def test_a_population_of_misfits_says_so() -> None:
    sound, _ = simulate_population(4, trials_per_level=20, seed=2)
    assert fit_population(sound).status is not PopulationStatus.MISFIT
    frame = sound.frame.copy()
    for subject in ("s1", "s2", "s3"):  # half of each session on one side
        rows = np.flatnonzero(frame["subject"] == subject)
        frame.loc[frame.index[rows[: rows.size // 2]], "count"] = 1
    fit = fit_population(Trials(frame, sound.task))
    assert fit.status is PopulationStatus.MISFIT
    assert "s2 (MISFIT_STREAKS)" in fit.report()
    assert fit.report().startswith("The animals together answer as no observers of this model do.")
