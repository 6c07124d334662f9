"""What tiles ask of an observer: its contacts, their signals and how likely readings are there.

Of all unknowns, or of all but a last one with a prior of its own, which is summed out. At a given
contact the density of a stiffness, a side or a friction is one narrow bump that moves from contact
to contact along a ridge: boxes of all unknowns together would be as narrow as the bump. So tiles
are of the other unknowns, as long as what a reading tells of *them*, and the last is summed at each
node by the trapezoid rule over a few points about its bump. Points lie on one lattice of the
unknown's normal coordinate, on which signals are known beforehand: as functions of it they are
combinations of a few (of one, where they are all in proportion to it).

Friction and curvature also say how far a whisker can be deflected. Nodes are coordinates, not
contacts, for that: the angle at a node then moves with the last unknown and stays within its range.
Its change, and that of ln of the prior's density, are two more functions beside the signals.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache, reduce
from typing import Any, NamedTuple

import numpy as np
from numpy.polynomial import chebyshev

from .._values import Array, Flags, Index
from ..mechanics.contact import Outcome
from .observer import Observer
from .scale_table import ScaleTable


class Peak(NamedTuple):
    """Bumps (m, N): where on the lattice, how wide, how high in ln, and how far they reach."""

    place: Index
    width: Array
    height: Array
    reach: Array


class NotSmooth(Exception):
    """Signals that are no combination of few smooth functions of the last unknown."""


class LastSummed:
    """What tiles ask of an observer's contacts, the last unknown being summed out on a lattice.

    Nodes have the `parts` (..., S, D) of their signals, combinations of functions of the last
    unknown. `panels` are so many parts of its range, of each of which a box says what readings it
    makes plausible.

    Raises
    ------
    NotSmooth
        Where contacts are lost, or signals bend, within four sds of the prior.
    """

    panels = 8
    #: Where signals are in proportion to the last unknown; how much larger readings may be for it.
    table: ScaleTable | None = None
    scales: tuple[float, float] | None = None

    def __init__(self, observer: Observer, *, samples: int = 65, most: int = 24) -> None:
        self.observer, self.noise = observer, observer.noise
        self.dim = len(observer.unknowns) - 1
        #: Most boxes, beyond which a plain grid is quicker.
        self.most = 24_000 // 4 ** (self.dim - 1)
        # As far as the reach: there contacts are lost first.
        fractions = 1 / (1 + np.exp(-np.append(np.linspace(-6, 5, 17), 30.0)))
        x = observer.space.spread(fractions, others=5)[:, :-1]
        x = np.unique(x, axis=0)
        #: Whether the angle at a node moves with the last unknown.
        self.turns = observer.space.angle_range_varies
        #: How many rows of the parts are signals.
        self.size = len(observer.cue.signal_names)
        nodes = np.cos(np.pi * (np.arange(samples) + 0.5) / samples)
        between = np.cos(np.pi * np.arange(1, samples) / samples)
        self.reach = reach = 6.0
        own, held = self._signals(x, reach * nodes)
        other, also = self._signals(x, reach * between)
        some = held[:, samples // 2]
        if not some.any():
            raise NotSmooth
        #: Up to where all contacts are held, as they are taken to be beyond; what that may do to an
        #: sd, were they lost there.
        lost = ~np.concatenate([held, also], axis=1)[some].all(axis=0)
        sure = np.abs(reach * np.concatenate([nodes, between]))[lost].min(initial=reach)
        self.unsure = float(sure * np.exp(-(sure**2) / 2) / np.sqrt(2 * np.pi))
        known = held.all(axis=1) & also.all(axis=1)
        if sure < 3.5 or known.sum() < some.sum() / 4:
            raise NotSmooth
        own, other = own[known], other[known]
        fit = np.linalg.inv(chebyshev.chebvander(nodes, samples - 1))
        rows = own.swapaxes(1, 2).reshape(-1, samples)
        size = np.abs(rows).max(axis=1, keepdims=True)
        if self.turns:  # a prior that hardly moves is no shape
            size = np.maximum(size, np.tile([0.0] * self.size + [1e-4, 0.0], len(own))[:, None])
        _, _, shapes = np.linalg.svd(rows / np.where(size > 0, size, 1.0), full_matrices=False)
        unit = [self._resolution(s) for s in (own, other)]
        for count in range(1, most + 1):
            self._shape = fit @ shapes[:count].T
            within = np.cos(np.pi * (np.arange(2 * count + 1) + 0.5) / (2 * count + 1))
            self.taken = min(reach, 0.98 * sure) * within
            self._solve = np.linalg.pinv(self.basis(self.taken)).T
            taken, _ = self._signals(x[known], self.taken)
            parts = np.einsum("njs,jd->nsd", taken, self._solve)
            off = [
                np.abs(np.einsum("nsd,jd->njs", parts, self.basis(reach * z)) - s) * u
                for z, s, u in ((nodes, own, unit[0]), (between, other, unit[1]))
            ]
            both = zip(off, (nodes, between), strict=True)
            each = np.max([(o * _less(reach * z)).max(axis=(1, 2)) for o, z in both], axis=0)
            # Where the end of the branch passes from the fold to the tip the range of angles has a
            # kink: nodes say how far off they are themselves.
            misfit = float(np.quantile(each, 0.9) if self.turns else each.max())
            if misfit < 1e-4:
                break
        if misfit > 3e-3:
            raise NotSmooth
        # A mean was 7e-4 sd off with a misfit of 3e-3.
        self.unsure += misfit / 3 if misfit > 1e-4 and not self.turns else 0.0
        self._lay(parts)

    def with_z(self, x: Array, z: Any = 0.0) -> tuple[Array, Array]:
        """Contacts (..., U) at coordinates x (..., U − 1) and z (...); ln of the prior of x."""
        z = np.broadcast_to(np.asarray(z, dtype=float), x.shape[:-1])
        contact, log_prior = self.observer.contact(np.concatenate([x, z[..., None]], axis=-1))
        return contact, log_prior + 0.5 * (z**2 + np.log(2 * np.pi))

    def with_last(self, contact: Array, z: Array) -> Array:
        """Contacts (..., U) where those of z = 0, (..., U − 1), are with the last unknown at z."""
        last = self.observer.last_unknown(np.zeros(z.shape))
        whole = np.concatenate([contact, last[..., None]], axis=-1)
        if not self.turns:
            whole[..., -1] = self.observer.last_unknown(z)
            return whole
        return self.with_z(self.observer.coordinates(whole)[..., :-1], z)[0]

    def _signals(self, x: Array, z: Array) -> tuple[Array, Flags]:
        """Signals (n, J, S) and whether contacts are held, at coordinates x (n, U − 1) and z (J,).

        Where the angle turns, with ln of how the prior changes from z = 0 on, and the angle over
        that at z = 0.
        """
        if not self.turns:
            felt = self.observer.given(self.observer.contact(x)[0])
            pairs = [felt(np.full(len(x), v)) for v in self.observer.last_unknown(z)]
        else:
            middle, log_middle = self.with_z(x)
            pairs = []
            for one in z:
                contact, log_prior = self.with_z(x, one)
                signals, outcome = self.observer.signals(contact)
                with np.errstate(invalid="ignore", divide="ignore"):
                    more = [log_prior - log_middle, contact[:, 1] / middle[:, 1]]
                known = [np.nan_to_num(m, posinf=1.0, neginf=1.0, nan=1.0) for m in more]
                pairs.append((np.column_stack([signals, *known]), outcome))
        signals = np.stack([s for s, _ in pairs], axis=1)
        held = np.stack([o == Outcome.HELD for _, o in pairs], axis=1)
        return np.where(held[..., None], signals, 1.0), held

    def parts(self, x: Array) -> tuple[Array, Flags]:
        """The parts (n, S, D) of signals at coordinates x (n, U − 1), and whether all are held.

        Where the angle turns there are three more rows: ln of the prior's change, the angle's
        ratio, and how far off the parts are, in sds, the same for all functions.
        """
        taken, held = self._signals(x, self.taken)
        parts = np.einsum("njs,jd->nsd", taken, self._solve)
        if self.turns:
            off = np.abs(np.einsum("nsd,jd->njs", parts, self.basis(self.taken)) - taken)
            off = (off * self._resolution(taken) * _less(self.taken)).max(axis=(1, 2))
            off = np.broadcast_to(off[:, None, None], (len(x), 1, parts.shape[2]))
            parts = np.concatenate([parts, off], axis=1)
        return parts, np.asarray(held.all(axis=1))

    def _resolution(self, signals: Array) -> Array:
        """One over the sd of signals (n, J, S); of an angle's ratio, 30.

        Where the last unknown turns a signal's sign it would be known exactly under Weber's law: it
        is taken for known to a fiftieth of its largest sd.
        """
        out = np.broadcast_to([1.0] * self.size + [1.0, 30.0], (*signals.shape[:-1], self.size + 2))
        out = out[..., : signals.shape[-1]].copy()
        fisher = self.observer.noise.fisher(signals[..., : self.size])
        told = np.diagonal(fisher, axis1=-2, axis2=-1)
        unit = np.sqrt(np.where(np.isfinite(told), np.maximum(told, 0.0), 0.0))
        if self.turns:
            least = np.where(unit > 0, unit, np.inf).min(axis=1, keepdims=True)
            unit = np.minimum(unit, 50 * least)
        out[..., : self.size] = unit
        return out

    def basis(self, z: Array) -> Array:
        """The functions (..., D) of which signals are combinations."""
        terms = chebyshev.chebvander(np.ravel(z) / self.reach, len(self._shape) - 1)
        return np.asarray(terms @ self._shape).reshape(*np.shape(z), -1)

    def _lay(self, parts: Array, *, points: int = 8, most: int = 20_000) -> None:
        """The lattice, so many points to the narrowest bump; parts (n, S, D) are of contacts.

        Beyond either end there is a point of no mass.
        """
        width = min(float(self.widths_at(parts, z).min()) for z in (-2.0, 0.0, 2.0))
        self.half = int(min(np.ceil(self.reach * points / width), most))
        self.step = self.reach / self.half
        self.z = self.step * np.arange(-self.half - 1, self.half + 2)
        inside = np.clip(self.z, -self.reach, self.reach)
        self.value, self.functions = self.observer.last_unknown(inside), self.basis(inside)
        self.log_prior = -0.5 * (self.z**2 + np.log(2 * np.pi))
        self.log_prior[[0, -1]] = -np.inf
        self._find_table()

    def _find_table(self, *, misfit: float = 1e-4) -> None:
        """A table, where all signals are in proportion to the last unknown and noise with them."""
        noise, value = self.noise, self.value
        if self.functions.shape[1] > 1 or not noise.is_scale_family or noise.gaussian_on is None:
            return
        ratio = self.functions[:, 0] / value
        if self.turns or self.observer.last_unknown(np.array([-12.0])) <= 0:
            return
        if np.ptp(ratio) > 1e-6 * np.abs(ratio).max():
            return
        table = ScaleTable(self.observer)
        if table.misfit < misfit:
            self.table, self.scales, self.panels = table, table.range, 1

    def widths_at(self, parts: Array, z: float) -> Array:
        """Widths (...) of the bump at z, by prior and Fisher information; parts (..., S, D)."""
        parts = parts[..., : self.size, :]
        signals, slope = parts @ self.basis(np.array(z)), parts @ self.slope(z)
        told = np.einsum("...i,...ij,...j->...", slope, self.observer.noise.fisher(signals), slope)
        return np.asarray((1.0 + np.nan_to_num(np.maximum(told, 0.0), posinf=0.0)) ** -0.5)

    def slope(self, z: float) -> Array:
        """d basis/dz, (D,)."""
        ends = self.basis(np.array([z + 1e-5, z - 1e-5]))
        return np.asarray((ends[0] - ends[1]) / 2e-5)

    def at(self, index: Index) -> Index:
        """Index of the lattice, those beyond it at its ends."""
        if index.size and index.min() >= 0 and index.max() <= 2 * self.half + 2:
            return index
        return np.clip(index, 0, 2 * self.half + 2)

    def contact(self, x: Array) -> tuple[Array, Array]:
        """Contacts (..., U − 1) at coordinates x, of the last unknown's middle; ln of the prior."""
        if not self.turns:
            return self.observer.contact(x)
        contact, log_prior = self.with_z(x)
        return contact[..., :-1], log_prior

    def signals(self, x: Array, contact: Array) -> tuple[Array, Flags]:
        """The parts (..., S, D) of the signals at coordinates (..., U − 1), and which are held."""
        parts, held = self.parts(x.reshape(-1, self.dim))
        shape = x.shape[:-1]
        return parts.reshape(*shape, *parts.shape[1:]), held.reshape(shape)

    def views(self, parts: Array) -> list[tuple[Array, Array | None]]:
        """Signals (..., S) at three places of the last unknown, and their slopes."""
        parts = parts[..., : self.size, :]
        return [(parts @ self.basis(np.array(z)), parts @ self.slope(z)) for z in (0.0, -2.0, 2.0)]

    def interval(self, parts: Array, width: float) -> tuple[Array, Array]:
        """Between which readings (..., panels, R) lie, of each panel; of the middle, by a table."""
        if self.table:
            low, high = self.noise.interval(self.middle(parts), width)
            return low[..., None, :], high[..., None, :]
        ends = self.basis(np.linspace(-1, 1, 2 * self.panels + 1) * self.reach)
        signals = np.einsum("...sd,ed->...es", parts[..., : self.size, :], ends)
        low, high = self.noise.interval(signals, width)
        cut = [slice(i, i + 2 * self.panels - 1 + (i > 1), 2) for i in range(3)]
        low = np.minimum.reduce([low[..., c, :] for c in cut])
        return low, np.maximum.reduce([high[..., c, :] for c in cut])

    def middle(self, parts: Array) -> Array:
        """Signals (..., S) at the middle of the prior."""
        return np.asarray(parts @ self.functions[self.half + 1])

    def curve(self, reading: Array, parts: Array) -> LastCurve:
        """ln of the density of the last unknown, for readings (m, R) and nodes (m, N, S, D)."""
        return LastCurve(self, reading, parts)

    def search(self, curve: LastCurve, low: Index, high: Index, width: Array, count: int) -> Peak:
        """The bumps of curves (m, N) between panels (m,), about as wide as (m,).

        Told by samples of each, from the best of which Newton's method goes on. A second bump that
        counts is within reach.
        """
        samples = 6
        size = 2 * self.half / self.panels
        share = (np.arange(samples) + 0.5) / samples
        at = 1 + size * (low[:, None] + (high + 1 - low)[:, None] * share)
        seen = np.broadcast_to(at.astype(np.intp)[:, None], (len(low), count, samples))
        log = curve(seen)
        index = np.take_along_axis(seen, log.argmax(axis=-1)[..., None], axis=-1)[..., 0]
        # Of bumps narrower than samples are apart, closer samples about the best.
        apart = size * (high + 1 - low) / samples
        about = np.linspace(-1, 1, 9)
        while (apart > 2 * width / self.step).any():
            closer = self.at((index[..., None] + apart[:, None, None] * about).astype(np.intp))
            best = curve(closer).argmax(axis=-1)[..., None]
            index, apart = np.take_along_axis(closer, best, axis=-1)[..., 0], apart / 4
        peak = self.climb(curve, index, width, 3)
        far = np.abs(seen - peak.place[..., None]) * self.step
        far = np.where(log > peak.height[..., None] - 12, far, 0.0).max(axis=-1)
        return peak._replace(reach=np.maximum(peak.reach, far + 2 * peak.width))

    def climb(self, curve: LastCurve, index: Index, width: Array, steps: int) -> Peak:
        """The bumps (m, N) near indices, about as wide as (m,), by Newton's method.

        In so many steps, or as many as the longest way takes: of three a narrow bump at a tile's
        corner is out of reach, and at k = 0.03 means were 0.3 sd off.
        """
        stride = np.maximum(1, (0.7 * width / self.step).astype(np.intp))[:, None]
        three = stride[..., None] * np.arange(-1, 2)
        for step in range(24):
            index = np.minimum(np.maximum(index, 1 + stride), 2 * self.half + 1 - stride)
            log = curve(index[..., None] + three)
            below, middle, above = log[..., 0], log[..., 1], log[..., 2]
            with np.errstate(invalid="ignore"):
                rise, bend = (above - below) / 2, 2 * middle - below - above
            if not np.isfinite(rise).all():
                rise, bend = np.nan_to_num(rise, posinf=9, neginf=-9), np.nan_to_num(bend, nan=1.0)
            bend = np.minimum(np.maximum(bend, 0.02), 50.0)
            move = np.minimum(np.maximum(rise / bend, -4.0), 4.0)
            index = index + np.rint(move * stride).astype(np.intp)
            inside = (index > 1 + stride) & (index < 2 * self.half + 1 - stride)
            if step + 1 >= steps and not (inside & (np.abs(move) >= 4.0)).any():
                break
        found = np.minimum(stride * self.step * bend**-0.5, 1.0)
        # Of a bump that is found the rise is little; more is of one that the lattice does not show.
        return Peak(index, found, middle + np.clip(rise * move / 2, 0.0, 8.0), 5 * found)

    def log_likelihood(self, reading: Array, parts: Array) -> Array:
        """ln p(reading | the other unknowns), (m, N), about: of bumps taken for Gaussian."""
        if self.table:
            told = self.table.quadratic(reading[:, None], self.middle(parts))
            return self.table.integral(self.table.likelihoods(told))
        m, count = parts.shape[:2]
        low = np.zeros(m, dtype=np.intp)
        width = self.widths(parts).min(axis=1)
        peak = self.search(self.curve(reading, parts), low, low + self.panels - 1, width, count)
        return np.asarray(peak.height + np.log(peak.width) + 0.5 * np.log(2 * np.pi))

    def widths(self, parts: Array) -> Array:
        """The least of the bumps' widths (...) at three places, as far as the lattice shows."""
        least = np.minimum.reduce([self.widths_at(parts, z) for z in (0.0, -2.0, 2.0)])
        return np.maximum(least, 2 * self.step)


