"""The commands that the documentation and the README show are commands that there are."""

from __future__ import annotations

import re
import shlex
from dataclasses import is_dataclass
from pathlib import Path

import pytest
import typer

import weberwhisk as ww
from weberwhisk.behaviour.effects import EFFECTS
from weberwhisk.behaviour.tasks import TASKS
from weberwhisk.cli import app
from weberwhisk.receptors import ReceptorNoise

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]


def shown() -> list[tuple[str, str]]:
    """Every line of a shell block that calls the command, with the page that shows it."""
    lines = []
    for page in PAGES:
        text = page.read_text("utf-8")
        for block in re.findall(r"^```(?:sh|powershell)\n(.*?)^```", text, re.M | re.S):
            for line in block.replace("\\", "/").splitlines():  # Windows' paths
                if line.startswith("weberwhisk "):
                    lines.append((str(page.relative_to(ROOT)), line))
    return lines


def test_there_are_commands_to_check() -> None:
    assert len({page for page, _ in shown()}) > 8


@pytest.mark.parametrize(("page", "line"), shown())
def test_commands_have_the_options_that_pages_give_them(page: str, line: str) -> None:
    """Parsed, not run: an option that is gone or wants another value raises."""
    words = shlex.split(line, comments=True)[1:]
    group = typer.main.get_command(app)
    context = group.make_context("weberwhisk", [], resilient_parsing=True)
    command = group.get_command(context, words[0])
    assert command is not None, f"{page} shows {line!r}, and there is no command {words[0]}"
    a_file = str(ROOT / "pyproject.toml")  # whatever is there
    command.make_context(
        words[0], [a_file if w.endswith((".csv", ".nwb", ".json")) else w for w in words[1:]]
    )


def things() -> dict[str, list[str]]:
    """What the package has of each kind that the maintainers' page says how to add, by name."""
    laws, cues = (
        [n for n in room.__all__ if isinstance(of := getattr(room, n), type) and is_dataclass(of)]
        for room in (ww.receptors, ww.cues)
    )
    return {
        "receptor law": [n for n in laws if issubclass(getattr(ww.receptors, n), ReceptorNoise)],
        "cue": [n for n in cues if issubclass(getattr(ww.cues, n), ww.cues.Cue)],
        "effect of choices": list(EFFECTS),
        "task": [name for name in TASKS if "correct" not in name],  # whose name has a number
    }


#: Cues that are conditions of another one, and on the command line options of every cue.
OPTIONS = {"commands/__init__.py": {"Friction", "UnknownCurvature", "UnknownHinge", "UnknownRoll"}}


@pytest.mark.parametrize("kind", things())
def test_all_there_is_of_a_kind_stands_where_the_maintainers_page_puts_it(kind: str) -> None:
    text = (ROOT / "docs/maintainers.md").read_text("utf-8")
    row = next(line for line in text.splitlines() if line.startswith(f"| {kind} |"))
    always = "; ".join(p for p in row.split("|")[3].split("; ") if ", where " not in p)
    places = re.findall(r"`([\w./]+\.(?:py|md))`", always)
    lists = re.findall(r"`([A-Z_]{4,})`", row)
    assert places or lists
    rooms = ("weberwhisk", "tests", "analyses")
    code = [p for f in rooms for p in (ROOT / f).rglob("*.py")]
    every = "\n".join(path.read_text("utf-8") for path in code)
    for name in lists:
        assert re.search(rf"^{name}\b.* = ", every, re.M), name
    for place in places:
        file = ROOT / place if (ROOT / place).exists() else ROOT / "weberwhisk" / place
        content = file.read_text("utf-8")
        if place.endswith("test_light.py"):
            continue  # compares two other places
        missing = [n for n in things()[kind] if not re.search(rf"(?<!\w){n}(?!\w)", content, re.I)]
        assert set(missing) <= OPTIONS.get(place, set()), (place, missing)


def test_files_and_functions_that_the_maintainers_page_names_exist() -> None:
    """Two had moved, which nobody saw."""
    text = (ROOT / "docs/maintainers.md").read_text("utf-8")
    ours = [ROOT / name for name in ("weberwhisk", "tests", "docs", "analyses")]
    files = ["/" + path.relative_to(ROOT).as_posix() for f in ours for path in f.rglob("*.py")]
    code = "\n".join(p.read_text("utf-8") for p in (ROOT / "weberwhisk").rglob("*.py"))
    named = set(re.findall(r"`([\w./]+)`", text))
    of_files = [name for name in named if name.endswith(".py")]
    of_code = [name for name in named if "." in name and "/" not in name and name not in of_files]
    missing = [name for name in of_files if not any(f.endswith("/" + name) for f in files)]
    missing += [name for name in of_code if not re.search(rf"\b{name.split('.')[-1]}\b", code)]
    assert len(of_files) > 40
    assert len(of_code) > 8
    assert not missing
