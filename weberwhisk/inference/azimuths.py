"""Contacts of a curved whisker in space: a grid for each azimuth from its plane of curvature.

All signals tell of distance, deflection and azimuth, and tiles of the three would be too many. At
an azimuth from the plane of curvature, though, distance and deflection are one bump, whose highest
point Fisher scoring finds and about which a plain grid lies. Such slices stand at even steps all
around, wherever there is mass: no peak needs to be told from another, and a circle has no ends. An
unknown roll is one turn of signals that are known, and is summed out at each node about the bump
that goes with it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
from typing import Any, NamedTuple

import numpy as np
from scipy.special import erf, expit, logsumexp, ndtri

from .._values import Array, Codes, Index
from ..cues.unknowns import Conditioned, UnknownRoll
from ..mechanics.contact import Outcome
from .coordinates import ContactCoordinates, family, from_normal
from .grid import OwnGrids, integrate, weighted_quantiles
from .laplace import climb
from .observer import Observer
from .tiled import Moments

FULL = 2 * np.pi


class Around:
    """An observer's contacts in coordinates q (..., 3) or, where the roll is unknown, (..., 4).

    Of distance and deflection as ever; the roll less its middle, in units of `scale`; and t, the
    azimuth from the plane of curvature. Where the azimuth has a prior with ends, t is its
    coordinate.
    """

    def __init__(self, observer: Observer) -> None:
        self.observer, self.noise = observer, observer.noise
        self.rolls = "roll" in observer.unknowns
        self.whisker: Any = observer.whisker
        cue: Any = observer.cue
        while isinstance(cue, Conditioned) and not isinstance(cue, UnknownRoll):
            self.whisker, cue = cue._under(self.whisker), cue.cue  # of a known friction, say
        self.map = cue.cue if self.rolls else cue
        self.middle = float(self.map.roll)
        self.spread = float(cue.spread) if self.rolls else 0.0
        self.scale = min(self.spread, 1.0)
        self.ends = None if _goes_around(observer) else from_normal(observer.prior["azimuth"])
        around = {"azimuth": self.map.priors(self.whisker)["azimuth"]}
        self.unknowns, self.bounded = observer.unknowns, 2
        self.prior = {n: observer.prior[n] for n in observer.prior if n in observer.unknowns[:2]}
        plane = self.map.__class__(self.map.signal_names)  # not rolled
        self.space = ContactCoordinates(self.whisker, plane, around | self.prior)
        self.dim = 4 if self.rolls else 3
        #: Curvature of ln prior in q, about.
        roll = [(self.scale / self.spread) ** 2] if self.rolls else []
        self.precision = np.diag([0.25, 0.25, *roll, 0.1 if self.ends is None else 1.0])

    def plane(self, t: Array) -> Array:
        """Azimuths (...) from the plane of curvature."""
        return t if self.ends is None else self.ends(t) - self.middle

    def place(self, x: Array, t: Array) -> tuple[Array, Array]:
        """Distance, deflection and azimuth from the plane (..., 3), and ln prior, at x (..., 2)."""
        plane = np.broadcast_to(self.plane(t), x.shape[:-1])
        turn = (plane + np.pi) % FULL / FULL
        z = ndtri(np.clip(turn, 1e-15, 1 - 1e-15))
        contact, log = self.space.constrain(np.concatenate([x, z[..., None]], axis=-1))
        for i, name in enumerate(self.observer.unknowns[:2]):
            if name in self.prior:
                log = log + self.prior[name].logpdf(contact[..., i])
        contact[..., 2] = plane
        flat = self.ends is None
        return contact, log - (np.log(FULL) if flat else 0.5 * (t**2 + np.log(FULL)))

    def log_roll(self, v: Array) -> Array:
        """ln of the prior of v (...), the roll in its coordinate."""
        if not self.rolls:
            return np.zeros(np.shape(v))
        off = (self.scale * v + np.pi) % FULL - np.pi
        cut = erf(np.pi / self.spread / np.sqrt(2))
        unit = np.log(self.scale / (self.spread * np.sqrt(FULL) * cut))
        return np.asarray(unit - 0.5 * (off / self.spread) ** 2)

    def contact(self, q: Array) -> tuple[Array, Array]:
        """Distance, deflection, azimuth from the plane, and azimuth (..., 4); ln prior (...)."""
        place, log = self.place(q[..., :2], q[..., -1])
        v = q[..., 2] if self.rolls else np.zeros(q.shape[:-1])
        azimuth = place[..., 2] + self.middle + self.scale * v
        return np.concatenate([place, azimuth[..., None]], axis=-1), log + self.log_roll(v)

    def signals(self, contact: Array) -> tuple[Array, Codes]:
        """Signals and outcome of contacts (..., 4) as above."""
        return self.felt(contact[..., :3])(contact[..., 3])

    def felt(self, place: Array) -> Any:
        """The signals of places (..., 3) as a function of the azimuth."""
        model = self.observer.solver
        return self.map.from_plane(self.whisker, place, model=model)

    @cached_property
    def directions(self) -> list[int]:
        """Which signals are directions that are read to whole turns."""
        if self.ends is not None or not self.noise.reads_signals:
            return []
        return [i for i, name in enumerate(self.map.signal_names) if "_direction" in name]

    def off(self, reading: Array) -> Array:
        """How far the first direction of readings (B, R) is from the middle of the roll, rad."""
        if not self.directions:
            return np.zeros(len(reading))
        return np.asarray(reading[:, self.directions[0]] - self.middle)

    @cached_property
    def scattered(self) -> tuple[Array, Array, Array]:
        """Coordinates (n, T, M, U) all over, by t and rolls, signals and ln of the prior there."""
        x = np.unique(self.space.spread(expit(np.linspace(-4, 4, 12)), others=2)[:, :2], axis=0)
        # To a whole turn either way, for directions that are read in another turn than their t.
        t = np.linspace(-2.5, 2.5, 25) if self.ends is not None else np.arange(-24, 25) * FULL / 24
        most = min(3 * self.scale, np.pi) if self.scale < 1 else np.pi
        rolls = np.linspace(-most, most, 2 * int(most / 0.2) + 1) / max(self.scale, 1e-300)
        shape = len(x), len(t), len(rolls) if self.rolls else 1
        q = np.empty((*shape, self.dim))
        q[..., :2], q[..., -1] = x[:, None, None], t[:, None]
        if self.rolls:
            q[..., 2] = rolls
        place, log = self.place(q[:, :, :1, :2], q[:, :, :1, -1])
        v = q[..., 2] if self.rolls else np.zeros(shape)
        signals, outcome = self.felt(place)(place[..., 2] + self.middle + self.scale * v)
        held = outcome == Outcome.HELD
        log = np.where(held, log + self.log_roll(v), -np.inf)
        return q, np.where(held[..., None], signals, 1.0), log


def _goes_around(observer: Observer) -> bool:
    """Whether the azimuth's prior is flat, all around."""
    prior = observer.prior["azimuth"]
    name = getattr(getattr(prior, "dist", None), "name", None)
    return name == "uniform" and bool(np.isclose(np.ptp(prior.support()), FULL))


