"""The same work on all cores of the machine: NumPy lets go of the interpreter while it computes."""

from __future__ import annotations

import multiprocessing
import os
import sys
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar, copy_context
from functools import cache
from threading import Lock
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from threadpoolctl import ThreadpoolController

__all__ = [
    "core_count", "in_browser", "limited_blas", "on_threads", "one_blas_thread", "thread_count",
]  # fmt: skip

Task = TypeVar("Task")
Result = TypeVar("Result")

_inside: ContextVar[bool] = ContextVar("inside a thread of on_threads", default=False)


def in_browser() -> bool:
    """Whether this is Python in WebAssembly (Pyodide), which has neither threads nor processes."""
    return sys.platform == "emscripten"


def core_count() -> int:
    """Cores that this process may run on, which may be fewer than the machine has."""
    if in_browser():
        return 1
    affinity = getattr(os, "sched_getaffinity", None)  # not on every system
    return len(affinity(0)) if affinity else os.cpu_count() or 1


def thread_count() -> int:
    """How many threads to use: the cores this process may run on, or ``OMP_NUM_THREADS`` if less.

    One in a worker process, whose fellows have the other cores.
    """
    if multiprocessing.parent_process() is not None:
        return 1
    asked = os.environ.get("OMP_NUM_THREADS", "")
    return min(core_count(), max(int(asked), 1)) if asked.isdecimal() else core_count()


@cache
def _libraries() -> ThreadpoolController:
    """The libraries of linear algebra, whose own threads spin while they wait for work."""
    import scipy.linalg  # noqa: F401  # its library must be there to be told
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


_lock = Lock()
_holders: list[Any] = []  # the limit, once for everyone within it


@contextmanager
def limited_blas() -> Iterator[None]:
    """Leave linear algebra one thread within: others would add in another order, and their many
    small products wait for a thread to wake.

    The limit is the whole process's: it ends when the last of those within it leaves, whichever
    thread that is, or the first to leave would end it for the others.
    """
    if in_browser():
        yield
        return
    with _lock:
        first = not _holders
        _holders.append(_libraries().limit(limits=1, user_api="blas") if first else _holders[0])
    try:
        yield
    finally:
        with _lock:
            limit = _holders.pop()
            if not _holders:
                limit.restore_original_limits()


#: As a decorator: products are many and small, and with a thread more each of them waits for the
#: other thread to wake, which on shared cores takes tens of times as long.
one_blas_thread = limited_blas()


def on_threads(function: Callable[[Task], Result], tasks: Iterable[Task]) -> Iterator[Result]:
    """Results in the order of the tasks, which must not depend on each other.

    A task that has tasks of its own does these one after the other.
    """
    waiting = list(tasks)
    count = 1 if _inside.get() else min(thread_count(), len(waiting))
    if count < 2:
        yield from map(function, waiting)
        return

    def task_of_many(task: Task) -> Result:
        _inside.set(True)
        return function(task)

    # NumPy's error state belongs to the context, and a thread starts with a fresh one.
    with limited_blas(), ThreadPoolExecutor(count) as pool:
        ahead: deque[Future[Result]] = deque()
        try:
            for task in waiting:
                ahead.append(pool.submit(copy_context().run, task_of_many, task))
                if len(ahead) > 2 * count:  # no further ahead: results take memory
                    yield ahead.popleft().result()
            while ahead:
                yield ahead.popleft().result()
        finally:
            for future in ahead:
                future.cancel()
