"""Three unknowns that every signal tells of: a grid about the highest point of each posterior.

Contacts of a curved whisker in space need too many tiles, and a plain grid takes a million nodes
to find them. Here Fisher scoring climbs from several starts, all around the base; the grid lies
along the axes of the Gaussian there, skewed so that its distances and azimuths stay those of a
product, of which `mechanics.space_surface` makes use. A posterior that has a second peak elsewhere,
or that the grid does not close off, is left to the others.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from ..observer import Observer
from .grid import OwnGrids, integrate
from .peaks import find_mode
from .result import Array, Index
from .tiled import Moments

#: The axes of the grid: distance, azimuth, angle.
_SKEWED = np.array([0, 2, 1])


class ModeGrid(OwnGrids):
    """The posterior of one reading (1, R) about its highest point.

    Parameters
    ----------
    observer : Observer
    reading : array, shape (1, R)
    centre, root : array, shape (3,) and (3, 3)
        The highest point in the coordinates x, and a root of the Gaussian's covariance there.
    wide : float
        How far the grid may go, in sds.
    """

    def __init__(
        self, observer: Observer, reading: Array, centre: Array, root: Array, wide: float = 16.0
    ) -> None:
        self.observer, self.centre, self.root = observer, centre, root
        ends = np.full((1, 3), wide)

        def density(u: Array, index: Index) -> Array:
            return observer.log_density(self._place(u), reading[:, None])

        def contact(u: Array) -> Array:
            return observer.contact(self._place(u))[0]

        for _ in range(3):
            found = integrate(density, -ends, ends, functions=contact, depth=20.0, nodes=(23, 31))
            weight, u = found.weights[0], found.points[0]
            mean, at_end = weight @ u, weight[(np.abs(u) > 0.9 * wide).any(axis=1)].sum()
            covariance = (weight * (u - mean).T) @ (u - mean)
            if at_end < 1e-6 and np.diagonal(covariance).max() < 4:
                break
            # Wider than it is at the highest point: once more as it is in all.
            self.centre = self._place(mean)
            self.root = _skewed(self.root @ covariance @ self.root.T)
        found.error[:] += wide * at_end
        self.weights, self.points, self.error = found.weights, found.points, found.error
        self.contacts = contact(found.points)
        best = self.contacts[:, self.weights[0].argmax()]
        signals = np.nan_to_num(observer.signals(best)[0], nan=1.0)
        log_evidence = found.log_evidence + np.linalg.slogdet(self.root)[1]
        share, none = self.weights.max(axis=1), np.zeros(1)
        self.moments = Moments(found.mean, found.sd, log_evidence, share, best, signals, none, none)

    def _place(self, u: Array) -> Array:
        """Coordinates x of points on the axes of the Gaussian."""
        return np.asarray(self.centre + u @ self.root.T)

    def draws(self, count: int, rng: np.random.Generator) -> Array:
        """Contacts (1, count, 3) drawn from the cells about the nodes."""
        u = self.points[0, rng.choice(self.weights.size, count, p=self.weights[0])]
        cell = [np.diff(np.unique(axis)[:2])[0] for axis in self.points[0].T]
        u = u + cell * (rng.random(u.shape) - 0.5)
        return self.observer.contact(self._place(u))[0][None]


def _skewed(covariance: Array) -> Array:
    """Roots (..., 3, 3) whose first axis alone moves the distance, and the third no azimuth."""
    root = np.linalg.cholesky(covariance[..., _SKEWED, :][..., _SKEWED])
    return np.asarray(root[..., np.argsort(_SKEWED), :])


@lru_cache(maxsize=16)
def _scattered(observer: Observer) -> tuple[Array, Array, Array, NDArray[np.intp]]:
    """Coordinates (n, 3) all over, signals there, ln of the prior, and which region each is in."""
    x = observer.space.spread(expit(np.linspace(-4, 4, 12)), others=25)
    contact, log_prior = observer.contact(x)
    signals, outcome = observer.signals(contact)
    held = outcome == 0
    x, contact, signals, log_prior = x[held], contact[held], signals[held], log_prior[held]
    low, high = observer.reach
    third = np.minimum(3 * (contact[:, 0] - low) / (high - low), 2).astype(np.intp)
    around = np.minimum((contact[:, 2] % (2 * np.pi)) / (np.pi / 2), 3).astype(np.intp)
    return x, signals, log_prior, 4 * third + around


def highest_points(
    observer: Observer, reading: Array, *, least: float = 14.0, apart: float = 5.0
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """The highest points (B, 3) of posteriors, roots (B, 3, 3) of the Gaussians there, and which
    have no other peak: within `least` in ln and more than `apart` sds off.
    """
    x, signals, log_prior, region = _scattered(observer)
    table = observer.noise.log_likelihoods(reading, signals) + log_prior
    regions = np.unique(region)
    starts = [np.where(region == k, table, -np.inf).argmax(axis=1) for k in regions]
    start = x[np.stack(starts, axis=1)].reshape(-1, 3)
    mode = find_mode(observer, np.repeat(reading, len(regions), axis=0), start)
    height = mode.log_density.reshape(len(reading), -1)
    rows, best = np.arange(len(reading)), height.argmax(axis=1)
    centres = mode.x.reshape(*height.shape, 3)
    centre = centres[rows, best]
    covariance = mode.covariance.reshape(*height.shape, 3, 3)[rows, best]
    root = _skewed(covariance)
    root *= np.minimum(1.0, 2.0 / np.linalg.norm(root, axis=(1, 2)))[:, None, None]
    off = np.linalg.solve(root, np.swapaxes(centres - centre[:, None], 1, 2))
    other = (height > height.max(axis=1, keepdims=True) - least) & (
        np.linalg.norm(off, axis=1) > apart
    )
    return centre, root, ~other.any(axis=1)
