"""Plain grids, for what nothing else serves.

Midpoints of a box of the coordinates, the same number along each axis; the box closes in on where
they have mass until it stays, and is summed by more of them, wider again where a face of it holds
mass. Half of the nodes, left out in turn, and what is left on the faces tell the error: nothing is
assumed of the density, and a peak between the first nodes is missed.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from .._values import Array, Index
from .observer import Observer
from .result import checked_density
from .tiled import Moments
from .tiling import trunk

#: ln of B densities at points (b, N, D) of those (b,), (b, N).
Density = Callable[[Array, Index], ArrayLike]

#: Nodes along each axis while closing in and at last, by the number of axes.
#: Odd, so that a mirror image of a node is in the same half: with even numbers the halves of a
#: symmetric ridge agreed, and an sd 9 % off was claimed to 1e-6.
NODES = {1: (161, 401), 2: (81, 201), 3: (41, 81), 4: (21, 29)}


class Sums(NamedTuple):
    """Integrals of B densities.

    ln of the integral over the box, (B,); mean and sd of the functions and the larger error of
    either, in sds, (B, C), NaN without any mass; the last points (B, N, D) and their weights (B,
    N), which sum to one.
    """

    log_evidence: Array
    mean: Array
    sd: Array
    error: Array
    points: Array
    weights: Array


def integrate(
    log_density: Density,
    low: ArrayLike,
    high: ArrayLike,
    *,
    functions: Callable[[Array], ArrayLike] | None = None,
    depth: float = 28.0,
    looks: int = 12,
    widenings: int = 6,
    nodes: tuple[int, int] | None = None,
    together: int = 2_000_000,
) -> Sums:
    """Integrate B densities over boxes `low` to `high` (B, D) of D = 1 to 4 coordinates.

    ``log_density(x, index)``, with x (b, N, D) and the densities `index` (b,) that these rows
    belong to, returns (b, N): −inf, but never NaN or +inf. ``functions(x)`` (b, N, C) are what
    moments are wanted of, finite where the density is not zero; by default the coordinates. The box
    ends `depth` in ln below the highest; it closes in so many times at most (`looks`) and is made
    wider as often as `widenings`, as coarse nodes see the ends of a narrow ridge badly (an sd was 9
    % off). `nodes` along each axis while closing in and at last are those of `NODES`; so many are
    worked on `together`.

    Examples
    --------
    The log of a gamma variable of shape 3, and the variable itself:

    >>> density = lambda x, index: 3 * x[..., 0] - np.exp(x[..., 0])
    >>> fit = integrate(density, [[-40.0]], [[10.0]], functions=np.exp)
    >>> fit.mean.round(4).tolist(), fit.sd.round(4).tolist()       # 3 and sqrt(3)
    ([[3.0]], [[1.7321]])
    """
    begin, end = (np.array(side, dtype=float) for side in (low, high))
    if begin.ndim != 2 or begin.shape != end.shape or begin.shape[1] not in NODES:
        raise ValueError(
            f"low and high must have shape (B, D) with D from 1 to 4, got {begin.shape} and "
            f"{end.shape}; give one box for each density."
        )
    if not (np.isfinite(begin) & np.isfinite(end) & (begin < end)).all():
        raise ValueError(
            f"low must be below high, both finite, got {begin.tolist()} and {end.tolist()}; "
            "give the ends of what each coordinate can be."
        )
    first, last = begin.copy(), end.copy()
    coarse, fine = nodes or NODES[begin.shape[1]]
    rows = max(1, together // fine ** begin.shape[1])
    parts = []
    for start in range(0, len(begin), rows):
        index = np.arange(start, min(start + rows, len(begin)))
        moving = index
        for _ in range(looks):
            closer = _closed_in(log_density, moving, begin[moving], end[moving], coarse, depth)
            share = np.prod((closer[1] - closer[0]) / (end[moving] - begin[moving]), axis=1)
            begin[moving], end[moving] = closer
            moving = moving[share < 0.7]
            if not moving.size:
                break
        for _ in range(widenings + 1):
            *sums, faces = _summed(log_density, index, begin[index], end[index], fine, functions)
            inside = np.stack([begin[index] > first[index], end[index] < last[index]], axis=-1)
            faces *= inside
            cut = faces > 1e-7
            if not cut.any():
                break
            wider = (end[index] - begin[index]) / 2
            begin[index] = np.maximum(begin[index] - wider * cut[..., 0], first[index])
            end[index] = np.minimum(end[index] + wider * cut[..., 1], last[index])
        # As if the density stayed as it is at the face for the width of the box.
        sums[3] = np.maximum(sums[3], fine * faces.max(axis=(1, 2))[:, None])
        parts.append(tuple(sums))
    return Sums._make(np.concatenate(column) for column in zip(*parts, strict=True))


def _nodes(low: Array, high: Array, count: int) -> Array:
    """Midpoints (b, N, D) of boxes, the last axis running fastest."""
    share = (np.arange(count) + 0.5) / count
    unit = np.stack(np.meshgrid(*[share] * low.shape[1], indexing="ij"), axis=-1)
    return low[:, None] + (high - low)[:, None] * unit.reshape(-1, low.shape[1])


def _closed_in(
    log_density: Density, index: Index, low: Array, high: Array, count: int, depth: float
) -> tuple[Array, Array]:
    """The part of boxes (b, D) in which densities have mass, as far as nodes can tell."""
    dim, points = low.shape[1], _nodes(low, high, count)
    log = checked_density(log_density(points, index), points, index)
    log = log.reshape(-1, *(count,) * dim)
    top = log.reshape(len(log), -1).max(axis=1)
    out_low, out_high = low.copy(), high.copy()
    for axis in range(dim):
        line = log.max(axis=tuple(a for a in range(1, dim + 1) if a != axis + 1))
        # A peak narrower than nodes are apart is as far above the best as that is above the next.
        padded = np.pad(line, ((0, 0), (1, 1)), constant_values=-np.inf)
        best = line.argmax(axis=1)[:, None]
        beside = [np.take_along_axis(padded, best + k, axis=1)[:, 0] for k in (0, 2)]
        with np.errstate(invalid="ignore"):
            fall = top - np.maximum(*beside)
        fall = np.where(np.isfinite(fall), fall, 0.0)
        held = line > (np.where(np.isfinite(top), top, 0.0) - depth - 4 * fall)[:, None]
        step = (high - low)[:, axis] / count
        some = held.any(axis=1)
        first, last = held.argmax(axis=1), count - 1 - held[:, ::-1].argmax(axis=1)
        start, stop = low[:, axis] + step * (first - 1), low[:, axis] + step * (last + 2)
        out_low[some, axis] = np.maximum(start, low[:, axis])[some]
        out_high[some, axis] = np.minimum(stop, high[:, axis])[some]
    return out_low, out_high


def _summed(
    log_density: Density,
    index: Index,
    low: Array,
    high: Array,
    count: int,
    functions: Callable[[Array], ArrayLike] | None,
) -> tuple[Array, ...]:
    """The columns of `Sums`, with what half of the nodes change; the mass on faces (b, D, 2)."""
    points = _nodes(low, high, count)
    log = checked_density(log_density(points, index), points, index)
    top = log.max(axis=1)
    weight = np.exp(log - np.where(np.isfinite(top), top, 0.0)[:, None])
    values = points if functions is None else np.asarray(functions(points), dtype=float)
    values = np.where((weight > 0)[..., None], values, 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        evidence = np.log(weight.mean(axis=1) * np.prod(high - low, axis=1)) + top
        share = weight / weight.sum(axis=1, keepdims=True)
        mean, sd = _moments(share, values)
        error = np.zeros_like(sd)
        place = np.indices((count,) * low.shape[1]).reshape(low.shape[1], -1)
        # Along each axis, too: a thin ridge that runs askew is seen alike by either half of all.
        for half in (p == side for p in (place.sum(axis=0) % 2, *(place % 2)) for side in (0, 1)):
            part = weight[:, half] / weight[:, half].sum(axis=1, keepdims=True)
            other, width = _moments(part, values[:, half])
            off = np.maximum(np.abs(other - mean), np.abs(width - sd)) / sd
            error = np.maximum(error, np.where(np.isfinite(off), off, np.inf))
    # What half of the nodes change falls as the square root of what all leave; and the box ends.
    error = np.where(error < 0.1, error**1.5, error) + 1e-6
    dim = low.shape[1]
    planes = share.reshape(-1, *(count,) * dim)
    over = [tuple(a for a in range(1, dim + 1) if a != axis) for axis in range(1, dim + 1)]
    faces = np.stack([planes.sum(axis=axes)[:, [0, -1]] for axes in over], axis=1)
    return evidence, mean, sd, error, points, share, np.nan_to_num(faces)


def _moments(share: Array, values: Array) -> tuple[Array, Array]:
    """Mean and sd (b, C) of values (b, N, C)."""
    mean = np.einsum("bn,bnc->bc", share, values)
    return mean, np.sqrt(np.einsum("bn,bnc->bc", share, np.square(values - mean[:, None])))


class OwnGrids:
    """The posteriors of readings (B, R) by `grid`, over all of the prior."""

    count = 1

    def __init__(self, observer: Observer, reading: Array) -> None:
        self.observer = observer

        def density(x: Array, index: Index) -> Array:
            return observer.log_density(x, reading[index, None])

        boxes = (np.tile(side, (len(reading), 1)) for side in prior_box(observer))
        found = integrate(density, *boxes, functions=lambda x: observer.contact(x)[0])
        self.weights, self.contacts = found.weights, observer.contact(found.points)[0]
        best = self.weights.argmax(axis=1)
        contact = self.contacts[np.arange(len(reading)), best]
        signals = np.nan_to_num(observer.signals(contact)[0], nan=1.0)
        share, none = self.weights.max(axis=1), np.zeros(len(reading))
        self.moments = Moments(
            found.mean, found.sd, found.log_evidence, share, contact, signals, none, none
        )
        self.error = found.error

    def quantiles(self, p: Array, unknown: int) -> tuple[Array, Array]:
        """Quantiles (B, Q), and their errors."""
        found = []
        for contact, weight in zip(self.contacts, self.weights, strict=True):
            value, whose = np.unique(contact[:, unknown], return_inverse=True)
            found.append(weighted_quantiles(value, np.bincount(whose, weight), p))
        values, errors = zip(*found, strict=True)
        return np.array(values), np.array(errors)

    def draws(self, count: int, rng: np.random.Generator) -> Array:
        """Contacts (B, count, U) drawn from the nodes."""
        chosen = [rng.choice(len(w), count, p=w) for w in self.weights]
        return np.stack([c[i] for c, i in zip(self.contacts, chosen, strict=True)])


def weighted_quantiles(value: Array, mass: Any, p: Array) -> tuple[Array, Array]:
    """Quantiles (Q,) of rising values (n,); their errors: what every other value changes."""
    out = []
    for some in (slice(None), slice(None, None, 2)):
        rise = np.cumsum(mass[some]) - mass[some] / 2
        out.append(np.interp(p, rise / mass[some].sum(), value[some]))
    return out[0], np.abs(out[0] - out[1])


def prior_box(observer: Observer) -> tuple[Array, Array]:
    """Ends (U,) of the coordinates between which the prior is not nothing."""
    boxes = trunk(observer).boxes
    further = [6.0] * (len(observer.unknowns) - boxes.low.shape[1])
    low, high = boxes.low.min(axis=0), boxes.high.max(axis=0)
    return np.append(low, np.negative(further)), np.append(high, further)
