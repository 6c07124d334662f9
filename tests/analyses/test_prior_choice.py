"""The beliefs about bias and criterion: `analyses/prior_choice.py`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from analysis_scripts import load
from scipy import stats
from short_forms import slow_but

from weberwhisk import fit_weber, read_trials
from weberwhisk.behaviour import task_named
from weberwhisk.behaviour.prior_sensitivity import DECIDES, LAPSES_DECIDE
from weberwhisk.behaviour.priors import DEFAULTS, of_task

script = load("prior_choice")


@pytest.mark.parametrize("task", ["2AFC", "go/no-go", "same-different"])
def test_what_was_chosen_is_the_default(task: str) -> None:
    shipped = of_task(DEFAULTS, task_named(task))
    bias, lapses, factor = script.shipped(task)
    assert (shipped.words("bias"), shipped.words("lapse_low")) == (bias, lapses)
    assert shipped.words("weber_fraction") == f"lognorm({np.log(factor):.4g}, scale=0.1)"
    assert script.DECIDES == (DECIDES, LAPSES_DECIDE)


@pytest.mark.parametrize(
    ("task", "trials", "k", "place", "lapse"),
    slow_but([("2AFC", 40, 0.03, 0.2, 0.02), ("go/no-go", 200, 0.1, 5.0, 0.08),
              ("same-different", 200, 0.1, 3.0, 0.0)], (1,)),
)  # fmt: skip
def test_the_nodes_give_what_the_fit_gives(
    task: str, trials: int, k: float, place: float, lapse: float
) -> None:
    observer = script.Observer(task, trials, k, place, lapse)
    found = script.outcome(observer, 3)
    errors = found.errors[script.shipped(task)]
    for i, count in enumerate(observer.answers(3)):
        table = pd.DataFrame(
            {
                "standard": 1.0,
                "comparison": observer.levels,
                "n": observer.shown.astype(int),
                "n_greater": count.astype(int),
            }
        )
        fit = fit_weber(read_trials(table[table["n"] > 0], task=task))
        middle, low, high = np.log(fit.posterior.quantile("weber_fraction", [0.5, 0.025, 0.975]))
        sd = (high - low) / 3.92
        np.testing.assert_allclose(
            errors[:, i], np.array([middle, low, high]) - np.log(k), atol=0.1 * sd
        )
        moved = fit.prior_sensitivity.loc[[fit.model.task.bias_name, "lapses", "weber_fraction"]]
        theirs = moved["sds"].to_numpy(float)
        np.testing.assert_allclose(found.moves[:, :, i].max(axis=1), theirs, atol=0.1)


@pytest.mark.slow
def test_short_form(tmp_path: Path) -> None:
    text = script.report(2, lambda o: o.k == 0.1 and o.trials == 40 and o.lapse in (0.0, 0.2))
    assert "cauchy(0, 0.7)" in text
    assert stats.cauchy(0, 0.7).ppf(0.75) == pytest.approx(0.7)
