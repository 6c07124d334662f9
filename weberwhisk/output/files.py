"""Files written whole, locked, and as text that every system and spreadsheet reads alike."""

from __future__ import annotations

import errno
import json
import os
import secrets
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import pandas as pd

FULL = errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO  # what a full or broken disk answers
#: What files and folders that are not finished begin with.
UNFINISHED = ".weberwhisk-unfinished-"


def atomic_write(path: str | os.PathLike[str], content: str | bytes) -> None:
    """Write a file whole: a reader, a failure or a kill sees the old content or the new.

    Parameters
    ----------
    path : path
        The file; a link is followed. Its folder must exist.
    content : str or bytes
        Text is written as UTF-8.

    Raises
    ------
    ValueError
        If `path` is not an ordinary file or cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     atomic_write(f"{folder}/trials.csv", "s1,s2,choice\\n")
    ...     print(Path(folder, "trials.csv").read_text(), end="")
    s1,s2,choice
    """
    target = Path(os.path.realpath(path))
    if target.exists() and not target.is_file():
        raise ValueError(f"{str(target)!r} is not an ordinary file; name a file to write.")
    part = target.with_name(f"{UNFINISHED}{secrets.token_hex(4)}")
    try:
        try:
            part.write_bytes(content.encode("utf-8") if isinstance(content, str) else content)
            sync(part)
            os.replace(part, target)
        finally:
            part.unlink(missing_ok=True)
    except OSError as error:
        raise ValueError(
            f"{str(target)!r} cannot be written ({error.strerror}); "
            "name a file in a folder that exists and that you may write to."
        ) from error


def csv_text(table: pd.DataFrame) -> str:
    """A table as CSV, the same bytes on every platform; no cell of it runs in a spreadsheet.

    Text that begins with =, +, - or @ is a formula to Excel, LibreOffice and Google Sheets. Such a
    cell gets an apostrophe in front, which they show as text (OWASP, "CSV injection");
    `read_trials` takes it off again. Numbers are left as they are.

    Examples
    --------
    >>> import pandas as pd
    >>> print(csv_text(pd.DataFrame({"subject": ["=1+1", "s1"], "bias": [-0.5, 0.5]})), end="")
    subject,bias
    '=1+1,-0.5
    s1,0.5
    """
    safe = table.copy()
    for column in safe:
        if safe[column].dtype.kind not in "biufcM":
            safe[column] = safe[column].map(_as_text)
    return str(safe.to_csv(index=False, lineterminator="\n"))


def _as_text(cell: Any) -> Any:
    """A cell that a spreadsheet takes for what it says."""
    if not (isinstance(cell, str) and cell.lstrip().startswith(("=", "+", "-", "@"))):
        return cell
    try:
        float(cell)
    except ValueError:
        return f"'{cell}"
    return cell


@contextmanager
def locked(path: Path, seconds: float = -1.0) -> Iterator[None]:
    """Let no other process in; the system lifts the lock however this one ends.

    Raises
    ------
    filelock.Timeout
        If it is held after so many seconds; a negative number waits for ever.
    """
    if sys.platform == "emscripten":  # in a browser no other process can see its files
        yield
        return
    from filelock import FileLock

    with FileLock(path, timeout=seconds):
        try:
            yield
        finally:
            # While it is held: who comes now makes a file of their own, and who waits notices.
            with suppress(OSError):
                path.unlink()


def to_json(value: Any) -> str:
    """Strict JSON of results: arrays, NumPy scalars, paths and outcomes included.

    NaN and infinities, which JSON lacks, become null; members of an enumeration become their
    names in lower case.

    Raises
    ------
    TypeError
        For anything that has no plain form.

    Examples
    --------
    >>> print(to_json({"moment": np.array([1.5, np.nan]), "path": Path("a")}))
    {
      "moment": [
        1.5,
        null
      ],
      "path": "a"
    }
    """
    return json.dumps(_plain(value), indent=2, ensure_ascii=False, allow_nan=False)


def _plain(value: Any) -> Any:
    if isinstance(value, Enum):
        return value.name.lower()
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    if isinstance(value, float):
        return value if np.isfinite(value) else None
    if value is None or isinstance(value, str | int):
        return value
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    raise TypeError(f"{type(value).__name__} has no JSON form; turn it into numbers and text.")


def sync(path: Path) -> None:
    """Have the file on the disk before its name is."""
    with open(path, "r+b") as file:  # Windows flushes only what is open for writing
        os.fsync(file.fileno())
