"""Taps at known distances give back the whisker, the hinge and the sensor's Weber fraction."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy import stats
from scipy.special import logsumexp

import weberwhisk as ww
from weberwhisk.cli import app
from weberwhisk.recordings import HingedTap
from weberwhisk.recordings.taps import TapModel

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
    for draw in found.samples.itertuples():
        sd = np.hypot(draw.weber_fraction, draw.misfit)
        slopes = table["moment_rate"].to_numpy() * np.exp(sd * np.array([[-1.0], [0.0], [1.0]]))
        inside = 3 * draw.stiffness_N_m2 / slopes - draw.hinge_mm / 1e3
        low, middle, high = 1 / (1 / inside + 1e3 / draw.apex_distance_mm)
        moved.append(middle)
        own.append((high - low) / 2)
    total = 1e3 * np.sqrt(np.var(moved, axis=0) + np.mean(np.square(own), axis=0))
    np.testing.assert_allclose(whole["sd_mm"], total, rtol=0.1)
    assert (whole["sd_mm"] > exact["sd_mm"]).all()
    assert ((whole["lower_mm"] < 1e3 * at) & (1e3 * at < whole["upper_mm"])).all()
    with pytest.raises(ValueError, match="its own cue and noise"):
        ww.locate(table, found, noise=ww.receptors.Weber(0.1))


def _weights_by_hand(found: ww.recordings.Calibration, slopes: np.ndarray, r: np.ndarray):
    """Posterior of distance on a grid, gross rows and misfits summed over one by one."""
    z = np.linspace(-4.5, 4.5, 61)
    total = np.zeros(r.size)
    for draw in found.samples.iloc[::8].itertuples():
        k, scale = draw.weber_fraction, 3 * draw.stiffness_N_m2
        beam = 1 / (1 / r - 1e3 / draw.apex_distance_mm)
        mean = scale / (beam + draw.hinge_mm / 1e3)
        off = slopes[:, None, None] / mean[:, None] - 1  # slope, distance, misfit
        own = 0.99 * stats.norm.pdf(off, draw.misfit * z, k) + 0.01 * stats.cauchy.pdf(
            off, 0.0, 10 * k
        )
        log = (np.log(own) - np.log(mean)[:, None]).sum(axis=0)
        log = logsumexp(log - z**2 / 2, axis=1)
        weight = np.exp(log - log.max())
        # Draws weigh by the prior of 1/slope where they put it, not by the scatter of the slopes.
        total += weight / weight.sum() * np.abs(np.gradient(r, 1 / mean))[log.argmax()]
    return total / total.sum()


def _compare(located: pd.Series, r: np.ndarray, weight: np.ndarray, of: str = "touch_") -> None:
    mean = 1e3 * weight @ r
    sd = np.sqrt(weight @ (1e3 * r - mean) ** 2)
    assert abs(located[f"{of}radial_distance_mm"] - mean) < 0.08 * sd
    assert located[f"{of}sd_mm"] == pytest.approx(sd, rel=0.05)
    low, high = 1e3 * np.interp([0.025, 0.975], np.cumsum(weight), r)
    assert abs(located[f"{of}lower_mm"] - low) < 0.15 * sd
    assert abs(located[f"{of}upper_mm"] - high) < 0.15 * sd


@pytest.mark.slow  # of gross taps: `tests/analyses/test_contacts.py`
def test_a_gross_slope_does_not_spoil_its_touch() -> None:
    """By the sum by hand; without it the touch would be off by 5 sds."""
    found = ww.calibrate(_taps(), NOMINAL)
    at = np.repeat([0.06, 0.07], [8, 1])
    slopes = ww.Observer(TRUE, HingedTap(HINGE), ww.receptors.Weber(K)).read(at[:, None], seed=9)
    slopes = slopes[:, 0]
    slopes[2] *= 1.4
    table = pd.DataFrame({"moment_rate": slopes, "touch": np.repeat([1, 2], [8, 1])})
    located = ww.locate(table, found, touch="touch")
    r = np.linspace(0.055, 0.065, 301)
    _compare(located.iloc[0], r, _weights_by_hand(found, slopes[:8], r))
    said = located["message"].str.contains("does not belong to its touch")
    assert said.to_numpy().nonzero()[0].tolist() == [2]
    assert abs(located["touch_radial_distance_mm"][0] - 60) < 2.5 * located["touch_sd_mm"][0]


def test_errors_of_measurement_widen_by_hand() -> None:
    """One slope with an error of a fifth, on a plain grid: the mean over draws."""
    found = ww.calibrate(_taps(), NOMINAL)
    slope = float(ww.Observer(TRUE, HingedTap(HINGE)).signals(np.array([[0.06]]))[0][0, 0])
    located = ww.locate(
        pd.DataFrame({"moment_rate": [slope], "moment_rate_sd": 0.2 * slope}), found
    )
    r = np.linspace(1e-4, 0.12, 4001)[:-1]
    total = np.zeros(r.size)
    for draw in found.samples.iloc[::10].itertuples():
        beam = 1 / (1 / r - 1e3 / draw.apex_distance_mm)
        mean = 3 * draw.stiffness_N_m2 / (beam + draw.hinge_mm / 1e3)
        sd = np.hypot(np.hypot(draw.weber_fraction, draw.misfit) * mean, 0.2 * slope)
        total += stats.norm.pdf(slope, mean, sd)
    _compare(located.iloc[0], r, total / total.sum(), "")


def test_the_density_of_taps_is_that_by_hand() -> None:
    """Misfits and gross rows summed over one by one, at places about the mode."""
    rng = np.random.default_rng(3)
    taps = _taps(each=4)
    off = np.repeat(1 + 0.03 * rng.standard_normal(11), 4)
    off[[5, 18, 19]] *= [1.4, 0.6, 0.75]  # two at one distance
    r, y = taps["radial_distance_mm"].to_numpy() / 1e3, off * taps["moment_rate"].to_numpy()
    single = np.r_[0:40, 40]  # the last distance has one tap
    model = TapModel.of(r[single], y[single], NOMINAL.length, True)
    mode, covariance = model.mode()
    places = rng.multivariate_normal(mode, covariance, 40)
    z = np.linspace(-8, 8, 2001)

    def by_hand(x: np.ndarray) -> float:
        sensor = model.sensor(x)
        mean, k = sensor.slope(model.r), float(sensor.k)
        total = 0.0
        for rows in model.groups:
            each = (model.y[rows] / mean[rows] - 1)[:, None]
            own = 0.99 * stats.norm.pdf(each, float(sensor.misfit) * z, k)
            log = np.log(own + 0.01 * stats.cauchy.pdf(each, 0.0, 10 * k)).sum(axis=0)
            total += logsumexp(log + stats.norm.logpdf(z)) - np.log(mean[rows]).sum()
        prior = stats.norm([1.5, -3.0, -4.5, -3.0], [2.0, 2.0, 3.0, 1.5])
        return total + prior.logpdf(x[1:]).sum()

    log = model.log_density(places)
    near = places[log > log.max() - 10]
    assert len(near) > 15
    difference = model.log_density(near) - [by_hand(x) for x in near]
    weight = np.exp(log[log > log.max() - 10] - log.max())
    weight /= weight.sum()
    # Sets of rows that `TapModel` leaves out are summed here.
    assert np.sqrt(weight @ (difference - weight @ difference) ** 2) < 0.05
    gross = model.gross_probability(near)
    assert (gross >= 0.9).nonzero()[0].tolist() == [5, 18, 19]


@pytest.mark.slow  # a gross slope: `test_a_gross_slope_does_not_spoil_its_touch`
@pytest.mark.parametrize("off", [9 * 0.027, pytest.param(0.9, marks=pytest.mark.slow)])
def test_two_gross_taps_of_two_hundred_are_named_and_spoil_nothing(off: float) -> None:
    rng = np.random.default_rng(7)
    r = np.repeat(np.linspace(0.03, 0.105, 10), 20)
    error = 0.027 * rng.standard_normal(200)
    error[[30, 111]] = [off, -off]
    slopes = ww.Observer(TRUE, HingedTap(HINGE)).signals(r[:, None])[0][:, 0] * (1 + error)
    taps = pd.DataFrame({"radial_distance_mm": 1e3 * r, "moment_rate": slopes})
    taps = taps.set_axis([f"tap {i}" for i in range(200)]).sample(frac=1, random_state=1)
    found = ww.calibrate(taps, NOMINAL)
    assert sorted(found.gross.index) == ["tap 111", "tap 30"]
    without = ww.calibrate(taps.drop(found.gross.index), NOMINAL)
    assert found.noise.weber_fraction == pytest.approx(without.noise.weber_fraction, rel=0.01)
    for name in without.parameters.index:
        plain = without.parameters.loc[name]
        assert abs(found.parameters.loc[name, "mean"] - plain["mean"]) < 0.1 * plain["sd"]
    assert found.fits
    assert (found.gross["weber_fraction_if_kept"] > 1.1 * found.noise.weber_fraction).all()
    assert "2 taps (rows" in found.message
    assert "k would be" in found.message


@pytest.mark.slow
def test_a_touch_shares_one_calibration() -> None:
    """By hand, on a plain grid of distances: the mean over draws of the density of the rows."""
    found = ww.calibrate(_taps(each=2, seed=5), NOMINAL)
    observer = ww.Observer(TRUE, HingedTap(HINGE), ww.receptors.Weber(K))
    at = np.repeat([0.05, 0.08], 12)
    slopes = observer.read(at[:, None], seed=6)[:, 0]
    table = pd.DataFrame({"moment_rate": slopes, "touch": np.repeat([1, 2], 12)})
    located = ww.locate(table, found, touch="touch").iloc[[0, 12]]
    for touch, own in enumerate(slopes.reshape(2, 12)):
        r = at[12 * touch] + np.linspace(-8e-3, 8e-3, 401)
        total = np.zeros(r.size)
        for draw in found.samples.itertuples():
            beam = 1 / (1 / r - 1e3 / draw.apex_distance_mm)
            mean = 3 * draw.stiffness_N_m2 / (beam + draw.hinge_mm / 1e3)
            covariance = draw.weber_fraction**2 * np.eye(12) + draw.misfit**2
            off = own[:, None] / mean - 1
            log = -0.5 * (off * np.linalg.solve(covariance, off)).sum(axis=0) - 12 * np.log(mean)
            weight = np.exp(log - log.max())
            slope = np.abs(np.gradient(r, 1 / mean))[log.argmax()]
            total += slope * weight / weight.sum()
        _compare(located.iloc[touch], r, total / total.sum())
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


@pytest.mark.slow
def test_columns_of_distance_and_slope_by_any_name(
    tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    from weberwhisk.cli import run_app

    taps = _taps(each=3)
    plain = ww.calibrate(taps, NOMINAL, draws=1000).parameters
    names = {"radial_distance": "Abstand", "moment_rate": "Steigung"}
    own = taps.set_axis([*names.values()], axis=1)
    table = own.assign(Abstand=0.1 * own["Abstand"])
    found = ww.calibrate(table, NOMINAL, draws=1000, columns=names, units={"radial_distance": "cm"})
    pd.testing.assert_frame_equal(found.parameters, plain)
    table = own.assign(Abstand=1e-3 * own["Abstand"]).rename(columns={"Abstand": "d [m]"})
    found = ww.calibrate(table, NOMINAL, draws=1000, columns=names | {"radial_distance": "d [m]"})
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


@pytest.mark.slow
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
