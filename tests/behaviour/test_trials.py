"""Tables are read as they are, and what is wrong with them is said all at once."""

from __future__ import annotations

import gzip
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from weberwhisk.behaviour import (
    load_rat_auditory,
    read_trials,
    simulate_trials,
)

GOOD = "stimulus_1,stimulus_2,choice\n1,1.1,1\n1,0.9,0\n"


def table(tmp_path: Path, text: str, name: str = "table.csv") -> Path:
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return path


def refusal(source: Path | pd.DataFrame, **options: object) -> str:
    with pytest.raises(ValueError) as caught:  # noqa: PT011
        read_trials(source, **options)  # type: ignore[arg-type]
    return str(caught.value)


# -- what is read ---------------------------------------------------------------------------------


def test_a_plain_table(tmp_path: Path) -> None:
    trials = read_trials(table(tmp_path, GOOD))
    assert trials.task.name == "2AFC"
    assert trials.n_trials == 2
    assert trials.frame["count"].tolist() == [1.0, 0.0]
    assert trials.standards.tolist() == [1.0]


@pytest.mark.parametrize("name", ["t.csv", "t.csv.gz", "t.tsv", "t.tsv.gz"])
def test_separators_and_gzip(tmp_path: Path, name: str) -> None:
    text = GOOD.replace(",", "\t") if "tsv" in name else GOOD
    path = tmp_path / name
    path.write_bytes(gzip.compress(text.encode()) if name.endswith("gz") else text.encode())
    assert read_trials(path).n_trials == 2


def test_columns_by_any_name_and_text_labels(tmp_path: Path) -> None:
    text = "first (g);second\n"  # not our separator: used below
    assert "no column" in refusal(table(tmp_path, text + "1;2\n"))
    frame = pd.DataFrame({"a": [1.0, 1.0, 2.0], "b": [1.2, 0.8, 2.2], "said": ["L", " R", None]})
    trials = read_trials(
        frame,
        columns={"stimulus_1": "a", "stimulus_2": "b", "choice": "said"},
        choice_labels={"L": "first", "R": "second"},
    )
    assert trials.frame["count"].tolist()[:2] == [0.0, 1.0]
    assert (trials.n_trials, trials.n_missing) == (2, 1)
    assert "1 trial without an answer" in trials.notes[0]


def test_writing_and_reading_come_round(tmp_path: Path) -> None:
    for task in ("2AFC", "3AFC percent correct"):
        trials = simulate_trials(task=task, missing=0.1, subject="r1", sessions=2, seed=3)
        path = trials.to_csv(tmp_path / "trials.csv")
        again = read_trials(path, task=task)
        pd.testing.assert_frame_equal(trials.frame, again.frame, check_dtype=False)
        assert [p.name for p in tmp_path.iterdir()] == ["trials.csv"]


@pytest.mark.parametrize(
    ("s1", "s2", "standards"),
    [
        ([1, 1, 1, 1], [0.8, 0.9, 1.1, 1.2], [1]),
        ([0.8, 0.9, 1.1, 1.2], [1, 1, 1, 1], [1]),
        ([1, 1, 1, 2, 2, 2], [0.8, 1, 1.3, 1.6, 2, 2.4], [1, 2]),
        ([1, 4, 4, 9], [4, 1, 9, 4], []),  # neighbours on a ladder: none is known
    ],
)
def test_standards_are_read_off_the_design(s1: list, s2: list, standards: list) -> None:
    frame = pd.DataFrame({"stimulus_1": s1, "stimulus_2": s2, "choice": 1})
    assert read_trials(frame).standards.tolist() == pytest.approx(standards)


# -- real data ------------------------------------------------------------------------------------


def test_the_rats_file() -> None:
    trials = load_rat_auditory()
    assert (len(trials), trials.n_trials, len(trials.sessions)) == (11489, 11489, 40)
    assert trials.task.name == "2IFC"
    assert trials.standards.size == 8
    # The file says itself which answers were right: right is rewarded where s1 > s2.
    raw = pd.read_csv(Path(__file__).parents[2] / "weberwhisk/data/rat_auditory_2ifc.csv.gz")
    greater = trials.frame["stimulus_2"] > trials.frame["stimulus_1"]
    assert ((trials.frame["count"] == greater) == (raw["correct"] == 1)).all()


