"""emcee on contacts: where the walkers start, what they propose, and what their sample says.

The default owes nothing to quadrature, so that it can check it: differential evolution and
stretches inside each ensemble, and draws from the mixture that the walkers start from, which takes
the best places of a scatter of the prior with the Fisher information there.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from scipy.special import expit

from .._checks import one_of
from .._values import Array, Flags, Index
from ..receptors import Seed
from ..threads import on_threads
from .coordinates import FARTHEST
from .ensemble import StackedSample, sample_stacked
from .laplace import climb, density_at, is_divided, prior_precision, score
from .moves import MoveMaker, StackedMixture, default_moves, recommended_walkers, student_t
from .observer import Observer
from .panels import panels_of
from .quadrature import quadrature
from .result import Estimate, Solution, Status, is_improbable, is_unidentified, refuse_impossible

Density = Callable[[Array, Index], Array]
#: Monte Carlo error of the sd, over the sd, that emcee goes on for, and the steps after which a
#: posterior that has not converged is called so: one unknown, and more.
PRECISION, MOST_STEPS = (0.02, 0.03), (20_000, 6_000)
#: Steps after which what has not converged gets proposals that have learnt from its draws.
STAGES = (96, 384, 1024)


class Mixture(NamedTuple):
    """Of each posterior: places (B, K, U), roots of covariances (B, K, U, U), weights (B, K)."""

    centre: Array
    root: Array
    weight: Array


def sample(
    observer: Observer,
    reading: Array,
    seed: Seed,
    tolerance: float | None,
    progress: Any,
    *,
    moves: str = "independent",
    stacked: int = 1024,
) -> Solution:
    """Posteriors of readings (B, R), as many as `stacked` in one run: its size is the memory's."""
    one_of("moves", moves, ("independent", "grid"))
    if observer.noise.is_categorical:
        # Few things can happen: each is sampled once.
        each, back = np.unique(reading, axis=0, return_inverse=True)
        if len(each) < len(reading):
            once = sample(observer, each, seed, tolerance, progress, moves=moves)
            return once.of(back.reshape(-1))
    dim = len(observer.unknowns)
    several = int(dim > 1)
    precision = tolerance or PRECISION[several]
    # The grid of pieces belongs to the seed, so that results do not depend on who runs which.
    pieces = range(0, len(reading), stacked)
    seeds = np.random.SeedSequence(int(np.random.default_rng(seed).integers(2**63))).spawn(
        len(pieces)
    )

    def piece(i: int) -> tuple[StackedSample, Array]:
        rows = reading[pieces[i] : pieces[i] + stacked]
        rng = np.random.default_rng(seeds[i])
        mixture, mode = fisher_mixture(observer, rows)
        first = mixture
        stages: tuple[int, ...] = (*STAGES, MOST_STEPS[several])
        if moves == "grid":
            stages = stages[-1:]
            mixture = _adapted(observer, rows, first, _from_quadrature(observer, rows, rng))
        todo = np.arange(len(rows))
        fields: dict[str, Any] = {}
        for most in stages:

            def density(x: Array, index: Index, todo: Any = todo) -> Array:
                value = observer.log_density(x, rows[todo[index], None])
                # Beyond, where contacts stay at an end, a density that does would let walkers go.
                return np.where(np.abs(x[..., 0]) < FARTHEST, value, -np.inf)

            found = sample_stacked(
                density,
                _start(density, mixture, mode[todo], rng),
                seed=rng,
                moves=_moves(mixture, dim, 9.0 if moves == "grid" else 1.0),
                functions=lambda x: observer.contact(x)[0],
                precision=precision,
                # Twice as many draws as it takes when they are independent.
                keep=max(int(0.25 / precision**2), 128),
                max_steps=most,
                indexed=True,
            )
            for name, value in vars(found).items():
                fields.setdefault(name, np.empty((len(rows), *value.shape[1:]), value.dtype))
                fields[name][todo] = value
            left = np.flatnonzero(found.shortfall)
            if not left.size or most == stages[-1]:
                break
            todo = todo[left]
            draws = found.values[left].reshape(len(left), -1, dim)
            mixture = _adapted(observer, rows[todo], Mixture(*(m[todo] for m in first)), draws)
        return StackedSample(**fields), observer.contact(mode)[0]

    samples, modes = [], []
    for found, mode in on_threads(piece, range(len(pieces))):
        samples.append(found)
        modes.append(mode)
        if progress:
            progress(min(len(samples) * stacked, len(reading)), len(reading))
    return _solution(observer, reading, samples, np.concatenate(modes))


