"""Receptor noise: moments, likelihood, sampling and information agree with each other."""

import numpy as np
import pytest
from numpy.polynomial.legendre import leggauss
from scipy import stats

import weberwhisk as ww
from weberwhisk import Status, domain
from weberwhisk.cues import Compliance
from weberwhisk.receptors import (
    Afferents,
    GeneralisedWeber,
    LogNormal,
    Saturating,
    SpikeCount,
    Weber,
)
from weberwhisk.sensitivity import fisher_jnd, weber_propagation

GAUSSIAN = {
    "weber": Weber(0.1),
    "per signal": Weber([0.1, 0.3]),
    "correlated": Weber([0.1, 0.2], correlation=0.6),
    "negative": Weber(0.2, correlation=-0.9),
    "floor": GeneralisedWeber(0.1, floor=[0.2, 0.1]),
    "ceiling": GeneralisedWeber(0.1, floor=0.2, ceiling=[1.5, 9.0], correlation=0.3),
    "constant": GeneralisedWeber(0.0, floor=[0.2, 0.1], correlation=-0.4),
    "saturating": Saturating([0.1, 0.2], ceiling=[3.0, 9.0], sharpness=2.0, floor=0.1),
}
OTHER = {
    "log-normal": LogNormal([0.1, 0.4]),
    "log-normal, correlated": LogNormal([0.5, 0.3], correlation=0.7),
    "counts": SpikeCount(Afferents(3, 0.5, [8.0, 20.0]), Afferents(2, 30.0, 300.0)),
    "counts, gain": SpikeCount(Afferents(3, 0.5, 8.0, exponent=1.3), gain_sd=0.4),
}
MODELS = GAUSSIAN | OTHER
every_model = pytest.mark.parametrize("noise", MODELS.values(), ids=MODELS)
SIGNALS = np.array([[2.0, 5.0], [0.3, -4.0], [1.0, 10.0]])


@pytest.mark.parametrize("noise", GAUSSIAN.values(), ids=GAUSSIAN)
def test_likelihood_is_scipys_normal_with_the_models_covariance(noise):
    reading = SIGNALS * [[1.1, 0.9]]
    for y, mean, covariance, ours in zip(
        reading,
        noise.mean(SIGNALS),
        noise.covariance(SIGNALS),
        noise.log_likelihood(reading, SIGNALS),
        strict=True,
    ):
        assert ours == pytest.approx(
            stats.multivariate_normal.logpdf(y, mean, covariance), rel=1e-12
        )


@every_model
def test_samples_have_the_models_moments(noise):
    n = 100_000
    draws = noise.sample(np.broadcast_to(SIGNALS[0], (n, 2)), seed=4)
    covariance = noise.covariance(SIGNALS[0])
    off = draws - noise.mean(SIGNALS[0])
    assert np.all(np.abs(off.mean(axis=0)) < 4.5 * np.sqrt(np.diag(covariance) / n))
    products = off[:, :, None] * off[:, None, :]
    error = products.std(axis=0) / np.sqrt(n)
    assert np.all(np.abs(products.mean(axis=0) - covariance) < 4.5 * error)


@every_model
def test_fisher_information_is_the_variance_of_the_score(noise):
    signal, n, h = SIGNALS[0], 200_000, 1e-4
    draws = noise.sample(np.broadcast_to(signal, (n, 2)), seed=7)
    score = np.stack(
        [
            (
                noise.log_likelihood(draws, signal + step)
                - noise.log_likelihood(draws, signal - step)
            )
            / (2 * h)
            for step in np.eye(2) * h
        ],
        axis=-1,
    )
    information = noise.fisher(signal)
    products = score[:, :, None] * score[:, None, :]
    error = products.std(axis=0) / np.sqrt(n)
    assert np.all(np.abs(products.mean(axis=0) - information) <= 4.5 * error + 1e-9)


