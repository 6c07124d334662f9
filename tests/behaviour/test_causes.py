"""Causes of a misfit: the right one first, what it does to k, and advice that ends well."""

from __future__ import annotations

import json
import pickle
import re
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from short_forms import slow_but

import weberwhisk as ww
from weberwhisk import cli
from weberwhisk.behaviour import (
    FitStatus,
    States,
    Trials,
    WeberFit,
    fit_weber,
    read_trials,
    simulate_trials,
    weber_law_test,
)
from weberwhisk.behaviour import effects as of
from weberwhisk.behaviour.causes import TRIED, WHOLE, possible_causes, with_causes
from weberwhisk.commands import as_options

DATA = Path(__file__).parents[1] / "data"
DESIGN: dict[str, Any] = {
    "standards": [1.0, 1.5, 2.25], "order": "random", "sessions": 6, "weber_fraction": 0.15,
    "offsets": [-0.35, -0.25, -0.15, -0.05, 0.05, 0.15, 0.25, 0.35], "lapse_low": 0.02,
    "lapse_high": 0.02, "trials_per_level": 60,
}  # fmt: skip


def observed(*effects: tuple[of.Effect, float], seed: int = 1, **more: Any) -> Trials:
    return simulate_trials(**DESIGN | more, effects=effects, seed=seed)


CASES: dict[str, tuple[of.Effect, float]] = {
    "contraction": (of.Contraction(), 0.4),
    "exponent": (of.Exponent(), 2.2),
    "standard_second": (of.StandardSecond(), 0.8),
    "history": (of.History(), 0.6),
    "session_bias": (of.SessionBias(), 0.7),
    "drift": (of.Drift(), -1.5),
}


@pytest.mark.parametrize("name", slow_but(CASES, (3,)))
@pytest.mark.slow  # of a cause found: the cases below
def test_the_cause_that_made_the_answers_is_first(name: str) -> None:
    trials = observed(CASES[name], trials_per_level=30)
    fit = fit_weber(trials)
    assert fit.unweighed.is_misfit
    table = fit.causes
    assert table.index[0].split(" + ")[0] == name
    assert table["log_evidence"].is_monotonic_decreasing
    best = table.iloc[0]
    assert best["log_bayes_factor"] > np.log(10)
    assert best["status"] == "DETERMINED"
    assert (table["status"] == "")[table["log_bayes_factor"] < 2].all()
    # The row is the fit with the effect, and what it says of k.
    again = fit_weber(trials, effects=[CASES[name][0]])
    if table.index[0] == name:
        assert best["log_evidence"] == pytest.approx(again.log_evidence, abs=0.05)
        assert best["weber_fraction"] == pytest.approx(again.weber_fraction, rel=0.01)
        change = np.log(again.weber_fraction / fit.weber_fraction)
        sd = np.log(fit.posterior.draws().weber_fraction).std()
        assert best["change"] == pytest.approx(change / sd, abs=0.1)
    assert fit.status.is_misfit == fit.search.matters
    words = next(c.words for c in possible_causes(fit) if c.name == name)
    assert f"The answers show {words} ({name} " in fit.report()


@pytest.mark.slow  # of constant noise: `test_comparison.py`
def test_constant_noise_is_a_cause_of_its_own() -> None:
    fit = fit_weber(observed(noise="constant", trials_per_level=60))
    assert fit.causes.index[0] == "constant noise"
    constant = fit_weber(fit.trials, noise="constant")
    best = fit.causes.iloc[0]
    assert best["log_evidence"] == pytest.approx(constant.log_evidence, abs=0.01)
    assert best["weber_fraction"] == pytest.approx(constant.weber_fraction, rel=1e-3)
    names = [cause.name for cause in possible_causes(constant)]
    assert {"constant noise", "exponent", "floor"}.isdisjoint(names)


def test_two_causes_are_found_together() -> None:
    both = (of.Contraction(), 0.4), (of.SessionBias(), 0.7)
    trials = observed(*both, standards=[1.0, 2.25], trials_per_level=20)
    fit = fit_weber(trials)
    chosen = fit.search.chosen
    assert {cause.name for cause in chosen.causes} == {"contraction", "session_bias"}
    alone = [one.log_evidence for one in fit.search.tried if len(one.causes) == 1]
    assert chosen.log_evidence > max(alone) + np.log(10)


def biased_sessions() -> Trials:
    """At one standard, so that there are few causes to try."""
    return observed((of.SessionBias(), 1.2), standards=[1.0], trials_per_level=40)


@pytest.fixture(scope="module")
def moved() -> WeberFit:
    return fit_weber(biased_sessions())


@pytest.fixture(scope="module")
def contracted() -> WeberFit:
    return fit_weber(read_trials(DATA / "contraction_standard.csv"))


def test_a_cause_that_moves_k_is_the_status_and_one_that_does_not_a_remark(
    moved: WeberFit, contracted: WeberFit
) -> None:
    assert moved.status is FitStatus.MISFIT_DRIFT
    assert abs(moved.causes["change"].iloc[0]) > 1
    k = moved.search.chosen.fit.weber_fraction
    assert f"with it k is {k:.3f}" in moved.report()
    assert f"in place of {moved.weber_fraction:.3g}" in moved.report()
    assert "with session_bias k = " in repr(moved)
    assert pickle.loads(pickle.dumps(moved)).causes.equals(moved.causes)
    assert moved.to_dict()["causes"][0]["cause"] == "session_bias"
    assert contracted.causes.index[0] == "contraction"
    assert not contracted.status.is_misfit
    assert "which moves k by less than its sd" in contracted.report()
    assert "MISFIT" not in repr(contracted)


