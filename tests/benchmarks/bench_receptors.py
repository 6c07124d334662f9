"""Speed of every receptor model: likelihoods, and posteriors by quadrature.

Run ``OMP_NUM_THREADS=1 python tests/benchmarks/bench_receptors.py``. Times are of one core's CPU.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

import weberwhisk as ww
from weberwhisk.inference.tree import Tree
from weberwhisk.receptors import (
    Afferents,
    GeneralisedWeber,
    LogNormal,
    ReceptorNoise,
    Saturating,
    SpikeCount,
    Weber,
)

W = ww.Whisker(50e-3, 100e-6, 5e-6)
UNIT = float(W.compliance_constant / W.length)
SLOW, RAPID = (30, 0.01 * UNIT, 100 * UNIT), (10, UNIT, 1e4 * UNIT)
MODELS: dict[str, ReceptorNoise] = {
    "Weber": Weber(0.1),
    "GeneralisedWeber": GeneralisedWeber(0.1, floor=0.01 * UNIT, ceiling=50 * UNIT),
    "Saturating": Saturating(0.1, ceiling=50 * UNIT),
    "LogNormal": LogNormal(0.1),
    "SpikeCount, 40 afferents": SpikeCount(Afferents(*SLOW), Afferents(*RAPID)),
    "the same, random gain": SpikeCount(Afferents(*SLOW), Afferents(*RAPID), gain_sd=0.3),
}
POINTS, READINGS = 100_000, 2_000


def least(work: Callable[[], object], repeats: int = 5) -> float:
    """The least CPU seconds of a few runs."""
    seconds = []
    for _ in range(repeats):
        begun = time.process_time()
        work()
        seconds.append(time.process_time() - begun)
    return min(seconds)


def main() -> None:
    rng = np.random.default_rng(1)
    signals = rng.uniform(0.1, 10, (POINTS, 1)) * UNIT
    places = rng.uniform(0.1, 0.95, (READINGS, 1)) * W.length
    print(f"{'model':28}{'likelihood':>14}{'first cells':>12}{'posteriors':>16}{'worst error':>14}")
    for name, noise in MODELS.items():
        reading = noise.sample(signals, seed=2)
        point = least(lambda n=noise, y=reading: n.log_likelihood(y, signals)) / POINTS
        observer = ww.Observer(W, ww.cues.Compliance(), noise)
        made = least(lambda o=observer: Tree(o, 2e-3).start)
        readings = observer.read(places, seed=3)
        rate = READINGS / least(lambda o=observer, y=readings: ww.posterior(o, y), 3)
        found = ww.posterior(observer, readings)
        error = np.max(np.maximum(found.mean_error, found.sd_error) / found.sd)
        print(f"{name:28}{1e9 * point:8.0f} ns/pt{1e3 * made:9.1f} ms{rate:14.0f}/s{error:14.0e}")


if __name__ == "__main__":
    main()
