"""Each equation and claim of §2e, §2f and §3 of Solomon & Hartmann (2011), as a test."""

import numpy as np
import pytest

import weberwhisk as ww
from weberwhisk import Outcome
from weberwhisk.cues import Compliance, ForceMap
from weberwhisk.jnd import weber_propagation
from weberwhisk.mechanics import closed_form
from weberwhisk.receptors import Weber

CONE = ww.Whisker(50e-3, 100e-6, 0.0)  # the paper's assumption in §2e: taper to zero at the tip
W = ww.Whisker(50e-3, 100e-6, 5e-6)  # and in §2f: base over tip 20
CYLINDER = W.cylinder()
L = W.length


def compliance_jnd(whisker, r, k=0.1):
    return weber_propagation(ww.Observer(whisker, Compliance(), Weber(k)), np.reshape(r, (-1, 1)))


def map_jnd(whisker, r, theta, noise):
    contact = np.stack(np.broadcast_arrays(r, theta), axis=-1)
    return weber_propagation(ww.Observer(whisker, ForceMap(), noise), contact)


def test_equations_2_1_and_2_3():
    c, r, theta = CONE.compliance_constant, np.linspace(0.1, 0.9, 9) * L, 0.02
    moment = c * theta * (1 / r - 1 / L)
    assert np.allclose(closed_form.moment(CONE, r, theta), moment)
    assert np.allclose(closed_form.distance_from_moment(CONE, moment, theta), r)
    assert np.allclose(c * theta * L / (c * theta + moment * L), r)  # (2.1) as printed


def test_2_3_is_the_small_angle_limit_of_the_beam():
    r = np.linspace(0.1, 0.9, 9) * L
    beam = ww.press(CONE, r, 1e-6).moment
    assert np.allclose(beam, closed_form.moment(CONE, r, 1e-6), rtol=1e-8)


def test_moment_rate_falls_with_distance():
    """§2e: a monotonic relationship between distance and Ṁ for any given velocity."""
    r = np.linspace(0.01, 0.999, 500)[:, None] * L
    for whisker in (CONE, W, CYLINDER):
        assert np.all(np.diff(Compliance().signals(whisker, r)[0][:, 0]) < 0)


def test_the_tapered_whisker_needs_smaller_forces_for_90_degrees_above_all_near_the_tip():
    """§2f on figure 2b, c."""

    def force_at_90(whisker, s):
        force = np.geomspace(1e-9, 1e-1, 4000)
        alpha = ww.bend(whisker, s, force).contact_angle
        return np.interp(np.pi / 2, alpha[np.isfinite(alpha)], force[np.isfinite(alpha)])

    ratio = [force_at_90(W, s * L) / force_at_90(CYLINDER, s * L) for s in (0.3, 0.5, 0.7, 0.9)]
    assert np.all(np.array(ratio) < 1)
    assert np.all(np.diff(ratio) < 0)


def test_the_map_of_the_tapered_whisker_is_one_to_one():
    """§2f, figure 2d, e: moment and axial force give distance and angle.

    The Jacobian's determinant keeps its sign over all held contacts, and the inverse found from
    the signals alone is the contact they came from.
    """
    r = np.linspace(0.02, 0.97, 60)[:, None] * L
    theta = np.linspace(0.02, 0.98, 60) * ww.flick_past(W, r).deflection_angle
    contact = np.stack(np.broadcast_arrays(r, theta), axis=-1).reshape(-1, 2)
    (a, b), (c, d) = np.moveaxis(ForceMap().jacobian(W, contact), 0, -1)
    assert len(set(np.sign(a * d - b * c))) == 1
    signals, outcome = ForceMap().signals(W, contact)
    assert np.all(outcome == Outcome.HELD)
    found, _ = ForceMap().contact(W, signals)
    assert np.allclose(found, contact, rtol=1e-5)


def test_the_map_of_the_cylinder_is_one_curve():
    """§2f, figure 2f: M² = 2EI·Fx at every load, so that nothing tells distance."""
    r = np.linspace(0.05, 0.5, 30)[:, None] * L
    theta = np.linspace(0.01, 1.6, 40)
    bent = ww.press(CYLINDER, r, theta)
    assert bent.held.all()
    ratio = bent.moment**2 / (2 * CYLINDER.stiffness * bent.axial_force)
    assert np.allclose(ratio, 1, rtol=1e-11)


