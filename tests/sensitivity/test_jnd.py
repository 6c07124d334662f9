"""One definition of the JND and its three routes."""

import numpy as np
import pytest

import weberwhisk as ww
from weberwhisk import plots
from weberwhisk.cues import (
    Compliance,
    ForceMap,
    Friction,
    SpaceMap,
)
from weberwhisk.receptors import GeneralisedWeber, Weber
from weberwhisk.sensitivity import fisher_jnd, is_linear, weber_propagation

W = ww.Whisker(50e-3, 100e-6, 5e-6)
L, A = W.length, W.apex_distance


@pytest.mark.parametrize(
    ("criterion", "value"),
    [
        ("d'=1", 0.1),
        ("76.02% 2AFC", 0.1),
        ("75% 2AFC", 0.0954),
        ("84.13% 2IFC", 0.1414),
        ("79.37% 2AFC", 0.1159),
        ("70.71% 2AFC", 0.0771),
        ("75% yes/no", 0.0674),
    ],
)
def test_criteria_have_the_conventional_factors(criterion, value):
    assert 0.1 * ww.sensitivity.criterion_factor(criterion) == pytest.approx(value, abs=6e-5)


def test_conversion_goes_there_and_back():
    there = ww.sensitivity.convert_jnd(0.2, from_criterion="75% 2AFC", to_criterion="75% yes/no")
    back = ww.sensitivity.convert_jnd(there, from_criterion="75% yes/no", to_criterion="75% 2AFC")
    assert there == pytest.approx(0.2 / np.sqrt(2))
    assert back == pytest.approx(0.2)


@pytest.mark.parametrize("criterion", ["75%", "100% 2AFC", "50% 2AFC", "loud", None, "75% 3AFC"])
def test_unknown_criteria_are_refused(criterion):
    with pytest.raises(ValueError, match="criterion"):
        ww.sensitivity.criterion_factor(criterion)


def test_fisher_beats_propagation_by_what_the_spread_tells():
    r = np.linspace(0.05, 0.95, 20)[:, None] * L
    for k in (0.05, 0.2, 0.5):
        observer = ww.Observer(W, Compliance(), Weber(k))
        ratio = weber_propagation(observer, r) / fisher_jnd(observer, r)
        assert np.allclose(ratio, np.sqrt(1 + 2 * k**2))


def test_a_floor_lifts_the_jnd_off_zero_at_the_tip():
    """With dI = k(I + I₀) on the moment the tapered JND is k(1 + I₀/M) r(1 − r/A)."""
    cone = ww.Whisker(50e-3, 100e-6, 0.0)
    unit = float(cone.compliance_constant / L)
    r = np.array([[0.5], [0.99], [0.9999]]) * L
    plain = weber_propagation(ww.Observer(cone, Compliance(), Weber(0.1)), r)
    floored = weber_propagation(
        ww.Observer(cone, Compliance(), GeneralisedWeber(0.1, floor=0.01 * unit)), r
    )
    moment = ww.Observer(cone, Compliance()).signals(r)[0][:, 0]
    expected = np.hypot(1, 0.01 * unit / (0.1 * moment)) * plain
    assert np.allclose(floored, expected)
    assert floored[-1] == pytest.approx(0.01 * L, rel=0.01)  # I₀ r²/C, not 0


def test_jnd_curve_holds_the_routes_side_by_side():
    observer = ww.Observer(W, Compliance(), Weber(0.05))
    r = np.array([0.2, 0.5, 0.8]) * L
    curve = ww.jnd_curve(observer, r, n_readings=400, seed=1)
    closed = 0.05 * r * (1 - r / A)
    assert np.allclose(curve["closed_form"], closed)
    assert np.allclose(curve["propagation"], closed)
    # Beyond the Monte Carlo error there is the next order in k.
    difference = np.abs(curve["posterior"] - curve["fisher"])
    assert np.all(difference < 4 * curve["posterior_error"] + 3 * 0.05**2 * closed)
    assert np.all(np.abs(curve["estimator"] - closed) < 4 * curve["estimator_error"])
    assert np.all(curve["unreliable"] == 0)
    assert set(curve["criterion"]) == {"d'=1"}


def test_the_criterion_scales_every_route():
    observer = ww.Observer(W, Compliance())
    one, two = (
        ww.jnd_curve(observer, 20e-3, n_readings=20, seed=1, criterion=c)
        for c in ("d'=1", "75% 2AFC")
    )
    routes = ["closed_form", "propagation", "fisher", "posterior", "estimator", "posterior_error"]
    ratio = (two[routes] / one[routes]).to_numpy()
    assert np.allclose(ratio, ww.sensitivity.criterion_factor("75% 2AFC"))


def test_contacts_that_are_not_held_stay_in_the_table():
    observer = ww.Observer(W, ForceMap(), Weber(0.1))
    curve = ww.jnd_curve(observer, np.array([0.5, 0.9]) * L, np.radians(20), n_readings=5, seed=1)
    assert np.isfinite(curve["posterior"][0])
    assert curve[["propagation", "fisher", "posterior"]].loc[1].isna().all()
    assert curve["outcome"][1].startswith("flicked past")


