"""The place of an object, from all whiskers that touch it and all that do not.

The posterior of a place is summed on an adaptive grid: cells cut in four until their sums agree.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import islice, product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from .._util import checks
from .._util.values import Array, Flags, Shown, pd, weighted_quantiles
from ..inference import Status
from ..inference.weighted import Spans
from ..receptors import Seed
from .evidence import JointEvidence, one_place
from .observer import ArrayObserver, Readings

__all__ = ["ArrayObserver", "Place", "place"]


def place(
    observer: ArrayObserver, readings: Readings, *, tolerance: float = 2e-3, seed: Seed = 1
) -> Place:
    """The posterior of an object's place from readings of any of an array's whiskers.

    Parameters
    ----------
    observer : ArrayObserver
    readings : mapping of whisker to array or None
        A reading in SI units, or None where the whisker does not touch. Whiskers that are left out
        give no information.
    tolerance : float
        Error of means and sds, in sds, at which the grid is fine enough.
    seed : int, SeedSequence or Generator
        Of the draws from which the grid starts.

    Raises
    ------
    ValueError
        For whiskers that are not in the array, and readings that are not finite or misshapen.

    Examples
    --------
    >>> from weberwhisk import WhiskerArray
    >>> observer = ArrayObserver(WhiskerArray("rat", "right").protract(np.radians(40)))
    >>> found = place(observer, observer.read([20e-3, 5e-3], seed=1))
    >>> len(found.touching), found.status.name, bool(found.credibility([20e-3, 5e-3]) < 0.95)
    (3, 'CONVERGED', True)
    """
    checks.kind(
        "observer", observer, "an ArrayObserver", "sensors", "write ww.ArrayObserver(array)"
    )
    evidence, box, rng = observer.log_likelihood(readings), observer.box, checks.generator(seed)
    frame, draws = Frame.of_box(box), np.empty((0, 2))
    if evidence.touched:
        drawn = [one.draws(rng, 800) for one in evidence.touched]
        draws = np.concatenate([d[: 800 // len(drawn)] for d in drawn])
        if drawn := [places for places in drawn if len(places) > 2]:  # else no contact explains it
            frame = Frame.of_draws(drawn)

    def log_density(at: Array) -> Array:
        inside = np.all((at >= box[:, 0]) & (at <= box[:, 1]), axis=-1)
        out = np.full(len(at), -np.inf)
        out[inside] = evidence(at[inside])
        return out

    sums = integrate(log_density, frame, tolerance, draws)
    if evidence.touched and not np.isfinite(sums["_log_evidence"]):  # they contradict each other
        sums = integrate(log_density, Frame.of_box(box), tolerance, draws)
    status = Status.CONVERGED if sums["error"] <= tolerance else Status.IMPRECISE
    if not np.isfinite(sums["_log_evidence"]):
        status = Status.IMPROBABLE_READING
    elif not evidence.touched:
        status = Status.NO_CONTACT
    else:
        best = sums["places"][np.argmax(sums["log_density"])]
        if any(one.is_improbable(best) for one in evidence.touched):
            status = Status.IMPROBABLE_READING
    return Place(observer, observer.checked(readings), status, **sums, _evidence=evidence)


@dataclass(frozen=True, eq=False, repr=False)
class Place(Shown):
    """The posterior of an object's place; `place` makes it.

    Attributes
    ----------
    observer : ArrayObserver
    readings : mapping of whisker to array or None
    status : Status
        `NO_CONTACT` where no whisker touches: the posterior is the prior less excluded places.
        `IMPROBABLE_READING` where no one place explains all readings within 5 sd.
    mean : array, shape (2,)
        x and y, m.
    covariance : array, shape (2, 2)
        m².
    error : float
        Estimated error of means and sds, in sds.
    places, weights, log_density : array, shape (n, 2), (n,), (n,)
        Nodes, m, their probabilities, and ln of the density, 1/m².
    """

    observer: ArrayObserver
    readings: Mapping[str, Array | None]
    status: Status
    mean: Array
    covariance: Array
    error: float
    places: Array
    weights: Array
    log_density: Array
    _log_evidence: float
    _evidence: JointEvidence
    _figure = "place"

    @property
    def touching(self) -> tuple[str, ...]:
        """Names of the whiskers that touch."""
        return tuple(name for name, reading in self.readings.items() if reading is not None)

    @property
    def sd(self) -> Array:
        """Sd of x and of y, m."""
        return np.sqrt(np.diag(self.covariance))

    def interval(self, mass: float = 0.95) -> Array:
        """Equal-tailed intervals of x and of y, (2, 2), m."""
        tail = (1 - checks.mass(mass)) / 2
        out = np.full((2, 2), np.nan)
        for i, values in enumerate(self.places.T if len(self.places) else ()):
            out[i] = weighted_quantiles(values, self.weights, [tail, 1 - tail])
        return out

    def ellipse(self, mass: float = 0.95) -> tuple[float, float, float]:
        """Half axes (m) of the error ellipse, and the angle (rad) of the longer from the x axis.

        The Gaussian's of the same covariance, which holds the place with probability `mass`.
        """
        values, vectors = np.linalg.eigh(self.covariance)
        minor, major = np.sqrt(-2 * np.log1p(-checks.mass(mass)) * values)
        return float(major), float(minor), float(np.arctan2(vectors[1, 1], vectors[0, 1]))

    def credibility(self, place: ArrayLike) -> float:
        """The mass of all places more probable than a place (2,): below 0.95 inside its region."""
        log = self._evidence(one_place(place)[None])[0] - self._log_evidence
        return float(self.weights[self.log_density > log].sum())

    def area(self, mass: float = 0.95) -> float:
        """Area of the most probable places that hold the object with probability `mass`, m²."""
        order = np.argsort(-self.log_density)
        size = np.exp(np.log(self.weights[order]) - self.log_density[order])
        kept = np.cumsum(self.weights[order]) - self.weights[order] < checks.mass(mass)
        return float(size[kept].sum())

    @cached_property
    def height(self) -> tuple[float, float, Array]:
        """Mean and sd of the z of the pole's middle, and its 95 % interval (2,), m.

        NaN for a pole whose length is not given: it is as high as all whiskers.
        """
        edges, log = self._evidence.spans(self.places)
        if not edges.size:
            return np.nan, np.nan, np.full(2, np.nan)
        top = log.max(axis=1, keepdims=True)
        share = np.exp(log - top)
        mass = (self.weights[:, None] * share / share.sum(axis=1, keepdims=True)).ravel()
        middle, width = ((edges[:, 1:] + edges[:, :-1]) / 2).ravel(), np.diff(edges).ravel()
        mean = float(mass @ middle)
        sd = float(np.sqrt(mass @ ((middle - mean) ** 2 + width**2 / 12)))
        low, high = edges[:, :-1].reshape(1, -1), edges[:, 1:].reshape(1, -1)
        spans = Spans(np.zeros(1, dtype=np.intp), low, high, mass[None])
        return mean, sd, spans.quantiles(np.array([0.025, 0.975]))[0]

    @property
    def bits(self) -> float:
        """Information of the readings about the place, against the flat prior, bits."""
        area = float(np.prod(np.diff(self.observer.box, axis=1)))
        return float(self.weights @ self.log_density + np.log(area)) / np.log(2)

    @property
    def note(self) -> str:
        """Warnings about this result; empty if none."""
        out = []
        if self.status is Status.NO_CONTACT:
            share = self.area(1.0) / float(np.prod(np.diff(self.observer.box, axis=1)))
            out.append(f"no whisker touches: {100 * share:.0f} % of the region is left")
        rise = {name: self.observer.sensors[name].follicle.elevation for name in self.touching}
        if steep := [name for name, angle in rise.items() if abs(angle) > np.radians(30.0)]:
            out.append(
                f"{', '.join(steep)} more than 30° out of the horizontal: slip along the pole, "
                "which is left out, may matter"
            )
        notes = (self.observer.sensors[name].observer.note for name in self.touching)
        out += list(islice(filter(None, notes), 1))  # all are straight, or none
        return "; ".join(out)

    def summary(self) -> pd.DataFrame:
        """A row each for x, y, z: mean, sd, 95 % interval in mm, how many touch, the status."""
        mean, sd, interval = self.height
        numbers = np.column_stack([self.mean, self.sd, self.interval()])
        if not np.isnan(mean):
            numbers = np.vstack([numbers, [mean, sd, *interval]])
        table = 1e3 * pd.DataFrame(numbers, columns=["mean_mm", "sd_mm", "low_95_mm", "high_95_mm"])
        table.insert(0, "coordinate", list("xyz")[: len(numbers)])
        return table.assign(touching=len(self.touching), status=self._said)

    @property
    def _said(self) -> str:
        """The status, in words of places where a posterior's are of one contact."""
        of_places = {
            Status.NO_CONTACT: "no contact",
            Status.IMPROBABLE_READING: "no one place explains all readings within 5 sd",
        }
        return of_places.get(self.status, self.status.message)

    def _line(self) -> str:
        (x, y), (dx, dy) = 1e3 * self.mean, 1e3 * self.sd
        where = f"x = {x:.3g} ± {dx:.2g} mm, y = {y:.3g} ± {dy:.2g} mm"
        z, dz = (1e3 * v for v in self.height[:2])
        where += "" if np.isnan(z) else f", z = {z:.3g} ± {dz:.2g} mm"
        said = f"{where}, touched by {len(self.touching)} of {len(self.readings)} whiskers"
        return "; ".join(filter(None, (said, self._said, self.note)))


