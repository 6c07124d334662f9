"""Who does the chunks: this process, processes of its own, or a dask cluster.

All three are executors of `concurrent.futures`, so one loop drives them (`campaign.run`). What they
are handed is a batch: some chunks of a `Job`, done in turn until they have taken long enough.
"""

from __future__ import annotations

import logging
import multiprocessing
import os
import signal
import threading
import time
import traceback
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import BrokenExecutor, Future
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ..threads import limited_blas
from .log import encode, versions

if TYPE_CHECKING:
    import pandas as pd

Chunk = dict[str, Any]
Work = Callable[[Chunk, np.random.SeedSequence], "pd.DataFrame"]


@dataclass(frozen=True)
class Job:
    """The same function of every chunk, each with the seed that its number gives it.

    `chunks` by number, for one worker some of them only; `entropy` and `spawn_key` are the root of
    the seeds.
    """

    work: Work
    chunks: dict[int, Chunk]
    entropy: int | Sequence[int]
    spawn_key: tuple[int, ...] = ()

    def only(self, numbers: Iterable[int]) -> Job:
        """The same job for some of its chunks."""
        return replace(self, chunks={number: self.chunks[number] for number in numbers})

    def seed(self, number: int) -> np.random.SeedSequence:
        """The seed of a chunk, which hangs on the root and its number alone."""
        return np.random.SeedSequence(self.entropy, spawn_key=(*self.spawn_key, number))

    def do(self, numbers: Sequence[int], seconds: float) -> Report:
        """Chunks in this order, until one has failed or they have taken so long together.

        Their seeds are made before and their tables written after the work: among long arithmetic,
        which fills the processor's caches with other things, either takes three times as long.
        """
        report, since = Report(), time.monotonic()
        tables: dict[int, pd.DataFrame] = {}
        asked = [(number, dict(self.chunks[number]), self.seed(number)) for number in numbers]
        with limited_blas():
            for number, chunk, seed in asked:
                try:
                    tables[number] = self.work(chunk, seed)
                except Exception as error:
                    report.fail(number, error)
                if report.failure or time.monotonic() - since > seconds:
                    break
        for number, frame in tables.items():
            try:
                report.lines[number] = encode(number, frame)
            except Exception as error:
                report.fail(number, error)
        report.back = [number for number in numbers if number not in report.ended]
        report.each = (time.monotonic() - since) / len(report.ended)
        return report


@dataclass
class Report:
    """What became of some chunks.

    `lines` of results by number of the chunk; `back`, chunks given back undone; `failure`, a chunk
    that raised an exception, which, and its traceback; `each`, seconds that a chunk took.
    """

    lines: dict[int, str] = field(default_factory=dict)
    back: list[int] = field(default_factory=list)
    failure: tuple[int, str, str] | None = None
    each: float = 0.0

    @property
    def ended(self) -> list[int]:
        """Chunks that were done, or have failed."""
        return [*self.lines, *([self.failure[0]] if self.failure else [])]

    def fail(self, number: int, error: Exception) -> None:
        """A chunk that raised an exception; the first is kept."""
        words = f"{type(error).__name__}: {error}"
        self.failure = self.failure or (number, words, "".join(traceback.format_exception(error)))


class WorkerStartupError(Exception):
    """No worker lives long enough to be given anything."""


class ClusterLost(Exception):
    """The scheduler or all its workers have gone."""


class Workers:
    """Who does batches of chunks: an executor with what the loop must know of it.

    `seconds` of work in a batch; `slots`, batches that are under way at most; `trials`, deaths of
    workers on one chunk alone, before it is given up. This process, by itself, is the plainest.
    """

    seconds: float = 0.25
    slots: int = 1
    trials: int = 1

    def submit(self, job: Job) -> Future[Report]:
        """Do the chunks of a job, or some of them."""
        future: Future[Report] = Future()
        future.set_result(job.do(list(job.chunks), self.seconds))
        return future

    def died(self, error: BaseException) -> bool:
        """Whether an exception of a batch says that its worker has died."""
        return False

    def restart(self) -> None:
        """Have other workers, where one has died."""

    def check(self) -> None:
        """Look whether anybody is there, where no batch has ended for a second."""

    def close(self) -> None:
        """Stop, whatever is being done."""


