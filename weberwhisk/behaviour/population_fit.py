"""Many animals at once, learnt from one another: the fit, and what is read off it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, ClassVar

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.special import bdtrc

from .._util import checks
from .._util.campaign import one_blas_thread
from .._util.output import plain, to_json
from .._util.refusals import Advice, Refusal, argument
from .._util.sampling import ArvizData, to_arviz
from .._util.values import (
    Array,
    Shown,
    counted,
    interval_text,
    methods_text,
    weighted_quantiles,
)
from ..inference.coordinates import in_words
from .alone import DIRECTIONS, LEFT_OUT, AnimalFits, fitted_alone
from .effects import Effect, check_effects
from .estimates import tails
from .formula import expanded
from .pooled import EDGES, pooled_checks, pooled_residuals
from .population import Population
from .population_model import PopulationModel, search_causes
from .population_priors import DECIDES, belief_sensitivity, belief_sentence
from .predictive import FALSE_ALARMS
from .priors import Priors, check_distribution
from .report import encoding_in_words, engine_in_words, priors_in_words, sentence
from .trials import Trials, check_trials
from .verdict import FitStatus

__all__ = ["PopulationFit", "PopulationStatus", "fit_population"]


class PopulationStatus(Enum):
    """What the animals together determine, worst first.

    Examples
    --------
    >>> PopulationStatus.ONE_ANIMAL.ok, PopulationStatus.ONE_ANIMAL.value
    (False, "there is one animal: the spread between animals is the prior's")
    """

    NO_TRIALS = "no animal has trials that can be used"
    NOT_CONVERGED = "the posterior was not computed to the accuracy requested"
    ONE_ANIMAL = "there is one animal: the spread between animals is the prior's"
    MISFIT = "the animals together answer as no observers of this model do"
    PRIOR_DEPENDENT = (
        "the population's median depends on what is believed beforehand: the answers alone do not "
        "determine it"
    )
    SPREAD_UNINFORMED = "the animals are too few, or inform too little, to say how they differ"
    DETERMINED = "the data determine the population and how its animals differ"

    @property
    def ok(self) -> bool:
        """Whether the spread is the data's own."""
        return self is PopulationStatus.DETERMINED

    @property
    def is_misfit(self) -> bool:
        """Whether the model does not hold."""
        return self is PopulationStatus.MISFIT


