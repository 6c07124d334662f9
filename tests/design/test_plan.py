"""Plans of experiments: balanced trial lists, files that rigs read, and plans that come back."""

from __future__ import annotations

import hashlib
import io
import json
import keyword
import re
from collections.abc import Callable
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import norm
from short_forms import short_or_full

from weberwhisk import Observer, Whisker, plan_experiment, plots, read_plan
from weberwhisk._util.output import csv_text
from weberwhisk.behaviour import CueEncoding, IdentityEncoding, Priors, read_trials
from weberwhisk.behaviour.encodings import Encoding
from weberwhisk.behaviour.simulate import simulate_responses
from weberwhisk.cues import Compliance, ForceMap
from weberwhisk.design import (
    Constraints,
    Goal,
    Hypothesis,
    Plan,
    Scheme,
    SubjectPopulation,
    cues,
    noises,
    plan_json,
    taper,
    trial_lists,
)
from weberwhisk.design.plan_file import _reader, plain, plan_of, preregistration
from weberwhisk.design.session import bpod_table, psychopy_tables

STANDARDS = [10e-3, 18e-3, 28e-3]
OFFSETS = [-3e-3, -2e-3, -1e-3, 1e-3, 2e-3, 3e-3]


@st.composite
def schemes(draw: st.DrawFn) -> Scheme:
    """Any scheme without an offset of nothing, level by level."""
    standards = draw(st.lists(st.integers(10, 40), min_size=1, max_size=4, unique=True))
    offset = st.integers(-9, 9).filter(bool)
    rows = [draw(st.lists(offset, min_size=1, max_size=6, unique=True)) for _ in standards]
    trials = [[draw(st.integers(1, 12)) for _ in row] for row in rows]
    return Scheme(standards, rows, trials, draw(st.integers(1, 2)))


@st.composite
def even_schemes(draw: st.DrawFn) -> Scheme:
    """Schemes with as many levels on either side of every standard, and trials alike."""
    offsets = draw(st.lists(st.integers(1, 9), min_size=1, max_size=4, unique=True))
    both = [sign * offset for sign in (-1, 1) for offset in offsets]
    count = draw(st.integers(1, 4))
    return Scheme(range(10, 10 + count), both, draw(st.integers(1, 30)), draw(st.integers(1, 2)))


def runs(sides: pd.Series) -> list[int]:
    return [len(list(run)) for _, run in groupby(sides)]


# -- trial lists ---------------------------------------------------------------------------------


@settings(max_examples=20)
@given(schemes(), st.integers(5, 200), st.integers(0, 99))
def test_every_list_holds_the_scheme_and_is_balanced(
    scheme: Scheme, per_session: int, seed: int
) -> None:
    lists = trial_lists(scheme, trials_per_session=per_session, seed=seed)
    levels = scheme.table()
    assert lists["subject"].nunique() == scheme.animals
    for _, own in lists.groupby("subject"):
        # The scheme, no more and no less.
        assert own["level"].value_counts(sort=False).sort_index().tolist() == list(levels["trials"])
        cells, level = scheme.cells(), own["level"].to_numpy() - 1
        metres = np.stack([cells.standard, cells.stimulus_2], axis=-1)[level]
        np.testing.assert_allclose(own["standard_mm"], 1e3 * metres[:, 0], rtol=1e-9)
        pair = np.sort(own[["stimulus_1_mm", "stimulus_2_mm"]], axis=1)
        np.testing.assert_allclose(pair, 1e3 * np.sort(metres, axis=1), rtol=1e-9)
        # The right answer is what it says.
        farther = np.where(own["stimulus_2_mm"] > own["stimulus_1_mm"], 2, 1)
        np.testing.assert_array_equal(own["greater"], farther)
        # Of the trials of a level, the standard comes first in half, within one.
        first = (own["stimulus_1_mm"] == own["standard_mm"]).groupby(own["level"]).sum()
        assert (2 * first - levels["trials"].to_numpy()).abs().max() <= 1
        # Every level equally often in every block, within one.
        times = own.groupby(["session", "block"])["level"].value_counts().unstack(fill_value=0)
        assert (times.max() - times.min()).max() <= 1
        # Sessions no longer than asked, numbered from one and without gaps.
        size = own.groupby("session").size()
        assert size.max() <= per_session
        assert size.index.tolist() == list(range(1, len(size) + 1))
        for _, session in own.groupby("session"):
            assert session["trial"].tolist() == list(range(1, len(session) + 1))
            assert (session["block"].diff().iloc[1:] >= 0).all()