def test_the_cylinders_force_map_has_an_infinite_jnd_and_says_so():
    observer = ww.Observer(W.cylinder(), ForceMap(), Weber(0.1))
    curve = ww.jnd_curve(observer, 25e-3, np.radians(10), n_readings=4, seed=1)
    routes = ["closed_form", "propagation", "fisher"]
    assert np.isinf(curve[routes].loc[0].astype(float)).all()
    assert curve["unreliable"][0] == 1


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"radial_distance": -1e-3}, "radial_distance must be above zero"),
        (
            {"radial_distance": 1e-2, "n_readings": 1},
            "n_readings must be .* of 2 or more, got 1",
        ),
        ({"radial_distance": 1e-2, "n_readings": np.nan}, "n_readings must be .*got nan"),
        ({"radial_distance": 1e-2, "n_readings": np.inf}, "n_readings must be .*got inf"),
        ({"radial_distance": 1e-2, "n_readings": "many"}, "n_readings must be .*got 'many'"),
        ({"radial_distance": 1e-2, "method": "nuts"}, "method 'nuts' is unknown"),
        ({"radial_distance": 1e-2, "deflection_angle": 0.1}, "no unknown deflection angle"),
    ],
)
def test_misuse_is_refused(arguments, words):
    with pytest.raises(ValueError, match=words):
        ww.jnd_curve(ww.Observer(W, Compliance()), **arguments)


@pytest.mark.parametrize("angle", [0.0, -0.2])
def test_a_deflection_that_is_not_positive_is_refused(angle):
    """A negative one gave a JND of 1e-8 mm by posteriors, 5 mm by the closed form."""
    with pytest.raises(ValueError, match="deflects the whisker by more than 0"):
        ww.jnd_curve(ww.Observer(W, ForceMap()), [20e-3], angle, n_readings=4)


@pytest.mark.parametrize("cue", [ForceMap(), Friction(ForceMap(), 0.2)])
def test_whiskers_beyond_the_closed_form_have_that_of_the_straight_taper(cue):
    """All but the tap and the balance of moments were refused, by a model nobody asked for."""
    w = ww.Whisker.from_identity("C2", curved=not isinstance(cue, Friction))
    curve = ww.jnd_curve(ww.Observer(w, cue), [8e-3, 10e-3], 0.15, n_readings=4, seed=1)
    plain = ww.Observer(ww.Whisker.from_identity("C2"), ForceMap())
    closed = weber_propagation(plain, [[8e-3, 0.15], [10e-3, 0.15]], model="closed_form")
    assert np.allclose(curve["closed_form"], closed)
    assert curve[["propagation", "fisher", "posterior"]].notna().all(axis=None)
    drawn = plots.jnd_lines(curve).get_lines()
    assert "8.594°: exact slope" in {line.get_label() for line in drawn}


def test_readings_that_are_all_the_same_event_have_no_scatter():
    table = ww.jnd_curve(ww.Observer(W, ww.cues.VibrissaLength()), 5e-3, n_readings=8, seed=1)
    assert np.isnan(table["estimator"][0])
    assert np.isfinite(table["posterior"][0])


def test_the_tolerance_of_posteriors_is_below_the_error_of_their_draws():
    """What `jnd_curve` reports, beside posteriors worked out a hundred times as closely."""
    observer = ww.Observer(W, ww.cues.ForceMap())
    draws, contact = 100, np.array([[8e-3, 0.1], [25e-3, 0.1], [40e-3, 0.1]])
    readings = observer.read(np.repeat(contact, draws, axis=0), seed=1)
    quick, close = (ww.posterior(observer, readings, tolerance=t) for t in (None, 1e-4))
    for name in ("mean", "sd"):
        a, b = (np.reshape(getattr(p, name), (-1, draws)) for p in (quick, close))
        error = b.std(axis=1, ddof=1) / np.sqrt(draws)
        assert np.all(np.abs((a - b).mean(axis=1)) < 0.05 * error)


# -- where linear JNDs are not to be believed ----------------------------------------------------


def test_false_zeros_of_moment_noise_are_told():
    """Where ∂Fx/∂θ_d changes its sign at fixed r, past a contact angle of 90°."""
    observer = ww.Observer(W, ForceMap(), Weber([0.1, 1e-3]))
    theta = np.radians(np.linspace(30.0, 58.0, 2801))
    contact = np.stack([np.full_like(theta, 0.3 * L), theta], axis=-1)
    slope = observer.cue.jacobian(W, contact)[:, 1, 1]
    peak = int(np.flatnonzero(np.diff(np.sign(slope)))[0])
    bent = ww.press(W, 0.3 * L, theta[peak])
    assert 100 < np.degrees(bent.contact_angle) < 106
    assert is_linear(observer, contact[[0, peak]]).tolist() == [True, False]
    assert weber_propagation(observer, contact[peak]) < 0.3 * weber_propagation(
        observer, contact[0]
    )


def test_linear_is_what_the_posterior_bears_out():
    """Over r and θ_d at k = 0.02: where linear is said, propagation is the posterior's sd."""
    observer = ww.Observer(W, ForceMap(), Weber(0.02))
    r = np.array([0.3, 0.5, 0.7])[:, None] * L
    limit = ww.flick_past(W, r[:, 0]).deflection_angle[:, None]
    curve = ww.jnd_curve(observer, r, limit * [0.2, 0.5, 0.8], n_readings=40, seed=2)
    told = curve.table[curve["linear"].to_numpy()]
    assert len(told) >= 5
    assert np.allclose(told["propagation_mm"], told["posterior_mm"], rtol=0.3)


def test_linear_is_the_same_at_all_azimuths():
    """An azimuth that may be any has no ends: near ±π it was taken for known."""
    observer = ww.Observer(W, SpaceMap())
    contact = [[30e-3, 0.2, azimuth] for azimuth in (0.5, 3.13, np.pi, -3.13)]
    assert is_linear(observer, contact).all()
    assert np.ptp(fisher_jnd(observer, contact)) < 1e-12
