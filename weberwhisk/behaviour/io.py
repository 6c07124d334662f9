"""Tables of choices from files, checked, every problem named; and those of a rat and two people."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from difflib import get_close_matches
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from .._util import checks
from .._util.refusals import Advice, Refusal, argument, named
from .._util.values import Array, Flags
from ..recordings.tables import as_number, load_table
from .tasks import TASKS, Task, task_named
from .trials import (
    LABELS,
    SCALES,
    SDS,
    Trials,
    in_millimetres,
    notes_of,
    notes_of_pooled,
    rounded_standards,
    rows_in_words,
    standards_of,
)

__all__ = ["load_numerosity", "load_rat_auditory", "read_trials"]

FORMS = (("stimulus_1", "stimulus_2"), ("standard", "comparison"), ("log_ratio",))
ANSWERS = {
    "choice": "2AFC",
    "n_greater": "2AFC",
    "correct": "2AFC percent correct",
    "n_correct": "2AFC percent correct",
    "percent_greater": "2AFC",
    "percent_correct": "2AFC percent correct",
}
#: Those of one trial a row; of the others a row has `n` trials.
SINGLE = ("choice", "correct")
NAMES = (
    *LABELS, "stimulus_1", "stimulus_2", "standard", "comparison", "log_ratio", "n", *ANSWERS, *SDS,
)  # fmt: skip


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
        CSV, tab- or semicolon-separated text, with points or commas for decimals, compressed or
        not; Parquet and Excel (extra `tables`), the `trials` of an NWB file (extra `nwb`), Bpod's
        `SessionData` (.mat), by the suffix of the name.
    columns : mapping, optional
        Our names → the file's, for those that differ. Ours: the stimuli as `stimulus_1` and
        `stimulus_2` (with `standard` if it is known), or `standard` and `comparison`, or
        `log_ratio` (stimulus 2 over stimulus 1); the answer as `choice` (which was greater,
        farther) or `correct`, or of `n` trials a row `n_greater` or `n_correct`, or
        `percent_greater` or `percent_correct` (0 to 100, rounded to whole percent at most); and if
        there `subject`, `session`, `trial`. Stimuli in `stimulus_1_mm`, `standard_mm` and so on are
        read in metres, unless one is mapped or goes by its plain name. `stimulus_1_sd` and
        `stimulus_2_sd` are the sds of located places (`with_distances`), in the stimuli's unit.
    task : str, optional
        "2AFC", "2IFC", "2AFC percent correct", "3AFC percent correct", … Read off the answer's
        column where not given.
    choice_labels : mapping, optional
        The file's labels → which stimulus was reported greater, "first" or "second", or "none"
        where no answer was given. Without it, 1 is "second" and 0 is "first".
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
        Further columns are kept for `select`, `residuals_by` and the effect `Covariate`; one that
        looks like subjects or sessions and was not mapped is named in `notes`.

    Raises
    ------
    ValueError
        With every problem found, a line each: file, column, row (the first below the header is
        1), remedy.
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
    _check_mapping("columns", columns, "{'choice': 'response'}")
    for ours, theirs in (columns or {}).items():
        if not isinstance(theirs, str):
            raise Refusal(
                f"columns[{ours!r}] must be the name of a column",
                checks.shown(theirs),
                "write it as it stands in the header",
            )
    _check_mapping("choice_labels", choice_labels, "{'L': 'first', 'R': 'second'}")
    checks.one_of("scale", scale, SCALES)
    if whisker is not None:
        hint = "write ww.Whisker.from_identity('C2'), say"
        checks.kind("whisker", whisker, "a Whisker", "length", hint)
    as_task = None if task is None else task_named(task)
    if log_unit is not None:
        hint = "give natural-log units per unit of the column"
        log_unit = checks.number("log_unit", log_unit, hint)
        checks.positive("log_unit", log_unit, hint)
    loaded = load_table(source, names=NAMES + tuple((columns or {}).values()))
    raw, name = loaded.frame, loaded.name
    if not len(raw):
        raise Refusal(
            f"{name}: the table has no rows", remedy="give one row per trial under a header"
        )
    check = TableCheck(pd.DataFrame(index=raw.index), name)
    mapped = dict(columns or {})
    # Where a stimulus goes by its plain name, or is mapped, all are in its unit.
    plain = {name for form in FORMS for name in form} & {*raw.columns, *mapped}
    lengths = {} if plain or scale == "log" else in_millimetres(raw)
    stimuli, answer = _choose_columns(check, raw, mapped | lengths, as_task)
    if scale == "linear" and log_unit is not None and stimuli != ("log_ratio",):
        raise Refusal(
            argument("log_unit", log_unit) + " was given for magnitudes",
            remedy="write " + argument("scale", "log") + ", or leave it out",
        )
    if choice_labels and answer != "choice":
        raise Refusal(
            named("choice_labels") + " say which stimulus was reported greater",
            f"them for the answer {answer!r}",
            "leave them out and write 1 for correct and 0 for wrong, or counts",
        )
    if "n" in mapped and answer in SINGLE:
        raise Refusal(
            named("columns") + " maps 'n', the trials of a row",
            f"{answer!r}, the answer of one trial",
            "map 'n_greater' or 'n_correct' to the count of answers, or leave 'n' out",
        )
    if stimuli == ("log_ratio",):
        scale, log_unit = "log", 1.0 if log_unit is None else log_unit
    table = check.table
    metres = 1e3 if lengths else 1.0
    shown_in = dict.fromkeys((*stimuli, "standard"))
    numbers = {c: check.numbers(c) / metres for c in shown_in if c in table}
    known = {*SDS} <= {*table}  # located places, as `Trials.table` has them
    sds = {c: check.numbers(c, least=0.0) / metres for c in SDS if known}
    if scale == "linear":
        check.magnitudes(numbers, whisker)
    labels = {c: check.labels(c) for c in LABELS if c in table}
    n = count = np.zeros(0)
    if answer in table:
        n, count = check.answers(answer, answer not in SINGLE, choice_labels)
    check.raise_problems()

    if stimuli == ("log_ratio",):
        s1, s2 = np.zeros(len(table)), numbers["log_ratio"]
    else:
        s1, s2 = (numbers[c] for c in stimuli)
    standard = numbers["standard"] if "standard" in numbers else standards_of(s1, s2, scale)
    shown = {"standard": rounded_standards(standard, scale), "stimulus_1": s1, "stimulus_2": s2}
    frame = pd.DataFrame(labels | shown | {"n": n.astype(np.int64), "count": count} | sds)
    chosen = as_task or task_named(ANSWERS[answer])
    rows = table.index.to_numpy()
    used = {*frame, *(mapped | lengths).values(), *stimuli, *ANSWERS, "count"}
    further = raw[[column for column in raw if column not in used]].reset_index(drop=True)
    notes = (*loaded.notes, *notes_of(frame, rows), *notes_of_pooled(further, {*frame}))
    frame = pd.concat([frame, further], axis=1)
    frame.attrs["columns"] = dict(mapped)  # what the user calls them, for figures
    return Trials(frame, chosen, scale, log_unit, name, notes, rows)


def _choose_columns(
    check: TableCheck, raw: pd.DataFrame, mapping: dict[str, str], task: Task | None
) -> tuple[tuple[str, ...], str]:
    """Put the columns needed into the check's table, under our names; what is missing is a problem.

    Returns which of them hold the stimuli, and which the answer.
    """
    here = [str(c) for c in raw.columns]
    for ours, theirs in mapping.items():
        checks.one_of(named("columns") + " key", ours, NAMES)
        if theirs in here:
            check.table[ours] = raw[theirs]
        else:
            check.missing_column(theirs, here, f"mapped from {ours!r}", ours)
    taken = set(mapping.values())
    for column in here:
        if column in NAMES and column not in check.table and column not in taken:
            check.table[column] = raw[column]
    expected = {*check.table, *mapping}  # a mapped column that is missing has been named already
    stimuli: tuple[str, ...] | None = next((s for s in FORMS if expected.issuperset(s)), None)
    if stimuli is None:
        stimuli = max(FORMS, key=lambda names: len(expected.intersection(names)))
        for column in stimuli:
            if column not in expected:
                check.missing_column(column, here, "needed for the stimuli")
    answers = [a for a in ANSWERS if a in expected]
    if task is not None:
        answers = [a for a in answers if TASKS[ANSWERS[a]].response == task.response]
    # A mapped answer is meant; one that merely has our name may be a by-product.
    answer = next((a for a in answers if a in mapping), answers[0] if answers else None)
    if answer is None:
        answer = task.response if task else "choice"
        check.missing_column(answer, here, "needed for the answer")
    if answer not in SINGLE and "n" not in expected:
        check.missing_column("n", here, "needed for the number of trials")
    return stimuli, answer


def _check_mapping(name: str, value: object, example: str) -> None:
    if value is not None and not isinstance(value, Mapping):
        raise Refusal(
            f"{name} must be a mapping", checks.shown(value), f"write {name}={example}, say"
        )


@dataclass
class TableCheck:
    """A table under its file's name, and every problem found in it so far."""

    table: pd.DataFrame
    name: str
    problems: list[str] = field(default_factory=list)

    def add(self, column: str, bad: Flags, sentence: str, *values: Array, remedy: str = "") -> None:
        """A problem with some cells of a column, if any; the first of the values fill in."""
        if bad.any():
            rows = rows_in_words(self.table.index.to_numpy()[bad])
            said = sentence.format(*(value[bad][0] for value in values)) if values else sentence
            self.problems.append(
                Advice.joined("", [f"{self.name}, column {column!r}, {rows}: ", said, remedy])
            )

    def missing_column(
        self, column: str, here: list[str], why: str, ours: str | None = None
    ) -> None:
        """A column that is not there, with the nearest that is, and how one is mapped to `ours`."""
        near = get_close_matches(column, here, n=1, cutoff=0.5)
        meant = near[0] if near else "<its name>"
        self.problems.append(
            f"{self.name}: there is no column {column!r}, {why}; the columns are "
            f"{', '.join(here)}, and " + argument("columns", {ours or column: meant}) + " maps one."
        )

    def raise_problems(self) -> None:
        """Raise everything found, a line each."""
        if self.problems:
            raise Refusal(Advice.joined("\n", self.problems))

    def numbers(self, column: str, least: float = -np.inf) -> Array:
        """A column as floats; text, gaps, infinities and what is below the least are problems."""
        cells = self.table[column]
        blank = _blank(cells)
        values = _floats(cells)
        text = np.isnan(values) & ~blank
        if text.any():
            first = cells[text].iloc[0]
            self.add(column, text, f"{first!r} is not a number; {as_number(first)}.")
        lost = blank | np.isinf(values)
        self.add(column, lost, "empty, NaN or infinite; give the stimulus or remove the row.")
        self.add(column, values < least, f"{{:g}} is below {least:g}; correct it.", values)
        return values

    def magnitudes(self, numbers: Mapping[str, Array], whisker: Any) -> None:
        """Magnitudes lie above zero, and radial distances on the whisker."""
        for column, values in numbers.items():
            low = np.isfinite(values) & (values <= 0)
            said = "a magnitude must be above zero, got {:g}; correct it, or read logarithms with "
            self.add(column, low, said, values, remedy=argument("scale", "log") + ".")
            if whisker is None:
                continue
            off = np.isfinite(values) & (values >= whisker.length)
            most = np.nanmax(values, initial=0)
            remedy = f"{whisker.length:g} m; write distances in metres."
            said = f"radial distance {{:g}} m is beyond the whisker's length of {remedy}"
            self.add(column, off, said, values)
            # Nothing beyond 0.2 % of the length: the unit is not metres.
            if most < 0.002 * whisker.length and not low.any():
                said = f"no radial distance is above {most:g} m on a whisker of"
                self.add(column, np.isfinite(values), f"{said} {remedy}")

    def labels(self, column: str) -> NDArray[Any]:
        """Subjects, sessions or trials: whole numbers where all are, else text without margins."""
        cells = self.table[column]
        if cells.dtype.kind == "M":  # dates are names, not numbers of nanoseconds
            cells = cells.astype("string")
        blank = _blank(cells)
        if column != "trial":
            self.add(column, blank, f"empty; name the {column} of every trial.")
        values = _floats(cells)
        whole = (values == np.round(values)) & (np.abs(values) < 2**53)
        if column != "subject" and whole.all():
            return values.astype(np.int64)
        names = np.array([_plain(c) for c in cells], dtype=object)
        # A terminal obeys what is not printed, and a figure has no sign for it.
        hidden = np.array([isinstance(c, str) and not c.isprintable() for c in names], dtype=bool)
        said = "{!r} contains characters that are not printed; write letters."
        self.add(column, hidden, said, names)
        return names

    def answers(
        self, answer: str, counted: bool, labels: Mapping[Any, str] | None
    ) -> tuple[Array, Array]:
        """Trials and answers of each row; an answer that was not given is NaN."""
        cells = self.table[answer]
        none = [_as_text(label) for label, which in (labels or {}).items() if which == "none"]
        blank = _blank(cells) | cells.map(_as_text).isin(none).to_numpy()
        if counted:
            n, count = self._counts(answer, blank)
            remedy = "write numbers"
        else:
            n = np.ones(len(cells))
            count, remedy = _single_answers(cells, answer, labels)
        text = np.isnan(count) & ~blank
        if text.any():
            said = f"{_as_text(cells[text].iloc[0])!r} is not an answer; "
            self.add(answer, text, Advice.joined("", [said, remedy, "."]))
        return n, count

    def _counts(self, answer: str, blank: Flags) -> tuple[Array, Array]:
        count = _floats(self.table[answer])
        n = np.full(count.shape, np.nan)
        if "n" in self.table:  # where it is not, that has been said
            n = self.numbers("n")
        if answer.startswith("percent_"):
            self._percentages(answer, count, n)
            count = np.round(np.nan_to_num(n) * np.clip(count, 0, 100) / 100)
        columns = {answer: (count, blank)}
        if "n" in self.table:
            columns = {"n": (n, np.zeros(len(n), bool)), **columns}
        for column, (values, gaps) in columns.items():
            bad = ~gaps & np.isfinite(values) & ((values < 0) | (values != np.round(values)))
            said = "{:g} is not a count; write whole numbers of zero or more."
            self.add(column, bad, said, values)
        said = "{:g} is above the {:g} trials in column 'n'; check which is which."
        self.add(answer, count > n, said, count, n)
        return n, count

    def _percentages(self, column: str, percent: Array, n: Array) -> None:
        """Percentages of `n` trials may have been rounded, to whole percent at most."""
        off = (percent < 0) | (percent > 100)
        of: tuple[Array, ...] = (percent,)
        said = "{:g} is no percentage"
        if not off.any() and 0 < np.nanmax(percent, initial=0) <= 1:
            off, said, of = percent > 0, "none is above 1, as if these were proportions", ()
        elif not off.any():
            answers = n * percent / 100
            off = np.abs(answers - np.round(answers)) > 0.005 * n + 1e-9
            said, of = "{:g} % of {:g} trials is no whole number of answers", (percent, n)
        self.add(column, off, f"{said}; write percent of the row's n trials, or counts.", *of)


