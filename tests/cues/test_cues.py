"""Cues and the observer that uses them."""

import numpy as np
import pytest
from scipy import stats

import weberwhisk as ww
from weberwhisk import Outcome
from weberwhisk.cues import (
    AngleSideAngle,
    BalanceOfMoments,
    ComparativeLength,
    Compliance,
    ContactAndDetachment,
    ForceMap,
    Fused,
    SpaceMap,
    TwoWhiskers,
    UnknownStiffness,
    Vibration,
    VibrissaLength,
)
from weberwhisk.receptors import GeneralisedWeber

W = ww.Whisker(50e-3, 100e-6, 5e-6)
CUES = [
    Compliance(),
    Compliance(tap_angle=0.15, angular_velocity=4.0),
    ForceMap(),
    ForceMap(["transverse_force", "moment", "axial_force"]),
    ForceMap("moment", deflection_angle=0.15),
    Fused(Compliance(), ForceMap()),
    VibrissaLength(),
    BalanceOfMoments(effort=None),
]


def contacts(cue, n=50):
    rng = np.random.default_rng(1)
    r = rng.uniform(0.05, 0.8, n) * W.length
    limit = ww.flick_past(W, r).deflection_angle
    if hasattr(cue, "largest_angle"):
        limit = np.minimum(limit, cue.largest_angle(W, r))
    theta = limit * rng.uniform(0.05, 0.9, n)
    return np.stack([r, theta], axis=-1)[:, : len(cue.unknowns)]


@pytest.mark.parametrize("cue", CUES, ids=repr)
@pytest.mark.parametrize("model", [None, "closed_form"])
def test_the_jacobian_is_the_slope_of_the_signals(cue, model):
    contact = contacts(cue) * 0.9
    jacobian = cue.jacobian(W, contact, model=model)
    for column in range(contact.shape[1]):
        step = np.zeros_like(contact)
        step[:, column] = contact[:, column] * 1e-5
        up, down = (cue.signals(W, contact + s * step, model=model)[0] for s in (1, -1))
        slope = (up - down) / (2 * step[:, column, None])
        assert np.allclose(
            jacobian[:, :, column], slope, rtol=1e-5, atol=1e-9 * np.abs(slope).max()
        )


def test_compliance_reaches_as_far_as_the_tap_can_be_held():
    cue = Compliance(tap_angle=np.radians(24.5732))
    assert cue.farthest(W) == pytest.approx(0.7 * W.length, rel=1e-5)
    beyond = np.array([[cue.farthest(W) * 1.001]])
    signals, outcome = cue.signals(W, beyond)
    assert outcome[0] == Outcome.FLICKED_PAST
    assert np.isnan(signals).all()
    with pytest.raises(ValueError, match="No contact holds a tap_angle of 120"):
        Compliance(tap_angle=np.radians(120)).farthest(W)


def test_the_force_map_of_a_cylinder_has_no_inverse():
    cylinder = W.cylinder()
    signals, _ = ForceMap().signals(cylinder, np.array([[30e-3, 0.3]]))
    contact, outcome = ForceMap().contact(cylinder, signals)
    assert np.isnan(contact).all()
    assert outcome[0] == Outcome.OUT_OF_REACH


def test_priors_are_used_and_bound_the_reach():
    prior = {
        "radial_distance": stats.uniform(10e-3, 20e-3),
        "deflection_angle": stats.norm(0.2, 0.05),
    }
    observer = ww.Observer(W, ForceMap(), prior=prior)
    assert observer.reach == pytest.approx((10e-3, 30e-3))
    contact = np.array([20e-3, 0.2])
    expected = sum(d.logpdf(c) for d, c in zip(prior.values(), contact, strict=True))
    x = observer.space.unconstrain(contact)
    log_jacobian = observer.space.constrain(x)[1] - expected
    h = 1e-6
    slope = [
        (observer.space.constrain(x + e)[0] - observer.space.constrain(x - e)[0]) / (2 * h)
        for e in h * np.eye(2)
    ]
    assert log_jacobian == pytest.approx(np.log(np.abs(np.linalg.det(slope))), abs=1e-6)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: Compliance(tap_angle=-0.1), "tap_angle must not be negative"),
        (lambda: Compliance(angular_velocity=0), "angular_velocity must be above zero"),
        (lambda: ww.Observer(ww.Whisker([1e-2, 2e-2], 1e-4, 5e-6), ForceMap()), "one whisker"),
        (
            lambda: ww.Observer(W, Compliance(), prior={"deflection_angle": stats.norm()}),
            "prior of 'deflection_angle' is unknown",
        ),
        (
            lambda: ww.Observer(W, Compliance(), prior={"radial_distance": stats.uniform(0.1, 1)}),
            "no overlap with what this whisker can reach",
        ),
        (lambda: ww.Observer(W, ForceMap()).read([30e-3]), "has 2 numbers"),
        (lambda: ww.Observer(W, ForceMap()).read([30e-3, 1.5]), "contact that the whisker loses"),
        (lambda: ww.Observer(W, Compliance()).read(np.nan), "contact must be finite"),
        (
            lambda: ww.Observer(W, Compliance(), GeneralisedWeber(0.1, floor=np.nan)),
            "floor must be finite",
        ),
    ],
)
def test_misuse_is_refused_in_one_sentence(call, words):
    with pytest.raises(ValueError, match=words) as error:
        call()
    assert "\n" not in str(error.value)


EVERY = [
    *CUES,
    ComparativeLength([40e-3], [[0.0, 3e-3]]),
    AngleSideAngle(),
    AngleSideAngle(side_sd=1e-3),
    TwoWhiskers(),
    ContactAndDetachment(),
    Vibration(3),
    SpaceMap(),
    BalanceOfMoments(),
    UnknownStiffness(ForceMap()),
]


STRAIGHT_ONLY = [cue for cue in EVERY if not cue.takes_curved]


@pytest.mark.parametrize("cue", STRAIGHT_ONLY, ids=repr)
def test_every_cue_refuses_whiskers_that_it_cannot_feel_through(cue):
    """A profile, and a curved whisker: by the observer, and by the cue itself."""
    profile = ww.mechanics.Profile.of(W)
    bent = ww.Whisker(50e-3, 1e-4, 5e-6, curvature=10.0)
    contact = np.full((1, len(cue.unknowns)), 0.02)
    for whisker, words in ((profile, "got a Profile"), (bent, "curvature")):
        with pytest.raises(ValueError, match=words):
            ww.Observer(whisker, cue)
        with pytest.raises(ValueError, match=words):
            cue.signals(whisker, contact)


def test_stiffness_scales_forces_alone():
    soft = ww.cues.UnknownStiffness(ww.cues.Fused(Compliance(), ww.cues.Vibration(3)))
    contact = np.array([20e-3])
    plain, _ = soft.cue.signals(W, contact)
    signals, _ = soft.signals(W, np.append(contact, 0.5))
    assert signals / plain == pytest.approx([0.5, 1.0, 1.0])
    with pytest.raises(ValueError, match="none is a force"):
        ww.cues.UnknownStiffness(ww.cues.AngleSideAngle())
