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


def resample(
    points: ArrayLike,
    weights: ArrayLike,
    count: int,
    *,
    seed: Seed,
    edges: ArrayLike | None = None,
) -> Array:
    """Equally weighted draws from weighted nodes, by systematic resampling.

    A node of weight w comes out w·count times, rounded up or down, in the order of the nodes:
    shuffle them before they are cut into chains.

    Parameters
    ----------
    points : array_like, shape (N, D)
    weights : array_like, shape (N,)
        Not negative; their sum does not matter.
    count : int
    seed : int, SeedSequence or Generator
    edges : array_like, shape (D, D), optional
        The steps between neighbouring nodes as columns (`grid.Nodes.edges`). With it every draw
        is moved to a random place of its node's cell, and all are drawn together about their
        mean so that the covariance of the nodes, not that of the cells' boxes, remains.

    Returns
    -------
    array, shape (count, D)

    Raises
    ------
    ValueError
        If weights are negative or not finite, or there is no weight or no count at all.

    Examples
    --------
    >>> draws = resample([[0.0], [1.0], [2.0]], [0.25, 0.5, 0.25], 8, seed=1)
    >>> draws.ravel().tolist()
    [0.0, 0.0, 1.0, 1.0, 1.0, 1.0, 2.0, 2.0]
    """
    x, mass = np.asarray(points, dtype=float), np.asarray(weights, dtype=float)
    if mass.shape != x.shape[:1] or x.ndim != 2:
        raise ValueError(
            f"points and weights must have shapes (N, D) and (N,), got {x.shape} and {mass.shape}; "
            "give one weight for each point."
        )
    bad = mass[~(np.isfinite(mass) & (mass >= 0))]
    if bad.size or not mass.sum() > 0:
        raise ValueError(
            f"weights must be finite, not negative and not all zero, got "
            f"{bad[0] if bad.size else 0.0}; a posterior whose status is EMPTY has no draws."
        )
    if count < 1:
        raise ValueError(f"count must be at least 1, got {count}; ask for one draw or more.")
    rng = np.random.default_rng(seed)
    share = np.cumsum(mass)
    at = (rng.random() + np.arange(count)) / count * share[-1]
    chosen = np.minimum(np.searchsorted(share, at, side="right"), np.flatnonzero(mass)[-1])
    draws = x[chosen]
    if edges is None:
        return draws
    step = np.asarray(edges, dtype=float)
    mean = mass @ x / share[-1]
    off = x - mean
    covariance = (mass[:, None] * off).T @ off / share[-1]
    boxes = covariance + step @ step.T / 12.0  # a uniform of width h has variance h²/12
    # In coordinates where draws with their boxes have covariance I, the nodes' own is less:
    # its square root draws them in.
    root = np.linalg.cholesky(boxes)
    inside = np.linalg.inv(root)
    values, vectors = np.linalg.eigh(inside @ covariance @ inside.T)
    draw_in = root @ (vectors * np.sqrt(np.clip(values, 0.0, 1.0))) @ vectors.T @ inside
    moved = draws + (rng.random(draws.shape) - 0.5) @ step.T
    return np.asarray(mean + (moved - mean) @ draw_in.T)


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
