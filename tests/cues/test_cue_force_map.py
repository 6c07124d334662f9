"""The map of moment and forces (§2f): any signals, angle known or not, stiffness known or not."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from cue_checks import (
    agrees_with_brute_force,
    keeps_the_protocol,
    prior_draws,
    small_noise_limit,
)
from short_forms import slow_but

import weberwhisk as ww
from weberwhisk import Outcome, Status
from weberwhisk.cues import Compliance, ForceMap, UnknownStiffness
from weberwhisk.cues.force_map import SIGNALS
from weberwhisk.inference import default_noise
from weberwhisk.receptors import GeneralisedWeber, Weber
from weberwhisk.sensitivity import fisher_jnd, weber_propagation

W = ww.Whisker(length=50e-3, base_radius=100e-6, tip_radius=5e-6)
PAIRS = [ForceMap(pair) for pair in itertools.combinations(SIGNALS, 2)]
KNOWN = [ForceMap(name, deflection_angle=0.2) for name in SIGNALS]
ALL = ForceMap(SIGNALS)


def contacts(n, seed=1, most=0.9):
    rng = np.random.default_rng(seed)
    r = rng.uniform(0.05, 0.9, n) * W.length
    share = rng.uniform(0.05, most, n)
    return np.stack([r, share * ww.flick_past(W, r).deflection_angle], axis=-1)


@pytest.mark.parametrize("cue", [*PAIRS, *KNOWN, ALL, UnknownStiffness(ALL)], ids=repr)
def test_the_protocol_is_kept(cue):
    contact = np.concatenate([contacts(50), np.full((50, 1), 1.3)], axis=-1)
    contact = contact[:, [0, 2]] if cue in KNOWN else contact
    contact = contact[:, : len(cue.unknowns)]
    if cue in KNOWN:
        contact = np.linspace(0.1, 0.7, 50)[:, None] * W.length
    keeps_the_protocol(ww.Observer(W, cue), contact)


@pytest.mark.parametrize("whisker", [W, W.cylinder()], ids=["tapered", "cylinder"])
@pytest.mark.parametrize("cue", PAIRS, ids=repr)
def test_two_signals_are_inverted(cue, whisker):
    contact = contacts(300)
    contact[:, 1] = np.minimum(contact[:, 1], 1.2)
    signals, outcome = cue.signals(whisker, contact)
    assert np.all(outcome == Outcome.HELD)
    found, outcome = cue.contact(whisker, signals)
    if whisker is not W and cue is PAIRS[0]:
        assert np.all(outcome == Outcome.OUT_OF_REACH)
        assert np.isnan(found).all()
    else:
        assert np.all(outcome == Outcome.HELD)
        assert np.allclose(found, contact, rtol=1e-6)


@pytest.mark.parametrize("pair", PAIRS[1:], ids=repr)
def test_the_transverse_force_makes_the_map_one_to_one_on_a_cylinder_too(pair):
    """∂(ln S₁, ln S₂)/∂(ln r, ln θ) never vanishes: it is 1 and 2 at small angle."""
    for whisker in (W, W.cylinder()):
        r = np.linspace(0.02, 0.98, 40)[:, None] * whisker.length
        share = np.sin(np.linspace(0.01, 0.99, 40) * np.pi / 2)
        theta = share * ww.flick_past(whisker, r).deflection_angle
        contact = np.stack(np.broadcast_arrays(r, theta), axis=-1)
        signals, _ = pair.signals(whisker, contact)
        determinant = np.linalg.det(pair.jacobian(whisker, contact)) * r * theta
        determinant /= np.abs(signals).prod(axis=-1)
        assert np.all(determinant[np.isfinite(determinant)] > 0.999)


def test_the_moment_is_inverted_at_a_known_angle():
    cue = KNOWN[0]
    r = np.linspace(0.02, 0.999, 30)[:, None] * cue.farthest(W)
    found, outcome = cue.contact(W, cue.signals(W, r)[0])
    assert np.all(outcome == Outcome.HELD)
    assert found == pytest.approx(r, rel=1e-7)
    found, outcome = cue.contact(W, [[1e-12]])
    assert outcome[0] == Outcome.OUT_OF_REACH
    assert np.isnan(found[0, 0])


@pytest.mark.parametrize("cue", slow_but([PAIRS[1], KNOWN[0], KNOWN[1], ALL], (3,)), ids=repr)
@pytest.mark.slow  # of the force map: `tests/inference`
def test_posteriors_agree_with_brute_force(cue):
    observer = ww.Observer(W, cue, replace(default_noise(W, cue), correlation=0.3))
    agrees_with_brute_force(observer, observer.read(prior_draws(observer, 1, 3), 4))


@pytest.mark.parametrize(
    ("cue", "noise"),
    slow_but(
        [
            (ForceMap(), Weber([0.01, 0.02], correlation=0.5)),
            (ForceMap(["moment", "transverse_force"]), None),
            (ALL, GeneralisedWeber(0.01, floor=[0, 0, 1e-7], correlation=-0.3)),
            (KNOWN[0], Weber(0.01)),
            (UnknownStiffness(ALL, 0.05), None),
        ],
        (0, 4),
    ),
)
def test_posteriors_have_the_propagated_width_at_small_noise(cue, noise):
    contact = np.array([[20e-3, 0.2, 1.0], [32e-3, 0.2, 1.0]])[:, : len(cue.unknowns)]
    noise = noise or default_noise(W, cue, 0.01)
    small_noise_limit(ww.Observer(W, cue, noise), contact, draws=30, bias=5e-3)


def test_moment_over_transverse_force_is_the_distance_at_small_angle():
    """M = r·F: Δr = r·√(k_M² + k_F² − 2ρk_Mk_F), whatever the taper and the stiffness."""
    noise = GeneralisedWeber([0.03, 0.04], floor=[0, 1e-16], correlation=0.5)
    cue = ForceMap(["moment", "transverse_force"])
    r = np.array([10e-3, 25e-3, 45e-3])
    contact = np.stack([r, np.full(3, 1e-4), np.ones(3)], axis=-1)
    expected = r * np.sqrt(0.03**2 + 0.04**2 - 2 * 0.5 * 0.03 * 0.04)
    for whisker in (W, W.cylinder()):
        observer = ww.Observer(whisker, cue, noise)
        assert weber_propagation(observer, contact[:, :2]) == pytest.approx(expected, rel=1e-6)
        soft = ww.Observer(whisker, UnknownStiffness(cue, 10.0), noise)
        assert weber_propagation(soft, contact) == pytest.approx(expected, rel=1e-6)


def test_unknown_stiffness_spoils_the_papers_pair_and_the_tap_but_hardly_moment_over_force():
    contact = np.array([25e-3, 0.2, 1.0])

    def jnds(cue):
        soft = ww.Observer(W, UnknownStiffness(cue))
        return fisher_jnd(ww.Observer(W, cue), contact[:2]), fisher_jnd(soft, contact)

    pair, soft_pair = jnds(ForceMap())
    ratio, soft_ratio = jnds(PAIRS[1])
    every, soft_every = jnds(ALL)
    assert soft_pair > 2 * pair
    assert soft_ratio < 1.1 * ratio
    # Of all three, what is left is what moment over force tells, and a little more.
    assert every < 0.6 * ratio
    assert 0.95 * soft_ratio < soft_every < soft_ratio
    tap = fisher_jnd(ww.Observer(W, Compliance()), contact[:1])
    soft = fisher_jnd(ww.Observer(W, UnknownStiffness(Compliance())), contact[[0, 2]])
    # ln Ṁ has the information 1/k² + 2 from noise; the prior's variance adds to its inverse.
    expected = np.sqrt(1 + 0.42**2 * (1 / 0.1**2 + 2))
    assert soft / tap == pytest.approx(expected, rel=1e-9)


def test_a_cylinders_pair_leaves_the_contact_open_and_a_third_signal_closes_it():
    cylinder = W.cylinder()
    for cue, status in ((ForceMap(), Status.UNIDENTIFIED), (ALL, Status.CONVERGED)):
        observer = ww.Observer(cylinder, cue, default_noise(cylinder, cue, 0.03))
        p = ww.posterior(observer, observer.read([25e-3, 0.3], seed=1))
        assert p.status == status
    assert np.isinf(weber_propagation(ww.Observer(cylinder, ForceMap()), [25e-3, 0.3]))


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: ForceMap(["momnt"]), "did you mean 'moment'"),
        (lambda: ForceMap([]), "one or more, each once"),
        (lambda: ForceMap(["moment", "moment"]), "one or more, each once"),
        (lambda: ForceMap(deflection_angle=-0.1), "deflection_angle must be above zero"),
        (lambda: ALL.contact(W, [1e-6, 1e-5, 1e-5]), "no unique contact"),
        (lambda: KNOWN[1].contact(W, [1e-6]), "no unique contact"),
        (lambda: ww.Observer(W, ForceMap(deflection_angle=2.0)), "No contact holds"),
        (lambda: UnknownStiffness(ALL, 0), "spread must be above zero"),
        (lambda: UnknownStiffness(UnknownStiffness(ALL)), "unknown in .* already"),
        (lambda: UnknownStiffness(ALL, soft_signals=["torque"]), "signal 'torque' is unknown"),
    ],
)
def test_misuse_is_refused_in_one_sentence(call, words):
    with pytest.raises(ValueError, match=words) as error:
        call()
    assert "\n" not in str(error.value)


def test_a_reading_whose_search_comes_to_a_standstill_is_not_found_in_silence():
    """Newton's determinant was 0 there: a warning, then a refusal of an angle that is NaN."""
    found, outcome = ForceMap().contact(W, [4.035570122755542e-08, 1.4052928242893354e-06])
    assert outcome == Outcome.OUT_OF_REACH
    assert np.isnan(found).all()


def test_moments_at_a_known_angle_are_inverted_each_by_itself():
    """The first row's outcome stood for all, and rows after the first were off by a tenth."""
    observer = ww.Observer(W, ForceMap("moment", deflection_angle=0.2))
    contacts = np.array([[10e-3], [20e-3], [30e-3]])
    moments = observer.signals(contacts)[0]
    for wanted in (moments, moments[:, 0]):
        found, outcome = observer.cue.contact(W, wanted)
        assert found == pytest.approx(contacts, rel=1e-9)
        assert outcome.tolist() == [Outcome.HELD] * 3
    assert observer.cue.contact(W, moments[0, 0])[0] == pytest.approx([10e-3])
    reading = np.concatenate([[[1e-12]], moments[1:]])
    lost = [Outcome.OUT_OF_REACH, Outcome.HELD, Outcome.HELD]
    assert ww.posterior(observer, reading).outcome.tolist() == lost
    assert ww.posterior(observer, reading[::-1]).outcome.tolist() == lost[::-1]