# -- what is refused ------------------------------------------------------------------------------


def one_sentence(message: str) -> bool:
    return "\n" not in message and message.endswith(".") and message.count(". ") == 0


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("", ["table.csv", "empty"]),
        ("stimulus_1,stimulus_2,choice\n", ["table.csv", "no rows"]),
        (
            "stimulus_1,stimuls_2,choice\n1,2,1\n",
            ["'stimulus_2'", "columns={'stimulus_2': 'stimuls_2'} maps one"],
        ),
        (
            "stimulus_1,stimulus_2,chioce\n1,2,1\n",
            ["'choice'", "columns={'choice': 'chioce'} maps one"],
        ),
        ("stimulus_1,stimulus_2,n_greater\n1,2,1\n", ["'n'", "number of trials"]),
        (GOOD + "1,,1\n", ["'stimulus_2'", "row 3", "empty"]),
        (GOOD + "1,nan,1\n", ["'stimulus_2'", "row 3", "NaN"]),
        (GOOD + "1,inf,1\n", ["'stimulus_2'", "row 3", "infinite"]),
        (GOOD + "1,heavy,1\n", ["'stimulus_2'", "row 3", "'heavy' is not a number"]),
        (GOOD + "1,-2,1\n", ["'stimulus_2'", "row 3", "above zero, got -2", "scale='log'"]),
        (GOOD + "1,0,1\n1,0,1\n", ["rows 3, 4", "above zero"]),
        (GOOD + "1,1,2\n", ["'choice'", "row 3", "'2' is not an answer", "choice_labels"]),
        (GOOD + "1,1,left\n", ["'left' is not an answer"]),
        ("standard,comparison,correct\n1,2,0.5\n", ["'correct'", "1 for correct"]),
        ("standard,comparison,n,n_correct\n1,2,5,6\n", ["6 is above the 5 trials"]),
        ("standard,comparison,n,n_correct\n1,2,5,-1\n", ["-1 is not a count"]),
        ("standard,comparison,n,n_correct\n1,2,5.5,5\n", ["5.5 is not a count"]),
        ("standard,comparison,n,n_correct\n1,2,five,5\n", ["'five' is not a number"]),
        ("stimulus_1,choice\n1,1.1,1\n", ["more cells than the header"]),
        ('a,b\n1,"2\n3,4\n', ["not readable as a table"]),
        ("subject,log_ratio,choice\nr1,1,1\n,1,1\n", ["'subject'", "row 2", "name the subject"]),
        (GOOD + "\n\n1,x,1\n", ["'stimulus_2'", "row 5", "'x' is not a number"]),
        (
            "stimulus_1;stimulus_2;choice\n0,5;2;1\n0.5;2;1\n",
            ["'0,5' is not a number; write 0.5, or give pandas.read_csv", 'decimal=","'],
        ),
    ],
)
def test_each_problem_is_one_sentence(tmp_path: Path, text: str, parts: list[str]) -> None:
    message = refusal(table(tmp_path, text))
    assert one_sentence(message), message
    assert all(part in message for part in ["table.csv", *parts]), message


def test_all_problems_are_named_at_once(tmp_path: Path) -> None:
    text = "stimulus_1,stimulus_2,choice\n1,x,1\n-1,2,7\n1,,1\n"
    lines = refusal(table(tmp_path, text)).splitlines()
    assert len(lines) == 4
    assert sum("'stimulus_2'" in line for line in lines) == 2
    assert all(line.startswith("table.csv, column ") for line in lines)


def test_missing_columns_and_bad_cells_are_named_together(tmp_path: Path) -> None:
    path = table(tmp_path, "standard,compar,n,n_greater,session\n-1,x,2.5,3,\n1,1,4,many,1\n")
    lines = refusal(path).splitlines()
    places = ["'comparison'", "'standard'", "'session'", "'n'", "'n_greater'", "row 2"]
    assert len(lines) == len(places)
    assert all(place in line for place, line in zip(places, lines, strict=True)), lines
    assert "columns={'comparison': 'compar'} maps one" in lines[0]


