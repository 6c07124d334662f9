"""Files that only grow: what was asked on the first line, then a line for every thing done.

JSON lines, appended to and never rewritten. A process killed while it writes leaves half a line at
the end, which is cut off when the next one goes on; whatever was written before is kept.
"""

from __future__ import annotations

import json
import os
import platform
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any, BinaryIO, Self

import numpy as np

from . import __version__

FORMAT = 1


@cache
def versions() -> dict[str, str]:
    """What the bits of a result hang on."""
    return {"weberwhisk": __version__, "numpy": np.__version__, "scipy": version("scipy")}


class Journal:
    """A file of JSON lines that belongs to one question, as a context manager.

    Parameters
    ----------
    path : path
        Made if it is missing. Where it holds an earlier part of the same, `lines` has that.
    kind : str
        What it is a journal of, one word.
    question : mapping
        What was asked, as JSON has it: must be the same whenever the file is gone on with.
    about : mapping, optional
        For a reader of the file.

    Attributes
    ----------
    lines : list of str
        The lines that were there, without the first.

    Raises
    ------
    ValueError
        If the file is of another question or of none, is being written by another process, or
        cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> file = tempfile.mkdtemp() + "/walk.jsonl"
    >>> with Journal(file, "walk", {"seed": 1}) as journal:
    ...     journal.append('{"step": 1}')
    >>> with Journal(file, "walk", {"seed": 1}) as journal:
    ...     journal.lines
    ['{"step": 1}']
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        kind: str,
        question: dict[str, Any],
        about: dict[str, Any] | None = None,
    ) -> None:
        self.path = Path(path)
        self.lines: list[str] = []
        self._kind = kind
        self._question = json.loads(json.dumps(question))
        self._about = about or {}

    def __enter__(self) -> Self:
        try:
            self._file = open(self.path, "a+b")
        except OSError as error:
            raise ValueError(
                f"{str(self.path)!r} cannot be written ({error.strerror}); name a file in a folder "
                "that exists and that you may write to."
            ) from error
        try:
            _lock(self._file, self.path)
            header, self.lines, good = _parse(self._file, self.path, self._kind)
            self._file.truncate(good)
            if header is None:
                self._begin()
            else:
                self._same(header)
        except BaseException:
            self._file.close()
            raise
        return self

    def __exit__(self, *error: object) -> None:
        self.sync()
        self._file.close()

    def append(self, *lines: str) -> None:
        """Add lines; they are in the system's hands, safe from this process being killed."""
        self._file.write("".join(f"{line}\n" for line in lines).encode("ascii"))
        self._file.flush()

    def sync(self) -> None:
        """Have it on the disk, safe from a power cut too."""
        os.fsync(self._file.fileno())

    def _begin(self) -> None:
        started = datetime.now(UTC).isoformat(timespec="seconds")
        about = {"python": platform.python_version(), "started": started} | self._about
        about = {"made_with": versions()} | about
        self.append(json.dumps({_mark(self._kind): FORMAT, **about, **self._question}))

    def _same(self, header: dict[str, Any]) -> None:
        for what, asked in self._question.items():
            if header.get(what) != asked:
                raise ValueError(
                    f"{str(self.path)!r} holds another {self._kind}: "
                    f"{_difference(what, header.get(what), asked)}; name another file, or remove "
                    "this one."
                )


def read(path: str | os.PathLike[str], kind: str) -> list[str]:
    """The lines written so far, without the first; the file may still be growing.

    Raises
    ------
    ValueError
        If it is no journal of that kind.
    """
    with open(path, "rb") as file:
        return _parse(file, Path(path), kind)[1]


def _mark(kind: str) -> str:
    return f"weberwhisk_{kind}"


def _parse(file: BinaryIO, path: Path, kind: str) -> tuple[dict[str, Any] | None, list[str], int]:
    """The header (None where the file has none yet), the lines, and where the good part ends."""
    file.seek(0)
    header: dict[str, Any] | None = None
    lines: list[str] = []
    good = 0
    refusal = (
        f"{str(path)!r} is not the file of a {kind}, or was changed by hand (line {{}}); name "
        "another file."
    )
    mark = _mark(kind)
    start = json.dumps({mark: FORMAT})[:-1].encode()
    *whole, rest = file.read().split(b"\n")
    for place, line in enumerate(whole):
        try:
            record = json.loads(line)
            if place == 0:
                header = record if record[mark] == FORMAT else None
            else:
                lines.append(line.decode("ascii"))
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


def _difference(what: str, was: Any, asked: Any) -> str:
    """What is not the same, in words."""
    if isinstance(was, list) and isinstance(asked, list):
        if len(was) != len(asked):
            return f"it has {len(was)} {what}, not {len(asked)}"
        at = next(i for i, (a, b) in enumerate(zip(was, asked, strict=True)) if a != b)
        return f"its {what} have {was[at]} in place {at}, not {asked[at]}"
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
            f"{str(path)!r} is being written by another process; wait for it, or name another file."
        ) from None
    except OSError:
        return  # a file system without locks
