"""Vibrations against Bessel functions, finite elements in time and a transfer-matrix shot."""

from __future__ import annotations

import mpmath as mp
import numpy as np
import pytest
from scipy import special
from scipy.linalg import expm, lu_factor, lu_solve
from scipy.optimize import brentq
from short_forms import slow_but

from weberwhisk.mechanics.modes import modes
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
    np.testing.assert_allclose(got, np.square(roots), rtol=1e-12)
    assert [round(v, 3) for v in got[:3]] == [3.516, 22.034, 61.697]  # the theory notes' digits


def all_roots(function, low, high):
    """Every sign change on a grid of 600, refined, so that none is missed between two."""
    grid = np.linspace(low, high, 600)
    signs = np.sign([function(x) for x in grid])
    return [
        brentq(function, grid[i], grid[i + 1], xtol=1e-14, rtol=1e-14)
        for i in np.flatnonzero(np.diff(signs))
    ]


def test_perfect_cone_frequencies_are_the_zeros_of_its_bessel_equation():
    """Kirchhoff 1879: y = z⁻¹[a J₂(z) + b I₂(z)] with z = 2√(ωx) from the apex."""
    got = modes(Whisker(50e-3, 100e-6, 0.0, 3e9), 5).normalised_frequency

    def condition(omega):
        z = 2 * np.sqrt(omega)
        return special.jv(2, z) * special.iv(3, z) + special.iv(2, z) * special.jv(3, z)

    roots = all_roots(condition, 1.0, 100.0)
    np.testing.assert_allclose(got, roots, rtol=1e-10)
    # The theory notes print 38.453 for the third: 38.45377 cut short.
    assert [round(v, d) for v, d in zip(got[:3], (4, 3, 3), strict=True)] == [
        8.7193,
        21.146,
        38.454,
    ]


@pytest.mark.parametrize("ratio", slow_but([1.5, 5.0, 20.0, 100.0], (2,)))
def test_truncated_cone_frequencies_are_the_zeros_of_their_bessel_determinant(ratio):
    """All four solutions z⁻² {J₂, Y₂, I₂, K₂}(z), z = 2√(ω′ξ), clamped at ξ = 1, free at 1/R.

    d/dz (z⁻ⁿFₙ) = ∓z⁻ⁿFₙ₊₁, so value, slope, bending and shear are F₂, F₃, F₄, F₅ up to factors.
    """
    signs = np.array([-1, -1, 1, -1])

    def determinant(omega, functions, sqrt=np.sqrt, det=np.linalg.det):
        kappa = omega / (1 - 1 / ratio) ** 2  # per apex distance, not length
        rows = []
        for order, xi in ((2, 1.0), (3, 1.0), (4, 1 / ratio), (5, 1 / ratio)):
            z = 2 * sqrt(kappa * xi)
            row = [f(order, z) for f in functions]
            size = max(abs(f) for f in row)
            rows.append([s ** (order - 2) * f / size for s, f in zip(signs, row, strict=True)])
        return det(rows)

    got = modes(Whisker(50e-3, 100e-6, 100e-6 / ratio, 3e9), 5).normalised_frequency
    fast = (special.jv, special.yv, special.iv, special.kv)
    found = all_roots(lambda omega: determinant(omega, fast), 1.0, got[4] + 5)
    assert len(found) == 5
    with mp.workdps(20):
        exact = (mp.besselj, mp.bessely, mp.besseli, mp.besselk)

        def precisely(omega):
            return determinant(omega, exact, mp.sqrt, lambda rows: mp.det(mp.matrix(rows)))

        roots = [float(mp.findroot(precisely, (x, x * (1 + 1e-9)))) for x in found]
    np.testing.assert_allclose(got, roots, rtol=1e-8)
    if ratio == 20:
        # The theory notes print 7.8955 for the first.
        digits = zip(roots[:3], (4, 3, 3), strict=True)
        assert [round(v, d) for v, d in digits] == [7.8941, 19.448, 36.510]


def finite_elements(profile, n):
    """Stiffness and mass of n Hermite beam elements, clamped rows included, and their nodes."""
    h = profile.whisker.length / n
    x, weight = np.polynomial.legendre.leggauss(6)
    x, weight = (x + 1) / 2, weight / 2 * h
    moved = [1 - 3 * x**2 + 2 * x**3, h * (x - 2 * x**2 + x**3), 3 * x**2 - 2 * x**3]
    moved = np.array([*moved, h * (x**3 - x**2)])
    bent = np.array([-6 + 12 * x, h * (-4 + 6 * x), 6 - 12 * x, h * (6 * x - 2)]) / h**2
    k, m = np.zeros((2, 2 * n + 2, 2 * n + 2))
    for i in range(n):
        at, s = slice(2 * i, 2 * i + 4), (i + x) * h
        k[at, at] += (bent * profile.stiffness(s) * weight) @ bent.T
        m[at, at] += (moved * profile.line_density(s) * weight) @ moved.T
    return k, m, np.arange(n + 1) * h


