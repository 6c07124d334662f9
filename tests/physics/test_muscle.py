"""§2h against SciPy's integrator and root finders, and plain sampling; see also figure 3."""

from __future__ import annotations

import numpy as np
import pytest
from integrators import follow
from scipy.optimize import brentq, minimize_scalar
from short_forms import slow_but

from weberwhisk import Outcome
from weberwhisk.cues import BalanceOfMoments, MuscleCurve
from weberwhisk.mechanics import elastica
from weberwhisk.whisker import Whisker

W = Whisker(50e-3, 100e-6, 5e-6, 3e9)
IMPACT = np.radians(60)
#: The end of figure 3b over L.
END = 0.696977644


def balances(share, impact=IMPACT, curve=MuscleCurve.NORMALISED, whisker=W):
    """Angle and outcome at distances over L, by the cue of the largest effort."""
    place = np.atleast_1d(share)[:, None] * whisker.length
    angle, outcome = BalanceOfMoments(impact, curve=curve).signals(whisker, place)
    return angle[:, 0], outcome


def pressed(distance, force):
    """Normalised moment and deflection angle of W at a distance under a force, by DOP853."""
    length, scale = float(W.length), float(W.moment_scale)

    def bent(s):
        return follow(length, float(W.base_radius), float(W.tip_radius), 3e9, s, force)

    s = brentq(lambda s: bent(s)[3] - distance, distance, length, xtol=1e-15)
    return bent(s)[0] / scale, bent(s)[4]


def extreme(function, bounds):
    """Smallest value of a function of the force in µN."""
    return minimize_scalar(
        lambda f: function(f * 1e-6), bounds=bounds, method="bounded", options={"xatol": 1e-4}
    ).fun


def pull(angle, w=1.25):
    """Equation (2.2) by geometry: the sine of the angle at which a muscle pulls on the follicle.

    The follicle is a lever of length 2 from the origin, the muscle's other end at w on the x axis,
    behind it; by the cross product of the two directions.
    """
    lever = 2 * np.stack([np.cos(angle), np.sin(angle)])
    muscle = np.stack([np.full_like(angle, -w), np.zeros_like(angle)]) - lever
    cross = lever[0] * muscle[1] - lever[1] * muscle[0]
    return cross / np.hypot(*lever) / np.hypot(*muscle)


@pytest.mark.slow  # of figure 3b: `test_paper_figures.py`
def test_the_curve_of_figure_3b_ends_where_the_two_curves_touch():
    """Where the smallest excess of muscle over whisker is zero, by SciPy: r = 0.697 L."""

    def least_excess(share):
        def excess(force):
            moment, theta = pressed(share * W.length, force)
            return pull(IMPACT + theta) / 0.625 - 2 * moment

        return extreme(excess, (50, 100))

    end, tiny = END, 1e-8
    assert least_excess(end - tiny) < 0 < least_excess(end + tiny)
    _, outcome = balances([end - tiny, end + tiny])
    assert outcome.tolist() == [Outcome.HELD, Outcome.FLICKED_PAST]


def test_printed_curve_peaks_at_half_w_near_128_7_degrees():
    peak = minimize_scalar(
        lambda a: -MuscleCurve.PRINTED.moment(a), bounds=(1, 3), method="bounded"
    )
    assert -peak.fun == pytest.approx(0.625, abs=1e-9)
    assert np.degrees(peak.x) == pytest.approx(128.7, abs=0.05)
    angle = np.linspace(0.1, 3, 50)
    np.testing.assert_allclose(
        MuscleCurve.NORMALISED.moment(angle), MuscleCurve.PRINTED.moment(angle) / 0.625
    )
    # Equation (2.2), with the arctangent on the branch that keeps the moment continuous.
    w = 1.25
    np.testing.assert_allclose(
        MuscleCurve.PRINTED.moment(angle),
        w * np.sin(angle) / np.sqrt(w**2 + 4 * w * np.cos(angle) + 4),
        rtol=1e-12,
    )


@pytest.mark.parametrize("w", [0.4, 1.25, 1.999, 2.0, 5.0])
def test_the_curve_is_the_triangle_and_goes_on_through_128_7_degrees(w):
    """The principal value of the arctangent would jump by twice the moment there."""
    angle = np.linspace(0.001, np.pi - 0.001, 4001)
    curve = MuscleCurve.PRINTED.moment(angle, w)
    np.testing.assert_allclose(curve, pull(angle, w), rtol=1e-11)
    assert np.all(curve > 0)
    np.testing.assert_allclose(MuscleCurve.NORMALISED.moment(angle, w).max(), 1.0, rtol=1e-6)
    jumps = np.sin(angle - np.arctan(2 * np.sin(angle) / (w + 2 * np.cos(angle))))
    assert np.allclose(jumps, curve) == (w >= 2)


