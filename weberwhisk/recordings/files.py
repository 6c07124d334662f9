"""Readers of whisker trackers' files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from .._util import checks
from .._util.refusals import Refusal, argument, call
from .._util.values import Array, counted
from .tables import load_table

#: Suffixes of files that only trackers write.
TRACKERS = (".whiskers", ".measurements", ".hdf5", ".h5", ".slp")
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
    rows = np.frombuffer(data, row, n, 16)[::-1]
    if not (rows["head"][:, 9] == m).all() or not np.isfinite(rows["values"][:, [0, 4, 5]]).all():
        raise Refusal(f"{path.name}: its rows contradict its header", remedy="copy the file again")
    head, values = rows["head"], rows["values"]
    names = ("length_px", "score", "angle_deg", "curvature_per_px", "follicle_x", "follicle_y",
             "tip_x", "tip_y")  # fmt: skip
    table = pd.DataFrame({name: values[:, i].copy() for i, name in enumerate(names)})
    for i, name in ((1, "frame"), (2, "whisker"), (3, "label")):
        table[name] = head[:, i]
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
    count, at, rows = int(np.frombuffer(data, "<i4", 1, len(data) - 4)[0]), 12, []
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
        rows.append({"frame": frame, "whisker": number, "score": float(np.median(score)),
                     **segment(x, y)})  # fmt: skip
        at += 12 + 16 * length
    if count != len(rows):
        raise broken
    return pd.DataFrame(rows)


def segment(*axes: Array) -> dict[str, Any]:
    """Columns of a segment whose points run from follicle to tip: x, y and perhaps z."""
    x, y = axes[:2]
    return {
        **dict(zip("xyz", axes, strict=False)), "follicle_x": x[0], "follicle_y": y[0],
        "tip_x": x[-1], "tip_y": y[-1],
        "length_px": float(np.linalg.norm(np.diff(axes), axis=0).sum()),
    }  # fmt: skip


def angle_and_curvature(x: Any, y: Any) -> tuple[float, float]:
    """Direction at the first of n points (degrees from +x to +y) and mean curvature (1/px).

    From a least-squares parabola in arc length; NaN for fewer than three points.
    """
    z = np.asarray(x) + 1j * np.asarray(y)
    if len(z) < 3:
        return np.nan, np.nan
    arc = np.append(0.0, np.cumsum(np.abs(np.diff(z))))
    bend, start, _ = np.polyfit(arc, z, 2, full=True)[0]  # full: no warning if points coincide
    turn = np.angle(1 + 2 * bend * arc[-1] / start)
    return float(np.degrees(np.angle(start))), float(turn / arc[-1])


def _runs_to_and_fro(axes: Array) -> bool:
    """Whether the path through means of eighths of points (D, n) is twice their extent."""
    parts = np.array_split(axes, min(8, axes.shape[1]), axis=1)
    means = np.array([part.mean(axis=1) for part in parts])
    way = np.linalg.norm(np.diff(means, axis=0), axis=1).sum()
    return bool(way > 2 * np.linalg.norm(means[:, None] - means, axis=2).max())


def hdf5(path: Path, likelihood: float, notes: list[str]) -> pd.DataFrame:
    """WhiskiWrap's `summary`, the first table of ndx-whisk in an NWB file, or poses."""
    import h5py

    found: dict[str, dict[str, Any]] = {}
    software = ""

    def look(name: str, item: Any) -> None:
        if isinstance(item, h5py.Group) and {"frame_id", "whisker_id"} <= set(item):
            found[name] = {
                k: v[:] for k, v in item.items()
                if isinstance(v, h5py.Dataset) and v.ndim == 1 and v.dtype.kind in "iuf"
            }  # fmt: skip

    try:
        with h5py.File(path, "r") as file:
            summary = file.get("summary")
            if isinstance(summary, h5py.Dataset) and summary.dtype.names:
                rows = summary[:]
                own: dict[str, Any] = {name: rows[name] for name in rows.dtype.names}
                for axis in "xy":
                    pixels = file.get(f"pixels_{axis}")
                    if isinstance(pixels, h5py.Dataset) and len(pixels) == len(rows):
                        own[axis] = list(pixels[:])
                found["summary"] = own
            elif "tracks" in file or "track_occupancy" in file:
                software = "sleap"
            elif "df_with_missing" in file:
                software = "deeplabcut"
            else:
                file.visititems(look)
    except Exception as error:  # whatever h5py makes of a damaged file
        raise Refusal(f"{path.name}: not readable as HDF5", remedy="copy the file again") from error
    if software:
        return segments(poses(path, software), path, likelihood, notes)
    if not found:
        raise Refusal(
            f"{path.name}: holds neither WhiskiWrap's summary nor a WhiskerMeasurementTable",
            remedy="name a file of tracked whiskers",
        )
    name, columns = next(iter(found.items()))
    if len(found) > 1:
        notes.append(f"There are {len(found)} tables of whiskers; this is {name}.")
    if len({len(v) for v in columns.values()}) > 1:
        raise Refusal(f"{path.name}: its columns differ in length", remedy="copy the file again")
    return pd.DataFrame(columns)


