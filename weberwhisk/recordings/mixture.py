"""Rows and touches located with unknown noise, shape at rest and stiffness.

Noise is learnt from the table. The curvature at rest and the stiffness of the whisker are
nuisance parameters with five values each: every combination gives an evidence and a posterior,
whose quantiles are interpolated between the values, and the result is their mixture.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import fmin
from scipy.special import logsumexp, ndtr

from .. import domain
from .._util.values import Array, Index
from .._util.weights import mixture_moments
from ..cues import Cue, UnknownStiffness
from ..cues.protocol import is_curved
from ..inference import Observer, default_noise
from ..inference import layers as inference_layers
from ..inference.coordinates import unconstrain_distance
from ..inference.one_distance import ReadingGroup, one_distance
from ..inference.quadrature import sums_of
from ..inference.weighted import between_nodes, in_one
from ..mechanics import Profile, Spiral
from ..mechanics.shape import with_modulus
from ..receptors import GeneralisedWeber, ReceptorNoise, Weber
from ..whisker import usual_curvature

#: Prior of the Weber fraction of a table's signals: median, and sd of its ln. Forces on real
#: tracked whiskers needed 0.2 to 0.3; simulated receptors have 0.1.
USUAL, SPREAD = 0.2, 0.7
BELIEF = f"{USUAL:g} with an sd of ln of {SPREAD:g}"
#: Grid points along each axis of contacts, and rows, used to learn the noise.
LATTICE, ROWS = 64, 48
#: Values of a nuisance parameter of the whisker, in sds of its prior.
SCORES = np.linspace(-2.5, 2.5, 5)
#: Probabilities of the quantiles of each posterior in a mixture, and those of a single posterior.
QUANTILES, ENDS = ndtr(inference_layers.SCORES), np.array([0.025, 0.975])
#: Largest angle of a touch as a share of the fold: with a flat prior of angles up to the fold,
#: touches at small angles had errors of 1.4 sd.
SPANS = np.array([0.05, 0.1, 0.2, 0.35, 0.55, 0.8, 1.2])

__all__ = [
    "BELIEF", "SPANS", "Case", "Cases", "Lattice", "Learnt", "Mixed", "cases_of",
    "curvature_at", "learn", "rows_of", "scaled", "touches_of", "usual_bow",
]  # fmt: skip

# -- noise learnt ----------------------------------------------------------------------------------


class Learnt(NamedTuple):
    """Equally likely factors (J, S) of a cue's default noise.

    `independent` is the share of the variance that is independent between rows of a touch; `said`
    names what the factors were learnt from, "" for the prior alone.
    """

    factors: Array
    independent: float = 1.0
    said: str = ""

    def exponent(self, rows: Array) -> Array:
        """Power of the likelihood of touches with so many rows, whose noise is partly shared.

        The mean of n rows has (1 − u) + u/n of one row's variance, where u is `independent`.
        """
        return np.asarray(1 / (rows * (1 - self.independent) + self.independent))


def scaled(whisker: Any, cue: Cue, factor: Array) -> ReceptorNoise:
    """The cue's default noise, with that of each signal multiplied by a factor (S,)."""
    return _times(default_noise(whisker, cue), factor)


def _times(usual: Any, factor: Array) -> ReceptorNoise:
    k = usual.weber_fractions(len(factor)) * factor
    if isinstance(usual, Weber):
        return Weber(k, correlation=usual.correlation)
    floor = usual.floors(len(factor)) * factor
    return GeneralisedWeber(k, floor=floor, correlation=usual.correlation)


