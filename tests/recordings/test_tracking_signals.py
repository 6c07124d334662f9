"""From a tracked video to signals and distances: a synthetic session, and its truth."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from analysis_scripts import load
from short_forms import slow_but

import weberwhisk as ww

simulate_tracking = load("tracked_session").simulate_tracking

C2 = ww.Whisker.from_identity("C2", curved=True)


def _scene(seed: int, distances: list[float], *, frames: int, **options: float):
    """Signals of a session with noise of 0.3 px at 0.05 mm a pixel, and the truth beside them."""
    known = {"spacing_px": 6.0, "whisking_hz": 12.5, "deflection": 0.25} | options
    video, truth = simulate_tracking(C2, distances, frames=frames, seed=seed, **known)
    return video, truth.set_index("frame").loc[video["frame"]].set_index(video.index)


def _covered(found: pd.DataFrame, truth: pd.DataFrame) -> pd.Series:
    inside = (found["lower_mm"] < truth["radial_distance_mm"]) & (
        truth["radial_distance_mm"] < found["upper_mm"]
    )
    return inside[truth["contact"]]


def test_shapes_are_those_of_the_planar_beam() -> None:
    """Moment, forces, distance and angle of the fit's own integration beside `press`."""
    from weberwhisk.recordings.shapes import Shapes

    r, more = np.array([10e-3, 15e-3, 20e-3, 15e-3]), np.array([0.1, 0.2, 0.2, 0.2])
    tilt = np.array([0, 0, 0, 0.3])
    b = ww.press(C2, r, ww.mechanics.rest_angle(C2, r) + more, tilt)
    shapes = Shapes(ww.mechanics.Profile.of(C2), 1.0)
    p = np.zeros((4, 12))
    p[:, 2], p[:, 3] = shapes.place(b.arc_length / C2.length), b.force / C2.force_scale
    p[:, 4], p[:, 5] = tilt, C2.curvature * C2.length
    found = shapes.signals(p) * [C2.moment_scale, C2.force_scale, C2.force_scale, C2.length, 1]
    wanted = (b.moment, b.axial_force, b.transverse_force, b.radial_distance, b.deflection_angle)
    np.testing.assert_allclose(found, np.stack(wanted, axis=1), rtol=3e-6)


@pytest.mark.parametrize(
    ("seeds", "frames"), [([1], 80), pytest.param(range(20), 200, marks=pytest.mark.slow)]
)
@pytest.mark.slow  # of a scene: with its pole, below
def test_a_session_gives_back_its_distances(seeds: list[int], frames: int) -> None:
    """The bar: within 0.5 mm in the median, and 95 % intervals that contain 92 to 98 %."""
    errors, covered, alarms = [], [], []
    for seed in seeds:
        video, truth = _scene(seed, [12e-3, 16e-3, 20e-3, 24e-3], frames=frames)
        signals = ww.tracked_signals(video, C2)
        found = ww.locate(signals, C2)
        seen = truth["contact"] & signals["contact"]
        alarms.append((signals["contact"] & ~truth["contact"])[~truth["contact"]])
        errors.append((found["radial_distance_mm"] - truth["radial_distance_mm"])[seen])
        covered.append(_covered(found[seen], truth[seen]))
        assert any("agree: slope" in note for note in signals.attrs["notes"])
        assert (found["status"][seen] == "converged").all()
        assert (errors[-1].abs() / found["sd_mm"][seen]).max() < 6
        assert (found["status"][~signals["contact"]] == "no_contact").all()
    assert pd.concat(errors).abs().median() < 0.15
    share = pd.concat(covered).mean()
    assert (0.92 if len(seeds) > 1 else 0.85) < share <= (0.98 if len(seeds) > 1 else 1)
    assert pd.concat(alarms).mean() < 0.02


