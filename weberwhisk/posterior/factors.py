"""An unknown that shares no signal with the others: its posterior stands by itself.

The azimuth of a contact in space is told by the directions of moment and force, which tell of
nothing else: the posterior is a product, and two unknowns and one cost less than three.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..observer import Observer
from ..receptors import ReceptorNoise, Seed
from .grid import integrate
from .result import Estimate, Status
from .solution import Array, Solution, is_outside

#: Ends of the lone unknown's normal coordinate.
ENDS = 8.0


class Factors(NamedTuple):
    """An observer of all unknowns but the last, and the noise of the signals that are the last."""

    first: Observer
    noise: ReceptorNoise
    signals: int


def factors_of(observer: Observer) -> Factors | None:
    """The factors of the posterior, if it is a product."""
    cue = getattr(observer.cue, "all_but_last", None)
    if cue is None:
        return None
    own, size = len(cue.signal_names), len(observer.cue.signal_names)
    noise, rest = observer.noise.part(size, 0, own), observer.noise.part(size, own, size)
    if noise is None or rest is None:
        return None  # the noise of some signals of either kind is one
    prior = {name: observer.prior[name] for name in cue.unknowns if name in observer.prior}
    first = Observer(observer.whisker, cue, noise, prior, model=observer.model)
    return Factors(first, rest, size - own)


def solve_factors(
    solve: Callable[[Observer, Array], Solution],
    observer: Observer,
    factors: Factors,
    reading: Array,
) -> Solution:
    """The posterior of readings (B, R): by `solve` of all unknowns but the last, which is summed.

    Of two faults the first factor's is said.
    """
    size = factors.first.noise.reading_size(len(factors.first.cue.signal_names))
    first = solve(factors.first, reading[:, :size])
    own = reading[:, size:]

    def density(x: Array, index: NDArray[np.intp]) -> Array:
        value = observer.last_unknown(x[..., 0])
        signals = np.repeat(value[..., None], factors.signals, axis=-1)
        log = factors.noise.log_likelihood(own[index, None], signals)
        return np.asarray(log - 0.5 * (x[..., 0] ** 2 + np.log(2 * np.pi)))

    ends = np.full((len(own), 1), ENDS)
    found = integrate(density, -ends, ends, functions=observer.last_unknown)
    value = observer.last_unknown(found.points)[..., 0]
    rise = np.cumsum(found.weights, axis=1) - found.weights / 2
    best = np.take_along_axis(value, found.weights.argmax(axis=1)[:, None], axis=1)
    status = np.where(found.error[:, 0] < 1e-2, Status.CONVERGED, Status.IMPRECISE)
    signals = np.repeat(best, factors.signals, axis=-1)
    status[is_outside(factors.noise, own, signals)] = Status.IMPROBABLE_READING
    mean, sd, error = found.mean[:, 0], found.sd[:, 0], found.error[:, 0]
    last = len(observer.unknowns) - 1

    def at(probability: Array) -> Array:
        """Values (B, Q) at probabilities (B, Q)."""
        pairs = zip(probability, rise, value, strict=True)
        return np.stack([np.interp(p, up, v) for p, up, v in pairs])

    def quantile_of(p: Array, unknown: int) -> Array:
        if unknown < last:
            return first.quantile_of(p, unknown)
        return at(np.broadcast_to(p, (len(own), len(p))))

    def quantile_error_of(p: Array, unknown: int) -> Array:
        if unknown < last:
            known = first.quantile_error_of
            return np.full((len(own), len(p)), np.nan) if known is None else known(p, unknown)
        # Straight lines between nodes of a tenth of the sd miss less than a hundredth of it.
        return np.asarray(sd[:, None] * (0.01 + error[:, None] / (4 * p * (1 - p))))

    def draws_of(count: int, seed: Seed) -> Array:
        rng = np.random.default_rng(seed)
        draws = first.draws_of(count, rng)
        chains, kept = draws.shape[1:3]
        strata = np.arange(chains * kept) + rng.random((len(own), chains * kept))
        lone = at(rng.permuted(strata / (chains * kept), axis=1))
        return np.concatenate([draws, lone.reshape(len(own), chains, kept, 1)], axis=-1)

    return Solution(
        [*first.estimates, Estimate(mean, sd, error * sd, error * sd)],
        np.where(first.status == Status.CONVERGED, status, first.status).astype(np.int8),
        first.log_evidence + found.log_evidence,
        quantile_of,
        draws_of,
        quantile_error_of,
        first.own_grid,
    )