def ringing(m, zeta, place, time, impulse):
    """Moment and transverse force at the base after an impulse: the sum over damped modes."""
    zeta, omega = zeta[:, None], m.angular_frequency[:, None]
    damped = omega * np.sqrt(1 - zeta**2)
    waves = np.exp(-zeta * omega * time) * np.sin(damped * time) / damped
    struck = impulse * m.shape(place)
    return (struck * m.base_moment) @ waves, (struck * m.base_shear) @ waves


def test_shapes_and_base_signals_make_the_ringing_of_finite_elements_in_time():
    """No modes here: nodes struck at rest, and their equations of motion stepped in time.

    Damping in proportion to the stiffness is a damping ratio in proportion to ω. What the modes
    leave out dies within the first 15 β.
    """
    count = 8
    m = modes(TAPER, count)
    beta = 1.9 / m.angular_frequency[-1]
    k, mass, nodes = finite_elements(m.profile, 100)
    inner, n = slice(2, None), len(k) - 2
    settled = lu_solve(lu_factor(mass[inner, inner]), np.hstack([k[inner, inner], np.eye(n)]))
    rates = np.block([[np.zeros((n, n)), np.eye(n)], [-settled[:, :n], -beta * settled[:, :n]]])
    step = 2 * np.pi / m.angular_frequency[0] / 40
    times = np.arange(1, 61) * step
    late = times > 15 * beta
    turn = expm(rates * step)
    for node, push in ((30, 1e-9), (75, -2e-9)):
        state = np.concatenate([np.zeros(n), push * settled[:, n + 2 * node - 2]])
        moment, shear = [], []
        for _ in times:
            state = turn @ state
            shear.append(-k[0, inner] @ state[:n])
            moment.append(-k[1, inner] @ state[:n])
        ring = ringing(m, beta * m.angular_frequency / 2, nodes[node], times, push)
        for by_modes, by_nodes in zip(ring, (moment, shear), strict=True):
            scale = np.abs(by_nodes)[late].max()
            np.testing.assert_allclose(by_modes[late], np.array(by_nodes)[late], atol=1e-5 * scale)


@pytest.mark.parametrize("name", WHISKERS)
def test_shapes_are_clamped_orthonormal_and_have_their_nodes(name):
    m = modes(WHISKERS[name], 5)
    knots = np.unique(np.concatenate([m.profile.arc, np.linspace(0, TAPER.length, 9)]))
    knots = knots[knots <= m.profile.whisker.length]
    x, weight = np.polynomial.legendre.leggauss(30)
    half = np.diff(knots)[:, None] / 2
    at = (knots[:-1, None] + half * (x + 1)).ravel()
    load = (half * weight).ravel() * m.profile.line_density(at)
    np.testing.assert_allclose((m.shape(at) * load) @ m.shape(at).T, np.eye(5), atol=1e-11)
    shape = m.shape(np.linspace(0, m.profile.whisker.length, 4001))
    np.testing.assert_allclose(shape[:, 0], 0, atol=1e-10)
    assert np.all(shape[:, -1] > 0)
    inner = shape[:, 40:]
    np.testing.assert_array_equal(np.sum(np.diff(np.sign(inner)) != 0, axis=1), np.arange(5))


def test_base_signals_are_in_balance_with_the_inertia():
    """Moment at the base: EI₀ φ″(0) = ω² ∫ m φ s ds; shear: ω² ∫ m φ ds = −(EI φ″)′(0)."""
    m = modes(TAPER, 4)
    s = np.linspace(0, TAPER.length / 20, 9)
    bending = m.profile.stiffness(s) * m.derivative(s, 2)
    np.testing.assert_allclose(m.base_moment, bending[:, 0], rtol=1e-7)
    slope = [np.polynomial.Polynomial.fit(s, row, 8).deriv()(0.0) for row in bending]
    np.testing.assert_allclose(m.base_shear, -np.array(slope), rtol=1e-5)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: modes(TAPER, 0), "count must be 1 to 12, got 0"),
        (lambda: modes(TAPER, 1.5), "count must be a whole number"),
        (lambda: modes(Whisker([0.05, 0.04], 1e-4, 5e-6)), "one whisker at a time"),
        (lambda: modes(TAPER).shape(0.06), "must be on the whisker of 0.05 m, got 0.06"),
    ],
)
def test_misuse_is_one_sentence(make, message):
    with pytest.raises(ValueError, match=message):
        make()
