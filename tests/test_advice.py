"""What a sentence of the package gives to type works as it stands."""

from __future__ import annotations

import ast
import importlib
import inspect
import re
import shlex
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from shutil import copy
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
import scipy.stats
from short_forms import slow_but
from test_misuse import MISUSES, RECEPTOR_AND_CUE_MISUSES

import weberwhisk as ww
from weberwhisk._util.refusals import in_code
from weberwhisk.cli import app, run_app

ROOT = Path(__file__).parents[1]
PACKAGE = Path(ww.__file__).parent
#: A value that only the sentence knows when it is said.
VALUE = "VALUE_"


def sentences() -> Iterator[tuple[str, str]]:
    """Every string of the package that is no docstring, with its place."""
    for path in sorted(PACKAGE.rglob("*.py")):
        if path.parent.name == "commands":
            continue  # those are followed below
        tree = ast.parse(path.read_text("utf-8"))
        inside = set()
        for node in ast.walk(tree):
            inside.update(node.values if isinstance(node, ast.JoinedStr) else ())
            inside.update([node.value] if isinstance(node, ast.Expr) else ())
            inside.update(node.args if is_piece(node) else ())
        for node in ast.walk(tree):
            at = f"{path.relative_to(PACKAGE)}:{getattr(node, 'lineno', 0)}"
            if isinstance(node, ast.JoinedStr):
                parts = [str(getattr(part, "value", "")) if isinstance(part, ast.Constant)
                         else VALUE for part in node.values]  # fmt: skip
                yield at, "".join(parts)
            elif isinstance(getattr(node, "value", None), str) and node not in inside:
                yield at, node.value
            elif is_piece(node) and node not in inside:
                yield at, f"write {as_said(node)}"


def is_piece(node: ast.AST) -> bool:
    """Whether this makes an argument or a call that advice gives to type."""
    return isinstance(node, ast.Call) and getattr(node.func, "id", "") in ("argument", "call")


def as_said(node: Any) -> str:
    """What such a piece says in Python."""
    if not is_piece(node):
        return f"*{VALUE}" if isinstance(node, ast.Starred) else VALUE
    first, *others = node.args
    name = first.value if isinstance(first, ast.Constant) else VALUE
    if node.func.id == "call":
        texts = (n.value if isinstance(n, ast.Constant) else as_said(n) for n in others)
        return f"{name}({', '.join(texts)})"
    try:
        value = in_code(ast.literal_eval(others[0])).replace("…", VALUE)
    except ValueError:
        value = VALUE
    return f"{name}={value}"


def given_code(sentence: str) -> Iterator[str]:
    """The code that a sentence gives: after these words, the longest part that parses."""
    words = r"\b(?:[Ww]rite|[Tt]ake|[Gg]ive|[Uu]se|or|as|with|cue|grows,|noise) (?=\S)"
    for found in re.finditer(words, sentence):
        rest = re.split(r", say\b", sentence[found.end() :])[0]
        for end in range(len(rest), 0, -1):
            code = rest[:end]
            outside = re.sub(r"\([^()]*\)|\[[^]]*\]|\{[^}]*\}|'[^']*'|\"[^\"]*\"", "", code)
            if re.match(r"\w\w", rest[end - 1 : end + 1]) or re.search(r"[, ]", outside):
                continue
            code = code if re.search(r"[^.]\.{3}$", code) else code.rstrip(".")
            is_keyword = re.match(r"\w+=[^=]", code)
            try:
                tree = ast.parse(f"dict({code})" if is_keyword else code, mode="eval")
            except (SyntaxError, ValueError):
                continue
            if is_keyword or (is_a_call(tree) and code[-1] in ")]}"):
                yield code
            break


def is_a_call(tree: ast.Expression) -> bool:
    return any(isinstance(node, ast.Call) for node in ast.walk(tree))


def is_numpy(function: object) -> bool:
    return isinstance(function, np.ufunc) or function in (np.linspace, scipy.stats.uniform)


def all_advice() -> Iterator[tuple[str, str, str]]:
    seen = set()
    for at, sentence in sentences():
        for code in given_code(sentence):
            if code not in seen or "from weber" in sentence:
                seen.add(code)
                yield at, code, sentence
    for work, _ in (*MISUSES, *RECEPTOR_AND_CUE_MISUSES):
        with pytest.raises(ValueError) as caught:  # noqa: PT011
            work()
        for code in given_code(str(caught.value)):
            yield "said", code, str(caught.value)
    for curved in (False, True):
        c2 = ww.Whisker.from_identity("C2", curved=curved)
        note = ww.Observer(c2, ww.cues.ForceMap()).note
        yield from (("note", code, note) for code in given_code(note))


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """What a user has who meets a sentence: the imports of the README, and what it speaks of."""
    whisker = ww.Whisker(50e-3, 100e-6, 5e-6, curvature=0)
    observer = ww.Observer(whisker, ww.cues.Compliance())
    trials = ww.simulate_trials(trials_per_level=3, seed=1)
    fit = ww.fit_weber(trials)
    table = trials.table()
    file = tmp_path_factory.mktemp("advice") / "file.csv"
    table.to_csv(file, index=False)
    r = np.repeat(np.linspace(10e-3, 40e-3, 7), 3)
    taps = {"radial_distance_mm": 1e3 * r, "moment_rate": observer.read(r[:, None], seed=1)[:, 0]}
    rows = {"angular_velocity": 1.0, "touch": range(2), "moment_rate": taps["moment_rate"][:2]}
    contacts = pd.DataFrame(rows)
    return {
        "ww": ww, "np": np, "pandas": pd, "scipy": scipy, "whisker": whisker, "cue": observer.cue,
        "observer": observer, "reading": observer.read([20e-3], seed=1), "trials": trials,
        "readings": [[1e-6, 1e-6, 1e-4, 1e-4, 1e-6, 1e-6]], "fit": fit, "other": fit,
        "table": table, "file": str(file), "contacts": contacts,
        "slopes": contacts.drop(columns="angular_velocity"),
        "calibration": ww.calibrate(pd.DataFrame(taps), whisker),
        "draws": SimpleNamespace(effects=None),  # the argument that the sentence is about
        "encoding": ww.behaviour.CueEncoding(observer), "array": ww.WhiskerArray("rat"),
        "scheme": ww.design.Scheme([20e-3], [-2e-3, 2e-3]),
        "fused": ww.cues.Fused(ww.cues.Compliance(), ww.cues.ForceMap("moment")),
        "arc_length": 30e-3, "force": 1e-5, "direction": 0.1,
    }  # fmt: skip