@settings(max_examples=20)
@given(even_schemes(), st.integers(2, 6), st.integers(0, 99))
def test_the_right_answer_cannot_be_foreseen_from_what_went_before(
    scheme: Scheme, longest: int, seed: int
) -> None:
    lists = trial_lists(scheme, trials_per_session=300, longest_run=longest, seed=seed)
    for _, session in lists.groupby(["subject", "session"]):
        sides = session["greater"]
        # Odd numbers of trials leave a level of each standard uneven, at most.
        assert abs((sides == 1).sum() - (sides == 2).sum()) <= len(scheme.standards)
        assert max(runs(sides)) <= longest


def test_lists_come_back_with_their_seed_and_each_animal_keeps_its_own() -> None:
    scheme = Scheme(STANDARDS, OFFSETS, 10, 3)
    one = trial_lists(scheme, seed=1)
    pd.testing.assert_frame_equal(one, trial_lists(scheme, seed=1))
    assert not one.equals(trial_lists(scheme, seed=2))
    orders = [own["level"].tolist() for _, own in one.groupby("subject")]
    assert orders[0] != orders[1] != orders[2]
    more = trial_lists(scheme.with_animals(5), seed=1)
    pd.testing.assert_frame_equal(one, more[more["subject"].isin(["s1", "s2", "s3"])])


@pytest.mark.parametrize(
    ("scheme", "options", "sentence"),
    [
        (Scheme([20e-3], [-2e-3, 0.0, 2e-3]), {}, "leave the offset 0 out"),
        (Scheme([20e-3], [-2e-3, 2e-3]), {"trials_per_session": 0}, "trials_per_session must be"),
        (Scheme([20e-3], [-2e-3, 2e-3]), {"longest_run": 1}, "longest_run must be a whole number"),
    ],
)
def test_lists_that_cannot_be_are_refused(
    scheme: Scheme, options: dict[str, int], sentence: str
) -> None:
    with pytest.raises(ValueError, match=sentence):
        trial_lists(scheme, seed=1, **options)


# -- files ---------------------------------------------------------------------------------------


def import_conditions(text: str) -> list[dict[str, object]]:
    """What `psychopy.data.importConditions` makes of a CSV, by its documented rules."""
    table = pd.read_csv(io.StringIO(text), encoding="utf-8-sig", sep=",", decimal=".")
    names = list(table.columns)
    assert len(set(names)) == len(names)
    for name in names:
        assert not name[0].isdigit()
        assert not re.search(r"\W", name)
        assert name.isidentifier()
        assert not keyword.iskeyword(name)
    assert not table.isna().any(axis=None)
    return [{str(k): v for k, v in row.items()} for row in table.to_dict("records")]


def test_psychopy_reads_each_session_as_it_was_planned() -> None:
    lists = trial_lists(Scheme(STANDARDS, OFFSETS, 11, 2), trials_per_session=90, seed=4)
    read = []
    for name, table in psychopy_tables(lists):
        conditions = import_conditions(csv_text(table))
        subject, session = name.removeprefix("psychopy_").split("_")
        assert {row["subject"] for row in conditions} == {subject}
        assert {f"{row['session']:03d}" for row in conditions} == {session}
        read.extend(conditions)
    assert len(read) == len(lists)
    back = pd.DataFrame(read)
    for name in ("standard_mm", "stimulus_1_mm", "stimulus_2_mm"):
        np.testing.assert_array_equal(back[name], lists[name])
    farther = np.where(lists["stimulus_2_mm"] > lists["stimulus_1_mm"], "right", "left")
    np.testing.assert_array_equal(back["correct_answer"], farther)
    assert "trial" not in back  # the name of a routine in PsychoPy's Builder


def test_the_table_for_bpod_is_numbers_alone() -> None:
    lists = trial_lists(Scheme(STANDARDS, OFFSETS, 10, 2), seed=4)
    text = csv_text(bpod_table(lists))
    header, *lines = text.splitlines()
    assert all(re.fullmatch(r"[A-Za-z]\w{0,62}", name) for name in header.split(","))
    numbers = np.array([[float(cell) for cell in line.split(",")] for line in lines])
    assert numbers.shape == (len(lists), len(header.split(",")))
    types = dict(zip(header.split(","), numbers.T, strict=True))["trial_type"]
    np.testing.assert_array_equal(types, lists["greater"])


