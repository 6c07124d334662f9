"""The classical rules: up after an error, down after so many right answers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from .. import _checks
from .hypotheses import Hypothesis
from .placement import Proposal, TrialLog
from .scheme import Scheme, decision_variable

Array = NDArray[np.float64]

#: Right answers in a row that make it harder.
RULES = {"1-up/1-down": 1, "1-up/2-down": 2, "1-up/3-down": 3}
STRIDES = (4, 2, 1)  # levels moved at once, until each turn


@dataclass
class _Track:
    """One staircase: its level, from the easiest down, and its turns."""

    level: int = 0
    right: int = 0
    way: int = 0
    turns: list[float] = field(default_factory=list)


class Staircase(TrialLog):
    """A transformed up–down rule (Levitt 1971), one track a standard, interleaved at random.

    Parameters
    ----------
    hypothesis : Hypothesis
        Says what is asked and how a stimulus is felt; the rule itself needs no more.
    scheme : Scheme
        Its comparisons are the levels, from the easiest on.
    rule : {"1-up/2-down", "1-up/3-down", "1-up/1-down"}
        Settles where 70.7, 79.4 or 50 % of the answers are right.
    turns : int, optional
        Finished after so many turns on every track.
    most : int, optional
        Finished after so many trials.
    seed : int
        Of the order of the standards, and of the side of the comparison.

    Examples
    --------
    >>> from weberwhisk.behaviour import IdentityEncoding
    >>> scheme = Scheme([1.0], [[-0.4, -0.2, -0.1, 0.1, 0.2, 0.4]])
    >>> staircase = Staircase(Hypothesis("Weber", IdentityEncoding()), scheme, seed=1)
    >>> offsets = []
    >>> for _ in range(6):
    ...     trial = staircase.next()
    ...     offsets.append(round(abs(trial.comparison - trial.standard), 3))
    ...     staircase.record(trial.standard, trial.comparison, trial.comparison > trial.standard)
    >>> offsets
    [0.4, 0.4, 0.1, 0.1, 0.1, 0.1]
    """

    def __init__(
        self,
        hypothesis: Hypothesis,
        scheme: Scheme,
        *,
        rule: str = "1-up/2-down",
        turns: int | None = None,
        most: int | None = None,
        seed: int = 0,
    ) -> None:
        super().__init__([hypothesis], scheme)
        self.rule = _checks.one_of("rule", rule, RULES)
        for name, value in (("turns", turns), ("most", most)):
            if value is not None:
                _checks.positive(name, value, "write 12, say")
        self.turns, self.most, self.seed = turns, most, seed
        self._sides: dict[float, tuple[Array, Array]] = {}
        for s, row in zip(scheme.standards, scheme.comparisons, strict=True):
            levels = np.asarray(row)
            # Easiest first on either side.
            below, above = np.sort(levels[levels < s]), np.sort(levels[levels > s])[::-1]
            if not below.size or not above.size:
                raise ValueError(
                    f"standard {s:g} has comparisons on one side only, and a staircase takes both; "
                    "give offsets of both signs."
                )
            self._sides[s] = below, above
        self._tracks = {s: _Track() for s in scheme.standards}
        self._proposal: Proposal | None = None

    @property
    def finished(self) -> str:
        """Why there are trials enough; empty where there are not."""
        if self.turns is not None and all(
            len(t.turns) >= self.turns for t in self._tracks.values()
        ):
            return f"every track has turned {self.turns} times"
        if self.most is not None and len(self._rows) >= self.most:
            return f"there are {len(self._rows)} trials, as many as wanted"
        return ""

    def next(self, standard: float | None = None) -> Proposal:
        """The next trial, the same until it is recorded."""
        if self._proposal is None or standard not in (None, self._proposal.standard):
            number = len(self._rows) + 1
            rng = np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(number,)))
            which, side = rng.random(2)
            known = self.scheme.standards
            if standard is not None and standard not in known:
                raise ValueError(
                    f"the scheme has no standard {standard:g}; choose one of "
                    f"{', '.join(f'{s:g}' for s in known)}."
                )
            s = known[int(which * len(known))] if standard is None else standard
            levels = self._sides[s][int(side < 0.5)]
            comparison = float(levels[min(self._tracks[s].level, levels.size - 1)])
            self._proposal = Proposal(number, s, comparison)
        return self._proposal

    def record(self, standard: float, comparison: float, choice: Any) -> None:
        """Move by a trial: what was shown, and the answer (None for none, which moves nothing).

        Raises
        ------
        ValueError
            For another choice, or stimuli that cannot be felt; the trial is not kept then.
        """
        pair = self._pair(standard, comparison)
        answer = self._note(pair, choice)
        self._proposal = None
        if answer is None:
            return
        is_choice = self.hypotheses[0].asked.response == "choice"
        right = answer == int(comparison > standard) if is_choice else bool(answer)
        track = self._tracks[pair[2]]
        track.right = track.right + 1 if right else 0
        way = -1 if not right else int(track.right >= RULES[self.rule])
        if way == 0:
            return
        track.right = 0
        if track.way and way != track.way:
            track.turns.append(self._difficulty(pair))
        track.way = way
        stride = STRIDES[min(len(track.turns), len(STRIDES) - 1)]
        lowest = max(side.size for side in self._sides[pair[2]]) - 1
        track.level = int(np.clip(track.level + way * stride, 0, lowest))

    def _difficulty(self, pair: Sequence[float]) -> float:
        """|d| of a trial for a Weber fraction of 1."""
        encoding = self.hypotheses[0].encoding
        return float(np.abs(decision_variable(encoding, [pair[0]], [pair[1]]))[0])

    @property
    def weber_fraction(self) -> float:
        """The textbook's estimate: the mean level (of logarithms) at all turns but the first two.

        NaN before the third turn, and for 1-up/1-down, which settles at chance. Lapses and bias
        move it; `fits` takes them into account.
        """
        turns = [d for track in self._tracks.values() for d in track.turns[2:]]
        share = 0.5 ** (1 / RULES[self.rule])
        if not turns or share == 0.5:
            return float("nan")
        return float(np.exp(np.mean(np.log(turns))) / ndtri(share))
