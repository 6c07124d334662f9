"""Posteriors of several unknowns with a second peak: none is missed."""

import numpy as np
import pytest
from cue_checks import brute_force

import weberwhisk as ww
from weberwhisk.cues import ForceMap, Fused, SpaceMap, Vibration
from weberwhisk.cues.force_map import SIGNALS
from weberwhisk.inference import Status, default_noise
from weberwhisk.receptors import Weber
from weberwhisk.sensitivity import prior_draws

W = ww.Whisker(length=50e-3, base_radius=100e-6, tip_radius=5e-6)
#: Two modes of a vibration leave two distances; a poor map does not tell which.
CUE = Fused(Vibration(2), ForceMap())
OBSERVER = ww.Observer(W, CUE, CUE.joint(Weber(0.1), Weber(1.5)))


def test_no_second_peak_is_missed():
    """A climb from one place found the wrong one of two peaks, and at best could say so."""
    readings = OBSERVER.read(prior_draws(OBSERVER, 8, seed=1), seed=2)[::2]
    p = ww.posterior(OBSERVER, readings)
    assert np.isin(p.status, (Status.OUTSIDE_DOMAIN, Status.UNIDENTIFIED)).all()  # k = 1.5
    for reading, mean, sd in zip(readings, p.mean, p.sd, strict=True):
        exact, width = brute_force(OBSERVER, reading, points=40_000)
        assert abs(mean - exact) < 1e-3 * width
        assert abs(sd - width) < 1e-3 * width


def test_one_peak_is_not_taken_for_two():
    observer = ww.Observer(W, ForceMap())
    p = ww.posterior(observer, observer.read(prior_draws(observer, 60, seed=3), seed=4))
    assert not np.any(p.status == Status.SEVERAL_PEAKS)


@pytest.mark.parametrize(
    ("cue", "contact"),
    [
        (ForceMap(SIGNALS), [0.03198637, 0.50927061]),
        pytest.param(  # 9 s on the plain grid
            SpaceMap(), [0.03202618, 0.50819100, 2.40874708], marks=pytest.mark.slow
        ),
    ],
)
def test_an_ordinary_reading_is_not_called_improbable(cue, contact):
    """Of many signals at k = 0.003 the coarse grid's best point may lie in another valley.

    One reading in a hundred was said to be none that such a contact gives.
    """
    observer = ww.Observer(W, cue, default_noise(W, cue, 0.003))
    p = ww.posterior(observer, observer.signals(np.array([contact]))[0])
    assert p.status[0] == Status.OUTSIDE_DOMAIN  # as such receptors are
    assert abs(p.mean[0] - contact[0]) < 2 * p.sd[0]
