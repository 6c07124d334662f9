"""The synthetic data are what their generator makes, and their truth is found in them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from analysis_scripts import load
from short_forms import slow_but

from weberwhisk.behaviour import FitStatus, fit_weber, read_trials
from weberwhisk.behaviour.effects import Drift

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "data_synthetic"
PACKAGE = json.loads((FOLDER / "datapackage.json").read_text("utf-8"))
CHOICES = [entry for entry in PACKAGE["resources"] if "task" in entry]
NAMES = [Path(entry["path"]).stem for entry in CHOICES]


def test_regenerating_gives_the_same_bytes(tmp_path: Path) -> None:
    load("make_synthetic").write(tmp_path)
    made = sorted(path.name for path in tmp_path.iterdir())
    kept = sorted(path.name for path in FOLDER.iterdir() if path.suffix in (".csv", ".json"))
    assert made == kept
    for name in made:
        assert (tmp_path / name).read_bytes() == (FOLDER / name).read_bytes(), name


@pytest.mark.parametrize("entry", slow_but(CHOICES, (3, 9)), ids=NAMES)
def test_the_fit_is_what_the_package_says(entry: dict) -> None:
    truth = entry["truth"]
    trials = read_trials(FOLDER / entry["path"], task=entry["task"])
    encoding = load("make_synthetic").encoding_of(Path(entry["path"]).stem)
    animals = truth.get("animals", [truth])
    for animal in animals:
        own = trials.select(subject=animal["subject"]) if "subject" in animal else trials
        fit = fit_weber(own, encoding=encoding)
        if entry["status"]:
            assert fit.status is FitStatus[entry["status"]]
        if "drift" in truth:
            continue
        for name in ("weber_fraction", "lapse_low", "lapse_high", "bias"):
            if name in animal and name in fit.parameters:
                # Some twenty intervals are tried: at 99.5 % one of ten such tests would miss.
                low, high = fit.interval(0.995, parameter=name)
                assert low < animal[name] < high, name


@pytest.mark.slow  # two causes of one animal: tests/behaviour/test_causes.py
def test_the_drifting_animal_is_found_out() -> None:
    trials = read_trials(FOLDER / "trouble_drift.csv")
    fit = fit_weber(trials, effects=[Drift()])
    low, high = fit.interval(0.995, parameter="drift")
    assert low < CHOICES[NAMES.index("trouble_drift")]["truth"]["drift"] < high < 0
    # Without the effect checks see a misfit, both of its causes are found, and k stays.
    plain = fit_weber(trials)
    assert plain.unweighed is FitStatus.MISFIT_STREAKS
    assert plain.search.chosen is not None
    assert plain.search.chosen.name == "drift + bias_drift"
    assert not plain.search.matters


@pytest.mark.parametrize("entry", PACKAGE["resources"], ids=lambda entry: entry["name"])
def test_the_schema_is_the_tables(entry: dict) -> None:
    header = (FOLDER / entry["path"]).read_text("utf-8").splitlines()[0]
    fields = entry["schema"]["fields"]
    assert header.split(",") == [field["name"] for field in fields]
    for field in fields if entry in CHOICES else ():
        stimulus = field["name"] in ("standard", "stimulus_1", "stimulus_2")
        assert ("unit" in field) == stimulus
        assert (field["type"] == "number") == stimulus


def test_missing_answers_are_counted() -> None:
    trials = read_trials(FOLDER / "weights_three_standards.csv")
    assert trials.n_missing > 0
    assert trials.n_trials + trials.n_missing == len(trials) == 810
    assert str(trials.n_missing) in trials.notes[0]
