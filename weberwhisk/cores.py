"""How many cores there are to work on."""

from __future__ import annotations

import os


def core_count() -> int:
    """Cores that this process may run on, which may be fewer than the machine has.

    Examples
    --------
    >>> core_count() >= 1
    True
    """
    affinity = getattr(os, "sched_getaffinity", None)  # not on every system
    return len(affinity(0)) if affinity else os.cpu_count() or 1
