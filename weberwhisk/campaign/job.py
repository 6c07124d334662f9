"""What a sweep asks of every worker, and the line of text that it gets back."""

from __future__ import annotations

import json
import time
import traceback
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from importlib import import_module
from math import isfinite
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import pandas as pd

Chunk = dict[str, Any]
Work = Callable[[Chunk, np.random.SeedSequence], "pd.DataFrame"]


@dataclass(frozen=True)
class Job:
    """The same function of every chunk, each with the seed that its number gives it.

    Parameters
    ----------
    work : callable
        At the top level of a module that every worker can import.
    chunks : dict of int to dict
        By number; a job for one worker may have some of them only.
    entropy, spawn_key
        The root of the seeds.
    """

    work: Work
    chunks: dict[int, Chunk]
    entropy: int | Sequence[int]
    spawn_key: tuple[int, ...] = ()

    def only(self, numbers: Iterable[int]) -> Job:
        """The same job for some of its chunks."""
        return replace(self, chunks={number: self.chunks[number] for number in numbers})

    def seed(self, number: int) -> np.random.SeedSequence:
        """The seed of a chunk, which hangs on the root and its number alone."""
        return np.random.SeedSequence(self.entropy, spawn_key=(*self.spawn_key, number))

    def do(self, numbers: Sequence[int], seconds: float) -> Report:
        """Chunks in this order, until one has failed or they have taken so long together.

        Their seeds are made before and their tables written after the work: among long arithmetic,
        which fills the processor's caches with other things, either takes three times as long.
        """
        report, since = Report(), time.monotonic()
        tables: dict[int, pd.DataFrame] = {}
        asked = [(number, dict(self.chunks[number]), self.seed(number)) for number in numbers]
        for number, chunk, seed in asked:
            try:
                tables[number] = self.work(chunk, seed)
            except Exception as error:
                report.fail(number, error)
            if report.failure or time.monotonic() - since > seconds:
                break
        for number, frame in tables.items():
            try:
                report.lines[number] = encode(number, frame)
            except Exception as error:
                report.fail(number, error)
        report.back = [number for number in numbers if number not in report.ended]
        report.each = (time.monotonic() - since) / len(report.ended)
        return report


@dataclass
class Report:
    """What became of some chunks.

    Parameters
    ----------
    lines : dict of int to str
        Results, by number of the chunk.
    back : list of int
        Chunks given back undone.
    suspects : list of int
        Chunks one of which may have killed its worker.
    deadly : int, optional
        A chunk that certainly has, time and again.
    failure : (int, str, str), optional
        A chunk that raised an exception, which, and its traceback.
    each : float
        Seconds that a chunk took.
    """

    lines: dict[int, str] = field(default_factory=dict)
    back: list[int] = field(default_factory=list)
    suspects: list[int] = field(default_factory=list)
    deadly: int | None = None
    failure: tuple[int, str, str] | None = None
    each: float = 0.0

    @property
    def ended(self) -> list[int]:
        """Chunks that were done, or have failed."""
        return [*self.lines, *([self.failure[0]] if self.failure else [])]

    def fail(self, number: int, error: Exception) -> None:
        """A chunk that raised an exception; the first is kept."""
        words = f"{type(error).__name__}: {error}"
        self.failure = self.failure or (number, words, "".join(traceback.format_exception(error)))


def check_work(work: Any) -> str:
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


def check_chunks(chunks: Iterable[Chunk]) -> list[Chunk]:
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


def encode(number: int, frame: pd.DataFrame) -> str:
    """A table as one line of strict JSON, every number to its last bit.

    Raises
    ------
    ValueError
        For anything but a DataFrame of numbers, booleans and text.
    """
    import pandas as pd

    if not isinstance(frame, pd.DataFrame):
        raise ValueError(f"work must return a DataFrame, got {type(frame).__name__}.")
    if not frame.columns.is_unique or not all(isinstance(name, str) for name in frame.columns):
        raise ValueError(
            f"work must return columns with different names, got {list(frame.columns)}."
        )
    columns = {str(name): _plain(str(name), column) for name, column in frame.items()}
    record = {"chunk": number, "rows": len(frame), "columns": columns}
    return json.dumps(record, allow_nan=False)


def _plain(name: str, column: pd.Series) -> list[Any]:
    """Kind of a column and its values; what JSON has no number for is text."""
    if isinstance(column.dtype, np.dtype) and column.dtype.kind in "biuf":
        values = column.to_list()
        if column.dtype.kind == "f":
            values = [v if isfinite(v) else str(v) for v in values]
        return [column.dtype.name, values]
    texts = [v if isinstance(v, str) or not _missing(v) else None for v in column.to_list()]
    if not all(v is None or isinstance(v, str) for v in texts):
        raise ValueError(
            f"work must return numbers, booleans or text, got a column {name!r} of {column.dtype}."
        )
    return ["text", texts]


def _missing(value: Any) -> bool:
    import pandas as pd

    return value is None or value is pd.NA or value is pd.NaT or value != value


def decode(lines: dict[int, str]) -> pd.DataFrame:
    """The tables of all chunks in one, in the order of the chunks."""
    import pandas as pd

    tables = [json.loads(line) for _, line in sorted(lines.items())]
    tables = [table for table in tables if table["rows"]] or tables[:1]
    if not tables:
        return pd.DataFrame()
    first = tables[0]
    for table in tables:
        if list(table["columns"]) != list(first["columns"]):
            raise ValueError(
                f"chunk {table['chunk']} returned the columns {list(table['columns'])}, and chunk "
                f"{first['chunk']} {list(first['columns'])}; let work return the same ones always."
            )
    return pd.DataFrame(
        {name: _joined([table["columns"][name] for table in tables]) for name in first["columns"]}
    )


def _joined(parts: list[list[Any]]) -> Any:
    if any(kind == "text" for kind, _ in parts):
        return [value for _, values in parts for value in values]
    return np.concatenate(
        [
            # Written apart: NumPy reads a list with text in it as text.
            np.array([float(v) for v in values] if kind.startswith("float") else values, kind)
            for kind, values in parts
        ]
    )
