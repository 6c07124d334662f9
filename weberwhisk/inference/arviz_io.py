"""What draws are worth, and draws as ArviZ data, on arviz 0.23 and 1.x alike.

The two differ in what holds the groups (InferenceData there, xarray's DataTree here) and in how
they are handed over; everything else is the same. arviz takes seconds to import, so it is
imported on use.

ArviZ computes R-hat for one posterior at a time, in more time than a small posterior takes to
sample. Here R-hat and Monte Carlo errors are batched: arrays of shape ``(..., chain, draw)`` give
results of shape ``(...)``. `rhat` follows Vehtari et al. (2021, Bayesian Analysis 16, 667) and
agrees with `arviz.rhat` to rounding. The chains must be independent of one another. The walkers of
one emcee ensemble are not: a chain here is a whole ensemble.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from enum import IntFlag
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray
from scipy import fft, special

from .._values import Array

if TYPE_CHECKING:
    from xarray import Dataset


class ArvizData(Protocol):
    """What ArviZ takes: its InferenceData on 0.23, xarray's DataTree on 1.x."""

    def __getitem__(self, group: str, /) -> Dataset:
        """A group, such as "posterior"."""

    def to_netcdf(self, filepath: str, /) -> object:
        """Keep all groups in a file."""


Variables = Mapping[str, ArrayLike]


def to_arviz(
    posterior: Variables,
    *,
    log_likelihood: Variables | None = None,
    observed_data: Variables | None = None,
    constant_data: Variables | None = None,
    prior: Variables | None = None,
    posterior_predictive: Variables | None = None,
    coords: Mapping[str, ArrayLike] | None = None,
    dims: Mapping[str, Sequence[str]] | None = None,
    attrs: Mapping[str, Any] | None = None,
) -> ArvizData:
    """Draws as ArviZ data: InferenceData on arviz 0.23, xarray's DataTree on 1.x.

    Sampled groups are arrays (chain, draw, ...) by name, a chain independent of the others: a whole
    ensemble of emcee, not one of its walkers. `coords` and `dims` label further dimensions, as
    ArviZ has them; `attrs` are remarks stored with the posterior. Both kinds offer
    ``data["posterior"]`` and ``data.to_netcdf(path)``.

    Examples
    --------
    >>> draws = np.random.default_rng(1).normal(size=(4, 100))
    >>> data = to_arviz({"r": draws}, observed_data={"moment": 1.0}, attrs={"method": "emcee"})
    >>> dict(data["posterior"]["r"].sizes)
    {'chain': 4, 'draw': 100}
    """
    sampled = {
        "posterior": posterior,
        "log_likelihood": log_likelihood,
        "prior": prior,
        "posterior_predictive": posterior_predictive,
    }
    fixed = {"observed_data": observed_data, "constant_data": constant_data}
    groups = {name: _draws(name, group) for name, group in sampled.items() if group is not None}
    for name, group in fixed.items():
        if group is not None:
            groups[name] = {key: np.asarray(value) for key, value in group.items()}
    named = {name: list(value) for name, value in (dims or {}).items()}
    labels = {name: np.asarray(value) for name, value in (coords or {}).items()}
    arviz = _arviz()
    if "InferenceData" in vars(arviz):  # asking 1.x for the attribute warns
        data = arviz.from_dict(**groups, coords=labels, dims=named)
        data.posterior.attrs.update(attrs or {})
    else:
        data = arviz.from_dict(groups, coords=labels, dims=named)
        data["posterior"].attrs.update(attrs or {})
    return data


def _arviz() -> Any:
    with warnings.catch_warnings():
        # arviz 0.23 announces its successor at every first import.
        warnings.simplefilter("ignore", FutureWarning)
        import arviz
    return arviz


def _draws(name: str, group: Variables) -> dict[str, NDArray[Any]]:
    """Arrays that all start with the same (chain, draw)."""
    arrays = {key: np.asarray(value) for key, value in group.items()}
    if not arrays:
        raise ValueError(f"{name} holds no variable; give at least one, or leave it out.")
    first = next(iter(arrays.values())).shape[:2]
    for key, value in arrays.items():
        if value.ndim < 2 or value.shape[:2] != first:
            raise ValueError(
                f"{name} variable {key!r} must have shape (chain, draw, ...) like the others, got "
                f"{value.shape}; put chains on the first axis and draws on the second."
            )
    return arrays


