"""The synthetic data are what their generator makes, and their truth is found in them."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path
from types import ModuleType

import pytest

from weberwhisk.behaviour import fit_weber, read_trials

ROOT = Path(__file__).parent.parent
FOLDER = ROOT / "data_synthetic"
PACKAGE = json.loads((FOLDER / "datapackage.json").read_text("utf-8"))
NAMES = [entry["name"] for entry in PACKAGE["resources"]]


def generator() -> ModuleType:
    spec = importlib.util.spec_from_file_location(
        "make_synthetic", ROOT / "analyses" / "make_synthetic.py"
    )
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_regenerating_gives_the_same_bytes(tmp_path: Path) -> None:
    generator().write(tmp_path)
    made = sorted(path.name for path in tmp_path.iterdir())
    kept = sorted(path.name for path in FOLDER.iterdir() if path.suffix in (".csv", ".json"))
    assert made == kept
    for name in made:
        assert (tmp_path / name).read_bytes() == (FOLDER / name).read_bytes(), name


@pytest.mark.parametrize("entry", PACKAGE["resources"], ids=NAMES)
def test_the_truth_is_inside_the_interval(entry: dict) -> None:
    truth = entry["truth"]
    trials = read_trials(FOLDER / entry["path"], task=truth["task"])
    fit = fit_weber(trials)
    assert fit.status.ok
    for name in ("weber_fraction", "lapse_low", "lapse_high", "bias"):
        if name in truth and name in fit.parameters:
            low, high = fit.interval(0.95, parameter=name)
            assert low < truth[name] < high, name


@pytest.mark.parametrize("entry", PACKAGE["resources"], ids=NAMES)
def test_the_schema_is_the_tables(entry: dict) -> None:
    header = (FOLDER / entry["path"]).read_text("utf-8").splitlines()[0]
    assert header.split(",") == [field["name"] for field in entry["schema"]["fields"]]


def test_missing_answers_are_counted() -> None:
    trials = read_trials(FOLDER / "weights_three_standards.csv")
    assert trials.n_missing > 0
    assert trials.n_trials + trials.n_missing == len(trials) == 810
    assert str(trials.n_missing) in trials.notes[0]