ONE_SIGNAL = {
    "weber": Weber(0.2),
    "ceiling": GeneralisedWeber(0.1, floor=0.2, ceiling=5.0),
    "saturating": Saturating(0.1, ceiling=2.0, sharpness=3.0),
    "log-normal": LogNormal(0.1),
    "wide log-normal": LogNormal(1.0),
    "count": SpikeCount(Afferents(1, 2.0, 2.0, exponent=1.5), window=0.2),
    "count, gain": SpikeCount(None, Afferents(1, 90.0, 90.0, peak_rate=900.0), gain_sd=0.3),
}


def over_all_readings(noise, signal):
    """All readings of one signal, as nodes (n, 1) and weights of an integral or a sum."""
    low, high = (float(end[0]) for end in noise.interval([signal], 9.0))
    if isinstance(noise, SpikeCount):
        counts = np.arange(np.ceil(high) + 1)[:, None]
        return counts, np.ones(len(counts))
    x, w = leggauss(300)
    if isinstance(noise, LogNormal):
        logs = np.log(low) + (np.log(high) - np.log(low)) * (x + 1) / 2
        return np.exp(logs)[:, None], w * (np.log(high) - np.log(low)) / 2 * np.exp(logs)
    return (low + (high - low) * (x + 1) / 2)[:, None], w * (high - low) / 2


@pytest.mark.parametrize("signal", [0.7, 3.0, 20.0])
@pytest.mark.parametrize("noise", ONE_SIGNAL.values(), ids=ONE_SIGNAL)
def test_the_integral_over_all_readings_gives_one_mean_variance_and_information(noise, signal):
    reading, weight = over_all_readings(noise, signal)

    def log(at):
        return noise.log_likelihood(reading, np.full((len(reading), 1), at))

    weight = weight * np.exp(log(signal))
    assert weight.sum() == pytest.approx(1, rel=1e-10)
    assert weight @ reading[:, 0] == pytest.approx(noise.mean([signal])[0], rel=1e-10)
    off = reading[:, 0] - noise.mean([signal])[0]
    assert weight @ off**2 == pytest.approx(noise.covariance([signal])[0, 0], rel=1e-9)
    h = 1e-4 * signal
    score = (
        8 * (log(signal + h) - log(signal - h)) - log(signal + 2 * h) + log(signal - 2 * h)
    ) / (12 * h)
    assert weight @ score**2 == pytest.approx(noise.fisher([signal])[0, 0], rel=1e-8, abs=1e-18)


@pytest.mark.parametrize("width", [1.0, 3.0, 5.0, 10.0])
@pytest.mark.parametrize("noise", ONE_SIGNAL.values(), ids=ONE_SIGNAL)
def test_readings_outside_the_interval_are_as_rare_as_it_says(noise, width):
    for signal in (0.01, 0.7, 3.0, 20.0):
        (low,), (high,) = noise.interval([signal], width)
        mean, variance = float(noise.mean([signal])[0]), float(noise.covariance([signal])[0, 0])
        if isinstance(noise, LogNormal):
            tails = stats.lognorm(noise.sigma, scale=signal * np.exp(-(noise.sigma**2) / 2))
        elif isinstance(noise, SpikeCount) and noise.gain_sd:
            shape = noise.gain_sd**-2
            tails = stats.nbinom(shape, shape / (shape + mean))
        elif isinstance(noise, SpikeCount):
            tails = stats.poisson(mean)
        else:
            tails = stats.norm(mean, np.sqrt(variance))
        bound = np.exp(-0.5 * width**2)
        assert tails.cdf(np.nextafter(low, -np.inf)) <= bound
        assert tails.sf(high) <= bound


# -- limits ---------------------------------------------------------------------------------------


def test_one_weber_signal_carries_1_plus_2k_squared():
    k, signal = 0.2, 3.0
    assert Weber(k).fisher([signal])[0, 0] == pytest.approx((1 + 2 * k**2) / (k * signal) ** 2)


