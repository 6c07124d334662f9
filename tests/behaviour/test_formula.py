"""Formulas of columns: what they mean, how they are scaled, and what is refused."""

from __future__ import annotations

import json
import pickle
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.special import ndtr

from weberwhisk import cli
from weberwhisk.behaviour import Trials, fit_weber, read_trials, simulate_trials
from weberwhisk.behaviour.effects import Covariate
from weberwhisk.behaviour.formula import expanded
from weberwhisk.behaviour.likelihood import build_model

K = {"none": 0.1, "air": 0.2, "lidocaine": 0.15}
BIAS = {"none": 0.0, "air": 0.0, "lidocaine": -0.6}
LAPSES = {"lapse_low": 0.0, "lapse_high": 0.0}


def table(trials: int = 1800, seed: int = 1) -> pd.DataFrame:
    """Three conditions that differ in k and bias, by hand."""
    rng = np.random.default_rng(seed)
    condition = rng.choice(sorted(K), trials)
    s2 = rng.choice([0.7, 0.85, 0.95, 1.05, 1.2, 1.4], trials)
    k, bias = (np.array([of[c] for c in condition]) for of in (K, BIAS))
    p = ndtr((s2 - 1) / (k * np.hypot(1, s2)) + bias)
    return pd.DataFrame(
        {"trial": np.arange(trials) + 1, "condition": condition, "stimulus_1": 1.0,
         "stimulus_2": s2, "choice": (rng.random(trials) < p).astype(int)}
    )  # fmt: skip


def test_each_level_has_a_parameter_of_its_own() -> None:
    trials = read_trials(table())
    fit = fit_weber(trials, effects=["k ~ condition", "bias ~ condition"], priors=LAPSES)
    levels = ["lidocaine", "none"]  # from "air"
    assert fit.effects == tuple(f"{on}:condition[{c}]" for on in ("k", "bias") for c in levels)
    for on, of in (("k", np.log(list(K.values()))), ("bias", np.array(list(BIAS.values())))):
        at = dict(zip(K, of, strict=True))
        for level in levels:
            low, high = fit.interval(0.99, f"{on}:condition[{level}]")
            assert low < at[level] - at["air"] < high
            assert high - low < 0.6
    low, high = fit.interval(0.99)
    assert low < K["air"] < high
    assert fit.checked["p"].min() > 0.005
    assert pickle.loads(pickle.dumps(fit)).effects == fit.effects
    assert "k:condition[none]" in fit.report()


def test_the_likelihood_is_the_observer_written_out() -> None:
    frame = table(300).assign(size=lambda t: np.arange(len(t)) % 7)
    trials = read_trials(frame)
    model = build_model(trials, None, None, "shared", "weber", None, ["k ~ condition * size"])[0]
    size = (frame["size"] - frame["size"].mean()) / frame["size"].std(ddof=0)
    lidocaine, none = ((frame["condition"] == c).to_numpy(float) for c in ("lidocaine", "none"))
    assert [e.name for e in model.effects] == [
        "k:condition[lidocaine]", "k:condition[none]", "k:size", "k:condition[lidocaine]:size",
        "k:condition[none]:size",
    ]  # fmt: skip
    crossed = []
    for level in (lidocaine, none):
        product = level * frame["size"]
        crossed.append((product - product.mean()) / product.std(ddof=0))
    value = np.array([0.2, -0.3, 0.1, 0.15, -0.05])
    change = np.stack([lidocaine, none, size, *crossed]).T @ value
    s2, choice = frame["stimulus_2"], frame["choice"]
    p = ndtr((s2 - 1) / (0.15 * np.exp(change) * np.hypot(1, s2)) + 0.2)
    exact = np.log(np.where(choice == 1, p, 1 - p)).sum()
    none_lost = np.zeros(1)
    one = np.array([0.15]), none_lost, none_lost, np.array([[0.2]]), value[None]
    assert model.log_likelihood(*one)[0] == pytest.approx(exact, abs=1e-8)


def test_functions_of_numpy_may_stand_in_a_formula() -> None:
    trials = read_trials(table(100).assign(size=lambda t: np.arange(len(t)) % 7 + 1))
    column = expanded(["k ~ np.log(size)"], trials)[0].column(trials, None)  # type: ignore[arg-type]
    log = np.log(trials.frame["size"])
    np.testing.assert_allclose(column, (log - log.mean()) / log.std(ddof=0), atol=1e-12)


