"""Tables of trials and of contacts from files of any format, as they stand.

The first bytes of a file say its format, whatever its name ends with.
"""

from __future__ import annotations

import bz2
import csv
import errno
import gzip
import io
import lzma
import zipfile
from collections.abc import Collection
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import pandas as pd

from .._util import checks
from .._util.refusals import Refusal, argument
from .matlab import UnreadMatlab, matlab_table

__all__ = ["Table", "as_number", "load_table"]


@dataclass(frozen=True)
class Table:
    """A table as it stands in a file; the index of `frame` counts its rows from 1.

    `name` is that of the file, for messages, `notes` say what had to be guessed to read it, and
    `guessed_encoding` is the encoding of its text where it is not known to be that.
    """

    frame: pd.DataFrame
    name: str
    notes: tuple[str, ...] = ()
    guessed_encoding: str | None = None


@dataclass(frozen=True)
class _Format:
    """A binary format: its name, the package that reads it, and the extra that installs it."""

    name: str
    package: str
    extra: str = "tables"


PARQUET = _Format("Parquet", "pyarrow")
EXCEL = _Format("Excel", "openpyxl")
OLD_EXCEL = _Format("Excel", "python-calamine")
OPEN_DOCUMENT = _Format("OpenDocument", "python-calamine")
NWB = _Format("NWB", "pynwb", "nwb")
MATLAB = _Format("MATLAB", "scipy")
#: What names end with where the first bytes do not say the format.
SUFFIXES = {
    ".parquet": PARQUET, ".pqt": PARQUET, ".xlsx": EXCEL, ".xlsm": EXCEL, ".ods": OPEN_DOCUMENT,
    ".nwb": NWB, ".mat": MATLAB,
}  # fmt: skip


def load_table(
    source: str | Path | pd.DataFrame,
    row: str = "trial",
    *,
    names: Collection[str] = (),
    text_encoding: str | None = None,
) -> Table:
    """The table as it stands.

    Parquet, Excel and OpenDocument (the first sheet with cells), NWB (`trials`) and MATLAB (Bpod's
    `SessionData`, or vectors of one length) are known by their first bytes; anything else is text,
    plain or compressed, in UTF-8, UTF-16 or else Windows-1252, with the separator (comma, tab,
    semicolon, or else spaces) that is most frequent in its header. Cells of text files stay text,
    with decimal commas replaced by points. Empty rows are dropped but counted: the index is the row
    of the file, and the first row below the header is 1. A first row that holds a number, and none
    of the `names` that are looked for, is no header; columns are then called 1, 2, 3, … `row` says
    what one row is, for messages.
    """
    if isinstance(source, pd.DataFrame):
        return Table(_numbered(source), "table")
    if not isinstance(source, str | Path):
        raise Refusal(
            "source must be a path or a DataFrame",
            checks.shown(source),
            f"give a table of {row}s, or its file",
        )
    path = Path(source)
    if not path.is_file():
        sentence = f"there is no such file; give the path of a table of {row}s"
        raise FileNotFoundError(errno.ENOENT, sentence, str(path))
    kind = _format_of(path)
    if kind is None:
        return _text_table(path, row, frozenset(names), text_encoding)
    notes: list[str] = []
    try:
        raw = _binary_table(path, kind, names, notes)
    except ImportError:
        raise Refusal(
            f"{path.name}: {kind.name} is read by {kind.package}, which is not installed",
            remedy=f"run pip install 'weberwhisk[{kind.extra}]', or save the table as CSV",
        ) from None
    except UnreadMatlab as error:
        raise Refusal(f"{path.name}: {error}", remedy=error.remedy) from None
    # Libraries of these formats raise any kind of exception for a broken file.
    except Exception as error:
        raise Refusal(
            f"{path.name}: not readable as a table of {kind.name} ({_reason(error)})",
            remedy="save it as CSV",
        ) from None
    return Table(_numbered(raw), path.name, tuple(notes))


def as_number(text: object) -> str:
    """Advice for a cell that is not a number, or has a decimal comma.

    Examples
    --------
    >>> as_number("0,5")
    'write 0.5, or give pandas.read_csv(file, sep=";", decimal=",")'
    """
    point = str(text).strip().replace(",", ".", 1)
    if not _is_number(point):
        return "write digits alone, with a point for decimals"
    return f'write {point}, or give pandas.read_csv(file, sep=";", decimal=",")'


def _is_number(text: object) -> bool:
    try:
        return float(str(text)) == float(str(text))  # the name of a column may be nan
    except ValueError:
        return False


def _numbered(raw: pd.DataFrame) -> pd.DataFrame:
    labels = [name for name in raw.index.names if name is not None and name not in raw]
    if labels:  # subjects and sessions are often the index of a table
        raw = raw.reset_index(labels)
    if not raw.columns.is_unique:
        _refuse_twice(raw.columns[raw.columns.duplicated()][0])
    table = raw.set_axis(pd.RangeIndex(1, len(raw) + 1), axis=0)
    return table[table.notna().any(axis=1)] if table.shape[1] else table


