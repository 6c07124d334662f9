"""Posteriors with an unknown curvature or hinge, at even steps of that unknown.

It says how far a whisker can be deflected, so that contacts are lost at some of its values. Where
it is known, the posterior of all else is one of two unknowns (or of three, whose last is summed
out) and is summed over tiles. Evidence and moments of those are smooth in the unknown's normal
coordinate z, and are summed by the trapezoid rule, which is off by 2 exp(−2π²/h²) for a Gaussian at
steps of h sd: by 5e-9 at one. Steps are halved, where there is mass, until these sums are those of
ln of the evidence interpolated between nodes, which tells the error: either rule is exact for what
the other is not.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from typing import Any

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.special import ndtr, ndtri

from .._values import Array, Flags, Index
from ..cues.unknowns import Conditioned
from ..mechanics.forward import forward_of
from .coordinates import from_normal
from .grid import weighted_quantiles
from .marginals import draws, tile_quantiles
from .observer import Observer
from .result import among
from .tiled import Moments, TiledObserver
from .tiling import Tiles, TooManyTiles, tiles_of

#: What the mechanics call unknowns that change how far a whisker can be deflected. Not friction,
#: which turns the sign of a force: where that is, evidence bends over a few hundredths of a radian,
#: and 33 to 129 nodes took as long as tiles that sum it at each contact.
TURNING = {"curvature_offset": "offset", "hinge_stiffness": "hinge"}
MECHANICAL = TURNING | {"friction_angle": "friction"}


@dataclass(frozen=True, eq=False, repr=False)
class Given(Conditioned):
    """A cue one of whose unknowns is known, at a value that its tables have."""

    name: str
    value: float

    @property
    def unknowns(self) -> tuple[str, ...]:
        return tuple(n for n in self.cue.unknowns if n != self.name)

    def _under(self, whisker: Any) -> Any:
        if self.name not in MECHANICAL:
            return whisker
        forward = forward_of(whisker)
        return replace(forward, fixed=(*forward.fixed, (MECHANICAL[self.name], self.value)))

    def _parts(self, whisker: Any, contact: Array) -> tuple[Any, Array]:
        whole = np.insert(contact, self.cue.unknowns.index(self.name), self.value, axis=-1)
        return self._under(whisker), whole

    def priors(self, whisker: Any) -> Mapping[str, Any]:
        own = self.cue.priors(self._under(whisker))
        return {n: p for n, p in own.items() if n != self.name}


#: Standard normal scores at which conditional quantiles are known.
SCORES = np.linspace(-4.5, 4.5, 25)


@lru_cache(maxsize=256)
def conditional(observer: Observer, name: str, z: float) -> Observer:
    """The observer to whom an unknown is known, at its normal coordinate z."""
    value = float(from_normal(observer.prior[name])(np.array(z)))
    prior = {n: p for n, p in observer.prior.items() if n != name}
    # A named model stays; one that was chosen is so again, and never the straight one.
    model = observer.model if type(observer.model) is str else None
    cue = Given(observer.cue, name, value)
    return Observer(observer.whisker, cue, observer.noise, prior, model=model, tolerance=1e-9)


def turning_unknown(observer: Observer) -> str | None:
    """The unknown that alone says how far the whisker can be deflected, if there is one."""
    names = [n for n in observer.unknowns[observer.bounded :] if n in TURNING]
    if len(names) != 1 or conditional(observer, names[0], 0.0).space.angle_range_varies:
        return None
    return names[0]


@cache
def _between(count: int, finer: int = 8, order: int = 6) -> Array:
    """From values at even nodes to those at steps finer by so much, (·, count): by Lagrange."""
    place = np.arange(finer * (count - 1) + 1) / finer
    order = min(order, count)
    first = np.clip(place.astype(np.intp) - (order // 2 - 1), 0, count - order)
    out = np.zeros((len(place), count))
    for i in range(order):
        terms = [(place - first - j) / (i - j) for j in range(order) if j != i]
        out[np.arange(len(place)), first + i] = np.prod(terms, axis=0)
    return out


class NodeSums:
    """The posteriors of readings (B, R), summed over nodes of the unknown of a `name`.

    `done` (B,) says of which readings nothing was too much.
    """

    count = 1
    #: Nodes are at even parts of one at closest, and as far out as that.
    parts, farthest = 16, 6

    def __init__(
        self,
        observer: Observer,
        name: str,
        reading: Array,
        length: float,
        wanted: float,
        tiled_of: Callable[[Observer, Tiles, float], TiledObserver],
    ) -> None:
        self.observer, self.name, self.reading, self.length = observer, name, reading, length
        self._tiles = tiled_of
        self.place = observer.unknowns.index(name)
        self.z = np.arange(-self.farthest * self.parts, self.farthest * self.parts + 1) / self.parts
        self.value = from_normal(observer.prior[name])(self.z)
        shape, dim = (len(reading), len(self.z)), len(observer.unknowns) - 1
        #: ln of the evidence and of the prior at nodes (B, n); −∞ where no contact explains it.
        self.log = np.full(shape, -np.inf)
        self.mean, self.sd = np.full((2, *shape, dim), np.nan)
        self.quantile = np.full((*shape, dim, len(SCORES)), np.nan, dtype=np.float32)
        self.misfit = np.zeros(shape)
        self.best = np.full((len(reading), dim), np.nan)
        self.signals = np.full((len(reading), len(observer.cue.signal_names)), np.nan)
        self._top = np.full(len(reading), -np.inf)
        self._known = np.zeros(shape, dtype=bool)
        self.stride = np.full(len(reading), self.parts)
        self.done = np.ones(len(reading), dtype=bool)
        dim += 1
        self.error = np.full((len(reading), dim), np.inf)
        asked = np.zeros(shape, dtype=bool)
        asked[:, np.abs(self.z) <= 4] = True
        asked[:, np.arange(len(self.z)) % self.parts > 0] = False
        left = np.arange(len(reading))
        while left.size:
            while (asked & ~self._known).any():
                self._evaluate(asked & ~self._known)
                asked |= self._beyond(left)
            self.error[left] = self._off(left)
            left = left[
                (self.error[left] > wanted / 2).any(axis=1)
                & self.done[left]
                & (self.stride[left] > 1)
            ]
            self.stride[left] //= 2
            asked = self._closer(left)
        #: Readings that are served; what follows is of those.
        served = self.done & np.isfinite(self._top) & (self.error <= wanted).all(axis=1)
        self.rows = np.flatnonzero(served)
        if self.rows.size:
            self.error += self._certificate()
            self.moments = self._moments()
            self.error = self.error[self.rows]

    def _evaluate(self, asked: Flags) -> None:
        """Sum over tiles at the nodes that are asked for, of the readings that do, (B, n)."""
        self._known |= asked
        for node in np.flatnonzero(asked.any(axis=0)):
            rows = np.flatnonzero(asked[:, node] & self.done)
            for some in np.array_split(rows, -(-len(rows) // 512)) if rows.size else []:
                for part, tiled, moments in self._tiled(node, some):
                    self._keep(node, part, tiled, moments)

    def _tiled(
        self, node: int, rows: Index, length: float | None = None
    ) -> list[tuple[Index, TiledObserver, Moments]]:
        """Tiles of readings at a node; fewer readings together where tiles are too many."""
        observer = conditional(self.observer, self.name, float(self.z[node]))
        length = length or self.length
        try:
            tiled = self._tiles(observer, tiles_of(observer, length, self.reading[rows]), length)
        except TooManyTiles:
            if len(rows) == 1:
                self.done[rows] = False
                return []
            halves = np.array_split(rows, 2)
            return [found for half in halves for found in self._tiled(node, half, length)]
        return [(rows, tiled, tiled.moments(self.reading[rows]))]

    def _keep(self, node: int, rows: Index, tiled: TiledObserver, moments: Moments) -> None:
        known = np.isfinite(moments.sd).all(axis=1) & (moments.sd > 0).all(axis=1)
        rows, moments = rows[known], among(moments, known)
        if not rows.size:
            return
        self.log[rows, node] = moments.log_evidence - 0.5 * self.z[node] ** 2
        self.mean[rows, node], self.sd[rows, node] = moments.mean, moments.sd
        self.misfit[rows, node] = moments.misfit
        better = self.log[rows, node] > self._top[rows]
        self._top[rows[better]] = self.log[rows[better], node]
        self.best[rows[better]] = moments.contact[better]
        self.signals[rows[better]] = moments.signals[better]
        # The angle's take many times as long, and wait until they are wanted.
        wanted = [i for i in range(self.mean.shape[2]) if i != 1]
        some = rows[self.log[rows, node] > self._top[rows] - 20]
        if some.size:
            self._keep_quantiles(node, some, tiled, wanted)

    def _keep_quantiles(
        self, node: int, rows: Index, tiled: TiledObserver, unknowns: list[int]
    ) -> None:
        lost = np.zeros((len(rows), self.mean.shape[2]))
        found, _ = tile_quantiles(tiled, self.reading[rows], ndtr(SCORES), unknowns, lost)
        for i in unknowns:
            self.quantile[rows, node, i] = found[i]

    def _beyond(self, rows: Index) -> Flags:
        """The next nodes (B, n) beyond the ends, where those have mass to speak of.

        At four sds the prior alone is e^-8 below its top.
        """
        out = np.zeros_like(self._known)
        for row in rows:
            known = np.flatnonzero(self._known[row])
            for end, step in ((known[0], -self.parts), (known[-1], self.parts)):
                if 0 <= end + step < len(self.z) and self.log[row, end] > self._top[row] - 7:
                    out[row, end + step] = True
        return out

    def _closer(self, rows: Index) -> Flags:
        """Nodes halfway between those that have mass, and their neighbours, (B, n)."""
        out = np.zeros_like(self._known)
        for row in rows:
            stride = 2 * self.stride[row]
            some = np.flatnonzero(self.log[row] > self._top[row] - 20)
            some = some[some % stride == 0] if some.size else some
            near = np.concatenate([some + k * stride // 2 for k in (-3, -1, 1, 3)])
            near = near[(near >= 0) & (near < len(self.z))]
            inside = np.flatnonzero(self._known[row])
            out[row, near[(near > inside[0]) & (near < inside[-1])]] = True
        return out

    def _filled(
        self, rows: Index, stride: int, columns: Array | None = None
    ) -> tuple[Index, Array, Array]:
        """Nodes (n,), the log (b, n) there over its top, and columns (b, n, …), wherever not known.

        Straight between nodes that are, far below; beyond the last as the prior falls. Columns, by
        default means and ln of sds, are those of the nearest node that explains the reading.
        """
        at = np.arange(0, len(self.z), stride)
        columns = np.stack([self.mean, np.log(self.sd)], axis=-1) if columns is None else columns
        log = np.empty((len(rows), len(at)))
        filled = np.empty((len(rows), len(at), *columns.shape[2:]))
        for i, row in enumerate(rows):
            known = at[self._known[row, at]]
            own = np.maximum(self.log[row, known] - self._top[row], -60.0)
            inside = np.clip(at, known[0], known[-1])
            log[i] = np.interp(inside, known, own) + (self.z[inside] ** 2 - self.z[at] ** 2) / 2
            held = at[np.isfinite(columns[row, at].reshape(len(at), -1)).all(axis=1)]
            filled[i] = columns[row, held[np.clip(np.searchsorted(held, at), 0, len(held) - 1)]]
        return at, log, filled

    def _between_nodes(
        self, rows: Index, stride: int, columns: Array | None = None
    ) -> tuple[Array, Array, Array]:
        """Places z (F,) between nodes, shares (b, F) of the mass there, and columns (b, F, …).

        By polynomials through the six nodes about a place.
        """
        at, log, filled = self._filled(rows, stride, columns)
        weigh = _between(len(at))
        log = log @ weigh.T
        share = np.exp(log - log.max(axis=1, keepdims=True))
        share /= share.sum(axis=1, keepdims=True)
        z = np.interp(np.arange(len(weigh)) / 8, np.arange(len(at)), self.z[at])
        out = np.tensordot(filled, weigh, axes=(1, 1))
        return z, share, np.moveaxis(np.asarray(out, dtype=np.float64), -1, 1)

    def _whole(self, share: Array, z: Array, mean: Array, sd: Array) -> tuple[Array, Array]:
        """Means and sds (b, U) of all unknowns, of shares (b, n) at nodes z (n,)."""
        value = np.broadcast_to(from_normal(self.observer.prior[self.name])(z), share.shape)
        mean = np.insert(mean, self.place, value, axis=2)
        sd = np.insert(sd, self.place, 0.0, axis=2)
        first = np.einsum("bn,bnu->bu", share, mean)
        square = sd**2 + (mean - first[:, None]) ** 2
        return first, np.sqrt(np.einsum("bn,bnu->bu", share, square))

    def _sums(self, rows: Index, stride: int) -> tuple[Array, Array]:
        """Means and sds (b, U) of readings by the trapezoid rule."""
        at, log, columns = self._filled(rows, stride)
        share = np.exp(log)
        share /= share.sum(axis=1, keepdims=True)
        return self._whole(share, self.z[at], columns[..., 0], np.exp(columns[..., 1]))

    def _by_stride(self, rows: Index) -> list[tuple[int, Index]]:
        """Readings whose nodes are as far apart, some at a time."""
        out = []
        for stride in np.unique(self.stride[rows]):
            some = rows[self.stride[rows] == stride]
            out += [(int(stride), part) for part in np.array_split(some, -(-len(some) // 64))]
        return out

    def _off(self, rows: Index) -> Array:
        """Errors (b, U) of mean and sd, in sds: what sums between nodes change."""
        out = np.full((len(self.reading), self.error.shape[1]), np.inf)
        for stride, some in self._by_stride(rows[np.isfinite(self._top[rows])]):
            mean, sd = self._sums(some, stride)
            z, share, columns = self._between_nodes(some, stride)
            other, width = self._whole(share, z, columns[..., 0], np.exp(columns[..., 1]))
            off = np.maximum(np.abs(mean - other) / sd, np.abs(width / sd - 1))
            # All on one node, there is nothing to compare.
            alone = np.exp(self.log[some] - self._top[some, None])[:, ::stride].sum(axis=1) < 1.5
            out[some] = np.where(alone[:, None], np.inf, off)
        return out[rows]

    def _certificate(self, *, certifying: int = 32) -> Array:
        """Errors (U,) of the tiles, in sds: what shorter ones change where readings have most mass.

        Half more than the largest of some readings; of the unknown that is summed, of any other.
        """
        some = self.rows[:: -(-len(self.rows) // certifying)]
        best, worst = self.log[some].argmax(axis=1), np.full(self.mean.shape[2], 3e-5)
        for node in np.unique(best):
            for rows, _, fine in self._tiled(node, some[best == node], self.length / 1.4):
                off = np.maximum(
                    np.abs(fine.mean - self.mean[rows, node]) / fine.sd,
                    np.abs(self.sd[rows, node] / fine.sd - 1),
                )
                worst = np.maximum(worst, np.nanmax(off, axis=0, initial=0.0))
        self.done[some] = True  # tiles were not too many
        return np.insert(1.5 * worst, self.place, 1.5 * worst.max())

    def _moments(self) -> Moments:
        rows = self.rows
        mean, sd = np.empty((2, len(rows), self.error.shape[1]))
        log_evidence, share, misfit = np.empty((3, len(rows)))
        for stride, some in self._by_stride(rows):
            of = np.searchsorted(rows, some)
            mean[of], sd[of] = self._sums(some, stride)
            weight = np.exp(self.log[some, ::stride] - self._top[some, None])
            total = weight.sum(axis=1)
            step = stride / self.parts / np.sqrt(2 * np.pi)
            log_evidence[of] = np.log(total * step) + self._top[some]
            share[of] = 1 / total
            misfit[of] = (weight * self.misfit[some, ::stride]).sum(axis=1) / total
        value = self.value[self.log[rows].argmax(axis=1)]
        contact = np.insert(self.best[rows], self.place, value, axis=1)
        rough = np.zeros(len(rows))
        return Moments(mean, sd, log_evidence, share, contact, self.signals[rows], rough, misfit)

    def _of_others(self, unknown: int) -> int:
        """Which of the unknowns without the one that is summed, its quantiles made ready."""
        other = unknown - (unknown > self.place)
        for node in np.flatnonzero(self._known[self.rows].any(axis=0)):
            some = self.rows[self.log[self.rows, node] > self._top[self.rows] - 20]
            some = some[np.isnan(self.quantile[some, node, other, 0])]
            for rows, tiled, _ in self._tiled(node, some) if some.size else []:
                self._keep_quantiles(node, rows, tiled, [other])
        return other

    def quantiles(self, p: Array, unknown: int) -> tuple[Array, Array]:
        """Quantiles (B, Q), and their errors.

        Of the mixture of what is known at nodes and, for posteriors there that are narrower than
        nodes are apart, of conditional quantiles interpolated between them.
        """
        out, error = np.empty((2, len(self.rows), len(p)))
        other = None if unknown == self.place else self._of_others(unknown)
        for stride, some in self._by_stride(self.rows):
            columns = None if other is None else self.quantile[:, :, other].astype(float)
            z, share, known = self._between_nodes(some, stride, columns)
            for row, own, at in zip(np.searchsorted(self.rows, some), share, known, strict=True):
                if other is None:
                    finer = np.linspace(z[0], z[-1], 8 * len(z))
                    mass = np.exp(make_interp_spline(z, np.log(own + 1e-300))(finer))
                    value = from_normal(self.observer.prior[self.name])(finer)
                    out[row], error[row] = weighted_quantiles(value, mass, p)
                else:
                    held = own > 1e-7
                    out[row], error[row] = _of_mixture(own[held], at[held], p)
        return out, error + (self.error * self.moments.sd)[:, unknown, None]

    def draws(self, count: int, rng: np.random.Generator) -> Array:
        """Contacts (B, count, U) drawn from the posteriors.

        Of the one at the nearest node, each unknown then moved to where the same quantile is at the
        place drawn.
        """
        others = [i for i in range(self.error.shape[1]) if i != self.place]
        for unknown in others:
            self._of_others(unknown)
        out = np.full((len(self.rows), count, self.error.shape[1]), np.nan)
        quantile = self.quantile.astype(float)
        for stride, some in self._by_stride(self.rows):
            z, share, known = self._between_nodes(some, stride, quantile)
            for row, own, at in zip(some, share, known, strict=True):
                strata = (rng.random() + np.arange(count)) / count
                place = np.minimum(np.searchsorted(np.cumsum(own), strata), len(z) - 1)
                held = np.flatnonzero(np.isfinite(quantile[row, :, :, 0]).all(axis=1))
                held = held[held % stride == 0]
                nearest = held[np.abs(z[place, None] - self.z[held]).argmin(axis=1)]
                drawn = np.empty((count, len(others)))
                for node in np.unique(nearest):
                    here = np.flatnonzero(nearest == node)
                    reading = self.reading[[row]]
                    tiled = self._tiled(node, np.array([row]))[0][1]
                    x = draws(tiled, reading, len(here), rng)
                    drawn[here] = tiled.completed(reading, x, rng)[0]
                    for i in range(len(others)):
                        score = np.interp(drawn[here, i], quantile[row, node, i], SCORES)
                        drawn[here, i] = _interpolated(at[place[here], i], score)
                value = from_normal(self.observer.prior[self.name])(z[place])
                contact = np.insert(drawn, self.place, value, axis=1)
                low, width = self.observer.space.angle_range(contact[:, 0], contact)
                contact[:, 1] = np.clip(contact[:, 1], low, low + width)
                out[np.searchsorted(self.rows, row)] = rng.permutation(contact)
        return out


def _of_mixture(share: Array, quantile: Array, p: Array) -> tuple[Array, Array]:
    """Quantiles (P,) of a mixture of shares (n,) with quantiles (n, Q) at `SCORES`; their errors.

    The normal score of its cumulative probability is next to straight between values; every other
    of these tells the error.
    """
    scores = np.linspace(-5, 5, 161)
    parts = np.maximum.accumulate(make_interp_spline(SCORES, quantile, axis=1)(scores), axis=1)
    order = np.argsort(parts, axis=None)
    rise = np.cumsum((share[:, None] * np.exp(-0.5 * scores**2)).ravel()[order])
    value = np.interp(ndtr(scores), rise / rise[-1], parts.ravel()[order])
    value = np.unique(value)
    below = [ndtr(np.interp(value, part, scores)) for part in parts]
    score = np.maximum.accumulate(ndtri(share @ np.array(below) / share.sum()))
    one, other = (np.interp(ndtri(p), score[::k], value[::k]) for k in (1, 2))
    return one, np.abs(one - other)


def _interpolated(quantile: Array, score: Array) -> Array:
    """Values (n,) at scores (n,), straight between the quantiles (n, Q) at `SCORES`."""
    place = (score - SCORES[0]) / (SCORES[1] - SCORES[0])
    first = np.clip(place.astype(np.intp), 0, len(SCORES) - 2)
    rows = np.arange(len(score))
    low, high = quantile[rows, first], quantile[rows, first + 1]
    return np.asarray(low + (high - low) * (place - first))
