"""Priors that end inside the domain, tips that rub and the fold, beside plain sums."""

from __future__ import annotations

import sys
from typing import Any

import pandas as pd
import pytest
from analysis_scripts import FOLDER, load
from short_forms import slow_but


@pytest.fixture
def edges(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.setattr(sys, "path", [str(FOLDER / "accuracy"), *sys.path])
    script = load("accuracy/edges")
    monkeypatch.setattr(script, "LINES", (500, 100))
    return script


@pytest.mark.parametrize("index", slow_but(range(4), (0, 3)))
def test_a_reading_of_each_kind_is_that_of_its_sum(edges: Any, index: int) -> None:
    row = edges.judged(index, 20261128)
    assert row["kind"] == edges.KINDS[index]
    assert row["moments"] < 2e-3
    assert row["ends"] < 2e-2


@pytest.mark.slow
def test_a_search_at_edges_finds_nothing_wrong_in_silence(edges: Any, search_seed: int) -> None:
    rows = pd.DataFrame([edges.judged(index, search_seed) for index in range(60)])
    sure = rows[(rows["left"] < edges.SURE) & (rows["status"] == "CONVERGED")]
    assert len(sure) > 20
    assert sure[sure["bar"] > 1].empty, sure[sure["bar"] > 1].to_string()


def test_the_kept_table_has_nothing_wrong_in_silence(edges: Any) -> None:
    rows = pd.read_csv(edges.TABLE)
    assert len(rows) >= 600
    of_kind = edges.summary(rows).set_index("kind")
    assert of_kind.loc["all", "silently wrong"] == 0
    assert of_kind.loc["all", "at an edge"] >= 0.25 * of_kind.loc["all", "readings"]