def test_distances_off_the_whisker() -> None:
    frame = pd.DataFrame({"standard": [0.02, 0.02], "comparison": [0.03, 30.0], "choice": [1, 1]})
    whisker = SimpleNamespace(length=0.05)
    message = refusal(frame, whisker=whisker)
    assert one_sentence(message)
    assert "row 2: radial distance 30 m is beyond the whisker's length of 0.05 m" in message


@pytest.mark.parametrize(
    ("options", "part"),
    [
        ({"task": "2AFCC"}, "did you mean '2AFC'"),
        ({"scale": "logarithmic"}, "scale 'logarithmic' is unknown"),
        ({"columns": {"stimulus1": "a"}}, "did you mean 'stimulus_1'"),
        ({"choice_labels": {"1": "left"}}, "choose one of first, second"),
        ({"log_unit": -1.0, "scale": "log"}, "log_unit must be above zero"),
        ({"task": "3AFC percent correct"}, "'correct'"),
    ],
)
def test_unknown_names_are_refused(tmp_path: Path, options: dict, part: str) -> None:
    message = refusal(table(tmp_path, GOOD), **options)
    assert one_sentence(message)
    assert part in message


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="there is no such file") as caught:
        read_trials(tmp_path / "none.csv")
    assert caught.value.filename == str(tmp_path / "none.csv")
    assert "none.csv" in str(caught.value)


# -- other formats --------------------------------------------------------------------------------

MADE = pd.DataFrame(
    {
        "subject": ["a", "a", "b"],
        "stimulus_1": [1.0, 1.0, 1.0],
        "stimulus_2": [1.1, 0.9, 1.2],
        "choice": [1.0, 0.0, np.nan],
    }
)


@pytest.mark.parametrize(
    ("name", "package"),
    [("t.parquet", "pyarrow"), ("t.xlsx", "openpyxl"), ("t.csv.bz2", ""), ("t.tsv.xz", "")],
)
def test_other_formats_hold_the_same_trials(tmp_path: Path, name: str, package: str) -> None:
    if package:
        pytest.importorskip(package)
    path = tmp_path / name
    if package == "pyarrow":
        MADE.to_parquet(path)
    elif package == "openpyxl":
        MADE.to_excel(path, index=False)
    else:
        MADE.to_csv(path, index=False, sep="\t" if "tsv" in name else ",")
    pd.testing.assert_frame_equal(read_trials(path).frame, read_trials(MADE).frame)


def test_the_trials_of_an_nwb_file(tmp_path: Path) -> None:
    pynwb = pytest.importorskip("pynwb")
    from datetime import UTC, datetime

    file = pynwb.NWBFile("trials", "id", datetime(2026, 1, 1, tzinfo=UTC))
    for column in ("near", "far"):
        file.add_trial_column(column, "radial distance, m")
    file.add_trial_column("said", "answer")
    file.add_trial_column("licks", "times, s", index=True)
    for i, said in enumerate(["far", "near", ""]):
        file.add_trial(
            start_time=float(i), stop_time=i + 0.5, near=0.02, far=0.03 - 0.015 * (i == 1),
            said=said, licks=[0.1] * i,
        )  # fmt: skip
    with pynwb.NWBHDF5IO(str(tmp_path / "t.nwb"), "w") as io:
        io.write(file)
    trials = read_trials(
        tmp_path / "t.nwb",
        columns={"stimulus_1": "near", "stimulus_2": "far", "choice": "said"},
        choice_labels={"far": "second", "near": "first"},
    )
    assert trials.frame["stimulus_2"].tolist() == [0.03, 0.015, 0.03]
    assert trials.frame["count"].tolist()[:2] == [1.0, 0.0]
    assert trials.n_missing == 1


@pytest.mark.parametrize("name", ["t.parquet", "t.xlsx", "t.nwb"])
def test_a_broken_file_or_a_missing_reader_is_one_sentence(tmp_path: Path, name: str) -> None:
    message = refusal(table(tmp_path, "not a table at all", name))
    assert message.startswith(name)
    assert "\n" not in message
    assert "save it as CSV" in message or "or save the table as CSV" in message


def test_a_missing_reader_names_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pynwb", None)
    message = refusal(table(tmp_path, "", "t.nwb"))
    assert one_sentence(message), message
    assert "pip install 'weberwhisk[nwb]'" in message


