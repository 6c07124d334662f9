"""The commands around an experiment, fuzzed: design, rehearse, next and quickstart.

As in `test_fuzz`: an answer or one sentence, never a traceback or a hang; and whatever ends a
command that was writing leaves the old files, the new ones, or a log that can be gone on with.
"""

from __future__ import annotations

import json
import subprocess
import sys
from contextlib import chdir
from io import StringIO
from pathlib import Path
from tempfile import TemporaryDirectory
from unittest import mock

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from test_fuzz import NUMBERS, WHISKERS, WORDS, check, refused, run

#: Whole numbers that a command can carry out in a moment, and those that it must refuse.
COUNTS = st.sampled_from(["1", "2", "3", "0", "-1", "1.5", "nan", "x", "", "9" * 400, "١", "1e3"])
DESIGN = {
    "--standard-mm": NUMBERS, "--level": NUMBERS, "--weber-fraction": NUMBERS, "--spread": NUMBERS,
    "--lapse": NUMBERS, "--nearest-mm": NUMBERS, "--farthest-mm": NUMBERS, "--step-mm": NUMBERS,
    "--easy-share": NUMBERS, "--share": NUMBERS, "--half-width": NUMBERS, "--bayes-factor": NUMBERS,
    "--deflection-angle-deg": NUMBERS, "--animals": COUNTS, "--trials-per-session": COUNTS,
    "--cue": WORDS, "--title": WORDS, "--seed": NUMBERS, "--trials": COUNTS,
}  # fmt: skip
NEXT = {
    "--standard": NUMBERS, "--standard-mm": NUMBERS, "--nearest": NUMBERS, "--farthest": NUMBERS,
    "--step": NUMBERS, "--easy-share": NUMBERS, "--width-percent": NUMBERS, "--most": COUNTS,
    "--goal": st.one_of(WORDS, st.sampled_from(["taper", "weber-fraction"])),
    "--bias": WORDS, "--task": WORDS, "--cue": WORDS, "--seed": NUMBERS,
    "--deflection-angle-deg": NUMBERS, "--log": st.sampled_from(["log", "no/such/log", "."]),
    "--out": st.sampled_from(["out", "trials.csv", ""]),
}  # fmt: skip


def options(draw: st.DrawFn, known: dict[str, st.SearchStrategy[str]], most: int = 3) -> list[str]:
    """A few options with values, some of which fit."""
    words = []
    for name in draw(st.lists(st.sampled_from(sorted(known)), max_size=most)):
        words += [name, draw(known[name])]
    return words


@st.composite
def designs(draw: st.DrawFn) -> list[str]:
    """`design` without simulation, which is long by intent."""
    words = ["design", *draw(WHISKERS), "--runs", "0", "--trials", "3", "--find", "nothing"]
    words += ["--standard-mm", "15", "--level", "-2,-1,1,2"] * bool(draw(st.integers(0, 3)))
    words += options(draw, DESIGN)
    return [*words, "--json"] if draw(st.booleans()) else words


@given(designs())
def test_any_design_is_planned_or_refused(arguments: list[str]) -> None:
    with TemporaryDirectory() as folder:
        check(arguments, Path(folder))


LINES = st.one_of(
    st.sampled_from(
        ["1", "0", "null", "", "2", "one", "[]", "{}", '{"choice": 1}', '{"choice": [1]}',
         '{"choice": 1, "comparison": 21}', '{"choice": 0, "comparison_mm": 1e999}', "true", "NaN",
         '{"choice": 1, "comparison": "x"}', '{"choice": 1, "standard": null}', '"1"', "1.0",
         '{"choice": 1, "trial": {}}', '{"choice": 1, "comparison": [[1]]}', "[" * 5000]
    ),
    st.text(max_size=6),
)  # fmt: skip


@st.composite
def conversations(draw: st.DrawFn) -> tuple[list[str], str]:
    """`next` with options, and what a rig might send it."""
    words = ["next", *draw(WHISKERS)]
    name = "--standard" if len(words) == 1 else "--standard-mm"
    words += [name, draw(st.sampled_from(["20", "10", "10,15"]))] * bool(draw(st.integers(0, 4)))
    words += options(draw, NEXT)
    return words, "\n".join(draw(st.lists(LINES, max_size=6)))


@given(conversations())
@example((["next", "--standard", "20"], "[" * 5000))
def test_any_conversation_goes_on_or_is_refused(talk: tuple[list[str], str]) -> None:
    arguments, said = talk
    with TemporaryDirectory() as folder, chdir(folder), mock.patch("sys.stdin", StringIO(said)):
        status, out, err = run(arguments)
    assert status in (0, 2), (status, err)
    if status == 2:
        refused(err)
        return
    assert err == ""
    for line in out.splitlines():
        assert isinstance(json.loads(line, parse_constant=pytest.fail), dict)


# -- at once ---------------------------------------------------------------------------


def test_two_conversations_do_not_write_one_log(tmp_path: Path) -> None:
    """The second is refused in a sentence, and the first goes on."""
    arguments = ["next", "--standard", "20", "--log", "log"]
    command = [
        sys.executable,
        "-c",
        "import sys; from weberwhisk.cli import main; sys.exit(main())",
        *arguments,
    ]
    first = subprocess.Popen(
        command, cwd=tmp_path, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert first.stdin is not None
    assert first.stdout is not None
    try:
        assert json.loads(first.stdout.readline())["trial"] == 1
        second = subprocess.run(
            command, cwd=tmp_path, input="1\n", capture_output=True, text=True, check=False
        )
        assert second.returncode == 2
        refused(second.stderr)
        first.stdin.write("1\n")
        first.stdin.flush()
        assert json.loads(first.stdout.readline())["trial"] == 2
    finally:
        first.kill()
        first.wait()
        first.stdin.close()
        first.stdout.close()
    with chdir(tmp_path), mock.patch("sys.stdin", StringIO("0\n")):
        status, out, err = run(arguments)
    assert (status, err) == (0, "")
    assert [json.loads(line)["trial"] for line in out.splitlines()] == [2, 3]
