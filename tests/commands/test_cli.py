"""The command line: answers, refusals in one sentence, and quiet ends."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pandas as pd
import pytest
import typer

import weberwhisk as ww
from weberwhisk import cli
from weberwhisk._util import checks
from weberwhisk._util.output import Run
from weberwhisk.cli import new_app, run_app
from weberwhisk.commands import progress

WHISKER = ["--length-mm", "50", "--base-radius-um", "100", "--tip-radius-um", "5"]
SOFT = [*WHISKER, "--youngs-modulus-gpa", "3"]
CONTACT = ["--radial-distance-mm", "20,40,60", "--deflection-angle-deg", "20"]


def refused(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """The sentence that the command line refuses `arguments` with."""
    assert run_app(cli.app, arguments) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith("weberwhisk: ")
    assert printed.err.endswith("\n")
    assert printed.err.count("\n") == 1
    return printed.err.removeprefix("weberwhisk: ").strip()


def answer(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict[str, object]:
    """What `--json` prints, strictly read."""
    assert run_app(cli.app, [*arguments, "--json"]) == 0
    printed = capsys.readouterr()
    assert printed.err == ""
    result = json.loads(printed.out, parse_constant=pytest.fail)
    assert isinstance(result, dict)
    return result


def rows(result: dict[str, object]) -> pd.DataFrame:
    return pd.DataFrame(result["rows"])


# bend


def test_bend_by_contact_gives_what_press_gives(capsys: pytest.CaptureFixture[str]) -> None:
    table = rows(answer(capsys, "bend", *SOFT, *CONTACT))
    whisker = ww.Whisker(50e-3, 100e-6, 5e-6, 3e9)
    expected = ww.press(whisker, np.array([20e-3, 40e-3, 60e-3]), np.radians(20))
    assert list(table["outcome"]) == ["held", "flicked_past", "out_of_reach"]
    assert list(table["radial_distance_mm"]) == [20, 40, 60]
    assert list(table["deflection_angle_deg"]) == [20, 20, 20]
    for column, values in {
        "moment_micronewton_metre": expected.moment * 1e6,
        "axial_force_micronewton": expected.axial_force * 1e6,
        "transverse_force_micronewton": expected.transverse_force * 1e6,
        "force_micronewton": expected.force * 1e6,
        "arc_length_mm": expected.arc_length * 1e3,
        "contact_angle_deg": np.degrees(expected.contact_angle),
        "error": expected.error,
    }.items():
        np.testing.assert_allclose(table[column].astype(float), values, rtol=1e-12)
    assert np.isfinite(table["moment_micronewton_metre"][0])
    assert list(table["model"]) == ["elastica"] * 3


def test_bend_combines_each_with_each(capsys: pytest.CaptureFixture[str]) -> None:
    lists = ["--radial-distance-mm", "10, 15.7", "--radial-distance-mm", "31.4"]
    angles = ["--deflection-angle-deg", "-7.5,7.5"]
    table = rows(answer(capsys, "bend", "--identity", "C2", *lists, *angles))
    # What was asked, to the last digit: these numbers change on the way to metres and back.
    assert list(table["radial_distance_mm"]) == [10, 10, 15.7, 15.7, 31.4, 31.4]
    assert list(table["deflection_angle_deg"]) == [-7.5, 7.5] * 3
    moment = table["moment_micronewton_metre"].to_numpy()
    np.testing.assert_allclose(moment[::2], -moment[1::2], rtol=1e-12)


def test_a_named_whisker_taken_as_straight_is_said(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    asked = ["jnd", "--draws", "2", "--identity", "C2", "--out", str(tmp_path)]
    assert run_app(cli.app, asked) == 0
    said = capsys.readouterr().out
    assert "C2 is taken as straight; its shape at rest moves r by up to" in said
    assert "write --curvature-per-m own" in said


def test_bend_identity_modulus_seed_and_model(capsys: pytest.CaptureFixture[str]) -> None:
    def result(*options: str) -> dict[str, object]:
        return answer(capsys, "bend", "--identity", "C2", *options, *CONTACT)

    mean = result()
    assert mean["whisker"] == {
        "length_mm": 33.6, "base_radius_um": 69.5, "tip_radius_um": 1.75,
        "youngs_modulus_gpa": 3.34,
    }  # fmt: skip
    drawn = result("--seed", "3")
    assert drawn != mean
    assert drawn == result("--seed", "3")
    stiff = rows(result("--youngs-modulus-gpa", "6.68"))["moment_micronewton_metre"][0]
    assert stiff == pytest.approx(2 * rows(mean)["moment_micronewton_metre"][0], rel=1e-12)
    forced = result("--model", "closed_form")
    assert list(rows(forced)["model"]) == ["closed_form"] * 3


def test_bend_writes_its_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    arguments = ["bend", "--identity", "C2", "--seed", "3", *CONTACT, "--out", str(out)]
    table = rows(answer(capsys, *arguments))
    pd.testing.assert_frame_equal(
        pd.read_csv(out / "bend.csv"), table, check_dtype=False, rtol=1e-12
    )
    record = json.loads((out / "bend.run.json").read_text("utf-8"))
    assert record["seed"] == 3
    assert record["inputs"]["identity"] == "C2"
    assert record["inputs"]["radial_distance_mm"] == ["20,40,60"]
    assert run_app(cli.app, arguments) == 0
    assert f"Written to {out}: bend.csv" in capsys.readouterr().out


def test_without_out_nothing_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    answer(capsys, "bend", "--identity", "C2", *CONTACT)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["bend2"], "No such command 'bend2'. Did you mean 'bend'?"),
        (["zzz"], "No such command 'zzz'; `weberwhisk --help` says what it takes."),
        (["--nope"], "No such option: --nope; `weberwhisk --help` says what it takes."),
        (["bend", "extra"], "unexpected extra argument"),
        (["bend", "--lenght-mm", "5"], "No such option: --lenght-mm (Possible options: "),
        (["bend", "--length-mm"], "Option '--length-mm' requires an argument"),
        (
            ["bend", "--length-mm", "abc"],
            "Invalid value for '--length-mm': 'abc' is not a number; write one such as 3.5",
        ),
        (["bend", "--seed", "-1"], "'-1' is not a seed; write a whole number such as 1"),
        (["bend"], "No whisker is given; write --identity C2, or its shape with --length-mm,"),
        (
            ["bend", "--length-mm", "50", *CONTACT],
            "shape is incomplete, got --length-mm; write --base-radius-um and --tip-radius-um",
        ),
        (
            ["bend", "--identity", "C2", *WHISKER, *CONTACT],
            "an identity or a shape, got --identity and --length-mm; leave one of them out.",
        ),
        (["bend", "--identity", "Q7", *CONTACT], "whisker 'Q7' is unknown; choose one of A0, "),
        (["bend", *WHISKER, *CONTACT, "--seed", "1"], "--seed draws a whisker of an --identity"),
        (["bend", *WHISKER], "got none of them; write both of one pair."),
        (
            ["bend", *WHISKER, *CONTACT, "--force-micronewton", "2"],
            "got --radial-distance-mm and --deflection-angle-deg and --force-micronewton; write",
        ),
        (
            ["bend", *WHISKER, "--radial-distance-mm", "2,x,y", "--deflection-angle-deg", "3"],
            "--radial-distance-mm takes numbers such as 10,20,30, got 'x'.",
        ),
        (
            ["bend", *WHISKER, "--radial-distance-mm", "2,0", "--deflection-angle-deg", "3"],
            "--radial-distance-mm must be above zero, got 0; give millimetres, such as 35.",
        ),
        (
            ["bend", *WHISKER, "--radial-distance-mm", "2", "--deflection-angle-deg", "nan"],
            "--deflection-angle-deg must be finite, got nan; give a number, such as 20.",
        ),
        (["bend", *WHISKER, "--length-mm", "-1"], "--length-mm must be above zero, got -1; give"),
        (["bend", *WHISKER, "--tip-radius-um", "-1"], "--tip-radius-um must not be negative"),
        (["bend", *WHISKER, "--tip-radius-um", "200"], "tip must not be wider than the base"),
        (
            ["bend", *WHISKER, *CONTACT, "--model", "elstica"],
            "model 'elstica' is unknown (did you mean 'elastica'?); choose one of closed_form, ",
        ),
        (["bend", *WHISKER, *CONTACT, "--out", __file__], "is a file; name a folder"),
    ],
)
@pytest.mark.parametrize("as_json", [False, True])
def test_wrong_input_ends_with_one_sentence(
    capsys: pytest.CaptureFixture[str], arguments: list[str], sentence: str, as_json: bool
) -> None:
    if as_json and arguments[0] == "bend":
        arguments = ["bend", "--json", *arguments[1:]]
    assert sentence in refused(capsys, *arguments)


# The conventions, whatever the command: a command line made for the test


def probe(command: Callable[..., None]) -> typer.Typer:
    app = new_app({})
    app.command("probe")(command)
    return app


def test_help_and_version(capsys: pytest.CaptureFixture[str]) -> None:
    for arguments in ([], ["--help"], ["bend", "--help"]):
        assert run_app(cli.app, arguments) == 0
        printed = capsys.readouterr()
        assert printed.out.startswith("Usage: weberwhisk")
        assert printed.err == ""
    assert run_app(cli.app, ["--version"]) == 0
    assert capsys.readouterr().out == f"weberwhisk {ww.__version__}\n"


def test_entry_point(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(sys, "argv", ["anything", "bend", "--identity", "C2", *CONTACT])
    assert cli.main() == 0
    assert "out_of_reach" in capsys.readouterr().out
    monkeypatch.setattr(sys, "argv", ["anything", "bend"])
    assert cli.main() == 2


def every_command() -> dict[str, Any]:
    group: Any = typer.main.get_command(cli.app)
    context = group.make_context("weberwhisk", ["--version"], resilient_parsing=True)
    return {name: group.get_command(context, name) for name in cli.COMMANDS}


@pytest.mark.parametrize("arguments", [["--version"], ["--help"], []])
def test_nothing_heavy_is_imported_before_a_command_is_used(arguments: list[str]) -> None:
    heavy = "scipy pandas matplotlib arviz emcee rich h5py distributed"
    code = (
        "import sys; from weberwhisk.cli import app, run_app;"
        f"status = run_app(app, {arguments!r});"
        f"print([m for m in {heavy.split()!r} if m in sys.modules], status)"
    )
    out, err = start(code).communicate()
    assert (out.splitlines()[-1], err) == ("[] 0", "")


def test_completion_imports_no_mathematics() -> None:
    code = (
        "import sys; from weberwhisk.cli import main\n"
        "try: main()\n"
        "finally: print([m for m in ('scipy', 'pandas') if m in sys.modules])"
    )
    asked = {"COMP_WORDS": "weberwhisk re", "COMP_CWORD": "1", "_TYPER_COMPLETE_ARGS": ""}
    asked |= {"_WEBERWHISK_COMPLETE": "complete_bash"}
    out, err = start(code, environment=asked).communicate()
    assert (out.split(), err) == (["rehearse", "[]"], "")


def test_every_command_has_the_common_options() -> None:
    commands = every_command()
    assert "bend" in commands
    # What is charted or analysed is the same each time, and `next` speaks JSON anyway.
    same = {name: {"--seed"} for name in ("analyse", "locate")}
    without = same | {"next": {"--json"}}
    for name, command in commands.items():
        options = {name for parameter in command.params for name in parameter.opts}
        assert {"--out", "--json", "--seed"} - without.get(name, set()) <= options, name


def test_a_value_error_of_weberwhisk_is_a_refusal(capsys: pytest.CaptureFixture[str]) -> None:
    def command() -> None:
        checks.positive("length", -1, "give metres,\nsuch as 1")

    assert run_app(probe(command), ["probe"]) == 2
    sentence = "weberwhisk: length must be above zero, got -1; give metres, such as 1.\n"
    assert capsys.readouterr().err == sentence


def test_a_value_error_inside_numpy_is_a_bug(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*arguments: object, **options: object) -> None:
        np.linalg.cholesky(np.zeros((2, 3)))

    monkeypatch.setattr(ww, "press", broken)
    with pytest.raises(ValueError, match="square"):
        run_app(cli.app, ["bend", *WHISKER, *CONTACT])


def test_an_interrupted_command_ends_quietly(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def command() -> None:
        with Run(tmp_path / "out", "probe", {}) as files:
            files.path("half.txt").write_text("half")
            raise KeyboardInterrupt

    assert run_app(probe(command), ["probe"]) == 130
    assert capsys.readouterr() == ("", "")
    assert list(tmp_path.iterdir()) == []


def test_progress_is_for_a_terminal_only(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def command(as_json: Annotated[bool, typer.Option("--json")] = False) -> None:
        with progress("Posteriors", 4, as_json=as_json) as advance:
            for _ in range(4):
                advance()

    app = probe(command)
    assert run_app(app, ["probe"]) == 0
    assert capsys.readouterr() == ("", "")
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    monkeypatch.setenv("TERM", "xterm")
    assert run_app(app, ["probe"]) == 0
    printed = capsys.readouterr()
    assert printed.out == ""
    assert "Posteriors" in printed.err
    assert "100%" in printed.err
    assert run_app(app, ["probe", "--json"]) == 0
    assert capsys.readouterr() == ("", "")


def test_long_work_without_a_terminal_tells_its_progress_in_lines(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with progress("Posteriors", 4, as_json=False, every=0.0) as advance:
        for _ in range(4):
            advance()
    lines = capsys.readouterr().err.splitlines()
    assert [line.split(" after")[0] for line in lines] == [
        f"Posteriors: {share} %" for share in (25, 50, 75, 100)
    ]


# As a process


COMMAND = "import sys; from weberwhisk.cli import main; sys.exit(main())"


def start(
    code: str,
    *arguments: str,
    stdout: int = subprocess.PIPE,
    environment: dict[str, str] | None = None,
) -> subprocess.Popen[str]:
    root = str(Path(__file__).parents[2])
    # As a user's shell starts it: output is buffered when it goes into a pipe.
    usual = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
    return subprocess.Popen(
        [sys.executable, "-W", "error", "-c", code, *arguments],
        env={**usual, "PYTHONPATH": root, "PYTHONIOENCODING": "utf-8", **(environment or {})},
        stdin=subprocess.DEVNULL,
        stdout=stdout,
        stderr=subprocess.PIPE,
        text=True,
    )


def test_process_answers_and_refuses() -> None:
    good = start(COMMAND, "bend", "--identity", "C2", *CONTACT, "--json")
    out, err = good.communicate()
    assert (good.returncode, err) == (0, "")
    assert len(json.loads(out)["rows"]) == 3
    bad = start(COMMAND, "bend", "--identity", "Q7", *CONTACT, "--json")
    out, err = bad.communicate()
    assert (bad.returncode, out) == (2, "")
    assert err.startswith("weberwhisk: whisker 'Q7' is unknown")
    assert err.count("\n") == 1


@pytest.mark.parametrize("many", [False, True])
def test_process_whose_reader_goes_is_quiet(many: bool) -> None:
    angles = ",".join(map(str, np.linspace(1, 10, 5000 if many else 2)))
    reading, writing = os.pipe()
    os.close(reading)  # nobody reads
    scene = [*WHISKER, "--radial-distance-mm", "20", "--deflection-angle-deg", angles]
    process = start(COMMAND, "bend", *scene, "--json", stdout=writing)
    os.close(writing)
    _, err = process.communicate()
    assert (process.returncode, err) == (1, "")


WAITING = """
import signal, sys, typer
from pathlib import Path
from weberwhisk.cli import new_app, run_app
from weberwhisk._util.output import Run

