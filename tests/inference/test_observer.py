"""Observers are frozen, say what they refuse, and say what their model of the mechanics costs."""

import pickle
from dataclasses import FrozenInstanceError, replace

import numpy as np
import pytest
from scipy import stats
from short_forms import slow_but

import weberwhisk as ww
from weberwhisk import cues, receptors

W = ww.Whisker(50e-3, 100e-6, 5e-6)
STIFFNESS = cues.UnknownStiffness(cues.ForceMap())


def test_an_observer_does_not_change():
    observer = ww.Observer(W, cues.ForceMap(), prior={"radial_distance": stats.uniform(1e-2, 2e-2)})
    with pytest.raises(FrozenInstanceError):
        observer.noise = receptors.Weber(0.2)  # type: ignore[misc]
    with pytest.raises(TypeError, match="does not support item assignment"):
        observer.prior["radial_distance"] = stats.uniform(0, 1)  # type: ignore[index]
    other = replace(observer, noise=receptors.Weber(0.2))
    assert (other.reach, other.prior.keys()) == (observer.reach, observer.prior.keys())
    assert len({observer: 1, other: 2}) == 2


def test_observers_are_equal_by_value():
    def made(k=0.1, low=1e-2):
        prior = {"radial_distance": stats.uniform(low, 2e-2)}
        cue = cues.UnknownStiffness(cues.ForceMap())
        return ww.Observer(ww.Whisker(50e-3, 100e-6, 5e-6), cue, receptors.Weber(k), prior)

    assert made() == made()
    assert len({made(), made(), made(k=0.2), made(low=2e-2)}) == 3
    assert made() != replace(made(), model="elastica")
    # A histogram tells its family what it is: two of them were one, and had one posterior.
    ends = [np.linspace(5e-3, 20e-3, 4), np.linspace(20e-3, 45e-3, 4)]
    tables = [{"radial_distance": stats.rv_histogram((np.ones(3), e))()} for e in ends]
    near, far = (ww.Observer(W, cues.Compliance(), prior=prior) for prior in tables)
    assert near != far
    assert ww.posterior(near, [1.5e-5]).mean < 20e-3 < ww.posterior(far, [1.5e-5]).mean
    assert made() != "an observer"


@pytest.mark.parametrize(
    ("cue", "changed"),
    [
        (STIFFNESS, {"cue": cues.UnknownStiffness(cues.ForceMap(), 0.05)}),
        (STIFFNESS, {"cue": cues.ForceMap()}),
        (cues.SpaceMap(), {"cue": cues.ForceMap()}),
        (cues.AngleSideAngle(), {"whisker": ww.Whisker(30e-3, 60e-6, 3e-6)}),
    ],
)
def test_one_made_from_another_has_its_own_defaults_and_the_users_choices(cue, changed):
    """It kept the priors and noise of the cue that was replaced: 6.8 mm where 3.9 was right."""
    prior = {"radial_distance": stats.uniform(1e-3, 2e-2)}
    for given in ({}, {"prior": prior}):
        made = ww.Observer(W, cue, **given)
        fresh = ww.Observer(**{"whisker": W, "cue": cue, **given, **changed})
        for observer in (made, pickle.loads(pickle.dumps(made))):
            assert replace(observer, **changed) == fresh
            assert replace(replace(observer, **changed), cue=cue, whisker=W) == made
    own = receptors.Weber(0.2)
    assert replace(ww.Observer(W, cues.ForceMap(), own), cue=cues.Compliance()).noise is own


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("C2", cues.Compliance()), "needs a Whisker"),
        ((W, "compliance"), "needs a cue, got 'compliance'"),
        ((W, cues.Compliance), "needs a cue, got the class Compliance"),
        ((W, 3.0), "needs a cue, got 3.0"),
        ((W, cues.Compliance(), 0.1), "needs receptor noise, got 0.1"),
        ((W, cues.Compliance(), receptors.Weber), "needs receptor noise, got the class Weber"),
        ((W, cues.Compliance(), None, 3.0), "prior must be a mapping"),
        ((W, cues.Compliance(), None, [stats.norm()]), "prior must be a mapping"),
        ((W, cues.Compliance(), None, {"radial_distance": 3.0}), "frozen SciPy distribution"),
        ((W, cues.Compliance(), None, {"distance": stats.norm()}), "radial_distance"),
    ],
)
def test_what_an_observer_refuses(arguments, says):
    with pytest.raises(ValueError, match=says):
        ww.Observer(*arguments)


def off_in_jnds(observer, contact):
    """How far r is off, in JNDs, where the closed form reads the exact signals of a contact."""
    exact, _ = observer.signals(contact)
    wrong = ww.posterior(replace(observer, model="closed_form"), exact)
    right = ww.posterior(observer, exact)
    return abs(wrong.mean - right.mean) / right.sd


def test_what_the_closed_form_would_cost_is_true():
    """Against posteriors under either model, at k = 0.01 where first order is close."""
    cue, noise = cues.ForceMap("moment", deflection_angle=0.02), receptors.Weber(0.01)
    observer = ww.Observer(W, cue, noise)
    r = observer.reach[1] * np.linspace(0.02, 0.98, 6)
    worst = np.max(off_in_jnds(observer, r[:, None]))
    said = float(observer.why.split("up to ")[1].split()[0])
    assert said == pytest.approx(worst, rel=0.1)
    assert replace(observer, model="closed_form").why == "closed_form was requested"


SCENES = [cues.Compliance(), cues.ForceMap(), cues.SpaceMap()]


@pytest.mark.parametrize("method", slow_but(["quadrature", "laplace"], (0,)))
@pytest.mark.parametrize("cue", SCENES, ids=repr)
def test_a_missing_reading_leaves_the_others_as_they_are(cue, method):
    observer = ww.Observer(W, cue)
    contact = observer.space.constrain(observer.space.spread(np.array([0.3, 0.4, 0.5])))[0][:3]
    readings = observer.read(contact, seed=1)
    broken = np.insert(readings, [0, 2], np.nan, axis=0)
    broken[0, 0] = np.inf
    known = np.isfinite(broken).all(axis=1)
    p, whole = (ww.posterior(observer, y, method) for y in (broken, readings))
    lost = ww.Status.NOT_A_READING
    assert np.array_equal(p.status == lost, ~known)
    for name, estimate in whole.estimates.items():
        for ours, theirs in zip(p.estimates[name], estimate, strict=True):
            assert np.array_equal(ours[known], theirs)
            assert np.isnan(ours[~known]).all()
    assert np.array_equal(p.interval()[known], whole.interval())
    assert np.isnan(p.interval()[~known]).all()
    assert p.to_arviz(draws=10)["posterior"]["radial_distance"].shape == (4, 10, 5)
    table = p.summary()
    assert (table.status == lost.message).sum() == 2 * len(observer.unknowns)
    assert np.array_equal(p.outcome == ww.Outcome.NOT_A_READING, ~known)
