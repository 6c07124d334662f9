"""An unknown that shares no signal with the others is integrated by itself."""

import numpy as np
import pytest
from scipy.stats import norm

import weberwhisk as ww
from weberwhisk import Status
from weberwhisk.cues import ForceMap, SpaceMap
from weberwhisk.cues.force_map import SIGNALS
from weberwhisk.inference import default_noise
from weberwhisk.receptors import GeneralisedWeber, Joint

W = ww.Whisker(50e-3, 100e-6, 5e-6)
FLOOR = 0.05
FORCES = default_noise(W, ForceMap(SIGNALS))


def noise_of(sizes):
    angle = GeneralisedWeber(0, floor=FLOOR)
    both = GeneralisedWeber([0.1] * 3 + [0.0], floor=[*FORCES.floor, FLOOR])
    models = {1: angle, 2: angle, 3: FORCES, 4: both}
    return Joint([models[n] for n in sizes], sizes=sizes)


def readings(observer, count):
    rng = np.random.default_rng(5)
    r, angle, turn = rng.uniform([0.2, 0.05, -3.1], [0.8, 0.3, 3.1], (count, 3)).T
    return observer.read(np.stack([r * W.length, angle, turn], axis=-1), seed=6)


@pytest.mark.parametrize(
    "method", ["quadrature", pytest.param("emcee", marks=pytest.mark.slow), "laplace"]
)
def test_each_factor_is_what_it_is_alone(method):
    """The azimuth is exactly a normal distribution, with no end at ±π; the rest is `ForceMap`'s."""
    observer = ww.Observer(W, SpaceMap(), noise_of([3, 2]))
    y = readings(observer, 4 if method == "emcee" else 12)
    y[0, 3:] = np.pi + 0.04  # past half a turn
    y[1, 3:] = [-3.0, -3.1]
    p = ww.posterior(observer, y, method, seed=1)
    if method != "quadrature":  # which cut the circle at ±π, and say so of what lies there
        good = p.status == ww.Status.CONVERGED
        assert not good[:2].any()
        assert good.sum() >= len(y) - 3
        y = y[good]
        p = ww.posterior(observer, y, method, seed=1)
    middle, sd = y[:, 3:].mean(axis=1), FLOOR / np.sqrt(2)
    exact = norm(middle, sd)
    azimuth = p.estimates["azimuth"]
    near = {"quadrature": 2e-3, "laplace": 0.4, "emcee": 0.15}[method]
    turns = 2 * np.pi * np.round((azimuth.mean - middle) / (2 * np.pi))
    assert np.abs(azimuth.mean - turns - middle).max() < near * sd
    assert np.abs(azimuth.sd / exact.std() - 1).max() < near
    end = p.quantile(0.1, of="azimuth") - turns
    assert np.abs(end - exact.ppf(0.1)).max() < max(near, 0.01) * sd

    alone = ww.posterior(ww.Observer(W, ForceMap(SIGNALS), FORCES), y[:, :3], method, seed=1)
    near = 1e-2 if method == "quadrature" else 0.3
    assert np.array_equal(p.status, alone.status)
    assert np.allclose(p.sd, alone.sd, rtol=near)
    ends = p.quantile([0.1, 0.9]), alone.quantile([0.1, 0.9])
    assert np.all(np.abs(ends[0] - ends[1]) < near * p.sd[:, None])
    if method == "quadrature":
        apart = (y[:, 3] - y[:, 4]) / np.sqrt(2)
        # Of two readings, N(ȳ; ω, s²/2) N(d; 0, s²) and the Jacobian 1/√2 of (ȳ, d).
        factor = norm.logpdf(apart, scale=FLOOR) + np.log(1 / (2 * np.pi) / np.sqrt(2))
        assert np.allclose(p.log_evidence, alone.log_evidence + factor, rtol=0, atol=2e-3)


def test_directions_that_contradict_each_other_are_improbable():
    observer = ww.Observer(W, SpaceMap(), noise_of([3, 2]))
    y = readings(observer, 2)
    y[1, 3:] = [0.0, 1.0]
    assert ww.posterior(observer, y).status.tolist() == [0, Status.IMPROBABLE_READING]
