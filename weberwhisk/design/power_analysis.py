"""How often an experiment reaches its goal, and the smallest that reaches it often enough."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import Any, ClassVar

import numpy as np
import pandas as pd
from scipy.special import ndtri

from .._util import campaign, checks, output
from .._util.refusals import Refusal, argument
from .._util.values import Shown, interval_text, paragraphs
from ..behaviour.states import States
from .goals import Contrast, Goal, goal_for
from .hypotheses import Hypothesis, SubjectPopulation
from .scheme import Scheme, sized
from .simulation import experiments

__all__ = ["Power", "power", "share_in_words", "smallest", "summary", "wilson"]

BY = ["truth", "trials", "animals"]  # what experiments are counted by


@dataclass(frozen=True, repr=False)
class Power(Shown):
    """What designs of several sizes reach.

    Columns of `table`, a row for each truth and size: `truth`; `trials` of the comparison shown
    most, for each animal; `animals`; `runs`; `power`, the share of experiments that reach the goal,
    with its Monte Carlo interval `lower` to `upper` (95 %, Wilson); the median, and 5 and 95 %
    quantiles, of `half_width` (of the 95 % interval of k, over its median) and of
    `log_bayes_factor` (natural log, for the truth against the best of the others); how well k is
    recovered: `bias`, the median of its estimate over the true one, less 1, and `coverage` of its
    interval; where hypotheses are compared `wrong`, the share whose Bayes factor is as far on the
    other side. `runs` has one row an experiment.
    """

    _figure: ClassVar[str] = "power_curve"
    goal: Goal
    table: pd.DataFrame
    runs: pd.DataFrame

    def _line(self) -> str:
        last = self.table.sort_values(["animals", "trials"]).groupby("truth", sort=False).last()
        return "power " + "; ".join(
            f"{interval_text(row['power'], row['lower'], row['upper'])} where {truth} is true, "
            f"{row['animals']:g} × {row['trials']:g} trials a comparison"
            for truth, row in last.iterrows()
        )

    def report(self) -> str:
        """The table in words: a paragraph for each truth, a sentence for each size."""
        sections = {"Goal": [f"{self.goal}."]}
        for truth, of_truth in self.table.groupby("truth", sort=False):
            sections[f"If {truth} is true"] = said = []
            for row in of_truth.to_dict("records"):
                wrong = (
                    "" if "wrong" not in row else f", the opposite in {100 * row['wrong']:.3g} %"
                )
                said += [
                    f"{row['animals']} × {row['trials']} trials a comparison: the goal is reached "
                    f"in {share_in_words(row)} of {row['runs']} runs, {_met(row, self.goal.share)}"
                    f"{wrong}.",
                    f"The 95 % interval of {self.goal.quantity} is "
                    f"±{100 * row['half_width']:.2g} % in the median and "
                    f"covers the truth in {100 * row['coverage']:.3g} %; the median estimate is "
                    f"{100 * row['bias']:+.2g} % off.",
                ]
                if wilson(1 - row["coverage"], int(row["runs"]))[0] > 0.1:
                    said.append(
                        "Caution: the animals are not as the priors have them. Give other priors, "
                        "with_priors(hypotheses, lapse_low=...), or wider levels."
                    )
        return paragraphs(sections)


def power(
    scheme: Scheme,
    hypotheses: Sequence[Hypothesis],
    *,
    goal: Goal | None = None,
    expected: SubjectPopulation | None = None,
    states: States | None = None,
    trials: Sequence[int] | None = None,
    animals: Sequence[int] | None = None,
    truths: Sequence[str] | None = None,
    runs: int = 1000,
    together: bool = True,
    seed: int | np.random.SeedSequence = 1,
    workers: int = 1,
    scheduler: str | None = None,
    title: str = "power",
    progress: Callable[[float], None] | None = None,
) -> Power:
    """Simulate experiments of several sizes, fit each, compare, and count what they reach.

    Every experiment is integrated exactly under every hypothesis, lapses and biases with the priors
    of its fit, and without effects; see `weberwhisk.design.simulation`. Several animals share a
    population of ln k, as in `fit_population`. `coverage` is how often intervals of k contain the
    truth; the report says where that is too seldom, as the animals are not as the priors have them.

    Parameters
    ----------
    scheme : Scheme
        Levels, trials and animals.
    hypotheses : sequence of Hypothesis
        To be distinguished; one alone for the interval of its k.
    goal : Goal, optional
        By default a Bayes factor above 10 in 80 % of experiments, or with one hypothesis ±20 %.
    expected : SubjectPopulation, optional
        What the animals are like: every experiment draws its own.
    states : States, optional
        Of animals that are engaged part of the time. Every one of them is simulated trial by trial
        and fitted with `states=3`, which takes seconds; give few `runs`.
    trials, animals : sequence of int, optional
        Sizes: trials of the comparison shown most, others in proportion; and numbers of animals.
        By default those of the scheme.
    truths : sequence of str, optional
        Names of the hypotheses that are the truth in turn; all by default.
    runs : int
        Experiments of each size and truth.
    together : bool
        Fit several animals at once. Otherwise each by itself: evidence multiplies over animals, and
        a goal about intervals is reached by the share of animals whose own is narrow enough.
    seed : int or SeedSequence
    workers, scheduler, title, progress
        As for `weberwhisk.campaign.run`.

    Raises
    ------
    ValueError
        For distances that cannot be encoded, sizes that are not whole, unknown truths, and a goal
        that needs another hypothesis.

    Examples
    --------
    >>> from weberwhisk import Whisker
    >>> from weberwhisk.design import SubjectPopulation, Scheme, taper
    >>> hypotheses = taper(Whisker(50e-3, 100e-6, 5e-6))
    >>> scheme = Scheme.spaced(hypotheses[0].encoding, [15e-3, 45e-3])
    >>> found = power(scheme, hypotheses, trials=[5, 40], truths=["tapered"], runs=64, seed=1)
    >>> few, many = found.table["power"]
    >>> few < many
    True
    """
    given, aim = goal_for(hypotheses, goal)
    checks.kind(
        "scheme", scheme, "a Scheme", "offsets", "write ww.design.Scheme([20e-3], [-2e-3, 2e-3])"
    )
    likely = SubjectPopulation() if expected is None else expected
    checks.kind("expected", likely, "animals", "bias_spread", "leave it out, say")
    sizes: list[list[Any]] = []
    for name, given_sizes, scheme_size in (
        ("trials", trials, max(map(max, scheme.trials))),
        ("animals", animals, scheme.animals),
    ):
        requested = [scheme_size]
        if given_sizes is not None:
            requested = checks.several(name, given_sizes, "write [20]")
        sizes.append([checks.number(name, size, "write 20, say") for size in requested])
    named: list[Any] = [h.name for h in given]
    if truths is not None:
        named = checks.several("truths", truths, f"write {named}, say")
    for name in named:
        checks.one_of("truth", name, [h.name for h in given])
    checks.whole("runs", runs, "write 1000")
    chunks = [
        chunk
        for truth, n, number in product(named, *sizes)
        for chunk in _chunks(sized(sized(scheme, "trials", n), "animals", number), truth, int(runs))
    ]
    for h in given:  # refused here, in one sentence, not in a worker
        h.model(scheme)
    if isinstance(aim, Contrast) and states is not None:
        raise Refusal("two conditions are compared without states", "states", "leave them out")
    if states is not None:
        checks.kind("states", states, "States", "drawn", "write ww.behaviour.States(engaged=0.7)")
        if together and max(sizes[1]) > 1:
            raise Refusal(
                "animals with states are fitted one by one",
                f"{max(sizes[1])} animals fitted together",
                "write " + argument("together", False),
            )
    work = partial(
        experiments, scheme=scheme, hypotheses=given, animals=likely, goal=aim, together=together,
        states=states,
    )  # fmt: skip
    table = campaign.run(
        work, chunks, seed=seed, workers=workers, scheduler=scheduler, title=title,
        progress=progress,
    )  # fmt: skip
    return Power(aim, summary(table, aim), table)


def smallest(
    scheme: Scheme,
    hypotheses: Sequence[Hypothesis],
    *,
    goal: Goal | None = None,
    vary: str = "trials",
    most: int | None = None,
    runs: int = 512,
    even: bool = False,
    seed: int = 1,
    **options: Any,
) -> tuple[Scheme, Power]:
    """The fewest trials, or animals, that reach a goal, whichever hypothesis is true.

    A goal that the spread of the animals or the information of a trial puts out of reach is refused
    before anything is simulated. The size is doubled or halved until the goal lies between two;
    sizes between, where the powers of both ends put the goal, narrow the bracket to 5 %. Its upper
    end is the size, and fresh runs give its power.

    Parameters
    ----------
    scheme, hypotheses, goal
        As for `power`; the search starts at the scheme's own size.
    vary : {"trials", "animals"}
    most : int, optional
        Where the search ends: 1000 trials of a comparison, or 200 animals.
    runs : int
        Experiments of each size and truth visited, and twice as many of the size found; 96 are
        enough where the power is clearly above or below the goal's share (99 %). Of several animals
        at most so many as have 8192 animals together, though never below 96.
    even : bool
        Take the next even number, so that every pair comes in both orders equally often; the power
        is that of this number.
    seed : int
    **options
        As for `power`.

    Returns
    -------
    scheme : Scheme
        Of the size found.
    power : Power
        Of all sizes that the search visited; of the size found from the fresh runs alone.

    Raises
    ------
    ValueError
        For a goal that is not reached with `most`, with what is.

    Examples
    --------
    >>> from weberwhisk import Whisker
    >>> from weberwhisk.design import Scheme, taper
    >>> hypotheses = taper(Whisker(50e-3, 100e-6, 5e-6))
    >>> scheme = Scheme.spaced(hypotheses[0].encoding, [15e-3, 45e-3], trials=20)
    >>> found, _ = smallest(scheme, hypotheses, runs=64, truths=["tapered"], seed=1)
    >>> 5 < found.trials[0][0] < 40
    True
    """
    usual = {"trials": 1000, "animals": 200}
    checks.one_of("vary", vary, usual)
    given, aim = goal_for(hypotheses, goal)
    end = usual[vary] if most is None else checks.whole("most", most, "write 100, say")
    likely = options.get("expected") or SubjectPopulation()
    aim.refuse_impossible(
        scheme, given, likely, vary=vary, most=end, together=options.get("together", True)
    )
    visited: dict[int, Power] = {}
    start = min(max(map(max, scheme.trials)) if vary == "trials" else scheme.animals, end)
    # Sizes, about: to where the goal lies between two, to a twentieth of it, and twice in the end.
    sizes = np.ceil(np.log2(max(end / start, start))) + 6

    def visit(sized_scheme: Scheme, runs: int, *seeds: int) -> Power:
        root = np.random.SeedSequence([seed, *seeds])
        count = len(_chunks(sized_scheme, "", runs)) * len(options.get("truths") or given)
        # Of a size that has its runs in two parts, each is so much of it.
        part = runs / enough(sized_scheme.animals) / count
        how = options | {"progress": lambda done: advance(done * part)}
        return power(sized_scheme, given, goal=aim, runs=runs, seed=root, **how)

    def enough(animals: int) -> int:
        return runs if animals == 1 else min(runs, max(96, 8192 // animals))

    def reached(size: int) -> bool:
        if size not in visited:
            sized_scheme = sized(scheme, vary, size)
            # Where the goal is far, few runs settle a size.
            whole = enough(sized_scheme.animals)
            first_runs = min(96, whole)
            result = visit(sized_scheme, first_runs, size)
            if first_runs < whole and not _clear(result):
                result = _joined([result, visit(sized_scheme, whole - first_runs, size, 1)])
            visited[size] = result
        return bool(visited[size].table["power"].min() >= aim.share)

    own_way = options.get("progress")
    bar = nullcontext(own_way) if own_way else output.shown("Smallest design", float(sizes))
    with bar as advance:
        low, high = 0, start
        while not reached(high):
            if high == end:
                raise Refusal(_out_of_reach(visited[end], vary, end))
            low, high = high, min(2 * high, end)
        while low == 0 and high > 1:
            half = high // 2
            low, high = (low, half) if reached(half) else (half, high)
        vain = 0  # sizes in a row that narrowed it by less than halving would have
        while (gap := high - low) > max(1, 0.05 * high):
            middle = (low + high) // 2
            if low > 0 and vain < 2:
                middle = _between(low, high, visited[low], visited[high], aim.share)
            low, high = (low, middle) if reached(middle) else (middle, high)
            vain = vain + 1 if vain < 2 and high - low > gap / 2 else 0
        scheme = sized(scheme, vary, high + high % 2 * even)
        last = 2 * runs if scheme.animals == 1 else enough(scheme.animals)
        if even:
            visited.pop(high)  # one size and one number
            high += high % 2
        visited[high] = visit(scheme, last, 0)
        return scheme, _joined(list(visited.values()))


def _between(low: int, high: int, below: Power, above: Power, share: float) -> int:
    """A size between two at which power is about the share: probits of power are linear in ln n.

    A fortieth of the size off the nearer end, so that the next one has it from both sides.
    """
    first, last = (
        float(ndtri((table["power"] * table["runs"] + 0.5) / (table["runs"] + 1)).min())
        for table in (below.table, above.table)
    )
    goal = float(ndtri(share))
    place = min(max((goal - first) / max(last - first, 1e-9), 0.0), 1.0)
    size = low ** (1 - place) * high**place
    size *= 1 + (0.025 if size * size < low * high else -0.025)
    return int(min(max(round(size), low + 1), high - 1))


def _clear(result: Power, confidence: float = 0.99) -> bool:
    """Whether these runs leave no doubt on which side of the goal's share the power lies."""
    shares = zip(result.table["power"], result.table["runs"], strict=True)
    low, high = np.array([wilson(share, n, confidence) for share, n in shares]).T
    return bool(low.min() > result.goal.share or high.min() < result.goal.share)


