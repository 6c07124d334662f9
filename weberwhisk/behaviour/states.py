"""Animals that are engaged part of the time: a hidden Markov model over trials in their order.

Engaged, the animal is the observer of `fit_weber`. With two states it is else disengaged: its
answers do not depend on the stimuli, be they guesses or one side. With three it has two disengaged
states, in which it answers nearly always "first", or nearly always "second": the three of Ashwood
et al. (2022, Nature Neuroscience 25:201), whose engaged state obeys Weber's law here.

Before each trial the state is kept with probability 1 − `switch` and else drawn anew, so that
`engaged`, the probability of the engaged state in such a draw, is its share of trials in the long
run, and a session begins with a draw. Of two states this is any chain that is sticky; of three it
has three parameters instead of six. Trials without an answer pass time and say nothing, and so do
trials whose numbers are missing in a session.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from scipy import stats
from scipy.sparse import csr_array
from scipy.special import logsumexp

from .._util import checks
from .._util.importance import WeightedDraws
from .._util.refusals import Refusal, argument, named
from .._util.values import Array, Codes, Fields, Index, pd
from .encodings import Encoding
from .importance import EFFECTIVE, PASS, ImportancePosterior, Target
from .likelihood import Draws, WeberModel, gather
from .order import is_numbered, session_block
from .posteriors import split
from .priors import REACH
from .trials import Trials, needs_rows

__all__ = [
    "STATE_PRIORS", "StateDraws", "StateModel", "StatePosterior", "StateTarget", "States",
    "check_states", "engagement", "streaks", "with_states",
]  # fmt: skip

_UNIFORM, _SWITCH = stats.beta(1.0, 1.0), stats.beta(1.0, 19.0)
#: Parameters of two states and of three, and what is believed of them. A state lasts some tens of
#: trials (Ashwood et al. 2022); `side` is the share of "second" among disengaged trials, and
#: `answer_low` and `answer_high` are probabilities of that answer in either disengaged state.
STATE_PRIORS: dict[int, dict[str, Any]] = {
    2: {"engaged": _UNIFORM, "switch": _SWITCH, "answer_away": _UNIFORM},
    3: {
        "engaged": _UNIFORM,
        "switch": _SWITCH,
        "side": _UNIFORM,
        "answer_low": stats.beta(1.0, 9.0),
        "answer_high": stats.beta(9.0, 1.0),
    },
}


@dataclass(frozen=True, repr=False)
class States(Fields):
    """An animal that is engaged part of the time, to simulate one.

    Parameters
    ----------
    engaged : float
        Share of trials engaged, in the long run.
    switch : float
        Probability before each trial that the state is drawn anew.
    side : float
        Share of the disengaged trials in the state of `answer_high`.
    answer_low, answer_high : float
        Probability of "second greater" in either disengaged state.

    Examples
    --------
    >>> from weberwhisk import simulate_trials
    >>> trials = simulate_trials(states=States(engaged=0.7), seed=1)
    >>> sorted(trials.frame["state"].unique())
    ['engaged', 'high', 'low']
    """

    engaged: float = 0.7
    switch: float = 0.05
    side: float = 0.5
    answer_low: float = 0.05
    answer_high: float = 0.95

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            checks.between(name, getattr(self, name), "write for example 0.5", ends="[]")

    def drawn(self, frame: pd.DataFrame, uniform: Array) -> tuple[Index, Array]:
        """The state of each trial (0 is engaged) and its P of "second", by uniforms (2, R)."""
        ends = np.cumsum([self.engaged, (1 - self.engaged) * (1 - self.side)])
        fresh = np.searchsorted(ends, uniform[1], side="right")
        begins = np.diff(session_block(frame), prepend=-1) != 0
        anew = begins | (uniform[0] < self.switch)
        # A state that is kept is that of the last trial where one was drawn.
        state = fresh[np.maximum.accumulate(np.where(anew, np.arange(len(frame)), 0))]
        return state, np.array([np.nan, self.answer_low, self.answer_high])[state]


@dataclass(frozen=True)
class StateDraws(Draws):
    """Draws with those of the parameters of the states, (N, P)."""

    states: Array = field(default_factory=lambda: np.zeros((1, 0)))

    def at(self, place: Any) -> StateDraws:
        return StateDraws(*(values[place] for values in (*self.values, self.states)))

    def named(self, model: WeberModel) -> dict[str, Array]:
        assert isinstance(model, StateModel)
        of_states = dict(zip(model.state_names, self.states.T, strict=True))
        columns = super().named(model.observer) | of_states
        return {name: columns[name] for name in model.names}


@dataclass(frozen=True)
class StateModel(WeberModel):
    """An observer that is engaged part of the time.

    `chained` is the number of states. `cell` and `answer` have an entry a row of the table: its
    cell, and 0 or 1, or 2 where there is none. `passed` is how many trials after the one before it
    a row is; sessions begin at `begins`.
    """

    chained: int = 3
    cell: Index = field(default_factory=lambda: np.zeros(0, dtype=np.intp))
    answer: Index = field(default_factory=lambda: np.zeros(0, dtype=np.intp))
    passed: Array = field(default_factory=lambda: np.zeros(0))
    begins: Index = field(default_factory=lambda: np.zeros(0, dtype=np.intp))

    @property
    def n_states(self) -> int:
        return self.chained

    @property
    def state_names(self) -> tuple[str, ...]:
        """Parameters of the states."""
        return tuple(STATE_PRIORS[self.n_states])

    @property
    def free_states(self) -> tuple[str, ...]:
        """Those that are inferred."""
        return tuple(n for n in self.state_names if not self.priors.is_fixed(n))

    @property
    def names(self) -> tuple[str, ...]:
        return (*super().names, *self.free_states)

    def fixed_value(self, name: str) -> float:
        if name in self.state_names:
            return float(self.priors.of(name))
        return super().fixed_value(name)

    @cached_property
    def observer(self) -> WeberModel:
        """The same observer, engaged all the time."""
        own = {name: getattr(self, name) for name in WeberModel.__dataclass_fields__}
        return WeberModel(**own)

    def plain(self) -> WeberModel:
        return self.observer.plain()

    def draws_of(self, theta: Array) -> StateDraws:
        """Every parameter at free lead scores, biases and scores of the states, (N, D)."""
        observed = theta.shape[1] - len(self.free_states)
        plain = self.observer.draws_at(*split(self.observer, theta[:, :observed]))
        return self._joined(plain, theta[:, observed:])

    def _joined(self, plain: Draws, scores: Array) -> StateDraws:
        """Draws with states at normal scores of the free ones."""
        at = dict(zip(self.free_states, np.clip(scores, -REACH, REACH).T, strict=True))
        none = np.zeros(len(scores))
        states = [self.priors.value(name, at.get(name, none)) for name in self.state_names]
        return StateDraws(*plain.values, np.stack(states, axis=1))

    def completed(self, draws: Draws, rng: np.random.Generator) -> Draws:
        return self._joined(draws, rng.standard_normal((len(draws), len(self.free_states))))

    # -- the chain -------------------------------------------------------------------------------

    def shares(self, draws: StateDraws) -> Array:
        """Probability of each state where one is drawn, (K, N)."""
        own = dict(zip(self.state_names, draws.states.T, strict=True))
        away = 1 - own["engaged"]
        if self.n_states == 2:
            return np.stack([own["engaged"], away])
        return np.stack([own["engaged"], away * (1 - own["side"]), away * own["side"]])

    def said(self, draws: StateDraws) -> tuple[Array, Array]:
        """Probability of what a row says: engaged (2C + 1, N) by cell and answer, the last for no
        answer; and disengaged (3, K − 1, N) by answer."""
        p, q = self.probability(*draws.values)
        engaged = np.concatenate([q, p, np.ones((len(p), 1))], axis=1).T
        second = draws.states.T[1 - self.n_states :]
        away = np.stack([1 - second, second, np.ones(second.shape)])
        floor = partial(np.maximum, 1e-18)  # sixteen of them can be multiplied
        return floor(engaged), floor(away)

    @cached_property
    def said_at(self) -> Index:
        """The row of the table of what is said, engaged, that each trial has."""
        size = self.cells.n.size
        return np.where(self.answer == 2, 2 * size, self.cell + size * (self.answer == 1))

    @cached_property
    def steps(self) -> list[tuple[Index, Array | None]]:
        """Rows of all sessions that are the first, the second and so on of their session, longest
        session first, and how many trials passed before each, None where that is one."""
        length = np.diff(np.r_[self.begins, self.cell.size])
        begins = self.begins[np.argsort(-length, kind="stable")]
        length = -np.sort(-length)
        out: list[tuple[Index, Array | None]] = []
        for t in range(int(length.max(initial=0))):
            rows = begins[length > t] + t
            passed = self.passed[rows]
            out.append((rows, None if (passed == 1).all() else passed))
        return out

    def chain(self, draws: StateDraws, keep: bool = False) -> tuple[Array, Array]:
        """Forward recursion, all draws and all sessions at once (Rabiner 1989, scaled).

        Returns
        -------
        log_likelihood : ndarray, shape (N,)
        before : ndarray, shape (R, K, N)
            With `keep`, the probability of each state before the answer of a row is known.
        """
        engaged, away = self.said(draws)
        share, switch = self.shares(draws), draws.states[:, 1]
        n = share.shape[1]
        state = np.repeat(share[:, None], self.begins.size, axis=1)
        product, log_likelihood = np.ones((self.begins.size, n)), np.zeros(n)
        before = np.empty((self.cell.size, self.n_states, n) if keep else (0, 0, 0))
        anew = (switch * share)[:, None]
        for t, (rows, passed) in enumerate(self.steps):
            now = state[:, : rows.size]
            if t and passed is None:
                now *= 1 - switch
                now += anew
            elif t:
                assert passed is not None
                kept = (1 - switch) ** passed[:, None]
                now *= kept
                now += (1 - kept) * share[:, None]
            if keep:
                before[rows] = now.swapaxes(0, 1)
            now[0] *= engaged[self.said_at[rows]]
            now[1:] *= away[self.answer[rows]].swapaxes(0, 1)
            total = now.sum(axis=0)
            now /= total
            product[: rows.size] *= total
            if t % 16 == 15:
                log_likelihood += np.log(product).sum(axis=0)
                product[:] = 1.0
        return log_likelihood + np.log(product).sum(axis=0), before

    def paths(self, draws: StateDraws, rng: np.random.Generator) -> Codes:
        """States drawn given all answers of the session, (R, N): backward sampling."""
        _, before = self.chain(draws, keep=True)
        engaged, away = self.said(draws)
        before[:, 0] *= engaged[self.said_at]
        before[:, 1:] *= away[self.answer]
        share, switch = self.shares(draws), draws.states[:, 1]
        path = np.zeros((self.cell.size, len(draws)), dtype=np.int8)
        column = np.arange(len(draws))
        for t in range(len(self.steps) - 1, -1, -1):
            rows = self.steps[t][0]
            weight = before[rows]  # (S, K, N)
            if t + 1 < len(self.steps):
                after = self.steps[t + 1][0]
                kept = (1 - switch) ** self.passed[after][:, None]
                last = path[after]
                into = (1 - kept) * share[last, column]
                weight[: after.size] *= into[:, None] + kept[:, None] * (
                    last[:, None] == np.arange(self.n_states)[:, None]
                )
            ends = np.cumsum(weight, axis=1)
            wanted = rng.random((rows.size, 1, len(draws))) * ends[:, -1:]
            path[rows] = (ends[:, :-1] <= wanted).sum(axis=1)
        return path

    # -- what other modules ask of a model -------------------------------------------------------

    def by_row(self, draws: Draws, cell: Index | None = None) -> tuple[Array, Array]:
        """P of either answer to each answered row given the answers before it, (N, R)."""
        p = self._of_rows(draws, lambda p: p)
        return p, 1 - p

    def expected(self, draws: Draws) -> tuple[Array, Array]:
        """The same, the mean over the rows of a cell, (N, C)."""
        mean = self._of_rows(draws, lambda p: p @ self.member) / self.cells.n
        return mean, 1 - mean

    def log_said(self, draws: Draws) -> Array:
        """Log-probability of the answers to each cell, each given those before it, (N, C)."""
        answer = self.answer[self.answer < 2]
        return self._of_rows(draws, lambda p: np.log(np.where(answer == 1, p, 1 - p)) @ self.member)

    def simulate(self, draws: Draws, rng: np.random.Generator) -> Array:
        return self._of_rows(draws, lambda p: (rng.random(p.shape) < p) @ self.member)

    def _of_rows(self, draws: Draws, made: Callable[[Array], Array]) -> Array:
        """What is made of P of each answered row given the answers before it, in batches."""
        assert isinstance(draws, StateDraws)
        out = []
        for rows in _batches(len(draws), max(int(1e7 / self.cell.size), 1)):
            some = draws.at(rows)
            _, before = self.chain(some, keep=True)
            engaged, away = self.said(some)
            before[:, 0] *= engaged[self.cell + self.cells.n.size]
            before[:, 1:] *= away[1]
            out.append(made(before.sum(axis=1)[self.answer < 2].T))
        return np.concatenate(out)

    @cached_property
    def member(self) -> csr_array:
        """(R, C): 1 where an answered row belongs to a cell."""
        cell = self.cell[self.answer < 2]
        ones = np.ones(cell.size), (np.arange(cell.size), cell)
        return csr_array(ones, (cell.size, self.cells.n.size))


@dataclass(frozen=True)
class StateTarget(Target):
    """The density of vectors of an observer with states, the scores of these last."""

    model: StateModel

    @property
    def further(self) -> int:
        return len(self.model.free_states)

    def parameters(self, theta: Array) -> StateDraws:
        return self.model.draws_of(theta)

    def log_likelihood(self, draws: Draws) -> Array:
        assert isinstance(draws, StateDraws)
        return self.model.chain(draws)[0]

    def weighted(self, effective: float = EFFECTIVE, size: int = PASS) -> WeightedDraws:
        """As of any target; of a whole fit by passes of three times as many draws.

        Answers of disengaged trials are of either side in turn: with passes of 2000 two of five
        seeds lost the higher mode of five sessions of the rat, by 4 to 9 nats, with 6000 none.
        """
        return super().weighted(effective, 3 * size if effective >= EFFECTIVE else size)


@dataclass(frozen=True, repr=False)
class StatePosterior(ImportancePosterior):
    """Weighted draws of an observer with states."""

    target: StateTarget

    def recomputed(self, model: WeberModel) -> None:
        return None

    def score_curve(self) -> tuple[Array, Array]:
        model, axis = self.target.model, np.linspace(-REACH, REACH, 73)
        thinned = self.reproducible_draws().thinned(60)
        assert isinstance(thinned, StateDraws)
        every = thinned.at(np.repeat(np.arange(len(thinned)), axis.size))
        k = np.tile(model.value("weber_fraction", axis), len(thinned))
        log, _ = model.chain(replace(every, weber_fraction=k))
        log = log.reshape(len(thinned), axis.size) - 0.5 * axis**2
        return axis, logsumexp(log - logsumexp(log, axis=1, keepdims=True), axis=0)


def with_states(model: WeberModel, trials: Trials, encoding: Encoding, n_states: int) -> StateModel:
    """The observer of these trials with states, priors of which it may have among its own.

    Raises
    ------
    ValueError
        For counts, trials out of order, scored answers and overdispersed ones.
    """
    frame = trials.frame
    needs_rows(trials, argument("states", n_states))
    if not trials.task.has_bias:
        raise Refusal(
            argument("states", n_states) + " needs to know which answer was given",
            f"task {trials.task.name!r}, scored right or wrong",
            "leave " + named("states") + " out, or read the choices",
        )
    if model.dispersed is not None:
        raise Refusal(
            argument("states", n_states) + " makes answers scatter by itself",
            "the effect Overdispersion",
            "leave it out",
        )
    if model.by_session is not None:
        raise Refusal(
            argument("states", n_states) + " goes with one bias for all sessions",
            "the effect SessionBias",
            "leave it out",
        )
    answered = trials.answered
    cell = np.zeros(len(frame), dtype=np.intp)
    cell[answered] = gather(trials, model.effects, encoding)[2]
    answer = np.where(answered, frame["count"].to_numpy(float, na_value=0.0), 2).astype(np.intp)
    block = session_block(frame)
    begins = np.flatnonzero(np.diff(block, prepend=-1) != 0)
    passed = np.ones(len(frame))
    if is_numbered(frame):
        leap = frame["trial"].groupby(block).diff().to_numpy(float)
        passed = np.where(leap > 1, leap, 1.0)
    own = {name: getattr(model, name) for name in WeberModel.__dataclass_fields__}
    effects = STATE_PRIORS[n_states] | dict(model.priors.effects)
    own["priors"] = replace(model.priors, effects=effects)
    return StateModel(
        **own, chained=n_states, cell=cell, answer=answer, passed=passed, begins=begins
    )


def check_states(n_states: Any) -> int:
    """Refuses a number of states that there is no model of."""
    if isinstance(n_states, bool) or n_states not in (1, *STATE_PRIORS):
        raise Refusal(
            named("states") + " must be 1, 2 or 3",
            checks.shown(n_states),
            "write "
            + argument("states", 3)
            + " for an animal that keeps to one side or the other when it is not engaged",
        )
    return int(n_states)


def streaks(
    model: WeberModel, log_evidence: float, trials: Trials, encoding: Encoding, effective: float
) -> float:
    """Log Bayes factor of two or three states, each as likely, over one of that evidence.

    It is that of draws worth so many independent ones: of 200 right to a tenth of a nat.
    """
    factors = []
    for n_states in STATE_PRIORS:
        target = StateTarget(with_states(model, trials, encoding, n_states))
        draws = target.weighted(effective, size=500)
        factors.append(draws.log_evidence - log_evidence)
    return float(logsumexp(factors) - np.log(len(factors)))


def engagement(model: StateModel, draws: Draws, seed: int) -> tuple[Array, Array]:
    """P(engaged) of each row (R,), and the share of the rows engaged of each draw (N,)."""
    assert isinstance(draws, StateDraws)
    rng = np.random.default_rng(seed)
    total, share = np.zeros(model.cell.size), np.empty(len(draws))
    for rows in _batches(len(draws), max(int(4e6 / model.cell.size), 1)):
        path = model.paths(draws.at(rows), rng) == 0
        total += path.sum(axis=1)
        share[rows] = path.mean(axis=0)
    return total / len(draws), share


def _batches(count: int, size: int) -> Iterator[slice]:
    return (slice(start, start + size) for start in range(0, count, size))
