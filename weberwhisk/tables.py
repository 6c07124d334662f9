"""Tables of trials and of contacts as they stand in a file."""

from __future__ import annotations

import errno
import gzip
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from . import _checks


def load_table(source: str | Path | pd.DataFrame, row: str = "trial") -> tuple[pd.DataFrame, str]:
    """The table as it stands, and its name for messages; its index counts rows from 1.

    By the suffix: Parquet (.parquet), Excel (.xlsx, .xls: its first sheet), NWB (.nwb: its
    `trials`), Bpod's session (.mat: the numbers of each trial in its `SessionData`), and everything
    else as text, plain or compressed, separated by commas, tabs or semicolons, whichever its header
    has most of; text gives text in every cell. Rows without any entry are left out and counted, so
    the index is that of the file: the first row below the header is 1. `row` is what one row is,
    for messages.
    """
    if isinstance(source, pd.DataFrame):
        return _numbered(source), "table"
    if not isinstance(source, str | Path):
        raise ValueError(
            f"source must be a path or a DataFrame, got {_checks.shown(source)}; give a table of "
            f"{row}s, or its file."
        )
    path = Path(source)
    if not path.is_file():
        sentence = f"there is no such file; give the path of a table of {row}s"
        raise FileNotFoundError(errno.ENOENT, sentence, str(path))
    try:
        raw = _read(path)
    except ImportError as error:
        extra = "nwb" if path.suffix == ".nwb" else "tables"
        raise ValueError(
            f"{path.name}: reading {path.suffix} needs the package {error.name or 'missing here'}; "
            f"run pip install 'weberwhisk[{extra}]', or save the table as CSV."
        ) from None
    except pd.errors.EmptyDataError:
        raise ValueError(
            f"{path.name}: the file is empty; give a header and one row per {row}."
        ) from None
    # The readers of all these formats raise whatever their libraries do at a broken file.
    except Exception as error:
        reason = " ".join(str(error).split()).rstrip(".").split(". ")[-1]
        if not reason.isprintable() or not 0 < len(reason) <= 200:  # some quote the file's bytes
            reason = type(error).__name__
        raise ValueError(
            f"{path.name}: not readable as a table ({reason}); save it as CSV."
        ) from None
    if not isinstance(raw.index, pd.RangeIndex):
        raise ValueError(
            f"{path.name}: rows have more cells than the header has names; name every column."
        )
    return _numbered(raw), path.name


def as_number(text: object) -> str:
    """What to write instead of a cell that is no number, where a comma stands for the point too.

    Examples
    --------
    >>> as_number("0,5")
    'write 0.5, or give pandas.read_csv(file, sep=";", decimal=",")'
    """
    point = str(text).strip().replace(",", ".", 1)
    try:
        float(point)
    except ValueError:
        return "write digits alone, with a point for decimals"
    return f'write {point}, or give pandas.read_csv(file, sep=";", decimal=",")'


def _numbered(raw: pd.DataFrame) -> pd.DataFrame:
    if not raw.columns.is_unique:
        twice = raw.columns[raw.columns.duplicated()][0]
        raise ValueError(f"there are two columns {str(twice)!r}; give each its own name.")
    table = raw.set_axis(pd.RangeIndex(1, len(raw) + 1), axis=0)
    return table[table.notna().any(axis=1)] if table.shape[1] else table


def _read(path: Path) -> pd.DataFrame:
    if path.suffix == ".parquet":
        return pd.read_parquet(path).reset_index(drop=True)
    if path.suffix in (".xlsx", ".xls", ".xlsm", ".ods"):
        return pd.read_excel(path)
    if path.suffix == ".nwb":
        return _nwb_trials(path)
    if path.suffix == ".mat":
        return _bpod_trials(path)
    separator, blank = _layout(path)
    return pd.read_csv(
        path, sep=separator, dtype=str, skipinitialspace=True, skip_blank_lines=False,
        skiprows=blank, encoding="utf-8-sig",
    )  # fmt: skip


def _layout(path: Path) -> tuple[str, int]:
    """The separator of a text table, and the blank lines above its header."""
    if path.suffix in (".bz2", ".xz", ".zip", ".zst"):  # pandas opens them, we do not look inside
        return ("\t" if {".tsv", ".tab"} & set(path.suffixes) else ","), 0
    opened: Any = gzip.open if path.suffix == ".gz" else open
    with opened(path, "rt", encoding="utf-8-sig") as lines:
        for blank, line in enumerate(lines):
            if line.strip():
                return max(",\t;", key=line.count), blank
    raise pd.errors.EmptyDataError


def _nwb_trials(path: Path) -> pd.DataFrame:
    """The `trials` of a Neurodata Without Borders file, columns that hold one value a trial."""
    import warnings

    from pynwb import NWBHDF5IO

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # remarks on how the file was written
        with NWBHDF5IO(str(path), "r", load_namespaces=True) as file:
            trials = file.read().trials
            if trials is None:
                raise ValueError("the NWB file has no trials")
            table = trials.to_dataframe().reset_index(drop=True)
    return table.drop(columns=[c for c in table if table[c].map(_holds_many).any()])


def _bpod_trials(path: Path) -> pd.DataFrame:
    """The fields of Bpod's `SessionData` that hold a number a trial, of the trials that ran."""
    from scipy.io import loadmat

    found = loadmat(path, simplify_cells=True)
    if "SessionData" not in found or "nTrials" not in found["SessionData"]:
        raise ValueError("it has no SessionData of Bpod")
    count = int(found["SessionData"].pop("nTrials"))
    fields = {name: np.atleast_1d(v) for name, v in found["SessionData"].items()}
    table = {
        name: v[:count]  # lists made before the session may be longer than it was
        for name, v in fields.items()
        if v.ndim == 1 and v.size >= count and v.dtype.kind in "fiub"
    }
    # MATLAB's numbers are floats, subject 1 too.
    whole = {name for name, v in table.items() if np.all(v == np.floor(v))}
    return pd.DataFrame({n: v.astype(int) if n in whole else v for n, v in table.items()})


def _holds_many(value: Any) -> bool:
    return hasattr(value, "__len__") and not isinstance(value, str)
