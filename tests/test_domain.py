"""Magnitudes outside the stated domain: refused where surely a slip of units, else flagged."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from short_forms import slow_but

import weberwhisk as ww
from weberwhisk import Observer, Status, Whisker, cues, domain, posterior, receptors
from weberwhisk.sensitivity import prior_draws

GOOD = (41e-3, 80e-6, 4e-6)


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ((41.0, 80e-6, 4e-6), "41 m is none: did you pass millimetres"),
        ((41.0, 80.0, 4.0), "41 m is none: did you pass millimetres"),
        ((41e-3, 80.0, 4.0), "base_radius 80 m: did you pass micrometres"),
        ((41e-3, 0.08, 0.004), "base_radius 0.08 m: did you pass micrometres or millimetres"),
        (([41e-3, 41.0], 80e-6, 4e-6), "41 m is none"),
    ],
)
def test_a_slip_of_units_is_refused_with_a_hint(fields, words):
    with pytest.raises(ValueError, match=words):
        ww.Whisker(*fields)


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ((1.9e-3, 50e-6, 5e-6), "a length of 1.9 mm"),
        ((0.21, 500e-6, 5e-6), "a length of 210 mm"),
        ((50e-3, 100e-6, 0.99e-7), "a radius ratio of 1010.1"),
    ],
)
def test_what_is_merely_unusual_is_flagged(fields, words):
    w = ww.Whisker(*fields)
    assert words in domain.sentence(domain.of_whisker(w))
    bent = ww.press(w, 0.5 * w.length, 0.1)
    assert words in bent.outside_domain
    assert bent.outcome == ww.Outcome.HELD


@pytest.mark.parametrize(
    "fields", [GOOD, (2e-3, 50e-6, 0.0), (0.2, 1e-3, 1e-6), (50e-3, 1e-4, 1e-4)]
)
def test_nothing_inside_is_flagged(fields):
    w = ww.Whisker(*fields)
    bent = ww.press(w, np.array([0.01, 0.5, 0.99, 1.5]) * w.length, 0.01)
    assert bent.outside_domain == ""
    near = ww.press(w, np.array([0.009, 0.5]) * w.length, 0.001)
    assert near.outside_domain.startswith("Outside the domain: a contact at 0.009 of the reach")
    assert ww.bend(w, 0.5 * w.length, 0.0).outside_domain == ""


@dataclass(frozen=True, eq=False, repr=False)
class _SquareRoot(receptors.Gaussian):
    """A law without a Weber fraction: however sharp, its posteriors were never flagged."""

    size: float = 0.1
    correlation: float = 0.0

    def sd(self, signals):
        return self.size * np.sqrt(np.abs(signals))


def test_receptors_of_per_cent_are_flagged():
    w = ww.Whisker(*GOOD)
    observer = ww.Observer(w, ww.cues.Compliance(), ww.receptors.Weber(10.0))
    assert "did you pass per cent" in domain.sentence(domain.of_observer(observer))
    assert domain.of_observer(ww.Observer(w, cues.Compliance(), _SquareRoot(1e-4))) == ()
    sharp = ww.Observer(w, cues.Compliance(), _SquareRoot(1e-7))
    assert "a Weber fraction of" in domain.sentence(domain.of_observer(sharp))
    p = posterior(sharp, sharp.read(20e-3, seed=1))
    assert p.status == Status.OUTSIDE_DOMAIN
    both = receptors.Joint([receptors.Weber(0.1), _SquareRoot(1e-12)], [1, 1])
    fractions = ww.Observer(w, cues.ForceMap(), both).usual_weber_fractions
    assert fractions[0] == 0.1
    assert 0 < fractions[1] < 1e-3
    angles = ww.Observer(w, ww.cues.SpaceMap())  # part of its noise has no Weber fraction
    assert domain.of_observer(angles) == ()


@pytest.mark.parametrize(
    ("cue", "count"),
    slow_but(
        [
            (cues.Compliance(), 20),
            (cues.ForceMap(), 2),
            (cues.ForceMap(), 20),
            (cues.Fused(cues.ForceMap(), cues.Compliance()), 20),
        ],
        quick=(0, 1),
    ),
)
def test_readings_far_from_every_contact_are_flagged(cue, count):
    """More than 8 sd from all of 20 000 contacts of the prior, in some signal: never converged."""
    size = len(cue.signal_names)
    noise = receptors.Weber(0.03)
    observer = Observer(Whisker(50e-3, 100e-6, 5e-6), cue, noise)
    signals = observer.signals(prior_draws(observer, 20_000, seed=1))[0]
    rng = np.random.default_rng(2)
    reading = signals[:20] * np.exp(rng.uniform(-5, 5, (20, size)))
    reading[10:] = signals[:10] * rng.uniform(-1.0, 0.0, (10, size))  # and of a wrong sign
    sd = noise.sd(signals)
    off = np.array([np.abs((y - signals) / sd).max(axis=1).min() for y in reading])
    assert (off > 8).sum() >= 8
    far = reading[off > 8][:: 20 // count]
    status = posterior(observer, far).status
    relied_on = np.isin(status, (Status.CONVERGED, Status.UNIDENTIFIED))
    assert not relied_on.any(), far[relied_on]
