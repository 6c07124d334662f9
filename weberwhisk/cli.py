"""The command line: a thin shell over the public functions, whose commands are in `commands/`.

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
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Annotated, Any

import typer
from typer.core import TyperCommand

from ._util.refusals import Refusal
from .commands import choices, plans, quickstart, whiskers

__all__ = ["COMMANDS", "app", "main", "new_app", "run_app"]


class GroupedCommand(TyperCommand):
    """A command whose help lists its options by group (`rich_help_panel`), as plain text."""

    def format_options(self, ctx: Any, formatter: Any) -> None:
        groups: dict[str, list[tuple[str, str]]] = {}
        for parameter in self.get_params(ctx):
            record = parameter.get_help_record(ctx)
            if record is not None:
                kind = "Arguments" if parameter.param_type_name == "argument" else "Options"
                group = getattr(parameter, "rich_help_panel", None) or kind
                groups.setdefault(group, []).append(record)
        for group, records in groups.items():
            with formatter.section(group):
                formatter.write_dl(records)


def new_app(commands: Mapping[str, Callable[..., None]]) -> typer.Typer:
    """A command line with this module's conventions."""
    app = typer.Typer(rich_markup_mode=None, pretty_exceptions_enable=False)
    for name, function in commands.items():
        app.command(name, cls=GroupedCommand)(function)

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
    except Refusal as error:
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


COMMANDS = {
    "quickstart": quickstart.quickstart,
    "bend": whiskers.bend,
    "jnd": whiskers.jnd,
    "calibrate": whiskers.calibrate,
    "locate": whiskers.locate,
    "simulate": choices.simulate,
    "fit": choices.fit,
    "design": plans.design,
    "rehearse": plans.rehearse,
    "analyse": plans.analyse,
    "next": choices.next_trials,
}
app = new_app(COMMANDS)


def main() -> int:
    """Run the command line; returns the exit status."""
    return run_app(app, sys.argv[1:])


if __name__ == "__main__":
    sys.exit(main())