def same(a, b, rtol=1e-12):
    reading = SIGNALS * [[1.1, 0.9]]
    for part in ("mean", "sd", "covariance", "fisher", "jacobian"):
        assert np.allclose(getattr(a, part)(SIGNALS), getattr(b, part)(SIGNALS), rtol=rtol), part
    assert np.allclose(a.log_likelihood(reading, SIGNALS), b.log_likelihood(reading, SIGNALS), rtol)


def test_weber_is_the_limit_of_its_generalisations():
    weber = Weber([0.1, 0.2], correlation=0.4)
    options = {"weber_fraction": [0.1, 0.2], "correlation": 0.4}
    same(weber, GeneralisedWeber(**options, floor=0.0))
    same(weber, Saturating(**options, ceiling=1e15), rtol=1e-10)


def test_log_normal_noise_has_webers_moments_and_its_shape_as_k_falls():
    for k in (0.05, 0.5, 2.0):
        weber, log_normal = Weber(k), LogNormal(k)
        assert np.allclose(log_normal.mean(SIGNALS), weber.mean(SIGNALS))
        assert np.allclose(log_normal.sd(SIGNALS), weber.sd(SIGNALS))
        ratio = weber.fisher([3.0])[0, 0] / log_normal.fisher([3.0])[0, 0]
        assert ratio == pytest.approx((1 + 2 * k**2) * np.log1p(k**2) / k**2, rel=1e-12)
    # The leading difference is the skewness, 3k: a Kullback–Leibler divergence of (3k)²/12.
    for k in (0.02, 0.01):
        reading, weight = over_all_readings(LogNormal(k), 3.0)
        signals = np.full((len(reading), 1), 3.0)
        log = LogNormal(k).log_likelihood(reading, signals)
        divergence = weight @ (np.exp(log) * (log - Weber(k).log_likelihood(reading, signals)))
        assert divergence == pytest.approx(0.75 * k**2, rel=20 * k**2)


@pytest.mark.parametrize("signal", [1e-120, 1e-158, 1e-300, 5e-324, 0.0])
def test_signals_next_to_nothing_exclude_a_reading(signal):
    """Where an sd underflowed the likelihood was NaN, and a walker that went there ended a run."""
    log = Weber(0.01).log_likelihood([1e-6, 1e-4], [signal, signal**2])
    assert log < -1e200


def test_a_log_normal_receptor_does_not_mistake_the_sign():
    noise = LogNormal(0.5)
    assert np.array_equal(np.sign(noise.sample(SIGNALS, seed=2)), np.sign(SIGNALS))
    readings = np.array([[-2.0, 5.0], [2.0, -5.0], [0.0, 5.0]])
    assert np.all(noise.log_likelihood(readings, SIGNALS[:1]) == -np.inf)
    assert noise.log_likelihood(-readings[0], -SIGNALS[0]) == -np.inf
    assert np.isfinite(noise.log_likelihood([0.3, -4.4], SIGNALS[1]))


def test_a_signal_without_spread_is_impossible_not_nan():
    assert Weber(0.1).log_likelihood([1.0], [0.0]) == -np.inf
    assert Weber(0.1).log_likelihood([0.0], [0.0]) == -np.inf
    assert LogNormal(0.1).log_likelihood([0.0], [0.0]) == -np.inf


# -- observers ------------------------------------------------------------------------------------

W = ww.Whisker(50e-3, 100e-6, 5e-6)
UNIT = float(W.compliance_constant / W.length)
OBSERVED = {
    "saturating": Saturating(0.1, ceiling=4 * UNIT, floor=0.01 * UNIT),
    "log-normal": LogNormal(0.1),
    "wide log-normal": LogNormal(0.7),
}


