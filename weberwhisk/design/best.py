"""The best that designs can do: goals that none reaches, and the best standards and offsets.

A goal out of reach is refused before any experiment is simulated. A scheme is judged by the
*expected* answers of an animal, n·P of every level (Cowan et al. 2011, Eur. Phys. J. C 71:1554,
§3.2), fitted as data are. One standard or end of the offsets is exchanged at a time, until no
exchange helps (Meyer & Nachtsheim 1995, Technometrics 37:60). Expected answers do not scatter:
simulated experiments decide between what was found and even standards.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import minimize
from scipy.special import logsumexp, rel_entr

from .._util import checks
from .._util.refusals import Advice, Refusal, argument
from .._util.values import Array, counted, density_quantiles
from ..behaviour.priors import SPREAD
from ..behaviour.psychometric import difference_sd
from .experiments import compare, fit, simulate
from .hypotheses import Goal, Hypothesis, SubjectPopulation, check_goal
from .scheme import Constraints, Scheme, sized

__all__ = [
    "best_scheme", "fewest_animals", "known_half_widths", "refuse_impossible", "trials_needed",
]  # fmt: skip

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

    Raises
    ------
    ValueError
        For constraints that nothing satisfies, saying which and by how much.

    Examples
    --------
    >>> from weberwhisk import Whisker
    >>> from weberwhisk.design import Constraints, taper
    >>> found = best_scheme(taper(Whisker(50e-3, 100e-6, 5e-6)), standards=2, pairs=1,
    ...                     constraints=Constraints(nearest=5e-3, farthest=45e-3), runs=32)
    >>> near, far = found.standards
    >>> near < 15e-3 and far > 35e-3
    True
    """
    given, aim = check_goal(hypotheses, goal)
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
    ends = _range(given, limits)
    tried: dict[Choice, tuple[float, Scheme | Refusal]] = {}

    def value(choice: Choice) -> float:
        """What is expected of a choice; minus infinity where rig or observers rule it out."""
        if choice not in tried:
            try:
                scheme = _scheme(choice, ends, given[0], likely, limits, pairs, each, animals)
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
    found = [s for c in dict.fromkeys((start, best)) if isinstance(s := tried[c][1], Scheme)]
    if isinstance(even_scheme, Refusal) and not found:
        raise even_scheme
    return max(found, key=lambda s: _simulated(s, given, aim, likely, runs, seed))


def _range(hypotheses: Sequence[Hypothesis], limits: Constraints) -> tuple[float, float]:
    """The distances that the animal reaches and every hypothesis can encode."""
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
    rows = []
    for s, wide in zip(standards, widest, strict=True):
        levels = np.unique(limits.positions(s + wide * np.concatenate([-ratios, ratios])))
        rows.append([float(f"{v - s:.12g}") for v in levels if abs(v - s) > 1e-9 * s])
    if standards.size < len(at) or any(len(row) < 2 * pairs for row in rows):
        raise Refusal(
            f"steps of {limits.step:g} leave fewer than standards={len(at)} with pairs={pairs} "
            f"of offsets between {low:g} and {high:g}",
            remedy="take finer steps, a wider range or fewer",
        )
    return Scheme(standards, rows, each, count)


def _expected(
    scheme: Scheme, hypotheses: Sequence[Hypothesis], goal: Goal, animals: SubjectPopulation
) -> float:
    """The log Bayes factor of the truth that is hardest to tell, or minus the half-width of the
    interval of k, from the answers that one animal gives on average."""
    own, found = scheme.with_animals(1), []
    for truth in hypotheses if goal.half_width is None else hypotheses[:1]:
        counts = truth.expected_counts(own, animals.weber_fraction, animals.lapse)[None, None]
        if goal.half_width is None:
            found.append(compare(hypotheses, truth.name, own, counts)[0][0])
        else:
            found.append(-fit(truth, own, counts).half_width[0])
    return float(min(found))


