"""The cells of a table, checked: each problem as one sentence with its place and remedy."""

from __future__ import annotations

from collections.abc import Mapping
from difflib import get_close_matches
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from .. import _checks

Array = NDArray[np.float64]


def missing_column(name: str, column: str, here: list[str], why: str) -> str:
    """The sentence for a column that is not there."""
    near = get_close_matches(column, here, n=1, cutoff=0.5)
    meant = f" (did you mean {near[0]!r}?)" if near else ""
    return (
        f"{name}: there is no column {column!r}, {why}{meant}; the columns are "
        f"{', '.join(here)}, and columns={{{column!r}: '<its name>'}} maps one."
    )


def rows_of(bad: NDArray[np.bool_]) -> str:
    """Rows in words, the first below the header being 1."""
    rows = np.flatnonzero(bad) + 1
    shown = ", ".join(map(str, rows[:3]))
    more = f" and {rows.size - 3} more" if rows.size > 3 else ""
    return f"row{'s' if rows.size > 1 else ''} {shown}{more}"


def numbers_of(column: pd.Series, label: str, name: str, problems: list[str]) -> Array:
    """The column as floats; text, gaps and infinities are problems."""
    blank = column.isna().to_numpy() | (column.astype(str).str.strip() == "").to_numpy()
    values = pd.to_numeric(column, errors="coerce").to_numpy(float)
    text = np.isnan(values) & ~blank
    if text.any():
        first = column[text].iloc[0]
        problems.append(
            f"{name}, column {label!r}, {rows_of(text)}: {first!r} is not a number; "
            "write digits alone."
        )
    lost = blank | np.isinf(values)
    if lost.any():
        problems.append(
            f"{name}, column {label!r}, {rows_of(lost)}: empty, NaN or infinite; "
            "give the stimulus or remove the row."
        )
    return values


def check_stimuli(
    numbers: dict[str, Array], name: str, scale: str, whisker: Any, problems: list[str]
) -> None:
    """Add a sentence for magnitudes that are not above zero, and distances off the whisker."""
    for label, values in numbers.items():
        if label == "log_ratio" or scale == "log":
            continue
        low = np.isfinite(values) & (values <= 0)
        if low.any():
            problems.append(
                f"{name}, column {label!r}, {rows_of(low)}: a magnitude must be above zero, got "
                f"{values[low][0]:g}; correct it, or read logarithms with scale='log'."
            )
        if whisker is not None:
            off = np.isfinite(values) & (values >= whisker.length)
            if off.any():
                problems.append(
                    f"{name}, column {label!r}, {rows_of(off)}: radial distance "
                    f"{values[off][0]:g} m is beyond the whisker's length of {whisker.length:g} m; "
                    "write distances in metres."
                )


def answers_of(
    table: pd.DataFrame,
    answer: str,
    counted: bool,
    labels: Mapping[Any, str] | None,
    name: str,
    problems: list[str],
) -> tuple[Array, Array]:
    """Trials and answers of each row; an answer that was not given is NaN."""
    column = table[answer]
    blank = (
        column.isna().to_numpy()
        | column.astype(str).str.strip().isin(["", "NaN", "nan"]).to_numpy()
    )
    if counted:
        n = numbers_of(table["n"], "n", name, problems)
        count = pd.to_numeric(column, errors="coerce").to_numpy(float)
        for label, values, gaps in (("n", n, np.zeros(len(n), bool)), (answer, count, blank)):
            bad = ~gaps & ~np.isnan(values) & ((values < 0) | (values != np.round(values)))
            if bad.any():
                problems.append(
                    f"{name}, column {label!r}, {rows_of(bad)}: {values[bad][0]:g} is not a "
                    "count; write whole numbers of zero or more."
                )
        over = count > n
        if over.any():
            problems.append(
                f"{name}, column {answer!r}, {rows_of(over)}: {count[over][0]:g} is above the "
                f"{n[over][0]:g} trials in column 'n'; check which is which."
            )
        text = np.isnan(count) & ~blank
        remedy = "write whole numbers"
    else:
        n = np.ones(len(table))
        count, remedy = _singleanswers(column, answer, labels)
        text = np.isnan(count) & ~blank
    if text.any():
        problems.append(
            f"{name}, column {answer!r}, {rows_of(text)}: {column[text].iloc[0]!r} is not an "
            f"answer; {remedy}."
        )
    return n, count


def _singleanswers(
    column: pd.Series, answer: str, labels: Mapping[Any, str] | None
) -> tuple[Array, str]:
    if labels is None:
        values = pd.to_numeric(
            column.replace({True: 1, False: 0, "True": 1, "False": 0}), errors="coerce"
        ).to_numpy(float)
        values = np.where((values == 0) | (values == 1), values, np.nan)
        remedy = "write 1 for correct and 0 for wrong"
        if answer == "choice":
            remedy = (
                "write 1 for second greater and 0 for first greater, or give "
                "choice_labels={label: 'first' or 'second'}"
            )
        return values.astype(float), remedy
    coded = {
        str(label): float(
            _checks.one_of("choice_labels value", which, ("first", "second")) == "second"
        )
        for label, which in labels.items()
    }
    values = column.astype(str).str.strip().map(coded).to_numpy(float)
    return values.astype(float), f"choice_labels knows {', '.join(map(repr, coded))}"
