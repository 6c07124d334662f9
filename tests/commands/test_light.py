"""What a command imports: help no library of mathematics, an answer no more than it is made of."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from short_forms import slow_but

import weberwhisk as ww
from weberwhisk import cli
from weberwhisk.behaviour.effects import EFFECTS
from weberwhisk.design import LEVELS

HEAVY = (
    "arviz", "emcee", "IPython", "matplotlib", "matplotlib.pyplot", "pandas", "rich", "scipy",
    "scipy.stats",
)  # fmt: skip
CHOICES = Path(ww.__file__).parent / "data" / "numerosity_2afc.csv"
BEND = ("bend", "--identity", "C2", "--radial-distance-mm", "20", "--deflection-angle-deg", "10")


def loaded(*arguments: str) -> set[str]:
    """The heavy packages that are loaded when a command has ended."""
    code = (
        "import sys\nfrom weberwhisk.cli import app, run_app\n"
        "assert run_app(app, sys.argv[1:]) == 0\n"
        f"print(*(name for name in {HEAVY} if name in sys.modules), sep='\\n', file=sys.stderr)"
    )
    ended = subprocess.run(
        [sys.executable, "-c", code, *arguments], capture_output=True, text=True, check=True
    )
    return set(ended.stderr.split())


def test_help_imports_no_mathematics() -> None:
    """In one process, as none of them loads any."""
    code = (
        "import sys\nfrom weberwhisk.cli import app, run_app\n"
        "assert not any(run_app(app, [name, '--help']) for name in sys.argv[1:])\n"
        f"print(*(name for name in {HEAVY} if name in sys.modules), sep='\\n', file=sys.stderr)"
    )
    ended = subprocess.run(
        [sys.executable, "-c", code, *cli.COMMANDS], capture_output=True, text=True, check=True
    )
    assert ended.stdout.count("Usage:") == len(cli.COMMANDS)
    assert ended.stderr == "\n"


@pytest.mark.parametrize(
    ("arguments", "needed"),
    slow_but(
        [
            ((*BEND, "--json"), {"pandas"}),
            (("jnd", "--identity", "C2", "--draws", "2", "--json"), {"pandas", "scipy"}),
            (("simulate", "--json"), {"pandas", "scipy", "scipy.stats"}),
            (
                ("fit", str(CHOICES), "--subject", "s1", "--json"),
                {"pandas", "scipy", "scipy.stats"},
            ),
        ],
        (3,),
    ),
)
def test_an_answer_without_a_figure_imports_no_matplotlib(
    arguments: tuple[str, ...], needed: set[str]
) -> None:
    assert loaded(*arguments) == needed


def test_a_figure_imports_neither_pyplot_nor_distributions(tmp_path: Path) -> None:
    assert loaded(*BEND, "--out", str(tmp_path)) == {"pandas", "scipy", "matplotlib"}


def test_help_names_what_the_rooms_have(capsys: pytest.CaptureFixture[str]) -> None:
    """It is written without importing them."""
    cli.run_app(cli.app, ["fit", "--help"])
    effects = capsys.readouterr().out.split("What else moves the answers:")[1].split(";")[0]
    assert effects.replace(",", " ").split() == list(EFFECTS)
    cli.run_app(cli.app, ["design", "--help"])
    text = "".join(capsys.readouterr().out.split())
    assert f"[default:{','.join(f'{z:g}' for z in LEVELS)}]" in text
