"""Angle–side–angle (§2c): its three variants, their JND and where they do not work."""

import numpy as np
import pytest
from short_forms import slow_but

import weberwhisk as ww
from weberwhisk import Outcome
from weberwhisk.cues import AngleSideAngle, ContactAndDetachment, Cue, TwoWhiskers
from weberwhisk.receptors import GeneralisedWeber
from weberwhisk.sensitivity import fisher_jnd, weber_propagation

W = ww.Whisker(50e-3, 100e-6, 5e-6)
CUES = [
    AngleSideAngle(10e-3),
    AngleSideAngle(10e-3, side_sd=1e-3),
    TwoWhiskers(3e-3, neighbour_length=30e-3),
    ContactAndDetachment(2e-3, side_sd=0.2e-3, push=0.2),
]
EVERY = pytest.mark.parametrize("cue", CUES, ids=repr)
ONE_DEGREE = np.radians(1.0)


def triangle_jnd(r, theta, s, *, angle_sd=ONE_DEGREE, side_sd=0.0, correlation=0.0):
    """The JND of distance by angle–side–angle for small noise, (...), m, from the triangle alone.

    From r = side·sin θ₁/sin δ with δ = θ₂ − θ₁ the angle at the object, and q = side·sin θ₂/sin δ
    the distance from the first place: ∂r/∂θ₁ = q/sin δ, ∂r/∂θ₂ = −r cos δ/sin δ, ∂r/∂side =
    r/side. So Δr² = σ²(q² + r² cos²δ − 2ρ q r cos δ)/sin²δ + (r σ_side/side)².
    """
    along, across = s + r * np.cos(theta), r * np.sin(theta)
    q, apex = np.hypot(along, across), theta - np.arctan2(across, along)
    near = r * np.cos(apex)
    angles = angle_sd**2 * (q**2 + near**2 - 2 * correlation * q * near) / np.sin(apex) ** 2
    return np.sqrt(angles + (r * side_sd / s) ** 2)


def drawn(cue, n, seed):
    """Contacts drawn from the prior, where the cue works."""
    rng = np.random.default_rng(seed)
    contact = [rng.uniform(0, cue.farthest(W), 4 * n), rng.uniform(*cue.bearings, 4 * n)]
    if len(cue.unknowns) > 2:
        contact.append(cue.side + cue.side_sd * rng.standard_normal(4 * n))
    contact = np.stack(contact, axis=-1)
    return contact[cue.signals(W, contact)[1] == Outcome.HELD][:n]


@EVERY
def test_it_keeps_the_protocol(cue):
    assert isinstance(cue, Cue)
    contact = drawn(cue, 200, 1)
    assert len(contact) == 200
    assert cue.signals(W, contact)[0].shape == (200, 2)
    assert set(cue.priors(W)) == set(cue.unknowns[1:])


@EVERY
def test_the_angles_are_those_of_the_triangle(cue):
    """By complex numbers: the object seen from 0 and from the side's other end."""
    contact = drawn(cue, 100, 2)
    side = contact[:, 2] if contact.shape[1] > 2 else cue.side
    there = side + contact[:, 0] * np.exp(1j * contact[:, 1])
    expected = np.stack([np.angle(there), np.angle(there - side)], axis=-1)
    assert np.allclose(cue.signals(W, contact)[0], expected, rtol=1e-12)


@EVERY
def test_it_is_inverted_wherever_it_works(cue):
    contact = drawn(cue, 300, 4)
    side = contact[:, 2] if contact.shape[1] > 2 else None
    r, outcome = cue.radial_distance(W, cue.signals(W, contact)[0], side)
    assert np.all(outcome == Outcome.HELD)
    assert np.allclose(r, contact[:, 0], rtol=1e-9)


@EVERY
def test_the_jnd_by_propagation_is_the_closed_form(cue):
    """But for what the prior knows of the bearing: an sd of 56° in the middle, to 1° of noise."""
    observer = ww.Observer(W, cue)
    contact = observer.at_middle(np.linspace(3e-3, 25e-3, 9)[:, None])
    expected = triangle_jnd(contact[:, 0], contact[:, 1], cue.side, side_sd=cue.side_sd)
    for jnd in (weber_propagation(observer, contact), fisher_jnd(observer, contact)):
        assert jnd == pytest.approx(expected, rel=5e-4)


def test_a_short_side_costs_jnd_and_distance_costs_its_square():
    far = triangle_jnd(np.array([20e-3, 40e-3]), 1.3, 0.1e-3)
    assert far[1] / far[0] == pytest.approx(4, rel=0.01)
    halved = triangle_jnd(30e-3, 1.3, np.array([0.1e-3, 0.2e-3]))
    assert halved[0] / halved[1] == pytest.approx(2, rel=0.01)
    limit = np.sqrt(2) * 0.01 * 30e-3**2 / (0.1e-3 * np.sin(1.3))
    assert triangle_jnd(30e-3, 1.3, 0.1e-3, angle_sd=0.01) == pytest.approx(limit, rel=0.01)


