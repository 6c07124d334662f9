"""What the command line says of the package's refusals and advice."""

from __future__ import annotations

import ast
import inspect
import re
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path

import pytest
import scipy.stats
import typer
from test_misuse import MISUSES, RECEPTOR_AND_CUE_MISUSES

import weberwhisk as ww
from weberwhisk import commands
from weberwhisk._util.refusals import Refusal, argument, call, named
from weberwhisk.behaviour.effects import Covariate, Drift
from weberwhisk.cli import COMMANDS, app

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
#: Of pytest, of scripts in `analyses/` and of the builder of the pages for a browser.
OF_OTHERS = {"--short", "--pyodide", "--workers", "--dist"}
OPTION = re.compile(r"(?<![\w-])--[a-z][a-z-]*")


@cache
def parameters(command: str) -> dict[str, set[str]]:
    """The parameters of a command, with their options."""
    group = typer.main.get_command(app)
    return {
        p.name: {*p.opts, *p.secondary_opts}
        for p in group.commands[command].params  # type: ignore[attr-defined]
    }


@cache
def options(*names: str) -> set[str]:
    every = [of for name in names or COMMANDS for of in parameters(name).values()]
    return set().union(*every, {"--help", "--version"})


@contextmanager
def running(command: str) -> Iterator[None]:
    before = commands._here.set(frozenset(parameters(command)))
    try:
        yield
    finally:
        commands._here.reset(before)


@cache
def refusals() -> list[Refusal]:
    made = []
    for work, _ in (*MISUSES, *RECEPTOR_AND_CUE_MISUSES):
        with pytest.raises(Refusal) as caught:
            work()
        made.append(caught.value)
    return made


def named_in(tree: ast.AST) -> list[tuple[int, str]]:
    """The options that texts of a piece of code name, with their lines."""
    return [
        (node.lineno, name)
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
        for name in OPTION.findall(node.value)
    ]


def test_every_option_that_a_text_of_the_package_names_exists() -> None:
    wrong = [
        f"{path.name}:{line}: {name}"
        for path in sorted(Path(ww.__file__).parent.rglob("*.py"))
        for line, name in named_in(ast.parse(path.read_text("utf-8")))
        if name not in options()
    ]
    assert not wrong, wrong


def test_a_command_names_its_own_options_alone() -> None:
    """And those of a command that it writes out; shared code, options of the module's commands."""
    for path in {Path(inspect.getfile(inspect.unwrap(of))) for of in COMMANDS.values()}:
        tree = ast.parse(path.read_text("utf-8"))
        mine = {inspect.unwrap(of).__name__: name for name, of in COMMANDS.items()
                if Path(inspect.getfile(inspect.unwrap(of))) == path}  # fmt: skip
        for node in tree.body:
            command = mine.get(getattr(node, "name", ""))
            written = {*re.findall(r"weberwhisk ([a-z]+)", ast.unparse(node))} & {*COMMANDS}
            there = options(*([command] if command else mine.values()), *written)
            wrong = [f"{path.name}:{line}: {name}" for line, name in named_in(node)
                     if name not in there]  # fmt: skip
            assert not wrong, wrong


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_option_that_a_page_names_exists(page: Path) -> None:
    text = re.sub(r"^```.*?^```", "", page.read_text("utf-8"), flags=re.M | re.S)
    named = re.findall(r"`(--[a-z][a-z-]*)[^`]*`", text)
    assert set(named) - options() - OF_OTHERS == set()


def test_parameters_of_another_name_have_options() -> None:
    known = {parameter for command in COMMANDS for parameter in parameters(command)}
    assert {spelled.option for spelled in commands.SPELLED.values()} <= known


@pytest.mark.parametrize("command", COMMANDS)
def test_a_refusal_names_options_of_the_command_alone(command: str) -> None:
    with running(command):
        for refusal in refusals():
            said = str(refusal.rendered(commands._as_typed))
            assert {*OPTION.findall(said)} - {*OPTION.findall(str(refusal))} <= options(command)


FEW = scipy.stats.beta(1, 20)
SAID = [
    ("fit", argument("columns", {"standard": "my col"}), "--column standard='my col'"),
    ("fit", argument("columns", {"n": ...}), "--column n='<its name>'"),
    ("fit", argument("choice_labels", {"L": "first", "R": "none"}),
     "--label L=first --label R=none"),
    ("fit", argument("priors", {"lapse_low": FEW, "lapse_high": FEW}),
     "--prior lapse_low='beta(1, 20)' --prior lapse_high='beta(1, 20)'"),
    ("fit", argument("priors", {"lapse_low": 0.02, "weber_fraction": "levels"}),
     "--prior lapse_low=0.02 --prior weber_fraction=levels"),
    ("next", argument("priors", {"bias": scipy.stats.norm(0, 5)}), "--prior bias='norm(0, 5)'"),
    ("fit", argument("bias", "per standard"), "--bias 'per standard'"),
    ("fit", call("fit_weber", "trials", argument("effects", [Drift(), Covariate("a b")]),
                 argument("states", 3), also=", with an import"),
     "--effect drift --effect 'covariate:a b' --states 3"),
    ("fit", call("trials.select", argument("session", 31)), "--session 31"),
    ("analyse", call("trials.select", argument("session", 31)), "trials.select(session=31)"),
    ("design", argument("together", False), "--apart"),
    ("fit", argument("together", False), "together=False"),
    ("jnd", argument("curved", True), "--curvature-per-m own"),
    ("jnd", named("curvature"), "--curvature-per-m"),
    ("locate", argument("identity", 2, of="tracked_signals"), "--label 2"),
    ("locate", argument("noise", 0.1, of="locate"), "--weber-fraction 0.1"),
    ("locate", call("read_tracking", argument("shortest_px", ...)), "--shortest-px"),
    ("locate", call("ww.tracked_signals", call("ww.read_tracking", "file",
                    argument("pixels_per_mm", 20), argument("frame_rate", 500)), "whisker"),
     "--pixels-per-mm 20 --frame-rate 500"),
    ("calibrate", argument("counts", True), "--counts"),
]  # fmt: skip


@pytest.mark.parametrize(("command", "said", "typed"), SAID)
def test_what_can_be_typed_is_said_as_options(command: str, said: str, typed: str) -> None:
    with running(command):
        assert commands.as_options("write " + said + ", say") == f"write {typed}, say"