def test_a_list_is_read_back_with_its_answers() -> None:
    lists = trial_lists(Scheme(STANDARDS, OFFSETS, 10, 2), seed=4)
    table = pd.read_csv(io.StringIO(csv_text(lists.assign(choice=lists["greater"] - 1))))
    columns = {name: f"{name}_mm" for name in ("standard", "stimulus_1", "stimulus_2")}
    trials = read_trials(table, columns=columns)
    np.testing.assert_allclose(trials.standards, [10, 18, 28])
    trials = read_trials(table)  # what is not mapped is in metres
    np.testing.assert_allclose(trials.standards, [10e-3, 18e-3, 28e-3])
    assert trials.subjects == ["s1", "s2"]
    assert trials.n_trials == len(lists)


# -- answers to a list ---------------------------------------------------------------------------


def test_answers_to_a_list_have_the_probabilities_of_their_observers() -> None:
    """Shares of answers against Φ by hand, for two animals, in both orders; 4.5 binomial sds."""
    from scipy.special import ndtr

    table = pd.DataFrame(
        {
            "subject": np.repeat(["s1", "s2"], 8000),
            "standard": 1.0,
            "stimulus_1": np.tile([1.0, 1.1], 8000),
            "stimulus_2": np.tile([1.1, 1.0], 8000),
        }
    )
    animals = pd.DataFrame(
        {
            "subject": ["s1", "s2"],
            "weber_fraction": [0.1, 0.2],
            "lapse_low": [0.0, 0.04],
            "lapse_high": [0.02, 0.0],
            "bias": [0.0, 0.3],
        }
    )
    trials = simulate_responses(table, animals, encoding=IdentityEncoding(), seed=1)
    for row in animals.itertuples():
        for s1, s2 in ((1.0, 1.1), (1.1, 1.0)):
            own = trials.frame.query("subject == @row.subject and stimulus_1 == @s1")
            chance = ndtr((s2 - s1) / (row.weber_fraction * np.hypot(s1, s2)) + row.bias)
            p = row.lapse_low * (1 - chance) + (1 - row.lapse_high) * chance
            share = own["count"].mean()
            assert abs(share - p) < 4.5 * np.sqrt(p * (1 - p) / len(own))


# -- plans ---------------------------------------------------------------------------------------


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
    digest = hashlib.sha256(csv_text(plan.trials).encode()).hexdigest()
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
    plan = Plan(Scheme([10e-3, 20e-3], [-1e-3, 1e-3]), hypotheses, Goal(bayes_factor=3))
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
    with pytest.raises(ValueError, match=r"version 1 .* reads version 2; .*weberwhisk 9\.9"):
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
        ({"scheme": Scheme([10e-3], [-11e-3])}, r"nearer than the animal's range .* by 1\.?\d* mm"),
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
                "goal": Goal(half_width=0.2),
                "cue": ForceMap(),
                "deflection_angle": 0.7,
                "scheme": Scheme([10e-3, 25e-3], [-1e-3, 1e-3]),
            },
            r"flicked past: the whisker holds .* too much",
        ),
        ({"goal": Goal(half_width=0.2), "cue": ForceMap()}, r"needs the deflection angle"),
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
        (lambda: Goal(), "got neither"),
        (lambda: Goal(10, 0.2), "got both"),
        (lambda: Goal(bayes_factor=1), "bayes_factor must be above 1"),
        (lambda: Goal(half_width=20), "half_width must lie between 0 and 1, got 20"),
        (lambda: Goal(10, share=1), "share must lie between 0 and 1, got 1"),
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


@short_or_full("runs", 24, 48)
def test_the_goal_decides_the_number_of_trials(runs: int) -> None:
    """As few as reach it, even in number; the power of the plan says so, and half as many do not.

    Chance: 48 experiments at a size have a standard error of 0.06, 24 of 0.08.
    """
    goal = Goal(bayes_factor=10, share=0.85)
    plan = plan_experiment(
        "C2", goal=goal, standards=[20e-3, 30e-3], levels=[-2, -1, 1, 2], runs=runs, seed=2
    )
    assert plan.power is not None
    (trials,) = {n for row in plan.scheme.trials for n in row}
    assert trials % 2 == 0
    size = plan.power["trials"][plan.power["trials"] <= trials].max()
    assert size >= trials - 1
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
    alone = Plan(plan.scheme, plan.hypotheses[:1], Goal(half_width=0.25), constraints=Constraints())
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
