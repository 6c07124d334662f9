"""Where the mass of a posterior of two unknowns or more can lie: one tiling for each observer.

The signals do not depend on the reading. So the coordinates are cut once into boxes, each so small
that any posterior is smooth on it, whatever the reading: no longer than a few sd of what a reading
tells (by the Fisher information of the receptors) and of what the prior says, less where the noise
changes along it. Gauss–Legendre nodes in a box then integrate any posterior, with one peak or
several, a ridge or an edge. For few readings only those boxes are followed in which one of them may
lie; the boxes themselves are the same.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.polynomial.legendre import leggauss, legvander
from numpy.typing import NDArray
from scipy.special import ndtri

from ..observer import Observer
from .likelihood import Likelihood, likelihood_of

Array = NDArray[np.float64]
Index = NDArray[np.intp]

#: Nodes along each axis of a tile.
ORDER = 6
#: ln of the share of the prior below which a box is not cut further and, `LEFT_OUT` below that,
#: left out: of all contacts, over the share of an average tile; where readings are followed.
ROUGH, LEFT_OUT, DEEP = -14.0, -6.0, -80.0
#: ln of the share of the prior down to which a kink or an edge is closed in.
KINK = -11.0
#: A reading may lie so many sd from the signals of a box, and (in ln) so far below the best.
WINDOW, NEGLIGIBLE = 7.0, 18.0
#: Tiles are followed further, so that what else is followed with a reading changes nothing.
SAFE = 8.0
#: Boxes worked on together.
CHUNK = 1024


_TAIL = np.linalg.inv(legvander(leggauss(ORDER)[0], ORDER - 1))[-2:]


class TooManyTiles(Exception):
    """More tiles than were allowed: a signal without scale, or too small a share of the prior."""


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


class Tiles(NamedTuple):
    """The tiles of an observer, or of some of its readings, side by side."""

    boxes: Boxes
    nodes: Nodes


def tiles_of(
    observer: Observer,
    length: float,
    reading: Array | None = None,
    *,
    most: int | None = None,
    everywhere: bool = False,
    deep: bool = True,
) -> Tiles:
    """The tiles of all contacts, or of those that some readings (B, R) may come from.

    Parameters
    ----------
    observer : Observer
    length : float
        Longest tile, in sd.
    reading : array, shape (B, R), optional
    most : int, optional
        Most boxes; by default what the likelihood says.
    everywhere : bool
        Look for readings far from all contacts, too.
    deep : bool
        Follow readings where hardly any of the prior is, as a whole tiling does not.

    Raises
    ------
    TooManyTiles
        Where it would take more.
    """
    total, likelihood = trunk_mass(observer), likelihood_of(observer)
    most = most or likelihood.most
    deep = deep and reading is not None
    rough = DEEP if deep else ROUGH - np.log(expected_tiles(observer, length))
    best = None if reading is None else np.full(len(reading), -np.inf)
    kept: list[Tiles] = []
    level = _trunk(observer)
    count = 0
    waiting = [Tiles(level.boxes, level.nodes)]
    while waiting:
        following: list[Boxes] = []
        for tiles in waiting:
            boxes, nodes = tiles
            live = nodes.log_weight.max(axis=1) > total + rough + LEFT_OUT
            if reading is not None:
                assert best is not None
                live &= _followed(observer, nodes, reading, best, everywhere)
            boxes, nodes = boxes.of(live), nodes.of(live)
            parts = np.clip(np.ceil(nodes.lengths / length), 1, 4).astype(np.intp)
            mass = nodes.log_weight.max(axis=1) - total
            cut = nodes.bent | (nodes.kink & (mass > KINK))[:, None]
            parts[cut] = np.maximum(parts[cut], 2)
            parts[boxes.high - boxes.low < 1e-6] = 1
            parts[mass < rough] = 1
            whole = (parts == 1).all(axis=1)
            kept.append(Tiles(boxes.of(whole), nodes.of(whole)))
            following.append(_split(boxes.of(~whole), parts[~whole]))
            count += int(whole.sum())
        boxes = Boxes._make(np.concatenate(column) for column in zip(*following, strict=True))
        if count + len(boxes.low) > most:
            raise TooManyTiles
        waiting = [
            Tiles(part, measured(observer, part))
            for part in (
                Boxes._make(column[i : i + CHUNK] for column in boxes)
                for i in range(0, len(boxes.low), CHUNK)
            )
        ]
    boxes = Boxes._make(np.concatenate(c) for c in zip(*(t.boxes for t in kept), strict=True))
    nodes = Nodes._make(np.concatenate(c) for c in zip(*(t.nodes for t in kept), strict=True))
    order = np.argsort(boxes.key, kind="stable")
    return Tiles(
        Boxes._make(column[order] for column in boxes),
        Nodes._make(column[order] for column in nodes),
    )


def _split(boxes: Boxes, parts: Index) -> Boxes:
    """Each box cut into so many parts (n, d) along each axis."""
    dim = boxes.low.shape[1]
    out = [Boxes(np.empty((0, dim)), np.empty((0, dim)), np.empty(0), np.empty(0))]
    for number in np.unique(parts, axis=0):
        some = boxes.of((parts == number).all(axis=1))
        place = np.array(list(product(*map(range, number))))
        step = (some.high - some.low) / number
        low = some.low[:, None] + step[:, None] * place
        high = np.where(place + 1 == number, some.high[:, None], low + step[:, None])
        span = some.span / len(place)
        key = some.key[:, None] + span[:, None] * np.arange(len(place))
        out.append(
            Boxes(
                low.reshape(-1, dim),
                high.reshape(-1, dim),
                key.ravel(),
                np.repeat(span, len(place)),
            )
        )
    return Boxes._make(np.concatenate(column) for column in zip(*out, strict=True))


@lru_cache(maxsize=64)
def _trunk(observer: Observer) -> Tiles:
    """The first boxes, of those whose prior is not nothing, and what is known at their nodes."""
    dim, bounded = likelihood_of(observer).dim, observer.bounded
    steps = (0.5, 1.0) if dim == len(observer.unknowns) == 2 else (1.0, 1.5)
    r_edges = np.linspace(-4.0, 4.2, round(8.2 / steps[0]) + 1)
    axes = [r_edges]
    if bounded > 1:
        # From hardly any of the range of angles to all but nothing of it, at any distance.
        x = np.zeros((65, dim))
        x[:, 0] = np.linspace(-4.0, 4.2, 65)
        r = observer.contact(x)[0][:, 0]
        low, width = observer.space.angle_range(r)
        r, width = r[width > 0], width[width > 0]
        least = 1e-15 if low > 0 else 1e-24
        ends = [
            observer.coordinates(np.stack([r, low + width * f], axis=-1))[:, 1]
            for f in (least, 1 - 1e-10)
        ]
        start, stop = ends[0].min(), ends[1][np.isfinite(ends[1])].max()
        axes.append(np.linspace(start, stop, int(np.ceil((stop - start) / steps[1])) + 1))
    axes += [np.linspace(-8.0, 8.0, 9 if dim == 2 else 3)] * (dim - bounded)
    corner = [
        np.stack(np.meshgrid(*side, indexing="ij"), axis=-1).reshape(-1, dim)
        for side in ([a[:-1] for a in axes], [a[1:] for a in axes])
    ]
    count = len(corner[0])
    boxes = Boxes(corner[0], corner[1], np.arange(count, dtype=float), np.ones(count))
    parts = []
    for i in range(0, count, CHUNK):
        some = Boxes._make(column[i : i + CHUNK] for column in boxes)
        some = some.of(_prior_weight(observer, some).max(axis=1) > -200.0)
        parts.append(Tiles(some, measured(observer, some)))
    return Tiles(
        Boxes._make(np.concatenate(c) for c in zip(*(t.boxes for t in parts), strict=True)),
        Nodes._make(np.concatenate(c) for c in zip(*(t.nodes for t in parts), strict=True)),
    )


def prior_box(observer: Observer) -> tuple[Array, Array]:
    """Ends (U,) of the coordinates between which the prior is not nothing."""
    boxes = _trunk(observer).boxes
    further = [6.0] * (len(observer.unknowns) - boxes.low.shape[1])
    low, high = boxes.low.min(axis=0), boxes.high.max(axis=0)
    return np.append(low, np.negative(further)), np.append(high, further)


@lru_cache(maxsize=64)
def trunk_mass(observer: Observer) -> float:
    """ln of the prior's integral, about."""
    return float(np.logaddexp.reduce(_trunk(observer).nodes.log_weight, axis=None))


