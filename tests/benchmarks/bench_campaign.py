"""Overhead and scaling of sweeps, in this process, in two, and on a cluster of two workers.

    OMP_NUM_THREADS=1 python tests/benchmarks/bench_campaign.py [--cluster]

The work burns CPU time of its own process, so on a busy machine wall times say little and CPU times
all: the overhead is the CPU that was spent beside the work, by this process and its children. Needs
weberwhisk[cluster] for the last lines.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pandas as pd

from weberwhisk.campaign import run


def burn(chunk: dict[str, float], seed: np.random.SeedSequence) -> pd.DataFrame:
    """So many seconds of CPU, and a row."""
    end = time.process_time() + chunk["seconds"]
    rng, total = np.random.default_rng(seed), 0.0
    while time.process_time() < end:
        total += rng.random()
    return pd.DataFrame({"total": [total]})


def spent() -> float:
    """CPU seconds of this process and of its children that have ended."""
    t = os.times()
    return t.user + t.system + t.children_user + t.children_system


def measure(name: str, seconds: float, count: int, start: float, **how: object) -> None:
    """One line: CPU beside the work, in per cent; what it costs to begin is told apart."""
    with tempfile.TemporaryDirectory() as folder:
        chunks = [{"seconds": seconds}] * count
        before, clock = spent(), time.perf_counter()
        run(burn, chunks, seed=1, out=Path(folder) / "sweep", **how)  # type: ignore[arg-type]
        cpu, wall = spent() - before, time.perf_counter() - clock
    beside = cpu - start - seconds * count
    print(
        f"{name:12s} {1e3 * seconds:5.0f} ms x {count:5d}: wall {wall:6.2f} s, "
        f"beside the work {1e3 * beside / count:6.2f} ms a chunk "
        f"({100 * beside / (seconds * count):5.1f} %)",
        flush=True,
    )


def starting(**how: object) -> float:
    """CPU seconds to begin and to end, from a sweep of next to no work."""
    before = spent()
    run(burn, [{"seconds": 0.0}] * 2, seed=1, **how)  # type: ignore[arg-type]
    return spent() - before


def main() -> None:
    starting()
    for workers in (1, 2):
        start = starting(workers=workers)
        print(f"{workers} worker(s): {start:.2f} s of CPU to begin")
        for seconds, count in ((0.001, 2000), (0.005, 800), (0.02, 300), (0.1, 60)):
            measure(f"{workers} worker(s)", seconds, count, start, workers=workers)
    if "--cluster" in sys.argv:
        cluster()


def cluster() -> None:
    """Tasks of chunks: the CPU of the scheduler and workers is not ours, so walls are compared."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "scheduler.json"
        paths = [str(Path(__file__).parent), *sys.path]
        environment = os.environ | {"PYTHONPATH": os.pathsep.join(paths)}
        where = ["--no-dashboard", "--scheduler-file", str(file)]
        commands = (
            ["scheduler", "--port", "0", "--host", "127.0.0.1", *where],
            ["worker", "--nworkers", "2", "--nthreads", "1", *where],
        )
        processes = [
            subprocess.Popen(
                [sys.executable, "-m", "dask", *c], env=environment, cwd=folder,
                stderr=subprocess.DEVNULL,
            )
            for c in commands
        ]  # fmt: skip
        while not file.exists():
            time.sleep(0.1)
        address = f"tcp://{_address(file)}"
        start = starting(scheduler=address)
        for seconds, count in ((0.005, 800), (0.02, 300)):
            measure("cluster of 2", seconds, count, start + seconds * count, scheduler=address)
            print("    (here: CPU of the client alone, beside nothing)")
        for process in reversed(processes):
            process.terminate()
            process.wait()


def _address(file: Path) -> str:
    import json

    return str(json.loads(file.read_text())["address"]).removeprefix("tcp://")


if __name__ == "__main__":
    import bench_campaign  # by a name that workers can import

    bench_campaign.main()
