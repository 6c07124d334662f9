"""Taps of a whisker on a hinge: their slopes, and the density of a table of them.

Slopes at one distance, relative to the curve, share a deviation of sd `misfit`, and each has noise
of sd k. A slope in a hundred, it is believed, is gross and says nothing of either: it lies about
the curve as a Cauchy variable of scale 10 k does. Whether rows are gross is summed over, for those
that might be.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import least_squares, minimize
from scipy.sparse import csr_array
from scipy.special import expit

from .._util import checks
from .._util.values import Array, Flags, Index
from ..cues import Cue
from ..cues.protocol import Encoded
from ..mechanics.contact import Outcome
from ..whisker import Whisker
from .learning import curvature_at

__all__ = [
    "BATCH", "GROSS_SHARE", "LEAST", "HingedTap", "Sensor", "TapModel", "far_rows", "gross_sets",
    "log_gross", "slope_on_hinge",
]  # fmt: skip

#: Least Weber fraction of a slope: without noise there would be no likelihood.
LEAST = 1e-4
#: Normal priors (mean, sd): logit of length over apex distance; ln of hinge over length; logit of
#: the misfit of one distance; ln of k. Seven distances inform little of the misfit's size: with an
#: sd of 1.5 intervals held 93.3 % of touches where it was 5 %, with 3 they held 95.3 % (of 2400).
BELIEFS = np.array([[1.5, 2.0], [-3.0, 2.0], [-4.5, 3.0], [-3.0, 1.5]])
#: Prior probability that a slope is gross, and the scale in k of the Cauchy distribution of these.
GROSS_SHARE, GROSS_SCALE = 0.01, 10.0
#: Rows nearer than this to the middle of their distance, in robust sds, belong: they are gross with
#: probabilities below 0.02, and all of them together move ln k by 0.002. Of one distance at most
#: six others can be gross.
NEAR, MOST = 2.5, 6
#: Numbers in memory at once.
BATCH = 4_000_000


@dataclass(frozen=True, eq=False, repr=False)
class HingedTap(Cue):
    """The slope of a light tap on a whisker whose base is a rotational spring (a hinge).

    Whisker and hinge are in series: slope = gain·3EI₀ω/(1/(1/r − 1/A) + h), equation (2.1) with
    the compliance of the hinge, h = 3EI₀/(its rotational stiffness), in metres.

    Parameters
    ----------
    hinge : float
        Compliance h of the hinge, m; 0 for a clamped base.
    gain : float
        Gain of the sensor: its units (counts per second) per N m/s.
    angular_velocity : float
        Angular velocity ω of the tap, rad/s.

    Examples
    --------
    >>> w = Whisker(50e-3, 100e-6, 5e-6)
    >>> soft, stiff = (HingedTap(h).signals(w, np.array([20e-3]))[0][0] for h in (5e-3, 0.0))
    >>> bool(soft < stiff)
    True
    """

    hinge: float = 0.0
    gain: float = 1.0
    angular_velocity: float = 1.0
    signal_names = ("moment_rate",)

    def signals(self, whisker: Whisker, contact: Array, *, model: str | None = None) -> Encoded:
        """The slope (..., 1) and the outcome of contacts (..., 1)."""
        checks.refuse_hinge(whisker, "HingedTap, which has a hinge of its own,")
        r = np.asarray(contact, dtype=float)[..., 0]
        apex = whisker.apex_distance
        reached = (r > 0) & (r < apex) & (r <= whisker.length)
        slope = slope_on_hinge(np.where(reached, r, whisker.length / 2), apex, self.hinge)
        slope = slope * self.gain * whisker.compliance_constant * self.angular_velocity
        outcome = np.where(reached, Outcome.HELD, Outcome.OUT_OF_REACH).astype(np.int8)
        return np.where(reached, slope, np.nan)[..., None], outcome


def slope_on_hinge(r: Array, apex: Any, hinge: Any) -> Array:
    """Slope of a tap at r over gain·3EI₀ω, by distance of the apex and compliance of the hinge."""
    return 1 / (1 / (1 / r - 1 / apex) + hinge)


class Sensor(NamedTuple):
    """Parameters of whiskers and sensors, (...): gain·3EI₀, apex distance and compliance of the
    hinge (m), misfit of a distance, and Weber fraction."""

    scale: Array
    apex: Array
    hinge: Array
    misfit: Array
    k: Array

    def slope(self, r: Array) -> Array:
        """Slopes (..., R) at distances r (R,)."""
        scale, apex, hinge = (np.asarray(v)[..., None] for v in self[:3])
        return np.asarray(scale * slope_on_hinge(r, apex, hinge))


class Subsets(NamedTuple):
    """The sets of rows of a distance that may be gross, one distance after the other: (C, n) with 1
    where a row belongs, and where it is gross; the first set of each distance, (D,); and how many
    rows belong, (C, 1)."""

    belong: csr_array
    gross: csr_array
    first: Index
    size: Array


@dataclass(frozen=True)
class TapModel:
    """The density of the slopes of taps, given whisker and sensor.

    Parameters
    ----------
    r, y : ndarray, shape (n,)
        Distances (m), ascending, and slopes of the taps.
    length : float
        Length of the whisker, m; what lies within 1 % of it is one distance.
    has_hinge : bool
        Whether the base may rotate.
    suspects : ndarray of int
        Rows that may be gross.
    """

    r: Array
    y: Array
    length: float
    has_hinge: bool
    suspects: Index

    @classmethod
    def of(cls, r: Array, y: Array, length: float, has_hinge: bool) -> TapModel:
        """The model of a table, of which rows far from others at their distance may be gross."""
        model = cls(r, y, length, has_hinge, np.zeros(0, dtype=np.intp))
        return replace(model, suspects=model._far())

    def without(self, members: Flags) -> TapModel:
        """The model of the other rows."""
        return TapModel.of(self.r[~members], self.y[~members], self.length, self.has_hinge)

    @cached_property
    def first(self) -> Index:
        """Index of the first tap at each distance."""
        first = [0]
        for i in range(len(self.r)):
            if self.r[i] - self.r[first[-1]] > 0.01 * self.length:
                first.append(i)
        return np.array(first[: len(self.r)], dtype=np.intp)

    @property
    def groups(self) -> list[Index]:
        """Rows of each distance."""
        return np.split(np.arange(len(self.r)), self.first[1:])

    @cached_property
    def _deviation(self) -> Array:
        """ln of slopes less the median at their distance."""
        log = np.log(self.y)
        return np.concatenate([log[g] - np.median(log[g]) for g in self.groups])

    @cached_property
    def robust_k(self) -> float:
        """Weber fraction by the median deviation from the median of a distance."""
        several = np.concatenate([np.full(g.size, g.size > 1) for g in self.groups])
        if not several.any():
            return LEAST
        share = several.sum() / max(several.sum() - sum(g.size > 1 for g in self.groups), 1)
        middle = float(np.median(np.abs(self._deviation[several])))
        return max(1.4826 * np.sqrt(share) * middle, LEAST)

    def _far(self) -> Index:
        """Rows that may be gross: of pairs and single taps all."""
        far = [g if g.size < 3 else g[far_rows(self._deviation[g] / self.robust_k)]
               for g in self.groups]  # fmt: skip
        return np.concatenate(far)

    @cached_property
    def _subsets(self) -> Subsets:
        belong: list[Index] = []
        gross: list[Index] = []
        first = []
        for members in self.groups:
            first.append(len(belong))
            for chosen in gross_sets(np.intersect1d(members, self.suspects)):
                gross.append(chosen)
                belong.append(np.setdiff1d(members, chosen))
        size = np.array([[one.size] for one in belong], dtype=float)
        of_belong, of_gross = _members(belong, len(self.r)), _members(gross, len(self.r))
        return Subsets(of_belong, of_gross, np.array(first, dtype=np.intp), size)

    def sensor(self, x: Array) -> Sensor:
        """The whisker and sensor at x: ln scale, logit taper, (ln hinge), logit misfit, ln k."""
        apex = self.length * (1 + np.exp(-x[..., 1]))
        hinge = self.length * np.exp(x[..., 2]) if self.has_hinge else 0.0 * apex
        return Sensor(np.exp(x[..., 0]), apex, hinge, expit(x[..., -2]), LEAST + np.exp(x[..., -1]))

    def log_subsets(self, x: Array) -> Array:
        """ln of the density of the slopes of a distance with each set of gross rows, (N, C).

        Slopes that belong, relative to the curve, have the covariance k²I + misfit².
        """
        belong, gross, first, size = self._subsets
        sensor = self.sensor(x)
        mean, k, misfit = sensor.slope(self.r).T, sensor.k, sensor.misfit
        off = self.y[:, None] / mean - 1
        middle = belong @ off / np.maximum(size, 1)
        within = np.maximum(belong @ off**2 - size * middle**2, 0.0) / k**2
        shared = k**2 + size * misfit**2
        log = -0.5 * (within + size * middle**2 / shared + np.log(shared))
        log -= (size - 1) * np.log(k) + 0.5 * size * np.log(2 * np.pi)
        log += size * np.log1p(-GROSS_SHARE)
        # The densities above are those of slopes relative to the curve.
        sets = np.diff(first, append=len(size))
        log -= np.repeat(np.add.reduceat(np.log(mean), self.first), sets, axis=0)
        return np.asarray((log + gross @ log_gross(off, k)).T)

    def log_density(self, x: Array) -> Array:
        """ln of the posterior density at x (N, D), up to a constant."""
        out = np.empty(len(x))
        size = max(BATCH // len(self.r), 1)
        for part in (slice(i, i + size) for i in range(0, len(x), size)):
            log = self.log_subsets(x[part])
            out[part] = np.logaddexp.reduceat(log, self._subsets.first, axis=1).sum(axis=1)
        prior = BELIEFS if self.has_hinge else np.delete(BELIEFS, 1, axis=0)
        return out - 0.5 * (((x[:, 1:] - prior[:, 0]) / prior[:, 1]) ** 2).sum(axis=1)

    def gross_probability(self, x: Array) -> Array:
        """Probability that a row is gross, (n,), the mean over draws x (N, D)."""
        log, first = self.log_subsets(x), self._subsets.first
        total = np.logaddexp.reduceat(log, first, axis=1)
        count = np.diff(first, append=log.shape[1])
        share = np.exp(log - np.repeat(total, count, axis=1)).mean(axis=0)
        return np.asarray(share @ self._subsets.gross)

    def mode(self, start: Array | None = None) -> tuple[Array, Array]:
        """The mode, from a start or from least squares, and the inverse of minus the curvature."""

        def cost(x: Any) -> float:
            return -float(self.log_density(np.asarray(x)[None])[0])

        x = minimize(cost, self._start() if start is None else start).x
        value, axes = np.linalg.eigh(curvature_at(cost, x, 1e-3))
        return x, (axes / np.maximum(value, 0.1)) @ axes.T

    def _start(self) -> Array:
        """By least squares through the medians of distances."""
        r = np.array([np.median(self.r[g]) for g in self.groups])
        y = np.array([np.median(self.y[g]) for g in self.groups])
        size = 3 if self.has_hinge else 2

        def off(x: Array) -> Array:
            """Residuals of the curve; 0.01 of the prior's fix parameters that the taps do not."""
            believed = (x[1:] - BELIEFS[: size - 1, 0]) / BELIEFS[: size - 1, 1]
            mean = self.sensor(np.append(x, [0.0, 0.0])).slope(r)
            return np.append(np.log(y / mean), 0.01 * believed)

        scale = np.log(np.median(y / slope_on_hinge(r, 1.1 * self.length, 0.0)))
        begin: Sequence[float] = [scale, 1.5, -3.0][:size]
        curve = least_squares(off, begin, loss="soft_l1", f_scale=0.05).x
        scatter = max(1.4826 * float(np.median(np.abs(off(curve)[: len(y)]))), LEAST)
        k = self.robust_k if self.robust_k > LEAST else scatter
        return np.array([*curve, np.log(scatter), np.log(k)])


def far_rows(off: Array) -> Index:
    """Which rows of a distance may be gross, by how many sds they are off."""
    far = np.flatnonzero(np.abs(off) > NEAR)
    return np.sort(far[np.argsort(-np.abs(off[far]), kind="stable")][:MOST])


def gross_sets(suspects: Index) -> Iterator[Index]:
    """Every set of rows, of those that may be gross."""
    for size in range(suspects.size + 1):
        for chosen in combinations(suspects, size):
            yield np.array(chosen, dtype=np.intp)


def log_gross(off: Array, k: Array) -> Array:
    """ln of the density of slopes that are off the curve by such a share, and of being gross."""
    tail = np.log1p((off / (GROSS_SCALE * k)) ** 2)
    return np.asarray(np.log(GROSS_SHARE / np.pi / GROSS_SCALE / k) - tail)


def _members(sets: Sequence[Index], n: int) -> csr_array:
    """(C, n): 1 where a set has a row."""
    ends = np.cumsum([0, *(one.size for one in sets)])
    members = np.concatenate(sets)
    return csr_array((np.ones(members.size), members, ends), (len(sets), n))