@dataclass(frozen=True, eq=False, repr=False)
class PopulationFit(Shown):
    """A population of animals, and each animal given the others.

    `parameters` are the population's: the median of each parameter of an animal (`weber_fraction`,
    the lapses, the bias, effects), and its sd between animals on the scale where it is normal:
    `spread` that of ln k, `lapse_spread` of the logits of lapses, `bias_spread` in sds of the
    difference. `subjects` has a row an animal: `subject`, `n` trials, `weber_fraction` with `lower`
    and `upper` from all the data, `alone`, `alone_lower` and `alone_upper` from its own data, the
    `status` of that fit, and each further parameter from all the data, `bias` with `bias_lower` and
    `bias_upper`, say. `fits` has each animal's own fit, made when it is asked for.

    `checked` are residuals of all animals together, a row a check; where they, or more animals by
    themselves than chance explains, show a misfit, `causes` has what was tried for it, the best
    first: `log_evidence`, `log_bayes_factor` over this fit, the population's `weber_fraction` with
    `lower` and `upper`, and `change`, how far its median moves in sds; `headline` says it. A
    misfit that moves the median by less than its sd is no status, unless Weber's law fails.
    `prior_sensitivity` says how far each belief, counted twice or half, moves the median.

    Examples
    --------
    >>> from weberwhisk.behaviour import simulate_population
    >>> fit = fit_population(simulate_population(3, trials_per_level=10, seed=1)[0])
    >>> fit.parameters
    ('weber_fraction', 'spread', 'lapse_low', 'lapse_high', 'lapse_spread', 'bias', 'bias_spread')
    >>> fit.subjects["subject"].tolist()
    ['s1', 's2', 's3']
    """

    _figure: ClassVar[str] = "population"
    status: PopulationStatus
    subjects: pd.DataFrame = field(repr=False)
    population: Population | None = field(repr=False)
    believed: Priors = field(repr=False)
    notes: tuple[str, ...]
    seed: int
    fits: AnimalFits = field(repr=False)
    checked: pd.DataFrame = field(default_factory=pd.DataFrame, repr=False)
    causes: pd.DataFrame = field(default_factory=pd.DataFrame, repr=False)
    prior_sensitivity: pd.DataFrame = field(default_factory=pd.DataFrame, repr=False)
    headline: str = ""
    model: PopulationModel | None = field(default=None, repr=False)

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the parameters of the population; none without one."""
        return () if self.population is None else self.population.hierarchy.parameters

    @property
    def weber_fraction(self) -> float:
        """Posterior median of the population's median Weber fraction."""
        return float(self.quantile("weber_fraction", 0.5))

    def quantile(self, parameter: str, probability: ArrayLike) -> Array:
        """Posterior quantiles of a parameter of the population."""
        return self._with(parameter).quantile(parameter, probability)

    def interval(
        self, mass: float = 0.95, parameter: str = "weber_fraction"
    ) -> tuple[float, float]:
        """Equal-tailed posterior interval of a parameter.

        That of a spread begins above 0 whatever the animals say, since 2.5 % of it lie below: it
        cannot show that animals differ. `status` says whether they inform of that of ln k.
        """
        low, high = self.quantile(parameter, tails(mass))
        return float(low), float(high)

    def summary(self, mass: float = 0.95) -> pd.DataFrame:
        """One row a parameter of the population: mean, sd, median, interval, prior."""
        population = self._existing()
        hierarchy = population.hierarchy
        rows, (first, last) = [], tails(mass)
        for name in self.parameters:
            mean, sd = population.mean(name), population.sd(name)
            prior = hierarchy.prior_in_words(name)
            rows.append((mean, sd, *self.quantile(name, [0.5, first, last]), mass, prior))
        columns = ["mean", "sd", "median", "lower", "upper", "mass", "prior"]
        return pd.DataFrame(rows, pd.Index(self.parameters, name="parameter"), columns)

    def _existing(self) -> Population:
        if self.population is None:
            raise Refusal(f"there is no population to speak of: {self.status.value}.")
        return self.population

    def _with(self, parameter: str) -> Population:
        """The population, which has such a parameter."""
        population = self._existing()
        checks.one_of("parameter", parameter, self.parameters)
        return population

    @property
    def log_evidence(self) -> float:
        """Natural log of the probability of all the answers; -inf without a population."""
        return -np.inf if self.population is None else self.population.log_evidence

    def _line(self) -> str:
        animals = counted(len(self.subjects), "animal")
        if self.population is None:
            return f"{animals}; {self.status.name}"
        k = interval_text(self.weber_fraction, *self.interval())
        spread = float(self.quantile("spread", 0.5))
        return f"median k = {k}, spread of ln k {spread:.2g}; {animals}; {self.status.name}"

    def _table(self) -> pd.DataFrame:
        return self.subjects

    def report(self) -> str:
        """What the animals say together, and each of them, in words."""
        lines = [sentence(self.status.value), *([self.headline] if self.headline else [])]
        for name in self.parameters:
            low, high = self.interval(parameter=name)
            middle = float(self.quantile(name, 0.5))
            words = {"weber_fraction": "median Weber fraction", "spread": "spread of ln k"}
            lines.append(
                f"Population, {words.get(name, name)}: {interval_text(middle, low, high)}."
            )
        for row in self.subjects.to_dict("records"):
            k = "left out"
            if row["weber_fraction"] == row["weber_fraction"]:
                k = f"k = {interval_text(row['weber_fraction'], row['lower'], row['upper'])}"
                alone = interval_text(row["alone"], row["alone_lower"], row["alone_upper"])
                k += f"; from its own trials alone {alone}"
            lines.append(f"{row['subject']}: {counted(row['n'], 'trial')}; {k}; {row['status']}.")
        return Advice.joined("\n", [*lines, *self.notes]) + "\n"

    def methods(self) -> str:
        """What was done, as a methods section says it: one paragraph without line breaks."""
        said = [*self.notes, f"The fit's status: {self.status.name}."]
        if self.population is not None:
            hierarchy = self.population.hierarchy
            used = self.subjects[self.subjects["weber_fraction"].notna()]
            one = next(iter(self.fits.values()))
            spreads = [
                f"{name} ~ {in_words(prior)}"
                for name, prior in zip(hierarchy.spread_names, hierarchy.spread_priors, strict=True)
            ]
            if self.headline:
                said = [self.headline, *said]
            said = [
                f"A hierarchical model was fitted to {counted(int(used['n'].sum()), 'trial')} of "
                f"the task {one.trials.task.name}, of {counted(len(used), 'animal')}: "
                f"{hierarchy.in_words}, each animal learning from the others (partial pooling).",
                encoding_in_words(one.encoding, one.noise),
                *([f"The model also has these effects: {', '.join(one.effects)}."]
                  if one.effects else []),
                priors_in_words(one, *spreads),
                "They are of the population's medians and of the sds between animals.",
                engine_in_words("importance"),
                *said,
            ]  # fmt: skip
        return methods_text(said)

    def to_dict(self) -> dict[str, object]:
        """Everything a reader needs to use the fit, ready for JSON."""
        described = {
            "status": self.status.name,
            "message": self.status.value,
            "headline": self.headline,
            "notes": self.notes,
            "population": {} if self.population is None else self.summary().to_dict("index"),
            "subjects": self.subjects.to_dict("records"),
            "checks": self.checked.to_dict("index"),
            "causes": self.causes.to_dict("index"),
            "prior_sensitivity": self.prior_sensitivity.to_dict("index"),
            "log_evidence": self.log_evidence,
            "error": None if self.population is None else self.population.error,
            "seed": self.seed,
        }
        return dict(plain(described))

    def to_json(self) -> str:
        """`to_dict()` as JSON."""
        return to_json(self.to_dict(), escaped=True)

    def to_arviz(self, draws: int = 1000) -> ArvizData:
        """ArviZ data (0.23 or 1.x) of independent draws, in four chains of `draws`.

        Besides the population's parameters there are `subject_weber_fraction` and every other
        parameter of each animal that is in it, drawn with them. The log-likelihood is that of all
        choices of an animal given the population: `arviz.loo` leaves out an animal at a time.

        Raises
        ------
        ValueError
            Where no animal has trials that can be used, and for less than one draw.

        Examples
        --------
        >>> from weberwhisk.behaviour import simulate_population
        >>> fit = fit_population(simulate_population(3, trials_per_level=10, seed=1)[0])
        >>> fit.to_arviz(draws=10)["posterior"]["subject_weber_fraction"].shape
        (4, 10, 3)
        """
        checks.whole("draws", draws, "write 1000, say")
        if self.population is None:
            raise Refusal(f"there is no population to draw from: {self.status.value}.")
        hierarchy, rng = self.population.hierarchy, np.random.default_rng(self.seed)
        scores = self.population.draws.resampled(4 * draws, rng)
        likelihood, of_animals = self.population.given(scores, rng)
        sample = hierarchy.values(scores)
        kept = self.subjects[self.subjects["weber_fraction"].notna()]
        by_subject = {f"subject_{name}": values.T for name, values in of_animals.items()}
        groups: dict[str, dict[str, Array]] = {
            "posterior": sample | by_subject,
            "log_likelihood": {"choices": likelihood.T},
            "prior": hierarchy.values(hierarchy.drawn(4 * draws, rng)),
            "log_prior": hierarchy.log_densities(sample),
        }
        chains = {
            group: {n: values.reshape(4, draws, *values.shape[1:]) for n, values in named.items()}
            for group, named in groups.items()
        }
        unit = next(iter(self.fits.values())).unit or "1"
        return to_arviz(
            chains.pop("posterior"),
            **chains,
            constant_data={"n": kept["n"].to_numpy(np.int64)},
            coords={"subject": kept["subject"].astype(str).to_numpy(str)},
            dims={name: ["subject"] for name in (*by_subject, "choices", "n")},
            attrs={"status": self.status.value},
            units=dict.fromkeys([*sample, *by_subject, "n"], "1")
            | {"weber_fraction": unit, "subject_weber_fraction": unit},
            comments={
                "log_likelihood": "A value is of all choices of an animal given the population, "
                "its own parameters integrated out: LOO of it leaves out an animal."
            },
        )