@pytest.mark.parametrize("separator", [";", "\t", ","])
def test_decimal_commas_are_read_whatever_separates_columns(tmp_path: Path, separator: str) -> None:
    """As spreadsheets write them in German or French; the remark's comma is no number's."""
    path = tmp_path / "trials.csv"
    table = pd.DataFrame({"standard": [1.5, 1.5, 30.25], "comparison": [1.2, 1.8, 1.5e-5],
                          "choice": [0, 1, 1], "remark": ["good, or so", "1", "2"]})  # fmt: skip
    table.to_csv(path, sep=separator, decimal=",", index=False)
    frame = read_trials(path).frame
    assert frame["stimulus_1"].tolist() == [1.5, 1.5, 30.25]
    assert frame["stimulus_2"].tolist() == [1.2, 1.8, 1.5e-5]


@pytest.mark.parametrize(
    "text",
    [
        "standard\tcomparison\tchoice\n1,500\t1,200\t0\n1,500\t1,800\t1\n",  # or thousands
        "standard;comparison;choice\n1.5;1,2;0\n1.5;1.8;1\n",  # both signs in one column
        "standard;comparison;choice\n1.500,5;1,2;0\n1,5;1,8;1\n",
    ],
)
def test_commas_that_may_be_of_thousands_are_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "trials.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match="is not a number; write") as refused:
        read_trials(path)
    assert str(refused.value).count("'standard'") < 2


def test_percentages_are_answers_of_the_trials_of_their_row() -> None:
    percent = {"percent_correct": [90.0, 62.5, 67.0, np.nan], "n": [40, 40, 40, 10]}
    table = pd.DataFrame({"standard": 1.5, "comparison": [1.2, 1.6, 1.7, 1.8], **percent})
    trials = read_trials(table)
    assert trials.task.name == "2AFC percent correct"
    counts = trials.frame["count"]
    assert counts[:3].tolist() == [36, 25, 27]  # 27 of 40 are 67.5 %
    assert np.isnan(counts[3])
    other = table.rename(columns={"percent_correct": "% right"})
    mapped = read_trials(other, columns={"percent_greater": "% right"})
    assert mapped.task.name == "2AFC"
    assert mapped.frame["count"][:3].tolist() == [36, 25, 27]
    for values, said in (
        ([150.0, 1, 2, 3], "150 is no percentage"),
        ([0.9, 0.6, 0.7, 1.0], "as if these were proportions"),
        ([91.0, 50, 50, 50], "91 % of 40 trials is no whole number"),
        (["x"] * 4, "'x' is not an answer"),
    ):
        with pytest.raises(ValueError, match=said) as refused:
            read_trials(table.assign(percent_correct=values))
        assert "\n" not in str(refused.value)


def test_semicolons_and_a_byte_order_mark(tmp_path: Path) -> None:
    path = tmp_path / "excel.csv"
    path.write_text("\n" + GOOD.replace(",", ";"), encoding="utf-8-sig")
    assert read_trials(path).n_trials == 2


# -- trouble --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("factor", "part"), [(1e-6, "no radial distance is above"), (1e6, "beyond")]
)
def test_distances_in_another_unit_are_refused(factor: float, part: str) -> None:
    frame = pd.DataFrame({"standard": 0.02, "comparison": [0.025, 0.015], "choice": [1, 0]})
    whisker = SimpleNamespace(length=0.05)
    assert read_trials(frame, whisker=whisker).n_trials == 2
    frame[["standard", "comparison"]] *= factor
    lines = refusal(frame, whisker=whisker).splitlines()
    assert len(lines) == 2
    assert all(part in line and "write distances in metres" in line for line in lines)


@pytest.mark.parametrize("name", ["\x1b[31mred", "a\x07", "a\tb", "zero\u200bwidth"])
def test_names_that_a_terminal_would_obey_are_refused(name: str) -> None:
    frame = pd.DataFrame({"subject": name, "stimulus_1": [1.0], "stimulus_2": 1.1, "choice": 1})
    assert "row 1: " in (said := refusal(frame))
    assert "not printed" in said
    assert said.isprintable()


