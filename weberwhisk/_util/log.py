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
from typing import Any, Self

from . import output
from .checks import shown

__all__ = ["Log"]

FORMAT = 1


class Log:
    """A file of JSON lines that belongs to one question, as a context manager.

    Made if it is missing; where it holds an earlier part of the same, `lines` has that, without the
    first. `kind` is what it is a log of, one word; `question` what was asked, as JSON has it, the
    same whenever the file is gone on with. Files of another question or of none, that another
    process is writing, or that cannot be written, are refused.

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

    def __init__(self, path: str | os.PathLike[str], kind: str, question: dict[str, Any]) -> None:
        if not isinstance(path, str | os.PathLike):
            raise ValueError(f"path must name a file, got {shown(path)}; write 'rat1.jsonl', say.")
        self.path = Path(path)
        self.lines: list[str] = []
        self._kind = kind
        self._question = json.loads(json.dumps(question))
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
            self._file.seek(0)
            self._resume(self._file.read())
            self._open = opened.pop_all()
        return self

    def _resume(self, content: bytes) -> None:
        """Take the lines of an earlier run, or write the first line of a new file."""
        mark = f"weberwhisk_{self._kind}"
        if not content:
            python, made_with = platform.python_version(), output.versions("numpy", "scipy")
            about = {"python": python, "made_with": made_with, "started": output.now()}
            self.append(json.dumps({mark: FORMAT} | about | self._question))
            return
        lines = content.splitlines(keepends=True)
        # The last may be half a line, or zeros after a power cut.
        half = lines.pop() if len(lines) > 1 and _record(lines[-1]) is None else b""
        records = [_record(line) for line in lines]
        header = records[0]
        whole = None not in records and isinstance(header, dict) and header.get(mark) == FORMAT
        if not whole:
            place = records.index(None) + 1 if None in records else 1
            raise ValueError(
                f"{str(self.path)!r} is not the file of a {self._kind}, or was changed by hand "
                f"(line {place}); name another file."
            )
        for what, asked in self._question.items():
            was = header.get(what)
            if was != asked:
                words = f"its {what} is {was}, not {asked}"
                words = words if len(words) < 300 else f"its {what} are others"
                raise ValueError(
                    f"{str(self.path)!r} holds another {self._kind}: {words}; name another file, "
                    "or remove this one."
                )
        self._file.truncate(len(content) - len(half))
        self.lines = [line[:-1].decode("ascii") for line in lines[1:]]

    def __exit__(self, *error: object) -> None:
        with self._open:
            self.sync()

    def append(self, line: str) -> None:
        """Add a line, safe from this process being killed; where that fails, nothing is added."""
        text = f"{line}\n".encode("ascii")
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


def _record(line: bytes) -> Any:
    """What a whole line says, None where it cannot be read."""
    try:
        return json.loads(line.decode("ascii")) if line.endswith(b"\n") else None
    except ValueError:
        return None
