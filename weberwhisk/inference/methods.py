"""Posteriors of a contact by quadrature, the reference, by emcee, or by Laplace's Gaussian."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from itertools import pairwise, product
from typing import Any
from warnings import warn

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import domain
from .._util.checks import kind, one_of, positive_number
from .._util.refusals import Refusal, argument
from .._util.values import Array, Flags, Index, member
from ..receptors import Seed
from . import tree
from .approximate import find_mode, laplace, sample
from .coordinates import is_all_around
from .layers import LayeredSums
from .nodes import Layers
from .observer import Observer
from .result import (
    Estimate,
    Posterior,
    Solution,
    Status,
    beyond_reach,
    is_improbable,
    is_unidentified,
    refuse_impossible,
)
from .tree import DROP, TOLERANCE, tree_of
from .weighted import Spans, Sums, extrapolated

__all__ = ["Estimate", "Posterior", "Status", "pieces_of", "posterior", "sums_of"]

#: Most readings that are solved together, for progress; the first time of unknowns that have priors
#: alone, whose readings have up to 3 MB of cells each.
TOGETHER, FEW = 2048, 32


def posterior(
    observer: Observer,
    reading: ArrayLike,
    method: str = "quadrature",
    *,
    seed: Seed = 1,
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
    kind("observer", observer, "an Observer", "checked_reading", "write ww.Observer(whisker, cue)")
    y = observer.checked_reading(reading, missing=True)
    single = y.ndim == 1
    rows = y.reshape(-1, y.shape[-1])
    given = np.isfinite(rows).all(axis=1)
    nothing = given & _of_no_contact(observer, rows)
    known = given & ~nothing
    asked, row = rows[known], np.full(len(rows), -1)
    row[known] = np.arange(len(asked))
    if observer.noise.is_categorical:  # few things can happen: each is solved once
        asked, back = np.unique(asked, axis=0, return_inverse=True)
        row[known] = back.reshape(-1)
    methods = {"quadrature": quadrature, "emcee": sample, "laplace": laplace}
    solve = methods[method] if known.any() else quadrature
    solution = solve(observer, asked, seed, tolerance, progress).of(row)
    if method != "quadrature":  # which knows no ends there
        cut = _cut_off(observer, solution) & (solution.status == Status.CONVERGED)
        solution.status[cut] = Status.NOT_CONVERGED if method == "emcee" else Status.NOT_GAUSSIAN
    solution.status[nothing] = Status.NO_CONTACT
    _hint_at_units(observer, rows, solution, int(known.sum()))
    solution.status[_outside(observer, rows, solution)] = Status.OUTSIDE_DOMAIN

    def shaped(values: NDArray[Any]) -> Any:
        return values[0] if single else values

    return Posterior(
        observer,
        y,
        method,
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


def _cut_off(observer: Observer, solution: Solution) -> Flags:
    """Posteriors (B,) of an azimuth that may be any, whose mass reaches the end of its range."""
    names = observer.unknowns
    if "azimuth" not in names or not is_all_around(observer.prior["azimuth"]):
        return np.zeros(len(solution.status), dtype=bool)
    found = solution.estimates[names.index("azimuth")]
    off = np.abs(found.mean - observer.prior["azimuth"].median())
    return np.asarray(off + 5 * found.sd > np.pi)


def _of_no_contact(observer: Observer, reading: Array) -> Flags:
    """Readings (B, R) that are zero wherever noise grows with the signal alone: no contact's."""
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


def _hint_at_units(observer: Observer, reading: Array, solution: Solution, known: int) -> None:
    """Warn of readings (B, R), of which so many are known, whose unit may be another.

    More than half of them are above 30 times what is usual, and explained by no contact, or by one
    within a hundredth of the reach of the base.
    """
    if observer.noise.is_categorical:  # reports have no unit
        return
    times = np.abs(reading) / np.where(observer.usual_reading > 0, observer.usual_reading, np.inf)
    low, high = observer.reach
    at_base = solution.estimates[0].mean < low + 0.01 * (high - low)
    odd = (times > 30).any(axis=1) & (at_base | (solution.status == Status.IMPROBABLE_READING))
    if odd.sum() * 2 > known:
        first = int(np.argmax(odd))
        warn(
            f"{odd.sum()} of {known} readings far above what this whisker gives, the "
            f"first {reading[first].tolist()}, {times[first].max():.3g} times the usual; readings "
            "are in SI units (N m, N, rad): did you pass mN?",
            stacklevel=3,
        )


# -- by quadrature ---------------------------------------------------------------------------------


