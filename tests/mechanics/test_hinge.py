"""A whisker in series with a rotational spring at its base."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy import integrate, optimize
from scipy.spatial.transform import Rotation

import weberwhisk as ww
from weberwhisk import Whisker, cues, mechanics, receptors
from weberwhisk.mechanics import closed_form, elastica
from weberwhisk.mechanics.contact import Outcome
from weberwhisk.mechanics.forward import ForwardModel
from weberwhisk.recordings.calibration import HingedTap
from weberwhisk.sweeping import follow

PLAIN = Whisker(50e-3, 100e-6, 5e-6)
SOFT = 2 * PLAIN.moment_scale  # N m/rad


def hinged(stiffness=SOFT, whisker=PLAIN):
    return replace(whisker, hinge_stiffness=stiffness)


def test_a_light_push_meets_two_springs_in_series():
    r = np.array([[2e-3], [10e-3], [30e-3], [48e-3]])[..., 0]
    lever = 1 / (1 / r - 1 / PLAIN.apex_distance)
    clamped = 3 * PLAIN.stiffness / lever
    series = 1 / (1 / clamped + 1 / SOFT)
    forward = ForwardModel(hinged())
    found, outcome = forward.signals(r, np.full(4, 1e-6))
    assert np.all(outcome == Outcome.HELD)
    np.testing.assert_allclose(found[:, 0] / 1e-6, series, rtol=1e-8)
    # Pushed at the contact: the arc's own r²/K on top of r²/(its stiffness).
    np.testing.assert_allclose(1e-6 * r / found[:, 2], r**2 / clamped + r**2 / SOFT, rtol=1e-8)
    np.testing.assert_allclose(forward.stiffness(r)[0], series, rtol=1e-12)
    named = ForwardModel(hinged(), "closed_form").signals(r, np.full(4, 0.1))[0]
    np.testing.assert_allclose(named[:, 0], 0.1 * series, rtol=1e-12)
    h = 3 * PLAIN.stiffness / SOFT  # as calibration has it
    tap, _ = cues.Compliance().signals(hinged(), r[:, None])
    np.testing.assert_allclose(tap, HingedTap(h).signals(PLAIN, r[:, None])[0], rtol=1e-12)


@pytest.mark.parametrize("curvature", [0.0, 12.0])
def test_a_stiff_hinge_is_a_clamped_base(curvature):
    whisker = replace(PLAIN, curvature=curvature)
    clamped = ForwardModel(whisker)
    stiff = ForwardModel(hinged(1e15 * PLAIN.moment_scale, whisker))
    r = np.linspace(0.02, 0.99, 30)[:, None] * clamped.reach
    np.testing.assert_allclose(stiff.limit(r), clamped.limit(r), rtol=1e-10)
    theta = np.linspace(0.01, 0.95, 20) * clamped.limit(r)
    found, wanted = (f.signals(r, theta)[0] for f in (stiff, clamped))
    np.testing.assert_allclose(found, wanted, rtol=1e-10)
    rtol = 1e-6 if curvature else 1e-10  # by differences of curved ones
    found, wanted = (f.jacobian(r, theta) for f in (stiff, clamped))
    np.testing.assert_allclose(found, wanted, rtol=rtol)
    np.testing.assert_array_equal(stiff.rest(r), clamped.rest(r))


def beam(whisker, stiffness, r, theta):
    """Moment and forces of a beam that is followed from its turned base to the object."""
    place = r * np.array([np.cos(theta), np.sin(theta)])

    def forces(force, tip):
        load = force * np.array([-np.sin(tip), np.cos(tip)])
        return load, place[0] * load[1] - place[1] * load[0]

    def miss(v):
        force, arc, tip = v[0] * whisker.force_scale, v[1] * r, v[2]
        load, moment = forces(force, tip)

        def slope(s, state):
            x, y, phi = state
            bending = (place[0] - x) * load[1] - (place[1] - y) * load[0]
            stiff = whisker.stiffness * (1 - s / whisker.apex_distance) ** 4
            return [np.cos(phi), np.sin(phi), bending / stiff + whisker.curvature * -1.0]

        start = [0.0, 0.0, moment / stiffness]
        end = integrate.solve_ivp(slope, (0, arc), start, rtol=1e-9, atol=1e-12).y[:, -1]
        return [*((end[:2] - place) / r), end[2] - tip]

    light = 3 * theta * whisker.length**2 / r**2 / (1 + 3 * whisker.stiffness / r / stiffness)
    found = optimize.root(miss, [light, 1.02, 1.5 * theta], tol=1e-10)
    assert found.success, found.message
    force, tip = found.x[0] * whisker.force_scale, found.x[2]
    moment = forces(force, tip)[1]
    at_base = tip - moment / stiffness
    return np.array([moment, force * np.sin(at_base), force * np.cos(at_base)])


@pytest.mark.parametrize(
    ("r", "theta", "soft"), [(15e-3, 0.5, 1.0), (30e-3, 0.4, 0.2), (40e-3, 0.35, 3.0)]
)
def test_signals_are_those_of_a_beam_on_a_spring(r, theta, soft):
    stiffness = PLAIN.moment_scale / soft
    forward = ForwardModel(hinged(stiffness))
    found, outcome = forward.signals(np.array([r]), np.array([theta]))
    assert outcome[0] == Outcome.HELD
    assert np.abs(found[0] / forward.clamped.signals(r, theta * 0.7)[0] - 1).max() > 1e-2
    np.testing.assert_allclose(found[0], beam(PLAIN, stiffness, r, theta), rtol=2e-7)


def test_the_range_ends_where_the_angle_stops_to_grow():
    give = 1 / SOFT
    forward, r = ForwardModel(hinged()), np.array([15e-3, 25e-3, 35e-3, 49.9e-3])
    inner = np.linspace(0, 1, 40_001) * elastica.flick_past(PLAIN, r).deflection_angle[:, None]
    angle = inner + give * np.nan_to_num(elastica.press(PLAIN, r[:, None], inner).moment)
    np.testing.assert_allclose(forward.limit(r), angle.max(axis=1), rtol=1e-7)
    assert np.all(angle.argmax(axis=1)[:3] < 40_000)  # before the clamped whisker's own end
    assert forward.signals(r, forward.limit(r))[1].tolist() == [Outcome.HELD] * 4
    lost = forward.signals(r, forward.limit(r) * (1 + 1e-6))
    assert lost[1].tolist() == [Outcome.FLICKED_PAST] * 3 + [Outcome.SLIPPED_OFF_TIP]
    assert np.isnan(lost[0]).all()
    assert forward.signals(np.array([51e-3]), np.array([0.1]))[1] == Outcome.OUT_OF_REACH
    # Of a very soft hinge next to the base: half a turn.
    assert ForwardModel(hinged(SOFT / 50)).limit(np.array([5e-3])) == np.pi


def test_an_unknown_hinge_ends_at_half_a_turn_of_its_median_and_in_proportion_on_others():
    """Beside the largest sum of what bends the whisker and what the hinge turns, on a fine grid."""
    median, r = SOFT / 50, 5e-3
    inner = np.linspace(0, 1, 4001) * elastica.flick_past(PLAIN, r).deflection_angle
    moment = np.nan_to_num(elastica.press(PLAIN, r, inner).moment)
    stiffness = median * np.array([1.0, 0.3, 0.8, 2.0])
    largest = np.max(inner + moment / stiffness[:, None], axis=1)
    cue = cues.UnknownHinge(cues.ForceMap(), 0.3)
    contact = np.column_stack([np.full(4, r), np.ones(4), stiffness])
    limit = cue.forward(hinged(median), contact).limit(contact[:, 0])
    np.testing.assert_allclose(limit, np.pi * largest / largest[0], rtol=1e-5)


@pytest.mark.parametrize("spread", [0.0, pytest.param(0.5, marks=pytest.mark.slow)])  # 4, 45 s
def test_posterior_is_that_of_a_plain_sum_over_bent_whiskers(spread):
    """Of a hinge that is known, and of one whose stiffness has a log-normal prior."""
    noise = receptors.Weber(0.1)
    cue = cues.UnknownHinge(cues.ForceMap(), spread) if spread else cues.ForceMap()
    observer = ww.Observer(hinged(), cue, noise)
    reading = observer.read([30e-3, 0.5, SOFT][: len(observer.unknowns)], seed=3)
    found = ww.posterior(observer, reading)
    # Over distances and what bends the whisker: dθ = dθ′ (1 + M′/K), up to where θ is largest.
    n, m = (120, 1201) if spread else (400, 1601)
    r = (np.arange(n) + 0.5) / n * PLAIN.length
    end = elastica.flick_past(PLAIN, r).deflection_angle
    inner = np.linspace(0, 1, m) ** 2 * end[:, None] * (1 - 1e-9)
    bent = elastica.press(PLAIN, r[:, None], inner)
    signals = np.stack([bent.moment, bent.axial_force], axis=-1)[:, 1::2]
    likelihood = np.exp(noise.log_likelihood(reading, signals) - 60)
    z, mass = np.polynomial.hermite_e.hermegauss(40) if spread else (np.zeros(1), np.ones(1))
    stiffness = SOFT * np.exp(spread * z)
    density, typical = [], np.max(inner + bent.moment / SOFT, axis=1)
    for soft in stiffness:
        angle = inner[:, ::2] + bent.moment[:, ::2] / soft
        weight = np.diff(angle, axis=1)
        weight = np.where(np.minimum.accumulate(weight > 0, axis=1), weight, 0.0)
        last = np.max(inner + bent.moment / soft, axis=1)
        held = last * np.minimum(np.pi / typical, 1.0)  # half a turn, at the median stiffness
        weight *= (angle[:, 1:] < held[:, None]) * likelihood
        density.append(weight.sum(axis=1))
    density = np.array(density) * mass[:, None]
    density /= density.sum()
    assert found.status.name == "CONVERGED"
    for name, of, value in (
        ("radial_distance", density.sum(axis=0), r),
        ("hinge_stiffness", density.sum(axis=1), stiffness),
    )[: 1 + (spread > 0)]:
        mean = of @ value
        sd = np.sqrt(of @ (value - mean) ** 2)
        assert abs(found.estimates[name].mean - mean) < 2e-3 * sd
        assert abs(found.estimates[name].sd / sd - 1) < 2e-3


def test_in_space_a_straight_whisker_turns_its_hinge_in_the_plane_of_the_contact():
    """Beside the rod of the clamped whisker, turned as a whole by what the moment turns it."""
    rng = np.random.default_rng(2)
    r, azimuth = rng.uniform(15e-3, 45e-3, 12), rng.uniform(-3, 3, 12)
    inner = elastica.flick_past(PLAIN, r).deflection_angle * rng.uniform(0.05, 0.7, 12)
    about = np.stack([0 * r, -np.sin(azimuth), np.cos(azimuth)], axis=-1)
    point = r[:, None] * Rotation.from_rotvec(inner[:, None] * about).apply([1.0, 0.0, 0.0])
    bent = mechanics.rod.press(replace(PLAIN, curvature=1e-9), point)
    place = Rotation.from_rotvec(bent.moment / SOFT).apply(point)
    contact = np.stack([r, np.arccos(place[:, 0] / r), np.arctan2(*place[:, :0:-1].T)], axis=-1)
    cue = cues.SpaceMap(["axial_force", "force_y", "force_z", "torsion", "moment_y", "moment_z"])
    found, outcome = cue.signals(hinged(), contact)
    assert not outcome.any()
    exact = np.concatenate([bent.force * [-1, 1, 1], bent.moment], axis=-1)
    for part in (slice(0, 3), slice(3, 6)):
        off = np.linalg.norm((found - exact)[:, part], axis=1)
        assert np.max(off / np.linalg.norm(exact[:, part], axis=1)) < 1e-6


def test_what_a_shape_at_rest_does_in_space_to_a_whisker_on_a_hinge_is_unknown():
    mouse = Whisker.from_identity("C2", species="mouse", hinge_stiffness=1e-5)
    assert ww.Observer(mouse, cues.SpaceMap()).note.endswith("does to this cue is unknown")


@pytest.mark.slow
def test_a_muscle_turns_a_whisker_on_a_hinge():
    """By as much more as the hinge gives: the same moment at a larger angle."""
    cue, r = cues.BalanceOfMoments(effort=None), np.array([15e-3, 25e-3])
    inner = np.array([0.1, 0.08])
    moment = elastica.press(PLAIN, r, inner).moment
    angle = inner + moment / SOFT
    signals, outcome = cue.signals(hinged(), np.stack([r, angle], axis=-1))
    muscle = cue.curve.moment(cue.impact_angle + angle)
    assert np.all(outcome == Outcome.HELD)
    np.testing.assert_allclose(
        signals[:, 1], cue.curve.gain() * moment / PLAIN.moment_scale / muscle
    )
    known = cues.BalanceOfMoments(effort=0.3)
    soft = cues.UnknownHinge(known, 0.3)
    both = soft.signals(hinged(), np.stack([r, [SOFT, SOFT]], axis=-1))[0]
    np.testing.assert_allclose(both, known.signals(hinged(), r[:, None])[0], rtol=1e-6)


def test_inverses_know_the_hinge():
    tap, r = cues.Compliance(), np.array([5e-3, 20e-3, 45e-3])
    rate, _ = tap.signals(hinged(), r[:, None])
    np.testing.assert_allclose(tap.radial_distance(hinged(), rate[:, 0]), r, rtol=1e-12)
    contact = np.array([[10e-3, 0.8], [30e-3, 0.4]])
    signals, _ = cues.ForceMap().signals(hinged(), contact)
    np.testing.assert_allclose(cues.ForceMap().contact(hinged(), signals)[0], contact, rtol=1e-8)


W = hinged()
CLAMPED_ONLY = {
    "press": lambda: ww.press(W, 30e-3, 0.1),
    "bend": lambda: ww.bend(W, 30e-3, 1e-5),
    "flick_past": lambda: ww.flick_past(W, 30e-3),
    "signal_jacobian": lambda: ww.mechanics.signal_jacobian(W, 30e-3, 0.1),
    "choose_model": lambda: ww.choose_model(W, 30e-3, 0.1),
    "profile": lambda: ww.mechanics.Profile.of(W),
    "rod": lambda: mechanics.rod.press(W, [30e-3, 5e-3, 0.0]),
    "sweep": lambda: ww.sweeping.sweep(W, ww.sweeping.peg(30e-3, 0.0), [0.0, 0.1]),
    "modes": lambda: mechanics.modes.modes(W),
    "moment": lambda: closed_form.moment(W, 30e-3, 0.1),
    "slopes": lambda: closed_form.signal_jacobian(W, 30e-3, 0.1),
    "distance": lambda: closed_form.distance_from_moment(W, 1e-6, 0.1),
    "contact": lambda: closed_form.contact_from_signals(W, 1e-6, 1e-5),
    "SpaceMap": lambda: ww.Observer(replace(W, curvature=8.0), cues.SpaceMap()),
    "AngleSideAngle": lambda: ww.Observer(W, cues.AngleSideAngle()),
    "UnknownStiffness": lambda: ww.Observer(W, cues.UnknownStiffness(cues.ForceMap())),
    "its slopes": lambda: cues.UnknownStiffness(cues.ForceMap()).jacobian(W, [30e-3, 0.2, 1.0]),
    "Friction": lambda: ww.Observer(W, cues.Friction(cues.ForceMap())),
    "UnknownCurvature": lambda: ww.Observer(W, cues.UnknownCurvature(cues.ForceMap(), 2.0)),
    "HingedTap": lambda: HingedTap(1e-3).signals(W, np.array([20e-3])),
    "calibrate": lambda: ww.calibrate(pd.DataFrame(), W),
    "locate": lambda: ww.locate(pd.DataFrame({"moment": [1e-6], "axial_force": [1e-5]}), W),
    "lateral sweep": lambda: follow(W, [0.1, 0.2], [1e-6, 2e-6]),
}


@pytest.mark.parametrize("name", CLAMPED_ONLY)
def test_what_takes_no_hinge_refuses_it(name):
    with pytest.raises(ValueError, match="clamped base, got hinge_stiffness"):
        CLAMPED_ONLY[name]()


def test_an_unknown_hinge_needs_a_whisker_on_one():
    with pytest.raises(ValueError, match="needs a whisker on a hinge"):
        ww.Observer(PLAIN, cues.UnknownHinge(cues.ForceMap(), 0.3))


def test_a_soft_hinge_has_contacts_at_the_edge_of_what_is_held():
    """Their signals have no slopes to weigh a model by, and no observer could be made."""
    w = Whisker(50e-3, 100e-6, 5e-6, hinge_stiffness=2e-5, curvature=-10.0)
    observer = ww.Observer(w, cues.UnknownHinge(cues.ForceMap(), 0.3))
    assert observer.model == "profile"
    assert observer.why.endswith("the straight elastica has contacts lost that are held")
