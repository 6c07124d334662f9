"""A session at the rig: trials on file as they come, line by line, and classical staircases.

The file is the memory. Every answer is in it before the next trial is given out, and when the
process is started again, whatever ended it, the answers in the file are learnt from again and the
session goes on with the trial that it had come to.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from .. import _checks
from ..behaviour.psychometric import SignedChoice, YesNo, decision_variable
from ..behaviour.trials import Cells
from ..campaign.log import Log
from .belief import Pair
from .hypotheses import Hypothesis
from .placement import BayesianPlacer, Placer, Proposal, TrialLog
from .scheme import Scheme

Array = NDArray[np.float64]

#: Right answers in a row that make it harder.
RULES = {"1-up/1-down": 1, "1-up/2-down": 2, "1-up/3-down": 3}


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
        Says what is asked and how a stimulus is encoded; the rule itself needs no more.
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
        super().__init__([hypothesis], scheme, seed)
        self.rule = _checks.one_of("rule", rule, RULES)
        for name, value in (("turns", turns), ("most", most)):
            if value is not None:
                _checks.positive(name, value, "write 12, say")
        self.turns, self.most = turns, most
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

    @property
    def finished(self) -> str:
        """Why there are trials enough; empty where there are not."""
        fewest = min(len(track.turns) for track in self._tracks.values())
        if self.turns is not None and fewest >= self.turns:
            return f"every track has turned {self.turns} times"
        return super().finished

    def _choose(self, number: int, rng: np.random.Generator, standard: float | None) -> Proposal:
        which, side = rng.random(2)
        s = self.scheme.standards[int(which * len(self._tracks))] if standard is None else standard
        levels = self._sides[s][int(side < 0.5)]
        return Proposal(number, s, float(levels[min(self._tracks[s].level, levels.size - 1)]))

    def _learn(self, pair: Pair, answer: int) -> None:
        """Move by an answer."""
        signed = isinstance(self.hypotheses[0].asked, SignedChoice | YesNo)
        right = answer == int(pair[1] > pair[0]) if signed else bool(answer)
        track = self._tracks[pair[2]]
        track.right = track.right + 1 if right else 0
        way = -1 if not right else int(track.right >= RULES[self.rule])
        if way == 0:
            return
        track.right = 0
        if track.way and way != track.way:
            track.turns.append(self._difficulty(pair))
        track.way = way
        stride = max(4 >> len(track.turns), 1)  # levels moved at once, halved with every turn
        lowest = max(side.size for side in self._sides[pair[2]]) - 1
        track.level = int(np.clip(track.level + way * stride, 0, lowest))

    def _encode(self, pair: Pair) -> None:
        self.hypotheses[0].model(Cells(*(np.array([v]) for v in (*pair, 1.0, 0.0))))

    def _difficulty(self, pair: Sequence[float]) -> float:
        """|d| of a trial for a Weber fraction of 1."""
        encoding = self.hypotheses[0].encoding
        return float(np.abs(decision_variable(encoding, [pair[0]], [pair[1]]))[0])

    @property
    def weber_fraction(self) -> float:
        """The textbook's estimate: the mean level (of logarithms) at all turns but the first two.

        NaN before the third turn, for 1-up/1-down, which settles at chance, and for tasks but 2AFC
        and 2IFC, whose right answers are not Φ of the level. Lapses and bias move it; `fits` takes
        them into account, and other tasks.
        """
        turns = [d for track in self._tracks.values() for d in track.turns[2:]]
        share = 0.5 ** (1 / RULES[self.rule])
        if not turns or share == 0.5 or not isinstance(self.hypotheses[0].asked, SignedChoice):
            return float("nan")
        return float(np.exp(np.mean(np.log(turns))) / ndtri(share))


KIND = "session"


class Session:
    """A placer whose trials are kept in a file, as a context manager.

    Parameters
    ----------
    placer : Placer
        Fresh: what is in the file is recorded in it again.
    path : path or None
        An append-only file of JSON lines. None: in memory alone.
    question : dict, optional
        How the placer was made, as JSON has it. A file of another question is refused.

    Raises
    ------
    ValueError
        If the file is of another question or of none, or is being written by another session.

    Examples
    --------
    >>> import tempfile
    >>> from weberwhisk.behaviour import IdentityEncoding
    >>> from weberwhisk.design import BayesianPlacer, Hypothesis, lattice
    >>> file, h = tempfile.mkdtemp() + "/rat1.jsonl", Hypothesis("Weber", IdentityEncoding())
    >>> def fresh():
    ...     return BayesianPlacer(h, lattice(h.encoding, 1.0), seed=1)
    >>> with Session(fresh(), file) as session:
    ...     for choice in (1, 0, None, 1):
    ...         trial = session.next()
    ...         session.record(trial.standard, trial.comparison, choice)
    >>> with Session(fresh(), file) as session:  # the rig was switched off
    ...     session.next().trial
    5
    """

    def __init__(
        self,
        placer: Placer,
        path: str | os.PathLike[str] | None,
        question: dict[str, Any] | None = None,
    ) -> None:
        self.placer = placer
        self._log = None if path is None else Log(path, KIND, question or {})
        self._open = ExitStack()

    def __enter__(self) -> Self:
        if self._log is not None:
            self._open.enter_context(self._log)
            try:
                for place, line in enumerate(self._log.lines):
                    self._again(place, json.loads(line))
            except BaseException:
                self._open.close()
                raise
        return self

    def __exit__(self, *error: object) -> None:
        self._open.close()

    def _again(self, place: int, row: dict[str, Any]) -> None:
        try:
            self.placer.record(row["standard"], row["comparison"], row["choice"])
        except (KeyError, TypeError, ValueError) as error:
            assert self._log is not None
            raise ValueError(
                f"{str(self._log.path)!r} has a trial that cannot be read (line {place + 2}: "
                f"{error}); name another file."
            ) from error

    @property
    def finished(self) -> str:
        """Why there are trials enough; empty where there are not."""
        return self.placer.finished

    def next(self, standard: float | None = None) -> Proposal:
        """The next trial, the same until it is recorded, also after a restart."""
        return self.placer.next(standard)

    def record(self, standard: float, comparison: float, choice: Any) -> None:
        """Keep and learn from a trial: what was shown, and the answer.

        Raises
        ------
        ValueError
            For what the placer refuses, and a file that cannot be written: the trial is not kept.
        """
        proposed = self.placer.next()
        self.placer.check(standard, comparison, choice)
        if self._log is not None:
            row = {
                "trial": proposed.trial,
                "standard": float(standard),
                "comparison": float(comparison),
                "choice": None if choice is None or choice != choice else int(choice),
                "easy": proposed.easy,
                "proposed": [proposed.standard, proposed.comparison],
            }
            self._log.append(json.dumps(row))  # where it fails, the trial still stands
        self.placer.record(standard, comparison, choice)

    def sync(self) -> None:
        """Have the trials on the disk, safe from a power cut too."""
        if self._log is not None:
            self._log.sync()


def converse(session: Session, lines: Iterable[str], unit: str = "") -> Iterator[str]:
    """Trials out, answers in, a line of JSON each.

    A trial, ``{"trial": 1, "standard": …, "comparison": …, "easy": false, …}``, after every answer;
    ``{"error": "…"}`` where a line could not be used: the trial still stands; at the end
    ``{"finished": "…", "trials": …}``. Answers are ``1``, ``0`` or ``null`` (none given), or an
    object with ``choice`` and, where they differ from what was proposed, ``standard`` and
    ``comparison``; with ``trial``, its number, an answer that was sent twice is refused. `unit` is
    the ending of the names of stimuli, ``"_mm"``.
    """
    answers = iter(lines)
    while not session.finished:
        trial = session.next()
        names = f"standard{unit}", f"comparison{unit}"
        shown = dict(zip(names, (trial.standard, trial.comparison), strict=True))
        row = {"trial": trial.trial, **shown, "easy": trial.easy}
        yield json.dumps(row | _known(session.placer))
        session.sync()  # while the animal is at it
        for line in answers:
            if not line.strip():
                continue
            try:
                answer = _answer(line, trial, names)
                session.placer.check(*answer)
            except ValueError as error:
                yield json.dumps({"error": " ".join(str(error).split())})
                continue
            session.record(*answer)  # a file that cannot be written ends the session
            break
        else:
            return
    about = {"finished": session.finished, "trials": session.next().trial - 1}
    yield json.dumps(about | _known(session.placer))


def _known(placer: Placer) -> dict[str, Any]:
    """What is known so far, where the placer knows it."""
    if not isinstance(placer, BayesianPlacer):
        return {}

    def rounded(values: dict[str, float]) -> dict[str, Any]:
        return {name: float(f"{value:.5g}") for name, value in values.items()}

    low, high = placer.interval()
    known = rounded({"weber_fraction": placer.weber_fraction, "low": low, "high": high})
    several = len(placer.hypotheses) > 1
    return known | ({"probabilities": rounded(placer.probabilities)} if several else {})


def _answer(line: str, trial: Proposal, names: tuple[str, str]) -> tuple[float, float, Any]:
    """What was shown, and the choice."""
    hint = 'write 1, 0, null, or {"choice": 1, "comparison...": ...}'
    try:
        given = json.loads(line)
    except (ValueError, RecursionError):  # brackets a thousand deep
        raise ValueError(f"an answer must be JSON, got {line.strip()[:80]!r}; {hint}.") from None
    if not isinstance(given, dict):
        return trial.standard, trial.comparison, given
    allowed = {"choice", "trial", *names}
    unknown = sorted({*given} - allowed)
    if "choice" not in given or unknown:
        wrong = f"{unknown[0]!r} is unknown" if unknown else "it has no choice"
        raise ValueError(
            f"an answer has choice and perhaps {', '.join(sorted(allowed - {'choice'}))}, got "
            f"{line.strip()} where {wrong}; {hint}."
        )
    if given.get("trial", trial.trial) != trial.trial:
        raise ValueError(
            f"trial {given['trial']} is not the one that is open; answer trial {trial.trial}."
        )
    standard, comparison = trial.standard, trial.comparison
    return given.get(names[0], standard), given.get(names[1], comparison), given["choice"]
