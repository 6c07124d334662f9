"""Where the mass of a posterior of two unknowns or more can lie: one tiling for each observer.

The signals do not depend on the reading. So the coordinates are cut once into boxes, each so small
that any posterior is smooth on it, whatever the reading: no longer than a few sd of what a reading
tells (by the Fisher information of the receptors) and of what the prior says, less where the noise
changes along it. Gauss–Legendre nodes in a box then integrate any posterior, with one peak or
several, a ridge or an edge. For few readings only those boxes are followed in which one of them may
lie; the boxes themselves are the same.
"""

from __future__ import annotations

from functools import lru_cache, partial
from typing import Any, NamedTuple

import numpy as np
from numpy.polynomial.legendre import leggauss, legvander
from numpy.typing import NDArray

from .._values import Array, Flags, Index
from ..threads import on_threads
from .observer import Observer
from .result import among, joined
from .summed import AllUnknowns, Likelihood, likelihood_of, within

#: Nodes along each axis of a tile.
ORDER = 6


@lru_cache
def rule(dim: int) -> tuple[Array, Array]:
    """Nodes (N, d) of Gauss–Legendre's product rule on the unit box, and ln of its weights.

    `ORDER` nodes an axis, the last axis running fastest.
    """
    x, w = leggauss(ORDER)
    points = np.stack(np.meshgrid(*[(x + 1) / 2] * dim, indexing="ij"), axis=-1)
    weight = np.stack(np.meshgrid(*[w / 2] * dim, indexing="ij"), axis=-1).prod(axis=-1)
    return points.reshape(-1, dim), np.log(weight).ravel()


class Boxes(NamedTuple):
    """Boxes (n, d) of the coordinates; their keys put neighbours side by side."""

    low: Array
    high: Array
    key: Array
    span: Array


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
    kink: Flags
    bent: Flags


def nodes_of(boxes: Boxes) -> Array:
    """The nodes (n, N, d) of boxes."""
    points, _ = rule(boxes.low.shape[1])
    return np.asarray(boxes.low[:, None] + (boxes.high - boxes.low)[:, None] * points)


def _weighted(log_prior: Array, boxes: Boxes) -> Array:
    """ln of prior and rule at the nodes (n, N) of boxes."""
    size = np.log(boxes.high - boxes.low).sum(axis=1)
    return np.asarray(log_prior + rule(boxes.low.shape[1])[1] + size[:, None])


def measured(observer: Observer, boxes: Boxes) -> Nodes:
    """What is known at the nodes of boxes, and how long the boxes are."""
    likelihood, points = likelihood_of(observer), nodes_of(boxes)
    contact, log_prior = likelihood.contact(points)
    log_weight = _weighted(log_prior, boxes)
    signals, held = likelihood.signals(points, contact)
    signals[held & (log_weight == -np.inf)] = 1.0  # no angle is left there, and so no signal
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
    for leap in observer.space.leaps.get("deflection_angle", ()):
        least, largest = (f(contact[..., 1], axis=1) for f in (np.min, np.max))
        beyond = 0.1 * (largest - least)  # the nodes end before the box does
        kink |= (least - beyond < leap) & (leap < largest + beyond)
    score = observer.space.prior_scores(contact)
    each = [_lengths(observer, score, *view, held) for view in views]
    # Friction turns the sign of a force, which at one friction angle bends the density at one
    # contact, at another elsewhere, and not at all once the friction is summed out: the middle.
    lengths = np.asarray((np.median if likelihood.turns else np.max)(each, axis=0))
    bent = _bent(observer, seen, held)
    return Nodes(contact, log_weight, signals, low, high, lengths, kink, bent)


def _bounds(likelihood: Likelihood, signals: Array, held: Flags) -> tuple[Array, Array]:
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


