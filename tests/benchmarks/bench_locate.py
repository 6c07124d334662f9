"""One film of a whisker whose shape and stiffness nobody gave: CPU and wall time, and memory.

    OMP_NUM_THREADS=1 python tests/benchmarks/bench_locate.py [ROWS] [WORKERS]

10 000 rows in 500 touches on two workers by default. Bars: 120 s and 1 GB on two quiet cores.
"""

from __future__ import annotations

import os
import resource
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2] / "analyses"))

from speed_accuracy.chart import film

import weberwhisk as ww


def main(rows: int, workers: int) -> None:
    table = film(rows)
    wall, here = time.perf_counter(), time.process_time()
    ww.locate(
        table,
        ww.Whisker(40e-3, 80e-6, 4e-6),
        units={"moment": "N m", "axial_force": "N"},
        workers=workers,
    )
    there = resource.getrusage(resource.RUSAGE_CHILDREN)
    memory = [resource.getrusage(who).ru_maxrss / 1e3
              for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]  # fmt: skip
    print(
        f"{rows} rows, {workers} worker(s): wall {time.perf_counter() - wall:.0f} s at load "
        f"{os.getloadavg()[0]:.1f}; CPU {time.process_time() - here:.0f} s here, "
        f"{there.ru_utime + there.ru_stime:.0f} s in workers; at most {memory[0]:.0f} MB here, "
        f"{memory[1]:.0f} MB in a worker"
    )


if __name__ == "__main__":
    main(*(int(a) for a in (sys.argv[1:] + ["10000", "2"][len(sys.argv) - 1 :])))
