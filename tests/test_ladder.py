"""One front for all rungs: the cheapest that the scene needs."""

import numpy as np
import pytest

import weberwhisk as ww
from weberwhisk import Outcome, Rung

STRAIGHT = ww.Whisker(50e-3, 100e-6, 5e-6)
CURVED = ww.Whisker(50e-3, 100e-6, 5e-6, curvature=5.0)


def test_each_scene_gets_the_cheapest_rung_that_models_it():
    assert ww.bend(STRAIGHT, 30e-3, 1e-5).model == Rung.ELASTICA
    assert ww.bend(STRAIGHT, 30e-3, 1e-5, friction_angle=-0.1).model == Rung.PROFILE
    assert ww.bend(CURVED, 30e-3, 1e-5).model == Rung.PROFILE
    assert ww.press(CURVED, 30e-3, 0.3).model == Rung.PROFILE
    assert ww.press(STRAIGHT, 30e-3, 0.1, model="closed_form").model == Rung.CLOSED_FORM


def test_rung_2_is_rung_1_on_a_straight_whisker():
    r, theta = np.linspace(5e-3, 40e-3, 6), 0.2
    a, b = ww.press(STRAIGHT, r, theta), ww.press(STRAIGHT, r, theta, model="profile")
    for key in ("moment", "axial_force", "transverse_force", "arc_length"):
        assert np.allclose(getattr(a, key), getattr(b, key), rtol=1e-8, equal_nan=True)
    assert np.array_equal(a.outcome, b.outcome)


def test_bend_and_press_agree_on_a_curved_whisker():
    bent = ww.bend(CURVED, 30e-3, 3e-5)
    back = ww.press(CURVED, bent.radial_distance, bent.deflection_angle)
    assert back.outcome == Outcome.HELD
    assert back.force == pytest.approx(3e-5, rel=1e-7)
    assert back.moment == pytest.approx(bent.moment, rel=1e-7)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: ww.press(CURVED, 3e-2, 0.1, model="elastica"), "curvature is not modelled by the"),
        (lambda: ww.bend(STRAIGHT, 3e-2, 1e-5, 0.1, model="closed_form"), "Friction is not model"),
        (lambda: ww.bend(STRAIGHT, 3e-2, 1e-5, np.nan), "friction_angle must be finite"),
        (lambda: ww.signal_jacobian(CURVED, 3e-2, 0.1), "curvature is not modelled"),
        (lambda: ww.Observer(CURVED, ww.cues.ForceMap()), "straight whiskers so far"),
    ],
)
def test_what_a_rung_does_not_model_is_refused(call, words):
    with pytest.raises(ValueError, match=words):
        call()
