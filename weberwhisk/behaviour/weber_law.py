"""Weber's law beside named rivals: is noise proportional to the stimulus?

The law says that one Weber fraction serves every standard. Its rivals say how it fails, by one
parameter each: noise that grows as a power of the stimulus other than 1, and noise that is left
where the stimulus vanishes. A bias of each standard, or contraction towards the mean stimulus,
would pass for either, so that both are marginalised. Of a population the bias is that of its fit,
and every parameter differs between its animals.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pandas as pd
from scipy.special import logsumexp

from .._util.campaign import one_blas_thread
from .._util.output import plain
from .._util.refusals import Refusal, argument
from .._util.values import Array, Line, interval_text
from .criticism import UNCHECKED
from .effects import Contraction, Effect, Exponent, Floor, is_possible
from .encodings import LogAxisEncoding, UnitEncodings
from .estimates import Estimates, check_fit
from .fit import WeberFit, fit_weber
from .pooled import any_fired, pooled_residuals
from .population import Population
from .population_fit import PopulationFit, PopulationStatus
from .population_model import PopulationModel
from .quadrature import QuadraturePosterior
from .trials import needs_standards
from .verdict import FitStatus, strength

__all__ = ["WeberLawTest", "weber_law_test"]

LEVELS = [0.5, 0.025, 0.975]
#: How each rival of the law departs from it, in words.
RIVALS = {"exponent": "noise as a power of the stimulus", "floor": "noise left at no stimulus"}


@dataclass(frozen=True, repr=False)
class WeberLawTest(Line):
    """Weber's law beside its rivals, each as likely beforehand.

    `log_bayes_factor` is the natural log of the evidence for the law over the mean of its rivals.
    `rivals` has a row a rival: `log_bayes_factor` of the law over it, and the median and 95 %
    interval of its parameter, `value`, `lower`, `upper` (of an exponent the law has 1, of a floor
    0). `least_shown` is the departure of the exponent from 1 that these data would have shown with
    strong evidence (10 to 1) one time in two. `status` is that of the fit with the most evidence:
    where it is a misfit the test says nothing. `by_standard` has the Weber fraction at each
    standard alone.

    Examples
    --------
    >>> from weberwhisk import fit_weber, simulate_trials
    >>> trials = simulate_trials(standards=[1.0, 4.0], weber_fraction=0.15, seed=2)
    >>> test = weber_law_test(fit_weber(trials))
    >>> test.by_standard["standard"].tolist(), test.rivals.index.tolist()
    ([1.0, 4.0], ['exponent', 'floor'])
    >>> test.verdict
    'no evidence either way'
    """

    log_bayes_factor: float
    rivals: pd.DataFrame = field(repr=False)
    least_shown: float
    status: FitStatus | PopulationStatus
    by_standard: pd.DataFrame = field(repr=False)

    def _table(self) -> pd.DataFrame:
        return self.rivals

    @property
    def verdict(self) -> str:
        """What the evidence says, or that it says nothing."""
        if self.status.is_misfit or self.status in (*UNCHECKED, PopulationStatus.NOT_CONVERGED):
            return (
                "nothing can be said of Weber's law, as the model does not hold "
                f"({self.status.name})"
            )
        size = strength(abs(self.log_bayes_factor))
        side = " for Weber's law" if self.log_bayes_factor > 0 else " against Weber's law"
        return size + ("" if size.startswith("no") else side)

    def to_dict(self) -> dict[str, object]:
        """Everything a reader needs to use the test, ready for JSON."""
        described = {
            "log_bayes_factor": self.log_bayes_factor,
            "verdict": self.verdict,
            "status": self.status.name,
            "least_shown": self.least_shown,
            "rivals": self.rivals.to_dict("index"),
            "by_standard": self.by_standard.to_dict("records"),
        }
        return dict(plain(described))

    def _line(self) -> str:
        return f"log Bayes factor {self.log_bayes_factor:+.2f}, {self.verdict}"

    def report(self) -> str:
        """The verdict in words, with what these data could have shown."""
        said = [f"Noise proportional to the stimulus against its rivals: {self._line()}."]
        for name, row in self.rivals.iterrows():
            value = interval_text(*row[["value", "lower", "upper"]])
            said.append(
                f"{RIVALS[str(name)].capitalize()}: {name} {value}, log Bayes factor of the law "
                f"{row['log_bayes_factor']:+.2f}."
            )
        if np.isfinite(self.least_shown):
            low, high = 1 - self.least_shown, 1 + self.least_shown
            said.append(
                "These data would have shown, by strong evidence one time in two, an exponent "
                f"below {low:.2g} or above {high:.2g}."
            )
        else:
            said.append("These data could not have shown any departure from the law.")
        return " ".join(said)


@one_blas_thread
def weber_law_test(fit: Estimates | PopulationFit) -> WeberLawTest:
    """Weber's law against noise as a power of the stimulus, and against a floor.

    Every model has the effects of the fit, and either a bias of each standard or one bias and
    contraction, each as likely beforehand.

    Parameters
    ----------
    fit : WeberFit or PopulationFit
        Of two standards or more; its encoding, priors, noise and effects are those of the test. Of
        a population the exponent and the floor are its medians, and the bias is the fit's.

    Returns
    -------
    WeberLawTest

    Raises
    ------
    ValueError
        With fewer than two standards, a fixed Weber fraction, states, effects that are themselves
        departures from the law, or noise that does not grow with the stimulus.

    Examples
    --------
    >>> from weberwhisk import fit_weber, simulate_trials
    >>> trials = simulate_trials(standards=[1.0, 4.0], weber_fraction=0.15, seed=2)
    >>> low, high = weber_law_test(fit_weber(trials)).rivals.loc["exponent", ["lower", "upper"]]
    >>> low < 1.0 < high
    True
    """
    if isinstance(fit, PopulationFit):
        return _of_population(fit)
    check_fit(fit)
    _refuse_untestable(fit)
    departures = _departures(fit)
    fits = {
        (observer, noise): _fitted(fit, bias, [*nuisance, *departure])
        for observer, (bias, nuisance) in _observers(fit).items()
        for noise, departure in {"law": [], **departures}.items()
    }
    posteriors = {key: one.posterior for key, one in fits.items()}
    evidence = {key: one.log_evidence for key, one in fits.items()}
    best = max(fits.values(), key=lambda one: one.log_evidence or -np.inf)
    return _weighed(evidence, posteriors, departures, best.status, _by_standard(fit))


def _of_population(fit: PopulationFit) -> WeberLawTest:
    """The test of all animals together."""
    if fit.model is None or fit.population is None:
        raise Refusal(f"there is no population to test: {fit.status.value}.")
    kept = list(fit.subjects.loc[fit.subjects["weber_fraction"].notna(), "subject"])
    animal = fit.fits[kept[0]]
    _refuse_untestable(animal)
    departures = _departures(animal)
    nuisances: dict[str, list[Effect]] = {animal.bias: []}
    nuisances |= {name: effects for name, (_, effects) in _observers(animal).items() if effects}
    fits: dict[tuple[str, str], tuple[PopulationModel, Population]] = {}
    for observer, nuisance in nuisances.items():
        for noise, departure in {"law": [], **departures}.items():
            model = fit.model.with_effects([*nuisance, *departure])
            fits[observer, noise] = model, model.integrated(model.fits(), kept)
    posteriors = {key: population for key, (_, population) in fits.items()}
    evidence = {key: one.log_evidence for key, one in posteriors.items()}
    model, best = fits[max(evidence, key=lambda key: evidence[key])]
    if best.trouble:
        status = PopulationStatus.NOT_CONVERGED
    elif any_fired(pooled_residuals(model.fits(), best, kept)):
        status = PopulationStatus.MISFIT
    else:
        status = PopulationStatus.DETERMINED
    rows = []
    for standard in fit.model.trials.standards:
        part = replace(fit.model, trials=fit.model.trials.select(standard=standard), effects=(),
                       bias="none" if animal.bias == "none" else "shared")  # fmt: skip
        fits_there = part.fits()
        there = part.integrated(fits_there, [one for one in kept if one in fits_there], quick=True)
        rows.append((standard, part.trials.n_trials, *there.quantile("weber_fraction", LEVELS)))
    columns = ["standard", "n", "weber_fraction", "lower", "upper"]
    return _weighed(evidence, posteriors, departures, status, pd.DataFrame(rows, columns=columns))


def _weighed(
    evidences: Mapping[tuple[str, str], float | None],
    posteriors: Mapping[tuple[str, str], Any],
    departures: Mapping[str, list[Effect]],
    status: FitStatus | PopulationStatus,
    by_standard: pd.DataFrame,
) -> WeberLawTest:
    """The test by log evidences and posteriors of observer and noise."""
    evidence = pd.Series(evidences, dtype=float)
    of_model = evidence.groupby(level=1).agg(lambda e: logsumexp(e) - np.log(e.size))
    law_over = of_model["law"] - of_model[list(departures)]
    best = {
        rival: posteriors[max((o, r) for o, r in posteriors if r == rival
                              and evidence[o, r] == evidence.xs(rival, level=1).max())]
        for rival in departures
    }  # fmt: skip
    by_rival = {
        rival: (law_over[rival], *best[rival].quantile(rival, LEVELS)) for rival in departures
    }
    rivals = pd.DataFrame.from_dict(
        by_rival, "index", columns=["log_bayes_factor", "value", "lower", "upper"]
    ).rename_axis("rival")
    of_rivals = logsumexp(of_model[list(departures)]) - np.log(len(departures))
    believed: Any = departures["exponent"][0].prior
    return WeberLawTest(
        log_bayes_factor=float(of_model["law"] - of_rivals),
        rivals=rivals,
        least_shown=_least_shown(float(believed.var()), best["exponent"].sd("exponent") ** 2),
        status=status,
        by_standard=by_standard,
    )


@dataclass(frozen=True, eq=False, repr=False)
class _ExponentOfLevel(Exponent):
    """The exponent where stimuli are logarithms: noise changes by its power along their axis."""

    log_unit: float = 1.0

    def bound(self, encodings: UnitEncodings, n: Array) -> Exponent:
        return replace(self, typical=float(np.r_[encodings.mean_1, encodings.mean_2].mean()))

    def relative(self, mean: Array | float) -> Array:
        return np.exp(self.log_unit * (np.asarray(mean) - (self.typical or 0.0)))


def _departures(fit: Estimates) -> dict[str, list[Effect]]:
    """The effects of the rivals that the stimuli can show.

    Where the unit of logarithms is unknown, the standards are taken to span a factor of 4.
    """
    if not isinstance(fit.encoding, LogAxisEncoding):
        return {"exponent": [Exponent()], "floor": [Floor()]}
    unit = 1.0 if fit.trials.unit_known else np.log(4.0) / float(np.ptp(fit.standards))
    return {"exponent": [_ExponentOfLevel(log_unit=unit)]}


def _observers(fit: Estimates) -> dict[str, tuple[str, list[Effect]]]:
    """Which bias and further effects may stand beside the noise."""
    if fit.bias == "none" or not fit.model.free_bias:
        return {fit.bias: (fit.bias, [])}
    observers: dict[str, tuple[str, list[Effect]]] = {"bias per standard": ("per standard", [])}
    contraction, given = Contraction(), (fit.trials, fit.encoding, fit.model.encodings)
    if (
        fit.trials.task.bias_name == "bias"
        and contraction.name not in fit.effects
        and is_possible(contraction, *given, fit.model.cells.n)
    ):
        observers["contraction"] = ("shared", [contraction])
    return observers


def _fitted(fit: Estimates, bias: str, effects: list[Effect]) -> WeberFit:
    priors = fit.model.priors
    return fit_weber(
        fit.trials, encoding=fit.encoding, bias=bias, noise=fit.noise, priors=priors,
        effects=[*fit.model.effects, *effects],
    )  # fmt: skip


def _refuse_untestable(fit: Estimates) -> None:
    departures = [name for name in RIVALS if name in fit.effects]
    if departures:
        raise Refusal(
            "Weber's law is tested against an exponent and a floor",
            "a fit with " + ", ".join(departures),
            "fit without them",
        )
    if fit.model.n_states > 1:
        raise Refusal(
            "Weber's law is tested of one state",
            argument("states", fit.model.n_states),
            "fit the trials of each standard, trials.select(standard=...), with states",
        )
    needs_standards(fit.trials, "the test of Weber's law")
    if fit.standards.size < 2:
        raise Refusal("Weber's law needs two standards or more", "1", "collect another standard")
    if "weber_fraction" not in fit.model.names:
        raise Refusal("the Weber fraction is fixed", remedy="give it a prior to test Weber's law")


def _by_standard(fit: Estimates) -> pd.DataFrame:
    """k at each standard alone, without effects."""
    fitted = []
    for standard, part in fit.model.plain().by_standard():
        alone = QuadraturePosterior.integrated(part.merged())
        k = alone.quantile("weber_fraction", LEVELS)
        fitted.append((standard, int(part.cells.n.sum()), *k))
    return pd.DataFrame(fitted, columns=["standard", "n", "weber_fraction", "lower", "upper"])


def _least_shown(prior: float, posterior: float, odds: float = 10.0) -> float:
    """The departure of the exponent from 1 whose Bayes factor would reach such odds.

    Prior and likelihood of the exponent as normal: with variances v₀ and v the log Bayes factor of
    an estimate d away is d² v₀ / (2 v (v + v₀)) − ½ ln(1 + v₀/v). Given are the variances of prior
    and posterior.
    """
    if posterior >= 0.95 * prior:
        return np.inf
    v = 1 / (1 / posterior - 1 / prior)
    ratio = prior / v
    away = float(np.sqrt((2 * np.log(odds) + np.log1p(ratio)) * v * (1 + 1 / ratio)))
    return away if away < 3 * np.sqrt(prior) else np.inf  # nobody expects an observer out there
