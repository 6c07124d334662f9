"""The folder that a command writes: all of it or nothing, with a record of how it was made.

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
  new record comes last. Interrupts wait until that is over, and so do other runs that end in the
  same folder: of two at once, the later one replaces the earlier whole. If the process is killed
  outright in between, the folder has no ``<command>.run.json``, and the next command that writes
  there completes the move first.

A process killed outright before that leaves a hidden ``.weberwhisk-unfinished-…`` folder in or
above the output folder; nothing reads it and it can be deleted.
"""

from __future__ import annotations

import json
import os
import platform
import re
import secrets
import shutil
import signal
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from .. import __version__
from .files import FULL, UNFINISHED, csv_text, locked, sync, to_json

if TYPE_CHECKING:
    import pandas as pd

_FINISHED = ".weberwhisk-finished-"
_RECORD = ".run.json"
_NAME = re.compile(r"\w[\w.-]*")
_RECORDED_PACKAGES = ("numpy", "scipy", "emcee", "arviz", "pandas")
LOCK = ".weberwhisk.lock"


class Run:
    """One run of a command and the files it makes, as a context manager.

    The files appear in `out_dir` when the block ends without an exception, all together.

    Parameters
    ----------
    out_dir : path or None
        Folder for the files, made if it is missing. None: nothing is written.
    command : str
        Name of the command, which is also the stem of its record.
    inputs : mapping
        What the command was asked to do; see `to_json` for what may be in it.
    seed : int, optional
        The seed that repeats the run.

    Attributes
    ----------
    files : list of str
        Names of the files made so far.

    Raises
    ------
    ValueError
        If `out_dir` is not a folder, cannot be written, or holds a file of another origin under
        a name that this run makes.

    Examples
    --------
    >>> import tempfile
    >>> import pandas as pd
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     with Run(Path(folder) / "out", "bend", {"identity": "C2"}) as run:
    ...         run.table("bend", pd.DataFrame({"moment": [1.0]}))
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
        self.command = command
        self.inputs = dict(inputs)
        self.seed = seed
        self.files: list[str] = []
        self._record = f"{command}{_RECORD}"
        self._earlier: list[str] = []
        self._staging: Path | None = None

    def __enter__(self) -> Self:
        self._started = _now()
        if self.out_dir is None:
            return self
        if self.out_dir.exists() and not self.out_dir.is_dir():
            raise ValueError(
                f"The output folder {str(self.out_dir)!r} is a file; name a folder, or a new one."
            )
        # In the folder itself, or in the nearest one above that exists: so a rename is enough to
        # move the files, and a failure leaves no empty folders.
        place = self.out_dir
        while not place.exists():
            place = place.parent
        staging = place / f"{UNFINISHED}{secrets.token_hex(4)}"
        try:
            self._look_again()
            staging.mkdir()
        except OSError as error:
            raise ValueError(
                f"The output folder {str(self.out_dir)!r} cannot be written "
                f"({error.strerror}); name a folder that you may write to."
            ) from error
        self._staging = staging
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        if self._staging is None:
            return
        try:
            cause = error if isinstance(error, OSError) else getattr(error, "__cause__", None)
            if isinstance(cause, OSError) and cause.errno in FULL:  # `atomic_write` has words too
                raise cause
            if kind is None:
                self._finish()
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
            self.path(f"{name}.csv").write_text(csv_text(table), encoding="utf-8", newline="\n")

    def figure(self, name: str, figure: Any) -> None:
        """Keep a Matplotlib figure as ``<name>.png`` and ``<name>.svg``."""
        if self.out_dir is not None:
            figure.savefig(self.path(f"{name}.png"))
            figure.set_layout_engine("none")  # found: a fourth of the time, and once is enough
            # The record has the date: two figures differ only where they look different.
            figure.savefig(self.path(f"{name}.svg"), metadata={"Date": None})

    def path(self, name: str) -> Path:
        """Where to write another file of this run, which then moves into place with the rest.

        Raises
        ------
        ValueError
            For a name with folders in it, one that this run or somebody else's file has taken, or
        a run without a folder.
        """
        if self._staging is None:
            raise ValueError(
                f"There is no folder for {name!r}; give the run an output folder and "
                "write inside its `with` block."
            )
        if not _NAME.fullmatch(name) or _RECORD in name:
            raise ValueError(
                f"{name!r} cannot name an output file; use letters, digits, '_', '-' and '.', "
                f"and leave *{_RECORD} to the record."
            )
        if name in self.files:
            raise ValueError(f"The output file {name!r} is made twice; give each its own name.")
        if name not in self._earlier:
            self._look_again()  # another run may have made it meanwhile
        self._spare_others(name)
        self.files.append(name)
        return self._staging / name

    def _look_again(self) -> None:
        """Complete the moves that were cut short, and read what the folder's record lists."""
        assert self.out_dir is not None
        if self.out_dir.exists():
            with locked(self.out_dir / LOCK):
                self._earlier = _made_earlier(self.out_dir, self._record)

    def _spare_others(self, name: str) -> None:
        """Refuse to replace what an earlier run of this command did not make."""
        assert self.out_dir is not None
        target = self.out_dir / name
        if target.is_dir() or (os.path.lexists(target) and name not in self._earlier):
            raise ValueError(
                f"{str(target)!r} would be overwritten, and `weberwhisk {self.command}` did not "
                "make it; move it, or name another output folder."
            )

    def _finish(self) -> None:
        assert self._staging is not None
        assert self.out_dir is not None
        if not self.out_dir.exists():
            self._seal()
            self.out_dir.parent.mkdir(parents=True, exist_ok=True)
            try:
                os.rename(self._staging, self.out_dir)
                return
            except OSError:  # unless another run made the folder meanwhile
                if not self.out_dir.is_dir():
                    raise
        with locked(self.out_dir / LOCK):
            self._earlier = _made_earlier(self.out_dir, self._record)
            for name in self.files:
                self._spare_others(name)
            self._seal()
            finished = self.out_dir / f"{_FINISHED}{secrets.token_hex(4)}"
            with _interrupts_wait():
                os.rename(self._staging, finished)
                _move_into_place(finished, self.out_dir)

    def _seal(self) -> None:
        """Add the record, and have all on the disk."""
        assert self._staging is not None
        assert self.out_dir is not None
        record = {
            "command": self.command,
            "inputs": self.inputs,
            "seed": self.seed,
            "files": self.files,
            "removed": [
                name
                for name in self._earlier
                if name not in self.files and (self.out_dir / name).is_file()
            ],
            "started": self._started,
            "finished": _now(),
            "versions": _versions(),
            "platform": platform.platform(),
        }
        (self._staging / self._record).write_text(to_json(record), "utf-8")
        for path in self._staging.iterdir():
            sync(path)


