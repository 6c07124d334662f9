"""An unknown that shares no signal with the others: its posterior stands by itself.

The azimuth of a contact in space is told by the directions of moment and force, which tell of
nothing else. The posterior is a product, and each factor is worked out alone: two unknowns and one
cost less than three.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..observer import Observer
from ..receptors import ReceptorNoise, Seed
from .grid import GridPosterior, integrate
from .result import Estimate, Status
from .solution import Array, Solution, is_outside

Solve = Callable[[Observer, Array], Solution]

#: Tolerance of the integral over the lone unknown, and where in the normal coordinate it looks.
TOLERANCE = 1e-6
SEARCHED = np.linspace(-8.0, 8.0, 129)
_STEP = 1e-4


class Factors(NamedTuple):
    """An observer of all unknowns but the last, and the noise of the signals that are the last."""

    first: Observer
    noise: ReceptorNoise
    signals: int


def factors_of(observer: Observer) -> Factors | None:
    """How the posterior comes apart, if it does."""
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


def solve_apart(solve: Solve, observer: Observer, factors: Factors, reading: Array) -> Solution:
    """The posterior of readings (B, R): by `solve` of all unknowns but the last, which is summed.

    Of two faults the first factor's is said.
    """
    size = factors.first.noise.reading_size(len(factors.first.cue.signal_names))
    first = solve(factors.first, reading[:, :size])
    own = reading[:, size:]

    def signals(z: Array) -> Array:
        return np.repeat(observer.last_unknown(z)[..., None], factors.signals, axis=-1)

    def density(x: Array, index: NDArray[np.intp]) -> Array:
        z = x[..., 0]
        log = factors.noise.log_likelihood(own[index, None], signals(z))
        return np.asarray(log - 0.5 * (z**2 + np.log(2 * np.pi)))

    value = observer.last_unknown
    mode, width = _modes(density, len(own))
    found: GridPosterior = integrate(
        density,
        mode[:, None],
        width[:, None, None],
        functions=value,
        only_functions=True,
        tolerance=TOLERANCE,
        keep_points=True,
    )
    nodes = found.nodes
    assert nodes is not None
    status = np.where(found.converged, Status.CONVERGED, Status.IMPRECISE)
    status[is_outside(factors.noise, own, signals(mode))] = Status.IMPROBABLE_READING
    moments = (found.mean[:, 0], found.sd[:, 0])
    errors = (error[:, 0] * moments[1] for error in (found.mean_error, found.sd_error))
    last = len(observer.unknowns) - 1

    def quantile_of(p: Array, unknown: int) -> Array:
        if unknown < last:
            return first.quantile_of(p, unknown)
        return np.stack([n.quantile(value(n.points)[:, 0], p) for n in nodes])

    def draws_of(count: int, seed: Seed) -> Array:
        from .arviz_io import resample

        rng = np.random.default_rng(seed)
        draws = first.draws_of(count, rng)
        chains, kept = draws.shape[1:3]
        drawn = [
            resample(n.points, n.weights, chains * kept, seed=rng, edges=n.edges) for n in nodes
        ]
        lone = value(rng.permuted(np.stack(drawn), axis=1)).reshape(len(own), chains, kept, 1)
        return np.concatenate([draws, lone], axis=-1)

    return Solution(
        [*first.estimates, Estimate(*moments, *errors)],
        np.where(first.status == Status.CONVERGED, status, first.status).astype(np.int8),
        first.log_evidence + found.log_evidence,
        quantile_of,
        draws_of,
    )


def _modes(density: Callable[[Array, NDArray[np.intp]], Array], count: int) -> tuple[Array, Array]:
    """Where densities (B,) of one coordinate are highest, and how wide they are there."""
    from scipy.optimize.elementwise import find_minimum

    rows = np.arange(count)
    table = density(np.broadcast_to(SEARCHED[:, None], (count, len(SEARCHED), 1)), rows)
    best = np.clip(table.argmax(axis=1), 1, len(SEARCHED) - 2)

    def depth(z: Array, row: Array) -> Array:
        return -density(z[:, None, None], row.astype(np.intp))[:, 0]

    bracket = tuple(SEARCHED[best + step] for step in (-1, 0, 1))
    mode = np.asarray(find_minimum(depth, bracket, args=(rows.astype(float),)).x)
    mode = np.where(np.isfinite(mode), mode, SEARCHED[best])
    near = mode[:, None, None] + _STEP * np.array([-1.0, 0.0, 1.0])[:, None]
    below, here, above = density(near, rows).T
    bend = (2 * here - below - above) / _STEP**2
    return mode, np.maximum(bend, 0.25) ** -0.5
