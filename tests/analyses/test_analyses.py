"""Every script of analyses/ says what it does, and does nothing, when asked for help."""

from __future__ import annotations

import contextlib
import io
import runpy
import sys
from pathlib import Path

import pandas as pd
import pytest
from analysis_scripts import FOLDER, load

SCRIPTS = [
    path
    for path in sorted([*FOLDER.glob("*.py"), *FOLDER.glob("*/make.py")])
    if "__main__" in path.read_text("utf-8")
]


def files(folder: Path) -> dict[Path, float]:
    kept = (p for p in folder.rglob("*") if p.is_file() and p.suffix != ".pyc")
    return {path: path.stat().st_mtime for path in kept}


def test_help_prints_the_docstring_and_writes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In one process, as what they import takes a second each."""
    assert len(SCRIPTS) >= 20
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [str(FOLDER), *sys.path])
    before = files(FOLDER)
    for script in SCRIPTS:
        monkeypatch.setattr(sys, "argv", [str(script), "--help"])
        printed = io.StringIO()
        with contextlib.redirect_stdout(printed), pytest.raises(SystemExit) as ended:
            runpy.run_path(str(script), run_name="__main__")
        assert ended.value.code == 0, script.name
        assert "usage: " in printed.getvalue(), script.name
        shown = f"python analyses/{script.relative_to(FOLDER).as_posix()}"
        assert shown in printed.getvalue(), script.name
    assert not list(tmp_path.iterdir())
    assert files(FOLDER) == before


def test_the_atlas_names_what_is_wrong_in_silence() -> None:
    stability = load("stability")
    counts = pd.read_csv(FOLDER / "figures" / "stability.csv")
    assert stability.conclusions(counts)[0].startswith("Wrong without saying so: none of")
    counts.loc[3, "silent"] = 2
    assert f"2 of {counts['domain'][3]}" in stability.conclusions(counts)[0]