def _floats(cells: pd.Series) -> Array:
    """Numbers as floats, NaN for all else."""
    return pd.to_numeric(cells, errors="coerce").to_numpy(float, na_value=np.nan)


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
        truths = {True: 1, False: 0, "True": 1, "False": 0, "TRUE": 1, "FALSE": 0}
        values = _floats(cells.map(lambda c: truths.get(c, c)))
        kept = np.where(np.isin(values, [0, 1]), values, np.nan)
        if answer != "choice":
            remedy = "write 1 for correct and 0 for wrong, or map percentages as percent_correct"
            return kept, remedy
        remedy = "write 1 for second greater and 0 for first greater, or give "
        return kept, remedy + argument("choice_labels", {"L": "first", "R": "second"}) + ", say"
    codes = {"first": 0.0, "second": 1.0, "none": np.nan}
    coded = {
        _as_text(label): codes[checks.one_of(named("choice_labels") + " value", which, codes)]
        for label, which in labels.items()
    }
    labelled = ", ".join(map(repr, coded))
    remedy = named("choice_labels") + f" knows {labelled}; 'none' is for no answer"
    return _floats(cells.map(_as_text).map(coded)), remedy


def _as_text(cell: Any) -> str:
    """A label as written: 1 and 1.0 are one, as a gap in a column makes floats of integers."""
    text = str(cell).strip()
    whole, point, zeros = text.partition(".")
    return whole if point and whole.lstrip("-").isdecimal() and not zeros.strip("0") else text


