"""What every test runs under."""

from __future__ import annotations

import os
import signal
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import hypothesis
import numpy as np
import pytest

HERE = Path(__file__).parent

# No window may open, and no terminal setting may change what the command line prints.
os.environ["MPLBACKEND"] = "agg"
for variable in ("COLUMNS", "FORCE_COLOR", "TTY_COMPATIBLE"):
    os.environ.pop(variable, None)
os.environ["NO_COLOR"] = "1"

# Run in the background of a script, interrupts are ignored, by all processes that tests start too.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# A property test judges an answer, never the time it took. The cases are the same in every run, so
# that a failure is of what was changed; `pytest -m slow` tries 75 times as many, new ones each
# time, and a failure prints a blob that repeats it (and `--hypothesis-seed` a whole run).
for name, examples in (("quick", 4), ("slow", 300)):
    hypothesis.settings.register_profile(
        name,
        deadline=None,
        database=None,
        derandomize=name == "quick",
        print_blob=True,
        max_examples=examples,
        suppress_health_check=[hypothesis.HealthCheck.too_slow],
    )


def pytest_configure(config: pytest.Config) -> None:
    """More cases of every property where the full-length tests are asked for."""
    config.option.loadscopereorder = False  # xdist's: files of many tests first, however short
    slow = "slow" in config.getoption("markexpr")
    hypothesis.settings.load_profile("slow" if slow else "quick")


@pytest.fixture
def search_seed(request: pytest.FixtureRequest) -> int:
    """The seed of a fault search: WEBERWHISK_SEARCH_SEED, else a new one with `pytest -m slow`.

    Otherwise always the same: what a new seed finds does not keep finished work from landing.
    """
    given = os.environ.get("WEBERWHISK_SEARCH_SEED")
    if given is not None:
        return int(given)
    fresh = "slow" in request.config.getoption("markexpr")
    return int(np.random.SeedSequence().generate_state(1)[0]) if fresh else 20110166


#: Files that CI runs on each Python: those of ArviZ, of what reads and writes, and of what a user
#: calls. The rest is arithmetic, which is run on one: doctests of every public name and these call
#: what another Python, NumPy or pandas may take away.
EACH = {
    "test_analyses", "test_arviz_io", "test_browser_pages", "test_cli", "test_comparison",
    "test_cues", "test_data_synthetic", "test_docs", "test_finish", "test_layers", "test_methods",
    "test_misuse", "test_protocols", "test_quickstart", "test_readme", "test_reading_outcomes",
    "test_runs", "test_shows", "test_threads", "test_trials", "test_whisker",
}  # fmt: skip


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """A second Python does not import what it runs nothing of: half a minute of CPU."""
    path = collection_path
    if "not once" not in config.getoption("markexpr") or not path.match("test_*.py"):
        return None
    return None if path.stem in EACH or "arviz" in path.read_text("utf-8") else True


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave the full-length tests to ``pytest -m slow``; say which a second Python may leave.

    Long files come first and doctests last, so that workers end together.
    """

    def tested_once(item: pytest.Item) -> bool:
        of_all = isinstance(item, pytest.DoctestItem) or item.path.stem in EACH
        return not of_all and "arviz" not in f"{item.name} {getattr(item, 'fixturenames', ())}"

    for item in filter(tested_once, items):
        item.add_marker("once")
    items.sort(key=lambda item: (isinstance(item, pytest.DoctestItem), item.path.stem in EACH))
    if "slow" in config.getoption("markexpr"):
        for item in items:
            if hypothesis.is_hypothesis_test(getattr(item, "obj", None)):
                item.add_marker("slow")
        return
    for item in items:
        if item.get_closest_marker("slow"):
            item.add_marker(pytest.mark.skip(reason="full length: `pytest -m slow` runs it"))


@pytest.fixture(autouse=True)
def _global_random_state_is_left_alone() -> Iterator[None]:
    """Nothing may draw from or reseed NumPy's global generator: randomness is an argument."""
    before = np.random.get_state(legacy=False)  # noqa: NPY002
    yield
    after = np.random.get_state(legacy=False)  # noqa: NPY002
    assert before["state"]["pos"] == after["state"]["pos"], "NumPy's global generator was used"
    np.testing.assert_array_equal(before["state"]["key"], after["state"]["key"])


@pytest.fixture(scope="session")
def arviz() -> Any:
    """ArviZ; on the first import of a day 0.23 announces its successor, and warnings are errors."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)
        import arviz
    return arviz
