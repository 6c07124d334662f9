"""What an experiment is to reach: a narrow interval of k, or evidence for the true hypothesis."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import pandas as pd

from .._util import checks
from .._util.refusals import Advice, Refusal, argument
from .._util.values import Array, Fields, counted
from .bounds import (
    fewest_animals,
    least_half_widths,
    trials_for_bayes_factor,
    trials_for_half_width,
)
from .hypotheses import Hypothesis, SubjectPopulation, check_distinct, refuse_given_k
from .scheme import Scheme, sized

__all__ = ["Contrast", "Evidence", "Goal", "Precision", "goal_for"]


class Goal(Fields, ABC):
    """What an experiment is to reach, and in what share of its repetitions.

    `Precision` is about the interval of the Weber fraction, `Contrast` about that of a ratio of
    two, `Evidence` about a Bayes factor.
    """

    share: float
    #: What has the interval `half_width`.
    quantity: ClassVar[str] = "k"
    #: The column of `Power.runs` that decides.
    column: ClassVar[str]
    #: What `plan_experiment` may ask for it, the default first.
    questions: ClassVar[tuple[str, ...]]

    @property
    @abstractmethod
    def threshold(self) -> float:
        """The value of the column at which an experiment reaches the goal."""

    @abstractmethod
    def check(self, hypotheses: Sequence[Hypothesis]) -> None:
        """Refuse hypotheses that cannot reach the goal."""

    @abstractmethod
    def truths(self, hypotheses: Sequence[Hypothesis]) -> Sequence[Hypothesis]:
        """The hypotheses that a scheme is judged under, each the truth in turn."""

    @abstractmethod
    def compared(self, hypotheses: Sequence[Hypothesis], truth: Hypothesis) -> Sequence[Hypothesis]:
        """The hypotheses that are fitted where one of them is the truth."""

    @abstractmethod
    def score(self, log_bayes_factor: Array, half_width: Array) -> Array:
        """How good the results of experiments are, greater for better; in nats or less ±k/k."""

    @abstractmethod
    def is_reached(self, runs: pd.DataFrame) -> pd.Series:
        """Which experiments of `Power.runs` reach the goal, or what share of their animals does."""

    def animal_columns(self, half_width: Any) -> dict[str, Array]:
        """Further columns of `Power.runs`, from the half-widths (..., A) of single animals."""
        return {}

    def power_columns(self, runs: pd.DataFrame) -> dict[str, float]:
        """Further columns of `Power.table`, from the experiments of one row."""
        return {}

    def verdict_of_factor(self, log_bayes_factor: float) -> str:
        """Whether the best hypothesis meets the goal, to follow its Bayes factor."""
        return ""

    def verdict_of_widths(self, half_width: pd.Series) -> list[str]:
        """How many intervals meet the goal, as sentences."""
        return []

    @abstractmethod
    def inference(self, over_animals: str) -> str:
        """What a preregistration says of the conclusion; how evidence combines over animals."""

    @abstractmethod
    def trials_needed(
        self, scheme: Scheme, hypotheses: Sequence[Hypothesis], expected: SubjectPopulation
    ) -> tuple[float, str]:
        """Trials of the comparison shown most that the goal takes at least, and of what."""

    @abstractmethod
    def refuse_impossible(
        self,
        scheme: Scheme,
        hypotheses: Sequence[Hypothesis],
        expected: SubjectPopulation,
        *,
        vary: str,
        most: int,
        together: bool,
    ) -> None:
        """Refuse a goal that the animals' spread or the information per trial puts out of reach.

        Either bound is optimistic: animals whose k is given exactly, and trials of an animal of
        which nothing but k is unknown.
        """

    def _refuse_too_many_trials(
        self,
        scheme: Scheme,
        hypotheses: Sequence[Hypothesis],
        expected: SubjectPopulation,
        most: int,
    ) -> None:
        needed, words = self.trials_needed(scheme, hypotheses, expected)
        if needed > most:
            raise Refusal(
                f"{self._out_of_reach('trials', most)}: {words}, which takes {needed:.0f} trials "
                "a comparison were nothing else unknown",
                remedy="set the standards farther apart, take more of them or of animals, or ask "
                "for less",
            )

    def _out_of_reach(self, vary: str, most: int) -> str:
        what = "trials a comparison" if vary == "trials" else "animals"
        return f"no design of up to {most} {what} reaches {self}"

    def _often(self) -> str:
        return f"in {100 * self.share:.3g} % of experiments"


class IntervalGoal(Goal):
    """A goal about the width of an interval of the first hypothesis."""

    column: ClassVar[str] = "half_width"

    def check(self, hypotheses: Sequence[Hypothesis]) -> None:
        """An interval of a Weber fraction that is given has no width, and no trials to wait for."""
        refuse_given_k(hypotheses, f"the goal is {self}")

    def truths(self, hypotheses: Sequence[Hypothesis]) -> Sequence[Hypothesis]:
        return hypotheses[:1]

    def compared(self, hypotheses: Sequence[Hypothesis], truth: Hypothesis) -> Sequence[Hypothesis]:
        return (truth,)

    def score(self, log_bayes_factor: Array, half_width: Array) -> Array:
        return -half_width


@dataclass(frozen=True, repr=False)
class Precision(IntervalGoal):
    """An interval of the Weber fraction that is narrow enough.

    Parameters
    ----------
    half_width : float
        Of the 95 % interval of k, over its estimate: 0.2 for ±20 %.
    share : float
        The share of experiments that are to reach it.

    Examples
    --------
    >>> print(Precision(half_width=0.2))
    a 95 % interval of k narrower than ±20 % in 80 % of experiments
    """

    questions: ClassVar[tuple[str, ...]] = ("precision",)
    half_width: float
    share: float = 0.8

    def __post_init__(self) -> None:
        checks.between("share", self.share, "write 0.8, say")
        checks.between("half_width", self.half_width, "write 0.2")

    def __str__(self) -> str:
        return f"a 95 % interval of k narrower than ±{100 * self.half_width:.3g} % {self._often()}"

    @property
    def threshold(self) -> float:
        return self.half_width

    def is_reached(self, runs: pd.DataFrame) -> pd.Series:
        return runs["reached"] if "reached" in runs else runs["half_width"] < self.half_width

    def animal_columns(self, half_width: Any) -> dict[str, Array]:
        return {"reached": (np.asarray(half_width) < self.half_width).mean(axis=-1)}

    def verdict_of_widths(self, half_width: pd.Series) -> list[str]:
        met = int((half_width < self.half_width).sum())
        return [
            f"The 95 % interval of k is within the planned ±{100 * self.half_width:g} % in {met} "
            f"of {counted(len(half_width), 'fit')}."
        ]

    def inference(self, over_animals: str) -> str:
        return (
            "The result is the interval of k; it is called precise if its half-width is below "
            f"{100 * self.half_width:g} % of the estimate."
        )

    def trials_needed(
        self, scheme: Scheme, hypotheses: Sequence[Hypothesis], expected: SubjectPopulation
    ) -> tuple[float, str]:
        needed = trials_for_half_width(
            scheme, hypotheses[0], expected, self.half_width, share=self.share
        )
        return needed, f"k to ±{100 * self.half_width:g} %"

    def refuse_impossible(
        self,
        scheme: Scheme,
        hypotheses: Sequence[Hypothesis],
        expected: SubjectPopulation,
        *,
        vary: str,
        most: int,
        together: bool,
    ) -> None:
        animals = sized(scheme, vary, most).animals
        if not together or animals == 1:
            if vary == "trials":
                self._refuse_too_many_trials(scheme, hypotheses, expected, most)
            return
        widths = least_half_widths(hypotheses[0], expected, animals)
        share = float((widths < self.half_width).mean())
        if share < self.share:
            fewest = fewest_animals(hypotheses[0], expected, self.half_width, share=self.share)
            reached = float(np.quantile(widths, self.share))
            more = "" if fewest is None else argument("animals", fewest) + " or more, or "
            raise Refusal(
                f"{self._out_of_reach(vary, most)}: were the k of each of "
                f"{counted(animals, 'animal')} known exactly, with ln k spread by "
                f"{expected.spread:g} between animals, the interval would be narrow enough in "
                f"{100 * share:.2g} % of experiments",
                remedy=Advice.joined(
                    "",
                    ["write ", more, argument("half_width", float(np.ceil(100 * reached) / 100))],
                ),
            )


@dataclass(frozen=True, repr=False)
class Evidence(Goal):
    """A Bayes factor for the true hypothesis against every other.

    Parameters
    ----------
    bayes_factor : float
    share : float
        The share of experiments that are to reach it.

    Examples
    --------
    >>> print(Evidence(bayes_factor=10))
    a Bayes factor above 10 for the true hypothesis in 80 % of experiments
    """

    column: ClassVar[str] = "log_bayes_factor"
    questions: ClassVar[tuple[str, ...]] = ("whiskers", "weber-law")
    bayes_factor: float
    share: float = 0.8

    def __post_init__(self) -> None:
        checks.between("share", self.share, "write 0.8, say")
        if not checks.number("bayes_factor", self.bayes_factor, "write 10, say") > 1:
            raise Refusal("bayes_factor must be above 1", f"{self.bayes_factor:g}", "write 10, say")

    def __str__(self) -> str:
        return f"a Bayes factor above {self.bayes_factor:g} for the true hypothesis {self._often()}"

    @property
    def threshold(self) -> float:
        return float(np.log(self.bayes_factor))

    def check(self, hypotheses: Sequence[Hypothesis]) -> None:
        if len(hypotheses) < 2:
            raise Refusal(
                "A Bayes factor compares two hypotheses",
                f"{hypotheses[0].name!r} alone",
                "give another, or ww.design.Precision(half_width=0.2)",
            )

    def truths(self, hypotheses: Sequence[Hypothesis]) -> Sequence[Hypothesis]:
        return hypotheses

    def compared(self, hypotheses: Sequence[Hypothesis], truth: Hypothesis) -> Sequence[Hypothesis]:
        return hypotheses

    def score(self, log_bayes_factor: Array, half_width: Array) -> Array:
        return log_bayes_factor

    def is_reached(self, runs: pd.DataFrame) -> pd.Series:
        return runs["log_bayes_factor"] > self.threshold

    def power_columns(self, runs: pd.DataFrame) -> dict[str, float]:
        return {"wrong": float((runs["log_bayes_factor"] < -self.threshold).mean())}

    def verdict_of_factor(self, log_bayes_factor: float) -> str:
        verdict = "meets" if log_bayes_factor > self.threshold else "does not meet"
        return f", which {verdict} the planned {self.bayes_factor:g}"

    def inference(self, over_animals: str) -> str:
        return (
            f"Hypotheses are compared by their exact evidence{over_animals}. One is accepted if it "
            f"is more than {self.bayes_factor:g} times as probable as every other (Bayes factor); "
            "otherwise the experiment is reported as undecided."
        )

    def trials_needed(
        self, scheme: Scheme, hypotheses: Sequence[Hypothesis], expected: SubjectPopulation
    ) -> tuple[float, str]:
        return trials_for_bayes_factor(scheme, hypotheses, expected, self.bayes_factor)

    def refuse_impossible(
        self,
        scheme: Scheme,
        hypotheses: Sequence[Hypothesis],
        expected: SubjectPopulation,
        *,
        vary: str,
        most: int,
        together: bool,
    ) -> None:
        if vary == "trials" and self.share >= 0.5:  # the bound is on the mean, so on the median
            self._refuse_too_many_trials(scheme, hypotheses, expected, most)


@dataclass(frozen=True, repr=False)
class Contrast(IntervalGoal):
    """Two conditions told apart: the interval of the ratio of their Weber fractions leaves out 1.

    Parameters
    ----------
    ratio : float
        Of k in the second condition to that in the first, where they differ.
    share : float
        The share of experiments that are to tell the conditions apart then.

    Examples
    --------
    >>> print(Contrast(ratio=1.3))
    a 95 % interval of the ratio of k that leaves out 1, where it is 1.3, in 80 % of experiments
    """

    questions: ClassVar[tuple[str, ...]] = ("conditions",)
    quantity: ClassVar[str] = "the ratio of k"
    ratio: float
    share: float = 0.8

    def __post_init__(self) -> None:
        checks.between("share", self.share, "write 0.8, say")
        checks.positive_number("ratio", self.ratio, "write 1.3, say")
        if self.ratio == 1:
            raise Refusal("a ratio of 1 is no difference", "1", "write 1.3, say")

    def __str__(self) -> str:
        return (
            f"a 95 % interval of the ratio of k that leaves out 1, where it is {self.ratio:g}, "
            f"{self._often()}"
        )

    @property
    def threshold(self) -> float:
        """The half-width of an interval that just leaves out 1."""
        return abs(1 - 1 / self.ratio)

    def is_reached(self, runs: pd.DataFrame) -> pd.Series:
        return runs["lower"] > 1 if self.ratio > 1 else runs["upper"] < 1

    def power_columns(self, runs: pd.DataFrame) -> dict[str, float]:
        opposite = runs["upper"] < 1 if self.ratio > 1 else runs["lower"] > 1
        return {"wrong": float(opposite.mean())}

    def verdict_of_ratio(self, lower: float, upper: float) -> str:
        """Whether an interval of the ratio tells the conditions apart."""
        if lower > 1 or upper < 1:
            return "its 95 % interval leaves out 1: the conditions are told apart"
        return "its 95 % interval holds 1: the conditions are not told apart"

    def inference(self, over_animals: str) -> str:
        return (
            "The result is the ratio of k in the second condition to that in the first, the same "
            "for all who answer, with δ, its natural logarithm, ~ norm(0, 1) beforehand. The "
            "conditions are called different if the equal-tailed 95 % interval of the ratio leaves "
            "out 1; otherwise the experiment is reported as undecided."
        )

    def trials_needed(
        self, scheme: Scheme, hypotheses: Sequence[Hypothesis], expected: SubjectPopulation
    ) -> tuple[float, str]:
        # An interval of either ln k that is √2 times as narrow, of all animals together.
        half_width = min(abs(np.log(self.ratio)) * np.sqrt(scheme.animals / 2), 0.99)
        needed = trials_for_half_width(scheme, hypotheses[0], expected, half_width, share=0.5)
        return needed, f"a ratio of {self.ratio:g}"

    def refuse_impossible(
        self,
        scheme: Scheme,
        hypotheses: Sequence[Hypothesis],
        expected: SubjectPopulation,
        *,
        vary: str,
        most: int,
        together: bool,
    ) -> None:
        if vary == "trials":
            self._refuse_too_many_trials(scheme, hypotheses, expected, most)


def goal_for(
    hypotheses: Sequence[Hypothesis], goal: Goal | None
) -> tuple[tuple[Hypothesis, ...], Goal]:
    """Hypotheses, and a goal that they can reach: by default a Bayes factor above 10, of one ±20 %.

    Raises
    ------
    ValueError
        For a goal that these hypotheses cannot reach.
    """
    given = check_distinct(hypotheses)
    if goal is None:
        goal = Evidence(10.0) if len(given) > 1 else Precision(0.2)
    checks.kind("goal", goal, "a Goal", "share", "write ww.design.Precision(half_width=0.2), say")
    goal.check(given)
    return given, goal
