"""Two conditions told apart by the ratio of their Weber fractions."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from figure_checks import faults
from scipy.stats import norm

import weberwhisk as ww
from weberwhisk import plots
from weberwhisk.cli import app, run_app
from weberwhisk.design import Contrast, Plan, Precision
from weberwhisk.design.conditions import PRIOR, STEP, log_ratio_density, quantiles_of_ratio
from weberwhisk.design.plan_file import plan_of, preregistration
from weberwhisk.design.rehearsal import one_experiment


@pytest.fixture(scope="module")
def plan() -> Plan:
    return ww.plan_experiment(
        magnitude="weight", standards=[100, 200], conditions=["saline", "drug"], animals=2,
        goal=Contrast(1.6), trials=14, runs=96, trials_per_session=100,
    )  # fmt: skip


def test_the_ratio_is_that_of_normal_posteriors() -> None:
    """Closed form: of normal likelihoods of ln k and a normal prior of its middle."""
    x = np.arange(-6.0, 2.0, STEP)
    both = np.linspace(x[0], x[-1], 2 * x.size - 1)
    at, sd = np.array([[-2.4, -2.0], [-2.1, -1.9]]), np.array([[0.1, 0.2], [0.15, 0.1]])
    log_like = norm(at[..., None], sd[..., None]).logpdf(x)[None]
    delta, log_density = log_ratio_density(log_like, norm(-2.3, 1.1).logpdf(both))
    precision, weighed = np.zeros((3, 3)), np.zeros(3)  # of δ, and the middle of each subject
    precision[0, 0] = 1.0 / PRIOR.var()
    for a in range(2):
        precision[1 + a, 1 + a] += 1 / 1.1**2
        weighed[1 + a] += -2.3 / 1.1**2
        for j, side in enumerate((-0.5, 0.5)):
            row = np.zeros(3)
            row[0], row[1 + a] = side, 1.0
            precision += np.outer(row, row) / sd[a, j] ** 2
            weighed += row * at[a, j] / sd[a, j] ** 2
    covariance = np.linalg.inv(precision)
    mean, spread = (covariance @ weighed)[0], np.sqrt(covariance[0, 0])
    expected = np.exp(mean + spread * norm.ppf([0.5, 0.025, 0.975]))
    np.testing.assert_allclose(quantiles_of_ratio(delta, log_density)[0], expected, rtol=1e-3)


def test_conditions_alternate_by_session(plan: Plan) -> None:
    of_session = plan.trials.groupby(["subject", "session"])["condition"].unique().str[0]
    assert of_session["s1"].tolist() == ["saline", "drug", "drug", "saline"]
    assert of_session["s2"].tolist() == ["drug", "saline", "saline", "drug"]
    counts = plan.trials.groupby(["subject", "condition", "level"]).size()
    assert set(counts) == {14}
    assert plan.scheme.n_trials == 2 * 12 * 14
    assert plan.sessions == 4
    assert len(plan.trials) == plan.scheme.total_trials


def test_a_plan_of_conditions_comes_back_and_says_what_it_is(plan: Plan) -> None:
    again = plan_of(ww.design.plan_json(plan))
    assert again.goal == plan.goal
    assert again.scheme == plan.scheme
    assert again.fingerprint == plan.fingerprint
    text = " ".join(preregistration(plan).split())
    assert "Is the Weber fraction k in drug another than in saline" in text
    assert "14 times to each animal in each of the conditions saline and drug" in text
    assert plan.power is not None
    assert "of their animals" not in plan.power_in_words()


@pytest.mark.usefixtures("few_draws")
def test_conditions_are_analysed_and_drawn(
    plan: Plan,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    ww.write_plan(plan, tmp_path / "plan")
    chunk: dict[str, Any] = {"truth": "Weber's law", "run": 1}
    row = one_experiment(chunk, np.random.SeedSequence(3), plan).iloc[0]
    assert row["lower"] < row["estimate"] < row["upper"]
    lists = pd.read_csv(tmp_path / "plan" / "trials.csv")
    right = (lists["greater"] == 2).astype(int)
    k = np.where(lists["condition"] == "drug", 0.25, 0.1)
    s1, s2 = lists["stimulus_1_g"], lists["stimulus_2_g"]
    p = norm.cdf((s2 - s1) / (k * np.hypot(s1, s2)))
    choice = (np.random.default_rng(1).random(len(lists)) < p).astype(int)
    lists.assign(choice=choice).to_csv(tmp_path / "data.csv", index=False)
    drawn: list[Any] = []
    draw = plots.analysed
    monkeypatch.setattr(plots, "analysed", lambda result: drawn.append(draw(result)) or drawn[0])
    command = ["analyse", str(tmp_path / "plan" / "plan.json"), str(tmp_path / "data.csv")]
    assert run_app(app, [*command, "--out", str(tmp_path / "out")]) == 0
    said = capsys.readouterr().out
    assert "The Weber fraction in drug is" in said
    assert "times that in saline; its 95 % interval" in said
    assert "--only condition=saline" in said
    table = pd.read_csv(tmp_path / "out" / "analysis.csv")
    assert table.groupby("condition").size().to_dict() == {"drug": 2, "saline": 2}
    again = ww.read_trials(pd.read_csv(tmp_path / "out" / "analysed_trials.csv"))
    assert again.n_trials == len(lists)
    assert faults(plots.style.figure_of(drawn[0])) == []
    lists.drop(columns="condition").assign(choice=right).to_csv(tmp_path / "data.csv", index=False)
    assert run_app(app, command) == 2
    assert "write in it in which each trial was run" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"conditions": ["a"]}, "two conditions are compared, by names of their own"),
        ({"conditions": ["a", "a"]}, "two conditions are compared, by names of their own"),
        ({"conditions": ["a", "b"], "goal": Precision(0.2)}, "is not answered by"),
        ({"goal": Contrast(1.3)}, "Two conditions go with a goal of their own"),
    ],
)
def test_what_is_no_comparison_of_conditions_is_refused(
    options: dict[str, Any], sentence: str
) -> None:
    with pytest.raises(ValueError, match=sentence):
        ww.plan_experiment(magnitude="weight", standards=[100, 200], trials=8, runs=0, **options)
