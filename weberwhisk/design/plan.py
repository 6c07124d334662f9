"""A planned experiment: what is shown, what is expected, how it will be analysed, and why so much.

The fields of a `Plan` are what was decided; all else is computed from them on request. Its JSON
has the fields, and brings back the same plan with the same trial lists, to the byte.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import pandas as pd
from scipy.stats import binom

from .._util import checks
from .._util.output import csv_text, versions_in_words
from .._util.refusals import Refusal, argument
from .._util.values import Array, Shown, counted, interval_text, paragraphs, plain_number
from ..behaviour.alone import LEFT_OUT
from ..behaviour.fit import WeberFit
from ..behaviour.population_fit import PopulationFit, PopulationStatus, fit_population
from ..behaviour.psychometric import difference_sd
from ..behaviour.report import equality_and_jnds
from ..behaviour.trials import STIMULI, Trials
from ..behaviour.verdict import FitStatus
from ..sensitivity import criterion_factor
from .conditions import Ratio, ratio_of
from .goals import Contrast, Goal, goal_for
from .hypotheses import (
    ONE_STIMULUS,
    Hypothesis,
    SubjectPopulation,
    check_answers,
    check_distinct,
    check_magnitude,
    check_task,
    options_of,
)
from .magnitude import Magnitude
from .power_analysis import share_in_words
from .rivals import FlooredNoise
from .scheme import Constraints, Scheme
from .session import sessions_needed, trial_lists, with_places

__all__ = ["AnalysisResult", "Plan", "analyse", "sha256_of"]


@dataclass(frozen=True, eq=False, repr=False)
class AnalysisResult(Shown):
    """What the planned analysis finds in a table of trials.

    Parameters
    ----------
    estimates : DataFrame
        One row a hypothesis and animal, or one a hypothesis for all animals fitted together
        (`subject` is then "population"): `hypothesis`, `subject`, `weber_fraction` (posterior
        median) with the 95 % interval `lower` to `upper`, and the `status` of the fit.
    log_evidence : mapping of str to float
        Of each hypothesis, all animals together.
    left_out : tuple of str
        Animals whose answers are evidence for no hypothesis: under at least one, the fit found them
        reversed, one-sided or missing. They are not in the evidence, nor in the population.
    trials : Trials
    fits : sequence of WeberFit or PopulationFit
        One for each row of `estimates`.
    plan : Plan, optional
        Where the analysis is a plan's.
    ratio : Ratio, optional
        Of the Weber fractions in two conditions, where a plan compares them; `estimates` has then a
        row a `condition`.
    """

    _figure: ClassVar[str] = "analysed"
    estimates: pd.DataFrame
    log_evidence: dict[str, float]
    left_out: tuple[str, ...]
    trials: Trials
    fits: Sequence[WeberFit | PopulationFit]
    plan: Plan | None = None
    ratio: Ratio | None = None

    def log_bayes_factor(self, hypothesis: str) -> float:
        """Natural log of the Bayes factor for a hypothesis against the best of the others.

        Infinite where there is no other.
        """
        checks.one_of("hypothesis", hypothesis, self.log_evidence)
        others = [v for name, v in self.log_evidence.items() if name != hypothesis]
        return self.log_evidence[hypothesis] - max(others, default=-np.inf)

    def favoured(self, bayes_factor: float = 10.0) -> str | None:
        """The hypothesis `bayes_factor` times as probable as every other, or None."""
        best = max(self.log_evidence, key=lambda name: self.log_evidence[name])
        return best if self.log_bayes_factor(best) > np.log(bayes_factor) else None

    def of(self, hypothesis: str) -> pd.DataFrame:
        """The estimates under one hypothesis."""
        of_hypothesis = self.estimates["hypothesis"] == hypothesis
        return self.estimates[of_hypothesis].reset_index(drop=True)

    def _line(self) -> str:
        return f"{' '.join(self._conclusion())} {counted(self.trials.n_trials, 'trial')}"

    def _table(self) -> pd.DataFrame:
        return self.estimates

    def report(self) -> str:
        """What was found, in plain words, a paragraph for each heading."""
        plan, trials = self.plan, self.trials
        who = SubjectPopulation() if plan is None else plan.animals
        animals = who.counted(max(len(trials.subjects), 1))
        data = f"{counted(trials.n_trials, 'trial')} with an answer of {animals}"
        if plan is not None:
            planned = "analysed as planned" if self.is_as_planned else "analysed by the plan"
            data += f", {planned}; {plan.scheme.total_trials} were planned"
        departures = self.departures_in_words()
        sentences = []
        for row, fit in zip(self.estimates.to_dict("records"), self.fits, strict=True):
            k = interval_text(row["weber_fraction"], row["lower"], row["upper"])
            if isinstance(fit, PopulationFit):
                said = PopulationStatus[row["status"]].value
            else:
                said = FitStatus[row["status"]].message
            said = said.replace("animals", who.subjects).replace("animal", who.subject)
            where = f", {row['condition']}" if "condition" in row else ""
            sentences.append(f"{row['hypothesis']}, {row['subject']}{where}: k = {k}; {said}.")
        if self.left_out:
            sentences.append(f"Left out of the conclusion: {', '.join(self.left_out)}.")
        sections = {
            "Data": [f"{data}.", *departures, *trials.notes],
            "Weber fraction": sentences,
            "Equality and just noticeable difference": self._equality_and_jnds(),
            "Conclusion": self._conclusion(),
            "Software": [f"{versions_in_words('numpy', 'scipy')}."],
        }
        title = "" if plan is None else f"{plan.title}\n\n"
        return title + paragraphs({head: said for head, said in sections.items() if said})

    def _equality_and_jnds(self) -> list[str]:
        """Of each one fitted alone, under the hypothesis of the highest evidence."""
        best = max(self.log_evidence, key=lambda name: self.log_evidence[name])
        said, unit, per_unit, greater = [], "", 1.0, "greater"
        if self.plan is not None:
            of = self.plan.magnitude
            unit, per_unit, greater = of.unit_after, of.per_unit, of.greater
        for row, fit in zip(self.estimates.to_dict("records"), self.fits, strict=True):
            if row["hypothesis"] == best and isinstance(fit, WeberFit):
                lines = equality_and_jnds(fit, unit, per_unit)
                lines = [line.replace('second greater"', f'second {greater}"') for line in lines]
                whose = [str(row[name]) for name in ("subject", "condition") if name in row]
                several = len(self.fits) > len(self.log_evidence)
                said += [f"{', '.join(whose)}: {line}" if several else line for line in lines]
        return said

    @property
    def departures(self) -> tuple[int, int]:
        """Trials of the plan that are missing, and trials that were not planned; (0, 0) of none."""
        if self.plan is None:
            return 0, 0
        of, planned = self.plan.magnitude, self.plan.trials
        pairs = [planned[of.column(name)] for name in STIMULI[1:]]
        frame = self.trials.frame
        first, second = (of.written(frame[name]) for name in STIMULI[1:])
        left = Counter(_rounded_pairs(*pairs))
        left.subtract(Counter(_rounded_pairs(first, second, frame["n"])))
        return sum(n for n in left.values() if n > 0), -sum(n for n in left.values() if n < 0)

    @property
    def is_as_planned(self) -> bool:
        """Whether the trials are those of the plan, all of them and no others."""
        return self.departures == (0, 0)

    def departures_in_words(self) -> list[str]:
        """How the trials differ from the plan's, in sentences; none where they do not."""
        missing, more = self.departures
        said = []
        if missing:
            verb = "is" if missing == 1 else "are"
            said.append(f"{counted(missing, 'planned trial')} {verb} missing.")
        if more:
            verb = "was" if more == 1 else "were"
            said.append(f"{counted(more, 'trial')} {verb} not planned.")
        return said

    def _conclusion(self) -> list[str]:
        said = self._verdict()
        if said and not self.is_as_planned:
            said.append(
                "This is not the preregistered verdict, which is that of the planned trials: "
                f"{' and '.join(words[:-1] for words in self.departures_in_words())}."
            )
        return said

    def _verdict(self) -> list[str]:
        goal = None if self.plan is None else self.plan.goal
        if self.ratio is not None and isinstance(goal, Contrast):
            verdict = goal.verdict_of_ratio(self.ratio.lower, self.ratio.upper)
            said = str(self.ratio)
            return [f"{said[0].upper()}{said[1:]}; {verdict}."]
        if len(self.log_evidence) > 1:
            best = max(self.log_evidence, key=lambda name: self.log_evidence[name])
            log_factor = self.log_bayes_factor(best)
            factor = "more than 100000"
            if log_factor < np.log(1e5):
                factor = f"{float(f'{np.exp(log_factor):.3g}'):g}"
            words = f"Best: {best}, by a Bayes factor of {factor}"
            return [f"{words}{'' if goal is None else goal.verdict_of_factor(log_factor)}."]
        if goal is None:
            return []
        half = (self.estimates["upper"] - self.estimates["lower"]) / 2
        return goal.verdict_of_widths(half / self.estimates["weber_fraction"])

    def methods(self) -> str:
        """What was done, for a methods section: a paragraph for each hypothesis."""
        firsts = self.estimates.reset_index().groupby("hypothesis", sort=False)["index"].first()
        return paragraphs({str(name): [self.fits[at].methods()] for name, at in firsts.items()})


