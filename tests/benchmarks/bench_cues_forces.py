"""CPU time of a JND curve of each cue of forces and vibrations: 40 distances × 200 readings.

Run ``python tests/benchmarks/bench_cues_forces.py [part of a cue's name]``, with OMP_NUM_THREADS=1;
a curve has 2 s on two cores, 4 s of CPU time.
"""

from __future__ import annotations

import sys
import time

import numpy as np

import weberwhisk as ww
from weberwhisk.cues import (
    Compliance,
    ForceMap,
    Fused,
    LateralSlip,
    UnknownStiffness,
    Vibration,
)
from weberwhisk.cues.force_map import SIGNALS

W = ww.Whisker(50e-3, 100e-6, 5e-6)
CUES = [
    Compliance(),
    Compliance(tap_angle=0.05),
    Compliance(velocity_spread=0.5),
    LateralSlip(),
    ForceMap(),
    ForceMap(SIGNALS),
    ForceMap("moment", deflection_angle=0.05),
    UnknownStiffness(ForceMap()),
    Vibration(3),
    Vibration(6, phase=True),
    Fused(Compliance(), Vibration(3, phase=True)),
    Fused(Compliance(), ForceMap()),
]


def main() -> None:
    print(f"{'cue':70}{'CPU s':>8}{'unreliable':>12}")
    for cue in CUES:
        if len(sys.argv) > 1 and sys.argv[1] not in repr(cue):
            continue
        observer = ww.Observer(W, cue)
        r = np.linspace(0.1, 0.9, 40) * min(cue.farthest(W), W.length)
        angle = 0.05 if "deflection_angle" in cue.unknowns else None
        start = time.process_time()
        table = ww.jnd_curve(observer, r, angle, draws=200, seed=1)
        spent = time.process_time() - start
        print(f"{cue!r:70}{spent:8.2f}{table['unreliable'].mean():12.1%}")


if __name__ == "__main__":
    main()
