"""Trackers' files: a real one, written ones, and damaged ones, each with one sentence."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest

import weberwhisk as ww

pytestmark = pytest.mark.once  # arithmetic in which ArviZ has no part

REAL = Path(__file__).parent / "data" / "tracking" / "test_5frames.measurements"


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


def _dlc(folder: Path) -> Path:
    path = folder / "a.csv"
    path.write_text("scorer,n,n,n,n,n,n\nbodyparts,base,base,base,tip,tip,tip\n"
                    "coords,x,y,likelihood,x,y,likelihood\n"
                    "0,0,0,1,3,4,1\n1,0,0,1,6,8,1\n")  # fmt: skip
    return path


WRITERS = {"whiskers": _whisk, "hdf5": _hdf5, "nwb": _nwb, "dlc": _dlc}


def test_the_real_file() -> None:
    """Lengths are those between follicle and tip or longer, frames ascend, two whiskers a frame."""
    table = ww.read_tracking(REAL)
    assert table["frame"].unique().tolist() == [0, 1, 2, 3, 4]
    straight = np.hypot(table["tip_x"] - table["follicle_x"], table["tip_y"] - table["follicle_y"])
    assert (table["length_px"] > 0.99 * straight).all()
    assert (straight > 0.5 * table["length_px"]).mean() > 0.95
    long = ww.read_tracking(REAL, shortest_px=200, mm_per_px=0.05, frame_rate=500)
    assert 1 <= long.groupby("frame").size().median() <= 3
    np.testing.assert_allclose(long["length_mm"], 0.05 * long["length_px"])
    assert long["time_s"].max() == pytest.approx(4 / 500)
    low = long["follicle_x"].min()
    assert len(ww.read_tracking(REAL, shortest_px=200, follicles=(low, 0, low, 1e4))) == 1
    assert "mm_per_px" in table.attrs["notes"][0]


def test_what_is_written_is_read(tmp_path: Path) -> None:
    tables = {name: ww.read_tracking(write(tmp_path)) for name, write in WRITERS.items()}
    assert tables["whiskers"]["length_px"].round(3).tolist() == [round(50 * 5**0.5, 3)] * 3
    assert tables["whiskers"]["x"][0].shape == (20,)
    assert tables["whiskers"]["frame"].tolist() == [7, 7, 7]
    assert tables["hdf5"][["frame", "tip_x", "length_px"]].to_numpy().tolist() == [
        [3, 50, 51], [4, 60, 61]]  # fmt: skip
    assert tables["nwb"]["angle_deg"].tolist() == [30, 31]
    assert tables["dlc"]["length_px"].tolist() == [5, 10]


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


def test_a_table_of_points_needs_its_columns(tmp_path: Path) -> None:
    path = tmp_path / "points.csv"
    pd.DataFrame({"frame": [0, 0], "u": [1, 2]}).to_csv(path, index=False)
    with pytest.raises(ValueError, match="frame, x and y"):
        ww.read_tracking(path)
    with pytest.raises(FileNotFoundError):
        ww.read_tracking(tmp_path / "none.whiskers")
