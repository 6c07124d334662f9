"""Time of one fit, of emcee beside it, of 50 animals together and of the rat.

    OMP_NUM_THREADS=1 python tests/benchmarks/bench_fit.py

Times are CPU seconds of this process. Bias, RMSE and coverage: `analyses/recovery.py`.
"""

from __future__ import annotations

import time
from collections.abc import Callable

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


def single(name: str, trials: Trials, **options: object) -> str:
    seconds, fit = timed(lambda: fit_weber(trials, **options))  # type: ignore[arg-type]
    low, high = fit.interval()
    return (
        f"{name:45s} {1e3 * seconds:8.0f} ms   k {fit.weber_fraction:.4f} ({low:.4f} to {high:.4f})"
        f"   {fit.status.name}, misfit p {fit.misfit:.3f}"
    )


def main() -> None:
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