def points(path: Path) -> pd.DataFrame:
    """One row per point: poses of a DeepLabCut CSV (header row `coords`), or a table of points."""
    raw = load_table(path, "point").frame
    if raw.shape[1] > 3 and "coords" in raw.iloc[:3, 0].astype(str).tolist():
        return poses(path, "dlc")
    if {"frame", "x", "y"} <= set(raw.columns):
        return raw
    raise Refusal(
        f"{path.name}: no tracker's file that is known, and no table of points with the "
        "columns frame, x and y",
        remedy=f"it has {checks.listed(map(str, raw.columns), 6)}",
    )


def poses(path: Path, software: str) -> pd.DataFrame:
    """Poses read by movement: individuals are whiskers, keypoints run from follicle to tip."""
    try:
        from movement.io import load_poses
    except ImportError as error:
        raise ModuleNotFoundError(
            f"{path.name}: poses of this kind are read by movement, which is not installed; write "
            'pip install "weberwhisk[tracking]".'
        ) from error
    try:
        load = load_poses.from_sleap_file if software == "sleap" else load_poses.from_dlc_file
        read = load(path)
        places = read["position"]
        order = {str(name)[:4]: name for name in places.dims}  # plural in some versions
        places = places.transpose(*(order[n] for n in ("time", "indi", "keyp", "spac")))
    except Exception as error:  # whatever movement and what it reads by make of a damaged file
        raise Refusal(
            f"{path.name}: movement does not read it ({str(error).splitlines()[0][:80]})",
            remedy="give a file of poses",
        ) from error
    n, whiskers, keypoints, axes = places.shape
    at = np.indices((n, whiskers, keypoints)).reshape(3, -1)
    out = pd.DataFrame({"frame": at[0], "whisker": at[1]})
    for i, name in enumerate("xyz"[:axes]):
        out[name] = np.asarray(places, dtype=float)[..., i].ravel()
    if "confidence" in read:
        sure = read["confidence"].transpose(*places.dims[:3])
        out["likelihood"] = np.asarray(sure, dtype=float).ravel()
    return out


def segments(points: pd.DataFrame, path: Path, likelihood: float, notes: list[str]) -> pd.DataFrame:
    """One row per whisker and frame, from one row per point."""
    axes = ["x", "y", *(["z"] if "z" in points else [])]
    keys = ["frame", *(["whisker"] if "whisker" in points else [])]
    sure = ["likelihood"] if "likelihood" in points else []
    points = points[[*keys, *axes, *sure]].copy()
    named = points[keys[-1]].dropna().astype(str).str.strip()
    named = named[named != ""]
    if len(keys) > 1 and pd.to_numeric(named, errors="coerce").isna().any():
        numbers, known_as = pd.factorize(named, sort=True)
        points["whisker"] = pd.Series(numbers, named.index)
        said = ", ".join(f"{name} is {i}" for i, name in enumerate(known_as[:8]))
        notes.append(f"Whiskers were numbered in the order of their names: {said}.")
    points = points.apply(pd.to_numeric, errors="coerce")
    known = np.isfinite(points[[*keys, *axes]].to_numpy(dtype=float)).all(axis=1)
    if sure:
        doubtful = known & (points["likelihood"] < likelihood).to_numpy()
        known &= ~doubtful
        if doubtful.any():
            count = f"{doubtful.sum()} of {len(points)} points"
            notes.append(f"{count} less likely than {likelihood:g}: left out.")
        # Distances are measured from the first keypoint: another must not replace it.
        seen = pd.Series(known).groupby([points[name].to_numpy() for name in keys])
        lost = known & ~seen.transform("first").eq(True).to_numpy()
        if lost.any():
            known &= ~lost
            count = counted(len(points[lost].drop_duplicates(keys)), "whisker")
            notes.append(f"{count} without a likely first keypoint: left out.")
    if known.sum() < 2:
        raise Refusal(f"{path.name}: it has no points with numbers in frame, x and y.")
    points = points[known]
    for name in keys:
        if (points[name] % 1 != 0).any():
            raise Refusal(
                f"{path.name}: {name} must be whole numbers from 0; is another column in its place?"
            )
    rows, wrong = [], 0
    for key, own in points.groupby(keys, sort=True):
        if len(own) > 1:
            wrong += _runs_to_and_fro(own[axes].to_numpy(float).T)
            score = {"score": float(own["likelihood"].median())} if sure else {}
            row = {"whisker": 0, **dict(zip(keys, key, strict=True)), **score}
            row |= {"label": row["whisker"]} if len(keys) > 1 else {}
            rows.append({**row, **segment(*own[axes].to_numpy(float).T)})
    if 2 * wrong > len(rows):
        raise Refusal(
            f"{path.name}: the points of a whisker run to and fro",
            remedy=(
                "give each whisker's once and in order from follicle to tip, and several "
                "whiskers as individuals or in a column whisker"
            ),
        )
    return pd.DataFrame(rows)


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
        if {"frame", "x", "y"} <= {*source}:
            raise Refusal("The table holds points of tracked whiskers", remedy=first)
