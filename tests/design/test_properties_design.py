"""Properties of designs: schemes, trial lists, power, placement, campaigns, populations."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from itertools import groupby
from pathlib import Path

import campaign_work
import numpy as np
import pandas as pd
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from property_strategies import POWERS, floats, logarithmic, scaled, whiskers

import weberwhisk as ww
from weberwhisk import campaign
from weberwhisk.behaviour import IdentityEncoding, fit_population, simulate_population
from weberwhisk.design import (
    BayesianPlacer,
    Goal,
    Hypothesis,
    Plan,
    Scheme,
    Session,
    Staircase,
    SubjectPopulation,
    lattice,
    next_trial,
    power,
    taper,
    trial_lists,
)
from weberwhisk.design.plan_file import plan_json, plan_of

SEEDS = st.integers(0, 2**32 - 1)
#: A placer, a plan or a population costs tens of milliseconds: a third of the examples.
few = settings(max_examples=max(settings.default.max_examples // 3, 4))
FELT = Hypothesis("Weber", IdentityEncoding(), bias="shared")


@st.composite
def schemes(draw: st.DrawFn, most: int = 30) -> Scheme:
    """Standards of any unit with offsets on both sides, one to `most` trials a level."""
    unit = draw(POWERS)
    standards = draw(st.lists(st.integers(8, 40), min_size=1, max_size=3, unique=True))
    rows, counts = [], []
    for _ in standards:
        steps = st.integers(-7, 7).filter(bool)
        offsets = sorted(draw(st.lists(steps, min_size=1, max_size=5, unique=True)))
        rows.append([offset * unit / 8 for offset in offsets])
        counts.append([draw(st.integers(1, most)) for _ in offsets])
    animals = draw(st.integers(1, 3))
    return Scheme([s * unit for s in standards], rows, counts, animals)


@given(schemes())
def test_a_scheme_counts_what_it_holds(scheme: Scheme) -> None:
    table = scheme.table()
    assert table["trials"].sum() == scheme.n_trials
    assert scheme.total_trials == scheme.n_trials * scheme.animals
    assert list(scheme.standards) == sorted(scheme.standards)
    again = Scheme(**scheme.as_dict())
    assert again == scheme
    more = scheme.with_animals(5).with_trials(3)
    assert more.total_trials == 15 * len(table)
    offsets = scheme.cells().stimulus_2 - scheme.cells().standard
    # Comparisons are given to twelve digits, so that lists of trials are the same everywhere.
    wanted = np.concatenate(scheme.offsets)
    np.testing.assert_allclose(offsets, wanted, atol=1e-11 * max(scheme.standards))


@given(schemes(), st.integers(4, 60), st.integers(2, 6), SEEDS)
def test_trial_lists_are_balanced_and_repeat(
    scheme: Scheme, per_session: int, longest: int, seed: int
) -> None:
    options = {"trials_per_session": per_session, "longest_run": longest, "seed": seed}
    table = trial_lists(scheme, **options)
    pd.testing.assert_frame_equal(table, trial_lists(scheme, **options))
    assert len(table) == scheme.total_trials
    first = table["stimulus_1_mm"] > table["stimulus_2_mm"]
    assert (table["greater"] == np.where(first, 1, 2)).all()
    levels = scheme.table()["trials"].to_numpy()
    for _, animal in table.groupby("subject"):
        # Every level as often as asked for; each side of it as often as the other, within one.
        assert (animal["level"].value_counts().sort_index().to_numpy() == levels).all()
        sides = animal.groupby("level")["greater"].agg(
            lambda g: abs(int((g == 1).sum() * 2 - len(g)))
        )
        assert sides.max() <= 1
        assert animal.groupby("session").size().max() <= per_session
        assert (animal.groupby("session")["trial"].max() == animal.groupby("session").size()).all()
    # Another animal changes nothing for those that there are.
    wider = trial_lists(scheme.with_animals(scheme.animals + 1), **options)
    pd.testing.assert_frame_equal(table, wider.iloc[: len(table)])


@given(st.integers(2, 12), st.integers(5, 6), SEEDS)
def test_no_answer_stays_right_for_longer_than_allowed(half: int, longest: int, seed: int) -> None:
    scheme = Scheme([20.0], [-2.0, -1.0, 1.0, 2.0], 2 * half)
    table = trial_lists(scheme, longest_run=longest, seed=seed)
    runs = [len(list(same)) for _, same in groupby(table["greater"])]
    assert max(runs) <= longest


@few
@given(whiskers(), st.lists(floats(0.1, 0.9), min_size=1, max_size=2, unique=True), POWERS)
def test_spaced_offsets_know_no_unit(w: ww.Whisker, places: list[float], size: float) -> None:
    assume(w.tip_radius < 0.9 * w.base_radius)
    assume(size * w.length < 2.0)  # longer ones are refused as a slip of units
    assume(len({round(p, 2) for p in places}) == len(places))
    at = np.array(places) * w.length
    options = {"weber_fraction": 0.05, "levels": [-1.0, -0.5, 0.5, 1.0]}
    one, other = (
        Scheme.spaced(taper(whisker)[0].encoding, at * unit, **options)
        for whisker, unit in ((w, 1.0), (scaled(w, size), size))
    )
    np.testing.assert_allclose(other.standards, np.array(one.standards) * size, rtol=1e-6)
    np.testing.assert_allclose(
        np.concatenate(other.offsets), np.concatenate(one.offsets) * size, rtol=1e-4
    )
    for row in one.offsets:
        assert list(row) == sorted(row)
        assert row[1] < 0 < row[2]


@settings(max_examples=2)
@given(st.integers(3, 8), SEEDS)
def test_power_grows_with_trials_and_repeats(few_trials: int, seed: int) -> None:
    hypotheses = taper(ww.Whisker(50e-3, 100e-6, 5e-6))
    scheme = Scheme.spaced(hypotheses[0].encoding, [15e-3, 45e-3])
    options = {"goal": Goal(bayes_factor=3), "truths": ["tapered"], "runs": 48, "seed": seed}
    found = power(scheme, hypotheses, trials=[few_trials, 12 * few_trials], **options)
    few_, many = found.table["power"]
    assert 0 <= few_ <= many <= 1
    again = power(scheme, hypotheses, trials=[few_trials, 12 * few_trials], **options)
    pd.testing.assert_frame_equal(found.runs, again.runs)


@settings(max_examples=4)
@given(schemes(6), SEEDS)
def test_a_plan_reads_back(scheme: Scheme, seed: int) -> None:
    scheme = Scheme(
        np.array(scheme.standards) / scheme.standards[0] * 10e-3,
        [np.array(row) / scheme.standards[0] * 10e-3 for row in scheme.offsets],
        scheme.trials,
        scheme.animals,
    )
    assume(max(scheme.standards) + np.max(np.concatenate(scheme.offsets)) < 48e-3)
    hypotheses = taper(ww.Whisker(50e-3, 100e-6, 5e-6))
    plan = Plan(scheme, hypotheses, Goal(bayes_factor=10), SubjectPopulation(0.07), seed=seed)
    again = plan_of(plan_json(plan))
    assert again.fingerprint == plan.fingerprint
    assert plan_json(again) == plan_json(plan)


# -- placement ------------------------------------------------------------------------------------

ANSWERS = st.lists(st.sampled_from([0, 1, 1, 0, None]), min_size=1, max_size=12)


@few
@given(ANSWERS, st.integers(-6, 6).map(lambda n: 10.0**n), SEEDS)
def test_a_placer_knows_no_unit_and_narrows(
    answers: list[int | None], unit: float, seed: int
) -> None:
    placers = [BayesianPlacer(FELT, _scaled_lattice(size), seed=seed) for size in (1.0, unit)]
    for choice in answers:
        one, other = (placer.next() for placer in placers)
        np.testing.assert_allclose(other.comparison, one.comparison * unit, rtol=1e-12)
        assert one.easy == other.easy
        placers[0].record(one.standard, one.comparison, choice)
        placers[1].record(other.standard, other.comparison, choice)
    (low, high), (again_low, again_high) = (placer.interval() for placer in placers)
    assert 0 < low < placers[0].weber_fraction < high
    np.testing.assert_allclose([again_low, again_high], [low, high], rtol=1e-9)
    assert placers[0].interval(0.5)[0] > low
    trials = placers[0].trials() if any(a is not None for a in answers) else None
    if trials is not None:
        assert trials.n_trials == sum(a is not None for a in answers)


def _scaled_lattice(unit: float) -> Scheme:
    """Trials of one standard, in a unit."""
    plain = lattice(FELT.encoding, 16.0, each_side=6)
    return Scheme([16.0 * unit], [[offset * unit for offset in row] for row in plain.offsets])


@few
@given(ANSWERS, SEEDS)
def test_a_session_torn_anywhere_proposes_the_same_trial(
    answers: list[int | None], seed: int
) -> None:
    scheme = lattice(FELT.encoding, 20.0, each_side=4)

    def placer() -> BayesianPlacer:
        return BayesianPlacer(FELT, scheme, seed=seed)

    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "log"
        with Session(placer(), file) as session:
            for choice in answers:
                trial = session.next()
                session.record(trial.standard, trial.comparison, choice)
            expected = session.next()
        with file.open("ab") as end:
            end.write(b'{"trial": 99, "stand')  # killed while it wrote
        with Session(placer(), file) as session:
            assert session.next() == expected


@few
@given(st.lists(st.sampled_from([0, 1]), min_size=1, max_size=30), SEEDS)
def test_a_staircase_stays_on_its_ladder(answers: list[int], seed: int) -> None:
    scheme = lattice(FELT.encoding, 20.0, each_side=4)
    stairs = Staircase(FELT, scheme, seed=seed)
    for choice in answers:
        trial = stairs.next()
        assert trial.comparison in scheme.comparisons[0]
        stairs.record(trial.standard, trial.comparison, choice)
    assert stairs.n_trials == len(answers)


@few
@given(SEEDS, st.integers(1, 3))
def test_the_next_trial_after_a_table_is_one_of_the_scheme(seed: int, each: int) -> None:
    trials = ww.simulate_trials(trials_per_level=each, seed=seed)
    scheme = lattice(FELT.encoding, 1.0, each_side=5)
    found = next_trial(trials, FELT, scheme, seed=1)
    assert found.trial == trials.n_trials + 1
    assert found == next_trial(trials, FELT, scheme, seed=1)
    assert found.comparison in scheme.comparisons[0]


# -- campaigns and populations --------------------------------------------------------------------


@few
@given(st.integers(1, 8), st.integers(0, 8), SEEDS)
def test_a_campaign_is_the_same_bits_however_it_was_cut(n: int, kept: int, seed: int) -> None:
    chunks = [{"i": i} for i in range(n)]
    whole = campaign.run(campaign_work.draw, chunks, seed=seed)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "sweep.jsonl"
        campaign.run(campaign_work.draw, chunks, seed=seed, out=file)
        lines = file.read_bytes().splitlines(keepends=True)
        kept = min(kept, len(lines) - 1)
        file.write_bytes(b"".join(lines[: 1 + kept]) + lines[-1][:7])
        resumed = campaign.run(campaign_work.draw, chunks, seed=seed, out=file)
        pd.testing.assert_frame_equal(resumed, whole)
        pd.testing.assert_frame_equal(campaign.read(file), whole)


@pytest.mark.slow
@settings(max_examples=2)
@given(logarithmic(0.03, 0.3), floats(0.0, 0.5), st.sampled_from([1e-3, 1.0, 25.4]), SEEDS)
def test_populations_know_neither_unit_nor_order(
    k: float, spread: float, unit: float, seed: int
) -> None:
    trials, truth = simulate_population(
        2, weber_fraction=k, spread=spread, trials_per_level=8, seed=seed
    )
    assert len(truth) == 2
    assert (truth["weber_fraction"] > 0).all()
    table = trials.frame.sample(frac=1, random_state=seed)
    for column in ("standard", "stimulus_1", "stimulus_2"):
        table[column] *= unit
    one, other = (fit_population(t) for t in (trials, replace(trials, frame=table)))
    low, high = one.interval(0.95)
    assert 0 < low < one.weber_fraction < high
    np.testing.assert_allclose(other.interval(0.95), [low, high], rtol=5e-3)
    summary = one.summary().select_dtypes("number").to_numpy()
    assert np.isfinite(summary).all()
    # An animal is read nearer to the others than by itself: intervals hold the estimate.
    subjects = one.subjects
    assert ((subjects["lower"] < subjects["upper"]) & (subjects["lower"] > 0)).all()
