"""Model 0: exact as the angle goes to zero, and honest about how far it can be trusted."""

import numpy as np
import pytest

import weberwhisk as ww
from weberwhisk.mechanics import closed_form

RATIOS = [1, 1.2, 3, 20, 1000]


@pytest.mark.parametrize("ratio", RATIOS)
def test_it_is_the_limit_of_rung_1(ratio):
    w = ww.Whisker(50e-3, 100e-6, 100e-6 / ratio)
    r = np.linspace(0.02, 0.99, 30) * w.length
    alpha = 1e-5
    u = r / w.apex_distance
    theta = alpha * 2 * (1 - u) / (3 - 2 * u)
    a, b = ww.press(w, r, theta, model="closed_form"), ww.press(w, r, theta, model="elastica")
    for key in ("moment", "axial_force", "transverse_force", "contact_angle", "force"):
        assert np.allclose(getattr(a, key), getattr(b, key), rtol=1e-9), key


@pytest.mark.parametrize("ratio", RATIOS)
def test_its_error_estimate_covers_the_error_without_exaggerating_it(ratio):
    w = ww.Whisker(50e-3, 100e-6, 100e-6 / ratio)
    r = np.linspace(0.02, 0.97, 30) * w.length
    for alpha in (0.01, 0.1, 0.3, 0.6):
        u = r / w.apex_distance
        theta = alpha * 2 * (1 - u) / (3 - 2 * u)
        a, b = ww.press(w, r, theta, model="closed_form"), ww.press(w, r, theta)
        held = b.held
        worst = np.max(
            [
                np.abs(getattr(a, key) / getattr(b, key) - 1)[held]
                for key in ("moment", "axial_force", "transverse_force")
            ],
            axis=0,
        )
        assert np.all(worst <= a.error[held])
        assert np.all(a.error[held] < 3 * worst)


@pytest.mark.parametrize("ratio", RATIOS)
def test_jacobian_is_the_slope_of_the_signals(ratio):
    w = ww.Whisker(50e-3, 100e-6, 100e-6 / ratio)
    r, theta, h = 0.6 * w.length, 0.1, 1e-6

    def signals(r, theta):
        b = ww.press(w, r, theta, model="closed_form")
        return np.array([b.moment, b.axial_force, b.transverse_force])

    by_r = (signals(r * (1 + h), theta) - signals(r * (1 - h), theta)) / (2 * h * r)
    by_theta = (signals(r, theta + h) - signals(r, theta - h)) / (2 * h)
    jacobian = closed_form.signal_jacobian(w, r, theta)
    assert np.allclose(jacobian, np.stack([by_r, by_theta], axis=-1), rtol=1e-8)


def test_signals_on_no_taper_have_no_contact():
    w = ww.Whisker(50e-3, 100e-6, 5e-6)
    cylinder = w.cylinder()
    b = ww.press(cylinder, 30e-3, 0.1, model="closed_form")
    r, theta = closed_form.contact_from_signals(cylinder, b.moment, b.axial_force)
    assert np.isnan(r)
    assert np.isnan(theta)
    # Axial force of the wrong sign: no contact gives a pull.
    assert np.isnan(closed_form.contact_from_signals(w, b.moment, -b.axial_force)[0])


# Pathologies, each with its reason. Straight, frictionless and without a fold, this model has no
# others; that it is used where it should not be, its error says.

W, CONE = ww.Whisker(50e-3, 100e-6, 5e-6), ww.Whisker(50e-3, 100e-6, 0.0)


def test_radius_ratio_to_one_and_to_infinity():
    """The apex goes to infinity, or to the tip: u = r/A is computed from the taper instead."""
    tips = 100e-6 * np.array([1 - 1e-15, 1.0, 1e-12, 0.0])
    m = closed_form.press(ww.Whisker(50e-3, 100e-6, tips), 20e-3, 0.1).moment
    assert m[0] == pytest.approx(m[1], rel=1e-14)
    assert m[2] == pytest.approx(m[3], rel=1e-11)


def test_contact_at_the_very_base_and_tip():
    """Forces go as 1/r² at the base; at a tip of no width there is nothing to push."""
    base = closed_form.press(W, 1e-9 * W.length, 0.01)
    assert base.outcome is ww.Outcome.HELD
    assert base.moment == pytest.approx(W.compliance_constant * 0.01 / (1e-9 * W.length))
    assert closed_form.press(W, W.length, 0.01).outcome is ww.Outcome.HELD
    assert closed_form.press(W, W.length * 1.001, 0.01).outcome is ww.Outcome.OUT_OF_REACH
    assert closed_form.press(CONE, CONE.length, 0.01).outcome is ww.Outcome.OUT_OF_REACH
    assert closed_form.bend(CONE, CONE.length, 1e-9).outcome is ww.Outcome.OUT_OF_REACH


@pytest.mark.parametrize("ratio", RATIOS)
def test_a_push_that_slides_off_the_tip_is_not_vouched_for(ratio):
    """Next to the tip a whisker slips off at an angle so small that 0.2 % had been claimed."""
    w = ww.Whisker(50e-3, 100e-6, 100e-6 / ratio)
    r = (1 - np.geomspace(1e-3, 1e-7, 30)) * w.length
    last = ww.flick_past(w, r).deflection_angle
    low = np.where(closed_form.press(w, r, last).contact_angle < 0.2)
    assert low[0].size > 10
    for push, gone in ((0.97, False), (1 + 1e-12, True), (1.3, True)):
        error = closed_form.press(w, r[low], push * last[low]).error
        assert np.all((error == 1) == gone)


def test_far_past_every_fold_its_error_says_that_nothing_is_known():
    """Linear theory holds any load, so that the estimate alone can warn; it must not overflow."""
    assert np.all(closed_form.bend(W, 30e-3, [1e-3, 1.0, 1e6, 1e200]).error == 1)
    assert np.all(closed_form.press(W, 30e-3, [1.6, 30.0]).error == 1)
