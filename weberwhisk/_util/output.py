"""What is written: files, a command's folder of them, and what to cite.

Every command hands its tables and figures to a `Run`, which adds ``<command>.run.json``: inputs,
versions, seed, times. The files are made in a folder of their own and moved into place when the
command has ended well, so that a command that fails or is interrupted changes nothing. Its earlier
files, those that its record lists, are replaced, or removed if it does not make them this time;
every other file stays, and one that stands in the way is a refusal. Several commands may share a
folder, and one with data of your own in it.
"""

from __future__ import annotations

import errno
import json
import os
import platform
import re
import shutil
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from datetime import UTC, datetime, timedelta
from enum import Enum
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Self

import numpy as np

from .. import __version__
from . import checks
from .refusals import Refusal
from .values import pd

__all__ = ["Log", "Run", "atomic_write", "csv_text", "locked", "to_json"]

#: What files and folders that are not finished begin with.
UNFINISHED = ".weberwhisk-unfinished-"
LOCK, RECORD = ".weberwhisk.lock", ".run.json"
NAME = re.compile(r"\w[\w.-]*")


def atomic_write(path: str | os.PathLike[str], content: str | bytes) -> None:
    """Write a file whole: a reader, a failure or a kill sees the old content or the new.

    A link is followed, the folder must exist, and text is written as UTF-8; a ValueError where
    `path` is not an ordinary file or cannot be written.
    """
    target = Path(os.path.realpath(path))
    if target.exists() and not target.is_file():
        raise Refusal(f"{str(target)!r} is not an ordinary file", remedy="name a file to write")
    part = target.with_name(f"{UNFINISHED}{os.getpid()}-{threading.get_ident()}")
    try:
        part.write_bytes(content.encode("utf-8") if isinstance(content, str) else content)
        os.replace(part, target)
    except OSError as error:
        raise unwritable(target, error) from error
    finally:
        with suppress(OSError):  # gone, or where nothing can be: the error above says so
            part.unlink()


