"""The same choices in tables of any shape are the same fit, or a note says why they are not."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from weberwhisk.behaviour import Trials, fit_weber, read_trials, simulate_trials

STIMULI = ["stimulus_1", "stimulus_2"]
OURS = {"session", "trial", "standard", "choice", *STIMULI}


@dataclass
class Shaped:
    """A table, what is said to read it, and whether a file holds it."""

    table: pd.DataFrame
    columns: dict[str, str] = field(default_factory=dict)
    labels: dict[Any, str] | None = None
    done: list[str] = field(default_factory=list)
    path: Path | None = None

    def read(self) -> Trials:
        source = self.table if self.path is None else self.path
        return read_trials(source, columns=self.columns, choice_labels=self.labels)


def made(rng: np.random.Generator) -> pd.DataFrame:
    standards = [[10.0], [10.0, 20.0, 40.0], [10.0, 15.0, 20.0, 30.0, 40.0]][rng.integers(3)]
    trials = simulate_trials(
        standards=standards, sessions=int(rng.integers(1, 4)), trials_per_level=6,
        order=str(rng.choice(["standard first", "random"])), missing=float(rng.choice([0, 0.05])),
        seed=rng,
    )  # fmt: skip
    kept = [c for c in ("session", "trial", "standard") if rng.random() < 0.6]
    return trials.table()[[*kept, *STIMULI, "choice"]]


def renamed(shaped: Shaped, rng: np.random.Generator) -> None:
    for column in rng.permutation(shaped.table.columns.to_numpy(str)):
        if rng.random() < 0.5:
            name = f"{rng.choice(['Var', 'Größe', 'my col', 'x.y'])}{rng.integers(1000)}"
            if name not in shaped.table:
                shaped.table = shaped.table.rename(columns={column: name})
                if column in OURS:
                    shaped.columns[str(column)] = name


def beside(shaped: Shaped, rng: np.random.Generator) -> None:
    """Columns that nobody asked for."""
    n = len(shaped.table)
    shaped.table = shaped.table.assign(rt=rng.random(n), condition=rng.choice(["a", "b"], n))


def reordered(shaped: Shaped, rng: np.random.Generator) -> None:
    shaped.table = shaped.table[rng.permutation(shaped.table.columns)]


def sorted_rows(shaped: Shaped, rng: np.random.Generator) -> None:
    by = rng.choice(shaped.table.columns.to_numpy(str), int(rng.integers(1, 4)), replace=False)
    shaped.table = shaped.table.sort_values([*by], kind="stable")


def shuffled(shaped: Shaped, rng: np.random.Generator) -> None:
    shaped.table = shaped.table.iloc[rng.permutation(len(shaped.table))]


def labelled(shaped: Shaped, rng: np.random.Generator) -> None:
    column = shaped.columns.get("choice", "choice")
    words = {0: "links", 1: "rechts"} if rng.random() < 0.5 else {0: "1", 1: "2"}
    cells = shaped.table[column].astype(object)
    said = pd.to_numeric(cells.where(cells.notna(), None), errors="coerce").map(words)
    shaped.table = shaped.table.assign(**{column: said})
    shaped.labels = {words[0]: "first", words[1]: "second"}


def retyped(shaped: Shaped, rng: np.random.Generator) -> None:
    for column in shaped.table.columns:
        cells = shaped.table[column]
        kind = rng.choice(["same", "object", "string", "category", "float", "text"])
        if kind == "float" and pd.api.types.is_numeric_dtype(cells):
            cells = cells.astype("float64")
        elif kind == "text":
            cells = cells.map(lambda v: "" if pd.isna(v) else str(v)).astype(object)
        elif kind in ("object", "string", "category"):
            cells = cells.astype(kind)
        shaped.table = shaped.table.assign(**{column: cells})


CHANGES = (renamed, beside, reordered, sorted_rows, shuffled, labelled, retyped)


def shaped_anyhow(table: pd.DataFrame, folder: Path, rng: np.random.Generator) -> Shaped:
    shaped = Shaped(table)
    for change in rng.permutation(np.array(CHANGES)):
        if rng.random() < 0.5:
            change(shaped, rng)
            shaped.done.append(change.__name__)
    if rng.random() < 0.4:
        encoding = str(rng.choice(["utf-8", "utf-8-sig", "utf-16", "cp1252"]))
        sep, decimal = ((",", "."), ("\t", "."), (";", ","))[rng.integers(3)]
        shaped.path = folder / "table.csv"
        text = shaped.table.to_csv(index=False, sep=sep, decimal=decimal)
        shaped.path.write_bytes(text.encode(encoding))
        shaped.done.append(f"written in {encoding}")
    return shaped


def answers(trials: Trials) -> pd.DataFrame:
    cells = trials.cells()
    columns = {name: getattr(cells, name) for name in (*STIMULI, "n", "count")}
    return pd.DataFrame(columns).groupby(STIMULI).sum().sort_index()


def said(trials: Trials, words: str) -> bool:
    return any(words in note for note in trials.notes)


@pytest.mark.parametrize("tables", [20, pytest.param(2000, marks=pytest.mark.slow)])
def test_the_fit_is_the_same_or_a_note_says_why_not(
    tables: int, tmp_path: Path, search_seed: int
) -> None:
    for number in range(tables):
        rng = np.random.default_rng([search_seed, number])
        table = made(rng)
        if rng.random() < 0.3:  # rows are lost
            table = table[rng.random(len(table)) > 0.1]
        plain = read_trials(table)
        shaped = shaped_anyhow(table, tmp_path, rng)
        read = shaped.read()
        where = f"seed {search_seed}, table {number}: {', '.join(shaped.done)}; {read.notes}"
        pd.testing.assert_frame_equal(answers(read), answers(plain), rtol=1e-9, obj=where)
        assert read.standards.tolist() == plain.standards.tolist(), where
        assert read.has_standards or said(read, "is the standard"), where
        assert read.n_missing == plain.n_missing, where
        if read.course.is_known != plain.course.is_known:
            unchecked = plain if read.course.is_known else read
            assert said(unchecked, "not taken for a course of time"), where
        elif read.course.is_known and "trial" in table:
            pd.testing.assert_series_equal(read.frame["count"], plain.frame["count"], obj=where)
        if number % 100 == 7:
            one, other = fit_weber(read), fit_weber(plain)
            np.testing.assert_allclose(one.interval(), other.interval(), rtol=1e-6, err_msg=where)
            if read.course.is_known == plain.course.is_known and "trial" in table:
                assert one.status is other.status, where


@pytest.mark.slow
def test_selecting_each_subject_takes_as_long_whatever_their_number() -> None:
    """Of a thousand it took six times as long a subject as of a hundred; of 500 beside 25, more."""
    rng = np.random.default_rng(1)

    def seconds(subjects: int) -> float:
        n = 306 * subjects
        trials = read_trials(pd.DataFrame({
            "subject": np.repeat(np.arange(subjects), 306),
            "trial": np.tile(np.arange(306), subjects),
            "stimulus_1": 100.0, "stimulus_2": rng.choice([80.0, 90, 110, 120], n),
            "choice": rng.integers(0, 2, n),
        }))  # fmt: skip
        start = time.process_time()
        for subject in trials.subjects:
            assert trials.select(subject=subject).n_trials == 306
        return (time.process_time() - start) / subjects

    assert seconds(250) <= 2.5 * min(seconds(25) for _ in range(3))