def analyse(
    trials: Trials,
    hypotheses: Sequence[Hypothesis],
    *,
    together: bool = False,
    unit: float = 1.0,
    check: bool = True,
) -> AnalysisResult:
    """Fit every hypothesis to the trials, and weigh them.

    Parameters
    ----------
    trials : Trials
        With a column `subject` where there are several animals.
    hypotheses : sequence of Hypothesis
        Each is fitted with its own encoding, priors, bias and noise.
    together : bool
        Fit all animals at once, each learning from the others (`fit_population`). Otherwise each is
        fitted by itself (`fit_weber`), and evidence multiplies over animals.
    unit : float
        Unit of the stimuli in the encodings' own: 1e-3 where they were mapped by name and are in
        millimetres; `stimulus_1_mm` and so on are read in metres already.
    check : bool
        Whether fits are checked for what the model does not hold; simulated studies leave it out.

    Raises
    ------
    ValueError
        For trials that cannot be fitted, and a single animal with `together`.

    Examples
    --------
    >>> from weberwhisk import Whisker, simulate_trials
    >>> from weberwhisk.behaviour import Priors
    >>> from weberwhisk.design import taper
    >>> lapses = Priors(lapse_low=0.02, lapse_high=0.02)
    >>> tapered, cylindrical = taper(Whisker(50e-3, 100e-6, 5e-6), priors=lapses)
    >>> trials = simulate_trials(encoding=tapered.encoding, standards=[15e-3, 45e-3],
    ...     offsets=[-0.1, -0.05, 0.05, 0.1], trials_per_level=60, subject="s1", seed=2)
    >>> analyse(trials, [tapered, cylindrical]).favoured(10)
    'tapered'
    """
    checks.kind("trials", trials, "Trials", "frame", "write ww.read_trials(file), say")
    if unit != 1.0:
        frame = trials.frame.assign(**{name: trials.frame[name] * unit for name in STIMULI})
        trials = replace(trials, frame=frame)
    given = check_distinct(hypotheses)
    return (_pooled if together else _each_animal)(trials, given, check)


