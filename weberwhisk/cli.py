"""The command line: a thin shell over the public functions, whose commands are in `commands/`.

- A wrong input ends with one sentence on standard error and status 2.
- Ctrl-C ends quietly with 130, termination with 143; both let the command clean up.
- A reader that goes away, as in ``| head``, ends the command quietly with 1.
- A sweep that cannot go on, for want of memory or a cluster, ends with one sentence and 1.
- An error that is no refusal is a bug: its traceback shows, with status 1.
"""

from __future__ import annotations

import os
import re
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

if TYPE_CHECKING:
    from ._util.values import Array

__all__ = [
    "COMMANDS", "PLAIN", "a_number", "a_seed", "app", "main", "new_app", "numbers", "progress",
    "raised_by_weberwhisk", "run_app",
]  # fmt: skip


#: Refusals are one sentence, not a box, and a traceback is the whole traceback.
PLAIN: Any = {"rich_markup_mode": None, "pretty_exceptions_enable": False}


class GroupedCommand(TyperCommand):
    """A command whose help lists its options by group (`rich_help_panel`), as plain text."""

    def format_options(self, ctx: Any, formatter: Any) -> None:
        groups: dict[str, list[tuple[str, str]]] = {}
        for parameter in self.get_params(ctx):
            record = parameter.get_help_record(ctx)
            if record is not None:
                own = "Arguments" if parameter.param_type_name == "argument" else "Options"
                group = getattr(parameter, "rich_help_panel", None) or own
                groups.setdefault(group, []).append(record)
        for group, records in groups.items():
            with formatter.section(group):
                formatter.write_dl(records)


def lazy_app(package: str, commands: Mapping[str, str]) -> typer.Typer:
    """A command line whose commands, ``"module:function"``, are imported when they are used.

    So that `--version` and completion do not wait for SciPy, a command's line of help, the first of
    its docstring, is read from the module's text.
    """
    folder = Path(__file__).parent / package.rpartition(".")[2]
    lines = {}
    for name, home in commands.items():
        module, _, function = home.partition(":")
        text = (folder / f"{module}.py").read_text("utf-8")
        found = re.search(rf'^def {function}\(.*?^    """(.*?)$', text, re.M | re.S)
        lines[name] = found[1] if found else ""

    class Lazy(TyperGroup):
        listing = False

        def __init__(self, **attributes: Any) -> None:
            super().__init__(**attributes)
            for name, line in lines.items():
                self.add_command(TyperCommand(name, callback=None, short_help=line))

        def get_command(self, ctx: Any, cmd_name: str) -> Any:
            if self.listing or cmd_name not in commands:
                return super().get_command(ctx, cmd_name)
            module, _, function = commands[cmd_name].partition(":")
            alone = typer.Typer(add_completion=False, **PLAIN)
            loaded = import_module(f"{package}.{module}")
            alone.command(cmd_name, cls=GroupedCommand)(getattr(loaded, function))
            return typer.main.get_command(alone)

        def format_commands(self, ctx: Any, formatter: Any) -> None:
            with formatter.section("Commands"):
                formatter.write_dl(list(lines.items()))

        def shell_complete(self, ctx: Any, incomplete: str) -> list[Any]:
            self.listing = True
            try:
                return super().shell_complete(ctx, incomplete)
            finally:
                self.listing = False

    return new_app(Lazy)


def new_app(group: type[TyperGroup] | None = None) -> typer.Typer:
    """An empty command line with this module's conventions."""
    app = typer.Typer(cls=group, add_completion=group is not None, **PLAIN)

    @app.callback(invoke_without_command=True)
    def weberwhisk(
        context: typer.Context,
        version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
    ) -> None:
        """Bayesian inference and psychophysics of touch through rat whiskers."""
        if version:
            from . import __version__

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
    except RuntimeError as error:
        from ._util.campaign import CampaignError

        if not isinstance(error, CampaignError) or getattr(error, "__notes__", None):
            raise  # a bug, or the work's own traceback
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
def progress(
    description: str, total: float, *, as_json: bool, every: float = 15.0
) -> Iterator[Callable[..., None]]:
    """Progress on standard error, as `output.shown` tells it; none where JSON is printed."""
    if as_json:
        yield lambda done=1.0: None
        return
    from ._util.output import shown

    with shown(description, total, every=every) as advance:
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


def numbers(option: str, values: Sequence[str]) -> Array:
    """The numbers of a list option, whether comma-separated or repeated.

    Examples
    --------
    >>> numbers("--deflection-angle-deg", ["5,10", "20"])
    array([ 5., 10., 20.])
    """
    import numpy as np

    found = []
    for text in (text.strip() for value in values for text in value.split(",")):
        try:
            found.append(float(text))
        except ValueError:
            raise ValueError(f"{option} takes numbers such as 10,20,30, got {text!r}.") from None
    return np.array(found)


#: Each command's function, by its module.
COMMANDS = {
    "quickstart": "quickstart:quickstart",
    "bend": "whiskers:bend",
    "jnd": "whiskers:jnd",
    "calibrate": "whiskers:calibrate",
    "locate": "whiskers:locate",
    "simulate": "choices:simulate",
    "fit": "fit:fit",
    "design": "experiments:design",
    "rehearse": "experiments:rehearse",
    "analyse": "experiments:analyse",
    "next": "choices:next_trials",
}
app = lazy_app(f"{__package__}.commands", COMMANDS)


def main() -> int:
    """Run the command line; returns the exit status."""
    return run_app(app, sys.argv[1:])


if __name__ == "__main__":
    sys.exit(main())
