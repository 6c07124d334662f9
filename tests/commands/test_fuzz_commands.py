"""The commands around an experiment, fuzzed: design, rehearse, next and quickstart.

As in `test_fuzz`: an answer or one sentence, never a traceback or a hang; and whatever ends a
command that was writing leaves the old files, the new ones, or a log that can be gone on with.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import chdir, contextmanager
from dataclasses import replace
from io import StringIO
from pathlib import Path
from tempfile import TemporaryDirectory
from unittest import mock

import pandas as pd
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from test_fuzz import NUMBERS, WHISKERS, WORDS, check, deadline, refused, refused_by_us, run

import weberwhisk as ww
from weberwhisk.design import Goal, Plan, Scheme, plan_json, read_plan, taper

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
    "--goal": st.one_of(WORDS, st.sampled_from(["taper", "weber-fraction", "1-up/2-down"])),
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


PLAN = Plan(
    Scheme([15e-3, 25e-3], [-2e-3, 2e-3], 4),
    taper(ww.Whisker(33.6e-3, 69.5e-6, 1.75e-6)),
    Goal(bayes_factor=10),
)
POWER = pd.DataFrame({"truth": ["tapered"], "trials": [32], "power": [0.5], "se": [0.1]})
TEXT = plan_json(replace(PLAN, power=POWER))


@st.composite
def plans(draw: st.DrawFn) -> bytes:
    """A plan's file, cut short, with bytes changed, or with a value of another kind."""
    if draw(st.booleans()):
        record = json.loads(TEXT)
        place, name = record, draw(st.sampled_from(sorted(record)))
        while isinstance(place[name], dict | list) and place[name] and draw(st.integers(0, 3)):
            place = place[name]
            names = sorted(place) if isinstance(place, dict) else range(len(place))
            name = draw(st.sampled_from(names))
        place[name] = draw(
            st.sampled_from([None, -1, 0, 1.5, "x", [], {}, [[1]], True, 1e308, "NaN", 10**30])
        )
        return json.dumps(record).encode()
    content = bytearray(TEXT.encode())
    if draw(st.booleans()):
        content = content[: draw(st.integers(0, len(content)))]
    for at in draw(st.lists(st.integers(0, max(len(content) - 1, 0)), max_size=3)):
        content[at : at + 1] = draw(st.binary(max_size=2))
    return bytes(content)


@settings(max_examples=3 * settings.default.max_examples)
@given(plans())
def test_a_damaged_plan_is_read_or_refused(content: bytes) -> None:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "plan.json"
        path.write_bytes(content)
        with deadline():
            try:
                # What is read is the plan that was written: its lists are signed.
                assert read_plan(path).fingerprint == PLAN.fingerprint
            except ValueError as refusal:
                if not (refused_by_us(refusal) and str(path) in str(refusal)):
                    raise


@given(
    st.sampled_from(["plan.json", "plan.json", "none.json", ".", ""]),
    st.lists(
        st.tuples(st.sampled_from(["--runs", "--workers", "--seed"]), COUNTS),
        min_size=1,
        max_size=2,
    ),
    st.booleans(),
)
def test_any_rehearsal_is_done_or_refused(
    file: str, given_options: list[tuple[str, str]], as_json: bool
) -> None:
    words = ["rehearse", file, "--runs", "1", "--workers", "1"]
    # Processes are started by `test_campaign`; many take long by intent.
    words += [w for pair in given_options for w in pair if pair != ("--workers", "2")][:4]
    with TemporaryDirectory() as folder:
        (Path(folder) / "plan.json").write_text(TEXT, "utf-8")
        with mock.patch("weberwhisk._util.campaign._processes", _one_process):
            check([*words, "--json"] if as_json else words, Path(folder))


@contextmanager
def _one_process(workers: int) -> Iterator[tuple[ThreadPoolExecutor, object]]:
    with ThreadPoolExecutor(1) as pool:
        yield pool, lambda: None


@settings(max_examples=6)
@given(
    st.sampled_from(["--weber-fraction", "--draws", "--identity", "--seed", "--out", "x"]),
    st.one_of(st.sampled_from(["-1", "nan", "x", "1.5", "", "inf", "-inf"]), st.text(max_size=4)),
)
def test_quickstart_refuses_what_it_does_not_know(option: str, value: str) -> None:
    """What it would carry out takes seconds, and other tests do it."""
    words = ["quickstart", option, value]
    with TemporaryDirectory() as folder:
        (Path(folder) / "file").write_text("")
        if option in ("--out", "--seed"):
            words = ["quickstart", "--out", "file"]  # a folder that is a file
        check(words, Path(folder))


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