def sha256_of(table: pd.DataFrame) -> str:
    """SHA-256 of a table as a CSV file."""
    return hashlib.sha256(csv_text(table).encode()).hexdigest()


def _rounded_pairs(first: Any, second: Any, n: Any = 1) -> list[tuple[str, str]]:
    """Pairs of stimuli as they are written, each so many times."""
    counts = np.broadcast_to(np.asarray(n, dtype=int), np.shape(first))
    triples = zip(np.asarray(first), np.asarray(second), counts, strict=True)
    return [(f"{a:.6g}", f"{b:.6g}") for a, b, times in triples for _ in range(times)]


def _each_animal(trials: Trials, hypotheses: Sequence[Hypothesis], check: bool) -> AnalysisResult:
    estimates: list[dict[str, Any]] = []
    every: list[WeberFit] = []
    evidence: dict[str, list[float | None]] = {h.name: [] for h in hypotheses}
    left_out = []
    for subject in trials.subjects or ["s1"]:
        answers = trials.select(subject=subject) if trials.subjects else trials
        fits = [h.fit(answers) for h in hypotheses]
        estimates += [
            _row(h, str(subject), fit, fit.status if check else fit.unchecked)
            for h, fit in zip(hypotheses, fits, strict=True)
        ]
        every += fits
        if any(fit.unchecked in LEFT_OUT for fit in fits):
            left_out.append(str(subject))
            continue
        for h, fit in zip(hypotheses, fits, strict=True):
            evidence[h.name].append(fit.log_evidence)
    total = {name: float(np.sum(np.array(values, float))) for name, values in evidence.items()}
    return AnalysisResult(pd.DataFrame(estimates), total, tuple(left_out), trials, every)


