"""What is written: files, a command's folder of them, all of it or nothing, and what to cite.

Every command hands its tables and figures to a `Run`, which adds ``<command>.run.json``: inputs,
versions, seed, times. The files are made in a folder of their own and moved into place when the
command has ended well. A command that fails, is interrupted or is terminated changes nothing.

What happens to a folder that is there already:

- The command's earlier files, those listed in its ``<command>.run.json``, are replaced, and
  removed if it does not make them this time: no stale figure stands beside a new table.
- Every other file stays as it is, and one that stands in the way is a refusal, not overwritten.
  Several commands may therefore share a folder, and one with data of your own in it.
- Several files cannot be renamed in one step. The finished set gets the name
  ``.weberwhisk-finished-…`` in one step, the old record is removed, the files are moved and the
  new record comes last, while interrupts and other runs wait. After a kill in between the next
  command that writes there completes the move first.

A process killed outright before that leaves a hidden ``.weberwhisk-unfinished-…`` folder, which
nothing reads and you may delete.
"""

from __future__ import annotations

import errno
import json
import os
import platform
import re
import secrets
import shutil
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from datetime import UTC, datetime, timedelta
from enum import Enum
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Self

import numpy as np

from . import __version__
from ._values import pd

__all__ = ["Run", "atomic_write", "csv_text", "locked", "to_json"]

FULL = errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO  # what a full or broken disk answers
#: What files and folders that are not finished begin with, and finished sets on their way.
UNFINISHED, FINISHED = ".weberwhisk-unfinished-", ".weberwhisk-finished-"
LOCK, RECORD = ".weberwhisk.lock", ".run.json"
NAME = re.compile(r"\w[\w.-]*")


def atomic_write(path: str | os.PathLike[str], content: str | bytes) -> None:
    """Write a file whole: a reader, a failure or a kill sees the old content or the new.

    A link is followed, the folder must exist, and text is written as UTF-8; a ValueError where
    `path` is not an ordinary file or cannot be written.
    """
    target = Path(os.path.realpath(path))
    if target.exists() and not target.is_file():
        raise ValueError(f"{str(target)!r} is not an ordinary file; name a file to write.")
    part = target.with_name(f"{UNFINISHED}{secrets.token_hex(4)}")
    try:
        part.write_bytes(content.encode("utf-8") if isinstance(content, str) else content)
        sync(part)
        os.replace(part, target)
    except OSError as error:
        raise unwritable(target, error) from error
    finally:
        with suppress(OSError):  # gone, or where nothing can be: the error above says so
            part.unlink()


def unwritable(path: Path, error: OSError) -> ValueError:
    """Why a file cannot be written."""
    return ValueError(
        f"{str(path)!r} cannot be written ({error.strerror}); name a file in a folder that exists "
        "and that you may write to."
    )


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
    with suppress(ValueError):
        float(cell)
        return cell
    return f"'{cell}"


@contextmanager
def locked(path: Path, seconds: float = -1.0) -> Iterator[None]:
    """Let no other process in; the system lifts the lock however this one ends.

    `filelock.Timeout` if it is held after so many seconds; a negative number waits for ever.
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

    See `plain`.
    """
    return json.dumps(plain(value), indent=2, ensure_ascii=False, allow_nan=False)


def plain(value: Any) -> Any:
    """A result as JSON can hold it: numbers, text, lists and dictionaries.

    NaN and infinities, which JSON lacks, become None; members of an enumeration become their names
    in lower case. A TypeError for anything that has no plain form.
    """
    if isinstance(value, Enum):
        return value.name.lower()
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    if value is None or isinstance(value, str | int | float):
        return None if value in (np.inf, -np.inf) or value != value else value
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    raise TypeError(f"{type(value).__name__} has no JSON form; turn it into numbers and text.")


def sync(path: Path) -> None:
    """Have the file on the disk before its name is."""
    with open(path, "r+b") as file:  # Windows flushes only what is open for writing
        os.fsync(file.fileno())