def sums_of(
    observer: Observer,
    readings: Array,
    covariance: Array | None = None,
    *,
    tolerance: float = TOLERANCE,
    drop: float = DROP,
) -> Sums | LayeredSums | PiecewiseSums:
    """The posteriors of readings (B, R) as weighted cells.

    With the covariances (B, R, R) of measurement errors, which add to the receptors' noise; cells
    whose density is `drop` nats below the highest are left out.
    """
    pieces = pieces_of(observer)
    if len(pieces) > 1:
        parts = [sums_of(p, readings, covariance, tolerance=tolerance, drop=drop) for p in pieces]
        return PiecewiseSums(observer, parts)
    if len(observer.unknowns) > observer.inner:
        layers = Layers(observer, tolerance, observer.inner)
        return LayeredSums(layers, readings, covariance, drop)
    return tree_of(observer, tolerance).sums(readings, covariance, drop=drop)


def quadrature(
    observer: Observer, reading: Array, seed: Seed, tolerance: float | None, progress: Any
) -> Solution:
    """Posteriors of readings (B, R) by quadrature."""
    if len(observer.unknowns) > 4:
        raise Refusal(
            "Quadrature sums over four unknowns at most",
            f"{len(observer.unknowns)} ({', '.join(observer.unknowns)})",
            "write " + argument("method", "emcee"),
        )
    wanted = tolerance or TOLERANCE
    sums = ManySums(observer, reading, wanted, progress)
    mean, sd, error, evidence, best = sums.columns
    refuse_impossible(reading, np.nan_to_num(evidence, nan=-np.inf))
    status = np.where(error <= wanted, Status.CONVERGED, Status.IMPRECISE)
    if len(observer.unknowns) > 1:
        # By the best cell, and where that says so by the mode itself. An error of a third of an sd
        # is worse news than a ridge.
        some = np.flatnonzero(is_unidentified(observer, best) & (error < 0.3))
        if some.size:
            mode, _ = find_mode(observer, reading[some], observer.space.unconstrain(best[some]))
            some = some[is_unidentified(observer, observer.space.constrain(mode)[0])]
        status[some] = Status.UNIDENTIFIED
    outside = is_improbable(observer, reading, best)
    vague = np.flatnonzero(outside & (status == Status.IMPRECISE))
    if vague.size:  # whose best cell may be the wrong one
        mode, _ = find_mode(observer, reading[vague])
        outside[vague] = is_improbable(observer, reading[vague], observer.space.constrain(mode)[0])
    status[outside] = Status.IMPROBABLE_READING

    def quantile_of(p: Array, unknown: int) -> Array:
        return np.concatenate([extrapolated(part, p, unknown) for _, part in sums.parts()])

    def quantile_error_of(p: Array, unknown: int) -> Array:
        # A share of the mass that moves the mean by its error may lie on the wrong side; and what
        # is interpolated between cells and nodes: a third of the most beside the kept truth.
        rough = 2e-3 if len(observer.unknowns) == observer.inner else 6e-3
        off = rough + error[:, None] / (4 * p * (1 - p))
        return np.asarray(sd[:, unknown, None] * off)

    def draws_of(count: int, seed: Seed) -> Array:
        rng = np.random.default_rng(seed)
        out = np.concatenate([part.draws(4 * count, rng, rows) for rows, part in sums.parts()])
        return out.reshape(len(reading), 4, count, -1)

    estimates = [Estimate(m, s, error * s, error * s) for m, s in zip(mean.T, sd.T, strict=True)]
    return Solution(
        estimates, status.astype(np.int8), evidence, quantile_of, draws_of, quantile_error_of
    )


class ManySums:
    """Posteriors of many readings (B, R), some at a time.

    Their cells are kept while they fit in half of `tree.MEMORY`; those of later readings are summed
    again where quantiles or draws are asked for. Columns are the mean (B, U), sd (B, U), error,
    ln of the evidence (B,) and best contact (B, U).
    """

    def __init__(
        self, observer: Observer, readings: Array, tolerance: float, progress: Any
    ) -> None:
        self._solve = partial(sums_of, observer, tolerance=tolerance)
        self._parts: list[tuple[Array, Sums | LayeredSums | PiecewiseSums | None]] = []
        columns: list[list[Array]] = []
        done, room = 0, tree.MEMORY / 2
        size = FEW if len(observer.unknowns) > observer.inner else TOGETHER
        while done < len(readings) or not columns:
            some = readings[done : done + size]
            part = self._solve(some)
            columns.append([part.mean, part.sd, part.error, part.log_evidence, part.best])
            room -= part.bytes
            self._parts.append((some, part if room > 0 else None))
            done += len(some)
            # So many that their cells take a quarter of the memory.
            size = int(np.clip(tree.MEMORY / 4 / max(part.bytes / size, 1), FEW, TOGETHER))
            if progress:
                progress(done, len(readings))
        self.columns = [np.concatenate(column) for column in zip(*columns, strict=True)]

    def parts(self) -> Iterator[tuple[Array, Sums | LayeredSums | PiecewiseSums]]:
        """Readings (n, R) and their sums, some at a time."""
        for some, part in self._parts:
            yield some, part or self._solve(some)


