"""Which tests are dear: the CPU time that each takes, measured, and the list of those over a limit.

``python -m pytest --measure -n auto`` runs all but the full-length tests and writes `durations.txt`
again; of a folder or a file that is named, its part. It is CPU time, as wall time depends on what
else runs, and of children too, as some tests start processes. What a shared fixture takes counts
for every test that needs it: without the others, any of them has to wait for it.

The quick tier is what lies under the limit and `quick.txt`: those of the others that reach most
statements of the package a second, up to the share that the README promises and some more. Choose
them again with coverage and pytest-cov installed::

    python -m pytest -m "not slow" -n auto --cov=weberwhisk --cov-context=test --cov-report=
    python tests/durations.py .coverage
"""

from __future__ import annotations

import ast
import os
import sys
from collections import defaultdict
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[1]
LIST = Path(__file__).with_name("durations.txt")
QUICK = Path(__file__).with_name("quick.txt")
#: CPU seconds; of a test with parameters the mean of its cases.
LIMIT = 0.25
#: Share of the package's statements that the quick tier reached when its tests were chosen.
SHARE = 0.93
HEAD = f"""\
# Tests that take more than {LIMIT} s of CPU time, those with parameters in the mean of their cases:
# they are dear, but for those of quick.txt. The second column is what all cases took together, with
# a shared fixture where it was made. Written by `python -m pytest --measure -n auto`.
"""


def measured() -> dict[str, tuple[float, float]]:
    """CPU seconds of a case and of all, of the tests over the limit, without parameters."""
    rows = (line.split() for line in LIST.read_text("utf-8").splitlines() if line[0] != "#")
    return {name: (float(case), float(all_cases)) for case, all_cases, name in rows}


def quick() -> list[str]:
    """Tests over the limit that are quick all the same."""
    return [line for line in QUICK.read_text("utf-8").splitlines() if line[0] != "#"]


def dear() -> dict[str, float]:
    """CPU seconds of all cases of the tests that are dear."""
    kept = {*quick()}
    return {name: seconds for name, (_, seconds) in measured().items() if name not in kept}


def choose(file: str) -> tuple[list[str], float]:
    """The tests for `quick.txt` by a file of coverage with a context a test, and their share."""
    import coverage

    data = coverage.CoverageData(file)
    data.read()
    analysis = coverage.Coverage(data_file=file)
    analysis.load()
    seconds = {name: max(row) for name, row in measured().items()}
    reached, left = set[tuple[str, int]](), defaultdict[str, set[tuple[str, int]]](set)
    over, count = {*seconds}, 0
    for path in data.measured_files():
        statements = {*analysis.analysis2(path)[1]}
        count += len(statements)
        for line, contexts in data.contexts_by_lineno(path).items():
            names = {without_parameters(context.partition("|")[0]) for context in contexts}
            if line not in statements:
                continue
            if names <= over:
                for name in names:
                    left[name].add((path, line))
            else:  # at import, or by a test under the limit
                reached.add((path, line))
    chosen: list[str] = []
    while left and len(reached) < SHARE * count:
        best = max(left, key=lambda name: len(left[name] - reached) / seconds[name])
        chosen.append(best)
        reached |= left.pop(best)
    return sorted(chosen), len(reached) / count


def without_parameters(node_id: str) -> str:
    return node_id.partition("[")[0]


@lru_cache
def _defined(path: Path) -> frozenset[str]:
    tree = ast.parse(path.read_text("utf-8")) if path.exists() else ast.Module([], [])
    kinds = ast.FunctionDef | ast.ClassDef
    return frozenset(node.name for node in ast.walk(tree) if isinstance(node, kinds))


def exists(name: str) -> bool:
    """Whether a test of the list is still there: its file, and a function or class of that name."""
    path, _, test = name.partition("::")
    module = path.removesuffix("/__init__.py").removesuffix(".py").replace("/", ".")
    return test == module or test.rpartition(".")[2] in _defined(ROOT / path)


class Measure:
    """A plugin that measures the tests that run, and writes the list at the end."""

    def __init__(self) -> None:
        self.seconds: dict[str, list[float]] = {}  # with the shared fixtures of each
        self.own: dict[str, list[float]] = {}  # as they ran
        self.shared: dict[tuple[str, str], float] = {}
        self.start = self.in_shared = 0.0
        self.depth = 0

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: Any, request: Any) -> Iterator[None]:
        if fixturedef.scope == "function" or self.depth:
            return (yield)
        self.depth, start = 1, cpu_time()
        try:
            return (yield)
        finally:
            self.depth, seconds = 0, cpu_time() - start
            self.in_shared += seconds
            self.shared[request.node.nodeid, fixturedef.argname] = seconds

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_setup(self, item: pytest.Item) -> Iterator[None]:
        self.start, self.in_shared = cpu_time(), 0.0
        return (yield)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_teardown(self, item: pytest.Item) -> Iterator[None]:
        try:
            return (yield)
        finally:
            names, places = getattr(item, "fixturenames", ()), [n.nodeid for n in item.listchain()]
            needed = sum(self.shared.get((at, n), 0.0) for at in places for n in names)
            own = cpu_time() - self.start
            item.user_properties.append(("cpu_time", (own - self.in_shared + needed, own)))

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.when == "teardown":
            name = without_parameters(report.nodeid)
            for seconds, own in (v for key, v in report.user_properties if key == "cpu_time"):
                self.seconds.setdefault(name, []).append(seconds)
                self.own.setdefault(name, []).append(own)

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        if hasattr(session.config, "workerinput"):  # the process that started it writes
            return
        before = {name: row for name, row in measured().items() if exists(name)}
        for name, cases in self.seconds.items():
            before.pop(name, None)
            if cases and (mean := sum(cases) / len(cases)) > LIMIT:
                before[name] = mean, sum(self.own[name])
        rows = (f"{a:6.2f} {b:6.1f} {name}\n" for name, (a, b) in sorted(before.items()))
        LIST.write_text(HEAD + "".join(rows), "utf-8")


def cpu_time() -> float:
    """Of this process and of those that it started and that ended, s."""
    return sum(os.times()[:4])


if __name__ == "__main__":
    names, share = choose(sys.argv[1])
    head = (
        f"# Dear tests of the quick tier, which reached {share:.1%} of the statements with them.\n"
    )
    QUICK.write_text(head + "".join(f"{name}\n" for name in names), "utf-8")