def keywords() -> set[str]:
    """The parameters of everything public."""
    found: set[str] = set()
    rooms = [room for name in ww.__all__ if inspect.ismodule(room := getattr(ww, name))]
    for value in (getattr(room, name) for room in (ww, *rooms) for name in room.__all__):
        methods = vars(value).values() if inspect.isclass(value) else ()
        for one in filter(inspect.isfunction, (value, getattr(value, "__init__", None), *methods)):
            found |= set(inspect.signature(one).parameters)
    return found


def test_what_a_sentence_gives_to_type_runs_as_it_stands(
    session: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where values are known only when it is said, names and parameters are some that there are."""
    monkeypatch.chdir(tmp_path)
    for name in ("file.csv", "a.csv"):
        session["table"].to_csv(name, index=False)
    known, wrong, lines = keywords(), [], 0
    for at, code, sentence in all_advice():
        lines += 1
        names = {name: getattr(ww, name) for name in ww.__all__} | session
        names |= {"table": session["slopes"]} if "recordings" in at else {}
        for module in re.findall(r"from (weberwhisk[\w.]*\w)", sentence):
            names |= vars(importlib.import_module(module))
        keyword = re.match(r"(\w+)=[^=]", code)
        tree = ast.parse(f"dict({code})" if keyword else code, mode="eval")
        if keyword and VALUE not in keyword[1] and keyword[1] not in known:
            wrong.append(f"{at}: nothing takes {code}")
        try:
            if VALUE in code or "..." in code:
                for node in ast.walk(tree):
                    if isinstance(node, ast.Call) and VALUE not in ast.unparse(node.func):
                        called = eval(ast.unparse(node.func), names)
                        given = {k.arg: None for k in node.keywords if k.arg}
                        if called is not dict and callable(called) and not is_numpy(called):
                            inspect.signature(called).bind_partial(**given)
            else:
                eval(code if not keyword else f"dict({code})", names)
        except Exception as error:
            wrong.append(f"{at}: {code}: {type(error).__name__}: {error}")
    assert not wrong, "\n".join(wrong)
    assert lines > 100


def advised(said: str, own: dict[str, str]) -> dict[str, str]:
    """The options that a refusal gives to type, with values; whose columns these are a user knows.

    The first of several ways; an option that is named without a value is none to type.
    """
    said = re.split(r", or --|; leave ", said.strip())[0]
    found = {}
    if bare := re.match(r"weberwhisk: (--[a-z-]+) .*; write (\d[\d.,]*\d)", said):
        found[f"{bare[1]} "] = bare[2]
    pattern = (
        r"(--[a-z-]+) ([a-z]\w+=)?('[^']*'|\d[\d.,]*|[A-Z]\w*|(?<==)[\w.]+|\w+(?=, say|\.$|$))"
    )
    for name, key, value in re.findall(pattern, said, re.MULTILINE):
        value = value.strip("'").rstrip(".,")
        found[f"{name} {key}"] = own.get(key[:-1], value) if "<" in value else value
    return found


OWN = {"stimulus_1": "ref", "stimulus_2": "test", "comparison": "test", "choice": "answer"}
FOLLOWED = [
    "fit own.csv",
    "fit own.csv --column standard=ref",
    "fit own.csv --column standard=ref --column comparison=test --column choice=answers",
    "fit six.csv",
    "fit six.csv --subject 1 --column subject=animal",
    "fit six.csv --subject s1 --lapse-prior 0",
    "bend --radial-distance-mm 20 --deflection-angle-deg 10",
    "jnd --draws 1",
    "locate tracked.csv",
    "simulate --identity C2",
]


@pytest.mark.parametrize("line", slow_but(FOLLOWED, (0,)))
def test_who_types_what_a_refusal_gives_gets_a_result(
    line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    table = ww.simulate_trials(trials_per_level=3, seed=1).table()[
        ["stimulus_1", "stimulus_2", "choice"]
    ]
    table.rename(columns=OWN).to_csv("own.csv", index=False)
    copy(ROOT / "data_synthetic" / "animals_six.csv", "six.csv")
    copy(ROOT / "data_synthetic" / "tracked_session.csv", "tracked.csv")
    words = shlex.split(line)
    typed = {}
    for name, value in pairwise(words):
        if name.startswith("--"):
            key, sign, rest = value.rpartition("=")
            typed[f"{name} {key}{sign}"] = rest
    start = [word for word in words[:2] if not word.startswith("-")]
    for _ in range(5):
        options = [f"{name}{value}" for name, value in typed.items()]
        split = [word for one in options for word in one.split(" ", 1)]
        status = run_app(app, [*start, *split, "--json"])
        said = capsys.readouterr().err
        if status == 0:
            return
        typed |= advised(said, OWN)
    pytest.fail(f"{start} {typed}: {said}")
