"""Bent whiskers fitted to tracked points: all frames at once, by least squares.

The beam equation of `mechanics.beam` is integrated from a single contact force at arc length s_c to
the base; beyond s_c the whisker keeps its shape at rest. Each frame has five parameters: direction
and offset of the base, s_c, the force, and the friction angle. Residuals are the distances of
points across the whisker, because trackers place points along it arbitrarily. Units: the length of
the whisker and EI₀ are 1.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from scipy.special import expit
from scipy.stats import chi2

from .._util import checks
from .._util.refusals import Refusal
from .._util.values import Array, Flags
from ..mechanics import Profile

Complex = NDArray[np.complex128]

#: Parameters of a shape, by column; curvature at rest k₀ + k₁ s + k₂ s², and m of the moment
#: EI·Δκ = m₀ + m₁ s + m₂ s².
NAMES = ("direction", "offset", "place", "force", "friction", "k0", "k1", "k2", "m0", "m1", "m2",
         "slide")  # fmt: skip
#: Parameters fitted: any shape at rest; bent, with a fixed contact or not; moment near the base.
FREE, PLACED, BENT, NEAR_BASE = (0, 1, 5, 6, 7), (0, 1, 3), (0, 1, 2, 3, 11), (0, 1, 8, 9, 10)
#: Steps from contact to base and from contact to tip: shapes are accurate to 1e-6 lengths.
_STEPS, _BEYOND = 24, 12


class Points(NamedTuple):
    """Points of n frames, in K groups along the whisker.

    First point (n,); of the groups (n, K) centre, variance of points along the whisker, weight
    1/sd, and arc length.
    """

    base: Complex
    at: Complex
    spread: Array
    weight: Array
    arc: Array

    def take(self, index: Any) -> Points:
        """A subset of the frames."""
        return Points(*(v[index] for v in self))


class FittedShape(NamedTuple):
    """Knots along n whiskers in base coordinates; arc length of the contact, and its force."""

    contact_arc: Array
    end: float
    angle: Array
    at: Complex
    bend: Array
    force: Complex

    @property
    def contact(self) -> Complex:
        """Where the force acts."""
        return self.at[:, _STEPS]

    def on(self, arc: Array) -> tuple[Complex, Complex, Array]:
        """Points, tangents and curvatures at arc lengths (n, K), by cubic Hermite splines."""
        contact_arc = self.contact_arc[:, None]
        far = arc > contact_arc
        step = np.where(far, (self.end - contact_arc) / _BEYOND, contact_arc / _STEPS)
        i = np.where(far, (arc - contact_arc) / step, arc / step)
        j = np.clip(np.floor(i), 0, np.where(far, _BEYOND, _STEPS) - 1).astype(np.intp)
        t, j = i - j, j + np.where(far, _STEPS, 0)
        z0, z1 = (np.take_along_axis(self.at, j + d, 1) for d in (0, 1))
        d0, d1 = (step * np.exp(1j * np.take_along_axis(self.angle, j + d, 1)) for d in (0, 1))
        k0, k1 = (np.take_along_axis(self.bend, j + d, 1) for d in (0, 1))
        rise = z1 - z0
        b, c = 3 * rise - 2 * d0 - d1, d0 + d1 - 2 * rise
        point = z0 + t * (d0 + t * (b + t * c))
        slope = d0 + t * (2 * b + 3 * t * c)
        return point, slope / np.abs(slope), k0 + t * (k1 - k0)


@dataclass(frozen=True, eq=False)
class Shapes:
    """Fits shapes of a whisker tracked up to `reach` (lengths); derivatives step by `change`."""

    profile: Profile
    reach: float
    change: float = 1e-5

    def contact_arc(self, p: Array) -> Array:
        """Arc length of the contact, from 1 % of the length to the tip."""
        return np.asarray(0.01 + 0.985 * expit(p[:, 2]))

    def place(self, contact_arc: Any) -> Array:
        """The parameter `place` for a contact at an arc length; the inverse of `contact_arc`."""
        share = np.clip((np.asarray(contact_arc, dtype=float) - 0.01) / 0.985, 0.005, 0.995)
        return np.asarray(np.log(share / (1 - share)))

    def started(self, p: Array, bends: Array, contact_arc: Any) -> Array:
        """Start values with a contact there, and a force estimated from curvatures (n, 3).

        The force follows from Δκ at a third of it, where the moment is 2/3 of that at the base.
        """
        p, s = p.copy(), np.asarray(contact_arc) / 3
        change = ((bends - p[:, 5:8]) * s[:, None] ** np.arange(3)).sum(axis=1)
        length = float(self.profile.whisker.length)
        ei = self.profile.stiffness(length * s) / self.profile.stiffness(0.0)
        p[:, 2], p[:, 3] = self.place(contact_arc), change * ei / (2 * s)
        return p

    def curve(self, p: Array) -> FittedShape:
        """Shapes with parameters (n, 12), in base coordinates."""
        contact_arc, end = self.contact_arc(p), max(self.reach, 1.0)
        k0, k1, k2, m0, m1, m2 = p[:, 5:11].T
        length, stiff = float(self.profile.whisker.length), float(self.profile.stiffness(0.0))
        force = 1j * p[:, 3] * np.exp(1j * p[:, 4])

        def bend(s: Array, z: Complex) -> Array:
            ei = self.profile.stiffness(length * s) / stiff
            moment = -(np.conj(z) * force).imag + m0 + s * (m1 + s * m2)
            return np.asarray(k0 + s * (k1 + s * k2) + moment / ei)

        h, s = -contact_arc / _STEPS, contact_arc
        angle, z = np.zeros_like(contact_arc), np.zeros(len(p), dtype=complex)
        angles, zs, bends = [angle], [z], [bend(s, z)]
        for _ in range(_STEPS):
            a1, z1 = bends[-1], np.exp(1j * angle)
            a2, z2 = bend(s + h / 2, z + h / 2 * z1), np.exp(1j * (angle + h / 2 * a1))
            a3, z3 = bend(s + h / 2, z + h / 2 * z2), np.exp(1j * (angle + h / 2 * a2))
            a4, z4 = bend(s + h, z + h * z3), np.exp(1j * (angle + h * a3))
            angle = angle + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
            z, s = z + h / 6 * (z1 + 2 * z2 + 2 * z3 + z4), s + h
            angles, zs, bends = [*angles, angle], [*zs, z], [*bends, bend(s, z)]
        # Beyond the contact, by Simpson's rule.
        u = contact_arc[:, None] + (end - contact_arc)[:, None] * np.linspace(0, 1, 2 * _BEYOND + 1)
        turn = u * (k0[:, None] + u * (k1[:, None] / 2 + u * k2[:, None] / 3))
        turn = turn - turn[:, :1]
        way = np.exp(1j * turn)
        step = ((end - contact_arc) / _BEYOND / 6)[:, None]
        far = np.cumsum(step * (way[:, :-2:2] + 4 * way[:, 1::2] + way[:, 2::2]), axis=1)
        rest = (k0[:, None] + u * (k1[:, None] + u * k2[:, None]))[:, 2::2]
        angles_at = np.concatenate([np.array(angles[::-1]).T, turn[:, 2::2]], axis=1)
        at = np.concatenate([np.array(zs[::-1]).T, far], axis=1)
        back = np.exp(-1j * angle)
        return FittedShape(
            contact_arc, end, angles_at - angle[:, None], (at - z[:, None]) * back[:, None],
            np.concatenate([np.array(bends[::-1]).T, rest], axis=1), force * back,
        )  # fmt: skip

    def signals(self, p: Array) -> Array:
        """Moment, axial and transverse force, distance and angle of the contact, (n, 5)."""
        curve = self.curve(p)
        c, f = curve.contact, curve.force
        return np.stack([(np.conj(c) * f).imag, -f.real, f.imag, np.abs(c), np.angle(c)], axis=1)

    # -- fitting -------------------------------------------------------------------------------

    def _residuals(self, p: Array, points: Points, extra: Extra) -> tuple[Array, Array]:
        """Residuals (n, R) in sds, and the offsets (n, K) of points along the whisker."""
        curve = self.curve(p)
        turn = np.exp(1j * p[:, 0])
        base = points.base + (p[:, 11] + 1j * p[:, 1]) * turn
        at, tangent, bend = curve.on(points.arc)
        off = np.conj(turn[:, None] * tangent) * (points.at - base[:, None] - turn[:, None] * at)
        across = points.weight * (off.imag - bend * points.spread / 2)
        # Weak priors, for what the points do not determine.
        friction = (p[:, [4]] - extra.friction) / extra.friction_sd
        residuals = [across, p[:, [2]] / 4, friction, p[:, [11]] / extra.base_sd]
        if extra.pole is not None:
            way = np.exp(1j * curve.angle[:, _STEPS]) * turn
            to = np.conj(way) * (extra.pole - base - turn * curve.contact)
            side = np.where(p[:, 3] < 0, 1.0, -1.0)  # the pole pushes from behind the force
            off_surface = to.imag - side * extra.pole_radius
            residuals += [part[:, None] / extra.pole_sd for part in (to.real, off_surface)]
        return np.concatenate(residuals, axis=1), off.real

    def _slopes(self, p: Array, points: Points, extra: Extra, free: Any) -> tuple[Array, Array]:
        """Residuals (n, R), and their derivatives (n, R, P)."""
        n, many = len(p), 1 + len(free)  # one call for all: for few frames calls are the cost
        every = np.tile(np.arange(n), many)
        aside = p[every]
        for k, i in enumerate(free):
            aside[(k + 1) * n : (k + 2) * n, i] += self.change
        residuals = self._residuals(aside, points.take(every), extra.take(every))[0]
        here, moved = np.split(residuals.reshape(many, n, -1), [1])
        return here[0], np.moveaxis(moved - here, 0, -1) / self.change

    def fit(
        self, p: Array, points: Points, extra: Extra, free: Any, rounds: int = 60
    ) -> tuple[Array, Array, Points]:
        """Parameters (n, 12), sums of squares (n,), and the points with fitted arc lengths.

        Levenberg–Marquardt steps with a damping for each frame, until its sum of squares converges.
        """
        p, columns = p.copy(), list(free)
        damping = np.full(len(p), 1e-4)
        points = self._moved(p, points, extra)
        cost = (self._residuals(p, points, extra)[0] ** 2).sum(axis=1)
        left = np.arange(len(p))
        for _ in range(rounds):
            current, fixed, old = points.take(left), extra.take(left), cost[left]
            here, slopes = self._slopes(p[left], current, fixed, columns)
            square = np.swapaxes(slopes, 1, 2) @ slopes
            size = damping[left, None] * (np.diagonal(square, axis1=1, axis2=2) + 1e-12)
            square = square + size[:, :, None] * np.eye(len(columns))
            pull = np.einsum("nrp,nr->np", slopes, here)
            step = np.linalg.solve(square, -pull[..., None])[..., 0]
            if 2 in columns:
                step[:, columns.index(2)] = np.clip(step[:, columns.index(2)], -0.7, 0.7)
            tried = p[left]
            tried[:, columns] += step
            moved = self._moved(tried, current, fixed)
            with np.errstate(over="ignore", invalid="ignore"):
                new = (self._residuals(tried, moved, fixed)[0] ** 2).sum(axis=1)
            better = np.isfinite(new) & (new <= old)
            at = left[better]
            p[at], cost[at], points.arc[at] = tried[better], new[better], moved.arc[better]
            damping[left] = np.where(better, damping[left] / 10, damping[left] * 4)
            still = np.where(better, old - new > 1e-5 * old, damping[left] < 1e5)
            left = left[still]
            if not left.size:
                break
        return p, cost, points

    def _moved(self, p: Array, points: Points, extra: Extra) -> Points:
        along = self._residuals(p, points, extra)[1]
        along = np.where(np.isfinite(along), along, 0.0)
        return points._replace(arc=np.clip(points.arc + along, 0.0, max(self.reach, 1.0)))

    def covariance(
        self, p: Array, points: Points, extra: Extra, free: Any, shared: Array | None = None
    ) -> tuple[Array, Array, Array]:
        """Covariances of the fitted parameters (n, P, P) and of the signals (n, 5, 5), and the part
        of the latter (n, 5, 5) that comes from the shape at rest.

        From the Jacobian at the fit; `shared` (3, 3) is the covariance of the shape at rest, whose
        error all frames share.
        """
        _, slopes = self._slopes(p, points, extra, free)
        square = np.swapaxes(slopes, 1, 2) @ slopes
        inverse = np.linalg.pinv(square, hermitian=True)
        gain = np.empty((len(p), 5, len(NAMES)))
        here = self.signals(p)
        for i in range(len(NAMES)):
            aside = p.copy()
            aside[:, i] += self.change
            gain[:, :, i] = (self.signals(aside) - here) / self.change
        to_free = gain[:, :, list(free)]
        out = to_free @ inverse @ np.swapaxes(to_free, 1, 2)
        common = np.zeros_like(out)
        if shared is not None:
            rest = [5, 6, 7]
            _, by_rest = self._slopes(p, points, extra, rest)
            follow = -inverse @ np.swapaxes(slopes, 1, 2) @ by_rest
            total = gain[:, :, rest] + to_free @ follow
            common = total @ shared @ np.swapaxes(total, 1, 2)
        return np.asarray(inverse), np.asarray(out + common), np.asarray(common)


class Extra(NamedTuple):
    """Information besides the points (in lengths): friction, error of first points, the pole."""

    friction: float = 0.0
    friction_sd: float = 1e-9
    base_sd: float = 1.0
    pole: Any = None
    pole_radius: float = 0.0
    pole_sd: float = 1.0

    def take(self, index: Any) -> Extra:
        """For some of the frames."""
        return self if self.pole is None else self._replace(pole=self.pole[index])


# -- from tables of tracking ----------------------------------------------------------------


def in_plane(table: pd.DataFrame, most: float) -> Array:
    """Unit vectors (2, D) of the image plane, or of the plane swept by points in space."""
    if "z" not in table:
        return np.eye(2)
    every = np.concatenate(
        [np.stack(list(row)) for row in table[["x", "y", "z"]].to_numpy()], axis=1
    )
    size, way = np.linalg.svd(every.T - every.mean(axis=1), full_matrices=False)[1:]
    off = size[2] / np.sqrt(every.shape[1])
    if off > most or size[2] > 0.2 * size[1]:
        raise Refusal(
            f"The points sweep no plane: they lie {off:.3g} px (rms) off the nearest, and "
            f"{size[1] / np.sqrt(every.shape[1]):.3g} px across it",
            remedy="give x and y of the whisker's",
        )
    if np.cross(way[0], way[1])[2] < 0:  # as seen from above: left stays left
        way[1] *= -1
    return np.asarray(way[:2])


def points_of(table: pd.DataFrame, plane: Array, unit: float, groups: int = 32) -> Points:
    """Points of every frame in whisker lengths (`unit` pixels), averaged in at most `groups`."""
    frames = []
    for points in table[list("xyz"[: plane.shape[1]])].to_numpy():
        x, y = plane @ np.stack(list(points))
        z = (x + 1j * y) / unit
        n = min(len(z), groups)
        which = np.arange(len(z)) * n // len(z)
        count = np.bincount(which, minlength=n)
        at = (np.bincount(which, z.real) + 1j * np.bincount(which, z.imag)) / count
        spread = np.bincount(which, np.abs(z - at[which]) ** 2) / count
        arc = np.append(0.0, np.cumsum(np.abs(np.diff(np.append(z[0], at)))))[1:]
        room = [(0, groups - n)]
        values = (at, spread, np.sqrt(count), arc)
        frames.append((z[0], *(np.pad(v, room, "edge") for v in values)))
        frames[-1][3][n:] = 0.0
    return Points(*(np.array(column) for column in zip(*frames, strict=True)))


def free_frames(bends: Array, false_alarms: float) -> Flags:
    """Frames without contact: curvature within a χ² limit of a robust mean and covariance.

    Concentration steps: mean and covariance of the frames that the last step found free, corrected
    for the truncation at the χ² limit.
    """
    size = bends.shape[1]
    if len(bends) < 10:  # no shape at rest follows from so few
        return np.ones(len(bends), dtype=bool)
    middle = np.median(bends, axis=0)
    spread = np.diag((1.4826 * np.median(np.abs(bends - middle), axis=0)) ** 2 + 1e-18)
    far = np.einsum("ni,ij,nj->n", bends - middle, np.linalg.inv(spread), bends - middle)
    free = far <= np.median(far)
    for cut in (0.5, 0.5, 0.75, 0.95, 0.99, 0.99, 0.99, 0.99):
        edge = chi2.ppf(cut, size)
        # Variance of a Gaussian truncated there, relative to the whole one.
        left = chi2.cdf(edge, size + 2) / cut
        subset = bends[free]
        middle, spread = subset.mean(axis=0), np.cov(subset.T) / left + 1e-18 * np.eye(size)
        far = np.einsum("ni,ij,nj->n", bends - middle, np.linalg.inv(spread), bends - middle)
        free = far <= (np.quantile(far, 0.5) if cut == 0.5 else edge)
    return np.asarray(far <= chi2.isf(false_alarms, size))


def median_shape(bends: Array) -> Array:
    """The median of curvatures (n, 3) in uncorrelated coordinates.

    Medians of single coefficients are inaccurate in directions with little variance.
    """
    root = np.linalg.cholesky(np.cov(bends.T))
    return np.asarray(root @ np.median(np.linalg.solve(root, bends.T), axis=1))


def contacts_of(tracking: pd.DataFrame, table: pd.DataFrame, contact: Any) -> Flags:
    """Rows in contact, from a column or a list."""
    if isinstance(contact, str):
        checks.one_of("contact", contact, map(str, tracking.columns))
        values = tracking[contact]
    else:
        several = checks.several("contact", contact, "write the name of a column")
        if len(several) != len(tracking):
            raise Refusal(
                f"contact must have a value for each of {len(tracking)} rows", len(several)
            )
        values = pd.Series(several, index=tracking.index)
    words = values.loc[table.index].astype(str).str.strip().str.lower()
    return ~words.isin(("false", "0", "0.0", "", "no", "none", "nan", "<na>")).to_numpy()


def pole_of(pole: ArrayLike, tracking: pd.DataFrame, table: pd.DataFrame, plane: Array) -> Any:
    """Position of the pole in each row, complex pixels."""
    place, axes = checks.finite("pole", pole, "give its place in pixels"), plane.shape[1]
    if place.shape not in ((axes,), (len(tracking), axes)):
        raise Refusal(
            f"pole must be ({', '.join('xyz'[:axes])}), or that in each of {len(tracking)} rows",
            f"an array of shape {place.shape}",
        )
    place = np.broadcast_to(place, (len(tracking), axes))
    x, y = plane @ place[tracking.index.get_indexer(table.index)].T
    return x + 1j * y
