"""Properties of trials, tasks and fits: units, order, swapped intervals, and round trips."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd
from hypothesis import given, settings
from hypothesis import strategies as st
from property_strategies import POWERS, floats, logarithmic

import weberwhisk as ww
from weberwhisk.behaviour import (
    TASKS,
    IdentityEncoding,
    LogEncoding,
    Trials,
    fit_weber,
    read_trials,
    response_probability,
    simulate_trials,
    threshold,
)

SEEDS = st.integers(0, 2**32 - 1)
K = logarithmic(0.01, 1.0)
LAPSE = floats(0.0, 0.2)
PAIRS = st.lists(
    st.tuples(logarithmic(1e-6, 1e6), logarithmic(0.1, 10.0)), min_size=1, max_size=6
).map(lambda pairs: np.array(pairs).T)
tasks = st.sampled_from(sorted(TASKS))
#: Fits cost some 20 ms each: a third of the examples of a formula.
fits = settings(max_examples=max(settings.default.max_examples // 12, 1))


@given(PAIRS, tasks, K, LAPSE, LAPSE, floats(-2.0, 2.0), POWERS)
def test_chances_are_chances_in_any_unit(
    pairs: np.ndarray, name: str, k: float, low: float, high: float, bias: float, unit: float
) -> None:
    task, (first, ratio) = TASKS[name], pairs
    observer = {"weber_fraction": k, "lapse_low": low, "lapse_high": high, "bias": bias}
    p = response_probability(task, IdentityEncoding(), first, first * ratio, **observer)
    assert ((p >= 0) & (p <= 1)).all()
    elsewhere = response_probability(
        task, IdentityEncoding(), first * unit, first * ratio * unit, **observer
    )
    np.testing.assert_allclose(p, elsewhere, rtol=1e-12)
    logs = response_probability(
        task, LogEncoding(), np.log(first), np.log(first * ratio), **observer
    )
    np.testing.assert_allclose(p, logs, rtol=1e-6, atol=1e-9)


@given(PAIRS, K, LAPSE, LAPSE, floats(-2.0, 2.0))
def test_swapped_intervals_have_the_other_answer(
    pairs: np.ndarray, k: float, low: float, high: float, bias: float
) -> None:
    first, ratio = pairs
    task, felt = TASKS["2AFC"], IdentityEncoding()
    one = response_probability(
        task,
        felt,
        first,
        first * ratio,
        weber_fraction=k,
        lapse_low=low,
        lapse_high=high,
        bias=bias,
    )
    other = response_probability(
        task,
        felt,
        first * ratio,
        first,
        weber_fraction=k,
        lapse_low=high,
        lapse_high=low,
        bias=-bias,
    )
    np.testing.assert_allclose(one, 1 - other, atol=1e-12)


@given(logarithmic(1e-3, 1e3), logarithmic(0.01, 0.5), floats(0.05, 0.95), tasks)
def test_the_threshold_has_its_proportion(
    standard: float, k: float, proportion: float, name: str
) -> None:
    task = TASKS[name]
    guess = task.guess_rate or 0.0
    wanted = guess + proportion * (1 - guess)
    at = threshold(task, IdentityEncoding(), standard, wanted, weber_fraction=k)
    assert not np.isnan(at)
    if np.isfinite(at) and at > 0 and abs(at / standard - 1) > 1e-6:
        p = response_probability(task, IdentityEncoding(), standard, at, weber_fraction=k)
        np.testing.assert_allclose(p, wanted, atol=1e-6)


@st.composite
def simulated(draw: st.DrawFn, asked: st.SearchStrategy[str] = tasks) -> Trials:
    """Trials of any observer that may come, good, bad or lapsing."""
    return simulate_trials(
        weber_fraction=draw(K),
        standards=draw(st.lists(logarithmic(1e-3, 1e3), min_size=1, max_size=3, unique=True)),
        offsets=draw(st.lists(floats(-0.9, 2.0), min_size=1, max_size=6)),
        trials_per_level=draw(st.integers(1, 30)),
        lapse_low=draw(LAPSE),
        lapse_high=draw(LAPSE),
        missing=draw(st.sampled_from([0.0, 0.1, 0.99])),
        sessions=draw(st.integers(1, 3)),
        subject=draw(st.sampled_from([None, "a", "ratte ö", "1"])),
        task=draw(asked),
        seed=draw(SEEDS),
    )


@given(simulated())
def test_a_written_table_reads_back(trials: Trials) -> None:
    with TemporaryDirectory() as folder:
        path = trials.to_csv(Path(folder) / "trials.csv")
        back = read_trials(path, task=trials.task.name)
        assert [p.name for p in Path(folder).iterdir()] == ["trials.csv"]
    pd.testing.assert_frame_equal(back.frame, trials.frame, check_dtype=False)
    assert back.n_missing == trials.n_missing
    assert back.n_trials == trials.n_trials


def check_fit(fit: ww.behaviour.WeberFit) -> None:
    """Finite numbers in their order, sentences, and strict JSON."""
    assert fit.status.message
    low, high = fit.interval()
    assert 0 < low < fit.weber_fraction < high
    assert np.isfinite(high)
    table = fit.summary()
    assert np.isfinite(table.drop(columns="prior").to_numpy(float)).all()
    answer = json.loads(fit.to_json(), parse_constant=lambda text: 1 / 0)
    assert answer["status"] == fit.status.name
    assert fit.report().strip()
    assert not fit.threshold()[["comparison", "lower", "upper"]].isna().any().any()


@fits
@given(simulated())
def test_every_table_has_a_whole_fit(trials: Trials) -> None:
    check_fit(fit_weber(trials))


def alike(one: ww.behaviour.WeberFit, other: ww.behaviour.WeberFit, rtol: float = 1e-3) -> None:
    """Two fits of the same data."""
    assert one.status == other.status
    quantiles = np.array([0.025, 0.5, 0.975])
    np.testing.assert_allclose(
        one.posterior.quantile("weber_fraction", quantiles),
        other.posterior.quantile("weber_fraction", quantiles),
        rtol=rtol,
    )


@fits
@given(simulated(), st.integers(-8, 8).map(lambda n: 10.0**n), SEEDS)
def test_fits_know_neither_unit_nor_order_nor_form(trials: Trials, unit: float, seed: int) -> None:
    fit = fit_weber(trials)
    stimuli = ["standard", "stimulus_1", "stimulus_2"]
    frame = trials.frame.copy()
    frame[stimuli] *= unit
    alike(fit, fit_weber(replace(trials, frame=frame)))
    shuffled = trials.frame.sample(frac=1.0, random_state=np.random.default_rng(seed))
    alike(fit, fit_weber(replace(trials, frame=shuffled.reset_index(drop=True))), 1e-9)
    answered = trials.frame.dropna(subset="count")
    if len(answered):
        counts = answered.groupby(stimuli, as_index=False)[["n", "count"]].sum()
        alike(fit, fit_weber(replace(trials, frame=counts)), 1e-9)
