"""Weber fractions of many animals, learnt from one another: the fit, and what is read off it."""

from __future__ import annotations

import json
from collections.abc import Hashable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from .. import _checks
from .._values import Array, Shown, interval_text, renamed_arguments
from ..inference.arviz_io import ArvizData, to_arviz
from ..output import plain
from ..threads import one_blas_thread
from . import report
from .axes import likely_scales
from .fit import WeberFit, fit_weber, tails
from .hierarchy import NAMES, Members, Population, integrate_population
from .integrate.batch import tabulate
from .likelihood import encoding_of, pairs_shown
from .priors import PopulationPriors, Priors, priors_for
from .trials import Trials, check_trials
from .verdict import FitStatus

LEFT_OUT = (FitStatus.NO_TRIALS, FitStatus.REVERSED, FitStatus.ONE_SIDED)


class PopulationStatus(Enum):
    """What the animals together could tell, worst first.

    Examples
    --------
    >>> PopulationStatus.ONE_ANIMAL.ok, PopulationStatus.ONE_ANIMAL.value
    (False, "there is one animal: the spread between animals is the prior's")
    """

    NO_TRIALS = "no animal has trials that can be used"
    NOT_CONVERGED = "the posterior was not computed to the accuracy requested"
    ONE_ANIMAL = "there is one animal: the spread between animals is the prior's"
    SPREAD_UNINFORMED = "the animals are too few, or tell too little, to say how they differ"
    DETERMINED = "the data determine the population and how its animals differ"

    @property
    def ok(self) -> bool:
        """Whether the spread is the data's own."""
        return self is PopulationStatus.DETERMINED


