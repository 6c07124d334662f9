"""Rows and touches located with unknown noise, shape at rest and stiffness.

The curvature at rest and the stiffness of the whisker are nuisance parameters with five values
each, and noise that was learnt has some too: every combination gives an evidence and a posterior,
whose quantiles are interpolated between the values, and the result is their mixture. A lattice of
contacts gives these posteriors for all rows together (`lattice.py`), and the cells of the observer
those for which it is not fine enough, or that need no mixture.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import PchipInterpolator, make_interp_spline
from scipy.special import logsumexp, ndtr

from .._util import campaign
from .._util.values import Array, Flags, Index, pd
from .._util.weights import mixture_moments
from ..cues import Cue, UnknownStiffness
from ..cues.protocol import is_curved
from ..inference import Observer
from ..inference import layers as inference_layers
from ..inference.one_distance import ReadingGroup, one_distance
from ..inference.quadrature import sums_of
from ..inference.tree import TOLERANCE
from ..inference.weighted import Cumulative
from ..mechanics import Profile, Spiral
from ..mechanics.shape import with_modulus
from ..receptors import ReceptorNoise
from ..whisker import usual_curvature
from .columns import seen_from_sides
from .lattice import ALONE, TOGETHER, Densities, Lattice, serves, step_of

__all__ = [
    "ERROR", "MISFIT", "SPANS", "Cases", "Done", "Mixed", "Readings", "Spread", "cases_of",
    "rows_of", "touches_of", "usual_bow", "whiskers_of",
]  # fmt: skip

#: Values of a nuisance parameter of the whisker, in sds of its prior, and points from one to the
#: next at which posteriors are interpolated.
SCORES, BETWEEN = np.linspace(-2.5, 2.5, 5), 4
#: Probabilities of the quantiles of each posterior in a mixture, and those of a single posterior.
QUANTILES, ENDS = ndtr(inference_layers.SCORES), np.array([0.025, 0.975])
#: Largest angle of a touch as a share of the fold: with a flat prior of angles up to the fold,
#: touches at small angles had errors of 1.4 sd.
SPANS = np.array([0.05, 0.1, 0.2, 0.35, 0.55, 0.8, 1.2])
#: Nats below the largest at which a part of a mixture has no weight, and at which its error has
#: none.
WEIGHTLESS, IMPRECISE = 18.0, 9.0
#: Rows whose quantiles are mixed together, and bins of the cumulative mixture.
MIXED_TOGETHER, BINS = 64, 4096
#: Rows that are located together, and seconds that a row takes by each combination, on a lattice
#: and by cells.
BLOCK, SECONDS = 512, (1e-4, 3e-3)
#: Layers with mass that a touch needs on a lattice, and points between layers.
LAYERS, PARTS = 6, 16


class Readings(NamedTuple):
    """Readings (n, S) of rows, the side of each push (n,), and covariances of errors (n, S, S)."""

    y: Array
    side: Array
    covariance: Array | None = None

    def of(self, index: Index) -> Readings:
        """Some of the rows."""
        errors = None if self.covariance is None else self.covariance[index]
        return Readings(self.y[index], self.side[index], errors)

    def as_chunk(self) -> dict[str, Any]:
        """The readings as plain lists, as workers get them."""
        errors = None if self.covariance is None else self.covariance.tolist()
        return {"y": self.y.tolist(), "side": self.side.tolist(), "covariance": errors}

    @classmethod
    def from_chunk(cls, chunk: Mapping[str, Any]) -> Readings:
        """The readings of `as_chunk`."""
        errors = chunk["covariance"]
        errors = None if errors is None else np.array(errors)
        return cls(np.array(chunk["y"]), np.array(chunk["side"]), errors)


@dataclass(frozen=True, eq=False)
class Cases:
    """Observers of N possible whiskers under J possible noises.

    Attributes
    ----------
    shape : tuple
        The number of values of each nuisance parameter.
    log_prior : array, shape (N F,)
        Their ln prior.
    stiffness : array, shape (F,)
        Relative to the observer's: signals and noise are proportional to it, so that readings are
        divided by it.
    observers : list
        ``observers[i][j]`` are the observers of pushes to the positive and the negative side.
    """

    shape: tuple[int, ...]
    log_prior: Array
    stiffness: Array
    observers: list[list[tuple[Observer, Observer]]]
    _lattices: dict[Any, Lattice] = field(default_factory=dict)

    @property
    def single(self) -> bool:
        """Whether there is nothing to mix."""
        return len(self.observers) * len(self.observers[0]) * len(self.stiffness) == 1

    @property
    def middle(self) -> list[tuple[Observer, Observer]]:
        """The observers of the middle whisker."""
        return self.observers[len(self.observers) // 2]

    def __getstate__(self) -> dict[str, Any]:
        return vars(self) | {"_lattices": {}}

    def sides(self, i: int, j: int, readings: Readings) -> Iterator[tuple[Index, Observer]]:
        """Rows pushed to either side, each with the observer."""
        positive, negative = self.observers[i][j]
        if positive is negative:
            yield np.arange(len(readings.y)), positive
            return
        for observer, index in ((positive, readings.side > 0), (negative, readings.side < 0)):
            if index.any():
                yield np.flatnonzero(index), observer

    @cached_property
    def on_lattices(self) -> bool:
        """Whether there is something to mix, of observers that lattices serve."""
        pairs = [pair for by_noise in self.observers for pair in by_noise]
        return not self.single and all(serves(observer) for pair in pairs for observer in pair)

    def cost(self, measured: bool, count: int, workers: int) -> str:
        """What so many rows take, and what spares it, where that is more than half a minute."""
        nodes = len(self.observers) * len(self.stiffness) * len(self.observers[0])
        each = SECONDS[0 if self.on_lattices and not measured else 1]
        minutes = nodes * each * count / workers / 60
        if minutes < 0.5:
            return ""
        spared = "" if self.single else (
            f" by {nodes} combinations of shape, stiffness and noise; a curvature, a Young's "
            "modulus and a noise that are given spare those"
        )  # fmt: skip
        return f"Locating {count} rows takes about {max(minutes, 1):.0f} min{spared}."

    def densities(self, observer: Observer, width: float) -> Densities:
        """The densities of an observer on a lattice of its whisker, which is kept."""
        step = step_of(observer.noise, len(observer.cue.signal_names))
        key = observer.whisker, step
        if key not in self._lattices:
            self._lattices[key] = Lattice(observer, step)
        return self._lattices[key].under(observer.noise, width)


class Mixed(NamedTuple):
    """Of n rows or touches: ends of intervals (n, 2), and means over all cases (n, K)."""

    ends: Array
    values: Array


# -- in blocks -------------------------------------------------------------------------------------


@dataclass
class Done:
    """Counts what is done of `total`, and says so."""

    progress: Callable[[int, int], None] | None = None
    total: int = 0
    count: int = 0

    def __call__(self, more: int) -> None:
        self.count += int(more)
        if self.progress and more:
            self.progress(self.count, self.total)


@dataclass(frozen=True)
class Spread:
    """Work on blocks of rows in this process, or spread over `workers` or a cluster.

    Each block is the same work wherever it is done, with one thread of linear algebra, so that its
    numbers are the same to the bit.
    """

    workers: int | None = None
    scheduler: str | None = None

    def over(
        self, work: Callable[[dict[str, Any]], Mixed], blocks: list[dict[str, Any]], title: str,
        done: Done, width: int,
    ) -> Mixed:  # fmt: skip
        """What `work` gives for each block, put together: (n, 2) and (n, `width`)."""
        sizes = [len(block["y"]) for block in blocks]
        results = [Mixed(np.zeros((0, 2)), np.zeros((0, width)))]
        if self.workers is None and self.scheduler is None:
            for block, size in zip(blocks, sizes, strict=True):
                with campaign.limited_blas():
                    results.append(work(block))
                done(size)
        elif blocks:
            mean_size = sum(sizes) / len(sizes)
            before, ended = done.count, 0.0

            def advance(more: float = 1.0) -> None:
                nonlocal ended
                ended += more
                done(before + int(ended * mean_size) - done.count)

            table = campaign.run(
                partial(_as_table, work=work), blocks, seed=0,
                workers=1 if self.workers is None else self.workers, scheduler=self.scheduler,
                title=title, progress=advance if done.progress else None,
            ).to_numpy()  # fmt: skip
            results.append(Mixed(table[:, :2], table[:, 2:]))
        return Mixed(*(np.concatenate(sides) for sides in zip(*results, strict=True)))


def _as_table(
    chunk: dict[str, Any], seed: np.random.SeedSequence, work: Callable[[dict[str, Any]], Mixed]
) -> pd.DataFrame:
    """What `work` gives for a block, as workers send it."""
    numbers = np.concatenate(work(chunk), axis=1)
    return pd.DataFrame(numbers, columns=[f"{i}" for i in range(numbers.shape[1])])


def usual_bow(whisker: Any) -> float | None:
    """Sd of the prior of curvature at rest (1/m); None where it was given, and of a wire."""
    plain = getattr(whisker, "whisker", whisker)
    bow = usual_curvature(plain)
    if bow is None or is_curved(whisker) or plain.hinge_stiffness:
        return None
    # At the largest of `SCORES` it turns by no more than the domain's 2 rad from base to tip.
    return min(bow, 2.0 / SCORES[-1] / float(plain.length))


def whiskers_of(whisker: Any, bow: float | None) -> list[Any]:
    """The whisker with each possible curvature at rest (prior sd `bow`), or itself for None."""
    if bow is None:
        return [whisker]
    return [_bent(whisker, float(s) * bow) for s in SCORES]


def _bent(whisker: Any, curvature: float) -> Any:
    if isinstance(whisker, Profile):
        return whisker.curved(Spiral(curvature))
    return replace(whisker, curvature=curvature)


def cases_of(
    whisker: Any, cue: Cue, bow: float | None, noises: Sequence[Any], prior: Any
) -> Cases:
    """The cases of a whisker with unknown curvature (prior sd `bow`, or None) and stiffness.

    Each of `noises` is a `ReceptorNoise`, or a function of whisker and cue that makes one, whose
    floors are proportional to the whisker's stiffness. With one noise and no `bow` the engine
    itself marginalises over the cue's stiffness.
    """
    whiskers = whiskers_of(whisker, bow)
    scores = [np.zeros(1) if bow is None else SCORES]
    inner, stiffness = cue, np.ones(1)
    is_mixed = bow is not None or len(noises) > 1
    if isinstance(cue, UnknownStiffness) and is_mixed and cue.is_scale:
        inner, stiffness = cue.cue, np.exp(cue.spread * SCORES)
        scores = [SCORES] if bow is None else [SCORES, SCORES]
        if any(isinstance(law, ReceptorNoise) and not law.is_scale_family for law in noises):
            modulus = getattr(whisker, "whisker", whisker).youngs_modulus
            whiskers = [with_modulus(w, float(f * modulus)) for w in whiskers for f in stiffness]
            stiffness = np.ones(1)

    def observer(law: Any, seen: Any) -> Observer:
        noise = law if isinstance(law, ReceptorNoise) else law(seen, inner)
        return Observer(seen, inner, noise, prior or {})

    def pair(law: Any, positive: Any, negative: Any) -> tuple[Observer, Observer]:
        first = observer(law, positive)
        return first, first if negative is positive else observer(law, negative)

    squares = np.square(np.meshgrid(*scores, indexing="ij")).sum(axis=0)
    observers = [[pair(law, *seen_from_sides(w)) for law in noises] for w in whiskers]
    return Cases(squares.shape, -0.5 * squares.ravel(), stiffness, observers)


# -- rows ------------------------------------------------------------------------------------------

#: After the quantiles of a row: mean and sd of distance (m), mean and sd of angle, the numerical
#: error in sds, and the largest deviation of a signal at the most probable contact, in sds.
ERROR, MISFIT = 4, 5


def rows_of(cases: Cases, readings: Readings, pool: Spread, done: Done) -> Mixed:
    """Posteriors of single rows."""
    blocks = [
        readings.of(np.arange(i, min(i + BLOCK, len(readings.y)))).as_chunk()
        for i in range(0, len(readings.y), BLOCK)
    ]
    return pool.over(partial(_rows_in_block, cases=cases), blocks, "Rows", done, 6)


def _rows_in_block(chunk: dict[str, Any], cases: Cases) -> Mixed:
    """Posteriors of the rows of a block."""
    readings = Readings.from_chunk(chunk)
    p = ENDS if cases.single else QUANTILES
    n, on_lattices = len(readings.y), readings.covariance is None and cases.on_lattices
    shape = len(cases.observers), len(cases.stiffness), len(cases.observers[0]), n
    log, table = np.full(shape, -np.inf), np.full((*shape, len(p) + 6), np.nan)
    for i, j in np.ndindex(shape[0], shape[2]):
        for index, observer in cases.sides(i, j, readings):
            subset = readings.of(index)
            if on_lattices:
                densities = cases.densities(observer, ALONE)
                result = _on_lattice(densities, subset.y, p, cases.stiffness)
            else:
                result = _by_cells(observer, subset, p, cases.stiffness)
            log[i, :, j][:, index], table[i, :, j][:, index] = result
    if on_lattices:
        for i, f, j, row in _unresolved(cases, log, table[..., len(p) + ERROR]):
            for index, observer in cases.sides(i, j, readings.of(row)):
                at = row[index]
                each = _by_cells(observer, readings.of(at), p, cases.stiffness[f : f + 1])
                log[i, f, j, at], table[i, f, j, at] = each[0][0], each[1][0]
        # Of what has next to no weight the error does not count.
        table[..., len(p) + ERROR][~_counts(cases, log)] = 0.0
    return _mixture(cases, log, table, len(p))


def _counts(cases: Cases, log: Array) -> Flags:
    """Whether a posterior of ln evidence (N, F, J, n) weighs enough for its error to count."""
    weight = log + cases.log_prior.reshape(log.shape[0], log.shape[1], 1, 1)
    top = weight.max(axis=(0, 1), keepdims=True)
    with np.errstate(invalid="ignore"):  # −inf less −inf
        return np.asarray((weight > top - IMPRECISE) | ~np.isfinite(top))


def _unresolved(
    cases: Cases, log: Array, error: Array
) -> Iterator[tuple[int, int, int, Index]]:
    """Whisker, stiffness and noise, and the rows for which a lattice is too coarse there."""
    bad = ~(error <= TOLERANCE) & _counts(cases, log)
    for i, f, j in np.ndindex(log.shape[:3]):
        if bad[i, f, j].any():
            yield i, f, j, np.flatnonzero(bad[i, f, j])


def _scaled_to(y: Array, stiffness: Array) -> Array:
    """Readings (n, S) over each stiffness (F,), (F n, S)."""
    return (y / stiffness[:, None, None]).reshape(-1, y.shape[-1])


def _on_lattice(
    densities: Densities, y: Array, p: Array, stiffness: Array
) -> tuple[Array, Array]:
    """ln evidence (F, n) and numbers (F, n, K) of readings (n, S) at each stiffness (F,)."""
    sums = densities.sums(_scaled_to(y, stiffness))
    bounded = sums.mean.shape[1]
    table = np.zeros((len(sums.error), len(p) + 6))
    there = np.flatnonzero(np.isfinite(sums.log_evidence))
    if there.size:
        table[there, : len(p)] = densities.quantiles(sums.layers[there], p)
    _moments_into(table[:, len(p) :], sums.mean, sums.sd, bounded)
    table[:, len(p) + ERROR], table[:, len(p) + MISFIT] = np.fmin(sums.error, 1.0), sums.misfit
    log = sums.log_evidence.reshape(len(stiffness), -1)
    log = log - y.shape[1] * np.log(stiffness)[:, None]
    return log, table.reshape(*log.shape, -1)


def _by_cells(
    observer: Observer, readings: Readings, p: Array, stiffness: Array
) -> tuple[Array, Array]:
    """As `_on_lattice`, by the observer's own cells."""
    y, errors = _scaled_to(readings.y, stiffness), readings.covariance
    if errors is not None:
        errors = errors / stiffness[:, None, None, None] ** 2
        errors = errors.reshape(-1, *errors.shape[2:])
    sums = sums_of(observer, y, errors)
    table = np.zeros((len(y), len(p) + 6))
    table[:, : len(p)] = sums.quantiles(p, 0)
    _moments_into(table[:, len(p) :], sums.mean, sums.sd, observer.bounded)
    signals = observer.signals(sums.best)[0]
    variance = observer.noise.sd(signals) ** 2
    if errors is not None:
        variance = variance + np.diagonal(errors, axis1=1, axis2=2)
    misfit = np.abs(y - observer.noise.mean(signals)) / np.sqrt(variance)
    table[:, len(p) + ERROR], table[:, len(p) + MISFIT] = np.fmin(sums.error, 1.0), misfit.max(1)
    log = np.nan_to_num(sums.log_evidence, nan=-np.inf).reshape(len(stiffness), -1)
    log = log - y.shape[1] * np.log(stiffness)[:, None]
    return log, table.reshape(*log.shape, -1)


