"""Weber fractions of what the animal felt: trials at the places where touches were located."""

from __future__ import annotations

import json
from functools import cache

import numpy as np
import pandas as pd
import pytest
from analysis_scripts import load

import weberwhisk as ww
from weberwhisk import cli
from weberwhisk.behaviour import (
    CueEncoding,
    Trials,
    response_probability,
    simulate_moving,
    task_named,
    with_distances,
)
from weberwhisk.behaviour.likelihood import build_model

simulate_tracking = load("tracked_session").simulate_tracking

WHISKER = ww.Whisker(50e-3, 100e-6, 5e-6)
ENCODING = CueEncoding(ww.Observer(WHISKER, ww.cues.Compliance()))
KNOWN = {"lapse_low": 0.0, "lapse_high": 0.0}


@pytest.mark.parametrize(
    ("task", "worst", "usual"),
    [("2AFC", 1.5e-3, 4e-4), ("yes/no", 1e-2, 3e-3), ("same-different", 7e-3, 4e-3)],
)
def test_the_likelihood_is_that_of_brute_force_over_the_places(
    task: str, worst: float, usual: float
) -> None:
    """Probabilities of answers averaged over 121 × 121 places of each trial, to 7 % of the way."""
    rng, n, encoding = np.random.default_rng(1), 9, ENCODING
    first = np.zeros(n) if task == "yes/no" else rng.normal(0, 2e-3, n)
    own = np.zeros(n) if task == "yes/no" else np.tile([0.2e-3, 0.5e-3, 1e-3], 3)
    frame = pd.DataFrame(
        {
            "stimulus_1": 20e-3 + first, "stimulus_2": 20e-3 + rng.normal(0, 3e-3, n),
            "standard": 20e-3, "n": 1, "count": 1.0,
            "stimulus_1_sd": own, "stimulus_2_sd": np.repeat([0.3e-3, 0.7e-3, 1.4e-3], 3),
        }
    )  # fmt: skip
    model, _, _ = build_model(Trials(frame, task_named(task)), encoding, None, None, "weber", None)
    values = {"weber_fraction": 0.1, "lapse_low": 0.02, "lapse_high": 0.03, "bias": 0.4}
    p, q = model.probability(*(np.array(v) for v in list(values.values())[:3]), np.array([0.4]))
    z = np.linspace(-6, 6, 121)
    weight = np.exp(-0.5 * z**2) / np.exp(-0.5 * z**2).sum()
    cells, off = model.cells, []
    assert cells.sd_1 is not None
    assert cells.sd_2 is not None
    for i in range(n):
        x1, x2 = np.meshgrid(
            cells.stimulus_1[i] + cells.sd_1[i] * z,
            cells.stimulus_2[i] + cells.sd_2[i] * z,
            indexing="ij",
        )
        whole = response_probability(
            task_named(task), encoding, x1.ravel(), x2.ravel(), standard=np.full(x1.size, 20e-3),
            **values,
        )  # fmt: skip
        off.append(p[i] - weight @ whole.reshape(x1.shape) @ weight)
    off = np.abs(off)
    assert off.max() < worst
    assert off[cells.sd_2 < 1e-3].max() < usual
    np.testing.assert_allclose(p + q, 1, atol=1e-12)


@cache
def session(seed: int) -> tuple[Trials, pd.DataFrame]:
    """270 trials of an animal whose touches scatter by 2 mm, measured to 0.7 mm."""
    nominal = ww.simulate_trials(
        standards=20e-3, encoding=ENCODING, trials_per_level=30, seed=1000 + seed
    )
    return simulate_moving(
        nominal, ENCODING, weber_fraction=0.1, scatter=2e-3, sd=0.7e-3, offset=1e-3,
        seed=5000 + seed,
    )  # fmt: skip


def test_an_animal_that_moves_has_its_weber_fraction_from_where_it_touched() -> None:
    """Root-mean-square error and coverage over data sets, from nominal and from located places."""
    found = {"located": [], "nominal": []}
    for seed in range(12):
        trials, located = session(seed)
        for name, given in (("located", located), ("nominal", None)):
            fit = ww.fit_weber(trials, encoding=ENCODING, distances=given, priors=KNOWN)
            low, high = fit.interval(0.95)
            found[name].append((np.log(fit.weber_fraction / 0.1), low < 0.1 < high))
    error = {name: np.sqrt(np.mean(np.square([e for e, _ in v]))) for name, v in found.items()}
    covered = {name: sum(c for _, c in v) for name, v in found.items()}
    assert error["located"] < 0.22 < 0.35 < error["nominal"]
    assert covered["located"] >= 10  # of 12: fewer happens once in 50 where it is 95 %
    assert covered["nominal"] <= 6


