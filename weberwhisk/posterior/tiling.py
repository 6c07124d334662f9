"""Where the mass of a posterior of two unknowns or more can lie: one tiling for each observer.

The signals do not depend on the reading. So the coordinates are cut once into boxes, each so small
that any posterior is smooth on it, whatever the reading: no longer than a few sd of what a reading
tells (by the Fisher information of the receptors) and of what the prior says, less where the noise
changes along it. Gauss–Legendre nodes in a box then integrate any posterior, with one peak or
several, a ridge or an edge. For few readings only those boxes are followed in which one of them may
lie; the boxes themselves are the same.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..observer import Observer
from .likelihood import Boxes, Nodes, Rule, likelihood_of, measured, nodes_of
from .result import Array, Index

#: ln of the share of the prior below which a box is not cut further and, `LEFT_OUT` below that,
#: left out: of all contacts, over the share of an average tile; where readings are followed.
ROUGH, LEFT_OUT, DEEP = -14.0, -6.0, -80.0
#: A box is followed where a reading is (in ln) so far below the best.
NEGLIGIBLE = 18.0
#: Boxes worked on together.
CHUNK = 1024


class TooManyTiles(Exception):
    """More tiles than were allowed: a signal without scale, or too small a share of the prior."""


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
            cut = nodes.bent | (nodes.kink & (mass > -11.0))[:, None]  # where there is some mass
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
        waiting = []
        for i in range(0, len(boxes.low), CHUNK):
            part = Boxes._make(column[i : i + CHUNK] for column in boxes)
            waiting.append(Tiles(part, measured(observer, part)))
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


def _prior_weight(observer: Observer, boxes: Boxes) -> Array:
    """ln of prior and rule at the nodes (n, N) of boxes."""
    rule = Rule.of(boxes.low.shape[1])
    _, log_prior = observer.contact(nodes_of(boxes))
    return np.asarray(
        log_prior + rule.log_weight + np.log(boxes.high - boxes.low).sum(axis=1)[:, None]
    )


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
        # Further, so that what else is followed with a reading changes nothing.
        out[b[top + unseen[b] > best[r] - NEGLIGIBLE - 8.0]] = True
    return out