@pytest.mark.parametrize("name", ["=1+1", "@SUM(A1)", "+x", "-x", " =2"])
def test_a_name_is_no_formula_in_a_spreadsheet(tmp_path: Path, name: str) -> None:
    frame = pd.DataFrame({"subject": name, "stimulus_1": [1.0], "stimulus_2": 1.1, "choice": 1})
    trials = read_trials(frame)
    path = trials.to_csv(tmp_path / "t.csv")
    cell = path.read_text().splitlines()[1].split(",")[0]
    assert cell.startswith("'")
    assert read_trials(path).subjects == trials.subjects == [name.strip()]


def test_labels_that_a_gap_made_into_floats_are_the_same_labels(tmp_path: Path) -> None:
    """pandas writes integers beside a gap as 1.0, in text too."""
    path = tmp_path / "trials.csv"
    path.write_text("stimulus_1,stimulus_2,choice\n1,2,1.0\n2,1,2.0\n1,2,\n")
    trials = read_trials(path, choice_labels={1: "first", 2: "second"})
    assert (trials.n_trials, trials.n_missing) == (2, 1)


def test_columns_in_mm_are_read_in_metres_where_all_stimuli_are() -> None:
    table = pd.DataFrame(
        {"standard_mm": [20, 20], "stimulus_1_mm": [20, 20], "stimulus_2_mm": [22, 18],
         "choice": [1, 0]}
    )  # fmt: skip
    assert read_trials(table).frame["stimulus_2"].tolist() == [0.022, 0.018]
    mapped = {name: f"{name}_mm" for name in ("stimulus_1", "stimulus_2")}
    frame = read_trials(table, columns=mapped).frame  # and not a standard of another unit
    assert frame["stimulus_2"].tolist() == [22, 18]
    assert (frame["standard"] > 1).all()


@pytest.mark.parametrize(
    ("answer", "value", "options", "said"),
    [
        (
            "correct",
            "hit",
            {"choice_labels": {"hit": "first"}},
            "got them for the answer 'correct'",
        ),
        ("n_greater", 1, {"choice_labels": {1: "first"}}, "got them for the answer 'n_greater'"),
        ("choice", 1, {"columns": {"n": "of"}}, "columns maps 'n'"),
    ],
)
def test_options_that_would_be_ignored_or_misread_are_refused(
    answer: str, value: object, options: dict[str, object], said: str
) -> None:
    table = pd.DataFrame({"standard": 1.0, "comparison": [1.1], "n": 5, "of": 5, answer: value})
    assert said in refusal(table, **options)


def test_a_session_called_inf_is_text_and_logical_words_of_a_spreadsheet_are_answers() -> None:
    table = pd.DataFrame({"session": ["inf", "1"], "standard": 1.0, "comparison": 1.1})
    trials = read_trials(table.assign(choice=pd.Series(["TRUE", "FALSE"], dtype=object)))
    assert trials.sessions == ["1", "inf"]
    assert trials.frame["count"].tolist() == [1.0, 0.0]


def test_the_one_stimulus_of_every_row_is_the_standard() -> None:
    """In random order each pair was its own standard, never shown."""
    trials = simulate_trials(order="random", seed=1)
    stimuli = trials.table()[["stimulus_1", "stimulus_2", "choice"]]
    assert read_trials(stimuli).standards.tolist() == [1.0]
    two = pd.DataFrame({"stimulus_1": [1.0, 4.0], "stimulus_2": [4.0, 1.0], "choice": [1, 0]})
    assert read_trials(two).standards.tolist() == []  # either may be


def test_tables_of_pandas_own_types_and_dates() -> None:
    table = pd.DataFrame(
        {"stimulus_1": [1, 1, 2, 2], "stimulus_2": [1.2, 0.8, 2.5, 1.6], "choice": [1, 0, None, 0]}
    )
    named = table.assign(session=["mon", "mon", "tue", "tue"], trial=[1, 2, 1, 2]).convert_dtypes()
    trials = read_trials(named)
    assert (trials.sessions, trials.n_missing) == (["mon", "tue"], 1)
    dated = table.assign(session=pd.to_datetime(["2024-01-02"] * 2 + ["2024-01-03"] * 2))
    assert read_trials(dated).sessions == ["2024-01-02", "2024-01-03"]
    numbered = table.assign(session=pd.array([1, 1, 2, None], dtype="Int64"))
    with pytest.raises(ValueError, match=r"row 4: empty; name the session"):
        read_trials(numbered)