@one_blas_thread
def fit_population(
    trials: Trials,
    *,
    encoding: Any = None,
    observer: Any = None,
    bias: str | None = None,
    noise: str = "weber",
    effects: Sequence[Effect | str] = (),
    priors: Any = None,
    spread_prior: Any = None,
    check: bool = True,
    seed: int = 1,
    workers: int = 1,
    scheduler: str | None = None,
    progress: Callable[[float], None] | None = None,
) -> PopulationFit:
    """Fit many animals at once: each learns from the others (partial pooling).

    Every parameter of the animals is normal about the population's: ln k, the logits of the lapses
    (with the correlation of their prior), the bias, and each effect, its logarithm where it cannot
    be negative. `weber_fraction` is the median of the population, `spread` the standard deviation
    of ln k, and so for the others. All of it is integrated by weighted draws
    (`behaviour/population.py`), as the log evidence is.

    Parameters
    ----------
    trials : Trials
        With a column `subject`.
    encoding, observer, bias, noise, effects
        As for `fit_weber`, the same for all animals.
    priors : Priors or mapping, optional
        As for `fit_weber`: of the medians of the population. What is a number is that of every
        animal. `{"weber_fraction": "levels"}` lays the prior of k about the geometric mean of what
        each animal's easiest pair says.
    spread_prior : frozen SciPy distribution, or mapping, optional
        Of the sd of ln k between animals: by default half-normal of 0.5. Two animals of a spread of
        0.5 differ by a factor of 1.8. By name for other spreads too,
        `{"bias_spread": scipy.stats.halfnorm(scale=1)}`; by default each is half-normal of half the
        sd that the parameter's prior has on its scale.
    check : bool
        Whether each animal's fit is checked for what the model does not hold, which takes several
        times as long as the fit; without it no status is a misfit.
    seed : int
        Of draws only.
    workers, scheduler, progress
        As for `weberwhisk.power`, for the fits of animals by themselves and their checks.

    Returns
    -------
    PopulationFit
        Always read its `status`, and those of its `subjects`.

    Raises
    ------
    ValueError
        Where the table has no subjects.

    Notes
    -----
    Two to sixteen animals of 5 to 20 trials each, whose biases are wide, leave a long tail of small
    Weber fractions, since a large bias explains the same answers. Draws do not reach its end: the
    lower end of the median's interval was 0.1 to 1.6 posterior sds too high in ten such populations
    beside brute force, the middle and the upper end right to 0.2. All ten are PRIOR_DEPENDENT.

    Examples
    --------
    >>> from weberwhisk.behaviour import simulate_population
    >>> trials, truth = simulate_population(4, weber_fraction=0.1, seed=1)
    >>> fit = fit_population(trials, bias="none")
    >>> low, high = fit.interval(0.95)
    >>> low < 0.1 < high
    True
    >>> bool((fit.subjects["upper"] - fit.subjects["lower"] < 0.2).all())
    True
    """
    check_trials(trials)
    check_effects(effects)
    effects = expanded(effects, trials)  # formulas are read by the rows of all animals
    spreads = _spreads(spread_prior)
    checks.generator(seed)
    if "subject" not in trials.frame:
        raise Refusal(
            f"{trials.source}: there is no column 'subject' that names the subjects",
            remedy="map one with "
            + argument("columns", {"subject": "<its name>"})
            + " when the table is read",
        )
    model = PopulationModel(trials, encoding, observer, bias, noise, effects, priors, spreads, seed)
    fits = model.fits()
    believed: Priors = fits.options["priors"]
    if believed.is_fixed("weber_fraction"):
        raise Refusal(
            "the Weber fraction of every animal was fixed, and a population learns them",
            remedy="leave it out of priors, or fix the lapses alone",
        )
    how: Any = {"workers": workers, "scheduler": scheduler, "progress": progress}
    alone = fitted_alone(fits, check, **how) if fits else None
    table = _subjects(trials, fits, alone)
    left_out = table["status"].isin([status.name for status in LEFT_OUT])
    notes = trials.notes + tuple(
        f"{subject} stays out: {FitStatus[status].message}."
        for subject, status in table.loc[left_out, ["subject", "status"]].itertuples(index=False)
    )
    if left_out.all():
        status = PopulationStatus.NO_TRIALS
        return PopulationFit(status, table, None, believed, notes, seed, fits, model=model)
    kept = table.loc[~left_out, "subject"]
    population = model.integrated(fits, list(kept))
    for name in spreads:
        checks.one_of("the spread that has a prior", name, population.hierarchy.spread_names)
    table = table.join(_given_all(population, kept.index))
    sensitivity = belief_sensitivity(population)
    done: dict[str, Any] = {"prior_sensitivity": sensitivity, "model": model}
    status, more = _verdict(population, sensitivity)
    notes += more
    if check and status is not PopulationStatus.NOT_CONVERGED:
        assert alone is not None
        residuals = pooled_residuals(fits, population, list(kept))
        done["checked"] = pooled_checks(residuals, alone.loc[list(kept)])
        misfits = _misfits(table, done["checked"])
        if misfits:
            found = search_causes(model, fits, list(kept), population, misfits, **how)
            done["causes"] = found.table
            done["headline"] = found.sentence
            notes += tuple(_seen(table, residuals, done["checked"]))
            if (found.matters or not found.chosen) and len(kept) > 1:
                status = PopulationStatus.MISFIT
    return PopulationFit(status, table, population, believed, notes, seed, fits, **done)


