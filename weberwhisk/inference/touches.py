"""Several touches of one object: one radial distance, to each touch a deflection of its own (§4).

Given the distance, touches are independent: each has a likelihood of the distance alone, its own
deflection integrated out, and these multiply. They are summed over a grid of contacts that is made
once for each observer (`posterior.rows`). A stiffness, curvature or hinge that is not known is the
same in all touches: it is summed over nodes, at each of which it is known.
"""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import PchipInterpolator, make_interp_spline
from scipy.special import ndtr

from .. import _checks
from .._checks import kind
from .._values import Array, interval_text
from ..receptors import Weber
from .coordinates import from_normal
from .friction import friction_rows
from .nodes import TURNING, conditional
from .observer import Observer
from .result import Status, is_unidentified
from .rows import TouchRows, distances


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
    shared : dict
        Of an unknown that is the same in all touches, by its name: posterior mean and sd.
    """

    observer: Observer
    count: int
    mean: float
    sd: float
    status: Status
    r: Array
    density: Array
    shared: dict[str, tuple[float, float]] = field(default_factory=dict)

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
        tail = (1 - _checks.mass(mass)) / 2
        low, high = self._quantiles(np.array([tail, 1 - tail]))
        return float(low), float(high)

    def _quantiles(self, p: Array) -> Array:
        step = np.diff(self.r)
        rise = np.append(0.0, np.cumsum((self.density[1:] + self.density[:-1]) / 2 * step))
        return np.interp(p, rise / rise[-1], self.r)


def touches(observer: Observer, readings: ArrayLike) -> Touches:
    """The posterior of the radial distance from several touches of it.

    Parameters
    ----------
    observer : Observer
        Of each touch; its priors of the deflection angle and of an unknown friction are each
        touch's own. An unknown stiffness, curvature or hinge is the whisker's, one for all touches.
    readings : array, shape (n, S)
        One reading a touch, in SI units.

    Returns
    -------
    Touches

    Raises
    ------
    ValueError
        For readings that are not finite or of another shape, and for an observer of other unknowns
        than distance, deflection, friction, and one of stiffness, curvature and hinge.

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

    What all touches share does not average out: of one deflection a stiffness moves all alike, and
    only touches that differ tell it from the distance. It is summed over 12 to 40 of its values, in
    20 to 100 ms, each with a grid of its own but for a stiffness under Weber's law. These take 2 to
    6 s at first at k = 0.1, and 10 to 30 s and 2 GB at k = 0.03; there they are too many to keep
    for a concave whisker, whose touches take 25 s each time.

    Examples
    --------
    >>> from weberwhisk import Whisker, cues
    >>> observer = Observer(Whisker(50e-3, 100e-6, 5e-6), cues.ForceMap())
    >>> readings = observer.read([[30e-3, 0.1], [30e-3, 0.2], [30e-3, 0.3]], seed=1)
    >>> one, three = touches(observer, readings[:1]), touches(observer, readings)
    >>> print(f"{1e3 * one.sd:.1f} mm from one touch, {1e3 * three.sd:.1f} mm from three")
    3.3 mm from one touch, 1.5 mm from three

    A stiffness that is not known is found on the way:

    >>> soft = Observer(Whisker(50e-3, 100e-6, 5e-6), cues.UnknownStiffness(cues.ForceMap()))
    >>> found = touches(soft, readings)
    >>> mean, sd = found.shared["stiffness"]
    >>> print(f"{1e3 * found.sd:.1f} mm, stiffness {mean:.2f} ± {sd:.2f}")
    4.4 mm, stiffness 1.15 ± 0.40
    """
    kind("observer", observer, "an Observer", "checked_reading", "write Observer(whisker, cue)")
    y = observer.checked_reading(readings)
    y = y.reshape(-1, y.shape[-1])
    shared = shared_unknowns(observer)
    if len(shared) > 1 or not set(shared) <= {"stiffness", *TURNING}:
        raise ValueError(
            "Touches are of distance and deflection, of friction, and of one of stiffness, "
            f"curvature and hinge, got {', '.join(observer.unknowns)} unknown; take a cue that "
            "knows the rest."
        )
    if shared:
        return _over_nodes(observer, shared[0], y)
    return _touches(observer, y)[0]


def _touches(observer: Observer, y: Array) -> tuple[Touches, float]:
    """The posterior from readings (n, S), and ln of the evidence, but for the prior's constant."""
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
    log_evidence = float(np.logaddexp.reduce(whole + np.log(skip * grid.step[rows])))
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
        return Touches(observer, len(y), np.nan, np.nan, lost, nan, nan), log_evidence
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
    smooth = make_interp_spline(x[rows], log, k=5 if len(rows) > 5 else 3)(fine)
    if smooth.max() > log.max() + 5.0:  # no peak: touches disagree, too steep for a quintic
        smooth = PchipInterpolator(x[rows], log)(fine)
    log = smooth
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
    return Touches(observer, len(y), mean, sd, status, r, density), log_evidence


