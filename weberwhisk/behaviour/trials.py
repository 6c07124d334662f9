"""A table of trials: the schema, and the nouns made from it."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property, partial, reduce
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from .._util import checks
from .._util.output import atomic_write, csv_text
from .._util.refusals import Advice, Refusal, argument
from .._util.values import Array, Flags, Index, Line, counted
from .order import Course, after_gap, course_of, session_block
from .standards import NAMING
from .tasks import Task

__all__ = [
    "LABELS", "SCALES", "SDS", "STIMULI", "Cells", "Trials", "check_trials", "in_millimetres",
    "joined", "needs_order", "needs_rows", "needs_standards", "notes_of", "rows_in_words",
    "sessions_of",
]  # fmt: skip

SCALES = ("linear", "log")
LABELS = ("subject", "session", "trial")
STIMULI = ("standard", "stimulus_1", "stimulus_2")
COLUMNS = (*STIMULI, "n", "count")
SDS = ("stimulus_1_sd", "stimulus_2_sd")  # of measured places, where `with_distances` put them in


@dataclass(frozen=True)
class Cells:
    """Trials gathered into unique pairs of stimuli, sorted by standard; arrays (C,).

    `count` of the `n` trials had the answer: "second greater", or correct. `sd_1` and `sd_2` are
    the sds with which the places of the stimuli are known, where they were measured.
    """

    stimulus_1: Array
    stimulus_2: Array
    standard: Array
    n: Array
    count: Array
    sd_1: Array | None = None
    sd_2: Array | None = None

    def of(self, standard: float) -> Cells:
        """The cells of one standard."""
        keep = self.standard == standard
        own = (None if a is None else a[keep] for a in (self.sd_1, self.sd_2))
        some = (self.stimulus_1, self.stimulus_2, self.standard, self.n, self.count)
        return Cells(*(a[keep] for a in some), *own)


@dataclass(frozen=True, repr=False)
class Trials(Line):
    """Choices of one or more observers, checked.

    Parameters
    ----------
    frame : DataFrame
        One row a trial, or a row of `n` trials. Columns: `stimulus_1`, `stimulus_2` (magnitudes,
        logarithms, or radial distances in metres), `standard`, `n`, `count` (how many of the n were
        answered "second greater", or correctly; NaN where the animal gave no answer), and where
        known `subject`, `session`, `trial`.
    task : Task
        What was asked.
    scale : {"linear", "log"}
        Whether the columns are magnitudes or their logarithms.
    log_unit : float, optional
        On a log scale: natural-log units per unit of the column, None where that is unknown.
    source : str
        Where the table came from, for messages.
    reading : tuple of str
        Notes on how the table was read, which hold of any part of it.
    rows : ndarray of int, optional
        Where each row stands in the file, the first below the header being 1.
    has_standards : bool
        Whether `standard` is the standard of each trial; else it gathers pairs alone.
    in_order : bool, optional
        Whether rows are in the order in which the trials were run; left out, `course` reads it
        off the table.

    Raises
    ------
    ValueError
        For a frame without these columns, counts that are none, an unknown scale.

    Examples
    --------
    >>> from weberwhisk import simulate_trials
    >>> trials = simulate_trials(trials_per_level=20, sessions=3, seed=1)
    >>> trials.n_trials, trials.sessions, trials.select(session=[1, 2]).n_trials
    (180, [1, 2, 3], 120)
    >>> trials.cells().n
    array([20., 20., 20., 20., 20., 20., 20., 20., 20.])
    """

    frame: pd.DataFrame = field(repr=False)
    task: Task
    scale: str = "linear"
    log_unit: float | None = None
    source: str = "table"
    reading: tuple[str, ...] = ()
    rows: Index | None = field(default=None, repr=False, compare=False)
    has_standards: bool = True
    in_order: bool | None = None

    def __post_init__(self) -> None:
        hint = "make it with ww.read_trials, which takes a table under any names"
        checks.kind("frame", self.frame, "a DataFrame", "columns", hint)
        lacking = [c for c in COLUMNS if c not in self.frame]
        if lacking:
            raise Refusal(f"frame has no column {', '.join(map(repr, lacking))}", remedy=hint)
        checks.kind(
            "task", self.task, "a Task", "decide", "write ww.behaviour.task_named('2AFC'), say"
        )
        checks.one_of("scale", self.scale, SCALES)
        n, count = (self.frame[c].to_numpy(float) for c in ("n", "count"))
        wrong = ~np.isfinite(n) | (n < 0) | (n != np.round(n)) | (count < 0) | (count > n)
        if wrong.any():
            raise Refusal(
                f"frame has n = {n[wrong][0]:g} and count = {count[wrong][0]:g} in a row",
                remedy=(
                    "n must be a whole number and count lie between 0 and n, or be NaN for "
                    "no answer"
                ),
            )

    def __len__(self) -> int:
        return len(self.frame)

    def _table(self) -> pd.DataFrame:
        return self.frame

    def _line(self) -> str:
        who = f" of {len(self.subjects)} subjects" if len(self.subjects) > 1 else ""
        lost = f", {self.n_missing} without" if self.n_missing else ""
        notes = f"; {counted(len(self.notes), 'note')}" if self.notes else ""
        return (
            f"{self.n_trials} with an answer{lost}, in {counted(len(self), 'row')}{who}; "
            f"{self.task.name}, {self.scale} scale, {self.source}{notes}"
        )

    @property
    def unit_known(self) -> bool:
        """Whether differences of stimuli have a unit that a Weber fraction can be in."""
        return self.scale == "linear" or self.log_unit is not None

    @property
    def n_trials(self) -> int:
        """Trials with an answer."""
        return int(self.frame.loc[self.frame["count"].notna(), "n"].sum())

    @property
    def answered(self) -> Flags:
        """Which rows have an answer to some trial."""
        return (self.frame["count"].notna() & (self.frame["n"] > 0)).to_numpy(bool)

    @property
    def n_missing(self) -> int:
        """Trials without an answer: kept in the table, not in any likelihood."""
        return int(self.frame.loc[self.frame["count"].isna(), "n"].sum())

    @property
    def subjects(self) -> list[Hashable]:
        """Subjects in the table, empty where it has no such column."""
        return self._levels("subject")

    @property
    def sessions(self) -> list[Hashable]:
        """Sessions in the table, empty where it has no such column."""
        return self._levels("session")

    @property
    def standards(self) -> Array:
        """Standards in the table, rising; empty where it is not known which stimuli they are."""
        return np.unique(
            self.frame["standard"].to_numpy(float)[: None if self.has_standards else 0]
        )

    @cached_property
    def course(self) -> Course:
        """Whether rows are a course of time; without one there is no history, streak or drift."""
        return course_of(self.frame, self.in_order)

    @cached_property
    def follows(self) -> Flags:
        """Which rows are the trial right after that of the row before."""
        start = np.diff(session_block(self.frame), prepend=-1) != 0
        return ~start & ~after_gap(self.frame, self.rows)

    def _levels(self, column: str) -> list[Any]:
        if column not in self.frame:
            return []
        found = self.frame[column].unique().tolist()
        # Numbers and text side by side: numbers first.
        return sorted(found, key=lambda label: (isinstance(label, str), label))

    def select(self, **chosen: Any) -> Trials:
        """The trials whose columns have these values.

        Parameters
        ----------
        **chosen
            Column = one value, or several: `select(subject="s1", session=range(20, 41))`.

        Raises
        ------
        ValueError
            For an unknown column, or where nothing is left.

        See Also
        --------
        without : all trials but some.
        """
        each = [self._places(column, several_values(value)) for column, value in chosen.items()]
        # Of the few rows of one of a thousand subjects: all would be sorted for each of them.
        shared = partial(np.intersect1d, assume_unique=True)
        places = reduce(shared, each) if each else np.arange(len(self))
        if not places.size:
            words = ", ".join(f"{column} = {value!r}" for column, value in chosen.items())
            raise Refusal(
                f"{self.source}: no trials have {words}",
                remedy=f"choose values that occur: {self._values_in_words(*chosen)}",
            )
        return self._at(places)

    def without(self, **left_out: Any) -> Trials:
        """The trials but those whose columns have any of these values.

        Parameters
        ----------
        **left_out
            Column = one value, or several: `without(block="practice", session=[1, 2])` leaves out
            the trials of that block, and those of these sessions.

        Raises
        ------
        ValueError
            For an unknown column, a value that no trial has, or where nothing is left.

        Examples
        --------
        >>> from weberwhisk import simulate_trials
        >>> trials = simulate_trials(sessions=3, trials_per_level=3, seed=1)
        >>> trials.without(session=1).sessions
        [2, 3]
        """
        kept = np.ones(len(self), dtype=bool)
        for column, value in left_out.items():
            for one in several_values(value):
                places = self._places(column, [one])
                if not places.size:
                    raise Refusal(
                        f"{self.source}: no trials have {column} = {one!r}",
                        remedy=f"leave out values that occur: {self._values_in_words(column)}",
                    )
                kept[places] = False
        if not kept.any():
            words = " or ".join(f"{column} = {value!r}" for column, value in left_out.items())
            raise Refusal(
                f"{self.source}: all trials have {words}",
                remedy="leave out fewer, or give a table with other trials",
            )
        return self._at(np.flatnonzero(kept))

    def _values_in_words(self, *columns: str) -> str:
        levels = {c: [one for one in self._levels(c) if one == one] for c in columns}  # not NaN
        return ", ".join(f"{c} has {checks.listed(of, 8)}" for c, of in levels.items())

    def _places(self, column: str, values: Iterable[Any]) -> Index:
        """The rows in which a column has any of these values."""
        checks.one_of("the column", column, map(str, self.frame.columns))
        gathered = self._gathered(column)
        of_each = [gathered[v] for v in dict.fromkeys(values) if v in gathered]
        return np.sort(np.concatenate(of_each)) if of_each else np.zeros(0, dtype=np.intp)

    def _at(self, places: Index) -> Trials:
        """The trials of these rows."""
        frame = self.frame.iloc[places].reset_index(drop=True)
        rows = (np.arange(1, len(self) + 1) if self.rows is None else self.rows)[places]
        return replace(self, frame=frame, rows=rows)

    def _gathered(self, column: str) -> Mapping[Hashable, Index]:
        """The rows of each value of a column, looked for once: a population takes each subject by
        itself, and would go through the whole table for every one."""
        kept: dict[str, Mapping[Hashable, Index]] = self.__dict__.setdefault("_by_value", {})
        if column not in kept:
            indices = self.frame.groupby(column, sort=False).indices
            kept[column] = {value: np.asarray(places) for value, places in indices.items()}
        return kept[column]

    @cached_property
    def notes(self) -> tuple[str, ...]:
        """What a reader should know: missing answers, rows that occur twice, whether rows are in
        order, and how the table was read."""
        order = (self.course.note,) if self.course.note else ()
        return (*notes_of(self.frame, self.rows), *order, *self.reading)

    def __getstate__(self) -> dict[str, Any]:
        return {f.name: getattr(self, f.name) for f in fields(self)}  # not what is quickly remade

    def cells(self) -> Cells:
        """Trials with an answer, gathered into unique (standard, stimulus 1, stimulus 2)."""
        return self.gathered()[0]

    def gathered(self, *columns: Array) -> tuple[Cells, Array, Index]:
        """The same, those apart that differ in further columns, a number a row; these, (E, C); and
        the cell of each row with an answer."""
        sds = [c for c in SDS if c in self.frame]
        numbers = [self.frame[c].to_numpy(float) for c in (*COLUMNS[:3], *sds, "n", "count")]
        rows = np.column_stack([*numbers[:-2], *columns, *numbers[-2:]])
        rows = rows[self.answered]
        order = np.lexsort(rows[:, -3::-1].T)
        rows = rows[order]
        new = np.any(np.diff(rows[:, :-2], axis=0) != 0, axis=1)
        starts = np.flatnonzero(np.r_[len(rows) > 0, new])
        cell = np.empty(len(rows), dtype=np.intp)
        cell[order] = np.r_[0, np.cumsum(new)][: len(rows)]
        n, count = np.add.reduceat(rows[:, -2:], starts, axis=0).T
        standard, s1, s2, *own = rows[starts, : 3 + len(sds)].T
        cells = Cells(s1, s2, standard, n, count, *own)
        return cells, rows[starts, 3 + len(sds) : -2].T, cell

    def table(self) -> pd.DataFrame:
        """The trials under the names that `read_trials` takes without a mapping."""
        single = bool((self.frame["n"] == 1).all())
        answer = self.task.response if single else f"n_{_COUNT_NAMES[self.task.response]}"
        out = self.frame.rename(columns={"count": answer})
        out[answer] = out[answer].astype("Int64")
        out = out if self.has_standards else out.drop(columns="standard")
        return out.drop(columns="n") if single else out

    def to_csv(self, path: str | Path) -> Path:
        """Write `table()`; the file is complete or absent, never half-written."""
        atomic_write(path, csv_text(self.table()))
        return Path(path)


def notes_of(frame: pd.DataFrame, rows: Index | None = None) -> tuple[str, ...]:
    """What a reader should know of a table whose rows have these places in their file."""
    places = np.arange(1, len(frame) + 1) if rows is None else rows
    notes = []
    missing = int(frame.loc[frame["count"].isna(), "n"].sum())
    if missing:
        said = counted(missing, "trial")
        notes.append(f"{said} without an answer: left out of the likelihood.")
    if "trial" in frame or (frame["n"] > 1).any():
        twice = frame.duplicated().to_numpy()
        if twice.any():
            notes.append(
                f"{counted(int(twice.sum()), 'repeated row')}, the first in "
                f"{rows_in_words(places[twice])}: counted as it stands."
            )
    empty = int((frame["n"] == 0).sum())
    if empty:
        notes.append(f"{counted(empty, 'row')} of a level without trials, which says nothing.")
    return tuple(notes)


def joined(parts: list[Trials]) -> Trials:
    """Tables of one task, scale and unit, one below the other."""
    if not isinstance(parts, list | tuple):
        raise Refusal("parts must be a list of Trials", checks.shown(parts))
    words, reading = set(), dict[str, None]()
    has_standards = True
    for part in parts:
        check_trials(part)
        words.add(part.in_order)
        reading |= dict.fromkeys(part.reading)
        has_standards &= part.has_standards
    if not parts:
        raise Refusal("there are no tables to join", remedy="give one or more")
    kinds = {(t.task.name, t.scale, t.log_unit) for t in parts}
    if len(kinds) > 1:
        raise Refusal(
            f"tables of {len(kinds)} kinds (task, scale, unit) were given",
            remedy="join those of one kind",
        )
    if len(parts) == 1:
        return parts[0]
    frame = pd.concat([t.frame for t in parts], ignore_index=True)
    return replace(
        parts[0], frame=frame, reading=tuple(reading), rows=None,
        has_standards=has_standards,
        in_order=words.pop() if len(words) == 1 else None,
    )  # fmt: skip


def rows_in_words(rows: ArrayLike) -> str:
    """Rows in words, the first below the header being 1."""
    numbers = np.atleast_1d(np.asarray(rows))
    shown = ", ".join(map(str, numbers[:3].tolist()))
    more = f" and {numbers.size - 3} more" if numbers.size > 3 else ""
    return f"row{'s' if numbers.size > 1 else ''} {shown}{more}"


def check_trials(trials: Any) -> None:
    """Refuses what is not a table of trials, with the line that makes one."""
    made = "ww.read_trials('file.csv')"
    if isinstance(trials, str | Path):
        made = f"ww.read_trials({str(trials)!r})"
    elif isinstance(trials, pd.DataFrame):
        made = "ww.read_trials(table)"
    checks.kind("trials", trials, "Trials", "cells", f"write {made}")


_COUNT_NAMES = {"choice": "greater", "correct": "correct"}


def in_millimetres(table: pd.DataFrame) -> dict[str, str]:
    """Our names of the stimuli that a table has in mm alone, and its own."""
    return {
        name: f"{name}_mm"
        for name in (*STIMULI, "comparison")
        if f"{name}_mm" in table and name not in table
    }


def several_values(value: Any) -> Iterable[Any]:
    """The values given, of which a text is one."""
    return [value] if isinstance(value, str) or not isinstance(value, Iterable) else value


def needs_order(trials: Trials, what: str) -> None:
    if trials.task.bias_name != "bias":
        raise Refusal(
            f"{what} needs to know which interval held which stimulus",
            f"task {trials.task.name!r}",
            "it goes with '2AFC' and '2IFC'",
        )


def needs_rows(trials: Trials, what: str) -> None:
    if (trials.frame["n"] != 1).any():
        raise Refusal(
            Advice(f"{trials.source}: ", what, " needs a row a trial"),
            "counts",
            "give the trials in their order",
        )
    if not trials.course.is_known:
        raise Refusal(
            Advice(f"{trials.source}: ", what, " needs the trials in the order of their run"),
            f"rows of which that is not known ({trials.course.why})",
            "sort by session and trial and name these columns, or write "
            + argument("in_order", True)
            + " where the file is read",
        )


def needs_standards(trials: Trials, what: str) -> None:
    if not trials.has_standards:
        raise Refusal(
            Advice(f"{trials.source}: ", what, " needs to know which stimulus is the standard"),
            "none that is known",
            "name its column, " + NAMING,
        )


def sessions_of(trials: Trials, what: str) -> tuple[list[Any], Index]:
    """Sessions in order (text as it first appears in the table), and the place of each row's."""
    if what and len(trials.sessions) < 2:
        raise Refusal(
            f"{trials.source}: {what} needs two sessions or more",
            len(trials.sessions),
            "give the table a column 'session'",
        )
    sessions = trials.frame["session"]
    place, levels = pd.factorize(sessions, sort=pd.api.types.is_numeric_dtype(sessions))
    return levels.tolist(), place