def _spreads(given: Any) -> dict[str, Any]:
    """Priors of spreads by name, checked."""
    named = dict(given) if isinstance(given, Mapping) else {"spread": given}
    named = {name: prior for name, prior in named.items() if prior is not None}
    for name, prior in named.items():
        check_distribution(name, prior)
        if (low := float(prior.support()[0])) < 0:
            raise Refusal(
                f"the prior of {name} must not reach below zero",
                f"support from {low:g}",
                "give for example scipy.stats.halfnorm(scale=0.5)",
            )
    return named


def _subjects(trials: Trials, fits: AnimalFits, alone: pd.DataFrame | None) -> pd.DataFrame:
    """A row an animal, of all subjects of the table."""
    nothing = {"n": 0, "alone": np.nan, "alone_lower": np.nan, "alone_upper": np.nan,
               "status": FitStatus.NO_TRIALS.name}  # fmt: skip
    kept = [] if alone is None else alone.drop(columns=[*DIRECTIONS]).to_dict("records")
    by_subject = dict(zip(fits.trials, kept, strict=False))
    rows = [{"subject": subject} | by_subject.get(subject, nothing) for subject in trials.subjects]
    return pd.DataFrame(rows)


def _verdict(
    population: Population, sensitivity: pd.DataFrame, of_prior: float = 0.8
) -> tuple[PopulationStatus, tuple[str, ...]]:
    """The status before checks; the spread is uninformed where its sd is more than that share of
    the prior's."""
    if why := population.trouble:
        return PopulationStatus.NOT_CONVERGED, (f"{why[0].upper()}{why[1:]}.",)
    if len(population.animals) == 1:
        return PopulationStatus.ONE_ANIMAL, ()
    deciding = sensitivity[sensitivity["sds"] > DECIDES].sort_values("sds", ascending=False)
    if len(deciding):
        said = tuple(belief_sentence(str(name), row) for name, row in deciding.iterrows())
        return PopulationStatus.PRIOR_DEPENDENT, said
    hierarchy = population.hierarchy
    prior = hierarchy.spread_priors[hierarchy.spread_names.index("spread")]
    if population.sd("spread") > of_prior * float(prior.std()):
        return PopulationStatus.SPREAD_UNINFORMED, ()
    return PopulationStatus.DETERMINED, ()