def brute_force(observer, reading):
    """Mean and sd of r for a flat prior, by Gauss–Legendre on many cells in r."""
    x, w = leggauss(6)
    top = 1 - np.geomspace(1e-14, 1e-3, 200)[::-1]
    edges = np.concatenate([[0.0], np.geomspace(1e-9, 1e-2, 800), np.linspace(0.011, 0.998, 4000)])
    edges = np.concatenate([edges, top]) * observer.whisker.length
    half = np.diff(edges) / 2
    r = ((edges[:-1] + half)[:, None] + half[:, None] * x).ravel()
    log = observer.log_likelihood(reading, r[:, None])
    weight = np.exp(log - log.max()) * (half[:, None] * w).ravel()
    mean = weight @ r / weight.sum()
    return mean, np.sqrt(weight @ (r - mean) ** 2 / weight.sum())


@pytest.mark.parametrize("noise", OBSERVED.values(), ids=OBSERVED)
def test_quadrature_agrees_with_brute_force(noise):
    observer = ww.Observer(W, Compliance(), noise)
    readings = observer.read(np.array([[0.05], [0.3], [0.7], [0.95]]) * W.length, seed=2)
    p = ww.posterior(observer, readings)
    inside = not domain.of_observer(observer)
    assert np.all(p.status == (Status.CONVERGED if inside else Status.OUTSIDE_DOMAIN))
    for mean, sd, reading in zip(p.mean, p.sd, readings, strict=True):
        expected_mean, expected_sd = brute_force(observer, reading)
        assert abs(mean - expected_mean) < 2e-3 * expected_sd
        assert sd == pytest.approx(expected_sd, rel=2e-3)


def test_the_linear_jnd_goes_by_the_slope_of_the_response():
    contact, weber = [0.4 * W.length], Weber(0.1)
    noise = Saturating(0.1, ceiling=UNIT)
    signal = ww.Observer(W, Compliance(), weber).signals(contact)[0]
    ratio = noise.mean(signal)[0] / signal[0] / noise.jacobian(signal)[0, 0]
    expected = ratio * weber_propagation(ww.Observer(W, Compliance(), weber), contact)
    found = weber_propagation(ww.Observer(W, Compliance(), noise), contact)
    assert found == pytest.approx(expected, rel=1e-12)
    blind = ww.Observer(W, Compliance(), GeneralisedWeber(0.1, floor=0.0, ceiling=0.1 * UNIT))
    assert weber_propagation(blind, contact) == np.inf
    assert fisher_jnd(blind, contact) == np.inf


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Weber(-0.1), "weber_fraction must be above zero, got -0.1"),
        (lambda: Weber(0), "weber_fraction must be above zero, got 0"),
        (lambda: Weber(np.nan), "weber_fraction must be finite, got nan"),
        (lambda: Weber("small"), "weber_fraction must be a number"),
        (lambda: Weber(0.1, correlation=1.2), "correlation must lie between -1 and 1, got 1.2"),
        (lambda: GeneralisedWeber(0, floor=[0, 1]), "A signal without noise has no likelihood"),
        (lambda: GeneralisedWeber(0.1, floor=-1), "floor must not be negative, got -1"),
        (lambda: GeneralisedWeber(0.1, floor=1, ceiling=0), "ceiling must be above zero"),
        (lambda: Weber(0.1, correlation=1).log_likelihood([1.0, 2], [1.0, 2]), "has no likelihood"),
        (lambda: Weber(0.1, correlation=-0.7).sample([1.0, 2, 3]), "cannot all be correlated"),
        (lambda: Saturating(0.1, ceiling=-1), "ceiling must be above zero, got -1"),
        (lambda: Saturating(0.1, ceiling=1, sharpness=0), "sharpness must be above zero, got 0"),
        (lambda: LogNormal(0), "weber_fraction must be above zero, got 0"),
        (lambda: LogNormal(0.1, correlation=2), "correlation must lie between -1 and 1, got 2"),
        (lambda: LogNormal(correlation=-1).log_likelihood([1.0, 2], [1.0, 2]), "no likelihood"),
    ],
)
def test_nonsense_is_refused(make, words):
    with pytest.raises(ValueError, match=words):
        make()
