"""Vibrations against tabulated values, finite elements and a transfer-matrix shot."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy import special
from scipy.integrate import solve_ivp
from scipy.linalg import eigh
from scipy.optimize import brentq

from weberwhisk.mechanics.modes import impulse_response, modes, transfer
from weberwhisk.mechanics.shape import Profile
from weberwhisk.whisker import Whisker

TAPER = Whisker(50e-3, 100e-6, 5e-6, 3e9)
HOLLOW = Profile.of(TAPER).hollow(60e-6, 20e-3)
TABLE = Profile.tabulated([0, 10e-3, 30e-3, 40e-3], [90e-6, 80e-6, 30e-6, 8e-6])
WHISKERS = {"taper": TAPER, "hollow": HOLLOW, "table": TABLE, "uniform": TAPER.cylinder()}


def test_uniform_frequencies_are_the_roots_of_the_textbook_equation():
    got = modes(TAPER.cylinder(), 5).normalised_frequency
    roots = [
        brentq(lambda x: np.cos(x) * np.cosh(x) + 1, a, a + 3, xtol=1e-14)
        for a in (1.0, 3.5, 7.0, 10.0, 13.0)
    ]
    np.testing.assert_allclose(got, np.square(roots), rtol=1e-10)
    np.testing.assert_allclose(got[:3], [3.5160, 22.034, 61.697], rtol=3e-5)


def test_perfect_cone_frequencies_are_the_zeros_of_its_bessel_equation():
    """Kirchhoff 1879: y = z⁻¹[a J₂(z) + b I₂(z)] with z = 2√(ωx) from the apex."""
    got = modes(Whisker(50e-3, 100e-6, 0.0, 3e9), 5).normalised_frequency

    def condition(omega):
        z = 2 * np.sqrt(omega)
        return special.jv(2, z) * special.iv(3, z) + special.iv(2, z) * special.jv(3, z)

    roots = [brentq(condition, 0.99 * x, 1.01 * x, xtol=1e-13) for x in got]
    np.testing.assert_allclose(got, roots, rtol=1e-9)
    assert len(set(np.round(roots, 3))) == 5
    np.testing.assert_allclose(got[:3], [8.7193, 21.146, 38.453], rtol=2.5e-5)


def test_truncated_cone_frequencies_are_the_zeros_of_their_bessel_determinant():
    """All four solutions z⁻² {J₂, Y₂, I₂, K₂}(z), z = 2√(ω′ξ), clamped at ξ = 1, free at 1/R.

    The theory notes print 7.8955 for the first at R = 20; this determinant, the shot below and
    finite elements all give 7.8941.
    """

    # d/dz (z⁻ⁿFₙ) = ∓z⁻ⁿFₙ₊₁, so value, slope, bending and shear are F₂, F₃, F₄, F₅ up to factors.
    functions, signs = (special.jv, special.yv, special.iv, special.kv), np.array([-1, -1, 1, -1])

    def determinant(omega, ratio=20):
        kappa = omega / (1 - 1 / ratio) ** 2  # per apex distance, not length
        rows = []
        for order, xi in ((2, 1.0), (3, 1.0), (4, 1 / ratio), (5, 1 / ratio)):
            z = 2 * np.sqrt(kappa * xi)
            rows.append(signs ** (order - 2) * np.array([f(order, z) for f in functions]))
        return np.linalg.det(np.array(rows))

    got = modes(TAPER, 3).normalised_frequency
    roots = [brentq(determinant, x * 0.999, x * 1.001, xtol=1e-13) for x in got]
    np.testing.assert_allclose(got, roots, rtol=1e-8)
    np.testing.assert_allclose(got, [7.8941, 19.448, 36.510], rtol=2e-5)


def shot(profile, guess):
    """Frequency near a guess for which a shot from the clamped base meets the free tip."""
    w = profile.whisker
    knots = np.unique(profile.arc) / w.length
    line = w.density * np.pi * w.base_radius**2 * w.length**4 / w.stiffness

    def miss(omega):
        ends = []
        for start in ([0, 0, 1.0, 0], [0, 0, 0, 1.0]):
            state = np.array(start)

            def slope(x, v):
                s = x * w.length
                ei = profile.stiffness(s) / w.stiffness
                m = profile.line_density(s) / (w.density * np.pi * w.base_radius**2)
                return [v[1], v[2] / ei, v[3], omega**2 * line * m * v[0]]

            for a, b in pairwise(knots):
                state = solve_ivp(slope, (a, b), state, "DOP853", rtol=1e-11, atol=1e-13).y[:, -1]
            ends.append(state)
        return ends[0][2] * ends[1][3] - ends[0][3] * ends[1][2]

    return brentq(miss, guess * 0.98, guess * 1.02, rtol=1e-11)


@pytest.mark.parametrize("name", ["taper", "hollow", "table"])
def test_frequencies_against_shooting(name):
    """The first five to 1e-6, by another equation form and SciPy's integrator."""
    whisker = WHISKERS[name]
    m = modes(whisker, 5)
    profile = whisker if isinstance(whisker, Profile) else Profile.of(whisker)
    exact = [shot(profile, w) for w in m.angular_frequency]
    np.testing.assert_allclose(m.angular_frequency, exact, rtol=1e-6)
    off = np.abs(m.angular_frequency / exact - 1)
    assert np.all(off <= m.error + 1e-9)


