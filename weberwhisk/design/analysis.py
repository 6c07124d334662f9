"""The planned analysis: every hypothesis fitted to the trials, and weighed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pandas as pd

from .. import _checks
from ..behaviour.population_fit import LEFT_OUT, PopulationFit, fit_population
from ..behaviour.result import WeberFit
from ..behaviour.trials import STIMULI, Trials
from .hypotheses import Hypothesis, check_distinct, options_of


@dataclass(frozen=True)
class AnalysisResult:
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
        Animals whose answers speak for no hypothesis: under one or another the fit found them
        reversed, one-sided or none. They are not in the evidence, nor in the population.
    """

    estimates: pd.DataFrame = field(repr=False)
    log_evidence: dict[str, float]
    left_out: tuple[str, ...] = ()

    def log_bayes_factor(self, hypothesis: str) -> float:
        """Natural log of the Bayes factor for a hypothesis against the best of the others.

        Infinite where there is no other.
        """
        _checks.one_of("hypothesis", hypothesis, self.log_evidence)
        others = [v for name, v in self.log_evidence.items() if name != hypothesis]
        return self.log_evidence[hypothesis] - max(others, default=-np.inf)

    def favoured(self, bayes_factor: float = 10.0) -> str | None:
        """The hypothesis that is so many times as probable as every other, None without one."""
        best = max(self.log_evidence, key=lambda name: self.log_evidence[name])
        return best if self.log_bayes_factor(best) > np.log(bayes_factor) else None

    def of(self, hypothesis: str) -> pd.DataFrame:
        """The estimates under one hypothesis."""
        rows = self.estimates["hypothesis"] == hypothesis
        return self.estimates[rows].reset_index(drop=True)


def analyse(
    trials: Trials,
    hypotheses: Sequence[Hypothesis],
    *,
    together: bool = False,
    unit: float = 1.0,
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

    Raises
    ------
    ValueError
        For trials that cannot be fitted, and one animal together with nobody.

    Examples
    --------
    >>> from weberwhisk import Whisker, simulate_trials
    >>> from weberwhisk.design import taper
    >>> tapered, cylindrical = taper(Whisker(50e-3, 100e-6, 5e-6))
    >>> trials = simulate_trials(encoding=tapered.encoding, standards=[15e-3, 30e-3, 45e-3],
    ...     offsets=[-0.1, -0.05, 0.05, 0.1], trials_per_level=60, subject="s1", seed=2)
    >>> analyse(trials, [tapered, cylindrical]).favoured(10)
    'tapered'
    """
    _checks.kind("trials", trials, "Trials", "frame", "write read_trials(file), say")
    if unit != 1.0:
        frame = trials.frame.assign(**{name: trials.frame[name] * unit for name in STIMULI})
        trials = replace(trials, frame=frame)
    given = check_distinct(hypotheses)
    return (_pooled if together else _apart)(trials, given)


def _apart(trials: Trials, hypotheses: Sequence[Hypothesis]) -> AnalysisResult:
    rows: list[dict[str, Any]] = []
    evidence: dict[str, list[float | None]] = {h.name: [] for h in hypotheses}
    left_out = []
    for subject in trials.subjects or ["s1"]:
        own = trials.select(subject=subject) if trials.subjects else trials
        fits = [h.fit(own) for h in hypotheses]
        rows += [_row(h, str(subject), fit) for h, fit in zip(hypotheses, fits, strict=True)]
        if any(fit.status in LEFT_OUT for fit in fits):
            left_out.append(str(subject))
            continue
        for h, fit in zip(hypotheses, fits, strict=True):
            evidence[h.name].append(fit.log_evidence)
    total = {name: float(np.sum(np.array(values, float))) for name, values in evidence.items()}
    return AnalysisResult(pd.DataFrame(rows), total, tuple(left_out))


def _pooled(trials: Trials, hypotheses: Sequence[Hypothesis]) -> AnalysisResult:
    if len(trials.subjects) < 2:
        raise ValueError(
            f"{trials.source}: animals are fitted together where there are two or more, got "
            f"{len(trials.subjects)}; write together=False."
        )
    fits = {h.name: fit_population(trials, **options_of(h)) for h in hypotheses}
    bad = {name: _names_left_out(fit) for name, fit in fits.items()}
    left_out = sorted(set().union(*bad.values()))
    kept = [s for s in trials.subjects if str(s) not in left_out]
    for h in hypotheses:  # all of them weigh the same animals
        if len(bad[h.name]) < len(left_out) and kept:
            fits[h.name] = fit_population(trials.select(subject=kept), **options_of(h))
    rows = [_row(h, "population", fits[h.name]) for h in hypotheses]
    evidence = {name: fit.log_evidence if kept else 0.0 for name, fit in fits.items()}
    return AnalysisResult(pd.DataFrame(rows), evidence, tuple(left_out))


def _names_left_out(fit: PopulationFit) -> set[str]:
    status = fit.subjects["status"].isin([status.name for status in LEFT_OUT])
    return set(fit.subjects["subject"][status].astype(str))


def _row(hypothesis: Hypothesis, subject: str, fit: WeberFit | PopulationFit) -> dict[str, Any]:
    if isinstance(fit, PopulationFit) and fit.population is None:
        middle = lower = upper = np.nan
    elif "weber_fraction" in fit.parameters:
        middle, (lower, upper) = fit.weber_fraction, fit.interval(0.95)
    else:  # a number that was given
        middle = lower = upper = fit.weber_fraction
    return {
        "hypothesis": hypothesis.name,
        "subject": subject,
        "weber_fraction": middle,
        "lower": lower,
        "upper": upper,
        "status": fit.status.name,
    }
