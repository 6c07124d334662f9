"""One posterior for the rows of a touch: one distance and one stiffness, an angle a row."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.interpolate import make_interp_spline

from ..coordinates import constrain_distance
from .lattice import Array, Cloud, Lattice, Readings, quantiles

#: Steps of the distance within the range that every row allows, and of the stiffness.
_DISTANCES, _STIFFNESSES = 401, 25
#: How far up to the fold the angles of a touch may go, and the integrals of exp(−(share/span)⁴).
_SPANS = np.array([0.05, 0.1, 0.2, 0.35, 0.55, 0.8, 1.2])
_NORMS = np.exp(-(((np.arange(2000)[:, None] + 0.5) / 2000 / _SPANS) ** 4)).mean(axis=0)


class LocatedTouch(NamedTuple):
    """Posterior of the distance of a touch: mean, sd and interval, m; whether rows agree."""

    mean: float
    sd: float
    ends: Array
    agree: bool


def touch_posterior(
    lattice: Lattice, clouds: Sequence[Cloud], readings: Readings, mass: float
) -> LocatedTouch:
    """The posterior of n rows (n, S), each with the cells from which it may come.

    p(r, E | rows) ∝ p(r) p(E) ∏ᵢ ∫ p(yᵢ | r, θᵢ, E) p(θᵢ | r) dθᵢ. The product of the rows' own
    posteriors of r would count prior and unknown stiffness once a row, and be far too sure. How far
    the angles go is unknown as well, and shared: with angles flat up to the fold, touches of small
    angles had errors of 1.4 sd.
    """
    nothing = LocatedTouch(np.nan, np.nan, np.full(2, np.nan), False)
    layers = [cloud.layers for cloud in clouds]
    low, high = max(x[0] for _, x in layers), min(x[-1] for _, x in layers)
    if not low < high or min(len(x) for _, x in layers) < 4:
        return nothing
    log_e: Array | None = None
    if lattice.soft is not None:
        log_e = lattice.log_median + lattice.log_sd * np.linspace(-4, 4, _STIFFNESSES)
    for last in (False, False, True):
        x, density = _density(lattice, clouds, readings, low, high, log_e)
        if last or not np.isfinite(density).any():
            break
        near = density > density.max() - 20.0
        if log_e is not None:
            few = np.flatnonzero(near.any(axis=0))
            least, most = log_e[max(few[0] - 1, 0)], log_e[min(few[-1] + 1, len(log_e) - 1)]
            log_e = np.linspace(least, most, _STIFFNESSES)
        # Distance shifts with stiffness: a range is narrowed when the stiffness has been.
        if log_e is None or len(few) > _STIFFNESSES / 4:
            across = x[near.any(axis=1)]
            low, high = max(low, across[0] - x[1] + x[0]), min(high, across[-1] + x[1] - x[0])
    if not np.isfinite(density).any():
        return nothing
    weight = np.exp(density - density.max()).sum(axis=1)
    weight /= weight.sum()
    r = lattice.distances(x)
    mean = weight @ r
    tails = np.array([(1 - mass) / 2, (1 + mass) / 2])
    ends = lattice.distances(quantiles(weight[None], x, tails)[0])
    return LocatedTouch(float(mean), float(np.sqrt(weight @ (r - mean) ** 2)), ends, True)


def _density(
    lattice: Lattice,
    clouds: Sequence[Cloud],
    readings: Readings,
    low: float,
    high: float,
    log_e: Array | None,
) -> tuple[Array, Array]:
    """Coordinates x (J,) between two of them, and ln of the density (J, E) there."""
    x = np.linspace(low, high, _DISTANCES)
    _, log_slope = constrain_distance(x)
    observer = lattice.observer
    with np.errstate(divide="ignore"):
        prior = np.log(observer.distance_prior(lattice.distances(x))) + log_slope
    out = np.repeat(prior[:, None], 1 if log_e is None else len(log_e), axis=1)
    if log_e is not None:
        out += lattice.log_prior_of_stiffness(log_e)
    out = out[..., None]
    angles_open = observer.bounded > 1 and "deflection_angle" not in observer.prior
    for i, cloud in enumerate(clouds):
        row, cells = readings.take([i]), cloud.cells
        if log_e is None:
            log = lattice.evidence(row, cells.signals).T
        else:
            scaled = lattice.scaled(cells.signals[:, None], log_e)
            log = lattice.log_likelihood(row, scaled[None])[0]
        log = log + cells.log_prior[:, None] + np.log(cloud.step[1:]).sum()
        first, own = cloud.layers
        top = np.maximum(log.max(axis=0), -1e300)
        weight = np.exp(log - top)[..., None]
        if angles_open:
            low_angle, width = observer.angle_range(cells.contact[:, 0])
            share = (cells.contact[:, 1] - low_angle) / width
            weight = weight * np.exp(-((share[:, None] / _SPANS) ** 4) - np.log(_NORMS))[:, None]
        with np.errstate(divide="ignore"):
            log = np.log(np.add.reduceat(weight, first, axis=0))
        log = np.maximum(log, -200.0) + top[:, None]
        out = out + make_interp_spline(own, log, 3)(x) - prior[:, None, None]
    top = out.max(axis=-1)
    return x, top + np.log(np.exp(out - top[..., None]).mean(axis=-1))