# -- the grid --------------------------------------------------------------------------------------

#: Gauss and Legendre's rule of each side of a cell.
_X, _W = np.polynomial.legendre.leggauss(4)
_X, _W = (_X + 1) / 2, _W / 2
_POINTS = np.array([*product(_X, _X)])
_WEIGHTS = np.outer(_W, _W).ravel()


class Frame(NamedTuple):
    """Coordinates u, place = middle + matrix @ u, in which the density is about a unit Gaussian.

    The grid starts from u between `low` and `high`, and grows unless these are the `whole` region.
    """

    middle: Array
    matrix: Array
    low: Array
    high: Array
    whole: bool = False

    @classmethod
    def of_box(cls, box: Array) -> Frame:
        """The frame of a box, ends of x and of y."""
        half = np.diff(box, axis=1)[:, 0] / 2
        return cls(box.mean(axis=1), np.diag(half), np.full(2, -1.0), np.full(2, 1.0), whole=True)

    @classmethod
    def of_draws(cls, drawn: list[Array], reach: float = 8.0) -> Frame:
        """The frame of a product of densities, each by draws (n, 2) taken as Gaussian."""
        total, pull = np.zeros((2, 2)), np.zeros(2)
        for places in drawn:
            inverse = np.linalg.inv(np.cov(places.T) + 1e-12 * np.eye(2))
            total += inverse
            pull += inverse @ places.mean(axis=0)
        covariance = np.linalg.inv(total)
        matrix = np.linalg.cholesky(covariance)
        return cls(covariance @ pull, matrix, np.full(2, -reach), np.full(2, reach))


