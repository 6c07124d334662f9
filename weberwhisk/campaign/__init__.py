"""Sweeps: the same work on many chunks, serially, on all cores, or on a cluster.

Recovery, power, calibration and surfaces of JNDs are all of one kind: a function of a chunk (what
to do) and a seed (its own) that returns a table. `run` does it for every chunk, and the answer is
the same to the bit whatever does it and in what order.
"""

from __future__ import annotations

import json
import os
import sys
import time
import warnings
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, wait
from contextlib import ExitStack, closing, contextmanager
from datetime import timedelta
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np

from .. import _checks
from ..threads import core_count, in_browser
from .executor import (
    Chunk,
    Cluster,
    ClusterLost,
    Job,
    Processes,
    Report,
    Work,
    Workers,
    WorkerStartupError,
)
from .log import Log, by_number, decode, read_lines, versions

if TYPE_CHECKING:
    import pandas as pd

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
    name = _check_work(work)
    plain = _check_chunks(chunks)
    _checks.whole("workers", workers, "write 2")
    if workers > 1 and in_browser():
        warnings.warn("a browser has no processes: the chunks are done serially.", stacklevel=2)
        workers = 1
    if scheduler is not None and workers != 1:
        raise ValueError(
            f"a cluster has its own workers, got workers={workers} with a scheduler; leave one out."
        )
    root = _root(seed)
    entropy = np.asarray(root.entropy, dtype=object).tolist()
    job = Job(work, dict(enumerate(plain)), entropy, tuple(int(k) for k in root.spawn_key))
    with ExitStack() as opened:
        log = None if out is None else opened.enter_context(_log(out, job, name, title))
        sweep = _Sweep(job, log)
        if sweep.queue:
            done = len(sweep.lines)
            if progress is None:
                bar = shown(title or "Sweep", len(job.chunks), done=done)
                progress = opened.enter_context(bar)
            else:
                progress(done)
            try:
                executor = opened.enter_context(closing(_executor(sweep, workers, scheduler)))
                sweep.finish(executor, progress)
            except WorkerStartupError:
                raise CampaignError(
                    "workers end as soon as they start, and what they printed says why; a script "
                    'that starts workers needs `if __name__ == "__main__":`.'
                ) from None
            except ClusterLost as error:
                raise CampaignError(f"the cluster was lost: {error}.{sweep.kept}") from None
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
        strange = [number for number in self.lines if number >= len(job.chunks)]
        if log is not None and strange:
            raise ValueError(
                f"{str(log.path)!r} has a line for chunk {strange[0]} of {len(job.chunks)}; it was "
                "changed by hand: name another file, or remove this one."
            )
        self.queue = deque(number for number in job.chunks if number not in self.lines)
        self._suspects: set[int] = set()
        self._deaths: Counter[int] = Counter()
        self._failure: str | None = None
        self._trace = ""
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
                numbers = self._next(executor, bool(held))
                if not numbers:
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
        if busy and self._suspects:
            return []
        numbers: list[int] = []
        most = batch_size(len(self.queue), executor.slots, executor.seconds, self._each)
        while self.queue and len(numbers) < most and not (numbers and self._suspects):
            numbers.append(self.queue.popleft())
        return numbers

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


def _log(out: str | os.PathLike[str], job: Job, name: str, title: str) -> Log:
    question = {
        "work": name,
        "seed": {"entropy": job.entropy, "spawn_key": list(job.spawn_key)},
        "chunks": list(job.chunks.values()),
        "versions": versions(),
    }
    return Log(out, KIND, question, {"title": title})


def _executor(sweep: _Sweep, workers: int, scheduler: str | None) -> Workers:
    if scheduler is not None:
        return Cluster(scheduler)
    return Workers() if workers == 1 else Processes(min(workers, len(sweep.queue)))


def _root(seed: int | np.random.SeedSequence) -> np.random.SeedSequence:
    if isinstance(seed, np.random.SeedSequence):
        return seed
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise ValueError(
            f"seed must be a whole number or a SeedSequence, got {seed!r}; a sweep that is resumed "
            "must find the same seeds again: write 1, say."
        )
    return np.random.SeedSequence(int(seed))


def _check_work(work: Any) -> str:
    """The name of a function that a fresh interpreter can find."""
    module, name = getattr(work, "__module__", None), getattr(work, "__qualname__", None)
    found: Any = None
    if module and name and "<" not in name:
        found = import_module(module)
        for part in name.split("."):
            found = getattr(found, part, None)
    if found is None or found is not work:
        raise ValueError(
            f"work must be a function at the top level of a module, got {work!r}; move it there, "
            "and what it needs to know into the chunks."
        )
    return f"{module}:{name}"


def _check_chunks(chunks: Iterable[Chunk]) -> list[Chunk]:
    """The chunks as JSON has them, so that a resumed sweep works on the very same ones."""
    plain: list[Chunk] = []
    for number, chunk in enumerate(chunks):
        try:
            if not isinstance(chunk, dict):
                raise TypeError
            plain.append(json.loads(json.dumps(chunk, allow_nan=False)))
        except (TypeError, ValueError):
            raise ValueError(
                f"chunk {number} must be a dict of plain finite numbers, text, lists and dicts, "
                f"got {chunk!r}; write arrays as lists."
            ) from None
    if not plain:
        raise ValueError("there are no chunks; give one dict or more.")
    return plain


@contextmanager
def shown(
    title: str, total: float, *, done: float = 0.0, every: float = 15.0
) -> Iterator[Callable[..., None]]:
    """Progress on standard error: a bar with the time left, or without a terminal a line each so
    many seconds. Yields a function that takes how much more of `total` has been done, 1 by default.
    """
    now, began = done, time.monotonic()
    told = began
    if sys.stderr.isatty():
        from rich.console import Console
        from rich.progress import Progress

        with Progress(console=Console(stderr=True), transient=True) as bar:
            # What was done before is no measure of how fast it goes now.
            task = bar.add_task(title, total=total, completed=int(done))
            yield lambda more=1.0: bar.advance(task, more)
        return

    def advance(more: float = 1.0) -> None:
        nonlocal now, told
        now += more
        if time.monotonic() - told < every or now <= done:
            return
        told = time.monotonic()
        left = timedelta(seconds=round((told - began) * (total - now) / (now - done)))
        share = f"{100 * now / total:.0f} % after {told - began:.0f} s"
        print(f"{title}: {share}, about {left} left", file=sys.stderr, flush=True)

    yield advance
