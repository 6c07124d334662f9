"""Which trial comes next: the one that is expected to tell most.

The objective is the mutual information between the next answer and what is asked for, everything
else integrated over what is believed of it (Lindley 1956; Kontsevich & Tyler 1999 for the
psychometric function). Lapses and bias are nuisances: an objective that also counted what a trial
tells of the lapses would spend trials on stimuli so easy that only a lapse can miss them (Prins
2013).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from scipy.special import softmax

from .._util import checks
from .._util.refusals import Refusal
from .._util.values import Array, Fields, Line, counted
from ..behaviour.encodings import LogEncoding
from ..behaviour.estimates import tails
from ..behaviour.fit import WeberFit, fit_weber
from ..behaviour.trials import Trials
from .belief import Belief, Pair, entropy
from .hypotheses import Hypothesis, check_answers, check_distinct, options_of, refuse_given_k
from .magnitude import Magnitude, magnitude_of
from .scheme import Scheme

__all__ = ["BayesianPlacer", "Proposal", "TrialLog", "next_trial"]

GOALS = ("weber_fraction", "hypothesis", "everything")


@dataclass(frozen=True, repr=False)
class Proposal(Fields):
    """The next trial.

    Parameters
    ----------
    trial : int
        From 1.
    standard, comparison : float
        Stimulus 1 and stimulus 2, in the encoding's unit.
    easy : bool
        Put in to keep the animal working.
    information : float
        Bits of information that the answer is expected to give about the goal.
    """

    trial: int
    standard: float
    comparison: float
    easy: bool = False
    information: float = float("nan")


class TrialLog(Line):
    """The trials so far, as a fit takes them; `BayesianPlacer` chooses the next."""

    most: int | None = None  # trials, after which there are enough

    def __init__(self, hypotheses: Sequence[Hypothesis], scheme: Scheme, seed: int = 1) -> None:
        self.hypotheses = check_distinct(hypotheses)
        checks.kind(
            "scheme", scheme, "a Scheme", "offsets", "write ww.design.lattice(encoding, 20e-3), say"
        )
        self.scheme, self.seed = scheme, seed
        self._recorded: list[tuple[float, float, float, float]] = []
        self._proposal: Proposal | None = None

    def _line(self) -> str:
        names = ", ".join(h.name for h in self.hypotheses)
        return f"{counted(self.n_trials, 'trial')} with an answer; {names}"

    @property
    def n_trials(self) -> int:
        """Trials with an answer."""
        return sum(1 for row in self._recorded if not np.isnan(row[3]))

    @property
    def finished(self) -> str:
        """Why there are trials enough; empty where there are not."""
        if self.most is not None and len(self._recorded) >= self.most:
            return f"{counted(len(self._recorded), 'trial')}, as many as wanted"
        return ""

    def next(self, standard: float | None = None) -> Proposal:
        """The next trial, the same until it is recorded.

        Parameters
        ----------
        standard : float, optional
            One of the scheme's, where the order of the standards is yours.
        """
        proposal = self._proposal
        if proposal is None or standard not in (None, proposal.standard):
            if standard is not None and standard not in self.scheme.standards:
                raise Refusal(
                    f"the scheme has no standard {standard:g}",
                    remedy=(f"choose one of {', '.join(f'{s:g}' for s in self.scheme.standards)}"),
                )
            number = len(self._recorded) + 1
            rng = np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(number,)))
            self._proposal = proposal = self._choose(number, rng, standard)
        return proposal

    def _choose(self, number: int, rng: np.random.Generator, standard: float | None) -> Proposal:
        raise NotImplementedError

    def check(
        self, standard: float, comparison: float, choice: Any, nominal: float | None = None
    ) -> Pair:
        """What was shown, with the scheme's standard nearest to the nominal one; refuses what
        `record` would."""
        for name, value in (("standard", standard), ("comparison", comparison)):
            checks.number(name, value, "give what was shown")
        about = standard if nominal is None else checks.number("nominal", nominal, "give 1, say")
        near = min(self.scheme.standards, key=lambda s: abs(s - about))
        pair = float(standard), float(comparison), near
        self._encode(pair)
        if choice is not None and choice == choice and choice not in (0, 1):
            raise Refusal(
                f"choice must be 1 ({self.hypotheses[0].asked.answer}), 0, or None for no answer",
                f"{choice!r}",
            )
        return pair

    def _encode(self, pair: Pair) -> None:
        raise NotImplementedError

    def record(
        self, standard: float, comparison: float, choice: Any, *, nominal: float | None = None
    ) -> None:
        """Learn from a trial: what was shown, whether or not it was proposed, and the answer.

        Parameters
        ----------
        standard, comparison : float
            Stimulus 1 and stimulus 2, in the encoding's unit.
        choice : {0, 1, None}
            1 is the answer that the task counts, "second greater" say; None for no answer.
        nominal : float, optional
            The standard of the trial; stimulus 1 by default. Give it where the comparison came
            first: a bias may belong to the standard.

        Raises
        ------
        ValueError
            For another choice, or stimuli that cannot be encoded; the trial is not kept then.
        """
        pair = self.check(standard, comparison, choice, nominal)
        missing = choice is None or choice != choice
        self._recorded.append((*pair, np.nan if missing else float(choice)))
        self._proposal = None  # another is to be chosen then
        if not missing:
            self._learn(pair, int(choice))

    def _learn(self, pair: Pair, answer: int) -> None:
        raise NotImplementedError

    def trials(self) -> Trials:
        """Every trial recorded, in order.

        The standard of a trial is the scheme's nearest to stimulus 1, unless one was given.
        """
        s1, s2, standard, count = np.array(self._recorded, dtype=float).reshape(-1, 4).T
        frame = pd.DataFrame({"session": 1, "trial": np.arange(count.size) + 1})
        frame = frame.assign(standard=standard, stimulus_1=s1, stimulus_2=s2, n=1, count=count)
        encoding = self.hypotheses[0].encoding
        unit = encoding.log_unit if isinstance(encoding, LogEncoding) else None
        scale = "linear" if unit is None else "log"
        return Trials(frame, self.hypotheses[0].asked, scale, unit, "trials placed")

    @property
    def magnitude(self) -> Magnitude:
        """What the stimuli are: of the scheme, where its unit is that of the encoding."""
        by_encoding = magnitude_of(self.hypotheses[0].encoding)
        of_distance = by_encoding.is_distance or self.scheme.magnitude.is_distance
        return by_encoding if of_distance else self.scheme.magnitude

    def fits(self) -> dict[str, WeberFit]:
        """The trials fitted under each hypothesis, as any other trials are."""
        trials = self.trials()
        return {h.name: fit_weber(trials, **options_of(h)) for h in self.hypotheses}


def _limit(name: str, value: int | None) -> int | None:
    if value is not None:
        checks.positive(name, value, "write 400, say")
    return value


class BayesianPlacer(TrialLog):
    """Places each trial where its answer is expected to be most informative.

    Parameters
    ----------
    hypotheses : Hypothesis or sequence of Hypothesis
        The observers that may be in front of you, each as it will be fitted; equally likely at
        first.
    scheme : Scheme
        The trials that may be proposed, see `lattice`; how many of each is not read.
    goal : {"weber_fraction", "hypothesis", "everything"}
        What the answers are to inform: k (averaged over the hypotheses), which hypothesis is right,
        or all parameters alike, lapses included (QUEST+, Watson 2017; to compare with).
    easy_share : float
        Share of trials that are as easy as the scheme has them, at random.
    width : float, optional
        Finished when the 95 % interval of k is within this share of its middle to either side:
        0.2 for ±20 %.
    most : int, optional
        Finished after so many trials, answered or not.
    seed : int
        Of the choice among trials that are nearly as good as the best, and of the easy ones.

    Raises
    ------
    ValueError
        For an unknown goal, shares outside 0 to 1, or one hypothesis where they are to be
        distinguished.

    Notes
    -----
    Everything follows from the trials recorded, so replaying them resumes a session exactly.
    Stopping when the interval is narrow enough leaves the posterior what it is: it does not
    depend on why the trials ended.

    Examples
    --------
    >>> from weberwhisk.behaviour import IdentityEncoding
    >>> h = Hypothesis("Weber", IdentityEncoding())
    >>> from weberwhisk.design import lattice
    >>> placer = BayesianPlacer(h, lattice(h.encoding, 1.0), seed=1)
    >>> trial = placer.next()
    >>> placer.record(trial.standard, trial.comparison, 1)
    >>> low, high = placer.interval()
    >>> placer.n_trials, low < placer.weber_fraction < high
    (1, True)
    """

    def __init__(
        self,
        hypotheses: Hypothesis | Sequence[Hypothesis],
        scheme: Scheme,
        *,
        goal: str = "weber_fraction",
        easy_share: float = 0.1,
        width: float | None = None,
        most: int | None = None,
        seed: int = 1,
    ) -> None:
        several = [hypotheses] if isinstance(hypotheses, Hypothesis) else hypotheses
        super().__init__(several, scheme, seed)
        self.goal = checks.one_of("goal", goal, GOALS)
        if goal == "hypothesis" and len(self.hypotheses) < 2:
            raise Refusal(
                "one hypothesis cannot be distinguished from others",
                remedy="write ww.design.taper(whisker), say",
            )
        checks.between("easy_share", easy_share, "write 0.1, say", ends="[)")
        if width is not None:
            checks.positive_number("width", width, "write 0.2 for an interval of ±20 %")
            refuse_given_k(self.hypotheses, f"trials end at an interval of k of width={width:g}")
        self.easy_share, self.width, self.most = easy_share, width, _limit("most", most)
        #: After each answer: trials, and 2.5, 50 and 97.5 % of k.
        self.course: list[tuple[float, ...]] = []
        self._cells = scheme.cells()
        self.beliefs = {h.name: Belief(h, self._cells) for h in self.hypotheses}

    @property
    def probabilities(self) -> dict[str, float]:
        """Posterior probability of each hypothesis."""
        log = np.array([b.log_evidence for b in self.beliefs.values()])
        return dict(zip(self.beliefs, softmax(log).tolist(), strict=True))

    @property
    def best(self) -> Belief:
        """The belief under the most probable hypothesis."""
        return max(self.beliefs.values(), key=lambda belief: belief.log_evidence)

    @property
    def weber_fraction(self) -> float:
        """Posterior median of k, under the most probable hypothesis."""
        return float(self.best.quantile(0.5))

    def interval(self, mass: float = 0.95) -> tuple[float, float]:
        """Central interval of k, under the most probable hypothesis."""
        low, high = self.best.quantile(np.array(tails(mass)))
        return float(low), float(high)

    @property
    def finished(self) -> str:
        if self.width is not None:
            low, high = self.interval()
            if (high - low) / (high + low) <= self.width:
                return f"the 95 % interval of k, {low:.4g} to {high:.4g}, is narrow enough"
        return super().finished

    def information(self) -> Array:
        """Expected information of the answer to each trial of the scheme, (C,), bits."""
        chance = np.array(list(self.probabilities.values()))
        beliefs = self.beliefs.values()
        given_k, of_each = zip(*(b.predicted() for b in beliefs), strict=True)
        given = np.array(of_each)
        whole = entropy(chance @ given)
        if self.goal == "hypothesis":
            left = chance @ entropy(given)
        elif self.goal == "everything":
            left = chance @ np.array([b.entropy_of_all() for b in beliefs])
        else:
            entropy_given_k = [b.mass_k @ entropy(p) for b, p in zip(beliefs, given_k, strict=True)]
            whole, left = chance @ entropy(given), chance @ np.array(entropy_given_k)
        return np.asarray(np.maximum(whole - left, 0.0) / np.log(2))

    def _encode(self, pair: Pair) -> None:
        for belief in self.beliefs.values():
            belief.encode(pair)

    def _choose(self, number: int, rng: np.random.Generator, standard: float | None) -> Proposal:
        easy, draw = rng.random() < self.easy_share, rng.random()
        cells, information = self._cells, self.information()
        allowed = self.scheme.standards if standard is None else (standard,)
        if easy:
            places = [np.flatnonzero(cells.standard == s) for s in allowed]
            good = [f(at, key=cells.stimulus_2.item) for at in places for f in (min, max)]
        else:  # any of these is as good, and none foreseen
            open_to = np.isin(cells.standard, allowed)
            enough = 0.95 * information[open_to].max()
            good = list(np.flatnonzero(open_to & (information >= enough)))
        at = int(good[int(draw * len(good))])
        s1, s2 = float(cells.stimulus_1[at]), float(cells.stimulus_2[at])
        return Proposal(number, s1, s2, bool(easy), float(information[at]))

    def _learn(self, pair: Pair, answer: int) -> None:
        for belief in self.beliefs.values():
            belief.absorb(pair, answer)
        k = self.best.quantile(np.array([0.025, 0.5, 0.975]))
        self.course.append((len(self._recorded), *k.tolist()))


def next_trial(
    trials: Trials,
    hypotheses: Hypothesis | Sequence[Hypothesis],
    scheme: Scheme,
    **options: Any,
) -> Proposal:
    """The next trial after a table of trials, for programs that keep the table themselves.

    A `BayesianPlacer` that lives through the session does the same in 1 to 3 ms of CPU a trial, up
    to 15 where its grid is laid anew.

    Parameters
    ----------
    trials : Trials
        May be none yet.
    hypotheses, scheme, **options
        As for `BayesianPlacer`.

    Examples
    --------
    >>> from weberwhisk.behaviour import IdentityEncoding, simulate_trials
    >>> h = Hypothesis("Weber", IdentityEncoding())
    >>> from weberwhisk.design import lattice
    >>> next_trial(simulate_trials(trials_per_level=2, seed=1), h, lattice(h.encoding, 1.0)).trial
    19
    """
    placer = BayesianPlacer(hypotheses, scheme, **options)
    check_answers(trials, placer.hypotheses[0].task, 1)
    if len(trials.subjects) > 1:
        raise Refusal(
            f"{trials.source}: trials are placed for one animal",
            f"{len(trials.subjects)} subjects",
            f"write trials.select(subject={trials.subjects[0]!r}), say",
        )
    names = "stimulus_1", "stimulus_2", "n", "count", "standard"
    columns = [trials.frame[c].to_numpy(float) for c in names]
    for s1, s2, n, count, nominal in zip(*columns, strict=True):
        for i in range(int(n)):
            choice = None if np.isnan(count) else int(i < count)
            placer.record(s1, s2, choice, nominal=nominal)
    return placer.next()
