"""Several touches of one object: one radial distance, each touch its own deflection (§4)."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import product

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtr

from .._util import checks
from .._util.checks import kind
from .._util.refusals import Refusal
from .._util.values import Array, Index, Line, density_quantiles, interval_text
from .observer import Observer
from .one_distance import OneDistance, ReadingGroup, one_distance, shared_unknowns
from .result import Status, is_improbable, is_unidentified
from .tree import TOLERANCE

__all__ = ["Touches", "shared_unknowns", "touches"]

#: Unknowns of the whisker that touches may share.
SHARED = "stiffness", "curvature_offset", "hinge_stiffness"


@dataclass(frozen=True, eq=False, repr=False)
class Touches(Line):
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
        found, or 8 from its own best, or where there is no distance that all may have;
        `UNIDENTIFIED` where none of them determines its contact; `IMPRECISE` where the estimated
        error of mean and sd is above 2e-3 sd.
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

    def _line(self) -> str:
        low, high = self.interval()
        r = interval_text(1e3 * self.mean, 1e3 * low, 1e3 * high, " mm")
        said = f"r = {r}, of {self.count}", self.status.message, self.observer.note
        return "; ".join(filter(None, said))

    def interval(self, mass: float = 0.95) -> tuple[float, float]:
        """The equal-tailed interval that holds the distance with probability `mass`, m.

        Raises
        ------
        ValueError
            For a mass outside 0 to 1.
        """
        tail = (1 - checks.mass(mass)) / 2
        low, high = density_quantiles(self.r, self.density, [tail, 1 - tail])
        return float(low), float(high)


def touches(observer: Observer, readings: ArrayLike) -> Touches:
    """The posterior of the radial distance from several touches of it.

    Parameters
    ----------
    observer : Observer
        Of each touch; its priors of the deflection angle and of an unknown friction are each
        touch's own. An unknown stiffness, curvature or hinge is the whisker's, one for all touches.
    readings : array, shape (n, S)
        One reading a touch, in SI units.

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

    The sd of n equal touches is that of one over √n as far as one touch's posterior is Gaussian. It
    is less where posteriors are skewed: of ten at k = 0.03, by 2 % for 25 mm and 0.2 rad of a
    straight whisker of 50 mm, by 4 % at a curvature of 8 /m, and by 46 % next to flick-past near
    the base, where one touch's posterior ends.

    What all touches share does not average out: of one deflection a stiffness moves all alike, and
    only touches that differ discriminate it from the distance.

    Examples
    --------
    >>> from weberwhisk import Whisker, cues
    >>> observer = Observer(Whisker(50e-3, 100e-6, 5e-6), cues.ForceMap())
    >>> readings = observer.read([[30e-3, 0.1], [30e-3, 0.2], [30e-3, 0.3]], seed=1)
    >>> one, three = touches(observer, readings[:1]), touches(observer, readings)
    >>> print(f"{1e3 * one.sd:.1f} mm from one touch, {1e3 * three.sd:.1f} mm from three")
    3.3 mm from one touch, 1.5 mm from three

    An unknown stiffness is estimated with it:

    >>> soft = Observer(Whisker(50e-3, 100e-6, 5e-6), cues.UnknownStiffness(cues.ForceMap()))
    >>> found = touches(soft, readings)
    >>> mean, sd = found.shared["stiffness"]
    >>> print(f"{1e3 * found.sd:.1f} mm, stiffness {mean:.2f} ± {sd:.2f}")
    4.4 mm, stiffness 1.15 ± 0.40
    """
    kind("observer", observer, "an Observer", "checked_reading", "write ww.Observer(whisker, cue)")
    y = observer.checked_reading(readings)
    y = y.reshape(-1, y.shape[-1])
    if not len(y):
        raise Refusal("touches needs a reading or more", "none", "give one row a touch")
    shared = shared_unknowns(observer)
    if len(shared) > 1 or not set(shared) <= set(SHARED):
        raise Refusal(
            "Touches are of distance and deflection, of friction, and of one of stiffness, "
            "curvature and hinge",
            f"{', '.join(observer.unknowns)} unknown",
            "take a cue that knows the rest",
        )
    if "friction_angle" in observer.unknowns and observer.bounded < 2:
        raise Refusal(
            "Touches have an unknown friction where their deflection is unknown too",
            f"{', '.join(observer.unknowns)} unknown",
            "give the friction's angle",
        )
    owner: Index = np.zeros(len(y), dtype=np.intp)
    [solution] = one_distance([ReadingGroup(observer, y, None, owner)], 1)
    named = {}
    if solution.shared:
        mean, sd, _ = solution.shared
        named[shared[0]] = mean, sd
    status = _status(observer, y, solution)
    return Touches(
        observer, len(y), solution.mean, solution.sd, status, solution.r, solution.density, named
    )


def _status(observer: Observer, y: Array, solution: OneDistance) -> Status:
    """How far the posterior of touches can be relied on."""
    # A distance that all touches allow is for none of them worse by 8 sd than its own best.
    if not np.isfinite(solution.mean) or (len(y) > 1 and solution.worse > 32.0):
        return Status.IMPROBABLE_READING
    each = np.unique(y, axis=0)
    contact = _best_contacts(observer, each, solution)
    if is_improbable(observer, each, contact).any():
        return Status.IMPROBABLE_READING
    # A posterior far narrower than the reach is informed by the readings.
    wide = solution.sd * len(y) ** 0.5 > 0.1 * (observer.reach[1] - observer.reach[0])
    if wide and is_unidentified(observer, contact).all():
        return Status.UNIDENTIFIED
    return Status.CONVERGED if solution.error <= TOLERANCE else Status.IMPRECISE


def _best_contacts(observer: Observer, y: Array, solution: OneDistance) -> Array:
    """The most probable contact (n, U) of each touch at the most probable distance."""
    further = [
        np.full(1, solution.shared[2])
        if name in SHARED
        else observer.prior[name].ppf(ndtr(np.linspace(-3.0, 3.0, 13)))
        for name in observer.unknowns[observer.bounded :]
    ]
    low, high = (end[1] if observer.bounded > 1 else 0.0 for end in observer.ends(observer.bounded))
    first = float(observer.space.unconstrain_one(np.array(solution.best), 0))
    count, best = len(y), np.full(len(y), -np.inf)
    out = np.empty((count, len(observer.unknowns)))
    for values in product(*further):
        middle, half = np.full(count, (low + high) / 2), (high - low) / 2
        for size in (401, 81) if observer.bounded > 1 else (1,):
            second = middle[:, None] + half * np.linspace(-1, 1, size)
            x = np.stack([np.full(second.shape, first), second], axis=-1)[..., : observer.bounded]
            with np.errstate(all="ignore"):
                contact, log = observer.space.constrain(x, further=values)
                log = log + observer.log_likelihood(y[:, None], contact)
            at = np.nan_to_num(log, nan=-np.inf).argmax(axis=1)
            row = np.arange(count)
            middle, half = second[row, at], 2 * half / max(size - 1, 1)
        more = log[row, at] > best
        best[more], out[more] = log[row, at][more], contact[row, at][more]
    return out