def _bent(observer: Observer, signals: Array, held: Flags, *, most: float = 0.03) -> Flags:
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
    held: Flags,
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

        def lines(values: NDArray[Any], axis: int = axis) -> NDArray[Any]:
            """Along the axis, where it meets the first and the last nodes of the others."""
            ends = (slice(0, ORDER, ORDER - 1),) * (dim - 1)
            return np.moveaxis(values, axis + 1, 1)[:, :, *ends]

        s, z, w, h = map(lines, (signals, score, spread, held))
        both = h[:, 1:] & h[:, :-1]
        step = np.where(both[..., None], np.diff(s, axis=1), 0.0)
        told = observer.noise.fisher((s[:, 1:] + s[:, :-1]) / 2)
        square = np.einsum("...i,...ij,...j->...", step, told, step)
        bend = np.diff(w, axis=1)
        if slope is not None:
            d, t = ((v[:, 1:] + v[:, :-1]) / 2 for v in map(lines, (slope, tilt)))
            of_last = (told @ d[..., None])[..., 0]
            move = (of_last * step).sum(axis=-1) / (1 + (of_last * d).sum(axis=-1))
            square = np.maximum(square - move * (of_last * step).sum(axis=-1), 0.0)
            bend = bend - move[..., None] * t
        square = np.where(both, square, 0.0) + np.square(np.diff(z, axis=1)).sum(axis=-1)
        bend = np.where(both, np.abs(bend).max(axis=-1), 0.0)
        length = (np.sqrt(square) + 4 * bend).sum(axis=1)
        out[:, axis] = length.reshape(count, -1).max(axis=1)
    ends = rule(1)[0]
    return np.nan_to_num(out / float(ends[-1, 0] - ends[0, 0]), nan=np.inf, posinf=np.inf)


#: ln of the share of the prior below which a box is not cut further and, `LEFT_OUT` below that,
#: left out: of all contacts, over the share of an average tile; where readings are followed.
ROUGH, LEFT_OUT, DEEP = -14.0, -6.0, -80.0


