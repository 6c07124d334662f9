"""What can be read off a fit: one posterior, and everything from it."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from .. import _checks
from . import criticism, report
from . import psychometric as curve
from .likelihood import WeberModel
from .percepts import Percept
from .posteriors import WeberPosterior
from .status import FitStatus
from .trials import Trials

if TYPE_CHECKING:
    from .law import WeberLawTest

Array = NDArray[np.float64]


@dataclass(frozen=True)
class WeberFit:
    """The fit of one observer; everything in it comes from one posterior.

    `weber_fraction` is the posterior median. `status` says what the data could tell and travels
    with the numbers; `notes` holds further sentences; `report()` puts all of it in plain words.
    """

    trials: Trials = field(repr=False)
    model: WeberModel = field(repr=False)
    percept: Percept = field(repr=False)
    noise: str
    bias: str
    method: str
    posterior: WeberPosterior = field(repr=False)
    status: FitStatus
    notes: tuple[str, ...] = ()

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
    def log_evidence(self) -> float | None:
        """Natural log of the probability of the sequence of answers; None by emcee."""
        return self.posterior.log_evidence

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the inferred parameters."""
        return self.model.names

    def interval(
        self, mass: float = 0.95, parameter: str = "weber_fraction"
    ) -> tuple[float, float]:
        """Equal-tailed posterior interval of a parameter."""
        _checks.one_of("parameter", parameter, self.parameters)
        low, high = self.posterior.quantile(parameter, _tails(mass))
        return float(low), float(high)

    def summary(self, mass: float = 0.95) -> pd.DataFrame:
        """One row a parameter: mean, sd, median, interval (`lower`, `upper`), prior."""
        rows = []
        for name in self.parameters:
            low, median, high = self.posterior.quantile(
                name, [*_tails(mass)[:1], 0.5, *_tails(mass)[1:]]
            )
            base = name if name in ("weber_fraction", "lapse_low", "lapse_high") else "bias"
            rows.append(
                {
                    "mean": self.posterior.mean(name),
                    "sd": self.posterior.sd(name),
                    "median": median,
                    "lower": low,
                    "upper": high,
                    "mass": mass,
                    "prior": self.model.priors.words(base),
                }
            )
        return pd.DataFrame(rows, index=pd.Index(self.parameters, name="parameter"))

    def threshold(
        self,
        standard: ArrayLike | None = None,
        proportion: float = 0.75,
        *,
        mass: float = 0.95,
        with_bias: bool = False,
        upward: bool = True,
    ) -> pd.DataFrame:
        """Comparisons at which the observer answers with that proportion, lapses removed.

        Parameters
        ----------
        standard : array_like, optional
            One or several; those of the table by default.
        proportion : float
            Of "second greater" (below ½: the downward threshold), or of correct answers.
        mass : float
            Of the interval, taken from the posterior of the threshold itself.
        with_bias : bool
            Leave the response bias in: the point as it lies on the curve. Without it the threshold
            is the observer's sensitivity, and the 50 % point is the standard.
        upward : bool
            The side, for percent-correct tasks.

        Returns
        -------
        DataFrame
            `standard`, `criterion`, `comparison` (median), `lower`, `upper`, `difference`
            (comparison − standard), and `unreachable`: the posterior probability that no comparison
            reaches the proportion, where an end may be infinite.
        """
        task = self.model.task
        rows = []
        for s in np.atleast_1d(
            self.trials.standards if standard is None else np.asarray(standard, float)
        ):

            def point(k: ArrayLike, b: ArrayLike = 0.0, s: float = float(s)) -> Array:
                return curve.threshold(
                    task,
                    self.percept,
                    s,
                    proportion,
                    weber_fraction=k,
                    bias=b,
                    noise=self.noise,
                    upward=upward,
                )

            if with_bias and self.model.group_names:
                d = self.posterior.draws()
                sample = point(d.weber_fraction, d.bias[:, self._group(float(s))])
                ends = np.quantile(
                    sample, [_tails(mass)[0], 0.5, _tails(mass)[1]], method="median_unbiased"
                )
            else:  # a monotone function of k alone
                at = np.array([_tails(mass)[0], 0.5, _tails(mass)[1]])
                ends = np.sort(point(self.posterior.quantile("weber_fraction", at)))
                sample = point(
                    self.posterior.quantile("weber_fraction", (np.arange(200) + 0.5) / 200)
                )
            edge = self.percept.domain[0]
            rows.append(
                {
                    "standard": float(s),
                    "criterion": curve.criterion(task, proportion),
                    "comparison": ends[1],
                    "lower": ends[0],
                    "upper": ends[2],
                    "difference": ends[1] - float(s),
                    "mass": mass,
                    "unreachable": float(np.mean(np.isinf(sample) | (sample == edge))),
                }
            )
        return pd.DataFrame(rows)

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
        levels = np.atleast_1d(_checks.finite("comparisons", comparisons, "give one or several"))
        if standard is None:
            if self.trials.standards.size != 1:
                raise ValueError(
                    f"the table has {self.trials.standards.size} standards; name one, for example "
                    f"standard={self.trials.standards[0]:g}."
                )
            standard = float(self.trials.standards[0])
        p = self._probability(np.full(levels.shape, standard), levels, standard)
        low, median, high = np.quantile(p, [_tails(mass)[0], 0.5, _tails(mass)[1]], axis=0)
        return pd.DataFrame({"comparison": levels, "median": median, "lower": low, "upper": high})

    def _probability(self, s1: Array, s2: Array, standard: float) -> Array:
        """P at a thinned set of draws, (1000, N)."""
        d = self.posterior.draws()
        thin = slice(None, None, max(d.weber_fraction.size // 1000, 1))
        bias = d.bias[thin, self._group(standard)] if self.model.group_names else 0.0
        return curve.response_probability(
            self.model.task,
            self.percept,
            s1,
            s2,
            standard=np.full(s1.shape, standard),
            weber_fraction=d.weber_fraction[thin],
            lapse_low=d.lapse_low[thin],
            lapse_high=d.lapse_high[thin],
            bias=bias,
            noise=self.noise,
        )

    def _group(self, standard: float) -> int:
        """The column of the bias that a standard has."""
        if self.bias != "per standard":
            return 0
        at = np.flatnonzero(np.isclose(self.trials.standards, standard, rtol=1e-9, atol=0))
        if not at.size:
            known = ", ".join(f"{s:g}" for s in self.trials.standards)
            raise ValueError(
                f"standard {standard:g} is not in the table, so it has no bias; "
                f"choose one of {known}."
            )
        return int(at[0])

    def residuals(self) -> pd.DataFrame:
        """One row a pair of stimuli: observed, expected, and `z` in standard errors."""
        return criticism.residuals(self.model, self.posterior.draws())

    @cached_property
    def misfit(self) -> float:
        """Posterior-predictive p of the squared residuals: small where the data are missed."""
        return criticism.misfit(self.model, self.posterior.draws())

    def report(self) -> str:
        """What the data say, what they cannot say, and what to collect next."""
        return report.report(self)

    def weber_law_test(self) -> WeberLawTest:
        """One Weber fraction for all standards, against one for each: a Bayes factor."""
        from .law import weber_law_test

        return weber_law_test(self)

    def to_dict(self) -> dict[str, Any]:
        """Everything a reader needs to use or repeat the fit, ready for JSON."""
        low, high = (
            self.interval() if "weber_fraction" in self.parameters else (self.weber_fraction,) * 2
        )
        return {
            "weber_fraction": self.weber_fraction,
            "lower": low,
            "upper": high,
            "mass": 0.95,
            "unit": self.unit or "ratio",
            "status": self.status.name,
            "message": self.status.message,
            "notes": list(self.notes),
            "parameters": self.summary().to_dict(orient="index"),
            "thresholds": _plain(self.threshold().to_dict(orient="records")),
            "log_evidence": self.log_evidence,
            "error": self.posterior.error,
            "misfit": self.misfit,
            "data": {
                "source": self.trials.source,
                "n_trials": self.trials.n_trials,
                "n_missing": self.trials.n_missing,
                "cells": int(self.model.cells.n.size),
                "standards": self.trials.standards.tolist(),
            },
            "settings": {
                "task": self.model.task.name,
                "noise": self.noise,
                "bias": self.bias,
                "method": self.method,
                "percept": type(self.percept).__name__,
            },
        }

    def to_json(self) -> str:
        """`to_dict()` as JSON; an unreachable threshold is null."""
        return json.dumps(self.to_dict(), indent=2, allow_nan=False)

    def to_arviz(self) -> Any:
        """Posterior, log-likelihood and observed data for ArviZ (0.23 or 1.x)."""
        from .export import to_arviz

        return to_arviz(self)


def _tails(mass: float) -> tuple[float, float]:
    value = float(_checks.finite("mass", mass, "write for example 0.95"))
    if not 0 < value < 1:
        raise ValueError(f"mass must lie between 0 and 1, got {value:g}; write for example 0.95.")
    return 0.5 - value / 2, 0.5 + value / 2


def _plain(rows: list[dict[Any, Any]]) -> list[dict[Any, Any]]:
    """Infinities as None, which JSON can hold."""
    return [
        {k: None if isinstance(v, float) and not np.isfinite(v) else v for k, v in row.items()}
        for row in rows
    ]