@pytest.mark.parametrize("side_sd", slow_but([0.0, 0.05e-3], [0]))
def test_the_posterior_has_the_closed_forms_sd_where_the_noise_is_small(side_sd):
    cue = AngleSideAngle(10e-3, side_sd=side_sd)
    noise = GeneralisedWeber(0.0, floor=np.radians(0.1))
    observer = ww.Observer(W, cue, noise)
    r = np.array([10e-3, 20e-3, 30e-3])
    table = ww.jnd_curve(observer, r, n_readings=30, seed=1)
    expected = triangle_jnd(r, np.pi / 2, 10e-3, angle_sd=np.radians(0.1), side_sd=side_sd)
    assert np.all(table["unreliable"] == 0)
    # The curvature of r(θ) tells at the order of the noise's square; the mean sd has an error.
    assert np.all(
        np.abs(table["posterior"] - expected) < 4 * table["posterior_error"] + 2e-3 * expected
    )
    # The estimate scatters by what varies from touch to touch: the angles, not the side.
    scatter = triangle_jnd(r, np.pi / 2, 10e-3, angle_sd=np.radians(0.1))
    assert np.all(np.abs(table["estimator"] - scatter) < 4 * table["estimator_error"])


@pytest.mark.parametrize("cue", slow_but([CUES[0], CUES[2]], (1,)), ids=repr)
def test_the_posterior_is_the_brute_force_integral(cue):
    observer = ww.Observer(W, cue)
    truth = [15e-3, 1.4]
    reading = observer.read(truth, seed=3)
    p = ww.posterior(observer, reading, tolerance=1e-4)
    n = 3000
    r = (np.arange(n) + 0.5) / n * cue.farthest(W)
    # Bearings that the second angle allows: the rest has exp(−50) of the mass.
    bearing = reading[1] + np.radians(10) * ((np.arange(800) + 0.5) / 400 - 1)
    contact = np.stack(np.meshgrid(r, bearing, indexing="ij"), axis=-1)
    weight = np.exp(observer.log_likelihood(reading, contact)).sum(axis=1)
    mean = weight @ r / weight.sum()
    sd = np.sqrt(weight @ (r - mean) ** 2 / weight.sum())
    assert p.status == 0
    assert p.mean == pytest.approx(mean, abs=1e-4 * sd)
    assert p.sd == pytest.approx(sd, rel=1e-4)


def test_an_unknown_side_is_integrated_out():
    """r scales with the side at given angles: the posterior is a product's, sampled by hand."""
    cue = AngleSideAngle(10e-3, side_sd=1e-3)
    observer = ww.Observer(W, cue, GeneralisedWeber(0.0, floor=np.radians(0.05)))
    contact = np.array([20e-3, 1.2, 10e-3])
    p = ww.posterior(observer, observer.signals(contact)[0])
    expected = np.hypot(20e-3 * 0.1, triangle_jnd(20e-3, 1.2, 10e-3, angle_sd=np.radians(0.05)))
    assert p.sd == pytest.approx(expected, rel=0.03)
    # A flat prior of r: the side's posterior is tilted by the factor side that r carries.
    assert p.estimates["side"].mean == pytest.approx(10e-3 * (1 + 0.1**2), rel=2e-3)


def test_it_says_where_it_does_not_work():
    cue = AngleSideAngle(10e-3)
    angles = np.radians([[80.0, 80.0], [100.0, 80.0], [79.0, 80.0], [-3.0, 40.0], [60.0, 80.0]])
    r, outcome = cue.radial_distance(W, angles)
    assert [Outcome(k).name for k in outcome] == [
        "PARALLEL", "PARALLEL", "OUT_OF_REACH", "PARALLEL", "HELD",
    ]  # fmt: skip
    assert np.isfinite(r).tolist() == [False, False, False, False, True]
    # The neighbour is too short for what the whisker itself reaches.
    short = TwoWhiskers(3e-3, neighbour_length=30e-3)
    assert short.signals(W, np.array([35e-3, 1.5]))[1] == Outcome.OUT_OF_REACH
    assert TwoWhiskers(3e-3).signals(W, np.array([35e-3, 1.5]))[1] == Outcome.HELD
    # Pushed too far, the whisker flicks past before it can detach.
    cue = ContactAndDetachment(push=0.4)
    limit = cue.farthest(W)
    # From the first place, at the sharpest bearing, the whisker is at its last.
    first = abs(cue.side + limit * np.exp(1j * cue.bearings[0]))
    assert ww.flick_past(W, first).deflection_angle == pytest.approx(0.4, rel=1e-6)
    contact = np.array(
        [[limit * 0.99, 1.5], [limit * 1.01, 1.5], [first * 1.01, 1.5], [60e-3, 1.5]]
    )
    names = [Outcome(k).name for k in cue.signals(W, contact)[1]]
    assert names == ["HELD", "ONE_SIDED", "FLICKED_PAST", "OUT_OF_REACH"]
    table = ww.jnd_curve(ww.Observer(W, cue), first * 1.01, n_readings=3, seed=1)
    assert table["outcome"][0].startswith("flicked past")


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: AngleSideAngle(0.0), "side must be above zero"),
        (lambda: AngleSideAngle(1e-2, side_sd=5e-3), "at most a quarter of the side"),
        (lambda: AngleSideAngle(bearings=(0.5, 4.0)), "bearings must be two that go up"),
        (lambda: TwoWhiskers(neighbour_length=-1), "neighbour_length must be above zero"),
        (lambda: ContactAndDetachment(push=-0.1), "push must not be negative"),
        (lambda: ww.Observer(W, ContactAndDetachment(push=2.0)), "No contact holds a push of 114"),
        (lambda: ww.Observer(W, AngleSideAngle(60e-3)), "a side of 0.06 m and a reach of 0.05 m"),
        (lambda: AngleSideAngle().radial_distance(W, [0.1, np.nan]), "angles must be finite"),
    ],
)
def test_misuse_is_refused_in_one_sentence(make, words):
    with pytest.raises(ValueError, match=words) as error:
        make()
    assert "\n" not in str(error.value)
