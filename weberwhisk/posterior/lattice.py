"""Quadrature of many posteriors in two coordinates, on lattices that they share.

The trapezoid rule again, as in `grid`; but the nodes do not depend on the reading. They lie on
lattices whose spacings are powers of √2, cut into square tiles: the mechanics are worked out once
for all readings that have mass on a tile. Each posterior starts at the tile of its peak and
spreads to those neighbours that it still has mass in, so that a bent ridge costs no more than a
straight one, and a lattice that proves too wide is changed for a finer one.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import reduce
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..threads import on_threads
from .gaps import GAPS, MORE_TILES, Look, water_in
from .passes import LOST, claimed_error, fitting

Array = NDArray[np.float64]
Index = NDArray[np.intp]
#: ln of the density (P, N) and functions (P, C, N) for pairs of a posterior and a tile, (P,) each.
OnTiles = Callable[[Index, Index], tuple[Array, Array]]
#: What gives it for the nodes (T, N, 2) of tiles.
Tiled = Callable[[Array], OnTiles]

#: Nodes along the side of a tile: a multiple of four, as every fourth tells of the error.
SIDE = 8
#: Widest spacing, in x: the prior's own width is a few units.
WIDEST = 0.26
#: Lattices tried, tiles of one posterior, and nodes that are worked on together.
TRIES, TILES, BATCH = 8, 256, 65_536
#: Steps by which a lattice may be wider than the conditional sds ask for: a ridge must not pass
#: between the nodes at the side of a tile.
COARSER = 2
#: Share of the tolerance that the mass beyond one side of a tile may take.
EDGE = 1 / 20
#: Slowest fall from two layers of nodes to the next that is believed.
SLOWEST = 0.95
#: Largest ratio of a coordinate's sd to its conditional sd: thinner ridges, at an angle to the
#: axes, are for grids that turn with them.
THINNEST = 25.0
_HALF = 1 << 23  # tiles to either side of the origin; some thousand posteriors fit


class LatticeMoments(NamedTuple):
    """Of B posteriors: mean, sd and, over the sd, their errors, (B, C); ln Z; whether all is well.

    What has not converged is not to be used, but where gaps were left that no lattice filled:
    there other grids fail in silence.
    """

    mean: Array
    sd: Array
    mean_error: Array
    sd_error: Array
    log_evidence: Array
    converged: NDArray[np.bool_]
    gaping: NDArray[np.bool_]

    def of(self, rows: NDArray[np.bool_]) -> LatticeMoments:
        """The same of some of the posteriors."""
        return LatticeMoments._make(column[rows] for column in self)

    def where(self, rows: NDArray[np.bool_], other: LatticeMoments) -> LatticeMoments:
        """These in some of the posteriors, others' in the rest."""
        return LatticeMoments._make(
            np.where(rows.reshape(-1, *[1] * (one.ndim - 1)), one, two)
            for one, two in zip(self, other, strict=True)
        )


