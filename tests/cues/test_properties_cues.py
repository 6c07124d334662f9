"""Properties of the balance of moments."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from property_strategies import POWERS, floats, scaled, whiskers

import weberwhisk as ww
from weberwhisk.cues import BalanceOfMoments, MuscleCurve

# Whiskers of every size may be as little curved as a slip of units would be.
pytestmark = pytest.mark.filterwarnings("ignore:curvature is in 1/m")


@given(
    whiskers(),
    st.lists(floats(0.02, 1.1), min_size=1, max_size=5),
    floats(0.6, 2.2),
    st.sampled_from(list(MuscleCurve)),
    POWERS,
    POWERS,
)
def test_where_muscle_and_whisker_balance(
    w: ww.Whisker, places: list[float], impact: float, curve: MuscleCurve, size: float, stiff: float
) -> None:
    r = np.array(places)[:, None] * w.length
    cue = BalanceOfMoments(impact, curve=curve, gain=2.0)
    angle, outcome = cue.signals(w, r)
    balanced = outcome == ww.Outcome.HELD
    assert (np.isfinite(angle[:, 0]) == balanced).all()
    # At the balance both moments are the same, and the whisker is held there.
    theta = angle[balanced, 0]
    bent = ww.press(w, r[balanced, 0], theta)
    assert np.all(bent.held)
    muscle = curve.moment(impact + theta)
    np.testing.assert_allclose(2.0 * bent.normalised_moment, muscle, rtol=1e-6, atol=1e-9)
    other, same = cue.signals(scaled(w, size, stiff), r * size)
    np.testing.assert_array_equal(same, outcome)
    np.testing.assert_allclose(other, angle, rtol=1e-11)
    # A stiffer whisker (a weaker muscle) stops sooner.
    sooner, held = replace(cue, gain=2.2).signals(w, r[balanced])
    assert (held == ww.Outcome.HELD).all()
    assert (sooner[:, 0] <= theta * (1 + 1e-9) + 1e-12).all()