def _pooled(trials: Trials, hypotheses: Sequence[Hypothesis], check: bool) -> AnalysisResult:
    if len(trials.subjects) < 2:
        raise Refusal(
            f"{trials.source}: animals are fitted together where there are two or more",
            len(trials.subjects),
            "write " + argument("together", False),
        )
    fits = {h.name: fit_population(trials, check=check, **options_of(h)) for h in hypotheses}
    names = [status.name for status in LEFT_OUT]
    bad = {
        name: set(fit.subjects["subject"][fit.subjects["status"].isin(names)].astype(str))
        for name, fit in fits.items()
    }
    left_out = sorted(set().union(*bad.values()))
    kept = [s for s in trials.subjects if str(s) not in left_out]
    for h in hypotheses:  # all of them weigh the same animals
        if len(bad[h.name]) < len(left_out) and kept:
            subset = trials.select(subject=kept)
            fits[h.name] = fit_population(subset, check=check, **options_of(h))
    estimates = [_row(h, "population", fits[h.name], fits[h.name].status) for h in hypotheses]
    evidence = {name: fit.log_evidence if kept else 0.0 for name, fit in fits.items()}
    return AnalysisResult(
        pd.DataFrame(estimates), evidence, tuple(left_out), trials, list(fits.values())
    )


def _row(
    hypothesis: Hypothesis, subject: str, fit: WeberFit | PopulationFit,
    status: FitStatus | PopulationStatus,
) -> dict[str, Any]:  # fmt: skip
    k: Sequence[float] = (np.nan, np.nan, np.nan)
    if not (isinstance(fit, PopulationFit) and fit.population is None):
        k = fit.weber_fraction, *fit.interval(0.95)
    names = "hypothesis", "subject", "weber_fraction", "lower", "upper", "status"
    return dict(zip(names, (hypothesis.name, subject, *k, status.name), strict=True))


