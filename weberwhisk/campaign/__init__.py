"""Sweeps: the same work on many chunks, serially, on all cores, or on a cluster.

Recovery, power, calibration and surfaces of JNDs are all of one kind: a function of a chunk (what
to do) and a seed (its own) that returns a table. `run` does it for every chunk, and the answer is
the same to the bit whatever does it and in what order.

Who does the chunks is an executor of `concurrent.futures`: this process, processes of its own, or a
dask cluster. What it is handed is a `Job`: some chunks, done in turn until they took long enough.
"""

from __future__ import annotations

import gc
import logging
import multiprocessing
import os
import signal
import threading
import time
import warnings
from collections import Counter, deque
from collections.abc import Callable, Iterable
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Future, wait
from contextlib import ExitStack, closing, suppress
from typing import Any

import numpy as np

from .. import _checks
from .._values import pd
from ..output import shown
from ..threads import core_count, in_browser
from .log import Chunk, Job, Log, Report, Work, by_number, decode, job_of, read_lines, versions

__all__ = ["CampaignError", "all_cores", "read", "run"]

KIND = "sweep"  # of its log


class CampaignError(RuntimeError):
    """A sweep that could not be finished; what it has done is in its file."""


def run(
    work: Work,
    chunks: Iterable[Chunk],
    *,
    seed: int | np.random.SeedSequence,
    workers: int = 1,
    scheduler: str | None = None,
    out: str | os.PathLike[str] | None = None,
    title: str = "",
    progress: Callable[[float], None] | None = None,
) -> pd.DataFrame:
    """Do the same work on every chunk, and put the tables under one another.

    The result is the same to the bit whatever the number of workers, their kind and their order,
    and whether or not the sweep was interrupted: the seed of a chunk hangs on `seed` and the number
    of the chunk alone, and linear algebra has one thread.

    Parameters
    ----------
    work : callable
        ``work(chunk, seed) -> DataFrame`` of numbers, booleans and text, with the same columns
        always and a new one each time; a function at the top level of a module. `chunk` is a dict,
        `seed` a SeedSequence.
    chunks : iterable of dict
        What may be written as JSON. Each costs 0.1 to 0.3 ms beside the work, so let them take 5 ms
        or more; short ones are handed out, and their tables written, many at a time.
    seed : int or SeedSequence
    workers : int
        1: this process. More: so many processes; a script that starts them needs
        ``if __name__ == "__main__":``. In a browser, which has none, all is done serially.
    scheduler : str, optional
        Address of a `dask.distributed` scheduler such as ``tcp://node1:8786``, whose workers have
        the same weberwhisk, NumPy and SciPy.
    out : path, optional
        A file to stream into, JSON lines. Where it holds part of the same sweep, the rest is done:
        same name of the work, chunks, seed and versions (not its source: a work that was mended may
        go on). `read` reads it at any time. What is in it is not computed again; of short chunks
        up to a quarter of a second's, on a cluster up to a few seconds', are on their way to it.
    title : str
        Shown beside the progress bar.
    progress : callable, optional
        Told how many more chunks are done. By default a bar with the time left, on standard error
        where that is a terminal, and a plain line every 15 s where it is not.

    Returns
    -------
    DataFrame
        Rows in the order of the chunks.

    Raises
    ------
    ValueError
        For what cannot be asked, a file of another sweep, or a cluster that cannot be reached.
    CampaignError
        When a chunk raises an exception or has killed its worker three times, naming the chunk; and
        when all workers are lost.

    Examples
    --------
    `weberwhisk.jnd_curves` gives one chunk to each Weber fraction:

    >>> from weberwhisk.jnd_curves import jnd_rows
    >>> tap = {"whisker": {"length": 50e-3, "base_radius": 1e-4, "tip_radius": 5e-6},
    ...        "radial_distance": [5e-3], "deflection_angle": None,
    ...        "method": "quadrature", "criterion": "d'=1", "n_readings": 4}
    >>> table = run(jnd_rows, [tap | {"weber_fraction": k} for k in (0.05, 0.1)], seed=1)
    >>> table["closed_form_mm"].round(3).tolist()
    [0.226, 0.453]
    """
    job, question = job_of(work, chunks, seed)
    _checks.whole("workers", workers, "write 2")
    if workers > 1 and in_browser():
        warnings.warn("a browser has no processes: the chunks are done serially.", stacklevel=2)
        workers = 1
    if scheduler is not None and workers != 1:
        raise ValueError(
            f"a cluster has its own workers, got workers={workers} with a scheduler; leave one out."
        )
    with ExitStack() as opened:
        log = None if out is None else Log(out, KIND, question, {"title": title})
        sweep = _Sweep(job, log and opened.enter_context(log))
        if sweep.queue:
            done = len(sweep.lines)
            if progress is None:
                progress = opened.enter_context(shown(title or "Sweep", len(job.chunks), done=done))
            else:
                progress(done)
            try:
                executor = Workers()
                if scheduler is not None:
                    executor = Cluster(scheduler)
                elif workers > 1:
                    executor = Processes(min(workers, len(sweep.queue)))
                with closing(executor):
                    sweep.finish(executor, progress)
            except _Lost as error:
                raise CampaignError(f"{error}{sweep.kept}") from None
        return decode(sweep.lines)


def all_cores(workers: int | None, scheduler: str | None) -> int:
    """As many workers as asked for; by default one a core, or those of the cluster.

    Examples
    --------
    >>> all_cores(3, None), all_cores(None, "tcp://node1:8786")
    (3, 1)
    """
    if workers is not None:
        return workers
    if scheduler is not None:
        return 1
    return core_count()


