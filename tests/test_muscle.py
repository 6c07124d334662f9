"""§2h against the paper's figure, the theory notes and a plain root finder."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import brentq, minimize_scalar

from weberwhisk.mechanics import elastica
from weberwhisk.mechanics.muscle import Balance, MuscleCurve, moment_balance
from weberwhisk.whisker import Whisker

W = Whisker(50e-3, 100e-6, 5e-6, 3e9)
IMPACT = np.radians(60)


def test_figure_3b():
    """The five values read off the figure, by the theory notes' reading of its curve."""
    r = np.linspace(0.3, 0.68, 2000) * W.length
    b = moment_balance(W, r, IMPACT)
    assert np.all(np.diff(b.balance_angle[b.outcome == 0]) > 0)  # monotonic, so a cue
    got = moment_balance(W, np.array([0.3, 0.4, 0.5, 0.6, 0.65]) * W.length, IMPACT)
    np.testing.assert_allclose(
        np.degrees(got.balance_angle), [2.55, 4.06, 6.29, 10.09, 13.54], atol=0.006
    )


def test_the_curve_of_figure_3b_ends_at_0_684_of_the_length():
    def balanced(share):
        return float(moment_balance(W, share * W.length, IMPACT).outcome == Balance.BALANCED) - 0.5

    end = brentq(balanced, 0.6, 0.8, xtol=1e-5)
    assert end == pytest.approx(0.684, abs=1e-3)  # "≈": the curves touch at 0.6848


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


def test_figure_curve_is_what_was_read_off():
    angles = np.radians([30, 113, 150])
    np.testing.assert_allclose(MuscleCurve.FIGURE.moment(angles), [0.125, 1.0, 0.80], atol=4e-3)


@pytest.mark.parametrize("curve", MuscleCurve)
def test_balance_is_the_root_that_scipy_finds(curve):
    for share in (0.3, 0.45):
        r = share * W.length
        b = moment_balance(W, r, IMPACT, curve=curve)
        assert b.outcome is Balance.BALANCED

        def excess(t, r=r):
            bent = elastica.press(W, r, t).normalised_moment
            return curve.moment(IMPACT + t) - 2 * bent

        assert b.balance_angle == pytest.approx(brentq(excess, 1e-6, 0.3, xtol=1e-15), rel=1e-10)
        assert b.moment == pytest.approx(
            curve.moment(IMPACT + b.balance_angle) * W.moment_scale / 2, rel=1e-9
        )


def test_white_areas_of_figure_3c():
    """Below the dashed line the whisker flicks past; above it the range of whisking ends."""
    late = moment_balance(W, np.array([0.3, 0.6, 0.9, 1.01]) * W.length, np.radians([[60], [147]]))
    assert late.outcome.shape == (2, 4)
    assert [Balance(k) for k in late.outcome[0]] == [
        Balance.BALANCED,
        Balance.BALANCED,
        Balance.FLICKED_PAST,
        Balance.OUT_OF_REACH,
    ]
    assert [Balance(k) for k in late.outcome[1]] == [Balance.END_OF_WHISKING] * 3 + [
        Balance.OUT_OF_REACH
    ]
    assert np.all(np.isnan(late.balance_angle[late.outcome != 0]))
    np.testing.assert_allclose(late.end_angle[1, :3], np.radians(3))
    tip = moment_balance(W, 0.99 * W.length, IMPACT)
    assert tip.outcome is Balance.SLIPPED_OFF_TIP
    assert all(outcome.message for outcome in Balance)


def test_flick_past_under_a_limited_moment_comes_at_the_moment_peak():
    """A muscle of constant moment just below the peak holds; just above it, it flicks past."""
    r = 0.7 * W.length
    peak = elastica.flick_past(W, r).at_moment_peak
    need = MuscleCurve.FIGURE.moment(IMPACT + peak.deflection_angle) / peak.normalised_moment
    # The muscle still grows with the angle, so it is the gain that decides, just off the peak.
    assert moment_balance(W, r, IMPACT, gain=1.05 * need).outcome is Balance.BALANCED
    assert moment_balance(W, r, IMPACT, gain=0.9 * need).outcome is Balance.FLICKED_PAST


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: moment_balance(W, 0.02, 0.1), "must be in the range of whisking"),
        (lambda: moment_balance(W, 0.02, 1.0, gain=0.0), "gain must be above zero"),
        (lambda: moment_balance(Whisker(0.05, 1e-4, 5e-6, curvature=1.0), 0.02, 1.0), "straight"),
    ],
)
def test_misuse_is_one_sentence(make, message):
    with pytest.raises(ValueError, match=message):
        make()
