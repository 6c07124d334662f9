"""The command line: a thin shell over the public functions, see `weberwhisk.commands`."""

from __future__ import annotations

import sys

from ._terminal import lazy_app, run_app

#: Each command's function, by its module.
COMMANDS = {
    "quickstart": "quickstart:quickstart",
    "bend": "whiskers:bend",
    "jnd": "whiskers:jnd",
    "calibrate": "contacts:calibrate",
    "locate": "contacts:locate",
    "simulate": "choices:simulate",
    "fit": "fit:fit",
    "design": "experiments:design",
    "rehearse": "experiments:rehearse",
    "analyse": "experiments:analyse",
    "next": "next:next_trials",
    "paper": "paper:paper",
    "chart": "paper:chart",
    "figure": "figure:figure",
}
app = lazy_app(f"{__package__}.commands", COMMANDS)


def main() -> int:
    """Run the command line; returns the exit status."""
    return run_app(app, sys.argv[1:])


if __name__ == "__main__":
    sys.exit(main())
