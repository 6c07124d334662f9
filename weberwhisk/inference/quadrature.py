"""Quadrature, the reference: panels for one unknown, tiles for more; which serve which readings.

Many readings share one tiling of all contacts, kept with the observer and certified when it is
made, by a finer one. A few readings, and those that the whole tiling does not serve (none of its
tiles is near, or the mass is on hardly a node), get tiles of their own, finer until two of them
agree. What would take too many tiles gets a plain grid.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import lru_cache, partial
from typing import Any, NamedTuple

import numpy as np

from .._values import Array, Flags, Index
from ..mechanics.contact import Outcome
from ..receptors import Seed
from ..threads import on_threads
from .azimuth_nodes import AroundNodes
from .azimuths import AroundGrid, around, starts
from .friction import FrictionSums, friction_rows
from .grid import OwnGrids
from .laplace import find_mode
from .marginals import by_draws, draws, tile_quantiles
from .nodes import MECHANICAL, NodeSums, turning_unknown
from .observer import Observer
from .panels import panels_of
from .result import (
    Estimate,
    Solution,
    Status,
    among,
    is_improbable,
    is_outside,
    is_unidentified,
    joined,
    refuse_impossible,
)
from .summed import LastSummed, likelihood_of
from .summed_tiles import SummedTiles
from .tiled import Moments, TiledObserver
from .tiling import Tiles, TooManyTiles, expected_tiles, tiles_of


def longest(tolerance: float) -> float:
    """Length of tiles, in sd, for a tolerance.

    Largest errors of 600 readings over the whole reach, k = 0.03 and 0.1 to 0.3: at 5.5 sd 3e-4 and
    4e-5 of the sd, at 4.4 sd 4e-5 and 2e-5, a cylinder's and a cone's too.
    """
    return float(5.5 if tolerance > 2e-3 else 4.4 * min(1.0, (tolerance / 1e-4) ** 0.1))


class _Found(NamedTuple):
    """Moments of some readings (n,), and the errors of mean and sd in sds, (n, U)."""

    rows: Index
    tiled: TiledObserver | OwnGrids | NodeSums | FrictionSums
    moments: Moments
    error: Array


def _by_panels(observer: Observer, reading: Array, wanted: float) -> Solution:
    """The posteriors of one unknown; an odd reading's may be off by 1e-2 of its sd."""
    panels = panels_of(observer)
    m = panels.moments(reading)
    error = np.maximum(m.mean_error, m.sd_error) / m.sd
    status = np.where(error <= wanted, Status.CONVERGED, Status.IMPRECISE)
    # Of an odd reading digits are of no interest, but numbers that may be anything are.
    odd = m.improbable & (error <= max(wanted, 1e-2))
    status = np.where(odd, Status.IMPROBABLE_READING, status)

    def quantile_of(p: Array, unknown: int) -> Array:
        return panels.quantiles(reading, p)

    def quantile_error_of(p: Array, unknown: int) -> Array:
        """The panels' own estimate, as a share of mass that may lie on the wrong side; and what
        cubics between nodes miss: 5e-6 sd at most beside sums, k = 0.03 to 0.3.
        """
        return np.asarray(m.sd[:, None] * (1e-5 + error[:, None] / (4 * p * (1 - p))))

    def draws_of(count: int, seed: Seed) -> Array:
        u = _stratified(len(reading), count, seed)
        return panels.quantiles(reading, u).reshape(len(reading), 4, -1, 1)

    estimate = Estimate(m.mean, m.sd, m.mean_error, m.sd_error)
    return Solution(
        [estimate],
        status.astype(np.int8),
        m.log_evidence,
        quantile_of,
        draws_of,
        quantile_error_of,
    )


def _stratified(rows: int, count: int, seed: Seed) -> Array:
    """Probabilities (rows, 4·count), one from each stratum, in random order: four chains."""
    rng = np.random.default_rng(seed)
    u = (np.arange(4 * count) + rng.random((rows, 4 * count))) / (4 * count)
    return rng.permuted(np.clip(u, 1e-12, 1 - 1e-12), axis=1)


