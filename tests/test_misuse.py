"""What was not meant is refused in one sentence: what is wrong, the value got, the remedy."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy import stats

import weberwhisk as ww
from weberwhisk import Observer, Whisker, cues, press
from weberwhisk.behaviour import (
    CueEncoding,
    IdentityEncoding,
    PercentCorrect,
    Priors,
    Trials,
    compare,
    fit_population,
    fit_weber,
    read_trials,
    residuals_by,
    response_probability,
    simulate_population,
    simulate_trials,
    task_named,
    threshold,
    weber_law_test,
)
from weberwhisk.behaviour.effects import Floor
from weberwhisk.behaviour.simulate import simulate_responses
from weberwhisk.behaviour.trials import joined
from weberwhisk.receptors import GeneralisedWeber
from weberwhisk.sweeping import follow

TRIALS = simulate_trials(trials_per_level=3, seed=1)
ANIMALS = simulate_population(2, trials_per_level=3, seed=1)[0]
TABLE = TRIALS.table()
FIT = fit_weber(TRIALS)
WHISKER = Whisker(50e-3, 100e-6, 5e-6)
TASK, SELF = task_named("2AFC"), IdentityEncoding()
A_WEBER_FIT = "must be a WeberFit, got .*; write ww.fit_weber"


def simulated(**options: Any) -> Callable[[], object]:
    return lambda: simulate_trials(**{"seed": 1, **options})


def fitted(**options: Any) -> Callable[[], object]:
    return lambda: fit_weber(TRIALS, **options)


def read(**options: Any) -> Callable[[], object]:
    return lambda: read_trials(TABLE, **options)


MISUSES: list[tuple[Callable[[], object], str]] = [
    # Not a table of trials.
    (lambda: fit_weber("file.csv"), r"got 'file.csv'; write ww.read_trials\('file.csv'\)"),  # type: ignore[arg-type]
    (lambda: fit_weber(TABLE), r"of type DataFrame; write ww.read_trials\(table\)"),
    (lambda: fit_population("a.csv"), r"write ww.read_trials\('a.csv'\)"),  # type: ignore[arg-type]
    (lambda: Trials(TABLE, TASK), "no column 'n', 'count'; make it with ww.read_trials"),
    (lambda: Trials(None, TASK), "frame must be a DataFrame, got None"),  # type: ignore[arg-type]
    (lambda: Trials(TRIALS.frame, "2AFC"), r"write ww.behaviour.task_named\('2AFC'\)"),  # type: ignore[arg-type]
    (lambda: Trials(TRIALS.frame, TASK, "ln"), "scale 'ln' is unknown"),
    (lambda: Trials(TRIALS.frame.assign(count=5), TASK), "n = 1 and count = 5"),
    # Effects and priors.
    (fitted(effects=["drift"]), r"an Effect, got 'drift'; write Drift\(\)"),
    (fitted(effects=[Floor]), r"got the class Floor; write Floor\(\)"),
    (fitted(effects=[Floor(prior=stats.norm())]), "floor must not reach below zero"),
    (fitted(priors=[1, 2]), r"priors must be Priors or a mapping, got \[1, 2\]"),
    (fitted(priors={"lapse_low": stats.beta}), "must be a frozen continuous distribution"),
    (fitted(priors={"lapse_low": (1, 9)}), "must be one number, got 2"),
    (fitted(priors={"lapse_low": 0.6, "lapse_high": 0.6}), "must leave something"),
    (lambda: Priors(effects=["a"]), "effects must be a mapping"),  # type: ignore[arg-type]
    (lambda: fit_population(ANIMALS, spread_prior=0.3), "spread must be a frozen continuous"),
    (lambda: fit_population(ANIMALS, priors={"weber_fraction": 0.1}), "a population learns them"),
    # Encodings, observers, whiskers.
    (fitted(encoding="log"), r"got 'log'; write ww.behaviour.IdentityEncoding\(\)"),
    (fitted(observer="C2"), r"an Observer, got 'C2'; write ww.Observer\(whisker"),
    (lambda: ww.design.taper("C2"), r"write ww.Whisker.from_identity\('C2'\)"),  # type: ignore[arg-type]
    (lambda: ww.design.cues(WHISKER, "a"), "deflection_angle must be a number"),  # type: ignore[arg-type]
    (lambda: CueEncoding(Observer(WHISKER, cues.Compliance()), unit=0), "unit must be above zero"),
    # Settings of a fit, and what is asked of it.
    (fitted(bias=0), "bias 0 is unknown"),
    (fitted(seed="a"), "seed must be a whole number .* got 'a'"),
    (lambda: FIT.threshold(-1.0), "stimulus -1 lies outside what can be encoded"),
    # Comparisons and criticism.
    (lambda: compare({"a": FIT, "b": "x"}), f"the fit 'b' {A_WEBER_FIT}"),  # type: ignore[dict-item]
    (lambda: weber_law_test(TRIALS), A_WEBER_FIT),  # type: ignore[arg-type]
    (lambda: residuals_by(FIT), "no column was named"),
    # Simulation.
    (simulated(trials_per_level="a"), "whole number of 1 or more, got 'a'"),
    (simulated(lapse_low=[0.1, 0.2]), "lapse_low must be one number, got 2"),
    (simulated(bias=[1, 2, 3]), r"bias has shape \(3,\) for standards of shape \(1,\)"),
    (simulated(drift=[1, 2], sessions=2), "drift must be one number"),
    (simulated(standards=[]), "standards is empty"),
    (simulated(offsets=[[0.1], [0.2]]), r"one row of numbers, got shape \(2, 1\)"),
    (simulated(comparisons=np.ones((1, 1, 2))), r"comparisons has shape \(1, 1, 2\)"),
    (lambda: simulate_population("a", seed=1), "subjects must be a whole number"),  # type: ignore[arg-type]
    (lambda: simulate_population(3, spread=[1, 2], seed=1), "spread must be one number"),  # type: ignore[arg-type]
    # Reading.
    (lambda: read_trials(None), r"a path or a DataFrame, got None"),  # type: ignore[arg-type]
    (lambda: read_trials(pd.concat([TABLE, TABLE[["choice"]]], axis=1)), "two columns 'choice'"),
    (read(columns="a"), "columns must be a mapping, got 'a'"),
    (read(columns={"choice": 5}), r"columns\['choice'\] must be the name of a column, got 5"),
    (read(choice_labels="LR"), "choice_labels must be a mapping, got 'LR'"),
    (read(log_unit=1.0), "log_unit=1 was given for magnitudes"),
    (read(whisker="C2"), "whisker must be a Whisker"),
    # The psychometric function by itself.
    (lambda: PercentCorrect(1), "whole number of 2 or more, got 1"),
    (lambda: response_probability("2AFC", SELF, 1, 1.1, weber_fraction=0.1), "task must be a Task"),  # type: ignore[arg-type]
    (lambda: response_probability(TASK, SELF, 1, 1.1, weber_fraction=-0.1), "above zero, got -0.1"),
    (lambda: response_probability(TASK, SELF, 1, -1.1, weber_fraction=0.1), "stimulus -1.1 lies"),
    (
        lambda: response_probability(TASK, SELF, 1, 1.1, weber_fraction=0.1, lapse_low=2),
        "lapses sum to more than 1",
    ),
    (lambda: threshold(TASK, SELF, 1, 0.75, weber_fraction=0), "above zero, got 0"),
    (
        lambda: response_probability(TASK, 3.0, 1.0, 1.1, weber_fraction=0.1),
        "encoding must be an Encoding, got 3.0; write ww.behaviour.IdentityEncoding",
    ),
    (
        lambda: response_probability(TASK, SELF, {}, 1.1, weber_fraction=0.1),
        "stimulus_1 must be a number",
    ),
    (
        lambda: response_probability(TASK, SELF, 1.0, 1.1, weber_fraction=0.1, bias={}),
        "bias must be a number",
    ),
    (
        lambda: threshold(TASK, SELF, 1.0, 0.75, weber_fraction=0.1, effects=3.0),
        "effects must be pairs of an effect and its value, got 3.0",
    ),
    (lambda: Trials(TRIALS.frame.assign(n=np.inf), TASK), "n must be a whole number"),
    (simulated(subject=[]), r"subject must be a name, got \[\]; write 'r1'"),
    (lambda: simulate_population(2.5, seed=1), "subjects must be a whole number"),
    (lambda: joined(3.0), "parts must be a list of Trials, got 3.0"),
    (read(scale="log", log_unit=[]), "log_unit must be one number, got 0"),
    (
        lambda: simulate_responses(3.0, pd.DataFrame(), encoding=SELF, seed=1),
        "table must be a DataFrame with columns subject, standard",
    ),
    (
        lambda: simulate_responses(
            TRIALS.frame.assign(subject="a"), pd.DataFrame(), encoding=SELF, seed=1
        ),
        "animals must be a DataFrame with columns subject, weber_fraction",
    ),
]


@pytest.mark.parametrize("number", range(len(MISUSES)))
def test_misuse_is_one_clear_sentence(number: int) -> None:
    work, part = MISUSES[number]
    with pytest.raises(ValueError, match=part) as caught:
        work()
    said = str(caught.value)
    assert "\n" not in said
    assert said.endswith(".")


def test_degrees_for_radians_are_hinted_at():
    with pytest.warns(UserWarning, match=r"did you pass degrees\? Write np.radians\(20\)"):
        press(WHISKER, 20e-3, 20)
    with pytest.warns(UserWarning, match="did you pass degrees"):
        CueEncoding(Observer(WHISKER, cues.ForceMap()), 10.0)


@pytest.mark.parametrize("call", [ww.posterior, ww.touches])
def test_what_is_no_observer_is_named(call):
    with pytest.raises(ValueError, match="observer must be an Observer, got 'C2'"):
        call("C2", [1.0])


CURVED, CONE = Whisker(50e-3, 100e-6, 5e-6, curvature=20.0), Whisker(50e-3, 100e-6, 0.0)
RECEPTOR_AND_CUE_MISUSES: list[tuple[Callable[[], object], str]] = [
    (lambda: cues.VibrissaLength().radial_distance(WHISKER, [1, 0, 1]), "must have 2 numbers"),
    (lambda: cues.VibrissaLength().radial_distance(WHISKER, 1.0), "must have 2 numbers"),
    (lambda: cues.AngleSideAngle().radial_distance(WHISKER, [1.0, 1.2, 1.3]), "have 2 numbers"),
    (lambda: follow(WHISKER, [0.1], [1e-6], start=(30e-3,)), "start must have 2 numbers"),
    *(
        (
            lambda d=d: Observer(WHISKER, cues.Compliance(), prior={"radial_distance": d}),
            "must be a frozen SciPy distribution, a continuous one",
        )
        for d in (stats.lognorm, stats.uniform, stats.randint(0, 3))
    ),
    (lambda: cues.Compliance().radial_distance(CURVED, 1e-5), "of a light tap on a straight"),
    (
        lambda: cues.Compliance(tap_angle=0.3).radial_distance(WHISKER, 1e-5),
        "of a light tap on a straight",
    ),
    (lambda: GeneralisedWeber(0.1, floor=0.0, ceiling=[np.nan, 1.0]), "ceiling must be finite"),
    (lambda: GeneralisedWeber(0.1, floor=0.0, ceiling=["a", 1.0]), "ceiling must be a number"),
]  # fmt: skip


@pytest.mark.parametrize("number", range(len(RECEPTOR_AND_CUE_MISUSES)))
def test_misuse_of_cues_and_receptors_is_one_clear_sentence(number: int) -> None:
    work, part = RECEPTOR_AND_CUE_MISUSES[number]
    with pytest.raises(ValueError, match=part) as caught:
        work()
    assert str(caught.value).count(";") == 1


def test_slips_of_units_are_hinted_at() -> None:
    with pytest.warns(UserWarning, match=r"curvature is in 1/m, got 0.012.*Write 12\."):
        ww.Whisker(50e-3, 100e-6, 5e-6, curvature=0.012)
    tap = ww.Observer(ww.Whisker(50e-3, 100e-6, 5e-6), ww.cues.Compliance())
    with pytest.warns(UserWarning, match="in metres, got 25: did you pass millimetres.*25e-3"):
        ww.jnd_curve(tap, [20e-3, 25.0], seed=1)
    with pytest.warns(UserWarning, match="in metres, got 20: did you pass millimetres.*20e-3"):
        ww.press(tap.whisker, 20, 0.2)
    with pytest.raises(ValueError, match=r"sign and unit \(N m, N, rad\)"):
        ww.posterior(tap, 1e9)
    assert "°" not in str(ww.flick_past(tap.whisker, 20))


@pytest.mark.parametrize(
    ("reading", "part"),
    [([1j], "reading must be a number, got"), (["a"], "reading must be a number, got")],
)
def test_what_is_no_number_is_no_reading(reading: list[Any], part: str) -> None:
    tap = ww.Observer(ww.Whisker(50e-3, 100e-6, 5e-6), ww.cues.Compliance())
    with pytest.raises(ValueError, match=part):
        ww.posterior(tap, reading)
    with pytest.raises(ValueError, match="a reading or more, got none; give one row a touch"):
        ww.touches(tap, [])


@pytest.mark.parametrize(
    ("angle", "written"),
    [
        (6.0, "np.radians(6)"),  # of a small tangent, as the next
        (-9.0, "np.radians(-9)"),
        (20.0, "np.radians(20)"),
        (45.0, "np.radians(30)"),
        (-180.0, "np.radians(-30)"),
        (0.6, "np.radians(30)"),
    ],
)
def test_a_friction_angle_in_degrees_is_refused_with_what_can_be_written(angle, written):
    with pytest.raises(ValueError, match="angle must be radians up to 30°") as caught:
        cues.Friction(cues.ForceMap(), angle)
    assert f"write {written} " in str(caught.value)
    assert cues.Friction(cues.ForceMap(), eval(written)).angle is not None