def _moments_into(table: Array, mean: Array, sd: Array, bounded: int) -> None:
    table[:, : 2 * bounded : 2], table[:, 1 : 1 + 2 * bounded : 2] = (
        mean[:, :bounded],
        sd[:, :bounded],
    )


# -- touches ---------------------------------------------------------------------------------------


def touches_of(
    cases: Cases, readings: Readings, members: Sequence[Index], exponent: Array, pool: Spread,
    done: Done,
) -> Mixed:  # fmt: skip
    """Posteriors of the distance that the rows of each touch share.

    `members` are the rows of each touch. The likelihood of rows with independent noise is raised
    to the power `exponent` (T,). Below 1 the angles have the observer's prior: the prior of a
    touch's largest angle would weigh too much.
    """
    blocks = []
    sizes = np.array([len(each) for each in members], dtype=int)
    number = (np.cumsum(sizes) - sizes) // BLOCK  # of the block in which a touch begins
    for block in np.unique(number):
        touches = np.flatnonzero(number == block)
        chunk = readings.of(np.concatenate([members[t] for t in touches])).as_chunk()
        chunk["owner"] = np.repeat(np.arange(len(touches)), sizes[touches]).tolist()
        chunk["exponent"] = exponent[touches].tolist()
        blocks.append(chunk)
    return pool.over(partial(_touches_in_block, cases=cases), blocks, "Touches", done, 2)


