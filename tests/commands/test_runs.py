"""A command's output folder: everything or nothing, and nobody else's files."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from enum import IntEnum
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import weberwhisk
from weberwhisk._util.output import Run, atomic_write, to_json

TABLE = pd.DataFrame({"radial_distance_mm": [10.0, 20.0], "outcome": ["held", "out_of_reach"]})


class Drawing:
    """Stands in for a Matplotlib figure."""

    def savefig(self, path: Path, /, **options: Any) -> None:
        path.write_text(f"{path.suffix} {options}")

    def set_layout_engine(self, layout: str) -> None:
        assert layout == "none"


def tree(folder: Path) -> dict[str, str]:
    """Every file under `folder`, hidden ones too, with its text; folders end in a slash."""
    return {
        f"{p.relative_to(folder)}{'/' if p.is_dir() else ''}": "" if p.is_dir() else p.read_text()
        for p in sorted(folder.rglob("*"))
    }


def make(out: Path, value: float = 1.0, command: str = "bend", extra: bool = False) -> None:
    with Run(out, command, {"value": value}, seed=7) as run:
        run.table(command, pd.DataFrame({"value": [value]}))
        if extra:
            run.figure(command, Drawing())


def test_writes_tables_figures_and_the_record(tmp_path: Path) -> None:
    out = tmp_path / "deep" / "out"
    inputs = {"identity": "C2", "angles": np.array([1.0, np.nan]), "out": out}
    with Run(out, "bend", inputs, seed=7) as run:
        run.table("bend", TABLE)
        run.figure("bend", Drawing())
        run.path("notes.txt").write_text("held")
        assert not out.exists(), "nothing may appear before the end"
    names = ["bend.csv", "bend.png", "bend.run.json", "bend.svg", "notes.txt"]
    assert sorted(tree(tmp_path)) == ["deep/", "deep/out/", *(f"deep/out/{n}" for n in names)]
    pd.testing.assert_frame_equal(pd.read_csv(out / "bend.csv"), TABLE)
    record = json.loads((out / "bend.run.json").read_text("utf-8"))
    assert record["command"] == "bend"
    assert record["inputs"] == {"identity": "C2", "angles": [1.0, None], "out": str(out)}
    assert record["seed"] == 7
    assert record["files"] == ["bend.csv", "bend.png", "bend.svg", "notes.txt"]
    assert record["started"] <= record["finished"]
    assert record["started"].endswith("+00:00")
    assert record["versions"]["weberwhisk"] == weberwhisk.__version__
    assert record["versions"]["numpy"] == np.__version__
    assert set(record["versions"]) == {
        "python", "weberwhisk", "numpy", "scipy", "emcee", "arviz", "pandas"
    }  # fmt: skip
    assert None not in record["versions"].values()


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt, SystemExit])
@pytest.mark.parametrize("there", [False, True])
def test_a_failure_changes_nothing(tmp_path: Path, error: type[BaseException], there: bool) -> None:
    out = tmp_path / "some" / "out"
    if there:
        make(out, 1.0, extra=True)
        (out / "mine.txt").write_text("mine")
    before = tree(tmp_path)
    with pytest.raises(error), Run(out, "bend", {}) as run:  # noqa: PT012
        run.table("bend", TABLE)
        raise error
    assert tree(tmp_path) == before


def test_second_run_replaces_its_own_files_and_no_others(tmp_path: Path) -> None:
    out = tmp_path / "out"
    make(out, 1.0, extra=True)
    make(out, 5.0, command="jnd")
    (out / "mine.txt").write_text("mine")
    (out / "notes").mkdir()
    make(out, 2.0)
    assert sorted(tree(out)) == [
        "bend.csv", "bend.run.json", "jnd.csv", "jnd.run.json", "mine.txt", "notes/"
    ]  # fmt: skip
    assert (out / "bend.csv").read_text() == "value\n2.0\n"
    assert (out / "jnd.csv").read_text() == "value\n5.0\n"
    record = json.loads((out / "bend.run.json").read_text())
    assert record["inputs"] == {"value": 2.0}
    assert record["removed"] == ["bend.png", "bend.svg"]


@pytest.mark.parametrize("directory", [False, True])
def test_a_foreign_file_in_the_way_is_refused(tmp_path: Path, directory: bool) -> None:
    if directory:
        (tmp_path / "bend.csv").mkdir()
    else:
        (tmp_path / "bend.csv").write_text("my data")
    before = tree(tmp_path)
    with pytest.raises(ValueError, match=r"bend.csv' would be overwritten.*did not make it"):
        make(tmp_path)
    assert tree(tmp_path) == before


@pytest.mark.parametrize(
    "text", ["", "{}", "[]", '{"files": 3}', '{"files": ["../mine.txt"]}', '{"files": [""]}']
)
def test_a_record_that_is_none_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "mine.txt").write_text("mine")
    out = tmp_path / "out"
    out.mkdir()
    (out / "bend.run.json").write_text(text)
    before = tree(tmp_path)
    with pytest.raises(ValueError, match="is not a record that weberwhisk wrote"):
        make(out)
    assert tree(tmp_path) == before


def test_out_that_is_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "out").write_text("mine")
    with pytest.raises(ValueError, match=r"out' is a file; name a folder, or a new one\.$"):
        make(tmp_path / "out")
    with pytest.raises(ValueError, match=r"cannot be written \(Not a directory\); name a folder"):
        make(tmp_path / "out" / "below")
    assert tree(tmp_path) == {"out": "mine"}


def test_atomic_write(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "trials.csv"
    atomic_write(path, "µ\n")
    assert path.read_bytes() == "µ\n".encode()
    atomic_write(path, b"\x00\x01")
    assert path.read_bytes() == b"\x00\x01"
    (tmp_path / "link.csv").symlink_to(path)
    atomic_write(tmp_path / "link.csv", "through the link")
    assert (tmp_path / "link.csv").is_symlink()
    assert path.read_text() == "through the link"

    def stop(*arguments: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "replace", stop)
    with pytest.raises(KeyboardInterrupt):
        atomic_write(path, "new")
    assert set(tree(tmp_path)) == {"link.csv", "trials.csv"}
    assert path.read_text() == "through the link"


def test_to_json_is_strict_json() -> None:
    class Outcome(IntEnum):
        OUT_OF_REACH = 4

    value = {
        "array": np.array([[1.0, np.inf], [-np.inf, np.nan]]),
        "integer": np.int64(3),
        "truth": np.bool_(True),
        "outcome": Outcome.OUT_OF_REACH,
        "path": Path("a/b"),
        "nothing": None,
        2: ("µ", float("nan")),
    }
    assert json.loads(to_json(value), parse_constant=pytest.fail) == {
        "array": [[1.0, None], [None, None]],
        "integer": 3,
        "truth": True,
        "outcome": "out_of_reach",
        "path": os.path.join("a", "b"),
        "nothing": None,
        "2": ["µ", None],
    }
    assert json.loads(to_json(TABLE.to_dict("records"))) == TABLE.to_dict("records")


RACING = """
import sys
import time
import pandas as pd
from weberwhisk._util.output import Run

