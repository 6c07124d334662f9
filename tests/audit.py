"""An audit of posteriors of random observers, by relations that hold whatever the reading."""

from __future__ import annotations

from typing import Any

import numpy as np

import weberwhisk as ww
from weberwhisk.cues import (
    Compliance,
    ForceMap,
    Friction,
    Fused,
    SpaceMap,
    UnknownCurvature,
    UnknownHinge,
    UnknownRoll,
    UnknownStiffness,
    Vibration,
)
from weberwhisk.inference import default_noise, tree
from weberwhisk.inference.quadrature import sums_of
from weberwhisk.inference.tree import TOLERANCE
from weberwhisk.sensitivity import prior_draws

#: Contacts so many nats below the highest density must have a cell.
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


#: Observers of unknowns that have priors alone, by name.
LAYERED = {
    "stiffness": (0.0, UnknownStiffness(ForceMap(), 0.3)),
    "curvature": (8.0, UnknownCurvature(ForceMap(), 2.0)),
    "friction": (8.0, Friction(ForceMap())),
    "hinge": (0.0, UnknownHinge(ForceMap(), 0.3)),
    "tap": (8.0, UnknownCurvature(Compliance(tap_angle=0.1), 2.0)),
    "space": (0.0, SpaceMap()),
    "curved space": (8.0, SpaceMap()),
    "roll": (8.0, UnknownRoll(SpaceMap(), 0.3)),
}


def layered_observer(name: str, k: float) -> ww.Observer:
    """One of `LAYERED`, its Weber fraction k."""
    bow, cue = LAYERED[name]
    hinge = 2e-5 if name == "hinge" else None
    whisker = ww.Whisker(50e-3, 100e-6, 5e-6, curvature=bow, hinge_stiffness=hinge)
    return ww.Observer(whisker, cue, default_noise(whisker, cue, k))


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
    x = observer.space.unconstrain(contact)
    density = np.array([observer.log_density(a, y) for a, y in zip(x, reading, strict=True)])
    found = sums_of(observer, reading)
    out = []
    for i in range(len(reading)):
        leaves = next(found.lattices(np.arange(len(reading)) == i))
        inside = (np.floor(x[i] / leaves.step[:, 0]) == leaves.place.T).all(axis=1).any()
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


def importance(observer: ww.Observer, reading: Any, draws: int, seed: int) -> dict[str, Any]:
    """Posteriors beside draws of the prior, weighed by their likelihood, of readings (n, R).

    Returns ln of evidence over the mean likelihood "log_ratio" (n,), the same for all readings: ln
    of the size of the domain, whose flat priors count as 1; its Monte Carlo error "error" (n,); and
    how far means are from those of the draws, in Monte Carlo errors, "mean_off" (n, U). An azimuth
    is counted in whole turns to be near its mean.
    """
    drawn = prior_draws(observer, draws, seed=seed)
    signals, outcome = observer.signals(drawn)
    held = outcome == ww.Outcome.HELD
    drawn, signals = drawn[held], signals[held]
    found, circular = sums_of(observer, reading), np.flatnonzero(observer.cue.circular)
    ratio, error, off = [], [], []
    for y, log, middle, sd in zip(reading, found.log_evidence, found.mean, found.sd, strict=True):
        near, value = np.tile(y, (len(signals), 1)), drawn - middle
        if circular.size:
            at = observer.unknowns.index("azimuth")
            value[:, at] -= 2 * np.pi * np.round(value[:, at] / (2 * np.pi))
            apart = near[:, circular] - signals[:, circular]
            near[:, circular] -= 2 * np.pi * np.round(apart / (2 * np.pi))
        weight = np.exp(observer.noise.log_likelihood(near, signals) - log)
        ratio.append(-np.log(weight.mean()))
        error.append(weight.std() / weight.mean() / np.sqrt(len(weight)))
        share = weight / weight.sum()
        mean = share @ value
        scatter = np.sqrt(share**2 @ (value - mean) ** 2)
        off.append(np.abs(mean) / np.maximum(scatter, 1e-9 * sd))
    return {"log_ratio": np.array(ratio), "error": np.array(error), "mean_off": np.array(off)}
