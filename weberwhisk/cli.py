"""The command line: a thin shell over the public functions, see `weberwhisk.commands`."""

from __future__ import annotations

import sys

from ._terminal import new_app, run_app
from .commands import bend, chart, design, figure, fit, jnd, quickstart, rehearse, simulate
from .commands import next as next_

app = new_app()
COMMANDS = (
    quickstart.quickstart,
    bend.bend,
    jnd.jnd,
    simulate.simulate,
    fit.fit,
    design.design,
    rehearse.rehearse,
    chart.chart,
    figure.figure,
)
for command in COMMANDS:
    app.command()(command)
app.command("next")(next_.next_trials)


def main() -> int:
    """Run the command line; returns the exit status."""
    return run_app(app, sys.argv[1:])


if __name__ == "__main__":
    sys.exit(main())
