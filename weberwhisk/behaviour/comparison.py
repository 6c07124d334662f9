"""Observers compared: which of them made these choices?

Two answers side by side. The evidence, integrated exactly, weighs each model with its priors; the
leave-one-out density (LOO) asks how well it would predict one more trial, whatever the priors.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
import pandas as pd
from scipy.special import logsumexp

from .._util import checks
from .._util.refusals import Refusal, argument
from .._util.sampling import pointwise_loo
from .._util.values import Array, Index, Shown
from .estimates import check_fit
from .fit import WeberFit
from .predictive import Answers
from .trials import SDS
from .verdict import strength

__all__ = ["Comparison", "compare"]


@dataclass(frozen=True, repr=False)
class Comparison(Shown):
    """Fits of several observers to the same trials, best evidence first in `table`.

    Columns of `table`: `log_evidence`; `log_bayes_factor` against the best (natural log);
    `probability` if all were equally likely before; `elpd`, the expected log predictive density of
    a trial left out, summed over the trials; `elpd_difference` from the highest, with its standard
    error `difference_se`; `bad_k`, trials whose Pareto k is above 0.7, where LOO is not to be
    relied on; `weber_fraction`, and the `status` of the fit.

    Examples
    --------
    >>> from weberwhisk import fit_weber, simulate_trials
    >>> trials = simulate_trials(weber_fraction=0.1, seed=1)
    >>> known = {"lapse_low": 0.0, "lapse_high": 0.0}
    >>> both = compare({"lapses": fit_weber(trials), "none": fit_weber(trials, priors=known)})
    >>> both.table["log_bayes_factor"].iloc[0], both.report().startswith("none against lapses")
    (np.float64(0.0), True)
    """

    _figure: ClassVar[str] = "comparison"
    table: pd.DataFrame
    fits: Mapping[str, WeberFit] = field(repr=False)

    def _line(self) -> str:
        return self.report().split("; ")[0].rstrip(".")

    def report(self) -> str:
        """The verdict in words."""
        if len(self.table) < 2 or not np.isfinite(self.table["log_evidence"]).all():
            return "There is nothing to compare by evidence."
        best, second = self.table.index[:2]
        lead = -float(self.table["log_bayes_factor"].iloc[1])
        row = self.table.loc[second]
        return (
            f"{best} against {second}: log Bayes factor {lead:+.2f}, {strength(lead)}; {second} "
            f"predicts a trial left out by {row['elpd_difference']:.1f} ± "
            f"{row['difference_se']:.1f} nats in all, from the best predictor."
        )


def compare(fits: Mapping[str, WeberFit]) -> Comparison:
    """Compare fits of the same trials.

    Parameters
    ----------
    fits : mapping of name to WeberFit

    Raises
    ------
    ValueError
        For fewer than two fits, or fits of different trials.

    Examples
    --------
    >>> from weberwhisk import fit_weber, simulate_trials
    >>> trials = simulate_trials(standards=[1.0, 2.0], weber_fraction=0.1, seed=1)
    >>> both = compare({"free": fit_weber(trials), "wrong": fit_weber(
    ...     trials, priors={"weber_fraction": 0.3})})
    >>> both.table.index.tolist()
    ['free', 'wrong']
    """
    if not isinstance(fits, Mapping):
        raise Refusal(
            "fits must be a mapping of names to fits",
            checks.shown(fits),
            "write ww.compare({'one': fit, 'two': other})",
        )
    for name, fit in fits.items():
        check_fit(fit, f"the fit {name!r}")
    if len(fits) < 2:
        raise Refusal("two fits or more can be compared", len(fits), "give another")
    rows = {name: Answers.of(fit) for name, fit in fits.items()}
    first, *others = rows.values()
    for name, other in zip(list(fits)[1:], others, strict=True):
        same = other.n.shape == first.n.shape and all(
            np.array_equal(getattr(first, a), getattr(other, a)) for a in ("n", "count")
        )
        if not (same and _same_stimuli(first.frame, other.frame)):
            raise Refusal(
                f"{name!r} was fitted to other trials than {next(iter(fits))!r}",
                remedy="fit both to the same ones",
            )
    evidence = np.array(
        [np.nan if f.log_evidence is None else f.log_evidence for f in fits.values()]
    )
    loos = [_by_answer(fit, rows[name].cell) for name, fit in fits.items()]
    # Trials by row and answer; a row of counts stands for several.
    weight = np.stack([first.count, first.n - first.count])
    elpd = np.array([(weight * values).sum() for values, _ in loos])
    best = int(np.argmax(elpd))
    total, errors = weight.sum(), []
    for values, _ in loos:
        off = values - loos[best][0]
        mean = (weight * off).sum() / total
        errors.append(np.sqrt((weight * (off - mean) ** 2).sum() * total / max(total - 1, 1)))
    table = pd.DataFrame(
        {
            "log_evidence": evidence,
            "log_bayes_factor": evidence - np.nanmax(evidence, initial=-np.inf),
            "probability": np.exp(evidence - logsumexp(evidence)),
            "elpd": elpd,
            "elpd_difference": elpd - elpd[best],
            "difference_se": errors,
            "bad_k": [int((weight * (k > 0.7)).sum()) for _, k in loos],
            "weber_fraction": [fit.weber_fraction for fit in fits.values()],
            "status": [fit.status.name for fit in fits.values()],
        },
        index=pd.Index(fits, name="model"),
    )
    order = ["log_evidence", "elpd"] if np.isfinite(evidence).all() else ["elpd"]
    return Comparison(table.sort_values(order, ascending=False), dict(fits))


def _same_stimuli(one: pd.DataFrame, other: pd.DataFrame) -> bool:
    """Whether the stimuli are the same but for their unit, or were measured, or are logarithms."""
    shown = [frame[["stimulus_1", "stimulus_2"]].to_numpy(float) for frame in (one, other)]
    if any(SDS[0] in f for f in (one, other)) or any((s <= 0).any() for s in shown):
        return True
    a, b = (s / s.max(initial=0.0) for s in shown)
    return bool(np.allclose(a, b))


def _by_answer(fit: WeberFit, cell: Index) -> tuple[Array, Array]:
    """LOO density and Pareto k of one trial of each row, answered one way or the other, (2, R)."""
    model = fit.model
    if model.dispersed is not None:
        raise Refusal(
            "trials of an overdispersed observer are not independent, so none can be left out "
            "alone",
            remedy="compare fits without the effect Overdispersion",
        )
    if model.n_states > 1:
        raise Refusal(
            "trials of an observer with "
            + argument("states", model.n_states)
            + " follow each other, so none can be left out alone",
            remedy="subtract one fit's log_evidence from the other's",
        )
    chains = fit.posterior.chains
    draws = fit.posterior.draws()
    size = len(draws) // chains
    p, q = model.expected(draws)
    both = np.log(np.stack([p, q], axis=1))[: size * chains]  # (D, 2, C)
    both = both.reshape(chains, size, -1)
    used = np.stack([model.cells.count, model.cells.n - model.cells.count]).ravel() > 0
    elpd, pareto_k = np.zeros(used.size), np.zeros(used.size)
    elpd[used], pareto_k[used] = pointwise_loo(both[..., used])
    shape = 2, model.cells.n.size
    return elpd.reshape(shape)[:, cell], pareto_k.reshape(shape)[:, cell]
