"""Rotational compliance with noise on both signals (§2e)."""

import numpy as np
import pytest
from cue_checks import (
    agrees_with_brute_force,
    keeps_the_protocol,
    prior_draws,
    small_noise_limit,
)
from short_forms import slow_but

import weberwhisk as ww
from weberwhisk.cues import Compliance
from weberwhisk.receptors import Weber
from weberwhisk.sensitivity import fisher_jnd, weber_propagation

W = ww.Whisker(length=50e-3, base_radius=100e-6, tip_radius=5e-6)
R = np.array([10e-3, 25e-3, 40e-3])
CUES = [
    Compliance(velocity_spread=0.5),
    Compliance(tap_angle=0.1, velocity_spread=0.5, angular_velocity=4.0),
]


@pytest.mark.parametrize("cue", CUES, ids=repr)
def test_the_protocol_is_kept(cue):
    observer = ww.Observer(W, cue)
    keeps_the_protocol(observer, prior_draws(observer, 50, 1) * 0.98)


@pytest.mark.parametrize("cue", slow_but(CUES, (0,)), ids=repr)
def test_posteriors_agree_with_brute_force(cue):
    observer = ww.Observer(W, cue)
    agrees_with_brute_force(observer, observer.read(prior_draws(observer, 1, 3), 4))


def test_noise_of_the_velocity_adds_to_that_of_the_moment():
    observer = ww.Observer(W, Compliance(velocity_spread=50.0), Weber([0.03, 0.04]))
    expected = 0.05 * R * (1 - R / W.apex_distance)
    contact = np.stack([R, np.ones(3)], axis=-1)
    assert weber_propagation(observer, contact) == pytest.approx(expected, rel=1e-6)


def test_a_known_velocity_is_the_limit_of_a_narrow_prior():
    contact = np.stack([R, np.ones(3)], axis=-1)
    narrow = ww.Observer(W, Compliance(velocity_spread=1e-5))
    plain = ww.Observer(W, Compliance())
    assert fisher_jnd(narrow, contact) == pytest.approx(fisher_jnd(plain, R[:, None]), rel=1e-6)


def test_noise_that_both_signals_share_cancels():
    contact = np.stack([R, np.ones(3)], axis=-1)
    shared = ww.Observer(W, Compliance(velocity_spread=50.0), Weber(0.1, correlation=1 - 1e-10))
    assert np.all(weber_propagation(shared, contact) < 1e-4 * R)


@pytest.mark.parametrize(
    ("cue", "noise", "second"),
    [
        (Compliance(velocity_spread=0.5), Weber([0.01, 0.02]), 1.0),
    ],
)
def test_posteriors_have_the_closed_forms_width_at_small_noise(cue, noise, second):
    contact = np.stack([R, np.full(3, second)], axis=-1)
    small_noise_limit(ww.Observer(W, cue, noise), contact, draws=50, bias=2e-3)


def test_two_readings_are_inverted():
    rate, _ = Compliance(velocity_spread=1.0).signals(W, np.array([20e-3, 3.0]))
    assert Compliance().radial_distance(W, *rate) == pytest.approx(20e-3, rel=1e-12)
    beyond = Compliance().radial_distance(W, [0.0, -1e-5, np.nan])  # they were 53 and 56 mm
    assert np.isnan(beyond).all()


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: Compliance(velocity_spread=-1), "velocity_spread must not be negative"),
    ],
)
def test_misuse_is_refused_in_one_sentence(call, words):
    with pytest.raises(ValueError, match=words) as error:
        call()
    assert "\n" not in str(error.value)
