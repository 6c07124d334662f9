"""Solutions a second of rung 2, on one core: ``OMP_NUM_THREADS=1 pytest tests/benchmarks``.

Run with ``pytest tests/benchmarks/bench_profile.py --benchmark-enable -o addopts=``.
"""

from __future__ import annotations

import numpy as np
import pytest

from weberwhisk.mechanics import profile
from weberwhisk.whisker import Whisker

N = 20_000
WHISKERS = {
    "straight": Whisker(50e-3, 100e-6, 5e-6, 3e9),
    "curved": Whisker(50e-3, 100e-6, 5e-6, 3e9, curvature=-8.0),
}


def scenes():
    """Distances over 0.1 to 0.8 L and angles up to 10 degrees past rest, all held."""
    rng = np.random.default_rng(1)
    return rng.uniform(0.1, 0.8, N) * 50e-3, rng.uniform(0.01, 0.17, N)


@pytest.mark.parametrize("tolerance", [1e-6, 1e-9])
@pytest.mark.parametrize("psi", [0.0, -0.2])
@pytest.mark.parametrize("name", WHISKERS)
@pytest.mark.parametrize("which", ["bend", "press"])
def test_speed(benchmark, which, name, psi, tolerance):
    w = WHISKERS[name]
    r, push = scenes()
    theta = profile.rest_angle(w, r) + push
    at = profile.press(w, r, theta, psi, tolerance=tolerance)
    assert np.mean(at.held) > 0.99
    if which == "press":
        call = (profile.press, w, r, theta, psi)
    else:
        s, f = (np.where(at.held, a, b) for a, b in ((at.arc_length, 1e-2), (at.force, 1e-6)))
        call = (profile.bend, w, s, f, psi)
    benchmark.extra_info["solutions"] = N
    benchmark(call[0], *call[1:], tolerance=tolerance)
