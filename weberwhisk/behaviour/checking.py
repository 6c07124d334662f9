"""The cells of a table, checked: each problem as one sentence with its place and remedy."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from difflib import get_close_matches
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from .. import _checks

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]


def rows_in_words(rows: ArrayLike) -> str:
    """Rows in words, the first below the header being 1."""
    numbers = np.atleast_1d(np.asarray(rows))
    shown = ", ".join(map(str, numbers[:3].tolist()))
    more = f" and {numbers.size - 3} more" if numbers.size > 3 else ""
    return f"row{'s' if numbers.size > 1 else ''} {shown}{more}"


@dataclass
class TableCheck:
    """A table under its file's name, and every problem found in it so far."""

    table: pd.DataFrame
    name: str
    problems: list[str] = field(default_factory=list)

    def add(self, column: str, bad: Flags, sentence: str) -> None:
        """A problem with some cells of a column."""
        rows = rows_in_words(self.table.index.to_numpy()[bad])
        self.problems.append(f"{self.name}, column {column!r}, {rows}: {sentence}")

    def missing_column(self, column: str, here: list[str], why: str) -> None:
        """A column that is not there, with the nearest that is."""
        near = get_close_matches(column, here, n=1, cutoff=0.5)
        meant = f" (did you mean {near[0]!r}?)" if near else ""
        self.problems.append(
            f"{self.name}: there is no column {column!r}, {why}{meant}; the columns are "
            f"{', '.join(here)}, and columns={{{column!r}: '<its name>'}} maps one."
        )

    def raise_problems(self) -> None:
        """Raise everything found, a line each."""
        if self.problems:
            raise ValueError("\n".join(self.problems))

    def numbers(self, column: str) -> Array:
        """A column as floats; text, gaps and infinities are problems."""
        cells = self.table[column]
        blank = _blank(cells)
        values = pd.to_numeric(cells, errors="coerce").to_numpy(float)
        text = np.isnan(values) & ~blank
        if text.any():
            self.add(column, text, f"{cells[text].iloc[0]!r} is not a number; write digits alone.")
        lost = blank | np.isinf(values)
        if lost.any():
            self.add(column, lost, "empty, NaN or infinite; give the stimulus or remove the row.")
        return values

    def magnitudes(self, numbers: Mapping[str, Array], whisker: Any) -> None:
        """Magnitudes lie above zero, and radial distances on the whisker."""
        for column, values in numbers.items():
            low = np.isfinite(values) & (values <= 0)
            if low.any():
                self.add(
                    column,
                    low,
                    f"a magnitude must be above zero, got {values[low][0]:g}; correct it, or read "
                    "logarithms with scale='log'.",
                )
            if whisker is None:
                continue
            off = np.isfinite(values) & (values >= whisker.length)
            if off.any():
                self.add(
                    column,
                    off,
                    f"radial distance {values[off][0]:g} m is beyond the whisker's length of "
                    f"{whisker.length:g} m; write distances in metres.",
                )
            # Nothing beyond 0.2 % of the length: the unit is not metres.
            elif np.nanmax(values, initial=0.0) < 0.002 * whisker.length and not low.any():
                self.add(
                    column,
                    np.isfinite(values),
                    f"no radial distance is above {np.nanmax(values, initial=0.0):g} m on a "
                    f"whisker of {whisker.length:g} m; write distances in metres.",
                )

    def labels(self, column: str) -> NDArray[Any]:
        """Subjects, sessions or trials: whole numbers where all are, else text without margins."""
        cells = self.table[column]
        blank = _blank(cells)
        if blank.any() and column != "trial":
            self.add(column, blank, f"empty; name the {column} of every trial.")
        values = pd.to_numeric(cells, errors="coerce")
        if column != "subject" and values.notna().all() and (values == values.round()).all():
            return values.to_numpy(np.int64)
        names = np.array([_plain(c) for c in cells], dtype=object)
        # A terminal obeys what is not printed, and a figure has no sign for it.
        hidden = np.array([isinstance(c, str) and not c.isprintable() for c in names], dtype=bool)
        if hidden.any():
            self.add(
                column,
                hidden,
                f"{names[hidden][0]!r} holds characters that are not printed; write letters.",
            )
        return names

    def answers(
        self, answer: str, counted: bool, labels: Mapping[Any, str] | None
    ) -> tuple[Array, Array]:
        """Trials and answers of each row; an answer that was not given is NaN."""
        cells = self.table[answer]
        blank = _blank(cells)
        if counted:
            n, count = self._counts(answer, blank)
            remedy = "write whole numbers"
        else:
            n = np.ones(len(cells))
            count, remedy = _single_answers(cells, answer, labels)
        text = np.isnan(count) & ~blank
        if text.any():
            self.add(answer, text, f"{cells[text].iloc[0]!r} is not an answer; {remedy}.")
        return n, count

    def _counts(self, answer: str, blank: Flags) -> tuple[Array, Array]:
        count = pd.to_numeric(self.table[answer], errors="coerce").to_numpy(float)
        columns = {answer: (count, blank)}
        n = np.full(count.shape, np.nan)
        if "n" in self.table:  # where it is not, that has been said
            n = self.numbers("n")
            columns = {"n": (n, np.zeros(len(n), bool)), **columns}
        for column, (values, gaps) in columns.items():
            bad = ~gaps & np.isfinite(values) & ((values < 0) | (values != np.round(values)))
            if bad.any():
                self.add(
                    column,
                    bad,
                    f"{values[bad][0]:g} is not a count; write whole numbers of zero or more.",
                )
        over = count > n
        if over.any():
            self.add(
                answer,
                over,
                f"{count[over][0]:g} is above the {n[over][0]:g} trials in column 'n'; check "
                "which is which.",
            )
        return n, count


def _plain(label: Any) -> Any:
    """A label without margins, nor the apostrophe that keeps a spreadsheet from running it."""
    if not isinstance(label, str):
        return label
    text = label.strip()
    return text[1:] if text[:1] == "'" and text[1:].lstrip()[:1] in tuple("=+-@") else text


def _blank(cells: pd.Series) -> Flags:
    text = cells.astype(str).str.strip().str.lower()
    return np.asarray(cells.isna() | text.isin(["", "nan"]), dtype=bool)


def _single_answers(
    cells: pd.Series, answer: str, labels: Mapping[Any, str] | None
) -> tuple[Array, str]:
    if labels is None:
        truths = {True: 1, False: 0, "True": 1, "False": 0}
        values = pd.to_numeric(cells.map(lambda c: truths.get(c, c)), errors="coerce")
        kept = values.where(values.isin([0, 1])).to_numpy(float)
        remedy = "write 1 for correct and 0 for wrong"
        if answer == "choice":
            remedy = (
                "write 1 for second greater and 0 for first greater, or give "
                "choice_labels={label: 'first' or 'second'}"
            )
        return kept, remedy
    coded = {
        _as_text(label): float(
            _checks.one_of("choice_labels value", which, ("first", "second")) == "second"
        )
        for label, which in labels.items()
    }
    values = cells.map(_as_text).map(coded)
    return values.to_numpy(float), f"choice_labels knows {', '.join(map(repr, coded))}"


def _as_text(cell: Any) -> str:
    """A label as written: 1 and 1.0 are one, as a gap in a column makes floats of integers."""
    text = str(cell).strip()
    whole, point, zeros = text.partition(".")
    return whole if point and whole.lstrip("-").isdecimal() and not zeros.strip("0") else text
