"""Many animals at once, learnt from one another: the fit, and what is read off it."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
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
    density_quantiles,
    interval_text,
    methods_text,
    weighted_quantiles,
)
from ..inference.coordinates import in_words
from .bulk import of_fraction
from .estimates import tails
from .fit import WeberFit, fit_weber
from .likelihood import encoding_of, pairs_shown
from .population import Population, integrate_population, trapezoid_shares
from .predictive import FALSE_ALARMS
from .priors import SPREAD, Priors, check_distribution, priors_for
from .report import encoding_in_words, engine_in_words, priors_in_words, sentence
from .trials import Trials, check_trials
from .verdict import FitStatus

__all__ = ["LEFT_OUT", "PopulationFit", "PopulationStatus", "fit_population"]

LEFT_OUT = (FitStatus.NO_TRIALS, FitStatus.REVERSED, FitStatus.ONE_SIDED)


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
    MISFIT = "more animals answer as no observer of this model does than chance explains"
    SPREAD_UNINFORMED = "the animals are too few, or inform too little, to say how they differ"
    DETERMINED = "the data determine the population and how its animals differ"

    @property
    def ok(self) -> bool:
        """Whether the spread is the data's own."""
        return self is PopulationStatus.DETERMINED


@dataclass(frozen=True, eq=False, repr=False)
class PopulationFit(Shown):
    """A population of animals, and each animal given the others.

    `subjects` has a row an animal: `subject`, `n` trials, `weber_fraction` with `lower` and `upper`
    from all the data, `alone`, `alone_lower` and `alone_upper` from its own data, and the `status`
    of that fit. `fits` has each animal's own fit.

    Examples
    --------
    >>> from weberwhisk.behaviour import simulate_population
    >>> fit = fit_population(simulate_population(3, trials_per_level=10, seed=1)[0])
    >>> fit.parameters
    ('weber_fraction', 'spread')
    >>> fit.subjects["subject"].tolist()
    ['s1', 's2', 's3']
    """

    _figure: ClassVar[str] = "population"
    status: PopulationStatus
    subjects: pd.DataFrame = field(repr=False)
    population: Population | None = field(repr=False)
    believed: Priors = field(repr=False)
    spread_prior: Any = field(repr=False)
    notes: tuple[str, ...]
    seed: int
    fits: Mapping[Hashable, WeberFit] = field(default_factory=dict, repr=False)
    parameters: ClassVar[tuple[str, ...]] = ("weber_fraction", "spread")

    @property
    def weber_fraction(self) -> float:
        """Posterior median of the population's median Weber fraction."""
        return float(self.quantile("weber_fraction", 0.5))

    def quantile(self, parameter: str, probability: ArrayLike) -> Array:
        """Posterior quantiles of a parameter of the population."""
        values, mass = self._nodes(parameter)
        if parameter == "spread":  # even nodes, the first at 0: a density, not a lump at 0
            return density_quantiles(values, mass / trapezoid_shares(values.size), probability)
        return weighted_quantiles(values, mass, probability)

    def interval(
        self, mass: float = 0.95, parameter: str = "weber_fraction"
    ) -> tuple[float, float]:
        """Equal-tailed posterior interval of a parameter.

        That of `spread` begins above 0 whatever the animals say, since 2.5 % of it lie below: it
        cannot show that animals differ. `status` says whether they inform of it.
        """
        low, high = self.quantile(parameter, tails(mass))
        return float(low), float(high)

    def summary(self, mass: float = 0.95) -> pd.DataFrame:
        """One row a parameter of the population: mean, sd, median, interval."""
        rows, (first, last) = [], tails(mass)
        for name in self.parameters:
            values, weight = self._nodes(name)
            mean = weight @ values
            sd = np.sqrt(weight @ (values - mean) ** 2)
            rows.append((mean, sd, *self.quantile(name, [0.5, first, last]), mass))
        columns = ["mean", "sd", "median", "lower", "upper", "mass"]
        return pd.DataFrame(rows, pd.Index(self.parameters, name="parameter"), columns)

    def _nodes(self, parameter: str) -> tuple[Array, Array]:
        checks.one_of("parameter", parameter, self.parameters)
        if self.population is None:
            raise Refusal(f"there is no population to speak of: {self.status.value}.")
        return self.population.nodes(parameter)

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
        lines = [sentence(self.status.value)]
        if self.population is not None:
            for name in self.parameters:
                low, high = self.interval(parameter=name)
                middle = float(self.quantile(name, 0.5))
                words = {"weber_fraction": "median Weber fraction"}.get(name, name)
                lines.append(f"Population, {words}: {interval_text(middle, low, high)}.")
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
            used = self.subjects[self.subjects["weber_fraction"].notna()]
            one = next(iter(self.fits.values()))
            said = [
                f"A hierarchical model was fitted to {counted(int(used['n'].sum()), 'trial')} of "
                f"the task {one.trials.task.name}, of {counted(len(used), 'animal')}: ln k is "
                "normal between animals, each learning from the others (partial pooling).",
                encoding_in_words(one.encoding, one.noise),
                priors_in_words(one, f"spread ~ {in_words(self.spread_prior)}"),
                engine_in_words("quadrature"),
                *said,
            ]
        return methods_text(said)

    def to_dict(self) -> dict[str, object]:
        """Everything a reader needs to use the fit, ready for JSON."""
        described = {
            "status": self.status.name,
            "message": self.status.value,
            "notes": self.notes,
            "population": {} if self.population is None else self.summary().to_dict("index"),
            "subjects": self.subjects.to_dict("records"),
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

        Besides the population's parameters there is `subject_weber_fraction`, of each animal that
        is in it, drawn with them. The log-likelihood is that of all choices of an animal given the
        population: `arviz.loo` leaves out an animal at a time.

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
        rng = np.random.default_rng(self.seed)
        sample = self.population.draws(4 * draws, rng)
        log_mean, spread = np.log(sample["weber_fraction"]), sample["spread"]
        likelihood, log_k = self.population.given(log_mean, spread, rng)
        beliefs = {"weber_fraction": self.believed.weber_fraction, "spread": self.spread_prior}
        kept = self.subjects[self.subjects["weber_fraction"].notna()]
        groups: dict[str, dict[str, Array]] = {
            "posterior": sample | {"subject_weber_fraction": np.exp(log_k).T},
            "log_likelihood": {"choices": likelihood.T},
            "prior": {n: p.rvs(4 * draws, random_state=rng) for n, p in beliefs.items()},
            "log_prior": {n: p.logpdf(sample[n]) for n, p in beliefs.items()},
        }
        chains = {
            group: {n: values.reshape(4, draws, *values.shape[1:]) for n, values in named.items()}
            for group, named in groups.items()
        }
        names = ("subject_weber_fraction", "choices", "n")
        unit = next(iter(self.fits.values())).unit or "1"
        return to_arviz(
            chains.pop("posterior"),
            **chains,
            constant_data={"n": kept["n"].to_numpy(np.int64)},
            coords={"subject": kept["subject"].astype(str).to_numpy(str)},
            dims={name: ["subject"] for name in names},
            attrs={"status": self.status.value},
            units={"weber_fraction": unit, "subject_weber_fraction": unit, "spread": "1", "n": "1"},
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
    priors: Any = None,
    spread_prior: Any = None,
    check: bool = True,
    seed: int = 1,
) -> PopulationFit:
    """Fit many animals at once: each learns from the others (partial pooling).

    ln k of the animals is normal about the population's; `weber_fraction` is its median, `spread`
    its standard deviation. Each animal has lapses and biases of its own, with the priors of a
    single fit. Everything is integrated, nothing sampled.

    Parameters
    ----------
    trials : Trials
        With a column `subject`.
    encoding, observer, bias, noise, priors
        As for `fit_weber`, the same for all animals; the prior of the population's median is that
        of the Weber fraction. `{"weber_fraction": "levels"}` lays it about the geometric mean of
        what each animal's easiest pair says.
    spread_prior : frozen SciPy distribution, optional
        Of the sd of ln k between animals: by default half-normal of 0.5. Two animals of a spread of
        0.5 differ by a factor of 1.8.
    check : bool
        Whether each animal's fit is checked for what the model does not hold, which takes some ten
        times as long as the fit; without it no status is a misfit.
    seed : int
        Of draws only.

    Returns
    -------
    PopulationFit
        Always read its `status`, and those of its `subjects`.

    Raises
    ------
    ValueError
        Where the table has no subjects.

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
    prior = SPREAD if spread_prior is None else spread_prior
    check_distribution("spread", prior)
    if (low := float(prior.support()[0])) < 0:
        raise Refusal(
            "the prior of spread must not reach below zero",
            f"support from {low:g}",
            "give for example scipy.stats.halfnorm(scale=0.5)",
        )
    checks.generator(seed)
    if "subject" not in trials.frame:
        raise Refusal(
            f"{trials.source}: there is no column 'subject' that names the subjects",
            remedy="map one with "
            + argument("columns", {"subject": "<its name>"})
            + " when the table is read",
        )
    parts = {subject: trials.select(subject=subject) for subject in trials.subjects}
    encoded = encoding_of(trials, encoding, observer, noise)
    # Of use to "levels" alone.
    shown = (pairs_shown(part.cells(), encoded, noise) for part in parts.values())
    believed = priors_for(priors, trials.cells(), trials.unit_known, trials.task, shown=shown)
    if believed.is_fixed("weber_fraction"):
        raise Refusal(
            "the Weber fraction of every animal was fixed, and a population learns them",
            remedy="leave it out of priors, or fix the lapses alone",
        )
    options = {"encoding": encoding, "observer": observer, "bias": bias, "noise": noise}
    fits = {
        subject: fit_weber(part, priors=believed, method="quadrature", seed=seed, **options)
        for subject, part in parts.items()
        if part.n_trials
    }
    alone = pd.DataFrame([_row(subject, fits.get(subject), check) for subject in parts])
    left_out = alone["status"].isin([status.name for status in LEFT_OUT])
    notes = trials.notes + tuple(
        f"{subject} stays out: {FitStatus[status].message}."
        for subject, status in alone.loc[left_out, ["subject", "status"]].itertuples(index=False)
    )
    misfits = alone["status"].str.startswith("MISFIT")
    if misfits.any():
        named = ", ".join(f"{row.subject} ({row.status})" for row in alone[misfits].itertuples())
        notes += (f"The model does not hold for {named}: see report() of their fits.",)
    shared = believed, prior, notes, seed, fits
    if left_out.all():
        return PopulationFit(PopulationStatus.NO_TRIALS, alone, None, *shared)
    kept = alone[~left_out]
    each = (fits[subject] for subject in kept["subject"])
    likelihoods = [of_fraction(fit.model.merged(), fit.weber_fraction) for fit in each]
    weber = believed.weber_fraction
    population = integrate_population(likelihoods, lambda x: weber.logpdf(np.exp(x)) + x, prior)
    p = [0.5, 0.025, 0.975]
    quantiles = [
        np.exp(weighted_quantiles(population.log_k, mass, p)) for mass in population.animals
    ]
    table = alone.join(pd.DataFrame(quantiles, kept.index, ["weber_fraction", "lower", "upper"]))
    status = _status(population, prior, len(kept))
    by_chance = bdtrc(misfits.sum() - 1, len(alone), FALSE_ALARMS) > FALSE_ALARMS
    if status is not PopulationStatus.NOT_CONVERGED and not by_chance:
        status = PopulationStatus.MISFIT
    return PopulationFit(status, table, population, *shared)


def _row(subject: Hashable, fit: WeberFit | None, check: bool) -> dict[str, Any]:
    low, middle, high = (
        fit.posterior.quantile("weber_fraction", [0.025, 0.5, 0.975]) if fit else [np.nan] * 3
    )
    return {
        "subject": subject,
        "n": fit.trials.n_trials if fit else 0,
        "alone": float(middle),
        "alone_lower": float(low),
        "alone_upper": float(high),
        "status": (
            (fit.unweighed if check else fit.unchecked) if fit else FitStatus.NO_TRIALS
        ).name,
    }


def _status(
    population: Population, prior: Any, animals: int, of_prior: float = 0.8
) -> PopulationStatus:
    """The spread is uninformed where its sd is more than that share of the prior's."""
    if population.error > 0.02:
        return PopulationStatus.NOT_CONVERGED
    if animals == 1:
        return PopulationStatus.ONE_ANIMAL
    values, mass = population.nodes("spread")
    sd = np.sqrt(mass @ (values - mass @ values) ** 2)
    if sd > of_prior * float(prior.std()):
        return PopulationStatus.SPREAD_UNINFORMED
    return PopulationStatus.DETERMINED
