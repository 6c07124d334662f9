"""Sums over the cells of a lattice: the posterior of a row, and of the rows of a touch."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline
from scipy.special import ndtri

from .lattice import Array, Cloud, Readings, distances, log_prior_of_distance


class Summary(NamedTuple):
    """Of each of n posteriors: mean and sd (n, U), ends of the interval (n, 2).

    And how many sds the best cell's signals are off, and whether the sums are reliable.
    """

    mean: Array
    sd: Array
    ends: Array
    off: Array
    precise: NDArray[np.bool_]


def summarise(cloud: Cloud, readings: Readings, mass: float) -> Summary:
    """Sums over the cells for each of some alike readings."""
    lattice, cells = cloud.lattice, cloud.cells
    log = lattice.evidence(readings, cells.signals)
    log += cells.log_prior + np.log(cloud.step).sum()
    top, best = log.max(axis=1, keepdims=True), log.argmax(axis=1)
    weight = np.exp(log - top)
    total = weight.sum(axis=1, keepdims=True)
    weight /= total
    mean = weight @ cells.contact
    middle = mean.mean(axis=0)  # off it, squares lose no digits
    square = weight @ (cells.contact - middle) ** 2 - (mean - middle) ** 2
    share = np.add.reduceat(weight, cloud.first, axis=1)
    tails = np.array([(1 - mass) / 2, (1 + mass) / 2])
    signals = cells.signals[best]
    if lattice.soft is not None:
        rows = range(len(best))
        log_e = [lattice.match(readings.take([i]), signals[[i]])[0][0, 0] for i in rows]
        signals = lattice.scaled(signals, np.array(log_e))
    off = np.abs(readings.value - signals) / np.sqrt(lattice.variance(readings, signals))
    ends = distances(lattice.observer, quantiles(share, cloud.layers, tails))
    return Summary(
        mean, np.sqrt(np.maximum(square, 0)), ends,
        off.max(axis=1),
        (weight.max(axis=1) < 0.8) & cloud.precise,
    )  # fmt: skip


def quantiles(share: Array, x: Array, probability: Array) -> Array:
    """Quantiles (n, Q) of masses (n, J) on layers at evenly spaced coordinates x (J,).

    Straight between the layers' edges in the probit of the probability: exact for a Gaussian.
    """
    step = x[1] - x[0] if len(x) > 1 else 1e-3
    edges = np.append(x - step / 2, x[-1] + step / 2)
    # From values at the middle to integrals over layers.
    bend = np.diff(np.pad(share, ((0, 0), (1, 1))), 2, axis=1)
    rise = np.cumsum(np.maximum(share + bend / 24, 0.0), axis=1)
    rise = np.concatenate([np.zeros((len(rise), 1)), rise / rise[:, -1:]], axis=1)
    z = ndtri(np.clip(rise, 1e-12, 1 - 1e-12))
    out = np.empty((len(share), len(probability)))
    for i, row in enumerate(z):
        keep = np.flatnonzero(np.diff(row, prepend=-np.inf) > 1e-9)
        out[i] = np.interp(ndtri(probability), row[keep], edges[keep])
    return out


#: How far up to the fold the angles of a touch may go: shares have the density exp(−(share/span)⁴).
_SPANS = np.array([0.05, 0.1, 0.2, 0.35, 0.55, 0.8, 1.2])


class LocatedTouch(NamedTuple):
    """Posterior of the distance of a touch: mean, sd and interval, m; whether rows agree."""

    mean: float
    sd: float
    ends: Array
    agree: bool


def touch_posterior(clouds: Sequence[Cloud], readings: Readings, mass: float) -> LocatedTouch:
    """The posterior of n rows (n, S), each with the cells from which it may come.

    p(r, E | rows) ∝ p(r) p(E) ∏ᵢ ∫ p(yᵢ | r, θᵢ, E) p(θᵢ | r) dθᵢ. The product of the rows' own
    posteriors of r would count prior and unknown stiffness once a row, and be far too sure. How far
    the angles go is unknown as well, and shared: with angles flat up to the fold, touches of small
    angles had errors of 1.4 sd.

    The logarithm of each row's integral is smooth where their product is sharp: it is had once on
    coarse nodes, and the sum over rows is interpolated where the product is.
    """
    lattice = clouds[0].lattice
    if len({cloud.lattice.observer.reach for cloud in clouds}) > 1:
        raise ValueError(
            "A touch has rows from both sides of a curved whisker, which reach differently far at "
            "the cue's angle; give the rows of each side a touch of their own."
        )
    nothing = LocatedTouch(np.nan, np.nan, np.full(2, np.nan), False)
    low, high = (f([cloud.layers[i] for cloud in clouds]) for f, i in ((max, 0), (min, -1)))
    if not low < high or min(len(cloud.layers) for cloud in clouds) < 4:
        return nothing
    finest = min(cloud.step[0] for cloud in clouds)
    x = np.linspace(low, high, 8 + int((high - low) / finest))
    # A row's stiffness at a distance is known to some 2 k: with twice these steps, 0.15 sd off.
    widest = 1.2 * max(lattice.observer.noise.weber_fractions(readings.value.shape[1]))
    log_e = np.zeros(1)
    if lattice.soft is not None:
        steps = int(np.ceil(8 * lattice.log_sd / np.clip(widest, 0.02, 0.14)))
        log_e = lattice.log_median + lattice.log_sd * np.linspace(-4, 4, steps + 1)
    # ln of the rows' product for each span of the angles, (J, E, spans).
    every = [_row(c, readings.take([i]), x, log_e) for i, c in enumerate(clouds)]
    total = np.sum(every, axis=0)
    ends = [(low, high), (log_e[0], log_e[-1])]
    for fine in ((101, 51), (401, 101)):
        axes = [np.linspace(*end, n) for end, n in zip(ends, fine, strict=True)]
        x_fine, e_fine = axes[0], axes[1] if len(log_e) > 1 else log_e
        found = make_interp_spline(x, total, 3)(x_fine)
        if len(log_e) > 1:
            found = make_interp_spline(log_e, found, 3, axis=1)(e_fine)
        density = found + log_prior_of_distance(lattice.observer, x_fine)[:, None, None]
        if lattice.soft is not None:
            density += lattice.log_prior_of_stiffness(e_fine)[:, None]
        if not np.isfinite(density).any():
            return nothing
        near = (density > density.max() - 20.0).any(axis=2)
        ends = [
            (axis[max(at[0] - 1, 0)], axis[min(at[-1] + 1, len(axis) - 1)])
            for axis, at in ((axes[0], np.flatnonzero(near.any(axis=1))),
                             (e_fine, np.flatnonzero(near.any(axis=0))))
        ]  # fmt: skip
    weight = np.exp(density - density.max()).sum(axis=(1, 2))
    weight /= weight.sum()
    r = distances(lattice.observer, x_fine)
    mean, tails = weight @ r, np.array([(1 - mass) / 2, (1 + mass) / 2])
    interval = distances(lattice.observer, quantiles(weight[None], x_fine, tails)[0])
    return LocatedTouch(float(mean), float(np.sqrt(weight @ (r - mean) ** 2)), interval, True)


def _row(cloud: Cloud, row: Readings, x: Array, log_e: Array) -> Array:
    """ln ∫ p(y | r, θ, E) p(θ | r, span) dθ of a row, (J, E, spans)."""
    lattice, cells, own, many = cloud.lattice, cloud.cells, cloud.layers, len(log_e)
    if many == 1:
        cell, at_e = np.arange(len(cells.contact)), np.zeros(1, dtype=np.intp)
        log = lattice.evidence(row, cells.signals)[0]
    else:
        middle, sd = lattice.match(row, cells.signals)
        cell, at_e = np.nonzero(np.abs(log_e - middle[0][:, None]) < 8 * sd[0][:, None])
        scaled = lattice.scaled(cells.signals[cell], log_e[at_e])
        log = lattice.log_likelihood(row, scaled[None])[0]
    log = log + cells.log_prior[cell]
    top = log.max()
    layer = np.repeat(np.arange(len(own)), np.diff(cloud.first, append=len(cells.contact)))
    at, weight = layer[cell] * many + at_e, np.exp(log - top)
    norms = np.exp(-(((np.arange(2000) + 0.5) / 2000 / _SPANS[:, None]) ** 4)).mean(axis=1)
    within = np.exp(-((cloud.share / _SPANS[:, None]) ** 4)) / norms[:, None]
    mass = [np.bincount(at, weight * one[cell], len(own) * many) for one in within]
    log = np.log(np.maximum(mass, 1e-26)).reshape(len(_SPANS), len(own), many) + top
    log -= np.maximum(cloud.log_prior, -100.0)[:, None]
    return np.asarray(make_interp_spline(own, np.moveaxis(log, 0, -1), 3)(x))
