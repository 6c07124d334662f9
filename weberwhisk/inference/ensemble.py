"""Thousands of posteriors in one emcee run.

A step of emcee costs the same bookkeeping for 32 walkers as for 32 000. The moves of `moves` pair
walkers only inside their own *block* of W consecutive rows, so that one `emcee.EnsembleSampler`
carries any number of independent ensembles, E of them for each of B posteriors, and the
log-density is called with half of all walkers at once.

What a run says about itself rests on the E ensembles of a posterior being independent: walkers
of one ensemble are not, so R-hat across them would mean nothing (emcee's own documentation).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import emcee
import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._values import Array, Flags, Index
from ..receptors import Seed
from . import arviz_io as diagnostics
from .arviz_io import Shortfall
from .moves import MoveMaker, StackedMove, checked_start, default_moves, refuse_outside
from .result import checked_density


@dataclass(frozen=True)
class StackedSample:
    """Draws of B posteriors and what they are worth.

    `values` (B, E, N, C) are N draws of each of the E independent ensembles, in order of time, of
    the C functions asked for or the coordinates. `mean`, `sd` and their Monte Carlo errors, the
    integrated autocorrelation time `tau` of the ensembles' means in steps, the independent draws
    `ess` that would give the mean as well, and the rank-normalised split `rhat`, (B, C), are of all
    steps after the burn-in. So many `steps` were made by every walker, `burn_in` left out, and
    `shortfall` has `Shortfall` flags, (B,).
    """

    values: Array
    mean: Array
    sd: Array
    mcse_mean: Array
    mcse_sd: Array
    tau: Array
    ess: Array
    rhat: Array
    acceptance: Array
    steps: NDArray[np.int64]
    burn_in: NDArray[np.int64]
    shortfall: NDArray[np.int64]

    @property
    def converged(self) -> Flags:
        """Which posteriors met every criterion, shape (B,)."""
        return self.shortfall == 0


def sample_stacked(
    log_density: Callable[..., ArrayLike],
    start: ArrayLike,
    *,
    seed: Seed,
    moves: Sequence[tuple[MoveMaker, float]] | None = None,
    functions: Callable[[Array], ArrayLike] | None = None,
    precision: float = 0.02,
    max_steps: int | NDArray[np.int64] = 20_000,
    keep: int = 1024,
    indexed: bool = False,
) -> StackedSample:
    """Sample B posteriors in one emcee run, each until it is good enough.

    All run together; after 256 steps, and whenever their number has grown by a tenth to a half,
    each is judged. It is done when the Monte Carlo errors of every mean and sd are small enough,
    its ensembles agree and are 160 autocorrelation times long together (40 each, if they are four),
    and every walker moves; or at `max_steps` (B,), with its reasons. What is left out as burn-in is
    the shortest of an eighth, a quarter and a half of the run after which early and late steps
    agree.

    ``log_density(x)``, with x (B, M, D), any M, returns (B, M): −inf, but never NaN or +inf; with
    `indexed`, ``log_density(x, index)`` as for `grid.integrate`, so that posteriors that are done
    drop out. `start` (B, E, W, D) has the walkers of E ≥ 4 ensembles, an even number W ≥ 2 D + 2,
    all inside the support, rather too wide than too narrow. The makers of `moves` take the walkers
    in a block and a Generator. ``functions(x)`` (B, M, Q) are judged and summarised in place of the
    coordinates. `keep` draws of each ensemble stay in the result. The same seed, density and start
    give the same bits. Memory is about 8·B·E·W·D·1024 bytes at most.

    `precision` is the largest Monte Carlo error of an sd, relative to it; the mean's may be √2
    times as much, as it is for independent draws. Where the kurtosis is above 4 both are tightened
    by √2: runs that happened to see little of a heavy tail look surer than they should. With it
    none of 8000 posteriors with kurtosis 5 to 75 passed with an sd wrong by more than 10 % (`pytest
    -m slow`); without it 2 of 2500 did.
    """
    places = checked_start(start)
    if not 0 < precision < 1:
        raise ValueError(f"precision must lie between 0 and 1, got {precision}; 0.02 is usual.")
    posteriors, _, walkers, dim = places.shape
    most = np.broadcast_to(max_steps, posteriors)
    if most.min() < 64:
        raise ValueError(f"max_steps must be at least 64, got {most.min()}; 20000 is usual.")
    rng = np.random.default_rng(seed)
    chosen = [(make(walkers, rng), weight) for make, weight in moves or default_moves(dim)]
    run = EnsembleRun(log_density, places, chosen, rng, functions, indexed, max(keep // walkers, 8))
    fields: dict[str, NDArray] = {}
    done = np.zeros(posteriors, dtype=bool)
    check = max(96, 2 * run.selected)
    while not done.all():
        waiting = ~done[run.alive]
        run.advance(min(check, most[run.alive[waiting]].min()))
        last = run.steps >= most[run.alive]
        verdict = run.judge(precision, every=bool(last.any()))
        needed = verdict.pop("needed")
        fresh = ((verdict["shortfall"] == 0) | last) & ~done[run.alive]
        for name, value in verdict.items():
            blank = np.zeros((posteriors, *value.shape[1:]), value.dtype)
            fields.setdefault(name, blank)[run.alive[fresh]] = value[fresh]
        done[run.alive[fresh]] = True
        waiting = ~done[run.alive]
        if waiting.any():
            # As soon as a quarter of them may be ready: judging is not free, nor is waiting.
            soon = np.quantile(np.nan_to_num(needed[waiting], nan=np.inf), 0.25, method="lower")
            check = int(np.clip(soon, 1.2 * run.steps, 1.5 * run.steps))
        if indexed and fresh.any():
            run.leave(~fresh)
    return StackedSample(**fields)


class EnsembleRun:
    """The posteriors still running, `alive`, and the record of their steps.

    `series` (2, b, C, E, n) holds the means over the walkers, and over `batch` steps, of the
    columns and of their squares, both about `origin`; `coords` (n, b, E, W, D) every batch-th
    step. When the record is full it is halved and `batch` doubled, so it stays short.
    """

    def __init__(
        self,
        log_density: Callable[..., ArrayLike],
        start: Array,
        moves: list[tuple[StackedMove, float]],
        rng: np.random.Generator,
        functions: Callable[[Array], ArrayLike] | None,
        indexed: bool,
        selected: int,
    ) -> None:
        self.log_density, self.moves, self.functions = log_density, moves, functions
        self.indexed, self.selected = indexed, selected
        self.alive = np.arange(len(start))
        for move, _ in moves:
            move.begin(len(start), start[0, ..., 0].size)
        self.shape = start.shape[1:]
        self.batch, self.steps, self.checked = 1, 0, 0
        self.moved = np.zeros(start.shape[:-1])
        # A new sampler copies NumPy's global state, unless the state to go on from has its own.
        own = np.random.RandomState(rng.integers(2**32, size=4)).get_state()
        self.state = emcee.State(start.reshape(-1, start.shape[-1]).copy(), random_state=own)
        self.state.log_prob = self.density(self.state.coords)
        refuse_outside(self.state.log_prob.reshape(len(start), -1))
        self.origin = self.columns(start[None])[0].mean(axis=(1, 2))
        self.series = np.empty((2, *self.origin.shape, self.shape[0], 0))
        self.coords = np.empty((0, *start.shape))

    def density(self, rows: Array) -> Array:
        """The log-density of rows in block order; refuses NaN and +inf, which would stick."""
        x = rows.reshape(len(self.alive), -1, self.shape[-1])
        out = self.log_density(x, self.alive) if self.indexed else self.log_density(x)
        return checked_density(out, x, self.alive).ravel()

    def columns(self, coords: Array) -> Array:
        """The functions, if any, of coordinates (n, b, E, W, D): (n, b, E, W, C)."""
        if self.functions is None:
            return coords
        n, b, e, w, dim = coords.shape
        points = coords.swapaxes(0, 1).reshape(b, n * e * w, dim)
        extra = np.asarray(self.functions(points), dtype=float)
        if extra.ndim != 3 or extra.shape[:2] != points.shape[:2] or not np.isfinite(extra).all():
            raise ValueError(
                f"functions must return finite values of shape {points.shape[:2]} and one axis "
                f"more for points of shape {points.shape}, got shape {extra.shape} with "
                f"{np.sum(~np.isfinite(extra))} not finite; return -inf as log-density where "
                "they are not defined."
            )
        return extra.reshape(b, n, e, w, extra.shape[-1]).swapaxes(0, 1)

    def advance(self, steps: int, *, piece: int = 32, stored: int = 1024) -> None:
        """Run emcee until at least `steps` have been made in all.

        In pieces of so many steps; when so many are on record they are halved.
        """
        self.moved[:] = 0
        self.checked = self.steps
        coords, series = [self.coords], [self.series]
        while self.steps < steps:
            length = max(piece, self.batch)
            sampler = emcee.EnsembleSampler(
                *self.state.coords.shape, self.density, moves=self.moves, vectorize=True
            )
            sampler.log_prob_fn = self.density  # emcee's wrapper prints all walkers on an error
            self.state = sampler.run_mcmc(self.state, length, skip_initial_state_check=True)
            self.steps += length
            self.moved += sampler.backend.accepted.reshape(self.moved.shape)
            chain = sampler.get_chain().reshape(length, *self.moved.shape, -1)
            coords.append(chain[self.batch - 1 :: self.batch])
            series.append(self.summed(chain))
            if sum(map(len, coords)) >= max(stored, 4 * self.selected):
                coords = [np.concatenate(coords)[1::2]]
                series = [_batched(np.concatenate(series, axis=-1), 2)]
                self.batch *= 2
        self.coords, self.series = np.concatenate(coords), np.concatenate(series, axis=-1)

    def summed(self, chain: Array) -> Array:
        """`series` of new steps (n, b, E, W, D)."""
        values = self.columns(chain) - self.origin[:, None, None]
        n, b, e, w, c = values.shape
        pool = np.tile(np.eye(c), (w, 1)) / w  # a product is faster than a mean over so few
        both = [v.reshape(-1, w * c) @ pool for v in (values, np.square(values))]
        return _batched(np.stack(both).reshape(2, n, b, e, c).transpose(0, 2, 4, 3, 1), self.batch)

    def leave(self, stay: Flags) -> None:
        """Go on with some of the posteriors only."""
        self.alive, self.moved = self.alive[stay], self.moved[stay]
        for move, _ in self.moves:
            move.leave(stay)
        self.series, self.origin = self.series[:, stay], self.origin[stay]
        self.coords = self.coords[:, stay]
        rows = np.repeat(stay, self.shape[0] * self.shape[1])
        state = self.state
        self.state = emcee.State(
            state.coords[rows], log_prob=state.log_prob[rows], random_state=state.random_state
        )

    def judge(
        self,
        precision: float,
        *,
        every: bool,
        rhat_limit: float = 1.01,
        times: float = 160.0,
        least_acceptance: float = 0.05,
        heavy: float = 4.0,
    ) -> dict[str, NDArray]:
        """Every field of `StackedSample` for the posteriors still running.

        R-hat is held to Vehtari et al. (2021); a run to so many autocorrelation times in all
        ensembles together (emcee advises 50 for one); where the kurtosis is `heavy` the precision
        asked for is tightened by √2. What takes the draws (kurtosis, R-hat) is worked out where
        nothing else is wrong, or for `every` posterior.
        """
        burn = self.burn_in()
        parts = [np.flatnonzero(burn == cut) for cut in np.unique(burn)]
        joined = [self.statistics(rows, int(burn[rows[0]])) for rows in parts]
        order = np.argsort(np.concatenate(parts))
        out = {k: np.concatenate([p[k] for p in joined])[order] for k in joined[0]}
        out["acceptance"] = self.moved.mean(axis=(1, 2)) / (self.steps - self.checked)
        out["steps"] = np.full(len(burn), self.steps)
        out["burn_in"] = burn * self.batch
        times /= self.shape[0]
        fault = np.zeros(len(burn), dtype=np.int64)
        fault |= Shortfall.SHORT * ~(self.steps >= times * out["tau"]).all(axis=1)
        fault |= Shortfall.IMPRECISE * ~(_excess(out, precision) <= 1).all(axis=1)
        fault |= Shortfall.STUCK * (self.moved == 0).any(axis=(1, 2))
        fault |= Shortfall.ACCEPTANCE * (out["acceptance"] < least_acceptance)
        # The steps at which these two would be met, if nothing but their number changed.
        short = np.maximum(times * out["tau"], self.steps * _excess(out, precision) ** 2)
        out["needed"] = short.max(axis=1)
        asked = np.flatnonzero((fault == 0) | every)
        values = self.values(asked, burn[asked])
        tight, rhat = np.full(out["mean"].shape, precision), np.full(out["mean"].shape, np.nan)
        if asked.size:
            rhat[asked] = diagnostics.rhat(np.moveaxis(values, -1, 1))
            tight[asked] = precision * np.where(_kurtosis(values) > heavy, np.sqrt(0.5), 1.0)
        fault[asked] |= Shortfall.RHAT * ~(rhat[asked] < rhat_limit).all(axis=1)
        fault |= Shortfall.IMPRECISE * ~(_excess(out, tight) <= 1).all(axis=1)
        kept = np.full((len(burn), *values.shape[1:]), np.nan)
        kept[asked] = values
        return out | {"shortfall": fault, "rhat": rhat, "values": kept}

    def burn_in(self) -> Index:
        """The shortest of n/8, n/4 and n/2 batches after which no drift of 3 errors is left."""
        n = self.series.shape[-1]
        late = self.series[..., n // 2 :]
        pieces = _batched(late, late.shape[-1] // 8)
        noise = pieces.var(axis=(-2, -1)) / (pieces.shape[-2] * pieces.shape[-1])
        burn = np.full(len(self.alive), n // 2)
        settled = np.ones(len(burn), dtype=bool)
        for cut in (n // 4, n // 8):
            early = self.series[..., cut : cut + (n - cut) // 4]
            gap = early.mean(axis=(-2, -1)) - late.mean(axis=(-2, -1))
            share = 1.0 + late.shape[-1] / early.shape[-1]
            settled &= (gap**2 <= 9.0 * noise * share).all(axis=(0, 2))
            burn[settled] = cut
        return burn

    def statistics(self, rows: Index, cut: int) -> dict[str, NDArray]:
        """Moments and their Monte Carlo errors after a burn-in of `cut` batches."""
        first, second = self.series[:, rows, ..., cut:]
        mean = first.mean(axis=(-2, -1))
        centre = mean[..., None, None]
        spread = second - 2 * centre * first + centre**2
        variance = np.maximum(spread.mean(axis=(-2, -1)), 0.0)
        of_mean, time = diagnostics.long_run_variance(first)
        of_variance, _ = diagnostics.long_run_variance(spread)
        count = first.shape[-2] * first.shape[-1]
        sd = np.sqrt(variance)
        return {
            "mean": mean + self.origin[rows],
            "sd": sd,
            "mcse_mean": np.sqrt(of_mean / count),
            "mcse_sd": np.sqrt(of_variance / count) / (2 * np.where(sd > 0, sd, np.nan)),
            "tau": time * self.batch,
            "ess": count * variance / np.where(of_mean > 0, of_mean, np.nan),
        }

    def values(self, rows: Index, cut: Index) -> Array:
        """An even selection of the columns of posteriors `rows`, (b, E, N, C), in order of time."""
        steps = np.linspace(cut, len(self.coords) - 1, self.selected).round().astype(np.intp)
        chosen = np.moveaxis(self.columns(self.coords[steps, rows]), 0, 2)
        draws = self.selected * self.shape[1]
        return chosen.reshape(len(rows), self.shape[0], draws, chosen.shape[-1])


def _batched(x: Array, size: int) -> Array:
    """Means over `size` neighbours along the last axis; a rest that fills no batch is left out."""
    whole = x.shape[-1] // size * size
    return x[..., :whole].reshape(*x.shape[:-1], -1, size).mean(axis=-1) if size > 1 else x


def _excess(out: dict[str, NDArray], precision: ArrayLike) -> Array:
    """Monte Carlo errors over those asked for, (b, C); the mean's may be √2 times the sd's."""
    target = np.asarray(precision) * np.where(out["sd"] > 0, out["sd"], np.nan)
    return np.asarray(np.maximum(out["mcse_sd"], out["mcse_mean"] / np.sqrt(2.0)) / target)


def _kurtosis(values: Array) -> Array:
    """Of the draws (b, E, N, C) of each column, (b, C); 3 is Gaussian."""
    square = np.square(values - values.mean(axis=(1, 2), keepdims=True))
    variance = square.mean(axis=(1, 2))
    return np.asarray(
        np.square(square).mean(axis=(1, 2)) / np.where(variance > 0, variance, np.nan) ** 2
    )
