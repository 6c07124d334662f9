"""From a question to a plan: sensible defaults for whatever an experimenter has not decided."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..behaviour.percepts import CuePercept
from ..cues import Compliance
from ..cues.protocol import Cue
from ..observer import Observer
from ..receptors import Weber
from ..whisker import Whisker
from .goals import Animals, Goal
from .hypotheses import Hypothesis, taper
from .plan import Plan
from .scheme import LEVELS, Constraints, Scheme

#: Where along the whisker the default standards stand, as fractions of its length.
PLACES = (0.3, 0.6, 0.9)


def plan_experiment(
    whisker: Whisker | str = "C2",
    *,
    goal: Goal | None = None,
    hypotheses: Sequence[Hypothesis] | None = None,
    cue: Cue | None = None,
    deflection_angle: float | None = None,
    scheme: Scheme | None = None,
    standards: ArrayLike | None = None,
    levels: ArrayLike = LEVELS,
    trials: int | None = None,
    animals: int = 1,
    expected: Animals | None = None,
    constraints: Constraints | None = None,
    trials_per_session: int = 300,
    longest_run: int = 5,
    together: bool = False,
    title: str = "Discrimination of radial distance",
    seed: int = 1,
    progress: Callable[[float], None] | None = None,
) -> Plan:
    """Plan an experiment on the discrimination of radial distance.

    Parameters
    ----------
    whisker : Whisker or str
        The whisker, or its identity.
    goal : Goal, optional
        By default a Bayes factor above 10 in 80 % of experiments.
    hypotheses : sequence of Hypothesis, optional
        As they will be fitted, the expected one first. By default the tapered whisker against the
        cylinder, or for a goal about the interval of k the tapered whisker alone.
    cue, deflection_angle : Cue and float, optional
        How distance is felt where the goal is the interval of k; the light tap by default.
    scheme : Scheme, optional
        Levels, trials and animals, where these are decided.
    standards : array_like, optional
        m; 0.3, 0.6 and 0.9 of the whisker's length by default.
    levels : array_like
        Comparisons of every standard, in sds of the expected animal's difference (see
        `Scheme.spaced`).
    trials : int, optional
        Of every comparison, for each animal; by default as few as reach the goal.
    animals : int
    expected : Animals, optional
        What the animals are expected to be like.
    constraints : Constraints, optional
        What rig and animal allow.
    trials_per_session, longest_run, together, title
        See `Plan`.
    seed : int
        Of the trial lists, and of the simulations that find the number of trials.
    progress : callable, optional

    Returns
    -------
    Plan

    Raises
    ------
    ValueError
        For constraints that contradict each other or the scheme, distances off the whisker or past
        which it flicks, and a goal that no number of trials reaches: which one, and by how much.

    Examples
    --------
    >>> plan = plan_experiment("C2", trials=20, animals=2)
    >>> plan.scheme.total_trials, plan.sessions
    (720, 2)
    """
    shape = Whisker.from_identity(whisker) if isinstance(whisker, str) else whisker
    aim = goal or Goal(bayes_factor=10.0)
    limits, likely = constraints or Constraints(), expected or Animals()
    given = _hypotheses(shape, aim, hypotheses, cue, deflection_angle)
    own: dict[str, Any] = {
        "hypotheses": given, "goal": aim, "animals": likely, "constraints": limits,
        "trials_per_session": trials_per_session, "longest_run": longest_run,
        "together": together, "title": title, "seed": seed,
    }  # fmt: skip
    if scheme is None:
        percept = given[0].percept
        at = np.asarray(PLACES) * percept.domain[1] if standards is None else standards
        scheme = Scheme.spaced(
            percept, at, weber_fraction=likely.weber_fraction, levels=levels,
            trials=1 if trials is None else trials, animals=animals, step=limits.step,
        )  # fmt: skip
    return Plan(scheme, **own)


def _hypotheses(
    whisker: Whisker,
    goal: Goal,
    hypotheses: Sequence[Hypothesis] | None,
    cue: Cue | None,
    deflection_angle: float | None,
) -> Sequence[Hypothesis]:
    if hypotheses is not None:
        if cue is not None:
            raise ValueError("Hypotheses have their cues, got hypotheses and cue; leave one out.")
        return hypotheses
    if goal.bayes_factor is not None:
        if cue is not None and not isinstance(cue, Compliance):
            raise ValueError(
                f"Taper is tested by the compliance cue, got {cue!r}; leave cue out, or give the "
                "hypotheses."
            )
        return taper(whisker)
    observer = Observer(whisker, cue or Compliance(), Weber(1.0))
    return [Hypothesis("expected observer", CuePercept(observer, deflection_angle))]
