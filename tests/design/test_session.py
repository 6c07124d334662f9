"""A session at the rig: line by line, on file, and nothing lost however it ends."""

from __future__ import annotations

import io
import json
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from weberwhisk._util.output import Log
from weberwhisk.behaviour import IdentityEncoding
from weberwhisk.cli import app, run_app
from weberwhisk.design import BayesianPlacer, Hypothesis, Session, lattice
from weberwhisk.design.session import converse

H = Hypothesis("Weber", IdentityEncoding(), bias="shared")
SCHEME = lattice(H.encoding, [20.0])


def placer(**options: Any) -> BayesianPlacer:
    return BayesianPlacer(H, SCHEME, seed=1, **options)


def talk(session: Session, *lines: str) -> list[dict[str, Any]]:
    return [json.loads(line) for line in converse(session, lines, "_mm")]


def test_resumes_exactly_where_it_was(tmp_path: Path) -> None:
    """Cut anywhere, also in the middle of a line, the session comes to the same trials."""
    answers = ["1", "0", "1", "null", "1", "0", "1", "1", "0", "1"]
    with Session(placer(), tmp_path / "whole") as session:
        whole = talk(session, *answers)
    lines = (tmp_path / "whole").read_bytes().splitlines(keepends=True)
    assert len(lines) == 11
    for kept, torn in ((1, b""), (5, b""), (7, lines[7][:20]), (10, lines[10][:-1]), (0, b"")):
        file = tmp_path / f"{kept}"
        file.write_bytes(b"".join(lines[:kept]) + torn)
        done = max(kept - 1, 0)
        with Session(placer(), file) as session:
            assert talk(session, *answers[done:]) == whole[done:]
        assert file.read_bytes().splitlines()[1:] == [line.strip() for line in lines[1:]]


def test_what_was_shown_is_kept_and_bad_lines_leave_the_trial_standing(tmp_path: Path) -> None:
    with Session(placer(), tmp_path / "log") as session:
        first, *rest = talk(
            session,
            "one",
            "2",
            '{"comparison_mm": 21.0}',
            '{"choice": 1, "comparison": 21.0}',
            '{"choice": 1, "comparison_mm": -3}',
            '{"choice": 1, "comparison_mm": NaN}',
            '{"choice": 1, "trial": 7}',
            "",
            '{"choice": 1, "comparison_mm": 21.5, "standard_mm": 20.25, "trial": 1}',
            '{"choice": 0, "trial": 1}',
        )
        frame = session.placer.trials().frame
    errors = [line["error"] for line in rest if "error" in line]
    for error, words in zip(
        errors,
        ("must be JSON", "choice must be 1", "it has no choice", "'comparison' is unknown",
         "lies outside what can be encoded", "comparison must be finite",
         "trial 7 is not the one that is open",
         "trial 1 is not the one that is open; answer trial 2"),
        strict=True,
    ):  # fmt: skip
        assert words in error
        assert error.count("\n") == 0
    assert first["trial"] == 1
    assert [line["trial"] for line in rest if "trial" in line] == [2]
    assert frame[["stimulus_1", "stimulus_2", "count"]].to_numpy().tolist() == [[20.25, 21.5, 1.0]]
    row = json.loads((tmp_path / "log").read_text().splitlines()[1])
    assert row["comparison"] == 21.5
    assert row["proposed"] == [first["standard_mm"], first["comparison_mm"]]


def test_another_sessions_file_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "log"
    with Session(placer(), file, {"animal": "rat1"}) as session:
        talk(session, "1", "0")
    with (
        pytest.raises(ValueError, match="holds another session: its animal is rat1, not rat2"),
        Session(placer(), file, {"animal": "rat2"}),
    ):
        pass
    file.write_text(file.read_text() + '{"trial": 3}\n')
    with (
        pytest.raises(ValueError, match="has a trial that cannot be read \\(line 4: 'standard'"),
        Session(placer(), file, {"animal": "rat1"}),
    ):
        pass
    with pytest.raises(ValueError, match="is not the file of a walk"), Log(file, "walk", {}):
        pass


# -- the command ---------------------------------------------------------------------------------

OPTIONS = ["next", "--identity", "C2", "--standard-mm", "12,20", "--seed", "3"]


def command(monkeypatch: pytest.MonkeyPatch, text: str, *arguments: str) -> int:
    monkeypatch.setattr(sys, "stdin", io.StringIO(text))
    return run_app(app, arguments)


