"""Observers of any whisker: part of `stability.py`, beside brute force.

A case is a whisker, its cue, a contact and how far the readings lie off their means. Not only mean
and sd must be right, but the evidence and the ends of the interval, in which a lost mode shows
first.

Fusions are of two cues with noise of their own. Forces tell of distance and angle, and what is
fused with them of distance alone or of distance and a bearing: given the distance the two are
independent, so that a sum over the distances and, at each, over angles and over bearings is the
whole posterior.

Real whiskers are curved to either side and rub, both known: the last of the sums is over contacts
of the planar beam itself, solved one by one. Where the curvature, a hinge or the friction is
uncertain, such posteriors are mixed at even steps of its normal score, by their evidence. In space
the sum is a plain grid that closes in.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache, partial
from types import SimpleNamespace
from typing import Any

import numpy as np
from fault_search import Axis, Domain, Fate, Judged
from scipy.special import expit, log_expit, logit, ndtr
from stability_posteriors import Sums, distance_sums

import weberwhisk as ww
from weberwhisk import Observer, Status, Whisker, cues, domain, receptors
from weberwhisk.cues.force_map import SIGNALS
from weberwhisk.inference import Posterior, default_noise

Array = np.ndarray
Case = dict[str, Array]
#: Base over tip radius; 0 stands for a cone.
RATIOS = (1.0, 1.5, 3.0, 20.0, 0.0)
PAIRS = ("forces and vibration", "forces and a tap", "forces and bearings")
FLOOR = 0.05
#: How far off, in sds, what converged may be without saying so; the evidence in ln.
ADMITTED = 1e-2
REAL_RATIOS = (1.0, 5.0, 20.0, 40.0, 0.0)
SENSED = ("M, Fx", "M, Fy", "M, Fx, Fy", "a tap")
#: Weber fractions of observers that are made once, as their tables take long.
FRACTIONS = (0.03, 0.1, 0.3)


def _one(of: dict[str, float], name: str, values: tuple) -> Any:
    """The value that a case's axis stands for."""
    return values[min(int(of[name]), len(values) - 1)]


def fusion(
    length: float, radius: float, ratio: float, pair: str, k: float, other: float
) -> Observer:
    """The observer of a pair of cues, k being the Weber fraction of the forces."""
    whisker = Whisker(length, radius, radius / ratio if ratio else 0.0)
    if pair == PAIRS[0]:
        second = cues.Vibration(3)
        noise = second.noise(other, FLOOR)
    elif pair == PAIRS[1]:
        second, noise = cues.Compliance(), receptors.Weber(other)
    else:
        second = cues.AngleSideAngle(min(10e-3, 0.4 * length))
        noise = receptors.GeneralisedWeber(0.0, floor=other)
    fused = cues.Fused(cues.ForceMap(), second)
    return Observer(whisker, fused, fused.joint(receptors.Weber(k), noise))


def bearings_told(o: Observer, reading: Array, r: Array, count: int = 1600) -> Array:
    """ln ∫ p(two angles | r, bearing) p(bearing) d bearing at distances (n,)."""
    cue = o.cue.cues[1]
    sd = float(o.noise.floors(4)[-1])
    low, high = cue.bearings
    begin, end = np.clip(reading[3] + 9 * sd * np.array([-1, 1]), low, high)
    bearing = begin + (np.arange(count) + 0.5) / count * (end - begin)
    at = np.maximum(r, 1e-12)[:, None]
    first = np.arctan2(at * np.sin(bearing), cue.side + at * np.cos(bearing))
    off = ((reading[2] - first) ** 2 + (reading[3] - bearing) ** 2) / (2 * sd**2)
    told = np.logaddexp.reduce(-off, axis=1) - 2 * np.log(sd * np.sqrt(2 * np.pi))
    return told + np.log((end - begin) / count / (high - low))


def fused(of: dict[str, float]) -> Observer:
    """A case's fusion."""
    radius, ratio, pair = of["slender"] * of["length"], _one(of, "ratio", RATIOS), PAIRS
    return fusion(of["length"], radius, ratio, _one(of, "pair", pair), of["k"], of["other"])


def real(of: dict[str, float]) -> Observer:
    """A case's curved whisker that rubs."""
    radius, ratio = of["slender"] * of["length"], _one(of, "ratio", REAL_RATIOS)
    tip = radius / ratio if ratio else 0.0
    whisker = Whisker(of["length"], radius, tip, curvature=of["curvature"])
    sensed = _one(of, "sensed", SENSED)
    signals = {"M, Fx": SIGNALS[:2], "M, Fy": SIGNALS[::2], "M, Fx, Fy": SIGNALS}
    cue = cues.ForceMap(signals[sensed]) if sensed in signals else cues.Compliance(tap_angle=0.1)
    rubbing = cues.Friction(cue, np.radians(of["friction"]))
    return Observer(whisker, rubbing, default_noise(whisker, rubbing, of["k"]))


