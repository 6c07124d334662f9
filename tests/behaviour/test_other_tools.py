"""The factors of the how-to "To another tool and back", against the tools themselves.

Each tool is skipped where it is not installed: ``pip install weberwhisk[referees]``.
"""

from __future__ import annotations

import re
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray
from scipy import optimize, stats

import weberwhisk as ww

Array = NDArray[np.float64]

PAGE = Path(__file__).parents[2] / "docs" / "howto" / "other_tools.md"
STANDARD, K = 20.0, 0.1
SD = np.sqrt(2) * K * STANDARD
#: Levels within two sds of the curve, and so many trials of each that chance hardly counts.
LEVELS, MANY = STANDARD + SD * np.linspace(-2, 2, 9), 20_000


def factor(row: str, column: int = 3) -> float:
    """The factor before the standard in a row of the page's table."""
    table = PAGE.read_text("utf-8").split("## Factors")[1].splitlines()
    (line,) = (text for text in table if text.startswith(f"| {row}"))
    cell = re.split(r"(?<!\\)\|", line)[column + 1]
    numbers = re.findall(r"\d+\.?\d*", cell)
    assert numbers, cell
    return float(numbers[0])


def share(noise: str = "equal-variance", lapse: float = 0.0) -> Array:
    """The proportion of "second greater" of a known observer."""
    chance = ww.behaviour.psychometric.response_probability(
        ww.behaviour.task_named("2AFC"), ww.behaviour.IdentityEncoding(), STANDARD, LEVELS,
        weber_fraction=K, noise=noise, lapse_low=lapse, lapse_high=lapse,
    )  # fmt: skip
    return np.asarray(chance, dtype=float)


@pytest.mark.parametrize("noise", ["equal-variance", "weber"])
def test_the_sd_of_the_curve_is_that_of_two_intervals(noise: str) -> None:
    p = share(noise)

    def cost(theta: Array) -> Any:
        q = stats.norm.cdf((LEVELS - theta[0]) / np.exp(theta[1]))
        return -(p * np.log(q) + (1 - p) * np.log(1 - q)).sum()

    found = optimize.minimize(cost, [STANDARD, 0.0], method="Nelder-Mead").x
    assert np.exp(found[1]) / factor("questplus") / STANDARD == pytest.approx(K, rel=0.01)


def test_factors_are_those_of_the_normal_curve() -> None:
    z = stats.norm.ppf
    exact = {
        "psignifit": 2 * z(0.95) * np.sqrt(2), "psychofit": 2.0, "questplus": np.sqrt(2),
        "AEPsych": np.sqrt(2), "half of": np.sqrt(2) * z(0.75),
    }  # fmt: skip
    for row, value in exact.items():
        assert factor(row) == pytest.approx(value, abs=6e-4)
        assert factor(row, 4) == pytest.approx(value, abs=6e-4)
    u = np.linspace(-6, 6, 4001)
    slopes = np.linspace(1.5, 1.9, 401)
    off = [np.abs(stats.norm.cdf(u) - 1 / (1 + np.exp(-a * u))).max() for a in slopes]
    assert slopes[np.argmin(off)] == pytest.approx(1.702, abs=1.5e-3)
    assert min(off) == pytest.approx(0.0095, abs=1e-4)
    assert factor("weight", 2) == 1.702
    assert factor("weight") == pytest.approx(1.702 / np.sqrt(2), abs=6e-4)


def test_a_logistic_weight() -> None:
    p = share()

    def cost(theta: Array) -> Any:
        q = 1 / (1 + np.exp(-(theta[0] + theta[1] * (LEVELS - STANDARD))))
        return -(p * np.log(q) + (1 - p) * np.log(1 - q)).sum()

    weight = optimize.minimize(cost, [0.0, 0.5]).x[1]
    assert factor("weight") / (weight * STANDARD) == pytest.approx(K, rel=0.03)


def test_psignifit() -> None:
    psignifit = pytest.importorskip("psignifit")
    count = np.round(MANY / 40 * share(lapse=0.02))
    rows = np.column_stack([LEVELS, count, np.full(9, MANY / 40)]).astype(float)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = psignifit.psignifit(rows, experiment_type="equal asymptote")
    width = found.get_parameter_estimate()["width"] if hasattr(
        found, "get_parameter_estimate") else found.parameter_estimate["width"]  # fmt: skip
    assert width / (factor("psignifit") * STANDARD) == pytest.approx(K, rel=0.03)


def test_psychofit() -> None:
    psychofit = pytest.importorskip("psychofit")
    data = np.stack([LEVELS, np.full(9, MANY), share(lapse=0.02)])
    state = np.random.get_state()  # noqa: NPY002 (its starts are drawn from the global generator)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found, _ = psychofit.mle_fit_psycho(
            data, P_model="erf_psycho_2gammas", parstart=np.array([STANDARD, 3.0, 0.01, 0.01]),
            parmin=np.array([10.0, 0.5, 0.0, 0.0]), parmax=np.array([30.0, 20.0, 0.1, 0.1]),
        )  # fmt: skip
    np.random.set_state(state)  # noqa: NPY002
    assert found[1] / (factor("psychofit") * STANDARD) == pytest.approx(K, rel=0.01)


def test_questplus() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        questplus = pytest.importorskip("questplus")
        plan = questplus.QuestPlus(
            stim_domain={"intensity": LEVELS},
            param_domain={"mean": np.array([STANDARD]), "sd": SD * np.geomspace(0.5, 2, 61),
                          "lower_asymptote": np.array([0.0]), "lapse_rate": np.array([0.0])},
            outcome_domain={"response": ["Yes", "No"]}, func="norm_cdf", stim_scale="linear",
            stim_selection_method="min_entropy", param_estimation_method="mean",
        )  # fmt: skip
        for level, p in zip(LEVELS, share(), strict=True):
            for i in range(40):
                response = "Yes" if i < round(40 * p) else "No"
                plan.update(stim={"intensity": level}, outcome={"response": response})
        sd = plan.param_estimate["sd"]
    assert sd / (factor("questplus") * STANDARD) == pytest.approx(K, rel=0.05)


def test_a_table_goes_to_another_tool_and_back() -> None:
    trials = ww.simulate_trials(weber_fraction=K, standards=STANDARD, sessions=4, seed=1)
    cells = trials.cells()
    rows = np.column_stack([cells.stimulus_2, cells.count, cells.n])
    table = {"comparison": rows[:, 0], "n_greater": rows[:, 1], "n": rows[:, 2],
             "standard": np.full(len(rows), STANDARD)}  # fmt: skip
    back = ww.fit_weber(ww.read_trials(pd.DataFrame(table)))
    assert back.weber_fraction == pytest.approx(ww.fit_weber(trials).weber_fraction, rel=1e-6)