def integrate_on_lattice(
    tiled: Tiled,
    centre: Array,
    covariance: Array,
    top: Array,
    *,
    tolerance: float,
    nested: bool = False,
    ridge: NDArray[np.bool_] | None = None,
) -> LatticeMoments:
    """Moments of functions of two coordinates under B densities.

    Parameters
    ----------
    tiled : callable
        The densities and the functions on tiles of nodes (T, N, 2).
    centre : array, shape (B, 2)
        Their peaks.
    covariance : array, shape (B, 2, 2)
        About the peaks.
    top : array, shape (B,)
        ln of the densities at the peaks, or near it.
    tolerance : float
        Largest estimated error of a mean or an sd, over the sd.
    nested : bool
        Whether the last two functions are the mean and the variance of one more unknown at each
        node, of which the mean is held to that unknown's whole sd, and the variance to nothing.
    ridge : array of bool, shape (B,), optional
        Those whose gaps are of no interest.
    """
    level = _levels(covariance, fitting(tolerance, 2))
    own, given = (np.diagonal(c, axis1=1, axis2=2) for c in (covariance, np.linalg.inv(covariance)))
    thin = np.asarray((own * given > THINNEST**2).any(axis=1))
    ridge = np.zeros(len(centre), dtype=bool) if ridge is None else ridge
    left, parts, most = np.arange(len(centre)), [], np.full(len(centre), TILES)
    before: Look | None = None
    for attempt in range(TRIES):
        flood = _Flood(
            tiled, centre[left], level[left], most[left], top[left], left, thin[left], tolerance,
            nested,
        )  # fmt: skip
        found, rough = flood.moments()
        water = np.where(ridge[left, None], 0.0, flood.water())
        gaps = water > GAPS * tolerance
        same = np.zeros(len(left), dtype=bool)
        if before is not None:
            # Gaps that are the posterior's own, between two peaks, are there on any lattice.
            same = before.agrees(found, water, slice(-2 if nested else None), tolerance)
            found = found.where(~flood.lost & (found.converged | ~same), before.found)
            water = np.where(flood.lost[:, None], before.water, water)
        doubted = found.converged & gaps.any(axis=1) & ~same
        rough = np.where(doubted[:, None], 2 * gaps[:, ::-1], rough)
        most[left[doubted]] = MORE_TILES
        well = found.converged & ~doubted
        done = well | flood.lost | np.full(len(left), attempt == TRIES - 1)
        gaping = ~well & (most[left] > TILES)
        missing = np.where(gaping, water.max(axis=1), 0.0)[:, None]
        ended = found._replace(
            mean_error=found.mean_error + missing,
            sd_error=found.sd_error + missing,
            converged=well,
            gaping=gaping,
        )
        parts.append((left[done], ended.of(done)))
        level[left] += rough
        before = Look(found.of(~done), water[~done], doubted[~done])
        left = left[~done]
        if not left.size:
            break
    order = np.argsort(np.concatenate([rows for rows, _ in parts]))
    columns = zip(*(found for _, found in parts), strict=True)
    return LatticeMoments._make(np.concatenate(column)[order] for column in columns)


def _levels(covariance: Array, cell: float) -> NDArray[np.int64]:
    """Levels (B, 2) of lattices on which a Gaussian has its moments; spacings are 2^(−level/2).

    The error of the rule is the density's Fourier transform at the points n/h of the dual lattice,
    exp(−2π² (n/h)·Σ(n/h)) (Poisson's summation formula). Spacings of `cell` conditional sds keep
    all of these small; where a coordinate's own sd is larger a wider one often does.
    """
    # Of either sign one will do.
    dual = np.array([n for n in product(range(4), range(-4, 5)) if n > (0, 0)], dtype=float)

    def spacing(level: Array) -> Array:
        return np.asarray(2.0 ** (-level / 2))

    def coarse(level: Array) -> NDArray[np.bool_]:
        wave = dual / spacing(level)[:, None]
        size = ((wave @ covariance) * wave).sum(axis=-1).min(axis=1)
        return np.asarray((size < cell**-2) | (spacing(level).max(axis=1) > WIDEST))

    conditional = np.diagonal(np.linalg.inv(covariance), axis1=1, axis2=2) ** -0.5
    finest = np.minimum(cell * conditional, WIDEST)
    level = np.ceil(-2 * np.log2(finest)).astype(np.int64)
    for axis in (0, 1):
        going = np.full(len(level), True)
        for _ in range(COARSER):
            wider = level - np.eye(2, dtype=np.int64)[axis]
            going &= ~coarse(wider)
            level = np.where(going[:, None], wider, level)
    return level