#: Grids that are kept, the last used last, and nodes of all of them: 2 GB.
_kept: OrderedDict[Observer, TouchRows] = OrderedDict()
MOST_KEPT = 60_000_000


def _grid(observer: Observer) -> TouchRows:
    if len(observer.unknowns) > observer.bounded:
        if observer.bounded < 2:
            raise ValueError(
                "Touches have an unknown friction where their deflection is unknown too, got "
                f"{', '.join(observer.unknowns)} unknown; give the friction's angle."
            )
        return friction_rows(observer)
    if observer not in _kept:
        _kept[observer] = TouchRows(observer)
        while len(_kept) > 1 and sum(len(grid.theta) for grid in _kept.values()) > MOST_KEPT:
            _kept.popitem(last=False)
    _kept.move_to_end(observer)
    return _kept[observer]


#: Nodes of an unknown shared by touches lie at even parts of one of z at closest, so far out.
PARTS, FARTHEST = 16, 6
#: Difference of sums at which their steps are close enough, in sds: at 1e-3 ends of intervals were
#: up to 0.014 sd off, at 1e-4 up to 0.0015.
PRECISION = 1e-4
#: Normal scores at which conditional quantiles of the distance are known.
SCORES = np.linspace(-6.0, 6.0, 97)


def _over_nodes(observer: Observer, name: str, y: Array) -> Touches:
    """The posterior where an unknown of a name is the same in all touches.

    Evidence and conditional posteriors are smooth in its normal coordinate z: steps are halved,
    where there is mass, until sums over nodes and over what is interpolated between them agree.
    """
    known: dict[int, tuple[Touches, float]] = {}
    stride, asked = PARTS, set(range(-3 * PARTS, 3 * PARTS + 1, PARTS))
    while True:
        for k in asked:
            one, log_evidence = _given(observer, name, k / PARTS, y)
            known[k] = one, log_evidence - 0.5 * (k / PARTS) ** 2
        top = max(log for _, log in known.values())
        best = next(one for one, log in known.values() if log == top)
        if top == -np.inf or not np.isfinite(best.mean):
            return replace(best, observer=observer)
        # At three sds the prior alone is e^-4.5 below its top.
        heavy = [k for k, (_, log) in known.items() if log > top - 16]
        first, last = min(heavy), max(heavy)
        reach = FARTHEST * PARTS
        asked = {k for k in (first - PARTS, last + PARTS) if abs(k) <= reach} - set(known)
        low, high = min(known), max(known)
        inside = range(max(first - stride, low), min(last + stride, high) + 1)
        asked |= {k for k in inside if k % stride == 0} - set(known)
        if asked:
            continue
        at = np.array([k for k in inside if k % stride == 0])
        sums = _Between(at / PARTS, [known[k] for k in at])
        if sums.error < PRECISION or stride == 1:
            break
        stride //= 2
        asked = {k for k in inside if k % stride == 0} - set(known)
    value = from_normal(observer.prior[name])(sums.z)
    middle = sums.share @ value
    shared = {name: (float(middle), float(np.sqrt(sums.share @ (value - middle) ** 2)))}
    status = best.status
    if status == Status.CONVERGED:
        rough = [log > top - 5 and one.status == Status.IMPRECISE for one, log in known.values()]
        status = Status.IMPRECISE if any(rough) or sums.error > PRECISION else status
    r, density = sums.density()
    return Touches(observer, len(y), *sums.moments, status, r, density, shared)


