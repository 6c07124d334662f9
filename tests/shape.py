"""The shape of a package: what imports what, how deep its calls go, which words its names use."""

from __future__ import annotations

import ast
import json
import subprocess
import sys
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

#: Words that say a name's role in a sentence rather than what it names, and what to write instead.
INSTEAD = {
    "own": "the thing itself: prior, scheme, encoding",
    "found": "the thing itself: solution, result, matches",
    "known": "the thing itself: given, fixed, is_finite",
    "held": "the thing itself: in_contact, fixed, kept_out",
    "other": "the thing itself: rival, second",
    "some": "the thing itself: subset",
    "wanted": "the thing itself: target, requested",
    "asked": "requested, question",
    "few": "the thing itself: first_runs",
    "apart": "separate, distance",
    "alike": "cluster, equal",
    "odd": "outlier",
    "sure": "support half-width, confidence",
    "told": "informed, discriminated, reported",
    "felt": "sensed",
    "turns": "limit depends on the nuisance",
    "bump": "conditional mode",
    "climb": "Fisher scoring",
    "leaves": "cells",
    "parts": "components",
    "spread": "coefficients, sd",
    "rows": "one-distance grid, readings, levels",
    "deep": "follow tails",
    "everywhere": "exhaustive",
    "rough": "truncated",
    "hidden": "unresolved",
    "leap": "discontinuity",
    "coarse": "under-resolved",
    "soft": "stiffness-scaled",
    "scaled": "rescaled",
    "hunt": "search",
    "referee": "independent reference",
    "astray": "biased",
}

# What is traced: calls of the package's functions, in every thread. Comprehensions are left out, as
# Python 3.12 has no frames for them, and modules, as all are imported before. The call is the first
# in its interpreter, so that it makes what later calls find ready.
TRACE = """
import importlib, json, pkgutil, sys, threading
import numpy as np, pandas as pd, weberwhisk as ww
from weberwhisk import array, behaviour, design, recordings, sensitivity
for module in pkgutil.walk_packages(ww.__path__, "weberwhisk."):
    if not module.name.startswith(("weberwhisk.cli", "weberwhisk.commands", "weberwhisk.plots")):
        importlib.import_module(module.name)
root = ww.__path__[0] + "/"
aside = {"<module>", "<listcomp>", "<dictcomp>", "<setcomp>", "<genexpr>"}
here, deepest, files, functions = threading.local(), [], set(), set()
def trace(frame, event, argument):
    code = frame.f_code
    if not code.co_filename.startswith(root) or code.co_name in aside:
        return
    stack = here.__dict__.setdefault("stack", [])
    if event == "call":
        stack.append(code)
        files.add(code.co_filename)
        functions.add(code)
        if len(stack) > len(deepest):
            deepest[:] = stack
    elif event == "return" and stack:
        stack.pop()
whisker = ww.Whisker(50e-3, 100e-6, 5e-6)
BEFORE
threading.setprofile(trace)
sys.setprofile(trace)
CALL
sys.setprofile(None)
names = [(code.co_filename.removeprefix(root), code.co_qualname) for code in deepest]
print(json.dumps([len(files), len(functions), names]))
"""

#: The call whose stack is measured, by what it is measured of, and what is made before it.
CALLS = {
    "posterior": (
        """
observer = ww.Observer(whisker, ww.cues.ForceMap(), ww.receptors.Weber(0.1))
readings = np.stack([observer.read([20e-3, 0.26], seed=i) for i in range(50)])""",
        "p = ww.posterior(observer, readings); p.mean, p.sd",
    ),
    "fit_weber": ("trials = ww.simulate_trials(seed=1)", "ww.fit_weber(trials)"),
    "power": (
        """
from weberwhisk.design import Scheme, power, taper
hypotheses = taper(whisker)
scheme = Scheme.spaced(hypotheses[0].encoding, [15e-3, 45e-3])""",
        "power(scheme, hypotheses, trials=[10], runs=16, workers=1)",
    ),
    "locate": (
        """
import dataclasses
whisker = dataclasses.replace(ww.Whisker.from_identity("C2"), curvature=0.0)
bent = ww.press(whisker, np.linspace(10e-3, 25e-3, 6), 0.3)
table = pd.DataFrame({"moment": bent.moment, "axial_force": bent.axial_force})""",
        "ww.locate(table, whisker)",
    ),
    "locate, curvature not given": (
        """
straight = ww.Whisker(50e-3, 100e-6, 5e-6, youngs_modulus=3e9, curvature=0)
bent = ww.press(straight, np.linspace(10e-3, 25e-3, 6), 0.3)
table = pd.DataFrame({"moment": bent.moment, "axial_force": bent.axial_force})""",
        "ww.locate(table, whisker, noise=0.1)",
    ),
    "jnd_curve": (
        "observer = ww.Observer(whisker, ww.cues.ForceMap(), ww.receptors.Weber(0.1))",
        "ww.sensitivity.jnd_curve(observer, [10e-3, 20e-3, 30e-3], 0.2)",
    ),
}