def _touches_in_block(chunk: dict[str, Any], cases: Cases) -> Mixed:
    """Posteriors of the touches of a block, each of which is one of its owners (n,), ascending."""
    readings, owner = Readings.from_chunk(chunk), np.array(chunk["owner"], dtype=np.intp)
    exponent = np.array(chunk["exponent"])
    count = len(exponent)
    p = ENDS if cases.single else QUANTILES
    shape = len(cases.observers), len(cases.stiffness), len(cases.observers[0]), count
    log, table = np.full(shape, -np.inf), np.full((*shape, len(p) + 2), np.nan)
    spans = SPANS if np.all(exponent == 1) else None
    signals = readings.y.shape[1] * np.bincount(owner, minlength=count)
    by_cells: Flags = np.ones(count, dtype=bool)
    if readings.covariance is None and cases.on_lattices:
        layers = np.zeros(shape, dtype=np.intp)
        for i, j in np.ndindex(shape[0], shape[2]):
            sides = [
                (index, cases.densities(observer, TOGETHER))
                for index, observer in cases.sides(i, j, readings)
            ]
            log[i, :, j], table[i, :, j], layers[i, :, j] = _products(
                sides, readings.y, owner, count, exponent, spans, p, cases.stiffness
            )
            log[i, :, j] -= (exponent * signals) * np.log(cases.stiffness)[:, None]
        by_cells = np.asarray((_counts(cases, log) & (layers < LAYERS)).any(axis=(0, 1, 2)))
    which = np.flatnonzero(by_cells)
    if which.size:
        kept = by_cells[owner]
        number = np.cumsum(by_cells) - 1
        result = _products_by_cells(
            cases, readings.of(np.flatnonzero(kept)), number[owner[kept]], exponent[which], spans, p
        )
        slope = (exponent * signals)[which] * np.log(cases.stiffness)[:, None, None]
        log[..., which], table[..., which, :] = result[0] - slope, result[1]
    return _mixture(cases, log, table, len(p))


