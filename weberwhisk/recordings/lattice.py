"""A lattice of contacts, and the densities of many readings summed over it.

A film has thousands of readings by one whisker under the same noise: their posteriors are sums over
one lattice of contacts, even in the observer's coordinates, whose signals are solved once. Contacts
stand in blocks; only those blocks are summed for a reading whose signals it may be of. An even
lattice is as good as its halves agree, which `LatticeSums.error` says.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.special import gamma, gammainc

from .._util.values import Array, Flags, Index
from .._util.weights import half_error
from ..inference import Observer
from ..inference.coordinates import unconstrain_angle, unconstrain_distance
from ..inference.weighted import Cumulative
from ..mechanics.contact import Outcome
from ..receptors import GeneralisedWeber, ReceptorNoise, Weber

__all__ = ["Densities", "Lattice", "LatticeSums", "serves", "step_of"]

#: Contacts along either side of a block.
SIDE = 8
#: Most sds between a reading and the signals of a contact that is summed: of single readings, and
#: of those that are multiplied, where tails meet.
ALONE, TOGETHER = 6.0, 8.0
#: The step of the lattice for the smallest Weber fraction, as a share of it (at 0.35 the means of
#: all but one in a hundred posteriors of curved whiskers are good to 2e-3 sd, at 0.7 of one in
#: two), and its bounds. With less than the least Weber fraction no lattice serves.
SHARE, FINEST, WIDEST, LEAST = 0.35, 0.02, 0.07, 0.03
#: Fractions of distance and angle at which a lattice ends.
ENDS = np.array([1e-5, 1 - 1e-6])
#: Points between layers at which densities of distance are interpolated.
PARTS = 4


def step_of(noise: ReceptorNoise, size: int) -> float:
    """The step of a lattice for noise of so many signals."""
    fractions = noise.weber_fractions(size)
    least = float(np.min(fractions, where=fractions > 0, initial=1.0))
    return float(np.clip(SHARE * least, FINEST, WIDEST))


@dataclass(frozen=True, eq=False)
class LatticeSums:
    """Posteriors of n readings given the noise and the whisker of a lattice.

    Attributes
    ----------
    layers : array, shape (n, L)
        ln of the joint density of reading and distance at each layer, −inf where there is none.
    log_evidence, error, misfit : array, shape (n,)
        `error` of mean and sd of the distance, in sds; `misfit` is the largest deviation of a
        signal at the most probable contact, in sds.
    mean, sd : array, shape (n, U)
    """

    layers: Array
    log_evidence: Array
    error: Array
    misfit: Array
    mean: Array
    sd: Array


class Lattice:
    """Contacts at even places of an observer's coordinates of distance and angle.

    A layer is what has one distance. The places do not depend on the whisker, only the distances
    there do, so that layers of both sides of a curved whisker are the same.

    Parameters
    ----------
    observer : Observer
        Unknowns that have priors alone take five values each.
    step : float
    """

    def __init__(self, observer: Observer, step: float) -> None:
        self.observer, self.step = observer, step
        space, bounded = observer.space, observer.bounded
        axes = [_even(step, *unconstrain_distance(ENDS))]
        if bounded > 1:
            axes.append(_even(step, *unconstrain_angle(ENDS)))
        axes += [np.linspace(-2.5, 2.5, 5)] * (len(observer.unknowns) - bounded)
        x = np.stack([a.ravel() for a in np.meshgrid(*axes, indexing="ij")], axis=-1)
        self.x = axes[0]
        self.shape = len(self.x), len(x) // len(self.x)
        self.distance = space.distance(self.x)
        if bounded > 1:  # every layer has the same fractions of its largest angle
            ones = np.ones((len(self.x), len(observer.unknowns)))
            ones[:, 0] = self.distance
            x[:, 1] += np.repeat(space.angle_scale(ones).log_gain, self.shape[1])
        with np.errstate(all="ignore"):
            contact, log = observer.space.constrain(x)
            signals, outcome = observer.signals(contact)
        in_contact = (outcome == Outcome.HELD) & np.isfinite(log) & np.isfinite(signals).all(axis=1)
        log = np.where(in_contact, log + observer.bounded * np.log(step), -np.inf)
        self.log_total = float(np.logaddexp.reduce(log))
        with np.errstate(divide="ignore"):
            mass = np.exp(log - self.log_total).reshape(self.shape)
            #: ln of the prior mass of each layer (L,).
            self.log_prior = np.log(mass.sum(axis=1))
        grid = np.where(in_contact[:, None], signals, np.nan).reshape(*self.shape, -1)
        slopes = [
            np.nan_to_num(np.gradient(grid, axis=i) if n > 1 else np.zeros_like(grid))
            for i, n in enumerate(self.shape)
        ]
        angle = contact[:, 1] if observer.bounded > 1 else np.zeros(len(contact))
        share = np.ones(len(contact))
        if observer.bounded > 1:
            least, width = observer.space.angle_range(contact[:, 0], contact)
            share = (angle - least) / np.maximum(width, 1e-300)
        #: In blocks (N, SIDE²): ln of prior mass, signals (…, S), their change from contact to
        #: contact (…, S, 2), angles and their shares of the largest.
        self.log_mass = self._blocks(log, -np.inf)
        self.signals = self._blocks(np.where(in_contact[:, None], signals, 1.0), 1.0)
        self.slopes = self._blocks(np.stack(slopes, axis=-1).reshape(*signals.shape, 2), 0.0)
        self.angle, self.share = self._blocks(angle, 0.0), self._blocks(share, 1.0)
        #: Of each block the first layer; and 1 or −1 for even and odd places along the angle.
        across = -(-self.shape[1] // SIDE)
        self.first = np.arange(len(self.log_mass)) // across * SIDE
        self.parity = np.tile(1.0 - 2.0 * (np.arange(SIDE) & 1), SIDE)

    def _blocks(self, values: Array, empty: float) -> Array:
        """Values at contacts (L·M, …) in blocks (N, SIDE², …)."""
        rest = values.shape[1:]
        sides = [-(-n // SIDE) * SIDE for n in self.shape]
        out = np.full((*sides, *rest), empty)
        out[: self.shape[0], : self.shape[1]] = values.reshape(*self.shape, *rest)
        out = out.reshape(sides[0] // SIDE, SIDE, sides[1] // SIDE, SIDE, *rest)
        return np.ascontiguousarray(out.swapaxes(1, 2)).reshape(-1, SIDE * SIDE, *rest)

    def spans(self, spans: Array) -> Array:
        """Densities exp(−(u/s)⁴) of shares u of the largest angle, over their means, (N, SIDE², K).
        """
        mean = spans * gamma(1.25) * gammainc(0.25, spans**-4.0)
        return np.asarray(np.exp(-((self.share[..., None] / spans) ** 4)) / mean)

    def under(self, noise: ReceptorNoise, width: float = ALONE) -> Densities:
        """The densities of readings under Gaussian noise, out to so many sds."""
        return Densities(self, noise, width)


class Densities:
    """Densities of readings at the contacts of a lattice, as quadratic forms of the readings."""

    def __init__(self, lattice: Lattice, noise: ReceptorNoise, width: float) -> None:
        self.lattice, self.noise = lattice, noise
        size = lattice.signals.shape[-1]
        mean, sd = noise.as_gaussian(lattice.signals)
        root = noise.gaussian_root(size)
        precision = root.T @ root
        scaled_mean = mean / sd
        forms = precision / (sd[..., :, None] * sd[..., None, :])
        slope = (scaled_mean @ precision) / sd
        square = ((scaled_mean @ precision) * scaled_mean).sum(axis=-1)
        constant = np.log(np.diag(root)).sum() - 0.5 * size * np.log(2 * np.pi)
        level = lattice.log_mass + constant - np.log(sd).sum(axis=-1) - 0.5 * square
        self.pairs = np.triu_indices(size)
        double = np.where(self.pairs[0] == self.pairs[1], 0.5, 1.0)
        terms = [-double * forms[..., self.pairs[0], self.pairs[1]], slope, level[..., None]]
        self.terms = np.ascontiguousarray(np.swapaxes(np.concatenate(terms, axis=-1), 1, 2))
        there = np.isfinite(lattice.log_mass)[..., None]
        #: Readings (N, S) between which a block counts.
        self.low = np.where(there, mean - width * sd, np.inf).min(axis=1)
        self.high = np.where(there, mean + width * sd, -np.inf).max(axis=1)

    def _features(self, y: Array) -> Array:
        first, second = self.pairs
        return np.concatenate([y[:, first] * y[:, second], y, np.ones((len(y), 1))], axis=1)

    def _near(self, y: Array) -> Iterator[tuple[int, Index]]:
        """Blocks that readings are near to, and these readings."""
        near: Flags = np.ones((len(self.low), len(y)), dtype=bool)
        for low, high, value in zip(self.low.T, self.high.T, y.T, strict=True):
            near &= (low[:, None] <= value) & (value <= high[:, None])
        block, reading = np.nonzero(near)
        count = np.bincount(block, minlength=len(near))
        ends = np.cumsum(count)
        for b in np.flatnonzero(count):
            yield int(b), reading[ends[b] - count[b] : ends[b]]

    def layers(self, y: Array, weights: Array) -> Array:
        """Joint density of readings (n, S) and layers, by weights (N, SIDE², K): (n, L, K)."""
        lattice = self.lattice
        out = np.zeros((len(y), lattice.first[-1] + SIDE, weights.shape[-1]))
        weights = weights.reshape(len(weights), SIDE, SIDE, -1)
        features = self._features(y)
        for b, index in self._near(y):
            density = np.exp(features[index] @ self.terms[b]).reshape(-1, SIDE, SIDE)
            mass = np.matmul(density.transpose(1, 0, 2), weights[b])
            first = lattice.first[b]
            out[index, first : first + SIDE] += mass.transpose(1, 0, 2)
        return out[:, : lattice.shape[0]]

    def sums(self, y: Array) -> LatticeSums:
        """The posteriors of readings (n, S)."""
        lattice = self.lattice
        padded, n = lattice.first[-1] + SIDE, len(y)
        table = np.zeros((n, padded, 4))
        best, contact = np.full(n, -np.inf), np.zeros((n, 2), dtype=np.intp)
        angle = lattice.angle
        each = np.stack(
            [np.ones(angle.shape), np.broadcast_to(lattice.parity, angle.shape), angle, angle**2],
            axis=-1,
        ).reshape(len(angle), SIDE, SIDE, 4)
        features = self._features(y)
        for b, index in self._near(y):
            log = features[index] @ self.terms[b]
            place = log.argmax(axis=1)
            top = log[np.arange(len(index)), place]
            higher = top > best[index]
            best[index[higher]] = top[higher]
            contact[index[higher], 0], contact[index[higher], 1] = b, place[higher]
            density = np.exp(log, out=log).reshape(-1, SIDE, SIDE)
            mass = np.matmul(density.transpose(1, 0, 2), each[b])
            first = lattice.first[b]
            table[index, first : first + SIDE] += mass.transpose(1, 0, 2)
        return self._summed(y, table[:, : lattice.shape[0]], contact)

    def _summed(self, y: Array, table: Array, contact: Index) -> LatticeSums:
        """Moments and errors of sums (n, L, 4): of 1, of ±1, of angle and its square."""
        lattice, bounded = self.lattice, self.lattice.observer.bounded
        mass, signed = table[..., 0], table[..., 1]
        total = mass.sum(axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            powers = np.stack([lattice.distance**0, lattice.distance, lattice.distance**2], axis=1)
            whole = mass @ powers
            parity = 1.0 - 2.0 * (np.arange(lattice.shape[0]) & 1)
            mean, sd = _moments(whole)
            error = np.zeros(len(y))
            for half in (mass @ (powers * parity[:, None]), signed @ powers)[:bounded]:
                for sign in (1, -1):
                    part = np.maximum(whole + sign * half, 0.0)
                    share = part[:, 0] / (2 * total)
                    half_mean, half_sd = _moments(part)
                    off = half_error(share, half_mean - mean, half_sd, sd)
                    error = np.maximum(error, np.where(share > 0, off, 1.0))
            angle, angle_sd = _moments(np.stack([total, *table[..., 2:].sum(axis=1).T], axis=1))
            log = np.log(mass)
            evidence = np.log(total)
        columns = slice(0, bounded)
        return LatticeSums(
            log, evidence, np.where(total > 0, error**2, np.inf), self._misfit(y, contact),
            np.stack([mean, angle], axis=1)[:, columns],
            np.stack([sd, angle_sd], axis=1)[:, columns],
        )  # fmt: skip

    def _misfit(self, y: Array, contact: Index) -> Array:
        """Largest deviation of a signal, in sds, next to the best contact of the lattice.

        Between contacts signals are straight.
        """
        at = contact[:, 0], contact[:, 1]
        mean, sd = self.noise.as_gaussian(self.lattice.signals[at])
        z = (y - mean) / sd
        slope = self.lattice.slopes[at] / sd[..., None]
        square = np.swapaxes(slope, 1, 2) @ slope + 1e-9 * np.eye(2)
        move = np.linalg.solve(square, np.swapaxes(slope, 1, 2) @ z[..., None])
        return np.abs(z - (slope @ np.clip(move, -1.0, 1.0))[..., 0]).max(axis=1)

    def quantiles(self, log: Array, p: Array, parts: int = PARTS) -> Array:
        """Quantiles (n, Q) of the distance, from ln of densities over layers (n, L)."""
        lattice = self.lattice
        x = lattice.x[0] + lattice.step * Cumulative(log, parts).inverse(p)
        return lattice.observer.space.distance(x)


def _even(step: float, low: float, high: float) -> Array:
    """Places at whole steps from one end to the other."""
    return step * np.arange(np.floor(low / step), np.ceil(high / step) + 1)


def _moments(sums: Array) -> tuple[Array, Array]:
    """Mean and sd from sums (n, 3) of 1, the value and its square."""
    mean = sums[:, 1] / sums[:, 0]
    return mean, np.sqrt(np.maximum(sums[:, 2] / sums[:, 0] - mean**2, 0.0))


def serves(observer: Observer) -> bool:
    """Whether a lattice serves: Gaussian noise, not too little, no unknown with a prior alone."""
    noise = observer.noise
    is_gaussian = type(noise) is Weber or (
        type(noise) is GeneralisedWeber and not np.isfinite(noise.ceiling).any()
    )
    if not is_gaussian or observer.bounded < len(observer.unknowns):
        return False
    fractions = noise.weber_fractions(len(observer.cue.signal_names))
    return bool(np.min(fractions, where=fractions > 0, initial=1.0) > LEAST)
