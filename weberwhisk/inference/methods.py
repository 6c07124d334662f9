"""Posteriors of a contact: quadrature, emcee and Laplace, from one `Observer`."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple
from warnings import warn

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import domain
from .._checks import kind, one_of, positive_number
from .._values import Array, Flags, Index, member
from ..receptors import ReceptorNoise, Seed
from .coordinates import family, from_normal
from .grid import integrate
from .laplace import laplace
from .observer import Observer
from .quadrature import quadrature
from .result import Estimate, Posterior, Solution, Status, beyond_reach, is_outside

__all__ = ["Estimate", "Posterior", "Status", "posterior"]


@cache
def _keep_memory() -> None:
    """Let freed arrays be used again instead of handing them back to the kernel.

    The C library returns each freed block that is larger than any it has seen freed before; the
    kernel clears it afresh for the next array, at more than the cost of the arithmetic (a factor
    of 2 to 4 in quadrature in one dimension). One block of 16 MB, never touched, raises that bar.
    """
    np.empty(1 << 21)


def posterior(
    observer: Observer,
    reading: ArrayLike,
    method: str = "quadrature",
    *,
    seed: Seed = None,
    tolerance: float | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Posterior:
    """The posterior of a contact given readings of its signals.

    Parameters
    ----------
    observer : Observer
    reading : array, shape (S,) or (B, S)
        One reading or many: the cue's signals in SI units (with one signal also () or (B,)).
    method : {"quadrature", "emcee", "laplace"}
        Quadrature is the reference: exact to about 1e-10 in one dimension, to `tolerance` in two.
        emcee samples many posteriors stacked in one run, and owes nothing to quadrature, which it
        can so check. Laplace is the Gaussian at the mode, and says where that will not do. An
        unknown that shares no signal with the others (`SpaceMap`'s azimuth) is integrated by
        itself, whatever the method.
    seed : int, SeedSequence or Generator
        Of emcee's walkers; NumPy's global state is neither read nor changed.
    tolerance : float, optional
        Error of mean and sd asked for, over the sd. Default 1e-6 (quadrature in one dimension),
        1e-2 (in two; 1e-4 at some five times the cost), 2 % and 3 % (emcee).
    progress : callable, optional
        Called with (posteriors done, posteriors in all).

    Returns
    -------
    Posterior
        With a `Status` for every reading; `NOT_A_READING`, and NaN, where a number is missing, and
        `NO_CONTACT` where all are zero that have no noise without a signal.

    Raises
    ------
    ValueError
        For a reading of the wrong shape or of text, an unknown method, a tolerance that is
        not positive.

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
    kind("observer", observer, "an Observer", "checked_reading", "write Observer(whisker, cue)")
    y = observer.checked_reading(reading, missing=True)
    single = y.ndim == 1
    rows = y.reshape(-1, y.shape[-1])
    solve = _solver(method)
    _keep_memory()

    given = np.isfinite(rows).all(axis=1)
    nothing = _of_no_contact(observer, rows)
    known = np.asarray(given & ~nothing)
    if not known.any():
        solution = _of_nothing(len(observer.unknowns))
    else:
        inner, told, apart = observer, rows[known], []
        while (factors := factors_of(inner)) is not None:
            size = factors.first.noise.reading_size(len(factors.first.cue.signal_names))
            apart.append((inner, factors, told[:, size:]))
            inner, told = factors.first, told[:, :size]
        solution = solve(inner, told, seed, tolerance, progress)
        for whole, factors, own in reversed(apart):
            solution = with_factor(solution, whole, factors, own)
    _hint_at_units(observer, rows[known], solution)
    if not known.all():
        solution = solution.among(known)
        solution.status[given & nothing] = Status.NO_CONTACT
    solution.status[_outside(observer, rows, solution)] = Status.OUTSIDE_DOMAIN

    def shaped(values: NDArray[Any]) -> Any:
        return values[0] if single else values

    return Posterior(
        observer,
        y,
        method + _who(solution),
        {
            name: Estimate(*map(shaped, estimate))
            for name, estimate in zip(observer.unknowns, solution.estimates, strict=True)
        },
        member(Status, shaped(solution.status)),
        shaped(solution.log_evidence),
        solution.quantile_of,
        solution.draws_of,
        solution.quantile_error_of,
    )


def _solver(method: str) -> Any:
    """The function of a method; emcee is imported when first asked for, as it is heavy."""
    if method == "quadrature":
        return quadrature
    if method == "emcee":
        from .emcee import sample

        return sample
    return laplace


def _who(solution: Solution) -> str:
    """What is to be added to the method's name: whether readings were summed by themselves."""
    own = solution.own_grid
    if own is None or not own.any():
        return ""
    return ", own grid" if own.all() else f", {own.sum()} of {len(own)} on own grids"


def _of_no_contact(observer: Observer, reading: Array) -> Flags:
    """Readings (B, R) that are zero wherever noise only grows with the signal: no contact's.

    Such noise has no zeros but of a signal that is zero, and not all are but without deflection.
    """
    noise, size = observer.noise, len(observer.cue.signal_names)
    if not noise.reads_signals or noise.is_categorical or reading.shape[1] != size:
        return np.zeros(len(reading), dtype=bool)
    graded = noise.floors(size) == 0
    return np.asarray(graded.any() & (reading[:, graded] == 0).all(axis=1))


def _outside(observer: Observer, reading: Array, solution: Solution) -> Flags:
    """Posteriors (B,) that converged, of an observer or at a distance outside the domain."""
    r = solution.estimates[0]
    outside = (r.mean / observer.reach[1] < domain.CONTACTS[0]) | beyond_reach(
        observer, reading, dict(zip(observer.unknowns, solution.estimates, strict=True))
    )
    outside |= bool(domain.of_observer(observer))
    return np.asarray(outside & (solution.status == Status.CONVERGED))


def _hint_at_units(observer: Observer, reading: Array, solution: Solution) -> None:
    """Warn of readings (B, R) so far above what the whisker gives that the unit may be another.

    More than half of them are above 30 times what is usual, and explained by no contact, or by one
    within a hundredth of the reach of the base.
    """
    if observer.noise.is_categorical:  # reports have no unit
        return
    times = np.abs(reading) / np.where(observer.usual_reading > 0, observer.usual_reading, np.inf)
    low, high = observer.reach
    at_base = solution.estimates[0].mean < low + 0.01 * (high - low)
    odd = (times > 30).any(axis=1) & (at_base | (solution.status == Status.IMPROBABLE_READING))
    if odd.sum() * 2 > len(odd):
        first = int(np.argmax(odd))
        warn(
            f"{odd.sum()} of {len(reading)} readings are far above what this whisker gives, the "
            f"first {reading[first].tolist()}, {times[first].max():.3g} times the usual; readings "
            "are in SI units (N m, N, rad): did you pass mN?",
            stacklevel=3,
        )


def _of_nothing(unknowns: int) -> Solution:
    """The solution for no reading at all."""
    none = np.empty(0)
    return Solution(
        [Estimate(none, none, none, none)] * unknowns,
        np.empty(0, dtype=np.int8),
        none,
        lambda p, unknown: np.empty((0, len(p))),
        lambda count, seed: np.empty((0, 4, count, unknowns)),
    )


# -- an unknown that stands by itself --------------------------------------------------------------


class Factors(NamedTuple):
    """An observer of all unknowns but one, where that is, and the noise of the signals left to it.

    An unknown that shares no signal with the others stands by itself: the azimuth of a contact in
    space is told by the directions of moment and force, which tell of nothing else. The posterior
    is a product, and two unknowns and one cost less than three. The roll of a straight whisker is
    told by no signal at all, and is as its prior has it.
    """

    first: Observer
    place: int
    noise: ReceptorNoise | None
    signals: int


def factors_of(observer: Observer) -> Factors | None:
    """The factors of the posterior, if it is a product."""
    cue = getattr(observer.cue, "all_but_one", None)
    if cue is None or not observer.forward.is_flat:
        return None
    own, size = len(cue.signal_names), len(observer.cue.signal_names)
    noise = observer.noise.part(size, 0, own)
    rest = observer.noise.part(size, own, size) if own < size else None
    if noise is None or (rest is None and own < size):
        return None  # the noise of some signals of either kind is one
    prior = {name: observer.prior[name] for name in cue.unknowns if name in observer.prior}
    first = Observer(observer.whisker, cue, noise, prior, model=observer.model)
    place = next(i for i, name in enumerate(observer.unknowns) if name not in cue.unknowns)
    return Factors(first, place, rest, size - own)


def with_factor(first: Solution, observer: Observer, factors: Factors, own: Array) -> Solution:
    """The posteriors of all unknowns, from those of all but one; `own` (B, R) tells of that.

    Of two faults the first factor's is said. An azimuth that may be any has no ends: that of a
    reading beyond a quarter turn is summed about half a turn on, and may so come out beyond π.
    """
    place, half = factors.place, np.zeros(len(own))
    name = observer.unknowns[place]
    value_at = from_normal(observer.prior[name])
    usual = observer.cue.priors(observer.whisker)[name]
    if name == "azimuth" and family(observer.prior[name]) == family(usual):
        half = np.pi * np.round(own[:, 0] / np.pi)
        own = own - half[:, None]

    def density(x: Array, index: Index) -> Array:
        value = value_at(x[..., 0])
        log = np.zeros(value.shape)
        if factors.noise is not None:
            signals = np.repeat(value[..., None], factors.signals, axis=-1)
            log = factors.noise.log_likelihood(own[index, None], signals)
        return np.asarray(log - 0.5 * (x[..., 0] ** 2 + np.log(2 * np.pi)))

    ends = np.full((len(own), 1), 8.0)
    found = integrate(density, -ends, ends, functions=value_at)
    value = value_at(found.points)[..., 0]
    rise = np.cumsum(found.weights, axis=1) - found.weights / 2
    best = np.take_along_axis(value, found.weights.argmax(axis=1)[:, None], axis=1)
    status = np.where(found.error[:, 0] < 1e-2, Status.CONVERGED, Status.IMPRECISE)
    signals = np.repeat(best, factors.signals, axis=-1)
    if factors.noise is not None:
        status[is_outside(factors.noise, own, signals)] = Status.IMPROBABLE_READING
    value = value + half[:, None]
    mean, sd, error = found.mean[:, 0] + half, found.sd[:, 0], found.error[:, 0]

    def at(probability: Array) -> Array:
        """Values (B, Q) at probabilities (B, Q)."""
        pairs = zip(probability, rise, value, strict=True)
        return np.stack([np.interp(p, up, v) for p, up, v in pairs])

    def quantile_of(p: Array, unknown: int) -> Array:
        if unknown != place:
            return first.quantile_of(p, unknown - (unknown > place))
        return at(np.broadcast_to(p, (len(own), len(p))))

    def quantile_error_of(p: Array, unknown: int) -> Array:
        if unknown != place:
            known, other = first.quantile_error_of, unknown - (unknown > place)
            return np.full((len(own), len(p)), np.nan) if known is None else known(p, other)
        # Straight lines between nodes of a tenth of the sd miss less than a hundredth of it.
        return np.asarray(sd[:, None] * (0.01 + error[:, None] / (4 * p * (1 - p))))

    def draws_of(count: int, seed: Seed) -> Array:
        rng = np.random.default_rng(seed)
        draws = first.draws_of(count, rng)
        chains, kept = draws.shape[1:3]
        strata = np.arange(chains * kept) + rng.random((len(own), chains * kept))
        lone = at(rng.permuted(strata / (chains * kept), axis=1))
        return np.insert(draws, place, lone.reshape(len(own), chains, kept), axis=-1)

    estimates = list(first.estimates)
    estimates.insert(place, Estimate(mean, sd, error * sd, error * sd))
    return Solution(
        estimates,
        np.where(first.status == Status.CONVERGED, status, first.status).astype(np.int8),
        first.log_evidence + found.log_evidence,
        quantile_of,
        draws_of,
        quantile_error_of,
        first.own_grid,
    )
