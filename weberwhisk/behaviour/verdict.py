"""What a fit is worth: did the data move the posterior, and which end of it is the prior's."""

from __future__ import annotations

from dataclasses import replace
from enum import Enum

import numpy as np

from .._util.refusals import argument
from .._util.values import Array
from .integrate import integrate
from .likelihood import WeberModel
from .posteriors import WeberPosterior

__all__ = ["FitStatus", "strength", "too_few_kinds", "verdict"]


class FitStatus(Enum):
    """The outcome of a fit, worst first; it travels with the numbers.

    Examples
    --------
    >>> FitStatus.REVERSED.ok, FitStatus.ONE_SIDED.message[:24]
    (False, 'all answers are the same')
    """

    NO_TRIALS = "there are no trials with an answer: the posterior is the prior"
    REVERSED = (
        "the answers run against the stimuli: the labels of the answers, or the two stimuli, look "
        "exchanged, and the Weber fraction below means nothing until that is settled"
    )
    ONE_SIDED = (
        "all answers are the same: they show a preference alone, and the Weber "
        "fraction below means nothing"
    )
    NOT_CONVERGED = "the posterior was not computed to the accuracy requested"
    MISFIT_STREAKS = (
        "an animal in one state does not give these answers, which come in streaks: the Weber "
        "fraction below is that of a model that does not hold"
    )
    MISFIT_HISTORY = (
        "the answers depend on the trial before: the Weber fraction below is that of a model that "
        "does not hold"
    )
    MISFIT_CURVE = (
        "the curve misses the choices: the Weber fraction below is that of a model that does not "
        "hold"
    )
    MISFIT_DRIFT = (
        "the animal changes in the course of the trials: the Weber fraction below is that of a "
        "model that does not hold"
    )
    MISFIT_OVERDISPERSION = (
        "answers to the same stimuli scatter more than chance: the interval below is too narrow"
    )
    UNINFORMED = "the data say next to nothing about the Weber fraction: the posterior is the prior"
    UPPER_BOUND = (
        "the data only bound the Weber fraction from above: the lower end of the interval is the "
        "prior's"
    )
    LOWER_BOUND = (
        "the data only bound the Weber fraction from below: the upper end of the interval is the "
        "prior's"
    )
    PRIOR_DEPENDENT = (
        "the Weber fraction depends on what is believed beforehand: the answers alone do not "
        "determine it"
    )
    GIVEN = "the Weber fraction was given, not fitted"
    DETERMINED = "the data determine the Weber fraction, at both ends of its interval"

    @property
    def ok(self) -> bool:
        """Whether the interval is the data's own, or none was requested."""
        return self in (FitStatus.GIVEN, FitStatus.DETERMINED)

    @property
    def is_misfit(self) -> bool:
        """Whether the model does not hold."""
        return self.name.startswith("MISFIT")

    @property
    def message(self) -> str:
        """The same as the value, for reading."""
        return self.value


def verdict(model: WeberModel, posterior: WeberPosterior) -> tuple[FitStatus, tuple[str, ...]]:
    """The status of a fit, and sentences beside it."""
    notes = _notes(model)
    if not model.cells.n.sum():
        return FitStatus.NO_TRIALS, notes
    if _reversed(model, posterior):
        return FitStatus.REVERSED, notes
    if _one_sided(model):
        return FitStatus.ONE_SIDED, notes
    if posterior.trouble:
        why = f"{posterior.trouble[0].upper()}{posterior.trouble[1:]}."
        return FitStatus.NOT_CONVERGED, (*notes, why)
    if "weber_fraction" not in model.names:
        return FitStatus.GIVEN, notes
    by_open_ends = {
        (True, True): FitStatus.UNINFORMED, (True, False): FitStatus.UPPER_BOUND,
        (False, True): FitStatus.LOWER_BOUND, (False, False): FitStatus.DETERMINED,
    }  # fmt: skip
    return by_open_ends[_open_ends(*posterior.score_curve())], notes