def contacts(located: pd.DataFrame, observer: ww.Observer, seed: int) -> pd.DataFrame:
    """What a sensor read of each touch, twice, at 5 % error, with frames that are of no trial."""
    rng = np.random.default_rng(seed)
    rows = located.loc[located.index.repeat(2), ["session", "trial", "interval", "true_mm"]]
    rows = pd.concat([rows, rows.iloc[:3].assign(trial=np.nan)], ignore_index=True)
    contact = [1e-3 * rows.pop("true_mm"), rng.uniform(0.1, 0.3, len(rows))]
    true = observer.signals(np.stack(contact[: len(observer.unknowns)], axis=-1))[0]
    for name, values in zip(observer.cue.signal_names, true.T, strict=True):
        rows[name] = values * (1 + 0.05 * rng.standard_normal(len(rows)))
        rows[f"{name}_sd"] = 0.05 * values
    return rows


C2 = ww.Whisker.from_identity("C2", curved=True)


@pytest.mark.slow  # the rooms by themselves: here, and tests/recordings
@pytest.mark.parametrize(
    ("whisker", "seeds", "each"),
    [(C2, [2], 4), (C2, range(3, 11), 8)],
)
def test_tracked_video_goes_all_the_way_to_the_weber_fraction(
    whisker: ww.Whisker, seeds: list[int], each: int, tmp_path
) -> None:
    """Each touch a whisk of a tracked session, each trial two: the animal's k, as it moved."""
    per = 6
    observer = ww.Observer(whisker, ww.cues.ForceMap(["moment", "transverse_force"]))
    encoding, k = CueEncoding(observer, 0.2), 0.05
    off, covered, beside = [], 0, []
    for seed in seeds:
        nominal = ww.simulate_trials(
            standards=16e-3, encoding=encoding, trials_per_level=each, seed=seed
        )
        trials, truth = simulate_moving(
            nominal, encoding, weber_fraction=k, scatter=2.5e-3, sd=0.0, seed=100 + seed
        )
        truth = truth.sort_values(["trial", "interval"]).drop(columns=["radial_distance_mm"])
        video, _ = simulate_tracking(
            whisker, 1e-3 * truth["true_mm"].to_numpy(), frames=per * len(truth), spacing_px=15.0,
            frame_rate=20.0 * per, whisking_hz=20.0, deflection=0.25, missing=0.0, seed=200 + seed,
        )  # fmt: skip
        video[["frame", "x", "y"]].explode(["x", "y"]).to_csv(tmp_path / "video.csv")
        video = ww.read_tracking(tmp_path / "video.csv", pixels_per_mm=20, frame_rate=20.0 * per)
        signals = ww.tracked_signals(video, whisker)
        whisk = signals["frame"].to_numpy() // per
        for name in ("session", "trial", "interval"):
            signals[name] = truth[name].to_numpy()[whisk]
        located = ww.locate(signals, whisker, touch=(whisk + 1).tolist())
        touches = located.dropna(subset="touch_sd_mm").groupby(whisk).first()
        gap = touches["touch_radial_distance_mm"] - truth["true_mm"].to_numpy()[touches.index]
        assert len(touches) > 0.97 * len(truth)
        assert gap.abs().median() < 0.1
        fit = ww.fit_weber(trials, observer=observer, distances=located, priors=KNOWN)
        still = ww.fit_weber(trials, encoding=encoding, priors=KNOWN)
        off.append(np.log(np.array([fit.weber_fraction, still.weber_fraction]) / k))
        low, high = fit.interval(0.95)
        covered += low < k < high
        beside.append(still.interval(0.95)[0] > k)
    assert covered >= 0.75 * len(off)
    error = np.sqrt(np.mean(np.square(off), axis=0))
    assert error[0] < 0.5 * error[1]
    assert np.mean(beside) > 0.8  # nominal places leave the truth out
    # The signals themselves, and trials that have their places already, are the same fit.
    for given in (
        ww.fit_weber(trials, observer=observer, distances=signals, priors=KNOWN),
        ww.fit_weber(with_distances(trials, located, fit.encoding), encoding=fit.encoding,
                     priors=KNOWN),
    ):  # fmt: skip
        assert given.weber_fraction == pytest.approx(fit.weber_fraction, rel=1e-9)


