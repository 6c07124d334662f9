"""Posteriors of a contact by quadrature, the reference, by emcee, or by Laplace's Gaussian."""

from __future__ import annotations

from collections.abc import Callable
from warnings import warn

import numpy as np
from numpy.typing import ArrayLike

from .. import domain
from .._util.checks import kind, one_of, positive_number, whole
from .._util.refusals import Refusal, argument
from .._util.values import Array, Flags
from ..receptors import Seed
from .approximate import laplace, sample
from .coordinates import is_all_around
from .observer import Observer
from .quadrature import quadrature
from .result import AtReadings, Estimate, Posterior, Solution, Status, beyond_reach
from .spread import spread_quadrature

__all__ = ["Estimate", "Posterior", "Status", "posterior"]


def posterior(
    observer: Observer,
    reading: ArrayLike,
    method: str = "quadrature",
    *,
    seed: Seed = 1,
    tolerance: float | None = None,
    progress: Callable[[int, int], None] | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
) -> Posterior:
    """The posterior of a contact given readings of its signals.

    Parameters
    ----------
    observer : Observer
    reading : array, shape (S,) or (B, S)
        One reading or many: the cue's signals in SI units (with one signal also () or (B,)).
    method : {"quadrature", "emcee", "laplace"}
        Quadrature is the reference, exact to `tolerance`.
        emcee samples many posteriors in one run; it is independent of quadrature, and so checks it.
        Laplace is the Gaussian at the mode, and flags readings where that is inaccurate. Neither
        follows an azimuth around the end of its range; both flag that.
    seed : int, SeedSequence or Generator
        Of emcee's walkers; NumPy's global state is neither read nor changed.
    tolerance : float, optional
        Largest error of mean and sd, over the sd. Default 2e-3 (quadrature; 1e-4 at about twice
        the cost), 2 % and 3 % (emcee, one and more unknowns).
    progress : callable, optional
        Called with (posteriors done, posteriors in all).
    workers, scheduler : optional
        How many processes, or the address of a dask cluster, as for `weberwhisk.campaign.run`: for
        tables that one core takes minutes for, by quadrature. Chunks are of 2048 readings, or of
        32 where an unknown has a prior alone. Numbers are the same to the bit as without, on
        machines of one kind. A process takes some seconds to start. Intervals and draws sum cells
        again in this process, in about the time that one core takes for the posteriors.

    Returns
    -------
    Posterior
        With a `Status` for every reading; `NOT_A_READING`, and NaN, where a number is missing, and
        `NO_CONTACT` where all are zero that have no noise without a signal.

    Raises
    ------
    ValueError
        For a reading of the wrong shape or of text, an unknown method, a tolerance that is
        not positive, workers of another method than quadrature, or a cluster that cannot be
        reached.
    CampaignError
        When workers are lost.

    Examples
    --------
    >>> from weberwhisk import Observer, Whisker, cues
    >>> observer = Observer(Whisker(50e-3, 100e-6, 5e-6), cues.Compliance())
    >>> reading = observer.read(30e-3, seed=1)
    >>> p = posterior(observer, reading)
    >>> print(f"{p.mean * 1e3:.2f} ± {p.sd * 1e3:.2f} mm, {p.status.message}")
    29.47 ± 1.31 mm, converged
    """
    one_of("method", method, ("quadrature", "emcee", "laplace"))
    if tolerance is not None:
        tolerance = positive_number("tolerance", tolerance, "write 1e-3, say")
    in_parallel = workers is not None or scheduler is not None
    if workers is not None:
        whole("workers", workers, "write 2")
    if in_parallel and method != "quadrature":  # the other two draw by one seed for all readings
        raise Refusal(
            "Only quadrature is spread over workers",
            argument("method", method),
            "leave workers and scheduler out, or write " + argument("method", "quadrature"),
        )
    kind("observer", observer, "an Observer", "checked_reading", "write ww.Observer(whisker, cue)")
    y = observer.checked_reading(reading, missing=True)
    readings = y.reshape(-1, y.shape[-1])
    given = np.isfinite(readings).all(axis=1)
    nothing = given & _of_no_contact(observer, readings)
    usable = given & ~nothing
    requested, row = readings[usable], np.full(len(readings), -1)
    row[usable] = np.arange(len(requested))
    if observer.noise.is_categorical:  # few things can happen: each is solved once
        requested, back = np.unique(requested, axis=0, return_inverse=True)
        row[usable] = back.reshape(-1)
    solved: Solution
    if in_parallel and usable.any():
        solved = spread_quadrature(observer, requested, tolerance, progress, workers, scheduler)
    else:
        methods: dict[str, Callable[..., Solution]]
        methods = {"quadrature": quadrature, "emcee": sample, "laplace": laplace}
        solve = methods[method] if usable.any() else quadrature
        solved = solve(observer, requested, seed, tolerance, progress)
    solution = AtReadings.of(solved, row)
    if method != "quadrature":  # which knows no ends there
        cut = _cut_off(observer, solution) & (solution.status == Status.CONVERGED)
        solution.status[cut] = Status.NOT_CONVERGED if method == "emcee" else Status.NOT_GAUSSIAN
    solution.status[nothing] = Status.NO_CONTACT
    _hint_at_units(observer, readings, solution, int(usable.sum()))
    solution.status[_outside(observer, readings, solution)] = Status.OUTSIDE_DOMAIN
    return Posterior.of(observer, y, method, solution)


