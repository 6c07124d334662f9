"""What every command line of this package keeps to: refusals, interrupts, progress, numbers.

- A wrong input ends with one sentence on standard error and status 2.
- Ctrl-C ends quietly with 130, termination with 143; both let the command clean up.
- A reader that goes away, as in ``| head``, ends the command quietly with 1.
- A sweep that cannot go on, for want of memory or a cluster, ends with one sentence and 1.
- An error that is no refusal is a bug: its traceback shows, with status 1.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Annotated

import numpy as np
import typer
from numpy.typing import NDArray

from . import __version__
from .campaign import CampaignError


def new_app() -> typer.Typer:
    """An empty command line with this module's conventions."""
    app = typer.Typer(
        # Refusals are one sentence, not a box, and a traceback is the whole traceback.
        rich_markup_mode=None,
        pretty_exceptions_enable=False,
        add_completion=False,
    )

    @app.callback(invoke_without_command=True)
    def weberwhisk(
        context: typer.Context,
        version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
    ) -> None:
        """Bayesian inference and psychophysics of touch through rat whiskers."""
        if version:
            typer.echo(f"weberwhisk {__version__}")
            raise typer.Exit()
        if context.invoked_subcommand is None:
            typer.echo(context.get_help())

    return app


def run_app(app: typer.Typer, arguments: Sequence[str]) -> int:
    """Run one command of `app` under the conventions of this module; returns the exit status."""
    command = typer.main.get_command(app)
    try:
        with _termination_unwinds():
            status = command.main(
                args=list(arguments), prog_name="weberwhisk", standalone_mode=False
            )
            sys.stdout.flush()
    except typer.TyperException as error:
        message = error.format_message().rstrip(".")
        context = getattr(error, "ctx", None)
        if context is not None and "?" not in message and ";" not in message:
            message += f"; `{context.command_path} --help` says what it takes."
        return _refuse(message)
    except ValueError as error:
        if not raised_by_weberwhisk(error):
            raise
        return _refuse(str(error))
    except CampaignError as error:
        if getattr(error, "__notes__", None):  # the work's own traceback
            raise
        print("weberwhisk:", error, file=sys.stderr)
        return 1
    except BrokenPipeError:
        # The reader has gone. Nothing more can be said to it, also not when Python shuts down.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except OSError as error:
        if error.filename is None:
            raise
        return _refuse(f"{os.fspath(error.filename)!r}: {error.strerror}.")
    return status if isinstance(status, int) else 0


def _refuse(sentence: str) -> int:
    print("weberwhisk:", " ".join(sentence.split()), file=sys.stderr)
    return 2


def raised_by_weberwhisk(error: BaseException) -> bool:
    """Whether it is a refusal of ours; a ValueError from elsewhere is a bug and must look it."""
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    package = trace.tb_frame.f_globals.get("__package__") if trace is not None else None
    return (package or "").split(".")[0] == "weberwhisk"


@contextmanager
def _termination_unwinds() -> Iterator[None]:
    """Let a terminated command clean up, as an interrupted one does."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def leave(number: int, frame: object) -> None:
        raise SystemExit(128 + number)

    before = signal.signal(signal.SIGTERM, leave)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


@contextmanager
def progress(description: str, total: float, *, as_json: bool) -> Iterator[Callable[..., None]]:
    """A progress bar on standard error, where somebody is there to see it.

    Yields a function that takes how much more of `total` has been done, 1 by default.
    """
    from rich.console import Console
    from rich.progress import Progress

    quiet = as_json or not sys.stderr.isatty()
    with Progress(console=Console(stderr=True), transient=True, disable=quiet) as bar:
        task = bar.add_task(description, total=total)

        def advance(done: float = 1.0) -> None:
            bar.advance(task, done)

        yield advance


def a_number(text: str | float) -> float:
    """The value of an option that takes one number."""
    try:
        return float(text)
    except ValueError:
        raise typer.BadParameter(f"{text!r} is not a number; write one such as 3.5") from None


def a_seed(text: str | int) -> int:
    """The value of ``--seed``."""
    if not str(text).isdecimal():
        raise typer.BadParameter(f"{text!r} is not a seed; write a whole number such as 1")
    return int(text)


def numbers(option: str, values: Sequence[str]) -> NDArray[np.float64]:
    """The numbers of a list option, whether comma-separated or repeated.

    Examples
    --------
    >>> numbers("--deflection-angle-deg", ["5,10", "20"])
    array([ 5., 10., 20.])
    """
    texts = [text.strip() for value in values for text in value.split(",")]
    try:
        return np.array([float(text) for text in texts])
    except ValueError:
        wrong = next(text for text in texts if not _is_number(text))
        raise ValueError(f"{option} takes numbers such as 10,20,30, got {wrong!r}.") from None


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
