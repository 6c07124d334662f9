"""Each equation and claim of §2e, §2f and §3 of Solomon & Hartmann (2011), as a test."""

import numpy as np
import pytest
from integrators import follow
from scipy.interpolate import CloughTocher2DInterpolator
from scipy.optimize import brentq, minimize_scalar
from short_forms import slow_but

import weberwhisk as ww
from weberwhisk import Outcome
from weberwhisk.cues import Compliance, ForceMap
from weberwhisk.mechanics import closed_form, signal_jacobian
from weberwhisk.receptors import Weber
from weberwhisk.sensitivity import weber_propagation

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


# -- where the paper's sentences end: over its whole domain, contact angles to 90°, all distances --


def beam_at(r, force):
    """Moment, axial force, θ_d and α of W under a force at a distance, by SciPy's DOP853."""

    def bent(s):
        return follow(L, 100e-6, 5e-6, float(W.youngs_modulus), s, force)

    s = brentq(lambda s: bent(s)[3] - r, r, min(L, 3 * r), xtol=1e-15)
    moment, axial, _, _, theta, alpha = bent(s)
    return moment, axial, theta, alpha


FALSE_ZEROS = [  # r/L, θ_d and α in degrees where the moment peaks at that distance
    (0.3, 46.6, 84),
    (0.5, 33.3, 71),
    (0.7, 20.8, 59),
    (0.9, 8.8, 47),
]


@pytest.mark.parametrize(("share", "degrees", "alpha"), slow_but(FALSE_ZEROS, (0,)))
@pytest.mark.slow
def test_results_are_similar_in_both_cases_only_up_to_a_false_zero(share, degrees, alpha):
    """§3c, noise in Fx alone: the linear JND is zero where ∂M/∂θ_d = 0, and rises beyond.

    That angle is found here on a beam of SciPy's: the largest moment at that distance.
    """
    r = share * L
    peak = ww.flick_past(W, r).at_moment_peak
    found = minimize_scalar(
        lambda f: -beam_at(r, f * peak.force)[0],
        bounds=(0.5, 1.3),
        method="bounded",
        options={"xatol": 1e-9},
    )
    _, _, theta, angle = beam_at(r, found.x * peak.force)
    assert np.degrees(theta) == pytest.approx(degrees, abs=0.05)
    assert np.degrees(angle) == pytest.approx(alpha, abs=0.5)
    assert np.degrees(angle) < 90  # inside the paper's domain
    moment_alone, axial_alone = Weber([0.1, 1e-9]), Weber([1e-9, 0.1])
    below, above = np.linspace(0.02, 1, 60)[:-1] * theta, theta * np.linspace(1.002, 1.06, 20)
    axial = map_jnd(W, r, below, axial_alone)
    assert np.all(np.diff(axial) < 0)
    assert np.all(np.diff(map_jnd(W, r, above, axial_alone)) > 0)
    assert map_jnd(W, r, theta, axial_alone) < 1e-4 * axial[0]
    # The other case is far from zero there: the two are anything but similar.
    assert map_jnd(W, r, theta, moment_alone) > 0.02 * map_jnd(W, r, below[0], moment_alone)


def _up_to_90_degrees(share, n=60):
    """Deflection angles at a distance, to a contact angle of 90° or the end."""
    theta = np.linspace(0.005, 0.999, n) * ww.flick_past(W, share * L).deflection_angle
    return theta[ww.press(W, share * L, theta).contact_angle < np.pi / 2]


@pytest.mark.parametrize("share", [0.1, 0.3, 0.5, 0.7, 0.9])
def test_the_slope_falls_with_deflection_while_the_moment_grows_more_slowly(share):
    """§3c has the reason upside down: |∂r/∂M| falls, M grows, their product falls."""
    theta = _up_to_90_degrees(share)
    theta = theta[theta < ww.flick_past(W, share * L).at_moment_peak.deflection_angle]
    slopes = np.linalg.inv(ww.mechanics.signal_jacobian(W, share * L, theta)[..., :2, :])[:, 0, 0]
    moment = ww.press(W, share * L, theta).moment
    assert np.all(np.diff(np.abs(slopes)) < 0)
    assert np.all(np.diff(moment) > 0)
    assert np.all(np.diff(np.abs(slopes) * moment) < 0)


