"""Speed of a JND curve for each cue: 40 distances × 200 readings by quadrature.

Run ``python tests/benchmarks/bench_cues.py``. CPU seconds of one core: set OMP_NUM_THREADS=1. What
is made once for each observer (panels, tables) is in the time.
"""

from __future__ import annotations

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
    TwoWhiskers,
    VibrissaLength,
)

W = ww.Whisker(50e-3, 100e-6, 5e-6)
LENGTHS = W.length * np.linspace(0.6, 1.3, 7)
BASES = np.stack([np.linspace(5e-3, -5e-3, 7), np.linspace(-8e-3, 8e-3, 7)], axis=-1)
CUES = [
    (Compliance(), None),
    (ForceMap(), 0.1),
    (VibrissaLength(), None),
    (ComparativeLength(LENGTHS[[1, 5]], BASES[[1, 5]]), None),
    (ComparativeLength(LENGTHS, BASES), None),
    (AngleSideAngle(), None),
    (AngleSideAngle(side_sd=1e-3), None),
    (TwoWhiskers(), None),
    (ContactAndDetachment(), None),
    (BalanceOfMoments(), None),
    (BalanceOfMoments(effort=None), 0.05),
]


def main() -> None:
    ww.jnd_curve(ww.Observer(W, Compliance()), [20e-3], draws=2)  # imports and the elastica's map
    print(f"{'cue':70}{'s':>8}{'bar':>6}{'unreliable':>12}")
    for cue, angle in CUES:
        start = time.process_time()
        observer = ww.Observer(W, cue)
        r = np.linspace(0.05, 0.95, 40) * min(observer.reach[1], 0.9 * W.length)
        table = ww.jnd_curve(observer, r, angle, draws=200, seed=1)
        seconds = time.process_time() - start
        print(f"{cue!r:70}{seconds:8.2f}{2:6}{table['unreliable'].mean():12.1%}")


if __name__ == "__main__":
    main()