@dataclass(frozen=True, eq=False, repr=False)
class Plan(Shown):
    """A planned experiment; everything in it follows from its fields.

    Parameters
    ----------
    scheme : Scheme
        Levels, trials and the number of animals; radial distances in m, or another magnitude.
    hypotheses : sequence of Hypothesis
        As they will be fitted; the first is what is expected.
    goal : Goal
    animals : SubjectPopulation
        What they are expected to be like.
    constraints : Constraints
    trials_per_session, longest_run : int
        See `trial_lists`.
    together : bool
        See `analyse`.
    seed : int
        Of the trial lists.
    title : str
    power : DataFrame, optional
        What was found of the goal at several sizes.

    Raises
    ------
    ValueError
        For a scheme that breaks a constraint or cannot be encoded, and a goal that needs another
        hypothesis.
    """

    _figure: ClassVar[str] = "planned_jnds"
    scheme: Scheme
    hypotheses: Sequence[Hypothesis]
    goal: Goal
    animals: SubjectPopulation = field(default_factory=SubjectPopulation)
    constraints: Constraints = field(default_factory=Constraints)
    trials_per_session: int = 300
    longest_run: int = 5
    together: bool = False
    seed: int = 1
    title: str = ""
    power: pd.DataFrame | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "hypotheses", check_distinct(self.hypotheses))
        for name, kind in (
            ("scheme", Scheme), ("goal", Goal), ("animals", SubjectPopulation),
            ("constraints", Constraints), ("title", str),
        ):  # fmt: skip
            if not isinstance(getattr(self, name), kind):
                raise Refusal(
                    f"{name} must be a {kind.__name__}",
                    checks.shown(getattr(self, name)),
                    "make one first",
                )
        if not self.title:
            object.__setattr__(self, "title", self.magnitude.title)
        for name in ("trials_per_session", "longest_run", "seed"):
            least = {"longest_run": 2, "seed": 0}.get(name, 1)
            whole = checks.whole(name, getattr(self, name), "write 300, say", least=least)
            object.__setattr__(self, name, whole)
        first = self.hypotheses[0]
        check_task(first.task)
        goal_for(self.hypotheses, self.goal)
        if bool(self.scheme.conditions) != isinstance(self.goal, Contrast):
            raise Refusal(
                "Two conditions go with a goal of their own",
                f"conditions {list(self.scheme.conditions)} and {self.goal}",
                "write goal=ww.design.Contrast(ratio=1.3) and conditions=['control', 'drug']",
            )
        if self.together and self.scheme.animals < 2:
            raise Refusal(
                "One animal cannot be fitted together with others", remedy="give two or more"
            )
        if self.together and any(h.priors.is_fixed("weber_fraction") for h in self.hypotheses):
            raise Refusal(
                "A Weber fraction that is given is not learnt from several animals",
                remedy="write " + argument("together", False),
            )
        check_magnitude(self.hypotheses, self.scheme.magnitude)
        self.constraints.check(self.scheme, first.encoding)
        for hypothesis in self.hypotheses:
            hypothesis.model(self.scheme)  # refuses what this one cannot encode

    @property
    def magnitude(self) -> Magnitude:
        """What the stimuli are."""
        return self.scheme.magnitude

    @cached_property
    def trials(self) -> pd.DataFrame:
        """The trial lists of all animals, see `trial_lists`."""
        return trial_lists(
            self.scheme, trials_per_session=self.trials_per_session, longest_run=self.longest_run,
            one_stimulus=self.hypotheses[0].task in ONE_STIMULUS, seed=self.seed,
        )  # fmt: skip

    @property
    def sessions(self) -> int:
        """Sessions of each animal."""
        each = sessions_needed(self.scheme.cells(), self.trials_per_session)[0]
        return each * max(len(self.scheme.conditions), 1)

    @cached_property
    def fingerprint(self) -> str:
        """SHA-256 of the trial lists, as they are written."""
        return sha256_of(with_places(self.trials, self.hypotheses[0].task))

    @cached_property
    def expected_trials(self) -> Trials:
        """What one typical animal answers on average under the first hypothesis, n·P."""
        first, animals = self.hypotheses[0], self.animals
        return first.expected_trials(self.scheme, animals.weber_fraction, animals.lapse)

    @cached_property
    def expected_fits(self) -> tuple[tuple[str, WeberFit], ...]:
        """Every hypothesis fitted to `expected_trials`.

        An "Asimov" data set (Cowan, Cranmer, Gross & Vitells 2011, Eur. Phys. J. C 71:1554, §3.2):
        one fit stands for the typical experiment, and `simulate_study` shows how far they scatter.
        """
        return tuple((h.name, h.fit(self.expected_trials)) for h in self.hypotheses)

    @cached_property
    def levels(self) -> pd.DataFrame:
        """Expected share of "second greater" at every level, and where 95 % of animals fall.

        Columns `standard`, `comparison` (with their unit), `n`, `expected`, `lower`, `upper`
        (binomial).
        """
        frame = self.expected_trials.frame
        n, share = frame["n"].to_numpy(), (frame["count"] / frame["n"]).to_numpy()
        low, high = (binom.ppf(q, n, share) / n for q in (0.025, 0.975))
        named = {"standard": frame["standard"], "comparison": frame["stimulus_2"], "n": n}
        table = pd.DataFrame({**named, "expected": share, "lower": low, "upper": high})
        return self._in_unit(table, "standard", "comparison")

    @cached_property
    def curves(self) -> pd.DataFrame:
        """Expected psychometric functions, by hypothesis.

        Columns `hypothesis`, `standard`, `comparison`, with their unit, `median`, `lower`, `upper`.
        """
        tables = []
        for name, fit in self.expected_fits:
            for standard in fit.standards:
                comparisons = fit.trials.frame.query("standard == @standard")["stimulus_2"]
                low, high = comparisons.min(), comparisons.max()
                margin = 0.1 * (high - low) or 0.05 * standard
                first, last = fit.encoding.domain
                start, end = low - margin, high + margin
                if np.isfinite(first):
                    start = max(start, first + 0.02 * (low - first))
                if np.isfinite(last):
                    end = min(end, last - 0.02 * (last - high))
                curve = fit.psychometric(np.linspace(start, end, 81), float(standard))
                curve.insert(0, "standard", float(standard))
                curve.insert(0, "hypothesis", name)
                tables.append(curve)
        return self._in_unit(pd.concat(tables, ignore_index=True), "standard", "comparison")

    @cached_property
    def jnds(self) -> pd.DataFrame:
        """Expected JND curves with the predicted interval of one animal, by hypothesis.

        Small offsets: a JND is k σ(s)/|μ′(s)| times the factor of the criterion, k r (1 − r/A) for
        a tapered whisker's compliance and k r for a cylinder's, (3.5) and (3.6). Columns
        `hypothesis`, `stimulus`, `jnd`, `lower`, `upper`, with their unit, `criterion`.
        """
        at = self.scheme.cells().stimulus_2
        low, high, edge = at.min(), at.max(), self.hypotheses[0].encoding.domain[1]
        ends = 0.5 * low, high + 0.5 * (min(edge, 2 * high) - high)
        if self.magnitude.is_log or low <= 0:
            ends = low - 0.2 * (high - low), high + 0.2 * (high - low)
        places = np.linspace(*ends, 81)
        tables = {name: self._jnds(fit, "stimulus", places) for name, fit in self.expected_fits}
        return pd.concat(tables, names=["hypothesis"]).reset_index(0).reset_index(drop=True)

    @cached_property
    def jnds_by_standard(self) -> pd.DataFrame:
        """The JND of one animal, from the trials of each standard alone.

        Columns `standard`, `jnd`, `lower`, `upper`, with their unit, `criterion`, `status`.
        """
        tables = []
        for standard in self.expected_trials.standards:
            fit = self.hypotheses[0].fit(self.expected_trials.select(standard=float(standard)))
            jnd = self._jnds(fit, "standard", np.array([float(standard)]))
            tables.append(jnd.assign(status=fit.status.name))
        return pd.concat(tables, ignore_index=True)

    def analyse(self, trials: Trials, *, unit: float = 1.0, check: bool = True) -> AnalysisResult:
        """The planned analysis, of real data or simulated; see `weberwhisk.design.analyse`."""
        check_answers(trials, self.hypotheses[0].task, self.scheme.animals, self.animals)
        self._check_unit(trials, unit)
        if self.scheme.conditions:
            return self._in_conditions(trials, unit, check)
        result = analyse(trials, self.hypotheses, together=self.together, unit=unit, check=check)
        return replace(result, plan=self)

    def _in_conditions(self, trials: Trials, unit: float, check: bool) -> AnalysisResult:
        """Each condition fitted by itself, and the ratio of the Weber fractions."""
        names, first = self.scheme.conditions, self.hypotheses[0]
        given = [str(c) for c in trials.frame.get("condition", pd.Series(dtype=str)).unique()]
        if {*given} != {*names}:
            raise Refusal(
                f"{trials.source}: the plan compares the conditions {' and '.join(names)}",
                checks.listed(given) if given else "no column 'condition'",
                "write in it in which each trial was run",
            )
        by_name = {name: trials.select(condition=name) for name in names}
        analyses = [analyse(one, [first], unit=unit, check=check) for one in by_name.values()]
        tables = [
            part.estimates.assign(condition=name)
            for name, part in zip(names, analyses, strict=True)
        ]  # fmt: skip
        left_out = tuple(sorted({s for part in analyses for s in part.left_out}))
        frame = trials.frame.assign(**{name: trials.frame[name] * unit for name in STIMULI})
        in_unit = replace(trials, frame=frame)
        evidence = {first.name: sum(part.log_evidence[first.name] for part in analyses)}
        ratio = None
        if len(left_out) < max(len(trials.subjects), 1):
            ratio = ratio_of(first, in_unit, names, left_out)
        fits = [fit for part in analyses for fit in part.fits]
        estimates = pd.concat(tables, ignore_index=True)
        return AnalysisResult(estimates, evidence, left_out, in_unit, fits, self, ratio)

    def _line(self) -> str:
        scheme = self.scheme
        return (
            f"{self.title}; standards {self.magnitude.listed(scheme.standards)}; "
            f"{scheme.n_trials} trials each, {self.animals.counted(scheme.animals)}; "
            f"goal: {self.goal}"
        )

    def _table(self) -> pd.DataFrame:
        return self.jnds_by_standard

    def power_in_words(self) -> str:
        """How often the planned size, or the next one looked at, reaches the goal."""
        if self.power is None:
            return ""
        most = max(map(max, self.scheme.trials))
        sizes = self.power[["trials", "animals"]].drop_duplicates()
        inside = (sizes["trials"] <= most) & (sizes["animals"] <= self.scheme.animals)
        if not inside.any():
            return ""
        trials, animals = sizes[inside].sort_values(["animals", "trials"]).iloc[-1]
        compared = len(self.hypotheses) > 1
        one_result = compared or self.together or bool(self.scheme.conditions)
        of_each = not (one_result or animals == 1)
        whose = f" of their {self.animals.subjects}" if of_each else ""
        each = [
            f"{share_in_words(row)}{whose}" + f" if {row['truth']} is true" * compared
            for row in self.power.to_dict("records")
            if row["trials"] == trials and row["animals"] == animals
        ]
        return (
            f"Of simulated experiments with {trials} trials of each comparison and "
            f"{self.animals.counted(animals)}, the aim is reached by {', '.join(each)}."
        )

    def _check_unit(self, trials: Trials, unit: float) -> None:
        """Refuses stimuli that are far from those planned, as in another unit."""
        planned, columns = self.scheme.cells().stimulus_2, map(self.magnitude.column, STIMULI[1:])
        given, words = unit * trials.frame["stimulus_2"].median(), ""
        if self.magnitude.is_log:
            off = float(given - np.median(planned))
            if abs(off) > 3 * np.ptp(planned) + 10 * np.log(8) / (self.magnitude.log_unit or 1.0):
                words = f"{off:+.3g} from those planned"
        elif (middle := np.median(planned)) > 0 and not 1 / 8 < (ratio := given / middle) < 8:
            words = f"{plain_number(float(ratio), 3)} times as large as those planned"
        if words:
            unit_named = f"{self.magnitude.unit}, in " if self.magnitude.unit else ""
            raise Refusal(
                f"{trials.source}: stimuli are {words}",
                remedy=f"check their unit: trial lists have {unit_named}columns called "
                f"{' and '.join(columns)}",
            )

    def _jnds(
        self, fit: WeberFit, name: str, at: Array, criterion: str = "75% 2AFC"
    ) -> pd.DataFrame:
        """JNDs of a fit at some stimuli, with 95 % intervals."""
        sd = difference_sd(fit.encoding, at) / np.sqrt(2.0)
        # A floor is noise of the signal: in the stimulus it goes as the Weber noise does.
        floor: Any = 0.0
        if isinstance(fit.encoding, FlooredNoise):
            floor = fit.encoding.floor * sd / fit.encoding.sd_per_weber_fraction(at)
        ends = dict(zip(("lower", "upper"), fit.interval(0.95), strict=True))
        jnd = {
            name: criterion_factor(criterion) * np.hypot(k * sd, floor)
            for name, k in {"jnd": fit.weber_fraction, **ends}.items()
        }
        table = pd.DataFrame({name: at, **jnd, "criterion": criterion})
        return self._in_unit(table, name, "jnd", "lower", "upper")

    def _in_unit(self, table: pd.DataFrame, *stimuli: str) -> pd.DataFrame:
        """A table in the unit of the trial lists; the names of its columns then say so."""
        written, column = self.magnitude.written, self.magnitude.column
        converted = table.assign(**{name: written(table[name]) for name in stimuli})
        return converted.rename(columns={name: column(name) for name in stimuli})