class Run:
    """One run of a command and the files it makes, as a context manager.

    `out_dir` is the folder for the files, made if it is missing; without one nothing is written.
    The `command` is the stem of its record, `inputs` and `seed` what was asked. Refused is what is
    no folder, cannot be written, or holds a file of another origin under a name that this run
    makes.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     with Run(Path(folder) / "out", "bend", {"identity": "C2"}) as run:
    ...         _ = run.path("bend.csv").write_text("moment")
    ...     sorted(path.name for path in run.out_dir.iterdir())
    ['bend.csv', 'bend.run.json']
    """

    def __init__(
        self,
        out_dir: str | os.PathLike[str] | None,
        command: str,
        inputs: Mapping[str, Any],
        seed: int | None = None,
    ) -> None:
        self.out_dir = None if out_dir is None else Path(os.path.realpath(out_dir))
        self.command, self.inputs, self.seed = command, dict(inputs), seed
        self.files: list[str] = []
        self._record = f"{command}{RECORD}"
        self._earlier: list[str] = []
        self._staging: Path | None = None

    def __enter__(self) -> Self:
        self._started = now()
        if self.out_dir is None:
            return self
        if self.out_dir.exists() and not self.out_dir.is_dir():
            raise ValueError(
                f"The output folder {str(self.out_dir)!r} is a file; name a folder, or a new one."
            )
        # In the folder itself, or in the nearest one above that exists: so a rename is enough to
        # move the files, and a failure leaves no empty folders.
        place = next(p for p in (self.out_dir, *self.out_dir.parents) if p.exists())
        staging = place / f"{UNFINISHED}{secrets.token_hex(4)}"
        try:
            self._look_again(self.out_dir)
            staging.mkdir()
        except OSError as error:
            raise ValueError(
                f"The output folder {str(self.out_dir)!r} cannot be written "
                f"({error.strerror}); name a folder that you may write to."
            ) from error
        self._staging = staging
        return self

    def __exit__(self, kind: object, error: BaseException | None, traceback: object) -> None:
        if self._staging is None or self.out_dir is None:
            return
        try:
            cause = error if isinstance(error, OSError) else getattr(error, "__cause__", None)
            if isinstance(cause, OSError) and cause.errno in FULL:  # `atomic_write` has words too
                raise cause
            if kind is None:
                self._finish(self._staging, self.out_dir)
        except OSError as wrong:
            if wrong.errno not in FULL:
                raise
            raise ValueError(
                f"The output folder {str(self.out_dir)!r} cannot be written ({wrong.strerror}); "
                "make room, or name a folder on another disk. Nothing there was changed."
            ) from wrong
        finally:
            shutil.rmtree(self._staging, ignore_errors=True)
            self._staging = None

    def table(self, name: str, table: pd.DataFrame) -> None:
        """Keep a DataFrame as ``<name>.csv``."""
        if self.out_dir is not None:
            self.path(f"{name}.csv").write_text(csv_text(table), "utf-8", newline="\n")

    def figure(self, name: str, drawn: Any) -> None:
        """Keep a Matplotlib figure, or that of axes, as ``<name>.png`` and ``<name>.svg``."""
        if self.out_dir is not None:
            drawn = np.ravel(np.asarray(drawn, dtype=object))[0]
            figure = getattr(drawn, "figure", drawn)
            figure.savefig(self.path(f"{name}.png"))
            figure.set_layout_engine("none")  # found: a fourth of the time, and once is enough
            # The record has the date: two figures differ only where they look different.
            figure.savefig(self.path(f"{name}.svg"), metadata={"Date": None})

    def path(self, name: str) -> Path:
        """Where to write another file of this run, which then moves into place with the rest.

        A ValueError for no plain name, one that is taken, or a run without a folder.
        """
        if self._staging is None or self.out_dir is None:
            raise ValueError(
                f"There is no folder for {name!r}; give the run an output folder and "
                "write inside its `with` block."
            )
        if not NAME.fullmatch(name) or RECORD in name:
            raise ValueError(
                f"{name!r} cannot name an output file; use letters, digits, '_', '-' and '.', "
                f"and leave *{RECORD} to the record."
            )
        if name in self.files:
            raise ValueError(f"The output file {name!r} is made twice; give each its own name.")
        if name not in self._earlier:
            self._look_again(self.out_dir)  # another run may have made it meanwhile
        self._spare_others(self.out_dir / name)
        self.files.append(name)
        return self._staging / name

    def _look_again(self, out_dir: Path) -> None:
        """Complete the moves that were cut short, and read what the folder's record lists."""
        if out_dir.exists():
            with locked(out_dir / LOCK):
                self._earlier = _made_earlier(out_dir, self._record)

    def _spare_others(self, target: Path) -> None:
        """Refuse to replace what an earlier run of this command did not make."""
        if target.is_dir() or (os.path.lexists(target) and target.name not in self._earlier):
            raise ValueError(
                f"{str(target)!r} would be overwritten, and `weberwhisk {self.command}` did not "
                "make it; move it, or name another output folder."
            )

    def _finish(self, staging: Path, out_dir: Path) -> None:
        if not out_dir.exists():
            self._seal(staging, out_dir)
            out_dir.parent.mkdir(parents=True, exist_ok=True)
            try:
                os.rename(staging, out_dir)
                return
            except OSError:  # unless another run made the folder meanwhile
                if not out_dir.is_dir():
                    raise
        with locked(out_dir / LOCK):
            self._earlier = _made_earlier(out_dir, self._record)
            for name in self.files:
                self._spare_others(out_dir / name)
            self._seal(staging, out_dir)
            finished = out_dir / f"{FINISHED}{secrets.token_hex(4)}"
            with _interrupts_wait():
                os.rename(staging, finished)
                _move_into_place(finished, out_dir)

    def _seal(self, staging: Path, out_dir: Path) -> None:
        """Add the record, and have all on the disk."""
        removed = [n for n in self._earlier if n not in self.files and (out_dir / n).is_file()]
        made_with = versions("numpy", "scipy", "emcee", "arviz", "pandas")
        record = {
            "command": self.command, "inputs": self.inputs, "seed": self.seed,
            "files": self.files, "removed": removed, "started": self._started, "finished": now(),
            "versions": {"python": platform.python_version(), **made_with},
            "platform": platform.platform(),
        }  # fmt: skip
        (staging / self._record).write_text(to_json(record), "utf-8")
        for path in staging.iterdir():
            sync(path)