def quadrature(
    observer: Observer, reading: Array, seed: Seed, tolerance: float | None, progress: Any
) -> Solution:
    """The reference: panels for one unknown, tiles for more."""
    if len(observer.unknowns) > 4:
        raise ValueError(
            f"Quadrature sums over four unknowns at most, got {len(observer.unknowns)} "
            f"({', '.join(observer.unknowns)}); give one of them, as Friction(cue, angle) does, "
            'or write method="laplace" for a quick look.'
        )
    if len(observer.unknowns) == 1:
        return _by_panels(observer, reading, tolerance or 1e-6)
    wanted = tolerance or 1e-2
    length = longest(wanted)
    found: list[_Found] = []
    left = np.arange(len(reading))
    if observer.forward.azimuth is not None:
        found = _around(observer, reading, wanted, progress)
        left = np.setdiff1d(left, [f.rows[0] for f in found]).astype(np.intp)
    elif observer.bounded == 2 and observer.unknowns[2:] == ("friction_angle",):
        found, left = _by_friction(observer, reading, wanted, progress)
    elif observer.space.angle_range_varies and (name := turning_unknown(observer)) is not None:
        found, left = _by_nodes(observer, name, reading, length, wanted, progress)
    # A tile of the whole takes 0.1 ms, tiles of a reading's own take 10 ms.
    elif len(reading) > 20 + min(expected_tiles(observer, length), MOST_TILES) / 100:
        whole = _whole(observer, length)
        if whole is not None:
            served, left = _by_whole(observer, reading, whole, wanted)
            found.append(served)
    # Tiles of three unknowns that all signals tell of would be too many.
    tiled = left if observer.forward.azimuth is None else left[:0]
    pieces = [tiled[i : i + 64] for i in range(0, len(tiled), 64)]
    by_own = partial(_by_own, observer, reading, length=length, wanted=wanted)
    for own in on_threads(by_own, pieces):
        found += own
        if progress:
            progress(sum(len(f.rows) for f in found), len(reading))
    done = np.zeros(len(reading), dtype=bool)
    for part in found:
        done[part.rows] = True
    for row in np.flatnonzero(~done):
        grid = OwnGrids(observer, reading[[row]])
        found.append(_Found(np.array([row]), grid, grid.moments, grid.error))
    if progress:
        progress(len(reading), len(reading))
    return _solution(observer, reading, found, wanted)


def _by_nodes(
    observer: Observer, name: str, reading: Array, length: float, wanted: float, progress: Any
) -> tuple[list[_Found], Index]:
    """What sums over nodes of an unknown find, and which readings they do not serve."""
    return _by_sums(
        lambda some: NodeSums(observer, name, some, length, wanted, _tiled), reading, progress
    )


def _by_friction(
    observer: Observer, reading: Array, wanted: float, progress: Any
) -> tuple[list[_Found], Index]:
    """What sums over rows of one distance each find, and which readings they do not serve."""
    rows = friction_rows(observer)
    if rows.coarse:
        return [], np.arange(len(reading))
    return _by_sums(lambda some: FrictionSums(rows, some, wanted), reading, progress)


def _by_sums(
    sums_of: Callable[[Array], NodeSums | FrictionSums], reading: Array, progress: Any
) -> tuple[list[_Found], Index]:
    found: list[_Found] = []
    left = np.ones(len(reading), dtype=bool)
    for start in range(0, len(reading), 512):
        sums = sums_of(reading[start : start + 512])
        left[start + sums.rows] = False
        if sums.rows.size:
            found.append(_Found(start + sums.rows, sums, sums.moments, sums.error))
        if progress:
            progress(min(start + 512, len(reading)), len(reading))
    return found, np.flatnonzero(left)


