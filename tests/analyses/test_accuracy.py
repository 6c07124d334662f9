"""Readings of `analyses/accuracy` that were wrong in silence, and one of those that never were."""

from __future__ import annotations

import csv

import pytest
from analysis_scripts import FOLDER
from short_forms import slow_but


@pytest.mark.parametrize(
    "index",
    slow_but(
        [
            1,
            105,  # a hinge: sums at each node were a hundredth as fine, 3.4e-3 sd off
            144,  # a force that turns round beside it: 1.1 % of the mass was given up early
        ],
        (0,),
    ),
)
def test_posteriors_are_those_of_sums_over_the_whole_domain(
    index: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(FOLDER / "accuracy")
    import compare

    with compare.TABLE.open(encoding="utf-8") as file:
        row = next(row for row in csv.DictReader(file) if int(row["index"]) == index)
    found = compare.compared(row)
    assert found["silent"]
    assert found["bar"] < 1
