"""Fits with long tails, and animals of two states, beside plain sums."""

from __future__ import annotations

import sys
from typing import Any

import pandas as pd
import pytest
from analysis_scripts import FOLDER, load


@pytest.fixture
def tails(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.setattr(sys, "path", [str(FOLDER / "accuracy"), *sys.path])
    return load("accuracy/tails")


@pytest.mark.parametrize("index", [7, 13])
def test_a_criterion_that_follows_the_weber_fraction_ends_where_its_sum_does(
    tails: Any, index: int
) -> None:
    """Its marginal was a sum of conditionals at nodes of k, narrower than those are apart, on even
    points of a tail of 1000 sds: quartiles were off by 0.14 sd, ends by 0.29."""
    row = tails.judged(index, 20261129)
    assert row["kind"] == "same-different"
    assert row["moments"] < 1e-2
    assert row["ends"] < 2e-2


@pytest.mark.slow
def test_a_search_of_tails_finds_nothing_wrong_in_silence(tails: Any, search_seed: int) -> None:
    rows = pd.DataFrame([tails.judged(index, search_seed) for index in range(60)])
    sure = rows[(rows["left"] < tails.SURE) & (rows["status"] == "CONVERGED")]
    assert len(sure) > 40
    assert sure[sure["bar"] > 1].empty, sure[sure["bar"] > 1].to_string()


def test_the_kept_table_has_nothing_wrong_in_silence(tails: Any) -> None:
    rows = pd.read_csv(tails.TABLE)
    of_kind = load("accuracy/edges").summary(rows).set_index("kind")
    assert (of_kind.loc[list(tails.KINDS), "readings"] >= 15).all()
    assert of_kind.loc["all", "silently wrong"] == 0
    assert of_kind.loc["all", "at an edge"] >= 0.25 * of_kind.loc["all", "readings"]
