"""Poses of DeepLabCut, LightningPose and SLEAP, and tables of points, as one row per whisker.

Frames and names are those of the file: frames may begin anywhere and miss some.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from .._util import checks
from .._util.refusals import Refusal, argument, call
from .._util.values import Array, counted
from .measures import segment

__all__ = ["deeplabcut", "is_deeplabcut", "segments", "sleap_analysis", "sleap_project"]


def is_deeplabcut(table: pd.DataFrame) -> bool:
    """Whether a table read with one header has the further header rows of DeepLabCut."""
    return table.shape[1] > 3 and "coords" in table.iloc[:3, 0].astype(str).tolist()


def deeplabcut(path: Path, notes: list[str]) -> pd.DataFrame:
    """One row per point of DeepLabCut's and LightningPose's poses, in the order of the header."""
    try:
        if path.suffix.lower() in (".h5", ".hdf5"):
            read = pd.DataFrame(pd.read_hdf(path))
        else:
            head = pd.read_csv(path, header=None, nrows=4, dtype=str)
            levels = head.iloc[:, 0].tolist()
            levels = levels[: levels.index("coords") + 1]
            # Not as header=: pandas takes a first row without any pose for names of the index.
            read = pd.read_csv(path, header=None, skiprows=len(levels), index_col=0)
            read.columns = pd.MultiIndex.from_frame(
                head.iloc[: len(levels), 1:].T.reset_index(drop=True), names=levels
            )
        levels = [str(name) for name in read.columns.names]
        of = {n: read.columns.get_level_values(n).astype(str) for n in levels}
        bodyparts, coordinates = of["bodyparts"], of["coords"]
    except ImportError as error:
        raise _missing(path, "PyTables") from error
    except Exception as error:  # whatever pandas and PyTables make of a damaged file
        raise _unreadable(path, "DeepLabCut", error) from error
    whiskers = of["individuals"] if "individuals" in of else pd.Index([""] * len(bodyparts))
    frame, columns = _frames(read.index, path), []
    for i, name in enumerate(dict.fromkeys(whiskers)):
        for j, part in enumerate(dict.fromkeys(bodyparts[whiskers == name])):
            here = (whiskers == name) & (bodyparts == part)
            values = {c: read.loc[:, here & (coordinates == c)] for c in ("x", "y", "z",
                                                                        "likelihood")}  # fmt: skip
            if values["x"].shape[1] and values["y"].shape[1]:
                columns.append(pd.DataFrame({
                    "frame": frame, "whisker": i, "name": name, "part": j,
                    **{c: v.iloc[:, 0].to_numpy() for c, v in values.items() if v.shape[1]},
                }))  # fmt: skip
    if not columns:
        raise _unreadable(path, "DeepLabCut", LookupError("it has no x and y"))
    if "single" in {*whiskers} and len({*whiskers}) > 1:
        alone = [str(part) for part in dict.fromkeys(bodyparts[whiskers == "single"])]
        notes.append(
            f"The body parts of no individual ({checks.listed(alone, 6)}) are points of one, "
            "called single, from the first to the last."
        )
    out = pd.concat(columns).sort_values(["frame", "whisker", "part"], kind="stable")
    if set(whiskers) == {""}:
        out = out.drop(columns="name")
    return out.drop(columns="part").reset_index(drop=True)


def _frames(index: pd.Index, path: Path) -> Array:
    """Frames of DeepLabCut's rows: numbers, or numbers in the names of labelled images."""
    if isinstance(index, pd.MultiIndex):
        index = index.map(lambda key: "/".join(map(str, key)))
    numbers = pd.to_numeric(index.to_series(), errors="coerce")
    if numbers.notna().all():
        return numbers.to_numpy(dtype=float)
    names = index.astype(str).str.replace("\\", "/")
    if len({name.rpartition("/")[0] for name in names}) > 1:
        raise Refusal(
            f"{path.name}: it has labels of several videos, whose frames would be taken for one's",
            remedy="give those of one",
        )
    matches = [re.search(r"(\d+)\.\w+$", name) for name in names]
    if not all(matches):
        raise Refusal(
            f"{path.name}: its rows are called {names[0]!r}, which is no number of a frame",
            remedy="give the poses that the tracker wrote",
        )
    return np.array([float(match[1]) for match in matches if match])


