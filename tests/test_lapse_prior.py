"""What no belief about lapses can do: `analyses/lapse_prior.py`, a grid written for itself."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from analysis_scripts import load

from weberwhisk.behaviour import fit_weber, read_trials

script = load("lapse_prior")


def fitted(k: float, count: np.ndarray) -> float:
    frame = pd.DataFrame(
        {"standard": 1.0, "comparison": 1 + script.offsets(k), "n": 33, "n_greater": count}
    )
    return fit_weber(read_trials(frame)).weber_fraction


@pytest.mark.parametrize("k", [0.1, 0.4])
def test_the_plain_grid_gives_what_the_fit_gives(k: float) -> None:
    count = script.counts(k, 4, seed=1)
    table = script.likelihood(k, np.concatenate(count))
    shipped = next(iter(script.priors().values()))
    found = script.judge(k, table, shipped)
    fits = np.array([[fitted(k, row) for row in rate] for rate in count])
    # Nodes of 0.1 in ln k, and two dozen for each lapse.
    np.testing.assert_allclose(found.bias, 100 * (np.median(fits, axis=1) / k - 1), atol=1.5)
    np.testing.assert_allclose(
        found.rmse, np.sqrt(np.mean((fits / k - 1) ** 2, axis=1)), rtol=0.05, atol=0.01
    )


def worst(sets: int, fractions: tuple[float, ...]) -> dict[str, tuple[float, float]]:
    """Largest bias and lowest coverage of each belief."""
    out: dict[str, list[tuple[float, float]]] = {}
    for k in fractions:
        table = script.likelihood(k, np.concatenate(script.counts(k, sets)))
        for name, by_rate in script.priors().items():
            found = script.judge(k, table, by_rate)
            out.setdefault(name, []).append((abs(found.bias).max(), found.covers.min()))
    return {name: (max(b for b, _ in v), min(c for _, c in v)) for name, v in out.items()}


def test_not_knowing_the_lapses_costs_more_than_six_per_cent() -> None:
    """Of 100 sets a median has a standard error of some 3 % where lapses are 0.1."""
    found = worst(100, (0.05,))
    known = found.pop("told what it is")
    assert known[0] < 6
    for name, (bias, _) in found.items():
        assert bias > 10, name


@pytest.mark.slow
def test_not_knowing_the_lapses_costs_more_than_six_per_cent_in_full() -> None:
    found = worst(500, script.FRACTIONS)
    known = found.pop("told what it is")
    assert known[0] < 9  # the belief about k pulls where lapses of 0.1 leave little to see
    assert known[1] > 90
    for name, (bias, _) in found.items():
        assert bias > 10, name
