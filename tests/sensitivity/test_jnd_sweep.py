"""A surface of JNDs is the curves that it is made of."""

import numpy as np
import pandas as pd
import pytest

import weberwhisk as ww

W = ww.Whisker(50e-3, 100e-6, 5e-6)


@pytest.mark.parametrize("angles", [None, [0.05, 0.1]])
def test_rows_are_those_of_jnd_curve(angles):
    k, r = [0.05, 0.1], [15e-3, 35e-3]
    table = ww.jnd_sweep(W, k, r, angles, n_readings=4, seed=3)
    places = [(fraction, angle) for fraction in k for angle in angles or [None]]
    seeds = np.random.SeedSequence(3).spawn(len(places))
    parts = []
    for (fraction, angle), seed in zip(places, seeds, strict=True):
        cue = ww.cues.Compliance() if angle is None else ww.cues.ForceMap()
        observer = ww.Observer(W, cue, ww.receptors.Weber(fraction))
        curve = ww.jnd_curve(observer, r, angle, n_readings=4, seed=seed)
        parts.append(curve.table.reset_index())
        parts[-1].insert(0, "weber_fraction", fraction)
    pd.testing.assert_frame_equal(table, pd.concat(parts, ignore_index=True), check_exact=True)


def test_several_whiskers_are_refused():
    several = ww.Whisker([50e-3, 40e-3], 100e-6, 5e-6)
    with pytest.raises(ValueError, match="A sweep has one whisker"):
        ww.jnd_sweep(several, 0.1, 10e-3, seed=1)
