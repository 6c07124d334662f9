"""The paragraph for a methods section: every number in it is the fit's."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import scipy
from scipy import stats

import weberwhisk as ww
from weberwhisk.behaviour import CueEncoding

DATA = Path(__file__).parents[2] / "data_synthetic"


def _read(name: str) -> ww.Trials:
    return ww.read_trials(DATA / name)


def test_counts_priors_and_versions_are_said() -> None:
    trials = _read("weights_three_standards.csv")
    text = ww.fit_weber(trials).methods()
    for words in (
        f"{trials.n_trials} trials (9 without an answer were left out) of the task 2AFC",
        f"{trials.cells().n.size} pairs of stimuli at 3 standards",
        "weber_fraction ~ lognorm(1.099, scale=0.1)",
        "lapse_low ~ beta(0.7, 20), lapse_high ~ beta(0.7, 20), bias ~ cauchy(0, 0.7)",
        "the two lapse rates correlate by 0.7",
        "Φ(d + b)",
        "status: DETERMINED",
        f"weberwhisk {ww.__version__} (NumPy {np.__version__}, SciPy {scipy.__version__})",
    ):
        assert words in text
    assert "\n" not in text


def test_what_is_fixed_left_out_or_believed_otherwise_is_said() -> None:
    table = pd.read_csv(DATA / "weights_three_standards.csv")
    table = table.dropna()
    own = {"lapse_low": 0.02, "lapse_high": stats.beta(1, 50)}
    text = ww.fit_weber(ww.read_trials(table), bias="none", priors=own).methods()
    assert f"{len(table)} trials of the task" in text
    assert "lapse_high ~ beta(1, 50), lapse_low fixed at 0.02." in text
    assert "Φ(d)" in text
    assert "correlate" not in text


def test_a_whisker_is_described() -> None:
    tap = ww.Observer(ww.Whisker(50e-3, 100e-6, 5e-6), ww.cues.Compliance())
    trials = _read("distance_tapered.csv")
    text = ww.fit_weber(trials, encoding=CueEncoding(tap, unit=1e-3)).methods()
    assert "a tapered whisker (50 mm long, radius 100 to 5 µm) by its rotational compl" in text
    assert "receptors Weber: the signal is noisy with an sd of the Weber fraction k times" in text
    other = replace(tap, noise=ww.receptors.LogNormal(0.1))
    text = ww.fit_weber(trials, encoding=CueEncoding(other, unit=1e-3)).methods()
    assert "receptors LogNormal. " in text


@pytest.mark.slow  # of methods: what is read off a population, `test_populations.py`
def test_a_population_is_described() -> None:
    trials = _read("animals_six.csv").select(subject=["s1", "s2", "s3"])
    found = ww.fit_population(trials, check=False)
    text = found.methods()
    assert (
        f"{found.subjects['n'].sum()} trials of the task 2AFC, of 3 animals: ln k, the logit of "
        "lapse_low, the logit of lapse_high and bias are normal between animals" in text
    )
    assert "bias ~ cauchy(0, 0.7), spread ~ halfnorm(scale=0.5), lapse_spread ~" in text
    assert f"status: {found.status.name}" in text
