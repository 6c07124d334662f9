"""Plans of any magnitude: its unit and its words, in lists, text, figures and analyses."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from figure_checks import faults
from short_forms import slow_but

import weberwhisk as ww
from weberwhisk import plots
from weberwhisk._util.values import interval_text
from weberwhisk.behaviour import IdentityEncoding
from weberwhisk.behaviour.simulate import simulate_responses
from weberwhisk.cli import app, run_app
from weberwhisk.commands.plans import rig_trials
from weberwhisk.design import Goal, Hypothesis, Precision, Scheme, SubjectPopulation
from weberwhisk.design.magnitude import DISTANCE, Magnitude, magnitude_named
from weberwhisk.design.plan import sha256_of
from weberwhisk.design.plan_file import plan_of, preregistration

#: What no plan of another magnitude has a word of.
WHISKERS = re.compile(r"millimet|\bmm\b|_mm\b|whisker(?!\w)|distance|farther|nearer|\bpole", re.I)
NAMED = re.compile(r"weberwhisk", re.I)


def strange(text: str) -> list[str]:
    """Words of whiskers in a text; the package's own name is none."""
    return WHISKERS.findall(NAMED.sub("", text))


PLANS = {
    "duration": ["--unit", "ms", "--standards", "300,600,1200", "--people", "2"],
    "weight": ["--standards", "100,200", "--animals", "2"],
    "sound level": ["--unit", "dB", "--standards", "40,60", "--people", "1"],
    "frequency": ["--standards", "500,2000", "--task", "yes/no", "--people", "1"],
    "number of dots": ["--standards", "20,80", "--task", "go/no-go", "--animals", "1"],
}


