"""Why a model does not hold, and how much it matters: causes tried one by one, and together.

Each cause is an effect, a number of states or a bias per standard that the table can show. They are
weighed by evidence, forwards: the best, then another beside it, and so on, with a step back where
one has become superfluous.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
import pandas as pd

from .._util.values import interval_text
from .effects import (
    BiasDrift,
    Contraction,
    Drift,
    Effect,
    Exponent,
    Floor,
    History,
    NoiseByOrder,
    Overdispersion,
    SessionBias,
    StandardSecond,
    WinStay,
    is_possible,
)
from .estimates import Estimates
from .importance import EFFECTIVE, PASS, ImportancePosterior, Target
from .likelihood import WeberModel, build_model
from .posteriors import WeberPosterior
from .quadrature import QuadraturePosterior
from .states import STATE_PRIORS, StateModel, StatePosterior, StateTarget, with_states
from .verdict import FitStatus

__all__ = ["Cause", "Search", "possible_causes", "search", "with_causes"]

MOST = 3  # causes at once
STRONG = float(np.log(10.0))  # log Bayes factor at which a cause is taken
MOVED, WIDER = 1.0, 1.5  # sds of ln k, and times its width, from which a cause matters


class Draws(NamedTuple):
    """How many independent draws weighted ones are to be worth, and how many a pass has."""

    effective: float
    size: int


WHOLE = Draws(EFFECTIVE, PASS)
TRIED = Draws(400.0, 500)  # evidence to 0.05, ends of k to 0.1 sd
SHOWN = Draws(1200.0, 1000)  # the fewest of a fit that counts as converged; ends of k to 0.06 sd


@dataclass(frozen=True, eq=False)
class Cause:
    """What may be behind a misfit, to be put into the model.

    `words` end "the answers show ..."; `status` is that of a fit without the cause, where it
    matters for k.
    """

    name: str
    words: str
    status: FitStatus
    effects: tuple[Effect, ...] = ()
    states: int = 1
    bias: str = ""
    noise: str = ""


_OF_EFFECTS: tuple[tuple[Effect, str, FitStatus], ...] = (
    (Contraction(), "contraction towards what was shown", FitStatus.MISFIT_CURVE),
    (Exponent(), "noise that grows as another power of the stimulus", FitStatus.MISFIT_CURVE),
    (Floor(), "a floor of the noise", FitStatus.MISFIT_CURVE),
    (NoiseByOrder(), "noise that differs between the intervals", FitStatus.MISFIT_CURVE),
    (
        StandardSecond(),
        "noise that differs by which interval held the standard",
        FitStatus.MISFIT_CURVE,
    ),
    (History(), "a pull towards the last answer, or away from it", FitStatus.MISFIT_HISTORY),
    (WinStay(), "a pull to the side that was right last, or away", FitStatus.MISFIT_HISTORY),
    (Drift(), "a Weber fraction that changes over the sessions", FitStatus.MISFIT_DRIFT),
    (SessionBias(), "a bias that differs by session", FitStatus.MISFIT_DRIFT),
    (BiasDrift(), "a bias that drifts over the trials", FitStatus.MISFIT_DRIFT),
    (
        Overdispersion(),
        "more scatter than chance makes",
        FitStatus.MISFIT_OVERDISPERSION,
    ),
)


def possible_causes(fit: Estimates) -> list[Cause]:
    """The causes that the table can show, of those that are not in the model."""
    model, trials = fit.model, fit.trials
    causes = []
    given = trials, fit.encoding, model.encodings, model.cells.n
    for effect, words, status in _OF_EFFECTS:
        if effect.name in fit.effects or not is_possible(effect, *given):
            continue
        column = effect.column(trials, fit.encoding)
        flat = column is not None and np.ptp(column[trials.answered]) == 0
        flat = flat or (isinstance(effect, Contraction) and np.ptp(model.cells.stimulus_1) == 0)
        if not flat:
            causes.append(Cause(effect.name, words, status, effects=(effect,)))
    if "exponent" in {cause.name for cause in causes} and fit.noise == "weber":
        words = "the same noise at every stimulus"
        causes.append(Cause("constant noise", words, FitStatus.MISFIT_CURVE, noise="constant"))
    if fit.bias == "shared" and trials.has_standards and fit.standards.size > 1:
        words = "a bias that differs by standard"
        causes.append(
            Cause("bias per standard", words, FitStatus.MISFIT_CURVE, bias="per standard")
        )
    if model.n_states == 1 and trials.course.is_known and model.task.has_bias:
        causes += [
            Cause(f"states={n}", "streaks, as of an animal that is engaged part of the time",
                  FitStatus.MISFIT_STREAKS, states=n)
            for n in STATE_PRIORS
        ]  # fmt: skip
    return [cause for cause in causes if _go_together(fit, [cause])]


def _go_together(fit: Estimates, causes: Sequence[Cause]) -> bool:
    """Whether a fit can have all of them: states go neither with one another nor with what makes
    answers scatter by itself, and noise that is constant has neither a floor nor an exponent."""
    names = {*fit.effects, *(cause.name for cause in causes)}
    if "constant noise" in names and names & {"exponent", "floor"}:
        return False
    states = sum(cause.states > 1 for cause in causes) + (fit.model.n_states > 1)
    return states <= (0 if {"overdispersion", "session_bias"} & names else 1)


def with_causes(fit: Estimates, causes: Sequence[Cause], draws: Draws = WHOLE) -> Estimates:
    """The same fit with causes in its model, by so many draws where it is by draws."""
    effects = (*fit.model.effects, *(e for cause in causes for e in cause.effects))
    bias = next((cause.bias for cause in causes if cause.bias), fit.bias)
    noise = next((cause.noise for cause in causes if cause.noise), fit.noise)
    n_states = max([fit.model.n_states, *(cause.states for cause in causes)])
    model, encoding, bias = build_model(
        fit.trials, fit.encoding, None, bias, noise, fit.model.priors, effects,
        STATE_PRIORS.get(n_states, {}),
    )  # fmt: skip
    fitted: WeberModel = model
    posterior: WeberPosterior
    accuracy = draws._asdict()
    if n_states > 1:
        fitted = with_states(model, fit.trials, encoding, n_states)
        assert isinstance(fitted, StateModel)
        posterior = StatePosterior.sampled(StateTarget(fitted), **accuracy)
    elif effects:
        posterior = ImportancePosterior.sampled(Target(model.merged()), **accuracy)
    else:
        posterior = QuadraturePosterior.integrated(model.merged())
    method = "importance" if effects or n_states > 1 else "quadrature"
    return replace(
        fit, model=fitted, encoding=encoding, noise=noise, bias=bias, method=method,
        posterior=posterior,
    )  # fmt: skip


@dataclass(frozen=True)
class Tried:
    """Causes together with the fit that has them."""

    causes: tuple[Cause, ...]
    fit: Estimates

    @property
    def name(self) -> str:
        return " + ".join(cause.name for cause in self.causes)

    @property
    def log_evidence(self) -> float:
        assert self.fit.log_evidence is not None
        return self.fit.log_evidence

    @cached_property
    def sd(self) -> float:
        """Posterior sd of ln k."""
        draws = self.fit.posterior.reproducible_draws()
        return float(np.log(draws.weber_fraction).std())


@dataclass(frozen=True)
class Search:
    """What was tried, and the causes `chosen`, none where none has strong evidence."""

    plain: Tried
    tried: tuple[Tried, ...]
    chosen: Tried | None

    @cached_property
    def table(self) -> pd.DataFrame:
        """A row for what was tried alone, and for what was chosen, the best first."""
        kept = [t for t in self.tried if len(t.causes) == 1 or t is self.chosen]
        table = [self._row(t) for t in sorted(kept, key=lambda t: -t.log_evidence)]
        columns = ["cause", "log_evidence", "log_bayes_factor", "weber_fraction", "lower", "upper",
                   "change", "status"]  # fmt: skip
        return pd.DataFrame(table, columns=columns).set_index("cause")

    def _row(self, tried: Tried) -> tuple[str | float, ...]:
        gain = tried.log_evidence - self.plain.log_evidence
        if gain >= STRONG and tried is not self.chosen:  # few draws have no status
            tried = Tried(tried.causes, with_causes(self.plain.fit, tried.causes, SHOWN))
        k = tried.fit.weber_fraction, *tried.fit.interval()
        status = tried.fit.unweighed.name if gain >= STRONG else ""
        return tried.name, tried.log_evidence, gain, *k, self.change(tried), status

    def change(self, tried: Tried) -> float:
        """How far causes move the median of ln k, in posterior sds without them."""
        return float(
            np.log(tried.fit.weber_fraction / self.plain.fit.weber_fraction) / self.plain.sd
        )

    @property
    def matters(self) -> bool:
        """Whether the causes chosen move k by more than its sd, or widen its interval by half."""
        assert self.chosen is not None
        moved = abs(self.change(self.chosen)) > MOVED
        return moved or self.chosen.sd > WIDER * self.plain.sd

    @property
    def sentence(self) -> str:
        """What the answers show, and what it makes of k."""
        if self.chosen is None:
            return ""
        fit, before = self.chosen.fit, self.plain.fit.weber_fraction
        shown = " and ".join(self._shown(cause) for cause in self.chosen.causes)
        k = _bracketed(fit.weber_fraction, *fit.interval())
        factor = f"log Bayes factor {self.chosen.log_evidence - self.plain.log_evidence:.3g}"
        if abs(self.change(self.chosen)) > MOVED:
            effect = f": with it k is {k} in place of {before:.3g}"
        elif self.matters:
            effect = (
                f": with it k is {k} in place of {before:.3g}, and its sd "
                f"{self.chosen.sd / self.plain.sd:.2g} times as large"
            )
        else:
            effect = f", which moves k by less than its sd, from {before:.3g} to {k}"
        return f"The answers show {shown}{effect} ({factor})."

    def _shown(self, cause: Cause) -> str:
        """A cause in words, with its parameter."""
        if not cause.effects:
            return cause.words
        assert self.chosen is not None
        name = cause.effects[0].name
        low, middle, high = self.chosen.fit.posterior.quantile(name, [0.025, 0.5, 0.975])
        value = _bracketed(float(middle), float(low), float(high)).replace(" (", ", ")
        return f"{cause.words} ({name} {value}"


def _bracketed(middle: float, low: float, high: float) -> str:
    """An estimate with its interval."""
    return interval_text(middle, low, high).replace("95 %: ", "")


def search(fit: Estimates) -> Search:
    """Try what may be behind a misfit: the best cause, and while checks still see a misfit another
    beside it, up to three.

    Each is taken with strong evidence, a Bayes factor of 10 or more. A cause that is superfluous
    beside a later one is dropped. Those chosen stand in the order of what the fit would lose
    without them.
    """
    plain = Tried((), fit if fit.log_evidence is not None else with_causes(fit, ()))
    causes = possible_causes(fit)
    tried = {frozenset[Cause](): plain}
    best = plain
    while len(best.causes) < MOST:
        more = [c for c in causes if c not in best.causes and _go_together(fit, [*best.causes, c])]
        if not more:
            break
        new = max((_trial(tried, fit, (*best.causes, c)) for c in more), key=_evidence)
        if new.log_evidence - best.log_evidence < STRONG:
            break
        for without in _without_each(tried, fit, new):
            new = max(new, without, key=_evidence)
        lost = [-one.log_evidence for one in _without_each(tried, fit, new)]
        order = tuple(new.causes[i] for i in np.argsort(lost, kind="stable")[::-1])
        best = Tried(order, with_causes(fit, order))
        tried[frozenset(order)] = best  # as good as any fit
        if not best.fit.unweighed.is_misfit:
            break
    alone = (one for one in tried.values() if one.causes)
    return Search(plain, tuple(alone), best if best.causes else None)


def _evidence(tried: Tried) -> float:
    return tried.log_evidence


def _trial(
    tried: dict[frozenset[Cause], Tried], fit: Estimates, causes: tuple[Cause, ...]
) -> Tried:
    """A quick fit with causes, made once."""
    key = frozenset(causes)
    if key not in tried:
        tried[key] = Tried(causes, with_causes(fit, causes, TRIED))
    return tried[key]


def _without_each(
    tried: dict[frozenset[Cause], Tried], fit: Estimates, whole: Tried
) -> list[Tried]:
    """Quick fits without one cause, for each cause."""
    rest = [tuple(c for c in whole.causes if c is not cause) for cause in whole.causes]
    return [_trial(tried, fit, causes) for causes in rest]
