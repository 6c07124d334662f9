"""What every test runs under."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
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
# that a failure is of what was changed; `pytest -m slow` tries fifty times as many, new ones each
# time, and a failure prints a blob that repeats it (and `--hypothesis-seed` a whole run).
for name, examples in (("quick", 6), ("slow", 300)):
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


#: Files of long arithmetic in which ArviZ has no part: CI runs them on one Python alone. What
#: another Python, NumPy or pandas may take away, doctests of every public name and the rest call.
ONCE = {
    "test_adaptive", "test_all_cues", "test_along_whisk", "test_array", "test_browser",
    "test_calibration", "test_campaign", "test_charts", "test_cli_design", "test_closed_form",
    "test_contact_calibration", "test_coverage", "test_criticism", "test_cue_angle_side_angle",
    "test_cue_balance_of_moments", "test_cue_compliance", "test_cue_force_map", "test_cue_fused",
    "test_cue_space_map", "test_cue_sweep", "test_cue_vibration", "test_cue_vibrissa_length",
    "test_design_information", "test_domain", "test_effects", "test_elastica",
    "test_emcee_hard_cases", "test_ensemble", "test_events", "test_factors", "test_figures",
    "test_fuzz", "test_fuzz_commands", "test_grid", "test_hinge", "test_integrate", "test_jnd",
    "test_jnd_sweep", "test_ladder", "test_lapse_prior", "test_limits", "test_memory", "test_modes",
    "test_muscle", "test_objects", "test_paper", "test_paper_figures", "test_pathology",
    "test_placement", "test_plan", "test_pooled", "test_power", "test_profile", "test_properties",
    "test_properties_choices", "test_properties_design", "test_properties_inference",
    "test_properties_scenes", "test_real_whiskers", "test_receptors", "test_referees",
    "test_rehearse", "test_ridge_status", "test_rod", "test_scale_out", "test_scene_costs",
    "test_second_peak", "test_session", "test_spike_count", "test_stability",
    "test_stability_three", "test_surface", "test_tasks", "test_three_unknowns", "test_tiling",
    "test_weber_2d",
}  # fmt: skip


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave the full-length tests to ``pytest -m slow``; say which a second Python may leave.

    Long files come first and doctests last, so that workers end together.
    """
    for item in items:
        if item.path.stem in ONCE:
            item.add_marker("once")
    items.sort(key=lambda item: (isinstance(item, pytest.DoctestItem), item.path.stem not in ONCE))
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


@pytest.fixture(scope="session")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """A scheduler, and two worker processes that are replaced when they die."""
    pytest.importorskip("distributed")
    folder = tmp_path_factory.mktemp("cluster")
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join(
            [str(HERE), *(str(HERE.parent / f) for f in ("", "analyses")), *sys.path]
        ),
        "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "2",
        # It stands idle until the last test has run, at a third of what watching itself costs.
        "DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED": "false",
        "DASK_DISTRIBUTED__ADMIN__TICK__INTERVAL": "500ms",
    }
    file = folder / "scheduler.json"
    where = ["--host", "127.0.0.1", "--no-dashboard", "--scheduler-file", str(file)]
    commands = [
        ["scheduler", "--port", "0", *where],
        ["worker", "--nworkers", "2", "--nthreads", "1", "--no-dashboard",
         "--scheduler-file", str(file), "--local-directory", str(folder)],
    ]  # fmt: skip
    processes = [
        subprocess.Popen(
            [sys.executable, "-m", "dask", *c], env=environment, cwd=folder,
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )
        for c in commands
    ]  # fmt: skip
    try:
        while not file.exists():
            assert processes[0].poll() is None
            time.sleep(0.05)
        yield json.loads(file.read_text())["address"]
    finally:
        for process in reversed(processes):
            process.terminate()
            process.wait()