def test_finite_elements_agree():
    """Hermite beam elements, which converge with the fourth power of their length."""
    n, w = 400, TAPER
    h = w.length / n
    k, m = np.zeros((2 * n + 2,) * 2), np.zeros((2 * n + 2,) * 2)
    ke = (
        np.array(
            [
                [12, 6 * h, -12, 6 * h],
                [6 * h, 4 * h**2, -6 * h, 2 * h**2],
                [-12, -6 * h, 12, -6 * h],
                [6 * h, 2 * h**2, -6 * h, 4 * h**2],
            ]
        )
        / h**3
    )
    me = (
        np.array(
            [
                [156, 22 * h, 54, -13 * h],
                [22 * h, 4 * h**2, 13 * h, -3 * h**2],
                [54, 13 * h, 156, -22 * h],
                [-13 * h, -3 * h**2, -22 * h, 4 * h**2],
            ]
        )
        * h
        / 420
    )
    profile = Profile.of(w)
    for i in range(n):
        at = slice(2 * i, 2 * i + 4)
        k[at, at] += profile.stiffness((i + 0.5) * h) * ke
        m[at, at] += profile.line_density((i + 0.5) * h) * me
    omega = np.sqrt(eigh(k[2:, 2:], m[2:, 2:], eigvals_only=True, subset_by_index=(0, 2)))
    np.testing.assert_allclose(modes(w, 3).angular_frequency, omega, rtol=2e-4)


@pytest.mark.parametrize("name", WHISKERS)
def test_shapes_are_clamped_orthonormal_and_have_their_nodes(name):
    m = modes(WHISKERS[name], 5)
    length = m.profile.whisker.length
    s, h = np.linspace(0, length, 20001, retstep=True)
    shape = m.shape(s)
    gram = np.trapezoid(shape[:, None] * shape[None] * m.profile.line_density(s), dx=h)
    np.testing.assert_allclose(gram, np.eye(5), atol=1e-5)
    np.testing.assert_allclose(shape[:, 0], 0, atol=1e-10)
    assert np.all(shape[:, -1] > 0)
    inner = shape[:, 200:]
    np.testing.assert_array_equal(np.sum(np.diff(np.sign(inner)) != 0, axis=1), np.arange(5))


def test_base_signals_are_in_balance_with_the_inertia():
    """Moment at the base: EI₀ φ″(0) = ω² ∫ m φ s ds; shear: ω² ∫ m φ ds = −(EI φ″)′(0)."""
    m = modes(TAPER, 4)
    h = TAPER.length / 1000
    bending = m.profile.stiffness(np.array([0.0, h])) * m.derivative([0.0, h], 2)
    np.testing.assert_allclose(m.base_moment, bending[:, 0], rtol=3e-5)
    np.testing.assert_allclose(m.base_shear, -np.diff(bending)[:, 0] / h, rtol=1e-2)


def test_impulse_response_is_that_of_a_damped_oscillator_per_mode():
    """SciPy integrates the modal equations; the response adds them up at the base."""
    m = modes(TAPER, 3, damping_ratio=[0.1, 0.05, 0.2])
    t = np.linspace(0, 0.03, 40)
    r, push = np.array([15e-3, 40e-3]), 2e-9
    ring = impulse_response(m, r, t, push)
    assert ring.moment.shape == ring.transverse_force.shape == (2, 40)
    w, z = m.angular_frequency, m.damping_ratio
    for i, place in enumerate(r):
        start = np.concatenate([np.zeros(3), push * m.shape(place)])
        solved = solve_ivp(
            lambda _t, q: np.concatenate([q[3:], -2 * z * w * q[3:] - w**2 * q[:3]]),
            (0, t[-1]),
            start,
            "DOP853",
            t_eval=t,
            rtol=1e-10,
            atol=1e-14 * push,
        )
        expected = m.base_moment @ solved.y[:3]
        np.testing.assert_allclose(ring.moment[i], expected, atol=1e-7 * np.abs(expected).max())
    # Modes are excited in proportion to their shape at the place struck.
    np.testing.assert_allclose(ring.amplitude, push * m.shape(r).T)


def test_the_spectrum_is_the_transform_of_the_ringing():
    m = modes(TAPER, 2, damping_ratio=0.2)
    t, h = np.linspace(0, 0.6, 200001, retstep=True)
    f = np.array([0.0, 30.0, m.frequency[0], 250.0])
    ring = impulse_response(m, 20e-3, t).moment
    by_hand = np.trapezoid(ring * np.exp(-2j * np.pi * f[:, None] * t), dx=h)
    np.testing.assert_allclose(transfer(m, 20e-3, f), by_hand, rtol=1e-4)


def test_nothing_before_the_impulse_and_nothing_from_one_at_the_base():
    m = modes(TAPER, 3, damping_ratio=0.1)
    assert np.all(impulse_response(m, 20e-3, [-0.1, -1e-6]).moment == 0)
    struck = [impulse_response(m, s, [0.001, 0.01]).moment for s in (0.0, 20e-3)]
    assert np.all(np.abs(struck[0]) < 1e-12 * np.abs(struck[1]).max())


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: modes(TAPER, 0), "count must be 1 to 12, got 0"),
        (lambda: modes(TAPER, 3, damping_ratio=1.0), "damping_ratio must be below 1"),
        (lambda: modes(Whisker([0.05, 0.04], 1e-4, 5e-6)), "one whisker at a time"),
        (lambda: modes(TAPER).shape(0.06), "must be on the whisker of 0.05 m, got 0.06"),
    ],
)
def test_misuse_is_one_sentence(make, message):
    with pytest.raises(ValueError, match=message):
        make()
