"""R-hat and Monte Carlo errors of many posteriors at once.

ArviZ computes R-hat for one posterior at a time, in more time than a small posterior takes to
sample. Here they are batched: arrays of shape ``(..., chain, draw)`` give results of shape
``(...)``. `rhat` follows Vehtari et al. (2021, Bayesian Analysis 16, 667) and agrees with
`arviz.rhat` to rounding.

The chains must be independent of one another. The walkers of one emcee ensemble are not: a chain
here is a whole ensemble.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import fft, special

Array = NDArray[np.float64]


def split(x: ArrayLike) -> Array:
    """Halve every chain, so that drift within a chain counts as disagreement between chains.

    Parameters
    ----------
    x : array_like, shape (..., chain, draw)

    Returns
    -------
    array, shape (..., 2 * chain, draw // 2)
        The middle draw of an odd number is left out.

    Examples
    --------
    >>> split([[1.0, 2.0, 3.0, 4.0, 5.0]]).tolist()
    [[1.0, 2.0], [4.0, 5.0]]
    """
    x = np.asarray(x, dtype=float)
    half = x.shape[-1] // 2
    return np.concatenate([x[..., :half], x[..., -half:]], axis=-2)


def rank_normalise(x: ArrayLike) -> Array:
    """Normal scores of the ranks over chains and draws together; ties share their mean rank.

    Parameters
    ----------
    x : array_like, shape (..., chain, draw)

    Returns
    -------
    array, shape (..., chain, draw)

    Examples
    --------
    >>> rank_normalise([[10.0, 2.0], [3.0, 3.0]]).round(3).tolist()
    [[1.049, -1.049], [0.0, 0.0]]
    """
    x = np.asarray(x, dtype=float)
    rows = x.reshape(-1, x.shape[-2] * x.shape[-1])
    # Mean ranks are whole or half numbers: a table replaces a quantile function per draw.
    scores = _normal_scores(rows.shape[-1])
    out = np.empty_like(rows)
    for row, scored in zip(rows, out, strict=True):  # a row fits the cache, the whole does not
        _, place, ties = np.unique(row, return_inverse=True, return_counts=True)
        scored[:] = scores[2 * np.cumsum(ties) - ties + 1][place]
    return out.reshape(x.shape)


def rhat(x: ArrayLike) -> Array:
    """Rank-normalised split R-hat: the larger of the bulk's and the folded draws'.

    Parameters
    ----------
    x : array_like, shape (..., chain, draw)
        At least two chains of four draws.

    Returns
    -------
    array, shape (...)
        Near 1 where the chains agree in location and, by the folding, in spread. NaN where a
        draw is not finite or where no draw differs from another.

    Raises
    ------
    ValueError
        If there are fewer chains or draws than that.

    Examples
    --------
    >>> x = np.random.default_rng(1).normal(size=(3, 4, 500))   # three posteriors, four chains
    >>> bool(np.all(rhat(x) < 1.01))
    True
    >>> bool(rhat(x[0] * np.array([[1.0], [1.0], [1.0], [2.0]])) > 1.05)   # one chain is wider
    True
    """
    x = np.asarray(x, dtype=float)
    # As in ArviZ: with fewer draws a split chain has no variance to speak of.
    if x.ndim < 2 or x.shape[-2] < 2 or x.shape[-1] < 4:
        raise ValueError(
            f"Draws must have shape (..., chain, draw) with at least 2 chains of 4 draws, got "
            f"{x.shape}; put the draws on the last axis."
        )
    halves = split(x)
    folded = np.abs(halves - np.median(halves, axis=(-2, -1), keepdims=True))
    bulk, tail = (_classic_rhat(rank_normalise(v)) for v in (halves, folded))
    return np.where(np.isfinite(halves).all(axis=(-2, -1)), np.maximum(bulk, tail), np.nan)


def windowed_time(rho: Array, *, window: float = 5.0) -> Array:
    """Integrated time of autocorrelations ``(..., lag)`` with Sokal's automatic window.

    Examples
    --------
    >>> lag = np.arange(200)
    >>> round(float(windowed_time(0.5 ** lag)), 4)     # exactly (1 + 0.5) / (1 - 0.5)
    2.9999
    """
    time = 2.0 * np.cumsum(rho, axis=-1) - 1.0
    enough = np.arange(rho.shape[-1]) >= window * time
    stop = np.where(enough.any(axis=-1), enough.argmax(axis=-1), rho.shape[-1] - 1)
    return np.take_along_axis(time, stop[..., None], axis=-1)[..., 0]


def long_run_variance(x: ArrayLike) -> tuple[Array, Array]:
    """Variance per draw of the mean over chains and draws, and the integrated time behind it.

    The autocovariance is taken about the mean of all chains, so chains that disagree widen it.

    Parameters
    ----------
    x : array_like, shape (..., chain, draw)

    Returns
    -------
    variance, time : arrays, shape (...)
        The squared standard error of the overall mean is ``variance / (chain * draw)``.

    Examples
    --------
    >>> x = np.random.default_rng(1).normal(size=(4, 4000))
    >>> variance, time = long_run_variance(x + 0.5)
    >>> round(float(variance), 1), round(float(time), 1)
    (1.0, 1.0)
    """
    x = np.asarray(x, dtype=float)
    covariance = autocovariance(x, centre=x.mean(axis=(-2, -1), keepdims=True)).mean(axis=-2)
    variance = covariance[..., 0]
    with np.errstate(invalid="ignore", divide="ignore"):
        time = windowed_time(covariance / variance[..., None])
    # A negative estimate is noise in a short run; no run is credited with much more than its size.
    time = np.maximum(time, 1.0 / np.log10(max(x.shape[-1] * x.shape[-2], 10)))
    return variance * time, time


def autocovariance(x: ArrayLike, *, centre: ArrayLike | None = None) -> Array:
    """Autocovariance at every lag along the last axis, by FFT; divided by the number of draws.

    `centre` (default: each chain's own mean) is taken off first. The mean over all chains instead
    lets chains that disagree show as correlation that does not die out.

    Examples
    --------
    >>> autocovariance([1.0, -1.0, 1.0, -1.0]).tolist()
    [1.0, -0.75, 0.5, -0.25]
    """
    values: Array = np.asarray(x, dtype=float)
    about = values.mean(axis=-1, keepdims=True) if centre is None else np.asarray(centre)
    n = values.shape[-1]
    size = fft.next_fast_len(2 * n, real=True)  # zeros keep the ends from meeting
    spectrum = fft.rfft(values - about, n=size, axis=-1)
    power = spectrum.real**2 + spectrum.imag**2
    return np.asarray(fft.irfft(power, n=size, axis=-1)[..., :n] / n)


def _classic_rhat(x: Array) -> Array:
    """Gelman and Rubin's R-hat of ``(..., chain, draw)``."""
    n = x.shape[-1]
    between = n * x.mean(axis=-1).var(axis=-1, ddof=1)
    within = x.var(axis=-1, ddof=1).mean(axis=-1)
    with np.errstate(invalid="ignore", divide="ignore"):
        result: Array = np.sqrt((between / within + n - 1) / n)
    return result


@lru_cache(maxsize=32)
def _normal_scores(count: int) -> Array:
    """Blom's normal score of every whole and half rank up to `count`, indexed by twice the rank."""
    rank = np.arange(2 * count + 1) / 2
    return np.asarray(special.ndtri(np.clip((rank - 0.375) / (count + 0.25), 0.0, 1.0)))
