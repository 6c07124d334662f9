"""Trackers' files: a real one, written ones, and damaged ones, each with one sentence."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pandas as pd
import pytest
from analysis_scripts import load

import weberwhisk as ww

simulate_tracking = load("tracked_session").simulate_tracking

REAL = Path(__file__).parents[1] / "data" / "tracking" / "test_5frames.measurements"


def _whisk(folder: Path) -> Path:
    path = folder / "a.whiskers"
    body = b"bwhiskbin1\0\0"
    for number in range(3):
        x = np.linspace(10, 60, 20, dtype="<f4")
        values = np.concatenate([x, 2 * x, np.ones(20, "<f4"), np.full(20, 5, "<f4")])
        body += np.array([number, 7, 20], "<i4").tobytes() + values.astype("<f4").tobytes()
    path.write_bytes(body + np.array([3], "<i4").tobytes())
    return path


def _hdf5(folder: Path) -> Path:
    path = folder / "a.hdf5"
    rows = np.zeros(2, [("time", "u4"), ("id", "u2"), ("tip_x", "f4"), ("tip_y", "f4"),
                        ("fol_x", "f4"), ("fol_y", "f4"), ("pixlen", "u2")])  # fmt: skip
    rows["time"], rows["id"], rows["tip_x"], rows["pixlen"] = [3, 4], [0, 1], [50, 60], [51, 61]
    with h5py.File(path, "w") as file:
        file["summary"] = rows
    return path


def _nwb(folder: Path) -> Path:
    path = folder / "a.nwb"
    with h5py.File(path, "w") as file:
        group = file.create_group("processing/behavior/WhiskerMeasurements")
        for name, values in {"frame_id": [0, 1], "whisker_id": [0, 0], "tip_x": [5.0, 6.0],
                             "angle": [30.0, 31.0], "length": [80.0, 81.0]}.items():  # fmt: skip
            group[name] = np.array(values)
    return path


def _wrapped(folder: Path) -> Path:
    """WhiskiWrap's newer table: every label 0, points from the tip."""
    path = folder / "wrapped.hdf5"
    rows = np.zeros(4, [("fid", "u4"), ("wid", "u2"), ("label", "i2"), ("tip_x", "f4"),
                        ("tip_y", "f4"), ("follicle_x", "f4"), ("follicle_y", "f4"),
                        ("angle", "f4"), ("length", "f4")])  # fmt: skip
    rows["fid"], rows["wid"], rows["tip_x"] = [0, 0, 1, 1], [0, 1, 0, 1], 50
    with h5py.File(path, "w") as file:
        file["summary"] = rows
        for name, values in (("x", np.linspace(50, 0, 11)), ("y", np.zeros(11))):
            column = file.create_dataset(f"pixels_{name}", 4, h5py.vlen_dtype("f4"))
            for i in range(4):
                column[i] = values
    return path


WRITERS = {"whiskers": _whisk, "hdf5": _hdf5, "nwb": _nwb, "wrapped": _wrapped}


def test_the_real_file() -> None:
    """Lengths are those between follicle and tip or longer, frames ascend, two whiskers a frame."""
    table = ww.read_tracking(REAL)
    assert table["frame"].unique().tolist() == [0, 1, 2, 3, 4]
    straight = np.hypot(table["tip_x"] - table["follicle_x"], table["tip_y"] - table["follicle_y"])
    assert (table["length_px"] > 0.99 * straight).all()
    assert (straight > 0.5 * table["length_px"]).mean() > 0.95
    long = ww.read_tracking(REAL, shortest_px=200, pixels_per_mm=20, frame_rate=500)
    assert 1 <= long.groupby("frame").size().median() <= 3
    np.testing.assert_allclose(long["length_mm"], 0.05 * long["length_px"])
    assert long["time_s"].max() == pytest.approx(4 / 500)
    low = long["follicle_x"].min()
    assert len(ww.read_tracking(REAL, shortest_px=200, follicles=(low, 0, low, 1e4))) == 1
    assert "pixels_per_mm" in table.attrs["notes"][-1]


def test_what_is_written_is_read(tmp_path: Path) -> None:
    tables = {name: ww.read_tracking(write(tmp_path)) for name, write in WRITERS.items()}
    assert tables["whiskers"]["length_px"].round(3).tolist() == [round(50 * 5**0.5, 3)] * 3
    assert tables["whiskers"]["x"][0].shape == (20,)
    np.testing.assert_allclose(tables["whiskers"]["angle_deg"], np.degrees(np.arctan(2)), rtol=1e-6)
    np.testing.assert_allclose(tables["whiskers"]["curvature_per_px"], 0.0, atol=1e-8)
    assert tables["whiskers"]["frame"].tolist() == [7, 7, 7]
    assert tables["hdf5"][["frame", "tip_x", "length_px"]].to_numpy().tolist() == [
        [3, 50, 51], [4, 60, 61]]  # fmt: skip
    assert tables["nwb"]["angle_deg"].tolist() == [30, 31]
    assert [v[0] for v in tables["wrapped"]["x"]] == [0] * 4


