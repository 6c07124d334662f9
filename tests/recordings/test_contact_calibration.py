"""Taps at known distances give back the whisker, the hinge and the sensor's Weber fraction."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import weberwhisk as ww
from weberwhisk.cli import app
from weberwhisk.recordings import HingedTap

TRUE = ww.Whisker(0.12, 0.8e-3, 0.2e-3, youngs_modulus=3e9)
NOMINAL = ww.Whisker(0.12, 0.8e-3, 0.4e-3, youngs_modulus=2e9)
HINGE, K = 0.012, 0.025


def _taps(gain: float = 1.0, each: int = 12, hinge: float = HINGE, seed: int = 3) -> pd.DataFrame:
    r = np.repeat(np.linspace(0.03, 0.105, 11), each)
    observer = ww.Observer(TRUE, HingedTap(hinge, gain), ww.receptors.Weber(K))
    slopes = observer.read(r[:, None], seed=seed)[:, 0]
    return pd.DataFrame({"radial_distance_mm": 1e3 * r, "moment_rate": slopes})


def test_eleven_distances_give_back_the_truth() -> None:
    """The bar: left-out errors within 2 % of the length, k within 15 %."""
    found = ww.calibrate(_taps(), NOMINAL)
    assert found.fits
    assert len(found.left_out) == 11
    assert found.left_out["error_share"].abs().max() < 0.02
    assert found.noise.weber_fraction == pytest.approx(K, rel=0.15)
    table = found.parameters
    truth = {"stiffness_N_m2": TRUE.stiffness, "apex_distance_mm": 1e3 * TRUE.apex_distance,
             "hinge_mm": 1e3 * HINGE, "weber_fraction": K}  # fmt: skip
    for name, value in truth.items():
        row = table.loc[name]
        assert abs(row["mean"] - value) < 3.5 * row["sd"], name
    assert found.effective_draws > 300
    assert np.abs(found.residuals["residual_sd"]).max() < 5


def test_counts_are_told_apart_from_stiffness_by_the_gain_and_locate_goes_by_it() -> None:
    found = ww.calibrate(_taps(gain=5e4), TRUE, counts=True)
    row = found.parameters.loc["gain"]
    assert abs(row["mean"] - 5e4) < 3.5 * row["sd"]
    taps = _taps(gain=5e4, each=4, seed=8)
    place = ww.locate(taps.drop(columns="radial_distance_mm"), found.whisker,
                      cue=found.cue, noise=found.noise)  # fmt: skip
    off = (place["radial_distance_mm"] - taps["radial_distance_mm"]) / place["sd_mm"]
    assert np.abs(off).max() < 4
    assert 0.7 < np.sqrt((off**2).mean()) < 1.4


def test_what_few_taps_leave_open_widens_the_distances() -> None:
    """By as much as the distances move from one draw of the calibration to the next."""
    taps = _taps(each=2, seed=5)
    found = ww.calibrate(taps, NOMINAL)
    at = np.array([0.04, 0.06, 0.08])
    observer = ww.Observer(TRUE, HingedTap(HINGE), ww.receptors.Weber(K))
    table = pd.DataFrame({"moment_rate": observer.signals(at[:, None])[0][:, 0]})
    exact = ww.locate(table, found.whisker, cue=found.cue, noise=found.noise)
    whole = ww.locate(table, found)
    # By hand: 1/r = 1/A + 1/(scale/slope − hinge) for each draw.
    moved, own = [], []
    for whisker, cue, noise in found.samples:
        k = noise.weber_fraction
        slopes = table["moment_rate"].to_numpy() * np.exp(k * np.array([[-1.0], [0.0], [1.0]]))
        inside = cue.gain * whisker.compliance_constant / slopes - cue.hinge
        low, middle, high = 1 / (1 / inside + 1 / whisker.apex_distance)
        moved.append(middle)
        own.append((high - low) / 2)
    total = 1e3 * np.sqrt(np.var(moved, axis=0) + np.mean(np.square(own), axis=0))
    np.testing.assert_allclose(whole["sd_mm"], total, rtol=0.1)
    assert (whole["sd_mm"] > exact["sd_mm"]).all()
    assert ((whole["lower_mm"] < 1e3 * at) & (1e3 * at < whole["upper_mm"])).all()
    with pytest.raises(ValueError, match="its own cue and noise"):
        ww.locate(table, found, noise=ww.receptors.Weber(0.1))


def test_a_touch_shares_one_calibration() -> None:
    """By hand, on a plain grid of distances: the mean over draws of the product of the rows."""
    found = ww.calibrate(_taps(each=2, seed=5), NOMINAL)
    observer = ww.Observer(TRUE, HingedTap(HINGE), ww.receptors.Weber(K))
    at = np.repeat([0.05, 0.08], 12)
    slopes = observer.read(at[:, None], seed=6)[:, 0]
    table = pd.DataFrame({"moment_rate": slopes, "touch": np.repeat([1, 2], 12)})
    located = ww.locate(table, found, touch="touch").iloc[[0, 12]]
    r, moments = np.linspace(0.03, 0.1, 4001), []
    for whisker, cue, noise in found.samples:
        own = ww.Observer(whisker, cue, noise)
        log = own.noise.log_likelihood(slopes[:, None, None], own.signals(r[:, None])[0])
        weight = np.exp([part - part.max() for part in log.reshape(2, 12, -1).sum(axis=1)])
        weight /= weight.sum(axis=1, keepdims=True)
        moments.append([weight @ r, weight @ r**2])
    mean, square = np.mean(moments, axis=0)
    sd = np.sqrt(square - mean**2)
    assert np.abs(located["touch_radial_distance_mm"] / 1e3 - mean).max() < 0.05 * sd.min()
    np.testing.assert_allclose(located["touch_sd_mm"], 1e3 * sd, rtol=0.03)
    # Twelve rows would be a third as uncertain as one, had they not the calibration in common.
    exact = ww.locate(table, found.whisker, cue=found.cue, noise=found.noise, touch="touch")
    assert (located["touch_sd_mm"] > 1.3 * exact["touch_sd_mm"].iloc[[0, 12]]).all()


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"drop": "moment_rate"}, "needs the columns"),
        ({"rows": 3}, "five taps or more"),
        ({"scale": ("radial_distance_mm", 1e3)}, "is not on a whisker"),
        ({"scale": ("radial_distance_mm", 1e-3)}, "did you pass metres"),
        ({"scale": ("moment_rate", -1)}, "above zero"),
        ({"scale": ("moment_rate", 1e6)}, "did you pass uN m/s"),
        ({"scale": ("moment_rate", 40)}, "give angular_velocity"),
    ],
)
def test_refusals(change: dict, sentence: str) -> None:
    taps = _taps(each=1)
    if "drop" in change:
        taps = taps.drop(columns=change["drop"])
    if "rows" in change:
        taps = taps.iloc[: change["rows"]]
    if "scale" in change:
        name, factor = change["scale"]
        taps[name] *= factor
    with pytest.raises(ValueError, match=sentence):
        ww.calibrate(taps, NOMINAL)


def test_columns_of_distance_and_slope_by_any_name(
    tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    from weberwhisk.cli import run_app

    taps = _taps(each=3)
    plain = ww.calibrate(taps, NOMINAL).parameters
    names = {"radial_distance": "Abstand", "moment_rate": "Steigung"}
    own = taps.set_axis([*names.values()], axis=1)
    for unit, scale in (("mm", 1.0), ("cm", 0.1), ("m", 1e-3)):
        table = own.assign(Abstand=scale * own["Abstand"])
        found = ww.calibrate(table, NOMINAL, columns=names, units={"radial_distance": unit})
        pd.testing.assert_frame_equal(found.parameters, plain)
        suffixed = table.rename(columns={"Abstand": f"d [{unit}]"})
        found = ww.calibrate(suffixed, NOMINAL, columns=names | {"radial_distance": f"d [{unit}]"})
        pd.testing.assert_frame_equal(found.parameters, plain)
    with pytest.raises(ValueError, match=r"in metres: write units=\{'radial_distance': 'mm'\}"):
        ww.calibrate(own, NOMINAL, columns=names)
    path = tmp_path / "taps.csv"
    own.to_csv(path, sep=";", decimal=",", index=False)
    words = ["calibrate", str(path), "--length-mm", "120", "--base-radius-um", "800",
             "--tip-radius-um", "400", "--youngs-modulus-gpa", "2", "--unit", "radial_distance=mm",
             "--column", "radial_distance=Abstand", "--column", "moment_rate=Steigung"]  # fmt: skip
    assert run_app(app, words) in (0, None)
    assert "The model fits" in capsys.readouterr().out


def test_fits_is_said_of_what_was_tested_alone() -> None:
    """Distances jittered by 0.01 mm are repeats; without repeats a misfit cannot be told."""
    rng = np.random.default_rng(2)
    taps = _taps()
    jittered = taps.assign(
        radial_distance_mm=taps["radial_distance_mm"] + 0.01 * rng.standard_normal(len(taps))
    )
    exact, found = ww.calibrate(taps, NOMINAL), ww.calibrate(jittered, NOMINAL)
    assert len(found.left_out) == 11
    assert found.p_value == pytest.approx(exact.p_value, abs=0.1)
    once = ww.calibrate(taps.iloc[::12], NOMINAL)
    assert np.isnan(once.p_value)
    assert not once.fits
    assert "Whether the model fits cannot be tested" in once.message
    contacts = taps.iloc[6::12].drop(columns="radial_distance_mm")
    located = ww.locate(contacts, once)
    assert located["message"].str.contains("the calibration was not tested: widened by").all()


def test_slopes_without_noise_give_back_the_sensor() -> None:
    """As a first try on computed slopes has them; with no least noise their density had no end."""
    taps = _taps(each=5)
    r = taps["radial_distance_mm"].to_numpy() / 1e3
    exact = ww.Observer(TRUE, HingedTap(HINGE)).signals(r[:, None])[0][:, 0]
    found = ww.calibrate(taps.assign(moment_rate=exact), NOMINAL)
    assert found.fits
    assert found.whisker.stiffness == pytest.approx(TRUE.stiffness, rel=1e-3)
    assert found.cue.hinge == pytest.approx(HINGE, rel=1e-2)
    assert found.noise.weber_fraction < 2e-4


def test_a_calibration_that_does_not_fit_widens_what_it_locates() -> None:
    """The slopes of every distance off by 5 % (sd), where taps scatter by 2.5 %."""
    rng = np.random.default_rng(4)
    taps = _taps()
    off = np.repeat(1 + 0.05 * rng.standard_normal(11), 12)
    found = ww.calibrate(taps.assign(moment_rate=off * taps["moment_rate"]), NOMINAL)
    assert found.p_value < 1e-6
    assert found.noise.weber_fraction == pytest.approx(K, rel=0.15)
    assert 0.02 < found.misfit < 0.12
    contacts = taps.drop(columns="radial_distance_mm").iloc[::12]
    located = ww.locate(contacts, found)
    assert located["message"].str.contains("the calibration does not fit: widened by").all()
    assert (
        located["sd_mm"] > 1.4 * ww.locate(contacts, ww.calibrate(taps, NOMINAL))["sd_mm"]
    ).all()


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    from weberwhisk.cli import run_app

    path = tmp_path / "taps.csv"
    _taps(each=3).to_csv(path, index=False)
    words = ["calibrate", str(path), "--length-mm", "120", "--base-radius-um", "800",
             "--tip-radius-um", "400", "--out", str(tmp_path / "out")]  # fmt: skip
    assert run_app(app, words) in (0, None)
    assert "weber_fraction" in capsys.readouterr().out
    contacts = _taps(each=1).rename(columns={"radial_distance_mm": "true_mm"})
    contacts.to_csv(tmp_path / "contacts.csv", index=False)
    where = ["locate", str(tmp_path / "contacts.csv"), "--taps", str(path), *words[2:-1],
             str(tmp_path / "located")]  # fmt: skip
    assert run_app(app, where) in (0, None)
    assert "The model fits" in capsys.readouterr().out
    found = pd.read_csv(tmp_path / "located" / "located.csv")
    off = (found["radial_distance_mm"] - found["true_mm"]) / found["sd_mm"]
    assert np.abs(off).max() < 3.5
    made = {p.name for p in (tmp_path / "out").iterdir()}
    assert {"parameters.csv", "residuals.csv", "left_out.csv", "calibrate.run.json",
            "calibration.png"} <= made  # fmt: skip