def negligible(length: float) -> float:
    """What is so far below the best, in ln, is nothing to tiles of a length, in sd.

    13 at 5.5 sd, which leaves 1e-4 of an sd at most, 15 at 4.4, which leaves 1e-5.
    """
    return min(23.0 - length / 0.55, 18.0)


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

    None is longer than `length`, in sd, and there are no more than `most` (what the likelihood
    says), or it raises `TooManyTiles`. Looks `everywhere` for readings far from all contacts too;
    `deep` follows them where hardly any of the prior is, as a whole tiling does not.
    """
    total, likelihood = trunk_mass(observer), likelihood_of(observer)
    most = most or likelihood.most
    deep = deep and reading is not None
    rough = DEEP if deep else _rough(observer, length)
    best = None if reading is None else np.full(len(reading), -np.inf)
    kept: list[Tiles] = []
    level = trunk(observer)
    count = 0
    waiting = [Tiles(level.boxes, level.nodes)]
    while waiting:
        following: list[Boxes] = []
        for tiles in waiting:
            boxes, nodes = tiles
            live = nodes.log_weight.max(axis=1) > total + rough + LEFT_OUT
            if reading is not None:
                assert best is not None
                live &= _followed(observer, nodes, reading, best, everywhere, length)
            boxes, nodes = among(boxes, live), among(nodes, live)
            parts = np.clip(np.ceil(nodes.lengths / length), 1, 4).astype(np.intp)
            mass = nodes.log_weight.max(axis=1) - total
            cut = nodes.bent | (nodes.kink & (mass > -11.0))[:, None]  # where there is some mass
            parts[cut] = np.maximum(parts[cut], 2)
            parts[boxes.high - boxes.low < 1e-6] = 1
            parts[mass < rough] = 1
            whole = (parts == 1).all(axis=1)
            kept.append(Tiles(among(boxes, whole), among(nodes, whole)))
            following.append(_split(among(boxes, ~whole), parts[~whole]))
            count += int(whole.sum())
        boxes = joined(following)
        if count + len(boxes.low) > most:
            raise TooManyTiles
        parts_of = [among(boxes, slice(i, i + CHUNK)) for i in range(0, len(boxes.low), CHUNK)]
        found = on_threads(partial(measured, observer), parts_of)
        waiting = list(map(Tiles, parts_of, found))
    boxes, nodes = joined([t.boxes for t in kept]), joined([t.nodes for t in kept])
    order = np.argsort(boxes.key, kind="stable")
    return Tiles(among(boxes, order), among(nodes, order))


def _split(boxes: Boxes, parts: Index) -> Boxes:
    """Each box cut into so many parts (n, d) along each axis."""
    count = parts.prod(axis=1)
    whose = np.repeat(np.arange(len(parts)), count)
    number = np.arange(len(whose)) - np.repeat(np.cumsum(count) - count, count)
    place, left = np.empty((len(whose), parts.shape[1]), dtype=np.intp), number
    for axis in reversed(range(parts.shape[1])):
        left, place[:, axis] = np.divmod(left, parts[whose, axis])
    step = ((boxes.high - boxes.low) / parts)[whose]
    low = boxes.low[whose] + step * place
    high = np.where(place + 1 == parts[whose], boxes.high[whose], low + step)
    span = (boxes.span / count)[whose]
    return Boxes(low, high, boxes.key[whose] + span * number, span)


@lru_cache(maxsize=64)
def trunk(observer: Observer) -> Tiles:
    """The first boxes, of those whose prior is not nothing, and what is known at their nodes."""
    dim, bounded = likelihood_of(observer).dim, observer.bounded
    steps = (0.5, 1.0) if dim == len(observer.unknowns) == 2 else (1.0, 1.5)
    r_edges = np.linspace(-4.0, 4.2, round(8.2 / steps[0]) + 1)
    if (leaps := observer.space.leaps.get("radial_distance")) is not None:
        r_edges = np.union1d(r_edges, np.clip(observer.space.unconstrain_one(leaps, 0), -4.0, 4.2))
    axes = [r_edges]
    if bounded > 1:
        # From hardly any of the range of angles to all but nothing of it, at any distance.
        x = np.zeros((65, dim))
        x[:, 0] = np.linspace(-4.0, 4.2, 65)
        r = observer.contact(x)[0][:, 0]
        low, width = observer.space.angle_range(r)
        r, width = r[width > 0], width[width > 0]
        least = 1e-15 if low > 0 else 1e-24
        with np.errstate(divide="ignore"):  # rounding may leave no range
            ends = [
                observer.coordinates(np.stack([r, low + width * f], axis=-1))[:, 1]
                for f in (least, 1 - 1e-10)
            ]
        first, last = (end[np.isfinite(end)] for end in ends)
        start, stop = first.min(), last.max()
        axes.append(np.linspace(start, stop, int(np.ceil((stop - start) / steps[1])) + 1))
    axes += [np.linspace(-8.0, 8.0, 9 if dim == 2 else 3)] * (dim - bounded)
    corner = [
        np.stack(np.meshgrid(*side, indexing="ij"), axis=-1).reshape(-1, dim)
        for side in ([a[:-1] for a in axes], [a[1:] for a in axes])
    ]
    count = len(corner[0])
    boxes = Boxes(corner[0], corner[1], np.arange(count, dtype=float), np.ones(count))
    boxes = _as_sharp_as_priors(observer, boxes)
    parts = []
    for i in range(0, len(boxes.low), CHUNK):
        some = among(boxes, slice(i, i + CHUNK))
        some = among(
            some, _weighted(observer.contact(nodes_of(some))[1], some).max(axis=1) > -200.0
        )
        if len(some.low):
            parts.append(Tiles(some, measured(observer, some)))
    return Tiles(joined([t.boxes for t in parts]), joined([t.nodes for t in parts]))


def _as_sharp_as_priors(
    observer: Observer, boxes: Boxes, *, longest: float = 9.0, most: int = 40_000
) -> Boxes:
    """Boxes cut where a prior of distance or angle has more than so many sd in one.

    Between nodes further apart a prior of 0.1 mm was not seen at all.

    Raises
    ------
    ValueError
        For a prior so sharp that more than `most` boxes are needed.
    """
    dim = boxes.low.shape[1]
    given = [i for i, n in enumerate(observer.unknowns[: observer.bounded]) if n in observer.prior]
    unit = np.stack(np.meshgrid(*[[0.0, 1.0]] * dim, indexing="ij"), axis=-1).reshape(-1, dim)
    kept: list[Boxes] = []
    while given and len(boxes.low):
        corners = boxes.low[:, None] + (boxes.high - boxes.low)[:, None] * unit
        score = observer.space.prior_scores(observer.contact(corners)[0])[..., given]
        least, largest = score.min(axis=1), score.max(axis=1)
        cut = ((largest - least > longest) & (least < 9.0) & (largest > -9.0)).any(axis=1)
        cut &= (boxes.high[:, 0] > -3.0) & (boxes.low[:, 0] < 3.0)  # all but 1e-4 of the reach
        kept.append(among(boxes, ~cut))
        score = score.reshape(len(score), *[2] * dim, -1)
        spans = [np.abs(np.diff(score, axis=1 + i)).max(axis=tuple(range(1, dim + 2)))
                 for i in range(dim)]  # fmt: skip
        parts = np.where(np.stack(spans, axis=-1) > longest / 2, 2, 1)
        boxes = _split(among(boxes, cut), parts[cut])
        if sum(len(b.low) for b in kept) + len(boxes.low) > most:
            names = " and ".join(observer.unknowns[i] for i in given)
            raise ValueError(
                f"The prior of {names} is too sharp for this cue; take what it knows as known, "
                "with cues.ForceMap(deflection_angle=0.2), say."
            )
    return joined([*kept, boxes]) if given else boxes


@lru_cache(maxsize=64)
def trunk_mass(observer: Observer) -> float:
    """ln of the prior's integral, about."""
    return float(np.logaddexp.reduce(trunk(observer).nodes.log_weight, axis=None))