@pytest.mark.parametrize("kind", [b"bwhiskpoly1", b"whisk1", b"whiskold"])
def test_other_kinds_are_refused_by_name(tmp_path: Path, kind: bytes) -> None:
    path = tmp_path / "a.whiskers"
    path.write_bytes(kind + bytes(40))
    with pytest.raises(ValueError, match=kind.decode()):
        ww.read_tracking(path)


def test_every_damaged_file_has_one_sentence(tmp_path: Path) -> None:
    """300 files cut, with other bytes, other magic, big-endian or with text for numbers."""
    rng = np.random.default_rng(18)
    sources = [REAL, *(write(tmp_path) for write in WRITERS.values())]
    read, sentences = 0, []
    for i in range(300):
        source = sources[i % len(sources)]
        data = bytearray(source.read_bytes())
        damage = (i // len(sources)) % 5
        if damage == 0:
            data = data[: rng.integers(0, len(data))]
        elif damage == 1:
            data[:4] = rng.bytes(4)
        elif damage == 2:  # a header of the other byte order
            data[8:16] = data[8:12][::-1] + data[12:16][::-1]
        elif damage == 3:
            for at in rng.integers(0, len(data), 8):
                data[at] = rng.integers(256)
        else:
            data += rng.bytes(int(rng.integers(1, 40)))
        path = tmp_path / f"broken{source.suffix}"
        path.write_bytes(bytes(data))
        try:
            table = ww.read_tracking(path)
        except ValueError as error:
            sentences.append(str(error))
        else:  # damage to a number in the middle is a number
            read += 1
            assert len(table)
            assert (table["frame"] >= 0).all()
    assert len(sentences) > 100
    assert read + len(sentences) == 300
    for sentence in sentences:
        assert "\n" not in sentence
        assert sentence.endswith((".", "?"))


def test_tables_of_points_with_gaps_swapped_columns_and_other_scales(tmp_path: Path) -> None:
    """NaN and text leave points out; a column in another's place, and mm for m, are told."""
    whisker = ww.Whisker.from_identity("C2", curved=True)
    video, _ = simulate_tracking(whisker, 15e-3, frames=30, spacing_px=20.0, missing=0.0)
    points = video[["frame", "x", "y"]].explode(["x", "y"]).reset_index(drop=True)
    path, rng = tmp_path / "points.csv", np.random.default_rng(18)
    gaps = points.astype(object)
    for _ in range(60):
        cell = rng.choice(np.array(["", "nan", "x", "inf"], dtype=object))
        gaps.iat[rng.integers(len(gaps)), rng.integers(1, 3)] = cell
    gaps.to_csv(path, index=False)
    found = ww.read_tracking(path)
    assert found["frame"].tolist() == video["frame"].tolist()
    assert sum(map(len, found["x"])) < sum(map(len, video["x"]))
    assert all(np.isfinite(v).all() for v in found["x"])
    swapped = points.rename(columns={"frame": "x", "x": "frame"})
    swapped.to_csv(path, index=False)
    with pytest.raises(ValueError, match=r"points\.csv: frame must be whole numbers"):
        ww.read_tracking(path)
    points.to_csv(path, index=False)
    for scale in (20e3, 20e-3):  # pixels a metre, or metres a pixel
        table = ww.read_tracking(path, pixels_per_mm=scale, frame_rate=500)
        with pytest.raises(ValueError, match="correct one of them"):
            ww.tracked_signals(table, whisker)


def test_whiskers_are_turned_to_the_face(tmp_path: Path) -> None:
    """Segments stored from either end: the face is asked for, or where ends move least."""
    rng = np.random.default_rng(1)
    body = b"bwhiskbin1\0\0"
    for i in range(60):
        turn = 0.6 * np.sin(i / 5)
        x, y = 50 + 200 * np.linspace(0, 1, 40), 90 + 200 * turn * np.linspace(0, 1, 40)
        points = np.stack([x, y, x * 0 + 1, x * 0 + 9])[:, :: rng.choice([-1, 1])]
        body += np.array([0, i, 40], "<i4").tobytes() + points.astype("<f4").tobytes()
    path = tmp_path / "a.whiskers"
    path.write_bytes(body + np.array([60], "<i4").tobytes())
    found = ww.read_tracking(path)
    assert (found["follicle_x"] == 50).all()
    assert (found["tip_x"] == 250).all()
    assert [v[0] for v in found["x"]] == found["follicle_x"].tolist()
    assert "at the left, where whiskers' ends move least" in found.attrs["notes"][0]
    other = ww.read_tracking(path, face="right")
    assert (other["follicle_x"] == 250).all()
    assert not any("face" in note for note in other.attrs["notes"])
    with pytest.raises(ValueError, match="face"):
        ww.read_tracking(path, face="up")


def _slp(poses: Any, path: Path) -> None:
    """SLEAP's own project file."""
    import sleap_io

    place = poses["position"].to_numpy()
    bones = sleap_io.Skeleton(list("abcd"))
    tracks = [sleap_io.Track(name) for name in ("w0", "w1")]
    video = sleap_io.Video(filename="a.mp4", open_backend=False)
    video.backend_metadata["shape"] = (3, 99, 99, 1)
    frames = [
        sleap_io.LabeledFrame(video=video, frame_idx=i, instances=[
            sleap_io.PredictedInstance.from_numpy(
                place[i, :, :, w].T, skeleton=bones, track=track, score=1.0,
                point_scores=np.ones(4))
            for w, track in enumerate(tracks) if np.isfinite(place[i, :, :, w]).all()
        ])
        for i in range(3)
    ]  # fmt: skip
    labels = sleap_io.Labels(frames, [video], [bones], tracks)
    sleap_io.save_slp(labels, str(path))


@pytest.mark.parametrize("kind", ["sleap", "slp", "dlc", "csv"])
def test_poses_that_movement_wrote_are_read(tmp_path: Path, kind: str) -> None:
    load_poses = pytest.importorskip("movement.io.load_poses")
    from movement.io import save_poses

    place = np.arange(3 * 2 * 4 * 2, dtype=float).reshape(3, 2, 4, 2)  # time, xy, keypoints, rats
    place[1, :, :, 1] = np.nan
    poses = load_poses.from_numpy(place, np.ones((3, 4, 2)), ["w0", "w1"], list("abcd"), fps=100)
    path = tmp_path / ("poses.h5" if kind in ("sleap", "dlc") else f"poses.{kind}")
    if kind == "sleap":
        save_poses.to_sleap_analysis_file(poses, path)
    elif kind == "slp":
        _slp(poses, path)
    else:
        save_poses.to_dlc_file(poses, path, split_individuals=False)
    found = ww.read_tracking(path)
    assert found["frame"].tolist() == [0, 0, 1, 2, 2]
    assert found["whisker"].tolist() == [0, 1, 0, 0, 1]
    assert found["x"][1].tolist() == place[0, 0, :, 1].tolist()
    assert found["y"][3].tolist() == place[2, 1, :, 0].tolist()
    if kind != "csv":
        path.write_bytes(path.read_bytes()[:3000])
        with pytest.raises(ValueError, match=r"poses\.(h5|slp): "):
            ww.read_tracking(path)


def test_poses_ask_for_what_reads_them_where_it_is_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "sleap_io", None)
    path = tmp_path / "poses.slp"
    path.write_bytes(b"\x89HDF\r\n")
    with pytest.raises(ModuleNotFoundError, match=r"weberwhisk\[tracking\]"):
        ww.read_tracking(path)


