"""Time of one fit, of emcee beside it, of 50 animals together and of the rat.

    OMP_NUM_THREADS=1 python tests/benchmarks/bench_fit.py [--beside TREE]

Times are CPU seconds of this process. `--beside` times fits of this tree and of another one (a
folder that holds `weberwhisk`) by turns, so that a busy machine is as busy for both. Bias, RMSE and
coverage: `analyses/recovery.py`.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

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


#: Run by a process of each tree: a line with a number in, the CPU seconds of that fit out.
WORKER = """
import sys, time
from weberwhisk.behaviour import effects, fit_weber, simulate_trials
standards, options = [1.0], {}
if sys.argv[1] == "a bias per standard":
    standards, options = [1.0, 2.0, 4.0], {"bias": "per standard"}
elif sys.argv[1] == "overdispersed":
    options = {"effects": [effects.Overdispersion()]}
sets = [simulate_trials(standards=standards, trials_per_level=33, lapse_low=0.02, lapse_high=0.02,
                        seed=seed) for seed in range(6)]
fit_weber(sets[0], **options).interval()
print(flush=True)
for line in sys.stdin:
    start = time.process_time()
    fit_weber(sets[int(line) % 6], **options).interval()
    print(time.process_time() - start, flush=True)
"""


def beside(other: Path) -> None:
    """Medians of both trees, and of the ratio, by turns."""
    trees = [other.resolve(), Path(__file__).resolve().parents[2]]
    for kind, turns in (("297 trials", 60), ("a bias per standard", 24), ("overdispersed", 6)):
        workers = [
            subprocess.Popen(
                [sys.executable, "-c", WORKER, kind], stdin=subprocess.PIPE, text=True, cwd=tree,
                stdout=subprocess.PIPE, env={**os.environ, "PYTHONPATH": str(tree)},
            )
            for tree in trees
        ]  # fmt: skip
        for worker in workers:
            assert worker.stdout is not None
            worker.stdout.readline()
        times = []
        for turn in range(turns):
            row = []
            for worker in workers:
                assert worker.stdin is not None
                assert worker.stdout is not None
                worker.stdin.write(f"{turn}\n")
                worker.stdin.flush()
                row.append(1e3 * float(worker.stdout.readline()))
            times.append(row)
        for worker in workers:
            worker.communicate()
        old, new = (statistics.median(column) for column in zip(*times, strict=True))
        ratio = statistics.median(after / before for before, after in times)
        print(f"{kind:45s} other {old:6.0f} ms   this {new:6.0f} ms   ratio {ratio:.2f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--beside", type=Path, metavar="TREE")
    if other := parser.parse_args().beside:
        beside(other)
        return
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
