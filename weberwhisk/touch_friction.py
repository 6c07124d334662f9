"""Rows of contacts whose friction is unknown, a touch its own, for many touches of one distance."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.polynomial import chebyshev
from scipy.special import ndtr

from .coordinates import leaps
from .mechanics.contact import Outcome
from .posterior.result import is_outside
from .touch_rows import Array, Index, TouchRows, highest


class FrictionRows(TouchRows):
    """Rows of contacts whose friction is unknown, and of each touch its own.

    There are too many contacts to keep. Of each row the signals are kept as polynomials of
    c = √(1 − share of the largest deflection), in which they are smooth up to the fold, and of the
    friction. For a row and a reading the rectangle of both is cut in two, where the signals change
    most, until none changes by more than `LONGEST` sd, and parts that the reading cannot be of are
    left out; what remains is summed by 6 × 6 of Gauss and Legendre's nodes each.
    """

    #: The longest parts, in sd: 3e-6 of an evidence off, and 2e-4 at 7.5; pairs at a time.
    LONGEST, AT_ONCE = 5.5, 400

    def _lay(self, at_once: int = 48, *, across: int = 24, terms: int = 9) -> None:
        """Coefficients (rows, S + 1, across, terms) of signals over the angle, and of its range."""
        observer = self.observer
        prior = observer.prior[observer.unknowns[-1]]
        self.low = observer.angle_range(self.r)[0]
        ends = np.array(prior.support())
        self.ends = np.where(np.isfinite(ends), ends, prior.ppf(ndtr([-6.0, 6.0])))
        nodes = [np.cos(np.pi * (np.arange(k) + 0.5) / k) for k in (across, terms)]
        fits = [np.linalg.inv(chebyshev.chebvander(t, len(t) - 1)) for t in nodes]
        c, last = (nodes[0] + 1) / 2, self._value((nodes[1] + 1) / 2)
        width = self._widths(self.r, last)
        values = self._signals(self.r[:, None, None], width[:, None], c[:, None], last)
        self.known = np.asarray(np.isfinite(values).all(axis=(1, 2, 3)))
        values[~self.known] = 1.0
        self.parts = np.einsum("ic,jp,ncps->nsij", *fits, values, optimize=True)
        self.ranges = width @ fits[1].T
        share, weight = np.polynomial.legendre.leggauss(16)
        last = self._value((share + 1) / 2)
        held = self._widths(self.r, last)
        if "deflection_angle" in observer.prior:
            angle = observer.prior["deflection_angle"]
            low = self.low
            held = angle.cdf(low + held) - angle.cdf(low)
        self.held = held @ (weight * prior.pdf(last)) * (self.ends[1] - self.ends[0]) / 2
        leaping = [leaps(prior), *observer.space.leaps.values()]
        self.coarse = self._misfit() > 0.03 or any(a.size for a in leaping)

    def _value(self, share: Array) -> Array:
        return self.ends[0] + (self.ends[1] - self.ends[0]) * share

    def _widths(self, r: Array, last: Array) -> Array:
        """Ranges (n, J) of the angle at distances (n,) and values (J,) of the unknown."""
        contact = np.ones((len(r), len(last), 3))
        contact[..., 0], contact[..., 2] = r[:, None], last
        return self.observer.space.angle_range(contact[..., 0], contact)[1]

    def _signals(self, r: Array, width: Array, c: Array, last: Array) -> Array:
        """Signals (..., S) over the angle, NaN where not held."""
        low = self.low
        theta = low + width * (1 - c**2)
        contact = np.stack(np.broadcast_arrays(r, theta, last), axis=-1)
        signals, outcome = self.observer.signals(contact)
        return np.where((outcome == Outcome.HELD)[..., None], signals, np.nan) / theta[..., None]

    def _misfit(self, count: int = 400) -> float:
        """How far off, in sd, the worst but one in twenty of contacts are."""
        rng = np.random.default_rng(20261123)
        row = rng.choice(np.flatnonzero(self.known), count)
        c, share = rng.uniform(0.02, 0.98, (2, count))
        last = self._value(share)
        box = np.column_stack([c, c, share, share])
        found, _ = self._felt(row, box, np.zeros(1))
        contact = np.stack([self.r[row], np.zeros(count), last], axis=-1)
        least, width = self.observer.space.angle_range(self.r[row], contact)
        contact[:, 1] = least + width * (1 - c**2)
        exact, outcome = self.observer.signals(contact)
        held = outcome == Outcome.HELD
        low, high = self.observer.noise.interval(exact[held], 0.5)
        found_low, found_high = self.observer.noise.interval(found[held, 0], 0.5)
        with np.errstate(all="ignore"):
            off = np.abs(found_low + found_high - low - high) / 2 / (high - low)
        return float(np.quantile(np.nan_to_num(off.max(axis=1), nan=np.inf), 0.95))

    def _felt(self, row: Index, box: Array, at: Array) -> tuple[Array, Array]:
        """Signals (m, J², S) in boxes (m, 4) of rows, at places −1 to 1 of either; contacts."""
        sides = [
            (box[:, [i]] + box[:, [i + 1]]) / 2 + (box[:, [i + 1]] - box[:, [i]]) / 2 * at
            for i in (0, 2)
        ]
        first, second = (
            chebyshev.chebvander(2 * side - 1, k - 1)
            for side, k in zip(sides, self.parts.shape[2:], strict=True)
        )
        felt = first[:, None] @ self.parts[row] @ second.swapaxes(1, 2)[:, None]
        felt = np.moveaxis(felt, 1, -1)
        share = 1 - sides[0][:, :, None] ** 2
        width = (second @ self.ranges[row][:, :, None]).swapaxes(1, 2)
        low = self.low
        contact = np.empty((*felt.shape[:3], 3))
        contact[..., 0] = self.r[row][:, None, None]
        contact[..., 1] = low + width * share
        contact[..., 2] = self._value(sides[1])[:, None]
        signals = felt * contact[..., 1:2]
        # The measure of c: dθ = 2 c width dc.
        measure = 2 * sides[0][:, :, None] * width
        flat = len(row), -1
        contact = np.concatenate([contact, measure[..., None]], axis=-1)
        return signals.reshape(*flat, signals.shape[-1]), contact.reshape(*flat, 4)

    def _leaves(
        self, reading: Array, row: Index, *, deepest: int = 60
    ) -> Iterator[tuple[Index, Array, Array, Array]]:
        """Pairs, contacts and ln of what they add, of nodes of readings (m, R) and rows (m,)."""
        at, weight = np.polynomial.legendre.leggauss(6)
        both = np.outer(weight, weight).ravel() / 4
        noise, prior = self.observer.noise, self.observer.prior
        pair, box = np.arange(len(row)), np.tile([0.0, 1.0, 0.0, 1.0], (len(row), 1))
        corner = np.arange(36).reshape(6, 6)
        angle = prior.get("deflection_angle")
        last = prior[self.observer.unknowns[-1]]
        sharpest = [0.0 if p is None else highest(p) for p in (angle, last)]
        for depth in range(deepest):
            if not pair.size:
                return
            signals, contact = self._felt(row[pair], box, at)
            low, high = noise.interval(signals, 6.0)
            low, high = low.min(axis=1), high.max(axis=1)
            room = 0.1 * (high - low)
            y = reading[pair]
            some = np.all((y >= low - room) & (y <= high + room), axis=1)
            pair, box, signals, contact = pair[some], box[some], signals[some], contact[some]
            if not pair.size:
                return
            low, high = noise.interval(signals, 0.5)
            unit, middle = (high - low).min(axis=1), (low + high) / 2
            change = []
            for i, ends in enumerate(((corner[0], corner[-1]), (corner[:, 0], corner[:, -1]))):
                turn = np.abs(middle[:, ends[1]] - middle[:, ends[0]]).max(axis=1)
                with np.errstate(all="ignore"):
                    part = np.nan_to_num(turn / unit, nan=0.0, posinf=1e9)
                own = contact[:, ends[1], i + 1] - contact[:, ends[0], i + 1]
                own = sharpest[i] * np.abs(own).max(axis=1)
                change.append(np.sqrt(np.square(part).sum(axis=1) + own**2) / 0.93)
            along = change[0] >= change[1]
            done = np.maximum(*change) <= (self.LONGEST if depth < deepest - 1 else np.inf)
            if done.any():
                log = noise.log_likelihood(reading[pair[done]][:, None], signals[done])
                side = box[done][:, [1, 3]] - box[done][:, [0, 2]]
                with np.errstate(divide="ignore"):
                    log = (
                        log
                        + np.log(side.prod(axis=1) * (self.ends[1] - self.ends[0]))[:, None]
                        + np.log(both)
                    )
                    log += np.log(np.maximum(contact[done][..., 3], 0.0))
                log += last.logpdf(contact[done][..., 2])
                if angle is not None:
                    log += angle.logpdf(contact[done][..., 1])
                yield pair[done], contact[done], signals[done], log
            pair, box, along = pair[~done], box[~done], along[~done]
            most = np.maximum(*change)[~done] / self.LONGEST
            pieces = np.clip(np.ceil(most), 2, 4).astype(np.intp)
            which = np.repeat(np.arange(len(pair)), pieces)
            piece = np.arange(len(which)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
            pair, box, each = pair[which], box[which], np.arange(len(which))
            split, pieces = np.where(along, 0, 2)[which], pieces[which]
            low = box[each, split]
            step = (box[each, split + 1] - low) / pieces
            box[each, split], box[each, split + 1] = low + piece * step, low + (piece + 1) * step

    def log_likelihood(self, reading: Array, rows: Index, stride: int = 1) -> Array:
        """ln p(reading | distance), (n, rows), of readings (n, R), all else integrated out.

        The same with any stride.
        """
        row, which = np.divmod(np.arange(len(rows) * len(reading)), len(reading))
        out = np.full(len(row), -np.inf)
        able = np.flatnonzero(self.known[rows][row])
        for part in np.array_split(able, max(1, len(able) // self.AT_ONCE)):
            found = list(self._leaves(reading[which[part]], rows[row[part]]))
            if found:
                pair = np.concatenate([f[0] for f in found])
                log = np.logaddexp.reduce(np.concatenate([f[3] for f in found]), axis=1)
                order = np.argsort(pair, kind="stable")
                pair, log = pair[order], log[order]
                begin = np.flatnonzero(np.diff(pair, prepend=-1))
                out[part[pair[begin]]] = np.logaddexp.reduceat(log, begin)
        out -= np.log(self.held[rows[row]])
        return np.nan_to_num(out, nan=-np.inf, neginf=-np.inf).reshape(len(rows), -1).T

    def best_contacts(self, reading: Array, row: int) -> tuple[Array, bool]:
        """The most probable contacts (n, U) at one distance; if any is 5 sd from its reading."""
        best = np.full(len(reading), -np.inf)
        contacts, felt = np.empty((len(reading), 3)), None
        for pair, contact, signals, log in self._leaves(reading, np.full(len(reading), row)):
            felt = np.ones((len(reading), signals.shape[-1])) if felt is None else felt
            for i, p in enumerate(pair):
                at = log[i].argmax()
                if log[i, at] > best[p]:
                    best[p], contacts[p], felt[p] = log[i, at], contact[i, at, :3], signals[i, at]
        if felt is None or not np.isfinite(best).all():
            return contacts[:0], True
        return contacts, bool(is_outside(self.observer.noise, reading, felt).any())
