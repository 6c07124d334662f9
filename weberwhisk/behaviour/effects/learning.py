"""Effects of the session: an animal that learns, smoothly or by blocks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ... import _checks
from ..percepts import Percept, Signals
from ..trials import Trials
from .effect import NORMAL, Plain

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Drift(Plain):
    """A learning animal, smoothly: ln k goes by `drift` from the first session to the last.

    Linear in the number of the session in its row, or with `of_log` in its logarithm (fast first,
    slow later). The Weber fraction is that in the middle of the course.

    Examples
    --------
    >>> from weberwhisk import simulate_trials
    >>> from weberwhisk.behaviour import IdentityPercept
    >>> trials = simulate_trials(sessions=3, trials_per_level=1, seed=1)
    >>> Drift().column(trials, IdentityPercept())
    array([-0.5, -0.5, -0.5,  0. ,  0. ,  0. ,  0.5,  0.5,  0.5])
    """

    prior: Any = NORMAL[0.5]
    name: str = "drift"
    of_log: bool = False

    def column(self, trials: Trials, percept: Percept) -> Array:
        sessions, place = sessions_of(trials, "Drift")
        course = np.log1p(np.arange(len(sessions))) if self.of_log else np.arange(len(sessions))
        return (course / course[-1] - 0.5)[place]

    def apply(self, felt: Signals, value: Array, column: Array | float) -> Signals:
        factor = np.exp(value * column)
        return felt._replace(sd_1=felt.sd_1 * factor, sd_2=felt.sd_2 * factor)


@dataclass(frozen=True, eq=False)
class Step(Plain):
    """A learning animal, by blocks: ln k changes by this much from session `at` on.

    Several steps make a piecewise course; the Weber fraction is that before the first.

    Examples
    --------
    >>> from weberwhisk import simulate_trials
    >>> from weberwhisk.behaviour import IdentityPercept
    >>> trials = simulate_trials(sessions=3, trials_per_level=1, seed=1)
    >>> Step(at=2).name, Step(at=2).column(trials, IdentityPercept())
    ('step[2]', array([0., 0., 0., 1., 1., 1., 1., 1., 1.]))
    """

    at: Any
    prior: Any = NORMAL[0.5]

    @property
    def name(self) -> str:
        return f"step[{self.at}]"

    def column(self, trials: Trials, percept: Percept) -> Array:
        sessions, place = sessions_of(trials, "Step")
        _checks.one_of("the session of a Step", str(self.at), map(str, sessions))
        return (place >= [str(s) for s in sessions].index(str(self.at))).astype(float)

    def apply(self, felt: Signals, value: Array, column: Array | float) -> Signals:
        factor = np.exp(value * column)
        return felt._replace(sd_1=felt.sd_1 * factor, sd_2=felt.sd_2 * factor)


def sessions_of(trials: Trials, what: str) -> tuple[list[Any], NDArray[np.intp]]:
    """Sessions in order, and the place of each row's."""
    if what and len(trials.sessions) < 2:
        raise ValueError(
            f"{trials.source}: {what} needs two sessions or more, got {len(trials.sessions)}; "
            "give the table a column 'session'."
        )
    levels, place = np.unique(trials.frame["session"].to_numpy(), return_inverse=True)
    return levels.tolist(), place
