"""Tables as people have them, each with the right value or with the sentence on what is missing."""

from __future__ import annotations

import io
import json
import zipfile
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pandas as pd
import pytest
from scipy.io import savemat
from scipy.special import ndtr
from short_forms import slow_but

from weberwhisk.behaviour import (
    Trials,
    checks,
    fit_weber,
    read_trials,
    simulate_trials,
    weber_law_test,
)
from weberwhisk.behaviour.effects import History
from weberwhisk.cli import app, run_app

pytestmark = pytest.mark.usefixtures("few_draws")

LEVELS = np.array([0.8, 0.9, 0.95, 1.05, 1.1, 1.25])
ORDERED = {"trend", "repetition", "outcome", "streaks"}


def answered(s1: np.ndarray, s2: np.ndarray, seed: int, k: float = 0.13) -> pd.DataFrame:
    """A stationary observer of Weber's law."""
    p = 0.02 + 0.96 * ndtr((s2 - s1) / (k * np.hypot(s1, s2)))
    choice = (np.random.default_rng(seed).random(len(p)) < p).astype(int)
    return pd.DataFrame({"stimulus_1": s1, "stimulus_2": s2, "choice": choice})


def one_standard(n: int = 240, seed: int = 1, standard: float = 100.0) -> pd.DataFrame:
    rng = np.random.default_rng(seed)
    return answered(np.full(n, standard), standard * rng.choice(LEVELS, n), seed)


def several(n: int = 400, seed: int = 2) -> pd.DataFrame:
    rng = np.random.default_rng(seed)
    s1 = rng.choice([1000.0, 1500.0, 2000.0, 2500.0, 3000.0], n)
    return answered(s1, np.round(s1 * rng.choice([0.7, 0.85, 0.93, 1.08, 1.18, 1.4], n), 1), seed)


def same_fit(one: Trials, other: Trials) -> bool:
    a, b = fit_weber(one), fit_weber(other)
    return bool(np.allclose(a.interval(), b.interval(), rtol=1e-6))


def refused(source: Any, **options: Any) -> str:
    with pytest.raises(ValueError) as caught:  # noqa: PT011
        read_trials(source, **options)
    return str(caught.value)


def command(capsys: pytest.CaptureFixture[str], *words: object) -> tuple[int, str]:
    code = run_app(app, ["fit", *map(str, words)])
    said = capsys.readouterr()
    return code, said.out + said.err


def as_json(capsys: pytest.CaptureFixture[str], *words: object) -> dict[str, Any]:
    code, said = command(capsys, *words, "--json")
    assert code == 0, said
    return dict(json.loads(said))


# -- a mapping is obeyed --------------------------------------------------------------------------


@pytest.fixture
def planned_and_measured() -> pd.DataFrame:
    """Planned levels under our names, measured ones under the user's."""
    made = one_standard(seed=3)
    measured = (100 * np.exp(2 * np.log(made["stimulus_2"] / 100))).round(2)
    log = np.log(measured / 100)
    return made.assign(std=100.0, cmp=measured, lr=log, said=1 - made["choice"])


