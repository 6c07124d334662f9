"""An existing `dask.distributed` cluster as a crew."""

from __future__ import annotations

import queue as queues
import time
from collections import deque
from typing import Any

from ..journal import versions
from .crews import UNKNOWN, fair, one_thread, portion
from .job import Job, Report

SECONDS = 1.5  # of work in one task: the cluster's own cost is some ten milliseconds a task
PATIENCE = 300.0  # seconds without any worker, before the sweep is given up
COUNT_EVERY = 2.0  # seconds between two looks at how many workers there are
CONNECT = 15.0  # seconds to reach the scheduler


class ClusterLost(Exception):
    """The scheduler or all its workers have gone."""


class Cluster:
    """The workers of a scheduler, whoever they are at the time.

    The scheduler gives the task of a worker that dies to another one. After some deaths it gives
    up the tasks that were waiting there too, so a chunk is said to kill only when it has had the
    whole cluster to itself.

    Parameters
    ----------
    job : Job
    address : str
        Such as ``tcp://node1:8786``.

    Raises
    ------
    ValueError
        If dask.distributed is not installed, or nobody answers at the address.
    """

    def __init__(self, job: Job, address: str) -> None:
        try:
            from distributed import Client
        except ImportError:
            raise ValueError(
                "a scheduler needs dask.distributed, which is not installed; write "
                "pip install 'weberwhisk[cluster]'."
            ) from None
        try:
            self._client: Any = Client(address, set_as_default=False, timeout=CONNECT)
        except (OSError, ValueError, TimeoutError) as error:
            raise ValueError(
                f"no scheduler could be reached at {address!r} ({type(error).__name__}); start one "
                "with `dask scheduler`, and give the address that it prints."
            ) from error
        self._job = job
        self._held: dict[Any, list[int]] = {}
        self._done: queues.Queue[Any] = queues.Queue()
        self._each = UNKNOWN
        self._sole = False  # whether what is held is one chunk that may kill
        self._slots, self._counted = 1, -COUNT_EVERY
        self._wanted = versions()

    @property
    def busy(self) -> bool:
        return bool(self._held)

    def give(self, queue: deque[int], alone: set[int]) -> None:
        if queue and time.monotonic() - self._counted > COUNT_EVERY:
            self._slots = 2 * max(sum(self._client.nthreads().values()), 1)
            self._counted = time.monotonic()
        while queue and len(self._held) < self._slots and not self._sole:
            if queue[0] in alone and self._held:
                return
            most = fair(len(queue), self._slots, SECONDS, self._each)
            numbers = portion(queue, alone, most)
            self._sole = numbers[0] in alone
            future = self._client.submit(
                _some, self._job.only(numbers), self._wanted, pure=False, retries=0
            )
            self._held[future] = numbers
            future.add_done_callback(self._done.put)

    def take(self) -> Report:
        from distributed import KilledWorker

        future = self._next()
        numbers, sole, self._sole = self._held.pop(future), self._sole, False
        try:
            report: Report = future.result()
        except KilledWorker:
            if sole:  # the scheduler has tried it on several workers already
                return Report(deadly=numbers[0])
            return Report(suspects=numbers)
        except _Mismatch as error:
            raise ClusterLost(str(error)) from None
        except Exception as error:
            raise ClusterLost(f"a task ended with {type(error).__name__}: {error}") from error
        self._each = report.each
        return report

    def _next(self) -> Any:
        """The next task to end; none does where there are no workers."""
        deadline = time.monotonic() + PATIENCE
        while True:
            try:
                return self._done.get(timeout=1.0)
            except queues.Empty:
                pass
            if self._client.status != "running":
                raise ClusterLost("the scheduler does not answer")
            if self._client.nthreads():
                deadline = time.monotonic() + PATIENCE
            elif time.monotonic() > deadline:
                raise ClusterLost(f"it has had no workers for {PATIENCE:g} s")

    def close(self) -> None:
        self._client.cancel(list(self._held), force=True)
        self._client.close()


class _Mismatch(Exception):
    """A worker with other versions than this process."""


def _some(job: Job, wanted: dict[str, str]) -> Report:
    """A worker's share: its chunks, until they are done or have taken long enough."""
    if versions() != wanted:
        raise _Mismatch(f"a worker has {versions()}, not {wanted}")
    one_thread()
    return job.do(list(job.chunks), 2 * SECONDS)