def rolled(share, radius, alpha):
    """Contacts of W with a cylinder met at share·L, at growing contact angles, without `sweep`.

    The cylinder's centre keeps its distance from the base; it lies off the contact by the radius,
    along the normal there.
    """
    centre = np.hypot(share * L, radius)

    def miss(r, angle):
        top = 0.999999 * ww.flick_past(W, r).deflection_angle
        theta = brentq(lambda t: ww.press(W, r, t).contact_angle - angle, 1e-6, top)
        x = r * np.cos(theta) + radius * np.sin(angle)
        y = r * np.sin(theta) - radius * np.cos(angle)
        return np.hypot(x, y) - centre, theta

    found = []
    for angle in alpha:
        r = brentq(lambda r, angle=angle: miss(r, angle)[0], 0.4 * share * L, 1.02 * share * L)
        found.append((r, miss(r, angle)[1]))
    return np.array(found)


def test_resolution_along_a_whisk_depends_on_slip():
    """§3c: on a thin cylinder it improves all along, on a thick one it worsens first."""
    alpha = np.radians([4.0, 12.0, 20.0, 35.0, 50.0, 65.0, 80.0, 88.0])
    jnds = []
    for radius in (6e-3, 20e-3):
        r, theta = rolled(0.6, radius, alpha).T
        assert np.all(np.diff(r) < 0)  # the contact slides towards the base
        jnds.append(map_jnd(W, r, theta, Weber([0.1, 1e-9])) / (0.1 * L))
    thin, thick = jnds
    assert np.all(np.diff(thin) < 0)
    assert thick[:2] == pytest.approx([0.613, 0.631], abs=0.005)
    assert np.all(np.diff(thick[2:]) < 0)
    assert thick[-1] == pytest.approx(0.08, abs=0.01)


def test_the_compliance_of_a_taper_is_larger_its_inverse_smaller():
    """§3b; and (3.5) is zero at the tip of a perfect cone alone."""
    r = np.linspace(0.01, 0.999, 200) * L
    for theta in (1e-4, 0.05):
        taper, cylinder = (ww.press(w, r, theta) for w in (W, CYLINDER))
        held = taper.held & cylinder.held
        assert held.sum() > 100
        assert np.all(theta / taper.moment[held] > theta / cylinder.moment[held])
    assert compliance_jnd(CONE, L * (1 - 1e-9)) < 1e-8 * L
    assert compliance_jnd(W, L * (1 - 1e-9)) == pytest.approx(0.1 * L / 20, rel=1e-6)


def test_taper_takes_the_moment_towards_nothing_and_the_axial_force_to_a_third():
    """By the closed forms with u = r/A, which is 0 of a cylinder: M as 1 − u, Fx as 1 − 2u/3."""
    r = np.linspace(0.05, 0.98, 20) * CONE.length
    taper, cylinder = (ww.press(w, r, 1e-5) for w in (CONE, CONE.cylinder()))
    u = r / CONE.length
    np.testing.assert_allclose(taper.moment / cylinder.moment, 1 - u, rtol=1e-3)
    np.testing.assert_allclose(taper.axial_force / cylinder.axial_force, 1 - 2 * u / 3, rtol=1e-3)


def test_a_scattered_map_must_be_interpolated_on_logarithmic_axes():
    """§2f: ∂r/∂M by a cubic through scattered (M, Fx), beside the simulator's."""
    share = np.linspace(0.1, 0.97, 40)[:, None]
    theta = np.linspace(0.01, 0.999, 40) * ww.flick_past(W, share * L).deflection_angle
    known = ww.press(W, share * L, theta)
    inside = known.held & (known.contact_angle < np.pi / 2)
    points = np.stack([known.moment, known.axial_force], axis=-1)[inside]
    r = np.broadcast_to(share * L, inside.shape)[inside]
    plain = CloughTocher2DInterpolator(points, r, rescale=True)
    logs = CloughTocher2DInterpolator(np.log(points), r)
    places, step = [(0.3, 0.4), (0.5, 0.1), (0.7, 0.1)], 1e-4
    off = []
    for place, angle in places:
        bent = ww.press(W, place * L, angle)
        moment, force = float(bent.moment), float(bent.axial_force)
        true = np.linalg.inv(signal_jacobian(W, place * L, angle)[:2])[0, 0]
        ends = np.array([[moment * (1 - step), force], [moment * (1 + step), force]])
        slopes = np.diff(plain(ends))[0], np.diff(logs(np.log(ends)))[0]
        off.append(np.abs(np.array(slopes) / (2 * step * moment * true) - 1))
    plain_off, logs_off = np.transpose(off)
    assert logs_off.max() < 0.017
    assert plain_off.max() > 5
    assert np.all(plain_off[1:] > 0.5)  # at small angles
