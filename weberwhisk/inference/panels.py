"""Quadrature of one-dimensional posteriors, many readings at a time.

The signals do not depend on the reading. So the axis of x is cut once for each observer
into panels no longer than two JNDs, on which signals and noise are smooth, and both are stored at
the nodes of a Gauss–Kronrod rule. A reading then only weighs the nodes of those panels that it
could have come from.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.polynomial import legendre
from scipy.special import ndtr

from .._values import Array, Flags, Index
from ..mechanics.contact import Outcome
from .observer import Observer
from .result import IMPROBABLE, refuse_impossible


def _gauss_kronrod(count: int = 7) -> tuple[Array, Array, Array]:
    """Nodes of Kronrod's rule (2n + 1,), its weights and those of Gauss's rule among them.

    The n + 1 further nodes are the zeros of Stieltjes' polynomial: times Legendre's of degree n it
    is orthogonal to all powers up to n. (QUADPACK's qk15, with n = 7, to rounding.)
    """
    x, w = legendre.leggauss(2 * count)
    terms = legendre.legvander(x, count + 1)
    moments = (w * terms[:, count]) @ (terms[:, :, None] * terms[:, None]).reshape(len(x), -1)
    moments = moments.reshape(count + 2, count + 2)[: count + 1]
    stieltjes = np.append(np.linalg.lstsq(moments[:, :-1], -moments[:, -1], rcond=None)[0], 1.0)
    gauss, weights = legendre.leggauss(count)
    nodes = np.sort(np.concatenate([gauss, legendre.legroots(stieltjes).real]))
    kronrod = np.linalg.solve(legendre.legvander(nodes, 2 * count).T, [2.0] + [0.0] * 2 * count)
    among = np.zeros(len(nodes))
    among[1::2] = weights
    return nodes, np.asarray(kronrod, dtype=np.float64), among


NODES, KRONROD, GAUSS = _gauss_kronrod()
_TO_LEGENDRE = np.linalg.inv(legendre.legvander(NODES, 14))
#: Integral from −1 to each node of the interpolant through the nodes, (15, 15).
_RISE = (
    np.stack(
        [legendre.legval(NODES, legendre.legint(np.eye(15)[n], lbnd=-1)) for n in range(15)], axis=1
    )
    @ _TO_LEGENDRE
)

#: Sums by the rule of 15 and by that of 7, of nodes that are weighted by the first.
_RULES = np.stack([np.ones(15), GAUSS / KRONROD], axis=1)

#: A panel is weighed where the reading lies within this many sd of its signals …
WINDOW = 10.0
#: … and its middle is not this far (in ln) below the highest.
NEGLIGIBLE = 32.0


class _Window:
    """The panels on which a reading lies between bounds given at the nodes (panels, nodes, R).

    Panel j is among them where low_j ≤ y ≤ high_j. These bounds, made monotone from either end,
    give the first and the last such panel by bisection; panels between them come along.
    """

    def __init__(self, low: Array, high: Array) -> None:
        low, high = low.min(axis=1), high.max(axis=1)
        self.low = np.minimum.accumulate(low, axis=0)
        self.high = np.maximum.accumulate(high, axis=0)
        self.low_back = np.minimum.accumulate(low[::-1], axis=0)
        self.high_back = np.maximum.accumulate(high[::-1], axis=0)

    def __call__(self, reading: Array) -> tuple[Index, Index]:
        """First panel and one past the last, for readings (B, S)."""
        first, back = np.zeros((2, len(reading)), dtype=np.intp)
        for k, y in enumerate(reading.T):
            first = np.maximum(first, np.searchsorted(-self.low[:, k], -y))
            first = np.maximum(first, np.searchsorted(self.high[:, k], y))
            back = np.maximum(back, np.searchsorted(-self.low_back[:, k], -y))
            back = np.maximum(back, np.searchsorted(self.high_back[:, k], y))
        return first, len(self.low) - back


@dataclass(frozen=True, eq=False)
class PanelMoments:
    """Moments of the radial distance for B readings; errors are estimates."""

    mean: Array
    sd: Array
    mean_error: Array
    sd_error: Array
    log_evidence: Array
    improbable: Flags


class Panels:
    """The axis of one observer, cut into panels.

    Raises
    ------
    ValueError
        For an observer with more than one unknown.
    """

    def __init__(self, observer: Observer) -> None:
        if len(observer.unknowns) != 1:
            raise ValueError(
                f"Panels are for one unknown, got {', '.join(observer.unknowns)}; "
                'write method="quadrature" and let posterior() choose.'
            )
        self.observer = observer
        edges = self._edges()
        left, right = edges[:-1], edges[1:]
        kept: list[tuple[Array, Array]] = []
        for _ in range(40):  # a kink (a saturated receptor) is closed in by halving
            long = self._too_long(left, right)
            kept.append((left[~long], right[~long]))
            left, right = left[long], right[long]
            middle = (left + right) / 2
            left, right = np.concatenate([left, middle]), np.concatenate([middle, right])
            if not left.size:
                break
        left, right = (np.concatenate(part) for part in zip(*kept, (left, right), strict=True))
        order = np.argsort(left)
        self.left, self.half = left[order], (right - left)[order] / 2
        x = self.left[:, None] + self.half[:, None] * (NODES + 1)
        contact, log_prior = observer.contact(x.reshape(-1, 1))
        self.r = contact.reshape(x.shape)
        signals, outcome = observer.signals(contact)
        held = outcome == Outcome.HELD
        signals = np.where(held[:, None], signals, 1.0).reshape(*x.shape, -1)
        log_prior = np.where(held, log_prior, -np.inf).reshape(x.shape)
        self.log_weight = log_prior + np.log(self.half[:, None] * KRONROD)
        #: ln p of a reading as good as the mean, about: what a middle's own is held against.
        spread = observer.noise.resolution(signals[:, 7])[1]
        self._usual = -np.log(np.maximum(spread, 1e-300) * np.sqrt(2 * np.pi)).sum(axis=-1)
        #: ln p(reading | each node) and ln p(reading | each middle), for readings and panels.
        self._at_nodes = observer.noise.prepared(signals)
        self._at_middle = observer.noise.prepared(signals[:, 7])
        self._plausible = _Window(*observer.noise.interval(signals, WINDOW))
        low, high = observer.noise.interval(signals, IMPROBABLE)
        #: What readings each panel makes probable, (panels, R).
        self._lowest, self._highest = low.min(axis=1), high.max(axis=1)

    @property
    def middles(self) -> Array:
        """Coordinates (P, 1) of the panels' middles: no place is farther off than a JND."""
        return np.asarray((self.left + self.half)[:, None])

    def _edges(self) -> Array:
        """First cuts in x: finer where the tip is near, and half an sd apart under a prior."""
        # From r = 1e-8 of the reach to 1 − 4e-15 of it: beyond, there is no mass to speak of.
        low, high = -3.6, 4.2
        cuts = np.concatenate([np.linspace(low, 0, 15), np.linspace(0, high, 17)])
        prior = self.observer.prior.get("radial_distance")
        if prior is not None:
            leaps = self.observer.space.leaps["radial_distance"]
            r = np.append(prior.ppf(ndtr(np.linspace(-8, 8, 33))), leaps)
            near, far = self.observer.reach
            inside = r[np.isfinite(r) & (r > near) & (r < far)]
            cuts = np.concatenate([cuts, self.observer.coordinates(inside[:, None])[:, 0]])
        return np.unique(np.clip(cuts, low, high))

    def _too_long(
        self, left: Array, right: Array, *, longest: float = 2.0, shortest: float = 1e-6
    ) -> Flags:
        """Panels longer than so many JNDs, or on which signals or noise are not smooth.

        None with a half-length below the shortest: a kink is close enough, its square is the error.
        """
        half = (right - left) / 2
        x = left[:, None] + half[:, None] * (NODES + 1)
        contact, _ = self.observer.contact(x.reshape(-1, 1))
        signals, outcome = self.observer.signals(contact)
        held = outcome == Outcome.HELD
        mean, sd = self.observer.noise.resolution(np.where(held[:, None], signals, 1.0))
        features = np.concatenate([mean / sd, np.log(sd)], axis=-1)
        features = np.where(held[:, None], features, 0.0).reshape(*x.shape, -1)
        # The readings' way across the panel in units of their sd: the length in JNDs.
        size, unit = np.abs(mean) + sd, sd / (np.abs(mean) + sd)
        steps = np.abs(np.diff(np.log(size).reshape(*x.shape, -1), axis=1))
        steps = steps / unit.reshape(*x.shape, -1)[:, :-1]
        length = np.sqrt(np.square(steps).sum(axis=-1)).sum(axis=1)
        tail = np.abs(np.einsum("ni,pif->pnf", _TO_LEGENDRE[-3:], features)).sum(axis=1)
        # What the last bit of r does to them is not roughness: at a cone's tip signals vanish.
        r = contact.reshape(x.shape)
        slope = (
            np.abs(np.diff(features, axis=1))
            / np.maximum(np.diff(r, axis=1), np.spacing(r[:, 1:]))[..., None]
        )
        rounding = 100 * np.spacing(r[:, -1:]) * slope.max(axis=1)
        rough = (tail > 1e-9 + rounding).any(axis=-1)
        return ((length > longest) | rough) & (half > shortest)

    def _window(self, reading: Array) -> tuple[Index, Index]:
        """First panel and one past the last in which each reading (B, S) has mass."""
        count = len(self.left)
        first, last = self._plausible(reading)
        nothing = first >= last
        first, last = np.where(nothing, 0, first), np.where(nothing, count, last)
        # Of these, keep what has mass: the middles of the panels tell.
        starts, row, panel = _pairs(first, last)
        at_middle = self._at_middle(reading[row], panel)
        # Where nothing here is near the reading, what is beyond the window, correlated or in other
        # signals, may be as near.
        far = NEGLIGIBLE - WINDOW**2 / 2
        astray = np.maximum.reduceat(at_middle - self._usual[panel], starts) < far
        if (astray & ~nothing).any():
            first, last = np.where(astray, 0, first), np.where(astray, count, last)
            starts, row, panel = _pairs(first, last)
            at_middle = self._at_middle(reading[row], panel)
        log = self.log_weight[panel, 7] + at_middle
        top = np.maximum.reduceat(log, starts)
        refuse_impossible(reading, top)
        slight = log < top[row] - NEGLIGIBLE
        first = np.minimum.reduceat(np.where(slight, count, panel), starts)
        last = np.maximum.reduceat(np.where(slight, -1, panel), starts) + 1
        return np.maximum(first - 1, 0), np.minimum(last + 1, count)

    def ends(self, reading: Array) -> tuple[Array, Array]:
        """Between which x (B,) readings (B, S) have mass."""
        first, last = self._window(reading)
        return self.left[first], self.left[last - 1] + 2 * self.half[last - 1]

    def moments(self, reading: Array, *, rows: int = 128) -> PanelMoments:
        """Moments of r for readings (B, S)."""
        if self.observer.noise.is_categorical and len(reading) > 1:
            # Few things can happen: each is weighed once.
            reading, back = np.unique(reading, axis=0, return_inverse=True)
            of_each = self._in_parts(reading, rows)
            return PanelMoments(*(column[back.reshape(-1)] for column in of_each))
        return PanelMoments(*self._in_parts(reading, rows))

    def _in_parts(self, reading: Array, rows: int) -> list[Any]:
        """The columns of `PanelMoments`, of few readings at a time."""
        parts = [self._moments(reading[i : i + rows]) for i in range(0, len(reading), rows)]
        return [np.concatenate(column) for column in zip(*parts, strict=True)]

    def _weigh(self, reading: Array) -> tuple[Index, Index, Index, Array, Array]:
        """`_pairs` of readings and panels, their nodes' weights (n, 15), ln of the largest.

        Weights are over the largest of their reading.
        """
        starts, row, panel = _pairs(*self._window(reading))
        log = self._at_nodes(reading[row], panel)
        log += self.log_weight[panel]
        top = np.maximum.reduceat(log.reshape(-1), starts * 15)
        log -= top[row, None]
        return starts, row, panel, np.exp(log, out=log), top

    def _moments(self, reading: Array) -> tuple[Any, ...]:
        starts, row, panel, weight, top = self._weigh(reading)
        of_panels = weight @ _RULES
        mass = np.add.reduceat(of_panels, starts).T
        # Squares are of distances from near the mean, so that their sums do not cancel.
        origin = np.add.reduceat(of_panels[:, 0] * self.r[panel, 7], starts) / mass[0]
        d = self.r[panel] - origin[row, None]
        first = np.add.reduceat((weight * d) @ _RULES, starts).T / mass
        second = np.add.reduceat((weight * d * d) @ _RULES, starts).T / mass
        mean, mean_7 = origin + first
        sd, sd_7 = np.sqrt(np.maximum(second - first**2, 0.0))
        # QUADPACK's rule for what the error of the 15 points is, given that of the 7.
        errors = [
            np.minimum((200 * np.abs(a - b) / sd) ** 1.5, 1.0) * sd
            for a, b in ((mean, mean_7), (sd, sd_7))
        ]
        beyond = self._beyond(row, panel, weight, len(reading)) / mass[0]
        errors = [np.maximum(error, beyond * sd) for error in errors]
        y = reading[row]
        probable = ((self._lowest[panel] <= y) & (y <= self._highest[panel])).all(axis=1)
        improbable = ~np.logical_or.reduceat(probable, starts)
        return mean, sd, *errors, np.log(mass[0]) + top, improbable

    def _beyond(self, row: Index, panel: Index, weight: Array, count: int) -> Array:
        """The mass beyond the ends of the axis, were the density of r to stay what it is there."""
        out = np.zeros(count)
        for end, node in ((0, 0), (len(self.left) - 1, 14)):
            here = panel == end
            x = self.left[end] + self.half[end] * (NODES[node] + 1)
            # r is e to the power of sinh x, out there.
            scale = KRONROD[node] * self.half[end] * np.cosh(x)
            out[row[here]] += weight[here, node] / scale
        return out

    def quantiles(self, reading: Array, probability: Array, *, rows: int = 512) -> Array:
        """Quantiles (B, Q) of r for readings (B, S), at probabilities (B, Q) or (Q,)."""
        probability = np.broadcast_to(probability, (len(reading), np.shape(probability)[-1]))
        out = np.empty(probability.shape)
        for start in range(0, len(reading), rows):
            part = slice(start, start + rows)
            out[part] = self._invert(*self._weigh(reading[part])[:4], probability[part])
        return out

    def _invert(
        self, starts: Index, row: Index, panel: Index, weight: Array, probability: Array
    ) -> Array:
        """Quantiles (B, Q): the cumulative mass at every node, inverted in x.

        Rows lie one above the other, from 2i to 2i + 1, so that one search serves all.
        """
        density = weight / KRONROD
        mass = weight.sum(axis=1)
        total = np.add.reduceat(mass, starts)[row]
        before = np.cumsum(mass)
        before = before - mass - (before - mass)[starts][row]
        x = self.left[panel, None] + self.half[panel, None] * (NODES + 1)
        rise = (before[:, None] + density @ _RISE.T) / total[:, None]
        rise = np.maximum.accumulate((np.clip(rise, 0.0, 1.0) + 2 * row[:, None]).reshape(-1))
        step = (density / (total * self.half[panel])[:, None]).reshape(-1)
        asked = probability + 2 * np.arange(len(starts))[:, None]
        # Never before the first node of a reading, nor beyond its last.
        ends = np.append(starts[1:], len(panel)) * 15 - 2
        place = np.searchsorted(rise, asked) - 1
        place = np.clip(place, starts[:, None] * 15, ends[:, None])
        return _hermite_inverse(x.reshape(-1), rise, step, asked, place, self.observer)


@lru_cache(maxsize=32)
def panels_of(observer: Observer) -> Panels:
    """The panels of an observer, kept for its next readings."""
    return Panels(observer)


def _pairs(first: Index, last: Index) -> tuple[Index, Index, Index]:
    """Where each row's pairs start, and the row and the panel of every pair."""
    counts = last - first
    starts = np.cumsum(counts) - counts
    row = np.repeat(np.arange(len(counts)), counts)
    return starts, row, np.arange(len(row)) + (first - starts)[row]


def _hermite_inverse(
    x: Array,
    cumulative: Array,
    density: Array,
    probability: Array,
    k: Index,
    observer: Observer,
) -> Array:
    """r at which the cumulative mass past node k reaches each probability (...).

    Cubic between nodes, bisected.
    """
    h = x[k + 1] - x[k]
    low, high = np.zeros_like(probability), np.ones_like(probability)
    for _ in range(52):
        t = (low + high) / 2
        value = (
            (1 + 2 * t) * (1 - t) ** 2 * cumulative[k]
            + t**2 * (3 - 2 * t) * cumulative[k + 1]
            + h * t * (1 - t) * ((1 - t) * density[k] - t * density[k + 1])
        )
        below = value < probability
        low, high = np.where(below, t, low), np.where(below, high, t)
    return observer.contact((x[k] + h * (low + high) / 2)[..., None])[0][..., 0]
