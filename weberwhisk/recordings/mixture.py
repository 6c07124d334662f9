"""Rows and touches located under all that nobody gave: mixtures over whiskers and noises.

A whisker's shape at rest and its stiffness take five values each, a noise those that were learnt.
For each of them the engine gives the evidence and the posterior; between values of the whisker both
are interpolated, quantile by quantile.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import PchipInterpolator, make_interp_spline
from scipy.special import ndtr

from .._util.values import Array, Index
from ..cues import Cue, UnknownStiffness
from ..cues.protocol import is_curved
from ..inference import Observer
from ..inference.methods import sums_of
from ..inference.one_distance import ReadingGroup, one_distance
from ..inference.weighted import Spans
from ..mechanics import Profile, Spiral
from ..whisker import Assumed, usual_turn

#: Values of what is not known, in sds of its prior, and parts between them.
SCORES = np.linspace(-2.5, 2.5, 5)
PARTS = 4
#: Most that a whisker turns from base to tip, rad: the domain's.
TURN = 2.0
#: Probabilities of the quantiles of each posterior that is mixed; of one alone the two ends.
QUANTILES = ndtr(np.linspace(-4.5, 4.5, 37))
ENDS = np.array([0.025, 0.975])
#: Rows that are located together, for progress and memory.
TOGETHER = 512
#: How far up to the fold the angles of a touch may go, as shares: with angles flat up to the fold,
#: touches of small angles had errors of 1.4 sd.
SPANS = np.array([0.05, 0.1, 0.2, 0.35, 0.55, 0.8, 1.2])

__all__ = ["SPANS", "Case", "Cases", "Mixed", "cases_of", "rows_of", "touches_of", "usual_bow"]

Case = list[tuple[Index, Observer]]


class Cases(NamedTuple):
    """The whiskers that there may be, and a case for each and each noise.

    `shape` counts the values of each unknown, ln of whose prior is (N,); cases are [N][J]: the
    rows of either side and their observer.
    """

    shape: tuple[int, ...]
    log_prior: Array
    cases: list[list[Case]]

    @property
    def single(self) -> bool:
        """Whether there is nothing to mix."""
        return len(self.cases) * len(self.cases[0]) == 1


class Mixed(NamedTuple):
    """Of n rows or touches: ends of intervals (n, 2), and means over all cases (n, K)."""

    ends: Array
    values: Array


def usual_bow(whisker: Any) -> float | None:
    """Curvature at rest (1/m) that is usual of a whisker whose own nobody gave, else none."""
    plain = getattr(whisker, "whisker", whisker)
    if not isinstance(plain.curvature, Assumed) or is_curved(whisker) or plain.hinge_stiffness:
        return None
    length = float(plain.length)
    bow = plain.identity[2] if plain.identity is not None else usual_turn() / length
    return min(float(bow), TURN / SCORES[-1] / length)


def cases_of(
    whisker: Any, cue: Cue, bow: float | None, side: Array, noises: Sequence[Callable[..., Any]],
    prior: Any,
) -> Cases:  # fmt: skip
    """The cases of a whisker whose curvature may be unknown (`bow` of its kind), and stiffness.

    Where there is one noise and no `bow`, the stiffness is the cue's, as the engine sums over it.
    """
    axes: list[list[Any]] = []
    if bow is not None:
        axes.append([_bent(whisker, float(score) * bow) for score in SCORES])
    inner: Any = cue
    if isinstance(cue, UnknownStiffness) and (axes or len(noises) > 1) and cue.is_scale:
        inner = cue.cue
        softer = np.exp(cue.spread * SCORES)
        axes = [[_softer(w, s) for s in softer] for w in (axes[0] if axes else [whisker])]
        shape: tuple[int, ...] = (len(axes), len(SCORES)) if bow is not None else (len(SCORES),)
        every = [w for row in axes for w in row]
    else:
        every = axes[0] if axes else [whisker]
        shape = (len(every),)
    scores = np.stack(np.meshgrid(*[_scores(n) for n in shape], indexing="ij"))
    cases = [
        [
            [(rows, Observer(own, inner, noise(own, inner), prior or {}))
             for rows, own in by_side(side, w)]
            for noise in noises
        ]
        for w in every
    ]  # fmt: skip
    return Cases(shape, -0.5 * (scores**2).sum(axis=0).ravel(), cases)


def _scores(count: int) -> Array:
    return np.asarray(SCORES if count > 1 else [0.0], dtype=float)


def _bent(whisker: Any, curvature: float) -> Any:
    if isinstance(whisker, Profile):
        return whisker.curved(Spiral(curvature))
    return replace(whisker, curvature=curvature)


def _softer(whisker: Any, factor: float) -> Any:
    if isinstance(whisker, Profile):
        return replace(whisker, whisker=_softer(whisker.whisker, factor))
    return replace(whisker, youngs_modulus=factor * whisker.youngs_modulus)


def by_side(side: Array, whisker: Any) -> list[tuple[Index, Any]]:
    """Rows pushed to either side, and the whisker as it looks from there: mirrored or not."""
    if not is_curved(whisker):
        return [(np.arange(len(side)), whisker)]
    profile = Profile.of(whisker)
    mirrored = profile.curved(profile.law.scaled(np.ones(()), -1.0))
    seen = ((np.flatnonzero(side > 0), whisker), (np.flatnonzero(side < 0), mirrored))
    return [(rows, own) for rows, own in seen if rows.size]


#: What stands behind the quantiles of a row: mean and sd of distance (m) and angle, the error of
#: the sums in sds, and by how many sds the worst signal is off at the most probable contact.
MEAN, SD, ANGLE, ANGLE_SD, ERROR, OFF = range(6)


def rows_of(
    cases: Cases, rows: Index, y: Array, covariance: Array | None, progress: Callable[[int], None]
) -> Mixed:
    """Rows one by one, with the covariances (n, S, S) of their measurement errors."""
    p = ENDS if cases.single else QUANTILES
    out = []
    for begin in range(0, len(rows), TOGETHER):
        some = rows[begin : begin + TOGETHER]
        place = np.full(len(y), -1)
        place[some] = np.arange(len(some))
        log = np.full((len(cases.cases), len(cases.cases[0]), len(some)), -np.inf)
        table = np.full((*log.shape, len(p) + 6), np.nan)
        for i, j in np.ndindex(log.shape[:2]):
            for own, observer in cases.cases[i][j]:
                mine = own[place[own] >= 0]
                if mine.size:
                    errors = None if covariance is None else covariance[mine]
                    log[i, j, place[mine]], table[i, j, place[mine]] = _row(
                        observer, y[mine], errors, p
                    )
        out.append(_mixed(cases, log, table, len(p)))
        progress(begin + len(some))
    if not out:
        return Mixed(np.zeros((0, 2)), np.zeros((0, 6)))
    return Mixed(*(np.concatenate(parts) for parts in zip(*out, strict=True)))


def _row(observer: Observer, y: Array, errors: Array | None, p: Array) -> tuple[Array, Array]:
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
    return np.nan_to_num(found.log_evidence, nan=-np.inf), table


def touches_of(
    cases: Cases, y: Array, covariance: Array | None, owner: Index, count: int, exponent: Array
) -> Mixed:
    """Distances that rows share, `owner` (n,) naming the touch of each, −1 for none.

    As a power `exponent` (count,) of what rows would say whose noise is independent. Below 1
    angles are as the observer has them: a prior of how far they go weighs too much there.
    """
    p = ENDS if cases.single else QUANTILES
    log = np.full((len(cases.cases), len(cases.cases[0]), count), -np.inf)
    table = np.full((*log.shape, len(p) + 2), np.nan)
    spans = SPANS if np.all(exponent == 1) else None
    for i, j in np.ndindex(log.shape[:2]):
        groups = []
        for rows, observer in cases.cases[i][j]:
            at = rows[owner[rows] >= 0]
            errors = None if covariance is None else covariance[at]
            if at.size:
                groups.append(ReadingGroup(observer, y[at], errors, owner[at]))
        for t, found in enumerate(one_distance(groups, count, spans, exponent)):
            if np.isfinite(found.mean):
                log[i, j, t] = found.log_evidence
                table[i, j, t] = [*found.quantiles(p), found.mean, found.sd]
    return _mixed(cases, log, table, len(p))


def _mixed(cases: Cases, log: Array, table: Array, count: int) -> Mixed:
    """The mixture of posteriors: ln of their evidence (N, J, n), and numbers (N, J, n, K).

    The first `count` numbers are quantiles, the next two mean and sd.
    """
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
                weight, own = _finer(cases.shape, log[:, j, row], table[:, j, row])
                weights.append(weight / weight.sum())
                tables.append(own)
        if not weights:
            continue
        weight, own = np.concatenate(weights) / len(weights), np.concatenate(tables)
        quantile = np.maximum.accumulate(own[:, :count], axis=1)
        mass = weight[:, None] * np.diff(QUANTILES)
        flat = [v.reshape(1, -1) for v in (quantile[:, :-1], quantile[:, 1:], mass)]
        ends[row] = Spans(np.zeros(1, dtype=np.intp), *flat).quantiles(ENDS)[0]
        values = own[:, count:]
        numbers[row] = weight @ values
        for at in range(0, 4 if values.shape[1] > 2 else 2, 2):
            square = values[:, at + 1] ** 2 + (values[:, at] - numbers[row, at]) ** 2
            numbers[row, at + 1] = np.sqrt(weight @ square)
    return Mixed(ends, numbers)


def _finer(shape: tuple[int, ...], log: Array, table: Array) -> tuple[Array, Array]:
    """Weights and numbers at parts between values, from those at values.

    Where a reading is of no contact, numbers are those of the nearest value.
    """
    known = np.isfinite(log)
    place = np.stack(np.unravel_index(np.arange(len(log)), shape))
    if not known.all():
        far = np.abs(place[:, :, None] - place[:, None, known]).sum(axis=0)
        table = table[np.flatnonzero(known)[far.argmin(axis=1)]]
    log = np.maximum(log - log.max(), -45.0).reshape(shape)
    table = table.reshape(*shape, -1)
    for d, many in enumerate(shape):
        if many > 1:
            fine = np.linspace(0, many - 1, PARTS * (many - 1) + 1)
            log = make_interp_spline(np.arange(many), log, k=3, axis=d)(fine)
            table = PchipInterpolator(np.arange(many), table, axis=d)(fine)
    log = log.ravel()
    heavy = log > log.max() - 18.0
    return np.exp(log[heavy] - log.max()), table.reshape(len(log), -1)[heavy]
