"""The last of three or more unknowns, integrated out at every node of a grid over the others.

A stiffness or a side is known by its prior and by what the rest of a reading leaves of it. At a
given contact its density is close to a Gaussian, whose middle and width change from contact to
contact: a Newton step or two find both, from the mode's own regression line at the corners of a
tile, and between these by interpolation. Gauss–Hermite's rule about them needs five nodes where a
grid of three dimensions has a dozen; and the mechanics, which know no stiffness, are worked out
once for all of them.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.polynomial.hermite_e import hermegauss
from numpy.typing import NDArray

from ..mechanics.contact import Outcome
from ..observer import Observer
from .grid import GridPosterior
from .lattice import SIDE, Array, Index, LatticeMoments, OnTiles, Tiled
from .mode import Mode
from .scale import has_scale, without_scale
from .solution import mode_root
from .tiles import Engine

#: Nodes of the rule, from the tolerance on that stands before them.
RULES = ((3e-3, 5), (3e-4, 9), (0.0, 15))
#: Most nodes, where the rule that the tolerance asks for proves too coarse.
MOST = 45
#: Widest and narrowest a conditional density may be, over the mode's.
WIDEST = 4.0
#: Most steps towards the conditional mode, in widths the last of them, and the density (in ln,
#: below the highest) at nodes that are not waited for.
STEPS, NEAR, NEGLIGIBLE = 16, 1.0, 30.0
#: Sums about better and better middles, where a climb has missed.
ROUNDS = 6
#: Variance about a middle, over what the width there says, from which the rule is not believed:
#: with five nodes it is half a hundredth off in ln of the density there, and soon far more.
UNLIKE = 2.0
#: Corners of a tile, and what each counts at every node between them.
CORNERS = [0, SIDE - 1, SIDE * (SIDE - 1), SIDE**2 - 1]
_ALONG = np.stack([np.linspace(1, 0, SIDE), np.linspace(0, 1, SIDE)])
BETWEEN = np.kron(_ALONG, _ALONG)


class Nodes(NamedTuple):
    """Nodes (n,): whose they are, readings, contacts, ln of prior and of the highest density."""

    row: Index
    reading: Array
    contact: Array
    log_prior: Array
    top: Array

    def of(self, rows: Index) -> Nodes:
        """Some of them."""
        return Nodes._make(column[rows] for column in self)


class Conditional:
    """The density of all unknowns but the last, for readings (B, R) and their modes."""

    def __init__(self, observer: Observer, reading: Array, mode: Mode, count: int) -> None:
        self.observer, self.reading, self.mode, self.count = observer, reading, mode, count
        precision = np.linalg.inv(mode.covariance)
        self.width = precision[:, -1, -1] ** -0.5
        self.slope = -precision[:, -1, :-1] / precision[:, -1, -1, None]
        #: Infinite for posteriors of whose conditional peaks one has been missed, 0 for the others.
        self.astray = np.zeros(len(reading))

    def __call__(self, x: Array, index: Index, *, finer: int = 1) -> tuple[Array, Array]:
        """ln of the density at x (b, N, U − 1), (b, N); and columns (b, N, U + 1).

        The columns are the contact, and of the last unknown the mean and variance at each node.
        """
        log, columns = self.climbed_and_summed(self.nodes(x, index), *self.start(x, index), finer)
        return log.reshape(x.shape[:2]), columns.reshape(*x.shape[:2], -1)

    def on_tiles(self, points: Array, *, finer: int = 1) -> OnTiles:
        """The same for pairs of a reading and a tile of nodes (T, N, U − 1), as `lattice` asks.

        Peaks are climbed to at the corners of a tile, and again where what lies between them
        misses.
        """

        def density(row: Index, tile: Index) -> tuple[Array, Array]:
            x = points[tile]
            if x.shape[1] != SIDE**2:  # a few places, not a tile
                log, columns = self(x, row, finer=finer)
                return log, np.moveaxis(columns, -1, 1)
            start = self.start(x[:, CORNERS], row)
            middle, width, _ = self.climbed(self.nodes(x[:, CORNERS], row), *start)
            nodes = self.nodes(x, row)
            between = [(a.reshape(-1, 4) @ BETWEEN).ravel() for a in (middle, np.log(width))]
            middle, width = between[0], np.exp(between[1])
            log, columns, middle, width, missed = self.summed(nodes, middle, width, finer)
            again = np.flatnonzero(missed)
            if again.size:
                # Between corners of which one has gone astray the mode's own line is nearer.
                density = self.log_density(nodes.of(again))
                line, wide = (part[again] for part in self.start(x, row))
                nearer = density(line)[0] > density(middle[again])[0]
                log[again], columns[again] = self.climbed_and_summed(
                    nodes.of(again),
                    np.where(nearer, line, middle[again]),
                    np.where(nearer, wide, width[again]),
                    finer,
                )
            columns = columns.reshape(*x.shape[:2], -1)
            return log.reshape(x.shape[:2]), np.moveaxis(columns, -1, 1)

        return density

    def start(self, x: Array, index: Index) -> tuple[Array, Array]:
        """The mode's regression line at x (b, N, U − 1), and the width about it, (b N,) each."""
        off = x - self.mode.x[index, None, :-1]
        middle = self.mode.x[index, None, -1] + (off @ self.slope[index, :, None])[..., 0]
        return middle.ravel(), np.repeat(self.width[index], x.shape[1])

    def nodes(self, x: Array, index: Index) -> Nodes:
        """All there is to know of the nodes x (b, N, U − 1) of readings (b,), in one row."""
        contact, log_prior = self.observer.contact(x)
        rows = np.repeat(index, x.shape[1])
        return Nodes(
            rows,
            self.reading[rows],
            contact.reshape(len(rows), -1),
            log_prior.ravel(),
            self.mode.log_density[rows],
        )

    def climbed_and_summed(
        self, nodes: Nodes, middle: Array, width: Array, finer: int
    ) -> tuple[Array, Array]:
        """ln of the density (n,) and the columns, by climbs from middles (n,)."""
        middle, width, held = self.climbed(nodes, middle, width)
        log = np.full(len(middle), -np.inf)
        columns = np.zeros((len(middle), nodes.contact.shape[1] + 2))
        live = np.flatnonzero(held)  # the others hold nothing
        middle, width = middle[live], width[live]
        for _ in range(ROUNDS):
            if not live.size:
                break
            found = self.summed(nodes.of(live), middle, width, finer)
            log[live], columns[live], middle, width, missed = found
            missed &= log[live] > nodes.top[live] - NEGLIGIBLE / 2
            live, middle, width = live[missed], middle[missed], width[missed]
        self.astray[nodes.row[live]] = np.inf
        return log, columns

    def climbed(
        self, nodes: Nodes, middle: Array, width: Array
    ) -> tuple[Array, Array, NDArray[np.bool_]]:
        """The conditional peaks, their widths, and whether they are worth summing, (n,) each."""
        reach = np.full(middle.shape, WIDEST)
        peak, step, narrower = self.climb(self.log_density(nodes), middle, width, reach)
        middle = middle + step * width
        above = peak + nodes.log_prior - nodes.top
        far = np.abs(step) > WIDEST / 2
        live = (above > -NEGLIGIBLE) | (far & np.isfinite(peak))
        for _ in range(STEPS):
            waited = live & ((above > -NEGLIGIBLE / 2) | far) & (np.abs(step) >= NEAR)
            left = np.flatnonzero(waited)
            if not left.size:
                break
            # Longer strides where they go on, as along the side of a ridge far from the mode.
            reach[left] = np.where(np.abs(step[left]) < reach[left], WIDEST, 2 * reach[left])
            density = self.log_density(nodes.of(left))
            found = self.climb(density, middle[left], width[left], reach[left])
            peak[left], step[left], narrower[left] = found
            middle[left] += step[left] * width[left]
            above[left] = peak[left] + nodes.log_prior[left] - nodes.top[left]
            far[left] = np.abs(step[left]) > WIDEST / 2
        return middle, width * narrower, live

    def summed(
        self, nodes: Nodes, middle: Array, width: Array, finer: int
    ) -> tuple[Array, Array, Array, Array, NDArray[np.bool_]]:
        """ln of the density (n,) and the columns (n, U + 1), by the rule about these middles.

        And better middles and widths, and whether these were beside the peak or far from as wide.
        """
        t, weight = hermegauss(finer * self.count)
        rule = np.log(weight) + t**2 / 2
        density = self.log_density(nodes)
        each = [density(middle + node * width) for node in t]
        share = np.stack([v + w for (v, _), w in zip(each, rule, strict=True)])
        top = share.max(axis=0)
        safe = np.where(np.isfinite(top), top, 0.0)
        share = np.exp(np.subtract(share, safe, out=share), out=share)
        total = share.sum(axis=0)
        found = total > 0
        share /= np.where(found, total, 1.0)
        values = np.stack([v for _, v in each])
        mean = (share * values).sum(axis=0)
        variance = (share * np.square(values - mean)).sum(axis=0)
        off = t @ share
        spread = t**2 @ share - off**2
        missed = (np.abs(off) > NEAR) | (spread > UNLIKE) | (spread < 1 / UNLIKE)
        with np.errstate(divide="ignore"):
            log = np.log(total * width) + safe + nodes.log_prior - 0.5 * np.log(2 * np.pi)
        columns = np.concatenate([nodes.contact, mean[:, None], variance[:, None]], axis=-1)
        columns[~found] = 0.0
        better = middle + off * width
        return log, columns, better, width * np.clip(spread, WIDEST**-2, WIDEST) ** 0.5, missed

    def log_density(self, nodes: Nodes) -> Callable[[Array], tuple[Array, Array]]:
        """ln of the density of the last unknown, and its value, at its coordinate (n,)."""
        felt = self.observer.given(nodes.contact)

        def log_density(z: Array) -> tuple[Array, Array]:
            value = self.observer.last_unknown(z)
            signals, outcome = felt(value)
            held = outcome == Outcome.HELD
            if held.all():
                return self.observer.noise.log_likelihood(
                    nodes.reading, signals
                ) - 0.5 * z**2, value
            signals = np.where(held[..., None], signals, 1.0)
            log = self.observer.noise.log_likelihood(nodes.reading, signals) - 0.5 * z**2
            return np.where(held, log, -np.inf), value

        return log_density

    @staticmethod
    def climb(
        density: Callable[[Array], tuple[Array, Array]], middle: Array, width: Array, reach: Array
    ) -> tuple[Array, Array, Array]:
        """A Newton step in widths, with the height it ends at and the factor of the width."""
        below, here, above = (density(middle + s * width)[0] for s in (-1.0, 0.0, 1.0))
        with np.errstate(divide="ignore", invalid="ignore"):
            rise, bend = (above - below) / 2, 2 * here - below - above
            # Uphill all the way where there is no peak to aim at.
            step = np.where(bend > 0, rise / bend, np.inf * np.sign(rise))
            step = np.nan_to_num(np.clip(step, -reach, reach))
            bend = np.clip(np.nan_to_num(bend, nan=1.0), WIDEST**-2, WIDEST**2)
            height = np.fmax(np.fmax(below, above), here + np.nan_to_num(step * rise) / 2)
        return height, step, bend**-0.5


