"""What trackers' files say is what is read: frames, names, lengths, −1, angles; small files each.

Right values are those of the circular arcs, labels and frames that are written here.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pandas as pd
import pytest
from analysis_scripts import load

import weberwhisk as ww
from weberwhisk.cli import app, run_app

simulate_tracking = load("tracked_session").simulate_tracking
FRAMES = [0, 1, 250, 251]


def arc(angle: float, curvature: float, length: float = 120.0, points: int = 121) -> np.ndarray:
    """Points (2, n) from (50, 150) in a direction, degrees from +x to +y, of a curvature, 1/px."""
    s = np.linspace(0, length, points)
    turned = np.radians(angle) + curvature * s / 2
    chord = s * np.sinc(curvature * s / 2 / np.pi)
    return np.stack([50 + chord * np.cos(turned), 150 + chord * np.sin(turned)])


#: Whiskers of a face at the left: their direction at the follicle, and their curvature.
ARCS = [(0.0, 0.0), (30.0, 0.002), (-40.0, 0.003), (20.0, -0.004)]


def measurements(path: Path, axis: bytes, version: bytes = b"measv3", scale: float = 1.0) -> Path:
    """Whisk's, whose angles are from +y to +x where the axis of the face is y."""
    rows = []
    for frame, (angle, curvature) in enumerate(ARCS):
        x, y = arc(angle, curvature)
        angle = 90 - angle if axis in b"yv" else angle
        values = [120.0 * scale, 7, angle, curvature, x[0], y[0], x[-1], y[-1]]
        head = np.array([frame, frame, 0, 0, -100, 150, 4, 5, 0, 8], "<i4").tobytes()
        more = axis if version == b"measv3" else axis + bytes(3) if version == b"measv2" else b""
        rows.append(head + more + np.array([*values, *[0.0] * 8], "<f8").tobytes())
    start = version + b"\0\0" + np.array([len(rows), 8], "<i4").tobytes()
    path.write_bytes(start + b"".join(rows[::-1]))
    return path


def whiskers(path: Path) -> Path:
    """Whisk's segments, every other one from the tip."""
    body = b"bwhiskbin1\0\0"
    for frame, (angle, curvature) in enumerate(ARCS):
        x, y = arc(angle, curvature)[:, :: -1 if frame % 2 else 1]
        body += np.array([0, frame, len(x)], "<i4").tobytes()
        body += np.stack([x, y, 0 * x + 1, 0 * x + 7]).astype("<f4").tobytes()
    path.write_bytes(body + np.array([len(ARCS)], "<i4").tobytes())
    return path


def summary(points: bool, **more: Any) -> pd.DataFrame:
    """WhiskiWrap's table of the arcs, from the tip as it writes them without measurements."""
    rows = []
    for frame, (angle, curvature) in enumerate(ARCS):
        x, y = arc(angle, curvature)[:, ::-1].astype("f4")
        rows.append({"fid": np.uint32(frame), "wid": np.uint16(0), "follicle_x": x[-1],
                     "follicle_y": y[-1], "tip_x": x[0], "tip_y": y[0]})  # fmt: skip
        rows[-1] |= {"pixels_x": x, "pixels_y": y} if points else {}
    return pd.DataFrame(rows).assign(**more)


def hdf5(path: Path, table: pd.DataFrame) -> Path:
    """WhiskiWrap's HDF5: a table and two columns of points."""
    plain = table.drop(columns=["pixels_x", "pixels_y"], errors="ignore")
    with h5py.File(path, "w") as file:
        text = {"face_side": "S6"} if "face_side" in plain else {}
        file["summary"] = plain.to_records(index=False, column_dtypes=text)
        for name in [n for n in ("pixels_x", "pixels_y") if n in table]:
            column = file.create_dataset(name, len(table), h5py.vlen_dtype("f4"))
            for i, values in enumerate(table[name]):
                column[i] = values
    return path


def nwb(path: Path, table: pd.DataFrame) -> Path:
    """ndx-whisk's table, column by column."""
    table = table.rename(columns={"fid": "frame_id", "wid": "whisker_id"})
    with h5py.File(path, "w") as file:
        group = file.create_group("processing/behavior/whisker_measurements")
        for name in table:
            group[name] = table[name].to_numpy()
    return path