def test_the_command_writes_trials_that_fit_reads(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out, log = tmp_path / "out", tmp_path / "log"
    more = ["--goal", "taper", "--most", "5", "--nearest", "6", "--farthest", "30", "--step", "0.1"]
    arguments = [*OPTIONS, *more, "--log", str(log), "--out", str(out)]
    assert command(monkeypatch, "1\n0\n", *arguments) == 0
    assert command(monkeypatch, '1\nnull\n{"choice": 1, "comparison_mm": 14.0}\n', *arguments) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [line.get("trial") for line in lines] == [1, 2, 3, 3, 4, 5, None]
    assert lines[2] == lines[3]
    assert set(lines[-1]["probabilities"]) == {"tapered", "cylindrical"}
    for line in lines[:-1]:
        assert 6 <= line["comparison_mm"] <= 30
        assert abs(line["comparison_mm"] * 10 - round(line["comparison_mm"] * 10)) < 1e-6
    assert run_app(app, ["fit", str(out / "trials.csv"), "--identity", "C2", "--json"]) == 0
    fit = json.loads(capsys.readouterr().out)
    assert fit["lower"] < fit["weber_fraction"] < fit["upper"]
    assert len((out / "trials.csv").read_text().splitlines()) == 6
    assert {p.name for p in out.iterdir()} == {
        "next.run.json", "trials.csv", "trials.png", "trials.svg",
    }  # fmt: skip


@pytest.mark.slow
def test_the_command_killed_outright_goes_on(tmp_path: Path) -> None:
    """kill -9 while the animal is at trial 4: the next start proposes trial 4 again."""
    log = tmp_path / "log"
    line = [sys.executable, "-m", "weberwhisk.cli", *OPTIONS, "--log", str(log)]

    def start() -> subprocess.Popen[str]:
        return subprocess.Popen(
            line, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1
        )

    def ask(process: subprocess.Popen[str], answer: str | None) -> dict[str, Any]:
        assert process.stdin is not None
        assert process.stdout is not None
        if answer is not None:
            process.stdin.write(f"{answer}\n")
        return json.loads(process.stdout.readline())

    with start() as process:
        ask(process, None)
        for answer in ("1", "0", "1"):
            fourth = ask(process, answer)
        process.send_signal(signal.SIGKILL)
    with start() as process:
        assert ask(process, None) == fourth
        assert ask(process, "1")["trial"] == 5
        assert process.stdin is not None
        process.stdin.close()
        assert process.wait() == 0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["next", "--identity", "C2"], "--standard-mm says what is compared with"),
        (["next", "--standard-mm", "20"], "--standard says what is compared with"),
        (["next", "--standard", "20", "--goal", "taper"], "--goal taper discriminates a tapered"),
        (["next", "--standard", "20", "--goal", "best"], "--goal 'best' is unknown"),
        ([*OPTIONS, "--farthest", "15"], "standard 20 is left without comparisons on both sides"),
        ([*OPTIONS, "--easy-share", "2"], "--easy-share must lie between 0 and 1"),
        ([*OPTIONS, "--bias", "some"], "bias 'some' is unknown"),
    ],
)
def test_the_command_refuses_in_one_sentence(
    arguments: list[str], words: str, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    assert command(monkeypatch, "1\n", *arguments) == 2
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1


def test_an_answer_that_cannot_be_written_is_not_learnt_nor_half_written(tmp_path: Path) -> None:
    resource = pytest.importorskip("resource")
    file = tmp_path / "rat1.jsonl"
    most = resource.getrlimit(resource.RLIMIT_FSIZE)
    with Session(placer(), file) as session:
        said = converse(session, iter(["1"] * 4), "_mm")
        next(said), next(said)
        kept = file.read_bytes()
        before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (len(kept) + 40, most[1]))  # a full disk
        try:
            with pytest.raises(ValueError, match="cannot be written"):
                next(said)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, most)
            signal.signal(signal.SIGXFSZ, before)
        assert session.placer.n_trials == 1  # type: ignore[attr-defined]
        assert file.read_bytes() == kept
        trial = session.next()
        session.record(trial.standard, trial.comparison, 1)
    assert len(file.read_bytes().splitlines()) == 3


def test_a_line_that_is_no_trial_is_refused_in_a_sentence(tmp_path: Path) -> None:
    file = tmp_path / "rat.jsonl"
    with Session(placer(), file):
        pass
    with file.open("a") as lines:
        lines.write("5\n")
    with pytest.raises(ValueError, match="has a trial that cannot be read"):
        Session(placer(), file).__enter__()
