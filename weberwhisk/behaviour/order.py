"""Whether the rows of a table are a course of time, and which row follows which trial.

Rows are a course of time where trials are numbered, a session or a time is written beside them, or
the user says so. A table that looks sorted is none.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from .._util.refusals import argument
from .._util.values import Array, Flags, Index

__all__ = [
    "Course", "after_gap", "course_of", "is_numbered", "put_in_order", "session_block",
    "trials_rise", "words_of",
]  # fmt: skip

#: Words of the name of a column that counts trials or tells the time; none of the others.
TIMES = {
    "trial", "trials", "trialnum", "trialno", "trialnumber", "trialid", "trl", "index", "time",
    "times", "timestamp", "datetime", "onset", "start", "started", "elapsed", "clock",
}  # fmt: skip
DURATIONS = {"rt", "reaction", "response", "duration", "isi", "iti", "delay", "type", "types"}
NUMBERING = argument("columns", {"trial": "<its name>"}) + " names their numbers"
SESSIONS = argument("columns", {"session": "<its name>"}) + " names their sessions"


@dataclass(frozen=True)
class Course:
    """Whether rows are a course of time; `why` not, as a clause; and a sentence for readers."""

    is_known: bool
    why: str = ""
    note: str = ""


def course_of(frame: pd.DataFrame, in_order: bool | None) -> Course:
    """Whether the rows of a table are a course of time; `in_order` is the user's word."""
    if (frame["n"] != 1).any() or len(frame) < 3:
        return Course(bool((frame["n"] == 1).all()))
    if in_order is not None:
        return Course(in_order, "" if in_order else "in_order=False says that they are in none")
    if is_numbered(frame):
        if not trials_rise(frame):
            return _no_course("trial numbers fall or sessions come in pieces", SESSIONS)
        if _answers_are_sorted(frame):
            return _no_course("they look sorted by the answer, whatever their numbers")
        return Course(True)
    if not trials_rise(frame):
        return _no_course("sessions come in pieces")
    if _looks_sorted(frame):
        return _no_course("they look sorted: neighbours are alike far more often than by chance")
    source = _time_column(frame)
    if source is None and "session" not in frame:
        return _no_course("no column has trial numbers, sessions or times")
    if source is None:
        return Course(True)
    said = f"The rows were taken to be in order, as the column {source!r} rises; "
    return Course(True, note=said + argument("in_order", False) + " says that they are not.")


def _no_course(why: str, naming: str = NUMBERING) -> Course:
    return Course(
        False,
        why,
        f"The rows are not taken for a course of time ({why}), so that streaks, history and drift "
        "are not looked for; "
        + naming
        + ", and "
        + argument("in_order", True)
        + " says that rows are in order.",
    )


def session_block(frame: pd.DataFrame) -> Index:
    """Which stretch of rows of one session each row lies in."""
    new = np.zeros(len(frame), dtype=bool)
    for label in ("subject", "session"):
        if label in frame:
            new |= (frame[label] != frame[label].shift(1)).to_numpy()
    return np.cumsum(new)


def is_numbered(frame: pd.DataFrame) -> bool:
    """Whether trials have numbers."""
    return "trial" in frame and pd.api.types.is_numeric_dtype(frame["trial"])


def trials_rise(frame: pd.DataFrame) -> bool:
    """Whether rows come session by session, trials rising in each, as far as columns say."""
    block = session_block(frame)
    labels = frame[[label for label in ("subject", "session") if label in frame]]
    if labels.size and block[-1] - block[0] >= len(labels.drop_duplicates()):
        return False
    if not is_numbered(frame):
        return True
    return bool((frame["trial"].groupby(block).diff().dropna() >= 0).all())


def after_gap(frame: pd.DataFrame, places: Index | None) -> Flags:
    """Where the trial before is not in the table: trial numbers of a session skip some, or, without
    numbers, places in the file do."""
    if is_numbered(frame):
        return (frame["trial"].groupby(session_block(frame)).diff() > 1).to_numpy(bool)
    if places is None:
        return np.zeros(len(frame), dtype=bool)
    return np.diff(places, prepend=places[:1]) > 1


def put_in_order(frame: pd.DataFrame) -> Index | None:
    """The order of rows by session and number of the trial; None where they are in it, or where
    two have one number."""
    if not is_numbered(frame) or trials_rise(frame):
        return None
    labels = [label for label in ("subject", "session") if label in frame]
    if frame.duplicated([*labels, "trial"]).any():
        return None
    keys = [frame["trial"].to_numpy()]
    for label in reversed(labels):
        place, levels = pd.factorize(frame[label])
        if label == "session":
            place = np.argsort(np.argsort(_padded(levels)))[place]
        keys.append(place)
    return np.lexsort(keys)


