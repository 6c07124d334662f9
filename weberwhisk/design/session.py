"""Sessions: trial lists made beforehand, and trials placed one by one, on file as they come.

An animal should find nothing in the order of a list to earn its reward by but the stimuli. Three
levels of balance, from the outside in:

- *blocks*: every level (a standard and its comparison) comes equally often in each block, within
  one, so that a session that ends early, or a drift of the animal, touches all levels alike;
- *sides*: of the trials of every level, in half the comparison is the first stimulus and in half
  the second, within one, and so the second is the greater on half of the trials;
- *history*: within a session the right answer repeats as often as it changes, within a few trials,
  and stays for no more than `longest_run` trials running, where a block's sides are even enough for
  that. A short limit is itself a cue: with 3 (Gellermann 1933) an answer that came twice running
  changes in 64 % of trials, with 4 in 57 %, with 5, the default, in 54 % (blocks of 36).

Of trials placed one by one the file is the memory. Every answer is in it before the next trial is
given out, and when the process is started again, whatever ended it, the answers in the file are
learnt from again and the session goes on with the trial that it had come to.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from itertools import pairwise
from typing import Any, Self

import numpy as np
import pandas as pd

from .._util import checks
from .._util.output import Log
from .._util.refusals import Refusal
from .._util.values import Array, Index, Line
from ..behaviour.trials import Cells
from .magnitude import Magnitude
from .placement import BayesianPlacer, Proposal
from .scheme import Scheme

__all__ = [
    "Session", "bpod_table", "converse", "psychopy_tables", "read_log", "sessions_needed",
    "trial_lists", "with_places",
]  # fmt: skip

Counts = Index  # what NumPy counts with: 32 bits in a browser


def trial_lists(
    scheme: Scheme,
    *,
    trials_per_session: int = 300,
    longest_run: int = 5,
    one_stimulus: bool = False,
    seed: int | np.random.SeedSequence,
) -> pd.DataFrame:
    """The trials of all animals, balanced and randomised within blocks.

    Parameters
    ----------
    scheme : Scheme
    trials_per_session : int
        At most; the trials are spread evenly over as many sessions as that takes.
    longest_run : int
        Trials running on which the same answer may be right.
    one_stimulus : bool
        Yes/no and go/no-go: `stimulus_2` alone is put, `stimulus_1` is the standard held in mind,
        and `greater` is 2 where the right answer is "yes".
    seed : int or SeedSequence
        The same seed gives the same lists, on every platform. Each animal has an order of its own,
        which further animals leave as it is.

    Returns
    -------
    DataFrame
        One row a trial: `subject` (s1, s2, …), `session`, `block` and `trial` (each from 1, block
        and trial within the session), `level` (row of `scheme.table()`, from 1), `standard`,
        `stimulus_1`, `stimulus_2`, with their unit (`standard_mm`), `greater` (1 or 2: the stimulus
        that is the greater, and so the right answer). `weberwhisk fit` reads it once it has a
        column `choice`.

    Raises
    ------
    ValueError
        For a level without a right answer, sessions without trials, and the like.

    Examples
    --------
    >>> table = trial_lists(Scheme([20e-3], [-2e-3, 2e-3], 20, 2), trials_per_session=25, seed=1)
    >>> table.groupby(["subject", "session"])["greater"].value_counts().unique().tolist()
    [10]
    """
    checks.kind(
        "scheme", scheme, "a Scheme", "offsets", "write ww.design.Scheme([20e-3], [-2e-3, 2e-3])"
    )
    checks.whole("trials_per_session", trials_per_session, "write 300, say")
    if not isinstance(seed, np.random.SeedSequence):
        checks.whole("seed", seed, "write 1, say", least=0)
    checks.whole("longest_run", longest_run, "write 5, say", least=2)
    levels = scheme.cells()
    is_equal = levels.standard == levels.stimulus_2
    if is_equal.any():
        raise Refusal(
            f"A comparison equal to its standard, {levels.standard[is_equal][0]:g}, has no right "
            "answer to reward",
            remedy="leave the offset 0 out",
        )
    root = seed if isinstance(seed, np.random.SeedSequence) else np.random.SeedSequence(int(seed))
    lists = {}
    for i in range(scheme.animals):  # as `spawn` would, without counting it up
        animal_seed = np.random.SeedSequence(root.entropy, spawn_key=(*root.spawn_key, i))
        rng = np.random.default_rng(animal_seed)
        of_conditions = [
            _of_animal(levels, scheme.magnitude, trials_per_session, longest_run, one_stimulus, rng)
            for _ in scheme.conditions or ("",)
        ]
        lists[f"s{i + 1}"] = _alternating(of_conditions, scheme.conditions, i)
    return pd.concat(lists, names=["subject"]).reset_index(0).reset_index(drop=True)


def _alternating(
    lists: list[pd.DataFrame], conditions: tuple[str, ...], animal: int
) -> pd.DataFrame:
    """The lists of one animal with their conditions in sessions A B B A …, of the next B A A B."""
    if not conditions:
        return lists[0]
    moved_all = []
    for j, (condition, one) in enumerate(zip(conditions, lists, strict=True)):
        before = one["session"] - 1
        second = (before + animal + j) % 2
        moved = one.assign(session=2 * before + 1 + second)
        moved.insert(1, "condition", condition)
        moved_all.append(moved)
    return pd.concat(moved_all).sort_values(["session", "trial"], kind="stable", ignore_index=True)


def sessions_needed(levels: Cells, trials_per_session: int) -> tuple[int, int]:
    """Sessions of one animal, and blocks in all of them.

    A block has every level in both orders, where a session can be that long.
    """
    trials = levels.n.astype(np.intp)
    sessions = -(-int(trials.sum()) // trials_per_session)
    while True:
        blocks = max(-(-int(trials.max()) // 2), sessions)
        sizes = _dealt(trials, blocks).sum(axis=1)
        in_session = np.bincount(_session_of(blocks, sessions), sizes)
        if in_session.max() <= trials_per_session:
            return sessions, blocks
        sessions += 1


def _of_animal(
    levels: Cells, magnitude: Magnitude, per_session: int, longest_run: int, one_stimulus: bool,
    rng: np.random.Generator,
) -> pd.DataFrame:  # fmt: skip
    sessions, blocks = sessions_needed(levels, per_session)
    counts = _dealt(levels.n.astype(np.intp), blocks)
    session_of = _session_of(blocks, sessions)
    if one_stimulus:
        second = counts * (levels.stimulus_2 > levels.standard)
    else:
        second = _greater_second(counts, levels.standard, rng)
    picked: list[tuple[Counts, Counts]] = []
    for number in range(sessions):
        before: list[int] = []
        for block in np.flatnonzero(session_of == number):
            picked.append(_block(counts[block], second[block], before, longest_run, rng))
            before.extend(picked[-1][1].tolist())
    level, side = (np.concatenate(arrays) for arrays in zip(*picked, strict=True))
    # Numbered without gaps: a block may be empty where sessions are shorter than the levels.
    in_block = np.repeat(np.arange(blocks), counts.sum(axis=1))
    session = np.unique(session_of[in_block], return_inverse=True)[1]
    block = np.unique(in_block, return_inverse=True)[1]
    start = np.searchsorted(session, session)
    standard, comparison = levels.standard[level], levels.stimulus_2[level]
    comparison_second = (side == 2) == (comparison > standard)
    shown = magnitude.written([levels.standard, levels.stimulus_2])
    standard_shown, comparison_shown = shown[:, level]
    return pd.DataFrame(
        {
            "session": session + 1,
            "block": block - block[start] + 1,
            "trial": np.arange(level.size) - start + 1,
            "level": level + 1,
            magnitude.column("standard"): standard_shown,
            magnitude.column("stimulus_1"): np.where(
                comparison_second, standard_shown, comparison_shown
            ),
            magnitude.column("stimulus_2"): np.where(
                comparison_second, comparison_shown, standard_shown
            ),
            "greater": side,
        }
    )


def _dealt(trials: Counts, blocks: int) -> Counts:
    """How often each level comes in each block, (B, C): evenly, within one."""
    # Levels that do not divide evenly are put off against each other, so that blocks are alike.
    phase = np.arange(trials.size) * blocks // trials.size
    upto = (np.arange(blocks + 1)[:, None] * trials + phase) // blocks
    return np.diff(upto, axis=0)


def _session_of(blocks: int, sessions: int) -> Counts:
    """The session of each block, from 0: as many blocks in each, within one."""
    return np.arange(blocks, dtype=np.intp) * sessions // blocks


def _greater_second(counts: Counts, standard: Array, rng: np.random.Generator) -> Counts:
    """On how many of a level's trials in each block the second stimulus is the greater, (B, C).

    Half of them. An odd trial goes to the side that the level has had less of; levels that have
    had as many of both take sides in turn, standard by standard.
    """
    lead = np.zeros(counts.shape[1], dtype=np.intp)  # of "second" over "first", by level
    out = counts // 2
    for block, is_odd in enumerate(counts % 2 == 1):
        side = np.where(is_odd, -lead, 0)
        free = np.flatnonzero(is_odd & (lead == 0))
        free = free[np.lexsort((rng.random(free.size), standard[free]))]
        uneven = (lead + side).sum()
        first = -int(np.sign(uneven)) or 1 - 2 * int(rng.random() < 0.5)
        side[free[::2]], side[free[1::2]] = first, -first
        lead += side
        out[block] += side == 1
    return out


def _block(
    counts: Counts, second: Counts, before: list[int], longest_run: int, rng: np.random.Generator,
    candidates: int = 20,
) -> tuple[Counts, Counts]:  # fmt: skip
    """One block in its order: level and side (1 or 2, the greater stimulus) of each trial.

    Of so many sequences drawn the one that balances history best.
    """
    each = np.arange(counts.size)
    decks = [np.repeat(each, counts - second), np.repeat(each, second)]
    drawn = [
        _sequence([d.size for d in decks], before, longest_run, rng) for _ in range(candidates)
    ]

    def excess(drawn: list[int]) -> int:
        """How many more, or fewer, right answers repeat the one before than change it."""
        sides = [*before, *drawn]
        return abs(len(sides) - 1 - 2 * sum(a != b for a, b in pairwise(sides)))

    sides = np.array(min(drawn, key=excess), dtype=np.intp)
    level = np.empty(sides.size, dtype=np.intp)
    for side, deck in enumerate(decks, start=1):
        # Uniform numbers alone: the streams of the others may change between versions.
        level[sides == side] = deck[np.argsort(rng.random(deck.size), kind="stable")]
    return level, sides


def _sequence(
    left: list[int], before: list[int], longest_run: int, rng: np.random.Generator
) -> list[int]:
    """Sides drawn one after another without replacement; none that must end in too long a run."""
    remaining, out = list(left), []
    last, run = 0, 0
    for side in before:
        last, run = side, run + 1 if side == last else 1
    for u in rng.random(sum(left)):
        side = 1 if u * sum(remaining) < remaining[0] else 2
        if not _can_follow(side, remaining, last, run, longest_run):
            opposite = 3 - side
            if _can_follow(opposite, remaining, last, run, longest_run) or not remaining[side - 1]:
                side = opposite
        remaining[side - 1] -= 1
        last, run = side, run + 1 if side == last else 1
        out.append(side)
    return out


def _can_follow(side: int, remaining: list[int], last: int, run: int, longest_run: int) -> bool:
    """Whether `side` may come next, and all that then remain be placed without too long a run."""
    same, opposite = remaining[side - 1] - 1, remaining[2 - side]
    run = run + 1 if side == last else 1
    return (
        same >= 0
        and run <= longest_run
        and same <= longest_run - run + longest_run * opposite
        and opposite <= longest_run * (same + 1)
    )


#: What a keyboard takes as the answer where the greater stimulus is 1, or 2.
KEYS = {"yes/no": ("n", "y"), "go/no-go": ("None", "space")}
ANSWERS = ("left", "right")  # of two stimuli
#: Where stimulus 1 and stimulus 2 are.
PLACES = {"2AFC": ("left", "right"), "2IFC": ("first", "second")}


def with_places(lists: pd.DataFrame, task: str) -> pd.DataFrame:
    """The lists as they are written, with `standard_is`: whether the standard is the left or right
    stimulus, or the first or second, or "in mind" where one alone is put."""
    standard, first = (
        next(lists[column] for column in lists if str(column).startswith(name))
        for name in ("standard", "stimulus_1")
    )
    before, after = PLACES.get(task, ("in mind", "in mind"))
    standard_is = np.where((standard == first).to_numpy(), before, after)
    out = lists.copy()
    out.insert(list(lists.columns).index("greater"), "standard_is", standard_is)
    return out


def psychopy_tables(lists: pd.DataFrame, task: str = "2AFC") -> Iterator[tuple[str, pd.DataFrame]]:
    """A conditions file for each session of each animal, with its name.

    The names are those that PsychoPy's own participant and session make: `$"psychopy_" +
    expInfo["participant"] + "_" + expInfo["session"] + ".csv"`, with sessions 001, 002 and so on;
    the loop takes it in sequential order, once. `correct_answer` is what a keyboard component takes
    as its correct answer. The number of the trial is not called `trial`, which is the name of a
    routine there.
    """
    table = lists.rename(columns={"trial": "trial_number"})
    keys = KEYS.get(task, ANSWERS)
    table["correct_answer"] = [keys[greater - 1] for greater in table["greater"]]
    for (subject, session), conditions in table.groupby(["subject", "session"], sort=False):
        yield f"psychopy_{subject}_{session:03d}", conditions


def bpod_table(lists: pd.DataFrame) -> pd.DataFrame:
    """All trials in numbers alone, so that MATLAB's `readtable` or `readmatrix` takes them:
    `standard_is` is 1 where stimulus 1, the first or left, is the standard, and 2 else; conditions
    are numbered by name.

    `trial_type` is that of Bpod's examples, 1 where left is right and 2 where right is: `T =
    readtable("bpod.csv"); TrialTypes = T.trial_type(T.subject == 1 & T.session == 3)';`
    """
    table = lists.copy()
    if "standard_is" in table:
        second = table.pop("standard_is").isin([after for _, after in PLACES.values()])
        table["standard_is"] = np.where(second, 2, 1)
    if "condition" in table:
        table["condition"] = pd.factorize(table["condition"], sort=True)[0] + 1
    table["subject"] = table["subject"].str.removeprefix("s").astype(int)
    table.insert(4, "trial_type", table.pop("greater"))
    return table


# -- trial by trial -------------------------------------------------------------------------------


KIND = "session"


def read_log(path: str | os.PathLike[str]) -> tuple[pd.DataFrame, dict[str, Any]] | None:
    """The trials that a `Session` kept in a file, and its question; None of another file.

    Columns: `trial`, `standard`, `stimulus_1`, `stimulus_2` and `choice`, 1, 0 or NaN.
    """
    with open(path, "rb") as file:
        if not file.read(200).startswith(f'{{"weberwhisk_{KIND}"'.encode()):
            return None
        file.seek(0)
        lines = file.read().splitlines()
    records = []
    for line in lines:
        try:
            records.append(json.loads(line))
        except ValueError:  # the last may be half a line
            break
    question, *answers = records or [{}]
    table = pd.DataFrame(answers, columns=["trial", "standard", "comparison", "choice"])
    table = table.rename(columns={"comparison": "stimulus_2"})
    table.insert(2, "stimulus_1", table["standard"])
    return table.assign(choice=table["choice"].astype(float)), question


class Session(Line):
    """A placer whose trials are kept in a file, as a context manager.

    Parameters
    ----------
    placer : BayesianPlacer
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
        placer: BayesianPlacer,
        path: str | os.PathLike[str] | None,
        question: dict[str, Any] | None = None,
    ) -> None:
        self.placer = placer
        self._log = None if path is None else Log(path, KIND, question or {})
        self._open = ExitStack()

    def _line(self) -> str:
        where = "in memory" if self._log is None else f"in {str(self._log.path)!r}"
        return f"{where}; {self.placer!r}"

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
            raise Refusal(
                f"{str(self._log.path)!r} has a trial that cannot be read (line {place + 2}: "
                f"{error})",
                remedy="name another file",
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


def converse(
    session: Session, lines: Iterable[str], unit: str = "", repeat: str = ""
) -> Iterator[str]:
    """Trials out, answers in, a line of JSON each.

    A trial, ``{"trial": 1, "standard": …, "comparison": …, "easy": false, …}``, after every answer;
    ``{"error": "…"}`` where a line could not be used: the trial still stands; at the end
    ``{"finished": "…", "trials": …}``. Answers are ``1``, ``0`` or ``null`` (none given), or an
    object with ``choice`` and, where they differ from what was proposed, ``standard`` and
    ``comparison``; with ``trial``, its number, an answer that was sent twice is refused. `unit` is
    the ending of the names of stimuli, ``"_mm"``; `repeat` the command that fits the same trials,
    which is said at the end.
    """
    answers = iter(lines)
    while not session.finished:
        trial = session.next()
        names = f"standard{unit}", f"comparison{unit}"
        shown = dict(zip(names, (trial.standard, trial.comparison), strict=True))
        row = {"trial": trial.trial, **shown, "easy": trial.easy}
        yield json.dumps(row | _estimates(session.placer))
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
    about: dict[str, Any] = {"finished": session.finished, "trials": session.next().trial - 1}
    about |= {"repeat": repeat} if repeat else {}
    yield json.dumps(about | _estimates(session.placer))


def _estimates(placer: BayesianPlacer) -> dict[str, Any]:
    """What is known so far."""

    def rounded(values: dict[str, float]) -> dict[str, Any]:
        return {name: float(f"{value:.5g}") for name, value in values.items()}

    low, high = placer.interval()
    estimate = rounded({"weber_fraction": placer.weber_fraction, "low": low, "high": high})
    several = len(placer.hypotheses) > 1
    return estimate | ({"probabilities": rounded(placer.probabilities)} if several else {})


def _answer(line: str, trial: Proposal, names: tuple[str, str]) -> tuple[float, float, Any]:
    """What was shown, and the choice."""
    hint = 'write 1, 0, null, or {"choice": 1, "comparison...": ...}'
    try:
        given = json.loads(line)
    except (ValueError, RecursionError):  # brackets a thousand deep
        raise Refusal("an answer must be JSON", f"{line.strip()[:80]!r}", hint) from None
    if not isinstance(given, dict):
        return trial.standard, trial.comparison, given
    allowed = {"choice", "trial", *names}
    unknown = sorted({*given} - allowed)
    if "choice" not in given or unknown:
        wrong = f"{unknown[0]!r} is unknown" if unknown else "it has no choice"
        raise Refusal(
            f"an answer has choice and perhaps {', '.join(sorted(allowed - {'choice'}))}",
            f"{line.strip()} where {wrong}",
            hint,
        )
    if given.get("trial", trial.trial) != trial.trial:
        raise Refusal(
            f"trial {given['trial']} is not the one that is open",
            remedy=f"answer trial {trial.trial}",
        )
    standard, comparison = trial.standard, trial.comparison
    return given.get(names[0], standard), given.get(names[1], comparison), given["choice"]