def _misfits(table: pd.DataFrame, checked: pd.DataFrame) -> list[FitStatus]:
    """Misfits of more animals than chance explains, and that of the curve where residuals of all
    together show one."""
    out = []
    seen = table["status"][table["status"].str.startswith("MISFIT")]
    if bdtrc(len(seen) - 1, len(table), FALSE_ALARMS) <= FALSE_ALARMS:
        out = [FitStatus[name] for name in dict.fromkeys(seen)]
    fired = checked.index[checked["fired"]]
    if len(fired.difference(["drift"])):
        out.append(FitStatus.MISFIT_CURVE)
    if "drift" in fired:
        out.append(FitStatus.MISFIT_DRIFT)
    return list(dict.fromkeys(out))


def _seen(
    table: pd.DataFrame, residuals: Mapping[str, pd.DataFrame], checked: pd.DataFrame
) -> list[str]:
    """Sentences on what checks have seen of the animals together, and of which animals."""
    said = []
    for name, row in checked[checked["fired"]].iterrows():
        if name in residuals:
            worst = residuals[str(name)].sort_values("z", key=np.abs).iloc[-1]
            said.append(
                f"Over all animals the answers miss the model by {WORDS[str(name)]} (p = "
                f"{row['p']:.2g}), most {_group(str(name), worst)}: {worst['observed']:.2f} seen, "
                f"{worst['expected']:.2f} expected of {worst['n']:.0f} trials."
            )
        else:
            said.append(
                f"Over all animals the answers go along what the effect {name} would change, by "
                f"{row['observed']:.1f} sds (p = {row['p']:.2g})."
            )
    misfits = table[table["status"].str.startswith("MISFIT")]
    if len(misfits):
        named = ", ".join(f"{row.subject} ({row.status})" for row in misfits.itertuples())
        said.append(f"The model does not hold for {named}: see report() of their fits.")
    return said


