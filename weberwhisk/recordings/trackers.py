"""Tracked whiskers from trackers' files, as one tidy table with one row per segment."""

from __future__ import annotations

import errno
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from .._util import checks
from .._util.refusals import Refusal, argument, call, named
from .._util.values import Array, Flags
from .files import hdf5, is_of_whiskers, measurements, point_lists, poses_of, whiskers
from .files import table as read_table
from .measures import LENGTHS, of_points, seen_from_tip, with_angles, with_lengths
from .poses import deeplabcut, is_deeplabcut, segments, sleap_analysis, sleap_project

#: Columns of every table, in order; what a file does not contain is NaN, and label is −1.
COLUMNS = (
    "frame", "whisker", "label", "follicle_x", "follicle_y", "tip_x", "tip_y", "length_px",
    "angle_deg", "curvature_per_px", "score",
)  # fmt: skip
#: Names of these columns in WhiskiWrap's and ndx-whisk's tables.
_ALIASES = {
    "frame": ("frame_id", "fid", "time"), "whisker": ("whisker_id", "wid", "id"),
    "follicle_x": ("fol_x",), "follicle_y": ("fol_y",), "angle_deg": ("angle",),
    "curvature_per_px": ("curvature",), "x": ("pixels_x",), "y": ("pixels_y",),
}  # fmt: skip
#: What −1 becomes in unsigned columns, and in what is written of these.
_MINUS_ONE = (2**16 - 1, 2**32 - 1, float(2**64 - 1))


