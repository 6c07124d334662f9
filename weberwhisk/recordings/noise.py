"""The noise of a table of contacts, learnt where nobody gave it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import fmin
from scipy.special import logsumexp

from .. import domain
from .._util.values import Array, Index
from ..cues import Cue
from ..inference import Observer, default_noise
from ..inference.coordinates import unconstrain_distance
from ..receptors import GeneralisedWeber, ReceptorNoise, Weber

#: Belief about the Weber fraction of a table's signals: median, and sd of its ln. Forces on real
#: tracked whiskers needed 0.2 to 0.3, simulated receptors have 0.1.
USUAL, SPREAD = 0.2, 0.7
#: Contacts along either axis on which noise is learnt, and rows from which it is.
LATTICE, ROWS = 64, 48

__all__ = ["Lattice", "Learnt", "curvature_at", "learn", "scaled"]


class Learnt(NamedTuple):
    """Factors (J, S) of a cue's default noise, each as likely, and what rows of a touch share.

    `independent` is the share of the variance that differs from row to row of a touch; `said`
    names what the factors were learnt from, "" for the prior alone.
    """

    factors: Array
    independent: float = 1.0
    said: str = ""

    def exponent(self, rows: Array) -> Array:
        """The power of the likelihood of touches of so many rows, where part of it is common.

        A mean of n rows has the variance (1 − u) + u/n of one row's, u being independent.
        """
        return np.asarray(1 / (rows * (1 - self.independent) + self.independent))


def scaled(whisker: Any, cue: Cue, factor: Array) -> ReceptorNoise:
    """The cue's default noise, that of each signal times a factor (S,)."""
    return _times(default_noise(whisker, cue), factor)


def _times(usual: Any, factor: Array) -> ReceptorNoise:
    k = usual.weber_fractions(len(factor)) * factor
    if isinstance(usual, Weber):
        return Weber(k, correlation=usual.correlation)
    floor = usual.floors(len(factor)) * factor
    return GeneralisedWeber(k, floor=floor, correlation=usual.correlation)


class Lattice:
    """Contacts all over the reach: their signals, whatever the noise, and the prior's mass."""

    def __init__(self, observer: Observer) -> None:
        self.observer, space = observer, observer.space
        far = float(unconstrain_distance(np.array(0.995)))
        x = np.linspace(-far, far, LATTICE)
        fractions = 0.5 + np.tanh(np.sinh(x) / 2) / 2
        at = space.spread(fractions, others=5)
        shape = (LATTICE,) * observer.bounded + (5,) * (at.shape[1] - observer.bounded)
        axes = at.reshape(*shape, -1)
        with np.errstate(all="ignore"):
            contact, log = observer.contact(at)
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
        """ln of sums over contacts of one distance, (B, LATTICE)."""
        top = log.max(axis=1, keepdims=True)
        first = np.flatnonzero(np.diff(self.layer, prepend=-1))
        out = np.full((len(log), LATTICE), -np.inf)
        with np.errstate(divide="ignore"):
            sums = np.log(np.add.reduceat(np.exp(log - top), first, axis=1)) + top
        out[:, self.layer[first]] = sums
        return out

    def layers(self, y: Array, factor: Array) -> Array:
        """ln of the density of readings (B, S) and distance, (B, LATTICE)."""
        noise = _times(self.observer.noise, factor)
        return self._summed(noise.log_likelihood(y[:, None], self.signals) + self.log_prior)


def curvature_at(log: Callable[[Array], Any], x: Array, step: float) -> Array:
    """Second derivatives (D, D) of a function of points (..., D), by differences."""
    e = step * np.eye(len(x))
    pairs = [np.array([[log(x + s * a + t * b) for b in e] for a in e])
             for s, t in ((1, 1), (1, -1), (-1, 1), (-1, -1))]  # fmt: skip
    out = (pairs[0] - pairs[1] - pairs[2] + pairs[3]) / (4 * step**2)
    return np.asarray((out + out.T) / 2)


def learn(
    members: Sequence[Sequence[tuple[Index, Observer]]], log_prior: Array, y: Array, touch: Index,
) -> Learnt:  # fmt: skip
    """What a table tells of its noise: by redundant signals, and by how rows of a touch agree.

    Parameters
    ----------
    members : sequence of sequences of (rows, observer)
        For each whisker that there may be, its rows of either side.
    log_prior : array, shape (N,)
        Of the members.
    y : array, shape (n, S)
    touch : array of int, shape (n,)
        −1 in none.

    Notes
    -----
    Rows of one touch have their noise in common as far as is known (a wrong direction of the force,
    say): together they count as one. How they scatter about one distance is then the least that
    the noise can be, whatever is common; that it is so much larger is as likely on a log scale.
    """
    observer, size = members[0][0][1], y.shape[1]
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
    lattices = [[(np.flatnonzero(np.isin(rows, own)), Lattice(o)) for own, o in member]
                for member in members]  # fmt: skip

    def evidence(factor: Array) -> tuple[Array, Array]:
        """ln of that of each row (B,), and of each touch of several over its rows'."""
        each, both = [], []
        for member in lattices:
            layers = np.full((len(rows), LATTICE), -np.inf)
            prior = np.zeros((len(rows), LATTICE))
            for own, lattice in member:
                layers[own] = lattice.layers(y[rows[own]], np.exp(factor))
                prior[own] = lattice.prior
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
        share = np.exp(log_prior - logsumexp(log_prior))[:, None]
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
    """Rows from which noise is learnt: of touches all over the table, up to eight of each."""
    good = np.flatnonzero(np.isfinite(y).all(axis=1) & (y != 0).all(axis=1))
    unit = np.where(touch[good] >= 0, touch[good], -1 - good)
    groups = [good[unit == u] for u in dict.fromkeys(unit.tolist())]
    groups = [g[:: 1 + (len(g) - 1) // 8] for g in groups]
    many = sum(map(len, groups))
    kept = groups[:: 1 + (many - 1) // ROWS] if groups else []
    return np.sort(np.concatenate(kept)) if kept else good


def _star(middle: Array, covariance: Array, usual: Array) -> Array:
    """Factors (2S, S) whose logarithms have this mean and covariance, within the domain of k."""
    root = np.sqrt(len(middle)) * np.linalg.cholesky(covariance).T
    most = domain.WEBER_FRACTIONS[1] / usual.max(initial=1e-300)
    return np.minimum(np.exp(np.concatenate([middle + root, middle - root])), most)