app = new_app({})

@app.command()
def wait() -> None:
    with Run(sys.argv[1], "wait", {}) as files:
        files.path("half.txt").write_text("half")
        print("ready", flush=True)
        while True:
            signal.pause()

sys.exit(run_app(app, ["wait"]))
"""


@pytest.mark.skipif(not hasattr(signal, "pause"), reason="no signals to end it with")
@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_process_that_is_told_to_end_leaves_nothing(
    tmp_path: Path, number: signal.Signals, status: int
) -> None:
    process = start(WAITING, str(tmp_path / "out"))
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    assert list(tmp_path.iterdir()), "something half-written is there to clean up"
    process.send_signal(number)
    out, err = process.communicate()
    assert (process.returncode, out, err) == (status, "", "")
    assert list(tmp_path.iterdir()) == []


# jnd, simulate, fit; quickstart has its own file


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


@pytest.mark.once
def test_choices_by_another_cue(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = [*SOFT, "--cue", "moment", "--deflection-angle-deg", "5"]
    out = tmp_path / "out"
    assert run_app(cli.app, ["simulate", *scene, "--standard-mm", "20", "--out", str(out)]) == 0
    capsys.readouterr()
    found = answer(capsys, "fit", str(out / "trials.csv"), *scene)
    assert found["lower"] < 0.1 < found["upper"]


@pytest.mark.once
@pytest.mark.parametrize(
    "scene",
    [
        ["--standard", "50,100"],
        ["--identity", "C2", "--standard-mm", "15,24"],
        ["--identity", "C2", "--cue", "force-map", "--standard-mm", "20"],
    ],
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


@pytest.mark.once
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
    assert len(pd.read_csv(out / "law.csv")) == 2
    assert found["law"]["verdict"] in (out / "fit_report.txt").read_text("utf-8")  # type: ignore[index]
    levels = answer(capsys, "fit", file, "--prior", "levels", "--lapse-prior", "1,20")
    believed = levels["parameters"]["weber_fraction"]["prior"]  # type: ignore[index]
    assert believed.endswith("about the levels shown")
    assert "choose one of levels" in refused(capsys, "fit", file, "--prior", "wide")
    moved = answer(capsys, "fit", file, "--effect", "floor", "--lapse-prior", "1,20")
    assert moved["settings"]["effects"] == ["floor"]  # type: ignore[index]


def test_fit_takes_animals_together(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    animals = ["--subjects", "3", "--trials-per-level", "12"]
    answer(capsys, "simulate", *animals, "--out", str(tmp_path / "s"))
    file, out = str(tmp_path / "s" / "trials.csv"), tmp_path / "out"
    known = ["--bias", "none"]  # one unknown less to integrate
    assert run_app(cli.app, ["fit", file, "--together", *known, "--out", str(out)]) == 0
    said = capsys.readouterr().out
    assert "Population, median Weber fraction: 0." in said
    assert said.startswith((out / "fit_report.txt").read_text("utf-8"))
    assert "of 3 animals" in (out / "fit_methods.txt").read_text("utf-8")
    found = json.loads((out / "fit.json").read_text("utf-8"))
    assert [row["subject"] for row in found["subjects"]] == ["s1", "s2", "s3"]  # type: ignore[attr-defined, union-attr]
    made = {path.name for path in out.iterdir()}
    figures = {f"{of}.{kind}" for of in ("population", "shrinkage") for kind in ("png", "svg")}
    texts = {"fit_report.txt", "fit_methods.txt"}
    assert made == {"fit.json", "fit.run.json", "subjects.csv"} | texts | figures


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
    assert "leave --effect, --states" in refused(
        capsys, "fit", str(file), "--states", "3", "--together"
    )


HEADER = "stimulus_1,stimulus_2,choice"


@pytest.mark.parametrize(
    ("lines", "options", "sentence"),
    [
        ([], [], "the file is empty; give a header"),
        (["a,b", "1,2"], [], "--column choice='<its name>' maps one"),
        ([HEADER, "-1,2,1"], [], "read logarithms with --scale log."),
        ([HEADER, "1,2,L"], [], "or give --label LABEL=first and --label LABEL=second."),
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
        ([HEADER, "1,2,1"], ["--together", "--effect", "drift"], "leave --effect, --states"),
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