def _refuse_twice(column: object) -> None:
    raise Refusal(f"there are two columns {str(column)!r}", remedy="give each its own name")


def _reason(error: Exception) -> str:
    """The last words of a library's error, unless they quote the file's bytes."""
    reason = " ".join(str(error).split()).rstrip(".").split(". ")[-1]
    return reason if reason.isprintable() and 0 < len(reason) <= 200 else type(error).__name__


# -- binary formats -------------------------------------------------------------------------------


def _format_of(path: Path) -> _Format | None:
    """The binary format of a file; None for text."""
    suffix = path.suffix.lower()
    with path.open("rb") as file:
        first = file.read(1024)
    if first.startswith(b"PAR1"):
        return PARQUET
    if first.startswith(b"\xd0\xcf\x11\xe0"):
        return OLD_EXCEL
    if first.startswith(b"MATLAB ") or (first.startswith(b"\x89HDF") and suffix == ".mat"):
        return MATLAB
    if first.startswith(b"\x89HDF"):
        return NWB
    if first.startswith(b"PK\x03\x04") and zipfile.is_zipfile(path):
        members = zipfile.ZipFile(path).namelist()
        if any(member.startswith("xl/") for member in members):
            return EXCEL
        return OPEN_DOCUMENT if "content.xml" in members else None
    return SUFFIXES.get(suffix)


def _binary_table(
    path: Path, kind: _Format, names: Collection[str], notes: list[str]
) -> pd.DataFrame:
    if kind is PARQUET:
        return pd.read_parquet(path)
    if kind is NWB:
        return _nwb_trials(path)
    if kind is MATLAB:
        return matlab_table(path, names, notes)
    return _sheet(path, kind, names, notes)


def _sheet(path: Path, kind: _Format, names: Collection[str], notes: list[str]) -> pd.DataFrame:
    engine: Any = "openpyxl" if kind is EXCEL else "calamine"
    with pd.ExcelFile(path, engine=engine) as book:
        tables = {name: pd.read_excel(book, sheet_name=name) for name in book.sheet_names}
        full = [name for name, table in tables.items() if table.shape[1]] or [*tables]
        if len(full) > 1:
            others = checks.listed(map(str, full[1:]), 4)
            notes.append(
                f"The sheet {full[0]!r} was read, the first of {len(full)}; save another "
                f"({others}) as a file of its own."
            )
        header = [*tables[full[0]].columns]
        if not _is_header(header, names):
            notes.append(_no_header(header))
            table = pd.read_excel(book, sheet_name=full[0], header=None)
            return table.set_axis([str(i + 1) for i in range(table.shape[1])], axis=1)
    return tables[full[0]].rename(columns=str)


def _nwb_trials(path: Path) -> pd.DataFrame:
    """The `trials` of a Neurodata Without Borders file: columns with one value per trial."""
    import warnings

    from pynwb import NWBHDF5IO

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # remarks on how the file was written
        with NWBHDF5IO(str(path), "r", load_namespaces=True) as file:
            trials = file.read().trials
            if trials is None:
                raise Refusal("the NWB file has no trials")
            table = trials.to_dataframe().reset_index(drop=True)
    return table.drop(columns=[c for c in table if table[c].map(pd.api.types.is_list_like).any()])


# -- text -----------------------------------------------------------------------------------------


def _text_table(path: Path, row: str, names: frozenset[str], text_encoding: str | None) -> Table:
    text, guessed = _decoded(path, row, text_encoding)
    lines = text.splitlines()
    blank = next((i for i, line in enumerate(lines) if line.strip()), None)
    if blank is None:
        raise Refusal(
            f"{path.name}: the file is empty", remedy=f"give a header and one row per {row}"
        )
    given, separator = lines[blank].strip(), _separator(lines[blank:])
    if given.lower().startswith("sep=") and len(given) == 5:  # as Excel writes it
        blank, separator = blank + 1, given[4]
    notes: list[str] = []
    if separator is None:
        cells = lines[blank].split()
    else:
        cells = next(csv.reader(io.StringIO("\n".join(lines[blank:])), delimiter=separator))
    cells = [cell.strip() for cell in cells]
    has_header = _is_header(cells, names)
    if has_header:
        twice = [cell for cell in cells if cells.count(cell) > 1 and cell in names]
        if twice:
            _refuse_twice(twice[0])
    else:
        notes.append(_no_header(cells))
    try:
        raw = pd.read_csv(
            io.StringIO(text), sep=r"\s+" if separator is None else separator, dtype=str,
            skipinitialspace=True, skip_blank_lines=False, skiprows=blank,
            header="infer" if has_header else None,
        )  # fmt: skip
    except pd.errors.ParserError as error:
        raise Refusal(
            f"{path.name}: not readable as a table ({_reason(error)})", remedy="mend that row"
        ) from None
    if not has_header:
        raw = raw.set_axis([str(i + 1) for i in range(raw.shape[1])], axis=1)
    if not isinstance(raw.index, pd.RangeIndex):
        raise Refusal(
            f"{path.name}: rows have more cells than the header has names",
            remedy="name every column",
        )
    raw = raw.apply(_with_points, always=separator == ";")
    return Table(_numbered(raw), path.name, tuple(notes), guessed)


