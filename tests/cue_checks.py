"""What every cue is held to, by means that share no code with the engines."""

from __future__ import annotations

import numpy as np

import weberwhisk as ww


def jacobian_by_differences(cue, whisker, contact, step=1e-5):
    """Central differences of the signals, (..., S, U); steps are relative."""
    columns = []
    for axis in range(contact.shape[-1]):
        h = np.zeros_like(contact)
        h[..., axis] = step * np.abs(contact[..., axis])
        up, down = (cue.signals(whisker, contact + s * h)[0] for s in (1, -1))
        columns.append((up - down) / (2 * h[..., axis, None]))
    return np.stack(columns, axis=-1)


def moments_by_midpoints(observer, reading, points=200_001):
    """Mean and sd of the radial distance by the midpoint rule, flat prior, one unknown."""
    low, high = observer.reach
    r = low + (np.arange(points) + 0.5) / points * (high - low)
    log = observer.log_likelihood(reading, r[:, None])
    weight = np.exp(log - log.max())
    mean = weight @ r / weight.sum()
    return mean, np.sqrt(weight @ (r - mean) ** 2 / weight.sum())


def coverage(observer, contact, seed):
    """Share of 95 % intervals that hold the radial distance, of readings of these contacts."""
    readings, back = np.unique(observer.read(contact, seed=seed), axis=0, return_inverse=True)
    interval = ww.posterior(observer, readings).interval(0.95)[back.reshape(-1)]
    low, high = np.moveaxis(interval, -1, 0)
    return np.mean((low <= contact[:, 0]) & (contact[:, 0] <= high))