class _Cells(NamedTuple):
    """Cells: low corner and sides (n, 2), ln density at nodes (n, N); and how far each quarter's
    share of the sums of six monomials was off, (n, 6), over the density of which ln is `top`, (n,).
    """

    low: Array
    side: Array
    log: Array
    difference: Array
    top: Array

    def points(self) -> Array:
        return np.asarray(self.low[:, None] + self.side[:, None] * _POINTS)

    def mass(self, top: float) -> Array:
        """Mass at each node (n, N), over the density exp(`top`)."""
        return np.asarray(np.exp(self.log - top) * _WEIGHTS * self.side.prod(axis=1)[:, None])

    def of(self, which: Flags) -> _Cells:
        return _Cells(*(column[which] for column in self))


def integrate(
    log_density: Callable[[Array], Array],
    frame: Frame,
    tolerance: float,
    draws: Array,
    *,
    depth: float = 26.0,
    most: int = 40_000,
) -> dict[str, Any]:
    """Sum a density over places, given as ln of it at (n, 2): what `Place` has of sums.

    Cells of 4 × 4 nodes are cut in four where they have mass, and again where a cell and its
    quarters differ, until twice the root of the summed squares of all differences is below the
    tolerance. Smooth cells are then far better than that; errors of cells that an edge runs through
    have random signs. `depth` is the ln of the density below the highest that is nothing, `most`
    the number of cells at which it ends, with an error above the tolerance.
    """

    def made(low: Array, side: Array) -> _Cells:
        u = low[:, None] + side[:, None] * _POINTS
        log = log_density((frame.middle + u @ frame.matrix.T).reshape(-1, 2))
        unknown = np.full((len(low), 6), np.inf)
        return _Cells(low, side, log.reshape(u.shape[:2]), unknown, np.zeros(len(low)))

    cells = made(*_lattice(frame.low, frame.high))
    for _ in range(0 if frame.whole else 12):  # wider where the density runs over a side
        share, _ = _mass(cells)
        low, high = frame.low.copy(), frame.high.copy()
        for axis in range(2):
            first = cells.low[:, axis] <= frame.low[axis] * (1 - 1e-9) + 1e-12
            last = cells.low[:, axis] + cells.side[:, axis] >= frame.high[axis] - 1e-9
            width = (high - low)[axis]
            low[axis] -= 0.4 * width * (share[first].sum() > 1e-6)
            high[axis] += 0.4 * width * (share[last].sum() > 1e-6)
        if np.all(low == frame.low) and np.all(high == frame.high):
            break
        frame = frame._replace(low=low, high=high)
        cells = made(*_lattice(low, high))
    error, seen = np.inf, log_density(draws) if len(draws) else np.empty(0)
    place = np.linalg.solve(frame.matrix, (draws - frame.middle).T).T[seen > -np.inf]
    seen = seen[seen > -np.inf]
    for _ in range(16):
        share, top = _mass(cells)
        if not np.isfinite(top):
            break
        new = np.isinf(cells.difference[:, 0])
        best = cells.log.max(axis=1)
        slack = best - np.where(np.isfinite(cells.log), cells.log, np.inf).min(axis=1)
        slack = np.nan_to_num(slack, nan=0.0, neginf=0.0)
        # The density between nodes may exceed theirs by as much as theirs differ.
        cut = new & (best + slack > top - depth)
        for at, log in zip(place[seen > top - 14.0], seen[seen > top - 14.0], strict=True):
            holds = np.all((cells.low <= at) & (at < cells.low + cells.side), axis=1)
            cut |= holds & (best < log - 1.0)
        error, size = _errors(cells, top, ~new)
        # One comparison may agree by chance: without this, errors were 7 times the estimate where
        # an edge ran through cells with mass.
        cut |= (size > 0.1 * share) & (share > 3e-5)
        order = np.argsort(size)
        over = np.sqrt(np.cumsum(size[order] ** 2)) > tolerance / 4
        if error > tolerance:
            cut[order[over & (size[order] > 0)]] = True
        if not cut.any() or len(cells.low) > most:
            break
        cells = _cut(cells, cut, made, top)
    return _sums(cells, frame, float(error))


