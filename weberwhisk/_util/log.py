"""Files that only grow: what was asked on the first line, then a line for every thing done.

JSON lines, appended to and never rewritten. A process killed while it writes leaves half a line at
the end, which is cut off when the next one goes on; whatever was written before is kept.
"""

from __future__ import annotations

import json
import os
import platform
from contextlib import ExitStack
from pathlib import Path
from typing import Any, BinaryIO, Self

from . import output
from .checks import shown

__all__ = ["Log", "read_lines"]

FORMAT = 1


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
        about: dict[str, Any] = {"python": platform.python_version()}
        about["made_with"] = output.versions("numpy", "scipy")
        about |= {"started": output.now()} | self._about
        self.append(json.dumps({_mark(self._kind): FORMAT, **about, **self._question}))

    def _same(self, header: dict[str, Any]) -> None:
        for what, asked in self._question.items():
            was = header.get(what)
            if was == asked:
                continue
            words = f"its {what} is {was}, not {asked}"
            words = words if len(words) < 300 else f"its {what} are others"
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