def expected_tiles(observer: Observer, length: float) -> float:
    """About how many tiles all contacts take."""
    nodes = _trunk(observer).nodes
    live = nodes.log_weight.max(axis=1) > trunk_mass(observer) - 23.0
    return float(np.maximum(nodes.lengths[live] / length, 1.0).prod(axis=1).sum())


def _points(boxes: Boxes) -> Array:
    """The nodes (n, N, d) of boxes."""
    rule = Rule.of(boxes.low.shape[1])
    return np.asarray(boxes.low[:, None] + (boxes.high - boxes.low)[:, None] * rule.points)


def _prior_weight(observer: Observer, boxes: Boxes) -> Array:
    """ln of prior and rule at the nodes (n, N) of boxes."""
    rule = Rule.of(boxes.low.shape[1])
    _, log_prior = observer.contact(_points(boxes))
    return np.asarray(
        log_prior + rule.log_weight + np.log(boxes.high - boxes.low).sum(axis=1)[:, None]
    )


def measured(observer: Observer, boxes: Boxes) -> Nodes:
    """What is known at the nodes of boxes, and how long the boxes are."""
    rule, likelihood = Rule.of(boxes.low.shape[1]), likelihood_of(observer)
    points = _points(boxes)
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
    place, step = observer.noise.resolution(signals)
    scaled = (place / step.min(axis=1, keepdims=True)).reshape(len(held), *(ORDER,) * dim, -1)
    out = np.repeat(np.all(held, axis=1, keepdims=True), dim, axis=1)
    for axis in range(dim):  # by the last two Legendre coefficients
        tail = np.abs(np.moveaxis(scaled, axis + 1, -1) @ _TAIL.T).sum(axis=-1)
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


