"""The one verdict on a fit: what its status is once the checks are made.

A fit whose numbers were computed well may still be of a model that does not hold, or hang on what
was believed beforehand. Either is its status, which says what to write next.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from .criticism import checks
from .estimates import Estimates
from .verdict import FitStatus, too_few_kinds

__all__ = ["FALSE_ALARMS", "advice", "judged"]

#: Share of stationary animals in which some check may fire: each has its part of it.
FALSE_ALARMS = 0.05
#: Odds against a belief about lapses above which the answers refute it.
REFUTED = 10.0
#: What each misfit is seen by, the first that is there being the status.
SEEN_BY = {
    FitStatus.MISFIT_STREAKS: ("streaks",),
    FitStatus.MISFIT_HISTORY: ("repetition", "outcome"),
    FitStatus.MISFIT_CURVE: ("levels",),
    FitStatus.MISFIT_DRIFT: ("sessions", "trend"),
    FitStatus.MISFIT_OVERDISPERSION: ("overdispersion",),
}


def judged(
    fit: Estimates, status: FitStatus, notes: tuple[str, ...]
) -> tuple[FitStatus, tuple[str, ...]]:
    """The status of a fit once it is checked, and sentences beside it; from those before."""
    notes = (*fit.trials.notes, *notes)
    if status in (
        FitStatus.NO_TRIALS, FitStatus.REVERSED, FitStatus.ONE_SIDED, FitStatus.NOT_CONVERGED,
    ):  # fmt: skip
        return status, notes
    table = checks(fit)
    fired = table[table["p"] < FALSE_ALARMS / max(len(table), 1)]
    notes = (*notes, *(_in_words(fit, str(name), row) for name, row in fired.iterrows()))
    named = next((s for s, by in SEEN_BY.items() if fired.index.isin(by).any()), None)
    if named is not None and status is not FitStatus.GIVEN:
        return named, notes
    if status is FitStatus.DETERMINED and (too_few_kinds(fit.model) or _moved_by_beliefs(fit)):
        return FitStatus.PRIOR_DEPENDENT, notes
    return status, notes


def _moved_by_beliefs(fit: Estimates) -> bool:
    """Whether a belief about lapses that the answers do not refute puts k out of its interval."""
    table, (low, high) = fit.lapse_sensitivity, fit.interval()
    outside = (table["weber_fraction"] < low) | (table["weber_fraction"] > high)
    return bool((outside & (table["log_bayes_factor"] > -np.log(REFUTED))).any())


def _in_words(fit: Estimates, name: str, row: pd.Series) -> str:
    if name == "streaks":
        return (
            "The answers come in streaks: states of engagement explain them better than one state, "
            f"by a log Bayes factor of {row['observed']:.3g}."
        )
    if name == "levels":
        worst = fit.residuals().sort_values("z", key=np.abs).iloc[-1]
        return (
            f"The curve misses the data (posterior-predictive p = {row['p']:.2g}), most at "
            f"{worst['stimulus_1']:.4g} against {worst['stimulus_2']:.4g}: "
            f"{worst['observed']:.2f} seen, {worst['expected']:.2f} expected."
        )
    return (
        f"The data show what this observer does not ({name}: {row['observed']:.3g}, where "
        f"{row['expected']:.3g} is expected; posterior-predictive p = {row['p']:.2g})."
    )


def advice(fit: Estimates) -> str | None:
    """What to write next where the model does not hold, or hangs on beliefs."""
    several = len(fit.trials.sessions) > 1
    fewer = (
        f"take fewer sessions at once, trials.select(session={fit.trials.sessions[-1]!r})"
        if several
        else "look for what changed within the session"
    )
    if fit.status is FitStatus.MISFIT_STREAKS:
        new = several and "drift" not in fit.effects
        either = f" and {_with(fit, 'Drift')}" if new else ""
        return (
            f"Nothing yet: first {_with(fit, states=3)}{either}, and keep the fit with the "
            "greatest log_evidence."
        )
    if fit.status is FitStatus.MISFIT_HISTORY:
        missing = [
            effect
            for effect, name in (("History", "history"), ("WinStay", "win_stay"))
            if name not in fit.effects
        ]
        return f"Nothing yet: first {_with(fit, *missing) if missing else fewer}."
    if fit.status is FitStatus.MISFIT_DRIFT:
        new = several and "drift" not in fit.effects
        return f"Nothing yet: first {_with(fit, 'Drift') + ', or ' if new else ''}{fewer}."
    if fit.status is FitStatus.MISFIT_OVERDISPERSION:
        new = fit.model.n_states == 1 and fit.model.dispersed is None
        return f"Nothing yet: first {_with(fit, 'Overdispersion') if new else fewer}."
    if fit.status is FitStatus.MISFIT_CURVE:
        model = fit.model
        if model.task.has_bias and fit.bias != "per standard" and fit.standards.size > 1:
            return f"Nothing yet: first {_with(fit, bias='per standard')}."
        if fit.noise == "weber":
            return f"Nothing yet: first {_with(fit, noise='equal-variance')}, or an encoding."
        return f"Nothing yet: first {fewer}."
    if fit.status is FitStatus.PRIOR_DEPENDENT:
        return (
            "Easy comparisons, further from the standard than any so far: they alone determine the "
            "lapses. Or state what is known of them, priors={'lapse_low': 0.02, 'lapse_high': "
            "0.02}, say."
        )
    return None


def _with(fit: Estimates, *more: str, **changed: Any) -> str:
    """The same fit with more effects or another option, as one would write it."""
    own = fit.model.effects
    names = dict.fromkeys([*(type(effect).__name__ for effect in own), *more])
    made = [*(effect.typed for effect in own), *(f"{name}()" for name in more)]
    usual = {"bias": "shared" if fit.model.task.has_bias else "none", "noise": "weber", "states": 1}
    options = {"bias": fit.bias, "noise": fit.noise, "states": fit.model.n_states} | changed
    said = [f"effects=[{', '.join(made)}]"] if made else []
    for name, value in options.items():
        if value != usual[name]:
            said.append(f'{name}="{value}"' if isinstance(value, str) else f"{name}={value}")
    call = f"fit_weber({', '.join(['trials', *said])})"
    imported = f", with from weberwhisk.behaviour.effects import {', '.join(names)}"
    return call + imported * bool(names)