class Lattice:
    """A grid of contacts over the whole reach: their signals and prior masses."""

    def __init__(self, observer: Observer) -> None:
        self.observer, space = observer, observer.space
        far = float(unconstrain_distance(np.array(0.995)))
        x = np.linspace(-far, far, LATTICE)
        fractions = 0.5 + np.tanh(np.sinh(x) / 2) / 2
        at = space.spread(fractions, others=5)
        shape = (LATTICE,) * observer.bounded + (5,) * (at.shape[1] - observer.bounded)
        axes = at.reshape(*shape, -1)
        with np.errstate(all="ignore"):
            contact, log = observer.space.constrain(at)
            for i in range(observer.bounded):
                log = log + np.log(np.abs(np.gradient(axes[..., i], axis=i))).ravel()
            signals, outcome = observer.signals(contact)
        held = (outcome == 0) & np.isfinite(log) & np.isfinite(signals).all(axis=1)
        order = np.argsort(~held, kind="stable")[: held.sum()]
        self.signals, self.layer = signals[order], order // (len(at) // LATTICE)
        self.log_prior = log[order]
        self.prior = self._summed(self.log_prior[None])[0]
        total = logsumexp(self.prior)
        self.log_prior, self.prior = self.log_prior - total, self.prior - total

    def _summed(self, log: Array) -> Array:
        """ln of sums over the contacts at each distance, (B, LATTICE)."""
        top = log.max(axis=1, keepdims=True)
        first = np.flatnonzero(np.diff(self.layer, prepend=-1))
        out = np.full((len(log), LATTICE), -np.inf)
        with np.errstate(divide="ignore"):
            sums = np.log(np.add.reduceat(np.exp(log - top), first, axis=1)) + top
        out[:, self.layer[first]] = sums
        return out

    def layers(self, y: Array, factor: Array) -> Array:
        """ln of the joint density of readings (B, S) and distance, (B, LATTICE)."""
        noise = _times(self.observer.noise, factor)
        return self._summed(noise.log_likelihood(y[:, None], self.signals) + self.log_prior)


def curvature_at(log: Callable[[Array], Any], x: Array, step: float) -> Array:
    """Hessian (D, D) of a function of a point (D,), by central differences."""
    e = step * np.eye(len(x))
    pairs = [np.array([[log(x + s * a + t * b) for b in e] for a in e])
             for s, t in ((1, 1), (1, -1), (-1, 1), (-1, -1))]  # fmt: skip
    out = (pairs[0] - pairs[1] - pairs[2] + pairs[3]) / (4 * step**2)
    return np.asarray((out + out.T) / 2)


def learn(cases: Cases, y: Array, touch: Index) -> Learnt:
    """Learn a table's noise from redundant signals and from the agreement of rows of a touch.

    Of the possible whiskers of `cases`, with the first noise there; `y` (n, S); `touch` (n,) is −1
    for rows in none.

    Rows of one touch may share their noise (a wrong direction of the force, say), so together they
    count as one row. Their scatter about one distance is a lower bound of the noise; above it the
    prior is flat in the logarithm.
    """
    observer, size = cases.cases[0][0][0][1], y.shape[1]
    usual = observer.noise.weber_fractions(size)
    middle = np.full(size, np.log(USUAL / usual.max(initial=1e-300)))
    rows = _chosen(y, touch)
    counts = np.bincount(touch[rows] + 1, minlength=touch.max(initial=-1) + 2)
    counts[0] = 1
    weight = 1 / counts[touch[rows] + 1]
    redundant = size > len(observer.unknowns)
    several = np.flatnonzero(counts > 1) - 1
    covariance, said = SPREAD**2 * np.eye(size), []
    if not (redundant or several.size):
        return Learnt(_star(middle, covariance, usual))
    lattices = [[(np.flatnonzero(np.isin(rows, own)), Lattice(o)) for own, o in first]
                for first, *_ in cases.cases]  # fmt: skip
    share = np.exp(cases.log_prior - logsumexp(cases.log_prior))[:, None]

    def evidence(factor: Array) -> tuple[Array, Array]:
        """ln evidence of each row (B,), and of each touch relative to that of its rows."""
        each, both = [], []
        for member, stiffness in product(lattices, cases.stiffness):
            layers = np.full((len(rows), LATTICE), -np.inf)
            prior = np.zeros((len(rows), LATTICE))
            for own, lattice in member:
                layers[own] = lattice.layers(y[rows[own]] / stiffness, np.exp(factor))
                prior[own] = lattice.prior
            layers -= size * np.log(stiffness)
            one = logsumexp(layers, axis=1)
            together = []
            for t in several:
                own = np.flatnonzero(touch[rows] == t)
                with np.errstate(invalid="ignore"):
                    total = np.nan_to_num((layers[own] - prior[own]).sum(axis=0), nan=-np.inf)
                total = total + prior[own[0]]
                together.append(logsumexp(total) - one[own].sum())
            each.append(one)
            both.append(together)
        return logsumexp(each, axis=0, b=share), logsumexp(both, axis=0, b=share)

    if redundant:
        believed = middle

        def cost(factor: Any) -> float:
            one = np.maximum(evidence(factor)[0], -1e4)
            return float(0.5 * ((factor - believed) ** 2).sum() / SPREAD**2 - weight @ one)

        middle = fmin(cost, middle, xtol=0.1, ftol=0.1, disp=False)
        value, axes = np.linalg.eigh(curvature_at(cost, middle, 0.1))
        covariance = (axes / np.maximum(value, SPREAD**-2)) @ axes.T
        said.append("redundant signals")
    independent = 1.0
    if several.size:
        step = SPREAD * np.arange(-4, 3)
        agree = np.array([np.maximum(evidence(middle + s)[1], -1e4).sum() for s in step])
        fine = np.linspace(step[0], step[-1], 601)
        least = np.interp(fine, step, agree)
        least = np.exp(least - least.max())
        own = np.ones(size) / size
        total = np.cumsum(least) * np.exp(-0.5 * fine**2 / (own @ covariance @ own))
        shift = float(total @ fine / total.sum())
        below = least * (fine <= max(shift, step[0]))
        independent = float(min(below @ np.exp(2 * (fine - shift)) / below.sum(), 1.0))
        middle = middle + shift
        said.append("rows of one touch")
    return Learnt(_star(middle, covariance, usual), independent, " and ".join(said))


