"""Distance from the vibration after an impact (§2d)."""

import numpy as np
import pytest
from analysis_scripts import load
from cue_checks import agrees_with_brute_force, keeps_the_protocol, small_noise_limit
from scipy import stats
from scipy.optimize import brentq

import weberwhisk as ww
from weberwhisk import Outcome, Status
from weberwhisk.cues import ForceMap, Vibration
from weberwhisk.inference.approximate import count_peaks, is_divided
from weberwhisk.mechanics import modes
from weberwhisk.receptors import GeneralisedWeber, Weber

W = ww.Whisker(length=50e-3, base_radius=100e-6, tip_radius=5e-6)
R = np.array([[10e-3], [25e-3], [42e-3]])
CUES = [
    Vibration(),
    Vibration(4, phase=True),
    Vibration(1, impulse=1e-9),
    Vibration(3, impulse=1e-9),
]


@pytest.mark.parametrize("cue", CUES, ids=repr)
def test_the_protocol_is_kept(cue):
    keeps_the_protocol(ww.Observer(W, cue), np.linspace(0.02, 0.99, 60)[:, None] * W.length)


def test_ratios_of_a_uniform_beam_are_those_of_its_exact_shapes():
    """cosh βx − cos βx − σ(sinh βx − sin βx): there M_n/ω_n is the same for every mode."""
    roots = [
        brentq(lambda b: np.cos(b) * np.cosh(b) + 1, *ends) for ends in ((1, 3), (4, 6), (7, 9))
    ]
    x = np.linspace(0.05, 1, 30)

    def shape(b):
        sigma = (np.cosh(b) + np.cos(b)) / (np.sinh(b) + np.sin(b))
        return np.cosh(b * x) - np.cos(b * x) - sigma * (np.sinh(b * x) - np.sin(b * x))

    first, *others = (shape(b) for b in roots)
    exact = np.stack([other / first for other in others], axis=-1)
    ratios, _ = Vibration(3, phase=True).signals(W.cylinder(), x[:, None] * W.length)
    assert ratios == pytest.approx(exact, rel=1e-6, abs=1e-7)


def test_amplitudes_are_those_of_the_ringing():
    """Each mode's moment at the base over two periods of the first, struck by 1e-9 N s."""
    found = modes.modes(W, 3)
    t = np.linspace(0, 2 / found.frequency[0], 20_001)
    omega = found.angular_frequency
    amplitude, _ = Vibration(3, impulse=1e-9).signals(W, R)
    for n in range(3):
        struck = 1e-9 * found.shape(R[:, 0])[n] * found.base_moment[n]
        ringing = struck[:, None] * np.sin(omega[n] * t) / omega[n]
        assert np.abs(ringing).max(axis=1) == pytest.approx(amplitude[:, n], rel=1e-4)


@pytest.mark.parametrize("cue", CUES, ids=repr)
def test_posteriors_agree_with_brute_force(cue):
    observer = ww.Observer(W, cue)
    agrees_with_brute_force(observer, observer.read(R, 4))


def test_posteriors_have_the_propagated_width_at_small_noise():
    cue = Vibration(4, phase=True)
    small_noise_limit(ww.Observer(W, cue, cue.noise(1e-3, 1e-4)), R, draws=50, bias=5e-3)


def test_the_ratios_posterior_is_that_of_amplitudes_with_the_strength_integrated_out():
    """Amplitudes with Weber noise, ln J flat: integrated here by brute force, J and all."""
    k, r = 0.02, 25e-3
    amplitudes = Vibration(3, impulse=1.0)
    place = np.linspace(20e-3, 30e-3, 2001)
    signals, _ = amplitudes.signals(W, place[:, None])
    truth, _ = amplitudes.signals(W, np.array([r]))
    noise = GeneralisedWeber(k, floor=1e-9)
    strength = np.exp(np.linspace(-0.2, 0.2, 401))
    log = noise.log_likelihood(truth, signals[:, None] * strength[:, None])
    weight = np.exp(log - log.max()).sum(axis=1)
    mean = place @ weight / weight.sum()
    sd = np.sqrt((place - mean) ** 2 @ weight / weight.sum())
    ratios = Vibration(3)
    here = {"radial_distance": stats.uniform(20e-3, 10e-3)}  # one of the peaks
    observer = ww.Observer(W, ratios, ratios.noise(k, 1e-9), here)
    p = ww.posterior(observer, ratios.signals(W, np.array([r]))[0])
    assert p.sd == pytest.approx(sd, rel=0.02)
    assert p.mean == pytest.approx(mean, abs=0.05 * sd)


