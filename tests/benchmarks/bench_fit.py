"""Time, bias, RMSE and coverage of one fit, and the time of emcee beside it.

    OMP_NUM_THREADS=1 python tests/benchmarks/bench_fit.py [data sets]

Times are CPU seconds of this process, medians; errors do not depend on the machine.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable

import numpy as np

from weberwhisk.behaviour import (
    Trials,
    WeberFit,
    fit_population,
    fit_weber,
    load_rat_auditory,
    simulate_population,
    simulate_trials,
)


def timed(work: Callable[[], WeberFit]) -> tuple[float, WeberFit]:
    start = time.process_time()
    fit = work()
    fit.interval()
    return time.process_time() - start, fit


def recovery(n_sets: int, k: float, per_level: int, lapse: float) -> str:
    """Errors of the shipped priors, and the bias that is left once the lapses are known."""
    known = {"lapse_low": lapse, "lapse_high": lapse}
    offsets = None if k == 0.1 else np.round(np.exp(np.linspace(-3 * k, 3 * k, 9)) - 1, 6)
    times, errors, without, inside = [], [], [], 0
    for seed in range(n_sets):
        trials = simulate_trials(
            weber_fraction=k,
            trials_per_level=per_level,
            offsets=offsets,
            seed=70_000 + seed,
            **known,
        )
        seconds, fit = timed(lambda trials=trials: fit_weber(trials))  # type: ignore[misc]
        low, high = fit.interval()
        times.append(seconds)
        errors.append(fit.weber_fraction / k - 1)
        without.append(fit_weber(trials, priors=known).weber_fraction / k - 1)
        inside += low < k < high
    e = np.array(errors)
    return (
        f"k {k:4.2f}, {9 * per_level:5d} trials, lapse {lapse:4.2f}: "
        f"{1e3 * np.median(times):6.1f} ms (90 % {1e3 * np.quantile(times, 0.9):6.1f}), "
        f"median bias {100 * np.median(e):+6.1f} % "
        f"(lapses known {100 * np.median(without):+6.1f}), "
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
    print(f"Nine levels to ±3 k (of logarithms, but at 0.1), {n_sets} data sets each")
    for k in (0.1, 0.05, 0.2, 0.4):
        for per_level in (13, 33, 111):
            for lapse in (0.0, 0.02, 0.1):
                print(recovery(n_sets, k, per_level, lapse), flush=True)
    trials = simulate_trials(trials_per_level=33, lapse_low=0.02, lapse_high=0.02, seed=1)
    print(single("the same 297 trials, quadrature", trials))
    print(single("the same 297 trials, emcee", trials, method="emcee", seed=1))
    animals, _ = simulate_population(
        50, standards=[1.0, 2.0, 4.0], trials_per_level=74, lapse_low=0.02, lapse_high=0.02, seed=3
    )
    start = time.process_time()
    population = fit_population(animals)
    low, high = population.interval()
    print(
        f"{'50 animals of 1998 trials, pooled':45s} {time.process_time() - start:8.1f} s    "
        f"k {population.weber_fraction:.4f} ({low:.4f} to {high:.4f})   {population.status.name}"
    )
    rat = load_rat_auditory(range(31, 36))
    for bias in ("none", "shared", "per standard"):
        print(single(f"rat, sessions 31 to 35, bias {bias}", rat, bias=bias))


if __name__ == "__main__":
    main()
