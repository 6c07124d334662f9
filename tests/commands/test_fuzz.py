"""Any file of trials and any command line: an answer or one sentence, never a traceback or a hang.

Every run has a deadline of its own. The pieces are valid ones, near misses and rubbish, put
together at random; `pytest -m slow` tries twenty times as many.
"""

from __future__ import annotations

import faulthandler
import gzip
import json
from collections.abc import Iterator
from contextlib import chdir, contextmanager, redirect_stderr, redirect_stdout
from importlib.util import find_spec
from io import BytesIO, StringIO, TextIOWrapper
from pathlib import Path
from tempfile import TemporaryDirectory

import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from weberwhisk import cli
from weberwhisk.behaviour import read_trials
from weberwhisk.cli import run_app

#: Formats that need the extra `tables`.
EXTRAS = [
    suffix
    for suffix, package in ((".xlsx", "openpyxl"), (".parquet", "pyarrow"))
    if find_spec(package)
]
#: Seconds after which a run counts as hung; the slowest honest one takes a twentieth.
DEADLINE = 120


@contextmanager
def deadline() -> Iterator[None]:
    """End the whole test run, with every stack, where a command never ends."""
    faulthandler.dump_traceback_later(DEADLINE, exit=True)
    try:
        yield
    finally:
        faulthandler.cancel_dump_traceback_later()


def run(arguments: list[str]) -> tuple[int, str, str]:
    """Exit status and what a command prints; an error that is no refusal comes through."""
    out, err = TextIOWrapper(BytesIO(), "utf-8"), StringIO()
    with deadline(), redirect_stdout(out), redirect_stderr(err):
        status = run_app(cli.app, arguments)
    out.flush()
    return status, out.buffer.getvalue().decode("utf-8"), err.getvalue()  # type: ignore[attr-defined]


def refused(err: str) -> None:
    """One line, of this program."""
    assert err.startswith("weberwhisk: ")
    assert err.count("\n") == 1


def check(arguments: list[str], folder: Path) -> None:
    """An answer, whole, or a refusal in one line that leaves nothing behind."""
    before = {path.name for path in folder.iterdir()}
    with chdir(folder):  # quickstart writes where it stands
        status, out, err = run(arguments)
    assert status in (0, 2), (status, err)
    if status == 2:
        assert out == ""
        refused(err)
        assert len(err) < 2000
        assert {path.name for path in folder.iterdir()} == before
        return
    assert err == ""
    assert "nan" not in out.lower().replace("nanmean", "")
    if "--json" in arguments and "--help" not in arguments and "--version" not in arguments:
        json.loads(out, parse_constant=pytest.fail)


# -- files of trials -----------------------------------------------------------------------------

NAMES = st.sampled_from(
    ["stimulus_1", "stimulus_2", "standard", "comparison", "log_ratio", "choice", "correct", "n",
     "n_greater", "n_correct", "subject", "session", "trial", "Choice", "stimulus_2_mm", "x", ""]
)  # fmt: skip
CELLS = st.one_of(
    st.sampled_from(["0", "1", "1.0", "2", "10", "3.5", "1e3", "-1", "0.999"]),
    st.sampled_from(
        ["", " ", "nan", "NaN", "inf", "-inf", "1e400", "1e-400", "1e308", "5e-324", "True", "L",
         "left", "1,5", '"', "'", "ß", "\x00", "=1+1", "1_000", "0x10", "١", "--", "NA", "None"]
    ),
    st.floats().map(str),
    st.integers(-(10**20), 10**20).map(str),
    st.text(max_size=4),
)  # fmt: skip
#: Tables that are almost right, so that the fuzz gets past the header.
HEADERS = st.sampled_from(
    [["stimulus_1", "stimulus_2", "choice"], ["standard", "comparison", "n", "n_greater"],
     ["log_ratio", "correct"], ["stimulus_1", "stimulus_2", "correct", "session", "subject"],
     ["standard", "comparison", "choice", "subject", "trial"]]
)  # fmt: skip
GOOD = st.sampled_from(["0", "1", "2", "1.0", "0.5"])