#: Checks by residuals of all animals, in words.
WORDS = {"standards": "standard", "levels": "the difference of the signals",
         "order": "the interval that held the standard"}  # fmt: skip


def _group(check: str, row: pd.Series) -> str:
    """A group of residuals in words."""
    if check == "levels":
        edges = [-np.inf, *EDGES, np.inf]
        at_level: Any = row.name
        low, high = edges[int(at_level)], edges[int(at_level) + 1]
        return f"between {low:g} and {high:g} sds"
    both: Any = row.name
    first, side = both
    at = f"at {first:.4g}" if check == "standards" else f"with it {'second' if first else 'first'}"
    words = {1: "the second stimulus greater", 0: "equal stimuli", -1: "the first one greater"}
    return f"{at} with {words[int(side)]}"


def _given_all(population: Population, index: pd.Index) -> pd.DataFrame:
    """Median and 95 % interval of every parameter of each animal, given all answers."""
    rows = []
    for number in range(len(population.animals)):
        row: dict[str, float] = {}
        weights = population.animal_weights(number)
        for name, values in population.animal_values(number).items():
            middle, low, high = weighted_quantiles(values, weights, [0.5, 0.025, 0.975])
            before = "" if name == "weber_fraction" else f"{name}_"
            row |= {name: middle, f"{before}lower": low, f"{before}upper": high}
        rows.append(row)
    names = [f for n in population.hierarchy.names
             for b in ["" if n == "weber_fraction" else f"{n}_"]
             for f in (n, f"{b}lower", f"{b}upper")]  # fmt: skip
    return pd.DataFrame(rows, index, names)
