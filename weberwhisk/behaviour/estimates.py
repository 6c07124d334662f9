"""The posterior of one observer, and what is read off it: intervals, thresholds, curves."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar, Protocol

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from .._util import checks
from .._util.refusals import Refusal
from .._util.values import Array, Shown, counted, interval_text
from . import psychometric as curve
from .cue_encoding import CueEncoding, PooledEncoding
from .effects import Effect
from .encodings import ConstantNoise, Encoding, refuse_outside
from .likelihood import Draws, WeberModel
from .posteriors import WeberPosterior
from .prior_sensitivity import lapse_sensitivity, prior_sensitivity
from .tasks import SignedChoice
from .trials import STIMULI, Trials, needs_standards, sessions_of
from .verdict import FitStatus

__all__ = ["Estimates", "Explanation", "by_session", "check_fit", "compared", "tails"]


class Explanation(Protocol):
    """What may be behind a misfit: `weberwhisk.behaviour.causes.Search`.

    `chosen` are the causes with strong evidence, with the fit that has them, or None; `matters`
    says whether they move k, and `sentence` how far.
    """

    @property
    def chosen(self) -> Any: ...
    @property
    def matters(self) -> bool: ...
    @property
    def sentence(self) -> str: ...
    @property
    def table(self) -> pd.DataFrame: ...


@dataclass(frozen=True, repr=False)
class Estimates(Shown):
    """The posterior of one observer given its trials.

    `weber_fraction` is the posterior median. `status` says what the data determine and travels
    with the numbers; `notes` are further sentences.
    """

    _figure: ClassVar[str] = "psychometrics"
    trials: Trials = field(repr=False)
    model: WeberModel = field(repr=False)
    encoding: Encoding = field(repr=False)
    noise: str
    bias: str
    method: str
    posterior: WeberPosterior = field(repr=False)

    @property
    def status(self) -> FitStatus:
        """What the fit is worth: by far the worst of what was found, or that all is well."""
        return self._judged[0]

    @property
    def notes(self) -> tuple[str, ...]:
        """What a reader should know besides, a sentence each."""
        return self._judged[1]

    @property
    def _judged(self) -> tuple[FitStatus, tuple[str, ...]]:
        """Status and notes; the fit has them, since the checks look at its estimates."""
        raise NotImplementedError

    @property
    def checked(self) -> pd.DataFrame:
        """What `predictive.checks` finds; the fit has it too."""
        raise NotImplementedError

    @property
    def unweighed(self) -> FitStatus:
        """The status once checked, whatever a misfit does to k; the fit has it too."""
        raise NotImplementedError

    @property
    def search(self) -> Explanation:
        """What may be behind a misfit; the fit has it too."""
        raise NotImplementedError

    @property
    def weber_fraction(self) -> float:
        """Posterior median of the Weber fraction (see `unit`)."""
        return float(self.posterior.quantile("weber_fraction", 0.5))

    @property
    def unit(self) -> str:
        """What the Weber fraction is counted in: empty for a pure ratio."""
        if self.trials.scale == "log" and self.trials.log_unit is None:
            return "per unit of the stimulus column"
        return ""

    @property
    def stimulus_unit(self) -> str:
        """Unit of the stimuli, where the encoding is of distances; else empty."""
        base = self.encoding.base if isinstance(self.encoding, ConstantNoise) else self.encoding
        if not isinstance(base, CueEncoding | PooledEncoding):
            return ""
        return {1e-3: "mm", 1.0: "m"}.get(base.unit, f"{base.unit:g} m")

    @property
    def log_evidence(self) -> float | None:
        """Natural log of the probability of the sequence of answers; None by emcee."""
        return self.posterior.log_evidence

    @property
    def standards(self) -> Array:
        """Standards with an answer, rising; those of the table where none has one; empty where it
        is not known which stimuli they are."""
        if not self.trials.has_standards:
            return self.trials.standards
        answered = np.unique(self.model.cells.standard)
        return answered if answered.size else self.trials.standards

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the inferred parameters."""
        return self.model.names

    @property
    def effects(self) -> tuple[str, ...]:
        """Names of the effects in the model."""
        return tuple(effect.name for effect in self.model.effects)

    @property
    def remarks(self) -> list[str]:
        """Sentences of the report on what this kind of fit alone has."""
        return []

    def interval(
        self, mass: float = 0.95, parameter: str = "weber_fraction"
    ) -> tuple[float, float]:
        """Equal-tailed posterior interval of a parameter.

        Parameters
        ----------
        mass : float
            Its posterior probability.
        parameter : str
            One of `parameters`; a Weber fraction that was given is both ends.
        """
        if parameter != "weber_fraction":
            checks.one_of("parameter", parameter, self.parameters)
        low, high = self.posterior.quantile(parameter, np.array(tails(mass)))
        return float(low), float(high)

    @cached_property
    def map(self) -> dict[str, float]:
        """The most probable values (MAP), in the normal scores of the priors (ln k, say)."""
        return self.posterior.mode()

    def summary(self, mass: float = 0.95) -> pd.DataFrame:
        """One row a parameter: mean, sd, median, MAP, intervals, prior.

        `lower` and `upper` leave out as much on either side; ``arviz.hdi(fit.to_arviz(), 0.95)``
        has the shortest interval of 95 % (without a number ArviZ takes another one).
        """
        rows = []
        for name in self.parameters:
            low, high = self.interval(mass, name)
            rows.append(
                {
                    "mean": self.posterior.mean(name),
                    "sd": self.posterior.sd(name),
                    "median": float(self.posterior.quantile(name, 0.5)),
                    "lower": low,
                    "upper": high,
                    "map": self.map[name],
                    "mass": mass,
                    "prior": self.model.priors.words(name),
                }
            )
        return pd.DataFrame(rows, index=pd.Index(self.parameters, name="parameter"))

    def threshold(
        self,
        standard: ArrayLike | None = None,
        proportion: float = 0.75,
        *,
        mass: float = 0.95,
        with_bias: bool | None = None,
        upward: bool = True,
    ) -> pd.DataFrame:
        """Comparisons at which the observer answers with that proportion, lapses removed.

        The column `criterion` says what else was: by default the bias, too.

        Parameters
        ----------
        standard : array_like, optional
            One or several; those that have answers by default.
        proportion : float
            Of "second greater" (below ½: the downward threshold), of correct answers, and so on.
        mass : float
            Of the interval, taken from the posterior of the threshold itself.
        with_bias : bool, optional
            Leave the response bias in: the point as it lies on the curve, lapses removed. Without
            it the threshold is the observer's sensitivity, and the 50 % point is the standard. By
            default a bias is removed, and the criterion of yes/no and same–different tasks kept.
        upward : bool
            The side, for percent-correct and same–different tasks.

        Returns
        -------
        DataFrame
            `standard`, `criterion`, `comparison` (median), `lower`, `upper`, `difference`
            (comparison − standard), and `unreachable`: the posterior probability that no comparison
            reaches the proportion, where an end may be infinite.
        """
        model, ends_at = self.model, tails(mass)
        biased = model.task.bias_name == "criterion" if with_bias is None else with_bias
        biased = biased and bool(model.group_names)
        words = curve.criterion(model.task, proportion, biased if model.group_names else None)
        at, even = np.array([ends_at[0], 0.5, ends_at[1]]), (np.arange(200) + 0.5) / 200
        given = self.standards if standard is None else standard
        rows = []
        for s in map(float, checks.finite("standard", given, "give one or several").ravel()):
            k = self.posterior.quantile("weber_fraction", [*at, *even])
            bias: ArrayLike = 0.0
            effects: list[tuple[Effect, Array]] = []
            if by_draws := biased or model.effects:  # else a monotone function of k alone
                d = self.posterior.draws()
                bias = d.bias[:, self._group(s)] if biased else 0.0
                k, effects = d.weber_fraction, self._moved(d)
            points = curve.threshold(
                model.task, self.encoding, s, proportion, weber_fraction=k, bias=bias,
                effects=effects, noise=self.noise, upward=upward,
            )  # fmt: skip
            ends = _quantiles(points, at) if by_draws else np.sort(points[: at.size])
            seen = points if by_draws else points[at.size :]
            edge = self.encoding.domain[0]
            rows.append(
                {
                    "standard": s,
                    "criterion": words,
                    "comparison": ends[1],
                    "lower": ends[0],
                    "upper": ends[2],
                    "difference": ends[1] - s,
                    "mass": mass,
                    "unreachable": float(np.mean(np.isinf(seen) | (seen == edge))),
                }
            )
        return pd.DataFrame(rows)

    def subjective_equality(
        self, standard: ArrayLike | None = None, *, mass: float = 0.95
    ) -> pd.DataFrame:
        """Points of subjective equality (PSE): comparisons that seem equal to the standard.

        Either answer is as likely there, lapses removed; the standard itself where the observer has
        neither bias nor effects. Columns are those of `threshold`: `difference` is the constant
        error.

        Parameters
        ----------
        standard, mass
            As for `threshold`.

        Raises
        ------
        ValueError
            For a task whose answers do not say which of two stimuli is the greater.

        Examples
        --------
        >>> from weberwhisk import fit_weber, simulate_trials
        >>> fit = fit_weber(simulate_trials(weber_fraction=0.1, bias=-1.0, seed=1))
        >>> low, high = fit.subjective_equality().loc[0, ["lower", "upper"]]
        >>> low < 1.153 < high
        True
        """
        if not isinstance(self.model.task, SignedChoice):
            raise Refusal(
                "the point of subjective equality is of a choice between two stimuli",
                f"the task {self.model.task.name}",
                "write fit.threshold(proportion=0.5), say",
            )
        return self.threshold(standard, 0.5, mass=mass, with_bias=True)

    @cached_property
    def usual_thresholds(self) -> pd.DataFrame:
        """Those of `threshold` by default, which report and JSON both have."""
        return self.threshold()

    @cached_property
    def equality_points(self) -> pd.DataFrame:
        """Those of `subjective_equality` by default."""
        return self.subjective_equality()

    def _moved(self, draws: Draws) -> list[tuple[Effect, Array]]:
        """The effects with their draws."""
        return [(e, draws.effects[:, i]) for i, e in enumerate(self.model.effects)]

    def psychometric(
        self, comparisons: ArrayLike, standard: float | None = None, *, mass: float = 0.95
    ) -> pd.DataFrame:
        """The psychometric function with its posterior band, lapses and bias included.

        Parameters
        ----------
        comparisons : array_like, shape (N,)
            Stimulus 2.
        standard : float, optional
            Stimulus 1; may be left out where the table has one standard.

        Returns
        -------
        DataFrame
            `comparison`, `median`, `lower`, `upper`: proportions.
        """
        levels = np.atleast_1d(checks.finite("comparisons", comparisons, "give one or several"))
        refuse_outside(self.encoding, levels)
        if standard is None:
            needs_standards(self.trials, "a curve without standard=")
            if self.standards.size != 1:
                raise Refusal(
                    f"the table has {self.standards.size} standards",
                    remedy=f"name one, for example standard={self.standards[0]:g}",
                )
            standard = float(self.standards[0])
        standard = checks.number("standard", standard, "name one standard")
        d = self.posterior.draws().thinned(1000)
        p = curve.response_probability(
            self.model.task, self.encoding, standard, levels, weber_fraction=d.weber_fraction,
            lapse_low=d.lapse_low, lapse_high=d.lapse_high, effects=self._moved(d),
            bias=d.bias[:, self._group(standard)] if self.model.group_names else 0.0,
            noise=self.noise,
        )  # fmt: skip
        low, median, high = np.quantile(p, [tails(mass)[0], 0.5, tails(mass)[1]], axis=0)
        return pd.DataFrame({"comparison": levels, "median": median, "lower": low, "upper": high})

    def _group(self, standard: float) -> int:
        """The column of the bias that a standard has."""
        if self.bias != "per standard":
            return 0
        at = np.flatnonzero(np.isclose(self.standards, standard, rtol=1e-9, atol=0))
        if not at.size:
            known = ", ".join(f"{s:g}" for s in self.standards)
            raise Refusal(
                f"standard {standard:g} has no answers in the table, so it has no bias",
                remedy=f"choose one of {known}",
            )
        return int(at[0])

    def residuals(self) -> pd.DataFrame:
        """Observed and expected proportions by pair of stimuli.

        `standard`, `stimulus_1`, `stimulus_2`, `n`, `observed`, `expected` (posterior mean) and
        `z`, their difference in binomial standard errors.
        """
        cells, draws = self.model.cells, self.posterior.draws().thinned(1000)
        p = self.model.expected(draws)[0].mean(axis=0)
        labels = {name: getattr(cells, name) for name in STIMULI}
        return pd.DataFrame(
            labels | compared(cells.n, cells.count, cells.n * p, cells.n * p * (1 - p))
        )

    @property
    def misfit(self) -> float:
        """Posterior-predictive p of how far the data lie from the curve: "levels" of `checks`."""
        return float(self.checked["p"].get("levels", 1.0))

    @cached_property
    def prior_sensitivity(self) -> pd.DataFrame:
        """How far each belief moves the Weber fraction, a row each: counted twice, or half.

        Columns are those of `weberwhisk.behaviour.prior_sensitivity.prior_sensitivity`.

        Examples
        --------
        >>> from weberwhisk import fit_weber, simulate_trials
        >>> table = fit_weber(simulate_trials(seed=1)).prior_sensitivity
        >>> table.index.tolist(), table.loc["bias", "prior"]
        (['weber_fraction', 'lapses', 'bias', 'answers'], 'cauchy(0, 0.7)')
        """
        return prior_sensitivity(self.model, self.posterior)

    @cached_property
    def lapse_sensitivity(self) -> pd.DataFrame:
        """The Weber fraction under other beliefs about lapses, a row a prior."""
        return lapse_sensitivity(self.model, self.posterior)

    def _line(self) -> str:
        k = f"k = {self.weber_fraction:.3g}, given"
        if "weber_fraction" in self.parameters:
            k = f"k = {interval_text(self.weber_fraction, *self.interval())}"
        unit = f" {self.unit}" if self.unit else ""
        many = counted(self.trials.n_trials, "trial")
        return f"{k}{unit}; {many}, {self.method}; {self.status.name}{self._with_cause}"

    @property
    def _with_cause(self) -> str:
        """Behind a misfit, its cause and k with it."""
        if not self.status.is_misfit or (cause := self.search.chosen) is None:
            return ""
        k = interval_text(cause.fit.weber_fraction, *cause.fit.interval())
        return f"; with {cause.name} k = {k}"