@st.composite
def tables(draw: st.DrawFn) -> bytes:
    """The bytes of a table, good, broken, or of something else."""
    header = draw(st.one_of(HEADERS, HEADERS, st.lists(NAMES, max_size=6)))
    rubbish = draw(st.sampled_from([0.0, 0.0, 0.1, 1.0]))
    width = len(header) + draw(st.sampled_from([0, 0, 0, 0, 1, -1]))
    separator = draw(st.sampled_from([",", ",", ",", "\t", ";", "|", "\n"]))
    rows = []
    for _ in range(draw(st.integers(0, 12))):
        bad = draw(st.floats(0, 1)) < rubbish
        cells = [draw(CELLS if bad else GOOD) for _ in range(max(width, 0))]
        rows.append(separator.join(cells))
    blank = draw(st.sampled_from(["", "", "", "\n", "\ufeff"]))
    end = draw(st.sampled_from(["\n", "\r\n", "\r"]))
    text = blank + end.join([separator.join(header), *rows])
    encoded = text.encode(draw(st.sampled_from(["utf-8", "utf-8", "utf-16", "latin-1"])), "replace")
    cut = draw(st.integers(0, 30))
    return encoded[cut:] if cut > 25 else encoded


SUFFIXES = st.sampled_from([".csv", ".csv", ".csv", ".tsv", ".txt", ".csv.gz", ".xlsx", ".parquet",
                            ".zip", ".nwb", ".xz", "", ".CSV"])  # fmt: skip
FILES = st.one_of(tables(), tables(), tables(), st.binary(max_size=200))


@settings(max_examples=2 * settings.default.max_examples)
@given(FILES, SUFFIXES, st.sampled_from([None, "2AFC", "yes/no", "3AFC percent correct"]),
       st.sampled_from(["linear", "log"]))  # fmt: skip
def test_any_file_is_read_or_refused(content: bytes, suffix: str, task: str, scale: str) -> None:
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"trials{suffix}"
        path.write_bytes(content)
        with deadline():
            try:
                trials = read_trials(path, task=task, scale=scale)
            except ValueError as refusal:
                if refused_by_us(refusal):
                    return
                raise
        assert len(trials) > 0
        assert trials.n_trials + trials.n_missing == trials.frame["n"].sum()
        trials.cells()


@st.composite
def damaged(draw: st.DrawFn) -> tuple[str, bytes]:
    """A sound file of some format, cut short or with a few bytes changed; and its suffix."""
    table = pd.read_csv(StringIO(TRIALS))
    suffix = draw(st.sampled_from([".csv", ".csv.gz", ".csv.bz2", ".csv.xz", ".csv.zip", *EXTRAS]))
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"trials{suffix}"
        writer = {".xlsx": table.to_excel, ".parquet": table.to_parquet}.get(suffix, table.to_csv)
        writer(path, index=False)
        content = bytearray(path.read_bytes())
    if draw(st.booleans()):
        content = content[: draw(st.integers(0, len(content)))]
    for at in draw(st.lists(st.integers(0, max(len(content) - 1, 0)), max_size=4)):
        content[at : at + 1] = draw(st.binary(max_size=2))
    return suffix, bytes(content)


@settings(max_examples=4 * settings.default.max_examples)
@given(damaged())
def test_a_damaged_file_is_read_or_refused(file: tuple[str, bytes]) -> None:
    suffix, content = file
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"trials{suffix}"
        path.write_bytes(content)
        with deadline():
            try:
                assert len(read_trials(path)) > 0
            except ValueError as refusal:
                if not refused_by_us(refusal):
                    raise


@pytest.mark.parametrize("suffix", [".zip", ".xz", ".bz2", ".gz", ".zst", ".xlsx", ".parquet"])
@pytest.mark.parametrize("content", [b"", b"?\n\n", b"PK\x03\x04", b"\x1f\x8b\x08"])
def test_a_file_of_another_format_is_refused(tmp_path: Path, suffix: str, content: bytes) -> None:
    """A broken zip file ended in a traceback."""
    path = tmp_path / f"trials{suffix}"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=r"trials\.\w+: "):
        read_trials(path)


@pytest.mark.parametrize("at", [12, 20, 40, 60])
def test_a_corrupt_archive_is_one_sentence_of_the_command(tmp_path: Path, at: int) -> None:
    """With a whisker the header is read first, and zlib's own error came through."""
    content = bytearray(gzip.compress(TRIALS.encode()))
    content[at : at + 4] = b"\xff" * 4
    path = tmp_path / "trials.csv.gz"
    path.write_bytes(content)
    status, _, err = run(["fit", str(path), "--identity", "C2", "--cue", "compliance"])
    assert status == 2
    refused(err)


def refused_by_us(error: BaseException) -> bool:
    """Raised in this package and in words."""
    trace = error.__traceback__
    assert trace is not None
    while trace.tb_next is not None:
        trace = trace.tb_next
    ours = "weberwhisk" in trace.tb_frame.f_code.co_filename
    return ours and str(error).endswith(".") and str(error).replace("\n", "").isprintable()


# -- command lines -------------------------------------------------------------------------------

