"""Sums over the cells of a lattice: the posterior of a row, and of the rows of a touch."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.sparse import csc_matrix
from scipy.special import ndtri

from .._values import Array, Flags, Index
from ..inference.coordinates import constrain_distance
from ..inference.observer import Observer
from .lattice import Lattice, LatticeCells, Readings


def log_prior_of_distance(observer: Observer, x: Array) -> Array:
    """ln of the prior density of the distance in coordinates x."""
    with np.errstate(divide="ignore"):
        prior = np.log(observer.distance_prior(observer.space.distance(x)))
    return np.asarray(prior + constrain_distance(x)[1])


def alike(lattice: Lattice, readings: Readings, most: int = 64) -> list[Index]:
    """Rows in groups of `most`: every signal within one sd of that of the first of its group.

    Where they have measurement errors of their own, in units in which the first one's are
    independent and 1, and these must be alike too.
    """
    value, own = readings.value, lattice.covariance(readings, readings.value)
    inverse = np.linalg.inv(np.linalg.cholesky(own))
    far = 1.01 * np.sqrt(lattice.size * own[:, -1, -1])
    left, groups = np.lexsort(value.T), []
    while left.size:
        first = left[0]
        end = np.searchsorted(value[left, -1], value[first, -1] + far[first], side="right")
        some = left[:end]
        z = (value[some] - value[first]) @ inverse[first].T
        near = (np.abs(z) <= 1).all(axis=1)
        if readings.covariance is not None:
            errors = inverse[first] @ readings.covariance[some] @ inverse[first].T
            near &= (np.abs(errors - errors[0]) < 0.25).all(axis=(1, 2))
        near[np.flatnonzero(near)[most:]] = False
        groups.append(some[near])
        left = np.delete(left, np.flatnonzero(near))
    return groups


class Summary(NamedTuple):
    """Of each of n posteriors: mean and sd (n, U), ends of the interval (n, 2).

    And how many sds the best cell's signals are off, whether the sums are reliable, and between
    which coordinates of the distance (n, 2) there is any density.
    """

    mean: Array
    sd: Array
    ends: Array
    off: Array
    precise: Flags
    between: Array


def summarise(
    lattice: Lattice, found: LatticeCells, groups: Sequence[Index], readings: Readings, mass: float
) -> Summary:
    """Sums over the cells of each row, for all rows of its group, group after group."""
    sizes = np.array([len(groups[i]) for i in found.rows])
    ends = np.append(found.first[1:], len(found.owner))
    rows, cell, log = np.concatenate([groups[i] for i in found.rows]), slice(None), found.log
    counts = np.repeat(ends - found.first, sizes)
    if len(rows) > len(sizes):
        begin = np.repeat(found.first, sizes)
        first = np.cumsum(counts) - counts
        cell = np.arange(counts.sum()) + np.repeat(begin - first, counts)
        owner = np.repeat(np.arange(len(rows)), counts)
        log = lattice.evidence(readings, rows[owner], found.signals[cell]) + found.log_prior[cell]
    else:
        first, owner = found.first, found.owner
    log = log + np.log(found.step).sum()

    def total(values: Array) -> Array:
        return np.add.reduceat(values, first, axis=0)

    top = np.maximum.reduceat(log, first)
    weight = np.exp(log - top[owner])
    weight /= total(weight)[owner]
    contact, layer = found.contact[cell], found.layer[cell]
    mean = np.stack([total(weight * c) for c in contact.T], axis=1)
    square = [total(weight * (c - m[owner]) ** 2) for c, m in zip(contact.T, mean.T, strict=True)]
    low = np.minimum.reduceat(layer, first)
    layers = int((layer - low[owner]).max()) + 1
    share = np.bincount(owner * layers + layer - low[owner], weight, len(rows) * layers)
    tails = np.array([(1 - mass) / 2, (1 + mass) / 2])
    places = low[:, None] + 0.5 + quantiles(np.asarray(share.reshape(-1, layers)), tails)
    best = np.flatnonzero(log == top[owner])
    best = best[np.unique(owner[best], return_index=True)[1]]
    own, signals = readings.take(rows), found.signals[cell][best]
    if lattice.soft is not None:
        signals = lattice.scaled(signals, lattice.match(own, signals)[0])
    sd = np.sqrt(np.diagonal(lattice.covariance(own, signals), axis1=1, axis2=2))
    high = np.maximum.reduceat(layer, first)
    r = lattice.observer.space.distance(places * found.step[0])
    return Summary(
        mean, np.sqrt(np.stack(square, axis=1)), r,
        (np.abs(own.value - signals) / sd).max(axis=1),
        (np.maximum.reduceat(weight, first) < 0.8) & np.repeat(found.precise, sizes),
        (np.stack([low, high], axis=1) + 0.5) * found.step[0],
    )  # fmt: skip


def quantiles(share: Array, probability: Array) -> Array:
    """Quantiles (n, Q) of masses (n, J) on evenly spaced layers, in steps from the first.

    Straight between the layers' edges in the probit of the probability: exact for a Gaussian.
    """
    edges = np.arange(share.shape[1] + 1) - 0.5
    # From values at the middle to integrals over layers.
    bend = np.diff(np.pad(share, ((0, 0), (1, 1))), 2, axis=1)
    rise = np.cumsum(np.maximum(share + bend / 24, 0.0), axis=1)
    rise = np.concatenate([np.zeros((len(rise), 1)), rise / rise[:, -1:]], axis=1)
    z, wanted = ndtri(np.clip(rise, 1e-12, 1 - 1e-12)), ndtri(probability)
    new = np.diff(z, prepend=-np.inf, axis=1) > 1e-9
    return np.stack(
        [np.interp(wanted, row[keep], edges[keep]) for row, keep in zip(z, new, strict=True)]
    )


#: How far up to the fold the angles of a touch may go: shares have the density exp(−(share/span)⁴).
_SPANS = np.array([0.05, 0.1, 0.2, 0.35, 0.55, 0.8, 1.2])
_NORMS = np.exp(-(((np.arange(2000)[:, None] + 0.5) / 2000 / _SPANS) ** 4)).mean(axis=0)


class LocatedTouch(NamedTuple):
    """Posterior of the distance of a touch: mean, sd and interval, m; whether rows agree."""

    mean: float
    sd: float
    ends: Array
    agree: bool


def touch_posterior(
    sides: Sequence[tuple[Lattice, Readings]], between: tuple[float, float], mass: float
) -> LocatedTouch:
    """The posterior of rows (n, S) of one or both sides, `between` coordinates none excludes.

    p(r, E | rows) ∝ p(r) p(E) ∏ᵢ ∫ p(yᵢ | r, θᵢ, E) p(θᵢ | r) dθᵢ. The product of the rows' own
    posteriors of r would count prior and unknown stiffness once a row, and be far too sure. How far
    the angles go is unknown as well, and shared: with angles flat up to the fold, touches of small
    angles had errors of 1.4 sd.

    The logarithm of each row's integral is smooth where their product is sharp: it is had once on
    coarse nodes, and the sum over rows is interpolated where the product is.
    """
    nothing = LocatedTouch(np.nan, np.nan, np.full(2, np.nan), False)
    low, high = between
    every = [
        (one, readings, found) for one, readings in sides
        for found in one.search(readings, np.full(len(readings.value), 23.0), between)
    ]  # fmt: skip
    if sum(len(f.rows) for _, _, f in every) < sum(len(own.value) for _, own in sides):
        return nothing
    for _, _, found in every:  # where every row has density
        least, most = (f.reduceat(found.layer, found.first) for f in (np.minimum, np.maximum))
        low = max(low, float(least.max() + 0.5) * found.step[0])
        high = min(high, float(most.min() + 0.5) * found.step[0])
    if not low < high:
        return nothing
    lattice, size = sides[0][0], sides[0][0].size
    x = np.linspace(low, high, 8 + int((high - low) / min(f.step[0] for _, _, f in every)))
    # A row's stiffness at a distance is known to some 2 k: with twice these steps, 0.15 sd off.
    widest = 1.2 * max(lattice.observer.noise.weber_fractions(size))
    log_e = np.zeros(1)
    if lattice.soft is not None:
        steps = int(np.ceil(8 * lattice.log_sd / np.clip(widest, 0.02, 0.14)))
        log_e = lattice.log_median + lattice.log_sd * np.linspace(-4, 4, steps + 1)
    # ln of the rows' product for each span of the angles, (J, E, spans).
    total = np.zeros((len(x), len(log_e), len(_SPANS)))
    for one, readings, found in every:
        for i in range(len(found.rows)):
            row = _row(one, found, i, readings, x, log_e)
            if row is None:
                return nothing
            total += row
    # Each row had the prior once.
    prior = np.maximum(log_prior_of_distance(lattice.observer, x), -100.0)[:, None, None]
    total -= sum(len(f.rows) for _, _, f in every) * prior
    ends = [(low, high), (log_e[0], log_e[-1])]
    for fine in ((61, 31), (161, 41)):
        axes = [np.linspace(*end, n) for end, n in zip(ends, fine, strict=True)]
        x_fine, e_fine = axes[0], axes[1] if len(log_e) > 1 else log_e
        density = make_interp_spline(x, total, 3)(x_fine)
        if len(log_e) > 1:
            density = make_interp_spline(log_e, density, 3, axis=1)(e_fine)
        density += log_prior_of_distance(lattice.observer, x_fine)[:, None, None]
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
    r = lattice.observer.space.distance(x_fine)
    mean, tails = weight @ r, np.array([(1 - mass) / 2, (1 + mass) / 2])
    place = quantiles(weight[None], tails)[0]
    interval = lattice.observer.space.distance(x_fine[0] + place * (x_fine[1] - x_fine[0]))
    return LocatedTouch(float(mean), float(np.sqrt(weight @ (r - mean) ** 2)), interval, True)


def _row(
    lattice: Lattice, found: LatticeCells, i: int, readings: Readings, x: Array, log_e: Array
) -> Array | None:
    """ln p(r) ∫ p(y | r, θ, E) p(θ | r, span) dθ of the ith of the rows found, (J, E, spans)."""
    own = slice(found.first[i], found.first[i + 1] if i + 1 < len(found.first) else None)
    row, signals, contact = readings.take([found.rows[i]]), found.signals[own], found.contact[own]
    layer = found.layer[own] - found.layer[own].min()
    many, layers = len(log_e), int(layer.max()) + 1
    if layers < 4:
        return None
    # Cells by layer, the logarithm at each stiffness, −∞ where that is beyond 8 sds of the best.
    noise = lattice.observer.noise
    if lattice.soft is None:
        log = (found.log[own] - found.log_prior[own])[:, None]
    elif row.covariance is None and noise.is_scale_family and lattice.soft.all():
        # Signals that are stiffer are readings that are less, by a product of matrices.
        less = row.value * np.exp(-log_e)[:, None]
        log = noise.log_likelihoods(less, signals).T - lattice.size * log_e
    else:
        middle, sd = lattice.match(row, signals)
        cell, at_e = np.nonzero(np.abs(log_e - middle[:, None]) < 8 * sd[:, None])
        scaled = lattice.scaled(signals[cell], log_e[at_e])
        log = np.full((len(layer), many), -np.inf)
        log[cell, at_e] = lattice.log_likelihood(row, scaled[None])[0]
    log += found.log_prior[own][:, None]
    top = log.max()
    own_x = (found.layer[own].min() + 0.5 + np.arange(layers)) * found.step[0]
    share = np.zeros(len(layer))  # how far up to the fold the angles go, 0 where a prior says
    observer = lattice.observer
    if observer.bounded > 1 and "deflection_angle" not in observer.prior:
        least, width = observer.angle_range(observer.space.distance(own_x))
        share = (contact[:, 1] - least) / width[layer]
    within = np.exp(-((share[:, None] / _SPANS) ** 4)) / _NORMS
    places = np.arange(len(_SPANS)) * layers + layer[:, None]
    table = csc_matrix(
        (within.ravel(), places.ravel(), np.arange(0, within.size + 1, len(_SPANS))),
        (len(_SPANS) * layers, len(layer)),
    )
    mass = (table @ np.exp(log - top)).reshape(len(_SPANS), layers, many)
    log = np.log(np.maximum(mass, 1e-26)) + top
    return np.asarray(make_interp_spline(own_x, np.moveaxis(log, 0, -1), 3)(x))
