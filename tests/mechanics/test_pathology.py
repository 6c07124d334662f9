"""Cases that break lesser code, each with its reason. No warning, no silent NaN."""

import numpy as np
import pytest

import weberwhisk as ww
from weberwhisk import Outcome, Status
from weberwhisk.cues import Compliance, ForceMap
from weberwhisk.receptors import GeneralisedWeber, Weber
from weberwhisk.sensitivity import weber_propagation

W = ww.Whisker(50e-3, 100e-6, 5e-6)
CONE = ww.Whisker(50e-3, 100e-6, 0.0)
NUMBERS = ("moment", "axial_force", "transverse_force", "contact_angle", "arc_length", "force")


def explained(bent):
    """Every number is finite, or its contact has an outcome that says why not."""
    excused = np.isin(bent.outcome, [Outcome.HELD, Outcome.PAST_FOLD])
    return all(np.all(np.isfinite(getattr(bent, key)) == excused) for key in NUMBERS)


# -- mechanics -----------------------------------------------------------------------------------


def test_zero_load_is_a_touch_not_an_error():
    for bent in (ww.bend(W, 30e-3, 0.0), ww.press(W, 30e-3, 0.0)):
        assert bent.outcome == Outcome.HELD
        assert bent.moment == bent.axial_force == bent.deflection_angle == 0


def test_contact_at_the_very_base_is_stiff_but_finite():
    bent = ww.press(W, 1e-9 * W.length, 0.5)
    assert bent.outcome == Outcome.HELD
    assert explained(bent)
    assert bent.moment == pytest.approx(W.compliance_constant * 0.5 / (1e-9 * W.length), rel=0.1)


def test_contact_at_the_tip_itself():
    """A truncated whisker can be touched at its tip and slips off at once; a cone has no tip."""
    assert ww.bend(W, W.length, 1e-9).outcome == Outcome.HELD
    assert ww.press(W, W.length, 0.0).outcome == Outcome.HELD
    assert ww.press(W, W.length, 0.01).outcome == Outcome.SLIPPED_OFF_TIP
    assert ww.press(CONE, CONE.length, 0.01).outcome == Outcome.OUT_OF_REACH
    assert ww.bend(CONE, CONE.length, 1e-12).outcome == Outcome.OUT_OF_REACH


def test_beyond_the_tip_there_is_nothing():
    bent = ww.press(W, W.length * 1.001, [0.0, 0.1])
    assert np.all(bent.outcome == Outcome.OUT_OF_REACH)
    assert explained(bent)
    assert ww.flick_past(W, W.length * 1.001).ended_by == Outcome.OUT_OF_REACH


def test_radius_ratio_towards_one_is_the_cylinder():
    """R → 1 sends the apex to infinity: nothing may be computed from A itself."""
    cylinder = ww.press(W.cylinder(), 20e-3, 0.7)
    for excess in (1e-3, 1e-8, 1e-15):
        near = ww.press(ww.Whisker(50e-3, 100e-6, 100e-6 * (1 - excess)), 20e-3, 0.7)
        assert near.moment == pytest.approx(cylinder.moment, rel=2 * excess + 1e-12)


def test_radius_ratio_towards_infinity_is_the_cone():
    cone = ww.press(CONE, 40e-3, 0.2)
    for tip in (1e-9, 1e-15, 1e-300):
        near = ww.press(ww.Whisker(50e-3, 100e-6, tip), 40e-3, 0.2)
        assert near.moment == pytest.approx(cone.moment, rel=1e5 * tip + 1e-12)


def test_the_fold_itself_is_held_and_a_hair_beyond_is_not():
    end = ww.flick_past(W, 25e-3).deflection_angle
    assert ww.press(W, 25e-3, end).outcome == Outcome.HELD
    assert ww.press(W, 25e-3, np.nextafter(end, 9) * (1 + 1e-13)).outcome == Outcome.FLICKED_PAST


def test_the_error_grows_towards_the_fold():
    """At the fold signals go as the square root of what is left: half the digits are gone."""
    end = ww.flick_past(W, 25e-3).deflection_angle
    errors = ww.press(W, 25e-3, end * (1 - np.array([1e-1, 1e-6, 1e-12]))).error
    assert errors[0] < 1e-11 < errors[1] < 1e-8 < errors[2]


def test_loads_far_past_the_fold_have_an_outcome():
    bent = ww.bend(W, 30e-3, np.geomspace(1e-9, 1e9, 60))
    assert bent.outcome[0] == Outcome.HELD
    assert bent.outcome[-1] == Outcome.FLICKED_PAST
    assert Outcome.PAST_FOLD in bent.outcome
    assert np.all(np.diff(bent.outcome.astype(int)) >= 0)
    assert explained(bent)


@pytest.mark.filterwarnings("ignore:.*did you pass degrees")
def test_angles_past_every_fold_have_an_outcome():
    bent = ww.press(W, 30e-3, [1.0, np.pi, 100.0, -100.0])
    assert np.all(bent.outcome == Outcome.FLICKED_PAST)
    assert explained(bent)


def test_a_sweep_with_every_outcome_survives():
    r = np.linspace(1e-4, 1.2, 60)[:, None] * W.length
    bent = ww.press(W, r, np.linspace(-2, 2, 81))
    assert set(np.unique(bent.outcome)) == {
        Outcome.HELD,
        Outcome.FLICKED_PAST,
        Outcome.SLIPPED_OFF_TIP,
        Outcome.OUT_OF_REACH,
    }
    assert explained(bent)


