"""Files that only grow: what was asked on the first line, then a line for every thing done.

JSON lines, appended to and never rewritten. A process killed while it writes leaves half a line at
the end, which is cut off when the next one goes on; whatever was written before is kept.
"""

from __future__ import annotations

import json
import os
import platform
import time
import traceback
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field, replace
from functools import cache
from importlib import import_module
from math import isfinite
from operator import attrgetter
from pathlib import Path
from typing import Any, BinaryIO, Self

import numpy as np

from .. import output
from .._checks import shown
from .._values import pd
from ..threads import limited_blas

FORMAT = 1
Chunk = dict[str, Any]
Work = Callable[[Chunk, np.random.SeedSequence], "pd.DataFrame"]


@cache
def versions() -> dict[str, str | None]:
    """What the bits of a result hang on."""
    return output.versions("numpy", "scipy")


class Log:
    """A file of JSON lines that belongs to one question, as a context manager.

    Made if it is missing; where it holds an earlier part of the same, `lines` has that, without the
    first. `kind` is what it is a log of, one word; `question` what was asked, as JSON has it, the
    same whenever the file is gone on with; `about` is for a reader of the file. Files of another
    question or of none, that another process is writing, or that cannot be written, are refused.

    Examples
    --------
    >>> import tempfile
    >>> file = tempfile.mkdtemp() + "/walk.jsonl"
    >>> with Log(file, "walk", {"seed": 1}) as log:
    ...     log.append('{"step": 1}')
    >>> with Log(file, "walk", {"seed": 1}) as log:
    ...     log.lines
    ['{"step": 1}']
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        kind: str,
        question: dict[str, Any],
        about: dict[str, Any] | None = None,
    ) -> None:
        if not isinstance(path, str | os.PathLike):
            raise ValueError(f"path must name a file, got {shown(path)}; write 'rat1.jsonl', say.")
        self.path = Path(path)
        self.lines: list[str] = []
        self._kind = kind
        self._question = json.loads(json.dumps(question))
        self._about = about or {}
        self._open = ExitStack()

    def __enter__(self) -> Self:
        with ExitStack() as opened:
            try:
                self._file = opened.enter_context(open(self.path, "a+b", buffering=0))
                lock = self.path.with_name(f".{self.path.name}.lock")
                opened.enter_context(output.locked(lock, 0.0))
            except TimeoutError:
                raise ValueError(
                    f"{str(self.path)!r} is being written by another process; wait for it, or name "
                    "another file."
                ) from None
            except OSError as error:
                raise output.unwritable(self.path, error) from error
            header, self.lines, good = _parse(self._file, self.path, self._kind)
            self._file.truncate(good)
            if header is None:
                self._begin()
            else:
                self._same(header)
            self._open = opened.pop_all()
        return self

    def __exit__(self, *error: object) -> None:
        with self._open:
            self.sync()

    def append(self, *lines: str) -> None:
        """Add lines; they are in the system's hands, safe from this process being killed.

        All of them or, where that fails, none.
        """
        text = "".join(f"{line}\n" for line in lines).encode("ascii")
        before = os.fstat(self._file.fileno()).st_size
        try:
            while text:  # a nearly full disk takes a part
                text = text[self._file.write(text) :]
        except OSError as error:
            self._file.truncate(before)
            raise output.unwritable(self.path, error) from error

    def sync(self) -> None:
        """Have it on the disk, safe from a power cut too."""
        os.fsync(self._file.fileno())

    def _begin(self) -> None:
        about = {"made_with": versions(), "python": platform.python_version()}
        about |= {"started": output.now()} | self._about
        self.append(json.dumps({_mark(self._kind): FORMAT, **about, **self._question}))

    def _same(self, header: dict[str, Any]) -> None:
        for what, asked in self._question.items():
            was = header.get(what)
            if was == asked:
                continue
            words = f"its {what} is {was}, not {asked}"
            if isinstance(was, list) and isinstance(asked, list):
                words = f"it has {len(was)} {what}, not {len(asked)}"
                if len(was) == len(asked):
                    at = next(i for i, (a, b) in enumerate(zip(was, asked, strict=True)) if a != b)
                    words = f"its {what} have {was[at]} in place {at}, not {asked[at]}"
            raise ValueError(
                f"{str(self.path)!r} holds another {self._kind}: {words}; name another file, or "
                "remove this one."
            )


def read_lines(path: str | os.PathLike[str], kind: str) -> list[str]:
    """The lines written so far, without the first; the file may still be growing."""
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


# -- what a worker does, and the tables of a sweep -------------------------------------------------


@dataclass(frozen=True)
class Job:
    """The same function of every chunk, each with the seed that its number gives it.

    `chunks` by number, for one worker some of them only; `entropy` and `spawn_key` are the root of
    the seeds.
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
        with limited_blas():
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

    `lines` of results by number of the chunk; `back`, chunks given back undone; `failure`, a chunk
    that raised an exception, which, and its traceback; `each`, seconds that a chunk took.
    """

    lines: dict[int, str] = field(default_factory=dict)
    back: list[int] = field(default_factory=list)
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


def job_of(
    work: Work, chunks: Iterable[Chunk], seed: int | np.random.SeedSequence
) -> tuple[Job, dict[str, Any]]:
    """The job that is asked for, and what its file says was asked."""
    name, plain, root = _checked_work(work), _checked_chunks(chunks), seed
    if not isinstance(root, np.random.SeedSequence):
        if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
            raise ValueError(
                f"seed must be a whole number or a SeedSequence, got {seed!r}; a sweep that is "
                "resumed must find the same seeds again: write 1, say."
            )
        root = np.random.SeedSequence(int(seed))
    entropy = np.asarray(root.entropy, dtype=object).tolist()
    job = Job(work, plain, entropy, tuple(int(k) for k in root.spawn_key))
    asked = {"entropy": entropy, "spawn_key": list(job.spawn_key)}
    listed = list(plain.values())
    return job, {"work": name, "seed": asked, "chunks": listed, "versions": versions()}


def _checked_work(work: Any) -> str:
    """The name of a function that a fresh interpreter can find."""
    module, name = getattr(work, "__module__", None), getattr(work, "__qualname__", None)
    found: Any = None
    with suppress(AttributeError):
        found = attrgetter(name)(import_module(module)) if module and name else None
    if found is None or found is not work:
        raise ValueError(
            f"work must be a function at the top level of a module, got {work!r}; move it there, "
            "and what it needs to know into the chunks."
        )
    return f"{module}:{name}"


def _checked_chunks(chunks: Iterable[Chunk]) -> dict[int, Chunk]:
    """The chunks as JSON has them, so that a resumed sweep works on the very same ones."""
    plain: dict[int, Chunk] = {}
    for number, chunk in enumerate(chunks):
        try:
            if not isinstance(chunk, dict):
                raise TypeError
            plain[number] = json.loads(json.dumps(chunk, allow_nan=False))
        except (TypeError, ValueError):
            raise ValueError(
                f"chunk {number} must be a dict of plain finite numbers, text, lists and dicts, "
                f"got {chunk!r}; write arrays as lists."
            ) from None
    if not plain:
        raise ValueError("there are no chunks; give one dict or more.")
    return plain


def encode(number: int, frame: pd.DataFrame) -> str:
    """The table of a chunk, numbers, booleans and text, as one line of strict JSON, every number to
    its last bit."""
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
    texts = column.astype(object).where(column.notna(), None).to_list()
    if not all(v is None or isinstance(v, str) for v in texts):
        raise ValueError(
            f"work must return numbers, booleans or text, got a column {name!r} of {column.dtype}."
        )
    return ["text", texts]


def decode(lines: dict[int, str]) -> pd.DataFrame:
    """The tables of all chunks in one, in the order of the chunks."""
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


def by_number(lines: list[str]) -> dict[int, str]:
    """Lines of chunks by their number, the first of each."""
    found: dict[int, str] = {}
    for line in lines:
        found.setdefault(int(json.loads(line)["chunk"]), line)
    return found
