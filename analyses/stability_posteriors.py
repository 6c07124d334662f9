"""The posteriors' part of `stability.py`: engines, cues and receptors beside brute force.

A case is a contact, a Weber fraction, and how far each reading lies off its mean, in sds. The
reference is a midpoint sum over the distance and, row by row, over the second unknown, each row in
a window of its own that closes in upon its mass; it shares the likelihood with the engines, and
nothing else: no coordinates, modes, panels or grids.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any, NamedTuple
from zlib import crc32

import numpy as np
import stability_three
from fault_search import Axis, Domain, Fate, Judged
from scipy.interpolate import CubicSpline
from scipy.special import expit, logit

import weberwhisk as ww
from weberwhisk import Observer, Status, Whisker, cues, domain, receptors
from weberwhisk.cues.force_map import SIGNALS
from weberwhisk.inference import default_noise

Array = np.ndarray
Case = dict[str, Array]

W = Whisker(50e-3, 100e-6, 5e-6, 3e9)
CYLINDER = Whisker(50e-3, 100e-6, 100e-6, 3e9)
BLUNT = Whisker(50e-3, 100e-6, 67e-6, 3e9)
UNIT = float(W.compliance_constant / W.length)
#: Weber fractions that observers are made for: one is taken for the nearest.
FRACTIONS = (0.01, 0.03, 0.1, 0.3, 0.5, 0.6)
#: ln below the highest density at which a window ends.
DEPTH = 40.0
#: Rows to either side that tell of a lost one.
NEAR = 4

Make = Callable[[float], Observer]
OBSERVERS: dict[str, Make] = {
    "compliance": lambda k: Observer(W, cues.Compliance(), receptors.Weber(k)),
    "deep tap": lambda k: Observer(W, cues.Compliance(tap_angle=0.3), receptors.Weber(k)),
    "vibration": lambda k: Observer(W, *_vibration(k, phase=False)),
    "vibration, phase": lambda k: Observer(W, *_vibration(k, phase=True)),
    "vibrissa length": lambda k: Observer(W, cues.VibrissaLength(spread=k)),
    "balance, effort known": lambda k: Observer(
        W, cues.BalanceOfMoments(effort=0.5), receptors.GeneralisedWeber(0.0, floor=0.3 * k)
    ),
    "moment at a known angle": lambda k: Observer(
        W, cues.ForceMap("moment", deflection_angle=0.2), receptors.Weber(k)
    ),
    "floor and ceiling": lambda k: Observer(
        W, cues.Compliance(), receptors.GeneralisedWeber(k, floor=0.5 * UNIT, ceiling=5 * UNIT)
    ),
    "saturating": lambda k: Observer(
        W, cues.Compliance(), receptors.Saturating(k, ceiling=2 * UNIT)
    ),
    "log-normal": lambda k: Observer(W, cues.Compliance(), receptors.LogNormal(k)),
    "force map": lambda k: Observer(W, cues.ForceMap(), receptors.Weber(k)),
    "cylinder's ridge": lambda k: Observer(CYLINDER, cues.ForceMap(), receptors.Weber(k)),
    "three forces": lambda k: Observer(
        W, cues.ForceMap(SIGNALS), default_noise(W, cues.ForceMap(SIGNALS), k)
    ),
    "correlated map": lambda k: Observer(
        W, cues.ForceMap(), receptors.Weber([k, 2 * k], correlation=0.95)
    ),
    "axial force dominates": lambda k: Observer(W, cues.ForceMap(), receptors.Weber([k / 10, k])),
    "velocity felt": lambda k: Observer(
        W, cues.Compliance(velocity_spread=0.5), receptors.Weber(k)
    ),
    "angle-side-angle": lambda k: Observer(
        W, cues.AngleSideAngle(), receptors.GeneralisedWeber(0.0, floor=0.3 * k)
    ),
    "balance of moments": lambda k: Observer(
        W,
        cues.BalanceOfMoments(effort=None),
        receptors.GeneralisedWeber([0.0, k], floor=[0.017, 0.0]),
    ),
    "two taps fused": lambda k: Observer(
        W,
        cues.Fused(cues.Compliance(), cues.Compliance(tap_angle=0.3)),
        receptors.Joint([receptors.Weber(k), receptors.Weber(2 * k)], sizes=[1, 1]),
    ),
    "tap and map fused": lambda k: Observer(
        W,
        cues.Fused(cues.Compliance(), cues.ForceMap()),
        receptors.Joint([receptors.Weber(2 * k), receptors.Weber(k)], sizes=[1, 2]),
    ),
    "map and vibration fused": lambda k: Observer(
        BLUNT,
        cues.Fused(cues.ForceMap(), cues.Vibration(3)),
        receptors.Joint([receptors.Weber(k), cues.Vibration(3).noise(k, 0.5 * k)], sizes=[2, 2]),
    ),
    "map, stiffness unknown": lambda k: Observer(
        W, cues.UnknownStiffness(cues.ForceMap()), receptors.Weber(max(k, 0.03))
    ),
    "log-normal map, stiffness unknown": lambda k: Observer(
        W, cues.UnknownStiffness(cues.ForceMap()), receptors.LogNormal(max(k, 0.03))
    ),
    "angle-side-angle, side unknown": lambda k: Observer(
        W, cues.AngleSideAngle(side_sd=2e-3), receptors.GeneralisedWeber(0.0, floor=0.3 * k)
    ),
}


def _vibration(k: float, *, phase: bool) -> tuple[Any, Any]:
    cue = cues.Vibration(3, phase=phase)
    return cue, cue.noise(k, 0.5 * k)


@lru_cache(maxsize=256)
def observer(name: str, k: float) -> Observer:
    """The observer of that name, made once."""
    return OBSERVERS[name](k)


# -- brute force ----------------------------------------------------------------------------------


def _limit(o: Observer, r: Array) -> Array:
    """The largest angle at each distance: where the whisker flicks past or the cue ends."""
    if not o.forward.is_plain:  # by its table, which tests hold to the planar beam
        return np.asarray(o.space.angle_range(r)[1])
    limit = np.nan_to_num(ww.flick_past(o.whisker, r).deflection_angle)
    if hasattr(o.cue, "largest_angle"):
        limit = np.minimum(limit, o.cue.largest_angle(o.whisker, r))
    return np.asarray(limit)


def _log_weight(o: Observer, reading: Array, r: Array, v: Array | None) -> Array:
    """ln of posterior density, times the slope of the second unknown's coordinate v (r's shape).

    v is the logit of the share of the angle held, or the second unknown's ln.
    """
    contact, log = r[..., None], np.zeros(r.shape)
    if v is not None:
        if o.bounded > 1:
            share = expit(v)
            limit = np.maximum(_limit(o, r[:, 0]), 1e-300)[:, None]
            second = np.minimum(share, np.nextafter(1, 0)) * limit
            log = log + np.log(limit) - np.logaddexp(0, v) - np.logaddexp(0, -v)
        else:
            name = o.unknowns[1]
            second = _second(o, v)
            log = log + o.prior[name].logpdf(second)
            log = log + (v if o.prior[name].support()[0] == 0 else 0.0)
        contact = np.stack([r, second], axis=-1)
    return np.asarray(log + o.log_likelihood(reading, contact))


def _second(o: Observer, v: Array) -> Array:
    """The second unknown, where priors bound it: v is its ln where it is positive."""
    return np.exp(v) if o.prior[o.unknowns[1]].support()[0] == 0 else v


def _second_range(o: Observer) -> tuple[float, float]:
    if o.bounded > 1:
        return -34.0, 34.0
    low, high = o.prior[o.unknowns[1]].ppf([1e-15, 1 - 1e-15])
    return (np.log(low), np.log(high)) if o.prior[o.unknowns[1]].support()[0] == 0 else (low, high)


def _may_hold(log: Array, best: Array) -> Array:
    """Nodes that may stand beside what holds mass: a peak between two may be as much higher as
    they differ from each other.
    """
    safe = np.where(np.isfinite(log), log, -1e300)
    padded = np.pad(safe, ((0, 0), (1, 1)), constant_values=-1e300)
    up = np.maximum(padded[:, :-2], padded[:, 2:]) - safe
    down = safe - np.minimum(padded[:, :-2], padded[:, 2:])
    room = np.where(up > 0, up, np.minimum(down, 1e6))
    return np.asarray((safe + room > best - DEPTH) & np.isfinite(log))


def _rows(
    o: Observer, reading: Array, r: Array, n: int, exact: Observer | None = None
) -> tuple[Array, Array]:
    """ln ∫ dv of each distance, each in a window of its own; what half the nodes change."""
    if len(o.unknowns) == 1:
        log = _log_weight(exact or o, reading, r, None)
        return log, np.zeros(r.size)
    low, high = (np.full(r.size, end) for end in _second_range(o))
    for look in range(11):
        x = low[:, None] + (np.arange(n) + 0.5) / n * (high - low)[:, None]
        who = exact if exact and look == 10 else o
        log = _log_weight(who, reading, np.repeat(r[:, None], n, axis=1), x)
        best = log.max(axis=1, keepdims=True)
        if look == 10:
            break
        held = _may_hold(log, best)
        first, last = held.argmax(axis=1), n - 1 - held[:, ::-1].argmax(axis=1)
        some = held.any(axis=1)
        step = (high - low) / n
        new_low, new_high = low + (first - 1) * step, low + (last + 2) * step
        low, high = np.where(some, new_low, low), np.where(some, new_high, high)
        if o.bounded == 1:
            low, high = np.maximum(low, _second_range(o)[0]), np.minimum(high, _second_range(o)[1])
    with np.errstate(divide="ignore", invalid="ignore"):
        weight = np.exp(log - np.where(np.isfinite(best), best, 0.0))
        total = weight.sum(axis=1)
        half = np.abs(2 * weight[:, ::2].sum(axis=1) / total - 1)
        value = np.log(total) + best[:, 0] + np.log((high - low) / n)
    return np.where(np.isfinite(best[:, 0]), value, -np.inf), np.nan_to_num(half)


class Sums(NamedTuple):
    """Mean and sd of the distance, how well they are known (in sds), evidence, 95 % interval.

    And how well the ends of the interval are known, in sds.
    """

    mean: float
    sd: float
    known: float
    log_evidence: float
    interval: Array
    ends_known: Array


def brute(o: Observer, reading: Array, near: float) -> tuple[float, float, float]:
    """Mean and sd of the distance, and how well they are known (in sds)."""
    return distance_sums(o, reading, near)[:3]


def distance_sums(
    o: Observer,
    reading: Array,
    near: float,
    also: Callable[[Array], Array] | None = None,
    reach: tuple[float, float] | None = None,
    exact: Observer | None = None,
    fine: int = 96,
) -> Sums:
    """What a posterior says of the distance.

    Sums over w = logit of the distance's share of the reach, in a window that closes in upon all
    that holds mass. `near` is the w of a point of high density: narrow peaks fall between nodes.
    `also` is ln of what else a distance is told by, (n,), within `reach`. `exact` is an observer of
    the same contacts by equations too dear for the search of windows. `fine` is the nodes of a row.
    """
    low_r, high_r = reach or o.reach
    low, high = -32.0, 32.0
    one = len(o.unknowns) == 1
    inner, done = 56, False
    for look in range(12):
        last = done or look == 11
        n = (20000 if one else 400) if last else (2000 if one else 100)
        w = low + (np.arange(n) + 0.5) / n * (high - low)
        if look == 0:
            even = (np.arange(n) + 0.5) / n
            w = np.unique([*w, *np.log(even / (1 - even)), near])
        # What is left beyond is small in itself: take care of its digits.
        left = expit(-w) * (high_r - low_r)
        r = np.maximum(high_r - left, low_r + 1e-14)
        log, half = _rows(o, reading, r, fine if last else inner, exact if last else None)
        log = log - np.logaddexp(0, w) - np.logaddexp(0, -w)
        log = log + (0.0 if also is None else also(high_r - left))
        if last:
            break
        held = np.flatnonzero(_may_hold(log[None], log.max())[0])
        first, past = max(held[0] - 1, 0), min(held[-1] + 1, w.size - 1)
        window = w[first], w[past]
        if held[0] == 0 and look > 0:
            window = low - (high - low) / 4, window[1]
        if held[-1] == w.size - 1 and look > 0:
            window = window[0], high + (high - low) / 4
        done = look > 0 and (window[1] - window[0]) > 0.7 * (high - low)
        low, high = window
    weight = np.exp(log - log.max())
    found = []
    for part in (slice(None), slice(None, None, 2), slice(1, None, 2)):
        p, x = weight[part] / weight[part].sum(), left[part]
        mean = p @ x
        found.append((mean, np.sqrt(p @ (x - mean) ** 2)))
    (mean, sd), *halves = found
    off = max(max(abs(m - mean), abs(s - sd)) for m, s in halves) / sd
    # A smooth sum has next to no error: what half the nodes change says that there is a kink, or
    # that some rows, narrow ones, were missed, and then more may have been.
    share = weight / weight.sum()
    pull = np.maximum(1.0, ((left - mean) / sd) ** 2)
    lost = np.maximum(_between(share) - share, 0.0) + share * half**2
    ends = [_ends(log[::step], w[::step]) for step in (1, 2)]
    return Sums(
        high_r - mean,
        sd,
        3 * off + float(lost @ pull),
        float(np.log(weight.sum() * (high - low) / n * (high_r - low_r)) + log.max()),
        low_r + (high_r - low_r) * ends[0],
        np.abs(ends[0] - ends[1]) * (high_r - low_r) / sd,
    )


def _ends(log: Array, w: Array) -> Array:
    """Shares of the reach at 2.5 and 97.5 % of the mass, by a spline through ln of the density."""
    fine = np.linspace(w[0], w[-1], 40 * w.size)
    density = np.exp(CubicSpline(w, np.maximum(log - log.max(), -2 * DEPTH))(fine))
    rise = np.cumsum(density) - density / 2
    return expit(np.interp([0.025, 0.975], rise / density.sum(), fine))


def _between(share: Array) -> Array:
    """The lower of the highest of a few rows before and after each: no row of a smooth sum, but
    one whose peak was lost, is far below that."""
    padded = np.lib.stride_tricks.sliding_window_view(np.pad(share, NEAR), NEAR).max(axis=1)
    return np.asarray(np.minimum(padded[: share.size], padded[NEAR + 1 :]))


# -- the judge ------------------------------------------------------------------------------------

#: Error of mean and sd, in sds, that each engine promises: one unknown, and more.
PROMISED = {"quadrature": (2e-3, 2e-3), "emcee": (0.02, 0.03), "laplace": (0.25, 0.25)}
#: How well the sum must know its own answer to judge, in sds: one unknown, and more.
UNKNOWN = (1e-3, 1e-2)
#: How many times its claimed error an engine may be off: a Monte Carlo error is a standard error.
TIMES = {"quadrature": 3.0, "emcee": 5.0, "laplace": 1.5}


def judge(case: Case, name: str, method: str) -> Judged:
    """Each case's posterior by an engine, beside brute force."""
    n = case["distance"].size
    k = np.array(FRACTIONS)[np.abs(np.log(np.array(FRACTIONS)[:, None] / case["k"])).argmin(axis=0)]
    fate, excess = np.full(n, Fate.REFUSED), np.full(n, -np.inf)
    seen = {key: np.full(n, np.nan) for key in ("status", "mean", "sd", "exact_mean", "exact_sd")}
    seen["weber_fraction"] = k
    for value in np.unique(k):
        o = observer(name, float(value))
        rows = np.flatnonzero(k == value)
        low, high = o.reach
        columns = [low + np.clip(case["distance"][rows], 1e-6, 1 - 1e-9) * (high - low)]
        for key, unknown in zip(("push", "further"), o.unknowns[1:], strict=False):
            share = np.clip(case[key][rows], 1e-9, 1 - 1e-9)
            if unknown != "deflection_angle":
                share = o.prior[unknown].ppf(np.clip(share, 1e-3, 1 - 1e-3))
            columns.append(share)
        points = np.stack(columns, axis=-1)
        contact = points.copy()
        if o.bounded > 1:
            contact[:, 1] *= _limit(o, contact[:, 0])
        signals, outcome = o.signals(contact)
        held = outcome == 0
        near = logit((points[:, 0] - low) / (high - low))[held]
        rows, signals = rows[held], signals[held]
        if not rows.size:
            continue
        off = np.stack([case["off_1"][rows], case["off_2"][rows]], -1)
        off = np.concatenate([off, 0.3 * off], axis=-1)
        if isinstance(o.noise, receptors.Events):
            chosen = np.arange(rows.size) % len(o.noise.reports)
            reading = o.noise.reports[chosen]
        elif isinstance(o.noise, receptors.LogNormal):
            reading = o.noise.mean(signals) * np.exp(
                off[:, : signals.shape[-1]] * o.noise.sd(signals) / o.noise.mean(signals)
            )
        else:
            reading = o.noise.mean(signals) + off[:, : signals.shape[-1]] * o.noise.sd(signals)
        seed = crc32(case["off_1"].tobytes())
        p = ww.posterior(o, reading, method, seed=seed)
        promised = PROMISED[method][len(o.unknowns) > 1]
        for j, row in enumerate(rows):
            status = Status(int(p.status[j]))
            seen["status"][row], seen["mean"][row], seen["sd"][row] = status, p.mean[j], p.sd[j]
            # An odd reading is a warning; of one unknown its numbers must be right all the same. Of
            # more a climb may have ended beside the peak, of which the reading is then odd.
            odd = status == Status.IMPROBABLE_READING and len(o.unknowns) == 1
            if status != Status.CONVERGED and not odd:
                fate[row] = Fate.WARNED
                continue
            sums = stability_three.brute if len(o.unknowns) > 2 else brute
            mean, sd, known = sums(o, reading[j], near[j])
            seen["exact_mean"][row], seen["exact_sd"][row] = mean, sd
            if known > UNKNOWN[len(o.unknowns) > 1]:
                fate[row] = Fate.UNJUDGED
                continue
            error = max(abs(p.mean[j] - mean), abs(p.sd[j] - sd)) / sd
            claimed = max(p.mean_error[j], p.sd_error[j]) / p.sd[j]
            allowed = max(TIMES[method] * claimed, promised) + known
            well = Fate.WARNED if odd else Fate.RIGHT
            fate[row] = Fate.SILENT if error > allowed else well
            excess[row] = np.log(max(error, 1e-300) / allowed)
    return Judged(fate, excess, seen)


#: Inside the package's domain (`weberwhisk.domain`), readings within 8 sd of a contact's.
AXES = {
    "distance": Axis(domain.CONTACTS[0], 1.0, special=(0.5, 0.9, 0.95)),
    "push": Axis(0.0, 1.0, special=(0.5,)),
    "further": Axis(0.01, 0.99, special=(0.5,)),
    "k": Axis(*domain.WEBER_FRACTIONS, log=True, special=(0.1, 0.3)),
    "off_1": Axis(-4.0, 4.0, special=(0.0,)),
    "off_2": Axis(-4.0, 4.0, special=(0.0,)),
}


#: Readings that no contact explains.
ODD = AXES | {
    "k": Axis(0.03, domain.WEBER_FRACTIONS[1], log=True),
    "off_1": Axis(-30.0, 30.0, special=(0.0,)),
    "off_2": Axis(-30.0, 30.0, special=(0.0,)),
}


def searched(name: str, method: str, *, odd: bool = False) -> Domain:
    """The domain of an observer and an engine."""
    return Domain(
        f"{method}, {name}{', odd readings' * odd}",
        ODD if odd else AXES,
        lambda case: judge(case, name, method),
    )
