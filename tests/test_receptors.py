"""Receptor noise: sd, likelihood, sampling and information agree with each other."""

import numpy as np
import pytest
from scipy import stats

from weberwhisk.receptors import GeneralisedWeber, ReceptorNoise, Weber

MODELS = {
    "weber": Weber(0.1),
    "per signal": Weber([0.1, 0.3]),
    "correlated": Weber([0.1, 0.2], correlation=0.6),
    "negative": Weber(0.2, correlation=-0.9),
    "floor": GeneralisedWeber(0.1, floor=[0.2, 0.1]),
    "ceiling": GeneralisedWeber(0.1, floor=0.2, ceiling=[1.5, 9.0], correlation=0.3),
}
SIGNALS = np.array([[2.0, 5.0], [0.3, -4.0], [1.0, 10.0]])


@pytest.mark.parametrize("noise", MODELS.values(), ids=MODELS)
def test_likelihood_is_scipys_normal_with_the_models_covariance(noise):
    assert isinstance(noise, ReceptorNoise)
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


@pytest.mark.parametrize("noise", MODELS.values(), ids=MODELS)
def test_samples_have_the_models_moments(noise):
    n = 200_000
    draws = noise.sample(np.broadcast_to(SIGNALS[0], (n, 2)), seed=4)
    covariance = noise.covariance(SIGNALS[0])
    z = (draws.mean(axis=0) - noise.mean(SIGNALS[0])) / np.sqrt(np.diag(covariance) / n)
    assert np.all(np.abs(z) < 4)
    spread = np.sqrt((np.outer(np.diag(covariance), np.diag(covariance)) + covariance**2) / n)
    assert np.all(np.abs(np.cov(draws.T) - covariance) < 4 * spread)


@pytest.mark.parametrize("noise", MODELS.values(), ids=MODELS)
def test_fisher_information_is_the_variance_of_the_score(noise):
    signal, n, h = SIGNALS[0], 400_000, 1e-4
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


def test_one_weber_signal_carries_1_plus_2k_squared():
    k, signal = 0.2, 3.0
    assert Weber(k).fisher([signal])[0, 0] == pytest.approx((1 + 2 * k**2) / (k * signal) ** 2)


def test_generalised_weber_has_weber_and_constant_noise_as_limits():
    weber, no_floor = Weber(0.1), GeneralisedWeber(0.1, floor=0.0)
    assert np.allclose(weber.covariance(SIGNALS), no_floor.covariance(SIGNALS))
    assert np.allclose(weber.fisher(SIGNALS), no_floor.fisher(SIGNALS))
    constant = GeneralisedWeber(1e-9, floor=0.5)
    assert np.allclose(constant.fisher(SIGNALS), np.eye(2) / 0.25)


def test_a_saturated_receptor_knows_nothing():
    noise = GeneralisedWeber(0.1, floor=0.1, ceiling=2.0)
    assert noise.fisher([5.0])[0, 0] == 0
    assert noise.log_likelihood([2.1], [5.0]) == noise.log_likelihood([2.1], [50.0])
    assert noise.saturated([1.0, 5.0]).tolist() == [False, True]


def test_a_signal_without_spread_is_impossible_not_nan():
    assert Weber(0.1).log_likelihood([1.0], [0.0]) == -np.inf
    assert Weber(0.1).log_likelihood([0.0], [0.0]) == -np.inf


def test_sampling_is_repeatable():
    a, b = (Weber(0.1).sample(SIGNALS, seed=3) for _ in range(2))
    assert np.array_equal(a, b)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Weber(-0.1), "weber_fraction must be above zero, got -0.1"),
        (lambda: Weber(0), "weber_fraction must be above zero, got 0"),
        (lambda: Weber(np.nan), "weber_fraction must be finite, got nan"),
        (lambda: Weber("small"), "weber_fraction must be a number"),
        (lambda: Weber(0.1, correlation=1.2), "correlation must lie between -1 and 1, got 1.2"),
        (lambda: GeneralisedWeber(0.1, floor=-1), "floor must not be negative, got -1"),
        (lambda: GeneralisedWeber(0.1, floor=1, ceiling=0), "ceiling must be above zero"),
        (lambda: Weber(0.1, correlation=1).log_likelihood([1.0, 2], [1.0, 2]), "has no likelihood"),
        (lambda: Weber(0.1, correlation=-0.7).sample([1.0, 2, 3]), "cannot all be correlated"),
    ],
)
def test_nonsense_is_refused(make, words):
    with pytest.raises(ValueError, match=words):
        make()
