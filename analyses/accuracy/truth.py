"""Posteriors by plain sums over the whole domain: the referee of every engine of the package.

    python analyses/accuracy/truth.py [table] [--count 500] [--seed 20261124]

Draws observers and readings (`cases.py`) and appends mean, sd and 95 % interval of every unknown to
a CSV table, one row a reading. What is there already is kept, so an interrupted run goes on.

Nothing of `weberwhisk.inference` but `Observer`, which draws the reading, has a part in it. The
signals, and the largest angle held at a distance, are the package's mechanics; the prior, the
likelihood and the sums are written out here:

- A contact is r = reach/(1 + e⁻ˣ) and θ = largest(r)·(1 − c²) with c = 1/(1 + eᵗ). Base, tip, no
  deflection and the fold are at infinity, and signals are smooth up to the fold in c. What else is
  unknown is a score z whose prior is the standard normal, or the azimuth itself.
- The density there vanishes at both ends, so that plain sums at even steps converge faster than
  any power of the step, once that is below the width of what is summed.
- x and z lie on a lattice, of which the columns stay that hold any mass. Each has its own stretch
  of t. All of it is found by tempering: the first look is at the density to the power 1/16, which
  no coarse lattice misses, and power and step come down together.
- Every sum is held to the same sum over every second and fourth step in x, in z and in t, which
  tell the error that is left. The axis on which that is more than 2e-4 sd for means and sds or
  1e-3 sd for quantiles is halved.
"""

from __future__ import annotations

import argparse
import csv
import inspect
import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from cases import DIRECTION_SD, Case, cue_of, draw, largest_angle
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.ndimage import maximum_filter, minimum_filter
from scipy.optimize import brentq
from scipy.special import expit, log_expit, logit, ndtr, ndtri

import weberwhisk as ww

Array = NDArray[np.float64]

TABLE = Path(__file__).with_name("truth.csv")
COLUMNS = (
    "index", "kind", "edge", "observer", "contact", "reading", "truth", "log_evidence",
    "truth_error", "quantile_error",
)  # fmt: skip
#: What is asked of moments and quantiles, over the sd.
MOMENTS, QUANTILES = 2e-4, 1e-3
GOLDEN = (np.sqrt(5) - 1) / 2
#: ln of the share of the highest density below which nothing is summed.
DROP = 24.0
#: Where x, z and t begin and end: the mass beyond is below 1e-9 of all.
ENDS_X, ENDS_Z, ENDS_T = (-10.0, 20.0), (-6.5, 6.5), (-20.0, 12.0)
#: Contacts that are asked for at once, and most in one sum.
CHUNK, MOST = 200_000, 12_000_000
TAILS = np.array([0.025, 0.975])


@dataclass(frozen=True)
class Answer:
    """A posterior: of each unknown mean, sd and the ends of the 95 % interval.

    Attributes
    ----------
    truth : dict
        Name of each unknown to [mean, sd, 2.5 % quantile, 97.5 % quantile].
    log_evidence : float
        With the density 1 of every contact held.
    truth_error, quantile_error : float
        The errors that are left, over the sd.
    """

    truth: dict[str, list[float]]
    log_evidence: float
    truth_error: float
    quantile_error: float


# -- the density ---------------------------------------------------------------------------------


def log_likelihood(groups: Sequence[dict[str, Any]], reading: Array, signals: Array) -> Array:
    """ln of the Gaussian density of a reading (S,) at signals (..., S), (...)."""
    out, start = np.zeros(signals.shape[:-1]), 0
    for group in groups:
        size, rho = len(group["k"]), group["rho"]
        own = signals[..., start : start + size]
        sd = np.sqrt(np.square(group["floor"]) + np.square(np.asarray(group["k"]) * own))
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            z = (reading[start : start + size] - own) / sd
            square = (z * z).sum(axis=-1)
            if rho:
                square = square - rho / (1 + (size - 1) * rho) * z.sum(axis=-1) ** 2
                square = square / (1 - rho)
                out -= 0.5 * ((size - 1) * np.log(1 - rho) + np.log(1 + (size - 1) * rho))
            out -= 0.5 * square + np.log(sd).sum(axis=-1) + 0.5 * size * np.log(2 * np.pi)
        start += size
    return np.where(np.isnan(out), -np.inf, out)


