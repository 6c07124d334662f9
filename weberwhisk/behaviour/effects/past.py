"""Effects of what came before, and of where the comparison stood."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ... import _checks
from ..percepts import Percept, Signals, UnitPercepts
from ..trials import Trials
from .effect import NORMAL, Plain, needs_order, needs_rows, stretch_of_session

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Contraction(Plain):
    """The first signal drawn towards the mean of all stimuli: m₁ → m₁ + contraction · (M − m₁).

    Contraction bias (Ashourian & Loewenstein 2011; Akrami et al. 2018): a remembered signal drifts
    towards what is usual. 0 is none, 1 an observer that compares with the mean alone. M is the mean
    signal of the whole table, as for an animal that has known its stimuli for long;
    `PastContraction` has that of the trials before.
    """

    prior: Any = NORMAL[0.3]
    name: str = "contraction"
    centre: float = 0.0

    def bound(self, percepts: UnitPercepts, n: Array) -> Contraction:
        total = float(n.sum())
        mean = (percepts.mean_1 + percepts.mean_2) @ n / (2 * total) if total else 0.0
        return replace(self, centre=float(mean))

    def column(self, trials: Trials, percept: Percept) -> Array | None:
        needs_order(trials, "Contraction")
        return None

    def apply(self, felt: Signals, value: Array, column: Array | float) -> Signals:
        usual = self.centre + column
        return felt._replace(mean_1=felt.mean_1 + value * (usual - felt.mean_1))


@dataclass(frozen=True, eq=False)
class PastContraction(Contraction):
    """The first signal drawn towards the mean of past ones: m₁ → m₁ + value · (M_t − m₁).

    M_t is the mean of both signals of all trials before this one in its session (Akrami et al.
    2018), answered or not. With a `half_life` in trials the past fades: a trial that many trials
    back counts half as much as the last. The first trial of a session has no past and is not
    drawn. M_t is rounded to a hundredth of the standard deviation of the signals, so that trials
    alike are counted together.

    Examples
    --------
    >>> from weberwhisk.behaviour import IdentityPercept, read_trials
    >>> import pandas as pd
    >>> table = pd.DataFrame({"stimulus_1": [1.0, 2.0, 4.0], "stimulus_2": [3.0, 2.0, 6.0],
    ...                       "choice": [1, 0, 1]})
    >>> PastContraction().column(read_trials(table), IdentityPercept()).round(1) + 3  # their mean
    array([1., 2., 2.])
    """

    name: str = "past_contraction"
    half_life: float | None = None

    def __post_init__(self) -> None:
        if self.half_life is not None:
            _checks.positive("half_life", self.half_life, "give trials, such as 20")

    def column(self, trials: Trials, percept: Percept) -> Array:
        needs_order(trials, "PastContraction")
        needs_rows(trials, "PastContraction")
        frame = trials.frame
        first, second = (
            percept.direction * percept.mean(frame[c].to_numpy(float))
            for c in ("stimulus_1", "stimulus_2")
        )
        middle = (first + second) / 2
        answered = middle[frame["count"].notna().to_numpy()]
        usual = answered.mean() if answered.size else 0.0
        ago = pd.Series(middle - usual).groupby(stretch_of_session(frame), sort=False)
        if self.half_life is None:
            past = ago.transform(lambda m: m.expanding().mean().shift(1))
        else:
            past = ago.transform(lambda m: m.ewm(halflife=self.half_life).mean().shift(1))
        step = 0.01 * middle.std() or 1.0
        return np.where(past.isna(), first - usual, np.round(past / step) * step)


@dataclass(frozen=True, eq=False)
class ComparisonBias(Plain):
    """A push towards the comparison, whichever interval it came in; sds of the difference.

    Where the standard takes turns between the intervals this is told apart from the order effect,
    which is the `bias`.
    """

    prior: Any = NORMAL[1.0]
    name: str = "comparison_bias"

    def column(self, trials: Trials, percept: Percept) -> Array:
        needs_order(trials, "ComparisonBias")
        s1, s2, standard = (
            trials.frame[c].to_numpy(float) for c in ("stimulus_1", "stimulus_2", "standard")
        )
        return np.sign(np.abs(s2 - standard) - np.abs(s1 - standard))

    def apply(self, felt: Signals, value: Array, column: Array | float) -> Signals:
        return felt._replace(push=felt.push + value * column)


@dataclass(frozen=True, eq=False)
class History(Plain):
    """A push towards the answer given on the trial before; sds of the difference.

    Positive repeats answers, negative alternates. The first trial of a session, and one after a
    missing answer, has none.
    """

    prior: Any = NORMAL[0.5]
    name: str = "history"

    def column(self, trials: Trials, percept: Percept) -> Array:
        needs_order(trials, "History")
        needs_rows(trials, "History")
        frame = trials.frame
        before = frame["count"].shift(1).to_numpy(float)
        answer = np.where(np.isnan(before), 0.0, 2 * np.nan_to_num(before) - 1)
        answer[np.diff(stretch_of_session(frame), prepend=-1) != 0] = 0.0
        return answer

    def apply(self, felt: Signals, value: Array, column: Array | float) -> Signals:
        return felt._replace(push=felt.push + value * column)