def _decoded(path: Path, row: str, text_encoding: str | None) -> tuple[str, str | None]:
    """The text of a file, plain or compressed, and its encoding where that was guessed."""
    data = _plain_bytes(path)
    if text_encoding is not None:
        try:
            return data.decode(text_encoding).removeprefix("\ufeff"), None
        except (LookupError, UnicodeDecodeError) as error:
            raise Refusal(
                f"{path.name}: text_encoding {text_encoding!r} does not read it ({error})",
                remedy="write 'utf-8', 'cp1252' or 'mac_roman', say",
            ) from None
    first, marks = data[:4096], (b"\xff\xfe", b"\xfe\xff")
    encoding = "utf-8-sig"
    if first.startswith(marks):
        encoding = "utf-16"
    elif b"\0" in first:  # UTF-16 without its mark: letters of Europe have one byte of zero
        encoding = "utf-16-be" if first[:1] == b"\0" else "utf-16-le"
    for tried, guessed in ((encoding, None), ("cp1252", "Windows-1252")):
        try:
            text = data.decode(tried)
        except UnicodeDecodeError:
            continue
        if "\0" not in text:
            return text, guessed
    named = ", or write " + argument("text_encoding", "mac_roman") + ", say"
    raise Refusal(
        f"{path.name}: not readable as text in UTF-8, UTF-16 or Windows-1252",
        remedy="save it in UTF-8 (in Excel, CSV UTF-8)" + (named if row == "trial" else ""),
    )


def _plain_bytes(path: Path) -> bytes:
    """The bytes of a file, taken out of the archive where it is one."""
    data = path.read_bytes()
    try:
        if data.startswith(b"\x1f\x8b"):
            return gzip.decompress(data)
        if data.startswith(b"BZh"):
            return bz2.decompress(data)
        if data.startswith(b"\xfd7zXZ"):
            return lzma.decompress(data)
        if data.startswith(b"PK\x03\x04"):
            with zipfile.ZipFile(io.BytesIO(data)) as archive:
                (member,) = (name for name in archive.namelist() if not name.endswith("/"))
                return archive.read(member)
        if data.startswith(b"\x28\xb5\x2f\xfd"):
            reader = import_module("zstandard").ZstdDecompressor().stream_reader(data)
            return bytes(reader.read())
    except Exception as error:  # whatever these make of a damaged archive
        raise Refusal(
            f"{path.name}: not readable as an archive of one table ({_reason(error)})",
            remedy="unpack it and give the table",
        ) from None
    return data


def _separator(lines: list[str]) -> str | None:
    """What separates cells, by the header; None for spaces."""
    found = max(",\t;", key=lines[0].count)
    if found in lines[0]:
        return found
    widths = {len(line.split()) for line in lines[:20] if line.strip()}
    return None if len(widths) == 1 and widths != {1} else ","


def _is_header(cells: Collection[object], names: Collection[str]) -> bool:
    """Whether the first row has names: one that is looked for, or no numbers."""
    texts = [str(cell) for cell in cells]
    if texts == [str(i + 1) for i in range(len(texts))]:
        return True
    words = {name for name in names if not _is_number(name)}  # a place may be named, too
    return not words.isdisjoint(texts) or not any(map(_is_number, cells))


def _no_header(cells: Collection[object]) -> str:
    number = next(cell for cell in cells if _is_number(cell))
    return (
        f"The first row holds the number {number}, so that there is no header: the columns are "
        f"called 1 to {len(cells)} (map a name that is in that row, were it the header)."
    )


def _with_points(cells: pd.Series, always: bool) -> pd.Series:
    """The column with decimal commas replaced by points, unless it has decimal points.

    In a file separated by semicolons (`always`) every comma is decimal. Otherwise a column in
    which three digits follow every comma may hold thousands, and is left as it is.
    """
    text = cells.dropna().astype(str).str.strip()
    if not text.str.contains(",", regex=False).any():
        return cells
    comma = text[text.str.fullmatch(r"[+-]?\d*,\d+([eE][+-]?\d+)?")]
    thousands = comma.str.fullmatch(r"[+-]?[1-9]\d{0,2},\d{3}").all() and not always
    if text.str.fullmatch(r"[+-]?\d*\.\d+([eE][+-]?\d+)?").any() or thousands:
        return cells
    return cells.where(~cells.index.isin(comma.index), comma.str.replace(",", "."))
