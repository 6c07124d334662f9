"""What tiles ask of an observer: the signals at the nodes of boxes, and how long the boxes are.

Of all its unknowns, or of all but the last.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.polynomial.legendre import leggauss, legvander
from numpy.typing import NDArray
from scipy.special import ndtri

from ..mechanics.contact import Outcome
from ..observer import Observer
from .result import Array
from .summed import LastSummed, NotSmooth

#: Nodes along each axis of a tile.
ORDER = 6
#: A reading may lie so many sd from the signals of a box.
WINDOW = 7.0


@dataclass(frozen=True)
class Rule:
    """Gauss–Legendre's product rule on the unit box of d coordinates."""

    points: Array
    log_weight: Array

    @classmethod
    def of(cls, dim: int) -> Rule:
        """The rule with `ORDER` nodes an axis, the last axis running fastest."""
        x, w = leggauss(ORDER)
        points = np.stack(np.meshgrid(*[(x + 1) / 2] * dim, indexing="ij"), axis=-1)
        weight = np.stack(np.meshgrid(*[w / 2] * dim, indexing="ij"), axis=-1).prod(axis=-1)
        return cls(points.reshape(-1, dim), np.log(weight).ravel())


class Boxes(NamedTuple):
    """Boxes (n, d) of the coordinates; their keys put neighbours side by side."""

    low: Array
    high: Array
    key: Array
    span: Array

    def of(self, rows: NDArray[np.bool_]) -> Boxes:
        """Some of them."""
        return Boxes._make(column[rows] for column in self)


class Nodes(NamedTuple):
    """What is known at the nodes of boxes: (n, N, d), (n, N), (n, N, …), and the boxes' readings.

    `log_weight` is ln of prior and rule; `low` and `high` (n, panels, R) bound the readings that a
    box makes plausible; `lengths` (n, d) are those of the boxes, in sd; `kink` (n,) says which
    have one, and `bent` (n, d) along which axes the signals are no polynomial.
    """

    contact: Array
    log_weight: Array
    signals: Array
    low: Array
    high: Array
    lengths: Array
    kink: NDArray[np.bool_]
    bent: NDArray[np.bool_]

    def of(self, rows: NDArray[np.bool_]) -> Nodes:
        """Those of some boxes."""
        return Nodes._make(column[rows] for column in self)