def _of_space(whisker: Whisker, k: float) -> receptors.ReceptorNoise:
    """The default noise of `SpaceMap`, with k for Weber's and k rad for directions."""
    forces = default_noise(whisker, cues.SpaceMap(SIGNALS), k)
    return receptors.Joint([forces, receptors.GeneralisedWeber(0.0, floor=k)], sizes=[3, 2])


@lru_cache(maxsize=16)
def _kept(kind: str, curvature: float, k: float) -> Observer:
    whisker = Whisker(50e-3, 100e-6, 5e-6, 3e9, curvature)
    cue = cues.ForceMap()
    if kind == "hinge":
        whisker = replace(whisker, hinge_stiffness=3 * whisker.stiffness / 10e-3)
    wrapped = {
        "hinge": lambda: cues.UnknownHinge(cue, 0.3),
        "curvature": lambda: cues.UnknownCurvature(cue, 2.0),
        "friction": lambda: cues.Friction(cue),
    }
    if kind in wrapped:
        made = wrapped[kind]()
        return Observer(whisker, made, default_noise(whisker, made, k))
    return Observer(whisker, cues.SpaceMap(), _of_space(whisker, k))


def uncertain(of: dict[str, float]) -> Observer:
    """A case whose curvature or hinge is uncertain."""
    kind = _one(of, "kind", ("curvature", "hinge"))
    return _kept(kind, _one(of, "curved", (-12.0, 8.0)), _one(of, "fraction", FRACTIONS))


def in_space(of: dict[str, float]) -> Observer:
    """A case in space."""
    return _kept("space", _one(of, "curved", (20.0, 8.0)), _one(of, "fraction", FRACTIONS))


def rubbing(of: dict[str, float]) -> Observer:
    """A case whose friction is unknown."""
    return _kept("friction", _one(of, "curved", (0.0, 8.0)), _one(of, "fraction", FRACTIONS))


def settled(*asked: Any, **how: Any) -> Sums:
    """`distance_sums` with as many nodes a row as a force that turns its sign takes."""
    for fine in (96, 384, 1536):
        found = distance_sums(*asked, fine=fine, **how)
        if found.known <= ADMITTED:
            break
    return found


def planar_sums(o: Observer, reading: Array, near: float) -> Sums:
    """Of a real whisker, by the planar beam."""
    return settled(o, reading, near, exact=replace(o, model="profile"))


def _at(o: Observer, value: float) -> Any:
    """The observer with its last unknown known."""
    if "friction_angle" not in o.unknowns:
        name = "hinge_stiffness" if "hinge_stiffness" in o.unknowns else "curvature"
        value += o.whisker.curvature if name == "curvature" else 0.0
        return Observer(replace(o.whisker, **{name: value}), o.cue.cue, o.noise)

    def known(contact: Array) -> Array:
        return np.concatenate([contact, np.full((*contact.shape[:-1], 1), value)], axis=-1)

    # By the table of all frictions: one for each of so many takes long.
    return SimpleNamespace(
        unknowns=o.unknowns[:-1],
        bounded=o.bounded,
        reach=o.reach,
        forward=o.forward,
        cue=o.cue,
        space=SimpleNamespace(
            angle_range=lambda r: o.space.angle_range(r, known(np.stack([r, r], axis=-1)))
        ),
        log_likelihood=lambda reading, contact: o.log_likelihood(reading, known(contact)),
    )