def sleap_project(path: Path, notes: list[str]) -> pd.DataFrame:
    """One row per point of the first video of SLEAP's project; corrected instances come first."""
    try:
        from sleap_io import load_slp
    except ImportError as error:
        raise _missing(path, "sleap-io") from error
    try:
        labels = load_slp(str(path), open_videos=False)
        tracks = {id(track): i for i, track in enumerate(labels.tracks)}
        point_tables = []
        for labelled in labels.labeled_frames:
            if labelled.video is not labels.videos[0]:
                continue
            instances = [*labelled.user_instances, *labelled.unused_predictions]
            for i, instance in enumerate(instances):
                at = np.asarray(instance.numpy(), dtype=float)
                points = pd.DataFrame({"x": at[:, 0], "y": at[:, 1]})
                if hasattr(instance, "score"):  # only the predicted have any
                    points["likelihood"] = np.asarray(instance.numpy(scores=True))[:, 2]
                whisker = tracks.get(id(instance.track), len(tracks) + i)
                name = "" if instance.track is None else str(instance.track.name)
                point_tables.append(
                    points.assign(frame=labelled.frame_idx, whisker=whisker, name=name)
                )
    except Exception as error:  # whatever sleap-io makes of a damaged file
        raise _unreadable(path, "SLEAP", error) from error
    if len(labels.videos) > 1:
        notes.append(
            f"The project has {len(labels.videos)} videos: this is the first, "
            f"{Path(str(labels.videos[0].filename)).name}."
        )
    if not point_tables:
        raise Refusal(f"{path.name}: no whisker was tracked in it; give another file.")
    out = pd.concat(point_tables, ignore_index=True)
    if not tracks:
        notes.append(
            "The file has no tracks: whisker numbers those of a frame, in no order, and not one "
            "whisker throughout; track them in SLEAP, or leave out the others by "
            + call("read_tracking", argument("follicles", ...))
            + ", the box that it starts in."
        )
    return out if tracks else out.drop(columns="name").assign(label=-1)


def sleap_analysis(path: Path, notes: list[str]) -> pd.DataFrame:
    """One row per point of SLEAP's analysis file."""
    import h5py

    try:
        with h5py.File(path, "r") as file:
            data: Any = file["tracks"]
            # Newer writers may have frames first, and say so.
            dims = json.loads(data.attrs.get("dims", '["track", "xy", "node", "frame"]'))
            places = np.transpose(
                data[:], [dims.index(d) for d in ("frame", "track", "node", "xy")]
            )
            scores: Any = file.get("point_scores")
            if scores is not None:
                order = [d for d in dims if d != "xy"]
                scores = np.transpose(
                    scores[:], [order.index(d) for d in ("frame", "track", "node")]
                )
            names = [n.decode() for n in file["track_names"][:]] if "track_names" in file else []
        n, many, nodes, _ = places.shape
        frame, whisker, _ = np.indices((n, many, nodes)).reshape(3, -1)
        out = pd.DataFrame({
            "frame": frame, "whisker": whisker, "x": places[..., 0].ravel(),
            "y": places[..., 1].ravel(),
        }).astype({"x": float, "y": float})  # fmt: skip
        if scores is not None and np.isfinite(scores).any():
            out["likelihood"] = scores.astype(float).ravel()
    except Exception as error:  # whatever h5py makes of a damaged file
        raise _unreadable(path, "SLEAP", error) from error
    if np.isfinite(places[:1]).any():  # else it was written with the empty frames before
        notes.append(
            "The file does not say the number of its first frame: frames are counted from 0, as "
            "SLEAP writes them where it keeps all frames; if it left some out, give the .slp."
        )
    if len(names) == many and names:
        out["name"] = np.array(names, dtype=object)[out["whisker"]]
        return out
    notes.append(
        "The file has no tracks, of which SLEAP writes one instance a frame here, whichever it is; "
        "if there were several whiskers, give the .slp, or track them in SLEAP."
    )
    return out.assign(label=-1)


def _missing(path: Path, package: str) -> ModuleNotFoundError:
    return ModuleNotFoundError(
        f"{path.name}: poses of this kind are read by {package}, which is not installed; write "
        'pip install "weberwhisk[tracking]".'
    )


