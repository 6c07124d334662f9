"""What a fit is worth: did the data move the posterior, and which end of it is the prior's."""

from __future__ import annotations

from dataclasses import replace
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from .integrate import integrate
from .likelihood import WeberModel
from .posteriors import WeberPosterior


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
        "all answers are the same: they tell of a preference, not of the stimuli, and the Weber "
        "fraction below means nothing"
    )
    NOT_CONVERGED = "the posterior was not computed to the accuracy asked for"
    UNINFORMED = "the data say next to nothing about the Weber fraction: the posterior is the prior"
    UPPER_BOUND = (
        "the data only bound the Weber fraction from above: the lower end of the interval is the "
        "prior's"
    )
    LOWER_BOUND = (
        "the data only bound the Weber fraction from below: the upper end of the interval is the "
        "prior's"
    )
    DETERMINED = "the data determine the Weber fraction: both ends of the interval are theirs"

    @property
    def ok(self) -> bool:
        """Whether the interval is the data's own."""
        return self is FitStatus.DETERMINED

    @property
    def message(self) -> str:
        """The same as the value, for reading."""
        return self.value


Array = NDArray[np.float64]

FAR = 3.0  # prior sds at which an end counts as the prior's
LIKELY = 0.1  # likelihood ratio to the best k above which that end is not excluded
ALIKE = 0.1  # of the largest d, below which two pairs of stimuli are of one kind
STRONG = np.log(100.0)  # evidence for exchanged labels


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
        return FitStatus.NOT_CONVERGED, (
            *notes,
            f"{posterior.trouble[0].upper()}{posterior.trouble[1:]}.",
        )
    if "weber_fraction" not in model.names:
        return FitStatus.DETERMINED, (*notes, "The Weber fraction was fixed, not fitted.")
    below, above = _open_ends(*posterior.score_curve())
    if below and above:
        return FitStatus.UNINFORMED, notes
    if below:
        return FitStatus.UPPER_BOUND, notes
    if above:
        return FitStatus.LOWER_BOUND, notes
    return FitStatus.DETERMINED, notes


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
            "priors={'lapse_low': 0.02, 'lapse_high': 0.02}, or add easier and harder pairs."
        )
    share = cells.count / np.maximum(cells.n, 1)
    if (
        cells.n.size > 1
        and not model.encodings.has_spread  # measured, every level was met once
        and not _one_sided(model)
        and np.all(
            np.where(
                model.encodings.mean_2 == model.encodings.mean_1, True, (share == 0) | (share == 1)
            )
        )
        and np.any(gap > 0)
    ):
        notes.append("Every level is answered all one way: only harder comparisons can tell more.")
    return tuple(notes)


def too_few_kinds(model: WeberModel) -> bool:
    """Whether the proportions that the observer could give are fewer than its parameters."""
    return bool(model.cells.n.size) and _kinds(model) < _dimensions(model)


def _kinds(model: WeberModel) -> int:
    """How many proportions the observer could give: pairs that differ in d by a tenth or more."""
    d = np.sort(model.task.decide(model.encodings.encoded(np.float64(1.0)))[0])
    alike, kinds, first = ALIKE * np.abs(d).max(), 1, d[0]
    for value in d:  # measured distances leave no gaps
        if value - first > alike:
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
    d = model.task.decide(model.encodings.encoded(np.float64(1.0)))[0]
    return bool(np.ptp(d) > 0 and (model.task.bias_name == "criterion" or d.min() < 0 < d.max()))


def _reversed(model: WeberModel, posterior: WeberPosterior) -> bool:
    """Whether the opposite answers would be far more probable, judged by the evidence."""
    c = model.cells
    if model.task.guess_rate is None:
        drive = model.task.decide(model.encodings.encoded(np.float64(1.0)))[0]
        suspect = drive @ (c.count - c.n * (c.count.sum() / c.n.sum())) < 0
    else:
        suspect = c.count.sum() < model.task.guess_rate * c.n.sum()
    if not suspect:
        return False
    # Effects do not turn answers round: the plain observer tells.
    plain = model.plain().merged()
    exchanged = replace(plain, cells=replace(plain.cells, count=plain.cells.n - plain.cells.count))
    as_they_are = posterior.log_evidence if not model.effects else None
    if as_they_are is None:
        as_they_are = integrate(plain).log_evidence
    return integrate(exchanged).log_evidence - as_they_are > STRONG


def _open_ends(axis: Array, log_density: Array) -> tuple[bool, bool]:
    """Whether the likelihood leaves very small, or very large, Weber fractions open.

    The likelihood of k is its posterior over its prior, everything else integrated; in normal
    scores the prior is known, and scores that the posterior does not reach are excluded.
    """
    likelihood = log_density + 0.5 * axis**2
    inside = np.abs(axis) <= FAR + 0.5
    best = likelihood[inside].max() if inside.any() else likelihood.max()

    def is_open(end: float) -> bool:
        within = axis[0] <= end <= axis[-1]
        return bool(within and np.interp(end, axis, likelihood) > best + np.log(LIKELY))

    return is_open(-FAR), is_open(FAR)