def _padded(levels: Any) -> list[str]:
    """Levels as text whose numbers are of one length, so that 10 comes after 9."""
    return [re.sub(r"\d+", lambda digits: digits[0].zfill(20), str(level)) for level in levels]


def words_of(column: object) -> list[str]:
    """The words of a column's name, in small letters.

    Examples
    --------
    >>> words_of("SubjectID"), words_of("trial_start.time2")
    (['subject', 'id'], ['trial', 'start', 'time'])
    """
    spaced = re.sub(r"(?<=[a-zà-ÿ])(?=[A-Z])", " ", str(column))
    return [word for word in re.split(r"[^a-zà-ÿ]+", spaced.lower()) if word]


def _time_column(frame: pd.DataFrame) -> str | None:
    """A column whose name is of times or trial numbers, and which rises but for new starts."""
    for column in frame:
        words = {*words_of(column)}
        if words.isdisjoint(TIMES) or not words.isdisjoint(DURATIONS):
            continue
        cells = frame[column]
        if cells.dtype.kind == "M":
            values = cells.astype("int64").to_numpy(float)
        else:
            values = pd.to_numeric(cells, errors="coerce").to_numpy(float, na_value=np.nan)
            if np.isnan(values).mean() > 0.5 and cells.dtype.kind not in "fiub":
                times = pd.to_datetime(cells, errors="coerce", format="ISO8601", utc=True)
                values = np.where(times.isna(), np.nan, times.astype("int64").to_numpy(float))
        steps = np.diff(values[np.isfinite(values)])
        if steps.size >= 0.9 * (len(frame) - 1) and (steps > 0).sum() >= 0.95 * steps.size:
            return str(column)
    return None


def _looks_sorted(frame: pd.DataFrame) -> bool:
    """Whether stimuli or answers of neighbouring rows are alike far more often than by chance."""
    block = session_block(frame)
    s1, s2 = (frame[name].to_numpy(float) for name in ("stimulus_1", "stimulus_2"))
    pair = s1 + 1j * s2
    answer = frame["count"].to_numpy(float, na_value=-1.0)
    repeats = (
        any(_repeats(v, block) > 0.25 for v in (s1, s2, pair)) or _repeats(answer, block) > 0.9
    )
    return bool(repeats or _is_monotone(s1, block) or _is_monotone(s2, block))


def _repeats(values: Any, block: Index) -> float:
    """The share of possible repeats of neighbours beyond those by chance; 0 where chance may be
    all."""
    _, code = np.unique(values, return_inverse=True)
    within = np.diff(block) == 0
    seen = float(((np.diff(code.reshape(-1)) == 0) & within).sum())
    counts = pd.Series(1.0).repeat(len(block)).groupby([block, code.reshape(-1)]).size()
    sizes = counts.groupby(level=0).transform("sum")
    expected = float((counts * (counts - 1) / sizes).sum())
    most = float(within.sum())
    free = most - expected
    if free < 5 or seen - expected < 6 * np.sqrt(expected * free / most + 1):
        return 0.0
    return (seen - expected) / free


def _is_monotone(values: Array, block: Index) -> bool:
    """Whether steps between neighbours nearly all go one way."""
    steps = np.diff(values)[np.diff(block) == 0]
    up, down = int((steps > 0).sum()), int((steps < 0).sum())
    total = up + down
    return total >= 10 and max(up, down) > total / 2 + max(6 * np.sqrt(total / 12), total / 4)


def _answers_are_sorted(frame: pd.DataFrame) -> bool:
    """Whether answers hardly change within stretches of one pair of stimuli."""
    answered = frame[frame["count"].notna()]
    stimuli = answered[["stimulus_1", "stimulus_2"]]
    new = (stimuli != stimuli.shift(1)).any(axis=1).to_numpy()
    run, count = np.cumsum(new), answered["count"].to_numpy(float)
    changes = float(((np.diff(count) != 0) & (np.diff(run) == 0)).sum())
    n, k = np.bincount(run).astype(float), np.bincount(run, count)
    expected = float((2 * k * (n - k) / np.maximum(n, 1)).sum())
    return changes < expected - 6 * np.sqrt(expected) and changes < 0.35 * expected
