"""`weberwhisk jnd`, `simulate` and `fit`: answers, files, and refusals."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from command_lines import SOFT, answer, refused, rows
from short_forms import slow_but

import weberwhisk as ww
from weberwhisk import cli
from weberwhisk.behaviour.effects import EFFECTS
from weberwhisk.behaviour.priors import belief_named
from weberwhisk.cli import run_app

pytestmark = pytest.mark.usefixtures("few_draws")


def test_jnd_gives_what_jnd_curve_gives(capsys: pytest.CaptureFixture[str]) -> None:
    scene = ["--radial-distance-mm", "10,40,60", "--draws", "20", "--seed", "4"]
    result = answer(capsys, "jnd", *SOFT, *scene)
    table = rows(result)
    assert list(table["radial_distance_mm"]) == [10, 40, 60]
    observer = ww.Observer(ww.Whisker(50e-3, 100e-6, 5e-6, 3e9), ww.cues.Compliance())
    expected = ww.jnd_curve(observer, [10e-3, 40e-3], n_readings=20, seed=1)
    for column in ("closed_form", "fisher"):
        found = table[f"{column}_mm"][:2].astype(float)
        np.testing.assert_allclose(found, expected[column] * 1e3, rtol=1e-9)
    assert table["posterior_mm"][0] == pytest.approx(expected["posterior"][0] * 1e3, rel=0.1)
    assert table["posterior_mm"][2] is None or np.isnan(table["posterior_mm"][2])
    assert table["outcome"][2].startswith("out of reach")
    assert result == answer(capsys, "jnd", *SOFT, *scene)


def test_choices_by_another_cue(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = [*SOFT, "--cue", "moment", "--deflection-angle-deg", "5"]
    out = tmp_path / "out"
    assert run_app(cli.app, ["simulate", *scene, "--standard-mm", "20", "--out", str(out)]) == 0
    capsys.readouterr()
    found = answer(capsys, "fit", str(out / "trials.csv"), *scene)
    assert found["lower"] < 0.1 < found["upper"]


def test_a_fit_that_takes_long_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A rat's 11 489 trials took two minutes without a word."""
    table = tmp_path / "few.csv"
    table.write_text("stimulus_1,stimulus_2,n,n_greater\n1,1.2,20,18\n1,0.8,20,3\n")
    for most, said in ((39, True), (40, False)):
        monkeypatch.setattr("weberwhisk.commands.choices.LONG", most)
        assert run_app(cli.app, ["fit", str(table)]) == 0
        assert ("40 trials: the checks" in capsys.readouterr().err) == said
    monkeypatch.setattr("weberwhisk.commands.choices.LONG", 0)
    assert run_app(cli.app, ["fit", str(table), "--json"]) == 0
    assert not capsys.readouterr().err


@pytest.mark.parametrize(
    "scene",
    slow_but(
        [
            ["--standard", "50,100"],
            ["--identity", "C2", "--standard-mm", "15,24"],
            ["--identity", "C2", "--cue", "force-map", "--standard-mm", "20"],
        ],
        (0,),
    ),
)
def test_simulate_and_fit_find_the_truth_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], scene: list[str]
) -> None:
    out = tmp_path / "out"
    truth = ["--weber-fraction", "0.15", "--lapse-high", "0.02", "--trials-per-level", "60"]
    simulated = answer(capsys, "simulate", *scene, *truth, "--out", str(out))
    table = pd.read_csv(out / "trials.csv")
    assert len(rows(simulated)) == len(table)
    known = json.loads((out / "truth.json").read_text("utf-8"))
    assert known["weber_fraction"] == 0.15
    assert known == simulated["truth"]
    standard = next(i for i, word in enumerate(scene) if word.startswith("--standard"))
    felt = scene[:standard]
    found = answer(capsys, "fit", str(out / "trials.csv"), *felt, "--out", str(out))
    assert found["status"] == "DETERMINED"
    sd = found["parameters"]["weber_fraction"]["sd"]  # type: ignore[index]
    assert abs(found["weber_fraction"] - 0.15) < 4 * sd  # type: ignore[operator]
    made = {path.name for path in out.iterdir()}
    assert made == {
        "trials.csv", "trials.png", "trials.svg", "truth.json",
        "simulate.run.json", "fit.csv",
        "fit.json", "fit_report.txt", "fit_methods.txt", "psychometric.png", "psychometric.svg",
        "fit.run.json",
    }  # fmt: skip
    assert json.loads((out / "fit.json").read_text("utf-8")) == found