@dataclass(frozen=True, eq=False, repr=False)
class PopulationFit(Shown):
    """A population of animals, and each of them in its light.

    `subjects` has a row an animal: `subject`, `n` trials, `weber_fraction` with `lower` and `upper`
    given all the data, `alone`, `alone_lower` and `alone_upper` from its own, and the `status` of
    the latter. `sessions` is the same by session, None unless sessions were distinguished. `fits`
    has each one's own fit by its labels.

    Examples
    --------
    >>> from weberwhisk.behaviour import simulate_population
    >>> fit = fit_population(simulate_population(3, trials_per_level=10, seed=1)[0])
    >>> fit.parameters
    ('weber_fraction', 'spread', 'bias_scale', 'mean_lapse_low', 'mean_lapse_high')
    >>> fit.subjects["subject"].tolist(), fit.sessions is None
    (['s1', 's2', 's3'], True)
    """

    _figure: ClassVar[str] = "population"
    status: PopulationStatus
    subjects: pd.DataFrame = field(repr=False)
    sessions: pd.DataFrame | None = field(repr=False)
    population: Population | None = field(repr=False)
    believed: Priors = field(repr=False)
    priors: PopulationPriors = field(repr=False)
    lapses: tuple[str, ...] = field(repr=False)
    notes: tuple[str, ...]
    seed: int
    fits: Mapping[tuple[Hashable, ...], WeberFit] = field(default_factory=dict, repr=False)

    @property
    def weber_fraction(self) -> float:
        """Posterior median of the population's median Weber fraction."""
        return float(self.quantile("weber_fraction", 0.5))

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the population's parameters.

        `weber_fraction` is its median, `spread` and `session_spread` are standard deviations of
        ln k, `bias_scale` the factor by which biases are wider than their prior in a single fit,
        `mean_lapse_low` and `mean_lapse_high` averages over the animals.
        """
        spreads = ("spread",) if self.sessions is None else ("spread", "session_spread")
        biases = ("bias_scale",) if self._has_biases else ()
        return ("weber_fraction", *spreads, *biases, *(f"mean_{name}" for name in self.lapses))

    @property
    def _has_biases(self) -> bool:
        return self.population is not None and self.population.values["bias_scale"].size > 1

    def quantile(self, parameter: str, probability: ArrayLike) -> Array:
        """Posterior quantiles of a parameter of the population."""
        return _quantile(*self._nodes(parameter), probability)

    def interval(
        self, mass: float = 0.95, parameter: str = "weber_fraction"
    ) -> tuple[float, float]:
        """Equal-tailed posterior interval."""
        low, high = self.quantile(parameter, tails(mass))
        return float(low), float(high)

    def summary(self, mass: float = 0.95) -> pd.DataFrame:
        """One row a parameter of the population: mean, sd, median, interval."""
        rows, (first, last) = [], tails(mass)
        for name in self.parameters:
            values, weight = self._nodes(name)
            mean = weight @ values
            sd = np.sqrt(weight @ (values - mean) ** 2)
            rows.append((mean, sd, *_quantile(values, weight, [0.5, first, last]), mass))
        columns = ["mean", "sd", "median", "lower", "upper", "mass"]
        return pd.DataFrame(rows, pd.Index(self.parameters, name="parameter"), columns)

    def _nodes(self, parameter: str) -> tuple[Array, Array]:
        _checks.one_of("parameter", parameter, self.parameters)
        if parameter not in self._known:
            self._known[parameter] = self._interpolated(parameter)
        return self._known[parameter]

    @cached_property
    def _known(self) -> dict[str, tuple[Array, Array]]:
        """Nodes by parameter: report, table, JSON and figure ask for the same ones."""
        return {}

    def _interpolated(self, parameter: str) -> tuple[Array, Array]:
        if self.population is None:
            raise ValueError(f"there is no population to speak of: {self.status.value}.")
        if parameter.startswith("mean_"):
            (mean, spread), mass = self.population.nodes("lapse_mean", "lapse_spread")
            z = np.linspace(-5, 5, 81)
            share = np.exp(-0.5 * z**2) / np.exp(-0.5 * z**2).sum()
            scores = np.clip(mean[:, None] + spread[:, None] * z, -8.0, 8.0)
            return self.believed.value(parameter.removeprefix("mean_"), scores) @ share, mass
        if parameter == "weber_fraction":
            (log_k,), mass = self.population.nodes(NAMES[0])
            return np.exp(log_k), mass
        (values,), mass = self.population.nodes(parameter)
        return values, mass

    @property
    def log_evidence(self) -> float:
        """Natural log of the probability of all the answers; -inf without a population."""
        return -np.inf if self.population is None else self.population.log_evidence

    def _line(self) -> str:
        animals = f"{len(self.subjects)} animals"
        if self.population is None:
            return f"{animals}; {self.status.name}"
        k = interval_text(self.weber_fraction, *self.interval())
        spread = float(self.quantile("spread", 0.5))
        return f"median k = {k}, spread of ln k {spread:.2g}; {animals}; {self.status.name}"

    def _table(self) -> pd.DataFrame:
        return self.subjects

    def report(self) -> str:
        """What the animals say together, and each of them, in words."""
        return report.population_report(self)

    def to_dict(self) -> dict[str, object]:
        """Everything a reader needs to use the fit, ready for JSON."""
        none, sessions = self.population is None, self.sessions
        described = {
            "status": self.status.name,
            "message": self.status.value,
            "notes": self.notes,
            "population": {} if none else self.summary().to_dict(orient="index"),
            "subjects": self.subjects.to_dict("records"),
            "sessions": None if sessions is None else sessions.to_dict("records"),
            "log_evidence": self.log_evidence,
            "error": None if self.population is None else self.population.error,
            "seed": self.seed,
        }
        return dict(plain(described))

    def to_json(self) -> str:
        """`to_dict()` as JSON."""
        return json.dumps(self.to_dict(), indent=2, allow_nan=False)

    def to_arviz(self, draws: int = 1000) -> ArvizData:
        """Independent draws of the population's parameters, in four chains, for ArviZ."""
        if self.population is None:
            raise ValueError(f"there is no population to draw from: {self.status.value}.")
        sample = self.population.draws(4 * draws, self.seed)
        sample["weber_fraction"] = np.exp(sample.pop(NAMES[0]))
        if self.sessions is None:
            del sample["session_spread"]
        if not self._has_biases:
            del sample["bias_scale"]
        return to_arviz(
            {name: values.reshape(4, draws) for name, values in sample.items()},
            attrs={"status": self.status.value},
        )


