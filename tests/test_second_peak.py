"""Posteriors of several unknowns with a second peak: looked for, and said."""

import numpy as np
from cue_checks import brute_force

import weberwhisk as ww
from weberwhisk.cues import ForceMap, Fused, Vibration
from weberwhisk.fusion import prior_draws
from weberwhisk.posterior import Status
from weberwhisk.receptors import Weber

W = ww.Whisker(length=50e-3, base_radius=100e-6, tip_radius=5e-6)
#: Two modes of a vibration leave two distances; a poor map does not tell which.
CUE = Fused(Vibration(2), ForceMap())
OBSERVER = ww.Observer(W, CUE, CUE.joint(Weber(0.1), Weber(1.5)))


def test_a_second_peak_that_was_missed_is_said():
    readings = OBSERVER.read(prior_draws(OBSERVER, 24, seed=1), seed=2)
    p = ww.posterior(OBSERVER, readings)
    off = []
    for reading, mean, sd in zip(readings, p.mean, p.sd, strict=True):
        exact, width = brute_force(OBSERVER, reading, points=40_000)
        off.append(max(abs(mean - exact) / width, abs(sd / width - 1)))
    off = np.array(off)
    several = p.status == Status.SEVERAL_PEAKS
    assert several.any()
    assert np.all(off[p.status == Status.CONVERGED] < 0.02)
    assert off[several].max() > 1


def test_one_peak_is_not_taken_for_two():
    observer = ww.Observer(W, ForceMap())
    p = ww.posterior(observer, observer.read(prior_draws(observer, 60, seed=3), seed=4))
    assert not np.any(p.status == Status.SEVERAL_PEAKS)
