"""Contacts located by a calibration: posteriors of distance, averaged over the calibration's draws.

With w the inverse of the curve's slope at a distance, y·w − 1 of a slope y is its deviation from
the curve: the misfit, which the slopes of a touch share, and noise. The density of w is nearly
normal, and a few draws of it for each of the calibration's, weighted, are enough. A slope far from
others of its touch may be gross, as in `taps`, and sets of gross slopes are summed over.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy.special import logsumexp
from scipy.stats import t as t_distribution

from .._util.values import Array, Index, weighted_quantiles
from .calibration import KEPT, NAMED, Calibration
from .taps import BATCH, GROSS_SHARE, Sensor, far_rows, gross_sets, log_gross

__all__ = ["Slopes", "averaged"]

#: Degrees of freedom of the Student's t of which draws are.
FREE = 6.0
#: Draws for each of the calibration's, in tables up to that many slopes; in larger ones it is one.
#: With one, lower ends were off by up to 0.25 sd where the misfit's size was open.
EACH, FEW_SLOPES = 8, 200
#: With draws worth fewer independent ones a row keeps what the best fit says of it.
FEW = 50


@dataclass(frozen=True)
class Slopes:
    """Slopes of contacts to be located by a calibration.

    Parameters
    ----------
    y : ndarray, shape (n,)
        NaN where there is none.
    variance : ndarray, shape (n,)
        Of their measurement errors.
    touch : ndarray of int, shape (n,)
        The touch of each, −1 for none.
    prior : callable
        Prior density of distances (m), up to a factor.
    """

    y: Array
    variance: Array
    touch: Index
    prior: Callable[[Array], Array]


class Distances(NamedTuple):
    """Mean, sd and 95 % interval of distances (T, 4), m, and the probability of rows (n,) that
    they are gross."""

    values: Array
    gross: Array


def averaged(calibration: Calibration, located: pd.DataFrame, slopes: Slopes) -> pd.DataFrame:
    """A table located by the best fit, with means over the calibration's samples in its place."""
    out = located.copy()
    members = np.flatnonzero(out["radial_distance_mm"].notna() & (slopes.y > 0))
    alone = _distances(calibration.sensors, slopes, list(members[:, None]))
    _put(out, "", list(members[:, None]), alone.values)
    share = f"{100 * calibration.misfit:.2g} % of the slopes"
    count = len(calibration.samples)
    note = f"Means over {count} draws of the calibration, whose misfit is {share}."
    if "touch_status" in out:
        used = members[slopes.touch[members] >= 0]
        used = used[np.argsort(slopes.touch[used], kind="stable")]
        names, first = np.unique(slopes.touch[used], return_index=True)
        touches = _distances(calibration.sensors, slopes, np.split(used, first[1:]))
        _put(out, "touch_", [np.flatnonzero(slopes.touch == t) for t in names], touches.values)
        gross = touches.gross >= NAMED
        out.loc[gross, "message"] += "; it does not belong to its touch"
    out.attrs = out.attrs | {"notes": (*out.attrs["notes"], note)}
    if not calibration.fits:
        tested = "does not fit" if calibration.p_value < 0.01 else "was not tested"
        is_located = out["radial_distance_mm"].notna().to_numpy()
        out.loc[is_located, "message"] += f"; the calibration {tested}: widened by {share}"
    return out


def _put(out: pd.DataFrame, of: str, members: Sequence[Index], values: Array) -> None:
    """Put mean, sd and ends (T, 4), in mm, into the rows of each, where there are any."""
    for name, column in zip(("radial_distance", "sd", "lower", "upper"), values.T, strict=True):
        new = out[f"{of}{name}_mm"].to_numpy(float, copy=True)
        for place, value in zip(members, column, strict=True):
            if np.isfinite(value):
                new[place] = 1e3 * value
        out[f"{of}{name}_mm"] = new


def _distances(sensor: Sensor, slopes: Slopes, touches: Sequence[Index]) -> Distances:
    """The distance of each touch, of which these are the rows."""
    values, gross = [np.zeros((0, 4))], np.zeros(len(slopes.y))
    if len(slopes.y) <= FEW_SLOPES:
        sensor = Sensor(*(np.tile(draws, EACH) for draws in sensor))
    ends = np.cumsum([members.size for members in touches])
    batch = (ends * len(sensor.k)) // BATCH
    for number in np.unique(batch):
        chunk = [touches[i] for i in np.flatnonzero(batch == number)]
        result = _Readings.of(sensor, slopes, chunk).distances(slopes.prior)
        values.append(result.values)
        gross += result.gross
    return Distances(np.concatenate(values), gross)