def _less(z: Array) -> Array:
    """How much a misfit at z (J,) counts, (J, 1): the prior has hardly any mass far out."""
    return np.asarray(np.exp(-np.maximum(z**2 - 9, 0) / 4))[:, None]


class LastCurve:
    """ln of the density of the last unknown, at indices of the lattice.

    For readings (m, R) and nodes (m, N, S, D).
    """

    def __init__(self, lattice: LastSummed, reading: Array, parts: Array) -> None:
        self.lattice, self.reading, self.parts = lattice, reading, parts

    def __call__(self, index: Index) -> Array:
        """At indices (m, N, K)."""
        return self._of(self.reading[:, None, None], self.parts, index)

    def at(self, pair: Index, node: Index, index: Index) -> Array:
        """At indices (n, K) of pairs (n,) and their nodes (n,)."""
        return self._of(self.reading[pair, None], self.parts[pair, node], index)

    def turn(self, pair: Index, node: Index, index: Index) -> Array:
        """The angle over that at the middle, at the same."""
        return np.einsum("nkd,nd->nk", self.lattice.functions[index], self.parts[pair, node, -2])

    def _of(self, reading: Array, parts: Array, index: Index) -> Array:
        size = self.lattice.size
        signals = self.lattice.functions[index] @ parts.swapaxes(-1, -2)
        log = self.lattice.observer.noise.log_likelihood(reading, signals[..., :size])
        if self.lattice.turns:
            log = log + signals[..., size]
        return np.asarray(log + self.lattice.log_prior[index])