def _made_earlier(out_dir: Path, record: str) -> list[str]:
    """Complete the moves that were cut short; the files that a command's record then lists."""
    for left in sorted(out_dir.glob(f"{_FINISHED}*")):
        _move_into_place(left, out_dir)
    return _recorded_files(out_dir / record)


def _move_into_place(finished: Path, out_dir: Path) -> None:
    """Move a finished set of files over an earlier one; safe to repeat after a stop anywhere."""
    for record in finished.glob(f"*{_RECORD}"):  # one, or none if a stop came after its move
        (out_dir / record.name).unlink(missing_ok=True)
        for name in json.loads(record.read_text("utf-8"))["removed"]:
            (out_dir / name).unlink(missing_ok=True)
        for path in finished.iterdir():
            if path != record:
                os.replace(path, out_dir / path.name)
        os.replace(record, out_dir / record.name)
    finished.rmdir()


def _recorded_files(record: Path) -> list[str]:
    """The files that an earlier run's record lists; none where there was no run."""
    if not record.exists():
        return []
    try:
        names = json.loads(record.read_text("utf-8"))["files"]
        # Names only: a record edited by hand must not reach outside its folder.
        if all(_NAME.fullmatch(name) for name in names):
            return list(names)
    except (ValueError, KeyError, TypeError):
        pass
    raise ValueError(
        f"{str(record)!r} is not a record that weberwhisk wrote; move it, or name another "
        "output folder."
    )


@contextmanager
def _interrupts_wait() -> Iterator[None]:
    """Hold Ctrl-C and termination back while a set of files is moved."""
    if threading.current_thread() is not threading.main_thread():
        yield  # interrupts reach the main thread only
        return
    waiting: list[int] = []
    before = {
        number: signal.signal(number, lambda number, _: waiting.append(number))
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield
    finally:
        for known, handler in before.items():
            signal.signal(known, handler)
        for number in waiting:
            signal.raise_signal(number)


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")


def _versions() -> dict[str, str | None]:
    versions: dict[str, str | None] = {
        "python": platform.python_version(),
        "weberwhisk": __version__,
    }
    for name in _RECORDED_PACKAGES:
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            versions[name] = None
    return versions