class Loo(NamedTuple):
    """Log predictive density of each observation left out, and its Pareto k, both (N,)."""

    elpd: Array
    pareto_k: Array


def pointwise_loo(log_likelihood: ArrayLike) -> Loo:
    """Leave each of N independent observations out (Vehtari, Gelman & Gabry 2017).

    Of log-likelihoods (chain, draw, N). Where `pareto_k` is above 0.7 the estimate is not to be
    relied on.
    """
    values = np.asarray(log_likelihood, dtype=float)
    # Where no draw differs, importance sampling has nothing to do, and its diagnostic no meaning.
    varies = np.ptp(values, axis=(0, 1)) > 1e-12
    elpd, pareto_k = values[0, 0].copy(), np.zeros(values.shape[2])
    if varies.any():
        data = to_arviz(
            {"unused": np.zeros(values.shape[:2])},
            log_likelihood={"y": values[..., varies]},
            observed_data={"y": np.zeros(int(varies.sum()))},
        )
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # large Pareto k, which are returned
            found = _arviz().loo(data, pointwise=True, var_name="y")
        pointwise = found["elpd_i"] if hasattr(found, "elpd_i") else found["loo_i"]
        elpd[varies] = np.asarray(pointwise).ravel()
        pareto_k[varies] = np.asarray(found["pareto_k"]).ravel()
    return Loo(elpd, pareto_k)


class Shortfall(IntFlag):
    """Why a posterior's sample is not to be relied on; 0 is converged, reasons add up."""

    RHAT = 1
    SHORT = 2
    IMPRECISE = 4
    STUCK = 8
    ACCEPTANCE = 16

    @property
    def message(self) -> str:
        """The reasons in words.

        Examples
        --------
        >>> Shortfall(12).message
        'Monte Carlo error above the precision asked for; a walker has not moved'
        """
        reasons = {
            Shortfall.RHAT: "independent ensembles disagree (R-hat above 1.01)",
            Shortfall.SHORT: "fewer than 160 autocorrelation times in all ensembles together",
            Shortfall.IMPRECISE: "Monte Carlo error above the precision asked for",
            Shortfall.STUCK: "a walker has not moved",
            Shortfall.ACCEPTANCE: "fewer than 5 % of the proposals are accepted",
        }
        return "; ".join(reasons[flag] for flag in Shortfall if flag & self) or "converged"


def split(x: ArrayLike) -> Array:
    """Chains (..., chain, draw) halved, so that drift within one counts as disagreement."""
    x = np.asarray(x, dtype=float)
    half = x.shape[-1] // 2
    return np.concatenate([x[..., :half], x[..., -half:]], axis=-2)


def rank_normalise(x: ArrayLike) -> Array:
    """Blom's normal scores of the ranks over chains and draws together; ties share their rank."""
    x = np.asarray(x, dtype=float)
    rank = scipy.stats.rankdata(x.reshape(*x.shape[:-2], -1), axis=-1)
    return np.asarray(special.ndtri((rank - 0.375) / (rank.shape[-1] + 0.25))).reshape(x.shape)


def rhat(x: ArrayLike) -> Array:
    """Rank-normalised split R-hat of draws (..., chain, draw): the bulk's or the folded draws'.

    Near 1 where at least two chains of four draws agree in location and, by the folding, in spread.
    NaN where a draw is not finite or where no draw differs from another.

    Examples
    --------
    >>> x = np.random.default_rng(1).normal(size=(3, 4, 500))   # three posteriors, four chains
    >>> bool(np.all(rhat(x) < 1.01))
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
    """Integrated time of autocorrelations (..., lag) with Sokal's automatic window."""
    time = 2.0 * np.cumsum(rho, axis=-1) - 1.0
    enough = np.arange(rho.shape[-1]) >= window * time
    stop = np.where(enough.any(axis=-1), enough.argmax(axis=-1), rho.shape[-1] - 1)
    return np.take_along_axis(time, stop[..., None], axis=-1)[..., 0]


def long_run_variance(x: ArrayLike) -> tuple[Array, Array]:
    """Variance per draw of the mean over draws (..., chain, draw), and the integrated time, (...).

    The autocovariance is taken about the mean of all chains, so chains that disagree widen it. The
    squared standard error of the overall mean is ``variance / (chain * draw)``.

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

    `centre` is taken off first: by default each chain's own mean. The mean over all chains instead
    lets chains that disagree show as correlation that does not die out.
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
