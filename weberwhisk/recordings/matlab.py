"""Tables in MATLAB's files, of version 7 and before (by SciPy) and of version 7.3 (HDF5)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from .._util.values import counted

__all__ = ["UnreadMatlab", "matlab_table"]


class UnreadMatlab(Exception):
    """Why a file has no table, with what to write."""

    def __init__(self, why: str, remedy: str) -> None:
        super().__init__(why)
        self.remedy = remedy


def matlab_table(path: Path, names: Collection[str], notes: list[str]) -> pd.DataFrame:
    """What has a value per trial: of Bpod's `SessionData`, of a struct, or of all variables.

    Vectors, cells and fields of an array of structs are columns. Bpod says how many trials there
    were: what is longer, as lists made before the session are, is cut, and what is shorter, as
    where the last trials have no answer, is filled with empty cells, which `notes` say.
    """
    with path.open("rb") as file:
        is_hdf5 = b"\x89HDF" in file.read(1024)
    variables = _read_hdf5(path) if is_hdf5 else _read_scipy(path)
    bpod = variables.get("SessionData")
    if isinstance(bpod, Mapping) and "nTrials" in bpod:
        fields = dict(bpod)
        count = int(fields.pop("nTrials"))
        columns = dict(_columns(fields))
    else:
        structs = [dict(_columns(v)) for v in variables.values() if isinstance(v, Mapping)]
        structs = [dict(_columns(variables)), *structs]
        columns = max(structs, key=len)
        lengths = Counter(len(v) for v in columns.values() if len(v) > 1)
        if not lengths:
            raise _nothing(variables)
        count = max(lengths, key=lambda length: (lengths[length], length))
    table, short = {}, []
    for name, values in columns.items():
        if len(values) < count:
            if name not in names and len(values) < count / 2:
                continue
            short.append(f"{name} has {len(values)}")
            values = [*values, *[np.nan] * (count - len(values))]
        table[name] = values[:count]
    if not table:
        raise _nothing(variables)
    if short:
        notes.append(
            f"Of {counted(count, 'trial')}, {', '.join(short)}: the last trials are taken to have "
            "none."
        )
    # MATLAB's numbers are floats, subject 1 too.
    return pd.DataFrame(table).apply(_whole)


def _nothing(variables: Mapping[str, Any]) -> UnreadMatlab:
    if not variables:
        return UnreadMatlab(
            "it holds nothing but MATLAB's own objects (table, string, categorical), which MATLAB "
            "alone reads",
            "save the table as CSV there, with writetable",
        )
    return UnreadMatlab(
        f"none of its variables ({', '.join([*variables][:6])}) has a value a trial",
        "save vectors of one length, or a table as CSV, with writetable",
    )


def _columns(fields: Mapping[str, Any]) -> Iterator[tuple[str, list[Any]]]:
    """Fields that are a number, a truth value or a text, or nothing, again and again."""
    for name, value in fields.items():
        if isinstance(value, np.ndarray) and value.dtype.kind in "fiubU" and value.ndim <= 1:
            yield name, np.atleast_1d(value).tolist()
        elif _is_list(value):
            cells = [_cell(cell) for cell in value]
            if cells and not any(cell is None for cell in cells):
                yield name, cells
        elif isinstance(value, int | float):
            yield name, [value]


def _is_list(value: Any) -> bool:
    """Whether it is cells in a row, whatever they hold."""
    return isinstance(value, list) or (isinstance(value, np.ndarray) and value.ndim == 1)


def _cell(value: Any) -> Any:
    """A number or a text; NaN for an empty cell, None for anything larger."""
    if isinstance(value, str | bool | int | float | np.number | np.bool_):
        return value.item() if isinstance(value, np.generic) else value
    if (isinstance(value, list) and not value) or (
        isinstance(value, np.ndarray) and not value.size
    ):
        return np.nan
    if isinstance(value, np.ndarray) and value.size == 1 and value.dtype.kind in "fiub":
        return value.item()
    return None


def _whole(column: pd.Series) -> pd.Series:
    if column.dtype.kind == "f" and np.all(column == np.floor(column)):
        return column.astype(np.int64)
    return column


def _read_scipy(path: Path) -> dict[str, Any]:
    from scipy.io import loadmat

    found = loadmat(path, simplify_cells=True)
    return {
        name: _by_field(value) for name, value in found.items()
        if not name.startswith("__") and type(value).__name__ != "MatlabOpaque"
    }  # fmt: skip


def _by_field(value: Any) -> Any:
    """An array of structs as a struct of lists."""
    if _is_list(value) and len(value) and all(isinstance(one, Mapping) for one in value):
        return {name: [one.get(name, np.nan) for one in value] for name in value[0]}
    if isinstance(value, Mapping):
        return {name: _by_field(one) for name, one in value.items()}
    return value


def _read_hdf5(path: Path) -> dict[str, Any]:
    import h5py

    with h5py.File(path, "r") as file:
        return {
            name: value for name in file if not name.startswith("#")
            for value in [_of_hdf5(file[name], file)] if value is not None
        }  # fmt: skip


def _of_hdf5(item: Any, file: Any) -> Any:
    """A variable of MATLAB 7.3; None for its objects, which are not described in the file."""
    import h5py

    if "MATLAB_object_decode" in item.attrs:
        return None
    if isinstance(item, h5py.Group):
        return {name: _of_hdf5(item[name], file) for name in item}
    kind = item.attrs.get("MATLAB_class", b"")
    kind = kind.decode() if isinstance(kind, bytes) else str(kind)
    if "MATLAB_empty" in item.attrs:
        return "" if kind == "char" else np.zeros(0)
    values = np.asarray(item[()]).T
    if values.dtype == object:  # cells, and the fields of an array of structs
        return [_of_hdf5(file[reference], file) for reference in values.ravel(order="F")]
    if kind == "char":
        lines = ["".join(map(chr, line)) for line in np.atleast_2d(values)]
        return lines[0] if len(lines) == 1 else lines
    return np.squeeze(values.astype(bool) if kind == "logical" else values)