@lru_cache(maxsize=64)
def around(observer: Observer) -> Around | None:
    """The coordinates of an observer whose contacts can be cut so, with those that it keeps."""
    known = observer.unknowns == ("radial_distance", "deflection_angle", "azimuth")
    if not known:
        if observer.unknowns[2:] != ("azimuth", "roll") or not _goes_around(observer):
            return None
        usual = observer.cue.priors(observer.whisker)["roll"]
        if family(observer.prior["roll"]) != family(usual):
            return None
    return Around(observer)


class Start(NamedTuple):
    """Where a reading (R,) is looked for.

    The reading with its directions turned by whole turns so that they are near the middle of the
    roll, and by how much; the highest points (n, U), ln of the density there and widths in t (n,);
    and the best of `Around.scattered` at each of its t, (T, U).
    """

    reading: Array
    turned: float
    peaks: Array
    height: Array
    width: Array
    best: Array


def starts(frame: Around, reading: Array) -> Iterator[Start]:
    """Of each of readings (B, R): the best of thirds of the distances and of sectors of t climb."""
    q, signals, log = frame.scattered
    n, turns, _ = log.shape
    off, near = FULL * np.round(frame.off(reading) / FULL), reading.copy()
    near[:, frame.directions] -= off[:, None]
    thirds, sectors = np.array_split(np.arange(n), 3), np.array_split(np.arange(turns), 12)
    parts = [np.ix_(i, j) for i in thirds for j in sectors]
    rows = max(1, 2_000_000 // log.size)
    for first in range(0, len(near), rows):
        some = near[first : first + rows]
        table = frame.noise.log_likelihoods(some, signals.reshape(-1, signals.shape[-1]))
        table = table.reshape(-1, *log.shape) + log
        begin = [_best(q[part], one[part]) for one in table for part in parts]
        x, top, covariance = climb(
            frame, np.repeat(some, len(parts), axis=0), np.array(begin), 1e-4, 60, frame.precision
        )
        width = np.sqrt(covariance[:, -1, -1])
        for k in range(len(some)):
            own = slice(k * len(parts), (k + 1) * len(parts))
            best = np.array([_best(q[:, j], table[k, :, j]) for j in range(turns)])
            yield Start(some[k], float(off[first + k]), x[own], top[own], width[own], best)


def _best(q: Array, height: Array) -> Array:
    return np.asarray(q.reshape(-1, q.shape[-1])[height.argmax()])


class Slices(NamedTuple):
    """Of which steps of t (B,): ln of the mass, how far off sums are in sds, and the nodes (K, …).

    Of those the slice, the contact with all unknowns, and the share of the slice's mass.
    """

    at: Index
    log_mass: Array
    error: Array
    whose: Index
    contact: Array
    weight: Array


@dataclass(frozen=True)
class _Bumps:
    """Of slices at t (B,): where distance and deflection are, (B, 2), roots (B, 2, 2) of their
    covariances; the roll that goes with that, its slope to them (B, 2), and steps (B,) about it.
    """

    frame: Around
    reading: Array
    t: Array
    centre: Array
    root: Array
    roll: Array
    slope: Array
    gap: Array
    rolls: int

    def nodes(self, u: Array, i: Index) -> tuple[Array, Array, Array]:
        """Contacts (b, N, 3), azimuths and ln of the density (b, N, J) at points (b, N, 2)."""
        frame = self.frame
        off = u @ self.root[i].swapaxes(1, 2)
        place, log = frame.place(self.centre[i, None] + off, self.t[i, None])
        v = self.roll[i, None] + np.einsum("bni,bi->bn", off, self.slope[i])
        steps = np.arange(self.rolls) - (self.rolls - 1) / 2
        v = v[..., None] + self.gap[i, None, None] * steps
        azimuth = place[..., 2, None] + frame.middle + frame.scale * v
        signals, outcome = frame.felt(place[..., None, :])(azimuth)
        held = outcome == Outcome.HELD
        value = frame.noise.log_likelihood(self.reading, np.where(held[..., None], signals, 1.0))
        value = value + frame.log_roll(v) + log[..., None] + np.log(self.gap)[i, None, None]
        return place, azimuth, np.where(held, value, -np.inf)

    def density(self, some: Index, u: Array, index: Index) -> Array:
        """ln of the density (b, N), the roll summed out, of some of the slices."""
        return np.asarray(logsumexp(self.nodes(u, some[index])[2], axis=-1))

    def spread(self, i: Index, u: Array, weight: Array) -> tuple[Index, Array, Array]:
        """Nodes (b, N, 2) of slices (b,) that have weight, with the roll: as in `Slices`."""
        size = int((weight > 1e-8 * weight.max(axis=1, keepdims=True)).sum(axis=1).max())
        order = np.argsort(-weight, axis=1)[:, :size]
        u, weight = np.take_along_axis(u, order[..., None], 1), np.take_along_axis(weight, order, 1)
        place, azimuth, log = self.nodes(u, i)
        share = np.exp(log - log.max(axis=2, keepdims=True, initial=-1e300))
        share *= (weight / share.sum(axis=2))[..., None]
        columns = [np.broadcast_to(place[..., k, None], azimuth.shape) for k in (0, 1)]
        columns += [azimuth, azimuth - place[..., 2, None]][: self.frame.dim - 2]
        some = share > 1e-9
        whose = np.broadcast_to(i[:, None, None], share.shape)[some]
        return whose, np.stack([c[some] for c in columns], axis=-1), share[some]

    def move(self, i: Index, mean: Array, u: Array, weight: Array) -> None:
        """Have points be about the means (b, 2) of slices (b,), as wide as those are."""
        off = u - mean[:, None]
        # All may be on one node: the next grid is a tenth as wide, then.
        covariance = np.einsum("bn,bni,bnj->bij", weight, off, off) + 0.01 * np.eye(2)
        moved = np.einsum("bij,bj->bi", self.root[i], mean)
        self.roll[i] += np.einsum("bi,bi->b", self.slope[i], moved)
        self.centre[i] += moved
        self.root[i] = np.linalg.cholesky(self.root[i] @ covariance @ self.root[i].swapaxes(1, 2))


def _bumps(frame: Around, start: Start, t: Array) -> _Bumps:
    """The bumps at t (B,): Fisher scoring climbs at each from the best that is known nearby."""
    columns = frame.scattered[0][0, :, 0, -1]
    begin = start.best[np.abs(columns - t[:, None]).argmin(axis=1)]
    begin[:, -1] = t
    still = frame.precision.copy()
    still[-1, -1] = 1e12
    x, _, cov = climb(frame, np.tile(start.reading, (len(t), 1)), begin, 1e-6, 40, still)
    root = np.asarray(np.linalg.cholesky(cov[:, :2, :2]))
    if not frame.rolls:
        none = np.zeros_like(t)
        return _Bumps(frame, start.reading, t, x[:, :2], root, none, 0 * x[:, :2], none + 1, 1)
    slope = np.asarray(np.linalg.solve(cov[:, :2, :2], cov[:, :2, 2:3])[..., 0])
    width = np.sqrt(cov[:, 2, 2] - np.einsum("bi,bi->b", slope, cov[:, :2, 2]))
    # So many steps go far enough to either side, or else all around.
    gap = np.minimum(1.1 * width, FULL / 13 / frame.scale)
    return _Bumps(frame, start.reading, t, x[:, :2].copy(), root, x[:, 2].copy(), slope, gap, 13)


class AroundGrid(OwnGrids):
    """The posterior of one reading.

    Parameters
    ----------
    frame : Around
    start : Start
    wide : float
        How far grids of a slice may go, in sds.
    """

    def __init__(self, frame: Around, start: Start, *, wide: float = 12.0) -> None:
        self.frame, self.start, self.wide = frame, start, wide
        self.observer = frame.observer
        tops = start.height > start.height.max() - 14
        low, length = -6.5, 13.0
        if frame.ends is None:
            low, length = float(frame.off(start.reading[None])[0]) - np.pi, FULL
        step = min(float(start.width[tops].min()) / 2.5, length / 48)
        self.count = 2 * int(np.ceil(length / step / 2))
        self.low, self.step = low, length / self.count
        about = start.peaks[tops, -1] + np.linspace(-6, 6, 31)[:, None] * start.width[tops]
        wanted = self._index((about.ravel() - low) / self.step)
        parts: list[Slices] = []
        for _ in range(5):
            while wanted.size:
                for i in range(0, wanted.size, 64):
                    parts = [_joined([*parts, self._slices(wanted[i : i + 64])])]
                mass = parts[0].at[parts[0].log_mass > parts[0].log_mass.max() - 13]
                wanted = self._index(mass[:, None] + np.arange(-3, 4))
                wanted = np.setdiff1d(wanted, parts[0].at)
            found = parts[0]
            off_by, contact, weight = self._sum(found)
            if off_by < 2e-3:
                break
            # Twice as many, where there is mass.
            self.count, self.step = 2 * self.count, self.step / 2
            parts = [found._replace(at=2 * found.at)]
            wanted = self._index(2 * mass[:, None] + [-1, 1])
        self._keep(found, contact, weight)

    def _index(self, at: Array) -> Index:
        """Slices nearest to places on the lattice."""
        index = np.rint(at).astype(np.intp).ravel()
        if self.frame.ends is None:
            return np.unique(index % self.count)
        return np.unique(np.clip(index, 0, self.count))

    def _slices(self, index: Index) -> Slices:
        """Distance, deflection and roll summed at steps of t: a grid about each highest point.

        Closer nodes, about the mean, where they do not do.
        """
        bumps = _bumps(self.frame, self.start, np.asarray(self.low + self.step * index))
        log_mass, error = np.full((2, len(index)), -np.inf)
        parts = []
        left = np.arange(len(index))
        for fine in (25, 35, 51):
            ends = np.full((len(left), 2), self.wide)
            found = integrate(
                partial(bumps.density, left), -ends, ends, depth=20.0, looks=1, nodes=(19, fine)
            )
            known = np.isfinite(found.log_evidence)
            weight = np.where(known[:, None], found.weights, 0.0)
            at_end = (weight * (np.abs(found.points) > 0.9 * self.wide).any(axis=2)).sum(axis=1)
            off_by = found.error.max(axis=1) + self.wide * at_end
            logs = found.log_evidence + np.linalg.slogdet(bumps.root[left])[1]
            log_mass[left] = np.where(known, logs, -np.inf)
            error[left] = np.where(known, off_by, 0.0)
            good = known & (at_end < 1e-6) & (found.sd.max(axis=1) < 2) & (off_by < 1e-3)
            rows = np.flatnonzero(good | (known & (fine == 51)))
            if rows.size:
                parts.append(bumps.spread(left[rows], found.points[rows], weight[rows]))
            rows = np.flatnonzero(known & ~good)
            left = left[rows]
            if not left.size:
                break
            if fine < 51:
                bumps.move(left, found.mean[rows], found.points[rows], weight[rows])
        nodes = (np.concatenate(column) for column in zip(*parts, strict=True))
        return Slices(index, log_mass, error, *nodes)

    def _sum(self, found: Slices) -> tuple[float, Array, Array]:
        """Sums over all slices; how far off steps of t leave them, by every other one; nodes."""
        frame = self.frame
        top = found.log_mass.max()
        mass = np.exp(found.log_mass - top)
        weight = mass[found.whose] * found.weight
        contact = found.contact.copy()
        contact[:, 2] += self.start.turned
        if frame.ends is None:
            circle = np.angle(weight @ np.exp(1j * contact[:, 2]))
            middle = self.observer.prior["azimuth"].median()
            if frame.directions:
                middle = self.start.reading[frame.directions[0]] + self.start.turned
            circle += FULL * np.round((middle - circle) / FULL)
            half = np.pi * np.round(circle / np.pi)
            contact[:, 2] -= FULL * np.round((contact[:, 2] - half) / FULL)
        if frame.rolls:
            contact[:, 3] -= FULL * np.round((contact[:, 3] - frame.middle) / FULL)
        weight = weight / weight.sum()
        mean = weight @ contact
        sd = np.sqrt(weight @ (contact - mean) ** 2)
        error = np.zeros(frame.dim)
        for side in (0, 1):
            half = weight * (found.at[found.whose] % 2 == side)
            half /= half.sum()
            other = half @ contact
            width = np.sqrt(half @ (contact - other) ** 2)
            error = np.maximum(error, np.maximum(np.abs(other - mean), np.abs(width - sd)) / sd)
        steps = np.where(error < 0.1, error**1.5, error)
        error = steps + 1e-6 + mass @ found.error / mass.sum()
        self.error = error[None]
        best = contact[[weight.argmax()]]
        signals = np.nan_to_num(self.observer.signals(best)[0], nan=1.0)
        if frame.ends is None:  # inside its prior
            first = self.observer.prior["azimuth"].support()[0]
            best[:, 2] = first + (best[:, 2] - first) % FULL
        log_evidence = np.array([top + np.log(mass.sum() * self.step)])
        none = np.zeros(1)
        self.moments = Moments(
            mean[None], sd[None], log_evidence, weight.max(keepdims=True), best, signals, none, none
        )
        return float(steps.max()), contact, weight

    def _keep(self, found: Slices, contact: Array, weight: Array, *, bins: int = 2000) -> None:
        """Marginals in narrow bins, and draws: nodes themselves would be megabytes a reading."""
        self.marginals = []
        for value in contact.T:
            edges = np.linspace(value.min(), value.max(), bins)
            whose = np.searchsorted(edges, value)
            mass = np.bincount(whose, weight)
            some = mass > 0
            middle = np.bincount(whose, weight * value)[some] / mass[some]
            self.marginals.append((middle, mass[some]))
        rng = np.random.default_rng(20261123)
        rise = np.cumsum(weight)
        at = np.searchsorted(rise, (np.arange(8000) + rng.random(8000)) / 8000 * rise[-1])
        self.drawn = contact[at]
        if not self.frame.rolls:  # else azimuths are not those of the slices
            t = self.low + self.step * found.at[found.whose[at]]
            beside = t + self.step * (rng.random(t.size) - 0.5)
            self.drawn[:, 2] += self.frame.plane(beside) - self.frame.plane(t)

    def quantiles(self, p: Array, unknown: int) -> tuple[Array, Array]:
        """Quantiles (1, Q) and their errors."""
        value, error = weighted_quantiles(*self.marginals[unknown], p)
        return value[None], error[None]

    def draws(self, count: int, rng: np.random.Generator) -> Array:
        """Contacts (1, count, U), drawn from what is kept."""
        return self.drawn[None, rng.choice(len(self.drawn), count, replace=count > len(self.drawn))]


def _joined(parts: list[Slices]) -> Slices:
    """All slices, the nodes of each pointing to theirs."""
    if len(parts) == 1:
        return parts[0]
    first, second = parts
    second = second._replace(whose=second.whose + len(first.at))
    return Slices(*(np.concatenate(pair) for pair in zip(first, second, strict=True)))
