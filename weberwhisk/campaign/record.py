"""The lines of the chunks that are done, and the file that they stream into."""

from __future__ import annotations

import json
import os
from contextlib import ExitStack
from typing import TYPE_CHECKING, Self

from .. import journal
from .job import Job, decode

if TYPE_CHECKING:
    import pandas as pd

KIND = "sweep"


class Record:
    """Lines by number of the chunk, in memory and, where there is a file, in the file.

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
        question = {
            "work": name,
            "seed": {"entropy": job.entropy, "spawn_key": list(job.spawn_key)},
            "chunks": list(job.chunks.values()),
            "versions": journal.versions(),
        }
        self._journal: journal.Journal | None = None
        if path is not None:
            self._journal = journal.Journal(path, KIND, question, {"title": title})
        self._most = len(job.chunks)
        self._open = ExitStack()

    def __enter__(self) -> Self:
        if self._journal is not None:
            self._open.enter_context(self._journal)
            self.lines = _by_number(self._journal.lines)
            strange = [number for number in self.lines if number >= self._most]
            if strange:
                self._open.close()
                raise ValueError(
                    f"{self.where!r} has a line for chunk {strange[0]} of {self._most}; it was "
                    "changed by hand: name another file, or remove this one."
                )
        return self

    def __exit__(self, *error: object) -> None:
        self._open.close()

    @property
    def where(self) -> str | None:
        """The file, if there is one."""
        return None if self._journal is None else str(self._journal.path)

    def add(self, lines: dict[int, str]) -> int:
        """Keep what was done, once; returns how many were new."""
        new = {number: line for number, line in lines.items() if number not in self.lines}
        if self._journal is not None:
            self._journal.append(*new.values())
        self.lines |= new
        return len(new)

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
    return decode(_by_number(journal.read(path, KIND)))


def _by_number(lines: list[str]) -> dict[int, str]:
    found: dict[int, str] = {}
    for line in lines:
        found.setdefault(int(json.loads(line)["chunk"]), line)
    return found