def _products(
    sides: list[tuple[Index, Densities]], y: Array, owner: Index, count: int, exponent: Array,
    spans: Array | None, p: Array, stiffness: Array,
) -> tuple[Array, Array, Index]:  # fmt: skip
    """Products of the likelihoods of the rows of touches, on lattices of either side.

    ln evidence (F, T) and numbers (F, T, K) at each stiffness (F,), and how many layers have mass
    (F, T). `owner` (n,) ascends.
    """
    densities = sides[0][1]
    lattice = densities.lattice
    if lattice.observer.bounded < 2 or "deflection_angle" in lattice.observer.prior:
        spans = None
    begin = np.flatnonzero(np.diff(owner, prepend=-1))
    log = np.full((len(stiffness), count), -np.inf)
    table = np.full((*log.shape, len(p) + 2), np.nan)
    layers = np.zeros(log.shape, dtype=np.intp)
    prior = np.empty((len(y), lattice.shape[0]))
    for index, side in sides:
        prior[index] = side.lattice.log_prior + side.lattice.log_total
    prior = prior[begin]  # whose angles are those of the side of the touch
    for f, value in enumerate(stiffness):
        total = np.full((len(y), lattice.shape[0], 1 if spans is None else len(spans)), -np.inf)
        for index, side in sides:
            ones = np.ones((*side.lattice.angle.shape, 1))
            weights = ones if spans is None else side.lattice.spans(spans)
            with np.errstate(divide="ignore", invalid="ignore"):
                joint = np.log(side.layers(y[index] / value, weights))
                given = joint - (side.lattice.log_prior + side.lattice.log_total)[:, None]
                total[index] = np.where(np.isnan(given), -np.inf, given)
        product = exponent[:, None, None] * np.add.reduceat(total, begin, axis=0)
        product = logsumexp(product, axis=2) - np.log(product.shape[2]) + prior
        top = product.max(axis=1)
        there = np.flatnonzero(np.isfinite(top))
        layers[f, there] = (product[there] > top[there, None] - 12.5).sum(axis=1)
        log[f, there] = logsumexp(product[there], axis=1)
        if there.size:
            table[f, there] = _numbers(densities, product[there], p)
    return log, table, layers


