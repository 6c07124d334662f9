"""Posterior-predictive checks: what animals do and the fitted observer does not.

Every check sets a statistic of the residuals of the data beside the same of data that the fitted
observer would give to the same trials (Gelman, Meng & Stern 1996). Its p is the share of replicated
data with as great a value. A p near 0 says that the model does not make such data; any other says
that nothing is wrong *there*. Replicates are drawn until p is known to lie on one side of the
threshold of the verdict, and by a stream that does not depend on the seed of the fit.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from .._util.checks import generator
from .._util.values import Array, Flags, Index
from .directions import directions
from .effects import EFFECTS
from .estimates import Estimates, check_fit
from .likelihood import gather
from .states import streaks
from .trials import STIMULI

__all__ = ["FALSE_ALARMS", "Answers", "checks", "is_near", "threshold"]

#: Share of stationary animals in which some check may fire: each has its part of it.
FALSE_ALARMS = 0.05
#: Replicated data sets of a round, and in all where p is near its threshold: within a factor of 1.5
#: of it, 8000 do not tell the sides apart to 2.5 sds.
ROUND, MOST, NEAR, SDS = 250, 8000, 1.5, 2.5
#: Effective draws behind the evidence of states: of 200 right to a tenth of a nat.
DRAWS_OF_STATES, DRAWS_NEAR = 200.0, 3000.0


def threshold(table: pd.DataFrame) -> float:
    """Below which p a check of the table fires."""
    return FALSE_ALARMS / max(len(table), 1)


def is_near(p: float, at: float) -> bool:
    """Whether a p is within a factor of 1.5 of its threshold."""
    return at / NEAR < p < at * NEAR


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
        where the data have too much of it), `replicates`, how many data sets that is a share of,
        more where it is near the threshold of a verdict, and `remedy`. Checks: `levels`: squared
        residuals over pairs of stimuli. `overdispersion`: the intraclass correlation of the answers
        to one pair in one session. `contraction`, `exponent`, `noise_by_order`, `standard_second`,
        `drift`: residuals along what the effect of that name would change, where the table can show
        it, in sds. `sessions`: squared residuals of whole sessions. `trend`:
        correlation of residuals with the course of trials. `repetition`: correlation of a residual
        with the one before; `outcome`: with the side that was right on the trial before, as when
        wins stay and losses shift. `streaks`: the log Bayes factor of two or three states (each as
        likely) over one; its `p` is one over the Bayes factor, an upper bound for an observer in
        one state (Markov's inequality). `sessions` needs two sessions or more, those from `trend`
        on a row a trial, in order, and `outcome` and `streaks` the choice of a stimulus.

    Examples
    --------
    >>> from weberwhisk import fit_weber, simulate_trials
    >>> table = checks(fit_weber(simulate_trials(sessions=4, seed=1)))
    >>> table.index.tolist()
    ['levels', 'overdispersion', 'sessions', 'exponent', 'noise_by_order', 'drift', 'trend',
     'repetition', 'outcome', 'streaks']
    >>> bool((table["p"] > 0.001).all())
    True
    """
    answers = Answers.of(fit)
    columns = ["observed", "expected", "p", "replicates", "remedy"]
    if not answers.n.size:
        return pd.DataFrame(columns=columns)
    # The answers of an observer without memory to one pair in a session are one count.
    counts = answers.merged() if fit.model.n_states == 1 else answers
    of_counts = counts.of_counts() | counts.along(directions(fit))
    of_rows = answers.of_rows(fit.model.task.bias_name == "bias")
    with_states = _can_have_states(fit)
    at = FALSE_ALARMS / (len(of_counts) + len(of_rows) + with_states)
    rng = generator(seed)
    out = {}
    for given, statistics in ((counts, of_counts), (answers, of_rows)):
        for name, tally in _replicated(fit, given, statistics, at, rng).items():
            statistic = statistics[name]
            out[name] = (tally.observed, tally.expected, tally.p, tally.count, statistic.remedy)
    if with_states:
        factor = _streaks(fit, at)
        out["streaks"] = factor, 0.0, float(np.exp(-max(factor, 0.0))), 0, "states=3"
    return pd.DataFrame.from_dict(out, "index", columns=columns).rename_axis("check")


def _can_have_states(fit: Estimates) -> bool:
    model = fit.model
    plain = model.n_states == 1 and model.task.has_bias
    plain = plain and model.dispersed is None and model.by_session is None
    return fit.trials.course.is_known and plain and fit.log_evidence is not None


def _streaks(fit: Estimates, at: float) -> float:
    """The log Bayes factor of states over one, by more draws where that is near the threshold."""
    assert fit.log_evidence is not None
    given = fit.model, fit.log_evidence, fit.trials, fit.encoding
    factor = streaks(*given, DRAWS_OF_STATES)
    if is_near(np.exp(-factor), at):
        factor = streaks(*given, DRAWS_NEAR)
    return factor


