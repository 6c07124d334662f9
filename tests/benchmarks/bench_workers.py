"""Many posteriors by one worker and by two: wall time, CPU time, and the same numbers.

    OMP_NUM_THREADS=1 python tests/benchmarks/bench_workers.py [COUNT]

Readings of two unknowns, 100 000 by default. On a machine that others use wall times say how busy
it was: the load is printed, and what the times would be on cores of our own, by the CPU time of
this process and half of that of the workers.
"""

from __future__ import annotations

import os
import resource
import sys
import time

import numpy as np

import weberwhisk as ww
from weberwhisk.cues import ForceMap
from weberwhisk.mechanics import Outcome


def cpu(who: int) -> float:
    used = resource.getrusage(who)
    return used.ru_utime + used.ru_stime


def main(count: int) -> None:
    observer = ww.Observer(ww.Whisker(50e-3, 100e-6, 5e-6), ForceMap())
    rng = np.random.default_rng(1)
    contact = np.column_stack(
        [rng.uniform(8e-3, 42e-3, 2 * count), rng.uniform(0.02, 0.4, 2 * count)]
    )
    contact = contact[observer.signals(contact)[1] == Outcome.HELD][:count]
    y = observer.read(contact, seed=2)
    results, ideal = [], []
    for workers in (1, 2):
        wall = time.perf_counter()
        here, there = cpu(resource.RUSAGE_SELF), cpu(resource.RUSAGE_CHILDREN)
        p = ww.posterior(observer, y, workers=workers)
        wall = time.perf_counter() - wall
        here = cpu(resource.RUSAGE_SELF) - here
        there = cpu(resource.RUSAGE_CHILDREN) - there
        ideal.append(here + there / 2)
        results.append(p)
        print(
            f"{len(y)} readings, {workers} worker(s): wall {wall:.1f} s at load "
            f"{os.getloadavg()[0]:.1f}; CPU {here:.1f} s here, {there:.1f} s in workers",
            flush=True,
        )
    one, two = results
    same = np.array_equal(one.mean, two.mean) and np.array_equal(one.sd, two.sd)
    print(f"{ideal[0] / ideal[1]:.2f} times as quick on cores of our own; same numbers: {same}")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 100_000)
