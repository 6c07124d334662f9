"""The surface of signals that observers use: model 1's signals and outcomes, for one whisker."""

import numpy as np
import pytest
from short_forms import slow_but

import weberwhisk as ww
from weberwhisk import Outcome
from weberwhisk.mechanics import profile
from weberwhisk.mechanics.curved_surface import curved_surface
from weberwhisk.mechanics.elastica import Surface
from weberwhisk.mechanics.forward import ForwardModel

TIPS = {"truncated": 5e-6, "cone": 0.0, "needle": 1e-7, "blunt": 50e-6, "cylinder": 100e-6}


@pytest.mark.parametrize("tip", slow_but(TIPS.values(), (0, 1)), ids=TIPS)
def test_signals_and_outcomes_are_those_of_rung_1(tip):
    w = ww.Whisker(50e-3, 100e-6, tip)
    rng = np.random.default_rng(5)
    r = rng.uniform(1e-4, 1.02, 20_000) * w.length
    limit = ww.flick_past(w, r).deflection_angle
    # To the fold and beyond, on either side, and close to it.
    share = np.where(rng.random(r.size) < 0.2, 1 - 10 ** rng.uniform(-9, -1, r.size), 1.1)
    theta = np.where(np.isnan(limit), 0.1, limit) * share * np.sqrt(rng.random(r.size))
    theta *= rng.choice([-1, 1], r.size)
    signals, outcome = Surface(w)(r, theta)
    bent = ww.press(w, r, theta, model="elastica")
    assert np.array_equal(outcome, bent.outcome)
    assert {Outcome.HELD, Outcome.OUT_OF_REACH} < {Outcome(int(o)) for o in np.unique(outcome)}
    held = outcome == Outcome.HELD
    assert np.isnan(signals[~held]).all()
    assert np.allclose(signals[held, 0], bent.moment[held], rtol=1e-8, atol=0)
    # Along a cylinder the axial force falls to 4 % of the closed form's on the way to the fold.
    assert np.allclose(signals[held, 1], bent.axial_force[held], rtol=3e-8, atol=0)
    force = np.abs(bent.force[held])
    assert np.all(np.abs(signals[held, 2] - bent.transverse_force[held]) < 1e-8 * force)


def test_the_limit_is_flick_pasts():
    w = ww.Whisker(50e-3, 100e-6, 5e-6)
    r = np.linspace(1e-3, 51e-3, 500)
    limit = ww.flick_past(w, r).deflection_angle
    assert np.allclose(Surface(w).limit(r), limit, rtol=1e-10, atol=0, equal_nan=True)


def test_any_shape_in_pieces_or_whole():
    w = ww.Whisker(50e-3, 100e-6, 5e-6)
    r, theta = np.linspace(5e-3, 45e-3, 150)[:, None], np.linspace(0.01, 1.5, 100)
    signals, outcome = ForwardModel(w).signals(r, theta)
    assert signals.shape == (150, 100, 3)
    assert outcome.shape == (150, 100)
    row, held = ForwardModel(w).signals(r[40], theta)
    assert np.allclose(signals[40], row, rtol=1e-13, atol=0, equal_nan=True)
    assert np.array_equal(outcome[40], held)


def test_a_friction_that_is_given_is_that_of_the_table():
    """By itself it was left out."""
    found, _ = ForwardModel(ww.Whisker(50e-3, 100e-6, 5e-6), friction=0.3).signals([30e-3], [0.2])
    bent = ww.press(ww.Whisker(50e-3, 100e-6, 5e-6), 30e-3, 0.2, 0.3)
    assert found[0] == pytest.approx([bent.moment, bent.axial_force, bent.transverse_force], 1e-5)


@pytest.mark.parametrize(
    ("radius_ratio", "curvature", "friction", "ends"),
    slow_but(
        [
            (1.63, 9.6, 0.086, None),
            (2.15, 7.9, 0.138, None),
            (2.84, 0.7, 0.138, None),
            (1.63, 9.6, None, (-0.2, 0.2)),
        ],
        (3,),
    ),
)
def test_the_limit_of_a_rubbing_whisker_ends_where_its_tip_slips_off(
    radius_ratio, curvature, friction, ends
):
    """By the planar beam, contact by contact: 1e-4 rad short of the limit it is held."""
    w = ww.Whisker(50e-3, 100e-6, 100e-6 / radius_ratio, curvature=curvature)
    surface = curved_surface(w, ends or (friction, friction))
    # The nodes of distances, between which the first slip lies, are 6 % of the reach apart.
    share = np.linspace(0.6, 0.95, 141)
    r, offset = share * surface.reach, np.zeros(share.size)
    rng = np.random.default_rng(1)
    given = rng.uniform(*ends, share.size) if ends else np.full(share.size, friction)
    push = surface.limit(r, given, offset)
    rest = profile.rest_angle(w, r)
    inside, beyond = (
        np.asarray(profile.press(w, r, rest + push + more, given).outcome) for more in (-1e-4, 1e-4)
    )
    assert (inside == Outcome.HELD).all()
    assert Outcome.SLIPPED_OFF_TIP in beyond
    assert Outcome.HELD not in beyond
