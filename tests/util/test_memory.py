"""Memory stays bounded: what a large call needs beside its result does not grow with it."""

from __future__ import annotations

import subprocess
import sys

import pytest
from short_forms import slow_but

pytest.importorskip("resource")

MEASURED = """
import resource, sys
import numpy as np
import weberwhisk as ww
from weberwhisk.behaviour import fit_weber, read_trials, simulate_trials

w = ww.Whisker(50e-3, 100e-6, 5e-6)
tap = ww.Observer(w, ww.cues.Compliance())

def call(what, n):
    r = np.linspace(5e-3, 45e-3, n)
    if what == "press":
        return ww.press(w, r, 0.1)
    if what == "bend":
        return ww.bend(w, r, 1e-6)
    if what == "flick past":
        return ww.flick_past(w, r)
    if what == "choose":
        return ww.choose_model(w, r, 0.1)
    if what == "posterior":
        return ww.posterior(tap, tap.read(r[:, None], 1))
    trials = simulate_trials(trials_per_level=max(n // 9, 1), sessions=10, seed=1)
    trials = read_trials(trials.table())
    return fit_weber(trials).report()

def peak():
    size = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return size if sys.platform == "darwin" else 1024 * size

what, n = sys.argv[1], int(sys.argv[2])
call(what, 300)
before = peak()
result = call(what, n)
print(peak() - before)
"""

#: Bytes a scene of the result and of what is broadcast for it: eight numbers, the error and two
#: codes of a `Bending` are 74; a `FlickPast` holds two, a `Choice` two numbers for each model.
BYTES = {"press": 130, "bend": 130, "flick past": 280, "choose": 360, "posterior": 150}
#: What is at work at any one time, however large the call.
AT_WORK = {"choose": 250e6, "trials": 200e6}


def grown(what: str, n: int) -> float:
    """Bytes by which a call raises the peak of its process."""
    ended = subprocess.run(
        [sys.executable, "-c", MEASURED, what, str(n)], capture_output=True, text=True
    )
    assert ended.returncode == 0, ended.stderr
    return float(ended.stdout)


def check(what: str, n: int) -> None:
    assert grown(what, n) < AT_WORK.get(what, 60e6) + BYTES.get(what, 500) * n


@pytest.mark.parametrize("what", slow_but(["flick past", "posterior"], (0,)))
@pytest.mark.slow
def test_many_scenes(what: str) -> None:
    """Flick-past angles took 1.1 kB a scene."""
    check(what, 100_000)


@pytest.mark.slow
def test_many_trials() -> None:
    """The checks of a report took 16 kB a trial."""
    check("trials", 20_000)


@pytest.mark.slow
@pytest.mark.parametrize("what", ["press", "bend", "flick past"])
def test_ten_million_scenes(what: str) -> None:
    check(what, 10_000_000)


@pytest.mark.slow
@pytest.mark.parametrize("what", ["choose", "posterior"])
def test_a_million_scenes(what: str) -> None:
    check(what, 1_000_000)


@pytest.mark.slow
def test_a_million_trials() -> None:
    check("trials", 1_000_000)
