"""The plain grid: exact answers, honest errors, and misuse refused."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import special, stats

from weberwhisk.inference.grid import Sums, integrate

Array = NDArray[np.float64]


def gaussians(count: int, dim: int, seed: int) -> tuple[Callable[..., Array], Array, Array]:
    """A density for many correlated Gaussians, their means and covariances."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(count, dim, dim))
    covariance = root @ root.swapaxes(1, 2) + 0.1 * np.eye(dim)
    mean = 5.0 * rng.normal(size=(count, dim))
    precision = np.linalg.inv(covariance)

    def density(x: Array, index: Array) -> Array:
        off = x - mean[index][:, None]
        return -0.5 * np.einsum("bnd,bde,bne->bn", off, precision[index], off)

    return density, mean, covariance


def assert_moments(fit: Sums, mean: Array, sd: Array, within: float) -> None:
    """Means and sds are right to within so many sds, and to three times the errors claimed."""
    error = np.maximum(np.abs(fit.mean - mean) / sd, np.abs(fit.sd / sd - 1))
    assert error.max() < within
    assert np.all(error < 3 * fit.error + 1e-8)


def box(rows: int, dim: int, half: float) -> tuple[Array, Array]:
    return np.full((rows, dim), -half), np.full((rows, dim), half)


@pytest.mark.parametrize(("dim", "within"), [(1, 1e-6), (2, 1e-3), (3, 2e-2)])
def test_gaussians_anywhere_in_the_box(dim: int, within: float) -> None:
    density, mean, covariance = gaussians(6, dim, seed=dim)
    fit = integrate(density, *box(6, dim, 30.0))
    assert_moments(fit, mean, np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)), within)
    exact = 0.5 * np.log(np.linalg.det(2 * np.pi * covariance))
    np.testing.assert_allclose(fit.log_evidence, exact, atol=within)


def test_four_coordinates() -> None:
    fit = integrate(lambda x, index: -0.5 * (x**2).sum(axis=-1), *box(1, 4, 9.0))
    assert_moments(fit, np.zeros((1, 4)), np.ones((1, 4)), 1e-3)


@pytest.mark.parametrize("width", [1e-3, 1e-2, 0.1])
def test_peaks_far_narrower_than_the_first_nodes_are_apart(width: float) -> None:
    at = np.array([1.234, -2.345])
    fit = integrate(lambda x, index: -0.5 * (((x - at) / width) ** 2).sum(axis=-1), *box(1, 2, 8.0))
    assert_moments(fit, at[None], np.full((1, 2), width), 1e-6)


def test_gamma_variables_and_their_logs() -> None:
    shape = np.array([0.5, 1.0, 2.0, 5.0, 20.0, 100.0])
    fit = integrate(
        lambda x, index: shape[index][:, None] * x[..., 0] - np.exp(x[..., 0]),
        np.full((6, 1), -70.0),
        np.full((6, 1), 20.0),
        functions=lambda x: np.concatenate([x, np.exp(x)], axis=-1),
    )
    mean = np.stack([special.digamma(shape), shape], axis=-1)
    sd = np.sqrt(np.stack([special.polygamma(1, shape), shape], axis=-1))
    assert_moments(fit, mean, sd, 1e-5)
    np.testing.assert_allclose(fit.log_evidence, special.gammaln(shape), atol=1e-5)


@pytest.mark.parametrize("bend", [0.2, 0.75, 1.2])
def test_bananas(bend: float) -> None:
    width = 0.3
    fit = integrate(
        lambda x, index: (
            -0.5 * x[..., 0] ** 2 - 0.5 * ((x[..., 1] - bend * x[..., 0] ** 2) / width) ** 2
        ),
        *box(1, 2, 60.0),
    )
    sd = np.array([[1.0, np.sqrt(2 * bend**2 + width**2)]])
    assert_moments(fit, np.array([[0.0, bend]]), sd, 2e-3)


@pytest.mark.parametrize("gap", [1.0, 5.0, 15.0])
def test_two_modes(gap: float) -> None:
    fit = integrate(
        lambda x, index: np.logaddexp(-0.5 * (x[..., 0] - gap) ** 2, -2.0 * (x[..., 0] + gap) ** 2),
        *box(1, 1, 40.0),
    )
    variance = 2 / 3 + 1 / 12 + 2 / 9 * (2 * gap) ** 2
    assert_moments(fit, np.array([[gap / 3]]), np.sqrt([[variance]]), 1e-6)


def test_a_thin_ridge_across_the_axes_says_how_little_is_known() -> None:
    covariance = np.array([[1.0, 0.999999], [0.999999, 1.0]])
    precision = np.linalg.inv(covariance)
    fit = integrate(lambda x, index: -0.5 * ((x @ precision) * x).sum(axis=-1), *box(1, 2, 9.0))
    off = np.maximum(np.abs(fit.mean), np.abs(fit.sd - 1))
    assert np.all(off < 3 * fit.error + 1e-3)


def test_quantiles_from_the_weights() -> None:
    fit = integrate(lambda x, index: -0.5 * x[..., 0] ** 2, *box(1, 1, 9.0))
    rise = np.cumsum(fit.weights[0]) - fit.weights[0] / 2
    p = np.array([0.025, 0.5, 0.975])
    assert np.interp(p, rise, fit.points[0, :, 0]) == pytest.approx(stats.norm.ppf(p), abs=2e-3)


def test_a_density_that_is_zero_everywhere_is_nan() -> None:
    fit = integrate(
        lambda x, index: np.where(index[:, None] == 1, -0.5 * x[..., 0] ** 2, -np.inf),
        *box(2, 1, 9.0),
    )
    assert np.isnan(fit.mean[0]).all()
    assert np.isneginf(fit.log_evidence[0])
    assert fit.sd[1] == pytest.approx(1.0, abs=1e-6)


def test_each_posterior_is_on_its_own() -> None:
    density, _, _ = gaussians(12, 2, seed=3)
    together = integrate(density, *box(12, 2, 30.0))
    for i in (0, 5, 11):
        alone = integrate(lambda x, index, i=i: density(x, index + i), *box(1, 2, 30.0))
        np.testing.assert_allclose(alone.mean[0], together.mean[i], rtol=1e-12)
        np.testing.assert_allclose(alone.sd[0], together.sd[i], rtol=1e-12)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"low": np.zeros(2)}, "low and high must have shape"),
        ({"low": np.zeros((1, 5)), "high": np.ones((1, 5))}, "D from 1 to 4"),
        ({"low": np.ones((1, 1))}, "low must be below high"),
        ({"low": np.full((1, 1), -np.inf)}, "both finite"),
        ({"log_density": lambda x, index: np.zeros(3)}, "The log-density must have shape"),
        ({"log_density": lambda x, index: np.full(x.shape[:2], np.nan)}, "posterior 0 is nan"),
        ({"log_density": lambda x, index: np.full(x.shape[:2], np.inf)}, "posterior 0 is inf"),
    ],
)
def test_misuse_is_refused_in_one_sentence(change: dict[str, object], words: str) -> None:
    arguments: dict[str, object] = {
        "log_density": lambda x, index: -0.5 * (x**2).sum(axis=-1),
        "low": np.full((1, 1), -1.0),
        "high": np.ones((1, 1)),
    }
    with pytest.raises(ValueError, match=words) as caught:
        integrate(**(arguments | change))  # type: ignore[arg-type]
    assert str(caught.value).endswith(".")
    assert "\n" not in str(caught.value)
