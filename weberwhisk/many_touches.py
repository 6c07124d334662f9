"""Several touches of one object: one radial distance, to each touch a deflection of its own (§4).

Given the distance, touches are independent: each has a likelihood of the distance alone, its own
deflection integrated out, and these multiply. They are summed over a grid of contacts that is made
once for each observer (`posterior.rows`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import make_interp_spline
from scipy.special import ndtr

from . import _checks
from ._checks import finite, kind, positive_number, whole
from ._values import Array, interval_text, pd, with_units
from .jnd import fisher_jnd
from .observer import Observer
from .posterior.friction import friction_rows
from .posterior.result import Status, is_unidentified
from .posterior.rows import TouchRows, distances
from .receptors import Seed


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
        found, or 8 from its own best; `UNIDENTIFIED` where none of them tells of its contact;
        `IMPRECISE` where more than 3e-3 of a touch's likelihood may lie between the nodes summed,
        as beside a zero of a signal, where Weber's law has no noise.
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

    One touch has the mean and sd of its `posterior` at ``tolerance=1e-6`` to 1e-6 of the sd. At the
    default 1e-2 that is itself some 1e-6 to 1e-5 off, 2e-4 at worst.

    The sd of n equal touches is that of one over √n as far as one touch's posterior is Gaussian. Of
    ten at k = 0.03 it is less: by 2 % for 25 mm and 0.2 rad of a straight whisker of 50 mm, by 4 %
    at a curvature of 8 /m, where posteriors are skewed, and by 46 % next to flick-past near the
    base, where one touch's posterior ends (median 3 % over the reach, 5 % at 8 /m); at k = 0.01 by
    0.2 and 0.5 %. There two signals ask for more nodes than are kept: such touches are `IMPRECISE`.

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
    sure = np.maximum(each, -1e6)
    whole = sure.sum(axis=0) + grid.log_prior[rows]
    might = whole - sure + np.logaddexp(sure, grid.hidden(y, rows))
    missed = np.logaddexp.reduce(might, axis=1) - np.logaddexp.reduce(whole)
    precise = not grid.coarse and missed.max() < 3e-3
    status = Status.CONVERGED if precise else Status.IMPRECISE
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
    # By a quintic: a cubic was up to 1e-5 sd off beside the base.
    log = make_interp_spline(x[rows], log, k=5 if len(rows) > 5 else 3)(fine)
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
    return friction_rows(observer)


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