def test_a_whisker_without_its_first_keypoint_is_left_out(tmp_path: Path) -> None:
    """The next keypoint would stand for the base, from which distances are."""
    table = pd.DataFrame({"frame": np.repeat([0, 1, 2, 3], 3), "x": [0.0, 5, 10] * 4, "y": 0.0})
    table["likelihood"] = [1, 1, 1, 0.1, 1, 1, 1, 0.1, 1, 1, 1, 1]
    table.loc[9, "x"] = np.nan
    table.to_csv(tmp_path / "a.csv", index=False)
    found = ww.read_tracking(tmp_path / "a.csv")
    assert found["frame"].tolist() == [0, 2]
    assert [v.tolist() for v in found["x"]] == [[0, 5, 10], [0, 10]]
    assert "2 whiskers without a likely first keypoint" in found.attrs["notes"][1]


def test_points_out_of_order_and_from_the_tip_are_told(tmp_path: Path) -> None:
    """Shuffled, twice, and of two whiskers in one: they run to and fro."""
    whisker = ww.Whisker.from_identity("C2", curved=True)
    video, _ = simulate_tracking(whisker, 15e-3, frames=25, spacing_px=40.0, noise_px=0.1)
    path = tmp_path / "points.csv"
    points = video[["frame", "x", "y"]].explode(["x", "y"])
    points.to_csv(path, index=False)
    found = ww.read_tracking(path)
    curvature = whisker.curvature / 20e3
    np.testing.assert_allclose(found["curvature_per_px"][:5], curvature, rtol=0.05)
    assert found["angle_deg"].abs().max() < 35
    other = points.assign(y=points["y"] + 90)
    for wrong in (points.sample(frac=1, random_state=1), pd.concat([points, points]),
                  pd.concat([points, other])):  # fmt: skip
        wrong.to_csv(path, index=False)
        with pytest.raises(ValueError, match="run to and fro"):
            ww.read_tracking(path)
    points[::-1].to_csv(path, index=False)
    assert any("if they run from the tip" in note for note in ww.read_tracking(path).attrs["notes"])
    right = ww.read_tracking(path, face="left")
    np.testing.assert_allclose(right["follicle_x"], found["follicle_x"])
