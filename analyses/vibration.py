"""Whether the vibration after an impact tells where it was (§2d): how many places it leaves open.

    python analyses/vibration.py [folder] [--short]

Writes vibration.csv: for numbers of modes, Weber fractions of their amplitudes, and phase felt or
not, the share of impacts anywhere on the whisker after which the most probable 95 % of distance
are one interval, and the most intervals seen. The floor of the noise is k of the first mode.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from command import options

import weberwhisk as ww
from weberwhisk._util.output import Run
from weberwhisk.cues import Vibration
from weberwhisk.inference.approximate import count_peaks

WHISKER = ww.Whisker(length=50e-3, base_radius=100e-6, tip_radius=5e-6)
COUNTS = (2, 3, 4, 6, 8)
WEBER_FRACTIONS = (0.3, 0.1, 0.03, 0.01)
SEED = 20110166
#: Impacts for each row.
DRAWS, DRAWS_SHORT = 1000, 100


def uniqueness(count: int, weber_fraction: float, phase: bool, draws: int) -> tuple[float, int]:
    """Share of readings that leave one place, and the most places that any leaves."""
    cue = Vibration(count, phase=phase)
    observer = ww.Observer(WHISKER, cue, cue.noise(weber_fraction, floor=weber_fraction))
    places, readings = np.random.SeedSequence(SEED).spawn(2)
    r = np.random.default_rng(places).uniform(0, WHISKER.length, (draws, 1))
    peaks = count_peaks(observer, observer.read(r, readings))
    return float(np.mean(peaks == 1)), int(peaks.max())


def table(draws: int) -> pd.DataFrame:
    """All combinations, a row each."""
    rows = [
        (phase, count, k, *uniqueness(count, k, phase, draws))
        for phase in (False, True)
        for count in COUNTS
        for k in WEBER_FRACTIONS
    ]
    columns = ["phase_felt", "modes", "weber_fraction", "share_unique", "most_places"]
    return pd.DataFrame(rows, columns=columns)


def make(folder: Path, *, short: bool = False) -> pd.DataFrame:
    """The table into `folder`."""
    draws = DRAWS_SHORT if short else DRAWS
    with Run(folder, "vibration", {"draws": draws}, SEED) as run:
        found = table(draws)
        run.table("vibration", found)
    return found


if __name__ == "__main__":
    given = options(__file__, __doc__, short="few impacts, seconds")
    print(make(given.folder, short=given.short).to_string(index=False))
    print(f"Written to {given.folder}.")