def mixed_sums(o: Observer, reading: Array, near: float) -> Sums:
    """Of an uncertain last unknown: at even steps of its score, and how far off half of them are.

    Evidence bends with friction where a force turns its sign. Of four readings steps of 0.6, 0.3
    and 0.15 were up to 0.6, 0.12 and 3e-3 sd off: less than the difference to half of them to 1.5.
    """
    step, power = (0.1, 1.5) if "friction_angle" in o.unknowns else (0.6, 2.0)
    n = round(4.2 / step)
    z = np.arange(-n, n + 1) * step
    known = [_at(o, v) for v in o.prior[o.unknowns[-1]].ppf(ndtr(z))]
    each = [distance_sums(one, reading, near) for one in known]
    evidence = np.array([e.log_evidence for e in each]) - 0.5 * z**2
    for i in np.flatnonzero(evidence > evidence.max() - 12):
        each[i] = settled(known[i], reading, near)
        evidence[i] = each[i].log_evidence - 0.5 * z[i] ** 2
    found = []
    for every in (1, 2):
        log = evidence[n % every :: every]
        share = np.exp(log - log.max())
        total = np.log(share.sum() * step * every / np.sqrt(2 * np.pi)) + log.max()
        share /= share.sum()
        m, s = np.array([e[:2] for e in each[n % every :: every]]).T
        mean = share @ m
        found.append((mean, np.sqrt(share @ (s**2 + (m - mean) ** 2)), total))
    (mean, sd, total), half = found
    weight = np.exp(evidence - evidence.max())
    unsure = float(weight @ [e.known for e in each] / weight.sum())
    off = max(abs(mean - half[0]) / sd, abs(sd - half[1]) / sd, abs(total - half[2]))
    return Sums(mean, sd, unsure + off**power, total, np.full(2, np.nan), np.zeros(2))


def space_sums(o: Observer, reading: Array, near: float, looks: int = 6) -> Sums:
    """Of a map in space: a plain grid of distance, deflection and azimuth that closes in."""
    low, high = o.reach
    windows = [(-7.0, 9.0), (-24.0, 4.0), (-np.pi, np.pi)]  # pushes of 1e-9 of the most, too
    for look in range(looks):
        n = {0: 72, looks - 1: 96}.get(look, 48)
        w, v, azimuth = (a + (np.arange(n) + 0.5) / n * (b - a) for a, b in windows)
        if look == 0:
            w = np.union1d(w, near + np.linspace(-0.3, 0.3, 5))
        r = low + expit(w) * (high - low)
        place = np.stack(np.meshgrid(r, np.pi * expit(v), azimuth, indexing="ij"), axis=-1)
        log = o.log_likelihood(reading, place)  # directions are read on a circle
        slope = (log_expit(w) + log_expit(-w))[:, None] + log_expit(v) + log_expit(-v)
        log = log + slope[..., None]
        if look == looks - 1:
            break
        held = log > log.max() - 60.0 * 0.8**look
        for i, axis in enumerate((w, v, azimuth)):
            some = np.flatnonzero(held.any(axis=tuple({0, 1, 2} - {i})))
            step = (windows[i][1] - windows[i][0]) / n
            windows[i] = axis[some[0]] - 1.5 * step, axis[some[-1]] + 1.5 * step
        first, last = windows[2]
        windows[2] = (-np.pi, np.pi) if last - first > 2 * np.pi else (first, last)
    weight, found = np.exp(log - log.max()), []
    for part in (slice(None), slice(None, None, 2), slice(1, None, 2)):
        p = weight[part, part, part].sum(axis=(1, 2))
        p, x = p / p.sum(), r[part]
        found.append((p @ x, np.sqrt(p @ (x - p @ x) ** 2)))
    (mean, sd), *halves = found
    off = max(max(abs(m - mean), abs(s - sd)) for m, s in halves) / sd
    cut = weight[:, [0, -1]].sum() / weight.sum()  # at the ends of the window of angles
    return Sums(mean, sd, off**1.5 + cut, np.nan, np.full(2, np.nan), np.zeros(2))


def sums(o: Observer, reading: Array, near: float) -> Sums:
    """The posterior of distance of a fusion."""
    if "bearing" not in o.unknowns:
        return distance_sums(o, reading, near)
    forces = Observer(o.whisker, o.cue.cues[0], o.noise.part(4, 0, 2))
    return distance_sums(
        forces, reading[:2], near, lambda r: bearings_told(o, reading, r), reach=o.reach
    )


def off_by(p: Posterior, exact: Sums) -> tuple[float, float]:
    """How far off a posterior is and how far it may be, where that is worst."""
    error = np.array(
        [
            abs(p.mean - exact.mean) / exact.sd,
            abs(p.sd - exact.sd) / exact.sd,
            *(
                np.abs(p.interval() - exact.interval) / exact.sd
                if exact.ends_known.any()
                else (0, 0)
            ),
            np.nan_to_num(abs(p.log_evidence - exact.log_evidence)),
        ]
    )
    claimed = [p.mean_error, p.sd_error, *p.quantile_error([0.025, 0.975]), p.sd_error]
    allowed = np.maximum(3 * np.array(claimed) / p.sd, ADMITTED) + exact.known
    allowed[2:4] += 2 * exact.ends_known.max()
    worst = int(np.argmax(error / allowed))
    return float(error[worst]), float(allowed[worst])


