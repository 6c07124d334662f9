"""Used by `stability_posteriors.py`: a sum over three unknowns, distance, push and another.

The likelihoods are written anew here, with the third unknown integrated out at every contact. Of
two signals with Weber noise, in proportion to the stiffness, by a sum over ln stiffness in a window
about where the signals would be as read; with log-normal noise in closed form, as the logs are
Gaussian. Of two angles and the side between them, by a sum over the sides that are believed and
seen.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.special import expit, log_expit, logsumexp

import weberwhisk as ww
from weberwhisk import Observer, receptors

Array = np.ndarray
#: ln below the highest density at which a window ends; looks at it.
DEPTH, LOOKS = 60.0, 8
#: Sds to either side of which there is no mass.
FAR = 12.0


class Looks(NamedTuple):
    """Nodes along each axis, and of the third unknown, of each look and of the last."""

    coarse: tuple[int, int] = (80, 41)
    fine: tuple[int, int] = (360, 41)


def _log_density(o: Observer, reading: Array, w: Array, v: Array, inner: int) -> Array:
    """ln ∫ over the third unknown, in w = logit(r over the reach), v = logit(share of the second).

    What is second is the deflection angle or the bearing.
    """
    low, high = o.reach
    r = (low + expit(w) * (high - low))[:, None]
    if "side" in o.unknowns:
        first, last = o.cue.bearings
        total = _sides(o, reading, r, first + (last - first) * expit(v), inner)
    else:
        limit = np.nan_to_num(ww.flick_past(o.whisker, r).deflection_angle)
        pushed = ww.press(o.whisker, r, limit * expit(v))
        summed = _logs if isinstance(o.noise, receptors.LogNormal) else _stiffnesses
        with np.errstate(all="ignore"):
            total = summed(o, reading, np.stack([pushed.moment, pushed.axial_force]), inner)
        total = np.where(np.isfinite(total) & np.asarray(pushed.held), total, -np.inf)
        total = total + np.log(np.maximum(limit, 1e-300))
    return total + (log_expit(w) + log_expit(-w))[:, None] + log_expit(v) + log_expit(-v)


def _spread(o: Observer) -> float:
    """Sd of ln stiffness beforehand."""
    return float(np.log(o.prior["stiffness"].ppf(0.8413447460685429)))


def _stiffnesses(o: Observer, reading: Array, signals: Array, inner: int) -> Array:
    k, spread = float(np.ravel(o.noise.weber_fraction)[0]), _spread(o)
    centre = np.log(np.abs(reading[:, None, None] / signals)).mean(axis=0)
    # Narrow noise: all there is lies within twelve sds; wide noise: the prior ends it.
    half = FAR * k if k < 0.25 else np.inf
    begin = np.clip(centre - half, -7 * spread, 7 * spread)
    end = np.clip(centre + half, -7 * spread, 7 * spread)
    u = begin[..., None] + (np.arange(inner) + 0.5) / inner * (end - begin)[..., None]
    felt = signals[..., None] * np.exp(u)
    off = (reading[:, None, None, None] / felt - 1) / k
    log = -(0.5 * off**2 + np.log(np.abs(felt))).sum(axis=0) - 0.5 * (u / spread) ** 2
    best = log.max(axis=-1)
    return np.log(np.exp(log - best[..., None]).sum(axis=-1) * (end - begin) / inner) + best


def _logs(o: Observer, reading: Array, signals: Array, inner: int) -> Array:
    """Logs of readings over signals: Gaussian, with noise each of its own and one stiffness."""
    variance = np.log1p(float(np.ravel(o.noise.weber_fraction)[0]) ** 2)
    signs = np.all(reading[:, None, None] * signals > 0, axis=0)
    off = np.log(np.abs(reading[:, None, None] / signals)) + variance / 2
    log = -0.25 * (off[0] - off[1]) ** 2 / variance
    log -= 0.25 * (off[0] + off[1]) ** 2 / (variance + 2 * _spread(o) ** 2)
    return np.where(signs, log, -np.inf)


def _sides(o: Observer, reading: Array, r: Array, bearing: Array, inner: int) -> Array:
    """Two angles, each read with one sd: the second is the bearing, the first goes by the side."""
    sd, (middle, spread) = float(np.ravel(o.noise.floor)[0]), (o.cue.side, o.cue.side_sd)
    across, ahead = r * np.sin(bearing), r * np.cos(bearing)
    # The larger the side, the smaller the angle that is seen.
    seen = np.clip(reading[0] + FAR * sd * np.array([1, -1]), 1e-9, np.pi - 1e-9)
    begin, end = (across / np.tan(angle) - ahead for angle in seen)
    begin = np.maximum(begin, middle - 9 * spread)
    end = np.minimum(end, middle + 9 * spread)
    width = np.maximum(end - begin, 0.0)
    side = begin[..., None] + (np.arange(inner) + 0.5) / inner * width[..., None]
    along = side + ahead[..., None]
    angle = np.arctan2(across[..., None], along)
    log = -0.5 * ((reading[0] - angle) / sd) ** 2 - 0.5 * ((side - middle) / spread) ** 2
    log = np.where(np.hypot(along, across[..., None]) <= o.whisker.length, log, -np.inf)
    with np.errstate(divide="ignore"):
        total = logsumexp(log, axis=-1) + np.log(width / inner)
    return total - 0.5 * ((reading[1] - bearing) / sd) ** 2


def brute(o: Observer, reading: Array, near: float) -> tuple[float, float, float]:
    """Mean and sd of the distance, and how well they are known (in sds)."""
    windows = [(-14.0, 14.0), (-34.0, 16.0)]  # down to pushes of 1e-14 of the last
    looks = Looks()
    for look in range(LOOKS):
        last = look == LOOKS - 1
        n, inner = looks.fine if last else looks.coarse
        w, v = (a + (np.arange(n) + 0.5) / n * (b - a) for a, b in windows)
        if look == 0:
            w = np.unique([*w, *(near + np.linspace(-0.3, 0.3, 9))])
        log = _log_density(o, reading, w, v, inner)
        if last:
            break
        held = log > log.max() - DEPTH
        for i, axis in enumerate((w, v)):
            where = np.flatnonzero(held.any(axis=1 - i))
            step = (windows[i][1] - windows[i][0]) / n
            windows[i] = (axis[where[0]] - 1.5 * step, axis[where[-1]] + 1.5 * step)
    weight = np.exp(log - log.max())
    low, high = o.reach
    r = low + expit(w) * (high - low)
    found = []
    for part in (slice(None), slice(None, None, 2), slice(1, None, 2)):
        p = weight[part, part].sum(axis=1)
        x, p = r[part], p / p.sum()
        mean = p @ x
        found.append((mean, np.sqrt(p @ (x - mean) ** 2)))
    (mean, sd), *halves = found
    off = max(max(abs(m - mean), abs(s - sd)) for m, s in halves) / sd
    return float(mean), float(sd), float(off**1.5)
