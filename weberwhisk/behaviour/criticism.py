"""Where a fitted observer misses the data, and what is written on its fit once that is known.

Every check sets the residuals of the data beside those of data that the fitted observer would give
to the same trials (posterior-predictive; Gelman, Meng & Stern 1996). A p near 0 says that the
model does not make such data; any other says that nothing is wrong *there*. A fit of a model that
does not hold, or that hangs on what was believed beforehand, has that as its status.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.special import bdtr, ndtri

from .._util.checks import generator, one_of
from .._util.refusals import Advice, Refusal, argument, call
from .._util.values import Array, Flags, Index
from .effects import Drift, Effect, History, Overdispersion, WinStay
from .encodings import encoding_for
from .estimates import Estimates, check_fit, compared
from .likelihood import gather
from .priors import PARAMETERS, priors_for
from .states import streaks
from .trials import STIMULI
from .verdict import FitStatus, too_few_kinds

__all__ = [
    "FALSE_ALARMS", "Answers", "advice", "checks", "judged", "quantile_residuals",
    "residuals_by",
]  # fmt: skip

SIGNED = ("trend", "repetition", "outcome")  # checks that may be off on either side


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
    rows = Answers.of(fit)
    if not columns:
        raise Refusal(
            "no column was named", remedy="write ww.behaviour.residuals_by(fit, 'session'), say"
        )
    for column in columns:
        one_of("column", column, map(str, rows.frame.columns))
    p = _expected(fit, rows).mean(axis=0)
    table = rows.frame[list(columns)].assign(
        n=rows.n, count=rows.count, mean=rows.n * p, spread=rows.n * p * (1 - p)
    )
    sums = table.groupby(list(columns), sort=True).sum().reset_index()
    n, count, mean, spread = sums[["n", "count", "mean", "spread"]].to_numpy(float).T
    return sums[list(columns)].assign(**compared(n, count, mean, spread))


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
    rows = Answers.of(fit)
    gathered, group = rows.gathered()
    p = _summed(_expected(fit, rows) * rows.n, group) / gathered["n"].to_numpy(float)
    n, count = (gathered[c].to_numpy(float) for c in ("n", "count"))
    whole = n.astype(np.int64)
    upper = bdtr(count, whole, p).mean(axis=0)
    lower = np.where(count > 0, bdtr(np.maximum(count - 1, 0), whole, p).mean(axis=0), 0.0)
    u = generator(seed).random(count.size)
    pit = np.clip(lower + u * (upper - lower), 1e-12, 1 - 1e-12)
    return gathered.assign(pit=pit, z=ndtri(pit))


def checks(fit: Estimates, seed: int = 1) -> pd.DataFrame:
    """Posterior-predictive checks of what animals do and a stationary observer does not.

    Parameters
    ----------
    fit : WeberFit
    seed : int
        Of the replicated data.

    Returns
    -------
    DataFrame
        Index `check`; `observed`, `expected` (mean over replicated data), `p` (the share of
        replicated data with as great a value, or as far from zero for those that have a sign; small
        where the data have too much of it), and `remedy`. Checks: `levels`: squared residuals over
        pairs of stimuli. `overdispersion`: the intraclass correlation of the answers to one pair
        in one session. `sessions`: squared residuals of whole sessions. `trend`: correlation of
        residuals with the course of trials. `repetition`: correlation of a residual with the one
        before; `outcome`: with the side that was right on the trial before, as when wins stay and
        losses shift. `streaks`: the log Bayes factor of two or three states (each as likely) over
        one; its `p` is one over the Bayes factor, an upper bound for an observer in one state
        (Markov's inequality). `sessions` needs two sessions or more, those from `trend` on a row a
        trial, in order, and `outcome` and `streaks` the choice of a stimulus.

    Examples
    --------
    >>> from weberwhisk import fit_weber, simulate_trials
    >>> table = checks(fit_weber(simulate_trials(sessions=4, seed=1)))
    >>> table.index.tolist()
    ['levels', 'overdispersion', 'sessions', 'trend', 'repetition', 'outcome', 'streaks']
    >>> bool((table["p"] > 0.001).all())
    True
    """
    rows = Answers.of(fit)
    if not len(rows.frame):
        return pd.DataFrame(columns=["observed", "expected", "p", "remedy"])
    draws = fit.posterior.draws().thinned(250)  # every trial is looked at
    rng = generator(seed)
    statistics = rows.statistics(fit.model.task.bias_name == "bias")
    # (seen, made) of every statistic; few draws at a time where there are many rows.
    values: dict[str, list[tuple[Array, Array]]] = {name: [] for name in statistics}
    stride = max(2_000_000 // rows.n.size, 1)  # numbers that are in memory together
    for start in range(0, len(draws), stride):
        p, q = fit.model.by_row(draws.at(slice(start, start + stride)), rows.cell)
        again = rng.binomial(rows.n.astype(np.int64), np.clip(p, 0, 1)).astype(float)
        spread = np.maximum(rows.n * p * q, 1e-12)
        for name, (statistic, _) in statistics.items():
            off = rows.count - rows.n * p, again - rows.n * p
            values[name].append((statistic(off[0], spread), statistic(off[1], spread)))
    out = {}
    for name, (_, remedy) in statistics.items():
        seen, made = (np.concatenate(parts) for parts in zip(*values[name], strict=True))
        greater = np.abs(made) >= np.abs(seen) if name in SIGNED else made >= seen
        out[name] = seen.mean(), made.mean(), float(np.mean(greater)), remedy
    if (factor := _streaks(fit, rng)) is not None:
        out["streaks"] = factor, 0.0, float(np.exp(-max(factor, 0.0))), "states=3"
    columns = ["observed", "expected", "p", "remedy"]
    return pd.DataFrame.from_dict(out, "index", columns=columns).rename_axis("check")


@dataclass(frozen=True)
class Answers:
    """The rows of a table that have an answer, and the cell of the model that each belongs to.

    `follows` says which are the trial right after the row before, with no gap between them; it is
    None where the rows are no course of time.
    """

    frame: pd.DataFrame
    n: Array
    count: Array
    cell: Index
    follows: Flags | None = None

    @classmethod
    def of(cls, fit: Estimates) -> Answers:
        check_fit(fit)
        trials = fit.trials
        _, _, cell = gather(trials, fit.model.effects, fit.encoding)
        frame = trials.frame.loc[trials.answered].reset_index(drop=True)
        n, count = (frame[name].to_numpy(float) for name in ("n", "count"))
        follows = None
        if trials.course.is_known:
            after_answer = trials.follows & np.r_[False, trials.answered[:-1]]
            follows = after_answer[trials.answered]
        return cls(frame, n, count, cell, follows)

    def gathered(self) -> tuple[pd.DataFrame, Index]:
        """Answers of one pair of stimuli in one session together, and which each row is in."""
        labels = [c for c in ("session", *STIMULI) if c in self.frame]
        table = self.frame[labels].assign(cell=self.cell, n=self.n, count=self.count)
        groups = table.groupby([*labels, "cell"], sort=True)
        sums = groups[["n", "count"]].sum().reset_index().drop(columns="cell")
        return sums, groups.ngroup().to_numpy().astype(np.intp)

    def statistics(self, is_choice: bool) -> dict[str, tuple[Callable[[Array, Array], Array], str]]:
        """Statistics of residuals (D, R) and their variances, each with a remedy; of the choice of
        a stimulus one more."""
        pairs = _codes(self.cell)
        sessions = _codes(self.frame["session"].to_numpy()) if "session" in self.frame else None
        both = pairs if sessions is None else _codes(pairs * (sessions.max() + 1) + sessions)
        # Moment estimate of ρ: the variance of a count is n P (1 − P) (1 + (n − 1) ρ).
        more = max(float((np.bincount(both, self.n) - 1).sum()), 1.0)
        out: dict[str, tuple[Callable[[Array, Array], Array], str]] = {
            "levels": (
                lambda off, spread: _squares(off, spread, pairs).mean(axis=1),
                "another noise, encoding, or bias per standard",
            ),
            "overdispersion": (
                lambda off, spread: (_squares(off, spread, both) - 1).sum(axis=1) / more,
                "the effect Overdispersion, or fewer sessions",
            ),
        }
        if sessions is not None and sessions.max() > 0:
            out["sessions"] = (
                lambda off, spread: _squares(off, spread, sessions).mean(axis=1),
                "the effect Drift, or fewer sessions",
            )
        if self.follows is not None and self.n.size > 2:
            course = np.linspace(-1, 1, self.n.size)
            course /= (course @ course) ** 0.5 * np.sqrt(course.size)
            follows = self.follows[1:]
            out["trend"] = (
                lambda off, spread: (off / np.sqrt(spread)) @ course,
                "a bias that drifts: fewer sessions",
            )

            def repeated(off: Array, spread: Array) -> Array:
                z = off / np.sqrt(spread)
                return np.asarray((z[:, 1:] * z[:, :-1])[:, follows].mean(axis=1))

            if follows.any():
                out["repetition"] = repeated, "the effect History"
            s1, s2 = (self.frame[name].to_numpy(float) for name in STIMULI[1:])
            right = (np.sign(s2 - s1)[:-1] * follows) / max(follows.sum(), 1)
            if is_choice and right.any():
                out["outcome"] = (
                    lambda off, spread: (off / np.sqrt(spread))[:, 1:] @ right,
                    "the effect WinStay",
                )
        return out


def _streaks(fit: Estimates, rng: np.random.Generator) -> float | None:
    """The log Bayes factor of states over one; None where there can be no states."""
    model, trials = fit.model, fit.trials
    single = trials.course.is_known
    plain = model.n_states == 1 and model.task.has_bias and model.dispersed is None
    if not (single and plain) or fit.log_evidence is None:
        return None
    return streaks(model, fit.log_evidence, trials, fit.encoding, rng)


def _codes(labels: NDArray[Any]) -> Index:
    return np.unique(labels, return_inverse=True)[1].reshape(-1)


def _summed(values: Array, group: Index) -> Array:
    """Sums by group along the last axis, (D, G)."""
    shape = len(values), int(group.max()) + 1
    place = np.arange(shape[0])[:, None] * shape[1] + group
    sums = np.bincount(place.ravel(), values.ravel(), minlength=shape[0] * shape[1])
    return np.asarray(sums.reshape(shape), dtype=float)


def _squares(off: Array, spread: Array, group: Index) -> Array:
    """Squared residuals of groups, in their variances, (D, G)."""
    return np.asarray(_summed(off, group) ** 2 / _summed(spread, group))


def _expected(fit: Estimates, rows: Answers) -> Array:
    """P of every row at some draws, (D, R)."""
    return fit.model.by_row(fit.posterior.draws().thinned(1000), rows.cell)[0]


#: Share of stationary animals in which some check may fire: each has its part of it.
FALSE_ALARMS = 0.05
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
    of_table = dict.fromkeys((*fit.trials.notes, fit.trials.course.note))
    notes = (*filter(None, of_table), *notes)
    if status in (
        FitStatus.NO_TRIALS, FitStatus.REVERSED, FitStatus.ONE_SIDED, FitStatus.NOT_CONVERGED,
    ):  # fmt: skip
        return status, notes
    table = fit.checked
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
    believable = table["log_bayes_factor"] > -np.log(10.0)  # odds of 10 against it refute it
    return bool((outside & believable).any())


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
    fewer: str = "look for what changed within the session"
    if several:
        last = call("trials.select", argument("session", fit.trials.sessions[-1]))
        fewer = "take fewer sessions at once, " + last
    if fit.status is FitStatus.MISFIT_STREAKS:
        new = several and "drift" not in fit.effects
        either = " and " + _with(fit, Drift()) if new else ""
        best = ", and keep the fit with the greatest log_evidence."
        return "Nothing yet: first " + _with(fit, states=3) + either + best
    if fit.status is FitStatus.MISFIT_HISTORY:
        missing = [e for e in (History(), WinStay()) if e.name not in fit.effects]
        return Advice.joined(
            "", ["Nothing yet: first ", _with(fit, *missing) if missing else fewer, "."]
        )
    if fit.status is FitStatus.MISFIT_DRIFT:
        new = several and "drift" not in fit.effects
        return Advice.joined(
            "", ["Nothing yet: first ", _with(fit, Drift()) + ", or " if new else "", fewer, "."]
        )
    if fit.status is FitStatus.MISFIT_OVERDISPERSION:
        new = fit.model.n_states == 1 and fit.model.dispersed is None
        return Advice.joined(
            "", ["Nothing yet: first ", _with(fit, Overdispersion()) if new else fewer, "."]
        )
    if fit.status is FitStatus.MISFIT_CURVE:
        model = fit.model
        if model.task.has_bias and fit.bias != "per standard" and fit.standards.size > 1:
            return "Nothing yet: first " + _with(fit, bias="per standard") + "."
        if fit.noise == "weber":
            return "Nothing yet: first " + _with(fit, noise="equal-variance") + ", or an encoding."
        return Advice.joined("", ["Nothing yet: first ", fewer, "."])
    if fit.status is FitStatus.PRIOR_DEPENDENT:
        return (
            "Easy comparisons, further from the standard than any so far: they alone determine the "
            "lapses. Or state what is known of them, "
            + argument("priors", {"lapse_low": 0.02, "lapse_high": 0.02})
            + ", say."
        )
    return None


def _with(fit: Estimates, *more: Effect, **changed: Any) -> Advice:
    """The same fit with more effects or another option, as one would write it."""
    effects = [*fit.model.effects, *more]
    names = dict.fromkeys(type(effect).__name__ for effect in effects)
    usual = {"bias": "shared" if fit.model.task.has_bias else "none", "noise": "weber", "states": 1}
    options = {"bias": fit.bias, "noise": fit.noise, "states": fit.model.n_states} | changed
    given = [argument("effects", effects)] if effects else []
    given += [argument(name, value) for name, value in options.items() if value != usual[name]]
    imported = f", with from weberwhisk.behaviour.effects import {', '.join(names)}"
    return call("fit_weber", "trials", *given, also=imported * bool(names)) + _kept(fit)


def _kept(fit: Estimates) -> str:
    """What else such a fit takes from this one, where this one has it of its own."""
    model, trials = fit.model, fit.trials
    usual = encoding_for(trials.scale, trials.log_unit, fit.noise)
    effects = {effect.name: effect.prior for effect in model.effects}
    believed = priors_for(None, model.cells, trials.unit_known, model.task, effects)
    other = [believed.words(n) != model.priors.words(n) for n in (*PARAMETERS, *effects)]
    own = ["encoding"] * (fit.encoding != usual) + ["priors"] * any(other)
    return f", and the {' and '.join(own)} of this fit" if own else ""
