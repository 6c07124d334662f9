"""What is written on a fit once its checks are known: status, notes, and advice.

A fit of a model that does not hold, or that depends on what was believed beforehand, has that as
its status.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from scipy.special import bdtr, ndtri

from .._util.checks import generator, one_of
from .._util.refusals import Advice, Refusal, argument, call
from .._util.values import Array
from .directions import LOOKED_FOR
from .effects import Effect
from .estimates import Estimates, compared
from .formula import Term
from .likelihood import encoding_of
from .predictive import Answers, is_near, summed, threshold
from .prior_sensitivity import moving, sentence_of
from .priors import PARAMETERS, priors_for
from .trials import STIMULI
from .verdict import FitStatus, too_few_kinds

__all__ = ["advice", "judged", "quantile_residuals", "residuals_by", "unweighed"]


def residuals_by(fit: Estimates, *columns: str) -> pd.DataFrame:
    """Observed and expected proportions by session, or by any columns of the table.

    Parameters
    ----------
    fit : WeberFit
    *columns : str
        Of `fit.trials.frame`: `"session"`, or `"session", "standard"`, and so on.

    Returns
    -------
    DataFrame
        The columns, `n`, `observed`, `expected` and `z`, their difference in standard errors.

    Examples
    --------
    >>> from weberwhisk import fit_weber, simulate_trials
    >>> fit = fit_weber(simulate_trials(sessions=4, seed=1))
    >>> residuals_by(fit, "session").columns.tolist()
    ['session', 'n', 'observed', 'expected', 'z']
    """
    answers = Answers.of(fit)
    if not columns:
        raise Refusal(
            "no column was named", remedy="write ww.behaviour.residuals_by(fit, 'session'), say"
        )
    for column in columns:
        one_of("column", column, map(str, answers.frame.columns))
    p = _expected(fit, answers).mean(axis=0)
    table = answers.frame[list(columns)].assign(
        n=answers.n, count=answers.count, mean=answers.n * p, variance=answers.n * p * (1 - p)
    )
    sums = table.groupby(list(columns), sort=True).sum().reset_index()
    n, count, mean, variance = sums[["n", "count", "mean", "variance"]].to_numpy(float).T
    return sums[list(columns)].assign(**compared(n, count, mean, variance))


def quantile_residuals(fit: Estimates, seed: int = 1) -> pd.DataFrame:
    """Randomised quantile residuals (Dunn & Smyth 1996), by pair of stimuli and session.

    Returns
    -------
    DataFrame
        `session` if there is one, `standard`, `stimulus_1`, `stimulus_2`, `n`, `count`, `pit`
        (the probability integral transform: uniform between 0 and 1 if the model holds) and `z`,
        its normal score: standard normal.

    Examples
    --------
    >>> from weberwhisk import fit_weber, simulate_trials
    >>> table = quantile_residuals(fit_weber(simulate_trials(sessions=4, seed=1)))
    >>> bool(abs(table["z"].mean()) < 0.5)
    True
    """
    answers = Answers.of(fit)
    labels = [c for c in ("session", *STIMULI) if c in answers.frame]
    table = answers.frame[labels].assign(cell=answers.cell, n=answers.n, count=answers.count)
    groups = table.groupby([*labels, "cell"], sort=True)
    gathered = groups[["n", "count"]].sum().reset_index().drop(columns="cell")
    group = groups.ngroup().to_numpy().astype(np.intp)
    p = summed(_expected(fit, answers) * answers.n, group) / gathered["n"].to_numpy(float)
    n, count = (gathered[c].to_numpy(float) for c in ("n", "count"))
    whole = n.astype(np.int64)
    upper = bdtr(count, whole, p).mean(axis=0)
    lower = np.where(count > 0, bdtr(np.maximum(count - 1, 0), whole, p).mean(axis=0), 0.0)
    u = generator(seed).random(count.size)
    pit = np.clip(lower + u * (upper - lower), 1e-12, 1 - 1e-12)
    return gathered.assign(pit=pit, z=ndtri(pit))


def _expected(fit: Estimates, answers: Answers) -> Array:
    """P of every row at some draws, (D, R)."""
    return fit.model.by_row(fit.posterior.draws().thinned(1000), answers.cell)[0]


#: What each misfit is seen by, the first that is there being the status where no cause is found.
SEEN_BY = {
    FitStatus.MISFIT_STREAKS: ("streaks",),
    FitStatus.MISFIT_HISTORY: ("repetition", "outcome"),
    FitStatus.MISFIT_CURVE: (
        "contraction", "exponent", "noise_by_order", "standard_second", "levels",
    ),
    FitStatus.MISFIT_DRIFT: ("sessions", "drift", "trend"),
    FitStatus.MISFIT_OVERDISPERSION: ("overdispersion",),
}  # fmt: skip
#: Statuses that say why there is nothing to check.
UNCHECKED = (
    FitStatus.NO_TRIALS, FitStatus.REVERSED, FitStatus.ONE_SIDED, FitStatus.NOT_CONVERGED,
)  # fmt: skip


def unweighed(fit: Estimates, status: FitStatus) -> FitStatus:
    """The status of a fit once it is checked, from that before, whatever a misfit does to k."""
    if status in (*UNCHECKED, FitStatus.GIVEN):
        return status
    fired = _fired(fit)
    named = next((s for s, by in SEEN_BY.items() if fired.isin(by).any()), None)
    return status if named is None else named


def _fired(fit: Estimates) -> pd.Index:
    """The checks that see a misfit."""
    table = fit.checked
    return table.index[table["p"] < threshold(table)]


def _is_unexplained(fit: Estimates) -> bool:
    """Whether a misfit is seen by more than the directions of effects, which have been tried."""
    return fit.unweighed.is_misfit and not _fired(fit).isin([e.name for e in LOOKED_FOR]).all()


def judged(
    fit: Estimates, status: FitStatus, notes: tuple[str, ...]
) -> tuple[FitStatus, tuple[str, ...]]:
    """The status of a fit once it is checked and what the checks see is weighed, and sentences
    beside it; from those before."""
    notes = (*fit.trials.notes, *notes)
    if status in UNCHECKED:
        return status, notes
    table = fit.checked
    at = threshold(table)
    fired = table[table["p"] < at]
    notes = (*notes, *(_in_words(fit, str(name), row) for name, row in fired.iterrows()))
    for name, p in table["p"].items():
        if is_near(p, at):
            notes = (*notes, f"The check {name} is near its threshold, {at:.2g}, with p = {p:.2g}: "
                     "more trials are needed to say whether the model holds.")  # fmt: skip
    by_checks = unweighed(fit, status)
    if by_checks.is_misfit:
        cause = fit.search.chosen
        if cause is None:
            notes = (*notes, _NO_CAUSE)
            if _is_unexplained(fit):
                return by_checks, notes
        elif _is_unexplained(cause.fit):
            return cause.causes[0].status, (*notes, _NOT_ALL)
        elif fit.search.matters:
            return cause.causes[0].status, notes
    if status is FitStatus.DETERMINED:
        deciding = moving(fit.prior_sensitivity)
        if len(deciding) or too_few_kinds(fit.model):
            said = (sentence_of(str(belief), row) for belief, row in deciding.iterrows())
            return FitStatus.PRIOR_DEPENDENT, (*notes, *said)
    return status, notes


_NO_CAUSE = "None of the causes that were tried has strong evidence."
_NOT_ALL = (
    "With what the answers show the checks still see a misfit, and it is not known how much the "
    "rest matters for the Weber fraction."
)


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
    remark = fit.unweighed.is_misfit and not fit.status.ok and fit.search.chosen is not None
    if fit.status.is_misfit or remark:
        cause = fit.search.chosen
        if cause is None or _is_unexplained(cause.fit):
            return Advice.joined("", ["Nothing yet: first ", _to_look_at(fit), "."])
        options = {
            "bias": (fit.bias, cause.fit.bias),
            "noise": (fit.noise, cause.fit.noise),
            "states": (fit.model.n_states, cause.fit.model.n_states),
        }
        changed = {name: now for name, (before, now) in options.items() if now != before}
        effects = [effect for one in cause.causes for effect in one.effects]
        return "Nothing yet: first " + _with(fit, *effects, **changed) + "."
    if fit.status is FitStatus.PRIOR_DEPENDENT:
        deciding = moving(fit.prior_sensitivity)
        belief = str(deciding.index[0]) if len(deciding) else "lapses"
        if belief == fit.model.task.bias_name:
            return "Comparisons about the one at which either answer is as likely."
        if belief == "weber_fraction":
            return "More trials of the same kind, or a belief about k that you can defend."
        if belief == "lapses":
            return (
                "Easy comparisons, further from the standard than any so far: they alone determine "
                "the lapses. Or state what is known of them, "
                + argument("priors", {"lapse_low": 0.02, "lapse_high": 0.02})
                + ", say."
            )
        return "More trials of the same kind, or a belief that you can defend."
    return None


def _to_look_at(fit: Estimates) -> str:
    """What to look at where no cause explains a misfit."""
    if len(fit.trials.sessions) > 1:
        last = call("trials.select", argument("session", fit.trials.sessions[-1]))
        return "look at the sessions one by one, " + last
    formula = argument("effects", ["k ~ condition"])
    return "look for what changed between the trials; a column that says it goes in as " + formula


def _with(fit: Estimates, *more: Effect, **changed: Any) -> Advice:
    """The same fit with more effects or another option, as one would write it."""
    effects = [*{e.typed: e for e in (*fit.model.effects, *more)}.values()]
    names = dict.fromkeys(type(e).__name__ for e in effects if not isinstance(e, Term))
    usual = {"bias": "shared" if fit.model.task.has_bias else "none", "noise": "weber", "states": 1}
    options = {"bias": fit.bias, "noise": fit.noise, "states": fit.model.n_states} | changed
    given = [argument("effects", effects)] if effects else []
    given += [argument(name, value) for name, value in options.items() if value != usual[name]]
    module = "weberwhisk.behaviour.effects"
    imported = f", with from {module} import {', '.join(names)}"
    return call("fit_weber", "trials", *given, also=imported * bool(names)) + _kept(fit)


def _kept(fit: Estimates) -> str:
    """What else such a fit takes from this one, where this one has it of its own."""
    model, trials = fit.model, fit.trials
    usual = encoding_of(trials, None, None, fit.noise)
    effects = {effect.name: effect.prior for effect in model.effects}
    believed = priors_for(None, model.cells, trials.unit_known, model.task, effects)
    changed = [believed.words(n) != model.priors.words(n) for n in (*PARAMETERS, *effects)]
    differing = ["encoding"] * (fit.encoding != usual) + ["priors"] * any(changed)
    return f", and the {' and '.join(differing)} of this fit" if differing else ""