def _around(observer: Observer, reading: Array, wanted: float, progress: Any) -> list[_Found]:
    """What slices of contacts in space find, of the readings that they serve."""
    found: list[_Found] = []
    frame = around(observer)
    grids: Iterable[OwnGrids | None] = ()
    if frame is not None:  # what no contact explains has no highest point
        some = starts(frame, reading)
        grids = (AroundGrid(frame, s) if np.isfinite(s.height.max()) else None for s in some)
    elif observer.unknowns[2:-1] == ("azimuth",) and observer.unknowns[-1] in MECHANICAL:
        grids = (AroundNodes(observer, one, wanted) for one in reading)
    for row, grid in enumerate(grids):
        if grid is not None and (grid.error <= wanted).all():
            found.append(_Found(np.array([row]), grid, grid.moments, grid.error))
        if progress:
            progress(row + 1, len(reading))
    return found


#: Most tiles of a whole tiling of two unknowns: 2 kB each, and six times that of three.
MOST_TILES = 80_000


class _Whole(NamedTuple):
    """A tiling of all contacts, and what errors (U,) its mean and sd have, in sds."""

    tiled: TiledObserver
    error: Array


@lru_cache(maxsize=8)
def _whole(observer: Observer, length: float, *, certifying: int = 128) -> _Whole | None:
    """An observer's whole tiling, if it does not take too many tiles.

    The errors are half more than the largest of `certifying` readings of contacts drawn from the
    prior, beside tiles shorter by a factor of 1.4.
    """
    try:
        likelihood = likelihood_of(observer)
        if likelihood.turns:
            return None  # some 4000 tiles of 20 kB, and their certificate takes minutes
        most = MOST_TILES // 6 ** (likelihood.dim - 2)
        tiled = _tiled(observer, tiles_of(observer, length, most=most), length)
    except TooManyTiles:
        return None
    rng = np.random.default_rng(20261122)
    weight = np.exp(tiled.log_weight - tiled.log_weight.max()).ravel()
    node = rng.choice(len(weight), certifying, p=weight / weight.sum())
    contact = tiled.tiles.nodes.contact.reshape(-1, tiled.dim)[node]
    if isinstance(likelihood, LastSummed):
        z = np.clip(rng.standard_normal(certifying), -3, 3)
        contact = likelihood.with_last(contact, z)
    signals, outcome = observer.signals(contact)
    reading = observer.noise.sample(signals[outcome == Outcome.HELD], rng)
    try:
        tiles = tiles_of(observer, length / 1.4, reading, deep=False)
    except TooManyTiles:
        return None  # no whole tiling without its certificate
    fine = _tiled(observer, tiles, length / 1.4)
    moments = tiled.moments(reading)
    error = _difference(moments, fine.moments(reading))[_served(tiled, reading, moments)]
    return _Whole(tiled, np.maximum(1.5 * error.max(axis=0, initial=0.0), 5e-5))


def _tiled(
    observer: Observer, tiles: Tiles, length: float, *, everywhere: bool = False
) -> TiledObserver:
    """What sums over an observer's tiles."""
    likelihood = likelihood_of(observer)
    if isinstance(likelihood, LastSummed):
        return SummedTiles(likelihood, tiles, length, everywhere=everywhere)
    return TiledObserver(observer, tiles, length, everywhere=everywhere)


def _difference(one: Moments, other: Moments) -> Array:
    """By how much means and sds differ, whichever is more, (B, U), in sds of the other."""
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.abs(one.mean - other.mean) / other.sd
        return np.maximum(mean, np.abs(one.sd / other.sd - 1))


def _by_whole(
    observer: Observer, reading: Array, whole: _Whole, wanted: float
) -> tuple[_Found, Index]:
    """What the whole tiling finds, and which readings it does not serve."""
    tiled, error = whole
    parts = [slice(i, i + 1024) for i in range(0, len(reading), 1024)]
    found = on_threads(lambda part: tiled.moments(reading[part]), parts)
    moments = joined(list(found))
    served = np.asarray(_served(tiled, reading, moments) & bool((error <= wanted).all()))
    errors = np.broadcast_to(error, (int(served.sum()), len(error)))
    rows = np.arange(len(reading))
    return _of(served, rows, tiled, moments, errors), np.flatnonzero(~served)