def _numbers(densities: Densities, log: Array, p: Array) -> Array:
    """Quantiles, mean and sd of distances (n, Q + 2), from ln of densities over layers (n, L)."""
    lattice = densities.lattice
    curves = Cumulative(log, PARTS)
    space = lattice.observer.space
    at = lattice.x[0] + lattice.step * curves.inverse(p)
    places = curves.first + (np.arange(curves.mass.shape[1]) + 0.5) / PARTS
    r = space.distance(lattice.x[0] + lattice.step * places)
    moments = mixture_moments(curves.mass.T, r[:, None])
    return np.concatenate([space.distance(at), moments.mean[:, None], moments.sd[:, None]], axis=1)


def _products_by_cells(
    cases: Cases, readings: Readings, owner: Index, exponent: Array, spans: Array | None, p: Array
) -> tuple[Array, Array]:
    """ln evidence (N, F, J, T) and numbers (N, F, J, T, K) of touches, by the observers' cells."""
    count = len(exponent)
    shape = len(cases.observers), len(cases.stiffness), len(cases.observers[0]), count
    log, table = np.full(shape, -np.inf), np.full((*shape, len(p) + 2), np.nan)
    positive = readings.side[np.searchsorted(owner, np.arange(count))] > 0
    if positive.any() and not positive.all():  # whose angles have another prior
        for touches in (positive, ~positive):
            number, index = np.cumsum(touches) - 1, np.flatnonzero(touches[owner])
            log[..., touches], table[..., touches, :] = _products_by_cells(
                cases, readings.of(index), number[owner[index]], exponent[touches], spans, p
            )
        return log, table
    for i, f, j in np.ndindex(shape[:3]):
        groups, stiffness = [], cases.stiffness[f]
        for index, observer in cases.sides(i, j, readings):
            errors = readings.covariance
            errors = None if errors is None else errors[index] / stiffness**2
            y = readings.y[index] / stiffness
            groups.append(ReadingGroup(observer, y, errors, owner[index]))
        for t, one in enumerate(one_distance(groups, count, spans, exponent)):
            if np.isfinite(one.mean):
                log[i, f, j, t] = one.log_evidence
                table[i, f, j, t] = [*one.quantiles(p), one.mean, one.sd]
    return log, table


