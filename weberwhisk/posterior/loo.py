"""Leave-one-out predictive density, by ArviZ's Pareto-smoothed importance sampling."""

from __future__ import annotations

import warnings
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .arviz_io import _arviz, to_arviz

Array = NDArray[np.float64]


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