def test_two_levels_are_a_covariate() -> None:
    trials = read_trials(table(400).assign(laser=lambda t: np.arange(len(t)) % 2))
    by_formula = fit_weber(trials, effects=["bias ~ laser"])
    by_hand = fit_weber(trials, effects=[Covariate("laser")])
    assert by_formula.log_evidence == pytest.approx(by_hand.log_evidence, abs=1e-9)
    assert by_formula.effects == ("bias:laser",)


def test_a_part_of_a_table_keeps_what_the_whole_was_read_by() -> None:
    trials = read_trials(table(400).assign(size=lambda t: np.arange(len(t)) % 7))
    terms = expanded(["k ~ condition + size"], trials)
    part = trials.select(condition="none")
    columns = [term.column(trials, None) for term in terms]  # type: ignore[arg-type]
    kept = (trials.frame["condition"] == "none").to_numpy()
    for term, column in zip(terms, columns, strict=True):
        np.testing.assert_array_equal(term.column(part, None), column[kept])  # type: ignore[arg-type]


def test_a_simulated_formula_is_found() -> None:
    trials = simulate_trials(
        sessions=6, trials_per_level=200, effects=[("k ~ session", 0.3), ("bias ~ session", -0.2)],
        seed=2,
    )  # fmt: skip
    fit = fit_weber(trials, effects=["k ~ session", "bias ~ session"], priors=LAPSES)
    for name, truth in (("k:session", 0.3), ("bias:session", -0.2)):
        low, high = fit.interval(0.99, name)
        assert low < truth < high
        assert not low < 0 < high
    with pytest.raises(ValueError, match=r"a number each.*bias:C\(session\)\[2\], bias"):
        simulate_trials(sessions=3, effects=[("bias ~ C(session)", 0.2)], seed=2)


@pytest.mark.parametrize(
    ("formula", "match"),
    [
        ("slope ~ condition", "left side of a formula.*'slope'"),
        ("k ~ conditon", "did you mean 'condition'"),
        ("k ~ condition +", "cannot be read"),
        ("k ~ f(trial)", "'f' is unknown"),
        ("k ~ 0 + condition", "no intercept"),
        ("k ~ 1", "no column that differs"),
        ("k ~ constant", "'constant' of 'k ~ constant' is the same in all trials"),
        ("k ~ hole", "column 'hole': empty in a trial with an answer"),
    ],
)
def test_formulas_that_cannot_be_are_refused(formula: str, match: str) -> None:
    frame = table(60).assign(constant=1.0, hole=[None, *range(59)])
    with pytest.raises(ValueError, match=match):
        fit_weber(read_trials(frame), effects=[formula])


def test_a_scored_task_has_no_bias_to_move() -> None:
    scored = simulate_trials(task="2AFC percent correct", sessions=2, trials_per_level=5, seed=1)
    with pytest.raises(ValueError, match=r"no response bias.*write 'k ~ session'"):
        fit_weber(scored, effects=["bias ~ session"])
    assert fit_weber(scored, effects=["k ~ session"]).effects == ("k:session",)


def test_a_value_may_lack_where_there_is_no_answer() -> None:
    frame = table(100)
    frame["choice"] = frame["choice"].astype("Int64")
    frame.loc[3, ["choice", "condition"]] = pd.NA
    trials = read_trials(frame)
    assert isinstance(trials, Trials)
    column = expanded(["k ~ condition"], trials)[0].column(trials, None)  # type: ignore[arg-type]
    assert column.size == 100
    assert column[3] == 0


def test_on_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "table.csv"
    table(400).to_csv(path, index=False)
    command = ["fit", str(path), "--effect", "k ~ condition", "--json"]
    assert cli.run_app(cli.app, command) == 0
    answer = json.loads(capsys.readouterr().out)
    assert "k:condition[none]" in answer["parameters"]
    command = ["simulate", "--sessions", "3", "--effect", "bias ~ session:0.4", "--json"]
    assert cli.run_app(cli.app, command) == 0
    assert json.loads(capsys.readouterr().out)["truth"]["effects"] == {"bias:session": 0.4}