def judge(
    case: Case,
    make: Callable[[dict[str, float]], Observer] = fused,
    sums: Callable[[Observer, Array, float], Sums] = sums,
) -> Judged:
    """Each case's posterior beside brute force."""
    n = case["distance"].size
    fate, excess = np.full(n, Fate.REFUSED), np.full(n, -np.inf)
    seen = {
        key: np.full(n, np.nan) for key in ("error", "exact_mean", "exact_sd", "weber_fraction")
    }
    for i in range(n):
        of = {key: float(values[i]) for key, values in case.items()}
        seen["weber_fraction"][i] = of["k"] if "k" in of else _one(of, "fraction", FRACTIONS)
        try:
            o = make(of)
            low, high = o.reach
            r = low + np.clip(of["distance"], 1e-6, 1 - 1e-9) * (high - low)
            start, width = o.space.angle_range(np.array([r]))
        except ValueError as refused:
            if "No table serves" in str(refused):  # of strongly curved cones and cylinders
                continue
            raise
        contact = [r, start + np.clip(of["push"], 1e-9, 1 - 1e-9) * width[0]][: o.bounded]
        for name in o.unknowns[o.bounded :]:
            contact.append(o.prior[name].ppf(np.clip(of["further"], 0.01, 0.99)))
        signals, outcome = o.signals(np.array(contact))
        if outcome != 0:
            continue
        z = np.resize([of[f"off_{j}"] for j in range(1, 5)], signals.size)
        # Readings of the vibration are correlated: off along the roots of their covariance.
        reading = o.noise.mean(signals) + np.linalg.cholesky(o.noise.covariance(signals)) @ z
        p = ww.posterior(o, reading)
        if p.status != Status.CONVERGED:
            fate[i] = Fate.WARNED
            continue
        exact = sums(o, reading, float(logit((r - low) / (high - low))))
        seen["exact_mean"][i], seen["exact_sd"][i] = exact.mean, exact.sd
        if exact.known > ADMITTED:
            fate[i] = Fate.UNJUDGED
            continue
        error, allowed = off_by(p, exact)
        seen["error"][i] = error
        fate[i] = Fate.SILENT if error > allowed else Fate.RIGHT
        excess[i] = np.log(max(error, 1e-300) / allowed)
    return Judged(fate, excess, seen)


CONTACT = {
    "distance": Axis(domain.CONTACTS[0], 1.0, special=(0.5, 0.9)),
    "push": Axis(0.0, 1.0, special=(0.5,)),
    "further": Axis(0.01, 0.99, special=(0.5,)),
} | {f"off_{i}": Axis(-2.5, 2.5, special=(0.0,)) for i in range(1, 5)}
SIZE = {
    "length": Axis(15e-3, 80e-3, log=True),
    "slender": Axis(1e-3, 4e-3, log=True),
    "k": Axis(*domain.WEBER_FRACTIONS, log=True, special=(0.1,)),
}
#: Observers that are made once: which, and of which Weber fraction.
KEPT = {
    "kind": Axis(0.0, 2 - 1e-9),
    "curved": Axis(0.0, 2 - 1e-9),
    "fraction": Axis(0.0, len(FRACTIONS) - 1e-9),
}
DOMAINS = (
    Domain(
        "fusions of any whisker",
        {"pair": Axis(0.0, len(PAIRS) - 1e-9), "ratio": Axis(0.0, len(RATIOS) - 1e-9)}
        | SIZE
        | {"other": Axis(0.01, 0.3, log=True, special=(0.03,))}
        | CONTACT,
        judge,
    ),
    Domain(
        "real whiskers",
        {"sensed": Axis(0.0, len(SENSED) - 1e-9), "ratio": Axis(0.0, len(REAL_RATIOS) - 1e-9)}
        | SIZE
        | {
            "curvature": Axis(-25.0, 25.0, special=(0.0,)),
            "friction": Axis(-26.0, 26.0, special=(0.0,)),
        }
        | CONTACT
        | {"k": Axis(0.03, 0.3, log=True, special=(0.1,))},
        partial(judge, make=real, sums=planar_sums),
    ),
    Domain(
        "curvature or hinge uncertain",
        KEPT | CONTACT,
        partial(judge, make=uncertain, sums=mixed_sums),
    ),
    Domain(
        "curved whiskers in space", KEPT | CONTACT, partial(judge, make=in_space, sums=space_sums)
    ),
    Domain("friction unknown", KEPT | CONTACT, partial(judge, make=rubbing, sums=mixed_sums)),
)
