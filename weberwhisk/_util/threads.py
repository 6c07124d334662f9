"""Cores of the machine, and one thread for linear algebra."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from threading import Lock
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from threadpoolctl import ThreadpoolController

__all__ = ["core_count", "in_browser", "limited_blas", "one_blas_thread"]


def in_browser() -> bool:
    """Whether this is Python in WebAssembly (Pyodide), which has neither threads nor processes."""
    return sys.platform == "emscripten"


def core_count() -> int:
    """Cores that this process may run on, which may be fewer than the machine has."""
    if in_browser():
        return 1
    affinity = getattr(os, "sched_getaffinity", None)  # not on every system
    return len(affinity(0)) if affinity else os.cpu_count() or 1


@cache
def _libraries() -> ThreadpoolController:
    """The libraries of linear algebra."""
    import scipy.linalg  # noqa: F401  # its library must be loaded to be found
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


_lock = Lock()
_holders: list[Any] = []  # the limit, once for each thread within it


@contextmanager
def limited_blas() -> Iterator[None]:
    """Let linear algebra use one thread: more would add in another order.

    The limit is the whole process's: it ends when the last thread that needs it leaves.
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


#: As a decorator: products are many and small, and waking a second thread for each takes longer.
one_blas_thread = limited_blas()
