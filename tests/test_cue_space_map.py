"""The map of all forces in space (§2g), against the rod of model 3."""

import numpy as np
import pytest
from cue_checks import keeps_the_protocol, small_noise_limit

import weberwhisk as ww
from weberwhisk import Outcome
from weberwhisk.cues import ForceMap, LateralSlip, SpaceMap
from weberwhisk.cues.force_map import SIGNALS
from weberwhisk.jnd import fisher_jnd
from weberwhisk.mechanics import rod
from weberwhisk.receptors import GeneralisedWeber, Joint, Weber

W = ww.Whisker(length=50e-3, base_radius=100e-6, tip_radius=5e-6)
CONTACT = np.array([[20e-3, 0.3, -2.0], [30e-3, 0.5, 0.4], [40e-3, 0.2, 2.5]])


def test_the_protocol_is_kept():
    keeps_the_protocol(ww.Observer(W, SpaceMap()), CONTACT)


def test_signals_and_inverse_are_those_of_the_rod():
    r, theta, turn = CONTACT.T
    across = r * np.sin(theta)
    points = np.stack([r * np.cos(theta), across * np.cos(turn), across * np.sin(turn)], axis=-1)
    bent = rod.press(ww.Whisker(50e-3, 100e-6, 5e-6, curvature=1e-9), points)
    signals, _ = SpaceMap().signals(W, CONTACT)
    assert np.allclose(signals[:, 0], np.hypot(*bent.moment[:, 1:].T), rtol=1e-6)
    assert np.allclose(signals[:, 1], bent.axial_force, rtol=1e-6)
    assert np.allclose(signals[:, 2], np.hypot(*bent.force[:, 1:].T), rtol=1e-6)
    assert np.allclose(signals[:, 3], np.arctan2(-bent.moment[:, 1], bent.moment[:, 2]), atol=1e-6)
    assert np.allclose(signals[:, 4], np.arctan2(bent.force[:, 2], bent.force[:, 1]), atol=1e-6)
    found, outcome = SpaceMap().contact(W, bent.moment[:, 1:], bent.axial_force)
    assert np.all(outcome == Outcome.HELD)
    assert np.allclose(found, CONTACT, rtol=1e-5)


def test_a_second_plane_costs_no_distance():
    plain = fisher_jnd(ww.Observer(W, ForceMap(SIGNALS)), CONTACT[:, :2])
    assert fisher_jnd(ww.Observer(W, SpaceMap()), CONTACT) == pytest.approx(plain, rel=1e-9)


def test_posteriors_have_the_propagated_width_at_small_noise():
    noise = Joint([Weber(0.01), GeneralisedWeber(0, floor=0.01)], sizes=[3, 2])
    small_noise_limit(ww.Observer(W, SpaceMap(), noise), CONTACT[:2], draws=10, bias=5e-3)


def test_where_there_is_no_contact_the_outcome_says_so():
    signals, outcome = SpaceMap().signals(W, np.array([[60e-3, 0.1, 0.0], [45e-3, 1.0, 0.0]]))
    assert outcome.tolist() == [Outcome.OUT_OF_REACH, Outcome.FLICKED_PAST]
    assert np.isnan(signals).all()
    cylinder = W.cylinder()
    signals, _ = SpaceMap().signals(cylinder, CONTACT[0])
    contact, outcome = SpaceMap().contact(cylinder, [0.0, signals[0]], signals[1])
    assert outcome == Outcome.OUT_OF_REACH
    assert np.isnan(contact).all()


@pytest.mark.parametrize(
    "contact",
    [[20e-3, 0.2, np.nan], [np.nan, 0.2, 0.1], [0.0, 0.2, 0.1], [20e-3, 3.0, 0.1]],
)
def test_what_is_no_contact_has_an_outcome_and_no_signals(contact):
    """A direction that is no number was held with NaN among its signals, the base with infinity."""
    for cue, place in ((SpaceMap(), contact), (ForceMap(), contact[:2])):
        signals, outcome = cue.signals(W, np.array(place))
        assert np.isfinite(signals).all() == (outcome == Outcome.HELD)
        assert np.isfinite(signals).any() == (outcome == Outcome.HELD)


@pytest.mark.parametrize("bad", [np.inf, -np.inf, np.nan])
def test_readings_that_are_no_numbers_have_no_contact(bad):
    place, outcome = SpaceMap().contact(W, [[bad, 1e-6], [1e-6, 2e-6]], [1e-5, bad])
    assert np.isnan(place).all()
    assert (outcome == Outcome.OUT_OF_REACH).all()


def test_readings_of_the_wrong_shape_or_kind_are_refused():
    for cue, words in ((SpaceMap(), "moment"), (ForceMap(), "signals"), (LateralSlip(), "signals")):
        more = (1e-5,) if isinstance(cue, SpaceMap) else ()
        with pytest.raises(ValueError, match=f"{words} must have 2 numbers"):
            cue.contact(W, [1e-6], *more)
        with pytest.raises(ValueError, match=f"{words} must be a number"):
            cue.contact(W, ["a", 1.0], *more)