@pytest.fixture(scope="module", params=slow_but(PLANS, (2,)))
def planned(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a plan of each, made on the command line."""
    out = tmp_path_factory.mktemp("plan") / "out"
    command = ["design", "--magnitude", request.param, *PLANS[request.param]]
    rest = ["--question", "precision", "--trials", "12", "--runs", "8", "--workers", "1"]
    assert run_app(app, [*command, *rest, "--out", str(out)]) == 0
    return out


def test_a_plan_has_no_word_of_whiskers(planned: Path) -> None:
    for path in sorted(planned.iterdir()):
        if path.suffix in (".txt", ".csv", ".html"):
            text = path.read_text("utf-8")
            text = re.sub(r'src="data:[^"]*"', "", text)
            assert not strange(text), (path.name, strange(text))
    inputs = json.loads((planned / "design.run.json").read_text("utf-8"))["inputs"]
    magnitude = magnitude_named(inputs["magnitude"], inputs["unit"])
    text = " ".join((planned / "preregistration.txt").read_text("utf-8").split())
    assert magnitude.greater in text
    assert "people" in text or "person" in text or inputs["animals"]
    assert f" {magnitude.unit} against " in text or not magnitude.unit


@pytest.mark.parametrize("planned", slow_but(PLANS, (2,)), indirect=True)
def test_its_figures_can_be_read(planned: Path) -> None:
    plan = ww.read_plan(planned / "plan.json")
    for axes in (plots.planned_jnds(plan), plots.planned_psychometrics(plan),
                 plots.power_curve(plan)):  # fmt: skip
        figure = plots.style.figure_of(axes)
        assert faults(figure) == []
        texts = figure.findobj(lambda artist: hasattr(artist, "get_text"))
        shown = " ".join(text.get_text() for text in texts)
        assert not strange(shown)
        assert "e+0" not in shown


@pytest.mark.usefixtures("few_draws")
@pytest.mark.parametrize("planned", slow_but(PLANS, (2,)), indirect=True)
def test_its_answers_are_analysed_in_its_unit(planned: Path, tmp_path: Path, capsys) -> None:
    """As a keyboard and as a table of choices has them."""
    plan = ww.read_plan(planned / "plan.json")
    of, hypothesis = plan.magnitude, plan.hypotheses[0]
    subjects = plan.animals.draw(plan.scheme.animals, 1)
    subjects["bias"] += hypothesis.usual_bias
    named = {of.column(n): n for n in ("standard", "stimulus_1", "stimulus_2")}
    answered = simulate_responses(
        plan.trials.rename(columns=named), subjects, encoding=hypothesis.encoding,
        task=hypothesis.task, seed=2,
    )  # fmt: skip
    count = answered.frame["count"].astype(int).to_numpy()
    pd.read_csv(planned / "trials.csv").assign(choice=count).to_csv(
        tmp_path / "choice.csv", index=False
    )
    capsys.readouterr()
    command = ["analyse", str(planned / "plan.json")]
    assert run_app(app, [*command, str(tmp_path / "choice.csv"), "--out", str(tmp_path / "a")]) == 0
    said = capsys.readouterr().out
    assert not strange(said)
    for path in (tmp_path / "a").glob("*.txt"):
        assert not strange(path.read_text("utf-8")), path.name
    keys, at = [], 0
    for path in sorted(planned.glob("psychopy_*.csv")):
        table = pd.read_csv(path, keep_default_na=False)
        right = table["correct_answer"].to_numpy()
        no, yes = (right[table["greater"] == g][0] for g in (1, 2))
        here = count[at : at + len(table)]
        at += len(table)
        keys.append(table.assign(**{"key_resp.keys": np.where(here == 1, yes, no)}))
    pd.concat(keys).to_csv(tmp_path / "keys.csv", index=False)
    assert run_app(app, [*command, str(tmp_path / "keys.csv")]) == 0
    again = capsys.readouterr().out
    of_choice, of_keys = (text.partition("The same numbers again")[0] for text in (said, again))
    assert of_keys.replace("keys.csv", "choice.csv") == of_choice


def test_a_plan_of_weights_from_python() -> None:
    """They were "100000 mm" of "radial distance"."""
    plan = ww.plan_experiment(
        hypotheses=[Hypothesis("Weber", IdentityEncoding())], standards=[100.0, 200.0],
        goal=Precision(0.2), trials=8, runs=0, expected=SubjectPopulation(weber_fraction=0.08),
    )  # fmt: skip
    assert {"standard", "stimulus_1", "stimulus_2"} <= {*plan.trials}
    assert set(plan.trials["standard"]) == {100.0, 200.0}
    text = preregistration(plan)
    assert not strange(text)
    assert "100 against" in text
    of_weights = ww.plan_experiment(magnitude="weight", standards=[100, 200], trials=8, runs=0,
                                    goal=Precision(0.2), people=3)  # fmt: skip
    assert set(of_weights.trials["standard_g"]) == {100.0, 200.0}
    assert "which of two weights is the heavier" in preregistration(of_weights)
    assert "3 people" in preregistration(of_weights)


@pytest.mark.parametrize("question", ["precision", "weber-law"])
def test_a_magnitude_comes_back_with_its_plan(question: str) -> None:
    of = Magnitude("loudness", "sone²/s", "louder", "softer", step=0.5)
    goal: Goal | None = Precision(0.3) if question == "precision" else None
    plan = ww.plan_experiment(magnitude=of, question=question, goal=goal, standards=[10, 40],
                              trials=8, runs=0)  # fmt: skip
    again = plan_of(ww.design.plan_json(plan))
    assert again.magnitude == of
    assert again.magnitude.column("standard") == "standard_sone2_per_s"
    assert again.fingerprint == plan.fingerprint


def test_a_plan_of_version_2_is_of_distances() -> None:
    plan = ww.plan_experiment("C2", standards=[10e-3, 20e-3], trials=6, runs=0)
    record = json.loads(ww.design.plan_json(plan))
    record["version"] = 2
    record["trials_sha256"] = sha256_of(plan.trials)  # of lists without `standard_is`
    del record["plan"]["scheme"]["magnitude"], record["plan"]["animals"]["subject"]
    again = plan_of(json.dumps(record))
    assert again.magnitude == DISTANCE
    assert again.animals.counted(2) == "2 animals"


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (["--magnitude", "duration"], "durations that are compared with are needed, got none; "
         "write --standards 300,600,1200, say."),
        (["--unit", "ms"], "--unit is of a --magnitude"),
        (["--standards", "3"], "--standards are those of a --magnitude"),
        (["--magnitude", "duration", "--identity", "C2"], "durations or of distances along"),
        (["--magnitude", "radial distance"], "encoded through a whisker"),
        (["--magnitude", "weight", "--standards", "-5,10"], "outside what can be encoded"),
        (["--magnitude", "weight", "--standards", "5,10", "--words", "heavy"], "takes two words"),
        (["--magnitude", "weight", "--standards", "5,10", "--greatest", "10"],
         "heavier than the range of 0 g to 10 g"),
        (["--magnitude", "weight", "--standards", "5,10", "--question", "whiskers"],
         "write --question weber-law"),
        (["--magnitude", "weight", "--standards", "5,10", "--people", "2", "--animals", "2"],
         "animals or people"),
        (["--magnitude", "number", "--standards", "3,10"], "steps of 1 are too coarse"),
    ],
)  # fmt: skip
def test_what_is_no_plan_of_a_magnitude_is_refused(
    options: list[str], sentence: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_app(app, ["design", *options, "--runs", "0", "--trials", "10"]) == 2
    said = capsys.readouterr().err
    assert sentence in said
    assert said.count("\n") == 1


def test_a_scheme_and_a_hypothesis_are_of_one_magnitude() -> None:
    with pytest.raises(ValueError, match="encodes another magnitude"):
        ww.design.Plan(Scheme([1.0], [-0.2, 0.2]), [Hypothesis("a", IdentityEncoding())],
                       Precision(0.2))  # fmt: skip


@pytest.mark.parametrize("rival", slow_but(["constant", "exponent:0.5", "floor:30"], (1,)))
def test_a_rival_of_webers_law_is_planned_by_name(rival: str) -> None:
    """It comes back with its plan, and its noise is what its name says."""
    plan = ww.plan_experiment(magnitude="duration", standards=[300, 1200], rival=rival, trials=12,
                              runs=0, people=1)  # fmt: skip
    weber, other = plan_of(ww.design.plan_json(plan)).hypotheses
    assert weber.name == "Weber's law"
    unit = other.model(plan.scheme).encodings.encoded(0.1)
    t = plan.scheme.cells().stimulus_2
    expected = {
        "constant": np.full(t.size, 60.0), "exponent:0.5": 60 * np.sqrt(t / 600),
        "floor:30": np.hypot(0.1 * t, 30),
    }[rival]  # fmt: skip
    np.testing.assert_allclose(unit.sd_2, expected)
    text = preregistration(plan)
    assert other.name in text
    assert not strange(text)
    assert faults(plots.style.figure_of(plots.planned_jnds(plan))) == []


@pytest.mark.parametrize(
    ("rival", "sentence"),
    [("linear", "rival 'linear' is unknown"), ("exponent:1", "exponent of 1 is Weber's law"),
     ("floor:x", "number of the rival 'floor' cannot be read"), ("floor:-1", "must be above zero"),
     ("constant:3", "constant noise has no number")],
)  # fmt: skip
def test_no_rival_is_refused(rival: str, sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        ww.plan_experiment(magnitude="weight", standards=[100, 200], rival=rival, runs=0, trials=8)


# -- what was run, beside what was planned --------------------------------------------------------


def answered(plan: ww.design.Plan, folder: Path, rows: slice = slice(None)) -> Path:
    """A table of answers to a plan's lists, or to a part of them."""
    subjects = plan.animals.draw(plan.scheme.animals, 1)
    named = {plan.magnitude.column(n): n for n in ("standard", "stimulus_1", "stimulus_2")}
    trials = simulate_responses(
        plan.trials.rename(columns=named), subjects, encoding=plan.hypotheses[0].encoding, seed=2
    )
    table = plan.trials.assign(choice=trials.frame["count"].astype(int).to_numpy())
    table[rows].to_csv(folder / "data.csv", index=False)
    return folder / "data.csv"


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, ww.design.Plan]:
    """144 trials on two standards."""
    plan = ww.plan_experiment(magnitude="duration", standards=[300, 600], trials=12, runs=0,
                              goal=Precision(0.2), people=1)  # fmt: skip
    folder = ww.write_plan(plan, tmp_path_factory.mktemp("small") / "plan")
    return folder / "plan.json", plan