def _lattice(low: Array, high: Array, count: int = 16) -> tuple[Array, Array]:
    """Low corners and sides (n, 2) of count × count cells."""
    place = np.stack(np.meshgrid(*[np.arange(count)] * 2, indexing="ij"), axis=-1).reshape(-1, 2)
    side = np.broadcast_to((high - low) / count, place.shape)
    return low + place * side, side.copy()


def _mass(cells: _Cells) -> tuple[Array, float]:
    """The share of each cell, and the highest ln of the density."""
    top = float(cells.log.max())
    if not np.isfinite(top):
        return np.zeros(len(cells.log)), top
    mass = cells.mass(top).sum(axis=1)
    return mass / mass.sum(), top


def _monomials(cells: _Cells, top: float) -> Array:
    """Integrals (n, 6) of 1, u, v, u², uv, v² over cells, over the highest density."""
    u, v = np.moveaxis(cells.points(), -1, 0)
    mass = cells.mass(top)
    return np.stack([(mass * m).sum(axis=1) for m in (1.0 + 0 * u, u, v, u * u, u * v, v * v)], 1)


def _cut(cells: _Cells, cut: Flags, made: Callable[[Array, Array], _Cells], top: float) -> _Cells:
    """The cells with those of `cut` replaced by their quarters."""
    old = cells.of(cut)
    side = np.repeat(old.side / 2, 4, axis=0)
    corner = np.tile([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]], (len(old.low), 1))
    quarters = made(np.repeat(old.low, 4, axis=0) + side * corner, side)
    sums = _monomials(quarters, top).reshape(-1, 4, 6).sum(axis=1)
    difference = np.repeat((sums - _monomials(old, top)) / 2, 4, axis=0)
    quarters = quarters._replace(difference=difference, top=np.full(len(quarters.log), top))
    return _Cells(*(np.concatenate(pair) for pair in zip(cells.of(~cut), quarters, strict=True)))