# -- mixtures --------------------------------------------------------------------------------------


def _mixture(cases: Cases, log: Array, table: Array, count: int) -> Mixed:
    """The mixture of posteriors with ln evidence `log` (N, F, J, n) and numbers (N, F, J, n, K).

    The first `count` numbers are quantiles, the next two mean and sd.
    """
    log, table = (part.reshape(-1, *part.shape[2:]) for part in (log, table))
    if cases.single:
        return Mixed(table[0, 0, :, :count], table[0, 0, :, count:])
    n, width = log.shape[-1], table.shape[-1]
    log = log + cases.log_prior[:, None, None]
    values, ends = np.full((n, width - count), np.nan), np.full((n, 2), np.nan)
    for begin in range(0, n, MIXED_TOGETHER):
        index = slice(begin, begin + MIXED_TOGETHER)
        weight, numbers = [], []
        for j in range(log.shape[1]):
            each = _between(cases.shape, log[:, j, index], table[:, j, index])
            weight.append(each[0])
            numbers.append(each[1])
        # Each noise is as likely as the next, whatever evidence the single row has.
        weights, every = np.concatenate(weight), np.concatenate(numbers)
        there = np.flatnonzero(weights.sum(axis=0) > 0)
        if not there.size:
            continue
        weights, every = weights[:, there], every[:, there]
        weights = weights / weights.sum(axis=0)
        ends[begin + there] = _ends(weights, every[..., :count])
        moments_of = every[..., count:]
        values[begin + there] = np.einsum("mn,mnk->nk", weights, moments_of)
        for k in range(0, min(4, moments_of.shape[-1]), 2):
            moments = mixture_moments(weights, moments_of[..., k], moments_of[..., k + 1])
            values[begin + there, k + 1] = moments.sd
    return Mixed(ends, values)