def test_the_cause_of_a_known_case_is_its_own(contracted: WeberFit) -> None:
    """Contraction of 900 choices at standards that are always first: 27.5 nats over one bias, and
    2 nats over a bias per standard, which has a parameter a standard."""
    table = contracted.causes
    assert table.loc["contraction", "log_bayes_factor"] > table["log_bayes_factor"].iloc[1]
    assert table.loc["contraction", "log_bayes_factor"] == pytest.approx(27.5, abs=0.2)
    assert table.loc["contraction", "weber_fraction"] == pytest.approx(0.202, abs=0.003)


def test_a_contracting_observer_is_not_said_to_break_the_law(contracted: WeberFit) -> None:
    """One bias for all standards made the evidence decisive against the law here."""
    test = weber_law_test(contracted)
    assert test.log_bayes_factor > 0
    low, high = test.rivals.loc["exponent", ["lower", "upper"]]
    assert low < 1 < high
    assert "would have shown" in test.report()


def advised(report: str) -> list[str]:
    return re.findall(r"fit_weber\((?:[^()]|\([^()]*\))*\)", report)


def check_advice(fit: WeberFit) -> None:
    """The fit that is advised holds."""
    assert fit.status.is_misfit
    (line,) = advised(fit.report())
    known = {**vars(of), "fit_weber": fit_weber, "trials": fit.trials}
    better = eval(line, known)
    assert better.log_evidence > fit.log_evidence + np.log(10)
    assert not better.unweighed.is_misfit
    assert "first --" in as_options(fit.report())


def test_the_fit_that_is_advised_holds(moved: WeberFit) -> None:
    check_advice(moved)


@pytest.mark.slow
@pytest.mark.parametrize(
    "given",
    [
        {"effects": [(of.SessionBias(), 1.2)]},
        {"effects": [(of.Drift(), -2.5)]},
        {
            "states": States(engaged=0.5),
            "order": "standard first",
        },
        {"bias": [1.5, 0.0, -1.5], "order": "standard first"},
    ],
)
def test_the_fit_that_is_advised_holds_of_other_causes(given: dict[str, Any]) -> None:
    check_advice(fit_weber(simulate_trials(**DESIGN | given, seed=3)))


@pytest.mark.parametrize("seed", slow_but(range(4), (0,)))
@pytest.mark.slow  # of a sound fit: `test_criticism.py`
def test_a_plain_observer_has_no_cause(seed: int) -> None:
    fit = fit_weber(observed(seed=seed, trials_per_level=20))
    assert fit.search.chosen is None or not fit.unweighed.is_misfit
    assert fit.status is FitStatus.DETERMINED
    assert fit.to_dict()["causes"] == []


def test_causes_are_those_that_a_table_can_show() -> None:
    plain = simulate_trials(trials_per_level=10, seed=1)
    names = [cause.name for cause in possible_causes(fit_weber(plain))]
    assert {"contraction", "standard_second", "drift", "session_bias"}.isdisjoint(names)
    assert {"exponent", "history", "win_stay", "states=3"} <= {*names}
    counts = plain.frame.groupby(["stimulus_1", "stimulus_2"], as_index=False)["count"].agg(
        ["sum", "size"]
    )
    counts = counts.rename(columns={"sum": "n_greater", "size": "n"})
    names = [cause.name for cause in possible_causes(fit_weber(read_trials(counts)))]
    assert {"history", "states=3", "bias_drift"}.isdisjoint(names)
    scattered = fit_weber(plain, effects=[of.Overdispersion()])
    assert "states=3" not in [cause.name for cause in possible_causes(scattered)]
    assert "overdispersion" not in [cause.name for cause in possible_causes(scattered)]


@pytest.mark.parametrize("every", slow_but([8, 1], (0,)))
def test_a_quick_fit_has_the_evidence_of_a_whole_one(every: int) -> None:
    fit = fit_weber(observed(trials_per_level=10))
    for cause in possible_causes(fit)[::every]:
        quick, whole = (with_causes(fit, [cause], draws) for draws in (TRIED, WHOLE))
        assert quick.log_evidence == pytest.approx(whole.log_evidence, abs=0.25)
        off = np.log(quick.weber_fraction / whole.weber_fraction)
        assert abs(off) < 0.2 * np.log(whole.posterior.draws().weber_fraction).std()


def test_causes_come_along(
    moved: WeberFit,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    trials = biased_sessions()
    monkeypatch.setattr(ww, "fit_weber", lambda *given, **more: moved)
    path = tmp_path / "table.csv"
    trials.to_csv(path)
    command = ["fit", str(path), "--out", str(tmp_path / "out"), "--json"]
    assert cli.run_app(cli.app, command) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["causes"][0]["cause"] == "session_bias"
    written = pd.read_csv(tmp_path / "out" / "causes.csv")
    assert written["cause"].iloc[0] == "session_bias"