def test_modes_that_damping_merges_are_unresolved():
    omega = modes.modes(W, 6).angular_frequency
    merging = np.min(np.diff(omega) / (omega[1:] + omega[:-1]))
    for share, outcome in ((0.99, Outcome.HELD), (1.01, Outcome.UNRESOLVED)):
        cue = Vibration(6, damping_ratio=share * merging)
        signals, found = cue.signals(W, R)
        assert np.all(found == outcome)
        assert np.isnan(signals).all() == (outcome != Outcome.HELD)
        assert cue.resolved(W) == (outcome == Outcome.HELD)
    table = ww.jnd_curve(ww.Observer(W, cue), R[:, 0], n_readings=2)
    assert table["outcome"].str.startswith("unresolved").all()
    assert table["posterior"].isna().all()
    assert Vibration(2, damping_ratio=share * merging).resolved(W)


def test_amplitudes_leave_several_places_and_their_phases_one():
    """The paper's expectation holds where amplitudes alone are felt, and not where phase is."""
    uniqueness = load("vibration").uniqueness

    # Without phase even k = 0.01 leaves doubt with few modes, and k = 0.1 with many.
    assert uniqueness(2, 0.01, False, 60)[0] < 0.3
    assert uniqueness(6, 0.1, False, 60)[0] < 0.7
    assert uniqueness(3, 0.1, False, 60)[1] >= 3
    assert uniqueness(8, 0.01, False, 60)[0] > 0.95
    # With it the ratio of the second mode to the first is monotone, so that two are enough.
    for k in (0.3, 0.1, 0.01):
        assert uniqueness(2, k, True, 60) == (1.0, 1)
    r = np.linspace(1e-4, W.length, 2001)[:, None]
    for whisker in (W, W.cylinder(), ww.Whisker(50e-3, 100e-6, 0.0)):
        assert np.all(np.diff(Vibration(2, phase=True).signals(whisker, r)[0][:, 0]) < 0)


@pytest.fixture(scope="module")
def divided():
    """An observer of six modes without phase, and readings with mass in several places."""
    observer = ww.Observer(W, Vibration(6))
    readings = observer.read(np.linspace(5e-3, 48e-3, 8)[:, None], seed=1)
    apart = is_divided(observer, readings)
    assert 2 <= apart.sum() < len(apart)
    return observer, readings, apart


def test_laplace_says_that_there_are_more_peaks_than_its_own(divided):
    observer, readings, apart = divided
    exact = ww.posterior(observer, readings)
    p = ww.posterior(observer, readings, "laplace")
    wrong = np.abs(p.sd / exact.sd - 1) > 0.5
    assert wrong.sum() >= 2
    assert np.all(p.status[wrong] != Status.CONVERGED)
    assert np.all(p.status[apart] == Status.SEVERAL_PEAKS)
    assert not np.any(p.status[~apart] == Status.SEVERAL_PEAKS)


@pytest.mark.slow
@pytest.mark.parametrize(
    "scenes",
    [[(2, 0.1, 2)], pytest.param([(2, 0.1, 6), (6, 0.1, 2), (3, 0.01, 2)], marks=pytest.mark.slow)],
)
def test_walkers_jump_from_peak_to_peak_or_say_why_not(scenes):
    """Converged, they are right; what a sample may well not see is said to be there."""
    for count, k, size in scenes:
        observer = ww.Observer(W, Vibration(count), Weber(k))
        r = np.random.default_rng(1).uniform(5e-3, 48e-3, (size, 1))
        readings = observer.read(r, seed=2)
        exact = ww.posterior(observer, readings)
        p = ww.posterior(observer, readings, "emcee", seed=3)
        good = p.status == Status.CONVERGED
        assert np.all(np.abs(p.mean - exact.mean)[good] < 5 * p.mean_error[good])
        assert np.all(np.abs(p.sd - exact.sd)[good] < 5 * p.sd_error[good])
        if count == 2:
            assert is_divided(observer, readings).all()
            assert good.mean() > 0.8


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: Vibration(1), "count must be 2 to 12, got 1"),
        (lambda: Vibration(13, impulse=1e-9), "count must be 1 to 12"),
        (lambda: Vibration(impulse=-1.0), "impulse must be above zero"),
        (lambda: Vibration(damping_ratio=1.0), "damping_ratio must be below 1"),
        (lambda: count_peaks(ww.Observer(W, Vibration()), [1.0, 1.0], 95), "between 0 and 1"),
        (lambda: count_peaks(ww.Observer(W, ForceMap()), [1e-6, 1e-5]), "for one unknown"),
    ],
)
def test_misuse_is_refused_in_one_sentence(call, words):
    with pytest.raises(ValueError, match=words) as error:
        call()
    assert "\n" not in str(error.value)
