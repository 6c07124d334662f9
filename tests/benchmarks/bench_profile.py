"""Solutions a second of the planar beam on one core, whatever the whisker.

Run ``OMP_NUM_THREADS=1 python tests/benchmarks/bench_profile.py``: CPU time, the best of five.
Scenes lie at 0.1 to 0.8 L and are pushed up to 10 degrees past rest ("near"), or up to 0.9 of the
way to the fold ("far"), half of them with friction.

A compiled kernel was measured and not kept. The inner loop, `beam.follow` for a linear
taper of constant curvature, written in numba 0.68 with blocks of 32 rows that its compiler turns
into vector instructions, took 0.98 µs for a pass of four steps with its derivatives; NumPy took
1.4 µs (the same results to 1e-14, same run, 2.5 GHz). A factor of
1.5 on the inner loop is not worth 3 s of compiling in each fresh process, 0.25 s of every import,
208 MB of dependency and a second spelling of every whisker's radius and curvature. What did pay was
to do less: two passes a solution, each no finer than its Newton step deserves, from the start of
the straight taper that gives way as easily and in the same shape, its fold moved by friction and
curvature; as many steps in the first pass as the bend asks for; an error estimate that scatters
less, and so asks for fewer steps.
"""

from __future__ import annotations

import time

import numpy as np

from weberwhisk.mechanics import profile
from weberwhisk.mechanics.shape import Parabola, Profile, Spiral
from weberwhisk.whisker import Whisker

N = 30_000
TAPER = Profile.of(Whisker(50e-3, 100e-6, 5e-6, 3e9))
RADII = 1e-4 * np.array([1, 0.9, 0.7, 0.5, 0.3, 0.05])
WHISKERS = {
    "straight taper": TAPER,
    "constant curvature": TAPER.curved(Spiral(-8.0)),
    "Euler spiral": TAPER.curved(Spiral(5.0, 200.0)),
    "parabola": TAPER.curved(Parabola(-9.0)),
    "cut, curved": TAPER.cut(30e-3).curved(Spiral(8.0)),
    "medulla": TAPER.hollow(60e-6, 20e-3),
    "six radii, curved": Profile.tabulated(
        np.linspace(0, 50e-3, 6), RADII, law=Spiral(-8.0), youngs_modulus=3e9
    ),
}


def scenes(whisker: Profile, far: bool):
    """Distances, deflection angles and friction angles, all of them held."""
    rng = np.random.default_rng(1)
    r = rng.uniform(0.1, 0.8, N) * whisker.whisker.length
    psi = np.where(rng.random(N) < 0.5, 0.0, -0.2)
    push = rng.uniform(0.01, 0.17, N)
    if far:
        knots = np.linspace(0.1, 0.8, 50) * whisker.whisker.length
        ends = [profile.flick_past(whisker, knots, p).deflection_angle for p in (0.0, -0.2)]
        end = np.min(ends, axis=0) - profile.rest_angle(whisker, knots)
        push = rng.uniform(0, 0.9, N) * np.interp(r, knots, end)
    return r, profile.rest_angle(whisker, r) + push, psi


def rate(call, count: int) -> float:
    """Solutions a second of CPU time."""
    times = []
    for _ in range(5):
        start = time.process_time()
        call()
        times.append(time.process_time() - start)
    return count / min(times)


def main() -> None:
    """Print the table."""
    columns = (
        "press near 1e-6",
        "press near 1e-9",
        "press far 1e-6",
        "bend 1e-6",
        "flick_past 1e-6",
    )
    print(f"{'solutions/s':20}", *(f"{c:>16}" for c in columns))
    for name, w in WHISKERS.items():
        near, far = scenes(w, far=False), scenes(w, far=True)
        at = profile.press(w, *far, tolerance=1e-6)
        assert np.all(at.held), name
        r = np.linspace(0.1, 0.9, 3000) * w.whisker.length
        rates = [
            rate(lambda w=w, near=near: profile.press(w, *near, tolerance=1e-6), N),
            rate(lambda w=w, near=near: profile.press(w, *near, tolerance=1e-9), N),
            rate(lambda w=w, far=far: profile.press(w, *far, tolerance=1e-6), N),
            rate(
                lambda w=w, at=at, psi=far[2]: profile.bend(
                    w, at.arc_length, at.force, psi, tolerance=1e-6
                ),
                N,
            ),
            rate(lambda w=w, r=r: profile.flick_past(w, r, tolerance=1e-6), r.size),
        ]
        print(f"{name:20}", *(f"{x:16,.0f}" for x in rates), flush=True)


if __name__ == "__main__":
    main()