def _solution(
    observer: Observer, reading: Array, samples: Sequence[StackedSample], mode: Array
) -> Solution:
    joined = {
        name: np.concatenate([getattr(s, name) for s in samples])
        for name in ("mean", "sd", "mcse_mean", "mcse_sd", "shortfall")
    }
    values = [part for s in samples for part in s.values]  # each (E, N, U)
    estimates = [
        Estimate(*(joined[key][:, i] for key in ("mean", "sd", "mcse_mean", "mcse_sd")))
        for i in range(mode.shape[1])
    ]
    # Of one unknown the prior is as good as any reading; of several one may be known by a ridge.
    status = np.full(len(reading), Status.CONVERGED)
    if mode.shape[1] > 1:
        status[is_unidentified(observer, mode)] = Status.UNIDENTIFIED
    status[is_improbable(observer, reading, mode)] = Status.IMPROBABLE_READING
    status[_missing_peaks(observer, reading, estimates[0])] = Status.SEVERAL_PEAKS
    status[joined["shortfall"] != 0] = Status.NOT_CONVERGED

    def quantile_of(p: Array, unknown: int) -> Array:
        return np.stack([np.quantile(v[..., unknown], p) for v in values])

    def draws_of(count: int, seed: Seed) -> Array:
        return np.stack([v[:, -count:] for v in values])

    evidence = np.full(len(reading), np.nan)
    return Solution(estimates, status.astype(np.int8), evidence, quantile_of, draws_of)


def _missing_peaks(observer: Observer, reading: Array, sampled: Estimate) -> Flags:
    """Of which posteriors of one unknown (B,), their mass being apart, walkers missed some.

    No diagnostic of the walkers sees a peak where none of them is, so these are held against
    quadrature: one of 40 readings of two modes of vibration had an sd ten times too small.
    """
    missing = is_divided(observer, reading)
    if missing.any():
        exact = panels_of(observer).moments(reading[missing])
        mean, sd, *errors = (column[missing] for column in sampled)
        off = np.abs([exact.mean - mean, exact.sd - sd])
        missing[missing] = (off > 4 * np.array(errors)).any(axis=0)
    return missing


def _moves(mixture: Mixture, dim: int, share: float) -> list[tuple[MoveMaker, float]]:
    """Draws from a mixture, so many times as often as local steps.

    Half of the steps are local where it starts from the prior: they find what it misses, and it
    learns of that. With six draws to a step three sds of 128 were 10 to 16 % off unsaid.
    """
    local = default_moves(dim)
    return [(partial(StackedMixture, *mixture), share * sum(s for _, s in local)), *local]


def fisher_mixture(
    observer: Observer, reading: Array, *, places: int = 6, prior_share: float = 0.1
) -> tuple[Mixture, Array]:
    """A mixture of t's like each posterior, by the Fisher information, and the modes (B, U).

    The best places of a scatter of the prior, none next to another, climb by Fisher scoring until
    they are among the bulk of what is about them (a Newton decrement of √(2U) sds), the best of
    them on to its peak. About each the mixture has the inverse of the information, with a weight of
    the mass that this would be; a `prior_share` is as wide as the scatter.
    """
    scatter, shape = _scatter(observer)
    dim, density = scatter.shape[1], density_at(observer, scatter)
    best = np.concatenate(
        [
            _best_places(density, reading[start : start + 256], shape, places)
            for start in range(0, len(reading), 256)
        ]
    )
    count = best.shape[1]
    owner = np.repeat(np.arange(len(reading)), count)
    x, top, covariance = climb(observer, reading[owner], scatter[best.ravel()], 2.0 * dim, 15)
    top = top.reshape(-1, count)
    highest = np.arange(len(reading)) * count + top.argmax(axis=1)
    mode, peak, at_mode = climb(observer, reading, x[highest], 1e-4, 25)
    centre = np.concatenate([x.reshape(-1, count, dim), mode[:, None]], axis=1)
    shape_of = (len(reading), count, dim, dim)
    spread = np.concatenate([covariance.reshape(shape_of), at_mode[:, None]], axis=1)
    mass = np.concatenate([top, peak[:, None]], axis=1) + 0.5 * np.linalg.slogdet(spread)[1]
    weight = np.exp(mass - mass.max(axis=1, keepdims=True))
    weight = 0.8 * weight / weight.sum(axis=1, keepdims=True) + 0.2 / weight.shape[1]
    prior = np.broadcast_to(np.cov(scatter.T).reshape(dim, dim), (len(reading), 1, dim, dim))
    middle = np.broadcast_to(scatter.mean(axis=0), (len(reading), 1, dim))
    return Mixture(
        np.concatenate([centre, middle], axis=1),
        np.linalg.cholesky(np.concatenate([spread, prior], axis=1)),
        np.pad((1 - prior_share) * weight, ((0, 0), (0, 1)), constant_values=prior_share),
    ), mode