def test_touches_are_joined_combined_and_missed() -> None:
    """Rows of a touch are one; two touches weigh by precision; a trial without one is scattered."""
    trials, located = session(0)
    located = located.drop(columns="true_mm").assign(touch_status="converged")
    touches = located.rename(
        columns={"radial_distance_mm": "touch_radial_distance_mm", "sd_mm": "touch_sd_mm"}
    )
    plain = with_distances(trials, located, ENCODING)
    again = with_distances(trials, pd.concat([touches, touches]), ENCODING)
    names = ["stimulus_1", "stimulus_2", "stimulus_1_sd", "stimulus_2_sd"]
    np.testing.assert_allclose(again.frame[names], plain.frame[names], rtol=1e-12)

    lost = touches.copy()
    lost.loc[0, "touch_status"] = "rows_disagree"
    missing = with_distances(trials, lost, ENCODING)
    assert any(note.startswith("1 touch not located") for note in missing.notes)
    row = missing.frame.iloc[0]
    assert row["stimulus_1"] == pytest.approx(trials.frame["stimulus_1"].iloc[0] + 1e-3, abs=3e-4)
    assert row["stimulus_1_sd"] == pytest.approx(2e-3, rel=0.15)

    twice = pd.concat([touches, touches.assign(touch_radial_distance_mm=lambda t: (
        t["touch_radial_distance_mm"] + 0.1))])  # fmt: skip
    both = with_distances(trials, twice, ENCODING).frame
    shrunk = 1 / both["stimulus_1_sd"] ** 2 - 1 / plain.frame["stimulus_1_sd"] ** 2
    assert np.sqrt(1 / shrunk.iloc[0]) == pytest.approx(0.7e-3, rel=0.05)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda d: d.drop(columns="interval"), "no column 'interval'"),
        (lambda d: d.drop(columns="sd_mm"), "'sd_mm'"),
        (lambda d: d.assign(sd_mm=0.0), "above zero"),
        (lambda d: d.assign(interval=3), "must be 1 or 2"),
        (lambda d: pd.concat([d, d]), "several rows for"),
        (lambda d: d.assign(session="x"), "belongs to a trial"),
        (lambda d: d.assign(status="no_contact"), "no located touch"),
        (lambda d: d.assign(radial_distance_mm=d["radial_distance_mm"] / 1000), "millimetres"),
        (lambda d: d.assign(radial_distance_mm=60.0), "give no signal"),
        (
            lambda d: d.rename(columns=lambda c: f"touch_{c}" if "mm" in c else c).assign(
                touch_radial_distance_mm=20.0
            ),
            "both intervals",
        ),
        (
            lambda d: contacts(d, ENCODING.observer, 1).drop(columns="moment_rate_sd"),
            "no measurement errors",
        ),
        (lambda d: contacts(d, ENCODING.observer, 1).drop(columns="interval"), "no column 'int"),
    ],
)
def test_tables_that_do_not_fit_are_refused_in_a_sentence(change, says: str) -> None:
    trials, located = session(2)
    with pytest.raises(ValueError, match=says) as caught:
        ww.fit_weber(trials, encoding=ENCODING, distances=change(located))
    assert str(caught.value).count("\n") == 0


def test_observers_and_tasks_that_cannot_take_them_are_refused() -> None:
    trials, located = session(2)
    with pytest.raises(ValueError, match="without a whisker"):
        ww.fit_weber(trials, distances=located)
    scored = ww.simulate_trials(
        standards=20e-3, offsets=[0.1, 0.2], encoding=ENCODING, task="2AFC percent correct", seed=1
    )
    scored, located = simulate_moving(
        scored, ENCODING, weber_fraction=0.1, scatter=1e-3, sd=1e-3, seed=1
    )
    with pytest.raises(ValueError, match="scored by the pole's place"):
        ww.fit_weber(scored, encoding=ENCODING, distances=located)


@pytest.mark.usefixtures("few_draws")
def test_the_command_takes_a_table_of_distances(tmp_path, capsys, monkeypatch) -> None:
    def _run(args: list[str]) -> tuple[int, str, str]:
        monkeypatch.setattr("sys.argv", ["weberwhisk", *args])
        return cli.main(), *capsys.readouterr()

    trials, located = session(3)
    trials = trials.select(trial=range(1, 91))
    frame = trials.table().drop(columns="standard")
    for name in ("stimulus_1", "stimulus_2"):
        frame[f"{name}_mm"] = 1e3 * frame.pop(name)
    frame.assign(standard_mm=20.0).to_csv(tmp_path / "trials.csv", index=False)
    located.to_csv(tmp_path / "located.csv", index=False)
    args = ["fit", str(tmp_path / "trials.csv"), "--distances", str(tmp_path / "located.csv"),
            "--length-mm", "50", "--base-radius-um", "100", "--tip-radius-um", "5",
            "--cue", "compliance", "--out", str(tmp_path / "out"), "--json"]  # fmt: skip
    code, out, _ = _run(args)
    assert code == 0
    fit = ww.fit_weber(trials, encoding=ENCODING, distances=located, seed=1)
    assert json.loads(out)["weber_fraction"] == pytest.approx(fit.weber_fraction, rel=1e-3)
    assert (tmp_path / "out" / "psychometric.png").exists()
    maps = [f"--column={c}={c}_mm" for c in ("stimulus_1", "stimulus_2", "standard")]
    code, _, err = _run([*args[:4], *maps])
    assert code == 2
    assert "needs the whisker" in err
