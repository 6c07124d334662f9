"""Speed of a JND curve for each cue and engine: 40 distances × 200 readings.

Run ``python tests/benchmarks/bench_cues.py [--emcee] [part of a cue's name]``; with ``--tenth``
of 20 readings, times ten. Wall and CPU seconds; the bars, 2 s by quadrature and 60 s by emcee, are
wall seconds on two cores that have nothing else to do. What is made once for each observer (panels,
tables) is in the time; what is made once for all whiskers (the elastica's map) is not.
"""

from __future__ import annotations

import sys
import time

import numpy as np

import weberwhisk as ww
from weberwhisk.cues import (
    AngleSideAngle,
    BalanceOfMoments,
    ComparativeLength,
    Compliance,
    ContactAndDetachment,
    ForceMap,
    Fused,
    SpaceMap,
    TwoWhiskers,
    UnknownStiffness,
    Vibration,
    VibrissaLength,
)
from weberwhisk.cues.force_map import SIGNALS

W = ww.Whisker(50e-3, 100e-6, 5e-6)
LENGTHS = W.length * np.linspace(0.6, 1.3, 7)
BASES = np.stack([np.linspace(5e-3, -5e-3, 7), np.linspace(-8e-3, 8e-3, 7)], axis=-1)
#: The push, rad, at which a contact at 0.8 of the length is held.
PUSH = 0.1
CUES = [
    VibrissaLength(),
    ComparativeLength(LENGTHS[[1, 5]], BASES[[1, 5]]),
    ComparativeLength(LENGTHS, BASES),
    AngleSideAngle(),
    AngleSideAngle(side_sd=1e-3),
    TwoWhiskers(),
    ContactAndDetachment(),
    Vibration(3),
    Vibration(6, phase=True),
    Compliance(),
    Compliance(tap_angle=0.05),
    Compliance(velocity_spread=0.5),
    ForceMap(),
    ForceMap(SIGNALS),
    ForceMap("moment", deflection_angle=PUSH),
    SpaceMap(),
    UnknownStiffness(ForceMap()),
    BalanceOfMoments(),
    BalanceOfMoments(effort=None),
    Fused(Compliance(), Vibration(3, phase=True)),
    Fused(Compliance(), ForceMap()),
]


def main() -> None:
    words = [word for word in sys.argv[1:] if not word.startswith("--")]
    times = 10 if "--tenth" in sys.argv else 1
    method = "emcee" if "--emcee" in sys.argv else "quadrature"
    ww.jnd_curve(
        ww.Observer(W, ForceMap()), [20e-3], PUSH, n_readings=2
    )  # imports, the elastica's map
    print(f"{'by ' + method:60}{'wall s':>8}{'CPU s':>8}{'bar':>5}{'unreliable':>12}")
    for cue in CUES:
        if not all(word in repr(cue) for word in words):
            continue
        wall, cpu = time.perf_counter(), time.process_time()
        observer = ww.Observer(W, cue)
        r = np.linspace(0.1, 0.8, 40) * min(observer.reach[1], W.length)
        # With the effort unknown the push itself is the muscle's, and little.
        angle = 0.05 if isinstance(cue, BalanceOfMoments) else PUSH
        given = (r, angle) if "deflection_angle" in cue.unknowns else (r,)
        table = ww.jnd_curve(observer, *given, method=method, n_readings=200 // times, seed=1)
        spent = times * (time.perf_counter() - wall), times * (time.process_time() - cpu)
        bar = 60 if method == "emcee" else 2
        share = table["unreliable"].mean()
        name = repr(cue)[:58]
        print(f"{name:60}{spent[0]:8.2f}{spent[1]:8.2f}{bar:5}{share:12.1%}", flush=True)


if __name__ == "__main__":
    main()
