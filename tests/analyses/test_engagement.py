"""The study of animals that are engaged part of the time, in short."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import numpy as np
import pandas as pd
import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def study() -> ModuleType:
    path = ROOT / "analyses" / "choices" / "engagement.py"
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("kind", ["reset", "rates"])
@pytest.mark.slow
def test_simulated_states_last_and_are_shared(study: ModuleType, kind: str) -> None:
    rng = np.random.default_rng(1)
    shares = [np.mean(study.states_of(kind, 1000, rng) == 0) for _ in range(60)]
    # Engaged in half to all trials, as many in each part.
    assert 0.7 < np.mean(shares) < 0.8
    assert np.mean(np.diff(study.states_of(kind, 5000, rng)) != 0) < 0.1


@pytest.mark.parametrize("sets", [2, pytest.param(30, marks=pytest.mark.slow)])
def test_states_hold_what_one_state_misses(study: ModuleType, sets: int) -> None:
    table = pd.DataFrame([study.row("reset", 300, seed) for seed in range(sets)])
    held = table["states_lower"].lt(study.K) & table["states_upper"].gt(study.K)
    assert held.mean() >= 0.9
    line = study.summary(table)[0]
    assert len(line) == len(study.HEADS)
