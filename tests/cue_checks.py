"""What every cue is held to, whatever it feels: used by the tests of single cues."""

from __future__ import annotations

import numpy as np

import weberwhisk as ww
from weberwhisk import Outcome
from weberwhisk.sensitivity import weber_propagation

#: Chance of fewer misses than this many sd of a binomial: one in 16 000.
SDS = 4.0


def jacobian_by_differences(cue, whisker, contact, step=1e-5, least=0.0):
    """Central differences of the signals, (..., S, U); steps are of the contact or of `least`."""
    columns = []
    for axis in range(contact.shape[-1]):
        h = np.zeros_like(contact)
        h[..., axis] = step * np.maximum(np.abs(contact[..., axis]), least)
        up, down = (cue.signals(whisker, contact + s * h)[0] for s in (1, -1))
        columns.append((up - down) / (2 * h[..., axis, None]))
    return np.stack(columns, axis=-1)


def moments_by_midpoints(observer, reading, points=200_001):
    """Mean and sd of the radial distance by the midpoint rule, one unknown."""
    low, high = observer.reach
    r = low + (np.arange(points) + 0.5) / points * (high - low)
    log = observer.log_likelihood(reading, r[:, None])
    if "radial_distance" in observer.prior:
        log = log + observer.prior["radial_distance"].logpdf(r)
    return weighted_moments(r, log)


def weighted_moments(r, log):
    """Mean and sd of places r with ln of their weights."""
    weight = np.exp(log - log.max())
    mean = weight @ r / weight.sum()
    return mean, np.sqrt(weight @ (r - mean) ** 2 / weight.sum())


def coverage(observer, contact, seed):
    """Share of 95 % intervals that hold the radial distance, of readings of these contacts."""
    readings, back = np.unique(observer.read(contact, seed=seed), axis=0, return_inverse=True)
    interval = ww.posterior(observer, readings).interval(0.95)[back.reshape(-1)]
    low, high = np.moveaxis(interval, -1, 0)
    return np.mean((low <= contact[:, 0]) & (contact[:, 0] <= high))


def prior_draws(observer, n, seed):
    """Contacts (n, U) from the prior: flat where none is given, over what the whisker holds."""
    rng = np.random.default_rng(seed)
    low, high = observer.reach
    kept = np.empty((0, len(observer.unknowns)))
    while len(kept) < n:
        columns = []
        for i, name in enumerate(observer.unknowns):
            if name in observer.prior:
                columns.append(observer.prior[name].rvs(4 * n, random_state=rng))
            elif i == 0:
                columns.append(rng.uniform(low, high, 4 * n))
            else:
                columns.append(rng.uniform(0, 2, 4 * n))  # no whisker holds an angle above 2 rad
        contact = np.stack(columns, axis=-1)
        inside = (contact[:, 0] > low) & (contact[:, 0] < high)
        inside &= np.all(contact[:, : observer.bounded] > 0, axis=1)
        kept = np.concatenate([kept, contact[inside & (observer.signals(contact)[1] == 0)]])
    return kept[:n]


def keeps_the_protocol(observer, contact):
    """Shapes, outcomes, and a Jacobian that is the slope of the signals."""
    cue, whisker = observer.cue, observer.whisker
    assert isinstance(cue, ww.cues.Cue)
    assert cue.unknowns[0] == "radial_distance"
    signals, outcome = cue.signals(whisker, contact)
    assert signals.shape == (*contact.shape[:-1], len(cue.signal_names))
    assert np.all(outcome == Outcome.HELD)
    jacobian = cue.jacobian(whisker, contact)
    assert jacobian.shape == (*signals.shape, len(cue.unknowns))
    slopes = jacobian_by_differences(cue, whisker, contact, least=1e-3)
    size = np.abs(slopes).max(axis=0)
    assert np.allclose(jacobian, slopes, rtol=2e-5, atol=1e-7 * size)


def brute_force(observer, reading, points=400_000):
    """Mean and sd of r by the midpoint rule in the contact itself, of one to three unknowns.

    Nothing is shared with the engines but the likelihood: no coordinates, no panels, no grids.
    """
    if len(observer.unknowns) == 1:
        return moments_by_midpoints(observer, reading, points)
    # First a coarse look at where the mass is, then a fine one there.
    dim = len(observer.unknowns)
    box = [observer.reach, *(_range(observer, name) for name in observer.unknowns[1:])]
    # In the end some 18 sds: by steps of 0.014 a density cut short was off by 1e-4.
    coarse, fine = (300, 3 * int(np.sqrt(points))) if dim == 2 else (64, 128)
    for n in (coarse, coarse, fine):
        axes = [a + (np.arange(n) + 0.5) / n * (b - a) for a, b in box]
        table = np.empty((n,) * dim)
        slab = max(1, 16_000 // n ** (dim - 1))  # three dimensions are many
        for i in range(0, n, slab):
            some = np.meshgrid(axes[0][i : i + slab], *axes[1:], indexing="ij")
            table[i : i + slab] = observer.log_likelihood(reading, np.stack(some, axis=-1))
        for k, name in enumerate(observer.unknowns):
            if name in observer.prior:
                shape = [-1 if j == k else 1 for j in range(dim)]
                table += observer.prior[name].logpdf(axes[k]).reshape(shape)
        near = table > table.max() - 40
        box = [
            (
                max(axis[kept].min() - 2 * (axis[1] - axis[0]), edge[0]),
                min(axis[kept].max() + 2 * (axis[1] - axis[0]), edge[1]),
            )
            for k, (axis, edge) in enumerate(zip(axes, box, strict=True))
            for kept in [near.any(axis=tuple(j for j in range(dim) if j != k))]
        ]
    log = np.log(np.exp(table - table.max()).reshape(n, -1).sum(axis=1) + 1e-300)
    return weighted_moments(axes[0], log)


def _range(observer, name):
    if name in observer.prior:
        return observer.prior[name].ppf([1e-13, 1 - 1e-13])
    return 0.0, 2.0


def agrees_with_brute_force(observer, readings, accuracy=1e-4, **options):
    """Quadrature's mean and sd beside the midpoint rule's, in units of the sd."""
    p = ww.posterior(observer, readings, tolerance=accuracy, **options)
    for i, reading in enumerate(readings):
        mean, sd = brute_force(observer, reading)
        assert abs(p.mean[i] - mean) < accuracy * sd
        assert abs(p.sd[i] / sd - 1) < accuracy


def small_noise_limit(observer, contact, draws=200, seed=1, bias=0.0):
    """Posterior sd beside Weber propagation, within Monte Carlo error and an allowed bias."""
    readings = observer.read(np.repeat(contact, draws, axis=0), seed)
    p = ww.posterior(observer, readings)
    sd = np.reshape(p.sd, (-1, draws))
    error = sd.std(axis=1, ddof=1) / np.sqrt(draws)
    expected = weber_propagation(observer, contact)
    assert np.all(np.abs(sd.mean(axis=1) - expected) < 4 * error + bias * expected)
