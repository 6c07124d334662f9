"""`weberwhisk design` and `weberwhisk rehearse`: folders, answers, refusals, and going on."""

from __future__ import annotations

import json
from pathlib import Path

import pandas as pd
import pytest

import weberwhisk as ww
from weberwhisk import cli
from weberwhisk.cli import run_app

DESIGN = ["design", "--standard-mm", "20,30", "--level", "-2,-1,1,2", "--trials", "12"]
REHEARSE = ["rehearse", "--runs", "2", "--workers", "1"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("design") / "out"
    assert run_app(cli.app, [*DESIGN, "--runs", "4", "--workers", "1", "--out", str(out)]) == 0
    return out


def test_design_writes_what_the_rig_needs(folder: Path) -> None:
    names = {path.name for path in folder.iterdir()}
    assert names >= {
        "plan.json", "plan.html", "preregistration.txt", "trials.csv", "bpod.csv",
        "psychopy_s1_001.csv", "planned_levels.csv", "planned_jnds.csv", "planned_power.csv",
        "planned_psychometric.png", "planned_jnd.svg", "planned_power.png", "design.run.json",
    }  # fmt: skip
    trials = pd.read_csv(folder / "trials.csv")
    assert trials["standard_mm"].value_counts().to_dict() == {20.0: 48, 30.0: 48}
    record = json.loads((folder / "design.run.json").read_text("utf-8"))
    assert record["inputs"]["trials"] == 12
    jnds = pd.read_csv(folder / "planned_jnds.csv")
    assert jnds["stimulus_mm"].between(1, 33.6).all()
    assert jnds["jnd_mm"].between(0.001, 3).all()


@pytest.mark.slow
def test_the_same_command_makes_the_same_plan(folder: Path, tmp_path: Path) -> None:
    """On all cores too."""
    assert run_app(cli.app, [*DESIGN, "--runs", "16", "--out", str(tmp_path / "again")]) == 0
    for name in ("plan.json", "trials.csv", "psychopy_s1_001.csv", "bpod.csv", "plan.html"):
        assert (tmp_path / "again" / name).read_bytes() == (folder / name).read_bytes()


def test_design_takes_curvature_and_one_stimulus(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shape = ["--identity", "C2", "--trials", "10", "--runs", "0", "--standard-mm", "20"]
    shape += ["--level", "-1,1"]
    command = ["design", *shape, "--curvature-per-m", "own", "--task", "go/no-go"]
    assert run_app(cli.app, [*command, "--out", str(tmp_path / "plan")]) == 0
    assert "curvature +16.5986 /m" in capsys.readouterr().out
    plan = ww.design.read_plan(tmp_path / "plan" / "plan.json")
    own = ww.Whisker.from_identity("C2", curved=True)
    assert plan.hypotheses[0].encoding.observer.whisker == own
    assert {h.task for h in plan.hypotheses} == {"go/no-go"}
    assert run_app(cli.app, ["design", *shape]) == 0
    assert "C2 is taken as straight" in (said := capsys.readouterr().out)
    assert "write --curvature-per-m own" in said
    bare = ["--length-mm", "50", "--base-radius-um", "100", "--tip-radius-um", "5"]
    bend = ["bend", *bare, "--radial-distance-mm", "20", "--deflection-angle-deg", "5"]
    assert run_app(cli.app, [*bend, "--curvature-per-m", "own"]) == 2
    assert "--curvature-per-m must be a number, got 'own'" in capsys.readouterr().err


def test_design_answers_in_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_app(cli.app, [*DESIGN, "--runs", "0", "--animals", "3", "--json"]) == 0
    printed = capsys.readouterr()
    assert printed.err == ""
    found = json.loads(printed.out, parse_constant=pytest.fail)
    assert found["trials_per_animal"] == 96
    assert found["total_trials"] == 288
    assert {row["standard_mm"] for row in found["levels"]} == {20.0, 30.0}
    assert found["power"] is None


def test_a_rehearsal_is_written_and_its_stream_cleared(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "rehearsal"
    assert run_app(cli.app, [*REHEARSE, str(folder / "plan.json"), "--out", str(out)]) == 0
    assert {path.name for path in out.iterdir()} == {
        "rehearsal.csv", "rehearsal_summary.csv", "rehearsal.txt", "rehearsal.png",
        "rehearsal.svg", "rehearse.run.json",
    }  # fmt: skip
    table = pd.read_csv(out / "rehearsal.csv")
    expected = ww.simulate_study(ww.read_plan(folder / "plan.json"), 2, seed=1).runs
    pd.testing.assert_frame_equal(table, expected)


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (["--half-width", "0.2", "--bayes-factor", "10"],
         "A goal is a Bayes factor or the width of an interval, got both"),
        (["--standard-mm", "35"], "is off the whisker, by 1.4 mm past its tip"),
        (["--trials", "0"], "--trials of a level must be a whole number of 1 or more, got 0"),
        (["--step-mm", "3"], "are too coarse at standard"),
        (["--farthest-mm", "25"],
         "is farther than the range of 0 mm to 25 mm, by"),
        (["--step-mm", "-1"], "--step-mm must not be negative, got -1; give millimetres"),
        (["--standard-mm", "nan"], "--standard-mm must be finite, got nan; give millimetres"),
        (["--nearest-mm", "inf"], "--nearest-mm must be finite, got inf; give millimetres"),
        (["--farthest-mm", "nan"], "--farthest-mm must lie beyond --nearest-mm, got nan and 0"),
        (["--bayes-factor", "nan"], "--bayes-factor must be finite, got nan"),
        (["--nearest-mm", "30", "--farthest-mm", "20"],
         "--farthest-mm must lie beyond --nearest-mm, got 20 and 30"),
        (["--half-width", "0.2", "--cue", "force-map", "--deflection-angle-deg", "60"], "flicked"),
        (["--cue", "force-map"], "Taper is tested by the compliance cue"),
        (["--trials-per-session", "0"], "--trials-per-session must be a whole number"),
        (["--share", "1"], "--share must lie between 0 and 1"),
        (["--identity", "Z9"], "Z9"),
    ],
)  # fmt: skip
def test_design_refuses_in_one_sentence_and_leaves_nothing(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, options: list[str], sentence: str
) -> None:
    out = tmp_path / "out"
    command = [*DESIGN, "--runs", "0", *options, "--out", str(out)]
    assert run_app(cli.app, command) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert sentence in printed.err
    assert printed.err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (None, "is not a file"),
        ("{", "is no whole plan"),
        ("[1]", "is not a plan"),
        ('{"format": "weberwhisk plan", "version": 4}', "has version 4 of the plan's format"),
        ('{"format": "weberwhisk plan", "version": 1}', "reads versions 2 and 3"),
        ('{"format": "weberwhisk plan", "version": 2}', "None is no Plan"),
    ],
)
def test_rehearse_refuses_what_is_no_plan(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, content: str | None, sentence: str
) -> None:
    file = tmp_path / "plan.json"
    if content is not None:
        file.write_text(content)
    out = tmp_path / "out"
    assert run_app(cli.app, [*REHEARSE, str(file), "--out", str(out)]) == 2
    printed = capsys.readouterr()
    assert sentence in printed.err
    assert printed.err.count("\n") == 1
    assert not out.exists()