def test_a_taper_lies_strictly_below_the_cylinders_curve():
    r = np.linspace(0.05, 0.95, 30)[:, None] * L
    theta = np.linspace(0.02, 0.98, 30) * ww.flick_past(W, r).deflection_angle
    bent = ww.press(W, r, theta)
    assert np.all(bent.moment**2 < 2 * W.stiffness * bent.axial_force)


def test_equation_3_1_webers_law():
    assert Weber(0.1).sd([1.0, 2.0, 10.0]) == pytest.approx([0.1, 0.2, 1.0])


def test_equation_3_3_slope_of_the_moment_rate():
    r = 0.4 * L
    slope = Compliance(angular_velocity=2.0).jacobian(CONE, np.array([r]))[0, 0]
    assert slope == pytest.approx(-CONE.compliance_constant * 2.0 / r**2)


def test_equations_3_5_and_3_6():
    r = np.linspace(0.05, 0.95, 19) * L
    assert np.allclose(compliance_jnd(CONE, r), 0.1 * r * (1 - r / L))
    assert np.allclose(compliance_jnd(CYLINDER, r), 0.1 * r)


def test_a_truncated_whisker_has_the_apex_distance_in_the_place_of_L():
    r = np.linspace(0.05, 1.0, 20) * L
    assert np.allclose(compliance_jnd(W, r), 0.1 * r * (1 - r / W.apex_distance))
    assert compliance_jnd(W, L) == pytest.approx(0.1 * L / 20)  # at the tip k·L/R, not 0


def test_figure_4a_both_start_at_zero_and_only_the_taper_returns():
    r = np.linspace(1e-4, 0.9999, 400) * L
    cone, cylinder = compliance_jnd(CONE, r), compliance_jnd(CYLINDER, r)
    assert np.all(cone <= cylinder)
    assert cone[0] < 1e-4 * L
    assert cone[-1] < 1e-4 * L
    assert np.all(np.diff(cylinder) > 0)
    assert r[np.argmax(cone)] == pytest.approx(L / 2, rel=0.01)
    assert np.max(cone) == pytest.approx(0.1 * L / 4, rel=1e-4)


def test_webers_law_at_half_the_weber_fraction_halves_the_jnd():
    r = np.linspace(0.1, 0.9, 9) * L
    assert np.allclose(compliance_jnd(W, r, 0.05), compliance_jnd(W, r, 0.1) / 2)


THEORY_4B = {  # Δr/(kL) at R = 20, moment-dominated, by θ_d in degrees
    1: [1.066, 0.742, 0.440, 0.171],
    5: [1.053, 0.727, 0.422, 0.140],
    10: [1.011, 0.682, 0.367, 0.036],
    20: [0.854, 0.511, 0.161, np.nan],
}


@pytest.mark.parametrize(("degrees", "values"), THEORY_4B.items())
def test_figure_4b(degrees, values):
    """(3.7): ∂r/∂M at constant Fx, that is, axial force without noise of its own."""
    r = np.array([0.3, 0.5, 0.7, 0.9]) * L
    ours = map_jnd(W, r, np.radians(degrees), Weber([0.1, 1e-9])) / (0.1 * L)
    assert np.array_equal(np.isnan(ours), np.isnan(values))
    assert np.allclose(ours, values, atol=6e-4, equal_nan=True)


def test_figure_4b_falls_with_distance_and_with_deflection():
    """§3c: smaller towards the tip at any θ_d, and smaller as θ_d grows at any r."""
    r = np.linspace(0.1, 0.85, 40)[:, None] * L
    theta = np.radians(np.linspace(0.5, 12, 24))
    jnd = map_jnd(W, r, theta, Weber([0.1, 1e-9]))
    assert np.isfinite(jnd).all()
    assert np.all(np.diff(jnd, axis=0) < 0)
    assert np.all(np.diff(jnd, axis=1) < 0)