@dataclass(frozen=True)
class Walk:
    """The package's functions that one call runs: how many, and the deepest stack of them."""

    files: int
    functions: int
    stack: list[tuple[str, str]]  # file and function

    @property
    def stack_files(self) -> int:
        """Files on the deepest stack."""
        return len({file for file, _ in self.stack})

    def __str__(self) -> str:
        return (
            f"{len(self.stack)} calls deep through {self.stack_files} files; "
            f"{self.functions} functions of {self.files} files in all"
        )


def walk(package: Path, name: str) -> Walk:
    """The functions that one of `CALLS` runs, in a fresh interpreter."""
    before, call = CALLS[name]
    code = TRACE.replace("BEFORE", before).replace("CALL", call)
    ended = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", code],
        cwd=package.parent, env={"PYTHONPATH": str(package.parent), "OMP_NUM_THREADS": "1"},
        capture_output=True, text=True,
    )  # fmt: skip
    if ended.returncode:
        raise RuntimeError(f"{name} of {package} ended with: {ended.stderr}")
    return Walk(*json.loads(ended.stdout))


def dotted(path: Path, package: Path) -> str:
    """The name of a file's module, without that of the package."""
    parts = path.relative_to(package).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imports(path: Path, package: Path, modules: Mapping[str, Path]) -> Iterator[tuple[str, bool]]:
    """What a file imports: modules of the package by dotted name, others as ``/name``.

    Imports inside functions, for type checkers only and by `import_module` count too; with each
    comes whether it ever runs, which those for type checkers do not.
    """
    folder = dotted(path.parent / "__init__.py", package)
    here = [package.name, *folder.split(".")] if folder else [package.name]

    def resolve(name: str, level: int) -> list[str]:
        above = here[: len(here) + 1 - level] if level else []
        return above + (name.split(".") if name else [])

    tree = ast.parse(path.read_text("utf-8"))
    for_types = {
        inner
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and ast.unparse(node.test).endswith("TYPE_CHECKING")
        for statement in node.body
        for inner in ast.walk(statement)
    }
    for node in ast.walk(tree):
        targets: list[list[str]] = []
        if isinstance(node, ast.Import):
            targets = [resolve(alias.name, 0) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = resolve(node.module or "", node.level)
            for alias in node.names:
                if [*base, alias.name] == [package.name, "__version__"]:
                    continue
                is_module = ".".join([*base[1:], alias.name]) in modules
                targets.append([*base, alias.name] if is_module else base)
        elif isinstance(node, ast.Call) and node.args:
            called = node.func.attr if isinstance(node.func, ast.Attribute) else ""
            called = node.func.id if isinstance(node.func, ast.Name) else called
            first = node.args[0]
            if called in ("import_module", "__import__") and isinstance(first, ast.Constant):
                name = str(first.value)
                level = len(name) - len(name.lstrip("."))
                targets = [resolve(name.lstrip("."), level)]
        for target in targets:
            if target[0] == package.name:
                yield ".".join(target[1:]), node not in for_types
            else:
                yield f"/{target[0]}", node not in for_types


def modules(package: Path) -> dict[str, Path]:
    """Every module of a package by its dotted name."""
    return {dotted(path, package): path for path in sorted(package.rglob("*.py"))}


@cache
def graph_of_files(package: Path) -> dict[str, set[str]]:
    """What each module imports of the package."""
    files = modules(package)
    return {
        name: {
            target for target, _ in imports(path, package, files)
            if target in files and target != name
        }
        for name, path in files.items()
    }  # fmt: skip


def graph_of_rooms(package: Path) -> dict[str, set[str]]:
    """What each folder, or module beside the folders, imports of the package."""
    rooms: dict[str, set[str]] = defaultdict(set)
    for name, targets in graph_of_files(package).items():
        room = name.split(".")[0]
        rooms[room] |= {target.split(".")[0] for target in targets} - {room}
    return dict(rooms)


def circles(graph: Mapping[str, set[str]]) -> list[list[str]]:
    """Sets of nodes each of which leads to all others of its set."""
    reach: dict[str, set[str]] = {}
    for start in graph:
        reach[start], ahead = set(), [start]
        while ahead:
            new = graph.get(ahead.pop(), set()) - reach[start]
            reach[start] |= new
            ahead += new
    sets = {
        tuple(sorted(b for b in reach[a] if a in reach.get(b, ()))) for a in graph if a in reach[a]
    }
    return [list(nodes) for nodes in sorted(sets)]


def identifiers(path: Path) -> Counter[str]:
    """How often the identifiers of a file are words of `INSTEAD`, underscores aside."""
    count: Counter[str] = Counter()
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        name = None
        if isinstance(node, ast.Name):
            name = node.id
        elif isinstance(node, ast.arg | ast.keyword):
            name = node.arg
        elif isinstance(node, ast.Attribute):
            name = node.attr
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            name = node.name
        if name is not None and name.strip("_") in INSTEAD:
            count[name.strip("_")] += 1
    return count
