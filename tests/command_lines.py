"""What tests of the command line share: arguments, and what a command answers or refuses."""

from __future__ import annotations

import json

import pandas as pd
import pytest

from weberwhisk import cli
from weberwhisk.cli import run_app

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