@dataclass(frozen=True)
class Density:
    """The posterior density of a case in x, z and t, up to the evidence.

    Parameters
    ----------
    whisker : Whisker
    cue : Cue
    groups : list of dict
        The noise.
    reading : array, shape (S,)
    """

    whisker: ww.Whisker
    cue: Any
    groups: list[dict[str, Any]]
    reading: Array

    @cached_property
    def third(self) -> str | None:
        """The unknown beside distance and angle, if there is one."""
        return self.cue.unknowns[2] if len(self.cue.unknowns) > 2 else None

    @cached_property
    def middle(self) -> float:
        """Where z begins to count: at the azimuth that was read, else at 0."""
        if self.third != "azimuth":
            return 0.0
        return float(self.reading[list(self.cue.circular).index(True)])

    @cached_property
    def reach(self) -> float:
        """The largest distance at which the cue works at all, m."""
        return float(self.cue.farthest(self.whisker))

    def value(self, z: Array) -> Array:
        """The third unknown at its score."""
        if self.third == "friction_angle":
            largest = np.arctan(self.cue.coefficient)
            return largest * (2 * ndtr(z) - 1)
        if self.third == "curvature_offset":
            return self.cue.spread * z
        if self.third == "hinge_stiffness":
            return self.whisker.hinge_stiffness * np.exp(self.cue.spread * z)
        if self.third == "stiffness":
            return np.exp(self.cue.spread * z)
        return self.middle + z

    def log_prior(self, z: Array) -> Array:
        """ln of the prior density of z."""
        if self.third is None:
            return np.zeros(z.shape)
        if self.third == "azimuth":
            return np.full(z.shape, -np.log(2 * np.pi))
        return -0.5 * (z**2 + np.log(2 * np.pi))

    def reaches(self, z: Array) -> Array:
        """The largest distance of each z (n,), m: less the more the whisker is curved."""
        if self.third != "curvature_offset":
            return np.full(z.shape, self.reach)
        low, high = np.full(z.shape, 0.5 * self.reach), np.full(z.shape, self.reach * (1 + 1e-9))
        for _ in range(60):
            middle = (low + high) / 2
            held = np.isfinite(self._limit(middle, z))
            low, high = np.where(held, middle, low), np.where(held, high, middle)
        return low

    def _limit(self, r: Array, z: Array) -> Array:
        contact = np.stack([r, np.zeros(r.shape), self.value(z)], axis=-1)
        return np.asarray(self.cue.forward(self.whisker, contact).limit(r))

    def columns(self, x: Array, z: Array, reaches: Array) -> tuple[Array, Array, Array]:
        """Of columns (n,): contacts (n, U) without angles, largest angles, ln of the prior."""
        contact = np.zeros((x.size, len(self.cue.unknowns)))
        contact[:, 0] = reaches * expit(x)
        if self.third is not None:
            contact[:, 2] = self.value(z)
        width = np.ones(x.shape)
        if contact.shape[1] > 1:
            width = largest_angle(self.cue, self.whisker, contact)
        log = np.log(reaches) + log_expit(x) + log_expit(-x) + self.log_prior(z)
        with np.errstate(divide="ignore"):
            return contact, width, log + np.log(width)

    def __call__(
        self, contact: Array, width: Array, log_prior: Array, t: Array
    ) -> tuple[Array, Array]:
        """ln density and angles (n, m) at t (n, m) of columns (n,)."""
        c = expit(-t)
        theta = width[:, None] * expit(t) * (1 + c)
        out = np.log(2) + 2 * log_expit(-t) + log_expit(t) + log_prior[:, None]
        step = max(CHUNK // t.shape[1], 1)
        for start in range(0, len(t), step):
            rows = slice(start, start + step)
            whole = np.repeat(contact[rows, None, :], t.shape[1], axis=1)
            whole[..., 1] = theta[rows]
            out[rows] += self.likelihood(whole.reshape(-1, whole.shape[-1])).reshape(t[rows].shape)
        return out, theta

    def likelihood(self, contact: Array) -> Array:
        """ln likelihood of contacts (n, U), (n,)."""
        with np.errstate(all="ignore"):
            signals, outcome = self.cue.signals(self.whisker, contact)
        held = outcome == 0
        turning = np.flatnonzero(self.cue.circular)  # known to whole turns
        turns = (signals[:, turning] - self.reading[turning]) / (2 * np.pi)
        signals[:, turning] -= 2 * np.pi * np.round(turns)
        log = log_likelihood(self.groups, self.reading, np.where(held[:, None], signals, 1.0))
        return np.where(held, log, -np.inf)


# -- the lattice ---------------------------------------------------------------------------------


class Lattice:
    """Columns at even steps of x and z, each with the stretch of t that holds its mass.

    Every row of one z is shifted in x by another fraction of the step: ridges that run along z
    would else be met by each row at the same places.

    Parameters
    ----------
    density : Density
    """

    def __init__(self, density: Density) -> None:
        self.density = density
        deep = density.third is not None
        step_z = 2 * np.pi / 26 if density.third == "azimuth" else 0.5
        self.x0, self.hx = ENDS_X[0], 0.4 if deep else 0.1
        self.z0, self.hz = (-13 * step_z if density.third == "azimuth" else ENDS_Z[0]), step_z
        count = round((ENDS_X[1] - ENDS_X[0]) / self.hx) + 1
        shape = (count, 27 if deep else 1)
        if not deep:
            self.z0 = 0.0
        self.low, self.high = np.full(shape, ENDS_T[0]), np.full(shape, ENDS_T[1])
        self.look(16.0, 214 if deep else 600)
        self.halve(x=True, z=False)
        self.look(4.0, 64)
        self.halve(x=not deep, z=False)
        self.look(1.0, 64)

    @property
    def shifts(self) -> Array:
        """Of the x of each row, in steps."""
        rows = np.arange(self.low.shape[1])
        return (rows * GOLDEN) % 1.0 - 0.5 if len(rows) > 1 else np.zeros(1)

    @property
    def starts(self) -> Array:
        """The first x of each row."""
        return self.x0 + self.hx * self.shifts

    @property
    def z(self) -> Array:
        return self.z0 + self.hz * np.arange(self.low.shape[1])

    @property
    def kept(self) -> NDArray[np.bool_]:
        """Which columns hold any mass."""
        return np.isfinite(self.low)

    def look(self, power: float, count: int) -> None:
        """Bring every stretch down to what matters to the density to the power 1/`power`."""
        places, t, log, _, step = self.nodes(count)
        best = log.max(axis=1)
        level = best.max() - DROP * power
        inside = log > level
        rows = inside.any(axis=1)
        first, last = inside.argmax(axis=1), count - 1 - inside[:, ::-1].argmax(axis=1)
        index = np.arange(len(t))
        low, high = t[index, first] - step, t[index, last] + step
        self.low[places] = np.where(rows, low, np.nan)
        self.high[places] = np.where(rows, high, np.nan)

    def nodes(self, count: int) -> tuple[Any, Array, Array, Array, Array]:
        """Of the n columns kept: where they are, t, ln density and angle (n, count), step (n,)."""
        places = np.nonzero(self.kept)
        z = self.z
        reaches = self.density.reaches(z)[places[1]]
        x = self.starts[places[1]] + self.hx * places[0]
        given = self.density.columns(x, z[places[1]], reaches)
        low, high = self.low[places], self.high[places]
        step = (high - low) / count
        t = low[:, None] + step[:, None] * (np.arange(count) + 0.5)
        log, theta = self.density(*given, t)
        return places, t, log, theta, step

    def halve(self, *, x: bool, z: bool) -> None:
        """Halve the steps, and let columns beside those kept have another look."""
        x_times, z_times = 1 + x, 1 + (z and self.low.shape[1] > 1)
        rows, columns = (np.flatnonzero(self.kept.any(axis=a)) for a in (1, 0))
        flat = self.low.shape[1] == 1
        pad_x, pad_z = (x_times, 0) if flat else (x_times + 2, z_times)
        shape = (
            x_times * (rows[-1] - rows[0]) + 1 + 2 * pad_x,
            z_times * (columns[-1] - columns[0]) + 1 + 2 * pad_z,
        )
        here = np.nonzero(self.kept)
        there = (
            x_times * (here[0] - rows[0]) + pad_x,
            z_times * (here[1] - columns[0]) + pad_z,
        )
        reach = 2 * pad_x + 1, 2 * pad_z + 1
        low, high = np.full(shape, np.inf), np.full(shape, -np.inf)
        low[there], high[there] = self.low[here], self.high[here]
        low = minimum_filter(low, reach, mode="constant", cval=np.inf)
        high = maximum_filter(high, reach, mode="constant", cval=-np.inf)
        self.x0 += self.hx * (rows[0] - pad_x / x_times)
        self.z0 += self.hz * (columns[0] - pad_z / z_times)
        self.hx, self.hz = self.hx / x_times, self.hz / z_times
        self.low = np.where(np.isfinite(low), low, np.nan)
        self.high = np.where(np.isfinite(low), high, np.nan)


# -- sums ----------------------------------------------------------------------------------------


class Sums:
    """Moments and quantiles of a lattice, with all of its nodes or with every other.

    Parameters
    ----------
    lattice : Lattice
    count : int
        Nodes in t of every column; even.
    """

    def __init__(self, lattice: Lattice, count: int) -> None:
        self.density, self.shape = lattice.density, lattice.low.shape
        self.places, self.t, log, self.theta, self.step = lattice.nodes(count)
        self.highest = log.max()
        self.log = log - self.highest
        self.starts, self.z = lattice.starts, lattice.z
        self.hx, self.hz = lattice.hx, lattice.hz
        self.reaches = self.density.reaches(self.z)
        x = self.starts[self.places[1]] + self.hx * self.places[0]
        self.r = self.reaches[self.places[1]] * expit(x)

    @property
    def names(self) -> tuple[str, ...]:
        return self.density.cue.unknowns

    def of(
        self, by_x: int = 1, by_z: int = 1, by_t: int = 1, *, with_quantiles: bool = True
    ) -> tuple[Array, Array, float]:
        """Mean and sd (U, 2), quantiles (U, 2) and ln evidence of every so many steps."""
        own = (self.places[0] % by_x == 0) & (self.places[1] % by_z == 0)
        log, theta = self.log[own, ::by_t], self.theta[own, ::by_t]
        weight = np.exp(log) * (by_t * self.step[own])[:, None]
        mass = weight.sum(axis=1)
        total = mass.sum()
        each = [self.r[own, None], theta]
        parts = [mass[:, None], weight]
        if self.density.third is not None:
            each.append(self.density.value(self.z[self.places[1][own]])[:, None])
            parts.append(mass[:, None])
        moments = np.empty((len(each), 2))
        for i, (value, part) in enumerate(zip(each, parts, strict=True)):
            mean = (part * value).sum() / total
            moments[i] = mean, np.sqrt((part * (value - mean) ** 2).sum() / total)
        cell = by_x * self.hx * (by_z * self.hz if self.density.third is not None else 1.0)
        evidence = float(np.log(total * cell) + self.highest)
        if not with_quantiles:
            return moments, np.full(moments.shape, np.nan), evidence

        # Along t in every column; along x, of the masses of columns, at every z; along z.
        angle = Rises(np.exp(log), by_t * self.step[own], self.t[own, 0])
        widest = theta[:, 0] / (1 - expit(-self.t[own, 0]) ** 2)
        table = np.zeros(self.shape)
        table[self.places[0][own], self.places[1][own]] = mass
        table, z = table[::by_x, ::by_z], self.z[::by_z]
        reaches = self.reaches[::by_z]
        distance = Rises(table.T, by_x * self.hx, self.starts[::by_z])

        def fold(a: float) -> Array:
            with np.errstate(divide="ignore"):
                c = np.sqrt(np.clip(1 - a / widest, 0.0, 1.0))
                return np.log1p(-c) - np.log(c)

        def place(a: float) -> Array:
            return logit(np.clip(a / reaches, 0.0, 1.0))

        quantiles = [distance.ends(place, *moments[0]), angle.ends(fold, *moments[1])]
        if self.density.third is not None:
            third = Rises(table.sum(axis=0)[None], by_z * self.hz, z[0])
            scores = third.ends(lambda a: np.array([a]), 0.5 * (z[0] + z[-1]), 0.1 * np.ptp(z))
            quantiles.append(self.density.value(scores))
        return moments, np.array(quantiles), evidence


class Rises:
    """How much of all mass is below a value, of densities along rows.

    Parameters
    ----------
    density : array, shape (n, m)
        At even steps of each row, on which cubic splines go.
    step, start : array, shape (n,), or float
        The step and the first node of each row.
    """

    def __init__(self, density: Array, step: Array | float, start: Array | float) -> None:
        rise = CubicSpline(np.arange(density.shape[1]), density, axis=1).antiderivative()
        self.terms = rise.c
        self.size, self.last = len(density), density.shape[1] - 1
        self.step, self.start = np.broadcast_to(step, self.size), start
        self.total = self._sum(np.full(self.size, float(self.last)))

    def _sum(self, position: Array) -> float:
        position = np.clip(position, 0.0, self.last)
        k = np.minimum(position.astype(np.int64), self.last - 1)
        terms = self.terms[:, k, np.arange(self.size)]
        return float((np.polyval(terms, position - k) * self.step).sum())

    def ends(self, coordinate: Callable[[float], Array], middle: float, scale: float) -> Array:
        """The two ends of the 95 % interval, of a value whose coordinate in each row is given."""

        def miss(value: float, share: float) -> float:
            return self._sum((coordinate(value) - self.start) / self.step) / self.total - share

        out = []
        for share in TAILS:
            low, high, size = middle, middle, scale
            while miss(low, share) > 0:
                low, size = low - size, 2 * size
            size = scale
            while miss(high, share) < 0:
                high, size = high + size, 2 * size
            out.append(brentq(miss, low, high, args=(share,), xtol=1e-7 * scale))
        return np.array(out)


def posterior_of(case: Case) -> Answer:
    """The posterior of a case.

    Parameters
    ----------
    case : Case

    Returns
    -------
    Answer
    """
    whisker, cue = ww.Whisker(**case.spec["whisker"]), cue_of(case.spec["cue"])
    groups, reading = case.spec["noise"], np.array(case.reading)
    if len(cue.unknowns) == 1:
        return _of_one(Density(whisker, cue, groups, reading))
    if "azimuth" in cue.unknowns and not whisker.curvature:
        sizes = ww.cues.ForceMap(cue.signal_names[:3])
        return _of_straight(Density(whisker, sizes, groups[:1], reading[:3]), reading)
    return _of_several(Density(whisker, cue, groups, reading))


def _of_several(density: Density) -> Answer:
    """Of distance, angle and perhaps one unknown more."""
    lattice = Lattice(density)
    axes = ("by_x", "by_t") if density.third is None else ("by_x", "by_z", "by_t")
    count = 32
    while True:
        sums = Sums(lattice, count)
        moments, _, evidence = sums.of(with_quantiles=False)
        sd = moments[:, 1:]
        off = {}
        for axis in axes:
            two, four = (sums.of(**{axis: n}, with_quantiles=False)[0] for n in (2, 4))
            off[axis] = [left(moments, two, four, sd), np.inf]
        bad = {a for a in axes if off[a][0] > MOMENTS}
        if not bad:
            quantiles = sums.of()[1]
            for axis in axes:
                two, four = (sums.of(**{axis: n})[1] for n in (2, 4))
                off[axis][1] = left(quantiles, two, four, sd)
            bad = {a for a in axes if off[a][1] > QUANTILES}
        if not bad or len(sums.step) * count * 2 ** len(bad) > MOST:
            quantiles = sums.of()[1]
            break
        count *= 1 + ("by_t" in bad)
        if bad & {"by_x", "by_z"}:
            lattice.halve(x="by_x" in bad, z="by_z" in bad)
            lattice.look(1.0, 48)
    truth = {
        name: [*map(float, m), *map(float, q)]
        for name, m, q in zip(sums.names, moments, quantiles, strict=True)
    }
    return Answer(truth, evidence, *(float(max(o[i] for o in off.values())) for i in (0, 1)))


def left(one: Array, two: Array, four: Array, sd: Array) -> float:
    """The error that is left, over the sd: from sums over all, every second and fourth step.

    What the last halving of the step changed, times how much less that was than the one before,
    but no less than a sixteenth of it; and all of it where the change has not fallen by four.
    """
    last, before = (float(np.max(np.abs(a - b) / sd)) for a, b in ((one, two), (two, four)))
    fall = last / before if before > 0 else 1.0
    return last * max(fall, 1 / 16) if fall < 1 / 4 else last


def _of_straight(density: Density, reading: Array) -> Answer:
    """Of a contact of a straight whisker in space, whose azimuth stands by itself.

    Two readings of the azimuth, each with the same sd, and a prior that is flat all around.
    """
    plane = _of_several(density)
    sd = DIRECTION_SD / np.sqrt(2)
    mean = float(reading[3:].mean())
    truth = plane.truth | {"azimuth": [mean, sd, *map(float, mean + sd * ndtri(TAILS))]}
    apart = reading[3] - reading[4]
    evidence = -np.log(2 * np.pi) - 0.5 * (apart / DIRECTION_SD) ** 2 / 2
    evidence -= 0.5 * np.log(2 * np.pi * 2 * DIRECTION_SD**2)
    evidence = plane.log_evidence + float(evidence)
    return Answer(truth, evidence, plane.truth_error, plane.quantile_error)


def _of_one(density: Density, step: float = 0.004) -> Answer:
    """Of the distance alone: one long sum."""
    x = np.arange(*ENDS_X, step)
    contact, _, log = density.columns(x, np.zeros(x.shape), np.full(x.shape, density.reach))
    log = log + density.likelihood(contact)
    r, highest = contact[:, 0], log.max()
    log = log - highest

    def of(every: int) -> tuple[Array, Array, float]:
        weight = np.exp(log[::every])
        mean = (weight * r[::every]).sum() / weight.sum()
        sd = np.sqrt((weight * (r[::every] - mean) ** 2).sum() / weight.sum())
        ends = Rises(weight[None], every * step, x[0]).ends(
            lambda a: logit(np.array([np.clip(a / density.reach, 0.0, 1.0)])), mean, sd
        )
        return np.array([mean, sd]), ends, float(np.log(weight.sum() * every * step) + highest)

    moments, quantiles, evidence = of(1)
    others = of(2)
    off = [np.max(np.abs(new - old)) / moments[1] for new, old in (
        (moments, others[0]), (quantiles, others[1])
    )]  # fmt: skip
    truth = {"radial_distance": [*map(float, moments), *map(float, quantiles)]}
    return Answer(truth, evidence, float(off[0]), float(off[1]))


# -- the table -----------------------------------------------------------------------------------


def row_of(index: int, case: Case, answer: Answer) -> dict[str, Any]:
    """A line of the table."""
    rounded: Callable[[float], float] = lambda value: float(f"{value:.10g}")  # noqa: E731
    truth = {name: [rounded(v) for v in values] for name, values in answer.truth.items()}
    return {
        "index": index,
        "kind": case.kind,
        "edge": case.edge,
        "observer": json.dumps(case.spec),
        "contact": json.dumps(case.contact),
        "reading": json.dumps(case.reading),
        "truth": json.dumps(truth),
        "log_evidence": f"{answer.log_evidence:.8g}",
        "truth_error": f"{answer.truth_error:.2g}",
        "quantile_error": f"{answer.quantile_error:.2g}",
    }


def main() -> None:
    """Write what is missing of the table."""
    parser = argparse.ArgumentParser(
        description=inspect.cleandoc(__doc__ or ""),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("table", type=Path, nargs="?", default=TABLE)
    parser.add_argument("--count", type=int, default=500, help="readings; by default 500")
    parser.add_argument("--seed", type=int, default=20261124, help="by default 20261124")
    given = parser.parse_args()
    done: set[int] = set()
    if given.table.exists():
        with given.table.open(newline="", encoding="utf-8") as file:
            done = {int(row["index"]) for row in csv.DictReader(file)}
    with given.table.open("a", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, COLUMNS)
        if not done:
            writer.writeheader()
        for index in range(given.count):
            if index in done:
                continue
            start = time.perf_counter()
            case = draw(index, given.seed)
            answer = posterior_of(case)
            writer.writerow(row_of(index, case, answer))
            file.flush()
            took = time.perf_counter() - start
            print(f"{index} {case.kind} {case.edge or '-'}: {answer.truth_error:.1g} sd, "
                  f"{answer.quantile_error:.1g} sd, {took:.1f} s", flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
