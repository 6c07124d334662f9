"""The last of three or more unknowns, integrated out at every node of a grid over the others.

A stiffness or a side is known by its prior and by what the rest of a reading leaves of it. At a
given contact its density is close to a Gaussian, whose middle and width change from contact to
contact: a Newton step or two from the mode's own regression line find both. Gauss–Hermite's rule
about them needs five nodes where a grid of three dimensions has a dozen; and the mechanics, which
know no stiffness, are worked out once for all of them.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.polynomial.hermite_e import hermegauss

from ..mechanics.contact import Outcome
from ..observer import Observer
from .grid import GridPosterior
from .lattice import Array, Index, LatticeMoments, OnTiles, Tiled
from .mode import Mode
from .scale import has_scale, without_scale
from .solution import mode_root
from .tiles import Engine

#: Nodes of the rule, from the tolerance on that stands before them.
RULES = ((3e-3, 5), (3e-4, 9), (0.0, 15))
#: Widest and narrowest a conditional density may be, over the mode's.
WIDEST = 4.0
#: Most steps towards the conditional mode, in widths the last of them, and the density (in ln,
#: below the highest) at nodes that are not waited for.
STEPS, NEAR, NEGLIGIBLE = 8, 1.0, 30.0


class Conditional:
    """The density of all unknowns but the last, for readings (B, R) and their modes."""

    def __init__(self, observer: Observer, reading: Array, mode: Mode, count: int) -> None:
        self.observer, self.reading, self.mode, self.count = observer, reading, mode, count
        precision = np.linalg.inv(mode.covariance)
        self.width = precision[:, -1, -1] ** -0.5
        self.slope = -precision[:, -1, :-1] / precision[:, -1, -1, None]

    def __call__(self, x: Array, index: Index, *, finer: int = 1) -> tuple[Array, Array]:
        """ln of the density at x (b, N, U − 1), (b, N); and columns (b, N, U + 1).

        The columns are the contact, and of the last unknown the mean and variance at each node.
        """
        contact, log_prior = self.observer.contact(x)
        off = x - self.mode.x[index, None, :-1]
        middle = self.mode.x[index, None, -1] + (off @ self.slope[index, :, None])[..., 0]
        width = np.broadcast_to(self.width[index, None], middle.shape)
        reading, at = self.reading[index, None], contact
        peak, step, narrower = self.climb(self.log_density(reading, at), middle, width)
        middle = middle + step * width
        # From here on without the nodes that hold nothing; far from its peak no node tells.
        live = peak + log_prior > self.mode.log_density[index, None] - NEGLIGIBLE
        live |= (np.abs(step) > WIDEST / 2) & np.isfinite(peak)
        log, columns = np.full(live.shape, -np.inf), np.zeros((*live.shape, x.shape[-1] + 2))
        if not live.any():
            return log, columns
        rows = np.nonzero(live)[0]
        reading, at, prior = self.reading[index[rows]], contact[live], log_prior[live]
        middle, width, step, peak = middle[live], width[live], step[live], peak[live]
        narrower = narrower[live]
        least = self.mode.log_density[index[rows]] - NEGLIGIBLE / 2 - prior
        for _ in range(STEPS):
            waited = (peak > least) | (np.abs(step) > WIDEST / 2)
            far = np.flatnonzero(waited & (np.abs(step) >= NEAR))
            if not far.size:
                break
            density = self.log_density(reading[far], at[far])
            peak[far], step[far], narrower[far] = self.climb(density, middle[far], width[far])
            middle[far] += step[far] * width[far]
        width = width * narrower
        density = self.log_density(reading, at)
        t, weight = hermegauss(finer * self.count)
        rule = np.log(weight) + t**2 / 2
        each = [density(middle + node * width) for node in t]
        value = np.stack([v + w for (v, _), w in zip(each, rule, strict=True)])
        top = value.max(axis=0)
        safe = np.where(np.isfinite(top), top, 0.0)
        share = np.exp(value - safe)
        total = share.sum(axis=0)
        values = np.stack([v for _, v in each])
        with np.errstate(divide="ignore", invalid="ignore"):
            mean = (share * values).sum(axis=0) / total
            variance = (share * np.square(values - mean)).sum(axis=0) / total
            marginal = np.log(total * width) + safe + prior - 0.5 * np.log(2 * np.pi)
        found = np.isfinite(marginal)
        log[live] = marginal
        part = np.concatenate([at, mean[:, None], variance[:, None]], axis=-1)
        columns[live] = np.where(found[:, None], part, 0.0)
        return log, columns

    def log_density(self, reading: Array, contact: Array) -> Callable[[Array], tuple[Array, Array]]:
        """ln of the density of the last unknown, and its value, at its coordinate (...)."""
        felt = self.observer.given(contact)

        def log_density(z: Array) -> tuple[Array, Array]:
            value = self.observer.last_unknown(z)
            signals, outcome = felt(value)
            held = outcome == Outcome.HELD
            if held.all():
                return self.observer.noise.log_likelihood(reading, signals) - 0.5 * z**2, value
            signals = np.where(held[..., None], signals, 1.0)
            log = self.observer.noise.log_likelihood(reading, signals) - 0.5 * z**2
            return np.where(held, log, -np.inf), value

        return log_density

    @staticmethod
    def climb(
        density: Callable[[Array], tuple[Array, Array]], middle: Array, width: Array
    ) -> tuple[Array, Array, Array]:
        """A Newton step in widths, with the height it ends at and the factor of the width."""
        below, here, above = (density(middle + s * width)[0] for s in (-1.0, 0.0, 1.0))
        with np.errstate(divide="ignore", invalid="ignore"):
            rise, bend = (above - below) / 2, 2 * here - below - above
            # Uphill all the way where there is no peak to aim at.
            step = np.where(bend > 0, rise / bend, np.inf * np.sign(rise))
            step = np.nan_to_num(np.clip(step, -WIDEST, WIDEST))
            bend = np.clip(np.nan_to_num(bend, nan=1.0), WIDEST**-2, WIDEST**2)
            height = np.fmax(np.fmax(below, above), here + np.nan_to_num(step * rise) / 2)
        return height, step, bend**-0.5

    def on_tiles(self, points: Array, *, finer: int = 1) -> OnTiles:
        """The same for pairs of a reading and a tile of nodes (T, N, U − 1), as `lattice` asks."""

        def density(row: Index, tile: Index) -> tuple[Array, Array]:
            log, columns = self(points[tile], row, finer=finer)
            return log, np.moveaxis(columns, -1, 1)

        return density


class LastUnknown(Engine):
    """The moments over all coordinates but the last, of three and more unknowns."""

    nested = True

    def __init__(self, observer: Observer, reading: Array, mode: Mode, tolerance: float) -> None:
        super().__init__(observer, reading, mode, tolerance)
        self.peak = Mode(mode.x[:, :-1], mode.log_density, mode.covariance[:, :-1, :-1])
        self.count = next(count for least, count in RULES if tolerance >= least)
        self.conditional = Conditional(observer, reading, mode, self.count)
        self._tiled = self.tiled()

    def tiled(self, finer: int = 1) -> Tiled:
        """The density and its functions on tiles, by a rule of so many times the nodes."""
        if has_scale(self.observer):
            top, count = self.mode.log_density, finer * self.count
            return without_scale(self.observer, self.reading, top, count)
        return partial(self.conditional.on_tiles, finer=finer)

    def at(self, x: Array, index: Index) -> tuple[Array, Array]:
        log, values = self._tiled(x)(index, np.arange(len(x)))
        return log, np.moveaxis(values, 1, -1)

    def completed(self, found: GridPosterior | LatticeMoments) -> dict[str, Any]:
        """Mean, sd and their errors of all unknowns, from the functions'."""
        mean, sd, mean_error, sd_error = found.mean, found.sd, found.mean_error, found.sd_error
        dim = mean.shape[1] - 2
        # Of the last unknown: the variance of its mean at the nodes, and the mean of its variance.
        whole = np.sqrt(sd[:, dim] ** 2 + mean[:, dim + 1])
        share = sd[:, dim] / whole
        spread = sd[:, dim + 1] * mean_error[:, dim + 1] / (2 * whole**2)
        last_mean_error, last_sd_error = share * mean_error[:, dim], share**2 * sd_error[:, dim]
        off = self.error()[:, None]
        return {
            "mean": mean[:, : dim + 1],
            "sd": np.column_stack([sd[:, :dim], whole]),
            "mean_error": np.column_stack([mean_error[:, :dim], last_mean_error]) + off,
            "sd_error": np.column_stack([sd_error[:, :dim], last_sd_error + spread]) + off,
        }

    def error(self) -> Array:
        """How far ln of the density is off, across the middle of each posterior (B,).

        The rule with three times as many nodes tells, at one sd to either side along each axis.
        """
        width = np.linalg.norm(mode_root(self.peak), axis=2)
        steps = np.concatenate([s * np.eye(width.shape[1]) for s in (-1.0, 0.0, 1.0)])
        places = self.peak.x[:, None] + steps * width[:, None]
        rows = np.arange(len(places))
        fine, plain = (self.tiled(finer)(places)(rows, rows)[0] for finer in (3, 1))
        with np.errstate(invalid="ignore"):
            change = np.nan_to_num(fine - plain, nan=1.0, posinf=1.0, neginf=-1.0)
        return np.asarray(np.ptp(change, axis=1))