class _Flood:
    """Posteriors on one lattice each: tiles seen so far and the sums over them."""

    def __init__(
        self,
        tiled: Tiled,
        centre: Array,
        level: NDArray[np.int64],
        most: NDArray[np.int64],
        top: Array,
        index: Index,
        lost: NDArray[np.bool_],
        tolerance: float,
        nested: bool,
    ) -> None:
        self.tiled, self.level, self.top, self.index = tiled, level, top, index
        self.tolerance, self.nested, self.most = tolerance, nested, most
        self.spacing = 2.0 ** (-level / 2)
        # Sums lose no digits about a place inside.
        _, origin = tiled(centre[:, None])(index, np.arange(len(index)))
        self.origin = origin[..., 0]
        count, columns = self.origin.shape
        self.sums = np.zeros((count, 1 + 2 * columns, len(_SUBSETS)))
        self.lost = lost.copy()
        self.tiles = np.zeros(count, dtype=np.int64)
        tile = np.floor(centre / (SIDE * self.spacing)).astype(np.int64)
        self.keys, self.faces, self.lines = self.spread(np.arange(count), tile)

    def spread(self, row: Index, tile: NDArray[np.int64]) -> tuple[NDArray[np.int64], Array, Array]:
        """From first tiles (n, 2) of posteriors (n,) to all that hold mass: keys, in order, sides
        (n, 1 + 2C, 8), and the mass of the lines of nodes across either axis (n, 2, SIDE)."""
        keys, faces, lines, seen = [], [], [], np.empty(0, dtype=np.int64)
        while row.size:
            terms, crossing = self.weigh(row, tile)
            starts = np.flatnonzero(np.diff(row, prepend=-1))
            self.sums[row[starts]] += np.add.reduceat(terms[..., :-8], starts)
            self.tiles += np.bincount(row, minlength=len(self.tiles))
            self.lost |= self.tiles > self.most
            keys.append(_key(row, tile))
            faces.append(terms[..., -8:].copy())
            lines.append(crossing)
            seen = np.sort(np.concatenate([seen, keys[-1]]))
            row, tile = self.beyond(keys[-1], faces[-1], seen)
            if not row.size:  # means have moved since the others were looked at
                row, tile = self.beyond(np.concatenate(keys), np.concatenate(faces), seen)
        order = np.argsort(np.concatenate(keys))
        sides, crossed = (np.concatenate(part)[order] for part in (faces, lines))
        return np.concatenate(keys)[order], sides, crossed

    def beyond(
        self, keys: NDArray[np.int64], faces: Array, seen: NDArray[np.int64]
    ) -> tuple[Index, NDArray[np.int64]]:
        """The neighbours, not yet seen, of sides that hold mass."""
        row, tile = _unkey(keys)
        pair, side = np.nonzero(self.shares(row, faces) > EDGE * self.tolerance)
        pair, side = pair[~self.lost[row[pair]]], side[~self.lost[row[pair]]]
        keys = np.unique(_key(row[pair], tile[pair] + _NEIGHBOURS[side]))
        return _unkey(keys[~_among(keys, seen)])

    def shares(self, row: Index, faces: Array) -> Array:
        """What lies beyond each side of each tile, as shares of mass and variances (n, 4).

        If layers go on falling as the last two do from the two before; and twice that.
        """
        columns = self.origin.shape[1]
        mass, mean, _, unit = self.all_moments()
        mean, unit = mean[row, :, None], unit[row, :, None]
        own, first, second = np.split(faces, [1, 1 + columns], axis=1)
        about = second - 2 * mean * first + mean**2 * own
        with np.errstate(invalid="ignore", over="ignore"):
            pull = np.where(unit > 0, about / np.where(unit > 0, unit, 1.0) ** 2, 0.0)
            pull = pull[:, :-1] if self.nested else pull
            # Far quicker than a maximum along an axis this short.
            most = own[:, 0] + reduce(np.maximum, np.moveaxis(pull, 1, 0))
            outer, inner = np.split(most / mass[row, None], 2, axis=1)
            fall = np.minimum(outer / np.where(inner > 0, inner, 1.0), SLOWEST)
        fall = np.where(inner > 0, fall, SLOWEST)
        return np.asarray(2 * outer * fall / (1 - fall))

    def all_moments(self) -> tuple[Array, Array, Array, Array]:
        """Mass (b,), means about the origin, sds, and what their errors are over (b, C)."""
        columns = self.origin.shape[1]
        mass = np.maximum(self.sums[:, 0, 0], np.finfo(float).tiny)
        mean = self.sums[:, 1 : columns + 1, 0] / mass[:, None]
        second = self.sums[:, columns + 1 :, 0] / mass[:, None]
        sd = np.sqrt(np.maximum(second - mean**2, 0.0))
        unit = sd.copy()
        if self.nested:
            unit[:, -2] = np.sqrt(sd[:, -2] ** 2 + np.maximum(self.origin + mean, 0.0)[:, -1])
        return mass, mean, sd, unit

    def water(self) -> Array:
        """Water in the gaps of the marginals along either axis (b, 2)."""
        row, tile = _unkey(self.keys)
        found = []
        for axis in (0, 1):
            own, member = np.unique(_key(row, tile * (axis == _AXES)), return_inverse=True)
            order = np.argsort(member, kind="stable")
            starts = np.searchsorted(member[order], np.arange(own.size))
            line = np.add.reduceat(self.lines[order, axis], starts)
            whose, place = _unkey(own)
            found.append(water_in(whose, place[:, axis], line, len(self.tiles)))
        return np.stack(found, axis=1)

    def weigh(self, row: Index, tile: NDArray[np.int64]) -> tuple[Array, Array]:
        """Sums (n, 1 + 2C, subsets and sides) over tiles: mass, first and second moments.

        And the mass of the lines of nodes across either axis (n, 2, SIDE).
        """
        out = np.empty((len(row), self.sums.shape[1], _MASKS.shape[1]))
        lines = np.empty((len(row), 2, SIDE))
        level = self.level[row]
        order = np.lexsort((tile[:, 1], tile[:, 0], level[:, 1], level[:, 0]))
        size = BATCH // SIDE**2

        def part(start: int) -> None:
            pairs = order[start : start + size]
            named = np.concatenate([level[pairs], tile[pairs]], axis=1)
            new = np.any(np.diff(named, axis=0, prepend=named[:1] - 1) != 0, axis=1)
            named, member = named[new], np.cumsum(new) - 1
            spacing = 2.0 ** (-named[:, None, :2] / 2)
            points = spacing * (named[:, None, 2:] * SIDE + _NODES)
            rows = row[pairs]
            log, values = self.tiled(points)(self.index[rows], member)
            log -= self.top[rows, None]
            weight = np.exp(np.minimum(log, 600.0, out=log), out=log)
            off = values - self.origin[rows, :, None]
            terms = np.empty((len(pairs), out.shape[1], SIDE**2))
            first, second = np.split(terms[:, 1:], 2, axis=1)
            terms[:, 0] = weight
            np.multiply(weight[:, None], off, out=first)
            np.multiply(first, off, out=second)
            sums = terms.reshape(-1, SIDE**2) @ _MASKS  # one product: far quicker than a stack
            out[pairs] = sums.reshape(len(pairs), -1, _MASKS.shape[1])
            lines[pairs] = (weight @ _LINES).reshape(-1, 2, SIDE)

        list(on_threads(part, range(0, len(row), size)))
        return out, lines

    def moments(self) -> tuple[LatticeMoments, NDArray[np.int64]]:
        """What was found, and how much finer (b, 2) a lattice should be."""
        mass, mean, sd, unit = self.all_moments()
        row, tile = _unkey(self.keys)
        shares = self.shares(row, self.faces)
        for side, step in enumerate(_NEIGHBOURS):
            shares[:, side] *= ~_among(_key(row, tile + step), self.keys)
        starts = np.flatnonzero(np.diff(row, prepend=-1))
        edge = np.add.reduceat(shares.sum(axis=1), starts)[:, None]
        changes = [self.change(k, mass, mean, sd, unit) for k in range(1, len(_SUBSETS))]
        second, fourth = changes[:3], changes[3:]
        errors = [
            [claimed_error(a, b) for a, b in zip(two, four, strict=True)]
            for two, four in zip(second, fourth, strict=True)
        ]
        hidden = [(two[0] > LOST)[:, None] for two in second]
        of_mean, of_sd = (
            [np.where(h, 1.0, e[k]) for h, e in zip(hidden, errors, strict=True)] for k in (1, 2)
        )
        mean_error, sd_error = (np.max(parts, axis=0) + edge for parts in (of_mean, of_sd))
        judged = -1 if self.nested else None
        worst = np.maximum(mean_error, sd_error)[:, :judged].max(axis=1)
        alone = np.stack(
            [
                np.maximum(a, b)[:, :judged].max(axis=1)
                for a, b in zip(of_mean[1:], of_sd[1:], strict=True)
            ],
            1,
        )
        rough = alone > self.tolerance / 2
        rough[~rough.any(axis=1)] = True
        spacing = np.log(self.spacing.prod(axis=1))
        own = np.where(sd > 0, unit / np.where(sd > 0, sd, 1.0), 1.0)
        found = LatticeMoments(
            self.origin + mean,
            sd,
            mean_error * own,
            sd_error * own,
            np.log(mass) + self.top + spacing,
            (worst <= self.tolerance) & ~self.lost,
            np.zeros(len(mass), dtype=bool),
        )
        return found, rough * np.where(alone > 0.2, 2, 1)

    def change(
        self, k: int, mass: Array, mean: Array, sd: Array, unit: Array
    ) -> tuple[Array, Array, Array]:
        """What subset k alone makes of ln Z (b,), the means and the sds (b, C), as `passes` has it.

        A function that is the same everywhere has no error.
        """
        columns = self.origin.shape[1]
        part = self.sums[:, :, k]
        known = part[:, 0] > 0
        own = np.where(known, part[:, 0], 1.0)
        of_mass = np.where(known, np.abs(np.log(own * _SUBSETS[k][0] / mass)), np.inf)
        scale = np.where(unit > 0, unit, 1.0)
        first = part[:, 1 : columns + 1] / own[:, None]
        second = part[:, columns + 1 :] / own[:, None]
        width = np.sqrt(np.maximum(second - first**2, 0.0))
        never = np.where(known, 0.0, np.inf)[:, None]
        return of_mass, np.abs(first - mean) / scale + never, np.abs(width - sd) / scale + never


