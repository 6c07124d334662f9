"""The part of `stability.py` outside the package's domain: whatever is answered there has the flag.

A case has one thing outside: the whisker's length or taper, the contact, the Weber fraction. No
number is judged, as none is promised.
"""

from __future__ import annotations

import numpy as np
from fault_search import Axis, Domain, Fate, Judged

import weberwhisk as ww
from weberwhisk import Observer, Status, Whisker, cues, domain, receptors

Array = np.ndarray
Case = dict[str, Array]
#: What is outside, in the order of a case's `kind`.
KINDS = ("shorter", "longer", "taper", "contact", "k below", "k above")
#: A case is off by a factor of exp(beyond).
AXES = {
    "beyond": Axis(1e-6, 2.0, log=True),
    "kind": Axis(0.0, len(KINDS) - 1e-3),
    "distance": Axis(0.05, 0.95),
    "push": Axis(0.05, 0.9),
}


def scene(beyond: float, kind: int, distance: float) -> tuple[Whisker, float, float]:
    """Whisker, radial distance (m) and Weber fraction, with one of them outside."""
    far = float(np.exp(beyond))
    length = {0: domain.LENGTHS[0] / far, 1: domain.LENGTHS[1] * far}.get(kind, 50e-3)
    ratio = domain.RADIUS_RATIOS[1] * far if kind == 2 else 20.0
    share = domain.CONTACTS[0] / far if kind == 3 else distance
    low, high = domain.WEBER_FRACTIONS
    k = {4: low / far, 5: high * far}.get(kind, 0.1)
    whisker = Whisker(length, length / 500, length / 500 / ratio, 3e9)
    return whisker, share * length, k


def judge(case: Case, *, inferred: bool) -> Judged:
    """Each case pressed, or its posterior found: flagged, refused, or silent."""
    n = case["kind"].size
    fate = np.full(n, Fate.WARNED)
    for i in range(n):
        kind = int(case["kind"][i])
        whisker, r, k = scene(case["beyond"][i], kind, case["distance"][i])
        theta = case["push"][i] * float(ww.flick_past(whisker, r).deflection_angle)
        bent = ww.press(whisker, r, theta)
        if not np.isfinite(theta) or bent.outcome != ww.Outcome.HELD:
            fate[i] = Fate.REFUSED
        elif inferred:
            o = Observer(whisker, cues.ForceMap(), receptors.Weber(k))
            if kind == 3 or Status(int(ww.posterior(o, o.read([r, theta], 1)).status)):
                continue  # a reading of a contact so far in may be one of those that are inside
            fate[i] = Fate.SILENT
        elif kind < 4 and not bent.outside_domain:
            fate[i] = Fate.SILENT
    excess = np.where(fate == Fate.SILENT, 1.0, -np.inf)
    shown = {"x": case["beyond"], "y": np.floor(case["kind"])}
    return Judged(fate, excess, shown)


DOMAINS = [
    Domain("contacts outside", AXES, lambda case: judge(case, inferred=False)),
    Domain("posteriors outside", AXES, lambda case: judge(case, inferred=True)),
]