def _chosen(y: Array, touch: Index) -> Index:
    """Rows from which noise is learnt: up to eight of each touch, from the whole table."""
    good = np.flatnonzero(np.isfinite(y).all(axis=1) & (y != 0).all(axis=1))
    unit = np.where(touch[good] >= 0, touch[good], -1 - good)
    groups = [good[unit == u] for u in dict.fromkeys(unit.tolist())]
    groups = [g[:: 1 + (len(g) - 1) // 8] for g in groups]
    many = sum(map(len, groups))
    kept = groups[:: 1 + (many - 1) // ROWS] if groups else []
    return np.sort(np.concatenate(kept)) if kept else good


def _star(middle: Array, covariance: Array, usual: Array) -> Array:
    """Factors (2S, S) whose logarithms have this mean and covariance, capped at the domain of k."""
    root = np.sqrt(len(middle)) * np.linalg.cholesky(covariance).T
    most = domain.WEBER_FRACTIONS[1] / usual.max(initial=1e-300)
    return np.minimum(np.exp(np.concatenate([middle + root, middle - root])), most)


# -- mixtures --------------------------------------------------------------------------------------

Case = list[tuple[Index, Observer]]


class Cases(NamedTuple):
    """A case for each of N possible whiskers and J possible noises.

    `shape` is the number of values of each nuisance parameter, `log_prior` (N F,) their ln prior.
    ``cases[i][j]`` lists the rows of either side with their observer, at each of F values of
    `stiffness` relative to the observer's: signals and noise are proportional to it, so that
    readings are divided by it.
    """

    shape: tuple[int, ...]
    log_prior: Array
    stiffness: Array
    cases: list[list[Case]]

    @property
    def single(self) -> bool:
        """Whether there is nothing to mix."""
        return len(self.cases) * len(self.cases[0]) * len(self.stiffness) == 1


class Mixed(NamedTuple):
    """Of n rows or touches: ends of intervals (n, 2), and means over all cases (n, K)."""

    ends: Array
    values: Array


def usual_bow(whisker: Any) -> float | None:
    """Sd of the prior of curvature at rest (1/m); None where it was given, and of a wire."""
    plain = getattr(whisker, "whisker", whisker)
    bow = usual_curvature(plain)
    if bow is None or is_curved(whisker) or plain.hinge_stiffness:
        return None
    # At the largest of `SCORES` it turns by no more than the domain's 2 rad from base to tip.
    return min(bow, 2.0 / SCORES[-1] / float(plain.length))


def cases_of(
    whisker: Any, cue: Cue, bow: float | None, side: Array, noises: Sequence[Any], prior: Any,
) -> Cases:  # fmt: skip
    """The cases of a whisker with unknown curvature (prior sd `bow`, or None) and stiffness.

    Each of `noises` is a `ReceptorNoise`, or a function of whisker and cue that makes one, whose
    floors are proportional to the whisker's stiffness. With one noise and no `bow` the engine
    itself marginalises over the cue's stiffness.
    """
    every = [whisker] if bow is None else [_bent(whisker, float(s) * bow) for s in SCORES]
    scores = [np.zeros(1) if bow is None else SCORES]
    inner, stiffness = cue, np.ones(1)
    mixed = bow is not None or len(noises) > 1
    if isinstance(cue, UnknownStiffness) and mixed and cue.is_scale:
        inner, stiffness = cue.cue, np.exp(cue.spread * SCORES)
        scores = [SCORES] if bow is None else [SCORES, SCORES]
        if any(isinstance(law, ReceptorNoise) and not law.is_scale_family for law in noises):
            modulus = getattr(whisker, "whisker", whisker).youngs_modulus
            every = [with_modulus(w, float(f * modulus)) for w in every for f in stiffness]
            stiffness = np.ones(1)

    def noise_of(law: Any, own: Any) -> Any:
        return law if isinstance(law, ReceptorNoise) else law(own, inner)

    squares = np.square(np.meshgrid(*scores, indexing="ij")).sum(axis=0)
    cases = [
        [
            [(rows, Observer(own, inner, noise_of(law, own), prior or {}))
             for rows, own in by_side(side, w)]
            for law in noises
        ]
        for w in every
    ]  # fmt: skip
    return Cases(squares.shape, -0.5 * squares.ravel(), stiffness, cases)


def _bent(whisker: Any, curvature: float) -> Any:
    if isinstance(whisker, Profile):
        return whisker.curved(Spiral(curvature))
    return replace(whisker, curvature=curvature)


def by_side(side: Array, whisker: Any) -> list[tuple[Index, Any]]:
    """Rows pushed to either side, each with the whisker, mirrored for the negative side."""
    if not is_curved(whisker):
        return [(np.arange(len(side)), whisker)]
    profile = Profile.of(whisker)
    mirrored = profile.curved(profile.law.scaled(np.ones(()), -1.0))
    seen = ((np.flatnonzero(side > 0), whisker), (np.flatnonzero(side < 0), mirrored))
    return [(rows, own) for rows, own in seen if rows.size]


#: After the quantiles of a row: mean and sd of distance (m), mean and sd of angle, the numerical
#: error in sds, and the largest deviation of a signal at the most probable contact, in sds.
ERROR, OFF = 4, 5


def rows_of(
    cases: Cases, rows: Index, y: Array, covariance: Array | None, progress: Callable[[int], None]
) -> Mixed:
    """Posteriors of single rows; `covariance` (n, S, S) is of their measurement errors."""
    p = ENDS if cases.single else QUANTILES
    out = []
    for begin in range(0, len(rows), 512):  # for progress and memory
        some = rows[begin : begin + 512]
        place = np.full(len(y), -1)
        place[some] = np.arange(len(some))
        log, table = _empty(cases, len(some), len(p) + 6)
        for i, j in np.ndindex(len(log), log.shape[2]):
            for own, observer in cases.cases[i][j]:
                mine = own[place[own] >= 0]
                if mine.size:
                    errors = None if covariance is None else covariance[mine]
                    found = _row(observer, y[mine], errors, p, cases.stiffness)
                    log[i, :, j][:, place[mine]], table[i, :, j][:, place[mine]] = found
        out.append(_mixed(cases, log, table, len(p)))
        progress(begin + len(some))
    if not out:
        return Mixed(np.zeros((0, 2)), np.zeros((0, 6)))
    return Mixed(*(np.concatenate(parts) for parts in zip(*out, strict=True)))


def _empty(cases: Cases, n: int, numbers: int) -> tuple[Array, Array]:
    """ln evidence (N, F, J, n), −inf, and numbers (N, F, J, n, K), NaN, for n posteriors."""
    shape = len(cases.cases), len(cases.stiffness), len(cases.cases[0]), n
    return np.full(shape, -np.inf), np.full((*shape, numbers), np.nan)


def _row(
    observer: Observer, y: Array, errors: Array | None, p: Array, stiffness: Array
) -> tuple[Array, Array]:
    """ln evidence (F, n) and numbers (F, n, K) of readings (n, S) at each stiffness (F,)."""
    shape = len(stiffness), *y.shape
    y = (y / stiffness[:, None, None]).reshape(-1, shape[-1])
    if errors is not None:
        errors = errors / stiffness[:, None, None, None] ** 2
        errors = errors.reshape(-1, *errors.shape[2:])
    found = sums_of(observer, y, errors)
    table = np.zeros((len(y), len(p) + 6))
    table[:, : len(p)] = found.quantiles(p, 0)
    bounded = observer.bounded
    table[:, len(p) : len(p) + 2 * bounded : 2] = found.mean[:, :bounded]
    table[:, len(p) + 1 : len(p) + 1 + 2 * bounded : 2] = found.sd[:, :bounded]
    signals = observer.signals(found.best)[0]
    variance = observer.noise.sd(signals) ** 2
    if errors is not None:
        variance = variance + np.diagonal(errors, axis1=1, axis2=2)
    table[:, len(p) + ERROR] = found.error
    off = np.abs(y - observer.noise.mean(signals)) / np.sqrt(variance)
    table[:, len(p) + OFF] = off.max(axis=1)
    log = np.nan_to_num(found.log_evidence, nan=-np.inf).reshape(shape[:2])
    return log - shape[-1] * np.log(stiffness)[:, None], table.reshape(*shape[:2], -1)


def touches_of(
    cases: Cases, y: Array, covariance: Array | None, owner: Index, count: int, exponent: Array
) -> Mixed:
    """Posteriors of the distance that the rows of each touch share.

    `owner` (n,) is the touch of each row, −1 for none. The likelihood of rows with independent
    noise is raised to the power `exponent` (count,). Below 1 the angles have the observer's prior:
    the prior of a touch's largest angle would weigh too much.
    """
    p = ENDS if cases.single else QUANTILES
    log, table = _empty(cases, count, len(p) + 2)
    spans = SPANS if np.all(exponent == 1) else None
    signals = y.shape[1] * np.bincount(owner[owner >= 0], minlength=count)
    for i, f, j in np.ndindex(log.shape[:3]):
        groups, stiffness = [], cases.stiffness[f]
        for rows, observer in cases.cases[i][j]:
            at = rows[owner[rows] >= 0]
            errors = None if covariance is None else covariance[at] / stiffness**2
            if at.size:
                groups.append(ReadingGroup(observer, y[at] / stiffness, errors, owner[at]))
        slope = -exponent * signals * np.log(stiffness)
        for t, found in enumerate(one_distance(groups, count, spans, exponent)):
            if np.isfinite(found.mean):
                log[i, f, j, t] = found.log_evidence + slope[t]
                table[i, f, j, t] = [*found.quantiles(p), found.mean, found.sd]
    return _mixed(cases, log, table, len(p))


def _mixed(cases: Cases, log: Array, table: Array, count: int) -> Mixed:
    """The mixture of posteriors with ln evidence `log` (N, F, J, n) and numbers (N, F, J, n, K).

    The first `count` numbers are quantiles, the next two mean and sd.
    """
    log, table = (part.reshape(-1, *part.shape[2:]) for part in (log, table))
    if cases.single:
        return Mixed(table[0, 0, :, :count], table[0, 0, :, count:])
    n, width = log.shape[-1], table.shape[-1]
    log = log + cases.log_prior[:, None, None]
    numbers = np.full((n, width - count), np.nan)
    ends = np.full((n, 2), np.nan)
    for row in range(n):
        weights, tables = [], []
        for j in range(log.shape[1]):
            if np.isfinite(log[:, j, row].max()):
                own_log = log[:, j, row].reshape(cases.shape)
                own = table[:, j, row].reshape(*cases.shape, -1)
                weight, own = between_nodes(own_log, np.isfinite(own_log), own, 4)
                weights.append(weight / weight.sum())
                tables.append(own)
        if not weights:
            continue
        weight, own = np.concatenate(weights) / len(weights), np.concatenate(tables)
        spans = in_one(np.zeros(1, dtype=np.intp), weight, own[:, :count], QUANTILES)
        ends[row] = spans.quantiles(ENDS)[0]
        values = own[:, count:]
        numbers[row] = weight @ values
        moments = slice(0, 4 if values.shape[1] > 2 else 2)
        means, sds = values[:, moments][:, ::2], values[:, moments][:, 1::2]
        numbers[row, moments][1::2] = mixture_moments(weight[:, None], means, sds).sd
    return Mixed(ends, numbers)