def _chunks(scheme: Scheme, truth: str, runs: int) -> list[dict[str, Any]]:
    """So many experiments at once that they take some seconds: the grid belongs to the seed."""
    common = {"truth": truth, "trials": max(map(max, scheme.trials)), "animals": scheme.animals}
    size = 512 if scheme.animals == 1 else max(4, 256 // scheme.animals)
    return [common | {"runs": min(size, runs - i)} for i in range(0, runs, size)]


def _joined(results: list[Power]) -> Power:
    runs = pd.concat([p.runs for p in results], ignore_index=True)
    table = summary(runs, results[0].goal).sort_values(BY).reset_index(drop=True)
    return Power(results[0].goal, table, runs)


def share_in_words(row: Any) -> str:
    """The power in a row of `Power.table` with its interval, in per cent."""
    share, low, high = (100 * row[name] for name in ("power", "lower", "upper"))
    return f"{share:.3g} % (95 % interval {low:.3g} to {high:.3g} %)"


def _met(row: Any, share: float) -> str:
    goal_text = f"the {100 * share:.3g} % asked for"
    if row["lower"] > share:
        return f"more than {goal_text}"
    if row["upper"] < share:
        return f"less than {goal_text}"
    return f"not distinguishable from {goal_text} by so many runs"


def _out_of_reach(result: Power, vary: str, most: int) -> str:
    row = result.table.sort_values("power").iloc[0]
    what = "trials a comparison" if vary == "trials" else "animals"
    return (
        f"no design of up to {most} {what} reaches {result.goal}: with {most} it is "
        f"{share_in_words(row)} where {row['truth']} is true, "
        f"{100 * (result.goal.share - row['power']):.3g} % short; set the standards farther apart, "
        "take more of them or of animals, or ask for less."
    )


def wilson(share: float, n: int, mass: float = 0.95) -> tuple[float, float]:
    """Wilson's interval of a proportion (1927, J. Am. Stat. Assoc. 22:209), of any share."""
    z = float(ndtri(0.5 + mass / 2))
    middle = (share + z**2 / (2 * n)) / (1 + z**2 / n)
    reach = z / (1 + z**2 / n) * np.sqrt(share * (1 - share) / n + (z / (2 * n)) ** 2)
    low = 0.0 if share <= 0 else float(max(middle - reach, 0.0))  # not 1e-17
    return low, 1.0 if share >= 1 else float(min(middle + reach, 1.0))


def summary(runs: pd.DataFrame, goal: Goal) -> pd.DataFrame:
    """`Power.table` from single runs."""
    met = goal.is_reached(runs)
    summaries = []
    for key, group in runs.groupby(BY, sort=False):
        share = float(met[group.index].mean())
        lower, upper = wilson(share, len(group))
        row = dict(zip(BY, key, strict=True)) | {
            "runs": len(group), "power": share, "lower": lower, "upper": upper,
        }  # fmt: skip
        for name in ("half_width", "log_bayes_factor"):
            low, middle, high = group[name].quantile([0.05, 0.5, 0.95], interpolation="nearest")
            row |= {name: middle, f"{name}_5": low, f"{name}_95": high}
        off = float((group["estimate"] / group["weber_fraction"]).median() - 1)
        row |= {"bias": off, "coverage": group["covers"].mean()}
        summaries.append(row | goal.power_columns(group))
    return pd.DataFrame(summaries)
