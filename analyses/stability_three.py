"""Used by `stability_posteriors.py`: a sum over three unknowns, distance, push and stiffness.

The likelihood is written anew here: two signals with Weber noise, in proportion to the stiffness.
The sum over ln stiffness has a window of its own at every contact, about where the signals would be
as read.
"""

from __future__ import annotations

import numpy as np
from scipy.special import expit, log_expit

import weberwhisk as ww
from weberwhisk import Observer

Array = np.ndarray
#: ln below the highest density at which a window ends; looks at it; nodes of each look.
DEPTH, LOOKS, COARSE, FINE = 60.0, 8, (80, 41), (360, 41)


def _log_density(o: Observer, reading: Array, w: Array, v: Array, inner: int) -> Array:
    """ln ∫ d ln c of the posterior in w = logit(r over the reach), v = logit(share of the push)."""
    low, high = o.reach
    r = low + expit(w) * (high - low)
    limit = np.nan_to_num(ww.flick_past(o.whisker, r).deflection_angle)
    pushed = ww.press(o.whisker, r[:, None], limit[:, None] * expit(v))
    signals = np.stack([pushed.moment, pushed.axial_force])
    k = float(np.ravel(o.noise.weber_fraction)[0])
    spread = float(np.log(o.prior["stiffness"].ppf(0.8413447460685429)))
    with np.errstate(all="ignore"):
        ratio = np.abs(reading[:, None, None] / signals)
        centre = np.log(ratio).mean(axis=0)
        # Narrow noise: all there is lies within twelve sds; wide noise: the prior ends it.
        half = 12 * k if k < 0.25 else np.inf
        begin = np.clip(centre - half, -7 * spread, 7 * spread)
        end = np.clip(centre + half, -7 * spread, 7 * spread)
        u = begin[..., None] + (np.arange(inner) + 0.5) / inner * (end - begin)[..., None]
        felt = signals[..., None] * np.exp(u)
        off = (reading[:, None, None, None] / felt - 1) / k
        log = -(0.5 * off**2 + np.log(np.abs(felt))).sum(axis=0) - 0.5 * (u / spread) ** 2
        best = log.max(axis=-1)
        total = np.log(np.exp(log - best[..., None]).sum(axis=-1) * (end - begin) / inner) + best
    total += (log_expit(w) + log_expit(-w) + np.log(np.maximum(limit, 1e-300)))[:, None]
    total += log_expit(v) + log_expit(-v)
    return np.where(np.isfinite(total) & np.asarray(pushed.held), total, -np.inf)


def brute(o: Observer, reading: Array, near: float) -> tuple[float, float, float]:
    """Mean and sd of the distance, and how well they are known (in sds)."""
    windows = [(-14.0, 14.0), (-34.0, 16.0)]  # down to pushes of 1e-14 of the last
    for look in range(LOOKS):
        last = look == LOOKS - 1
        n, inner = FINE if last else COARSE
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
