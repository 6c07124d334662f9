"""The command line: a thin shell over the public functions, see `weberwhisk.commands`."""

from __future__ import annotations

import sys

from ._terminal import lazy_app, run_app

#: Each command's function, in the module of its name, and its line of help. A module is imported
#: when its command is used, so that `--version` and completion do not wait for SciPy.
COMMANDS = {
    "quickstart": (
        "quickstart",
        "The paper's figures 4a and 4b for a real whisker, and the Weber fraction of a real rat.",
    ),
    "bend": ("bend", "Bend a whisker against a point: the forces and moment at its base."),
    "jnd": (
        "jnd",
        "Just noticeable differences of radial distance, by formula, information, posterior.",
    ),
    "calibrate": ("calibrate", "Calibrate a whisker and its sensor by taps at known distances."),
    "locate": ("locate", "Say how far away each contact of a table or a tracked video is."),
    "simulate": ("simulate", "Simulate choices between two stimuli, with the truth beside them."),
    "fit": ("fit", "Fit the Weber fraction of one observer to a table of choices."),
    "design": (
        "design",
        "Plan an experiment: distances, trials, animals, trial lists, and what to expect of it.",
    ),
    "rehearse": (
        "rehearse",
        "Simulate a planned experiment, fit it as planned, and count how often it ends right.",
    ),
    "analyse": (
        "analyse",
        "The preregistered analysis of a plan, on PsychoPy's output or a table for Bpod.",
    ),
    "next": (
        "next_trials",
        "Place trials one by one: a line of JSON out, an answer in.",
    ),
    "paper": (
        "paper",
        "Every figure of Solomon & Hartmann (2011), and every claim with what we find.",
    ),
    "chart": (
        "chart",
        "Chart error against CPU time: beams, posteriors, JND curves and fits, and how each grows.",
    ),
    "figure": ("figure", "Charts of what every cue tells of distance; each with its table."),
}
app = lazy_app(f"{__package__}.commands", COMMANDS)


def main() -> int:
    """Run the command line; returns the exit status."""
    return run_app(app, sys.argv[1:])


if __name__ == "__main__":
    sys.exit(main())
