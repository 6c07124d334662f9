"""Observers are frozen, say what they refuse, and say what their model of the mechanics costs."""

import pickle
from dataclasses import FrozenInstanceError, replace

import numpy as np
import pytest
from scipy import stats

import weberwhisk as ww
from weberwhisk import cues, receptors
from weberwhisk.surveys import CUES

W = ww.Whisker(50e-3, 100e-6, 5e-6)


def test_an_observer_does_not_change():
    observer = ww.Observer(W, cues.ForceMap(), prior={"radial_distance": stats.uniform(1e-2, 2e-2)})
    with pytest.raises(FrozenInstanceError):
        observer.noise = receptors.Weber(0.2)  # type: ignore[misc]
    with pytest.raises(TypeError, match="does not support item assignment"):
        observer.prior["radial_distance"] = stats.uniform(0, 1)  # type: ignore[index]
    other = replace(observer, noise=receptors.Weber(0.2))
    assert (other.reach, other.prior.keys()) == (observer.reach, observer.prior.keys())
    assert len({observer: 1, other: 2}) == 2


@pytest.mark.parametrize(
    "cue", [cues.ForceMap(), cues.UnknownStiffness(cues.ForceMap()), cues.SpaceMap()], ids=repr
)
def test_an_observer_travels_to_another_process(cue):
    observer = ww.Observer(W, cue, model=None)
    again = pickle.loads(pickle.dumps(observer))
    x = np.full((1, len(observer.unknowns)), 0.3)
    assert np.array_equal(again.contact(x)[0], observer.contact(x)[0])


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
    cue, noise = cues.ForceMap("moment", deflection_angle=0.1), receptors.Weber(0.01)
    observer = ww.Observer(W, cue, noise)
    r = observer.reach[1] * np.linspace(0.1, 0.9, 6)
    worst = np.max(off_in_jnds(observer, r[:, None]))
    said = float(observer.why.split("up to ")[1].split()[0])
    assert said == pytest.approx(worst, rel=0.1)
    assert replace(observer, model="closed_form").why == "closed_form was asked for"


def test_every_cue_says_why():
    for cue in CUES.values():
        assert ww.Observer(W, cue).why.endswith("allowed")