def check_fit(fit: object, name: str = "fit") -> None:
    """Refuses what is not a fit of one observer."""
    checks.kind(name, fit, "a WeberFit", "posterior", "write ww.fit_weber(trials)")


def tails(mass: float) -> tuple[float, float]:
    """Probabilities below the ends of an equal-tailed interval."""
    hint = f"write fit.interval(parameter={mass!r})" if isinstance(mass, str) else "write 0.95, say"
    value = checks.between("mass", mass, hint)
    return 0.5 - value / 2, 0.5 + value / 2


def by_session(fit: Estimates, mass: float) -> pd.DataFrame:
    """The bias of each session with its interval."""
    model = fit.model
    if model.by_session is None:
        raise Refusal(
            "the bias is the same in all sessions of this fit",
            remedy="fit with effects=[SessionBias()], from weberwhisk.behaviour.effects",
        )
    draws = fit.posterior.reproducible_draws().thinned(2000)
    bias = model.session_deviations(draws)
    if model.n_groups == 1:
        bias = bias + draws.bias
    sessions, place = sessions_of(fit.trials, "SessionBias")
    with_answers = np.unique(place[fit.trials.answered])
    low, high = np.quantile(bias, tails(mass), axis=0)
    labels = [sessions[i] for i in with_answers]
    return pd.DataFrame({"session": labels, "bias": bias.mean(axis=0), "lower": low, "upper": high})


def _quantiles(sample: Array, at: Array) -> Array:
    """Quantiles of draws, some of which may be infinite: between two infinities lies no number."""
    if np.isfinite(sample).all():
        return np.asarray(np.quantile(sample, at, method="median_unbiased"), dtype=float)
    return np.sort(sample)[np.round(at * (sample.size - 1)).astype(np.intp)]


def compared(n: Array, count: Array, mean: Array, variance: Array) -> dict[str, Array]:
    """Counts of n trials beside their mean and variance, in proportions and standard errors."""
    se, off = np.sqrt(variance), count - mean
    # Where the model is certain and the data agree there is nothing off.
    z = np.divide(off, se, out=np.zeros_like(off), where=se > 0)
    return {"n": n.astype(int), "observed": count / n, "expected": mean / n, "z": z}