def test_a_pole_gives_the_distance_and_the_mechanics_check_it() -> None:
    video, truth = _scene(2, [12e-3, 20e-3], frames=80)
    pole = truth[["pole_x", "pole_y"]].to_numpy()
    right = ww.tracked_signals(video, C2, pole=pole, pole_sd_px=0.05)
    both = right["contact"] & truth["contact"]
    for name in ("pole_distance", "shape_distance"):
        z = (right[f"{name}_mm"] - truth["radial_distance_mm"]) / right[f"{name}_sd_mm"]
        assert 0.5 < np.sqrt((z[both] ** 2).mean()) < 1.5, name
    for name in ("moment", "axial_force", "transverse_force"):
        unit = "uNm" if name == "moment" else "uN"
        z = (right[f"{name}_{unit}"] - truth[f"{name}_{unit}"]) / right[f"{name}_sd_{unit}"]
        assert 0.5 < np.sqrt((z[both] ** 2).mean()) < 1.5, name
    ratio = right["pole_distance_sd_mm"] / right["shape_distance_sd_mm"]
    assert ratio[both].median() < 0.8
    assert "agree: slope" in right.attrs["notes"][1]
    wrong = ww.tracked_signals(video, C2, pole=pole + np.array([40.0, 0.0]))
    assert "DO NOT agree" in wrong.attrs["notes"][1]
    assert "does not fit" in wrong.attrs["notes"][2]


def test_errors_of_moment_and_forces_are_those_of_monte_carlo_over_the_fit() -> None:
    """By slopes, as they are had, and by 2000 draws of the fit's own covariance."""
    from weberwhisk.recordings.shapes import BENT, Extra, Shapes, points_of
    from weberwhisk.recordings.signals import _bent

    video, truth = _scene(2, [12e-3, 20e-3], frames=80)
    some = video[truth["contact"].to_numpy()]
    shapes = Shapes(ww.mechanics.Profile.of(C2), 1.0)
    unit = 20e3 * C2.length
    points = points_of(some, np.eye(2), unit)
    points = points._replace(weight=points.weight * unit / 0.3)
    first = np.zeros((len(some), 12))
    first[:, 0] = np.angle(points.at[:, 2] - points.base)
    first[:, 5] = C2.curvature * C2.length
    start = first[:, 5:8] + [0.3, 0.0, 0.0]
    p, _, points = _bent(shapes, first, start, points, Extra(base_sd=0.3 / unit))
    own, signals, _ = shapes.covariance(p, points, Extra(base_sd=0.3 / unit), BENT)
    held = shapes.contact_arc(p)
    clear = np.flatnonzero((held > 0.2) & (held < 0.9))[:12]
    rng, ratio = np.random.default_rng(1), []
    for i in clear:
        drawn = np.tile(p[i], (2000, 1))
        drawn[:, list(BENT)] += rng.multivariate_normal(np.zeros(len(BENT)), own[i], 2000)
        ratio.append(shapes.signals(drawn).std(axis=0) / np.sqrt(np.diagonal(signals[i])))
    assert len(ratio) > 6
    np.testing.assert_allclose(np.median(ratio, axis=0), 1.0, atol=0.05)
    np.testing.assert_allclose(ratio, 1.0, atol=0.25)


@pytest.mark.parametrize("slip", slow_but([True, False], (0,)))
def test_errors_of_the_first_point_along_the_whisker_count_and_movement_does_not(
    slip: bool,
) -> None:
    """Only the first point off by 0.3 mm, or whiskers as a whole moved by as much."""
    video, truth = _scene(1, [12e-3, 16e-3, 20e-3], frames=80)
    rng = np.random.default_rng(1)
    for x, y in zip(video["x"], video["y"], strict=True):
        off = 6 * rng.standard_normal() * np.array([x[3] - x[0], y[3] - y[0]])
        off /= np.hypot(x[3] - x[0], y[3] - y[0])
        some = slice(0, 1 if slip else None)
        x[some], y[some] = x[some] + off[0], y[some] + off[1]
    found = ww.tracked_signals(video, C2)
    both = found["contact"] & truth["contact"]
    sd = found["shape_distance_sd_mm"][both]
    z = (found["shape_distance_mm"] - truth["radial_distance_mm"])[both] / sd
    assert 0.5 < np.sqrt((z**2).mean()) < 2
    assert (sd.median() > 0.15) == slip
    assert any("first points" in note for note in found.attrs["notes"]) == slip


