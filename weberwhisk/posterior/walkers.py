"""emcee on contacts: where the walkers start, and what their sample says."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..coordinates import FARTHEST
from ..observer import Observer
from ..receptors import Events, Seed
from ..threads import on_threads
from .densities import Density
from .ensemble import (
    MoveMaker,
    StackedSample,
    default_moves,
    recommended_walkers,
    sample_stacked,
)
from .grid import integrate
from .mode import Mode
from .moves import StackedGrid
from .nodes import Nodes
from .nuisance import LastUnknown
from .peaks import find_highest, over_all_peaks
from .result import Estimate, Status
from .solution import Array, Solution, is_improbable, is_unidentified, mode_root

#: Monte Carlo error of the sd, over the sd, that emcee goes on for: one unknown, and more.
PRECISION = (0.02, 0.03)
ENSEMBLES = 4
#: Tolerance of the grids that proposals are drawn from: one unknown, and more.
GRID_TOLERANCE = (0.03, 0.2)
#: Steps after which a posterior that has not converged is called so: one unknown, and more.
MOST_STEPS = (20_000, 6_000)
#: The same where a sample will not do anyway.
STEPS_BEYOND = 512
#: Most nodes of such a grid.
MOST_NODES = 20_000
#: Posteriors in one emcee run: enough to share its bookkeeping, few enough for the memory.
STACKED = 1024


def sample(
    observer: Observer, reading: Array, seed: Seed, tolerance: float | None, progress: Any
) -> Solution:
    if isinstance(observer.noise, Events):
        # Few things can happen: each is sampled once.
        each, back = np.unique(reading, axis=0, return_inverse=True)
        if len(each) < len(reading):
            return sample(observer, each, seed, tolerance, progress).of(back.reshape(-1))
    dim = len(observer.unknowns)
    many = int(dim > 1)
    precision = tolerance or PRECISION[many]
    # The grid of pieces belongs to the seed, so that results do not depend on who runs which.
    pieces = range(0, len(reading), STACKED)
    seeds = np.random.SeedSequence(int(np.random.default_rng(seed).integers(2**63))).spawn(
        len(pieces)
    )

    def piece(i: int) -> tuple[StackedSample, Array, NDArray[np.bool_]]:
        rows = reading[pieces[i] : pieces[i] + STACKED]
        rng = np.random.default_rng(seeds[i])
        mode = find_highest(observer, rows)
        apart, beyond = over_all_peaks(observer, rows)

        def density(x: Array, index: NDArray[np.intp]) -> Array:
            value = observer.log_density(x, rows[index, None])
            # Beyond, where contacts stay at an end, a density that stays too would let walkers go.
            return np.where(np.abs(x[..., 0]) < FARTHEST, value, -np.inf)

        def contact(x: Array) -> Array:
            return observer.contact(x)[0]

        found = sample_stacked(
            density,
            _start(density, mode, rng),
            seed=rng,
            moves=_moves(observer, rows, density, mode, apart),
            functions=contact,
            precision=precision,
            # Twice as many draws as it takes when they are independent.
            keep=max(int(0.25 / precision**2), 128),
            max_steps=np.where(beyond, STEPS_BEYOND, MOST_STEPS[many]),
            indexed=True,
        )
        return found, mode.x, beyond

    samples, modes, several = [], [], []
    for found, at_mode, beyond in on_threads(piece, range(len(pieces))):
        samples.append(found)
        modes.append(at_mode)
        several.append(beyond)
        if progress:
            progress(min(len(samples) * STACKED, len(reading)), len(reading))
    joined = {
        name: np.concatenate([getattr(s, name) for s in samples])
        for name in ("mean", "sd", "mcse_mean", "mcse_sd", "shortfall")
    }
    values = [part for s in samples for part in s.values]  # each (E, N, U)
    estimates = [
        Estimate(*(joined[key][:, i] for key in ("mean", "sd", "mcse_mean", "mcse_sd")))
        for i in range(dim)
    ]
    highest = observer.contact(np.concatenate(modes))[0]
    # Of one unknown the prior is as good as any reading; of several one may be known by a ridge.
    status = np.full(len(reading), Status.CONVERGED)
    if many:
        status[is_unidentified(observer, highest)] = Status.UNIDENTIFIED
    status[is_improbable(observer, reading, highest)] = Status.IMPROBABLE_READING
    status[joined["shortfall"] != 0] = Status.NOT_CONVERGED
    status[np.concatenate(several)] = Status.SEVERAL_PEAKS

    def quantile_of(p: Array, unknown: int) -> Array:
        return np.stack([np.quantile(v[..., unknown], p) for v in values])

    def draws_of(count: int, seed: Seed) -> Array:
        return np.stack([v[:, -count:] for v in values])

    evidence = np.full(len(reading), np.nan)
    return Solution(estimates, status.astype(np.int8), evidence, quantile_of, draws_of)


def _moves(
    observer: Observer, reading: Array, density: Density, mode: Mode, apart: dict[int, Nodes]
) -> list[tuple[MoveMaker, float]]:
    """Most steps are drawn anew from a coarse grid over the posterior, or from one `apart`.

    It takes 50 evaluations with one unknown and a thousand with two, and then a step is nearly an
    independent draw, where differential evolution needs five to nine or, on a bent ridge, hundreds.
    A finer grid is hardly a better proposal: with two unknowns 85 % are accepted at a tolerance
    of 0.1, 83 % at 0.2. A coarser one misses tails, in which walkers then linger. With three
    unknowns and more the grid is over all but the last, which is nearly normal at every node.
    """
    dim = mode.x.shape[1]
    others = default_moves(dim)
    tolerance = GRID_TOLERANCE[int(dim > 1)]
    if dim > 2:
        engine = LastUnknown(observer, reading, mode, tolerance)
        grid = engine.on_grid(max_points=MOST_NODES, keep_points=True)
    else:
        grid = integrate(
            density,
            mode.x,
            mode_root(mode),
            tolerance=tolerance,
            max_points=MOST_NODES,
            keep_points=True,
        )
    assert grid.nodes is not None
    nodes = [apart.get(row, of_one) for row, of_one in enumerate(grid.nodes)]
    last = [_last(observer, of_one) for of_one in nodes] if dim > 2 else None
    guess = partial(StackedGrid, nodes=nodes, last=last)
    return [(guess, 9 * sum(weight for _, weight in others)), *others]


def _last(observer: Observer, nodes: Nodes) -> Array:
    """Sd, mean and the mean's slopes (N, 1 + D) of the last coordinate, from the unknown's own."""
    assert nodes.values is not None
    mean, variance = nodes.values[:, -2:].T
    z = np.linspace(-8.0, 8.0, 4001)
    value = observer.last_unknown(z)
    low, middle, high = (np.interp(mean + s * np.sqrt(variance), value, z) for s in (-1, 0, 1))
    known = high > low  # elsewhere are nodes that hold nothing
    table = np.where(known, middle, np.nan).reshape(nodes.shape)
    slopes = [np.nan_to_num(np.gradient(table, axis=k)).ravel() for k in range(table.ndim)]
    return np.stack([np.where(known, (high - low) / 2, 1.0), middle, *slopes], axis=-1)


def _start(density: Density, mode: Mode, rng: np.random.Generator) -> Array:
    """Walkers (B, E, W, U) about the modes, wider than the posterior, all inside its support."""
    count, dim = mode.x.shape
    shape = (count, ENSEMBLES, recommended_walkers(dim), dim)
    root = mode_root(mode, widen=1.5)
    middle = mode.x.copy()
    middle[:, 0] = np.clip(middle[:, 0], -0.99 * FARTHEST, 0.99 * FARTHEST)
    z = rng.standard_normal(shape)
    for _ in range(30):  # draw in towards the mode what has fallen outside
        x = middle[:, None, None] + np.einsum("bde,bnwe->bnwd", root, z)
        value = np.asarray(density(x.reshape(count, -1, dim), np.arange(count)))
        bad = ~np.isfinite(value).reshape(shape[:3])
        if not bad.any():
            break
        z = np.where(bad[..., None], 0.5 * z, z)
    return x