def _notes(model: WeberModel) -> tuple[str, ...]:
    cells, notes = model.cells, []
    gap = np.abs(model.encodings.mean_2 - model.encodings.mean_1)
    if cells.n.size and not np.any(gap > 0):
        notes.append(
            "All comparisons equal their standard: no difference was ever put to the animal."
        )
    elif cells.n.size == 1:
        notes.append(
            "There is one pair of stimuli: bias, lapses and Weber fraction are not identified "
            "separately."
        )
    elif too_few_kinds(model):
        notes.append(
            f"The pairs of stimuli are of {_kinds(model)} kinds, as far apart as noise makes them, "
            f"and the parameters are {_dimensions(model)}: the answers alone do not identify "
            "them, and a bound on one holds given what is believed beforehand of the others. State "
            "lapses that are known, for example "
            + argument("priors", {"lapse_low": 0.02, "lapse_high": 0.02})
            + ", or add easier and harder pairs."
        )
    d = _drive(model)
    none, every = (d[gap > 0][left[gap > 0] > 0] for left in (cells.n - cells.count, cells.count))
    separated = none.max(initial=-np.inf) < every.min(initial=np.inf)
    if separated and none.size + every.size > 1 and not _one_sided(model):
        notes.append("Every level is answered all one way: only harder comparisons inform further.")
    return tuple(notes)


def _drive(model: WeberModel) -> Array:
    """The decision variable of every pair for a Weber fraction of 1, biases and lapses apart."""
    return np.asarray(model.task.decide(model.encodings.encoded(1.0))[0])


def too_few_kinds(model: WeberModel) -> bool:
    """Whether the proportions that the observer could give are fewer than its parameters."""
    return bool(model.cells.n.size) and _kinds(model) < _dimensions(model)


def _kinds(model: WeberModel) -> int:
    """How many proportions the observer could give: pairs that differ in d by a tenth or more."""
    d = np.sort(_drive(model))
    tolerance, kinds, first = 0.1 * np.abs(d).max(), 1, d[0]
    for value in d:  # measured distances leave no gaps
        if value - first > tolerance:
            kinds, first = kinds + 1, value
    return kinds


def _dimensions(model: WeberModel) -> int:
    """Parameters that all pairs share, for an observer without effects."""
    shared = model.free_bias and model.n_groups == 1
    return 0 if model.effects else sum(model.free) + shared


def _one_sided(model: WeberModel) -> bool:
    """Whether every pair, of those that should differ in their answers, has the same answer."""
    c = model.cells
    if model.task.guess_rate is not None or c.n.size < 2 or c.count.sum() not in (0, c.n.sum()):
        return False
    d = _drive(model)
    return bool(np.ptp(d) > 0 and (model.task.bias_name == "criterion" or d.min() < 0 < d.max()))


def _reversed(model: WeberModel, posterior: WeberPosterior) -> bool:
    """Whether the opposite answers would be a hundred times as probable, by the evidence."""
    c = model.cells
    if model.task.guess_rate is None:
        drive = _drive(model)
        suspect = drive @ (c.count - c.n * (c.count.sum() / c.n.sum())) < 0
    else:
        suspect = c.count.sum() < model.task.guess_rate * c.n.sum()
    if not suspect:
        return False
    # Effects do not turn answers round: the plain observer decides.
    plain = model.plain().merged()
    exchanged = replace(plain, cells=replace(plain.cells, count=plain.cells.n - plain.cells.count))
    plainly = not model.effects and model.n_states == 1
    as_they_are = posterior.log_evidence if plainly else None
    if as_they_are is None:
        as_they_are = integrate(plain).log_evidence
    return integrate(exchanged).log_evidence - as_they_are > np.log(100.0)


def _open_ends(
    axis: Array, log_density: Array, far: float = 3.0, likely: float = 0.1
) -> tuple[bool, bool]:
    """Whether the likelihood leaves very small, or very large, Weber fractions open.

    The likelihood of k is its posterior over its prior, everything else integrated; in normal
    scores the prior is known, and scores that the posterior does not reach are excluded. An end is
    open where the likelihood, `far` prior sds away, is more than `likely` of the best.
    """
    likelihood = log_density + 0.5 * axis**2
    inside = np.abs(axis) <= far + 0.5
    best = likelihood[inside].max() if inside.any() else likelihood.max()

    def is_open(end: float) -> bool:
        within = axis[0] <= end <= axis[-1]
        return bool(within and np.interp(end, axis, likelihood) > best + np.log(likely))

    return is_open(-far), is_open(far)


def strength(log_bayes_factor: float) -> str:
    """The evidence of a Bayes factor above 1 in words: some from 3 on, strong from 10, decisive
    from 100."""
    words = ("no evidence either way", "some evidence", "strong evidence", "decisive evidence")
    return words[int(np.searchsorted(np.log([3, 10, 100]), log_bayes_factor))]
