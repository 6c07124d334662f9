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

from ..mechanics.contact import Outcome
from ..observer import Observer
from .result import Array, Index
from .summed import LastCurve, LastLattice, NotSmooth, Peak, Quadratic

#: Nodes along each axis of a tile.
ORDER = 6


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


class LastSummed:
    """What tiles ask of an observer's contacts, the last unknown being summed out.

    Nodes have the `parts` (..., S, D) of their signals. `panels` are so many parts of the range of
    the last unknown, of each of which a box says what readings it makes plausible.
    """

    panels = 8

    def __init__(self, observer: Observer) -> None:
        self.observer, self.noise = observer, observer.noise
        self.dim = len(observer.unknowns) - 1
        #: Most boxes, beyond which a plain grid is quicker.
        self.most = 24_000 // 4 ** (self.dim - 1)
        self.lattice = LastLattice(observer)

    def contact(self, x: Array) -> tuple[Array, Array]:
        """Contacts (..., U − 1) at coordinates x, of the last unknown's middle; ln of the prior."""
        if not self.lattice.turns:
            return self.observer.contact(x)
        contact, log_prior = self.lattice.contact(x)
        return contact[..., :-1], log_prior

    def signals(self, x: Array, contact: Array) -> tuple[Array, NDArray[np.bool_]]:
        """The parts (..., S, D) of the signals at coordinates (..., U − 1), and which are held."""
        lattice, flat = self.lattice, x.reshape(-1, self.dim)
        parts, held = lattice.parts(flat)
        shape = x.shape[:-1]
        return parts.reshape(*shape, *parts.shape[1:]), held.reshape(shape)

    def views(self, parts: Array) -> list[tuple[Array, Array | None]]:
        """Signals (..., S) at three places of the last unknown, and their slopes."""
        lattice = self.lattice
        parts = parts[..., : lattice.size, :]
        return [
            (parts @ lattice.basis(np.array(z)), parts @ lattice.slope(z)) for z in (0.0, -2.0, 2.0)
        ]

    def over_views(self, lengths: list[Array]) -> Array:
        """The lengths (n, d) of boxes, of what the views say: the most.

        Friction turns the sign of a force, which at one friction angle bends the density at one
        contact, at another elsewhere, and not at all once the friction is summed out: the middle.
        """
        return np.asarray((np.median if self.lattice.turns else np.max)(lengths, axis=0))

    def interval(self, parts: Array, width: float) -> tuple[Array, Array]:
        """Between which readings (..., panels, R) lie, of each panel."""
        ends = self.lattice.basis(np.linspace(-1, 1, 2 * self.panels + 1) * self.lattice.reach)
        signals = np.einsum("...sd,ed->...es", parts[..., : self.lattice.size, :], ends)
        low, high = self.noise.interval(signals, width)
        cut = [slice(i, i + 2 * self.panels - 1 + (i > 1), 2) for i in range(3)]
        low = np.minimum.reduce([low[..., c, :] for c in cut])
        return low, np.maximum.reduce([high[..., c, :] for c in cut])

    def curve(self, reading: Array, parts: Array) -> LastCurve:
        """ln of the density of the last unknown, for readings (m, R) and nodes (m, N, S, D)."""
        if self.lattice.quadratic:
            signals = parts @ self.lattice.unit
            scales = self.lattice.scales
            told = (self.noise.log_likelihood(c * reading[:, None], signals) for c in scales)
            return Quadratic(self.lattice, *told)
        return LastCurve(self.lattice, reading, parts)

    def search(self, curve: LastCurve, low: Index, high: Index, width: Array, count: int) -> Peak:
        """The bumps of curves (m, N) between panels (m,), about as wide as (m,).

        Told by samples of each, from the best of which Newton's method goes on. A second bump that
        counts is within reach.
        """
        lattice, samples = self.lattice, 6
        size = 2 * lattice.half / self.panels
        share = (np.arange(samples) + 0.5) / samples
        at = 1 + size * (low[:, None] + (high + 1 - low)[:, None] * share)
        seen = np.broadcast_to(at.astype(np.intp)[:, None], (len(low), count, samples))
        log = curve(seen)
        index = np.take_along_axis(seen, log.argmax(axis=-1)[..., None], axis=-1)[..., 0]
        # Of bumps narrower than samples are apart, closer samples about the best.
        apart = size * (high + 1 - low) / samples
        about = np.linspace(-1, 1, 9)
        while (apart > 2 * width / lattice.step).any():
            closer = lattice.at((index[..., None] + apart[:, None, None] * about).astype(np.intp))
            best = curve(closer).argmax(axis=-1)[..., None]
            index, apart = np.take_along_axis(closer, best, axis=-1)[..., 0], apart / 4
        peak = self.climb(curve, index, width, 3)
        far = np.abs(seen - peak.place[..., None]) * lattice.step
        far = np.where(log > peak.height[..., None] - 12, far, 0.0).max(axis=-1)
        return peak._replace(reach=np.maximum(peak.reach, far + 2 * peak.width))

    def climb(self, curve: LastCurve, index: Index, width: Array, steps: int) -> Peak:
        """The bumps (m, N) near indices, about as wide as (m,), by Newton's method."""
        lattice = self.lattice
        stride = np.maximum(1, (0.7 * width / lattice.step).astype(np.intp))[:, None]
        three = stride[..., None] * np.arange(-1, 2)
        for _ in range(steps):
            index = np.minimum(np.maximum(index, 1 + stride), 2 * lattice.half + 1 - stride)
            log = curve(index[..., None] + three)
            below, middle, above = log[..., 0], log[..., 1], log[..., 2]
            with np.errstate(invalid="ignore"):
                rise, bend = (above - below) / 2, 2 * middle - below - above
            if not np.isfinite(rise).all():
                rise, bend = np.nan_to_num(rise, posinf=9, neginf=-9), np.nan_to_num(bend, nan=1.0)
            bend = np.minimum(np.maximum(bend, 0.02), 50.0)
            move = np.minimum(np.maximum(rise / bend, -4.0), 4.0)
            index = index + np.rint(move * stride).astype(np.intp)
        found = np.minimum(stride * lattice.step * bend**-0.5, 1.0)
        # Of a bump that is found the rise is little; more is of one that the lattice does not show.
        return Peak(index, found, middle + np.clip(rise * move / 2, 0.0, 8.0), 5 * found)

    def log_likelihood(self, reading: Array, parts: Array) -> Array:
        """ln p(reading | the other unknowns), (m, N), about: of bumps taken for Gaussian."""
        m, count = parts.shape[:2]
        low = np.zeros(m, dtype=np.intp)
        width = self.widths(parts).min(axis=1)
        peak = self.search(self.curve(reading, parts), low, low + self.panels - 1, width, count)
        return np.asarray(peak.height + np.log(peak.width) + 0.5 * np.log(2 * np.pi))

    def widths(self, parts: Array) -> Array:
        """The least of the bumps' widths (...) at three places, as far as the lattice shows."""
        least = np.minimum.reduce([self.lattice.widths(parts, z) for z in (0.0, -2.0, 2.0)])
        return np.maximum(least, 2 * self.lattice.step)


Likelihood = AllUnknowns | LastSummed


@lru_cache(maxsize=64)
def likelihood_of(observer: Observer) -> Likelihood:
    """Of three unknowns and more the last is summed out, where signals are smooth in it.

    Not so of two cues with an unknown each, nor of the azimuth of a curved whisker's contact: the
    last is known by its own signals as well as any is.
    """
    if (
        len(observer.unknowns) < 3
        or observer.forward.azimuth is not None
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
    score = observer.space.prior_scores(contact)
    lengths = likelihood.over_views([_lengths(observer, score, *view, held) for view in views])
    bent = _bent(observer, seen, held)
    return Nodes(contact, log_weight, signals, low, high, lengths, kink, bent)


def _bounds(likelihood: Likelihood, signals: Array, held: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Between which readings (n, panels, R) boxes make plausible lie."""
    low, high = likelihood.interval(signals, 7.0)  # a reading may lie so many sd from a box
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