@pytest.mark.parametrize(
    "columns",
    [
        {"standard": "std", "comparison": "cmp"},
        pytest.param({"stimulus_1": "std", "stimulus_2": "cmp"}, marks=pytest.mark.slow),
        {"log_ratio": "lr"},
        pytest.param({"comparison": "cmp", "standard": "stimulus_1"}, marks=pytest.mark.slow),
    ],
)
def test_mapped_stimuli_are_read_whatever_columns_of_our_names_there_are(
    planned_and_measured: pd.DataFrame,
    columns: dict[str, str],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    right = planned_and_measured[["choice"]].assign(
        stimulus_1=100.0, stimulus_2=planned_and_measured["cmp"]
    )
    trials = read_trials(planned_and_measured, columns=columns)
    assert same_fit(trials, read_trials(right))
    path = tmp_path / "mapped.csv"
    planned_and_measured.to_csv(path, index=False)
    words = [word for pair in columns.items() for word in ("--column", "=".join(pair))]
    found = as_json(capsys, path, *words)
    assert found["weber_fraction"] == pytest.approx(fit_weber(trials).weber_fraction, rel=1e-6)


def test_a_mapped_answer_is_read_and_contradictions_are_refused(
    planned_and_measured: pd.DataFrame,
) -> None:
    table = planned_and_measured.assign(correct=1)
    turned = read_trials(table, columns={"choice": "said"})
    assert (turned.frame["count"] == 1 - table["choice"]).all()
    both = {"comparison": "cmp", "stimulus_1": "std"}
    assert "one form" in refused(table, columns=both)
    assert "one answer" in refused(table, columns={"choice": "said", "correct": "correct"})
    said = refused(table, columns={"correct": "said"}, task="2AFC")
    assert "map 'choice'" in said
    assert "'stimulus_2_sd'" in refused(table, columns={"stimulus_1_sd": "lr"})


def test_columns_that_disagree_are_said_and_the_line_works(
    planned_and_measured: pd.DataFrame,
) -> None:
    table = planned_and_measured.rename(columns={"lr": "log_ratio"})
    (said,) = (note for note in read_trials(table).notes if "does not agree" in note)
    assert "columns={'log_ratio': 'log_ratio'} reads that" in said
    read = read_trials(table, columns={"log_ratio": "log_ratio"})
    assert same_fit(read, read_trials(planned_and_measured, columns={"log_ratio": "lr"}))


# -- standards ------------------------------------------------------------------------------------


def test_an_equal_pair_in_the_first_row_is_of_the_same_standard() -> None:
    made = one_standard(seed=4, standard=8.6)
    turned = made.index % 2 == 1  # the standard is in either interval
    made.loc[turned, ["stimulus_1", "stimulus_2"]] = made.loc[
        turned, ["stimulus_2", "stimulus_1"]
    ].to_numpy()
    made.loc[turned, "choice"] = 1 - made.loc[turned, "choice"]
    equal = pd.DataFrame({"stimulus_1": [8.6], "stimulus_2": [8.6], "choice": [1]})
    first = read_trials(pd.concat([equal, made], ignore_index=True))
    last = read_trials(pd.concat([made, equal], ignore_index=True))
    for trials in (first, last):
        assert trials.standards.tolist() == [8.6]
        assert not any("standard" in note for note in trials.notes)
    a, b = (fit_weber(t, bias="per standard").weber_fraction for t in (first, last))
    assert a == pytest.approx(b, rel=1e-9)
    with pytest.raises(ValueError, match="two standards or more"):
        weber_law_test(fit_weber(first))


def test_five_standards_with_two_comparisons_each_are_five(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    standards = np.array([1.0, 1.4, 2.0, 2.8, 4.0])
    s1 = np.tile(standards, 12)
    made = answered(s1, np.repeat([0.74, 1.35], 30) * s1, seed=5)
    trials = read_trials(made)
    assert trials.standards.tolist() == standards.tolist()
    (said,) = (note for note in trials.notes if "guessed" in note)
    assert "columns={'standard': '<its name>'} would name them" in said
    fit = fit_weber(trials)
    assert said in fit.notes
    assert said in fit.report()
    assert said in json.loads(fit.to_json())["notes"]
    path = tmp_path / "contraction.csv"
    made.to_csv(path, index=False)
    assert "--column standard='<its name>' would name them" in command(capsys, path)[1]
    named = read_trials(made, columns={"standard": "stimulus_2"})  # as the line says
    assert named.standards.size == 10
    found = as_json(capsys, path, "--column", "standard=stimulus_2")
    assert len(found["data"]["standards"]) == 10


def test_a_column_of_intervals_is_no_magnitude() -> None:
    made = several(seed=6)
    turned = made["stimulus_2"] > 2000
    made.loc[turned, ["stimulus_1", "stimulus_2"]] = made.loc[
        turned, ["stimulus_2", "stimulus_1"]
    ].to_numpy()
    read = read_trials(made.assign(standard=np.where(turned, 2, 1)))
    assert read.standards.tolist() == [1000, 1500, 2000, 2500, 3000]
    assert any("interval of the standard" in note for note in read.notes)
    places = made.assign(standard=np.where(turned, 2, 1), comparison=np.where(turned, 1, 2))
    only = places[["standard", "comparison", "choice"]]
    assert "intervals, not magnitudes" in refused(only)


def test_without_a_standard_nothing_is_concluded_that_needs_one() -> None:
    ladder = np.geomspace(1.0, 4.0, 7)
    rng = np.random.default_rng(7)
    low = rng.integers(0, 6, 400)
    up = rng.random(400) < 0.5
    made = answered(ladder[low + ~up], ladder[low + up], seed=7)
    trials = read_trials(made)
    assert trials.standards.size == 0
    fit = fit_weber(trials)
    assert not fit.threshold().size
    assert "From standard" not in fit.report()
    assert any("which stimulus of a pair is the standard" in note for note in fit.notes)
    for refusing in (lambda: fit_weber(trials, bias="per standard"), lambda: weber_law_test(fit)):
        with pytest.raises(ValueError, match=r"columns=\{'standard': '<its name>'\}"):
            refusing()
    assert np.isfinite(fit.threshold(standard=2.0)["comparison"]).all()  # the user names one
    assert fit.plot() is not None
    again = read_trials(trials.table())
    assert again.standards.size == 0
    assert read_trials(made, columns={"standard": "stimulus_1"}).standards.size == 7


# -- order and people -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    "by", slow_but([["stimulus_1"], ["stimulus_1", "stimulus_2", "choice"]], (0,))
)
def test_a_sorted_table_has_no_check_of_order_and_says_so(
    by: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    made = several(160, seed=8).sort_values(by, kind="stable")
    fit = fit_weber(read_trials(made))
    assert ORDERED.isdisjoint(checks(fit).index)
    (said,) = (note for note in fit.notes if "look sorted" in note)
    assert "in_order=True says that rows are in order" in said
    assert said in fit.report()
    with_sessions = read_trials(made.assign(session=1))
    assert not with_sessions.course.is_known
    told = read_trials(made, in_order=True)
    assert told.course.is_known
    assert not any("order" in note for note in told.notes)
    with pytest.raises(ValueError, match="look sorted"):
        fit_weber(read_trials(made), effects=[History()])
    path = tmp_path / "sorted.csv"
    made.to_csv(path, index=False)
    assert "--in-order says that rows are in order" in command(capsys, path)[1]
    assert not any("order" in note for note in as_json(capsys, path, "--in-order")["notes"])


def test_rows_are_a_course_of_time_where_something_says_so() -> None:
    made = several(seed=9)
    rows = np.arange(len(made))
    assert not read_trials(made).course.is_known
    for named in ({"trial": rows}, {"session": rows // 100}):
        assert read_trials(made.assign(**named)).course.is_known
        assert not read_trials(made.assign(**named), in_order=False).course.is_known
    guessed = read_trials(made.assign(time_elapsed=rows * 1.5))
    assert guessed.course.is_known
    assert "'time_elapsed' rises; in_order=False says" in guessed.course.note
    clock = pd.Timestamp("2024-05-01") + pd.to_timedelta(rows, "s")
    assert read_trials(made.assign(Timestamp=clock.astype(str))).course.is_known
    assert not read_trials(made.assign(response_time=rows)).course.is_known


def test_numbered_trials_are_put_in_their_order() -> None:
    made = simulate_trials(sessions=12, trials_per_level=10, seed=3).table()
    named = made.assign(session=["s" + str(s) for s in made["session"]])
    shuffled = named.sample(frac=1, random_state=1)
    read = read_trials(shuffled)
    assert (read.frame["trial"] == made["trial"]).all()
    assert read.frame["session"].unique().tolist() == [f"s{i}" for i in range(1, 13)]
    assert any("put in the order" in note for note in read.notes)
    assert not read_trials(shuffled, in_order=True).frame["trial"].equals(made["trial"])
    assert read.rows is not None
    first = read.frame.loc[read.rows == 1].iloc[0]  # rows of the file are known by their places
    assert first["trial"] == shuffled["trial"].iloc[0]


def test_gaps_mean_the_same_to_checks_and_to_effects() -> None:
    """An observer who repeats the answer before; every other trial is not in the table."""
    whole = simulate_trials(trials_per_level=60, effects=[(History(), 1.5)], seed=4)
    table = whole.table().drop(columns="session")
    assert checks(fit_weber(read_trials(table)))["p"]["repetition"] < 0.01
    half = read_trials(table[::2])
    assert not half.follows.any()
    assert {"repetition", "outcome"}.isdisjoint(checks(fit_weber(half)).index)
    from weberwhisk.behaviour import IdentityEncoding

    assert not History().column(half, IdentityEncoding()).any()


@pytest.mark.parametrize(
    ("name", "values", "ours"),
    [
        ("sub", [1, 2, 3, 4], "subject"), ("subcode", ["a", "b", "c", "d"], "subject"),
        ("id", [11, 12, 13, 14], "subject"), ("ppt", [1, 2, 3, 4], "subject"),
        ("vp", [1, 2, 3, 4], "subject"), ("monkey", ["J", "K", "L", "M"], "subject"),
        ("SubjectID", [1, 2, 3, 4], "subject"), ("kuerzel", ["x", "y", "z", "w"], "subject"),
        ("blk", [1, 2, 3, 4], "session"), ("testDay", [1, 2, 3, 4], "session"),
    ],
)  # fmt: skip
def test_people_and_sessions_are_not_pooled_in_silence(
    name: str, values: list[object], ours: str
) -> None:
    made = one_standard(seed=10).assign(**{name: np.repeat(np.array(values, dtype=object), 60)})
    line = f"columns={{{ours!r}: {name!r}}}"
    assert any(line in note and "4 values" in note for note in read_trials(made).notes)
    kept = read_trials(made, columns={ours: name})
    assert len(kept.subjects if ours == "subject" else kept.sessions) == 4
    assert not any("keep them apart" in note for note in kept.notes)


def test_a_column_of_another_kind_is_not_taken_for_people() -> None:
    made = one_standard(seed=11)
    rng = np.random.default_rng(1)
    made = made.assign(rt=rng.random(len(made)), level=made["stimulus_2"] // 10, id=made.index)
    assert not any("keep them apart" in note for note in read_trials(made).notes)


def test_the_index_of_a_table_is_read() -> None:
    made = one_standard(seed=12).assign(subject=np.repeat(["a", "b"], 120)).set_index("subject")
    assert read_trials(made).subjects == ["a", "b"]


def test_a_session_named_like_a_range_is_a_session(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    names = ["10-03", "11-03", "3", "4"]
    made = one_standard(40, seed=13).assign(session=np.repeat(names, 10))
    path = tmp_path / "dates.csv"
    made.to_csv(path, index=False)
    for chosen, n in (("10-03,3", 20), ("3-4", 20)):
        assert as_json(capsys, path, "--session", chosen)["data"]["n_trials"] == n
    numbers = made.assign(session=np.repeat([1, 2, 3, 4], 10))
    numbers.to_csv(path, index=False)
    assert as_json(capsys, path, "--session", "2-4")["data"]["n_trials"] == 30


# -- text -----------------------------------------------------------------------------------------

FRENCH = {"stimulus_1": "durée_1", "stimulus_2": "durée_2", "choice": "réponse"}
SAID = {"première": "first", "deuxième": "second"}


def french() -> pd.DataFrame:
    made = one_standard(160, seed=14)
    made["choice"] = made["choice"].map({0: "première", 1: "deuxième"})
    return made.rename(columns={ours: theirs for ours, theirs in FRENCH.items()})


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "cp1252"])
def test_text_of_any_usual_encoding_is_read(
    encoding: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "table.txt"
    path.write_bytes(french().to_csv(index=False, sep="\t").encode(encoding))
    trials = read_trials(path, columns=FRENCH, choice_labels=SAID)
    guessed = [note for note in trials.notes if "Windows-1252" in note]
    assert len(guessed) == (encoding == "cp1252")
    assert trials.frame["count"].tolist() == (french()["réponse"] == "deuxième").tolist()
    if guessed:
        words = [w for pair in FRENCH.items() for w in ("--column", "=".join(pair))]
        words += [w for pair in SAID.items() for w in ("--label", "=".join(pair))]
        assert "--text-encoding mac_roman, say" in command(capsys, path, *words)[1]
        path.write_bytes(french().to_csv(index=False).encode("mac_roman"))
        found = as_json(capsys, path, *words, "--text-encoding", "mac_roman")
        assert found["data"]["n_trials"] == 160
        assert "or write text_encoding='mac_roman', say" in refused(path, columns=FRENCH)


def test_an_unknown_text_encoding_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_text("stimulus_1,stimulus_2,choice\n1,2,1\n", "utf-8")
    assert "'utf-8', 'cp1252' or 'mac_roman'" in refused(path, text_encoding="utf9")
    path.write_bytes(b"stimulus_1,\x81\x8d,choice\n1,2,1\n")
    said = refused(path)
    assert "save it in UTF-8" in said
    assert "as CSV" not in said


def test_true_and_false_of_jspsych_are_answers(tmp_path: Path) -> None:
    made = one_standard(220, seed=15)
    right = (made["stimulus_2"] > 100) == (made["choice"] == 1)
    table = pd.DataFrame({
        "stimulus": '<div style="width:50%">\n<p>dots</p></div>', "n_left": 100,
        "n_right": made["stimulus_2"], "correct": right.map({True: "true", False: "false"}),
        "time_elapsed": 1500 * np.arange(220),
    })  # fmt: skip
    table.to_csv(tmp_path / "jspsych.csv", index=False, quoting=1)
    names = {"stimulus_1": "n_left", "stimulus_2": "n_right"}
    trials = read_trials(tmp_path / "jspsych.csv", columns=names, task="2AFC percent correct")
    assert trials.frame["count"].tolist() == right.tolist()
    labelled = table.assign(correct=right.map({True: "hit", False: "miss"}))
    said = refused(labelled, columns=names)
    assert "choice_labels={'hit': 'correct', 'miss': 'wrong'}" in said
    labels = {"hit": "correct", "miss": "wrong"}
    assert (
        read_trials(labelled, columns=names, choice_labels=labels).frame["count"].tolist()
        == right.tolist()
    )


def test_a_file_without_a_header_is_read_by_places(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    made = one_standard(seed=16)
    columns = {"stimulus_1": "1", "stimulus_2": "2", "choice": "3"}
    for name, text in {
        "t.csv": made.to_csv(index=False, header=False),
        "t.dat": made.to_string(index=False, header=False),
    }.items():
        (tmp_path / name).write_text(text, "utf-8")
        trials = read_trials(tmp_path / name, columns=columns)
        assert len(trials) == len(made)
        assert same_fit(trials, read_trials(made))
        assert any("there is no header" in note for note in trials.notes)
        assert "from '1', '2', '3', by their places" in refused(tmp_path / name)
    words = [w for pair in columns.items() for w in ("--column", "=".join(pair))]
    assert as_json(capsys, tmp_path / "t.csv", *words)["data"]["n_trials"] == 240


def test_a_wide_table_is_refused_in_a_short_sentence(tmp_path: Path) -> None:
    path = tmp_path / "wide.csv"
    header = [f"recorded_column_{i:02d}" for i in range(60)]
    pd.DataFrame([range(60)] * 2, columns=header).to_csv(path, index=False)
    said = refused(path)
    assert len(said) < 600
    assert said.count("recorded_column_00") == 1
    assert "'stimulus_1' or 'stimulus_2', needed for the stimuli, nor 'choice'" in said


def test_messages_name_the_columns_of_the_file() -> None:
    table = pd.DataFrame({"left": [1.0, -2.0], "right": [1.1, 1.2], "said": ["L", "x"]})
    said = refused(
        table, columns={"stimulus_1": "left", "stimulus_2": "right", "choice": "said"},
        choice_labels={"L": "first"},
    )  # fmt: skip
    assert "column 'left', row 2" in said
    assert "column 'said', row 2" in said
    assert "stimulus_1" not in said


# -- other formats --------------------------------------------------------------------------------

EXCEL = {"stimulus_1": "Stimulus1", "stimulus_2": "Stimulus2", "choice": "Answer"}


def test_old_excel_is_read_with_the_extra_or_names_it(monkeypatch: pytest.MonkeyPatch) -> None:
    path = Path(__file__).parents[1] / "data" / "choices.xls"
    with monkeypatch.context() as patched:
        patched.setitem(__import__("sys").modules, "python_calamine", None)
        said = refused(path, columns=EXCEL)
        assert "python-calamine, which is not installed" in said
        assert "pip install 'weberwhisk[tables]'" in said
    pytest.importorskip("python_calamine")
    trials = read_trials(path, columns=EXCEL, choice_labels={1: "first", 2: "second"})
    assert trials.frame["stimulus_2"].tolist() == [12, 8, 10, 10, 14, 6, 10, 9]
    assert trials.frame["count"].tolist() == [1, 0, 0, 0, 1, 0, 1, 1]


def test_open_document_sheets_are_read(tmp_path: Path) -> None:
    pytest.importorskip("python_calamine")
    table = pd.DataFrame({"stimulus_1": [10.0, 10, 10], "stimulus_2": [12.0, 8, 9], "choice": 1})
    rows = [list(table), *table.to_numpy().tolist()]
    cells = "".join(
        "<table:table-row>" + "".join(
            f'<table:table-cell office:value-type="string"><text:p>{c}</text:p></table:table-cell>'
            if isinstance(c, str) else
            f'<table:table-cell office:value-type="float" office:value="{c}"/>' for c in row
        ) + "</table:table-row>" for row in rows
    )  # fmt: skip
    space = "urn:oasis:names:tc:opendocument:xmlns:"
    names = " ".join(f'xmlns:{n}="{space}{n}:1.0"' for n in ("office", "table", "text"))
    content = (
        f'<?xml version="1.0"?><office:document-content {names}><office:body><office:spreadsheet>'
        f'<table:table table:name="Trials">{cells}</table:table>'
        "</office:spreadsheet></office:body></office:document-content>"
    )
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w") as archive:
        archive.writestr("mimetype", "application/vnd.oasis.opendocument.spreadsheet")
        archive.writestr("META-INF/manifest.xml", "<manifest/>")
        archive.writestr("content.xml", content)
    (tmp_path / "calc.ods").write_bytes(made.getvalue())
    assert read_trials(tmp_path / "calc.ods").frame["stimulus_2"].tolist() == [12, 8, 9]


def test_parquet_is_known_whatever_its_name(tmp_path: Path) -> None:
    pytest.importorskip("pyarrow")
    made = one_standard(20, seed=17)
    made.to_parquet(tmp_path / "_ibl_trials.table.pqt")
    assert len(read_trials(tmp_path / "_ibl_trials.table.pqt")) == 20


def matlab_73(path: Path, fields: dict[str, Any]) -> Path:
    """A struct `SessionData` as MATLAB writes it with -v7.3."""
    with h5py.File(path, "w", userblock_size=512) as file:
        group, cells = file.create_group("SessionData"), file.create_group("#refs#")
        group.attrs["MATLAB_class"] = np.bytes_("struct")

        def kept(place: Any, name: str, value: Any) -> Any:
            if isinstance(value, str):
                made = np.array([[ord(c)] for c in value] or [[0, 0]], dtype=np.uint16)
                item = place.create_dataset(name, data=made)
                item.attrs["MATLAB_class"] = np.bytes_("char")
                if not value:
                    item.attrs["MATLAB_empty"] = np.uint8(1)
            elif isinstance(value, list):
                refs = [kept(cells, f"{name}{i}", v).ref for i, v in enumerate(value)]
                data = np.array(refs, dtype=h5py.ref_dtype).reshape(-1, 1)
                item = place.create_dataset(name, data=data)
                item.attrs["MATLAB_class"] = np.bytes_("cell")
            else:
                item = place.create_dataset(name, data=np.atleast_1d(value).reshape(-1, 1))
                item.attrs["MATLAB_class"] = np.bytes_("double")
            return item

        for name, value in fields.items():
            kept(group, name, value)
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64")
    return path


@pytest.mark.parametrize("version", ["7", "7.3"])
def test_sessions_of_bpod_of_either_version(version: str, tmp_path: Path) -> None:
    fields: dict[str, Any] = {
        "nTrials": 6.0,
        "near": np.full(8, 20.0),  # made before the session, which was shorter
        "far": np.array([22.0, 18, 23, 17, 24, 16]),
        "Reply": np.array([2.0, 1, 2, 1, 2]),  # the last trial has no answer
        "Word": ["right", "left", "right", "left", "", "left"],
    }
    path = tmp_path / "session.mat"
    if version == "7.3":
        matlab_73(path, fields)
    else:
        cells = np.empty(6, dtype=object)
        cells[:] = fields["Word"]
        savemat(path, {"SessionData": fields | {"Word": cells}})
    columns = {"stimulus_1": "near", "stimulus_2": "far", "choice": "Reply"}
    trials = read_trials(path, columns=columns, choice_labels={1: "first", 2: "second"})
    assert trials.frame["stimulus_2"].tolist() == [22, 18, 23, 17, 24, 16]
    assert trials.frame["count"].tolist()[:5] == [1, 0, 1, 0, 1]
    assert trials.n_missing == 1
    assert any("Reply has 5" in note for note in trials.notes)
    sides = {"left": "first", "right": "second"}
    words = read_trials(path, columns=columns | {"choice": "Word"}, choice_labels=sides)
    assert words.frame["count"].tolist()[:4] == [1, 0, 1, 0]
    assert words.n_missing == 1


def test_vectors_and_structs_of_matlab_are_tables(tmp_path: Path) -> None:
    made = one_standard(30, seed=18)
    vectors = {name: made[name].to_numpy(float) for name in made}
    savemat(tmp_path / "a.mat", vectors | {"settings": np.arange(3.0)})
    records = np.array(
        [tuple(row) for row in made.to_numpy()], dtype=[(name, "O") for name in made]
    )
    savemat(tmp_path / "b.mat", {"trials": records})
    for name in ("a.mat", "b.mat"):
        assert read_trials(tmp_path / name).frame["count"].tolist() == made["choice"].tolist()
    savemat(tmp_path / "c.mat", {"note": "nothing"})
    assert "as CSV, with writetable" in refused(tmp_path / "c.mat")


def test_no_text_is_told_to_be_saved_as_csv(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    for made in (b'a,b\n1,"2\n3,4\n', b"stimulus_1,x\n1,2,3\n", b"\x81\x8d\n", b"\n\n"):
        path.write_bytes(made)
        assert "as CSV" not in refused(path)


# -- criteria and points of equality far away -----------------------------------------------------


def held_or_said(table: pd.DataFrame, task: str, k: float) -> bool:
    """Whether the 95 % interval holds k, or the status says that something else decides."""
    fit = fit_weber(read_trials(table, task=task))
    low, high = fit.interval(0.95)
    return low <= k <= high or fit.status.name != "DETERMINED"


@pytest.mark.parametrize("boundary", slow_but([13.0, 14.0, 15.0], (2,)))
def test_a_criterion_of_several_sds_does_not_move_k_in_silence(boundary: float) -> None:
    """Under a standard normal belief intervals held k = 0.08 in 10, 2 and 0 of 20, DETERMINED."""
    shown, n = np.array([10, 12, 14, 16, 18, 20.0]), np.array([200, 40, 40, 40, 40, 40])
    p = 0.01 + 0.98 * ndtr((shown - boundary) / (0.08 * shown))
    well = 0
    for seed in range(100, 110):
        count = np.random.default_rng(seed).binomial(n, p)
        table = pd.DataFrame({"standard": 10.0, "comparison": shown, "n": n, "n_greater": count})
        well += held_or_said(table, "go/no-go", 0.08)
    assert well >= 9


def test_equality_far_off_does_not_move_a_small_k_in_silence() -> None:
    """20 % off at k = 0.03 is a bias of 4 sds: under the belief before 1 of 12 was held."""
    shown, k = np.linspace(1.05, 1.35, 9), 0.03
    bias = -0.2 / (k * np.hypot(1, 1.2))
    p = 0.02 + 0.96 * ndtr((shown - 1) / (k * np.hypot(1, shown)) + bias)
    well = 0
    for seed in range(12):
        count = np.random.default_rng(seed).binomial(20, p)
        table = pd.DataFrame({"standard": 1.0, "comparison": shown, "n": 20, "n_greater": count})
        well += held_or_said(table, "2AFC", k)
    assert well >= 11
