"""ArviZ's data and diagnostics, on arviz 0.23 and 1.x alike.

The two differ in what holds the groups (InferenceData there, xarray's DataTree here) and in how
they are handed over; everything else is the same. arviz takes seconds to import, so it is
imported on use.

ArviZ's diagnostics take a posterior at a time: an error 0.1 to 0.6 ms and R-hat 0.5 to 3 ms, where
a posterior takes emcee 20 ms and more. The chains must be independent of one another. The walkers
of one emcee ensemble are not: a chain here is a whole ensemble.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .values import Array

if TYPE_CHECKING:
    from xarray import Dataset

__all__ = ["ArvizData", "mcse", "pointwise_loo", "rhat", "to_arviz"]


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


def rhat(draws: Array) -> Array:
    """ArviZ's rank-normalised split R-hat of draws (..., chain, draw), in shape (...)."""
    return _each("rhat", draws)


def mcse(draws: Array) -> Array:
    """ArviZ's Monte Carlo error of the mean of draws (..., chain, draw), in shape (...)."""
    return _each("mcse", draws, method="mean")


def _each(name: str, draws: Array, **options: str) -> Array:
    function = getattr(_arviz(), name)
    with np.errstate(invalid="ignore", divide="ignore"):  # NaN where no draw differs from another
        flat = [float(function(x, **options)) for x in draws.reshape(-1, *draws.shape[-2:])]
    return np.reshape(np.array(flat), draws.shape[:-2])
