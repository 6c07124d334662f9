"""Time, bias, RMSE and coverage of one fit, and the time of emcee beside it.

    OMP_NUM_THREADS=1 python tests/benchmarks/bench_fit.py [data sets]

Times are CPU seconds of this process, medians; errors do not depend on the machine.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable

import numpy as np

from weberwhisk.behaviour import Trials, WeberFit, fit_weber, load_rat_auditory, simulate_trials


def timed(work: Callable[[], WeberFit]) -> tuple[float, WeberFit]:
    start = time.process_time()
    fit = work()
    fit.interval()
    return time.process_time() - start, fit


def recovery(n_sets: int, per_level: int, lapse: float) -> str:
    times, errors, inside = [], [], 0
    for seed in range(n_sets):
        trials = simulate_trials(
            trials_per_level=per_level, lapse_low=lapse, lapse_high=lapse, seed=70_000 + seed
        )
        seconds, fit = timed(lambda trials=trials: fit_weber(trials))  # type: ignore[misc]
        low, high = fit.interval()
        times.append(seconds)
        errors.append(fit.weber_fraction / 0.1 - 1)
        inside += low < 0.1 < high
    e = np.array(errors)
    return (
        f"{9 * per_level:5d} trials, lapse {lapse:4.2f}: {1e3 * np.median(times):6.1f} ms "
        f"(90 % {1e3 * np.quantile(times, 0.9):6.1f}), median bias {100 * np.median(e):+6.1f} %, "
        f"RMSE {np.sqrt(np.mean(e**2)):.3f}, covers {100 * inside / n_sets:5.1f} %"
    )


def single(name: str, trials: Trials, **options: object) -> str:
    seconds, fit = timed(lambda: fit_weber(trials, **options))  # type: ignore[arg-type]
    low, high = fit.interval()
    return (
        f"{name:45s} {1e3 * seconds:8.0f} ms   k {fit.weber_fraction:.4f} ({low:.4f} to {high:.4f})"
        f"   {fit.status.name}, misfit p {fit.misfit:.3f}"
    )


def main() -> None:
    n_sets = int(sys.argv[1]) if len(sys.argv) > 1 else 200
    print(f"k = 0.1, nine levels to ±0.30, k + two lapses + bias, {n_sets} data sets each")
    for per_level, lapse in ((13, 0.02), (33, 0.0), (33, 0.02), (33, 0.1), (111, 0.02)):
        print(recovery(n_sets, per_level, lapse))
    trials = simulate_trials(trials_per_level=33, lapse_low=0.02, lapse_high=0.02, seed=1)
    print(single("the same 297 trials, quadrature", trials))
    print(single("the same 297 trials, emcee", trials, method="emcee", seed=1))
    rat = load_rat_auditory(range(31, 36))
    for bias in ("none", "shared", "per standard"):
        print(single(f"rat, sessions 31 to 35, bias {bias}", rat, bias=bias))


if __name__ == "__main__":
    main()