def _simulated(
    scheme: Scheme, hypotheses: Sequence[Hypothesis], goal: Goal, animals: SubjectPopulation,
    runs: int, seed: int,
) -> float:  # fmt: skip
    """The same of simulated animals: what the goal's share of experiments reach."""
    own, rng, worst = scheme.with_animals(1), np.random.default_rng(seed), np.inf
    truths = hypotheses if goal.half_width is None else hypotheses[:1]
    for truth in truths:
        counts, _ = simulate(truth, own, animals, max(runs // len(truths), 1), rng)
        if goal.half_width is None:
            reached = compare(hypotheses, truth.name, own, counts)[0]
        else:
            reached = -fit(truth, own, counts).half_width
        worst = min(worst, float(np.quantile(reached, 1 - goal.share)))
    return worst


def refuse_impossible(
    scheme: Scheme,
    hypotheses: Sequence[Hypothesis],
    goal: Goal,
    expected: SubjectPopulation,
    vary: str,
    most: int,
    together: bool,
) -> None:
    """Refuse a goal that the animals' spread or the information per trial puts out of reach.

    Either bound is optimistic: animals whose k is known exactly, and trials of an animal of which
    nothing else is unknown.
    """
    what = "trials a comparison" if vary == "trials" else "animals"
    start = f"no design of up to {most} {what} reaches {goal}"
    largest = sized(scheme, vary, most)
    if goal.half_width is not None and together and largest.animals > 1:
        widths = known_half_widths(hypotheses[0], expected, largest.animals)
        share = float((widths < goal.half_width).mean())
        if share < goal.share:
            fewest = fewest_animals(hypotheses[0], expected, goal)
            reached = float(np.quantile(widths, goal.share))
            more = "" if fewest is None else argument("animals", fewest) + " or more, or "
            raise Refusal(
                f"{start}: were the k of each of {counted(largest.animals, 'animal')} known "
                f"exactly, with ln k spread by {expected.spread:g} between animals, the "
                f"interval would be narrow enough in {100 * share:.2g} % of experiments",
                remedy=Advice.joined(
                    "",
                    ["write ", more, argument("half_width", float(np.ceil(100 * reached) / 100))],
                ),
            )
        return
    if vary != "trials" or (goal.bayes_factor is not None and goal.share < 0.5):
        return
    needed, words = trials_needed(scheme, hypotheses, goal, expected)
    if needed > most:
        raise Refusal(
            f"{start}: {words}, which takes {needed:.0f} trials a comparison were nothing else "
            "unknown",
            remedy=(
                "set the standards farther apart, take more of them or of animals, or ask for less"
            ),
        )


def known_half_widths(
    hypothesis: Hypothesis, expected: SubjectPopulation, animals: int, runs: int = 256
) -> Array:
    """Half-widths of the population's k over its median, (runs,), were every animal's k known.

    What is left unknown is the mean of ln k, given its prior, and the spread.
    """
    log_k = np.log(expected.weber_fraction) + expected.spread * np.random.default_rng(1).normal(
        size=(runs, animals)
    )
    middle, variance = log_k.mean(axis=1), log_k.var(axis=1)
    node, weight = np.polynomial.legendre.leggauss(60)
    end = float(SPREAD.ppf(1 - 1e-4))
    spread = 0.5 * end * (node + 1)
    # As many sds of the mean as the tails of an unknown spread have.
    away = np.sqrt((variance[:, None] + 1e-12) / animals) * np.linspace(-12, 12, 241)
    square = variance[:, None] + 1e-12 + away**2
    # The likelihood of the mean depends on that square alone.
    table = np.geomspace(square.min(), square.max(), 500)
    log_like = -animals * (np.log(spread) + table[:, None] / (2 * spread**2)) + np.log(weight)
    log_like = logsumexp(log_like + SPREAD.logpdf(spread), axis=1)
    density = np.interp(np.log(square), np.log(table), log_like)
    density = np.exp(density - density.max(axis=1, keepdims=True))
    mean = middle[:, None] + away
    density *= np.exp(hypothesis.priors.log_density("weber_fraction", np.exp(mean)) + mean)
    low, half, high = density_quantiles(mean, density, [0.025, 0.5, 0.975]).T
    return np.asarray((np.exp(high - half) - np.exp(low - half)) / 2)


def fewest_animals(
    hypothesis: Hypothesis, expected: SubjectPopulation, goal: Goal, most: int = 200
) -> int | None:
    """The fewest animals that could reach the goal, were every animal's k known; None past `most`.

    Examples
    --------
    >>> from weberwhisk.behaviour import IdentityEncoding
    >>> weber = Hypothesis("Weber", IdentityEncoding())
    >>> 8 < fewest_animals(weber, SubjectPopulation(), Goal(half_width=0.2)) < 20
    True
    """
    assert goal.half_width is not None
    low, high = 1, most
    if (known_half_widths(hypothesis, expected, most) < goal.half_width).mean() < goal.share:
        return None
    while high - low > 1:
        middle = (low + high) // 2
        widths = known_half_widths(hypothesis, expected, middle)
        enough = (widths < goal.half_width).mean() >= goal.share
        low, high = (low, middle) if enough else (middle, high)
    return high


def trials_needed(
    scheme: Scheme, hypotheses: Sequence[Hypothesis], goal: Goal, expected: SubjectPopulation
) -> tuple[float, str]:
    """Trials of the comparison shown most that the information of a trial demands, and of what.

    For an interval Fisher information of ln k, lapses and bias known: the sd is at least its root's
    inverse. For a Bayes factor the mean log-likelihood ratio to the nearest of the other
    hypothesis, which has any k and biases (Kullback–Leibler divergence).
    """
    cells, most = scheme.cells(), max(map(max, scheme.trials))
    if goal.half_width is not None:
        model = hypotheses[0].model(scheme)
        drawn = expected.draw(64, seed=20)
        lapses = drawn[["lapse_low", "lapse_high"]].to_numpy().T
        bias = np.repeat(
            hypotheses[0].usual_bias + drawn["bias"].to_numpy()[:, None], model.n_groups, axis=1
        )
        k, step = drawn["weber_fraction"].to_numpy(), 1e-3
        below, p, above = (
            model.probability(k * np.exp(d), lapses[0], lapses[1], bias)[0]
            for d in (-step, 0.0, step)
        )
        slope = (above - below) / (2 * step)
        each = (slope**2 / (p * (1 - p))) @ cells.n / most
        wanted = (1.96 / np.arcsinh(goal.half_width)) ** 2
        prior = np.log(hypotheses[0].priors.value("weber_fraction", np.array([-0.5, 0.5])))
        needed = (wanted - np.diff(prior).item() ** -2.0) / each
        return float(np.quantile(needed, goal.share)), f"k to ±{100 * goal.half_width:g} %"
    assert goal.bayes_factor is not None
    hardest, words = 0.0, ""
    for truth in hypotheses:
        p = truth.expected_counts(scheme, expected.weber_fraction, expected.lapse) / cells.n
        for other in hypotheses:
            if other is truth:
                continue
            ratio = scheme.animals * _divergence(other, scheme, p, expected) / most
            needed = float(np.log(goal.bayes_factor) / max(ratio, 1e-12))
            if needed > hardest:
                hardest, words = needed, f"{truth.name} discriminated from {other.name}"
    return hardest, words


def _divergence(
    hypothesis: Hypothesis, scheme: Scheme, p: Array, expected: SubjectPopulation
) -> float:
    """Mean log-likelihood ratio of one animal's table to the nearest that a hypothesis has."""
    model, n = hypothesis.model(scheme), scheme.cells().n
    lapse, middle = np.array([expected.lapse]), np.log(expected.weber_fraction)

    def ratio(theta: Array) -> float:
        bias = theta[1:] if model.free_bias else 0.0
        biases = hypothesis.usual_bias + np.broadcast_to(bias, (1, model.n_groups))
        q = model.probability(np.exp(middle + theta[:1]), lapse, lapse, biases)[0][0]
        return float(n @ (rel_entr(p, q) + rel_entr(1 - p, 1 - q)))

    start = np.zeros(1 + model.n_groups * model.free_bias)
    return float(minimize(ratio, start, method="BFGS").fun)