@pytest.mark.slow
def test_the_middle_of_a_thick_pole_lies_behind_the_contact() -> None:
    video, truth = _scene(2, [15e-3], frames=50, noise_px=0.1)
    middle = truth[["pole_x", "pole_y"]].to_numpy() @ [1, 1j]
    for i, arc in truth["arc_length_mm"].dropna().items():
        at, z = round(20 * arc / 6), video.loc[i, "x"] + 1j * video.loc[i, "y"]
        along = z[at + 4] - z[at - 4]
        middle[truth.index.get_loc(i)] -= 12 * 1j * along / abs(along)
    pole = np.stack([middle.real, middle.imag], axis=1)
    right = ww.tracked_signals(video, C2, pole=pole, pole_radius_px=12)
    off = (right["pole_distance_mm"] - 15)[truth["contact"]]
    assert off.abs().median() < 0.05
    assert right["misfit"].median() < 2
    assert ww.tracked_signals(video, C2, pole=pole)["misfit"].median() > 2


@pytest.mark.slow  # of signals by themselves: test_locate.py
def test_either_side_of_a_curved_whisker_and_hidden_contacts() -> None:
    """Concave, convex from the other side (a mirrored video), and the base half alone."""
    from dataclasses import replace

    video, truth = _scene(3, [16e-3], frames=45)
    mirrored = video.assign(y=[-y for y in video["y"]])
    half = video.assign(**{a: [v[: len(v) // 2] for v in video[a]] for a in "xy"})
    hollow, behind = simulate_tracking(
        replace(C2, curvature=-C2.curvature), 16e-3, frames=45, spacing_px=6.0,
        whisking_hz=12.5, deflection=0.25, seed=3,
    )  # fmt: skip
    behind = behind.set_index("frame").loc[hollow["frame"]].set_index(hollow.index)
    found = {}
    for name, table, true in (("as it is", video, truth), ("mirrored", mirrored, truth),
                              ("half", half, truth), ("concave", hollow, behind)):  # fmt: skip
        signals = ww.tracked_signals(table, C2)
        seen = signals["contact"] & true["contact"]
        signals, true = signals[seen].iloc[::3], true[seen].iloc[::3]
        found[name] = ww.locate(signals, C2)
        assert _covered(found[name], true).mean() > 0.75, name
    same, other = found["as it is"], found["mirrored"]
    np.testing.assert_allclose(other["radial_distance_mm"], same["radial_distance_mm"], rtol=1e-6)
    assert (other["side"] == -same["side"]).all()
    assert (found["half"]["sd_mm"].median() > 2 * same["sd_mm"].median()) & (len(same) > 4)
    # Receptors come on top, and what tracking alone leaves is told beside it.
    both = ww.locate(signals.iloc[:3], C2, noise=0.1)
    np.testing.assert_allclose(both["measurement_sd_mm"], found["concave"]["sd_mm"].iloc[:3])
    assert (both["sd_mm"] > 2 * both["measurement_sd_mm"]).all()


def test_points_in_space_are_taken_in_the_plane_that_they_sweep() -> None:
    video, truth = _scene(4, [15e-3], frames=45, spacing_px=20.0)
    pole = truth[["pole_x", "pole_y"]].to_numpy()
    turn = np.array([[1, 0], [0, np.cos(0.6)], [0, np.sin(0.6)]])
    points = [turn @ np.stack(row) for row in video[["x", "y"]].to_numpy()]
    space = video.assign(**{a: [p[i] for p in points] for i, a in enumerate("xyz")})
    flat = ww.tracked_signals(video, C2, pole=pole)
    found = ww.tracked_signals(space, C2, pole=pole @ turn.T)
    for name in ("moment_uNm", "shape_distance_mm", "pole_distance_mm", "side"):
        np.testing.assert_allclose(found[name], flat[name], atol=1e-6)
    bulge = space.assign(z=[z + 0.3 * x * (-1) ** i for i, (x, z) in enumerate(
        zip(space["x"], space["z"], strict=True))])  # fmt: skip
    with pytest.raises(ValueError, match="sweep no plane"):
        ww.tracked_signals(bulge, C2)


def test_false_alarms_are_as_stated_and_contacts_may_be_given() -> None:
    from weberwhisk.recordings.shapes import free_frames, median_shape

    rng = np.random.default_rng(5)
    root = np.array([[1, 0, 0], [-0.9, 0.4, 0], [0.5, -0.6, 0.2]])
    bends = rng.standard_normal((20_000, 3)) @ root.T
    bends[:6000] += [30.0, 0.0, 0.0]
    taken = ~free_frames(bends, 0.01)
    assert taken[:6000].all()
    assert taken[6000:].mean() == pytest.approx(0.01, abs=0.003)
    # Medians one by one are some hundred sds off along what hardly varies.
    thin = rng.standard_normal((400, 3)) * [1, 1, 1e-3]
    thin = thin @ np.array([[1, 0, 1], [0, 1, -1], [0, 0, 1]])
    off = median_shape(thin) @ np.linalg.inv(np.cov(thin.T)) @ median_shape(thin)
    assert off * 400 / (np.pi / 2) < 16
    video, truth = _scene(4, [15e-3], frames=40)
    signals = ww.tracked_signals(video.assign(held=truth["contact"]), C2, contact="held")
    assert (signals["contact"] == truth["contact"]).all()


@pytest.mark.parametrize(
    ("change", "options", "sentence"),
    [
        ("no scale", {}, "pixels_per_mm=20, frame_rate=500"),
        ("no points", {}, "measurements alone"),
        ("two whiskers", {}, "identity=0"),
        ("two whiskers", {"identity": 7}, "no whisker 7"),
        ("twice", {"identity": "0"}, "Frame 0 has two rows"),
        ("one frame", {}, "ten frames without contact, got 1"),
        ("", {"pixels_per_mm": 10}, "no more than it is long"),
        ("", {"pixels_per_mm": 20e3}, "a tenth of it is needed"),
        ("", {"contact": [True] * 40}, "ten frames"),
        ("", {"pole": [1.0, 2.0, 3.0]}, "pole must be"),
        ("", {"false_alarms": 2}, "below 1"),
    ],
)
def test_what_is_missing_is_asked_for_in_a_sentence(
    change: str, options: dict, sentence: str
) -> None:
    video, _ = simulate_tracking(C2, 15e-3, frames=40, missing=0.0, spacing_px=20.0)
    if change == "no scale":
        video.attrs = {}
    if change == "no points":
        video = video.drop(columns=["x", "y"])
    attrs = video.attrs
    if change in ("two whiskers", "twice"):
        video = pd.concat([video, video.assign(whisker=int(change != "twice"))])
    if change == "one frame":
        video = video.iloc[:1]
    video.attrs = attrs
    with pytest.raises(ValueError, match=sentence) as caught:
        ww.tracked_signals(video, C2, **options)
    assert "\n" not in str(caught.value)


def test_the_command_goes_from_a_trackers_file_to_distances(
    tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    from weberwhisk.cli import app, run_app

    video, truth = _scene(4, [15e-3], frames=40)
    body = b"bwhiskbin1\0\0"
    for i, row in video.iterrows():
        x, y = ((v - v.min()) for v in (row["x"], -row["y"]))
        points = np.stack([x, y, x * 0 + 1, x * 0 + 9])[:, :: 1 if i % 3 else -1]
        body += np.array([0, row["frame"], len(x)], "<i4").tobytes()
        body += points.astype("<f4").tobytes()
    path = tmp_path / "session.whiskers"
    path.write_bytes(body + np.array([len(video)], "<i4").tobytes())
    words = ["locate", str(path), "--identity", "C2", "--pixels-per-mm", "20", "--frame-rate",
             "500", "--face", "left", "--out", str(tmp_path / "out")]  # fmt: skip
    assert run_app(app, words) in (0, None)
    said = capsys.readouterr().out
    assert "contact × force" in said
    located = pd.read_csv(tmp_path / "out" / "located.csv")
    held = located["radial_distance_mm"].notna()
    assert 0 <= truth["contact"].sum() - held.sum() <= 2  # the lightest
    assert abs(located["radial_distance_mm"][held].median() - 15) < 0.1
    assert run_app(app, [*words[:4], "--frame-rate", "500"]) == 2
    assert "--pixels-per-mm 20" in capsys.readouterr().err
