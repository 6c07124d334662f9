"""From a question to a plan, with defaults for whatever is not decided."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from .._util import checks
from .._util.refusals import Refusal, argument
from .._util.values import Array
from ..behaviour.encodings import CueEncoding, Encoding, refuse_out_of_reach
from ..behaviour.psychometric import difference_sd
from ..cues import Compliance
from ..cues.protocol import Cue
from ..inference.observer import Observer
from ..whisker import Whisker
from .goals import Contrast, Evidence, Goal, Precision
from .hypotheses import Hypothesis, SubjectPopulation, check_distinct, noises, taper
from .magnitude import DISTANCE, Magnitude, magnitude_named, magnitude_of
from .plan import Plan
from .power_analysis import power, smallest
from .rivals import rivals
from .scheme import LEVELS, Constraints, Scheme
from .scheme_search import best_scheme

__all__ = ["plan_experiment"]

QUESTIONS = ("whiskers", "weber-law", "precision", "conditions")


def plan_experiment(
    whisker: Whisker | str = "C2",
    *,
    magnitude: Magnitude | str | None = None,
    question: str | None = None,
    rival: str | None = None,
    conditions: Sequence[str] = (),
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
    people: int | None = None,
    find: str | None = None,
    expected: SubjectPopulation | None = None,
    constraints: Constraints | None = None,
    trials_per_session: int = 300,
    longest_run: int = 5,
    together: bool | None = None,
    title: str = "",
    runs: int = 512,
    seed: int = 1,
    workers: int = 1,
    scheduler: str | None = None,
    progress: Callable[[float], None] | None = None,
) -> Plan:
    """Plan an experiment on the discrimination of radial distance, or of any magnitude.

    Parameters
    ----------
    whisker : Whisker or str
        The whisker, or its identity.
    magnitude : Magnitude or str, optional
        What is compared, where it is no distance along a whisker: "duration", say. Standards are
        in its unit then, and there is no whisker.
    question : {"whiskers", "weber-law", "precision", "conditions"}, optional
        What the experiment is to find: whether distance is sensed through the tapered whisker or a
        cylinder, whether noise grows with the signal (Weber's law) or is constant, or k to a
        precision. By default what the goal is about: "precision" for an interval, else "whiskers",
        or of another magnitude "weber-law".
    rival : str, optional
        Of Weber's law: "constant" noise by default, "exponent:0.5" or "floor:20" (see `rivals`).
    conditions : sequence of str
        Two conditions, such as ["saline", "drug"], in which k is compared; they alternate by
        session.
    goal : Goal, optional
        By default a Bayes factor above 10, for a precision a 95 % interval of k within ±20 %, for
        two conditions an interval of the ratio of their k that leaves out 1 where it is 1.3; in
        80 % of experiments.
    hypotheses : sequence of Hypothesis, optional
        As they will be fitted, the expected one first, in place of a question.
    cue, deflection_angle : Cue and float, optional
        How distance is encoded, by default a light tap; the question "whiskers" has its own cue.
    task : str, optional
        Of hypotheses that are not given: "2AFC" by default, "2IFC" of another magnitude, or
        "go/no-go", say, at a single pole.
    scheme : Scheme, optional
        Levels, trials and animals, where these are decided.
    standards : array_like, optional
        m; 0.3, 0.6 and 0.9 of the whisker's length by default. Of another magnitude, in its unit.
    levels : array_like
        Comparisons of every standard, in sds of the expected animal's difference (see
        `Scheme.spaced`). By default ±0.75, 1.5 and 3.5: the widest inform of lapses.
    best : bool
        Choose standards and offsets by `best_scheme` instead. They are best for the expected
        animals: give the distances that real ones reach as `constraints`.
    trials : int, optional
        Of every comparison, for each animal; by default as few as reach the goal, an even number.
    animals : int
    people : int, optional
        In place of `animals`.
    find : {"trials", "animals", "nothing"}, optional
        What is made as small as the goal allows: by default the trials where they are not given,
        and nothing where they are. For "animals" the search starts at `animals`.
    expected : SubjectPopulation, optional
        What the animals are expected to be like.
    constraints : Constraints, optional
        What rig and animal allow; pole steps of 10 µm by default, or what the magnitude allows.
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
    of = _magnitude(magnitude, hypotheses, scheme)
    shape = Whisker.from_identity(whisker) if isinstance(whisker, str) else whisker
    if question is not None:
        checks.one_of("question", question, QUESTIONS)
    if conditions and question is None:
        question = "conditions"
    usual: Goal = {"precision": Precision(0.2), "conditions": Contrast(1.3)}.get(
        question or "", Evidence(10.0)
    )
    called = "animal" if of.is_distance or animals != 1 else "subject"
    aim, likely = goal or usual, expected or SubjectPopulation(subject=called)
    if people is not None:
        if animals != 1:
            raise Refusal("Those who answer are animals or people", "both", "leave one out")
        animals = people
        likely = replace(likely, subject="person") if expected is None else likely
    limits = constraints or Constraints(
        of.least / of.per_unit, of.greatest / of.per_unit, of.step / of.per_unit
    )
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
    topic = question or next(q for q in aim.questions if of.is_distance or q != "whiskers")
    if topic == "whiskers" and not of.is_distance:
        raise Refusal(
            f"The question 'whiskers' is about radial distances, and this is about {of.plural}",
            remedy="write " + argument("question", "weber-law") + " or "
            + argument("question", "precision"),
        )  # fmt: skip
    if topic not in aim.questions:
        raise Refusal(
            f"The question {topic!r} is not answered by {aim}",
            remedy=(
                "write ww.design.Precision(half_width=0.2) for a precision, "
                "ww.design.Contrast(ratio=1.3) for two conditions, "
                "ww.design.Evidence(bayes_factor=10) for the others"
            ),
        )
    if rival is not None and (topic != "weber-law" or hypotheses is not None):
        raise Refusal(
            "A rival is of Weber's law", repr(rival), "write " + argument("question", "weber-law")
        )
    k = likely.weber_fraction
    if hypotheses is None and not of.is_distance:
        at = standards if scheme is None else scheme.standards
        given = _of_magnitude(of, topic, (cue, deflection_angle), task, at, best, rival, k)
    elif hypotheses is None:
        given = _hypotheses(shape, topic, cue, deflection_angle, task, standards, rival, k)
    elif (question, cue, deflection_angle, task) == (None, None, None, None):
        given = hypotheses
    else:
        raise Refusal(
            "Hypotheses have their question, cues and task",
            "hypotheses and one of these",
            "leave one out",
        )
    to_vary = _what_to_find(find, trials is not None or scheme is not None)
    if constraints is None and not of.step and scheme is None and standards is not None:
        step = _round_step(given[0].encoding, standards, likely.weber_fraction)
        limits = replace(limits, step=step)
    settings: dict[str, Any] = {"goal": aim, "constraints": limits, "seed": seed}
    if best:
        if scheme is not None or standards is not None:
            raise Refusal(
                argument("best", True) + " chooses the standards",
                remedy="leave scheme and standards out",
            )
        scheme = best_scheme(given, **settings, expected=likely, animals=animals, magnitude=of)
        scheme = scheme if trials is None else scheme.with_trials(trials)
    if scheme is None:
        encoding = given[0].encoding
        at = _spread_out(encoding) if standards is None else standards
        scheme = Scheme.spaced(
            encoding, at, weber_fraction=likely.weber_fraction, levels=levels,
            trials=20 if trials is None else trials, animals=animals, step=limits.step,
            magnitude=of,
        )  # fmt: skip
    if conditions:
        scheme = replace(scheme, conditions=tuple(conditions))
    settings |= {
        "hypotheses": given, "animals": likely, "trials_per_session": trials_per_session,
        "longest_run": longest_run, "title": title,
    }  # fmt: skip
    # Refuses what cannot be shown before anything is computed.
    Plan(scheme, **settings, together=bool(together))  # conditions are never fitted together
    options: dict[str, Any] = {
        "goal": aim, "expected": likely, "runs": runs, "workers": workers, "scheduler": scheduler,
        "progress": progress, "together": together is not False, "seed": seed,
    }  # fmt: skip
    table: pd.DataFrame | None = None
    if to_vary != "nothing":
        even = to_vary == "trials"
        scheme, simulated = smallest(scheme, given, vary=to_vary, even=even, **options)
        table = simulated.table
    elif runs:
        most = max(map(max, scheme.trials))
        sizes = sorted({max(most // 2, 1), most, 2 * most})
        table = power(scheme, given, trials=sizes, **options).table
    if together is None:
        k_is_fixed = any(h.priors.is_fixed("weber_fraction") for h in given)
        together = scheme.animals > 1 and not (k_is_fixed or scheme.conditions)
    return Plan(scheme, **settings, together=together, power=table)


def _round_step(encoding: Encoding, standards: ArrayLike, weber_fraction: float) -> float:
    """A power of ten of some per cent of the smallest sd: numbers that can be set and read."""
    at = np.atleast_1d(checks.finite("standards", standards, "give one, or several"))
    refuse_out_of_reach(encoding, at, "standard")
    smallest = weber_fraction * float(np.min(difference_sd(encoding, at)))
    return float(f"1e{math.floor(math.log10(0.03 * smallest))}")


def _spread_out(encoding: Encoding) -> Array:
    """Standards over the range that can be encoded."""
    return np.array([0.3, 0.6, 0.9]) * encoding.domain[1]


def _magnitude(
    magnitude: Magnitude | str | None,
    hypotheses: Sequence[Hypothesis] | None,
    scheme: Scheme | None,
) -> Magnitude:
    """What is compared: as said, or of the scheme, or what the hypotheses are of."""
    if isinstance(magnitude, str):
        magnitude = magnitude_named(magnitude)
    if magnitude is not None:
        checks.kind("magnitude", magnitude, "a Magnitude", "per_unit", 'write "duration", say')
        return magnitude
    if scheme is not None:
        return scheme.magnitude
    return DISTANCE if hypotheses is None else magnitude_of(check_distinct(hypotheses)[0].encoding)


def _of_magnitude(
    of: Magnitude,
    question: str,
    whisker_options: tuple[Any, ...],
    task: str | None,
    at: ArrayLike | None,
    best: bool,
    rival: str | None,
    weber_fraction: float,
) -> Sequence[Hypothesis]:
    """Hypotheses on a magnitude that is its own signal."""
    if any(option is not None for option in whisker_options):
        raise Refusal(
            f"cue and deflection_angle are of whiskers, and this is about {of.plural}",
            "one of them", "leave it out",
        )  # fmt: skip
    if at is None and not (best and question == "precision"):
        raise Refusal(
            f"The {of.plural} that are compared with are needed", "none",
            "write " + argument("standards", [300.0, 600.0, 1200.0]) + ", say",
        )  # fmt: skip
    task = task or "2IFC"
    if question == "weber-law":
        named = rival or "constant"
        standards = np.asarray(at, dtype=float)
        return rivals(of.encoding, standards, named, weber_fraction=weber_fraction, task=task)
    return [Hypothesis("Weber's law", of.encoding, task=task)]


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
    rival: str | None,
    weber_fraction: float,
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
        if rival is not None:
            return rivals(encoding, at, rival, weber_fraction=weber_fraction, task=task)
        return noises(encoding, at, task=task)
    return [Hypothesis("expected observer", encoding, task=task)]
