"""The fusions' part of `stability.py`: two cues on any whisker, beside brute force.

A case is a whisker, a pair of cues with noise of their own, a contact and how far the readings lie
off their means. Forces tell of distance and angle, and what is fused with them of distance alone
or of distance and a bearing: given the distance the two are independent, so that a sum over the
distances and, at each, over angles and over bearings is the whole posterior. Not only mean and sd
must be right, but the evidence and the ends of the interval, in which a lost mode shows first.
"""

from __future__ import annotations

import numpy as np
from hunting import Axis, Domain, Fate, Judged
from scipy.special import logit
from stability_posteriors import Sums, distance_sums

import weberwhisk as ww
from weberwhisk import Observer, Status, Whisker, cues, domain, receptors

Array = np.ndarray
Case = dict[str, Array]
#: Base over tip radius; 0 stands for a cone.
RATIOS = (1.0, 1.5, 3.0, 20.0, 0.0)
PAIRS = ("forces and vibration", "forces and a tap", "forces and bearings")
FLOOR = 0.05
#: How far off, in sds, what converged may be without saying so; the evidence in ln.
ADMITTED = 1e-2


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


def sums(o: Observer, reading: Array, near: float) -> Sums:
    """The posterior of distance of a fusion."""
    if "bearing" not in o.unknowns:
        return distance_sums(o, reading, near)
    forces = Observer(o.whisker, o.cue.cues[0], o.noise.part(4, 0, 2))
    return distance_sums(
        forces, reading[:2], near, lambda r: bearings_told(o, reading, r), reach=o.reach
    )


def off_by(o: Observer, reading: Array, exact: Sums) -> tuple[float, float, str]:
    """How far off a posterior is and how far it may be, where that is worst; and its status."""
    p = ww.posterior(o, reading)
    if p.status != Status.CONVERGED:
        return np.nan, np.nan, p.status.name
    error = np.array(
        [
            abs(p.mean - exact.mean) / exact.sd,
            abs(p.sd - exact.sd) / exact.sd,
            *np.abs(p.interval() - exact.interval) / exact.sd,
            abs(p.log_evidence - exact.log_evidence),
        ]
    )
    claimed = [p.mean_error, p.sd_error, *p.quantile_error([0.025, 0.975]), p.sd_error]
    allowed = np.maximum(3 * np.array(claimed) / p.sd, ADMITTED) + exact.known
    allowed[2:4] += 2 * exact.ends_known.max()
    worst = int(np.argmax(error / allowed))
    return float(error[worst]), float(allowed[worst]), p.status.name


def judge(case: Case) -> Judged:
    """Each case's posterior beside brute force."""
    n = case["distance"].size
    fate, excess = np.full(n, Fate.REFUSED), np.full(n, -np.inf)
    seen = {key: np.full(n, np.nan) for key in ("error", "exact_mean", "exact_sd")}
    for i in range(n):
        of = {key: float(values[i]) for key, values in case.items()}
        ratio = RATIOS[min(int(of["ratio"]), len(RATIOS) - 1)]
        pair = PAIRS[min(int(of["pair"]), len(PAIRS) - 1)]
        o = fusion(of["length"], of["slender"] * of["length"], ratio, pair, of["k"], of["other"])
        low, high = o.reach
        r = low + np.clip(of["distance"], 1e-6, 1 - 1e-9) * (high - low)
        start, width = o.angle_range(np.array([r]))
        contact = [r, start + np.clip(of["push"], 1e-9, 1 - 1e-9) * width[0]]
        if "bearing" in o.unknowns:
            contact.append(o.prior["bearing"].ppf(np.clip(of["further"], 0.01, 0.99)))
        signals, outcome = o.signals(np.array(contact))
        if outcome != 0:
            continue
        z = np.array([of[f"off_{j}"] for j in range(1, 5)])[: signals.size]
        # Readings of the vibration are correlated: off along the roots of their covariance.
        reading = o.noise.mean(signals) + np.linalg.cholesky(o.noise.covariance(signals)) @ z
        exact = sums(o, reading, float(logit((r - low) / (high - low))))
        seen["exact_mean"][i], seen["exact_sd"][i] = exact.mean, exact.sd
        error, allowed, status = off_by(o, reading, exact)
        if status != Status.CONVERGED.name:
            fate[i] = Fate.WARNED
            continue
        if exact.known > ADMITTED:
            fate[i] = Fate.UNJUDGED
            continue
        seen["error"][i] = error
        fate[i] = Fate.SILENT if error > allowed else Fate.RIGHT
        excess[i] = np.log(max(error, 1e-300) / allowed)
    return Judged(fate, excess, seen)


DOMAINS = (
    Domain(
        "fusions of any whisker",
        {
            "pair": Axis(0.0, len(PAIRS) - 1e-9),
            "ratio": Axis(0.0, len(RATIOS) - 1e-9),
            "length": Axis(15e-3, 80e-3, log=True),
            "slender": Axis(1e-3, 4e-3, log=True),
            "k": Axis(*domain.WEBER_FRACTIONS, log=True, special=(0.1,)),
            "other": Axis(0.01, 0.3, log=True, special=(0.03,)),
            "distance": Axis(domain.CONTACTS[0], 1.0, special=(0.5, 0.9)),
            "push": Axis(0.0, 1.0, special=(0.5,)),
            "further": Axis(0.01, 0.99, special=(0.5,)),
        }
        | {f"off_{i}": Axis(-2.5, 2.5, special=(0.0,)) for i in range(1, 5)},
        judge,
    ),
)