def _quantile(values: Array, mass: Array, probability: ArrayLike) -> Array:
    """Quantiles of values (n,) of which each has a probability."""
    order = np.argsort(values)
    below = np.cumsum(mass[order]) - 0.5 * mass[order]
    return np.interp(np.asarray(probability, dtype=float), below, values[order])


@renamed_arguments(percept="encoding")
@one_blas_thread
def fit_population(
    trials: Trials,
    *,
    sessions: bool = False,
    encoding: Any = None,
    observer: Any = None,
    bias: str | None = None,
    noise: str = "weber",
    priors: Any = None,
    population: PopulationPriors | None = None,
    seed: int = 0,
) -> PopulationFit:
    """Fit many animals at once: each learns from the others (partial pooling).

    ln k of the animals is normal about the population's, and where sessions are distinguished,
    those of a session about its animal's. So are the normal scores of the lapses, one mean and
    spread for both ends; each session, or animal, has lapses of its own. Everything is integrated,
    nothing sampled.

    Biases are drawn from the prior of a single fit, all times one factor, the `bias_scale`: their
    sd, where that prior is a standard normal. Without it k would be pulled wherever biases are
    narrower or wider than believed (see `weberwhisk.behaviour.axes`).

    Parameters
    ----------
    trials : Trials
        With a column `subject`, and `session` if these are distinguished. Sessions without a
        subject are one animal's.
    sessions : bool
        Let the Weber fraction of an animal vary between sessions.
    encoding, observer, bias, noise, priors
        As for `fit_weber`, the same for all animals. `{"weber_fraction": "levels"}` lays the prior
        of their median about the geometric mean of what each animal's easiest pair says.
    population : PopulationPriors, optional
    seed : int
        Of draws only.

    Returns
    -------
    PopulationFit
        Always read its `status`, and those of its `subjects`.

    Raises
    ------
    ValueError
        Where the table has no subjects, or no sessions to distinguish.

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
    if population is not None:
        hint = "write PopulationPriors(spread=scipy.stats.halfnorm(scale=0.5)), say"
        _checks.kind("population", population, "PopulationPriors", "lapse_spread", hint)
    _checks.generator(seed)
    if sessions and "subject" not in trials.frame:
        trials = replace(trials, frame=trials.frame.assign(subject="the animal"))
    for column, wanted in (("subject", True), ("session", sessions)):
        if wanted and column not in trials.frame:
            raise ValueError(
                f"{trials.source}: there is no column {column!r} to tell {column}s apart; map one "
                f"with columns={{{column!r}: '<its name>'}} when the table is read."
            )
    unit_known = trials.scale == "linear" or trials.log_unit is not None
    each = (trials.select(subject=subject).cells() for subject in trials.subjects)
    encoded = encoding_of(trials, encoding, observer, noise)
    shown = (pairs_shown(cells, encoded, noise) for cells in each)  # of use to "levels" alone
    believed = priors_for(priors, trials.cells(), unit_known, trials.task, shown=shown)
    if believed.is_fixed("weber_fraction"):
        raise ValueError(
            "the Weber fraction of every animal was fixed, and a population learns them; leave it "
            "out of priors, or fix the lapses alone."
        )
    options = {"encoding": encoding, "observer": observer, "bias": bias, "noise": noise}
    fits = {
        labels: fit_weber(part, priors=believed, method="quadrature", seed=seed, **options)
        if part.n_trials
        else None
        for labels, part in _members(trials, sessions)
    }
    own = pd.DataFrame([_row(labels, fit) for labels, fit in fits.items()])
    left_out = own["status"].isin([status.name for status in LEFT_OUT])
    notes = tuple(
        f"{' '.join(map(str, labels))} stays out: {FitStatus[status].message}."
        for labels, status, out in zip(fits, own["status"], left_out, strict=True)
        if out
    )
    prior = population or PopulationPriors()
    lapses = tuple(name for name in trials.task.lapses if not believed.is_fixed(name))
    shared = believed, prior, lapses, notes, seed, {key: fit for key, fit in fits.items() if fit}
    if left_out.all():
        status = PopulationStatus.NO_TRIALS
        return PopulationFit(status, own, None, None, *shared)
    kept = own[~left_out]
    animals = kept["subject"].unique()
    chosen = [fit for fit, out in zip(fits.values(), left_out, strict=True) if fit and not out]
    draws, models = [f.posterior.draws() for f in chosen], [f.model.merged() for f in chosen]
    scales = likely_scales(models, draws, prior.bias_scale)
    members = Members(
        tuple(tabulate(m, d, scales) for m, d in zip(models, draws, strict=True)),
        pd.factorize(kept["subject"])[0],
        sessions,
        scales,
    )
    weber = believed.weber_fraction
    found = integrate_population(members, prior, lambda x: weber.logpdf(np.exp(x)) + x)
    table = _with_quantiles(own, kept.index, found.log_k, found.members)
    status = _status(found, prior, animals.size)
    if not sessions:
        return PopulationFit(status, table, None, found, *shared)
    subjects = own.groupby("subject", sort=False)["n"].sum().reset_index()
    at = subjects.index[subjects["subject"].isin(animals)]
    subjects = _with_quantiles(subjects, at, found.log_k, found.animals)
    return PopulationFit(status, subjects, table, found, *shared)


def _members(trials: Trials, sessions: bool) -> Iterator[tuple[tuple[Any, ...], Trials]]:
    """Every animal, or every session of every animal, with its labels."""
    for subject in trials.subjects:
        own = trials.select(subject=subject)
        if not sessions:
            yield (subject,), own
            continue
        for session in own.sessions:
            yield (subject, session), own.select(session=session)


def _row(labels: tuple[Any, ...], fit: WeberFit | None) -> dict[str, Any]:
    low, middle, high = (
        fit.posterior.quantile("weber_fraction", [0.025, 0.5, 0.975]) if fit else [np.nan] * 3
    )
    return {
        **dict(zip(("subject", "session"), labels, strict=False)),
        "n": fit.trials.n_trials if fit else 0,
        "alone": float(middle),
        "alone_lower": float(low),
        "alone_upper": float(high),
        "status": (fit.status if fit else FitStatus.NO_TRIALS).name,
    }


def _with_quantiles(table: pd.DataFrame, rows: pd.Index, log_k: Array, mass: Array) -> pd.DataFrame:
    """The table with medians and 95 % intervals of exp(ln k); NaN for those left out."""
    found = [np.exp(_quantile(log_k, own, [0.5, 0.025, 0.975])) for own in mass]
    names = ["weber_fraction", "lower", "upper"]
    return table.join(pd.DataFrame(found, index=rows, columns=names))


def _status(
    found: Population, prior: PopulationPriors, animals: int, of_prior: float = 0.8
) -> PopulationStatus:
    """The spread is uninformed where its sd is more than that share of the prior's."""
    if found.error > 0.02:
        return PopulationStatus.NOT_CONVERGED
    if animals == 1:
        return PopulationStatus.ONE_ANIMAL
    (values,), mass = found.nodes("spread")
    sd = np.sqrt(mass @ (values - mass @ values) ** 2)
    if sd > of_prior * float(prior.spread.std()):
        return PopulationStatus.SPREAD_UNINFORMED
    return PopulationStatus.DETERMINED
