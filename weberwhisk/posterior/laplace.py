"""Laplace's approximation: the Gaussian at the mode, and where that will not do."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.special import ndtri

from ..observer import Observer
from ..receptors import Seed
from .mode import Mode
from .peaks import find_highest, is_divided
from .result import Estimate, Status
from .solution import Array, Solution, contact_slope, is_improbable, is_unidentified

#: Error of mean or sd, over the sd, up to which Laplace's approximation passes.
LAPLACE_MISFIT = 0.25


def laplace(
    observer: Observer, reading: Array, seed: Seed, tolerance: float | None, progress: Any
) -> Solution:
    mode = find_highest(observer, reading)
    contact, _ = observer.contact(mode.x)
    to_contact = contact_slope(observer, mode.x)
    covariance = to_contact @ mode.covariance @ np.swapaxes(to_contact, 1, 2)
    sd = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    mean_error, sd_error, summed = _beside_the_density(observer, reading, mode, sd)
    worst = (np.maximum(mean_error, sd_error) / np.minimum(sd, summed)).max(axis=1)
    improbable = is_improbable(observer, reading, contact)
    status = np.where(improbable, Status.IMPROBABLE_READING, Status.CONVERGED)
    status = np.where(~(worst <= (tolerance or LAPLACE_MISFIT)), Status.NOT_GAUSSIAN, status)
    status = np.where(is_divided(observer, reading), Status.SEVERAL_PEAKS, status)
    status = np.where(is_unidentified(observer, contact), Status.UNIDENTIFIED, status)
    estimates = [
        Estimate(contact[:, i], sd[:, i], mean_error[:, i], sd_error[:, i])
        for i in range(contact.shape[1])
    ]
    log_evidence = mode.log_density + 0.5 * (
        np.linalg.slogdet(mode.covariance)[1] + contact.shape[1] * np.log(2 * np.pi)
    )
    root = np.linalg.cholesky(mode.covariance)

    def quantile_of(p: Array, unknown: int) -> Array:
        spread = np.sqrt(np.diagonal(mode.covariance, axis1=1, axis2=2))
        out = []
        for value in ndtri(p):  # quantiles are carried along each coordinate
            out.append(observer.contact(mode.x + value * spread)[0][:, unknown])
        return np.stack(out, axis=-1)

    def draws_of(count: int, seed: Seed) -> Array:
        z = np.random.default_rng(seed).standard_normal((len(reading), 4 * count, root.shape[1]))
        x = mode.x[:, None] + z @ np.swapaxes(root, 1, 2)
        return observer.contact(x)[0].reshape(len(reading), 4, count, -1)

    return Solution(estimates, status.astype(np.int8), log_evidence, quantile_of, draws_of)


def _beside_the_density(
    observer: Observer, reading: Array, mode: Mode, sd: Array
) -> tuple[Array, Array, Array]:
    """How far mean and sd of the contact are from the Gaussian's, and what the sd is, (B, U) each.

    The density itself is summed over a coarse grid along the axes of the Gaussian. Along each axis
    alone it would miss what bends across them. A Gaussian leaves next to nothing at the grid's
    edge; of what there is as much again is taken to lie beyond, at the least as far off.
    """
    at_mode = observer.contact(mode.x)[0]
    dim = mode.x.shape[1]
    reach = 6.0 if dim == 1 else 4.5
    t = np.linspace(-reach, reach, _NODES.get(dim, 7))
    z = np.stack([a.ravel() for a in np.meshgrid(*[t] * dim, indexing="ij")], axis=-1)
    edge = (np.abs(z) == reach).any(axis=1)
    values, vectors = np.linalg.eigh(mode.covariance)
    root = vectors * np.sqrt(values)[:, None]
    mean, variance = np.empty((2, *at_mode.shape))
    beyond = np.empty((len(reading), 1))
    rows = max(1, _TOGETHER // len(z))
    for start in range(0, len(reading), rows):
        some = slice(start, start + rows)
        x = mode.x[some, None] + z @ np.swapaxes(root[some], 1, 2)
        log, contact = observer.log_density_and_contact(x, reading[some, None])
        weight = np.exp(log - log.max(axis=1, keepdims=True))
        weight /= weight.sum(axis=1, keepdims=True)
        # Where the density is zero there may be no contact.
        contact = np.where(weight[..., None] > 0, contact, 0.0)
        mean[some] = np.einsum("bt,btu->bu", weight, contact)
        off = contact - mean[some, None]
        variance[some] = np.einsum("bt,btu->bu", weight, off * off)
        beyond[some, 0] = weight[:, edge].sum(axis=1)
    summed = np.sqrt(variance)
    return (
        np.abs(mean - at_mode) + reach * beyond * summed,
        np.abs(summed - sd) + reach**2 / 2 * beyond * summed,
        summed,
    )


#: Nodes along each axis, by the number of unknowns, and nodes that are worked on together.
_NODES = {1: 25, 2: 13, 3: 9}
_TOGETHER = 500_000
