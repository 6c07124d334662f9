"""What a cue's method makes of a reading, said by the posterior; and whiskers that no cue knows."""

import numpy as np
import pytest

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

W = ww.Whisker(length=50e-3, base_radius=100e-6, tip_radius=5e-6)
ARRAY = ComparativeLength([30e-3], [[0.0, 6e-3]])
CUES = [
    VibrissaLength(), ARRAY, AngleSideAngle(), TwoWhiskers(), ContactAndDetachment(), Vibration(2),
    Compliance(), ForceMap(), SpaceMap(), UnknownStiffness(ForceMap()),
    BalanceOfMoments(), BalanceOfMoments(effort=None), Fused(Compliance(), ForceMap()),
]  # fmt: skip


@pytest.mark.parametrize(
    ("cue", "reading", "outcome"),
    [
        (ARRAY, [0, 1], Outcome.CONTRADICTORY),
        (ARRAY, [0, 0], Outcome.NO_TOUCH),
        (ARRAY, [1, 0], Outcome.HELD),
        (VibrissaLength(), [1, 0], Outcome.TIP_NOT_TOUCHED),
        (AngleSideAngle(), [1.5, 1.4], Outcome.PARALLEL),
        (Compliance(), [1e-5], Outcome.HELD),
        (Fused(Compliance(), ARRAY), [1e-5, 0, 1], Outcome.CONTRADICTORY),
    ],
)
def test_the_posterior_says_what_the_method_makes_of_the_reading(cue, reading, outcome):
    p = ww.posterior(ww.Observer(W, cue), np.array(reading, dtype=float))
    assert p.outcome is outcome
    assert p.summary()["outcome"][0] == outcome.message
    # Lengths and angles are uncertain: there is a posterior all the same.
    assert np.isfinite(p.sd)


@pytest.mark.parametrize("cue", [c for c in CUES if not c.takes_curved], ids=repr)
def test_curved_whiskers_and_profiles_are_refused_in_one_sentence(cue):
    curved = ww.Whisker(50e-3, 100e-6, 5e-6, curvature=20.0)
    contact = np.array([20e-3, 0.2, 0.1])[: len(cue.unknowns)]
    for call in (lambda w: ww.Observer(w, cue), lambda w: cue.signals(w, contact)):
        for whisker, words in (
            (curved, "for straight whiskers, got curvature 20"),
            ("a profile", "needs a Whisker, straight and without friction, got a str"),
        ):
            with pytest.raises(ValueError, match=words) as error:
                call(whisker)
            assert str(error.value).count(";") == 1


def test_a_reading_far_below_all_signals_has_no_inverse():
    """Newton's method met a point where nothing changes, and `summary()` raised."""
    observer = ww.Observer(W, ForceMap(), ww.receptors.Weber(0.3))
    reading = [[2.9125190529052675e-08, 3.681067958641244e-07], [2e-6, 1e-4]]
    assert observer.reading_outcome(reading).tolist() == [Outcome.OUT_OF_REACH, Outcome.HELD]