out, value = sys.argv[1], float(sys.argv[2])
names = ("bend", "second", "third")[: 3 if value == 1 else 2]
for _ in range(int(sys.argv[3])):
    with Run(out, "bend", {"value": value}) as run:
        for name in names:
            run.table(name, pd.DataFrame({"value": [value] * 50}))
"""


def whole(out: Path) -> float:
    """The value of the one result in a folder, every file of it."""
    record = json.loads((out / "bend.run.json").read_text("utf-8"))
    value = record["inputs"]["value"]
    assert {path.name for path in out.iterdir() if not path.name.startswith(".")} == {
        "bend.run.json", *record["files"]
    }  # fmt: skip
    for name in record["files"]:
        assert (out / name).read_text() == "value\n" + f"{value}\n" * 50
    return float(value)


@pytest.mark.skipif(sys.platform == "win32", reason="no lock on folders there")
@pytest.mark.parametrize("there", [pytest.param(False, marks=pytest.mark.slow), True])
def test_two_runs_at_once_leave_one_of_the_two(tmp_path: Path, there: bool) -> None:
    """They ended in tracebacks, and left files that no record listed."""
    out = tmp_path / "out"
    if there:
        make(out, 3.0, extra=True)
    racers = [
        subprocess.Popen(
            [sys.executable, "-c", RACING, str(out), str(value), "15"],
            stderr=subprocess.PIPE,
            text=True,
        )
        for value in (1.0, 2.0, 1.0)
    ]
    for racer in racers:
        _, error = racer.communicate(timeout=120)
        assert racer.returncode == 0, error
    assert whole(out) in (1.0, 2.0)
    assert not list(tmp_path.glob(".*")) + list(out.glob(".*"))