def _adapted(
    observer: Observer,
    reading: Array,
    mixture: Mixture,
    contact: Array,
    *,
    draws: int = 192,
    kernels: int = 32,
    width: float = 0.8,
    even: float = 0.2,
) -> Mixture:
    """The mixture with further kernels about draws (B, N, U) of an earlier run.

    Where draws lie that the mixture has too low, there it gets kernels, one by one, as wide as the
    information there says (as in incremental mixture importance sampling, Raftery & Bao 2010,
    Biometrics 66, 1162). In the end each weighs as many draws as it explains.
    """
    count, dim = len(reading), contact.shape[2]
    contact = contact[:, np.linspace(0, contact.shape[1] - 1, draws).round().astype(int)]
    with np.errstate(divide="ignore", invalid="ignore"):  # at an edge, to rounding
        x = observer.coordinates(contact)
    inside = np.isfinite(x).all(axis=2, keepdims=True) & (np.abs(x[..., :1]) < FARTHEST)
    x = np.where(inside, x, mixture.centre[:, -2:-1])
    log = observer.log_density(x, reading[:, None])
    each = student_t(x, mixture.centre, np.asarray(np.linalg.inv(mixture.root), dtype=float))
    weight = mixture.weight
    index, owner = np.arange(count), np.repeat(np.arange(count), draws)
    _, _, information = score(observer, reading[owner], x.reshape(-1, dim))
    root = width * np.linalg.cholesky(np.linalg.inv(information + prior_precision(observer)))
    root = root.reshape(count, draws, dim, dim)
    inverse = np.linalg.inv(root)
    chosen = np.empty((count, kernels), dtype=int)
    mixed = np.einsum("bmk,bk->bm", each, weight)
    added = []
    for k in range(kernels):
        chosen[:, k] = best = (log - np.log(mixed)).argmax(axis=1)
        own = student_t(x, x[index, best][:, None], inverse[index, best][:, None])
        added.append(own)
        mixed += own[..., 0] / kernels
    row = index[:, None]
    centre = np.concatenate([x[row, chosen], mixture.centre], axis=1)
    root = np.concatenate([root[row, chosen], mixture.root], axis=1)
    each = np.concatenate([*added, each], axis=2)
    weight = np.full(centre.shape[:2], 1 / centre.shape[1])
    for _ in range(5):
        mixed = np.einsum("bmk,bk->bm", each, weight)
        explained = weight * np.einsum("bm,bmk->bk", 1 / mixed, each) / draws
        weight = (1 - even) * explained + even / weight.shape[1]
    return Mixture(centre, root, weight / weight.sum(axis=1, keepdims=True))


def _scatter(observer: Observer) -> tuple[Array, tuple[int, ...]]:
    """Coordinates (n, U) all over the prior, and the shape of the grid they are on."""
    dim, bounded = len(observer.unknowns), observer.bounded
    along, others = {1: (257, 1), 2: (45, 9)}.get(dim, (25, 5))
    x = observer.space.spread(expit(np.linspace(-7.0, 6.0, along)), others=others)
    return x, (along,) * bounded + (others,) * (dim - bounded)


def _best_places(
    density: Callable[[Array], Array], reading: Array, shape: tuple[int, ...], places: int
) -> Index:
    """Which of a grid's places (B, K) are best, each at least two steps from the others."""
    table = density(reading)
    refuse_impossible(reading, table.max(axis=1))
    grid = np.stack(np.unravel_index(np.arange(table.shape[1]), shape), axis=-1)
    near = [np.flatnonzero((np.abs(grid - at) <= 2).all(axis=1)) for at in grid]
    best = np.empty((len(reading), places), dtype=np.intp)
    for k in range(places):
        best[:, k] = table.argmax(axis=1)
        lost = np.isneginf(table[np.arange(len(table)), best[:, k]])
        best[lost, k] = best[lost, 0]
        for row, at in enumerate(best[:, k]):
            table[row, near[at]] = -np.inf
    return best


def _from_quadrature(observer: Observer, reading: Array, rng: np.random.Generator) -> Array:
    """Draws (B, N, U) of the contact by quadrature."""
    draws = quadrature(observer, reading, rng, None, None).draws_of(48, rng)
    return draws.reshape(len(reading), -1, draws.shape[-1])


def _start(density: Density, mixture: Mixture, mode: Array, rng: np.random.Generator) -> Array:
    """Walkers (B, E, W, U) of four ensembles, drawn from the mixture, all inside the support."""
    count, dim = mode.shape
    shape = (count, 4, recommended_walkers(dim), dim)
    move = StackedMixture(*mixture, 2, rng)
    move.begin(count, 0)
    x = move.draw(shape[1] * shape[2])[0]
    for _ in range(30):  # draw in towards the best place what has fallen outside
        bad = ~np.isfinite(density(x, np.arange(count)))
        if not bad.any():
            break
        x = np.where(bad[..., None], (x + mode[:, None]) / 2, x)
    return x.reshape(shape)
