"""Readers of whisker trackers' files."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from .._util import checks
from .._util.refusals import Refusal, argument, call
from .measures import segment
from .poses import is_deeplabcut
from .tables import load_table

#: Suffixes of files that only trackers write.
TRACKERS = (".whiskers", ".measurements", ".hdf5", ".h5", ".slp")
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?|nan"
_REFUSED = (b"bwhiskpoly1", b"whisk1", b"whiskold")


def measurements(path: Path) -> pd.DataFrame:
    """Whisk's measurements, which the file stores in reverse order."""
    data = path.read_bytes()
    # Bytes before the numbers in each row, by version of the file.
    heads = {b"measV1": (40,), b"measv2": (44, 48), b"measv3": (41,)}.get(data[:6])
    if heads is None or data[6:8] != b"\0\0" or len(data) < 16:
        raise Refusal(
            f"{path.name}: not a .measurements file of Whisk (it begins with {data[:6]!r}, not "
            "measV1, measv2 or measv3)",
            remedy="give the file that `measure` wrote",
        )
    n, m = (int(v) for v in np.frombuffer(data, "<i4", 2, 8))
    body = len(data) - 16
    if n <= 0 or m not in (8, 9) or body % n or body // n - 16 * m not in heads:
        raise Refusal(
            f"{path.name}: cut short or damaged: {n} rows of {m} measures do not fill "
            f"{len(data)} bytes",
            remedy="copy the file again",
        )
    row = np.dtype({
        "names": ["head", "values"], "formats": [("<i4", 10), ("<f8", m)],
        "offsets": [0, body // n - 16 * m], "itemsize": body // n,
    })  # fmt: skip
    records = np.frombuffer(data, row, n, 16)[::-1]
    finite = np.isfinite(records["values"][:, [0, 4, 5]]).all()
    if not finite or not (records["head"][:, 9] == m).all():
        raise Refusal(f"{path.name}: its rows contradict its header", remedy="copy the file again")
    head, values = records["head"], records["values"]
    names = ("length_px", "score", "angle_deg", "curvature_per_px", "follicle_x", "follicle_y",
             "tip_x", "tip_y")  # fmt: skip
    table = pd.DataFrame({name: values[:, i].copy() for i, name in enumerate(names)})
    for i, name in ((1, "frame"), (2, "whisker"), (3, "label")):
        table[name] = head[:, i]
    if body // n - 16 * m > 40:  # the first version does not say which way the face is
        axis = np.frombuffer(data, "S1", len(data) - 16, 16).reshape(n, -1)[::-1, 40]
        table["from_y"] = np.select([np.isin(axis, [b"y", b"v"]), np.isin(axis, [b"x", b"h"])],
                                    [1.0, 0.0], np.nan)  # fmt: skip
    return table


def whiskers(path: Path) -> pd.DataFrame:
    """Whisk's segments; the points of each may start at either end."""
    data = path.read_bytes()
    if not data.startswith(b"bwhiskbin1\0\0"):
        kind = next((k.decode() for k in _REFUSED if data.startswith(k)), repr(data[:10]))
        raise Refusal(
            f"{path.name}: of the kind {kind}, where bwhiskbin1 can be read",
            remedy="convert it with Whisk's whisker_convert",
        )
    broken = Refusal(f"{path.name}: cut short or damaged", remedy="copy the file again")
    if len(data) < 16:
        raise broken
    count, at, records = int(np.frombuffer(data, "<i4", 1, len(data) - 4)[0]), 12, []
    end = len(data) - 4
    while at < end:
        if at + 12 > end:
            raise broken
        number, frame, length = (int(v) for v in np.frombuffer(data, "<i4", 3, at))
        if length < 2 or at + 12 + 16 * length > end:
            raise broken
        numbers = np.frombuffer(data, "<f4", 4 * length, at + 12).astype(float)
        x, y, _, score = numbers.reshape(4, -1)
        if not (np.isfinite(x) & np.isfinite(y)).all():
            raise broken
        records.append({"frame": frame, "whisker": number, "score": float(np.median(score)),
                     **segment(x, y)})  # fmt: skip
        at += 12 + 16 * length
    if count != len(records):
        raise broken
    return pd.DataFrame(records)


def hdf5(path: Path, notes: list[str]) -> pd.DataFrame:
    """WhiskiWrap's `summary`, or the first table of ndx-whisk in an NWB file."""
    import h5py

    tables: dict[str, dict[str, Any]] = {}

    def look(name: str, item: Any) -> None:
        if isinstance(item, h5py.Group) and {"frame_id", "whisker_id"} <= set(item):
            tables[name] = {
                k: v[:] for k, v in item.items()
                if isinstance(v, h5py.Dataset) and v.ndim == 1 and v.dtype.kind in "iuf"
            }  # fmt: skip

    try:
        with h5py.File(path, "r") as file:
            summary = file.get("summary")
            if isinstance(summary, h5py.Dataset) and summary.dtype.names:
                records = summary[:]
                measures: dict[str, Any] = {name: records[name] for name in records.dtype.names}
                for axis in "xy":
                    pixels = file.get(f"pixels_{axis}")
                    if isinstance(pixels, h5py.Dataset) and len(pixels) == len(records):
                        measures[axis] = list(pixels[:])
                tables["summary"] = measures
            else:
                file.visititems(look)
    except Exception as error:  # whatever h5py makes of a damaged file
        raise Refusal(f"{path.name}: not readable as HDF5", remedy="copy the file again") from error
    if not tables:
        raise Refusal(
            f"{path.name}: holds neither WhiskiWrap's summary nor a WhiskerMeasurementTable",
            remedy="name a file of tracked whiskers",
        )
    name, columns = next(iter(tables.items()))
    if len(tables) > 1:
        notes.append(f"There are {len(tables)} tables of whiskers; this is {name}.")
    if len({len(v) for v in columns.values()}) > 1:
        raise Refusal(f"{path.name}: its columns differ in length", remedy="copy the file again")
    return pd.DataFrame(columns)


def poses_of(path: Path) -> str:
    """The software that wrote the poses of an HDF5 file, "" where it holds none."""
    import h5py

    try:
        with h5py.File(path, "r") as file:
            if "tracks" in file or "track_occupancy" in file:
                return "SLEAP"
            return "DeepLabCut" if any("block0_values" in file[name] for name in file
                                       if isinstance(file[name], h5py.Group)) else ""  # fmt: skip
    except Exception:  # whatever h5py makes of a damaged file: `hdf5` says so
        return ""


def table(path: Path, notes: list[str]) -> pd.DataFrame:
    """A table of text or Parquet: DeepLabCut's, WhiskiWrap's with a whisker a row, or points."""
    read = load_table(path, "point", names=("frame", "scorer", "fid", "x"))
    notes.extend(read.notes)
    raw = read.frame
    names = set(raw.columns)
    if is_deeplabcut(raw) or {"frame", "x", "y"} <= names or is_of_whiskers(raw):
        return raw
    raise Refusal(
        f"{path.name}: no tracker's file that is known, and no table of points with the "
        f"columns frame, x and y",
        remedy=f"it has {checks.listed(map(str, raw.columns), 6)}",
    )


def is_of_whiskers(table: pd.DataFrame) -> bool:
    """Whether a table has a whisker in each row, as WhiskiWrap's and ndx-whisk's."""
    names = set(table.columns)
    numbered = {"fid", "frame_id", "frame"} & names and {"wid", "whisker_id", "whisker"} & names
    return bool(numbered and {"follicle_x", "fol_x", "pixels_x"} & names)


def point_lists(cells: pd.Series) -> pd.Series:
    """The numbers in each cell, which text files have as [1.0, 2.0] or [1. 2.]."""
    out = np.empty(len(cells), dtype=object)
    for i, cell in enumerate(cells):
        if isinstance(cell, str):
            cell = re.findall(_NUMBER, cell)
        out[i] = np.array(cell, dtype=float) if np.ndim(cell) else np.zeros(0)
    return pd.Series(out, cells.index)


def refuse_tracked(source: Any) -> None:
    """Refuse a tracker's file or table of points, from which signals must be computed first."""
    scales = argument("pixels_per_mm", 20), argument("frame_rate", 500)
    first = (
        "forces follow from the shape: write "
        + call("ww.tracked_signals", call("ww.read_tracking", "file", *scales), "whisker")
        + " with your video's numbers"
    )
    if isinstance(source, str | Path):
        if Path(source).suffix.lower() in TRACKERS:
            raise Refusal(f"{Path(source).name} is of a tracker", remedy=first)
    elif isinstance(source, pd.DataFrame):
        if {"frame", "follicle_x", "tip_x"} <= {*source} and "x" not in source:
            raise Refusal(
                "The table holds tracked whiskers, but points are what is missing: read Whisk's "
                ".whiskers, say",
                remedy=first,
            )
        if {"fid", "wid"} <= {*source} or "scorer" in source:
            raise Refusal("The table is of a tracker", remedy=first)
        if {"frame", "x", "y"} <= {*source}:
            raise Refusal("The table holds points of tracked whiskers", remedy=first)