class LastUnknown(Engine):
    """The moments over all coordinates but the last, of three and more unknowns.

    Attributes
    ----------
    coarse : array of bool, shape (B,)
        Where the rule for the last unknown takes more than half of the tolerance.
    """

    nested = True

    def __init__(
        self,
        observer: Observer,
        reading: Array,
        mode: Mode,
        tolerance: float,
        count: int | None = None,
    ) -> None:
        super().__init__(observer, reading, mode, tolerance)
        self.peak = Mode(mode.x[:, :-1], mode.log_density, mode.covariance[:, :-1, :-1])
        self.count = count or next(count for least, count in RULES if tolerance >= least)
        self.conditional = Conditional(observer, reading, mode, self.count)
        self._tiled = self.tiled()
        self.coarse, self._off, self._last_off = self.errors()

    def tiled(self, finer: int = 1) -> Tiled:
        """The density and its functions on tiles, by a rule of so many times the nodes."""
        if has_scale(self.observer):
            top, count = self.mode.log_density, finer * self.count
            return without_scale(self.observer, self.reading, top, count)
        return partial(self.conditional.on_tiles, finer=finer)

    def at(self, x: Array, index: Index) -> tuple[Array, Array]:
        if not has_scale(self.observer):
            return self.conditional(x, index)
        log, values = self._tiled(x)(index, np.arange(len(x)))
        return log, np.moveaxis(values, 1, -1)

    def sound(self) -> NDArray[np.bool_]:
        return np.asarray(self._off + self.conditional.astray < self.tolerance)

    def completed(self, found: GridPosterior | LatticeMoments) -> dict[str, Any]:
        """Mean, sd and their errors of all unknowns, from the functions'."""
        mean, sd, mean_error, sd_error = found.mean, found.sd, found.mean_error, found.sd_error
        dim = mean.shape[1] - 2
        # Of the last unknown: the variance of its mean at the nodes, and the mean of its variance.
        whole = np.sqrt(sd[:, dim] ** 2 + mean[:, dim + 1])
        share = sd[:, dim] / whole
        spread = sd[:, dim + 1] * mean_error[:, dim + 1] / (2 * whole**2)
        of_mean, of_variance = (off / whole**n for n, off in enumerate(self._last_off, 1))
        last_mean_error = share * mean_error[:, dim] + of_mean
        last_sd_error = share**2 * sd_error[:, dim] + spread + of_mean + of_variance / 2
        off = (self._off + self.conditional.astray)[:, None]
        return {
            "mean": mean[:, : dim + 1],
            "sd": np.column_stack([sd[:, :dim], whole]),
            "mean_error": np.column_stack([mean_error[:, :dim], last_mean_error]) + off,
            "sd_error": np.column_stack([sd_error[:, :dim], last_sd_error]) + off,
        }

    def errors(self) -> tuple[NDArray[np.bool_], Array, tuple[Array, Array]]:
        """What `coarse` says, and how far ln of the density is off across each posterior (B,).

        And the last unknown's mean and variance at a contact. The rule with three times as many
        nodes tells, at one sd to either side along each axis.
        """
        width = np.linalg.norm(mode_root(self.peak), axis=2)
        steps = np.concatenate([s * np.eye(width.shape[1]) for s in (-1.0, 0.0, 1.0)])
        places = self.peak.x[:, None] + steps * width[:, None]
        rows = np.arange(len(places))
        fine, plain = (self.tiled(finer)(places)(rows, rows) for finer in (3, 1))
        with np.errstate(invalid="ignore"):
            change = np.nan_to_num(fine[0] - plain[0], nan=0.0, posinf=1.0, neginf=-1.0)
        off = np.ptp(change, axis=1)
        mean, variance = np.moveaxis(np.abs(fine[1] - plain[1])[:, -2:], 1, 0)
        own = np.maximum(fine[1][:, -1], np.finfo(float).tiny)
        worst = np.maximum(mean / np.sqrt(own), variance / (2 * own)).max(axis=1)
        coarse = np.maximum(off, worst) > self.tolerance / 2
        return coarse, off, (mean.max(axis=1), variance.max(axis=1))
