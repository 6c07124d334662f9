"""An audit of posteriors of random observers, by relations that hold whatever the reading."""

from __future__ import annotations

from typing import Any

import numpy as np

import weberwhisk as ww
from weberwhisk.cues import Compliance, ForceMap, Friction, Fused, Vibration
from weberwhisk.inference import default_noise, tree
from weberwhisk.inference.quadrature import TOLERANCE, sums_of
from weberwhisk.jnd import prior_draws

#: Fine enough for every contact that has a share in the posterior.
NATS = 15.0
#: Another step of the first cells, with which every later cell is elsewhere.
OTHER_STEP = 0.43


def random_observer(rng: np.random.Generator) -> ww.Observer:
    """An observer of two unknowns from the whole domain of whiskers, cues and noise."""
    while True:
        ratio = 1.0 if rng.random() < 0.15 else float(np.exp(rng.uniform(*np.log([5, 40]))))
        bow = 0.0 if rng.random() < 0.3 else float(rng.uniform(-25, 25))
        whisker = ww.Whisker(50e-3, 100e-6, 100e-6 / ratio, curvature=bow)
        cue: Any = ForceMap()
        if rng.random() < 0.4:
            cue = Friction(cue, float(rng.uniform(-0.45, 0.45)))
        elif bow == 0 and rng.random() < 0.4:
            cue = Fused(cue, [Vibration(2), Compliance()][rng.integers(2)])
        k = float(np.exp(rng.uniform(*np.log([0.03, 0.3]))))
        try:
            observer = ww.Observer(whisker, cue, default_noise(whisker, cue, k))
            observer.read(prior_draws(observer, 2, seed=0), seed=0)
        except ValueError:  # a combination that observers do not take
            continue
        return observer


def readings_of(observer: ww.Observer, count: int, rng: np.random.Generator) -> tuple[Any, Any]:
    """Contacts drawn from the prior, and a reading of each."""
    contact = prior_draws(observer, count, seed=rng)
    signals, outcome = observer.signals(contact)
    held = outcome == ww.Outcome.HELD
    return contact[held], observer.noise.sample(signals[held], rng)


def lost(observer: ww.Observer, contact: Any, reading: Any) -> Any:
    """Readings (n,) whose cells leave out the contact that they came from, though it has a share.

    Of observers of one or two unknowns.
    """
    x = observer.coordinates(contact)
    density = np.array([observer.log_density(a, y) for a, y in zip(x, reading, strict=True)])
    found = sums_of(observer, reading)
    out = []
    for i in range(len(reading)):
        leaves = next(found._current(np.arange(len(reading)) == i))
        place = leaves.level.data[found._places.place][:, leaves.cell].T
        inside = (place == np.floor(x[i] / leaves.level.step)).all(axis=1).any()
        if density[i] > leaves.log.max() - NATS and not inside:
            out.append(i)
    return np.array(out, dtype=int)


def shifted(observer: ww.Observer, reading: Any, tolerance: float = TOLERANCE) -> tuple[Any, Any]:
    """How far means and sds are from those of other cells, in sds (n, U), and the errors claimed.

    NaN where either says that it is imprecise.
    """
    usual, step = sums_of(observer, reading, tolerance=tolerance), tree.ROOT_STEP
    tree._kept.clear()
    try:
        tree.ROOT_STEP = OTHER_STEP
        other = sums_of(observer, reading, tolerance=tolerance)
    finally:
        tree.ROOT_STEP = step
        tree._kept.clear()
    claimed = np.maximum(usual.error, other.error)
    off = np.maximum(np.abs(usual.mean - other.mean), np.abs(usual.sd - other.sd)) / usual.sd
    off[claimed > tolerance] = np.nan
    return off, claimed


def evidence_ratio(observer: ww.Observer, reading: Any, draws: int, seed: int) -> tuple[Any, Any]:
    """ln of evidence over mean likelihood of draws of the prior (n,), and its Monte Carlo error.

    The same for all readings: ln of the size of the domain, whose flat prior counts as 1.
    """
    drawn = prior_draws(observer, draws, seed=seed)
    signals, outcome = observer.signals(drawn)
    signals = signals[outcome == ww.Outcome.HELD]
    evidence, out, error = sums_of(observer, reading).log_evidence, [], []
    for y, log in zip(reading, evidence, strict=True):
        likelihood = np.exp(observer.noise.log_likelihood(y, signals) - log)
        out.append(-np.log(likelihood.mean()))
        error.append(likelihood.std() / likelihood.mean() / np.sqrt(len(likelihood)))
    return np.array(out), np.array(error)
