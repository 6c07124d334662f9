"""The file that a sweep streams into: what was asked, then a line for every chunk done.

JSON lines, appended to and never rewritten. A process killed while it writes leaves half a line at
the end, which is cut off when the sweep goes on.
"""

from __future__ import annotations

import json
import os
import platform
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, Self

import numpy as np

from .. import __version__
from .job import Job, decode

if TYPE_CHECKING:
    import pandas as pd

MARK = "weberwhisk_campaign"
FORMAT = 1


@cache
def versions() -> dict[str, str]:
    """What the bits of a result hang on."""
    return {"weberwhisk": __version__, "numpy": np.__version__, "scipy": version("scipy")}


class Record:
    """Lines of the chunks that are done, in memory and, where there is a file, in the file.

    Parameters
    ----------
    path : path or None
        None: in memory alone.
    job : Job
    name : str
        Of the work.
    title : str
        For a reader of the file.

    Raises
    ------
    ValueError
        If the file holds anything else, or is being written by another process.
    """

    def __init__(
        self, path: str | os.PathLike[str] | None, job: Job, name: str, title: str
    ) -> None:
        self.lines: dict[int, str] = {}
        self.path = None if path is None else Path(path)
        self._file: BinaryIO | None = None
        self._question = {
            "work": name,
            "seed": {"entropy": job.entropy, "spawn_key": list(job.spawn_key)},
            "chunks": list(job.chunks.values()),
            "versions": versions(),
        }
        self._about = {
            "title": title,
            "python": platform.python_version(),
            "started": datetime.now(UTC).isoformat(timespec="seconds"),
        }

    def __enter__(self) -> Self:
        if self.path is None:
            return self
        try:
            self._file = open(self.path, "a+b")
        except OSError as error:
            raise ValueError(
                f"{str(self.path)!r} cannot be written ({error.strerror}); name a file in a folder "
                "that exists and that you may write to."
            ) from error
        try:
            _lock(self._file, self.path)
            self._resume(self._file)
        except BaseException:
            self._file.close()
            raise
        return self

    def __exit__(self, *error: object) -> None:
        if self._file is not None:
            self._file.flush()
            os.fsync(self._file.fileno())
            self._file.close()

    def _resume(self, file: BinaryIO) -> None:
        assert self.path is not None
        header, self.lines, good = _parse(file, self.path)
        file.truncate(good)
        if header is None:
            self._write(json.dumps({MARK: FORMAT, **self._about, **self._question}))
            return
        for what, asked in self._question.items():
            if header.get(what) != asked:
                raise ValueError(
                    f"{str(self.path)!r} holds another sweep: {_difference(what, header, asked)}; "
                    "name another file, or remove this one."
                )
        strange = [number for number in self.lines if number >= len(header["chunks"])]
        if strange:
            raise ValueError(
                f"{str(self.path)!r} has a line for chunk {strange[0]} of {len(header['chunks'])}; "
                "it was changed by hand: name another file, or remove this one."
            )

    def add(self, lines: dict[int, str]) -> int:
        """Keep what was done, once; returns how many were new."""
        new = {number: line for number, line in lines.items() if number not in self.lines}
        for line in new.values():
            self._write(line)
        self.lines |= new
        return len(new)

    def _write(self, line: str) -> None:
        if self._file is not None:
            self._file.write(line.encode("ascii") + b"\n")
            # In the system's hands: safe from this process being killed.
            self._file.flush()

    def table(self) -> pd.DataFrame:
        """Everything done, in the order of the chunks."""
        return decode(self.lines)


def read(path: str | os.PathLike[str]) -> pd.DataFrame:
    """The rows that a sweep has written so far, in the order of its chunks.

    The file may be of a sweep that is still running.

    Raises
    ------
    ValueError
        If the file is no sweep's.
    """
    with open(path, "rb") as file:
        _, lines, _ = _parse(file, Path(path))
    return decode(lines)


def _parse(file: BinaryIO, path: Path) -> tuple[dict[str, Any] | None, dict[int, str], int]:
    """The header (None where the file has none yet), the lines, and where the good part ends."""
    file.seek(0)
    header: dict[str, Any] | None = None
    lines: dict[int, str] = {}
    good = 0
    refusal = (
        f"{str(path)!r} is not the file of a sweep, or was changed by hand (line {{}}); name "
        "another file."
    )
    start = json.dumps({MARK: FORMAT})[:-1].encode()
    content = file.read()
    *whole, rest = content.split(b"\n")
    for place, line in enumerate(whole):
        try:
            record = json.loads(line)
            if place == 0:
                header = record if record[MARK] == FORMAT else None
            else:
                lines.setdefault(int(record["chunk"]), line.decode("ascii"))
        except (ValueError, KeyError, TypeError):
            # A machine that goes down may leave zeros where the last line was to be.
            if place == 0 or place < len(whole) - 1 or rest:
                raise ValueError(refusal.format(place + 1)) from None
            return header, lines, good
        if header is None:
            raise ValueError(refusal.format(1))
        good += len(line) + 1
    if header is None and not (rest.startswith(start) or start.startswith(rest)):
        raise ValueError(refusal.format(1))
    return header, lines, good


def _difference(what: str, header: dict[str, Any], asked: Any) -> str:
    """What is not the same, in words."""
    was = header.get(what)
    if what == "chunks" and isinstance(was, list):
        if len(was) != len(asked):
            return f"it has {len(was)} chunks, not {len(asked)}"
        number = next(i for i, (a, b) in enumerate(zip(was, asked, strict=True)) if a != b)
        return f"its chunk {number} is {was[number]}, not {asked[number]}"
    return f"its {what} is {was}, not {asked}"


def _lock(file: BinaryIO, path: Path) -> None:
    """Let no other process write the same file; the system unlocks it however this one ends."""
    try:
        import fcntl
    except ImportError:  # no such locks on Windows
        return
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise ValueError(
            f"{str(path)!r} is being written by another sweep; wait for it, or name another file."
        ) from None
    except OSError:
        return  # a file system without locks