def _moments(cells: _Cells, top: float) -> tuple[float, Array, Array]:
    total, u, v, uu, uv, vv = _monomials(cells, top).sum(axis=0)
    mean = np.array([u, v]) / total
    covariance = np.array([[uu, uv], [uv, vv]]) / total - np.outer(mean, mean)
    return total, mean, covariance


def _errors(cells: _Cells, top: float, compared: Flags) -> tuple[float, Array]:
    """The estimated error in sds, and how much of it each cell has (n,)."""
    total, mean, covariance = _moments(cells, top)
    sd = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    above = np.exp(np.minimum(cells.top - top, 500.0))  # a peak that quarters did not meet again
    difference = np.where(compared[:, None], cells.difference, 0.0) * above[:, None] / total
    one, size = difference[:, 0], np.abs(difference[:, 0])
    for m, s, (first, second) in zip(mean, sd, ((1, 3), (2, 5)), strict=True):
        off = (difference[:, first] - m * one) / s
        square = difference[:, second] - 2 * m * difference[:, first] + m * m * one
        size = np.maximum(size, np.maximum(np.abs(off), np.abs(square / s**2 - one) / 2))
    return 2 * float(np.sqrt(np.sum(size**2))), size


def _sums(cells: _Cells, frame: Frame, error: float) -> dict[str, Any]:
    top = float(cells.log.max())
    if not np.isfinite(top):
        none = np.empty(0)
        return {
            "mean": np.full(2, np.nan), "covariance": np.full((2, 2), np.nan), "error": np.inf,
            "places": np.empty((0, 2)), "weights": none, "log_density": none,
            "_log_evidence": -np.inf,
        }  # fmt: skip
    total, mean, covariance = _moments(cells, top)
    evidence = top + np.log(total * abs(np.linalg.det(frame.matrix)))
    weight = cells.mass(top) / total
    kept = weight > 0
    return {
        "mean": frame.middle + frame.matrix @ mean,
        "covariance": frame.matrix @ covariance @ frame.matrix.T,
        "error": error,
        "places": (frame.middle + cells.points() @ frame.matrix.T)[kept],
        "weights": weight[kept],
        "log_density": cells.log[kept] - evidence,
        "_log_evidence": evidence,
    }