# -- replicated data -------------------------------------------------------------------------------


@dataclass
class Tally:
    """Replicates so far: how many, in how many the statistic is as great, and sums of it."""

    count: int = 0
    greater: int = 0
    of_data: float = 0.0
    of_replicates: float = 0.0

    def add(self, of_data: Array, of_replicates: Array, signed: bool) -> None:
        """Statistics (D,) of the data and of the replicates, given the same draws."""
        size = np.abs if signed else np.asarray
        greater = size(of_replicates) >= size(of_data)
        self.count += greater.size
        self.greater += int(greater.sum())
        self.of_data += float(of_data.sum())
        self.of_replicates += float(of_replicates.sum())

    @property
    def observed(self) -> float:
        """Mean over posterior draws."""
        return self.of_data / self.count

    @property
    def expected(self) -> float:
        """Mean over replicates."""
        return self.of_replicates / self.count

    @property
    def p(self) -> float:
        """Share of replicates with as great a statistic."""
        return self.greater / self.count

    def is_beside(self, at: float) -> bool:
        """Whether p may lie on either side of a threshold (Wilson's interval of 2.5 sds)."""
        n, p, square = self.count, self.p, SDS**2
        middle = p + square / (2 * n)
        half = SDS * np.sqrt(p * (1 - p) / n + square / (4 * n**2))
        return bool(middle - half < at * (1 + square / n) < middle + half)


