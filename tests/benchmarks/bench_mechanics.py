"""Speed of bending, against an integrator on the same work in the same run.

Run ``python tests/benchmarks/bench_mechanics.py``. Times are of one core: set OMP_NUM_THREADS=1.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np

import weberwhisk as ww

sys.path.insert(0, str(Path(__file__).parents[1]))
from analysis_scripts import load
from integrators import follow

W = ww.Whisker(50e-3, 100e-6, 5e-6, 3e9)


def best(call, repeats=3):
    """Shortest of several times, s."""
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        call()
        times.append(time.perf_counter() - start)
    return min(times)


def rk4(steps, s, force):
    """Classical Runge–Kutta from the contact to the base, all scenes at once: (M, α)."""
    slope = (W.base_radius - W.tip_radius) / W.length

    def rates(at, angle, lever):
        stiffness = W.youngs_modulus * np.pi / 4 * (W.base_radius - slope * at) ** 4
        return -force * lever / stiffness, np.cos(angle)

    angle, lever, h = np.zeros_like(s), np.zeros_like(s), s / steps
    for i in range(steps):
        at = s - i * h
        a1, l1 = rates(at, angle, lever)
        a2, l2 = rates(at - h / 2, angle + h / 2 * a1, lever + h / 2 * l1)
        a3, l3 = rates(at - h / 2, angle + h / 2 * a2, lever + h / 2 * l2)
        a4, l4 = rates(at - h, angle + h * a3, lever + h * l3)
        angle, lever = (
            angle + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4),
            lever + h / 6 * (l1 + 2 * l2 + 2 * l3 + l4),
        )
    return force * lever, -angle


def main() -> None:
    rng = np.random.default_rng(0)
    n = 1_000_000
    r = rng.uniform(0.02, 0.95, n) * W.length
    theta = ww.flick_past(W, r).deflection_angle * rng.uniform(0.01, 0.99, n)
    bent = ww.press(W, r, theta)
    s, force = bent.arc_length, bent.force
    print(f"numpy {np.__version__}; times are the best of three on one core\n")
    print(f"{'work':58}{'time':>12}{'bar':>12}")
    rows = [
        ("1e6 bend", best(lambda: ww.bend(W, s, force)), "1 s"),
        ("1e6 press", best(lambda: ww.press(W, r, theta)), "5 s"),
        ("1e6 signal_jacobian", best(lambda: ww.mechanics.signal_jacobian(W, r, theta)), ""),
        ("1e6 press, closed form", best(lambda: ww.press(W, r, theta, model="closed_form")), ""),
        ("one scalar bend", best(lambda: [ww.bend(W, 35e-3, 8e-5) for _ in range(100)]) / 100, ""),
        ("one scalar press", best(lambda: [ww.press(W, 30e-3, 0.3) for _ in range(100)]) / 100, ""),
        ("the map built anew (it is shipped)", best(load("build_elastica_map").build, 1), ""),
    ]
    for name, seconds, bar in rows:
        bar = "0.2 ms" if "scalar" in name else bar
        print(f"{name:58}{seconds * 1e3:9.3f} ms{bar:>12}")

    print("\nthe same work by others, per solution, with the relative error of M against this map")
    s_few, force_few, moment_few = s[:1000], force[:1000], bent.moment[:1000]
    for steps in (8, 32, 128):
        seconds = best(lambda steps=steps: rk4(steps, s_few, force_few))
        error = np.median(np.abs(rk4(steps, s_few, force_few)[0] / moment_few - 1))
        name = f"NumPy RK4, {steps} steps, batches of 1000 (error {error:.0e})"
        print(f"{name:58}{seconds / 1000 * 1e6:9.3f} µs")
    few = range(20)
    arguments = [(W.length, W.base_radius, W.tip_radius, 3e9, s[i], force[i]) for i in few]
    seconds = best(lambda: [follow(*a) for a in arguments]) / len(few)
    error = max(
        abs(follow(*a)[0] / bent.moment[i] - 1) for i, a in zip(few, arguments, strict=True)
    )
    print(f"{f'SciPy DOP853, rtol 3e-14 (largest error {error:.0e})':58}{seconds * 1e6:9.0f} µs")
    print(f"{'this map, bend':58}{rows[0][1] / n * 1e6:9.3f} µs")


if __name__ == "__main__":
    main()
