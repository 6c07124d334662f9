"""Posteriors as ArviZ data, on arviz 0.23 and 1.x alike.

The two differ in what holds the groups (InferenceData there, xarray's DataTree here) and in how
they are handed over; everything else is the same. arviz takes seconds to import, so it is
imported on use.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Variables = Mapping[str, ArrayLike]
Seed = int | np.random.SeedSequence | np.random.Generator


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
) -> Any:
    """Draws as ArviZ data.

    Parameters
    ----------
    posterior, log_likelihood, prior, posterior_predictive : mapping of name to array
        Shape (chain, draw, ...). A chain must be independent of the others: a whole ensemble of
        emcee, not one of its walkers.
    observed_data, constant_data : mapping of name to array
        Any shape.
    coords, dims : mapping, optional
        Labels of the further dimensions, as ArviZ has them.
    attrs : mapping, optional
        Remarks stored with the posterior: text or numbers.

    Returns
    -------
    arviz.InferenceData on arviz 0.23, xarray.DataTree on arviz 1.x
        Both offer ``data["posterior"]`` and ``data.to_netcdf(path)``.

    Raises
    ------
    ValueError
        If there is nothing to convert, or arrays are not (chain, draw, ...) of one size.

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

    Parameters
    ----------
    log_likelihood : array_like, shape (chain, draw, N)

    Returns
    -------
    Loo
        Where `pareto_k` is above 0.7 the estimate is not to be relied on.

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> mean, data = rng.normal(0, 0.1, (4, 500, 1)), rng.normal(size=100)
    >>> loo = pointwise_loo(-0.5 * (data - mean) ** 2 - 0.5 * np.log(2 * np.pi))
    >>> loo.elpd.shape, bool((loo.pareto_k < 0.7).all())
    ((100,), True)
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
