"""Laplace's approximation: the Gaussian at the mode, and where that will not do."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.special import ndtri

from ..observer import Observer
from ..receptors import Seed
from .mode import Mode, find_mode
from .peaks import is_divided
from .result import Estimate, Status
from .solution import Array, Solution, contact_slope, is_unidentified

#: Error of mean or sd, over the sd, up to which Laplace's approximation passes.
LAPLACE_MISFIT = 0.25


def laplace(
    observer: Observer, reading: Array, seed: Seed, tolerance: float | None, progress: Any
) -> Solution:
    mode = find_mode(observer, reading)
    contact, _ = observer.contact(mode.x)
    to_contact = contact_slope(observer, mode.x)
    covariance = to_contact @ mode.covariance @ np.swapaxes(to_contact, 1, 2)
    sd = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    mean_error, sd_error = _along_axes(observer, reading, mode, to_contact, sd)
    worst = (np.maximum(mean_error, sd_error) / sd).max(axis=1)
    status = np.where(worst > (tolerance or LAPLACE_MISFIT), Status.NOT_GAUSSIAN, Status.CONVERGED)
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


def _along_axes(
    observer: Observer, reading: Array, mode: Mode, to_contact: Array, sd: Array
) -> tuple[Array, Array]:
    """How far mean and sd of the contact are from the Gaussian's, (B, U) each.

    Along each axis of the Gaussian the density itself is summed, out to six sd.
    """
    at_mode = observer.contact(mode.x)[0]
    values, vectors = np.linalg.eigh(mode.covariance)
    t = np.linspace(-6, 6, 25)
    mean_error, variance_error = np.zeros((2, *at_mode.shape))
    for axis in range(mode.x.shape[1]):
        reach = np.sqrt(values[:, axis, None]) * vectors[:, :, axis]
        x = mode.x[:, None] + t[:, None] * reach[:, None]
        log = observer.log_density(x, reading[:, None]) - mode.log_density[:, None]
        weight = np.exp(log - log.max(axis=1, keepdims=True))
        weight /= weight.sum(axis=1, keepdims=True)
        contact = observer.contact(x)[0]
        mean = np.einsum("bt,btu->bu", weight, contact)
        variance = np.einsum("bt,btu->bu", weight, (contact - mean[:, None]) ** 2)
        claimed = np.einsum("bue,be->bu", to_contact, reach) ** 2
        mean_error += np.abs(mean - at_mode)
        variance_error += variance - claimed
    return mean_error, np.abs(np.sqrt(np.maximum(sd**2 + variance_error, 0.0)) - sd)