def read(path: str | os.PathLike[str]) -> pd.DataFrame:
    """The rows that a sweep has written so far, in the order of its chunks.

    The file may be of a sweep that is still running.

    Raises
    ------
    ValueError
        If the file is no sweep's.
    """
    return decode(by_number(read_lines(path, KIND)))


def batch_size(waiting: int, takers: int, seconds: float, each: float, least: float = 0.1) -> int:
    """How many of the chunks that wait one of several workers should take.

    So many seconds' at so many each, a thousand at most; less at the end, so that all end together,
    but no less than what takes 0.1 s.
    """
    within, few = (max(1, min(int(s / max(each, 1e-6)), 1000)) for s in (seconds, least))
    return min(within, max(-(-waiting // (2 * takers)), few))


class _Sweep:
    """What is to be done, what has been, and what has killed workers.

    When a worker dies, one of the chunks that were under way may have killed it. Each is then done
    with nothing beside it, so that there is no doubt the next time.
    """

    def __init__(self, job: Job, log: Log | None) -> None:
        self.job, self._log = job, log
        self.lines = {} if log is None else by_number(log.lines)
        strange = self.lines.keys() - job.chunks.keys()
        if log is not None and strange:
            raise ValueError(
                f"{str(log.path)!r} has a line for chunk {min(strange)} of {len(job.chunks)}; it "
                "was changed by hand: name another file, or remove this one."
            )
        self.queue = deque(number for number in job.chunks if number not in self.lines)
        self._suspects: set[int] = set()
        self._deaths: Counter[int] = Counter()
        self._failure, self._trace = "", ""
        self._each = float("inf")  # seconds that a chunk takes, before one is done

    def finish(self, executor: Workers, advance: Callable[[float], None]) -> None:
        """Hand out and write until all is done; a failure waits for what is under way."""
        held: dict[Future[Report], list[int]] = {}
        lost: list[int] = []
        while held or lost or (self.queue and not self._failure):
            if lost and not held:
                executor.restart()
                self._blame(lost, executor.trials)
                lost = []
            while len(held) < executor.slots and not (lost or self._failure):
                if not (numbers := self._next(executor, bool(held))):
                    break
                held[executor.submit(self.job.only(numbers))] = numbers
            done = wait(held, timeout=1.0, return_when=FIRST_COMPLETED).done
            if held and not done:
                executor.check()
            for future in done:
                numbers = held.pop(future)
                error = CancelledError() if future.cancelled() else future.exception()
                if error is None:
                    advance(self._keep(future.result()))
                elif executor.died(error):
                    lost += numbers
        if self._failure:
            wrong = CampaignError(self._failure + self.kept)
            if self._trace:
                wrong.add_note(self._trace)
            raise wrong

    def _next(self, executor: Workers, busy: bool) -> list[int]:
        """Chunks for one worker, from the left of the queue; those that may kill are done alone."""
        if self._suspects:
            return [self.queue.popleft()] if self.queue and not busy else []
        size = batch_size(len(self.queue), executor.slots, executor.seconds, self._each)
        return [self.queue.popleft() for _ in range(min(size, len(self.queue)))]

    def _keep(self, report: Report) -> int:
        """Write what was done, once; returns how many chunks were new."""
        new = {number: line for number, line in report.lines.items() if number not in self.lines}
        if self._log is not None:
            self._log.append(*new.values())
        self.lines |= new
        self._suspects -= new.keys()
        self.queue.extendleft(reversed(report.back))
        if report.ended:
            self._each = report.each
        if report.failure and not self._failure:
            number, words, self._trace = report.failure
            self._failure = f"chunk {number} {self.job.chunks[number]} failed: {words}"
        return len(new)

    def _blame(self, lost: list[int], trials: int) -> None:
        """Who may have killed the worker; who has been alone with it so often is given up."""
        self.queue.extendleft(sorted(lost, reverse=True))
        if len(lost) == 1 and (trials > 1 or lost[0] in self._suspects):
            self._deaths[lost[0]] += 1
            if self._deaths[lost[0]] >= trials:
                times = f"{trials} times" if trials > 1 else "several times"
                self._failure = (
                    f"chunk {lost[0]} {self.job.chunks[lost[0]]} has killed its worker {times}, as "
                    "want of memory does."
                )
        self._suspects |= {*lost}

    @property
    def kept(self) -> str:
        """Where what was done is, in words."""
        if self._log is None:
            return ""
        return f" {len(self.lines)} chunks are done and kept in {str(self._log.path)!r}."


class _Lost(Exception):
    """All workers have gone, or none begins."""


class _Mismatch(Exception):
    """A worker with other versions than this process."""


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
            raise _Lost(
                "workers end as soon as they start, and what they printed says why; a script that "
                'starts workers needs `if __name__ == "__main__":`.'
            ) from None

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
        # A client that has failed is closed when it is collected: while another starts, for ever.
        gc.collect()
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
        words = f"a task ended with {type(error).__name__}: {' '.join(str(error).split())}"
        raise self._lost(str(error) if isinstance(error, _Mismatch) else words)

    def check(self) -> None:
        """Refuse to wait for a scheduler that has gone, or where there are no workers."""
        try:
            if self._client.status != "running":
                raise OSError
            self.slots, anybody = self._count(), bool(self._client.nthreads())
        except (OSError, TimeoutError):
            raise self._lost("the scheduler does not answer") from None
        if anybody:
            self._deadline = time.monotonic() + self._patience
        elif time.monotonic() > self._deadline:
            raise self._lost(f"it has had no workers for {self._patience:g} s")

    def _lost(self, why: str) -> _Lost:
        return _Lost(f"the cluster was lost: {why}.")

    def close(self) -> None:
        with suppress(Exception):  # it may have gone
            self._pool.shutdown(wait=False, cancel_futures=True)
        with suppress(Exception):
            self._client.close(timeout=2.0)
        self._silent.setLevel(self._level)


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
