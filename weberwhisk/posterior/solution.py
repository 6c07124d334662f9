"""What every engine gives back, and what it asks of a posterior before it starts."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..observer import Observer
from ..receptors import ReceptorNoise, Seed
from .result import Estimate, Status

Array = NDArray[np.float64]
Index = NDArray[np.intp]

#: A reading this many sd from the signals is improbable under the model.
IMPROBABLE = 5.0


class Solution(NamedTuple):
    """What a method gives for readings (B, S)."""

    estimates: list[Estimate]
    status: NDArray[np.int8]
    log_evidence: Array
    quantile_of: Callable[[Array, int], Array]
    draws_of: Callable[[int, Seed], Array]
    #: Errors of the quantiles, where the method knows them.
    quantile_error_of: Callable[[Array, int], Array] | None = None
    #: Readings (B,) that were summed on a grid of their own.
    own_grid: NDArray[np.bool_] | None = None

    def of(self, rows: NDArray[np.intp]) -> Solution:
        """The same for readings some of which come again and again."""
        return Solution(
            [Estimate(*(column[rows] for column in estimate)) for estimate in self.estimates],
            self.status[rows],
            self.log_evidence[rows],
            lambda p, unknown: self.quantile_of(p, unknown)[rows],
            lambda count, seed: self.draws_of(count, seed)[rows],
        )

    def among(self, known: NDArray[np.bool_]) -> Solution:
        """The same among readings (B,) of which the others are not known: NaN for those."""

        def put(values: Array) -> Array:
            out = np.full((len(known), *values.shape[1:]), np.nan)
            out[known] = values
            return out

        def of_known(p: Array, unknown: int) -> Array:
            assert self.quantile_error_of is not None
            return self.quantile_error_of(p, unknown)

        status = np.full(len(known), Status.NOT_A_READING, dtype=np.int8)
        status[known] = self.status
        return Solution(
            [Estimate(*map(put, estimate)) for estimate in self.estimates],
            status,
            put(self.log_evidence),
            lambda p, unknown: put(self.quantile_of(p, unknown)),
            lambda count, seed: put(self.draws_of(count, seed)),
            self.quantile_error_of and (lambda p, unknown: put(of_known(p, unknown))),
            None if self.own_grid is None else put(self.own_grid.astype(float)) == 1,
        )


def of_nothing(unknowns: int) -> Solution:
    """The solution for no reading at all."""
    none = np.empty(0)
    return Solution(
        [Estimate(none, none, none, none)] * unknowns,
        np.empty(0, dtype=np.int8),
        none,
        lambda p, unknown: np.empty((0, len(p))),
        lambda count, seed: np.empty((0, 4, count, unknowns)),
    )


def is_improbable(observer: Observer, reading: Array, contact: Array) -> NDArray[np.bool_]:
    """Readings with a number more than 5 sd from what their own most probable contact gives."""
    return is_outside(observer.noise, reading, observer.signals(contact)[0])


def is_outside(noise: ReceptorNoise, reading: Array, signals: Array) -> NDArray[np.bool_]:
    """Readings (B, R) with a number more than 5 sd from their signals (B, S)."""
    low, high = noise.interval(signals, IMPROBABLE)
    return np.any((reading < low) | (reading > high), axis=-1)


def contact_slope(observer: Observer, x: Array) -> Array:
    """d contact/dx, (B, U, U), by central differences."""
    h = 1e-5
    columns = []
    for axis in range(x.shape[1]):
        offset = np.zeros(x.shape[1])
        offset[axis] = h
        rise = observer.contact(x + offset)[0] - observer.contact(x - offset)[0]
        columns.append(rise / (2 * h))
    return np.stack(columns, axis=-1)


def is_unidentified(observer: Observer, contact: Array) -> NDArray[np.bool_]:
    """Posteriors to which the reading adds less than the prior in some direction.

    In the coordinates x a flat prior has a curvature of ¼ and more: information below that
    leaves the prior to decide. Unknowns that the whisker does not bound are known by their priors,
    and what is left to know of them is taken from the others (Schur complement).
    """
    slope = contact_slope(observer, observer.coordinates(contact))
    told = observer.information(contact) + observer.prior_information(contact)
    information = np.swapaxes(slope, 1, 2) @ told @ slope
    information = information[np.isfinite(information).all(axis=(1, 2))]
    n = observer.bounded
    cross = information[:, :n, n:]
    shared = cross @ np.linalg.solve(information[:, n:, n:], np.swapaxes(cross, 1, 2))
    least = np.zeros(len(contact))
    known = np.isfinite(told).all(axis=(1, 2))
    least[known] = np.linalg.eigvalsh(information[:, :n, :n] - shared)[:, 0]
    return least < 0.25


def checked_density(value: ArrayLike, points: Array, index: Index) -> Array:
    """The log-density as (b, N), refused where it is NaN, +inf or of another shape."""
    out = np.asarray(value, dtype=float)
    if out.shape != points.shape[:2]:
        raise ValueError(
            f"The log-density must have shape {points.shape[:2]} for points of shape "
            f"{points.shape}, got {out.shape}; return one value for each point."
        )
    if not np.max(out) < np.inf:
        bad = tuple(np.argwhere(~(out < np.inf))[0])
        raise ValueError(
            f"The log-density of posterior {index[bad[0]]} is {out[bad]} at "
            f"{points[bad].tolist()}; return -inf where the density is zero."
        )
    return out


def refuse_impossible(reading: Array, highest: Array) -> None:
    """Refuse readings (B, R) whose log-density is −inf everywhere: there is no posterior."""
    impossible = np.isneginf(highest)
    if np.any(impossible):
        raise ValueError(
            f"No contact can give the reading {reading[impossible][0].tolist()} under this noise; "
            "check its sign, or choose noise that allows it, such as Weber."
        )