def test_simulate_prints_its_table_or_where_it_is(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    short = ["simulate", "--trials-per-level", "1", "--offset", "-0.1,0.1", "--task", "2IFC"]
    assert run_app(cli.app, short) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("2 trials of 2IFC, 0 without an answer; 1 standard, ")
    assert lines[1] == "session,trial,standard,stimulus_1,stimulus_2,choice"
    assert len(lines) == 4
    assert run_app(cli.app, [*short, "--out", str(tmp_path)]) == 0
    assert f"Written to {tmp_path}: trials.csv" in capsys.readouterr().out


@pytest.mark.parametrize("name", slow_but(EFFECTS, (0, 4)))
def test_simulate_draws_the_curve_of_every_effect(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    """At the true values, where the fit has nothing to fit."""
    design = [
        "--order",
        "random",
        "--sessions",
        "2",
        "--trials-per-level",
        "5",
        "--out",
        str(tmp_path),
    ]
    assert run_app(cli.app, ["simulate", *design, "--effect", f"{name}:0.1"]) == 0
    assert "trials.png" in capsys.readouterr().out
    assert json.loads((tmp_path / "truth.json").read_text("utf-8"))["effects"] == {name: 0.1}


def test_python_runs_the_package_as_its_command() -> None:
    asked = [sys.executable, "-m", "weberwhisk", "--version"]
    said = subprocess.run(asked, capture_output=True, text=True, check=True)
    assert said.stdout.split()[-1] == ww.__version__


def write(path: Path, *lines: str) -> str:
    path.write_text("\n".join(lines) + "\n", "utf-8")
    return str(path)


def test_fit_takes_columns_labels_subjects_and_sessions(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = [
        f"{who},{day},10,{10 + gap},{'R' if (gap > 0) != (i % 10 == 0) else 'L'}"
        for who in "ab"
        for day in range(1, 5)
        for gap in (-3, -1, 1, 3)
        for i in range(10)
    ]
    file = write(tmp_path / "t.csv", "subject,session,left,right,said", *lines)
    options = ["--column", "stimulus_1=left", "--column", "stimulus_2=right"]
    options += ["--column", "choice=said", "--label", "L=first", "--label", "R=second"]
    assert "write --subject a, or --together for all." in refused(capsys, "fit", file, *options)
    found = answer(capsys, "fit", file, *options, "--subject", "b", "--session", "1,3-4")
    assert found["data"]["n_trials"] == 120  # type: ignore[index]
    assert "no trials have session" in refused(
        capsys, "fit", file, *options, "--subject", "b", "--session", "9"
    )


def test_fit_takes_some_trials_and_leaves_others_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    trials = ww.simulate_trials(sessions=4, trials_per_level=20, seed=1)
    table = trials.table().assign(
        block=["practice", "a", "b"] * 60, day=trials.frame["session"] + 0.0
    )
    table.loc[:5, "block"] = np.nan  # not of any block
    file = str(tmp_path / "t.csv")
    table.to_csv(file, index=False)

    def fitted(*options: str) -> int:
        return answer(capsys, "fit", file, *options)["data"]["n_trials"]  # type: ignore[index,no-any-return]

    count = table["block"].value_counts()
    assert fitted("--without", "block=practice") == len(table) - count["practice"]
    assert fitted("--only", "block=practice, a") == count["practice"] + count["a"]
    assert (
        fitted("--without", "block=a", "--without", "block=b")
        == len(table) - count["a"] - count["b"]
    )
    later = table["day"] > 1
    assert (
        fitted("--only", "block=a", "--without", "day=1") == ((table["block"] == "a") & later).sum()
    )
    assert fitted("--without", "day=1-3") == (table["day"] == 4).sum()
    for option in ("--only", "--without"):
        said = refused(capsys, "fit", file, option, "blok=practice")
        assert "the column 'blok' is unknown (did you mean 'block'?)" in said
        assert "block has 'a', 'b'" in refused(capsys, "fit", file, option, "block=practce")
        assert "did you mean 'block'?" in refused(capsys, "fit", file, option, "blok=a")
        assert f"{option} takes a pair such as block=practice" in refused(
            capsys, "fit", file, option, "practice"
        )
    assert "all trials have day = " in refused(capsys, "fit", file, "--without", "day=1-4")
    read = ww.read_trials(file)
    rest = read.without(block=["a", "b"])
    assert rest.table().equals(read.select(block="practice").table()) is False  # those of no block
    assert len(rest) == count["practice"] + table["block"].isna().sum()
    assert rest.follows.sum() < 6 + 1


def test_fit_takes_effects_the_law_and_what_is_known_of_lapses(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    design = ["--standard", "1,4", "--weber-fraction", "0.15", "--sessions", "2"]
    answer(capsys, "simulate", *design, "--trials-per-level", "30", "--out", str(out))
    file = str(out / "trials.csv")
    plain = answer(capsys, "fit", file)
    found = answer(capsys, "fit", file, "--lapse-prior", "1,20", "--law", "--out", str(out))
    assert found["parameters"]["lapse_low"]["prior"] == "beta(1, 20)"  # type: ignore[index]
    assert found["weber_fraction"] != plain["weber_fraction"]
    assert pd.read_csv(out / "law.csv")["rival"].tolist() == ["exponent", "floor"]
    assert len(pd.read_csv(out / "by_standard.csv")) == 2
    assert found["law"]["verdict"] in (out / "fit_report.txt").read_text("utf-8")  # type: ignore[index]
    levels = answer(capsys, "fit", file, "--prior", "levels", "--lapse-prior", "1,20")
    believed = levels["parameters"]["weber_fraction"]["prior"]  # type: ignore[index]
    assert believed.endswith("about the levels shown")
    assert "--prior takes a pair such as" in refused(capsys, "fit", file, "--prior", "wide")
    moved = answer(capsys, "fit", file, "--effect", "floor", "--lapse-prior", "1,20")
    assert moved["settings"]["effects"] == ["floor"]  # type: ignore[index]


def test_every_belief_has_an_option(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = str(tmp_path / "t.csv")
    ww.simulate_trials(trials_per_level=10, sessions=3, seed=1).table().to_csv(file, index=False)
    said = {
        "weber_fraction": "lognorm(1, scale=0.2)", "lapse_low": "beta(1, 20)",
        "bias": "norm(0, 5)", "drift": "norm(0, 0.2)",
    }  # fmt: skip
    options = [w for name, text in said.items() for w in ("--prior", f"{name}={text}")]
    options += ["--prior", "lapse_high=0.02", "--effect", "drift"]
    found = answer(capsys, "fit", file, *options)
    parameters: Any = found["parameters"]
    assert {name: one["prior"] for name, one in parameters.items()} == said
    priors = {name: belief_named(text) for name, text in said.items()} | {"lapse_high": 0.02}
    same = ww.fit_weber(ww.read_trials(file), priors=priors, effects=[ww.behaviour.effects.Drift()])
    assert found["weber_fraction"] == pytest.approx(same.weber_fraction, rel=1e-9)
    for text, words in (
        ("bias=nrm(0, 1)", "no such continuous distribution"), ("bias=norm(0, -1)", "parameters"),
        ("bias=norm(0", "write 'beta(1, 9)'"), ("bais=0.2", "did you mean 'bias'"),
        ("bias=poisson(2)", "no such continuous"),
    ):  # fmt: skip
        assert words in refused(capsys, "fit", file, "--prior", text)


def test_fit_takes_animals_together(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    animals = ["--subjects", "3", "--trials-per-level", "12", "--standard", "1", "--standard", "2"]
    animals += ["--lapse-low", "0.02", "--lapse-high", "0.02"]
    answer(capsys, "simulate", *animals, "--out", str(tmp_path / "s"))
    file, out = str(tmp_path / "s" / "trials.csv"), tmp_path / "out"
    lapses = ["--prior", "lapse_low=0.02", "--prior", "lapse_high=0.02"]
    known = ["--bias", "none", *lapses, "--law"]  # fewer unknowns to integrate
    assert run_app(cli.app, ["fit", file, "--together", *known, "--out", str(out)]) == 0
    said = capsys.readouterr().out
    assert "Population, median Weber fraction: 0." in said
    assert "Noise proportional to the stimulus against its rivals: log Bayes factor" in said
    assert said.startswith((out / "fit_report.txt").read_text("utf-8"))
    assert "of 3 animals" in (out / "fit_methods.txt").read_text("utf-8")
    found = json.loads((out / "fit.json").read_text("utf-8"))
    assert [row["subject"] for row in found["subjects"]] == ["s1", "s2", "s3"]  # type: ignore[attr-defined, union-attr]
    made = {path.name for path in out.iterdir()}
    figures = {f"{of}.{kind}" for of in ("population", "shrinkage") for kind in ("png", "svg")}
    texts = {"fit_report.txt", "fit_methods.txt"}
    tables = {"subjects.csv", "population.csv", "law.csv", "by_standard.csv"}
    assert made == {"fit.json", "fit.run.json"} | tables | texts | figures


def test_fit_of_states_has_the_course_of_engagement(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    trials = ww.simulate_trials(
        sessions=2, trials_per_level=20, states=ww.behaviour.States(engaged=0.6), seed=3
    )
    file, out = tmp_path / "trials.csv", tmp_path / "out"
    trials.frame.rename(columns={"count": "choice"}).drop(columns="n").to_csv(file, index=False)
    assert run_app(cli.app, ["fit", str(file), "--states", "3", "--out", str(out)]) == 0
    assert "The animal was engaged on" in capsys.readouterr().out
    assert "three states" in (out / "fit_methods.txt").read_text("utf-8")
    course = pd.read_csv(out / "engagement.csv")
    assert course["engaged"].between(0, 1).all()
    assert len(course) == len(trials.frame)
    assert (out / "engagement.png").is_file()
    assert "leave --states and --method" in refused(
        capsys, "fit", str(file), "--states", "3", "--together"
    )


HEADER = "stimulus_1,stimulus_2,choice"


@pytest.mark.parametrize(
    ("lines", "options", "sentence"),
    [
        ([], [], "the file is empty; give a header"),
        (["a,b", "1,2"], [], "--column choice='<its name>' maps them"),
        ([HEADER, "-1,2,1"], [], "read logarithms with --scale log."),
        ([HEADER, "1,2,L"], [], "or give --label L=first --label R=second, say."),
        ([HEADER, "1,2,1"], ["--label", "1=third"], "'third' is unknown"),
        ([HEADER, "1,2,1"], ["--column", "choice"], "takes a pair such as choice=response"),
        ([HEADER, "1,2,1"], ["--method", "laplace"], "method 'laplace' is unknown"),
        ([HEADER, "1,2,1"], ["--session", "1"], "there is no column 'session'"),
        ([HEADER, "1,2,1"], ["--cue", "compliance"], "--cue needs a whisker"),
        ([HEADER, ".02,.03,1"], ["--identity", "C2"], "as if written in metres"),
        ([HEADER, "20,50,1"], ["--identity", "C2"], "50 mm is beyond the whisker's length"),
        ([HEADER, "20,25,1"], ["--identity", "C2", "--scale", "log"], "leave --scale out"),
        ([HEADER, "1,2,1"], ["--effect", "drft"], "did you mean 'drift'?"),
        ([HEADER, "1,2,1"], ["--lapse-prior", "0,3"], "takes two numbers above zero"),
        ([HEADER, "1,2,1"], ["--together", "--method", "emcee"], "leave --states and --method"),
        ([HEADER, "1,2,1"], ["--together"], "there is no column 'subject'"),
    ],
)
def test_fit_refuses_and_leaves_nothing(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    lines: list[str],
    options: list[str],
    sentence: str,
) -> None:
    file = tmp_path / "t.csv"
    file.write_text("\n".join(lines), "utf-8")
    assert sentence in refused(capsys, "fit", str(file), *options, "--out", str(tmp_path / "out"))
    assert list(tmp_path.iterdir()) == [file]


C2 = ["--identity", "C2"]


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["fit"], "Missing argument 'FILE'"),
        (["fit", "nowhere.csv"], "'nowhere.csv' is not a file; give the path"),
        (["jnd", *C2, "--weber-fraction", "-1"], "--weber-fraction must be above zero, got -1"),
        (["jnd", *C2, "--weber-fraction", "0.1,0.2"], "each signal of the cue (1), got 2"),
        (["jnd", *C2, "--cue", "smell"], "cue 'smell' is unknown"),
        (["jnd", *C2, "--draws", "1"], "needs at least two noisy readings"),
        (["jnd", *C2, "--criterion", "75%"], "The criterion '75%' is unknown"),
        (["jnd", *C2, "--method", "x"], "method 'x' is unknown"),
        (["jnd", *C2, "--deflection-angle-deg", "5,9"], "one angle of tap, got 2 values"),
        (["jnd", *C2, "--deflection-angle-deg", "-3"], "must not be negative, got -3"),
        (
            ["jnd", *C2, "--cue", "two-whiskers", "--weber-fraction", "0.1"],
            "no use for --weber-fraction",
        ),
        (["jnd", *C2, "--cue", "two-whisker"], "did you mean 'two-whiskers'?"),
        (["simulate", *C2, "--cue", "vibrissa-length"], "cue 'vibrissa-length' is unknown"),
        (["simulate", "--effect", "histry:0.5"], "did you mean 'history'?"),
        (["simulate", "--effect", "history"], "the value of an effect must be a number"),
        (["simulate", "--effect", "covariate:laser"], "write covariate:laser:0.3"),
        (["simulate", "--weber-fraction", "-1"], "--weber-fraction must be above zero"),
        (["simulate", "--standard", "0"], "--standard must be above zero, got 0"),
        (["simulate", "--standard-mm", "3"], "--standard-mm needs a whisker"),
        (["simulate", *C2], "are given by --standard-mm, got none"),
        (["simulate", *C2, "--standard", "3"], "are given by --standard-mm, got --standard"),
        (["simulate", *C2, "--standard-mm", "40"], "stimulus 40 lies outside"),
        (["simulate", "--lapse-low", "0.6", "--lapse-high", "0.6"], "must be below 1, got 1.2"),
        (["simulate", "--task", "foo"], "task 'foo' is unknown"),
        (
            ["simulate", *C2, "--standard-mm", "9", "--cue", "force-map",
             "--deflection-angle-deg", "5,9"],
            "at one deflection angle, got 2",
        ),
        (["quickstart", "--identity", "Q7"], "whisker 'Q7' is unknown"),
    ],
)  # fmt: skip
def test_other_commands_refuse_and_leave_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], sentence: str
) -> None:
    assert sentence in refused(capsys, *arguments, "--out", str(tmp_path / "out"))
    assert list(tmp_path.iterdir()) == []
