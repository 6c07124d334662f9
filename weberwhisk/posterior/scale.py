"""A common factor of all signals, integrated out under Weber's law: an unknown stiffness.

At a given contact with signals m the reading y says of the factor E, with v = ln E, u = 1/E and S
signals, that ln p(y | E m) = const − S v − ½(A u² − 2B u + C). The numbers A, B and C are all that
it takes of the contact and of the reading; so the mode is found, and the Gauss–Hermite rule about
it summed, without any signals or noise being worked out again. `nuisance` does the same for any
last unknown, at five times the cost.
"""

from __future__ import annotations

import numpy as np
from numpy.polynomial.hermite_e import hermegauss
from scipy.special import ndtr

from ..cues import UnknownStiffness
from ..mechanics.contact import Outcome
from ..observer import Observer
from ..receptors import Weber
from .lattice import Array, Index, OnTiles, Tiled

#: Newton steps from where prior and likelihood, each taken as a Gaussian, meet.
STEPS = 2
#: A density this far (in ln) below the peak's is not summed, and counts as nothing.
NEGLIGIBLE = 30.0


def has_scale(observer: Observer) -> bool:
    """Whether the last unknown is a log-normal factor of all signals, and the noise Weber's law."""
    cue, noise = observer.cue, observer.noise
    if not isinstance(cue, UnknownStiffness) or type(noise) is not Weber:
        return False
    prior = observer.prior["stiffness"]
    family = getattr(getattr(prior, "dist", None), "name", None)
    return cue.is_scale and family == "lognorm" and prior.support()[0] == 0


def without_scale(observer: Observer, reading: Array, top: Array, count: int) -> Tiled:
    """Posteriors of readings (B, S) over all unknowns but the factor, which is the last.

    `top` (B,) is ln of their densities at the peak, and `count` the nodes of the rule. The
    functions are the unknowns, and the mean and the variance of the factor at each node.
    """
    assert isinstance(observer.noise, Weber)
    prior = observer.prior["stiffness"]
    middle, above = np.log(prior.ppf([0.5, ndtr(1.0)]))
    spread, size = above - middle, reading.shape[1]
    k = np.broadcast_to(observer.noise.weber_fraction, size)
    root = observer.noise.root(size)
    t, weight = hermegauss(count)
    weight = weight / np.sqrt(2 * np.pi) / spread

    def tiled(points: Array) -> OnTiles:
        contact, log_prior = observer.contact(points)
        signals, outcome = observer.given(contact)(np.ones(contact.shape[:-1]))
        held = (outcome == Outcome.HELD) & np.all(signals != 0, axis=-1)
        signals = np.where(held[..., None], signals, 1.0)
        unit = k * np.abs(signals)
        # Readings and signals in units of their noise, without correlation.
        per_reading = np.moveaxis(root / unit[..., None, :], (-2, -1), (0, 1))
        own = np.moveaxis(np.sign(signals) / k @ root.T, -1, 0)
        constant = log_prior + np.log(np.diag(root)).sum() - np.log(unit).sum(axis=-1)
        constant -= 0.5 * (size * np.log(2 * np.pi) + np.square(own).sum(axis=0))
        constant = np.where(held, constant, -np.inf)
        places = np.where(held[:, None], np.moveaxis(contact, -1, 1), 0.0)

        def density(row: Index, tile: Index) -> tuple[Array, Array]:
            y, log = reading[row], constant[tile]
            a, b = np.zeros((2, *log.shape))
            for j in range(size):
                felt_j = sum(per_reading[j, i][tile] * y[:, i, None] for i in range(j, size))
                a += felt_j * felt_j
                b += felt_j * own[j][tile]
            v, width = _mode(a, b, size, middle, spread)
            best = log + _log(v, a, b, size, middle, spread)
            live = best > top[row, None] - NEGLIGIBLE
            v, width, a, b, best = v[live], width[live], a[live], b[live], best[live]
            total, first, second = np.zeros((3, v.size))
            factor = np.exp(v)
            for node, w in zip(t, weight, strict=True):
                step = node * width
                # Of the factor over its mode, so that squares do not cancel.
                share = w * np.exp(
                    _log(v + step, a, b, size, middle, spread) - (best - log[live]) + node**2 / 2
                )
                off = factor * np.expm1(step)
                total += share
                first += share * off
                second += share * off * off
            mean = first / total
            out = np.full(log.shape, -np.inf)
            out[live] = best + np.log(total * width)
            columns = np.zeros((len(row), places.shape[1] + 2, log.shape[1]))
            columns[:, :-2] = places[tile]
            columns[:, -2][live] = factor + mean
            columns[:, -1][live] = second / total - mean**2
            return out, columns

        return density

    return tiled


def _log(v: Array, a: Array, b: Array, size: int, middle: float, spread: float) -> Array:
    """ln of the likelihood of v = ln E and of its prior, up to constants."""
    u = np.exp(-v)
    z = (v - middle) / spread
    return np.asarray(u * (b - 0.5 * a * u) - size * v - 0.5 * z * z)


def _mode(a: Array, b: Array, size: int, middle: float, spread: float) -> tuple[Array, Array]:
    """The highest v, and its width."""
    precision = spread**-2
    u = (b + np.sqrt(b * b + 4 * size * a)) / (2 * a)  # the likelihood's own: −S + a u² − b u = 0
    told = a * u * u + size
    v = (middle * precision - told * np.log(u)) / (told + precision)
    for _ in range(STEPS + 1):
        u = np.exp(-v)
        slope = u * (a * u - b) - size - (v - middle) * precision
        bend = np.maximum(u * (2 * a * u - b), 0.0) + precision
        v = v + np.clip(slope / bend, -1.0, 1.0)
    return v, bend**-0.5