def _cut_off(observer: Observer, solution: AtReadings) -> Flags:
    """Posteriors (B,) of an azimuth that may be any, whose mass reaches the end of its range."""
    names = observer.unknowns
    if "azimuth" not in names or not is_all_around(observer.prior["azimuth"]):
        return np.zeros(len(solution.status), dtype=bool)
    azimuth = solution.estimates[names.index("azimuth")]
    off = np.abs(azimuth.mean - observer.prior["azimuth"].median())
    return np.asarray(off + 5 * azimuth.sd > np.pi)


def _of_no_contact(observer: Observer, reading: Array) -> Flags:
    """Readings (B, R) that are zero wherever noise grows with the signal alone: no contact's."""
    noise, size = observer.noise, len(observer.cue.signal_names)
    if not noise.reads_signals or noise.is_categorical or reading.shape[1] != size:
        return np.zeros(len(reading), dtype=bool)
    graded = noise.floors(size) == 0
    return np.asarray(graded.any() & (reading[:, graded] == 0).all(axis=1))


def _outside(observer: Observer, reading: Array, solution: AtReadings) -> Flags:
    """Posteriors (B,) that converged, of an observer or at a distance outside the domain."""
    r = solution.estimates[0]
    outside = (r.mean / observer.reach[1] < domain.CONTACTS[0]) | beyond_reach(
        observer, reading, dict(zip(observer.unknowns, solution.estimates, strict=True))
    )
    outside |= bool(domain.of_observer(observer))
    return np.asarray(outside & (solution.status == Status.CONVERGED))


def _hint_at_units(observer: Observer, reading: Array, solution: AtReadings, usable: int) -> None:
    """Warn where the unit of readings (B, R), so many of them usable, seems to be wrong.

    More than half of them are above 30 times what is usual, and explained by no contact, or by one
    within a hundredth of the reach of the base.
    """
    if observer.noise.is_categorical:  # reports have no unit
        return
    times = np.abs(reading) / np.where(observer.usual_reading > 0, observer.usual_reading, np.inf)
    low, high = observer.reach
    at_base = solution.estimates[0].mean < low + 0.01 * (high - low)
    outlier = (times > 30).any(axis=1) & (at_base | (solution.status == Status.IMPROBABLE_READING))
    if outlier.sum() * 2 > usable:
        first = int(np.argmax(outlier))
        warn(
            f"{outlier.sum()} of {usable} readings far above what this whisker gives, the "
            f"first {reading[first].tolist()}, {times[first].max():.3g} times the usual; readings "
            "are in SI units (N m, N, rad): did you pass mN?",
            stacklevel=3,
        )