def unwritable(path: Path, error: OSError, what: str = "file") -> ValueError:
    """Why a file or a folder of output cannot be written."""
    place = "a file in a folder that exists and" if what == "file" else "a folder"
    return Refusal(
        f"{'The output folder ' * (what == 'folder')}{str(path)!r} cannot be written "
        f"({error.strerror})",
        remedy=f"name {place} that you may write to, on a disk with room",
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


def to_json(value: Any, *, escaped: bool = False) -> str:
    """Strict JSON of results: arrays, NumPy scalars, paths and outcomes included.

    See `plain`. `escaped` is in ASCII, which a file of any encoding can hold.
    """
    return json.dumps(plain(value), indent=2, ensure_ascii=escaped, allow_nan=False)


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
            raise Refusal(
                f"The output folder {str(self.out_dir)!r} is a file",
                remedy="name a folder, or a new one",
            )
        # In the folder itself, or in the nearest one above that exists: a rename moves the files.
        place = next(p for p in (self.out_dir, *self.out_dir.parents) if p.exists())
        self._earlier = _made_earlier(self.out_dir / self._record)
        try:
            self._staging = Path(tempfile.mkdtemp(prefix=UNFINISHED, dir=place))
        except OSError as error:
            raise unwritable(self.out_dir, error, "folder") from error
        return self

    def __exit__(self, kind: object, error: BaseException | None, traceback: object) -> None:
        if self._staging is None or self.out_dir is None:
            return
        try:
            if isinstance(error, OSError) and error.errno == errno.ENOSPC:
                raise error
            if kind is None:
                self._finish(self._staging, self.out_dir)
        except OSError as wrong:
            raise unwritable(self.out_dir, wrong, "folder") from wrong
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
            raise Refusal(
                f"There is no folder for {name!r}",
                remedy="give the run an output folder and write inside its `with` block",
            )
        if not NAME.fullmatch(name) or RECORD in name:
            raise Refusal(
                f"{name!r} cannot name an output file",
                remedy=(
                    f"use letters, digits, '_', '-' and '.', and leave *{RECORD} to the record"
                ),
            )
        if name in self.files:
            raise Refusal(
                f"The output file {name!r} is made twice", remedy="give each its own name"
            )
        if name not in self._earlier:  # another run may have made it meanwhile
            self._earlier = _made_earlier(self.out_dir / self._record)
        self._spare_others(self.out_dir / name)
        self.files.append(name)
        return self._staging / name

    def _spare_others(self, target: Path) -> None:
        """Refuse to replace what an earlier run of this command did not make."""
        if target.is_dir() or (os.path.lexists(target) and target.name not in self._earlier):
            raise Refusal(
                f"{str(target)!r} would be overwritten, and `weberwhisk {self.command}` did "
                "not make it",
                remedy="move it, or name another output folder",
            )

    def _finish(self, staging: Path, out_dir: Path) -> None:
        """Move the files into place, the record last."""
        inputs = plain(self.inputs)
        out_dir.mkdir(parents=True, exist_ok=True)
        with locked(out_dir / LOCK):
            self._earlier = _made_earlier(out_dir / self._record)
            for name in self.files:
                self._spare_others(out_dir / name)
            removed = [n for n in self._earlier if n not in self.files and (out_dir / n).is_file()]
            made_with = versions("numpy", "scipy", "emcee", "arviz", "pandas")
            record = {
                "command": self.command, "inputs": inputs, "seed": self.seed,
                "files": self.files, "removed": removed, "started": self._started,
                "finished": now(), "platform": platform.platform(),
                "versions": {"python": platform.python_version(), **made_with},
            }  # fmt: skip
            (staging / self._record).write_text(to_json(record), "utf-8")
            for name in removed:
                (out_dir / name).unlink()
            for name in (*self.files, self._record):
                os.replace(staging / name, out_dir / name)


def _made_earlier(record: Path) -> list[str]:
    """The files that a command's record lists."""
    if not record.exists():
        return []
    with suppress(ValueError, KeyError, TypeError):
        names = json.loads(record.read_text("utf-8"))["files"]
        # Names only: a record edited by hand must not reach outside its folder.
        if all(NAME.fullmatch(name) for name in names):
            return list(names)
    raise Refusal(
        f"{str(record)!r} is not a record that weberwhisk wrote",
        remedy="move it, or name another output folder",
    )


def now() -> str:
    """The time, for a record."""
    return datetime.now(UTC).isoformat(timespec="seconds")


class Log:
    """A file of JSON lines that belongs to one question, as a context manager.

    Made if it is missing; where it holds an earlier part of the same, `lines` has that, without the
    first. `kind` is what it is a log of, one word; `question` what was asked, as JSON has it, the
    same whenever the file is gone on with. Files of another question or of none, that another
    process is writing, or that cannot be written, are refused.
    """

    def __init__(self, path: str | os.PathLike[str], kind: str, question: dict[str, Any]) -> None:
        if not isinstance(path, str | os.PathLike):
            got = checks.shown(path)
            raise Refusal("path must name a file", got, "write 'rat1.jsonl', say")
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
                opened.enter_context(locked(lock, 0.0))
            except TimeoutError:
                raise Refusal(
                    f"{str(self.path)!r} is being written by another process",
                    remedy="wait for it, or name another file",
                ) from None
            except OSError as error:
                raise unwritable(self.path, error) from error
            self._file.seek(0)
            self._resume(self._file.read())
            self._open = opened.pop_all()
        return self

    def _resume(self, content: bytes) -> None:
        """Take the lines of an earlier run, or write the first line of a new file."""
        mark = f"weberwhisk_{self._kind}"
        if not content:
            python, made_with = platform.python_version(), versions("numpy", "scipy")
            about = {"python": python, "made_with": made_with, "started": now()}
            self.append(json.dumps({mark: 1} | about | self._question))
            return
        lines = content.splitlines(keepends=True)
        # The last may be half a line, or zeros after a power cut.
        half = lines.pop() if len(lines) > 1 and _record(lines[-1]) is None else b""
        records = [_record(line) for line in lines]
        header = records[0]
        whole = None not in records and isinstance(header, dict) and header.get(mark) == 1
        if not whole:
            place = records.index(None) + 1 if None in records else 1
            raise Refusal(
                f"{str(self.path)!r} is not the file of a {self._kind}, or was changed by hand "
                f"(line {place})",
                remedy="name another file",
            )
        for what, requested in self._question.items():
            was = header.get(what)
            if was != requested:
                words = f"its {what} is {was}, not {requested}"
                words = words if len(words) < 300 else f"its {what} are others"
                raise Refusal(
                    f"{str(self.path)!r} holds another {self._kind}: {words}",
                    remedy="name another file, or remove this one",
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
            raise unwritable(self.path, error) from error

    def sync(self) -> None:
        """Have it on the disk, safe from a power cut too."""
        os.fsync(self._file.fileno())


def _record(line: bytes) -> Any:
    """What a whole line says, None where it cannot be read."""
    try:
        return json.loads(line.decode("ascii")) if line.endswith(b"\n") else None
    except ValueError:
        return None


@contextmanager
def shown(
    title: str, total: float, *, done: float = 0.0, every: float = 15.0
) -> Iterator[Callable[..., None]]:
    """Progress on standard error: a bar with the time left, or without a terminal a line each so
    many seconds. Yields a function that takes how much more of `total` has been done, 1 by default.
    """
    now, began = done, time.monotonic()
    last_said = began
    if sys.stderr.isatty():
        from rich.console import Console
        from rich.progress import Progress

        with Progress(console=Console(stderr=True), transient=True) as bar:
            # What was done before is no measure of how fast it goes now.
            task = bar.add_task(title, total=total, completed=int(done))
            yield lambda more=1.0: bar.advance(task, more)
        return

    def advance(more: float = 1.0) -> None:
        nonlocal now, last_said
        now += more
        if time.monotonic() - last_said < every or now <= done:
            return
        last_said = time.monotonic()
        left = timedelta(seconds=round((last_said - began) * (total - now) / (now - done)))
        share = f"{100 * now / total:.0f} % after {last_said - began:.0f} s"
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
    installed = versions(*packages)
    out = [f"{name} {installed[name]}" for name in packages if installed[name]]
    return ", ".join([f"weberwhisk {__version__}", f"Python {platform.python_version()}", *out])


def versions(*packages: str) -> dict[str, str | None]:
    """Of this package and others, None for those that are not installed."""
    out: dict[str, str | None] = {"weberwhisk": __version__, **dict.fromkeys(packages)}
    for name in packages:
        with suppress(PackageNotFoundError):
            out[name] = version(name)
    return out
