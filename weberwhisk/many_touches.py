"""Several touches of one object: one radial distance, to each touch a deflection of its own (§4).

Given the distance, touches are independent: each has a likelihood of the distance alone, its own
deflection integrated out, and these multiply. They are summed over a grid of contacts that is made
once for each observer: along it no step is longer than 0.28 JND, across each is 0.75 sd or less,
wherever it lies, where the trapezoid rule's error is below 1e-10.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage
from scipy.interpolate import CubicSpline
from scipy.special import ndtr

from . import _checks
from ._checks import finite, kind, positive_number, whole
from ._values import interval_text, with_units
from .coordinates import constrain_angle, constrain_distance, unconstrain_angle
from .jnd import fisher_jnd
from .mechanics.contact import Outcome
from .observer import Observer
from .posterior.result import Status, is_outside, is_unidentified
from .receptors import Seed

if TYPE_CHECKING:
    import pandas as pd

Array = NDArray[np.float64]
Index = NDArray[np.intp]


@dataclass(frozen=True, eq=False, repr=False)
class Touches:
    """The posterior of a radial distance from n touches; `touches` makes it.

    Attributes
    ----------
    observer : Observer
    count : int
        n.
    mean, sd : float
        Of the radial distance, m.
    status : Status
        `IMPROBABLE_READING` where a touch lies more than 5 sd from every contact at the distance
        found, or 8 from its own best; `UNIDENTIFIED` where none of them tells of its contact.
    r, density : array
        Density of the distance, 1/m, at distances, m.
    """

    observer: Observer
    count: int
    mean: float
    sd: float
    status: Status
    r: Array
    density: Array

    def __repr__(self) -> str:
        low, high = self.interval()
        r = interval_text(1e3 * self.mean, 1e3 * low, 1e3 * high, " mm")
        said = f"r = {r}, of {self.count}", self.status.message, self.observer.note
        return f"<Touches: {'; '.join(filter(None, said))}>"

    def interval(self, mass: float = 0.95) -> tuple[float, float]:
        """The equal-tailed interval that holds the distance with probability `mass`, m.

        Raises
        ------
        ValueError
            For a mass outside 0 to 1.
        """
        step = np.diff(self.r)
        rise = np.append(0.0, np.cumsum((self.density[1:] + self.density[:-1]) / 2 * step))
        tail = (1 - _checks.mass(mass)) / 2
        low, high = np.interp([tail, 1 - tail], rise / rise[-1], self.r)
        return float(low), float(high)


def touches(observer: Observer, readings: ArrayLike) -> Touches:
    """The posterior of the radial distance from several touches of it.

    Parameters
    ----------
    observer : Observer
        Of each touch; its prior of the deflection angle is each touch's own.
    readings : array, shape (n, S)
        One reading a touch, in SI units.

    Returns
    -------
    Touches

    Raises
    ------
    ValueError
        For readings that are not finite or of another shape, and for an observer of more unknowns
        than distance and deflection.

    Notes
    -----
    The prior of the deflection counts once for each touch, and by default all angles that stay in
    contact are as likely. Where touches are alike that belief is wrong as often as there are
    touches: of 17 light ones at k = 0.3 the mean was 4 sd off in a simulation. Say how the animal
    touches: ``Observer(..., prior={"deflection_angle": scipy.stats.halfnorm(scale=0.1)})``.

    Examples
    --------
    >>> from weberwhisk import Whisker, cues
    >>> observer = Observer(Whisker(50e-3, 100e-6, 5e-6), cues.ForceMap())
    >>> readings = observer.read([[30e-3, 0.1], [30e-3, 0.2], [30e-3, 0.3]], seed=1)
    >>> one, three = touches(observer, readings[:1]), touches(observer, readings)
    >>> print(f"{1e3 * one.sd:.1f} mm from one touch, {1e3 * three.sd:.1f} mm from three")
    3.3 mm from one touch, 1.5 mm from three
    """
    kind("observer", observer, "an Observer", "checked_reading", "write Observer(whisker, cue)")
    y = observer.checked_reading(readings)
    y = y.reshape(-1, y.shape[-1])
    grid = _grid(observer)
    x, best, low, high, width = grid.x, np.full(len(y), -np.inf), 0, len(grid.x), 1
    for step, depth in ((16, 60.0), (4, 32.0)):  # closer and closer to where they agree
        rows = np.arange(low, high, step)
        each = grid.log_likelihood(y, rows, 2)
        best = np.maximum(best, each.max(axis=1))
        log = each.sum(axis=0) + grid.log_prior[rows]
        if np.isfinite(log.max()):
            near = rows[log > log.max() - depth]
            low, high = max(near[0] - step, 0), min(near[-1] + step + 1, len(x))
            width = step * int((log > log.max() - 2.0).sum()) // 4  # of an sd, in rows
    rows = np.arange(low, high, max(width // 2, 1) if len(y) > 8 else 1)
    each = grid.log_likelihood(y, rows)
    best = np.maximum(best, each.max(axis=1))
    log = each.sum(axis=0) + grid.log_prior[rows]
    kept = log > log.max() - 32.0
    first, last = int(np.argmax(kept)), len(kept) - int(np.argmax(kept[::-1]))
    prior = observer.prior.get("radial_distance")
    if prior is not None:  # which rows may be too far apart to tell
        first, last = max(first - 3, 0), min(last + 3, len(rows))
    rows, log, each = rows[first:last], log[first:last], each[:, first:last]
    top, far = log.argmax(), bool(log.max() == -np.inf)
    if not far:
        contact, far = grid.best_contacts(y, rows[top])
        # A distance that all touches allow is for none of them worse by 8 sd than its own best.
        far |= len(y) > 1 and bool((best - each[:, top] > 32.0).any())
    coarse = grid.coarse[rows[log > log.max() - 20.0]].any()  # below lies no mass to speak of
    status = Status.IMPRECISE if coarse else Status.CONVERGED
    if far:
        status = Status.IMPROBABLE_READING
    if len(rows) < 4 or log[top] == -np.inf:
        # Hundreds of touches say more than the rows of the grid can tell.
        lost = status if far else Status.IMPRECISE
        nan = np.full(2, np.nan)
        return Touches(observer, len(y), np.nan, np.nan, lost, nan, nan)
    fine = np.linspace(x[rows[0]], x[rows[-1]], 16 * len(rows))
    if prior is not None:
        log = each.sum(axis=0) + grid.log_held[rows]
        sharp = prior.ppf(ndtr(np.linspace(-8.0, 8.0, 513)))
        sharp = observer.space.unconstrain_one(
            np.append(sharp, observer.space.leaps["radial_distance"]), 0
        )
        fine = np.union1d(fine, np.clip(sharp, fine[0], fine[-1]))
    log = np.maximum(log, log.max() - 60.0)  # none there to speak of
    log = CubicSpline(x[rows], log)(fine)
    r, log_slope = _distances(observer, fine)
    if prior is not None:
        log += prior.logpdf(r)
    step = np.gradient(fine)
    weight = np.exp(log - log.max()) * step
    mass = weight.sum()
    mean = float(weight @ r / mass)
    sd = float(np.sqrt(weight @ (r - mean) ** 2 / mass))
    # What is no wider than the reach by far is known.
    wide = sd * len(y) ** 0.5 > 0.1 * (observer.reach[1] - observer.reach[0])
    if wide and not far and is_unidentified(observer, contact).all():
        status = Status.UNIDENTIFIED
    density = weight / np.exp(log_slope) / mass / step
    return Touches(observer, len(y), mean, sd, status, r, density)


def _distances(observer: Observer, x: Array) -> tuple[Array, Array]:
    """r (n,) at their coordinates x, and ln dr/dx."""
    low, high = observer.reach
    fraction, log_slope = constrain_distance(x)
    return low + (high - low) * fraction, log_slope + np.log(high - low)


class _Grid:
    """The contacts of an observer in rows of one distance each, and their signals."""

    #: Steps along, in JNDs, and across, in sd; most nodes in all; sd within which a node matters.
    ALONG, ACROSS, MOST, WINDOW = 0.28, 0.75, 4_000_000, 7.5

    def __init__(self, observer: Observer, bins: int = 512) -> None:
        if len(observer.unknowns) > observer.bounded:
            raise ValueError(
                f"Touches are of distance and deflection alone, got {', '.join(observer.unknowns)} "
                "unknown; take a cue that knows the rest, such as Friction(cue, angle=0.0)."
            )
        self.observer = observer
        ends = np.linspace(-3.4, 4.0, 75)
        _, log_rate = _distances(observer, ends)
        jnd = np.full(len(ends), np.inf)
        for depth in (-3.0, -1.0, 0.0, 0.5, 1.0):
            told, _ = self._told(ends, np.array([depth]))
            with np.errstate(all="ignore"):
                jnd = np.fmin(jnd, np.sqrt(np.linalg.pinv(np.nan_to_num(told))[:, 0, 0, 0]))
        rate = np.clip(np.exp(log_rate) / np.maximum(jnd, 1e-12) / self.ALONG, 4.0, 400.0)
        rise = np.append(0.0, np.cumsum((rate[1:] + rate[:-1]) / 2 * np.diff(ends)))
        self.x = np.interp(np.linspace(0, rise[-1], int(rise[-1]) + 2), rise, ends)
        self.coarse, y, log_step = np.zeros(len(self.x), bool), np.zeros((1, 1)), np.zeros((1, 1))
        if observer.bounded > 1:
            y, log_step = self._across()
        r, log_rate = _distances(observer, self.x)
        low, width = observer.angle_range(r)
        fraction, log_across = constrain_angle(y)
        theta = low + width[:, None] * fraction
        self.r, self.theta = r, theta
        weight = np.broadcast_to(log_across + log_step, theta.shape).copy()
        if (prior := observer.prior.get("deflection_angle")) is not None:
            weight += prior.logpdf(theta)
            if observer.space.leaps["deflection_angle"].size:  # which the rule does not see
                middle = (theta[:, 1:] + theta[:, :-1]) / 2
                ends = np.column_stack([0 * r + low, middle, low + width])
                with np.errstate(divide="ignore"):
                    weight = np.log(np.diff(prior.cdf(ends), axis=1))
        place = np.stack([np.broadcast_to(r[:, None], theta.shape), theta], axis=-1)
        signals, outcome = observer.signals(place[..., : observer.bounded])
        held = outcome == Outcome.HELD
        weight[~held] = -np.inf
        whole = np.logaddexp.reduce(weight, axis=1, keepdims=True)
        self.weight = weight - np.where(np.isfinite(whole), whole, 0.0)
        signals = np.where(held[..., None], signals, 1.0)
        # In C's order, or each `take` would copy the whole of it first.
        self.signals = np.ascontiguousarray(signals.reshape(-1, signals.shape[-1]))
        with np.errstate(divide="ignore"):
            self.log_held = np.log(observer.angles_held(r)) + log_rate
            self.log_prior = self.log_held
            if (prior := observer.prior.get("radial_distance")) is not None:
                ends, _ = _distances(observer, (self.x[1:] + self.x[:-1]) / 2)
                share = np.diff(prior.cdf(ends), prepend=0.0, append=1.0)
                self.log_prior = self.log_held + np.log(share / np.gradient(r))
        low_y, high_y = observer.noise.interval(signals, self.WINDOW)
        high_y = np.where(held[..., None], high_y, -np.inf)
        low_y = np.where(held[..., None], low_y, np.inf)[:, ::-1]
        # Made monotone across: in which columns a reading can be is known by what it lies between.
        high_y = np.moveaxis(np.maximum.accumulate(high_y, axis=1), -1, 0)
        low_y = np.moveaxis(np.minimum.accumulate(low_y, axis=1)[:, ::-1], -1, 0)
        share = np.linspace(0.0, 1.0, bins)
        self._between: list[Array] = []
        self._first, self._last = np.empty((2, len(high_y), bins + 1, len(r)), dtype=np.int32)
        for k, (tops, feet) in enumerate(zip(high_y, low_y, strict=True)):
            ends = np.quantile(np.concatenate([a[np.isfinite(a)] for a in (tops, feet)]), share)
            self._between.append(ends)
            for i, (top, foot) in enumerate(zip(tops, feet, strict=True)):
                self._first[k, 0, i], self._last[k, -1, i] = 0, len(top)
                self._first[k, 1:, i] = np.searchsorted(top, ends)
                self._last[k, :-1, i] = np.searchsorted(foot, ends, side="right")

    def best_contacts(self, reading: Array, row: int) -> tuple[Array, bool]:
        """The most probable contacts (n, U) at one distance; if any is 5 sd from its reading."""
        signals = self.signals.reshape(*self.weight.shape, -1)[row]
        best = (self.observer.noise.log_likelihoods(reading, signals) + self.weight[row]).argmax(1)
        far = is_outside(self.observer.noise, reading, signals[best]).any()
        theta = self.theta[row][best]
        contact = np.stack([np.full(len(theta), self.r[row]), theta], axis=-1)
        return contact[:, : self.observer.bounded], bool(far)

    def _told(self, x: Array, depth: Array) -> tuple[Array, Array]:
        """Information (n, D, U, U) at coordinates x (n,) and depths (D,); dθ/d depth."""
        r, _ = _distances(self.observer, x)
        low, width = self.observer.angle_range(r)
        fraction, log_slope = constrain_angle(depth)
        theta = low + width[:, None] * fraction
        contact = np.stack([np.broadcast_to(r[:, None], theta.shape), theta], axis=-1)
        told = self.observer.information(
            contact[..., : self.observer.bounded].reshape(-1, self.observer.bounded)
        )
        return told.reshape(*theta.shape, *told.shape[1:]), width[:, None] * np.exp(log_slope)

    def _across(
        self, *, terms: int = 21, samples: int = 65, finest: float = 20.0
    ) -> tuple[Array, Array]:
        """Angles' coordinates (rows, columns) at even steps of what is told, and ln of the steps.

        Even steps of the coordinate miss bumps where signals hardly change with the angle but in a
        part of its range: ten touches 5 mm from the base were 4 sd off at k = 0.03. The density of
        nodes is a polynomial, so that sums stay as exact as those of even steps.
        """
        start, stop = unconstrain_angle(np.array([1e-6, 1 - 1e-8]))
        t = np.cos(np.pi * (np.arange(samples) + 0.5) / samples)
        told, unit = self._told(self.x, (start + stop) / 2 + (stop - start) / 2 * t)
        rate = np.nan_to_num(np.sqrt(told[..., 1, 1]) * unit, nan=0.0, posinf=0.0)
        # Where a signal passes through zero its noise does: no reading is of there.
        usual = np.quantile(rate, 0.75, axis=1, keepdims=True)
        rate = ndimage.maximum_filter1d(np.minimum(rate, finest * usual), 3, axis=1)
        rate = np.hypot(rate, 3.0)  # a third of an sd of the range itself, which is summed too
        if (prior := self.observer.prior.get("deflection_angle")) is not None:
            sharpest = np.sqrt(2 * np.pi) * prior.pdf(prior.ppf(np.linspace(0.02, 0.98, 49))).max()
            rate = np.hypot(rate, sharpest * unit)
        shape = np.asarray(chebyshev.chebfit(t, rate.T, terms - 1))  # (terms, rows)
        # Jackson's factors: smoothed by a kernel that is nowhere negative, as densities must be.
        turn = np.pi / (terms + 1)
        n = np.arange(terms)[:, None]
        damping = (1 - n * turn / np.pi) * np.cos(n * turn)
        shape *= damping + np.sin(n * turn) / np.tan(turn) * turn / np.pi
        fine = np.linspace(-1, 1, 401)
        rise = np.asarray(chebyshev.chebint(shape, lbnd=-1))
        whole = np.asarray(chebyshev.chebval(1.0, rise))
        count = (stop - start) / 2 * whole / self.ACROSS + 2
        columns = min(int(count.max()), self.MOST // len(self.x))
        self.coarse = count * self.ACROSS > columns  # steps of 1 sd still sum to 5e-9
        wanted = np.linspace(0.0, 1.0, columns)
        table = chebyshev.chebval(fine, rise) / whole[:, None]
        place = np.stack([np.interp(wanted, row, fine) for row in table])
        for _ in range(2):
            miss = _series(rise, place) / whole[:, None] - wanted
            density = _series(shape, place) / whole[:, None]
            place = np.clip(place - miss / density, -1.0, 1.0)
        return (start + stop) / 2 + (stop - start) / 2 * place, -np.log(_series(shape, place))

    def log_likelihood(self, reading: Array, rows: Index, stride: int = 1) -> Array:
        """ln p(reading | distance), (n, rows), of readings (n, R), deflections integrated out.

        By every so many of the nodes.
        """
        first = np.zeros((len(rows), len(reading)), dtype=np.intp)
        last = np.full(first.shape, self.weight.shape[1])
        for k, y in enumerate(reading.T):
            at = np.searchsorted(self._between[k], y)[None, :], rows[:, None]
            np.maximum(first, self._first[k][at], out=first)
            np.minimum(last, self._last[k][at], out=last)
        some = np.flatnonzero((last > first).ravel())
        out = np.full(first.size, -np.inf)
        if some.size:
            row, which = np.divmod(some, len(reading))
            start, count = first.ravel()[some], (last - first).ravel()[some]
            count = (count + stride - 1) // stride
            begin = np.cumsum(count) - count
            start = start + rows[row] * self.weight.shape[1] - begin * stride
            node = np.repeat(start, count) + stride * np.arange(count.sum())
            y = np.repeat(reading[which], count, axis=0)
            log = self.observer.noise.log_likelihood(y, self.signals.take(node, axis=0))
            log += self.weight.take(node)
            top = np.maximum.reduceat(log, begin)
            log -= np.repeat(np.where(np.isfinite(top), top, 0.0), count)
            with np.errstate(divide="ignore"):
                out[some] = top + np.log(np.add.reduceat(np.exp(log), begin) * stride)
        return np.nan_to_num(out, nan=-np.inf, neginf=-np.inf).reshape(first.shape).T


def _series(coefficients: Array, t: Array) -> Array:
    """Chebyshev series (terms, rows), each at its own places (rows, n)."""
    return np.asarray(chebyshev.chebval(t, coefficients[..., None], tensor=False))


@lru_cache(maxsize=8)
def _grid(observer: Observer) -> _Grid:
    return _Grid(observer)


def touches_jnd(
    observer: Observer,
    radial_distance: float,
    deflection_angles: ArrayLike,
    counts: ArrayLike = (1, 2, 5, 10, 20, 50),
    *,
    n_readings: int = 100,
    seed: Seed = None,
) -> pd.DataFrame:
    """The JND of a distance against the number of touches, beside 1/√n.

    Parameters
    ----------
    observer : Observer
    radial_distance : float
        m.
    deflection_angles : float or array
        Of one touch after the other, in turn, rad.
    counts : array of int
        Numbers of touches.
    n_readings : int
        Simulated sets of touches at each number.
    seed : int, SeedSequence or Generator

    Returns
    -------
    pandas.DataFrame
        A row a number: ``count``, ``posterior_mm`` (the mean sd of posteriors), its Monte Carlo
        error ``posterior_error_mm``, ``fisher_mm`` (information summed over touches) and
        ``root_n_mm`` (the first touch's Fisher JND over √n).

    Raises
    ------
    ValueError
        For no numbers of touches or angles, numbers of touches below 1 and of readings below 2, and
        contacts that are not held.

    Notes
    -----
    Mice tell pole positions about 1 mm apart with one whisker and 1 to 17 touches (Pammer et al.
    2013, J Neurosci 33:6726).
    """
    import pandas as pd

    radial_distance = positive_number("radial_distance", radial_distance, "give metres")
    angles = np.atleast_1d(finite("deflection_angles", deflection_angles, "give radians"))
    if not angles.size:
        raise ValueError("deflection_angles must be one or more, got none; give radians.")
    wanted = [whole("counts", n, "give numbers of touches", least=1) for n in np.ravel(counts)]
    n_readings = whole("n_readings", n_readings, "write 100, say", least=2)
    rng = np.random.default_rng(seed)
    rows = []
    for n in wanted:
        theta = np.resize(angles, n)
        contact = np.stack([np.full(n, radial_distance), theta], axis=-1)[:, : observer.bounded]
        jnd = np.atleast_1d(fisher_jnd(observer, contact))
        sds = [touches(observer, observer.read(contact, rng)).sd for _ in range(n_readings)]
        error = np.std(sds, ddof=1) / np.sqrt(n_readings)
        fisher = np.sum(jnd**-2.0) ** -0.5
        rows.append((n, np.mean(sds), error, fisher, jnd[0] / np.sqrt(n)))
    lengths = ["posterior", "posterior_error", "fisher", "root_n"]
    return with_units(pd.DataFrame(rows, columns=["count", *lengths]), lengths)