def _followed(
    observer: Observer, nodes: Nodes, reading: Array, best: Array, everywhere: bool
) -> NDArray[np.bool_]:
    """In which boxes (n,) one of the readings may lie; updates ln of the most (B,) seen in one.

    A peak between the nodes may be higher than they are by what the distance to the next of them,
    in sd, says. (Half of it would do were signals linear: in boxes of a hundred sd they are not,
    and the end of a ridge was lost, 0.1 sd of the mean, by tiles of any length.)
    """
    y = reading[:, None, None]
    near = ((nodes.low <= y) & (y <= nodes.high)).all(axis=-1).any(axis=-1)
    row, box = np.nonzero(near | everywhere)
    likelihood = likelihood_of(observer)
    out = np.zeros(len(nodes.low), dtype=bool)
    step = max(1, 400_000 // nodes.log_weight.shape[1])
    widest = np.diff(Rule.of(1).points[:, 0]).max()
    unseen = 0.5 * np.square(np.minimum(nodes.lengths, 1e6) * widest).sum(axis=1)
    for i in range(0, len(row), step):
        r, b = row[i : i + step], box[i : i + step]
        log = likelihood.log_likelihood(reading[r], nodes.signals[b])
        top = (log + nodes.log_weight[b]).max(axis=1)
        np.maximum.at(best, r, top)
        out[b[top + unseen[b] > best[r] - NEGLIGIBLE - SAFE]] = True
    return out
