"""Posteriors of many measured contacts: sums over a lattice in the observer's own coordinates.

Rows of a table of contacts may each have a measurement error, and those of one touch share distance
and stiffness while the deflection angle moves. So what is wanted is the evidence of each row over
both, the angle summed out; and intervals of every row at the cost of its mean.

Rows whose readings are alike share a set of cells. It starts from all contacts at a coarse spacing;
cells that could explain the reading, were it as uncertain as the signals vary across a cell, are
split along the coordinates in which signals change by more than 1.9 sd. The coordinates have
no edges, so that sums over a lattice (the trapezoidal rule) converge as they do for a Gaussian.
A stiffness that scales signals is integrated at each cell by Gauss and Hermite's rule.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..coordinates import constrain_distance
from ..cues import UnknownStiffness
from ..mechanics.contact import Outcome
from ..observer import Observer

Array = NDArray[np.float64]
Index = NDArray[np.intp]


class Readings(NamedTuple):
    """Readings (n, S), and the covariances (n, S, S) of their measurement errors where known."""

    value: Array
    covariance: Array | None = None

    def take(self, rows: Any) -> Readings:
        """Some of them."""
        covariance = None if self.covariance is None else self.covariance[rows]
        return Readings(self.value[rows], covariance)


class LatticeCells(NamedTuple):
    """Cells of a lattice: what it takes to hold them against readings.

    Places in lattice steps (N, U), contacts (N, U), signals (N, S), ln of the prior density in x
    (N,), and by how much signals change across each cell (U, N, S).
    """

    place: Index
    contact: Array
    signals: Array
    log_prior: Array
    change: Array

    def take(self, some: Any) -> LatticeCells:
        """Some of them."""
        change = self.change[:, some] if len(self.change) else self.change
        return LatticeCells(
            self.place[some], self.contact[some], self.signals[some], self.log_prior[some], change
        )


@dataclass(frozen=True, eq=False)
class Cloud:
    """The cells from which alike readings may come, by distance; their steps (U,) in x.

    `precise` says whether the lattice is as fine as it should be.
    """

    cells: LatticeCells
    step: Array
    precise: bool
    lattice: Lattice

    @cached_property
    def first(self) -> Index:
        """Where cells of another distance begin."""
        place = self.cells.place[:, 0]
        return np.flatnonzero(np.diff(place, prepend=place[0] - 1))

    @cached_property
    def layers(self) -> Array:
        """Coordinates x of the distances."""
        return np.asarray(self.cells.place[self.first, 0] * self.step[0])

    @cached_property
    def share(self) -> Array:
        """How far up to the fold the angle of each cell goes, 0 where its prior is given."""
        observer, contact = self.lattice.observer, self.cells.contact
        if observer.bounded < 2 or "deflection_angle" in observer.prior:
            return np.zeros(len(contact))
        low, width = observer.angle_range(contact[:, 0])
        return np.asarray((contact[:, 1] - low) / width)

    @cached_property
    def log_prior(self) -> Array:
        """ln of the prior density of each distance in x."""
        return log_prior_of_distance(self.lattice.observer, self.layers)


def distances(observer: Observer, x: Array) -> Array:
    """Radial distances, m, at coordinates x."""
    low, high = observer.reach
    return np.asarray(low + (high - low) * constrain_distance(x)[0])


def log_prior_of_distance(observer: Observer, x: Array) -> Array:
    """ln of the prior density of the distance in coordinates x."""
    with np.errstate(divide="ignore"):
        prior = np.log(observer.distance_prior(distances(observer, x)))
    return np.asarray(prior + constrain_distance(x)[1])


class Lattice:
    """The lattice of an observer, whose cue may be an `UnknownStiffness`.

    Without receptors readings have their measurement errors alone; cells for touches resolve
    distance and angle at each stiffness.
    """

    def __init__(
        self, observer: Observer, *, with_receptors: bool = True, for_touches: bool = False
    ) -> None:
        self.for_touches = for_touches
        self.whole, self.with_receptors = observer, with_receptors
        self.soft: NDArray[np.bool_] | None = None
        if isinstance(observer.cue, UnknownStiffness):
            self.soft = np.isin(observer.cue.signal_names, observer.cue.soft)
            self.stiffness = observer.prior["stiffness"]
            low, middle, high = np.log(self.stiffness.ppf([0.159, 0.5, 0.841]))
            self.log_median, self.log_sd = float(middle), float(high - low) / 2
            prior = {name: p for name, p in observer.prior.items() if name != "stiffness"}
            observer = replace(observer, cue=observer.cue.cue, prior=prior)
        self.observer = observer
        self.unknowns = len(observer.unknowns)
        # The tails of strong Weber noise are wide: with k = 0.3 errors were 0.04 sd by plain nodes.
        strong = max(observer.noise.weber_fractions(len(observer.cue.signal_names))) > 0.15
        nodes, weights = np.polynomial.hermite_e.hermegauss(11 if strong else 7)
        wider = 1.4 if strong else 1.15
        self._nodes, self._log_weights = wider * nodes, np.log(wider * weights) + nodes**2 / 2

    # -- likelihood ----------------------------------------------------------------------------

    def variance(self, readings: Readings, signals: Array) -> Array:
        """Variances (..., S) of readings (..., S) of signals (..., S)."""
        out = np.zeros(np.broadcast_shapes(readings.value.shape, signals.shape))
        if self.with_receptors:
            out += self.observer.noise.sd(signals) ** 2
        if readings.covariance is not None:
            out += np.diagonal(readings.covariance, axis1=-2, axis2=-1)
        return out

    def log_likelihood(self, readings: Readings, signals: Array) -> Array:
        """ln p (n, ...) of readings (n, S) at signals (n or 1, ..., S)."""
        own = (len(readings.value), *(1,) * (signals.ndim - 2))
        y = readings.value.reshape(*own, -1)
        if readings.covariance is None:
            return self.observer.noise.log_likelihood(y, signals)
        root = np.linalg.cholesky(self.covariance(readings, signals))
        z = _whitened(np.linalg.inv(root), y - self.observer.noise.mean(signals))
        log_sd = np.log(np.diagonal(root, axis1=-2, axis2=-1)).sum(axis=-1)
        return -0.5 * (z**2).sum(axis=-1) - log_sd - 0.5 * y.shape[-1] * np.log(2 * np.pi)

    def covariance(self, readings: Readings, signals: Array) -> Array:
        """Covariances (n, ..., S, S) of readings (n, S) at signals (n or 1, ..., S)."""
        assert readings.covariance is not None
        own, size = (len(readings.value), *(1,) * (signals.ndim - 2)), signals.shape[-1]
        total = readings.covariance.reshape(*own, size, size)
        return total + self.observer.noise.covariance(signals) if self.with_receptors else total

    def match(self, readings: Readings, signals: Array) -> tuple[Array, Array]:
        """ln of the stiffness (n, N) that brings signals (N, S) nearest to readings, and its sd."""
        assert self.soft is not None
        y = readings.value[:, self.soft]
        with np.errstate(divide="ignore", invalid="ignore"):
            known = y**2 / self.variance(readings, readings.value)[:, self.soft]
            ratio = y[:, None] / signals[:, self.soft]
            usable = (ratio > 0) & np.isfinite(ratio) & np.isfinite(known[:, None])
            weight = np.where(usable, known[:, None], 0.0)
            pull = np.where(usable, weight * np.log(np.where(usable, ratio, 1.0)), 0.0)
        precision = self.log_sd**-2
        total = weight.sum(axis=-1) + precision
        return (pull.sum(axis=-1) + precision * self.log_median) / total, total**-0.5

    def scaled(self, signals: Array, log_stiffness: Array) -> Array:
        """Signals (..., S) at another stiffness (...)."""
        assert self.soft is not None
        scale = np.exp(log_stiffness)[..., None]
        return signals * (scale if self.soft.all() else np.where(self.soft, scale, 1.0))

    def evidence(self, readings: Readings, signals: Array) -> Array:
        """ln p (n, N) of readings at cells' signals (N, S), the stiffness integrated."""
        if self.soft is None:
            if readings.covariance is None:
                return np.asarray(self.observer.noise.log_likelihoods(readings.value, signals))
            return self.log_likelihood(readings, signals[None])
        out = np.empty((len(readings.value), len(signals)))
        some = 1 + 4096 // len(signals)  # at a time: their arrays stay in the cache
        for rows in (slice(i, i + some) for i in range(0, len(out), some)):
            own = readings.take(rows)
            middle, sd = self.match(own, signals)
            log_e = middle[..., None] + sd[..., None] * self._nodes
            log = self.log_likelihood(own, self.scaled(signals[None, :, None], log_e))
            log += self.log_prior_of_stiffness(log_e) + self._log_weights
            top = np.maximum(log.max(axis=-1), -1e300)
            out[rows] = top + np.log(np.exp(log - top[..., None]).sum(axis=-1)) + np.log(sd)
        return out

    def log_prior_of_stiffness(self, log_stiffness: Array) -> Array:
        """Its prior density in the logarithm."""
        if self.stiffness.dist.name == "lognorm":  # SciPy's own takes ten times as long
            z = (log_stiffness - self.log_median) / self.log_sd
            return -0.5 * z * z - np.log(self.log_sd * np.sqrt(2 * np.pi))
        return self.stiffness.logpdf(np.exp(log_stiffness)) + log_stiffness

    # -- cells ---------------------------------------------------------------------------------

    @cached_property
    def _start(self) -> tuple[LatticeCells, Array]:
        """The coarse lattice over all contacts, and its steps (U,)."""
        ends = self.observer.space.spread(np.array([1e-7, 1e-3, 0.5, 1 - 1e-3, 1 - 1e-7]))
        step = np.full(self.unknowns, 0.5)
        axes = [
            np.arange(np.floor(a / h), np.ceil(b / h) + 1)
            for a, b, h in zip(ends.min(axis=0), ends.max(axis=0), step, strict=True)
        ]
        grid = np.meshgrid(*axes, indexing="ij")
        place = np.stack([a.ravel() for a in grid], axis=-1).astype(np.intp)
        return self._cells([(place, step, True)])[0], step

    def _cells(self, wanted: Sequence[tuple[Index, Array, bool]]) -> list[LatticeCells]:
        """Cells held at places (N, U) in steps (U,), with their changes or without, in one go."""
        axes = np.eye(self.unknowns)
        x = [
            place * step + aside
            for place, step, changes in wanted
            for aside in (0.0 * step, *(1e-3 * step * axes if changes else ()))
        ]
        ends = np.cumsum([len(part) for part in x])[:-1]
        found = self._at(np.concatenate(x))
        parts = zip(*(np.split(values, ends) for values in found), strict=True)
        out = []
        for place, _, changes in wanted:
            contact, signals, log_prior = next(parts)
            change = np.zeros((self.unknowns if changes else 0, *signals.shape))
            for d in range(len(change)):
                _, moved, still = next(parts)
                both = np.isfinite(still) & np.isfinite(log_prior)
                change[d] = np.where(both[:, None], (moved - signals) / 1e-3, 0.0)
            cells = LatticeCells(place, contact, signals, log_prior, change)
            out.append(cells.take(np.isfinite(log_prior)))
        return out

    def _at(self, x: Array) -> tuple[Array, Array, Array]:
        """Contacts, signals (0 where not held) and ln of the prior in x, −inf where not held."""
        contact, log_prior = self.observer.contact(x)
        signals, outcome = self.observer.signals(contact)
        held = (outcome == Outcome.HELD) & np.isfinite(log_prior)
        return contact, np.where(held[:, None], signals, 0.0), np.where(held, log_prior, -np.inf)

    def clouds(
        self, readings: Readings, most: int = 60_000, drop: float = 23.0, widest: float = 1.9
    ) -> list[Cloud]:
        """For each of n readings, the cells from which it, and those within 1 sd of it, may come.

        Left out are those whose ln of the density is `drop` below the best: 5 sd beyond readings
        1 sd from the middle. `widest` is by how many sds signals may change from a cell to the next
        where the density is highest. Signals of some hundred cells cost what the calls cost, so
        that readings are taken together.
        """
        every = [self._start] * len(readings.value)
        precise = np.zeros(len(every), dtype=bool)
        left = list(range(len(every)))
        for _ in range(14):
            wanted = {}
            for i in left:
                cells, step = every[i]
                log, lengths = self._tempered(readings.take([i]), cells, step)
                kept, wide = log > log.max() - 1.2 * drop, lengths > widest
                precise[i] = not wide.any()
                if precise[i] or kept.sum() * 2 ** int(wide.sum()) > most:
                    continue
                step = np.where(wide, step / 2, step)
                halves = np.array(np.meshgrid(*[[0, 1] if w else [0] for w in wide], indexing="ij"))
                place = np.where(wide, 2, 1) * cells.place[kept, None]
                place = (place + halves.reshape(self.unknowns, -1).T).reshape(-1, self.unknowns)
                # Half the step changes signals half as much: where that will do, it is the last.
                precise[i] = (np.where(wide, lengths / 2, lengths) <= widest).all()
                wanted[i] = place, step, not precise[i]
            if not wanted:
                break
            for i, cells in zip(wanted, self._cells([*wanted.values()]), strict=True):
                every[i] = cells, wanted[i][1]
            left = [i for i in wanted if not precise[i]]
        out = []
        for i, (cells, step) in enumerate(every):
            log = self.evidence(readings.take([i]), cells.signals)[0] + cells.log_prior
            at = np.flatnonzero(log > log.max() - drop)
            at = at[np.lexsort(cells.place[at].T[::-1])]
            out.append(Cloud(cells.take(at), step, bool(precise[i]), self))
        return out

    def _tempered(self, reading: Readings, cells: LatticeCells, step: Array) -> tuple[Array, Array]:
        """ln of the density of cells (N,), as blurred as they are wide; their lengths (U,) in sd.

        The lengths are the largest near the top, across the direction in which stiffness moves
        signals: along it there is nothing to resolve but the prior, whose width is 1, about.
        """
        signals, change, log = cells.signals, cells.change, cells.log_prior
        if self.soft is not None:
            log_e = self.match(reading, signals)[0][0]
            log = log - 0.5 * ((log_e - self.log_median) / self.log_sd) ** 2
            signals, change = self.scaled(signals, log_e), self.scaled(change, log_e)
        off = reading.value - self.observer.noise.mean(signals)
        log_sd: Any
        if reading.covariance is None:
            sd = np.maximum(np.sqrt(self.variance(reading, signals)), 1e-300)
            off, change, scale = off / sd, change / sd, signals / sd
            log_sd = np.log(sd).sum(axis=1)
        else:  # errors of a row may go together: in units in which they do not
            root = np.linalg.cholesky(self.covariance(reading, signals))
            inverse = np.linalg.inv(root)
            off, change, scale = (_whitened(inverse, v) for v in (off, change, signals))
            log_sd = np.log(np.diagonal(root, axis1=-2, axis2=-1)).sum(axis=-1)
        # Across half a cell each way, and a little more for curvature.
        spread = np.sqrt(1 + 0.36 * np.abs(change).sum(axis=0) ** 2)
        log = log - (0.5 * (off / spread) ** 2 + np.log(spread)).sum(axis=1) - log_sd
        near = log > log.max() - 2.0
        steps = change[:, near]
        if self.soft is not None and not self.for_touches:
            along = np.where(self.soft, scale[near], 0.0)
            size = (along**2).sum(axis=1) + self.log_sd**-2
            steps = steps - ((steps * along).sum(axis=2) / size)[..., None] * along
        return log, np.sqrt((steps**2).sum(axis=2)).max(axis=1) + 5.0 * step

    def alike(self, readings: Readings) -> list[Index]:
        """Rows in groups: every signal within one sd of that of the first of its group.

        Where they have measurement errors of their own, in units in which the first one's are
        independent and 1, and these must be alike too.
        """
        value, covariance = readings
        if covariance is None:
            variance = np.maximum(self.variance(readings, value), 1e-300)
            own = variance[..., None] * np.eye(value.shape[1])
        else:
            own = self.covariance(readings, value)
        inverse = np.linalg.inv(np.linalg.cholesky(own))
        far = 1.01 * np.sqrt(value.shape[1] * own[:, -1, -1])
        left, groups = np.lexsort(value.T), []
        while left.size:
            first = left[0]
            end = np.searchsorted(value[left, -1], value[first, -1] + far[first], side="right")
            some = left[:end]
            near = (np.abs(_whitened(inverse[first], value[some] - value[first])) <= 1).all(axis=1)
            if covariance is not None:
                errors = inverse[first] @ covariance[some] @ inverse[first].T
                near &= (np.abs(errors - errors[0]) < 0.25).all(axis=(1, 2))
            groups.append(some[near])
            left = np.delete(left, np.flatnonzero(near))
        return groups


def _whitened(inverse: Array, values: Array) -> Array:
    """Values (..., S) in units in which errors are independent and 1, by the roots' inverses."""
    return np.asarray(np.einsum("...ij,...j->...i", inverse, values))
