"""Model 1 against exact results, stored references and integrators that share no code with it."""

import csv
from pathlib import Path

import numpy as np
import pytest
from analysis_scripts import load
from integrators import follow
from mpmath import mp
from short_forms import slow_but

import weberwhisk as ww
from weberwhisk import Outcome
from weberwhisk.mechanics.elastica import Surface, load_cap, the_map

W = ww.Whisker(50e-3, 100e-6, 5e-6, 3e9)
SIGNALS = ("moment", "axial_force", "transverse_force")
PLACE = ("radial_distance", "deflection_angle", "contact_angle")


def relative(bent, reference):
    """Relative errors; those of a force component are relative to the force."""
    scale = {}
    if "transverse_force" in reference:
        scale["transverse_force"] = np.hypot(*(reference[k] for k in SIGNALS[1:]))
    return {
        key: np.max(np.abs(getattr(bent, key) - value) / np.abs(scale.get(key, value)))
        for key, value in reference.items()
    }


def straight_references():
    path = Path(__file__).parents[1] / "data" / "elastica_points.csv"
    with path.open() as file:
        rows = [{k: float(v) for k, v in row.items()} for row in csv.DictReader(file)]
    rows = [r for r in rows if r["curvature"] == 0 and r["friction_angle"] == 0]
    return {key: np.array([r[key] for r in rows]) for key in rows[0]}


def test_bend_and_press_meet_the_stored_references():
    ref = straight_references()
    assert len(ref["length"]) == 36
    w = ww.Whisker(*(ref[k] for k in ("length", "base_radius", "tip_radius", "youngs_modulus")))
    bent = ww.bend(w, ref["arc_length"], ref["force"])
    wanted = {k: ref[k] for k in (*SIGNALS, *PLACE)}
    assert max(relative(bent, wanted).values()) < 1e-11
    pressed = ww.press(w, ref["radial_distance"], ref["deflection_angle"])
    wanted = {k: ref[k] for k in (*SIGNALS, "contact_angle", "arc_length", "force")}
    assert max(relative(pressed, wanted).values()) < 1e-11
    assert bent.held.all()
    assert pressed.held.all()


@pytest.mark.parametrize("ratio", slow_but([1, 1.001, 1.5, 3, 20, 1000, np.inf], (0, 4, 6)))
def test_bend_meets_an_independent_integrator_up_to_the_fold(ratio):
    w = ww.Whisker(50e-3, 100e-6, 100e-6 / ratio, 3e9)
    for fraction in (0.01, 0.2, 0.5, 0.8, 0.95, 0.99, 0.999):
        u = np.array([fraction * w.taper])
        fold = (the_map().fold_load(u)[0] * load_cap(u))[0]
        for share in (1e-6, 0.01, 0.3, 0.7, 0.95, 1 - 1e-9):
            force = share * fold * 6 * w.stiffness * (1 - u[0]) ** 2
            force /= (fraction * w.length) ** 2 * (3 - 2 * u[0])
            bent = ww.bend(w, fraction * w.length, force)
            values = follow(50e-3, 100e-6, 100e-6 / ratio, 3e9, fraction * 50e-3, force)
            wanted = dict(zip((*SIGNALS, *PLACE), values, strict=True))
            assert bent.outcome == Outcome.HELD
            assert max(relative(bent, wanted).values()) < 1e-10, (ratio, fraction, share)


def exact_uniform(alpha):
    """F a²/EI, M a/EI, x/a, y/a of a uniform beam at contact angle α, by 30-digit quadrature."""
    with mp.workdps(30):
        a = mp.mpf(alpha)
        j = mp.quad(lambda t: 2 / mp.sqrt(mp.sinc(t * t)), [0, mp.sqrt(a)])
        s = mp.quad(lambda t: 2 * t * t * mp.sqrt(mp.sinc(t * t)), [0, mp.sqrt(a)])
        root = mp.sqrt(mp.sin(a))
        return [
            float(v)
            for v in (
                j**2 / 2,
                j * root,
                (2 * mp.cos(a) * root + s * mp.sin(a)) / j,
                (2 * mp.sin(a) * root - s * mp.cos(a)) / j,
            )
        ]


@pytest.mark.parametrize("alpha", [1e-3, 0.1, 0.5, 1.0, np.pi / 2, 2.0, 2.9])
def test_the_cylinder_is_exact(alpha):
    force, moment, x, y = exact_uniform(alpha)
    c = W.cylinder()
    a = 0.3 * c.length
    bent = ww.bend(c, a, force * c.stiffness / a**2)
    wanted = {
        "contact_angle": alpha,
        "moment": moment * c.stiffness / a,
        "radial_distance": a * np.hypot(x, y),
        "deflection_angle": np.arctan2(y, x),
    }
    assert max(relative(bent, wanted).values()) < 2e-12


def test_p70():
    b = ww.bend(W, 35e-3, 8.755567343e-5)
    assert np.degrees(b.contact_angle) == pytest.approx(60, abs=1e-7)
    assert b.moment == pytest.approx(2.311081582e-6, rel=1e-9)
    assert b.axial_force == pytest.approx(7.582544e-5, rel=1e-7)
    assert b.transverse_force == pytest.approx(4.377784e-5, rel=2e-7)
    x, y = (b.radial_distance * f(b.deflection_angle) for f in (np.cos, np.sin))
    assert (x * 1e3, y * 1e3) == pytest.approx((30.600803, 12.811592), abs=1e-6)
    assert np.degrees(b.deflection_angle) == pytest.approx(22.7175, abs=5e-5)