def _key(row: Index, tile: NDArray[np.int64]) -> NDArray[np.int64]:
    """One number for a posterior and a tile; in order of the posteriors."""
    return np.asarray(((row * 2 * _HALF) + tile[:, 0] + _HALF) * 2 * _HALF + tile[:, 1] + _HALF)


def _unkey(key: NDArray[np.int64]) -> tuple[Index, NDArray[np.int64]]:
    """The posterior and the tile of a number."""
    rest, second = np.divmod(key, 2 * _HALF)
    row, first = np.divmod(rest, 2 * _HALF)
    return row, np.stack([first, second], axis=-1) - _HALF


def _among(keys: NDArray[np.int64], known: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which keys are among known ones, which are in order."""
    place = np.searchsorted(known, keys)
    return np.asarray(known[np.minimum(place, len(known) - 1)] == keys)


#: Every how manieth node counts along each axis, after what share that is: all nodes; of every
#: second along both axes and along each alone; and of every fourth.
_SUBSETS = [
    (float(a * b), a, b) for a, b in ((1, 1), (2, 2), (2, 1), (1, 2), (4, 4), (4, 1), (1, 4))
]
#: Sides of a tile: the step to its neighbour there.
_NEIGHBOURS = np.array([(-1, 0), (1, 0), (0, -1), (0, 1)])
#: The two layers of nodes at either side, and the two next to them.
_PAIRS = ((0, SIDE // 2 - 1), (1, SIDE // 2 - 2))
_NODES = np.indices((SIDE, SIDE)).reshape(2, -1).T
_AXES = np.arange(2)
_LINES = np.concatenate([_NODES[:, k, None] == np.arange(SIDE) for k in _AXES], axis=1) * 1.0
_MASKS = np.stack(
    [(_NODES[:, 0] % a == 0) & (_NODES[:, 1] % b == 0) for _, a, b in _SUBSETS]
    + [_NODES[:, k] // 2 == pair for pairs in _PAIRS for k in (0, 1) for pair in pairs],
    axis=1,
).astype(float)
