"""A sweep from question to table."""

from __future__ import annotations

import os
import sys
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing, contextmanager
from datetime import timedelta
from typing import TYPE_CHECKING

import numpy as np

from .. import _checks
from ..cores import core_count
from .cluster import Cluster, ClusterLost
from .crews import MOST_DEATHS, Crew, Processes, Serial, WorkersDieAtBirth
from .job import Chunk, Job, Report, Work, check_chunks, check_work
from .record import Record

if TYPE_CHECKING:
    import pandas as pd


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
        ``if __name__ == "__main__":``.
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
    `weberwhisk.jnd_surface` gives one chunk to each Weber fraction:

    >>> from weberwhisk.jnd_surface import jnd_rows
    >>> tap = {"whisker": {"length": 50e-3, "base_radius": 1e-4, "tip_radius": 5e-6},
    ...        "radial_distance": [5e-3], "deflection_angle": None,
    ...        "method": "quadrature", "criterion": "d'=1", "draws": 4}
    >>> table = run(jnd_rows, [tap | {"weber_fraction": k} for k in (0.05, 0.1)], seed=1)
    >>> (table["closed_form"] * 1e3).round(3).tolist()
    [0.226, 0.453]
    """
    name = check_work(work)
    plain = check_chunks(chunks)
    _checks.whole("workers", workers, "write 2")
    if scheduler is not None and workers != 1:
        raise ValueError(
            f"a cluster has its own workers, got workers={workers} with a scheduler; leave one out."
        )
    root = _root(seed)
    entropy = np.asarray(root.entropy, dtype=object).tolist()
    job = Job(work, dict(enumerate(plain)), entropy, tuple(int(k) for k in root.spawn_key))
    with Record(out, job, name, title) as record:
        queue = deque(number for number in job.chunks if number not in record.lines)
        if queue:
            done = len(plain) - len(queue)
            with (
                _shown(progress, title, done, len(plain)) as advance,
                closing(_crew(job.only(queue), workers, scheduler)) as crew,
            ):
                _drive(crew, queue, job, record, advance)
        return record.table()


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


def _root(seed: int | np.random.SeedSequence) -> np.random.SeedSequence:
    if isinstance(seed, np.random.SeedSequence):
        return seed
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise ValueError(
            f"seed must be a whole number or a SeedSequence, got {seed!r}; a sweep that is resumed "
            "must find the same seeds again: write 1, say."
        )
    return np.random.SeedSequence(int(seed))


def _crew(job: Job, workers: int, scheduler: str | None) -> Crew:
    if scheduler is not None:
        return Cluster(job, scheduler)
    return Serial(job) if workers == 1 else Processes(job, min(workers, len(job.chunks)))


def _drive(
    crew: Crew, queue: deque[int], job: Job, record: Record, advance: Callable[[float], None]
) -> None:
    """Give, take and write until all is done; a failure waits for what is under way."""
    alone: set[int] = set()
    failed: Report | None = None
    try:
        while queue or crew.busy:
            if failed is None:
                crew.give(queue, alone)
            elif not crew.busy:
                break
            report = crew.take()
            advance(record.add(report.lines))
            queue.extendleft(reversed(report.back + report.suspects))
            alone |= {*report.suspects}
            if report.failure or report.deadly is not None:
                failed = failed or report
    except WorkersDieAtBirth as error:
        raise CampaignError(
            f"workers end as soon as they start (exit status {error.args[0]}), and what they "
            'printed says why; a script that starts workers needs `if __name__ == "__main__":`.'
        ) from None
    except ClusterLost as error:
        raise CampaignError(f"the cluster was lost: {error}.{_kept(record)}") from error
    if failed is not None:
        _raise(failed, job, record)


def _raise(failed: Report, job: Job, record: Record) -> None:
    if failed.failure is None:
        assert failed.deadly is not None
        raise CampaignError(
            f"chunk {failed.deadly} {job.chunks[failed.deadly]} has killed its worker "
            f"{MOST_DEATHS} times, as want of memory does.{_kept(record)}"
        )
    number, words, trace = failed.failure
    error = CampaignError(f"chunk {number} {job.chunks[number]} failed: {words}{_kept(record)}")
    error.add_note(trace)
    raise error


def _kept(record: Record) -> str:
    if record.where is None:
        return ""
    return f" {len(record.lines)} chunks are done and kept in {record.where!r}."


class _Lines:
    """Progress as plain lines on standard error, few of them: none where it takes seconds."""

    def __init__(self, title: str, done: int, total: int, seconds: float = 15.0) -> None:
        self._title, self._done, self._total, self._seconds = title, done, total, seconds
        self._before, self._began = done, time.monotonic()
        self._next = self._began + seconds

    def advance(self, more: float) -> None:
        self._done += int(more)
        now = time.monotonic()
        if now < self._next or self._done <= self._before:
            return
        self._next = now + self._seconds
        each = (now - self._began) / (self._done - self._before)
        left = str(timedelta(seconds=round(each * (self._total - self._done))))
        text = f"{self._title}: {self._done} of {self._total}, about {left} left"
        print(text, file=sys.stderr, flush=True)


@contextmanager
def _shown(
    progress: Callable[[float], None] | None, title: str, done: int, total: int
) -> Iterator[Callable[[float], None]]:
    """What to tell of chunks that are done."""
    if progress is not None:
        progress(done)
        yield progress
        return
    if not sys.stderr.isatty():
        yield _Lines(title or "Sweep", done, total).advance
        return
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeRemainingColumn,
    )

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
    console = Console(stderr=True)
    with Progress(*columns, TimeRemainingColumn(), console=console, transient=True) as bar:
        # What was done before is no measure of how fast it goes now.
        task = bar.add_task(title or "Sweep", total=total, completed=done)
        yield lambda more: bar.advance(task, more)