@dataclass(frozen=True)
class _Readings:
    """What slopes of touches may be: sets of them that belong and that are gross, for N sensors.

    Parameters
    ----------
    sensor : Sensor
        Of N draws.
    slopes : Slopes
    touch : ndarray of int, shape (G,)
        The touch of each set, ascending.
    belong : ndarray of int, shape (R,)
        Rows that belong, set by set.
    first : ndarray of int, shape (G,)
        Where those of each set begin.
    gross : sequence of ndarray of int
        The gross rows of each set.
    """

    sensor: Sensor
    slopes: Slopes
    touch: Index
    belong: Index
    first: Index
    gross: Sequence[Index]

    @classmethod
    def of(cls, sensor: Sensor, slopes: Slopes, touches: Sequence[Index]) -> _Readings:
        """All that may be gross in touches of three slopes or more."""
        belong, gross, touch = [], [], []
        k = np.median(sensor.k)
        for number, members in enumerate(touches):
            suspects = members[:0]
            if members.size > 2:
                y = slopes.y[members]
                sd = np.sqrt((k * y) ** 2 + slopes.variance[members])
                suspects = members[far_rows((y - np.median(y)) / sd)]
            for chosen in gross_sets(suspects):
                if chosen.size < members.size:
                    touch.append(number)
                    gross.append(chosen)
                    belong.append(np.setdiff1d(members, chosen) if chosen.size else members)
        first = np.cumsum([0, *(members.size for members in belong[:-1])])
        return cls(sensor, slopes, np.array(touch), np.concatenate(belong), first, gross)

    @property
    def size(self) -> Index:
        """How many rows of each set belong, (G,)."""
        return np.diff(self.first, append=self.belong.size)

    def sums(self, w: Array) -> tuple[Array, Array, Array, Array]:
        """Sums over rows that belong of p, p·y, p·y² and ln p, (N, G), p the precision at w."""
        k, y, variance = self.sensor.k[:, None], self.slopes.y[self.belong], self.slopes.variance
        if not variance.any():
            p = 1 / k**2
            total, square = (np.add.reduceat(v, self.first) for v in (y, y**2))
            return p * self.size, p * total, p * square, self.size * np.log(p)
        every = np.repeat(np.broadcast_to(w, (len(k), self.first.size)), self.size, axis=1)
        p = 1 / (k**2 + variance[self.belong] * every**2)
        of_p, of_py, of_pyy, of_log = (
            np.add.reduceat(v, self.first, axis=1) for v in (p, p * y, p * y**2, np.log(p))
        )
        return of_p, of_py, of_pyy, of_log

    def log_likelihood(self, w: Array) -> Array:
        """ln of the density of the slopes of each set at w (N, G), misfits integrated out."""
        p, py, pyy, log_p = self.sums(w)
        shared = self.sensor.misfit[:, None] ** 2
        square = pyy * w**2 - 2 * py * w + p - shared / (1 + shared * p) * (py * w - p) ** 2
        log = 0.5 * (log_p - np.log1p(shared * p) - square)
        log += self.size * (np.log(w) + np.log1p(-GROSS_SHARE) - 0.5 * np.log(2 * np.pi))
        for i in np.flatnonzero([members.size for members in self.gross]):
            off = self.slopes.y[self.gross[i]] * w[:, i, None] - 1
            each = np.log(w[:, i, None]) + log_gross(off, self.sensor.k[:, None])
            log[:, i] += each.sum(axis=1)
        return np.asarray(log)

    def distances(self, prior: Callable[[Array], Array]) -> Distances:
        """The distance of each touch, over the sensors.

        A touch's scatter does not weigh sensors: their k is that of the calibration.
        """
        n, size, slopes = len(self.sensor.k), self.size, self.slopes
        p, py, pyy, _ = self.sums(size / np.add.reduceat(slopes.y[self.belong], self.first))
        shared = self.sensor.misfit[:, None] ** 2
        shared = shared / (1 + shared * p)
        # ln of the density at w is size·ln w − a·w²/2 + b·w, up to errors of measurement.
        a, b = pyy - shared * py**2, py - shared * py * p
        middle = (b + np.sqrt(b**2 + 4 * a * size)) / (2 * a)
        sd = 1 / np.sqrt(a + size / middle**2)
        at_middle = self.log_likelihood(middle)
        # In strata: those of one draw of the calibration are as far apart as can be.
        each = n // KEPT if n % KEPT == 0 else 1
        order = np.random.default_rng(0).permutation(n // each)
        rank = (np.arange(each)[:, None] * order.size + order).ravel()
        t = t_distribution.ppf((rank + 0.5) / n, FREE)[:, None]
        w = middle + t * sd
        scale, apex, hinge = (v[:, None] for v in self.sensor[:3])
        possible = (w > 0) & (w * scale > hinge)
        w = np.where(possible, w, np.maximum(middle, 2 * hinge / scale))
        r = 1 / (1 / (w * scale - hinge) + 1 / apex)
        density = np.where(possible, prior(r), 0.0) * scale * (r / (w * scale - hinge)) ** 2
        with np.errstate(divide="ignore"):
            log = self.log_likelihood(w) - t_distribution.logpdf(t, FREE) + np.log(density)
        log_mass = at_middle + np.log(sd)
        log += np.log(sd)
        gross = np.zeros(len(slopes.y))
        values = np.full((self.touch.max(initial=-1) + 1, 4), np.nan)
        begin = np.searchsorted(self.touch, np.arange(len(values) + 1))
        for touch, sets in enumerate(map(slice, begin, begin[1:])):
            relative = log[:, sets] - logsumexp(log_mass[:, sets], axis=1, keepdims=True)
            if not np.isfinite(relative.max()):
                continue
            weight = np.exp(relative - relative.max())
            weight /= weight.sum()
            if 1 / (weight**2).sum() < FEW:
                continue
            place, share = r[:, sets].ravel(), weight.ravel()
            mean = share @ place
            sd_of_place = np.sqrt(share @ (place - mean) ** 2)
            values[touch] = mean, sd_of_place, *weighted_quantiles(place, share, [0.025, 0.975])
            for members, mass in zip(self.gross[sets], weight.sum(axis=0), strict=True):
                gross[members] += mass
        return Distances(values, gross)
