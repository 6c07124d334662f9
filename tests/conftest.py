"""What every test runs under."""

from __future__ import annotations

import os
import re
import signal
import warnings
from collections import Counter
from collections.abc import Iterator
from typing import Any

import durations
import hypothesis
import numpy as np
import pytest

# No window may open, and no terminal setting may change what the command line prints.
os.environ["MPLBACKEND"] = "agg"
for variable in ("COLUMNS", "FORCE_COLOR", "TTY_COMPATIBLE"):
    os.environ.pop(variable, None)
os.environ["NO_COLOR"] = "1"

# Run in the background of a script, interrupts are ignored, by all processes that tests start too.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--measure", action="store_true", help=durations.__doc__.splitlines()[0])


def pytest_configure(config: pytest.Config) -> None:
    """Which tests run: without `-m` and names of tests the quick ones, of what is named all.

    But for the slow ones, which `-m slow` runs.
    """
    config.option.loadscopereorder = False  # xdist's: files of many tests first, however short
    if config.option.measure:
        config.pluginmanager.register(durations.Measure())
    if not config.option.markexpr:
        all_rooms = config.args_source is config.ArgsSource.TESTPATHS and not config.option.keyword
        quick = all_rooms and not config.option.measure
        config.option.markexpr = "not dear and not slow" if quick else "not slow"
    # A property test judges an answer, never the time it took. The cases are the same in every run,
    # so that a failure is of what was changed; `-m slow` tries 75 times as many, new ones each
    # time, and a failure prints a blob that repeats it (and `--hypothesis-seed` a whole run).
    hypothesis.settings.register_profile(
        "here",
        deadline=None,
        database=None,
        derandomize=not _full_length(config),
        print_blob=True,
        max_examples=300 if _full_length(config) else 4,
        suppress_health_check=[hypothesis.HealthCheck.too_slow],
    )
    hypothesis.settings.load_profile("here")


def _full_length(config: pytest.Config) -> bool:
    return re.search(r"(?<!not )\bslow\b", config.option.markexpr) is not None


@pytest.fixture
def search_seed(request: pytest.FixtureRequest) -> int:
    """The seed of a fault search: WEBERWHISK_SEARCH_SEED, else a new one with `pytest -m slow`.

    Otherwise always the same: what a new seed finds does not keep finished work from landing.
    """
    given = os.environ.get("WEBERWHISK_SEARCH_SEED")
    if given is not None:
        return int(given)
    fresh = _full_length(request.config)
    return int(np.random.SeedSequence().generate_state(1)[0]) if fresh else 20110166


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Mark what took long when it was measured as dear, and what has a full-length form as slow.

    Files that take long come first and doctests last, so that workers end together.
    """
    dear, of_file = durations.dear(), Counter[str]()
    for name, seconds in dear.items():
        of_file[name.partition("::")[0]] += seconds
    for item in items:
        if _full_length(config) and hypothesis.is_hypothesis_test(getattr(item, "obj", None)):
            item.add_marker("slow")
        measured = durations.without_parameters(item.nodeid) in dear
        if measured and not item.get_closest_marker("slow"):
            item.add_marker("dear")

    def order(item: pytest.Item) -> tuple[bool, float]:
        return isinstance(item, pytest.DoctestItem), -of_file[item.nodeid.partition("::")[0]]

    items.sort(key=order)


@pytest.fixture(autouse=True)
def _global_random_state_is_left_alone() -> Iterator[None]:
    """Nothing may draw from or reseed NumPy's global generator: randomness is an argument."""
    before = np.random.get_state(legacy=False)  # noqa: NPY002
    yield
    after = np.random.get_state(legacy=False)  # noqa: NPY002
    assert before["state"]["pos"] == after["state"]["pos"], "NumPy's global generator was used"
    np.testing.assert_array_equal(before["state"]["key"], after["state"]["key"])


@pytest.fixture
def few_draws(monkeypatch: pytest.MonkeyPatch) -> None:
    """A quarter of the draws from a fit, for tests of commands and pages, not of estimates."""
    from weberwhisk.behaviour.quadrature import QuadraturePosterior

    monkeypatch.setattr(QuadraturePosterior.__init__, "__defaults__", (0, 1000, 4))


@pytest.fixture(scope="session")
def arviz() -> Any:
    """ArviZ; on the first import of a day 0.23 announces its successor, and warnings are errors."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)
        import arviz
    return arviz