def _unreadable(path: Path, software: str, error: Exception) -> Refusal:
    reason = " ".join(str(error).split())[:80] or type(error).__name__
    return Refusal(
        f"{path.name}: not readable as poses of {software} ({reason})",
        remedy="give the file that it wrote",
    )


# -- from points to whiskers ----------------------------------------------------------------------


def segments(points: pd.DataFrame, path: Path, likelihood: float, notes: list[str]) -> pd.DataFrame:
    """One row per whisker and frame, from one row per point.

    Points may have a `whisker`, number or name; `name`, that of a numbered whisker; `label`.
    """
    axes = ["x", "y", *(["z"] if "z" in points else [])]
    keys = ["frame", *(["whisker"] if "whisker" in points else [])]
    sure = ["likelihood"] if "likelihood" in points else []
    more = [name for name in ("name", "label") if name in points]
    points = points[[*keys, *axes, *sure, *more]].copy()
    if len(keys) > 1 and "name" not in points:
        named = points["whisker"].dropna().astype(str).str.strip()
        named = named[named != ""]
        if pd.to_numeric(named, errors="coerce").isna().any():
            points["whisker"] = pd.Series(pd.factorize(named)[0], named.index)
            points["name"] = named
            more.append("name")
    numbers = points[[*keys, *axes, *sure]].apply(pd.to_numeric, errors="coerce")
    points = points.assign(**{name: numbers[name] for name in numbers})
    usable = np.isfinite(points[[*keys, *axes]].to_numpy(dtype=float)).all(axis=1)
    if sure:
        doubtful = usable & (points["likelihood"] < likelihood).to_numpy()
        usable &= ~doubtful
        if doubtful.any():
            count = f"{doubtful.sum()} of {len(points)} points"
            notes.append(
                f"{count} less likely than {likelihood:g}: left out; write "
                + argument("likelihood", 0)
                + " to have all."
            )
        # Distances are measured from the first keypoint: another must not replace it.
        seen = pd.Series(usable).groupby([points[name].to_numpy() for name in keys])
        lost = usable & ~seen.transform("first").eq(True).to_numpy()
        if lost.any():
            usable &= ~lost
            count = counted(len(points[lost].drop_duplicates(keys)), "whisker")
            notes.append(f"{count} without a likely first keypoint: left out.")
    if usable.sum() < 2:
        raise Refusal(f"{path.name}: it has no points with numbers in frame, x and y.")
    points = points[usable]
    for name in keys:
        if (points[name] % 1 != 0).any():
            raise Refusal(
                f"{path.name}: {name} must be whole numbers from 0; is another column in its place?"
            )
    segment_rows, wrong, short = [], 0, 0
    for key, whisker_points in points.groupby(keys, sort=True):
        if len(whisker_points) < 2:
            short += 1
            continue
        wrong += _runs_to_and_fro(whisker_points[axes].to_numpy(float).T)
        score = {"score": float(whisker_points["likelihood"].median())} if sure else {}
        row = {"whisker": 0, **dict(zip(keys, key, strict=True)), **score}
        row |= {"label": row["whisker"]} if len(keys) > 1 else {}
        row |= {name: whisker_points[name].iloc[0] for name in more}
        if row.get("name") == "":
            row["label"] = -1
        segment_rows.append({**row, **segment(*whisker_points[axes].to_numpy(float).T)})
    if short:
        notes.append(f"{counted(short, 'whisker')} with a single point: left out.")
    if 2 * wrong > len(segment_rows):
        raise Refusal(
            f"{path.name}: the points of a whisker run to and fro",
            remedy=(
                "give each whisker's once and in order from follicle to tip, and several "
                "whiskers as individuals or in a column whisker"
            ),
        )
    return pd.DataFrame(segment_rows)


def _runs_to_and_fro(axes: Array) -> bool:
    """Whether the path through means of eighths of points (D, n) is twice their extent."""
    eighths = np.array_split(axes, min(8, axes.shape[1]), axis=1)
    means = np.array([part.mean(axis=1) for part in eighths])
    way = np.linalg.norm(np.diff(means, axis=0), axis=1).sum()
    return bool(way > 2 * np.linalg.norm(means[:, None] - means, axis=2).max())