def read_tracking(
    path: str | Path, *, shortest_px: float = 0.0, likelihood: float = 0.6,
    follicles: Sequence[float] | Array | None = None, face: str | None = None,
    pixels_per_mm: float | None = None, frame_rate: float | None = None,
) -> pd.DataFrame:  # fmt: skip
    """Read the tracked whiskers of a video from the file that a tracker wrote.

    Parameters
    ----------
    path : path
        Whisk's `.measurements` or `.whiskers`; WhiskiWrap's `.hdf5`, `.parquet` or `.csv`; a
        `.nwb` with ndx-whisk's `WhiskerMeasurementTable`; poses of DeepLabCut (`.csv`, `.h5`),
        LightningPose (`.csv`) and SLEAP (`.slp`, `.h5`), where each individual or track is a
        whisker with keypoints from follicle to tip (for `.slp` and DeepLabCut's `.h5` the extra
        `tracking`); or a table with one row per point from base to tip, with columns frame, x, y
        and optionally z, whisker and likelihood.
    shortest_px : float
        Shorter segments are left out: most of what trackers find is fur.
    likelihood : float
        Less likely keypoints are left out, and so are whiskers whose first keypoint is less
        likely, because distances are measured from it.
    follicles : (x, y, x, y), optional
        Corners of the box that holds the follicles, pixels; segments that start elsewhere are left
        out.
    face : {"left", "right", "top", "bottom"}, optional
        The side of the image where the face is: the follicle is the end nearer to it. By default
        as in the file; for `.whiskers`, which start at either end, the side where the ends of
        whiskers move least.
    pixels_per_mm, frame_rate : float, optional
        Scale of the image, and frames per second: no tracker writes them.

    Returns
    -------
    DataFrame
        One row per segment: `frame`, as in the file; `whisker`; `label` (the tracker's identity,
        −1 for none), and `name` where the file names whiskers; follicle and tip; `length_px` along
        the points, or the tracker's where the distance from follicle to tip bears it out, or that
        distance; `angle_deg`, the direction of the whisker at the follicle, from +x to +y (which
        runs down in an image), above −180 to 180; `curvature_per_px`, the mean rate at which this
        direction grows towards the tip: both by the points, or else the tracker's, turned into
        this convention; `score`; where the file has points, `x`, `y` (and `z`), arrays from the
        follicle; `length_mm` with `pixels_per_mm` and `time_s` with `frame_rate`.
        ``attrs["notes"]`` says what was found or assumed, and what is still needed.

    Raises
    ------
    ValueError
        For a file that is damaged, cut short, or of another kind than its name or header says.
    FileNotFoundError
        Where there is no such file.
    ModuleNotFoundError
        For poses, where the extra `tracking` is not installed.

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
    shortest_px = checks.non_negative_number("shortest_px", shortest_px, hint)
    likelihood = checks.non_negative_number("likelihood", likelihood, "give 0.6, say")
    for name, value in (("pixels_per_mm", pixels_per_mm), ("frame_rate", frame_rate)):
        if value is not None:
            checks.positive_number(name, value, hint)
    if face is not None:
        checks.one_of("face", face, _FACES)
    with open(path, "rb") as file:
        head = file.read(16)
    notes: list[str] = []
    either = False  # whether whiskers may be stored from either end
    if path.suffix == ".slp":
        table = segments(sleap_project(path, notes), path, likelihood, notes)
    elif head.startswith(b"\x89HDF"):
        poses = {"SLEAP": sleap_analysis, "DeepLabCut": deeplabcut}.get(poses_of(path))
        if poses is not None:
            table = segments(poses(path, notes), path, likelihood, notes)
        else:
            table = hdf5(path, notes)
            either = "x" in table and "angle" not in table and "score" not in table
    elif head[:4].lower() == b"meas" or path.suffix == ".measurements":
        table = measurements(path)
    elif head.startswith((b"bwhisk", b"whisk")) or path.suffix == ".whiskers":
        table, either = whiskers(path), True
    else:
        table = read_table(path, notes)
        if is_deeplabcut(table):
            table = segments(deeplabcut(path, notes), path, likelihood, notes)
        elif is_of_whiskers(table):
            either = "pixels_x" in table and "angle" not in table and "score" not in table
        else:
            table = segments(table, path, likelihood, notes)
    table = _from_follicle(tidy(table, path, notes))
    table = table[~(table["length_px"] < shortest_px)]
    if follicles is not None:
        x0, y0, x1, y1 = checks.finite("follicles", follicles, "give x, y, x, y in pixels")
        inside = table["follicle_x"].between(*sorted((x0, x1)))
        table = table[inside & table["follicle_y"].between(*sorted((y0, y1)))]
    table = table.reset_index(drop=True)
    if face is not None:
        table = _facing(table, face)
    elif either and len(table):
        spread = {side: _spread(_facing(table, side)) for side in _FACES}
        face = min(spread, key=lambda side: spread[side])
        clear = spread[face] < 0.7 * spread[_FACES[face]]
        table = _facing(table, face)
        notes.append(
            f"The face was taken to be at the {face}, where whiskers' ends move "
            f"{'least' if clear else 'hardly less'}; give " + named("face") + " if it is not."
        )
    elif "x" in table and table["frame"].nunique() > 20:
        own = table.groupby(identified_by(table))
        first, last = (
            own[[f"{end}_x", f"{end}_y"]].transform(lambda v: (v - v.median()).abs()).median().sum()
            for end in ("follicle", "tip")
        )
        if last < 0.5 * first:
            notes.append(
                "Whiskers' last points move less than their first, from which distances are; if "
                "they run from the tip, write " + named("face") + "."
            )
    table = of_points(table)
    needed = []
    if pixels_per_mm is None:
        needed.append("pixels_per_mm")
    else:
        table["length_mm"] = table["length_px"] / pixels_per_mm
    if frame_rate is None:
        needed.append("frame_rate")
    else:
        table["time_s"] = table["frame"] / frame_rate
    by = identified_by(table)
    if by == "whisker" and table["whisker"].nunique() > 1:
        needed.append("which whisker each is (whisker, of the table)")
    elif by == "name":
        names = [name for name in dict.fromkeys(table["name"]) if name]
        one = argument("identity", names[0], of="tracked_signals")
        notes.append(
            f"The file names {checks.listed(names, 6)}: "
            + call("tracked_signals", "…", one)
            + " takes one."
        )
    if needed:
        notes.append(f"The file does not tell {', '.join(needed)}; give them.")
    table.attrs = {"pixels_per_mm": pixels_per_mm, "frame_rate": frame_rate, "notes": tuple(notes)}
    return table


def identified_by(table: pd.DataFrame) -> str:
    """The column that identifies whiskers: `name`; `label`, unless several share one in a frame."""
    if "name" in table and (table["name"] != "").any():
        return "name"
    labelled = table[table["label"] >= 0]
    twice = labelled.duplicated(["frame", "label"]).any()
    return "whisker" if twice or not len(labelled) else "label"


#: Sides of the image, and the side across.
_FACES = {"left": "right", "right": "left", "top": "bottom", "bottom": "top"}


def _facing(table: pd.DataFrame, face: str) -> pd.DataFrame:
    """The table with every whisker starting at the end nearer to the face."""
    axis, sign = "x" if face in ("left", "right") else "y", -1 if face in ("left", "top") else 1
    turn = np.asarray(sign * (table[f"tip_{axis}"] - table[f"follicle_{axis}"]) > 0)
    out = table.copy()
    for name in "xy":
        ends = [f"follicle_{name}", f"tip_{name}"]
        out.loc[turn, ends] = table.loc[turn, ends[::-1]].to_numpy()
    return seen_from_tip(_turned(out, turn), turn)


def _from_follicle(table: pd.DataFrame) -> pd.DataFrame:
    """The table with points that start at the measured follicle; WhiskiWrap has either order."""
    if "x" not in table:
        return table
    follicle = table[["follicle_x", "follicle_y"]].to_numpy(dtype=float).T
    first, last = (
        np.array([[v[i] if len(v) else np.nan for v in table[a]] for a in "xy"]) - follicle
        for i in (0, -1)
    )
    return _turned(table, np.hypot(*first) > np.hypot(*last))


def _turned(table: pd.DataFrame, turn: Flags) -> pd.DataFrame:
    """The table with the points of rows `turn` reversed."""
    points = {
        name: [v[::-1] if t else v for v, t in zip(table[name], turn, strict=True)]
        for name in "xyz" if name in table
    }  # fmt: skip
    return table.assign(**points)


def _spread(table: pd.DataFrame) -> float:
    """Median distance of follicles from their median, px, for the longer half of whiskers."""
    long = table[table["length_px"] >= table["length_px"].median()]
    ends = long[["follicle_x", "follicle_y"]]
    return float((ends - ends.median()).abs().median().sum())


def tidy(table: pd.DataFrame, path: Path, notes: list[str] | None = None) -> pd.DataFrame:
    """A tracker's table with `COLUMNS`, in order, and names and points where there are any."""
    notes = [] if notes is None else notes
    for name, others in _ALIASES.items():
        for other in others:
            if name not in table and other in table:
                table = table.rename(columns={other: name})
    if not len(table):
        raise Refusal(f"{path.name}: no whisker was tracked in it; give another file.")
    for name in ("frame", "whisker"):
        if name not in table:
            raise Refusal(f"{path.name}: no column tells the {name}; is it of another kind?")
        values = pd.to_numeric(table[name], errors="coerce").to_numpy(dtype=float)
        if not (np.isfinite(values).all() and (values >= 0).all() and (values % 1 == 0).all()):
            raise Refusal(f"{path.name}: {name} must be whole numbers from 0; is the file damaged?")
        table = table.assign(**{name: values.astype(np.int64)})
    table = _labelled(table)
    axes = "xyz" if {"x", "y"} <= set(table) else ""  # a damaged file may have only one
    axes = "".join(name for name in axes if name in table)
    for name in axes:
        table[name] = point_lists(table[name])
    if "face_side" in table:
        side = table["face_side"].map(lambda v: v.decode() if isinstance(v, bytes) else str(v))
        from_y = {"left": 1.0, "right": 1.0, "top": 0.0, "bottom": 0.0}
        table = table.assign(from_y=side.str.strip().str.lower().map(from_y))
    names = [*COLUMNS[:3], *(["name"] if "name" in table else []), *COLUMNS[3:]]
    measured = [n for n in LENGTHS if n in table and n not in names]
    more = ["from_y"] if "from_y" in table else []
    table = table.assign(**{n: np.nan for n in names if n not in table and n != LENGTHS[0]})
    numbers = {n: pd.to_numeric(table[n], errors="coerce") for n in COLUMNS[3:] if n in table}
    table = table[[n for n in names if n in table] + [*measured, *more, *axes]]
    return with_angles(with_lengths(table.assign(**numbers), notes), notes)[[*names, *axes]]


def _labelled(table: pd.DataFrame) -> pd.DataFrame:
    """The table with whole numbers for `label`, −1 for none however it was stored."""
    if "label" not in table:
        return table.assign(label=-1)
    column = table["label"]
    numbers = pd.to_numeric(column, errors="coerce").astype(float)
    text = column.notna() & numbers.isna() & (column.astype(str).str.strip() != "")
    none = numbers.isin(_MINUS_ONE) | ~np.isfinite(numbers) | (numbers % 1 != 0)
    if getattr(column.dtype, "kind", "O") == "u":
        none |= numbers == float(np.iinfo(column.dtype.type).max)
    out = table.assign(label=numbers.mask(none, -1.0).astype(np.int64))
    if text.any() and "name" not in table:
        out = out.assign(name=column.where(text, "").astype(str).str.strip())
    return out
