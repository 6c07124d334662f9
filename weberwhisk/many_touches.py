"""Several touches of one object: one radial distance, to each touch a deflection of its own (§4).

Given the distance, touches are independent: each has a likelihood of the distance alone, its own
deflection integrated out, and these multiply. They are summed over a grid of contacts that is made
once for each observer (`touch_rows`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline
from scipy.special import ndtr

from . import _checks
from ._checks import finite, kind, positive_number, whole
from ._values import interval_text, pd, with_units
from .coordinates import leaps
from .jnd import fisher_jnd
from .mechanics.contact import Outcome
from .observer import Observer
from .posterior.result import Status, is_outside, is_unidentified
from .receptors import Seed
from .touch_rows import TouchRows, distances, highest

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
        Of each touch; its priors of the deflection angle and of an unknown friction are each
        touch's own.
    readings : array, shape (n, S)
        One reading a touch, in SI units.

    Returns
    -------
    Touches

    Raises
    ------
    ValueError
        For readings that are not finite or of another shape, and for an observer of other unknowns
        than distance, deflection and friction: a stiffness, curvature or hinge is the whisker's,
        the same in all touches, which no product over touches knows.

    Notes
    -----
    The prior of the deflection counts once for each touch, and by default all angles that stay in
    contact are as likely. Where touches are alike that belief is wrong as often as there are
    touches: of 17 light ones at k = 0.3 the mean was 4 sd off in a simulation. Say how the animal
    touches: ``Observer(..., prior={"deflection_angle": scipy.stats.halfnorm(scale=0.1)})``.

    The sd of n equal touches is that of one over √n as far as one touch's posterior is Gaussian:
    2 % less of ten at k = 0.03 on a straight whisker and 4 % at a curvature of 8 /m, where it is
    skewed; 0.2 and 0.5 % at k = 0.01.

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
    for step, depth, stride in ((16, 60.0, 3), (4, 32.0, 2)):  # closer to where they agree
        rows = np.arange(low, high, step)
        each = grid.log_likelihood(y, rows, stride)
        best = np.maximum(best, each.max(axis=1))
        log = each.sum(axis=0) + grid.log_prior[rows]
        if np.isfinite(log.max()):
            near = rows[log > log.max() - depth]
            low, high = max(near[0] - step, 0), min(near[-1] + step + 1, len(x))
            width = step * int((log > log.max() - 2.0).sum()) // 4  # of an sd, in rows
    between = np.interp(np.arange(low, high), rows, np.maximum(log, log.max() - 40.0))
    skip = max(width // 2, 1) if len(y) > 8 else 1
    if len(observer.unknowns) > 2:  # rows are as close as the friction's ends ask, and dear
        skip = min(max(width // 4, 1), 3)
    rows = np.arange(low, high, skip)
    if observer.prior.get("radial_distance") is None:
        rows = rows[between[rows - low] >= between.max() - 32.0]
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
    status = Status.IMPRECISE if grid.coarse else Status.CONVERGED
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
    r, log_slope = distances(observer, fine)
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


class FrictionRows(TouchRows):
    """Rows of contacts whose friction is unknown, and of each touch its own.

    There are too many contacts to keep. Of each row the signals are kept as polynomials of
    c = √(1 − share of the largest deflection), in which they are smooth up to the fold, and of the
    friction. For a row and a reading the rectangle of both is cut in two, where the signals change
    most, until none changes by more than `LONGEST` sd, and parts that the reading cannot be of are
    left out; what remains is summed by 6 × 6 of Gauss and Legendre's nodes each.
    """

    #: The longest parts, in sd: 3e-6 of an evidence off, and 2e-4 at 7.5; pairs at a time.
    LONGEST, AT_ONCE = 5.5, 400

    def _lay(self, at_once: int = 48, *, across: int = 24, terms: int = 9) -> None:
        """Coefficients (rows, S + 1, across, terms) of signals over the angle, and of its range."""
        observer = self.observer
        prior = observer.prior[observer.unknowns[-1]]
        self.low = observer.angle_range(self.r)[0]
        ends = np.array(prior.support())
        self.ends = np.where(np.isfinite(ends), ends, prior.ppf(ndtr([-6.0, 6.0])))
        nodes = [np.cos(np.pi * (np.arange(k) + 0.5) / k) for k in (across, terms)]
        fits = [np.linalg.inv(chebyshev.chebvander(t, len(t) - 1)) for t in nodes]
        c, last = (nodes[0] + 1) / 2, self._value((nodes[1] + 1) / 2)
        width = self._widths(self.r, last)
        values = self._signals(self.r[:, None, None], width[:, None], c[:, None], last)
        self.known = np.asarray(np.isfinite(values).all(axis=(1, 2, 3)))
        values[~self.known] = 1.0
        self.parts = np.einsum("ic,jp,ncps->nsij", *fits, values, optimize=True)
        self.ranges = width @ fits[1].T
        share, weight = np.polynomial.legendre.leggauss(16)
        last = self._value((share + 1) / 2)
        held = self._widths(self.r, last)
        if "deflection_angle" in observer.prior:
            angle = observer.prior["deflection_angle"]
            low = self.low
            held = angle.cdf(low + held) - angle.cdf(low)
        self.held = held @ (weight * prior.pdf(last)) * (self.ends[1] - self.ends[0]) / 2
        leaping = [leaps(prior), *observer.space.leaps.values()]
        self.coarse = self._misfit() > 0.03 or any(a.size for a in leaping)

    def _value(self, share: Array) -> Array:
        return self.ends[0] + (self.ends[1] - self.ends[0]) * share

    def _widths(self, r: Array, last: Array) -> Array:
        """Ranges (n, J) of the angle at distances (n,) and values (J,) of the unknown."""
        contact = np.ones((len(r), len(last), 3))
        contact[..., 0], contact[..., 2] = r[:, None], last
        return self.observer.space.angle_range(contact[..., 0], contact)[1]

    def _signals(self, r: Array, width: Array, c: Array, last: Array) -> Array:
        """Signals (..., S) over the angle, NaN where not held."""
        low = self.low
        theta = low + width * (1 - c**2)
        contact = np.stack(np.broadcast_arrays(r, theta, last), axis=-1)
        signals, outcome = self.observer.signals(contact)
        return np.where((outcome == Outcome.HELD)[..., None], signals, np.nan) / theta[..., None]

    def _misfit(self, count: int = 400) -> float:
        """How far off, in sd, the worst but one in twenty of contacts are."""
        rng = np.random.default_rng(20261123)
        row = rng.choice(np.flatnonzero(self.known), count)
        c, share = rng.uniform(0.02, 0.98, (2, count))
        last = self._value(share)
        box = np.column_stack([c, c, share, share])
        found, _ = self._felt(row, box, np.zeros(1))
        contact = np.stack([self.r[row], np.zeros(count), last], axis=-1)
        least, width = self.observer.space.angle_range(self.r[row], contact)
        contact[:, 1] = least + width * (1 - c**2)
        exact, outcome = self.observer.signals(contact)
        held = outcome == Outcome.HELD
        low, high = self.observer.noise.interval(exact[held], 0.5)
        found_low, found_high = self.observer.noise.interval(found[held, 0], 0.5)
        with np.errstate(all="ignore"):
            off = np.abs(found_low + found_high - low - high) / 2 / (high - low)
        return float(np.quantile(np.nan_to_num(off.max(axis=1), nan=np.inf), 0.95))

    def _felt(self, row: Index, box: Array, at: Array) -> tuple[Array, Array]:
        """Signals (m, J², S) in boxes (m, 4) of rows, at places −1 to 1 of either; contacts."""
        sides = [
            (box[:, [i]] + box[:, [i + 1]]) / 2 + (box[:, [i + 1]] - box[:, [i]]) / 2 * at
            for i in (0, 2)
        ]
        first, second = (
            chebyshev.chebvander(2 * side - 1, k - 1)
            for side, k in zip(sides, self.parts.shape[2:], strict=True)
        )
        felt = first[:, None] @ self.parts[row] @ second.swapaxes(1, 2)[:, None]
        felt = np.moveaxis(felt, 1, -1)
        share = 1 - sides[0][:, :, None] ** 2
        width = (second @ self.ranges[row][:, :, None]).swapaxes(1, 2)
        low = self.low
        contact = np.empty((*felt.shape[:3], 3))
        contact[..., 0] = self.r[row][:, None, None]
        contact[..., 1] = low + width * share
        contact[..., 2] = self._value(sides[1])[:, None]
        signals = felt * contact[..., 1:2]
        # The measure of c: dθ = 2 c width dc.
        measure = 2 * sides[0][:, :, None] * width
        flat = len(row), -1
        contact = np.concatenate([contact, measure[..., None]], axis=-1)
        return signals.reshape(*flat, signals.shape[-1]), contact.reshape(*flat, 4)

    def _leaves(
        self, reading: Array, row: Index, *, deepest: int = 60
    ) -> Iterator[tuple[Index, Array, Array, Array]]:
        """Pairs, contacts and ln of what they add, of nodes of readings (m, R) and rows (m,)."""
        at, weight = np.polynomial.legendre.leggauss(6)
        both = np.outer(weight, weight).ravel() / 4
        noise, prior = self.observer.noise, self.observer.prior
        pair, box = np.arange(len(row)), np.tile([0.0, 1.0, 0.0, 1.0], (len(row), 1))
        corner = np.arange(36).reshape(6, 6)
        angle = prior.get("deflection_angle")
        last = prior[self.observer.unknowns[-1]]
        sharpest = [0.0 if p is None else highest(p) for p in (angle, last)]
        for depth in range(deepest):
            if not pair.size:
                return
            signals, contact = self._felt(row[pair], box, at)
            low, high = noise.interval(signals, 6.0)
            low, high = low.min(axis=1), high.max(axis=1)
            room = 0.1 * (high - low)
            y = reading[pair]
            some = np.all((y >= low - room) & (y <= high + room), axis=1)
            pair, box, signals, contact = pair[some], box[some], signals[some], contact[some]
            if not pair.size:
                return
            low, high = noise.interval(signals, 0.5)
            unit, middle = (high - low).min(axis=1), (low + high) / 2
            change = []
            for i, ends in enumerate(((corner[0], corner[-1]), (corner[:, 0], corner[:, -1]))):
                turn = np.abs(middle[:, ends[1]] - middle[:, ends[0]]).max(axis=1)
                with np.errstate(all="ignore"):
                    part = np.nan_to_num(turn / unit, nan=0.0, posinf=1e9)
                own = contact[:, ends[1], i + 1] - contact[:, ends[0], i + 1]
                own = sharpest[i] * np.abs(own).max(axis=1)
                change.append(np.sqrt(np.square(part).sum(axis=1) + own**2) / 0.93)
            along = change[0] >= change[1]
            done = np.maximum(*change) <= (self.LONGEST if depth < deepest - 1 else np.inf)
            if done.any():
                log = noise.log_likelihood(reading[pair[done]][:, None], signals[done])
                side = box[done][:, [1, 3]] - box[done][:, [0, 2]]
                with np.errstate(divide="ignore"):
                    log = (
                        log
                        + np.log(side.prod(axis=1) * (self.ends[1] - self.ends[0]))[:, None]
                        + np.log(both)
                    )
                    log += np.log(np.maximum(contact[done][..., 3], 0.0))
                log += last.logpdf(contact[done][..., 2])
                if angle is not None:
                    log += angle.logpdf(contact[done][..., 1])
                yield pair[done], contact[done], signals[done], log
            pair, box, along = pair[~done], box[~done], along[~done]
            most = np.maximum(*change)[~done] / self.LONGEST
            pieces = np.clip(np.ceil(most), 2, 4).astype(np.intp)
            which = np.repeat(np.arange(len(pair)), pieces)
            piece = np.arange(len(which)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
            pair, box, each = pair[which], box[which], np.arange(len(which))
            split, pieces = np.where(along, 0, 2)[which], pieces[which]
            low = box[each, split]
            step = (box[each, split + 1] - low) / pieces
            box[each, split], box[each, split + 1] = low + piece * step, low + (piece + 1) * step

    def log_likelihood(self, reading: Array, rows: Index, stride: int = 1) -> Array:
        """ln p(reading | distance), (n, rows), of readings (n, R), all else integrated out.

        The same with any stride.
        """
        row, which = np.divmod(np.arange(len(rows) * len(reading)), len(reading))
        out = np.full(len(row), -np.inf)
        able = np.flatnonzero(self.known[rows][row])
        for part in np.array_split(able, max(1, len(able) // self.AT_ONCE)):
            found = list(self._leaves(reading[which[part]], rows[row[part]]))
            if found:
                pair = np.concatenate([f[0] for f in found])
                log = np.logaddexp.reduce(np.concatenate([f[3] for f in found]), axis=1)
                order = np.argsort(pair, kind="stable")
                pair, log = pair[order], log[order]
                begin = np.flatnonzero(np.diff(pair, prepend=-1))
                out[part[pair[begin]]] = np.logaddexp.reduceat(log, begin)
        out -= np.log(self.held[rows[row]])
        return np.nan_to_num(out, nan=-np.inf, neginf=-np.inf).reshape(len(rows), -1).T

    def best_contacts(self, reading: Array, row: int) -> tuple[Array, bool]:
        """The most probable contacts (n, U) at one distance; if any is 5 sd from its reading."""
        best = np.full(len(reading), -np.inf)
        contacts, felt = np.empty((len(reading), 3)), None
        for pair, contact, signals, log in self._leaves(reading, np.full(len(reading), row)):
            felt = np.ones((len(reading), signals.shape[-1])) if felt is None else felt
            for i, p in enumerate(pair):
                at = log[i].argmax()
                if log[i, at] > best[p]:
                    best[p], contacts[p], felt[p] = log[i, at], contact[i, at, :3], signals[i, at]
        if felt is None or not np.isfinite(best).all():
            return contacts[:0], True
        return contacts, bool(is_outside(self.observer.noise, reading, felt).any())


@lru_cache(maxsize=8)
def _grid(observer: Observer) -> TouchRows:
    further = observer.unknowns[observer.bounded :]
    if not further:
        return TouchRows(observer)
    if further != ("friction_angle",) or observer.bounded < 2:
        raise ValueError(
            "Touches are of distance and deflection, and of friction where both are unknown, got "
            f"{', '.join(observer.unknowns)} unknown; take a cue that knows the rest."
        )
    return FrictionRows(observer)


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
