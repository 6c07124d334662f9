"""The cost and error of the ladder over natural sweeps: the short form, and what it must show."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from analysis_scripts import FOLDER
from analysis_scripts import load as load_script

import weberwhisk as ww

costs = load_script("scene_costs")


@pytest.fixture(scope="module")
def tables(tmp_path_factory: pytest.TempPathFactory) -> tuple[pd.DataFrame, pd.DataFrame]:
    folder = tmp_path_factory.mktemp("scene_costs")
    made = costs.make(folder, short=True)
    assert {path.name for path in folder.iterdir()} == {
        "scene_costs.csv", "scene_costs_models.csv", "scene_costs.png"
    }  # fmt: skip
    return made


def kept() -> tuple[pd.DataFrame, pd.DataFrame]:
    """The tables kept with the figure."""
    names = ("scene_costs.csv", "scene_costs_models.csv")
    return tuple(pd.read_csv(FOLDER / "figures" / name) for name in names)  # type: ignore[return-value]


@pytest.fixture(params=["short", "kept"])
def either(request: pytest.FixtureRequest) -> tuple[pd.DataFrame, pd.DataFrame]:
    return request.getfixturevalue("tables") if request.param == "short" else kept()


def test_angles_weigh_as_much_as_the_time_spent_there() -> None:
    """Of a sinusoid the share of the time below an angle is an arcsine."""
    turned = costs.rotations(2000)
    most = costs.AMPLITUDE - costs.MET
    assert turned.min() > 0
    assert turned.max() == pytest.approx(most.max(), rel=1e-5)
    for angle in np.radians([3.0, 10.0, 25.0]):
        phase = np.arcsin(np.minimum((costs.MET + angle) / costs.AMPLITUDE, 1))
        begin = np.arcsin(costs.MET / costs.AMPLITUDE)
        share = np.sum(phase - begin) / np.sum(np.pi / 2 - begin)
        assert np.mean(turned <= angle) == pytest.approx(share, abs=2e-3)


def test_shares_are_shares_and_the_bias_stays_within_the_tolerance(
    either: tuple[pd.DataFrame, pd.DataFrame],
) -> None:
    ladder, rungs = either
    shares = ladder[list(costs.NAMES)]
    np.testing.assert_allclose(shares.sum(axis=1), 1, atol=1e-3)
    assert (shares >= 0).all(axis=None)
    assert (ladder["bias_worst"] <= costs.TOLERANCE).all()
    assert (ladder["lost"] == 0).all()
    assert (ladder[["seconds_choosing", "seconds_chosen", "seconds_complete"]] > 0).all(axis=None)
    # The yardstick can find fault: without a choice the cheap rungs are off by more.
    throughout = rungs[rungs["model"] == costs.NAMES[0]]
    assert (throughout["bias_worst"] > costs.TOLERANCE).all()


def test_more_noise_needs_no_dearer_rungs(either: tuple[pd.DataFrame, pd.DataFrame]) -> None:
    ladder, _ = either
    for _, rows in ladder.sort_values("weber_fraction").groupby(["whisker", "object"]):
        cheaper = rows[list(costs.NAMES)].to_numpy().cumsum(axis=1)
        assert (np.diff(cheaper, axis=0) >= -1e-3).all()


def test_rungs_that_model_all_there_is_agree(either: tuple[pd.DataFrame, pd.DataFrame]) -> None:
    """In the plane the rod is a check on the planar beam, and the beam on the elastica."""
    _, rungs = either
    flat = rungs[~rungs["whisker"].str.contains("rolled")]
    assert (flat.loc[flat["model"] == costs.NAMES[3], "bias_worst"] < 1e-5).all()
    straight = flat[(flat["whisker"] == "straight") & (flat["object"] == "peg")]
    assert (straight.loc[straight["model"] == costs.NAMES[2], "bias_worst"] < 1e-6).all()


@pytest.mark.slow
def test_the_force_on_a_tip_is_tilted_as_the_wall_is() -> None:
    """A tip on a wall feels the wall's normal, pressed again as friction would tilt it."""
    kind = costs.KINDS[0]
    size = costs.Size(6, ("C2",), (1,), ("wall",), 1, 1)
    met = costs.contacts(kind, "C2", "wall", size)
    again = met.press()
    whisker = kind.whisker("C2")
    swept = ww.sweeping.sweep(
        whisker,
        costs.body(kind, whisker, "wall", 1),
        np.concatenate([[-0.02], costs.rotations(6)]),
    ).bending
    held = np.asarray(swept.held)
    np.testing.assert_allclose(again.moment, swept.moment[held], rtol=1e-6)


@pytest.mark.slow
def test_scenes_near_the_fold_are_left_to_the_rung_that_knows() -> None:
    """Bent towards the push, with friction."""
    kind = costs.Kind("", bow=-0.2)
    rng = np.random.default_rng(5)
    whisker, n = kind.whisker("C2"), 2000
    r = rng.uniform(0.05, 0.97, n) * whisker.whisker.length
    friction = np.radians(rng.uniform(-25, 25, n)) * (rng.random(n) < 0.5)
    theta = ww.mechanics.rest_angle(whisker, r) + rng.uniform(0, 1, n) ** 1.5
    reached = np.isfinite(theta)
    met = costs.Contacts(whisker, r[reached], theta[reached], friction[reached], 0.0)
    true = met.press()
    off = costs.bias(true, met.press(met.choose(0.3).model), 0.3)[np.asarray(true.held)]
    assert off.max() <= costs.TOLERANCE


def test_conclusions_say_which_model_fails_where() -> None:
    ladder, rungs = kept()
    cheapest, failing, dearer = costs.conclusions(ladder, rungs)
    assert "curved, rolled by 60°: closed form" in cheapest
    assert "planar beam with curved, rolled by 60°" in failing
    assert "the rod" in dearer
    rungs.loc[rungs["model"] == "planar beam", "bias_95"] = 0.0
    assert "planar beam" not in costs.conclusions(ladder, rungs)[1]
