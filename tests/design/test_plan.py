"""Plans of experiments come back from their files, and say what they are."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import norm

from weberwhisk import Observer, Whisker, plan_experiment, plots, read_plan
from weberwhisk._util.output import csv_text
from weberwhisk.behaviour import CueEncoding, Priors
from weberwhisk.behaviour.encodings import Encoding
from weberwhisk.cues import Compliance, ForceMap
from weberwhisk.design import (
    Constraints,
    Evidence,
    Hypothesis,
    Plan,
    Precision,
    Scheme,
    SubjectPopulation,
    cues,
    noises,
    plan_json,
    taper,
)
from weberwhisk.design.plan_file import _reader, plain, plan_of, preregistration
from weberwhisk.design.session import with_places

STANDARDS = [10e-3, 18e-3, 28e-3]
OFFSETS = [-3e-3, -2e-3, -1e-3, 1e-3, 2e-3, 3e-3]


@pytest.fixture(scope="module")
def plan() -> Plan:
    """Two animals, three standards, pole steps of 10 µm, and everything else not the default."""
    return plan_experiment(
        "C3",
        standards=[8e-3, 15e-3, 22e-3],
        levels=[-2.0, -1.2, -0.6, 0.6, 1.2, 2.0],
        trials=6,
        animals=2,
        expected=SubjectPopulation(0.12, 0.2, 0.02, 0.1),
        constraints=Constraints(5e-3, 27e-3, 1e-5),
        trials_per_session=60,
        longest_run=4,
        title="A plan, “tried”",
        together=False,
        runs=4,
        seed=7,
    )


def test_a_plan_comes_back_from_its_file_to_the_byte(plan: Plan, tmp_path: Path) -> None:
    text = plan_json(plan)
    (tmp_path / "plan.json").write_text(text, "utf-8")
    again = read_plan(tmp_path / "plan.json")
    assert plan_json(again) == text
    assert csv_text(again.trials) == csv_text(plan.trials)
    assert preregistration(again) == preregistration(plan)
    # And the fingerprint is that of the file of trials.
    written = with_places(plan.trials, plan.hypotheses[0].task)
    digest = hashlib.sha256(csv_text(written).encode()).hexdigest()
    assert json.loads(text)["trials_sha256"] == digest


@pytest.mark.parametrize(
    "hypotheses",
    [
        taper(Whisker.from_identity("C2"), bias="shared"),
        cues(Whisker.from_identity("C2"), 0.1, priors=Priors(lapse_low=0.02, bias=norm(0.1, 2.0))),
        noises(taper(Whisker.from_identity("C2"))[0].encoding, [0.01, 0.02]),
    ],
    ids=["taper", "cues", "noises"],
)
def test_any_hypotheses_come_back_with_their_plan(hypotheses: tuple[Hypothesis, ...]) -> None:
    plan = Plan(Scheme([10e-3, 20e-3], [-1e-3, 1e-3]), hypotheses, Evidence(bayes_factor=3))
    again = plan_of(plan_json(plan))
    cells = plan.scheme.cells()
    for one, other in zip(plan.hypotheses, again.hypotheses, strict=True):
        assert (one.name, one.bias, one.noise, one.task) == (
            other.name, other.bias, other.noise, other.task,
        )  # fmt: skip
        for call in ("mean", "sd_per_weber_fraction"):
            mine, theirs = (getattr(h.encoding, call)(cells.stimulus_2) for h in (one, other))
            np.testing.assert_array_equal(mine, theirs)
        score = np.linspace(-3, 3, 7)
        for name in ("weber_fraction", "lapse_low", "lapse_high", "bias"):
            np.testing.assert_array_equal(
                one.priors.value(name, score), other.priors.value(name, score)
            )


REMOVED = "removed"


def tried(plan: Plan, place: tuple[Any, ...], put: Any) -> None:
    """The plan with one part replaced: refused in one sentence, or read and of use."""
    record = json.loads(plan_json(plan))
    *above, key = place
    inside: Any = record
    for step in above:
        inside = inside[step]
    if put is REMOVED:
        del inside[key]
    else:
        inside[key] = put
    try:
        read = plan_of(json.dumps(record))
    except ValueError as error:
        sentence = str(error)
        assert "plan.json" in sentence
        assert "\n" not in sentence
        assert len(sentence) < 400
        return
    assert read.fingerprint == plan.fingerprint
    # What the file let through, `rehearse` uses.
    preregistration(read)
    assert np.isfinite([h.priors.value("weber_fraction", 0.5) for h in read.hypotheses]).all()
    assert not any(read.levels.isna().any())


HYPOTHESIS = "plan", "hypotheses", 0


@pytest.mark.parametrize(
    ("place", "put"),
    [
        ((*HYPOTHESIS, "priors"), []),
        ((*HYPOTHESIS, "priors"), None),
        ((*HYPOTHESIS, "priors", "is"), REMOVED),
        ((*HYPOTHESIS, "priors", "weber_fraction", "args", 0), np.nan),
        ((*HYPOTHESIS, "priors", "weber_fraction", "args", 0), -1),
        ((*HYPOTHESIS, "priors", "weber_fraction", "kwds", "scale"), 0),
        ((*HYPOTHESIS, "priors", "bias", "args", 0), None),
        ((*HYPOTHESIS, "encoding", "observer", "cue", "tap_angle"), [1]),
        ((*HYPOTHESIS, "encoding", "observer", "whisker", "length"), None),
        (("plan", "hypotheses"), [1]),
        (("plan", "title"), None),
        (("plan", "animals"), 0.5),
        (("plan", "scheme", "standards"), [None]),
        (("plan", "scheme", "trials"), [[1e400]]),
        (("power",), [1]),
        (("power",), {"power": [0.5]}),
    ],
)
def test_what_once_broke_a_plan_is_refused_in_one_sentence(
    plan: Plan, place: tuple[Any, ...], put: Any
) -> None:
    with np.errstate(all="raise"):
        tried(plan, place, put)


def test_a_plan_of_another_version_says_which_made_it(plan: Plan) -> None:
    record = json.loads(plan_json(plan))
    record["version"] = 1
    record["made_with"] = {"weberwhisk": "9.9", "numpy": "7.1"}
    with pytest.raises(ValueError, match=r"version 1 .* reads versions 2 and 3; .*weberwhisk 9\.9"):
        plan_of(json.dumps(record))


def test_a_plan_whose_lists_come_out_differently_is_refused(plan: Plan) -> None:
    record = json.loads(plan_json(plan))
    record["plan"]["seed"] += 1
    with pytest.raises(ValueError, match="gives other trial lists than when it was made"):
        plan_of(json.dumps(record))


C2 = Whisker.from_identity("C2")  # 33.6 mm


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"standards": [40e-3]}, r"standard 40 mm is off the whisker, by 6\.4 mm past its tip"),
        ({"standards": [30e-3], "levels": [9.0]}, r"comparison .* is off the whisker, by"),
        ({"scheme": Scheme([10e-3], [-11e-3])}, r"nearer than the range .* by 1\.?\d* mm"),
        ({"trials": 0}, r"trials of a level must be a whole number of 1 or more, got 0"),
        ({"animals": 0}, r"animals must be a whole number of 1 or more, got 0"),
        ({"constraints": Constraints(nearest=9e-3), "trials": 5}, r"nearer .* by .* mm"),
        (
            {"constraints": Constraints(farthest=30e-3), "trials": 5},
            r"farther .* to 30 mm, by 0\.24 mm",
        ),
        ({"constraints": Constraints(step=2e-3), "trials": 5}, r"steps of 2 mm are too coarse"),
        (
            {
                "goal": Precision(half_width=0.2),
                "cue": ForceMap(),
                "deflection_angle": 0.7,
                "scheme": Scheme([10e-3, 25e-3], [-1e-3, 1e-3]),
            },
            r"flicked past: the whisker holds .* too much",
        ),
        ({"goal": Precision(half_width=0.2), "cue": ForceMap()}, r"needs the deflection angle"),
        ({"cue": ForceMap(), "trials": 5}, r"Taper is tested by the compliance cue"),
        ({"hypotheses": taper(C2)[:1], "trials": 5}, r"A Bayes factor compares two hypotheses"),
        ({"together": True, "trials": 5}, r"One animal cannot be fitted together"),
        ({"cue": Compliance(tap_angle=0.5), "trials": 5}, r"at the lightest tap"),
        ({"deflection_angle": 0.5, "trials": 5}, r"has no deflection angle, got 0\.5"),
        ({"scheme": Scheme([10e-3], [-1e-3, 1e-3]), "trials": 5}, r"leave standards and trials"),
        ({"scheme": Scheme([10e-3], [-1e-3, 1e-3]), "animals": 3}, r"with_animals\(3\)"),
        ({"find": "nothing"}, r"Trials are given or found, got neither"),
        ({"find": "animals"}, r"found for so many trials each, got none"),
        ({"find": "whiskers"}, r"find 'whiskers' is unknown"),
    ],
)
def test_what_cannot_be_planned_is_refused(options: dict[str, Any], sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        plan_experiment("C2", **options, runs=0)


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (lambda: Evidence(bayes_factor=1), "bayes_factor must be above 1"),
        (lambda: Precision(half_width=20), "half_width must lie between 0 and 1, got 20"),
        (lambda: Evidence(10, share=1), "share must lie between 0 and 1, got 1"),
        (lambda: SubjectPopulation(0), "weber_fraction must be above zero"),
        (lambda: SubjectPopulation(lapse=0.5), "lapse must lie between 0 and 0.5"),
        (lambda: SubjectPopulation(spread=-1), "spread must not be negative"),
    ],
)
def test_goals_and_animals_that_make_no_sense_are_refused(
    make: Callable[[], object], sentence: str
) -> None:
    with pytest.raises(ValueError, match=sentence):
        make()


# -- the size ------------------------------------------------------------------------------------


@pytest.mark.slow  # of power by itself: test_power.py
@pytest.mark.parametrize("runs", [24, pytest.param(48, marks=pytest.mark.slow)])
def test_the_goal_decides_the_number_of_trials(runs: int) -> None:
    """As few as reach it, even in number; the power of the plan says so, and half as many do not.

    Chance: 48 experiments at a size have a standard error of 0.06, 24 of 0.08.
    """
    goal = Evidence(bayes_factor=10, share=0.85)
    plan = plan_experiment(
        "C2", goal=goal, standards=[20e-3, 30e-3], levels=[-2, -1, 1, 2], runs=runs, seed=2
    )
    assert plan.power is not None
    (trials,) = {n for row in plan.scheme.trials for n in row}
    assert trials % 2 == 0
    size = plan.power["trials"][plan.power["trials"] <= trials].max()
    assert size == trials
    planned = plan.power[plan.power["trials"] == size]
    assert sorted(planned["truth"]) == ["cylindrical", "tapered"]
    assert (planned["upper"] > 0.85).all()
    small = plan.power[plan.power["trials"] <= trials / 2]
    assert small["power"].min() < 0.85
    assert "the aim is reached by" in plan.power_in_words()
    ax = plots.power_curve(plan)
    marked = [line.get_xdata()[0] for line in ax.get_lines() if len(set(line.get_xdata())) == 1]
    assert trials in marked


# -- what is expected ----------------------------------------------------------------------------


def test_expected_jnds_are_the_papers(plan: Plan) -> None:
    """k r (1 − r/A) and k r, (3.5) and (3.6), in the 75 % criterion: 0.9539 of an sd."""
    whisker = Whisker.from_identity("C3")
    for hypothesis, fit in plan.expected_fits:
        own = plan.jnds.query("hypothesis == @hypothesis")
        r = own["stimulus_mm"].to_numpy()
        shape = r if hypothesis == "cylindrical" else r * (1 - r / (1e3 * whisker.apex_distance))
        expected = 0.953873 * fit.weber_fraction * shape
        np.testing.assert_allclose(own["jnd_mm"], expected, rtol=2e-5)
        assert (own["lower_mm"] < own["jnd_mm"]).all()
        assert (own["jnd_mm"] < own["upper_mm"]).all()


# -- the page and the folder ---------------------------------------------------------------------


def test_the_preregistration_says_what_the_plan_is(plan: Plan) -> None:
    text = " ".join(preregistration(plan).split())
    for fact in (
        "Bayes factor above 10",
        "2 animals, 108 trials each, in 3 sessions of at most 60",
        "sd of ln k 0.2",
        "lapses of 2 % a side",
        "not more than 4 times running",
        "from seed 7",
        "lognorm(1.099, scale=0.1)",
        "beta(0.7, 20)",
        "a response bias b for each standard",
        'weberwhisk.fit_weber with bias="per standard"; on the command line --bias',
    ):
        assert fact in text, fact
    alone = Plan(plan.scheme, plan.hypotheses[:1], Precision(0.25), constraints=Constraints())
    assert "half-width is below 25 %" in " ".join(preregistration(alone).split())
    pooled = replace(plan, together=True)
    assert "All animals are fitted together" in " ".join(preregistration(pooled).split())


def test_a_plan_keeps_the_model_of_its_observers() -> None:
    """Power, which goes by JSON, was of an elastica where a closed form was asked for."""
    whisker = Whisker.from_identity("C2")
    given = CueEncoding(Observer(whisker, ForceMap(), model="closed_form"), 0.5)
    again = _reader().structure(plain(given), Encoding)
    assert again == given
    assert again != CueEncoding(Observer(whisker, ForceMap()), 0.5)
    own = Observer(whisker, ForceMap(), prior={"radial_distance": norm(20e-3, 1e-3)})
    with pytest.raises(ValueError, match="has a prior or a tolerance of its own"):
        plain(own)


@pytest.mark.parametrize(
    ("goal", "of_0_2"),
    [
        (Evidence(5, 0.9), {"bayes_factor": 5, "half_width": None, "share": 0.9}),
        (Precision(0.3), {"bayes_factor": None, "half_width": 0.3, "share": 0.8}),
    ],
)
def test_goals_of_0_2_are_read(goal: Evidence | Precision, of_0_2: dict[str, Any]) -> None:
    hypotheses = taper(Whisker.from_identity("C2"))
    plan = Plan(Scheme([10e-3, 20e-3], [-1e-3, 1e-3]), hypotheses, goal)
    record = json.loads(plan_json(plan))
    assert plan_of(json.dumps(record)).goal == goal
    record["plan"]["goal"] = {"is": "Goal", **of_0_2}
    assert plan_of(json.dumps(record)).goal == goal
    record["plan"]["goal"] = {"is": "Goal", "bayes_factor": None, "half_width": None, "share": 0.8}
    with pytest.raises(ValueError, match="is no Goal"):
        plan_of(json.dumps(record))
