"""The commands that the documentation and the README show are commands that there are."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
import typer

from weberwhisk.cli import app

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