def poses(name: str, places: np.ndarray, frames: list[int] = FRAMES, **names: Any) -> pd.DataFrame:
    """DeepLabCut's table; places are (frames, individuals, body parts, 2)."""
    people, parts = names.get("individuals"), names["bodyparts"]
    columns = [
        (name, *([who] if people else []), part, c)
        for who in people or [""]
        for part in parts
        for c in ("x", "y", "likelihood")
    ]
    levels = ["scorer", *(["individuals"] if people else []), "bodyparts", "coords"]
    values = np.concatenate([places, np.full((*places.shape[:3], 1), 0.99)], axis=3)
    values[np.isnan(values[..., 0])] = np.nan
    header = pd.MultiIndex.from_tuples(columns, names=levels)
    return pd.DataFrame(values.reshape(len(frames), -1), frames, header)


def said(table: pd.DataFrame) -> str:
    return " ".join(table.attrs["notes"])


# -- frames and names ------------------------------------------------------------------------------


@pytest.mark.parametrize("scorer", ["DLC_resnet50", "heatmap_tracker"])
@pytest.mark.parametrize("suffix", ["csv", "h5"])
def test_frames_of_poses_are_the_files(tmp_path: Path, scorer: str, suffix: str) -> None:
    """DeepLabCut and LightningPose: an offset, dropped frames, and a first row without a pose."""
    places = np.tile([[10.0, 50], [20, 50], [30, 50]], (4, 1, 1, 1))
    places[0] = np.nan
    path = tmp_path / f"a.{suffix}"
    table = poses(scorer, places, bodyparts=["p1", "p2", "p3"])
    if suffix == "csv":
        table.to_csv(path)
    else:
        pytest.importorskip("tables")
        table.to_hdf(path, key="df_with_missing")
    found = ww.read_tracking(path, frame_rate=500)
    assert found["frame"].tolist() == [1, 250, 251]
    assert found["time_s"].tolist() == [0.002, 0.5, 0.502]
    assert found["x"][0].tolist() == [10, 20, 30]
    assert "name" not in found


def test_frames_of_labelled_images_are_in_their_names(tmp_path: Path) -> None:
    places = np.tile([[10.0, 50], [20, 50], [30, 50]], (2, 1, 1, 1))
    table = poses("me", places, frames=[0, 1], bodyparts=["a", "b", "c"])
    table.index = ["labeled-data/v/img0007.png", "labeled-data/v/img0123.png"]
    table.drop(columns="likelihood", level="coords").to_csv(tmp_path / "a.csv")
    assert ww.read_tracking(tmp_path / "a.csv")["frame"].tolist() == [7, 123]
    table.index = ["labeled-data/v/img0007.png", "labeled-data/w/img0007.png"]
    table.to_csv(tmp_path / "a.csv")
    with pytest.raises(ValueError, match="labels of several videos"):
        ww.read_tracking(tmp_path / "a.csv")


def test_individuals_keep_their_names_and_order(tmp_path: Path) -> None:
    """Two whiskers B and A; and body parts of no individual, which no reader may shift."""
    places = np.arange(4 * 2 * 3 * 2, dtype=float).reshape(4, 2, 3, 2)
    table = poses("DLC", places, individuals=["B", "A"], bodyparts=["base", "k", "tip"])
    table.to_csv(tmp_path / "a.csv")
    found = ww.read_tracking(tmp_path / "a.csv")
    assert found["name"].tolist() == ["B", "A"] * 4
    assert found["whisker"].tolist() == [0, 1] * 4
    assert [v[0] for v in found["x"]] == [places[i, j, 0, 0] for i in range(4) for j in range(2)]
    assert "The file names 'B', 'A': tracked_signals(…, identity='B') takes one." in said(found)
    alone = poses("DLC", places[:, :1, :2] + 500, individuals=["single"], bodyparts=["eye", "ear"])
    pd.concat([table, alone], axis=1).to_csv(tmp_path / "b.csv")
    found = ww.read_tracking(tmp_path / "b.csv")
    assert found["name"].tolist() == ["B", "A", "single"] * 4
    assert [len(v) for v in found["x"]] == [3, 3, 2] * 4
    assert "('eye', 'ear') are points of one, called single" in said(found)
    one = alone.drop(columns="ear", level="bodyparts")
    pd.concat([table, one], axis=1).to_csv(tmp_path / "c.csv")
    found = ww.read_tracking(tmp_path / "c.csv")
    assert found["name"].tolist() == ["B", "A"] * 4
    assert "4 whiskers with a single point: left out" in said(found)