def test_the_map_cues_closed_form_in_all_its_limits():
    """Δr = ½(A−r)(3A−2r)/(2A−r)·√(4k_M² + k_F² − 4ρk_M k_F), as θ_d → 0."""
    r, a = np.linspace(0.1, 0.95, 18) * L, W.apex_distance
    shape = 0.5 * (a - r) * (3 * a - 2 * r) / (2 * a - r)
    for k_m, k_f, rho in ((0.1, 1e-9, 0), (1e-9, 0.1, 0), (0.1, 0.1, 0), (0.1, 0.2, 0.7)):
        closed = shape * np.sqrt(4 * k_m**2 + k_f**2 - 4 * rho * k_m * k_f)
        noise = Weber([k_m, k_f], correlation=rho)
        assert np.allclose(map_jnd(W, r, 1e-5, noise), closed, rtol=1e-6)
        contact = np.stack([r, np.full_like(r, 0.3)], axis=-1)
        observer = ww.Observer(W, ForceMap(), noise)
        assert np.allclose(weber_propagation(observer, contact, model="closed_form"), closed)


def test_moment_dominated_is_twice_axial_dominated():
    r = np.linspace(0.1, 0.9, 9) * L
    moment = map_jnd(W, r, 1e-4, Weber([0.1, 1e-9]))
    axial = map_jnd(W, r, 1e-4, Weber([1e-9, 0.1]))
    assert np.allclose(moment, 2 * axial, rtol=1e-5)


def test_a_pure_gain_common_to_both_signals_cancels():
    """k_F = 2k_M and ρ = 1: M²/Fx does not change with the gain."""
    r = np.linspace(0.1, 0.9, 9) * L
    jnd = map_jnd(W, r, 1e-5, Weber([0.1, 0.2], correlation=1.0))
    assert np.all(jnd < 1e-5 * L)


def test_the_axial_dominated_jnd_has_a_false_zero_where_the_posterior_has_none():
    """Where ∂M/∂θ_d = 0 at fixed r the linear JND vanishes; the posterior does not."""
    r = 0.7 * L
    peak = ww.flick_past(W, r).at_moment_peak.deflection_angle
    k = 0.05
    linear = map_jnd(W, r, peak, Weber([1e-9, k]))
    assert linear < 1e-3 * k * L
    # A little noise on the moment, so that the linear route is not zero outright.
    observer = ww.Observer(W, ForceMap(), Weber([0.002, k]))
    contact = np.array([r, float(peak)])
    p = ww.posterior(observer, observer.signals(contact)[0])
    assert p.sd > 1.5 * weber_propagation(observer, contact)


def test_small_angle_compliance_is_as_far_off_as_theory_says():
    """5 % at θ_d = 10° for a contact at s = 0.7 L, and 33 % at 0.9 L."""
    for s, percent in ((0.7, 5), (0.9, 33)):
        force = np.geomspace(1e-8, 1e-3, 20001)
        bent = ww.bend(W, s * L, force)
        theta = np.where(bent.outcome <= Outcome.PAST_FOLD, bent.deflection_angle, np.nan)
        i = int(np.nanargmin(np.abs(theta - np.radians(10))))
        small = closed_form.moment(W, bent.radial_distance[i], bent.deflection_angle[i])
        assert 100 * (small / bent.moment[i] - 1) == pytest.approx(percent, abs=0.5)


def test_posterior_over_closed_form_near_the_tip():
    """At r = 0.95 L the posterior leaves the closed form as k grows.

    Ratios 1.06, 1.38, 2.97, 4.84 at k = 0.1, 0.2, 0.3, 0.5 for a reading without noise.
    """
    r = np.array([0.95 * L])
    ratios = {}
    for k in (0.05, 0.1, 0.2, 0.3, 0.5):
        observer = ww.Observer(CONE, Compliance(), Weber(k))
        p = ww.posterior(observer, observer.signals(r)[0])
        ratios[k] = float(p.sd / compliance_jnd(CONE, r, k)[0])
    assert ratios[0.05] == pytest.approx(1, abs=0.015)
    assert [ratios[k] for k in (0.1, 0.2, 0.3, 0.5)] == pytest.approx(
        [1.06, 1.38, 2.97, 4.84], rel=0.01
    )