def _between(shape: tuple[int, ...], log: Array, table: Array) -> tuple[Array, Array]:
    """Weights (M, n) and numbers (M, n, K) of rows at nodes and between them.

    From ln of the evidence (N, n), interpolated by splines, and numbers (N, n, K), by cubics
    without overshoot; a node without evidence has the numbers of the nearest that has some. The
    weights of a row add up to 1, or to 0 where no node has evidence.
    """
    is_finite = np.isfinite(log)
    table = table.copy()
    place = np.stack(np.unravel_index(np.arange(len(log)), shape), axis=1)
    distance = np.abs(place[:, None] - place).sum(axis=2)
    for row in np.flatnonzero(~is_finite.all(axis=0) & is_finite.any(axis=0)):
        given = np.flatnonzero(is_finite[:, row])
        nearest = given[distance[:, given].argmin(axis=1)]
        table[:, row] = table[nearest, row]
    there = is_finite.any(axis=0)
    table[:, ~there] = 0.0
    top = np.where(there, log.max(axis=0), 0.0)
    log = np.maximum(log - top, -45.0).reshape(*shape, -1)
    table = table.reshape(*shape, *table.shape[1:])
    for d, size in enumerate(shape):
        if size > 1:
            nodes, fine = np.arange(size), np.linspace(0, size - 1, BETWEEN * (size - 1) + 1)
            log = make_interp_spline(nodes, log, k=min(3, size - 1), axis=d)(fine)
            table = PchipInterpolator(nodes, table, axis=d)(fine)
    log = log.reshape(-1, log.shape[-1])
    weight = np.exp(log - log.max(axis=0))
    weight[weight < np.exp(-WEIGHTLESS)] = 0.0
    weight *= there / weight.sum(axis=0)
    return weight, table.reshape(len(log), *table.shape[len(shape) :])


def _ends(weight: Array, quantile: Array) -> Array:
    """The 95 % intervals (n, 2) of mixtures of weight (M, n) with quantiles (M, n, Q).

    Mass is even between quantiles: two points of half of it have its mean and its variance.
    """
    n = weight.shape[1]
    node, index = np.nonzero(weight > np.exp(-WEIGHTLESS))
    quantile = np.maximum.accumulate(quantile[node, index], axis=1)
    low, high = np.full(n, np.inf), np.full(n, -np.inf)
    np.minimum.at(low, index, quantile[:, 0])
    np.maximum.at(high, index, quantile[:, -1])
    unit = np.maximum(high - low, 1e-300) / BINS
    place = (quantile - low[index, None]) / unit[index, None]
    mass = 0.5 * weight[node, index][:, None] * np.diff(QUANTILES)
    middle, width = (place[:, 1:] + place[:, :-1]) / 2, np.diff(place, axis=1) / np.sqrt(12.0)
    cumulative = np.zeros((n, BINS))
    for side in (middle - width, middle + width):
        bins = np.clip(side.astype(np.intp), 0, BINS - 1) + BINS * index[:, None]
        cumulative += np.bincount(bins.ravel(), mass.ravel(), n * BINS).reshape(n, BINS)
    below = np.pad(np.cumsum(cumulative, axis=1), ((0, 0), (1, 0)))
    below /= below[:, -1:]
    edges = np.arange(BINS + 1)
    at = np.stack([np.interp(ENDS, rise, edges) for rise in below])
    return np.asarray(low[:, None] + unit[:, None] * at)