def load_rat_auditory(sessions: int | Iterable[int] | None = None) -> Trials:
    """One rat comparing two sounds: which was louder?

    Rat W053 of the delayed-comparison task of Akrami, Kopec, Diamond & Brody (2018, Nature
    554:368), the first 40 sessions of its training: 11 489 trials. The stimuli are normalised
    logarithms of the sound level; one unit is an unknown number of natural-log units, so a Weber
    fraction is counted per unit. Neighbouring levels are compared, at several standards. The animal
    is learning: lapses, bias and drift are real.

    Sample data of the psytrack package (github.com/nicholas-roy/psytrack), MIT licence, copyright
    of its author; see `weberwhisk/data/README.md`.

    Parameters
    ----------
    sessions : int or iterable of int, optional
        1 to 40; all by default.

    Examples
    --------
    >>> load_rat_auditory(sessions=range(31, 41)).n_trials
    3101
    """
    with as_file(files("weberwhisk") / "data" / "rat_auditory_2ifc.csv.gz") as path:
        trials = read_trials(
            path,
            columns={"stimulus_1": "s1_z", "stimulus_2": "s2_z"},
            choice_labels={"right": "first", "left": "second"},
            scale="log",
            task="2IFC",
        )
    return trials if sessions is None else trials.select(session=sessions)


def load_numerosity(subject: str | None = None) -> Trials:
    """Two people, each 250 trials: which of two clouds has more dots?

    `stimulus_2` over `stimulus_1` is given by its natural logarithm; a choice of "second" is the
    first colour of the original table.

    Data of the TEfits package (github.com/akcochrane/TEfits), MIT licence; Cochrane, Cui, Hubbard &
    Green (2019); see `weberwhisk/data/README.md`.

    Parameters
    ----------
    subject : {"s1", "s2"}, optional
        Both by default.

    Examples
    --------
    >>> load_numerosity("s1").n_trials
    250
    """
    with as_file(files("weberwhisk") / "data" / "numerosity_2afc.csv") as path:
        trials = read_trials(path, columns={"choice": "response"})
    return trials if subject is None else trials.select(subject=subject)
