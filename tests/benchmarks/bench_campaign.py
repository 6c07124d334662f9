"""Overhead and scaling of sweeps, in this process, in two, and on a cluster of two workers.

    OMP_NUM_THREADS=1 python tests/benchmarks/bench_campaign.py [--cluster]

The work sleeps, so that all CPU time is overhead, but for that of a plain loop over the same work,
which is subtracted; wall times say little on a busy machine. A cluster spends some in just being
there. Needs weberwhisk[cluster] for the last lines.
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

SIZES = 0.001, 0.005, 0.02, 0.1  # seconds of a chunk
SPAN = 4.0  # seconds of work altogether


def rest(chunk: dict[str, float], seed: np.random.SeedSequence) -> pd.DataFrame:
    """So many seconds, and a row."""
    time.sleep(chunk["seconds"])
    return pd.DataFrame({"total": [np.random.default_rng(seed).random()]})


def spent() -> float:
    """CPU seconds of this process and of its children that have ended."""
    t = os.times()
    return t.user + t.system + t.children_user + t.children_system


def plain(seconds: float, count: int) -> float:
    """CPU of the same work without a sweep: a loop, and the tables under one another."""
    before = spent()
    seeds = np.random.SeedSequence(1).spawn(count)
    pd.concat([rest({"seconds": seconds}, s) for s in seeds], ignore_index=True)
    return spent() - before


def measure(name: str, seconds: float, start: float, **how: object) -> None:
    """One line: CPU beside that of a plain loop; what it costs to begin is told apart."""
    count = round(SPAN / seconds)
    alone = plain(seconds, count)
    with tempfile.TemporaryDirectory() as folder:
        chunks = [{"seconds": seconds}] * count
        before, clock = spent(), time.perf_counter()
        run(rest, chunks, seed=1, out=Path(folder) / "sweep", **how)  # type: ignore[arg-type]
        cpu, wall = spent() - before, time.perf_counter() - clock
    beside = cpu - start - (0.0 if "scheduler" in how else alone)
    print(
        f"{name:12s} {1e3 * seconds:5.0f} ms x {count:5d}: wall {wall:6.2f} s, "
        f"beside the work {1e3 * beside / count:6.2f} ms a chunk "
        f"({100 * beside / (seconds * count):5.1f} %)",
        flush=True,
    )


def starting(**how: object) -> float:
    """CPU seconds to begin and to end, from sweeps of next to no work."""
    found = []
    for _ in range(3):
        before = spent()
        run(rest, [{"seconds": 0.0}] * 2, seed=1, **how)  # type: ignore[arg-type]
        found.append(spent() - before)
    return float(np.median(found))


def main() -> None:
    starting()
    for workers in (1, 2):
        start = starting(workers=workers)
        print(f"{workers} worker(s): {start:.2f} s of CPU to begin")
        for seconds in SIZES:
            measure(f"{workers} worker(s)", seconds, start, workers=workers)
    if "--cluster" in sys.argv:
        cluster()


def cluster() -> None:
    """A real scheduler with two workers; CPU of all its processes is counted when they end."""
    for seconds in SIZES:
        count = round(SPAN / seconds)
        idle, busy = (_on_cluster(seconds, n) for n in (2, count))
        alone = plain(seconds, count - 2)
        beside = busy - idle - alone
        print(
            f"cluster of 2 {1e3 * seconds:5.0f} ms x {count:5d}: beside the work "
            f"{1e3 * beside / count:6.2f} ms a chunk ({100 * beside / (seconds * count):5.1f} %)",
            flush=True,
        )


def _on_cluster(seconds: float, count: int) -> float:
    """CPU seconds of a cluster that does so many chunks, from its start to its end, and ours."""
    before = spent()
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "scheduler.json"
        paths = [str(Path(__file__).parent), *sys.path]
        environment = os.environ | {"PYTHONPATH": os.pathsep.join(paths)}
        where = ["--no-dashboard", "--scheduler-file", str(file)]
        # Workers without nannies: their CPU is counted with that of the child that started them.
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
        while not file.exists():
            time.sleep(0.1)
        address = f"tcp://{_address(file)}"
        run(rest, [{"seconds": 0.0}] * 20, seed=1, scheduler=address)  # what it takes to import
        chunks = [{"seconds": seconds}] * count
        run(rest, chunks, seed=1, out=Path(folder) / "sweep", scheduler=address)
        for process in reversed(processes):
            process.terminate()
            process.wait()
    return spent() - before


def _address(file: Path) -> str:
    import json

    return str(json.loads(file.read_text())["address"]).removeprefix("tcp://")


if __name__ == "__main__":
    import bench_campaign  # by a name that workers can import

    bench_campaign.main()
