"""Files of whisker trackers, to one tidy table: a row a tracked segment."""

from __future__ import annotations

import errno
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from .. import _checks
from ..behaviour.io import load_table

#: Columns of every table, in order; what a file does not tell is NaN, and label is −1.
COLUMNS = (
    "frame", "whisker", "label", "follicle_x", "follicle_y", "tip_x", "tip_y", "length_px",
    "angle_deg", "curvature_per_px", "score",
)  # fmt: skip
#: Names of the same in WhiskiWrap's and ndx-whisk's tables.
_ALIASES = {
    "frame": ("frame_id", "time", "fid"), "whisker": ("whisker_id", "id", "wid"),
    "follicle_x": ("fol_x",), "follicle_y": ("fol_y",), "length_px": ("length", "pixlen",
    "pixel_length"), "angle_deg": ("angle",), "curvature_per_px": ("curvature",),
}  # fmt: skip
#: Bytes before the numbers of a row of `.measurements`, by version of the file.
_HEADS = {b"measV1": (40,), b"measv2": (44, 48), b"measv3": (41,)}
_REFUSED = (b"bwhiskpoly1", b"whisk1", b"whiskold")


def read_tracking(
    path: str | Path,
    *,
    shortest_px: float = 0.0,
    follicles: tuple[float, float, float, float] | None = None,
    face: str | None = None,
    pixels_per_mm: float | None = None,
    frame_rate: float | None = None,
) -> pd.DataFrame:
    """Tracked whiskers of a video, from the file that a tracker wrote.

    Parameters
    ----------
    path : path
        Whisk's `.measurements` or `.whiskers`; WhiskiWrap's `.hdf5`; a `.nwb` with ndx-whisk's
        `WhiskerMeasurementTable`; poses of DeepLabCut (`.csv`, `.h5`), LightningPose (`.csv`) and
        SLEAP (`.slp`, `.h5`), the last and `.h5` by movement (extra `tracking`), with keypoints
        from follicle to tip; or any table of points with the columns frame, x, y and, for several
        whiskers, whisker, a row a point from base to tip.
    shortest_px : float
        Shorter segments are left out: most of what trackers find is fur.
    follicles : (x, y, x, y), optional
        Corners of the box in which follicles lie, pixels; segments that start elsewhere are left
        out.
    face : {"left", "right", "top", "bottom"}, optional
        The side of the image where the face is: whiskers start at the end that is nearer to it.
        By default as the file has it; `.whiskers` have either end first, and there it is the side
        at which the ends of whiskers stay closest together.
    pixels_per_mm, frame_rate : float, optional
        Scale of the image, and frames a second: no tracker writes them.

    Returns
    -------
    DataFrame
        A row a segment: `frame`, `whisker`, `label` (the tracker's identity, −1 for none),
        follicle and tip, `length_px`, `angle_deg`, `curvature_per_px`, `score`; `x` and `y`, arrays
        of points from the follicle, where the file has them; `length_mm` with `pixels_per_mm` and
        `time_s` with `frame_rate`. ``attrs["notes"]`` says what is still needed.

    Raises
    ------
    ValueError
        For a file that is not what it says, cut short, or of another kind.
    FileNotFoundError
        Where there is no such file.
    ModuleNotFoundError
        For poses that take movement, where that is not installed.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     points = Path(folder) / "points.csv"
    ...     _ = points.write_text("frame,x,y\\n0,0,0\\n0,3,4\\n1,0,0\\n1,6,8\\n")
    ...     read_tracking(points)[["frame", "tip_x", "length_px"]]
       frame  tip_x  length_px
    0      0    3.0        5.0
    1      1    6.0       10.0
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(errno.ENOENT, "there is no such file of tracking", str(path))
    hint = "give a number, or leave it out"
    shortest_px = _checks.non_negative_number("shortest_px", shortest_px, hint)
    for name, value in (("pixels_per_mm", pixels_per_mm), ("frame_rate", frame_rate)):
        if value is not None:
            _checks.positive_number(name, value, hint)
    if face is not None:
        _checks.one_of("face", face, _FACES)
    with open(path, "rb") as file:
        head = file.read(16)
    if path.suffix == ".slp":
        table = _poses(path, "sleap")
    elif head.startswith(b"\x89HDF"):
        table = _hdf5(path)
    elif head[:4].lower() == b"meas" or path.suffix == ".measurements":
        table = _measurements(path)
    elif head.startswith((b"bwhisk", b"whisk")) or path.suffix == ".whiskers":
        table = _whiskers(path)
    else:
        table = _points(path)
    table = tidy(table, path)
    table = table[~(table["length_px"] < shortest_px)]
    if follicles is not None:
        x0, y0, x1, y1 = _checks.finite("follicles", follicles, "give x, y, x, y in pixels")
        inside = table["follicle_x"].between(*sorted((x0, x1)))
        table = table[inside & table["follicle_y"].between(*sorted((y0, y1)))]
    table = table.reset_index(drop=True)
    notes = []
    if face is not None:
        table = _facing(table, face)
    elif head.startswith(b"bwhisk") and len(table):
        spread = {side: _spread(_facing(table, side)) for side in _FACES}
        face = min(spread, key=lambda side: spread[side])
        clear = spread[face] < 0.7 * spread[_FACES[face][2]]
        table = _facing(table, face)
        notes.append(
            f"The face was taken to be at the {face}, where whiskers' ends move "
            f"{'least' if clear else 'hardly less'}; give face= if it is not."
        )
    needed = []
    if pixels_per_mm is None:
        needed.append("pixels_per_mm")
    else:
        table["length_mm"] = table["length_px"] / pixels_per_mm
    if frame_rate is None:
        needed.append("frame_rate")
    else:
        table["time_s"] = table["frame"] / frame_rate
    if not (table["label"] >= 0).any():
        needed.append("which whisker each is (whisker, of the table)")
    if needed:
        notes.append(f"The file does not tell {', '.join(needed)}; give them.")
    table.attrs = {"pixels_per_mm": pixels_per_mm, "frame_rate": frame_rate, "notes": tuple(notes)}
    return table


#: Sides of the image: the axis, its sign towards the face, and the side across.
_FACES = {
    "left": ("x", -1, "right"), "right": ("x", 1, "left"),
    "top": ("y", -1, "bottom"), "bottom": ("y", 1, "top"),
}  # fmt: skip


def _facing(table: pd.DataFrame, face: str) -> pd.DataFrame:
    """Every whisker from the end that is nearer to the face."""
    axis, sign, _ = _FACES[face]
    turn = np.asarray(sign * (table[f"tip_{axis}"] - table[f"follicle_{axis}"]) > 0)
    out = table.copy()
    for name in "xy":
        ends = [f"follicle_{name}", f"tip_{name}"]
        out.loc[turn, ends] = table.loc[turn, ends[::-1]].to_numpy()
        if name in out:
            out[name] = [v[::-1] if t else v for v, t in zip(table[name], turn, strict=True)]
    return out


def _spread(table: pd.DataFrame) -> float:
    """How far follicles lie about their middle, pixels; the long half of the whiskers alone."""
    long = table[table["length_px"] >= table["length_px"].median()]
    ends = long[["follicle_x", "follicle_y"]]
    return float((ends - ends.median()).abs().median().sum())


def _poses(path: Path, software: str) -> pd.DataFrame:
    """Poses by movement: an individual is a whisker, its keypoints from follicle to tip."""
    try:
        from movement.io import load_poses
    except ImportError as error:
        raise ModuleNotFoundError(
            f"{path.name}: poses of this kind are read by movement, which is not installed; write "
            'pip install "weberwhisk[tracking]".'
        ) from error
    try:
        load = load_poses.from_sleap_file if software == "sleap" else load_poses.from_dlc_file
        poses = load(path)
        places = poses["position"]
        order = {str(name)[:4]: name for name in places.dims}  # plural in some versions
        places = places.transpose(*(order[n] for n in ("time", "indi", "keyp", "spac")))
    except Exception as error:  # whatever movement and what it reads by make of a damaged file
        raise ValueError(
            f"{path.name}: movement does not read it ({str(error).splitlines()[0][:80]}); give a "
            "file of poses."
        ) from error
    rows = []
    for frame, of_frame in enumerate(np.asarray(places, dtype=float)):
        for whisker, points in enumerate(of_frame):
            points = points[np.isfinite(points).all(axis=1), :2]
            if len(points) > 1:
                rows.append({"frame": frame, "whisker": whisker, **segment(*points.T)})
    return pd.DataFrame(rows)


def tidy(table: pd.DataFrame, path: Path) -> pd.DataFrame:
    """The columns of every table, in order, from what a tracker wrote."""
    for name, others in _ALIASES.items():
        for other in others:
            if name not in table and other in table:
                table = table.rename(columns={other: name})
    if not len(table):
        raise ValueError(f"{path.name}: no whisker was tracked in it; give another file.")
    for name in ("frame", "whisker"):
        values = pd.to_numeric(table[name], errors="coerce").to_numpy(dtype=float)
        if not (np.isfinite(values).all() and (values >= 0).all() and (values % 1 == 0).all()):
            raise ValueError(
                f"{path.name}: {name} must be whole numbers from 0; is the file damaged?"
            )
        table[name] = values.astype(np.int64)
    if "label" not in table:
        table["label"] = -1
    for name in COLUMNS:
        if name not in table:
            table[name] = np.nan
    return table[[*COLUMNS, *(name for name in ("x", "y") if name in table)]]


def _measurements(path: Path) -> pd.DataFrame:
    """Whisk's measurements: rows stand in reverse order."""
    data = path.read_bytes()
    heads = _HEADS.get(data[:6])
    if heads is None or data[6:8] != b"\0\0" or len(data) < 16:
        raise ValueError(
            f"{path.name}: not a .measurements file of Whisk (it begins with {data[:6]!r}, not "
            "measV1, measv2 or measv3); give the file that `measure` wrote."
        )
    n, m = (int(v) for v in np.frombuffer(data, "<i4", 2, 8))
    body = len(data) - 16
    if n <= 0 or m not in (8, 9) or body % n or body // n - 16 * m not in heads:
        raise ValueError(
            f"{path.name}: cut short or damaged: {n} rows of {m} measures do not fill "
            f"{len(data)} bytes; copy the file again."
        )
    row = np.dtype({
        "names": ["head", "values"], "formats": [("<i4", 10), ("<f8", m)],
        "offsets": [0, body // n - 16 * m], "itemsize": body // n,
    })  # fmt: skip
    rows = np.frombuffer(data, row, n, 16)[::-1]
    if not (rows["head"][:, 9] == m).all() or not np.isfinite(rows["values"][:, [0, 4, 5]]).all():
        raise ValueError(f"{path.name}: its rows contradict its header; copy the file again.")
    head, values = rows["head"], rows["values"]
    names = ("length_px", "score", "angle_deg", "curvature_per_px", "follicle_x", "follicle_y",
             "tip_x", "tip_y")  # fmt: skip
    table = pd.DataFrame({name: values[:, i].copy() for i, name in enumerate(names)})
    for i, name in ((1, "frame"), (2, "whisker"), (3, "label")):
        table[name] = head[:, i]
    return table


def _whiskers(path: Path) -> pd.DataFrame:
    """Whisk's segments, with their points in the stored order, which is arbitrary."""
    data = path.read_bytes()
    if not data.startswith(b"bwhiskbin1\0\0"):
        kind = next((k.decode() for k in _REFUSED if data.startswith(k)), repr(data[:10]))
        raise ValueError(
            f"{path.name}: of the kind {kind}, where bwhiskbin1 can be read; convert it with "
            "Whisk's whisker_convert."
        )
    broken = ValueError(f"{path.name}: cut short or damaged; copy the file again.")
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


def segment(x: NDArray[np.float64], y: NDArray[np.float64]) -> dict[str, Any]:
    """What a row tells of points from follicle to tip."""
    return {
        "x": x, "y": y, "follicle_x": x[0], "follicle_y": y[0], "tip_x": x[-1], "tip_y": y[-1],
        "length_px": float(np.hypot(np.diff(x), np.diff(y)).sum()),
    }  # fmt: skip


def _hdf5(path: Path) -> pd.DataFrame:
    """WhiskiWrap's `summary`, or a table of ndx-whisk anywhere in an NWB file."""
    import h5py

    found: list[dict[str, Any]] = []
    poses = ""

    def look(_: str, item: Any) -> None:
        if isinstance(item, h5py.Group) and {"frame_id", "whisker_id"} <= set(item):
            found.append({
                k: v[:] for k, v in item.items()
                if isinstance(v, h5py.Dataset) and v.ndim == 1 and v.dtype.kind in "iuf"
            })  # fmt: skip

    try:
        with h5py.File(path, "r") as file:
            summary = file.get("summary")
            if isinstance(summary, h5py.Dataset) and summary.dtype.names:
                rows = summary[:]
                found.append({name: rows[name] for name in rows.dtype.names})
                for axis in "xy":
                    pixels = file.get(f"pixels_{axis}")
                    if isinstance(pixels, h5py.Dataset) and len(pixels) == len(rows):
                        found[0][axis] = list(pixels[:])
            elif "tracks" in file or "track_occupancy" in file:
                poses = "sleap"
            elif "df_with_missing" in file:
                poses = "deeplabcut"
            else:
                file.visititems(look)
    except (OSError, RuntimeError, KeyError) as error:
        raise ValueError(f"{path.name}: not readable as HDF5; copy the file again.") from error
    if poses:
        return _poses(path, poses)
    if not found or not any(n in found[0] for n in ("frame", *_ALIASES["frame"])):
        raise ValueError(
            f"{path.name}: holds neither WhiskiWrap's summary nor a WhiskerMeasurementTable; name "
            "a file of tracked whiskers."
        )
    if len({len(v) for v in found[0].values()}) > 1:
        raise ValueError(f"{path.name}: its columns differ in length; copy the file again.")
    return pd.DataFrame(found[0])


def _points(path: Path) -> pd.DataFrame:
    """DeepLabCut's table, whose second row says bodyparts, or a table of points."""
    raw, _ = load_table(path, "point")
    first = raw.iloc[:, 0].astype(str).tolist() if raw.shape[1] else []
    if raw.shape[1] > 3 and first[:2] == ["bodyparts", "coords"]:
        parts, coords = (raw.iloc[i, 1:].tolist() for i in (0, 1))
        frames = raw.iloc[2:, 0].tolist()
        cells = raw.iloc[2:, 1:].apply(pd.to_numeric, errors="coerce").to_numpy(dtype=float)
        axes = [[i for i, c in enumerate(coords) if c == axis] for axis in "xy"]
        if not axes[0] or len(axes[0]) != len(axes[1]):
            raise ValueError(f"{path.name}: its {len(parts)} columns have no x and y each.")
        frame, (x, y) = np.repeat(frames, len(axes[0])), (cells[:, a].ravel() for a in axes)
        points = pd.DataFrame({"frame": frame, "x": x, "y": y})
    elif {"frame", "x", "y"} <= set(raw.columns):
        points = raw
    else:
        raise ValueError(
            f"{path.name}: no tracker's file that is known, and no table of points with the "
            f"columns frame, x and y; it has {_checks.listed(map(str, raw.columns), 6)}."
        )
    keys = ["frame", *(["whisker"] if "whisker" in points else [])]
    points = points[[*keys, "x", "y"]].apply(pd.to_numeric, errors="coerce")
    known = np.isfinite(points.to_numpy(dtype=float)).all(axis=1)
    if known.sum() < 2:
        raise ValueError(f"{path.name}: it has no points with numbers in frame, x and y.")
    for name in keys:
        if (points.loc[known, name] % 1 != 0).any():
            raise ValueError(
                f"{path.name}: {name} must be whole numbers from 0; is another column in its place?"
            )
    rows = []
    for key, own in points[known].groupby(keys, sort=True):
        if len(own) > 1:
            values = dict(zip(keys, key, strict=True))
            rows.append({"whisker": 0, **values, **segment(*own[["x", "y"]].to_numpy(float).T)})
    return pd.DataFrame(rows)