def _served(tiled: TiledObserver, reading: Array, moments: Moments) -> Flags:
    """Of which readings (B,) the sums over a whole tiling are to be believed."""
    served = np.isfinite(moments.sd).all(axis=1) & (moments.rough < 1e-4)
    served &= moments.share < 0.35  # else it is narrower than its reading should be
    # Far from all contacts the density is not as wide as the tiles expect.
    low, high = tiled.observer.noise.interval(moments.signals, 6.5)
    return np.asarray(served & ((low <= reading) & (reading <= high)).all(axis=1))


def _by_own(
    observer: Observer,
    reading: Array,
    rows: Index,
    length: float,
    wanted: float,
    *,
    deep: bool = False,
    everywhere: bool = False,
) -> list[_Found]:
    """Tiles of some readings' own, finer and finer until they agree with the coarser ones."""
    tiles = partial(tiles_of, observer, everywhere=everywhere, deep=deep)
    tiled = partial(_tiled, observer, everywhere=everywhere)
    out: list[_Found] = []
    try:
        coarse = tiled(tiles(length, reading[rows]), length)
        moments = coarse.moments(reading[rows])
    except TooManyTiles:
        if len(rows) > 1:
            for half in np.array_split(rows, 2):
                out += _by_own(observer, reading, half, length, wanted, deep=deep)
        return out
    far = ~np.isfinite(moments.sd).all(axis=1)
    if everywhere:
        refuse_impossible(reading[rows], moments.log_evidence)
    else:
        for row in rows[far]:  # far from all contacts
            one = np.array([row])
            out += _by_own(observer, reading, one, length, wanted, deep=True, everywhere=True)
    hidden = (moments.rough > 1e-5) & ~far & (not deep)
    for row in rows[hidden]:  # where hardly any contacts are
        out += _by_own(observer, reading, np.array([row]), length, wanted, deep=True)
    rows, moments = rows[~far & ~hidden], among(moments, ~far & ~hidden)
    start, error = length, np.full(moments.mean.shape, np.inf)
    while rows.size and length > start / 1.5**3.5:
        try:
            fine = tiled(tiles(length / 1.5, reading[rows]), length / 1.5)
            beside = fine.moments(reading[rows])
        except TooManyTiles:
            if len(rows) > 1 and length == start:
                for half in np.array_split(rows, 2):
                    out += _by_own(observer, reading, half, start, wanted, deep=deep)
                return out
            break
        length /= 1.5
        error = np.maximum(2 * _difference(moments, beside), min(5e-5, wanted / 2))
        good = np.asarray((error <= wanted).all(axis=1))
        out.append(_of(good, rows, coarse, moments, error[good]))
        rows, error, coarse = rows[~good], error[~good], fine
        moments = among(beside, ~good)
    out.append(_of(np.ones(len(rows), dtype=bool), rows, coarse, moments, error))
    return out


def _of(some: Flags, rows: Index, tiled: TiledObserver, moments: Moments, error: Array) -> _Found:
    return _Found(rows[some], tiled, among(moments, some), error)