# -- priors that leap ------------------------------------------------------------------------------


class _Within:
    """A distribution between two values, its density as it is."""

    def __init__(self, distribution: Any, low: float, high: float) -> None:
        self.distribution, self.ends = distribution, (low, high)
        for name in ("pdf", "logpdf", "cdf", "sf", "ppf", "isf", "median", "mean", "std"):
            if hasattr(distribution, name):
                setattr(self, name, getattr(distribution, name))

    def support(self) -> tuple[float, float]:
        return self.ends


def pieces_of(observer: Observer) -> list[Observer]:
    """Observers between the values at which priors of distance and angle leap; mostly itself.

    Between them densities are smooth, as the trapezoidal rule has them; the coordinates of each
    piece have no edges at its ends.
    """
    leaps = {name: at for name, at in observer.space.leaps.items() if len(at)}
    if not leaps:
        return [observer]
    choices = []
    for name, at in leaps.items():
        prior = observer.prior[name]
        low, high = observer.reach if name == "radial_distance" else prior.support()
        inside = at[(at > low) & (at < high)]
        edges = np.concatenate([[low], inside, [high]])
        some = [(a, b) for a, b in pairwise(edges) if prior.cdf(b) > prior.cdf(a)]
        choices.append([(name, _Within(prior, float(a), float(b))) for a, b in some])
    return [
        replace(observer, prior={**observer.prior, **dict(chosen)}, noise=observer.noise)
        for chosen in product(*choices)
    ]


class PiecewiseSums:
    """As `weighted.Sums`, under a prior that leaps: mixtures of those of its pieces."""

    def __init__(self, observer: Observer, parts: list[Any]) -> None:
        self.observer, self.parts = observer, parts
        log = np.stack([np.nan_to_num(p.log_evidence, nan=-np.inf) for p in parts])
        top = log.max(axis=0)
        with np.errstate(invalid="ignore"):
            weight = np.where(np.isfinite(top), np.exp(log - top), 0.0)
        total = weight.sum(axis=0)
        with np.errstate(divide="ignore", invalid="ignore"):
            self.log_evidence = np.where(total > 0, top + np.log(total), np.nan)
            self.share = weight / total
        mean = np.stack([np.nan_to_num(p.mean) for p in parts])
        sd = np.stack([np.nan_to_num(p.sd) for p in parts])
        share = self.share[..., None]
        self.mean = (share * mean).sum(axis=0)
        self.sd = np.sqrt((share * (sd**2 + (mean - self.mean) ** 2)).sum(axis=0))
        error = np.stack([np.where(np.isfinite(p.error), p.error, 0.0) for p in parts])
        self.error = np.where(total > 0, (self.share * error).sum(axis=0), np.inf)
        best = np.nan_to_num(self.share, nan=0.0).argmax(axis=0)
        self.best = np.stack([p.best for p in parts])[best, np.arange(len(best))]

    @property
    def bytes(self) -> int:
        """Memory of the cells."""
        return sum(part.bytes for part in self.parts)

    def spans(self, unknown: int, stride: int = 1) -> Iterator[Spans]:
        """Spans of an unknown, for one reading at a time."""
        every: dict[int, list[tuple[Array, Array, Array]]] = {}
        for part, share in zip(self.parts, self.share, strict=True):
            for spans in part.spans(unknown, stride):
                for row, low, high, mass in zip(*spans, strict=True):
                    own = low, high, share[row] * mass / mass.sum()
                    every.setdefault(int(row), []).append(own)
        for row, pieces in sorted(every.items()):
            yield Spans(
                np.array([row]), *(np.concatenate(c)[None] for c in zip(*pieces, strict=True))
            )

    def draws(self, count: int, rng: np.random.Generator, readings: Array) -> Array:
        """Draws (B, count, U) of the contact."""
        every = np.stack([part.draws(count, rng, readings) for part in self.parts])
        out = np.full(every.shape[1:], np.nan)
        for row in np.flatnonzero(np.isfinite(self.log_evidence)):
            which: Index = rng.choice(len(every), count, p=self.share[:, row])
            out[row] = every[which, row, np.arange(count)]
        return out