@pytest.mark.slow
def test_either_scale_gives_the_same_balance_on_its_own_gain():
    share = np.linspace(0.3, 0.99, 24)
    for impact in np.radians(np.linspace(30, 149, 9)):
        one, other = (balances(share, impact, curve) for curve in MuscleCurve)
        np.testing.assert_array_equal(one[1], other[1])
        np.testing.assert_allclose(one[0], other[0], rtol=1e-9)


@pytest.mark.parametrize("curve", MuscleCurve)
def test_balance_is_the_root_that_scipy_finds(curve):
    for share in (0.3, 0.45):
        r = share * W.length
        (angle,), (outcome,) = balances(share, curve=curve)
        assert outcome == Outcome.HELD

        def excess(t, r=r):
            bent = elastica.press(W, r, t).normalised_moment
            return curve.moment(IMPACT + t) - curve.gain() * bent

        # Observers' tables of the elastica are good to 1e-9.
        assert angle == pytest.approx(brentq(excess, 1e-6, 0.3, xtol=1e-15), rel=1e-8)


@pytest.mark.parametrize(
    "whisker", slow_but([W, W.cylinder(), Whisker(50e-3, 1e-4, 0.0)], (0,)), ids=repr
)
@pytest.mark.parametrize("curve", MuscleCurve)
def test_every_outcome_of_figure_3c_by_plain_sampling(curve, whisker):
    """Below the dashed line the whisker flicks past; above it the range of whisking ends."""
    share = np.append(np.linspace(0.02, 0.96, 15), [0.99, 1.02])
    limit = elastica.flick_past(whisker, share * whisker.length)
    flick, seen = np.nan_to_num(limit.deflection_angle), set()
    for impact in np.radians([30.0, 35.0, 60.0, 90.0, 120.0, 145.0, 149.0]):
        angle, outcome = balances(share, impact, curve, whisker)
        room = np.radians(150) - impact
        # Closer steps towards the fold, about which everything goes as a square root.
        reach, steps = np.minimum(flick, room), 1 - (1 - np.linspace(0, 1, 3000)) ** 2
        theta = steps[:, None] * reach * (1 - 1e-9)
        moment = elastica.press(whisker, share * whisker.length, theta).normalised_moment
        stopped = curve.moment(impact + theta) <= curve.gain() * np.nan_to_num(moment, nan=0.0)
        held = stopped.any(axis=0)
        expected = np.where(flick > room, Outcome.END_OF_WHISKING, limit.ended_by)
        expected[held] = Outcome.HELD
        expected[np.equal(limit.ended_by, Outcome.OUT_OF_REACH)] = Outcome.OUT_OF_REACH
        np.testing.assert_array_equal(outcome, expected)
        first = np.argmax(stopped, axis=0)[held]
        at, before = (theta[i, np.flatnonzero(held)] for i in (first, np.maximum(first - 1, 0)))
        np.testing.assert_array_less(angle[held], at * (1 + 1e-7) + 1e-12)
        np.testing.assert_array_less(before * (1 - 1e-7), angle[held] + 1e-12)
        assert np.all(np.isnan(angle[~held]))
        seen.update(outcome.tolist())
    assert seen >= {Outcome.HELD, Outcome.END_OF_WHISKING, Outcome.OUT_OF_REACH}
    assert Outcome.FLICKED_PAST in seen or whisker.taper == 0


@pytest.mark.parametrize("share", [0.7])
@pytest.mark.slow  # of the fold: `test_profile.py`
def test_the_fold_and_the_moment_peak_end_the_two_kinds_of_flick_past(share):
    """Imposed angle: the largest angle of any force. Limited moment: the largest moment."""
    r, most = share * W.length, 700 if share == 0.5 else 200
    limit = elastica.flick_past(W, r)
    fold = -extreme(lambda force: -pressed(r, force)[1], (10, most))
    peak = -extreme(lambda force: -pressed(r, force)[0], (10, most))
    assert limit.deflection_angle == pytest.approx(fold, rel=1e-9)
    assert limit.at_moment_peak.normalised_moment == pytest.approx(peak, rel=1e-9)
    assert limit.at_moment_peak.deflection_angle < limit.deflection_angle
