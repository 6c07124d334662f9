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
from command_lines import CONTACT, SOFT, WHISKER, answer, refused, rows
from short_forms import slow_but

import weberwhisk as ww
from weberwhisk import cli
from weberwhisk._util import checks
from weberwhisk._util.output import Run
from weberwhisk.cli import new_app, run_app
from weberwhisk.commands import progress


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


@pytest.mark.parametrize("many", slow_but([False, True], (1,)))
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