def _given(observer: Observer, name: str, z: float, y: Array) -> tuple[Touches, float]:
    """`_touches` where the shared unknown is known, at its normal coordinate z.

    Readings under Weber's law of a stiffness e are those of 1, times e: one grid serves them all.
    """
    if type(observer.noise) is not Weber or not getattr(observer.cue, "is_scale", False):
        return _touches(conditional(observer, name, z), y)
    scale = float(from_normal(observer.prior[name])(np.array(z)))
    middle = float(from_normal(observer.prior[name])(np.array(0.0)))
    one, log_evidence = _touches(conditional(observer, name, 0.0), y * (middle / scale))
    return one, log_evidence - y.size * np.log(scale / middle)


class _Between:
    """The posteriors at nodes z (n,), and between them: what is smooth, by quintics.

    Attributes
    ----------
    z, share, mean, sd : array
        Closer nodes, their shares of the mass, conditional means and sds of the distance.
    moments : tuple
        Mean and sd of all.
    error : float
        By how much the sums over the nodes themselves are off, in sds.
    """

    def __init__(self, z: Array, known: list[tuple[Touches, float]], finer: int = 32) -> None:
        log = np.array([log for _, log in known])
        log = np.maximum(log - log.max(), -40.0)
        held = np.array([one.sd > 0 for one, _ in known])
        p = ndtr(SCORES)
        columns = [(one.mean, np.log(one.sd), *one._quantiles(p)) for one, _ in known if one.sd > 0]
        rows = np.arange(len(z))
        near = np.abs(rows[:, None] - rows[held]).argmin(axis=1)
        table = np.column_stack([log, np.array(columns)[near]])
        self.z = np.linspace(z[0], z[-1], finer * (len(z) - 1) + 1)
        fine = make_interp_spline(z, table, k=min(5, len(z) - 1 - len(z) % 2))(self.z)
        self.share, self.mean, self.sd, self._quantile = (
            np.exp(fine[:, 0] - fine[:, 0].max()), fine[:, 1], np.exp(fine[:, 2]), fine[:, 3:],
        )  # fmt: skip
        self.share /= self.share.sum()
        own = np.exp(log)
        alone = own.sum() < 1.5  # nothing to compare
        mean, sd = _moments(own / own.sum(), table[:, 1], np.exp(table[:, 2]))
        self.moments = _moments(self.share, self.mean, self.sd)
        off = abs(mean - self.moments[0]) + abs(sd - self.moments[1])
        self.error = np.inf if alone else float(off / self.moments[1])

    def density(self, count: int = 2001) -> tuple[Array, Array]:
        """Distances, and the density there: of the mixture of scores between quantiles."""
        heavy = self.share > 1e-9 * self.share.max()
        quantile = np.maximum.accumulate(self._quantile[heavy], axis=1)
        r = np.linspace(quantile.min(), quantile.max(), count)
        below = [ndtr(np.interp(r, one, SCORES, -9.0, 9.0)) for one in quantile]
        return r, np.gradient(self.share[heavy] @ np.array(below), r)


def _moments(share: Array, mean: Array, sd: Array) -> tuple[float, float]:
    """Mean and sd of a mixture of shares."""
    middle = share @ mean
    return float(middle), float(np.sqrt(share @ (sd**2 + (mean - middle) ** 2)))


def shared_unknowns(observer: Observer) -> list[str]:
    """The unknowns that are the whisker's, the same in all touches."""
    return [n for n in observer.unknowns[observer.bounded :] if n != "friction_angle"]