def _move_into_place(finished: Path, out_dir: Path) -> None:
    """Move a finished set of files over an earlier one; safe to repeat after a stop anywhere."""
    for record in finished.glob(f"*{RECORD}"):  # one, or none if a stop came after its move
        (out_dir / record.name).unlink(missing_ok=True)
        for name in json.loads(record.read_text("utf-8"))["removed"]:
            (out_dir / name).unlink(missing_ok=True)
        for path in finished.iterdir():
            if path != record:
                os.replace(path, out_dir / path.name)
        os.replace(record, out_dir / record.name)
    finished.rmdir()


def _made_earlier(out_dir: Path, name: str) -> list[str]:
    """Complete the moves that were cut short; the files that a command's record then lists."""
    for left in sorted(out_dir.glob(f"{FINISHED}*")):
        _move_into_place(left, out_dir)
    record = out_dir / name
    if not record.exists():
        return []
    with suppress(ValueError, KeyError, TypeError):
        names = json.loads(record.read_text("utf-8"))["files"]
        # Names only: a record edited by hand must not reach outside its folder.
        if all(NAME.fullmatch(name) for name in names):
            return list(names)
    raise ValueError(
        f"{str(record)!r} is not a record that weberwhisk wrote; move it, or name another "
        "output folder."
    )