def _replicated(
    fit: Estimates,
    answers: Answers,
    statistics: dict[str, Statistic],
    at: float,
    rng: np.random.Generator,
) -> dict[str, Tally]:
    """Replicates of all statistics, and more of those whose p is beside the threshold."""
    tallies = {name: Tally() for name in statistics}
    open_ones = list(statistics)
    draws = fit.posterior.reproducible_draws()
    every = max(len(draws) // ROUND, 1)
    size = max(2_000_000 // answers.n.size, 1)  # numbers that are in memory together
    for number in range(MOST // ROUND):
        if not open_ones:
            break
        given = draws.at(slice(number % every, None, every))
        for part in (slice(i, i + size) for i in range(0, len(given), size)):
            p, q = fit.model.by_row(given.at(part), answers.cell)
            again = answers.again(p, rng)
            variance = np.maximum(answers.n * p * q, 1e-12)
            off = answers.count - answers.n * p, again - answers.n * p
            for name in open_ones:
                statistic = statistics[name]
                of_data, of_replicates = (statistic.of(o, variance) for o in off)
                tallies[name].add(of_data, of_replicates, statistic.signed)
        open_ones = [name for name in open_ones if tallies[name].is_beside(at)]
    return tallies


@dataclass(frozen=True)
class Answers:
    """Answers of a table: n trials of each row, how many had the answer, the cell of the model, and
    the session, numbered; `frame` has the rows.

    `follows` says which are the trial right after the row before, with no gap between them; it is
    None where the rows are no course of time.
    """

    n: Array
    count: Array
    cell: Index
    session: Index
    frame: pd.DataFrame
    follows: Flags | None = None

    @classmethod
    def of(cls, fit: Estimates) -> Answers:
        """Those of the rows of a fit that have an answer."""
        check_fit(fit)
        trials = fit.trials
        _, _, cell = gather(trials, fit.model.effects, fit.encoding)
        frame = trials.frame.loc[trials.answered].reset_index(drop=True)
        n, count = (frame[name].to_numpy(float) for name in ("n", "count"))
        if "session" in frame:
            session = _numbered(frame["session"].to_numpy())
        else:
            session = np.zeros(n.size, dtype=np.intp)
        follows = None
        if trials.course.is_known:
            after_answer = trials.follows & np.r_[False, trials.answered[:-1]]
            follows = after_answer[trials.answered]
        return cls(n, count, cell, session, frame, follows)

    def merged(self) -> Answers:
        """The same with a row for each cell and session."""
        both = self.cell * (self.session.max() + 1) + self.session
        _, first, group = np.unique(both, return_index=True, return_inverse=True)
        n, count = (np.bincount(group.reshape(-1), a, first.size) for a in (self.n, self.count))
        return Answers(
            n.astype(float),
            count.astype(float),
            self.cell[first],
            self.session[first],
            self.frame.iloc[first],
        )

    def again(self, p: Array, rng: np.random.Generator) -> Array:
        """Counts that answers of probability p (D, R) would give."""
        if (self.n == 1).all():
            return (rng.random(p.shape) < p).astype(float)
        return rng.binomial(self.n.astype(np.int64), np.clip(p, 0, 1)).astype(float)

    def of_counts(self) -> dict[str, Statistic]:
        """Statistics of counts, whatever their order."""
        pairs = _numbered(self.cell)
        both = _numbered(pairs * (self.session.max() + 1) + self.session)
        out: dict[str, Statistic] = {
            "levels": Squares(pairs, "another noise, encoding, or bias per standard"),
            "overdispersion": Intraclass(both, float((np.bincount(both, self.n) - 1).sum())),
        }
        if self.session.max() > 0:
            out["sessions"] = Squares(self.session, "the effect Drift, or fewer sessions")
        return out

    def along(self, by_name: dict[str, Array]) -> dict[str, Statistic]:
        """Sums of residuals with the weights of effects, which are of the rows of the table."""
        place = self.frame.index
        return {
            name: Direction(weight[place], f"the effect {type(EFFECTS[name]).__name__}")
            for name, weight in by_name.items()
        }

    def of_rows(self, is_choice: bool) -> dict[str, Statistic]:
        """Statistics of single answers in order; of the choice of a stimulus one more."""
        if self.follows is None or self.n.size <= 2:
            return {}
        course, follows = np.linspace(-1, 1, self.n.size), self.follows[1:]
        out: dict[str, Statistic] = {
            "trend": Trend(course / np.sqrt(course.size * (course @ course)))
        }
        if follows.any():
            out["repetition"] = Repetition(follows)
        s1, s2 = (self.frame[name].to_numpy(float) for name in STIMULI[1:])
        right = (np.sign(s2 - s1)[:-1] * follows) / max(follows.sum(), 1)
        if is_choice and right.any():
            out["outcome"] = Outcome(right)
        return out


# -- statistics ------------------------------------------------------------------------------------


class Statistic(Protocol):
    """A statistic of residuals, with what to write where it is too great.

    `signed`: whether it may be too far from zero on either side.
    """

    @property
    def remedy(self) -> str: ...
    @property
    def signed(self) -> bool: ...
    def of(self, off: Array, variance: Array) -> Array:
        """Of residuals (D, R) with these variances, (D,)."""


@dataclass(frozen=True)
class Squares:
    """Mean squared residual of groups of rows, in their variances."""

    group: Index
    remedy: str
    signed = False

    def of(self, off: Array, variance: Array) -> Array:
        return np.asarray(_squares(off, variance, self.group).mean(axis=1))


@dataclass(frozen=True)
class Intraclass:
    """Moment estimate of ρ: the variance of a count is n P (1 − P) (1 + (n − 1) ρ).

    `more` is the sum of n − 1.
    """

    group: Index
    more: float
    remedy = "the effect Overdispersion, or fewer sessions"
    signed = False

    def of(self, off: Array, variance: Array) -> Array:
        squares = _squares(off, variance, self.group)
        return np.asarray((squares - 1).sum(axis=1) / max(self.more, 1.0))


@dataclass(frozen=True)
class Direction:
    """Sum of residuals with weights (R,), in its sds: the score of an effect."""

    weight: Array
    remedy: str
    signed = True

    def of(self, off: Array, variance: Array) -> Array:
        return np.asarray(off @ self.weight)


@dataclass(frozen=True)
class Trend:
    """Correlation with the course (R,) of trials."""

    course: Array
    remedy = "a bias that drifts: fewer sessions"
    signed = True

    def of(self, off: Array, variance: Array) -> Array:
        return np.asarray((off / np.sqrt(variance)) @ self.course)


@dataclass(frozen=True)
class Repetition:
    """Correlation with the residual before, where one `follows` in the session (R − 1,)."""

    follows: Flags
    remedy = "the effect History"
    signed = True

    def of(self, off: Array, variance: Array) -> Array:
        z = off / np.sqrt(variance)
        return np.asarray((z[:, 1:] * z[:, :-1])[:, self.follows].mean(axis=1))


@dataclass(frozen=True)
class Outcome:
    """Correlation with the side that was right on the trial before (R − 1,)."""

    right: Array
    remedy = "the effect WinStay"
    signed = True

    def of(self, off: Array, variance: Array) -> Array:
        return np.asarray((off / np.sqrt(variance))[:, 1:] @ self.right)


def _numbered(labels: NDArray[Any]) -> Index:
    return np.unique(labels, return_inverse=True)[1].reshape(-1)


def summed(values: Array, group: Index) -> Array:
    """Sums by group along the last axis, (D, G)."""
    shape = len(values), int(group.max()) + 1
    place = np.arange(shape[0])[:, None] * shape[1] + group
    sums = np.bincount(place.ravel(), values.ravel(), minlength=shape[0] * shape[1])
    return np.asarray(sums.reshape(shape), dtype=float)


def _squares(off: Array, variance: Array, group: Index) -> Array:
    """Squared residuals of groups, in their variances, (D, G)."""
    return np.asarray(summed(off, group) ** 2 / summed(variance, group))
