"""Tables of choices from files, checked, every problem named; and those of a rat and two people."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
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
from .order import put_in_order
from .people import notes_of_pooled
from .standards import Standards, named_standards, rounded, standards_of
from .tasks import TASKS, Task, task_named
from .trials import LABELS, SCALES, SDS, Trials, in_millimetres, rows_in_words

__all__ = ["load_numerosity", "load_rat_auditory", "millimetres_beside", "read_trials"]

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
#: Labels of answers that are right or wrong, as an example.
SCORED = {"hit": "correct", "miss": "wrong"}
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
    in_order: bool | None = None,
    text_encoding: str | None = None,
) -> Trials:
    """Read a table of choices: trial by trial, or counts.

    Parameters
    ----------
    source : path or DataFrame
        Text separated by commas, tabs, semicolons or spaces, with points or commas for decimals,
        compressed or not, in UTF-8, UTF-16 or Windows-1252; Parquet, Excel (.xlsx, .xls) and .ods
        (extra `tables`), the `trials` of an NWB file (extra `nwb`), MATLAB's .mat of any version
        (Bpod's `SessionData`, or vectors of one length). A text or sheet whose first row holds a
        number has no header; its columns are called 1, 2, 3, …
    columns : mapping, optional
        Our names → the file's, for those that differ, or where the file has columns of our names
        that are not meant. Ours: the stimuli as `stimulus_1` and `stimulus_2` (with `standard` if
        it is known, or the interval in which it was, 1 or 2), or `standard` and `comparison`, or
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
        The file's labels → which stimulus was reported greater, "first" or "second", or whether
        the answer was "correct" or "wrong", or "none" where no answer was given. Without it, 1 and
        true are "second" or "correct", and 0 and false "first" or "wrong".
    scale : {"linear", "log"}
        "log": the columns are logarithms of the magnitude, up to an additive constant.
    log_unit : float, optional
        On a log scale, natural-log units per unit of the column (`log_ratio` has 1 by default).
        Left out where unknown; the Weber fraction is then counted per unit of the column.
    whisker : Whisker, optional
        Stimuli are radial distances (m); those that do not lie on it are refused.
    in_order : bool, optional
        Whether rows are in the order in which the trials were run. Left out, numbered trials are
        put in their order, and other rows are taken to be in it where there are sessions or times
        beside them, and they do not look sorted; else streaks, history and drift are not looked
        for.
    text_encoding : str, optional
        Of a text, such as "mac_roman"; read off it where left out.

    Returns
    -------
    Trials
        Rows without an answer are kept, counted in `n_missing`, and stay out of the likelihood.
        Further columns are kept for `select`, `residuals_by` and the effect `Covariate`. What had
        to be guessed (standards, order, subjects or sessions under other names, the encoding of a
        text) is said in `notes`, with what to write where it is wrong.

    Notes
    -----
    The standard of a trial, the first that holds:

    1. What a column `standard` says: the stimulus itself, or in which interval it was (1 or 2).
    2. The first stimulus of yes/no tasks, and of those with more than two alternatives.
    3. One value in every trial of a table with four or more, or all of one interval.
    4. Values that were each compared with three others or more, of which every pair has exactly
       one.
    5. The interval with at most half as many values as the other, each compared with two or more.

    Where none holds there is no standard, and no bias per standard, test of Weber's law or
    threshold from a standard is given.

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
    to_read = NAMES + tuple((columns or {}).values())
    loaded = load_table(source, names=to_read, text_encoding=text_encoding)
    raw, name = loaded.frame, loaded.name
    if not len(raw):
        raise Refusal(
            f"{name}: the table has no rows", remedy="give one row per trial under a header"
        )
    mapped = dict(columns or {})
    check = TableCheck(pd.DataFrame(index=raw.index), name, mapped)
    # Where a stimulus goes by its plain name, or is mapped, all are in its unit.
    plain = {name for form in FORMS for name in form} & {*raw.columns, *mapped}
    lengths = {} if plain or scale == "log" else in_millimetres(raw)
    stimuli, answer = _choose_columns(check, raw, mapped | lengths, as_task)
    if scale == "linear" and log_unit is not None and stimuli != ("log_ratio",):
        raise Refusal(
            argument("log_unit", log_unit) + " was given for magnitudes",
            remedy="write " + argument("scale", "log") + ", or leave it out",
        )
    if choice_labels and answer not in SINGLE:
        raise Refusal(
            named("choice_labels") + " say which stimulus was reported greater or what is correct",
            f"them for the answer {answer!r}",
            "leave them out and write counts",
        )
    if "n" in mapped and answer in SINGLE:
        raise Refusal(
            named("columns") + " maps 'n', the trials of a row",
            f"{answer!r}, the answer of one trial",
            "map 'n_greater' or 'n_correct' to the count of answers, or leave 'n' out",
        )
    chosen = as_task or task_named(ANSWERS[answer])
    of_magnitudes = scale == "linear"
    if stimuli == ("log_ratio",):
        scale, log_unit = "log", 1.0 if log_unit is None else log_unit
    table = check.table
    metres = 1e3 if lengths else 1.0
    shown_in = dict.fromkeys((*stimuli, "standard"))
    numbers = {c: check.numbers(c) / metres for c in shown_in if c in table}
    is_located = {*SDS} <= {*table}  # located places, as `Trials.table` has them
    sds = {c: check.numbers(c, least=0.0) / metres for c in SDS if is_located}
    if scale == "linear":
        levels = np.unique(numbers.get("standard", np.zeros(0))).tolist()
        is_interval = "standard" not in stimuli and levels in ([1.0, 2.0], [0.0, 1.0])
        check.magnitudes(
            {c: v for c, v in numbers.items() if not (is_interval and c == "standard")}, whisker
        )
        if stimuli == FORMS[1] and {*levels} == {1.0, 2.0}:
            total = numbers["standard"] + numbers.get("comparison", np.nan)
            said = "1 and 2 are intervals, not magnitudes; map stimulus_1 and stimulus_2."
            check.add("standard", np.full(len(raw), bool((total == 3).all())), said)
    labels = {c: check.labels(c) for c in LABELS if c in table}
    n = count = np.zeros(0)
    if answer in table:
        n, count = check.answers(answer, answer not in SINGLE, choice_labels)
    check.raise_problems()

    notes = list(loaded.notes)
    if loaded.guessed_encoding:
        notes.append(
            f"The text is not UTF-8 and was read as {loaded.guessed_encoding}; "
            + argument("text_encoding", "mac_roman")
            + ", say, reads it otherwise."
        )
    notes += _disagreements(check, stimuli, raw, mapped)
    named_by = check.called("standard")
    if stimuli == ("log_ratio",):
        s1, s2 = np.zeros(len(table)), numbers["log_ratio"]
        if "standard" in numbers and of_magnitudes and (numbers["standard"] > 0).all():
            assert log_unit is not None
            s1 = np.log(numbers["standard"]) / log_unit
            s2, numbers["standard"] = s1 + s2, s1
            notes.append(
                f"Standards are the logarithms of column {named_by!r}, as those of ratios are."
            )
    else:
        s1, s2 = (numbers[c] for c in stimuli)
    standards = Standards(numbers["standard"]) if "standard" in numbers else None
    if standards is None:
        standards = standards_of(s1, s2, scale, chosen)
    elif stimuli == FORMS[0] and not is_located:
        standards = named_standards(standards.values, s1, s2, named_by, scale)
    notes += [standards.note] if standards.note else []
    shown = {"standard": rounded(standards.values, scale), "stimulus_1": s1, "stimulus_2": s2}
    frame = pd.DataFrame(labels | shown | {"n": n.astype(np.int64), "count": count} | sds)
    places = table.index.to_numpy()
    used = {*frame, *(mapped | lengths).values(), *stimuli, *ANSWERS, "count"}
    further = raw[[column for column in raw if column not in used]].reset_index(drop=True)
    notes += notes_of_pooled(further, {*frame})
    frame = pd.concat([frame, further], axis=1)
    if in_order is None and (order := put_in_order(frame)) is not None:
        frame, places = frame.iloc[order].reset_index(drop=True), places[order]
        notes.append(
            "The rows were put in the order of their sessions and trials; "
            + argument("in_order", True)
            + " leaves them in that of the table."
        )
    frame.attrs["columns"] = dict(mapped)  # what the user calls them, for figures
    return Trials(
        frame, chosen, scale, log_unit, name, tuple(notes), places, standards.are_known, in_order
    )


def millimetres_beside(raw: pd.DataFrame, columns: Mapping[str, str]) -> dict[str, str]:
    """The stimuli that a table has in mm, of the form in which the user maps some, if any."""
    form = _mapped_form(columns)
    lengths = in_millimetres(raw).items()
    return {ours: theirs for ours, theirs in lengths if form is None or ours in (*form, "standard")}


def _mapped_form(mapping: Mapping[str, str]) -> tuple[str, ...] | None:
    """The form of stimuli of which columns are mapped; `standard` alone may be of two."""
    meant = [form for form in FORMS if {*form} & {*mapping} - {"standard"}]
    if len(meant) > 1:
        said = [next(c for c in form if c in mapping and c != "standard") for form in meant]
        raise Refusal(
            named("columns") + " maps the stimuli in one form",
            f"{' and '.join(map(repr, said))}",
            f"leave {said[-1]!r} out, or the others",
        )
    return meant[0] if meant else None


def _choose_columns(
    check: TableCheck, raw: pd.DataFrame, mapping: dict[str, str], task: Task | None
) -> tuple[tuple[str, ...], str]:
    """Put the columns needed into the check's table, under our names; what is missing is a problem.

    Returns which of them hold the stimuli, and which the answer: what is mapped is meant, and what
    merely has our name may be a by-product.
    """
    here = [str(c) for c in raw.columns]
    for ours, theirs in mapping.items():
        checks.one_of(named("columns") + " key", ours, NAMES)
        if theirs in here:
            check.table[ours] = raw[theirs]
        else:
            check.missing_column(theirs, f"mapped from {ours!r}", ours)
    taken = {theirs for ours, theirs in mapping.items() if ours != "standard"}
    for column in here:
        if column in NAMES and column not in check.table and column not in taken:
            check.table[column] = raw[column]
    expected = {*check.table, *mapping}  # a mapped column that is missing has been named already
    stimuli = _mapped_form(mapping) or next((s for s in FORMS if expected.issuperset(s)), None)
    if stimuli is None:
        stimuli = max(FORMS, key=lambda names: len(expected.intersection(names)))
    for column in stimuli:
        if column not in expected:
            check.missing_column(column, "needed for the stimuli")
    sds = [c for c in SDS if c in mapping]
    if len(sds) == 1:
        second = next(c for c in SDS if c not in sds)
        if second not in expected:
            check.missing_column(second, f"needed beside {sds[0]!r}")
    answer = _answer_column(expected, mapping, task)
    if answer is None:
        answer = task.response if task else "choice"
        check.missing_column(answer, "needed for the answer")
    if answer not in SINGLE and "n" not in expected:
        check.missing_column("n", "needed for the number of trials")
    check.say_missing(here)
    return stimuli, answer


def _answer_column(expected: set[str], mapping: Mapping[str, str], task: Task | None) -> str | None:
    """The column of the answer: the one that is mapped, or else one that goes with the task."""
    meant = [a for a in ANSWERS if a in mapping]
    if len(meant) > 1:
        raise Refusal(
            named("columns") + " maps one answer",
            " and ".join(map(repr, meant)),
            f"leave {meant[-1]!r} out",
        )
    if meant and task is not None and TASKS[ANSWERS[meant[0]]].response != task.response:
        raise Refusal(
            f"the answer of task {task.name!r} is a {task.response!r}",
            f"a column for {meant[0]!r}",
            f"map {task.response!r}, or leave the task out",
        )
    here = [a for a in ANSWERS if a in expected]
    if task is not None:
        here = [a for a in here if TASKS[ANSWERS[a]].response == task.response]
    return next(iter(meant or here), None)


def _disagreements(
    check: TableCheck, stimuli: tuple[str, ...], raw: pd.DataFrame, mapped: Mapping[str, str]
) -> list[str]:
    """Sentences on columns of our names that give other stimuli than those that were read."""
    if _mapped_form(mapped) is not None or stimuli != FORMS[0]:
        return []
    table = check.table
    notes: list[str] = []
    first, second = (_floats(table[c]) for c in stimuli)
    for name in ("comparison", "log_ratio"):
        if name not in table or (name == "comparison" and "standard" not in table):
            continue
        values = _floats(table[name])
        if name == "log_ratio":
            with np.errstate(all="ignore"):
                agree = np.isclose(values, np.log(second / first), rtol=0.02, atol=0.005)
        elif set(np.unique(values)) <= {0.0, 1.0, 2.0}:  # intervals
            continue
        else:
            agree = np.isclose(values, first, 1e-6) | np.isclose(values, second, 1e-6)
        if not agree.all():
            theirs = check.called(name)
            notes.append(
                f"Stimuli were read from {check.called(stimuli[0])!r} and "
                f"{check.called(stimuli[1])!r}, with which {theirs!r} does not agree; "
                + argument("columns", {name: theirs})
                + " reads that."
            )
    return notes


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
    mapped: Mapping[str, str] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)
    missing: list[tuple[str, str, str]] = field(default_factory=list)

    def called(self, column: str) -> str:
        """What the file calls a column."""
        return self.mapped.get(column, column)

    def add(self, column: str, bad: Flags, sentence: str, *values: Array, remedy: str = "") -> None:
        """A problem with some cells of a column, if any; the first of the values fill in."""
        if bad.any():
            rows = rows_in_words(self.table.index.to_numpy()[bad])
            said = sentence.format(*(value[bad][0] for value in values)) if values else sentence
            self.problems.append(
                Advice.joined(
                    "", [f"{self.name}, column {self.called(column)!r}, {rows}: ", said, remedy]
                )
            )

    def missing_column(self, column: str, why: str, ours: str | None = None) -> None:
        """A column that is not there, and which of ours it is mapped from."""
        self.missing.append((column, why, ours or column))

    def say_missing(self, here: list[str]) -> None:
        """All columns that are not there, in a sentence with the nearest that are."""
        if not self.missing:
            return
        reasons: dict[str, list[str]] = {}
        for column, why, _ in self.missing:
            reasons.setdefault(why, []).append(repr(column))
        said = ", nor ".join(f"{' or '.join(names)}, {why}" for why, names in reasons.items())
        near = {
            ours: next(iter(get_close_matches(column, here, n=1, cutoff=0.5)), "<its name>")
            for column, _, ours in self.missing
        }
        one = "one" if len(near) == 1 else "them"
        numbered = here == [str(i + 1) for i in range(len(here))]
        by = ", by their places, as there is no header" * numbered
        self.problems.append(
            f"{self.name}: there is no column {said}; "
            + argument("columns", near)
            + f" maps {one} from {checks.listed(here, 12)}{by}."
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
        said = f"{{:g}} is above the {{:g}} trials in column {self.called('n')!r}; check which is "
        said += "which."
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
    scored = answer == "correct"
    if labels is None:
        truths = {"true": 1, "false": 0}
        values = _floats(cells.map(lambda c: truths.get(str(c).strip().lower(), c)))
        kept = np.where(np.isin(values, [0, 1]), values, np.nan)
        if scored:
            return kept, (
                "write 1 for correct and 0 for wrong, map percentages as percent_correct, or give "
                + argument("choice_labels", SCORED)
                + ", say"
            )
        remedy = "write 1 for second greater and 0 for first greater, or give "
        return kept, remedy + argument("choice_labels", {"L": "first", "R": "second"}) + ", say"
    codes = {"first": 0.0, "second": 1.0, "none": np.nan}
    if scored:
        codes = {"wrong": 0.0, "correct": 1.0, "none": np.nan}
        if {*labels.values()} & {"first", "second"}:
            raise Refusal(
                named("choice_labels") + " say which stimulus was reported greater",
                f"them for the answer {answer!r}",
                "write " + argument("choice_labels", SCORED) + ", say",
            )
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
    fraction is counted per unit. Neighbouring levels are compared, and every pair of them counts as
    a standard, named by its middle. The animal is learning: lapses, bias and drift are real.

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
        table = load_table(path)
    sounds = [pd.to_numeric(table.frame[name]) for name in ("s1_z", "s2_z")]
    trials = read_trials(
        table.frame.assign(standard=0.5 * (sounds[0] + sounds[1])),
        columns={"stimulus_1": "s1_z", "stimulus_2": "s2_z"},
        choice_labels={"right": "first", "left": "second"},
        scale="log",
        task="2IFC",
    )
    trials = replace(trials, source=table.name)
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
