"""Overhead and scaling of sweeps, in this process, in two, and on a cluster of two workers.

    OMP_NUM_THREADS=1 python tests/benchmarks/bench_campaign.py [--cluster]

The work computes for so long and says how much CPU it took; what all processes took beside that is
overhead. What processes take before their first chunk, which is to import, is told apart, and so is
what a cluster takes to be there. Wall times say little on a busy machine, where overhead is twice
what it is on a quiet one: other processes take the caches. Needs weberwhisk[cluster] for the last
lines.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd

from weberwhisk.campaign import run

SIZES = 0.001, 0.005, 0.02, 0.1  # CPU seconds of a chunk
SPAN = 8.0  # seconds of work altogether


def work(chunk: dict[str, float], seed: np.random.SeedSequence) -> pd.DataFrame:
    """So many seconds of sorting; CPU before and for it, and whose."""
    start, rng = time.process_time(), np.random.default_rng(seed)
    numbers = rng.random(2000)
    while time.process_time() - start < chunk["seconds"]:
        np.sort(numbers)
    row = np.array([[numbers.sum(), os.getpid(), start, 0.0]])
    names = ["total", "worker", "before", "spent"]
    frame = pd.DataFrame(row, columns=names, copy=False)  # a view: making it is part of the work
    row[0, 3] = time.process_time() - start
    return frame


def measure(
    name: str, seconds: float, used: Callable[[], float], there: float = 0.0, **how: object
) -> None:
    """One line; `used` is the CPU of all processes so far, `there` theirs a second if idle."""
    count = round(SPAN / seconds)
    with tempfile.TemporaryDirectory() as folder:
        chunks = [{"seconds": seconds}] * count
        before, clock = used(), time.perf_counter()
        table = run(work, chunks, seed=1, out=Path(folder) / "sweep", **how)  # type: ignore[arg-type]
        cpu, wall = used() - before, time.perf_counter() - clock
    own, begin = float(table["spent"].sum()), 0.0
    if "workers" in how:  # that began for this
        ours = table["worker"] == os.getpid()
        begin = float(table[~ours].groupby("worker")["before"].min().sum())
    beside = cpu - begin - there * wall - own
    print(
        f"{name:12s} {1e3 * seconds:5.0f} ms x {count:5d}: wall {wall:6.2f} s, to begin "
        f"{begin:4.2f} s, beside the work {1e3 * beside / count:5.2f} ms a chunk "
        f"({100 * beside / own:4.1f} %)",
        flush=True,
    )


def spent() -> float:
    """CPU seconds of this process and of its children that have ended."""
    t = os.times()
    return t.user + t.system + t.children_user + t.children_system


def main() -> None:
    run(work, [{"seconds": 0.0}] * 20, seed=1)
    for workers in (1, 2):
        for seconds in SIZES:
            measure(f"{workers} worker(s)", seconds, spent, workers=workers)
    if "--cluster" in sys.argv:
        cluster()


def cluster() -> None:
    """A real scheduler with two workers."""
    import psutil  # distributed needs it

    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "scheduler.json"
        paths = [str(Path(__file__).parent), *sys.path]
        environment = os.environ | {"PYTHONPATH": os.pathsep.join(paths)}
        where = ["--no-dashboard", "--scheduler-file", str(file)]
        commands = (
            ["scheduler", "--port", "0", "--host", "127.0.0.1", *where],
            *(["worker", "--no-nanny", "--nthreads", "1", *where],) * 2,
        )
        processes = [
            subprocess.Popen(
                [sys.executable, "-m", "dask", *c], env=environment, cwd=folder,
                stderr=subprocess.DEVNULL,
            )
            for c in commands
        ]  # fmt: skip

        def used() -> float:
            times = [psutil.Process(p.pid).cpu_times() for p in processes]
            return time.process_time() + sum(t.user + t.system for t in times)

        while not file.exists():
            time.sleep(0.1)
        address = f"tcp://{_address(file)}"
        # What it takes to import.
        run(work, [{"seconds": 0.1}] * 40, seed=1, scheduler=address)
        before, clock = used(), time.perf_counter()
        time.sleep(SPAN / 2)
        there = (used() - before) / (time.perf_counter() - clock)
        print(f"a cluster of 2 that does nothing: {there:.3f} s of CPU a second", flush=True)
        for seconds in SIZES:
            measure("cluster of 2", seconds, used, there, scheduler=address)
        for process in reversed(processes):
            process.terminate()
            process.wait()


def _address(file: Path) -> str:
    import json

    return str(json.loads(file.read_text())["address"]).removeprefix("tcp://")


if __name__ == "__main__":
    import bench_campaign  # by a name that workers can import

    bench_campaign.main()