def within(
    low: Iterable[Array],
    high: Iterable[Array],
    reading: Iterable[Array],
    scales: tuple[float, float] | None,
) -> Flags:
    """Whether each number of a reading may lie between these; for one of the `scales` for all."""
    if scales is None:
        between = ((a <= y) & (y <= b) for a, y, b in zip(low, reading, high, strict=True))
        return reduce(np.logical_and, between)
    least, most = (np.asarray(scale) for scale in scales)
    for a, y, b in zip(low, reading, high, strict=True):
        with np.errstate(divide="ignore"):
            ends = a / y, b / y
        least, most = np.fmax(least, np.fmin(*ends)), np.fmin(most, np.fmax(*ends))
    return np.asarray(least <= most)


class AllUnknowns:
    """Every unknown has an axis of the tiles; nodes have the signals themselves."""

    panels, turns, unsure, scales = 1, False, 0.0, None

    def __init__(self, observer: Observer) -> None:
        self.observer, self.noise = observer, observer.noise
        self.dim = len(observer.unknowns)
        #: Most boxes: 120 000 in two dimensions, 20 000 in three.
        self.most = 720_000 // 6 ** (self.dim - 1)
        #: Contacts (..., U) at coordinates x, and ln of the prior.
        self.contact = observer.contact

    def signals(self, x: Array, contact: Array) -> tuple[Array, Flags]:
        """Signals (..., S) of contacts (..., U), and which are held."""
        signals, outcome = self.observer.signals(contact)
        held = outcome == Outcome.HELD
        return np.where(held[..., None], signals, 1.0), np.asarray(held)

    def views(self, signals: Array) -> list[tuple[Array, Array | None]]:
        """The signals; there is nothing left to know."""
        return [(signals, None)]

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
