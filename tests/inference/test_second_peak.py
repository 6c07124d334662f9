"""Posteriors of several unknowns with a second peak: none is missed."""

import numpy as np
import pytest
from cue_checks import brute_force

import weberwhisk as ww
from weberwhisk.cues import ForceMap, Fused, Vibration
from weberwhisk.inference import Status
from weberwhisk.receptors import Weber
from weberwhisk.sensitivity import prior_draws

W = ww.Whisker(length=50e-3, base_radius=100e-6, tip_radius=5e-6)
#: Two modes of a vibration leave two distances; a poor map does not tell which.
CUE = Fused(Vibration(2), ForceMap())
OBSERVER = ww.Observer(W, CUE, CUE.joint(Weber(0.1), Weber(1.5)))


@pytest.mark.slow  # of modes: `test_tree.py`
def test_no_second_peak_is_missed():
    """A climb from one place found the wrong one of two peaks, and at best could say so."""
    readings = OBSERVER.read(prior_draws(OBSERVER, 8, seed=1), seed=2)[::2]
    p = ww.posterior(OBSERVER, readings)
    assert np.isin(p.status, (Status.OUTSIDE_DOMAIN, Status.UNIDENTIFIED)).all()  # k = 1.5
    for reading, mean, sd in zip(readings, p.mean, p.sd, strict=True):
        exact, width = brute_force(OBSERVER, reading, points=40_000)
        assert abs(mean - exact) < 1e-3 * width
        assert abs(sd - width) < 1e-3 * width
