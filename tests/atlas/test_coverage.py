"""Intervals of every cue, whatever is unknown: 95 % of 95 % hold the truth."""

import numpy as np
import pytest
from audit import LAYERED, layered_observer
from cue_checks import SDS, agrees_with_brute_force, coverage
from scipy import stats
from short_forms import slow_but

import weberwhisk as ww
from weberwhisk.cues import (
    AngleSideAngle,
    BalanceOfMoments,
    ComparativeLength,
    Compliance,
    ContactAndDetachment,
    ForceMap,
    Fused,
    SpaceMap,
    TwoWhiskers,
    UnknownStiffness,
    Vibration,
    VibrissaLength,
)
from weberwhisk.cues.force_map import SIGNALS
from weberwhisk.inference import default_noise
from weberwhisk.receptors import Weber
from weberwhisk.sensitivity import prior_draws

W = ww.Whisker(length=50e-3, base_radius=100e-6, tip_radius=5e-6)
CUES = {
    "light tap": Compliance(),
    "tap": Compliance(tap_angle=0.2),
    "unknown velocity": Compliance(velocity_spread=0.5),
    "known angle": ForceMap(SIGNALS, deflection_angle=0.2),
    "moment and transverse force": ForceMap(["moment", "transverse_force"]),
    "known effort": BalanceOfMoments(),
    "ratio of modes": Vibration(),
    "length": VibrissaLength(),
    "comparative": ComparativeLength([40e-3, 30e-3], [[0.0, 3e-3], [0.0, 6e-3]]),
    "map": ForceMap(),
    "three signals": ForceMap(SIGNALS),
    "space": SpaceMap(),
    "felt effort": BalanceOfMoments(effort=None),
    "angle side angle": AngleSideAngle(),
    "unknown side": AngleSideAngle(side_sd=1e-3),
    "two whiskers": TwoWhiskers(),
    "detachment": ContactAndDetachment(),
    "vibration": Vibration(3),
    "fused": Fused(Compliance(), ForceMap()),
    "soft map": UnknownStiffness(ForceMap()),
    "soft fusion": Fused(UnknownStiffness(ForceMap()), Compliance()),
}
#: Three unknowns, whose intervals take ten times as long.
LARGE = ("space", "unknown side", "soft map", "soft fusion")
QUICK = {"tap", "ratio of modes", "map", "space", "vibration"}


def share_covered(name, n):
    observer = ww.Observer(W, CUES[name])
    return coverage(observer, prior_draws(observer, n, seed=1), seed=2)


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[pytest.mark.slow] * (n not in QUICK)) for n in CUES]
)
def test_intervals_cover_as_often_as_they_say(name):
    # Of one unknown a hundred cost as little as one of three.
    n = 600 if len(CUES[name].unknowns) == 1 else 12 if name in LARGE else 40
    # Fewer or more hits than these are rarer than one in 16 000.
    least, most = stats.binom.ppf(stats.norm.cdf([-SDS, SDS]), n, 0.95)
    assert least <= share_covered(name, n) * n <= most


@pytest.mark.slow
@pytest.mark.parametrize("name", CUES)
def test_of_two_thousand_intervals_93_5_to_96_5_per_cent_cover(name):
    share = share_covered(name, 2000)
    print(f"{name}: {share:.2%}")
    assert 0.935 <= share <= 0.965


@pytest.mark.parametrize(
    ("name", "n"),
    [("tap", 200), *(pytest.param(n, 2000, marks=pytest.mark.slow) for n in LAYERED)],
)
@pytest.mark.slow
def test_intervals_cover_whatever_else_is_unknown(name, n):
    observer = layered_observer(name, 0.1)
    share = coverage(observer, prior_draws(observer, n, seed=1), seed=2)
    assert abs(share - 0.95) < (0.015 if n == 2000 else SDS * np.sqrt(0.95 * 0.05 / n))


FORCES = default_noise(W, UnknownStiffness(ForceMap(SIGNALS), 0.1), 0.05)
#: Stiffness and noise small enough for no mass at the fold, at whose edge the midpoint rule errs.
THREE = {
    "soft map": (UnknownStiffness(ForceMap(), 0.03), Weber(0.03), [20e-3, 0.25, 1.02]),
    "three signals": (UnknownStiffness(ForceMap(SIGNALS), 0.1), FORCES, [20e-3, 0.3, 1.05]),
    "soft fusion": (CUES["soft fusion"], None, [20e-3, 0.2, 0.9]),
    "unknown side": (CUES["unknown side"], None, [20e-3, 1.4, 10.2e-3]),
}


@pytest.mark.parametrize("name", slow_but(THREE, (3,)))
def test_three_unknowns_agree_with_brute_force(name):
    cue, noise, contact = THREE[name]
    observer = ww.Observer(W, cue, noise)
    agrees_with_brute_force(observer, observer.read([contact], seed=3))
