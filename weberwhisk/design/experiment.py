"""From a question to a plan: sensible defaults for whatever an experimenter has not decided."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from .. import _checks
from .._deprecated import renamed_arguments
from ..behaviour.encodings import CueEncoding, Encoding, checked_encoding, gives_signal
from ..behaviour.psychometric import difference_sd, refuse_out_of_reach
from ..cues import Compliance
from ..cues.protocol import Cue
from ..observer import Observer
from ..receptors import Weber
from ..whisker import Whisker
from .best import best_scheme
from .hypotheses import Goal, Hypothesis, SubjectPopulation, taper
from .plan import Plan
from .power_analysis import power, sized, smallest
from .scheme import Constraints, Scheme

#: Comparisons of every standard, in sds: the widest are easy.
WIDE = (-3.5, -1.5, -0.75, 0.75, 1.5, 3.5)


def plan_experiment(
    whisker: Whisker | str = "C2",
    *,
    goal: Goal | None = None,
    hypotheses: Sequence[Hypothesis] | None = None,
    cue: Cue | None = None,
    deflection_angle: float | None = None,
    scheme: Scheme | None = None,
    standards: ArrayLike | None = None,
    levels: ArrayLike = WIDE,
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
    goal : Goal, optional
        By default a Bayes factor above 10 in 80 % of experiments.
    hypotheses : sequence of Hypothesis, optional
        As they will be fitted, the expected one first. By default the tapered whisker against the
        cylinder, or for a goal about the interval of k the tapered whisker alone.
    cue, deflection_angle : Cue and float, optional
        How distance is encoded where the goal is the interval of k; the light tap by default.
    scheme : Scheme, optional
        Levels, trials and animals, where these are decided.
    standards : array_like, optional
        m; 0.3, 0.6 and 0.9 of the whisker's length by default.
    levels : array_like
        Comparisons of every standard, in sds of the expected animal's difference (see
        `Scheme.spaced`). By default ±0.75, 1.5 and 3.5: the widest tell of lapses, which else are
        taken for a large k, and with them 162 trials do what 288 do at ±0.6, 1.2 and 2.
    best : bool
        Choose standards and offsets by `best_scheme` instead. It is best for the expected animals,
        and wants the range that real ones reach among the constraints.
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
    >>> plan = plan_experiment("C2", trials=20, animals=2, runs=0)
    >>> plan.scheme.total_trials, plan.sessions
    (720, 2)
    >>> plan_experiment("C2", standards=[10e-3, 30e-3], runs=32).goal.bayes_factor
    10.0
    """
    shape = Whisker.from_identity(whisker) if isinstance(whisker, str) else whisker
    for name, value in (("goal", goal), ("expected", expected), ("constraints", constraints)):
        kind = {"goal": Goal, "expected": SubjectPopulation, "constraints": Constraints}[name]
        if value is not None and not isinstance(value, kind):
            raise ValueError(
                f"{name} must be {kind.__name__}, got {_checks.shown(value)}; leave it out, say."
            )
    aim = goal or Goal(bayes_factor=10.0)
    if scheme is not None and (trials, standards) != (None, None):
        raise ValueError("A scheme has its standards and trials; leave standards and trials out.")
    if scheme is not None and animals not in (1, scheme.animals):
        raise ValueError(
            f"A scheme has its animals, got {scheme.animals} and animals={animals}; write "
            f"scheme.with_animals({animals})."
        )
    limits, likely = constraints or Constraints(step=10e-6), expected or SubjectPopulation()
    given = _hypotheses(shape, aim, hypotheses, cue, deflection_angle)
    wanted = _what_to_find(find, trials, scheme)
    if best:
        if scheme is not None or standards is not None:
            raise ValueError("best=True chooses the standards; leave scheme and standards out.")
        options: dict[str, Any] = {
            "goal": aim, "constraints": limits, "expected": likely, "animals": animals,
            "seed": seed,
        }  # fmt: skip
        chosen = best_scheme(given, **options)
        if trials is None and aim.half_width is not None:
            # Few trials want others than as many as the goal needs: intervals go as 1/√n.
            needed = chosen.scheme.n_trials * (chosen.value / aim.half_width) ** 2
            chosen = best_scheme(
                given, **options, trials=max(round(needed), chosen.scheme.n_trials // 2)
            )
        scheme = chosen.scheme if trials is None else chosen.scheme.with_trials(trials)
    if scheme is None:
        encoding = given[0].encoding
        at = np.array([0.3, 0.6, 0.9]) * encoding.domain[1] if standards is None else standards
        scheme = Scheme.spaced(
            encoding, at, weber_fraction=likely.weber_fraction, levels=levels,
            trials=20 if trials is None else trials, animals=animals, step=limits.step,
        )  # fmt: skip
    own: dict[str, Any] = {
        "hypotheses": given, "goal": aim, "animals": likely, "constraints": limits,
        "trials_per_session": trials_per_session, "longest_run": longest_run, "title": title,
        "seed": seed,
    }  # fmt: skip
    Plan(
        scheme, **own, together=bool(together)
    )  # refuses what cannot be shown before anything is computed
    options = {
        "goal": aim, "expected": likely, "runs": runs, "workers": workers, "scheduler": scheduler,
        "progress": progress, "together": together is not False,
    }  # fmt: skip
    found: pd.DataFrame | None = None
    if wanted != "nothing":
        scheme, found = _smallest(scheme, given, wanted, seed, options)
    elif runs:
        found = _curve(scheme, given, seed, options)
    if together is None:
        known = any(h.priors.is_fixed("weber_fraction") for h in given)
        together = scheme.animals > 1 and not known
    return Plan(scheme, **own, together=together, power=found)


def _what_to_find(find: str | None, trials: int | None, scheme: Scheme | None) -> str:
    decided = trials is not None or scheme is not None
    if find is None:
        return "nothing" if decided else "trials"
    _checks.one_of("find", find, ("trials", "animals", "nothing"))
    if find == "animals" and not decided:
        raise ValueError(
            "The number of animals is found for so many trials each, got none; write trials=20, "
            "say."
        )
    if find == "nothing" and not decided:
        raise ValueError("Trials are given or found, got neither; write trials=20, or leave find.")
    return find


def _smallest(
    scheme: Scheme,
    hypotheses: Sequence[Hypothesis],
    vary: str,
    seed: int,
    options: dict[str, Any],
) -> tuple[Scheme, pd.DataFrame]:
    """The smallest scheme that reaches the goal, and the power of all sizes on the way."""
    found = smallest(scheme, hypotheses, vary=vary, seed=seed, **options)
    size = getattr(found.power.table.iloc[0], vary)
    # Even numbers of trials let every pair come in both orders equally often.
    final = sized(scheme, vary, int(size) + (int(size) % 2 if vary == "trials" else 0))
    ways = [found.path.table[found.path.table[vary] != size], found.power.table]
    return final, pd.concat(ways, ignore_index=True).sort_values(["truth", vary])


def _curve(
    scheme: Scheme, hypotheses: Sequence[Hypothesis], seed: int, options: dict[str, Any]
) -> pd.DataFrame:
    """The power of a scheme that is decided, and of half and twice as many trials."""
    most = max(map(max, scheme.trials))
    sizes = sorted({max(most // 2, 1), most, 2 * most})
    return power(scheme, hypotheses, trials=sizes, seed=seed, **options).table


def _hypotheses(
    whisker: Whisker,
    goal: Goal,
    hypotheses: Sequence[Hypothesis] | None,
    cue: Cue | None,
    deflection_angle: float | None,
) -> Sequence[Hypothesis]:
    if hypotheses is not None:
        if cue is not None or deflection_angle is not None:
            raise ValueError(
                "Hypotheses have their cues, got hypotheses and a cue or deflection_angle; leave "
                "one out."
            )
        return hypotheses
    if goal.bayes_factor is not None:
        if cue is not None and not (isinstance(cue, Compliance) and cue.tap_angle == 0):
            raise ValueError(
                f"Taper is tested by the compliance cue at the lightest tap, got {cue!r}; leave "
                "cue out, or give the hypotheses."
            )
        if deflection_angle is not None:
            raise ValueError(
                "Taper is tested by the compliance cue, which has no deflection angle, got "
                f"{deflection_angle!r}; leave it out."
            )
        return taper(whisker)
    observer = Observer(whisker, cue or Compliance(), Weber(1.0))
    return [Hypothesis("expected observer", CueEncoding(observer, deflection_angle))]


@renamed_arguments(percept="encoding")
def lattice(
    encoding: Encoding,
    standards: ArrayLike,
    constraints: Constraints | None = None,
    *,
    each_side: int = 16,
    smallest: float = 0.01,
    largest: float = 1.2,
) -> Scheme:
    """Trials to choose from: comparisons in equal ratios of offset on either side of each standard.

    Parameters
    ----------
    encoding : Encoding
        Says how large an offset is: offsets are multiples of the sd of the difference between two
        encodings that an animal with k = 1 would have (`difference_sd`).
    standards : array_like
    constraints : Constraints, optional
        What falls outside the range is left out, the rest put on the nearest step.
    each_side : int
        Comparisons on either side, at most.
    smallest, largest : float
        Offsets, in those sds: about twice the least and the greatest k that may be met.

    Raises
    ------
    ValueError
        Where a standard is left without comparisons on both sides.

    Examples
    --------
    >>> from weberwhisk.behaviour import IdentityEncoding
    >>> lattice(IdentityEncoding(), 1.0, each_side=3, largest=0.5).comparisons
    ((0.292893, 0.9, 0.985858, 1.01414, 1.1, 1.70711),)
    """
    checked_encoding(encoding)
    low, high = encoding.domain
    # A range of distances begins at 0; other stimuli, such as logarithms, need not.
    limits = constraints or Constraints(farthest=high)
    nearest = limits.nearest if constraints else -np.inf
    given = np.atleast_1d(_checks.finite("standards", standards, "give one or several"))
    at = np.unique(limits.positions(given))
    refuse_out_of_reach(encoding, at, "standard")
    ratios = np.geomspace(smallest, largest, each_side)
    rows = []
    for s in at:
        steps = ratios * float(difference_sd(encoding, s))
        levels = limits.positions(np.concatenate([s - steps[::-1], s + steps]))
        levels = np.array([float(f"{v:.6g}") for v in levels])
        inside = (levels >= nearest) & (levels <= limits.farthest)
        levels = levels[inside & (levels > low) & (levels < high)]
        levels = np.unique(
            levels[gives_signal(encoding, levels) & (np.abs(levels - s) > 1e-9 * abs(s))]
        )
        if not (np.any(levels < s) and np.any(levels > s)):
            raise ValueError(
                f"standard {s:g} is left without comparisons on both sides, between "
                f"{max(low, nearest):g} and {min(high, limits.farthest):g}; choose another, "
                "or widen the range."
            )
        rows.append([float(f"{level - s:.12g}") for level in levels])
    return Scheme(at, rows)