def test_no_scenes_at_all():
    assert ww.press(W, np.empty(0), 0.1).moment.shape == (0,)


# -- receptors, posteriors -----------------------------------------------------------------------


def test_tiny_k_is_as_exact_as_any():
    observer = ww.Observer(W, Compliance(), Weber(1e-3))
    p = ww.posterior(observer, observer.read(20e-3, seed=1))
    assert p.status == Status.OUTSIDE_DOMAIN
    assert p.sd == pytest.approx(1e-3 * 20e-3 * (1 - 20e-3 / W.apex_distance), rel=1e-3)


def test_a_reading_of_zero_is_no_contact():
    """A rate of zero lies past the tip: it gave 41 mm, improbable."""
    observer = ww.Observer(W, Compliance(), Weber(0.1))
    p = ww.posterior(observer, [0.0])
    assert p.status == Status.NO_CONTACT
    assert np.isnan([p.mean, p.sd]).all()


def test_a_negative_reading_is_improbable_unless_noise_is_large():
    reading = [-0.1 * float(W.compliance_constant / W.length)]
    small = ww.posterior(ww.Observer(W, Compliance(), Weber(0.1)), reading)
    large = ww.posterior(ww.Observer(W, Compliance(), Weber(0.5)), reading)
    assert small.status == Status.IMPROBABLE_READING
    assert large.status == Status.CONVERGED
    assert np.isfinite([large.mean, large.sd]).all()


@pytest.mark.filterwarnings("ignore:.*did you pass mN")
def test_a_reading_from_far_inside_the_base():
    observer = ww.Observer(W, Compliance(), Weber(0.1))
    p = ww.posterior(observer, observer.signals([1e-5 * W.length])[0])
    assert p.status == Status.OUTSIDE_DOMAIN
    assert p.mean == pytest.approx(1e-5 * W.length, rel=0.05)


def test_a_saturated_receptor_gives_back_the_prior_below_its_distance():
    """Above the ceiling all contacts feel alike: flat from the base to where it begins."""
    unit = float(W.compliance_constant / W.length)
    observer = ww.Observer(W, Compliance(), GeneralisedWeber(0.001, floor=0.0, ceiling=4 * unit))
    p = ww.posterior(observer, [4 * unit])
    edge = 1 / (4 + W.taper) * W.length
    assert p.mean == pytest.approx(edge / 2, rel=0.02)
    assert p.sd == pytest.approx(edge / np.sqrt(12), rel=0.02)


def test_the_cones_tip_where_signal_and_noise_both_vanish():
    """(3.5) promises infinite resolution there; the posterior only shrinks with the signal."""
    observer = ww.Observer(CONE, Compliance(), Weber(0.1))
    for left in (1e-2, 1e-4, 1e-6):
        p = ww.posterior(observer, observer.signals([CONE.length * (1 - left)])[0])
        assert p.status == Status.CONVERGED
        assert p.sd == pytest.approx(0.1 * left * CONE.length, rel=0.2)


def test_a_cone_has_a_reach_at_any_angle():
    """Its very tip holds no contact, so that there the largest angle is not a number."""
    for cue in (Compliance(tap_angle=0.05), ForceMap("moment", deflection_angle=0.05)):
        end = ww.Observer(CONE, cue).reach[1]
        assert ww.press(CONE, end * (1 - 1e-9), 0.05).outcome == Outcome.HELD
        assert ww.press(CONE, end * (1 + 1e-6), 0.05).outcome == Outcome.FLICKED_PAST


def test_the_map_near_its_fold_and_tip():
    """Posteriors cut off by the fold or the tip stay inside and say how sure they are."""
    observer = ww.Observer(W, ForceMap(), Weber(0.1))
    for r in (0.4, 0.97, 0.995):
        theta = 0.97 * float(ww.flick_past(W, r * W.length).deflection_angle)
        p = ww.posterior(observer, observer.signals([r * W.length, theta])[0])
        assert p.status in (Status.CONVERGED, Status.IMPRECISE)
        assert 0 < p.mean < W.length
        assert 0 < p.sd < W.length / 4


def test_perfectly_correlated_noise_has_a_jnd_but_no_posterior():
    observer = ww.Observer(W, ForceMap(), Weber([0.1, 0.2], correlation=1.0))
    assert weber_propagation(observer, [25e-3, 1e-5]) < 1e-5 * W.length
    with pytest.raises(ValueError, match="has no likelihood"):
        ww.posterior(observer, observer.signals([25e-3, 0.1])[0])


@pytest.mark.slow  # of walkers: `test_emcee_hard_cases.py`
def test_walkers_never_start_outside_the_support():
    """emcee accepts walkers at −∞ in silence and leaves them there."""
    observer = ww.Observer(W, ForceMap(), Weber(0.1))
    theta = 0.99 * float(ww.flick_past(W, 45e-3).deflection_angle)
    p = ww.posterior(observer, observer.signals([45e-3, theta])[0], "emcee", seed=1)
    assert p.status in (Status.CONVERGED, Status.NOT_CONVERGED)
    assert np.isfinite([p.mean, p.sd]).all()
