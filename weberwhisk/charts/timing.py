"""CPU time of a call, and what machine it was on."""

from __future__ import annotations

import platform
import time
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, TypeVar

from .. import __version__

T = TypeVar("T")
Row = dict[str, Any]


def timed(call: Callable[[], T], *, least: float = 5e-3, repeats: int = 3) -> tuple[T, float]:
    """The result of a call and the CPU seconds that it takes: the least of a few, caches warm.

    A call of more than `least` seconds is made once more and no further.

    Examples
    --------
    >>> value, seconds = timed(lambda: sum(range(1000)))
    >>> value, seconds > 0
    (499500, True)
    """
    result = call()
    times = []
    for _ in range(repeats):
        start, count = time.process_time(), 0
        while count == 0 or time.process_time() - start < least:
            result, count = call(), count + 1
        times.append((time.process_time() - start) / count)
        if times[-1] > least:
            break
    return result, min(times)


def machine(*packages: str) -> str:
    """Versions and kind of processor, for the foot of a figure."""
    listed = []
    for name in ("numpy", "scipy", "emcee", *packages):
        try:
            listed.append(f"{name} {version(name)}")
        except PackageNotFoundError:
            continue
    python = f"Python {platform.python_version()}, weberwhisk {__version__}"
    return f"{python}, {', '.join(listed)}; {_processor()}, one core, CPU time"


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text("utf-8").splitlines()
        return next(line.split(":", 1)[1].strip() for line in lines if "model name" in line)
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()