class Processes(Workers):
    """Processes of this machine; when one dies all are replaced."""

    # What a worker holds so that it need not wait, and chunks that end are in the file soon.
    seconds, trials = 0.3, 3

    def __init__(self, workers: int) -> None:
        self._workers = workers
        self.slots = 2 * workers
        self._start()

    def _start(self) -> None:
        from concurrent.futures import ProcessPoolExecutor  # a browser's Python lacks it

        # A fresh interpreter: a copy of this one would have its threads' locks, held for ever.
        context = multiprocessing.get_context("spawn")
        self._pool = ProcessPoolExecutor(self._workers, context, _begin)
        try:
            self._pool.submit(os.getpid).result()
        except BrokenExecutor:
            raise WorkerStartupError from None

    def submit(self, job: Job) -> Future[Report]:
        try:
            return self._pool.submit(_some, job, self.seconds)
        except BrokenExecutor as error:  # since the last look
            future: Future[Report] = Future()
            future.set_exception(error)
            return future

    def died(self, error: BaseException) -> bool:
        return isinstance(error, BrokenExecutor)

    def restart(self) -> None:
        self.close()
        self._start()

    def close(self) -> None:
        processes = list((getattr(self._pool, "_processes", None) or {}).values())
        self._pool.shutdown(wait=False, cancel_futures=True)
        for process in processes:
            process.terminate()
        for process in processes:
            process.join()


class Cluster(Workers):
    """The workers of a dask scheduler, whoever they are at the time.

    The scheduler gives the task of a worker that dies to another one. After some deaths it gives up
    the tasks that were waiting there too, so a chunk is said to kill only when it has had the whole
    cluster to itself. `connect` is how many seconds it may take to reach the scheduler, and
    `patience` how many without any worker are waited before the sweep is given up.
    """

    seconds, trials = 1.5, 1  # the cluster's own cost is some ten milliseconds a task

    def __init__(self, address: str, patience: float = 300.0, connect: float = 15.0) -> None:
        try:
            from distributed import Client
        except ImportError:
            raise ValueError(
                "a scheduler needs dask.distributed, which is not installed; write "
                "pip install 'weberwhisk[cluster]'."
            ) from None
        # What it has to say of a lost connection is said here, in a sentence.
        self._silent = logging.getLogger("distributed")
        self._level = self._silent.level
        self._silent.setLevel(logging.CRITICAL + 1)
        try:
            self._client: Any = Client(address, set_as_default=False, timeout=connect)
        except (OSError, ValueError, TimeoutError) as error:
            self._silent.setLevel(self._level)
            raise ValueError(
                f"no scheduler could be reached at {address!r} ({type(error).__name__}); start one "
                "with `dask scheduler`, and give the address that it prints."
            ) from error
        self._pool = self._client.get_executor(pure=False, retries=0)
        self._patience, self._deadline = patience, time.monotonic() + patience
        self._wanted = versions()
        self.slots = self._count()

    def _count(self) -> int:
        return 2 * max(sum(self._client.nthreads().values()), 1)

    def submit(self, job: Job) -> Future[Report]:
        future: Future[Report] = self._pool.submit(_some, job, 2 * self.seconds, self._wanted)
        return future

    def died(self, error: BaseException) -> bool:
        from distributed import KilledWorker

        if isinstance(error, KilledWorker):
            return True
        self.check()
        if isinstance(error, _Mismatch):
            raise ClusterLost(str(error))
        raise ClusterLost(
            f"a task ended with {type(error).__name__}: {' '.join(str(error).split())}"
        )

    def check(self) -> None:
        """Refuse to wait for a scheduler that has gone, or where there are no workers."""
        if self._client.status != "running":
            raise ClusterLost("the scheduler does not answer")
        try:
            self.slots, anybody = self._count(), bool(self._client.nthreads())
        except (OSError, TimeoutError):
            raise ClusterLost("the scheduler does not answer") from None
        if anybody:
            self._deadline = time.monotonic() + self._patience
        elif time.monotonic() > self._deadline:
            raise ClusterLost(f"it has had no workers for {self._patience:g} s")

    def close(self) -> None:
        with suppress(Exception):  # it may have gone
            self._pool.shutdown(wait=False, cancel_futures=True)
            self._client.close(timeout=2.0)
        self._silent.setLevel(self._level)


class _Mismatch(Exception):
    """A worker with other versions than this process."""


def _begin() -> None:
    """A worker's birth: who asked decides what an interrupt means, and it outlives nobody."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    assert parent is not None

    def follow() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=follow, daemon=True).start()


def _some(job: Job, seconds: float, wanted: dict[str, str | None] | None = None) -> Report:
    """A worker's share: its chunks, until they are done or have taken long enough."""
    if wanted is not None and versions() != wanted:
        raise _Mismatch(f"a worker has {versions()}, not {wanted}")
    return job.do(list(job.chunks), seconds)
