"""The receptor noise of a table, learnt from redundant signals and from the rows of its touches."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import fmin
from scipy.special import logsumexp

from .. import domain
from .._util.values import Array, Index
from ..cues import Cue
from ..inference import default_noise
from ..receptors import GeneralisedWeber, ReceptorNoise, Weber
from .lattice import Lattice
from .mixture import Cases, Readings

__all__ = ["BELIEF", "Learnt", "curvature_at", "learn", "rescaled_noise"]

#: Prior of the Weber fraction of a table's signals: median, and sd of its ln. Forces on real
#: tracked whiskers needed 0.2 to 0.3; simulated receptors have 0.1.
MEDIAN, LOG_SD = 0.2, 0.7
BELIEF = f"{MEDIAN:g} with an sd of ln of {LOG_SD:g}"
#: Step of the lattices, most sds between a reading and its signals, and rows, from which noise is
#: learnt. Rows at odds with noise that is too small must still say by how much.
STEP, WIDTH, ROWS = 0.12, 25.0, 48


class Learnt(NamedTuple):
    """Equally likely factors (J, S) of a cue's default noise.

    `independent` is the share of the variance that is independent between rows of a touch; `source`
    names what the factors were learnt from, "" for the prior alone.
    """

    factors: Array
    independent: float = 1.0
    source: str = ""

    def exponent(self, index: Array) -> Array:
        """Power of the likelihood of touches with so many rows, whose noise is partly shared.

        The mean of n rows has (1 − u) + u/n of one row's variance, where u is `independent`.
        """
        return np.asarray(1 / (index * (1 - self.independent) + self.independent))


def rescaled_noise(whisker: Any, cue: Cue, factor: Array) -> ReceptorNoise:
    """The cue's default noise, with that of each signal multiplied by a factor (S,)."""
    return _times(default_noise(whisker, cue), factor)


def _times(usual: Any, factor: Array) -> ReceptorNoise:
    k = usual.weber_fractions(len(factor)) * factor
    if isinstance(usual, Weber):
        return Weber(k, correlation=usual.correlation)
    floor = usual.floors(len(factor)) * factor
    return GeneralisedWeber(k, floor=floor, correlation=usual.correlation)


def curvature_at(log: Callable[[Array], Any], x: Array, step: float) -> Array:
    """Hessian (D, D) of a function of a point (D,), by central differences."""
    e = step * np.eye(len(x))
    pairs = [np.array([[log(x + s * a + t * b) for b in e] for a in e])
             for s, t in ((1, 1), (1, -1), (-1, 1), (-1, -1))]  # fmt: skip
    out = (pairs[0] - pairs[1] - pairs[2] + pairs[3]) / (4 * step**2)
    return np.asarray((out + out.T) / 2)


class Evidence:
    """Evidence of a table's rows and touches for factors of the noise, over possible whiskers.

    With the first noise of `cases`. Of touches (T,), `several` have more than one row.
    """

    def __init__(self, cases: Cases, readings: Readings, touch: Index, several: Index) -> None:
        self.cases, self.readings = cases, readings
        self.members = [np.flatnonzero(touch == t) for t in several]
        self.lattices = [
            [(index, Lattice(observer, STEP)) for index, observer in cases.sides(i, 0, readings)]
            for i in range(len(cases.observers))
        ]
        self.share = np.exp(cases.log_prior - logsumexp(cases.log_prior))[:, None]

    def __call__(self, factor: Array) -> tuple[Array, Array]:
        """ln evidence of each row (B,), and of each touch relative to that of its rows."""
        of_rows: Any = []
        of_touches: Any = []
        separate: Any = []
        y = self.readings.y
        for sides, stiffness in product(self.lattices, self.cases.stiffness):
            log = prior = np.full((len(y), len(sides[0][1].x)), -np.inf)
            log, prior = log.copy(), prior.copy()
            for index, lattice in sides:
                densities = lattice.under(_times(lattice.observer.noise, np.exp(factor)), WIDTH)
                ones = np.ones((*lattice.angle.shape, 1))
                with np.errstate(divide="ignore"):
                    log[index] = np.log(densities.layers(y[index] / stiffness, ones)[..., 0])
                log[index] -= lattice.log_total
                prior[index] = lattice.log_prior
            log -= y.shape[1] * np.log(stiffness)
            one = logsumexp(log, axis=1)
            together = []
            for index in self.members:
                with np.errstate(invalid="ignore"):  # −inf over −inf
                    total = (log[index] - prior[index]).sum(axis=0)
                    total = np.where(np.isnan(total), -np.inf, total) + prior[index[0]]
                together.append(logsumexp(total))
            of_rows.append(one)
            of_touches.append(together)
            separate.append([one[index].sum() for index in self.members])
        of_rows, of_touches, separate = (
            logsumexp(log, axis=0, b=self.share) for log in (of_rows, of_touches, separate)
        )
        with np.errstate(invalid="ignore"):
            return of_rows, np.nan_to_num(of_touches - separate, nan=-np.inf)


def learn(cases: Cases, readings: Readings, touch: Index) -> Learnt:
    """Learn a table's noise from redundant signals and from the agreement of rows of a touch.

    Of the possible whiskers of `cases`, with the first noise there; `touch` (n,) is −1 for rows in
    none.

    Rows of one touch may share their noise (a wrong direction of the force, say), so together they
    count as one row. Their scatter about one distance is a lower bound of the noise; above it the
    prior is flat in the logarithm.
    """
    observer, size = cases.observers[0][0][0], readings.y.shape[1]
    usual = observer.noise.weber_fractions(size)
    middle = np.full(size, np.log(MEDIAN / usual.max(initial=1e-300)))
    index = _sample(readings.y, touch)
    counts = np.bincount(touch[index] + 1, minlength=touch.max(initial=-1) + 2)
    counts[0] = 1
    weight = 1 / counts[touch[index] + 1]
    redundant = size > len(observer.unknowns)
    several = np.flatnonzero(counts > 1) - 1
    covariance, sources = LOG_SD**2 * np.eye(size), []
    if not (redundant or several.size):
        return Learnt(_star(middle, covariance, usual))
    evidence = Evidence(cases, readings.of(index), touch[index], several)
    if redundant:
        believed = middle

        def cost(factor: Any) -> float:
            one = np.maximum(evidence(factor)[0], -1e4)
            return float(0.5 * ((factor - believed) ** 2).sum() / LOG_SD**2 - weight @ one)

        middle = fmin(cost, middle, xtol=0.1, ftol=0.1, disp=False)
        value, axes = np.linalg.eigh(curvature_at(cost, middle, 0.1))
        covariance = (axes / np.maximum(value, LOG_SD**-2)) @ axes.T
        sources.append("redundant signals")
    independent = 1.0
    if several.size:
        step = LOG_SD * np.arange(-4, 3)
        agree = np.array([np.maximum(evidence(middle + s)[1], -1e4).sum() for s in step])
        fine = np.linspace(step[0], step[-1], 601)
        least = np.interp(fine, step, agree)
        least = np.exp(least - least.max())
        mean = np.ones(size) / size
        total = np.cumsum(least) * np.exp(-0.5 * fine**2 / (mean @ covariance @ mean))
        shift = float(total @ fine / total.sum())
        below = least * (fine <= max(shift, step[0]))
        independent = float(min(below @ np.exp(2 * (fine - shift)) / below.sum(), 1.0))
        middle = middle + shift
        sources.append("rows of one touch")
    return Learnt(_star(middle, covariance, usual), independent, " and ".join(sources))


def _sample(y: Array, touch: Index) -> Index:
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
