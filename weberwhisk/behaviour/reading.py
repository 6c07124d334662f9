"""Tables of choices from files, checked: every problem named at once, with its row and remedy."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from .. import _checks
from .checking import answers_of, check_stimuli, missing_column, numbers_of, rows_of
from .tasks import TASKS, Task, task_named
from .trials import LABELS, SCALES, Trials, standards_of

Array = NDArray[np.float64]

STIMULI = (("stimulus_1", "stimulus_2"), ("standard", "comparison"), ("log_ratio",))
ANSWERS = {
    "choice": "2AFC",
    "n_greater": "2AFC",
    "correct": "2AFC percent correct",
    "n_correct": "2AFC percent correct",
}
NAMES = (*LABELS, "stimulus_1", "stimulus_2", "standard", "comparison", "log_ratio", "n", *ANSWERS)


def read_trials(
    source: str | Path | pd.DataFrame,
    *,
    columns: Mapping[str, str] | None = None,
    task: str | None = None,
    choice_labels: Mapping[Any, str] | None = None,
    scale: str = "linear",
    log_unit: float | None = None,
    whisker: Any = None,
) -> Trials:
    """Read a table of choices: trial by trial, or counts.

    Parameters
    ----------
    source : path or DataFrame
        CSV, or tab-separated where the name ends in .tsv or .tab; gzip and others by pandas.
    columns : mapping, optional
        Our names → the file's, for those that differ. Ours: the stimuli as `stimulus_1` and
        `stimulus_2` (with `standard` if it is known), or `standard` and `comparison`, or
        `log_ratio` (stimulus 2 over stimulus 1); the answer as `choice` (which was greater,
        farther) or `correct`, or for counts `n` with `n_greater` or `n_correct`; and if there
        `subject`, `session`, `trial`.
    task : str, optional
        "2AFC", "2IFC", "2AFC percent correct", "3AFC percent correct", … Read off the answer's
        column where not given.
    choice_labels : mapping, optional
        The file's labels → which stimulus was reported greater, "first" or "second". Without it,
        1 is "second" and 0 is "first".
    scale : {"linear", "log"}
        "log": the columns are logarithms of the magnitude, up to an additive constant.
    log_unit : float, optional
        On a log scale, natural-log units per unit of the column (`log_ratio` has 1 by default).
        Left out where unknown; the Weber fraction is then counted per unit of the column.
    whisker : Whisker, optional
        Stimuli are radial distances (m); those that do not lie on it are refused.

    Returns
    -------
    Trials
        Rows without an answer are kept, counted in `n_missing`, and stay out of the likelihood.

    Raises
    ------
    ValueError
        With every problem found: file, column, row (the first below the header is 1), remedy.
    FileNotFoundError
        Where there is no such file.

    Examples
    --------
    >>> import pandas as pd
    >>> table = pd.DataFrame({"left_mm": [30, 30], "right_mm": [28, 33], "said": ["L", "R"]})
    >>> trials = read_trials(
    ...     table, columns={"stimulus_1": "left_mm", "stimulus_2": "right_mm", "choice": "said"},
    ...     choice_labels={"L": "first", "R": "second"})
    >>> trials.n_trials, trials.task.name
    (2, '2AFC')
    """
    _checks.one_of("scale", scale, SCALES)
    asked = None if task is None else task_named(task)
    if log_unit is not None:
        _checks.positive("log_unit", log_unit, "give natural-log units per unit of the column")
    raw, name = _load(source)
    if not len(raw):
        raise ValueError(f"{name}: the table has no rows; give one row per trial under a header.")
    table, stimuli, answer, n_column = _choose_columns(raw, name, dict(columns or {}), asked)
    if stimuli == ("log_ratio",):
        scale, log_unit = "log", 1.0 if log_unit is None else log_unit
    problems: list[str] = []
    numbers = {
        c: numbers_of(table[c], c, name, problems) for c in {*stimuli, "standard"} & {*table}
    }
    check_stimuli(numbers, name, scale, whisker, problems)
    n, count = answers_of(table, answer, n_column, choice_labels, name, problems)
    if problems:
        raise ValueError("\n".join(problems))

    if stimuli == ("log_ratio",):
        s1, s2 = np.zeros(len(table)), numbers["log_ratio"]
    else:
        s1, s2 = (numbers[c] for c in stimuli)
    standard = numbers["standard"] if "standard" in numbers else standards_of(s1, s2, scale)
    labels = {c: _label(table[c], c) for c in LABELS if c in table}
    frame = pd.DataFrame(
        {
            **labels,
            "standard": standard,
            "stimulus_1": s1,
            "stimulus_2": s2,
            "n": n.astype(np.int64),
            "count": count,
        }
    )
    chosen = asked or task_named(ANSWERS[answer])
    return Trials(frame, chosen, scale, log_unit, name, _notes(frame))


def _load(source: str | Path | pd.DataFrame) -> tuple[pd.DataFrame, str]:
    if isinstance(source, pd.DataFrame):
        return source.reset_index(drop=True), "table"
    path = Path(source)
    if not path.is_file():
        raise FileNotFoundError(f"{path}: there is no such file; give the path of a CSV table.")
    tabs = {".tsv", ".tab"} & set(path.suffixes)
    try:
        raw = pd.read_csv(path, sep="\t" if tabs else ",", dtype=str, skipinitialspace=True)
    except pd.errors.EmptyDataError:
        raise ValueError(
            f"{path.name}: the file is empty; give a header and one row per trial."
        ) from None
    except (pd.errors.ParserError, UnicodeDecodeError, OSError, EOFError) as error:
        reason = " ".join(str(error).split()).rstrip(".").split(". ")[-1]
        raise ValueError(
            f"{path.name}: not readable as a table ({reason}); save it as CSV."
        ) from None
    if not isinstance(raw.index, pd.RangeIndex):
        raise ValueError(
            f"{path.name}: rows have more cells than the header has names; name every column."
        )
    return raw, path.name


def _choose_columns(
    raw: pd.DataFrame, name: str, mapping: dict[str, str], task: Task | None
) -> tuple[pd.DataFrame, tuple[str, ...], str, bool]:
    """The columns needed, under our names; which hold the stimuli, the answer, and the count."""
    problems = []
    here = [str(c) for c in raw.columns]
    for ours, theirs in mapping.items():
        _checks.one_of("columns key", ours, NAMES)
        if theirs not in here:
            problems.append(missing_column(name, theirs, here, f"mapped from {ours!r}"))
    taken = set(mapping.values())
    table = pd.DataFrame({ours: raw[theirs] for ours, theirs in mapping.items() if theirs in here})
    for column in here:
        if column in NAMES and column not in table and column not in taken:
            table[column] = raw[column]
    expected = {*table, *mapping}  # a mapped column that is missing has been named already
    stimuli = next((s for s in STIMULI if expected.issuperset(s)), None)
    if stimuli is None:
        partial = next((s for s in STIMULI if expected.intersection(s) - {"standard"}), STIMULI[0])
        for column in partial:
            if column not in expected:
                problems.append(missing_column(name, column, here, "needed for the stimuli"))
    answers = [a for a in ANSWERS if a in expected]
    if task is not None:
        answers = [a for a in answers if TASKS[ANSWERS[a]].response == task.response]
    # A mapped answer was asked for; one that merely has our name may be a by-product.
    answer = next((a for a in answers if a in mapping), answers[0] if answers else None)
    if answer is None:
        wanted = task.response if task else "choice"
        problems.append(missing_column(name, wanted, here, "needed for the answer"))
    counted = answer is not None and answer.startswith("n_")
    if counted and "n" not in expected:
        problems.append(missing_column(name, "n", here, "needed for the number of trials"))
    if problems:
        raise ValueError("\n".join(problems))
    assert stimuli is not None
    assert answer is not None
    return table, stimuli, answer, counted


def _label(column: pd.Series, name: str) -> NDArray[Any]:
    """Sessions and trials as whole numbers where all of them are; anything else as it stands."""
    if name != "subject":
        values = pd.to_numeric(column, errors="coerce")
        if values.notna().all() and (values == values.round()).all():
            return values.to_numpy(np.int64)
    return column.to_numpy()


def _notes(frame: pd.DataFrame) -> tuple[str, ...]:
    notes = []
    missing = int(frame.loc[frame["count"].isna(), "n"].sum())
    if missing:
        notes.append(f"{missing} trials have no answer and stay out of the likelihood.")
    keys = [c for c in LABELS if c in frame]
    twice = frame.duplicated() if "trial" in keys or (frame["n"] > 1).any() else None
    if twice is not None and twice.any():
        notes.append(
            f"{int(twice.sum())} rows occur more than once, the first in "
            f"{rows_of(twice.to_numpy())}; they are counted as they stand."
        )
    return tuple(notes)