@contextmanager
def _interrupts_wait() -> Iterator[None]:
    """Hold Ctrl-C and termination back while a set of files is moved."""
    waiting: list[int] = []
    before = {}
    if threading.current_thread() is threading.main_thread():  # interrupts reach no other
        for number in (signal.SIGINT, signal.SIGTERM):
            before[number] = signal.signal(number, lambda number, _: waiting.append(number))
    try:
        yield
    finally:
        for known, handler in before.items():
            signal.signal(known, handler)
        for late in waiting:
            signal.raise_signal(late)


def now() -> str:
    """The time, for a record."""
    return datetime.now(UTC).isoformat(timespec="seconds")


@contextmanager
def shown(
    title: str, total: float, *, done: float = 0.0, every: float = 15.0
) -> Iterator[Callable[..., None]]:
    """Progress on standard error: a bar with the time left, or without a terminal a line each so
    many seconds. Yields a function that takes how much more of `total` has been done, 1 by default.
    """
    now, began = done, time.monotonic()
    told = began
    if sys.stderr.isatty():
        from rich.console import Console
        from rich.progress import Progress

        with Progress(console=Console(stderr=True), transient=True) as bar:
            # What was done before is no measure of how fast it goes now.
            task = bar.add_task(title, total=total, completed=int(done))
            yield lambda more=1.0: bar.advance(task, more)
        return

    def advance(more: float = 1.0) -> None:
        nonlocal now, told
        now += more
        if time.monotonic() - told < every or now <= done:
            return
        told = time.monotonic()
        left = timedelta(seconds=round((told - began) * (total - now) / (now - done)))
        share = f"{100 * now / total:.0f} % after {told - began:.0f} s"
        print(f"{title}: {share}, about {left} left", file=sys.stderr, flush=True)

    yield advance


_PAPER = (
    "Solomon JH, Hartmann MJZ (2011) Radial distance determination in the rat vibrissal system and "
    "the effects of Weber's law. Phil. Trans. R. Soc. B 366:3049–3057. doi:10.1098/rstb.2011.0166"
)
_BIBTEX = """@software{{weberwhisk,
  title = {{weberwhisk: Bayesian inference and psychophysics of touch through rat whiskers}},
  author = {{{{the weberwhisk developers}}}},
  version = {{{version}}},
}}
@article{{solomon2011radial,
  title = {{Radial distance determination in the rat vibrissal system and the effects of
           {{Weber}}'s law}},
  author = {{Solomon, Joseph H. and Hartmann, Mitra J. Z.}},
  journal = {{Philosophical Transactions of the Royal Society B}},
  volume = {{366}},
  number = {{1581}},
  pages = {{3049--3057}},
  year = {{2011}},
  doi = {{10.1098/rstb.2011.0166}},
}}
"""


def cite(*, bibtex: bool = False) -> str:
    """What to cite: this package in its version, and the paper whose theory it carries out.

    Examples
    --------
    >>> print(cite().splitlines()[0][:17])
    weberwhisk, versi
    >>> cite(bibtex=True).count("@")
    2
    """
    if bibtex:
        return _BIBTEX.format(version=__version__)
    return (
        f"weberwhisk, version {__version__}: Bayesian inference and psychophysics of touch through "
        f"rat whiskers.\n{_PAPER}\n"
    )


def versions_in_words(*packages: str) -> str:
    """This package's version, Python's, and those of the packages, for a methods section."""
    known = versions(*packages)
    found = [f"{name} {known[name]}" for name in packages if known[name]]
    return ", ".join([f"weberwhisk {__version__}", f"Python {platform.python_version()}", *found])


def versions(*packages: str) -> dict[str, str | None]:
    """Of this package and others, None for those that are not installed."""
    found: dict[str, str | None] = {"weberwhisk": __version__, **dict.fromkeys(packages)}
    for name in packages:
        with suppress(PackageNotFoundError):
            found[name] = version(name)
    return found
