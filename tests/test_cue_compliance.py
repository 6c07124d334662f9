"""Rotational compliance with noise on both signals, and with slip out of the plane (§2e)."""

import numpy as np
import pytest
from cue_checks import (
    agrees_with_brute_force,
    covers,
    is_calibrated,
    keeps_the_protocol,
    prior_draws,
    small_noise_limit,
)
from short_forms import slow_but

import weberwhisk as ww
from weberwhisk import Outcome
from weberwhisk.cues import Compliance, LateralSlip
from weberwhisk.jnd import fisher_jnd, weber_propagation
from weberwhisk.mechanics import rod
from weberwhisk.receptors import GeneralisedWeber, Joint, Weber

W = ww.Whisker(length=50e-3, base_radius=100e-6, tip_radius=5e-6)
R = np.array([10e-3, 25e-3, 40e-3])
CUES = [
    Compliance(velocity_spread=0.5),
    Compliance(tap_angle=0.1, velocity_spread=0.5, angular_velocity=4.0),
    LateralSlip(friction_angle=0.1),
]


def tilt_noise(k):
    return Joint([Weber(k), GeneralisedWeber(0, floor=k)], sizes=[1, 1])


@pytest.mark.parametrize("cue", CUES, ids=repr)
def test_the_protocol_is_kept(cue):
    observer = ww.Observer(W, cue)
    keeps_the_protocol(observer, prior_draws(observer, 50, 1) * 0.98)


@pytest.mark.parametrize("cue", slow_but(CUES, (0, 2)), ids=repr)
def test_posteriors_agree_with_brute_force(cue):
    observer = ww.Observer(W, cue)
    agrees_with_brute_force(observer, observer.read(prior_draws(observer, 1, 3), 4))


@pytest.mark.parametrize("cue", [Compliance(), Compliance(tap_angle=0.2)], ids=repr)
def test_intervals_cover_when_the_velocity_is_known(cue):
    covers(ww.Observer(W, cue), n=600)


@pytest.mark.parametrize("cue", CUES[::2], ids=repr)
def test_posteriors_are_calibrated(cue):
    is_calibrated(ww.Observer(W, cue), n=500)


@pytest.mark.slow
@pytest.mark.parametrize("cue", [*CUES, Compliance(), Compliance(tap_angle=0.2)], ids=repr)
def test_intervals_cover_over_many_draws(cue):
    covers(ww.Observer(W, cue))


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
        (LateralSlip(), tilt_noise(0.01), 0.5),
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


def test_the_lateral_slip_is_that_of_a_rod_pressed_by_a_tilted_plane():
    """The rod of model 3, turned by a small angle against a smooth tilted plane."""
    r, tilt, turn = 25e-3, 0.6, 1e-4
    whisker = ww.Whisker(50e-3, 100e-6, 5e-6, curvature=1e-9)
    # The normal's part of the point's shift in the base frame is all that bends the whisker.
    push = r * turn * np.cos(tilt)
    point = [r, push * np.cos(tilt), push * np.sin(tilt)]
    moment = rod.press(whisker, point).moment / turn
    (size, direction), _ = LateralSlip().signals(W, np.array([r, tilt]))
    # A force along (0, cos τ, sin τ) has the moment (0, −sin τ, cos τ).
    assert np.hypot(moment[1], moment[2]) == pytest.approx(size, rel=1e-5)
    assert np.arctan2(-moment[1], moment[2]) == pytest.approx(direction, rel=1e-5)


def test_friction_holds_the_whisker_up_to_its_angle():
    cue = LateralSlip(friction_angle=0.3)
    contact = np.array([[25e-3, t] for t in (-0.5, -0.3, 0.0, 0.2, 0.3, 0.5)])
    signals, outcome = cue.signals(W, contact)
    square = Compliance().signals(W, contact[:, :1])[0][:, 0]
    assert np.all(outcome == Outcome.HELD)
    assert signals[1:5, 0] == pytest.approx(square[1:5], rel=1e-12)
    assert signals[:, 1] == pytest.approx([-0.2, 0, 0, 0, 0, 0.2], abs=1e-12)
    assert cue.sticks(contact[:, 1]).tolist() == [False, True, True, True, True, False]
    found, outcome = cue.contact(W, signals)
    assert outcome.tolist() == [0, *[Outcome.STUCK] * 4, 0]
    assert found[:, 0] == pytest.approx(contact[:, 0], rel=1e-12)
    assert np.isnan(found[1:5, 1]).all()
    # The tilt is not told where it sticks, the distance as well as ever.
    observer = ww.Observer(W, cue)
    assert fisher_jnd(observer, contact[2]) == pytest.approx(
        float(fisher_jnd(ww.Observer(W, Compliance()), 25e-3)), rel=1e-9
    )


def test_what_is_out_of_reach_says_so():
    signals, outcome = LateralSlip().signals(W, np.array([[60e-3, 0.1], [20e-3, 1.4]]))
    assert np.all(outcome == Outcome.OUT_OF_REACH)
    assert np.isnan(signals).all()
    contact, outcome = LateralSlip().contact(W, [[1e-9, 0.0], [1e-5, 1.4]])
    assert np.all(outcome == Outcome.OUT_OF_REACH)
    assert np.isnan(contact).all()


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: Compliance(velocity_spread=-1), "velocity_spread must not be negative"),
        (lambda: LateralSlip(friction_angle=1.4), "Angles must rise from friction_angle"),
        (lambda: LateralSlip(steepest=2.0), "Angles must rise from friction_angle"),
        (lambda: LateralSlip(angular_velocity=0), "angular_velocity must be above zero"),
    ],
)
def test_misuse_is_refused_in_one_sentence(call, words):
    with pytest.raises(ValueError, match=words) as error:
        call()
    assert "\n" not in str(error.value)
