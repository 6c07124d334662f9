"""Likelihoods of the place of a vertical pole, from one whisker of an array and from all."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline, RectBivariateSpline
from scipy.special import logsumexp, ndtr

from .._util.checks import angle, finite
from .._util.refusals import Refusal
from .._util.values import Array
from ..inference import posterior
from ..inference.coordinates import constrain_angle, unconstrain_angle, within_half_turn
from ..inference.observer import Observer
from ..inference.result import is_outside
from ..mechanics.contact import Outcome
from .follicles import Follicle

__all__ = ["Evidence", "JointEvidence", "Sensor", "metres", "one_place"]


@dataclass(frozen=True, eq=False)
class Sensor:
    """One whisker with its observer; the error of its azimuth has the sd `angle_sd`, rad."""

    follicle: Follicle
    observer: Observer
    angle_sd: float

    @property
    def taps(self) -> bool:
        """Whether it senses distance alone, and the azimuth at which it first touched."""
        return len(self.observer.unknowns) == 1

    # -- geometry ------------------------------------------------------------------------------

    def contact(self, place: ArrayLike) -> tuple[Array, Array]:
        """Radial distance and deflection from rest (...) of a pole at (..., 2).

        Negative where the whisker has not come as far, NaN out of reach.
        """
        r, theta = self.follicle.in_plane(place)
        low, high = self.observer.reach
        near = (r > max(low, 1e-9)) & (r < high)
        out = np.full(np.shape(r), np.nan)
        out[near] = theta[near]
        if not self.observer.forward.is_plain and near.any():
            out[near] -= self.observer.forward.rest(r[near])
        return r, out

    def height(self, place: Array) -> Array:
        """z (...) at which the plane of whisking meets a pole at (..., 2), m."""
        r, angle = self.follicle.in_plane(place)
        rise = r * np.cos(angle) * np.sin(self.follicle.elevation)
        return np.asarray(self.follicle.base[2] + rise)

    def largest(self, r: Array) -> Array:
        """Deflection up to which it touches at distances (n,): swept, or flicked past."""
        swept = np.full(np.shape(r), self.follicle.swept_in_plane)
        return swept if self.taps else np.minimum(swept, self.observer.space.angle_range(r)[1])

    def touch_probability(self, place: ArrayLike) -> Array:
        """The probability (...) that it touches a pole at (..., 2)."""
        r, theta = self.contact(place)
        out, near = np.zeros(np.shape(r)), np.isfinite(theta)
        theta, top = theta[near], self.largest(r[near])
        if self.angle_sd == 0:
            out[near] = (theta > 0) & (theta < top)
        else:
            out[near] = ndtr((top - theta) / self.angle_sd) - ndtr(-theta / self.angle_sd)
        return out

    def azimuth(self, theta: Array) -> Array:
        """The whisker's azimuth where it first touched, having come on by θ (...) since then."""
        turned = np.arctan2(np.sin(theta), np.cos(theta) * np.cos(self.follicle.elevation))
        return np.asarray(self.follicle.azimuth - turned)

    # -- readings ------------------------------------------------------------------------------

    def read(self, place: Array, rng: np.random.Generator) -> Array | None:
        """A noisy reading of a pole at (2,), or None where the whisker does not touch it."""
        r, theta = self.contact(place)
        error = self.angle_sd * rng.standard_normal()
        if not 0 < theta + error < self.largest(r):
            return None
        contact = np.array([r, theta + error])[: len(self.observer.unknowns)]
        reading = self.observer.read(contact, rng)
        return np.append(reading, self.azimuth(theta) - error) if self.taps else reading

    def checked(self, name: str, reading: ArrayLike) -> Array:
        """A reading as finite numbers: signals, and of a tap the azimuth."""
        if not self.taps:
            y = self.observer.checked_reading(reading)
            if y.ndim != 1:
                raise Refusal(
                    f"{name} has one reading of one place",
                    f"shape {y.shape}",
                    "call place() for each",
                )
            return y
        y = finite(f"the reading of {name}", reading, "give SI units")
        if y.ndim != 1 or len(y) < 2:
            raise Refusal(
                f"The reading of {name} is a tap: signals, and last the azimuth at which it "
                "touched in rad",
                f"shape {y.shape}",
                "write [*signals, azimuth]",
            )
        return np.append(
            self.observer.checked_reading(y[:-1]),
            angle(f"the azimuth of {name}", y[-1], "give radians"),
        )

    def evidence(self, reading: Array) -> Evidence:
        """The likelihood of places given a reading."""
        if self.taps:
            return Tap(self, reading)
        return Evidence(self, reading) if self.angle_sd == 0 else Blurred(self, reading)

    # -- information ---------------------------------------------------------------------------

    def information(self, place: Array) -> Array:
        """Fisher information about places (n, 2), (n, 2, 2), 1/m²; 0 where it does not touch."""
        r, theta = self.contact(place)
        out = np.zeros((len(place), 2, 2))
        touches = np.isfinite(theta)
        touches[touches] = (theta > 0)[touches] & (theta[touches] < self.largest(r[touches]))
        if not touches.any():
            return out
        sides = [
            [np.stack(self._sensed(place[touches] + s * h), axis=-1) for s in (1, -1)]
            for h in 1e-8 * np.eye(2)
        ]
        slope = np.stack([(a - b) / 2e-8 for a, b in sides], axis=-1)
        contact = np.stack([r, theta], axis=-1)[touches][:, : len(self.observer.unknowns)]
        inner = np.nan_to_num(self.observer.information(contact))
        if self.taps:
            both = np.zeros((len(contact), 2, 2))
            both[:, 0, 0], both[:, 1, 1] = inner[:, 0, 0], self.angle_sd**-2
            inner = both
        else:  # the error of the azimuth is a nuisance parameter with the prior sd `angle_sd`
            row = inner[:, :, 1]
            total = inner[:, 1, 1] + max(self.angle_sd, 1e-12) ** -2.0
            inner = inner - row[:, :, None] * row[:, None] / total[:, None, None]
        out[touches] = np.swapaxes(slope, -1, -2) @ inner @ slope
        return out

    def _sensed(self, place: Array) -> tuple[Array, Array]:
        """Distance, and deflection or azimuth, of places (n, 2)."""
        r, theta = self.contact(place)
        return r, self.azimuth(theta) if self.taps else theta


