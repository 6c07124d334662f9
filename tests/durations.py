"""Which tests are dear: the CPU time that each takes, measured, and the list of those over a limit.

``python -m pytest --measure -n auto`` runs all but the full-length tests and writes `durations.txt`
again; of a folder or a file that is named, its part. It is CPU time, as wall time depends on what
else runs, and of children too, as some tests start processes. What a shared fixture takes counts
for every test that needs it: without the others, any of them has to wait for it.
"""

from __future__ import annotations

import ast
import os
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[1]
LIST = Path(__file__).with_name("durations.txt")
#: CPU seconds; of a test with parameters the mean of its cases.
LIMIT = 0.5
#: Tests that take longer and are quick all the same: the only ones of the quick tier that run a
#: plan's files, figures and analysis, tracked signals, a power, mixtures over shapes and noise, the
#: place of an object, contacts at which flank and tip alternate, and touches of one distance.
QUICK = {
    "tests/array/test_array.py::test_one_whisker_alone_says_what_its_posterior_says",
    "tests/design/test_power.py::test_power_is_that_of_a_brute_force_simulation",
    "tests/inference/test_touches.py::test_one_touch_is_todays_posterior",
    "tests/recordings/test_locate.py::test_own_names_units_signs_and_index",
    "tests/recordings/test_tracking_signals.py::test_a_session_gives_back_its_distances",
    "tests/sweeping/test_objects.py::test_a_wall_is_met_with_the_tip_then_with_the_flank",
    "weberwhisk/array/place.py::weberwhisk.array.place.place",
    "weberwhisk/design/plan.py::weberwhisk.design.plan.analyse",
    "weberwhisk/plots/designs.py::weberwhisk.plots.designs.rehearsed",
    "weberwhisk/plots/designs.py::weberwhisk.plots.designs.write_plan",
}
HEAD = f"""\
# Tests that take more than {LIMIT} s of CPU time, those with parameters in the mean of their cases:
# they are marked dear. Written by `python -m pytest --measure -n auto`.
"""


def dear() -> dict[str, float]:
    """CPU seconds of the tests that are dear, by node id without parameters."""
    rows = (line.split() for line in LIST.read_text("utf-8").splitlines() if line[0] != "#")
    return {name: float(seconds) for seconds, name in rows}


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
        self.seconds: dict[str, list[float]] = {}
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
            seconds = cpu_time() - self.start - self.in_shared + needed
            item.user_properties.append(("cpu_time", seconds))

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.when == "teardown":
            name = without_parameters(report.nodeid)
            seconds = [value for key, value in report.user_properties if key == "cpu_time"]
            self.seconds.setdefault(name, []).extend(seconds)

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        if hasattr(session.config, "workerinput"):  # the process that started it writes
            return
        means = {name: sum(each) / len(each) for name, each in self.seconds.items() if each}
        before = {name: s for name, s in dear().items() if name not in means and exists(name)}
        after = before | {name: seconds for name, seconds in means.items() if seconds > LIMIT}
        after = {name: seconds for name, seconds in after.items() if name not in QUICK}
        rows = (f"{seconds:6.1f} {name}\n" for name, seconds in sorted(after.items()))
        LIST.write_text(HEAD + "".join(rows), "utf-8")


def cpu_time() -> float:
    """Of this process and of those that it started and that ended, s."""
    return sum(os.times()[:4])
