"""Columns that hold subjects or sessions under names that were not mapped."""

from __future__ import annotations

import numpy as np
import pandas as pd

from .._util.refusals import argument
from .order import DURATIONS, TIMES, words_of

__all__ = ["notes_of_pooled"]

#: What columns of subjects and of sessions are often called: a word of the name.
LOOKS_LIKE = {
    "subject": {
        "subject", "subjects", "subj", "sub", "subs", "subcode", "subid", "subno", "subnum", "sbj",
        "participant", "participants", "ppt", "ppid", "ppn", "partid", "observer", "vp", "vpn",
        "vpnr", "vpcode", "versuchsperson", "proband", "sujet", "sujeto", "soggetto", "deelnemer",
        "animal", "rat", "mouse", "monkey", "ferret", "bird", "pigeon", "cat", "dog", "human",
        "person", "people", "patient", "listener", "volunteer", "worker",
    },
    "session": {"session", "sessions", "sess", "ses", "day", "date", "visit", "block", "blk", "run",
                "bloc", "sitzung"},
}  # fmt: skip
#: The whole name of a column that may hold them, where its values are few and in long stretches.
MAY_BE = {"id", "uid", "code", "name", "initials", "user", "pp", "ss", "s", "obs", "part", "nr"}


def notes_of_pooled(further: pd.DataFrame, present: set[str]) -> list[str]:
    """Sentences on columns that look like subjects or sessions, where there are none of that name:
    their trials are taken as one."""
    notes, seen = [], False
    for ours, names in LOOKS_LIKE.items():
        for column in further if ours not in present else ():
            words = {*words_of(column)}
            named = not names.isdisjoint(words)
            repeated = 1 < further[column].nunique() <= len(further) / 2
            brief = ours == "subject" and len(words) == 1 and words <= MAY_BE
            if repeated and (named or (brief and _in_stretches(further[column]))):
                notes.append(_note(further[column], ours))
                seen = True
    if not seen and present.isdisjoint(LOOKS_LIKE):
        for column in further:
            words = {*words_of(column)}
            if words.isdisjoint(TIMES | DURATIONS) and _in_stretches(further[column]):
                notes.append(_note(further[column], "subject"))
                break
    return notes


def _note(cells: pd.Series, ours: str) -> str:
    column = str(cells.name)
    return (
        f"The column {column!r} has {cells.nunique()} values and is not used, so that all "
        f"trials are taken for one {ours}; "
        + argument("columns", {ours: column})
        + " would keep them apart."
    )


def _in_stretches(cells: pd.Series) -> bool:
    """Whether each of few values is in one stretch of rows, of ten or more."""
    texts = cells.astype(str).to_numpy()
    starts = np.flatnonzero(np.r_[True, texts[1:] != texts[:-1]])
    lengths = np.diff(np.r_[starts, len(texts)])
    number = cells.nunique(dropna=False)
    return bool(1 < number == len(starts) and np.median(lengths) >= 10)
