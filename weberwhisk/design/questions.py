"""From a question to a plan, with defaults for whatever is not decided."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from .._util import checks
from .._util.refusals import Refusal, argument
from .._util.values import Array
from ..behaviour.encodings import CueEncoding, Encoding
from ..cues import Compliance
from ..cues.protocol import Cue
from ..inference.observer import Observer
from ..whisker import Whisker
from .goals import Evidence, Goal, Precision
from .hypotheses import Hypothesis, SubjectPopulation, noises, taper
from .plan import Plan
from .power_analysis import power, smallest
from .scheme import LEVELS, Constraints, Scheme, sized
from .scheme_search import best_scheme

__all__ = ["plan_experiment"]

QUESTIONS = ("whiskers", "weber-law", "precision")


def plan_experiment(
    whisker: Whisker | str = "C2",
    *,
    question: str | None = None,
    goal: Goal | None = None,
    hypotheses: Sequence[Hypothesis] | None = None,
    cue: Cue | None = None,
    deflection_angle: float | None = None,
    task: str | None = None,
    scheme: Scheme | None = None,
    standards: ArrayLike | None = None,
    levels: ArrayLike = LEVELS,
    best: bool = False,
    trials: int | None = None,
    animals: int = 1,
    find: str | None = None,
    expected: SubjectPopulation | None = None,
    constraints: Constraints | None = None,
    trials_per_session: int = 300,
    longest_run: int = 5,
    together: bool | None = None,
    title: str = "Discrimination of radial distance",
    runs: int = 512,
    seed: int = 1,
    workers: int = 1,
    scheduler: str | None = None,
    progress: Callable[[float], None] | None = None,
) -> Plan:
    """Plan an experiment on the discrimination of radial distance.

    Parameters
    ----------
    whisker : Whisker or str
        The whisker, or its identity.
    question : {"whiskers", "weber-law", "precision"}, optional
        What the experiment is to find: whether distance is sensed through the tapered whisker or a
        cylinder, whether noise grows with the signal (Weber's law) or is constant, or k to a
        precision. By default what the goal is about: "precision" for an interval, else "whiskers".
    goal : Goal, optional
        By default a Bayes factor above 10, or for a precision a 95 % interval of k within ±20 %, in
        80 % of experiments.
    hypotheses : sequence of Hypothesis, optional
        As they will be fitted, the expected one first, in place of a question.
    cue, deflection_angle : Cue and float, optional
        How distance is encoded, by default a light tap; the question "whiskers" has its own cue.
    task : str, optional
        Of hypotheses that are not given: "2AFC" by default, or "go/no-go", say, at a single pole.
    scheme : Scheme, optional
        Levels, trials and animals, where these are decided.
    standards : array_like, optional
        m; 0.3, 0.6 and 0.9 of the whisker's length by default.
    levels : array_like
        Comparisons of every standard, in sds of the expected animal's difference (see
        `Scheme.spaced`). By default ±0.75, 1.5 and 3.5: the widest inform of lapses.
    best : bool
        Choose standards and offsets by `best_scheme` instead. They are best for the expected
        animals: give the distances that real ones reach as `constraints`.
    trials : int, optional
        Of every comparison, for each animal; by default as few as reach the goal, an even number.
    animals : int
    find : {"trials", "animals", "nothing"}, optional
        What is made as small as the goal allows: by default the trials where they are not given,
        and nothing where they are. For "animals" the search starts at `animals`.
    expected : SubjectPopulation, optional
        What the animals are expected to be like.
    constraints : Constraints, optional
        What rig and animal allow; pole steps of 10 µm by default.
    trials_per_session, longest_run, title
        See `Plan`.
    together : bool, optional
        Fit all animals at once (see `analyse`); by default where there are several.
    runs : int
        Experiments simulated at every size for the power; 0 leaves it out where nothing is to be
        found.
    seed : int
        Of the trial lists and of these simulations.
    workers, scheduler, progress
        Of these simulations, as for `campaign.run`: the plan is the same to the bit.

    Raises
    ------
    ValueError
        For constraints that contradict each other or the scheme, distances off the whisker or past
        which it flicks, and a goal that no number of trials reaches: which one, and by how much.

    Examples
    --------
    >>> plan = plan_experiment("C2", trials=20, animals=2, runs=0)
    >>> plan.scheme.total_trials, plan.sessions
    (720, 2)
    >>> plan_experiment("C2", standards=[10e-3, 30e-3], runs=32).goal.bayes_factor
    10.0
    """
    shape = Whisker.from_identity(whisker) if isinstance(whisker, str) else whisker
    if question is not None:
        checks.one_of("question", question, QUESTIONS)
    usual = Precision(0.2) if question == "precision" else Evidence(10.0)
    aim, likely = goal or usual, expected or SubjectPopulation()
    limits = constraints or Constraints(step=10e-6)
    for name, value, kind in (
        ("goal", aim, Goal), ("expected", likely, SubjectPopulation),
        ("constraints", limits, Constraints),
    ):  # fmt: skip
        if not isinstance(value, kind):
            raise Refusal(
                f"{name} must be {kind.__name__}", checks.shown(value), "leave it out, say"
            )
    if scheme is not None and (trials, standards) != (None, None):
        raise Refusal(
            "A scheme has its standards and trials", remedy="leave standards and trials out"
        )
    if scheme is not None and animals not in (1, scheme.animals):
        raise Refusal(
            "A scheme has its animals",
            f"{scheme.animals} and " + argument("animals", animals),
            f"write scheme.with_animals({animals})",
        )
    topic = question or aim.questions[0]
    if topic not in aim.questions:
        raise Refusal(
            f"The question {topic!r} is not answered by {aim}",
            remedy=(
                "write ww.design.Precision(half_width=0.2) for a precision, "
                "ww.design.Evidence(bayes_factor=10) for the others"
            ),
        )
    if hypotheses is None:
        given = _hypotheses(shape, topic, cue, deflection_angle, task, standards)
    elif (question, cue, deflection_angle, task) == (None, None, None, None):
        given = hypotheses
    else:
        raise Refusal(
            "Hypotheses have their question, cues and task",
            "hypotheses and one of these",
            "leave one out",
        )
    to_vary = _what_to_find(find, trials is not None or scheme is not None)
    settings: dict[str, Any] = {"goal": aim, "constraints": limits, "seed": seed}
    if best:
        if scheme is not None or standards is not None:
            raise Refusal(
                argument("best", True) + " chooses the standards",
                remedy="leave scheme and standards out",
            )
        scheme = best_scheme(given, **settings, expected=likely, animals=animals)
        scheme = scheme if trials is None else scheme.with_trials(trials)
    if scheme is None:
        encoding = given[0].encoding
        at = _spread_out(encoding) if standards is None else standards
        scheme = Scheme.spaced(
            encoding, at, weber_fraction=likely.weber_fraction, levels=levels,
            trials=20 if trials is None else trials, animals=animals, step=limits.step,
        )  # fmt: skip
    settings |= {
        "hypotheses": given, "animals": likely, "trials_per_session": trials_per_session,
        "longest_run": longest_run, "title": title,
    }  # fmt: skip
    # Refuses what cannot be shown before anything is computed.
    Plan(scheme, **settings, together=bool(together))
    options: dict[str, Any] = {
        "goal": aim, "expected": likely, "runs": runs, "workers": workers, "scheduler": scheduler,
        "progress": progress, "together": together is not False, "seed": seed,
    }  # fmt: skip
    table: pd.DataFrame | None = None
    if to_vary != "nothing":
        scheme, simulated = smallest(scheme, given, vary=to_vary, **options)
        most, table = max(map(max, scheme.trials)), simulated.table
        if to_vary == "trials":  # even numbers let every pair come in both orders equally often
            scheme = sized(scheme, to_vary, most + most % 2)
    elif runs:
        most = max(map(max, scheme.trials))
        sizes = sorted({max(most // 2, 1), most, 2 * most})
        table = power(scheme, given, trials=sizes, **options).table
    if together is None:
        k_is_fixed = any(h.priors.is_fixed("weber_fraction") for h in given)
        together = scheme.animals > 1 and not k_is_fixed
    return Plan(scheme, **settings, together=together, power=table)


def _spread_out(encoding: Encoding) -> Array:
    """Standards over the range that can be encoded."""
    return np.array([0.3, 0.6, 0.9]) * encoding.domain[1]


def _what_to_find(find: str | None, decided: bool) -> str:
    """What is made small, where the trials are decided or not."""
    if find is None:
        return "nothing" if decided else "trials"
    checks.one_of("find", find, ("trials", "animals", "nothing"))
    if find == "animals" and not decided:
        raise Refusal(
            "The number of animals is found for so many trials each",
            "none",
            "write " + argument("trials", 20) + ", say",
        )
    if find == "nothing" and not decided:
        raise Refusal(
            "Trials are given or found",
            "neither",
            "write " + argument("trials", 20) + ", or leave find",
        )
    return find


def _hypotheses(
    whisker: Whisker,
    question: str,
    cue: Cue | None,
    deflection_angle: float | None,
    task: str | None,
    standards: ArrayLike | None,
) -> Sequence[Hypothesis]:
    task = task or "2AFC"
    if question == "whiskers":
        if cue is not None and not (isinstance(cue, Compliance) and cue.tap_angle == 0):
            raise Refusal(
                "Taper is tested by the compliance cue at the lightest tap",
                f"{cue!r}",
                "leave cue out, or give the hypotheses",
            )
        if deflection_angle is not None:
            raise Refusal(
                "Taper is tested by the compliance cue, which has no deflection angle",
                f"{deflection_angle!r}",
                "leave it out",
            )
        return taper(whisker, task=task)
    encoding = CueEncoding(Observer(whisker, cue or Compliance()), deflection_angle)
    if question == "weber-law":
        at = _spread_out(encoding) if standards is None else standards
        return noises(encoding, at, task=task)
    return [Hypothesis("expected observer", encoding, task=task)]
