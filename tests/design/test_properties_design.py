"""Properties of designs: schemes, trial lists, power, placement, campaigns, populations."""

from __future__ import annotations

import numpy as np
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from property_strategies import POWERS, floats, scaled, whiskers

import weberwhisk as ww
from weberwhisk.behaviour import IdentityEncoding
from weberwhisk.design import (
    BayesianPlacer,
    Hypothesis,
    Scheme,
    lattice,
    next_trial,
    taper,
)

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
@given(SEEDS, st.integers(1, 3))
def test_the_next_trial_after_a_table_is_one_of_the_scheme(seed: int, each: int) -> None:
    trials = ww.simulate_trials(trials_per_level=each, seed=seed)
    scheme = lattice(FELT.encoding, 1.0, each_side=5)
    found = next_trial(trials, FELT, scheme, seed=1)
    assert found.trial == trials.n_trials + 1
    assert found == next_trial(trials, FELT, scheme, seed=1)
    assert found.comparison in scheme.comparisons[0]


# -- campaigns and populations --------------------------------------------------------------------