def test_the_fold_is_where_theory_has_it():
    end = ww.flick_past(W, np.array([0.3, 0.5, 0.7, 0.9]) * W.length)
    assert np.degrees(end.deflection_angle) == pytest.approx([59.12, 40.53, 24.57, 10.22], abs=5e-3)
    assert np.all(end.ended_by == Outcome.FLICKED_PAST)
    assert np.degrees(end.at_moment_peak.deflection_angle[2]) == pytest.approx(20.8, abs=0.05)
    c = W.cylinder()
    end = ww.flick_past(c, 0.3 * c.length)
    assert np.degrees(end.deflection_angle) == pytest.approx(99.568, abs=1e-3)
    assert end.at_end.arc_length == pytest.approx(1.79 * 0.3 * c.length, rel=2e-3)


@pytest.mark.parametrize("ratio", [1, 1.5, 20, 1000])
def test_at_flick_past_the_fold_or_the_tip_is_reached(ratio):
    w = ww.Whisker(50e-3, 100e-6, 100e-6 / ratio, 3e9)
    r = np.linspace(0.01, 0.9999, 400) * w.length
    end = ww.flick_past(w, r)
    tip = end.ended_by == Outcome.SLIPPED_OFF_TIP
    assert tip.any()
    assert np.allclose(end.at_end.arc_length[tip], w.length, rtol=1e-11)
    assert np.all(end.at_end.arc_length[~tip] < w.length)
    assert end.at_end.held.all()
    # A hair further on, the contact is lost, and for the reason given.
    beyond = ww.press(w, r, end.deflection_angle * (1 + 1e-6))
    assert np.array_equal(beyond.outcome, end.ended_by)
    # The moment is largest at its peak.
    theta = np.linspace(0.01, 1, 200)[:, None] * end.deflection_angle
    path = ww.press(w, r, theta).moment
    assert np.all(np.nanmax(path, axis=0) <= end.at_moment_peak.moment * (1 + 1e-9))
    assert np.allclose(np.nanmax(path, axis=0), end.at_moment_peak.moment, rtol=1e-3)
    assert np.allclose(Surface(w).limit(r), end.deflection_angle, rtol=1e-9)


def test_derivatives_meet_finite_differences_of_eighth_order():
    rng = np.random.default_rng(2)
    r = rng.uniform(0.02, 0.97, 1500) * W.length
    end = ww.flick_past(W, r).deflection_angle
    theta = end * rng.uniform(0.02, 0.95, 1500)
    theta *= rng.choice([-1, 1], 1500)
    jacobian = ww.mechanics.signal_jacobian(W, r, theta)

    def signals(r, theta):
        b = ww.press(W, r, theta)
        return np.stack([b.moment, b.axial_force, b.transverse_force], axis=-1)

    weights = {1: 4 / 5, 2: -1 / 5, 3: 4 / 105, 4: -1 / 280}
    room = 1 - np.abs(theta) / end
    for column, h in ((0, 4e-3 * room * r), (1, 4e-3 * np.minimum(1, room) * np.abs(theta))):
        dr, dt = (h, 0) if column == 0 else (0, h)
        slope = sum(
            c * (signals(r + k * dr, theta + k * dt) - signals(r - k * dr, theta - k * dt))
            for k, c in weights.items()
        )
        slope = slope / h[:, None]
        # Slopes pass through zero: errors are relative to the signals' own size over r or θ.
        size = np.abs(signals(r, theta)) / (r if column == 0 else np.abs(theta))[:, None]
        size[:, 2] = size[:, 1:].max(axis=1)
        error = np.abs(jacobian[:, :, column] - slope) / np.maximum(np.abs(slope), size)
        assert error.max() < 1e-8


def test_the_shipped_map_is_the_one_the_script_builds():
    built = load("build_elastica_map").build()
    m = the_map()
    shipped = {
        "force_given": m.force_given,
        "contact_given": m.contact_given,
        "fold_load": m.fold_load,
        "fold": m.fold,
    }
    for name, table in shipped.items():
        assert np.allclose(built[name], table.coefficients, rtol=0, atol=2e-11), name


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: ww.bend(W, -1e-3, 1e-5), "arc_length must be above zero, got -0.001"),
        (lambda: ww.bend(W, 1e-2, np.nan), "force must be finite, got nan"),
        (lambda: ww.press(W, 0.0, 0.1), "radial_distance must be above zero, got 0"),
        (lambda: ww.press(W, "far", 0.1), "radial_distance must be a number, got 'far'"),
        (lambda: ww.press(W, 1e-2, np.inf), "deflection_angle must be finite, got inf"),
        (lambda: ww.press(W, 1e-2, 0.1, model="elastic"), "did you mean 'elastica'"),
        (lambda: ww.flick_past(W, [1e-2, -1e-2]), "radial_distance must be above zero"),
    ],
)
def test_misuse_is_refused_in_one_sentence(call, words):
    with pytest.raises(ValueError, match=words) as error:
        call()
    assert "\n" not in str(error.value)