def _solution(observer: Observer, reading: Array, found: list[_Found], wanted: float) -> Solution:
    found = [f for f in found if f.rows.size]
    dim, count = len(observer.unknowns), len(reading)
    mean, sd, error = np.full((3, count, dim), np.nan)
    log_evidence = np.full(count, np.nan)
    status = np.full(count, Status.CONVERGED, dtype=np.int64)
    signals = np.ones((count, len(observer.cue.signal_names)))
    contact = np.ones((count, dim))
    for part in found:
        rows, moments = part.rows, part.moments
        if not part.tiled.count:  # no contact explains these readings at all
            status[rows] = Status.IMPROBABLE_READING
            continue
        mean[rows], sd[rows] = moments.mean, moments.sd
        error[rows] = part.error + moments.misfit[:, None] / 2
        log_evidence[rows] = moments.log_evidence
        signals[rows], contact[rows] = moments.signals, moments.contact
        if not isinstance(part.tiled, NodeSums | FrictionSums):
            error[rows] += likelihood_of(observer).unsure
    known = np.isfinite(sd).all(axis=1)
    with np.errstate(invalid="ignore"):
        status[~(error <= wanted).all(axis=1)] = Status.IMPRECISE
        precise = (error < 0.3).all(axis=1)  # else that is worse news than a ridge
    some = np.flatnonzero(known)
    ridge = np.zeros(count, dtype=bool)
    ridge[some] = is_unidentified(observer, contact[some])
    status[ridge & ((status != Status.IMPRECISE) | precise)] = Status.UNIDENTIFIED
    right = np.isin(status, (Status.CONVERGED, Status.UNIDENTIFIED)) & known
    outside = is_outside(observer.noise, reading, signals)
    status[right & outside] = Status.IMPROBABLE_READING
    status[~known & (status != Status.IMPROBABLE_READING)] = Status.IMPRECISE
    # Where no contact explains a reading the mass may be on one node, which has no width.
    vague = np.flatnonzero((status == Status.IMPRECISE) & outside)
    if vague.size:
        at = observer.contact(find_mode(observer, reading[vague]).x)[0]
        vague = vague[is_improbable(observer, reading[vague], at)]
        status[vague] = Status.IMPROBABLE_READING
    own_grid = np.zeros(count, dtype=bool)
    for part in found:
        own_grid[part.rows] = isinstance(part.tiled, OwnGrids)

    kept: dict[tuple[tuple[float, ...], int], tuple[Array, Array]] = {}

    def both(p: tuple[float, ...], unknown: int) -> tuple[Array, Array]:
        """Quantiles (B, Q) and their errors: of reading them off, and of the tiles' sums.

        A share of the mass that moves the mean by its error may lie on the wrong side.
        """
        if (p, unknown) not in kept:
            # An angle whose range turns with a third unknown is cut by no line alike.
            turning = 1 if observer.space.angle_range_varies else None
            # An angle takes many times as long as a distance, which comes with it for little.
            several = [unknown]
            if unknown not in (0, turning):
                several = [i for i in range(dim) if i != turning]
            value, off = np.full((2, dim, count, len(p)), np.nan)
            for part in found:
                rows, args = part.rows, (reading[part.rows], np.array(p))
                if isinstance(part.tiled, OwnGrids | NodeSums | FrictionSums):
                    for i in several:
                        value[i, rows], off[i, rows] = part.tiled.quantiles(args[1], i)
                elif unknown == turning:
                    value[unknown, rows], off[unknown, rows] = by_draws(part.tiled, *args, unknown)
                else:
                    value[:, rows], off[:, rows] = tile_quantiles(
                        part.tiled, *args, several, 0.5 * error[rows]
                    )
            kept.update({(p, i): (value[i], off[i]) for i in several})
        return kept[p, unknown]

    def quantile_of(p: Array, unknown: int) -> Array:
        return both(tuple(p), unknown)[0].copy()

    def quantile_error_of(p: Array, unknown: int) -> Array:
        return both(tuple(p), unknown)[1].copy()

    def draws_of(number: int, seed: Seed) -> Array:
        rng = np.random.default_rng(seed)
        out = np.full((count, 4 * number, dim), np.nan)
        for part in found:
            if isinstance(part.tiled, OwnGrids | NodeSums | FrictionSums):
                out[part.rows] = part.tiled.draws(4 * number, rng)
                continue
            x = draws(part.tiled, reading[part.rows], 4 * number, rng)
            out[part.rows] = part.tiled.completed(reading[part.rows], x, rng)
        return out.reshape(count, 4, number, dim)

    estimates = [
        Estimate(mean[:, i], sd[:, i], error[:, i] * sd[:, i], error[:, i] * sd[:, i])
        for i in range(dim)
    ]
    return Solution(
        estimates,
        status.astype(np.int8),
        log_evidence,
        quantile_of,
        draws_of,
        quantile_error_of,
        own_grid,
    )