@pytest.mark.usefixtures("few_draws")
@pytest.mark.slow  # missing: also in the test after
def test_trials_that_are_missing_are_said(
    small: tuple[Path, ww.design.Plan], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, plan = small
    for rows, missing in ((slice(None), 0), (slice(90), 54)):
        data = answered(plan, tmp_path, rows)
        assert run_app(app, ["analyse", str(file), str(data)]) == 0
        said = capsys.readouterr().out
        assert ("not the preregistered verdict" in said) == (missing > 0)
        assert (f"{missing} planned trials are missing." in said) == (missing > 0)
        if not missing:
            continue
        assert run_app(app, ["analyse", str(file), str(data), "--json"]) == 0
        answer = json.loads(capsys.readouterr().out)
        assert (answer["missing"], answer["not_planned"]) == (missing, 0)
        assert not answer["as_planned"]


def test_the_analysis_has_equality_and_jnd_in_the_unit_and_leaves_trials_out(
    small: tuple[Path, ww.design.Plan], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, plan = small
    data = answered(plan, tmp_path, slice(None))
    table = pd.read_csv(data)
    table.assign(phase=np.where(table.index < 30, "practice", "test")).to_csv(data, index=False)
    assert run_app(app, ["analyse", str(file), str(data), "--without", "phase=practice"]) == 0
    said = capsys.readouterr().out
    assert "30 planned trials are missing." in said
    trials = rig_trials([data], plan).without(phase="practice")
    fit = plan.analyse(trials).fits[0]
    rows = zip(fit.subjective_equality().itertuples(), fit.threshold().itertuples(), strict=True)
    for equal, at in rows:
        pse = interval_text(equal.comparison, equal.lower, equal.upper, " ms")
        s = at.standard
        jnd = interval_text(at.comparison - s, at.lower - s, at.upper - s, " ms")
        assert f"From standard {s:.4g} ms: PSE {pse}; JND {jnd}." in said
    assert 'PSE, the point of subjective equality: 50 % "second longer"' in said


@pytest.mark.usefixtures("few_draws")
def test_next_analyse_and_fit_agree_on_one_session(
    small: tuple[Path, ww.design.Plan],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """They gave 0.076, 0.079 and 0.0915: each now names the command that repeats its number."""
    log = tmp_path / "p1.jsonl"
    rng = np.random.default_rng(3)
    monkeypatch.setattr("sys.stdin", iter(f"{int(u > 0.4)}\n" for u in rng.random(28)))
    command = ["next", "--magnitude", "duration", "--unit", "ms", "--standards", "300,600"]
    assert run_app(app, [*command, "--most", "28", "--log", str(log)]) == 0
    first, *_, last = map(json.loads, capsys.readouterr().out.splitlines())
    assert {"standard_ms", "comparison_ms"} <= {*first}
    k = {}
    assert run_app(app, [*shlex.split(last["repeat"])[1:], "--json"]) == 0
    k["next"] = json.loads(capsys.readouterr().out)["weber_fraction"]
    assert k["next"] == pytest.approx(last["weber_fraction"], rel=0.03)
    out = tmp_path / "out"
    assert run_app(app, ["analyse", str(small[0]), str(log), "--out", str(out)]) == 0
    said = capsys.readouterr().out
    assert "28 trials were not planned" in said
    again = next(line for line in said.splitlines() if "weberwhisk fit" in line)
    again = again[again.index("weberwhisk fit") :]
    assert run_app(app, [*shlex.split(again)[1:], "--json"]) == 0
    k["analyse"] = json.loads(capsys.readouterr().out)["weber_fraction"]
    table = pd.read_csv(out / "analysis.csv")
    assert k["analyse"] == pytest.approx(table["weber_fraction"][0], rel=1e-9)
    assert k["analyse"] == pytest.approx(k["next"], rel=1e-9)
    assert run_app(app, ["fit", str(log)]) == 0
    assert "--bias 'per standard'" in capsys.readouterr().out


# -- power, beside whole experiments --------------------------------------------------------------


@pytest.mark.slow  # rows of studies: test_rehearse.py
@pytest.mark.parametrize("runs", [12, pytest.param(200, marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    ("magnitude", "options"),
    slow_but([
        ("duration", {"standards": [300, 600, 1200], "goal": Precision(0.25), "trials": 40}),
        ("weight", {"standards": [100, 400], "rival": "exponent:0.5", "trials": 30}),
        ("sound level", {"standards": [40, 60], "conditions": ["quiet", "noise"], "animals": 3,
                         "goal": ww.design.Contrast(1.4), "trials": 24}),
    ], (0,)),
)  # fmt: skip
def test_simulated_studies_have_the_power_of_their_plan(
    magnitude: str, options: dict[str, Any], runs: int
) -> None:
    """Lists, answers and analysis against the power, within 3 standard errors."""
    plan = ww.plan_experiment(magnitude=magnitude, runs=400, find="nothing", **options)
    assert plan.power is not None
    planned = plan.power[plan.power["trials"] == options["trials"]].set_index("truth")
    table = ww.simulate_study(plan, runs, seed=2).table.set_index("truth")
    for truth, row in table.iterrows():
        p = float(planned.loc[truth, "power"])
        error = np.sqrt(max(p * (1 - p), 0.02) * (1 / 400 + 1 / runs))
        assert abs(row["power"] - p) < 3 * error, (truth, row["power"], p)