@dataclass(eq=False)
class Evidence:
    """Likelihood of a pole's place from one reading of one whisker of exactly known azimuth."""

    sensor: Sensor
    reading: Array

    def __call__(self, place: Array) -> Array:
        """ln p(reading, touch | pole at (n, 2)), (n,)."""
        r, theta = self.sensor.contact(place)
        out = np.full(r.shape, -np.inf)
        near = np.isfinite(theta)
        if near.any():
            out[near] = self._at(r[near], theta[near])
        return out

    def _at(self, r: Array, theta: Array) -> Array:
        """ln p(reading | r, θ), (n,)."""
        touches = (theta > 0) & (theta < self.sensor.largest(r))
        out = np.full(r.shape, -np.inf)
        contact = np.stack([r, theta], axis=-1)[touches]
        if len(contact):
            out[touches] = self.sensor.observer.log_likelihood(self.reading, contact)
        return out

    def _likeliest(self, r: float, theta: float) -> tuple[float, float]:
        """The most likely true deflection, and how many sds of the azimuth it is from `theta`."""
        return theta, 0.0

    def is_improbable(self, place: Array) -> bool:
        """Whether a number of the reading lies more than 5 sd from what a pole at (2,) gives."""
        r, theta = (float(v) for v in self.sensor.contact(place))
        if not np.isfinite(theta):
            return True
        observer, count = self.sensor.observer, len(self.sensor.observer.unknowns)
        theta, off = self._likeliest(r, theta)
        signals, outcome = observer.signals(np.array([[r, theta]])[:, :count])
        signs = self.reading[: len(self.reading) - self.sensor.taps]
        if outcome[0] != Outcome.HELD or off > 5.0:
            return True
        return bool(is_outside(observer.noise, signs[None], signals)[0])

    def draws(self, rng: np.random.Generator, count: int) -> Array:
        """Draws (n, 2) of the place from the posterior of this whisker alone."""
        sensor, observer = self.sensor, self.sensor.observer
        contact = self._contacts(rng, count)
        contact = contact[np.isfinite(contact).all(axis=1)]
        error = sensor.angle_sd * rng.standard_normal(len(contact))
        if sensor.taps:
            turned = sensor.follicle.azimuth - self.reading[-1] + error
            flat = np.cos(sensor.follicle.elevation)
            theta = np.arctan2(np.sin(turned) * flat, np.cos(turned))
        else:
            theta = contact[:, 1] + error
        r = contact[:, 0]
        return sensor.follicle.place(r, theta + observer.forward.rest(r))

    def _contacts(self, rng: np.random.Generator, count: int) -> Array:
        """Contacts (n, U) drawn from the posterior of this whisker alone."""
        observer = self.sensor.observer
        signals = self.reading[: len(self.reading) - self.sensor.taps]
        drawn = posterior(observer, signals).solution.draws(count // 4, rng)[0]
        return np.asarray(drawn.reshape(-1, len(observer.unknowns)))


class Tap(Evidence):
    """The distance by the cue, the bearing by the azimuth at first touch."""

    def _at(self, r: Array, theta: Array) -> Array:
        sd = self.sensor.angle_sd
        off = self._off(theta) / sd
        log = self.sensor.observer.log_likelihood(self.reading[:-1], r[:, None])
        return np.asarray(log - 0.5 * off**2 - np.log(sd * np.sqrt(2 * np.pi)))

    def _likeliest(self, r: float, theta: float) -> tuple[float, float]:
        return theta, abs(float(self._off(np.array(theta)))) / self.sensor.angle_sd

    def _off(self, theta: Array) -> Array:
        """How far the azimuth read is from that of a touch, rad, to whole turns."""
        return within_half_turn(self.reading[-1] - self.sensor.azimuth(theta))


class Blurred(Evidence):
    """Distance and deflection by the cue, the azimuth known with an error.

    ∫ p(reading | r, φ) N(φ; θ, sd²) dφ is tabulated once: at distances closer than the posterior's
    sd, over φ where the reading is likely, for θ in units of its sd.
    """

    #: ln below the best at which nothing is left.
    DEPTH = 45.0
    #: Sd of φ by the reading over that of the azimuth, from which on the azimuth counts as known:
    #: it would add less than 0.1 % to the spread.
    MOST = 22.0

    def __init__(self, sensor: Sensor, reading: Array) -> None:
        super().__init__(sensor, reading)
        distances = 100
        x = np.linspace(-3.4, 3.4, distances)
        for _ in range(4):  # closer and closer to where the reading is likely
            r = sensor.observer.space.distance(x)
            log, phi, weight = self._along(r, 48)
            top = np.logaddexp.reduce(log + np.log(weight), axis=1)
            live = np.flatnonzero(top > np.max(top) - self.DEPTH)
            first, last = max(live[0] - 1, 0), min(live[-1] + 1, len(x) - 1)
            x = np.linspace(x[first], x[last], distances)
        sd = sensor.angle_sd
        mean, variance, total = _moments(log, phi, weight)
        wide = float(np.sqrt(variance.max())) / sd
        share = total / total.max() * np.gradient(r)
        self._cloud = r, share / share.sum()  # distances, and their shares of the likelihood
        self._ends = r[0], r[-1]
        # Mean and variance of φ at a distance; ln of the integral, less that of a Gaussian.
        self._line = CubicSpline(r, np.stack([mean, variance], axis=1))
        self._table: RectBivariateSpline | None = None  # as where the azimuth counts as known
        if wide > self.MOST:
            return
        # The steps of φ and θ are shorter than the azimuth's sd, over which edges are smoothed.
        steps = np.diff(phi, axis=1).max() * 47
        log, phi, weight = self._along(r, int(max(steps / (0.7 * sd), 160)))
        mean, variance, _ = _moments(log, phi, weight)
        width = np.sqrt(variance + sd**2)
        t = np.linspace(-8.0, 8.0, int(max(32 * wide, 61)))
        log += np.log(weight)
        value = np.empty((len(r), len(t)))
        for i, at in enumerate(t):
            exponent = log - 0.5 * ((phi - (mean + at * width)[:, None]) / sd) ** 2
            most = exponent.max(axis=1)
            value[:, i] = most + np.log(np.exp(exponent - most[:, None]).sum(axis=1)) + at**2 / 2
        value -= np.log(sd * np.sqrt(2 * np.pi))
        self._line = CubicSpline(r, np.stack([mean, variance], axis=1))
        self._table = RectBivariateSpline(r, t, value)

    def _along(self, r: Array, count: int) -> tuple[Array, Array, Array]:
        """ln p(reading | r, φ) at nodes φ around the likeliest, and their weights, (n, count)."""
        top = np.maximum(self.sensor.largest(r), 1e-9)[:, None]
        ends = unconstrain_angle(np.array([1e-7, 1 - 1e-9]))
        low, high = (np.full(len(r), end) for end in ends)
        for nodes in (48, 48, 48, count):
            share = np.linspace(0.0, 1.0, nodes)
            y = low[:, None] + (high - low)[:, None] * share
            fraction, slope = constrain_angle(y)
            phi = top * fraction
            contact = np.stack([np.broadcast_to(r[:, None], phi.shape), phi], axis=-1)
            log = self.sensor.observer.log_likelihood(self.reading, contact)
            live = log > log.max(axis=1, keepdims=True) - self.DEPTH
            first = np.maximum(live.argmax(axis=1) - 1, 0)
            last = np.minimum(nodes - live[:, ::-1].argmax(axis=1), nodes - 1)
            step, index = (high - low) / (nodes - 1), np.arange(len(r))
            low, high = y[index, first], y[index, last]
        return log, phi, top * np.exp(slope) * step[:, None]

    def _at(self, r: Array, theta: Array) -> Array:
        if self._table is None:
            return super()._at(r, theta)
        out = np.full(r.shape, -np.inf)
        inside = (r >= self._ends[0]) & (r <= self._ends[1])
        mean, variance = self._line(r[inside]).T
        t = (theta[inside] - mean) / np.sqrt(np.maximum(variance, 0.0) + self.sensor.angle_sd**2)
        out[inside] = self._table.ev(r[inside], np.clip(t, -8.0, 8.0)) - t**2 / 2
        return out

    def _contacts(self, rng: np.random.Generator, count: int) -> Array:
        r = rng.choice(self._cloud[0], count, p=self._cloud[1])
        mean, variance = self._line(r).T
        return np.stack([r, mean + np.sqrt(variance) * rng.standard_normal(count)], axis=-1)

    def _likeliest(self, r: float, theta: float) -> tuple[float, float]:
        mean, variance = self._line(r)
        precise = 1 / variance + self.sensor.angle_sd**-2.0
        phi = float((mean / variance + theta / self.sensor.angle_sd**2) / precise)
        return phi, abs(phi - theta) / self.sensor.angle_sd


@dataclass(frozen=True, eq=False)
class JointEvidence:
    """Joint likelihood of a place from readings of whiskers and from absent touches of others.

    With `pole_length`, of a short pole whose middle is at a height between `heights`.
    """

    touched: list[Evidence]
    untouched: list[Sensor]
    missed: float
    pole_length: float | None
    heights: tuple[float, float]

    def __call__(self, place: Array) -> Array:
        """ln p(readings | pole at (n, 2)), (n,); −∞ where one of them cannot be."""
        out = np.full(len(place), len(self.touched) * np.log1p(-self.missed))
        for evidence in self.touched:  # impossible places are not evaluated further
            live = np.flatnonzero(out > -np.inf)
            out[live] += evidence(place[live])
        if self.pole_length is not None:
            live = np.flatnonzero(out > -np.inf)
            _, log = self.spans(place[live])
            low, high = self.heights
            out[live] += logsumexp(log, axis=1) - np.log(high - low)
            return out
        for sensor in self.untouched:
            live = np.flatnonzero(out > -np.inf)
            noticed = (1 - self.missed) * sensor.touch_probability(place[live])
            with np.errstate(divide="ignore"):
                out[live] += np.log1p(-noticed)
        return out

    def spans(self, place: Array) -> tuple[Array, Array]:
        """Ends (n, k + 1) of spans of z, and ln of the mass (n, k) that readings leave in each.

        Given x and y, whether a whisker meets a short pole is a matter of z alone.
        """
        if self.pole_length is None:
            return np.empty((0, 0)), np.empty((0, 0))
        half, n = self.pole_length / 2, len(place)
        low, high = (np.full(n, end) for end in self.heights)
        for evidence in self.touched:
            z = evidence.sensor.height(place)
            low, high = np.maximum(low, z - half), np.minimum(high, z + half)
        high = np.maximum(low, high)
        noticed = [
            ((1 - self.missed) * s.touch_probability(place), s.height(place))
            for s in self.untouched
        ]
        noticed = [(p, z) for p, z in noticed if p.any()]
        ends = [low, high, *(z + d for _, z in noticed for d in (-half, half))]
        edges = np.sort(np.clip(ends, low, high), axis=0).T
        with np.errstate(divide="ignore"):
            log = np.log(np.diff(edges))
            for p, z in noticed:
                level = np.abs((edges[:, 1:] + edges[:, :-1]) / 2 - z[:, None]) < half
                log += np.where(level, np.log1p(-p)[:, None], 0.0)
        return edges, log


def _moments(log: Array, phi: Array, weight: Array) -> tuple[Array, Array, Array]:
    """Mean and variance of φ at each distance (n,), and the mass there over the largest."""
    mass = np.exp(log - log.max(axis=1, keepdims=True)) * weight
    mean = (mass * phi).sum(axis=1) / mass.sum(axis=1)
    variance = (mass * (phi - mean[:, None]) ** 2).sum(axis=1) / mass.sum(axis=1)
    return mean, variance, mass.sum(axis=1) * np.exp(log.max(axis=1) - log.max())


def metres(name: str, value: ArrayLike) -> Array:
    """Finite head coordinates, m; refuses a metre or more, which are likely millimetres."""
    at = finite(name, value, "give metres")
    if np.any(np.abs(at) >= 1.0):
        far = at.flat[np.argmax(np.abs(at))]
        raise Refusal(
            f"{name} is in metres from the middle of a head",
            f"{far:g}",
            f"write {far:g}e-3 if that was in millimetres",
        )
    return at


def one_place(place: ArrayLike, count: int = 2) -> Array:
    """A place as x and y, or x, y and z."""
    at = metres("place", place)
    if at.shape != (count,):
        what, such = "x and y", "[20e-3, 0.0]"
        if count == 3:
            what, such = "x, y and z", "[20e-3, 0.0, 5e-3]"
        raise Refusal(f"A place is {what} in metres", f"shape {at.shape}", f"write {such}")
    return at