def expected_tiles(observer: Observer, length: float) -> float:
    """About how many tiles all contacts take."""
    nodes = trunk(observer).nodes
    live = nodes.log_weight.max(axis=1) > trunk_mass(observer) - 23.0
    return float(np.maximum(nodes.lengths[live] / length, 1.0).prod(axis=1).sum())


def _rough(observer: Observer, length: float) -> float:
    return float(ROUGH - np.log(expected_tiles(observer, length)))


def near_the_cut(observer: Observer, nodes: Nodes, length: float) -> Flags:
    """Which tiles (n,) hold so little of the prior that others like them were left out.

    Those that are not cut further, where a reading comes from: a tile next to it that is left out
    has e^6 times less of the prior at least, beside others.
    """
    rough = trunk_mass(observer) + _rough(observer, length)
    return np.asarray(nodes.log_weight.max(axis=1) < rough)


def _followed(
    observer: Observer, nodes: Nodes, reading: Array, best: Array, everywhere: bool, length: float
) -> Flags:
    """In which boxes (n,) one of the readings may lie; updates ln of the most (B,) seen in one.

    A peak between the nodes may be higher than they are by what the distance to the next of them,
    in sd, says. (Half of it would do were signals linear: in boxes of a hundred sd they are not,
    and the end of a ridge was lost, 0.1 sd of the mean, by tiles of any length.)
    """
    likelihood = likelihood_of(observer)
    low, high = np.moveaxis(nodes.low, -1, 0), np.moveaxis(nodes.high, -1, 0)
    near = within(low, high, reading.T[..., None, None], likelihood.scales).any(axis=-1)
    row, box = np.nonzero(near | everywhere)
    out = np.zeros(len(nodes.low), dtype=bool)
    step = max(1, 400_000 // nodes.log_weight.shape[1])
    widest = np.diff(rule(1)[0][:, 0]).max()
    unseen = 0.5 * np.square(np.minimum(nodes.lengths, 1e6) * widest).sum(axis=1)
    bounded = isinstance(likelihood, AllUnknowns) and _independent(observer)
    for i in range(0, len(row), step):
        r, b = row[i : i + step], box[i : i + step]
        log = likelihood.log_likelihood(reading[r], nodes.signals[b])
        top = (log + nodes.log_weight[b]).max(axis=1)
        np.maximum.at(best, r, top)
        # Further, so that what else is followed with a reading changes nothing.
        least = best[r] - negligible(length) - 8.0
        live = top + unseen[b] > least
        fat = np.flatnonzero(live & (unseen[b] > 8.0)) if bounded else r[:0]
        if fat.size:
            live[fat] = _most(observer, nodes, reading[r[fat]], b[fat]) > least[fat] + 4.0
        out[b[live]] = True
    return out


def _independent(observer: Observer) -> bool:
    """Whether numbers of a reading are Gaussian, each about a signal of its own."""
    parts = observer.noise.components(len(observer.cue.signal_names))
    return all(
        c.noise.gaussian_on == "linear" and not getattr(c.noise, "correlation", 0.0) for c in parts
    )


def _most(observer: Observer, nodes: Nodes, reading: Array, box: Index) -> Array:
    """ln of about the most mass (m,) that boxes may have of readings (m, R), however thin.

    Where a signal passes through its reading within a box, the density along a line across it is
    one over how fast the signal changes there; the others are no likelier than at the ends they
    come nearest. Under Weber's law a light reading is within 1/k sd of all heavier signals: where
    the transverse force of these turns its sign, a ridge that a floor makes as thin as 1e-5 of a
    coordinate, and that has next to no mass, took 100 000 tiles.
    """
    signals, held = nodes.signals[box], np.isfinite(nodes.log_weight[box])
    mean, sd = observer.noise.mean(signals), observer.noise.sd(signals)
    off = reading[:, None] - mean
    dim = nodes.lengths.shape[1]
    grid = off.reshape(len(off), *(ORDER,) * dim, -1)
    weight = np.logaddexp.reduce(nodes.log_weight[box], axis=1)
    gaps = np.diff(rule(1)[0], axis=0)[:, None]
    crossed, steps = np.full((2, len(off), off.shape[-1]), np.inf)
    steps[:] = 1e-300
    for axis in range(1, dim + 1):
        lines = np.moveaxis(grid, axis, 1).reshape(len(off), ORDER, -1, off.shape[-1])
        step = np.maximum(np.abs(np.diff(lines, axis=1)), 1e-300)
        across = np.where(lines[:, :-1] * lines[:, 1:] <= 0, gaps / step, 0.0)
        crossed = np.minimum(crossed, across.sum(axis=1).mean(axis=1))
        steps = np.maximum(steps, step.max(axis=(1, 2)))
    # The nodes end before the box does.
    near = np.abs(off).min(axis=1) < steps
    crossed = np.where(near, np.maximum(crossed, gaps.max() / steps), 0.0)
    with np.errstate(divide="ignore"):
        z = np.abs(off / sd).min(axis=1)
        clear = -0.5 * z**2 - np.log(sd.min(axis=1)) - 0.5 * np.log(2 * np.pi)
        clear[crossed > 0] = np.inf
        through = np.where(crossed > 0, np.log(crossed), clear)
    others = np.stack([np.delete(clear, i, axis=1).sum(axis=1) for i in range(off.shape[-1])], -1)
    most = (through + others).min(axis=1) + weight + 2.0
    return np.where(held.all(axis=1), most, np.inf)