NUMBERS = st.one_of(
    st.sampled_from(["1", "0.1", "20", "5", "10,20", "50", "100", "0"]),
    st.sampled_from(["-1", "nan", "inf", "-inf", "1e400", "1e-300", "1e300", "", ",", "x", "1,,2",
                     "1e5", "١", "0x1", "--", "1 2", "9" * 400]),
    st.floats().map(str),
)  # fmt: skip
WORDS = st.one_of(
    st.sampled_from(["C2", "A0", "Q7", "compliance", "force-map", "two-whiskers", "quadrature",
                     "emcee", "laplace", "closed_form", "elastica", "profile", "rod", "d'=1",
                     "75% 2AFC", "50% 2AFC", "2AFC", "yes/no", "log", "linear", "drift", "noise",
                     "shared", "per standard", "none", "vibrissa-length", "balance-of-moments"]),
    st.text(max_size=5),
)  # fmt: skip
WHISKERS = st.sampled_from(
    [["--identity", "C2"], ["--identity", "A0"],
     ["--length-mm", "50", "--base-radius-um", "100", "--tip-radius-um", "5"],
     ["--length-mm", "50", "--base-radius-um", "100", "--tip-radius-um", "0"],
     ["--length-mm", "50", "--base-radius-um", "100", "--tip-radius-um", "100"], []]
)  # fmt: skip
#: Options that take numbers and words, by command; a run that would be long by intent is left out.
NUMERIC = {
    "bend": ["--radial-distance-mm", "--deflection-angle-deg", "--arc-length-mm",
             "--force-micronewton", "--length-mm", "--base-radius-um", "--tip-radius-um",
             "--youngs-modulus-gpa", "--seed"],
    "jnd": ["--radial-distance-mm", "--deflection-angle-deg", "--weber-fraction", "--seed",
            "--tip-radius-um"],
    "simulate": ["--standard", "--standard-mm", "--offset", "--weber-fraction", "--lapse-low",
                 "--lapse-high", "--bias", "--missing", "--spread", "--seed"],
    "fit": ["--log-unit", "--lapse-prior", "--session", "--seed", "--deflection-angle-deg"],
}  # fmt: skip
WORDED = {
    "bend": ["--identity", "--model"],
    "jnd": ["--identity", "--cue", "--method", "--criterion"],
    "simulate": ["--identity", "--cue", "--task"],
    "fit": ["--cue", "--task", "--scale", "--bias", "--noise", "--effect", "--column",
            "--label", "--subject", "--method"],
}  # fmt: skip
USUAL = {
    "bend": ["--radial-distance-mm", "20", "--deflection-angle-deg", "10"],
    "jnd": ["--draws", "2", "--radial-distance-mm", "20"],
    "simulate": ["--trials-per-level", "2"],
    "fit": ["trials.csv"],
}
TRIALS = "session,trial,standard,stimulus_1,stimulus_2,choice\n" + "".join(
    f"{1 + i // 12},{i % 12 + 1},10,10,{level},{int((level > 10) != (i % 7 == 0))}\n"
    for i, level in enumerate([7, 8, 9, 9.5, 10.5, 11, 12, 14] * 3)
)


@st.composite
def command_lines(draw: st.DrawFn) -> list[str]:
    """A command with options that fit it more or less."""
    command = draw(st.sampled_from(sorted(USUAL)))
    words = [command, *draw(WHISKERS)]
    if draw(st.integers(0, 9)):
        words += USUAL[command]
    for _ in range(draw(st.integers(0, 3))):
        name = draw(st.sampled_from(NUMERIC[command] + WORDED[command]))
        words += [name, draw(NUMBERS if name in NUMERIC[command] else WORDS)]
    if draw(st.booleans()):
        words.append("--json")
    if draw(st.booleans()):
        words += ["--out", draw(st.sampled_from(["out", "deep/er", "trials.csv", "", "."]))]
    if not draw(st.integers(0, 19)):
        words.insert(draw(st.integers(0, len(words))), draw(st.one_of(WORDS, NUMBERS)))
    return words


@settings(max_examples=2 * settings.default.max_examples)
@given(command_lines())
def test_any_command_line_is_answered_or_refused(arguments: list[str]) -> None:
    with TemporaryDirectory() as folder:
        (Path(folder) / "trials.csv").write_text(TRIALS, "utf-8")
        check(arguments, Path(folder))


@given(tables(), st.sampled_from([[], ["--task", "yes/no"], ["--scale", "log"], ["--together"]]))
def test_any_table_is_fitted_or_refused(content: bytes, options: list[str]) -> None:
    with TemporaryDirectory() as folder:
        (Path(folder) / "trials.csv").write_bytes(content)
        check(["fit", "trials.csv", *options, "--json"], Path(folder))
