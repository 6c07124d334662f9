"""What an effect is, and what several of them ask of a table."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import stats

from ..encodings import Encoding, Signals, UnitEncodings
from ..trials import Trials

Array = NDArray[np.float64]


class Effect(Protocol):
    """A change of the observer with one parameter."""

    @property
    def name(self) -> str:
        """Name of the parameter."""

    @property
    def prior(self) -> Any:
        """Frozen SciPy distribution of the parameter, or a number where it is known."""

    @property
    def neutral(self) -> float:
        """The value at which there is no effect."""

    def bound(self, encodings: UnitEncodings, n: Array) -> Effect:
        """The effect with its scale taken from the stimuli of the table, `n` trials of each."""

    def column(self, trials: Trials, encoding: Encoding) -> Array | None:
        """What the effect goes with, a number a row; None where the stimuli are all of it.

        Zero stands for a trial like any other, where a curve is drawn or a threshold is told.
        """

    def apply(self, signals: Signals, value: Array, column: Array | float) -> Signals:
        """The signals with the effect, (..., C), for a parameter (..., 1)."""


class Plain:
    """An effect that needs neither a scale nor a column."""

    neutral: float = 0.0

    def bound(self, encodings: UnitEncodings, n: Array) -> Any:
        return self

    def column(self, trials: Trials, encoding: Encoding) -> Array | None:
        return None


# One object each: the table of its quantiles is made once (see `priors.quantiles`).
NORMAL = {sd: stats.norm(0.0, sd) for sd in (0.3, 0.4, 0.5, 1.0)}


def needs_order(trials: Trials, what: str) -> None:
    if trials.task.bias_name != "bias":
        raise ValueError(
            f"{what} needs to know which interval held which stimulus, got task "
            f"{trials.task.name!r}; it goes with '2AFC' and '2IFC'."
        )


def needs_rows(trials: Trials, what: str) -> None:
    if (trials.frame["n"] != 1).any():
        raise ValueError(
            f"{trials.source}: {what} needs a row a trial, got counts; give the trials in their "
            "order."
        )


def session_block(frame: pd.DataFrame) -> NDArray[np.intp]:
    """Which stretch of rows of one session each row lies in."""
    new = np.zeros(len(frame), dtype=bool)
    for label in ("subject", "session"):
        if label in frame:
            new |= (frame[label] != frame[label].shift(1)).to_numpy()
    return np.cumsum(new)
