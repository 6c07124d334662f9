"""The best standards and offsets for a number of trials.

A scheme is judged by the *expected* answers of an animal, n·P of every level (Cowan et al. 2011,
Eur. Phys. J. C 71:1554, §3.2), fitted as data are. One standard or end of the offsets is exchanged
at a time, until no exchange helps (Meyer & Nachtsheim 1995, Technometrics 37:60). Expected answers
do not scatter: simulated experiments decide between the best scheme and even standards.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from .._util import checks
from .._util.refusals import Refusal
from .._util.values import Array
from ..behaviour.psychometric import difference_sd
from .goals import Goal, goal_for
from .hypotheses import Hypothesis, SubjectPopulation
from .magnitude import Magnitude, magnitude_of
from .scheme import Constraints, Scheme
from .simulation import compare, simulate

__all__ = ["best_scheme"]

#: Places of a standard over the range, and the least and greatest offsets, in sds of the expected
#: difference, that are tried. On a C2-like whisker within 5 to 45 mm, 360 trials, the schemes found
#: reach 5.9 nats or ±39 % in 80 % of 2048 experiments; so did a search over every single offset in
#: steps of 0.3 sd and 19 places, with 5.9 nats and ±42 %.
PLACES = 15
OFFSETS = (0.3, 0.6, 1.0), (1.5, 2.5, 3.5)
Choice = tuple[int, ...]  # places of the standards, and of the least and greatest offset


def best_scheme(
    hypotheses: Sequence[Hypothesis],
    *,
    goal: Goal | None = None,
    constraints: Constraints | None = None,
    expected: SubjectPopulation | None = None,
    standards: int = 3,
    pairs: int = 3,
    trials: int = 360,
    animals: int = 1,
    runs: int = 512,
    seed: int = 1,
    magnitude: Magnitude | None = None,
) -> Scheme:
    """Choose standards and offsets for a number of trials.

    Parameters
    ----------
    hypotheses : sequence of Hypothesis
        The first is the expected one.
    goal : Goal, optional
        Whether to go for the Bayes factor (by default with two hypotheses) or the interval of k.
    constraints : Constraints, optional
    expected : SubjectPopulation, optional
        The animals whose answers are expected.
    standards, pairs : int
        How many standards, and how many offsets on either side of each, in equal ratios.
    trials : int
        Of one animal, all levels together: they are spread evenly.
    animals : int
        Written into the scheme.
    runs : int
        Experiments simulated in the end, all truths together.
    seed : int
        Of these.
    magnitude : Magnitude, optional
        What the stimuli are, by default what the first encoding is of.

    Raises
    ------
    ValueError
        For constraints that nothing satisfies, saying which and by how much.

    Examples
    --------
    >>> from weberwhisk import Whisker
    >>> from weberwhisk.behaviour import Priors
    >>> from weberwhisk.design import Constraints, taper
    >>> lapses = Priors(lapse_low=0.02, lapse_high=0.02)
    >>> found = best_scheme(taper(Whisker(50e-3, 100e-6, 5e-6), priors=lapses), standards=2,
    ...                     constraints=Constraints(nearest=5e-3, farthest=45e-3), runs=8)
    >>> near, far = found.standards
    >>> near < 15e-3 and far > 35e-3
    True
    """
    given, aim = goal_for(hypotheses, goal)
    limits, likely = constraints or Constraints(), expected or SubjectPopulation()
    for name, number in (("standards", standards), ("pairs", pairs), ("trials", trials)):
        checks.whole(name, number, "write 3")
    each = trials // (2 * pairs * standards)
    if each < 1:
        raise Refusal(
            f"{trials} trials are fewer than the {2 * pairs * standards} levels of {standards} "
            f"standards with {pairs} pairs, {2 * pairs * standards - trials} short",
            remedy="give more",
        )
    if standards >= PLACES:
        raise Refusal(f"standards must be below {PLACES}", standards, "write 3, say")
    of = magnitude or magnitude_of(given[0].encoding)
    ends = _range(given, limits)
    tried: dict[Choice, tuple[float, Scheme | Refusal]] = {}

    def value(choice: Choice) -> float:
        """What is expected of a choice; minus infinity where rig or observers rule it out."""
        if choice not in tried:
            try:
                scheme = _scheme(choice, ends, given[0], likely, limits, pairs, each, animals)
                scheme = replace(scheme, magnitude=of)
                for h in given:
                    limits.check(scheme, h.encoding)
                tried[choice] = _expected(scheme, given, aim, likely), scheme
            except Refusal as error:
                tried[choice] = -np.inf, error
        return tried[choice][0]

    even = np.linspace(0, PLACES - 1, standards + 2)[1:-1].round().astype(int)
    start = best = (*even.tolist(), 1, 2)
    sizes = [*[PLACES] * standards, *map(len, OFFSETS)]
    before = None
    while best != before:
        before = best
        for i, size in enumerate(sizes):
            ways = [(*best[:i], j, *best[i + 1 :]) for j in range(size)]
            ways = [way for way in ways if len({*way[:standards]}) == standards]
            best = max([best, *ways], key=value)
    even_scheme = tried[start][1]
    schemes = [s for c in dict.fromkeys((start, best)) if isinstance(s := tried[c][1], Scheme)]
    if isinstance(even_scheme, Refusal) and not schemes:
        raise even_scheme
    return max(schemes, key=lambda s: _simulated(s, given, aim, likely, runs, seed))


def _range(hypotheses: Sequence[Hypothesis], limits: Constraints) -> tuple[float, float]:
    """The stimuli that can be put and every hypothesis can encode."""
    low = max(limits.nearest, max(h.encoding.domain[0] for h in hypotheses))
    high = min(limits.farthest, min(h.encoding.domain[1] for h in hypotheses))
    if not (np.isfinite(high) and low < high):
        raise Refusal(
            f"the range of {limits.nearest:g} to {limits.farthest:g} leaves nothing that can "
            f"be encoded, which ends at {high:g}, {low - high:.3g} before it begins",
            remedy="give ww.design.Constraints(nearest=..., farthest=...)",
        )
    return low, high


def _scheme(
    choice: Choice, ends: tuple[float, float], first: Hypothesis, animals: SubjectPopulation,
    limits: Constraints, pairs: int, each: int, count: int,
) -> Scheme:  # fmt: skip
    """The scheme of a choice; offsets shrink together where the range has no room for them."""
    low, high = ends
    *at, least, greatest = choice
    places = np.linspace(low, high, PLACES + 2)
    standards = np.unique(limits.positions([float(f"{places[i + 1]:.6g}") for i in at]))
    sd = animals.weber_fraction * difference_sd(first.encoding, standards)
    room = 0.99 * np.minimum(standards - low, high - standards)
    widest = np.minimum(OFFSETS[1][greatest] * sd, room)
    ratios = np.geomspace(1.0, OFFSETS[0][least] / OFFSETS[1][greatest], pairs)
    offsets = []
    for s, wide in zip(standards, widest, strict=True):
        levels = np.unique(limits.positions(s + wide * np.concatenate([-ratios, ratios])))
        offsets.append([float(f"{v - s:.12g}") for v in levels if abs(v - s) > 1e-9 * s])
    if standards.size < len(at) or any(len(row) < 2 * pairs for row in offsets):
        raise Refusal(
            f"steps of {limits.step:g} leave fewer than standards={len(at)} with pairs={pairs} "
            f"of offsets between {low:g} and {high:g}",
            remedy="take finer steps, a wider range or fewer",
        )
    return Scheme(standards, offsets, each, count)


def _expected(
    scheme: Scheme, hypotheses: Sequence[Hypothesis], goal: Goal, animals: SubjectPopulation
) -> float:
    """The goal's score from the answers that one animal gives on average, under the worst truth."""
    single = scheme.with_animals(1)
    return min(
        _scores(
            truth, hypotheses, goal, single,
            truth.expected_counts(single, animals.weber_fraction, animals.lapse)[None, None],
        ).item()
        for truth in goal.truths(hypotheses)
    )  # fmt: skip


def _simulated(
    scheme: Scheme, hypotheses: Sequence[Hypothesis], goal: Goal, animals: SubjectPopulation,
    runs: int, seed: int,
) -> float:  # fmt: skip
    """The score that the goal's share of simulated experiments reaches, under the worst truth."""
    single, rng, worst = scheme.with_animals(1), np.random.default_rng(seed), np.inf
    truths = goal.truths(hypotheses)
    for truth in truths:
        counts, _ = simulate(truth, single, animals, max(runs // len(truths), 1), rng)
        scores = _scores(truth, hypotheses, goal, single, counts)
        worst = min(worst, float(np.quantile(scores, 1 - goal.share)))
    return worst


def _scores(
    truth: Hypothesis, hypotheses: Sequence[Hypothesis], goal: Goal, scheme: Scheme, counts: Array
) -> Array:
    log_factor, fitted = compare(goal.compared(hypotheses, truth), truth.name, scheme, counts)
    return goal.score(log_factor, fitted.half_width)