def test_points_of_named_whiskers_are_selected_by_name(
    tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    """In Python and by --label, as the note says; a name that is not there is refused."""
    whisker = ww.Whisker.from_identity("C2", curved=True)
    video, _ = simulate_tracking(whisker, 15e-3, frames=12, spacing_px=40.0, missing=0.0)
    points = video[["frame", "x", "y"]].explode(["x", "y"])
    both = pd.concat(
        [points.assign(y=points["y"] + 300, whisker="D1"), points.assign(whisker="C2")]
    )
    both.to_csv(tmp_path / "a.csv", index=False)
    found = ww.read_tracking(tmp_path / "a.csv", pixels_per_mm=20, frame_rate=500)
    assert found["name"].tolist() == ["D1", "C2"] * 12
    with pytest.raises(ValueError, match="identity='D1'"):
        ww.tracked_signals(found, whisker)
    one = ww.tracked_signals(found, whisker, identity="C2")
    alone = ww.tracked_signals(video, whisker)
    np.testing.assert_allclose(one["shape_distance_mm"], alone["shape_distance_mm"], rtol=1e-6)
    with pytest.raises(ValueError, match="no name 'B3'"):
        ww.tracked_signals(found, whisker, identity="B3")
    words = ["locate", str(tmp_path / "a.csv"), "--identity", "C2", "--curvature-per-m", "own",
             "--pixels-per-mm", "20", "--frame-rate", "500"]  # fmt: skip
    assert run_app(app, words) == 2
    assert "--label D1" in capsys.readouterr().err
    assert run_app(app, [*words, "--label", "C2", "--likelihood", "0", "--json"]) in (0, None)
    answer = json.loads(capsys.readouterr().out)
    assert [row["frame"] for row in answer["rows"]] == list(range(12))
    assert any("The file names 'D1', 'C2': --label D1 takes one" in n for n in answer["notes"]) or (
        any("identity='D1'" in n for n in answer["notes"])
    )


# -- SLEAP -----------------------------------------------------------------------------------------


def slp(path: Path, *, names: tuple[str, ...] = (), videos: int = 1) -> Path:
    """Two whiskers that start at y = 20 and 120, whose order changes from frame to frame."""
    sleap_io = pytest.importorskip("sleap_io")
    bones = sleap_io.Skeleton([f"k{i}" for i in range(7)])
    tracks = [sleap_io.Track(name) for name in names]
    films = [sleap_io.Video(filename=f"{i}.mp4", open_backend=False) for i in range(videos)]
    frames = []
    for i in range(16):
        both = []
        for j, y in enumerate((20.0, 120.0)):
            place = np.stack([np.linspace(10, 90, 7), np.full(7, y + i)], axis=1)
            both.append(sleap_io.PredictedInstance.from_numpy(
                place, skeleton=bones, track=tracks[j] if names else None, score=0.8,
                point_scores=np.full(7, 0.9)))  # fmt: skip
        frames += [sleap_io.LabeledFrame(video=film, frame_idx=2 * i + 5,
                                         instances=both[:: 1 if i % 2 else -1])
                   for film in films]  # fmt: skip
    sleap_io.save_slp(sleap_io.Labels(frames, films, [bones], tracks), str(path))
    return path


def test_sleap_without_tracks_keeps_all_whiskers_and_says_so(tmp_path: Path) -> None:
    path = slp(tmp_path / "a.slp")
    found = ww.read_tracking(path, pixels_per_mm=2.5, frame_rate=500)
    assert len(found) == 32
    assert found["frame"].tolist() == [2 * i + 5 for i in range(16) for _ in range(2)]
    assert sorted(found["follicle_y"]) == sorted(y + i for i in range(16) for y in (20, 120))
    assert (found["label"] == -1).all()
    assert "has no tracks" in said(found)
    whisker = ww.Whisker(40e-3, 60e-6, 3e-6)
    with pytest.raises(ValueError, match=r"not one whisker throughout: in \d+ of 16 frames"):
        ww.tracked_signals(found, whisker, identity=0)
    box = ww.read_tracking(path, follicles=(0, 0, 50, 60))
    assert box["follicle_y"].tolist() == [20.0 + i for i in range(16)]


def test_sleap_with_tracks_keeps_names(tmp_path: Path) -> None:
    found = ww.read_tracking(slp(tmp_path / "a.slp", names=("up", "down"), videos=2))
    assert found["name"].tolist() == ["up", "down"] * 16
    assert (found.loc[found["name"] == "down", "follicle_y"] == np.arange(120, 136)).all()
    assert "2 videos: this is the first, 0.mp4" in said(found)


@pytest.mark.parametrize("dims", [None, ["frame", "track", "node", "xy"]])
@pytest.mark.parametrize("names", [[], ["up", "down"]])
def test_sleaps_analysis_is_read_in_either_order(
    tmp_path: Path, dims: list[str] | None, names: list[str]
) -> None:
    """SLEAP has tracks first; sleap-io may have frames first, and says so in an attribute."""
    usual = ["track", "xy", "node", "frame"]
    places = np.arange(2 * 2 * 3 * 4, dtype=float).reshape(2, 2, 3, 4)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        order = [usual.index(d) for d in dims or usual]
        file["tracks"] = np.transpose(places, order)
        scores = [usual.index(d) for d in dims or usual if d != "xy"]
        file["point_scores"] = np.transpose(np.full((2, 1, 3, 4), 0.9), [*scores, 1])[..., 0]
        if dims:
            file["tracks"].attrs["dims"] = json.dumps(dims)
        file["track_names"] = np.array(names, dtype="S4") if names else np.zeros(0, dtype="S4")
        if dims is None:  # an empty frame at the beginning: all were written
            file["tracks"][..., 0] = np.nan
    found = ww.read_tracking(tmp_path / "a.h5")
    assert ("number of its first frame: frames are counted from 0" in said(found)) == bool(dims)
    frames = [0, 1, 2, 3] if dims else [1, 2, 3]
    assert found["frame"].tolist() == [frame for frame in frames for _ in range(2)]
    for _, row in found.iterrows():
        x, y = places[row["whisker"], :, :, row["frame"]]
        assert row["x"].tolist() == x.tolist()
        assert row["y"].tolist() == y.tolist()
    assert ("has no tracks" in said(found)) == (not names)
    identities = found["name"] if names else found["label"]
    assert identities.tolist() == (names or [-1, -1]) * len(frames)


# -- lengths and labels ----------------------------------------------------------------------------


@pytest.mark.parametrize("write", ["hdf5", "parquet", "csv"])
@pytest.mark.parametrize("length", [0, 85, None])
def test_lengths_of_whiskiwrap_are_those_of_its_points(
    tmp_path: Path, write: str, length: int | None
) -> None:
    """It writes 0 without measurements, or the number of points; newer ones write no length."""
    more = {} if length is None else {"pixel_length": np.uint16(length)}
    table, path = summary(True, **more), tmp_path / f"a.{write}"
    if write == "hdf5":
        hdf5(path, table)
    elif write == "parquet":
        pytest.importorskip("pyarrow")
        table.to_parquet(path)
    else:
        table.assign(
            **{n: [v.tolist() for v in table[n]] for n in ("pixels_x", "pixels_y")}
        ).to_csv(path, index=False)
    found = ww.read_tracking(path, face="left")
    np.testing.assert_allclose(found["length_px"], 120, atol=0.01)
    assert found["frame"].tolist() == [0, 1, 2, 3]
    np.testing.assert_allclose(found["angle_deg"], [a for a, _ in ARCS], atol=1)
    assert [v[0] for v in found["x"]] == [50] * 4
    assert ("pixel_length of the file is no length in pixels" in said(found)) == (
        length is not None
    )
    assert len(ww.read_tracking(path, face="left", shortest_px=100)) == 4


@pytest.mark.parametrize("write", [hdf5, nwb])
def test_lengths_without_points_are_checked_against_the_chord(
    tmp_path: Path, write: Callable[[Path, pd.DataFrame], Path]
) -> None:
    """Millimetres, as ndx-whisk says of its length; numbers of points; and a single 0."""
    chord = [np.hypot(*(p[:, -1] - p[:, 0])) for p in (arc(*a) for a in ARCS)]
    path = tmp_path / ("a.hdf5" if write is hdf5 else "a.nwb")
    for column, values, right, note in (
        ("length", [6.0] * 4, chord, "length of the file is no length in pixels (median 6"),
        ("pixel_length", [85] * 4, chord, "is by the distance from follicle to tip"),
        ("length", [120.0, 120, 120, 0], [120, 120, 120, chord[3]], "length of 1 whisker is no"),
        ("length", [120.0] * 4, [120] * 4, ""),
    ):
        write(path, summary(False, **{column: values}))
        found = ww.read_tracking(path)
        np.testing.assert_allclose(found["length_px"], right, rtol=1e-5)
        assert note in said(found)
        assert note or "no length" not in said(found)
    write(path, summary(False, length=6.0, pixel_length=[120] * 4))
    assert ww.read_tracking(path)["length_px"].tolist() == [120] * 4
    if write is nwb:
        write(path, summary(False, length=6.0).drop(columns=["tip_x", "tip_y"]))
        found = ww.read_tracking(path)
        assert "length of the file could not be checked" in said(found)


@pytest.mark.parametrize("kind", ["u1", "u2", "u4", "u8", "i4", "f4", "text", "as text"])
def test_minus_one_is_minus_one_however_it_was_stored(tmp_path: Path, kind: str) -> None:
    given = np.array([-1, 0, 1, -1])
    if "text" in kind:
        label = given.astype("u2" if kind == "as text" else int)
        path = tmp_path / "a.csv"
        summary(False, label=label).to_csv(path, index=False)
    else:
        label = given.astype(kind)
        path = hdf5(tmp_path / "a.hdf5", summary(False, label=label))
    assert ww.read_tracking(path)["label"].tolist() == [-1, 0, 1, -1]


# -- angle and curvature ---------------------------------------------------------------------------


def written(folder: Path) -> dict[str, Path]:
    """The arcs in every format that has angles or points."""
    side = {"angle": [90 - a for a, _ in ARCS], "curvature": [k for _, k in ARCS], "length": 120.0}
    out = {
        "whiskers": whiskers(folder / "a.whiskers"),
        "side": measurements(folder / "side.measurements", b"y"),
        "side, V1": measurements(folder / "v1.measurements", b"y", b"measV1"),
        "side, v2": measurements(folder / "v2.measurements", b"v", b"measv2"),
        "top": measurements(folder / "top.measurements", b"x"),
        "top, V1": measurements(folder / "top1.measurements", b"h", b"measV1"),
        "hdf5": hdf5(folder / "a.hdf5", summary(False, **side)),
        "points": hdf5(folder / "b.hdf5", summary(True, **side)),
        "side said": hdf5(folder / "c.hdf5", summary(False, face_side=[b"left"] * 4, **side)),
        "nwb": nwb(folder / "a.nwb", summary(False, **side)),
        "csv": folder / "a.csv",
    }
    summary(False, **side).to_csv(out["csv"], index=False)
    points = [arc(*a) for a in ARCS]
    pd.DataFrame(
        {
            "frame": np.repeat(range(4), 121),
            "x": np.concatenate([p[0] for p in points]),
            "y": np.concatenate([p[1] for p in points]),
        }
    ).to_csv(folder / "p.csv")
    return out | {"points alone": folder / "p.csv"}


def test_angles_and_curvatures_have_one_convention(tmp_path: Path) -> None:
    """From +x to +y, and growing in that sense towards the tip, whatever the file counts from."""
    right = np.array(ARCS)
    for name, path in written(tmp_path).items():
        found = ww.read_tracking(path, face="left")
        np.testing.assert_allclose(found["angle_deg"], right[:, 0], atol=1, err_msg=name)
        np.testing.assert_allclose(found["curvature_per_px"], right[:, 1], atol=1e-4, err_msg=name)
        other = ww.read_tracking(path, face="right")  # seen from the other end
        ends = right[:, 0] + np.degrees(120 * right[:, 1]) + 180
        off = (other["angle_deg"] - ends + 180) % 360 - 180
        np.testing.assert_allclose(off, 0, atol=1, err_msg=name)
        np.testing.assert_allclose(other["curvature_per_px"], -right[:, 1], atol=1e-4, err_msg=name)
        assert (other["tip_x"] == found["follicle_x"]).all(), name
        assert other["angle_deg"].between(-180, 180).all(), name
        whisk = name.startswith("side") or name in ("hdf5", "nwb", "csv", "points")
        assert ("counts angles from +y to +x" in said(found)) == whisk, name


def test_angles_of_no_axis_are_replaced_and_unknown_ones_are_told(tmp_path: Path) -> None:
    angles = {"angle": [170.0, -160, 150, 90], "curvature": [k for _, k in ARCS], "length": 120.0}
    found = ww.read_tracking(hdf5(tmp_path / "a.hdf5", summary(False, **angles)))
    np.testing.assert_allclose(found["angle_deg"], [a for a, _ in ARCS], atol=1)
    assert "agree with no axis" in said(found)
    table = summary(False, **angles).drop(columns=["follicle_x", "tip_x"])
    found = ww.read_tracking(nwb(tmp_path / "a.nwb", table))
    assert found["angle_deg"].tolist() == angles["angle"]
    assert "could not be checked" in said(found)
