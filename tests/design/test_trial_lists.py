"""Lists of trials: balanced, read back from their files, and answered."""

from __future__ import annotations

import io
import keyword
import re
from itertools import groupby

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from weberwhisk._util.output import csv_text
from weberwhisk.behaviour import IdentityEncoding, read_trials
from weberwhisk.behaviour.simulate import simulate_responses
from weberwhisk.design import Scheme, trial_lists
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