class AllUnknowns:
    """Every unknown has an axis of the tiles; nodes have the signals themselves."""

    panels = 1

    def __init__(self, observer: Observer) -> None:
        self.observer, self.noise = observer, observer.noise
        self.dim = len(observer.unknowns)
        #: Most boxes: 120 000 in two dimensions, 20 000 in three.
        self.most = 720_000 // 6 ** (self.dim - 1)

    def contact(self, x: Array) -> tuple[Array, Array]:
        """Contacts (..., U) at coordinates x, and ln of the prior."""
        return self.observer.contact(x)

    def signals(self, x: Array, contact: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Signals (..., S) of contacts (..., U), and which are held."""
        signals, outcome = self.observer.signals(contact)
        held = outcome == Outcome.HELD
        return np.where(held[..., None], signals, 1.0), np.asarray(held)

    def views(self, signals: Array) -> list[tuple[Array, Array | None]]:
        """The signals; there is nothing left to know."""
        return [(signals, None)]

    def over_views(self, lengths: list[Array]) -> Array:
        """The lengths (n, d) of boxes, of what the views say."""
        return lengths[0]

    def interval(self, signals: Array, width: float) -> tuple[Array, Array]:
        """Between which readings (..., 1, R) lie."""
        low, high = self.noise.interval(signals, width)
        return low[..., None, :], high[..., None, :]

    def log_likelihood(self, reading: Array, signals: Array) -> Array:
        """ln p(reading | contact), (m, N), for readings (m, R) and nodes (m, N, S)."""
        return self.noise.log_likelihood(reading[:, None], signals)


Likelihood = AllUnknowns | LastSummed


@lru_cache(maxsize=64)
def likelihood_of(observer: Observer) -> Likelihood:
    """Of three unknowns and more the last is summed out, where signals are smooth in it.

    Not so of two cues with an unknown each: the last is known by its own cue as well as any is.
    """
    if (
        len(observer.unknowns) < 3
        or observer.unknowns[-1] not in observer.unknowns[observer.bounded :]
    ):
        return AllUnknowns(observer)
    try:
        return LastSummed(observer)
    except NotSmooth:
        return AllUnknowns(observer)


def nodes_of(boxes: Boxes) -> Array:
    """The nodes (n, N, d) of boxes."""
    rule = Rule.of(boxes.low.shape[1])
    return np.asarray(boxes.low[:, None] + (boxes.high - boxes.low)[:, None] * rule.points)


def measured(observer: Observer, boxes: Boxes) -> Nodes:
    """What is known at the nodes of boxes, and how long the boxes are."""
    rule, likelihood = Rule.of(boxes.low.shape[1]), likelihood_of(observer)
    points = nodes_of(boxes)
    contact, log_prior = likelihood.contact(points)
    log_weight = log_prior + rule.log_weight + np.log(boxes.high - boxes.low).sum(axis=1)[:, None]
    signals, held = likelihood.signals(points, contact)
    held &= log_weight > -np.inf
    log_weight = np.where(held, log_weight, -np.inf)
    low, high = _bounds(likelihood, signals, held)
    views = likelihood.views(signals)
    seen = views[0][0]
    partly = held.any(axis=1) & ~held.all(axis=1)
    # A kink or an edge within the box is closed in, as far as there is mass to speak of.
    blind = np.asarray(observer.noise.uninformative(seen)).reshape(*held.shape, -1)
    mixed = np.logical_and(blind.any(axis=1), ~blind.all(axis=1))
    kink = np.asarray(partly | np.any(mixed, axis=1))
    score = prior_scores(observer, contact)
    lengths = likelihood.over_views([_lengths(observer, score, *view, held) for view in views])
    bent = _bent(observer, seen, held)
    return Nodes(contact, log_weight, signals, low, high, lengths, kink, bent)


def _bounds(likelihood: Likelihood, signals: Array, held: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Between which readings (n, panels, R) boxes make plausible lie."""
    low, high = likelihood.interval(signals, WINDOW)
    known = held[..., None, None]
    # The nodes end before the box does: by less than half of what the signals do between two.
    dim = likelihood.dim
    found = []
    for ends, sign in ((low, -1), (high, 1)):
        ends = np.where(known, ends, np.nan)
        grid = ends.reshape(len(ends), *(ORDER,) * dim, *ends.shape[2:])
        beyond = np.zeros((len(ends), *ends.shape[2:]))
        for axis in range(1, dim + 1):
            step = np.abs(np.diff(grid, axis=axis)).reshape(len(ends), -1, *ends.shape[2:])
            beyond = np.maximum(beyond, 0.5 * np.where(np.isnan(step), 0.0, step).max(axis=1))
        end = sign * np.where(known, sign * ends, -np.inf).max(axis=1)
        found.append(end + sign * beyond)
    # Of a box that is partly without contacts the nodes do not say all.
    partly = held.any(axis=1) & ~held.all(axis=1)
    found[0][partly], found[1][partly] = -np.inf, np.inf
    return found[0], found[1]


def _bent(
    observer: Observer, signals: Array, held: NDArray[np.bool_], *, most: float = 0.03
) -> NDArray[np.bool_]:
    """Along which axes (n, d) the signals of boxes are no polynomial, as told by its last terms.

    So it is at the node of a vibration, whose size is felt and not its sign: tilings of two lengths
    may agree there, and both be wrong. `most` is in sd; each halving halves what a kink leaves.
    """
    dim = round(np.log(held.shape[1]) / np.log(ORDER))
    last = np.linalg.inv(legvander(leggauss(ORDER)[0], ORDER - 1))[-2:]
    place, step = observer.noise.resolution(signals)
    scaled = (place / step.min(axis=1, keepdims=True)).reshape(len(held), *(ORDER,) * dim, -1)
    out = np.repeat(np.all(held, axis=1, keepdims=True), dim, axis=1)
    for axis in range(dim):  # by the last two Legendre coefficients
        tail = np.abs(np.moveaxis(scaled, axis + 1, -1) @ last.T).sum(axis=-1)
        out[:, axis] &= tail.reshape(len(held), -1).max(axis=1) > most
    return out


def _lengths(
    observer: Observer,
    score: Array,
    signals: Array,
    slope: Array | None,
    held: NDArray[np.bool_],
) -> Array:
    """Lengths (n, d) of boxes: what a reading and the prior tell along each axis, in sd.

    And 4 for each factor of e in the noise, which bends the density. With the slopes (n, N, S) of
    an unknown that is summed out, what is left to tell where that is not known (Schur complement).
    """
    count, dim = len(score), score.shape[-1]
    shape = (count, *(ORDER,) * dim)
    score = score.reshape(*shape, -1)
    if slope is not None:
        noisier = [np.log(observer.noise.resolution(signals + h * slope)[1]) for h in (1e-3, -1e-3)]
        tilt = ((noisier[0] - noisier[1]) / 2e-3).reshape(*shape, -1)
        slope = slope.reshape(*shape, -1)
    spread = np.log(observer.noise.resolution(signals)[1]).reshape(*shape, -1)
    signals, held = signals.reshape(*shape, -1), held.reshape(shape)
    out = np.empty((count, dim))
    for axis in range(dim):
        edges: list[slice] = [slice(None)] + [slice(0, ORDER, ORDER - 1)] * dim
        edges[axis + 1] = slice(None)
        a, b = (_along(axis + 1, cut, dim) for cut in (slice(1, None), slice(None, -1)))
        own = tuple(edges)
        s, z, w, h = signals[own], score[own], spread[own], held[own]
        both = h[a] & h[b]
        step = np.where(both[..., None], s[a] - s[b], 0.0)
        told = observer.noise.fisher((s[a] + s[b]) / 2)
        square = np.einsum("...i,...ij,...j->...", step, told, step)
        bend = w[a] - w[b]
        if slope is not None:
            d = (slope[own][a] + slope[own][b]) / 2
            of_last = (told @ d[..., None])[..., 0]
            move = (of_last * step).sum(axis=-1) / (1 + (of_last * d).sum(axis=-1))
            square = np.maximum(square - move * (of_last * step).sum(axis=-1), 0.0)
            bend = bend - move[..., None] * (tilt[own][a] + tilt[own][b]) / 2
        square = np.where(both, square, 0.0) + np.square(z[a] - z[b]).sum(axis=-1)
        bend = np.where(both, np.abs(bend).max(axis=-1), 0.0)
        length = (np.sqrt(square) + 4 * bend).sum(axis=axis + 1)
        out[:, axis] = length.reshape(count, -1).max(axis=1)
    ends = Rule.of(1).points
    return np.nan_to_num(out / float(ends[-1, 0] - ends[0, 0]), nan=np.inf, posinf=np.inf)


def _along(axis: int, cut: slice, dim: int) -> tuple[slice, ...]:
    """A cut along one axis of (n, …)."""
    return tuple(cut if i == axis else slice(None) for i in range(dim + 1))


def prior_scores(observer: Observer, contact: Array) -> Array:
    """How far up its prior each unknown is, as standard normal scores (..., U) within ±9."""
    out = np.empty(contact.shape)
    for i, name in enumerate(observer.unknowns[: contact.shape[-1]]):
        value = contact[..., i]
        if name in observer.prior and hasattr(observer.prior[name], "sf"):
            below, above = observer.prior[name].cdf(value), observer.prior[name].sf(value)
        else:
            low, top = observer.reach
            size = np.asarray(top - low)
            if i:
                low, size = observer.space.angle_range(contact[..., 0])
                size = np.maximum(size, np.finfo(float).tiny)
            below = (value - low) / size
            above = (low + size - value) / size
        with np.errstate(divide="ignore"):
            lower, upper = ndtri(np.clip(below, 0, 1)), -ndtri(np.clip(above, 0, 1))
        out[..., i] = np.clip(np.where(below < above, lower, upper), -9.0, 9.0)
    return out
